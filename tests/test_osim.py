"""Models of OpenSim: a small one with known answers, what is refused, and its own reference of inverse kinematics."""

from __future__ import annotations

import numpy as np
import pytest

import vitruvian as vt
from capture_maker import LINE, MARKS, SHANK, THIGH, model, mutated
from vitruvian.body.kinematics import joint_positions, site_positions
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.osim import read_osim
from vitruvian.motion.mechanism import coordinates_of


def test_a_joint_that_slides_while_it_turns(tmp_path):
    path = tmp_path / "leg.osim"
    path.write_text(model(THIGH, SHANK, markers=MARKS))
    leg = read_osim(path)
    assert leg.coordinates == ("a", "b") and leg.markers == ("T1", "T2", "S1", "S2")
    q = np.array([[0.0, 0.0], [np.pi / 2, 0.0], [0.0, 1.0], [0.0, -1.5]])
    at = leg.places(q)
    assert at[0, 1, :3, 3] == pytest.approx([0, 0.5, 0])
    assert at[1, 1, :3, 3] == pytest.approx([0.5, 1, 0], abs=1e-12)
    # x^3 through the knots is its own not-a-knot spline
    assert at[2, 1, :3, 3] == pytest.approx([0.1, 0.5, 0], abs=1e-12)
    assert at[3, 1, 0, 3] == pytest.approx(-0.3375, abs=1e-12)
    far = leg.places(np.array([[0.0, 3.0]]))[0, 1, 0, 3]
    assert far == pytest.approx(0.8 + 1.2, abs=1e-9), "straight on beyond the knots"
    rng = np.random.default_rng(0)
    truth = rng.uniform(-1.2, 1.2, size=(6, 2))
    points = leg.marker_places(truth)
    points[2, 1] = np.nan
    found, left = coordinates_of(leg, leg.markers, points)
    assert np.abs(found - truth).max() < 1e-5 and np.nanmax(left) < 1e-6 and np.isnan(left[2, 1])
    motion = leg.motion(truth, 60.0)
    matrices = vt.joint_matrices(motion.skeleton, motion)
    assert np.allclose(joint_positions(motion.skeleton, matrices), leg.places(truth)[..., :3, 3], atol=1e-12)
    assert np.allclose(site_positions(motion.skeleton, matrices), leg.marker_places(truth), atol=1e-12)
    with pytest.raises(VitruvianError, match="the model has no 'X'"):
        coordinates_of(leg, ("X",), points[:, :1])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not well-formed"),
        ("<OpenSimDocument/>", "expected a Model with a BodySet"),
        (model(), "at least one body"),
        (model(SHANK), "its parent 'thigh' is not before it"),
        (model(THIGH, THIGH), "'thigh' twice"),
        (model(THIGH.replace("0 0 1", "0 0 0")), "an axis with a length"),
        (model(THIGH.replace("0 0 1", "0 0 nan")), "found 'nan'"),
        (model(THIGH.replace("0 0 1", "0 1")), "expected 3 numbers"),
        (model(THIGH.replace(LINE, "<Magic/>")), "found Magic"),
        (model(THIGH, SHANK.replace("-2 -1 0 1 2", "-2 -1 -1 1 2")), "x rising"),
        (model(THIGH.replace("CustomJoint", "BallJoint")), "found BallJoint"),
        (model(THIGH).replace("meters", "furlongs"), "expected meters"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "declares entities"),
        ("<a>" * 5000, "levels"),
    ],
)
def test_what_is_no_model(text, message, tmp_path):
    path = tmp_path / "bad.osim"
    path.write_text(text)
    with pytest.raises(FileError, match=message):
        read_osim(path)


@pytest.mark.filterwarnings("ignore::vitruvian.errors.VitruvianWarning")
def test_mutations_are_refused_or_read(tmp_path):
    data, path = model(THIGH, SHANK, markers=MARKS).encode(), tmp_path / "mutant.osim"
    refused = 0
    for seed in range(200):
        path.write_bytes(mutated(data, seed))
        try:
            read_osim(path)
        except FileError:
            refused += 1
    assert refused > 100


def test_opensims_own_answers_are_found(shared):
    """23 coordinates of 73 frames from 31 markers: within a hundredth of a degree where a degree was the goal."""
    folder = shared / "data" / "motion"
    gait = read_osim(folder / "opensim_ik_subject01_simbody.osim")
    seen = vt.load(folder / "opensim_ik_subject01_synthetic_marker_data.trc")
    table = vt.load(folder / "opensim_ik_std_subject01_walk1_ik.mot")
    found, left = coordinates_of(gait, seen.names, seen.points)
    for c, name in enumerate(gait.coordinates):
        truth = table.values[:, table.columns.index(name)]
        sliding = name.startswith("pelvis_t") and name[-1] in "xyz"
        off = 1000 * (found[:, c] - truth) if sliding else np.degrees(found[:, c]) - truth
        assert np.sqrt((off**2).mean()) < (0.1 if sliding else 0.02), name
    assert np.sqrt((left**2).mean()) < 1e-4
