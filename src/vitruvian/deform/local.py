"""Joint-dependent local deformations: an operator has a domain, a set of joints, parameters, and a value.

An actor carries several. The domain is a uniquely defined part of the surface; the value depends on nothing but the
angles of the operator's own joints, and whatever is above them carries it along. Weighted skin, contours, hands and
displacers are all of this kind: `local_operators` shows a bound deformer as what it consists of, `Composed` makes one
out of any that have a domain in common with no other and cover the surface together.

Source: N. Magnenat-Thalmann, D. Thalmann, joint-dependent local deformations (1987), as in "Simulation of object and
human skin deformations in a grasping task" (1989), section 2.1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vitruvian.body.rotations import from_matrix, from_vector, to_matrix, to_vector
from vitruvian.body.types import Body, Floats, Ints, Skeleton, require
from vitruvian.deform.contours import ContourOperator
from vitruvian.deform.deformer import Deformer
from vitruvian.deform.hands import HandOperator, HandProgram, place
from vitruvian.deform.operators import Operator
from vitruvian.errors import VitruvianError

Single = NDArray[np.float32]


class LocalOperator(Protocol):
    """What every joint-dependent local deformation has.

    domain (n,): vertices. joints (k,): the joints it depends on, parents first. anchor: the joint that carries its value
    along, -1 for none. parameters: what an animator may change. `adds`: its value is added to another operator's.
    """

    @property
    def name(self) -> str: ...

    @property
    def domain(self) -> Ints: ...

    @property
    def joints(self) -> Ints: ...

    @property
    def anchor(self) -> int: ...

    @property
    def parameters(self) -> Mapping[str, object]: ...

    @property
    def adds(self) -> bool: ...

    def evaluate(self, angles: ArrayLike) -> Floats:
        """(n,3) positions, or offsets when it `adds`, for angles (k,3): the turn of each joint against its parent as
        axis times radians. With a leading axis of frames (F,k,3) -> (F,n,3). As if `anchor` were at rest."""


@dataclass(frozen=True, eq=False)
class Bound:
    """The part of a bound deformer that moves `domain`."""

    name: str
    domain: Ints
    joints: Ints
    anchor: int
    skeleton: Skeleton
    rest: Floats
    operator: Operator
    parameters: Mapping[str, object] = field(default_factory=dict)
    program: HandProgram | None = None
    adds: bool = False

    def evaluate(self, angles: ArrayLike) -> Floats:
        """See `LocalOperator`. A hand is placed in double precision."""
        turns, single = _turns(angles, len(self.joints), self.name)
        matrices = turned(self.skeleton, self.joints, turns)
        moved = np.empty((len(turns), len(self.rest), 3), np.float32)
        self.operator.points(matrices, moved)
        out = moved.astype(np.float64)
        if self.program is not None:
            place(self.program, matrices, out)
        out = out[:, self.domain]
        return out[0] if single else out


@dataclass(frozen=True, eq=False)
class Displaced:
    """Displacers of one joint as an operator that adds: `samples` (s,) angles about the unit `axis` of the joint, at which
    the points of `domain` (n,) stand off by `offsets` (s,n,3) in the joint's turned frame; between, they are interpolated
    linearly from the nearest two, beyond the last as there, and nothing at zero. With one sample and no axis: a displacer
    with a weight, whatever the pose.
    """

    name: str
    domain: Ints
    joints: Ints
    anchor: int
    axis: Floats | None
    samples: Floats
    offsets: Floats
    weight: float = 0.0
    adds: bool = True

    @property
    def parameters(self) -> Mapping[str, object]:
        return {"weight": self.weight} if self.axis is None else {"axis": self.axis, "samples": self.samples}

    def weights(self, turns: Floats) -> Floats:
        """(F,s) the weight of each sample for the joint's turns (F,3)."""
        if self.axis is None:
            return np.full((len(turns), 1), self.weight)
        q = from_vector(turns)
        q = np.where(q[:, 3:] < 0, -q, q)
        angle = 2 * np.arctan2(q[:, :3] @ self.axis, q[:, 3])
        return hats(angle, self.samples)

    def evaluate(self, angles: ArrayLike) -> Floats:
        """See `LocalOperator`: offsets in the frame of the anchor."""
        turns, single = _turns(angles, len(self.joints), self.name)
        own = turns[:, -1] if len(self.joints) else np.zeros((len(turns), 3))
        moved = np.einsum("fs,snd->fnd", self.weights(own), self.offsets)
        if len(self.joints):
            moved = np.einsum("fab,fnb->fna", to_matrix(from_vector(own)), moved)
        return moved[0] if single else moved


def hats(angle: Floats, samples: Floats) -> Floats:
    """(F,s) piecewise linear weights of samples (s,), all of one sign and growing away from zero, for angles (F,)."""
    knots = np.concatenate([[0.0], samples])
    sign = -1.0 if samples[-1] < 0 else 1.0
    clipped = np.clip(angle * sign, 0, abs(samples[-1]))
    return np.stack([np.interp(clipped, knots * sign, np.eye(len(knots))[k]) for k in range(1, len(knots))], axis=1)


