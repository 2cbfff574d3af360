"""VRM: bones, terms of use and expressions out; bones, terms and morphs of both versions in."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vitruvian as vt
from gltf_maker import BONES, Foreign
from gltf_player import Player
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.rotations import inverse
from vitruvian.errors import VitruvianError
from vitruvian.formats.vrm_pose import REQUIRED, t_turns, vrm_bones
from vitruvian.formats.vrm_tables import UNITS, expressions, meta_of
from vitruvian.hanim.humanoid import Humanoid, Joint
from vitruvian.motion.rigs import rig
from vitruvian.motion.turns import local_rotations


@pytest.fixture(scope="module")
def person() -> Humanoid:
    return vt.person(gender=0.0, age=40)


@pytest.fixture(scope="module")
def written(person: Humanoid, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    path = tmp_path_factory.mktemp("vrm") / "a.vrm"
    return path, vt.save(person, path)


def test_file_says_what_vrm_wants(written: tuple[Path, dict], person: Humanoid) -> None:
    path, report = written
    player = Player(path)
    extension = player.json["extensions"]["VRMC_vrm"]
    assert player.json["extensionsUsed"] == ["VRMC_vrm"] and extension["specVersion"] == "1.0"
    bones = {b: player.nodes[e["node"]]["name"] for b, e in extension["humanoid"]["humanBones"].items()}
    assert set(REQUIRED) <= set(bones) and len(REQUIRED) == 15 and report["bones"] == len(bones) == 55
    assert bones["hips"] == "humanoid_root" and bones["spine"] == "vl5" and bones["leftHand"] == "l_radiocarpal"
    assert len(set(bones.values())) == len(bones)
    parent = {c: i for i, n in enumerate(player.nodes) for c in n.get("children", [])}
    above = {}
    for bone, entry in extension["humanoid"]["humanBones"].items():
        node, path_up = entry["node"], []
        while (node := parent.get(node, -1)) >= 0:
            path_up.append(player.nodes[node]["name"])
        above[bone] = path_up
    order = ("hips", "spine", "chest", "upperChest", "neck", "head", "leftEye")
    for a, b in zip(order, order[1:]):
        assert bones[a] in above[b], (a, b)
    assert bones["upperChest"] in above["leftShoulder"] and bones["hips"] in above["rightUpperLeg"]
    assert not any("scale" in n for n in player.nodes) and "animations" not in player.json
    meta = extension["meta"]
    assert meta["licenseUrl"] == "https://vrm.dev/licenses/1.0/" and meta["authors"] == ["unknown"]
    assert meta["avatarPermission"] == "onlyAuthor" and meta["allowRedistribution"] is False
    assert any("author" in line for line in report["lost"])


def test_rest_pose_is_the_t_of_vrm(written: tuple[Path, dict]) -> None:
    player = Player(written[0])
    world, _ = player.worlds(0)
    bones = player.json["extensions"]["VRMC_vrm"]["humanoid"]["humanBones"]
    at = {b: world[e["node"]][:3, 3] for b, e in bones.items()}
    for n in player.nodes:
        assert "rotation" not in n or n["extras"]["hanim"]["node"] in ("Site", "Viewpoint")
    way = lambda a, b: (at[b] - at[a]) / np.linalg.norm(at[b] - at[a])  # noqa: E731
    for side, sign in (("left", 1), ("right", -1)):
        for a, b in (("UpperArm", "LowerArm"), ("LowerArm", "Hand"), ("Hand", "MiddleProximal"),
                     ("IndexProximal", "IndexIntermediate"), ("LittleIntermediate", "LittleDistal")):  # fmt: skip
            assert np.abs(way(side + a, side + b) - [sign, 0, 0]).max() < 1e-5, (side, a)
        thumb = way(f"{side}ThumbMetacarpal", f"{side}ThumbProximal")
        assert np.abs(thumb - np.array([sign, 0, 1]) / np.sqrt(2)).max() < 1e-5
        across = way(f"{side}LittleProximal", f"{side}IndexProximal")
        assert abs(across[1]) < 0.02 and across[2] > 0.9  # palms down, thumbs ahead
        assert way(f"{side}UpperLeg", f"{side}Foot")[1] < -0.98
    vertices = player.vertices(0)
    assert abs(vertices[:, 1].min()) < 0.01
    assert np.ptp(vertices[:, 0]) == pytest.approx(np.ptp(vertices[:, 1]), rel=0.1)  # span of the arms and stature


def test_arms_go_back_to_where_they_were(written: tuple[Path, dict], person: Humanoid) -> None:
    """A player that lowers the arms shows our rest pose, but for what four influences cost."""
    path, report = written
    ours, back = vt.pack(person), vt.pack(vt.load(path))
    used = np.unique(ours.skin.triangles)
    s = back.skeleton
    turns = t_turns(ours.skeleton, vrm_bones(ours.skeleton))
    local = local_rotations(ours.skeleton.parents, inverse(turns)[None])[0]
    rotation = local[[ours.skeleton.index[n] for n in s.names]][None]
    assert np.abs(s.centers[s.index["l_radiocarpal"]][0]) > 0.5  # a T it is
    moved = joint_matrices(s, vt.Motion(s, 30, rotation, np.zeros((1, 3))))[0]
    p = np.concatenate([back.skin.rest, np.ones((len(back.skin.rest), 1))], -1)
    w = back.skin.weights
    shown = np.zeros_like(back.skin.rest)
    np.add.at(shown, w.vertex, w.weight[:, None] * np.einsum("nab,nb->na", moved[w.joint][:, :3], p[w.vertex]))
    apart = np.linalg.norm(shown - ours.skin.rest[used], axis=1)
    assert apart.max() < report["rest_error_m"] + 1e-4 < 0.04 and np.percentile(apart, 80) < 1e-5


def test_expressions_of_the_person(written: tuple[Path, dict]) -> None:
    path, report = written
    player = Player(path)
    said = player.json["extensions"]["VRMC_vrm"]["expressions"]["preset"]
    names = player.json["meshes"][0]["extras"]["targetNames"]
    assert set(report["expressions"]) == set(said) and "relaxed" not in said
    assert {"aa", "ih", "ou", "ee", "oh", "blink", "happy", "angry", "sad", "surprised"} <= set(said)
    blink = {names[b["index"]]: b["weight"] for b in said["blink"]["morphTargetBinds"]}
    assert blink == {"l_eye_blink_action": 1, "r_eye_blink_action": 1}
    for preset in said.values():
        for bind in preset["morphTargetBinds"]:
            assert player.nodes[bind["node"]]["name"] == "body" and 0 < bind["weight"] <= 1


def test_expressions_need_all_their_units() -> None:
    assert expressions(["l_eye_blink_action"], 3)["preset"].keys() == {"blinkLeft"}
    assert expressions(["eyeBlinkLeft", "eyeBlinkRight", "jawOpen"], 3)["preset"].keys() == {
        "blink", "blinkLeft", "blinkRight", "aa"
    }  # fmt: skip
    assert expressions(["nose"], 0) == {}
    own = expressions(["relaxed_action", "l_eye_blink"], 1)["preset"]["relaxed"]["morphTargetBinds"]
    assert own == [{"node": 1, "index": 0, "weight": 1.0}]
    from vitruvian.modeling.person import action_name

    units = {u.removeprefix("*_").removeprefix("l_").removeprefix("r_") for d in UNITS.values() for u in d}
    known = {action_name(u).removesuffix("_action").removeprefix("l_") for u in _arkit()}
    assert units <= known


def _arkit() -> list[str]:
    from vitruvian.modeling import source

    return list(source.manifest()["faces"])


def test_terms_come_from_info() -> None:
    info = {
        "authorName": "A, B", "copyright": "(c) B", "usageRestrictions": "ask", "avatarPermission": "everyone",
        "commercialUsage": "all of it", "allowRedistribution": "true", "authorEmail": "b@example.org",
    }  # fmt: skip
    meta, lost = meta_of("b", info)
    assert meta["authors"] == ["A", "B"] and meta["copyrightInformation"] == "(c) B; usage: ask" and not lost
    assert meta["avatarPermission"] == "everyone" and meta["commercialUsage"] == "personalNonProfit"
    assert meta["allowRedistribution"] is True and meta["allowAntisocialOrHateUsage"] is False
    assert meta["contactInformation"] == "b@example.org"


def test_bodies_that_vrm_can_not_hold(tmp_path: Path, person: Humanoid) -> None:
    lame = replace(vt.person(loa=1))
    for j in lame.joints():
        j.joints = [c for c in j.joints if c.name not in ("l_knee", "r_elbow")]
    with pytest.raises(VitruvianError, match="leftLowerLeg .l_knee., leftFoot .*rightLowerArm .r_elbow."):
        vt.save(lame, tmp_path / "a.vrm")
    with pytest.raises(VitruvianError, match="surface"):
        vt.save(replace(person, skin=[]), tmp_path / "a.vrm")
    with pytest.raises(VitruvianError, match="mesh"):
        vt.save(vt.Mesh(np.eye(3), np.array([[0, 1, 2]])), tmp_path / "a.vrm")
    assert not list(tmp_path.glob("*.vrm"))


@pytest.mark.parametrize("loa", [1, 2, 3])
def test_lower_levels_have_fewer_bones(tmp_path: Path, loa: int) -> None:
    report = vt.save(vt.person(loa=loa), tmp_path / "a.vrm")
    bones = Player(tmp_path / "a.vrm").json["extensions"]["VRMC_vrm"]["humanoid"]["humanBones"]
    assert set(REQUIRED) <= set(bones) and ("chest" in bones) == (loa > 1) and ("upperChest" in bones) == (loa > 1)
    assert report["bones"] == {1: 17, 2: 55, 3: 55}[loa] or report["bones"] == len(bones)


@pytest.mark.filterwarnings("ignore::vitruvian.errors.VitruvianWarning")
def test_khronos_validator_on_vrm(written: tuple[Path, dict], tmp_path: Path, shared: Path, referee: Path) -> None:
    files = [written[0]]
    for name in ("JinLOA3.x3d", "JinNoAnimations_Fixed.x3d"):
        files.append(tmp_path / f"{name}.vrm")
        report = vt.save(vt.load(shared / "data" / "hanim" / name), files[-1])
        height = np.ptp(Player(files[-1]).vertices(0)[:, 1])
        assert 1.2 < height < 2.2 and report["bones"] >= 50, name
    validated(files, referee)


def validated(files: list[Path], referee: Path) -> None:
    """The Khronos validator has nothing to say but that it does not know VRM's extension."""
    import os
    import shutil
    import subprocess

    script = Path(__file__).with_name("referee_gltf.mjs")
    done = subprocess.run(
        [shutil.which("node") or "node", str(script), *map(str, files)], capture_output=True, text=True, timeout=60,
        env={**os.environ, "REFEREE": str(referee)},
    )  # fmt: skip
    reports = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(reports) == len(files), done.stderr
    for r in reports:
        said = [m for m in r["messages"] if not m.startswith("NODE_EMPTY")]  # bones of a motion hold nothing
        assert not r["errors"] and not r["warnings"] and len(said) == 1 and "VRMC_vrm" in said[0], r


