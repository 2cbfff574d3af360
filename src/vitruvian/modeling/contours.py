"""Any body as a contour body: limbs, torso and neck sliced into contours, the rest cut along them.

Contours lie in planes that turn from the bisector of one joint to that of the next, so that a bent knee has them evenly
spaced; their points are where rays from the bone meet the outermost surface. The torso is a front and a back.

Source: cross-section deformation of H-Anim bodies (pre-oriented contours, torso in two halves, ExtrContour).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vitruvian.body.pack import pack
from vitruvian.body.types import Body, Floats, Skin
from vitruvian.hanim import tables
from vitruvian.hanim.humanoid import ContourSurface, Displacer, Humanoid, Joint, Material, Segment, Shape
from vitruvian.modeling.cuts import Cuts, unit
from vitruvian.modeling.slicing import Rings, joined, rings

FRONT = np.array([0.0, 0.0, 1.0])
FIXED = 3  # contours of an arm that stand in the trunk and stay with it


@dataclass(frozen=True, eq=False)
class ContourBody:
    """A humanoid whose limbs, torso and neck are contour surfaces; `error` (mean, largest) m between its surface and
    that of the original, without what stands in the trunk."""

    humanoid: Humanoid
    error: tuple[float, float]


def contours(humanoid: Humanoid, *, density: float = 1.0, mitre: float = 0.5, diversion: float = 0.0) -> Humanoid:
    """The contour form of a humanoid: see `contoured`."""
    return contoured(humanoid, density=density, mitre=mitre, diversion=diversion).humanoid


def contoured(humanoid: Humanoid, *, density: float = 1.0, mitre: float = 0.5, diversion: float = 0.0) -> ContourBody:
    """A humanoid with hips, knees, ankles, shoulders, elbows, wrists, a spine joint and a skull as a contour body.

    `density` scales the number of contours and of points in each. `mitre` and `diversion`, 0..1, for all limbs.
    Raises VitruvianError naming the joints that are missing, and for a surface that the slices do not meet.
    """
    body = pack(humanoid)
    cuts = Cuts(body)
    made = _limbs(cuts, density, mitre, diversion) + _trunk(cuts, density)
    error = _error(body, [s for _, s in made])
    return ContourBody(_assembled(humanoid, body, made, cuts.pieces()), error)


@dataclass(frozen=True)
class Limb:
    """A limb between two joints, by names without side: how it is sliced at density 1.

    `regions`: left-side codes of what may be met (see `Cuts`; 0 is the trunk). `reach` (m) outwards. The first
    `fixed` contours stand in the trunk and stay with it. `next_spread`: the next joint's surface spreads its twist.
    """

    name: str
    near: str
    far: str
    regions: tuple[int, int]
    points: int
    contours: int
    reach: float
    fixed: int
    next_spread: bool
    roundness: float = 1.8


LIMBS = (
    Limb("upperarm", "shoulder", "elbow", (2, 0), 20, 18, 0.12, FIXED, True, 1.35),
    Limb("forearm", "elbow", "radiocarpal", (2, 4), 20, 16, 0.09, 0, False),
    Limb("thigh", "hip", "knee", (6, 0), 26, 20, 0.17, 0, True),
    Limb("calf", "knee", "talocrural", (6, 8), 26, 18, 0.12, 0, False),
)


Named = tuple[int, ContourSurface]  # the joint that a surface hangs on


def _limbs(cuts: Cuts, density: float, mitre: float, diversion: float) -> list[Named]:
    out = []
    for number, side in enumerate("lr"):
        for spec in LIMBS:
            joint, made, ramp = _limb(cuts, side, number, spec, density)
            surface = ContourSurface(
                f"{side}_{spec.name}_def", made.points, fixed_upper=spec.fixed, upper=ramp + (2 if spec.fixed else 0),
                lower=ramp, diversion=diversion, mitre=mitre, spread=True, colors=_colors(cuts.body.skin, made),
            )  # fmt: skip
            out.append((joint, surface))
    for (_, above), (_, below) in zip(out[::2], out[1::2], strict=True):  # a seam is one loop, of both surfaces
        below.points[0] = above.points[-1]
        if above.colors is not None and below.colors is not None:
            below.colors[0] = above.colors[-1]
    return out


def _limb(cuts: Cuts, side: str, number: int, spec: Limb, density: float) -> tuple[int, Rings, int]:
    """The joint, the loops, and how many contours each ramp takes."""
    near, far, fixed = f"{side}_{spec.near}", f"{side}_{spec.far}", spec.fixed
    points, count = max(6, round(spec.points * density)), max(8, round(spec.contours * density))
    start, end = cuts.at(near), cuts.at(far)
    axis, length = unit(end - start), float(np.linalg.norm(end - start))
    (_, first), (_, last) = cuts.planes[near], cuts.planes[far]
    step = length / (count - 1 - fixed)
    s = np.arange(-fixed, count - fixed) * step / length  # contours above the joint stay with the trunk
    s[:fixed] *= 0.6
    t = np.clip(s, 0, 1)[:, None]
    normal = (1 - t) ** 2 * first + 2 * t * (1 - t) * axis + t**2 * last
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    centers = start + s[:, None] * length * axis
    centers[:fixed] = start + s[:fixed, None] * length * first  # back along the first plane's own normal
    made = rings(
        cuts.body.skin.rest, cuts.body.skin.triangles,
        cuts.triangles(tuple(k + number if k else 0 for k in spec.regions)), centers, normal, points=points,
        reach=spec.reach, forward=FRONT, roundness=spec.roundness, name=f"{side}_{spec.name}",
    )  # fmt: skip
    middle = made.points[:fixed].mean(axis=1, keepdims=True)  # what stands in the trunk stays below its surface
    made.points[:fixed] += 0.04 * (middle - made.points[:fixed])
    radius = float(np.median(np.linalg.norm(made.points - made.points.mean(axis=1, keepdims=True), axis=2)))
    ramp = int(np.clip(round(radius / step), 2, (count - fixed) // 2 - 1))
    return cuts.index[near], made, ramp


def _trunk(cuts: Cuts, density: float) -> list[Named]:
    """The torso's front and back, and the neck."""
    skin = cuts.body.skin
    points, count = max(6, round(17 * density)), max(10, round(30 * density))
    heights = np.linspace(cuts.neck_height, cuts.bottom, count)
    inside = skin.rest[cuts.region == 0]
    middle = np.array([
        [0.0, y, np.median(band[:, 2]) if len(band := inside[np.abs(inside[:, 1] - y) < 0.03]) else 0.0]
        for y in heights
    ])  # fmt: skip
    middle[:, 2] = np.convolve(np.pad(middle[:, 2], 2, "edge"), np.ones(5) / 5, "valid")
    axis = np.tile([0.0, -1.0, 0.0], (count, 1))
    walls = [cuts.planes["l_shoulder"], cuts.planes["r_shoulder"]]
    around = np.arange(2 * (points - 1)) * np.pi / (points - 1) - np.pi / 2
    high = heights > (cuts.armpit("l")[1] + cuts.armpit("r")[1]) / 2  # there the torso ends where the arms begin
    loops = joined(*(
        rings(skin.rest, skin.triangles, cuts.triangles(kinds), middle[some], axis[some], points=points, reach=0.32,
              forward=FRONT, angles=around, walls=bounds, roundness=4, name="torso")
        for some, kinds, bounds in ((high, (0, 1, 2, 3), walls), (~high, (0,), None))
    ))  # fmt: skip
    colors = _colors(skin, loops)
    out = []
    front, back = np.arange(points), np.append(np.arange(points - 1, 2 * points - 2), 0)
    for name, which in (("front", front), ("back", back)):
        part = None if colors is None else colors[:, which]
        surface = ContourSurface(f"l5_{name}_def", loops.points[:, which], closed=False, colors=part)
        out.append((cuts.index["vl5"], surface))
    return [*out, _neck(cuts, loops, density)]


