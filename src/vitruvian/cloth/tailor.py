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
from vitruvian.cloth.placing import ARMS, dummy, hung
from vitruvian.cloth.sheet import Sheet, strains
from vitruvian.cloth.solver import FRAME, SUBSTEPS, Cloth, Pairs, State, assemble, step
from vitruvian.cloth.tessellate import PanelMesh, tessellate, topology, welded
from vitruvian.cloth.untangling import untangle

SEWING = 1.0  # seconds in which seams close
CLOSED = 1e-3  # metres between what is sewn when a seam counts as closed
WAIST, SHOULDERS = "lower_interface", ("collar", "armhole", "strapless_top")  # labels of edges
HELD = 0.2  # of what a waist has slipped while it is sewn is put right each frame
TIGHT, LOOSE = 0.008, 0.05  # metres from the skin: what lies on it, and what hangs about it
LONGEST = 10.0  # seconds of draping
STILL, CALM = 2e-3, 30  # m/s (root mean square of all vertices, mean of so many frames): at rest
LOOK = 0.15  # seconds between two looks at cloth that moves
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
    progress(what, share) is called now and then; watch(positions (n,3), triangles (m,3)) a few times a second, with how
    the cloth moves. What they raise ends the work.

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
    flat = hung(pattern, mesh.material, mesh.panel, obstacle.distances)
    clock("place")
    thick = max(1e-3, *(f.thickness for f in cloths)) if gap is None else gap
    smooth = tuple(replace(f, friction_body=0.0) for f in cloths)  # sewn on silk, so that it finds its place
    weld = welded(mesh)
    sewing = assemble(sewn(mesh, None, smooth))
    state, apart = _sewn(sewing, mesh, flat, obstacle, _waist(pattern, mesh), progress, watch)
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


class _Looks:
    """Shows cloth that moves to who watches, a few times a second."""

    def __init__(self, watch: Watch | None, cloth: Cloth) -> None:
        self.watch, self.triangles, self.last = watch, cloth.sheet.triangles, 0.0

    def __call__(self, state: State) -> None:
        if self.watch and time.perf_counter() - self.last > LOOK:
            self.watch(state.x.astype(np.float64), self.triangles)
            self.last = time.perf_counter()


def _fabric(name: str, usual: str | Fabric) -> Fabric:
    if name:
        return fabric_named(name)
    return usual if isinstance(usual, Fabric) else fabric_named(usual)


def _waist(pattern: Pattern, mesh: PanelMesh) -> Ints:
    """Vertices of the edges that a garment without shoulders hangs by: they stay as high as the pattern puts them."""
    labels = {e.label for p in pattern.panels for e in p.edges}
    if any(label.endswith(SHOULDERS) for label in labels):
        return np.zeros(0, np.int32)
    named = [(k, i) for k, p in enumerate(pattern.panels) for i, e in enumerate(p.edges) if e.label == WAIST]
    return np.unique(np.concatenate([np.zeros(0, np.int32), *(mesh.edges[key] for key in named)]))


def _sewn(
    cloth: Cloth,
    mesh: PanelMesh,
    flat: Floats,
    obstacle: Obstacle,
    waist: Ints,
    progress: Progress | None,
    watch: Watch | None = None,
) -> tuple[State, Floats]:
    """The panels drawn together along their seams, without gravity, and how far apart each pair is left, metres."""
    a, b = mesh.pairs.T
    first = np.linalg.norm(flat[a] - flat[b], axis=1)
    state, frames = cloth.state(flat), round(SEWING / FRAME)
    apart, look = first, _Looks(watch, cloth)
    for k in range(2 * frames):
        low, high = (first * (1 - _smooth(min(1.0, (k + j) / frames))) for j in (0, 1))
        pairs = Pairs(mesh.pairs, low, high)
        substeps = SUBSTEPS if k < frames else 3 * SUBSTEPS  # what pulls against a seam opens it by a step's square
        state = step(cloth, state, gravity=(0, 0, 0), damping=5.0, pairs=pairs, obstacle=obstacle, substeps=substeps)
        state.x[waist, 1] += (HELD * (flat[waist, 1] - state.x[waist, 1])).astype(np.float32)
        apart = np.linalg.norm(state.x[a] - state.x[b], axis=1)
        if progress:
            progress("sewing", min(1.0, (k + 1) / frames))
        look(state)
        if k >= frames and apart.max(initial=0) < CLOSED:
            break
    return state, apart


def _smooth(t: float) -> float:
    return t * t * (3 - 2 * t)


def _merged(positions: Floats, weld: Ints) -> Floats:
    count = np.bincount(weld)
    return np.stack([np.bincount(weld, positions[:, k]) / count for k in range(3)], axis=1)


def _draped(
    cloth: Cloth, state: State, obstacle: Obstacle, progress: Progress | None, watch: Watch | None = None
) -> tuple[State, bool]:
    """The garment under gravity until it rests."""
    frames, speeds = round(LONGEST / FRAME), deque([np.inf] * CALM, CALM)
    look = _Looks(watch, cloth)
    for k in range(frames):
        gravity = (0.0, -9.81 * min(1.0, (k + 1) * FRAME / 0.25), 0.0)
        state = step(cloth, state, gravity=gravity, damping=2.0, obstacle=obstacle)
        speeds.append(state.speed)
        if progress:
            progress("draping", (k + 1) / frames)
        look(state)
        if np.mean(speeds) < STILL:
            return state, True
    return state, False
