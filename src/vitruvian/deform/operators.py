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
from vitruvian.deform.bind import DUAL, Bucket, Influences, lane_buckets, plain_buckets
from vitruvian.deform.motions import RIGID, choose_signs, factor, joint_duals
from vitruvian.deform.se3 import to_frame
from vitruvian.native import kernels

Single = NDArray[np.float32]


class Operator(Protocol):
    def points(self, matrices: Floats, out: Single, rest: Floats | None = None) -> None: ...

    def frames(self, matrices: Floats, out: Single) -> None: ...


@dataclass(frozen=True, eq=False)
class Linear:
    """A = sum w M; what is missing to one in the weights stays at rest."""

    rows: Influences
    rest: Floats
    threads: int = 0

    @cached_property
    def buckets(self) -> tuple[Bucket, ...]:
        return plain_buckets(self.rows, self.rest)

    def points(self, matrices: Floats, out: Single, rest: Floats | None = None) -> None:
        native = kernels()
        if native is None:
            points = self.rest if rest is None else rest
            for f, frame in enumerate(matrices):
                out[f] = apply(twins.linear(self.rows, frame), points)
            return
        table = native.linear_table(matrices)
        for b in self.buckets:
            moved = b if rest is None else b.moved(rest)
            _linear(native, table, moved, out, self.threads)

    def frames(self, matrices: Floats, out: Single) -> None:
        native = kernels()
        if native is None:
            for f, frame in enumerate(matrices):
                out[f] = twins.linear(self.rows, frame)
            return
        table, flat = native.linear_table(matrices), out.reshape(len(out), -1, 12)
        for b in self.buckets:
            _linear(native, table, b, flat, self.threads)


def _linear(native: ModuleType, table: Single, b: Bucket, out: Single, threads: int) -> None:
    native.linear(table, b.rest, b.joint, b.weight, b.row, b.target, b.width, b.count, out, threads)


