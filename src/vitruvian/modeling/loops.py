"""What is wrong with a surface that is to be put in contours, and where it ends: edges, islands, boundary loops."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats
from vitruvian.errors import VitruvianError
from vitruvian.modeling.slicing import Whole

Corner = tuple[int, int]  # a vertex, and what it looks like there

_MOST = 6000  # triangles up to which a surface is searched for places where it crosses itself


def welded(rest: Floats, triangles: Whole) -> tuple[Whole, Whole]:
    """(V,) the first point at the place of each, and triangles (T',3) of those, without collapsed ones."""
    size = float(np.ptp(rest, axis=0).max()) if len(rest) else 1.0
    _, first, where = np.unique(
        np.round(rest / max(1e-7 * size, 1e-300)), axis=0, return_index=True, return_inverse=True
    )
    same = first[where.reshape(-1)].astype(np.int64)
    faces = same[triangles]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 0] != faces[:, 2])
    return same, faces[whole]


def checked(rest: Floats, faces: Whole, name: str) -> None:
    """Raises VitruvianError naming the first non-manifold edge, edge whose faces turn differently, island, inside-out
    surface or place where the surface crosses itself."""
    if not len(faces):
        raise VitruvianError(f"{name}: expected a surface, found no triangles")
    a, b = faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel()
    keys, first, times = np.unique(
        np.minimum(a, b) * len(rest) + np.maximum(a, b), return_index=True, return_counts=True
    )
    where = lambda v: " ".join(f"{x:.4g}" for x in rest[v])  # noqa: E731
    edge = lambda k: f"edge {a[k]}-{b[k]} at {where(a[k])}"  # noqa: E731
    bad = np.flatnonzero(times > 2)
    if len(bad):
        raise VitruvianError(
            f"{name}: expected at most two faces at an edge, found {times[bad[0]]} at {edge(first[bad[0]])}"
        )
    directed, first, times = np.unique(a * len(rest) + b, return_index=True, return_counts=True)
    if (times > 1).any():
        k = first[np.argmax(times > 1)]
        raise VitruvianError(f"{name}: expected faces that all turn one way, found a mirrored one at {edge(k)}")
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    used, flat = np.unique(faces, return_inverse=True)
    local = flat.reshape(-1, 3)
    graph = coo_array((np.ones(2 * len(local)), (local[:, :2].ravel(), local[:, 1:].ravel())), shape=(len(used),) * 2)
    count, island = connected_components(graph, directed=False)
    if count > 1:
        size = np.bincount(island)
        small = int(np.argmin(size))
        at = where(used[np.flatnonzero(island == small)[0]])
        raise VitruvianError(
            f"{name}: expected one piece, found {count} islands; the smallest has {size[small]} points, at {at}"
        )
    if _inside_out(rest, faces):
        raise VitruvianError(f"{name}: expected faces that look outwards, found the whole surface mirrored")
    crossing = crossings(rest, faces)
    if crossing is not None:
        raise VitruvianError(
            f"{name}: expected a surface that does not cross itself, found triangles {crossing[0]} and {crossing[1]} "
            f"crossing at {where(faces[crossing[0], 0])}"
        )


def _inside_out(rest: Floats, faces: Whole) -> bool:
    """Whether the volume, open ends closed by lids, is negative."""
    p = rest - rest[faces[:, 0]].mean(axis=0)
    total = np.einsum("ni,ni->", p[faces[:, 0]], np.cross(p[faces[:, 1]], p[faces[:, 2]]))
    for line in directed_loops(faces):
        middle = p[line].mean(axis=0)
        total += np.sum(np.cross(p[np.roll(line, -1)], p[line]) @ middle)
    return bool(total < 0)


def directed_loops(faces: Whole) -> list[NDArray[np.int64]]:
    """The boundary loops, each in the direction of its faces. Where several meet in a point each is closed first."""
    a, b = faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel()
    n = int(faces.max(initial=0)) + 1
    lone = ~np.isin(a * n + b, b * n + a)
    following: dict[int, list[int]] = {}
    for u, v in zip(a[lone].tolist(), b[lone].tolist(), strict=True):
        following.setdefault(u, []).append(v)
    out = []
    while following:
        start = min(following)
        line, here = [start], start
        while True:
            ahead = following.get(here)
            if not ahead:
                break
            here = ahead.pop()
            if not ahead:
                del following[line[-1]]
            if here == start:
                break
            line.append(here)
        out.append(np.array(line, np.int64))
    return out