def _turns(angles: ArrayLike, count: int, name: str) -> tuple[Floats, bool]:
    turns = np.asarray(angles, np.float64)
    if count == 0 and turns.size == 0 and turns.ndim < 3:
        turns = turns.reshape(0, 3)
    fits = turns.ndim in (2, 3) and turns.shape[-2:] == (count, 3)
    require(fits, f"operator {name}: angles", f"shape ({count}, 3) or (F, {count}, 3)", turns.shape)
    return (turns[None], True) if turns.ndim == 2 else (turns, False)


def turned(skeleton: Skeleton, joints: Ints, turns: Floats) -> Floats:
    """(F,J,4,4) where these joints are turned (F,k,3) against their parents, all others are at rest."""
    own = {int(j): k for k, j in enumerate(joints)}
    local = to_matrix(from_vector(turns))
    out = np.tile(np.eye(4), (len(turns), len(skeleton), 1, 1))
    for j, parent in enumerate(skeleton.parents.tolist()):
        if parent >= 0:
            out[:, j] = out[:, parent]
        if j in own:
            step = np.tile(np.eye(4), (len(turns), 1, 1))
            step[:, :3, :3] = local[:, own[j]]
            step[:, :3, 3] = skeleton.centers[j] - local[:, own[j]] @ skeleton.centers[j]
            out[:, j] = out[:, j] @ step
    return out


def angles_of(skeleton: Skeleton, joints: Ints, matrices: Floats) -> Floats:
    """(F,k,3) how joints are turned against their parents (axis times radians) in joint matrices (F,J,4,4)."""
    parents = skeleton.parents[joints]
    rotation = matrices[..., :3, :3]
    above = np.where((parents >= 0)[:, None, None], rotation[:, parents], np.eye(3))
    q = from_matrix(np.swapaxes(above, -1, -2) @ rotation[:, joints])
    return to_vector(np.where(q[..., 3:] < 0, -q, q))


def family(skeleton: Skeleton, some: Sequence[int]) -> tuple[Ints, int]:
    """The joints on the ways between some joints, parents first, and the joint above all of them (-1: none)."""
    if not len(some):
        return np.zeros(0, np.int32), -1
    parents = skeleton.parents.tolist()

    def way(j: int) -> list[int]:
        out = []
        while j >= 0:
            out.append(j)
            j = parents[j]
        return out

    ways = [way(int(j)) for j in {int(j) for j in some}]
    common = set(ways[0]).intersection(*ways[1:])
    if not common:
        return np.array(sorted(set().union(*ways)), np.int32), -1
    top = max(common)
    return np.array(sorted(set().union(*ways) - common | {top}), np.int32), parents[top]


def local_operators(deformer: Deformer) -> tuple[LocalOperator, ...]:
    """What a bound deformer consists of: its hands, its contour surfaces, the skin of each joint, and displacers.

    Their domains are disjoint and cover the surface; displacers add to them.
    """
    body, operator = deformer.body, deformer.operator
    skin, skeleton = body.skin, body.skeleton
    base = operator.base if isinstance(operator, HandOperator) else operator
    weights = skin.weights
    taken = np.zeros(len(skin.rest), bool)
    out: list[LocalOperator] = []

    seen = base.retwists if isinstance(base, ContourOperator) else {}

    def bound(name: str, domain: Ints, extra: Sequence[int], **more: object) -> None:
        own = np.isin(weights.vertex, domain) & (weights.weight > 0)
        held = np.unique(weights.joint[own]).tolist()
        joints, anchor = family(skeleton, [*held, *(k for j in held for k in seen.get(j, ())), *extra])
        out.append(Bound(name, domain, joints, anchor, skeleton, skin.rest, base, **more))  # type: ignore[arg-type]
        taken[domain] = True

    for program in operator.programs if isinstance(operator, HandOperator) else ():
        hand = program.hand
        joints = [j for j in (*hand.before.tolist(), *hand.near.tolist(), *hand.far.tolist()) if j >= 0]
        parameters = {skeleton.names[j]: r for j, r in zip(hand.near.tolist(), hand.roundings, strict=True)}
        bound(hand.name, hand.vertices, joints, parameters=parameters, program=program)
    for surface in body.contours if deformer.name == "contours" else ():
        domain = surface.vertices.ravel()
        shares = {
            "swing": surface.swing,
            "twist": surface.twist,
            "diversion": surface.diversion,
            "mitre": surface.mitre,
            "recentre": surface.recentre,
        }
        bound(surface.name, domain[~taken[domain]], surface.joints.tolist(), parameters=shares)
    pivot = np.full(len(skin.rest), -1)
    order = np.lexsort((weights.weight, weights.vertex))
    pivot[weights.vertex[order]] = weights.joint[order]  # the largest weight comes last
    left = ~taken
    for j in np.unique(pivot[left]).tolist():
        name = f"skin of {skeleton.names[j]}" if j >= 0 else "skin without weights"
        bound(name, np.flatnonzero(left & (pivot == j)).astype(np.int32), [])
    for m in skin.morphs:
        own = np.array([] if m.before or m.joint < 0 else [m.joint], np.int32)
        anchor = m.joint if m.before else (int(skeleton.parents[m.joint]) if len(own) else -1)
        out.append(Displaced(m.name, m.index, own, anchor, None, np.ones(1), m.offset[None], m.weight))
    return tuple(out)


