"""A walk of our own, for any H-Anim skeleton.

It starts from normative angles over the gait cycle (0 = heel strike, 1 = next heel strike of the same foot): key
values of our own fit to the mean curves in D. A. Winter, "The Biomechanics and Motor Control of Human Gait" (2nd ed.,
1991) for hip, knee and ankle, J. Perry, "Gait Analysis" (1992) for pelvis, toes and foot rockers, M. P. Murray, S. B.
Sepic and E. J. Barnard, "Patterns of sagittal rotation of the upper limbs in walking" (1967) for the arms. Cadence
follows from speed by a constant ratio of step length to step rate (N. Sekiya et al., 1996). Feet are then put down on
the floor, rolled over heel, ball and toes, and the legs solved to reach them, so nothing slides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from vitruvian.body.rotations import multiply, rotate
from vitruvian.body.types import Floats, Skeleton
from vitruvian.errors import VitruvianError
from vitruvian.motion.contacts import Leg, below, floor_at_rest, in_units, legs, units_per_metre
from vitruvian.motion.hands import relaxed
from vitruvian.motion.legs import compose, smooth, two_bone
from vitruvian.motion.names import joint_index
from vitruvian.motion.posture import STRAIGHT, X, Y, Z, aim_leg, hang_arm, spread_spine, wave
from vitruvian.motion.turns import about, local_rotations, positions, world_rotations
from vitruvian.motion.types import Motion

# Degrees at percent of the cycle. Thigh: from vertical, forward positive. Knee: flexion. Foot: pitch, toes up positive
# (the sum of thigh, knee and ankle; its flat part is exactly flat).
THIGH = {0: 24, 5: 24, 10: 21.5, 15: 17.5, 20: 13, 30: 3, 40: -8, 46: -14, 51: -16.5, 55: -15, 60: -8, 65: 2, 70: 11,
         75: 19, 80: 25, 86: 28.5, 92: 27.5, 96: 25.5}  # fmt: skip
KNEE = {0: 5, 5: 10.5, 10: 16, 15: 18, 20: 16.5, 25: 13, 30: 9.5, 35: 7, 40: 6, 45: 8, 50: 14.5, 55: 25, 60: 38, 65: 53,
        69: 63, 73: 67, 77: 63, 82: 47, 87: 27.5, 92: 11, 96: 4.5}  # fmt: skip
FOOT = {0: 19, 3: 13, 6: 5, 9: 0.8, 12: 0, 20: 0, 28: 0, 34: -1.2, 40: -6, 46: -16.5, 52: -33, 57: -51, 62: -67,
        66: -70, 70: -62, 75: -43, 80: -23, 85: -4, 90: 11, 94: 19, 97: 20.5}  # fmt: skip
TOES_BEND = np.radians(38.0)  # how far toes give before the foot rolls over their tips


def _curve(keys: dict[int, float]) -> CubicSpline:
    at = np.array([*keys, 100]) / 100
    return CubicSpline(at, np.radians([*keys.values(), next(iter(keys.values()))]), bc_type="periodic")


@dataclass(frozen=True)
class _Pace:
    """Timing and size of a walk: stride (m, two steps), cycle (s), stance (share of the cycle).

    vigour is 1 at 1.35 m/s, reach 1 for a stride of 1.65 leg lengths.
    """

    speed: float
    stride: float
    cycle: float
    frames: int
    stance: float
    vigour: float
    reach: float


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
    stance = float(np.clip(0.658 - 0.035 * speed, 0.57, 0.66))
    vigour, reach = np.clip(speed / 1.35, 0.35, 1.4), np.clip(speed * cycle / (1.65 * leg), 0.3, 1.5)
    return _Pace(speed, speed * cycle, cycle, frames, stance, float(vigour), float(reach))


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
    cycle is rounded to whole frames, so stride = speed * cycle), cycles how many strides. in_place: walks on a
    treadmill, so that repeating the clip goes nowhere; else a repetition starts `speed * seconds` further.
    Planted feet neither slide nor sink. Joints that the skeleton lacks leave their part to the next one towards the
    root.
    """
    unit = units_per_metre(skeleton)
    if unit != 1.0:
        keys: dict = {"speed": speed, "stride": stride, "fps": fps, "cycles": cycles, "in_place": in_place}
        out = walk(in_units(skeleton, 1 / unit), **keys)
        return replace(out, skeleton=skeleton, translation=out.translation * unit)
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


