"""Humanoid (tree) to Body (arrays).

The skin comes first, so that indices into `skinCoord` stay valid; geometry of Segments and Sites follows, each vertex
with weight 1 on its joint. Source: ISO/IEC 19774-1, Humanoid, Joint, Segment, Site, Displacer.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from vitruvian.body.contours import Contours, grid
from vitruvian.body.hands import stored_roundings
from vitruvian.body.kinematics import transform_matrix
from vitruvian.body.organise import equivalent, joined, organised
from vitruvian.body.rotations import from_axis_angle
from vitruvian.body.types import Body, Drive, Floats, Ints, Morph, Part, Skeleton, Skin, Weights, require
from vitruvian.errors import VitruvianError, warn
from vitruvian.hanim.defbody import halved, mapped
from vitruvian.hanim.drivers import driver_of
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Segment, Shape, Site
from vitruvian.hanim.welding import pieces, restored


def pack(humanoid: Humanoid) -> Body:
    """The arrays of a humanoid: skeleton, skin with the geometry of Segments, and the Humanoid's own transform.

    Joints are in depth-first order, each once. Weights are kept as the file gives them (sums need not be one).
    Fewer weights than indices reuse the last weight, as browsers do, with one warning.
    Raises VitruvianError, naming the joint, for indices outside `skinCoord`, negative or non-finite weights, and for a
    humanoid without joints.
    """
    joints = _joints(humanoid)
    if not joints:
        raise VitruvianError(f"humanoid {humanoid.name!r}: expected at least one Joint in skeleton, found none")
    skeleton = _skeleton(humanoid, joints)
    skin, contours = _skin(humanoid, joints, skeleton)
    return Body(humanoid.name, skeleton, skin, _placement(humanoid), contours, stored_roundings(humanoid))


def _joints(humanoid: Humanoid) -> list[Joint]:
    """Each joint once, even when a file hangs it in two places."""
    return list({id(j): j for j in humanoid.joints()}.values())


def _placement(humanoid: Humanoid) -> Floats:
    h = humanoid
    return transform_matrix(h.translation, h.rotation, h.scale, h.scale_orientation, h.center)


def _skeleton(humanoid: Humanoid, joints: list[Joint]) -> Skeleton:
    where = {id(j): i for i, j in enumerate(joints)}
    parents = np.full(len(joints), -1, np.int32)
    for i, joint in enumerate(joints):
        for child in joint.joints:
            if where[id(child)] > i:
                parents[where[id(child)]] = i
    limits = np.full((len(joints), 3, 2), np.nan)
    for i, joint in enumerate(joints):
        for side, angles in enumerate((joint.llimit, joint.ulimit)):
            given = np.asarray(angles, dtype=np.float64)[:3]
            limits[i, : len(given), side] = given
    sites = [(s, i) for i, j in enumerate(joints) for s in [*j.sites, *(t for g in j.segments for t in g.sites)]]
    sites = [(s, 0) for s in humanoid.sites] + sites
    return Skeleton(
        names=tuple(j.name for j in joints),
        parents=parents,
        centers=np.array([j.center for j in joints]),
        translation=np.array([j.translation for j in joints]),
        rotation=from_axis_angle(np.array([j.rotation for j in joints])),
        scale=np.array([j.scale for j in joints]),
        scale_orientation=from_axis_angle(np.array([j.scale_orientation for j in joints])),
        limits=limits,
        limit_orientation=from_axis_angle(np.array([j.limit_orientation for j in joints])),
        stiffness=np.array([j.stiffness for j in joints]),
        binding=_binding(humanoid, joints),
        site_names=tuple(s.name for s, _ in sites),
        site_joints=np.array([i for _, i in sites], dtype=np.int32),
        site_points=np.array([s.center + s.translation for s, _ in sites]).reshape(-1, 3),
    )


def _binding(humanoid: Humanoid, joints: list[Joint]) -> Floats | None:
    """jointBinding*: T R S per joint; a scale of zero, a default of the 4.0 schema, is read as one."""
    if not humanoid.binding:
        return None
    out = np.tile(np.eye(4), (len(joints), 1, 1))
    for i, joint in enumerate(joints):
        if joint.name in humanoid.binding:
            translation, rotation, scale = humanoid.binding[joint.name]
            scale = np.ones(3) if not np.any(scale) else scale
            out[i] = transform_matrix(translation, rotation, scale)
    return None if np.allclose(out, np.eye(4), rtol=0, atol=1e-12) else out


@dataclass
class _Surface:
    """What has been gathered so far; counts are kept so that later pieces know their offsets."""

    points: list[Floats] = field(default_factory=list)
    triangles: list[Ints] = field(default_factory=list)
    uv: list[Floats] = field(default_factory=list)
    uv_triangles: list[Ints | None] = field(default_factory=list)
    paint: list[tuple[Ints, Floats]] = field(default_factory=list)  # vertices and their colours
    painted: bool = False
    parts: list[Part] = field(default_factory=list)
    vertex_count: int = 0
    uv_count: int = 0
    face_count: int = 0

    def add_points(self, points: Floats) -> int:
        """Index of the first."""
        self.points.append(np.asarray(points, dtype=np.float64).reshape(-1, 3))
        self.vertex_count += len(self.points[-1])
        return self.vertex_count - len(self.points[-1])

    def add_shape(self, shape: Shape, first: int, name: str) -> None:
        """The faces of a shape whose point 0 is vertex `first`."""
        triangles = np.asarray(shape.triangles, dtype=np.int32).reshape(-1, 3)
        limit = self.vertex_count - first
        bad = np.flatnonzero((triangles < 0).any(axis=1) | (triangles >= limit).any(axis=1))
        require(not bad.size, f"triangles of {name}", f"point indices in 0..{limit - 1}", f"{triangles[bad[:1]]}")
        self.triangles.append(triangles + np.int32(first))
        if shape.uv is None:
            self.uv_triangles.append(None)
        else:
            corners = triangles if shape.uv_triangles is None else np.asarray(shape.uv_triangles, np.int32)
            self.uv_triangles.append(corners.reshape(-1, 3) + np.int32(self.uv_count))
            self.uv.append(np.asarray(shape.uv, dtype=np.float64))
            self.uv_count += len(shape.uv)
        m = shape.material
        used = np.unique(self.triangles[-1])
        if shape.colors is not None:
            self.painted = True
            self.paint.append((used, np.asarray(shape.colors, dtype=np.float64)[used - first]))
        else:
            self.paint.append((used, np.broadcast_to(np.array(m.color[:3], dtype=np.float64), (len(used), 3))))
        start = self.face_count
        self.face_count += len(triangles)
        color = (float(m.color[0]), float(m.color[1]), float(m.color[2]))
        look = (
            float(m.roughness),
            float(m.metallic),
            float(m.opacity),
            bool(m.double_sided),
            float(shape.crease_angle),
            m.picture if shape.uv is not None else None,
        )
        self.parts.append(Part(shape.name or m.name or name, start, self.face_count, color, *look))

    def skin(self, weights: Weights, morphs: list[Morph]) -> Skin:
        """Everything joined. Shapes without texture coordinates share one coordinate where others have them."""
        uv = uv_triangles = colors = None
        if self.uv:
            uv = np.concatenate([*self.uv, np.zeros((1, 2))])
            pairs = zip(self.triangles, self.uv_triangles, strict=True)
            filled = [np.full_like(t, self.uv_count) if u is None else u for t, u in pairs]
            uv_triangles = np.concatenate(filled)
        if self.painted:
            colors = np.full((self.vertex_count, 3), 0.8)
            for used, color in self.paint:
                colors[used] = color
        return Skin(
            rest=np.concatenate(self.points) if self.points else np.zeros((0, 3)),
            triangles=np.concatenate(self.triangles) if self.triangles else np.zeros((0, 3), np.int32),
            weights=weights,
            uv=uv,
            uv_triangles=uv_triangles,
            colors=colors,
            parts=tuple(self.parts),
            morphs=tuple(morphs),
        )


def _skin(humanoid: Humanoid, joints: list[Joint], skeleton: Skeleton) -> tuple[Skin, tuple[Contours, ...]]:
    surface = _Surface()
    morphs: list[Morph] = []
    vertex: list[Ints] = []
    owner: list[Ints] = []
    weight: list[Floats] = []

    deforming = [s for s in humanoid.skin if s.points is None]
    cut = list(pieces(humanoid, by_place=False))  # Segments cut out of the skin bend as the skin does
    deforming += [restored(s, len(humanoid.skin_coord)) for _, _, s in cut]
    count = len(humanoid.skin_coord) if deforming or any(len(j.skin_coord_index) for j in joints) else 0
    if count:
        surface.add_points(humanoid.skin_coord)
        for i, joint in enumerate(joints):
            index, value = _influence(joint, count)
            vertex.append(index)
            owner.append(np.full(len(index), i, np.int32))
            weight.append(value)
            morphs += [m for d in joint.displacers if (m := _morph(d, joint.name, count, i, skeleton)) is not None]
        own = (_morph(d, humanoid.name, count, 0, skeleton) for d in humanoid.skin_displacers)
        morphs += [replace(m, before=True) for m in own if m is not None]
        morphs += _cut_morphs(cut, {id(j): i for i, j in enumerate(joints)}, count, skeleton)
        for n, shape in enumerate(deforming):
            surface.add_shape(shape, 0, f"skin {n}")
    for n, shape in enumerate(s for s in humanoid.skin if s.points is not None):
        surface.add_shape(shape, surface.add_points(_placed(shape, np.eye(4))), f"skin shape {n}")  # does not move

    for i, joint in enumerate(joints):
        for holder, frame in _holders(joint):
            first = surface.vertex_count
            starts = _add_holder(surface, holder, frame)
            moved = np.arange(first, surface.vertex_count, dtype=np.int32)
            vertex.append(moved)
            owner.append(np.full(len(moved), i, np.int32))
            weight.append(np.ones(len(moved)))
            if isinstance(holder, Segment):
                morphs += [m for d in holder.displacers for m in _segment_morphs(d, holder, starts, i, skeleton)]

    contours = _contours(surface, joints, skeleton)
    if contours:
        points, contours = joined(np.concatenate(surface.points), contours)
        surface.points = [points]
    for packed in contours:
        parent = max(int(skeleton.parents[packed.joints[0]]), 0)
        owners, values = equivalent(packed, parent)
        each = packed.vertices.shape[1]
        vertex.append(np.repeat(packed.vertices.ravel(), len(owners)))
        owner.append(np.tile(owners, packed.vertices.size))
        weight.append(np.repeat(values, each, axis=0).ravel())

    join = lambda parts, kind: np.concatenate(parts) if parts else np.zeros(0, kind)  # noqa: E731
    weights = Weights.from_pairs(
        surface.vertex_count, join(vertex, np.int32), join(owner, np.int32), join(weight, np.float64)
    )
    return surface.skin(weights, morphs), contours


def _contours(surface: _Surface, joints: list[Joint], skeleton: Skeleton) -> tuple[Contours, ...]:
    """The contour surfaces of all Segments, their points and faces added to the skin."""
    found = []
    for i, joint in enumerate(joints):
        for c in (c for s in joint.segments for c in s.contours):
            points = np.asarray(c.points, dtype=np.float64)
            require(
                points.ndim == 3 and points.size > 0, f"contours {c.name}", "points (contours, points, 3)", points.shape
            )
            count, each = points.shape[:2]
            numbers = np.arange(count * each, dtype=np.int32).reshape(count, each)
            colors = None if c.colors is None else np.asarray(c.colors, np.float64).reshape(-1, 3)
            uv, corners = (None, None) if c.uv is None else mapped(c)
            first = surface.add_points(points.reshape(-1, 3))
            starts = [k for k, _ in c.bands]
            fits = not starts or (starts[0] == 0 and max(starts) < count - 1 and starts == sorted(set(starts)))
            require(fits, f"contours {c.name}: bands", f"rising contours from 0 to {count - 2}", starts)
            stops = [*starts[1:], count - 1]
            for (start, look), stop in zip(c.bands or ((0, c.material),), stops, strict=True):
                title = c.name if look.name in ("", c.name) else f"{c.name} {look.name}"
                own = None if corners is None else halved(corners[start:stop])
                shape = Shape(title, grid(numbers[start : stop + 1], c.closed), points.reshape(-1, 3), uv=uv,
                              uv_triangles=own, colors=colors, material=look)  # fmt: skip
                surface.add_shape(shape, first, c.name)
            found.append((i, c, numbers + np.int32(first)))
    return organised(found, skeleton)


def _influence(joint: Joint, count: int) -> tuple[Ints, Floats]:
    """skinCoordIndex and skinCoordWeight of a joint, checked."""
    index = np.asarray(joint.skin_coord_index, dtype=np.int64).reshape(-1)
    weight = np.asarray(joint.skin_coord_weight, dtype=np.float64).reshape(-1)
    where = f"joint {joint.name}"
    if len(weight) != len(index):
        what = f"{where}: {len(index)} skinCoordIndex but {len(weight)} skinCoordWeight"
        if len(weight) < len(index):
            warn(f"{what}; the last weight is used for the rest")
            last = weight[-1] if len(weight) else 1.0
            weight = np.concatenate([weight, np.full(len(index) - len(weight), last)])
        else:
            warn(f"{what}; the surplus is dropped")
            weight = weight[: len(index)]
    bad = np.flatnonzero((index < 0) | (index >= count))
    require(not bad.size, f"{where} skinCoordIndex", f"indices in 0..{count - 1}", index[bad[:1]])
    bad = np.flatnonzero(~(weight >= 0) | np.isinf(weight))
    require(not bad.size, f"{where} skinCoordWeight", "finite weights >= 0", f"{weight[bad[:1]]} at {bad[:1]}")
    return index.astype(np.int32), weight


def _morph(displacer: Displacer, where: str, count: int, joint: int, skeleton: Skeleton | None = None) -> Morph | None:
    """A displacer whose indices fit into `count` points; entries that do not fit are skipped, with a warning.

    None for one that only marks a region: nothing that deforms has a use for it.
    """
    if displacer.marks:
        return None
    index = np.asarray(displacer.coord_index, dtype=np.int64).reshape(-1)
    offset = np.asarray(displacer.displacements, dtype=np.float64).reshape(-1, 3)
    n = min(len(index), len(offset))
    good = (index[:n] >= 0) & (index[:n] < count)
    if len(index) != len(offset) or not good.all():
        what = f"{len(index)} indices, {len(offset)} displacements, {count} points"
        warn(f"Displacer {displacer.name} of {where}: {what}; entries that do not fit are skipped")
    kept, offset = index[:n][good].astype(np.int32), offset[:n][good]
    if not len(kept):
        return None
    drive = None if skeleton is None else _drive(displacer, where, skeleton)
    return Morph(displacer.name, kept, offset, joint, weight=float(displacer.weight), drive=drive)


def _drive(displacer: Displacer, where: str, skeleton: Skeleton) -> Drive | None:
    """The driver of a displacer; one that does not make sense is left out, with a warning."""
    try:
        driver = driver_of(displacer)
    except VitruvianError as error:
        warn(f"{error}; it is left out")
        return None
    if driver is None:
        return None
    if driver.joint not in skeleton.index:
        warn(f"Displacer {displacer.name} of {where}: its driver names no joint of this figure, {driver.joint!r}")
        return None
    return Drive(skeleton.index[driver.joint], driver.axis, driver.angles, driver.weights)


def _cut_morphs(
    cut: list[tuple[Joint, Segment, Shape]], place: dict[int, int], count: int, skeleton: Skeleton
) -> list[Morph]:
    """Displacers of Segments that were cut out of the skin, over skin points; a point on a cut moves once."""
    homes = {id(home): (joint, home, shape) for joint, home, shape in cut}
    taken: dict[str, Ints] = {}
    out = []
    for joint, home, shape in homes.values():
        index = shape.skin_index
        assert index is not None
        for d in home.displacers:
            part = _morph(d, home.name, len(index), place[id(joint)], skeleton)
            if part is None:
                continue
            rows = index[part.index]
            fresh = ~np.isin(rows, taken.get(d.name, rows[:0]))
            taken[d.name] = np.concatenate([taken.get(d.name, rows[:0]), rows])
            if fresh.any():
                out.append(replace(part, index=rows[fresh], offset=part.offset[fresh]))
    return out


def _holders(joint: Joint) -> Iterator[tuple[Segment | Site, Floats]]:
    """What carries rigid geometry under a joint, and where it stands in the joint's frame."""
    for segment in joint.segments:
        yield segment, np.eye(4)
        for site in segment.sites:
            yield site, _site_frame(site)
    for site in joint.sites:
        yield site, _site_frame(site)


