"""Loose cloth about limbs: each vertex in a half-ball on the skin, as a point of a rigid body that hangs from it.

How far a vertex may be from the skin follows from what is around the limb: a ring of cloth, wider than the limb by some
room, hangs on it. Under a level limb there is twice the room, above it none.
Source: seed 003, section 5.3.2; note cloth.md, section 7.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vitruvian.body.types import Floats, Ints
from vitruvian.cloth.binding import Binding, frames
from vitruvian.cloth.moving import Skin, feet
from vitruvian.cloth.sheet import Sheet
from vitruvian.cloth.solver import AIR, DRAG, FRAME
from vitruvian.native import kernels

Single = NDArray[np.float32]
RING = 0.02  # metres of a limb's length
DAMPING, SMOOTH = 4.0, 0.3  # 1/s, relative to the skin; share of its neighbours' place that a vertex takes
LEAST = 0.003  # metres from the skin, halved where the drape has it nearer
SETTLING = 120  # frames until cloth rests as the half-balls have it


@dataclass(frozen=True, eq=False)
class Limbs:
    """vertices (k,) of the garment about bones (k,) of `ends` (b,2) joints; radius and room (k,) metres of the limb and of
    the ring of cloth at each; least (k,) metres from the skin. row, neighbour: those that each folds with. corner, share,
    fold (k,3): how the cloth as it was draped differs from what hangs so smoothly, metres in the frame of the foot. part
    (k,) that these make of the vertices' places, less than one near tight cloth."""

    vertices: Ints
    bones: Ints
    ends: Ints
    radius: Single
    room: Single
    least: Single
    row: Ints
    neighbour: Ints
    corner: Ints
    share: Single
    fold: Single
    part: Single
    friction: float
    density: float


def made(
    sheet: Sheet, x: Floats, binding: Binding, mine: NDArray[np.bool_], around: NDArray[np.bool_], regions: Ints,
    bones: Ints, joints: Floats, rings: Ints, least: Floats, skin: Skin, gravity: ArrayLike, band: int,
) -> Limbs | None:  # fmt: skip
    """The vertices `mine` (n,) of a garment at x (n,3), bound to a skin, about limbs; None without any.

    around (n,): the vertices that show how wide the rings of cloth are; bones (R,2) joints at the ends of each region's
    bone, joints (J,3) metres; rings (n,): how many sides each vertex is from tight cloth, of which `band` make the change;
    least (n,) metres from the skin.
    """
    vertices = np.flatnonzero(mine).astype(np.int32)
    if not len(vertices):
        return None
    used, bone = np.unique(regions[vertices], return_inverse=True)
    radius, room = np.zeros(len(vertices)), np.zeros(len(vertices))
    corner = binding.triangles[binding.face]
    foot = np.einsum("nk,nkx->nx", binding.share, skin.points[corner])
    for k, region in enumerate(used):
        start, end = joints[bones[region]]
        axis = (end - start) / np.linalg.norm(end - start)
        some = np.flatnonzero(around & (regions == region))
        along, thick, wide = (foot[some] - start) @ axis, _off(foot[some], start, axis), _off(x[some], start, axis)
        low, high = along.min(), along.max()
        bins = max(1, round((high - low) / RING))
        which = np.minimum(((along - low) / max(high - low, 1e-9) * bins).astype(int), bins - 1)
        count = np.bincount(which, minlength=bins)
        full = count > 0
        middle = (low + (np.arange(bins) + 0.5) * (high - low) / bins)[full]
        own = bone.reshape(-1) == k
        at = (foot[vertices[own]] - start) @ axis
        mean = [np.bincount(which, v, bins)[full] / count[full] for v in (thick, wide)]
        radius[own] = np.interp(at, middle, mean[0])
        room[own] = np.maximum(0.0, np.interp(at, middle, mean[1] - mean[0]))
    row, neighbour = _neighbours(sheet.edges, mine)
    height = binding.offset[vertices, 2]
    friction, density = (
        sheet.of_vertices("friction_body")[vertices].mean(),
        sheet.of_vertices("density")[vertices].mean(),
    )
    single = lambda a: np.ascontiguousarray(a, np.float32)  # noqa: E731
    limbs = Limbs(
        vertices, bone.reshape(-1).astype(np.int32), np.ascontiguousarray(bones[used], np.int32), single(radius),
        single(room), single(np.clip(height, 0.5 * LEAST, least[vertices])), row, neighbour,
        np.ascontiguousarray(corner[vertices], np.int32), single(binding.share[vertices]),
        np.zeros((len(vertices), 3), np.float32), single(np.minimum(1.0, rings[vertices] / (band + 1))),
        float(friction), float(density),
    )  # fmt: skip
    # what the drape has and the half-balls have not, so that it comes to lie as it was draped
    still, up, _ = feet(skin, limbs.corner, limbs.share, limbs.fold)
    state, (_, _, draped) = (
        begun(x[vertices], still),
        feet(skin, limbs.corner, limbs.share, single(binding.offset[vertices])),
    )
    for _ in range(SETTLING):
        state = hung(limbs, state, still, still, up, joints, FRAME, gravity, None)
    _, frame = frames(skin.points.astype(np.float64), binding.triangles, binding.face[vertices], binding.share[vertices],
                      skin.normals.astype(np.float64))  # fmt: skip
    fold = np.einsum("kij,ki->kj", frame, (draped - still - state[0]).astype(np.float64))
    return replace(limbs, fold=single(fold))


