"""Hostile files: one clear line with file and line number, exit 2, within 5 s and 1 GB, nothing written."""

from __future__ import annotations

import gzip
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

HUMANOID = (
    '<X3D version="4.0"><Scene><HAnimHumanoid name="h" DEF="h">\n'
    '<HAnimJoint name="humanoid_root" DEF="r" containerField="skeleton" {joint}/>\n'
    '<Coordinate DEF="c" containerField="skinCoord" point="{points}"/>\n'
    "</HAnimHumanoid></Scene></X3D>"
)
BVH = (
    "HIERARCHY\nROOT Hips\n{{\nOFFSET 0 0 0\nCHANNELS 3 Zrotation Yrotation Xrotation\n"
    "End Site\n{{\nOFFSET 0 1 0\n}}\n}}\nMOTION\n{motion}"
)
BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {chr(98 + i)} "{"&" + chr(97 + i) + ";"}{("&" + chr(97 + i) + ";") * 9}">' for i in range(9)
)

CASES: dict[str, tuple[str, bytes]] = {
    "empty": ("a.x3d", b""),
    "binary": ("a.x3d", bytes(range(256)) * 400),
    "truncated": ("a.x3d", b'<X3D version="4.0"><Scene><HAnimHumanoid name="h"><HAnimJoint name="humanoid_root'),
    "entity bomb": ("a.x3d", (BOMB + "]><X3D><Scene>&j;</Scene></X3D>").encode()),
    "external entity": (
        "a.x3d",
        b'<!DOCTYPE x [<!ENTITY f SYSTEM "file:///etc/passwd">]><X3D><Scene>&f;</Scene></X3D>',
    ),
    "deep": ("a.x3d", b"<X3D><Scene>" + b"<Transform>" * 200_000),
    "nan": ("a.x3d", HUMANOID.format(joint='center="0 nan 0"', points="0 0 0").encode()),
    "infinity": ("a.x3d", HUMANOID.format(joint="", points="0 1e999 0").encode()),
    "wrong count": ("a.x3d", HUMANOID.format(joint="", points="0 0 0 1").encode()),
    "huge index": (
        "a.x3d",
        HUMANOID.format(joint='skinCoordIndex="0 2000000000" skinCoordWeight="1 1"', points="0 0 0").encode(),
    ),
    "not a number": ("a.x3d", HUMANOID.format(joint='center="0 zero 0"', points="0 0 0").encode()),
    "vrml binary": ("a.wrl", bytes(range(256)) * 400),
    "vrml truncated": ("a.wrl", b"#VRML V2.0 utf8\nTransform { children [ Shape {"),
    "vrml deep": ("a.wrl", b"#VRML V2.0 utf8\n" + b"Group { children [ " * 200_000),
    "vrml self-referencing PROTO": (
        "a.wrl",
        b"#VRML V2.0 utf8\nPROTO Humanoid [ field MFNode skeleton [] ] { Humanoid { skeleton [] } }\n"
        b"Humanoid { skeleton [ Joint { center 0 0 } ] }",
    ),
    "vrml open string": ("a.wrl", b'#VRML V2.0 utf8\nWorldInfo { title "no end\n' + b"x" * 1_000_000),
    "vrml gzip bomb": ("a.wrz", gzip.compress(b" " * 300_000_000, 9)),
    "classic without header": ("a.x3dv", b"HAnimHumanoid { name 1 2 3"),
    "json empty": ("a.json", b""),
    "json binary": ("a.x3dj", bytes(range(1, 256)) * 400),
    "json truncated": ("a.json", b'{"X3D": {"@version": "4.0", "Scene": {"-children": [{"HAnimHumanoid": {"@na'),
    "json deep": ("a.json", b'{"X3D": ' + b"[" * 1_000_000),
    "json of another kind": ("a.json", b'{"pattern": {"panels": {}}}'),
    "json key twice": ("a.x3dj", b'{"X3D": {"Scene": {"-children": [{"HAnimHumanoid": {"@DEF": "a", "@DEF": "b"}}]}}}'),
    "json nan": (
        "a.json",
        b'{"X3D": {"Scene": {"-children": [{"HAnimHumanoid": {"@name": "h", "-skeleton": [{"HAnimJoint": {"@name": '
        b'"humanoid_root", "@center": [0, NaN, 0]}}]}}]}}}',
    ),
    "json gzip bomb": ("a.json.gz", gzip.compress(b" " * 300_000_000, 9)),
    "bvh empty": ("a.bvh", b""),
    "bvh binary": ("a.bvh", bytes(range(256)) * 400),
    "bvh few numbers": ("a.bvh", BVH.format(motion="Frames: 2\nFrame Time: 0.01\n1 2 3\n4 5\n").encode()),
    "bvh nan": ("a.bvh", BVH.format(motion="Frames: 1\nFrame Time: 0.01\n1 nan 3\n").encode()),
    "bvh frames lie": ("a.bvh", BVH.format(motion="Frames: 2000000000\nFrame Time: 0.01\n1 2 3\n").encode()),
    "bvh deep": ("a.bvh", b"HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n" + b"JOINT a\n{\nOFFSET 0 0 0\n" * 100_000),
    "obj huge index": ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 2000000000\n"),
    "obj nan": ("a.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    "obj binary": ("a.obj", bytes(range(256)) * 400),
    "obj empty": ("a.obj", b""),
}
# prints the peak memory in kB as the last line of stderr
RUNNER = """
import atexit, re, sys
peak = lambda: re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]
atexit.register(lambda: print(peak(), file=sys.stderr))
from vitruvian.cli import main
main()
"""


@pytest.mark.parametrize("case", CASES)
def test_refused_in_one_line(case: str, tmp_path: Path) -> None:
    name, content = CASES[case]
    (tmp_path / name).write_bytes(content)
    before = sorted(os.listdir(tmp_path))
    start = time.monotonic()
    command = [sys.executable, "-c", RUNNER, "convert", str(tmp_path / name), str(tmp_path / "out.glb")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30)
    seconds = time.monotonic() - start
    *lines, peak = done.stderr.splitlines()
    errors = [line for line in lines if line.startswith("error:")]
    assert done.returncode == 2 and len(errors) == 1 and "Traceback" not in done.stderr, done.stderr
    assert "internal" not in errors[0], errors[0]
    assert name in errors[0], errors[0]
    assert not done.stdout
    assert seconds < 5
    assert int(peak) < 1 << 20, "more than 1 GB"
    assert sorted(os.listdir(tmp_path)) == before
