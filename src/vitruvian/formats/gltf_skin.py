"""Skin weights for players that take four influences, and what that and linear skinning cost in millimetres."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from vitruvian.body.kinematics import joint_matrices, pose_matrices
from vitruvian.body.rotations import from_vector
from vitruvian.body.types import Body, Floats, Ints, Weights
from vitruvian.motion.types import Motion

CHUNK = 1024  # vertices whose weights are fitted at a time


def completed(weights: Weights, joints: int) -> Weights:
    """Rows that sum to one: what is missing goes to one more joint, number `joints`, that never moves.

    Rows that sum to more than one are divided by their sum (glTF can't express them).
    """
    sums = weights.sums
    # a deficit below this is rounding in the file, not a wish to stay at rest
    short = np.flatnonzero(sums < 1 - 1e-4)
    vertex = np.concatenate([weights.vertex, short])
    joint = np.concatenate([weights.joint, np.full(len(short), joints)])
    weight = np.concatenate([weights.weight, 1 - sums[short]])
    full = Weights.from_pairs(len(weights), vertex, joint, weight)
    return Weights(full.row, full.joint, full.weight / full.sums[full.vertex])


def limit(body: Body, count: int, played: Floats | None = None) -> tuple[Ints, Floats, dict[str, Any]]:
    """At most `count` influences for each vertex that move it much as all did: (V,count) joints, weights, the facts.

    The smallest influences are not simply left out: one after another, the weight of a joint goes to the joint of the
    same vertex where that changes its place least over trial poses, then weights are fitted anew to where the vertex
    was. Trial poses are random, and up to 24 of the joint matrices `played` (F,J,4,4), which matter more. Rows sum to
    1; places without weight name joint 0, and joint number J stands for "stays at rest". A vertex with no more than
    `count` keeps its weights as they are.
    """
    skin, joints = body.skin, len(body.skeleton)
    full = completed(skin.weights, joints)
    chosen, kept = full.top(count)
    facts: dict[str, Any] = {
        "pruned_weights": int((full.counts > count).sum()),
        "largest_dropped_weight": float(max(1 - kept.sum(axis=1).min(initial=1.0), 0.0)),
        "overweight_vertices": int((skin.weights.sums > 1 + 1e-4).sum()),
    }
    rows = np.flatnonzero(full.counts > count)
    if len(rows):
        among, weights = full.top(int(full.counts.max()))
        trials = _trials(body, played)
        rest = np.concatenate([skin.rest, np.ones((len(skin.rest), 1))], axis=1)
        for start in range(0, len(rows), CHUNK):
            r = rows[start : start + CHUNK]
            # (n, k, 3F): where each joint alone would have the vertex in every trial pose
            alone = np.einsum("fnkab,nb->nkfa", trials[:, among[r]], rest[r]).reshape(len(r), among.shape[1], -1)
            slot, kept[r] = _fewer(alone, weights[r], count)
            chosen[r] = np.take_along_axis(among[r], slot, axis=1)
    kept = (kept / kept.sum(axis=1, keepdims=True)).astype(np.float32).astype(np.float64)
    kept[:, 0] += 1 - kept.sum(axis=1)
    chosen[kept == 0] = 0
    return chosen, kept, facts


def _trials(body: Body, played: Floats | None) -> Floats:
    """(F,J+1,3,4) joint matrices that weights are fitted on; the last joint is the one that stays."""
    if played is None:
        found = _random(body, 24, np.pi / 8)
    else:
        some = np.linspace(0, len(played) - 1, min(len(played), 24)).round().astype(int)
        found = np.concatenate([played[some], _random(body, 12, np.pi / 12)])
    still = np.broadcast_to(np.eye(4), (len(found), 1, 4, 4))
    return np.concatenate([found, still], axis=1)[:, :, :3]


def _fewer(alone: Floats, weights: Floats, count: int) -> tuple[Ints, Floats]:
    """(n,count) which of k influences stay and their weights, from the places (n,k,P) each alone would give."""
    n, k, _ = alone.shape
    inner = alone @ alone.swapaxes(1, 2)
    square = np.einsum("nkk->nk", inner)
    apart = np.maximum(square[:, :, None] + square[:, None] - 2 * inner, 0)
    left, alive = weights.copy(), weights > 0
    for _ in range(k - count):
        pairs = alive[:, :, None] & alive[:, None] & ~np.eye(k, dtype=bool)
        cost = np.where(pairs, left[:, :, None] ** 2 * apart, np.inf).reshape(n, -1)
        giver, taker = np.divmod(cost.argmin(axis=1), k)
        row = np.flatnonzero(alive.sum(axis=1) > count)
        left[row, taker[row]] += left[row, giver[row]]
        left[row, giver[row]], alive[row, giver[row]] = 0.0, False
    slot = np.argsort(-left, axis=1, kind="stable")[:, :count].astype(np.int32)
    left = np.take_along_axis(left, slot, axis=1)
    # least squares of weights that sum to one, drawn to those given: places may depend on each other
    place = np.take_along_axis(alone, slot[:, :, None].astype(np.intp), axis=1)
    across, goal = place[:, 1:] - place[:, :1], np.einsum("nk,nkp->np", weights, alone) - place[:, 0]
    normal = across @ across.swapaxes(1, 2)
    draw = 1e-4 * np.einsum("nkk->n", normal) + 1e-12
    normal += draw[:, None, None] * np.eye(count - 1)
    right = np.einsum("nkp,np->nk", across, goal) + draw[:, None] * left[:, 1:]
    others = np.linalg.solve(normal, right[..., None])[..., 0]
    found = np.concatenate([1 - others.sum(axis=1, keepdims=True), others], axis=1).clip(0)
    return slot, found / found.sum(axis=1, keepdims=True)


def poses(body: Body, motion: Motion | None, random: int = 100) -> Floats:
    """(F,J,4,4) joint matrices to try a skin on: rest, then every frame, or `random` seeded poses without a motion.

    A random pose turns every joint by up to 60 degrees about a random axis.
    """
    s = body.skeleton
    moved = joint_matrices(s, motion) if motion is not None else _random(body, random, np.pi / 3)
    return np.concatenate([joint_matrices(s), moved])


def _random(body: Body, count: int, angle: float) -> Floats:
    """(count,J,4,4) joint matrices of seeded poses: every joint turned by up to `angle` about a random axis."""
    s = body.skeleton
    rng = np.random.default_rng(0)
    axis = rng.normal(size=(count, len(s), 3))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    turn = from_vector(axis * rng.uniform(0, angle, (count, len(s), 1)))
    return pose_matrices(s, turn, s.translation[None])


def matrix_of(joints: NDArray, weights: NDArray, columns: int) -> csr_array:
    """Sparse (V,columns) from padded rows (V,k)."""
    n, k = joints.shape
    return csr_array((weights.reshape(-1), joints.reshape(-1), np.arange(0, n * k + 1, k)), shape=(n, columns))


def browsers(weights: Weights, columns: int) -> csr_array:
    """Sparse (V,columns) with the meaning of H-Anim: p' = p + sum w (M p - p), the last column is what stays."""
    n = len(weights)
    own = csr_array((weights.weight, weights.joint, weights.row), shape=(n, columns))
    still = np.full(n, columns - 1), np.arange(n + 1)
    return own + csr_array((1 - weights.sums, *still), shape=(n, columns))


def measure(body: Body, motion: Motion | None, joints: Ints, weights: Floats, deformer: str) -> dict[str, Any]:
    """Distances in metres between our skin and what a glTF player makes of it, over `poses`."""
    skin, columns = body.skin, len(body.skeleton) + 1
    exact = browsers(skin.weights, columns)
    loss = exact - matrix_of(joints, weights, columns)
    loss.data[np.abs(loss.data) < 1e-7] = 0
    loss.eliminate_zeros()
    rows = np.flatnonzero(np.diff(loss.indptr))
    loss = loss[rows]
    rest = np.concatenate([skin.rest, np.ones((len(skin.rest), 1))], -1)[rows]
    matrices = poses(body, motion)
    worst, square = 0.0, 0.0
    for m in matrices if len(rows) else ():
        blend = (loss @ _flat(m)).reshape(-1, 3, 4)
        distance = ((blend @ rest[:, :, None])[:, :, 0] ** 2).sum(axis=1)
        worst, square = max(worst, float(distance.max())), square + float(distance.sum())
    out: dict[str, Any] = {
        "poses": len(matrices),
        "max_vertex_error_m": worst**0.5,
        "rms_vertex_error_m": (square / (len(matrices) * max(len(skin.rest), 1))) ** 0.5,
        "deformer": deformer,
        "deformer_difference_m": 0.0,
        "displacer_error_m": _displacers(body, exact, matrices),
    }
    if deformer != "linear" and motion is not None:
        out["deformer_difference_m"] = _difference(body, matrices[1:], exact, deformer)
    return out


def _flat(matrices: Floats) -> Floats:
    """(J+1,12): the upper rows of each joint matrix, then those of the joint that stays."""
    return np.concatenate([matrices[:, :3].reshape(-1, 12), np.eye(4)[:3].reshape(1, 12)])


def _difference(body: Body, matrices: Floats, exact: csr_array, deformer: str) -> float:
    """Largest distance between a deformer and linear skinning, over at most 60 frames spread evenly."""
    from vitruvian.deform.deformer import deformer as make

    some = np.linspace(0, len(matrices) - 1, min(len(matrices), 60)).round().astype(int)
    move = make(deformer, body)
    rest = np.concatenate([body.skin.rest, np.ones((len(body.skin.rest), 1))], -1)
    worst = 0.0
    for start in range(0, len(some), 8):
        chunk = matrices[some[start : start + 8]]
        ours = np.asarray(move(chunk, {m.name: 0.0 for m in body.skin.morphs}), np.float64).reshape(len(chunk), -1, 3)
        for m, v in zip(chunk, ours):
            linear = ((exact @ _flat(m)).reshape(-1, 3, 4) @ rest[:, :, None])[:, :, 0]
            worst = max(worst, float(np.linalg.norm(linear - v, axis=1).max(initial=0.0)))
    return worst


def _displacers(body: Body, exact: csr_array, matrices: Floats) -> float:
    """Largest distance that a Joint displacer at weight 1 is off, being morphed before skinning instead of after."""
    late = [m for m in body.skin.morphs if not m.before and len(m.index)]
    if not late:
        return 0.0
    some = matrices[np.linspace(0, len(matrices) - 1, min(len(matrices), 12)).round().astype(int)]
    worst = 0.0
    for m in some:
        flat = _flat(m)
        turn = (exact @ flat).reshape(-1, 3, 4)[:, :, :3]
        for d in late:
            apart = turn[d.index] - m[d.joint, :3, :3]
            worst = max(worst, float(np.linalg.norm((apart @ d.offset[:, :, None])[:, :, 0], axis=1).max()))
    return worst
