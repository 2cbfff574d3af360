"""Forward kinematics of a 31-joint clip on one thread, against its NumPy twin. Run: python benchmarks/kinematics.py"""

from __future__ import annotations

import numpy as np
from _rows import main, row
from skin import interleaved

from vitruvian.body import kinematics
from vitruvian.body.rotations import normalize
from vitruvian.body.types import Skeleton
from vitruvian.native import kernels

GOAL = 500_000  # frames per second


def rows(quick: bool = False) -> list[dict[str, object]]:
    """One row; `ratio` is frames per second over the goal."""
    if kernels() is None:
        return []
    rng = np.random.default_rng(0)
    joints, frames = 31, 2000
    parents = [-1, *(int(rng.integers(0, j)) for j in range(1, joints))]
    skeleton = Skeleton(tuple(f"j{i}" for i in range(joints)), parents, rng.normal(size=(joints, 3)))
    rotation, root = normalize(rng.normal(size=(frames, joints, 4))), rng.normal(size=(frames, 3))
    still, out, other = np.zeros((1, joints, 3)), np.empty((frames, joints, 4, 4)), np.empty((frames, joints, 4, 4))
    t = interleaved(
        {
            "kernel": lambda: kinematics.pose_matrices(skeleton, rotation, still, root=root, out=out, threads=1),
            "twin": lambda: kinematics._numpy(skeleton, rotation, still, root, None, other),
        },
        1.0 if quick else 4.0,
    )
    rate = frames / t["kernel"]
    name = f"forward kinematics, 31 joints, one thread: {rate:,.0f} frames/s"
    return [
        row(name, t["kernel"], "NumPy twin", t["twin"], t["twin"] / t["kernel"], f">= {GOAL:,} frames/s", rate >= GOAL)
    ]


if __name__ == "__main__":
    main(__doc__, rows)
