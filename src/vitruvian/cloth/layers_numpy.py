"""The kernels of cloth in layers one and two in NumPy: what they mean, and what runs without the extension."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints

Single = NDArray[np.float32]
OUT, RISING, ALIKE = 0.005, 0.3, 0.7  # as in src/native/layers.cpp


def cloth_feet(
    point: Single, normal: Single, corner: Ints, share: Single, offset: Single, foot: Single, up: Single, out: Single
) -> None:
    """foot (n,3) and up (n,3), the normal there: of vertices whose feet have shares (n,3) of the corners (n,3) of a
    surface, point and normal (V,3); out (n,3): the vertices, offset (n,3) from their feet."""
    p, q, w, o = (a.astype(np.float64) for a in (point, normal, share, offset))
    s = np.einsum("nk,nkx->nx", w, p[corner])
    n = _unit(np.einsum("nk,nkx->nx", w, q[corner]))
    edge = p[corner[:, 1]] - p[corner[:, 0]]
    t = _unit(edge - _dot(edge, n) * n)
    foot[:], up[:] = s, n
    out[:] = s + o[:, :1] * t + o[:, 1:2] * np.cross(n, t) + o[:, 2:] * n


def cloth_clear(
    x: Single, vertex: Ints, nearest: Ints, triangle: Ints, neighbour: Ints, surface: Single, offset: float, deep: float
) -> None:
    """Moves some vertices (k,) of x (n,3) straight away from a body, surface (V,6) points and normals, until they are
    `offset` metres from it, and less and less far from a third of `deep` inside on, to nothing there.

    nearest (k,): triangles (t,3) from which the kernel goes on, over neighbours (t,3), as long as it comes nearer; -1 for
    what stays. This twin asks all triangles.
    """
    import igl

    from vitruvian.cloth.touch_numpy import shares

    at, points = x[vertex].astype(np.float64), surface[:, :3].astype(np.float64)
    face = np.asarray(igl.point_mesh_squared_distance(at, points, triangle.astype(np.int64))[1], np.int64).reshape(-1)
    corner = triangle[face]
    share = shares(at, points[corner])
    foot = np.einsum("kc,kcx->kx", share, points[corner])
    normal = _unit(np.einsum("kc,kcx->kx", share, surface[corner, 3:].astype(np.float64)))
    apart = np.linalg.norm(at - foot, axis=1)
    away = np.where(_dot(at - foot, normal)[:, 0] < 0, -apart, apart)
    far = apart > 1e-5
    normal[far] = (at[far] - foot[far]) / away[far, None]
    some = (away < offset) & (away >= -deep) & (nearest >= 0) & ~_well_out(surface, triangle[nearest], at)
    part = np.minimum(1.5 * (1 + away / deep), 1)[:, None]
    x[vertex[some]] = (at + part * (foot + offset * normal - at))[some]


def cloth_pinch(
    x: Single, part: Single, foot: Single, up: Single, vertex: Ints, nearest: Ints, triangle: Ints, neighbour: Ints,
    surface: Single, offset: float, far: float, back: float,
) -> None:  # fmt: skip
    """Draws some vertices (k,) of x (n,3), those of one together, towards their feet (n,3), normals there up (n,3), until
    they are `offset` metres out of a body that faces them, surface (V,6) points and normals, or half way to it where the
    foot is nearer than twice that.

    nearest (k,): triangles (t,3) from which it is looked for over neighbours (t,3), if they are not farther than `far`.
    This twin asks all triangles that hang together with those. part (n,): shares of the way from its foot that each
    vertex had, and has afterwards: they grow by `back` at most.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    from vitruvian.cloth.touch_numpy import shares

    t = len(triangle)
    a, k = np.nonzero(neighbour >= 0)
    piece = connected_components(coo_array((np.ones(len(a)), (a, neighbour[a, k])), (t, t)), directed=False)[1]
    points = surface[:, :3].astype(np.float64)
    each = np.unique(vertex)
    part[each] = np.minimum(part[each] + back, 1)
    whole = (x - foot).astype(np.float64)
    turns = np.array([np.count_nonzero(vertex[:i] == v) for i, v in enumerate(vertex)], np.int64)
    for turn, own in ((t, p) for t in range(turns.max(initial=-1) + 1) for p in np.unique(piece[nearest])):
        some = np.flatnonzero((turns == turn) & (piece[nearest] == own))
        out = _Out(surface, triangle[piece == own], neighbour[piece == own], offset)
        s, way = foot[vertex[some]].astype(np.float64), part[vertex[some], None] * whole[vertex[some]]
        first = points[triangle[nearest[some]]]
        now = out(s + way)[0]
        apart = s + way - np.einsum("kc,kcx->kx", shares(s + way, first), first)
        normal = surface[triangle[nearest[some], 0], 3:].astype(np.float64)
        facing = _dot(normal, up[vertex[some]].astype(np.float64))[:, 0] <= ALIKE
        held = facing & (now < offset) & (_dot(apart, apart)[:, 0] <= far**2)
        held &= ~_well_out(surface, triangle[nearest[some]], s + way)
        share, low, inside = np.ones(len(some)), np.zeros(len(some)), now < 0
        for _ in range(5):
            half = 0.5 * (low + share)
            within = out(s + half[:, None] * way)[0] < 0
            share, low = np.where(inside & within, half, share), np.where(inside & ~within, half, low)
        share = np.where(inside, low, share)
        now, there, m = out(s + share[:, None] * way)
        high = _dot(s - there, m)[:, 0]
        least = np.where(high < 2 * offset, 0.5 * high, offset)
        nearer = (high > now) & (now < least)
        share *= np.where(nearer, np.maximum(high - least, 0) / np.where(nearer, high - now, 1) * (high > 0), 1)
        part[vertex[some[held]]] *= share[held]
    x[each] = foot[each] + part[each, None] * whole[each]


