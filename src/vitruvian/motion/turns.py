"""Turns along a chain of joints: local and world rotations of whole clips, and twists.

Quaternions are `xyzw`; clips have shape (F,J,4), F frames and J joints, parents before children.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from vitruvian.body.rotations import from_matrix, from_vector, inverse, multiply, rotate
from vitruvian.body.types import Floats


def about(axis: ArrayLike, angle: ArrayLike) -> Floats:
    """Turn by `angle` (...) radians about a unit `axis` (...,3)."""
    return from_vector(np.asarray(axis, dtype=np.float64) * np.asarray(angle, dtype=np.float64)[..., None])


def unit(v: Floats) -> Floats:
    """Vectors (...,3) of length one; those shorter than 1e-12 stay zero."""
    norm = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.where(norm > 1e-12, v / np.maximum(norm, 1e-300), 0.0)


def twist(q: Floats, axis: Floats) -> Floats:
    """Angle (...) in -pi..pi of the part of q that turns about the unit `axis`: q = swing * twist.

    Where q is a half turn about a normal of the axis the twist is undefined and 0 is answered.
    """
    along, w = np.sum(q[..., :3] * axis, axis=-1), q[..., 3]
    angle = (2.0 * np.arctan2(along, w) + np.pi) % (2 * np.pi) - np.pi
    return np.where(np.hypot(along, w) < 1e-9, 0.0, angle)


def frame(primary: Floats, secondary: Floats) -> Floats:
    """Quaternion whose Y axis is along `primary` and whose Z axis along the part of `secondary` normal to it."""
    y = unit(primary)
    z = unit(secondary - y * np.sum(y * secondary, axis=-1, keepdims=True))
    return from_matrix(np.stack([np.cross(y, z), y, z], axis=-1))


def world_rotations(parents: ArrayLike, local: Floats) -> Floats:
    """World rotations (F,J,4) of local ones (F,J,4)."""
    out = np.array(local)
    for j, p in enumerate(np.asarray(parents)):
        if p >= 0:
            out[:, j] = multiply(out[:, p], local[:, j])
    return out


def local_rotations(parents: ArrayLike, world: Floats) -> Floats:
    """Local rotations (F,J,4) of world ones (F,J,4)."""
    parents = np.asarray(parents)
    child = np.flatnonzero(parents >= 0)
    out = np.array(world)
    out[:, child] = multiply(inverse(world[:, parents[child]]), world[:, child])
    return out


def positions(parents: ArrayLike, centers: Floats, world: Floats, root: Floats, shift: Floats | None = None) -> Floats:
    """Joint positions (F,J,3) from centers (J,3) at rest, world rotations (F,J,4), `root` (F,3) translation of joint 0.

    `shift` (F,J,3) are the translations of all joints in their parents' frames, or None.
    """
    out = np.empty((*world.shape[:2], 3))
    for j, p in enumerate(np.asarray(parents)):
        own = 0.0 if shift is None else shift[:, j]
        if p < 0:
            out[:, j] = centers[j] + (root if j == 0 else own)
        else:
            out[:, j] = out[:, p] + rotate(world[:, p], centers[j] - centers[p] + own)
    return out