def _upper_body(skeleton: Skeleton, index: dict[str, int], phase: Floats, pace: _Pace) -> Floats:
    """Local rotations (F,J,4) of everything but the legs; `phase` is that of the left leg."""
    degrees, v = np.radians, pace.vigour
    size = pace.stride / 1.45
    yaw = degrees(4.5) * size * -wave(phase, 1, 0.02)  # left hip forward at left heel strike
    list_ = degrees(4.0) * v**0.5 * _list(phase)
    tilt = degrees(1.2) * wave(phase, 2, 0.05) + degrees(1.5)
    pelvis = multiply(multiply(about(Y, yaw), about(Z, list_)), about(X, tilt))
    # the chest turns against the pelvis a little late, leans into the walk, and stays level
    chest_yaw = degrees(3.8) * v * wave(phase, 1, 0.06)
    lean = degrees(2.0 + 1.2 * (v - 1)) + degrees(0.8) * wave(phase, 2, 0.1)
    sway = degrees(1.3) * wave(phase, 1, 0.3)
    chest = multiply(multiply(about(Y, chest_yaw), about(Z, -sway)), about(X, lean))
    head = multiply(about(Y, 0.15 * chest_yaw), about(X, degrees(1.0) - degrees(0.7) * wave(phase, 2, 0.12)))
    local = np.zeros((len(phase), len(skeleton), 4))
    local[..., 3] = 1.0
    local[:, index["humanoid_root"]] = pelvis
    spread_spine(skeleton, index, local, pelvis, chest, head)
    for side, own in (("l", phase), ("r", phase - 0.5)):
        _swing_arm(skeleton, index, local, side, own, v)
    for name, turn in relaxed(skeleton).items():
        local[:, index[name]] = turn
    return local


def _swing_arm(
    skeleton: Skeleton, index: dict[str, int], local: Floats, side: str, phase: Floats, vigour: float
) -> None:
    """The arm swings against its own leg: farthest back at its heel strike, farthest forward half a cycle later.

    The elbow follows the shoulder a little late, the wrist the elbow.
    """
    degrees = np.radians
    if f"{side}_sternoclavicular" in index:
        forth = degrees(-2.0 if side == "l" else 2.0) * vigour * wave(phase, 1, 0.55)
        local[:, index[f"{side}_sternoclavicular"]] = about(Y, forth)
    hang_arm(
        skeleton,
        index,
        local,
        side,
        forward=degrees(-6.0) + degrees(16.0) * vigour * (wave(phase, 1, 0.52) + 0.06 * wave(phase, 2, 0.55)),
        out=degrees(7.0) + degrees(1.0) * wave(phase, 1, 0.55),
        bend=degrees(11.0) + degrees(9.0) * vigour * (1 + wave(phase, 1, 0.60)) + degrees(3.0) * vigour,
        inward=degrees(1.0) + degrees(3.0) * vigour * wave(phase, 1, 0.55),
        pronation=degrees(14.0),
        wrist=degrees(-4.0) * wave(phase, 1, 0.72),
        palm=degrees(5.0),
    )


def _list(phase: Floats) -> Floats:
    """Pelvic list, -1..1: the swinging side hangs lowest just after the other foot has taken the weight."""
    raw = wave(phase, 1, 0.17) + 0.28 * wave(phase, 3, 0.10)
    return raw / 1.2


@dataclass(frozen=True, eq=False)
class _Roll:
    """How one foot rolls over the floor: forward and up are z and y, from the toe joint when the foot is flat."""

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
    middle = np.mean([offset[:, leg.hip, 2].mean() for leg in limbs])
    move = np.zeros((len(phase), 3))
    move[:, 0] = 0.020 * length / 0.9 * (1.35 / max(pace.speed, 0.7)) ** 0.5 * wave(phase, 1, 0.31)
    # fastest with both feet down, slowest over the standing leg; and the hips, not the sacrum, travel on the line
    move[:, 2] = 0.008 * pace.stride * np.sin(4 * np.pi * (phase - 0.02)) - middle
    steps = []
    for leg in limbs:
        own = (phase if leg.side == "l" else phase - 0.5) % 1.0
        steps.append((leg, own, _roll(skeleton, leg, floor)))

    def heights(start: float) -> Floats:
        """Heights (2,F) of the root at which each standing leg has its normative knee."""
        found = [_height(roll, own, pace, offset[:, leg.hip] + move, start) for leg, own, roll in steps]
        return np.array(found) + floor

    # how far the hips are before the foot: both legs have to want the same height at heel strike, where the leading leg
    # takes over; the trailing one then bends as it has to
    lead = lambda start: float(np.subtract(*heights(start)[:, 0]))  # noqa: E731
    start = float(brentq(lead, -0.8 * length, 0.1 * length, xtol=1e-5))
    left, right = heights(start)
    move[:, 1] = _even(np.where(phase < 0.5, left, right), phase)
    for _ in range(2):  # once for what stands, once more because the swinging leg hangs from the hip
        feet = [
            _foot_way(skeleton, leg, own, roll, pace, offset[:, leg.hip] + move, start, floor)
            for leg, own, roll in steps
        ]
        move[:, 1] -= _too_far(steps, pace, offset, move, feet)
    for (leg, _, _), (ankle, foot, bend) in zip(steps, feet):
        hip = offset[:, leg.hip] + move
        ahead = rotate(about(Y, (1.0 if leg.side == "l" else -1.0) * np.radians(4.0)), Z)
        knee, ankle = two_bone(hip, ankle, 0.5 * (hip + ankle) + ahead, leg.thigh, leg.shank, STRAIGHT)
        aim_leg(skeleton, leg, world, hip, knee, ankle, ahead)
        world[:, leg.ankle] = foot
        for j in below(skeleton, leg.ankle):
            parent = world[:, skeleton.parents[j]]
            world[:, j] = multiply(parent, about(X, -bend)) if j in leg.toes else parent
    return world, move


