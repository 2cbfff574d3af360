"""How good worn cloth is: beside a full simulation of the same garment, against the skin, and at the borders of its layers.

Source: seed 003, section 5.3; note cloth.md, sections 6, 7 and 12.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints
from vitruvian.cloth.layers import FLOATING, NAMES
from vitruvian.cloth.moving import Skin
from vitruvian.cloth.pinching import NOTHING
from vitruvian.cloth.sheet import strains
from vitruvian.cloth.solver import FRAME, substeps_for
from vitruvian.cloth.wear import Prepared, Wearer, entered
from vitruvian.cloth.worn import STEPS, Now, moved, simulated

DEEP = 0.001  # metres inside the skin that count
ABOVE = 0.0005  # metres over a foot, where it is seen whether that is under other skin
STILL = 0.002  # metres a frame: what moves less does not jump

FAR = 0.05  # metres from the skin beyond which nothing is inside


@dataclass(frozen=True, eq=False)
class Proof:
    """What was seen of a garment on a moving body: layered and full (F,n,3) metres, in layers and wholly simulated; layer
    (n,); seconds a frame of each. `far` (F,n) metres from each vertex to where the full simulation has it, and `off`
    (F,n) to its surface. inside (F,) and deepest (F,) of the layered cloth: vertices more than `DEEP` in the skin that it
    is about, where that is not folded into itself, and metres; crossed (F,): those in any skin, where arms pass through the
    body among them. strain (F,) the 99th percentile; jump: the largest step of a vertex beside another layer over the mean
    of its neighbours'."""

    layer: Ints
    layered: NDArray[np.float32]
    full: NDArray[np.float32]
    seconds: tuple[float, float]
    far: Floats
    off: Floats
    inside: Ints
    deepest: Floats
    crossed: Ints
    strain: Floats
    jump: float

    def summary(self) -> Mapping[str, object]:
        """Figures: millimetres, counts, shares, milliseconds."""
        counts = np.bincount(self.layer, minlength=len(NAMES))
        return {
            "frames": len(self.layered),
            "vertices": {name: int(n) for name, n in zip(NAMES, counts)},
            "from_full_mm": round(1000 * float(self.far.mean()), 2),
            "from_full_by_layer_mm": {
                name: round(1000 * float(self.far[:, self.layer == k].mean()), 2)
                for k, name in enumerate(NAMES) if counts[k]
            },
            "from_full_surface_mm": round(1000 * float(self.off.mean()), 2),
            "inside": int(self.inside.sum()),
            "frames_with_any_inside": int((self.inside > 0).sum()),
            "deepest_mm": round(1000 * float(self.deepest.max()), 2),
            "in_any_skin": int(self.crossed.sum()),
            "strain_p99": round(float(np.median(self.strain)), 4),
            "strain_p99_worst": round(float(self.strain.max()), 4),
            "jump": round(self.jump, 2),
            "layered_ms": round(1000 * self.seconds[0], 3),
            "full_ms": round(1000 * self.seconds[1], 3),
            "share": round(self.seconds[0] / self.seconds[1], 4),
        }  # fmt: skip


