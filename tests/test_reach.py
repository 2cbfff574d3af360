"""Inverse kinematics: closed forms, limits and stiffness of the standard, kernel against twin, real bodies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import vitruvian as vt
from vitruvian import Goal, VitruvianError
from vitruvian.body.kinematics import joint_positions, pose_matrices, site_positions
from vitruvian.body.rotations import from_euler, from_vector, normalize, rotate
from vitruvian.body.types import Skeleton
from vitruvian.motion import solver
from vitruvian.motion.limits import angles, beyond, boxes, rotations, within
from vitruvian.motion.turns import world_rotations

FREE = (np.nan, np.nan)


def arm(elbow=FREE, stiffness=None) -> Skeleton:
    """Two bones of one metre along X that turn about Z."""
    limits = np.zeros((3, 3, 2))
    limits[:, 2] = np.nan
    limits[1, 2] = elbow
    return Skeleton(
        ("shoulder", "elbow", "tip"), [-1, 0, 1], [[0, 0, 0], [1, 0, 0], [2, 0, 0]], limits=limits, stiffness=stiffness
    )


def turned(skeleton: Skeleton, *degrees: float) -> vt.Motion:
    turn = np.zeros((1, len(skeleton), 4))
    turn[..., 3] = 1
    for j, angle in enumerate(degrees):
        turn[0, j] = from_vector([0, 0, np.radians(angle)])
    return vt.Motion(skeleton, 30.0, turn, np.zeros((1, 3)))


def bends(result: vt.Motion) -> np.ndarray:
    return np.degrees(angles(result.skeleton, result.rotation))[0, :2, 2]


def reached(skeleton: Skeleton, goal: list[float] | Goal, start=(5.0, 5.0), **more) -> vt.Motion:
    return vt.reach(
        skeleton,
        turned(skeleton, *start),
        {"tip": goal},
        joints=("shoulder", "elbow"),
        tolerance=1e-7,
        iterations=200,
        **more,
    )


def test_two_bones_have_closed_forms():
    """Note motion.md, 6: targets (1, 1), (0, 0.5), one that is 3 m away, and one within a limited elbow's dead zone."""
    assert np.allclose(bends(reached(arm(), [1, 1, 0])), [0, 90], atol=1e-4)
    assert np.allclose(bends(reached(arm(), [1, 1, 0], (80, -60))), [90, -90], atol=1e-4)
    assert abs(abs(bends(reached(arm(), [0, 0.5, 0]))[1]) - 151.045) < 1e-3
    far = reached(arm(), [3, 0, 0], (57, 57))
    assert not far.reached.any() and abs(far.residual[0, 0] - 1.0) < 1e-6
    assert "1000.0 mm missing" in far.notes[0]
    short = reached(arm((0, np.pi / 3)), [1, 1, 0])
    assert abs(short.residual[0, 0] - (3**0.5 - 2**0.5)) < 1e-6
    assert bends(short)[1] == pytest.approx(60, abs=1e-9)


def test_a_stretched_arm_bends_when_asked_along_itself():
    """On the straight line bending changes nothing at first order; limits tell which way is open."""
    result = reached(arm((0, 2.5)), [1.2, 0, 0], (0, 0))
    assert result.reached.all() and bends(result)[1] > 10


def test_stiffness_is_the_share_of_a_step():
    """1 holds an axis still; 0.9 leaves most of the way to the others; 0 everywhere is plain least squares."""
    still = np.zeros((3, 3))
    still[1] = 1.0
    result = reached(arm(stiffness=still), [0, 2, 0], (0, 20))
    assert bends(result)[1] == pytest.approx(20, abs=1e-9)
    stiff = np.zeros((3, 3))
    stiff[0] = 0.9
    lower = Goal(plane=[0, 1, 0, 0.3])  # one wish, two joints
    soft, hard = (bends(reached(arm(stiffness=s), lower, (10, 30))) for s in (None, stiff))
    assert abs(hard[0] - 10) < abs(soft[0] - 10)


def test_what_was_beyond_its_limits_only_comes_back():
    skeleton = arm((0, 1.0))
    result = reached(skeleton, [0, 0.5, 0], (5, 100))
    assert 57.29 < bends(result)[1] <= 100.0 + 1e-9  # it would need 151 degrees and may not go farther out
    back = reached(skeleton, [1.9, 0.5, 0], (5, 100))
    assert bends(back)[1] < 57.2958 and back.reached.all()


