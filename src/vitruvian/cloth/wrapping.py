"""Places for patterns that have none: from names, labels and shapes, panels stand before, behind and beside the body.

Source: note cloth.md, sections 2.2, 2.4 and 5. Fronts and backs stand flat, as those of our own drafts; sleeves and bands
of one piece are rolled around the limb or waist. The tailor then moves each outwards until it is clear of the skin.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.drafting.figure import Figure
from vitruvian.cloth.pattern import Edge, Panel, Pattern, along, area, ends, length, loops, placed
from vitruvian.cloth.placing import Dummy
from vitruvian.errors import VitruvianError

WAIST = "lower_interface"  # the label of the edge that a garment without shoulders hangs by
RISE, CROTCH = 0.018, 0.02  # metres of a shoulder's inner end over the nape, of a fork under the crotch
DEPTH = {"torso": 0.16, "skirt": 0.14, "leg": 0.14, "band": 0.14, "pocket": 0.22, "collar": 0.12, "hood": 0.14}
ROOM = 0.02  # metres between what is rolled and the limb, and of shoulders over shoulders
NECK = 0.1  # metres beside the middle, where shoulders are and the head is not
LEFT, RIGHT = 1, -1  # sides of the body, as x has them
FRONT, BACK = 1, -1
# What a word in a name or label says of the region, the face and the side
REGIONS = {
    "sleeve": ("sleeve", "sleeves", "arm"),
    "cuff": ("cuff", "cuffs"),
    "collar": ("collar", "neckband"),
    "hood": ("hood",),
    "band": ("waistband", "wb", "band", "belt"),
    "leg": ("leg", "pant", "pants", "trouser", "trousers", "jeans", "shorts", "leggings"),
    "skirt": ("skirt",),
    "pocket": ("pocket", "pockets"),
    "torso": (
        "torso",
        "ftorso",
        "btorso",
        "bodice",
        "shirt",
        "tshirt",
        "tee",
        "top",
        "dress",
        "jacket",
        "yoke",
        "body",
    ),
}
FACES = {FRONT: ("front", "f", "ftorso", "fr"), BACK: ("back", "b", "btorso", "bk")}
SIDES = {LEFT: ("left", "l"), RIGHT: ("right", "r")}
LABELS = {"torso": "body", "sleeve": "arm", "cuff": "arm", "leg": "leg", "skirt": "skirt", "band": "body"}
MIRRORED = "mirrored"


@dataclass(frozen=True)
class Worn:
    """Where a panel is worn: its region (a key of `REGIONS`), which way it faces (`FRONT`, `BACK`, 0: neither), and the
    side of the body (`LEFT`, `RIGHT`, 0: the middle)."""

    region: str
    face: int
    side: int


@dataclass(frozen=True, eq=False)
class Stand:
    """The body that panels are placed around: its measures and landmarks, the points of its skin (V,3) metres as it stands
    to be dressed, and by side its shoulder's and elbow's joint (3,)."""

    figure: Figure
    points: Floats
    arms: Mapping[int, tuple[Floats, Floats]]

    def slice(self, height: float, reach: float) -> Floats:
        """(n,3): what of the skin is within a centimetre of a height, and `reach` of the middle."""
        p = self.points
        return p[(np.abs(p[:, 1] - height) < 0.01) & (np.abs(p[:, 0]) < reach)]

    def top(self, x: float) -> float:
        """How high the shoulders reach beside the neck, metres."""
        p = self.points
        column = p[(np.abs(p[:, 0] - x) < 0.012) & (p[:, 1] > self.figure.waist)]
        return float(column[:, 1].max()) if len(column) else self.figure.shoulder


def stand(figure: Figure, mannequin: Dummy) -> Stand:
    """The body as it will be dressed."""
    skeleton = mannequin.body.skeleton
    arms = {}
    for side, letter in ((LEFT, "l"), (RIGHT, "r")):
        joints = [skeleton.index[f"{letter}_{n}"] for n in ("shoulder", "elbow")]
        ends = [(mannequin.matrices[j] @ np.append(skeleton.centers[j], 1.0))[:3] for j in joints]
        arms[side] = (ends[0], ends[1])
    return Stand(figure, mannequin.vertices[np.unique(mannequin.triangles)], arms)


def wrapped(pattern: Pattern, at: Stand) -> Pattern:
    """The pattern with a place for every panel that has none, and the waist of a garment without shoulders labelled.

    Panels that have a place keep it. `extra["wrap"]`, panel -> words, goes before what its name and label say.
    VitruvianError for a panel of which neither words nor shape say where it belongs.
    """
    if all(p.rotation is not None and p.translation is not None for p in pattern.panels):
        return pattern
    where = wearing(pattern)
    lifted = _lift(pattern, where, at)
    panels = [
        p if p.rotation is not None and p.translation is not None else _stood(p, where[p.name], at, lifted)
        for p in pattern.panels
    ]
    labelled = [p if p.label else replace(p, label=LABELS.get(where[p.name].region, "")) for p in panels]
    return replace(pattern, panels=tuple(_anchored(labelled, where)))


def wearing(pattern: Pattern) -> dict[str, Worn]:
    """Where each panel is worn, by words and, where they do not say it, by shape. VitruvianError where neither does."""
    said = pattern.extra.get("wrap", {})
    given = said if isinstance(said, Mapping) else {}
    words = {p.name: _words(f"{given.get(p.name, '')} {p.name} {p.label}") for p in pattern.panels}
    wraps = {p.name: _words(str(given.get(p.name, ""))) for p in pattern.panels}
    found = {n: _first(REGIONS, wraps[n]) or _first(REGIONS, w) for n, w in words.items()}
    usual = _garment(pattern, found)
    out = {}
    for p in pattern.panels:
        mine = words[p.name]
        region = found[p.name] or usual
        if region is None:
            raise VitruvianError(
                f"panel {p.name}: expected a name that says where it is worn (front, back, sleeve, waistband, ...); say it "
                "in the sidecar, or give it a place"
            )
        face = _first(FACES, wraps[p.name]) or _first(FACES, mine) or 0
        side = _first(SIDES, wraps[p.name]) or _first(SIDES, mine) or 0
        out[p.name] = Worn(region, face, side)
    for p in pattern.panels:
        worn = out[p.name]
        if worn.region in ("torso", "leg", "skirt") and not worn.face:
            raise VitruvianError(f"panel {p.name}: expected front or back in its name; say it in the sidecar")
        if not worn.side:
            out[p.name] = replace(worn, side=_side(p, worn, pattern))
    return out


def _words(text: str) -> list[str]:
    parts = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text)
    return [w for w in re.split(r"[^a-zA-Z]+", parts.lower()) if w]


def _first(table: Mapping, words: Iterable[str]):  # noqa: ANN202 (a key of the table or None)
    """The first key of a table of which one of the words is there."""
    words = list(words)
    return next((key for key, names in table.items() if any(w in names for w in words)), None)


def _garment(pattern: Pattern, found: Mapping[str, str | None]) -> str | None:
    """What panels are part of that say only front and back."""
    known = set(found.values())
    if known & {"leg", "skirt"} and not known & {"torso", "sleeve", "collar", "hood"}:
        return "leg" if "leg" in known else "skirt"
    if known & {"torso", "sleeve", "collar", "hood"}:
        return "torso"
    named = _first({k: REGIONS[k] for k in ("leg", "skirt", "torso")}, _words(pattern.name))
    if named is not None:
        return named
    whole = [p for p in pattern.panels if found[p.name] is None]
    if any(_fork(p) is not None for p in whole):
        return "leg"
    return "torso" if any(_dip(p) > 0.045 for p in whole) else "skirt" if whole else None


def _ring(panel: Panel) -> Floats:
    """(n,2) metres: the outline, a point every 5 mm of lines too."""
    pieces = []
    for i in next(loops(panel)):
        count = max(2, int(np.ceil(length(panel, i) / 0.005)))
        pieces.append(along(panel, i, np.arange(count) / count))
    return np.concatenate(pieces)


def _fork(panel: Panel) -> Floats | None:
    """(2,) metres: the tip of a trouser's fork, a corner that stands out at one side below its top third or so."""
    ring = _ring(panel)
    high, low = float(ring[:, 1].max()), float(ring[:, 1].min())
    tall = high - low
    for sign in (1, -1):
        tip = ring[(sign * ring[:, 0]).argmax()]
        share = (high - tip[1]) / tall
        top = ring[ring[:, 1] > high - 0.12 * tall]
        bottom = ring[ring[:, 1] < low + 0.05 * tall]
        in_above, in_below = (float(sign * tip[0] - (sign * r[:, 0]).max()) for r in (top, bottom))
        if 0.12 < share < 0.75 and in_above > 0.05 and in_below > 0.03:
            near = ring[np.abs(ring[:, 1] - tip[1]) < 0.015]
            if np.ptp(near[sign * near[:, 0] > sign * tip[0] - 0.05][:, 0]) > 0.02:  # a corner, not a curve's bulge
                return tip
    return None


