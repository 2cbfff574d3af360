"""Measures: known solids, independent sections, all kinds of bodies, the commands; people made to measure."""

from __future__ import annotations

import json
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from typer.testing import CliRunner

import vitruvian as vt
from scan_maker import case
from vitruvian.cli import app
from vitruvian.errors import VitruvianError, VitruvianWarning
from vitruvian.modeling import letting, source
from vitruvian.modeling.figures import humanoid_figure
from vitruvian.modeling.measures import GIRTHS, NAMES, TABLE, Figure, measures, taken, tape
from vitruvian.modeling.person import person
from vitruvian.modeling.shape import Shape, shaped
from vitruvian.modeling.sizing import SLIDERS

UP = np.array([0.0, 1.0, 0.0])


def tube(radius: np.ndarray, heights: np.ndarray, sides: int = 256, squash: bool = False):
    """Points and triangles of a tube round Y; `squash` makes its sections hourglasses."""
    angle = np.arange(sides) * 2 * np.pi / sides
    wide = 1 - 0.85 * np.sin(angle) ** 2 if squash else np.ones(sides)
    ring = np.stack([np.cos(angle) * wide, np.zeros(sides), np.sin(angle) * wide], axis=1)
    points = np.concatenate([r * ring + [0, h, 0] for r, h in zip(radius, heights, strict=True)])
    i, k = np.meshgrid(np.arange(len(heights) - 1) * sides, np.arange(sides), indexing="ij")
    a, b = (i + k).ravel(), (i + (k + 1) % sides).ravel()
    faces = np.concatenate([np.stack([a, a + sides, b], 1), np.stack([b, a + sides, b + sides], 1)])
    return points, faces.astype(np.int32)


def test_a_cylinder_has_the_girth_of_its_polygon() -> None:
    points, faces = tube(np.full(3, 0.1), np.array([0.0, 0.5, 1.0]))
    length, line = tape(points, faces, np.array([0.02, 0.3, 0.01]), UP)
    assert length == pytest.approx(512 * 0.1 * np.sin(np.pi / 256), abs=1e-12) == pytest.approx(0.62830, abs=5e-6)
    assert np.linalg.norm(np.roll(line, -1, axis=0) - line, axis=1).sum() == pytest.approx(length, abs=1e-12)
    np.testing.assert_allclose(line[:, 1], 0.3, atol=1e-12)
    tilted, _ = tape(points, faces, np.array([0, 0.5, 0]), np.array([0.3, 1.0, 0]))
    assert tilted > length


def test_a_tape_spans_hollows() -> None:
    points, faces = tube(np.full(2, 0.1), np.array([0.0, 1.0]), squash=True)
    length, line = tape(points, faces, np.array([0, 0.5, 0]), UP)
    ring = points[:256, [0, 2]]
    assert length == pytest.approx(ConvexHull(ring).area, abs=1e-12)
    assert length < np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1).sum() - 0.01
    assert len(line) < 250


def test_of_two_legs_one_is_measured_and_nothing_is_nothing() -> None:
    points, faces = tube(np.full(2, 0.05), np.array([0.0, 1.0]))
    both = np.concatenate([points, points * [2, 1, 2] + [0.3, 0, 0]])
    two = np.concatenate([faces, faces + len(points)])
    one = tape(both, two, np.array([0, 0.5, 0]), UP)[0]
    other = tape(both, two, np.array([0.33, 0.5, 0]), UP)[0]
    assert other == pytest.approx(2 * one, abs=1e-12)
    assert tape(both, two, np.array([0, 2.0, 0]), UP)[0] == 0.0


@pytest.fixture(scope="module")
def woman():
    return person(gender=0.0, outfit=None, hair="none")


def test_girths_agree_with_an_independent_section(woman) -> None:
    """trimesh cuts, SciPy spans: every tape of the figure lies in such a section and is as long as its hull."""
    figure = humanoid_figure(woman)
    found = taken(figure)
    surface = trimesh.Trimesh(figure.points, figure.triangles, process=False)
    for name in ("waist", "l_thigh", "r_knee", "l_calf", "head"):
        line = found.contours[name]
        normal = np.linalg.svd(line - line.mean(axis=0))[2][2]
        middle = line.mean(axis=0)
        cut = trimesh.intersections.mesh_plane(surface, normal, middle).reshape(-1, 3)
        near = np.linalg.norm(cut - middle, axis=1) < np.linalg.norm(line - middle, axis=1).max() + 0.005
        if name[:2] in ("l_", "r_"):
            near &= cut[:, 0] * middle[0] > 0
        else:
            near &= np.abs(cut[:, 0]) < np.abs(line[:, 0]).max() + 1e-4  # arms are further out
        axes = np.linalg.svd(line - middle)[2][:2]
        length = np.linalg.norm(np.roll(line, -1, axis=0) - line, axis=1).sum()
        assert ConvexHull((cut[near] - middle) @ axes.T).area == pytest.approx(length, abs=2e-4), name


