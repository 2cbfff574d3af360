"""Legs that reach the ground: two-bone inverse kinematics and feet that stand still while they stand.

Source: note motion.md, 4.7 and 6 (closed form by the law of cosines with the knee as pole).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vitruvian.body.rotations import between, inverse, multiply, rotate, slerp
from vitruvian.body.types import Floats, Skeleton
from vitruvian.motion.contacts import Leg, floor_at_rest, runs, standing
from vitruvian.motion.turns import about, positions, unit

REACH = 0.995  # of the straight leg; beyond it knees lock and snap
UP = np.array([0.0, 1.0, 0.0])
STIFFEST = 0.15  # radians of bend that a straight knee counts as, where the hips go
CALM = 0.015  # seconds in which the hips' place may change
STAYS = 0.05  # how much they stay over the floor where they are


@dataclass(frozen=True, eq=False)
class Foothold:
    """When heel and ball of a foot stand on the ground: two flags (F,)."""

    heel: NDArray[np.bool_]
    ball: NDArray[np.bool_]


def two_bone(
    root: Floats, goal: Floats, pole: Floats, upper: float, lower: float, straight: ArrayLike = REACH
) -> tuple[Floats, Floats]:
    """Middle joint and end (...,3) of a chain of two bones from `root` to `goal`, bent towards `pole` (...,3).

    A goal out of reach is approached to `straight` (a number or (...)) of the whole length, one too near to the
    shortest fold.
    """
    way = goal - root
    far = np.linalg.norm(way, axis=-1, keepdims=True)
    along = np.where(far > 1e-9, way / np.maximum(far, 1e-9), -UP)
    reach = np.clip(far, abs(upper - lower) + 1e-6, np.asarray(straight)[..., None] * (upper + lower))
    side = pole - root
    normal = unit(side - along * np.sum(side * along, axis=-1, keepdims=True))
    a = (upper**2 - lower**2 + reach**2) / (2 * reach)
    h = np.sqrt(np.maximum(upper**2 - a**2, 0.0))
    return root + along * a + normal * h, root + along * reach


def bend_leg(
    skeleton: Skeleton,
    leg: Leg,
    world: Floats,
    hip: Floats,
    knee: Floats,
    ankle: Floats,
    foot: Floats,
    straight: ArrayLike = REACH,
) -> None:
    """Turn thigh, shank and foot in `world` (F,J,4), in place, so that the ankle comes to `ankle` (F,3).

    hip, knee (F,3): where they are now, the knee as pole. foot (F,4): the world rotation the foot gets.
    Thigh and shank are swung the shortest way, so the knee's axis stays with the leg.
    """
    c = skeleton.centers
    middle, end = two_bone(hip, ankle, knee, leg.thigh, leg.shank, straight)
    for joint, bone, way in (
        (leg.hip, c[leg.knee] - c[leg.hip], middle - hip),
        (leg.knee, c[leg.ankle] - c[leg.knee], end - middle),
    ):
        world[:, joint] = multiply(between(rotate(world[:, joint], bone), way), world[:, joint])
    world[:, leg.ankle] = foot


def heading(foot: Floats) -> tuple[Floats, Floats, Floats]:
    """Yaw, pitch (toes up is positive) (F,) and rest (F,4) of a foot's world rotation: foot = compose(yaw, pitch, rest).

    A foot that points straight down heads where its instep shows, and one that is bent back further still does.
    """
    front, up = rotate(foot, np.array([0.0, 0.0, 1.0])), rotate(foot, UP)
    steep = smooth((np.abs(front[..., 1]) - 0.8) / 0.15)
    beyond = (up[..., 1] < 0) & (np.abs(front[..., 1]) > 0.8)
    level = np.hypot(front[..., 0], front[..., 2])
    pitch = np.arctan2(front[..., 1], np.where(beyond, -level, level))
    flat = front / np.maximum(level, 1e-9)[..., None] * np.where(beyond, -1.0, 1.0)[..., None]
    instep = -np.sign(front[..., 1:2]) * up / np.maximum(np.hypot(up[..., 0], up[..., 2]), 1e-9)[..., None]
    ahead = flat + steep[..., None] * (instep - flat)
    yaw = np.arctan2(ahead[..., 0], ahead[..., 2])
    return yaw, pitch, multiply(inverse(compose(yaw, pitch)), foot)


def compose(yaw: Floats, pitch: Floats, rest: Floats | None = None) -> Floats:
    """World rotation (F,4) of a foot from its yaw, pitch and the rest (F,4), None: nothing."""
    x, y, _ = np.eye(3)
    turned = multiply(about(y, yaw), about(x, -np.asarray(pitch)))
    return turned if rest is None else multiply(turned, rest)


def ease(flags: NDArray[np.bool_], frames: float) -> Floats:
    """(F,) 1 where flags are set, falling smoothly to 0 within `frames` frames on either side."""
    count = len(flags)
    if not flags.any():
        return np.zeros(count)
    at = np.flatnonzero(flags)
    right = np.clip(np.searchsorted(at, np.arange(count)), 0, len(at) - 1)
    near = np.minimum(np.abs(at[right] - np.arange(count)), np.abs(at[np.maximum(right - 1, 0)] - np.arange(count)))
    return smooth(1.0 - near / max(frames, 1.0))


def smooth(t: Floats) -> Floats:
    """Smooth step from 0 (t <= 0) to 1 (t >= 1)."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3 - 2 * t)