def _dip(panel: Panel) -> float:
    """How far the middle of a whole panel's top is below its highest point, metres."""
    ring = _ring(panel)
    middle = 0.5 * (ring[:, 0].min() + ring[:, 0].max())
    half = 0.5 * float(ring[:, 1].min() + ring[:, 1].max())
    upper = ring[(np.abs(ring[:, 0] - middle) < 0.01) & (ring[:, 1] > half)]
    return float(ring[:, 1].max() - upper[:, 1].max()) if len(upper) else 0.0


def _symmetric(panel: Panel) -> bool:
    ring = _ring(panel)
    middle = 0.5 * (ring[:, 0].min() + ring[:, 0].max())
    other = ring * [-1, 1] + [2 * middle, 0]
    apart = np.hypot(*(ring[:, None, :] - other[None, ::3]).transpose(2, 0, 1)).min(axis=0)
    return bool(apart.max() < 0.012)


def _side(panel: Panel, worn: Worn, pattern: Pattern) -> int:
    """Which side of the body a panel is for whose name does not say it."""
    if worn.region in ("sleeve", "cuff"):
        marks = pattern.extra.get("notches", [])
        mine = [m for m in marks if m[0] == panel.name] if isinstance(marks, list) else []
        at = {kind: panel.vertices[panel.edges[edge].start][0] for _, edge, kind in mine}
        if "notch" in at and "bnotch" in at:
            return RIGHT if at["notch"] > at["bnotch"] else LEFT
        return LEFT if MIRRORED in _words(panel.name) else RIGHT
    if worn.region == "hood":
        return LEFT if MIRRORED in _words(panel.name) else RIGHT
    if worn.region in ("band", "collar", "pocket") or _symmetric(panel):
        return 0
    # the middle of the body, seen as u: at a fork, where a top is highest, where a skirt's top edge is upright
    ring = _ring(panel)
    left, right = float(ring[:, 0].min()), float(ring[:, 0].max())
    fork = _fork(panel) if worn.region == "leg" else None
    if fork is not None:
        middle = fork[0]
    elif worn.region == "torso":
        middle = ring[ring[:, 1].argmax()][0]
    else:
        middle = left if _lean(ring, -1) < _lean(ring, 1) else right
    inner = 1 if middle > 0.5 * (left + right) else -1
    return -inner * _across(panel, worn.face)


