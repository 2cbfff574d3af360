"""Retargeting: known answers, other rest poses, other proportions, real clips."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skeletons import figure, posed_rest, renamed, scaled_legs
from vitruvian.body.rotations import from_axis_angle, from_vector, inverse, multiply, rotate
from vitruvian.body.types import Skeleton
from vitruvian.errors import VitruvianError
from vitruvian.formats.bvh import read_bvh, write_bvh
from vitruvian.motion.contacts import floor_penetration_mm, foot_slide_mm, legs, runs, sole_points, standing
from vitruvian.motion.gait import walk
from vitruvian.motion.legs import REACH, compose, heading, two_bone
from vitruvian.motion.names import match
from vitruvian.motion.retarget import retarget
from vitruvian.motion.turns import local_rotations, positions, twist, world_rotations
from vitruvian.motion.types import Motion

MIXAMO = {
    "humanoid_root": "mixamorig:Hips",
    "vl5": "mixamorig:Spine",
    "vl1": "mixamorig:Spine1",
    "vt6": "mixamorig:Spine2",
    "vc4": "mixamorig:Neck",
    "skullbase": "mixamorig:Head",
}
for _side, _word in (("l", "Left"), ("r", "Right")):
    for _joint, _name in (
        ("sternoclavicular", "Shoulder"),
        ("shoulder", "Arm"),
        ("elbow", "ForeArm"),
        ("radiocarpal", "Hand"),
        ("hip", "UpLeg"),
        ("knee", "Leg"),
        ("talocrural", "Foot"),
        ("metatarsophalangeal_2", "ToeBase"),
        ("carpometacarpal_1", "HandThumb1"),
        ("metacarpophalangeal_2", "HandIndex1"),
        ("metacarpophalangeal_3", "HandMiddle1"),
    ):
        MIXAMO[f"{_side}_{_joint}"] = f"mixamorig:{_word}{_name}"


def lively(skeleton: Skeleton, frames: int = 30, size: float = 0.5, seed: int = 1) -> Motion:
    """Every joint turns; the root wanders."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 2 * np.pi, frames)[:, None, None]
    turns = rng.normal(0, size, (1, len(skeleton), 3)) * np.sin(time + rng.uniform(0, 6, (1, len(skeleton), 3)))
    return Motion(skeleton, 30, from_vector(turns), rng.normal(0, 0.01, (frames, 3)))


def world(motion: Motion):
    return world_rotations(motion.skeleton.parents, motion.rotation)


def places(motion: Motion):
    return positions(
        motion.skeleton.parents, motion.skeleton.centers, world(motion), motion.translation, motion.joint_translation
    )


def degrees(a, b):
    """Angle between rotations; from the vector part, so that small ones are exact."""
    q = multiply(inverse(a), b)
    return np.degrees(2 * np.arctan2(np.linalg.norm(q[..., :3], axis=-1), np.abs(q[..., 3])))


@pytest.mark.parametrize("loa", [1, 3, 4])
def test_own_skeleton_on_itself(loa):
    motion = lively(figure(loa))
    out = retarget(motion, figure(loa), feet=False)
    assert degrees(out.rotation, motion.rotation).max() < 0.05
    assert np.abs(out.translation - motion.translation).max() < 1e-6


def test_own_walk_on_itself_with_feet():
    motion = walk(figure(3), fps=60, cycles=2)
    out = retarget(motion, figure(3))
    knee = motion.skeleton.index["l_knee"]
    change = degrees(out.rotation[:, knee], motion.rotation[:, knee])
    assert np.median(change) < 1.5 and np.quantile(change, 0.9) < 4  # a straight knee bends ten degrees for 4 mm
    index, shift = motion.skeleton.index, np.linalg.norm(places(out) - places(motion), axis=-1)
    assert shift[:, index["vt1"]].max() < 0.02
    assert max(shift[:, index[f"{side}_talocrural"]].max() for side in "lr") < 0.02


REST = {
    "T": {"l_shoulder": [0, 0, 1, np.pi / 2], "r_shoulder": [0, 0, 1, -np.pi / 2]},
    "A": {
        "l_shoulder": [0, 0, 1, np.radians(45)],
        "r_shoulder": [0, 0, 1, -np.radians(45)],
        "l_hip": [0, 0, 1, np.radians(12)],
        "r_hip": [0, 0, 1, -np.radians(12)],
    },
}