def footholds(
    skeleton: Skeleton, world: Floats, move: Floats, limbs: tuple[Leg, ...], fps: float
) -> dict[str, Foothold]:
    """When heel and ball of each leg stand in a clip as it comes: world rotations (F,J,4), root translation (F,3)."""
    place = positions(skeleton.parents, skeleton.centers, world, move)
    out = {}
    for leg in limbs:
        foot, ankle = world[:, leg.ankle], place[:, leg.ankle]
        heel, ball = (
            standing(ankle + rotate(foot, p - skeleton.centers[leg.ankle]), fps, height=0.02)
            for p in (leg.heel, leg.pivot)
        )
        # an end of the foot that comes loose for a moment while the other stands has not been lifted
        for flags, other in ((heel, ball.copy()), (ball, heel.copy())):
            for start, stop in runs(~flags):
                if start > 0 and stop < len(flags) and stop - start < 0.15 * fps and other[start:stop].all():
                    flags[start:stop] = True
        out[leg.side] = Foothold(heel, ball)
    return out


def plant(
    skeleton: Skeleton,
    world: Floats,
    move: Floats,
    limbs: tuple[Leg, ...],
    holds: Mapping[str, Foothold],
    fps: float,
    *,
    blend: float = 0.08,
) -> tuple[Floats, Floats]:
    """Keep standing feet where they stand: new world rotations (F,J,4) and root translations (F,3).

    A foot whose heel and ball stand lies flat; one that stands on the ball keeps its toes flat. Between contacts the
    correction fades from one to the next, and no sole goes below the floor. The hips sink, smoothly, where a standing
    foot could not be reached; a swinging foot gives way instead.
    """
    world, move = world.copy(), move.copy()
    floor = floor_at_rest(skeleton)
    c = skeleton.centers
    place = positions(skeleton.parents, c, world, move)
    goals = {leg.side: _steps(skeleton, leg, world, place, holds[leg.side], floor, fps, blend) for leg in limbs}
    lean = _lean(place, limbs, goals, fps)
    move += lean
    place += lean[:, None]
    sink = np.zeros(len(move))
    # knees may be as straight as they are in the clip, but no straighter than that or REACH
    straight = {}
    for leg in limbs:
        far = np.linalg.norm(place[:, leg.ankle] - place[:, leg.hip], axis=1) / leg.length
        straight[leg.side] = np.clip(far, REACH, 0.9998)
    for leg in limbs:
        goal, _, hold = goals[leg.side]
        stands = hold.heel | hold.ball
        way = place[:, leg.hip] - goal
        flat = np.hypot(way[:, 0], way[:, 2])
        reach = np.sqrt(np.maximum((0.9999 * straight[leg.side] * leg.length) ** 2 - flat**2, 0.0))
        sink = np.maximum(sink, np.maximum(way[:, 1] - reach, 0.0) * ease(stands, blend * fps))
    sink = _over(sink, fps)
    move[:, 1] -= sink
    place[..., 1] -= sink[:, None]
    for leg in limbs:
        goal, foot, hold = goals[leg.side]
        before = world.copy()
        bend_leg(skeleton, leg, world, place[:, leg.hip], place[:, leg.knee], goal, foot, straight[leg.side])
        _carry(skeleton, leg.ankle, before, world)
        _flatten_toes(skeleton, leg, world, ease(hold.ball, blend * fps))
    return world, move


