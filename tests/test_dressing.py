"""From a pattern to a garment that is worn: the tailor, `dress`, `pattern check`, `pattern draw`."""

from __future__ import annotations

import json
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from typer.testing import CliRunner

import vitruvian as vt
from conftest import SHARED
from test_patterns import SQUARE, rectangle
from vitruvian.cli import app
from vitruvian.cli.dressing import faults
from vitruvian.cloth.drafting import drafted
from vitruvian.cloth.fabric import fabric
from vitruvian.cloth.garment import buttoned, charted, sewn
from vitruvian.cloth.intersections import intersections
from vitruvian.cloth.obstacle import still
from vitruvian.cloth.pattern import Edge, Panel, Pattern, Seam, Span
from vitruvian.cloth.placing import dummy, hung
from vitruvian.cloth.tailor import tailor
from vitruvian.cloth.tessellate import tessellate, welded
from vitruvian.errors import VitruvianError
from vitruvian.formats.pattern_svg import drawing
from vitruvian.modeling.measures import measures
from vitruvian.modeling.wearing import worn

FOLDER = SHARED / "data/patterns/garmentcode"
runner = CliRunner()


@pytest.fixture(scope="module")
def person():
    return vt.person(outfit=None, hair="none")


@pytest.fixture(scope="module")
def body(person):
    return vt.pack(person)


def skirt(waist: float = 0.86, hem: float = 1.3, top: float = 1.02, long: float = 0.45) -> Pattern:
    """A front and a back that widen downwards, hung before and behind the hips."""
    panels = []
    for name, sign, depth in (("front", 1.0, 0.3), ("back", -1.0, -0.3)):
        corners = np.array([[-hem / 4, 0], [hem / 4, 0], [waist / 4, long], [-waist / 4, long]]) * [sign, 1]
        edges = tuple(Edge(i, (i + 1) % 4, label="lower_interface" if i == 2 else "") for i in range(4))
        panels.append(Panel(name, corners, edges, "leg", np.eye(3), [0, top - long, depth]))
    seams = (Seam((Span("front", 1),), (Span("back", 3),)), Seam((Span("front", 3),), (Span("back", 1),)))
    return Pattern("skirt", tuple(panels), seams)


@pytest.fixture(scope="module")
def made(body):
    return tailor(skirt(), body, size=0.025)


def test_buttons_are_closed(person, body):
    """A shirt whose fronts overlap, not sewn: what is buttoned lies one over the other, and nothing goes through it."""
    pattern = drafted("shirt", measures(person).values, closed="buttons")
    made = tailor(pattern, body, size=0.02)
    pairs = made.weld[buttoned(pattern, made.mesh)]
    apart = 1000 * np.linalg.norm(made.vertices[pairs[:, 0]] - made.vertices[pairs[:, 1]], axis=1)
    assert len(pairs) == 6 and made.report["button_gap_max_mm"] == pytest.approx(apart.max()) and apart.max() < 10
    assert made.report["self_intersections"] == 0 and made.report["strain_p99"] < 0.05
    middle = made.mesh.panel == [p.name for p in pattern.panels].index("left_front")
    assert np.ptp(made.vertices[made.weld[middle], 0]) > 0.1  # it is not drawn together to a string
    open_ = tailor(replace(pattern, buttons=()), body, size=0.02)
    far = np.linalg.norm(open_.vertices[pairs[:, 0]] - open_.vertices[pairs[:, 1]], axis=1)
    assert 1000 * far.max() > 3 * apart.max()
    assert "buttons" in faults({**made.report, "button_gap_max_mm": 50.0})[0]


def test_the_dummy_lifts_its_arms(body):
    d = dummy(body, arms=np.radians(30))
    index, centers = body.skeleton.index, body.skeleton.centers
    for side, sign in (("l", 1), ("r", -1)):
        a, b = (d.matrices[index[f"{side}_{n}"]] @ [*centers[index[f"{side}_{n}"]], 1] for n in ("shoulder", "elbow"))
        way = (b - a)[:3]
        assert np.degrees(np.arctan2(-way[1], sign * way[0])) == pytest.approx(30, abs=0.5)
    assert len(d.triangles) < len(body.skin.triangles)  # without eyes and brows
    with pytest.raises(VitruvianError, match="clothes need a body with"):
        bare = vt.pack(vt.person(outfit=None, hair="none", loa=0))
        dummy(bare)