@pytest.mark.parametrize("rest", REST)
def test_rest_pose_does_not_matter(rest):
    """The same bones at rest in T and A: limbs must have the true world orientation of the figure that moved.

    Truth: the clip is made on the standard rest pose; for the other rest pose each world rotation W becomes W P^-1 with
    P the turn of the rest pose, which leaves every bone where it was.
    """
    standard = figure(3)
    truth = lively(standard, size=0.4)
    rotation = truth.rotation.copy()
    # trunk, feet and hands at ease: their rest frames are conventions, tested elsewhere
    for j, name in enumerate(standard.names):
        if not name.startswith(
            ("humanoid_root", "l_shoulder", "r_shoulder", "l_elbow", "r_elbow", "l_hip", "r_hip", "l_k")
        ):
            rotation[:, j] = [0, 0, 0, 1]
    truth = Motion(standard, 30, rotation, truth.translation)
    other = posed_rest(standard, REST[rest])
    pose = np.tile([0.0, 0, 0, 1], (1, len(standard), 1))
    for name, turn in REST[rest].items():
        pose[0, standard.index[name]] = from_axis_angle(turn)
    there = world_rotations(standard.parents, pose)
    carried = local_rotations(standard.parents, multiply(world(truth), inverse(there)))
    source = Motion(renamed(other, MIXAMO), 30, carried, truth.translation)
    assert np.abs(places(source) - places(truth)).max() < 1e-9  # the two clips really show the same
    out = retarget(source, standard, feet=False, twist_to_elbow=0.5)
    got, want = places(out), places(truth)
    for side in "lr":
        for near, far in (("shoulder", "elbow"), ("elbow", "radiocarpal"), ("hip", "knee"), ("knee", "talocrural")):
            a, b = standard.index[f"{side}_{near}"], standard.index[f"{side}_{far}"]
            one, two = got[:, b] - got[:, a], want[:, b] - want[:, a]
            cosine = np.sum(one * two, axis=1) / np.linalg.norm(one, axis=1) / np.linalg.norm(two, axis=1)
            assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.1
        for name in (f"{side}_shoulder", f"{side}_radiocarpal", f"{side}_hip"):
            j = standard.index[name]
            assert degrees(world(out)[:, j], world(truth)[:, j]).max() < 0.1, name


def test_forearm_twist_is_kept_and_shared():
    """30 degrees about the forearm: the hand has all of it, elbow and wrist half each."""
    skeleton = figure(3)
    for joint in ("l_elbow", "l_radiocarpal"):
        motion = lively(skeleton, size=0.0)
        j, elbow, hand = (skeleton.index[n] for n in (joint, "l_elbow", "l_radiocarpal"))
        axis = skeleton.centers[hand] - skeleton.centers[elbow]
        axis /= np.linalg.norm(axis)
        rotation = motion.rotation.copy()
        rotation[:, j] = from_vector(axis * np.radians(30))
        source = Motion(renamed(skeleton, MIXAMO), 30, rotation, motion.translation)
        out = retarget(source, skeleton, feet=False)
        assert degrees(world(out)[:, hand], from_vector(axis * np.radians(30))).max() < 0.1
        for part in (elbow, hand):
            assert np.degrees(twist(out.rotation[:, part], axis)) == pytest.approx(15, abs=0.1)


@pytest.mark.parametrize("factor", [0.85, 1.15])
def test_longer_and_shorter_legs_keep_their_feet_down(factor):
    motion = walk(figure(3), fps=60, cycles=2)
    target = scaled_legs(figure(3), factor)
    out = retarget(motion, target)
    assert foot_slide_mm(out) <= 2
    assert floor_penetration_mm(out) <= 5
    j = target.index["l_knee"]
    change = degrees(out.rotation[:, j], motion.rotation[:, j])
    assert np.median(change) < 3 and np.quantile(change, 0.9) < 5
    raw = retarget(motion, target, feet=False)
    assert np.abs(sole_points(raw)[..., 1].min(axis=1)).max() > 0.005  # floats or sinks: what the feet stage is for
    travel = out.translation[-1, 2] - out.translation[0, 2]
    assert travel == pytest.approx((motion.translation[-1, 2] - motion.translation[0, 2]) * factor, rel=0.05)
    kept = retarget(motion, target, root="keep")
    assert kept.translation[-1, 2] - kept.translation[0, 2] == pytest.approx(
        motion.translation[-1, 2] - motion.translation[0, 2], rel=0.02
    )


