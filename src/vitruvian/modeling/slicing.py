"""Loops of points where planes meet a surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Whole = NDArray[np.int64]
_LAYERS = 2.2  # loops round the same bone are layers of clothes up to this many times the radius of the innermost
_RAYS = np.arange(7) * 2 * np.pi / 7 + 0.1


@dataclass(frozen=True, eq=False)
class Rings:
    """Loops of points on a surface. points (C,P,3), counter-clockwise seen from the top (against the axis).

    face (C,P): the triangle of the skin that each point lies on, -1 where none was met; barycentric (C,P,3).
    """

    points: Floats
    face: Whole
    barycentric: Floats

    @property
    def radius(self) -> float:
        """The middle one of all points' distances from the middles of their loops, m."""
        return float(np.median(np.linalg.norm(self.points - self.points.mean(axis=1, keepdims=True), axis=2)))


@dataclass(frozen=True, eq=False)
class Section:
    """Where a plane meets triangles: segments (S,2,2) in the plane's own coordinates, from its centre.

    face (S,): the triangle of each. loop (S,): which connected line it belongs to; `size` (L,) the mean distance of each
    line's points from the centre.
    """

    segments: Floats
    face: Whole
    loop: Whole
    size: Floats

    @property
    def round(self) -> Whole:
        """The loops that go round the centre and are not much wider than the innermost: a limb and its clothes."""
        some = np.flatnonzero(self.around(np.zeros(2)))
        return some[self.size[some] <= _LAYERS * self.size[some].min()] if len(some) else some

    def holds(self, place: Floats) -> bool:
        """Whether one of the loops that go round the centre goes round `place` (2,) too."""
        return bool(self.around(place)[self.round].any())

    def around(self, place: Floats) -> NDArray[np.bool_]:
        """(L,) which loops go round a place: most rays from it cross them an odd number of times, however faces turn."""
        a, b = self.segments[:, 0] - place, self.segments[:, 1] - place
        odd = np.zeros(len(self.size))
        for angle in _RAYS:
            c, s = np.cos(angle), np.sin(angle)
            before, after = c * a[:, 1] - s * a[:, 0], c * b[:, 1] - s * b[:, 0]
            gap = before - after
            t = before / np.where(gap == 0, 1, gap)
            ahead = c * (a[:, 0] + t * (b[:, 0] - a[:, 0])) + s * (a[:, 1] + t * (b[:, 1] - a[:, 1]))
            hit = ((before >= 0) != (after >= 0)) & (ahead > 0)
            odd += np.bincount(self.loop[hit], minlength=len(self.size)) % 2
        return np.asarray(odd > len(_RAYS) / 2)


def frames(axis: Floats, forward: Floats) -> tuple[Floats, Floats]:
    """For unit `axis` (C,3), pointing down the limb: unit directions in the plane, (C,3) first and (C,3) second.

    The first is `forward` laid into the plane; from it to the second is counter-clockwise seen from the top.
    """
    first = forward - np.sum(axis * forward, axis=1, keepdims=True) * axis
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(-axis, first)


def section(rest: Floats, triangles: Ints, center: Floats, axis: Floats, forward: Floats) -> Section:
    """Where the plane through `center` across unit `axis` meets triangles (T,3). A point in the plane counts as above."""
    first, second = (d[0] for d in frames(axis[None], forward))
    height = (rest - center) @ axis
    side = (height >= 0)[triangles]
    cut = np.flatnonzero(side.any(axis=1) & ~side.all(axis=1))
    t, s = triangles[cut].astype(np.int64), side[cut]
    rows = np.arange(len(t))
    alone = np.argmax(s == (s.sum(axis=1) == 1)[:, None], axis=1)  # the corner on its own side
    ends = np.stack([t[rows, alone], t[rows, (alone + 1) % 3], t[rows, alone], t[rows, (alone + 2) % 3]], axis=1)
    ends = ends.reshape(-1, 2, 2)
    low, high = ends.min(axis=2), ends.max(axis=2)
    share = height[low] / (height[low] - height[high])
    where = rest[low] + share[..., None] * (rest[high] - rest[low]) - center
    flat = np.stack([where @ first, where @ second], axis=-1)
    if not len(t):
        return Section(flat, cut, np.zeros(0, np.int64), np.zeros(0))
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    keys, node = np.unique(low * len(rest) + high, return_inverse=True)
    node = node.reshape(-1, 2)
    graph = coo_array((np.ones(len(node)), (node[:, 0], node[:, 1])), shape=(len(keys), len(keys)))
    count, part = connected_components(graph, directed=False)
    loop = part[node[:, 0]].astype(np.int64)
    size = np.bincount(loop, np.linalg.norm(flat[:, 0], axis=1), minlength=count) / np.bincount(loop, minlength=count)
    return Section(flat, cut, loop, size)


