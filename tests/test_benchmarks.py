"""Benchmarks answer rows that the command can print; what they measure is theirs to say (`vitruvian bench`)."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"
NAMES = sorted(p.name for p in FOLDER.glob("[a-z]*.py"))
ONE = """
from __future__ import annotations
from dataclasses import dataclass


@dataclass
class Case:  # looks its module up
    points: int


def rows(quick=False):
    return [{"name": "a task", "ours_s": 0.0012, "peer": None, "peer_s": None, "ratio": None, "goal": ">= 1",
             "holds": quick}]
"""


@pytest.mark.parametrize("name", NAMES)
def test_rows_are_made_in_one_place(name: str) -> None:
    text = (FOLDER / name).read_text()
    assert "row(" in text and '"ours_s":' not in text
    helped = subprocess.run([sys.executable, FOLDER / name, "--help"], capture_output=True, text=True, timeout=60)
    assert helped.returncode == 0 and "--quick" in helped.stdout, helped.stderr


def test_the_command_prints_each_benchmark_and_says_what_was_missed(tmp_path: Path) -> None:
    (tmp_path / "benchmarks").mkdir()
    (tmp_path / "benchmarks" / "one.py").write_text(ONE)

    def run(*more: str) -> str:
        command = [sys.executable, "-m", "vitruvian", "bench", *more]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert "a task" in run() and "1.2 ms" in run() and "MISSED" in run()
    assert "holds" in run("--quick")
    assert json.loads(run("--json"))["rows"][0]["ours_s"] == 0.0012
