"""Contour bodies of real figures: closed, shut in every pose, tunable, at several levels of detail; events intercepted."""

import warnings

import numpy as np
import pytest

import vitruvian as vt
from test_contours import exact, posed, spine, tube
from vitruvian.body.contours import distal_shares, limb_parameters, own_shares, zone_counts, zone_lengths
from vitruvian.body.types import Skin
from vitruvian.deform import contours as operator
from vitruvian.deform.deformer import deformer
from vitruvian.deform.interception import Interceptor
from vitruvian.deform.quality import _boundary, _weld
from vitruvian.errors import VitruvianError, VitruvianWarning
from vitruvian.modeling.contours import contoured, tuned
from vitruvian.modeling.detail import Levels
from vitruvian.modeling.trials import _bare, trials


@pytest.fixture(scope="module")
def made():
    return contoured(vt.person(outfit=None))


@pytest.fixture(scope="module")
def body(made):
    return vt.pack(made.humanoid)


def open_edges(skin: Skin) -> int:
    faces = _weld(skin.rest)[skin.triangles]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 0] != faces[:, 2])
    return len(_boundary(faces[whole], len(skin.rest))[0])


def test_the_person_is_one_closed_surface(made, body):
    assert open_edges(_bare(body).skin) == 0
    assert made.error[0] < 0.001 and made.error[1] < 0.008
    assert {s.name for s in body.contours if len(s.tied)} >= {"l_thigh_def", "l_calf_def", "l_upperarm_def", "c7_def"}


def test_no_hard_pose_opens_a_seam_by_a_bit(made):
    found = {t.pose: t for t in trials(made.humanoid)}
    assert len(found) == 10
    assert all(t.gap == 0 for t in found.values())
    assert all(0.95 < t.volume < 1.02 for t in found.values())
    assert all(t.stretch < 7 for t in found.values())
    assert found["knees 120"].folds == 0 and found["wrists twisted 150"].folds == 0


