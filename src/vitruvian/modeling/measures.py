"""Measures of any body as a tailor takes them: girths by a tape round a plane section, lengths between feature points.

A tape is the convex hull of the line where a plane meets the body; of several lines it is the one round the axis of the
limb or trunk. Where each is taken is in `TABLE`, in the manner of ISO 8559-1 (anthropometric definitions for garments)
unless it says otherwise. Everything depends on feature points alone, so that a scan, a fitted body and the built-in
person are measured alike; measures whose feature points a body lacks are left out. Both sides are taken, their mean
counts.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from vitruvian.body.types import Floats, Ints, floats, indices
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.modeling import mass
from vitruvian.modeling.slicing import frames, section

UP = np.array([0.0, 1.0, 0.0])
SIDE = np.array([1.0, 0.0, 0.0])
# measure -> how it is taken; girths first. The names are those of `person --measure`.
TABLE: dict[str, str] = {
    "head": "girth through glabella and opisthocranion",
    "neck": "girth across the neck, through the Adam's apple",
    "chest": "level girth through the bust points",
    "underbust": "level girth 0.45 of the way from the bust points to the lower end of the breastbone",
    "waist": "level girth 0.3 of the way from the lower end of the breastbone to the iliac crests (natural waist)",
    "hips": "largest level girth between crotch and iliac crests",
    "thigh": "girth across the thigh, a fifth of the way from the crotch to the knee (lower)",
    "knee": "girth across the leg through the epicondyles",
    "calf": "largest girth across the lower leg",
    "ankle": "smallest girth across the lower leg above the malleoli (minimum)",
    "upper_arm": "girth half way between shoulder and elbow",
    "elbow": "girth across the arm through the epicondyles (arm straight)",
    "wrist": "girth through the styloids",
    "height": "from the soles to the top of the head",
    "inseam": "from the soles to the crotch",
    "arm_length": "acromion to elbow to wrist, straight",
    "shoulder_width": "acromion to acromion, straight",
    "back_length": "cervicale to the level of the waist, upright (straight)",
    "foot_length": "heel to the longest toe",
}
NAMES = tuple(TABLE)
GIRTHS = NAMES[:13]
_TRUNK, _HEAD = ("trunk", "l_thigh", "r_thigh"), ("head", "trunk")


# girths of limbs: on which part's axis, at which shares of its length, which parts' skin counts
LIMBS: dict[str, tuple[str, tuple[float, ...], tuple[str, ...]]] = {
    "thigh": ("thigh", (0.28,), ("thigh",)),
    "knee": ("thigh", (1.0,), ("thigh", "shank")),
    "calf": ("shank", (0.15, 0.21, 0.27, 0.33, 0.39, 0.45), ("shank",)),
    "ankle": ("shank", (0.75, 0.8, 0.85, 0.9, 0.95), ("shank", "foot")),
    "upper_arm": ("upper arm", (0.5,), ("upper arm",)),
    "elbow": ("upper arm", (1.0,), ("upper arm", "forearm")),
    "wrist": ("forearm", (1.0,), ("forearm", "hand")),
}


# straight lengths along the axes of limbs, from where the part begins to where it ends
LENGTHS: dict[str, str] = {
    "upper arm": "middle of acromion and armpit to the middle of the elbow",
    "forearm": "middle of the elbow to the middle of the wrist",
    "thigh": "middle of trochanterion and crotch to the middle of the knee",
    "shank": "middle of the knee to the middle of the ankle",
}


@dataclass(frozen=True, eq=False)
class Figure:
    """A body to be measured, upright, facing +Z, metres: points (V,3), triangles (T,3), places of feature points.

    parts (T,): what each triangle belongs to ("trunk", "l_thigh", ...), or None where there are no weights to tell.
    """

    points: Floats
    triangles: Ints
    places: Mapping[str, Floats]
    parts: NDArray[np.str_] | None = None


@dataclass(frozen=True, eq=False)
class Measures:
    """What a body measures. values: name -> metres; contours: name (with `l_`, `r_` for limbs) -> (N,3) closed tape,
    the first point not repeated; volume in m3, mass in kg, masses and volumes: Segment -> kg and
    m3 (empty for a plain surface); limbs: straight lengths of the parts of arms and legs, metres, as `LENGTHS` says."""

    values: dict[str, float]
    contours: dict[str, Floats]
    volume: float
    mass: float
    masses: dict[str, float]
    limbs: dict[str, float] = field(default_factory=dict)
    volumes: dict[str, float] = field(default_factory=dict)


def tape(
    points: Floats,
    triangles: Ints,
    center: Floats,
    axis: Floats,
    *,
    half: tuple[Floats, Floats] | None = None,
    alone: bool = False,
) -> tuple[float, Floats]:
    """A tape round a surface: its length (m) and the corners (N,3) of the hull that it follows; 0 and none where the
    plane through `center` (3,) across `axis` (3,) meets nothing.

    Of several lines the largest that goes round `center` is taken; where none does (holes, limbs cut off) the line
    nearest to it, or all of them when the triangles are known to be of one limb `alone`. `half`: a place and a direction;
    what lies behind is left out.
    """
    axis = axis / np.linalg.norm(axis)
    forward = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.9 else UP
    cut = section(points, triangles, center, axis, forward)
    first, second = (d[0] for d in frames(axis[None], forward))
    segments, loop = cut.segments, cut.loop
    if not len(segments):
        return 0.0, np.zeros((0, 3))
    if half is None:
        size = np.zeros(len(cut.size))
        np.maximum.at(size, loop, np.linalg.norm(segments[:, 0], axis=1))
        around = cut.around(np.zeros(2)) & (size > 0)
        near = np.full(len(cut.size), np.inf)
        np.minimum.at(near, loop, np.linalg.norm(segments.mean(axis=1), axis=1))
        if around.any():
            mine = loop == int(np.argmax(np.where(around, size, -1)))
        else:
            mine = np.ones(len(loop), bool) if alone else loop == int(np.argmin(near))
        some = segments[mine].reshape(-1, 2)
    else:
        where = center + segments.mean(axis=1) @ np.stack([first, second])
        some = segments[(where - half[0]) @ half[1] > 0].reshape(-1, 2)
    try:
        hull = ConvexHull(some)
    except (QhullError, ValueError):
        return 0.0, np.zeros((0, 3))
    corners = some[hull.vertices]
    return float(hull.area), center + corners @ np.stack([first, second])  # in the plane, "area" is the perimeter


def _middle(*points: Floats) -> Floats:
    return np.mean(points, axis=0)


@dataclass(frozen=True, eq=False)
class _Taker:
    """Takes the measures of one figure; KeyError where a feature point is missing."""

    figure: Figure

    def at(self, *names: str) -> Floats:
        """The middle of feature points."""
        return _middle(*(np.asarray(self.figure.places[n], dtype=np.float64) for n in names))

    def floor(self) -> float:
        return float(self.figure.points[:, 1].min())

    def around(self, center: Floats, axis: Floats, parts: Collection[str], side: str = "") -> tuple[float, Floats]:
        f = self.figure
        if f.parts is not None:
            mine = f.triangles[np.isin(f.parts, list(parts))]
            if len(mine):
                return tape(f.points, mine, center, axis, alone=True)
        leg = bool(side) and any(p.endswith(("thigh", "shank")) for p in parts) and "crotch" in f.places
        half = (self.at("crotch"), SIDE * (1 if side == "l_" else -1)) if leg else None
        near = f.triangles
        if half is not None:  # the other leg and hands that touch the thighs are no part of it
            reach = np.linalg.norm(f.points - center, axis=1) < 0.25
            near = f.triangles[reach[f.triangles].all(axis=1)]
            whole = tape(f.points, near, center, axis)
            if not len(whole[1]) or ((whole[1] - half[0]) @ half[1]).min() > -0.02:
                return whole
        return tape(f.points, near, center, axis, half=half)

    def level(self, height: float) -> tuple[Floats, Floats]:
        """A level plane through the trunk: its middle and +Y."""
        low, high = self.at("crotch"), self.at("cervicale", "suprasternale")
        share = (height - low[1]) / max(float(high[1] - low[1]), 1e-6)
        center = low + np.clip(share, 0.1, 1) * (high - low)
        center[1] = height
        return center, UP

    def bust(self) -> float:
        return float(self.at("l_thelion", "r_thelion")[1])

    def waist_level(self) -> float:
        bone, crest = self.at("substernale"), self.at("l_iliocristale", "r_iliocristale")
        return float(bone[1] + 0.3 * (crest[1] - bone[1]))

    def under_level(self) -> float:
        return self.bust() + 0.45 * (float(self.at("substernale")[1]) - self.bust())

    def limb(self, side: str, kind: str) -> tuple[Floats, Floats]:
        """Where a limb's part begins and ends, on its axis."""
        s = side
        if kind == "upper arm":
            shoulder = (self.at(s + "acromion") + self.at(s + "axilla_proximal", s + "axilla_distal")) / 2
            return shoulder, self.at(s + "humeral_lateral_epicondyle", s + "humeral_medial_epicondyle")
        if kind == "forearm":
            elbow = self.at(s + "humeral_lateral_epicondyle", s + "humeral_medial_epicondyle")
            return elbow, self.at(s + "radial_styloid", s + "ulnar_styloid")
        knee = self.at(s + "femoral_lateral_epicondyle", s + "femoral_medial_epicondyle")
        if kind == "thigh":
            return (self.at(s + "trochanterion") + self.at("crotch")) / 2, knee
        return knee, self.at(s + "lateral_malleolus", s + "medial_malleolus")

    def planes(self, name: str, side: str) -> list[tuple[Floats, Floats]]:
        """Where a girth is looked for: places on the axis and directions of the axis there."""
        if name in LIMBS:
            kind, shares, _ = LIMBS[name]
            a, b = self.limb(side, kind)
            along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
            return [(a + share * (b - a), along) for share in shares]
        if name == "head":
            front, back = self.at("glabella"), self.at("opisthocranion")
            normal = np.cross(SIDE, front - back)
            return [((front + back) / 2, normal / max(float(np.linalg.norm(normal)), 1e-9))]
        if name == "neck":
            base, top = self.at("cervicale", "suprasternale"), self.at("l_tragion", "r_tragion")
            axis = (top - base) / max(float(np.linalg.norm(top - base)), 1e-9)
            apple = self.figure.places.get("adams_apple")
            if apple is None:
                apple = 0.45 * self.at("menton") + 0.55 * self.at("suprasternale")
            return [(base + ((apple - base) @ axis) * axis, axis)]
        if name == "hips":
            low, high = float(self.at("crotch")[1]), float(self.at("l_iliocristale", "r_iliocristale")[1])
            return [self.level(y) for y in low + np.linspace(0.15, 0.85, 8) * (high - low)]
        heights = {"chest": self.bust, "underbust": self.under_level, "waist": self.waist_level}
        return [self.level(heights[name]())]

    def girth(self, name: str, side: str) -> tuple[float, Floats]:
        """One girth: its length and its tape."""
        parts = [side + p for p in LIMBS[name][2]] if name in LIMBS else _HEAD if name in ("head", "neck") else _TRUNK
        found = [self.around(c, axis, parts, side) for c, axis in self.planes(name, side)]
        there = [f for f in found if f[0] > 0] or found[:1]
        return (min if name == "ankle" else max)(there, key=lambda t: t[0])

    def length(self, name: str) -> float:
        """One length."""
        sides = ("l_", "r_")
        if name == "height":
            return float(np.ptp(self.figure.points[:, 1]))
        if name == "inseam":
            return float(self.at("crotch")[1]) - self.floor()
        if name == "shoulder_width":
            return float(np.linalg.norm(self.at("l_acromion") - self.at("r_acromion")))
        if name == "back_length":
            return float(self.at("cervicale")[1]) - self.waist_level()
        if name == "arm_length":
            chains = [[s + "acromion", s + "humeral_lateral_epicondyle", s + "ulnar_styloid"] for s in sides]
            lines = [np.array([self.at(n) for n in chain]) for chain in chains]
            return float(np.mean([np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in lines]))
        out = []
        for s in sides:
            heel, toe = self.at(s + "calcaneus_posterior"), self.at(s + "tarsal_distal_phalanx_2")
            along = (toe - heel) * [1, 0, 1]
            size = float(np.linalg.norm(along))
            low = self.figure.points[self.figure.points[:, 1] < self.floor() + 0.4 * size]
            mine = low[np.linalg.norm((low - (heel + toe) / 2)[:, [0, 2]], axis=1) < 0.75 * size]
            out.append(float(np.ptp(mine @ (along / size))) if len(mine) else size)
        return float(np.mean(out))


