"""Offset Deformer: fine detail of a surface as displacements, per point and as pictures over its UVs.

Displacements are metres along the axes of the dress pose, or along the normal alone. Put on the body in the dress pose
they follow every pose as the skin does. The same picture fits the surface at other resolutions. Tangents of the UVs would
be the other choice of axes; they turn by half a circle between points that share a texel (in folds of lips, lids and
nails), which no picture of a reasonable size can hold: we measured 3 to 13 mm there, at 2048 texels.

Source: seed 003, table 1 "Offset Deformer", and its section 3.1: "a displacement map".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.seams import face_normals
from vitruvian.body.types import Floats, Ints, floats, indices, require
from vitruvian.deform.normals import normalized
from vitruvian.errors import VitruvianError, warn
from vitruvian.hanim.humanoid import Humanoid

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from vitruvian.modeling.fit import Fit

FAR = 0.05  # metres: what of a scan lies farther from the surface is not its detail
MOST = 0.75  # of a body's points: fewer that have something of a surface say that it stands otherwise
LEVELS = 65535
SIDES = (1024, 2048, 4096)  # texels
CLOSE = 2e-4  # metres that a point may read wrong
CELLS = 64  # a side: squares of the map by which surfaces with other UVs are told
STRAY = 0.1  # share of a body's UVs that may lie where a picture has none
SHARED = 1e-3  # of a texel's square: how far a picture goes to please points in one texel
CHUNK = 1 << 20  # texels drawn at once


@dataclass(frozen=True, eq=False)
class Chart:
    """A surface in the dress pose: points (V,3) m, triangles (T,3), uv (U,2) in 0..1 with its own uv_triangles (T,3).

    Points that no triangle uses may be there (those of clothes, or skin that clothes hide); nothing is drawn of them.
    """

    points: Floats
    triangles: Ints
    uv: Floats
    uv_triangles: Ints

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", floats(self.points, "points", None, 3))
        object.__setattr__(self, "triangles", indices(self.triangles, "triangles", len(self.points), None, 3))
        object.__setattr__(self, "uv", floats(self.uv, "uv", None, 2))
        corners = indices(self.uv_triangles, "uv_triangles", len(self.uv), len(self.triangles), 3)
        object.__setattr__(self, "uv_triangles", corners)
        require(len(self.triangles) > 0, "triangles", "one at least", "none")
        used = self.uv[corners.ravel()]
        beyond = used[((used < -1e-3) | (used > 1 + 1e-3)).any(axis=1)]
        require(not len(beyond), "uv", "places inside 0..1, on one picture", beyond[:1].tolist())

    @cached_property
    def _seen(self) -> tuple[NDArray[np.int64], Floats, NDArray[np.int64]]:
        point, uv = self.triangles.ravel(), self.uv[self.uv_triangles.ravel()]
        keys, corner = np.unique(np.column_stack([point, uv]), axis=0, return_inverse=True)
        return keys[:, 0].astype(np.int64), np.ascontiguousarray(keys[:, 1:]), corner.reshape(-1, 3)

    @property
    def point(self) -> NDArray[np.int64]:
        """(P,) of every place on the picture which point it is; on a seam a point has several places."""
        return self._seen[0]

    @property
    def place(self) -> Floats:
        """(P,2) texture coordinates of the places."""
        return self._seen[1]

    @property
    def corners(self) -> NDArray[np.int64]:
        """(T,3) the place at each corner of the triangles."""
        return self._seen[2]

    @cached_property
    def normals(self) -> Floats:
        """(V,3) unit normals of the points, one for those at the same place; zero where nothing is drawn."""
        weld = np.unique(self.points, axis=0, return_inverse=True)[1].reshape(-1)
        a, b, c = (self.points[self.triangles[:, k]] for k in range(3))
        sums = np.zeros(self.points.shape)
        for k in range(3):
            np.add.at(sums, weld[self.triangles[:, k]], np.cross(b - a, c - a))
        return normalized(sums)[weld]


def chart_of(humanoid: Humanoid) -> Chart:
    """The skin of a body, its first shape, in the dress pose; VitruvianError where it has no seamless skin with UVs."""
    for shape in humanoid.skin[:1]:
        if shape.points is None and shape.uv is not None:
            corners = shape.triangles if shape.uv_triangles is None else shape.uv_triangles
            return Chart(humanoid.skin_coord, shape.triangles, shape.uv, corners)
    raise VitruvianError(f"{humanoid.name}: expected a seamless skin with UVs, on which displacements live; found none")


@dataclass(frozen=True, eq=False)
class Relief:
    """A picture of displacements: texels (H,W,3) along x, y, z, or (H,W,1) along the normal, 16 bits.

    Metres are `offset + scale * texel`; rows go down from v = 1. Beyond the borders of the map's parts it is padded.
    `covered` (CELLS,CELLS): the squares of the map, v upward, that the surface lies on.
    """

    texels: NDArray[np.uint16]
    scale: float
    offset: float
    covered: NDArray[np.bool_]


def nearest(chart: Chart, points: Floats, triangles: Ints) -> tuple[Floats, NDArray[np.bool_]]:
    """(V,3) for every point of the surface the nearest one of another, such as a scan in its pose (m), and (V,) whether
    there is one: within 5 cm, facing the same way. Where not, or where nothing is drawn, it is the point itself."""
    import igl

    require(len(triangles) > 0, "target", "a surface with triangles", "none")
    faces = np.ascontiguousarray(triangles, np.int64)
    squared, face, y = igl.point_mesh_squared_distance(chart.points, np.asarray(points, np.float64), faces)
    facing = np.sum(normalized(face_normals(points, triangles))[face] * chart.normals, axis=1) > 0.5
    good = (np.asarray(squared) < FAR**2) & facing
    return np.where(good[:, None], y, chart.points), good


def captured(base: Humanoid, target: Humanoid | Floats, triangles: Ints | None = None) -> Floats:
    """(V,3) displacements (m, axes of the dress pose) from the skin of a body to another surface in the same pose.

    `target`: the same body with detail, point by point; or any other body, or points (n,3) and `triangles` (t,3) of a
    surface, by their nearest points. Raises VitruvianError where next to nothing of it is near.
    """
    chart = chart_of(base)
    if isinstance(target, Humanoid):
        require(bool(target.skin), f"{target.name}: skin", "a seamless one", "none")
        points, faces = target.skin_coord, target.skin[0].triangles
        if points.shape == chart.points.shape and np.array_equal(faces, chart.triangles):
            return _drawn_only(chart, points - chart.points)
    else:
        require(triangles is not None, "triangles", "those of the target", "none")
        points = floats(target, "target", None, 3)
        faces = indices(triangles, "triangles", len(points), None, 3)
    y, found = nearest(chart, points, faces)
    share = float(found[chart.point].mean())
    if share < 0.1:
        raise VitruvianError(
            f"target: expected a surface on the body, in metres, in its pose; only {share:.0%} of the body's points have "
            f"something of it within {100 * FAR:g} cm"
        )
    if share < MOST:
        bare = f"{1 - share:.0%} of the body's points have nothing of it within {100 * FAR:g} cm; they stay"
        warn(f"target: {bare}; is it in the body's pose?")
    return _drawn_only(chart, y - chart.points)


def detail(fit: Fit) -> Floats:
    """(V,3) displacements (m, axes of the dress pose) that a fit leaves between its body and the scan; 0 where no scan
    answers. They are taken in the scan's pose and turned with the skin into the dress pose."""
    from vitruvian.body.kinematics import joint_matrices
    from vitruvian.body.pack import pack
    from vitruvian.deform.deformer import deformer

    turned = deformer("log", pack(fit.humanoid)).frames(joint_matrices(fit.pose.skeleton, fit.pose))[0]
    out = np.zeros(fit.humanoid.skin_coord.shape)
    count = len(fit.displacement)
    out[:count] = np.linalg.solve(turned[:count, :, :3], np.nan_to_num(fit.displacement)[:, :, None])[:, :, 0]
    return _drawn_only(chart_of(fit.humanoid), out)


