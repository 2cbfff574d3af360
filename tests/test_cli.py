"""The command line as a user meets it: answers, statuses, one-line errors."""

from __future__ import annotations

import functools
import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest


def run(*args: object, timeout: float = 60) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "vitruvian", *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout)


def answer(*args: object) -> dict | list:
    """The JSON document of a command that must succeed and print nothing else to stdout."""
    done = run(*args, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def fails(*args: object) -> str:
    """The one `error:` line of a command that must refuse."""
    done = run(*args)
    assert done.returncode == 2, (done.stdout, done.stderr)
    assert "Traceback" not in done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("error:")]
    others = [line for line in done.stderr.splitlines() if not line.startswith(("error:", "warning:"))]
    assert len(errors) == 1 and not others, done.stderr
    return errors[0]


@pytest.fixture(scope="module")
def anna(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A person written by the command line."""
    path = tmp_path_factory.mktemp("cli") / "anna.x3d"
    facts = answer("person", "--gender", "female", "--age", "40", "--height", "1.68", "--loa", "3", "-o", path)
    assert facts["height_m"] == pytest.approx(1.68, abs=0.005)
    assert 40 < facts["mass_kg"] < 90
    assert 0.5 < facts["measures"]["waist"] < 1.1
    return path


COMMANDS = ["demo", "info", "check", "convert", "pose", "person", "animate", "view", "render", "bench"]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(command: str) -> None:
    done = run(command, "--help")
    assert done.returncode == 0
    assert f"Example: vitruvian {command}" in " ".join(done.stdout.split())


def test_info_counts_what_a_person_has(anna: Path) -> None:
    (facts,) = answer("info", anna)["humanoids"]
    assert (facts["joints"], facts["segments"], facts["loa"], facts["version"]) == (94, 94, 3, "2.0")
    assert facts["displacers"] == 76
    assert facts["vertices"] > 13_000 and facts["triangles"] > 25_000


def test_info_about_itself() -> None:
    facts = answer("info", "--self")
    assert facts["kernels"] in ("x86-64-v3", "baseline", "numpy")


def test_a_written_person_passes_the_check(anna: Path) -> None:
    (document,) = answer("check", anna)
    assert document["ok"], document["findings"]


def test_check_says_no_with_status_one(tmp_path: Path) -> None:
    bad = tmp_path / "bad.x3d"
    bad.write_text(
        '<X3D version="4.0" profile="Immersive"><Scene><HAnimHumanoid DEF="h" name="h" version="2.0">\n'
        '<HAnimJoint DEF="r" name="humanoid_root" containerField="skeleton"'
        ' skinCoordIndex="0 7" skinCoordWeight="1 1"/>\n'
        '<Coordinate DEF="c" containerField="skinCoord" point="0 0 0"/></HAnimHumanoid></Scene></X3D>'
    )
    done = run("check", bad, "--json")
    assert done.returncode == 1
    (document,) = json.loads(done.stdout)
    assert not document["ok"]
    rules = {f["rule"]: f for f in document["findings"]}
    assert rules["S02"]["severity"] == "error" and rules["S02"]["line"] == 2
    assert "7" in fails("info", bad)


def test_pose_writes_the_matrices_that_skinning_uses(anna: Path, tmp_path: Path) -> None:
    import numpy as np

    out = tmp_path / "m.json"
    answer("pose", anna, "--joints", '{"l_knee": [1, 0, 0, 0.8]}', "--matrices", out, "-o", tmp_path / "p.x3d")
    matrices = json.loads(out.read_text())
    c, s = np.cos(0.8), np.sin(0.8)
    np.testing.assert_allclose(np.array(matrices["l_knee"])[:3, :3], [[1, 0, 0], [0, c, -s], [0, s, c]], atol=1e-12)
    np.testing.assert_allclose(matrices["r_knee"], np.eye(4), atol=1e-12)
    again = answer("pose", tmp_path / "p.x3d", "--joints", "{}")
    np.testing.assert_allclose(again["l_knee"], matrices["l_knee"], atol=1e-5)


def test_pose_refuses_unknown_joints(anna: Path) -> None:
    assert "l_kneee" in fails("pose", anna, "--joints", '{"l_kneee": [1, 0, 0, 0.8]}')
    assert "radians" in fails("pose", anna, "--joints", '{"l_knee": [1, 0, 0]}')
    assert "JSON" in fails("pose", anna, "--joints", "{l_knee")


@pytest.mark.parametrize("kind", ["glb", "x3d", "x3dv", "wrl", "html", "png", "bvh", "obj"])
def test_animate_writes_every_kind(anna: Path, tmp_path: Path, kind: str) -> None:
    out = tmp_path / f"walk.{kind}"
    facts = answer("animate", anna, "walk", "-o", out)
    assert facts["frames"] > 20 and facts["fps"] == 30
    assert facts["foot_slide_mm"] <= 2 and facts["floor_penetration_mm"] <= 5
    assert out.stat().st_size > 1000


def test_a_captured_walk_keeps_its_feet_on_the_floor(shared: Path, tmp_path: Path) -> None:
    clip = shared / "data" / "motion" / "cmu_131_01_walk.bvh"
    facts = answer("animate", "person", clip, "-o", tmp_path / "walk.glb")
    assert facts["frames"] == 994
    # 5 mm in the worst frame of eight seconds: fast pivots, which the feet make in the capture too
    assert facts["foot_slide_mm"] <= 5 and facts["floor_penetration_mm"] <= 5


@pytest.mark.parametrize("kind", ["wrl", "x3dv", "json", "glb", "x3d"])
def test_convert_real_bodies(shared: Path, tmp_path: Path, kind: str) -> None:
    source = shared / "data" / "hanim" / "JinNoAnimations_Fixed.x3d"
    out = tmp_path / f"jin.{kind}"
    report = answer("convert", source, out)
    assert out.stat().st_size > 10_000
    assert isinstance(report["lost"], list)
    if kind != "glb":
        (before,) = answer("info", source)["humanoids"]
        (after,) = answer("info", out)["humanoids"]
        assert after["vertices"] == before["vertices"] and after["triangles"] == before["triangles"]


def test_every_command_takes_json(shared: Path, tmp_path: Path) -> None:
    """An X3D JSON file is checked, repaired, converted and posed; other JSON is refused in one line."""
    source = tmp_path / "joe.json"
    answer("convert", shared / "data" / "hanim" / "JoeKick.x3d", source)
    checked = run("check", source, "--json")
    assert checked.returncode == 1
    (document,) = json.loads(checked.stdout)
    lines = source.read_text().splitlines()
    (pair,) = [f for f in document["findings"] if f["rule"] == "S01"]
    assert "l_elbow" in pair["message"] and '"HAnimJoint"' in lines[pair["line"] - 1]
    repaired = run("check", source, "--fix", tmp_path / "mended.json", "--also", "S01", "--json")
    (mended,) = json.loads(repaired.stdout)
    assert not [f for f in mended["findings"] if f["rule"] == "S01"]
    answer("pose", tmp_path / "mended.json", "--joints", '{"l_knee": [1, 0, 0, 0.8]}', "-o", tmp_path / "posed.x3dj")
    assert answer("info", tmp_path / "posed.x3dj")["format"] == "x3dj"
    (tmp_path / "other.json").write_text('{"panels": []}')
    assert 'expected {"X3D": ...} or {"pattern": ...} or ' in fails("info", tmp_path / "other.json")


def test_convert_folds_joints_above_a_level(anna: Path, tmp_path: Path) -> None:
    out = tmp_path / "coarse.x3d"
    report = answer("convert", anna, out, "--loa", "1")
    assert any("76 joints" in line for line in report["lost"])
    (before,) = answer("info", anna)["humanoids"]
    (after,) = answer("info", out)["humanoids"]
    assert (after["joints"], after["loa"]) == (18, 1)
    assert (after["vertices"], after["sites"]) == (before["vertices"], before["sites"])
    (document,) = answer("check", out)
    assert document["ok"], document["findings"]


def test_mistakes_are_one_line(anna: Path, tmp_path: Path) -> None:
    assert "no such file" in fails("info", tmp_path / "nobody.x3d")
    assert "unknown kind" in fails("info", __file__)
    assert "--out" in fails("person")
    assert "info" in fails("infoo", anna)
    assert "linear" in fails("animate", anna, "walk", "--deformer", "liner", "-o", tmp_path / "a.glb")
    assert "folder" in fails("person", "-o", tmp_path / "no" / "a.glb")
    assert ".tiff" in fails("animate", anna, "walk", "-o", tmp_path / "a.tiff")
    assert "gender" in fails("person", "--gender", "femal", "-o", tmp_path / "a.glb")
    assert "waist" in fails("person", "--measure", "waist", "-o", tmp_path / "a.glb")
    assert not list(tmp_path.iterdir())


def test_an_interrupt_leaves_nothing_half_written(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    command = [sys.executable, "-m", "vitruvian", "demo", "--no-open", "--out", str(out)]
    heard = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # tests may run where it is ignored
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, preexec_fn=heard, **pipes) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("motion"):
                process.send_signal(signal.SIGINT)
                break
        _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert [line for line in err.splitlines() if line.startswith("error:")] == [
        "error: interrupted; no file was left half written"
    ]
    whole = {"demo.glb", "demo.x3d", "demo.html", "demo.png", "demo.mp4"}
    assert {p.name for p in out.iterdir()} <= whole if out.exists() else True


def test_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    out = tmp_path / "a.glb"
    out.write_bytes(b"precious")
    fails("animate", tmp_path / "nobody.x3d", "walk", "-o", out)
    assert out.read_bytes() == b"precious" and len(list(tmp_path.iterdir())) == 1
