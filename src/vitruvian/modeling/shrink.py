"""Drawing a template onto a scan: which point of the scan each point of the surface means, and free offsets.

Correspondences are closest points on the scan's triangles, without those that are far, face another way, lie on the
border of a hole, or, in the first rounds, are among the worst twentieth. Offsets follow them as smoothly as a Laplacian
wants.
Sources: note body.md, section 3; B. Allen, B. Curless, Z. Popovic, "The space of human body shapes" (2003).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints
from vitruvian.modeling.slicing import barycentric, cotangents

if TYPE_CHECKING:
    from scipy.sparse import csr_array

WORST = 0.05
FADE = 4  # edges over which a step fades that would fold triangles
Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Scan:
    """A scan's surface: `vertices` (n,3) metres, `triangles` (t,3), unit `normals` (n,3), `border` (n,) at its holes."""

    vertices: Floats
    triangles: Ints
    normals: Floats
    border: Flags

    @cached_property
    def tree(self) -> Any:
        """For closest points."""
        import igl

        tree = igl.AABB()
        tree.init(self.vertices, self.corners)
        return tree

    @cached_property
    def corners(self) -> NDArray[np.int64]:
        """The triangles, as the tree wants them."""
        return self.triangles.astype(np.int64)

    def turned(self) -> Scan:
        """The same inside out."""
        return Scan(self.vertices, np.ascontiguousarray(self.triangles[:, ::-1]), -self.normals, self.border)


@dataclass(frozen=True, eq=False)
class Match:
    """For points (n): the closest point `goal` (n,3) of a scan, its `normal` (n,3), the `distance` (n,), which triangle
    `face` (n,) at which barycentric `share` (n,3), and whether it is `good`."""

    goal: Floats
    normal: Floats
    distance: Floats
    face: Ints
    share: Floats
    good: Flags


