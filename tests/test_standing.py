"""Bodies in other poses come to the standard's; what they did before, they still do in space."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import vitruvian as vt
from vitruvian.body.kinematics import joint_matrices, joint_positions, move, site_positions
from vitruvian.body.rotations import from_axis_angle, to_axis_angle
from vitruvian.errors import VitruvianError
from vitruvian.hanim import tables
from vitruvian.hanim.build import scene_of
from vitruvian.hanim.doctor import check
from vitruvian.hanim.humanoid import Displacer, Humanoid
from vitruvian.hanim.normals import turned
from vitruvian.modeling.standing import standard_pose
from vitruvian.motion.lowering import lowered
from vitruvian.motion.tracks import motion_data, motion_of, tracks_of


@cache
def person(loa: int = 2) -> Humanoid:
    return vt.person(loa=loa, outfit=None, hair="none")


def baked(h: Humanoid, turns: dict[str, tuple]) -> Humanoid:
    """A body modelled in another pose: its surface and centres are what these turns make of the person's."""
    posed = h.copied()
    for name, turn in turns.items():
        posed.joint(name).rotation = np.array(turn, float)
    body = vt.pack(posed)
    matrices = joint_matrices(body.skeleton)[0]
    out = h.copied()
    out.skin_coord = vt.deformer("log", body)(matrices).astype(float)[: len(h.skin_coord)]
    for joint, m in zip(out.joints(), matrices, strict=True):
        joint.center = move(m, joint.center)
        joint.displacers = [replace(d, displacements=d.displacements @ m[:3, :3].T) for d in joint.displacers]
        for home in joint.segments:
            home.sites = [replace(s, translation=move(m, s.translation)) for s in home.sites]
    out.loa = h.loa
    return out


T_POSE = {"l_shoulder": (0, 0, 1, 1.35), "r_shoulder": (0, 0, 1, -1.35)}
A_POSE = {
    "l_shoulder": (0, 0, 1, 0.7),
    "r_shoulder": (0, 0, 1, -0.7),
    "l_hip": (0, 0, 1, 0.15),
    "r_hip": (0, 0, 1, -0.15),
}
TURNED = {"humanoid_root": (0, 1, 0, 1.2), **T_POSE}


def direction(h: Humanoid, a: str, b: str) -> np.ndarray:
    c = {tables.canonical(j.name): j.center for j in h.joints()}
    return (c[b] - c[a]) / np.linalg.norm(c[b] - c[a])


@pytest.mark.parametrize("turns", [T_POSE, A_POSE, TURNED], ids=["T", "A", "turned"])
@pytest.mark.parametrize("loa", [1, 2])
def test_poses_become_the_standard_one(turns: dict, loa: int) -> None:
    h = baked(person(loa), turns)
    out, lost = standard_pose(h)
    for side, sign in (("l_", 1), ("r_", -1)):
        arm = direction(out, side + "shoulder", side + "elbow")
        assert -arm[1] > np.cos(np.radians(15))
        np.testing.assert_allclose(direction(out, side + "elbow", side + "radiocarpal"), [0, -1, 0], atol=1e-6)
        np.testing.assert_allclose(direction(out, side + "hip", side + "knee"), [0, -1, 0], atol=1e-6)
        if loa == 2:
            np.testing.assert_allclose(
                direction(out, side + "carpometacarpal_1", side + "metacarpophalangeal_1"),
                [0, -np.sqrt(0.5), np.sqrt(0.5)],
                atol=1e-6,
            )
            knuckles = [direction(out, side + "radiocarpal", f"{side}metacarpophalangeal_{k}") for k in (2, 5)]
            palm = np.cross(*knuckles) * -sign
            assert palm[0] * -sign > 0.99 * np.linalg.norm(palm)  # inwards
        assert direction(out, side + "talocrural", side + "metatarsophalangeal_2")[2] > 0.8
    assert abs(out.skin_coord[:, 1].min()) < 1e-7
    assert all((j.rotation[3], *j.translation) == (0, 0, 0, 0) and (j.scale == 1).all() for j in out.joints())
    assert not {"P01", "P04", "P05"} & {f.rule for f in check(scene_of([out])[0])}
    # the person that it was made from stands so too: bones, surface, feature points
    np.testing.assert_allclose(out.skin_coord, person(loa).skin_coord, atol=0.04)
    truth = {s.name: s.translation for s in person(loa).all_sites()}
    assert max(np.abs(s.center + s.translation - truth[s.name]).max() for s in out.all_sites()) < 0.03
    assert out.scene is None
    assert all("limits" in x for x in lost)


def test_twice_is_once() -> None:
    once, _ = standard_pose(baked(person(2), T_POSE))
    twice, lost = standard_pose(once)
    assert lost == []
    np.testing.assert_allclose(once.skin_coord, twice.skin_coord, atol=2e-3)
    for a, b in zip(once.joints(), twice.joints()):
        np.testing.assert_allclose(a.center, b.center, atol=2e-3)


