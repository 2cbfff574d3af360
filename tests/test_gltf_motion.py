"""Animations of glTF and VRMA: every interpolation as the specification draws it, steps and splines included."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

import vitruvian as vt
from gltf_maker import BONES, Foreign, Maker
from vitruvian.body.kinematics import joint_matrices, joint_positions
from vitruvian.errors import FileError
from vitruvian.motion.tracks import motion_of, sample_track

TIMES = np.array([0.0, 0.5, 2.0])


def turned(rig: Foreign, name: str, angles: list[float]) -> np.ndarray:
    """Rotations of a bone's node that turn it by angles about its own Z."""
    rest = Rotation.from_quat(rig.maker.json["nodes"][rig.bone[name]]["rotation"])
    return np.array([(rest * Rotation.from_euler("z", a)).as_quat() for a in angles])


def angles_of(humanoid: vt.Humanoid, joint: str, at: list[float]) -> np.ndarray:
    """Angles (radians, from the bind pose) of a joint's track at times."""
    (track,) = [t for t in humanoid.tracks if t.target == joint and t.field == "rotation"]
    q = sample_track(track, np.array(at) / track.interval)
    return 2 * np.arctan2(np.linalg.norm(q[:, :3], axis=1), np.abs(q[:, 3]))


def test_linear_rotations_turn_evenly(tmp_path: Path) -> None:
    rig = Foreign()
    rig.animate(TIMES, LeftArm=("rotation", turned(rig, "LeftArm", [0, 1.0, 0.2]), "LINEAR"))
    h = vt.load(rig.maker.glb(tmp_path / "a.glb"))
    assert np.allclose(angles_of(h, "l_shoulder", [0, 0.25, 0.5, 1.25, 2]), [0, 0.5, 1, 0.6, 0.2], atol=1e-5)


def test_steps_hold_until_the_next_key(tmp_path: Path) -> None:
    rig = Foreign()
    rig.animate(TIMES, LeftArm=("rotation", turned(rig, "LeftArm", [0.1, 1.0, 0.2]), "STEP"))
    h = vt.load(rig.maker.glb(tmp_path / "a.glb"))
    found = angles_of(h, "l_shoulder", [0, 0.25, 0.4999, 0.5, 0.51, 1.9, 2])
    assert np.allclose(found, [0.1, 0.1, 0.1, 1.0, 1.0, 1.0, 0.2], atol=1e-5)


def test_cubic_splines_are_followed(tmp_path: Path) -> None:
    rig = Foreign()
    at = np.array(rig.maker.json["nodes"][rig.bone["Hips"]]["translation"])
    values = np.zeros((3, 3, 3)) + at  # in-tangent, value, out-tangent, of each key
    values[:, 0], values[:, 2] = [[0, 0, 0], [0, 0, 30], [0, 0, -20]], [[0, 0, 40], [0, 0, 10], [0, 0, 0]]
    values[1, 1, 2] += 50
    rig.animate(TIMES, Hips=("translation", values.reshape(-1, 3), "CUBICSPLINE"))
    h = vt.load(rig.maker.glb(tmp_path / "a.glb"))
    (track,) = h.tracks

    def spline(t: float) -> float:  # appendix C of the specification, along Z of the file (centimetres), Y of ours
        k = 0 if t < 0.5 else 1
        d = TIMES[k + 1] - TIMES[k]
        s = (t - TIMES[k]) / d
        p, q = values[k, 1, 2] - at[2], values[k + 1, 1, 2] - at[2]
        m, n = d * values[k, 2, 2], d * values[k + 1, 0, 2]
        return (
            (2 * s**3 - 3 * s**2 + 1) * p + (s**3 - 2 * s**2 + s) * m + (-2 * s**3 + 3 * s**2) * q + (s**3 - s**2) * n
        )

    for t in np.linspace(0, 2, 37):
        y = sample_track(track, np.array([t / 2]))[0]
        assert abs(y[1] - 0.01 * spline(t)) < 3e-4 and np.abs(y[[0, 2]]).max() < 1e-5


def test_motion_of_nodes_above_and_between(tmp_path: Path) -> None:
    """What moves the node above the root moves the root; the figure's own bones stay still."""
    rig = Foreign()
    rig.animate([0, 1.0], Armature=("translation", [[0, 0, 0], [1, 0, 0.5]], "LINEAR"))
    h = vt.load(rig.maker.glb(tmp_path / "a.glb"))
    (track,) = h.tracks
    assert (track.target, track.field) == ("humanoid_root", "translation")
    assert np.allclose(track.values, [[0, 0, 0], [1, 0, 0.5]], atol=1e-6)