def test_a_skinned_body_and_its_bare_surface_measure_alike(woman) -> None:
    figure = humanoid_figure(woman)
    plain = taken(Figure(figure.points, figure.triangles, figure.places))
    whole = taken(figure)
    assert list(whole.values) == list(NAMES) == list(plain.values)
    for name, value in whole.values.items():
        assert plain.values[name] == pytest.approx(value, abs=1e-4), name
    assert len(whole.contours) == 6 + 2 * 7


def test_measures_are_plausible_and_scale() -> None:
    man = measures(person(gender=1.0)).values
    assert 0.9 < man["chest"] < 1.0 and 0.5 < man["head"] < 0.6 and 0.2 < man["foot_length"] < 0.3
    assert 0.4 * man["height"] < man["inseam"] < 0.5 * man["height"]
    s = case("man, A pose")
    mesh = SimpleNamespace(vertices=s.vertices * 1000, triangles=s.triangles)
    marks = {n: p * 1000 for n, p in s.truth.items()}
    posed = measures(mesh, marks).values
    assert measures(mesh, marks, unit="cm").values["waist"] == pytest.approx(10 * posed["waist"], rel=1e-9)
    for name in ("waist", "hips", "calf", "thigh", "neck", "upper_arm", "wrist", "height"):
        assert posed[name] == pytest.approx(man[name], rel=0.04), name


def test_clothes_do_not_count_on_the_built_in_person(tmp_path) -> None:
    dressed, bare = person(gender=0.0), person(gender=0.0, outfit=None, hair="none")
    vt.save(dressed, tmp_path / "dressed.x3d")
    here, there = measures(vt.load(tmp_path / "dressed.x3d")), measures(bare)
    for name in ("waist", "hips", "head", "calf"):
        assert here.values[name] == pytest.approx(there.values[name], abs=1e-3), name
    assert here.volume == pytest.approx(there.volume, rel=5e-3) and here.mass == pytest.approx(there.mass, rel=5e-3)


def test_masses_are_those_of_the_segments(woman) -> None:
    found = measures(woman)
    assert found.mass == pytest.approx(sum(s.mass for s in woman.segments()), rel=1e-9)
    assert found.volume * 1050 == pytest.approx(found.mass, rel=0.01)
    assert found.masses["l_thigh"] == woman.joint("l_hip").segments[0].mass


def test_missing_points_leave_measures_out(woman) -> None:
    figure = humanoid_figure(woman)
    fewer = {n: p for n, p in figure.places.items() if "epicondyle" not in n and n != "substernale"}
    found = taken(Figure(figure.points, figure.triangles, fewer))
    assert {"chest", "hips", "neck", "height"} <= set(found.values)
    assert not {"waist", "underbust", "thigh", "knee"} & set(found.values)
    h = woman.copied()
    for s in h.segments():
        s.sites.clear()
    with pytest.raises(VitruvianError, match="crotch|feature points"):
        measures(SimpleNamespace(vertices=figure.points, triangles=figure.triangles), {"navel": np.zeros(3)})


def run(*arguments: object):
    return CliRunner().invoke(app, [str(a) for a in arguments], catch_exceptions=True)


