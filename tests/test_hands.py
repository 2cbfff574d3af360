"""Hands: the published construction's figures, its symmetries, and both hands of the built-in person."""

import dataclasses
import pickle
import time

import numpy as np
import pytest

import vitruvian as vt
from vitruvian.body.hands import Hand, Rounding, store_roundings, stored_roundings
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.rotations import from_axis_angle
from vitruvian.body.types import Skeleton, Skin, Weights
from vitruvian.deform import hands
from vitruvian.deform.deformer import deformer
from vitruvian.deform.hand_links import hands_of
from vitruvian.errors import VitruvianError, VitruvianWarning
from vitruvian.hanim.default import default_body
from vitruvian.motion.types import Motion

ENDS = np.array([0.0, 3.0, 5.5, 7.5])
RINGS, POINTS = 123, 32


@pytest.fixture(params=["kernel", "twin"])
def engine(request, monkeypatch):
    if request.param == "twin":
        monkeypatch.setattr(hands, "kernels", lambda: None)


def finger(rounding, rest=None):
    """Links of 3, 2.5 and 2 along +x, radius 1, the back of the finger +y; flexion about -z."""
    skeleton = Skeleton(("a", "b", "c"), np.array([-1, 0, 1]), np.array([[x, 0, 0] for x in ENDS[:3]]))
    if rest is None:
        turn = np.arange(POINTS) * 2 * np.pi / POINTS
        x = np.repeat(np.linspace(0, 7.5, RINGS), POINTS)
        rest = np.stack([x, np.cos(np.tile(turn, RINGS)), np.sin(np.tile(turn, RINGS))], axis=1)
        rest = np.concatenate([rest, [[0, 0, 0], [7.5, 0, 0]]])
    n = len(rest)
    if n == RINGS * POINTS + 2:
        i = np.arange(RINGS * POINTS).reshape(RINGS, POINTS)
        a, b, c, d = i[:-1], np.roll(i, -1, 1)[:-1], np.roll(i, -1, 1)[1:], i[1:]
        caps = [
            np.stack([np.full(POINTS, n - 2), np.roll(i[0], -1), i[0]], -1),
            np.stack([np.full(POINTS, n - 1), i[-1], np.roll(i[-1], -1)], -1),
        ]
        triangles = np.concatenate(
            [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3), *caps]
        )
    else:
        triangles = np.zeros((0, 3))
    owner = np.clip(np.searchsorted(ENDS[1:3], rest[:, 0], "right"), 0, 2)
    skin = Skin(rest, triangles.astype(np.int32), Weights.from_pairs(n, np.arange(n), owner, np.ones(n)))
    axis = np.tile([0, 0, -1.0], (3, 1))
    points = np.array([[x, 0, 0] for x in ENDS])
    hand = Hand(
        "finger", np.array([-1, 0, 1]), np.arange(3), np.array([1, 2, -1]), points[:3], points[1:], axis, axis,
        np.full((3, 2), -1), np.arange(n), np.ones(n), (rounding,) * 3,
    )  # fmt: skip
    return skeleton, skin, hand


def flexed(skeleton, degrees, root=None):
    q = np.tile([0.0, 0, 0, 1], (1, len(skeleton), 1))
    q[0, 1:] = from_axis_angle([0, 0, -1, np.radians(degrees)])
    if root is not None:
        q[0, 0] = from_axis_angle(root)
    return joint_matrices(skeleton, Motion(skeleton, 30.0, q, np.zeros((1, 3))))


def placed(rounding, degrees, root=None, rest=None):
    skeleton, skin, hand = finger(rounding, rest)
    out = skin.rest[None].astype(np.float32)
    hands.place(hands.hand_program(hand, skin), flexed(skeleton, degrees, root), out)
    return skin, out[0].astype(np.float64)


def volume(points, triangles):
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.einsum("ni,ni->", a, np.cross(b, c)) / 6


VOLUMES = {  # flexion: (knuckle, muscle) -> volume over that at rest
    30: {(0, 0): 0.9851, (0.5, 0): 0.9869, (1, 0): 0.9886, (0, 0.3): 0.9894, (1, 0.3): 0.9928},
    60: {(0, 0): 0.9407, (0.5, 0): 0.9474, (1, 0): 0.9541, (0, 0.3): 0.9532, (1, 0.3): 0.9666},
    90: {(0, 0): 0.8666, (0.5, 0): 0.8813, (1, 0): 0.8959, (0, 0.3): 0.8825, (1, 0.3): 0.9118},
}


