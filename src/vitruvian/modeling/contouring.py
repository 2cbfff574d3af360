"""Any body as a contour body: limbs, torso and neck sliced into contours, head, hands, feet and hips cut along them.

Contours lie in planes that turn from the bisector of one joint to that of the next, so that a bent knee has them evenly
spaced; their points are where rays from the bone meet the outermost surface. The torso is a front and a back. What is
not sliced keeps its triangles and is cut along the planes of the contours it meets; there its weights are those of the
contours, so that both move alike.

Source: cross-section deformation of H-Anim bodies (pre-oriented contours, torso in two halves, ExtrContour).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.contours import Contours, grid, limb, spine_shares
from vitruvian.body.types import Body, Floats, Ints, Part, Skin, Weights
from vitruvian.errors import VitruvianError
from vitruvian.modeling.slicing import Rings, clipped, joined, rings
from vitruvian.motion.names import VERTEBRAE, joint_index

FRONT = np.array([0.0, 0.0, 1.0])
FIXED = 3  # contours of an arm or thigh that stay with the trunk


@dataclass(frozen=True, eq=False)
class Sliced:
    """One surface: its name, the segment's joint, rings, and how many of its contours each zone has."""

    name: str
    joint: int
    rings: Rings
    surface: Contours  # with vertices numbered from 0


@dataclass(frozen=True, eq=False)
class ContourBody:
    """`body` has contours; `error` (mean, largest) metres between its surface and that of the original."""

    body: Body
    error: tuple[float, float]


def contoured(body: Body, *, density: float = 1.0, mitre: float = 1.0, diversion: float = 0.0) -> ContourBody:
    """The contour form of a body with hips, knees, ankles, shoulders, elbows, wrists, a spine joint and a skull.

    `density` scales the number of contours and of points in each. `mitre` and `diversion`, 0..1, for all limbs.
    Raises VitruvianError naming the joints that are missing, and for a surface that the slices do not meet.
    """
    plan = Plan(body, density, mitre, diversion)
    surfaces = plan.limbs() + plan.trunk()
    return _assembled(body, surfaces, plan.pieces())


@dataclass(frozen=True)
class Limb:
    """A limb between two joints, by names without side: how it is sliced at density 1.

    `regions`: left-side codes of what may be met (see `Plan._regions`; 0 is the trunk). `reach` (m) outwards. The first
    `fixed` contours stand in the trunk and stay with it. `next_spread`: the next joint's surface spreads its twist.
    """

    name: str
    near: str
    far: str
    regions: tuple[int, int]
    points: int
    contours: int
    reach: float
    fixed: int
    next_spread: bool
    roundness: float = 1.8


LIMBS = (
    Limb("upperarm", "shoulder", "elbow", (2, 0), 20, 18, 0.12, FIXED, True, 1.35),
    Limb("forearm", "elbow", "radiocarpal", (2, 4), 20, 16, 0.09, 0, False),
    Limb("thigh", "hip", "knee", (6, 0), 26, 20, 0.17, 0, True),
    Limb("calf", "knee", "talocrural", (6, 8), 26, 18, 0.12, 0, False),
)


