"""Joints that were wound past half a turn: matrices can't tell 190 degrees one way from 170 the other way.

Deformers that are given frames in a row follow; a stage has one frame at a time. So it remembers how joints came to be
where they are, and gives those few poses that are wound with the way that leads to them.

Why not a `live` deformer: it knows one figure's last call. Here actors share deformers, change them and their level of
detail while they move, and contours follow in their own way; what is remembered of a joint serves them all, is part of
the pose, and is forgotten by a seek. Turns that only add up past half a turn, as in a fist, need neither: signs go down
the skeleton.
"""

from __future__ import annotations

import numpy as np

from vitruvian.body.rotations import from_vector
from vitruvian.body.types import Floats

NEAR = np.cos(np.pi / 8)  # as deformers: turns of less than 45 degrees are steps of one movement
CLEAR = 0.3  # two rotations with a greater w are never NEAR with opposite signs
START = np.radians(170.0)  # here all deformers agree about the way
STEP = np.radians(40.0)


def wound(rotation: Floats, before: Floats | None) -> Floats:
    """`rotation` (J,4) with signs that say how far each joint is wound: w < 0 past half a turn.

    `before`: the same a moment ago, None when there is none; joints that leap are not wound.
    """
    if rotation[:, 3].min() > CLEAR and (before is None or before[:, 3].min() > CLEAR):
        return rotation  # as nearly always: nothing is near half a turn
    flip = rotation[:, 3] < 0
    if before is not None:
        dot = np.einsum("ji,ji->j", before, rotation)
        flip = np.where(np.abs(dot) >= NEAR, dot < 0, flip)
    return np.where(flip[:, None], -rotation, rotation) if flip.any() else rotation


def way(turns: Floats) -> Floats | None:
    """(K,J,4) rotations that lead to `wound` ones (J,4), without these; None when no joint is past half a turn."""
    if turns[:, 3].min() >= 0:
        return None
    past = np.flatnonzero(turns[:, 3] < 0)
    axis, length = turns[past, :3], np.linalg.norm(turns[past, :3], axis=1)
    angle = 2 * np.arctan2(length, turns[past, 3])
    unit = axis / np.maximum(length, 1e-12)[:, None]
    steps = max(int(np.ceil((angle.max() - START) / STEP)), 1)
    out = np.tile(turns, (steps, 1, 1))
    for k in range(steps):
        out[k, past] = from_vector(unit * (START + (angle - START) * k / steps)[:, None])
    return out