def partition_faults(operators: Sequence[LocalOperator], body: Body) -> list[str]:
    """What keeps operators from being one actor's, a line each: joints or vertices that the body does not have, vertices in
    two domains, vertices in none. Operators that add are not asked about the latter two."""
    count, joints = len(body.skin.rest), len(body.skeleton)
    owner = np.full(count, -1)
    out = []
    for i, op in enumerate(operators):
        bad = [int(j) for j in op.joints if not 0 <= j < joints]
        if bad:
            out.append(f"operator {op.name}: expected joints in 0..{joints - 1}, found {bad[0]}")
        domain = np.asarray(op.domain, np.int64)
        wrong = domain[(domain < 0) | (domain >= count)]
        if len(wrong):
            out.append(f"operator {op.name}: expected vertices in 0..{count - 1}, found {wrong[0]}")
        domain = domain[(domain >= 0) & (domain < count)]
        if op.adds:
            continue
        values, times = np.unique(domain, return_counts=True)
        if (times > 1).any():
            out.append(
                f"operator {op.name}: expected each vertex once in its domain, found {values[times > 1][0]} twice"
            )
        both = domain[owner[domain] >= 0]
        if len(both):
            other = operators[int(owner[both[0]])].name
            out.append(f"operators {other} and {op.name}: expected domains apart, found vertex {both[0]} in both")
        owner[domain] = i
    free = np.flatnonzero(owner < 0)
    if len(free):
        names = body.skeleton.names
        held = body.skin.weights.joint[body.skin.weights.vertex == free[0]]
        where = f" (of {names[held[0]]})" if len(held) else ""
        out.append(
            f"operators: expected every vertex in a domain, found vertex {free[0]}{where} in none, {len(free)} such in all"
        )
    return out


@dataclass(frozen=True, eq=False)
class Composed:
    """An actor's local operators as one operator for a `Deformer`. Joints turn; of translations only those of the root
    and above an operator's joints are followed. Raises VitruvianError when they are no partition."""

    body: Body
    operators: tuple[LocalOperator, ...]

    def __post_init__(self) -> None:
        faults = partition_faults(self.operators, self.body)
        if faults:
            raise VitruvianError(faults[0] + (f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""))

    def points(self, matrices: Floats, out: Single, rest: Floats | None = None) -> None:
        require(rest is None, "composed operators", "no displacers before skinning", "some")
        skeleton = self.body.skeleton
        for op in sorted(self.operators, key=lambda o: o.adds):
            value = op.evaluate(angles_of(skeleton, op.joints, matrices))
            carrier = self._carrier(op, matrices)
            moved = np.einsum("fab,fnb->fna", carrier[:, :3, :3], value)
            if op.adds:
                out[:, op.domain] += moved.astype(np.float32)
            else:
                out[:, op.domain] = moved + carrier[:, None, :3, 3]

    def _carrier(self, op: LocalOperator, matrices: Floats) -> Floats:
        """(F,4,4) what carries an operator's value: its anchor, or how far the root that it turns with has moved."""
        if op.anchor >= 0:
            return matrices[:, op.anchor]
        out = np.tile(np.eye(4), (len(matrices), 1, 1))
        if len(op.joints):
            center, root = self.body.skeleton.centers[op.joints[0]], matrices[:, op.joints[0]]
            out[:, :3, 3] = root[:, :3, :3] @ center + root[:, :3, 3] - center
        return out

    def frames(self, matrices: Floats, out: Single) -> None:
        """The rigid motion of the joint that holds each vertex most, put where the vertex is."""
        points = np.empty((*out.shape[:2], 3), np.float32)
        self.points(matrices, points)
        joint = self.body.skin.weights.top(1)[0][:, 0]
        out[..., :3] = matrices[:, joint, :3, :3]
        out[..., 3] = points - np.einsum("fvab,vb->fva", out[..., :3].astype(np.float64), self.body.skin.rest)


def composed(body: Body, operators: Sequence[LocalOperator]) -> Deformer:
    """A deformer made of local operators. Raises VitruvianError, naming vertex or joint, when they are no partition."""
    bare = replace(body, skin=replace(body.skin, morphs=()))  # displacers are among the operators, if wanted
    return Deformer("composed", bare, Composed(body, tuple(operators)))
