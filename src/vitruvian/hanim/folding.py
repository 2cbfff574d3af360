"""One joint folded into another: what hangs on it, moves with it and is moved by it finds a new place there."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.hanim.humanoid import Joint, Segment, Shape
from vitruvian.hanim.normals import turned


def stand_in(name: str, kept: Container[str]) -> str | None:
    """The joint, not an ancestor, that does for a folded one at lower levels, if it is `kept`; all are 2.0 names.

    Feet of levels below 4 have the second ray only: its ball moves all toes, and its metatarsal the others.
    """
    for part, ball in (("tarsometatarsal_", ""), ("metatarsophalangeal_", ""), ("tarsal_", "metatarsophalangeal_2")):
        if name[:2] in ("l_", "r_") and name[2:].startswith(part):
            other = f"{name[:2]}{ball or part + '2'}"
            return other if other != name and other in kept else None
    return None


def fold(joint: Joint, into: Joint, lost: list[str]) -> None:
    """Give everything of `joint` but its own joints to `into`, which is changed; what can't go there is told in `lost`.

    Geometry and sites keep their places (humanoid space), weights of a skin point add up, masses add up with their
    centre and inertia (parallel axes), displacers keep their points.
    """
    if joint.rotation[3] != 0 or joint.translation.any() or (joint.scale != 1).any():
        lost.append(f"the rest transform of joint {joint.name}, folded into {into.name}")
    for segment in joint.segments:
        if not into.segments:
            into.segments.append(Segment(name=f"{into.name}_segment"))
        _fold_segment(segment, into.segments[0])
    into.sites = [*into.sites, *joint.sites]
    into.displacers = [*into.displacers, *joint.displacers]
    index = np.concatenate([into.skin_coord_index, joint.skin_coord_index]).astype(np.int32)
    weight = np.concatenate([into.skin_coord_weight, joint.skin_coord_weight])
    into.skin_coord_index, where = np.unique(index, return_inverse=True)
    into.skin_coord_weight = np.bincount(where, weight, minlength=len(into.skin_coord_index)).astype(np.float64)


def _fold_segment(segment: Segment, target: Segment) -> None:
    if segment.displacers or (target.displacers and segment.shapes):
        shapes, starts = _one_list([target.shapes, segment.shapes])
        moved = []
        for displacers, models, start in zip((target.displacers, segment.displacers), (target, segment), starts):
            model = next((s for s in models.shapes if s.points is not None), None)
            turn = np.eye(3) if model is None or model.transform is None else model.transform[:3, :3]
            for d in displacers:
                index = (d.coord_index + start).astype(np.int32)
                moved.append(replace(d, coord_index=index, displacements=d.displacements @ turn.T, node=None))
        target.shapes, target.displacers = shapes, moved
    else:
        target.shapes = [*target.shapes, *segment.shapes]
    target.contours = [*target.contours, *segment.contours]
    target.sites = [*target.sites, *segment.sites]
    mass = target.mass + segment.mass
    if mass:
        center = (target.mass * target.center_of_mass + segment.mass * segment.center_of_mass) / mass
        inertia = np.zeros((3, 3))
        given = False
        for part in (target, segment):
            if part.moments_of_inertia.any():
                given = True
                r = part.center_of_mass - center
                inertia += part.moments_of_inertia.reshape(3, 3) + part.mass * (r @ r * np.eye(3) - np.outer(r, r))
        target.center_of_mass = center
        target.moments_of_inertia = inertia.reshape(9) if given else target.moments_of_inertia
    target.mass = mass


def _one_list(groups: Sequence[list[Shape]]) -> tuple[list[Shape], list[int]]:
    """Shapes over one list of points, their transforms baked, and where the first points of each group begin in it.

    Displacers index the points of a Segment's first shape: with one list for all, those of both stay right.
    """
    points: list[NDArray[np.float64]] = []
    place: dict[tuple[int, bytes], int] = {}
    count = 0
    found: list[tuple[Shape, int]] = []
    starts = []
    for group in groups:
        starts.append(count)
        for shape in group:
            if shape.points is None:
                found.append((shape, -1))
                continue
            key = (id(shape.points), b"" if shape.transform is None else shape.transform.tobytes())
            baked = turned(shape)
            assert baked.points is not None
            if key not in place:
                place[key] = count
                points.append(baked.points)
                count += len(baked.points)
            found.append((baked, place[key]))
    whole = np.concatenate([np.zeros((0, 3)), *points])
    return [s if at < 0 else _over(s, whole, at) for s, at in found], starts


def _over(shape: Shape, points: NDArray[np.float64], first: int) -> Shape:
    """A shape whose points now begin at `first` of longer `points`."""
    own = shape.triangles
    count = 0 if shape.points is None else len(shape.points)
    colors = None
    if shape.colors is not None:
        colors = np.full((len(points), 3), 0.8)
        colors[first : first + count] = shape.colors
    index = None
    if shape.skin_index is not None:
        index = np.zeros(len(points), np.int32)
        index[first : first + count] = shape.skin_index
    return replace(
        shape,
        points=points,
        triangles=(own + first).astype(np.int32),
        uv_triangles=own if shape.uv is not None and shape.uv_triangles is None else shape.uv_triangles,
        normal_triangles=own
        if shape.normals is not None and shape.normal_triangles is None
        else shape.normal_triangles,
        colors=colors,
        skin_index=index,
        node=None,
    )
