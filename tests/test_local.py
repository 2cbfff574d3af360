"""Joint-dependent local operators: what a deformer consists of, domains, and hands sampled as displacers."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

import vitruvian as vt
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.rotations import from_axis_angle, from_vector
from vitruvian.body.types import Morph, Weights
from vitruvian.deform.deformer import deformer
from vitruvian.deform.hand_displacers import add_displacers, as_morphs, displacer_weights, hand_displacers
from vitruvian.deform.local import angles_of, composed, family, hats, local_operators, partition_faults
from vitruvian.errors import VitruvianError
from vitruvian.motion.types import Motion


@pytest.fixture(scope="module")
def humanoid():
    return vt.person(outfit="body suit", hair="none")


@pytest.fixture(scope="module")
def body(humanoid):
    return vt.pack(humanoid)


def pose(body, turns, frames=1):
    q = np.tile([0.0, 0, 0, 1], (frames, len(body.skeleton), 1))
    for name, turn in turns.items():
        q[:, body.skeleton.index[name]] = from_axis_angle(turn)
    return joint_matrices(body.skeleton, Motion(body.skeleton, 30.0, q, np.zeros((frames, 3))))


def anyhow(body, seed=2, frames=2):
    rng = np.random.default_rng(seed)
    q = from_vector(rng.normal(scale=0.2, size=(frames, len(body.skeleton), 3)))
    return joint_matrices(body.skeleton, Motion(body.skeleton, 30.0, q, rng.normal(size=(frames, 3))))


@pytest.mark.parametrize("name", ["log", "hand", "linear"])
def test_a_deformer_is_the_sum_of_its_operators(body, name):
    """Each depends on its own joints alone, together they cover the surface, and give what the deformer gives."""
    d, m = deformer(name, body), anyhow(body)
    parts = local_operators(d)
    assert partition_faults(parts, body) == []
    assert sum(len(p.domain) for p in parts if not p.adds) == len(body.skin.rest)
    error = float(np.abs(composed(body, parts)(m) - d(m)).max())
    assert error < 2e-6
    assert max(len(p.joints) for p in parts) < 60 < len(body.skeleton)
    names = [p.name for p in parts]
    assert ("l_hand" in names) == (name == "hand") and "skin of l_knee" in names and len(set(names)) == len(names)
    if name == "hand":
        assert set(parts[0].parameters) >= {"l_metacarpophalangeal_2", "l_carpal_interphalangeal_1"}


def test_contours_are_operators_too(humanoid):
    body = vt.pack(vt.contours(humanoid))
    for hands in (None, True):
        d, m = deformer("contours", body, hands=hands), anyhow(body, frames=1)
        parts = local_operators(d)
        assert partition_faults(parts, body) == []
        arm = next(p for p in parts if p.name == "l_forearm_def")
        assert {body.skeleton.names[j] for j in arm.joints} >= {"l_elbow"} and "swing" in arm.parameters
        error = float(np.abs(composed(body, parts)(m) - d(m)).max())
        assert error < 2e-5


def test_an_operator_takes_the_angles_of_its_joints(body):
    knee = next(p for p in local_operators(deformer("log", body)) if p.name == "skin of l_knee")
    names = [body.skeleton.names[j] for j in knee.joints]
    assert np.abs(knee.evaluate(np.zeros((len(names), 3))) - body.skin.rest[knee.domain]).max() < 1e-6
    bent = np.zeros((3, len(names), 3))
    bent[:, names.index("l_knee"), 0] = [0.2, 0.4, 0.6]
    moved = knee.evaluate(bent)
    assert moved.shape == (3, len(knee.domain), 3)
    want = deformer("log", body)(pose(body, {"l_knee": [1, 0, 0, 0.4]}))[0, knee.domain]
    assert np.abs(moved[1] - want).max() < 1e-5
    with pytest.raises(VitruvianError, match=rf"operator skin of l_knee: angles: expected shape \({len(names)}, 3\)"):
        knee.evaluate(np.zeros((2, 3)))


def test_faults_name_vertex_and_joint(body):
    parts = local_operators(deformer("hand", body))
    left = parts[0]
    vertex = int(left.domain[0])
    assert partition_faults(parts[1:], body)[0].startswith(
        f"operators: expected every vertex in a domain, found vertex {vertex}"
    )
    assert f"{len(left.domain)} such in all" in partition_faults(parts[1:], body)[0]
    twice = (*parts, replace(left, name="again", domain=left.domain[3:5]))
    assert partition_faults(twice, body) == [
        f"operators l_hand and again: expected domains apart, found vertex {left.domain[3]} in both"
    ]
    inner = replace(left, domain=np.append(left.domain, left.domain[7]))
    assert partition_faults((inner, *parts[1:]), body) == [
        f"operator l_hand: expected each vertex once in its domain, found {left.domain[7]} twice"
    ]
    count, joints = len(body.skin.rest), len(body.skeleton)
    beyond = replace(left, domain=np.append(left.domain, count), joints=np.array([0, joints]))
    assert partition_faults((beyond, *parts[1:]), body) == [
        f"operator l_hand: expected joints in 0..{joints - 1}, found {joints}",
        f"operator l_hand: expected vertices in 0..{count - 1}, found {count}",
    ]
    with pytest.raises(VitruvianError, match=r"expected domains apart, found vertex \d+ in both"):
        composed(body, twice)


@dataclass
class Breathing:
    """An operator of one's own: the chest widens with the turn of one joint."""

    domain: np.ndarray
    joints: np.ndarray
    anchor: int
    offset: np.ndarray
    name: str = "breathing"
    adds: bool = True
    parameters: dict = field(default_factory=dict)

    def evaluate(self, angles):
        return np.asarray(angles)[..., 0, 0, None, None] * self.offset