def test_a_dressed_body_is_not_dressed_over():
    with pytest.raises(VitruvianError, match="clothes need a bare body in one piece: the largest piece"):
        dummy(vt.pack(vt.person()))


def test_panels_are_moved_until_they_are_clear(body):
    place = lambda *at: Pattern("p", (Panel("front", SQUARE.vertices, SQUARE.edges, "", np.eye(3), at),))  # noqa: E731
    inside, mannequin = place(-0.15, 0.9, 0.0), dummy(body)
    distance = lambda p: p[:, 2] - 0.12  # noqa: E731  (a wall)
    points = hung(inside, tessellate(inside, 0.03), mannequin, distance)
    assert points[:, 2].min() == pytest.approx(0.13) and points[:, 0].min() == pytest.approx(-0.15)
    with pytest.raises(VitruvianError, match="panel front: it is still inside the body"):
        hung(inside, tessellate(inside, 0.03), mannequin, lambda p: p[:, 2] - 9)
    bare = Pattern("p", (SQUARE,))
    with pytest.raises(VitruvianError, match="panel a: expected a place around the body"):
        hung(bare, tessellate(bare, 0.03), mannequin, distance)


def test_sleeves_are_brought_to_the_arm(body):
    measures = {"height": 1.72, "chest": 0.96, "waist": 0.82, "hips": 1.0}
    pattern, mannequin = drafted("tshirt", measures), dummy(body)
    mesh = tessellate(pattern, 0.03)
    lowered = tuple(_turned(p, np.radians(25)) if p.label == "arm" else p for p in pattern.panels)
    distance = still(mannequin.vertices, mannequin.triangles).distances
    one, two = (hung(replace(pattern, panels=ps), mesh, mannequin, distance) for ps in (pattern.panels, lowered))
    arm = np.isin(mesh.panel, [k for k, p in enumerate(pattern.panels) if p.label == "arm"])
    assert np.abs(two - one)[arm].max() < 0.04 and np.abs(two - one)[~arm].max() < 1e-9


def _turned(panel: Panel, angle: float) -> Panel:
    """A sleeve that hangs lower by so much, turned about a point beside its shoulder."""
    sign = np.sign(panel.translation[0])
    c, s = np.cos(-sign * angle), np.sin(-sign * angle)
    turn, pivot = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([sign * 0.18, 1.38, 0])
    return replace(panel, rotation=turn @ panel.rotation, translation=turn @ (panel.translation - pivot) + pivot)


def test_a_skirt_is_sewn_and_rests_on_the_hips(made):
    r = made.report
    assert r["settled"] and r["seam_gap_max_mm"] < 1 and not r["open_seams"]
    assert r["penetrating_vertices"] == 0 and r["self_intersections"] == 0 and r["boundary_loops"] == 2
    assert r["strain_p99"] < 0.05 and sum(r["layers"].values()) == len(made.vertices)
    assert 0.8 < made.vertices[:, 1].max() < 1.1 and made.vertices[:, 1].min() > 0.3
    assert len(intersections(made.vertices, made.triangles)) == 0


def test_it_is_the_same_a_second_time(body, made):
    assert np.array_equal(tailor(skirt(), body, size=0.025).vertices, made.vertices)


def test_a_garment_over_another_does_not_cut_it(body, made):
    over = tailor(skirt(waist=0.88, hem=1.5, long=0.5), body, size=0.025, over=(made,))
    r = over.report
    assert r["self_intersections"] == 0 and r["penetrating_vertices"] == 0 and r["boundary_loops"] == 2
    (inner,) = over.below
    both = np.concatenate([inner.vertices, over.vertices])
    faces = np.concatenate([inner.triangles, over.triangles + len(inner.vertices)])
    assert inner.report["self_intersections"] == inner.report["penetrating_vertices"] == 0
    assert len(intersections(both, faces)) == 0
    assert r["settled"] and 0.8 < over.vertices[:, 1].max() < 1.1  # it has not slid down
    with pytest.raises(VitruvianError, match="worn in another pose"):
        tailor(skirt(), body, size=0.025, arms=0.5, over=(made,))


def test_fine_cloth_lies_as_coarse_cloth_does(body):
    coarse, fine = (tailor(skirt(), body, size=s) for s in (0.024, 0.012))
    assert len(fine.triangles) > 3 * len(coarse.triangles) and fine.report["settled"]
    assert fine.report["self_intersections"] == fine.report["penetrating_vertices"] == 0
    assert fine.report["strain_p99"] < 0.05
    assert np.abs(fine.vertices.mean(axis=0) - coarse.vertices.mean(axis=0)).max() < 0.02


