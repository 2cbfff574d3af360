"""A segment's surface put in contours: by reordering its points, by a field over it, or by resampling it.

"reorder" only rearranges points: the surface is peeled ring by ring from the loop nearest the parent joint. "field" is a
harmonic function, 0 at the near end and 1 at the far one, whose value is each point's real-valued contour number: the
shape is unchanged and ramps use it as weights. "resample" cuts the surface at level sets of the field.

Source: cross-section deformation of H-Anim bodies, section on organising existing surfaces.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np

from vitruvian.body.contours import distal_shares, own_shares
from vitruvian.body.types import Floats, Ints, require
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import ContourSurface, Humanoid, Joint, Segment, Shape
from vitruvian.hanim.tables import canonical
from vitruvian.modeling.loops import checked, directed_loops, welded
from vitruvian.modeling.slicing import Whole, cotangents
from vitruvian.motion.names import VERTEBRAE

MODES = ("auto", "reorder", "field", "resample")


@dataclass(frozen=True, eq=False)
class Organised:
    """A surface in contours. mode: "reorder", "field" or "resample".

    order (C,P): points of the surface, contour by contour ("reorder"). field (V,): 0 at the near end, 1 at the far one.
    points (C,P,3) and uv (C,P,2): the contours ("reorder", "resample"). error (m): mean and largest distance between the
    surface and its contours, 0 where the shape is unchanged. refused: why "auto" did not take the modes before.
    """

    mode: str
    order: Ints | None = None
    field: Floats | None = None
    points: Floats | None = None
    uv: Floats | None = None
    error: tuple[float, float] = (0.0, 0.0)
    refused: tuple[str, ...] = ()

    def shares(self, count: int, *, fixed: float = 0, upper: float = 0, lower: float = 0) -> Floats:
        """(V,2) of a "field": the share of its own joint's rotation and of the next one's that each point takes, as a
        surface of `count` contours with these parameters has them, between contours in proportion."""
        require(self.field is not None, "shares", "a surface organised by a field", self.mode)
        assert self.field is not None
        at = self.field * (count - 1)
        whole = np.arange(count)
        own = np.interp(at, whole, own_shares(count, fixed=int(fixed), upper=int(upper)))
        return np.stack([own, np.interp(at, whole, distal_shares(count, int(lower)))], axis=1)


def organise(
    points: Floats,
    triangles: Ints,
    near: Floats,
    far: Floats | None = None,
    *,
    mode: str = "auto",
    contours: int = 16,
    each: int = 20,
    uv: Floats | None = None,
    name: str = "surface",
) -> Organised:
    """Put a surface, points (V,3) and triangles (T,3), in contours from its parent joint `near` (3,) on towards `far`.

    mode "auto": reorder, where that fails field. `contours` and `each` (points in each) are what "resample" makes; `uv`
    (V,2) is carried along. Raises VitruvianError naming the edge, island, loop or level for surfaces that can't be
    organised: never a half-ordered one.
    """
    require(mode in MODES, "mode", " or ".join(map(repr, MODES)), repr(mode))
    rest = np.ascontiguousarray(points, np.float64).reshape(-1, 3)
    same, faces = welded(rest, np.asarray(triangles, np.int64).reshape(-1, 3))
    checked(rest, faces, name)
    refused: list[str] = []
    if mode in ("auto", "reorder"):
        try:
            order = _peeled(rest, faces, near, name)
            return Organised(
                "reorder", order.astype(np.int32), points=rest[order], uv=None if uv is None else uv[order]
            )
        except VitruvianError as error:
            if mode == "reorder":
                raise
            refused.append(str(error))
    field = harmonic(rest, faces, near, far, name)
    if mode != "resample":
        return Organised("field", field=field[same], refused=tuple(refused))
    made, own = _levels(rest, faces, field, contours, each, uv, name)
    return Organised("resample", field=field[same], points=made, uv=own, error=_apart(rest, faces, made))


def _peeled(rest: Floats, faces: Whole, near: Floats, name: str) -> Whole:
    """(C,P) the points of a tube, ring by ring from the loop nearest `near`."""
    loops = directed_loops(faces)
    if not loops:
        raise VitruvianError(f"{name}: reorder: expected a surface with an open end, found a closed one")
    first = min(loops, key=lambda line: float(np.linalg.norm(rest[line].mean(axis=0) - near)))
    each = len(first)
    neighbours: dict[int, set[int]] = {}
    for a, b, c in faces.tolist():
        for u, v in ((a, b), (b, c), (c, a)):
            neighbours.setdefault(u, set()).add(v)
            neighbours.setdefault(v, set()).add(u)
    rings_, ring = [list(first)], list(first)
    done = set(ring)
    while True:
        ahead = {v for u in ring for v in neighbours[u]} - done
        if not ahead:
            break
        number = len(rings_)
        if len(ahead) != each:
            raise VitruvianError(f"{name}: reorder: expected {each} points in ring {number}, found {len(ahead)}")
        ring = _beside(rest, ring, ahead, neighbours, name, number)
        rings_.append(ring)
        done |= ahead
    if len(rings_) < 2 or len(done) != len(np.unique(faces)):
        raise VitruvianError(f"{name}: reorder: expected rings that reach every point, found {len(done)} reached")
    order = np.array(rings_)
    centers = rest[order].mean(axis=1)
    axis = centers[min(1, len(order) - 1)] - centers[0]
    around = rest[order[0]] - centers[0]
    if np.cross(around, np.roll(around, -1, axis=0)).sum(axis=0) @ axis > 0:  # counter-clockwise seen from the top
        order = order[:, ::-1]
    return np.roll(order, -_start(rest[order[0]], axis), axis=1)


def _beside(
    rest: Floats, ring: list[int], ahead: set[int], neighbours: dict[int, set[int]], name: str, number: int
) -> list[int]:
    """The next ring in the order of this one: a cycle whose points are joined to those of the ring."""
    broken = VitruvianError(f"{name}: reorder: expected ring {number} to be one loop, found gaps or branches in it")
    beside = {v: sorted(neighbours[v] & ahead) for v in ahead}
    if any(len(b) != 2 for b in beside.values()):
        raise broken
    start = min(ahead)
    line, here = [start], beside[start][0]
    while here != start and len(line) <= len(ahead):
        a, b = beside[here]
        line, here = [*line, here], b if a == line[-1] else a
    if len(line) != len(ahead):
        raise broken
    best: tuple[float, list[int]] | None = None
    for way in (line, line[::-1]):
        for shift in range(len(way)):
            turned = way[shift:] + way[:shift]
            if all(b in neighbours[a] for a, b in zip(ring, turned, strict=True)):
                length = float(np.linalg.norm(rest[ring] - rest[turned], axis=1).sum())
                if best is None or length < best[0]:
                    best = (length, turned)
    if best is None:
        raise VitruvianError(
            f"{name}: reorder: expected every point of ring {number - 1} to be joined to ring {number}"
        )
    return best[1]


def _start(ring: Floats, axis: Floats) -> int:
    """The point furthest in the reference direction: forwards, or upwards where the bone points forwards."""
    size = float(np.linalg.norm(axis)) or 1.0
    reference = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.8 * size else np.array([1.0, 0.0, 0.0])
    return int(np.argmax(ring @ reference))


def harmonic(rest: Floats, faces: Whole, near: Floats, far: Floats | None, name: str) -> Floats:
    """(V,) the harmonic function with 0 on the end nearest `near` and 1 on the other.

    Ends are boundary loops; a closed end is a pole, the point furthest along. Cotangents below a trifle count as one, so
    that no value leaves 0..1. Raises VitruvianError for more than two open ends.
    """
    from scipy.sparse import csr_array, diags_array
    from scipy.sparse.linalg import spsolve

    loops = sorted(directed_loops(faces), key=lambda line: float(np.linalg.norm(rest[line].mean(axis=0) - near)))
    used = np.unique(faces)
    if len(loops) > 2:
        place = " ".join(f"{v:.3g}" for v in rest[loops[2]].mean(axis=0))
        raise VitruvianError(
            f"{name}: expected at most two open ends, found {len(loops)}; one of {len(loops[2])} points is at {place}"
        )
    way = (rest[used].mean(axis=0) if far is None else far) - near
    along = (rest[used] - near) @ way
    low = loops[0] if loops else [int(used[np.argmin(along)])]
    if len(loops) == 1 and far is not None:  # is the open end the near or the far one?
        middle = rest[loops[0]].mean(axis=0)
        if np.linalg.norm(middle - far) < np.linalg.norm(middle - near):
            low = [int(used[np.argmin(along)])]
            loops = [np.array(low), loops[0]]
    away = np.linalg.norm(rest[used] - rest[low].mean(axis=0), axis=1)
    high = loops[1] if len(loops) == 2 else [int(used[np.argmax(away)])]
    n = len(rest)
    w = cotangents(rest, faces, 1e-3, 1e3)
    laplacian = diags_array(np.asarray(w.sum(axis=1)).ravel()) - w
    out = np.zeros(n)
    out[np.asarray(high)] = 1.0
    free = np.setdiff1d(used, np.concatenate([np.asarray(low), np.asarray(high)]))
    if len(free):
        matrix = csr_array(laplacian)
        out[free] = spsolve(matrix[free][:, free].tocsc(), -(matrix[free] @ out))
    return np.clip(out, 0.0, 1.0)


def _levels(
    rest: Floats, faces: Whole, field: Floats, count: int, each: int, uv: Floats | None, name: str
) -> tuple[Floats, Floats | None]:
    """(C,P,3) level sets of a field, (C,P,2) their texture coordinates. Refuses levels of several loops."""
    require(count >= 2 and each >= 3, name, "2 contours of 3 points or more", (count, each))
    values = rest if uv is None else np.concatenate([rest, uv], axis=1)
    axis = rest[field > 0.9].mean(axis=0) - rest[field < 0.1].mean(axis=0)
    made = np.zeros((count, each, values.shape[1]))
    for k in range(count):
        level = np.clip(k / (count - 1), 1e-6, 1 - 1e-6)
        line = _isoline(values, faces, field, float(level), name)
        around = line[:, :3] - line[:, :3].mean(axis=0)
        if np.cross(around, np.roll(around, -1, axis=0)).sum(axis=0) @ axis > 0:
            line = line[::-1]
        line = np.roll(line, -_start(line[:, :3], axis), axis=0)
        closed = np.concatenate([line, line[:1]])
        length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(closed[:, :3], axis=0), axis=1))])
        place = np.arange(each) * length[-1] / each
        made[k] = np.stack([np.interp(place, length, closed[:, i]) for i in range(closed.shape[1])], axis=1)
    return made[..., :3], None if uv is None else made[..., 3:]


def _isoline(values: Floats, faces: Whole, field: Floats, level: float, name: str) -> Floats:
    """(n,k) the one loop where a field has a value."""
    above = field[faces] >= level
    cut = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
    t, s = faces[cut], above[cut]
    rows = np.arange(len(t))
    alone = np.argmax(s == (s.sum(axis=1) == 1)[:, None], axis=1)
    a, b, c = t[rows, alone], t[rows, (alone + 1) % 3], t[rows, (alone + 2) % 3]
    up = s[rows, alone]
    start = np.where(up[:, None], np.stack([a, b], 1), np.stack([a, c], 1))
    stop = np.where(up[:, None], np.stack([a, c], 1), np.stack([a, b], 1))
    key = lambda e: (e.min(axis=1) * len(values) + e.max(axis=1)).tolist()  # noqa: E731
    following = dict(zip(key(start), key(stop), strict=True))
    first = next(iter(following), None)
    line, here = [], first
    while here is not None and here in following:
        line.append(here)
        here = following.pop(here)
    if first is None or here != first or following:
        raise VitruvianError(f"{name}: resample: expected one closed loop at level {level:.3f}, found several or gaps")
    low, high = np.divmod(np.array(line), len(values))
    share = (level - field[low]) / np.where(field[high] == field[low], 1, field[high] - field[low])
    return np.asarray(values[low] + np.clip(share, 0, 1)[:, None] * (values[high] - values[low]))


def _apart(rest: Floats, faces: Whole, made: Floats) -> tuple[float, float]:
    """Mean and largest distance of the surface's points from its contours' faces and the other way."""
    import igl

    from vitruvian.body.contours import grid

    numbers = np.arange(made.shape[0] * made.shape[1], dtype=np.int32).reshape(made.shape[:2])
    flat, new = made.reshape(-1, 3), grid(numbers, True).astype(np.int64)
    there = igl.point_mesh_squared_distance(np.ascontiguousarray(rest[np.unique(faces)]), flat, new)[0]
    back = igl.point_mesh_squared_distance(np.ascontiguousarray(flat[new].mean(axis=1)), rest, faces)[0]
    far = np.sqrt(np.maximum(np.concatenate([there, back]), 0))
    return float(far.mean()), float(far.max())


@dataclass(frozen=True)
class SegmentReport:
    """What organising a segment's surface came to: `mode` of `Organised`, or "" with what is wrong in `message`."""

    segment: str
    joint: str
    points: int
    mode: str
    message: str
    error: tuple[float, float]

    def document(self) -> dict[str, object]:
        """As JSON knows it."""
        return asdict(self) | {"error": list(self.error)}