def test_an_actor_carries_operators_of_ones_own(body):
    d = deformer("log", body)
    chest = np.flatnonzero(np.abs(body.skin.rest[:, 1] - 1.2) < 0.03).astype(np.int32)
    joints, anchor = family(body.skeleton, [body.skeleton.index["vt6"]])
    own = Breathing(chest, joints, anchor, np.tile([0, 0, 0.1], (len(chest), 1)))
    m = pose(body, {"vt6": [1, 0, 0, 0.3]})
    moved = composed(body, (*local_operators(d), own))(m)[0] - d(m)[0]
    assert np.allclose(moved[chest], [0, 0, 0.03], atol=1e-5)
    moved[chest] = 0
    assert np.abs(moved).max() < 1e-5


def test_displacers_with_a_weight_are_operators(body):
    index = np.arange(40, 60, dtype=np.int32)
    skull = body.skeleton.index["skullbase"]
    offset = np.tile([0.0, 0.01, 0.02], (20, 1))
    morphs = (Morph("late", index, offset, skull, False, 0.5), Morph("early", index, offset, skull, True, 0.25))
    count = len(body.skin.rest)
    rigid = Weights.from_pairs(count, np.arange(count), np.full(count, skull), np.ones(count))
    head = replace(body, skin=replace(body.skin, morphs=morphs, weights=rigid))
    d, m = deformer("log", head), anyhow(head, frames=3)
    parts = local_operators(d)
    assert [p.name for p in parts if p.adds] == ["late", "early"]
    error = float(np.abs(composed(head, parts)(m) - d(m)).max())
    assert error < 2e-6


def test_weights_over_the_angle_are_linear_between_samples():
    samples = np.radians([30.0, 60.0, 90.0])
    got = hats(np.radians([-20.0, 0, 15, 30, 45, 90, 120]), samples)
    want = [[0, 0, 0], [0, 0, 0], [0.5, 0, 0], [1, 0, 0], [0.5, 0.5, 0], [0, 0, 1], [0, 0, 1]]
    assert np.allclose(got, want, atol=1e-12)


def test_hands_become_displacers_over_the_joint_angle(humanoid, body, tmp_path):
    """At the sampled angles of one joint they give the hand, between nearly; in a file they move plain skin alike."""
    d, plain = deformer("hand", body), deformer("log", body)
    sampled = hand_displacers(d)
    assert len(sampled) == 2 * 14 and {len(s.samples) for s in sampled} == {3}
    finger = next(s for s in sampled if s.name == "l_carpal_proximal_interphalangeal_2")
    for degrees, most in ((60.0, 5e-5), (75.0, 4e-4)):
        m = pose(body, {finger.name: [*finger.axis, np.radians(degrees)]})
        want, base = d(m)[0].astype(float), plain(m)[0].astype(float)
        got = composed(body, (*local_operators(plain), *sampled))(m)[0]
        assert np.abs(got - want).max() < most < 0.15 * np.abs(base - want).max()
        weights = displacer_weights(sampled, body.skeleton, m)
        own = {k: v for k, v in weights.items() if v.any()}
        assert set(own) <= {f"{finger.name}_{a}_action" for a in ("060", "090")} and len(own) in (1, 2)
    made = add_displacers(humanoid, sampled)
    assert len(made.displacers()) == len(humanoid.displacers()) + 84
    vt.save(made, tmp_path / "hands.x3d")
    again = vt.pack(vt.load(tmp_path / "hands.x3d"))
    with_weights = deformer("log", again)(m, morphs=weights)[0]
    assert np.abs(with_weights - want).max() < 5e-4
    assert {x.name for x in as_morphs(sampled)} <= {x.name for x in again.skin.morphs}
    with pytest.raises(VitruvianError, match="degrees: expected growing angles"):
        hand_displacers(d, [60, 30])
    with pytest.raises(VitruvianError, match="expected a deformer with hands, found 'log'"):
        hand_displacers(plain)


def test_angles_are_read_back(body):
    joints, anchor = family(body.skeleton, [body.skeleton.index["l_elbow"], body.skeleton.index["l_radiocarpal"]])
    assert body.skeleton.names[anchor] == "l_shoulder"
    m = pose(body, {"l_shoulder": [0, 1, 0, 1.0], "l_elbow": [1, 0, 0, -0.8]})
    got = angles_of(body.skeleton, joints, m)[0]
    assert np.allclose(got[0], [-0.8, 0, 0], atol=1e-12) and np.allclose(got[1:], 0, atol=1e-12)