@pytest.mark.parametrize("kind", ["tracks", "motion"])
@pytest.mark.parametrize("how", ["made so", "rest rotations"])
def test_clips_move_the_same_in_space(kind: str, how: str) -> None:
    if how == "made so":
        h = baked(person(2), TURNED)
    else:
        h = person(2).copied()
        for name, turn in TURNED.items():
            h.joint(name).rotation = np.array(turn, float)
        h.joint("l_knee").translation = np.array([0, 0.01, 0.02])
    a = vt.pack(h)
    clip = vt.walk(vt.pack(person(2)).skeleton, fps=20)
    clip = replace(clip, skeleton=a.skeleton, weights={"jaw_open_action": np.linspace(0, 1, len(clip))})
    h = replace(h, tracks=tracks_of(clip, timer="w")) if kind == "tracks" else replace(h, motions=[motion_data(clip)])
    out, _ = standard_pose(h)
    b = vt.pack(out)
    m, n = motion_of(h, a.skeleton, fps=50), motion_of(out, b.skeleton, fps=50)
    before, after = joint_matrices(a.skeleton, m), joint_matrices(b.skeleton, n)
    np.testing.assert_allclose(
        joint_positions(a.skeleton, before), joint_positions(b.skeleton, after), atol=2e-6 if kind == "motion" else 1e-9
    )
    np.testing.assert_allclose(site_positions(a.skeleton, before), site_positions(b.skeleton, after), atol=2e-6)
    for joint in ("l_shoulder", "skullbase"):  # what hangs on one joint alone moves exactly, too
        i = a.skeleton.index[joint]
        d, e = (next(iter(x.joint("skullbase").displacers)).displacements for x in (h, out))
        if joint == "skullbase":
            np.testing.assert_allclose(before[3, i, :3, :3] @ d[0], after[3, i, :3, :3] @ e[0], atol=1e-8)
    if kind == "tracks":
        kept = [t for t in out.tracks if t.field == "weight"]
        assert [t.target for t in kept] == ["jaw_open_action"]


def test_segments_sites_and_masses_follow(shared: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        h = vt.load(shared / "data" / "hanim" / "JinLOA1.x3d")
    for name, turn in T_POSE.items():
        h.joint(name).rotation = np.array(turn, float)
    home = h.joint("l_elbow").segments[0]
    home.mass, home.center_of_mass = 2.0, h.joint("l_elbow").center + 1.0
    home.moments_of_inertia = np.diag([1.0, 2, 3]).reshape(9)
    home.displacers = [Displacer("flex_action", np.array([0], np.int32), np.array([[0.0, 0, 3.0]]), weight=1.0)]
    a = vt.pack(h)
    matrices = joint_matrices(a.skeleton)
    out, _ = standard_pose(h)
    b = vt.pack(out)
    i = a.skeleton.index["l_elbow"]
    moved = (joint_matrices(b.skeleton)[0, i]) @ np.eye(4)
    np.testing.assert_allclose(moved, np.eye(4), atol=1e-12)
    new = out.joint("l_elbow").segments[0]
    # distances within a rigid part stay what they were
    old_arm = np.linalg.norm(turned(home.shapes[0]).points - home.center_of_mass, axis=1)
    new_arm = np.linalg.norm(new.shapes[0].points - new.center_of_mass, axis=1)
    np.testing.assert_allclose(old_arm, new_arm, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.eigvalsh(new.moments_of_inertia.reshape(3, 3)), [1, 2, 3], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(new.displacers[0].displacements), 3.0)
    assert -direction(out, "l_shoulder", "l_elbow")[1] > np.cos(np.radians(15))
    assert matrices.shape[1] == len(out.joints())
    assert home.shapes[0].points is h.joint("l_elbow").segments[0].shapes[0].points


def test_limits_of_turned_joints_are_told() -> None:
    h = baked(person(2), T_POSE)
    assert len(h.joint("l_shoulder").llimit)
    out, lost = standard_pose(h)
    assert len(out.joint("l_shoulder").llimit) == 0
    assert any("limits" in x and "l_shoulder" in x for x in lost)
    np.testing.assert_array_equal(out.joint("l_knee").llimit, h.joint("l_knee").llimit)


def test_a_joint_without_size_is_named() -> None:
    h = person(2).copied()
    h.joint("l_knee").scale = np.array([1.0, 0, 1])
    with pytest.raises(VitruvianError, match="joint l_knee: expected a scale above zero"):
        standard_pose(h)
    with pytest.raises(VitruvianError, match="joint l_knee"):
        lowered(h, "2.0", loa=1)


def test_scaled_joints_become_surface() -> None:
    h = person(1).copied()
    h.joint("skullbase").scale = np.full(3, 1.2)
    a = vt.pack(h)
    before = vt.deformer("linear", a)(joint_matrices(a.skeleton))[0]
    out, lost = standard_pose(h, deformer="linear")
    assert any("scales of joints" in x for x in lost)
    top = a.skin.weights.joint == a.skeleton.index["skullbase"]
    head = a.skin.weights.vertex[top & (a.skin.weights.weight > 0.999)]
    np.testing.assert_allclose(np.ptp(out.skin_coord[head], axis=0), np.ptp(before[head], axis=0), atol=1e-5)


def test_a_body_of_parts_and_an_upside_down_axis(shared: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        hand = vt.load(shared / "data" / "hanim" / "HAnimModelHandLeft.x3d")
    out, _ = standard_pose(hand)
    assert len(out.joints()) == len(hand.joints())
    lying = baked(person(1), {"humanoid_root": (1, 0, 0, -np.pi / 2)})  # modelled with Z up
    up, _ = standard_pose(lying)
    np.testing.assert_allclose(up.skin_coord, person(1).skin_coord, atol=0.04)
    turn = from_axis_angle(up.joints()[0].rotation)
    np.testing.assert_allclose(to_axis_angle(turn)[3], 0)
