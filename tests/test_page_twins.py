"""The pattern editor's page measures, cuts and resizes panels as Python does: both on the same random panels."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from vitruvian.cloth.dimensions import dimensions, evaluate, extended, fitted, lengthened
from vitruvian.cloth.drafting import DRAFTS, drafted
from vitruvian.cloth.pattern import Edge, Panel, Pattern, along, area, ends, length, loops, outline, placed
from vitruvian.cloth.placing import outward
from vitruvian.errors import VitruvianError
from vitruvian.formats.pattern_file import document, pattern_from

MEASURES = {"height": 1.7, "chest": 0.9, "waist": 0.72, "hips": 0.98}
GOOD = {
    "45": 45,
    " 4.5 ": 4.5,
    ".5": 0.5,
    "chest/4 + 2": 24.5,
    "2*(hips - waist)/3": 52 / 3,
    "-(-3)": 3,
    "min(chest, hips)/2": 45,
    "max(1, 2, 3)": 3,
    "sqrt(16) + abs(-2)": 6,
    "1 - 2 - 3": -4,
    "8/2/2": 2,
    "+waist": 72,
}
BAD = [
    *("", " ", "chest +", "(chest", "chest)", "bust", "1/0", "sqrt(-1)", "min()", "sqrt(1, 2)", "1 2", "chest.x"),
    *("__import__('os')", "chest/4;1", "2**3", "constructor", "toString", "eval(1)", "_", "1e5", "'1'", "a=1", "1%2"),
    *("(" * 80 + "1" + ")" * 80, "-" * 80 + "1", "1+" * 120 + "1", "\u0661", "\u00bd", "hips\u00b2"),
]


def random_panel(rng: np.random.Generator, hole: bool) -> Panel:
    n = int(rng.integers(3, 8))
    turn = np.sort(rng.uniform(0, 2 * np.pi, n)) * rng.choice([-1, 1])
    vertices = np.stack([np.cos(turn), np.sin(turn)], axis=1) * rng.uniform(0.1, 0.5, (n, 1)) + rng.normal(0, 0.3, 2)
    edges = []
    for i in range(n):
        a, b = vertices[i], vertices[(i + 1) % n]
        kind = str(rng.choice(["line", "quadratic", "cubic", "arc", "polyline"]))
        count = {"line": 0, "quadratic": 1, "cubic": 2, "arc": 1, "polyline": 3}[kind]
        points = np.sort(rng.uniform(0.1, 0.9, count))[:, None] * (b - a) + a + rng.normal(0, 0.05, (count, 2))
        edges.append(Edge(i, (i + 1) % n, kind, points, label="left_collar" if i == 0 else ""))
    if hole:
        middle = vertices.mean(axis=0)
        vertices = np.concatenate([vertices, middle + [[0, 0], [0.02, 0], [0, 0.02]]])
        edges += [Edge(n + i, n + (i + 1) % 3) for i in range(3)]
    q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    q[:, 2] *= np.linalg.det(q)
    return Panel("left_piece", vertices, tuple(edges), "body", q, rng.normal(size=3))


def panel_of(said: dict) -> Panel:
    return pattern_from({"vitruvian_pattern": 1, "name": "p", "panels": [said]}, "p").panels[0]


def dimensioned(name: str) -> Pattern:
    """A draft of which some edges and a width are said by measures."""
    made = drafted(name, MEASURES)
    p = made.panels[0]
    lines = [
        {"panel": p.name, "edge": 1, "length": "chest/4 + 1.5", "fix": "start", "stretch": True},
        {"panel": p.name, "edge": 2, "length": "max(waist, hips)/5", "fix": "middle", "stretch": False},
        {"panel": made.panels[-1].name, "axis": 0, "length": "hips/2 + 3"},
    ]
    return Pattern(name, made.panels, made.seams, extra={"drawing": {"dimensions": lines}})


@pytest.fixture(scope="module")
def asked():
    rng = np.random.default_rng(11)
    panels = [random_panel(rng, k % 5 == 4) for k in range(40)]
    return panels, [dimensioned(name) for name in DRAFTS]


@pytest.fixture(scope="module")
def twin(asked):
    """What the page answers."""
    if not shutil.which("node"):
        pytest.skip("node is missing")
    panels, patterns = asked
    said = [document(Pattern("p", (p,)))["panels"][0] for p in panels]
    question = {
        "panels": said,
        "expressions": [*GOOD, *BAD],
        "measures": MEASURES,
        "documents": [document(p) for p in patterns],
    }
    script = Path(__file__).with_name("pattern_twin.mjs")
    done = subprocess.run(
        ["node", str(script)], input=json.dumps(question), capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_lengths_areas_and_points_are_those_of_python(asked, twin):
    for panel, found in zip(asked[0], twin["panels"], strict=True):
        assert found["area"] == pytest.approx(area(panel), abs=1e-12)
        assert found["loops"] == list(loops(panel))
        for i in range(len(panel.edges)):
            assert found["lengths"][i] == pytest.approx(length(panel, i), abs=1e-12)
            here = along(panel, i, [0, 0.13, 0.5, 0.77, 1])
            assert np.abs(np.array(found["along"][i]) - here).max() < 1e-11
        for loop, points in zip(loops(panel), found["outline"], strict=True):
            assert np.abs(np.array(points) - outline(panel, loop, 0.01)).max() < 1e-11


def test_an_edge_that_is_cut_keeps_its_shape_and_its_label(asked, twin):
    for panel, said in zip(asked[0], twin["cut"], strict=True):
        made = panel_of(said)
        assert len(made.edges) == 2 * len(panel.edges)
        assert area(made) == pytest.approx(area(panel), abs=2e-6)  # Beziers are measured by chords
        for i in range(len(panel.edges)):
            one, two = length(made, 2 * i), length(made, 2 * i + 1)
            assert one + two == pytest.approx(length(panel, i), abs=2e-5)
            assert one == pytest.approx(0.37 * (one + two), abs=2e-5)
            assert made.edges[2 * i].label == made.edges[2 * i + 1].label == panel.edges[i].label
            assert np.abs(along(made, 2 * i, 1.0) - along(panel, i, 0.37)).max() < 2e-5
            assert np.abs(along(made, 2 * i + 1, 0.5) - along(panel, i, 0.685)).max() < 1e-4


def test_lengths_are_set_as_python_sets_them(asked, twin):
    for panel, found, wide in zip(asked[0], twin["longer"], twin["wider"], strict=True):
        ways = [(fix, stretch) for fix in ("start", "middle", "end") for stretch in (True, False)]
        for (fix, stretch), said in zip(ways, found, strict=True):
            made, here = panel_of(said), lengthened(panel, 1, 0.345, fix=fix, stretch=stretch)
            assert length(made, 1) == pytest.approx(0.345, abs=1e-9)
            assert np.abs(made.vertices - here.vertices).max() < 1e-11
            for e, f in zip(made.edges, here.edges):
                assert np.abs(e.points - f.points).max(initial=0) < 1e-10
            kept = {"start": [0], "end": [1], "middle": []}[fix]
            for k in kept:
                assert np.abs(ends(made, 1)[k] - ends(panel, 1)[k]).max() < 1e-12
        for axis, said in enumerate(wide):
            made, here = panel_of(said), extended(panel, axis, 0.777)
            assert np.abs(made.vertices - here.vertices).max() < 1e-11


def test_a_mirrored_panel_hangs_as_in_a_mirror_and_faces_outwards(asked, twin):
    across = np.array([-1.0, 1.0, 1.0])
    for panel, said in zip(asked[0], twin["mirrored"], strict=True):
        made = panel_of(said)
        assert made.name == "right_piece"
        assert area(made) == pytest.approx(area(panel), abs=1e-12)  # it winds the same way, so it can be sewn to it
        assert np.linalg.det(made.rotation) == pytest.approx(1)
        assert np.abs(placed(made, made.vertices) - placed(panel, panel.vertices) * across).max() < 1e-12
        assert np.abs(outward(made) - outward(panel) * across).max() < 1e-12
        assert sorted(length(made, i) for i in range(len(made.edges))) == pytest.approx(
            sorted(length(panel, i) for i in range(len(panel.edges)))
        )
        assert [e.label for e in made.edges].count("right_collar") == 1


def test_expressions_have_one_meaning_and_are_no_code(twin):
    for text, value, wanted in zip(GOOD, twin["values"], GOOD.values()):
        assert evaluate(text, MEASURES) == pytest.approx(wanted)
        assert value == pytest.approx(wanted), text
    for text, value in zip(BAD, twin["values"][len(GOOD) :], strict=True):
        assert value is None, text
        with pytest.raises(VitruvianError, match="dimension"):
            evaluate(text, MEASURES)


def test_dimensions_are_evaluated_anew_for_another_body_as_in_the_page(asked, twin):
    for pattern, found in zip(asked[1], twin["documents"], strict=True):
        here, there = fitted(pattern, MEASURES), pattern_from(found, "p")
        assert len(dimensions(here)) == 3 and here.measures == MEASURES
        for p, q in zip(here.panels, there.panels, strict=True):
            assert np.abs(p.vertices - q.vertices).max() < 1e-10
            for e, f in zip(p.edges, q.edges, strict=True):
                assert np.abs(e.points - f.points).max(initial=0) < 1e-9


def square(lines: list[object]) -> Pattern:
    corners = np.array([[0, 0], [0.4, 0], [0.4, 0.5], [0, 0.5]])
    panel = Panel("front", corners, tuple(Edge(i, (i + 1) % 4) for i in range(4)))
    return Pattern("square", (panel,), extra={"drawing": {"dimensions": lines}})


def test_a_rectangle_stays_one():
    made = fitted(square([{"panel": "front", "edge": 0, "length": "chest/2"}]), MEASURES).panels[0]
    assert [length(made, i) for i in range(4)] == pytest.approx([0.45, 0.5, 0.45, 0.5])
    made = fitted(square([{"panel": "front", "edge": 0, "length": "chest/2", "stretch": False}]), MEASURES).panels[0]
    assert length(made, 0) == pytest.approx(0.45) and length(made, 2) == pytest.approx(0.4)


def test_what_cannot_be_evaluated_names_the_panel_and_nonsense_is_left_out():
    with pytest.raises(VitruvianError, match=r"panel front.*no measure bust: there are chest, height"):
        fitted(square([{"panel": "front", "edge": 0, "length": "bust"}]), MEASURES)
    with pytest.raises(VitruvianError, match="positive"):
        fitted(square([{"panel": "front", "edge": 0, "length": "waist - chest"}]), MEASURES)
    strange = [
        7,
        {},
        {"panel": "front"},
        {"panel": "front", "edge": "0", "length": "3"},
        {"panel": 1, "axis": 0, "length": "1"},
    ]
    strange += [
        {"panel": "front", "edge": True, "length": "3"},
        {"panel": "front", "edge": 0, "length": "3", "fix": "up"},
    ]
    assert dimensions(square(strange)) == []
    unknown = square([{"panel": "back", "edge": 0, "length": "3"}, {"panel": "front", "edge": 9, "length": "3"}])
    assert np.array_equal(fitted(unknown, MEASURES).panels[0].vertices, unknown.panels[0].vertices)
    for extra in ({}, {"drawing": 3}, {"drawing": {"dimensions": "x"}}):
        plain = Pattern("square", unknown.panels, extra=extra)
        assert fitted(plain, MEASURES) is plain
