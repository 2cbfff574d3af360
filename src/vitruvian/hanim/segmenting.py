"""A seamless skin cut into the Segments of its joints.

Each triangle goes to the joint of greatest weight; points on the cuts are copied, and copies keep position, normal and
weights, so that the pieces stay one surface: at rest, and posed too when the points of several joints are recomputed.
Source: the Body Manager's export (seed 003, 5.2, 6.1, 6.2; note hanim.md, section 7).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.hanim import tables
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Segment, Shape
from vitruvian.hanim.normals import corner_normals

Ints = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Patch:
    """What a player recomputes of one Segment that was cut out of a skin.

    `skin` (n,) the skin point that each point of the Segment copies. `rigid` and `deformed` split 0..n-1: rigid points
    hang on this Segment's joint alone and ride with it; the others, on the cuts and round the joints, have weights of
    other joints and are computed anew in every pose.
    """

    joint: str
    segment: str
    skin: Ints
    rigid: Ints
    deformed: Ints


def triangle_joints(humanoid: Humanoid, triangles: Ints, joints: Collection[str] | None = None) -> NDArray[np.int64]:
    """(t,) number of the joint, in tree order, that each triangle of the skin follows.

    Weights of the three corners are summed per joint; the largest wins, ties go to the joint that comes first in the
    standard's table (then in the tree); triangles without any weight follow the root. With `joints`, weights of joints
    not among these names count for their nearest ancestor that is.
    """
    every = humanoid.joints()
    holder = _holders(humanoid, joints)
    table = tables.joints()
    known = [tables.canonical(j.name) for j in every]
    rank = sorted(range(len(every)), key=lambda n: (table[k].index if (k := known[n]) else len(table), n))
    best = np.zeros(len(triangles))
    owner = np.zeros(len(triangles), np.int64)
    weight = np.zeros(len(humanoid.skin_coord))
    for number in rank:
        mine = [j for n, j in enumerate(every) if holder[n] == number and len(j.skin_coord_index)]
        if not mine:
            continue
        weight[:] = 0
        for joint in mine:
            np.add.at(weight, joint.skin_coord_index, joint.skin_coord_weight)
        total = weight[triangles].sum(axis=1)
        better = total > best + 1e-12
        best[better], owner[better] = total[better], number
    return owner


def _holders(humanoid: Humanoid, joints: Collection[str] | None) -> list[int]:
    """For each joint the number of the joint that may own its triangles: itself, or its nearest listed ancestor."""
    every = humanoid.joints()
    number = {id(j): n for n, j in enumerate(every)}
    out = list(range(len(every)))
    if joints is None:
        return out
    for n, joint in enumerate(every):
        for child in joint.joints:
            if child.name not in joints:
                out[number[id(child)]] = out[n]
    return out


def segment(humanoid: Humanoid, *, joints: Collection[str] | None = None) -> Humanoid:
    """A copy whose skin is cut into Segments: nothing is drawn by `skin` any more, everything by its joints.

    Segments of one joint share one array of points, each skin point once; normals are those of the whole skin. What
    the pieces need to bend like the skin stays: `skin_coord`, the weights of the joints, and `Shape.skin_index`; so
    `weld` gives the skin back, `pack` deforms the pieces as one, and `patches` says what to recompute. Displacers of
    joints move to the Segments that hold their points. `joints` names those that get Segments (default all).
    A humanoid without joints loses its skin. Indices are into `skin_coord`; metres, humanoid space.
    """
    out = replace(humanoid.copied(), skin=[], skin_normal=None)
    if out.skeleton:
        _cut(humanoid, out.joints(), joints)
    return out.settled()


def _cut(humanoid: Humanoid, joints: list[Joint], listed: Collection[str] | None) -> None:
    """Hang the pieces of the skin on copies of its joints, in tree order."""
    moving = [s for s in humanoid.skin if s.points is None]
    for shape in humanoid.skin:  # geometry beside the skin that nothing moves
        if shape.points is not None:
            _segment_of(joints[0]).shapes.append(replace(shape))
    if not moving:
        return
    triangles = np.concatenate([s.triangles for s in moving])
    owner = triangle_joints(humanoid, triangles, listed)
    normals, corners = _normals(humanoid, moving, triangles)
    first = np.cumsum([0, *(len(s.triangles) for s in moving)])
    moved = [(j, d) for j in joints for d in j.displacers]
    for joint in joints:
        joint.displacers = []
    for number in np.unique(owner):
        rows = np.unique(triangles[owner == number]).astype(np.int32)
        points = humanoid.skin_coord[rows]
        here = [d for _, d in moved if np.isin(d.coord_index, rows).any()]
        home = _segment_of(joints[number], apart=bool(here))
        home.displacers = home.displacers + [_displacer(d, rows) for d in here]
        soft = normals[rows] if corners is None else None
        for shape, a, b in zip(moving, first, first[1:]):
            mine = owner[a:b] == number
            if not mine.any():
                continue
            piece = _piece(shape, mine, rows, points, joints[number].name)
            if corners is None:
                piece.normals = soft
            else:
                used, local = np.unique(corners[a:b][mine], return_inverse=True)
                piece.normals, piece.normal_triangles = normals[used], local.reshape(-1, 3).astype(np.int32)
            home.shapes.append(piece)


def _normals(humanoid: Humanoid, moving: list[Shape], triangles: Ints) -> tuple[NDArray[np.float64], Ints | None]:
    """Of the whole skin: the file's own where it has one per point, else from all its faces."""
    given = humanoid.skin_normal
    if given is not None and len(given) == len(humanoid.skin_coord):
        return given, None
    crease = np.repeat([s.crease_angle for s in moving], [len(s.triangles) for s in moving])
    return corner_normals(humanoid.skin_coord, triangles, crease)


