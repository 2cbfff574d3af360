"""How good a deformed surface is, in numbers that compare deformers: volume, sections, bulge, folds, seams, stretch.

A `Gauge` lays closed sections round the joints of a body at rest, once, and follows the same material points through any
pose of any deformer. All numbers are ratios to rest, so they have no unit, except the seam gap (metres) and the folds
(a count).

Sections lie between the middles of the bones that meet at the joint, in planes that turn from one bone to the other.
Where a plane cuts several loops, the section is the largest closed one round the bone; a plane without one (armpit,
crotch) is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.seams import face_normals
from vitruvian.body.types import Body, Floats, Ints, Skeleton, require
from vitruvian.deform.bind import bind
from vitruvian.deform.operators import Rigid
from vitruvian.errors import VitruvianError

STATIONS = 41  # planes round a joint; odd, so that one goes through the joint
DIAMETERS = 16  # directions in which each section's thickness is taken
SAME = 1e-6  # points closer than this at rest (metres) are one point of the surface
TURNED = np.radians(1)  # joints that turn less are not looked at


@dataclass(frozen=True)
class Quality:
    """A surface against its rest form. NaN where nothing could be measured.

    volume: enclosed volume over rest; signed tetrahedra, with the mean point of each boundary loop as its lid's middle.
    area: least over the sections of the length of the vector area, over rest.
    thickness: least over sections and directions of the distance of two points that lie opposite, over rest.
    bulge: one plus the furthest that a section's point moves away from the bent bone line, in mean radii of the section
    at rest. For a round section about its bone that is the largest distance from the line over rest; for others, a side
    that lies near the bone (the elbow's) counts as much as the others.
    folds: triangles turned by more than 90 degrees against their rest normal, which turns with the mean rotation of
    their joints ("log").
    gap: how far, metres, points that coincide at rest come apart at most.
    stretch: largest length of an edge over rest.
    """

    volume: float
    area: float
    thickness: float
    bulge: float
    folds: int
    gap: float
    stretch: float

    def document(self) -> dict[str, float | int | None]:
        """As JSON knows it: None for NaN."""
        return {k: None if v != v else v for k, v in asdict(self).items()}


@dataclass(frozen=True)
class Report:
    """`whole`: the whole surface, with the worst section of all joints. `joints`: the surface round each joint."""

    whole: Quality
    joints: dict[str, Quality]

    def document(self) -> dict[str, object]:
        """As JSON knows it."""
        return {"whole": self.whole.document(), "joints": {k: q.document() for k, q in self.joints.items()}}


def quality(body: Body, points: NDArray, matrices: Floats, *, joints: Sequence[str] | None = None) -> Report:
    """Measures the skin points (V,3) of one pose, whose joint matrices are (J,4,4), against the body at rest.

    `joints`: those round which to lay sections; by default those that this pose turns by more than a degree against
    their parent. Points are in humanoid space, as a deformer gives them.
    Raises VitruvianError for shapes that do not fit and for joints that the body does not have.
    """
    chosen = turned(body.skeleton, matrices) if joints is None else joints
    return Gauge(body, tuple(chosen)).measure(points, matrices)


def turned(skeleton: Skeleton, matrices: Floats) -> tuple[str, ...]:
    """The joints with a parent that turn by more than a degree against it, most first, for matrices (J,4,4)."""
    m = _matrices(skeleton, matrices)[:, :3, :3]
    child = np.flatnonzero(skeleton.parents >= 0)
    between = np.einsum("jab,jab->j", m[child], m[skeleton.parents[child]])
    angle = np.arccos(np.clip((between - 1) / 2, -1, 1))
    order = np.argsort(-angle, kind="stable")
    return tuple(skeleton.names[child[i]] for i in order if angle[i] > TURNED)


def _matrices(skeleton: Skeleton, matrices: Floats) -> Floats:
    m = np.asarray(matrices, dtype=np.float64)
    require(m.shape == (len(skeleton), 4, 4), "matrices", f"shape ({len(skeleton)}, 4, 4)", m.shape)
    return m


@dataclass(frozen=True, eq=False)
class Sections:
    """Closed sections of one joint, as material points: (1 - share) of vertex `first` and share of vertex `second`.

    first, second, share, section: (N,) per point. start, stop, owner: (S,) segments between points, along the surface's
    orientation. near, far, pair: (D,) opposite points. count: number of sections.
    """

    first: Ints
    second: Ints
    share: Floats
    section: Ints
    start: Ints
    stop: Ints
    owner: Ints
    near: Ints
    far: Ints
    pair: Ints
    count: int

    def at(self, points: Floats) -> Floats:
        """(N,3) where the section's points are."""
        t = self.share[:, None]
        return (1 - t) * points[self.first] + t * points[self.second]

    def areas(self, points: Floats) -> Floats:
        """(count,) lengths of the vector areas, for points (N,3)."""
        middle = _means(points, self.section, self.count)[self.owner]
        each = np.cross(points[self.start] - middle, points[self.stop] - middle) / 2
        return np.linalg.norm(_sums(each, self.owner, self.count), axis=1)

    def diameters(self, points: Floats) -> Floats:
        """(D,) distances of the opposite points, for points (N,3)."""
        return np.linalg.norm(points[self.near] - points[self.far], axis=1)


@dataclass(frozen=True, eq=False)
class Line:
    """Two half lines from a joint (3,): back along its parent's bone and on along its own, unit directions (3,)."""

    joint: Floats
    back: Floats
    on: Floats

    def distance(self, points: Floats) -> Floats:
        """(N,) to the nearer half line."""
        p = points - self.joint
        feet = [np.maximum(p @ u, 0)[:, None] * u for u in (self.back, self.on)]
        return np.minimum(*(np.linalg.norm(p - foot, axis=1) for foot in feet))

    def moved(self, parent: Floats, own: Floats) -> Line:
        """The line when the parent's and the own joint's matrix (4,4) are these."""
        back, on = parent[:3, :3] @ self.back, own[:3, :3] @ self.on
        where = own[:3, :3] @ self.joint + own[:3, 3]
        return Line(where, back / np.linalg.norm(back), on / np.linalg.norm(on))


@dataclass(frozen=True, eq=False)
class Region:
    """The surface round a joint: the limb from the middle of one bone to the middle of the next.

    vertices (V,) and triangles (T,): what belongs to it, bool. `line` at rest, `reach` of it backwards and onwards (m).
    """

    joint: int
    parent: int
    line: Line
    reach: tuple[float, float]
    limb: NDArray[np.bool_]
    vertices: NDArray[np.bool_]
    triangles: NDArray[np.bool_]


class Gauge:
    """Sections and regions round the named joints of a body, laid at rest; measures any pose of it."""

    def __init__(self, body: Body, joints: Sequence[str] = ()):
        skeleton, skin = body.skeleton, body.skin
        unknown = [j for j in joints if j not in skeleton.index]
        if unknown:
            raise VitruvianError(f"quality: {body.name} has no joint {unknown[0]}; name joints of its skeleton")
        self.body = body
        self.rest = skin.rest
        self.welded = _weld(skin.rest)
        self.faces = self.welded[skin.triangles]
        edges = np.sort(skin.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        self.edges = np.unique(edges, axis=0)
        self.lengths = _lengths(self.rest, self.edges)
        self.regions: dict[str, Region] = {}
        self.sections: dict[str, Sections] = {}
        tree = Tree.of(body)
        for name in joints:
            region = _region(body, skeleton.index[name], tree)
            if region is not None:
                self.regions[name] = region
                self.sections[name] = _lay(self.rest, self.faces[region.limb[self.faces].all(axis=1)], region)

    @cached_property
    def compass(self) -> Rigid:
        """Turns rest normals: the mean rotation of the joints of each vertex."""
        rows = bind(self.body.skin.weights, len(self.body.skeleton), rule="as_file", rigid=True)
        return Rigid("log", self.body, rows)

    def measure(self, points: NDArray, matrices: Floats) -> Report:
        """The report of skin points (V,3) in a pose with joint matrices (J,4,4)."""
        p = np.asarray(points, dtype=np.float64)
        require(p.shape == self.rest.shape, "points", f"shape {self.rest.shape}", p.shape)
        m = _matrices(self.body.skeleton, matrices)
        flipped = self._flipped(p, m)
        apart = [np.linalg.norm(q - q[self.welded], axis=1) for q in (p, self.rest)]
        gaps = np.maximum(apart[0] - apart[1], 0)
        stretch = _lengths(p, self.edges) / np.where(self.lengths > SAME, self.lengths, np.nan)
        volumes = {"": _volume(p, self.faces) / (_volume(self.rest, self.faces) or np.nan)}
        joints: dict[str, Quality] = {}
        for name, region in self.regions.items():
            faces = self.faces[region.triangles]
            inside = region.vertices[self.edges].all(axis=1)
            joints[name] = Quality(
                volume=_volume(p, faces) / (_volume(self.rest, faces) or np.nan),
                folds=int(flipped[region.triangles].sum()),
                gap=float(gaps[region.vertices].max(initial=0)),
                stretch=_largest(stretch[inside]),
                **self._cuts(name, p, m),
            )
        worst = {
            "area": -_largest([-q.area for q in joints.values()]),
            "thickness": -_largest([-q.thickness for q in joints.values()]),
            "bulge": _largest([q.bulge for q in joints.values()]),
        }
        whole = Quality(
            volume=volumes[""], folds=int(flipped.sum()), gap=float(gaps.max(initial=0)), stretch=_largest(stretch),
            **worst,
        )  # fmt: skip
        return Report(whole, joints)

    def _cuts(self, name: str, points: Floats, matrices: Floats) -> dict[str, float]:
        """Area, thickness and bulge of the sections of a joint."""
        region, cut = self.regions[name], self.sections[name]
        before, after = cut.at(self.rest), cut.at(points)
        line = region.line.moved(matrices[region.parent], matrices[region.joint])
        with np.errstate(divide="ignore", invalid="ignore"):
            size = cut.areas(before)
            area = cut.areas(after) / size
            thick = cut.diameters(after) / cut.diameters(before)
            away = line.distance(after) - region.line.distance(before)
            bulge = 1 + away / np.sqrt(size / np.pi)[cut.section]
        return {"area": -_largest(-area), "thickness": -_largest(-thick), "bulge": _largest(bulge)}

    def _flipped(self, points: Floats, matrices: Floats) -> NDArray[np.bool_]:
        """(T,) triangles that face away from where their joints turn them."""
        triangles = self.body.skin.triangles
        frames = np.empty((1, len(points), 3, 4), np.float32)
        self.compass.frames(matrices[None], frames)
        mean = frames[0, :, :, :3].astype(np.float64)[triangles].sum(axis=1)
        before = np.einsum("tab,tb->ta", mean, face_normals(self.rest, triangles))
        after = face_normals(points, triangles)
        return np.asarray((before * after).sum(axis=1) < 0)


def _largest(values: object) -> float:
    """The largest of what can be measured, NaN when nothing can."""
    v = np.asarray(values, dtype=np.float64)
    v = v[np.isfinite(v)]
    return float(v.max()) if v.size else float("nan")


def _lengths(points: Floats, edges: Ints) -> Floats:
    return np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)


def _sums(values: Floats, group: Ints, count: int) -> Floats:
    """(count,3) sums of values (n,3) by group."""
    return np.stack([np.bincount(group, values[:, k], minlength=count) for k in range(3)], axis=1)


def _means(values: Floats, group: Ints, count: int) -> Floats:
    return _sums(values, group, count) / np.maximum(np.bincount(group, minlength=count), 1)[:, None]


def _weld(rest: Floats) -> Ints:
    """(V,) the first vertex at the place of each vertex."""
    if not len(rest):
        return np.zeros(0, np.int32)
    _, first, where = np.unique(np.round(rest / SAME), axis=0, return_index=True, return_inverse=True)
    return first[where.reshape(-1)].astype(np.int32)


def _volume(points: Floats, faces: Ints) -> float:
    """Signed volume of triangles (T,3), m3; each boundary loop is closed by a fan round its mean point."""
    if not len(faces):
        return 0.0
    p = points - points[faces[:, 0]].mean(axis=0)
    a, b, c = (p[faces[:, k]] for k in range(3))
    total = float(np.einsum("ni,ni->", a, np.cross(b, c)))
    start, stop, times = _boundary(faces, len(points))
    if len(start):
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        graph = coo_array((np.ones(len(start)), (start, stop)), shape=(len(points), len(points)))
        count, loop = connected_components(graph, directed=False)
        middle = _means(p[start], loop[start], count)[loop[start]]
        lids = np.einsum("ni,ni->n", middle, np.cross(p[stop], p[start]))  # against the boundary: that closes it
        total += float(lids @ times)
    return total / 6


def _boundary(faces: Ints, vertices: int) -> tuple[Ints, Ints, Floats]:
    """Directed edges (start, stop) that lack a partner, and how many times each: 1 on a manifold with boundary."""
    a, b = faces[:, [0, 1, 2]].ravel().astype(np.int64), faces[:, [1, 2, 0]].ravel().astype(np.int64)
    low, high = np.minimum(a, b), np.maximum(a, b)
    keys, where = np.unique(low * vertices + high, return_inverse=True)
    net = np.bincount(where, np.sign(b - a), minlength=len(keys))
    open_ = np.flatnonzero(net)
    low, high, net = keys[open_] // vertices, keys[open_] % vertices, net[open_]
    ahead = net > 0
    return np.where(ahead, low, high), np.where(ahead, high, low), np.abs(net)


@dataclass(frozen=True, eq=False)
class Tree:
    """Joints in the order of a walk that goes down before it goes on: those below joint j have `first[j]` <= place <
    `first[j] + size[j]`. `load` (J,): how much skin hangs on each joint and those below it."""

    first: Ints
    size: Ints
    load: Floats

    @staticmethod
    def of(body: Body) -> Tree:
        parents, w = body.skeleton.parents, body.skin.weights
        n = len(parents)
        size, load = np.ones(n, np.int32), np.bincount(w.joint, w.weight, minlength=n).astype(np.float64)
        for j in range(n - 1, -1, -1):
            if parents[j] >= 0:
                size[parents[j]] += size[j]
                load[parents[j]] += load[j]
        first, free, top = np.zeros(n, np.int32), np.zeros(n, np.int32), 0
        for j, parent in enumerate(parents):
            first[j] = free[parent] if parent >= 0 else top
            if parent >= 0:
                free[parent] += size[j]
            else:
                top += size[j]
            free[j] = first[j] + 1
        return Tree(first, size, load)

    def under(self, joint: int) -> NDArray[np.bool_]:
        """(J,) the joint and all below it."""
        return (self.first >= self.first[joint]) & (self.first < self.first[joint] + self.size[joint])


def _region(body: Body, joint: int, tree: Tree) -> Region | None:
    """The surface round a joint; None for a root, and where its bones have no length."""
    skeleton, skin = body.skeleton, body.skin
    parents, centers = skeleton.parents, skeleton.centers
    parent = int(parents[joint])
    if parent < 0 or not len(skin.triangles):
        return None
    back = centers[parent] - centers[joint]
    size = float(np.linalg.norm(back))
    if size < SAME:
        return None
    under = tree.under(joint)
    w = skin.weights
    share = np.bincount(w.vertex, w.weight * (under[w.joint] | (w.joint == parent)), minlength=len(skin.rest))
    limb = share > 0.5 * np.maximum(w.sums, 1e-9)
    limb &= w.counts > 0
    below = np.bincount(w.vertex, w.weight * under[w.joint], minlength=len(skin.rest)) > 0.5
    end = _end(skeleton, tree, joint, 0.25 * size)
    if end is None and below.any():  # the last joint of a chain: on along the parent's bone
        end = centers[joint] - back / size * float(((skin.rest[below] - centers[joint]) @ -back / size).max())
    on = np.zeros(3) if end is None else end - centers[joint]
    length = float(np.linalg.norm(on))
    if length < SAME:
        return None
    line = Line(centers[joint], back / size, on / length)
    reach = (size / 2, length / 2)
    p = skin.rest - centers[joint]
    ahead = p @ (line.on - line.back) >= 0
    along = np.where(ahead, p @ line.on / reach[1], -(p @ line.back) / reach[0])
    vertices = limb & (np.abs(along) <= 1 + 1e-9)
    return Region(joint, parent, line, reach, limb, vertices, vertices[skin.triangles].all(axis=1))


def _end(skeleton: Skeleton, tree: Tree, joint: int, least: float) -> Floats | None:
    """Where the bone of a joint ends: in the middle of its branches (wrist: between the fingers), by how much skin hangs
    on each; where that is nearer than `least`, on the heaviest branch."""
    below = np.flatnonzero(skeleton.parents == joint)
    if not len(below):
        return None
    center, load = skeleton.centers[joint], tree.load[below] + 1e-9
    ends = np.stack([_far(skeleton, tree, int(child), center, least) for child in below])
    middle: Floats = load @ ends / load.sum()
    return middle if np.linalg.norm(middle - center) >= least else ends[np.argmax(load)]


def _far(skeleton: Skeleton, tree: Tree, at: int, center: Floats, least: float) -> Floats:
    """The first joint, down the heaviest branch, that is at least so far from `center`; else its last joint."""
    while np.linalg.norm(skeleton.centers[at] - center) < least:
        below = np.flatnonzero(skeleton.parents == at)
        if not len(below):
            break
        at = int(below[np.argmax(tree.load[below])])
    return skeleton.centers[at]


def _lay(rest: Floats, faces: Ints, region: Region) -> Sections:
    """The closed sections round the bone, in planes from the middle of one bone to the middle of the next."""
    line = region.line
    used, local = np.unique(faces, return_inverse=True)
    rest, faces = rest[used], local.reshape(-1, 3).astype(np.int32)
    pieces: list[tuple[NDArray, ...]] = []
    nodes = 0
    for s in np.linspace(-1, 1, STATIONS):
        h = (s + 1) / 2
        h = h * h * (3 - 2 * h)
        normal = (1 - h) * -line.back + h * line.on
        if np.linalg.norm(normal) < 1e-6:
            continue
        normal /= np.linalg.norm(normal)
        center = line.joint + (s * region.reach[1] * line.on if s >= 0 else -s * region.reach[0] * line.back)
        found = _slice(rest, faces, center, normal)
        if found is None:
            continue
        first, second, share, start, stop = found
        points = (1 - share[:, None]) * rest[first] + share[:, None] * rest[second]
        near, far = _opposite(points, normal)
        k = len(pieces)
        pieces.append(
            (used[first], used[second], share, np.full(len(first), k), start + nodes, stop + nodes, np.full(len(start), k),
             near + nodes, far + nodes, np.full(len(near), k))
        )  # fmt: skip
        nodes += len(first)
    if not pieces:
        none = np.zeros(0, np.int32)
        return Sections(none, none, np.zeros(0), none, none, none, none, none, none, none, 0)
    columns = [np.concatenate(column) for column in zip(*pieces)]
    return Sections(*columns, count=len(pieces))  # type: ignore[misc, arg-type]


def _slice(rest: Floats, faces: Ints, center: Floats, normal: Floats) -> tuple[NDArray, ...] | None:
    """The largest closed loop round `center` in which a plane cuts triangles: points on edges, segments between them.

    A vertex in the plane counts as above it, so that every triangle is cut in two edges or in none.
    """
    height = (rest - center) @ normal
    above = height >= 0
    side = above[faces]
    cut = np.flatnonzero(side.any(axis=1) & ~side.all(axis=1))
    if len(cut) < 3:
        return None
    t, side = faces[cut], side[cut]
    alone = np.argmax(side == (side.sum(axis=1) == 1)[:, None], axis=1)  # the corner on its own side
    rows = np.arange(len(t))
    a, b, c = t[rows, alone], t[rows, (alone + 1) % 3], t[rows, (alone + 2) % 3]
    ends = np.stack([np.stack([a, b], 1), np.stack([a, c], 1)], 1)  # (n,2,2): edges at start and stop
    ends = np.where(side[rows, alone][:, None, None], ends, ends[:, ::-1])
    low, high = ends.min(axis=-1).astype(np.int64), ends.max(axis=-1).astype(np.int64)
    keys, where = np.unique(low * len(rest) + high, return_inverse=True)
    where = where.reshape(-1, 2)
    first, second = keys // len(rest), keys % len(rest)
    share = height[first] / (height[first] - height[second])
    points = (1 - share[:, None]) * rest[first] + share[:, None] * rest[second]

    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(where)), (where[:, 0], where[:, 1])), shape=(len(keys), len(keys)))
    count, part = connected_components(graph, directed=False)
    degree = np.bincount(where.ravel(), minlength=len(keys))
    closed = np.bincount(part, degree != 2, minlength=count) == 0
    middle = _means(points, part, count)
    owner = part[where[:, 0]]
    each = np.cross(points[where[:, 0]] - middle[owner], points[where[:, 1]] - middle[owner]) / 2
    area = np.abs(_sums(each, owner, count) @ normal)
    round_bone = np.linalg.norm(middle - center, axis=1) < np.sqrt(area / np.pi)
    area = np.where(closed & round_bone, area, 0)
    best = int(np.argmax(area))
    if area[best] <= 0:
        return None
    mine = part == best
    renumber = np.cumsum(mine) - 1
    segments = renumber[where[owner == best]]
    return first[mine], second[mine], share[mine], segments[:, 0], segments[:, 1]


def _opposite(points: Floats, normal: Floats) -> tuple[Ints, Ints]:
    """(D,) the outermost points of a loop both ways in each of `DIAMETERS` directions of its plane."""
    x = np.eye(3)[np.argmin(np.abs(normal))]
    x = x - (x @ normal) * normal
    x /= np.linalg.norm(x)
    angle = np.arange(DIAMETERS) * np.pi / DIAMETERS
    ways = np.outer(np.cos(angle), x) + np.outer(np.sin(angle), np.cross(normal, x))
    height = points @ ways.T
    return np.argmin(height, axis=0), np.argmax(height, axis=0)