def test_facing_and_up_of_the_source_do_not_matter():
    """A rig that stands with its face along +X gives the same clip, turned."""
    skeleton = figure(3)
    motion = lively(skeleton, size=0.3)
    turn = from_vector([0, np.pi / 2, 0])
    turned = Skeleton(skeleton.names, skeleton.parents, rotate(turn, skeleton.centers))
    rotation = multiply(multiply(turn, motion.rotation), inverse(turn))
    out = retarget(Motion(turned, 30, rotation, rotate(turn, motion.translation)), skeleton, feet=False)
    assert degrees(world(out), multiply(turn, world(motion))).max() < 0.1


def test_spine_is_spread_and_bends_the_same_in_all():
    """Six joints of the source onto 24 vertebrae: ends are exact, between them the bend grows steadily."""
    plain, skeleton = figure(2), figure(3)
    motion = lively(plain, size=0.0)
    rotation = motion.rotation.copy()
    for name in ("vl5", "vl1", "vt6"):
        rotation[:, plain.index[name]] = from_vector([np.radians(10), 0, 0])
    source = Motion(renamed(plain, MIXAMO), 30, rotation, motion.translation)
    out = retarget(source, skeleton, feet=False)
    bend = np.degrees(2 * np.arcsin(world(out)[0, :, 0]))
    index = skeleton.index
    assert bend[index["skullbase"]] == pytest.approx(30, abs=0.01)
    assert bend[index["humanoid_root"]] == pytest.approx(0, abs=0.01)
    chain = [bend[index[n]] for n in skeleton.names if n.startswith("v")]
    assert (np.diff(chain) > -1e-6).all() and np.diff(chain).max() < 6
    assert bend[index["vt1"]] == pytest.approx(30, abs=1)


@pytest.mark.parametrize("loa", [1, 2, 3, 4])
def test_any_level_of_articulation_gets_the_limbs(loa):
    source = Motion(renamed(figure(3), MIXAMO), 30, lively(figure(3)).rotation, np.zeros((30, 3)))
    out = retarget(source, figure(loa), feet=False)
    a, b = figure(3).index, figure(loa).index
    for name in ("skullbase", "l_knee", "r_elbow"):
        mine = MIXAMO[name]
        one = world(source)[:, source.skeleton.index[mine]]
        two = world(out)[:, b[name]]
        if name == "r_elbow":  # its twist is shared with the wrist
            bone = figure(3).centers[a["r_radiocarpal"]] - figure(3).centers[a["r_elbow"]]
            assert rotate(one, bone) == pytest.approx(rotate(two, bone), abs=1e-6)
        else:
            assert degrees(one, two).max() < 0.1


