"""Linear blending where joints turn little, the logarithm elsewhere.

Linear blending errs by r (1 - cos(th/2)) at a relative angle th, r the distance from the axis; so the tolerance gives
the angle th0 = 2 acos(1 - tol / r) of each joint pair. Between th0/2 and th0 the two are faded.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.rotations import from_matrix
from vitruvian.body.types import Body, Floats, Ints
from vitruvian.deform.bind import Influences
from vitruvian.deform.operators import Linear, Rigid

FLOOR = 1e-3  # metres: the least radius that an angle is derived from


@dataclass(frozen=True, eq=False)
class Pairs:
    """Joint pairs in use (P,2), and sets of pairs: rows `row` (S+1,) of `pair`; `group` (V,) the set of each vertex."""

    joints: Ints
    row: Ints
    pair: Ints
    group: Ints


def pairs_of(rows: Influences) -> Pairs:
    """All pairs of joints that share a vertex. Vertices with the same joints share a set."""
    width = max(int(rows.counts.max(initial=0)), 1)
    table = np.full((len(rows), width), -1, np.int32)
    table[rows.vertex, np.arange(len(rows.joint)) - rows.row[:-1][rows.vertex]] = rows.joint
    sets, group = np.unique(np.sort(table, axis=1), axis=0, return_inverse=True)
    of_set, first, second = [], [], []
    for a in range(width):
        for b in range(a + 1, width):
            both = np.flatnonzero(sets[:, a] >= 0)
            of_set.append(both)
            first.append(sets[both, a])
            second.append(sets[both, b])
    owner = np.concatenate(of_set) if of_set else np.zeros(0, np.int64)
    both = np.stack([np.concatenate(first), np.concatenate(second)], 1) if first else np.zeros((0, 2), np.int32)
    joints, pair = np.unique(both, axis=0, return_inverse=True)
    order = np.argsort(owner, kind="stable")
    row = np.zeros(len(sets) + 1, np.int32)
    np.cumsum(np.bincount(owner, minlength=len(sets)), out=row[1:])
    return Pairs(
        joints.astype(np.int32), row, pair.reshape(-1)[order].astype(np.int32), group.reshape(-1).astype(np.int32)
    )


def radii(pairs: Pairs, body: Body) -> Floats:
    """(P,) largest distance of a pair's vertices from the line through the distal joint along its bone, at rest."""
    skeleton, rest = body.skeleton, body.skin.rest
    depth = np.zeros(len(skeleton) + 1, np.int64)
    depth[-1] = -1
    for j, parent in enumerate(skeleton.parents):
        depth[j] = depth[parent] + 1 if parent >= 0 else 0
    out = np.full(len(pairs.joints), FLOOR)
    users = np.argsort(pairs.group, kind="stable")
    starts = np.searchsorted(pairs.group[users], np.arange(len(pairs.row)))
    for group in range(len(pairs.row) - 1):
        points = rest[users[starts[group] : starts[group + 1]]]
        for pair in pairs.pair[pairs.row[group] : pairs.row[group + 1]]:
            a, b = (int(j) for j in pairs.joints[pair])
            near, far = (a, b) if depth[a] <= depth[b] else (b, a)
            center = skeleton.centers[far]
            if near == len(skeleton):  # the influence that does not move: measured from the root
                near = 0
            bone = center - skeleton.centers[near]
            length = np.linalg.norm(bone)
            axis = bone / length if length > 0 else np.array([0.0, 1.0, 0.0])
            away = points - center
            distance = np.linalg.norm(away - (away @ axis)[:, None] * axis, axis=1)
            out[pair] = max(out[pair], float(distance.max(initial=0)))
    return out


@dataclass(frozen=True, eq=False)
class Hybrid:
    """Fades from `linear` to `log` by the largest relative angle among a vertex's joints.

    `tolerance` metres of error that linear blending may make, or `angle` (radians) for all pairs; `fade` False switches
    hard at the angle, as published.
    """

    linear: Linear
    log: Rigid
    tolerance: float = 0.0005
    angle: float | None = None
    fade: bool = True

    @cached_property
    def pairs(self) -> Pairs:
        return pairs_of(self.log.rows)

    @cached_property
    def limit(self) -> Floats:
        """(P,) the angle from which a pair counts as turned."""
        if self.angle is not None:
            return np.full(len(self.pairs.joints), float(self.angle))
        radius = radii(self.pairs, self.log.body)
        return 2 * np.arccos(np.clip(1 - self.tolerance / radius, -1.0, 1.0))

    def shares(self, matrices: Floats) -> NDArray[np.float32]:
        """(F,V) how much of the logarithm each vertex gets."""
        rigid, _ = self.log.factored(matrices)
        q = np.concatenate([from_matrix(rigid), np.tile([0.0, 0, 0, 1], (len(matrices), 1, 1))], axis=1)
        a, b = self.pairs.joints[:, 0], self.pairs.joints[:, 1]
        dots = np.abs(np.sum(q[:, a] * q[:, b], axis=-1))
        angle = 2 * np.arccos(np.minimum(dots, 1.0))
        limit = np.maximum(self.limit, 1e-9)
        if self.fade:
            s = np.clip((angle - limit / 2) / (limit / 2), 0.0, 1.0)
            share = s * s * (3 - 2 * s)
        else:
            share = (angle >= limit).astype(np.float64)
        share[:, self.limit >= np.pi] = 0.0
        share[:, self.limit <= 0] = 1.0
        row = self.pairs.row
        sets = np.zeros((len(matrices), len(row) - 1))
        some = np.flatnonzero(np.diff(row))
        if len(some):
            sets[:, some] = np.maximum.reduceat(share[:, self.pairs.pair], row[some], axis=1)
        return sets[:, self.pairs.group].astype(np.float32)

    def points(self, matrices: Floats, out: NDArray[np.float32], rest: Floats | None = None) -> None:
        self.linear.points(matrices, out, rest)
        self.log.mixed_points(matrices, out, rest, self.shares(matrices))

    def frames(self, matrices: Floats, out: NDArray[np.float32]) -> None:
        self.linear.frames(matrices, out)
        other = np.empty_like(out)
        self.log.frames(matrices, other)
        out += self.shares(matrices)[..., None, None] * (other - out)


@dataclass(frozen=True, eq=False)
class Painted:
    """A per-vertex mix (V,) of the linear (0) and a rigid (1) operator."""

    linear: Linear
    rigid: Rigid
    mix: NDArray[np.float32]

    def points(self, matrices: Floats, out: NDArray[np.float32], rest: Floats | None = None) -> None:
        self.linear.points(matrices, out, rest)
        self.rigid.mixed_points(matrices, out, rest, np.broadcast_to(self.mix, out.shape[:2]))

    def frames(self, matrices: Floats, out: NDArray[np.float32]) -> None:
        self.linear.frames(matrices, out)
        other = np.empty_like(out)
        self.rigid.frames(matrices, other)
        out += self.mix[:, None, None] * (other - out)
