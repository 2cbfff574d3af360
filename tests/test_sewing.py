"""From a drawing to a garment: sidecars, places for panels that have none, proposed seams, PDF, conversions."""

from __future__ import annotations

import json
import re
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import vitruvian as vt
from conftest import SHARED
from test_patterns import FILES, files, rectangle, tube
from vitruvian.cli import app
from vitruvian.cloth.drafting import drafted
from vitruvian.cloth.drafting.figure import figure
from vitruvian.cloth.pattern import Edge, Panel, Pattern, Seam, Span, area, length, placed
from vitruvian.cloth.placing import dummy
from vitruvian.cloth.proposals import proposals
from vitruvian.cloth.wrapping import BACK, FRONT, LEFT, RIGHT, WAIST, Stand, Worn, stand, wearing, wrapped
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.pattern_pdf import write_pdf

runner = CliRunner()
FOLDER = SHARED / "data/patterns"
real = pytest.mark.skipif(not FOLDER.is_dir(), reason="needs ../shared/data/patterns")
MEASURES = {"height": 1.665, "chest": 0.874, "waist": 0.702, "hips": 0.919, "inseam": 0.784, "arm_length": 0.551,
            "shoulder_width": 0.371, "back_length": 0.383, "neck": 0.333, "upper_arm": 0.275}  # fmt: skip
DRAWING = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="300mm" height="300mm" viewBox="0 0 300 300">'
    '<path id="front" d="M0 0h100v80h-100z"/><path id="sleeve" d="M150 0h50v60h-50z"/></svg>'
)


@pytest.fixture(scope="module")
def at() -> Stand:
    from vitruvian.modeling.person import person

    return stand(figure(MEASURES), dummy(vt.pack(person(outfit=None))))


def drawn(tmp_path: Path, **said: object) -> Pattern:
    """The drawing above with a sidecar."""
    (tmp_path / "x.svg").write_text(DRAWING)
    (tmp_path / "x.sewing.json").write_text(json.dumps({"vitruvian_sewing": 1, **said}))
    return vt.load(tmp_path / "x.svg")


