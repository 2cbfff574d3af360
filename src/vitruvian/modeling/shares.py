"""How the skin of one joint is shared among the joints of a finer chain.

Along a chain each joint owns its bone; from the middle of one bone to the middle of the next the share passes over with
a cubic step, so that a turn spread over the joints bends the skin smoothly. Between chains the nearer one counts, the
distance measured in thicknesses of its bones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vitruvian.body.types import Floats

_POWER = 8  # of the ratio of distances to two chains
_LEAK = 0.1  # a chain with less than this share of the nearest one's gets none: fingers stay apart
_NEAR = 4  # power of the distance in the mean of places along a chain
_BEYOND = 4  # thicknesses by which a chain goes on beyond its ends


@dataclass(frozen=True, eq=False)
class Branch:
    """A chain of joints: names from the former joint down, `points` (k+1,3) their centres and the chain's end,
    `thickness` (k,) of each bone (m)."""

    joints: tuple[str, ...]
    points: Floats
    thickness: Floats


def shares(points: Floats, branches: list[Branch]) -> dict[str, Floats]:
    """joint -> (n,) share, 0..1, of each skin point (n,3) that passes from the former joint to that new joint.

    What is left of one stays with the former joint, the first of every branch.
    """
    distance = np.maximum(np.array([_distance(points, b) for b in branches]), 1e-6)
    portion = (distance.min(axis=0) / distance) ** _POWER
    portion = np.maximum(portion - _LEAK, 0.0)
    portion /= portion.sum(axis=0)
    out: dict[str, Floats] = {}
    for branch, part in zip(branches, portion):
        near = np.flatnonzero(part > 0)
        along = _along(points[near], branch)
        lengths = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
        start = np.concatenate([[0.0], np.cumsum(lengths)])
        passed = [np.ones(len(near))]
        for i in range(1, len(branch.joints)):
            low, high = start[i] - lengths[i - 1] / 2, start[i] + lengths[i] / 2
            t = np.clip((along - low) / max(high - low, 1e-9), 0.0, 1.0)
            passed.append(t * t * (3 - 2 * t))
        passed.append(np.zeros(len(near)))
        for i in range(1, len(branch.joints)):
            share = out.setdefault(branch.joints[i], np.zeros(len(points)))
            share[near] += part[near] * (passed[i] - passed[i + 1])
    return out


def _distance(points: Floats, branch: Branch) -> Floats:
    """(n,) distance to the chain in thicknesses of its bones."""
    best = np.full(len(points), np.inf)
    for a, b, thick in zip(branch.points, branch.points[1:], branch.thickness):
        bone = b - a
        on = np.clip((points - a) @ bone / max(float(bone @ bone), 1e-18), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - a - on[:, None] * bone, axis=1) / thick)
    return best


def _along(points: Floats, branch: Branch) -> Floats:
    """(n,) length along the chain of the place beside each point.

    That place is the mean of the chain, weighted by a power of the distance: the nearest one close to the bones, and
    without jumps at the breast, where several vertebrae are equally near. The chain goes on straight beyond its ends.
    """
    bones = np.diff(branch.points, axis=0)
    lengths = np.maximum(np.linalg.norm(bones, axis=1), 1e-9)
    total = float(lengths.sum())
    thick = float(branch.thickness.max())
    first = branch.points[0] - bones[0] / lengths[0] * thick * _BEYOND
    last = branch.points[-1] + bones[-1] / lengths[-1] * thick * _BEYOND
    knots = np.concatenate([[first], branch.points, [last]])
    start = np.concatenate([[-thick * _BEYOND, 0.0], np.cumsum(lengths), [total + thick * _BEYOND]])
    count = int(np.clip(np.ceil((start[-1] - start[0]) / (0.1 * thick)), 16, 200))
    along = np.linspace(start[0], start[-1], count)
    place = np.stack([np.interp(along, start, knots[:, k]) for k in range(3)], axis=1)
    squared = (points * points).sum(axis=1)[:, None] - 2 * points @ place.T + (place * place).sum(axis=1)
    squared = np.maximum(squared, (0.02 * thick) ** 2)
    weight = (squared.min(axis=1, keepdims=True) / squared) ** (_NEAR // 2)
    return np.clip((weight @ along) / weight.sum(axis=1), 0.0, total)
