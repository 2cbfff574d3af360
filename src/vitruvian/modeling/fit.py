"""From a scan to an animatable humanoid: a template is brought to the scan's size, pose and shape.

Stages: similarity by landmarks; joint parameters by landmarks; sliders of the built-in person and joint parameters by the
surface; free offsets; back to the dress pose, where the skin's weights hold again.
Sources: seed 003, sections 3.1 and 3.2; H. Seo, N. Magnenat-Thalmann, "An Automatic Modeling of Human Bodies from Sizing
Parameters" (2003); note body.md, section 3.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vitruvian.body.types import Body, Floats
from vitruvian.errors import VitruvianError, warn
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.modeling import bones as bo
from vitruvian.modeling import shrink
from vitruvian.modeling.bones import Bones, Rows
from vitruvian.modeling.likeness import Likeness, improved, moves, reshaped, shape_of, values_of
from vitruvian.modeling.shape import Shape
from vitruvian.modeling.template import Template, body_template, person_template
from vitruvian.motion.types import Motion

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "dm": 0.1, "ft": 0.3048}
LEAST, FEW = 8, 20
SAMPLES = 3500
ROUNDS = 8


@dataclass(frozen=True, eq=False)
class Fit:
    """What a fit found. `humanoid`: at rest; `pose`: one frame on its skeleton that puts it, in metres, where the scan is;
    `bones`: joint parameters from the template's dress pose; `shape`: sliders of the built-in person, None for other
    templates; `displacement` (V,3): from the posed surface's points to the scan, metres in the scan's axes, NaN where
    nothing of the scan answers; `distance` (V,): its length. `report`: figures, see `fit`."""

    humanoid: Humanoid
    pose: Motion
    bones: Bones
    shape: Shape | None
    displacement: Floats
    report: dict[str, Any] = field(default_factory=dict)

    @property
    def distance(self) -> Floats:
        return np.linalg.norm(self.displacement, axis=1)


@dataclass(frozen=True, eq=False)
class _Posed:
    """A template on a scan: sliders None for templates without; `points` (V,3) as they lie on the scan, upright."""

    template: Template
    bones: Bones
    values: Floats | None
    points: Floats


def fit(
    mesh: Any,
    landmarks: Mapping[Any, ArrayLike] | None = None,
    *,
    template: Humanoid | None = None,
    unit: str | None = None,
    name: str = "person",
    loa: int = 4,
    progress: Callable[[int, int], None] | None = None,
    **look: Any,
) -> Fit:
    """An animatable humanoid with the size, pose and shape of a scan.

    mesh: anything with `vertices` (n,3) and `triangles` (t,3). landmarks: feature point of the standard, or (face,
    barycentric coordinates) of the template, -> place (3,), in the mesh's own unit and axes.
    """
    clock = _Clock(progress)
    vertices, triangles = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.triangles, np.int64)
    marks = _landmarks(landmarks)
    base, values = _template(template)
    names = list(marks)
    where = base.landmarks(names)
    goal = np.array([marks[n] for n in names])
    scale, turn, shift, mirrored = bo.similarity(where @ base.points, goal)
    if mirrored:
        raise VitruvianError("landmarks: they are mirrored; exchange the names that begin with l_ and r_")
    factor = UNITS[unit] if unit else _unit(scale)
    to_scan = np.eye(4)
    to_scan[:3, :3], to_scan[:3, 3] = turn, shift * factor
    upright = lambda p: (p * factor - to_scan[:3, 3]) @ turn  # noqa: E731
    scan = shrink.surface_of(upright(vertices), triangles)
    goal = upright(goal)
    clock("similarity")
    found = _by_landmarks(base, where, goal, np.log(scale * factor))
    clock("landmarks")
    if values is not None:
        found, values = _by_surface(found, values, scan, where, goal)
    clock("shape")
    points = _shrunk(found, scan, where, goal)
    clock("offsets")
    state = _Posed(found.template, found.bones, values, points)
    humanoid, pose, body = _rested(state, to_scan, name, loa, look)
    clock("rest")
    away, foot, _, _ = shrink.closest(points, scan)
    report = {"seconds": clock.stages, "fit_to_scan_mean_mm": float(away.mean() * 1000)}
    fitted = shrink.surface_of(points, found.template.triangles)
    back = shrink.closest(scan.vertices, fitted)[0] * 1000
    report |= {"mean_mm": float(back.mean()), "p95_mm": float(np.quantile(back, 0.95)), "max_mm": float(back.max())}
    return Fit(
        humanoid, pose, found.bones, None if values is None else shape_of(values), (foot - points) @ turn.T, report
    )


class _Clock:
    """Seconds per stage."""

    def __init__(self, progress: Callable[[int, int], None] | None):
        self.stages: dict[str, float] = {}
        self.last = time.perf_counter()
        self.progress = progress

    def __call__(self, stage: str) -> None:
        now = time.perf_counter()
        self.stages[stage] = now - self.last
        self.last = now
        if self.progress is not None:
            self.progress(len(self.stages), 6)


def _landmarks(landmarks: Mapping[Any, ArrayLike] | None) -> dict[Any, Floats]:
    assert landmarks is not None
    out = {}
    for name, place in landmarks.items():
        title = name.removesuffix("_pt") if isinstance(name, str) else name
        out[title] = np.asarray(place, np.float64)
    return out


def _template(humanoid: Humanoid | None) -> tuple[Template, Floats | None]:
    if humanoid is None:
        return person_template(Shape()), values_of(Shape())
    from vitruvian.body.pack import pack

    return body_template(pack(humanoid)), None


def _unit(scale: float) -> float:
    return min(UNITS.values(), key=lambda f: abs(np.log(scale * f)))


def _by_landmarks(base: Template, where: Any, goal: Floats, size: float) -> Likeness:
    """Joint parameters by landmarks alone, coarse to fine."""
    rows = bo.everywhere(where, base.points, base.weights, goal, np.ones(len(goal)))
    bones = Bones.none(len(base.names))
    usual = np.zeros((len(base.names), bo.EACH))
    usual[:, 6:] = size
    bones = replace(bones, scale=bones.scale + size)
    titles = [n.split()[1] for n in base.knobs.names]
    coarse = ("root", "pelvis", "vl", "vt", "vc", "skull")
    limbs = ("clavicle", "blade", "shoulder", "hip")
    last = [0, 0, 0]
    for stage, kept in enumerate(
        (
            [t == "root" for t in titles],
            [t in coarse or t[2:] in limbs for t in titles],
            [t in coarse or t[2:] in (*limbs, "elbow", "knee") for t in titles],
            [True] * len(titles),
        )
    ):
        del stage
        knobs = base.knobs.only(kept)
        bones = bo.settle(base.parents, base.centers, base.axes, bones, rows, knobs, usual=usual.ravel(), rounds=15)
    del last
    return Likeness(np.zeros(0), bones, base)


def _by_surface(
    found: Likeness, values: Floats, scan: shrink.Scan, where: Any, goal: Floats
) -> tuple[Likeness, Floats]:
    usual = values.copy()
    now = Likeness(values, found.bones, found.template)
    base = found.template
    for _ in range(3):
        rows = bo.everywhere(where, now.template.points, base.weights, goal, np.ones(len(goal)))
        now = improved(now, rows, usual=usual, firm=3.0)
    rng = np.random.default_rng(0)
    t = base.triangles
    a, b, c = (base.points[t[:, k]] for k in range(3))
    area = np.bincount(
        t.ravel(), np.repeat(np.linalg.norm(np.cross(b - a, c - a), axis=1), 3), minlength=len(base.points)
    )
    chance = area**0.6 * base.heard
    picked = rng.choice(len(base.points), min(SAMPLES, int(base.heard.sum())), replace=False, p=chance / chance.sum())
    chosen = base.chosen(picked)
    moved = None
    for round_ in range(ROUNDS):
        if round_ % 3 == 0:
            moved = moves(now.values)
        distance = max(0.10 * 0.7**round_, 0.012)
        rows = _rows(now, scan, chosen, picked, distance, np.radians(60 - 2.5 * round_), 0.15 + 0.12 * round_)
        marks = bo.everywhere(where, now.template.points, base.weights, goal, np.full(len(goal), 1 / (1 + round_)))
        now = improved(now, rows.joined(marks), usual=usual, firm=10.0, moved=moved)
    return now, now.values


def _rows(
    now: Likeness, scan: shrink.Scan, chosen: Any, picked: Any, distance: float, angle: float, trust: float
) -> Rows:
    """Point-to-plane rows of some vertices."""
    t = now.template
    frame = bo.posed(t.parents, t.centers, t.axes, now.bones)
    points, _ = bo.skinned(t.points, t.weights, frame.matrices(t.centers))
    normals = shrink.vertex_normals(points, t.triangles)
    match = shrink.matches(points[picked], normals[picked], scan, distance=distance, angle=angle)
    good = np.flatnonzero(match.good)
    weight = trust / (1 + (match.distance[good] / (0.5 * distance)) ** 2)
    return bo.wanted(chosen[good], t.points, t.weights, match.normal[good], match.goal[good], weight)


def _shrunk(found: Likeness, scan: shrink.Scan, where: Any, goal: Floats) -> Floats:
    """(V,3) the surface drawn onto the scan by free offsets."""
    t = found.template
    frame = bo.posed(t.parents, t.centers, t.axes, found.bones)
    points, _ = bo.skinned(t.points, t.weights, frame.matrices(t.centers))
    smooth = shrink.laplacian(points, t.triangles)
    start = points
    alpha, distance = 300.0, 0.03
    for round_ in range(8):
        normals = shrink.vertex_normals(points, t.triangles)
        match = shrink.matches(points, normals, scan, distance=distance, angle=np.radians(50 - round_ * 1.5))
        pull = (match.good & t.heard) * 1.0
        along = ((match.goal - points) * match.normal).sum(axis=1)
        target = points - start + along[:, None] * match.normal
        stiff = alpha * (1 + (1 - t.soft) * 30)
        u = shrink.offsets(start, smooth, pull, target, stiff)
        points, _ = shrink.unfolded(points, start + u - points, t.triangles, smooth)
        alpha, distance = max(alpha / 3, 0.3), max(distance * 0.8, 0.01)
    return points


def _rested(state: _Posed, to_scan: Floats, name: str, loa: int, look: dict[str, Any]) -> tuple[Humanoid, Motion, Body]:
    """The humanoid at rest, its pose on the scan, and its packed form."""
    from vitruvian.modeling import rebinding

    return rebinding.rested_person(
        state.template, state.bones, state.values, state.points, to_scan, name=name, loa=loa, look=look
    )