def _site_frame(s: Site) -> Floats:
    return transform_matrix(s.translation, s.rotation, s.scale, s.scale_orientation, s.center)


def _placed(shape: Shape, frame: Floats) -> Floats:
    assert shape.points is not None
    whole = frame if shape.transform is None else frame @ shape.transform
    return np.asarray(shape.points, dtype=np.float64).reshape(-1, 3) @ whole[:3, :3].T + whole[:3, 3]


def _add_holder(surface: _Surface, holder: Segment | Site, frame: Floats) -> list[tuple[Shape, int]]:
    """Adds the shapes of a Segment or Site; shapes that share points and placement share vertices.

    Returns each piece of points once: its first shape and first vertex.
    """
    seen: dict[tuple[int, bytes], int] = {}
    starts = []
    for n, shape in enumerate(holder.shapes):
        if shape.points is None or shape.skin_index is not None:
            continue
        key = (id(shape.points), b"" if shape.transform is None else np.asarray(shape.transform).tobytes())
        if key not in seen:
            seen[key] = surface.add_points(_placed(shape, frame))
            starts.append((shape, seen[key]))
        surface.add_shape(shape, seen[key], holder.name or f"shape {n}")
    return starts


def _segment_morphs(
    displacer: Displacer, segment: Segment, starts: list[tuple[Shape, int]], joint: int, skeleton: Skeleton
) -> list[Morph]:
    """A Segment's displacer moves the points of Segment.coord (those of its first shape when not given) and of shapes
    with equal ones."""
    if not starts:
        return []
    model = starts[0][0].points if segment.coord is None else segment.coord
    assert model is not None
    morph = _morph(displacer, segment.name, len(model), joint, skeleton)
    if morph is None:
        return []
    out = []
    for shape, first in starts:
        if shape.points is not None and np.array_equal(shape.points, model):
            turn = np.eye(3) if shape.transform is None else np.asarray(shape.transform)[:3, :3]
            index, offset = morph.index + np.int32(first), morph.offset @ turn.T
            out.append(replace(morph, index=index, offset=offset, before=True))
    return out