def _lean(ring: Floats, sign: int) -> float:
    """How much farther out a side is 15 cm below its top, metres."""
    top = ring[ring[:, 1] > ring[:, 1].max() - 0.05]
    end = top[(sign * top[:, 0]).argmax()]
    below = ring[np.abs(ring[:, 1] - (end[1] - 0.15)) < 0.02]
    return abs(float((sign * below[:, 0]).max() - sign * end[0])) if len(below) else 0.0


def _across(panel: Panel, face: int) -> int:
    """1 where u is the body's left in a panel that faces this way, -1 where it is its right."""
    return 1 if face * np.sign(area(panel)) > 0 else -1


def _lift(pattern: Pattern, where: Mapping[str, Worn], at: Stand) -> float:
    """Height at which the tops of fronts and backs stand, so that their shoulders are just above the body's."""
    least = np.inf
    for p in pattern.panels:
        worn = where[p.name]
        if worn.region != "torso":
            continue
        here = _upright(p, worn.face, worn.side, 0.0, 0.0)
        ring = placed(here, _ring(p))
        rise = np.abs(np.roll(ring, -1, axis=0) - ring)
        level = rise[:, 1] < 0.5 * rise[:, 0]  # shoulders, not necks and armholes
        high = ring[level & (ring[:, 1] > -0.12) & (np.abs(ring[:, 0]) > NECK)]
        least = min([least, *(y - at.top(x) for x, y, _ in high[::4])])
    return ROOM - float(least) if np.isfinite(least) else at.figure.nape + RISE


