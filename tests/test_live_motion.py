"""Motion in files: through HAnimMotion and interpolators and back with equal joint matrices; clips by name; events."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vitruvian as vt
from scene_figure import typed
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.pack import pack
from vitruvian.body.rotations import from_axis_angle
from vitruvian.errors import VitruvianError, VitruvianWarning
from vitruvian.hanim.events import find, send
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, MotionData, Segment, Site, Track
from vitruvian.motion.clips import trim
from vitruvian.motion.live import baked, set_time
from vitruvian.motion.tracks import clip_names, motion_of, played_frames
from vitruvian.motion.types import Motion


def bare(loa: int = 3, skin: bool = False) -> Humanoid:
    h = typed(loa, skin=skin)
    h.tracks = []
    return h


def clips(h: Humanoid) -> dict[str, Motion]:
    """A walking loop, and a clip that does not loop with offsets of a joint."""
    walk = replace(vt.walk(pack(h).skeleton), name="walk")
    part = trim(walk, 0.1, 0.5)
    shift = np.repeat(part.skeleton.translation[None], len(part), axis=0)
    shift[:, 0] = part.translation
    shift[:, part.skeleton.index["vl5"], 1] = np.linspace(0, 0.02, len(part))
    return {"walk": walk, "stretch": replace(part, joint_translation=shift, name="stretch")}


@pytest.mark.parametrize("clip", ["walk", "stretch"])
@pytest.mark.parametrize(
    ("file", "form"),
    [("a.x3d", "interpolators"), ("a.x3dv", "interpolators"), ("a.wrl", "interpolators"), ("a.x3d", "hanimmotion")],
)
def test_equal_motion_after_a_round_trip(tmp_path: Path, clip: str, file: str, form: str) -> None:
    """Joint matrices within 1e-6, frames, rate and looping the same. 1.x names in VRML97 are looked up."""
    h = bare()
    motion = clips(h)[clip]
    vt.save(vt.Clip(h, pack(h), motion), tmp_path / file, motion=form)
    back = vt.load(tmp_path / file)
    found = motion_of(back, pack(back).skeleton)
    assert (found.fps, found.loop, len(found)) == (pytest.approx(motion.fps), motion.loop, len(motion))
    assert found.name == clip
    expected, got = joint_matrices(motion.skeleton, motion), joint_matrices(found.skeleton, found)
    assert len(motion.skeleton) == len(found.skeleton)
    assert np.abs(expected - got).max() < 1e-6


def test_several_clips_of_one_figure(tmp_path: Path) -> None:
    h = bare(1)
    body = pack(h)
    made = clips(h)
    pair = [vt.Clip(h, body, m) for m in made.values()]
    for form in ("interpolators", "hanimmotion"):
        vt.save(pair, tmp_path / f"{form}.x3d", motion=form)
        back = vt.load(tmp_path / f"{form}.x3d")
        names = clip_names(back)
        assert list(names) == ["walk", "stretch"]
        for name, seconds in names.items():
            m = motion_of(back, pack(back).skeleton, name=name)
            assert m.name == name and len(m) == len(made[name])
            assert abs(seconds - len(m) / m.fps) < 1.01 / m.fps
            assert np.abs(joint_matrices(m.skeleton, m) - joint_matrices(made[name].skeleton, made[name])).max() < 1e-6
    with pytest.raises(VitruvianError, match="expected a clip named 'run', found walk, stretch"):
        motion_of(vt.load(tmp_path / "interpolators.x3d"), body.skeleton, name="run")


def test_commands_know_clips(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from vitruvian.cli import app

    h = bare(1)
    vt.save([vt.Clip(h, pack(h), m) for m in clips(h).values()], tmp_path / "two.x3d")
    run = CliRunner().invoke
    facts = json.loads(run(app, ["info", str(tmp_path / "two.x3d"), "--json"]).stdout)
    assert [c["name"] for c in facts["humanoids"][0]["clips"]] == ["walk", "stretch"]
    bvh = tmp_path / "stretch.bvh"
    assert run(app, ["convert", str(tmp_path / "two.x3d"), str(bvh), "--clip", "stretch"]).exit_code == 0
    assert len(vt.load(bvh)) == len(clips(h)["stretch"])
    vt.save(bare(2), tmp_path / "other.x3d")
    command = ["animate", str(tmp_path / "other.x3d"), str(tmp_path / "two.x3d"), "--clip", "stretch", "--json"]
    result = run(app, [*command, "-o", str(tmp_path / "out.x3d")])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["frames"] == len(clips(h)["stretch"])


def frames(**more: object) -> MotionData:
    values = np.arange(6.0)[:, None] * [10.0, 1.0]
    data = MotionData("m", ["vl5", "l_hip"], [("Xrotation",), ("Yrotation",)], values, 0.1, True, False)
    for name, value in more.items():
        setattr(data, name, value)
    return data


def angles(data: MotionData) -> list[list[float]]:
    h = bare(1)
    h.motions = [data]
    skeleton = pack(h).skeleton
    m = motion_of(h, skeleton)
    half = m.rotation[:, [skeleton.index["vl5"], skeleton.index["l_hip"]]][..., :3].sum(axis=-1)
    return np.degrees(2 * np.arcsin(half)).round(6).tolist()


@pytest.mark.parametrize(
    ("more", "shown"),
    [
        ({}, [0, 1, 2, 3, 4, 5]),
        ({"start_frame": 2}, [2, 3, 4, 5]),
        ({"start_frame": 1, "end_frame": 4, "frame_increment": 2}, [1, 3]),
        ({"start_frame": 4, "end_frame": 2}, [2, 3, 4]),
        ({"frame_increment": -2, "end_frame": 4}, [4, 2, 0]),
        ({"frame_increment": 0, "frame_index": 3}, [3]),
        ({"end_frame": 99}, [0, 1, 2, 3, 4, 5]),
    ],
)
def test_frames_that_an_hanimmotion_shows(more: dict, shown: list[int]) -> None:
    assert played_frames(frames(**more)) == shown
    assert angles(frames(**more)) == [[10.0 * f, 1.0 * f] for f in shown]


def test_channels_can_be_switched_off() -> None:
    assert angles(frames(channels_enabled=[True, False]))[3] == [30, 0]
    data = frames(channels_enabled=[True, False, True])
    data.channels = [("Xrotation", "Zrotation"), ("Yrotation",)]
    data.values = np.tile([10.0, 20.0, 30.0], (2, 1))
    assert angles(data)[0] == [10, 30]
    scaled = frames()
    scaled.channels = [("Xrotation",), ("Xscale",)]
    assert angles(scaled)[3] == [30, 0]  # what scales a joint does not turn it


def test_which_motion_plays() -> None:
    h = bare(1)
    h.motions = [frames(name="off", enabled=False), frames(name="kept"), frames(name="on")]
    h.motions_enabled = [True, False]
    skeleton = pack(h).skeleton
    assert motion_of(h, skeleton).name == "on"
    h.motions = h.motions[:1]
    h.tracks = typed(1).tracks
    assert motion_of(h, skeleton).name == "wave"
    h.tracks = []
    assert motion_of(h, skeleton).name == "off"


def test_a_moving_humanoid_moves_its_root() -> None:
    """Interpolators on the Humanoid itself: root joints take it over, inside the place the file gives the figure."""
    h = bare(1)
    h.translation, h.scale, h.center = np.array([1.0, 2, 3]), np.full(3, 2.0), np.array([0.0, 0.5, 0])
    h.rotation = np.array([0, 1.0, 0, 0.5])
    keys = np.array([0, 0.25, 1])
    walk = np.array([[1, 2, 3], [1, 2, 4], [2, 2, 9.0]])
    turn = np.array([[0, 1, 0, 0.5], [0, 1, 0, 1.0], [1, 0, 0, 2.0]])
    h.tracks = [Track("", "translation", keys, walk, 1, False, "go"), Track("", "rotation", keys, turn, 1, False, "go")]
    body = pack(h)
    motion = motion_of(h, body.skeleton, fps=4)
    found = body.placement @ joint_matrices(body.skeleton, motion)
    for frame, key in ((0, 0), (1, 1), (4, 2)):
        moved = replace(h, translation=walk[key], rotation=turn[key])
        there = pack(moved).placement @ joint_matrices(body.skeleton)[0]
        np.testing.assert_allclose(found[frame], there, atol=1e-12)


def test_displacers_and_points_in_files(tmp_path: Path) -> None:
    """Weights of displacers as `Motion.weights`, whole point sets as baked frames, through a file and back."""
    h = bare(1, skin=True)
    keys = np.array([0, 0.5, 1])
    points = np.stack([h.skin_coord, h.skin_coord + [0, 0.5, 0], h.skin_coord]).reshape(3, -1)
    h.tracks = [
        Track("blink_action", "weight", keys, np.array([[0], [1.0], [0]]), 2.0, True, "blink"),
        Track("", "point", keys, points, 2.0, True, "blink"),
    ]
    for name in ("face.x3d", "face.wrl"):
        vt.save(h, tmp_path / name)
        back = vt.load(tmp_path / name)
        assert {(t.target, t.field) for t in back.tracks} == {("blink_action", "weight"), ("", "point")}
        shown = baked(back, fps=2)
        assert shown.shape == (5, len(h.skin_coord), 3)
        np.testing.assert_allclose(shown[1] - shown[0], np.tile([0, 0.25, 0], (len(h.skin_coord), 1)), atol=1e-6)
        with pytest.warns(VitruvianWarning, match="the humanoid point"):
            motion = motion_of(back, pack(back).skeleton)
        np.testing.assert_allclose(motion.weights["blink_action"], [0, 1], atol=1e-6)
        vt.save(back, tmp_path / f"again-{name}")  # into its own graph
        assert len(vt.load(tmp_path / f"again-{name}").tracks) == 2
        set_time(back, 0.5)
        assert back.displacers()[0].weight == pytest.approx(0.5)
        assert back.skin_coord[0, 1] == pytest.approx(h.skin_coord[0, 1] + 0.25, abs=1e-6)


def test_time_sets_the_fields_of_the_tree() -> None:
    h = typed(1)
    h.tracks.append(
        Track("front_view", "center", np.array([0, 1.0]), np.array([[0, 0, 0], [0, 4.0, 0]]), 2.0, True, "wave")
    )
    assert set_time(h, 0.5, name="wave") == [
        ("l_shoulder", "rotation"),
        ("humanoid_root", "translation"),
        ("front_view", "center"),
    ]
    assert h.joint("l_shoulder").rotation.tolist() == pytest.approx([0, 0, 1, 0.75])
    assert h.joint("humanoid_root").translation.tolist() == pytest.approx([0, 0, 0.25])
    assert find(h, "front_view").center.tolist() == [0, 1, 0]
    set_time(h, 2.5)  # it loops
    assert h.joint("l_shoulder").rotation[3] == pytest.approx(0.75)
    set_time(h, 2.0)
    assert h.joint("humanoid_root").translation[2] == pytest.approx(1)
    with pytest.raises(VitruvianError, match="wave"):
        set_time(h, 0, name="run")
    h.tracks[0].target = "tail"
    with pytest.raises(VitruvianError, match="tail"):
        set_time(h, 0)


def test_events() -> None:
    h = typed(1)
    hip, knee = h.joint("l_hip"), h.joint("l_knee")
    send(hip, "set_rotation", [1, 0, 0, 0.5])
    send(hip, "scale", (2, 2, 2))
    send(h.displacers()[0], "set_weight", 1)
    send(h, "set_skeletalConfiguration", "OTHER")
    assert (hip.rotation.tolist(), hip.scale.tolist(), h.displacers()[0].weight) == ([1, 0, 0, 0.5], [2, 2, 2], 1.0)
    tail, flag = Joint("tail"), Site("flag_pt")
    send(hip, "addChildren", [tail, flag, knee])  # the knee is there already
    assert [j.name for j in hip.joints] == ["l_knee", "tail"] and hip.sites == [flag]
    send(hip, "removeChildren", [tail, Segment("nothing")])
    assert [j.name for j in hip.joints] == ["l_knee"]
    segment = hip.segments[0]
    send(segment, "addChildren", flag)
    assert segment.sites[-1] is flag
    for target, event, value, message in (
        (hip, "set_weight", 1, "takes no event 'set_weight'"),
        (hip, "set_bboxSize", [1, 1, 1], "takes no event"),
        (hip, "set_rotation", [1, 0, 0], "expected SFRotation"),
        (hip, "set_center", [1, 0, np.nan], "finite"),
        (hip, "set_visible", 1, "SFBool"),
        (knee, "addChildren", [hip], "is above it"),
        (hip, "addChildren", [Displacer("d")], "expected Joint, Segment, Site"),
        (h, "addChildren", [tail], "takes no event"),
    ):
        with pytest.raises(VitruvianError, match=message):
            send(target, event, value)


def test_rotations_of_more_than_one_site(tmp_path: Path) -> None:
    """A Site that turns keeps its track; one of a joint stays one of a joint."""
    h = bare(1)
    turn = np.array([[0, 0, 1, 0], [0, 0, 1, 1.0]])
    h.tracks = [Track("front_view", "rotation", np.array([0, 1.0]), turn, 1, True, "pan")]
    vt.save(h, tmp_path / "pan.x3d")
    back = vt.load(tmp_path / "pan.x3d")
    (track,) = back.tracks
    assert (track.target, track.field) == ("front_view", "rotation")
    np.testing.assert_allclose(from_axis_angle(track.values), from_axis_angle(turn), atol=1e-6)