def _drawn_only(chart: Chart, displacement: Floats) -> Floats:
    out = np.zeros(displacement.shape)
    out[chart.point] = displacement[chart.point]
    return out


def displaced(humanoid: Humanoid, relief: Relief, *, strength: float = 1.0) -> Humanoid:
    """The body with the displacements of a picture, `strength` 0..1 of them; at seams by the mean of both sides.

    Clothes, hair and what they hide stay as they are. Raises VitruvianError for a picture over other UVs.
    """
    require(0 <= strength <= 1, "strength", "a number in 0..1", strength)
    out = humanoid.copied()
    out.skin_coord = humanoid.skin_coord + strength * sampled(chart_of(humanoid), relief)
    out.made_from = None
    out.skin_normal = None
    return out


def drawn(
    chart: Chart,
    displacement: Floats,
    *,
    size: int | None = None,
    normal_only: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Relief:
    """Displacements (V,3) m as a picture over the UVs, padded beyond the borders of the map's parts.

    `size`: texels a side, 16..4096; None: the least of 1024, 2048 and 4096 that keeps every point within 0.2 mm, for
    points that lie closer than texels can't each have what is theirs. Warns where the picture is farther off.
    `progress` is called with sizes tried and in all.
    """
    require(size is None or 16 <= size <= SIDES[-1], "size", f"16..{SIDES[-1]} texels", size)
    d = floats(displacement, "displacement", len(chart.points), 3)
    if normal_only:
        d = np.sum(d * chart.normals, axis=1, keepdims=True)
    sides = SIDES if size is None else (size,)
    for k, side in enumerate(sides):
        if progress is not None:
            progress(k, len(sides))
        relief = _relief(chart, d, side)
        off = np.linalg.norm(_read(chart, relief) - d[chart.point], axis=1)
        if off.max() <= CLOSE:
            return relief
    warn(
        f"picture of {side} texels: {(off > CLOSE).mean():.1%} of the points are more than {CLOSE * 1e3:g} mm off, "
        f"{off.max() * 1e3:.2f} mm at most: they lie closer than texels, or parts of the map overlap"
    )
    return relief


def _relief(chart: Chart, d: Floats, size: int) -> Relief:
    from scipy.ndimage import distance_transform_edt

    field, known = _filled(chart, d[chart.point], size)
    require(bool(known.any()), "uv", f"parts that cover texels of a picture of {size}", "none")
    rows, columns = distance_transform_edt(~known, return_distances=False, return_indices=True)
    field = _matched(chart, field[rows, columns], d[chart.point])
    least, most = float(field.min()), float(field.max())
    scale = (most - least) / LEVELS
    texels = np.zeros(field.shape) if scale == 0 else (field - least) / scale
    return Relief(np.rint(texels).astype(np.uint16), scale, least, _cells(chart))


def _filled(chart: Chart, values: Floats, size: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Values (P,C) of the places drawn triangle by triangle: a field (H,W,C), and (H,W) where it is known."""
    field, known = np.zeros((size * size, values.shape[1])), np.zeros(size * size, bool)
    corner = np.stack([chart.place[:, 0] * size - 0.5, (1 - chart.place[:, 1]) * size - 0.5], axis=1)[chart.corners]
    low = np.clip(np.ceil(corner.min(axis=1)), 0, size).astype(np.int64)
    wide = np.maximum(np.clip(np.floor(corner.max(axis=1)) + 1, 0, size).astype(np.int64) - low, 0)
    (ax, ay), (bx, by), (cx, cy) = corner[:, 0].T, corner[:, 1].T, corner[:, 2].T
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    count = np.where(np.abs(area) > 1e-12, wide.prod(axis=1), 0)
    for part in np.split(np.arange(len(corner)), np.flatnonzero(np.diff(np.cumsum(count) // CHUNK)) + 1):
        t = np.repeat(part, count[part])
        n = np.arange(len(t)) - np.repeat(np.cumsum(count[part]) - count[part], count[part])
        x, y = low[t, 0] + n % wide[t, 0], low[t, 1] + n // wide[t, 0]
        dx, dy = x - ax[t], y - ay[t]
        s = (dx * (cy - ay)[t] - dy * (cx - ax)[t]) / area[t]
        r = ((bx - ax)[t] * dy - (by - ay)[t] * dx) / area[t]
        inside = (s >= -1e-9) & (r >= -1e-9) & (s + r <= 1 + 1e-9)
        texel = (y * size + x)[inside]
        share = np.stack([1 - s - r, s, r], axis=1)[inside]
        field[texel] = np.einsum("tk,tkc->tc", share, values[chart.corners[t[inside]]])
        known[texel] = True
    return field.reshape(size, size, -1), known.reshape(size, size)


def sampled(chart: Chart, relief: Relief) -> Floats:
    """(V,3) displacements m of a surface's points by a picture, bilinear; means of a point's places at seams.

    Raises VitruvianError where the surface has other UVs than the one that the picture was made on.
    """
    from scipy.ndimage import binary_dilation

    own = _cells(chart)  # finer surfaces have corners where coarser ones have none: neighbours count
    stray = float((own & ~binary_dilation(relief.covered)).sum() / own.sum())
    where = f"nothing below {stray:.0%} of the body's UVs: it is of another body, or of one that shows less skin"
    require(stray <= STRAY, "picture", "one captured over the UVs of this body", where)
    read, total = _read(chart, relief), np.zeros(chart.points.shape)
    np.add.at(total, chart.point, read if read.shape[1] == 3 else read * chart.normals[chart.point])
    return total / np.maximum(np.bincount(chart.point, minlength=len(total)), 1)[:, None]


def _read(chart: Chart, relief: Relief) -> Floats:
    """(P,C) metres that places read."""
    height, width, channels = relief.texels.shape
    return relief.offset + relief.scale * (_taps(chart, height, width) @ relief.texels.reshape(-1, channels))


def _cells(chart: Chart) -> NDArray[np.bool_]:
    """(CELLS,CELLS) squares of the map with corners or middles of triangles in them."""
    at = np.concatenate([chart.place, chart.place[chart.corners].mean(axis=1)]) * CELLS
    x, y = np.clip(at, 0, CELLS - 1).astype(int).T
    out = np.zeros((CELLS, CELLS), bool)
    out[y, x] = True
    return out


def _taps(chart: Chart, height: int, width: int) -> csr_array:
    """(P, texels) matrix that samples a picture at the places, bilinear."""
    from scipy.sparse import csr_array

    x = np.clip(chart.place[:, 0] * width - 0.5, 0, width - 1)
    y = np.clip((1 - chart.place[:, 1]) * height - 0.5, 0, height - 1)
    i, j = np.minimum(y.astype(int), height - 2), np.minimum(x.astype(int), width - 2)
    r, s = y - i, x - j
    values = np.concatenate([(1 - r) * (1 - s), (1 - r) * s, r * (1 - s), r * s])
    texel = np.concatenate([i * width + j, i * width + j + 1, (i + 1) * width + j, (i + 1) * width + j + 1])
    count = len(chart.place)
    return csr_array((values, (np.tile(np.arange(count), 4), texel)), shape=(count, height * width))


def _matched(chart: Chart, field: Floats, d: Floats) -> Floats:
    """The picture (H,W,C) changed least so that places read their displacements (P,C): triangles smaller than texels
    leave no mark in it otherwise. Places in one texel can't all have their way: they share what is wrong. Texels stay
    within twice the range of what they hold, so that surfaces of other resolutions read nothing wild."""
    from scipy.sparse import identity
    from scipy.sparse.linalg import splu

    taps = _taps(chart, *field.shape[:2])
    texels = field.reshape(-1, field.shape[2])
    near = np.unique(taps.indices)
    some = taps[:, near]
    normal = (some.T @ some + SHARED * identity(len(near))).tocsc()
    texels = texels.copy()
    texels[near] += splu(normal, permc_spec="MMD_AT_PLUS_A").solve(some.T @ (d - taps @ texels))
    least, most = d.min(axis=0), d.max(axis=0)
    room = (most - least) / 2
    return np.clip(texels, least - room, most + room).reshape(field.shape)
