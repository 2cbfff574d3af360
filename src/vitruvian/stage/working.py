"""Where a tick's poses are made: what is asked for, what hooks leave of it, joint matrices, points.

Nothing here is seen outside before it is whole: see `Workshop.finished`.
"""

from __future__ import annotations

import inspect
import math
import operator
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from vitruvian.body.types import Body, Floats, require
from vitruvian.errors import VitruvianError
from vitruvian.stage.actor import Actor, Posed, Shaded, Single
from vitruvian.stage.events import HOLD, Event
from vitruvian.stage.winding import way, wound

if TYPE_CHECKING:
    from vitruvian.deform.deformer import Deformer
    from vitruvian.stage.stage import Stage

NONE = np.zeros((0, 4, 4))


@dataclass
class Draft:
    """An actor in the making. joints and matrices (J,4,4), vertices (V,3) as in `Posed`; systems after "deform" may put
    other vertices in the place of these, but not write into them. `changed`: whether the pose has to be computed."""

    made_of: tuple[Any, ...]  # rotation, translation, weights and what decides how they deform
    changed: bool
    run: Deformer | None = None
    cloth: Shaded | None = None  # what has normals in its place
    joints: Floats = field(default_factory=lambda: NONE)
    matrices: Floats = field(default_factory=lambda: NONE)
    vertices: Single | None = None
    deformed: Single | None = None  # the vertices as "deform" made them
    of: Floats | None = None  # the matrices that `vertices` belong to
    wound: Floats = field(default_factory=lambda: NONE)  # rotations with signs that say how far joints are wound
    path: Floats | None = None


Group = list[tuple[Actor, Draft]]


TUNING = ("hands", "rounded")  # options that a bound deformer with hands can change


@cache
def known_options() -> frozenset[str]:
    """Names of options that an actor's deformer may have: those of `deformer` but the ones that the stage decides."""
    from vitruvian.deform.deformer import deformer

    return frozenset(inspect.signature(deformer).parameters) - {"name", "body", "follow"}