@dataclass(frozen=True, eq=False)
class Rigid:
    """Blends rigid motions: `kind` "dual-quaternion", "log", "log-pair" or "log-absolute".

    Scaled joint matrices are factored: the stretches blend linearly and come first.
    `follow` keeps the sign of relative turns from frame to frame ("dual-quaternion" and "log").
    """

    kind: str
    body: Body
    rows: Influences
    steps: int = 1
    follow: bool = True
    threads: int = 0

    @cached_property
    def buckets(self) -> tuple[Bucket, ...]:
        rows = self.rows
        if self.kind == "log-pair":  # the kernel blends the motions of pairs
            rows = Influences(rows.row, rows.pairs[1], rows.weight, rows.joints)
        return lane_buckets(rows, self.body.skin.rest)

    @cached_property
    def bases(self) -> list[Ints]:
        """The joint with the largest weight of each vertex, as each bucket lays vertices out."""
        pivot = self.rows.joint[self.rows.row[:-1]][:, None]
        return [b.lay(pivot).astype(np.int32) * np.int32(DUAL) for b in self.buckets]

    @cached_property
    def used(self) -> Ints:
        """The joints that move something."""
        used = np.unique(self.rows.joint)
        return used[used < self.rows.joints]

    @cached_property
    def stretch(self) -> Linear:
        """Blends the stretches, with the same weights."""
        real = self.rows.joint < self.rows.joints
        row = np.concatenate([[0], np.cumsum(real)])[self.rows.row].astype(np.int32)
        rows = Influences(row, self.rows.joint[real], self.rows.weight[real], self.rows.joints)
        return Linear(rows, self.body.skin.rest, self.threads)

    def points(self, matrices: Floats, out: Single, rest: Floats | None = None) -> None:
        self.mixed_points(matrices, out, rest, None)

    def mixed_points(self, matrices: Floats, out: Single, rest: Floats | None, mix: Single | None) -> None:
        """`points`, of which (F,V) `mix` replaces what is in `out`; None replaces it all."""
        rigid, stretches = self.factored(matrices)
        if stretches is None:
            self._run(rigid, out, rest, mix)
            return
        first = np.empty((1, *out.shape[1:]), np.float32)
        for f in range(len(matrices)):
            self.stretch.points(stretches[f : f + 1], first, rest)
            part = None if mix is None else mix[f : f + 1]
            self._run(rigid[f : f + 1], out[f : f + 1], first[0].astype(np.float64), part)

    def frames(self, matrices: Floats, out: Single) -> None:
        rigid, stretches = self.factored(matrices)
        self._run(rigid, out, None, None)
        if stretches is None:
            return
        first = np.empty_like(out[:1])
        for f in range(len(matrices)):
            self.stretch.frames(stretches[f : f + 1], first)
            linear = out[f, :, :, :3].copy()
            out[f, :, :, :3] = linear @ first[0, :, :, :3]
            out[f, :, :, 3] += np.einsum("vab,vb->va", linear, first[0, :, :, 3])

    def factored(self, matrices: Floats) -> tuple[Floats, Floats | None]:
        """Rigid motions, and stretches if there are any: see `motions.factor`."""
        native = kernels()
        if native is not None and native.deviation(matrices) <= RIGID:
            return matrices, None
        return factor(matrices, self.body.skeleton, self.used)

    def _run(self, rigid: Floats, out: Single, rest: Floats | None, mix: Single | None) -> None:
        native = kernels()
        if native is None:
            self._run_numpy(rigid, out, rest, mix)
            return
        table, steps, agree, bases = self._table(native, rigid)
        flat = out.reshape(len(out), -1, 12) if out.ndim == 4 else out
        mix = None if mix is None else np.ascontiguousarray(mix)
        for i, b in enumerate(self.buckets):
            points = b.rest if rest is None else b.lay(rest)
            base = None if bases is None else self.bases[i]
            shape = (b.joint, b.weight, b.uniform, b.target, b.count)
            native.rigid(table, steps, agree, bases, base, points, *shape, mix, flat, self.threads)

    def _table(self, native: ModuleType, rigid: Floats) -> tuple[Single, int, NDArray | None, Single | None]:
        """What the kernel blends: dual quaternions, or half twists (steps -1) with their base motions."""
        if self.kind in ("log", "dual-quaternion"):
            tree, left = self.rows.chain
            table, agree = native.dual_table(rigid, tree, left, self.follow)
            return table, self.steps if self.kind == "log" else 0, agree, None
        duals = joint_duals(rigid)
        if self.kind == "log-pair":
            return half(twins.pair_twists(self.rows.pairs[0], duals)), -1, None, duals.astype(np.float32)
        return half(twins.joint_twists(duals)), -1, None, None

    def _run_numpy(self, rigid: Floats, out: Single, rest: Floats | None, mix: Single | None) -> None:
        points = self.body.skin.rest if rest is None else rest
        for f, dual in enumerate(self._blend(rigid)):
            frame = to_frame(dual)
            if out.ndim == 4:
                out[f] = frame
            elif mix is None:
                out[f] = apply(frame, points)
            else:
                out[f] += mix[f][:, None] * (apply(frame, points) - out[f])

    def _blend(self, rigid: Floats) -> list[Floats]:
        duals = joint_duals(rigid)
        if self.kind == "log-pair":
            return [twins.log_pair(self.rows, d) for d in duals]
        if self.kind == "log-absolute":
            return [twins.log_absolute(self.rows, d) for d in duals]
        steps = self.steps if self.kind == "log" else 0
        duals, agree = choose_signs(duals, self.rows, follow=self.follow)
        return [twins.log(self.rows, d, steps, signed=bool(a)) for d, a in zip(duals, agree, strict=True)]


def half(twists: Floats) -> Single:
    """Twists (...,6) as the kernel wants them, (...,8): half of each part, and a zero."""
    out = np.zeros((*twists.shape[:-1], 8), np.float32)
    out[..., :3], out[..., 4:7] = twists[..., :3] / 2, twists[..., 3:] / 2
    return out


def apply(frames: Floats, points: Floats) -> Floats:
    """(V,3): each point (V,3) by its own (V,3,4)."""
    return np.einsum("vab,vb->va", frames[..., :3], points) + frames[..., 3]