@pytest.mark.parametrize("degrees", VOLUMES)
def test_the_reference_finger_keeps_its_volumes(degrees, engine):
    for (joint, muscle), want in VOLUMES[degrees].items():
        skin, out = placed(Rounding(joint, 0.3, 0.3, muscle, arc=0), degrees)
        assert volume(out, skin.triangles) / volume(skin.rest, skin.triangles) == pytest.approx(want, abs=6e-5)


def test_knuckles_reach_the_mitre_and_the_muscle_swells(engine):
    at = np.array([[3.0, 1, 0], [4.25, -1, 0], [3.0, 0, 1]])
    _, plain = placed(Rounding(0, 0.3, 0.3, 0, arc=0), 90, rest=at)
    _, round_ = placed(Rounding(1, 0.3, 0.3, 0.4, arc=0), 90, rest=at)
    joint = [3, 0, 0]
    assert np.linalg.norm(plain[0] - joint) == pytest.approx(1, abs=1e-6)
    assert np.linalg.norm(round_[0] - joint) == pytest.approx(np.sqrt(2), abs=1e-6)
    middle = np.array([3.0, -1.25, 0])  # of the second link, which now points down
    assert np.linalg.norm(round_[1] - middle) == pytest.approx(1.4, abs=1e-6)


def test_a_straight_finger_is_at_rest_and_a_turned_hand_turns(engine):
    skin, out = placed(Rounding(), 0)
    assert np.abs(out - skin.rest).max() < 1e-6
    _, bent = placed(Rounding(), 70)
    _, turned = placed(Rounding(), 70, root=[0.3, 1, -0.4, 1.1])
    r = flexed(finger(Rounding())[0], 0, [0.3, 1, -0.4, 1.1])[0, 0]
    assert np.abs(turned - (bent @ r[:3, :3].T + r[:3, 3])).max() < 3e-6


def exactly(rounding, matrices, rest, hand=None, plain=False):
    """The reference finger in double precision."""
    skeleton, skin, own = finger(rounding, rest)
    out = np.repeat(skin.rest[None], len(matrices), axis=0)
    hands.place(hands.hand_program(hand or own, skin, plain=plain), matrices, out)
    return out


def test_moving_the_hand_moves_the_skin_to_the_last_digit():
    rest = np.random.default_rng(3).normal(size=(200, 3)) * [2, 0.6, 0.6] + [3.5, 0, 0]
    skeleton = finger(Rounding())[0]
    m = flexed(skeleton, 70)
    r = flexed(skeleton, 0, [0.3, 1, -0.4, 1.1])[0, 0]
    r[:3, 3] += [0.5, -2, 1]
    rounding = Rounding(0.7, 0.2, 0.4, 0.6, 0.4)
    bent, turned = exactly(rounding, m, rest)[0], exactly(rounding, r @ m, rest)[0]
    assert np.abs(turned - (bent @ r[:3, :3].T + r[:3, 3])).max() < 1e-12


@pytest.mark.parametrize("arc", [0, 1])
def test_borders_of_areas_are_continuous(arc):
    """Across all of them, and at the line between back and palm also when the joints twist."""
    rounding = Rounding(0.8, 0.3, 0.25, 0.5, 0.4, arc=arc)
    skeleton = finger(rounding)[0]
    step, turn = 1e-9, np.linspace(0, 2 * np.pi, 49)
    borders = [3.0, 5.5, *(a + f * n for a, n in ((0, 3), (3, 2.5), (5.5, 2)) for f in (0.3, 0.75, 0.48, 0.6))]
    rest = np.array([[x + s, np.cos(t), np.sin(t)] for x in borders for t in turn for s in (-step, step)])
    out = exactly(rounding, flexed(skeleton, 80), rest)[0]
    assert np.abs(out[0::2] - out[1::2]).max() < 1e-8
    side = np.array([[x, s, z] for x in np.linspace(0.1, 7.4, 60) for z in (-1, 0.4, 1) for s in (-step, step)])
    q = from_axis_angle([[0, 0, -1, 1.0], [0.3, 0.1, -1, 1.2], [0.2, -0.3, -1, 0.7]])[None]
    m = joint_matrices(skeleton, Motion(skeleton, 30.0, q, np.zeros((1, 3))))
    out = exactly(rounding, m if arc else flexed(skeleton, 80), side)[0]
    assert np.abs(out[0::2] - out[1::2]).max() < 1e-8