def _neck(cuts: Cuts, torso: Rings, density: float) -> Named:
    """From the skull's plane to the torso's first contour, whose points it shares."""
    points, count = torso.points.shape[1], max(6, round(10 * density))
    skull, normal = cuts.planes["skullbase"]
    low = torso.points[0].mean(axis=0)
    s = np.linspace(1, 0, count)[:, None]
    axis = (1 - s) * np.array([0.0, -1.0, 0.0]) + s * normal
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    around = np.arange(points) * 2 * np.pi / points - np.pi / 2
    made = rings(
        cuts.body.skin.rest, cuts.body.skin.triangles, cuts.triangles((0, 1)), (1 - s) * low + s * skull, axis,
        points=points, reach=0.14, forward=FRONT, angles=around, name="neck",
    )  # fmt: skip
    colors, trunk = _colors(cuts.body.skin, made), _colors(cuts.body.skin, torso)
    made.points[-1] = torso.points[0]
    if colors is not None and trunk is not None:
        colors[-1] = trunk[0]
    joint = cuts.neck[0] if cuts.neck else cuts.index["skullbase"]
    name = tables.canonical(cuts.body.skeleton.names[joint]) or "c7"
    segment = tables.joints()[name].segment if name in tables.joints() else "c7"
    return joint, ContourSurface(f"{segment}_def", made.points, colors=colors)


