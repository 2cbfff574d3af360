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
from vitruvian.modeling.likeness import Likeness, improved, reshaped, shape_of, values_of
from vitruvian.modeling.shape import Shape
from vitruvian.modeling.template import Template, body_template, person_template
from vitruvian.motion.types import Motion

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "dm": 0.1, "ft": 0.3048}
LEAST, FEW = 8, 20
SAMPLES = 2500
ROUNDS = 15
STIFF = (300.0, 100.0, 30.0, 10.0, 3.0, 1.0, 0.4)  # of the surface, round by round
HELD = 1.0


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
    found = _by_surface(found, values, scan, where, goal, np.log(scale * factor))
    values = None if values is None else found.values
    clock("shape")
    points, _ = _shrunk(found, scan, where, goal)
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
    for kept in (
        [t == "root" for t in titles],
        [t in coarse or t[2:] in limbs for t in titles],
        [t in coarse or t[2:] in (*limbs, "elbow", "knee") for t in titles],
        [True] * len(titles),
    ):
        knobs = base.knobs.only(kept)
        bones = bo.settle(
            base.parents, base.centers, base.axes, bones, rows, knobs, usual=usual.ravel(), rounds=10, tolerance=1e-3
        )
    return Likeness(np.zeros(0), bones, base)


def _by_surface(
    found: Likeness, values: Floats | None, scan: shrink.Scan, where: Any, goal: Floats, size: float
) -> Likeness:
    """Sliders, where the template has some, and joint parameters by landmarks and the surface."""
    base = found.template
    usual = np.zeros((len(base.names), bo.EACH))
    usual[:, 6:] = size
    now, first = found, np.zeros(0)
    if values is not None:
        now, first = replace(found, values=values), values
        for _ in range(3):
            rows = bo.everywhere(where, now.template.points, base.weights, goal, np.ones(len(goal)))
            now = improved(now, rows, usual=first, firm=30.0)
    rng = np.random.default_rng(0)
    area = shrink.areas(base.points, base.triangles)
    heard = np.flatnonzero(base.heard)
    chance = area[heard] ** 0.6
    density = area[heard] / chance
    density /= np.average(density, weights=chance)
    chance /= chance.sum()
    for round_ in range(ROUNDS):
        late = round_ / (ROUNDS - 1)
        some = rng.choice(len(heard), min(SAMPLES, len(heard)), replace=False, p=chance)
        distance = max(0.10 * 0.82**round_, 0.010)
        trust = (0.1 + 0.9 * late) * density[some] ** (1 - late)
        rows = _rows(now, scan, heard[some], distance, np.radians(60 - 20 * late), trust)
        marks = bo.everywhere(where, now.template.points, base.weights, goal, np.full(len(goal), 1 - 0.7 * late))
        rows = rows.joined(marks)
        if values is None:
            t = now.template
            bones = bo.settle(t.parents, t.centers, t.axes, now.bones, rows, t.knobs, rounds=2, usual=usual.ravel())
            now = replace(now, bones=bones)
        else:
            now = improved(now, rows, usual=first, firm=30 * 0.2**late)
    return now


def _on_scan(now: Likeness) -> Floats:
    """(V,3) where joint parameters and sliders put the skin."""
    t = now.template
    frame = bo.posed(t.parents, t.centers, t.axes, now.bones)
    return bo.skinned(t.points, t.weights, frame.matrices(t.centers))[0]


def _rows(now: Likeness, scan: shrink.Scan, picked: Any, distance: float, angle: float, trust: Floats) -> Rows:
    """Point-to-plane rows of some vertices, and of some points of the scan against the template's surface."""
    t = now.template
    points = _on_scan(now)
    normals = shrink.vertex_normals(points, t.triangles)
    match = shrink.matches(points[picked], normals[picked], scan, distance=distance * t.reach[picked], angle=angle)
    good = np.flatnonzero(match.good)
    weight = trust[good] / (1 + (match.distance[good] / (0.5 * distance)) ** 2)
    return bo.wanted(t.chosen(picked[good]), t.points, t.weights, match.normal[good], match.goal[good], weight)


def _shrunk(found: Likeness, scan: shrink.Scan, where: Any, goal: Floats) -> tuple[Floats, int]:
    """(V,3) the surface drawn onto the scan by free offsets, and how many triangles are folded."""
    t = found.template
    start = points = _on_scan(found)
    smooth = shrink.laplacian(points, t.triangles)
    rng = np.random.default_rng(1)
    left = 0
    for round_ in range(len(STIFF)):
        alpha, distance = STIFF[round_], max(0.03 * 0.85**round_, 0.012)
        normals = shrink.vertex_normals(points, t.triangles)
        match = shrink.matches(points, normals, scan, distance=distance, angle=np.radians(55 - round_ * 1.5))
        pull = (match.good & t.heard) * 1.0
        along = ((match.goal - points) * match.normal).sum(axis=1)
        target = points - start + along[:, None] * match.normal
        stiff = alpha + t.stiff * np.maximum(100 - alpha, 0) * HELD
        # the other way: what points of the scan want of the template's surface
        some = rng.choice(len(scan.vertices), min(len(scan.vertices), 15_000), replace=False)
        back = shrink.matches(
            scan.vertices[some], scan.normals[some], shrink.surface(points, t.triangles), distance=distance, angle=0.8
        )
        good = back.good & t.heard[t.triangles[back.face]].all(axis=1)
        blend = shrink.blend(t.triangles[back.face[good]], back.share[good], len(points))
        ahead = ((scan.vertices[some][good] - back.goal[good]) * back.normal[good]).sum(axis=1)
        wish = shrink.Wish(blend, blend @ (points - start) + ahead[:, None] * back.normal[good], 0.5)
        u = shrink.offsets(
            smooth, pull, target, stiff, [wish, shrink.Wish(where, goal - where @ start, 10 / 3**round_)]
        )
        points, left = shrink.unfolded(points, start + u - points, t.triangles, smooth)
    return points, left


def _rested(state: _Posed, to_scan: Floats, name: str, loa: int, look: dict[str, Any]) -> tuple[Humanoid, Motion, Body]:
    """The humanoid at rest, its pose on the scan, and its packed form."""
    from vitruvian.modeling import rebinding

    return rebinding.rested_person(
        state.template, state.bones, state.values, state.points, to_scan, name=name, loa=loa, look=look
    )
