"""A walk and an idle of our own, for any H-Anim skeleton.

The walk starts from normative angles over the gait cycle (0 = heel strike, 1 = next heel strike of the same foot): key
values of our own fit to the mean curves in D. A. Winter, "The Biomechanics and Motor Control of Human Gait" (2nd ed.,
1991) for hip, knee and ankle, J. Perry, "Gait Analysis" (1992) for pelvis, toes and foot rockers, M. P. Murray, S. B.
Sepic and E. J. Barnard, "Patterns of sagittal rotation of the upper limbs in walking" (1967) for the arms. Cadence
follows from speed by a constant ratio of step length to step rate (N. Sekiya et al., 1996). Feet are then put down on
the floor, rolled over heel, ball and toes, and the legs solved to reach them, so nothing slides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from vitruvian.body.rotations import inverse, multiply, rotate, slerp
from vitruvian.body.types import Floats, Skeleton
from vitruvian.errors import VitruvianError
from vitruvian.motion.contacts import Leg, below, floor_at_rest, legs
from vitruvian.motion.hands import relaxed
from vitruvian.motion.legs import compose, smooth, two_bone
from vitruvian.motion.names import VERTEBRAE, joint_index
from vitruvian.motion.turns import about, frame, local_rotations, positions, unit, world_rotations
from vitruvian.motion.types import Motion

X, Y, Z = np.eye(3)

# Degrees at percent of the cycle. Thigh: from vertical, forward positive. Knee: flexion. Foot: pitch, toes up positive
# (the sum of thigh, knee and ankle; its flat part is exactly flat).
THIGH = {0: 24, 5: 24, 10: 21.5, 15: 17.5, 20: 13, 30: 3, 40: -8, 46: -14, 51: -16.5, 55: -15, 60: -8, 65: 2, 70: 11,
         75: 19, 80: 25, 86: 28.5, 92: 27.5, 96: 25.5}  # fmt: skip
KNEE = {0: 5, 5: 10.5, 10: 16, 15: 18, 20: 16.5, 25: 13, 30: 9.5, 35: 7, 40: 6, 45: 8, 50: 14.5, 55: 25, 60: 38, 65: 51,
        69: 58.5, 73: 61, 77: 57.5, 82: 44, 87: 26.5, 92: 11, 96: 4.5}  # fmt: skip
FOOT = {0: 19, 3: 13, 6: 5, 9: 0.8, 12: 0, 20: 0, 28: 0, 34: -1.2, 40: -6, 46: -16, 52: -31, 57: -46, 62: -60, 66: -64,
        70: -58, 75: -42, 80: -23, 85: -4, 90: 11, 94: 19, 97: 20.5}  # fmt: skip
STRAIGHT = 0.9992  # of the leg's length: knees keep some four degrees
TOES_BEND = np.radians(45.0)  # how far toes give before the foot rolls over their tips


def _curve(keys: dict[int, float]) -> CubicSpline:
    at = np.array([*keys, 100]) / 100
    return CubicSpline(at, np.radians([*keys.values(), next(iter(keys.values()))]), bc_type="periodic")


@dataclass(frozen=True)
class _Pace:
    """Timing and size of a walk: stride (m, two steps), cycle (s), stance (share of the cycle), vigour (1 at 1.35 m/s)."""

    speed: float
    stride: float
    cycle: float
    frames: int
    stance: float
    vigour: float


def _pace(speed: float, stride: float | None, fps: float, leg: float) -> _Pace:
    if not 0.3 <= speed <= 2.5:
        raise VitruvianError(f"speed: expected a walk of 0.3 to 2.5 m/s, found {speed}")
    if not fps >= 10:
        raise VitruvianError(f"fps: expected at least 10 frames per second, found {fps}")
    if stride is None:
        # step length / step rate = 0.0065 m min for a leg of 0.90 m
        stride = 2 * float(np.sqrt(0.0065 * (leg / 0.90) * speed * 60))
    if not 0.4 <= stride / leg <= 2.3:
        raise VitruvianError(f"stride: expected {0.4 * leg:.2f} to {2.3 * leg:.2f} m for these legs, found {stride}")
    frames = max(8, int(round(stride / speed * fps)))
    cycle = frames / fps
    stance = float(np.clip(0.665 - 0.035 * speed, 0.57, 0.67))
    return _Pace(speed, speed * cycle, cycle, frames, stance, float(np.clip(speed / 1.35, 0.35, 1.4)))


def walk(
    skeleton: Skeleton,
    *,
    speed: float = 1.35,
    stride: float | None = None,
    fps: float = 30,
    cycles: int = 1,
    in_place: bool = False,
) -> Motion:
    """A person walking along +Z on the floor (y = 0), beginning at left heel strike; loops without a seam.

    speed in m/s (0.3 to 2.5), stride in metres (two steps; by default the usual one at that speed and leg length; the
    cycle is rounded to whole frames, so stride = speed * cycle), cycles how many strides. in_place: walks on a treadmill,
    so that repeating the clip goes nowhere; else a repetition starts `speed * seconds` further.
    Planted feet neither slide nor sink. Joints that the skeleton lacks leave their part to the next one towards the root.
    """
    limbs = legs(skeleton)
    index = joint_index(skeleton.names)
    if len(limbs) != 2 or "humanoid_root" not in index:
        raise VitruvianError("skeleton: expected humanoid_root and both legs (hip, knee, ankle) to walk")
    pace = _pace(speed, stride, fps, float(np.mean([leg.length for leg in limbs])))
    fine = max(1, -(-240 // pace.frames))  # waves are fitted and feet put down on a finer grid than is answered
    phase = np.arange(pace.frames * fine) / (pace.frames * fine)
    local = _upper_body(skeleton, index, phase, pace)
    world, move = _walk_legs(skeleton, limbs, local, phase, pace)
    rotation = local_rotations(skeleton.parents, world[::fine])
    move = move[::fine]
    rotation = np.concatenate([rotation] * max(1, cycles))
    move = np.concatenate([move] * max(1, cycles))
    if not in_place:
        move[:, 2] += pace.speed * np.arange(len(move)) / fps
    return Motion(skeleton, fps, rotation, move, loop=True, name="walk")


def _wave(phase: Floats, harmonic: int, peak: float) -> Floats:
    """Cosine of the given harmonic of the cycle with its maximum at `peak` (share of the cycle)."""
    return np.cos(2 * np.pi * harmonic * (phase - peak))


def _upper_body(skeleton: Skeleton, index: dict[str, int], phase: Floats, pace: _Pace) -> Floats:
    """Local rotations (F,J,4) of everything but the legs; `phase` is that of the left leg."""
    degrees, v = np.radians, pace.vigour
    size = pace.stride / 1.45
    yaw = degrees(4.5) * size * -_wave(phase, 1, 0.02)  # left hip forward at left heel strike
    list_ = degrees(4.0) * v**0.5 * _list(phase)
    tilt = degrees(1.2) * _wave(phase, 2, 0.05) + degrees(1.5)
    pelvis = multiply(multiply(about(Y, yaw), about(Z, list_)), about(X, tilt))
    # the chest turns against the pelvis a little late, leans into the walk, and stays level
    chest_yaw = degrees(3.8) * v * _wave(phase, 1, 0.06)
    lean = degrees(2.0 + 1.2 * (v - 1)) + degrees(0.8) * _wave(phase, 2, 0.1)
    sway = degrees(1.3) * _wave(phase, 1, 0.3)
    chest = multiply(multiply(about(Y, chest_yaw), about(Z, -sway)), about(X, lean))
    head = multiply(about(Y, 0.15 * chest_yaw), about(X, degrees(1.0) - degrees(0.7) * _wave(phase, 2, 0.12)))
    local = np.zeros((len(phase), len(skeleton), 4))
    local[..., 3] = 1.0
    local[:, index["humanoid_root"]] = pelvis
    _spine(skeleton, index, local, pelvis, chest, head)
    for side, sign, own in (("l", 1.0, phase), ("r", -1.0, phase - 0.5)):
        _arm(skeleton, index, local, side, sign, own, v)
    for name, turn in relaxed(skeleton).items():
        local[:, index[name]] = turn
    return local


def _list(phase: Floats) -> Floats:
    """Pelvic list, -1..1: the swinging side hangs lowest just after the other foot has taken the weight."""
    raw = _wave(phase, 1, 0.17) + 0.28 * _wave(phase, 3, 0.10)
    return raw / 1.2


def _spine(
    skeleton: Skeleton, index: dict[str, int], local: Floats, pelvis: Floats, chest: Floats, head: Floats
) -> None:
    """Spread the way from pelvis over chest to head evenly (by height) over the vertebrae that there are."""
    names = [n for n in VERTEBRAE if n in index]
    y = skeleton.centers[:, 1]
    top = y[index["vt1"]] if "vt1" in index else y[index["l_shoulder"]] if "l_shoulder" in index else y.max()
    low = y[index["humanoid_root"]]
    skull = y[index["skullbase"]] if "skullbase" in index else top + 0.1
    before = pelvis
    lower = [n for n in names if not n.startswith("vc")]
    for name in names:
        if name in lower:
            last = name == lower[-1]
            share = 1.0 if last else np.clip((y[index[name]] - low) / max(top - low, 1e-6), 0.0, 1.0)
            now = slerp(pelvis, chest, np.full(len(pelvis), share))
        else:
            share = np.clip((y[index[name]] - top) / max(skull - top, 1e-6), 0.0, 1.0)
            now = slerp(chest, head, np.full(len(pelvis), share))
        local[:, index[name]] = multiply(inverse(before), now)
        before = now
    if "skullbase" in index:
        local[:, index["skullbase"]] = multiply(inverse(before), head)


def _arm(
    skeleton: Skeleton, index: dict[str, int], local: Floats, side: str, sign: float, phase: Floats, vigour: float
) -> None:
    """The arm swings against its own leg: farthest back at its heel strike, farthest forward half a cycle later."""
    shoulder, elbow, wrist = (index.get(f"{side}_{n}") for n in ("shoulder", "elbow", "radiocarpal"))
    clavicle = index.get(f"{side}_sternoclavicular")
    degrees = np.radians
    if shoulder is None or elbow is None:
        return
    c = skeleton.centers
    swing = degrees(-6.0) + degrees(16.0) * vigour * (_wave(phase, 1, 0.52) + 0.06 * _wave(phase, 2, 0.55))
    upper = unit(c[elbow] - c[shoulder])
    spread = np.arctan2(sign * upper[0], -upper[1])  # how far the arm stands off at rest
    hang = degrees(7.0) + degrees(1.0) * _wave(phase, 1, 0.55)
    lift = about(Z, sign * (hang - spread))
    inward = about(Y, -sign * (degrees(8.0) + degrees(5.0) * vigour * _wave(phase, 1, 0.55)))
    front = np.arctan2(upper[2], -upper[1])
    local[:, shoulder] = multiply(multiply(about(X, -(swing - front)), lift), inward)
    if clavicle is not None:
        local[:, clavicle] = multiply(
            about(Y, sign * degrees(-2.0) * vigour * _wave(phase, 1, 0.55)), about(Z, np.full(len(phase), 0.0))
        )
    bend = degrees(11.0) + degrees(9.0) * vigour * (1 + _wave(phase, 1, 0.60)) + degrees(3.0) * vigour
    if wrist is None:
        local[:, elbow] = about(X, -bend)
        return
    fore = unit(c[wrist] - c[elbow])
    straight = np.arctan2(fore[2], -fore[1]) - front  # bend at rest
    local[:, elbow] = multiply(about(X, -(bend - straight)), about(-Y, sign * np.full(len(phase), degrees(14.0))))
    local[:, wrist] = multiply(
        about(X, degrees(4.0) * _wave(phase, 1, 0.72)), about(Z, -sign * np.full(len(phase), degrees(5.0)))
    )


@dataclass(frozen=True, eq=False)
class _Roll:
    """How one foot rolls over the floor: forward and up are z and y, relative to the toe joint when the foot is flat."""

    leg: Leg
    ankle: Floats  # (2,) z, y of the ankle from the toe joint, foot flat
    heel: Floats  # (2,) of the heel's sole
    tip: Floats  # (2,) of the tip's sole
    height: float  # of the toe joint over the floor

    def at(self, pitch: Floats) -> tuple[Floats, Floats]:
        """Ankle (n,2) as z, y over the floor, and the toes' bend (n,), for a standing foot of that pitch (n,)."""
        pivot = np.zeros((len(pitch), 2))
        pivot[:, 1] = self.height
        bend = np.clip(-pitch, 0.0, TOES_BEND)
        over = np.minimum(pitch + TOES_BEND, 0.0)  # beyond the toes' bend the foot goes over their tips
        ground = self.tip + [0.0, self.height]
        pivot = np.where((over < 0)[:, None], ground + _pitched(-self.tip, over), pivot)
        ahead = pivot + _pitched(self.ankle, pitch)
        ground = self.heel + [0.0, self.height]
        behind = ground + _pitched(self.ankle - self.heel, pitch)
        return np.where((pitch > 0)[:, None], behind, ahead), bend


