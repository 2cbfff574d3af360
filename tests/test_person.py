"""The built-in person: sizes, names, weights, rest pose, looks, and the pack it is made from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import vitruvian as vt
from vitruvian.hanim import tables
from vitruvian.modeling import anatomy, source
from vitruvian.modeling.measure import measured, report
from vitruvian.modeling.person import action_name, unit_name
from vitruvian.modeling.shape import Shape, shaped

WIDE = settings(max_examples=10, deadline=None)


@pytest.fixture(scope="module")
def anna() -> vt.Humanoid:
    return vt.person(gender=0, age=30)


@pytest.fixture(scope="module")
def body(anna: vt.Humanoid) -> vt.Body:
    return vt.pack(anna)


@pytest.mark.parametrize(("gender", "stature"), [(0, 1.594), (0.5, 1.662), (1, 1.730)])
def test_stature_of_the_source_body(gender: float, stature: float) -> None:
    """Half "ideal" proportions, three origins averaged: figures given with the data."""
    y = shaped(Shape(gender=gender, proportions=0.75))[: source.BODY, 1]
    assert np.ptp(y) == pytest.approx(stature, abs=1e-3)


@pytest.mark.parametrize("loa", range(5))
def test_joints_names_and_parents_at_every_level(loa: int) -> None:
    h = vt.person(loa=loa)
    assert [j.name for j in h.joints()] != []
    assert {j.name for j in h.joints()} == set(tables.joints_at(loa))
    assert len(h.joints()) == tables.LOA_COUNTS[loa] and h.loa == loa
    for joint in h.joints():
        for child in joint.joints:
            assert tables.parent_at(child.name, loa) == joint.name


def test_weights_sum_to_one_at_every_level() -> None:
    for loa in (1, 2, 4):
        weights = vt.pack(vt.person(loa=loa)).skin.weights
        assert np.abs(weights.sums - 1).max() < 1e-6
        assert weights.counts.min() >= 1


def test_rest_does_not_depend_on_the_level(anna: vt.Humanoid) -> None:
    coarse = vt.person(gender=0, age=30, loa=1)
    np.testing.assert_allclose(coarse.skin_coord, anna.skin_coord, atol=1e-12)
    for joint in coarse.joints():
        np.testing.assert_allclose(joint.center, anna.joint(joint.name).center, atol=1e-12)


def test_rest_pose_is_the_standards(anna: vt.Humanoid, body: vt.Body) -> None:
    at = {j.name: j.center for j in anna.joints()}
    for side in ("l_", "r_"):
        for a, b in (("elbow", "radiocarpal"), ("hip", "knee"), ("knee", "talocrural")):
            bone = at[side + b] - at[side + a]
            angle = np.degrees(np.arccos(-bone[1] / np.linalg.norm(bone)))
            assert angle < 0.5, f"{side}{a} to {b}: {angle:.2f} degrees from straight down"
        arm = at[side + "radiocarpal"] - at[side + "shoulder"]
        assert np.degrees(np.arccos(-arm[1] / np.linalg.norm(arm))) < 8
        foot = at[side + "metatarsophalangeal_2"] - at[side + "talocrural"]
        assert foot[2] > 0 and abs(foot[0]) < 0.01
    assert anna.skin_coord[:, 1].min() == pytest.approx(0, abs=1e-9)
    assert at["l_hip"][0] > 0 > at["r_hip"][0]
    for joint in anna.joints():
        assert joint.rotation[3] == 0 and not joint.translation.any() and (joint.scale == 1).all()


def test_hands_hang_clear_of_the_thighs() -> None:
    for gender, weight in ((0, 0.3), (0, 0.6), (1, 0.3), (1, 0.6)):
        skin = vt.pack(vt.person(gender=gender, weight=weight)).skin
        names = anatomy.names()
        strongest = skin.weights.top(1)[0][: source.BODY, 0]
        owner = np.array(["_".join(n.split("_")[:2]) for n in names])[strongest]
        points = skin.rest[: source.BODY]
        hand = points[np.isin(owner, ["l_radiocarpal", "l_metacarpophalangeal", "l_carpal", "l_carpometacarpal"])]
        thigh = points[np.isin(owner, ["l_hip"])]
        inside = hand[:, 0].min() - thigh[(thigh[:, 1] > hand[:, 1].min()) & (thigh[:, 1] < hand[:, 1].max()), 0].max()
        assert inside > -0.012, f"hand {-inside * 1000:.0f} mm into the thigh (gender {gender}, weight {weight})"


def test_left_mirrors_right(anna: vt.Humanoid) -> None:
    mirror = source.array("mirror")[: source.BODY]
    points = anna.skin_coord[: source.BODY]
    assert np.abs(points[mirror] * [-1, 1, 1] - points).max() < 2e-4
    for joint in anna.joints():
        if joint.name.startswith("l_"):
            other = anna.joint("r_" + joint.name[2:]).center
            np.testing.assert_allclose(joint.center * [-1, 1, 1], other, atol=2e-4)


def test_centres_scale_with_the_body() -> None:
    points = shaped(Shape())
    np.testing.assert_allclose(anatomy.centers(points * 1.3), anatomy.centers(points) * 1.3, atol=1e-12)


@given(
    gender=st.floats(0, 1),
    age=st.floats(10, 90),
    weight=st.floats(0, 1),
    muscle=st.floats(0, 1),
)
@WIDE
def test_every_shape_is_a_person(gender: float, age: float, weight: float, muscle: float) -> None:
    h = vt.person(gender=gender, age=age, weight=weight, muscle=muscle, loa=2)
    skin = vt.pack(h).skin
    assert np.isfinite(skin.rest).all()
    body = skin.rest[: source.BODY]
    assert 1.2 < np.ptp(body[:, 1]) < 2.0
    assert abs(body[:, 0].mean()) < 0.01
    knee, ankle = h.joint("l_knee").center, h.joint("l_talocrural").center
    assert h.joint("l_hip").center[1] > knee[1] > ankle[1] > 0.02


def test_height_is_met_at_rest() -> None:
    h = vt.person(gender=1, age=40, height=1.82)
    assert np.ptp(h.skin_coord[: source.BODY, 1]) == pytest.approx(1.82, abs=1e-6)
    assert report(h)["height_m"] == pytest.approx(1.82, abs=2e-3)


def test_measures_are_met() -> None:
    wishes = {"waist": 0.72, "hips": 0.98}
    h = vt.person(gender=0, measures=wishes, loa=1)
    found = report(h)["measures"]
    for name, value in wishes.items():
        assert found[name] == pytest.approx(value, abs=0.005)


def test_kilograms_are_met() -> None:
    assert report(vt.person(gender=1, weight=75.0, loa=1))["mass_kg"] == pytest.approx(75, abs=0.5)


def test_impossible_wishes_are_told() -> None:
    with pytest.warns(vt.VitruvianWarning, match="nearest"):
        vt.person(gender=0, height=2.45, loa=1)
    with pytest.raises(vt.VitruvianError, match=r"1\.75"):
        vt.person(height=175)
    with pytest.raises(vt.VitruvianError, match="chest"):
        vt.person(measures={"brain": 0.5})
    with pytest.raises(vt.VitruvianError, match="gender"):
        vt.person(gender=2)
    with pytest.raises(vt.VitruvianError, match="loa"):
        vt.person(loa=5)
    with pytest.warns(vt.VitruvianWarning, match="10 to 90"):
        vt.person(age=4, loa=1)


def test_measures_are_of_human_size() -> None:
    for gender in (0, 1):
        found = measured(shaped(Shape(gender=gender)))
        assert 0.5 < found["waist"] < found["hips"] < 1.1
        assert found["neck"] < found["thigh"] < found["waist"]
        assert found["wrist"] < found["upper_arm"] < found["calf"] + 0.02
        assert 0.28 < found["shoulder_width"] < 0.45


def test_masses_add_up(anna: vt.Humanoid) -> None:
    masses = {s.name: s.mass for s in anna.segments()}
    assert sum(masses.values()) == pytest.approx(float(anna.info["weight"]), abs=0.1)
    assert masses["l_thigh"] == pytest.approx(masses["r_thigh"], rel=0.02)
    assert masses["l_thigh"] > masses["l_calf"] > masses["l_talus"]


def test_sites_lie_on_the_body(anna: vt.Humanoid) -> None:
    sites = {s.name: s.translation for s in anna.all_sites()}
    assert sites["skull_vertex_pt"][1] > 0.97 * anna.skin_coord[: source.BODY, 1].max()
    assert sites["l_index_tip" if "l_index_tip" in sites else "l_carpal_distal_phalanx_2_tip"][1] < 0.8
    assert len([n for n in sites if n.endswith("_pt")]) >= 77
    assert sites["l_thelion_pt"][0] > 0 and sites["l_thelion_pt"][2] > 0.03


def test_face_units_are_displacers(anna: vt.Humanoid) -> None:
    displacers = {d.name: d for d in anna.displacers()}
    assert len(displacers) == 52 and all(n.endswith("_action") for n in displacers)
    jaw = displacers[action_name("jawOpen")]
    assert jaw.displacements[:, 1].min() < -0.01
    smile = displacers[action_name("mouthSmileLeft")]
    moved = anna.skin_coord[smile.coord_index][np.linalg.norm(smile.displacements, axis=1) > 2e-3]
    assert (moved[:, 0] > -0.02).all() and moved[:, 0].mean() > 0.01
    for unit in source.manifest()["faces"]:
        assert unit_name(action_name(unit)) == unit


def test_pack_is_small_and_licensed() -> None:
    files = list(source.PACK.iterdir())
    assert sum(f.stat().st_size for f in files) <= 10e6
    assert "CC0" in (source.PACK / "LICENSE-CC0.txt").read_text()


def test_parts_have_looks(anna: vt.Humanoid, body: vt.Body) -> None:
    names = {p.name for p in body.skin.parts}
    assert {"skin", "eyes", "hair", "brows", "top", "shoes"} <= names
    assert body.skin.colors is not None and body.skin.colors.std(axis=0).min() > 0.02
    skin = next(s for s in anna.skin if s.name == "skin")
    assert skin.uv is not None and 0 <= skin.uv.min() and skin.uv.max() <= 1