def test_both_links_of_a_joint_place_its_section_alike():
    """On all sides: the section at the joint, held by one link and by the other."""
    turn = np.arange(32) * 2 * np.pi / 32
    rest = np.stack([np.full(32, 3.0), np.cos(turn), np.sin(turn)], axis=1)
    rounding = Rounding(0.8, 0.3, 0.3, 0.5)
    m = flexed(finger(rounding)[0], 75)
    _, skin, hand = finger(rounding, rest)
    given = hands.assign(hand, skin)
    out = []
    for link in (0, 1):
        held = dataclasses.replace(given, link=np.full_like(given.link, link))
        points = skin.rest[None].copy()
        hands.place(hands.hand_program(hand, skin, held), m, points)
        out.append(points[0])
    assert np.abs(out[0] - out[1]).max() < 1e-12


def test_knuckles_are_as_thick_as_at_rest_at_least_and_never_jump():
    x = np.array([3.0, 5.5])
    rest = np.stack([x, np.full(2, 0.8), np.zeros(2)], axis=1)
    rounding = Rounding(0.5, 0.3, 0.3, 0.3)
    before = None
    for degrees in range(0, 121, 2):
        m = flexed(finger(rounding)[0], degrees)
        out = exactly(rounding, m, rest)[0]
        joints = np.array([m[0, k, :3, :3] @ [a, 0, 0] + m[0, k, :3, 3] for k, a in ((1, 3.0), (2, 5.5))])
        assert np.linalg.norm(out - joints, axis=1).min() >= 0.8 - 1e-12
        assert before is None or np.abs(out - before).max() < 0.5
        before = out


def test_the_back_of_a_bent_joint_is_round_and_the_palm_does_not_fold_through_itself():
    x = np.linspace(1.5, 4.25, 111)
    back, palm = (np.stack([x, np.full(111, h), np.zeros(111)], axis=1) for h in (0.8, -0.8))

    def turns(arc, rest):
        rounding = Rounding(0.5, 0.3, 0.3, 0.3, arc=arc)
        way = np.diff(exactly(rounding, flexed(finger(rounding)[0], 100), rest)[0], axis=0)
        angle = np.degrees(np.arctan2(way[:, 1], way[:, 0]))
        return np.abs(np.diff(np.unwrap(angle, period=360)))

    assert turns(0, back).max() > 90 and turns(1, back).max() < 15
    thick = np.stack([np.linspace(3.0, 5.5, 60), np.full(60, -1.6), np.zeros(60)], axis=1)  # twice as thick as its like

    def falls(arc):
        """The largest step back, along the middle link, of points of the palm side in a row."""
        rounding = Rounding(0, 0.3, 0.3, 0.6, arc=arc)
        m = flexed(finger(rounding)[0], 90)
        along = np.diff(exactly(rounding, m, thick)[0] @ m[0, 1, :3, 0])
        return -along.min()

    assert falls(0) > 0.01 and falls(1) < 1e-6


def test_the_second_pass_can_be_left_out(body):
    rest = np.random.default_rng(4).normal(size=(200, 3)) * [2, 0.6, 0.6] + [3.5, 0, 0]
    m = flexed(finger(Rounding())[0], 80)
    plain = exactly(Rounding(0, 0.3, 0.3, 0, arc=0), m, rest)
    assert np.array_equal(exactly(Rounding(1, 0.3, 0.3, 1), m, rest, plain=True), plain)
    assert np.abs(exactly(Rounding(), m, rest) - plain).max() > 0.1
    d, m = deformer("hand", body), fist(body)
    off = d.tuned(rounded=False)
    assert np.array_equal(off(m), deformer("hand", body, rounded=False)(m))
    assert np.array_equal(off.tuned(rounded=True)(m), d(m)) and np.abs(off(m) - d(m)).max() > 0.001


