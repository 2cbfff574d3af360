"""Hands: the published construction's figures, its symmetries, and both hands of the built-in person."""

import numpy as np
import pytest

import vitruvian as vt
from vitruvian.body.hands import Hand, Rounding
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.rotations import from_axis_angle
from vitruvian.body.types import Skeleton, Skin, Weights
from vitruvian.deform import hands
from vitruvian.deform.deformer import deformer
from vitruvian.deform.hand_links import hands_of
from vitruvian.errors import VitruvianError
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
