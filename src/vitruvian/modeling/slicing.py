"""Cutting a surface: loops of points where planes meet it, and what lies on one side of a plane."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, Part, Skin, Weights
from vitruvian.errors import VitruvianError

Whole = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Rings:
    """Loops of points on a surface. points (C,P,3), counter-clockwise seen from the top (against the axis).

    face (C,P): the triangle of the skin that each point lies on, -1 where the ray met nothing; barycentric (C,P,3).
    """

    points: Floats
    face: Whole
    barycentric: Floats


def frames(axis: Floats, forward: Floats) -> tuple[Floats, Floats]:
    """For unit `axis` (C,3), pointing down the limb: unit directions in the plane, (C,3) first and (C,3) second.

    The first is `forward` laid into the plane; from it to the second is counter-clockwise seen from the top.
    """
    first = forward - np.sum(axis * forward, axis=1, keepdims=True) * axis
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(-axis, first)


def rings(
    rest: Floats,
    triangles: Ints,
    chosen: Whole,
    centers: Floats,
    axis: Floats,
    *,
    points: int,
    reach: float,
    forward: Floats,
    angles: Floats | None = None,
    walls: list[tuple[Floats, Floats]] | None = None,
    roundness: float = 1.8,
    name: str = "surface",
) -> Rings:
    """Loops of `points` points round `centers` (C,3), in the planes across `axis` (C,3), on the outermost surface.

    `chosen`: the triangles that may be met; `reach` (m): how far out to look. A second look goes no further than
    `roundness` times the loop's median radius, so that a neighbour is not taken for the limb. `walls` (point, outward
    normal): no point goes beyond them. Directions that meet nothing get the radius of their neighbours in the loop.
    `angles` (P,): directions other than evenly round from `forward`. Raises VitruvianError, naming the surface, when
    more than half of the slices meet nothing.
    """
    from trimesh import Trimesh
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    around = np.arange(points) * 2 * np.pi / points if angles is None else angles
    first, second = frames(axis, forward)
    direction = np.cos(around)[None, :, None] * first[:, None] + np.sin(around)[None, :, None] * second[:, None]
    count, each = direction.shape[:2]
    mesh = Trimesh(rest, triangles[chosen], process=False)
    caster = RayMeshIntersector(mesh)
    limit = np.full((count, each), reach)
    for point, normal in walls or []:
        toward = direction @ normal
        away = np.einsum("cd,d->c", point - centers, normal)[:, None]
        hit = np.where(toward > 1e-9, away / np.where(toward > 1e-9, toward, 1), np.inf)
        limit = np.minimum(limit, np.maximum(hit, 0.0))
    origin = np.repeat(centers[:, None], each, axis=1)
    radius = np.full((count, each), np.nan)
    face = np.full((count, each), -1, np.int64)
    bound = limit
    for _ in range(2):
        start = origin + bound[..., None] * direction
        met = caster.intersects_first(start.reshape(-1, 3), -direction.reshape(-1, 3)).reshape(count, each)
        corner = rest[triangles[chosen[np.maximum(met, 0)]]]
        normal = np.cross(corner[..., 1, :] - corner[..., 0, :], corner[..., 2, :] - corner[..., 0, :])
        along = np.sum(direction * normal, axis=-1)
        distance = np.sum((corner[..., 0, :] - origin) * normal, axis=-1) / np.where(
            np.abs(along) > 1e-15, along, np.nan
        )
        good = (met >= 0) & (distance > 1e-4) & (distance <= bound + 1e-6)
        radius = np.where(good, distance, np.nan)
        face = np.where(good, chosen[np.maximum(met, 0)], -1)
        middle = np.nanmedian(np.where(good, distance, np.nan), axis=1, keepdims=True)
        bound = np.minimum(limit, np.nan_to_num(roundness * middle, nan=reach))
    empty = np.flatnonzero(np.isnan(radius).all(axis=1))
    if len(empty) > count // 2:
        raise VitruvianError(
            f"contours {name}: expected a surface around it, found none at {len(empty)} of {count} slices"
        )
    walled = np.isnan(radius) & (limit < reach - 1e-9)
    radius = np.where(walled, np.minimum(limit, bound), radius)
    radius = _filled(radius)
    where = origin + radius[..., None] * direction
    weights = np.full((count, each, 3), 1 / 3)
    some = face >= 0
    weights[some] = _barycentric(rest[triangles[face[some]]], where[some])
    return Rings(where, face, weights)


def joined(upper: Rings, lower: Rings) -> Rings:
    """The loops of one after those of the other."""
    return Rings(
        np.concatenate([upper.points, lower.points]),
        np.concatenate([upper.face, lower.face]),
        np.concatenate([upper.barycentric, lower.barycentric]),
    )


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


def _barycentric(corners: Floats, points: Floats) -> Floats:
    """(n,3) of points (n,3) in triangles (n,3,3), clipped into the triangle."""
    a, b, p = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    aa, ab, bb = (a * a).sum(1), (a * b).sum(1), (b * b).sum(1)
    pa, pb = (p * a).sum(1), (p * b).sum(1)
    size = np.maximum(aa * bb - ab * ab, 1e-30)
    v, w = (bb * pa - ab * pb) / size, (aa * pb - ab * pa) / size
    out = np.clip(np.stack([1 - v - w, v, w], axis=1), 0, 1)
    return out / out.sum(axis=1, keepdims=True)


def clipped(skin: Skin, distance: Floats, whole: NDArray[np.bool_]) -> tuple[Skin, NDArray[np.bool_]]:
    """The part of a skin where `distance` (V,) is positive or zero, and (V',) which of its vertices lie on the cut.

    Triangles across the cut are divided, with positions, weights, colours and texture coordinates in proportion.
    `whole` (T,): triangles that are kept as they are. Morphs keep the vertices that are left.
    """
    d = np.where(np.abs(distance) < 1e-7, 0.0, distance)
    keep: list[Ints] = []
    keep_uv: list[Ints] = []
    parts: list[Part] = []
    edges: dict[tuple[int, int], int] = {}
    uv_edges: dict[tuple[int, int, int, int], int] = {}
    uv_triangles = skin.triangles if skin.uv_triangles is None else skin.uv_triangles
    total = 0
    for part in skin.parts:
        these = np.arange(part.start, part.stop)
        t, u = skin.triangles[these], uv_triangles[these]
        inside = (d[t] >= 0).sum(axis=1)
        full = whole[these] | ((inside == 3) & ~(d[t] == 0).all(axis=1))
        new, new_uv = [t[full]], [u[full]]
        cut = ~full & (inside > 0) & (inside < 3) & (d[t].max(axis=1) > 0)
        more, more_uv = _divided(t[cut], u[cut], d, edges, uv_edges, len(d), 0 if skin.uv is None else len(skin.uv))
        new.append(more)
        new_uv.append(more_uv)
        count = sum(len(x) for x in new)
        if count:
            parts.append(replace(part, start=total, stop=total + count))
            keep += new
            keep_uv += new_uv
            total += count
    triangles = np.concatenate(keep) if keep else np.zeros((0, 3), np.int32)
    corners = np.concatenate(keep_uv) if keep_uv else np.zeros((0, 3), np.int32)
    pairs = np.array(list(edges), np.int64).reshape(-1, 2)
    share = d[pairs[:, 0]] / (d[pairs[:, 0]] - d[pairs[:, 1]]) if len(pairs) else np.zeros(0)
    between = lambda values, ij, s: values[ij[:, 0]] + s[:, None] * (values[ij[:, 1]] - values[ij[:, 0]])  # noqa: E731
    rest = np.concatenate([skin.rest, between(skin.rest, pairs, share)])
    used = np.unique(triangles)
    place = np.full(len(rest), -1, np.int64)
    place[used] = np.arange(len(used))
    weights = _weights(skin.weights, pairs, share, place, len(used))
    uv = out_uv = None
    if skin.uv is not None:
        uv_pairs = np.array(list(uv_edges), np.int64).reshape(-1, 4)
        s = d[uv_pairs[:, 2]] / (d[uv_pairs[:, 2]] - d[uv_pairs[:, 3]]) if len(uv_pairs) else np.zeros(0)
        every = np.concatenate([skin.uv, between(skin.uv, uv_pairs[:, :2], s)])
        named, flat = np.unique(corners, return_inverse=True)
        uv, out_uv = every[named], flat.reshape(-1, 3).astype(np.int32)
    colors = None
    if skin.colors is not None:
        colors = np.concatenate([skin.colors, between(skin.colors, pairs, share)])[used]
    morphs = []
    for m in skin.morphs:
        left = place[m.index] >= 0
        if left.any():
            morphs.append(replace(m, index=place[m.index[left]].astype(np.int32), offset=m.offset[left]))
    on_cut = np.concatenate([d == 0, np.ones(len(pairs), bool)])[used]
    part_skin = Skin(
        rest[used], place[triangles].astype(np.int32), weights, uv, out_uv, colors, tuple(parts), tuple(morphs)
    )
    return part_skin, on_cut


def _divided(
    t: Ints,
    u: Ints,
    d: Floats,
    edges: dict[tuple[int, int], int],
    uv_edges: dict[tuple[int, int, int, int], int],
    points: int,
    coordinates: int,
) -> tuple[Ints, Ints]:
    """Triangles across the cut as what is left of them; new vertices are numbered from `points` on."""
    out, out_uv = [], []
    for tri, uv in zip(t.tolist(), u.tolist(), strict=True):
        polygon: list[tuple[int, int]] = []
        for i in range(3):
            a, b, ua, ub = tri[i], tri[(i + 1) % 3], uv[i], uv[(i + 1) % 3]
            if d[a] >= 0:
                polygon.append((a, ua))
            if d[a] * d[b] < 0:
                if a > b:
                    a, b, ua, ub = b, a, ub, ua
                new = points + edges.setdefault((a, b), len(edges))
                new_uv = coordinates + uv_edges.setdefault((ua, ub, a, b), len(uv_edges))
                polygon.append((new, new_uv))
        for i in range(1, len(polygon) - 1):
            out.append([polygon[0][0], polygon[i][0], polygon[i + 1][0]])
            out_uv.append([polygon[0][1], polygon[i][1], polygon[i + 1][1]])
    return np.array(out, np.int32).reshape(-1, 3), np.array(out_uv, np.int32).reshape(-1, 3)


def _weights(weights: Weights, pairs: Whole, share: Floats, place: Whole, count: int) -> Weights:
    vertex, joint, value = [weights.vertex.astype(np.int64)], [weights.joint], [weights.weight]
    for side, part in ((0, 1 - share), (1, share)):
        for n, v in enumerate(pairs[:, side].tolist()):
            a, b = weights.row[v], weights.row[v + 1]
            vertex.append(np.full(b - a, len(weights) + n))
            joint.append(weights.joint[a:b])
            value.append(weights.weight[a:b] * part[n])
    v, j, w = np.concatenate(vertex), np.concatenate(joint), np.concatenate(value)
    left = place[v] >= 0
    return Weights.from_pairs(count, place[v[left]], j[left], w[left])
