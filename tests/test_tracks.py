"""HAnimMotion and interpolators to Motion and back."""

from __future__ import annotations

import numpy as np
import pytest

from skeletons import figure
from vitruvian.body.rotations import from_axis_angle, from_euler, slerp
from vitruvian.errors import VitruvianError, VitruvianWarning
from vitruvian.hanim.humanoid import Humanoid, MotionData, Track
from vitruvian.motion.gait import walk
from vitruvian.motion.idle import idle
from vitruvian.motion.tracks import axis_angles, motion_data, motion_of, sample_track, tracks_of
from vitruvian.motion.types import Motion


def same(a, b):
    return np.degrees(2 * np.arccos(np.clip(np.abs(np.sum(a * b, axis=-1)), 0, 1))).max()


def test_meaning_of_hanimmotion():
    """Degrees, channels in listed order, positions straight to translation, IGNORED consumes, either version's
    names.
    """
    data = MotionData(
        "clip",
        ["HumanoidRoot", "IGNORED", "l_ankle", "l_elbow"],
        [("Xposition", "Zposition", "Zrotation", "Xrotation", "Yrotation"), ("Xrotation",), ("Yrotation",), ()],
        np.array([[1.0, 2, 30, 40, 50, 99, 60], [1, 2, 31, 41, 51, 99, 61]]),
        frame_duration=0.05,
        loop=False,
    )
    skeleton = figure(2)
    motion = motion_of(Humanoid(motions=[data]), skeleton)
    assert motion.fps == pytest.approx(20)
    assert not motion.loop
    index = skeleton.index
    assert motion.translation[0] == pytest.approx([1, 0, 2])
    assert same(motion.rotation[:, 0], from_euler(np.radians([[30, 40, 50], [31, 41, 51.0]]), "ZXY")) < 1e-5
    assert same(motion.rotation[0, index["l_talocrural"]], from_axis_angle([0, 1, 0, np.radians(60)])) < 1e-5
    assert motion.rotation[0, index["l_elbow"]] == pytest.approx([0, 0, 0, 1])
    rebased = motion_of(Humanoid(motions=[data]), skeleton, rebase=True)
    assert rebased.translation[0] == pytest.approx([1, 0, 2] - skeleton.centers[0] * [1, 0, 1])


def test_unknown_joints_are_named_and_wrong_counts_refused():
    data = MotionData("clip", ["tail", "l_knee"], [("Xrotation",), ("Xrotation",)], np.zeros((3, 2)))
    with pytest.warns(VitruvianWarning, match="tail"):
        motion_of(Humanoid(motions=[data]), figure(1))
    data.values = np.zeros((3, 5))
    with pytest.raises(VitruvianError, match="clip"):
        motion_of(Humanoid(motions=[data]), figure(1))


def test_enabled_motion_is_chosen_and_none_without_any():
    one = MotionData("a", ["l_knee"], [("Xrotation",)], np.full((2, 1), 10.0), enabled=False)
    two = MotionData("b", ["l_knee"], [("Xrotation",)], np.full((2, 1), 20.0), enabled=True)
    skeleton = figure(1)
    assert motion_of(Humanoid(motions=[one, two]), skeleton).name == "b"
    assert motion_of(Humanoid(motions=[one, two]), skeleton, name="a").name == "a"
    assert motion_of(Humanoid(), skeleton) is None


def test_interpolators():
    """Slerp the short way, clamped ends, later value at equal keys."""
    turn = np.array([[1, 0, 0, 0.0], [1, 0, 0, 1.0], [0, 1, 0, 2.0], [0, 0, 1, 3.0]])
    track = Track("l_knee", "rotation", np.array([0.2, 0.5, 0.5, 0.9]), turn, interval=2.0)
    got = sample_track(track, np.array([0.0, 0.35, 0.5, 0.7, 1.0]))
    q = from_axis_angle(turn)
    half = slerp(q[2], q[3], 0.5)
    expected = np.stack([q[0], from_axis_angle([1, 0, 0, 0.5]), q[2], half, q[3]])
    assert same(got, expected) < 1e-5
    motion = motion_of(Humanoid(tracks=[track]), figure(1), fps=25)
    assert len(motion) == 51  # not closed: both ends are shown
    assert motion.seconds == pytest.approx(2.04)
    weight = Track("smile", "weight", np.array([0.0, 1.0]), np.array([[0.0], [1.0]]))
    motion = motion_of(Humanoid(tracks=[weight]), figure(1), fps=10)
    assert motion.weights["smile"][5] == pytest.approx(0.5)


