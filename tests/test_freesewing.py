"""Drafts of FreeSewing and drawings of other programs: known lengths and areas, both encodings alike, hostile input."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import vitruvian as vt
from conftest import SHARED
from vitruvian.cloth.cutting import mirrored, nearest, panel_of, split, turned_edge, unfolded
from vitruvian.cloth.drafting import drafted
from vitruvian.cloth.pattern import Edge, Panel, Pattern, along, area, length, loops
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.svg_path import runs, transform

FOLDER = SHARED / "data/patterns/freesewing"
real = pytest.mark.skipif(not FOLDER.is_dir(), reason="needs ../shared/data/patterns")
DESIGNS = ("teagan", "penelope", "titan")
# note cloth.md, 2.2: half-piece areas cm2, and mm between named points
AREAS = {
    "teagan": {"front": 1598.52, "back": 1653.98, "sleeve": 538.14},
    "penelope": {"back": 1903.74, "front": 1722.06, "waistband": 269.16},
    "titan": {"back": 3368.05, "front": 2822.10},
}


def design(name: str, form: str = "json") -> Pattern:
    return vt.load(FOLDER / f"freesewing_{name}_w38.{form}")


def between(pattern: Pattern, panel: str, *names: str) -> float:
    """Millimetres of the edges of these names in one half of a panel."""
    p = pattern.panel(panel)
    half = range(len(p.edges)) if panel.startswith("sleeve") else range(len(p.edges) // 2 or 1)
    half = half if pattern.name.startswith("freesewing_teagan") else range(len(p.edges))
    return 1000 * sum(length(p, i) for i in half if p.edges[i].label in names)


@real
@pytest.mark.parametrize("form", ["json", "svg"])
@pytest.mark.parametrize("name", DESIGNS)
def test_areas(name, form):
    pattern = design(name, form)
    folded = {"teagan": ("front", "back"), "penelope": ("front", "waistband"), "titan": ()}[name]
    for panel, known in AREAS[name].items():
        pieces = [p for p in pattern.panels if p.name.removesuffix("_mirrored") == panel]
        assert len(pieces) == (1 if panel in folded else 2)
        for p in pieces:
            assert 1e4 * area(p) == pytest.approx(known * (2 if panel in folded else 1), rel=3e-5)


@real
def test_lengths():
    t = design("teagan")
    hole = ("armhole..armholeHollow", "armholeHollow..shoulder")
    for panel, armhole in (("front", 257.10), ("back", 255.44)):
        assert between(t, panel, "shoulder..neck") == pytest.approx(103.69, abs=0.005)
        assert between(t, panel, "hem..armhole") == pytest.approx(393.87, abs=0.005)
        assert between(t, panel, *hole) == pytest.approx(armhole, abs=0.01)
    cap = [e.label for e in t.panel("sleeve").edges if "cap" in e.label]
    assert between(t, "sleeve", *cap) == pytest.approx(512.55, abs=0.01)
    p = design("titan")
    assert between(p, "back", "floorOut..seatY", "seatY..styleWaistOut") == pytest.approx(1092.51, abs=0.01)
    assert between(p, "front", "styleWaistOut..seatOut", "seatOut..floorOut") == pytest.approx(1092.50, abs=0.01)
    assert between(p, "back", "fork..floorIn") == pytest.approx(811.79, abs=0.01)
    assert between(p, "front", "floorIn..fork") == pytest.approx(812.03, abs=0.01)
    s = design("penelope")
    for panel, legs in (("back", (108.08, 108.09, 134.89, 134.89)), ("front", (97.14, 97.14, 121.29, 121.29))):
        of = s.panel(panel)
        darts = [1000 * length(of, i) for i, e in enumerate(of.edges) if "Middle" in e.label]
        assert darts[:4] == pytest.approx(legs, abs=0.006)


@real
@pytest.mark.parametrize("name", DESIGNS)
def test_both_encodings_are_one_pattern(name):
    a, b = design(name), design(name, "svg")
    assert [p.name for p in a.panels] == [p.name for p in b.panels]
    assert a.extra.get("notches") == b.extra.get("notches")
    for p, q in zip(a.panels, b.panels):
        assert [(e.start, e.end, e.kind) for e in p.edges] == [(e.start, e.end, e.kind) for e in q.edges]
        assert np.abs(p.vertices - q.vertices).max() < 2e-5 and p.grain == pytest.approx(q.grain, abs=1e-3)
        for i in range(len(p.edges)):
            t = np.linspace(0, 1, 9)
            assert np.abs(along(p, i, t) - along(q, i, t)).max() < 4e-5


@real
def test_notches_grain_and_folds():
    t = design("teagan")
    marks = t.extra["notches"]
    assert len([m for m in marks if m[0] == "front"]) == 2 == len([m for m in marks if m[0] == "sleeve"])
    front = t.panel("front")
    assert len(front.edges) == 14 and front.vertices[:, 0].min() == pytest.approx(-front.vertices[:, 0].max())
    assert t.panel("sleeve").grain == pytest.approx([0, 1])
    assert design("penelope").panel("waistband").grain == pytest.approx([1, 0])  # along the fold


def test_a_half_unfolds_to_the_whole():
    corners = np.array([[0, 0], [0.3, 0], [0.2, 0.4], [0, 0.5]])
    edges = (
        Edge(0, 1),
        Edge(1, 2, "cubic", [[0.35, 0.1], [0.1, 0.3]], "left_armhole"),
        Edge(2, 3, "arc", [[0.12, 0.47]]),
    )
    half = Panel("half", corners, (*edges, Edge(3, 0)))
    whole = unfolded(half, corners[[0, 3]])
    assert area(whole) == pytest.approx(2 * area(half)) and len(whole.edges) == 6 == len(whole.vertices)
    assert [e.label for e in whole.edges] == ["", "left_armhole", "", "", "right_armhole", ""]
    assert [length(whole, i) for i in range(6)] == pytest.approx([length(half, i) for i in (0, 1, 2, 2, 1, 0)])
    ring = np.array([[0.05, 0.1], [0.15, 0.1], [0.1, 0.2]])
    edges = (*half.edges, Edge(4, 5), Edge(5, 6, "arc", [[0.14, 0.17]]), Edge(6, 4))
    hole = replace(half, vertices=np.concatenate([corners, ring]), edges=edges)
    whole = unfolded(hole, corners[[0, 3]])
    assert area(whole) == pytest.approx(2 * area(hole)) and len(list(loops(whole))) == 3
    with pytest.raises(VitruvianError, match="one run of edges on the fold, found none"):
        unfolded(half, np.array([[5.0, 0], [5, 1]]))


def test_a_mirrored_piece_is_wound_as_the_piece_is():
    points = {
        "quadratic": [[1, 0.4]],
        "cubic": [[0.3, 0.4], [1.4, -0.2]],
        "arc": [[1, 0.3]],
        "polyline": [[0.5, 0.1], [1, 0.2]],
    }
    for kind, inner in points.items():
        corners = np.array([[0.0, 0], [2, 0], [1, 2]])
        panel = Panel("p", corners, (Edge(0, 1, kind, np.array(inner) * [1, -1]), Edge(1, 2), Edge(2, 0)), "left_leg")
        other = mirrored(panel, "q")
        assert area(other) == pytest.approx(area(panel)) and other.label == "right_leg"
        for i in range(3):
            there = along(other, turned_edge(panel, i), 1 - np.linspace(0, 1, 7)) * [-1, 1]
            assert there == pytest.approx(along(panel, i, np.linspace(0, 1, 7)), abs=1e-9)


@pytest.mark.parametrize("kind", ["line", "quadratic", "cubic", "arc", "polyline"])
def test_pieces_of_an_edge_are_the_edge(kind):
    inner = {
        "line": [],
        "quadratic": [[1, 0.9]],
        "cubic": [[0.1, 0.9], [1.9, -0.9]],
        "arc": [[1, -0.7]],
        "polyline": [[0.5, 0.2], [1.2, -0.3]],
    }
    corners = np.array([[0.0, 0], [2, 0], [1, 3]])
    panel = Panel("p", corners, (Edge(0, 1, kind, np.array(inner[kind]).reshape(-1, 2), "a"), Edge(1, 2), Edge(2, 0)))
    cuts = [0.2, 0.55, 0.9]
    out = split(panel, 0, cuts)
    assert len(out.edges) == 6 and area(out) == pytest.approx(area(panel), rel=1e-4)
    sizes = np.array([length(out, i) for i in range(4)])
    assert sizes.sum() == pytest.approx(length(panel, 0), rel=1e-4)
    assert sizes / sizes.sum() == pytest.approx(np.diff([0, *cuts, 1]), abs=2e-4)
    t = np.linspace(0, 1, 21)
    for i in range(4):
        for point in along(out, i, t):
            assert nearest(panel, point)[2] < 1e-4
    edge, t, apart = nearest(panel, along(panel, 0, 0.3)[0] + [0, 1e-4])
    assert edge == 0 and t == pytest.approx(0.3, abs=1e-3) and apart < 1.1e-4


def test_the_language_of_paths():
    (run,) = runs("M10 10h5v-5l-5,0z")
    assert run.closed and [s[1][-1].tolist() for s in run.segments] == [[15, 10], [15, 5], [10, 5], [10, 10]]
    one, two = runs("m1,1 2,0 0,2z m5 5 1 0")  # a move after z is from the subpath's start; more points are lines
    assert one.segments[1][1][-1].tolist() == [3, 3] and two.segments[0][1].tolist() == [[6, 6], [7, 6]]
    (run,) = runs("M0 0C1 0 2 1 2 2S3 4 4 4")
    assert run.segments[1][1].tolist() == [[2, 2], [2, 3], [3, 4], [4, 4]]
    (run,) = runs("M0 0Q1 1 2 0T4 0 6 0")
    assert [s[1][1].tolist() for s in run.segments] == [[1, 1], [3, -1], [5, 1]]
    (run,) = runs("M0,0a5,5 0 0110,0")  # flags need no blanks
    kind, points = run.segments[0]
    assert kind == "arc" and points.tolist() == pytest.approx(np.array([[0, 0], [5, -5], [10, 0]]))
    (run,) = runs("M.5-.5.5 5e-1-1-.5", np.diag([2.0, -2, 1]))
    assert [p.tolist() for _, s in run.segments for p in s[1:]] == [[1, -1], [-2, 1]]


@pytest.mark.parametrize(("large", "sweep"), [(0, 0), (0, 1), (1, 0), (1, 1)])
@pytest.mark.parametrize("radii", [(5, 5), (5, 3)])
def test_arcs_lie_on_their_ellipse(large, sweep, radii):
    """F.6 of SVG: on the ellipse, on the side that the flags say; a flattened one as cubics."""
    turn = 0.0 if radii[0] == radii[1] else 30.0
    (run,) = runs(f"M1 2A{radii[0]} {radii[1]} {turn} {large} {sweep} 4 5")
    whole = [Panel("e", p[[0, -1]], (Edge(0, 1, kind, p[1:-1]), Edge(1, 0))) for kind, p in run.segments]
    points = np.concatenate([along(one, 0, np.linspace(0, 1, 33)) for one in whole])
    assert points[0] == pytest.approx([1, 2]) and points[-1] == pytest.approx([4, 5])
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    flat = points @ np.array([[c, -s], [s, c]]) / radii
    a, b, d = flat[0], flat[len(flat) // 3], flat[-1]
    system = 2 * np.array([b - a, d - a])
    center = np.linalg.solve(system, [b @ b - a @ a, d @ d - a @ a])
    assert np.hypot(*(flat - center).T) == pytest.approx(1, abs=2e-4)
    way = np.unwrap(np.arctan2(*(flat - center).T[::-1]))
    assert (way[-1] - way[0] > 0) == bool(sweep) and (abs(way[-1] - way[0]) > np.pi) == bool(large)


def test_transforms():
    p = np.array([1.0, 2, 1])
    assert transform("translate(3)") @ p == pytest.approx([4, 2, 1])
    assert transform("rotate(90, 1, 1)") @ p == pytest.approx([0, 1, 1])
    assert transform("translate(1 1) scale(2), matrix(1 0 0 1 0 5)") @ p == pytest.approx([3, 15, 1])
    assert transform("skewX(45)") @ p == pytest.approx([3, 2, 1])
    for bad in ("perspective(3)", "rotate(1,2)", "scale()", "translate(1,2) x", "scale(1e9)"):
        with pytest.raises(VitruvianError, match="transform: expected"):
            transform(bad)


def svg(body: str, head: str = 'width="300mm" height="200mm" viewBox="0 0 300 200"') -> str:
    return f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:inkscape="i" {head}>{body}</svg>'


def loaded(tmp_path, text: str, **options: object) -> Pattern:
    path = tmp_path / "x.svg"
    path.write_text(text, encoding="utf-8")
    return vt.load(path, **options)


def test_plain_drawings(tmp_path):
    square = '<g transform="translate(10,10)"><path id="Rücken" d="M0 0h100v50h-100z M20 20h20v20h-20z"/></g>'
    more = '<rect inkscape:label="pocket" x="1" y="1" width="40" height="30"/><path d="M0 0L5 5"/>'
    unseen = "<defs><path d='M0 0h100v50h-100z'/></defs><g display='none'><path d='M0 0h100v50h-100z'/></g>"
    pattern = loaded(tmp_path, svg(square + more + unseen))
    assert [p.name for p in pattern.panels] == ["Rücken", "pocket"]
    assert [area(p) for p in pattern.panels] == pytest.approx([0.0046, 0.0012])
    assert len(list(loops(pattern.panels[0]))) == 2
    twice = loaded(tmp_path, svg(square, 'viewBox="0 0 300 200" width="60cm"'))
    assert area(twice.panels[0]) == pytest.approx(4 * 0.0046)
    pixels = loaded(tmp_path, svg('<circle id="disc" r="96"/>', ""))
    assert area(pixels.panels[0]) == pytest.approx(np.pi * 0.0254**2)
    assert [
        p.name
        for p in loaded(tmp_path, svg(square + '<rect class="a b" width="20" height="20"/>'), outlines="b").panels
    ] == ["piece1"]


@pytest.mark.parametrize("name", ["shirt", "circle-skirt", "trousers"])
def test_our_own_drawings_come_back(name, tmp_path):
    pattern = drafted(name, {"height": 1.7, "chest": 0.95, "waist": 0.8, "hips": 1.0})
    vt.save(pattern, tmp_path / "x.svg")
    back = vt.load(tmp_path / "x.svg")
    assert [p.name for p in back.panels] == [p.name for p in pattern.panels]
    for p, q in zip(pattern.panels, back.panels):
        kinds = [[e.kind for e in x.edges] for x in (p, q)]
        assert [a if a == b else b for a, b in zip(*kinds, strict=True)] == kinds[1]
        assert [length(q, i) for i in range(len(q.edges))] == pytest.approx(
            [length(p, i) for i in range(len(p.edges))], abs=1e-6
        )
        assert area(q) == pytest.approx(area(p), rel=1e-5) and q.grain @ p.grain == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (svg(""), "expected closed outlines, found none"),
        (svg('<path d="M0 0L5 x"/>'), "expected a number at character 7"),
        (svg('<path d="L0 0"/>'), "expected M or m"),
        (svg('<path d="M0 0z5 5"/>'), "expected a command"),
        (svg('<path d="M0 0A1 1 0 2 0 3 3"/>'), "a flag, 0 or 1"),
        (svg('<path d="M0 0L1e300 0"/>'), "numbers up to"),
        (svg(f'<path d="M0 0{"h1 " * 30000}"/>'), "at most 20000 numbers"),
        (svg('<g transform="warp(2)"/>'), "transform: expected one of matrix"),
        (svg("", 'viewBox="0 0 1"'), "viewBox: expected four numbers"),
        (svg("", 'viewBox="0 0 100 100" width="100mm" height="50mm"'), "in the proportion of the viewBox"),
        (svg("<g>" * 300 + "</g>" * 300), "at most 200 elements inside"),
        ("<html/>", "expected an svg element at the top"),
        ("<svg>", "not well-formed XML"),
        ('<!DOCTYPE svg [<!ENTITY a "aaaa">]><svg>&a;</svg>', "entity; that is refused"),
        (svg('<rect width="5x" height="5"/>'), "width: expected a length"),
    ],
)  # fmt: skip
def test_what_is_no_drawing(text, message, tmp_path):
    with pytest.raises(FileError, match=message):
        loaded(tmp_path, text)


def dump(**changes: object) -> dict:
    """A square of 100 mm whose left side is a fold."""
    move, lines = {"type": "move", "to": [0, 0]}, [[0, 100], [100, 100], [100, 0], [0, 0]]
    ops = [move, *({"type": "line", "to": to} for to in lines), {"type": "close"}]
    fold = [move, {"type": "line", "to": [0, 100]}]
    paths = {"seam": {"class": "fabric", "ops": ops}, "__macro_cutonfold_x_line": {"class": "note", "ops": fold}}
    part = {
        "points": {"a": [0, 0], "b": [100, 0]},
        "paths": paths,
        "snippets": {"n": {"def": "notch", "at": [100, 40]}},
    }
    part["paths"] = paths | changes.pop("paths", {})
    return {"units": "mm", "parts": {"x.one": part | changes.pop("part", {})}} | changes


def test_a_dump_by_hand(tmp_path):
    path = tmp_path / "x.json"
    path.write_text(json.dumps(dump()))
    (panel,) = vt.load(path).panels
    assert panel.name == "one" and area(panel) == pytest.approx(0.02) and len(panel.edges) == 8
    assert vt.load(path).extra["notches"] == [["one", 2, "notch"], ["one", 6, "notch"]]


@pytest.mark.parametrize(
    ("document", "message"),
    [
        (dump(units="inch"), "units: expected mm"),
        (dump(parts=[]), "parts: expected an object"),
        (dump(parts={"a": {}}), 'one with a path of class "fabric"'),
        (dump(paths={"seam": {"class": "fabric", "ops": [{"type": "spline"}]}}), "op 0: expected one of move"),
        (dump(paths={"seam": {"class": "fabric", "ops": [{"type": "line", "to": [1]}]}}), "op 0 to: expected 2 numbers"),
        (dump(paths={"seam": {"class": "fabric", "ops": [{"type": "line", "to": [1e9, 0]}]}}), "numbers up to"),
        (dump(part={"points": {"a": "here"}}), "point a: expected 2 numbers"),
        (dump(part={"snippets": {"a": {"def": "notch"}}}), "snippet a: expected 2 numbers"),
        (dump(paths={"__macro_cutonfold_x_line": {"ops": [{"type": "line", "to": [9, 1]}]}}), "on the fold, found none"),
    ],
)  # fmt: skip
def test_what_is_no_dump(document, message, tmp_path):
    path = tmp_path / "x.json"
    path.write_text(json.dumps(document))
    with pytest.raises(FileError, match=message):
        vt.load(path)


def test_panels_of_segments_are_closed_and_cleaned():
    a, b, c = np.array([0.0, 0]), np.array([0.0, 0.1]), np.array([0.1, 0.1])
    run = [("line", np.array([a, b])), ("line", np.array([b, b + 1e-7])), ("cubic", np.array([b, b + [0.02, 0], c, c]))]
    panel = panel_of("p", [run])
    assert [e.kind for e in panel.edges] == ["line"] * 3 and area(panel) == pytest.approx(0.005)
    with pytest.raises(VitruvianError, match="panel p: expected a closed outline, found 0 edges"):
        panel_of("p", [[("line", np.array([a, a]))]])
