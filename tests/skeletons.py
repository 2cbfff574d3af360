"""Skeletons for tests: the standard's default figure at any level of articulation, other rests of it, other rigs."""

from __future__ import annotations

import numpy as np

from vitruvian.body.rotations import from_axis_angle, rotate
from vitruvian.body.types import Skeleton
from vitruvian.hanim.tables import default_centers, joints_at, parent_at
from vitruvian.motion.turns import positions, world_rotations


def figure(loa: int = 3, version: str = "2.0") -> Skeleton:
    """The default figure (1.75 m) with the joints of that level."""
    centers = default_centers(version)
    names = [n for n in joints_at(loa, version) if n in centers]
    parents = []
    for name in names:
        parent = parent_at(name, loa, version)
        parents.append(-1 if parent is None else names.index(parent))
    return Skeleton(tuple(names), np.array(parents), np.array([centers[n] for n in names]))


def posed_rest(skeleton: Skeleton, turns: dict[str, list[float]]) -> Skeleton:
    """The same bones with another rest pose: joints turned by axis-angles, everything below goes along."""
    local = np.tile([0.0, 0.0, 0.0, 1.0], (1, len(skeleton), 1))
    for name, turn in turns.items():
        local[0, skeleton.index[name]] = from_axis_angle(turn)
    world = world_rotations(skeleton.parents, local)
    centers = positions(skeleton.parents, skeleton.centers, world, np.zeros((1, 3)))[0]
    points = [
        centers[j] + rotate(world[0, j], p - skeleton.centers[j])
        for j, p in zip(skeleton.site_joints, skeleton.site_points)
    ]
    return Skeleton(
        skeleton.names,
        skeleton.parents,
        centers,
        site_names=skeleton.site_names,
        site_joints=skeleton.site_joints,
        site_points=np.array(points).reshape(-1, 3),
    )


def renamed(skeleton: Skeleton, names: dict[str, str]) -> Skeleton:
    """Other names for the same joints; those not named get names nobody knows."""
    new = tuple(names.get(n, f"part{i}") for i, n in enumerate(skeleton.names))
    return Skeleton(
        new,
        skeleton.parents,
        skeleton.centers,
        site_names=skeleton.site_names,
        site_joints=skeleton.site_joints,
        site_points=skeleton.site_points,
    )


def scaled_legs(skeleton: Skeleton, factor: float) -> Skeleton:
    """Thighs and shanks longer or shorter, feet as they are, standing on the same floor."""
    centers = skeleton.centers.copy()
    for side in "lr":
        hip, knee, ankle = (skeleton.index[f"{side}_{n}"] for n in ("hip", "knee", "talocrural"))
        old = skeleton.centers
        new_knee = centers[hip] + (old[knee] - old[hip]) * factor
        new_ankle = new_knee + (old[ankle] - old[knee]) * factor
        shift = new_ankle - old[ankle]
        centers[knee] = new_knee
        for j in range(len(skeleton)):
            k = j
            while k >= 0 and k != ankle:
                k = skeleton.parents[k]
            if k == ankle:
                centers[j] = old[j] + shift
    lift = (skeleton.centers[skeleton.index["l_talocrural"]] - centers[skeleton.index["l_talocrural"]])[1]
    centers[:, 1] += lift
    return Skeleton(skeleton.names, skeleton.parents, centers)
