"""The volume survey: contours widen or narrow where a bend would change the volume between them.

Source: cross-section deformation of H-Anim bodies, future work: contours that inflate or deflate as the volume asks.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from vitruvian.body.contours import Contours
from vitruvian.body.types import Body, Floats, Ints


@dataclass(frozen=True, eq=False)
class Slabs:
    """Neighbouring contours of the same surface: `pair` (S,2) numbers of contours; `area` (C,3) vector areas at rest,
    `free` (C,) how far a contour may change: nothing at seams."""

    pair: Ints
    area: Floats
    free: Floats


def vector_areas(points: Floats) -> Floats:
    """(C,3) vector areas of contours (C,P,3)."""
    around = points - points.mean(axis=1, keepdims=True)
    return np.cross(around, np.roll(around, -1, axis=1)).sum(axis=1) / 2


def slabs(body: Body, surfaces: Collection[Contours]) -> Slabs:
    """What the volume survey needs. Halves of a torso are left alone: their areas are no sections."""
    pairs, areas, free = [], [], []
    first = 0
    for surface in surfaces:
        count = len(surface)
        areas.append(vector_areas(body.skin.rest[surface.vertices]))
        if surface.closed:
            pairs.append(first + np.stack([np.arange(count - 1), np.arange(1, count)], axis=1))
            inner = np.ones(count)
            inner[[0, -1]] = 0
            free.append(inner)
        else:
            free.append(np.zeros(count))
        first += count
    pair = np.concatenate(pairs).astype(np.int32) if pairs else np.zeros((0, 2), np.int32)
    return Slabs(pair, np.concatenate(areas), np.concatenate(free))


def surveyed(moved: Floats, middle: Floats, normal: Floats, s: Slabs) -> Floats:
    """Motions (F,C,4,4) of contours, each widened or narrowed in its plane so that the slabs keep their volume.

    middle, normal (C,3): centres and unit normals of the contours at rest.
    A slab between two contours holds about the mean of their vector areas times the way between their centres. Factors
    stay within 0.7 and 1.4; seams keep theirs at one.
    """
    if not len(s.pair):
        return moved
    rest = _volumes(s.area, middle, s.pair)
    center = np.einsum("fcab,cb->fca", moved[..., :3, :3], middle) + moved[..., :3, 3]
    area = np.einsum("fcab,cb->fca", moved[..., :3, :3], s.area)
    now = _volumes(area, center, s.pair)
    ratio = np.clip(rest / np.where(np.abs(now) > 1e-12, now, 1e-12), 0.49, 1.96)
    total = np.zeros(moved.shape[:2])
    count = np.zeros(len(middle))
    for side in (0, 1):
        total[:, s.pair[:, side]] += ratio  # a contour is in one slab on each side at most
        count[s.pair[:, side]] += 1
    mean = np.where(count > 0, total / np.maximum(count, 1), 1.0)
    factor = np.clip(np.sqrt(mean), 0.7, 1.4)
    factor = 1 + s.free * (factor - 1)
    along = normal[:, :, None] * normal[:, None, :]
    shape = factor[..., None, None] * (np.eye(3) - along) + along
    out = moved.copy()
    out[..., :3, :3] = moved[..., :3, :3] @ shape
    out[..., :3, 3] = center - np.einsum("fcab,cb->fca", out[..., :3, :3], middle)
    return out


def _volumes(area: Floats, center: Floats, pair: Ints) -> Floats:
    way = center[..., pair[:, 1], :] - center[..., pair[:, 0], :]
    return np.sum((area[..., pair[:, 0], :] + area[..., pair[:, 1], :]) / 2 * way, axis=-1)