def segments(humanoid: Humanoid, *, mode: str = "auto") -> list[SegmentReport]:
    """Organise the surfaces of a humanoid's Segments, each connected surface by itself, and report them one by one.

    A surface's near end is its joint's centre, its far end the middle of the centres of the joints below.
    """
    return [report for _, _, _, report, _ in _each(humanoid, mode, False)]


def rearranged(humanoid: Humanoid, *, mode: str = "auto") -> tuple[Humanoid, list[SegmentReport]]:
    """A humanoid whose Segments have their surfaces in contours, and the reports of all of them.

    What comes out as contours ("reorder", "resample") becomes a contour surface without ramps, which moves as the Segment
    did until it is given some; on the spine they run from the neck down, and bend as a trunk does. All others, and those
    that a border of the texture runs across, stay as they are.
    """
    out, reports = humanoid.copied(), []
    for joint, segment, shape, report, found in _each(out, mode, True):
        reports.append(report)
        if found is None or found.points is None:
            continue
        points, looks = found.points, found.uv
        spine = canonical(joint.name) in VERTEBRAE
        if spine and points[0, :, 1].mean() < points[-1, :, 1].mean():
            points, looks = points[::-1, ::-1], None if looks is None else looks[::-1, ::-1]
        surface = ContourSurface(
            f"{segment.name}_def", points.copy(), extra=0 if spine else len(points), material=shape.material
        )
        if sum(c.name.startswith(surface.name) for c in segment.contours):
            surface.name += str(len(segment.contours) + 1)
        if looks is not None:
            surface.uv = None if shape.uv is None else looks[..., :2].copy()
            surface.colors = None if shape.colors is None else looks[..., -3:].copy()
        segment.contours.append(surface)
        segment.shapes = [s for s in segment.shapes if s is not shape]
    return out, reports


