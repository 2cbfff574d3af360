"""Joint parameters: scale, rotation and translation of each bone that make a template fall on what is known of a scan.

Column form, axes of the world at rest: `Q_j = Q_p exp[turn_j]`, `q_j = q_p + Q_p (A_p (c_j - c_p) + shift_j)` and
`x = sum_j w_j (q_j + Q_j A_j (a - c_j))`, where `A_j` stretches by exp(scale_j0) along the bone and by exp(scale_j1)
across it. A parent's scale moves the child's centre; the child's own flesh does not inherit it.

Source: seed 003, section 3.1 (joint parameters through the skeleton-driven deformation itself); note body.md, section 3;
S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns" (1991); K. Levenberg (1944),
D. Marquardt (1963).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from vitruvian.body import rotations as rot
from vitruvian.body.types import Floats, Ints, Skeleton

if TYPE_CHECKING:
    from scipy.sparse import csr_array

MIRRORED = 0.9  # a reflection that leaves less than this share of a rotation's residual is meant
EACH = 8  # parameters of a joint: turn 3, shift 3, scale 2


@dataclass(frozen=True, eq=False)
class Bones:
    """Parameters of J joints: log `scale` (J,2) along and across the bone, `turn` (J,3) rotation vectors against the
    parent, `shift` (J,3) metres in the parent's turned axes."""

    scale: Floats
    turn: Floats
    shift: Floats

    @staticmethod
    def none(joints: int) -> Bones:
        return Bones(np.zeros((joints, 2)), np.zeros((joints, 3)), np.zeros((joints, 3)))


@dataclass(frozen=True, eq=False)
class Frame:
    """Where bones are: `turn` (J,3,3) in the world, `place` (J,3) of the centres, `stretch` (J,3,3) at rest."""

    turn: Floats
    place: Floats
    stretch: Floats

    def matrices(self, centers: Floats) -> Floats:
        """(J,4,4) what takes points of the template, whose joints have these centres (J,3), to where the bones are."""
        out = np.tile(np.eye(4), (len(centers), 1, 1))
        out[:, :3, :3] = self.turn @ self.stretch
        out[:, :3, 3] = self.place - np.einsum("jab,jb->ja", out[:, :3, :3], centers)
        return out


def bone_axes(parents: Ints, centers: Floats) -> Floats:
    """(J,3) unit direction of each bone: to the child with most joints below it; ends go on like their parent."""
    count = len(parents)
    size = np.ones(count, np.int64)
    for j in range(count - 1, 0, -1):
        if parents[j] >= 0:
            size[parents[j]] += size[j]
    axes = np.tile([0.0, 1.0, 0.0], (count, 1))
    best = np.full(count, -1)
    for j in range(count):
        p = parents[j]
        if p >= 0 and (best[p] < 0 or size[j] > size[best[p]]) and np.linalg.norm(centers[j] - centers[p]) > 1e-6:
            best[p] = j
    for j in range(count):
        if best[j] >= 0:
            axes[j] = rot.unit(centers[best[j]] - centers[j])
        elif parents[j] >= 0:
            axes[j] = axes[parents[j]]
    return axes


def posed(parents: Ints, centers: Floats, axes: Floats, bones: Bones) -> Frame:
    """Where the bones of a template with these centres (J,3) and axes (J,3) are."""
    along, across = np.exp(bones.scale).T
    both = axes[:, :, None] * axes[:, None, :]
    stretch = across[:, None, None] * np.eye(3) + (along - across)[:, None, None] * both
    turn = rot.to_matrix(rot.from_vector(bones.turn))
    place = centers + bones.shift
    for j, p in enumerate(parents):
        if p >= 0:
            place[j] = place[p] + turn[p] @ (stretch[p] @ (centers[j] - centers[p]) + bones.shift[j])
            turn[j] = turn[p] @ turn[j]
    return Frame(turn, place, stretch)


def bone_motions(skeleton: Skeleton, bones: Bones) -> Floats:
    """(J,4,4) matrices of bones on a skeleton, humanoid space."""
    axes = bone_axes(skeleton.parents, skeleton.centers)
    return posed(skeleton.parents, skeleton.centers, axes, bones).matrices(skeleton.centers)