def _pitched(v: Floats, pitch: Floats) -> Floats:
    """Vectors (z, y) turned toes-up by pitch (n,): (n,2)."""
    s, c = np.sin(pitch), np.cos(pitch)
    return np.stack([v[0] * c - v[1] * s, v[0] * s + v[1] * c], axis=-1)


def _roll(skeleton: Skeleton, leg: Leg, floor: float) -> _Roll:
    c = skeleton.centers
    joint = leg.pivot
    height = float(joint[1] - floor)
    flat = lambda p: np.array([p[2] - joint[2], p[1] - joint[1]])  # noqa: E731
    return _Roll(leg, flat(c[leg.ankle]), flat(leg.heel), flat(leg.tip), height)


def _walk_legs(
    skeleton: Skeleton, limbs: tuple[Leg, ...], local: Floats, phase: Floats, pace: _Pace
) -> tuple[Floats, Floats]:
    """World rotations (F,J,4) with solved legs, and the root translation (F,3) less the even way forward.

    The hips follow from the planted feet: where the normative thigh and knee of the standing leg put them, reduced to
    an even way with two and four waves per stride.
    """
    c, floor = skeleton.centers, floor_at_rest(skeleton)
    world = world_rotations(skeleton.parents, local)
    offset = positions(skeleton.parents, c, world, np.zeros((len(phase), 3)))
    length = float(np.mean([leg.length for leg in limbs]))
    swing = _thigh_scale(_roll(skeleton, limbs[0], floor), pace)
    steps = []
    for leg in limbs:
        own = (phase if leg.side == "l" else phase - 0.5) % 1.0
        steps.append((leg, own, _roll(skeleton, leg, floor)))
    way, weight = np.zeros(len(phase)), np.zeros(len(phase))
    heights = []
    for leg, own, roll in steps:
        z, y = _hip_over_foot(roll, own, pace, swing)
        z -= pace.stride * own
        load = np.where(own < pace.stance, np.sin(np.pi * np.clip(own / pace.stance, 0.0, 1.0)) ** 2, 0.0)
        way += load * (z - (offset[:, leg.hip, 2] - offset[:, leg.hip, 2].mean()))
        weight += load
        heights.append(np.where(own < pace.stance, y + floor - offset[:, leg.hip, 1], np.inf))
    way, height = way / weight, np.min(heights, axis=0)  # with both feet down, the shorter leg decides
    start = way.mean()  # of the hips over the toe joint at heel strike
    move = np.zeros((len(phase), 3))
    move[:, 0] = 0.020 * length / 0.9 * (1.35 / max(pace.speed, 0.7)) ** 0.5 * _wave(phase, 1, 0.31)
    move[:, 1] = _even(height, phase)
    move[:, 2] = 0.7 * (_even(way, phase) - start)
    middle = np.mean([offset[:, leg.hip, 2].mean() for leg in limbs])
    move[:, 2] -= middle  # the hips, not the sacrum, travel on the line
    feet = [_foot_way(skeleton, leg, own, roll, pace, swing, offset[:, leg.hip] + move, start, floor) for leg, own, roll in steps]
    move[:, 1] -= _too_far(steps, pace, offset, move, feet)
    for (leg, _, _), (ankle, foot, bend) in zip(steps, feet):
        hip = offset[:, leg.hip] + move
        ahead = rotate(about(Y, (1.0 if leg.side == "l" else -1.0) * np.radians(4.0)), Z)
        knee, ankle = two_bone(hip, ankle, 0.5 * (hip + ankle) + ahead, leg.thigh, leg.shank, STRAIGHT)
        _aim(skeleton, leg, world, hip, knee, ankle, ahead)
        world[:, leg.ankle] = foot
        for j in below(skeleton, leg.ankle):
            parent = world[:, skeleton.parents[j]]
            world[:, j] = multiply(parent, about(X, -bend)) if j in leg.toes else parent
    return world, move