@given(st.integers(0, 10**6))
@settings(max_examples=60, deadline=None)
def test_angles_and_rotations_are_inverse(seed):
    rng = np.random.default_rng(seed)
    limits = np.sort(rng.uniform(-2.5, 2.5, (4, 3, 2)), axis=-1)
    limits[1, 1:] = 0.0  # a hinge
    limits[2] = np.nan
    limits[3, 0, 0] = np.nan
    frame = normalize(rng.normal(size=(4, 4)))
    skeleton = Skeleton(("a", "b", "c", "d"), [-1, 0, 1, 2], np.zeros((4, 3)), limits=limits, limit_orientation=frame)
    box = boxes(skeleton)
    turn = normalize(rng.normal(size=(5, 4, 4)))
    same = rotations(skeleton, angles(skeleton, turn))
    free = [0, 2, 3]
    assert np.abs(np.abs(np.sum(same * turn, axis=-1))[:, free] - 1).max() < 1e-9
    inside = within(skeleton, turn)
    assert np.abs(beyond(skeleton, inside)).max() < 1e-9
    assert np.array_equal(inside[:, 2], turn[:, 2])
    middle = np.clip(rng.uniform(-1, 1, (5, 4, 3)), box[..., 0], box[..., 1])
    assert np.abs(beyond(skeleton, rotations(skeleton, middle))).max() < 1e-9


def tree(rng: np.random.Generator, joints: int, scaled: bool) -> Skeleton:
    limits = np.full((joints, 3, 2), np.nan)
    for j in range(joints):
        kind = rng.integers(4)
        if kind == 1:
            limits[j] = np.sort(rng.uniform(-1.4, 1.4, (3, 2)), axis=-1)
        elif kind == 2:
            limits[j] = 0.0
            limits[j, rng.integers(3)] = [-1.0, 1.5]
        elif kind == 3:
            limits[j, 0] = [-0.5, 1.0]
    return Skeleton(
        tuple(f"j{i}" for i in range(joints)),
        [-1, *(int(rng.integers(max(0, i - 2), i)) for i in range(1, joints))],
        rng.normal(size=(joints, 3)),
        translation=rng.normal(size=(joints, 3)) * 0.1,
        scale=rng.uniform(0.6, 1.5, (joints, 3)) if scaled else None,
        limits=limits,
        limit_orientation=normalize(rng.normal(size=(joints, 4))),
        stiffness=rng.choice([0.0, 0.0, 0.3, 1.0], (joints, 3)),
    )


