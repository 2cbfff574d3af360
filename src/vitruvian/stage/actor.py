"""Actors: what a stage knows of each figure between ticks, and what it publishes of it."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.kinematics import bound_kinematics
from vitruvian.body.rotations import multiply, slerp
from vitruvian.body.types import Body, Floats, Ints, Skeleton
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.motion.types import Motion
from vitruvian.stage.clip import Clip, Mesh
from vitruvian.stage.clock import Clock
from vitruvian.stage.extremities import stilled

if TYPE_CHECKING:
    from vitruvian.cloth.garment import Garment

Single = NDArray[np.float32]
NEAR = 0.9995  # dot product of quaternions so close that a chord is as good as an arc, to 1e-6


class Shaded(Protocol):
    """What knows the normals (V,3) of points (V,3): a Deformer, or cloth."""

    def normals(self, vertices: Single, /) -> Single: ...


@dataclass(frozen=True, eq=False)
class Posed:
    """One actor in one frame; everything in it belongs to the same pose. Arrays are not to be written to.

    rotation (J,4) xyzw and translation (J,3): local, as released; weights (D,) of the displacers. joints (J,4,4): joint
    matrices in humanoid space without, matrices (J,4,4) with the file's binding, as deformers take them. vertices (V,3)
    float32 in humanoid space, of `body`; None when they are left to who shows the frame. source (V,): which vertices of
    the full body these are, None for all. placement (4,4): humanoid space to the stage, rounds of a walk included.
    turns (joint -> quaternion), shift (3,) of the first joint or None, shaped (displacer -> weight): what was set on top
    of the motion. path (K,J,4,4): matrices
    of poses that lead to this one, when joints are wound past half a turn: deformers need them before `matrices`.
    """

    name: str
    body: Body | None
    rotation: Floats
    translation: Floats
    weights: Floats
    joints: Floats
    matrices: Floats
    vertices: Single | None
    source: Ints | None
    placement: Floats
    round: int
    deformer: str
    turns: Mapping[int, Floats]
    shaped: Mapping[int, float]
    shift: Floats | None = None
    run: Shaded | None = field(default=None, repr=False)
    path: Floats | None = field(default=None, repr=False)

    @cached_property
    def normals(self) -> Single | None:
        """(V,3) float32 unit normals of `vertices`, weighted by area."""
        if self.vertices is None or self.run is None:
            return None
        return self.run.normals(self.vertices)

    @property
    def points(self) -> Floats:
        """(V,3) `vertices` on the stage, metres: moved by `placement`."""
        if self.vertices is None:
            raise VitruvianError(
                f"points of {self.name}: expected an actor that the stage deforms, found one it does not"
            )
        return self.vertices @ self.placement[:3, :3].T + self.placement[:3, 3]


@dataclass(frozen=True, eq=False)
class Level:
    """A level of detail: a body on the same skeleton, and (V',) which vertices of the full one it has (None: all)."""

    body: Body
    source: Ints | None = None


class Actor:
    """A figure, or a thing without joints, on a stage.

    `deformer` and `options`: as for `vitruvian.deformer`. `rotation` (J,4), `translation` (J,3), `weights` (D,): what its
    motion and the events ask for; replaced, never written into. `turns`, `shift`, `shaped`: set on top of it. `on`: the
    actor that it is placed with, as clothes are.
    """

    def __init__(
        self,
        name: str,
        body: Body | None = None,
        *,
        humanoid: Humanoid | None = None,
        mesh: Mesh | None = None,
        motion: Motion | None = None,
        deformer: str = "log",
        options: Mapping[str, Any] | None = None,
        on: Actor | None = None,
    ):
        self.name, self.body, self.humanoid, self.mesh = name, body, humanoid, mesh
        self.motion, self.deformer, self.options = motion, deformer, dict(options or {})
        self.on = on
        self.garment: Garment | None = None  # to be worn on a stage
        self.levels: dict[int, Level] = {} if body is None else {0: Level(body)}
        self.level = 0
        self.still: frozenset[str] = frozenset()  # extremities that are off
        self.turns: Mapping[int, Floats] = MappingProxyType({})
        self.shaped: Mapping[int, float] = MappingProxyType({})
        self.shift: Floats | None = None
        self.loops = motion is not None and motion.loop
        self.travel = np.zeros(3) if motion is None or not motion.loop else travel(motion)
        self.posed: Posed | None = None  # as last published
        self.placement = np.eye(4) if body is None else body.placement
        self.round = 0  # of its motion
        self._placed = (0, self.placement)
        skeleton = None if body is None else body.skeleton
        self.rotation: Floats = np.zeros((0, 4)) if skeleton is None else skeleton.rotation
        self.translation: Floats = np.zeros((0, 3)) if skeleton is None else skeleton.translation
        self.weights = self.file = np.array([m.weight for m in self.morphs], np.float64)
        self._curves = self._weight_curves()
        self._sampled = -1.0
        self._mixed: tuple[Any, ...] = ((None,), self.rotation, self.weights)
        self._moved: tuple[Any, Any, Floats] = (None, None, self.translation)
        self._folds: dict[frozenset[str], tuple[Ints, Ints]] = {}

    @property
    def morphs(self) -> tuple[Any, ...]:
        return () if self.body is None else self.body.skin.morphs

    @property
    def skeleton(self) -> Skeleton:
        assert self.body is not None
        return self.body.skeleton

    @property
    def index(self) -> Mapping[str, int]:
        """Joint name -> number; none for things without joints."""
        return {} if self.body is None else self.body.skeleton.index

    def refine(self, body: Body, inner: Ints) -> None:
        """Have a finer body, `inner` (V,) the vertices of it that the one so far has: that and the coarser ones are the
        levels after it, and what is shown stays the same."""
        assert self.body is not None
        finer = replace(body, skeleton=self.skeleton)
        inner = np.asarray(inner, np.int32)
        coarser = {n + 1: Level(v.body, inner if v.source is None else inner[v.source]) for n, v in self.levels.items()}
        self.levels, self.body, self.level = {0: Level(finer), **coarser}, finer, self.level + 1

    @cached_property
    def kinematics(self) -> Callable[[Floats, Floats], Floats]:
        """Forward kinematics without the file's binding."""
        skeleton = self.skeleton
        return bound_kinematics(skeleton if skeleton.binding is None else replace(skeleton, binding=None))

    @cached_property
    def displacers(self) -> dict[str, int]:
        """Displacer name -> index."""
        return {m.name: i for i, m in enumerate(self.morphs)}

    def _weight_curves(self) -> Floats | None:
        """(F,D) weights of a motion that moves displacers of this body."""
        driven = {} if self.motion is None else self.motion.weights
        if self.motion is None or not any(n in driven for n in self.displacers):
            return None
        curves = np.tile(self.weights, (len(self.motion), 1))
        for i, morph in enumerate(self.morphs):
            if morph.name in driven:
                curves[:, i] = driven[morph.name]
        return curves

    def sample(self, clock: Clock) -> None:
        """Take over what the motion says at this time: of the round, or of its own loop on an endless stage."""
        motion = self.motion
        if motion is None:
            return
        seconds = clock.time
        if clock.length < np.inf:
            self.round = clock.round
        elif self.loops:
            self.round = int(seconds / motion.seconds + 1e-9)
            seconds = max(seconds - self.round * motion.seconds, 0.0)
        if seconds == self._sampled:
            return
        self._sampled = seconds
        n, at = len(motion), seconds * motion.fps
        i = int(at + 1e-6)
        part = at - i
        if i >= n or (i == n - 1 and not self.loops):
            i, part = n - 1, 0.0
        if part < 1e-5:
            self.rotation = motion.rotation[i]
            root, shift = (
                motion.translation[i],
                None if motion.joint_translation is None else motion.joint_translation[i],
            )
            weights = None if self._curves is None else self._curves[i]
        else:
            j = (i + 1) % n
            self.rotation = between(motion.rotation[i], motion.rotation[j], part)
            on = self.travel if j == 0 else 0.0
            mix = lambda values: values[i] + part * (values[j] - values[i])  # noqa: E731
            root = mix(motion.translation) + part * on
            shift = None if motion.joint_translation is None else mix(motion.joint_translation)
            weights = None if self._curves is None else mix(self._curves)
        if shift is None:
            self.translation = self.skeleton.translation.copy()
            self.translation[0] = root
        else:
            self.translation = shift.copy()
            self.translation[0] = root
        if weights is not None:
            self.weights = weights

    def wanted(self) -> tuple[Floats, Floats]:
        """Rotation and weights with what was set on top of them; the same objects while nothing changes."""
        key = (self.rotation, self.turns, self.weights, self.shaped)
        if not all(map(operator.is_, self._mixed[0], key)):
            rotation, weights = self.rotation, self.weights
            if self.turns:
                which = list(self.turns)
                rotation = rotation.copy()
                rotation[which] = multiply(np.array([self.turns[j] for j in which]), rotation[which])
            if self.shaped:
                weights = weights.copy()
                weights[list(self.shaped)] = list(self.shaped.values())
            self._mixed = (key, rotation, weights)
        return self._mixed[1], self._mixed[2]

    def moved(self) -> Floats:
        """(J,3) translation with the shift on top of it; the same object while nothing changes."""
        if self.shift is None:
            return self.translation
        if self._moved[0] is not self.translation or self._moved[1] is not self.shift:
            out = self.translation.copy()
            out[0] += self.shift
            self._moved = (self.translation, self.shift, out)
        return self._moved[2]

    def placed(self) -> Floats:
        """(4,4) humanoid space to the stage."""
        if self.on is not None:
            return self.on.placed()
        if self._placed[0] != self.round:
            out = self.placement.copy()
            out[:3, 3] += self.placement[:3, :3] @ (self.round * self.travel)
            self._placed = (self.round, out)
        return self._placed[1]

    def fold(self, joints: Floats) -> None:
        """Let joints (J,4,4) of extremities that are off follow what they hang on."""
        if self.still not in self._folds:
            self._folds[self.still] = stilled(self.skeleton, self.still)
        which, follow = self._folds[self.still]
        joints[which] = joints[follow]


def between(a: Floats, b: Floats, part: float) -> Floats:
    """Rotations (J,4) that part of the way, 0..1, from `a` to `b`, at even speed."""
    dot = np.einsum("ji,ji->j", a, b)
    out = a + part * (b - a)
    out /= np.sqrt(np.einsum("ji,ji->j", out, out))[:, None]
    far = dot < NEAR
    if far.any():
        out[far] = slerp(a[far], b[far], part)
    return out


def travel(motion: Motion) -> Floats:
    """Displacement (3,) on the floor of one round: from the first frame to the one that would follow the last."""
    t = motion.translation
    if len(t) < 3:
        return np.zeros(3)
    step = (t[-1] - t[-2] + t[1] - t[0]) / 2
    way: Floats = (t[-1] + step - t[0]) * [1.0, 0.0, 1.0]
    return way if np.linalg.norm(way) > 0.05 else np.zeros(3)


def actor_of(thing: object) -> Actor:
    """An Actor for a Clip, Humanoid, Body or Mesh; `VitruvianError` for anything else."""
    if isinstance(thing, Actor):
        return thing
    if isinstance(thing, Mesh):
        return Actor(thing.name or "object", mesh=thing)
    if isinstance(thing, Humanoid):
        from vitruvian.body.pack import pack

        body = pack(thing)
        return Actor(body.name or "figure", body, humanoid=thing)
    if isinstance(thing, Body):
        return Actor(thing.name or "figure", thing)
    if isinstance(thing, Clip):
        body, motion = thing.body, thing.motion
        out = Actor(body.name or "figure", body, humanoid=thing.humanoid, motion=motion, deformer=thing.deformer)
        out.garment = thing.garment
        return out
    raise VitruvianError(f"stage: expected a Clip, Humanoid, Body, Mesh or Actor, found {type(thing).__name__}")