def _aim(skeleton: Skeleton, leg: Leg, world: Floats, hip: Floats, knee: Floats, ankle: Floats, ahead: Floats) -> None:
    """World rotations (in place) that lay thigh and shank along hip, knee and ankle (F,3), kneecaps towards `ahead`."""
    c = skeleton.centers
    for joint, bone, line in (
        (leg.hip, c[leg.knee] - c[leg.hip], knee - hip),
        (leg.knee, c[leg.ankle] - c[leg.knee], ankle - knee),
    ):
        world[:, joint] = multiply(frame(line, ahead), inverse(frame(bone, Z)))


def _legs_at(own: Floats, pace: _Pace, swing: float) -> tuple[Floats, Floats, Floats]:
    """Thigh, knee and foot pitch (n,) at phases of one leg; the curves' stance of 62 % is stretched to this walk's."""
    at = np.interp(own, [0.0, pace.stance, 1.0], [0.0, 0.62, 1.0])
    knee = _curve(KNEE)(at)
    early = np.exp(-(((at - 0.15) / 0.09) ** 2))  # giving way under the load grows with speed
    knee = knee * (1 + (np.clip(pace.vigour, 0.5, 1.3) - 1) * 0.8 * early)
    foot = _curve(FOOT)(at)
    foot = np.where(foot > 0, foot * np.clip(swing, 0.4, 1.15), foot * np.clip(0.5 + 0.5 * swing, 0.6, 1.05))
    return np.radians(1.0) + swing * _curve(THIGH)(at), knee, foot