class Plan:
    """Where everything is cut. Limbs are worked out on demand and remembered by name."""

    def __init__(self, body: Body, density: float, mitre: float, diversion: float):
        self.body, self.density, self.mitre, self.diversion = body, density, mitre, diversion
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

    def _armpit(self, side: str) -> Floats:
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
            out[f"{side}_hip"] = (hip, _unit(np.array([-inward[1] * sign, -abs(inward[0]), 0.0])))
            pit = self._armpit(side) - p("shoulder")
            out[f"{side}_shoulder"] = (p("shoulder"), _unit(np.array([-pit[1] * sign, -abs(pit[0]), 0.0])))
            for a, b, c in (("shoulder", "elbow", "radiocarpal"), ("hip", "knee", "talocrural")):
                out[f"{side}_{b}"] = (p(b), _unit(_unit(p(b) - p(a)) + _unit(p(c) - p(b))))
            out[f"{side}_radiocarpal"] = (p("radiocarpal"), _unit(p("radiocarpal") - p("elbow")))
            out[f"{side}_talocrural"] = (p("talocrural"), _unit(p("talocrural") - p("knee")))
        skull = self.at("skullbase")
        out["skullbase"] = (skull, _unit(np.array([0.0, -1.0, -0.9])))  # below the chin
        out["vl5"] = (np.array([0.0, self.bottom, 0.0]), np.array([0.0, -1.0, 0.0]))
        return out

    def limbs(self) -> list[Sliced]:
        out = [self._limb(side, number, spec) for number, side in enumerate("lr") for spec in LIMBS]
        for above, below in zip(out[::2], out[1::2], strict=True):  # a seam is one loop, of both surfaces
            for field in ("points", "face", "barycentric"):
                getattr(below.rings, field)[0] = getattr(above.rings, field)[-1]
        return out

    def _limb(self, side: str, number: int, spec: Limb) -> Sliced:
        name, near, far, fixed = f"{side}_{spec.name}", f"{side}_{spec.near}", f"{side}_{spec.far}", spec.fixed
        points, count = max(6, round(spec.points * self.density)), max(8, round(spec.contours * self.density))
        start, end = self.at(near), self.at(far)
        axis, length = _unit(end - start), float(np.linalg.norm(end - start))
        (_, first), (_, last) = self.planes[near], self.planes[far]
        step = length / (count - 1 - fixed)
        s = np.arange(-fixed, count - fixed) * step / length  # contours above the joint stay with the trunk
        s[:fixed] *= 0.6
        t = np.clip(s, 0, 1)[:, None]
        normal = (1 - t) ** 2 * first + 2 * t * (1 - t) * axis + t**2 * last
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        centers = start + s[:, None] * length * axis
        for k in range(fixed):  # back along the first plane's own normal
            centers[k] = start + s[k] * length * first
        chosen = self._triangles(tuple(k + number if k else 0 for k in spec.regions))
        made = rings(self.body.skin.rest, self.body.skin.triangles, chosen, centers, normal, points=points,
                     reach=spec.reach, forward=FRONT, roundness=spec.roundness)  # fmt: skip
        middle = made.points[:fixed].mean(axis=1, keepdims=True)  # what stands in the trunk stays below its surface
        made.points[:fixed] += 0.04 * (middle - made.points[:fixed])
        radius = float(np.median(np.linalg.norm(made.points - made.points.mean(axis=1, keepdims=True), axis=2)))
        ramp = int(np.clip(round(radius / step), 2, (count - fixed) // 2 - 1))
        below = self.body.skeleton.parents == self.index[far]
        after = self.centers[below][0] - end if below.any() else axis
        numbers = np.arange(count * points, dtype=np.int32).reshape(count, points)
        surface = limb(
            f"{name}_def", numbers, self.index[near], self.index[far],
            fixed=fixed, upper=ramp + (2 if fixed else 0), lower=ramp, diversion=self.diversion, mitre=self.mitre,
            axes=np.stack([axis, _unit(after)]), spread=(True, spec.next_spread),
        )  # fmt: skip
        return Sliced(name, self.index[near], made, surface)

    def _triangles(self, kinds: tuple[int, ...]) -> NDArray[np.int64]:
        """Triangles with a corner in one of the regions, hair and other ornaments apart."""
        skin = self.body.skin
        touched = np.isin(self.region, kinds)
        chosen = touched[skin.triangles[:, 0]] | touched[skin.triangles[:, 1]] | touched[skin.triangles[:, 2]]
        for part in skin.parts:
            if _ornament(part):
                chosen[part.start : part.stop] = False
        return np.flatnonzero(chosen)

    def trunk(self) -> list[Sliced]:
        """The torso's front and back, and the neck."""
        points, count = max(6, round(17 * self.density)), max(10, round(30 * self.density))
        top = self.neck_height
        heights = np.linspace(top, self.bottom, count)
        rest = self.body.skin.rest
        inside = rest[self.region == 0]
        middle = np.array([
            [0.0, y, np.median(band[:, 2]) if len(band := inside[np.abs(inside[:, 1] - y) < 0.03]) else 0.0]
            for y in heights
        ])  # fmt: skip
        middle[:, 2] = np.convolve(np.pad(middle[:, 2], 2, "edge"), np.ones(5) / 5, "valid")
        axis = np.tile([0.0, -1.0, 0.0], (count, 1))
        walls = [self.planes["l_shoulder"], self.planes["r_shoulder"]]
        around = np.arange(2 * (points - 1)) * np.pi / (points - 1) - np.pi / 2
        armpit = (self._armpit("l")[1] + self._armpit("r")[1]) / 2
        high = heights > armpit  # there the torso ends where the arms begin
        halves = [
            rings(rest, self.body.skin.triangles, self._triangles(kinds), middle[some], axis[some], points=points,
                  reach=0.32, forward=FRONT, angles=around, walls=bounds, roundness=4)
            for some, kinds, bounds in ((high, (0, 1, 2, 3), walls), (~high, (0,), None))
        ]  # fmt: skip
        loops = joined(*halves)
        centers = self.centers[self.spine][:, 1]
        low = centers[0] - 0.01  # zones are squeezed into what lies above the hips
        squeezed = low + (heights - self.bottom) * (top - low) / (top - self.bottom)
        swing, twist = spine_shares(squeezed, centers)
        out = []
        for name, which in (
            ("front", np.arange(points)),
            ("back", np.append(np.arange(points - 1, 2 * points - 2), 0)),
        ):
            part = Rings(loops.points[:, which], loops.face[:, which], loops.barycentric[:, which])
            surface = Contours(
                f"l5_{name}_def", self.index["vl5"], np.arange(count * points, dtype=np.int32).reshape(count, points),
                np.array(self.spine, np.int32), swing, twist, closed=False,
            )  # fmt: skip
            out.append(Sliced(f"l5_{name}", self.index["vl5"], part, surface))
        return [*out, self._neck(loops)]

    def _neck(self, torso: Rings) -> Sliced:
        """From the torso's first contour, whose points it shares, to the skull's plane."""
        points, count = torso.points.shape[1], max(6, round(10 * self.density))
        skull, normal = self.planes["skullbase"]
        low = torso.points[0].mean(axis=0)
        s = np.linspace(0, 1, count)[:, None]
        axis = (1 - s) * np.array([0.0, -1.0, 0.0]) + s * normal
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        high = skull - normal * 0.0
        middle = (1 - s) * low + s * high
        around = np.arange(points) * 2 * np.pi / points - np.pi / 2
        made = rings(self.body.skin.rest, self.body.skin.triangles, self._triangles((0, 1)), middle, axis,
                     points=points, reach=0.14, forward=FRONT, angles=around)  # fmt: skip
        order = slice(None, None, -1)  # top to bottom, as all surfaces
        where, face, weights = made.points.copy(), made.face.copy(), made.barycentric.copy()
        where[0], face[0], weights[0] = torso.points[0], torso.face[0], torso.barycentric[0]
        joints = [*self.neck, self.index["skullbase"]]
        heights = middle[:, 1]
        swing, twist = np.ones((count, len(joints))), np.full((count, len(joints)), np.nan)
        if self.neck:
            bend, wind = spine_shares(heights, self.centers[self.neck][:, 1])
            along = np.linspace(0, 1, count)[:, None]
            swing[:, :-1] = np.minimum(bend, 1) * np.clip(3 * along, 0, 1)
            twist[:, :-1] = np.minimum(wind, 1) * np.clip(3 * along, 0, 1)
            swing[-1, :-1], twist[-1, :-1] = 1, 1
        swing[:, -1] = 0.5 * np.linspace(0, 1, count) ** 2
        rings_ = Rings(where[order], face[order], weights[order])
        joint = joints[0]
        surface = Contours("c7_def", joint, np.arange(count * points, dtype=np.int32).reshape(count, points),
                           np.array(joints, np.int32), swing[order], twist[order])  # fmt: skip
        return Sliced("c7", joint, rings_, surface)

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
            if _ornament(part):
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
            share = 0.5 + 0.5 * _smooth(np.clip(depth[some] / length, 0, 1))
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
            share = 0.5 * _smooth(depth) * _smooth(np.clip(sign * x / width, 0, 1))
            share *= _smooth(np.clip((self.bottom - rest[some, 1]) / 0.05, 0, 1))  # nothing where the torso begins
            fresh[:, self.index[f"{side}_hip"]] += share
        left = 1 - fresh.sum(axis=1)
        low = _smooth(np.clip((self.bottom - rest[some, 1]) / 0.08, 0, 1))
        fresh[:, pelvis] += left * low
        fresh[:, trunk] += left * (1 - low)
        table[some] = fresh


def _unit(v: Floats) -> Floats:
    return v / max(float(np.linalg.norm(v)), 1e-12)


def _smooth(x: Floats) -> Floats:
    return x * x * (3 - 2 * x)


def _ornament(part: Part) -> bool:
    """Parts of the head that are never cut."""
    return any(word in part.name.lower() for word in ("hair", "brow", "lash", "eye", "teeth", "tongue", "beard"))


def _assembled(body: Body, surfaces: list[Sliced], pieces: Skin) -> ContourBody:
    skin = body.skin
    points, triangles, colors, contours, parts = [], [], [], [], []
    vertex, joint, weight = [], [], []
    first = total = 0
    painted = skin.colors is not None
    for s in surfaces:
        count, each = s.rings.points.shape[:2]
        numbers = first + np.arange(count * each).reshape(count, each)
        faces = grid(numbers, s.surface.closed)
        points.append(s.rings.points.reshape(-1, 3))
        triangles.append(faces)
        colors.append(_colors(skin, s.rings) if painted else np.zeros((count * each, 3)))
        contours.append(replace(s.surface, vertices=numbers))
        owners, values = _equivalent(s.surface)
        vertex.append(np.repeat(numbers[:, :, None], len(owners), axis=2).ravel())
        joint.append(np.tile(owners, count * each))
        weight.append(np.repeat(values, each, axis=0).ravel())
        parts.append(Part(s.name, total, total + len(faces), double_sided=True))
        first += count * each
        total += len(faces)
    for part in pieces.parts:
        parts.append(replace(part, start=part.start + total, stop=part.stop + total))
    w = pieces.weights
    rows = Weights.from_pairs(
        first + len(pieces.rest),
        np.concatenate([*vertex, w.vertex.astype(np.int64) + first]),
        np.concatenate([*joint, w.joint]),
        np.concatenate([*weight, w.weight]),
    )
    whole = Skin(
        np.concatenate([*points, pieces.rest]),
        np.concatenate([*triangles, pieces.triangles + first]).astype(np.int32),
        rows,
        colors=np.concatenate([*colors, pieces.colors]) if painted and pieces.colors is not None else None,
        parts=tuple(parts),
        morphs=tuple(replace(m, index=(m.index + first).astype(np.int32)) for m in pieces.morphs),
    )
    made = Body(body.name, body.skeleton, whole, body.placement, tuple(contours))
    return ContourBody(made, _error(body, whole, total))


def _colors(skin: Skin, made: Rings) -> Floats:
    assert skin.colors is not None
    face = made.face
    known = np.where(face >= 0, face, -1)
    out = np.zeros((*face.shape, 3))
    some = face >= 0
    corner = skin.colors[skin.triangles[face[some]]]
    out[some] = np.einsum("nk,nkc->nc", made.barycentric[some], corner)
    for k in range(len(out)):  # where nothing was met: the neighbour in the loop
        good = np.flatnonzero(known[k] >= 0)
        if 0 < len(good) < face.shape[1]:
            for c in range(3):
                out[k, :, c] = np.interp(np.arange(face.shape[1]), good, out[k, good, c], period=face.shape[1])
    return out.reshape(-1, 3)


def _equivalent(surface: Contours) -> tuple[Ints, Floats]:
    """Joints and weights (C,n) of skinning that moves the contours alike: what each joint takes of what is left."""
    joints = surface.joints.tolist()
    left = np.ones(len(surface))
    values = np.zeros((len(surface), len(joints) + 1))
    for i in range(len(joints) - 1, -1, -1):
        values[:, i + 1] = left * surface.swing[:, i]
        left = left * (1 - surface.swing[:, i])
    values[:, 0] = left
    return np.array([0, *joints], np.int32), values


def _error(body: Body, made: Skin, faces: int) -> tuple[float, float]:
    """Mean and largest distance (m) of the sliced surface's faces from the original surface."""
    import igl

    corners = made.rest[made.triangles[:faces]]
    samples = corners.mean(axis=1)
    squared = igl.point_mesh_squared_distance(
        np.ascontiguousarray(samples), body.skin.rest, body.skin.triangles.astype(np.int64)
    )[0]
    distance = np.sqrt(np.maximum(squared, 0))
    return float(distance.mean()), float(distance.max())
