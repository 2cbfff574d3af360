"""Joint limits: angles in the frame of `limitOrientation`, how far a pose is beyond them, poses within them.

The standard gives llimit and ulimit about X, Y, Z of the frame turned by limitOrientation and is silent on the order of
the rotations. Convention (note motion.md, 6): a rotation R is brought into that frame, R' = O^-1 R O, and its angles are
those of R' = Rz Ry Rx, x first. A joint with one axis that may turn is a hinge: its angle is the twist about that axis.
Missing entries (NaN) are free.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.rotations import from_euler, inverse, multiply, to_euler
from vitruvian.body.types import Floats, Skeleton
from vitruvian.motion.turns import twist

_FIXED = 1e-9  # radians between the limits of an axis that does not turn


def boxes(skeleton: Skeleton) -> Floats:
    """(J,3,2) lowest and highest angles about X, Y, Z, radians; -inf and inf where free, exchanged where they cross."""
    box = skeleton.limits.copy()
    box[..., 0] = np.where(np.isnan(box[..., 0]), -np.inf, box[..., 0])
    box[..., 1] = np.where(np.isnan(box[..., 1]), np.inf, box[..., 1])
    return np.sort(box, axis=-1)


def hinges(box: Floats) -> tuple[NDArray[np.signedinteger], NDArray[np.signedinteger]]:
    """Joints (H,) of which two axes are fixed, and which axis (H,) turns."""
    turns = box[..., 1] - box[..., 0] > _FIXED
    found = np.flatnonzero(turns.sum(axis=1) == 1)
    return found, turns[found].argmax(axis=1)


def angles(skeleton: Skeleton, rotation: Floats) -> Floats:
    """(...,J,3) angles about X, Y, Z in the frames of the limits, radians, of local rotations (...,J,4).

    Of the triples that mean the same rotation the one least beyond the limits is taken.
    """
    frame, box = skeleton.limit_orientation, boxes(skeleton)
    local = multiply(multiply(inverse(frame), rotation), frame)
    first = to_euler(local, "ZYX")[..., ::-1]
    both = np.stack([first, first * [1.0, -1.0, 1.0] + np.pi])
    for joint, axis in zip(*hinges(box), strict=True):
        both[..., joint, :] = 0.0
        both[..., joint, axis] = twist(local[..., joint, :], np.eye(3)[axis])
    middle = np.zeros(box.shape[:2])
    bound = np.isfinite(box).all(axis=-1)
    middle[bound] = box[bound].mean(axis=-1)
    both += 2 * np.pi * np.round((middle - both) / (2 * np.pi))
    out = np.abs(both - np.clip(both, box[..., 0], box[..., 1])).sum(axis=-1)
    return np.where((out[1] < out[0] - 1e-12)[..., None], both[1], both[0])


def rotations(skeleton: Skeleton, angle: Floats) -> Floats:
    """(...,J,4) local rotations of angles (...,J,3): the inverse of `angles`."""
    frame = skeleton.limit_orientation
    return multiply(multiply(frame, from_euler(angle[..., ::-1], "ZYX")), inverse(frame))


def beyond(skeleton: Skeleton, rotation: Floats) -> Floats:
    """(...,J,3) radians by which rotations (...,J,4) are beyond the limits: negative below, positive above, 0 within."""
    box, angle = boxes(skeleton), angles(skeleton, rotation)
    return angle - np.clip(angle, box[..., 0], box[..., 1])


def within(skeleton: Skeleton, rotation: Floats) -> Floats:
    """(...,J,4): rotations with the angles of limited joints clamped, axis by axis; those of free joints as they are."""
    box, angle = boxes(skeleton), angles(skeleton, rotation)
    limited = np.isfinite(box).any(axis=(1, 2))
    out = np.array(rotation, dtype=np.float64)
    out[..., limited, :] = rotations(skeleton, np.clip(angle, box[..., 0], box[..., 1]))[..., limited, :]
    return out
