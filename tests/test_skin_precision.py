"""What the skinning operators promise to the last digits: their float64 twins, which say what the kernels mean."""

import numpy as np
import pytest

import skins
from vitruvian.body.kinematics import transform_matrix
from vitruvian.deform import operators, twins
from vitruvian.deform.bind import bind
from vitruvian.deform.deformer import deformer
from vitruvian.deform.operators import apply
from vitruvian.deform.se3 import to_frame

STRAIGHT = ("linear", "dual-quaternion", "log-pair", "log")
# Turns about z = -1, 0, 1 by up to a radian, and points on a cylinder of radius 1.
MOTIONS = np.stack(
    [
        transform_matrix((0, 0, 0), (1, 0, 0, 0.4), center=(0, 0, -1)),
        transform_matrix((0, 0, 0), (0, 1, 0, 1.0)),
        transform_matrix((0, 0, 0), (0.6, 0, 0.8, 0.7), center=(0, 0, 1)),
    ]
)
TURN = transform_matrix((0, 0, 0), (0, 0, 1, np.pi / 2), center=(1, 2, 3))


def tube() -> tuple:
    rng = np.random.default_rng(4)
    turn, z = rng.uniform(0, 2 * np.pi, 200), rng.uniform(-1.5, 1.5, 200)
    share = rng.dirichlet(np.ones(3), 200)
    return np.stack([np.cos(turn), np.sin(turn), z], axis=1), share


def blended(name: str, share: np.ndarray, motions: np.ndarray) -> np.ndarray:
    """(V,3,4) float64."""
    vertex, joint = np.repeat(np.arange(len(share)), 3), np.tile(np.arange(3), len(share))
    weights = skins.Weights.from_pairs(len(share), vertex, joint, share.ravel())
    if name == "linear":
        return twins.linear(bind(weights, 3), motions)
    skin = skins.Skin(np.zeros((len(share), 3)), np.zeros((0, 3), np.int32), weights)
    body = skins.Body("tube", skins.skeleton(3, chain=False), skin)
    run = deformer(name, body).operator
    assert isinstance(run, operators.Rigid)
    return to_frame(run._blend(motions[None])[0])


@pytest.mark.parametrize("name", STRAIGHT)
def test_rest_is_rest_to_the_last_digit(name):
    points, share = tube()
    still = np.tile(np.eye(4), (3, 1, 1))
    assert np.abs(apply(blended(name, share, still), points) - points).max() <= 2.3e-16


@pytest.mark.parametrize("name", [*STRAIGHT, "log-absolute"])
def test_turning_all_joints_turns_the_skin_to_the_last_digits(name):
    """By the same motion; the operator as first published, not the default, is off by a good part of the radius."""
    points, share = tube()
    before = apply(blended(name, share, MOTIONS), points) @ TURN[:3, :3].T + TURN[:3, 3]
    error = np.linalg.norm(apply(blended(name, share, TURN @ MOTIONS), points) - before, axis=1).max()
    print(f"{name}: {error:.2e}")
    assert error > 0.1 if name == "log-absolute" else error < 4e-15


@pytest.mark.parametrize("name", STRAIGHT)
def test_another_origin_is_the_same_to_the_last_digits(name):
    """A hundred metres away, where one digit is 1.4e-14."""
    points, share = tube()
    away, back = np.eye(4), np.eye(4)
    away[:3, 3], back[:3, 3] = (0, 100, 0), (0, -100, 0)
    here = apply(blended(name, share, MOTIONS), points)
    there = apply(blended(name, share, away @ MOTIONS @ back), points + away[:3, 3]) - away[:3, 3]
    error = np.abs(here - there).max()
    print(f"{name}: {error:.2e}")
    assert error < 5e-14