def similarity(source: Floats, target: Floats) -> tuple[float, Floats, Floats, bool]:
    """Scale, rotation (3,3), translation (3,) that take points (n,3) nearest to others (n,3), and whether a mirror image
    would do much better."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    u, d, vt = np.linalg.svd(b.T @ a)
    sign = np.sign(np.linalg.det(u @ vt)) or 1.0
    spread = float((a**2).sum())
    every = float((b**2).sum())

    def missed(last: float) -> float:
        return max(every - float(d[0] + d[1] + last * d[2]) ** 2 / spread, 0.0)

    turn = u @ np.diag([1.0, 1.0, sign]) @ vt
    scale = float(d[0] + d[1] + sign * d[2]) / spread
    mirrored = sign < 0 and missed(1.0) < MIRRORED**2 * missed(-1.0)
    return scale, turn, target.mean(axis=0) - scale * turn @ source.mean(axis=0), mirrored


@dataclass(frozen=True, eq=False)
class Rows:
    """What is wanted: points `at` (n,3) of the template, with `weights` (n,J) sparse, shall come to `goal` (n,3), as far
    as `along` (n,3), a unit direction, says; `trust` (n,) weighs the squares. `vertex` (n,V) sparse: which vertices of the
    template the points are means of."""

    vertex: csr_array
    at: Floats
    weights: csr_array
    along: Floats
    goal: Floats
    trust: Floats

    def joined(self, other: Rows) -> Rows:
        from scipy.sparse import vstack

        both = lambda a, b: np.concatenate([a, b])  # noqa: E731
        return Rows(
            vstack([self.vertex, other.vertex], format="csr"),
            both(self.at, other.at),
            vstack([self.weights, other.weights], format="csr"),
            both(self.along, other.along),
            both(self.goal, other.goal),
            both(self.trust, other.trust),
        )


def wanted(vertex: Any, points: Floats, weights: Any, along: Floats, goal: Floats, trust: Floats) -> Rows:
    """Rows for points given as means `vertex` (n,V) sparse of the template's (V,3) with their weights (V,J)."""
    return Rows(vertex, vertex @ points, (vertex @ weights).tocsr(), along, goal, trust)


def everywhere(vertex: Any, points: Floats, weights: Any, goal: Floats, trust: Floats) -> Rows:
    """Rows for points (n) wanted at a place: three directions each."""
    from scipy.sparse import vstack

    three = vstack([vertex] * 3, format="csr")
    along = np.repeat(np.eye(3), len(goal), axis=0)
    return wanted(three, points, weights, along, np.tile(goal, (3, 1)), np.tile(trust, 3))


@dataclass(frozen=True, eq=False)
class Knobs:
    """What may change: `links` (8J, K) sparse, how much of each joint parameter a knob turns; the prior's `pull` (K,)
    towards the values `rest` (8J,), and `pairs` (K,2) with `tie` (p,) that pulls two knobs together."""

    links: csr_array
    pull: Floats
    pairs: Ints
    tie: Floats
    names: tuple[str, ...]

    @cached_property
    def blocks(self) -> list[tuple[Ints, Floats]]:
        """Of each joint: the knobs (k,) that turn it, and (8,k) how much."""
        ends = self.links.indptr[::EACH]
        out = []
        for j, (a, b) in enumerate(zip(ends[:-1], ends[1:], strict=True)):
            knob, where = np.unique(self.links.indices[a:b], return_inverse=True)
            mine = np.zeros((EACH, len(knob)))
            row = np.repeat(np.arange(EACH), np.diff(self.links.indptr[EACH * j : EACH * (j + 1) + 1]))
            np.add.at(mine, (row, where), self.links.data[a:b])
            out.append((knob.astype(np.int32), mine))
        return out

    def only(self, kept: Sequence[bool] | Any) -> Knobs:
        """Those knobs alone."""
        kept = np.asarray(kept, bool)
        new = np.cumsum(kept) - 1
        both = kept[self.pairs].all(axis=1) if len(self.pairs) else np.zeros(0, bool)
        names = tuple(n for n, k in zip(self.names, kept, strict=True) if k)
        return Knobs(
            self.links[:, np.flatnonzero(kept)].tocsr(), self.pull[kept], new[self.pairs[both]], self.tie[both], names
        )