# reading


def vrm_file(path: Path, version: int) -> Path:
    """A VRM of somebody else: bones of any name, a face with two morphs, terms of use."""
    rig_ = Foreign("x_")
    m = rig_.maker
    for k, i in enumerate(rig_.bone.values()):
        m.json["nodes"][i]["name"] = f"J_{k}"
    table = {joint: bone for bone, joint in rig("vrm" if version else "vrm0")["joints"].items()}
    bones = {table[j]: rig_.bone[n] for j, n, _ in BONES if j in table}
    mesh = m.json["meshes"][0]
    count = m.json["accessors"][mesh["primitives"][0]["attributes"]["POSITION"]]["count"]
    for primitive in mesh["primitives"]:
        primitive["targets"] = [
            {"POSITION": m.sparse(count, np.arange(120 + 24 * k, 144), np.tile([0, 0, 1.0 + k], (24 - 24 * k, 1)))}
            for k in (0,)
        ]
    mesh["extras"] = {"targetNames": ["Fcl_MTH_A"]}
    if version:
        m.json["extensions"] = {"VRMC_vrm": {
            "specVersion": "1.0", "humanoid": {"humanBones": {b: {"node": i} for b, i in bones.items()}},
            "meta": {"name": "Mia", "authors": ["Me", "You"], "licenseUrl": "x", "avatarPermission": "everyone"},
            "expressions": {"preset": {"aa": {"morphTargetBinds": [{"node": rig_.node, "index": 0, "weight": 1}]}}},
        }}  # fmt: skip
    else:  # figures of version 0 look along -Z
        away = m.put("nodes", {"name": "all", "rotation": [0, 1, 0, 0], "children": [rig_.root]})
        m.json["scenes"][0]["nodes"] = [away, rig_.node]
        m.json["extensions"] = {"VRM": {
            "humanoid": {"humanBones": [{"bone": b, "node": i} for b, i in bones.items()]},
            "meta": {"title": "Mia", "author": "Me", "allowedUserName": "Everyone", "violentUssageName": "Disallow",
                     "licenseName": "CC_BY"},
            "blendShapeMaster": {"blendShapeGroups": [
                {"presetName": "a", "binds": [{"mesh": 0, "index": 0, "weight": 100}]},
            ]},
        }}  # fmt: skip
    return m.glb(path)


