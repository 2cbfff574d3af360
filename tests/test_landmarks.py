"""Landmarks: files, Sites, checks, and feature points found on scans whose truth is known."""

from __future__ import annotations

import json
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import vitruvian as vt
from scan_maker import case, scan
from vitruvian.errors import FileError, VitruvianError, VitruvianWarning
from vitruvian.modeling import landmarks, source
from vitruvian.modeling.finding import found
from vitruvian.modeling.person import person


@pytest.fixture(scope="module")
def places():
    return vt.feature_points(person(outfit=None, hair="none"))


def test_files_keep_what_they_are_given(tmp_path, places) -> None:
    path = tmp_path / "marks.json"
    landmarks.save(places, path)
    back = landmarks.read(path)
    assert list(back) == list(places)
    assert all(np.array_equal(back[n], places[n]) for n in places)
    path.write_text('{"l_acromion_pt": [1, 2, 3], "r_metatarsal_pha1": [4.5, 0, 1e-3]}')  # a Site's name, 1.x's name
    assert {n: p.tolist() for n, p in landmarks.read(path).items()} == {
        "l_acromion": [1, 2, 3],
        "r_metatarsal_phalanx_1": [4.5, 0, 1e-3],
    }


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        ('{\n"l_acromion": [1, 2, 3],\n"l_acromium": [1, 2, 3]}', 3, "did you mean l_acromion"),
        ('{"l_acromion": [1, 2]}', 1, "'l_acromion': expected three numbers"),
        ('{"l_acromion": [1, 2, "3"]}', 1, "three numbers"),
        ('{"l_acromion":\n [1, 2, NaN]}', 1, "finite"),
        ('{"l_acromion": [1, 2, 1e999]}', 1, "finite"),
        ('{"l_acromion": [1, 2, 3],\n"l_acromion_pt": [1, 2, 3]}', 2, "twice"),
        ('{"navel": [1, 2, 3],\n,}', 2, "JSON"),
        ("[1, 2]", 0, "object"),
        ("[" * 100_000, 0, "JSON"),
        ('{"navel": [1, 2, ' + "9" * 6000 + "]}", 0, "JSON"),
    ],
)
def test_other_files_are_refused_in_one_line(tmp_path, text, line, says) -> None:
    path = tmp_path / "marks.json"
    path.write_text(text)
    with pytest.raises(FileError, match=says) as error:
        landmarks.read(path)
    assert error.value.line == line and "\n" not in str(error.value) and len(str(error.value)) < 500


def test_large_and_binary_files_are_refused(tmp_path) -> None:
    path = tmp_path / "marks.json"
    path.write_bytes(b" " * (landmarks.MAX_BYTES + 1))
    with pytest.raises(FileError, match="at most 1 MB"):
        landmarks.read(path)
    path.write_bytes(b"\xff\xfe\x00{")
    with pytest.raises(FileError, match="UTF-8"):
        landmarks.read(path)
    with pytest.raises(FileError, match="read"):
        landmarks.read(tmp_path / "absent.json")


json_values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=12), inner, max_size=4),
)


@settings(max_examples=60, deadline=None)
@given(
    st.dictionaries(st.sampled_from(["l_acromion", "navel", "menton_pt", "nose"]) | st.text(max_size=9), json_values)
)
def test_any_object_is_read_or_refused(tmp_path_factory, document) -> None:
    path = tmp_path_factory.mktemp("any") / "marks.json"
    path.write_text(json.dumps(document), encoding="utf-8", errors="surrogatepass")
    try:
        found = landmarks.read(path)
    except FileError:
        return
    assert all(p.shape == (3,) and np.isfinite(p).all() for p in found.values())


