"""Retargeting: how true and how fast. Run: python benchmarks/retarget.py

True: the standard's figure on itself, a clip from a T pose onto the standard's rest, twist of the forearm, and a walk on
legs 15 % longer and shorter. Fast: frames per second with and without feet. No peer: the goals are absolute.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from _rows import main, row

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))


def rows(quick: bool = False) -> list[dict[str, object]]:
    """One row a figure; `figure` is what was measured."""
    from skeletons import figure, posed_rest, renamed, scaled_legs
    from vitruvian.body.rotations import from_axis_angle, inverse, multiply
    from vitruvian.motion.contacts import floor_penetration_mm, foot_slide_mm
    from vitruvian.motion.gait import walk
    from vitruvian.motion.retarget import retarget
    from vitruvian.motion.turns import local_rotations, twist, unit, world_rotations
    from vitruvian.motion.types import Motion

    out = []

    def said(name: str, value: float, goal: float, unit: str, at_least: bool = False) -> None:
        holds = value >= goal if at_least else value <= goal
        limit = f"{'>=' if at_least else '<='} {goal:,g} {unit}"
        out.append(row(f"{name}: {value:,.4g} {unit}", None, None, None, None, limit, bool(holds), figure=value))

    def degrees(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        turn = multiply(inverse(a), b)
        return np.degrees(2 * np.arctan2(np.linalg.norm(turn[..., :3], axis=-1), np.abs(turn[..., 3])))

    body = figure(3)
    clip = walk(body, fps=60, cycles=2)
    world = world_rotations(body.parents, clip.rotation)
    again = retarget(clip, body, feet=False)
    said("on itself", degrees(world_rotations(body.parents, again.rotation), world).max(), 0.05, "degrees")

    arms = {"l_shoulder": np.pi / 2, "r_shoulder": -np.pi / 2}
    pose = np.tile([0.0, 0.0, 0.0, 1.0], (1, len(body), 1))
    for name, angle in arms.items():
        pose[0, body.index[name]] = from_axis_angle([0, 0, 1, angle])
    theirs = multiply(world, inverse(world_rotations(body.parents, pose)))
    standing = posed_rest(body, {n: [0, 0, 1, a] for n, a in arms.items()})
    source = Motion(standing, 60, local_rotations(body.parents, theirs), clip.translation)
    turned = world_rotations(body.parents, retarget(source, body, feet=False).rotation)
    said("T pose onto the standard's rest", degrees(turned, world).max(), 0.1, "degrees")

    elbow, hand = body.index["l_elbow"], body.index["l_radiocarpal"]
    axis = unit(body.centers[hand] - body.centers[elbow])
    still = np.tile([0.0, 0.0, 0.0, 1.0], (5, len(body), 1))
    still[:, hand] = from_axis_angle([*axis, np.radians(30)])
    rig = renamed(body, {n: "bone " + n.replace("l_", "Left").replace("r_", "Right") for n in body.names})
    names = dict(zip(rig.names, body.names))
    carried = retarget(Motion(rig, 30, still, np.zeros((5, 3))), body, names=names, feet=False).rotation
    kept = np.degrees(twist(carried[:, elbow], axis) + twist(carried[:, hand], axis))
    said("twist of 30 degrees kept", float(np.abs(kept - 30).max()), 0.1, "degrees")

    for factor in (0.85, 1.15):
        legs = scaled_legs(body, factor)
        moved = retarget(clip, legs)
        of = f"legs x {factor:g}: "
        said(of + "sole slides in a frame", foot_slide_mm(moved), 2, "mm")
        said(of + "sole under the floor", floor_penetration_mm(moved), 5, "mm")
        knees = [degrees(moved.rotation[:, k], clip.rotation[:, k]) for k in map(body.index.get, ("l_knee", "r_knee"))]
        said(of + "change of the knees, 90th percentile", float(np.quantile(knees, 0.9)), 5, "degrees")

    long = walk(body, fps=120, cycles=4 if quick else 16)
    for feet, goal in ((False, 20_000), (True, 1_000)):
        times = []
        for _ in range(2 if quick else 5):
            start = time.perf_counter()
            retarget(long, body, feet=feet)
            times.append(time.perf_counter() - start)
        said(f"{'with' if feet else 'without'} feet", len(long) / min(times), goal, "frames/s", at_least=True)
    return out


if __name__ == "__main__":
    main(__doc__, rows)