@pytest.mark.parametrize("version", [0, 1])
def test_vrm_of_others(tmp_path: Path, version: int) -> None:
    h = vt.load(vrm_file(tmp_path / "a.vrm", version))
    assert h.name == "Mia" and h.info["avatarPermission"] == "everyone"
    assert h.info["authorName"] == ("Me, You" if version else "Me")
    assert {j.name for j in h.joints()} == {j for j, _, _ in BONES}
    centers = {j.name: j.center for j in h.joints()}
    rig_ = Foreign()
    assert max(np.abs(centers[j] - c).max() for (j, _, _), c in zip(BONES, rig_.centers)) < 1e-5
    assert [(j.name, d.name) for j in h.joints() for d in j.displacers] == [("skullbase", "aa_action")]


def test_vrm_comes_out_as_it_went_in(tmp_path: Path) -> None:
    """Another program's VRM, through us and back: bones, author, terms, expression; a T pose is not turned."""
    h = vt.load(vrm_file(tmp_path / "a.vrm", 1))
    report = vt.save(h, tmp_path / "b.vrm")
    said = Player(tmp_path / "b.vrm").json["extensions"]["VRMC_vrm"]
    assert said["meta"]["name"] == "Mia" and said["meta"]["authors"] == ["Me", "You"]
    assert said["meta"]["avatarPermission"] == "everyone" and list(said["expressions"]["preset"]) == ["aa"]
    g = vt.load(tmp_path / "b.vrm")
    a, b = {j.name: j.center for j in h.joints()}, {j.name: j.center for j in g.joints()}
    legs = [n for n in a if "shoulder" not in n and not any(w in n for w in ("elbow", "carp", "phal"))]
    assert max(np.abs(a[n] - b[n]).max() for n in legs) < 1e-5 and report["rest_error_m"] < 1e-6