def test_a_failed_save_leaves_the_old_file(tmp_path) -> None:
    path = tmp_path / "marks.json"
    landmarks.save({"navel": [0, 1, 0]}, path)
    with pytest.raises(VitruvianError, match="did you mean navel"):
        landmarks.save({"navell": [0, 1, 0]}, path)
    assert list(landmarks.read(path)) == ["navel"]
    with pytest.raises(VitruvianError, match="can't be written"):
        landmarks.save({"navel": [0, 1, 0]}, tmp_path / "none" / "marks.json")
    assert [p.name for p in tmp_path.iterdir()] == ["marks.json"]


def test_sites_both_ways() -> None:
    h = person(loa=1)
    landmarks.as_sites(h, {"l_acromion": [0.2, 1.4, 0.1], "r_clavicale": [-0.1, 1.4, 0.0]})
    back = landmarks.from_sites(h)
    assert back["l_acromion"].tolist() == [0.2, 1.4, 0.1] and back["r_clavicle"].tolist() == [-0.1, 1.4, 0.0]


def test_sides_of_the_built_in_points(places) -> None:
    """Left is left, right its mirror image, and the points of the limbs are where their names say."""
    assert len(places) >= 105
    for name, p in places.items():
        if name.startswith("l_"):
            assert p[0] > 0, name
            np.testing.assert_allclose(places["r_" + name[2:]], p * [-1, 1, 1], atol=1e-6)
    assert (
        places["l_calcaneus_posterior"][2] < places["l_lateral_malleolus"][2] < places["l_tarsal_distal_phalanx_1"][2]
    )
    assert places["l_medial_malleolus"][0] < places["l_lateral_malleolus"][0]
    assert places["l_suprapatella"][2] > places["l_knee_crease"][2] + 0.05
    assert places["l_infraorbitale"][2] > places["l_tragion"][2] + 0.04
    assert places["suprasternale"][1] < places["adams_apple"][1] < places["menton"][1]


@pytest.mark.parametrize(("unit", "per_metre"), [("m", 1), ("cm", 100), ("mm", 1000), ("in", 39.37)])
def test_the_unit_is_told(places, unit, per_metre) -> None:
    some = {n: p * per_metre for n, p in places.items() if "tarsal" not in n}
    seen = landmarks.checked(some)
    assert seen.unit == unit and not seen.mirrored and seen.size == pytest.approx(per_metre, rel=0.15)


def test_swapped_sides_are_told() -> None:
    s = scan({"gender": 1.0}, arms=(80, 60), yaw=2.0, bend=30)
    assert not landmarks.checked(s.truth).mirrored
    other = {"l_": "r_", "r_": "l_"}
    swapped = {other.get(n[:2], n[:2]) + n[2:]: p for n, p in s.truth.items()}
    with pytest.warns(VitruvianWarning, match="left and right"):
        assert landmarks.checked(swapped).mirrored
    with pytest.warns(VitruvianWarning, match="left and right"):
        assert landmarks.checked({n: p * [1, 1, -1] for n, p in s.truth.items()}).mirrored


def test_landmarks_that_make_no_sense(places) -> None:
    for points, says in (
        ({"navel": [0, 1, 0]}, "at least 4"),
        ({**places, "nose": [0, 0, 0]}, "nose"),
        ({**places, "navel": [0, np.nan, 0]}, "navel"),
        ({n: [1, 1, 1] for n in places}, "one place"),
    ):
        with pytest.raises(VitruvianError, match=says):
            landmarks.checked(points)
    with pytest.warns(VitruvianWarning, match="fits no unit"):
        landmarks.checked({n: p * 7 for n, p in places.items()})


@pytest.mark.parametrize(
    "name",
    [
        "tall heavy man, inches, no soles, no crown",
        "arms unlike, inside out, coarse",
    ],
)
def test_points_are_found(name) -> None:
    """Mean error <= 25 mm, 90th percentile <= 50 mm, sides never swapped, what is sure is right within 40 mm."""
    s = case(name)
    points = landmarks.detect(SimpleNamespace(vertices=s.vertices, triangles=s.triangles))
    off = {n: float(np.linalg.norm(p - s.truth[n]) * s.metres) for n, (p, _) in points.items()}
    values = np.array(list(off.values()))
    assert len(points) >= 100 and values.mean() <= 0.025 and np.quantile(values, 0.9) <= 0.05
    sure = np.array([off[n] <= 0.04 for n, (_, c) in points.items() if c >= 0.7])
    assert len(sure) >= 60 and sure.mean() >= 0.95
    for n, (p, _) in points.items():
        if n.startswith("l_"):
            assert np.linalg.norm(p - s.truth[n]) < np.linalg.norm(p - s.truth["r_" + n[2:]]), n


