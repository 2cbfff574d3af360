"""The face of the built-in person as Displacers: units, regions and expressions, and where they go from there."""

import numpy as np
import pytest

import vitruvian as vt
from vitruvian.hanim.humanoid import Track
from vitruvian.modeling import face, source
from vitruvian.modeling.blend import blend
from vitruvian.modeling.decimate import decimate
from vitruvian.modeling.person import action_name
from vitruvian.modeling.smoother import smoother
from vitruvian.show.explore import group


@pytest.fixture(scope="module")
def woman():
    return vt.person(gender=0.0)


def kind(name):
    return name.rpartition("_")[2]


def counts(humanoid):
    kinds = [kind(d.name) for d in humanoid.displacers()]
    return tuple(kinds.count(k) for k in ("action", "feature", "config"))


def regions_of(humanoid):
    return {d.name.removesuffix("_feature"): d for d in humanoid.displacers() if d.marks}


def middles(humanoid):
    return {n: humanoid.skin_coord[d.coord_index].mean(axis=0) for n, d in regions_of(humanoid).items()}


def stands_right(at):
    """Where the parts of any face are."""
    assert at["forehead"][1] > at["l_eyebrow"][1] > at["l_upper_eyelid"][1] > at["l_lower_eyelid"][1]
    assert at["l_lower_eyelid"][1] > at["nose"][1] > at["upper_lip"][1] > at["lower_lip"][1] > at["chin_pad"][1]
    assert at["l_eyebrow"][1] > at["l_cheek"][1] > at["chin_pad"][1]
    assert at["l_ear"][0] > at["l_cheek"][0] > at["l_nostril"][0] > 0
    assert at["nose"][2] > at["l_cheek"][2] > at["l_ear"][2] > at["scalp"][2]


def test_the_kinds_are_all_there(woman):
    assert counts(woman) == (52, 18, 6)
    assert len({d.name for d in woman.displacers()}) == 76
    assert all(d.weight == 0 for d in woman.displacers())


def test_regions_are_mirror_images_and_do_not_overlap():
    found, mirror = face.regions(), source.array("mirror")[: source.BODY]
    for name, index in found.items():
        other = {"l_": "r_", "r_": "l_"}.get(name[:2], name[:2]) + name[2:]
        np.testing.assert_array_equal(np.sort(mirror[index]), found[other])
    every = np.concatenate(list(found.values()))
    assert len(np.unique(every)) == len(every)
    assert all(len(index) >= 20 for index in found.values())


@pytest.mark.parametrize("sliders", [{"gender": 0.0}, {"gender": 1.0, "age": 70}, {"age": 12, "weight": 0.9}])
def test_regions_are_where_they_say(sliders):
    h = vt.person(**sliders)
    at = middles(h)
    stands_right(at)
    eye = h.joint("l_eyeball_joint").center
    for lid in ("l_upper_eyelid", "l_lower_eyelid"):
        assert np.linalg.norm(at[lid] - eye) < 0.025
    places = vt.feature_points(h)
    for point, region in {
        "menton": "chin_pad",
        "sellion": "nose",
        "skull_vertex": "scalp",
        "l_tragion": "l_ear",
    }.items():
        own = h.skin_coord[regions_of(h)[region].coord_index]
        assert np.linalg.norm(own - places[point], axis=1).min() < 1e-3


def test_units_move_their_regions(woman):
    """A unit named after a part of the face moves that part more than any other."""
    moves = {d.name: d for d in woman.displacers()}
    for unit, region in {
        "l_brow_down_action": "l_eyebrow",
        "r_brow_outer_up_action": "r_eyebrow",
        "l_eye_blink_action": "l_upper_eyelid",
        "mouth_roll_lower_action": "lower_lip",
        "mouth_roll_upper_action": "upper_lip",
        "cheek_puff_action": "l_cheek",
    }.items():
        size = np.zeros(len(woman.skin_coord))
        size[moves[unit].coord_index] = np.linalg.norm(moves[unit].displacements, axis=1)
        mean = {n: size[d.coord_index].mean() for n, d in regions_of(woman).items()}
        mean = {n: v for n, v in mean.items() if n[:2] not in ("l_", "r_") or n[:2] == region[:2]}
        assert max(mean, key=mean.__getitem__) == region, unit


def test_expressions_are_sums_of_units(woman):
    moves = {d.name: d for d in woman.displacers()}

    def field(name):
        out = np.zeros((len(woman.skin_coord), 3))
        out[moves[name].coord_index] = moves[name].displacements
        return out

    for name, shares in face.configurations().items():
        sum_of = sum(w * field(action_name(u)) for u, w in shares.items())
        assert np.abs(field(name) - sum_of).max() < np.sqrt(3) * face.LEAST_MOVE + len(shares) * 5e-5
        assert np.abs(field(name)).max() > 3e-3
        assert group(name) == "Expressions"
    corner = regions_of(woman)["upper_lip"].coord_index
    ends = corner[np.argsort(np.abs(woman.skin_coord[corner, 0]))[-8:]]
    assert field("joy_config")[ends, 1].min() > 0.002 and field("sadness_config")[ends, 1].max() < -0.002
    low = regions_of(woman)["lower_lip"].coord_index
    assert field("surprise_config")[low, 1].mean() < -0.005


@pytest.mark.parametrize("form", ["x3d", "x3dv", "wrl", "json"])
def test_files_keep_them(woman, tmp_path, form):
    path = tmp_path / f"face.{form}"
    vt.save(woman, path)
    again = vt.load(path)
    assert counts(again) == (52, 18, 6)
    stands_right(middles(again))
    old, new = middles(woman), middles(again)
    assert all(np.abs(old[n] - new[n]).max() < 2e-3 for n in old)  # points are counted in another order
    found = [f for f in vt.check(path) if f.rule == "D03"]
    assert "58 displacers" in found[0].message


@pytest.mark.parametrize("form", ["glb", "vrm", "usd"])
def test_regions_are_no_morphs(woman, tmp_path, form):
    body = vt.pack(woman)
    assert len(body.skin.morphs) == 58 and not any("feature" in m.name for m in body.skin.morphs)
    path = tmp_path / f"face.{form}"
    vt.save(woman, path)
    again = vt.load(path)
    assert counts(again) == (52, 0, 6)


def test_a_route_to_a_region_moves_nothing(woman):
    h = vt.person(loa=1)
    h.tracks = [Track("nose_feature", "weight", np.array([0.0, 1.0]), np.array([[0.0], [1.0]]), timer="T")]
    h.tracks.append(Track("joy_config", "weight", np.array([0.0, 1.0]), np.array([[0.0], [1.0]]), timer="T"))
    motion = vt.motion_of(h, vt.pack(h).skeleton)
    assert list(motion.weights) == ["joy_config"]


def test_levels_cuts_and_blends_keep_them(woman):
    for loa in (0, 1, 3):
        assert counts(vt.person(gender=0.0, loa=loa)) == (52, 18, 6)
    low = decimate(woman, 6300)
    assert counts(low) == (52, 18, 6)
    stands_right(middles(low))
    cut = vt.segment(woman)
    assert {kind(d.name) for d in cut.displacers()} == {"action", "feature", "config"}
    assert counts(vt.weld(cut)) == (52, 18, 6)
    fine = smoother(low)
    assert counts(fine) == (52, 18, 6)
    stands_right(middles(fine))
    assert all(len(regions_of(fine)[n].coord_index) > len(d.coord_index) for n, d in regions_of(low).items())
    mixed = blend([woman, vt.person(gender=1.0)], [0.5, 0.5])
    assert counts(mixed) == (52, 18, 6)
    stands_right(middles(mixed))
