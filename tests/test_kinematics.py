"""Forward kinematics: the kernel against its twin, and known answers."""

import numpy as np
import pytest

from vitruvian import VitruvianError
from vitruvian.body import kinematics as k
from vitruvian.body.rotations import from_axis_angle, normalize
from vitruvian.body.types import Skeleton
from vitruvian.motion.types import Motion
from vitruvian.native import kernels

RNG = np.random.default_rng(2)


def skeleton(joints=31, **more):
    parents = [-1, *(int(RNG.integers(0, j)) for j in range(1, joints))]
    return Skeleton(tuple(f"j{i}" for i in range(joints)), parents, RNG.normal(size=(joints, 3)), **more)


def scaled(joints=31):
    return skeleton(
        joints,
        scale=RNG.uniform(0.5, 2, (joints, 3)),
        scale_orientation=normalize(RNG.normal(size=(joints, 4))),
        binding=RNG.normal(size=(joints, 4, 4)),
    )


@pytest.mark.parametrize("make", [skeleton, scaled])
@pytest.mark.parametrize("frames", [1, 3, 700])
def test_kernel_equals_twin(make, frames):
    if kernels() is None:
        pytest.skip("the extension vitruvian._native is not built: pip install .")
    s = make()
    rotation, translation = RNG.normal(size=(frames, 31, 4)), RNG.normal(size=(frames, 31, 3))
    root = RNG.normal(size=(frames, 3))
    for moved in (translation, translation[:1]):
        ours = k.pose_matrices(s, rotation, moved, root=root)
        twin = k._numpy(s, rotation, moved, root, k._stretch(s), np.empty_like(ours))
        assert np.abs(ours - twin).max() <= 1e-14 * np.abs(twin).max()


def test_threads_do_not_change_a_bit():
    if kernels() is None:
        pytest.skip("the extension vitruvian._native is not built: pip install .")
    s, rotation = skeleton(), RNG.normal(size=(1000, 31, 4))
    results = [k.pose_matrices(s, rotation, s.translation[None], threads=n) for n in (1, 2, 5)]
    assert all(np.array_equal(results[0], r) for r in results)


def test_local_transform_is_the_one_of_x3d():
    """T C R SR S -SR -C, written out."""
    t, c, s = np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0]), np.array([2.0, 0.5, 1.5])
    turn, so = (0, 0, 1, 0.7), (1, 0, 0, 0.4)

    def four(linear, shift=(0, 0, 0)):
        m = np.eye(4)
        m[:3, :3], m[:3, 3] = linear, shift
        return m

    def rotation(axis_angle):
        return k.transform_matrix((0, 0, 0), axis_angle)

    expected = four(np.eye(3), t + c) @ rotation(turn) @ rotation(so) @ four(np.diag(s))
    expected = expected @ np.linalg.inv(rotation(so)) @ four(np.eye(3), -c)
    assert np.allclose(k.transform_matrix(t, turn, s, so, c), expected)
    one = Skeleton(("a",), [-1], c[None], t[None], from_axis_angle([turn]), s[None], from_axis_angle([so]))
    assert np.allclose(k.joint_matrices(one)[0, 0], expected)


def test_rest_pose_moves_nothing_and_children_follow():
    s = Skeleton(("a", "b"), [-1, 0], [[0, 0, 0], [0, 1, 0]])
    assert np.array_equal(k.joint_matrices(s)[0], np.stack([np.eye(4)] * 2))
    turned = from_axis_angle([[0, 0, 1, np.pi / 2], [1, 0, 0, -1.0]])
    m = k.pose_matrices(s, turned[None], np.zeros((1, 2, 3)))
    assert np.allclose(k.joint_positions(s, m)[0], [[0, 0, 0], [-1, 0, 0]])


def test_motion_moves_root_and_may_move_every_joint():
    s = Skeleton(("a", "b"), [-1, 0], [[0, 0, 0], [0, 1, 0]], translation=[[9, 9, 9], [0, 0, 0.5]])
    still = np.tile([0.0, 0, 0, 1], (4, 2, 1))
    path = RNG.normal(size=(4, 3))
    m = k.joint_matrices(s, Motion(s, 30, still, path))
    assert np.allclose(m[:, 0, :3, 3], path)
    assert np.allclose(m[:, 1, :3, 3], path + [0, 0, 0.5])
    both = RNG.normal(size=(4, 2, 3))
    m = k.joint_matrices(s, Motion(s, 30, still, both[:, 0], joint_translation=both))
    assert np.allclose(m[:, 1, :3, 3], both.sum(axis=1))


def test_sites_ride_on_their_joints():
    s = Skeleton(
        ("a",), [-1], [[0, 0, 0]], site_names=("tip",), site_joints=np.array([0], np.int32), site_points=[[0, 1, 0]]
    )
    m = k.pose_matrices(s, from_axis_angle([[[0, 0, 1, np.pi / 2]]]), np.zeros((1, 1, 3)))
    assert np.allclose(k.site_positions(s, m), [[[-1, 0, 0]]])


def test_out_is_filled_and_checked():
    s = skeleton(3)
    out = np.empty((1, 3, 4, 4))
    assert k.joint_matrices(s, out=out) is out
    with pytest.raises(VitruvianError, match="out: expected float64"):
        k.joint_matrices(s, out=np.empty((1, 3, 4, 4), np.float32))
    with pytest.raises(VitruvianError, match="retarget"):
        k.joint_matrices(s, Motion(skeleton(4), 30, np.ones((1, 4, 4)), np.zeros((1, 3))))
