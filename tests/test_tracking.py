"""Markers become motion: synthetic truth, noise, gaps, misplaced and exchanged markers, real laboratories."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

import vitruvian as vt
from vitruvian.body.kinematics import joint_positions, site_positions
from vitruvian.body.rotations import rotate
from vitruvian.errors import VitruvianError
from vitruvian.motion.calibration import groups, scaled
from vitruvian.motion.filters import lowpass
from vitruvian.motion.gaps import cleaned
from vitruvian.motion.limits import beyond, within
from vitruvian.motion.marker_sets import place_of, sides
from vitruvian.motion.tracking import track
from vitruvian.motion.turns import world_rotations

POINTS = [
    *("cervicale", "suprasternale", "substernale", "skull_vertex", "glabella"),
    *(
        f"{side}_{name}"
        for side in "lr"
        for name in (
            "asis", "psis", "acromion", "humeral_lateral_epicondyle", "humeral_medial_epicondyle", "radial_styloid",
            "ulnar_styloid", "femoral_lateral_epicondyle", "femoral_medial_epicondyle", "lateral_malleolus",
            "medial_malleolus", "calcaneus_posterior", "metatarsal_phalanx_1", "metatarsal_phalanx_5", "tragion",
            "metacarpal_phalanx_2", "metacarpal_phalanx_5",
        )
    ),
]  # fmt: skip
JUDGED = [f"{s}_{n}" for s in "lr" for n in ("hip", "knee", "talocrural", "shoulder", "elbow", "radiocarpal")] + [
    "humanoid_root",
    "skullbase",
]


@pytest.fixture(scope="module")
def body():
    return vt.pack(vt.person(hair="none"))


def performed(skeleton, cycles=3):
    """A walk within the limits that begins with a second of standing at rest."""
    walk = vt.walk(skeleton, fps=60, cycles=cycles)
    turn = within(skeleton, walk.rotation)
    rest = np.tile([0.0, 0.0, 0.0, 1.0], (60, len(skeleton), 1))
    move = np.concatenate([np.zeros((60, 3)), walk.translation])
    return vt.Motion(skeleton, 60.0, np.concatenate([rest, turn]), move)


def markers(skeleton, motion):
    at = site_positions(skeleton, vt.joint_matrices(skeleton, motion))
    return at[:, [skeleton.site_index[f"{n}_pt"] for n in POINTS]]


def errors(truth, found, rows=slice(60, None)):
    """RMS of the turns of limbs in the world, degrees, and of their joints' centres, mm."""
    a, b = (world_rotations(m.skeleton.parents, m.rotation)[rows] for m in (truth, found))
    p, q = (joint_positions(m.skeleton, vt.joint_matrices(m.skeleton, m))[rows] for m in (truth, found))
    some = [truth.skeleton.index[n] for n in JUDGED]
    turn = 2 * np.degrees(np.arccos(np.clip(np.abs(np.sum(a[:, some] * b[:, some], axis=-1)), 0, 1)))
    apart = 1000 * np.linalg.norm(p[:, some] - q[:, some], axis=-1)
    return np.sqrt((turn**2).mean()), np.sqrt((apart**2).mean(axis=0)).max()


def test_the_person_is_found_from_markers_without_noise(body):
    truth = performed(body.skeleton)
    found = track(body, tuple(POINTS), markers(body.skeleton, truth), 60.0)
    turn, apart = errors(truth, found.motion)
    assert turn < 1.0 and apart < 5.0, (turn, apart)
    assert found.rms < 1e-3 and all(abs(v - 1) < 0.01 for v in found.scale.values())
    assert np.abs(beyond(found.motion.skeleton, found.motion.rotation)).max() < 1e-9


def test_noise_gaps_and_misplaced_markers(body):
    """2 mm noise, 10 % gaps, every marker 1 cm off its place: within 3 degrees and 12 mm, with a still stand to begin."""
    truth = performed(body.skeleton)
    rng = np.random.default_rng(1)
    s = body.skeleton
    points = markers(s, truth)
    off = rng.normal(size=points.shape[1:])
    off *= 0.01 / np.linalg.norm(off, axis=1, keepdims=True)
    spin = vt.joint_matrices(s, truth)[:, [s.site_joints[s.site_index[f"{n}_pt"]] for n in POINTS], :3, :3]
    points = points + np.einsum("fmij,mj->fmi", spin, off) + rng.normal(size=points.shape) * 0.002
    lost = np.zeros(points.shape[:2], bool)
    for k in range(len(POINTS)):
        while lost[60:, k].mean() < 0.1:
            first = int(rng.integers(60, len(points)))
            lost[first : first + int(rng.integers(3, 40)), k] = True
    points[lost] = np.nan
    found = track(body, tuple(POINTS), points, 60.0, still=slice(0, 60))
    # the truth jumps from the stand to the walk, which no filter should see
    walking = lowpass(
        replace(found.motion, rotation=found.motion.rotation[60:], translation=found.motion.translation[60:]), 6
    )
    truth = replace(truth, rotation=truth.rotation[60:], translation=truth.translation[60:])
    turn, apart = errors(truth, walking, slice(None))
    assert turn < 3.0 and apart < 12.0, (turn, apart)
    assert any("missing points" in n for n in found.notes)


def test_another_performer_has_other_bones(body):
    """Taller, with long shanks and short arms: the lengths come out."""
    part = groups(body.skeleton)
    factor = dict.fromkeys(part, 1.1) | {"shank": 1.25, "upper arm": 0.98, "spine": 1.15}
    performer = scaled(body.skeleton, factor)
    truth = performed(performer, 2)
    found = track(body, tuple(POINTS), markers(performer, truth), 60.0)
    for name in ("shank", "thigh", "upper arm", "spine", "forearm"):
        assert found.scale[name] == pytest.approx(factor[name], abs=0.025), name
    turn, apart = errors(truth, found.motion)
    assert turn < 2.0 and apart < 12.0


