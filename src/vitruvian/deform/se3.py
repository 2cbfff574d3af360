"""Rigid motions as dual quaternions and twists, float64, over any leading axes.

A dual quaternion (...,8) is `x y z w` of the rotation, then the dual part `1/2 (t, 0) q`; a twist (...,6) is rotation
vector then translation part. Sources: L. Kavan et al., "Geometric Skinning with Approximate Dual Quaternion Blending"
(2008); R. Murray, Z. Li, S. Sastry, "A Mathematical Introduction to Robotic Manipulation" (1994), section 2.3.
"""

from __future__ import annotations

import numpy as np

from vitruvian.body.rotations import from_matrix, inverse, multiply, to_matrix
from vitruvian.body.types import Floats


def dual_quaternion(matrix: Floats) -> Floats:
    """(...,8) of rigid matrices (...,4,4)."""
    return from_rotation_translation(from_matrix(matrix[..., :3, :3]), matrix[..., :3, 3])


def from_rotation_translation(q: Floats, t: Floats) -> Floats:
    """(...,8) of a unit quaternion (...,4) and a translation (...,3)."""
    pure = np.concatenate([t, np.zeros_like(t[..., :1])], axis=-1)
    return np.concatenate([q, multiply(pure, q) / 2], axis=-1)


def translation(dual: Floats) -> Floats:
    """(...,3) of unit dual quaternions (...,8)."""
    return 2 * multiply(dual[..., 4:], inverse(dual[..., :4]))[..., :3]


def unit(dual: Floats) -> Floats:
    """Unit dual quaternions: real part of length one, dual part perpendicular to it."""
    norm = np.linalg.norm(dual[..., :4], axis=-1, keepdims=True)
    real, other = dual[..., :4] / norm, dual[..., 4:] / norm
    return np.concatenate([real, other - real * np.sum(real * other, axis=-1, keepdims=True)], axis=-1)


def to_frame(dual: Floats) -> Floats:
    """(...,3,4): rotation and translation of unit dual quaternions."""
    return np.concatenate([to_matrix(dual[..., :4]), translation(dual)[..., None]], axis=-1)


def product(a: Floats, b: Floats) -> Floats:
    """The motion `b` followed by `a`."""
    real = multiply(a[..., :4], b[..., :4])
    return np.concatenate([real, multiply(a[..., :4], b[..., 4:]) + multiply(a[..., 4:], b[..., :4])], axis=-1)


def reverse(dual: Floats) -> Floats:
    """The opposite motion of unit dual quaternions."""
    return np.concatenate([inverse(dual[..., :4]), inverse(dual[..., 4:])], axis=-1)


def log(dual: Floats) -> Floats:
    """Twists (...,6) of unit dual quaternions, the angle in 0..2 pi as the sign of the quaternion says."""
    q, t = dual[..., :4], translation(dual)
    length = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(length, q[..., 3:])
    small = length < 1e-12
    w = q[..., :3] * np.where(small, 2.0, angle / np.where(small, 1.0, length))
    angle = np.minimum(angle, 2 * np.pi - 1e-6)  # at a full turn the translation part has no finite value
    flat = angle < 1e-3
    safe = np.where(flat, 1.0, angle)
    k = np.where(flat, 1 / 12 + angle**2 / 720, (1 - safe / 2 / np.tan(safe / 2)) / safe**2)
    cross = np.cross(w, t)
    return np.concatenate([w, t - cross / 2 + k * np.cross(w, cross)], axis=-1)


def exp(twist: Floats) -> Floats:
    """Unit dual quaternions (...,8) of twists (...,6)."""
    w, v = twist[..., :3], twist[..., 3:]
    angle = np.linalg.norm(w, axis=-1, keepdims=True)
    flat = angle < 1e-3
    safe = np.where(flat, 1.0, angle)
    b = np.where(flat, 0.5 - angle**2 / 24, 2 * np.sin(angle / 2) ** 2 / safe**2)
    c = np.where(flat, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    cross = np.cross(w, v)
    t = v + b * cross + c * np.cross(w, cross)
    q = np.concatenate([w * np.sinc(angle / 2 / np.pi) / 2, np.cos(angle / 2)], axis=-1)
    return from_rotation_translation(q, t)


def polar(linear: Floats) -> tuple[Floats, Floats]:
    """Rotation and symmetric stretch of 3x3 matrices with positive determinant: `linear = rotation @ stretch`."""
    u, s, vt = np.linalg.svd(linear)
    return u @ vt, np.swapaxes(vt, -1, -2) @ (s[..., None] * vt)
