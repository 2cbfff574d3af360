"""Mass, centre of mass and inertia: of closed surfaces, of the Segments of a humanoid, of the whole body while it moves.

Volume integrals are sums over the tetrahedra between the origin and each triangle (A. M. Messner and G. Q. Taylor,
"Algorithm 550: Solid polyhedron measures", ACM TOMS 6, 1980). A seamless skin is filled with wedges from its triangles to
the nearest points of their bones: neighbours share their walls, so the Segments fill the body without gap or overlap.
Segment geometry is closed by cones over its holes.
Published shares of the segments: P. de Leva, "Adjustments to Zatsiorsky-Seluyanov's segment inertia parameters",
J. Biomechanics 29, 1996, table 4.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, floats, indices, require
from vitruvian.errors import VitruvianError
from vitruvian.hanim import tables
from vitruvian.hanim.humanoid import Humanoid, Joint, Segment, Shape

if TYPE_CHECKING:
    from vitruvian.motion.types import Motion

DENSITY = 1050.0  # kg/m3, of the whole body
METHODS = ("geometry", "fractions")
# Share of the body's mass, female and male, and where the share goes when the figure has no such part.
FRACTIONS: dict[str, tuple[float, float, str]] = {
    "hand": (0.0056, 0.0061, "forearm"),
    "forearm": (0.0138, 0.0162, "upper arm"),
    "upper arm": (0.0255, 0.0271, "trunk"),
    "foot": (0.0129, 0.0137, "shank"),
    "shank": (0.0481, 0.0433, "thigh"),
    "thigh": (0.1478, 0.1416, "trunk"),
    "head": (0.0668, 0.0694, "trunk"),
    "trunk": (0.4257, 0.4346, "trunk"),
}
_STARTS = {  # where a part of the body begins; what hangs below belongs to it until the next begins
    "shoulder": "upper arm",
    "elbow": "forearm",
    "radiocarpal": "hand",
    "hip": "thigh",
    "knee": "shank",
    "talocrural": "foot",
}


@dataclass(frozen=True, eq=False)
class Mass:
    """`mass` in kg, `center` (3,) in metres, `inertia` (3,3) in kg m2 about the centre, axes of the frame."""

    mass: float
    center: Floats
    inertia: Floats

    def moved(self, matrices: Floats) -> tuple[Floats, Floats]:
        """(F,3) centre and (F,3,3) inertia under rigid matrices (F,4,4)."""
        turn = matrices[:, :3, :3]
        return turn @ self.center + matrices[:, :3, 3], turn @ self.inertia @ turn.transpose(0, 2, 1)


@dataclass(frozen=True, eq=False)
class WholeBody:
    """`mass` in kg; `center` (F,3), metres, and `inertia` (F,3,3), kg m2 about it, in humanoid space per frame."""

    mass: float
    center: Floats
    inertia: Floats


@dataclass(frozen=True, eq=False)
class Cut:
    """How a surface falls into closed pieces; does not depend on where its points are.

    triangles (t,3) and their piece (t,); ring edges (e,2), directed so that the cone to the middle of their ring closes
    the piece, with their ring (e,); rings belong to pieces (r,); `vertex` and `of` list the points of each ring.
    """

    pieces: int
    triangles: Ints
    owner: Ints
    edges: Ints
    ring: Ints
    ring_owner: Ints
    vertex: Ints
    of: Ints


def cut(triangles: Ints, owner: NDArray[np.integer], pieces: int, same: NDArray[np.integer] | None = None) -> Cut:
    """The pieces of a surface: triangles (t,3), each with the number of its piece (t,) in 0..pieces-1.

    `same` (points,) numbers points so that those at one place share a number (copies along a seam). Holes of the
    surface are closed like cuts.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    corners = triangles if same is None else same[triangles]
    whole = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2]) & (corners[:, 2] != corners[:, 0])
    triangles, corners, owner = triangles[whole], corners[whole], np.asarray(owner)[whole]
    start = corners[:, [0, 1, 2]].reshape(-1).astype(np.int64)
    stop = corners[:, [1, 2, 0]].reshape(-1).astype(np.int64)
    piece = np.repeat(owner.astype(np.int64), 3)
    n = int(corners.max(initial=0)) + 1
    low, high = np.minimum(start, stop), np.maximum(start, stop)
    keys, where = np.unique((piece * n + low) * n + high, return_inverse=True)
    balance = np.bincount(where, np.where(start < stop, 1, -1)).astype(int)  # there and back closes by itself
    keys = np.repeat(keys, np.abs(balance))
    forward = np.repeat(balance > 0, np.abs(balance))
    low, high = keys // n, (keys // n // n) * n + keys % n  # piece * n + point
    a, b = np.where(forward, low, high), np.where(forward, high, low)
    nodes, local = np.unique(np.concatenate([a, b]), return_inverse=True)
    a, b = local[: len(a)], local[len(a) :]
    graph = coo_matrix((np.ones(len(a)), (a, b)), (len(nodes), len(nodes)))
    rings, label = connected_components(graph, directed=False) if len(nodes) else (0, np.zeros(0, np.int32))
    real = np.zeros(n, np.int64)
    real[corners.reshape(-1)] = triangles.reshape(-1)
    point = real[nodes % n]
    ring_owner = np.zeros(rings, np.int32)
    ring_owner[label] = nodes // n
    edges = np.stack([point[b], point[a]], axis=1)
    ints = lambda x: np.ascontiguousarray(x, dtype=np.int32)  # noqa: E731
    return Cut(pieces, ints(triangles), ints(owner), ints(edges), ints(label[a]), ring_owner, ints(point), ints(label))