def _hip_over_foot(roll: _Roll, own: Floats, pace: _Pace, swing: float) -> tuple[Floats, Floats]:
    """Hip z from the flat foot's toe joint and y over the floor (n,) when the leg stands with normative angles."""
    thigh, knee, foot = _legs_at(own, pace, swing)
    ankle, _ = roll.at(foot)
    z = ankle[:, 0] - roll.leg.thigh * np.sin(thigh) - roll.leg.shank * np.sin(thigh - knee)
    y = ankle[:, 1] + roll.leg.thigh * np.cos(thigh) + roll.leg.shank * np.cos(thigh - knee)
    return z, y


def _thigh_scale(roll: _Roll, pace: _Pace) -> float:
    """How much of the normative thigh swing makes this stride: the hip goes half a stride while the load changes over."""

    def lack(swing: float) -> float:
        z, _ = _hip_over_foot(roll, np.array([0.06, 0.56]) * pace.stance / 0.62, pace, swing)
        return float(z[1] - z[0]) - 0.5 * pace.stride * pace.stance / 0.62

    low, high = 0.2, 2.2
    if lack(low) > 0 or lack(high) < 0:
        return low if lack(low) > 0 else high
    return float(brentq(lack, low, high, xtol=1e-6))


def _even(values: Floats, phase: Floats) -> Floats:
    """Mean, second and fourth harmonic of one cycle: both steps alike, nothing jerky."""
    out = np.full(len(values), values.mean())
    for k in (2, 4):
        for wave in (np.cos(2 * np.pi * k * phase), np.sin(2 * np.pi * k * phase)):
            out = out + 2 * (values @ wave) / len(values) * wave
    return out


