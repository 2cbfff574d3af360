"""Our own patterns: they fit who they are drafted for, true up, and can be sewn."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vitruvian.cloth.drafting import DRAFTS, drafted
from vitruvian.cloth.drafting.figure import figure
from vitruvian.cloth.garment import buttoned
from vitruvian.cloth.pattern import Panel, Pattern, area, ends, length, loops, outline
from vitruvian.cloth.tessellate import angles, tessellate, topology, welded
from vitruvian.errors import VitruvianError

WOMAN = {
    "height": 1.66, "chest": 0.9, "underbust": 0.77, "waist": 0.72, "hips": 0.97, "neck": 0.33, "shoulder_width": 0.36,
    "arm_length": 0.54, "upper_arm": 0.28, "wrist": 0.155, "thigh": 0.56, "calf": 0.36, "inseam": 0.76, "back_length": 0.38,
}  # fmt: skip
STOUT = {"height": 1.7, "chest": 1.25, "waist": 1.3, "hips": 1.3}
CHILD = {"height": 1.2, "chest": 0.6, "waist": 0.54, "hips": 0.64}
# pieces, Euler characteristic, boundary loops: holes for what goes in and comes out
TOPOLOGY = {
    "tshirt": (1, -2, 4),
    "shirt": (1, -2, 4),
    "trousers": (1, -1, 3),
    "skirt": (1, 0, 2),
    "circle-skirt": (1, 0, 2),
    "dress": (1, -2, 4),
    "tunic": (1, -2, 4),
    "toga": (1, -1, 3),
}


def sides(pattern: Pattern) -> list[tuple[str, float, float]]:
    """Kind of each seam and the lengths of its sides."""
    panels = {p.name: p for p in pattern.panels}

    def side(spans: object) -> float:
        return sum(length(panels[s.panel], s.edge) * (s.t1 - s.t0) for s in spans)

    return [(s.kind, side(s.a), side(s.b)) for s in pattern.seams]


def width(panel: Panel, height: float) -> float:
    """How much of a level line lies inside a panel."""
    u = []
    for loop in loops(panel):
        p = outline(panel, loop, 0.002)
        q = np.roll(p, -1, axis=0)
        cut = (p[:, 1] > height) != (q[:, 1] > height)
        u += list(p[cut, 0] + (height - p[cut, 1]) / (q[cut, 1] - p[cut, 1]) * (q[cut, 0] - p[cut, 0]))
    u = np.sort(u)
    return float(np.sum(u[1::2] - u[::2]))


def girth(pattern: Pattern, height: float, label: str = "body") -> float:
    """Around the garment at a height over the soles, as its panels of that label hang."""
    return sum(width(p, height - p.translation[1]) for p in pattern.panels if p.label == label)


def measures_of(height: float, build: float, chest: float, waist: float, legs: float, arms: float) -> dict[str, float]:
    hips = 0.575 * height * build
    return {
        "height": height, "hips": hips, "chest": hips * chest, "waist": hips * waist, "inseam": height * legs,
        "back_length": 0.23 * height, "shoulder_width": 0.222 * height * (0.8 + 0.2 * build), "arm_length": height * arms,
        "neck": 0.37 * hips * chest, "upper_arm": 0.31 * hips, "wrist": 0.165 * hips, "thigh": 0.57 * hips,
        "calf": 0.38 * hips,
    }  # fmt: skip


people = st.builds(
    measures_of,
    height=st.floats(1.15, 2.05),
    build=st.floats(0.85, 1.45),
    chest=st.floats(0.84, 1.08),
    waist=st.floats(0.7, 1.02),
    legs=st.floats(0.44, 0.49),
    arms=st.floats(0.31, 0.35),
)


@pytest.mark.parametrize("name", DRAFTS)
@pytest.mark.parametrize("measures", [WOMAN, STOUT, CHILD], ids=["woman", "stout", "child"])
def test_drafts_can_be_cut_and_sewn(name, measures):
    pattern = drafted(name, measures)
    mesh = tessellate(pattern, 0.012)
    assert topology(welded(mesh)[mesh.triangles]) == TOPOLOGY[name]
    assert np.degrees(angles(mesh).min()) > 20
    for panel in pattern.panels:  # away from the body: fronts forwards, backs backwards
        faces = panel.rotation[:, 2] * area(panel)
        assert faces @ (panel.translation * [1, 0, 1]) > 0, panel.name
        assert abs(np.linalg.det(panel.rotation) - 1) < 1e-12


@settings(max_examples=25, deadline=None)
@given(measures=people, name=st.sampled_from(sorted(DRAFTS)))
def test_seams_true_up_whoever_it_is_for(measures, name):
    pattern = drafted(name, measures)
    for kind, a, b in sides(pattern):
        if kind == "ease":
            assert 1.0 <= a / b < 1.5
        else:
            assert abs(a - b) < 1e-4
    crossing = pytest.importorskip("vitruvian.cloth.doctor").examined(pattern)
    assert [f for f in crossing if f.severity == "error"] == []


@settings(max_examples=25, deadline=None)
@given(measures=people)
def test_garments_are_wider_than_who_wears_them(measures):
    at = figure(measures)
    shirt = drafted("tshirt", measures)
    low = min(p.translation[1] + p.vertices[:, 1].min() for p in shirt.panels if p.label == "body")
    for level, name, ease in ((at.nape - at["chest"] / 8 - 0.12 * at["height"], "chest", 0.09),):
        assert girth(shirt, level) >= measures[name] + ease
    for level, name in ((at.waist, "waist"), (at.hips, "hips")):
        if low + 0.005 < level:
            assert girth(shirt, level) >= measures[name] + 0.055
    for name in ("skirt", "trousers"):
        bottom = drafted(name, measures)
        hips = girth(bottom, at.hips - 1e-6, "leg" if name == "trousers" else "body")
        assert hips >= measures["hips"] + (0.0499 if name == "skirt" else 0.0599)
        top = [(p, i) for p in bottom.panels for i, e in enumerate(p.edges) if e.label == "lower_interface"]
        around = sum(length(p, i) for p, i in top)
        assert measures["waist"] + 0.019 <= around
        assert all(p.translation[1] + ends(p, i)[0][1] == pytest.approx(at.waist + 0.04) for p, i in top)
    thigh = girth(drafted("trousers", measures), at.crotch - 0.02, "leg") / 2
    assert thigh >= measures["thigh"] + 0.01


def test_options_change_what_they_say():
    slim = WOMAN | {"hips": 0.85}  # whose hips do not widen the hem
    plain, long = drafted("tshirt", slim), drafted("tshirt", slim, length=1.1, ease=0.2, sleeve=0.54)
    assert np.ptp(long.panel("front").vertices[:, 1]) - np.ptp(plain.panel("front").vertices[:, 1]) > 0.2
    chest = figure(WOMAN).armpit - 0.08
    assert girth(long, chest) - girth(plain, chest) == pytest.approx(0.1, abs=2e-3)
    assert np.ptp(long.panel("left_sleeve_front").vertices[:, 0]) == pytest.approx(0.54)
    ring = drafted("circle-skirt", WOMAN, circle=0.4, length=0.5, band=0.0)
    arcs = sorted(length(ring.panel("front"), i) for i in range(4))
    waist = (WOMAN["waist"] + 0.02) / 2
    assert arcs == pytest.approx(sorted([waist, 0.5, 0.5, waist + 0.4 * np.pi * 0.5]))
    buttons = drafted("shirt", WOMAN, closed="buttons")
    assert len(buttons.buttons) >= 5 and len(buttons.seams) == len(drafted("shirt", WOMAN).seams) - 1
    mesh = tessellate(buttons, 0.02)
    for button, pair in zip(buttons.buttons, buttoned(buttons, mesh)):
        off = [np.linalg.norm(mesh.material[v] - at) for v, (_, at) in zip(pair, (button.a, button.b))]
        assert max(off) < 1e-12, "a vertex where each button is sewn on"
    overlap = buttons.panel("left_front").vertices[:, 0].min(), buttons.panel("right_front").vertices[:, 0].max()
    assert overlap == pytest.approx((-0.015, 0.015))
    sleeved = drafted("dress", WOMAN, sleeve=0.5)
    mesh = tessellate(sleeved, 0.02)
    assert topology(welded(mesh)[mesh.triangles]) == (1, -2, 4)


def test_the_head_goes_through_what_does_not_stretch():
    for name in ("dress", "tunic"):
        for measures in (WOMAN, STOUT, CHILD):
            pattern = drafted(name, measures)
            labelled = [(p, i) for p in pattern.panels for i, e in enumerate(p.edges) if e.label.endswith("collar")]
            assert sum(length(p, i) for p, i in labelled) >= 0.338 * measures["height"]


def test_knowing_less_of_a_body_is_enough():
    short = {k: WOMAN[k] for k in ("height", "chest", "waist", "hips")}
    for name in DRAFTS:
        assert drafted(name, short).measures["inseam"] == pytest.approx(0.47 * 1.66)


@pytest.mark.parametrize(
    "name, measures, options, said",
    [
        ("tshrt", WOMAN, {}, "did you mean tshirt"),
        ("tshirt", {"height": 1.7}, {}, "chest is missing"),
        ("tshirt", WOMAN | {"chest": 96.0}, {}, "measure chest"),
        ("tshirt", WOMAN | {"chest": float("nan")}, {}, "measure chest"),
        ("skirt", WOMAN, {"lenght": 0.5}, "expected options"),
        ("skirt", WOMAN, {"length": 3.0}, "length: expected"),
        ("trousers", WOMAN, {"heights": {"knee": 2.0}}, "crotch above the knee"),
        ("circle-skirt", WOMAN, {"circle": 0.1}, "hips do not go into it"),
        ("shirt", WOMAN, {"closed": "zip"}, "closed: expected"),
    ],
)
def test_what_cannot_be_drafted_is_said(name, measures, options, said):
    with pytest.raises(VitruvianError, match=said) as found:
        drafted(name, measures, **options)
    assert "\n" not in str(found.value)
