"""Forward kinematics of a 31-joint clip on one thread, against its NumPy twin and, where it is installed (`pip install
pin`), against pinocchio, which takes frame after frame in its own loop. Run: python benchmarks/kinematics.py
"""

from __future__ import annotations

import numpy as np
from _rows import main, row
from skin import interleaved

from vitruvian.body import kinematics
from vitruvian.body.rotations import normalize
from vitruvian.body.types import Floats, Skeleton
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
        row(name, t["kernel"], "NumPy twin", t["twin"], t["twin"] / t["kernel"], f">= {GOAL:,} frames/s", rate >= GOAL),
        *_pinocchio(skeleton, rotation, root, out, quick),
    ]


def _pinocchio(skeleton: Skeleton, rotation: Floats, root: Floats, out: Floats, quick: bool) -> list[dict[str, object]]:
    """The same joints as a model of theirs: times of both, and how far centres are apart."""
    try:
        import pinocchio as pin
    except ImportError:
        return []
    model, ids = pin.Model(), []
    c = skeleton.centers
    for j, p in enumerate(skeleton.parents):
        joint = pin.JointModelFreeFlyer() if p < 0 else pin.JointModelSpherical()
        place = pin.SE3(np.eye(3), np.zeros(3) if p < 0 else c[j] - c[p])
        ids.append(model.addJoint(ids[p] if p >= 0 else 0, joint, place, skeleton.names[j]))
    data, turns = model.createData(), np.zeros((len(rotation), model.nq))
    for j, i in enumerate(ids):
        k = model.idx_qs[i]
        if j == 0:
            turns[:, k : k + 3], k = c[0] + root, k + 3
        turns[:, k : k + 4] = rotation[:, j]
    still, forward = np.zeros((1, len(c), 3)), pin.forwardKinematics

    def theirs() -> None:
        for q in turns:
            forward(model, data, q)

    ours = lambda: kinematics.pose_matrices(skeleton, rotation, still, root=root, out=out, threads=1)  # noqa: E731
    t = interleaved({"kernel": ours, "pinocchio": theirs}, 1.0 if quick else 4.0)
    apart = np.abs(
        [data.oMi[i].translation for i in ids] - (out[-1, :, :3, :3] @ c[..., None] + out[-1, :, :3, 3:])[..., 0]
    )
    ratio = t["pinocchio"] / t["kernel"]
    name = f"forward kinematics, 31 joints, one thread; centres {apart.max():.1e} m apart"
    return [row(name, t["kernel"], "pinocchio", t["pinocchio"], ratio, ">= 1", ratio >= 1 and apart.max() < 1e-9)]


if __name__ == "__main__":
    main(__doc__, rows)