def zipped(p: Floats, q: Floats) -> Whole:
    """Triangles (n+m,3) between two closed loops of points (n,3), (m,3) that run the same way, with the least sum of
    lengths across that begins at the first of both; the second loop's points are numbered after the first's.

    Source: H. Fuchs, Z. Kedem, S. Uselton, "Optimal surface reconstruction from planar contours" (1977)."""
    n, m = len(p), len(q)
    across = np.linalg.norm(p[np.arange(n + 1) % n][:, None] - q[np.arange(m + 1) % m][None], axis=2)
    cost = np.zeros((n + 1, m + 1))
    cost[0] = np.cumsum(across[0])
    cost[0, m] = np.inf  # round one loop first: the edge between their first points would be there twice
    for i in range(1, n + 1):  # by row: the best way to (i, j) comes down or along from the left
        total = np.cumsum(across[i])
        down = cost[i - 1] + across[i] - total
        down[0] = np.inf if i == n else down[0]
        cost[i] = np.minimum.accumulate(down) + total
    i, j, out = n, m, []
    while i or j:
        if j == 0 or (i and cost[i - 1, j] <= cost[i, j - 1]):
            out.append([(i - 1) % n, i % n, n + j % m])
            i -= 1
        else:
            out.append([n + j % m, n + (j - 1) % m, i % n])
            j -= 1
    return np.array(out[::-1])


def divided(tri: list[Corner], middle: list[Corner | None]) -> list[tuple[Corner, Corner, Corner]]:
    """A triangle with new corners on some of its sides, `middle[i]` between corners i and i + 1, as triangles."""
    out, line = [], []
    for before, corner, after in zip([middle[2], *middle[:2]], tri, middle, strict=True):
        if before is not None and after is not None:
            out.append((before, corner, after))
        else:
            line.append(corner)
        if after is not None:
            line.append(after)
    first = next((line.index(m) for m in middle if m is not None), 0)  # never the far end of a side that is divided
    line = line[first:] + line[:first]
    return [*out, *((line[0], line[i], line[i + 1]) for i in range(1, len(line) - 1))]


def crossings(rest: Floats, faces: Whole) -> tuple[int, int] | None:
    """Two triangles without a common point that cross each other, or None; large surfaces are not searched."""
    count = len(faces)
    if count > _MOST:
        return None
    corner = rest[faces]
    low, high = corner.min(axis=1), corner.max(axis=1)
    order = np.argsort(low[:, 0], kind="stable")
    sorted_low = low[order, 0]
    last = np.searchsorted(sorted_low, high[order, 0], side="right")
    for begin in range(0, count, 512):
        rows = np.arange(begin, min(begin + 512, count))
        reach = last[rows] - rows - 1
        one = np.repeat(rows, np.maximum(reach, 0))
        two = (
            np.arange(len(one))
            - np.repeat(np.cumsum(np.maximum(reach, 0)) - np.maximum(reach, 0), np.maximum(reach, 0))
            + one
            + 1
        )  # noqa: E501
        i, j = order[one], order[two]
        near = ((low[i, 1:] < high[j, 1:]) & (low[j, 1:] < high[i, 1:])).all(axis=1)
        i, j = i[near], j[near]
        apart = ~(faces[i][:, :, None] == faces[j][:, None, :]).any(axis=(1, 2))
        i, j = i[apart], j[apart]
        for first, second in ((i, j), (j, i)):
            for k in range(3):
                hit = _pierced(corner[first, k], corner[first, (k + 1) % 3], corner[second])
                if hit.any():
                    n = int(np.argmax(hit))
                    return int(first[n]), int(second[n])
    return None


def _pierced(start: Floats, stop: Floats, triangle: Floats) -> NDArray[np.bool_]:
    """(n,) whether segments go through triangles (n,3,3), not merely touching them."""
    u, v, way = triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0], stop - start
    p = np.cross(way, v)
    size = (u * p).sum(axis=1)
    scale = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1) * np.linalg.norm(way, axis=1)
    safe = np.abs(size) > 1e-9 * np.maximum(scale, 1e-300)
    inverse = 1 / np.where(safe, size, 1)
    t = start - triangle[:, 0]
    a = (t * p).sum(axis=1) * inverse
    q = np.cross(t, u)
    b = (way * q).sum(axis=1) * inverse
    s = (v * q).sum(axis=1) * inverse
    e = 1e-7
    return np.asarray(safe & (a > e) & (b > e) & (a + b < 1 - e) & (s > e) & (s < 1 - e))