def _lean(
    place: Floats, limbs: tuple[Leg, ...], goals: Mapping[str, tuple[Floats, Floats, Foothold]], fps: float
) -> Floats:
    """(F,3) where the hips go, smoothly, for knees to stay as bent as they are over feet that are put down.

    Least squares over time: the length each leg asks for, the more the straighter it is (then millimetres cost degrees),
    against second differences and, on the floor, against going at all.
    """
    from scipy.linalg import solveh_banded

    count = len(place)
    shift = np.zeros((count, 3))
    smooth = (CALM * fps) ** 4
    for _ in range(2):
        normal, asked = np.zeros((count, 3, 3)), np.zeros((count, 3))
        for leg in limbs:
            goal = goals[leg.side][0]
            far = np.linalg.norm(place[:, leg.ankle] - place[:, leg.hip], axis=1)
            way = place[:, leg.hip] + shift - goal
            long = np.linalg.norm(way, axis=1)
            along = way / np.maximum(long, 1e-9)[:, None]
            bend = 2 * np.arccos(np.clip(far / leg.length, -1.0, 1.0))
            own = 1 / (bend + STIFFEST) ** 2
            wish = np.clip(far - long, -0.1 * leg.length, 0.1 * leg.length) + np.sum(along * shift, axis=1)
            normal += own[:, None, None] * along[:, :, None] * along[:, None, :]
            asked += (own * wish)[:, None] * along
        scale = max(float(normal[:, 1, 1].mean()), 1e-12)
        normal, asked = normal / scale + np.diag([STAYS, 1e-6, STAYS]), asked / scale
        bands = np.zeros((7, 3 * count))  # x, y, z of a frame, then of the next; from the diagonal down
        for row in range(3):
            for axis in range(3 - row):
                bands[row, axis::3] = normal[:, axis + row, axis]
        for row, column, value in ((0, 0, 1.0), (0, 1, 4.0), (0, 2, 1.0), (1, 0, -2.0), (1, 1, -2.0), (2, 0, 1.0)):
            bands[3 * row, 3 * column : 3 * (count - 2 + column)] += smooth * value
        shift = solveh_banded(bands, asked.ravel(), lower=True).reshape(count, 3)
    return shift


def _carry(skeleton: Skeleton, joint: int, before: Floats, world: Floats) -> None:
    """Joints below `joint` keep their local rotations after it was turned."""
    turned = {joint: multiply(world[:, joint], inverse(before[:, joint]))}
    for j in range(joint + 1, len(skeleton)):
        parent = int(skeleton.parents[j])
        if parent in turned:
            turned[j] = turned[parent]
            world[:, j] = multiply(turned[j], before[:, j])


def _flatten_toes(skeleton: Skeleton, leg: Leg, world: Floats, stands: Floats) -> None:
    """Toes lie on the floor while the ball of the foot stands."""
    yaw, _, _ = heading(world[:, leg.ankle])
    flat = about(UP, yaw)
    for toe in leg.toes:
        before = world.copy()
        world[:, toe] = slerp(world[:, toe], flat, stands)
        _carry(skeleton, toe, before, world)