def test_a_figure_in_segments_becomes_one_with_contours(shared):
    for name, surfaces in (("JinLOA1.x3d", 11), ("NancyPrototypes.wrl", 10)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", VitruvianWarning)
            found = contoured(vt.load(str(shared / "data/hanim" / name)))
            packed = vt.pack(found.humanoid)
        assert len(packed.contours) >= surfaces
        assert found.error[0] / found.scale < 0.004
        left = sum(len(shape.triangles) for s in found.humanoid.segments() for shape in s.shapes)
        assert left > 100  # head, hands and feet stay as they are


def test_parameters_are_edited_as_contours_and_as_lengths(made):
    points = next(c for s in made.humanoid.segments() for c in s.contours if c.name == "l_thigh_def").points
    lengths = zone_lengths(points, upper=3, lower=5)
    assert zone_counts(points, **lengths) == {"upper": 3, "lower": 5}
    fine = np.repeat(points, 2, axis=0)[:-1]
    fine[1::2] = (points[:-1] + points[1:]) / 2
    assert zone_counts(fine, **lengths) == {"upper": 6, "lower": 10}
    before = [c.lower for s in made.humanoid.segments() for c in s.contours if c.name == "l_thigh_def"][0]
    tuned(made.humanoid, {"l_thigh_def": {"lower": lengths["lower"], "mitre": 0.4}})
    surface = next(c for s in made.humanoid.segments() for c in s.contours if c.name == "l_thigh_def")
    assert surface.lower == 5 and surface.mitre == 0.4
    tuned(made.humanoid, {"l_thigh_def": {"lower": before, "mitre": 0.25}})
    with pytest.raises(VitruvianError, match="surface: expected one of"):
        tuned(made.humanoid, {"tail_def": {"lower": 2}})
    with pytest.raises(VitruvianError, match="l_thigh_def lower: expected 0 to 20"):
        tuned(made.humanoid, {"l_thigh_def": {"lower": 99}})


@pytest.mark.parametrize("parameters", [{"upper": 5}, {"fixed": 3, "upper": 6}, {"extra": 18}, {"upper": 2}])
def test_weights_constant_on_contours_are_parameters(parameters):
    own, distal = own_shares(18, **parameters), distal_shares(18, 3)
    found = limb_parameters(own, distal)
    assert np.allclose(own_shares(18, **{k: v for k, v in found.items() if k != "lower"}), own) and found["lower"] == 3
    bent = own.copy()
    bent[9] = 0.37
    with pytest.raises(VitruvianError, match="linear ramp of contours"):
        limb_parameters(bent)


def test_levels_are_switched_and_added_while_running(body):
    levels = Levels(body)
    turns = {
        "l_knee": [1, 0, 0, 1.4],
        "r_shoulder": [0, 0, 1, -1.2],
        "vc4": [0, 1, 0, 0.3],
        "l_radiocarpal": [0, 1, 0, 1],
    }
    m = posed(body.skeleton, **turns)
    full = levels(m)
    coarse = levels.add(contours=2, points=2)
    assert np.array_equal(levels(m), full)  # added, not yet active
    levels.set_lod(coarse)
    assert np.array_equal(levels(m), full[levels.source]) and len(levels.source) < len(full)
    assert open_edges(_bare(levels.body).skin) == 0  # coarse contours meet what is sewn to all of their points
    levels.set_lod(0)
    levels.set_extremities(False)
    assert np.array_equal(levels(np.tile(np.eye(4), (len(body.skeleton), 1, 1))), body.skin.rest.astype(np.float32))
    assert not np.array_equal(levels(m), full)
    levels.set_extremities(True)
    assert np.array_equal(levels(m), full)
    with pytest.raises(VitruvianError, match="level: expected 0 to 1"):
        levels.set_lod(7)


def test_twists_as_first_published_are_rough_and_exact_ones_are_not():
    trunk = spine()
    program = deformer("contours", trunk, twist="paper").operator.program
    assert program.paper
    m = posed(trunk.skeleton, vt1=[np.sqrt(0.75), 0.5, 0, 1.5])[None]
    rough, fine = (deformer("contours", trunk, twist=t)(m)[0] for t in ("paper", "exact"))
    front = trunk.contours[0].vertices
    assert np.abs(rough[front[:4]] - fine[front[:4]]).max() < 1e-6  # above the zone both are the whole turn
    turned = [
        np.arctan2(p[front[:, 0], 0], p[front[:, 0], 2]) - np.arctan2(*p[front[-1, 0], [0, 2]]) for p in (rough, fine)
    ]
    low = turned[1][20] / turned[0][20]
    assert low == pytest.approx(0.8718 / 0.750, abs=0.01)
    straight = posed(trunk.skeleton, vt1=[0, 1, 0, 0.9])[None]
    same = [deformer("contours", trunk, twist=t)(straight) for t in ("paper", "exact")]
    assert np.abs(same[0] - same[1]).max() < 1e-6


def test_events_of_one_time_are_one_computation_and_nothing_is_released_before_its_points():
    trunk = spine()
    seen = []
    box = Interceptor(deformer("contours", trunk), lambda points, turns: seen.append((points, turns)))
    for k, joint in enumerate(["vl5", "vt10", "vt6", "vt1"] * 2 + ["vl5", "vt1"]):
        box.send(f"hanim_{joint}Def", [0, 1, 0, 0.1 * k], 1.0)
    assert box.computed == 0 and not seen  # held back until the step ends
    box.send("hanim_vt6Def", [0, 0, 1, 0.2], 1.04)
    assert box.computed == 1 and set(seen[0][1]) == {"vl5", "vt10", "vt6", "vt1"}
    box.end_of_step()
    assert box.computed == 2
    m = posed(trunk.skeleton, vl5=[0, 1, 0, 0.8], vt10=[0, 1, 0, 0.5], vt6=[0, 0, 1, 0.2], vt1=[0, 1, 0, 0.9])
    assert np.array_equal(seen[-1][0], deformer("contours", trunk)(m))
    box.send("hanim_tailDef", [1, 0, 0, 0.5], 2.0)
    assert box.findings == ["no joint tail: its rotation is passed through"]
    assert np.array_equal(seen[-1][1]["tail"], [1, 0, 0, 0.5]) and not len(seen[-1][0])
    with pytest.raises(VitruvianError, match="4 finite numbers"):
        box.set("vl5", [0, 1, 0, np.nan], 3.0)


def test_vertices_on_a_seam_move_with_it():
    b, _ = tube(joints=3)
    ring = b.contours[1].vertices[-1]
    rest = np.concatenate([b.skin.rest, b.skin.rest[ring]])
    n = len(b.skin.rest)
    from dataclasses import replace

    from vitruvian.body.organise import joined

    points, surfaces = joined(rest + np.where(np.arange(len(rest)) >= n, 3e-7, 0)[:, None], b.contours)
    tied = np.concatenate([s.tied for s in surfaces])
    assert sorted(tied[:, 0]) == list(range(n, n + 16)) and np.array_equal(points[n:], points[ring])
    from vitruvian.body.types import Weights

    w = b.skin.weights
    more = Weights.from_pairs(
        n + 16,
        np.concatenate([w.vertex, np.arange(n, n + 16)]),
        np.concatenate([w.joint, np.full(16, 2)]),
        np.ones(n + 16),
    )
    both = replace(b, skin=Skin(points, b.skin.triangles, more), contours=surfaces)
    m = posed(b.skeleton, j1=[1, 0, 0, 1.0], j2=[0, 0, 1, 1.3])
    out = deformer("contours", both)(m)
    assert np.array_equal(out[n:], out[ring])
    assert np.abs(exact(b, m)[ring] - out[ring]).max() < 1e-6
    assert operator.ROUND < 1
