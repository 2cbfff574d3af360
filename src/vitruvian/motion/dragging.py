"""Dragging: handles on a body, and inverse kinematics that is prepared once and solved at every move of a pointer.

Source: ISO/IEC 19774-1, Joint (llimit, ulimit, limitOrientation, stiffness) and Site (`_tip`: end effectors); note
motion.md, 6. The solver is that of `vitruvian.motion.reach`; what it needs to know is bound when a drag begins.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.types import Floats, Ints, Skeleton
from vitruvian.errors import VitruvianError
from vitruvian.motion.names import VERTEBRAE, joint_index
from vitruvian.motion.reach import PER_RADIAN, unlocked
from vitruvian.motion.solver import POINT, TURN, Bound, Freedom, Place, Prior, Wishes, limbs
from vitruvian.motion.turns import world_rotations

HELD = 30.0  # the weight of what is held against what is dragged
LEVEL = 0.3  # of a wrong turn of feet and pelvis against a wrong place: they keep their turns where they can
NEAR = 1e-3  # metres: a goal that is missed by less is reached
REST = 3e-5  # metres^2 a radian^2: what a turn away from the start costs; it decides what the goals leave open
CLAVICLE = 10.0  # times that, where no limits hold it
STEPS = 8  # at most, of each solve: the next move of the pointer goes on from there
ENOUGH = 1e-3  # of the cost: a step that gains less is the last
_TRUNK = {"humanoid_root", "sacroiliac", *VERTEBRAE}
_ENDS = {"hand": ("radiocarpal", "elbow", "shoulder"), "foot": ("talocrural", "knee", "hip")}


@dataclass(frozen=True, eq=False)
class Handle:
    """A place of a body to take hold of.

    joint: what it rides on; point (3,): where, in humanoid space at rest, metres. moves (n,): joints that turn when it is
    dragged. main: of the whole body (hands, feet, head, pelvis); the others are tips of fingers and toes.
    keeps: its joint keeps its turn in the world where it can. shifts: the first joint turns and shifts with it.
    """

    name: str
    joint: int
    point: Floats
    moves: Ints
    main: bool = True
    keeps: bool = False
    shifts: bool = False


@dataclass(frozen=True, eq=False)
class Dragged:
    """A pose that a drag led to: rotation (J,4) local, shift (3,) translation of the first joint, and what is missing of
    each goal: residual (K,) metres, in the order of `Drag.names`."""

    rotation: Floats
    shift: Floats
    residual: Floats


def handles(skeleton: Skeleton) -> tuple[Handle, ...]:
    """Where a body can be taken hold of: hands, feet, head and pelvis, then its other end effectors (Sites `_tip`).

    A hand or foot that the skeleton lacks is the next joint up its limb. Bodies with joints that the standard does not
    know have their end effectors, moved by the joints down to the first fork, and the first joint.
    """
    index = joint_index(skeleton.names)
    known = {j: n for n, j in index.items()}
    out: list[Handle] = []
    ends: dict[int, str] = {}
    for part, joints in _ENDS.items():
        for side in "lr":
            found = next((index[f"{side}_{n}"] for n in joints if f"{side}_{n}" in index), -1)
            if found < 0:
                continue
            up = [j for j in _path(skeleton, found) if known.get(j, "") not in _TRUNK]
            foot = part == "foot" and known[found] == f"{side}_talocrural"
            moves = up if foot else up[1:]  # its own turn moves no wrist
            out.append(Handle(f"{side}_{part}", found, skeleton.centers[found], _ints(moves), keeps=foot))
            ends[found] = part
    if "skullbase" in index:
        head = index["skullbase"]
        tip = next((s for s, j in enumerate(skeleton.site_joints) if j == head and _is_tip(skeleton, s)), -1)
        point = skeleton.centers[head] if tip < 0 else skeleton.site_points[tip]
        out.append(Handle("head", head, point, _ints(_path(skeleton, head))))
        ends[head] = "head"
    out.append(Handle("pelvis", 0, skeleton.centers[0], _ints([0]), keeps=True, shifts=True))
    forks = {int(p) for p in skeleton.parents if p >= 0 and (skeleton.parents == p).sum() > 1}
    for s, name in enumerate(skeleton.site_names):
        joint = int(skeleton.site_joints[s])
        if not _is_tip(skeleton, s) or joint in ends or any(h.name == name for h in out):
            continue
        path = _path(skeleton, joint)
        stops = [k for k, j in enumerate(path) if j in ends or (not ends and j in forks)]
        moves = path[: stops[0]] if stops else path
        if moves:
            out.append(Handle(name, joint, skeleton.site_points[s], _ints(moves), main=False))
    return tuple(out)


class Drag:
    """Handles that are led somewhere from one pose on: made once, then `to` at every move.

    rotation (J,4), shift (3,): the pose; a joint takes part of what `reach` lets it. names: the handles that have goals;
    the first is dragged, the others are held and weigh more. Feet are held by themselves where the pelvis is dragged.
    still: joints that must not turn. moving (n,): those that may; shifts: whether the first joint shifts, too.
    What a pose leads to depends on the pose at the start, little on the way.
    Raises VitruvianError for unknown handles, and where no joint may move.
    """

    def __init__(
        self, skeleton: Skeleton, rotation: Floats, shift: Floats, names: Iterable[str], *, still: Iterable[int] = ()
    ):
        table = {h.name: h for h in handles(skeleton)}
        self.names = tuple(dict.fromkeys(names))
        for name in self.names:
            if name not in table:
                raise VitruvianError(f"handles: expected one of {', '.join(table)}, found {name!r:.60}")
        if not self.names:
            raise VitruvianError("handles: expected at least one that is dragged, found none")
        goals = [table[n] for n in self.names]
        self.shifts = any(h.shifts for h in goals)
        if self.shifts:
            goals += [h for n, h in table.items() if n.endswith("_foot") and n not in self.names]
        moving = {int(j) for h in goals for j in h.moves} - set(still)
        self.moving = _ints(sorted(moving))
        freedom = Freedom(skeleton, self.moving, self.shifts)
        if not len(freedom.columns):
            raise VitruvianError(f"handles: no joint that could bring {self.names[0]} anywhere may turn")
        self.rotation = np.array(rotation, dtype=np.float64)
        mats = pose_matrices(
            replace(skeleton, binding=None), rotation[None], skeleton.translation[None], root=shift[None]
        )
        world = world_rotations(skeleton.parents, rotation[None])[0]
        size = float(np.ptp(skeleton.centers, axis=0).max()) / 1.5  # of the humanoid's unit, which may not be the metre
        self.unit = size if size > 1e-6 else 1.0
        rows: list[tuple[int, Handle, list[float], float]] = []
        for k, h in enumerate(goals):
            here = mats[0, h.joint, :3, :3] @ h.point + mats[0, h.joint, :3, 3]
            rows.append((POINT, h, [*here, 0.0], HELD if k else 1.0))
            if h.keeps:
                rows.append((TURN, h, [*world[h.joint]], (LEVEL * PER_RADIAN * self.unit) ** 2))
        kind = _ints(row[0] for row in rows)
        self.place, self.weight = np.array([[row[2] for row in rows]]), np.array([[row[3] for row in rows]])
        self._rows = np.flatnonzero(kind == POINT)[: len(self.names)]
        self._root = np.sqrt(self.weight[0, self._rows])
        joint, point = _ints(row[1].joint for row in rows), np.array([row[1].point for row in rows])
        wishes = Wishes(kind, joint, point, np.zeros((len(rows), 3)), self.place, self.weight)
        calm = Prior(self.rotation[None], shift[None], REST * self.unit**2 * _calm(skeleton), REST)
        self._bound = Bound(freedom, wishes, calm)
        self._now = self._bound.state(self.rotation[None], shift[None])
        bent = unlocked(freedom, self.rotation[None])
        self._short = NEAR * self.unit
        self._other = self._now if bent is None else self._bound.state(bent, shift[None])

    def to(self, places: Mapping[str, Floats]) -> Dragged:
        """The pose that brings the handles to places (3,) in humanoid space, as well as limits let them.

        Names that are left out stay where they were asked to be last. Raises VitruvianError for a place that is not finite.
        """
        for k, name in enumerate(self.names):
            if name in places:
                place = np.asarray(places[name], dtype=np.float64)
                if place.shape != (3,) or not np.isfinite(place).all():
                    raise VitruvianError(f"handles: {name}: expected a place of 3 finite numbers, found {place}")
                self.place[0, self._rows[k], :3] = place
        self._now, cost, residual = self._solved(self._now)
        if residual.max() > 1.2 * self._short:  # a straight limb does not feel that bending would shorten it
            state, less, other = self._solved(self._other)
            if less < 0.99 * cost:
                self._now, residual = state, other
        self._short = max(float(residual.max()), NEAR * self.unit)  # what is out of reach is not tried again at once
        rotation = self.rotation.copy()
        rotation[self._bound.chain] = self._now.rotation[0]
        return Dragged(rotation, self._now.shift[0].copy(), residual)

    def _solved(self, start: Place) -> tuple[Place, float, Floats]:
        """The pose reached from a state, its cost, and what is missing of each goal (K,) metres."""
        state = Place(start.rotation.copy(), start.angle.copy(), start.shift.copy())
        error, _ = self._bound.run(
            state, self.place, self.weight, damping=1e-5, idle=ENOUGH, iterations=STEPS, threads=1
        )
        return state, float((error**2).sum()), np.linalg.norm(error[0, self._rows], axis=1) / self._root


def _calm(skeleton: Skeleton) -> Floats:
    """(J,3) how dear a turn about each axis is."""
    out = 1 + 10 * skeleton.stiffness
    for name, j in joint_index(skeleton.names).items():
        if name[2:] in ("sternoclavicular", "acromioclavicular"):
            out[j] *= np.where(np.isfinite(skeleton.limits[j]).all(axis=-1), 1.0, CLAVICLE)
    return out


def _path(skeleton: Skeleton, joint: int) -> list[int]:
    """From a joint up to below the root."""
    return [int(j) for j in limbs(skeleton, [joint])[::-1] if skeleton.parents[j] >= 0]


def _is_tip(skeleton: Skeleton, site: int) -> bool:
    return skeleton.site_names[site].endswith("_tip")


def _ints(values: Iterable[int]) -> Ints:
    return np.array(list(values), dtype=np.int32)
