"""The command that makes motion of markers, from files to files; and what it says when they do not tell enough."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import vitruvian as vt
from capture_maker import c3d, cloud
from test_tracking import POINTS, markers, performed
from vitruvian.cli import app
from vitruvian.errors import VitruvianError
from vitruvian.motion.markers import Markers
from vitruvian.motion.names import VERTEBRAE
from vitruvian.motion.tracking import track
from vitruvian.show.plots import residual_panels, svg


@pytest.fixture(scope="module")
def body():
    return vt.pack(vt.person(hair="none"))


@pytest.fixture(scope="module")
def walking(body):
    """Names and points (F,M,3) of half a second of standing and some walking."""
    return tuple(POINTS), markers(body.skeleton, performed(body.skeleton, 1))[30:]


def solve(*args: object):
    return CliRunner().invoke(app, ["solve", *map(str, args)])


def test_a_file_of_markers_becomes_motions_and_a_plot(walking, tmp_path):
    names, points = walking
    source, plot = tmp_path / "walk.trc", tmp_path / "off.svg"
    vt.save(Markers(names, points, 60.0), source)
    answer = solve(source, "-o", tmp_path / "walk.bvh", "--plot", plot, "--up", "y", "--json")
    assert answer.exit_code == 0, answer.output
    found = json.loads(answer.stdout)
    assert found["frames"] == len(points) and found["rms_mm"] < 2 and found["max_mm"] < 15
    assert set(found["per_marker_rms_mm"]) == set(names) and found["frames_per_second"] > 0
    motion = vt.load(tmp_path / "walk.bvh")
    assert len(motion) == len(points) and {"humanoid_root", "l_knee", "vl5"} <= set(motion.skeleton.names)
    drawn = plot.read_text()
    assert "root mean square of all markers" in drawn and all(n in drawn for n in names)


def test_a_body_that_is_given_moves(walking, tmp_path):
    names, points = walking
    source, own = tmp_path / "walk.csm", tmp_path / "own.x3d"
    vt.save(Markers(names, points[:70], 60.0), source)
    vt.save(vt.person(height=1.6, loa=2, hair="none"), own)
    answer = solve(source, "--up", "z", "--body", own, "-o", tmp_path / "moved.x3d", "--json")
    assert answer.exit_code == 0, answer.output
    assert json.loads(answer.stdout)["floor_penetration_mm"] < 5
    moved = vt.load(tmp_path / "moved.x3d")
    motion = vt.motion_of(moved, vt.pack(moved).skeleton)
    assert motion is not None and len(motion) >= 60
    knee = motion.skeleton.index["l_knee"]
    assert np.degrees(np.ptp(2 * np.arccos(np.clip(np.abs(motion.rotation[:, knee, 3]), 0, 1)))) > 20


def test_a_map_says_where_markers_sit(walking, tmp_path):
    names, points = walking
    labels = tuple(f"P{k}" for k in range(len(names)))
    source, said = tmp_path / "p.trc", tmp_path / "map.json"
    vt.save(Markers(labels, points[:60], 60.0), source)
    answer = solve(source, "-o", tmp_path / "p.bvh", "--up", "y")
    assert isinstance(answer.exception, VitruvianError) and "unknown: P0, P1" in str(answer.exception)
    said.write_text(json.dumps({k: f"{n}_pt" for k, n in zip(labels, names)} | {"P0": ""}))
    answer = solve(source, "-o", tmp_path / "p.bvh", "--up", "y", "--markers", said, "--json")
    assert answer.exit_code == 0, answer.output
    found = json.loads(answer.stdout)
    assert found["rms_mm"] < 2 and "P0" not in found["per_marker_rms_mm"]
    for text, message in (("[1]", "expected {"), ("{", "expected JSON"), ('{"Q": "l_asis"}', "no marker 'Q'")):
        said.write_text(text)
        answer = solve(source, "-o", tmp_path / "p.bvh", "--up", "y", "--markers", said)
        assert isinstance(answer.exception, VitruvianError) and message in str(answer.exception)


def test_another_clip_tells_the_bones(body, walking, tmp_path):
    names, points = walking
    first = track(body, names, points, 60.0)
    some = [k for k, n in enumerate(names) if n not in ("l_asis", "glabella")]
    again = track(body, tuple(names[k] for k in some), points[40:70, some], 60.0, performer=first)
    assert again.scale == first.scale and again.rms < 2e-3 and len(again.names) == len(some)
    assert (again.motion.skeleton.centers == first.motion.skeleton.centers).all()
    for name in ("all.trc", "part.trc"):
        vt.save(Markers(names, points if name == "all.trc" else points[40:70], 60.0), tmp_path / name)
    answer = solve(
        tmp_path / "part.trc", "--performer", tmp_path / "all.trc", "--up", "y", "-o", tmp_path / "o.npz", "--json"
    )
    assert answer.exit_code == 0, answer.output
    assert json.loads(answer.stdout)["rms_mm"] < 3


def test_two_people_in_one_file(tmp_path):
    points = np.concatenate([cloud(), cloud() + [2.0, 0.0, 0.0]], axis=1)
    points = 1000 * np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)  # mm, Z up
    labels = [f"{who}:{n}" for who in ("Ann", "Bob") for n in ("LFHD", "RFHD", "C7", "STRN", "LASI", "RASI")]
    labels += [f"{who}:{n}" for who in ("Ann", "Bob") for n in ("LKNE", "RKNE", "LHEE", "RHEE", "LTOE", "RTOE")]
    order = [*range(6), *range(12, 18), *range(6, 12), *range(18, 24)]
    path = tmp_path / "two.c3d"
    path.write_bytes(c3d(points[:, order], labels=labels))
    answer = solve(path, "-o", tmp_path / "two.bvh")
    assert isinstance(answer.exception, VitruvianError) and "Ann (12 markers), Bob (12 markers)" in str(
        answer.exception
    )
    answer = solve(path, "--actor", "Bob", "-o", tmp_path / "bob.bvh", "--json")
    assert answer.exit_code == 0, answer.output
    found = json.loads(answer.stdout)
    assert set(found["per_marker_rms_mm"]) >= {"LFHD", "RTOE"}
    bob = vt.load(tmp_path / "bob.bvh")
    assert abs(bob.translation[0, 0] - 2.0) < 0.2, "where Bob walks"


def test_markers_that_are_missing_and_a_clip_that_stands_still(body, walking):
    names, points = walking
    still = np.repeat(points[:1], 20, axis=0)
    still[:, names.index("l_radial_styloid")] = np.nan
    still[3:9, names.index("r_asis")] = np.nan
    found = track(body, names, still, 60.0)
    assert any("never seen: l_radial_styloid" in n for n in found.notes)
    assert any("missing points" in n for n in found.notes)
    assert np.abs(np.diff(found.motion.rotation, axis=0)).max() < 1e-3 and found.rms < 2e-3
    one = track(body, names, still[:1], 60.0)
    assert len(one.motion) == 1


def test_a_wrong_unit_is_no_dwarf(body, walking):
    with pytest.raises(VitruvianError, match="times the size of the body; say unit="):
        track(body, walking[0], walking[1][:20] / 100, 60.0)


def test_a_limb_without_markers_stays_as_it_rests(body, walking):
    names, points = walking
    some = [
        k
        for k, n in enumerate(names)
        if not n.startswith("l_") or not any(w in n for w in ("hum", "ulna", "rad", "meta"))
    ]
    found = track(body, tuple(names[k] for k in some), points[:, some], 60.0)
    elbow = found.motion.skeleton.index["l_elbow"]
    assert (np.abs(found.motion.rotation[:, elbow, 3]) > 1 - 1e-9).all() and found.rms < 3e-3


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("nobody.trc", "-o", "x.bvh"), "no such file"),
        (("walk.bvh", "-o", "x.bvh"), "expected markers"),
        (("walk.trc", "-o", "x.doc"), "can't write"),
        (("walk.trc", "-o", "x.bvh", "--up", "y", "--still", "5", "9"), "--still: expected FROM < TO"),
        (("walk.trc", "-o", "x.bvh", "--up", "y", "--plot", "x.png"), "ends in .svg"),
    ],
)
def test_what_it_does_not_do(args, message, walking, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    vt.save(Markers(walking[0], walking[1][:10], 60.0), "walk.trc")
    vt.save(vt.walk(vt.pack(vt.person(loa=1, hair="none")).skeleton), "walk.bvh")
    answer = solve(*args)
    assert isinstance(answer.exception, VitruvianError) and message in str(answer.exception)


def test_residuals_are_drawn_with_their_gaps():
    residual = np.abs(np.random.default_rng(0).normal(size=(50, 8))) * 0.01
    residual[:, 2], residual[10:20, 3] = np.nan, np.nan
    residual[:, 5] += 0.03
    panels = residual_panels(tuple("abcdefgh"), residual)
    assert [len(p.lines) for p in panels] == [1, 6, 1] and next(iter(panels[1].lines)) == "f"
    assert not any("c" in p.lines for p in panels)
    assert "NaN" not in svg(panels, np.arange(50) / 60, "t").replace("nan", "NaN")


@pytest.mark.parametrize(
    "file", ["opensim_walk_free_01.trc", "opensim_ik_subject01_synthetic_marker_data.trc", "opensim_walking2.c3d"]
)
def test_laboratories_see_people_who_hold_themselves_upright(body, shared, file):
    """Fits of millimetres do not make the spine curl: all vertebrae together turn by less than a bow."""
    seen = vt.load(shared / "data" / "motion" / file)
    found = track(body, seen.names, seen.points, seen.fps)
    skeleton = found.motion.skeleton
    spine = [j for n, j in skeleton.index.items() if n in VERTEBRAE]
    turn = 2 * np.degrees(np.arccos(np.clip(np.abs(found.motion.rotation[:, spine, 3]), 0, 1)))
    assert np.median(turn.sum(axis=1)) < 75 and turn.max() < 12
    assert found.rms < 0.015 and np.nanmax(found.residual) < 0.04
