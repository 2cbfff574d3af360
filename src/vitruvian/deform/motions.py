"""Joint matrices made ready for the operators: rigid parts, stretches, signs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.rotations import inverse, multiply
from vitruvian.body.types import Floats, Ints, Skeleton
from vitruvian.deform import se3
from vitruvian.deform.bind import Influences
from vitruvian.errors import VitruvianError

RIGID = 1e-5  # how far R^T R may be from the identity before a matrix counts as scaled
NEAR = np.cos(np.pi / 8)  # frames whose joint pairs turned by less than 45 degrees are consecutive


def factor(matrices: Floats, skeleton: Skeleton, used: Ints) -> tuple[Floats, Floats | None]:
    """M = G S: rigid motions G (F,J,4,4), and stretches S (F,J,4,4) about the joint centres, None when there are none.

    Source: polar decomposition of the 3x3 parts. When all `used` joints mirror, the mirror (x to -x) is part of S;
    raises VitruvianError naming a joint when some do and some do not, or when one is flat.
    """
    linear = matrices[..., :3, :3]
    gram = np.einsum("fjba,fjbc->fjac", linear, linear)
    if np.abs(gram - np.eye(3)).max(initial=0) <= RIGID and (np.linalg.det(linear) > 0).all():
        return matrices, None
    det = np.linalg.det(linear)
    flat = np.argwhere(np.abs(det[:, used]) < 1e-12)
    if flat.size:
        name = skeleton.names[used[flat[0, 1]]]
        raise VitruvianError(f"matrices: joint {name} is scaled to nothing; only the linear operator can show that")
    negative = det[:, used] < 0
    if negative.any() and not negative.all():
        name = skeleton.names[used[np.argwhere(negative)[0, 1]]]
        raise VitruvianError(f"matrices: joint {name} mirrors and others do not; use the linear operator")
    rigid, around = matrices.copy(), np.zeros_like(matrices)
    around[..., 3, 3] = 1
    if negative.any():  # M = R (S X): stretch and mirror about the origin
        mirror = np.diag([-1.0, 1.0, 1.0])
        rotation, stretch = se3.polar(linear @ mirror)
        around[..., :3, :3] = stretch @ mirror
    else:
        rotation, stretch = se3.polar(linear)
        shift = skeleton.centers - np.einsum("fjab,jb->fja", stretch, skeleton.centers)
        around[..., :3, :3], around[..., :3, 3] = stretch, shift
        rigid[..., :3, 3] -= np.einsum("fjab,fjb->fja", rotation, shift)
    rigid[..., :3, :3] = rotation
    return rigid, around


def joint_duals(rigid: Floats) -> Floats:
    """(F,J+1,8) float64 dual quaternions of rigid (F,J,4,4); the last one does not move."""
    frames = len(rigid)
    still = np.tile([0.0, 0, 0, 1, 0, 0, 0, 0], (frames, 1, 1))
    return np.concatenate([se3.dual_quaternion(rigid), still], axis=1)


def chain(rows: Influences, skeleton: Skeleton) -> tuple[Ints, Ints]:
    """(E,2) edges, outward, along which signs are made to agree, and (R,2) pairs in use that may disagree nevertheless.

    Down the skeleton, so that turns of joints add up on the way to another: a fist's last bones are turned by more than
    half a turn against the palm although no joint is. Where joints hang on several roots: the trees of pairs in use.
    """
    roots = np.flatnonzero(skeleton.parents < 0)
    if len(roots) > 1:
        return rows.chain
    below = np.flatnonzero(skeleton.parents >= 0)
    edges = np.stack([skeleton.parents[below], below], axis=1)
    still = np.array([[roots[0], rows.joints]])
    return np.concatenate([edges, still]).astype(np.int32), np.zeros((0, 2), np.int32)


def choose_signs(
    duals: Floats, tree: Ints, left: Ints, *, follow: bool, memory: Floats | None = None
) -> tuple[Floats, NDArray[np.bool_]]:
    """Dual quaternions whose signs agree along a `chain` of joints, and per frame whether all pairs agree.

    Where all agree, no sign needs to be looked at per vertex. `follow`: in frames that follow their predecessor closely
    the relative turn of an edge keeps its sign through 180 degrees, and the choice holds for all pairs. `memory` (E,4)
    carries the relative turns from call to call: NaN when there is no frame before; the last frame's are left in it.
    """
    duals = duals.copy()
    agree = np.ones(len(duals), dtype=bool)
    known = follow and memory is not None and memory.size > 0 and not np.isnan(memory[0, 0])
    before: Floats | None = memory.copy() if known and memory is not None else None
    for f, frame in enumerate(duals):
        for e, b in enumerate(tree[:, 1]):  # outward: the sign of the first is final
            turn = _relative(frame, tree[e])
            flip = turn[3] < 0
            if follow and before is not None and abs(turn @ before[e]) >= NEAR:
                flip = turn @ before[e] < 0
            if flip:
                frame[b] = -frame[b]
        relative = _relative(frame, tree)
        before = relative
        wound = (relative[:, 3] < 0).any()
        if len(left) and not wound:
            agree[f] = bool((np.sum(frame[left[:, 0], :4] * frame[left[:, 1], :4], axis=1) >= 0).all())
    if follow and memory is not None and before is not None:
        memory[:] = before
    return duals, agree


def _relative(frame: Floats, pairs: Ints) -> Floats:
    return multiply(inverse(frame[pairs[..., 0], :4]), frame[pairs[..., 1], :4])