def test_the_command_measures_and_draws_tapes(tmp_path) -> None:
    body = tmp_path / "a.x3d"
    vt.save(person(gender=0.0, measures={"height": 1.7, "waist": 0.74}), body)
    answer = json.loads(run("measure", body, "--json", "--before", "person", "-o", tmp_path / "t.x3d").stdout)
    assert answer["measures"]["waist"] == pytest.approx(0.74, abs=2e-3) and set(answer["before"]["measures"]) == set(
        NAMES
    )
    assert answer["height_m"] == pytest.approx(1.7, abs=1e-3) and sum(answer["masses_kg"].values()) > 30
    text = run("measure", body, "--before", "person").stdout
    assert "change" in text and all(name in text for name in TABLE)
    assert not [f for f in vt.check(tmp_path / "t.x3d") if f.severity == "error"]
    assert "tape_l_thigh" in (tmp_path / "t.x3d").read_text()
    run("measure", body, "-o", tmp_path / "t.csv")
    rows = [r.split(",") for r in (tmp_path / "t.csv").read_text().splitlines()[1:]]
    line = np.array([r[1:] for r in rows if r[0] == "waist"], float)
    assert np.linalg.norm(np.roll(line, -1, axis=0) - line, axis=1).sum() == pytest.approx(0.74, abs=2e-3)
    assert isinstance(run("measure", body, "-o", tmp_path / "t.png").exception, VitruvianError)


def test_the_command_finds_landmarks(tmp_path, shared) -> None:
    scan, marks = shared / "data" / "scans" / "human_man.obj", tmp_path / "marks.json"
    answer = json.loads(run("landmarks", scan, "-o", marks, "--json").stdout)
    assert answer["kept"] >= 100 and 0 <= answer["points"]["navel"]["confidence"] <= 1
    found = json.loads(run("measure", scan, "--landmarks", marks, "--json").stdout)["measures"]
    assert found["height"] == pytest.approx(1.791, abs=2e-3) and 0.9 < found["chest"] < 1.15


@pytest.mark.parametrize(
    ("shape", "wishes"),
    [
        ({"gender": 1.0}, {"chest": 0.96, "waist": 0.80}),
        (
            {"gender": 0.0},
            {"height": 1.62, "chest": 1.06, "waist": 0.94, "hips": 1.12, "neck": 0.36, "inseam": 0.74, "arm_length": 0.53,
             "thigh": 0.64, "shoulder_width": 0.36},
        ),
        ({"gender": 1.0}, {"elbow": 0.30, "knee": 0.40}),
    ],
)  # fmt: skip
def test_people_are_made_to_measure(shape, wishes) -> None:
    """Each asked girth and length within 2 mm on the finished, dressed figure."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", VitruvianWarning)
        found = measures(person(**shape, measures=wishes)).values
    for name, want in wishes.items():
        assert found[name] == pytest.approx(want, abs=2e-3), name


def test_what_nobody_can_have_is_said() -> None:
    with pytest.warns(VitruvianWarning, match=r"measure waist: the nearest this build reaches is \d\.\d+ m, not 0.2"):
        person(gender=1.0, measures={"waist": 0.2, "chest": 1.0})
    with pytest.raises(VitruvianError, match="expected one of head, neck"):
        person(measures={"wiast": 0.8})
    with pytest.raises(VitruvianError, match="did you mean 0.8"):
        person(measures={"waist": 80})


def test_letting_out_is_smooth_and_local() -> None:
    """Girths grow by their share, faces keep their side, and what is far stays."""
    points = shaped(Shape(gender=1.0))
    body = points[: source.BODY]
    triangles = source.array("triangles")

    def normals(p):
        a, b, c = (p[triangles[:, k]] for k in range(3))
        n = np.cross(b - a, c - a)
        return n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-15)

    for name in letting.REACH:
        out = letting.let_out(points, {name: 0.06})
        change = np.linalg.norm(out - points, axis=1)
        assert 0.001 < change.max() < 0.03, name
        assert np.einsum("ij,ij->i", normals(body), normals(out[: source.BODY])).min() > 0.8, name
        edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]])
        step = np.linalg.norm((out - points)[edges[:, 0]] - (out - points)[edges[:, 1]], axis=1)
        assert (step / np.maximum(np.linalg.norm(body[edges[:, 0]] - body[edges[:, 1]], axis=1), 1e-4)).max() < 0.5, (
            name
        )
        if name not in ("ankle", "calf", "knee"):
            assert change[body[:, 1].argmin()] < 1e-6
    assert letting.let_out(points, {"waist": 0.0}) is points
    for wrong in ({"waist": 0.5}, {"height": 0.1}, {"waist": np.nan}):
        with pytest.raises(VitruvianError, match="girths: expected"):
            letting.let_out(points, wrong)
    assert set(letting.REACH) == set(GIRTHS) and set(SLIDERS) == set(NAMES)
