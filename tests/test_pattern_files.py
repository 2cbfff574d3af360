"""Our own pattern files: nothing is lost on the way, and what is wrong in one is said in a line."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import vitruvian as vt
from test_patterns import FILES, files, rectangle, tube
from vitruvian.cloth.drafting import drafted
from vitruvian.cloth.pattern import Button, Edge, Panel, Pattern, Seam, Span
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.pattern_file import document, pattern_from, text

number = st.floats(-900, 900, allow_nan=False)
point = st.tuples(number, number)
KINDS = {"line": 0, "quadratic": 1, "cubic": 2, "arc": 1, "polyline": 5}


def same(one: Pattern, two: Pattern) -> bool:
    """Whether two patterns are equal to the last bit."""
    for p, q in zip(one.panels, two.panels, strict=True):
        for field in ("vertices", "grain", "rotation", "translation"):
            a, b = getattr(p, field), getattr(q, field)
            if (a is None) != (b is None) or (a is not None and not np.array_equal(a, b)):
                return False
        plain = [(x.name, x.label, x.fabric, x.order) for x in (p, q)]
        edges = [[(e.start, e.end, e.kind, e.label, e.points.tolist()) for e in x.edges] for x in (p, q)]
        if plain[0] != plain[1] or edges[0] != edges[1]:
            return False
    rest = [(x.name, x.seams, x.buttons, dict(x.measures), dict(x.extra)) for x in (one, two)]
    return rest[0] == rest[1]


def everything() -> Pattern:
    """One of each."""
    corners = np.array([[0, 0], [0.3, 0], [0.3, 0.4], [0, 0.1 + 0.2]])
    edges = (
        Edge(0, 1, "cubic", [[0.1, -0.02], [0.2, 0.02]], "lower_interface"),
        Edge(1, 2, "arc", [[0.35, 0.2]]),
        Edge(2, 3, "polyline", [[0.2, 0.41], [0.1, 1 / 3]], "left_collar"),
        Edge(3, 0, "quadratic", [[-0.02, 0.2]]),
    )
    turn = np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])
    front = Panel("Vorderteil ½", corners, edges, "body", turn, [0, 1.1, 0.2], [0.1, 0.9], "denim", 2)
    hole = np.concatenate([rectangle("", 0.3, 0.3).vertices, [[0.1, 0.1], [0.1, 0.2], [0.2, 0.2]]])
    loops = (*(Edge(i, (i + 1) % 4) for i in range(4)), Edge(4, 5), Edge(5, 6), Edge(6, 4))
    seams = (
        Seam((Span("Vorderteil ½", 0, 0.1, 0.7), Span("Vorderteil ½", 1)), (Span("back", 2),), False, "gather", True),
        Seam((Span("back", 1),), (Span("back", 3),), kind="pleat"),
    )
    buttons = (Button(("back", (0.02, 0.02)), ("Vorderteil ½", (0.1, 1 / 7))),)
    extra = {"properties": {"a": [1, None, "x", {"b": 0.1}]}}
    return Pattern("all", (front, Panel("back", hole, loops)), seams, buttons, {"chest": 0.9984}, extra)


def test_everything_comes_back(tmp_path):
    path = tmp_path / "all.pattern.json"
    report = vt.save(everything(), path)
    assert report["lost"] == [] and same(vt.load(path), everything())
    assert path.read_text() == text(vt.load(path))
    lines = path.read_text().splitlines()
    assert sum('"ends"' in line for line in lines) == 4 + 7 and max(map(len, lines)) < 230
    plain = tmp_path / "all.json"  # what it is says its top key
    plain.write_bytes(path.read_bytes())
    assert same(vt.load(plain), everything())


@files
@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_real_patterns_come_back(path, tmp_path):
    pattern = vt.load(path)
    vt.save(pattern, tmp_path / "x.pattern.json")
    assert same(vt.load(tmp_path / "x.pattern.json"), pattern)


def test_drafts_come_back():
    for name in ("shirt", "trousers", "circle-skirt", "toga"):
        pattern = drafted(name, {"height": 1.7, "chest": 0.95, "waist": 0.8, "hips": 1.0})
        assert same(pattern_from(json.loads(text(pattern)), "x"), pattern)


@given(
    st.lists(point, min_size=3, max_size=6),
    st.lists(
        st.tuples(st.sampled_from(sorted(KINDS)), st.lists(point, min_size=5, max_size=5)), min_size=3, max_size=6
    ),
    st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=20),
    st.integers(-9, 9),
)
def test_any_panel_comes_back(corners, kinds, name, order):
    n = len(corners)
    edges = tuple(
        Edge(i % n, (i + 1) % n, k, points[: KINDS[k]] or np.zeros((0, 2))) for i, (k, points) in enumerate(kinds)
    )
    pattern = Pattern(name, (Panel(name, np.array(corners), edges, fabric=name, order=order),))
    assert same(pattern_from(json.loads(text(pattern)), "x"), pattern)


def test_what_is_left_out_is_what_it_usually_is():
    rows = [[0, 0], [1, 0], [0, 1]]
    triangle = {"name": "a", "vertices": rows, "edges": [{"ends": [i, (i + 1) % 3]} for i in range(3)]}
    pattern = pattern_from({"vitruvian_pattern": 1, "panels": [triangle]}, "said")
    panel = pattern.panels[0]
    assert pattern.name == "said" and panel.rotation is None and panel.grain.tolist() == [0, 1]
    assert [e.kind for e in panel.edges] == ["line"] * 3 and not pattern.seams


def changed(path: list[object], value: object) -> dict:
    """The document of `everything` with one value replaced."""
    whole = json.loads(json.dumps(document(everything())))
    place = whole
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = value
    return whole


FRONT = ["panels", 0]


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (["vitruvian_pattern"], 2, "from a newer vitruvian, found 2"),
        (["vitruvian_pattern"], "1", "expected a version"),
        (["panels"], {}, "panels: expected a list"),
        (["panels"], [], "at least one panel"),
        (["panels", 1, "name"], "Vorderteil ½", "different names of panels"),
        (["panels", 0, "name"], "a\nb", "panel 0 name: expected a line"),
        ([*FRONT, "vertices", 1], [1, None], "panel Vorderteil ½ vertices 1: expected 2 numbers"),
        ([*FRONT, "vertices", 1], [1, 10**400], "panel Vorderteil ½ vertices 1: expected 2 numbers"),
        ([*FRONT, "vertices", 1], [1, 1e300], "numbers up to 1000"),
        ([*FRONT, "edges", 2, "ends"], [2, 4], "panel Vorderteil ½ edge 2 ends: expected an index of 0 to 3, found 4"),
        ([*FRONT, "edges", 2, "ends"], [2, True], "edge 2 ends: expected an index"),
        ([*FRONT, "edges", 0, "kind"], "spiral", "edge 0 kind: expected one of line"),
        ([*FRONT, "edges", 0, "points"], [[0, 0]], "edge 0 points: expected 2 points of a cubic, found 1"),
        ([*FRONT, "rotation"], [[2, 0, 0], [0, 1, 0], [0, 0, 1]], "rotation: expected a rotation matrix"),
        ([*FRONT, "rotation"], [[1, 0, 0]], "rotation: expected a rotation matrix"),
        ([*FRONT, "grain"], [0, 0], "grain: expected a direction"),
        ([*FRONT, "order"], 0.5, "order: expected an integer"),
        (["seams", 0, "a", 0], ["nobody", 0], "seam 0 side a: expected the name of a panel"),
        (["seams", 0, "a", 0], ["back", 7], "seam 0 side a panel back edge: expected an index of 0 to 6"),
        (["seams", 0, "a", 0], ["back", 0, 0.5, 0.5], "0 <= t0 < t1 <= 1"),
        (["seams", 0, "b"], [], "seam 0 side b: expected at least one span"),
        (["seams", 0, "kind"], "glue", "seam 0 kind: expected one of plain"),
        (["seams", 0, "open"], 1, "seam 0 open: expected true or false"),
        (["buttons", 0, "a"], ["back", 1], "button 0 side a: expected 2 numbers"),
        (["measures", "chest"], "wide", "measures chest: expected a number"),
        (["extra"], [], "extra: expected an object"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(path, value, message, tmp_path):
    with pytest.raises(VitruvianError, match=message) as said:
        pattern_from(changed(path, value), "x")
    assert "\n" not in str(said.value)
    file = tmp_path / "x.pattern.json"
    file.write_text(json.dumps(changed(path, value)))
    with pytest.raises(FileError, match=message):
        vt.load(file)


def test_a_key_twice_is_an_error(tmp_path):
    file = tmp_path / "x.pattern.json"
    file.write_text(text(tube()).replace('"fabric": ""', '"name": "other"', 1))
    with pytest.raises(FileError, match="twice"):
        vt.load(file)


def test_what_json_cannot_say_is_not_written(tmp_path):
    for extra in ({"a": np.zeros(2)}, {"a": float("nan")}):
        with pytest.raises(VitruvianError, match="extra that JSON can hold"):
            vt.save(replace(tube(), extra=extra), tmp_path / "x.pattern.json")
    with pytest.raises(VitruvianError, match="a line of"):
        vt.save(replace(tube(), name="a\nb"), tmp_path / "x.pattern.json")
    with pytest.raises(VitruvianError, match="a pattern can be written as .pattern.json"):
        vt.save(tube(), tmp_path / "x.glb")
    assert not list(tmp_path.iterdir())
