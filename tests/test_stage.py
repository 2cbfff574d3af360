"""The stage: whole frames, interception, time, systems, levels, extremities, replay."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import vitruvian as vt
from capsules import about, capsule_body, capsule_clip, stride
from pages import find, opened, pause, scrub
from test_server import dial, hello, receive
from vitruvian.body.contours import grid, limb
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.rotations import from_axis_angle, from_matrix, multiply, to_axis_angle
from vitruvian.body.types import Body, Skeleton, Skin, Weights
from vitruvian.deform.deformer import deformer
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.motion.clips import sample
from vitruvian.motion.types import Motion
from vitruvian.show.actors import actors_of, actors_on
from vitruvian.show.live import Window, serve, show
from vitruvian.show.recording import messages
from vitruvian.show.server import Server
from vitruvian.show.showing import Showing
from vitruvian.show.wire import decode
from vitruvian.stage.actor import Actor
from vitruvian.stage.clock import Clock
from vitruvian.stage.events import HOLD, KINDS, Event


def arm(count: int = 15, points: int = 16) -> Body:
    """An arm of two contour surfaces along -Y, the elbow a unit below the shoulder."""
    skeleton = Skeleton(("l_shoulder", "l_elbow"), np.array([-1, 0]), np.array([[0.0, 0, 0], [0, -1, 0]]))
    angle = np.arange(points) * 2 * np.pi / points
    ring = 0.2 * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], -1)
    rest = np.concatenate([ring + [0, -y, 0] for j in (0, 1) for y in np.linspace(j, j + 1, count)])
    numbers = np.arange(2 * count * points).reshape(2, count, points)
    surfaces = (limb("upper", numbers[0], 0, 1, lower=5), limb("lower", numbers[1], 1, None, upper=5))
    triangles = np.concatenate([grid(n.astype(np.int32), True) for n in numbers])
    vertex = np.arange(len(rest))
    weights = Weights.from_pairs(len(rest), vertex, np.repeat([0, 1], count * points), np.ones(len(rest)))
    return Body("arm", skeleton, Skin(rest, triangles, weights), contours=surfaces)


def bending(body: Body, frames: int = 30) -> Motion:
    """The elbow bends from 0 to 2 radians within a second, at 30 frames a second."""
    rotation = np.zeros((frames, len(body.skeleton), 4))
    rotation[..., 3] = 1
    rotation[:, body.skeleton.index["l_elbow"]] = about("x", np.linspace(0, 2.0, frames))
    return Motion(body.skeleton, 30.0, rotation, np.zeros((frames, 3)))


def elbow(posed) -> float:
    """The angle of the elbow, out of its published joint matrices."""
    return float(np.linalg.norm(to_axis_angle(posed.rotation[posed.body.skeleton.index["l_elbow"]])[3]))


def off(posed, joints=None) -> float:
    """How far (m) published points are from where the contours have to be at the angle of the published joints."""
    body = posed.body
    relative = (posed.joints if joints is None else joints)[1, :3, :3]
    angle = np.arctan2(relative[2, 1], relative[1, 1])  # about x
    q = np.zeros((1, 2, 4))
    q[..., 3] = 1
    q[0, 1] = about("x", np.array([angle]))[0]
    wanted = deformer("contours", body)(joint_matrices(body.skeleton, Motion(body.skeleton, 30, q, np.zeros((1, 3)))))
    return float(np.abs(posed.vertices - wanted[0]).max())


def arm_stage(**options) -> vt.Stage:
    body = arm()
    return vt.Stage([vt.Clip(Humanoid(name="arm"), body, bending(body), "contours")], rate=30, **options)


def test_no_frame_has_joints_and_points_of_different_poses():
    stage = arm_stage()
    frames = [stage.frame, *(stage.step() for _ in range(29))]
    angles = [elbow(f["arm"]) for f in frames]
    np.testing.assert_allclose(angles, np.linspace(0, 2, 30), atol=1e-9)
    assert max(off(f["arm"]) for f in frames) < 1e-6


def test_the_fork_shows_turned_joints_without_their_points():
    """Sent to both, the joint turns at once and the points come when they are ready: here one frame later."""
    stage = arm_stage()
    frames = [stage.frame, *(stage.step() for _ in range(29))]
    forked = [off(late["arm"], now["arm"].joints) for now, late in zip(frames[1:], frames)]
    whole = [off(f["arm"]) for f in frames[1:]]
    assert min(forked) > 0.01 and max(whole) < 1e-6  # a centimetre in every frame


def test_points_of_another_pose_are_not_published():
    """A system that turns joints when the points are there already: the fork again, and refused."""
    stage = arm_stage()
    before = stage.step()

    def late(s, dt):
        draft = s.draft("arm")
        draft.joints = draft.matrices = joint_matrices(s.actors["arm"].skeleton)[0]

    system = stage.add(late, after="deform")
    with pytest.raises(VitruvianError, match="points of arm belong to another pose"):
        stage.step()
    assert stage.frame is before and stage.actors["arm"].posed is before["arm"]
    stage.systems.remove(system)
    assert off(stage.step()["arm"]) < 1e-6
    names = [s.name for s in stage.systems]
    k, d = names.index("kinematics"), names.index("deform")
    stage.systems[k], stage.systems[d] = stage.systems[d], stage.systems[k]
    with pytest.raises(VitruvianError, match="after kinematics"):
        stage.step()


def test_updates_of_one_time_stamp_make_one_computation_and_the_last_wins():
    stage = vt.Stage([Actor("arm", arm(), deformer="contours")])
    start = stage.workshop.computed
    for k in range(10):
        stage.send("rotation", "arm", "l_elbow" if k % 2 else "l_shoulder", about("x", np.array([0.1 * k]))[0])
    posed = stage.step()["arm"]
    assert stage.workshop.computed == start + 1
    assert elbow(posed) == pytest.approx(0.9) and to_axis_angle(posed.rotation[0])[3] == pytest.approx(0.8)
    assert stage.step()["arm"] is posed and stage.step()["arm"] is posed  # nothing came: nothing is computed
    assert stage.workshop.computed == start + 1
    stage.send("rotation", "arm", "l_elbow", about("x", np.array([1.4]))[0], time=0.5)
    stage.send("rotation", "arm", "l_elbow", about("x", np.array([0.2]))[0], time=0.3)
    seen = {round(f.time, 3): elbow(f["arm"]) for f in (stage.step() for _ in range(60))}
    assert seen[0.283] == pytest.approx(0.9) and seen[0.3] == pytest.approx(0.2)
    assert seen[0.483] == pytest.approx(0.2) and seen[0.5] == pytest.approx(1.4)
    assert stage.workshop.computed == start + 3


def halved(stage, event):
    return replace(event, value=from_axis_angle(to_axis_angle(event.value) * [1, 1, 1, 0.5]))


def test_a_hook_that_halves_is_seen_in_pose_and_points():
    stage = arm_stage()
    seen = []
    stage.intercept(lambda s, e: seen.append((e.name, e.old)) or halved(s, e), name="l_elbow")
    for k in range(1, 29):
        posed = stage.step()["arm"]
        assert elbow(posed) == pytest.approx(np.linspace(0, 2, 30)[k] / 2) and off(posed) < 1e-6
    assert {n for n, _ in seen} == {"l_elbow"} and len(seen) == 28
    assert to_axis_angle(seen[20][1])[3] == pytest.approx(np.linspace(0, 2, 30)[20] / 2)  # what the joint had


def test_hooks_drop_hold_and_replace():
    stage = vt.Stage([Actor("arm", arm(), deformer="contours")])
    answers = {}
    asked = []

    def gate(s, event):
        asked.append(event.value)
        return answers.get(s.clock.tick, event)

    hook = stage.intercept(gate, actor="arm", name="l_elbow")
    turn = lambda a: about("x", np.array([a]))[0]  # noqa: E731
    stage.send("rotation", "arm", "l_elbow", turn(1.0))
    answers[1] = None
    still = stage.step()["arm"]
    assert elbow(still) == 0 and stage.step()["arm"] is still and len(asked) == 1  # dropped, not asked again
    answers |= {3: HOLD, 4: HOLD}
    stage.send("rotation", "arm", "l_elbow", turn(0.7))
    assert elbow(stage.step()["arm"]) == 0 == elbow(stage.step()["arm"])
    assert elbow(stage.step()["arm"]) == pytest.approx(0.7) and len(asked) == 4  # held twice, then let through
    answers[6] = Event("rotation", "arm", "l_elbow", turn(0.2))
    stage.send("rotation", "arm", "l_elbow", turn(2.0))
    assert elbow(stage.step()["arm"]) == pytest.approx(0.2)
    stage.hooks.remove(hook)
    assert elbow(stage.step()["arm"]) == pytest.approx(2.0)  # nobody stands between any more


def test_hooks_see_turns_levels_time_and_events_of_ones_own():
    clip = capsule_clip(vertices=600)
    stage = vt.Stage([clip])
    limit = np.array([0.0, 0, 0, 1])
    stage.intercept(lambda s, e: replace(e, value=limit), name="l_knee")  # a joint that may not bend
    stage.intercept(lambda s, e: replace(e, value=min(e.value, 2.0)), "speed")
    stage.intercept(lambda s, e: None, "deformer")
    stage.kinds["cue"] = lambda value, where: value
    stage.intercept(lambda s, e: HOLD if s.clock.tick < 3 else e, "cue")
    stage.send("turn", "capsules", "l_knee", about("x", np.array([1.0]))[0])
    stage.send("deformer", "capsules", "linear")
    stage.send("cue", value="enter left")
    stage.speed(4)
    frames = [stage.step() for _ in range(3)]
    for frame in frames:
        posed = frame["capsules"]
        np.testing.assert_array_equal(posed.rotation[posed.body.skeleton.index["l_knee"]], limit)
        assert posed.deformer == "log"
        np.testing.assert_array_equal(posed.vertices, deformer("log", clip.body)(posed.matrices))
    assert [[e.kind for e in f.events] for f in frames] == [["speed", "turn"], [], ["cue"]]
    assert stage.clock.speed == 2.0 and frames[2].events[0].value == "enter left"


def test_a_stage_plays_what_the_motion_says():
    clip = capsule_clip(vertices=600)
    wanted = joint_matrices(clip.body.skeleton, clip.motion)
    stage = vt.Stage([clip], rate=90)
    for k in range(1, 3 * 36):
        posed = stage.step()["capsules"]
        if k % 3 == 0:
            np.testing.assert_array_equal(posed.matrices, wanted[k // 3])
        elif k < 3 * 35:
            np.testing.assert_allclose(posed.rotation, sample(clip.motion, np.array([k / 90])).rotation[0], atol=1e-6)
    assert stage.frame["capsules"].placement[2, 3] == 0
    seam = stage.frame["capsules"].matrices[0, 2, 3]
    posed = stage.step()["capsules"]  # the next round begins where the first one led
    np.testing.assert_allclose(posed.placement[:3, 3], [0, 0, 1.3], atol=0.02)
    step = posed.placement[2, 3] + posed.matrices[0, 2, 3] - seam
    assert posed.round == 1 and 0 < step < 0.05


def test_turns_weights_and_clear():
    body = capsule_body(vertices=600)
    stage = vt.Stage([vt.Clip(Humanoid(name="capsules"), body, stride(body))], rate=30)
    turn = about("y", np.array([0.7]))[0]
    stage.send("turn", "capsules", "l_shoulder", turn)
    stage.send("weight", "capsules", "chin_action", 0.5)
    posed = stage.step()["capsules"]
    j = body.skeleton.index["l_shoulder"]
    np.testing.assert_allclose(posed.rotation[j], multiply(turn, stride(body).rotation[1, j]), atol=1e-15)
    want = deformer("log", body)(posed.matrices, {"chin_action": 0.5})
    np.testing.assert_array_equal(posed.vertices, want)
    assert posed.weights.tolist() == [0.5, 0.0]
    stage.send("weight", "capsules", "chin_action", None)
    stage.send("turn", "capsules", "l_shoulder", None)
    stage.send("weight", "capsules", "grow_action", 1)
    assert stage.step(0)["capsules"].weights.tolist() == [0.0, 1.0]
    stage.send("clear", "capsules")
    posed = stage.step(0)["capsules"]
    np.testing.assert_array_equal(posed.matrices, joint_matrices(body.skeleton, stride(body))[1])
    assert not posed.weights.any()


def test_weights_that_a_motion_drives_reach_the_points():
    body = capsule_body(vertices=600)
    motion = replace(stride(body), weights={"chin_action": np.linspace(0, 1, 36)})
    stage = vt.Stage([vt.Clip(Humanoid(name="c"), body, motion)], rate=30)
    for k in (1, 2, 3):
        posed = stage.step()["capsules"]
        np.testing.assert_array_equal(posed.vertices, deformer("log", body)(posed.matrices, {"chin_action": k / 35}))


def test_the_clock_counts():
    stage = vt.Stage([capsule_body(vertices=300)])
    stage.speed(0.5)
    stage.step(0)
    made = 0
    for _ in range(600):  # ten seconds outside
        before = stage.clock.tick
        stage.advance(1 / 60)
        made += stage.clock.tick - before
    assert made == 300 and stage.frame.time == 5.0 and stage.clock.dropped == 0
    stage.pause()
    assert stage.step().time == 5.0 == stage.step(3).time
    assert stage.advance(1.0) is stage.frame
    stage.seek(1.25)
    assert stage.step().time == 1.25  # the moment it leapt to
    stage.play()
    assert stage.step().time == pytest.approx(1.25 + 1 / 60)
    stage.speed(-1)
    assert stage.step(30).time == pytest.approx(1.25 + 1 / 60 - 0.5)
    assert stage.step(200).time == 0 and not stage.clock.playing


def test_rounds_and_ends():
    clock = Clock(30, 1.2, last=35 / 30)
    clock.move(36)
    assert (clock.round, clock.time) == (1, 0.0)
    clock.move(35)
    assert clock.round == 1 and clock.time == pytest.approx(35 / 30)
    clock.loop = False
    clock.move(7)
    assert clock.round == 1 and clock.time == pytest.approx(35 / 30) and not clock.playing
    clock.play()
    assert clock.time == pytest.approx(0) and clock.round == 1
    clock.move(3)
    clock.pace(300)
    clock.move(1)
    assert clock.time == pytest.approx(0.1 + 1 / 300)
    assert clock.due(0.01) == 3 and clock.due(0.0017) == 0 and clock.due(0.0017) == 1
    with pytest.raises(VitruvianError, match="rate"):
        Clock(0)


def test_systems_run_in_their_order_and_simulations_miss_no_tick():
    stage = vt.Stage([capsule_body(vertices=300)])
    ran = []
    stage.add(lambda s, dt: ran.append("script"), name="script")
    stage.add(lambda s, dt: ran.append("early"), name="early", before="animate")
    stage.add(lambda s, dt: ran.append("cloth"), name="cloth", after="deform")
    stage.add(lambda s, dt: ran.append("contact"), name="contact", after="cloth")
    assert [s.name for s in stage.systems] == [
        "early", "animate", "script", "intercept", "kinematics", "deform", "cloth", "contact", "publish"
    ]  # fmt: skip
    stage.step(5)
    assert ran == ["early", "script", "cloth", "contact"]  # once: nobody has to see the ticks between
    for bad in (
        {"name": "cloth"},
        {"name": "x", "before": "nothing"},
        {"name": "x", "before": "deform", "after": "deform"},
    ):
        with pytest.raises(VitruvianError, match="system"):
            stage.add(print, **bad)
    times = []
    stage.add(lambda s, dt: times.append(dt), name="solver", after="deform", every=True)
    stage.step(5)
    assert times == pytest.approx([1 / 60] * 5)
    stage.advance(1.0)  # a second late: four ticks are made up for, the others are gone
    assert len(times) == 9 and stage.clock.dropped == 56
    stage.speed(-1)
    with pytest.raises(VitruvianError, match="simulates"):
        stage.step()


def test_a_system_between_can_turn_joints_in_the_same_tick_and_points_after():
    stage = vt.Stage([Actor("arm", arm(), deformer="contours")])
    stage.add(
        lambda s, dt: s.send("rotation", "arm", "l_elbow", about("x", np.array([s.clock.time]))[0]), name="script"
    )

    def lift(s, dt):
        draft = s.draft("arm")
        draft.vertices = draft.vertices + np.float32([0, 1, 0])

    stage.add(lift, name="flesh", after="deform")
    for _ in range(3):
        frame = stage.step()
        plain = replace(frame["arm"], vertices=frame["arm"].vertices - np.float32([0, 1, 0]))
        assert elbow(plain) == pytest.approx(frame.time) and off(plain) < 1e-6
    stage.pause()
    stage.systems = [s for s in stage.systems if s.name != "script"]
    lifted = stage.step()["arm"].vertices
    np.testing.assert_array_equal(stage.step()["arm"].vertices, lifted)  # not lifted twice
    with pytest.raises(VitruvianError, match="between two ticks"):
        stage.draft("arm")


def test_when_a_system_fails_nothing_is_published_and_the_stage_goes_on():
    stage = vt.Stage([Actor("arm", arm(), deformer="contours")])
    fail = [None]

    def system(s, dt):
        if fail[0] == "raise":
            raise RuntimeError("out of wood")
        if fail[0] == "nan":
            draft = s.draft("arm")
            draft.vertices = draft.vertices.copy()
            draft.vertices[7] = np.nan

    stage.add(system, name="carpenter", after="deform")
    stage.intercept(lambda s, e: e, name="l_elbow")  # hooks are asked again when what they let through was lost
    before = stage.step()
    for kind, error in (("raise", RuntimeError), ("nan", VitruvianError)):
        fail[0] = kind
        stage.send("rotation", "arm", "l_elbow", about("x", np.array([1.0]))[0])
        with pytest.raises(error, match="wood|vertex 7 of arm is not finite after carpenter"):
            stage.step()
        assert stage.frame is before and stage.actors["arm"].posed is before["arm"]
    fail[0] = None
    after = stage.step()["arm"]
    assert elbow(after) == pytest.approx(1.0) and off(after) < 1e-6
    inner = []
    stage.add(lambda s, dt: inner.append(pytest.raises(VitruvianError, s.step)), name="recursive")
    stage.step()
    assert "between two ticks" in str(inner[0].value)


@pytest.fixture(scope="module")
def sliced():
    return vt.pack(vt.contours(vt.person(outfit=None), density=0.5))


def folded(body, **rotations):
    stage = vt.Stage([Actor("p", body, deformer="contours")])
    for name, rotation in rotations.items():
        stage.send("rotation", "p", name, from_axis_angle(rotation))
    return stage


def test_levels_of_detail_are_subsets_to_the_bit(sliced):
    stage = folded(sliced, l_knee=[1, 0, 0, 1.2], vt6=[0, 1, 0, 0.4])
    full = stage.step()["p"]
    sizes = [len(full.vertices)]
    for level in (1, 2, 3):
        stage.send("level", "p", value=level)
        posed = stage.step()["p"]
        sizes.append(len(posed.vertices))
        np.testing.assert_array_equal(posed.vertices, full.vertices[posed.source])
        np.testing.assert_array_equal(posed.matrices, full.matrices)
        assert posed.normals.shape == posed.vertices.shape and len(posed.body.skin.rest) == sizes[-1]
    assert sizes == sorted(sizes, reverse=True) and len(set(sizes)) == 4
    computed = stage.workshop.computed
    stage.intercept(lambda s, e: None, "level")  # intercepted: the points stay
    stage.send("level", "p", value=0)
    assert stage.step()["p"] is posed and stage.workshop.computed == computed
    for bad in (4, -1, True, 1.5):
        with pytest.raises(VitruvianError, match="level"):
            stage.send("level", "p", value=bad)


def test_levels_are_given_to_other_bodies_and_at_run_time():
    body = capsule_body(vertices=600)
    stage = vt.Stage([body])
    with pytest.raises(VitruvianError, match="a body with contours"):
        stage.send("level", "capsules", value=1)
    kept = np.arange(0, len(body.skin.rest), 2)
    w = body.skin.weights
    place = np.full(len(w), -1)
    place[kept] = np.arange(len(kept))
    some = place[w.vertex] >= 0
    weights = Weights.from_pairs(len(kept), place[w.vertex[some]], w.joint[some], w.weight[some])
    half = replace(body, skin=Skin(body.skin.rest[kept], np.zeros((0, 3), np.int32), weights))
    stage.add_level("capsules", 1, half, kept)
    stage.send("level", "capsules", value=1)
    stage.send("weight", "capsules", "chin_action", 1.0)  # which this level does not have
    posed = stage.step()["capsules"]
    np.testing.assert_array_equal(posed.vertices, body.skin.rest[kept].astype(np.float32))
    with pytest.raises(VitruvianError, match="same joints"):
        stage.add_level("capsules", 2, arm(), np.arange(len(arm().skin.rest)))


def test_extremities_off_are_rigid_and_on_again_the_same(sliced):
    index = sliced.skeleton.index
    names = {"l_metacarpophalangeal_2": [0, 0, 1, 0.8], "r_metatarsophalangeal_1": [1, 0, 0, -0.5], "vc4": [0, 0.3, 1, 0.4],
             "l_radiocarpal": [0, 0, 1, 0.5], "skullbase": [0, 1, 0, 0.5]}  # fmt: skip
    stage = folded(sliced, **names)
    alive = stage.step()["p"]
    for name in ("fingers", "neck", "toes"):
        stage.send("extremity", "p", name, False)
    still = stage.step()["p"]
    np.testing.assert_array_equal(still.vertices, deformer("contours", sliced)(still.matrices))
    for joint, base in (("l_carpal_distal_interphalangeal_2", "l_radiocarpal"), ("vc1", "vt1")):
        np.testing.assert_array_equal(still.joints[index[joint]], still.joints[index[base]])
    np.testing.assert_array_equal(still.joints[index["skullbase"]], alive.joints[index["skullbase"]])
    wrist, weights = index["l_radiocarpal"], sliced.skin.weights
    hand = np.isin(weights.joint, [j for j in range(len(index)) if below(sliced.skeleton, j, wrist)])
    share = np.bincount(weights.vertex, weights.weight * hand, minlength=len(weights))
    rigid = np.flatnonzero(share > 1 - 1e-6)
    m = still.joints[wrist]
    np.testing.assert_allclose(still.vertices[rigid], sliced.skin.rest[rigid] @ m[:3, :3].T + m[:3, 3], atol=2e-6)
    assert np.abs(still.vertices - alive.vertices).max() > 0.01
    _, place = np.unique(sliced.skin.rest, axis=0, return_inverse=True)
    first = np.full(place.max() + 1, -1)
    first[place[::-1]] = np.arange(len(place))[::-1]
    for posed in (alive, still):  # points that meet at rest stay together, not a bit apart
        np.testing.assert_array_equal(posed.vertices, posed.vertices[first[place]])
    for name in ("fingers", "neck", "toes"):
        stage.send("extremity", "p", name, True)
    np.testing.assert_array_equal(stage.step()["p"].vertices, alive.vertices)
    plain = folded(sliced, l_knee=[1, 0, 0, 0.4])
    before = plain.step()["p"].vertices
    plain.send("extremity", "p", "fingers", False)
    np.testing.assert_array_equal(plain.step()["p"].vertices, before)  # at zero rotation to the bit


def below(skeleton, joint, root):
    while joint >= 0 and joint != root:
        joint = skeleton.parents[joint]
    return joint == root


def test_hands_are_static_surfaces_when_fingers_are_off():
    body = vt.pack(vt.person(outfit="body suit"))
    stage = vt.Stage([Actor("p", body, deformer="hand")])
    stage.send("rotation", "p", "l_metacarpophalangeal_3", from_axis_angle([0, 0, 1, -1.0]))
    assert stage.step()["p"].run.name == "hand"
    stage.send("extremity", "p", "fingers", False)
    posed = stage.step()["p"]
    assert posed.run.name == "log"
    np.testing.assert_allclose(posed.vertices, body.skin.rest, atol=2e-6)
    with pytest.raises(VitruvianError, match="expected one of fingers, neck, toes, found 'tail'"):
        stage.send("extremity", "p", "tail", False)


def test_deformers_are_switched_by_events():
    body = arm()
    stage = vt.Stage([Actor("arm", body)])
    stage.send("rotation", "arm", "l_elbow", about("x", np.array([1.5]))[0])
    for name, options in (
        ("log", {}),
        ("linear", {}),
        ("contours", {}),
        ("contours", {"survey": True}),
        ("log", {"steps": 3}),
    ):
        stage.send("deformer", "arm", name, options)
        posed = stage.step()["arm"]
        np.testing.assert_array_equal(posed.vertices, deformer(name, body, **options)(posed.matrices))
        assert posed.deformer == name
    for name, options in (
        ("melt", {}),
        ("log", {"stepps": 3}),
        ("log", {"follow": True}),
        ("log", {"steps": 9}),
        ("hand", {}),
    ):
        with pytest.raises(VitruvianError):
            stage.send("deformer", "arm", name, options)
    with pytest.raises(VitruvianError, match="contours"):
        vt.Stage([Actor("c", capsule_body(vertices=300), deformer="contours")])


@pytest.mark.parametrize("name", ["contours", "log", "volume", "linear"])
@pytest.mark.parametrize("sense", [1, -1])
def test_a_joint_may_be_wound_past_half_a_turn_and_back(name, sense):
    body = arm()
    if name != "contours":  # weights that blend
        share = np.clip(body.skin.rest[:, 1] / -1 - 0.5, 0, 1)
        vertex = np.arange(len(share))
        pairs = (np.tile(vertex, 2), np.repeat([0, 1], len(share)), np.concatenate([1 - share, share]))
        body = replace(body, skin=replace(body.skin, weights=Weights.from_pairs(len(share), *pairs)))
    degrees = sense * np.concatenate([np.arange(0, 331, 15.0), np.arange(330, -1, -15.0)])
    q = about("y", np.radians(degrees))
    motion = np.tile([0.0, 0, 0, 1], (len(q), 2, 1))
    motion[:, 1] = q
    wanted = deformer(name, body)(
        joint_matrices(body.skeleton, Motion(body.skeleton, 30, motion, np.zeros((len(q), 3))))
    )
    stage = vt.Stage([Actor("arm", body, deformer=name), Actor("twin", body, deformer=name)])
    worst = 0.0
    for k in range(len(q)):
        stage.send("rotation", "arm", "l_elbow", q[k] * (-1) ** k)  # either of the two quaternions of a rotation
        posed = stage.step()["arm"]
        worst = max(worst, float(np.abs(posed.vertices - wanted[k]).max()))
        assert (posed.path is not None) == (abs(degrees[k]) > 181)
    assert worst < 2e-6
    stage.send("rotation", "arm", "l_elbow", about("y", np.radians([200.0]))[0])
    assert stage.step()["arm"].path is None  # who leaps is not wound
    np.testing.assert_array_equal(stage.frame["arm"].vertices, deformer(name, body)(stage.frame["arm"].matrices))


def test_several_actors_share_a_computation_and_are_moved_alone():
    body = capsule_body(vertices=600)
    walk = vt.Clip(Humanoid(name="capsules"), body, stride(body))
    stage = vt.Stage([*[walk] * 6, Actor("still", body), Actor("other", body, deformer="linear")], rate=30)
    assert list(stage.actors) == ["capsules", *(f"capsules {k}" for k in range(2, 7)), "still", "other"]
    start = stage.workshop.computed
    frame = stage.step()
    assert stage.workshop.computed == start + 1  # six walk alike, two stand
    stage.send("turn", "capsules 3", "l_elbow", about("x", np.array([-1.0]))[0])
    stage.send("weight", "capsules 4", "chin_action", 1.0)
    stage.send("rotation", "other", "r_knee", about("x", np.array([0.5]))[0])
    frame = stage.step()
    assert stage.workshop.computed == start + 1 + 4
    for name, posed in frame.actors.items():
        morphs = {"chin_action": 1.0} if name == "capsules 4" else None
        np.testing.assert_array_equal(posed.vertices, deformer(posed.deformer, body)(posed.matrices, morphs))
    assert frame["capsules"].vertices is not frame["capsules 3"].vertices
    assert stage.actors["capsules"].posed.run is stage.actors["still"].posed.run  # bound once


def test_meshes_and_actors_that_are_left_to_the_page():
    box = vt.Mesh(np.eye(3), [[0, 1, 2]], name="box")
    body = capsule_body(vertices=300)
    stage = vt.Stage([box, body, body], leave=("log",))
    stage.send("turn", "capsules 2", "l_knee", about("x", np.array([1.0]))[0])
    frame = stage.step()
    assert frame["capsules"].matrices is not frame["capsules 2"].matrices
    np.testing.assert_array_equal(frame["capsules"].matrices, joint_matrices(body.skeleton)[0])
    stage.send("deformer", "capsules 2", "linear")
    posed = stage.step()["capsules 2"]
    np.testing.assert_array_equal(posed.vertices, deformer("linear", body)(posed.matrices))
    assert stage.workshop.computed == 1
    stage.send("deformer", "capsules 2", "log")
    frame = stage.step()
    assert frame["capsules 2"].vertices is None
    np.testing.assert_array_equal(frame["box"].points, np.eye(3))
    assert frame["capsules"].vertices is None and stage.workshop.computed == 1
    with pytest.raises(VitruvianError, match="points of capsules"):
        _ = frame["capsules"].points
    with pytest.raises(VitruvianError, match="box has no joints"):
        stage.send("rotation", "box", "x", [0, 0, 0, 1])
    for bad in ([], [3], [body, "walk.bvh"]):
        with pytest.raises(VitruvianError, match="stage"):
            vt.Stage(bad)


@pytest.mark.parametrize(
    "event",
    [("fly", "capsules"), ("rotation", "nobody", "l_elbow", [0, 0, 0, 1]), ("rotation", "capsules", "wing", [0, 0, 0, 1]),
     ("rotation", "capsules", "l_elbow", [0, 0, 0, 0]), ("rotation", "capsules", "l_elbow", [0, 0, np.nan, 1]),
     ("rotation", "capsules", "l_elbow", [0, 0, 1]), ("weight", "capsules", "frown", 1.0),
     ("weight", "capsules", "chin_action", float("inf")), ("weight", "capsules", "chin_action", "1"),
     ("translation", "capsules", "l_hip", [1, 2]), ("seek", "", "", -1.0), ("speed", "", "", 5), ("loop", "", "", 1),
     ("play", "", "", 1), ("extremity", "capsules", "fingers", 0), ("deformer", "capsules", "log", 3)],
)  # fmt: skip
def test_events_that_do_not_fit_are_refused_at_once(event):
    stage = vt.Stage([capsule_body(vertices=300)])
    with pytest.raises(VitruvianError) as caught:
        stage.send(*event)
    assert "\n" not in str(caught.value) and stage.sent == 0


def lively(seed: int, journal: bool) -> vt.Stage:
    """A stage with a script that throws dice, and a hook."""
    body = capsule_body(vertices=300)
    walk = vt.Clip(Humanoid(name="capsules"), body, stride(body))
    stage = vt.Stage([walk, Actor("still", body)], seed=seed, journal=journal)

    def nod(s, dt):
        if s.random.random() < 0.3:
            s.send("turn", "still", "skullbase", from_axis_angle([1, 0, 0, s.random.normal() * 0.2]))

    stage.add(nod)
    stage.intercept(halved, actor="still")
    return stage


def same(a, b) -> bool:
    assert (a.tick, a.time, a.round, list(a.actors)) == (b.tick, b.time, b.round, list(b.actors))
    return all(
        np.array_equal(getattr(p, f), getattr(q, f))
        for p, q in zip(a.actors.values(), b.actors.values())
        for f in ("vertices", "matrices", "rotation", "weights", "placement")
    )


def test_a_replay_is_equal_to_the_bit():
    live = lively(3, True)
    rng = np.random.default_rng(8)
    frames = []
    for k in range(60):
        if rng.random() < 0.4:
            live.send("turn", "capsules", "r_shoulder", from_axis_angle([0, 0, 1, rng.normal()]))
        if k == 20:
            live.seek(0.1)
            live.send("deformer", "still", "linear")
        if k == 40:
            live.speed(0.5)
        live.advance(rng.uniform(0, 0.1))
        frames.append(live.frame)
    again, made = lively(3, False), {}
    for frame in again.replay(live.journal[1:]):  # the first is the making of the stage
        made[frame.tick] = frame
    seen = {f.tick: f for f in frames}
    assert len(seen) > 20 and all(same(f, made[t]) for t, f in seen.items())
    other = [f for f in lively(4, False).replay(live.journal[1:])]
    assert not same(other[-1], made[other[-1].tick])  # another seed: other dice


def deformed(posed, morphs):
    """Points of a published pose, made by the deformer alone."""
    rows = posed.matrices[None] if posed.path is None else np.concatenate([posed.path, posed.matrices[None]])
    return deformer(posed.deformer, posed.body)(rows, morphs)[-1]


SMALL = capsule_body(vertices=200)
quaternions = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.01)
JOINTS = st.sampled_from(["l_elbow", "skullbase", "humanoid_root", "l_wrist"])
SENT = st.one_of(
    st.tuples(st.sampled_from(["rotation", "turn"]), JOINTS, quaternions),
    st.tuples(st.just("translation"), JOINTS, st.lists(st.floats(-2, 2), min_size=3, max_size=3)),
    st.tuples(st.just("weight"), st.sampled_from(["chin_action", "grow_action"]), st.none() | st.floats(-2, 2)),
    st.tuples(st.just("deformer"), st.sampled_from(["log", "linear", "volume", "hybrid"]), st.none()),
    st.tuples(st.just("extremity"), st.sampled_from(["fingers", "toes", "neck"]), st.booleans()),
    st.tuples(st.just("clear"), st.just(""), st.none()),
    st.tuples(st.sampled_from(["play", "pause"]), st.just(""), st.none()),
    st.tuples(st.just("seek"), st.just(""), st.floats(0, 3)),
    st.tuples(st.just("speed"), st.just(""), st.floats(-4, 4)),
    st.tuples(st.just("loop"), st.just(""), st.booleans()),
)


@given(st.lists(st.tuples(SENT, st.none() | st.floats(0, 2), st.integers(0, 3)), max_size=12), st.booleans())
@settings(max_examples=40, deadline=None)
def test_whatever_comes_every_frame_is_whole(sent, endless):
    body = SMALL
    stage = vt.Stage([vt.Clip(Humanoid(name="c"), body, stride(body))], length=np.inf if endless else 1.2)
    for (kind, name, value), time, ticks in sent:
        stage.send(
            kind, "" if kind not in KINDS or name == "" and kind != "clear" else "capsules", name, value, time=time
        )
        frame = stage.step(ticks)
        posed = frame["capsules"]
        morphs = dict(zip(("chin_action", "grow_action"), posed.weights))
        assert 0 <= frame.time <= (np.inf if endless else 1.2)
        np.testing.assert_array_equal(posed.vertices, deformed(posed, morphs))
        assert not posed.vertices.flags.writeable and not posed.matrices.flags.writeable


def wire_points(arrays, header, name):
    """(V,3) points of a frame message, and half of their quantum."""
    (entry,) = [b for b in header["blocks"] if b["actor"] == name and b["channel"] == "vertices"]
    q = arrays[name, "vertices"][:, :3].astype(float)
    return np.array(entry["origin"]) + q * entry["scale"] / 32767, entry["scale"] / 65534


def squared(rows):
    out = np.tile(np.eye(4), (len(rows), 1, 1))
    out[:, :3] = rows.reshape(-1, 3, 4)
    return out


def test_messages_to_pages_hold_points_and_the_pose_of_these_points():
    clip = capsule_clip(vertices=500, deformer="hybrid")
    showing = Showing(actors_of([clip]))
    run = deformer("hybrid", clip.body)
    turned = 0
    for k in range(12):
        showing.apply({"type": "seek", "frame": 3 * k})
        if k % 3 == 1 and k < 9:
            q = about("x", np.array([-0.3 * k]))[0].tolist()
            showing.apply({"type": "set_rotation", "actor": "capsules", "joint": "l_elbow", "rotation": q})
        if k == 9:
            showing.apply({"type": "clear_pose", "actor": "capsules"})
        header, arrays = decode(showing.frame(k))
        points, half = wire_points(arrays, header, "capsules")
        clip_pose = arrays["capsules", "pose"]
        posed = arrays.get(("capsules", "posed"), clip_pose)
        assert np.abs(points - run(squared(posed))).max() < half + 2e-6
        np.testing.assert_allclose(clip_pose, actors_of([clip])[0].poses[3 * k], atol=2e-6)  # what sliders start from
        turned += ("capsules", "posed") in arrays
        assert header["frame"] == pytest.approx(3 * k) and (("capsules", "posed") in arrays) == (1 <= k < 9)
    assert turned == 8


def test_recordings_hold_whole_frames_of_actors_with_rates_of_their_own():
    clip = capsule_clip(vertices=300, deformer="hybrid")
    slow = replace(clip, motion=Motion(clip.body.skeleton, 12.0, clip.motion.rotation[:9], clip.motion.translation[:9]))
    stored = [decode(m) for m in messages(Showing(actors_of([clip, slow])))]
    frames = [m for m in stored if m[0]["type"] == "frame"]
    assert len(frames) == 36
    run, wanted = deformer("hybrid", clip.body), sample(slow.motion, np.minimum(np.arange(36) / 30, 8 / 12))
    wanted = joint_matrices(clip.body.skeleton, wanted)
    for n, (header, arrays) in enumerate(frames):
        np.testing.assert_allclose(squared(arrays["capsules 2", "pose"]), wanted[n], atol=2e-6)
        for name in ("capsules", "capsules 2"):
            if (name, "vertices") in arrays:  # where the page does not deform by itself
                points, half = wire_points(arrays, header, name)
                assert np.abs(points - run(squared(arrays[name, "pose"]))).max() < half + 2e-6


def test_a_stage_is_shown_live_with_its_hooks_and_levels():
    body = arm()
    stage = vt.Stage([Actor("p", body, deformer="contours")])
    stage.intercept(lambda s, e: replace(e, value=from_axis_angle([1, 0, 0, 0.3])), name="l_elbow")
    showing = Showing(actors_on(stage), stage=stage)
    server = Server(showing)
    with Window(server, serve(server)) as window, dial(window) as ws:
        hello(window, ws)
        header, arrays = receive(ws, "mesh")
        full = len(arrays["p", "rest"])
        ws.send(json.dumps({"type": "pause"}))
        ws.send(json.dumps({"type": "set_rotation", "actor": "p", "joint": "l_elbow", "rotation": [1, 0, 0, 0]}))
        for _ in range(100):
            header, arrays = receive(ws, "frame")
            if ("p", "posed") in arrays:
                break
        points, half = wire_points(arrays, header, "p")
        elbow_ = body.skeleton.index["l_elbow"]
        got = squared(arrays["p", "posed"])
        assert to_axis_angle(from_matrix(got[elbow_]))[3] == pytest.approx(0.3, abs=1e-6)
        assert np.abs(points - deformer("contours", body)(got)).max() < half + 5e-6
        stage.send("level", "p", value=2)  # from Python, while the page stands still
        header, arrays = receive(ws, "mesh")
        coarse = len(arrays["p", "rest"])
        header, arrays = receive(ws, "frame")
        assert coarse < full and len(arrays["p", "vertices"]) == coarse


def test_joints_and_points_on_the_page_are_never_of_different_poses(browser):
    """Sliders while the server deforms: sampled between any two drawings, the hand stays where the arm ends."""
    clip = capsule_clip(vertices=1500, frames=6)
    skeleton, weights = clip.body.skeleton, clip.body.skin.weights
    hand = [skeleton.index["l_wrist"], skeleton.index["l_carpometacarpal_2"]]
    share = np.bincount(weights.vertex, weights.weight * np.isin(weights.joint, hand), minlength=len(weights))
    vertex = int(np.argmax(share))
    with show(clip, open_browser=False, block=False) as window, opened(browser, window.url) as page:
        pause(page)
        scrub(page, 2)
        page.get_by_test_id("deformer").select_option("hybrid")
        page.wait_for_timeout(300)
        find(page, "l_wrist")
        samples = page.evaluate(
            """async (vertex) => {
              const slider = document.querySelector('[data-testid="slider-l_wrist-x"]'), out = [];
              for (let k = 0; k < 12; k++) {
                slider.value = -5 * k;
                slider.dispatchEvent(new Event("input"));
                for (let i = 0; i < 4; i++) {
                  out.push([...vitruvian.site("l_hand_tip"), ...vitruvian.positions().slice(3 * vertex, 3 * vertex + 3)]);
                  await new Promise(requestAnimationFrame);
                }
              }
              return out;
            }""",
            vertex,
        )
    samples = np.array(samples)
    site, point = samples[:, :3], samples[:, 3:]
    site = site - [0, 0, np.round((site[0] - point[0])[2] / 1.3) * 1.3]  # rounds that it has walked
    assert np.ptp(point, axis=0).max() > 0.01  # it has moved
    # Site and vertex are one rigid piece: where the Site is says where the vertex has to be
    rigid = np.linalg.norm(site - point, axis=1)
    assert np.ptp(rigid) < 2e-4