def _steps(
    skeleton: Skeleton, leg: Leg, world: Floats, place: Floats, hold: Foothold, floor: float, fps: float, blend: float
) -> tuple[Floats, Floats, Foothold]:
    """Where the ankle shall be (F,3), the foot's world rotation (F,4), and when heel and ball stand after all."""
    c = skeleton.centers
    ankle = place[:, leg.ankle]
    raw_heel, raw_ball = (ankle + rotate(world[:, leg.ankle], p - c[leg.ankle]) for p in (leg.heel, leg.pivot))
    hold = _split(hold, (raw_heel, raw_ball), fps)
    yaw, pitch, rest = heading(world[:, leg.ankle])
    hold = _rolling(hold, pitch)
    on_heel, on_ball = ease(hold.heel, 0.5 * blend * fps), ease(hold.ball, blend * fps)
    pitch = np.maximum(pitch, 0.0) * (1 - on_ball) + np.minimum(pitch, 0.0) * (1 - on_heel)
    # who turns on one end of the foot keeps the other a little off the floor
    on_one = on_heel * (1 - on_ball) - on_ball * (1 - on_heel)
    pitch = pitch + on_one * np.maximum(np.radians(3.0) - np.abs(pitch), 0.0)
    rest = slerp(rest, np.array([0.0, 0.0, 0.0, 1.0]), np.maximum(on_heel, on_ball))
    foot = compose(_steady(np.unwrap(yaw), hold.heel & hold.ball, fps), pitch, rest)
    heel = ankle + rotate(foot, leg.heel - c[leg.ankle])
    ball = ankle + rotate(foot, leg.pivot - c[leg.ankle])
    stands = hold.heel | hold.ball
    delta = np.zeros_like(ankle)
    for start, stop in runs(stands):
        _hold(delta, start, stop, hold, heel, ball, floor, float(leg.pivot[1]))
    goal = ankle + _bridge(delta, stands)
    # the rest of the sole: toes as they are bent, until they lie flat
    toes = multiply(foot, multiply(inverse(world[:, leg.ankle]), world[:, leg.front]))
    toes = slerp(toes, about(UP, heading(foot)[0]), on_ball)
    ground = [heel[:, 1], *((ball + rotate(toes, p - leg.pivot))[:, 1] for p in (leg.ball, leg.tip))]
    lowest = np.min(ground, axis=0) + goal[:, 1] - ankle[:, 1]
    away = 1.0 - ease(stands, 0.07 * fps)  # swinging feet pass a little over the floor
    goal[:, 1] += np.maximum(floor + 0.015 * away - lowest, 0.0)
    return goal, foot, hold


def _split(
    hold: Foothold, ends: tuple[Floats, Floats], fps: float, drift: float = 0.05, pause: float = 0.1
) -> Foothold:
    """Contacts in which heel or ball (`ends`: paths (F,3)) go farther than `drift` (m) are cut where that is fastest.

    So slow steps, which never get faster than a contact may, become steps.
    """
    flags = (hold.heel.copy(), hold.ball.copy())
    half = max(1, int(round(0.5 * pause * fps)))
    for k, path in enumerate(ends):
        stack = runs(flags[k])
        while stack:
            start, stop = stack.pop()
            part = path[start:stop]
            if stop - start < 6 * half or np.linalg.norm(part - np.median(part, axis=0), axis=1).max() < drift:
                continue
            pace = np.linalg.norm(np.gradient(part, axis=0), axis=1)
            cut = start + 2 * half + int(np.argmax(pace[2 * half : -2 * half]))
            for end in flags:
                end[cut - half : cut + half] = False
            stack += [(start, cut - half), (cut + half, stop)]
    return Foothold(*flags)