def test_bones_above_the_root_are_left_out(tmp_path: Path) -> None:
    """Many figures have a bone on the floor that holds the hips and moves no vertex."""
    path = vrm_file(tmp_path / "a.vrm", 1)
    from gltf_maker import Maker

    player = Player(path)
    m = Maker()
    m.json, m.bin = player.json, bytearray(player.bin)
    skin = m.json["skins"][0]
    inverse = player.read(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    armature = 0
    skin["joints"] = [*skin["joints"], armature]
    skin["inverseBindMatrices"] = m.add(np.concatenate([inverse, np.diag([100.0, 100, 100, 1])[None]]))
    h = vt.load(m.glb(tmp_path / "b.vrm"))
    assert [j.name for j in h.skeleton] == ["humanoid_root"] and len(h.joints()) == len(BONES)


def test_a_joint_alone_is_no_vrm(tmp_path: Path) -> None:
    with pytest.raises(VitruvianError, match="surface"):
        vt.save(Humanoid("a", skeleton=[Joint("humanoid_root")]), tmp_path / "a.vrm")


def test_a_figure_in_t_pose_walks_with_hanging_arms(written: tuple[Path, dict], person: Humanoid) -> None:
    """The gait puts hands and elbows where it puts those of the same body at the standard's rest pose."""
    from vitruvian.body.kinematics import joint_positions

    places = []
    for humanoid in (person, vt.load(written[0])):
        s = vt.pack(humanoid).skeleton
        found = joint_positions(s, joint_matrices(s, vt.walk(s)))
        root = found[:, s.index["vt1"]]
        places.append([found[:, s.index[n]] - root for n in ("l_elbow", "l_radiocarpal", "r_elbow", "r_radiocarpal")])
    apart = np.linalg.norm(np.array(places[0]) - np.array(places[1]), axis=-1)
    assert apart.max() < 0.04 and (np.array(places[1])[[1, 3], :, 1] < -0.35).all()


def test_commands_say_what_a_motion_is_not(written: tuple[Path, dict], shared: Path) -> None:
    from test_cli import fails

    vrma = shared / "data" / "motion" / "chatvrm_idle_loop.vrma"
    assert "to pose" in fails("pose", vrma, "--joints", '{"l_knee": [1, 0, 0, 1]}')
    assert "doctor" in fails("check", vrma)
