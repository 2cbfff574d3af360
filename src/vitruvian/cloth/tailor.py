"""The tailor: panels are hung around a body, sewn, and draped until they rest.

Source: note cloth.md, section 5; seed 003, sections 5.1 and 6.2.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Body, Floats, Ints
from vitruvian.cloth.fabric import Fabric
from vitruvian.cloth.fabric import fabric as fabric_named
from vitruvian.cloth.garment import Garment, buttoned, sewn
from vitruvian.cloth.intersections import intersections
from vitruvian.cloth.obstacle import Obstacle, still
from vitruvian.cloth.pattern import Pattern
from vitruvian.cloth.placing import ARMS, dummy, hung, waist
from vitruvian.cloth.sheet import Sheet, strains
from vitruvian.cloth.solver import FRAME, SUBSTEPS, Pairs, assemble, step
from vitruvian.cloth.tessellate import PanelMesh, tessellate, topology, welded
from vitruvian.cloth.untangling import untangle
from vitruvian.errors import VitruvianError

COARSE, FINE = 0.014, 2  # metres: finer cloth is sewn and draped at twice its size, then in so many times smaller steps
SEWING = 1.0  # seconds in which seams close
PULL = 1.5  # m/s with which a thread draws together what is still apart
SLOWLY = 0.1  # m/s with which a button that has come apart is drawn to again
CLOSING = 0.25  # of the gap between cloths that is kept while the last seams close
CLOSED = 1e-3  # metres between what is sewn when a seam counts as closed
HELD = 0.5  # of what a waist has slipped while it is sewn is put right each frame
TIGHT, LOOSE = 0.008, 0.05  # metres from the skin: what lies on it, and what hangs about it
LONGEST = 10.0  # seconds of draping
DAMPING, PATIENCE = 2.0, 3.0  # 1/s, and seconds after which it doubles with every second
STILL, CALM = 2e-3, 30  # m/s from frame to frame (root mean square of all vertices, mean of so many frames): at rest
Progress = Callable[[str, float], None]
Watch = Callable[[NDArray[np.floating], Ints], None]


def tailor(
    pattern: Pattern,
    body: Body,
    *,
    fabric: str | Fabric = "cotton",
    size: float = 0.010,
    arms: float = ARMS,
    gap: float | None = None,
    over: Sequence[Garment] = (),
    progress: Progress | None = None,
    watch: Watch | None = None,
) -> Garment:
    """A pattern sewn and draped on a body.

    The body stands with its arms `arms` radians below the horizontal; its shape is taken as it is. fabric: a preset's name
    or a Fabric, for panels that name none; size: metres between vertices; gap: metres between cloths that touch (None: the
    fabric's thickness, 1 mm at least); over: garments that the body wears below this one, in the same pose, innermost
    first: they give way to it, and lie as `below` of the result says; progress(what, share) is called now and then,
    watch(positions (n,3), triangles (m,3)) after every frame.

    The report tells: `faces`, `seam_gap_max_mm` when the seams were welded and `open_seams` that were still apart,
    `button_gap_max_mm` between what is buttoned,
    `penetrating_vertices`, `self_intersections`, `strain_p99` and `strain_max` of edges, `boundary_loops`, `settled`,
    `speed` (m/s), `layers`: how many vertices are tight, loose and floating, `seconds` of each part.

    Raises VitruvianError for patterns without places or that cannot be meshed, bodies without arms or skin, and garments
    below that were made for another pose or body.
    """
    clock = _Clock()
    mannequin = dummy(body, arms=arms)
    for k, garment in enumerate(over):
        if (
            garment.matrices.shape != mannequin.matrices.shape
            or np.abs(garment.matrices - mannequin.matrices).max() > 1e-6
        ):
            raise VitruvianError(f"over[{k}] {garment.name}: it is worn in another pose or by another body")
    cloths = tuple(_fabric(p.fabric, fabric) for p in pattern.panels)
    thick = max(1e-3, *(f.thickness for f in cloths)) if gap is None else gap
    mesh = tessellate(pattern, size if size > COARSE else 2 * size)
    clock("mesh")
    room = _Room(still(mannequin.vertices, mannequin.triangles), progress, watch)
    below = tuple(over)
    flat = hung(pattern, mesh, mannequin, lambda x: _distances(x, room.obstacle, below))
    clock("place")
    smooth = tuple(replace(f, friction_body=0.0, friction_self=0.0) for f in cloths)  # silk: it finds its place
    weld = welded(mesh)
    buttons = buttoned(pattern, mesh)
    positions, below, apart = _sewn(
        room, below, sewn(mesh, None, smooth), mesh, weld, flat, max(thick, 2e-3), waist(pattern, mesh), buttons
    )
    open_seams = sorted({int(s) for s in mesh.seam[apart > CLOSED]})
    clock("sew")
    sheet = sewn(mesh, weld, cloths)
    positions, below = _untangled(room, below, sheet, _merged(positions, weld))
    vertices, below, speed = _draped(room, below, sheet, positions, thick, SUBSTEPS, weld[buttons])
    clock("drape")
    if size <= COARSE:  # cloth comes to rest sooner in larger pieces
        fine = tessellate(pattern, size)
        positions = finer(mesh, vertices[weld], fine)
        mesh, weld, buttons = fine, welded(fine), buttoned(pattern, fine)
        sheet = sewn(mesh, weld, cloths)
        positions = _merged(positions, weld)
        vertices, below, speed = _draped(room, below, sheet, positions, thick, FINE * SUBSTEPS, weld[buttons])
        clock("refine")
    vertices, below = _untangled(room, below, sheet, vertices)
    clock("untangle")
    report = {
        "faces": len(sheet.triangles),
        "seam_gap_max_mm": 1000 * float(apart.max(initial=0)),
        "open_seams": open_seams,
        "button_gap_max_mm": 1000
        * float(np.linalg.norm(np.diff(vertices[weld[buttons]], axis=1), axis=2).max(initial=0)),
        "settled": speed < STILL,
        "speed": speed,
        **fitting(sheet, vertices, room.obstacle, below),
        "seconds": clock.parts,
    }
    below = tuple(
        replace(g, report={**g.report, **fitting(g.sheet, g.vertices, room.obstacle, below[:k])})
        for k, g in enumerate(below)
    )
    return Garment(pattern, mesh, weld, vertices, cloths, mannequin.matrices, report, below)


def fitting(sheet: Sheet, vertices: Floats, obstacle: Obstacle, below: Sequence[Garment] = ()) -> dict[str, Any]:
    """How a garment lies: strains of its edges, vertices inside the body, where it cuts itself or what is below, its
    boundary loops."""
    strain = strains(sheet, vertices)
    distance = obstacle.distances(vertices)
    whole, points = _with(sheet, vertices, below)
    cuts = intersections(points, whole.triangles, edges=whole.edges)
    own = (whole.edges[cuts[:, 0]] < len(vertices)).all(axis=1) | (cuts[:, 1] < len(sheet.triangles))
    return {
        "penetrating_vertices": int((distance < 0).sum()),
        "layers": {
            "tight": int((distance <= TIGHT).sum()),
            "loose": int(((distance > TIGHT) & (distance <= LOOSE)).sum()),
            "floating": int((distance > LOOSE).sum()),
        },
        "self_intersections": int(own.sum()),
        "strain_p99": float(np.quantile(np.abs(strain), 0.99)),
        "strain_max": float(np.abs(strain).max(initial=0)),
        "boundary_loops": topology(sheet.triangles)[2],
    }


@dataclass(frozen=True, eq=False)
class _Room:
    """Where a garment is made: the body, and who looks on."""

    obstacle: Obstacle
    progress: Progress | None
    watch: Watch | None


def _distances(points: Floats, obstacle: Obstacle, below: Sequence[Garment]) -> Floats:
    """(n,) metres of points (n,3) from the body, negative inside, or from what it wears."""
    out = obstacle.distances(points)
    for garment in below:
        out = np.minimum(out, still(garment.vertices, garment.triangles).nearest(points)[0])
    return out


def _with(sheet: Sheet, vertices: Floats, below: Sequence[Garment]) -> tuple[Sheet, Floats]:
    """A sheet and what lies below it as one."""
    for garment in below:
        other, count = garment.sheet, len(vertices)
        sheet = Sheet(
            np.concatenate([sheet.triangles, other.triangles + np.int32(count)]),
            np.concatenate([sheet.material, other.material]),
            np.concatenate([sheet.fabric, other.fabric + np.int32(len(sheet.fabrics))]),
            sheet.fabrics + other.fabrics,
        )
        vertices = np.concatenate([vertices, garment.vertices])
    return sheet, vertices


def _apart(points: NDArray[np.floating], count: int, below: Sequence[Garment]) -> tuple[Floats, tuple[Garment, ...]]:
    """The vertices of a garment, and the garments below it, out of those of all."""
    ends = count + np.cumsum([0, *(len(g.vertices) for g in below)])
    x: Floats = points.astype(np.float64)
    return x[:count], tuple(replace(g, vertices=x[a:b]) for g, a, b in zip(below, ends, ends[1:]))


def _untangled(
    room: _Room, below: tuple[Garment, ...], sheet: Sheet, vertices: Floats
) -> tuple[Floats, tuple[Garment, ...]]:
    """A sheet, and what is below it, where they do not cut each other or themselves."""
    whole, points = _with(sheet, vertices, below)
    return _apart(untangle(points, whole.triangles, obstacle=room.obstacle).positions, len(vertices), below)


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
    room: _Room,
    below: tuple[Garment, ...],
    sheet: Sheet,
    mesh: PanelMesh,
    weld: Ints,
    flat: Floats,
    gap: float,
    held: Ints,
    buttons: Ints,
) -> tuple[Floats, tuple[Garment, ...], Floats]:
    """The panels drawn together along their seams, and at their buttons (b,2), without gravity: (n,3) metres, what is below
    them, and how far apart each pair of a seam is left."""
    count = len(flat)
    whole, points = _with(sheet, flat, below)
    same = np.concatenate([weld, np.arange(count, len(points))])
    cloth = assemble(whole, gap=gap, same=same)
    both = np.concatenate([mesh.pairs, buttons])
    least = np.repeat([0, gap], [len(mesh.pairs), len(buttons)])  # what is buttoned lies one over the other
    a, b = both.T
    first = np.linalg.norm(flat[a] - flat[b], axis=1)
    state, frames, farthest = cloth.state(points), round(SEWING / FRAME), first.max(initial=0)
    apart = first
    for k in range(2 * frames):
        # what is far apart first, so that a skirt does not pull its bodice from the shoulders before they are closed
        low, high = (np.minimum(first, farthest * (1 - _smooth(min(1.0, (k + j) / frames)))) for j in (0, 1))
        # nor at once: threads that pull against each other would tear the cloth
        pairs = Pairs(
            both, np.maximum(np.maximum(low, apart), least), np.maximum(np.maximum(high, apart - PULL * FRAME), least)
        )
        # what pulls against a seam opens it by a step's square
        substeps = SUBSTEPS if k < frames else 3 * SUBSTEPS if k < 1.5 * frames else 8 * SUBSTEPS
        if k == round(1.5 * frames):
            cloth = replace(cloth, gap=CLOSING * cloth.gap)  # what lies beside a seam does not hold it open
        state = step(
            cloth, state, gravity=(0, 0, 0), damping=5.0, pairs=pairs, obstacle=room.obstacle, substeps=substeps
        )
        state.x[held, 1] += (HELD * (flat[held, 1] - state.x[held, 1])).astype(np.float32)
        apart = np.linalg.norm(state.x[a] - state.x[b], axis=1)
        if room.progress:
            room.progress("sewing", min(1.0, (k + 1) / frames))
        if room.watch:
            room.watch(state.x[:count], mesh.triangles)
        if k >= frames and (apart - least).max(initial=0) < CLOSED:
            break
    return *_apart(state.x, count, below), apart[: len(mesh.pairs)]


def _smooth(t: float) -> float:
    return t * t * (3 - 2 * t)


def finer(mesh: PanelMesh, positions: Floats, fine: PanelMesh) -> Floats:
    """(n,3) metres: where the vertices of another mesh of the same panels are, positions (m,3) of `mesh` given."""
    import igl

    out = np.empty((len(fine.material), 3))
    for k in np.unique(fine.panel):
        mine = fine.panel == k
        own = mesh.triangles[mesh.panel[mesh.triangles[:, 0]] == k]
        point, plane = (np.column_stack([m.material, np.zeros(len(m.material))]) for m in (fine, mesh))
        face = igl.point_mesh_squared_distance(np.ascontiguousarray(point[mine]), plane, own.astype(np.int64))[1]
        corner = own[np.asarray(face).reshape(-1)]
        a, b, c = (mesh.material[corner[:, j]] for j in range(3))
        u, v = np.linalg.solve(np.stack([b - a, c - a], axis=2), (fine.material[mine] - a)[..., None])[..., 0].T
        share = np.stack([1 - u - v, u, v], axis=1)
        out[mine] = np.einsum("nk,nkx->nx", share, positions[corner])
    return out


def _merged(positions: Floats, weld: Ints) -> Floats:
    count = np.bincount(weld)
    return np.stack([np.bincount(weld, positions[:, k]) / count for k in range(3)], axis=1)


def _draped(
    room: _Room,
    below: tuple[Garment, ...],
    sheet: Sheet,
    positions: Floats,
    gap: float,
    substeps: int,
    buttons: Ints,
) -> tuple[Floats, tuple[Garment, ...], float]:
    """The garment under gravity until it rests, closed at its buttons (b,2): (n,3) metres, what is below it, and how fast
    they still are, m/s in the mean of some frames."""
    count, frames, speeds = len(positions), round(LONGEST / FRAME), deque([np.inf] * CALM, CALM)
    whole, points = _with(sheet, positions, below)
    cloth = assemble(whole, gap=gap)
    state = cloth.state(points)
    apart = np.linalg.norm(points[buttons[:, 0]] - points[buttons[:, 1]], axis=1)
    for k in range(frames):
        gravity = (0.0, -9.81 * min(1.0, (k + 1) * FRAME / 0.25), 0.0)
        before = state.x
        damping = DAMPING * 2 ** max(
            0.0, (k + 1) * FRAME - PATIENCE
        )  # what trembles on is calmed; where it rests is the same
        state = step(
            cloth, state, gravity=gravity, damping=damping, obstacle=room.obstacle, substeps=substeps,
            pairs=Pairs(buttons, np.maximum(apart, gap), np.maximum(apart - SLOWLY * FRAME, gap)),
        )  # fmt: skip
        apart = np.linalg.norm(state.x[buttons[:, 0]] - state.x[buttons[:, 1]], axis=1)
        # how far it comes in a frame: what trembles within its steps does not move
        speeds.append(float(np.sqrt(np.mean(np.sum((state.x - before).astype(np.float64) ** 2, axis=1)))) / FRAME)
        if room.progress:
            room.progress("draping", (k + 1) / frames)
        if room.watch:
            room.watch(state.x[:count], sheet.triangles)
        if np.mean(speeds) < STILL:
            break
    return *_apart(state.x, count, below), float(np.mean(speeds))