def test_several_clips_and_their_names(tmp_path: Path) -> None:
    rig = Foreign()
    rig.animate([0, 1.0], LeftArm=("rotation", turned(rig, "LeftArm", [0, 1]), "LINEAR"))
    rig.animate([0, 2.0], LeftLeg=("rotation", turned(rig, "LeftLeg", [0, 1]), "LINEAR"))
    rig.maker.json["animations"][1]["name"] = "kick"
    h = vt.load(rig.maker.glb(tmp_path / "a.glb"))
    assert [(t.timer, t.target, t.interval) for t in h.tracks] == [("move", "l_shoulder", 1), ("kick", "l_knee", 2)]
    skeleton = vt.pack(h).skeleton
    kick = motion_of(h, skeleton, name="kick")
    assert kick is not None and kick.seconds == pytest.approx(2, abs=0.05)


def test_animation_alone_is_a_motion(tmp_path: Path) -> None:
    """As downloaded "without skin": bones and keys only, at the keys' own rate."""
    rig = Foreign(skin=False)
    n, rng = 21, np.random.default_rng(3)
    swing = np.cumsum(rng.normal(size=n)) * 0.1
    rig.animate(np.arange(n) / 25, LeftArm=("rotation", turned(rig, "LeftArm", list(swing)), "LINEAR"))
    m = vt.load(rig.maker.glb(tmp_path / "a.glb"))
    assert isinstance(m, vt.Motion) and m.fps == 25 and len(m) == n and not m.loop
    assert set(m.skeleton.names) == {j for j, _, _ in BONES}
    c = {name: m.skeleton.centers[i] for name, i in m.skeleton.index.items()}
    assert max(np.abs(c[j] - x).max() for (j, _, _), x in zip(BONES, rig.centers)) < 1e-6
    wrist = joint_positions(m.skeleton, joint_matrices(m.skeleton, m))[:, m.skeleton.index["l_radiocarpal"]]
    bind = rig.bind[[n for _, n, _ in BONES].index("LeftArm")]
    own = np.linalg.inv(bind) @ np.append(c["l_radiocarpal"], 1)
    for k in range(n):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_euler("z", swing[k]).as_matrix()
        assert np.abs(wrist[k] - (bind @ turn @ own)[:3]).max() < 1e-5


def test_wrong_animations_are_refused(tmp_path: Path) -> None:
    for times, values, how, what in (
        ([0, 1.0, 0.5], 3, "LINEAR", "increase"), ([0, 1.0], 3, "LINEAR", "do not fit"),
        ([0, 1.0], 2, "CUBICSPLINE", "do not fit"), ([0, 1.0], 2, "SPLINE", "STEP"),
    ):  # fmt: skip
        rig = Foreign()
        rig.animate(times, LeftArm=("rotation", np.tile([0, 0, 0, 1.0], (values, 1)), how))
        with pytest.raises(FileError, match=what):
            vt.load(rig.maker.glb(tmp_path / "a.glb"))


def test_vrma_of_another_program(shared: Path) -> None:
    """Read by hand from the same bytes: the left hand and the hips in the world at some frames."""
    path = shared / "data" / "motion" / "chatvrm_idle_loop.vrma"
    m = vt.load(path)
    assert (
        isinstance(m, vt.Motion) and m.fps == 24 and len(m) in (249, 250) and m.seconds == pytest.approx(10.4, abs=0.05)
    )
    names = set(m.skeleton.names)
    assert {"humanoid_root", "vl5", "vt10", "vt6", "vc4", "skullbase", "l_shoulder", "r_radiocarpal", "l_hip"} <= names
    places = joint_positions(m.skeleton, joint_matrices(m.skeleton, m))
    world = _player(path)
    for frame in (0, 17, 120, 248):
        for name, node in (("l_radiocarpal", 5), ("humanoid_root", 31), ("skullbase", 0 + 1), ("r_talocrural", 28)):
            if name == "skullbase":
                node = 0
            ours = places[frame, m.skeleton.index[name]]
            assert np.abs(ours - world(frame / 24)[node][:3, 3]).max() < 2e-5, (name, frame)


def _player(path: Path):
    """World matrices of the nodes at a time, from scipy's rotations and slerp."""
    from gltf_player import Player

    player = Player(path)
    channels = []
    for channel in player.json["animations"][0]["channels"]:
        sampler = player.json["animations"][0]["samplers"][channel["sampler"]]
        keys, values = player.read(sampler["input"])[:, 0], player.read(sampler["output"])
        channels.append((channel["target"]["node"], channel["target"]["path"], keys, values))

    def world(t: float) -> list[np.ndarray]:
        state = [dict(n) for n in player.nodes]
        for node, path, keys, values in channels:
            if path == "rotation":
                state[node][path] = Slerp(keys, Rotation.from_quat(values))(min(t, keys[-1])).as_quat()
            else:
                state[node][path] = [np.interp(t, keys, v) for v in values.T]
        out: list[np.ndarray] = [np.eye(4)] * len(state)
        stack = [(i, np.eye(4)) for i in player.json["scenes"][0]["nodes"]]
        while stack:
            i, above = stack.pop()
            local = np.eye(4)
            local[:3, :3] = Rotation.from_quat(state[i].get("rotation", [0, 0, 0, 1])).as_matrix()
            local[:3, :3] *= np.array(state[i].get("scale", [1, 1, 1]))
            local[:3, 3] = state[i].get("translation", [0, 0, 0])
            out[i] = above @ local
            stack += [(c, out[i]) for c in state[i].get("children", [])]
        return out

    return world


