"""What a live file is drawn from: levels of detail of contours, and the skin between them cut into stiff and soft parts."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from vitruvian.body.contours import Contours, grid
from vitruvian.body.types import Body, Floats, Ints
from vitruvian.deform.bind import Influences, bind
from vitruvian.deform.contours import retwisted
from vitruvian.hanim import tables
from vitruvian.hanim.humanoid import Humanoid, Segment, Shape
from vitruvian.hanim.normals import corner_normals

LEVELS = 3  # of detail: all contours and points, every second, every fourth
SOFT = "live_soft"  # how the shapes are named that the script moves


@dataclass(frozen=True, eq=False)
class Soft:
    """Points of the skin that the script moves, shape after shape.

    `vertices` (n,) numbers of skin points, `rest`, `normals` (n,3) in humanoid space; `influences` of n points, by
    joints of the body; `end` (s,) where each shape ends, `names` its shapes; `far` (n,) whether a point follows a hand,
    a foot or the head. `tied` (n,): the contour that moves a point, counted through all surfaces, -1: its weights do.
    """

    vertices: Ints
    rest: Floats
    normals: Floats
    influences: Influences
    end: Ints
    names: tuple[str, ...]
    far: Ints
    tied: Ints


def parted(humanoid: Humanoid, body: Body) -> tuple[Humanoid, Soft]:
    """A humanoid without a skin: what one joint holds hangs in its Segment, the rest in the first joint's.

    `body` is the packed humanoid. So no browser deforms anything by itself, and nothing is deformed twice.
    """
    out = humanoid.copied()
    out.skin, out.skin_coord, out.skin_normal, out.skin_displacers = [], np.zeros((0, 3)), None, []
    joints = out.joints()
    for joint in joints:
        joint.skin_coord_index, joint.skin_coord_weight, joint.displacers = np.zeros(0, np.int32), np.zeros(0), []
    count = len(humanoid.skin_coord)
    rows = bind(body.skin.weights, len(body.skeleton), rigid=True)
    single = np.full(len(rows), -1)
    alone = rows.counts == 1
    single[alone] = rows.joint[rows.row[:-1][alone]]
    single[np.isin(single, [s.joint for s in retwisted(body.contours)])] = -1  # no Segment turns as they see it
    contour, start = np.full(len(rows), -1), 0
    for s in body.contours:
        contour[s.tied[:, 0]] = start + s.tied[:, 1]
        start += len(s)
    single[contour >= 0] = -1
    single = single[:count]
    shapes = [s for s in humanoid.skin if s.points is None and len(s.triangles)]
    for shape in humanoid.skin:
        if shape.points is not None:
            _home(out, 0).shapes.append(shape)
    normal = np.zeros((0, 3))
    if shapes:
        triangles = np.concatenate([s.triangles for s in shapes])
        normal = corner_normals(humanoid.skin_coord, triangles, np.full(len(triangles), np.pi))[0]
        sewn = np.flatnonzero(contour[:count] >= 0)
        normal[sewn] = smooth_normals(body)[sewn]
    taken: list[Ints] = []
    names = []
    for number, shape in enumerate(shapes):
        held = single[shape.triangles]
        owner = np.where((held == held[:, :1]).all(axis=1) & (held[:, 0] < len(joints)), held[:, 0], -1)
        for joint in np.unique(owner):
            mine, used = _piece(shape, owner == joint, humanoid.skin_coord, normal)
            if joint >= 0:
                _home(out, int(joint)).shapes.append(replace(mine, name=f"{shape.name}_{joints[joint].name}"))
                continue
            names.append(f"{SOFT}_{number}")
            taken.append(used)
            _home(out, 0).shapes.append(replace(mine, name=names[-1]))
    chosen = np.concatenate(taken) if taken else np.zeros(0, np.int64)
    place = [np.arange(rows.row[v], rows.row[v + 1]) for v in chosen]
    entry = np.concatenate(place) if place else np.zeros(0, np.int64)
    row = np.concatenate([[0], np.cumsum(rows.counts[chosen])]).astype(np.int32)
    joint, weight = rows.joint[entry], rows.weight[entry]
    far = _extremities(body)[np.minimum(joint[row[:-1]], len(joints) - 1)] if len(chosen) else np.zeros(0, bool)
    far &= contour[chosen] < 0
    soft = Soft(
        chosen.astype(np.int32),
        humanoid.skin_coord[chosen], normal[chosen], Influences(row, joint, weight, len(body.skeleton)),
        np.cumsum([len(t) for t in taken]).astype(np.int32), tuple(names), far.astype(np.int32),
        contour[chosen].astype(np.int32),
    )  # fmt: skip
    return out.settled(), soft


def _piece(shape: Shape, mine: np.ndarray, points: Floats, normals: Floats) -> tuple[Shape, Ints]:
    used, local = np.unique(shape.triangles[mine], return_inverse=True)
    uv = None if shape.uv is None else shape.uv_triangles if shape.uv_triangles is not None else shape.triangles
    piece = replace(
        shape, points=points[used], triangles=local.reshape(-1, 3).astype(np.int32), normals=normals[used],
        normal_triangles=None, colors=None if shape.colors is None else shape.colors[used],
        uv_triangles=None if uv is None else uv[mine], faces=None, transform=None, node=None, skin_index=None,
    )  # fmt: skip
    if uv is not None and shape.uv_triangles is None:
        piece = replace(piece, uv=shape.uv[used], uv_triangles=None)  # type: ignore[index]
    return piece, used


def _home(humanoid: Humanoid, number: int) -> Segment:
    joint = humanoid.joints()[number]
    if not joint.segments:
        known = tables.canonical(joint.name)
        joint.segments.append(Segment(tables.joints()[known].segment if known else f"{joint.name}_segment"))
    return joint.segments[0]


def _extremities(body: Body) -> np.ndarray:
    """(J,) whether a joint moves a hand, a foot, or the head and neck."""
    from vitruvian.motion.names import joint_index

    skeleton, index = body.skeleton, joint_index(body.skeleton.names)
    starts = {index[n] for n in ("l_radiocarpal", "r_radiocarpal", "l_talocrural", "r_talocrural") if n in index}
    starts |= {j for n, j in index.items() if n.startswith("vc") or n == "skullbase"}
    out = np.zeros(len(skeleton), bool)
    for j, parent in enumerate(skeleton.parents):
        out[j] = j in starts or (parent >= 0 and out[parent])
    return out


def smooth_normals(body: Body) -> Floats:
    """(V,3) of all points of the skin, contours and what is sewn to them as one; points that lie together share theirs."""
    points, every = body.skin.rest, body.skin.triangles
    _, same = np.unique(np.round(points, 7), axis=0, return_inverse=True)
    same = same.reshape(-1)
    sums = np.zeros((same.max() + 1, 3))
    a, b, c = np.moveaxis(points[every], 1, 0)
    face = np.cross(b - a, c - a)
    for corner in every.T:
        np.add.at(sums, same[corner], face)
    size = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.where(size > 1e-15, sums / np.where(size > 0, size, 1), [0.0, 1.0, 0.0])[same]


def _numbers(surface: Contours) -> Ints:
    return np.arange(surface.vertices.size, dtype=np.int32).reshape(surface.vertices.shape)


def levels(body: Body, surfaces: Collection[Contours], count: int = LEVELS) -> list[list[Ints]]:
    """Triangles (t,3) of each surface at each level of detail, as numbers of its own points; 0 is the finest.

    A level keeps every second contour and point of the one before, and always seams and the ends of ramps. Where two
    surfaces share a loop, both keep the same of its points, so that no level opens a seam; where skin is sewn on, all.
    """
    out = [[grid(_numbers(s), s.closed) for s in surfaces]]
    for level in range(1, count):
        out.append(_coarse(body, list(surfaces), 2**level))
    return out


def _coarse(body: Body, surfaces: list[Contours], step: int) -> list[Ints]:
    rows = [_rows(s, step) for s in surfaces]
    kept = []
    shared: set[tuple[float, ...]] = set()
    keys = [np.round(body.skin.rest[s.vertices] * 1e7).astype(np.int64) for s in surfaces]
    for s, key in zip(surfaces, keys, strict=True):
        keep = np.zeros(s.vertices.shape, bool)
        keep[:, _every(s.vertices.shape[1], step, s.closed)] = True
        keep[np.unique(s.tied[:, 1])] = True
        kept.append(keep)
        edge = keep.copy()
        edge[1:-1] = False
        if not s.closed:
            edge[:, [0, -1]] = keep[:, [0, -1]]
        shared |= {tuple(k) for k in key[edge].tolist()}
    made = []
    for s, keep, key, mine in zip(surfaces, kept, keys, rows, strict=True):
        for r in (0, len(s) - 1):
            keep[r] |= [tuple(k) in shared for k in key[r].tolist()]
        picked = [np.flatnonzero(keep[r]).astype(np.int32) for r in mine]
        made.append(
            np.concatenate([
                _strip(a, picked[n], b, picked[n + 1], s.vertices.shape[1], s.closed)
                for n, (a, b) in enumerate(zip(mine, mine[1:]))
            ])
        )  # fmt: skip
    return made


def staying(surface: Contours) -> Ints:
    """(n,) for each contour what levels that are added later keep: 2 all its points, as it is a seam or skin is sewn to
    it, 1 the contour, as a ramp ends there, 0 neither."""
    out = np.zeros(len(surface), np.int32)
    out[_rows(surface, len(surface))] = 1
    out[[0, -1]] = 2
    out[np.unique(surface.tied[:, 1])] = 2
    return out


def _rows(surface: Contours, step: int) -> list[int]:
    """Contours that a level keeps; those of an open surface (half a torso) all at the same heights as the other's."""
    share = surface.swing
    kind = np.where(share <= 0, 0, np.where(share >= 1, 2, 1))
    ends = np.zeros(len(share), bool)
    for a in range(len(share) - 1):
        turn = kind[a] != kind[a + 1]
        ends[a] |= bool((turn & (kind[a] != 1)).any())
        ends[a + 1] |= bool((turn & (kind[a + 1] != 1)).any())
    keep = np.arange(len(share)) % step == 0
    keep[[0, -1]] = True
    return np.flatnonzero(keep | ends).tolist()


def _every(count: int, step: int, closed: bool) -> Ints:
    chosen = np.arange(0, count, step if count > 2 * step else 1, dtype=np.int32)
    return chosen if closed or chosen[-1] == count - 1 else np.append(chosen, np.int32(count - 1))


def _strip(row: int, near: Ints, below: int, far: Ints, each: int, closed: bool) -> Ints:
    """(t,3) triangles between two contours that keep different points, the outside out as in `grid`."""
    a, b = [*near.tolist()], [*far.tolist()]
    if closed:
        a, b = [*a, a[0] + each], [*b, b[0] + each]
    out, i, k = [], 0, 0
    while i < len(a) - 1 or k < len(b) - 1:
        ahead = k >= len(b) - 1 or (i < len(a) - 1 and a[i + 1] <= b[k + 1])
        here, there = row * each + a[i] % each, below * each + b[k] % each
        if ahead:
            out.append((here, there, row * each + a[i + 1] % each))
            i += 1
        else:
            out.append((here, there, below * each + b[k + 1] % each))
            k += 1
    return np.array(out, np.int32)