def _foot_way(
    skeleton: Skeleton,
    leg: Leg,
    own: Floats,
    roll: _Roll,
    pace: _Pace,
    swing: float,
    hip: Floats,
    start: float,
    floor: float,
) -> tuple[Floats, Floats, Floats]:
    """Ankle (F,3) less the way of the hips, the foot's world rotation (F,4) and the bend of its toes (F,)."""
    sign = 1.0 if leg.side == "l" else -1.0
    c = skeleton.centers
    thigh, knee, pitch = _legs_at(own, pace, swing)
    ankle, bend = roll.at(pitch)
    ankle[:, 0] += -start - pace.stride * own
    stands = own < pace.stance
    # in the air: the normative leg hung from the hip, bent so that it leaves and meets the floor without a jerk
    air = np.stack(
        [
            hip[:, 2] + leg.thigh * np.sin(thigh) + leg.shank * np.sin(thigh - knee),
            hip[:, 1] - floor - leg.thigh * np.cos(thigh) - leg.shank * np.cos(thigh - knee),
        ],
        axis=-1,
    )
    order = np.argsort(own)
    loop = CubicSpline(np.append(own[order], 1 + own[order[0]]), np.vstack([air[order], air[order[:1]]]), bc_type="periodic")
    eps = 1e-4
    ends = np.array([pace.stance - eps, pace.stance, 1.0, 1.0 + eps]) % 1.0
    ends[2] = 0.0
    _, _, turned = _legs_at(ends, pace, swing)
    edge, _ = roll.at(turned)
    edge[:, 0] += -start - pace.stride * np.array([pace.stance - eps, pace.stance, 0.0, eps])
    miss = edge - loop(np.array([pace.stance - eps, pace.stance, 1.0, 1.0 + eps]))
    span = 1.0 - pace.stance
    s = np.clip((own - pace.stance) / span, 0.0, 1.0)[:, None]
    slopes = (miss[1] - miss[0]) / eps * span, (miss[3] - miss[2]) / eps * span
    bridge = (2 * s**3 - 3 * s**2 + 1) * miss[1] + (s**3 - 2 * s**2 + s) * slopes[0]
    bridge = bridge + (3 * s**2 - 2 * s**3) * miss[2] + (s**3 - s**2) * slopes[1]
    ankle = np.where(stands[:, None], ankle, air + bridge)
    fly = s[:, 0]
    off = np.clip(-turned[1], 0.0, TOES_BEND)
    airy = off * (1 - smooth(fly / 0.4)) + 0.4 * turned[2] * smooth((fly - 0.5) / 0.5)
    bend = np.where(stands, np.where(pitch > 0, 0.4 * pitch, bend), airy)
    ankle[:, 1] += _clearance(roll, ankle, pitch, bend, fly)
    yaw = np.full(len(own), sign * np.radians(6.0))
    tuck = np.radians(4.0) * np.sin(np.pi * fly) ** 2
    foot = compose(yaw, pitch, -sign * tuck)
    half = 0.048 * leg.length / 0.85
    # turned out about the toe joint: the ankle stands a little further in, and back by its own lateral offset
    side = rotate(about(Y, yaw), np.array([c[leg.ankle][0] - leg.pivot[0], 0.0, 0.0]))
    track = sign * (half + np.sin(np.radians(6.0)) * abs(roll.ankle[0]))
    forth = rotate(about(Y, yaw), Z)
    # what the foot does about its place on the floor goes along its own line, its flight along the way
    along = ankle[:, :1] + start + pace.stride * own[:, None]
    first, last = edge[2, 0] + start, edge[1, 0] + start + pace.stride * pace.stance
    about_place = np.where(stands[:, None], along, last + (first - last) * smooth(s))
    out = forth * about_place + side
    out[:, 2] += (along - about_place)[:, 0]
    out[:, 0] += track
    out[:, 2] -= start + pace.stride * own
    out[:, 1] = ankle[:, 1] + floor
    return out, foot, bend


