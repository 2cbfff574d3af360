"""Names between the versions of the standard, in joints and in motions; conversions on the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import vitruvian as vt
from scene_figure import typed
from vitruvian.cli import app
from vitruvian.hanim import tables
from vitruvian.hanim.convert import converted
from vitruvian.hanim.default import default_body
from vitruvian.hanim.humanoid import MotionData, Track
from vitruvian.motion.tracks import tracks_of

OLD = ("1.1", "200x", "1.0")


@pytest.mark.parametrize("old", OLD)
@pytest.mark.parametrize("start", [*OLD, "2.0"])
def test_names_there_and_back(old: str, start: str) -> None:
    """All 94 joints, their segments, sites and animation; the identity whatever the way."""
    h = default_body(3, start)
    names = [j.name for j in h.joints()]
    key, turn = np.zeros(1), np.array([[0.0, 0, 1, 0.1]])
    h.tracks = [Track(n, "rotation", key, turn, timer="t") for n in names]
    h.motions = [MotionData("m", [*names, "IGNORED"], [("Xrotation",)] * 95, np.ones((2, 95)))]
    there, lost = converted(h, old)
    assert lost == []
    assert len({j.name for j in there.joints()}) == 94
    assert [tables.canonical(j.name) for j in there.joints()] == [tables.canonical(n) for n in names]
    assert all(tables.name_in(j.name, old) == j.name for j in there.joints())
    up, lost = converted(there, "2.0")
    assert (lost, up.loa) == ([], 3)
    back, lost = converted(up, start)
    assert lost == []
    assert [j.name for j in back.joints()] == names
    assert [t.target for t in back.tracks] == names
    assert back.motions[0].joints == h.motions[0].joints
    assert [g.name for g in back.segments()] == [g.name for g in h.segments()]
    if start != "2.0":  # 2.0 has feature points that 1.x lacks a name for
        assert [s.name for s in back.all_sites()] == [s.name for s in h.all_sites()]


def run(*arguments: object) -> dict:
    result = CliRunner().invoke(app, ["convert", *map(str, arguments), "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def test_convert_goes_both_ways(tmp_path: Path) -> None:
    h = vt.person(loa=4, outfit=None, hair="none")
    motion = vt.walk(vt.pack(h).skeleton, fps=10)
    vt.save(replace(h, tracks=tracks_of(motion, timer="walk")), tmp_path / "fine.x3d")
    report = run(tmp_path / "fine.x3d", tmp_path / "coarse.x3d", "--loa", 1)
    assert 0.001 < report["max_vertex_error_m"] < 0.1
    assert any("folded" in x for x in report["lost"])
    coarse = vt.load(tmp_path / "coarse.x3d")
    assert (len(coarse.joints()), coarse.loa) == (18, 1)
    assert len(coarse.tracks) > 10
    report = run(tmp_path / "coarse.x3d", tmp_path / "again.x3d", "--loa", 3)
    again = vt.load(tmp_path / "again.x3d")
    assert (len(again.joints()), again.loa, report["max_vertex_error_m"]) == (94, 3, 0.0)
    report = run(tmp_path / "fine.x3d", tmp_path / "old.wrl")  # joints of 2.0 only: their motion is carried
    old = vt.load(tmp_path / "old.wrl")
    assert len(old.joints()) == 94
    assert {t.target for t in old.tracks} <= {j.name for j in old.joints()}
    assert any("m off" in x for x in report["lost"])


def test_convert_cuts_welds_and_sets_upright(tmp_path: Path) -> None:
    h = typed(1)
    h.joint("l_shoulder").rotation = np.array([0, 0, 1.0, 1.2])
    vt.save(h, tmp_path / "a.x3d")
    run(tmp_path / "a.x3d", tmp_path / "cut.x3d", "--skin", "segments", "--rest", "standard")
    cut = vt.load(tmp_path / "cut.x3d")
    assert cut.skin == []
    assert cut.joint("l_shoulder").rotation[3] == 0
    assert sum(len(s.triangles) for g in cut.segments() for s in g.shapes) == 36
    run(tmp_path / "cut.x3d", tmp_path / "whole.x3d", "--skin", "seamless")
    whole = vt.load(tmp_path / "whole.x3d")
    assert sum(len(s.triangles) for s in whole.skin) == 36
    assert not any(g.shapes for g in whole.segments())
    facts = CliRunner().invoke(app, ["info", str(tmp_path / "cut.x3d"), "--json"])
    assert json.loads(facts.stdout)["humanoids"][0]["triangles"] == 36


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--skin", "leather"], "segments or seamless"),
        (["--rest", "asleep"], "standard"),
        (["--hanim", "1.1", "--loa", "4"], "ends at 3"),
    ],
)
def test_bad_options_are_one_line(tmp_path: Path, options: list[str], said: str) -> None:
    vt.save(typed(1), tmp_path / "a.x3d")
    result = CliRunner().invoke(app, ["convert", str(tmp_path / "a.x3d"), str(tmp_path / "b.x3d"), *options])
    text = f"{result.output}{result.exception}"
    assert result.exit_code != 0
    assert said in text
    assert not (tmp_path / "b.x3d").exists()