class Workshop:
    """Keeps bound deformers, drafts of this tick, and what hooks were asked last."""

    def __init__(self, leave: frozenset[str] = frozenset()):
        self.leave = leave
        self.drafts: dict[str, Draft] = {}
        self.computed = 0  # poses that were deformed so far
        self._bound: dict[Any, tuple[Deformer, Any]] = {}
        self._computed: dict[str, Draft] = {}  # per actor: as it left "deform" when it was published last
        self._run: dict[str, tuple[tuple[Any, ...], Deformer | None]] = {}
        self._offered: dict[tuple[str, str], Floats] = {}

    def prepare(self, actor: Actor) -> None:
        """Bind an actor's deformer; VitruvianError when it can't move the body."""
        if actor.body is not None:
            self.bound(actor)

    def bound(
        self, actor: Actor, *, deformer: str | None = None, options: Mapping[str, Any] | None = None,
        body: Body | None = None, follow: bool = False,
    ) -> Deformer | None:  # fmt: skip
        """The deformer of an actor as it is, or would be; None when it is left to who shows the frames.

        Deformers of one body are shared by all that ask for the same. Mostly they see one frame of several actors at a
        time, and then must not follow from one to the next.
        """
        name = actor.deformer if deformer is None else deformer
        given = actor.options if options is None else options
        if name in self.leave or actor.body is None:
            return None
        body = actor.levels[actor.level].body if body is None else body
        if "fingers" in actor.still:  # hands are rigid pieces then
            name, given = ("log" if name == "hand" else name), {k: v for k, v in given.items() if k != "hands"}
        tuning = {k: v for k, v in given.items() if name == "hand" and k in TUNING}
        key = (id(body), name, _frozen({k: v for k, v in given.items() if k not in tuning}), follow)
        if key not in self._bound:
            from vitruvian.deform.deformer import deformer as bind

            unknown = sorted(set(given) - known_options())
            require(not unknown, f"deformer {name}", f"options out of {', '.join(sorted(known_options()))}", unknown)
            self._bound[key] = (bind(name, body, follow=follow, **given), (body, given))  # what ids stand for, kept
        run, (_, bound) = self._bound[key]
        if name == "hand" and tuning != {k: v for k, v in bound.items() if k in TUNING}:
            hands = tuning.get("hands")  # as a slider moves: nothing is bound anew, and only the last is kept
            run = run.tuned(hands if isinstance(hands, Mapping) else None, rounded=tuning.get("rounded", True))
            self._bound[key] = (run, (body, given))
        return run

    def ask_again(self) -> None:
        """Offer everything to hooks anew: there are others now."""
        self._offered.clear()

    def begin(self, stage: Stage, actor: Actor) -> None:
        """What the actor's joints and displacers get at this tick."""
        rotation, weights = actor.wanted()
        translation, was = actor.moved(), actor.posed
        if stage.hooks and was is not None:
            rotation = self._guarded(stage, actor, "rotation", rotation, was.rotation)
            translation = self._guarded(stage, actor, "translation", translation, was.translation)
            weights = self._guarded(stage, actor, "weight", weights, was.weights)
        level = actor.levels.get(actor.level)
        made_of = (rotation, translation, weights, actor.deformer, actor.options, level, actor.still)
        before = self._computed.get(actor.name)
        if before is None or not all(map(operator.is_, made_of, before.made_of)):
            draft = self.drafts[actor.name] = Draft(made_of, True, self.run(actor))
            if draft.run is not None:
                known = before is not None and not stage.leapt and len(before.wound) > 0
                draft.wound = wound(rotation, before.wound if before is not None and known else None)
        else:
            self.drafts[actor.name] = replace(before, changed=False, vertices=before.deformed)

    def _guarded(self, stage: Stage, actor: Actor, kind: str, wanted: Floats, old: Floats) -> Floats:
        """`wanted` as hooks leave it; only what is new is offered to them."""
        hooks = [h for h in stage.hooks if h.kind == kind and h.actor in ("", actor.name)]
        if not hooks:
            return wanted
        names = list(actor.displacers) if kind == "weight" else actor.skeleton.names if actor.body else ()
        offered = self._offered.get((actor.name, kind))
        which = [i for i, n in enumerate(names) if any(h.name in ("", n) for h in hooks)]
        out, held = wanted.copy(), []
        for i in which:
            if offered is not None and np.array_equal(offered[i], wanted[i]):
                out[i] = old[i]
                continue
            answer = stage.asked(Event(kind, actor.name, names[i], wanted[i], stage.clock.total, old[i]))
            if answer is None or answer is HOLD or answer.value is None:
                out[i] = old[i]
                held += [i] if answer is HOLD else []
            else:
                out[i] = stage.kinds[kind](answer.value, f"hook of {kind} {names[i]}")
        offered = wanted.copy()
        offered[held] = np.nan  # equal to nothing: to be offered again
        self._offered[actor.name, kind] = offered
        return old if np.array_equal(out, old) else out

    def kinematics(self, actors: Iterable[Actor]) -> None:
        """Joint matrices of all actors whose pose changed; equal poses of one skeleton are computed once."""
        for group in self._groups(actors, lambda actor, draft: id(actor.skeleton)):
            first = group[0][0]
            alike = _alike(group, lambda a, d: (*(x.tobytes() for x in (*d.made_of[:2], d.wound)), a.still))
            if len(alike) == 1:
                rotation, translation = group[0][1].made_of[:2]
                joints = first.kinematics(rotation[None], translation[None])
            else:
                rotation, translation = (np.stack([twins[0][1].made_of[k] for twins in alike]) for k in (0, 1))
                joints = first.kinematics(rotation, translation)
            for own, twins in zip(joints, alike):
                if twins[0][0].still:
                    twins[0][0].fold(own)
            if not math.isfinite(joints.sum()):
                k, j = np.argwhere(~np.isfinite(joints).all(axis=(2, 3)))[0]
                name = alike[int(k)][0][0].name
                require(False, f"pose of {name}", "finite matrices", f"{first.skeleton.names[int(j)]} without")
            binding = first.skeleton.binding
            matrices = joints if binding is None else joints @ binding
            joints.flags.writeable = matrices.flags.writeable = False
            for k, twins in enumerate(alike):
                own, bound = joints[k], matrices[k]
                path = self._path(*twins[0]) if twins[0][1].run is not None else None
                for _, draft in twins:
                    draft.joints, draft.matrices, draft.path = own, bound, path

    @staticmethod
    def _path(actor: Actor, draft: Draft) -> Floats | None:
        """(K,J,4,4) matrices of poses that lead to this one, when joints are wound past half a turn."""
        rotations = way(draft.wound)
        if rotations is None:
            return None
        shift = np.broadcast_to(draft.made_of[1], (len(rotations), *draft.made_of[1].shape))
        joints = actor.kinematics(rotations, np.ascontiguousarray(shift))
        for own in joints:
            if actor.still:
                actor.fold(own)
        return joints if actor.skeleton.binding is None else joints @ actor.skeleton.binding

    def deform(self, actors: Iterable[Actor]) -> None:
        """Points of all actors whose pose changed; equal poses of one body are deformed once, others together."""
        actors = list(actors)
        for actor in actors:
            draft = self.drafts[actor.name]
            if actor.mesh is not None and draft.changed:
                draft.vertices = draft.deformed = np.ascontiguousarray(actor.mesh.vertices, np.float32)
        for group in self._groups(actors, lambda actor, draft: id(draft.run) if draft.path is None else actor.name):
            run = group[0][1].run
            if run is None:
                continue
            if any(len(draft.matrices) == 0 for _, draft in group):
                raise VitruvianError("deform: expected joint matrices, found none; it comes after kinematics")
            alike = _alike(group, lambda _, draft: (id(draft.matrices), draft.made_of[2].tobytes()))
            some = [twins[0] for twins in alike]
            if some[0][1].path is not None:
                vertices = self._led(*some[0])
            elif len(some) == 1:
                vertices = _deformed(run, some[0][1].matrices[None], some)
            else:
                vertices = _deformed(run, np.stack([draft.matrices for _, draft in some]), some)
            self.computed += len(some)
            vertices.flags.writeable = False
            for own, twins in zip(vertices, alike):
                for _, draft in twins:
                    draft.vertices = draft.deformed = own
                    draft.of = draft.matrices

    def _led(self, actor: Actor, draft: Draft) -> Single:
        """(1,V,3) points of a pose with those that lead to it."""
        assert draft.path is not None
        run = self.bound(actor, follow=True)
        assert run is not None
        rows = np.concatenate([draft.path, draft.matrices[None]])
        return np.ascontiguousarray(_deformed(run, rows, [(actor, draft)] * len(rows))[-1:])

    def _groups(self, actors: Iterable[Actor], by: Callable[[Actor, Draft], object]) -> Iterable[Group]:
        """Actors with joints whose pose changed, those together that can be computed together."""
        groups: dict[object, Group] = {}
        for actor in actors:
            draft = self.drafts[actor.name]
            if draft.changed and actor.body is not None:
                groups.setdefault(by(actor, draft), []).append((actor, draft))
        return groups.values()

    def run(self, actor: Actor) -> Deformer | None:
        """`bound`, looked up once while nothing about it changes."""
        key = (actor.deformer, actor.options, actor.levels.get(actor.level), actor.still)
        known = self._run.get(actor.name)
        if known is None or not all(map(operator.is_, key, known[0])):
            known = self._run[actor.name] = (key, self.bound(actor))
        return known[1]

    def finished(self, actor: Actor, later: Collection[str]) -> Posed:
        """What is published of an actor: its pose and the points of just this pose. `later`: systems after "deform"."""
        draft, was = self.drafts[actor.name], actor.posed
        placement = actor.placed()
        if was is not None and not draft.changed:
            key = (was.vertices, was.placement, was.turns, was.shaped, was.shift)
            if all(map(operator.is_, key, (draft.vertices, placement, actor.turns, actor.shaped, actor.shift))):
                return was
        run = draft.run
        if run is not None and draft.of is not draft.matrices:
            raise VitruvianError(f"publish: the points of {actor.name} belong to another pose than its joints")
        if draft.vertices is not None and later and not np.isfinite(draft.vertices).all():
            bad = int(np.flatnonzero(~np.isfinite(draft.vertices).all(axis=1))[0])
            raise VitruvianError(f"publish: vertex {bad} of {actor.name} is not finite after {', '.join(later)}")
        rotation, translation, weights = draft.made_of[:3]
        level = actor.levels.get(actor.level)
        return Posed(
            actor.name, None if level is None else level.body, rotation, translation, weights, draft.joints,
            draft.matrices, draft.vertices, None if level is None else level.source, placement, actor.round,
            actor.deformer, actor.turns, actor.shaped, actor.shift, draft.cloth or run, draft.path,
        )  # fmt: skip

    def commit(self) -> None:
        """The drafts of this tick are what is published now."""
        self._computed.update(self.drafts)


