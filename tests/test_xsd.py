"""What we write is valid by the X3D schemas, their known defects subtracted."""

from __future__ import annotations

import re
import subprocess
import sys
import warnings
from pathlib import Path

from scene_figure import typed
from vitruvian.formats.x3d import read_x3d, write_x3d
from vitruvian.hanim.build import scene_of
from vitruvian.hanim.humanoid import MotionData
from vitruvian.hanim.view import humanoids

# The schemas' own defects: no displacer under a joint, no name on HAnimMotion, which the standard both allows.
KNOWN = re.compile(r"Element 'HAnimDisplacer': This element is not expected|attribute 'name' is not allowed")
REAL = ["JoeKick", "JinNoAnimations_Fixed", "KoreanCharacterMotionAnnexD01Jin", "HAnim2SpecificationLOA3Illustrated"]


def test_written_files_are_valid(shared: Path, tmp_path: Path) -> None:
    files = []
    ada = typed(1)
    ada.motions = [MotionData("run", ["vl5"], [("Xrotation",)], ada.tracks[0].keys[:, None])]
    figures = {"ada": ada, "segments": typed(3, skin=False), "loa4": typed(4)}
    for name in REAL:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            (figures[name],) = humanoids(read_x3d(shared / "data" / "hanim" / f"{name}.x3d"))
    for name, h in figures.items():
        for version in ("2.0", "1.0"):
            scene, _ = scene_of([h], version=version)
            files.append(tmp_path / f"{name}_{version}.x3d")
            write_x3d(scene, files[-1])
    script = shared / "hanim" / "referee" / "xsd_validate.py"
    command = [sys.executable, str(script), str(shared / "hanim" / "xsd"), *map(str, files)]
    out = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False).stdout
    verdicts = re.findall(r"^(valid|INVALID) (\S+) (\S+)$", out, re.MULTILINE)
    assert [v[2] for v in verdicts] == [f.name for f in files]
    assert {v[1] for v in verdicts} == {"3.3", "4.0"}
    complaints = [line for line in out.splitlines() if line.startswith("   line")]
    assert [c for c in complaints if not KNOWN.search(c)] == []
    plain = [v[2] for v in verdicts if v[0] == "valid"]
    assert {"segments_2.0.x3d", "JinNoAnimations_Fixed_2.0.x3d", "KoreanCharacterMotionAnnexD01Jin_2.0.x3d"} <= set(
        plain
    )
