"""Operators bound to a body: joint matrices of all frames in, points or frames of all vertices out.

An operator has `points(matrices (F,J,4,4), out (F,V,3) float32, rest)` and `frames(matrices, out (F,V,3,4) float32)`,
which fill `out`; `rest` (V,3) replaces the body's rest positions. With the extension they call kernels, without it the
twins.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Body, Floats, Ints
from vitruvian.deform import twins
from vitruvian.deform.bind import DUAL, Bucket, Influences, Laid, lane_buckets, linear_buckets
from vitruvian.deform.motions import RIGID, chain, choose_signs, factor, joint_duals
from vitruvian.deform.se3 import to_frame
from vitruvian.native import kernels

Single = NDArray[np.float32]
SIGNED = ("log", "dual-quaternion")  # kinds that the kernel blends as dual quaternions


class Operator(Protocol):
    def points(self, matrices: Floats, out: Single, rest: Floats | None = None) -> None: ...

    def frames(self, matrices: Floats, out: Single) -> None: ...


@dataclass(frozen=True, eq=False)
class Linear:
    """A = sum w M; what is missing to one in the weights stays at rest.

    `layout`: how vertices are laid out for the kernel, if not as `linear_buckets` does; those in no bucket are left alone.
    """

    rows: Influences
    rest: Floats
    threads: int = 0
    layout: tuple[Bucket, ...] | None = None

    @cached_property
    def buckets(self) -> tuple[Bucket, ...]:
        return linear_buckets(self.rows, self.rest) if self.layout is None else self.layout

    @cached_property
    def laid(self) -> Laid:
        return Laid(self.buckets)

    def points(self, matrices: Floats, out: Single, rest: Floats | None = None) -> None:
        native = kernels()
        if native is None:
            points = self.rest if rest is None else rest
            for f, frame in enumerate(matrices):
                out[f] = apply(twins.linear(self.rows, frame), points)
            return
        native.linear(self.laid.program(rest), native.linear_table(matrices), out, self.threads)

    def frames(self, matrices: Floats, out: Single) -> None:
        native = kernels()
        if native is None:
            for f, frame in enumerate(matrices):
                out[f] = twins.linear(self.rows, frame)
            return
        flat = out.reshape(len(out), -1, 12)
        native.linear(self.laid.program(None), native.linear_table(matrices), flat, self.threads)


@dataclass(frozen=True, eq=False)
class Rigid:
    """Blends rigid motions: `kind` "dual-quaternion", "log", "log-pair" or "log-absolute".

    Scaled joint matrices are factored: the stretches blend linearly and come first.
    `follow` keeps the sign of relative turns from frame to frame (not "log-absolute"), `memory` also from call to call.
    """

    kind: str
    body: Body
    rows: Influences
    steps: int = 1
    follow: bool = True
    threads: int = 0
    memory: Floats | None = None

    @cached_property
    def buckets(self) -> tuple[Bucket, ...]:
        rows = self.rows
        if self.kind == "log-pair":  # the kernel blends the motions of pairs
            rows = Influences(rows.row, rows.pairs[1], rows.weight, rows.joints)
        return lane_buckets(rows, self.body.skin.rest)

    @cached_property
    def plain(self) -> Laid:
        """The buckets, for "log-pair" with the joint with the largest weight of each vertex."""
        if self.kind != "log-pair":
            return Laid(self.buckets)
        pivot = self.rows.joint[self.rows.row[:-1]][:, None]
        return Laid(self.buckets, tuple({"base": b.lay(pivot).astype(np.int32) * np.int32(DUAL)} for b in self.buckets))

    @cached_property
    def used(self) -> Ints:
        """The joints that move something."""
        used = np.unique(self.rows.joint)
        return used[used < self.rows.joints]

    @cached_property
    def chain(self) -> tuple[Ints, Ints]:
        """Edges along which signs of motions agree: see `motions.chain`."""
        return chain(self.rows, self.body.skeleton)

    @cached_property
    def unscaled(self) -> Linear:
        """Linear blending with the same weights."""
        real = self.rows.joint < self.rows.joints
        row = np.concatenate([[0], np.cumsum(real)])[self.rows.row].astype(np.int32)
        rows = Influences(row, self.rows.joint[real], self.rows.weight[real], self.rows.joints)
        return Linear(rows, self.body.skin.rest, self.threads)

    def points(self, matrices: Floats, out: Single, rest: Floats | None = None) -> None:
        rigid, stretches = self.factored(matrices)
        if stretches is None:
            self._run(rigid, out, rest)
            return
        first = np.empty((1, *out.shape[1:]), np.float32)
        for f in range(len(matrices)):  # sizes first
            self.unscaled.points(stretches[f : f + 1], first, rest)
            self._run(rigid[f : f + 1], out[f : f + 1], first[0].astype(np.float64))

    def frames(self, matrices: Floats, out: Single) -> None:
        rigid, stretches = self.factored(matrices)
        self._run(rigid, out, None)
        if stretches is None:
            return
        first = np.empty_like(out[:1])
        for f in range(len(matrices)):
            self.unscaled.frames(stretches[f : f + 1], first)
            linear = out[f, :, :, :3].copy()
            out[f, :, :, :3] = linear @ first[0, :, :, :3]
            out[f, :, :, 3] += np.einsum("vab,vb->va", linear, first[0, :, :, 3])

    def laid(self, group: Ints) -> Laid:
        """With the set (V,) of each vertex; for `faded`."""
        return Laid(self.buckets, tuple({"set": b.lay(group[:, None]).astype(np.int32)} for b in self.buckets))

    def faded(
        self,
        matrices: Floats,
        out: Single,
        rest: Floats | None,
        share: Single,
        group: Ints,
        sets: Laid,
    ) -> None:
        """`points` into out (F,V,3), or `frames` into out (F,V,3,4), mixed with linear blending.

        `share` (F or 1, S) of this operator in the result for each set, `group` (V,) the set of each vertex, laid out in
        `sets`.
        """
        if kernels() is not None and self.kind in SIGNED and self.factored(matrices)[1] is None:
            self._run(matrices, out, rest, sets, share)
            return
        other = np.empty_like(out)
        if out.ndim == 4:
            self.unscaled.frames(matrices, out)
            self.frames(matrices, other)
        else:
            self.unscaled.points(matrices, out, rest)
            self.points(matrices, other, rest)
        out += share[:, group].reshape(len(share), len(group), *(1,) * (out.ndim - 2)) * (other - out)

    def centred(self, matrices: Floats, out: Single, rest: Floats | None, centers: Laid, share: Single) -> bool:
        """Points that turn about moving centres in buckets that have them, as far as `share` (1,V) says; False where only
        the twins can do it."""
        if kernels() is None or self.factored(matrices)[1] is not None:
            return False
        self._run(matrices, out, rest, centers, share)
        return True

    def shares(self, matrices: Floats, sets: Sets) -> Single:
        """(F,S) how much of the motion each set of joint pairs gets, by the largest angle between two of its joints."""
        native = kernels()
        rigid = self.factored(matrices)[0]
        tree, left = self.chain
        if native is not None:
            s = (sets.joints, sets.low, sets.high, sets.hard, sets.row, sets.pair)
            return native.turn_shares(rigid, tree, left, self.follow, self.memory, *s)
        duals, agree = choose_signs(joint_duals(rigid), *self.chain, follow=self.follow, memory=self.memory)
        return sets.shares(duals, agree)

    def factored(self, matrices: Floats) -> tuple[Floats, Floats | None]:
        """Rigid motions, and stretches if there are any: see `motions.factor`."""
        native = kernels()
        if native is not None and native.deviation(matrices) <= RIGID:
            return matrices, None
        return factor(matrices, self.body.skeleton, self.used)

    def _run(
        self, rigid: Floats, out: Single, rest: Floats | None, laid: Laid | None = None, share: Single | None = None
    ) -> None:
        native = kernels()
        if native is None:
            self._run_numpy(rigid, out, rest)
            return
        table, steps, agree, bases = self._table(native, rigid)
        flat = out.reshape(len(out), -1, 12) if out.ndim == 4 else out
        if laid is None:
            native.rigid(self.plain.program(rest), table, steps, agree, bases, flat, self.threads)
        else:
            linear = native.linear_table(rigid, True)
            native.rigid(laid.program(rest), table, steps, agree, bases, flat, self.threads, linear, share)

    def _table(self, native: ModuleType, rigid: Floats) -> tuple[Single, int, NDArray | None, Single | None]:
        """What the kernel blends: dual quaternions, or half twists (steps -1) with their base motions."""
        tree, left = self.chain
        if self.kind in SIGNED:
            table, agree = native.dual_table(rigid, tree, left, self.follow, self.memory)
            return table, self.steps if self.kind == "log" else 0, agree, None
        if self.kind == "log-pair":
            twists, duals = native.twist_table(rigid, tree, left, self.follow, self.memory, self.rows.pairs[0])
            return twists, -1, None, duals
        joints = self.rows.joints
        from_rest = np.stack([np.full(joints + 1, joints), np.arange(joints + 1)], axis=1).astype(np.int32)
        return native.twist_table(rigid, tree[:0], left[:0], False, None, from_rest)[0], -1, None, None

    def _run_numpy(self, rigid: Floats, out: Single, rest: Floats | None) -> None:
        points = self.body.skin.rest if rest is None else rest
        for f, dual in enumerate(self._blend(rigid)):
            frame = to_frame(dual)
            out[f] = frame if out.ndim == 4 else apply(frame, points)

    def _blend(self, rigid: Floats) -> list[Floats]:
        duals = joint_duals(rigid)
        if self.kind == "log-absolute":
            return [twins.log_absolute(self.rows, d) for d in duals]
        steps = self.steps if self.kind == "log" else 0
        duals, agree = choose_signs(duals, *self.chain, follow=self.follow, memory=self.memory)
        if self.kind == "log-pair":
            return [twins.log_pair(self.rows, d, signed=bool(a)) for d, a in zip(duals, agree, strict=True)]
        return [twins.log(self.rows, d, steps, signed=bool(a)) for d, a in zip(duals, agree, strict=True)]


@dataclass(frozen=True, eq=False)
class Sets:
    """Joint pairs in use (P,2), and sets of pairs: rows `row` (S+1,) of `pair`; `group` (V,) the set of each vertex.

    A set fades from 0 to 1 while the largest angle of its pairs goes from `low` to `high` (P,) radians; `hard`: at once.
    """

    joints: Ints
    row: Ints
    pair: Ints
    group: Ints
    low: Floats
    high: Floats
    hard: bool

    def shares(self, duals: Floats, agree: NDArray[np.bool_]) -> Single:
        """(F,S) of dual quaternions (F,J+1,8), whose signs count in the frames that `agree`."""
        a, b = self.joints[:, 0], self.joints[:, 1]
        dots = np.sum(duals[:, a, :4] * duals[:, b, :4], axis=-1)
        dots = np.where(agree[:, None], dots, np.abs(dots))
        angle = 2 * np.arccos(np.clip(dots, -1.0, 1.0))
        if self.hard:
            share = (angle >= self.high).astype(np.float64)
        else:
            s = np.clip((angle - self.low) / np.maximum(self.high - self.low, 1e-300), 0.0, 1.0)
            share = s * s * (3 - 2 * s)
        share[:, self.high >= np.pi] = 0.0
        share[:, self.high <= 0] = 1.0
        out = np.zeros((len(duals), len(self.row) - 1), np.float32)
        some = np.flatnonzero(np.diff(self.row))
        if len(some):
            out[:, some] = np.maximum.reduceat(share[:, self.pair], self.row[some], axis=1)
        return out


def apply(frames: Floats, points: Floats) -> Floats:
    """(V,3): each point (V,3) by its own (V,3,4)."""
    return np.einsum("vab,vb->va", frames[..., :3], points) + frames[..., 3]
