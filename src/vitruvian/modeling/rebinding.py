"""A fitted surface back in the dress pose: the built-in person with new points, or another body with new points.

Source: seed 003, section 3.2 (attachment data after the shape has changed); note body.md, section 3, step 6.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from vitruvian.body import rotations as rot
from vitruvian.body.pack import pack
from vitruvian.body.types import Body, Floats
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.modeling import anatomy, source
from vitruvian.modeling import bones as bo
from vitruvian.modeling.bones import Bones
from vitruvian.modeling.likeness import shape_of
from vitruvian.modeling.person import assemble, figure, parents_matrix, resting, weight_matrix
from vitruvian.modeling.shape import shaped
from vitruvian.modeling.template import Template
from vitruvian.modeling.transfer import dressed
from vitruvian.motion.types import Motion

NEAR = 12


@cache
def _followers() -> Any:
    """(19158, 13380) sparse: the body points whose offsets each point of the source takes: itself, the nearest for what
    lies over or under the skin, one mean for each eyeball and for what is in the mouth."""
    from scipy.sparse import csr_matrix
    from scipy.spatial import cKDTree

    from vitruvian.modeling.look import mask

    points = source.points()[: source.POINTS]
    body = points[: source.BODY]
    outside = np.flatnonzero(mask("inside-mouth") < 0.1)
    distance, near = cKDTree(body[outside]).query(points[source.BODY :], k=NEAR)
    share = 1 / (distance + 0.004) ** 2
    share /= share.sum(axis=1, keepdims=True)
    row = np.repeat(np.arange(source.BODY, source.POINTS), NEAR)
    column, value = outside[near].ravel(), share.ravel()
    solid = np.zeros(source.POINTS, bool)
    lips, lids = np.flatnonzero(mask("lips") > 0.5), np.flatnonzero(mask("eyelids") > 0.5)
    left = lids[body[lids, 0] > 0]
    right = lids[body[lids, 0] < 0]
    half = (source.EYES.start + source.EYES.stop) // 2
    groups = [(range(source.EYES.start, half), left), (range(half, source.EYES.stop), right)]
    groups += [(range(s.start, s.stop), lips) for s in (source.TEETH, source.TONGUE)]
    rows, columns, values = [], [], []
    for some, held in groups:
        some = np.asarray(some)
        solid[some] = True
        rows.append(np.repeat(some, len(held)))
        columns.append(np.tile(held, len(some)))
        values.append(np.full(len(some) * len(held), 1 / len(held)))
    keep = ~solid[row]
    own = np.arange(source.BODY)
    every = lambda a, b, c: np.concatenate([a, b, *c])  # noqa: E731
    return csr_matrix(
        (
            every(np.ones(source.BODY), value[keep], values),
            (every(own, row[keep], rows), every(own, column[keep], columns)),
        ),
        (source.POINTS, source.BODY),
    )


def rested_person(
    template: Template,
    bones: Bones,
    values: Floats | None,
    points: Floats,
    to_scan: Floats,
    *,
    name: str,
    loa: int,
    look: dict[str, Any],
) -> tuple[Humanoid, Motion, Body]:
    """The built-in person whose skin lies at `points` (13380,3), upright, in the pose of its bones."""
    assert values is not None
    sliders = shape_of(values)
    full = shaped(sliders)
    centers = anatomy.centers(full)
    frame = bo.posed(template.parents, centers, template.axes, bones)
    straight = bo.posed(template.parents, centers, template.axes, replace(bones, turn=np.zeros_like(bones.turn)))
    scaled = straight.matrices(centers)
    model, linear = bo.skinned(full[: source.BODY], template.weights, frame.matrices(centers))
    # offsets in the A pose: those on the scan, turned and stretched back
    rigid = frame.turn @ np.linalg.inv(straight.turn)
    _, turned = bo.skinned(full[: source.BODY], template.weights, _with(rigid))
    offset = np.linalg.solve(turned, (points - model)[..., None])[..., 0]
    weights = _source_weights()
    flesh = bo.skinned(full[: source.POINTS], weights, scaled)[0] + _followers() @ offset
    places = {n: i for i, n in enumerate(anatomy.names())}
    ends = {n: scaled[places[n], :3, :3] @ p + scaled[places[n], :3, 3] for n, p in anatomy.ends(full).items()}
    assembly = assemble(np.concatenate([flesh, full[source.POINTS :]]), sliders, **look)
    where, middle, moved_ends, rest = resting(assembly, straight.place, ends)
    # the pose: from rest to the scan
    turns = frame.turn @ rest[:, :3, :3].transpose(0, 2, 1)
    matrices = np.tile(np.eye(4), (len(turns), 1, 1))
    matrices[:, :3, :3] = turns
    matrices[:, :3, 3] = frame.place - np.einsum("jab,jb->ja", turns, middle)
    humanoid = figure(sliders, assembly, where, middle, moved_ends, loa=4, name=name)
    body = pack(humanoid)
    names = list(body.skeleton.names)
    order = [places[n] for n in names]
    here = matrices[order]
    target = body.skin.rest.copy()
    target[: source.BODY] = points
    fresh = dressed(body, target, here)[: source.BODY]
    change = fresh - where[: source.BODY]
    where = where + parents_matrix(assembly.keys) @ (_followers() @ change)
    humanoid = figure(sliders, assembly, where, middle, moved_ends, loa=loa, name=name)
    body = pack(humanoid)
    return humanoid, pose_of(body, {n: to_scan @ matrices[places[n]] for n in body.skeleton.names}), body


def pose_of(body: Body, matrices: dict[str, Floats]) -> Motion:
    """One frame with these matrices (4,4) of joints."""
    skeleton = body.skeleton
    turn = np.array([matrices[n][:3, :3] for n in skeleton.names])
    local = turn.copy()
    for j, p in enumerate(skeleton.parents):
        if p >= 0:
            local[j] = turn[p].T @ turn[j]
    first = matrices[skeleton.names[0]]
    center = skeleton.centers[0]
    shift = first[:3, :3] @ center + first[:3, 3] - center
    return Motion(skeleton, 30.0, rot.from_matrix(local)[None], shift[None], name="scan")


def _with(turn: Floats) -> Floats:
    out = np.tile(np.eye(4), (len(turn), 1, 1))
    out[:, :3, :3] = turn
    return out


@cache
def _source_weights() -> Any:
    """(19158,146) weights of the source's points."""
    from vitruvian.modeling.template import normalised

    return normalised(weight_matrix())