def _rolling(hold: Foothold, pitch: Floats, limit: float = np.radians(1.5)) -> Foothold:
    """A foot that already rolls is not flat, slow as it may be: the heel is off, or the ball not yet down.

    Compared with the pitch that the foot has while it is flat, at the end and at the beginning of each contact.
    """
    heel, ball = hold.heel.copy(), hold.ball.copy()
    for start, stop in runs(hold.heel & hold.ball):
        part = pitch[start:stop] - np.median(pitch[start:stop])
        off = np.flatnonzero(part >= -limit)
        heel[start + off[-1] + 1 : stop] = False
        down = np.flatnonzero(part <= limit)
        ball[start : start + down[0]] = False
    return Foothold(heel, ball)


def _steady(yaw: Floats, flat: NDArray[np.bool_], fps: float, *, limit: float = np.radians(15.0)) -> Floats:
    """Flat feet do not turn: up to `limit` of turning is taken off; what turns more really turns."""
    change = np.zeros((len(yaw), 1))
    for start, stop in runs(flat):
        change[start:stop, 0] = np.clip(np.median(yaw[start:stop]) - yaw[start:stop], -limit, limit)
    return yaw + _bridge(change, flat)[:, 0]


def _hold(
    delta: Floats, start: int, stop: int, hold: Foothold, heel: Floats, ball: Floats, floor: float, high: float
) -> None:
    """Corrections (in place) that keep one contact, frames start..stop, on one spot: the ball's, else the heel's.

    `high` is the height of the toe joint when the foot stands.
    """
    part = slice(start, stop)
    on_ball = hold.ball[part]
    if not on_ball.any():
        delta[part] = np.median(heel[part], axis=0) - heel[part]
        delta[part, 1] = floor - heel[part, 1]
        return
    # runs of one kind, outwards from the longest on the ball: each takes over where its neighbour has put the foot
    pieces = sorted([(a, b, True) for a, b in runs(on_ball)] + [(a, b, False) for a, b in runs(~on_ball)])
    first = max((k for k, piece in enumerate(pieces) if piece[2]), key=lambda k: pieces[k][1] - pieces[k][0])
    a, b, _ = pieces[first]
    spot = np.median(ball[start + a : start + b], axis=0)
    for k in [first, *range(first + 1, len(pieces)), *range(first - 1, -1, -1)]:
        a, b, front = pieces[k]
        path, rise = (ball, high) if front else (heel, floor)
        rows = np.arange(start + a, start + b)
        if k != first:
            # the frame of the neighbour that is already put down
            edge = start + (a - 1 if k > first else b)
            spot = path[edge] + delta[edge]
        delta[rows] = spot - path[rows]
        delta[rows, 1] = rise - path[rows, 1]


def _bridge(delta: Floats, stands: NDArray[np.bool_]) -> Floats:
    """Corrections of the frames between contacts: a smooth way from the last to the next."""
    found = runs(stands)
    if not found:
        return delta
    out = delta.copy()
    out[: found[0][0]] = delta[found[0][0]]
    out[found[-1][1] :] = delta[found[-1][1] - 1]
    for (_, a), (b, _) in zip(found, found[1:]):
        t = smooth((np.arange(a, b) - a + 1) / (b - a + 1))[:, None]
        out[a:b] = delta[a - 1] * (1 - t) + delta[b] * t
    return out


def _over(value: Floats, fps: float) -> Floats:
    """A smooth curve that is nowhere below `value` (F,): sliding maximum, then a mean over the same window."""
    if not value.any():
        return value
    width = max(1, int(round(0.08 * fps)))
    window = np.lib.stride_tricks.sliding_window_view
    top = window(np.pad(value, width, mode="edge"), 2 * width + 1).max(axis=-1)
    kernel = np.hanning(2 * width + 3)[1:-1]
    return np.convolve(np.pad(top, width, mode="edge"), kernel / kernel.sum(), mode="valid")
