"""A fitted surface back in the dress pose: the built-in person with new points, or another body with new points.

Source: seed 003, section 3.2 (attachment data after the shape has changed); note body.md, section 3, step 6.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from vitruvian.body import rotations as rot
from vitruvian.body.pack import pack
from vitruvian.body.types import Body, Floats, Ints, Weights, floats
from vitruvian.hanim.humanoid import Displacer, Humanoid, Site
from vitruvian.modeling import anatomy, source
from vitruvian.modeling import bones as bo
from vitruvian.modeling.bones import Bones
from vitruvian.modeling.crossings import crossings, uncrossed
from vitruvian.modeling.likeness import shape_of
from vitruvian.modeling.person import Assembly, assemble, figure, parents_matrix, resting, weight_matrix
from vitruvian.modeling.recentring import recentred
from vitruvian.modeling.rest import at_rest
from vitruvian.modeling.shape import Shape, shaped
from vitruvian.modeling.template import Template
from vitruvian.modeling.transfer import dressed
from vitruvian.motion.types import Motion

NEAR = 12
CLEARANCES = (0.025, 0.06)  # metres
ARMS = ("elbow", "carpal", "carpo")


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
    for part, held in groups:
        some = np.asarray(part)
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
    points: Floats,
    to_scan: Floats,
    values: Floats,
    *,
    name: str,
    loa: int,
    look: dict[str, Any],
) -> tuple[Humanoid, Motion]:
    """The built-in person whose skin lies at `points` (13380,3), upright, in the pose of its bones."""
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
    offset = floats(np.linalg.solve(turned, (points - model)[..., None])[..., 0], "offsets", None, 3)
    weights = _source_weights()
    flesh = bo.skinned(full[: source.POINTS], weights, scaled)[0] + _followers() @ offset
    model = bo.skinned(full[: source.BODY], template.weights, scaled)[0]
    here, away = recentred(template, values, model, offset, straight.place, frame)
    middle, frame = straight.place + here, replace(frame, place=frame.place + away)
    places = {n: i for i, n in enumerate(anatomy.names())}
    ends = {
        n: scaled[places[n], :3, :3] @ p + scaled[places[n], :3, 3] + here[places[n]]
        for n, p in anatomy.ends(full).items()
    }
    assembly = assemble(np.concatenate([flesh, full[source.POINTS :]]), sliders, **look)
    args = (template, frame, assembly, middle, ends, sliders, points, name)
    best = _laid(*args, 0.0)
    for clearance in CLEARANCES:  # arms that touch the trunk are let go of
        if best.touching:
            best = min(best, _laid(*args, clearance), key=lambda tried: tried.touching)
    where, matrices = best.where, best.matrices
    plain = at_rest(middle, model, _whole(template), best.rest)[0]
    fresh = uncrossed(plain, best.fresh, template.triangles, template.stiff > 0.3)
    change = fresh - where[: source.BODY]
    where = where + parents_matrix(assembly.keys) @ (_followers() @ change)
    humanoid = figure(sliders, assembly, where, best.middle, best.ends, loa=loa, name=name)
    body = pack(humanoid)
    return humanoid, pose_of(body, {n: to_scan @ matrices[places[n]] for n in body.skeleton.names})


@dataclass(frozen=True, eq=False)
class _Laid:
    """A person at rest: `where` (n,3) the points as the sliders have them, `fresh` (13380,3) the fitted skin, `middle`
    (146,3) joint centres and `ends` of bones, `matrices` (146,4,4) from rest to the scan and `rest` (146,4,4) from the A
    pose to rest; `touching`: how many pairs of triangles of forearms or hands and of something else cross."""

    where: Floats
    fresh: Floats
    middle: Floats
    ends: dict[str, Floats]
    matrices: Floats
    rest: Floats
    touching: int


def _laid(
    template: Template,
    frame: bo.Frame,
    assembly: Assembly,
    centers: Floats,
    ends: dict[str, Floats],
    sliders: Shape,
    points: Floats,
    name: str,
    clearance: float,
) -> _Laid:
    """The person at rest, its hands that much (m) farther from the hips than usual."""
    where, middle, moved_ends, rest = resting(assembly, centers, ends, clearance)
    # the pose: from rest to the scan
    turns = frame.turn @ rest[:, :3, :3].transpose(0, 2, 1)
    matrices = np.tile(np.eye(4), (len(turns), 1, 1))
    matrices[:, :3, :3] = turns
    matrices[:, :3, 3] = frame.place - np.einsum("jab,jb->ja", turns, middle)
    body = pack(figure(sliders, assembly, where, middle, moved_ends, loa=4, name=name))
    places = {n: i for i, n in enumerate(anatomy.names())}
    target = body.skin.rest.copy()
    target[: source.BODY] = points
    fresh = dressed(body, target, matrices[[places[n] for n in body.skeleton.names]])[: source.BODY]
    arms = template.weights @ np.array([any(w in n for w in ARMS) for n in template.names], np.float64) > 0.5
    touching = _mixed(crossings(fresh, template.triangles), arms[template.triangles])
    return _Laid(where, fresh, middle, moved_ends, matrices, rest, touching)


def _mixed(pairs: Ints, arms: Any) -> int:
    """How many pairs (n,2) of triangles are one of the arms and one of the rest; arms (t,3) of their corners."""
    one, two = arms[pairs[:, 0]].all(axis=1), arms[pairs[:, 1]].all(axis=1)
    return int((one != two).sum())


def rested_body(
    humanoid: Humanoid, template: Template, bones: Bones, points: Floats, to_scan: Floats, *, name: str
) -> tuple[Humanoid, Motion]:
    """A copy of a humanoid at rest, sized and shaped so that its surface lies at `points` (V,3), upright, in the pose of
    its bones.

    Segment geometry, Sites and displacers are scaled with their bones; those on the skin follow it. What the humanoid
    was made from, its clips and masses are forgotten: they were those of another body.
    """
    from scipy.spatial import cKDTree

    body = pack(humanoid)
    plain = replace(body.skeleton, binding=None)
    centers = template.centers
    frame = bo.posed(template.parents, centers, template.axes, bones)
    straight = bo.posed(template.parents, centers, template.axes, replace(bones, turn=np.zeros_like(bones.turn)))
    scaled = straight.matrices(centers)
    size, stretch = bo.skinned(template.points, template.weights, scaled)
    sized = replace(
        body,
        skeleton=replace(plain, centers=straight.place),
        skin=replace(body.skin, rest=size, morphs=(), weights=_whole(template)),
        contours=(),
    )
    rigid = _with(frame.turn)
    rigid[:, :3, 3] = frame.place - np.einsum("jab,jb->ja", frame.turn, straight.place)
    rest = dressed(sized, points, rigid)
    down = np.array([0.0, -rest[:, 1].min(), 0.0])
    tree, moved = cKDTree(template.points), rest - size
    out = humanoid.copied()
    count = len(humanoid.skin_coord)
    every = list({id(j): j for j in out.joints()}.values())
    place = {n: i for i, n in enumerate(plain.names)}

    def carried(p: Floats, j: int) -> Floats:
        near, index = tree.query(p, k=min(6, len(moved)))
        share = 1 / (near + 1e-4)
        along = (moved[index] * (share / share.sum(axis=-1, keepdims=True))[..., None]).sum(axis=-2)
        fade = np.clip(2 - near.min(axis=-1) / 0.02, 0, 1)  # what is deep inside goes with its bone
        return p @ scaled[j, :3, :3].T + scaled[j, :3, 3] + fade[..., None] * along + down

    for joint in every:
        j = place[joint.name]
        joint.center = straight.place[j] + down
        joint.translation, joint.rotation = np.zeros(3), np.array([0.0, 0.0, 1.0, 0.0])
        joint.sites = [_site(s, carried(s.center + s.translation, j)) for s in joint.sites]
        joint.displacers = [_grown(d, stretch, count) for d in joint.displacers]
        for segment in joint.segments:
            segment.sites = [_site(s, carried(s.center + s.translation, j)) for s in segment.sites]
            segment.shapes = [
                s
                if s.points is None
                else replace(s, points=carried(s.points, j), normals=None, normal_triangles=None, node=None)
                for s in segment.shapes
                if s.transform is None
            ] + [s for s in segment.shapes if s.transform is not None]
            segment.mass, segment.center_of_mass = 0.0, np.zeros(3)
            segment.moments_of_inertia = np.zeros(9)
    coordinates = (rest[:count] + down) if len(rest) >= count else humanoid.skin_coord
    made = replace(
        out, name=name, skin_coord=coordinates, skin_normal=None, binding={}, motions=[], tracks=[], made_from=None
    ).settled()
    fresh = pack(made)
    rigid[:, :3, 3] = frame.place - np.einsum("jab,jb->ja", frame.turn, straight.place + down)
    return made, pose_of(fresh, {n: to_scan @ rigid[place[n]] for n in fresh.skeleton.names})


def _site(site: Site, where: Floats) -> Site:
    return replace(site, translation=where - site.center, node=None)


def _grown(d: Displacer, stretch: Floats, count: int) -> Displacer:
    """A displacer whose moves have grown with the flesh."""
    index = d.coord_index
    if not len(index) or int(index.max()) >= min(count, len(stretch)) or len(d.displacements) != len(index):
        return d
    return replace(d, displacements=np.einsum("nab,nb->na", stretch[index], d.displacements))


def _whole(template: Template) -> Weights:
    """A template's weights, which sum to one."""
    rows = template.weights.tocsr()
    rows.sort_indices()
    return Weights(rows.indptr, rows.indices, rows.data)


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