def begun(x: NDArray[np.floating], foot: Single) -> tuple[Single, Single]:
    """From their feet (k,3), and at rest: cloth at x (k,3)."""
    return np.ascontiguousarray(x - foot, np.float32), np.zeros((len(foot), 3), np.float32)


def hung(
    limbs: Limbs, state: tuple[Single, Single], before: Single, foot: Single, up: Single, joints: Floats, dt: float,
    gravity: ArrayLike, wind: ArrayLike | None,
) -> tuple[Single, Single]:  # fmt: skip
    """The half-balls' state `dt` seconds later: feet (k,3) before and now, their normals, joints (J,3) metres."""
    native = kernels()
    if native is None:
        from vitruvian.cloth.layers_numpy import cloth_limbs
    else:
        cloth_limbs = native.cloth_limbs
    axis = joints[limbs.ends[:, 1]] - joints[limbs.ends[:, 0]]
    axis = (axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9)).astype(np.float32)
    blows = wind is not None
    numbers = np.zeros(12, np.float32)
    numbers[:6] = dt, DAMPING, limbs.friction, SMOOTH, 0.5 * AIR * DRAG, limbs.density if blows else 0.0
    numbers[6:9] = gravity
    if blows:
        numbers[9:] = wind
    r, v = state[0].copy(), state[1].copy()
    count = np.arange(len(limbs.vertices), dtype=np.int32)
    cloth_limbs(
        r, v, count, limbs.bones, limbs.radius, limbs.room, limbs.least, limbs.row, limbs.neighbour, before, foot, up,
        axis, numbers,
    )  # fmt: skip
    return r, v


def placed(limbs: Limbs, state: tuple[Single, Single], x: Single, skin: Skin) -> None:
    """Puts the vertices of x (n,3), which are as they are bound to the skin, where the half-balls have them."""
    foot, up, out = feet(skin, limbs.corner, limbs.share, limbs.fold)
    way = state[0] + (out - foot)
    way += np.maximum(limbs.least - np.einsum("kx,kx->k", way, up), 0)[:, None] * up
    tight = x[limbs.vertices]
    x[limbs.vertices] = tight + limbs.part[:, None] * (foot + way - tight)


def _off(points: Floats, start: Floats, axis: Floats) -> Floats:
    """(n,) metres of points (n,3) from a line."""
    way = points - start
    return np.linalg.norm(way - (way @ axis)[:, None] * axis, axis=1)


def _neighbours(edges: Ints, mine: NDArray[np.bool_]) -> tuple[Ints, Ints]:
    """Rows of neighbours among the vertices `mine`, numbered as they come."""
    number = np.cumsum(mine) - 1
    some = edges[mine[edges].all(axis=1)]
    a, b = number[np.concatenate([some, some[:, ::-1]])].T
    order = np.lexsort((b, a))
    row = np.zeros(int(mine.sum()) + 1, np.int32)
    np.cumsum(np.bincount(a, minlength=len(row) - 1), out=row[1:])
    return row, b[order].astype(np.int32)
