"""Repairs on whole figures and real files: what is right is not touched, posed pictures stay, nothing is done twice."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from doctor_cases import BULGE
from scene_figure import GOOD, MOTION, VRML, good, typed
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.pack import pack
from vitruvian.errors import VitruvianError
from vitruvian.formats.vrml import parse_vrml, read_vrml
from vitruvian.formats.x3d import parse_x3d, read_x3d, write_x3d
from vitruvian.formats.x3d_writer import print_x3d
from vitruvian.hanim.build import scene_of
from vitruvian.hanim.doctor import check
from vitruvian.hanim.doctor_fix import mend
from vitruvian.hanim.graph import Scene
from vitruvian.hanim.humanoid import Humanoid, MotionData
from vitruvian.hanim.view import humanoids
from vitruvian.motion.tracks import motion_of


def written(scene: Scene, path: Path) -> bytes:
    write_x3d(scene, path)
    return path.read_bytes()


def test_a_good_figure_is_not_touched(tmp_path: Path) -> None:
    scene = good()
    before = written(scene, tmp_path / "a.x3d")
    assert mend(scene, also=["all"]) == []
    assert written(scene, tmp_path / "b.x3d") == before


def test_all_at_once() -> None:
    text = GOOD
    for old, new in (
        (' containerField="skeleton"', ""),
        ('"1 0.5 0.5"', '"1 0.5"'),
        ('"0.5 0.5 1"', '"0.5 0.3 1 7"'),
        ('llimit="-1 -1 -1"', 'llimit="9 -1 -1" stiffness="2 0 0"'),
        ('<HAnimJoint USE="hanim_vl5" containerField="joints"/>', ""),
        ("</HAnimHumanoid>", MOTION.replace('"humanoid_root', '"HumanoidRoot').replace(' enabled="true"', "")),
    ):
        text = text.replace(old, new)
    scene = parse_x3d(text.encode(), "tin.x3d")
    done = mend(scene, also=["S01", "m14"])
    assert len(done) >= 8
    assert check(scene) == []
    (h,) = humanoids(scene)
    total = np.zeros(8)
    for j in h.joints():
        np.add.at(total, j.skin_coord_index, j.skin_coord_weight)
    np.testing.assert_allclose(total, 1)
    np.testing.assert_array_equal(h.joint("vl5").ulimit, [9, 1, 1])
    assert h.motions[0].joints == ["humanoid_root", "vl5"]


@pytest.mark.parametrize("word", ["Q99", "F02", "every"])
def test_what_cannot_be_asked_for(word: str) -> None:
    with pytest.raises(VitruvianError, match=f"--also: {word} (is no rule|has no repair); expected some of .*S04"):
        mend(good(), also=[word])


# Rest poses


def picture(scene: Scene, time: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Skin points and segment points (humanoid space) as browsers show them: at rest in the file, or in the clip."""
    (h,) = humanoids(scene)
    body = pack(h)
    matrices = joint_matrices(body.skeleton)[0]
    if time is not None:
        motion = motion_of(h, body.skeleton)
        assert motion is not None
        matrices = joint_matrices(body.skeleton, motion)[round(time * motion.fps)]
    at = dict(zip(body.skeleton.names, matrices))
    skin = h.skin_coord.copy()
    for j in h.joints():
        index, weight = j.skin_coord_index, j.skin_coord_weight[:, None]
        rest = h.skin_coord[index]
        np.add.at(skin, index, weight * (rest @ at[j.name][:3, :3].T + at[j.name][:3, 3] - rest))
    parts = []
    for j in h.joints():
        for segment in j.segments:
            for shape in segment.shapes:
                place = at[j.name] @ (np.eye(4) if shape.transform is None else shape.transform)
                assert shape.points is not None
                parts.append(shape.points @ place[:3, :3].T + place[:3, 3])
        for site in [*j.sites, *(s for g in j.segments for s in g.sites)]:
            where = at[j.name] @ np.array([*(site.translation + site.center), 1.0])
            parts.append(where[None, :3])
    return skin, np.concatenate(parts) if parts else np.zeros((0, 3))


def posed(scale: float) -> Humanoid:
    """A clip of three joints on a figure that is bent and shifted in the file."""
    h = typed(1)
    for j in h.joints():
        j.skin_coord_weight = np.ones(4)
    h.displacers()[0].weight = 0.0
    h.joint("l_shoulder").rotation = np.array([0, 0, 1, 1.2])
    h.joint("vl5").rotation = np.array([0.6, 0.8, 0, 0.7])
    h.joint("humanoid_root").translation = np.array([0.1, 0.05, -0.2])
    h.joint("l_elbow").rotation = np.array([1, 0, 0, -0.9])
    h.joint("l_elbow").scale = np.full(3, scale)
    if scale != 1:
        h.tracks = []
    return h


