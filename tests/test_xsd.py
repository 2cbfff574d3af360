"""What we write is valid by the X3D schemas, their known defects subtracted."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from scene_figure import typed
from vitruvian.formats.registry import write_scene
from vitruvian.hanim.build import scene_of
from vitruvian.hanim.humanoid import MotionData
from written import people, real_figures, write

# The schemas' own defects: what the standard allows and they don't.
KNOWN = {"displacers of joints": r"Element 'HAnimDisplacer': This element is not expected"}


def complaints(shared: Path, files: list[Path]) -> dict[str, list[str]]:
    """What the schemas say of each file, known defects of theirs left out. The validator shows five lines a file."""
    script = shared / "hanim" / "referee" / "xsd_validate.py"
    command = [sys.executable, str(script), str(shared / "hanim" / "xsd"), *map(str, files)]
    out = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False).stdout
    found: dict[str, list[str]] = {}
    for line in out.splitlines():
        verdict = re.fullmatch(r"(valid|INVALID) (\S+) (\S+)", line)
        if verdict:
            found[verdict[3]] = lines = []
        elif not any(re.search(known, line) for known in KNOWN.values()):
            lines.append(line)
    assert list(found) == [f.name for f in files], out
    return found


@pytest.mark.parametrize("version", ["2.0", "1.0"])
def test_real_figures(shared: Path, tmp_path: Path, version: str) -> None:
    files = [write(h, tmp_path, n, "x3d", version).path for n, h in real_figures(shared).items()]
    assert len(files) >= 16
    assert {n: c for n, c in complaints(shared, files).items() if c} == {}


@pytest.mark.parametrize("version", ["2.0", "1.0"])
def test_people(shared: Path, tmp_path: Path, version: str) -> None:
    files = [write(people()[n], tmp_path, n, "x3d", version).path for n in ("person1-walks", "person4")]
    assert {n: c for n, c in complaints(shared, files).items() if c} == {}


def test_small_figures(shared: Path, tmp_path: Path) -> None:
    """With everything we know in one figure; what has no displacer under a joint is valid without any exception."""
    ada = typed(1)
    ada.motions = [MotionData("run", ["vl5"], [("Xrotation",)], ada.tracks[0].keys[:, None])]
    files = []
    for name, h in {"ada": ada, "segments": typed(3, skin=False), "loa4": typed(4)}.items():
        for version in ("2.0", "1.0"):
            scene, _ = scene_of([h], version=version)
            files.append(tmp_path / f"{name}_{version}.x3d")
            write_scene(scene, files[-1])
    assert {n: c for n, c in complaints(shared, files).items() if c} == {}


def test_the_referee_sees_mistakes(shared: Path, tmp_path: Path) -> None:
    scene, _ = scene_of([typed(1, skin=False)], version="2.0")
    good = tmp_path / "good.x3d"
    write_scene(scene, good)
    bad = tmp_path / "bad.x3d"
    bad.write_text(good.read_text().replace("loa='1'", "loa='one'", 1))
    found = complaints(shared, [good, bad])
    assert not found["good.x3d"]
    assert found["bad.x3d"]
