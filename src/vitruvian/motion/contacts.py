"""Feet and the floor: soles of a skeleton, when a point stands still on the ground, how much a clip slides or sinks.

Source: note motion.md, 4.7 (thresholds and hysteresis).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.rotations import rotate
from vitruvian.body.types import Body, Floats, Skeleton
from vitruvian.hanim.tables import canonical
from vitruvian.motion.names import joint_index
from vitruvian.motion.turns import positions, world_rotations
from vitruvian.motion.types import Motion


@dataclass(frozen=True, eq=False)
class Leg:
    """One leg of a skeleton: joint indices, bone lengths (m) and the sole at rest.

    `toes` are the joints at the ball of the foot (none: the foot is one piece), `front` the one the foot rolls over
    (else the ankle) and `pivot` (3,) its centre. `heel`, `ball`, `tip` (3,) are points of the sole, all on the floor;
    heel moves with the ankle, ball and tip with `front`. Points are in humanoid space at rest.
    """

    side: str
    hip: int
    knee: int
    ankle: int
    toes: tuple[int, ...]
    front: int
    pivot: Floats
    heel: Floats
    ball: Floats
    tip: Floats
    thigh: float
    shank: float

    @property
    def length(self) -> float:
        """Hip to ankle when straight (m)."""
        return self.thigh + self.shank


def floor_at_rest(skeleton: Skeleton) -> float:
    """Height (m) of the floor under the resting figure: 0, unless its feet are clearly elsewhere."""
    y = np.concatenate([skeleton.centers[:, 1], skeleton.site_points[:, 1]])
    low, size = float(y.min()), max(float(np.ptp(y)), 1e-9)
    return 0.0 if -0.03 * size < low < 0.1 * size else low


def units_per_metre(skeleton: Skeleton) -> float:
    """1 for a figure in metres; else what makes its legs those of a person: cm, mm, dm, inches or, failing those, 0.85 m.

    Some files build in centimetres or units of their own and scale the Humanoid.
    """
    index, c = joint_index(skeleton.names), skeleton.centers
    if not all(f"l_{n}" in index for n in ("hip", "knee", "talocrural")):
        return 1.0
    hip, knee, ankle = (c[index[f"l_{n}"]] for n in ("hip", "knee", "talocrural"))
    length = float(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee))
    if 0.2 < length < 1.8 or length < 1e-9:
        return 1.0
    return next((u for u in (100.0, 1000.0, 10.0, 1 / 0.0254) if 0.6 < length / u < 1.1), length / 0.85)


def in_units(skeleton: Skeleton, factor: float) -> Skeleton:
    """The same skeleton with all lengths times `factor`."""
    lengths = {name: getattr(skeleton, name) * factor for name in ("centers", "translation", "site_points")}
    return replace(skeleton, **lengths)


def legs(skeleton: Skeleton, body: Body | None = None) -> tuple[Leg, ...]:
    """The legs that have hip, knee and ankle. With `body`, the soles are those of its skin."""
    index = joint_index(skeleton.names)
    floor = floor_at_rest(skeleton)
    found = []
    size = float(np.ptp(skeleton.centers[:, 1]))
    sites = {canonical(name, "site") or name: p for name, p in zip(skeleton.site_names, skeleton.site_points)}
    for side in "lr":
        chain = [index.get(f"{side}_{part}") for part in ("hip", "knee", "talocrural")]
        if None in chain:
            continue
        hip, knee, ankle = (int(i) for i in chain if i is not None)
        toes = tuple(index[n] for k in range(1, 6) if (n := f"{side}_metatarsophalangeal_{k}") in index)
        c = skeleton.centers
        middle = index.get(f"{side}_metatarsophalangeal_2", toes[0] if toes else None)
        # without a toe joint the foot is one stiff piece that rolls over its tip
        ball = c[middle] if middle is not None else c[ankle] + [0.0, 0.0, 0.09 * size]
        tip = sites.get(f"{side}_tarsal_distal_phalanx_2")
        tip = None if tip is None else tip + [0.0, 0.0, 0.008]  # the great toe, or a shoe, is a little longer
        heel = sites.get(f"{side}_calcaneus_posterior")
        if middle is None:
            tip = ball if tip is None else tip
            ball = tip
        tip = ball + [0.0, 0.0, 0.03 * size] if tip is None else tip
        heel = c[ankle] - [0.0, 0.0, 0.03 * size] if heel is None else heel + [0.0, 0.0, 0.004]
        points = [np.array([p[0], floor, p[2]]) for p in (heel, ball, tip)]
        points[0][0] = c[ankle][0]
        front = ankle if middle is None else int(middle)
        pivot = points[1] if middle is None else c[front]
        thigh, shank = (float(np.linalg.norm(c[b] - c[a])) for a, b in ((hip, knee), (knee, ankle)))
        found.append(Leg(side, hip, knee, ankle, toes, front, pivot, points[0], points[1], points[2], thigh, shank))
    return tuple(found if body is None else (_on_skin(leg, body) for leg in found))


def below(skeleton: Skeleton, joint: int) -> list[int]:
    """The joints that hang below `joint`, without itself, parents first."""
    found = {joint}
    for j in range(joint + 1, len(skeleton)):
        if int(skeleton.parents[j]) in found:
            found.add(j)
    return sorted(found - {joint})


def _on_skin(leg: Leg, body: Body) -> Leg:
    """The same leg with heel and tip where the skin of the sole begins and ends."""
    weights = body.skin.weights
    mine = np.zeros(len(body.skeleton))
    mine[[leg.ankle, *below(body.skeleton, leg.ankle)]] = 1.0
    part = np.bincount(weights.vertex, weights.weight * mine[weights.joint], minlength=len(weights))
    unit = units_per_metre(body.skeleton)
    sole = body.skin.rest[(part > 0.5) & (body.skin.rest[:, 1] < leg.heel[1] + 0.02 * unit)]
    if len(sole) < 3:
        return leg
    heel, tip = leg.heel.copy(), leg.tip.copy()
    heel[2], tip[2] = sole[:, 2].min() + 0.01 * unit, sole[:, 2].max() - 0.01 * unit
    return replace(leg, heel=heel, tip=tip)


def soled(body: Body) -> Skeleton:
    """The body's skeleton with a Site at heel and toe tip of each foot, taken from its skin where it brings none.

    Feet that are solved on it stand on the soles that are drawn.
    """
    skeleton = body.skeleton
    known = {canonical(name, "site") or name for name in skeleton.site_names}
    names, joints, points = list(skeleton.site_names), list(skeleton.site_joints), list(skeleton.site_points)
    for leg in legs(skeleton, body):
        for part, joint, point in (
            ("calcaneus_posterior", leg.ankle, leg.heel),
            ("tarsal_distal_phalanx_2", leg.front, leg.tip),
        ):
            if f"{leg.side}_{part}" not in known:
                names.append(f"{leg.side}_{part}")
                joints.append(joint)
                points.append(point)
    return replace(
        skeleton,
        site_names=tuple(names),
        site_joints=np.array(joints, np.int32),
        site_points=np.array(points, np.float64).reshape(-1, 3),
    )


def standing(
    points: Floats,
    fps: float,
    *,
    speed: float = 0.15,
    height: float = 0.05,
    shortest: float = 0.08,
    gap: float = 0.05,
) -> NDArray[np.bool_]:
    """(F,) in which frames a point (F,3) stands on the ground.

    It begins to stand below `speed` (m/s) and `height` (m over the lowest point within a second), stops at twice as
    much of either; rests shorter than `gap` (s) are closed and contacts shorter than `shortest` (s) dropped.
    """
    count = len(points)
    if count < 2:
        return np.ones(count, bool)
    pace = np.linalg.norm(np.gradient(points, axis=0), axis=1) * fps
    reach = int(round(fps))
    padded = np.pad(points[:, 1], reach, mode="edge")
    lowest = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1).min(axis=1)
    rise = points[:, 1] - lowest
    begins = (pace < speed) & (rise < height)
    keeps = (pace < 2 * speed) & (rise < 2 * height)
    # a run of `keeps` counts when it has a frame that begins it
    out = np.zeros(count, bool)
    for start, stop in runs(keeps):
        if begins[start:stop].any():
            first = start + int(np.argmax(begins[start:stop]))
            out[first:stop] = True
    for start, stop in runs(~out):
        if start > 0 and stop < count and stop - start < gap * fps:
            out[start:stop] = True
    for start, stop in runs(out):
        if stop - start < shortest * fps and start > 0 and stop < count:
            out[start:stop] = False
    return out


def runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Ranges (start, stop) in which flags are true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def sole_points(motion: Motion, body: Body | None = None) -> Floats:
    """Paths (F,n,3) of heel, ball and toe tip of each leg, in metres over the floor (y = 0 is the floor at rest)."""
    skeleton, unit = motion.skeleton, units_per_metre(motion.skeleton)
    world = world_rotations(skeleton.parents, motion.rotation)
    place = positions(skeleton.parents, skeleton.centers, world, motion.translation, motion.joint_translation)
    out = []
    for leg in legs(skeleton, body):
        for joint, point in ((leg.ankle, leg.heel), (leg.front, leg.ball), (leg.front, leg.tip)):
            out.append(place[:, joint] + rotate(world[:, joint], point - skeleton.centers[joint]))
    if not out:
        return np.zeros((len(motion), 0, 3))
    return (np.stack(out, axis=1) - [0.0, floor_at_rest(skeleton), 0.0]) / unit


def foot_slide_mm(motion: Motion, body: Body | None = None, *, touch: float = 0.005) -> float:
    """How far (mm per frame, largest) a point of a sole moves along the floor while it stands.

    Heel, ball and toe tip count, each when it stays within `touch` (m) of the floor for a tenth of a second or longer;
    the first and last thirtieth of a second, when it is put down and taken up, do not.
    """
    points = sole_points(motion, body)
    step = np.linalg.norm(np.diff(points, axis=0)[..., [0, 2]], axis=-1)
    edge = max(1, int(round(motion.fps / 30)))
    worst = 0.0
    for k in range(points.shape[1]):
        for start, stop in runs(points[:, k, 1] < touch):
            if stop - start >= 0.1 * motion.fps:
                worst = max(worst, float(step[start + edge : stop - 1 - edge, k].max(initial=0.0)))
    return 1000 * worst


def floor_penetration_mm(motion: Motion, body: Body | None = None) -> float:
    """How far (mm, largest) heel, ball or toe tip are below the floor; 0 when never."""
    return float(1000 * np.maximum(0.0, -sole_points(motion, body)[..., 1]).max(initial=0.0))