def limbs_of(figure: Figure) -> dict[str, float]:
    """Lengths of the parts of both arms and legs, metres, those that the figure has the feature points for."""
    taker, out = _Taker(figure), {}
    for kind in LENGTHS:
        for side in ("l_", "r_"):
            try:
                a, b = taker.limb(side, kind)
            except KeyError:
                continue
            out[side + kind.replace(" ", "_")] = float(np.linalg.norm(b - a))
    return out


def axis_of(figure: Figure, name: str, side: str) -> tuple[Floats, Floats]:
    """Where the axis goes through the middle of a girth (3,), and its unit direction (3,); KeyError as `taken` skips."""
    planes = _Taker(figure).planes(name, side)
    return planes[len(planes) // 2]


def taken(figure: Figure, names: Collection[str] = NAMES, *, sides: Collection[str] = ("l_", "r_")) -> Measures:
    """Measures of a figure, those of `names` that it has the feature points for; volume and masses are left at 0."""
    taker = _Taker(figure)
    values: dict[str, float] = {}
    contours: dict[str, Floats] = {}
    for name in names:
        try:
            if name not in GIRTHS:
                values[name] = taker.length(name)
                continue
            mine = {s: taker.girth(name, s) for s in (sides if name in LIMBS else ("",))}
        except KeyError:
            continue
        good = {s: t for s, t in mine.items() if t[0] > 0}
        if good:
            values[name] = float(np.mean([t[0] for t in good.values()]))
            contours |= {s + name: t[1] for s, t in good.items()}
    return Measures(values, contours, 0.0, 0.0, {})


def measures(body: Any, landmarks: Mapping[str, Floats] | None = None, *, unit: str | None = None) -> Measures:
    """All measures of a body: a Humanoid, at rest, or a surface with `vertices` and `triangles`.

    `landmarks`: feature point -> place (3,), in the unit and axes of the body; None: a Humanoid's Sites and Displacers,
    or found on the surface. `unit` of a surface: "m", "cm", "mm" or "in"; None: what its size suggests.
    Clothes that a file holds as surfaces of their own are measured with the body, except those of the built-in person.
    Raises VitruvianError where there is no surface or no feature point to go by.
    """
    from vitruvian.modeling import scans
    from vitruvian.modeling.figures import humanoid_figure, surface_figure

    if isinstance(body, Humanoid):
        figure = humanoid_figure(body, landmarks)
        own = {s.name: float(s.mass) for s in body.segments() if s.mass > 0}
        if not own:
            own = {n: m.mass for n, m in mass.masses(body).items()}
        weight = sum(own.values())
        room = {n: m.mass / mass.DENSITY for n, m in mass.masses(body).items()}
    else:
        mesh: scans.Surface = body
        figure, own, weight, room = surface_figure(mesh, landmarks, unit), {}, 0.0, {}
    found = taken(figure)
    if not found.values:
        raise VitruvianError("measures: expected feature points (Sites such as l_acromion_pt), found none that serve")
    volume = mass.solid(figure.points, figure.triangles).mass / 1000.0
    return Measures(found.values, found.contours, volume, weight or volume * mass.DENSITY, own, limbs_of(figure), room)


def figure_of(points: Floats, triangles: Ints, places: Mapping[str, Floats], parts: Any = None) -> Figure:
    """A Figure with its arrays checked; VitruvianError where they do not fit."""
    where = floats(points, "points", None, 3)
    return Figure(where, indices(triangles, "triangles", len(where), None, 3), places, parts)
