"""What walking and standing share: a spine between pelvis, chest and head, hanging arms, legs laid along a line."""

from __future__ import annotations

import numpy as np

from vitruvian.body.rotations import inverse, multiply, rotate, slerp
from vitruvian.body.types import Floats, Skeleton
from vitruvian.motion.contacts import Leg
from vitruvian.motion.names import VERTEBRAE
from vitruvian.motion.turns import about, frame, unit

X, Y, Z = np.eye(3)
RAISED = 0.6  # radians: arms at rest that are farther off the body belong to an A or T pose
STRAIGHT = 0.9992  # of the leg's length: knees keep some four degrees


def wave(phase: Floats, harmonic: int, peak: float = 0.0) -> Floats:
    """Cosine of the given harmonic of the cycle with a maximum at `peak` (share of the cycle)."""
    return np.cos(2 * np.pi * harmonic * (phase - peak))


def spread_spine(
    skeleton: Skeleton, index: dict[str, int], local: Floats, pelvis: Floats, chest: Floats, head: Floats
) -> None:
    """Local rotations (in place) that lead from pelvis over chest to head (F,4), world, evenly by height.

    The last joint below the neck has the chest's turn, so at low levels of articulation nothing of it is lost.
    """
    names = [n for n in VERTEBRAE if n in index]
    trunk = [n for n in names if not n.startswith("vc")]
    y = skeleton.centers[:, 1]
    low = y[index["humanoid_root"]]
    top = y[index[trunk[-1]]] if trunk else low
    skull = y[index["skullbase"]] if "skullbase" in index else top + 0.1
    before = pelvis
    for name in names:
        here = y[index[name]]
        if name in trunk:
            share = 1.0 if name == trunk[-1] else (here - low) / max(top - low, 1e-6)
            now = slerp(pelvis, chest, np.full(len(pelvis), np.clip(share, 0.0, 1.0)))
        else:
            share = np.clip((here - top) / max(skull - top, 1e-6), 0.0, 1.0)
            now = slerp(chest, head, np.full(len(pelvis), share))
        local[:, index[name]] = multiply(inverse(before), now)
        before = now
    if "skullbase" in index:
        local[:, index["skullbase"]] = multiply(inverse(before), head)


def hang_arm(
    skeleton: Skeleton,
    index: dict[str, int],
    local: Floats,
    side: str,
    *,
    forward: Floats | float,
    out: Floats | float,
    bend: Floats | float,
    inward: Floats | float,
    pronation: Floats | float,
    wrist: Floats | float = 0.0,
    palm: Floats | float = 0.0,
) -> None:
    """Local rotations (in place) of one arm from angles in radians, each a number or (F,).

    forward: the upper arm, out: the whole arm from hanging straight down; bend: the elbow; inward: about the upper arm
    towards the body; pronation: thumb inwards; wrist: towards the thumb; palm: towards the palm. They mean the same
    whatever arm the rest pose shows, because what the rest pose already has is taken off.
    """
    shoulder, elbow, hand = (index.get(f"{side}_{n}") for n in ("shoulder", "elbow", "radiocarpal"))
    if shoulder is None or elbow is None:
        return
    sign = 1.0 if side == "l" else -1.0
    c, count = skeleton.centers, np.zeros(len(local))
    upper = unit(c[elbow] - c[shoulder])
    line = unit(c[elbow if hand is None else hand] - c[shoulder])  # the whole arm decides how far it hangs off the body
    fore = upper if hand is None else unit(c[hand] - c[elbow])
    lower = np.array([0.0, 0.0, 0.0, 1.0])
    if np.arctan2(sign * line[0], -line[1]) > RAISED:  # an A or T pose: its arms hang first, all else is as for those
        lower = about(Z, -sign * np.arctan2(sign * line[0], -line[1]))
        upper, line, fore = rotate(lower, upper), rotate(lower, line), rotate(lower, fore)
    put = lambda q: multiply(multiply(inverse(lower), q), lower)  # noqa: E731  (a turn of hanging arms, in the pose at rest)
    spread, front = np.arctan2(sign * line[0], -line[1]), np.arctan2(upper[2], -upper[1])
    swing = multiply(about(X, count - (forward - front)), about(Z, count + sign * (out - spread)))
    local[:, shoulder] = multiply(multiply(swing, about(Y, count - sign * inward)), lower)
    if hand is None:
        local[:, elbow] = put(about(X, count - bend))
        return
    straight = np.arctan2(fore[2], -fore[1]) - front  # the bend at rest
    turned = about(Y, count - sign * pronation)
    local[:, elbow] = put(multiply(about(X, count - (bend - straight)), turned))
    local[:, hand] = put(multiply(about(X, count - wrist), about(Z, count - sign * palm)))


def aim_leg(
    skeleton: Skeleton, leg: Leg, world: Floats, hip: Floats, knee: Floats, ankle: Floats, ahead: Floats
) -> None:
    """World rotations (in place) that lay thigh and shank along hip, knee and ankle (F,3), kneecaps towards `ahead`."""
    c = skeleton.centers
    for joint, bone, line in (
        (leg.hip, c[leg.knee] - c[leg.hip], knee - hip),
        (leg.knee, c[leg.ankle] - c[leg.knee], ankle - knee),
    ):
        world[:, joint] = multiply(frame(line, ahead), inverse(frame(bone, Z)))
