"""Hands: every point keeps its place along its link and its distance from it, in frames that bend with the joints.

A point is given by its place R along its link, and by how it stands off the link in a frame whose y axis is the normal
towards the back of the hand. At a joint that normal is the mean of its direction on both links, so both agree there;
between, it is interpolated. In a second pass the back of a bent joint is rounded and pushed out (the knuckle), and the
muscle on the palm side swells. Between two metacarpals the frame's x axis is the line from one to the other, and what
folds gets thicker.

Source: joint-dependent local operators for hands, "Simulation of object and human skin deformations in a grasping task"
(1989), section 2. Repaired: normals and side axes are averaged in the world, so that both links of a joint agree in any
pose, and the thickness factor F is the present distance of two links over the initial one, as the text has it. Ours: the
arc, without which the back of a bent joint is a corner.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.hands import Hand
from vitruvian.body.rotations import from_matrix, unit
from vitruvian.body.types import Body, Floats, Skin, Weights
from vitruvian.deform.hand_terms import Assignment, HandProgram, assign, bridge_frames, frames, hand_program, mixed
from vitruvian.deform.operators import Operator
from vitruvian.native import kernels

Single = NDArray[np.float32]
MOST = np.radians(120.0)  # flexion beyond which a knuckle grows no more
ROOM = 0.9  # of the depth at which the palm side would fold onto itself, that it may have
ROUND = np.radians(60.0)  # flexion at which the back of a joint is fully an arc


@dataclass(frozen=True, eq=False)
class Bent:
    """Links in one pose: ends (L,3); normals and side axes (L,3,3) at the near end, of the link, at the far end; bend
    (L,3): knuckles and muscle; arc (L,2) in 0..1: how far the two ends are rounded; tight (L,2), 1/m: the palm side at
    the two ends folds onto itself where it is thicker than one over that."""

    start: Floats
    end: Floats
    ys: Floats
    zs: Floats
    bend: Floats
    arc: Floats
    tight: Floats


def bent(program: HandProgram, matrices: Floats) -> Bent:
    """The links of a hand for joint matrices (J,4,4)."""
    p, hand = program, program.hand
    own_matrix = matrices[hand.near]
    far_matrix = np.where((hand.far >= 0)[:, None, None], matrices[hand.far], own_matrix)
    own, after = own_matrix[:, :3, :3], far_matrix[:, :3, :3]
    before = np.where((hand.before >= 0)[:, None, None], matrices[hand.before, :3, :3], own)
    turn = lambda r, v: np.einsum("lab,lb->la", r, v)  # noqa: E731
    put = lambda m, p: np.einsum("lab,lb->la", m[:, :3, :3], p) + m[:, :3, 3]  # noqa: E731
    y_near = unit(turn(before, p.normal_near) + turn(own, p.normal_near))
    y_far = unit(turn(own, p.normal_far) + turn(after, p.normal_far))
    y_own = turn(own, p.normal_own)
    square = lambda z, y: unit(z - np.sum(z * y, axis=1, keepdims=True) * y)  # noqa: E731
    z_near = square(-turn(before, hand.axis_near) - turn(own, hand.axis_near), y_near)
    z_far = square(-turn(own, hand.axis_far) - turn(after, hand.axis_far), y_far)
    z_own = square(-turn(own, p.axis_own), y_own)
    flex_near = _flexion(before, own, hand.axis_near)
    flex_far = _flexion(own, after, hand.axis_far)
    knuckle = lambda a: 1 / np.cos(np.clip(a, 0, MOST) / 2) - 1  # noqa: E731
    muscle = 1 - np.cos(np.maximum(0, (flex_near + flex_far) / 2))
    bow = np.clip(np.stack([flex_near, flex_far], axis=1) / ROUND, 0, 1)
    start, end = put(own_matrix, hand.start), put(far_matrix, hand.end)
    # Along the palm side frames turn by the mean of both flexions while they advance by the link's length.
    mean = np.maximum(0, (flex_near + flex_far) / 2)
    steepest = np.clip(np.maximum(flex_near, flex_far), 0, MOST)
    own_tight = mean / (ROOM * np.linalg.norm(end - start, axis=1) * np.cos(steepest / 2))
    tight = np.stack([own_tight, own_tight], axis=1)
    behind = np.flatnonzero(p.previous >= 0)
    for i in behind.tolist():  # both links of a joint agree there
        tight[i, 0] = tight[p.previous[i], 1] = max(tight[i, 0], tight[p.previous[i], 1])
    return Bent(
        start, end, np.stack([y_near, y_own, y_far], axis=1),
        np.stack([z_near, z_own, z_far], axis=1), np.stack([knuckle(flex_near), knuckle(flex_far), muscle], axis=1),
        bow * (2 - bow), tight,
    )  # fmt: skip


def _flexion(one: Floats, two: Floats, axis: Floats) -> Floats:
    """(L,) signed angle about `axis` of the rotation from `one` to `two`."""
    q = from_matrix(np.swapaxes(one, 1, 2) @ two)
    q = np.where(q[:, 3:] < 0, -q, q)
    return 2 * np.arctan2(np.sum(q[:, :3] * axis, axis=1), q[:, 3])


def place(program: HandProgram, matrices: Floats, out: NDArray[np.floating]) -> None:
    """Move the hand's vertices of `out` (F,V,3) by their share to where joint matrices (F,J,4,4) put them.

    A float64 `out` is worked out in double precision, in NumPy; what the kernel does in single precision is the same.
    """
    native = kernels()
    if native is not None and out.dtype == np.float32:
        native.hand(program.bound, np.ascontiguousarray(matrices), out)
        return
    own = program.hand.vertices
    for f, frame in enumerate(matrices):
        moved = np.zeros((len(own), 3))
        _add(program, bent(program, frame), moved)
        out[f, own] = (1 - program.whole)[:, None] * out[f, own].astype(np.float64) + moved


def _add(program: HandProgram, pose: Bent, moved: Floats) -> None:
    p, a = program, program.assignment
    k = a.link
    along = p.along + np.sum(p.shift * pose.arc[k], axis=1)
    foot = pose.start[k] + along[:, None] * (pose.end - pose.start)[k]
    local = p.local.copy()
    local[:, 1] *= 1 + np.sum(p.swell * pose.bend[k], axis=1)
    inner = np.clip(p.along, 0, 1)
    depth = p.press * local[:, 1] * ((1 - inner) * pose.tight[k, 0] + inner * pose.tight[k, 1])
    local[:, 1] /= (1 + depth**4) ** 0.25
    axes = frames(pose.ys[k], pose.zs[k], p.coefficients)
    np.add.at(moved, a.row, a.share[:, None] * (foot + np.einsum("nab,nb->na", axes, local)))
    if not len(a.gap_row):
        return
    one, two = a.links[:, 0], a.links[:, 1]
    feet = [pose.start[k] + p.alongs[:, i, None] * (pose.end - pose.start)[k] for i, k in enumerate((one, two))]
    ys = [mixed(pose.ys[k], p.gap_coefficients[:, i]) for i, k in enumerate((one, two))]
    bridge = feet[1] - feet[0]
    ratio = np.where(p.width < 1e-6, 1.0, np.linalg.norm(bridge, axis=1) / np.maximum(p.width, 1e-6))
    local = p.gap_local.copy()
    thicker = np.minimum(1 + p.fold * (1 / np.maximum(ratio, 1e-6) - 1), 2.0)
    local[:, 1] *= np.where(ratio < 1, thicker, 1.0)
    axes = bridge_frames(bridge, ys[0], ys[1], p.across)
    where = feet[0] + p.across[:, None] * bridge + np.einsum("nab,nb->na", axes, local)
    np.add.at(moved, a.gap_row, a.gap_share[:, None] * where)


@dataclass(frozen=True, eq=False)
class HandOperator:
    """Another operator, with hands placed over it. `rounded` False: without the second pass.

    `beneath`: the same operator as `base`, for a body whose skin is simpler where nothing of it shows.
    """

    base: Operator
    skin: Skin
    hands: tuple[Hand, ...]
    rounded: bool = True
    assignments: tuple[Assignment, ...] = ()
    programs: tuple[HandProgram, ...] = ()
    beneath: Operator | None = None

    def __post_init__(self) -> None:
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        put("assignments", self.assignments or tuple(assign(hand, self.skin) for hand in self.hands))
        if not self.programs:
            put("programs", self._programs(self.skin))

    def _programs(self, skin: Skin) -> tuple[HandProgram, ...]:
        both = zip(self.hands, self.assignments, strict=True)
        return tuple(hand_program(hand, skin, a, plain=not self.rounded) for hand, a in both)

    @property
    def alone(self) -> NDArray[np.bool_]:
        """(V,) the points that are the hands' alone."""
        alone = np.zeros(len(self.skin.rest), bool)
        for p in self.programs:
            alone[p.hand.vertices[p.whole > 1 - 1e-9]] = True
        return alone

    def spared(self, body: Body) -> Body:
        """A body whose points that are the hands' alone follow one joint each, which costs less."""
        alone = self.alone
        weights, first = body.skin.weights, body.skin.weights.top(1)[0][:, 0]
        keep, some = ~alone[weights.vertex], np.flatnonzero(alone)
        simple = Weights.from_pairs(
            len(alone),
            np.concatenate([weights.vertex[keep], some]),
            np.concatenate([weights.joint[keep], first[some]]),
            np.concatenate([weights.weight[keep], np.ones(len(some))]),
        )
        return replace(body, skin=replace(body.skin, weights=simple))

    def tuned(self, hands: tuple[Hand, ...] | None = None, *, rounded: bool | None = None) -> HandOperator:
        """The same with other parameters, for which nothing is bound anew: the same hands, the second pass on or off."""
        chosen = self.hands if hands is None else hands
        second = self.rounded if rounded is None else rounded
        programs = tuple(
            p
            if second == self.rounded and new.roundings == p.hand.roundings
            else hand_program(new, self.skin, a, plain=not second)
            for new, p, a in zip(chosen, self.programs, self.assignments, strict=True)
        )
        return replace(self, hands=chosen, rounded=second, programs=programs)

    def points(self, matrices: Floats, out: Single, rest: Floats | None = None) -> None:
        (self.beneath or self.base).points(matrices, out, rest)
        programs = self.programs
        if rest is not None and any((rest[h.vertices] != self.skin.rest[h.vertices]).any() for h in self.hands):
            # displaced: the hand's points stand elsewhere on their links
            programs = self._programs(replace(self.skin, rest=rest, morphs=()))
        for program in programs:
            place(program, matrices, out)

    def frames(self, matrices: Floats, out: Single) -> None:
        """The base operator's, moved to where the hand's points are."""
        self.base.frames(matrices, out)
        for program in self.programs:
            own = program.hand.vertices
            rest = self.skin.rest[own]
            points = np.zeros((len(out), len(self.skin.rest), 3), np.float32)
            part = out[:, own]
            turned = np.einsum("fvab,vb->fva", part[..., :3].astype(np.float64), rest)
            points[:, own] = turned + part[..., 3]
            place(program, matrices, points)
            part[..., 3] = points[:, own] - turned
            out[:, own] = part