@pytest.mark.parametrize("seed", range(12))
def test_the_kernel_does_what_its_twin_does(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    joints, frames, wishes = 9, 3, 7
    skeleton = tree(rng, joints, seed % 3 == 2)
    if seed % 5 == 4:  # a second root, which the shift does not move
        skeleton = replace(skeleton, parents=[*skeleton.parents[:5], -1, *skeleton.parents[6:]])
    freedom = solver.Freedom(skeleton, np.arange(seed % 2, joints, dtype=np.int32), seed % 2 == 0)
    turn = within(skeleton, normalize(rng.normal(size=(frames, joints, 4)) * 0.2 + [0, 0, 0, 1]))
    place = np.concatenate([rng.normal(size=(frames, wishes, 3)) * 2, np.zeros((frames, wishes, 1))], axis=-1)
    kind = np.array([0, 0, 0, 1, 2, 3, 0], np.int32)
    place[:, 4] = normalize(rng.normal(size=(frames, 4)))
    place[1, 0] = np.nan
    axis = rng.normal(size=(wishes, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    asked = solver.Wishes(
        kind,
        rng.integers(2, joints, wishes).astype(np.int32),
        rng.normal(size=(wishes, 3)),
        axis,
        place,
        rng.uniform(0.2, 2, (frames, wishes)),
    )
    prior = solver.Prior(turn, np.zeros((frames, 3)), rng.uniform(0, 0.1, (joints, 3)), 0.01) if seed % 4 > 1 else None
    native = solver.solve(freedom, asked, turn, np.zeros((frames, 3)), prior=prior, iterations=8)
    monkeypatch.setattr(solver, "kernels", lambda: None)
    twin = solver.solve(freedom, asked, turn, np.zeros((frames, 3)), prior=prior, iterations=8)
    assert np.array_equal(native.steps, twin.steps)
    assert np.abs(native.error - twin.error).max() < 1e-7
    assert np.abs(native.rotation - twin.rotation).max() < 1e-7
    assert np.abs(native.shift - twin.shift).max() < 1e-7
    assert np.abs(beyond(skeleton, native.rotation)).max() < 1e-9
    assert np.isfinite(native.rotation).all()


def test_results_do_not_depend_on_threads():
    rng = np.random.default_rng(5)
    skeleton = tree(rng, 9, False)
    freedom = solver.Freedom(skeleton, np.arange(9, dtype=np.int32))
    turn = within(skeleton, normalize(rng.normal(size=(50, 9, 4)) * 0.2 + [0, 0, 0, 1]))
    place = np.concatenate([rng.normal(size=(50, 2, 3)) * 2, np.zeros((50, 2, 1))], axis=-1)
    asked = solver.Wishes(
        np.zeros(2, np.int32), np.array([8, 5], np.int32), np.zeros((2, 3)), np.zeros((2, 3)), place, np.ones((50, 2))
    )
    one, two = (solver.solve(freedom, asked, turn, np.zeros((50, 3)), threads=n).rotation for n in (1, 2))
    assert np.array_equal(one, two)
    alone = solver.solve(
        freedom,
        solver.Wishes(*(getattr(asked, f) for f in ("kind", "joint", "point", "axis")), place[7:8], asked.weight[7:8]),
        turn[7:8],
        np.zeros((1, 3)),
    )
    assert np.array_equal(alone.rotation[0], one[7])


@pytest.fixture(scope="module")
def person() -> vt.Body:
    return vt.pack(vt.person(hair="none"))


def places(body: vt.Body, motion: vt.Motion | None = None) -> dict[str, np.ndarray]:
    s = body.skeleton
    matrices = vt.joint_matrices(s, motion)
    return dict(
        zip(
            (*s.site_names, *s.names), np.concatenate([site_positions(s, matrices)[0], joint_positions(s, matrices)[0]])
        )
    )


def test_a_person_reaches_with_both_hands_and_a_foot(person):
    rest = places(person)
    goals = {
        "l_carpal_distal_phalanx_2_tip": rest["l_carpal_distal_phalanx_2_tip"] + [0.0, 0.5, 0.4],
        "r_carpal_distal_phalanx_2_tip": rest["l_shoulder"] + [0.02, -0.03, 0.1],
        "l_talocrural": rest["l_talocrural"] + [0.05, 0.3, 0.2],
    }
    result = vt.reach(person, None, goals)
    assert result.reached.all() and not result.notes
    now = places(person, result)
    for name, goal in goals.items():
        assert np.linalg.norm(now[name] - goal) < 1e-4
    assert np.abs(beyond(person.skeleton, result.rotation)).max() < 1e-9
    spine = [i for i, n in enumerate(person.skeleton.names) if n.startswith(("vl", "vt", "vc"))]
    assert np.array_equal(result.rotation[0, spine], person.skeleton.rotation[spine])  # limbs reach, the trunk stays
    knee = angles(person.skeleton, result.rotation)[0, person.skeleton.index["l_knee"]]
    assert knee[0] > 0.3


def test_the_root_may_move_while_the_feet_are_held(person):
    """A deep reach: the hand goes to the floor in front, the feet stay, because the pelvis may shift and turn."""
    rest = places(person)
    feet = {n: rest[n] for n in ("l_talocrural", "r_talocrural")}
    hand = {"r_carpal_distal_phalanx_3_tip": [-0.15, 0.05, 0.45]}
    assert not vt.reach(person, None, hand).reached.all()
    free = [
        n
        for n in person.skeleton.names
        if n.startswith(("vl", "vt")) or n.split("_", 1)[-1] in ("hip", "knee", "shoulder", "elbow")
    ]
    result = vt.reach(
        person, None, {**hand, **{n: Goal(p, weight=10) for n, p in feet.items()}}, joints=free, root=True
    )
    assert result.reached.all(), result.notes
    now = places(person, result)
    assert all(np.linalg.norm(now[n] - p) < 2e-4 for n, p in feet.items())


def test_looking_turning_and_lying_on_a_plane(person):
    s = person.skeleton
    at = np.array([1.0, 1.3, 1.0])
    result = vt.reach(person, None, {"skullbase": Goal(look_at=at)}, tolerance=1e-6)
    head = s.index["skullbase"]
    trunk = [i for i, n in enumerate(s.names) if n.startswith(("vl", "vt"))]
    assert np.array_equal(result.rotation[0, trunk], s.rotation[trunk])  # a glance does not lean
    world = world_rotations(s.parents, result.rotation)
    eye = places(person, result)["skullbase"]
    want = (at - eye) / np.linalg.norm(at - eye)
    assert np.degrees(np.arccos(np.clip(rotate(world[0, head], [0.0, 0.0, 1.0]) @ want, -1, 1))) < 0.01
    turn = from_euler([0.2, 0.3, -0.4])
    palm = vt.reach(
        person, None, {"l_radiocarpal": Goal(places(person)["l_radiocarpal"] + [0, 0.3, 0.3], rotation=turn)}
    )
    assert palm.reached.all()
    hand = world_rotations(s.parents, palm.rotation)[0, s.index["l_radiocarpal"]]
    assert 2 * np.arccos(min(1.0, abs(hand @ turn))) < 2e-3
    wall = vt.reach(person, None, {"l_carpal_distal_phalanx_2_tip": Goal(plane=[0, 0, 2, 0.5])})
    assert abs(places(person, wall)["l_carpal_distal_phalanx_2_tip"][2] - 0.5) < 1e-4


def test_a_clip_is_changed_frame_by_frame(person):
    clip = vt.walk(person.skeleton)
    tip = "l_carpal_distal_phalanx_2_tip"
    matrices = vt.joint_matrices(person.skeleton, clip)
    goal = site_positions(person.skeleton, matrices)[:, person.skeleton.site_index[tip]] + [0.0, 0.1, 0.1]
    result = vt.reach(person, clip, {tip: goal})
    assert result.reached.all() and result.residual.shape == (len(clip), 1) and result.fps == clip.fps
    one = vt.reach(
        person, vt.Motion(clip.skeleton, clip.fps, clip.rotation[3:4], clip.translation[3:4]), {tip: goal[3]}
    )
    assert np.allclose(one.rotation[0], result.rotation[3], atol=1e-12)


def test_standard_names_find_their_sites(person):
    rest = places(person)["l_carpal_distal_phalanx_2_tip"]
    for name in ("l_carpal_distal_phalanx_2", "l_index_distal_tip"):
        assert vt.reach(person, None, {name: rest + [0, 0.1, 0.1]}).reached.all()


@pytest.mark.parametrize(
    ("goals", "more", "message"),
    [
        ({}, {}, "at least one"),
        ({"l_carpal_distal_falanx_2_tip": [0, 0, 0]}, {}, "near: l_carpal_distal_phalanx_2_tip"),
        ({"l_radiocarpal": [0, 0]}, {}, r"expected shape \(3,\)"),
        ({"l_radiocarpal": [0, np.nan, 0]}, {}, "finite"),
        ({"l_radiocarpal": Goal()}, {}, "none of them"),
        ({"l_radiocarpal": Goal([0, 1, 0], weight=0)}, {}, "positive weight"),
        ({"l_radiocarpal": Goal(plane=[0, 0, 0, 1])}, {}, "direction"),
        ({"l_radiocarpal": [0, 1, 0]}, {"joints": ["elbo"]}, "no joint 'elbo'"),
    ],
)
def test_wrong_questions_get_one_line(person, goals, more, message):
    with pytest.raises(VitruvianError, match=message) as error:
        vt.reach(person, None, goals, **more)
    assert "\n" not in str(error.value)


def test_every_real_figure_can_reach(shared):
    """Other people's files: hands of JinLOA1, Nancy and Joe, with whatever limits they have."""
    from vitruvian import pack

    for name in ("JinLOA1.x3d", "NancyPrototypes.wrl", "JoeHAnimKick1a.x3dv"):
        with pytest.warns() if name.startswith("Joe") else __import__("contextlib").nullcontext():
            body = pack(vt.load(shared / "data" / "hanim" / name))
        s = body.skeleton
        wrist = next(n for n in s.names if n in ("l_radiocarpal", "l_wrist"))
        mats = pose_matrices(s, s.rotation[None], s.translation[None])
        at = joint_positions(s, mats)[0, s.index[wrist]]
        size = np.ptp(s.centers[:, 1])
        result = vt.reach(body, None, {wrist: at + size * np.array([0.0, 0.05, 0.05])}, tolerance=1e-4 * size)
        assert result.reached.all(), (name, result.notes)
