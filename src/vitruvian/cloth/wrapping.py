"""Places for patterns that have none: from names, labels and shapes, panels stand before, behind and beside the body.

Source: note cloth.md, sections 2.2, 2.4 and 5. Panels stay flat, as those of our own drafts; the tailor then moves each
outwards until it is clear of the skin.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.drafting.figure import Figure
from vitruvian.cloth.pattern import Edge, Panel, Pattern, along, area, ends, length, loops
from vitruvian.cloth.placing import ARMS
from vitruvian.errors import VitruvianError

WAIST = "lower_interface"  # the label of the edge that a garment without shoulders hangs by
RISE, CROTCH = 0.018, 0.02  # metres of a shoulder's inner end over the nape, of a fork under the crotch
DEPTH = {"torso": 0.16, "skirt": 0.14, "leg": 0.14, "band": 0.14, "pocket": 0.22, "collar": 0.12, "hood": 0.14}
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
LIKE = {"cuff": "sleeve", "arm": "sleeve"}
MIRRORED = "mirrored"


@dataclass(frozen=True)
class Worn:
    """Where a panel is worn: its region (a key of `REGIONS`), which way it faces (`FRONT`, `BACK`, 0: neither), and the
    side of the body (`LEFT`, `RIGHT`, 0: the middle)."""

    region: str
    face: int
    side: int


def wrapped(pattern: Pattern, figure: Figure, *, arms: float = ARMS) -> Pattern:
    """The pattern with a place for every panel that has none, and the waist of a garment without shoulders labelled.

    figure: the body's landmarks; arms: how far below the horizontal its arms hang, radians. Panels that have a place keep
    it. `extra["wrap"]`, panel -> words, goes before what its name and label say. VitruvianError for a panel of which
    neither words nor shape say where it belongs.
    """
    if all(p.rotation is not None and p.translation is not None for p in pattern.panels):
        return pattern
    where = wearing(pattern)
    panels = [
        p if p.rotation is not None and p.translation is not None else _stood(p, where[p.name], figure, arms)
        for p in pattern.panels
    ]
    return replace(pattern, panels=tuple(_anchored(panels, where)))


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
    if worn.region in ("band", "collar", "pocket") or _symmetric(panel):
        return 0
    if worn.region == "hood":
        return LEFT if MIRRORED in _words(panel.name) else RIGHT
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


def _stood(panel: Panel, worn: Worn, f: Figure, arms: float) -> Panel:
    if worn.region in ("sleeve", "cuff"):
        return _on_arm(panel, worn, f, arms)
    if worn.region == "band":
        return _around_waist(panel, worn, f)
    if worn.region == "collar":
        return _upright(panel, worn.face or BACK, worn.side, f.nape + 0.06, DEPTH["collar"])
    if worn.region == "hood":
        return _beside_head(panel, worn, f)
    if worn.region == "pocket":
        return _upright(panel, worn.face or FRONT, worn.side, f.waist, DEPTH["pocket"])
    top = f.nape + RISE if worn.region == "torso" else f.waist
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


def _around_waist(panel: Panel, worn: Worn, f: Figure) -> Panel:
    """A strip along the waist, its long way across; one that goes all the way round stands before the body."""
    ring = _ring(panel)
    size = np.ptp(ring, axis=0)
    face = worn.face or FRONT
    if size[0] >= size[1]:
        return _upright(panel, face, worn.side, f.waist + float(size[1]), DEPTH["band"])
    spin = np.array([[0.0, 1.0], [-1.0, 0.0]])  # u, v of the strip as it lies
    lying = replace(panel, vertices=panel.vertices @ spin.T, edges=tuple(_spun(e, spin) for e in panel.edges))
    stood = _upright(lying, face, worn.side, f.waist + float(size[0]), DEPTH["band"])
    whole = np.eye(3)
    whole[:2, :2] = spin
    assert stood.rotation is not None
    return replace(panel, rotation=stood.rotation @ whole, translation=stood.translation)


def _spun(edge: Edge, spin: Floats) -> Edge:
    return replace(edge, points=edge.points @ spin.T)


def _on_arm(panel: Panel, worn: Worn, f: Figure, arms: float) -> Panel:
    """Above the arm, its top (v) towards the shoulder; halves that face forwards or backwards hang before or behind it."""
    side = worn.side or LEFT
    out = np.array([side * np.cos(arms), -np.sin(arms), 0.0])
    shoulder = np.array([side * (f["shoulder_width"] / 2), f.shoulder, 0.0])
    ring = _ring(panel)
    start = shoulder + 0.015 * out
    if worn.region == "cuff":
        start = shoulder + (f["arm_length"] - float(np.ptp(ring[:, 1]))) * out
    wound = 1.0 if area(panel) > 0 else -1.0
    if worn.face:
        return _half_sleeve(panel, worn.face, side, ring, start, arms, wound)
    up = np.array([side * np.sin(arms), np.cos(arms), 0.0])
    v, w = -out, wound * up
    rotation = np.stack([np.cross(v, w), v, w], axis=1)
    top = np.array([0.5 * (ring[:, 0].min() + ring[:, 0].max()), ring[:, 1].max(), 0.0])
    reach = f["upper_arm"] / (2 * np.pi) + 0.03
    return replace(panel, rotation=rotation, translation=start + reach * up - rotation @ top)


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
