"""Where a surface runs through itself: pairs of triangles that cross, without those that share a point."""

from __future__ import annotations

from typing import Any

import numpy as np

from vitruvian.body.types import Floats, Ints

EASED = 12  # rounds of smoothing where a surface crosses itself
REACH = 0.03  # metres round a crossing in which others may come of it


def crossings(points: Floats, triangles: Ints) -> Ints:
    """(n,2) pairs of triangles (t,3) of points (v,3) that cross each other, told with exact arithmetic."""
    from igl.predicates import find_self_intersections

    corners = np.ascontiguousarray(triangles, dtype=np.int64)
    found = find_self_intersections(np.ascontiguousarray(points, dtype=np.float64), corners)[1]
    pairs = np.asarray(found, np.int32).reshape(-1, 2)
    shared = (triangles[pairs[:, 0], :, None] == triangles[pairs[:, 1], None, :]).any(axis=(1, 2))
    return pairs[~shared]


def uncrossed(
    plain: Floats, shaped: Floats, triangles: Ints, movable: Any, own: Floats | None = None, rounds: int = 3
) -> Floats:
    """The shaped points (v,3) without crossings that the surface has not of its own, as far as that goes.

    Where triangles of `movable` parts (v,) cross, their corners give way to the middle of their neighbours, round by round:
    thighs that touch and creases that turn over come apart. Where that is not enough, such parts come nearer to the plain
    points (v,3). `own` (v,3): positions whose crossings are the surface's own; the plain ones when None.
    """
    from vitruvian.modeling.shrink import laplacian

    near = (abs(laplacian(plain, triangles)) > 0).astype(np.float64)
    count = np.maximum(np.asarray(near.sum(axis=1)).ravel(), 1)
    worn = crossings(plain, triangles)
    known = _keys(worn if own is None else crossings(own, triangles))
    points, now = _eased(shaped, triangles, known, near, movable)
    movable = movable & ~_ring(worn, known, triangles, near)  # plain points that cross are no help
    shaped, share = points, np.ones(len(plain))
    for _ in range(rounds):
        some = _ring(now, known, triangles, near)
        if not (some & movable).any():
            break
        share[some & movable] *= 0.5
        soft = share
        for _ in range(2):
            soft = np.minimum(share, (near @ soft) / count)
        points = plain + soft[:, None] * (shaped - plain)
        now = crossings(points, triangles)
    return points


def _eased(points: Floats, triangles: Ints, known: Any, near: Any, movable: Any) -> tuple[Floats, Ints]:
    """Of the points that smoothing where triangles cross leads through, those that leave the fewest crossings (n,2)."""
    from scipy.spatial import cKDTree

    found = crossings(points, triangles)
    fresh = found[~np.isin(_keys(found), known)]
    if not movable[triangles[fresh]].any():
        return points, found
    middle = points[triangles].mean(axis=1)
    away = cKDTree(middle[np.unique(fresh)]).query(middle, distance_upper_bound=REACH)[0]
    some = np.flatnonzero(away < REACH).astype(np.int32)  # only these can come to cross, or cease to
    best, least, now = points, len(fresh), points
    for _ in range(EASED):
        moved = np.unique(triangles[fresh])
        moved = moved[movable[moved]]
        if not len(moved):
            break
        mean = (near[moved] @ now) / np.asarray(near[moved].sum(axis=1)).reshape(-1, 1)
        now = now.copy()
        now[moved] = (now[moved] + mean) / 2
        pairs = some[crossings(now, triangles[some])]
        fresh = pairs[~np.isin(_keys(pairs), known)]
        if len(fresh) < least:
            best, least = now, len(fresh)
    return best, crossings(best, triangles)


def _ring(pairs: Ints, known: Any, triangles: Ints, near: Any) -> Any:
    """(v,) the corners of triangles in crossings (n,2) that are not among the known, and what is next to these."""
    fresh = pairs[~np.isin(_keys(pairs), known)]
    some = np.zeros(near.shape[0], bool)
    some[triangles[fresh].ravel()] = True
    return some | ((near @ some) > 0)


def _keys(pairs: Ints) -> Any:
    """(n,) one number for each pair, whichever way round it is."""
    low, high = np.sort(pairs.astype(np.int64), axis=1).T
    return low * (1 << 32) + high