def _clearance(roll: _Roll, ankle: Floats, pitch: Floats, bend: Floats, fly: Floats, least: float = 0.012) -> Floats:
    """How much higher (n,) the swinging foot has to go so that heel, ball and tip pass `least` over the floor."""
    joint = ankle - _pitched(roll.ankle, pitch)
    heel = joint + _pitched(roll.heel, pitch)
    tip = joint + _pitched(roll.tip, pitch + bend)
    ball = joint + _pitched(np.array([0.0, -roll.height]), pitch)
    low = np.minimum(np.minimum(heel, tip), ball)[:, 1]
    shape = np.where(fly > 0, np.sin(np.pi * np.clip(fly, 0.0, 1.0)) ** 2, 0.0)
    need = np.where(shape > 0.25, (least - low) / np.maximum(shape, 0.25), 0.0)
    return shape * max(0.0, float(need.max(initial=0.0)))


def _too_far(steps: list, pace: _Pace, offset: Floats, move: Floats, feet: list) -> float:
    """How much (m) the hips have to sink so that both legs reach their feet whenever those stand."""
    sink = 0.0
    for (leg, own, _), (ankle, _, _) in zip(steps, feet):
        stands = own < pace.stance
        way = (offset[:, leg.hip] + move - ankle)[stands]
        reach = np.sqrt(np.maximum((STRAIGHT * leg.length) ** 2 - way[:, 0] ** 2 - way[:, 2] ** 2, 0.0))
        sink = max(sink, float((way[:, 1] - reach).max()))
    return sink