RIGS = {
    "cmu": "Hips LowerBack Spine Spine1 Neck Neck1 Head LeftShoulder LeftArm LeftForeArm LeftHand LeftUpLeg LeftLeg "
    "LeftFoot LeftToeBase",
    "cmu old": "Hips lowerback Chest Chest2 lowerneck Neck Head LeftCollar LeftShoulder LeftElbow LeftWrist LeftHip "
    "LeftKnee LeftAnkle LeftToe",
    "asf": "root lowerback upperback thorax lowerneck upperneck head lclavicle lhumerus lradius lwrist lfemur "
    "ltibia lfoot ltoes",
    "mixamo": "mixamorig:Hips mixamorig:Spine mixamorig:Spine1 mixamorig:Spine2 mixamorig:Neck mixamorig:Head "
    "mixamorig:LeftShoulder mixamorig:LeftArm mixamorig:LeftForeArm mixamorig:LeftHand mixamorig:LeftUpLeg "
    "mixamorig:LeftLeg mixamorig:LeftFoot mixamorig:LeftToeBase",
    "vrm": "hips spine chest upperChest neck head leftShoulder leftUpperArm leftLowerArm leftHand leftUpperLeg "
    "leftLowerLeg leftFoot leftToes",
    "biped": "Bip01_Pelvis Bip01_Spine Bip01_Neck Bip01_Head Bip01_L_Clavicle Bip01_L_UpperArm Bip01_L_Forearm "
    "Bip01_L_Hand Bip01_L_Thigh Bip01_L_Calf Bip01_L_Foot Bip01_L_Toe0",
    "rigify": "DEF-spine DEF-spine.001 DEF-spine.002 DEF-spine.003 DEF-spine.004 DEF-spine.006 DEF-shoulder.L "
    "DEF-upper_arm.L DEF-forearm.L DEF-hand.L DEF-thigh.L DEF-shin.L DEF-foot.L DEF-toe.L",
    "smpl": "pelvis spine1 spine2 spine3 neck head left_collar left_shoulder left_elbow left_wrist left_hip left_knee "
    "left_ankle left_foot",
    "makehuman": "root spine05 spine04 spine01 neck01 head clavicle.L upperarm01.L lowerarm01.L wrist.L upperleg01.L "
    "lowerleg01.L foot.L toe1-1.L",
    "motion builder": "Hips Spine Spine1 Neck Head LeftShoulder LeftArm LeftForeArm LeftHand LeftUpLeg LeftLeg LeftFoot "
    "LeftToeBase",
    "unreal": "root spine_01 spine_02 neck_01 head clavicle_l upperarm_l lowerarm_l hand_l thigh_l calf_l foot_l ball_l",
    "h-anim 1": "HumanoidRoot vl5 skullbase l_sternoclavicular l_shoulder l_elbow l_wrist l_hip l_knee l_ankle "
    "l_midtarsal",
}


@pytest.mark.parametrize("rig", RIGS)
def test_names_of_known_rigs(rig):
    words = RIGS[rig].split()
    found = {h: n for n, h in match(words).items()}
    limbs = [f"l_{n}" for n in "shoulder elbow radiocarpal hip knee talocrural metatarsophalangeal_2".split()]
    if rig == "rigify":
        found["humanoid_root"] = "DEF-spine"  # its hips are the first spine joint
    # the tail of each list is, in order, arm then leg
    assert [found.get(n) for n in limbs] == words[-7:], match(words)
    assert found["l_sternoclavicular"] == words[-8]
    assert "humanoid_root" in found
    assert "skullbase" in found
    assert found["skullbase"] in words


def test_bodies_of_opensim_are_joints():
    bodies = "pelvis torso femur_r tibia_r talus_r calcn_r toes_r humerus_r ulna_r radius_r hand_r".split()
    found = match(bodies)
    limb = ("hip", "knee", "talocrural", "metatarsophalangeal_2", "shoulder", "elbow", "radiocarpal")
    mine = ("femur_r", "tibia_r", "talus_r", "toes_r", "humerus_r", "ulna_r", "hand_r")
    assert [found.get(n) for n in mine] == [f"r_{n}" for n in limb]
    assert "radius_r" not in found and found["calcn_r"] == "r_talocalcaneonavicular"


def test_fingers_of_known_rigs():
    for names in (
        ["LeftHandThumb1", "LeftHandIndex1", "LeftHandIndex2", "LeftHandPinky3"],
        ["leftThumbMetacarpal", "leftIndexProximal", "leftIndexIntermediate", "leftLittleDistal"],
        ["Bip01 L Finger0", "Bip01 L Finger1", "Bip01 L Finger11", "Bip01 L Finger42"],
        ["finger1-1.L", "finger2-1.L", "finger2-2.L", "finger5-3.L"],
        ["Thumb1_L", "Index1_L", "Index2_L", "Pinky3_L"],
        ["l_thumb1", "l_index1", "l_index2", "l_pinky3"],
    ):
        assert list(match(names).values()) == [
            "l_carpometacarpal_1",
            "l_metacarpophalangeal_2",
            "l_carpal_proximal_interphalangeal_2",
            "l_carpal_distal_interphalangeal_5",
        ], names


