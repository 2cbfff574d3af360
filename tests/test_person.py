"""The built-in person: reference sizes, levels, rest pose, symmetry, looks that follow every shape, decency."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from vitruvian.errors import VitruvianError, VitruvianWarning
from vitruvian.hanim import tables
from vitruvian.modeling import anatomy, source
from vitruvian.modeling.look import HAIR, STYLES, mask, tone_color
from vitruvian.modeling.outfit import OUTFITS
from vitruvian.modeling.person import action_name, person, unit_name
from vitruvian.modeling.shape import Shape, shaped


@pytest.fixture(scope="module")
def woman():
    return person(gender=0.0)


@pytest.fixture(scope="module")
def man():
    return person(gender=1.0)


def part(humanoid, name):
    return next(s for s in humanoid.skin if s.name == name)


@pytest.mark.parametrize(("gender", "stature"), [(0.0, 1.594), (0.5, 1.662), (1.0, 1.730)])
def test_statures_of_the_source(gender, stature):
    """Known statures before re-posing, with half "ideal" proportions and the three origins averaged."""
    body = shaped(Shape(gender=gender, proportions=0.75))[: source.BODY]
    assert np.ptp(body[:, 1]) == pytest.approx(stature, abs=1e-3)


@pytest.mark.parametrize(("loa", "count"), [(0, 1), (1, 18), (2, 71), (3, 94), (4, 146)])
def test_levels_of_articulation(loa, count):
    h = person(loa=loa)
    joints = {j.name: j for j in h.joints()}
    assert len(joints) == count
    for j in joints.values():
        assert all(tables.parent_at(child.name, loa) == j.name for child in j.joints)
    total = np.zeros(len(h.skin_coord))
    for j in joints.values():
        np.add.at(total, j.skin_coord_index, j.skin_coord_weight)
    assert np.abs(total - 1).max() < 1e-6


def test_rest_does_not_depend_on_the_level():
    full, plain = person(loa=4), person(loa=1)
    assert np.abs(full.skin_coord - plain.skin_coord).max() < 1e-12
    centers = {j.name: j.center for j in full.joints()}
    assert all(np.array_equal(j.center, centers[j.name]) for j in plain.joints())


def test_mirror_image(woman):
    body = woman.skin_coord[: source.BODY]
    image = body[source.array("mirror")[: source.BODY]] * [-1, 1, 1]
    assert np.abs(body - image).max() < 1e-6
    left, right = woman.joint("l_knee").center, woman.joint("r_knee").center
    assert np.allclose(left, right * [-1, 1, 1], atol=1e-6)


@pytest.mark.parametrize("shape", [{"gender": 0.0}, {"gender": 1.0, "muscle": 1.0}, {"age": 10}, {"weight": 0.6}])
def test_rest_pose(shape):
    """Soles at 0, facing +Z, forearms and hands along -Y, thumbs forward, every rotation zero."""
    h = person(**shape)
    assert abs(h.skin_coord[:, 1].min()) < 1e-9
    assert all(np.array_equal(j.rotation[3:], [0]) for j in h.joints())
    for side in ("l_", "r_"):
        places = [h.joint(side + n).center for n in ("elbow", "radiocarpal", "metacarpophalangeal_3")]
        for a, b in zip(places, places[1:], strict=False):
            d = (b - a) / np.linalg.norm(b - a)
            assert np.degrees(np.arccos(-d[1])) < 0.5
        thumb = h.joint(side + "carpal_interphalangeal_1").center - h.joint(side + "metacarpophalangeal_1").center
        assert thumb[2] > 0.5 * np.linalg.norm(thumb)
        toe = h.joint(side + "metatarsophalangeal_2").center - h.joint(side + "talocrural").center
        assert abs(toe[0]) < 0.02 < toe[2]


def test_reposing_keeps_the_volume():
    def volume(points):
        a, b, c = (points[source.array("triangles")[:, k]] for k in range(3))
        return np.einsum("ij,ij->", a, np.cross(b, c)) / 6

    for shape in ({}, {"gender": 1.0, "muscle": 0.9}, {"gender": 0.0, "weight": 0.9}):
        before = volume(shaped(Shape(**shape))[: source.BODY])
        after = volume(person(**shape).skin_coord[: source.BODY])
        assert after == pytest.approx(before, rel=0.003)


def test_centres_scale_with_the_body():
    points = shaped(Shape())
    assert np.allclose(anatomy.centers(2 * points), 2 * anatomy.centers(points))


def test_smooth_where_it_should_be():
    """The detail of the source is gone: the chest lies within 2 mm of a quadric over the 13 vertices about a thelion."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        gender, muscle, weight, cup = rng.uniform(0, 1, 4)
        p = shaped(Shape(gender=gender, muscle=muscle, weight=weight, cup=cup, age=rng.uniform(12, 80)))[: source.BODY]
        thelion = p[source.feature_vertices()["l_thelion"]]
        near = p[np.argsort(np.linalg.norm(p - thelion, axis=1))[:13]] - thelion
        axes = np.linalg.svd(near - near.mean(axis=0))[2]
        u, v, height = (near @ axes.T).T
        quadric = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
        rest = height - quadric @ np.linalg.lstsq(quadric, height, rcond=None)[0]
        assert np.abs(rest).max() < 0.002