def _stood(panel: Panel, worn: Worn, at: Stand, lifted: float) -> Panel:
    f = at.figure
    if worn.region in ("sleeve", "cuff"):
        return _on_arm(panel, worn, at)
    if worn.region == "band":
        low, face = f.waist, worn.face or FRONT
        return _strip(panel, worn, at, low, f["waist"], face, DEPTH["band"])
    if worn.region == "collar":
        return _strip(panel, worn, at, f.nape, f["neck"], worn.face or BACK, DEPTH["collar"])
    if worn.region == "hood":
        return _beside_head(panel, worn, f)
    if worn.region == "pocket":
        return _upright(panel, worn.face or FRONT, worn.side, f.waist, DEPTH["pocket"])
    top = lifted if worn.region == "torso" else f.waist
    fork = _fork(panel) if worn.region == "leg" else None
    if fork is not None:
        rise = float(panel.vertices[:, 1].max() - fork[1])
        top = min(f.waist + 0.02, f.crotch - CROTCH + rise)
    return _upright(panel, worn.face, worn.side, top, DEPTH[worn.region])


def _upright(panel: Panel, face: int, side: int, top: float, depth: float) -> Panel:
    """Before or behind the body, its top at a height, in the middle or with its inner edge there."""
    across = _across(panel, face)
    rotation = np.diag([across, 1.0, across])
    low, high = panel.vertices.min(axis=0), panel.vertices.max(axis=0)
    ring = _ring(panel)
    low, high = np.minimum(low, ring.min(axis=0)), np.maximum(high, ring.max(axis=0))
    ends = np.sort(across * np.array([low[0], high[0]]))
    x = -0.5 * ends.sum() if not side else 0.004 - ends[0] if side > 0 else -0.004 - ends[1]
    return replace(panel, rotation=rotation, translation=np.array([x, top - high[1], face * depth]))


def _strip(panel: Panel, worn: Worn, at: Stand, low: float, girth: float, face: int, depth: float) -> Panel:
    """A strip with its long way across; one that is longer than half the girth is rolled around the body."""
    ring = _ring(panel)
    size = np.ptp(ring, axis=0)
    standing = size[1] > size[0]
    spin = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) if standing else np.eye(3)
    flat = spin[:2, :2]
    lying = replace(panel, vertices=panel.vertices @ flat.T, edges=tuple(_spun(e, flat) for e in panel.edges))
    stood = _upright(lying, face, worn.side, low + float(min(size)), depth)
    assert stood.rotation is not None and stood.translation is not None
    out = replace(panel, rotation=stood.rotation @ spin, translation=stood.translation)
    if max(size) < 0.55 * girth:
        return out
    skin = at.slice(low + 0.5 * float(min(size)), girth / 4 + 0.03)
    half = 0.5 * np.ptp(skin[:, [0, 2]], axis=0) if len(skin) else np.full(2, girth / 6)
    radius = max(float(half.max()) + ROOM, 1.02 * float(max(size)) / (2 * np.pi))
    middle = 0.5 * float(skin[:, 2].min() + skin[:, 2].max()) if len(skin) else 0.0
    place = stood.translation * [1, 1, 0] + [0, 0, middle + face * radius]
    return replace(out, translation=place, bend=np.array([0.0, 1.0] if standing else [1.0, 0.0]) / radius)


def _spun(edge: Edge, spin: Floats) -> Edge:
    return replace(edge, points=edge.points @ spin.T)