def test_own_names_win_and_mistakes_are_named():
    skeleton = figure(2)
    strange = renamed(skeleton, {n: f"bone_{i}" for i, n in enumerate(skeleton.names)})
    clip = Motion(strange, 30, lively(skeleton).rotation, np.zeros((30, 3)))
    chain = Skeleton(("a", "b", "c"), np.array([-1, 0, 1]), np.array([[0, 0, 0], [0, 1, 0], [0, 2, 0.0]]))
    with pytest.raises(VitruvianError, match="hips"):
        retarget(Motion(chain, 30, clip.rotation[:, :3], clip.translation), skeleton)
    own = {f"bone_{i}": n for i, n in enumerate(skeleton.names)}
    out = retarget(clip, skeleton, names=own, feet=False)
    knee = skeleton.index["l_knee"]
    assert degrees(world(out)[:, knee], world(clip)[:, knee]).max() < 0.05
    with pytest.raises(VitruvianError, match="no joint 'nobody'"):
        retarget(clip, skeleton, names={"nobody": "l_knee"})
    with pytest.raises(VitruvianError, match="two joints"):
        retarget(clip, skeleton, names={"bone_1": "l_knee", "bone_2": "l_knee"})
    with pytest.raises(VitruvianError, match="H-Anim joint names"):
        retarget(clip, strange)
    with pytest.raises(VitruvianError, match="root"):
        retarget(clip, skeleton, names=own, root="elsewhere")


def test_unmatched_joints_are_listed():
    skeleton = renamed(figure(2), {**MIXAMO, "vt1": "tail"})
    clip = Motion(skeleton, 30, lively(figure(2)).rotation, np.zeros((30, 3)))
    notes = retarget(clip, figure(2), feet=False).notes
    assert any("tail" in n for n in notes)


def test_one_frame_and_no_legs():
    skeleton = figure(2)
    clip = lively(skeleton, frames=1)
    assert len(retarget(clip, skeleton)) == 1
    rootless = figure(0)
    assert len(retarget(lively(skeleton), rootless)) == 30


@pytest.mark.parametrize("pitch", [-120, -100, -90, -80, -45, 0, 30])
def test_a_pointed_foot_is_not_turned_round(pitch):
    """It heads where it did, all of it comes back, and a little roll changes little."""
    yaw = np.radians([-120.0, 0.0, 75.0])
    foot = compose(yaw, np.radians(np.full(3, pitch)))
    found = heading(foot)
    assert np.abs(found[0] - yaw).max() < 1e-6 and np.abs(np.degrees(found[1]) - pitch).max() < 1e-4
    rolled = multiply(foot, from_axis_angle(np.array([0.0, 0.0, 1.0, np.radians(8)])))
    found = heading(rolled)
    assert np.abs(compose(*found) - rolled).max() < 1e-12
    assert np.degrees(np.abs(found[0] - yaw)).max() < 10


def test_one_toe_joint_bends_all_toes():
    full = figure(4)
    clip = retarget(lively(renamed(figure(3), MIXAMO), size=0.2), full, feet=False)
    turned = world(clip)
    for side in "lr":
        own = [full.index[f"{side}_metatarsophalangeal_{k}"] for k in range(1, 6)]
        assert np.abs(turned[:, own] - turned[:, own[1]][:, None]).max() < 1e-9
        assert np.ptp(clip.rotation[:, own[1]], axis=0).max() > 0.05


def test_two_bone_reference_cases():
    """Planar arms of 1 m + 1 m: note motion.md, 6."""
    root, up = np.zeros(3), np.array([0.0, 1.0, 0.0])
    middle, end = two_bone(root, np.array([1.0, 1, 0]), up, 1, 1)
    assert middle == pytest.approx([0, 1, 0]) and end == pytest.approx([1, 1, 0])
    middle, end = two_bone(root, np.array([0.0, 0.5, 0]), np.array([1.0, 0, 0]), 1, 1)
    inner = (middle - root) @ (end - middle)
    assert np.degrees(np.arccos(inner)) == pytest.approx(151.045, abs=1e-3)
    middle, end = two_bone(root, np.array([0.0, 3, 0]), np.array([1.0, 0, 0]), 1, 1)
    assert np.linalg.norm(end) == pytest.approx(2 * REACH)


