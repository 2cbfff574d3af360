"""Where a body is cut for its contours: the planes at its joints, and how far arms, legs and trunk can be told apart.

A limb begins where a loop round its bone first lies clear of the trunk: below the armpit, rising towards the deltoid;
below the crotch, rising towards the hip. The trunk ends below the armpits and above the hips.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Body, Floats, Ints, Morph, Part, Skin
from vitruvian.errors import VitruvianError
from vitruvian.modeling.charts import Charts
from vitruvian.modeling.slicing import Rings, Whole, carried, frames, section
from vitruvian.motion.names import VERTEBRAE, joint_index

FRONT = np.array([0.0, 0.0, 1.0])
_STATURE = 1.45  # metres from ankle to skullbase of the figure that lengths in this module are meant for
_STEPS = 24  # places that are tried for the beginning of a limb
_LEANS = {"shoulder": (0.8, 0.5, 0.25), "hip": (0.6, 0.45, 0.3)}  # how the first loop may lean outwards
_WHOLE = 0.95  # how much of the skin round its beginning a limb should hold, nine tenths of the way round
_THIN = 0.05  # metres of a person: the radius that a trunk has at least, and marks of joints do not
_UNDER = 0.93  # of the width a little higher: narrower is the underside of a trunk
_BEYOND = 0.05  # metres of a person from the seam of a limb in segments with the trunk to its first contour
CLEAR = 0.016  # metres from where a limb is first clear of the trunk to its first contour
FOLLOW = {"shoulder": 0.07, "hip": 0.1}  # metres of a person of the trunk beside a seam that go with the limb

OUTER = (4, 5, 8, 9, 10)  # regions of hands, feet and pelvis

Plane = tuple[Floats, Floats]  # a point, and the unit normal down the limb


class Cuts:
    """The planes that a body is cut along. Raises VitruvianError naming joints that the body lacks."""

    def __init__(self, body: Body, seams: Mapping[str, Floats] | None = None):
        """`seams`: by joint, points (n,3) where a limb of a figure in segments is one surface with the trunk."""
        self.seams = dict(seams or {})
        skeleton = body.skeleton
        self.index = joint_index(skeleton.names)
        wanted = [f"{side}_{part}" for side in "lr" for part in
                  ("hip", "knee", "talocrural", "shoulder", "elbow", "radiocarpal")]  # fmt: skip
        missing = [n for n in wanted if n not in self.index]
        if missing:
            raise VitruvianError(f"contours: the body needs the joints {', '.join(missing)}, which it does not have")
        self.centers = skeleton.centers
        self.spine = [self.index[v] for v in VERTEBRAE if v in self.index and v[1] in "lt"]
        self.neck = [self.index[v] for v in VERTEBRAE if v in self.index and v[1] == "c"]
        ankles = (self.at("l_talocrural") + self.at("r_talocrural")) / 2
        shoulders = (self.at("l_shoulder") + self.at("r_shoulder")) / 2
        self.hips = (self.at("l_hip") + self.at("r_hip")) / 2
        top = self.index.get("skullbase")
        height = 1.12 * (shoulders - ankles)[1] if top is None else (self.centers[top] - ankles)[1]
        if height <= 0:
            raise VitruvianError("contours: expected a figure that stands upright, its head up the Y axis")
        self.scale = float(height) / _STATURE
        self.shoulders = shoulders
        skin = body.skin
        welded = _weld(skin.rest, 1e-6 * self.scale, skin.weights.top(1)[0][:, 0])
        morphs = tuple(_welded(m, welded) for m in skin.morphs)
        self.body = replace(body, skin=replace(skin, triangles=welded[skin.triangles], morphs=morphs))
        self.corners = skin.triangles  # as they were: points at one place may have several colours
        self.part = np.repeat(np.arange(len(skin.parts)), [p.stop - p.start for p in skin.parts])
        self.segmented = self._segmented()
        self.region = self._regions()
        chosen = np.ones(len(skin.triangles), bool)
        for part in skin.parts:
            if ornament(part):
                chosen[part.start : part.stop] = False
        self.sliced = np.flatnonzero(chosen)
        self.planes: dict[str, Plane] = {}
        self._limbs()
        self._trunk()

    @property
    def skin(self) -> Skin:
        return self.body.skin

    def colored(self, loops: Rings) -> Floats | None:
        """(C,P,3) colours of contours' points, None where the skin has none."""
        return None if self.skin.colors is None else carried(loops, self.skin.colors, self.corners)

    def mapped(self, loops: Rings) -> Floats | None:
        """(C,P,2) texture coordinates of contours' points, None where the skin has none."""
        corners = self.skin.uv_triangles
        return None if self.skin.uv is None or corners is None else carried(loops, self.skin.uv, corners)

    @cached_property
    def charts(self) -> Charts | None:
        """The islands of the skin's texture coordinates, None where it has none."""
        return None if self.skin.uv is None else Charts(self.skin, self.skin.triangles, self.sliced)

    def at(self, name: str) -> Floats:
        return self.centers[self.index[name]]

    def _regions(self) -> NDArray[np.int64]:
        """(V,) 0 trunk, 1 head, 2/3 left/right arm, 4/5 hand, 6/7 leg, 8/9 foot: by the joint of largest weight.

        The pelvis is the trunk's in a skin, and 10 in a figure of segments with a spine, where it stays as it is. The
        neck is 11 in a figure of segments whose neck has joints.
        """
        skeleton, weights = self.body.skeleton, self.body.skin.weights
        start = {"skullbase": 1}
        for n, side in enumerate("lr"):
            start |= {f"{side}_shoulder": 2 + n, f"{side}_radiocarpal": 4 + n, f"{side}_hip": 6 + n}
            start |= {f"{side}_talocrural": 8 + n}
        root = 10 if self.segmented and self.spine else 0
        of_joint = np.full(len(skeleton), root, np.int64)
        begin = {self.index[name]: code for name, code in start.items() if name in self.index}
        if self.segmented and self.neck:
            begin[self.neck[0]] = 11
        if root:
            begin[self.spine[0]] = 0
        for j, parent in enumerate(skeleton.parents):
            of_joint[j] = begin.get(j, of_joint[parent] if parent >= 0 else root)
        joint, weight = weights.top(1)
        return np.where(weight[:, 0] > 0, of_joint[joint[:, 0]], 0)

    def _segmented(self) -> bool:
        """Whether the surface is in separate pieces, each on one joint, as old figures are."""
        weights = self.body.skin.weights
        used = np.unique(self.skin.triangles)
        return bool(len(used)) and bool((weights.counts[used] <= 1).mean() > 0.98)

    def triangles(self, *codes: int) -> Whole:
        """Triangles that may be sliced for these regions: all of a skin, the segments' own where it is in pieces."""
        if not self.segmented:
            return self.sliced
        inside = np.isin(self.region, codes)[self.skin.triangles[self.sliced]].all(axis=1)
        return self.sliced[inside]

    def _limbs(self) -> None:
        for n, side in enumerate("lr"):
            for a, b, c, codes in (
                ("shoulder", "elbow", "radiocarpal", (2 + n,)),
                ("hip", "knee", "talocrural", (6 + n,)),
            ):
                first, middle, last = (self.at(f"{side}_{j}") for j in (a, b, c))
                self.planes[f"{side}_{a}"] = self._beginning(a, side, first, middle, codes)
                self.planes[f"{side}_{b}"] = (middle, unit(unit(middle - first) + unit(last - middle)))
                self.planes[f"{side}_{c}"] = (last, unit(last - middle))

    def _beginning(self, name: str, side: str, start: Floats, end: Floats, codes: tuple[int, ...]) -> Plane:
        """The first plane down a limb whose loop does not go round the trunk or the other leg too, and which the skin's
        weights give to the limb almost wholly: from there on contours turn it as they do."""
        bone, away = unit(end - start), np.array([np.sign(start[0] - self.hips[0]), 0.0, 0.0])
        if self.segmented:
            seam = self.seams.get(f"{side}_{name}")
            return (start, bone) if seam is None else (self._clear(seam, start, bone, codes), bone)
        chosen = self.triangles(*codes)
        faces = self.skin.triangles[chosen]
        length = float(np.linalg.norm(end - start))
        share = self.share(f"{side}_{name}")
        best, most = (start + 0.4 * length * bone, bone), -1.0
        for s in np.linspace(0.0, 0.6, _STEPS):
            center = start + s * length * bone
            for lean in _LEANS[name]:
                normal = unit(bone + lean * away * (1 - abs(float(bone @ away))))
                cut = section(self.skin.rest, faces, center, normal, FRONT)
                if not len(cut.round) or any(cut.holds(p) for p in self._others(name, center, normal)):
                    continue
                met = np.isin(cut.loop, cut.round)
                least = float(np.quantile(share[faces[cut.face[met]]].mean(axis=1), 0.1))
                if least > most:
                    best, most = (center + CLEAR * self.scale * bone, normal), least
                if least >= _WHOLE:
                    return best
        return best

    def _clear(self, seam: Floats, start: Floats, bone: Floats, codes: tuple[int, ...]) -> Floats:
        """The middle of a limb just beyond its seam with the trunk: its bone may begin beside it."""
        center = start + (float(((seam - start) @ bone).max()) + _BEYOND * self.scale) * bone
        cut = section(self.skin.rest, self.skin.triangles[self.triangles(*codes)], center, bone, FRONT)
        if not len(cut.size):
            return center
        first, second = (d[0] for d in frames(bone[None], FRONT))
        widest = cut.segments[cut.loop == np.bincount(cut.loop).argmax()]
        length = np.linalg.norm(widest[:, 1] - widest[:, 0], axis=1)
        x, y = length @ widest.mean(axis=1) / max(float(length.sum()), 1e-12)
        return np.asarray(center + x * first + y * second)

    def below(self, name: str) -> NDArray[np.bool_]:
        """(J,) a joint and all that hang on it."""
        parents = self.body.skeleton.parents
        out = np.zeros(len(parents), bool)
        for j in range(len(parents)):
            out[j] = j == self.index[name] or (parents[j] >= 0 and out[parents[j]])
        return out

    def share(self, name: str) -> Floats:
        """(V,) how much of each vertex a joint and what hangs on it hold, by the skin's weights."""
        weights = self.skin.weights
        held = np.where(self.below(name)[weights.joint], weights.weight, 0.0)
        return np.bincount(weights.vertex, held, minlength=len(weights)).astype(np.float64)

    @property
    def arms(self) -> NDArray[np.bool_]:
        """(J,) the joints of both arms."""
        return self.below("l_shoulder") | self.below("r_shoulder")

    def _others(self, name: str, center: Floats, normal: Floats) -> list[Floats]:
        """Places in a plane that are the trunk's or the other leg's."""
        first, second = (d[0] for d in frames(normal[None], FRONT))
        if name == "hip":
            x = 2 * (self.hips[0] - center[0])  # the other leg: heavy thighs may pass the middle
            places = [np.array([x, -normal[0] / min(normal[1], -0.3) * x, 0.0])]
        else:
            places = [np.array([self.hips[0] - center[0], y * self.scale, 0.0]) for y in (0.0, -0.1, -0.2, -0.3)]
        return [np.array([p @ first, p @ second]) for p in places]

    def _trunk(self) -> None:
        """Where the trunk's contours end: below the armpits and above the legs; and those of the neck."""
        down = np.array([0.0, -1.0, 0.0])
        faces = self.skin.triangles[self.triangles(0)]
        s = self.scale
        middle = lambda y: np.array([self.hips[0], y, self.depth(y)])  # noqa: E731
        high = self.shoulders[1]
        if self.neck:
            base = self.centers[self.neck[0]]
        elif "skullbase" in self.index:  # no joint says where the neck begins
            base = self.at("skullbase")
            if not self.segmented:
                base = (base + [self.hips[0], high, self.depth(high)]) / 2
        else:
            base = self.shoulders + [0, 0.1 * s, 0]
        if self.segmented:
            used = self.skin.rest[np.unique(faces)]
            top = float(min(base[1], used[:, 1].max()) - 0.03 * s)  # below the collar
            low = max(float(self.hips[1]), float(used[:, 1].min()) + 0.01 * s)
            low = self._hem(faces, low)
            for name, seam in self.seams.items():  # what moves with arms is no contours, nor what moves with legs
                if name.endswith("shoulder"):
                    top = min(top, float(seam[:, 1].min()) - FOLLOW["shoulder"] * s)
                elif not len(self.triangles(10)):
                    low = max(low, float(seam[:, 1].max()) + FOLLOW["hip"] * s)
            self.planes["top"], self.planes["vl5"] = (middle(top), down), (middle(low), down)
        else:
            top = high - 0.12 * s
            for y in np.arange(high + 0.02 * s, self.hips[1], -0.006 * s):
                cut = section(self.skin.rest, faces, middle(y), down, FRONT)
                if len(cut.round) and not any(cut.holds(self._arm(side, y, cut)) for side in "lr"):
                    top = float(y) - 0.045 * s
                    break
            self.planes["top"] = (middle(top), down)
            low = max(self._waist(), float(self.hips[1]) + 0.06 * s)
            self.planes["vl5"] = (middle(min(low, top - 0.12 * s)), down)
        if "skullbase" in self.index:
            skull = self.at("skullbase")
            self.planes["skullbase"] = (skull, unit(np.array([0.0, -1.0, -0.9])))  # below the chin
            self.planes["neck"] = (base, unit(np.array([0.0, -1.0, -0.5])))

    def _hem(self, faces: Ints, low: float) -> float:
        """The lowest height from `low` on at which the trunk of a figure in segments goes all round and is not yet its
        underside."""
        steps = low + np.arange(14) * 0.005 * self.scale
        down = np.array([0.0, -1.0, 0.0])
        size = np.zeros(len(steps))
        for k, y in enumerate(steps):
            cut = section(self.skin.rest, faces, np.array([self.hips[0], y, self.depth(y)]), down, FRONT)
            size[k] = cut.size[cut.round].max() if len(cut.round) else 0.0
        good = np.flatnonzero(size > _UNDER * size.max())
        return float(steps[good[0]]) if size.max() > _THIN * self.scale else low

    def depth(self, y: float) -> float:
        """Z of the spine's place at height y, a little in front of its joints."""
        chain = self.centers[self.spine] if self.spine else self.hips[None]
        return float(np.interp(y, chain[:, 1], chain[:, 2]))

    def _arm(self, side: str, y: float, cut: object) -> Floats:
        """Where an arm's bone meets height y, in the plane of a section through the spine: from two fifths of the upper
        arm on."""
        a, b, c = (self.at(f"{side}_{j}") for j in ("shoulder", "elbow", "radiocarpal"))
        line = np.array([a + 0.4 * (b - a), b, c])
        at = np.linspace(0, 2, 41)
        bone = np.stack([np.interp(at, [0, 1, 2], line[:, k]) for k in range(3)], axis=1)
        place = bone[np.argmin(np.abs(bone[:, 1] - y))] - [self.hips[0], y, self.depth(y)]
        first, second = (d[0] for d in frames(np.array([[0.0, -1.0, 0.0]]), FRONT))
        return np.array([place @ first, place @ second])

    def _waist(self) -> float:
        """Height above which the legs do not pull: where the hips' planes leave the body at its sides."""
        out = 0.0
        for side in "lr":
            center, normal = self.planes[f"{side}_hip"]
            at = self.at(f"{side}_hip")
            out = max(out, float(at[1]) + 0.09 * self.scale)
        return out


def _weld(rest: Floats, tolerance: float, owner: Ints) -> NDArray[np.int32]:
    """(V,) the first vertex at the place of each that the same joint (V,) holds."""
    if not len(rest):
        return np.zeros(0, np.int32)
    key = np.concatenate([np.round(rest / tolerance), owner[:, None]], axis=1)
    _, first, where = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return first[where.reshape(-1)].astype(np.int32)


def _welded(morph: Morph, welded: Ints) -> Morph:
    index, first = np.unique(welded[morph.index], return_index=True)
    return replace(morph, index=index.astype(np.int32), offset=morph.offset[first])


def unit(v: Floats) -> Floats:
    return v / max(float(np.linalg.norm(v)), 1e-12)


def smooth(x: Floats) -> Floats:
    return x * x * (3 - 2 * x)


def ornament(part: Part) -> bool:
    """Parts of the head that are never cut."""
    return any(word in part.name.lower() for word in ("hair", "brow", "lash", "eye", "teeth", "tongue", "beard"))