@pytest.mark.parametrize("scale", [1.0, 1.5])
def test_baking_keeps_the_picture(scale: float) -> None:
    """P01: skin, segments, sites and the clip look the same, while every joint is at rest in the file."""
    scene = parse_x3d(print_x3d(scene_of([posed(scale)])[0])[0].encode(), "posed.x3d")
    times = [None] if scale != 1 else [None, 0.0, 0.3, 1.0, 1.7]
    before = [picture(scene, t) for t in times]
    assert any("P01" in line for line in mend(scene))
    assert "P01" not in {f.rule for f in check(scene)}
    again = parse_x3d(print_x3d(scene)[0].encode(), "baked.x3d")
    for (skin, parts), time in zip(before, times):
        moved_skin, moved_parts = picture(again, time)
        np.testing.assert_allclose(moved_skin, skin, atol=2e-6)
        np.testing.assert_allclose(moved_parts, parts, atol=2e-6)
    (h,) = humanoids(again)
    assert all(j.rotation[3] == 0 and not j.translation.any() for j in h.joints())
    assert mend(again) == []


@pytest.mark.parametrize("flags", [[], [True] * 5, [True, True, False, True, True], [True] * 17])
def test_baking_carries_a_motion_along(flags: list[bool]) -> None:
    """P01 with an HAnimMotion on turned joints, in several channels and orders: every frame looks the same."""
    h = posed(1.0)
    h.tracks = []
    joints = ["humanoid_root", "vl5", "IGNORED", "l_shoulder", "l_elbow"]
    place, turn = ("Xposition", "Yposition", "Zposition"), ("Zrotation", "Xrotation", "Yrotation")
    channels = [
        place + turn,
        ("Xrotation",),
        ("Yrotation",) * 2,
        (turn[1], turn[0], turn[2], *place),
        ("Zrotation", place[1]),
    ]
    values = np.random.default_rng(2).normal(scale=40, size=(6, 17)) * np.where(
        ["position" in c for g in channels for c in g], 0.01, 1.0
    )  # fmt: skip
    values[0, 13:] = 0
    h.motions = [MotionData("run", joints, channels, values, 0.1, True, False, channels_enabled=flags)]
    scene = parse_x3d(print_x3d(scene_of([h])[0])[0].encode(), "posed.x3d")
    times = [0.0, 0.1, 0.3, 0.5]
    before = [picture(scene, t) for t in times]
    assert any("P01" in line for line in mend(scene))
    again = parse_x3d(print_x3d(scene)[0].encode(), "baked.x3d")
    for (skin, parts), time in zip(before, times):
        moved_skin, moved_parts = picture(again, time)
        np.testing.assert_allclose(moved_skin, skin, atol=5e-6)
        np.testing.assert_allclose(moved_parts, parts, atol=5e-6)
    assert all(j.rotation[3] == 0 and not j.translation.any() for j in humanoids(again)[0].joints())
    assert mend(again) == []


def test_baking_waits_where_there_is_no_one_answer() -> None:
    """A Script, an HAnimMotion that scales or does not fit, or a scale of zero on a joint that is not at rest."""
    bent = GOOD.replace('name="l_shoulder"', 'name="l_shoulder" rotation="0 0 1 1"')
    script = '<Script DEF="m"><field name="r" type="SFRotation" accessType="outputOnly"/></Script>'
    route = '<ROUTE fromNode="m" fromField="r" toNode="hanim_l_elbow" toField="set_rotation"/></Scene>'
    for text in (
        bent.replace("</Scene>", script + route),
        bent.replace("</HAnimHumanoid>", MOTION.replace(" vl5", " l_shoulder").replace("Xrotation", "Xscale")),
        bent.replace("</HAnimHumanoid>", MOTION.replace("1 Xrotation", "2 Xrotation")),
        bent.replace('name="vl5"', 'name="vl5" scale="0 1 1"'),
    ):
        scene = parse_x3d(text.encode(), "bent.x3d")
        assert mend(scene) == []
        assert "P01" in {f.rule for f in check(scene)}


@pytest.mark.filterwarnings("ignore::vitruvian.errors.VitruvianWarning")
def test_a_robot_is_baked(shared: Path) -> None:
    """The robot dialect gives offsets instead of centres: they become centres, the shapes stay where they are."""
    path = shared / "data" / "hanim" / "sample1.wrl"
    scene = read_vrml(path)
    _, before = picture(scene, None)
    assert any("(P01)" in line for line in mend(scene))
    _, after = picture(scene, None)
    np.testing.assert_allclose(after, before, atol=1e-9)
    (h,) = humanoids(scene)
    assert len({tuple(np.round(j.center, 6)) for j in h.joints()}) >= 15


def test_prototypes_may_have_another_default() -> None:
    """What a joint leaves to its PROTO counts as its pose, and is written out neutral once it is baked."""
    text = VRML.replace("SFRotation rotation 0 0 1 0", "SFRotation rotation 1 0 0 0.25")
    scene = parse_vrml(text.encode(), "nobody.wrl")
    _, before = picture(scene, None)
    assert any("the pose of 2 joints baked" in line for line in mend(scene))
    _, after = picture(scene, None)
    np.testing.assert_allclose(after, before, atol=1e-9)
    assert mend(scene) == []
    assert "P01" not in {f.rule for f in check(scene)}


# Names and DEFs