def test_a_scene_with_floor_table_and_another_person() -> None:
    s = scan({"gender": 0.0}, yaw=0.4, cell=0.015)
    child = scan({"age": 10}, yaw=0.4, cell=0.02)
    tall = float(s.vertices[:, 1].min())
    floor = trimesh.creation.box(
        [4, 0.001, 4], trimesh.transformations.translation_matrix([0, tall, 0])
    ).subdivide_loop(3)
    table = trimesh.creation.box([1.6, 0.7, 0.8], trimesh.transformations.translation_matrix([0, 0.4, 1.6]))
    parts = [(s.vertices, s.triangles), (floor.vertices, floor.faces), (table.vertices, table.faces)]
    parts.append((child.vertices + [2.0, 0, 0], child.triangles))
    starts = np.cumsum([0, *(len(v) for v, _ in parts)])
    scene = SimpleNamespace(
        vertices=np.concatenate([v for v, _ in parts]),
        triangles=np.concatenate([f + a for (_, f), a in zip(parts, starts, strict=False)]).astype(np.int32),
    )
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        points = landmarks.detect(scene)
    off = [
        min(np.linalg.norm(p - s.truth[n]), np.linalg.norm(p - child.truth[n] - [2.0, 0, 0]))
        for n, (p, _) in points.items()
    ]
    assert np.mean(off) < 0.025
    assert any("several" in str(w.message) for w in said)


def test_what_is_no_person_is_refused() -> None:
    ball = trimesh.creation.icosphere(3)
    box = trimesh.creation.box([0.5, 1.7, 0.3]).subdivide().subdivide().subdivide()
    flat = trimesh.creation.box([2, 0.0, 2]).subdivide().subdivide().subdivide()
    for thing in (ball, box, flat):
        with pytest.raises(VitruvianError, match="scan|vertices") as error:
            landmarks.detect(SimpleNamespace(vertices=thing.vertices, triangles=thing.faces.astype(np.int32)))
        assert "\n" not in str(error.value)
    with pytest.raises(VitruvianError, match="50 triangles"):
        landmarks.detect(SimpleNamespace(vertices=np.eye(3), triangles=np.array([[0, 1, 2]], np.int32)))


def test_a_real_scan(shared) -> None:
    mesh = vt.load(shared / "data" / "scans" / "human_man.obj")
    seen = found(mesh)
    at = {n: p for n, (p, _) in seen.points.items()}
    assert seen.up == "+y" and seen.upright[2] @ [0, 0, 1] > 0.98
    assert sum(c >= 0.7 for _, c in seen.points.values()) >= 70
    assert at["skull_vertex"][1] == pytest.approx(mesh.vertices[:, 1].max(), abs=0.01)
    assert at["l_carpal_distal_phalanx_3"][0] == pytest.approx(mesh.vertices[:, 0].max(), abs=0.05)
    assert at["crotch"][1] == pytest.approx(0.83, abs=0.03)
    assert at["l_calcaneus_posterior"][1] < 0.08 and at["l_tarsal_distal_phalanx_1"][2] > at["l_calcaneus_posterior"][2]
    assert abs(at["l_acromion"][0] + at["r_acromion"][0]) < 0.03
    surface = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    assert surface.nearest.vertex(np.array(list(at.values())))[0].max() < 0.05


def test_positions_are_on_the_built_in_body() -> None:
    assert max(source.feature_vertices().values()) < source.BODY
