"""Our own walk and idle: planted feet, seams, speed, ranges of the joints."""

from __future__ import annotations

import numpy as np
import pytest

from skeletons import figure, scaled_legs
from vitruvian.body.rotations import rotate, to_vector
from vitruvian.body.types import Skeleton
from vitruvian.errors import VitruvianError
from vitruvian.motion.contacts import floor_penetration_mm, foot_slide_mm, in_units, legs, sole_points
from vitruvian.motion.gait import walk
from vitruvian.motion.idle import idle
from vitruvian.motion.turns import positions, world_rotations


def places(motion):
    world = world_rotations(motion.skeleton.parents, motion.rotation)
    return positions(motion.skeleton.parents, motion.skeleton.centers, world, motion.translation)


def flexion(motion, upper, middle, lower):
    """Angle (F,) in degrees between two bones."""
    place, index = places(motion), motion.skeleton.index
    a = place[:, index[middle]] - place[:, index[upper]]
    b = place[:, index[lower]] - place[:, index[middle]]
    cosine = np.sum(a * b, axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
    return np.degrees(np.arccos(cosine))


@pytest.mark.parametrize("loa", [1, 2, 3, 4])
@pytest.mark.parametrize("speed", [0.7, 1.35, 1.8])
def test_feet_neither_slide_nor_sink(loa, speed):
    motion = walk(figure(loa), speed=speed, cycles=2)
    assert foot_slide_mm(motion) < 0.5
    assert floor_penetration_mm(motion) < 0.5


@pytest.mark.parametrize("factor", [0.85, 1.15])
def test_other_legs_walk_too(factor):
    motion = walk(scaled_legs(figure(3), factor), cycles=2)
    assert foot_slide_mm(motion) < 0.5
    assert floor_penetration_mm(motion) < 0.5


def test_each_foot_stands_about_three_fifths_of_the_time_and_swings_clear():
    motion = walk(figure(3), fps=120)
    low = sole_points(motion)[:, :3, 1].min(axis=1)
    assert 0.58 < (low < 0.002).mean() < 0.68
    assert sole_points(motion)[:, :3, 1].max() > 0.05


@pytest.mark.parametrize(("speed", "stride"), [(1.35, None), (0.8, None), (1.2, 1.2), (1.6, 1.5)])
def test_speed_and_stride_are_as_asked(speed, stride):
    motion = walk(figure(3), speed=speed, stride=stride, fps=60, cycles=3)
    pace = (motion.translation[-1, 2] - motion.translation[0, 2]) / (len(motion) - 1) * motion.fps
    assert pace == pytest.approx(speed, rel=0.02)
    if stride:
        assert len(motion) / 3 / motion.fps * speed == pytest.approx(stride, rel=0.02)
    usual = walk(figure(3), speed=1.35)
    steps_per_minute = 2 * 60 / usual.seconds
    assert 105 < steps_per_minute < 120  # normal cadence at normal speed


def test_loops_without_a_seam():
    """The step from the last frame to the first is like all others, in place and (with the way) on stage."""
    for motion in (walk(figure(3), in_place=True), idle(figure(3))):
        rotation = np.concatenate([motion.rotation, motion.rotation[:1]])
        dots = np.abs(np.sum(rotation[1:] * rotation[:-1], axis=-1))
        steps = 2 * np.arccos(np.clip(dots, 0, 1)).max(axis=1)
        assert steps[-1] < 1.2 * steps[:-1].max()
        move = np.concatenate([motion.translation, motion.translation[:1]])
        steps = np.linalg.norm(np.diff(move, axis=0), axis=1)
        assert steps[-1] < 1.2 * steps[:-1].max()
        assert motion.loop


def test_moves_smoothly():
    """No joint speeds up by more than a person's: the swinging foot stays below four times the walking speed."""
    motion = walk(figure(3), fps=120, cycles=2)
    place = places(motion)
    for leg in legs(motion.skeleton):
        pace = np.linalg.norm(np.diff(place[:, leg.ankle], axis=0), axis=1) * motion.fps
        assert 3.0 < pace.max() < 4 * 1.45
        push = np.linalg.norm(np.diff(place[:, leg.ankle], 2, axis=0), axis=1) * motion.fps**2
        assert push.max() < 120  # m/s2; heel strike is a kink, not a jump


def test_joint_ranges_are_those_of_walking():
    motion = walk(figure(3), fps=60)
    knee = flexion(motion, "l_hip", "l_knee", "l_talocrural")
    assert 50 < knee.max() < 75  # in swing
    assert knee.min() < 12  # nearly straight at heel strike
    count = len(motion)
    assert knee[int(0.12 * count) : int(0.18 * count)].max() > 12  # gives way under the load
    elbow = flexion(motion, "l_shoulder", "l_elbow", "l_radiocarpal")
    assert elbow.min() > 8 and 20 < elbow.max() < 50
    place, index = places(motion), motion.skeleton.index
    height = place[:, index["l_hip"], 1] / 2 + place[:, index["r_hip"], 1] / 2
    assert 0.02 < np.ptp(height) < 0.06
    chest = np.degrees(to_vector(world_rotations(motion.skeleton.parents, motion.rotation)))
    assert np.abs(chest[:, index["skullbase"]]).max() < 6  # the head is kept still
    pelvis, thorax = chest[:, index["humanoid_root"], 1], chest[:, index["vt1"], 1]
    assert np.corrcoef(pelvis, thorax)[0, 1] < -0.7  # trunk turns against the pelvis


def test_arms_swing_against_the_legs_and_clear_the_hips():
    motion = walk(figure(3), fps=60)
    place, index = places(motion), motion.skeleton.index
    for side in "lr":
        hand = place[:, index[f"{side}_radiocarpal"], 2] - place[:, index[f"{side}_shoulder"], 2]
        foot = place[:, index[f"{side}_talocrural"], 2] - place[:, index[f"{side}_hip"], 2]
        assert np.corrcoef(hand, foot)[0, 1] < -0.6
        out = np.abs(place[:, index[f"{side}_radiocarpal"], 0] - place[:, index["sacroiliac"], 0])
        hip = np.abs(place[:, index[f"{side}_hip"], 0] - place[:, index["sacroiliac"], 0])
        assert (out - hip).min() > 0.08


def test_palms_face_the_body():
    motion = idle(figure(3))
    world, index = world_rotations(motion.skeleton.parents, motion.rotation), motion.skeleton.index
    for side, inward in (("l", -1.0), ("r", 1.0)):
        palm = rotate(world[:, index[f"{side}_radiocarpal"]], [inward, 0, 0])
        assert (palm[:, 0] * inward > 0.6).all()


def test_idle_is_never_still_and_stands():
    motion = idle(figure(4), seconds=6, blink=("l_eye_close", "r_eye_close"))
    assert len(motion) == 180
    assert foot_slide_mm(motion) < 1e-6 and floor_penetration_mm(motion) < 1e-6
    place = places(motion)
    step = np.linalg.norm(np.diff(place, axis=0), axis=-1).max(axis=1)
    assert step.min() > 1e-5
    assert step.max() < 0.01
    weight = motion.weights["l_eye_close"]
    assert weight.max() > 0.9 and (weight < 0.01).mean() > 0.85


def test_requests_that_make_no_sense():
    with pytest.raises(VitruvianError, match="speed"):
        walk(figure(2), speed=9)
    with pytest.raises(VitruvianError, match="stride"):
        walk(figure(2), stride=5)
    with pytest.raises(VitruvianError, match="fps"):
        walk(figure(2), fps=0)
    with pytest.raises(VitruvianError, match="seconds"):
        idle(figure(2), seconds=1)
    with pytest.raises(VitruvianError, match="both legs"):
        walk(figure(0))


def test_figures_in_other_units_walk_alike():
    """A figure built in centimetres gets the same turns and a way in its own units."""
    metres = walk(figure(2))
    centimetres = walk(in_units(figure(2), 100.0))
    assert np.abs(np.sum(metres.rotation * centimetres.rotation, axis=-1)).min() > 0.999
    assert foot_slide_mm(centimetres) < 0.5 and floor_penetration_mm(centimetres) < 0.5
    assert centimetres.skeleton.centers[0, 1] > 50 and np.ptp(centimetres.translation[:, 2]) > 50


def test_a_foot_without_toes_rolls_over_its_tip():
    plain = figure(1)
    keep = [i for i, n in enumerate(plain.names) if "metatarsophalangeal" not in n]
    parents = [-1 if plain.parents[i] < 0 else keep.index(plain.parents[i]) for i in keep]
    stiff = Skeleton(tuple(plain.names[i] for i in keep), np.array(parents), plain.centers[keep])
    motion = walk(stiff, fps=60)
    assert foot_slide_mm(motion) < 1 and floor_penetration_mm(motion) < 1


def test_feet_without_sites_stand_on_the_soles_that_are_drawn() -> None:
    """A body without foot Sites: the walk on `soled` keeps its skin nearer to the floor than the bare skeleton's."""
    import vitruvian as vt
    from vitruvian.motion.contacts import soled

    humanoid = vt.person(loa=1)
    for segment in humanoid.segments():
        segment.sites = []
    body = vt.pack(humanoid)
    skeleton = soled(body)
    assert set(skeleton.site_names) >= {"l_calcaneus_posterior", "r_tarsal_distal_phalanx_2"}
    move = vt.deformer("linear", body)
    lowest = {
        name: float(move(vt.joint_matrices(body.skeleton, vt.walk(s)))[:, :, 1].min())
        for name, s in (("bare", body.skeleton), ("soled", skeleton))
    }
    assert lowest["soled"] > -0.012 and lowest["soled"] >= lowest["bare"]