def rings(
    rest: Floats,
    triangles: Ints,
    chosen: Whole,
    centers: Floats,
    axis: Floats,
    *,
    forward: Floats,
    angles: Floats,
    name: str = "surface",
    loose: bool = False,
) -> Rings:
    """Loops of points round `centers` (C,3), in the planes across unit `axis` (C,3), on the outermost surface.

    `chosen`: the triangles that may be met. `angles` (P,): directions in the planes, from `forward` on. Directions that
    meet nothing get the radius of their neighbours. `loose`: where no loop goes round a centre, whatever is there counts,
    as in surfaces of loose faces. Raises VitruvianError, naming the surface, when more than half of
    the planes meet no loop round their centre.
    """
    first, second = frames(axis, forward)
    count, each = len(centers), len(angles)
    ray = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    radius = np.full((count, each), np.nan)
    face = np.full((count, each), -1, np.int64)
    faces = triangles[chosen]
    for k in range(count):
        cut = section(rest, faces, centers[k], axis[k], forward)
        keep = np.isin(cut.loop, cut.round)
        if loose and not keep.any():
            keep = np.ones(len(cut.loop), bool)
        if not keep.any():
            continue
        a, b = cut.segments[keep, 0], cut.segments[keep, 1]
        beside = ray[:, :1] * a[None, :, 1] - ray[:, 1:] * a[None, :, 0]  # (P,S) where the ends lie beside the rays
        other = ray[:, :1] * b[None, :, 1] - ray[:, 1:] * b[None, :, 0]
        gap = beside - other
        t = np.clip(beside / np.where(np.abs(gap) > 1e-15, gap, 1), 0, 1)
        out = ray @ a.T + t * (ray @ (b - a).T)
        out = np.where((beside * other <= 0) & (np.abs(gap) > 1e-15), out, -1.0)
        best = np.argmax(out, axis=1)
        far = out[np.arange(each), best]
        radius[k] = np.where(far > 0, far, np.nan)
        face[k] = np.where(far > 0, chosen[cut.face[keep][best]], -1)
    empty = np.flatnonzero(np.isnan(radius).all(axis=1))
    if len(empty) > count // 2:
        raise VitruvianError(
            f"contours {name}: expected a surface around it, found none at {len(empty)} of {count} slices"
        )
    radius = _filled(radius)
    direction = ray[None, :, :1] * first[:, None] + ray[None, :, 1:] * second[:, None]
    where = centers[:, None] + radius[..., None] * direction
    weights = np.full((count, each, 3), 1 / 3)
    some = face >= 0
    weights[some] = barycentric(rest[triangles[face[some]]], where[some])
    return Rings(where, face, weights)


def _filled(radius: Floats) -> Floats:
    """Missing values from their neighbours round the loop; loops that are missing whole, from their neighbours."""
    out = radius.copy()
    each = radius.shape[1]
    for row in out:
        good = np.flatnonzero(np.isfinite(row))
        if 0 < len(good) < each:
            row[:] = np.interp(np.arange(each), good, row[good], period=each)
    whole = np.flatnonzero(np.isfinite(out[:, 0]))
    for k in np.flatnonzero(~np.isfinite(out[:, 0])):
        out[k] = out[whole[np.argmin(np.abs(whole - k))]] if len(whole) else 0.01
    return out


def carried(loops: Rings, values: Floats, corners: Ints) -> Floats:
    """(C,P,k) values (n,k), which triangles have at their corners (T,3), at the points of loops; where nothing was met
    those of the neighbours in the loop, or of the next loop."""
    some = loops.face >= 0
    out = np.zeros((*loops.face.shape, values.shape[1]))
    out[some] = np.einsum("nk,nkc->nc", loops.barycentric[some], values[corners[loops.face[some]]])
    each, whole = loops.face.shape[1], np.flatnonzero(some.any(axis=1))
    for k in range(len(out)):
        good = np.flatnonzero(some[k])
        for c in range(out.shape[2] if 0 < len(good) < each else 0):
            out[k, :, c] = np.interp(np.arange(each), good, out[k, good, c], period=each)
    for k in np.flatnonzero(~some.any(axis=1)).tolist() if len(whole) else ():
        out[k] = out[whole[np.argmin(np.abs(whole - k))]]
    return out


def cotangents(points: Floats, faces: Ints | Whole, low: float, high: float) -> csr_array:
    """(n,n) sparse, symmetric: for each edge of triangles (T,3) of points (n,3) the sum of the cotangents, kept within
    low..high, of the angles that face it. U. Pinkall, K. Polthier, "Computing discrete minimal surfaces" (1993)."""
    from scipy.sparse import csr_array

    start, stop, values = [], [], []
    for k in range(3):
        a, b, c = faces[:, k], faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        u, v = points[b] - points[a], points[c] - points[a]
        cross = np.linalg.norm(np.cross(u, v), axis=1)
        edge = b != c
        start.append(b[edge])
        stop.append(c[edge])
        values.append(np.clip((u * v).sum(axis=1) / np.maximum(cross, 1e-15), low, high)[edge])
    i, j, value = (np.concatenate(x) for x in (start, stop, values))
    links = csr_array((value, (i, j)), shape=(len(points), len(points)))
    return csr_array(links + links.T)


def barycentric(corners: Floats, points: Floats) -> Floats:
    """(n,3) of points (n,3) in triangles (n,3,3), clipped into the triangle."""
    a, b, p = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    aa, ab, bb = (a * a).sum(1), (a * b).sum(1), (b * b).sum(1)
    pa, pb = (p * a).sum(1), (p * b).sum(1)
    size = np.maximum(aa * bb - ab * ab, 1e-30)
    v, w = (bb * pa - ab * pb) / size, (aa * pb - ab * pa) / size
    out = np.clip(np.stack([1 - v - w, v, w], axis=1), 0, 1)
    return out / out.sum(axis=1, keepdims=True)
