"""Levels of articulation and versions, downwards, with the motion: what folded joints did, their kept joints now do.

Every kept joint below a folded one keeps its place and turn in space exactly (by its rotation and translation). A kept
joint that others were folded into follows the chain: where all its skin moved as one, as one; where vertebrae moved
apart, as the rigid motion nearest to all of them, weighted by their skin. Branches that end (fingers into a wrist) don't
pull at it. Source: note hanim.md, section 4; the nearest rigid motion: W. Kabsch, "A solution for the best rotation to
relate two sets of vectors" (1976).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.pack import pack
from vitruvian.body.rotations import from_matrix, to_axis_angle, to_matrix
from vitruvian.body.types import Body, Floats, Ints, Skeleton
from vitruvian.hanim.convert import converted
from vitruvian.hanim.folding import stand_in
from vitruvian.hanim.humanoid import Humanoid, Joint
from vitruvian.hanim.tables import canonical
from vitruvian.motion.names import joint_index
from vitruvian.motion.takes import Take, carried, local_matrices
from vitruvian.motion.types import Motion

_FRAMES = 120  # of a clip that the report measures


def lowered(humanoid: Humanoid, version: str, *, loa: int | None = None) -> tuple[Humanoid, list[str], float]:
    """`converted` (version "2.0", "200x", "1.1" or "1.0", at most level `loa`) with rest pose and clips carried along.

    Answers the new humanoid, what was lost, and the largest distance in metres by which a vertex is off in any clip or
    at rest (linear skinning, up to 120 frames of each). Joints that no folded joint concerns keep their keys.
    """
    plain = humanoid.copied()
    rest: dict[str, Joint] = {}
    for joint in plain.joints():  # what converted would report as lost is carried below
        rest[joint.name] = replace(joint)
        joint.rotation, joint.translation = np.array([0.0, 0.0, 1.0, 0.0]), np.zeros(3)
    bare = replace(plain, tracks=[], motions=[])
    out, lost = converted(bare, version, loa=loa)
    renamed, _ = converted(replace(humanoid, skeleton=plain.skeleton), version, loa=loa)
    if len(out.joints()) == len(humanoid.joints()):
        for new, old in zip(out.joints(), humanoid.joints()):
            new.rotation, new.translation = old.rotation, old.translation
        return replace(out, motions=renamed.motions, tracks=renamed.tracks), lost, 0.0
    for joint in plain.joints():
        joint.rotation, joint.translation = rest[joint.name].rotation, rest[joint.name].translation
    body, goal = pack(plain), pack(out)
    fold = Folding(body, goal.skeleton)
    still = fold(Take(body.skeleton.rotation[None], body.skeleton.translation[None]))
    for j, joint in enumerate(out.joints()):
        if np.abs(still.translation[0, j]).max() > 1e-12:
            joint.translation = still.translation[0, j]
        if abs(still.rotation[0, j, 3]) < 1 - 1e-15:
            joint.rotation = to_axis_angle(still.rotation[0, j])
    goal = pack(out)
    fold = Folding(body, goal.skeleton)
    fold(Take(body.skeleton.rotation[None], body.skeleton.translation[None]))
    off = fold.worst
    out = carried(humanoid, body.skeleton, out, goal.skeleton, fold)
    sites = {s.name: t.name for s, t in zip(_places(humanoid), _places(renamed))}
    sites = {old: new for old, new in sites.items() if old not in goal.skeleton.index}
    out.tracks = [replace(t, target=sites.get(t.target, t.target)) for t in out.tracks]
    if fold.worst > 1e-6:
        where = "at rest" if off == fold.worst else "in motion"
        joints = ", ".join(fold.moved[:4]) + (", ..." if len(fold.moved) > 4 else "")
        lost.append(f"turns of {len(fold.moved)} folded joints ({joints}): the skin is {fold.worst:.4f} m off {where}")
    return out, lost, fold.worst


def _places(h: Humanoid) -> list:
    return [*h.all_sites(), *h.viewpoints]


def lowered_motion(motion: Motion, skeleton: Skeleton, *, body: Body | None = None) -> Motion:
    """The clip on a coarser skeleton of the same figure: its joints are joints of the clip, by name across versions.

    The joints kept below folded ones stay exactly where they were. With `body`, the clip's packed body, its weights
    decide what joints with folded ones do; without, they follow the chain of turns. Metres, humanoid space.
    """
    fold = Folding(body if body is not None else motion.skeleton, skeleton)
    shift = motion.joint_translation
    if shift is None:
        shift = np.repeat(motion.skeleton.translation[None], len(motion), axis=0)
        shift[:, 0] = motion.translation
    take = fold(Take(motion.rotation, shift))
    still = np.abs(take.translation[:, 1:] - skeleton.translation[1:]).max(initial=0.0) < 1e-9
    return replace(
        motion,
        skeleton=skeleton,
        rotation=take.rotation,
        translation=take.translation[:, 0],
        joint_translation=None if still else take.translation,
    )


@dataclass(eq=False)
class _Sums:
    """Second moments of the skin of each joint, (J,4,4) of homogeneous rest points, and its weight (J,)."""

    moments: Floats
    weight: Floats


class Folding:
    """Takes of a figure to takes of the same figure with fewer joints; `worst` is how far a vertex was off so far (m).

    `figure` is a packed body, or a skeleton alone.
    """

    def __init__(self, figure: Body | Skeleton, target: Skeleton):
        self.body = figure if isinstance(figure, Body) else None
        self.source = figure.skeleton if isinstance(figure, Body) else figure
        self.target = target
        known = joint_index(target.names)
        self.kept = np.full(len(self.source), -1, np.int32)  # source joint -> target joint
        for i, name in enumerate(self.source.names):
            j = target.index.get(name)
            self.kept[i] = known.get(canonical(name) or "", -1) if j is None else j
        self.into = self._nearest()
        self.drivers = self._drivers()
        self.worst = 0.0
        self.moved: list[str] = []

    def _nearest(self) -> Ints:
        """(J,) the target joint that stands for each source joint, as `converted` folds them."""
        out = self.kept.copy()
        known = joint_index(self.target.names)
        for i, parent in enumerate(self.source.parents):
            if out[i] < 0:
                out[i] = out[parent] if parent >= 0 else 0
        for i, name in enumerate(self.source.names):
            other = stand_in(canonical(name) or "", known) if self.kept[i] < 0 else None
            out[i] = out[i] if other is None else known[other]
        return out

    def _drivers(self) -> dict[int, list[int]]:
        """Target joint -> the source joints that it follows; [itself] when nothing folded leads on.

        These are itself and the folded joints that lie on the way to every kept joint below. A joint without skin of
        its own whose folded joints have some follows all of those.
        """
        back = {int(j): i for i, j in enumerate(self.kept) if j >= 0}
        paths: dict[int, list[list[int]]] = {}
        for i in range(len(self.source)):
            if self.kept[i] < 0:
                continue
            path = []
            at = int(self.source.parents[i])
            while at >= 0 and self.kept[at] < 0:
                path.append(at)
                at = int(self.source.parents[at])
            if at >= 0 and path:
                paths.setdefault(int(self.kept[at]), []).append(path[::-1])
        out = {}
        for j, i in back.items():
            ways = paths.get(j, [])
            common = [level[0] for level in zip(*ways) if len(set(level)) == 1] if ways else []
            chain = [i, *common]
            whole = [k for k in range(len(self.source)) if self.into[k] == j]
            if self.body is not None and not self.sums.weight[chain].any() and self.sums.weight[whole].any():
                chain = whole
            out[j] = chain
        return out

    @cached_property
    def sums(self) -> _Sums:
        skin = self.body.skin if self.body is not None else None
        count = len(self.source)
        moments, weight = np.zeros((count, 4, 4)), np.zeros(count)
        if skin is not None and len(skin.weights.joint):
            w = skin.weights
            points = np.concatenate([skin.rest, np.ones((len(skin.rest), 1))], axis=1)[w.vertex]
            for a in range(4):
                for b in range(4):
                    product = w.weight * points[:, a] * points[:, b]
                    moments[:, a, b] = np.bincount(w.joint, product, minlength=count)
            weight = moments[:, 3, 3].copy()
        return _Sums(moments, weight)

    def __call__(self, take: Take) -> Take:
        """The take of the target's joints; measures how far the skin is off."""
        skeleton = replace(self.source, binding=None)
        old = pose_matrices(skeleton, take.rotation, take.translation)
        new = np.empty((len(old), len(self.target), 4, 4))
        for j, chain in self.drivers.items():
            new[:, j] = self._follow(old, chain)
        local = local_matrices(self.target, new)
        linear = local[..., :3, :3]
        if not (self.target.scale == 1).all():
            u, _, vt = np.linalg.svd(linear)
            rotation = from_matrix(u @ vt)
            turn = to_matrix(self.target.scale_orientation)
            stretch = np.einsum("jab,jb,jcb->jac", turn, self.target.scale, turn)
            linear = to_matrix(rotation) @ stretch
        else:
            rotation = from_matrix(linear)
        c = self.target.centers
        translation = local[..., :3, 3] - c + np.einsum("fjab,jb->fja", linear, c)
        self._measure(old, new)
        return Take(rotation, translation)

    def _follow(self, old: Floats, chain: list[int]) -> Floats:
        """(F,4,4) what a target joint does, given the source joints that it follows."""
        first = old[:, chain[0]]
        spread = max((np.abs(old[:, k] - first).max() for k in chain[1:]), default=0.0)
        if spread < 1e-12:
            return first
        weight = self.sums.weight[chain]
        if not weight.any():  # no skin: the turn of the whole chain, about the joint itself
            out = first.copy()
            out[:, :3, :3] = old[:, chain[-1], :3, :3]
            center = self.source.centers[chain[0]]
            moved = np.einsum("fab,b->fa", first[:, :3, :3], center) + first[:, :3, 3]
            out[:, :3, 3] = moved - np.einsum("fab,b->fa", out[:, :3, :3], center)
            return out
        alone = [k for k, w in zip(chain, weight) if w > 1e-9 * weight.sum()]
        if len(alone) == 1:
            return old[:, alone[0]]
        total = float(weight.sum())
        moments = self.sums.moments[chain]
        # a little of each joint's own frame, so that skin along a line leaves no turn open
        for n, k in enumerate(chain):
            moments[n] += 1e-6 * total * _frame_moments(self.source.centers[k])
        target = np.einsum("fjab,jbc->fac", old[:, chain, :3, :], moments)
        moments = moments.sum(axis=0)
        total = float(moments[3, 3])
        middle, moved = moments[:3, 3] / total, target[:, :, 3] / total
        cross = target[:, :, :3] - moved[:, :, None] * moments[:3, 3]
        u, _, vt = np.linalg.svd(cross)
        u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
        out = np.zeros((len(old), 4, 4))
        out[:, :3, :3] = u @ vt
        out[:, :3, 3] = moved - np.einsum("fab,b->fa", out[:, :3, :3], middle)
        out[:, 3, 3] = 1.0
        return out

    def _measure(self, old: Floats, new: Floats) -> None:
        """Note how far the skin is off and which folded joints turned."""
        chosen = np.unique(np.linspace(0, len(old) - 1, min(len(old), _FRAMES)).round().astype(int))
        wrong = old[:, :, :3, :] - new[:, self.into, :3, :]
        off = np.abs(wrong).max(axis=(0, 2, 3)) > 1e-9
        for i in np.flatnonzero(off & (self.kept < 0)):
            parent = self.source.parents[i]
            if parent < 0 or np.abs(old[:, i] - old[:, parent]).max() > 1e-9:
                name = self.source.names[i]
                self.moved += [name] if name not in self.moved else []
        if self.body is None or not off.any():
            return
        w, rest = self.body.skin.weights, self.body.skin.rest
        mine = off[w.joint]
        joint, weight, vertex = w.joint[mine], w.weight[mine], w.vertex[mine]
        points = rest[vertex]
        for f in chosen:
            d = np.einsum("nab,nb->na", wrong[f, joint, :, :3], points) + wrong[f, joint, :, 3]
            sums = [np.bincount(vertex, weight * d[:, k], minlength=len(rest)) for k in range(3)]
            self.worst = max(self.worst, float(np.sqrt(sum(s * s for s in sums)).max(initial=0.0)))


def _frame_moments(center: Floats) -> Floats:
    """(4,4) second moments of six points 1 cm around a place."""
    out = np.zeros((4, 4))
    for axis in np.eye(3):
        for sign in (0.01, -0.01):
            p = np.append(center + sign * axis, 1.0)
            out += np.outer(p, p)
    return out