def test_parameters_follow_a_slider(body):
    """Tuning binds nothing anew, and gives what binding with the same parameters gives."""
    d, m = deformer("hand", body), fist(body)
    d(m)
    chosen = {"index": Rounding(0.1, 0.4, 0.2, 0.6, 0.3), "l_metacarpophalangeal_3": Rounding(axis=(0.1, 0, -1))}
    start = time.perf_counter()
    tuned = d.tuned(chosen)
    seconds = time.perf_counter() - start
    assert np.array_equal(tuned(m), deformer("hand", body, hands=chosen)(m))
    assert tuned.operator.base is d.operator.base and tuned.operator.assignments[0] is d.operator.assignments[0]
    assert np.array_equal(tuned.tuned()(m), d(m))  # the body's own again, the axis too
    assert seconds < 0.5
    for name, value in (("joint", 0.9), ("near", 0.1), ("far", 0.1), ("muscle", 0.9), ("belly", 0.3), ("arc", 0.0)):
        assert np.abs(d.tuned({"": Rounding(**{name: value})})(m) - d(m)).max() > 1e-5, name
    with pytest.raises(VitruvianError, match="tuned: expected a deformer with hands, found 'log'"):
        deformer("log", body).tuned({})


@pytest.mark.parametrize("ending", ["x3d", "x3dv", "json", "wrl", "glb"])
def test_parameters_stay_with_the_body_in_files(tmp_path, ending):
    h = default_body(4)
    given = {"index": Rounding(joint=0.8, belly=0.35), "l_metacarpophalangeal_3": Rounding(axis=(0.6, 0.0, -0.8))}
    store_roundings(h, given)
    vt.save(h, tmp_path / f"h.{ending}")
    assert stored_roundings(vt.load(tmp_path / f"h.{ending}")) == given
    store_roundings(h, {})
    assert stored_roundings(h) == {}


def test_stored_parameters_are_used_and_bad_ones_told(body):
    h = default_body(4)
    h.info["rounding:thumb"] = "joint 7"
    h.info["rounding:index"] = "joint"
    h.info["rounding:ring"] = "elbow 1"
    h.info["rounding:pinky"] = "joint 0.9 muscle 0.1"
    with pytest.warns(VitruvianWarning) as said:
        assert stored_roundings(h) == {"pinky": Rounding(joint=0.9, muscle=0.1)}
    told = [str(w.message) for w in said]
    assert told[0] == "info rounding:thumb: rounding joint: expected 0 to 1, found 7.0; ignored"
    assert told[1] == "info rounding:index: rounding joint: expected 1 numbers, found 'joint'; ignored"
    assert "expected joint, near" in told[2]
    kept = dataclasses.replace(body, roundings={"index": Rounding(joint=1.0)})
    m = fist(body)
    assert np.array_equal(deformer("hand", kept)(m), deformer("hand", body, hands={"index": Rounding(joint=1.0)})(m))


def test_hands_are_mirror_images():
    """A hand, and its mirror image in the mirrored pose, in double precision."""
    rounding = Rounding(0.7, 0.3, 0.3, 0.4)
    skeleton, skin, hand = finger(rounding)
    flip = np.diag([-1.0, 1, 1])
    q = from_axis_angle([[0, 0, -1, 0.4], [0.3, 0.1, -1, 1.2], [0.2, -0.3, -1, 0.7]])[None]
    m = joint_matrices(skeleton, Motion(skeleton, 30.0, q, np.zeros((1, 3))))
    other = np.eye(4)
    other[:3, :3] = flip
    mirrored = dataclasses.replace(
        hand,
        start=hand.start @ flip,
        end=hand.end @ flip,
        axis_near=-hand.axis_near @ flip,
        axis_far=-hand.axis_far @ flip,
    )
    image = dataclasses.replace(skin, rest=skin.rest @ flip)
    out, back = skin.rest[None].copy(), image.rest[None].copy()
    hands.place(hands.hand_program(hand, skin), m, out)
    hands.place(hands.hand_program(mirrored, image), other @ m @ other, back)
    assert np.abs(out @ flip - back).max() < 1e-12


@pytest.mark.parametrize(
    "name, moved", [("JinLOA3", 649), ("HAnimModelHandLeft", 0), ("HAnim2SpecificationLOA3Illustrated", 0)]
)
def test_hands_of_other_bodies(shared, name, moved):
    """Jin's segments bend; balls and diamonds that mark joints and sites stay what they are."""
    body = vt.pack(vt.load(shared / f"data/hanim/{name}.x3d"))
    found = hands_of(body)
    assert [len(h.near) for h in found] == [19] * len(found) and [len(h.vertices) for h in found] == [moved] * len(
        found
    )
    d, m = deformer("hand", body), fist(body)
    still = np.tile(np.eye(4), (1, len(body.skeleton), 1, 1))
    extent = np.ptp(body.skin.rest, axis=0).max()
    assert np.abs(d(still)[0] - body.skin.rest).max() < 1e-6 * extent
    assert (np.abs(d(m) - deformer("log", body)(m)).max() > 0.001 * extent) == (moved > 0)