def test_pack_fits_its_budget():
    folder = Path(source.PACK)
    assert sum(f.stat().st_size for f in folder.iterdir()) <= 10_000_000
    assert (folder / "LICENSE-CC0.txt").exists()


def test_a_person_is_dressed_and_has_a_face(woman, man):
    for h in (woman, man):
        names = [s.name for s in h.skin]
        assert names[:1] == ["skin"]
        assert {"eyes", "brows", "lashes", "teeth", "tongue", "hair", "shorts", "top", "shoes"} <= set(names)
        for s in h.skin:
            assert s.points is None and s.triangles.max() < len(h.skin_coord)
            assert s.colors.shape == (len(h.skin_coord), 3) and 0 <= s.colors.min() <= s.colors.max() <= 1
    assert len(part(woman, "skin").triangles) < len(source.array("triangles"))


@pytest.mark.parametrize(
    "shape", [{"gender": 0.0, "cup": 0.9}, {"gender": 1.0, "weight": 0.9}, {"age": 10}, {"age": 80, "weight": 0.2}]
)
def test_no_skin_shows_through_the_clothes(shape):
    """Skin that is drawn near the inside of a garment lies inside of it."""
    h = person(**shape)
    top = part(h, "top")
    t = h.skin_coord[top.triangles]
    normal = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    middle = t.mean(axis=1)
    drawn = np.unique(part(h, "skin").triangles)
    chest, hip = h.joint("vt6").center[1], h.joint("l_hip").center[1]
    torso = drawn[
        (h.skin_coord[drawn, 1] > hip + 0.06)
        & (h.skin_coord[drawn, 1] < chest)
        & (np.abs(h.skin_coord[drawn, 0]) < 0.1)
    ]
    assert len(torso) == 0 or (
        ((h.skin_coord[torso] - middle[cKDTree(middle).query(h.skin_coord[torso])[1]]) * normal[0]).sum(axis=1).max()
        < 0.02
    )
    # The body under the shirt is nowhere outside of it.
    body = h.skin_coord[: source.BODY]
    under = np.flatnonzero((body[:, 1] > hip + 0.08) & (body[:, 1] < chest) & (np.abs(body[:, 0]) < 0.09))
    where = cKDTree(middle).query(body[under])[1]
    outside = ((body[under] - middle[where]) * normal[where]).sum(axis=1)
    assert np.mean(outside > 0.002) < 0.01


@pytest.mark.parametrize("style", [s for s in STYLES if s != "none"])
@pytest.mark.parametrize("shape", [{"gender": 0.0}, {"gender": 1.0, "age": 70}, {"age": 10}])
def test_hair_sits_on_the_head(style, shape):
    """Hair is near the skin of the head and clear of the eyes and the mouth."""
    h = person(hair=style, **shape)
    hair = h.skin_coord[np.unique(part(h, "hair").triangles)]
    head = h.skin_coord[: source.BODY]
    assert cKDTree(head).query(hair)[0].max() < 0.075
    eyes = h.skin_coord[np.unique(part(h, "eyes").triangles)]
    front = hair[hair[:, 2] > eyes[:, 2].mean()]
    assert not (front[:, 1] < eyes[:, 1].mean() - 0.02).any() or np.abs(front[:, 0]).min() > 0.02
    assert hair[:, 1].max() > head[:, 1].max()


def test_eyes_turn_with_their_joints(woman):
    eyes = np.unique(part(woman, "eyes").triangles)
    left = eyes[woman.skin_coord[eyes, 0] > 0]
    joint = woman.joint("l_eyeball_joint")
    held = dict(zip(joint.skin_coord_index.tolist(), joint.skin_coord_weight.tolist(), strict=True))
    assert all(held.get(int(v), 0) > 0.999 for v in left)
    assert np.linalg.norm(woman.skin_coord[left].mean(axis=0) - joint.center) < 0.012


def test_blinking_closes_the_lids_with_lashes(woman):
    blink = next(d for d in woman.displacers() if d.name == action_name("eyeBlinkLeft"))
    lashes = np.unique(part(woman, "lashes").triangles)
    assert np.isin(lashes, blink.coord_index).sum() > 20
    assert blink.displacements[:, 1].min() < -0.004


def test_names_of_face_units_go_both_ways(woman):
    units = source.manifest()["faces"]
    assert len(units) == 52 == sum(d.name.endswith("_action") for d in woman.displacers())
    assert all(unit_name(action_name(u)) == u for u in units)


def test_masses_and_sites(man):
    mass = sum(s.mass for s in man.segments())
    assert mass == pytest.approx(float(man.info["weight"]), abs=0.1)
    assert 50 < mass < 90
    names = {s.name for s in man.all_sites()}
    assert {"skull_tip", "l_carpal_distal_phalanx_2_tip", "navel_pt", "l_acromion_pt"} <= names