def test_standing_has_hysteresis_and_drops_short_touches():
    fps, time = 100, np.arange(300) / 100
    path = np.zeros((300, 3))
    path[:, 2] = np.where(time < 1, 0, np.where(time < 2, (time - 1) * 1.0, 1.0))
    path[:, 1] = np.where((time > 1) & (time < 2), 0.1 * np.sin(np.pi * (time - 1)), 0)
    got = runs(standing(path, fps))
    assert len(got) == 2
    assert got[0][0] == 0 and abs(got[0][1] - 100) < 5 and abs(got[1][0] - 200) < 5
    path[150:153] = path[150]
    assert len(runs(standing(path, fps))) == 2


@pytest.mark.parametrize("name", ["cmu_131_01_walk", "cmu_01_01_playground"])
def test_captured_clips(shared, name):
    """On the floor, feet still, hands not turned, knees forward."""
    clip = read_bvh(shared / "data" / "motion" / f"{name}.bvh")
    out = retarget(clip, figure(3))
    assert len(out) == len(clip)
    assert floor_penetration_mm(out) <= 5
    raw = retarget(clip, figure(3), feet=False)
    assert floor_penetration_mm(raw) > 10
    skeleton = out.skeleton
    place, turn, index = places(out), world(out), skeleton.index
    slides = []
    for leg in legs(skeleton):
        ball = place[:, leg.front]
        for start, stop in runs(standing(places(clip)[:, _toe(clip, leg.side)], clip.fps)):
            inside = ball[start + 6 : stop - 6]
            if len(inside) > 6:
                slides.append(np.linalg.norm(np.diff(inside, axis=0), axis=1).max() * 1000)
    assert np.quantile(slides, 0.8) < 2
    for side in "lr":
        axis = skeleton.centers[index[f"{side}_radiocarpal"]] - skeleton.centers[index[f"{side}_elbow"]]
        axis /= np.linalg.norm(axis)
        for joint in ("elbow", "radiocarpal"):
            angle = np.degrees(twist(out.rotation[:, index[f"{side}_{joint}"]], axis))
            assert np.abs(angle).max() < 100, (side, joint)
        thumb = out.rotation[:, index[f"{side}_carpometacarpal_1"]]
        assert np.abs(thumb - thumb[0]).max() < 1e-6  # the clip's thumbs flip by half turns, so they are left alone
    source_world = world_rotations(clip.skeleton.parents, clip.rotation)
    face = rotate(turn[:, index["skullbase"]], [0, 0, 1])
    his = rotate(source_world[:, clip.skeleton.index["Head"]], [0, 0, 1])
    assert (np.sum(face[2:] * his[2:], axis=1) > 0.999).all()
    # the inserted zero pose at the start is not shown
    if "playground" in name:
        assert np.abs(out.rotation[0] - out.rotation[1]).max() < 0.05
        assert any("frame 0" in n for n in out.notes)


def _toe(clip, side):
    found = {h: n for n, h in match(clip.skeleton.names).items()}
    return clip.skeleton.index[found[f"{side}_metatarsophalangeal_2"]]


def test_bvh_to_hanim_to_bvh(shared, tmp_path):
    """Written and read again, the retargeted clip puts every joint within a tenth of a millimetre."""
    clip = read_bvh(shared / "data" / "motion" / "cmu_131_01_walk.bvh")
    out = retarget(clip, figure(2))
    write_bvh(out, tmp_path / "out.bvh")
    back = read_bvh(tmp_path / "out.bvh")
    pick = [back.skeleton.index[n] for n in out.skeleton.names]
    assert np.abs(places(back)[:, pick] - places(out)).max() < 1e-4


def test_a_single_pose_stands_on_the_floor():
    """One frame with its hips at the origin, as programs write poses: the lower foot is put on the floor."""
    skeleton = figure(1)
    clip = walk(skeleton)
    pose = replace(clip, rotation=clip.rotation[:1], translation=clip.translation[:1] - [0.0, 1.3, 0.0], loop=False)
    assert abs(sole_points(retarget(pose, skeleton))[..., 1].min()) < 1e-9
    assert sole_points(retarget(pose, skeleton, feet=False))[..., 1].min() < -1
