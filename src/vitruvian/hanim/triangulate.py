"""Polygons and primitives to triangles.

Everything answers *corners*: for each triangle the places of its three corners in the list of polygon corners, so that
coordinates, texture coordinates and colours with their own index lists can all follow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_EARS = 100_000  # corners of concave polygons that are cut ear by ear in one face set
_WIDEST = 512  # corners of one such polygon


def polygons(index: NDArray[np.integer]) -> tuple[Ints, Ints]:
    """Start and length of each polygon in a list of corners separated by -1 (the last may lack its -1)."""
    ends = np.flatnonzero(index == -1)
    if len(index) and index[-1] != -1:
        ends = np.append(ends, len(index))
    starts = np.concatenate([[0], ends[:-1] + 1]).astype(np.int64)[: len(ends)]
    return starts, (ends - starts).astype(np.int64)


def faces(index: NDArray[np.integer], points: Floats) -> tuple[Ints, Ints]:
    """Triangle corners (t, 3) of a face set, in face order, and the face of each triangle (t,).

    A fan where it is safe; a polygon whose fan would fold (it is concave) is cut ear by ear, up to a limit of work
    that no honest file reaches, then as a fan. Faces with fewer than three corners give nothing. Indices must be valid.
    """
    if not len(index) % 4:  # most meshes: triangles, each with its -1
        rows = index.reshape(-1, 4)
        if (rows[:, 3] == -1).all() and (rows[:, :3] >= 0).all():
            return np.arange(len(index)).reshape(-1, 4)[:, :3], np.arange(len(rows))
    starts, sizes = polygons(index)
    budget = _EARS
    corners: list[Ints] = []
    owners: list[Ints] = []
    for n in np.unique(sizes[sizes >= 3]):
        which = np.flatnonzero(sizes == n)
        loop = starts[which, None] + np.arange(n)
        fan = np.stack([np.zeros(n - 2, np.int64), np.arange(1, n - 1), np.arange(2, n)], axis=1)
        local = np.broadcast_to(fan, (len(which), n - 2, 3))
        if n > 3:
            folded = _folded(points[index[loop]], fan)
            if folded.any():
                local = local.copy()
                if n == 4:
                    local[folded] = [[1, 2, 3], [1, 3, 0]]
                    folded[:] = False
                for f in np.flatnonzero(folded):
                    if n > _WIDEST or budget < n:
                        break
                    budget -= n
                    local[f] = ears(points[index[loop[f]]])
        corners.append((local + starts[which, None, None]).reshape(-1, 3))
        owners.append(np.repeat(which, n - 2))
    if not corners:
        return np.zeros((0, 3), np.int64), np.zeros(0, np.int64)
    if len(corners) == 1:  # all polygons of one kind are in order
        return corners[0], owners[0]
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(corners)[order], owner[order]


def _folded(loops: Floats, fan: Ints) -> NDArray[np.bool_]:
    """(f,) whether a fan over loops (f, n, 3) has a triangle against the polygon's own normal (Newell's)."""
    following = np.roll(loops, -1, axis=1)
    normal = np.cross(loops, following).sum(axis=1)
    a, b, c = (loops[:, fan[:, k]] for k in range(3))
    side = np.einsum("fti,fi->ft", np.cross(b - a, c - a), normal)
    return (side < -1e-12 * np.einsum("fi,fi->f", normal, normal)[:, None]).any(axis=1)


def ears(loop: Floats) -> Ints:
    """(n-2, 3) triangles of one simple polygon (n, 3) by ear clipping, in its own winding."""
    normal = np.cross(loop, np.roll(loop, -1, axis=0)).sum(axis=0)
    drop = int(np.argmax(np.abs(normal)))
    axes = [(1, 2), (2, 0), (0, 1)][drop]
    flat = loop[:, axes] * (1.0, 1.0 if normal[drop] >= 0 else -1.0)
    left = list(range(len(loop)))
    found: list[tuple[int, int, int]] = []
    while len(left) > 3:
        for i in range(len(left)):
            a, b, c = left[i - 1], left[i], left[(i + 1) % len(left)]
            if _turn(flat[a], flat[b], flat[c]) <= 0:
                continue
            others = flat[[p for p in left if p not in (a, b, c)]]
            if not _inside(others, flat[a], flat[b], flat[c]).any():
                found.append((a, b, c))
                del left[i]
                break
        else:  # not a simple polygon: what is left becomes a fan, as browsers do it
            found += [(left[0], left[k], left[k + 1]) for k in range(1, len(left) - 1)]
            return np.array(found, np.int64)
    found.append((left[0], left[1], left[2]))
    return np.array(found, np.int64)


def _turn(a: Floats, b: Floats, c: Floats) -> Floats:
    """Twice the signed area of a, b, c; c may be many points (n, 2)."""
    return (b[0] - a[0]) * (c[..., 1] - a[1]) - (b[1] - a[1]) * (c[..., 0] - a[0])


def _inside(p: Floats, a: Floats, b: Floats, c: Floats) -> NDArray[np.bool_]:
    """(n,) whether points p (n, 2) lie in or on the triangle."""
    return (_turn(a, b, p) >= 0) & (_turn(b, c, p) >= 0) & (_turn(c, a, p) >= 0)


def strips(counts: Ints) -> Ints:
    """(t, 3) corners of triangle strips of `counts` vertices laid end to end; every other triangle is turned."""
    found = []
    start = 0
    for n in counts:
        for k in range(int(n) - 2):
            a, b = (start + k, start + k + 1) if k % 2 == 0 else (start + k + 1, start + k)
            found.append((a, b, start + k + 2))
        start += int(n)
    return np.array(found, np.int64).reshape(-1, 3)


def fans(counts: Ints) -> Ints:
    """(t, 3) corners of triangle fans of `counts` vertices laid end to end."""
    found = []
    start = 0
    for n in counts:
        found += [(start, start + k, start + k + 1) for k in range(1, int(n) - 1)]
        start += int(n)
    return np.array(found, np.int64).reshape(-1, 3)


def box(size: Floats) -> tuple[Floats, Ints]:
    """A box around the origin: 24 points (4 per side, so that sides shade flat) and 12 triangles."""
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    points = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            side = np.empty((4, 3))
            side[:, axis] = sign
            side[:, (axis + 1) % 3] = corner[:, 0] * sign
            side[:, (axis + 2) % 3] = corner[:, 1]
            points.append(side)
    quads = np.arange(24).reshape(6, 4)
    return np.concatenate(points) * size / 2, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def sphere(radius: float, around: int = 24, rings: int = 12) -> tuple[Floats, Ints]:
    """A sphere around the origin, poles on Y, one point per pole."""
    up = np.pi * np.arange(1, rings) / rings
    turn = 2 * np.pi * np.arange(around) / around
    ring = np.stack([np.sin(turn), np.zeros(around), np.cos(turn)], axis=1)
    body = [np.sin(u) * ring + [0, np.cos(u), 0] for u in up]
    points = np.concatenate([[[0, 1, 0]], *body, [[0, -1, 0]]]) * radius
    k = np.arange(around)
    following = (k + 1) % around
    last = len(points) - 1
    triangles = [np.stack([0 * k, 1 + k, 1 + following], axis=1)]
    for r in range(rings - 2):
        a, b = 1 + r * around, 1 + (r + 1) * around
        triangles.append(np.stack([a + k, b + k, b + following], axis=1))
        triangles.append(np.stack([a + k, b + following, a + following], axis=1))
    a = 1 + (rings - 2) * around
    triangles.append(np.stack([a + k, 0 * k + last, a + following], axis=1))
    return points, np.concatenate(triangles)


def cylinder(
    radius: float, height: float, *, top: bool = True, bottom: bool = True, side: bool = True, tip: bool = False
) -> tuple[Floats, Ints]:
    """A cylinder, or with `tip` a cone, along Y around the origin; caps have points of their own."""
    around = 24
    turn = 2 * np.pi * np.arange(around) / around
    ring = np.stack([radius * np.sin(turn), np.zeros(around), radius * np.cos(turn)], axis=1)
    k = np.arange(around)
    following = (k + 1) % around
    points: list[Floats] = []
    triangles: list[Ints] = []
    count = 0
    up = np.array([0, height / 2, 0])
    if side:
        points += [ring - up, np.tile(up, (around, 1)) if tip else ring + up]
        triangles.append(np.stack([k, following, around + following], axis=1))
        if not tip:
            triangles.append(np.stack([k, around + following, around + k], axis=1))
        else:
            triangles[-1] = np.stack([k, following, around + k], axis=1)
        count = 2 * around
    for wanted, sign in ((top and not tip, 1), (bottom, -1)):
        if wanted:
            points += [ring + sign * up, sign * up[None]]
            pair = (count + k, count + following) if sign > 0 else (count + following, count + k)
            triangles.append(np.stack([*pair, np.full(around, count + around)], axis=1))
            count += around + 1
    if not points:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    return np.concatenate(points), np.concatenate(triangles)
