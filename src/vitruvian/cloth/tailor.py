"""The tailor: panels are hung around a body, sewn, and draped until they rest.

Source: note cloth.md, section 5; seed 003, sections 5.1 and 6.2.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from vitruvian.body.types import Body, Floats, Ints
from vitruvian.cloth.fabric import Fabric
from vitruvian.cloth.fabric import fabric as fabric_named
from vitruvian.cloth.garment import Garment, sewn
from vitruvian.cloth.intersections import intersections
from vitruvian.cloth.obstacle import Obstacle, still
from vitruvian.cloth.pattern import Pattern
from vitruvian.cloth.placing import ARMS, dummy, hung, waist
from vitruvian.cloth.sheet import Sheet, strains
from vitruvian.cloth.solver import FRAME, SUBSTEPS, Cloth, Pairs, State, assemble, step
from vitruvian.cloth.tessellate import PanelMesh, tessellate, topology, welded
from vitruvian.cloth.untangling import untangle

SEWING = 1.0  # seconds in which seams close
PULL = 1.5  # m/s with which a thread draws together what is still apart
CLOSED = 1e-3  # metres between what is sewn when a seam counts as closed
HELD = 0.5  # of what a waist has slipped while it is sewn is put right each frame
TIGHT, LOOSE = 0.008, 0.05  # metres from the skin: what lies on it, and what hangs about it
LONGEST = 10.0  # seconds of draping
STILL, CALM = 2e-3, 30  # m/s (root mean square of all vertices, mean of so many frames): at rest
Progress = Callable[[str, float], None]
Watch = Callable[[Floats, Ints], None]


def tailor(
    pattern: Pattern,
    body: Body,
    *,
    fabric: str | Fabric = "cotton",
    size: float = 0.010,
    arms: float = ARMS,
    gap: float | None = None,
    progress: Progress | None = None,
    watch: Watch | None = None,
) -> Garment:
    """A pattern sewn and draped on a body.

    The body stands with its arms `arms` radians below the horizontal; its shape is taken as it is. fabric: a preset's name
    or a Fabric, for panels that name none; size: metres between vertices; gap: metres between cloths that touch (None: the
    fabric's thickness, 1 mm at least);
    progress(what, share) is called now and then, watch(positions (n,3), triangles (m,3)) after every frame.

    The report tells: `faces`, `seam_gap_max_mm` when the seams were welded and `open_seams` that were still apart,
    `penetrating_vertices`, `self_intersections`, `strain_p99` and `strain_max` of edges, `boundary_loops`, `settled`,
    `speed` (m/s), `layers`: how many vertices are tight, loose and floating, `seconds` of each part.

    Raises VitruvianError for patterns without places or that cannot be meshed, and bodies without arms or skin.
    """
    clock = _Clock()
    mannequin = dummy(body, arms=arms)
    mesh = tessellate(pattern, size)
    clock("mesh")
    cloths = tuple(_fabric(p.fabric, fabric) for p in pattern.panels)
    obstacle = still(mannequin.vertices, mannequin.triangles)
    flat = hung(pattern, mesh, mannequin, obstacle.distances)
    clock("place")
    thick = max(1e-3, *(f.thickness for f in cloths)) if gap is None else gap
    smooth = tuple(replace(f, friction_body=0.0) for f in cloths)  # sewn on silk, so that it finds its place
    weld = welded(mesh)
    sewing = assemble(sewn(mesh, None, smooth), gap=max(thick, 2e-3), same=weld)
    state, apart = _sewn(sewing, mesh, flat, obstacle, waist(pattern, mesh), progress, watch)
    clock("sew")
    positions = _merged(state.x.astype(np.float64), weld)
    cloth = assemble(sewn(mesh, weld, cloths), gap=thick)
    rest, settled = _draped(cloth, cloth.state(positions), obstacle, progress, watch)
    clock("drape")
    triangles = weld[mesh.triangles]
    vertices = untangle(rest.x, triangles, obstacle=obstacle).positions
    clock("untangle")
    report = {
        "faces": len(triangles),
        "seam_gap_max_mm": 1000 * float(apart.max(initial=0)),
        "open_seams": sorted({int(s) for s in mesh.seam[apart > CLOSED]}),
        "settled": settled,
        "speed": rest.speed,
        **fitting(cloth.sheet, vertices, obstacle),
        "seconds": clock.parts,
    }
    return Garment(pattern, mesh, weld, vertices, cloths, mannequin.matrices, report)


def fitting(sheet: Sheet, vertices: Floats, obstacle: Obstacle) -> dict[str, Any]:
    """How a garment lies: strains of its edges, vertices inside the body, where it cuts itself, its boundary loops."""
    strain = strains(sheet, vertices)
    distance = obstacle.distances(vertices)
    return {
        "penetrating_vertices": int((distance < 0).sum()),
        "layers": {
            "tight": int((distance <= TIGHT).sum()),
            "loose": int(((distance > TIGHT) & (distance <= LOOSE)).sum()),
            "floating": int((distance > LOOSE).sum()),
        },
        "self_intersections": len(intersections(vertices, sheet.triangles, edges=sheet.edges)),
        "strain_p99": float(np.quantile(np.abs(strain), 0.99)),
        "strain_max": float(np.abs(strain).max(initial=0)),
        "boundary_loops": topology(sheet.triangles)[2],
    }


class _Clock:
    """Seconds of one part after the other."""

    def __init__(self) -> None:
        self.parts: dict[str, float] = {}
        self.last = time.perf_counter()

    def __call__(self, name: str) -> None:
        now = time.perf_counter()
        self.parts[name], self.last = now - self.last, now


def _fabric(name: str, usual: str | Fabric) -> Fabric:
    if name:
        return fabric_named(name)
    return usual if isinstance(usual, Fabric) else fabric_named(usual)


def _sewn(
    cloth: Cloth,
    mesh: PanelMesh,
    flat: Floats,
    obstacle: Obstacle,
    held: Ints,
    progress: Progress | None,
    watch: Watch | None,
) -> tuple[State, Floats]:
    """The panels drawn together along their seams, without gravity, and how far apart each pair is left, metres."""
    a, b = mesh.pairs.T
    first = np.linalg.norm(flat[a] - flat[b], axis=1)
    state, frames, farthest = cloth.state(flat), round(SEWING / FRAME), first.max(initial=0)
    apart = first
    for k in range(2 * frames):
        # what is far apart first, so that a skirt does not pull its bodice from the shoulders before they are closed
        low, high = (np.minimum(first, farthest * (1 - _smooth(min(1.0, (k + j) / frames)))) for j in (0, 1))
        # nor at once: threads that pull against each other would tear the cloth
        pairs = Pairs(mesh.pairs, np.maximum(low, apart), np.maximum(high, apart - PULL * FRAME))
        # what pulls against a seam opens it by a step's square
        substeps = SUBSTEPS if k < frames else 3 * SUBSTEPS if k < 1.5 * frames else 8 * SUBSTEPS
        state = step(cloth, state, gravity=(0, 0, 0), damping=5.0, pairs=pairs, obstacle=obstacle, substeps=substeps)
        state.x[held, 1] += (HELD * (flat[held, 1] - state.x[held, 1])).astype(np.float32)
        apart = np.linalg.norm(state.x[a] - state.x[b], axis=1)
        if progress:
            progress("sewing", min(1.0, (k + 1) / frames))
        if watch:
            watch(state.x, mesh.triangles)
        if k >= frames and apart.max(initial=0) < CLOSED:
            break
    return state, apart


def _smooth(t: float) -> float:
    return t * t * (3 - 2 * t)


def _merged(positions: Floats, weld: Ints) -> Floats:
    count = np.bincount(weld)
    return np.stack([np.bincount(weld, positions[:, k]) / count for k in range(3)], axis=1)


def _draped(
    cloth: Cloth, state: State, obstacle: Obstacle, progress: Progress | None, watch: Watch | None
) -> tuple[State, bool]:
    """The garment under gravity until it rests."""
    frames, speeds = round(LONGEST / FRAME), deque([np.inf] * CALM, CALM)
    for k in range(frames):
        gravity = (0.0, -9.81 * min(1.0, (k + 1) * FRAME / 0.25), 0.0)
        state = step(cloth, state, gravity=gravity, damping=2.0, obstacle=obstacle)
        speeds.append(state.speed)
        if progress:
            progress("draping", (k + 1) / frames)
        if watch:
            watch(state.x, cloth.sheet.triangles)
        if np.mean(speeds) < STILL:
            return state, True
    return state, False