def _well_out(surface: Single, corner: Ints, at: Floats) -> NDArray[np.bool_]:
    """(k,) which points (k,3) are so far over the planes in the first of some corners (k,3) that they are not looked at."""
    way = at - surface[corner[:, 0], :3]
    high = _dot(way, surface[corner[:, 0], 3:].astype(np.float64))[:, 0] - OUT
    return (high > 0) & (high**2 > RISING**2 * _dot(way, way)[:, 0])


class _Out:
    """How far points (k,3) are out of a surface, what is nearest on it and the normals there: `beyond` where that is on its
    border."""

    def __init__(self, surface: Single, triangle: Ints, neighbour: Ints, beyond: float):
        self.points, self.normals = surface[:, :3].astype(np.float64), surface[:, 3:].astype(np.float64)
        self.triangle, self.neighbour, self.beyond = triangle.astype(np.int64), neighbour, beyond

    def __call__(self, at: Floats) -> tuple[Floats, Floats, Floats]:
        import igl

        from vitruvian.cloth.touch_numpy import shares

        face = np.asarray(igl.point_mesh_squared_distance(at, self.points, self.triangle)[1], np.int64).reshape(-1)
        corner = self.triangle[face]
        share = shares(at, self.points[corner])
        foot = np.einsum("kc,kcx->kx", share, self.points[corner])
        m = _unit(np.einsum("kc,kcx->kx", share, self.normals[corner]))
        border = np.any((self.neighbour[face] < 0) & (np.roll(share, 1, axis=1) <= 0), axis=1)
        return np.where(border, self.beyond, _dot(at - foot, m)[:, 0]), foot, np.where(border[:, None], 0, m)


