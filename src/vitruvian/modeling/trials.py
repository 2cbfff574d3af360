"""Hard poses for a contour body, and what each does to it in numbers.

Source: the figures that the work on cross-section deformation asks for: seams shut in every pose, volume kept, no folds.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.pack import pack
from vitruvian.body.rotations import from_axis_angle, unit
from vitruvian.body.seams import face_normals
from vitruvian.body.types import Body, Floats, Part, Skeleton, Skin
from vitruvian.deform.deformer import deformer
from vitruvian.deform.quality import Gauge
from vitruvian.hanim.humanoid import ContourSurface, Humanoid
from vitruvian.modeling.cuts import ornament
from vitruvian.motion.names import joint_index

_ROUNDED = 1e-7  # metres: points that are close but not one at rest part by the rounding of single precision
_SHORT = 0.002  # of the figure's height: shorter edges are not asked how much they stretch


@dataclass(frozen=True)
class Trial:
    """A pose and its figures. gap (m): how far points that coincide at rest part at most, 0 when not by a bit. volume:
    of the surface that is posed over rest. folds: triangles turned over. stretch: the longest edge over rest, of edges
    longer than 1/500 of the figure."""

    pose: str
    gap: float
    volume: float
    folds: int
    stretch: float

    def document(self) -> dict[str, object]:
        """As JSON knows it."""
        return asdict(self)


def trials(humanoid: Humanoid, *, names: tuple[str, ...] | None = None) -> list[Trial]:
    """The contour body `humanoid` in the poses of `poses`, or those named. Raises VitruvianError without contours."""
    body = _bare(pack(humanoid))
    move = deformer("contours", body)
    gauge = Gauge(body)
    edges = gauge.edges[gauge.lengths > _SHORT * float(np.ptp(body.skin.rest, axis=0).max())]
    before = _lengths(body.skin.rest, edges)
    out = []
    for name, turns in poses(body.skeleton).items():
        if names is not None and name not in names:
            continue
        rotation = body.skeleton.rotation.copy()
        rotation[list(turns)] = from_axis_angle(np.array(list(turns.values())).reshape(-1, 4))
        matrices = joint_matrices(replace(body.skeleton, rotation=rotation))[0]
        points = move(matrices)
        found = gauge.measure(points, matrices).whole
        stretch = _lengths(points.astype(np.float64), edges) / before
        turned = _flipped(body, move.frames(matrices)[..., :3].astype(np.float64), points.astype(np.float64))
        gap = max(found.gap, seam_gap(body, points)) if found.gap > _ROUNDED else seam_gap(body, points)
        out.append(Trial(name, gap, found.volume, turned, float(stretch.max(initial=1.0))))
    return out


def seam_gap(body: Body, points: NDArray) -> float:
    """How far skin points (V,3) that are equal at rest to the bit part at most; 0: they are equal to the bit."""
    _, first, place = np.unique(body.skin.rest, axis=0, return_index=True, return_inverse=True)
    apart = points.astype(np.float64) - points[first[place.reshape(-1)]]
    return float(np.linalg.norm(apart, axis=1).max(initial=0.0))


def shape_error(body: Body, surfaces: list[ContourSurface]) -> tuple[float, float]:
    """Mean and largest distance (m) of the contours' faces from the original surface."""
    import igl

    centers = []
    for s in surfaces:
        p = s.points[max(s.fixed_upper, 0) :]
        right = np.roll(p, -1, axis=1) if s.closed else p[:, 1:]
        left = p if s.closed else p[:, :-1]
        centers.append(((left[:-1] + right[:-1] + left[1:] + right[1:]) / 4).reshape(-1, 3))
    samples = np.ascontiguousarray(np.concatenate(centers))
    squared = igl.point_mesh_squared_distance(samples, body.skin.rest, body.skin.triangles.astype(np.int64))[0]
    distance = np.sqrt(np.maximum(squared, 0))
    return float(distance.mean()), float(distance.max())