def idle(skeleton: Skeleton, *, seconds: float = 8, fps: float = 30, blink: Sequence[str] = ()) -> Motion:
    """A person standing at ease: weight from leg to leg, breath, small looks around; never still, loops without a seam.

    seconds: length of the loop (at least 4). blink: names of displacers that close the eyes; they get weights that close
    them now and then for about 0.15 s. Feet stay planted on the floor where they are at rest.
    """
    if not seconds >= 4:
        raise VitruvianError(f"seconds: expected at least 4 for one breath, found {seconds}")
    if not fps >= 10:
        raise VitruvianError(f"fps: expected at least 10 frames per second, found {fps}")
    limbs, index = legs(skeleton), joint_index(skeleton.names)
    if "humanoid_root" not in index:
        raise VitruvianError("skeleton: expected a joint humanoid_root to stand")
    frames = int(round(seconds * fps))
    phase = np.arange(frames) / frames
    wave = lambda n, peak=0.0: _wave(phase, n, peak)  # noqa: E731
    degrees = np.radians
    breaths = max(1, int(round(seconds / 4.0)))
    breath = wave(breaths) + 0.18 * wave(2 * breaths, 0.02)
    weight = 0.85 * wave(1, 0.2) + 0.22 * wave(2, 0.35) + 0.07 * wave(3, 0.1)  # 1: on the left leg
    restless = 0.5 * wave(3, 0.15) + 0.35 * wave(5, 0.62)
    pelvis = multiply(about(Z, degrees(1.8) * weight), about(Y, degrees(1.6) * wave(1, 0.32)))
    pelvis = multiply(pelvis, about(X, degrees(0.5) * restless))
    chest = multiply(about(Z, -degrees(1.0) * weight), about(Y, degrees(1.0) * wave(2, 0.5)))
    chest = multiply(chest, about(X, degrees(1.0) - degrees(0.9) * breath + degrees(0.4) * restless))
    look = degrees(4.5) * (wave(1, 0.62) + 0.45 * wave(2, 0.2)) + degrees(0.8) * restless
    nod = degrees(0.5) + degrees(1.1) * wave(2, 0.8) + degrees(0.5) * wave(3, 0.4) + degrees(0.3) * breath
    head = multiply(multiply(about(Y, look), about(X, nod)), about(Z, degrees(1.2) * wave(1, 0.45)))
    local = np.zeros((frames, len(skeleton), 4))
    local[..., 3] = 1.0
    local[:, index["humanoid_root"]] = pelvis
    _spine(skeleton, index, local, pelvis, chest, head)
    for side, sign, late in (("l", 1.0, 0.0), ("r", -1.0, 0.07)):
        _hanging_arm(skeleton, index, local, side, sign, breath, _wave(phase, 1, 0.4 + late) + 0.5 * _wave(phase, 3, late))
    for name, turn in relaxed(skeleton).items():
        ease_ = 1.0 + 0.12 * _wave(phase, 2, 0.3 if name.startswith("l") else 0.55)
        local[:, index[name]] = about(to_axis(turn), 2 * np.arccos(np.clip(turn[3], -1, 1)) * ease_)
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