def test_vrma_moves_the_person(shared: Path) -> None:
    body = vt.pack(vt.person(loa=2))
    m = vt.retarget(vt.load(shared / "data" / "motion" / "chatvrm_idle_loop.vrma"), body.skeleton)
    places = joint_positions(body.skeleton, joint_matrices(body.skeleton, m))
    s = body.skeleton.index
    hands = places[:, [s["l_radiocarpal"], s["r_radiocarpal"]]]
    assert (hands[..., 1] < places[:, s["vl5"], None, 1] + 0.1).all()  # an idle stance: hands hang
    assert places[:, s["skullbase"], 1].min() > 1.3


def test_vrma_expressions_are_weights(tmp_path: Path) -> None:
    m = Maker()
    hips = m.put("nodes", {"name": "h", "translation": [0, 1, 0]})
    face = m.put("nodes", {"name": "e"})
    m.json["scenes"] = [{"nodes": [hips, face]}]
    clock = m.add([0, 0.1, 0.2])
    m.put("animations", {
        "samplers": [
            {"input": clock, "output": m.add([[0, 1, 0], [0, 1.1, 0], [0, 1.2, 0]])},
            {"input": clock, "output": m.add([[0, 0, 0], [1, 0, 0], [0.5, 0, 0]])},
        ],
        "channels": [
            {"sampler": 0, "target": {"node": hips, "path": "translation"}},
            {"sampler": 1, "target": {"node": face, "path": "translation"}},
        ],
    })  # fmt: skip
    m.json["extensions"] = {"VRMC_vrm_animation": {
        "humanoid": {"humanBones": {"hips": {"node": hips}}}, "expressions": {"preset": {"aa": {"node": face}}},
    }}  # fmt: skip
    found = vt.load(m.glb(tmp_path / "a.vrma"))
    assert isinstance(found, vt.Motion) and found.fps == 10
    assert np.allclose(found.weights["aa"], [0, 1, 0.5]) and np.allclose(found.translation[:, 1], [0, 0.1, 0.2])


@pytest.mark.parametrize("loop", [False, True])
def test_vrma_out_and_in(tmp_path: Path, loop: bool) -> None:
    """Where the bones of the body go, those of the file go: measured by what both do to a third body."""
    body = vt.pack(vt.person(loa=1))
    s = body.skeleton
    rng = np.random.default_rng(5)
    t = np.arange(20) / 20 * 2 * np.pi
    turns = [Rotation.from_rotvec(np.outer(np.sin(t + k), rng.normal(size=3) * 0.4)).as_quat() for k in range(len(s))]
    place = 0.1 * np.stack([np.sin(t), np.cos(t) - 1, np.sin(2 * t)], -1)
    sent = vt.Motion(s, 25, np.stack(turns, 1), place, weights={"aa_action": np.abs(np.sin(t))}, loop=loop)
    report = vt.save(sent, tmp_path / "a.vrma")
    got = vt.load(tmp_path / "a.vrma")
    assert (got.fps, got.loop, len(got)) == (25, loop, 20) and report["bones"] == len(got.skeleton)
    assert np.allclose(got.weights["aa"], sent.weights["aa_action"], atol=1e-6)
    ours, theirs = joint_matrices(s, sent), joint_matrices(got.skeleton, got)
    a, b = joint_positions(s, ours), joint_positions(got.skeleton, theirs)
    for name, j in got.skeleton.index.items():
        i = s.index[name]
        # turns between frames are the same in the world, whatever the rest pose
        turn = ours[1:, i, :3, :3] @ ours[:1, i, :3, :3].transpose(0, 2, 1)
        same = theirs[1:, j, :3, :3] @ theirs[:1, j, :3, :3].transpose(0, 2, 1)
        assert np.abs(turn - same).max() < 1e-5, name
    for name in ("humanoid_root", "vl5", "skullbase", "l_shoulder"):  # nothing of LOA 1 is skipped up to here
        assert np.abs(a[:, s.index[name]] - b[:, got.skeleton.index[name]]).max() < 0.05, name
    assert np.abs(a[:, s.index["humanoid_root"]] - b[:, got.skeleton.index["humanoid_root"]]).max() < 1e-5


def test_vrma_of_a_capture(tmp_path: Path, shared: Path, referee: Path) -> None:
    from test_vrm import validated

    report = vt.save(vt.load(shared / "data" / "motion" / "makehuman_dance1.bvh"), tmp_path / "a.vrma")
    assert report["bones"] >= 15
    validated([tmp_path / "a.vrma"], referee)