def test_feature_points_are_where_their_names_say(man):
    at = {s.name: s.translation for s in man.all_sites()}
    body = man.skin_coord[: source.BODY]
    eye = man.joint("l_eyeball_joint").center
    assert at["skull_vertex_pt"][1] == pytest.approx(body[:, 1].max(), abs=1e-9)
    for name in ("skull_vertex", "sellion", "menton", "suprasternale", "crotch", "navel", "cervicale"):
        assert abs(at[name + "_pt"][0]) < 1e-6
    assert abs(at["sellion_pt"][1] - eye[1]) < 0.02 and at["sellion_pt"][2] > eye[2]
    assert at["menton_pt"][1] < eye[1] - 0.08 and at["menton_pt"][2] > man.joint("skullbase").center[2]
    assert at["l_tragion_pt"][0] > 0.06 and at["r_tragion_pt"][0] < -0.06
    assert abs(at["crotch_pt"][1] - man.joint("l_hip").center[1]) < 0.16


def test_regions_of_the_skin():
    lips = mask("lips") > 0.5
    reference = source.points()[: source.BODY]
    assert 50 < lips.sum() < 400
    assert np.ptp(reference[lips, 0]) < 0.08 and reference[lips, 2].min() > 0.08
    assert tone_color(0.0).sum() > tone_color(1.0).sum()
    h = person(gender=0.0)
    colors = part(h, "skin").colors[: source.BODY]
    cheek = colors[(mask("face") > 0.5) & (mask("lips") < 0.01)].mean(axis=0)
    rosy = colors[lips].mean(axis=0)
    assert rosy[1] / rosy[0] < cheek[1] / cheek[0]


def test_wishes_are_met():
    h = person(gender=0.0, height=1.68)
    body = h.skin_coord[: source.BODY, 1]
    assert np.ptp(body) == pytest.approx(1.68, abs=2e-3)


def test_old_people_are_grey_and_colours_can_be_chosen():
    old, young = person(age=78, origin=(0, 0, 1)), person(age=25, origin=(0, 0, 1))
    tint = lambda h: part(h, "hair").colors[np.unique(part(h, "hair").triangles)].mean(axis=0)  # noqa: E731
    assert np.ptp(tint(old)) < 0.12 < tint(old).mean() - tint(young).mean()
    red = person(hair_color="red")
    assert np.ptp(tint(red)) > 0.2 and "red" in HAIR


def test_every_outfit_can_be_worn():
    for name in OUTFITS:
        h = person(outfit=name)
        assert len(h.skin) == 7 + len(OUTFITS[name])
    bare = person(outfit=None)
    navel = bare.skin_coord[: source.BODY]
    at = np.argmin(
        np.linalg.norm(navel - next(s.translation for s in bare.all_sites() if s.name == "navel_pt"), axis=1)
    )
    assert part(bare, "skin").colors[at].max() < 0.45  # the painted suit


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"hair": "mohawk"}, "hair: expected"),
        ({"outfit": "tuxedo"}, "outfit: expected"),
        ({"skin_tone": 2.0}, "skin_tone: expected"),
        ({"eye_color": "mauve"}, "eye_color: expected"),
        ({"hair_color": (1, 2, 3)}, "hair_color: expected"),
        ({"loa": 7}, "loa: expected"),
        ({"gender": 3.0}, "gender: expected"),
    ],
)
def test_wrong_wishes_say_what_was_expected(wrong, says):
    with pytest.raises(VitruvianError, match=says):
        person(**wrong)


def test_ages_outside_the_pack_warn():
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        person(age=5)
    assert any(isinstance(w.message, VitruvianWarning) and "10" in str(w.message) for w in seen)


def test_cameras_go_with_the_person_and_hold_it(tmp_path: Path) -> None:
    from vitruvian.formats.registry import load, save
    from vitruvian.show.figure import Figure

    child = person(age=12)
    save(child, tmp_path / "child.x3d")
    for who in (child, load(tmp_path / "child.x3d")):
        assert [s.name for s in who.viewpoints] == ["front_view", "side_view", "face_view"]
        figure = Figure(who)
        surface = next(figure.at([0.0]))
        places = figure.places(surface, 0.0)
        for name, toward in (("front_view", [0, 0, 1]), ("side_view", [1, 0, 0])):
            local = surface.vertices @ places[name][:3, :3] - places[name][:3, 3] @ places[name][:3, :3]
            assert np.allclose(places[name][:3, 2], toward, atol=1e-6)
            assert (np.abs(local[:, :2]) < np.tan(np.pi / 8) * -local[:, 2:]).all()  # in a picture 45 degrees wide
        eye, nose = places["face_view"][:3, 3], figure.skeleton.centers[figure.skeleton.index["skullbase"]]
        assert 0.3 < eye[2] - nose[2] < 0.8 and abs(eye[1] - nose[1]) < 0.15