def to_axis(q: Floats) -> Floats:
    """Unit axis (3,) of a rotation that turns."""
    return unit(q[..., :3])


def _hanging_arm(
    skeleton: Skeleton, index: dict[str, int], local: Floats, side: str, sign: float, breath: Floats, drift: Floats
) -> None:
    shoulder, elbow, wrist = (index.get(f"{side}_{n}") for n in ("shoulder", "elbow", "radiocarpal"))
    if shoulder is None or elbow is None or wrist is None:
        return
    degrees, c = np.radians, skeleton.centers
    if f"{side}_sternoclavicular" in index:
        local[:, index[f"{side}_sternoclavicular"]] = about(Z, sign * degrees(0.9) * breath)
    upper, fore = unit(c[elbow] - c[shoulder]), unit(c[wrist] - c[elbow])
    spread, front = np.arctan2(sign * upper[0], -upper[1]), np.arctan2(upper[2], -upper[1])
    hang = degrees(7.5) + degrees(0.5) * breath + degrees(0.5) * drift
    forward = degrees(-1.0) + degrees(0.9) * drift
    local[:, shoulder] = multiply(
        multiply(about(X, -(forward - front)), about(Z, sign * (hang - spread))), about(Y, -sign * degrees(10.0) + 0 * hang)
    )
    straight = np.arctan2(fore[2], -fore[1]) - front
    bend = degrees(13.0) + degrees(1.2) * drift
    local[:, elbow] = multiply(about(X, -(bend - straight)), about(Y, -sign * degrees(14.0) + 0 * bend))
    local[:, wrist] = about(Z, -sign * degrees(5.0) + 0 * bend)


def _stand(
    skeleton: Skeleton, limbs: tuple[Leg, ...], world: Floats, weight: Floats, breath: Floats, phase: Floats
) -> tuple[Floats, Floats]:
    """Both feet stay where they are at rest; the hips go over the loaded leg, whose knee is straighter."""
    c = skeleton.centers
    offset = positions(skeleton.parents, c, world, np.zeros((len(phase), 3)))
    length = float(np.mean([leg.length for leg in limbs]))
    move = np.zeros((len(phase), 3))
    move[:, 0] = 0.022 * length / 0.9 * weight
    move[:, 2] = 0.004 * length / 0.9 * (_wave(phase, 2, 0.1) + 0.6 * _wave(phase, 3, 0.7))
    need = 0.0
    ankles = []
    for leg in limbs:
        goal = c[leg.ankle]
        hip = offset[:, leg.hip] + move
        way = hip - goal
        reach = np.sqrt((0.9985 * leg.length) ** 2 - way[:, 0] ** 2 - way[:, 2] ** 2)
        need = max(need, float((way[:, 1] - reach).max()))
        ankles.append(goal)
    move[:, 1] -= need + 0.0008 * (1 + breath)
    world = world.copy()
    for leg, goal in zip(limbs, ankles):
        hip = offset[:, leg.hip] + move
        ankle = np.broadcast_to(goal, hip.shape)
        sign = 1.0 if leg.side == "l" else -1.0
        ahead = np.broadcast_to(rotate(about(Y, sign * np.radians(5.0)), Z), hip.shape)
        knee, ankle = two_bone(hip, ankle, 0.5 * (hip + ankle) + ahead, leg.thigh, leg.shank, STRAIGHT)
        _aim(skeleton, leg, world, hip, knee, ankle, ahead)
        world[:, leg.ankle] = [0.0, 0.0, 0.0, 1.0]
        for j in below(skeleton, leg.ankle):
            world[:, j] = world[:, skeleton.parents[j]]
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
