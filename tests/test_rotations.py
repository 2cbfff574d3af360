"""body.rotations against scipy and against itself."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vitruvian import VitruvianError
from vitruvian.body import rotations as r

RNG = np.random.default_rng(5)
QUATERNIONS = r.normalize(RNG.normal(size=(200, 4)))
ORDERS = ["".join(o) for o in itertools.product("XYZ", repeat=3) if o[0] != o[1] and o[1] != o[2]]


def same_turn(a, b, tolerance=1e-14):
    return np.abs(np.abs(np.sum(a * b, axis=-1)) - 1).max() <= tolerance


def test_matrix_agrees_with_scipy_and_returns():
    matrices = r.to_matrix(QUATERNIONS)
    assert np.abs(matrices - Rotation.from_quat(QUATERNIONS).as_matrix()).max() < 1e-14
    assert same_turn(r.from_matrix(matrices), QUATERNIONS)


@pytest.mark.parametrize("axis", np.eye(3))
def test_matrix_of_half_turn_keeps_all_digits(axis):
    for angle in (np.pi, np.pi - 1e-9, 1e-9, 0.0):
        q = r.from_axis_angle([*axis, angle])
        back = r.to_axis_angle(r.from_matrix(r.to_matrix(q)))
        assert abs(back[3] - angle) < 1e-15 if angle < 1 else abs(back[3] - angle) < 1e-12


def test_axis_angle_of_the_standard():
    q = r.from_axis_angle([[0, 0, 2, np.pi / 2], [0, 0, 0, 1.0], [1, 1, 0, -0.5]])
    assert np.allclose(q[0], [0, 0, np.sqrt(0.5), np.sqrt(0.5)])
    assert np.allclose(q[1], [0, 0, 0, 1])
    assert np.allclose(r.to_axis_angle(q[2]), [-np.sqrt(0.5), -np.sqrt(0.5), 0, 0.5])
    assert np.allclose(r.to_axis_angle([0, 0, 0, 1.0]), [0, 0, 1, 0])


def test_vector_and_back():
    vectors = RNG.uniform(-1.8, 1.8, (100, 3))
    assert np.abs(r.to_vector(r.from_vector(vectors)) - vectors).max() < 1e-13
    assert np.allclose(r.to_vector(r.from_vector([1e-20, 0, 0])), [1e-20, 0, 0], rtol=1e-12, atol=0)


def test_product_inverse_and_turned_vectors():
    a, b = QUATERNIONS[:100], QUATERNIONS[100:]
    assert np.abs(r.to_matrix(r.multiply(a, b)) - r.to_matrix(a) @ r.to_matrix(b)).max() < 1e-14
    assert same_turn(r.multiply(a, r.inverse(a)), np.array([0, 0, 0, 1.0]))
    v = RNG.normal(size=(100, 3))
    assert np.abs(r.rotate(a, v) - np.einsum("nij,nj->ni", r.to_matrix(a), v)).max() < 1e-14


def test_slerp_is_even_and_short():
    a, b = r.from_axis_angle([0, 1, 0, 0.2]), -r.from_axis_angle([0, 1, 0, 1.4])
    for t in (0.0, 0.25, 0.5, 1.0):
        assert np.allclose(r.to_axis_angle(r.slerp(a, b, t)), [0, 1, 0, 0.2 + 1.2 * t])
    assert np.allclose(r.slerp(a, a, 0.3), a)


def test_between_directions():
    a, b = RNG.normal(size=(50, 3)), RNG.normal(size=(50, 3))
    turned = r.rotate(r.between(a, b), a)
    assert np.abs(np.cross(turned, b)).max() < 1e-13
    assert (np.sum(turned * b, axis=1) > 0).all()
    opposite = r.between([[0, 0, 2.0]], [[0, 0, -1.0]])
    assert np.allclose(r.rotate(opposite, [[0, 0, 1.0]]), [[0, 0, -1]])
    assert np.allclose(r.between([0, 0, 0.0], [1.0, 0, 0]), [0, 0, 0, 1])


@pytest.mark.parametrize("order", ORDERS)
def test_euler_agrees_with_scipy_and_returns_everywhere(order):
    angles = RNG.uniform(-np.pi, np.pi, (200, 3))
    for n, pole in enumerate((np.pi / 2, -np.pi / 2, 0.0, np.pi)):
        angles[n * 10 : n * 10 + 10, 1] = pole
    q = r.from_euler(angles, order)
    assert same_turn(q, Rotation.from_euler(order, angles).as_quat())
    for continuous in (False, True):
        assert same_turn(r.from_euler(r.to_euler(q, order, continuous=continuous), order), q)


@pytest.mark.parametrize("order", ORDERS)
def test_continuous_euler_follows_through_the_poles(order):
    angles = np.linspace(0, 9, 900)[:, None] * np.array([1, 0.7, -0.5]) + np.array([0, 0.3, 0.1])
    found = r.to_euler(r.from_euler(angles, order), order, continuous=True)
    assert np.abs((found - found[0]) - (angles - angles[0])).max() < 1e-9


def test_zyx_is_rz_ry_rx():
    a = np.array([0.3, -0.4, 0.5])
    x, y, z = (r.to_matrix(r.from_axis_angle([*np.eye(3)[k], a[2 - k]])) for k in range(3))
    assert np.allclose(r.to_matrix(r.from_euler(a, "ZYX")), z @ y @ x)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-10, 10), min_size=3, max_size=3), st.sampled_from(ORDERS))
def test_any_angles_return(angles, order):
    q = r.from_euler(angles, order)
    assert same_turn(r.from_euler(r.to_euler(q, order), order), q, 1e-13)


def test_wrong_shapes_and_orders_are_named():
    with pytest.raises(VitruvianError, match=r"quaternion: expected shape \(\.\.\., 4\)"):
        r.to_matrix(np.zeros(3))
    for order in ("ZZX", "ABC", "XY"):
        with pytest.raises(VitruvianError, match="order"):
            r.from_euler([0, 0, 0], order)