def surface_of(vertices: Floats, triangles: Ints) -> tuple[Scan, int]:
    """A scan for matching, of the points that triangles have; those of triangle soups are taken together where they are
    at one place. Also how many edges have more than two triangles."""
    used, corner = np.unique(triangles, return_inverse=True)
    place, same = np.unique(np.round(vertices[used], 7), axis=0, return_inverse=True)
    t = same.reshape(-1)[corner.reshape(-1, 3)]
    t = t[(t[:, 0] != t[:, 1]) & (t[:, 1] != t[:, 2]) & (t[:, 2] != t[:, 0])]
    edges = np.sort(t[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    keys, count = np.unique(edges[:, 0].astype(np.int64) * len(place) + edges[:, 1], return_counts=True)
    border = np.zeros(len(place), bool)
    open_ = keys[count == 1]
    border[open_ // max(len(place), 1)] = border[open_ % max(len(place), 1)] = True
    return Scan(place, t.astype(np.int32), vertex_normals(place, t), border), int((count > 2).sum())


def surface(points: Floats, triangles: Ints) -> Scan:
    """A surface that is whole and clean already, such as a template's."""
    return Scan(points, triangles, vertex_normals(points, triangles), np.zeros(len(points), bool))


def vertex_normals(points: Floats, triangles: Ints) -> Floats:
    """(n,3) unit normals of points, weighted by area."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    total = np.stack(
        [np.bincount(triangles.ravel(), np.repeat(face[:, k], 3), minlength=len(points)) for k in range(3)], axis=1
    )
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-20)


def closest(points: Floats, scan: Scan) -> tuple[Floats, Floats, Ints, Floats]:
    """Of points (n,3): distance (n,), closest point (n,3), its triangle (n,) and barycentric coordinates (n,3)."""
    squared, face, foot = scan.tree.squared_distance(scan.vertices, scan.corners, np.ascontiguousarray(points))[:3]
    face = np.asarray(face).reshape(-1).astype(np.int32)
    foot = np.asarray(foot, np.float64).reshape(-1, 3)
    return np.sqrt(np.asarray(squared).reshape(-1)), foot, face, barycentric(scan.vertices[scan.triangles[face]], foot)


def matches(
    points: Floats, normals: Floats, scan: Scan, *, distance: float | Floats, angle: float, worst: float = WORST
) -> Match:
    """The closest points of a scan to points (n,3) with unit normals (n,3); good within `distance` (m) and `angle`."""
    away, foot, face, share = closest(points, scan)
    corners = scan.triangles[face]
    normal = np.einsum("nk,nka->na", share, scan.normals[corners])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    edge = ((share > 1e-9) & scan.border[corners]).sum(axis=1) == (share > 1e-9).sum(axis=1)
    good = (away < distance) & ((normal * normals).sum(axis=1) > np.cos(angle)) & ~edge
    if good.any():
        good &= away <= np.quantile(away[good], 1 - worst)
    return Match(foot, normal, away, face, share, good)


def laplacian(points: Floats, triangles: Ints) -> Any:
    """(n,n) sparse: each point against the weighted mean of its neighbours, by cotangents."""
    from scipy.sparse import diags_array

    links = cotangents(points, triangles, 0.05, 5.0)
    total = np.asarray(links.sum(axis=1)).ravel()
    lonely = total <= 0
    return (diags_array(np.where(lonely, 0.0, 1.0)) - diags_array(1 / np.where(lonely, 1.0, total)) @ links).tocsr()


@dataclass(frozen=True, eq=False)
class Wish:
    """That means `vertex` (k,n) sparse of offsets shall be these (k,3), with one weight."""

    vertex: csr_array
    offset: Floats
    weight: float


def offsets(smooth: Any, pull: Floats, target: Floats, stiff: Floats, wishes: Sequence[Wish] = ()) -> Floats:
    """(n,3) the offsets u with least sum pull |u - target|^2 + stiff |L u|^2, L = `smooth`, plus the wishes' squares.

    pull, stiff (n,), target (n,3). One sparse factorisation serves all three axes.
    """
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    bend = diags_array(np.sqrt(stiff)) @ smooth
    left = diags_array(pull + 1e-9) + bend.T @ bend
    right = pull[:, None] * target
    for wish in wishes:
        left = left + wish.weight * (wish.vertex.T @ wish.vertex)
        right = right + wish.weight * (wish.vertex.T @ wish.offset)
    solver = splu(left.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return np.asarray(solver.solve(right))


def blend(corners: Ints, share: Floats, count: int) -> csr_array:
    """(n,count) sparse: the points of triangles with corners (n,3) and barycentric coordinates (n,3)."""
    from scipy.sparse import csr_array

    n = len(corners)
    return csr_array((share.ravel(), corners.ravel(), np.arange(0, 3 * n + 1, 3)), shape=(n, count))


def areas(points: Floats, triangles: Ints) -> Floats:
    """(n,) a third of the area of the triangles round each point, m2."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    face = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
    return np.bincount(triangles.ravel(), np.repeat(face, 3), minlength=len(points)).astype(np.float64)


def folds(before: Floats, after: Floats, triangles: Ints) -> Flags:
    """(t,) triangles whose normal has turned over between two positions of the points."""
    sides = []
    for p in (before, after):
        a, b, c = (p[triangles[:, k]] for k in range(3))
        sides.append(np.cross(b - a, c - a))
    return (sides[0] * sides[1]).sum(axis=1) <= 0


def unfolded(before: Floats, step: Floats, triangles: Ints, smooth: Any, rounds: int = 6) -> tuple[Floats, int]:
    """Positions (n,3) after a step (n,3) that is halved where it would fold triangles, and at last not taken there; and how
    many folds are left. Round such places the step fades: where it ended sharply, triangles would fold at its end."""
    share = np.ones(len(before))
    near = (abs(smooth) > 0).astype(np.float64)
    count = np.maximum(np.asarray(near.sum(axis=1)).ravel(), 1)
    after = before + step
    for k in range(4 * rounds):
        bad = folds(before, after, triangles)
        if not bad.any():
            return after, 0
        some = np.zeros(len(before))
        some[triangles[bad]] = 1
        share[(near @ some) > 0] *= 0.5 if k < rounds else 0.0
        soft = share
        for _ in range(FADE):
            soft = np.minimum(share, (near @ soft) / count)
        after = before + soft[:, None] * step
    return after, int(folds(before, after, triangles).sum())
