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
    far, along = zip(*(_project(points, b) for b in branches))
    distance = np.maximum(np.array(far), 1e-6)
    near = distance.min(axis=0)
    portion = (near / distance) ** _POWER
    portion = np.maximum(portion / portion.max(axis=0) - _LEAK, 0.0)
    portion /= portion.sum(axis=0)
    out: dict[str, Floats] = {}
    for k, branch in enumerate(branches):
        lengths = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
        start = np.concatenate([[0.0], np.cumsum(lengths)])
        passed = [np.ones(len(points))]
        for i in range(1, len(branch.joints)):
            low, high = start[i] - lengths[i - 1] / 2, start[i] + lengths[i] / 2
            t = np.clip((along[k] - low) / max(high - low, 1e-9), 0.0, 1.0)
            passed.append(t * t * (3 - 2 * t))
        passed.append(np.zeros(len(points)))
        for i in range(1, len(branch.joints)):
            name = branch.joints[i]
            out[name] = out.get(name, 0.0) + portion[k] * (passed[i] - passed[i + 1])
    return out


def _project(points: Floats, branch: Branch) -> tuple[Floats, Floats]:
    """(n,) distance to the chain in thicknesses and (n,) length along the chain of the nearest place on it."""
    best = np.full(len(points), np.inf)
    where = np.zeros(len(points))
    start = 0.0
    for a, b, thick in zip(branch.points, branch.points[1:], branch.thickness):
        bone = b - a
        length = float(np.linalg.norm(bone))
        t = np.clip((points - a) @ bone / max(length * length, 1e-18), 0.0, 1.0)
        far = np.linalg.norm(points - a - t[:, None] * bone, axis=1) / thick
        better = far < best - 1e-12
        best = np.where(better, far, best)
        where = np.where(better, start + t * length, where)
        start += length
    return best, where