def test_a_sidecar_says_how_a_drawing_is_cut_sewn_and_worn(tmp_path):
    seams = [{"a": [["front", 0], ["front", 1]], "b": [["sleeve", 1, 0.2, 0.9]], "reversed": False, "kind": "gather"}]
    pattern = drawn(
        tmp_path,
        pieces={"sleeve": {"copies": 3, "mirror": True, "label": "arm", "fabric": "denim", "order": 2}},
        split=[["front", 1, 0.25]],
        seams=seams,
        anchors=[["front", 2, "lower_interface"]],
        places={
            "front": {"rotation": np.eye(3).tolist(), "translation": [0, 1, 0.2]},
            "sleeve": {"wrap": "left sleeve"},
        },
        buttons=[{"a": ["front", [0.01, 0.02]], "b": ["sleeve", [0.01, 0.02]]}],
    )
    assert [p.name for p in pattern.panels] == ["front", "sleeve", "sleeve_mirrored", "sleeve_2"]
    front, sleeve = pattern.panel("front"), pattern.panel("sleeve")
    assert [1000 * length(front, i) for i in range(5)] == pytest.approx([80, 25, 75, 80, 100])
    assert front.edges[2].label == "lower_interface" and front.translation.tolist() == [0, 1, 0.2]
    assert {(p.label, p.fabric, p.order) for p in pattern.panels[1:]} == {("arm", "denim", 2)}
    assert pattern.seams[0].kind == "gather" and pattern.seams[0].b == (Span("sleeve", 1, 0.2, 0.9),)
    assert pattern.extra["wrap"] == {"sleeve": "left sleeve"} and len(pattern.buttons) == 1 and sleeve.rotation is None
    assert vt.load(tmp_path / "x.svg", sidecar=tmp_path / "x.sewing.json").extra == pattern.extra
    (tmp_path / "x.sewing.json").unlink()
    assert [p.name for p in vt.load(tmp_path / "x.svg").panels] == ["front", "sleeve"]
    with pytest.raises(FileError, match="no such file"):
        vt.load(tmp_path / "x.svg", sidecar=tmp_path / "nobody.json")


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"vitruvian_sewing": 3}, "vitruvian_sewing: expected version 1, found 3"),
        ({"stitches": []}, "sidecar: expected one of pieces, split"),
        ({"pieces": {"cuff": {}}}, "pieces: expected one of front, sleeve, found 'cuff'"),
        ({"pieces": {"front": {"color": 1}}}, "piece front: expected one of unfold"),
        ({"pieces": {"front": {"unfold": True}}}, "expected a fold to unfold it about, found none"),
        ({"pieces": {"front": {"copies": 0}, "sleeve": {"copies": 0}}}, "at least one copy"),
        ({"split": [["front", 9, 0.5]]}, "split 0 edge: expected an index of 0 to 3, found 9"),
        ({"split": [["front", 1, 1]]}, "split 0 share: expected 0.001 to 0.999"),
        ({"seams": [{"a": [["cuff", 0]], "b": [["front", 0]]}]}, "seam 0 side a: expected the name of a panel"),
        ({"anchors": [["cuff", 0, "x"]]}, "anchor 0: expected one of the panels front, sleeve"),
        ({"places": {"front": {"translation": [0, 1, 0]}}}, "place of front: expected wrap, or rotation and translation"),
        ({"buttons": [{"a": ["front", [0, 0]]}]}, "button 0 side b"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_a_sidecar_is_said(said, message, tmp_path):
    with pytest.raises(FileError, match=message) as error:
        drawn(tmp_path, **said)
    assert error.value.path.endswith("x.sewing.json") and "\n" not in str(error.value)


def test_a_panel_is_rolled_without_stretching_it():
    panel = rectangle("p", 0.5, 0.2, rotation=np.eye(3), translation=np.array([0, 1.0, 0.3]))
    rolled = replace(panel, bend=np.array([2 * np.pi / 0.5, 0.0]))
    grid = np.stack(np.meshgrid(np.linspace(0, 0.5, 201), [0.0, 0.2]), axis=-1)
    points = placed(rolled, grid.reshape(-1, 2)).reshape(2, 201, 3)
    steps = np.linalg.norm(np.diff(points, axis=1), axis=-1)
    assert steps == pytest.approx(0.0025, rel=1e-3) and points[:, 0] == pytest.approx(points[:, -1], abs=1e-12)
    assert points[0, 100] == pytest.approx([0.25, 1, 0.3])  # the middle stays
    assert np.hypot(points[..., 0] - 0.25, points[..., 2] - 0.3 + 0.25 / np.pi) == pytest.approx(0.25 / np.pi)
    assert placed(replace(panel, bend=np.zeros(2)), grid.reshape(-1, 2))[:, 2] == pytest.approx(0.3)


def shapes() -> Pattern:
    """Panels that say by words where they are worn."""
    names = ("front", "backLeft", "back right", "SLEEVE_L", "r-cuff", "waistband", "hood", "collar", "breast pocket")
    return Pattern("coat", tuple(rectangle(n, 0.3 if "band" not in n else 0.8, 0.2) for n in names))


def test_words_say_where_panels_are_worn():
    assert wearing(shapes()) == {
        "front": Worn("torso", FRONT, 0),
        "backLeft": Worn("torso", BACK, LEFT),
        "back right": Worn("torso", BACK, RIGHT),
        "SLEEVE_L": Worn("sleeve", 0, LEFT),
        "r-cuff": Worn("cuff", 0, RIGHT),
        "waistband": Worn("band", 0, 0),
        "hood": Worn("hood", 0, RIGHT),
        "collar": Worn("collar", 0, 0),
        "breast pocket": Worn("pocket", 0, 0),
    }
    strange = Pattern("x", (rectangle("flap", 0.1, 0.1), rectangle("sleeve", 0.1, 0.1)))
    with pytest.raises(VitruvianError, match="panel flap: expected front or back in its name"):
        wearing(strange)
    told = replace(strange, extra={"wrap": {"flap": "left back torso"}})
    assert wearing(told)["flap"] == Worn("torso", BACK, LEFT)


def test_panels_stand_outside_the_body_and_face_away_from_it(at):
    pattern = wrapped(shapes(), at)
    for p in pattern.panels:
        assert np.linalg.det(p.rotation) == pytest.approx(1) and p.rotation @ p.rotation.T == pytest.approx(np.eye(3))
        out = p.rotation[:, 2] * np.sign(area(p))
        middle = placed(p, p.vertices.mean(axis=0)[None])[0]
        if p.name != "hood":
            assert out @ (middle - [0, middle[1], 0]) > 0 or "SLEEVE" in p.name or "cuff" in p.name
    band = placed(pattern.panel("waistband"), pattern.panel("waistband").vertices)
    assert np.abs(band[:, 0]).max() < 0.1 and band[:, 1].max() > at.figure.waist > band[:, 1].min() - 1e-6
    again = wrapped(pattern, at)
    assert again is pattern  # what has a place keeps it
    turned = replace(shapes().panels[0], vertices=shapes().panels[0].vertices * [-1, 1])  # drawn from inside
    front = wrapped(Pattern("coat", (turned, *shapes().panels[1:])), at).panel("front")
    assert front.rotation[:, 2] * np.sign(area(front)) == pytest.approx([0, 0, 1]) and front.translation[2] > 0


@real
def test_shapes_say_it_where_words_do_not(at):
    worn = {}
    for name in ("teagan", "penelope", "titan"):
        pattern = vt.load(FOLDER / f"freesewing/freesewing_{name}_w38.json")
        worn[name] = wearing(pattern)
        stood = wrapped(pattern, at)
        labels = {e.label for p in stood.panels for e in p.edges}
        assert (WAIST in labels) == (name != "teagan")
    assert {w.region for w in worn["titan"].values()} == {"leg"}
    assert {w.region for w in worn["teagan"].values()} == {"torso", "sleeve"}
    assert {w.region for w in worn["penelope"].values()} == {"skirt", "band"}
    assert worn["titan"]["front"] == Worn("leg", FRONT, RIGHT) and worn["titan"]["back_mirrored"] == Worn(
        "leg", BACK, LEFT
    )
    assert worn["penelope"]["back"] == Worn("skirt", BACK, RIGHT) and worn["penelope"]["front"].side == 0
    assert worn["teagan"]["sleeve"].side == RIGHT and worn["teagan"]["sleeve_mirrored"].side == LEFT


@pytest.mark.parametrize("turn", [0, 90, 200])
def test_a_sleeve_is_known_by_its_hem_and_cap_however_it_is_drawn(turn, at):
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    spin = np.array([[c, s], [-s, c]])
    corners = np.array([[-0.18, 0], [0.18, 0], [0.17, 0.06], [-0.17, 0.06]])
    cap = np.array([[0.1, 0.25], [-0.1, 0.25]])
    edges = (Edge(0, 1), Edge(1, 2), Edge(2, 3, "cubic", cap @ spin), Edge(3, 0))
    names = ("left sleeve", "front", "back")
    sleeve = Panel(names[0], corners @ spin, edges)
    pattern = wrapped(Pattern("p", (sleeve, rectangle("front", 0.5, 0.6), rectangle("back", 0.5, 0.6))), at)
    tube = pattern.panel("left sleeve")
    shoulder, elbow = at.arms[LEFT]
    ends = [placed(tube, tube.vertices[i]).mean(axis=0) for i in ([0, 1], [2, 3])]
    axis = (elbow - shoulder) / np.linalg.norm(elbow - shoulder)
    assert (ends[0] - ends[1]) @ axis == pytest.approx(0.06, abs=0.003)  # the hem is farther out
    assert np.abs(placed(tube, tube.vertices)[:, 2]).max() < 0.1 and 1 / np.hypot(*tube.bend) > 0.055
    assert tube.rotation[:, 2] @ [0, 1, 0] > 0.9


def joined(seam: Seam) -> frozenset[tuple[str, int]]:
    return frozenset((s.panel, s.edge) for s in (*seam.a, *seam.b))


@real
@pytest.mark.parametrize(("name", "count"), [("teagan", 12), ("penelope", 18), ("titan", 6)])
def test_all_seams_of_freesewing_drafts_are_proposed(name, count, at):
    found = proposals(wrapped(vt.load(FOLDER / f"freesewing/freesewing_{name}_w38.json"), at))
    said = {joined(p.seam) for p in found}
    sides = sum(p.seam.kind != "dart" for p in found)
    if name == "penelope":  # eight darts, both sides of three edges, the middle of the back, the waistband and its ends
        assert len(found) == count and sides == 3 + 3 + 1 + 2 + 1
        assert sorted(len(p.seam.b) for p in found)[-2:] == [6, 6]
        return
    pattern = vt.load(FOLDER / f"freesewing/freesewing_{name}_w38.json")
    wanted = {
        "teagan": [
            ("sleeve", (1,), "sleeve", (9,)), ("front", (1,), "back", (12,)), ("front", (5,), "back", (8,)),
            ("sleeve", (2, 3), "front", (10, 11)), ("sleeve", (7, 8), "back", (2, 3)),
            ("sleeve_mirrored", (6, 7), "front", (2, 3)), ("sleeve_mirrored", (1, 2), "back", (10, 11)),
        ],
        "titan": [
            ("front", (3,), "back", (0,)), ("front", (0, 1), "back", (2, 3)),
            ("front", (4, 5), "front_mirrored", (1, 2)), ("back", (5, 6), "back_mirrored", (0, 1)),
        ],
    }[name]  # fmt: skip
    for a, i, b, j in wanted:
        assert frozenset([*((a, k) for k in i), *((b, k) for k in j)]) in said
    if name == "teagan":
        assert frozenset([*(("sleeve", k) for k in (4, 5, 6)), ("back", 4), ("front", 9)]) in said
    assert len(found) == count and len(pattern.panels) == 4


@real
@pytest.mark.slow
def test_a_draft_becomes_a_shirt(tmp_path):
    """The command line's way: refused without seams, sewn, dressed."""
    source = FOLDER / "freesewing/freesewing_teagan_w38.json"
    out = tmp_path / "x.glb"
    refused = runner.invoke(app, ["dress", "person", str(source), "-o", str(out)])
    assert refused.exit_code != 0 and "pattern sew" in str(refused.exception) + refused.output
    sewn = tmp_path / "t.pattern.json"
    result = runner.invoke(app, ["pattern", "sew", str(source), "-o", str(sewn), "--json"])
    assert len(json.loads(result.stdout)["seams"]) == 12 and json.loads(result.stdout)["alone"] == []
    result = runner.invoke(app, ["dress", "person", str(sewn), "--size", "25", "-o", str(out), "--json"])
    report = json.loads(result.stdout)
    assert not report["open_seams"] and not report["self_intersections"] and not report["penetrating_vertices"], report
    assert report["strain_p99"] < 0.05 and report["boundary_loops"] == 4 and report["speed"] < 0.03


def test_seams_alone_go_into_a_sidecar(tmp_path):
    from vitruvian.formats.sewing import write_sidecar

    (tmp_path / "x.svg").write_text(DRAWING)
    one = drawn(
        tmp_path, seams=[{"a": [["front", 0]], "b": [["sleeve", 2]], "kind": "ease"}], anchors=[["front", 2, "x"]]
    )
    write_sidecar(one, tmp_path / "x.sewing.json")
    two = vt.load(tmp_path / "x.svg")
    assert two.seams == one.seams and two.panel("front").edges[2].label == "x"


def objects(data: bytes) -> dict[int, bytes]:
    """The objects of a PDF by its table, streams unpacked."""
    start = int(re.search(rb"startxref\n(\d+)\n%%EOF\n\Z", data)[1])
    count = int(re.match(rb"xref\n0 (\d+)\n", data[start:])[1])
    rows = re.findall(rb"(\d{10}) 00000 n \n", data[start:])
    assert len(rows) == count - 1
    out = {}
    for k, row in enumerate(rows, 1):
        found = re.match(rb"(\d+) 0 obj\n(.*?)\nendobj\n", data[int(row) :], re.DOTALL)
        assert int(found[1]) == k
        head, _, rest = found[2].partition(b"stream\n")
        size = re.search(rb"/Length (\d+)", head)
        out[k] = head + zlib.decompress(rest[: int(size[1])]) if size else head
    return out


def test_drawings_as_pdf(tmp_path):
    pattern = drafted("tshirt", MEASURES)
    pattern = replace(pattern, panels=(replace(pattern.panels[0], name="Größe (38)\\ж"), *pattern.panels[1:]), seams=())
    assert write_pdf(pattern, tmp_path / "x.pdf") == 1
    whole = objects((tmp_path / "x.pdf").read_bytes())
    box = [float(v) for v in re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", whole[5]).groups()]
    drawn = [float(v) for v in re.search(rb"/BBox \[0 0 ([\d.]+) ([\d.]+)\]", whole[4]).groups()]
    assert box == pytest.approx([v * 72 / 25.4 for v in drawn], abs=0.02)
    assert rb"Gr\366\337e \05038\051\134?" in whole[4]
    # the outline at scale 1:1: its points are those of the panel, millimetres
    numbers = np.array(re.findall(rb"(-?[\d.]+) (-?[\d.]+) [ml]", whole[4].split(b" f*")[0]), float)
    assert np.ptp(numbers, axis=0) == pytest.approx(1000 * np.ptp(pattern.panels[0].vertices, axis=0), abs=0.5)
    pages = write_pdf(pattern, tmp_path / "y.pdf", paper="a4")
    found = objects((tmp_path / "y.pdf").read_bytes())
    wide, high = (int(np.ceil(v / w)) for v, w in zip(drawn, (190, 277)))
    assert pages == wide * high == sum(b"/Type /Page " in o for o in found.values())
    assert sum(b"100 mm" in o for o in found.values()) == 1
    with pytest.raises(VitruvianError, match="paper: expected one of a4, a3, letter"):
        write_pdf(pattern, tmp_path / "z.pdf", paper="a0")
    huge = Pattern("p", (rectangle("a", 9, 9),))
    with pytest.raises(VitruvianError, match="too large for one page; give a paper"):
        write_pdf(huge, tmp_path / "z.pdf")
    with pytest.raises(VitruvianError, match="more than 500"):
        write_pdf(huge, tmp_path / "z.pdf", paper="a4")
    assert not (tmp_path / "z.pdf").exists()


@files
@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_garmentcode_is_written(path, tmp_path):
    pattern = vt.load(path)
    assert vt.save(pattern, tmp_path / "x.garmentcode.json")["lost"] == []
    back = vt.load(tmp_path / "x.garmentcode.json")
    assert back.seams == pattern.seams
    for p, q in zip(pattern.panels, back.panels):
        assert q.vertices == pytest.approx(p.vertices, abs=1e-12) and q.rotation == pytest.approx(p.rotation, abs=1e-9)
        assert [(e.kind, e.label) for e in p.edges] == [(e.kind, e.label) for e in q.edges]
        for e, g in zip(p.edges, q.edges):
            assert g.points == pytest.approx(e.points, abs=1e-7)


def test_what_garmentcode_cannot_hold(tmp_path):
    pattern = drafted("trousers", MEASURES)
    lost = vt.save(pattern, tmp_path / "x.garmentcode.json")["lost"]
    assert any("of several" in line for line in lost) and "kinds of seams" in lost
    corners = np.array([[0, 0], [1, 0], [0, 1.0]])
    panel = Panel("p", corners, (Edge(0, 1, "polyline", [[0.5, 0.1]]), Edge(1, 2), Edge(2, 0)))
    with pytest.raises(VitruvianError, match="panel p edge 0: GarmentCode knows no polylines"):
        vt.save(Pattern("x", (panel,)), tmp_path / "y.garmentcode.json")
    assert not (tmp_path / "y.garmentcode.json").exists()


def test_patterns_are_converted(tmp_path):
    vt.save(tube(), tmp_path / "a.pattern.json")
    for name in ("b.svg", "c.garmentcode.json", "d.pdf", "e.pattern.json"):
        result = runner.invoke(
            app, ["pattern", "convert", str(tmp_path / "a.pattern.json"), str(tmp_path / name), "--json"]
        )
        assert result.exit_code == 0 and json.loads(result.stdout)["panels"] == 2
        assert (tmp_path / name).stat().st_size > 300
    assert (tmp_path / "e.pattern.json").read_text() == (tmp_path / "a.pattern.json").read_text()
    result = runner.invoke(
        app, ["pattern", "draw", str(tmp_path / "a.pattern.json"), "-o", str(tmp_path / "x.pdf"), "--paper", "a3"]
    )
    assert result.exit_code == 0 and "pages" in result.stdout
    result = runner.invoke(app, ["pattern", "check", str(tmp_path / "a.pattern.json"), "--unit", "mm"])
    assert "--unit says nothing about such a file" in str(result.exception) + result.output