def test_a_gathered_side_is_as_long_as_the_other_along_the_seam():
    long, short = rectangle("long", 0.3, 0.2), rectangle("short", 0.2, 0.2)
    pattern = Pattern("p", (long, short), (Seam((Span("long", 0),), (Span("short", 2),)),))
    mesh = tessellate(pattern, 0.02)
    weld = welded(mesh)
    cotton = fabric("cotton")
    flat, gathered = (sewn(mesh, w, (cotton, cotton)) for w in (None, weld))
    lengths = np.linalg.norm(np.roll(gathered.material, -1, axis=1) - gathered.material, axis=2)
    count = np.bincount(gathered.sides.ravel())
    seam = np.isin(gathered.edges, weld[mesh.pairs]).all(axis=1) & (count == 2)
    for edge in np.flatnonzero(seam):
        both = lengths[gathered.sides == edge]
        assert both.max() == pytest.approx(both.min(), rel=1e-9)
    assert seam.sum() == len(mesh.pairs) - 1
    changed = np.abs(gathered.material - flat.material).max(axis=(1, 2)) > 1e-12
    assert 0 < changed.sum() <= 2 * seam.sum()


def test_a_skirt_that_is_too_small_says_so(body):
    r = tailor(skirt(waist=0.4, hem=0.5), body, size=0.03).report
    assert r["strain_p99"] > 0.2 or r["open_seams"]
    assert np.isfinite(r["strain_max"])


def test_worn_it_hangs_in_the_pose_as_draped(person, made, tmp_path):
    uv, corners = charted(made)
    assert uv.min() >= 0 and uv.max() <= 1 and len(corners) == len(made.triangles)
    dressed = worn(person, made.vertices, made.triangles, made.matrices, uv=uv, uv_triangles=corners)
    body = vt.pack(dressed)
    moved = vt.deformer("log", body)(vt.joint_matrices(body.skeleton))[0]
    assert np.abs(moved[-len(made.vertices) :] - made.vertices).max() < 1e-4
    vt.save(dressed, tmp_path / "dressed.x3d")
    findings = vt.check(tmp_path / "dressed.x3d")
    assert dressed.skin[-1].name == "garment" and not [f for f in findings if f.severity == "error"]


def test_dress_writes_what_it_says(tmp_path):
    path = FOLDER / "gc_skirt2_mean_male.json"
    if not path.exists():
        pytest.skip("needs ../shared/data/patterns")
    out = tmp_path / "dressed.glb"
    result = runner.invoke(app, ["dress", "person", str(path), "--size", "25", "-o", str(out), "--json"])
    document = json.loads(result.stdout)
    assert result.exit_code in (0, 1) and out.exists()
    keys = {"faces", "seam_gap_max_mm", "penetrating_vertices", "self_intersections", "strain_p99", "boundary_loops"}
    assert keys | {"layers", "seconds", "settled"} <= set(document) and document["boundary_loops"] == 2
    assert (result.exit_code == 1) == bool(document["reasons"])


def test_pattern_check_and_draw(tmp_path):
    path = FOLDER / "gc_dress_mean_all.json"
    if not path.exists():
        pytest.skip("needs ../shared/data/patterns")
    document = json.loads(runner.invoke(app, ["pattern", "check", str(path), "--json"]).stdout)
    assert document["ok"] and len(document["panels"]) == 8 and len(document["seams"]) == 32
    assert sum(map(len, document["edge_lengths_cm"].values())) == 74
    assert sum(document["areas_cm2"].values()) == pytest.approx(10706.46, rel=1e-3)
    out = tmp_path / "dress.svg"
    assert runner.invoke(app, ["pattern", "draw", str(path), "-o", str(out)]).exit_code == 0
    root = ElementTree.fromstring(out.read_text())
    assert root.get("width").endswith("mm") and len(root.findall("{*}g")) == 8
    assert runner.invoke(app, ["pattern", "draw", str(path), "-o", "x.png"]).exit_code != 0


def test_a_drawing_is_one_to_one_and_escapes_names():
    text = drawing(Pattern("<p>", (rectangle("a & b", 0.3, 0.2),)))
    root = ElementTree.fromstring(text)
    width, height = (float(root.get(k)[:-2]) for k in ("width", "height"))
    assert (width, height) == pytest.approx((324, 224)) and "a &amp; b" in text and "30.0 cm" in text
