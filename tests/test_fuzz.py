"""Mutated files through every reader, and what that found."""

from __future__ import annotations

import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT, SHARED
from skeletons import figure
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats import registry
from vitruvian.hanim.graph import Literal
from vitruvian.hanim.humanoid import Humanoid, MotionData, Track
from vitruvian.hanim.values import parse
from vitruvian.motion.tracks import motion_of

TOOL = ROOT / "tools" / "fuzz_scenes.py"


def fuzz(*arguments: str) -> subprocess.CompletedProcess:
    command = [sys.executable, str(TOOL), "--data", str(SHARED / "data"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)


def test_mutated_files() -> None:
    """The first thousand cases; `.ci/run` runs twenty thousand."""
    run = fuzz("--cases", "1000")
    assert run.returncode == 0, run.stderr
    assert ", 0 failed" in run.stdout
    read = int(run.stdout.split(" could still be read")[0].split()[-1])
    assert 100 < read < 900, run.stdout


def test_a_case_is_always_the_same(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        assert fuzz("--only", "7", "--keep", str(tmp_path / folder)).returncode == 0
    (one,), (two,) = (list((tmp_path / f).iterdir()) for f in ("a", "b"))
    assert one.name == two.name
    assert one.read_bytes() == two.read_bytes()


@pytest.mark.parametrize(
    ("body", "complaint"),
    [("raise KeyError('no')", "KeyError"), ("while True: pass", "hangs"), ("bytearray(3 << 30)", "MemoryError"),
     ("import os; os.abort()", "ended with -6")],
)  # fmt: skip
def test_the_watch_sees_crashes_hangs_and_memory(body: str, complaint: str, tmp_path: Path) -> None:
    code = (
        f"import sys; sys.path.insert(0, {str(TOOL.parent)!r}); import fuzz_scenes as f; f.SECONDS = 0.4\n"
        f"def bad(path, **_):\n  {body}\n"
        "f.endure, f.warm_up = bad, lambda: None\n"
        "print([(x.case, x.what) for x in f.fuzz([3, 5], workers=1)[0]])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert run.stdout.count(complaint) == 2, run.stdout + run.stderr


@pytest.mark.parametrize("make", ["interpolators", "motion"])
def test_endless_clips_are_refused(make: str) -> None:
    """A cycleInterval of years, or millions of frames: not unrolled into memory."""
    skeleton = figure()
    h = Humanoid("long")
    if make == "motion":
        values = np.zeros((10_000_000, 1), np.float32)
        h.motions = [MotionData("m", [skeleton.names[0]], [("Xrotation",)], values)]
    else:
        keys, turns = np.array([0, 1.0]), np.array([[0, 0, 1, 0.0], [0, 0, 1, 1]])
        h.tracks = [Track(skeleton.names[0], "rotation", keys, turns, 1e9, True, "clock")]
    with pytest.raises(VitruvianError, match="expected at most .* frames for"):
        motion_of(h, skeleton)


@pytest.mark.parametrize("text", ["1 \x1c", "\x1c", "1 2\x853", "1 \u2028 2", "1 2 \ud800", "1 \uff11 2"])
@pytest.mark.parametrize("type", ["MFFloat", "MFInt32", "MFVec2f"])
def test_blanks_of_other_scripts_are_no_blanks(text: str, type: str) -> None:
    """Python splits at more characters than X3D does."""
    with pytest.raises(FileError, match="found"):
        parse(Literal(text, "xml", 1), type, "t")


@pytest.mark.parametrize(
    "name",
    sorted(p.relative_to(SHARED / "data").as_posix() for p in (SHARED / "data").rglob("*")
           if p.suffix in {*registry.SCENES, *registry.READERS} and p.stat().st_size < 600_000),
)  # fmt: skip
def test_files_cut_short_at_every_percent(name: str, tmp_path: Path) -> None:
    """One clear error or something usable, in under 2 s of processor time (meshes: every tenth percent)."""
    sys.path.insert(0, str(TOOL.parent))
    try:
        from fuzz_scenes import endure
    finally:
        sys.path.remove(str(TOOL.parent))
    data = (SHARED / "data" / name).read_bytes()
    read = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for percent in range(0, 100, 1 if Path(name).suffix in registry.SCENES else 10):
            path = tmp_path / f"cut{Path(name).suffix}"
            path.write_bytes(data[: len(data) * percent // 100])
            start = time.process_time()
            read.append(endure(path, thorough=percent % 10 == 0))
            assert time.process_time() - start < 2, percent
    assert not all(read)
