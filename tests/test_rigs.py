"""Names of foreign rigs: every table agrees with the standard, and common rigs are known."""

from __future__ import annotations

from pathlib import Path

import pytest

from vitruvian.errors import FileError, VitruvianError
from vitruvian.hanim import tables
from vitruvian.motion.rigs import hanim_names, own_names, rig

RIGS = ("vrm", "vrm0", "mixamo", "makehuman", "unreal")


@pytest.mark.parametrize("name", RIGS)
def test_tables_hold_joints_of_the_standard_once(name: str) -> None:
    joints = rig(name)["joints"]
    assert set(joints.values()) <= set(tables.joints()) and len(set(joints.values())) == len(joints)
    assert "humanoid_root" in joints.values() and {"l_shoulder", "r_knee", "skullbase"} <= set(joints.values())
    for joint in joints.values():
        if joint.startswith("l_"):
            assert "r_" + joint[2:] in joints.values()
    assert hanim_names(list(joints)) == list(joints.values()) or name == "vrm0"


def test_vrm_has_its_55_bones_and_two_ways_to_count_a_thumb() -> None:
    one, zero = rig("vrm")["joints"], rig("vrm0")["joints"]
    assert len(one) == len(zero) == 55
    assert one["leftThumbMetacarpal"] == zero["leftThumbProximal"] == "l_carpometacarpal_1"
    assert one["leftThumbProximal"] == zero["leftThumbIntermediate"] == "l_metacarpophalangeal_1"


def test_spelling_does_not_matter() -> None:
    names = ["mixamorig:Hips", "mixamorig:Spine", "mixamorig:Head", "mixamorig:LeftArm", "mixamorig:LeftUpLeg",
             "mixamorig:LeftLeg", "mixamorig:RightUpLeg", "mixamorig:RightLeg", "mixamorig:HeadTop_End"]  # fmt: skip
    found = ["humanoid_root", "vl5", "skullbase", "l_shoulder", "l_hip", "l_knee", "r_hip", "r_knee", None]
    for spell in (str, str.lower, lambda n: n.replace(":", "_"), lambda n: n.replace("mixamorig:", "")):
        assert hanim_names([spell(n) for n in names]) == found


def test_hanim_names_of_both_versions() -> None:
    old = [
        "HumanoidRoot",
        "sacroiliac",
        "l_hip",
        "l_knee",
        "l_ankle",
        "vl5",
        "skullbase",
        "l_shoulder",
        "l_elbow",
        "l_wrist",
    ]
    new = hanim_names(old)
    assert new[4] == "l_talocrural" and new[-1] == "l_radiocarpal" and new[0] == "humanoid_root" and None not in new
    assert hanim_names([f"hanim_{n}" for n in old]) == new


def test_other_rigs_by_their_words() -> None:
    rigify = ["DEF-spine", "DEF-spine.001", "DEF-spine.002", "DEF-spine.003", "DEF-neck", "DEF-head", "DEF-thigh.L",
              "DEF-shin.L", "DEF-foot.L", "DEF-upper_arm.L", "DEF-forearm.L", "DEF-hand.L", "DEF-thigh.R",
              "tail"]  # fmt: skip
    found = dict(zip(rigify, hanim_names(rigify)))
    assert found["DEF-shin.L"] == "l_knee" and found["DEF-forearm.L"] == "l_elbow" and found["tail"] is None
    assert found["DEF-spine.003"] == "vt6" and found["DEF-neck"] == "vc4" and found["DEF-head"] == "skullbase"
    assert hanim_names(["a", "b"]) == [None, None]


def test_own_table_wins(tmp_path: Path) -> None:
    names = list(rig("mixamo")["joints"])
    found = dict(zip(names, hanim_names(names, own_names({"Spine1": "vl1", "LeftHand": "l_wrist"}))))
    assert found["Spine1"] == "vl1" and found["LeftHand"] == "l_radiocarpal" and found["Spine2"] == "vt6"
    (tmp_path / "a.json").write_text('["l_hip"]')
    with pytest.raises(VitruvianError, match="bone"):
        own_names(tmp_path / "a.json")
    (tmp_path / "a.json").write_text("{")
    with pytest.raises(FileError, match="JSON"):
        own_names(tmp_path / "a.json")
