"""Lays the rough stand-in onto a scan: which way is up, where the front is, how the limbs stand, what the proportions are.

Starts are few and plain: every axis that may be up, both ways that the widest direction allows the person to face, arms
and legs towards where the scan reaches out. Each is settled coarsely, the best is settled finely, and what the stand-in
cannot follow is taken up by a smooth field of offsets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from vitruvian.body import rotations as rot
from vitruvian.body.types import Floats
from vitruvian.modeling.rough import HEIGHT, JOINTS, SHAPES, Likeness, Posed, Rough, jacobian, moved, posed, start

FACING = 0.06  # metres that a normal that turns the other way counts as, in looking for closest points
SURE = 0.015  # metres: the spread of what fits, in the weight of data against what is expected of people
WHOLE = 220.0  # how many independent measurements a scan counts as
FAR = 0.05  # metres: the score counts nothing beyond


@dataclass(frozen=True, eq=False)
class Target:
    """A scan made ready: points (N,3) and unit normals (N,3), upright, as high as `HEIGHT`; a tree over both."""

    points: Floats
    normals: Floats
    tree: cKDTree

    @staticmethod
    def of(points: Floats, normals: Floats) -> Target:
        """With its tree."""
        return Target(points, normals, cKDTree(np.concatenate([points, FACING * normals], axis=1)))


def settle(
    model: Rough,
    who: Likeness,
    target: Target,
    *,
    rounds: int,
    every: int,
    spread: tuple[float, float],
    shape: float = 1.0,
) -> Likeness:
    """The stand-in moved onto the target. `every`: one point in so many takes part; `spread` (m): how far off a point may
    be to count, in the first round and in the last; `shape`: how far the proportions may leave the mean."""
    rows = np.arange(0, model.matched, every)
    some = np.linspace(0, len(target.points) - 1, min(len(target.points), 2 * len(rows))).astype(np.int64)
    some = np.unique(some)
    for k in range(rounds):
        sigma = spread[0] * (spread[1] / spread[0]) ** (k / max(rounds - 1, 1))
        now = posed(model, who)
        step = _step(model, who, now, target, rows, some, sigma, shape)
        who = moved(who, now, step, model.parents)
        if k > 4 and float(np.abs(step).max()) < 1e-3 and sigma < 1.3 * spread[1]:
            break
    return who


def _step(
    model: Rough,
    who: Likeness,
    now: Posed,
    target: Target,
    rows: NDArray[np.int64],
    some: NDArray[np.int64],
    sigma: float,
    shape: float,
) -> Floats:
    """(P,) one Gauss-Newton step."""
    from scipy.linalg import cho_factor, cho_solve

    six = np.concatenate([now.points[rows], FACING * now.normals[rows]], axis=1)
    there = target.tree.query(six)[1]
    back = rows[cKDTree(six).query(np.concatenate([target.points[some], FACING * target.normals[some]], axis=1))[1]]
    jac = jacobian(model, who, now, rows)
    number = np.full(len(now.points), -1)
    number[rows] = np.arange(len(rows))
    mine = np.concatenate([rows, back])
    apart = np.concatenate([target.points[there], target.points[some]]) - now.points[mine]
    normal = np.concatenate([target.normals[there], target.normals[some]])
    agree = np.clip(np.einsum("ij,ij->i", normal, now.normals[mine]), 0, 1)
    square = np.einsum("ij,ij->i", apart, apart)
    weight = agree * (sigma**2 / (sigma**2 + square)) ** 2
    weight[: len(rows)] /= max(float(len(rows)), 1)
    weight[len(rows) :] /= max(float(len(some)), 1)
    weight *= WHOLE / 2 / SURE**2
    # Sums over correspondences by point of the model: metric (3,3) and pull (3,).
    metric = weight[:, None, None] * (normal[:, :, None] * normal[:, None, :] + 0.15 * np.eye(3))
    pull = np.einsum("nab,nb->na", metric, apart)
    n = len(rows)
    at = number[mine]
    sums = np.stack([np.bincount(at, metric[:, a, b], minlength=n) for a in range(3) for b in range(3)], axis=1)
    drawn = np.stack([np.bincount(at, pull[:, a], minlength=n) for a in range(3)], axis=1)
    flat = jac.reshape(3 * n, -1)
    heavy = np.einsum("nab,nbp->nap", sums.reshape(n, 3, 3), jac).reshape(3 * n, -1)
    normal_matrix, right = flat.T @ heavy, flat.T @ drawn.reshape(-1)
    _expected(model, who, now, normal_matrix, right, shape)
    normal_matrix[np.diag_indices_from(normal_matrix)] += 1e-3 * np.trace(normal_matrix) / len(right) * 1e-3
    return np.asarray(cho_solve(cho_factor(normal_matrix), right))


def _expected(model: Rough, who: Likeness, now: Posed, matrix: Floats, right: Floats, shape: float) -> None:
    """Adds what is expected of people: joints near the A pose, arms and legs alike, proportions near the mean."""
    count = len(JOINTS)
    for j, p in enumerate(model.parents):
        frame = now.turns[p] if p >= 0 else np.eye(3)
        sure = frame @ np.diag(model.loose[j] ** -2.0) @ frame.T
        at = slice(3 * j, 3 * j + 3)
        matrix[at, at] += sure
        if p >= 0:
            right[at] -= sure @ frame @ rot.to_vector(rot.from_matrix(who.turn[j]))
    own = np.arange(3 * count + 4, 3 * count + 4 + SHAPES)
    matrix[own, own] += shape**-2.0
    right[own] -= who.shape * shape**-2.0
    matrix[3 * count + 3, 3 * count + 3] += 0.05**-2.0
    right[3 * count + 3] -= np.log(who.scale) * 0.05**-2.0


def score(model: Rough, who: Likeness, target: Target, every: int = 2) -> float:
    """Mean distance (m) both ways, with nothing beyond `FAR` and the facing of the surfaces taken into account."""
    now = posed(model, who)
    rows = np.arange(0, model.matched, every)
    six = np.concatenate([now.points[rows], FACING * now.normals[rows]], axis=1)
    some = np.linspace(0, len(target.points) - 1, min(len(target.points), 2500)).astype(np.int64)
    other = np.concatenate([target.points[some], FACING * target.normals[some]], axis=1)
    there = target.tree.query(six, distance_upper_bound=FAR)[0]
    back = cKDTree(six).query(other, distance_upper_bound=FAR)[0]
    return float(np.minimum(there, FAR).mean() + np.minimum(back, FAR).mean()) / 2


def standing(points: Floats) -> tuple[Floats, float]:
    """How upright points (N,3) are brought to the stand-in's place: what becomes the origin, (3,), and the scale.

    The middle is between the shins and the head: arms that hang unlike each other do not move it.
    """
    low, high = np.quantile(points[:, 1], [0.0005, 0.9995])
    tall = max(float(high - low), 1e-9)
    ends = []
    for bottom, top in ((0.1, 0.25), (0.9, 1.0)):
        band = points[(points[:, 1] > low + bottom * tall) & (points[:, 1] < low + top * tall)]
        if len(band) > 5:
            ends.append((np.quantile(band, 0.02, axis=0) + np.quantile(band, 0.98, axis=0)) / 2)
    middle = np.mean(ends, axis=0) if ends else np.median(points, axis=0)
    return np.array([middle[0], low, middle[2]]), HEIGHT / tall


def begun(model: Rough, target: Target, across: Floats) -> Likeness:
    """A first guess: facing so that the left is along `across` (3,), arms and legs towards where the scan reaches."""
    forward = np.cross(across, [0.0, 1.0, 0.0])
    frame = np.stack([across, [0.0, 1.0, 0.0], forward], axis=1)
    who = start(frame)
    local = target.points @ frame
    mean = posed(model, start())
    for side, sign in (("l_", 1.0), ("r_", -1.0)):
        shoulder = mean.centers[JOINTS.index(side + "shoulder")]
        high = local[(local[:, 1] > 0.35 * HEIGHT) & (sign * local[:, 0] > 0.1)]
        if len(high):
            reach = np.quantile(sign * high[:, 0], 0.99)
            hand = high[sign * high[:, 0] >= reach - 0.02].mean(axis=0)
            tip = model.points[model.matched + model.names.index(side + "carpal_distal_phalanx_3")]
            _aim(who, side + "shoulder", tip - shoulder, hand - shoulder)
        low = local[(local[:, 1] < 0.06 * HEIGHT) & (sign * local[:, 0] > 0)]
        if len(low) > 10:
            hip = mean.centers[JOINTS.index(side + "hip")]
            ankle = mean.centers[JOINTS.index(side + "talocrural")]
            foot = np.array([np.median(low[:, 0]), ankle[1], np.median(low[:, 2]) - 0.05])
            _aim(who, side + "hip", ankle - hip, foot - hip)
    return who


def _aim(who: Likeness, joint: str, old: Floats, new: Floats) -> None:
    by = rot.between(old / np.linalg.norm(old), new / max(float(np.linalg.norm(new)), 1e-9))
    who.turn[JOINTS.index(joint)] = rot.to_matrix(by)


def widest(points: Floats) -> Floats:
    """(3,) the horizontal direction in which upright points (N,3) of one `HEIGHT` spread most, above the hips."""
    upper = points[(points[:, 1] > 0.45 * HEIGHT) & (points[:, 1] < 0.9 * HEIGHT)]
    flat = (upper if len(upper) > 10 else points)[:, [0, 2]]
    _, axes = np.linalg.eigh(np.cov((flat - np.median(flat, axis=0)).T))
    return np.array([axes[0, 1], 0.0, axes[1, 1]])


def refined(model: Rough, now: Posed, target: Target) -> Floats:
    """(K,3) the stand-in's points drawn the rest of the way: offsets to the target, smooth along the body, thrice."""
    weights = {width: _near(model, width) for width in (0.12, 0.07, 0.045)}
    points, rows = now.points.copy(), np.arange(model.matched)
    for width, near in weights.items():
        index, share = near
        six = np.concatenate([points[rows], FACING * now.normals[rows]], axis=1)
        there = target.tree.query(six)[1]
        apart = target.points[there] - points[rows]
        normal = target.normals[there]
        along = np.einsum("ij,ij->i", apart, normal)[:, None] * normal
        agree = np.clip(np.einsum("ij,ij->i", normal, now.normals[rows]), 0, 1)
        trust = agree * (width**2 / (width**2 + 4 * np.einsum("ij,ij->i", apart, apart))) ** 2
        mixed = share * trust[index]
        sums = np.einsum("kn,kna->ka", mixed, (along + 0.3 * (apart - along))[index])
        points += sums / (mixed.sum(axis=1, keepdims=True) + 0.05 * share.sum(axis=1, keepdims=True))
    return points


def _near(model: Rough, width: float) -> tuple[NDArray[np.int64], Floats]:
    """Neighbours among the points for matching of every point (K,24), and their shares: by distance at rest."""
    tree = cKDTree(model.points[: model.matched])
    far, index = tree.query(model.points, k=24)
    return index, np.exp(-((far / width) ** 2))