def _legs_at(own: Floats, pace: _Pace) -> tuple[Floats, Floats, Floats]:
    """Thigh, knee and foot pitch (n,) at phases of one leg; the curves' stance of 62 % is stretched to this walk's."""
    at = np.interp(own, [0.0, pace.stance, 1.0], [0.0, 0.62, 1.0])
    knee = _curve(KNEE)(at)
    early = np.exp(-(((at - 0.15) / 0.09) ** 2))  # giving way under the load grows with speed
    knee = knee * (1 + (np.clip(pace.vigour, 0.5, 1.3) - 1) * 0.8 * early)
    foot = _curve(FOOT)(at)
    foot = np.where(foot > 0, foot * np.clip(pace.reach, 0.4, 1.15), foot * np.clip(0.5 + 0.5 * pace.reach, 0.6, 1.05))
    return pace.reach * _curve(THIGH)(at), knee, foot


def _height(roll: _Roll, own: Floats, pace: _Pace, hip: Floats, start: float) -> Floats:
    """How much (n,) the hip (n,3) has to be lifted for the leg to stand with its normative knee."""
    _, knee, foot = _legs_at(own, pace)
    ankle, _ = roll.at(foot)
    a, b = roll.leg.thigh, roll.leg.shank
    reach = a * a + b * b + 2 * a * b * np.cos(knee)
    flat = (hip[:, 2] - (ankle[:, 0] - start - pace.stride * own)) ** 2 + (0.05 * roll.leg.length) ** 2
    return ankle[:, 1] + np.sqrt(np.maximum(reach - flat, 1e-6)) - hip[:, 1]


def _even(values: Floats, phase: Floats) -> Floats:
    """Mean, second and fourth harmonic of one cycle: both steps alike, nothing jerky."""
    out = np.full(len(values), values.mean())
    for k in (2, 4):
        for part in (np.cos(2 * np.pi * k * phase), np.sin(2 * np.pi * k * phase)):
            out = out + 2 * (values @ part) / len(values) * part
    return out