def _on_arm(panel: Panel, worn: Worn, at: Stand) -> Panel:
    """Rolled around the arm from above, its top (v) towards the shoulder; halves that face forwards or backwards hang
    before or behind it."""
    f, side = at.figure, worn.side or LEFT
    shoulder, elbow = at.arms[side]
    way = elbow - shoulder
    out = np.array([way[0], way[1], 0.0]) / np.hypot(way[0], way[1])
    ring = _ring(panel)
    start = shoulder + (abs(f["shoulder_width"] / 2 + 0.02 - abs(shoulder[0])) / max(abs(out[0]), 0.2)) * out
    if worn.region == "cuff":
        start = shoulder + (f["arm_length"] - float(np.ptp(ring[:, 1]))) * out
    wound = 1.0 if area(panel) > 0 else -1.0
    if worn.face:
        return _half_sleeve(panel, worn.face, side, ring, start, float(np.arctan2(-out[1], side * out[0])), wound)
    up = np.array([-side * out[1], side * out[0], 0.0])
    v, w = -out, wound * up
    rotation = np.stack([np.cross(v, w), v, w], axis=1)
    top = np.array([0.5 * (ring[:, 0].min() + ring[:, 0].max()), ring[:, 1].max(), 0.0])
    radius = max(f["upper_arm"] / (2 * np.pi) + ROOM, 1.02 * float(np.ptp(ring[:, 0])) / (2 * np.pi))
    bend = np.array([1 / radius, 0.0])
    return replace(panel, rotation=rotation, translation=start + radius * up - rotation @ top, bend=bend)


def _half_sleeve(panel: Panel, face: int, side: int, ring: Floats, start: Floats, arms: float, wound: float) -> Panel:
    """Half a sleeve that is drawn along u, as the wearer is seen from the front, or along v."""
    turn = -side * arms
    across = face * wound
    spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    rotation = spin @ np.diag([across, 1.0, across])
    flat = ring * [across, 1.0]
    inner = float((side * flat[:, 0]).min()) * side
    middle = 0.5 * float(flat[:, 1].min() + flat[:, 1].max())
    at = start + np.array([0, 0.02, face * 0.12]) - spin @ np.array([inner, middle, 0.0])
    return replace(panel, rotation=rotation, translation=at)


def _beside_head(panel: Panel, worn: Worn, f: Figure) -> Panel:
    side = worn.side or LEFT
    wound = 1.0 if area(panel) > 0 else -1.0
    w = np.array([side * wound, 0.0, 0.0])
    v = np.array([0.0, 1.0, 0.0])
    rotation = np.stack([np.cross(v, w), v, w], axis=1)
    ring = _ring(panel)
    low = np.array([0.5 * (ring[:, 0].min() + ring[:, 0].max()), ring[:, 1].min(), 0.0])
    at = np.array([side * DEPTH["hood"], f.nape, 0.0])
    return replace(panel, rotation=rotation, translation=at - rotation @ low)


def _anchored(panels: list[Panel], where: Mapping[str, Worn]) -> list[Panel]:
    """Panels whose waist is labelled where nothing else holds the garment: the upper edge of bands, or of what hangs."""
    regions = {w.region for w in where.values()}
    labels = {e.label for p in panels for e in p.edges}
    if regions & {"torso", "sleeve", "collar", "hood"} or any(label == WAIST for label in labels):
        return panels
    region = "band" if "band" in regions else None
    return [_waisted(p) if where[p.name].region in ((region,) if region else ("leg", "skirt")) else p for p in panels]


def _waisted(panel: Panel) -> Panel:
    """The panel with the edges along its top labelled as its waist."""
    if panel.rotation is None:
        return panel
    up = panel.rotation[1, :2]
    ring = _ring(panel) @ up
    high = float(ring.max())
    edges = list(panel.edges)
    for i, e in enumerate(edges):
        a, b = ends(panel, i)
        level = abs(float((b - a) @ up)) < 0.5 * float(np.hypot(*(b - a)))
        if level and min(float(a @ up), float(b @ up)) > high - 0.045:
            edges[i] = replace(e, label=WAIST)
    return replace(panel, edges=tuple(edges))
