"""The 87 points: where bodies have them, that injected errors are found, and that they are put right."""

import json
import subprocess
import sys
from collections import Counter

import numpy as np
import pytest

import vitruvian as vt
from vitruvian.errors import VitruvianError
from vitruvian.hanim.default import default_body
from vitruvian.modeling.actor import ENDS, JOINTS, POINTS, actor, examine, place, placed


@pytest.fixture(scope="module")
def person():
    return vt.person(outfit="body suit", hair="none")


@pytest.fixture(scope="module")
def good(person):
    """The person with its limb joints in the middle of the flesh."""
    return placed(person, place(actor(person)))


def test_there_are_87_points():
    assert len(JOINTS) == 71 and len(ENDS) == 16 and len(set(POINTS)) == 87


def test_the_default_body_keeps_the_rules_that_need_no_surface():
    a = actor(default_body(2))
    assert a.missing == ("chin", "l_heel", "r_heel") and examine(a) == []


def test_the_person_has_all_points_and_placing_mends_its_limbs(person, good):
    before, after = examine(actor(person)), examine(actor(good))
    assert actor(person).missing == ()
    limbs = lambda found: [f for f in found if f.rule in "ab" and "carpal" in f.point]  # noqa: E731
    assert limbs(before) == limbs(after) == []  # fingers have their joints in their middle
    bent = lambda found: {f.point for f in found if f.rule in "ab"}  # noqa: E731
    assert bent(before) >= {"l_knee", "r_knee", "l_elbow", "r_elbow"} and not bent(after)
    assert all(f.distance_mm > 0 for f in before)
    assert not any("epicondyles" in f.message for f in before)
    a = actor(person)
    for joint, bone, apart in (("elbow", "humeral", 0.055), ("knee", "femoral", 0.09)):
        for side, sign in (("l", 1), ("r", -1)):
            medial, lateral = (a.features[f"{side}_{bone}_{part}_epicondyle"] for part in ("medial", "lateral"))
            x = a.places[f"{side}_{joint}"][0]
            assert sign * medial[0] < sign * x < sign * lateral[0] and np.linalg.norm(lateral - medial) > apart


# What is done to the points: point, shift in metres -> the rule that finds it, of which point.
ERRORS = {
    "a": ("l_elbow", (0.0, 0.0, 0.025), "l_elbow"),
    "b": ("l_carpal_proximal_interphalangeal_3", (0.006, 0.0, 0.0), "l_carpal_proximal_interphalangeal_3"),
    "c": ("r_elbow", (0.0, 0.0, 0.09), "r_elbow"),
    "d": ("vt1", (0.0, 0.0, 0.05), "vt1"),
    "e": ("r_hip", (0.0, 0.03, 0.0), "r_hip"),
    "f": ("l_knee", (0.0, 0.17, 0.0), "l_knee"),
    "g": ("r_radiocarpal", (0.0, 0.1, 0.2), "r_radiocarpal"),
}


@pytest.mark.parametrize("rule", ERRORS)
def test_an_injected_error_is_found(good, rule):
    name, shift, where = ERRORS[rule]
    key = lambda f: (f.rule, f.point)  # noqa: E731
    clean = {key(f) for f in examine(actor(good))}
    assert (rule, where) not in clean
    wrong = good.copied()
    wrong.joint(name).center = wrong.joint(name).center + shift
    found = {key(f): f for f in examine(actor(wrong))}
    assert (rule, where) in found
    hit = found[rule, where]
    assert 0 < hit.distance_mm < 400
    if hit.move_mm is not None and rule in "acde":  # the move goes back
        assert np.dot(hit.move_mm, shift) < 0


def test_a_turned_joint_is_found():
    body = default_body(2)
    body.joint("l_elbow").rotation = np.array([1.0, 0, 0, 0.5])
    hit = [f for f in examine(actor(body)) if f.point == "l_elbow"]
    assert [f.rule for f in hit] == ["g"] and "29 degrees" in hit[0].message


def test_locked_and_edited_points_stay(person):
    a = actor(person)
    there = a.places["r_elbow"] + [0.01, 0, 0]
    b = place(a, lock=["l_elbow"], edits={"r_elbow": there})
    assert np.array_equal(b.places["l_elbow"], a.places["l_elbow"]) and np.array_equal(b.places["r_elbow"], there)
    assert b.locked == {"l_elbow", "r_elbow"}
    assert not np.array_equal(place(a).places["l_elbow"], a.places["l_elbow"])
    with pytest.raises(VitruvianError, match="expected names of the 87 points, found 'l_ellbow'"):
        place(a, lock=["l_ellbow"])
    with pytest.raises(VitruvianError, match="expected a humanoid with a surface"):
        place(actor(default_body(1)))


def test_units_of_the_file_do_not_matter(shared):
    """Jin is in units of 22.5 mm: distances are millimetres of the figure that is seen."""
    a = actor(vt.load(shared / "data/hanim/JinLOA3.x3d"))
    found = examine(a)
    assert a.stature * a.scale == pytest.approx(1.59, abs=0.01)
    assert Counter(f.rule for f in found)["e"] == 0 and max(f.distance_mm for f in found) < 60


def test_check_tells_about_points(tmp_path, shared):
    file, out = shared / "data/hanim/JinLOA3.x3d", tmp_path / "jin.x3d"
    run = lambda *a: subprocess.run([sys.executable, "-m", "vitruvian", *a], capture_output=True, text=True)  # noqa: E731
    said = run("check", str(file), "--points", "--json")
    told = json.loads(said.stdout)[0]["actors"][0]
    assert told["points"] == 87 and told["missing"] == [] and told["surface"]
    assert {"rule", "point", "distance_mm", "message", "move_mm"} == set(told["findings"][0])
    done = run("check", str(file), "--place", str(out), "--lock", "l_elbow", "--json")
    again = json.loads(done.stdout)[0]["actors"][0]
    assert len(again["findings"]) < len(told["findings"]) and "r_elbow: moved by" in done.stderr
    assert "l_elbow: moved" not in done.stderr
    assert run("check", str(file), "--lock", "l_elbow").stderr.startswith("error: --lock: says what --place leaves")
