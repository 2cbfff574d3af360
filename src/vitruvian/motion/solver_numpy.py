"""The twin of the kernel of `vitruvian.motion.solver`: the same steps for all frames side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.kinematics import bound_kinematics
from vitruvian.body.rotations import from_matrix, from_vector, inverse, multiply, to_matrix, to_vector
from vitruvian.body.types import Floats, Ints, Skeleton
from vitruvian.motion.limits import rotations
from vitruvian.motion.solver import LOOK, PLANE, POINT, TURN, Freedom, Near, Wishes

Whole = NDArray[np.signedinteger]
_SWEEPS = 3  # of a step: those that run into limits stay there, the others are asked again
_LONGEST = 0.7  # radians or metres of a step: farther away the slopes mean nothing
_STUCK = 1e12  # damping at which no step helps


@dataclass(frozen=True, eq=False)
class State:
    """Local rotations (F,J,4), translation of the first joint (F,3) and, for limited joints, their angles (F,J,3)."""

    rotation: Floats
    shift: Floats
    angle: Floats

    def at(self, frames: NDArray[np.bool_] | Whole) -> State:
        return State(self.rotation[frames], self.shift[frames], self.angle[frames])

    def put(self, frames: Whole, other: State) -> None:
        self.rotation[frames], self.shift[frames], self.angle[frames] = other.rotation, other.shift, other.angle


def solve_poses(
    freedom: Freedom,
    wishes: Wishes,
    rotation: Floats,
    shift: Floats,
    angle: Floats,
    near: Near | None,
    tolerance: float,
    damping: float,
    idle: float,
    iterations: int,
) -> tuple[Floats, Ints]:
    """Changes rotation (F,J,4), shift (F,3) and angle (F,J,3); error (F,K,3) and tried steps (F,)."""
    forward = bound_kinematics(freedom.skeleton)
    still = np.repeat(freedom.skeleton.translation[None], len(rotation), axis=0)

    def matrices(state: State) -> Floats:
        move = still[: len(state.shift)].copy()
        move[:, 0] = state.shift
        return forward(np.ascontiguousarray(state.rotation), move)

    everyone = np.arange(len(rotation))
    state = State(rotation, shift, angle)
    column = _Columns(freedom, state)
    mats = matrices(state)
    error = _errors(wishes, mats, everyone)
    drift = _drift(freedom, state, near, everyone)
    cost = _cost(error, drift, near)
    mu, count = np.full(len(rotation), damping), np.zeros(len(rotation), np.int32)
    busy = (_unmet(error, tolerance) | (near is not None)) & bool(len(freedom.columns))
    for _ in range(iterations):
        now = np.flatnonzero(busy)
        if not len(now):
            break
        part = state.at(now)
        slope = _slopes(freedom, wishes, mats[now], part, now)
        step = _step(slope, error[now], mu[now], column, part, now, drift[now], near)
        trial = column.moved(part, step, now)
        new = matrices(trial)
        missing, gap = _errors(wishes, new, now), _drift(freedom, trial, near, now)
        then = _cost(missing, gap, near)
        better = then < cost[now]
        won = now[better]
        over = np.abs(step).max(axis=1) < 1e-6
        over[better] |= cost[won] - then[better] <= idle * then[better]
        state.put(won, trial.at(better))
        column.narrow(state, won)
        mats[won], error[won], drift[won], cost[won] = new[better], missing[better], gap[better], then[better]
        mu[now] = np.where(better, np.maximum(mu[now] * 0.2, 1e-12), np.maximum(mu[now], 1e-9) * 8)
        count[now] += 1
        busy[now] = ~over & (mu[now] <= _STUCK) & (_unmet(error[now], tolerance) | (near is not None))
    return error.reshape(len(error), -1, 3), count


class _Columns:
    """How numbers change a state, and within which bounds, which close behind a state that was beyond its limits."""

    def __init__(self, freedom: Freedom, state: State):
        self.freedom = freedom
        joint, axis = freedom.columns.T
        self.angle = np.flatnonzero((joint >= 0) & freedom.limited[joint])
        self.free = np.flatnonzero((joint >= 0) & ~freedom.limited[joint])
        self.shift = np.flatnonzero(joint < 0)
        self.joint, self.axis = joint, axis
        self.bent = np.unique(joint[self.angle])
        self.loose = np.unique(joint[self.free])
        box = freedom.box[joint[self.angle], axis[self.angle]]
        here = state.angle[:, joint[self.angle], axis[self.angle]]
        self.limit = box
        self.low, self.high = np.minimum(box[:, 0], here), np.maximum(box[:, 1], here)

    def narrow(self, state: State, frames: Whole) -> None:
        here = state.angle[frames][:, self.joint[self.angle], self.axis[self.angle]]
        self.low[frames] = np.maximum(self.low[frames], np.minimum(self.limit[:, 0], here))
        self.high[frames] = np.minimum(self.high[frames], np.maximum(self.limit[:, 1], here))

    def room(self, state: State, frames: Whole) -> tuple[Floats, Floats]:
        """(f,D) how far each number may fall and rise."""
        down = np.full((len(frames), len(self.joint)), -np.inf)
        up = -down
        here = state.angle[:, self.joint[self.angle], self.axis[self.angle]]
        down[:, self.angle], up[:, self.angle] = self.low[frames] - here, self.high[frames] - here
        return np.minimum(down, 0.0), np.maximum(up, 0.0)

    def moved(self, state: State, step: Floats, frames: Whole) -> State:
        rotation, shift, angle = state.rotation.copy(), state.shift.copy(), state.angle.copy()
        if len(self.angle):
            here = angle[:, self.joint[self.angle], self.axis[self.angle]] + step[:, self.angle]
            angle[:, self.joint[self.angle], self.axis[self.angle]] = np.clip(here, self.low[frames], self.high[frames])
            some = _of(self.freedom.skeleton, self.bent)
            rotation[:, self.bent] = rotations(some, angle[:, self.bent])
        if len(self.free):
            turn = np.zeros((len(step), len(self.freedom.skeleton), 3))
            turn[:, self.joint[self.free], self.axis[self.free]] = step[:, self.free]
            rotation[:, self.loose] = multiply(from_vector(turn[:, self.loose]), rotation[:, self.loose])
        if len(self.shift):
            shift = shift + step[:, self.shift]
        return State(rotation, shift, angle)


def _of(skeleton: Skeleton, joints: Ints) -> Skeleton:
    """Those joints alone, without parents: for what concerns single joints."""
    return Skeleton(
        tuple(skeleton.names[j] for j in joints),
        np.full(len(joints), -1, np.int32),
        skeleton.centers[joints],
        limits=skeleton.limits[joints],
        limit_orientation=skeleton.limit_orientation[joints],
    )


def _errors(wishes: Wishes, mats: Floats, frames: Whole) -> Floats:
    """(f,3K) what is missing, weighted."""
    points, place = _points(wishes, mats), wishes.place[frames]
    out = place[..., :3] - points
    for k in np.flatnonzero(wishes.kind != POINT):
        goal = place[:, k]
        if wishes.kind[k] == PLANE:
            out[:, k] = (out[:, k] @ wishes.axis[k])[:, None] * wishes.axis[k]
        elif wishes.kind[k] == TURN:
            there = from_matrix(_straight(mats[:, wishes.joint[k], :3, :3]))
            known = np.isfinite(goal).all(axis=-1, keepdims=True)
            out[:, k] = np.where(known, to_vector(_short(multiply(np.where(known, goal, there), inverse(there)))), 0.0)
        else:
            out[:, k] = _turn_to(_looks(wishes, mats, k), _unit(goal[:, :3] - points[:, k]))
    return np.asarray(np.nan_to_num(out * np.sqrt(wishes.weight[frames])[..., None]).reshape(len(frames), -1))


def _points(wishes: Wishes, mats: Floats) -> Floats:
    own = mats[:, wishes.joint]
    return np.asarray(np.einsum("fkij,kj->fki", own[..., :3, :3], wishes.point) + own[..., :3, 3])


def _looks(wishes: Wishes, mats: Floats, k: np.signedinteger) -> Floats:
    """(f,3) where wish k looks."""
    return _unit(mats[:, wishes.joint[k], :3, :3] @ wishes.axis[k])


def _turn_to(now: Floats, want: Floats) -> Floats:
    """(f,3) shortest rotation vectors between unit directions; straight behind: one of the ways round."""
    normal = np.cross(now, want)
    size = np.linalg.norm(normal, axis=-1, keepdims=True)
    angle = np.arctan2(size, np.sum(now * want, axis=-1, keepdims=True))
    other = _unit(np.cross(now, np.where(np.abs(now[..., 1:2]) < 0.9, [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])))
    return np.asarray(np.where(size > 1e-9, normal / np.maximum(size, 1e-12), other) * angle)


def _slopes(freedom: Freedom, wishes: Wishes, mats: Floats, state: State, frames: Whole) -> Floats:
    """(f,3K,D): how what `_errors` misses falls with each number."""
    skeleton = freedom.skeleton
    joint, axis = freedom.columns.T
    spin = _spins(freedom, mats, state)
    center = np.einsum("fdij,dj->fdi", mats[:, joint, :3, :3], skeleton.centers[joint]) + mats[:, joint][..., :3, 3]
    points = _points(wishes, mats)
    rows = np.cross(spin[:, None], points[:, :, None] - center[:, None])
    shifts = joint < 0
    rows[:, :, shifts] = np.eye(3)[axis[shifts]]
    for k in np.flatnonzero(wishes.kind != POINT):
        if wishes.kind[k] == PLANE:
            rows[:, k] = (rows[:, k] @ wishes.axis[k])[..., None] * wishes.axis[k]
            continue
        rows[:, k] = spin
        if wishes.kind[k] == LOOK:
            now = _looks(wishes, mats, k)[:, None]
            rows[:, k] -= np.sum(spin * now, axis=-1, keepdims=True) * now
    asked = np.isfinite(wishes.place[frames]).all(axis=-1) * np.sqrt(wishes.weight[frames])
    rows = np.where(freedom.above[wishes.joint][None, :, :, None], rows, 0.0) * asked[..., None, None]
    return np.asarray(np.moveaxis(rows, 2, 3).reshape(len(frames), -1, len(joint)))


def _spins(freedom: Freedom, mats: Floats, state: State) -> Floats:
    """(f,D,3) the world axis each number turns about; zero for shifts."""
    skeleton = freedom.skeleton
    joint, axis = freedom.columns.T
    parent = skeleton.parents[joint]
    above = _straight(np.where((parent < 0)[:, None, None], np.eye(3), mats[:, parent, :3, :3]))
    local = np.broadcast_to(np.eye(3)[axis], (len(mats), len(joint), 3)).copy()
    bent = np.flatnonzero((joint >= 0) & freedom.limited[joint])
    if len(bent):
        j, a = joint[bent], axis[bent]
        y, z = state.angle[:, j, 1], state.angle[:, j, 2]
        turned = np.zeros((len(mats), len(bent), 3))  # Rz Ry ex, Rz ey, ez
        turned[..., 0] = np.where(a == 0, np.cos(z) * np.cos(y), np.where(a == 1, -np.sin(z), 0.0))
        turned[..., 1] = np.where(a == 0, np.sin(z) * np.cos(y), np.where(a == 1, np.cos(z), 0.0))
        turned[..., 2] = np.where(a == 0, -np.sin(y), np.where(a == 1, 0.0, 1.0))
        local[:, bent] = np.einsum("dij,fdj->fdi", to_matrix(skeleton.limit_orientation[j]), turned)
    return np.where((joint < 0)[:, None], 0.0, np.einsum("fdij,fdj->fdi", above, local))


def _step(
    slope: Floats,
    error: Floats,
    mu: Floats,
    column: _Columns,
    state: State,
    frames: Whole,
    drift: Floats,
    near: Near | None,
) -> Floats:
    """(f,D) the damped step within the limits."""
    give = np.sqrt(column.freedom.give)
    scaled = slope * give
    back = np.swapaxes(scaled, 1, 2)
    normal = back @ scaled
    pull = (back @ error[..., None])[..., 0]
    size = np.trace(normal, axis1=1, axis2=2) / max(slope.shape[1], 1)
    if near is not None:
        normal[:, np.arange(len(give)), np.arange(len(give))] += near.weight * give**2
        pull = pull - near.weight * drift * give
    down, up = column.room(state, frames)
    held = ((down >= 0) & (pull < 0)) | ((up <= 0) & (pull > 0))
    fixed: Floats = np.zeros(pull.shape)
    out: Floats = fixed
    eye = np.eye(len(give))
    for _ in range(_SWEEPS):
        free = ~held
        lam = np.maximum(mu * size, 1e-15)
        a = normal * (free[:, :, None] & free[:, None, :]) + eye * np.where(free, lam[:, None], 1.0)[:, None, :]
        b = np.where(free, pull - (normal @ (fixed * held)[..., None])[..., 0], fixed)
        out = np.asarray(np.linalg.solve(a, b[..., None])[..., 0], dtype=np.float64)
        over = free & ((out * give < down - 1e-15) | (out * give > up + 1e-15))
        if not over.any():
            break
        fixed = np.where(over, np.clip(out * give, down, up) / give, fixed)
        held = held | over
    step = np.clip(out * give, down, up)
    largest = np.abs(step).max(axis=1, keepdims=True)
    return step * np.where(largest > _LONGEST, _LONGEST / np.maximum(largest, _LONGEST), 1.0)


def _drift(freedom: Freedom, state: State, near: Near | None, frames: Whole) -> Floats:
    """(f,D) how far the state is from the prior, in columns."""
    joint, axis = freedom.columns.T
    out = np.zeros((len(frames), len(joint)))
    if near is None:
        return out
    turning = joint >= 0
    bent, free = np.flatnonzero(turning & freedom.limited[joint]), np.flatnonzero(turning & ~freedom.limited[joint])
    gap = state.angle[:, joint[bent], axis[bent]] - near.angle[frames][:, joint[bent], axis[bent]]
    out[:, bent] = (gap + np.pi) % (2 * np.pi) - np.pi
    turn = to_vector(_short(multiply(state.rotation, inverse(near.rotation[frames]))))
    out[:, free] = turn[:, joint[free], axis[free]]
    out[:, ~turning] = (state.shift - near.shift[frames])[:, axis[~turning]]
    return out


def _cost(error: Floats, drift: Floats, near: Near | None) -> Floats:
    out = np.einsum("fr,fr->f", error, error)
    return out if near is None else out + np.einsum("fd,d,fd->f", drift, near.weight, drift)


def _unmet(error: Floats, tolerance: float) -> NDArray[np.bool_]:
    """(f,) whether a wish is missed by more than the tolerance."""
    missing = np.linalg.norm(error.reshape(len(error), -1, 3), axis=-1)
    return np.asarray((missing > tolerance).any(axis=1))


def _straight(linear: Floats) -> Floats:
    """Matrices (...,3,3) with columns of length one: scale taken out."""
    return np.asarray(linear / np.maximum(np.linalg.norm(linear, axis=-2, keepdims=True), 1e-12))


def _unit(v: Floats) -> Floats:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12))


def _short(q: Floats) -> Floats:
    """The same rotations with w >= 0."""
    return np.where(q[..., 3:] < 0, -q, q)
