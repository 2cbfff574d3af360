"""The doctor: each rule fires on a figure broken in one way, and only there."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from scene_figure import GOOD, MOTION, VRML, broken, good, typed
from vitruvian.errors import FileError
from vitruvian.formats.vrml import parse_vrml, read_vrml
from vitruvian.formats.x3d import parse_x3d, read_x3d
from vitruvian.hanim.build import scene_of
from vitruvian.hanim.doctor import check, unreadable
from vitruvian.hanim.doctor_rules import RULES
from vitruvian.hanim.graph import Literal, Scene

SKIN_COORD = '<Coordinate USE="hanim_skin_coords" containerField="skinCoord"/>'
ROOT_JOINT = '<HAnimJoint USE="hanim_humanoid_root" containerField="joints"/>'
VL5_JOINT = '<HAnimJoint USE="hanim_vl5" containerField="joints"/>'
SITE = '<HAnimSite USE="hanim_navel_pt" containerField="sites"/>'
ELBOW = '<HAnimJoint DEF="hanim_l_elbow"'
FEED = '<ROUTE fromNode="Clock" fromField="fraction_changed" toNode="Turn" toField="set_fraction"/>'
ENDS = "</HAnimJoint></HAnimJoint></HAnimJoint>"
DISPLACER = '<HAnimDisplacer DEF="d" name="bulge_action" coordIndex="5 6" displacements="0 0 1 0 0 2"/>'

# rule, what stands in the good figure, what stands instead, a piece of the message
MUTATIONS = [
    ("F03", 'name="vl5"', 'name="vl5" centre="0 0 0"', "no field centre"),
    ("F07", '<component name="HAnim" level="1"/>', "", "without component HAnim"),
    ("V05", 'name="humanoid_root"', 'name="HumanoidRoot"', "the root is called HumanoidRoot"),
    ("D04", 'mass="3"', 'mass="-3"', "mass -3 is negative"),
    ("D04", 'mass="3"', 'momentsOfInertia="1 0 0 0 1 0 0 0 3"', "belongs to no solid"),
    ("D04", 'mass="3"', 'momentsOfInertia="1 0.5 0 0 1 0 0 0 1"', "not symmetric"),
    ("M11", 'keyValue="0 0 1 0 0 0 1 1', 'keyValue="0 0 1 0 0 0 1 0', "1 interpolators give the same value"),
    ("M19", 'loa="-1"', 'visible="false"', "visible is FALSE"),
    ("M19", "<HAnimHumanoid", "<Switch><HAnimHumanoid", "whichChoice -1"),
    ("M21", ELBOW, "<Shape><Box/></Shape>" + ELBOW, "1 shapes stand in joint l_shoulder"),
    ("F04", 'DEF="hanim_skin"', 'DEF="hanim_faces"', "given twice"),
    ("F05", 'USE="hanim_navel_pt"', 'USE="hanim_nabel_pt"', "USE hanim_nabel_pt has no DEF before it"),
    ("F06", ' containerField="skeleton"', "", "without containerField"),
    ("V01", 'version="2.0"', 'version="200x"', "X3D knows"),
    ("V04", 'name="l_elbow"', 'name="l_wrist"', "older names (l_wrist)"),
    ("N01", 'name="vl5" ', "", "nothing can address it"),
    ("N02", 'name="l_elbow"', 'name="l_ellbow"', "not standard though close"),
    ("N03", 'name="l_elbow"', 'name="tail"', "taken for an addition"),
    ("N04", 'name="l_elbow"', 'name="l_shoulder"', "2 joints are called l_shoulder"),
    ("N07", 'name="sacrum"', 'name="l_thigh"', "whose segment is sacrum"),
    ("N08", ' name="Tin"', "", "no name"),
    ("T01", 'name="humanoid_root"', 'name="sacroiliac"', "expected humanoid_root"),
    ("T02", 'name="vl5" center', 'name="l_hip" center', "l_shoulder hangs under l_hip"),
    ("T04", SITE, ROOT_JOINT.replace("joints", "skeleton") + SITE, "reached twice"),
    ("P01", 'center="0 1 0"', 'center="0 1 0" rotation="1 0 0 0.4"', "not at rest"),
    ("P02", 'center="0.2 1.1 0"', "", "no center (l_elbow)"),
    ("P03", ELBOW, '<HAnimJoint DEF="hanim_r_elbow" name="r_elbow" center="-0.3 1.1 0"/>' + ELBOW, "not mirror images"),
    ("P06", 'center="0 1 0"', 'center="0 1 nan"', "entry 2 is not a finite number"),
    ("P06", 'center="0 1 0"', 'center="0 1 0" scale="1 0 1"', "zero collapses"),
    ("P06", 'center="0 1 0"', 'center="0 1 0" limitOrientation="0 2 0 1"', "axis has length 2"),
    ("P06", "0.1 0.8 0 0.1", "0.1 inf 0 0.1", "point: entry 4 is not a finite number"),
    ("S01", '"1 0.5 0.5"', '"1 0.5"', "3 skinCoordIndex but 2 skinCoordWeight"),
    ("S02", '"4 5 6"', '"4 5 99"', "outside 0..7 (entry 2 is 99)"),
    ("S03", '"1 0.5 0.5"', '"1 0.5 0.4"', "do not sum to 1 (point 6: 0.9)"),
    ("S04", 'skinCoordIndex="0 1" skinCoordWeight="1 1"', 'skinCoordIndex="0" skinCoordWeight="1"', "1 of 8 skin"),
    ("S05", 'skinCoordIndex="0 1" skinCoordWeight="1 1"', 'skinCoordIndex="0 1" skinCoordWeight="1 -1"', "0..1"),
    ("S06", '"4 5 6"', '"4 5 5"', "1 vertices twice"),
    ("S08", SKIN_COORD, SKIN_COORD + '<Normal vector="0 0 1" containerField="skinNormal"/>', "1 vectors for 8 points"),
    ("S09", "4 5 6 7 -1", "4 5 6 8 -1", "outside 0..7 (entry 11: 8)"),
    ("S09", "4 5 6 7 -1", "4 5 6 7 -1 0 1 -1", "1 faces with fewer"),
    ("S09", 'coordIndex="0 1 2 3 -1"', 'coordIndex="0 1 2 9 -1"', "outside 0..3 (entry 3: 9)"),
    ("D01", ENDS, DISPLACER.replace("5 6", "5 60") + ENDS, "entry 1: 60"),
    ("D01", ENDS, DISPLACER.replace("5 6", "5") + ENDS, "2 displacem"),
    ("D05", 'llimit="-1 -1 -1"', 'llimit="-1 -1 2"', "llimit is above ulimit"),
    ("D05", 'llimit="-1 -1 -1"', 'llimit="-1 -1"', "expected 0 or 3"),
    ("M01", VL5_JOINT, "", "1 joints of the skeleton are not in joints (vl5)"),
    ("M02", VL5_JOINT, VL5_JOINT * 2, "1 joints are listed twice"),
    ("M03", VL5_JOINT, VL5_JOINT + '<HAnimJoint DEF="x" name="vl4" containerField="joints"/>', "(vl4)"),
    ("M04", SKIN_COORD, "", "skinCoord is missing"),
    ("M05", 'DEF="hanim_skin" containerField="skin"', 'containerField="metadata"', "skin is empty"),
    ("M07", 'toNode="hanim_l_shoulder"', 'toNode="l_shoulder"', "there is no DEF l_shoulder"),
    ("M07", 'fromField="value_changed"', 'fromField="set_fraction"', "the field is inputOnly"),
    ("M08", FEED, "", "nothing drives the fraction"),
    ("M09", 'cycleInterval="2"', 'cycleInterval="0"', "the clock never runs"),
    ("M09", 'cycleInterval="2"', 'enabled="false"', "nothing switches it on"),
    ("M09", 'loop="true"', 'loop="false"', "nothing starts it"),
    ("M10", 'key="0 0.5 1"', 'key="0 1"', "2 keys but 3 key values"),
    ("M10", 'key="0 0.5 1"', 'key="0 0.7 0.5"', "backwards"),
    ("M10", 'key="0 0.5 1"', 'key="0 0.5 2"', "outside 0..1"),
    ("M13", FEED, FEED + GOOD[GOOD.index('<ROUTE fromNode="Turn"') : GOOD.index("</Scene>")], "last writer wins"),
    ("M14", "</HAnimHumanoid>", MOTION.replace('enabled="true"', ""), "enabled is not given"),
    ("M14", "</HAnimHumanoid>", MOTION.replace('enabled="true"', 'enabled="false"'), "it stands still"),
    ("M15", "</HAnimHumanoid>", MOTION.replace(' 45"', '"'), "7 values are not a multiple of 4"),
    ("M15", "</HAnimHumanoid>", MOTION.replace(" vl5", ""), "2 groups of channels for 1 joints"),
    ("M16", "</HAnimHumanoid>", MOTION.replace('"humanoid_root', '"HumanoidRoot'), "joint HumanoidRoot"),
    ("M17", "</HAnimHumanoid>", MOTION.replace("0.1", "0"), "frameDuration 0"),
    ("M18", "</HAnimHumanoid>", MOTION.replace('values="0 0 0', 'values="0 96 0'), "further off than"),
]  # fmt: skip


def rules(scene: Scene) -> set[str]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the doctor reports by findings alone
        return {f.rule for f in check(scene)}


def test_nothing_is_wrong_with_the_good_figure() -> None:
    assert check(good()) == []
    assert rules(broken("</HAnimHumanoid>", MOTION)) == set()


@pytest.mark.parametrize(("rule", "old", "new", "message"), MUTATIONS, ids=[f"{m[0]}-{m[3][:20]}" for m in MUTATIONS])
def test_each_rule_finds_its_defect(rule: str, old: str, new: str, message: str) -> None:
    ends = ("</HAnimHumanoid>", "</HAnimHumanoid></Switch>") if "<Switch>" in new else ("", "")
    scene = parse_x3d(GOOD.replace(old, new, 1).replace(*ends).encode(), "tin.x3d")
    assert old in GOOD
    found = [f for f in check(scene) if f.rule == rule]
    assert found, sorted(rules(scene))
    finding = next(f for f in found if message in f.message)
    assert finding.severity == {"E": "error", "W": "warning", "N": "note"}[RULES[rule].severity]
    assert finding.line > 0
    assert finding.where


def test_every_error_rule_has_a_mutation() -> None:
    elsewhere = {"F02", "M06", "M12", "M20", "M22", "V02", "V03", "T03", "S07", "D02", "P04", "P05"}
    assert set(RULES) - {m[0] for m in MUTATIONS} <= elsewhere


def test_level_of_articulation() -> None:
    scene = broken('loa="-1"', 'loa="4"')
    assert "V02" not in rules(scene)  # a part of a body: whole-body rules need hips and head
    legs = "".join(f'<HAnimJoint name="{n}" DEF="{n}" center="0.1 0.8 0"/>' for n in ("l_hip", "r_hip", "skullbase"))
    whole = GOOD.replace('loa="-1"', 'loa="1"').replace(ELBOW, legs + ELBOW)
    found = {f.rule: f for f in check(parse_x3d(whole.encode(), "w.x3d"))}
    assert found["V02"].fix == "loa='0'"
    assert "11 of its joints are missing" in found["V02"].message
    found = {f.rule: f for f in check(parse_x3d(whole.replace('loa="1"', 'loa="0"').encode(), "w.x3d"))}
    assert "6 joints of higher levels" in found["V03"].message


def test_pose_and_size_of_a_whole_body() -> None:
    assert {f.rule for f in check(scene_of([typed(1)])[0])} == {"S03"}  # its weights do not sum to one, on purpose
    giant, airborne, tpose = typed(1), typed(1), typed(1)
    giant.scale = np.full(3, 100.0)
    for j in airborne.joints():
        j.center = j.center + [0, 3, 0]
    tpose.joint("l_radiocarpal").center = tpose.joint("l_shoulder").center + [0.5, 0, 0]
    for h, rule, message in (
        (giant, "P05", "measures 156 m: the units are not metres"),
        (airborne, "P05", "the ankles are 3.1 m above the ground"),
        (tpose, "P04", "the left arm is 90 degrees off the body"),
    ):
        found = {f.rule: f for f in check(scene_of([h])[0])}
        assert message in found[rule].message


def test_a_file_that_cannot_be_read_is_one_finding() -> None:
    finding = unreadable(FileError("x.x3d", 7, "mismatched tag"))
    assert (finding.rule, finding.severity, finding.line, finding.message) == ("F02", "error", 7, "mismatched tag")


def test_all_zero_and_no_weights() -> None:
    import re

    zero = re.sub(r'skinCoordWeight="[^"]*"', lambda m: re.sub(r"[\d.]+", "0", m[0]), GOOD)
    assert "S05" in rules(parse_x3d(zero.encode(), "z.x3d"))
    none = re.sub(r'\s*skinCoord(Weight|Index)="[^"]*"', "", GOOD)
    assert rules(parse_x3d(none.encode(), "n.x3d")) == {"M06"}


def test_cycles_are_found_not_followed() -> None:
    scene = good()
    elbow = scene.defs()["hanim_l_elbow"]
    from vitruvian.hanim.graph import Use

    elbow.fields["children"] = [Use("hanim_vl5", scene.defs()["hanim_vl5"], line=15)]
    assert {"F05", "T04"} <= rules(scene)


def test_prototypes_are_examined_too() -> None:
    scene = parse_vrml(VRML.encode(), "nobody.wrl")
    assert rules(scene) == {"P01"}
    assert "N01" in rules(parse_vrml(VRML.replace('name "l_hip"', "").encode(), "nobody.wrl"))


@pytest.mark.parametrize(
    "junk", ["", "1 2 3 4 5 6 7", "nan inf -inf 1e999", "a b c", '"x" "y"', "99999999999999999999", "-7"]
)
def test_bad_content_never_raises(junk: str) -> None:
    """Every number field of every node filled with rubbish, one at a time and all at once."""
    whole = broken("</HAnimHumanoid>", MOTION)
    for node in whole.walk():
        for field, value in node.fields.items():
            if isinstance(value, Literal) and field not in {"name", "version"}:
                node.fields[field] = Literal(junk, "xml", value.line)
                check(whole)
                node.fields[field] = value
    for node in whole.walk():
        for field, value in node.fields.items():
            if isinstance(value, Literal):
                node.fields[field] = Literal(junk, "xml", value.line)
    check(whole)


def test_findings_are_sorted_and_plain() -> None:
    scene = broken('"4 5 6"', '"4 5 99"')
    scene.defs()["hanim_vl5"].fields["center"] = np.array([0.0, np.nan, 0.0])
    found = check(scene)
    order = [("error", "warning", "note").index(f.severity) for f in found]
    assert order == sorted(order)
    assert all("\n" not in f.message for f in found)


REAL = {
    "HAnim2SpecificationLOA3Illustrated.x3d": (set(), set()),
    "JinLOA3.x3d": (set(), set()),
    "HAnimPrototypes.x3d": (set(), set()),
    "HAnimModelHandLeft.x3d": (set(), {"P02"}),
    "HAnim1SpecificationLOA3Invisible.x3d": (set(), {"V04"}),
    "DiamondManLOA0.x3d": (set(), {"V03"}),
    "DiamondManLOA2.x3d": (set(), {"V02", "V03"}),
    "KoreanCharacterMotionAnnexD01Jin.x3d": ({"M16"}, {"M14", "M18"}),
    "JinScaledV2L1LOA4Humanoid.x3d": ({"T04", "M01"}, set()),
    "JinNoAnimations_Fixed.x3d": ({"T04", "M02"}, set()),
    "JoeKick.x3d": ({"N01", "S01"}, {"S04", "V02"}),
    "Humanoid1NoSegSite.x3d": ({"S05"}, set()),
    "NancyPrototypes.wrl": (set(), {"M12"}),
    "sample1.wrl": ({"N01", "T01"}, set()),
}


@pytest.mark.parametrize("name", REAL)
def test_real_files(shared: Path, name: str) -> None:
    path = shared / "data" / "hanim" / name
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = (read_x3d if path.suffix == ".x3d" else read_vrml)(path)
    found = check(scene)
    errors, others = REAL[name]
    assert errors <= {f.rule for f in found if f.severity == "error"}
    assert others <= {f.rule for f in found if f.severity != "error"}
    if not errors:
        assert {f.rule for f in found if f.severity == "error"} == set()
