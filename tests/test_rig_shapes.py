"""Rigs of other makers, wholly known by their names or, when nobody knows the names, by their shape."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from skeletons import figure, posed_rest, renamed
from vitruvian.body.rotations import from_axis_angle, inverse, multiply
from vitruvian.body.types import Skeleton
from vitruvian.cli import app
from vitruvian.errors import VitruvianError
from vitruvian.formats.bvh import write_bvh
from vitruvian.motion.guess import guessed
from vitruvian.motion.names import match
from vitruvian.motion.retarget import retarget
from vitruvian.motion.turns import world_rotations
from vitruvian.motion.types import Motion

# humanoid_root, two of the trunk, neck, head; then for each side: collar, arm, forearm, hand, thigh, shin, foot, toes
JOINTS = ("humanoid_root", "vl5", "vt6", "vc4", "skullbase")
LIMBS = ("sternoclavicular", "shoulder", "elbow", "radiocarpal", "hip", "knee", "talocrural", "metatarsophalangeal_2")
RIGS = {  # middle, limbs, how a side is written
    "mixamo": ("Hips Spine Spine2 Neck Head", "Shoulder Arm ForeArm Hand UpLeg Leg Foot ToeBase", "mixamorig:{S}{}"),
    "mixamo in Blender": (
        "Hips Spine Spine2 Neck Head",
        "Shoulder Arm ForeArm Hand UpLeg Leg Foot ToeBase",
        "mixamorig_{S}{}",
    ),
    "rigify": (
        "spine spine.001 spine.003 spine.004 spine.006",
        "shoulder upper_arm forearm hand thigh shin foot toe",
        "DEF-{}.{L}",
    ),
    "biped": ("Pelvis Spine Spine1 Neck Head", "Clavicle UpperArm Forearm Hand Thigh Calf Foot Toe0", "Bip01 {L} {}"),
    "makehuman": (
        "root spine05 spine01 neck01 head",
        "clavicle upperarm01 lowerarm01 wrist upperleg01 lowerleg01 foot toe1-1",
        "{}.{L}",
    ),
    "smpl": ("pelvis spine1 spine3 neck head", "collar shoulder elbow wrist hip knee ankle foot", "{s}_{}"),
    "vrm": ("hips spine chest neck head", "Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot Toes", "{s}{}"),
    "vroid": (
        "Hips Spine Chest Neck Head",
        "Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot ToeBase",
        "J_Bip_{L}_{}",
    ),
    "cmu": ("root lowerback thorax upperneck head", "clavicle humerus radius wrist femur tibia foot toes", "{l}{}"),
    "opensim": ("pelvis lumbar torso neck head", "clavicle humerus ulna hand femur tibia talus toes", "{}_{l}"),
    "motionbuilder": (
        "Hips Spine Spine1 Neck Head",
        "Shoulder Arm ForeArm Hand UpLeg Leg Foot ToeBase",
        "Character1_{S}{}",
    ),
}
# the middle of the body: the same prefix, no side
MIDDLE = {"mixamo": "mixamorig:", "mixamo in Blender": "mixamorig_", "rigify": "DEF-", "biped": "Bip01 ",
          "vroid": "J_Bip_C_", "motionbuilder": "Character1_"}  # fmt: skip
RESTS = {
    "T": {"l_shoulder": [0, 0, 1, np.pi / 2], "r_shoulder": [0, 0, 1, -np.pi / 2]},
    "A": {"l_shoulder": [0, 0, 1, np.pi / 4], "r_shoulder": [0, 0, 1, -np.pi / 4]},
}


def names_of(rig: str) -> dict[str, str]:
    """{H-Anim joint: name in that rig}"""
    middle, limbs, form = RIGS[rig]
    out = {h: MIDDLE.get(rig, "") + n for h, n in zip(JOINTS, middle.split())}
    for s in ("left", "right"):
        for h, n in zip(LIMBS, limbs.split()):
            out[f"{s[0]}_{h}"] = form.format(n, s=s, S=s.title(), l=s[0], L=s[0].upper())
    return out


def small(skeleton: Skeleton) -> Skeleton:
    """Only the joints that every rig has."""
    keep = [j for j, n in enumerate(skeleton.names) if n in {*JOINTS, *(f"{s}_{n}" for s in "lr" for n in LIMBS)}]
    parents = []
    for j in keep:
        p = int(skeleton.parents[j])
        while p >= 0 and p not in keep:
            p = int(skeleton.parents[p])
        parents.append(-1 if p < 0 else keep.index(p))
    return Skeleton(tuple(skeleton.names[j] for j in keep), np.array(parents), skeleton.centers[keep])


def clip(skeleton: Skeleton) -> Motion:
    rng = np.random.default_rng(3)
    axes = rng.normal(size=(20, len(skeleton), 3))
    turn = from_axis_angle(np.concatenate([axes, np.full((20, len(skeleton), 1), 0.3)], -1))
    return Motion(skeleton, 30, turn, np.zeros((20, 3)))


def turned(skeleton: Skeleton, rest: str, names: dict[str, str]) -> tuple[Motion, np.ndarray]:
    """A clip on that rig in that rest pose, and the world rotations that the H-Anim body must show."""
    truth = clip(skeleton)
    world = world_rotations(skeleton.parents, truth.rotation)
    pose = np.tile([0.0, 0.0, 0.0, 1.0], (1, len(skeleton), 1))
    for n, turn in RESTS[rest].items():
        pose[0, skeleton.index[n]] = from_axis_angle(turn)
    offset = world_rotations(skeleton.parents, pose)
    theirs = multiply(world, inverse(offset))
    local = theirs.copy()
    for j, p in enumerate(skeleton.parents):
        if p >= 0:
            local[:, j] = multiply(inverse(theirs[:, p]), theirs[:, j])
    return Motion(renamed(posed_rest(skeleton, RESTS[rest]), names), 30, local, np.zeros((20, 3))), world


def wrong(a: np.ndarray, b: np.ndarray) -> float:
    dot = np.abs(np.sum(a * b, axis=-1))
    return float(np.degrees(2 * np.arccos(np.clip(dot, 0, 1))).max())


@pytest.mark.parametrize("rest", RESTS)
@pytest.mark.parametrize("rig", RIGS)
def test_every_rig_is_known_wholly_and_moves_the_body(rig: str, rest: str) -> None:
    skeleton, names = small(figure(3)), names_of(rig)
    source, world = turned(skeleton, rest, names)
    found = match(source.skeleton.names)
    assert set(found) == set(names.values())
    out = retarget(source, skeleton, feet=False)
    assert not any("not matched" in n for n in out.notes)
    got = world_rotations(skeleton.parents, out.rotation)
    for side in "lr":
        for part in ("hip", "knee", "talocrural", "shoulder", "radiocarpal"):
            j = skeleton.index[f"{side}_{part}"]
            assert wrong(got[:, j], world[:, j]) < 0.1, (rig, rest, side, part)


@pytest.mark.parametrize("rest", RESTS)
@pytest.mark.parametrize("loa", [1, 2, 3])
def test_names_nobody_knows(rest: str, loa: int) -> None:
    """Without a single known name, limbs are found by where they are, and on the right side; a table wins."""
    plain = figure(loa)
    strange = renamed(posed_rest(plain, RESTS[rest]), {})
    found = guessed(strange)
    by = {h: plain.names[strange.index[n]] for n, h in found.items() if h not in ("spine", "neck")}
    for side in "lr":
        for part in ("hip", "knee", "talocrural", "shoulder", "elbow", "radiocarpal"):
            assert by[f"{side}_{part}"] == f"{side}_{part}"
    assert by["skullbase"] == "skullbase"
    small_one = small(figure(3))
    source, world = turned(small_one, rest, {})
    out = retarget(source, small_one, feet=False)
    assert any("matched by the shape" in n for n in out.notes)
    got = world_rotations(small_one.parents, out.rotation)
    for name in ("l_knee", "r_talocrural", "l_shoulder", "r_radiocarpal"):
        j = small_one.index[name]
        assert wrong(got[:, j], world[:, j]) < 0.1
    knee = source.skeleton.names[small_one.index["l_knee"]]
    assert "l_knee" not in " ".join(retarget(source, small_one, names={knee: "l_knee"}, feet=False).notes)


def test_a_figure_that_faces_the_other_way_keeps_its_sides() -> None:
    plain = figure(2)
    half = np.array([-1.0, 1.0, -1.0])
    back = Skeleton(tuple(f"b{i}" for i in range(len(plain))), plain.parents, plain.centers * half)
    found = {h: int(n[1:]) for n, h in guessed(back).items()}
    assert plain.names[found["l_knee"]] == "l_knee" and plain.names[found["r_elbow"]] == "r_elbow"


def test_what_is_no_figure_is_no_figure() -> None:
    rng = np.random.default_rng(5)
    for n in (1, 2, 9, 60):
        parents = np.array([-1, *(int(rng.integers(0, j)) for j in range(1, n))])
        guessed(Skeleton(tuple(f"b{i}" for i in range(n)), parents, np.zeros((n, 3))))
        guessed(Skeleton(tuple(f"b{i}" for i in range(n)), parents, rng.normal(size=(n, 3))))
    line = Skeleton(("a", "b"), np.array([-1, 0]), np.array([[0, 0, 0], [0, 1.0, 0]]))
    with pytest.raises(VitruvianError, match="hips"):
        retarget(Motion(line, 30, clip(line).rotation, np.zeros((20, 3))), figure(2))


def test_exchanged_sides_are_found() -> None:
    skeleton = small(figure(3))
    names = names_of("mixamo")
    crossed = {h: names[{"l_": "r_", "r_": "l_"}.get(h[:2], h[:2]) + h[2:]] for h in names}
    source, _ = turned(skeleton, "T", crossed)
    assert any("exchanged" in n for n in retarget(source, skeleton, feet=False).notes)
    own = {n: {"l_": "r_", "r_": "l_"}.get(h[:2], h[:2]) + h[2:] for h, n in names.items()}
    source, _ = turned(skeleton, "T", names)
    with pytest.raises(VitruvianError, match="exchange l_ and r_"):
        retarget(source, skeleton, names=own, feet=False)
    right, _ = turned(skeleton, "A", names)
    assert not any("exchanged" in n for n in retarget(right, skeleton, feet=False).notes)


def test_animate_takes_a_table_of_names(tmp_path: Path) -> None:
    skeleton = small(figure(3))
    source, _ = turned(skeleton, "T", {})
    write_bvh(source, tmp_path / "strange.bvh")
    table = {n: h for n, h in zip(source.skeleton.names, skeleton.names)}
    (tmp_path / "names.json").write_text(json.dumps(table))
    words = ["animate", "person", str(tmp_path / "strange.bvh"), "-o", str(tmp_path / "out.bvh"), "--up", "y"]
    done = CliRunner().invoke(app, [*words, "--names", str(tmp_path / "names.json")])
    assert done.exit_code == 0, done.output
    (tmp_path / "names.json").write_text(json.dumps({**table, source.skeleton.names[1]: "humanoid_root"}))
    done = CliRunner().invoke(app, [*words, "--names", str(tmp_path / "names.json")])
    assert done.exit_code != 0 and "two joints" in str(done.exception)
