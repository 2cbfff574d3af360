"""How long the performer's bones are, and where on them each marker sits.

Method: poses and lengths in turn. With the turns of all segments known, a marker's place is linear in the lengths of the
bones above it, in its own offset and in the root's place, so those come from one linear least squares problem over all
frames (note motion.md, 5.2: symmetric lengths, offsets near the feature point a marker is glued to).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.types import Floats, Ints, Skeleton
from vitruvian.errors import VitruvianError
from vitruvian.motion.names import VERTEBRAE, joint_index
from vitruvian.motion.solver import Freedom, Prior, Wishes, solve

ROUNDS = 12
SURE, LOOSE = 0.02, 0.12  # metres that markers at feature points, and others, may sit off where they are thought to be
CAREFUL = 0.6  # of a step: poses do not follow as straight as it takes them to
STOPPED = 1e3
NOISE = 0.005  # metres that a marker is away for reasons nobody models
UPRIGHT = 100.0  # how much more the back and head are held at rest than other joints
STRETCH = 0.15  # of the length of a bone against the whole body's


@dataclass(frozen=True, eq=False)
class Attachment:
    """Markers on a skeleton: joint (M,), point (M,3) in humanoid space at rest, sure (M,): glued to a feature point."""

    joint: Ints
    point: Floats
    sure: NDArray[np.bool_]


def groups(skeleton: Skeleton) -> list[str]:
    """The part of the body that each joint (J,) carries; both sides share a name."""
    index = joint_index(skeleton.names)
    first = {"humanoid_root": "pelvis", "skullbase": "head"}
    first |= {n: "neck" if n.startswith("vc") else "spine" for n in VERTEBRAE}
    for side in "lr":
        for name, part in (
            ("hip", "thigh"),
            ("knee", "shank"),
            ("talocrural", "foot"),
            ("sternoclavicular", "clavicle"),
            ("acromioclavicular", "clavicle"),
            ("shoulder", "upper arm"),
            ("elbow", "forearm"),
            ("radiocarpal", "hand"),
        ):
            first[f"{side}_{name}"] = part
    known = {j: first[n] for n, j in index.items() if n in first}
    out: list[str] = []
    for j, p in enumerate(skeleton.parents):
        out.append(known.get(j, out[p] if p >= 0 else "pelvis"))
    return out


def scaled(skeleton: Skeleton, factor: dict[str, float]) -> Skeleton:
    """The skeleton with the segments of each part longer by its factor; Sites go with them."""
    part = groups(skeleton)
    centers = skeleton.centers.copy()
    for j, p in enumerate(skeleton.parents):
        if p >= 0:
            centers[j] = centers[p] + factor[part[p]] * (skeleton.centers[j] - skeleton.centers[p])
    each = np.array([factor[g] for g in part])[skeleton.site_joints, None]
    sites = centers[skeleton.site_joints] + each * (skeleton.site_points - skeleton.centers[skeleton.site_joints])
    return replace(skeleton, centers=centers, site_points=sites)


def calibrated(
    skeleton: Skeleton, attachment: Attachment, points: Floats, movers: Ints, *, rest: float = 0.01
) -> tuple[Skeleton, Attachment, dict[str, float], tuple[Floats, Floats]]:
    """The skeleton and attachment that fit markers (F,M,3) best, the factors of its parts, and the poses found.

    `rest`: how near to the rest pose the performer stands, as a factor of what turns cost."""
    from vitruvian.motion.tracking import NEAR, aligned, calm

    part = groups(skeleton)
    names = sorted(set(part))
    size = _size(skeleton, attachment, points)
    factor = dict.fromkeys(names, size)
    offset = np.zeros_like(attachment.point)
    body, marks = _with(skeleton, attachment, factor, offset)
    rotation, shift = aligned(body, marks, points)
    weight = np.where(attachment.sure, 1.0, 0.02)
    still = np.tile([0.0, 0.0, 0.0, 1.0], (len(points), len(skeleton), 1))
    heft = NEAR * rest * calm(skeleton)
    heft[_upright(skeleton)] *= UPRIGHT
    heft[0] = 0.0
    asked = np.concatenate([points, np.zeros((*points.shape[:2], 1))], axis=2)
    for turn in range(ROUNDS):
        still[:, 0] = rotation[:, 0]
        wishes = _wishes(marks, asked, weight)
        freedom = Freedom(body, movers, True)
        near = Prior(still, shift, heft)
        answer = solve(freedom, wishes, rotation, shift, prior=near, iterations=40, idle=1e-6)
        rotation, shift = answer.rotation, answer.shift
        weight = np.where(attachment.sure, 1.0, min(1.0, 0.1 * 2**turn))
        pull = _pull(freedom, _wishes(marks, asked, weight), rotation, shift, still, heft)
        factor, offset = _lengths(skeleton, attachment, part, names, rotation, pull, factor, offset, size)
        body, marks = _with(skeleton, attachment, factor, offset)
    answer = solve(
        Freedom(body, movers, True),
        _wishes(marks, asked, weight),
        rotation,
        shift,
        prior=near,
        iterations=40,
        idle=1e-6,
    )
    return body, marks, factor, (answer.rotation, answer.shift)


def _upright(skeleton: Skeleton) -> Ints:
    """Vertebrae and head: how they are turned and where their markers sit look alike, so they are taken to be at rest."""
    index = joint_index(skeleton.names)
    return np.array([index[n] for n in (*VERTEBRAE, "skullbase") if n in index], np.int32)


def _wishes(marks: Attachment, asked: Floats, weight: Floats) -> Wishes:
    count = len(weight)
    return Wishes(
        np.zeros(count, np.int32),
        marks.joint,
        marks.point,
        np.zeros((count, 3)),
        asked,
        np.tile(weight, (len(asked), 1)),
    )


@dataclass(frozen=True, eq=False)
class Pull:
    """What is missing in each frame, and how turning the joints would change it: slope (F,3M,D) and error (F,3M), both
    weighted, hold (F,D) and drift (F,D): what turns cost and where they are, weight (F,M) of markers, 0 where missing."""

    slope: Floats
    error: Floats
    hold: Floats
    drift: Floats
    weight: Floats


def _pull(freedom: Freedom, wishes: Wishes, rotation: Floats, shift: Floats, still: Floats, heft: Floats) -> Pull:
    from vitruvian.motion.limits import angles
    from vitruvian.motion.solver import Near
    from vitruvian.motion.solver_numpy import State, _drift, _errors, _slopes

    skeleton = replace(freedom.skeleton, binding=None)
    freedom = Freedom(skeleton, freedom.joints, True)
    state = State(rotation, shift, angles(skeleton, rotation))
    everyone = np.arange(len(rotation))
    mats = pose_matrices(skeleton, rotation, skeleton.translation[None], root=shift)
    joint, axis = freedom.columns.T
    hold = np.where(joint < 0, 0.0, heft[joint, axis])
    near = Near(still, angles(skeleton, still), shift, hold)
    seen = np.isfinite(wishes.place).all(axis=2)
    box = freedom.box[joint, axis]
    here = state.angle[:, joint, axis]
    stopped = (joint >= 0) & ((here <= box[:, 0] + 1e-6) | (here >= box[:, 1] - 1e-6))
    hold = hold + STOPPED * stopped  # what is at its limit does not give way
    return Pull(
        _slopes(freedom, wishes, mats, state, everyone),
        _errors(wishes, mats, everyone),
        hold,
        _drift(freedom, state, near, everyone),
        np.where(seen, np.sqrt(wishes.weight), 0.0),
    )


def _with(
    skeleton: Skeleton, attachment: Attachment, factor: dict[str, float], offset: Floats
) -> tuple[Skeleton, Attachment]:
    body = scaled(skeleton, factor)
    part = groups(skeleton)
    each = np.array([factor[part[j]] for j in attachment.joint])[:, None]
    local = attachment.point - skeleton.centers[attachment.joint]
    return body, replace(attachment, point=body.centers[attachment.joint] + each * local + offset)


def _size(skeleton: Skeleton, attachment: Attachment, points: Floats) -> float:
    """How large the performer is against the body: distances between markers of one segment, else the spread of all."""
    ratios = []
    for joint in np.unique(attachment.joint):
        some = np.flatnonzero((attachment.joint == joint) & attachment.sure)
        for i, a in enumerate(some):
            for b in some[i + 1 :]:
                there = float(np.linalg.norm(attachment.point[a] - attachment.point[b]))
                here = np.linalg.norm(points[:, a] - points[:, b], axis=1)
                if there > 0.1 and np.isfinite(here).any():
                    ratios.append((float(np.nanmedian(here)) / there, there))
    tall = np.nanmax(points[..., 1], axis=1) - np.nanmin(points[..., 1], axis=1)
    rest = float(np.ptp(attachment.point[:, 1]))
    ratios.append((float(np.nanmax(tall)) / max(rest, 1e-3), rest))
    value, weight = np.array(ratios).T
    order = np.argsort(value)
    middle = np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2)
    found = float(value[order][min(middle, len(value) - 1)])
    if not 0.2 < found < 2.0:
        raise VitruvianError(f"markers: they would make a person {found:.3g} times the size of the body; say unit=")
    return float(np.clip(found, 0.3, 1.6))


def _lengths(
    skeleton: Skeleton,
    attachment: Attachment,
    part: list[str],
    names: list[str],
    rotation: Floats,
    pull: Pull,
    factor: dict[str, float],
    offset: Floats,
    size: float,
) -> tuple[dict[str, float], Floats]:
    """Factors of parts, and offsets of markers (M,3) in the frames of their joints at rest, after one step of all of them
    and all poses together: the turns of each frame are eliminated (variable projection)."""
    frames, count = pull.weight.shape
    spin = pose_matrices(replace(skeleton, binding=None), rotation, skeleton.translation[None])[..., :3, :3]
    column = {g: i for i, g in enumerate(names)}
    # reach (F,J,G,3): how the centre of each joint moves with the factors
    reach = np.zeros((frames, len(skeleton), len(names), 3))
    for j, p in enumerate(skeleton.parents):
        if p >= 0:
            reach[:, j] = reach[:, p]
            reach[:, j, column[part[p]]] += spin[:, p] @ (skeleton.centers[j] - skeleton.centers[p])
    own = reach[:, attachment.joint].copy()
    for k, j in enumerate(attachment.joint):
        own[:, k, column[part[j]]] += spin[:, j] @ (attachment.point[k] - skeleton.centers[j])
    parts, wide = len(names), len(names) + 3 * count
    rows = np.zeros((frames, count, 3, wide))
    rows[..., :parts] = np.moveaxis(own, 2, 3)
    for k in range(count):
        rows[:, k, :, parts + 3 * k : parts + 3 * k + 3] = spin[:, attachment.joint[k]]
    rows = (rows * pull.weight[..., None, None]).reshape(frames, 3 * count, wide)
    sigma = np.where(attachment.sure, SURE, LOOSE)
    # a marker's residual counts once in every frame, and so does what is known beforehand
    prior = np.concatenate([np.full(parts, NOISE / (STRETCH * size)), np.repeat(NOISE / sigma, 3)]) ** 2 * frames
    now = np.concatenate([[factor[g] for g in names], offset.ravel()])
    goal = np.concatenate([np.full(parts, size), np.zeros(3 * count)])
    back = np.swapaxes(pull.slope, 1, 2)
    turns = back @ pull.slope + np.eye(pull.hold.shape[1]) * (pull.hold[:, None] + 1e-9)
    mixed = back @ rows
    pose_pull = (back @ pull.error[..., None])[..., 0] - pull.hold * pull.drift
    solved = np.linalg.solve(turns, np.concatenate([mixed, pose_pull[..., None]], axis=2))
    normal = np.einsum("frx,fry->xy", rows, rows) - np.einsum("fdx,fdy->xy", mixed, solved[..., :-1])
    right = np.einsum("frx,fr->x", rows, pull.error) - np.einsum("fdx,fd->x", mixed, solved[..., -1])
    normal[np.arange(wide), np.arange(wide)] += prior
    step = np.linalg.solve(normal, right + prior * (goal - now))
    step *= min(1.0, 0.15 * size / max(float(np.abs(step[:parts]).max()), 1e-12))
    after = now + CAREFUL * step
    return (
        {g: float(np.clip(after[i], 0.5 * size, 1.8 * size)) for i, g in enumerate(names)},
        after[parts:].reshape(count, 3),
    )
