"""Which parts of a surface took the wrong limb for their own: a skirt that a hanging hand is near, a sleeve at the waist.

Every point of the surface has a joint that it would go with. Neighbours whose joints are far apart along the bones tell a
leap; what lies between leaps is a region. Of the regions of one piece of surface those that are large and as near the
root as any belong to it. Source: note body.md, section 4, step 4 ("joints far from a vertex by graph distance").
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, Skeleton

LEAP = 0.55 / 1.6  # along the bones, over the height of the joints: an armpit's two sides are no farther apart
STEPS = 3  # bones between: coarse skeletons have long ones
LARGE, DEEP = 0.15, 0.1  # a region's share of its piece; and how much farther from the root, over the height, it may be


def strayed(known: NDArray[np.bool_], joint: Ints, points: Floats, triangles: Ints, skeleton: Skeleton) -> NDArray:
    """(n,) which of the `known` points (n,) of a surface, points (n,3) and triangles (t,3), go with the wrong limb.

    joint (n,): the joint of each point's largest weight; only those of known points count. Points at one place are one.
    Of every connected piece some known points stay.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    n, none = len(points), np.zeros(len(points), bool)
    tall = float(np.ptp(skeleton.centers[:, 1]))
    if not known.any() or not len(triangles) or tall <= 0:
        return none
    a, b = np.unique(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0).T
    length = np.linalg.norm(points[a] - points[b], axis=1)
    away, owner = _owners(a, b, length, known)
    along, bones = _paths(skeleton)
    reached = np.isfinite(away[a]) & np.isfinite(away[b])
    a, b, length = a[reached], b[reached], length[reached]
    mine, other = joint[owner[a]], joint[owner[b]]
    gap = length + away[a] + away[b]
    leap = (along[mine, other] > LEAP * tall + gap) & (bones[mine, other] >= STEPS)
    if not leap.any():
        return none

    def parts(some: NDArray[np.bool_]) -> Ints:
        pairs = csr_array((np.ones(int(some.sum())), (a[some], b[some])), shape=(n, n))
        return np.asarray(connected_components(pairs, directed=False)[1], np.int32)

    piece, region = parts(np.ones(len(a), bool)), parts(~leap)
    p, q, r = (points[triangles[:, k]] for k in range(3))
    area = np.bincount(triangles.ravel(), np.repeat(np.linalg.norm(np.cross(q - p, r - p), axis=1), 3), minlength=n)
    count = int(region.max()) + 1
    home = np.zeros(count, np.int64)
    home[region] = piece
    depth = along[int(np.argmax(skeleton.parents < 0)), joint]
    first = np.full(count, np.inf)
    np.minimum.at(first, region[known], depth[known])
    size = np.bincount(region, area, minlength=count)
    whole = np.bincount(home, size, minlength=int(piece.max()) + 1)[home]
    large = (size >= LARGE * whole) & np.isfinite(first)
    least = np.full(int(piece.max()) + 1, np.inf)
    np.minimum.at(least, home[large], first[large])
    stays = large & (first <= least[home] + DEEP * tall)
    stays |= np.isinf(least[home])  # many small regions: none of them is the one to believe
    return known & ~stays[region]


def _owners(a: Ints, b: Ints, length: Floats, known: NDArray[np.bool_]) -> tuple[Floats, Ints]:
    """(n,) how far along edges a, b (e,) the nearest known point is, and (n,) which one."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    n = len(known)
    links = csr_array((np.maximum(length, 1e-9), (a, b)), shape=(n, n))
    away, _, owner = dijkstra(
        links, directed=False, indices=np.flatnonzero(known), min_only=True, return_predecessors=True
    )
    return away, np.maximum(owner, 0)


def _paths(skeleton: Skeleton) -> tuple[Floats, Floats]:
    """(J,J) lengths along bones, metres, and how many bones that is."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import shortest_path

    count = len(skeleton)
    child = np.flatnonzero(skeleton.parents >= 0)
    parent = skeleton.parents[child]
    far = np.linalg.norm(skeleton.centers[child] - skeleton.centers[parent], axis=1)
    links = csr_array((np.maximum(far, 1e-9), (child, parent)), shape=(count, count))
    return shortest_path(links, directed=False), shortest_path(links, directed=False, unweighted=True)
