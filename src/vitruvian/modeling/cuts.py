"""Where a body is cut for its contours, and what is left between: head, hands, feet and hips.

Limbs are cut at their joints, across the bisector of the bones; thighs along the way from the hip to the crotch, arms
along that from the shoulder to the armpit. What is not sliced keeps its triangles, divided along those planes; there its
weights become those of the contours it meets, so that both move alike.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Body, Floats, Part, Skin, Weights
from vitruvian.errors import VitruvianError
from vitruvian.modeling.slicing import clipped
from vitruvian.motion.names import VERTEBRAE, joint_index


class Cuts:
    """The planes that a body is cut along."""

    def __init__(self, body: Body):
        self.body = body
        skeleton = body.skeleton
        self.index = joint_index(skeleton.names)
        wanted = [f"{side}_{part}" for side in "lr" for part in
                  ("hip", "knee", "talocrural", "shoulder", "elbow", "radiocarpal")]  # fmt: skip
        missing = [n for n in [*wanted, "vl5", "skullbase"] if n not in self.index]
        if missing:
            raise VitruvianError(f"contours: the body needs the joints {', '.join(missing)}, which it does not have")
        self.centers = skeleton.centers
        self.region = self._regions()
        self.spine = [self.index[v] for v in VERTEBRAE if v in self.index and v[1] in "lt"]
        self.neck = [self.index[v] for v in VERTEBRAE if v in self.index and v[1] == "c"]
        base = self.neck[0] if self.neck else self.index["skullbase"]
        self.neck_height = float(self.centers[base][1])
        self.crotch = self._crotch()
        self.bottom = self._bottom()
        self.planes = self._planes()

    def at(self, name: str) -> Floats:
        return self.centers[self.index[name]]

    def _regions(self) -> NDArray[np.int64]:
        """(V,) 0 trunk, 1 head, 2/3 left/right arm, 4/5 hand, 6/7 leg, 8/9 foot: by the joint of largest weight."""
        skeleton, weights = self.body.skeleton, self.body.skin.weights
        start = {"skullbase": 1}
        for n, side in enumerate("lr"):
            start |= {f"{side}_shoulder": 2 + n, f"{side}_radiocarpal": 4 + n, f"{side}_hip": 6 + n}
            start |= {f"{side}_talocrural": 8 + n}
        of_joint = np.zeros(len(skeleton), np.int64)
        begin = {self.index[name]: code for name, code in start.items()}
        for j, parent in enumerate(skeleton.parents):
            of_joint[j] = begin.get(j, of_joint[parent] if parent >= 0 else 0)
        joint, weight = weights.top(1)
        return np.where(weight[:, 0] > 0, of_joint[joint[:, 0]], 0)

    def _crotch(self) -> Floats:
        """The lowest point between the legs: where the surface crosses the middle plane."""
        rest, triangles = self.body.skin.rest, self.body.skin.triangles
        hips = (self.at("l_hip") + self.at("r_hip")) / 2
        corners = rest[triangles[np.isin(self.region[triangles], (0, 6, 7)).all(axis=1)]]
        x = corners[..., 0] - hips[0]
        crossing = corners[(x.min(axis=1) <= 1e-6) & (x.max(axis=1) >= -1e-6)].mean(axis=1)
        height = float(crossing[:, 1].min()) if len(crossing) else hips[1]
        leg = float(hips[1] - self.at("l_knee")[1])  # trouser legs may touch: not lower than legs have it
        return np.array([hips[0], np.clip(height, hips[1] - 0.25 * leg, hips[1] - 0.12 * leg), hips[2]])

    def _bottom(self) -> float:
        """Height at which the torso ends: above where the planes of the hips leave the body at its sides."""
        hip, rest = self.at("l_hip"), self.body.skin.rest
        near = np.isin(self.region, (0, 6, 7)) & (np.abs(rest[:, 1] - hip[1] - 0.05) < 0.05)
        width = float(np.abs(rest[near, 0] - self.crotch[0]).max()) if near.any() else 2 * hip[0]
        slope = (hip[1] - self.crotch[1]) / abs(hip[0] - self.crotch[0])
        leaves = hip[1] + (width - abs(hip[0] - self.crotch[0])) * slope
        return max(float(self.centers[self.index["vl5"]][1]) - 0.01, float(leaves) + 0.05)

    def armpit(self, side: str) -> Floats:
        """The lowest place where arm and trunk meet."""
        region, triangles, rest = self.region, self.body.skin.triangles, self.body.skin.rest
        codes = region[triangles]
        both = (codes == (2 if side == "l" else 3)).any(axis=1) & (codes == 0).any(axis=1)
        joint = self.at(f"{side}_shoulder")
        near = rest[triangles[both]].mean(axis=1)
        near = near[np.linalg.norm(near - joint, axis=1) < 0.2]
        fallback = joint + np.array([-0.04 if side == "l" else 0.04, -0.09, 0.0])
        return near[np.argmin(near[:, 1])] if len(near) else fallback

    def _planes(self) -> dict[str, tuple[Floats, Floats]]:
        """Point and normal (down the limb) of every cut, by the joint's name."""
        out = {}
        for side, sign in (("l", 1.0), ("r", -1.0)):
            p = lambda name, side=side: self.at(f"{side}_{name}")  # noqa: E731
            hip = p("hip")
            inward = self.crotch - hip  # the plane holds the way from the hip to the crotch
            out[f"{side}_hip"] = (hip, unit(np.array([-inward[1] * sign, -abs(inward[0]), 0.0])))
            pit = self.armpit(side) - p("shoulder")
            out[f"{side}_shoulder"] = (p("shoulder"), unit(np.array([-pit[1] * sign, -abs(pit[0]), 0.0])))
            for a, b, c in (("shoulder", "elbow", "radiocarpal"), ("hip", "knee", "talocrural")):
                out[f"{side}_{b}"] = (p(b), unit(unit(p(b) - p(a)) + unit(p(c) - p(b))))
            out[f"{side}_radiocarpal"] = (p("radiocarpal"), unit(p("radiocarpal") - p("elbow")))
            out[f"{side}_talocrural"] = (p("talocrural"), unit(p("talocrural") - p("knee")))
        skull = self.at("skullbase")
        out["skullbase"] = (skull, unit(np.array([0.0, -1.0, -0.9])))  # below the chin
        out["vl5"] = (np.array([0.0, self.bottom, 0.0]), np.array([0.0, -1.0, 0.0]))
        return out

    def triangles(self, kinds: tuple[int, ...]) -> NDArray[np.int64]:
        """Triangles with a corner in one of the regions, hair and other ornaments apart."""
        skin = self.body.skin
        touched = np.isin(self.region, kinds)
        chosen = touched[skin.triangles[:, 0]] | touched[skin.triangles[:, 1]] | touched[skin.triangles[:, 2]]
        for part in skin.parts:
            if ornament(part):
                chosen[part.start : part.stop] = False
        return np.flatnonzero(chosen)

    def pieces(self) -> Skin:
        """Head, hands, feet and hips: the original triangles, with weights that meet those of the contours."""
        skin, rest = self.body.skin, self.body.skin.rest
        away = {name: (rest - point) @ normal for name, (point, normal) in self.planes.items()}
        inside = np.full(len(rest), -np.inf)
        region = self.region
        for n, side in enumerate("lr"):
            for limb_, joint in ((4, "radiocarpal"), (8, "talocrural")):
                near = np.isin(region, (limb_ + n, limb_ - 2 + n))
                inside = np.where(near, np.maximum(inside, away[f"{side}_{joint}"]), inside)
        head = np.isin(region, (0, 1)) & (rest[:, 1] > self.neck_height - 0.02)
        inside = np.where(head, np.maximum(inside, -away["skullbase"]), inside)
        hips = np.minimum(away["vl5"], -np.maximum(away["l_hip"], away["r_hip"]))
        trunk = np.isin(region, (0, 6, 7)) & ~head
        inside = np.where(trunk, np.maximum(inside, hips), inside)
        whole = np.zeros(len(skin.triangles), bool)
        for part in skin.parts:
            if ornament(part):
                whole[part.start : part.stop] = True
        # The distance jumps where regions meet: only triangles whose corners agree on what cuts them are divided.
        inside = np.where(np.isfinite(inside), inside, -1.0)
        weights = self._blended(away)
        kept, _ = clipped(replace(skin, weights=weights), inside, whole)
        return kept

    def _blended(self, away: dict[str, Floats]) -> Weights:
        """The skin's weights, those of its neighbour taken over near a cut: half at the plane, none beyond a radius."""
        weights, region = self.body.skin.weights, self.region
        table = np.zeros((len(weights), len(self.body.skeleton)))
        table[weights.vertex, weights.joint] = weights.weight
        parents = self.body.skeleton.parents

        def below(joint: int) -> NDArray[np.bool_]:
            out = np.zeros(len(parents), bool)
            for j in range(len(parents)):
                out[j] = j == joint or (parents[j] >= 0 and out[parents[j]])
            return out

        def meet(name: str, near: str | None, kinds: tuple[int, ...], depth: Floats, length: float) -> None:
            """At depth 0 half of `name`, at `length` all of it; the rest to `near`."""
            joint = self.index[name]
            some = np.isin(region, kinds) & (depth > -0.03)
            share = 0.5 + 0.5 * smooth(np.clip(depth[some] / length, 0, 1))
            own = below(joint)
            rows = table[some]
            mine = rows[:, own].sum(axis=1)
            fresh = np.zeros_like(rows)
            fresh[:, own] = np.where(mine[:, None] > 1e-6, rows[:, own] / np.maximum(mine, 1e-6)[:, None], 0)
            fresh[mine <= 1e-6, joint] = 1
            fresh *= share[:, None]
            fresh[:, self.index[near] if near else int(parents[joint])] += 1 - share
            blend = np.clip(depth[some] / (1.5 * length), 0, 1)[:, None] ** 2
            table[some] = (1 - blend) * fresh + blend * rows / np.maximum(rows.sum(axis=1, keepdims=True), 1e-9)

        for n, side in enumerate("lr"):
            meet(f"{side}_radiocarpal", f"{side}_elbow", (4 + n, 2 + n), away[f"{side}_radiocarpal"], 0.04)
            meet(f"{side}_talocrural", f"{side}_knee", (8 + n, 6 + n), away[f"{side}_talocrural"], 0.05)
        meet("skullbase", None, (1,), -away["skullbase"], 0.05)
        self._hips(table, away)
        vertex, joint = np.nonzero(table > 1e-6)
        return Weights.from_pairs(len(weights), vertex, joint, table[vertex, joint])

    def _hips(self, table: Floats, away: dict[str, Floats]) -> None:
        """The upper half of the pelvis goes with the trunk, the lower with the thighs, by the side it is on."""
        rest = self.body.skin.rest
        some = np.isin(self.region, (0, 6, 7)) & (rest[:, 1] < self.bottom + 0.05)
        pelvis = int(self.body.skeleton.parents[self.index["l_hip"]])
        trunk = int(self.body.skeleton.parents[self.index["vl5"]])
        width = abs(self.at("l_hip")[0] - self.at("r_hip")[0]) / 4
        x = rest[some, 0] - self.crotch[0]
        fresh = np.zeros((int(some.sum()), table.shape[1]))
        for side, sign in (("l", 1.0), ("r", -1.0)):
            depth = np.clip(1 + away[f"{side}_hip"][some] / 0.08, 0, 1)
            share = 0.5 * smooth(depth) * smooth(np.clip(sign * x / width, 0, 1))
            share *= smooth(np.clip((self.bottom - rest[some, 1]) / 0.05, 0, 1))  # nothing where the torso begins
            fresh[:, self.index[f"{side}_hip"]] += share
        left = 1 - fresh.sum(axis=1)
        low = smooth(np.clip((self.bottom - rest[some, 1]) / 0.08, 0, 1))
        fresh[:, pelvis] += left * low
        fresh[:, trunk] += left * (1 - low)
        table[some] = fresh


def unit(v: Floats) -> Floats:
    return v / max(float(np.linalg.norm(v)), 1e-12)


def smooth(x: Floats) -> Floats:
    return x * x * (3 - 2 * x)


def ornament(part: Part) -> bool:
    """Parts of the head that are never cut."""
    return any(word in part.name.lower() for word in ("hair", "brow", "lash", "eye", "teeth", "tongue", "beard"))