@pytest.mark.parametrize("make", [walk, idle, lambda s: walk(s, in_place=True)])
def test_clips_survive_both_forms(make):
    motion = make(figure(3))
    for humanoid in (Humanoid(motions=[motion_data(motion)]), Humanoid(tracks=tracks_of(motion))):
        back = motion_of(humanoid, motion.skeleton, fps=motion.fps)
        count = len(motion)
        assert len(back) in (count, count + 1)
        assert same(back.rotation[:count], motion.rotation) < 1e-4
        assert np.abs(back.translation[:count] - motion.translation).max() < 1e-9
        assert back.loop
    closed = motion_of(Humanoid(tracks=tracks_of(idle(figure(2)))), figure(2), fps=30)
    assert len(closed) == len(idle(figure(2)))


def test_a_travelling_loop_does_not_jump_back():
    motion = walk(figure(2))
    track = next(t for t in tracks_of(motion) if t.field == "translation")
    assert track.interval == pytest.approx(len(motion) / motion.fps)
    steps = np.diff(track.values[:, 2])
    assert (steps > 0).all() and steps[-1] < 1.5 * steps.mean()


def test_axis_angles_are_continuous():
    time = np.linspace(0, 1, 200)
    turns = np.stack([0.3 * np.sin(9 * time), 2.5 * np.sin(5 * time), 4 * np.sin(7 * time)], axis=1)
    clip = Motion(figure(0), 30, from_euler(turns, "XYZ")[:, None], np.zeros((200, 3))).rotation[:, 0]
    out = axis_angles(clip)
    assert same(from_axis_angle(out), clip) < 1e-5
    assert np.linalg.norm(out[:, :3], axis=1) == pytest.approx(1)
    assert (np.sum(out[1:, :3] * out[:-1, :3], axis=1) >= 0).all()
    assert np.abs(np.diff(out[:, 3])).max() < 0.5
    assert axis_angles(np.tile([0.0, 0, 0, 1], (3, 1)))[:, 3] == pytest.approx(0)


def test_angles_of_hanimmotion_do_not_jump():
    data = motion_data(walk(figure(3), cycles=3))
    turning = [c for group in data.channels for c in group]
    rotations = [i for i, c in enumerate(turning) if c.endswith("rotation")]
    assert np.abs(np.diff(data.values[:, rotations], axis=0)).max() < 60
    assert data.enabled and data.loop
    assert data.values.shape == (len(data.values), len(turning))


def test_the_real_sample(shared):
    """Annex D sample: 18 groups, 57 channels, 392 frames, three IGNORED groups, names of both versions."""
    from vitruvian.body.pack import pack
    from vitruvian.formats.x3d import read_x3d
    from vitruvian.hanim.view import humanoids

    scene = read_x3d(shared / "data" / "hanim" / "KoreanCharacterMotionAnnexD01Jin.x3d")
    humanoid = humanoids(scene)[0]
    data = humanoid.motions[0]
    assert len(data.joints) == 18 and data.values.shape == (392, 57)
    skeleton = pack(humanoid).skeleton
    motion = motion_of(humanoid, skeleton)
    assert len(motion) in (391, 392) and motion.fps == pytest.approx(10)
    turned = np.abs(motion.rotation[..., 3]).min(axis=0) < 0.9999
    assert turned.sum() >= 12


def test_a_joint_that_the_file_poses_can_come_back_to_rest() -> None:
    """Tracks are left out only where the clip keeps the file's own pose; they keep the rate they were made with."""
    from scene_figure import typed
    from vitruvian.body.pack import pack

    h = typed(1)
    h.joint("l_knee").rotation = np.array([1.0, 0, 0, 0.5])
    h.joint("humanoid_root").translation = np.array([0.0, 1, 0])
    skeleton = pack(h).skeleton
    still = np.zeros((7, len(skeleton), 4))
    still[..., 3] = 1
    clip = Motion(skeleton, 25.0, still, np.zeros((7, 3)))
    h.tracks = tracks_of(clip)
    assert {(t.target, t.field) for t in h.tracks} == {("l_knee", "rotation"), ("humanoid_root", "translation")}
    back = motion_of(h, skeleton)
    assert back.fps == 25 and len(back) == 7
    np.testing.assert_allclose(back.rotation, clip.rotation, atol=1e-12)
    np.testing.assert_allclose(back.translation, 0, atol=1e-12)
