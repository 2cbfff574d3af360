"""A skin with some of its points, in another order: all that is stored per point follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vitruvian.body.types import Floats, Ints, require
from vitruvian.hanim.humanoid import Displacer, Humanoid, Shape, Track


def chosen(humanoid: Humanoid, rows: Ints) -> Humanoid:
    """A copy whose skin points are `rows` (n,) of the old ones, in that order, each at most once.

    Weights, displacers, colours, normals, texture coordinates, binding coordinates and animated points follow, all to the
    bit; triangles that lose a point go. Points are metres in humanoid space. Raises VitruvianError for rows that are not
    points of the skin or come twice.
    """
    count = len(humanoid.skin_coord)
    rows = np.asarray(rows, np.int32)
    place = np.full(count, -1, np.int64)
    fits = rows.ndim == 1 and (not len(rows) or (rows.min() >= 0 and rows.max() < count))
    require(bool(fits), "rows", f"numbers of skin points, 0 to {count - 1}", rows.max() if rows.size else rows.shape)
    place[rows] = np.arange(len(rows))
    require(int((place >= 0).sum()) == len(rows), "rows", "each point at most once", f"{len(rows)} with doubles")
    out = humanoid.copied()
    out.skin_coord = np.asarray(humanoid.skin_coord)[rows]
    for name in ("skin_normal", "skin_binding_coords", "skin_binding_normals"):
        values = getattr(humanoid, name)
        setattr(out, name, values[rows] if values is not None and len(values) == count else None)
    out.skin = [s if s.points is not None else _shape(s, rows, place) for s in humanoid.skin]
    for joint in out.joints():
        n = min(len(joint.skin_coord_index), len(joint.skin_coord_weight))
        short = len(joint.skin_coord_weight) < len(joint.skin_coord_index) and n
        index, weight = np.asarray(joint.skin_coord_index), np.asarray(joint.skin_coord_weight)
        if short:  # browsers use the last weight for the rest
            weight = np.concatenate([weight, np.full(len(index) - n, weight[-1])])
        elif not n and len(index):
            weight = np.ones(len(index))
        new = _placed(index, place)
        kept = new >= 0
        joint.skin_coord_index, joint.skin_coord_weight = new[kept].astype(np.int32), weight[: len(index)][kept]
        joint.displacers = [d for d in (_displacer(d, place) for d in joint.displacers) if len(d.coord_index)]
    out.skin_displacers = [d for d in (_displacer(d, place) for d in humanoid.skin_displacers) if len(d.coord_index)]
    out.tracks = [_track(t, rows, count) for t in humanoid.tracks]
    return out


def _placed(index: Ints, place: np.ndarray) -> np.ndarray:
    """New numbers of points, -1 for those that are gone and for numbers that no point has."""
    number = np.asarray(index).reshape(-1)
    inside = (number >= 0) & (number < len(place))
    return np.where(inside, place[np.where(inside, number, 0)], -1) if len(place) else np.full(len(number), -1)


def _shape(shape: Shape, rows: Ints, place: np.ndarray) -> Shape:
    faces = np.asarray(shape.triangles, np.int64)
    kept = (place[faces] >= 0).all(axis=1) if len(faces) else np.zeros(0, bool)
    of_points = shape.uv is not None and shape.uv_triangles is None
    some = lambda a: None if a is None else a[kept]  # noqa: E731
    normals = shape.normals
    if normals is not None and shape.normal_triangles is None:
        normals = _rows(normals, rows, 0.0)
    return replace(
        shape,
        triangles=place[faces[kept]].astype(np.int32),
        uv=_rows(shape.uv, rows, 0.0) if of_points and shape.uv is not None else shape.uv,
        uv_triangles=some(shape.uv_triangles),
        colors=None if shape.colors is None else _rows(shape.colors, rows, 0.8),
        normals=normals,
        normal_triangles=some(shape.normal_triangles),
        faces=some(shape.faces),
        node=None,
    )


def _rows(values: Floats, rows: Ints, fill: float) -> Floats:
    """Rows of an array that may be shorter than the skin where its last points have no use for it."""
    short = int(rows.max(initial=-1)) + 1 - len(values)
    if short > 0:
        values = np.concatenate([values, np.full((short, values.shape[1]), fill)])
    return values[rows]


def _displacer(d: Displacer, place: np.ndarray) -> Displacer:
    n = min(len(d.coord_index), len(d.displacements))
    new = _placed(d.coord_index[:n], place)
    kept = new >= 0
    return replace(d, coord_index=new[kept].astype(np.int32), displacements=d.displacements[:n][kept], node=None)


def _track(track: Track, rows: Ints, count: int) -> Track:
    """Animated points of the skin; other tracks as they are."""
    if track.target or track.field != "point" or track.values.shape[-1] != 3 * count:
        return track
    values = track.values.reshape(len(track.values), count, 3)[:, rows]
    return replace(track, values=values.reshape(len(values), -1))