def _each(
    humanoid: Humanoid, mode: str, looks: bool
) -> Iterator[tuple[Joint, Segment, Shape, SegmentReport, Organised | None]]:
    """What organising each surface comes to, None where it can't be; `looks`: textures and colours have to come along."""
    for joint in {id(j): j for j in humanoid.joints()}.values():
        below = [j.center for j in joint.joints]
        far = np.mean(below, axis=0) if below else None
        for segment in joint.segments:
            shapes = list(segment.shapes)
            for n, shape in enumerate(shapes):
                if shape.points is None or not len(shape.triangles):
                    continue
                points = np.asarray(shape.points, np.float64)
                if shape.transform is not None:
                    points = points @ shape.transform[:3, :3].T + shape.transform[:3, 3]
                name = segment.name if len(shapes) == 1 else f"{segment.name} {shape.name or n}"
                found = None
                try:
                    found = organise(
                        points, shape.triangles, np.asarray(joint.center), far, mode=mode, name=name,
                        uv=_looks(shape, len(points), name) if looks else None,
                    )  # fmt: skip
                    row = (found.mode, "; ".join(found.refused), found.error)
                except VitruvianError as error:
                    row = ("", str(error), (0.0, 0.0))
                yield joint, segment, shape, SegmentReport(name, joint.name, len(points), *row), found


def _looks(shape: Shape, count: int, name: str) -> Floats | None:
    """(V,2..5) texture coordinates and colours of a shape's points, None where it has neither."""
    columns = []
    if shape.uv is not None:
        index = shape.triangles if shape.uv_triangles is None else shape.uv_triangles
        uv = np.zeros((count, 2))
        uv[shape.triangles] = np.asarray(shape.uv, np.float64)[index]
        other = np.flatnonzero((uv[shape.triangles] != shape.uv[index]).any(axis=(1, 2)))
        if len(other):
            raise VitruvianError(
                f"{name}: expected one pair of texture coordinates at each point, found others on triangle {other[0]}"
            )
        columns.append(uv)
    if shape.colors is not None:
        columns.append(np.asarray(shape.colors, np.float64)[:, :3])
    return np.concatenate(columns, axis=1) if columns else None