def _piece(shape: Shape, mine: NDArray[np.bool_], rows: Ints, points: NDArray[np.float64], joint: str) -> Shape:
    """The triangles `mine` of a skin shape over the Segment's points, which copy the skin points `rows`."""
    uv_triangles = shape.triangles if shape.uv_triangles is None else shape.uv_triangles
    return replace(
        shape,
        name=f"{shape.name}_{joint}" if shape.name else "",
        points=points,
        triangles=np.searchsorted(rows, shape.triangles[mine]).astype(np.int32),
        uv_triangles=None if shape.uv is None else uv_triangles[mine],
        colors=None if shape.colors is None else shape.colors[rows],
        skin_index=rows,
        faces=None if shape.faces is None else shape.faces[mine],
        transform=None,
    )


def _displacer(whole: Displacer, rows: Ints) -> Displacer:
    """What a displacer of the skin does to a Segment's points."""
    here = np.isin(whole.coord_index, rows)
    local = np.searchsorted(rows, whole.coord_index[here]).astype(np.int32)
    return replace(whole, coord_index=local, displacements=whole.displacements[here], node=None)


def _segment_of(joint: Joint, apart: bool = False) -> Segment:
    """The joint's first segment, made when it has none.

    Displacers index the first shape of their segment: with `apart`, one that has geometry already gets a neighbour.
    """
    if joint.segments:
        first = joint.segments[0]
        if first.shapes and (apart or first.displacers):
            joint.segments.insert(1, Segment(f"{first.name}_skin"))
            return joint.segments[1]
    else:
        known = tables.canonical(joint.name)
        name = tables.joints()[known].segment if known else f"{joint.name}_segment"
        older = known is not None and known != joint.name
        joint.segments.append(Segment((tables.name_in(name, "1.1", "segment") if older else None) or name))
    return joint.segments[0]


def patches(humanoid: Humanoid) -> list[Patch]:
    """One entry per Segment that was cut out of the skin, in tree order; see `segment`."""
    joints = humanoid.joints()
    total = np.zeros(len(humanoid.skin_coord))
    for joint in joints:
        np.add.at(total, joint.skin_coord_index, joint.skin_coord_weight)
    out = []
    for joint in joints:
        own = np.zeros(len(total))
        np.add.at(own, joint.skin_coord_index, joint.skin_coord_weight)
        for home in joint.segments:
            index = next((s.skin_index for s in home.shapes if s.skin_index is not None), None)
            if index is None:
                continue
            alone = (np.abs(own[index] - total[index]) < 1e-9) & (np.abs(total[index] - 1) < 1e-6)
            rigid, deformed = (np.flatnonzero(k).astype(np.int32) for k in (alone, ~alone))
            out.append(Patch(joint.name, home.name, index, rigid, deformed))
    return out
