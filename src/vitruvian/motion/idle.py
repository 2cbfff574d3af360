"""Standing at ease: weight from leg to leg, breath, small looks around. Our own, no capture.

Periods and sizes follow what is measured in quiet standing: some 15 breaths a minute, weight shifts of a few
centimetres over several seconds, blinks of about 0.15 s every two to four seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vitruvian.body.rotations import from_vector, multiply, rotate, to_vector
from vitruvian.body.types import Floats, Skeleton
from vitruvian.errors import VitruvianError
from vitruvian.motion.contacts import Leg, below, in_units, legs, units_per_metre
from vitruvian.motion.hands import relaxed
from vitruvian.motion.legs import smooth, two_bone
from vitruvian.motion.names import joint_index
from vitruvian.motion.posture import STRAIGHT, X, Y, Z, aim_leg, hang_arm, spread_spine, wave
from vitruvian.motion.turns import about, local_rotations, positions, world_rotations
from vitruvian.motion.types import Motion


def idle(skeleton: Skeleton, *, seconds: float = 8, fps: float = 30, blink: Sequence[str] = ()) -> Motion:
    """A person standing at ease on the floor (y = 0 at rest); never still, loops without a seam.

    seconds: length of the loop (at least 4). blink: names of displacers that close the eyes; they get weights that
    close them now and then for about 0.15 s. Feet stay planted where they are at rest.
    """
    if not 4 <= seconds < 3600:
        raise VitruvianError(f"seconds: expected at least 4 for one breath, found {seconds}")
    if not 10 <= fps < 10000:
        raise VitruvianError(f"fps: expected at least 10 frames per second, found {fps}")
    unit = units_per_metre(skeleton)
    if unit != 1.0:
        out = idle(in_units(skeleton, 1 / unit), seconds=seconds, fps=fps, blink=blink)
        return replace(out, skeleton=skeleton, translation=out.translation * unit)
    limbs, index = legs(skeleton), joint_index(skeleton.names)
    if "humanoid_root" not in index:
        raise VitruvianError("skeleton: expected a joint humanoid_root to stand")
    frames, degrees = int(round(seconds * fps)), np.radians
    phase = np.arange(frames) / frames
    breaths = max(1, int(round(seconds / 4.0)))
    breath = wave(phase, breaths) + 0.18 * wave(phase, 2 * breaths, 0.02)
    weight = 0.85 * wave(phase, 1, 0.2) + 0.22 * wave(phase, 2, 0.35) + 0.07 * wave(phase, 3, 0.1)  # 1: on the left leg
    restless = 0.5 * wave(phase, 3, 0.15) + 0.35 * wave(phase, 5, 0.62)
    pelvis = multiply(about(Z, degrees(1.8) * weight), about(Y, degrees(1.6) * wave(phase, 1, 0.32)))
    pelvis = multiply(pelvis, about(X, degrees(0.5) * restless))
    chest = multiply(about(Z, -degrees(1.0) * weight), about(Y, degrees(1.0) * wave(phase, 2, 0.5)))
    chest = multiply(chest, about(X, degrees(1.0) - degrees(0.9) * breath + degrees(0.4) * restless))
    look = degrees(4.5) * (wave(phase, 1, 0.62) + 0.45 * wave(phase, 2, 0.2)) + degrees(0.8) * restless
    nod = degrees(0.5) + degrees(1.1) * wave(phase, 2, 0.8) + degrees(0.5) * wave(phase, 3, 0.4) + degrees(0.3) * breath
    head = multiply(multiply(about(Y, look), about(X, nod)), about(Z, degrees(1.2) * wave(phase, 1, 0.45)))
    local = np.zeros((frames, len(skeleton), 4))
    local[..., 3] = 1.0
    local[:, index["humanoid_root"]] = pelvis
    spread_spine(skeleton, index, local, pelvis, chest, head)
    for side, late in (("l", 0.0), ("r", 0.07)):
        drift = wave(phase, 1, 0.4 + late) + 0.5 * wave(phase, 3, late)
        if f"{side}_sternoclavicular" in index:
            lift = degrees(0.9 if side == "l" else -0.9) * breath
            local[:, index[f"{side}_sternoclavicular"]] = about(Z, lift)
        hang_arm(
            skeleton,
            index,
            local,
            side,
            forward=degrees(-1.0) + degrees(0.9) * drift,
            out=degrees(7.5) + degrees(0.5) * breath + degrees(0.5) * drift,
            bend=degrees(13.0) + degrees(1.2) * drift,
            inward=degrees(10.0),
            pronation=degrees(14.0),
            palm=degrees(5.0),
        )
    for name, turn in relaxed(skeleton).items():
        ease = 1.0 + 0.12 * wave(phase, 2, 0.3 if name.startswith("l") else 0.55)
        local[:, index[name]] = from_vector(to_vector(turn) * ease[:, None])
    world = world_rotations(skeleton.parents, local)
    move = np.zeros((frames, 3))
    if len(limbs) == 2:
        world, move = _stand(skeleton, limbs, world, weight, breath, phase)
    return Motion(
        skeleton,
        fps,
        local_rotations(skeleton.parents, world),
        move,
        weights={name: _blinks(frames, fps) for name in blink},
        loop=True,
        name="idle",
    )


def _stand(
    skeleton: Skeleton, limbs: tuple[Leg, ...], world: Floats, weight: Floats, breath: Floats, phase: Floats
) -> tuple[Floats, Floats]:
    """Both feet stay where they are at rest; the hips go over the loaded leg, whose knee is straighter."""
    c = skeleton.centers
    offset = positions(skeleton.parents, c, world, np.zeros((len(phase), 3)))
    size = float(np.mean([leg.length for leg in limbs])) / 0.9
    move = np.zeros((len(phase), 3))
    move[:, 0] = 0.022 * size * weight
    move[:, 2] = 0.004 * size * (wave(phase, 2, 0.1) + 0.6 * wave(phase, 3, 0.7))
    sink = 0.0
    for leg in limbs:
        way = offset[:, leg.hip] + move - c[leg.ankle]
        reach = np.sqrt((0.9985 * leg.length) ** 2 - way[:, 0] ** 2 - way[:, 2] ** 2)
        sink = max(sink, float((way[:, 1] - reach).max()))
    move[:, 1] = -sink - 0.0008 * (1 + breath)
    world = world.copy()
    for leg in limbs:
        hip = offset[:, leg.hip] + move
        ankle = np.broadcast_to(c[leg.ankle], hip.shape)
        outward = np.radians(5.0 if leg.side == "l" else -5.0)
        ahead = np.broadcast_to(rotate(about(Y, outward), Z), hip.shape)
        knee, ankle = two_bone(hip, ankle, 0.5 * (hip + ankle) + ahead, leg.thigh, leg.shank, STRAIGHT)
        aim_leg(skeleton, leg, world, hip, knee, ankle, ahead)
        world[:, [leg.ankle, *below(skeleton, leg.ankle)]] = [0.0, 0.0, 0.0, 1.0]
    return world, move


def _blinks(frames: int, fps: float) -> Floats:
    """Weights (F,) that close the eyes about every three seconds, unevenly, each for about 0.15 s."""
    out = np.zeros(frames)
    at, gaps, k = 1.3, (3.1, 2.3, 3.9, 0.6, 3.4), 0
    while at < frames / fps - 0.3:
        t = np.arange(frames) / fps - at
        out = np.maximum(out, np.where(t < 0, smooth(1 + t / 0.07), smooth(1 - (t - 0.03) / 0.11)))
        at += gaps[k % len(gaps)]
        k += 1
    return out