def flat(bones: Bones) -> Floats:
    """(8J,) turn, shift and scale of the joints, one after the other."""
    return np.concatenate([bones.turn, bones.shift, bones.scale], axis=1).ravel()


def changed(bones: Bones, step: Floats) -> Bones:
    """Bones after a step (8J,), whose turns are taken in the turned joint."""
    move = step.reshape(-1, EACH)
    turned = rot.multiply(rot.from_vector(bones.turn), rot.from_vector(move[:, :3]))
    return Bones(bones.scale + move[:, 6:], rot.to_vector(turned), bones.shift + move[:, 3:6])


def jacobian(
    parents: Ints, centers: Floats, axes: Floats, bones: Bones, frame: Frame, rows: Rows, knobs: Knobs
) -> Floats:
    """(n,K) how the distance of each row changes with the knobs."""
    count, joints = len(rows.at), len(parents)
    linear = frame.turn @ frame.stretch
    held = rows.weights.tocsc()
    above = np.where((parents >= 0)[:, None, None], frame.turn[np.maximum(parents, 0)], np.eye(3))
    grow = np.exp(bones.scale)
    out = np.zeros((count, knobs.links.shape[1]))
    # sums over all joints below, from the leaves to the root: share (1), place (3), what the bone stretches (3)
    total = np.empty((count, 7))
    below: list[list[tuple[Ints, Floats]]] = [[] for _ in range(joints)]
    for j in range(joints - 1, -1, -1):
        total[:] = 0
        mine = slice(held.indptr[j], held.indptr[j + 1])
        here, share = held.indices[mine], held.data[mine, None]
        away = rows.at[here] - centers[j]
        total[here, 0] = share[:, 0]
        total[here, 1:4] = share * (frame.place[j] + away @ linear[j].T)
        total[here, 4:] = share * away
        for row, some in below[j]:
            total[row] += some
        row = np.flatnonzero(total[:, 0]).astype(np.int32)
        sums = total[row]
        part, arm, reach = sums[:, :1], sums[:, 1:4], sums[:, 4:]
        p = parents[j]
        if p >= 0:
            below[p].append((row, np.hstack([sums[:, :4], part * (centers[j] - centers[p])])))
        knob, amount = knobs.blocks[j]
        if not len(row) or not len(knob):  # a point hangs on few of the joints, a joint on few of the knobs
            continue
        along = rows.along[row]
        facing = along @ frame.turn[j]
        ahead = (reach @ axes[j]) * (facing @ axes[j])
        slope = np.empty((len(row), EACH))
        slope[:, :3] = _cross(arm - part * frame.place[j], along) @ frame.turn[j]
        slope[:, 3:6] = part * (along @ above[j])
        slope[:, 6] = ahead * grow[j, 0]
        slope[:, 7] = ((reach * facing).sum(axis=1) - ahead) * grow[j, 1]
        out[row[:, None], knob] += slope @ amount
    return out