@pytest.mark.parametrize(
    "name, counts",
    [("JinNoAnimations_Fixed.x3d", [265, 267]), ("JoeHAnimKick1a.x3dv", [91, 84]), ("JoeKick.x3d", [91, 84])],
)
def test_hands_in_real_skins_do_not_tear(shared, name, counts):
    """Files of both versions, with few points and with weights by distance, which hang thighs on fingers beside them."""
    body = vt.pack(vt.load(shared / f"data/hanim/{name}"))
    found = hands_of(body)
    assert [len(h.vertices) for h in found] == counts
    rotation = np.tile([0.0, 0, 0, 1], (1, len(body.skeleton), 1))
    for hand in found:
        for link in np.flatnonzero(hand.before_links() >= 0):
            rotation[0, hand.near[link]] = from_axis_angle([*hand.axis_near[link], 1.0])
    m = joint_matrices(body.skeleton, Motion(body.skeleton, 30.0, rotation, np.zeros((1, 3))))
    own = np.zeros(len(body.skin.rest), bool)
    own[np.concatenate([h.vertices for h in found])] = True
    corners = body.skin.triangles[own[body.skin.triangles].any(axis=1)]
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    length = lambda p: np.linalg.norm(p[edges[:, 0]] - p[edges[:, 1]], axis=1)  # noqa: E731
    rest = length(body.skin.rest)
    stretch = {n: (length(deformer(n, body)(m)[0]) / rest)[rest > 1e-6].max() for n in ("log", "hand")}
    assert stretch["hand"] < stretch["log"]
    off = np.abs(deformer("hand", body)(m) - deformer("log", body)(m))[0].max(axis=1)
    assert off[own].max() > 0.002 and off[~own].max() < 1e-6
    for hand in found:  # what is not the hand's by its weights follows it less
        foreign = hand.share < 1
        assert foreign.any() == name.startswith("Jin") and (hand.share > 0.1).all()


def test_zones_meet_without_a_step(engine):
    turn = np.linspace(0, 2 * np.pi, 49)
    step = 1e-9
    for x in (3.0, 5.5, 3.0 + 0.3 * 2.5, 3.0 + 0.7 * 2.5):
        rest = np.array([[x + s, np.cos(t), np.sin(t)] for t in turn for s in (-step, step)])
        _, out = placed(Rounding(0.8, 0.3, 0.3, 0.5), 60, rest=rest)
        assert np.abs(out[0::2] - out[1::2]).max() < 1e-6
    rest = np.array([[x, s, 1.0] for x in np.linspace(0, 7.5, 40) for s in (-step, step)])
    _, out = placed(Rounding(0.8, 0.3, 0.3, 0.5), 60, rest=rest)
    assert np.abs(out[0::2] - out[1::2]).max() < 1e-6


def test_parameters_are_checked():
    with pytest.raises(VitruvianError, match="rounding near: expected 0 to 0.5, found 0.9"):
        Rounding(near=0.9)
    with pytest.raises(VitruvianError, match="roundings: expected joints or rays of a hand, found l_indx"):
        deformer("hand", vt.pack(vt.person()), hands={"l_indx": Rounding()})


@pytest.fixture(scope="module")
def body():
    return vt.pack(vt.person())


def fist(body, angle=1.0):
    q = np.tile([0.0, 0, 0, 1], (1, len(body.skeleton), 1))
    for side, sign in (("l", -1), ("r", 1)):
        for ray in range(2, 6):
            for joint in ("metacarpophalangeal", "carpal_proximal_interphalangeal", "carpal_distal_interphalangeal"):
                if f"{side}_{joint}_{ray}" in body.skeleton.index:
                    q[0, body.skeleton.index[f"{side}_{joint}_{ray}"]] = from_axis_angle([0, 0, sign, angle])
    return joint_matrices(body.skeleton, Motion(body.skeleton, 30.0, q, np.zeros((1, 3))))