def measured(points: Floats, pieces: Cut) -> tuple[Floats, Floats, Floats]:
    """Volume (n,), integral of x (n,3) and of x x^T (n,3,3) of every piece, from the points (v,3) of its surface."""
    count = np.maximum(np.bincount(pieces.of, minlength=len(pieces.ring_owner)), 1)
    sums = [np.bincount(pieces.of, points[pieces.vertex, k], len(count)) for k in range(3)]
    middle = (np.stack(sums, axis=1) / count[:, None])[pieces.ring]
    a, b, c = (points[pieces.triangles[:, k]] for k in range(3))
    if len(pieces.edges):
        a = np.concatenate([a, points[pieces.edges[:, 0]]])
        b = np.concatenate([b, points[pieces.edges[:, 1]]])
        c = np.concatenate([c, middle])
    owner = np.concatenate([pieces.owner, pieces.ring_owner[pieces.ring]])
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    total = a + b + c

    def add(values: Floats) -> Floats:
        return np.bincount(owner, values, pieces.pieces).astype(np.float64)

    first = np.stack([add(volume * total[:, k] / 4) for k in range(3)], axis=1)
    second = np.zeros((pieces.pieces, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            pair = total[:, i] * total[:, j] + a[:, i] * a[:, j] + b[:, i] * b[:, j] + c[:, i] * c[:, j]
            second[:, i, j] = second[:, j, i] = add(volume * pair / 20)
    return add(volume), first, second


@dataclass(frozen=True, eq=False)
class Wedges:
    """How a skin falls into pieces between triangles and bones; does not depend on where its points are.

    triangles (t,3) with their points in rising order, `sign` (t,) -1 where that turned them over, piece of each (t,),
    `bone` (v,): the bone that each point looks to.
    """

    pieces: int
    triangles: Ints
    sign: Floats
    owner: Ints
    bone: Ints


def wedges(
    triangles: Ints,
    owner: NDArray[np.integer],
    bone: Ints,
    pieces: int,
    same: NDArray[np.integer] | None = None,
) -> Wedges:
    """The wedges of triangles (t,3), each with its piece (t,); `bone` (v,) as in `Wedges`, `same` (v,) as in `cut`."""
    if same is not None:
        first = np.zeros(int(same.max(initial=-1)) + 1, np.int64)
        first[same[::-1]] = np.arange(len(same))[::-1]
        triangles = first[same[triangles]].astype(np.int32)
    a, b, c = (triangles[:, k] for k in range(3))
    swaps = (a > b).astype(int) + (b > c) + (a > c)
    ints = lambda x: np.ascontiguousarray(x, dtype=np.int32)  # noqa: E731
    return Wedges(pieces, ints(np.sort(triangles, axis=1)), 1.0 - 2.0 * (swaps % 2), ints(owner), ints(bone))


def bones(joints: list[Joint]) -> Floats:
    """(J,2,3) where the bone of each joint begins and ends: at the child with most joints below; a leaf is a point."""
    size = {id(j): 1 for j in joints}
    for joint in reversed(joints):
        size[id(joint)] += sum(size.get(id(c), 0) for c in joint.joints)
    ends = [max(j.joints, key=lambda c: size.get(id(c), 0)).center if j.joints else j.center for j in joints]
    return np.stack([np.array([j.center for j in joints]), np.array(ends)], axis=1)


def filled(points: NDArray[np.floating], pieces: Wedges, bones: NDArray[np.floating]) -> tuple[Floats, Floats, Floats]:
    """Volume (n,), integral of x (n,3) and of x x^T (n,3,3) of the pieces of a skin with points (v,3), bones (J,2,3).

    Points and bones in single precision are twice as fast and good to 1e-6 for a figure near the origin.
    """
    start, along = bones[:, 0][pieces.bone], (bones[:, 1] - bones[:, 0])[pieces.bone]
    length = np.maximum(np.einsum("vi,vi->v", along, along), 1e-12)
    inside = start + along * np.clip(np.einsum("vi,vi->v", points - start, along) / length, 0, 1)[:, None]
    p, q = _corners(points, pieces.triangles), _corners(inside, pieces.triangles)
    count, kind = len(pieces.triangles), p[0].dtype
    volume, first, second = np.zeros(count, kind), np.zeros((3, count), kind), np.zeros((6, count), kind)
    row, column = np.triu_indices(3)
    outer = {id(x): x[row] * x[column] for x in (*p, *q)}
    # a prism as three tetrahedra, its walls split from the lower point outside to the higher one inside
    for corners, sign in (((*p, q[2]), 1), ((p[0], p[1], q[1], q[2]), -1), ((p[0], *q), 1)):
        a, b, c, d = corners
        v = _triple(a - d, b - d, c - d) * (sign / 6)
        total = a + b + c + d
        volume += v
        first += v / 4 * total
        square = total[row] * total[column]
        for x in corners:
            square += outer[id(x)]
        second += v / 20 * square

    def add(values: Floats) -> Floats:
        return np.bincount(pieces.owner, pieces.sign * values, pieces.pieces).astype(np.float64)

    spread = np.zeros((pieces.pieces, 3, 3))
    for i, j, values in zip(row, column, second, strict=True):
        spread[:, i, j] = spread[:, j, i] = add(values)
    return add(volume), np.stack([add(values) for values in first], axis=1), spread


def enclosed(points: Floats, pieces: Wedges) -> float:
    """The volume inside the whole of a closed skin with points (v,3)."""
    return float((pieces.sign * _triple(*_corners(points, pieces.triangles))).sum()) / 6


def _corners(points: NDArray[np.floating], triangles: Ints) -> list[Floats]:
    """The corners of triangles (t,3) as three arrays (3,t): sums along such rows are fast."""
    rows = np.ascontiguousarray(points.T)
    return [rows.take(triangles[:, k], axis=1) for k in range(3)]


def _triple(a: Floats, b: Floats, c: Floats) -> Floats:
    """a . (b x c) of rows (3,n); NumPy's cross is several times slower."""
    x, y, z = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
    return a[0] * x + a[1] * y + a[2] * z


def pieces_of(volume: Floats, first: Floats, second: Floats, densities: Floats) -> list[Mass | None]:
    """Mass properties of pieces from their integrals, as `filled` and `measured` answer them; None without volume.

    Where no body can have the inertia (thin pieces that overlap) it is that of a ball of the same volume.
    """
    there = volume > 1e-12
    v, density = volume[there], densities[there]
    center = first[there] / v[:, None]
    spread = density[:, None, None] * (second[there] - v[:, None, None] * center[:, :, None] * center[:, None, :])
    inertia = np.trace(spread, axis1=1, axis2=2)[:, None, None] * np.eye(3) - spread
    low, middle, high = np.linalg.eigvalsh(inertia).T
    bad = ~((low > 0) & (low + middle >= high * (1 - 1e-9)))
    ball = 0.4 * density * v * (0.75 * v / np.pi) ** (2 / 3)
    inertia[bad] = ball[bad, None, None] * np.eye(3)
    out: list[Mass | None] = [None] * len(volume)
    for k, m, c, i in zip(np.flatnonzero(there), density * v, center, inertia, strict=True):
        out[k] = Mass(float(m), c, i)
    return out


def solid(points: Floats, triangles: Ints, *, density: float = 1000.0) -> Mass:
    """Mass properties of what a surface encloses: points (v,3) in metres, triangles (t,3), density in kg/m3.

    Holes are closed by cones; a surface that looks inwards counts as one that looks outwards.
    Raises `VitruvianError` when nothing is enclosed.
    """
    points = floats(points, "points", None, 3)
    triangles = indices(triangles, "triangles", len(points), None, 3)
    _, same = np.unique(points, axis=0, return_inverse=True)
    volume, first, second = measured(points, cut(triangles, np.zeros(len(triangles), np.int32), 1, same.reshape(-1)))
    require(abs(volume[0]) > 1e-12, "triangles", "a surface that encloses something", "no volume")
    sign = np.sign(volume[0])
    (found,) = pieces_of(sign * volume, sign * first, sign * second, np.array([density]))
    assert found is not None
    return found


def masses(
    humanoid: Humanoid,
    *,
    weight: float | None = None,
    density: float | Mapping[str, float] = DENSITY,
    method: str = "geometry",
    gender: float = 0.5,
    store: bool = False,
) -> dict[str, Mass]:
    """Mass properties of the Segments, by Segment name, in humanoid space at rest.

    From the seamless skin, cut where the joint of greatest weight changes, or from the geometry of the Segments.
    `weight`: kilograms of the whole body; everything is scaled to it. `density`: kg/m3 of all or by Segment name (others
    1050). `method` "fractions" gives each part of the body its published share of the weight (`gender` 0 female to 1
    male) instead of its volume's; centres and the shape of the inertia stay those of the geometry. `store` writes them
    into the Segments (made for joints that have none). Segments without volume are left out.
    Raises `VitruvianError` when the humanoid has no surface that encloses anything.
    """
    if method not in METHODS:
        raise VitruvianError(f"method: expected one of {', '.join(METHODS)}, found {method!r}")
    require(weight is None or 0 < weight < np.inf, "weight", "kilograms above zero", weight)
    joints = humanoid.joints()
    names, volume, first, second = _pieces(humanoid, joints)
    whole = float(np.sum(volume))
    who = humanoid.name or "humanoid"
    require(abs(whole) > 1e-12, who, "a skin or Segments that enclose a volume", "none")
    sign = np.sign(whole)
    given = density if isinstance(density, Mapping) else {}
    usual = DENSITY if isinstance(density, Mapping) else float(density)
    densities = np.array([given.get(segment, usual) for segment, _ in names], dtype=np.float64)
    parts = pieces_of(sign * volume, sign * first, sign * second, densities)
    found = {segment: m for (segment, _), m in zip(names, parts, strict=True) if m is not None}
    owners = dict(names)
    total = sum(m.mass for m in found.values())
    if method == "fractions":
        shares = _shares(joints, owners, found, gender)
        found = {n: _scaled(m, shares[n] * (weight or total) / m.mass) for n, m in found.items()}
    elif weight is not None:
        found = {n: _scaled(m, weight / total) for n, m in found.items()}
    if store:
        _store(joints, found, owners)
    return found


def _scaled(m: Mass, factor: float) -> Mass:
    return Mass(m.mass * factor, m.center, m.inertia * factor)


def segment_name(joint: Joint) -> str:
    """The Segment of a joint: its first, else what the standard calls it."""
    if joint.segments:
        return joint.segments[0].name
    known = tables.canonical(joint.name)
    return tables.joints()[known].segment if known else f"{joint.name}_segment"


def _pieces(humanoid: Humanoid, joints: list[Joint]) -> tuple[list[tuple[str, str]], Floats, Floats, Floats]:
    """(segment, joint) names of the pieces with their integrals: of the skin when it has weights, else of Segments."""
    from vitruvian.hanim.segmenting import triangle_joints

    moving = [s.triangles for s in humanoid.skin if s.points is None and len(s.triangles)]
    if moving and any(len(j.skin_coord_index) for j in joints):
        triangles = np.concatenate(moving)
        _, same = np.unique(humanoid.skin_coord, axis=0, return_inverse=True)
        best, bone = np.zeros(len(humanoid.skin_coord)), np.zeros(len(humanoid.skin_coord), np.int32)
        for k, joint in enumerate(joints):
            index, weight = joint.skin_coord_index, joint.skin_coord_weight
            more = weight > best[index]
            bone[index[more]], best[index[more]] = k, weight[more]
        pieces = wedges(triangles, triangle_joints(humanoid, triangles), bone, len(joints), same.reshape(-1))
        return [(segment_name(j), j.name) for j in joints], *filled(humanoid.skin_coord, pieces, bones(joints))
    segments = [(s, j) for j in joints for s in j.segments]
    points, faces, owner, start = [np.zeros((0, 3))], [np.zeros((0, 3), np.int32)], [np.zeros(0, np.int32)], 0
    for k, (segment, _) in enumerate(segments):
        for shape in segment.shapes:
            if shape.points is not None and len(shape.triangles):
                points.append(_placed(shape))
                faces.append(shape.triangles + np.int32(start))
                owner.append(np.full(len(shape.triangles), k, np.int32))
                start += len(shape.points)
    everything = np.concatenate(points)
    _, same = np.unique(everything, axis=0, return_inverse=True)
    surface = cut(np.concatenate(faces), np.concatenate(owner), len(segments), same.reshape(-1))
    return [(s.name, j.name) for s, j in segments], *measured(everything, surface)


def _placed(shape: Shape) -> Floats:
    points = np.asarray(shape.points, dtype=np.float64)
    if shape.transform is None:
        return points
    return points @ shape.transform[:3, :3].T + shape.transform[:3, 3]


def part_of(joints: list[Joint]) -> dict[str, str]:
    """Joint name -> part of the body ("trunk", "head", "upper arm", ...), by where it hangs."""
    out: dict[str, str] = {}
    above = {id(c): j.name for j in joints for c in j.joints}
    for joint in joints:
        known = tables.canonical(joint.name) or joint.name
        plain = known[2:] if known[:2] in {"l_", "r_"} else known
        start = "head" if known.startswith("vc") or known == "skullbase" else _STARTS.get(plain)
        out[joint.name] = start or out.get(above.get(id(joint), ""), "trunk")
    return out


def _shares(joints: list[Joint], owners: dict[str, str], found: dict[str, Mass], gender: float) -> dict[str, float]:
    """Segment name -> its share of the whole mass; parts are split among their Segments by volume."""
    part = part_of(joints)
    side = {j.name: (j.name[:2] if j.name[:2] in {"l_", "r_"} else "") for j in joints}
    whose = {s: owners[s] for s in found}
    group = {s: (part[j], side[j] if part[j] not in {"trunk", "head"} else "") for s, j in whose.items()}
    wanted: dict[tuple[str, str], float] = {}
    for name, (female, male, instead) in FRACTIONS.items():
        share = female + gender * (male - female)
        for s in ("",) if name in {"trunk", "head"} else ("l_", "r_"):
            wanted[name, s] = wanted.get((name, s), 0.0) + share
            if (name, s) not in group.values() and instead != name:
                there = (instead, "" if instead == "trunk" else s)
                wanted[there] = wanted.get(there, 0.0) + wanted.pop((name, s))
    volume: dict[tuple[str, str], float] = {}
    for segment, m in found.items():
        volume[group[segment]] = volume.get(group[segment], 0.0) + m.mass
    out = {s: wanted.get(group[s], 0.0) * m.mass / volume[group[s]] for s, m in found.items()}
    whole = sum(out.values())
    return {s: v / whole for s, v in out.items()}


def _store(joints: list[Joint], found: dict[str, Mass], owners: dict[str, str]) -> None:
    by_name = {s.name: s for j in joints for s in j.segments}
    holders = {j.name: j for j in joints}
    for name, m in found.items():
        if name not in by_name:
            by_name[name] = Segment(name)
            holders[owners[name]].segments.append(by_name[name])
        put(by_name[name], m)


def put(segment: Segment, m: Mass) -> None:
    """Write mass properties into a Segment."""
    segment.mass, segment.center_of_mass = m.mass, m.center.copy()
    segment.moments_of_inertia = m.inertia.reshape(9).copy()


def whole_body(humanoid: Humanoid, motion: Motion | None = None, *, matrices: Floats | None = None) -> WholeBody:
    """Mass, centre of mass and inertia of the whole body, frame by frame, from the masses in its Segments.

    `motion` on the humanoid's packed skeleton, or joint matrices (F,J,4,4) of it; neither: the file's own pose.
    Humanoid space, without the Humanoid's own transform; the centre divides out nothing but the masses given.
    Raises `VitruvianError` when no Segment has a mass (`masses(humanoid, store=True)` computes them).
    """
    from vitruvian.body.kinematics import joint_matrices
    from vitruvian.body.pack import pack

    if matrices is None:
        matrices = joint_matrices(pack(humanoid).skeleton, motion)
    joints = list({id(j): j for j in humanoid.joints()}.values())
    poses = np.asarray(matrices, dtype=np.float64)
    require(poses.ndim == 4 and poses.shape[1:] == (len(joints), 4, 4), "matrices", "(F, joints, 4, 4)", poses.shape)
    parts = [(k, s) for k, j in enumerate(joints) for s in j.segments if s.mass > 0]
    require(bool(parts), humanoid.name or "humanoid", "Segments with mass", "none; masses(..., store=True) makes them")
    moved = []
    for k, s in parts:
        own = Mass(s.mass, s.center_of_mass, np.asarray(s.moments_of_inertia, dtype=np.float64).reshape(3, 3))
        moved.append((s.mass, *own.moved(poses[:, k])))
    mass = float(sum(m for m, _, _ in moved))
    center = np.sum([m * c for m, c, _ in moved], axis=0) / mass
    inertia = np.zeros((len(poses), 3, 3))
    for m, c, own_inertia in moved:
        arm = c - center
        square = np.einsum("fi,fi->f", arm, arm)[:, None, None] * np.eye(3)
        inertia += own_inertia + m * (square - arm[:, :, None] * arm[:, None, :])
    return WholeBody(mass, center, inertia)
