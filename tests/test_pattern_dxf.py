"""Patterns in the DXF of apparel CAD: the edges of the pattern that was written, corners, folds, hostile input."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

import vitruvian as vt
from conftest import ROOT, SHARED
from test_patterns import rectangle
from vitruvian.cloth.drafting import drafted
from vitruvian.cloth.pattern import Edge, Panel, Pattern, area, length, loops
from vitruvian.cloth.tessellate import tessellate, topology, welded
from vitruvian.errors import FileError, MissingExtra, VitruvianError

FOLDER = SHARED / "data/patterns"
FILES = sorted((FOLDER / "dxf").glob("*.dxf"))
ezdxf = pytest.importorskip("ezdxf", reason="needs the extra patterns: pip install 'vitruvian[patterns]'")


@pytest.mark.skipif(not FILES, reason="needs ../shared/data/patterns")
@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_edges_are_those_of_the_pattern_that_was_written(path):
    pattern = vt.load(path)
    source = vt.load(FOLDER / "garmentcode" / f"{path.stem}.json")
    truth = json.loads((FOLDER / "garmentcode" / f"{path.stem}.truth.json").read_text())["panels"]
    names = {p.name[:31].upper(): p.name for p in source.panels}
    assert sorted(p.name for p in pattern.panels) == sorted(names)
    for p in pattern.panels:
        known = truth[names[p.name]]
        assert len(p.edges) == len(known["edge_len"])
        assert 100 * sum(length(p, i) for i in range(len(p.edges))) == pytest.approx(sum(known["edge_len"]), rel=5e-4)
        assert 1e4 * abs(area(p)) == pytest.approx(known["area"], rel=2e-3)
        assert [100 * length(p, i) for i in range(len(p.edges))] == pytest.approx(known["edge_len"], rel=1e-3)
    # so that its seams fit
    own = {v: k for k, v in names.items()}
    spans = [[tuple(replace(x, panel=own[x.panel]) for x in side) for side in (s.a, s.b)] for s in source.seams]
    sewn = replace(pattern, seams=tuple(replace(s, a=a, b=b) for s, (a, b) in zip(source.seams, spans)))
    one, two = tessellate(sewn, 0.03), tessellate(source, 0.03)
    assert topology(welded(one)[one.triangles]) == topology(welded(two)[two.triangles])


@pytest.mark.parametrize("name", ["shirt", "trousers", "circle-skirt"])
def test_what_is_written_is_read(name, tmp_path):
    pattern = drafted(name, {"height": 1.7, "chest": 0.95, "waist": 0.8, "hips": 1.0})
    lost = vt.save(pattern, tmp_path / "x.dxf")["lost"]
    assert "seams" in lost and "places" in lost
    back = vt.load(tmp_path / "x.dxf")
    assert [p.name for p in back.panels] == [p.name for p in pattern.panels]
    for p, q in zip(pattern.panels, back.panels):
        assert len(p.edges) == len(q.edges) and q.grain == pytest.approx(p.grain, abs=1e-6)
        here = [length(x, i) for x in (p, q) for i in range(len(p.edges))]
        assert here[: len(p.edges)] == pytest.approx(here[len(p.edges) :], rel=2e-4)
        assert area(q) == pytest.approx(area(p), rel=1e-4)


def test_holes_and_long_names_survive(tmp_path):
    ring = np.array([[0.1, 0.1], [0.1, 0.2], [0.2, 0.2]])
    outer = rectangle("a very long name of a panel, Größe 38 ½", 0.3, 0.3)
    edges = (*outer.edges, Edge(4, 5), Edge(5, 6), Edge(6, 4))
    frame = replace(outer, vertices=np.concatenate([outer.vertices, ring]), edges=edges)
    twin = replace(frame, name=outer.name + "!")
    vt.save(Pattern("p", (frame, twin)), tmp_path / "x.dxf")
    back = vt.load(tmp_path / "x.dxf")
    assert [p.name for p in back.panels] == [frame.name, twin.name]
    assert area(back.panels[0]) == pytest.approx(0.085) and len(list(loops(back.panels[0]))) == 2


def test_newer_entities_folds_and_units(tmp_path):
    """LWPOLYLINE with arcs, SPLINE, a fold, inches, a mirrored pair, turn points; a line of the outline for each side."""
    document = ezdxf.new("R2010")
    front = document.blocks.new("FRONT")
    front.add_lwpolyline(
        [(0, 0, 0), (5, 0, 0.5), (5, 8, 0), (0, 8, 0)], format="xyb", close=True, dxfattribs={"layer": "14"}
    )
    front.add_line((0, 0), (0, 8), dxfattribs={"layer": "6"})
    front.add_lwpolyline([(1, 1), (2, 1), (2, 3)], dxfattribs={"layer": "8"})
    sleeve = document.blocks.new("SLEEVE")
    for a, b in (((0, 0), (4, 0)), ((4, 6), (4, 0)), ((4, 6), (0, 6))):
        sleeve.add_line(a, b, dxfattribs={"layer": "1"})
    sleeve.add_spline([(0, 6), (-1, 3), (0, 0)], dxfattribs={"layer": "1"})
    sleeve.add_point((2, 0), dxfattribs={"layer": "4"})
    for block, text in ((front, "QUANTITY: 1"), (sleeve, "QUANTITY: 2"), (sleeve, "PIECE NAME: sleeve")):
        block.add_text(text)
    document.modelspace().add_text("Units: English")
    path = tmp_path / "x.dxf"
    document.saveas(path)
    pattern = vt.load(path)
    assert [p.name for p in pattern.panels] == ["FRONT", "sleeve", "sleeve_mirrored"]
    inch, angle = 0.0254, 4 * np.arctan(0.5)
    r = 4 / np.sin(angle / 2)
    bulge = 0.5 * r * r * (angle - np.sin(angle))
    assert area(pattern.panel("FRONT")) == pytest.approx(2 * (40 + bulge) * inch**2, rel=1e-4)
    assert pattern.panel("FRONT").grain == pytest.approx([0, 1]) and len(pattern.panel("FRONT").edges) == 6
    sleeves = [pattern.panel(n) for n in ("sleeve", "sleeve_mirrored")]
    assert len(sleeves[0].edges) == 5 and area(sleeves[0]) == pytest.approx(area(sleeves[1]))
    assert pattern.extra["notches"][0][0] == "sleeve" and list(pattern.extra["layers"]["FRONT"]) == ["8"]


def test_units_are_not_guessed(tmp_path):
    document = ezdxf.new("R12")
    document.blocks.new("A").add_polyline2d([(0, 0), (9, 0), (9, 9)], close=True, dxfattribs={"layer": "1"})
    path = tmp_path / "x.dxf"
    document.saveas(path)
    with pytest.raises(FileError, match="UNITS: METRIC or UNITS: ENGLISH, found no such text; say unit="):
        vt.load(path)
    assert area(vt.load(path, unit="cm").panels[0]) == pytest.approx(0.00405)
    with pytest.raises(VitruvianError, match="expected one of mm, cm, m, in"):
        vt.load(path, unit="ell")
    with pytest.raises(FileError, match="is the unit right"):
        document.blocks.get("A").add_point((1e9, 0), dxfattribs={"layer": "4"})
        document.saveas(path)
        vt.load(path, unit="m")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("POLYLINE", "SOLID", "expected blocks with a closed line"),
        ("METRIC", "CUBITS", "found 'CUBITS'"),
        ("SECTION", "NOTION", "expected"),
        ("\n100\n", "\nwide\n", "expected"),
    ],
)
def test_what_is_no_pattern(old, new, message, tmp_path):
    sys.path.insert(0, str(ROOT / "tools"))
    try:
        from fuzz_scenes import dxf_piece
    finally:
        sys.path.remove(str(ROOT / "tools"))
    path = tmp_path / "x.dxf"
    path.write_bytes(dxf_piece())
    assert [p.name for p in vt.load(path).panels] == ["A", "A_mirrored"]
    path.write_text(dxf_piece().decode().replace(old, new))
    with pytest.raises(FileError, match=message) as said:
        vt.load(path)
    assert "\n" not in str(said.value)


def test_without_ezdxf_it_is_said_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    path = tmp_path / "x.dxf"
    path.write_text("0\nEOF\n")
    for act in (lambda: vt.load(path), lambda: vt.save(Pattern("p", (rectangle("a", 1, 1),)), path)):
        with pytest.raises(MissingExtra, match=r"DXF needs an extra: pip install 'vitruvian\[patterns\]'"):
            act()


def test_a_circle_has_two_edges(tmp_path):
    document = ezdxf.new("R2010")
    document.header["$INSUNITS"] = 5
    document.modelspace().add_circle((0, 0), 20)
    document.saveas(tmp_path / "x.dxf")
    (disc,) = vt.load(tmp_path / "x.dxf").panels
    assert isinstance(disc, Panel) and len(disc.edges) == 2 and abs(area(disc)) == pytest.approx(np.pi * 0.04, rel=1e-3)