def _assembled(humanoid: Humanoid, body: Body, made: list[Named], pieces: Skin) -> Humanoid:
    """The humanoid with contour surfaces in its Segments, and the pieces as its skin."""
    copies = {id(j): replace(j, joints=[], segments=[replace(s, shapes=[], displacers=[], contours=[]) for s in j.segments],
                             displacers=[], skin_coord_index=np.zeros(0, np.int32), skin_coord_weight=np.zeros(0))
              for j in humanoid.joints()}  # fmt: skip
    order = list({id(j): j for j in humanoid.joints()}.values())
    for joint in order:
        copies[id(joint)].joints = [copies[id(j)] for j in joint.joints]
    joints = [copies[id(j)] for j in order]
    for number, surface in made:
        _segment(joints[number]).contours.append(surface)
    weights = pieces.weights
    for number, joint in enumerate(joints):
        mine = weights.joint == number
        joint.skin_coord_index = weights.vertex[mine]
        joint.skin_coord_weight = weights.weight[mine]
    for m in pieces.morphs:
        joints[m.joint].displacers.append(Displacer(m.name, m.index, m.offset, m.weight))
    looks = {s.name or s.material.name: s.material for s in _shapes(humanoid)}
    shapes = []
    for part in pieces.parts:
        look = looks.get(part.name) or Material(part.name, part.color, part.roughness, part.metallic, part.opacity,
                                                double_sided=part.double_sided)  # fmt: skip
        rows = slice(part.start, part.stop)
        uv = None if pieces.uv_triangles is None else pieces.uv_triangles[rows]
        shapes.append(Shape(part.name, pieces.triangles[rows], uv=pieces.uv, uv_triangles=uv, colors=pieces.colors,
                            material=look, crease_angle=part.crease))  # fmt: skip
    skin_look = _skin_look(humanoid)
    for _, surface in made:
        surface.material = skin_look
    return replace(
        humanoid, skeleton=[copies[id(j)] for j in humanoid.skeleton], skin=shapes, skin_coord=pieces.rest,
        skin_normal=None, node=None, scene=None,
    )  # fmt: skip


def _segment(joint: Joint) -> Segment:
    if not joint.segments:
        known = tables.canonical(joint.name)
        joint.segments.append(Segment(tables.joints()[known].segment if known else f"{joint.name}_segment"))
    return joint.segments[0]


def _shapes(humanoid: Humanoid) -> list[Shape]:
    return [*humanoid.skin, *(shape for s in humanoid.segments() for shape in s.shapes)]


def _skin_look(humanoid: Humanoid) -> Material:
    """What contour surfaces look like: white where points have colours, matt as cloth and skin are, seen from both
    sides."""
    shapes = _shapes(humanoid)
    color = shapes[0].material.color if shapes else (0.8, 0.8, 0.8)
    return Material("contours", color, roughness=0.65, double_sided=True)


def _colors(skin: Skin, made: Rings) -> Floats | None:
    """(C,P,3) of the loops' points, None where the skin has none."""
    if skin.colors is None:
        return None
    face = made.face
    known = np.where(face >= 0, face, -1)
    out = np.zeros((*face.shape, 3))
    some = face >= 0
    corner = skin.colors[skin.triangles[face[some]]]
    out[some] = np.einsum("nk,nkc->nc", made.barycentric[some], corner)
    for k in range(len(out)):  # where nothing was met: the neighbour in the loop
        good = np.flatnonzero(known[k] >= 0)
        if 0 < len(good) < face.shape[1]:
            for c in range(3):
                out[k, :, c] = np.interp(np.arange(face.shape[1]), good, out[k, good, c], period=face.shape[1])
    return out


def _error(body: Body, surfaces: list[ContourSurface]) -> tuple[float, float]:
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