def test_exchanged_labels_and_stray_points_are_seen(body):
    truth = performed(body.skeleton, 2)
    points = markers(body.skeleton, truth)
    clean = points.copy()
    a, b = POINTS.index("l_lateral_malleolus"), POINTS.index("r_lateral_malleolus")
    points[80:110, [a, b]] = points[80:110, [b, a]]
    points[100:104, 3] += 0.3
    found = track(body, tuple(POINTS), points, 60.0)
    assert any("exchanged" in n for n in found.notes)
    assert errors(truth, found.motion)[1] < 6.0
    assert np.isnan(found.residual[100:104, 3]).all() or any("jump" in n for n in found.notes)
    assert np.isfinite(clean).all()


def test_gaps_are_filled_up_to_a_fifth_of_a_second():
    at = np.arange(200) / 100.0
    points = np.stack([np.sin(3 * at), np.cos(2 * at), at], axis=1)[:, None]
    holes = points.copy()
    holes[20:40] = np.nan
    holes[100:140] = np.nan
    holes[60, 0, 0] += 5.0
    out, notes = cleaned(holes, 100.0, ("m",))
    assert np.abs(out[20:40] - points[20:40]).max() < 1e-3
    assert np.isnan(out[100:140]).all() and abs(out[60, 0, 0] - points[60, 0, 0]) < 1e-3
    assert len(notes) == 2


def test_names_of_laboratories():
    assert place_of("anna:LASI").site == "l_asis" and place_of("R.Knee.Lat").site == "r_femoral_lateral_epicondyle"
    assert place_of("l_acromion_pt").site == "l_acromion" and place_of("C7").site == "cervicale"
    assert place_of("R.Thigh.Front").joint == "r_hip" and place_of("LHJC").center
    assert place_of("*21") is None
    assert sides(("LASI", "C7", "RASI")) == [(0, 2)]


@pytest.mark.parametrize(
    ("names", "points", "message"),
    [
        (("a", "b"), np.zeros((3, 2, 3)), "at least 6 whose place is known, found 0; unknown: a, b"),
        (tuple(POINTS), np.full((3, len(POINTS), 3), np.nan), "no frame shows six"),
        (tuple(POINTS), np.zeros((3, 4, 3)), "expected shape"),
    ],
)
def test_what_is_not_enough(body, names, points, message):
    with pytest.raises(VitruvianError, match=message):
        track(body, names, points, 60.0)


def read_trc(path):
    lines = path.read_text().splitlines()
    names = [t for t in lines[3].split("\t") if t.strip()][2:]
    rows = [line.split("\t")[2 : 2 + 3 * len(names)] for line in lines[5:] if line.strip()]
    values = [[float(v) if v.strip() else np.nan for v in r] + [np.nan] * (3 * len(names) - len(r)) for r in rows]
    return tuple(names), np.array(values).reshape(len(rows), len(names), 3)


@pytest.mark.parametrize(
    ("file", "unit", "most"),
    [
        ("opensim_walk_free_01.trc", 1e-3, 0.015),
        ("opensim_subject01_static.trc", 1e-3, 0.015),
        ("opensim_ik_subject01_synthetic_marker_data.trc", 1.0, 0.015),
    ],
)
def test_real_laboratories(body, shared, file, unit, most):
    names, points = read_trc(shared / "data" / "motion" / file)
    found = track(body, names, points * unit, 60.0)
    assert found.rms < most and np.nanmax(found.residual) < 0.04
    assert len(found.names) == len(names)
    knee = found.motion.skeleton.index["l_knee"]
    assert np.abs(beyond(found.motion.skeleton, found.motion.rotation)[:, knee]).max() < 1e-9


def test_toes_bend_as_one_and_thumbs_point_ahead(body, shared):
    """Lateral markers of these wrists are on the side of the little finger."""
    names, points = read_trc(shared / "data" / "motion" / "opensim_walk_free_01.trc")
    found = track(body, names, points / 1000, 60.0)
    s = found.motion.skeleton
    for side in "lr":
        toes = [s.index[f"{side}_metatarsophalangeal_{k}"] for k in range(1, 6)]
        assert np.ptp(found.motion.rotation[:, toes], axis=1).max() == 0
    turned = world_rotations(s.parents, found.motion.rotation)
    for side in "lr":
        hand = s.index[f"{side}_radiocarpal"]
        palm = (
            s.site_points[s.site_index[f"{side}_radial_styloid_pt"]]
            - s.site_points[s.site_index[f"{side}_ulnar_styloid_pt"]]
        )
        ahead = rotate(turned[:, 0], np.array([0.0, 0.0, 1.0]))
        assert np.sum(rotate(turned[:, hand], palm) * ahead, axis=1).mean() > 0
    assert any("Wrist" in note for note in found.notes)


def test_it_keeps_up_with_a_camera(body):
    """The poses of 39 markers: at least 120 frames a second, calibration apart, one after the other as in a batch."""
    from vitruvian.motion.tracking import _movers, _Solver, attach

    s = body.skeleton
    truth = performed(s, 6)
    attachment, _, _ = attach(s, tuple(POINTS))
    solver = _Solver(s, attachment, _movers(s, attachment), 60.0)
    points = markers(s, truth)
    start = time.process_time()
    solver.through(points, (np.array([0]), truth.rotation[:1], truth.translation[:1]), None)
    rate = len(points) / (time.process_time() - start)
    assert rate > 120, rate
