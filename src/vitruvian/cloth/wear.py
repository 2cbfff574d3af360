"""A garment prepared for a body: sorted into layers, and bound to the skin that a deformer moves.

Source: seed 003, sections 5.2 and 5.3.1; note cloth.md, section 6.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.rotations import between as turn_between
from vitruvian.body.rotations import from_matrix, from_vector, slerp
from vitruvian.body.types import Floats, Ints, Skeleton
from vitruvian.cloth.binding import Binding, bind, feet
from vitruvian.cloth.garment import Garment, Hung
from vitruvian.cloth.layers import Anatomy, anatomy, sort
from vitruvian.cloth.moving import Passing, Skin
from vitruvian.cloth.pinching import pinched
from vitruvian.cloth.placing import LEGS, largest
from vitruvian.cloth.sheet import joined
from vitruvian.cloth.solver import assemble, step
from vitruvian.cloth.worn import Now, Worn, begun, made, moved
from vitruvian.deform.deformer import Deformer

FORK = ("l_hip", "r_hip")
ARMS = np.radians(20.0)  # beside the trunk, where cloth is bound
LOWERING, SETTLING = 90, 45  # frames from the pose that a garment was draped in to that, and at rest there
ARM = ("upper_arm", "forearm", "hand")
LEAST, BESIDE = 0.003, 0.03  # metres: between cloths and skin; from the feet of cloth below to what is over it
ENTRY = 40  # frames from the pose that a garment was draped in to the first that is shown
# Poses in which it is seen what cloth stays with: joints and their rotation vectors, radians; l_ stands for both sides,
# mirrored, and what is named by its side is for that side alone
Pose = Mapping[str, tuple[float, float, float]]
TRAINING: tuple[Pose, ...] = (
    {"*_shoulder": (0, 0, -0.1)},
    {"*_shoulder": (-1.3, 0, 0), "*_elbow": (-0.5, 0, 0)},
    {"*_shoulder": (0.5, 0, 0.1), "*_elbow": (-1.4, 0, 0)},
    {"*_shoulder": (0, 0, 1.3)},
    {"l_hip": (-0.6, 0, 0), "r_hip": (0.4, 0, 0), "r_knee": (0.5, 0, 0),
     "l_shoulder": (0.4, 0, 0.1), "r_shoulder": (-0.4, 0, -0.1)},
    {"r_hip": (-0.6, 0, 0), "l_hip": (0.4, 0, 0), "l_knee": (0.5, 0, 0),
     "r_shoulder": (0.4, 0, -0.1), "l_shoulder": (-0.4, 0, 0.1)},
    {"*_hip": (-1.3, 0, 0.1), "*_knee": (1.3, 0, 0)},
    {"*_hip": (0, 0, 0.5)},
    {"vl3": (0.3, 0, 0), "vt10": (0.3, 0, 0), "*_shoulder": (-0.4, 0, 0.2)},
    {"vl3": (0, 0.3, 0), "vt10": (0, 0.3, 0), "*_shoulder": (0, 0, 0.2)},
    {"vl3": (0, 0, 0.25), "vt10": (0, 0, 0.2), "*_shoulder": (0, 0, 0.2)},
)  # fmt: skip
# Poses in which, besides, it is seen what skin comes to face
FOLDING: tuple[Pose, ...] = (
    {"*_hip": (-1.7, 0, 0), "*_knee": (2.0, 0, 0), "*_shoulder": (0, 0, -0.15), "*_elbow": (-2.0, 0, 0)},
    {"*_hip": (-0.9, 0, 0), "*_knee": (1.0, 0, 0), "*_shoulder": (-0.5, 0, -0.1), "*_elbow": (-1.0, 0, 0)},
    {"*_hip": (0.2, 0, 0), "*_knee": (1.5, 0, 0), "vl3": (0.4, 0, 0), "vt10": (0.3, 0, 0)},
    {"*_hip": (-1.7, 0, 0), "*_knee": (1.0, 0, 0), "vl3": (0.5, 0, 0), "vt10": (0.4, 0, 0)},
    {"l_hip": (-0.5, 0, 0), "r_hip": (0.3, 0, 0), "l_knee": (0.6, 0, 0), "r_knee": (0.3, 0, 0)},
    {"r_hip": (-0.5, 0, 0), "l_hip": (0.3, 0, 0), "r_knee": (0.6, 0, 0), "l_knee": (0.3, 0, 0)},
    {"l_hip": (-1.3, 0.2, 0), "l_knee": (1.2, 0, 0), "vl3": (0.4, 0, 0), "vt10": (0.2, 0, 0)},
    {"r_hip": (-1.3, -0.2, 0), "r_knee": (1.2, 0, 0), "vl3": (0.4, 0, 0), "vt10": (0.2, 0, 0)},
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Wearer:
    """A body that a deformer moves, with the largest piece of its skin, triangles (t,3), and the regions (V,) of that."""

    run: Deformer
    skin: Skin
    known: Anatomy
    regions: Ints

    def at(self, matrices: Floats) -> tuple[Skin, Floats]:
        """The skin under joint matrices (J,4,4), and where the joints are, (J,3) metres."""
        return self.on(self.run(matrices)), self.joints(matrices)

    def on(self, points: NDArray[np.float32]) -> Skin:
        """The skin where its points are (V,3) metres."""
        return self.skin.at(points, self.run.normals(points))

    def joints(self, matrices: Floats) -> Floats:
        """(J,3) metres: where the joints are under their matrices (J,4,4)."""
        centers = self.run.body.skeleton.centers
        return np.einsum("jab,jb->ja", matrices[:, :3, :3], centers) + matrices[:, :3, 3]


@dataclass(frozen=True, eq=False)
class Prepared:
    """A garment with what is needed to wear it: `worn`, and how it hangs, x (n,3) metres, in the pose that it is bound in,
    of matrices (J,4,4)."""

    garment: Garment
    worn: Worn
    matrices: Floats
    x: Floats


def wearer(run: Deformer) -> Wearer:
    """What a body has to do with clothes."""
    body, known = run.body, anatomy(run.body.skeleton)
    rest = body.skin.rest.astype(np.float32)
    triangles = largest(body.skin.triangles, len(rest))
    regions = known.of(body)
    side = np.zeros(len(rest), np.int8)
    for k, name in enumerate(known.names):
        if name[2:] in ARM:
            side[regions == k] = 1 if name[0] == "l" else 2
    return Wearer(run, Skin(rest, run.rest_normals.astype(np.float32), triangles, side), known, regions)


def wear(
    garment: Garment,
    person: Wearer,
    *,
    edges: Mapping[str, tuple[float, float]] | None = None,
    painted: Mapping[int, int] | None = None,
    gap: float = 0.0,
    pose: Floats | None = None,
) -> tuple[Prepared, ...]:
    """A garment, after those that it is worn over, innermost first, ready to be worn in real time by the person that they
    were draped on.

    edges: region (see `vitruvian.cloth.layers.REGIONS`) -> metres from the skin up to which cloth is tight, and loose;
    painted: vertex of the garment -> layer, what a person decided; gap: metres that floating cloth keeps from itself, 0:
    passes through; pose (J,4,4): joint matrices that it is bound in, None: standing, see `stood`.
    """
    skeleton = person.run.body.skeleton
    matrices = stood(skeleton) if pose is None else pose
    skin, joints = person.at(matrices)
    trials, folds = cache(partial(_trials, person)), cache(partial(_trials, person, FOLDING))
    hips = [joints[skeleton.index[j], 1] for j in FORK if j in skeleton.index]
    garments, out = (*garment.below, garment), []
    inner: list[tuple[Floats, Floats]] = []  # of what is below: feet, and heights over the skin
    known = [g.hung for g in garments if g.hung is not None] if pose is None else []
    if len(known) < len(garments):
        known = []
    places = [k.x for k in known] or led(garments, person, matrices)
    for k, (own, x) in enumerate(zip(garments, places)):
        binding = _bound(skin, x, sides(person, own))
        foot = np.einsum("nk,nkx->nx", binding.share, skin.points[binding.triangles[binding.face]])
        mine = painted if own is garment else None
        if known and not edges and not mine:
            layer = known[k].layer
        else:
            trained = [(points, binding.at(points, normals)) for points, normals in trials()]
            layer = sort(
                binding, x, own.triangles, person.regions, person.known, trained, edges=edges,
                crotch=_crotch(skin, person) if hips else None, painted=mine,
            )  # fmt: skip
        regions = person.regions[binding.triangles[binding.face, binding.share.argmax(axis=1)]]
        least = _raised(foot, inner)
        close = pinched(
            skin, person.regions, binding.triangles[binding.face], binding.share,
            [(binding.at(*there), *there) for there in (*trials(), *folds())],
        )  # fmt: skip
        worn = made(
            own.sheet, x, binding, layer, regions, person.known.bones, skin, joints, least, close=close, gap=gap
        )
        out.append(Prepared(own, worn, matrices, x))
        inner.append((foot, binding.offset[:, 2]))
    return tuple(out)


def hung(prepared: Sequence[Prepared]) -> Garment:
    """The garment that was prepared, and those below it, with what there was to find out for that: `wear` on the same body
    then takes a moment."""
    *below, own = (replace(p.garment, hung=Hung(p.x, p.worn.layer)) for p in prepared)
    return replace(own, below=tuple(below))


def _trials(person: Wearer, poses: Sequence[Pose] = TRAINING) -> list[tuple[Floats, Floats]]:
    """Points and normals (V,3) of the skin in each of some poses."""
    there = [person.at(m)[0] for m in training(person.run.body.skeleton, poses)]
    return [(s.points.astype(np.float64), s.normals.astype(np.float64)) for s in there]


def _raised(foot: Floats, inner: Sequence[tuple[Floats, Floats]]) -> Floats:
    """(n,) metres from the skin that cloth with feet (n,3) keeps at least, for what is worn below it there."""
    from scipy.spatial import cKDTree

    out = np.full(len(foot), LEAST)
    for feet_below, heights in inner:
        far, near = cKDTree(feet_below).query(foot)
        out = np.where(far < BESIDE, np.maximum(out, heights[near] + LEAST), out)
    return out


def sides(person: Wearer, garment: Garment) -> Ints:
    """(n,) what each vertex of a garment is about: 1 the left arm, 2 the right one, 0 the rest of the body. Seen in the
    pose that it was draped in, with the arms away from the trunk."""
    skin = person.at(garment.matrices)[0]
    face = feet(skin.points.astype(np.float64), skin.triangles, garment.vertices)[0]
    return skin.side[skin.triangles[face, 0]]


def _bound(skin: Skin, x: Floats, side: Ints) -> Binding:
    """Cloth at x (n,3) bound to the part of the skin that it is about, `sides` (n,): beside the trunk, arms are as near to
    a shirt as its trunk is."""
    points, normals = skin.points.astype(np.float64), skin.normals.astype(np.float64)
    face, share, offset = np.zeros(len(x), np.int32), np.zeros((len(x), 3)), np.zeros((len(x), 3))
    of = skin.side[skin.triangles[:, 0]]
    for k in np.unique(side):
        some, own = side == k, np.flatnonzero(of == k)
        part = bind(points, skin.triangles[own], x[some], normals=normals)
        face[some], share[some], offset[some] = own[part.face], part.share, part.offset
    return Binding(skin.triangles, face, share, offset, np.ones(len(x), bool))


def stood(skeleton: Skeleton, *, arms: float = ARMS) -> Floats:
    """(J,4,4) matrices of the pose that cloth is bound in, in the middle of what people do: standing, with the arms so many
    radians beside the trunk."""
    rotation = np.tile([0.0, 0.0, 0.0, 1.0], (1, len(skeleton), 1))
    for side, sign in (("l", 1.0), ("r", -1.0)):
        shoulder, elbow = skeleton.index[f"{side}_shoulder"], skeleton.index[f"{side}_elbow"]
        bone = skeleton.centers[elbow] - skeleton.centers[shoulder]
        long = np.hypot(*bone[:2])
        down = np.array([sign * np.sin(arms) * long, -np.cos(arms) * long, bone[2]])
        rotation[0, shoulder] = turn_between(bone, down)
        if f"{side}_hip" in skeleton.index:
            rotation[0, skeleton.index[f"{side}_hip"]] = from_vector(np.array([0.0, 0.0, sign * LEGS]))
    return pose_matrices(skeleton, rotation, np.zeros((1, len(skeleton), 3)))[0]


def led(garments: Sequence[Garment], person: Wearer, matrices: Floats) -> list[Floats]:
    """(n,3) metres each: how garments over each other hang in a pose, led there from the one that they were draped in,
    whole and with contact between them."""
    skeleton, first = person.run.body.skeleton, garments[-1].matrices
    turn = matrices[0] @ np.linalg.inv(first[0])  # where it is to be, so that nothing is flung there
    start = turn @ first
    sheet, x = joined([g.sheet for g in garments]), np.concatenate([g.vertices for g in garments])
    cloth = assemble(sheet, gap=max(1e-3, *(f.thickness for f in sheet.fabrics)))
    state, before = cloth.state(x @ turn[:3, :3].T + turn[:3, 3]), person.at(start)[0]
    home = np.concatenate([sides(person, g) > 0 for g in garments])
    for k in range(1, LOWERING + SETTLING + 1):
        share = min(1.0, k / LOWERING)
        skin = person.at(between(skeleton, start, matrices, share * share * (3 - 2 * share)))[0]
        state = step(cloth, state, obstacle=Passing(skin, before, home), damping=2.0)
        before = skin
    ends = np.cumsum([0, *(len(g.vertices) for g in garments)])
    return [state.x[a:b].astype(np.float64) for a, b in zip(ends, ends[1:])]


def entered(prepared: Prepared, person: Wearer, matrices: Floats, *, frames: int = ENTRY) -> Now:
    """The garment on a body under joint matrices (J,4,4), led there from the pose that it is bound in."""
    skeleton = person.run.body.skeleton
    start = matrices[0] @ np.linalg.inv(prepared.matrices[0]) @ prepared.matrices  # as in `led`
    now = begun(prepared.worn, *person.at(start))
    for k in range(1, frames + 1):
        share = min(1.0, k / (0.75 * frames))
        there = between(skeleton, start, matrices, share * share * (3 - 2 * share))
        now = moved(prepared.worn, now, *person.at(there))
    return now


def between(skeleton: Skeleton, a: Floats, b: Floats, share: float) -> Floats:
    """(J,4,4) matrices of a pose between two, of matrices (J,4,4): each joint turned by a share of the way."""
    turns, roots = [], []
    for m in (a, b):
        above = np.where(skeleton.parents[:, None, None] < 0, np.eye(3), m[np.maximum(skeleton.parents, 0), :3, :3])
        turns.append(from_matrix(np.einsum("jba,jbc->jac", above, m[:, :3, :3])))
        roots.append(m[0, :3, 3] - skeleton.centers[0] + m[0, :3, :3] @ skeleton.centers[0])
    shift = np.zeros((1, len(skeleton), 3))
    shift[0, 0] = roots[0] + share * (roots[1] - roots[0])
    return pose_matrices(skeleton, slerp(turns[0], turns[1], share)[None], shift)[0]


def training(skeleton: Skeleton, poses: Sequence[Pose] = TRAINING) -> list[Floats]:
    """(J,4,4) matrices of each training pose, as far as a skeleton has the joints."""
    out = []
    for pose in poses:
        rotation = np.tile([0.0, 0.0, 0.0, 1.0], (1, len(skeleton), 1))
        for name, (x, y, z) in pose.items():
            for side, sign in (("l", 1.0), ("r", -1.0)) if name.startswith("*") else (("", 1.0),):
                joint = skeleton.index.get(side + name.removeprefix("*"))
                if joint is not None:
                    rotation[0, joint] = from_vector(np.array([x, sign * y, sign * z]))
        out.append(pose_matrices(skeleton, rotation, np.zeros((1, len(skeleton), 3)))[0])
    return out


def _crotch(skin: Skin, person: Wearer) -> float:
    """Height where the legs part, metres: the lowest of the trunk."""
    used = np.zeros(len(person.regions), bool)
    used[skin.triangles.ravel()] = True
    return float(skin.points[(person.regions == 0) & used, 1].min())
