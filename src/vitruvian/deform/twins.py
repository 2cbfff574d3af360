"""The skinning operators in NumPy, float64: what they mean, and what runs where the extension is missing.

Each takes bound influences (rows) and the matrices of one frame, and answers the blended transform of every vertex,
(V,3,4). Formulas: the module docstring of `vitruvian.deform.deformer`.
"""

from __future__ import annotations

import numpy as np

from vitruvian.body.types import Floats, Ints
from vitruvian.deform import se3
from vitruvian.deform.bind import Influences


def linear(rows: Influences, matrices: Floats) -> Floats:
    """I + sum w (M - I) for matrices (J,4,4): the same as sum w M when the weights sum to one."""
    delta = (matrices[:, :3] - np.eye(4)[:3])[rows.joint].reshape(-1, 12)
    return (rows.sum @ delta).reshape(-1, 3, 4) + np.eye(4)[:3]


def dual_quaternion(rows: Influences, duals: Floats, *, signed: bool = False) -> Floats:
    """Unit blended dual quaternion of every vertex (V,8), of joint duals (J+1,8).

    Signs are chosen against the joint with the largest weight, unless the duals come `signed`.
    """
    entries = duals[rows.joint]
    if not signed:
        dots = np.sum(entries[:, :4] * duals[rows.pivot][:, :4], axis=1)
        entries = np.where(dots[:, None] < 0, -entries, entries)
    blend = rows.sum @ entries
    lost = np.linalg.norm(blend[:, :4], axis=1) < 1e-8  # antipodal: the pivot's own motion
    blend[lost] = duals[rows.joint[rows.row[:-1][lost]]]
    return se3.unit(blend)


def log(rows: Influences, duals: Floats, steps: int, *, signed: bool = False) -> Floats:
    """`dual_quaternion`, then `steps` times A <- A exp(sum w log(A^-1 M)), (V,8)."""
    blend = dual_quaternion(rows, duals, signed=signed)
    entries = duals[rows.joint]
    if not signed:
        dots = np.sum(entries[:, :4] * duals[rows.pivot][:, :4], axis=1)
        entries = np.where(dots[:, None] < 0, -entries, entries)
    for _ in range(steps):
        relative = se3.product(se3.reverse(blend)[rows.vertex], entries)
        blend = se3.product(blend, se3.exp(rows.sum @ se3.log(relative)))
    return blend


def log_pair(rows: Influences, duals: Floats, *, signed: bool = False) -> Floats:
    """M_b exp(sum w log(M_b^-1 M)), b the joint with the largest weight, (V,8)."""
    pairs, of_entry = rows.pairs
    blend = rows.sum @ pair_twists(pairs, duals, signed=signed)[of_entry]
    return se3.product(duals[rows.joint[rows.row[:-1]]], se3.exp(blend))


def log_absolute(rows: Influences, duals: Floats) -> Floats:
    """exp(sum w log M), (V,8)."""
    return se3.exp(rows.sum @ joint_twists(duals)[rows.joint])


def pair_twists(pairs: Ints, duals: Floats, *, signed: bool = False) -> Floats:
    """(...,P,6) twists log(M_a^-1 M_b) of pairs (P,2): as the signs say, or the short way."""
    relative = se3.product(se3.reverse(duals[..., pairs[:, 0], :]), duals[..., pairs[:, 1], :])
    return se3.log(relative) if signed else joint_twists(relative)


def joint_twists(duals: Floats) -> Floats:
    """(...,6) twists of dual quaternions, the short way."""
    return se3.log(np.where(duals[..., 3:4] < 0, -duals, duals))
