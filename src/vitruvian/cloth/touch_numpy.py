"""What of a surface is near to what of it, and what cuts what, in NumPy: everything against everything."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints

Single = NDArray[np.float32]
BENT = 0.5  # cosine of the angle between neighbours that may touch in the coming frame


def shares(x: Floats, corner: Floats) -> Floats:
    """(k,3) shares of the corners (k,3,3) in the points of triangles that are nearest to x (k,3)."""
    a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
    dot = lambda u, v: np.sum(u * v, axis=1)  # noqa: E731
    ab, ac = b - a, c - a
    d00, d01, d11 = dot(ab, ab), dot(ab, ac), dot(ac, ac)
    d20, d21 = dot(x - a, ab), dot(x - a, ac)
    whole = np.where(d00 * d11 - d01 * d01 == 0, 1, d00 * d11 - d01 * d01)
    v, w = (d11 * d20 - d01 * d21) / whole, (d00 * d21 - d01 * d20) / whole
    out = np.stack([1 - v - w, v, w], axis=1)
    outside = (out < 0).any(axis=1) | (d00 * d11 - d01 * d01 <= 0)
    best = np.full(len(x), np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):  # the nearest point of the rim
        p, way = corner[:, i], corner[:, j] - corner[:, i]
        t = np.clip(dot(x - p, way) / np.maximum(dot(way, way), 1e-300), 0, 1)
        far = np.sum((p + t[:, None] * way - x) ** 2, axis=1)
        better = outside & (far < best)
        best = np.where(better, far, best)
        row = np.zeros_like(out)
        row[:, i], row[:, j] = 1 - t, t
        out[better] = row[better]
    return out


def near_plan(x: Single, triangles: Ints, edges: Ints, sides: Ints) -> tuple[Ints, ...]:
    """None is needed here."""
    return ()


def near_cloth(
    x: Single,
    v: Single,
    triangles: Ints,
    edges: Ints,
    sides: Ints,
    same: Ints,
    limits: Single,
    before: Ints,
    side: Single,
    plan: tuple[Ints, ...] = (),
    threads: int = 0,
) -> tuple[Ints, Single, Ints, Single]:
    """As the kernel: vertices and triangles, then edges, that may meet. See src/native/near_cloth.h. One thread."""
    p, u = x[:, :3].astype(np.float64), v[:, :3].astype(np.float64)
    still, time, moving, firm = (float(value) for value in limits)

    def meet(way: Floats, one: Ints, other: Ints) -> NDArray[np.bool_]:  # ways (k,3), (k,a) and (k,b) vertices: (k,)
        rate = u[one][:, :, None] - u[other][:, None]
        fast, closing = np.sum(rate * rate, axis=-1), -np.einsum("kx,kabx->kab", way, rate)
        until = np.minimum(closing / np.maximum(fast, 1e-300), np.minimum(time, moving / np.sqrt(fast + 1e-300)))
        then = way[:, None, None] + np.maximum(until, 0)[..., None] * rate
        return (np.sum(then * then, axis=-1) <= still**2).any(axis=(1, 2))

    known = {(int(i), int(t)): float(s) for (i, t), s in zip(before, side)}
    index: list[list[int]] = []
    which: list[float] = []
    keys: list[list[int]] = []
    kept: list[float] = []
    wide, free = still + moving, x[:, 3] > 0
    normal = np.cross(p[triangles[:, 1]] - p[triangles[:, 0]], p[triangles[:, 2]] - p[triangles[:, 0]])
    normal /= np.sqrt(np.sum(normal**2, axis=1, keepdims=True) + 1e-60)
    vertex_of, edge_of = (
        np.array([np.flatnonzero((of == k).any(axis=1))[0] for k in range(n)])
        for of, n in ((triangles, len(p)), (sides, len(edges)))
    )

    def flat(t: NDArray[np.integer], u: int) -> NDArray[np.bool_]:  # neighbours that are not bent do not touch
        common = (same[triangles[t]][:, :, None] == same[triangles[u]][None, None]).any(axis=(1, 2))
        return common & (normal[t] @ normal[u] >= BENT)

    for i in range(len(p)):
        away = ~(same[triangles] == same[i]).any(axis=1)
        low, high = p[triangles].min(axis=1), p[triangles].max(axis=1)
        some = np.flatnonzero(away & ((p[i] >= low - wide) & (p[i] <= high + wide)).all(axis=1))
        corner = p[triangles[some]]
        share = shares(np.broadcast_to(p[i], (len(some), 3)), corner)
        way = p[i] - np.einsum("kc,kcx->kx", share, corner)
        upright = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        up = np.sum((p[i] - corner[:, 0]) * upright, axis=1)
        good = meet(way, np.full((len(some), 1), i), triangles[some]) & ~flat(some, vertex_of[i])
        good &= free[i] | free[triangles[some]].any(axis=1)
        for k in np.flatnonzero(good):
            t = int(some[k])
            index.append([i, *triangles[t]])
            which.append(known.get((i, t), -1.0 if up[k] < 0 else 1.0))
            if np.sum(way[k] ** 2) <= firm * firm:
                keys.append([i, t])
                kept.append(which[-1])
    a, b = p[edges[:, 0]], p[edges[:, 1]]
    low, high = np.minimum(a, b), np.maximum(a, b)
    for e in range(len(edges)):
        later = np.arange(e + 1, len(edges))
        box = ((low[later] - wide <= high[e]) & (high[later] + wide >= low[e])).all(axis=1)
        for f in later[box]:
            if np.isin(same[edges[e]], same[edges[f]]).any() or flat(edge_of[None, f], edge_of[e])[0]:
                continue
            share_, across = _closest_edges(p[[*edges[e], *edges[f]]])
            way = share_ @ p[[*edges[e], *edges[f]]]
            if across and free[[*edges[e], *edges[f]]].any() and meet(way[None], edges[None, e], edges[None, f])[0]:
                index.append([*edges[e], *edges[f]])
    return (
        np.array(index, np.int32).reshape(-1, 4),
        np.array(which, np.float32),
        np.array(keys, np.int32).reshape(-1, 2),
        np.array(kept, np.float32),
    )


def _closest_edges(x: Floats) -> tuple[Floats, bool]:
    """(4,) shares of the ends (4,3) of two edges in the way from the second to the first, and whether they are not
    parallel."""
    d1, d2, r = x[1] - x[0], x[3] - x[2], x[0] - x[2]
    a, e, b, c, g = d1 @ d1, d2 @ d2, d1 @ d2, d1 @ r, d2 @ r
    whole = a * e - b * b
    across = bool(whole > 1e-6 * a * e)
    s = np.clip((b * g - c * e) / whole, 0, 1) if across else 0.5
    q = np.clip((b * s + g) / e, 0, 1) if e > 0 else 0.0
    s = np.clip((b * q - c) / a, 0, 1) if a > 0 else 0.0
    return np.array([1 - s, s, q - 1, -q]), across


def closest(x: Floats, corner: bool) -> tuple[Floats, bool]:
    """(4,) shares of a vertex and a triangle, or two edges, (4,3) in the way between what is nearest of both, and whether
    that is inside the triangle, or of both edges."""
    if corner:
        s = shares(x[:1], x[None, 1:])[0]
        return np.array([1.0, -s[0], -s[1], -s[2]]), bool((s > 0).all())
    share, across = _closest_edges(x)
    return share, across and bool((np.abs(share) > 0).all())


def cloth_cuts(x: Single, triangles: Ints, edges: Ints, same: Ints) -> Ints:
    """(k,2) edges and triangles without a common vertex that cut each other."""
    p = x[:, :3].astype(np.float64)
    u, v, w = (p[triangles[:, k]] for k in range(3))
    normal = np.cross(v - u, w - u)
    low, high = np.minimum(np.minimum(u, v), w), np.maximum(np.maximum(u, v), w)
    out = []
    for e, (i, j) in enumerate(edges):
        a, b = p[i], p[j]
        box = ((np.minimum(a, b) <= high) & (np.maximum(a, b) >= low)).all(axis=1)
        some = np.flatnonzero(box & ~np.isin(same[triangles], same[[i, j]]).any(axis=1))
        begin, end = np.sum(normal[some] * (a - u[some]), axis=1), np.sum(normal[some] * (b - u[some]), axis=1)
        volume = [np.sum((b - a) * np.cross(m[some] - a, k[some] - a), axis=1) for m, k in ((u, v), (v, w), (w, u))]
        alike = np.all(np.array(volume) > 0, axis=0) | np.all(np.array(volume) < 0, axis=0)
        out += [[e, int(t)] for t in some[((begin > 0) != (end > 0)) & alike]]
    return np.array(out, np.int32).reshape(-1, 2)