def _foot_way(
    skeleton: Skeleton,
    leg: Leg,
    own: Floats,
    roll: _Roll,
    pace: _Pace,
    hip: Floats,
    start: float,
    floor: float,
) -> tuple[Floats, Floats, Floats]:
    """Ankle (F,3) less the way of the hips, the foot's world rotation (F,4) and the bend of its toes (F,)."""
    sign = 1.0 if leg.side == "l" else -1.0
    c = skeleton.centers
    thigh, knee, pitch = _legs_at(own, pace)
    ankle, bend = roll.at(pitch)
    stands = own < pace.stance
    # turned out about the toe joint: what the foot does about its place on the floor goes along its own line
    turn = sign * np.radians(6.0)
    beside = rotate(about(Y, turn), np.array([c[leg.ankle][0] - leg.pivot[0], 0.0, 0.0]))
    track = sign * (0.048 * leg.length / 0.85 + np.sin(np.radians(6.0)) * abs(roll.ankle[0]))
    eps, span = 1e-3, 1.0 - pace.stance
    ends = np.array([pace.stance - eps, pace.stance, 0.0])
    _, _, turned = _legs_at(ends, pace)
    edge, _ = roll.at(turned)
    s = np.clip((own - pace.stance) / span, 0.0, 1.0)
    near = np.where(stands, ankle[:, 0], edge[1, 0] + (edge[2, 0] - edge[1, 0]) * smooth(s))
    beyond = lambda n: np.stack([np.sin(turn) * n + beside[0] + track, (np.cos(turn) - 1) * n + beside[2]], axis=-1)  # noqa: E731
    ankle[:, 0] += -start - pace.stride * own
    edge_way = beyond(edge[:, 0])
    edge[:, 0] += -start - pace.stride * ends + edge_way[:, 1]
    # in the air: the normative knee and line of the leg, bent so that they go on from the standing leg
    order = np.argsort(own)
    loop = CubicSpline(
        np.append(own[order], 1 + own[order[0]]), np.vstack([hip[order], hip[order[:1]]]), bc_type="periodic"
    )
    hips = loop(np.array([pace.stance - eps, pace.stance, 1.0]))
    hips[2] = loop(own[order[0]]) if own[order[0]] == 0 else hips[2]
    held = _leg_angles(leg, edge - (hips[:, [2, 1]] - [0.0, floor]), hips[:, 0] - edge_way[:, 0])
    usual = _line_and_knee(leg, *_legs_at(np.array([pace.stance - eps, pace.stance, 1.0 - 1e-9]), pace)[:2])
    miss = held - usual
    push = 0.5 * (miss[1] - miss[0]) / eps  # half of it: the toes let go at once; heel strike is a small knock anyway
    t, early = s[:, None], np.minimum(s / 0.5, 1.0)[:, None]
    bridge = (2 * early**3 - 3 * early**2 + 1) * miss[1] + (early**3 - 2 * early**2 + early) * push * 0.5 * span
    bridge = bridge + (3 * t**2 - 2 * t**3) * miss[2]
    line, bent = np.moveaxis(_line_and_knee(leg, thigh, knee) + bridge, -1, 0)
    reach = leg.thigh**2 + leg.shank**2 + 2 * leg.thigh * leg.shank * np.cos(np.maximum(bent, np.radians(4.0)))
    way = beyond(near)
    far = np.sqrt(reach - (hip[:, 0] - way[:, 0]) ** 2)
    air = np.stack([hip[:, 2] + far * np.sin(line) - way[:, 1], hip[:, 1] - floor - far * np.cos(line)], axis=-1)
    ankle = np.where(stands[:, None], ankle, air)
    fly = s
    off = np.clip(-turned[1], 0.0, TOES_BEND)
    airy = off * (1 - smooth(fly / 0.4)) + 0.4 * turned[2] * smooth((fly - 0.5) / 0.5)
    bend = np.where(stands, np.where(pitch > 0, 0.4 * pitch, bend), airy)
    ankle[:, 1] += _clearance(roll, ankle, pitch, bend, fly)
    tuck = np.radians(4.0) * np.sin(np.pi * fly) ** 2
    foot = compose(np.full(len(own), turn), pitch, about(np.eye(3)[2], -sign * tuck))
    out = np.stack([way[:, 0], ankle[:, 1] + floor, ankle[:, 0] + way[:, 1]], axis=-1)
    return out, foot, bend


def _line_and_knee(leg: Leg, thigh: Floats, knee: Floats) -> Floats:
    """Direction of the line from hip to ankle and the knee's bend, (n,2), of thigh angles and knee bends (n,)."""
    line = thigh - np.arctan2(leg.shank * np.sin(knee), leg.thigh + leg.shank * np.cos(knee))
    return np.stack([line, knee], axis=-1)


def _leg_angles(leg: Leg, way: Floats, aside: Floats) -> Floats:
    """Direction of the line from hip to ankle (forward of straight down) and bend of the knee, (n,2) radians.

    way (n,2) is hip to ankle as z, y, aside (n,) its x.
    """
    far = np.sum(way**2, axis=1) + aside**2
    cosine = (far - leg.thigh**2 - leg.shank**2) / (2 * leg.thigh * leg.shank)
    return np.stack([np.arctan2(way[:, 0], -way[:, 1]), np.arccos(np.clip(cosine, -1.0, 1.0))], axis=-1)


def _clearance(roll: _Roll, ankle: Floats, pitch: Floats, bend: Floats, fly: Floats, least: float = 0.015) -> Floats:
    """How much higher (n,) the swinging foot has to go so that heel, ball and tip pass `least` over the floor."""
    joint = ankle - _pitched(roll.ankle, pitch)
    heel = joint + _pitched(roll.heel, pitch)
    tip = joint + _pitched(roll.tip, pitch + bend)
    ball = joint + _pitched(np.array([0.0, -roll.height]), pitch)
    low = np.minimum(np.minimum(heel, tip), ball)[:, 1]
    wanted = least * smooth(fly / 0.14) * smooth((1 - fly) / 0.2)
    return np.where((fly > 0) & (fly < 1), np.maximum(wanted - low, 0.0), 0.0)


def _too_far(steps: list, pace: _Pace, offset: Floats, move: Floats, feet: list) -> float:
    """How much (m) the hips have to sink so that both legs reach their feet whenever those stand."""
    sink = 0.0
    for (leg, own, _), (ankle, _, _) in zip(steps, feet):
        stands = own < pace.stance
        way = (offset[:, leg.hip] + move - ankle)[stands]
        reach = np.sqrt(np.maximum((STRAIGHT * leg.length) ** 2 - way[:, 0] ** 2 - way[:, 2] ** 2, 0.0))
        sink = max(sink, float((way[:, 1] - reach).max()))
    return sink
