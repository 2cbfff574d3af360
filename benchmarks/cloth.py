"""A square metre of cloth falls on a ball: milliseconds a frame, and how far it stretches at rest.

Run: python benchmarks/cloth.py [--quick]. Cloth of 0.2 kg/m2, ball of 0.25 m radius, frames of 1/60 s in as many steps
as `substeps_for` says (20, and 26 for the finer one); note cloth.md, section 12.
"""

from __future__ import annotations

import time

import numpy as np
import trimesh
from _rows import main, row

from vitruvian.cloth.fabric import FABRICS, Fabric
from vitruvian.cloth.obstacle import Obstacle, still
from vitruvian.cloth.pattern import Edge, Panel, Pattern
from vitruvian.cloth.sheet import Sheet, strains
from vitruvian.cloth.solver import assemble, step, substeps_for
from vitruvian.cloth.tessellate import tessellate
from vitruvian.native import kernels

CASES = ((0.0215, "5k", 0.003), (0.0107, "20k", 0.014))  # mesh size, triangles, seconds a frame
STRAIN = 0.05


def square(size: float) -> tuple[Sheet, np.ndarray]:
    """A square metre at rest over the ball."""
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    mesh = tessellate(Pattern("sheet", (Panel("sheet", corners, tuple(Edge(i, (i + 1) % 4) for i in range(4))),)), size)
    cotton = FABRICS["cotton"]
    cloth = Fabric(**{**vars(cotton), "density": 0.2})
    sheet = Sheet(mesh.triangles, mesh.grain[mesh.triangles], np.zeros(len(mesh.triangles), np.int32), (cloth,))
    tilt = 1e-4 * np.random.default_rng(0).normal(size=sheet.count)
    return sheet, np.stack([mesh.material[:, 0] - 0.5, 0.27 + tilt, mesh.material[:, 1] - 0.5], axis=1)


def ball() -> Obstacle:
    """What it falls on."""
    made = trimesh.creation.icosphere(subdivisions=4, radius=0.25)
    return still(np.array(made.vertices), np.array(made.faces, np.int32))


def rows(quick: bool = False) -> list[dict[str, object]]:
    """The benchmark's rows."""
    if kernels() is None:
        return []
    obstacle = ball()
    out = []
    for size, name, goal in CASES[: 1 if quick else None]:
        sheet, start = square(size)
        cloth = assemble(sheet)
        state, times, substeps = cloth.state(start), [], substeps_for(cloth)
        for _ in range(60 if quick else 150):
            began = time.perf_counter()
            state = step(cloth, state, obstacle=obstacle, substeps=substeps)
            times.append(time.perf_counter() - began)
        frame = float(np.median(times))
        most = float(np.quantile(np.abs(strains(sheet, state.x)), 0.99))
        what = f"sheet on a ball, {name}: {len(sheet.triangles)} triangles"
        out.append(row(f"{what}, a frame", frame, f"{1000 * goal:g} ms", goal, frame / goal, "<= 1", frame <= goal))
        out.append(row(f"{what}, p99 strain", frame, "-", None, most, f"<= {STRAIN}", most <= STRAIN))
    return out


if __name__ == "__main__":
    main(__doc__, rows)