def proven(
    prepared: Prepared, person: Wearer, matrices: Floats, *, dt: float = FRAME, gap: float = 0.0,
    progress: Callable[[float], None] | None = None,
) -> Proof:  # fmt: skip
    """A garment on a body under joint matrices (F,J,4,4), a frame each `dt` seconds, in its layers and wholly simulated, in
    sixtieths of a second, then `gap` metres from itself (0: through itself); `progress` is told the share that is done."""
    worn = prepared.worn
    every = np.full(len(worn.layer), FLOATING, np.int32)
    home = person.skin.side[worn.corner[:, 0]] > 0
    whole = replace(
        worn, layer=every, limbs=None, rough=None, close=NOTHING, beneath=np.full_like(worn.beneath, -1),
        floating=simulated(worn.sheet, every, gap, home),
    )  # fmt: skip
    now = [entered(replace(prepared, worn=w), person, matrices[0]) for w in (worn, whole)]
    places: list[list[NDArray[np.float32]]] = [[now[0].x], [now[1].x]]
    took: list[list[float]] = [[], []]
    depth = [_depths(now[0].skin, now[0], home)]
    assert whole.floating is not None
    steps = (STEPS, substeps_for(whole.floating.cloth))  # as many as dress takes
    pieces = max(1, int(np.ceil(dt / FRAME - 1e-6)))
    for k in range(1, len(matrices)):
        skin, joints = person.at(matrices[k])
        for i, w in enumerate((worn, whole)):
            begun, first, where = time.perf_counter(), now[i].skin, now[i].joints
            for p in range(1, pieces + 1):
                part = p / pieces
                there = first.toward(skin, part)
                now[i] = moved(w, now[i], there, where + part * (joints - where), dt=dt / pieces, steps=steps[i])
            took[i].append((time.perf_counter() - begun) / pieces)
            places[i].append(now[i].x)
        depth.append(_depths(skin, now[0], home))
        if progress is not None:
            progress(k / (len(matrices) - 1))
    layered, full = (np.array(p) for p in places)
    own, any_ = (np.array([d[i] for d in depth]) for i in (0, 1))
    return Proof(
        worn.layer, layered, full, (float(np.median(took[0])), float(np.median(took[1]))),
        np.linalg.norm(layered.astype(np.float64) - full, axis=2), _off(layered, full, worn.sheet.triangles),
        (own > DEEP).sum(axis=1), own.max(axis=1, initial=0), (any_ > DEEP).sum(axis=1),
        np.array([np.quantile(np.abs(strains(worn.sheet, x)), 0.99) for x in layered]),
        jumps(worn.sheet.edges, worn.layer, layered),
    )  # fmt: skip


def _depths(skin: Skin, now: Now, home: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """(n,) metres that each vertex is inside the part of the skin that it is about, arms or the rest, and any."""
    import igl

    body, arms = skin.parts
    x = now.x
    points, own = x.astype(np.float64), np.zeros(len(x))
    for faces, some in ((body, ~home), (arms, home)):
        if some.any() and len(faces):
            own[some] = _inside(skin.points, skin.triangles[faces], points[some])
    feet = (now.foot + ABOVE * now.up).astype(np.float64)
    buried = np.asarray(igl.fast_winding_number(skin.points.astype(np.float64), skin.triangles.astype(np.int64), feet))
    return np.where(buried > 0.5, 0, own), _inside(skin.points, skin.triangles, points)


def _inside(vertices: NDArray[np.float32], triangles: Ints, points: Floats) -> Floats:
    """(n,) metres that points (n,3) are inside a surface, 0 outside."""
    import igl

    at, faces = vertices.astype(np.float64), triangles.astype(np.int64)
    out = np.zeros(len(points))
    some = np.flatnonzero(np.asarray(igl.fast_winding_number(at, faces, points)) > 0.5)
    if len(some):
        out[some] = np.sqrt(np.asarray(igl.point_mesh_squared_distance(points[some], at, faces)[0]).reshape(-1))
    return np.where(out < FAR, out, 0.0)


def _off(layered: NDArray[np.float32], full: NDArray[np.float32], triangles: Ints) -> Floats:
    """(F,n) metres from each vertex to the surface of the same garment elsewhere."""
    import igl

    faces = triangles.astype(np.int64)
    return np.array([
        np.sqrt(np.asarray(igl.point_mesh_squared_distance(a.astype(np.float64), b.astype(np.float64), faces)[0]))
        for a, b in zip(layered, full)
    ]).reshape(len(layered), -1)  # fmt: skip


def jumps(edges: Ints, layer: Ints, x: NDArray[np.float32]) -> float:
    """The largest step from frame to frame of x (F,n,3) that a vertex with a neighbour (edges (e,2)) in another layer (n,)
    makes, over the mean of its neighbours'. Steps under `STILL` do not count."""
    steps = np.linalg.norm(np.diff(x.astype(np.float64), axis=0), axis=2)
    a, b = np.concatenate([edges, edges[:, ::-1]]).T
    n = len(layer)
    degree = np.maximum(np.bincount(a, minlength=n), 1)
    border = np.unique(a[layer[a] != layer[b]])
    worst = 0.0
    for step in steps if len(border) else ():
        mean = np.bincount(a, step[b], n)[border] / degree[border]
        some = step[border] > STILL
        worst = max(worst, float((step[border] / np.maximum(mean, STILL))[some].max(initial=0)))
    return worst