def cloth_limbs(
    r: Single, v: Single, vertex: Ints, bone: Ints, radius: Single, room: Single, least: Single, row: Ints,
    neighbour: Ints, foot_before: Single, foot: Single, up: Single, axis: Single, numbers: Single,
) -> None:  # fmt: skip
    """One frame of r (k,3), from the foot, and v (k,3) m/s, in place: each vertex in a half-ball on the skin.

    numbers: step, damping, friction, smooth, drag, density, gravity (3), wind (3). See `vitruvian.cloth.worn`.
    """
    h, damping, friction, smooth, drag, density = (float(q) for q in numbers[:6])
    g, air = numbers[6:9].astype(np.float64), numbers[9:12].astype(np.float64)
    s, n, low = (a[vertex].astype(np.float64) for a in (foot, up, foot_before))
    sdot, was, floor = (s - low) / h, r.astype(np.float64), least.astype(np.float64)[:, None]
    far = reach(n, axis.astype(np.float64)[bone], g, radius.astype(np.float64), room.astype(np.float64), floor[:, 0])[
        :, None
    ]
    speed = sdot + (v - sdot) * np.exp(-damping * h) + h * g
    if density > 0:
        meet = _dot(air - speed, n)
        speed = speed + np.minimum(drag * np.abs(meet) * h / density, 1.0) * meet * n
    to, touched = _within(was + h * (speed - sdot), n, floor, far)
    slide = (to - was) / h
    along = _dot(slide, n) * n
    slide = np.where(touched, along + (1 - friction) * (slide - along), slide)
    v[:] = sdot + slide
    count = np.diff(row)
    total = np.zeros_like(to)
    np.add.at(total, np.repeat(np.arange(len(count)), count), to[neighbour])
    mixed = (1 - smooth) * to + smooth * total / np.maximum(count, 1)[:, None]
    r[:] = _within(np.where(count[:, None] > 0, mixed, to), n, floor, far)[0]


def reach(n: Floats, axis: Floats, gravity: Floats, radius: Floats, room: Floats, least: Floats) -> Floats:
    """(k,) metres that cloth can be from the skin, where its normal is n (k,3): as a ring that is `room` wider than a limb
    of that radius (k,) about an axis (k,3), and hangs on it.

    Under a level limb it is twice the room, above it nothing, about an upright limb the room all around.
    Source: seed 003, section 5.3.2 (a diameter by the place relative to the normal); note cloth.md, section 7.
    """
    pull = float(np.linalg.norm(gravity))
    down = gravity / pull if pull > 1e-9 else np.zeros(3)
    across = down - _dot(down, axis) * axis
    m = np.linalg.norm(across, axis=1)
    cosine = np.clip(np.sum(n * across, axis=1) / np.maximum(m, 1e-30), -1, 1)
    gap = room * cosine + np.sqrt(np.maximum((radius + room) ** 2 - room**2 * (1 - cosine**2), 0)) - radius
    return np.maximum(np.where(m > 1e-6, m * gap + (1 - m) * room, room), least)


def _within(r: Floats, n: Floats, least: Floats, reach: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """r (k,3) at least `least` along n and at most `reach` long, and whether it was under the first."""
    up = _dot(r, n)
    touched = up < least
    r = np.where(touched, r + (least - up) * n, r)
    size = np.linalg.norm(r, axis=1, keepdims=True)
    r = np.where(size > reach, r * reach / np.maximum(size, 1e-30), r)
    up = _dot(r, n)
    flat = r - up * n
    wide = np.linalg.norm(flat, axis=1, keepdims=True)
    room = np.sqrt(np.maximum(reach**2 - least**2, 0))
    low = (size > reach) & (up < least)
    return np.where(low, least * n + np.minimum(1, room / np.maximum(wide, 1e-30)) * flat, r), touched


def _dot(a: Floats, b: Floats) -> Floats:
    return np.sum(a * b, axis=-1, keepdims=True)


def _unit(a: Floats) -> Floats:
    size = np.linalg.norm(a, axis=1, keepdims=True)
    return np.where(size > 1e-20, a / np.maximum(size, 1e-30), 0)