def _alike(group: Group, key: Callable[[Actor, Draft], object]) -> list[Group]:
    """The actors of a group, those with equal keys together."""
    if len(group) == 1:
        return [group]
    found: dict[object, Group] = {}
    for actor, draft in group:
        found.setdefault(key(actor, draft), []).append((actor, draft))
    return list(found.values())


def _deformed(run: Deformer, matrices: Floats, some: Group) -> Single:
    """(A,V,3) points of actors with this deformer, for their matrices (A,J,4,4) and displacers' weights."""
    given = [draft.made_of[2] for _, draft in some]
    file = some[0][0].file
    if all(w is file for w in given) and not file.any():  # as nearly always: nothing is displaced
        out = np.empty((len(matrices), len(run.body.skin.rest), 3), np.float32)
        run.operator.points(matrices, out)
        return out
    names, known = list(some[0][0].displacers), set(run.morphs.names)
    weights = np.stack(given)
    changed = np.flatnonzero((weights != file).any(axis=0))
    return run(matrices, {names[i]: weights[:, i] for i in changed if names[i] in known} or None)


def _frozen(value: Any) -> Any:
    """Something hashable that tells options apart; arrays by identity."""
    if isinstance(value, Mapping):
        return tuple(sorted((str(k), _frozen(v)) for k, v in value.items()))
    if isinstance(value, (list, tuple, set, frozenset)):
        return tuple(sorted(map(str, value)))
    return id(value) if isinstance(value, np.ndarray) else repr(value)
