"""The "volume" operator where a limb goes on into several bones: the forearm into the palm."""

from dataclasses import replace

import numpy as np
import pytest

from capsules import capsule_body
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.pack import pack
from vitruvian.body.rotations import from_axis_angle
from vitruvian.deform.bind import bind
from vitruvian.deform.deformer import deformer
from vitruvian.deform.forks import forked, forks
from vitruvian.deform.quality import Gauge
from vitruvian.modeling.person import humanoid_of
from vitruvian.modeling.shape import Shape


def posed(body, joint, axis, degrees):
    rotation = body.skeleton.rotation.copy()
    rotation[body.skeleton.index[joint]] = from_axis_angle(np.array([*axis, np.radians(degrees)]))
    return joint_matrices(replace(body.skeleton, rotation=rotation))[0]


@pytest.fixture(scope="module", params=[Shape(gender=1.0), Shape(gender=0.1, age=80, weight=1.0, height=0.1)])
def body(request):
    return pack(humanoid_of(request.param, outfit=None, hair="none"))


def test_a_wrist_twists_and_bends_without_collapse(body):
    """Without their common line, palms twisted by 120 degrees keep 0.78 of their thickness and bulge by 0.13."""
    skeleton = body.skeleton
    forearm = skeleton.centers[skeleton.index["l_radiocarpal"]] - skeleton.centers[skeleton.index["l_elbow"]]
    forearm /= np.linalg.norm(forearm)
    gauge, move = Gauge(body, ("l_radiocarpal",)), deformer("volume", body)
    cases = [
        (forearm, 120, 0.94, 1.07),
        (forearm, -120, 0.94, 1.06),
        ([0, 0, 1], -80, 0.93, 1.06),
        ([0, 0, 1], 70, 0.95, 1.06),
    ]
    for axis, degrees, thick, bulge in cases:
        matrices = posed(body, "l_radiocarpal", axis, degrees)
        report = gauge.measure(move(matrices), matrices)
        found = report.joints["l_radiocarpal"]
        assert found.thickness > thick and found.bulge < bulge and found.stretch < 2.0, (degrees, found)
        assert report.whole.folds <= 4


def test_only_what_turns_with_the_wrist_is_made_even(body):
    """Weights keep their sums, those of the bones of the palm their proportions, and the rest of the body its own."""
    rows = bind(body.skin.weights, len(body.skeleton))
    area = np.ones(len(rows))
    center, radius = np.zeros((len(rows), 3)), np.ones(len(rows))
    found = forks(body, rows, area)
    assert [body.skeleton.names[j] for j, _, _ in found] == ["l_radiocarpal", "r_radiocarpal"]
    moved, thick, even = forked(body, rows, center, radius, area)
    dense = lambda r: np.bincount(r.vertex * (r.joints + 1) + r.joint, r.weight, minlength=len(r) * (r.joints + 1))  # noqa: E731
    before, after = (dense(r).reshape(len(rows), -1) for r in (rows, even))
    assert np.allclose(before.sum(axis=1), after.sum(axis=1), atol=1e-12) and (after >= 0).all()
    changed = np.abs(before - after).max(axis=1) > 1e-9
    far = np.linalg.norm(body.skin.rest[:, None] - body.skeleton.centers[[j for j, _, _ in found]], axis=2).min(axis=1)
    assert 100 < changed.sum() < len(rows) / 10 and far[changed].max() < 0.13
    left = np.abs(center - moved).max(axis=1) == 0
    assert (~left).sum() > 100 and far[~left].max() < 0.13 and (thick[left] == 1).all()
    for _, under, _ in found:
        own = before[:, under].sum(axis=1) > 0.05
        share = [w[own][:, under] / w[own][:, under].sum(axis=1, keepdims=True) for w in (before, after)]
        assert np.allclose(*share, atol=1e-9)


def test_bodies_without_forks_keep_everything():
    body = capsule_body(vertices=900)
    rows = bind(body.skin.weights, len(body.skeleton))
    center, radius, area = body.skin.rest * 0.5, np.ones(len(rows)), np.ones(len(rows))
    moved, thick, even = forked(body, rows, center, radius, area)
    assert (moved == center).all() and (thick == radius).all()
    assert np.array_equal(np.sort(even.weight), np.sort(rows.weight)) and np.array_equal(even.row, rows.row)
