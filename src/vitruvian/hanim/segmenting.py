"""A seamless skin cut into the Segments of its joints, for versions of the standard that know no skin.

Source: the Body Manager's export: each triangle goes to the joint of greatest weight, border points are copied.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.hanim import tables
from vitruvian.hanim.humanoid import Humanoid, Joint, Segment


def triangle_joints(humanoid: Humanoid, triangles: NDArray[np.int32]) -> NDArray[np.int64]:
    """(t,) number of the joint, in tree order, that each triangle of the skin follows.

    Weights of the three corners are summed per joint; the largest wins, ties go to the earlier joint; triangles without
    any weight follow the root.
    """
    best = np.zeros(len(triangles))
    owner = np.zeros(len(triangles), np.int64)
    weight = np.zeros(len(humanoid.skin_coord))
    for number, joint in enumerate(humanoid.joints()):
        if not len(joint.skin_coord_index):
            continue
        weight[:] = 0
        np.add.at(weight, joint.skin_coord_index, joint.skin_coord_weight)
        total = weight[triangles].sum(axis=1)
        better = total > best + 1e-12
        best[better], owner[better] = total[better], number
    return owner


def segmented(humanoid: Humanoid) -> Humanoid:
    """A copy without skin: its triangles are Segment geometry, in humanoid space, each point once per segment.

    Without a joint there is nothing to hang it on: the skin is dropped.
    """
    copies: dict[int, Joint] = {}
    for joint in humanoid.joints():
        copies[id(joint)] = replace(
            joint,
            segments=list(joint.segments),
            joints=[],
            displacers=[],
            skin_coord_index=np.zeros(0, np.int32),
            skin_coord_weight=np.zeros(0),
        )
    for joint in humanoid.joints():
        copies[id(joint)].joints = [copies[id(j)] for j in joint.joints]
    joints = [copies[id(j)] for j in humanoid.joints()]
    for shape in humanoid.skin if joints else []:
        owner = triangle_joints(humanoid, shape.triangles)
        source = humanoid.skin_coord if shape.points is None else shape.points
        if shape.points is not None:
            owner[:] = 0
        uv_triangles = shape.triangles if shape.uv_triangles is None else shape.uv_triangles
        for number in np.unique(owner):
            mine = owner == number
            used, local = np.unique(shape.triangles[mine], return_inverse=True)
            piece = replace(
                shape,
                name=f"{shape.name}_{joints[number].name}" if shape.name else "",
                points=source[used],
                triangles=local.reshape(-1, 3).astype(np.int32),
                uv_triangles=None if shape.uv is None else uv_triangles[mine],
                colors=None if shape.colors is None else shape.colors[used],
            )
            _segment_of(joints[number]).shapes.append(piece)
    return replace(
        humanoid,
        skeleton=[copies[id(j)] for j in humanoid.skeleton],
        skin=[],
        skin_coord=np.zeros((0, 3)),
        skin_normal=None,
    )


def _segment_of(joint: Joint) -> Segment:
    """The joint's first segment as a copy that may be added to, made when it has none."""
    if joint.segments:
        first = joint.segments[0]
        joint.segments[0] = replace(first, shapes=list(first.shapes))
    else:
        known = tables.canonical(joint.name)
        name = tables.joints()[known].segment if known else f"{joint.name}_segment"
        joint.segments.append(Segment(tables.name_in(name, "1.1", "segment") or name))
    return joint.segments[0]