def _cross(a: Floats, b: Floats) -> Floats:
    """(n,3) cross products, without what numpy does for other shapes."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)


def placed(rows: Rows, frame: Frame, centers: Floats) -> Floats:
    """(n,3) where the points of rows are."""
    m = frame.matrices(centers)
    spread = rows.weights @ m.reshape(len(m), 16)
    blend = spread.reshape(-1, 4, 4)
    return np.einsum("nab,nb->na", blend[:, :3, :3], rows.at) + blend[:, :3, 3]


def skinned(points: Floats, weights: Any, matrices: Floats) -> tuple[Floats, Floats]:
    """(V,3) points moved by blended matrices (J,4,4), and the (V,3,3) linear parts of these."""
    blend = (weights @ matrices.reshape(len(matrices), 16)).reshape(-1, 4, 4)
    return np.einsum("vab,vb->va", blend[:, :3, :3], points) + blend[:, :3, 3], blend[:, :3, :3]


def _turning(turn: Floats) -> Floats:
    """(J,3,3) by which a step in the turned joint changes the rotation vectors (J,3): the inverse right Jacobian."""
    angle = np.linalg.norm(turn, axis=1)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    rest = np.where(small, 1 / 12, 1 / safe**2 - (1 + np.cos(safe)) / (2 * safe * np.maximum(np.sin(safe), 1e-6)))
    x, y, z = turn.T
    o = np.zeros(len(turn))
    cross = np.stack([o, -z, y, z, o, -x, -y, x, o], axis=1).reshape(-1, 3, 3)
    return np.eye(3) + cross / 2 + rest[:, None, None] * (cross @ cross)


def settle(
    parents: Ints,
    centers: Floats,
    axes: Floats,
    bones: Bones,
    rows: Rows,
    knobs: Knobs,
    *,
    rounds: int = 30,
    usual: Floats | None = None,
    tolerance: float = 1e-6,
) -> Bones:
    """The bones after Levenberg-Marquardt on rows and the prior, or after `rounds`.

    `usual` (8J,): the parameters that the prior pulls to, zero when None.
    """
    usual = np.zeros(len(parents) * EACH) if usual is None else usual
    mean = knobs.links / np.maximum(np.asarray(abs(knobs.links).sum(axis=0)).ravel(), 1e-12)

    def cost(b: Bones) -> tuple[float, Floats, Floats, Frame]:
        frame = posed(parents, centers, axes, b)
        short = ((rows.goal - placed(rows, frame, centers)) * rows.along).sum(axis=1)
        off = mean.T @ (flat(b) - usual)
        apart = off[knobs.pairs[:, 0]] - off[knobs.pairs[:, 1]]
        total = rows.trust @ short**2 + knobs.pull @ off**2 + knobs.tie @ apart**2
        return float(total), short, off, frame

    best, short, off, frame = cost(bones)
    damping = 1e-4
    for _ in range(rounds):
        slope = jacobian(parents, centers, axes, bones, frame, rows, knobs)
        scaled = slope * rows.trust[:, None]
        hessian, downhill = slope.T @ scaled, scaled.T @ short
        turning = np.tile(np.eye(EACH), (len(parents), 1, 1))
        turning[:, :3, :3] = _turning(bones.turn)
        how = _block(turning)
        prior = (mean.T @ how @ knobs.links).toarray()
        hessian += prior.T @ (knobs.pull[:, None] * prior)
        downhill -= prior.T @ (knobs.pull * off)
        if len(knobs.pairs):
            gap = prior[knobs.pairs[:, 0]] - prior[knobs.pairs[:, 1]]
            hessian += gap.T @ (knobs.tie[:, None] * gap)
            downhill -= gap.T @ (knobs.tie * (off[knobs.pairs[:, 0]] - off[knobs.pairs[:, 1]]))
        before = best
        while damping < 1e6:
            step = np.linalg.solve(hessian + damping * np.diag(np.diag(hessian) + 1e-6), downhill)
            trial = changed(bones, knobs.links @ step)
            found = cost(trial)
            if found[0] < best:
                bones, (best, short, off, frame) = trial, found
                damping = max(damping / 5, 1e-9)
                break
            damping *= 5
        if before - best < tolerance * max(before, 1e-12):
            break
    return bones


def _block(blocks: Floats) -> Any:
    """Sparse matrix with these (J,n,n) along its diagonal."""
    from scipy.sparse import bsr_array

    count, size = len(blocks), blocks.shape[1]
    return bsr_array((blocks, np.arange(count), np.arange(count + 1)), shape=(count * size, count * size)).tocsr()


def unscaled(bones: Bones) -> Bones:
    """The same pose without scales and shifts of inner joints."""
    shift = np.zeros_like(bones.shift)
    shift[0] = bones.shift[0]
    return replace(bones, scale=np.zeros_like(bones.scale), shift=shift)
