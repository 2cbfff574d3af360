"""Least squares over joint angles within their limits: the solver under inverse kinematics and marker solving.

Method: Gauss-Newton steps damped after Levenberg and Marquardt, projected onto the limits (Nocedal & Wright, Numerical
Optimization, chapters 10 and 16.7); the Jacobian of a point is axis x (point - joint), in the world. A joint with limits
is described by its angles in their frame (`vitruvian.motion.limits`), a free one by rotation vectors in its parent's
frame. stiffness s of an axis lets 1 - s of a step through (note motion.md, 6).
All frames of a call are solved side by side and do not know of each other. The work is done by a kernel, or by its twin
`vitruvian.motion.solver_numpy`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.rotations import to_matrix
from vitruvian.body.types import Floats, Ints, Skeleton
from vitruvian.motion.limits import angles, boxes, hinges, rotations
from vitruvian.native import kernels

POINT, PLANE, TURN, LOOK = range(4)
IDLE = 1e-8  # of the cost: a step that gains less is the last


@dataclass(frozen=True, eq=False)
class Freedom:
    """What may change: which joints (n,) turn, and whether the first joint of the skeleton shifts."""

    skeleton: Skeleton
    joints: Ints
    shifts: bool = False

    @cached_property
    def box(self) -> Floats:
        """(J,3,2) the limits."""
        return boxes(self.skeleton)

    @cached_property
    def limited(self) -> NDArray[np.bool_]:
        """(J,) whether a joint is described by angles."""
        return np.asarray(np.isfinite(self.box).any(axis=(1, 2)))

    @cached_property
    def columns(self) -> Ints:
        """(D,2) joint and axis of each number that may change; joint -1 for the shift."""
        turns = (self.box[..., 1] - self.box[..., 0] > 0) & (self.skeleton.stiffness < 1)
        rows = [(j, a) for j in sorted(self.joints) for a in range(3) if turns[j, a]]
        if self.shifts:
            rows += [(-1, a) for a in range(3)]
        return np.array(rows, dtype=np.int32).reshape(-1, 2)

    @cached_property
    def give(self) -> Floats:
        """(D,) the share of a step each takes: 1 - stiffness."""
        joint, axis = self.columns.T
        return np.where(joint < 0, 1.0, 1.0 - np.clip(self.skeleton.stiffness[joint, axis], 0.0, 1.0))

    @cached_property
    def above(self) -> NDArray[np.bool_]:
        """(J,D): whether a change of the number moves the joint and what hangs on it."""
        out = np.zeros((len(self.skeleton), len(self.columns)), bool)
        for j, p in enumerate(self.skeleton.parents):
            out[j] = (out[p] if p >= 0 else False) | (self.columns[:, 0] == j)
            if j == 0:
                out[j] |= self.columns[:, 0] < 0
        return out

    @cached_property
    def stretch(self) -> Floats | None:
        """(J,3,3) what scales each joint, or None."""
        if (self.skeleton.scale == 1).all():
            return None
        turn = to_matrix(self.skeleton.scale_orientation)
        return np.ascontiguousarray(np.einsum("jab,jb,jcb->jac", turn, self.skeleton.scale, turn))


@dataclass(frozen=True, eq=False)
class Wishes:
    """What is asked of a pose, one row each.

    kind (K,): POINT shall be at a place, PLANE shall have the place's distance along a normal, TURN: the joint shall
    have a turn from rest, LOOK: a direction shall lead to a place. joint (K,). point (K,3) moved by it, in humanoid
    space at rest. axis (K,3): the unit normal, or direction at rest.
    place (F,K,4): a position and 0, or a quaternion xyzw; NaN where nothing is asked in that frame.
    weight (F,K): of squares of metres; TURN and LOOK: times square metres a square radian.
    """

    kind: Ints
    joint: Ints
    point: Floats
    axis: Floats
    place: Floats
    weight: Floats


@dataclass(frozen=True, eq=False)
class Prior:
    """A pose that the result stays near: rotation (F,J,4), shift (F,3); each number's squared deviation costs `weight`.

    weight (J,3): for the axes of each joint, square metres a square radian. shift_weight: for the shift.
    """

    rotation: Floats
    shift: Floats
    weight: Floats
    shift_weight: float = 0.0


@dataclass(frozen=True, eq=False)
class Answer:
    """rotation (F,J,4), shift (F,3), error (F,K,3): what is missing of each wish, weighted, tried steps (F,)."""

    rotation: Floats
    shift: Floats
    error: Floats
    steps: Ints


def solve(
    freedom: Freedom,
    wishes: Wishes,
    rotation: Floats,
    shift: Floats,
    *,
    prior: Prior | None = None,
    tolerance: float = 1e-4,
    iterations: int = 50,
    damping: float = 1e-3,
    idle: float = IDLE,
    threads: int = 0,
) -> Answer:
    """Poses near rotation (F,J,4), shift (F,3) that do best what is wished.

    A frame ends when every wish is met to `tolerance` (metres; not with a prior), when steps are below 1e-6 or gain less
    than `idle` of the cost, or after `iterations` of them. Angles beyond limits at the start only come nearer to them.
    """
    bound = Bound(freedom, wishes, prior)
    state = bound.state(rotation, shift)
    error, steps = bound.run(state, wishes.place, wishes.weight, tolerance, damping, idle, iterations, threads)
    out = np.array(rotation, dtype=np.float64)
    out[:, bound.chain] = state.rotation
    return Answer(out, state.shift, error, steps)


@dataclass(frozen=True, eq=False)
class Near:
    """A `Prior` on the joints of a problem: rotation (F,J,4), angle (F,J,3), shift (F,3), weight (D,)."""

    rotation: Floats
    angle: Floats
    shift: Floats
    weight: Floats


@dataclass(frozen=True, eq=False)
class Place:
    """Where the joints of a problem are: rotation (F,J,4), angle (F,J,3), shift (F,3). Solving writes into it."""

    rotation: Floats
    angle: Floats
    shift: Floats


class Bound:
    """Wishes of one kind on one skeleton, prepared once for many poses: `state`, then `run` as often as one likes.

    chain (C,): the joints of the skeleton that matter, in their order; states are of these. The places in `wishes` do not
    matter, and its weights neither: `run` is given both.
    """

    def __init__(self, freedom: Freedom, wishes: Wishes, prior: Prior | None = None):
        self.chain = limbs(freedom.skeleton, [0, *wishes.joint, *freedom.joints])
        self.small = _small(freedom, self.chain)
        self.wishes = replace(wishes, joint=np.searchsorted(self.chain, wishes.joint).astype(np.int32))
        self.hinged = _hinged(self.small)[:, None]
        self.near = None if prior is None else self._near(prior)
        native, small, s = kernels(), self.small, self.small.skeleton
        self.native = native
        if native is not None:
            w = self.wishes
            self.problem = native.bind_poses(
                s.parents, s.centers, s.translation, small.stretch, s.limit_orientation, small.box,
                small.limited.astype(np.uint8), small.columns, small.give,
                w.kind, w.joint, w.point, w.axis, None if self.near is None else self.near.weight,
            )  # fmt: skip

    def _near(self, prior: Prior) -> Near:
        bent = np.ascontiguousarray(prior.rotation[:, self.chain])
        joint, axis = self.small.columns.T
        weight = np.where(joint < 0, prior.shift_weight, prior.weight[self.chain][joint, axis])
        turned = np.ascontiguousarray(angles(self.small.skeleton, bent))
        return Near(bent, turned, np.ascontiguousarray(prior.shift), weight)

    def state(self, rotation: Floats, shift: Floats) -> Place:
        """Of rotations (F,J,4) of all joints and shifts (F,3); hinges keep their twist alone."""
        turn, shift = np.ascontiguousarray(rotation[:, self.chain]), np.array(shift, dtype=np.float64)
        angle = np.ascontiguousarray(angles(self.small.skeleton, turn))
        hinge = np.where(self.hinged, rotations(self.small.skeleton, angle), turn)
        return Place(np.ascontiguousarray(hinge), angle, shift)

    def run(
        self,
        state: Place,
        place: Floats,
        weight: Floats,
        tolerance: float = 1e-4,
        damping: float = 1e-3,
        idle: float = IDLE,
        iterations: int = 50,
        threads: int = 0,
    ) -> tuple[Floats, Ints]:
        """Bring `state` to place (F,K,4) with weight (F,K), as `solve` does; error (F,K,3) weighted, tried steps (F,)."""
        near, place, weight = self.near, np.ascontiguousarray(place), np.ascontiguousarray(weight)
        if self.native is None:
            from vitruvian.motion.solver_numpy import solve_poses

            wishes = replace(self.wishes, place=place, weight=weight)
            return solve_poses(
                self.small, wishes, state.rotation, state.shift, state.angle, near, tolerance, damping, idle, iterations
            )
        error, steps = np.zeros((*place.shape[:2], 3)), np.zeros(len(place), np.int32)
        before = (None, None, None) if near is None else (near.rotation, near.angle, near.shift)
        self.native.solve_poses(
            self.problem, state.rotation, state.shift, state.angle, place, weight, *before,
            tolerance, damping, idle, iterations, error, steps, threads,
        )  # fmt: skip
        return error, steps


def limbs(skeleton: Skeleton, joints: Sequence[int]) -> Ints:
    """The joints from `joints` up to the roots, parents first."""
    found: set[int] = set()
    for j in joints:
        while j >= 0 and j not in found:
            found.add(int(j))
            j = int(skeleton.parents[j])
    return np.array(sorted(found), dtype=np.int32)


def _small(freedom: Freedom, chain: Ints) -> Freedom:
    """The same on the joints of `chain` alone."""
    s = freedom.skeleton
    place = {-1: -1, **{int(j): i for i, j in enumerate(chain)}}
    own = {
        n: getattr(s, n)[chain]
        for n in ("centers", "translation", "scale", "scale_orientation", "limits", "limit_orientation", "stiffness")
    }
    names = tuple(s.names[j] for j in chain)
    skeleton = Skeleton(names, np.array([place[int(s.parents[j])] for j in chain], np.int32), **own)
    return Freedom(skeleton, np.array([place[int(j)] for j in freedom.joints], np.int32), freedom.shifts)


def _hinged(freedom: Freedom) -> NDArray[np.bool_]:
    """(J,) which of the moving joints are hinges: they keep their twist alone."""
    out = np.zeros(len(freedom.skeleton), bool)
    out[np.intersect1d(hinges(freedom.box)[0], freedom.joints)] = True
    return out