def test_followers_follow() -> None:
    """A renamed DEF takes its USEs and ROUTEs along; a renamed joint the lists of motions."""
    scene = parse_x3d(GOOD.replace('"Turn"', '"Turn it"').encode(), "t.x3d")
    mend(scene)
    assert {r.from_node for r in scene.routes()} == {"Clock", "Turn_it"}
    assert check(scene) == []
    text = GOOD.replace('name="vl5"', 'name="vL5"').replace("</HAnimHumanoid>", MOTION.replace(" vl5", " vL5"))
    scene = parse_x3d(text.encode(), "t.x3d")
    mend(scene)
    (h,) = humanoids(scene)
    assert h.motions[0].joints == ["humanoid_root", "vl5"]
    scene = parse_x3d(GOOD.replace("hanim_", "Tom_").encode(), "t.x3d")
    assert any("(N05)" in line for line in mend(scene, also=["N05"]))
    assert check(scene) == []
    assert {r.to_node for r in scene.routes()} == {"Turn", "hanim_l_shoulder"}
    (h,) = humanoids(parse_x3d(print_x3d(scene)[0].encode(), "t.x3d"))
    assert len(h.joints()) == len(h.node.children("joints")) == 4  # type: ignore[union-attr]


def test_the_later_of_two_is_renamed() -> None:
    """ROUTEs before the second DEF mean the first, those after it the second."""
    head = (
        "#X3D V4.0 utf8\nPROFILE Full\nDEF T TimeSensor { loop TRUE }\nDEF I ScalarInterpolator { key 0 keyValue 0 }\n"
    )
    text = head + "ROUTE T.fraction_changed TO I.set_fraction\nDEF T TimeSensor { loop TRUE }\n"
    text += "DEF K ScalarInterpolator { key 0 keyValue 0 }\nROUTE T.fraction_changed TO K.set_fraction\n"
    scene = parse_vrml(text.encode(), "t.x3dv")
    assert mend(scene) == ["DEF 'T' of line 6 is T_2 (F04)"]
    assert [(r.from_node, r.to_node) for r in scene.routes()] == [("T", "I"), ("T_2", "K")]


def test_weights_of_neighbours() -> None:
    """S04: a point without weight takes those of the nearest point along the mesh."""
    scene = parse_x3d(
        GOOD.replace('"5 6 7" skinCoordWeight="0.5 0.5 1"', '"5 6" skinCoordWeight="0.5 0.5"').encode(), "t"
    )
    assert mend(scene) == []
    assert any("(S04)" in line for line in mend(scene, also=["S04"]))
    (h,) = humanoids(scene)
    elbow, shoulder = h.joint("l_elbow"), h.joint("l_shoulder")
    assert dict(zip(elbow.skin_coord_index, elbow.skin_coord_weight)) == {5: 0.5, 6: 0.5, 7: 0.5}
    assert shoulder.skin_coord_weight[list(shoulder.skin_coord_index).index(7)] == 0.5


def test_normals_point_outward() -> None:
    """S08: new normals are unit and stand on the faces."""
    text = GOOD.replace(
        '<Coordinate USE="hanim_skin_coords" containerField="skinCoord"/>',
        '<Coordinate USE="hanim_skin_coords" containerField="skinCoord"/><Normal vector="1 0 0" '
        'containerField="skinNormal"/>',
    )
    scene = parse_x3d(text.encode(), "t.x3d")
    mend(scene)
    (h,) = humanoids(scene)
    assert h.skin_normal is not None
    np.testing.assert_allclose(np.linalg.norm(h.skin_normal, axis=1), 1)
    np.testing.assert_allclose(np.abs(h.skin_normal @ [0, 0, 1]), 1)  # the little skin is flat


def test_displacers_turn_with_the_pose() -> None:
    """P01 for a displacer of a joint: its directions are those that the pose has shown."""
    scene = parse_x3d(
        BULGE.replace('name="l_shoulder"', 'name="l_shoulder" rotation="1 0 0 1.5707963"').encode(), "t.x3d"
    )
    mend(scene)
    (h,) = humanoids(scene)
    np.testing.assert_allclose(h.displacers()[0].displacements, [[0, -1, 0], [0, -2, 0]], atol=1e-6)


REAL = [
    "JinNoAnimations_Fixed",
    "JinScaledV2L1LOA4Humanoid",
    "JoeKick",
    "DiamondManLOA2",
    "KoreanCharacterMotionAnnexD01Jin",
]


@pytest.mark.parametrize("name", REAL)
def test_real_files(shared: Path, name: str, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = read_x3d(shared / "data" / "hanim" / f"{name}.x3d")
    before = {f.rule for f in check(scene)}
    assert mend(scene) != []
    assert {f.rule for f in check(scene) if f.severity == "error"} < before
    assert mend(scene) == []
    mend(scene, also=["all"])
    first = written(scene, tmp_path / "a.x3d")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what has no repair is still said: a joint without a name
        again = read_x3d(tmp_path / "a.x3d")
        humanoids(again)
    assert {f.rule for f in check(again) if f.severity == "error"} <= {"N01", "F05"}
    assert mend(again, also=["all"]) == []
    assert written(again, tmp_path / "b.x3d") == first
