"""The "contours" operator: every contour of a surface moves as one piece, by shares of its joints' rotations.

A contour's motion is the product, root to tip, of the share of each joint's local motion that it takes: the joint's axis
with a part of its angle, about the joint's centre. At a seam both surfaces take a half, by the same arithmetic, so that
nothing opens. Vertices that belong to no contour move by their weights ("log").

Source: cross-section deformation of H-Anim bodies, formulas (2) and (3); the exact twist is swing-twist about the bone.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.contours import Contours
from vitruvian.body.types import Body, Floats, Ints, Skeleton, Skin, Weights
from vitruvian.deform.bind import Influences, bind, plain_buckets
from vitruvian.deform.contour_steps import Program, motions, program
from vitruvian.deform.hybrid import Painted
from vitruvian.deform.motions import RIGID, factor
from vitruvian.deform.operators import Linear, Rigid
from vitruvian.deform.survey import Slabs, slabs, surveyed
from vitruvian.native import kernels

Single = NDArray[np.float32]
ROUND = 0.3  # of "log" in what skins vertices outside the contours, the rest is "linear": shoulders swell less


def retwisted(surfaces: Collection[Contours]) -> list[Contours]:
    """Surfaces of one contour that moves as vertices outside the contours see the surface's own joint move: see
    `ContourOperator.seen`. None for joints that they see as they are."""
    found: dict[int, Contours] = {}
    for s in surfaces:
        if s.wound is not None:
            bent = np.tri(len(s.joints))  # with a joint all below it are bent
            for k in np.flatnonzero((s.wound != bent).any(axis=1)).tolist():
                used = np.arange(len(s.joints)) <= max(k, int(np.flatnonzero(s.wound[k]).max(initial=0)))
                found[int(s.joints[k])] = Contours(
                    s.name, int(s.joints[k]), s.vertices[:1], s.joints[used], bent[[k]][:, used], s.wound[[k]][:, used],
                    s.axes[used],
                )  # fmt: skip
            continue
        if s.joint != s.joints[0]:
            continue
        whole = np.ones((1, len(s.joints)))
        if s.twist[0, 0] == 0 and s.swing[0, 0] > 0 and (s.tied[:, 1] == 0).any():
            keep, swing, twist = 1, whole[:, :1], np.zeros((1, 1))
        elif len(s.joints) == 2 and s.twist[-1, 1] == 1 and (s.tied[:, 1] == len(s) - 1).any():
            keep, swing, twist = 2, np.array([[1.0, 0.0]]), np.ones((1, 2))
        else:
            continue
        found[s.joint] = Contours(s.name, s.joint, s.vertices[:1], s.joints[:keep], swing, twist, s.axes[:keep])
    return list(found.values())


@dataclass(frozen=True, eq=False)
class ContourOperator:
    """The operator of a body with contours. `off`: names of surfaces that follow their joint as rigid pieces.

    `survey`: contours widen or narrow where a bend would change the volume between them.
    """

    body: Body
    off: frozenset[str] = frozenset()
    survey: bool = False
    follow: bool = True
    threads: int = 0
    paper: bool = False
    spared: NDArray[np.bool_] | None = None  # (V,) points that somebody else sets: `points` may leave anything there

    @cached_property
    def program(self) -> Program:
        surfaces = [s.rigid if s.name in self.off else s for s in self.body.contours]
        return program(self.body, surfaces, paper=self.paper)

    @cached_property
    def slabs(self) -> Slabs:
        return slabs(self.body, self.body.contours)

    @cached_property
    def owner(self) -> NDArray[np.int64]:
        """(V,) the contour of each vertex, -1 for those in none."""
        out = np.full(len(self.body.skin.rest), -1, np.int64)
        first = 0
        for surface in self.body.contours:
            out[surface.vertices] = first + np.arange(len(surface))[:, None]
            out[surface.tied[:, 0]] = first + surface.tied[:, 1]
            first += len(surface)
        return out

    @cached_property
    def seen(self) -> tuple[Ints, Program] | None:
        """Joints that vertices outside the contours, if any, see turned otherwise, and how: without the twist that contours
        sewn to them spread below, and with the twist that contours have taken up above."""
        weights = self.body.skin.weights
        used = np.unique(weights.joint[self.owner[weights.vertex] < 0])
        found = [s for s in self._retwisted if s.joint in used]
        if not found:
            return None
        return np.array([s.joint for s in found], np.int32), program(self.body, found, paper=self.paper)

    @cached_property
    def _retwisted(self) -> list[Contours]:
        return retwisted([s for s in self.body.contours if s.name not in self.off])

    @property
    def retwists(self) -> dict[int, list[int]]:
        """For the joints of `seen`, whose turns they are seen to have shares of."""
        return {s.joint: list(s.joints) for s in self._retwisted}

    @cached_property
    def carried(self) -> Linear:
        """Moves each vertex by its contour, or by the joint that alone holds it."""
        joints = len(self.body.skeleton)
        single = self._single
        motion = np.where(self.owner >= 0, self.owner + joints, single)
        some = np.flatnonzero(motion >= 0)
        row = np.zeros(len(motion) + 1, np.int32)
        row[1:] = np.cumsum(motion >= 0)
        rows = Influences(row, motion[some].astype(np.int32), np.ones(len(some)), joints + len(self.program))
        left = None if self.spared is None else np.flatnonzero(~self.spared & (motion >= 0)).astype(np.int32)
        # One joint each: lanes would only cut contours into pieces.
        return Linear(rows, self.body.skin.rest, self.threads, layout=plain_buckets(rows, self.body.skin.rest, left))

    @cached_property
    def _single(self) -> NDArray[np.int64]:
        """(V,) the one joint that holds a vertex with all its weight, else -1."""
        weights = self.body.skin.weights
        alone = (weights.counts == 1) & (np.abs(weights.sums - 1) < 1e-6)
        out = np.full(len(weights), -1, np.int64)
        out[alone] = weights.joint[weights.row[:-1][alone]]
        return out

    @cached_property
    def rest_of_skin(self) -> Ints:
        """Vertices that neither a contour nor a single joint moves."""
        return np.flatnonzero((self.owner < 0) & (self._single < 0)).astype(np.int32)

    @cached_property
    def _alike(self) -> tuple[Ints, NDArray[np.int64]]:
        """Vertices out of `rest_of_skin`, and which of them moves each: where one point is there several times, with
        the same weights, one is computed for all, so that they stay together to the bit."""
        skin, chosen = self.body.skin, self.rest_of_skin
        w, mark = skin.weights, np.random.default_rng(0).random((2, len(self.body.skeleton)))
        marks = [np.bincount(w.vertex, w.weight * m[w.joint], minlength=len(w)) for m in mark]
        key = np.concatenate([skin.rest[chosen], np.stack(marks, axis=1)[chosen]], axis=1)
        _, first, place = np.unique(key, axis=0, return_index=True, return_inverse=True)
        order = np.argsort(first, kind="stable")
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        return chosen[first[order]], rank[place.reshape(-1)]

    @cached_property
    def blended(self) -> tuple[Painted, Ints]:
        """What moves `_alike[0]`, and the joints whose matrices it takes: few bodies need all of them, though what is on
        the way to the root counts for the signs of turns."""
        skin, skeleton, chosen = self.body.skin, self.body.skeleton, self._alike[0]
        weights = skin.weights
        place = np.full(len(weights), -1, np.int64)
        place[chosen] = np.arange(len(chosen))
        keep = place[weights.vertex] >= 0
        needed = np.zeros(len(skeleton), bool)
        needed[weights.joint[keep]] = True
        needed[0] |= not needed.any()
        for j in range(len(skeleton) - 1, 0, -1):  # parents come first
            needed[skeleton.parents[j]] |= needed[j] and skeleton.parents[j] >= 0
        used, number = np.flatnonzero(needed).astype(np.int32), np.cumsum(needed) - 1
        parents = np.where(skeleton.parents[used] >= 0, number[skeleton.parents[used]], -1)
        some = Weights.from_pairs(
            len(chosen), place[weights.vertex[keep]], number[weights.joint[keep]], weights.weight[keep]
        )
        own = Skeleton(tuple(skeleton.names[j] for j in used), parents, skeleton.centers[used])
        body = Body(self.body.name, own, Skin(skin.rest[chosen], np.zeros((0, 3), np.int32), some))
        linear = Linear(bind(some, len(used)), body.skin.rest, self.threads)
        rigid = Rigid("log", body, bind(some, len(used), rigid=True), 1, self.follow, self.threads)
        return Painted(linear, ((rigid, np.full(len(chosen), ROUND)),), self.threads), used

    @cached_property
    def stretch(self) -> Linear:
        return Linear(bind(self.body.skin.weights, len(self.body.skeleton)), self.body.skin.rest, self.threads)

    def _motions(self, matrices: Floats) -> tuple[Floats, Floats | None]:
        """(F,J+C,4,4) of joints as vertices outside the contours see them, and of contours; stretches if there are any."""
        native, stretches = kernels(), None
        if native is None or native.deviation(matrices) > RIGID:
            used = np.arange(len(self.body.skeleton), dtype=np.int32)
            matrices, stretches = factor(matrices, self.body.skeleton, used)
        both, joints = motions(self.program, matrices, follow=self.follow), matrices.shape[1]
        if self.survey:
            both[:, joints:] = surveyed(both[:, joints:], self.program.middle, self.program.along, self.slabs)
        if self.seen is not None:
            own, turns = self.seen
            both[:, own] = motions(turns, matrices, follow=self.follow, with_joints=False)
        return both, stretches

    def points(self, matrices: Floats, out: Single, rest: Floats | None = None) -> None:
        both, stretches = self._motions(matrices)
        if stretches is None:
            self._points(both, out, rest)
            return
        first = np.empty_like(out[:1])
        for f in range(len(matrices)):  # sizes first, as the rigid operators do it
            self.stretch.points(stretches[f : f + 1], first, rest)
            self._points(both[f : f + 1], out[f : f + 1], first[0].astype(np.float64))

    def _points(self, both: Floats, out: Single, rest: Floats | None) -> None:
        self.carried.points(both, out, rest)
        if len(self.rest_of_skin):
            chosen, place = self._alike
            part = np.empty((len(out), len(chosen), 3), np.float32)
            blended, used = self.blended
            blended.points(both[:, used], part, None if rest is None else rest[chosen])
            out[:, self.rest_of_skin] = part if len(chosen) == len(place) else part[:, place]

    def frames(self, matrices: Floats, out: Single) -> None:
        both, _ = self._motions(matrices)
        self.carried.frames(both, out)
        if len(self.rest_of_skin):
            chosen, place = self._alike
            part = np.empty((len(out), len(chosen), 3, 4), np.float32)
            blended, used = self.blended
            blended.frames(both[:, used], part)
            out[:, self.rest_of_skin] = part[:, place]
