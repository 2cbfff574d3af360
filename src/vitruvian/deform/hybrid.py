"""Mixtures of operators: by how far joints turn (`Hybrid`), and painted (`Painted`).

Hybrid: linear blending where joints turn little, the logarithm elsewhere.

Linear blending errs by r (1 - cos(th/2)) at a relative angle th, r the distance from the axis; so the tolerance gives
the angle th0 = 2 acos(1 - tol / r) of each joint pair. Between th0/2 and th0 the two are faded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Body, Floats, Ints
from vitruvian.deform.bind import Influences, Laid
from vitruvian.deform.operators import Linear, Operator, Rigid, Sets

FLOOR = 1e-3  # metres: the least radius that an angle is derived from


def pairs_of(rows: Influences) -> Sets:
    """All pairs of joints that share a vertex. Vertices with the same joints share a set. Limits are zero."""
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
    flat = lambda a: np.ascontiguousarray(a.reshape(-1), dtype=np.int32)  # noqa: E731
    none = np.zeros(len(joints))
    return Sets(
        np.ascontiguousarray(joints, np.int32), row, flat(pair.reshape(-1)[order]), flat(group), none, none, False
    )


def radii(pairs: Sets, body: Body) -> Floats:
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
    """Fades from linear blending to `log` by the largest relative angle among a vertex's joints.

    `tolerance` metres of error that linear blending may make, or `angle` (radians) for all pairs; `fade` False switches
    hard at the angle, as published. Which vertices are blended how is settled for each set of joints once a frame.
    """

    log: Rigid
    tolerance: float = 0.0005
    angle: float | None = None
    fade: bool = True

    @property
    def threads(self) -> int:
        return self.log.threads

    @cached_property
    def sets(self) -> Sets:
        """Pairs of joints, and the angles at which they fade."""
        pairs = pairs_of(self.log.rows)
        if self.angle is not None:
            limit = np.full(len(pairs.joints), float(self.angle))
        else:
            radius = radii(pairs, self.log.body)
            limit = 2 * np.arccos(np.clip(1 - self.tolerance / radius, -1.0, 1.0))
        return replace(pairs, low=limit / 2, high=limit, hard=not self.fade)

    @cached_property
    def laid(self) -> Laid:
        return self.log.laid(self.sets.group)

    def points(self, matrices: Floats, out: NDArray[np.float32], rest: Floats | None = None) -> None:
        share = self.log.shares(matrices, self.sets)
        self.log.faded(matrices, out, rest, share, self.sets.group, self.laid)

    def frames(self, matrices: Floats, out: NDArray[np.float32]) -> None:
        share = self.log.shares(matrices, self.sets)
        self.log.faded(matrices, out, None, share, self.sets.group, self.laid)


@dataclass(frozen=True, eq=False)
class Painted:
    """Operators blended by painted shares: each of `others` has (V,) shares of the result, `base` what they leave."""

    base: Operator
    others: tuple[tuple[Operator, Floats], ...]
    threads: int = 0

    @cached_property
    def kept(self) -> Floats:
        """(V,) the share of `base`."""
        return 1 - np.sum([paint for _, paint in self.others], axis=0)

    @cached_property
    def laid(self) -> tuple[Ints, Laid]:
        """For a rigid operator over linear blending: every vertex is a set of its own."""
        operator, paint = self.others[0]
        assert isinstance(operator, Rigid)
        own = np.arange(len(paint), dtype=np.int32)
        return own, operator.laid(own)

    def points(self, matrices: Floats, out: NDArray[np.float32], rest: Floats | None = None) -> None:
        self._blend(matrices, out, rest)

    def frames(self, matrices: Floats, out: NDArray[np.float32]) -> None:
        self._blend(matrices, out, None)

    def _blend(self, matrices: Floats, out: NDArray[np.float32], rest: Floats | None) -> None:
        operator, paint = self.others[0]
        if isinstance(self.base, Linear) and isinstance(operator, Rigid) and len(self.others) == 1:
            own, laid = self.laid
            operator.faded(matrices, out, rest, paint[None].astype(np.float32), own, laid)
            return
        shape = (-1, *(1,) * (out.ndim - 2))
        _fill(self.base, matrices, out, rest)
        out *= self.kept.astype(np.float32).reshape(shape)
        part = np.empty_like(out)
        for operator, paint in self.others:
            _fill(operator, matrices, part, rest)
            out += paint.astype(np.float32).reshape(shape) * part


def _fill(operator: Operator, matrices: Floats, out: NDArray[np.float32], rest: Floats | None) -> None:
    if out.ndim == 4:
        operator.frames(matrices, out)
    else:
        operator.points(matrices, out, rest)