def test_both_hands_of_the_person_make_a_fist(body, monkeypatch):
    left, right = hands_of(body)
    assert (left.name, right.name) == ("l_hand", "r_hand") and len(left.near) == len(right.near) == 19
    still = np.tile(np.eye(4), (1, len(body.skeleton), 1, 1))
    d = deformer("hand", body)
    assert np.abs(d(still) - body.skin.rest).max() < 1e-6
    m = fist(body)
    out, plain = d(m)[0], deformer("log", body)(m)[0]
    other = np.ones(len(out), bool)
    other[[*left.vertices, *right.vertices]] = False
    assert np.array_equal(out[other], plain[other])
    assert 0.002 < np.abs(out - plain).max() < 0.03
    mirrored = out[left.vertices] * [-1, 1, 1]
    distance = np.linalg.norm(mirrored[::7, None] - out[right.vertices][None], axis=2).min(axis=1)
    assert distance.max() < 1e-3
    rounder = deformer("hand", body, hands={"index": Rounding(joint=1.0)})(m)[0]
    moved = np.flatnonzero(np.abs(rounder - out).max(axis=1) > 1e-5)
    assert 20 < len(moved) < 600
    monkeypatch.setattr(hands, "kernels", lambda: None)
    assert np.abs(deformer("hand", body)(m)[0] - out).max() < 1e-6
    frames = d.frames(m)[0]
    whole = np.einsum("vab,vb->va", frames[..., :3], body.skin.rest) + frames[..., 3]
    assert np.abs(whole - out).max() < 2e-6


def test_what_is_bound_can_be_sent_elsewhere(body):
    d, m = deformer("hand", body), fist(body)
    here = d(m)
    assert np.array_equal(pickle.loads(pickle.dumps(d))(m), here)


def test_a_rounder_knuckle_stands_further_out(body):
    left = hands_of(body)[0]
    m = fist(body, 1.3)
    flat, plain, mitre = (deformer("hand", body, hands={"": Rounding(joint=a)})(m)[0] for a in (0.0, 0.5, 1.0))
    program = hands.hand_program(left, body.skin)
    back = program.swell[:, 0] > 0.1  # next to the near joint
    for link in (4, 8, 12, 16):
        rows = program.vertex[back & (program.assignment.link == link) & (program.assignment.share > 0.5)]
        joint = left.near[link]
        center = m[0, joint, :3, :3] @ body.skeleton.centers[joint] + m[0, joint, :3, 3]
        away = [np.linalg.norm(p[rows] - center, axis=1).mean() for p in (flat, plain, mitre)]
        assert len(rows) > 2 and away[0] < away[1] < away[2]


def test_the_palm_folds_by_the_ratio_of_distances():
    """Two links 20 mm apart move to 10 mm: F is a half, and the skin between gets 1 + A (1/F - 1) as thick."""
    start, end = np.array([[0.0, 0, 0], [0.02, 0, 0]]), np.array([[0.0, -0.06, 0], [0.02, -0.06, 0]])
    axis = np.tile([1.0, 0, 0], (2, 1))  # links point down, the back of the hand is -z: d x a
    rest = np.array([[0.01, -0.03, -0.01], [0.01, -0.03, 0.01]])
    hand = Hand(
        "palm", np.array([-1, -1]), np.array([0, 1]), np.array([-1, -1]), start, end, axis, axis,
        np.array([[-1, 1], [0, -1]]), np.arange(2), np.ones(2), (Rounding(muscle=0.4),) * 2,
    )  # fmt: skip
    skin = Skin(rest, np.zeros((0, 3), np.int32), Weights.from_pairs(2, [0, 1], [0, 0], [1, 1]))
    program = hands.hand_program(hand, skin)
    assert program.assignment.gap_share.min() > 0.9  # half way: all gap
    m = np.tile(np.eye(4), (1, 2, 1, 1))
    m[0, 1, 0, 3] = -0.01
    out = rest[None].astype(np.float32)
    hands.place(program, m, out)
    assert np.allclose(out[0, :, 0], 0.005, atol=1e-6)
    thick = np.abs(out[0, :, 2])
    back = np.flatnonzero(program.fold > 0)
    assert len(back) == 1 and thick[program.gap_vertex[back[0]]] == pytest.approx(0.014, abs=1e-6)
    assert np.sort(thick)[0] == pytest.approx(0.01, abs=1e-6)