def poses(skeleton: Skeleton) -> dict[str, dict[int, list[float]]]:
    """{name: {joint: [x, y, z, angle]}}: arms lifted from where they hang by 90 and 150 degrees forwards and sideways,
    or to the T pose; elbow 135, knee 120, hip 90, wrist twisted 150, spine twisted 60, head nodded 40 and turned 60, neck
    bent sideways 40. Poses whose joints lack are left out."""
    index, centers = joint_index(skeleton.names), skeleton.centers
    out: dict[str, dict[int, list[float]]] = {}

    def bone(a: str, b: str) -> Floats:
        return unit(centers[index[b]] - centers[index[a]])

    def put(name: str, joint: str, axis: Floats, degrees: float) -> None:
        size = float(np.linalg.norm(axis))
        if size > 1e-6:
            out.setdefault(name, {})[index[joint]] = [*(axis / size).tolist(), float(np.radians(degrees))]

    for side, away in (("l", 1.0), ("r", -1.0)):
        arm, fore = [f"{side}_{n}" for n in ("shoulder", "elbow")], f"{side}_radiocarpal"
        leg = [f"{side}_{n}" for n in ("hip", "knee")]
        if {*arm, fore} <= set(index):
            upper = bone(*arm)
            for degrees in (90, 150):
                lifted = degrees - float(np.degrees(np.arccos(np.clip(-upper[1], -1, 1))))  # from hanging straight down
                put(f"arms forward {degrees}", arm[0], np.cross(upper, [0, 0, 1.0]), degrees)
                put(f"arms sideways {degrees}", arm[0], np.cross(upper, [away, 0, 0]), lifted)
            level = float(np.degrees(np.arccos(np.clip(upper[0] * away, -1, 1))))
            put("T pose", arm[0], np.cross(upper, [away, 0, 0]), level)
            put("elbows 135", arm[1], np.cross(bone(arm[1], fore), [0, 0, 1.0]), 135)
            put("wrists twisted 150", fore, bone(arm[1], fore) * away, 150)
        if {*leg, f"{side}_talocrural"} <= set(index):
            put("hips 90", leg[0], np.cross(bone(*leg), [0, 0, 1.0]), 90)
            put("hips 90", leg[1], np.cross(bone(leg[1], f"{side}_talocrural"), [0, 0, -1.0]), 90)
            put("knees 120", leg[1], np.cross(bone(leg[1], f"{side}_talocrural"), [0, 0, -1.0]), 120)
    spine = [index[n] for n in ("vt8", "vt6", "vt10", "vt1", "vl5") if n in index]
    if spine:
        out["spine twisted 60"] = {spine[0]: [0.0, 1.0, 0.0, float(np.radians(60))]}
    for name, joints, axis, degrees in (
        ("head nodded 40", ("skullbase",), [1.0, 0, 0], 40),
        ("head turned 60", ("skullbase",), [0, 1.0, 0], 60),
        ("neck bent 40", ("vc4", "vc7", "vc1"), [0, 0, 1.0], 40),
    ):
        some = [index[j] for j in joints if j in index]
        if some:
            out[name] = {some[0]: [*axis, float(np.radians(degrees))]}
    return out


def _bare(body: Body) -> Body:
    """The body without hair, lashes, eyes and teeth, which are no part of its surface."""
    skin = body.skin
    keep = [p for p in skin.parts if not ornament(p)]
    rows = [np.arange(p.start, p.stop) for p in keep]
    chosen = np.concatenate(rows) if rows else np.zeros(0, np.int64)
    parts: list[Part] = []
    for p in keep:
        start = parts[-1].stop if parts else 0
        parts.append(replace(p, start=start, stop=start + p.stop - p.start))
    corners = None if skin.uv_triangles is None else skin.uv_triangles[chosen]
    return replace(
        body,
        skin=Skin(
            skin.rest, skin.triangles[chosen], skin.weights, skin.uv, corners, skin.colors, tuple(parts), skin.morphs
        ),
    )


def _flipped(body: Body, frames: Floats, points: Floats) -> int:
    """How many triangles face away from where their own points' frames (V,3,3) turn them."""
    t = body.skin.triangles
    mean = frames[t].sum(axis=1)
    before = np.einsum("tab,tb->ta", mean, face_normals(body.skin.rest, t))
    return int(((before * face_normals(points, t)).sum(axis=1) < 0).sum())


def _lengths(points: Floats, edges: np.ndarray) -> Floats:
    return np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
