"""Inverse kinematics: joints turned, within their limits, so that Sites come to places.

Source: ISO/IEC 19774-1, Joint (llimit, ulimit, limitOrientation, stiffness) and Site (names ending in `_tip` are end
effectors); method: note motion.md, 6, solved by `vitruvian.motion.solver`.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vitruvian.body.rotations import normalize
from vitruvian.body.types import Body, Floats, Ints, Skeleton, floats
from vitruvian.errors import VitruvianError
from vitruvian.hanim.tables import canonical
from vitruvian.motion.limits import angles, rotations
from vitruvian.motion.names import VERTEBRAE
from vitruvian.motion.solver import LOOK, PLANE, POINT, TURN, Answer, Freedom, Prior, Wishes, limbs, solve
from vitruvian.motion.types import Motion

TOLERANCE = 1e-4  # metres
EASE = 3e-3  # metres^2 a radian^2: what turning costs on the way
PER_RADIAN = 0.1  # metres a radian: what a wrong turn counts
_WIDE, _NEAR, _BENT = np.radians([60.0, 3.0, 25.0])  # range, distance from its end, first bend of stretched joints
_FIELD = {POINT: "position", PLANE: "plane", TURN: "rotation", LOOK: "look_at"}
_TRUNK = {"humanoid_root", "sacroiliac", *VERTEBRAE}


@dataclass(frozen=True, eq=False)
class Goal:
    """What a Site, or a joint's centre, shall do; each array for one frame or (F,...) for all, in humanoid space, metres.

    position (3,): where it shall be. plane (4,): unit normal and distance from the origin of a plane it shall lie on.
    rotation (4,) xyzw: the turn from rest that its joint shall have, in the world.
    look_at (3,): what `axis` (3,), a direction at rest, shall point at from there. weight: of its squares among goals'.
    """

    position: ArrayLike | None = None
    plane: ArrayLike | None = None
    rotation: ArrayLike | None = None
    look_at: ArrayLike | None = None
    axis: ArrayLike = (0.0, 0.0, 1.0)
    weight: float = 1.0


@dataclass(frozen=True, eq=False)
class Reached(Motion):
    """The motion that reaches, and how well: residual (F,K) metres for `goals` (K,), reached (F,K), iterations (F,)."""

    goals: tuple[str, ...] = ()
    residual: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    reached: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), bool))
    iterations: Ints = field(default_factory=lambda: np.zeros(0, np.int32))


def reach(
    body: Body | Skeleton,
    pose: Motion | None,
    goals: Mapping[str, Goal | ArrayLike],
    *,
    joints: Iterable[str] | None = None,
    root: bool = False,
    tolerance: float = TOLERANCE,
    iterations: int = 50,
) -> Reached:
    """`pose` (None: the file's own) changed so that Sites or joints reach their goals, as well as limits let them.

    body: its skeleton's `llimit`, `ulimit`, `limitOrientation` bound each joint, `stiffness` says how much of a step each
    axis takes. goals: name of a Site or joint -> place (3,) or (F,3), humanoid space, or a `Goal`.
    joints: those that may turn; left out, those between each goal and the trunk; where the goal is on the trunk, neck
    or head all above it, or the neck alone when the head only has to turn. root: the first joint may turn and shift, too
    (then hold the feet by goals of their own). No joint turns farther from the pose than it takes.
    Frames are solved independently. What is out of reach ends at its nearest, and `reached`, `residual` say so.
    Raises VitruvianError for unknown names, for places that are not finite or not of as many frames as the pose has.
    """
    skeleton = body.skeleton if isinstance(body, Body) else body
    if pose is not None and pose.skeleton is not skeleton and pose.skeleton.names != skeleton.names:
        raise VitruvianError("pose: expected a motion on this skeleton, found one with other joints; retarget it first")
    if not goals:
        raise VitruvianError("goals: expected at least one {Site or joint: place}, found none")
    frames = 1 if pose is None else len(pose)
    spots = {name: spot(skeleton, name) for name in goals}
    asked = {n: g if isinstance(g, Goal) else Goal(position=g) for n, g in goals.items()}
    wishes, owner = _wishes(asked, spots, frames)
    freedom = Freedom(
        skeleton, _movers(skeleton, {spots[n][0]: _only_turns(g) for n, g in asked.items()}, joints, root), root
    )
    if pose is None:
        turn, shift = skeleton.rotation[None], skeleton.translation[None, 0]
    else:
        turn, shift = pose.rotation, pose.translation
        if pose.joint_translation is not None or pose.joint_scale is not None:
            raise VitruvianError("pose: expected turning joints only, found joint translations or scales over time")
    weights = np.array([goal.weight for goal in asked.values()])

    def residuals(error: Floats) -> Floats:
        missing = np.linalg.norm(error, axis=-1) / np.sqrt(weights[owner])
        return np.stack([missing[:, np.array(owner) == k].max(axis=1) for k in range(len(asked))], axis=1)

    def reaching(some: Wishes, start: Floats, near: Floats, place: Floats) -> Answer:
        """First about there without bending more than it takes, then all the way."""
        calm = Prior(near, place, EASE * (1 + 10 * skeleton.stiffness), EASE)
        eased = solve(freedom, some, start, place, prior=calm, iterations=iterations, idle=1e-3)
        return solve(freedom, some, eased.rotation, eased.shift, tolerance=tolerance, iterations=iterations)

    answer = reaching(wishes, turn, turn, shift)
    residual = residuals(answer.error)
    far = np.flatnonzero((residual > tolerance).any(axis=1))
    if len(far):
        bent = unlocked(freedom, turn[far])
        if bent is not None:
            some = replace(wishes, place=wishes.place[far], weight=wishes.weight[far])
            again = reaching(some, bent, turn[far], shift[far])
            better = (again.error**2).sum(axis=(1, 2)) < 0.99 * (answer.error[far] ** 2).sum(axis=(1, 2))
            won = far[better]
            answer.rotation[won], answer.shift[won] = again.rotation[better], again.shift[better]
            answer.steps[far] += again.steps
            residual[won] = residuals(again.error[better])
    return Reached(
        skeleton,
        30.0 if pose is None else pose.fps,
        answer.rotation,
        answer.shift,
        weights={} if pose is None else pose.weights,
        loop=pose is not None and pose.loop,
        name="" if pose is None else pose.name,
        notes=_said(tuple(asked), residual, tolerance),
        goals=tuple(asked),
        residual=residual,
        reached=residual <= tolerance,
        iterations=answer.steps,
    )


def unlocked(freedom: Freedom, rotation: Floats) -> Floats | None:
    """Rotations (F,J,4) with limbs that are stretched against a limit a little bent: a straight leg does not feel that
    bending the knee would shorten it. None where no joint is."""
    joint, axis = freedom.columns[freedom.columns[:, 0] >= 0].T
    box = freedom.box[joint, axis]
    wide = np.isfinite(box).all(axis=1) & (box[:, 1] - box[:, 0] > _WIDE)
    joint, axis, box = joint[wide], axis[wide], box[wide]
    angle = angles(freedom.skeleton, rotation)
    here = angle[:, joint, axis]
    low, high = here - box[:, 0] < _NEAR, box[:, 1] - here < _NEAR
    if not (low | high).any():
        return None
    angle[:, joint, axis] = here + _BENT * (low * 1.0 - high * 1.0)
    out = np.array(rotation)
    some = np.unique(joint)
    out[:, some] = rotations(freedom.skeleton, angle)[:, some]
    return out


def spot(skeleton: Skeleton, name: str) -> tuple[int, Floats]:
    """Joint and point, in humanoid space at rest, of what the name calls: a Site, or a joint's centre."""
    for candidate in (name, f"{name}_tip", f"{name}_pt", f"{name}_view"):
        if candidate in skeleton.site_index:
            s = skeleton.site_index[candidate]
            return int(skeleton.site_joints[s]), skeleton.site_points[s]
    joint = name if name in skeleton.index else canonical(name)
    if joint in skeleton.index:
        j = skeleton.index[joint]
        return j, skeleton.centers[j]
    standard = canonical(name, "site")
    for s, site in enumerate(skeleton.site_names):
        if standard is not None and canonical(site, "site") == standard:
            return int(skeleton.site_joints[s]), skeleton.site_points[s]
    near = difflib.get_close_matches(name, [*skeleton.site_names, *skeleton.names], 3, 0.5)
    raise VitruvianError(
        f"goals: expected a Site or joint of the body, found {name!r}{'; near: ' * bool(near)}{', '.join(near)}"
    )


def _only_turns(goal: Goal) -> bool:
    """Whether nothing has to come to a place."""
    return goal.position is None and goal.plane is None


def _movers(skeleton: Skeleton, ends: Mapping[int, bool], joints: Iterable[str] | None, root: bool) -> Ints:
    """The joints that may turn, parents first. ends: joint -> whether it only has to turn: then a head turns on its neck,
    and the trunk does not lean."""
    if joints is not None:
        named = list(joints)
        unknown = [n for n in named if n not in skeleton.index and canonical(n) not in skeleton.index]
        if unknown:
            raise VitruvianError(f"joints: the body has no joint {unknown[0]!r}")
        found = {skeleton.index.get(n, skeleton.index.get(canonical(n) or "", 0)) for n in named}
    else:
        found = set()
        for end, turns in ends.items():
            path = [int(j) for j in limbs(skeleton, [end]) if skeleton.parents[j] >= 0]
            names = {j: canonical(skeleton.names[j]) or "" for j in path}
            limb = [j for j in path if names[j] not in _TRUNK]
            head = bool(limb) and names[limb[0]] == "skullbase"
            if head and turns:
                limb = [j for j in path if names[j].startswith("vc")] + limb
            found.update(limb if limb and (turns or not head) else path)
    if root:
        found.add(0)
    return np.array(sorted(found), dtype=np.int32)


def _wishes(
    goals: Mapping[str, Goal], spots: Mapping[str, tuple[int, Floats]], frames: int
) -> tuple[Wishes, list[int]]:
    """Rows of wishes, and the goal that each belongs to."""
    rows, owner = [], []
    for number, (name, goal) in enumerate(goals.items()):
        joint, point = spots[name]
        given = [goal.position, goal.plane, goal.rotation, goal.look_at]
        if all(g is None for g in given):
            raise VitruvianError(f"goals: {name}: expected a position, plane, rotation or look_at, found none of them")
        if not (np.isfinite(goal.weight) and goal.weight > 0):
            raise VitruvianError(f"goals: {name}: expected a positive weight, found {goal.weight}")
        for kind, value in zip((POINT, PLANE, TURN, LOOK), given, strict=True):
            if value is None:
                continue
            place, axis = np.zeros((frames, 4)), np.zeros(3)
            wide = 4 if kind in (PLANE, TURN) else 3
            place[:, :wide] = _over_time(value, f"goals: {name}: {_FIELD[kind]}", frames, wide)
            size = float(goal.weight)
            if kind == PLANE:
                axis, distance = _direction(place[0, :3], f"goals: {name}: plane"), place[:, 3].copy()
                place = np.concatenate([axis * distance[:, None], np.zeros((frames, 1))], axis=1)
            elif kind == TURN:
                place, size = normalize(place), size * PER_RADIAN**2
            elif kind == LOOK:
                axis, size = (
                    _direction(np.asarray(goal.axis, dtype=np.float64), f"goals: {name}: axis"),
                    size * PER_RADIAN**2,
                )
            rows.append((kind, joint, point, axis, place, np.full(frames, size)))
            owner.append(number)
    kind, joint, point, axis, place, weight = zip(*rows)
    wishes = Wishes(
        np.array(kind, np.int32),
        np.array(joint, np.int32),
        np.array(point),
        np.array(axis),
        np.stack(place, axis=1),
        np.stack(weight, axis=1),
    )
    return wishes, owner


def _over_time(value: ArrayLike, name: str, frames: int, wide: int) -> Floats:
    """(F,wide) of one value for all frames or one for each."""
    array = np.asarray(value, dtype=np.float64)
    if array.shape not in ((wide,), (frames, wide)):
        raise VitruvianError(f"{name}: expected shape ({wide},) or ({frames}, {wide}), found {array.shape}")
    return floats(np.broadcast_to(array, (frames, wide)), name, frames, wide)


def _direction(value: Floats, name: str) -> Floats:
    size = float(np.linalg.norm(value))
    if value.shape != (3,) or not np.isfinite(size) or size < 1e-9:
        raise VitruvianError(f"{name}: expected a direction (3 numbers, not all zero), found {value}")
    return value / size


def _said(names: tuple[str, ...], residual: Floats, tolerance: float) -> tuple[str, ...]:
    worst = residual.max(axis=0)
    return tuple(
        f"{name} is not reached: {1000 * far:.1f} mm missing"
        + (f" in frame {residual[:, k].argmax()}" * (len(residual) > 1))
        for k, (name, far) in enumerate(zip(names, worst, strict=True))
        if far > tolerance
    )
