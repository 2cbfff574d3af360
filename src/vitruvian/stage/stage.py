"""The stage: actors, one clock, systems in a fixed order, events that are intercepted, frames that are whole.

What turns a joint waits in a buffer until `intercept`; then joints, points and everything that later systems make of them
are computed, and only `publish` lets go of all of it at once. So no frame has joints and points of different poses.
Updates of one time stamp make one computation; what did not change is not computed at all; actors with the same body,
deformer and pose share it.

Source: H-Anim deformation in VRML, 3.3 (updates of one time stamp) and 3.4.1 (interception of events).
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from threading import get_ident
from types import MappingProxyType
from typing import Any

import numpy as np

from vitruvian.body.types import Body, Ints, floats, indices, require
from vitruvian.errors import VitruvianError
from vitruvian.stage.actor import Actor, Level, Posed, actor_of
from vitruvian.stage.clock import Clock
from vitruvian.stage.events import ACTOR, HOLD, KINDS, TRANSPORT, Event, Hook, Hooked, of_script
from vitruvian.stage.extremities import parts
from vitruvian.stage.working import Draft, Workshop

CATCH_UP = 4  # ticks that are made up for at most, where each has to be made
BUILT_IN = 5  # systems that every stage has
AUTOMATIC = 3  # levels of detail that a contour body has by itself
Run = Callable[["Stage", float], None]


@dataclass(frozen=True, eq=False)
class System:
    """One step of every tick: `run(stage, dt)`, dt the seconds of play since the last. `every`: it must not miss a tick,
    as simulations must not; without such systems a stage that is late leaps ahead."""

    name: str
    run: Run
    every: bool = False


@dataclass(frozen=True, eq=False)
class Frame:
    """What a stage publishes at a tick. `time`: seconds within the round `round`; `actors` by name; `events`: those that
    took effect, beside rotations and translations, in their order."""

    tick: int
    time: float
    round: int
    actors: dict[str, Posed]
    events: tuple[Event, ...] = ()

    def __getitem__(self, name: str) -> Posed:
        return self.actors[name]


class Stage:
    """Several figures under one clock.

    `actors`: Clips, Humanoids, Bodies, Meshes or Actors; names that are taken get a number. `rate`: ticks per second.
    `length`: seconds of a round, after which all begins anew; endless without, then motions loop by themselves. `last`:
    where a round ends that is not followed by another.
    `leave`: deformers that whoever shows the frames runs itself: actors with these are published without points.
    `seed`: of `random`, the generator that systems use. `journal`: keep what came from outside, for `replay`.
    Raises VitruvianError for anything that is no actor, and when a deformer can't move its body.
    """

    def __init__(
        self,
        actors: Iterable[object],
        *,
        rate: float = 60.0,
        length: float = math.inf,
        last: float = math.inf,
        leave: Sequence[str] = (),
        seed: int = 0,
        journal: bool = False,
    ):
        self.actors: dict[str, Actor] = {}
        for thing in actors:
            actor = actor_of(thing)
            name, n = actor.name, 2
            while actor.name in self.actors:
                actor.name, n = f"{name} {n}", n + 1
            require(actor not in self.actors.values(), "stage", "an actor once", f"{name} twice")
            self.actors[actor.name] = actor
        require(bool(self.actors), "stage", "at least one actor", "none")
        self.clock = Clock(rate, length, last)
        self.random = np.random.default_rng(seed)
        self.kinds = dict(KINDS)  # systems may add kinds of their own, with a function that checks values
        self.hooks: list[Hook] = []
        self.journal: list[tuple[int, tuple[Event, ...]]] | None = [] if journal else None
        self.sent = 0  # events so far
        self.findings: list[str] = []  # what came that nobody here could take
        self.happened: list[Event] = []  # in this tick
        self.leapt = False  # whether this tick shows another time than the one that follows
        self.workshop = Workshop(frozenset(leave))
        self.systems = [
            System("animate", _animate),
            System("intercept", _intercept),
            System("kinematics", lambda stage, _: stage.workshop.kinematics(stage.actors.values())),
            System("deform", lambda stage, _: stage.workshop.deform(stage.actors.values())),
            System("publish", _publish),
        ]
        self._inbox: deque[tuple[float, int, Event]] = deque()  # from outside, also from other threads
        self._queue: list[tuple[float, int, Event]] = []
        self._numbers = itertools.count()
        self._running = 0  # the thread that makes a tick
        for actor in self.actors.values():
            self.workshop.prepare(actor)
        self.frame: Frame
        self.step(0)
        for actor in list(self.actors.values()):
            if actor.garment is not None:
                from vitruvian.stage.clothes import dressed

                dressed(self, actor.name, actor.garment)

    # what a stage is made of

    def add(self, run: Run, *, name: str = "", before: str = "", after: str = "", every: bool = False) -> System:
        """Put a system of one's own before or after another, by name; before "intercept" without either.

        What it sends there counts in the same tick; after it, in the next. Raises VitruvianError for a name that is taken
        or unknown.
        """
        names = [s.name for s in self.systems]
        name = name or getattr(run, "__name__", "system")
        require(name not in names, f"system {name}", "a name of its own", "one that is there already")
        require(not (before and after), f"system {name}", "before or after", "both")
        place = before or after or "intercept"
        require(place in names, f"system {name}", f"one of {', '.join(names)}", repr(place))
        system = System(name, run, every)
        self.systems.insert(names.index(place) + bool(after), system)
        return system

    def enter(self, actor: Actor) -> None:
        """Put another actor on the stage; it is in the next frame. Raises VitruvianError for a name that is taken."""
        require(actor.name not in self.actors, f"actor {actor.name}", "a name of its own", "one that is there already")
        self.workshop.prepare(actor)
        self.actors[actor.name] = actor

    def intercept(self, run: Hooked, kind: str = "rotation", *, actor: str = "", name: str = "") -> Hook:
        """Let a function see events before they take effect: `run(stage, event)`.

        It answers the event, or another in its place; None drops it; HOLD leaves everything as it is and has it offered
        again at the next tick. "rotation", "translation" and "weight" are what a joint or displacer would get at this
        tick, from its motion or from events, turns included; `event.old` is what it has. Hooks are asked in the order in
        which they were added; `stage.hooks.remove` takes one away. Raises VitruvianError for an unknown kind.
        """
        require(kind in self.kinds, "intercept", f"one of {', '.join(self.kinds)}", repr(kind))
        hook = Hook(run, kind, actor, name)
        self.hooks.append(hook)
        self.workshop.ask_again()
        return hook

    def add_level(self, actor: str, level: int, body: Body, source: Ints) -> None:
        """A level of detail for an actor: a body on the same joints, and (V',) which vertices of the full one it has.

        A finer one than the full one comes by the event "finer". Raises VitruvianError when joints or vertices do not fit.
        """
        full = self._actor(actor)
        require(full.body is not None, f"level of {actor}", "an actor with joints", "none")
        same = body.skeleton.names == full.skeleton.names
        require(same and level > 0, f"level of {actor}", "level 1 or more, with the same joints", level)
        assert full.body is not None
        vertices = indices(source, f"level of {actor}: source", len(full.body.skin.rest), len(body.skin.rest))
        full.levels[level] = Level(replace(body, skeleton=full.skeleton), vertices)

    def draft(self, actor: str) -> Draft:
        """An actor in the making, for systems after "intercept"."""
        require(self._running != 0, "draft", "a stage that is in a tick", "one between two ticks")
        return self.workshop.drafts[self._actor(actor).name]

    # what happens to it

    def send(self, kind: str, actor: str = "", name: str = "", value: Any = None, *, time: float | None = None) -> None:
        """Ask for something: see `events.KINDS`. With `time` (seconds through all rounds) it waits until then.

        Raises VitruvianError for unknown kinds, actors and names and for values that do not fit, at once.
        """
        require(time is None or math.isfinite(time), f"event {kind}", "a finite time", time)
        event = self.checked(Event(kind, actor, name, value, time))
        inside = self._running == get_ident()  # from a system: part of this tick
        (self._queue if inside else self._inbox).append(self._numbered(event))
        self.sent += 1

    def checked(self, event: Event) -> Event:
        """The event with a value of the right type; VitruvianError when it does not fit, or could not be done."""
        require(event.kind in self.kinds, "event", f"one of {', '.join(self.kinds)}", repr(event.kind))
        if event.kind == "rotation" and event.name.endswith("Def"):  # as a Script node in a file has it
            index = self._actor(event.actor).index
            known = event if event.name in index else of_script(event)
            if known.name not in index:  # passed through
                return replace(event, value=floats(event.value, f"event {event.name}", 4))
            event = known
        value = self.kinds[event.kind](event.value, f"event {event.kind}")
        if event.kind in ACTOR:
            self._check(event.kind, self._actor(event.actor), event.name, value)
        return replace(event, value=value)

    def play(self) -> None:
        self.send("play")

    def pause(self) -> None:
        self.send("pause")

    def seek(self, seconds: float) -> None:
        """Go to a time of this round; the next frame shows it."""
        self.send("seek", value=seconds)

    def speed(self, value: float) -> None:
        """Seconds of play in a second outside, -4..4; backwards only without systems that must not miss a tick."""
        self.send("speed", value=value)

    def step(self, ticks: int = 1) -> Frame:
        """Make so many ticks and publish; 0: the same moment again, with what was sent since.

        When a system raises, nothing is published, and poses stay what they were.
        """
        require(ticks >= 0, "ticks", "0 or more", ticks)
        require(self._running == 0, "step", "a stage between two ticks", "one that is in a tick")
        come = [self._inbox.popleft() for _ in range(len(self._inbox))]
        self._queue += come
        if self.journal is not None:
            self.journal.append((ticks, tuple(event for _, _, event in come)))
        if ticks > 1 and self.simulates:
            for _ in range(ticks - 1):
                self._tick(1)
            ticks = 1
        self._tick(ticks)
        return self.frame

    def advance(self, elapsed: float) -> Frame:
        """Let `elapsed` seconds outside go by: makes the ticks that are due, with sight only of the last of them.

        With systems that must not miss a tick at most `CATCH_UP` are made and the others dropped (`clock.dropped`).
        The same frame again when nothing is due and nothing was sent.
        """
        ticks = self.clock.due(elapsed)
        if self.simulates and ticks > CATCH_UP:
            self.clock.dropped += ticks - CATCH_UP
            ticks = CATCH_UP
        now = self.clock.total
        waiting = bool(self._inbox) or any(e.time is None or e.time <= now for _, _, e in self._queue)
        return self.step(ticks) if ticks or waiting else self.frame

    def replay(self, journal: Sequence[tuple[int, tuple[Event, ...]]]) -> Iterable[Frame]:
        """The frames of another stage of the same making, by its journal: equal to the bit."""
        for ticks, events in journal:
            for event in events:
                self.send(event.kind, event.actor, event.name, event.value, time=event.time)
            yield self.step(ticks)

    @property
    def simulates(self) -> bool:
        """Whether a system must not miss a tick."""
        return any(s.every for s in self.systems)

    def _tick(self, ticks: int) -> None:
        self._running = get_ident()
        self.happened = []
        try:
            leaps = [self._transport(event) for event in self._take(TRANSPORT)]
            dt, self.leapt = 0.0, any(leaps)
            if self.leapt:
                self.clock.tick += ticks  # it shows the moment that it leapt to
            else:
                dt = self.clock.move(ticks)
            for system in tuple(self.systems):
                system.run(self, dt)
        except BaseException:
            self.workshop.ask_again()  # what hooks let through was not published
            raise
        finally:
            self._running = 0

    def _numbered(self, event: Event) -> tuple[float, int, Event]:
        return (math.inf if event.time is None else event.time, next(self._numbers), event)

    def _take(self, kinds: Iterable[str], but: bool = False) -> list[Event]:
        """Events of these (or all but these) kinds that are due, the earliest first."""
        if not self._queue:
            return []
        now = self.clock.total + 1e-9
        some: list[tuple[float, int, Event]] = []
        left: list[tuple[float, int, Event]] = []
        for entry in self._queue:
            event = entry[2]
            due = (event.time is None or event.time <= now) and (event.kind in kinds) != but
            (some if due else left).append(entry)
        self._queue[:] = left
        return [e for _, _, e in sorted(some, key=lambda entry: entry[:2])]

    def asked(self, event: Event) -> Event | None:
        """The event as hooks leave it; None when it was dropped, HOLD when it has to wait."""
        for hook in self.hooks:
            if hook.wants(event.kind, event.actor, event.name):
                answer = hook.run(self, event)
                if answer is None or answer is HOLD:
                    return answer
                event = answer
        return event

    def _asked(self, event: Event) -> Event | None:
        """`asked`, where an event that has to wait is sent again."""
        answer = self.asked(event) if self.hooks else event
        if answer is HOLD:
            self._queue.append(self._numbered(event))
            return None
        if answer is not None:
            self.happened.append(answer)
        return answer

    def _transport(self, event: Event) -> bool:
        """Whether the clock leapt."""
        clock = self.clock
        asked = self._asked(event)
        if asked is None:
            return False
        if asked is not event:
            asked = self.checked(asked)
        if asked.kind == "play":
            clock.play()
        elif asked.kind == "pause":
            clock.playing = False
        elif asked.kind == "loop":
            clock.loop = asked.value
        elif asked.kind == "speed":
            backwards = asked.value < 0 and self.simulates
            require(not backwards, "speed", "0 or more on a stage that simulates", asked.value)
            clock.speed = asked.value
        else:
            clock.seek(asked.value)
            return True
        return False

    def _actor(self, name: str) -> Actor:
        if name not in self.actors:
            raise VitruvianError(f"stage: expected one of the actors {', '.join(self.actors)}, found {name!r:.60}")
        return self.actors[name]

    def _check(self, kind: str, actor: Actor, name: str, value: Any) -> None:
        """Refuse at once what could not be done later."""
        who = f"event {kind}: {actor.name}"
        if actor.body is None:
            raise VitruvianError(f"{who} has no joints")
        if kind in ("rotation", "translation", "turn"):
            require(name in actor.skeleton.index, who, "a joint that it has", f"{name!r:.60}")
        elif kind == "weight":
            require(name in actor.displacers, who, "a displacer that it has", f"{name!r:.60}")
        elif kind == "extremity":
            known = parts(actor.skeleton)
            require(name in known, who, f"one of {', '.join(known) or 'none'}", f"{name!r:.60}")
        elif kind == "level":
            self._level(actor, value)
            self.workshop.bound(actor, body=actor.levels[value].body)
        elif kind == "finer":
            same = actor.skeleton.names == value[0].skeleton.names
            morphs = [m.name for m in actor.morphs] == [m.name for m in value[0].skin.morphs]
            require(same and morphs, who, "the same joints and displacers", "others")
            assert actor.body is not None
            inner = indices(value[1], f"{who}: vertices", len(value[0].skin.rest), len(actor.body.skin.rest))
            meets = np.array_equal(value[0].skin.rest[inner], actor.body.skin.rest)
            require(meets, who, "a body that has all points of the present one", "one that lacks some")
            self.workshop.bound(actor, body=value[0])
        elif kind == "deformer":
            self.workshop.bound(actor, deformer=name, options=value)

    def _level(self, actor: Actor, level: int) -> None:
        """Make the level of a contour body that nobody gave: every second (fourth, eighth) contour and point."""
        if level in actor.levels:
            return
        assert actor.body is not None
        known = ", ".join(map(str, sorted(actor.levels)))
        good = bool(actor.body.contours) and level <= AUTOMATIC
        require(good, f"level of {actor.name}", f"one of {known}, or a body with contours and 1 to {AUTOMATIC}", level)
        from vitruvian.modeling.detail import coarser

        actor.levels[level] = Level(*coarser(actor.body, contours=2**level, points=2**level))


def _animate(stage: Stage, dt: float) -> None:
    """Motions at this time."""
    for actor in stage.actors.values():
        actor.sample(stage.clock)


def _intercept(stage: Stage, dt: float) -> None:
    """Events take effect, then hooks see what joints and displacers would get."""
    for event in stage._take(TRANSPORT, but=True):
        if event.kind in ("rotation", "translation"):  # hooks see what comes of them
            actor = stage.actors[event.actor]
            if event.name in actor.index:
                apply(actor, event)
            else:
                stage.findings.append(f"{actor.name} has no joint for {event.name}: its rotation is passed through")
                stage.happened.append(event)
            continue
        asked = stage._asked(event)
        if asked is not None and asked is not event:  # a hook's own words
            asked = stage.checked(asked)
        if asked is not None and asked.kind in ACTOR:
            apply(stage.actors[asked.actor], asked)
    for actor in stage.actors.values():
        stage.workshop.begin(stage, actor)


def _publish(stage: Stage, dt: float) -> None:
    """Let go of poses and points of this tick together."""
    finished, later = stage.workshop.finished, []
    if len(stage.systems) > BUILT_IN:
        names = [s.name for s in stage.systems]
        later = names[names.index("deform") + 1 : names.index("publish")]
    posed = {actor.name: finished(actor, later) for actor in stage.actors.values()}
    stage.workshop.commit()
    clock = stage.clock
    stage.frame = Frame(clock.tick, clock.time, clock.round, posed, tuple(stage.happened))
    for actor in stage.actors.values():
        actor.posed = posed[actor.name]


def apply(actor: Actor, event: Event) -> None:
    """An event that hooks have let through, on the actor it is for."""
    kind, name, value = event.kind, event.name, event.value
    if kind in ("rotation", "translation"):
        array = getattr(actor, kind).copy()
        array[actor.skeleton.index[name]] = value
        setattr(actor, kind, array)
    elif kind == "turn":
        actor.turns = _with(actor.turns, actor.skeleton.index[name], value)
    elif kind == "weight":
        actor.shaped = _with(actor.shaped, actor.displacers[name], value)
    elif kind == "shift":
        actor.shift = value
    elif kind == "clear":
        actor.turns, actor.shaped, actor.shift = MappingProxyType({}), MappingProxyType({}), None
    elif kind == "deformer":
        actor.deformer, actor.options = name, value
    elif kind == "level":
        actor.level = value
    elif kind == "finer":
        actor.refine(*value)
    elif kind == "extremity":
        actor.still = actor.still - {name} if value else actor.still | {name}


def _with(mapping: Any, key: int, value: Any) -> Any:
    """The mapping with one entry more, or without it when the value is None."""
    out = {k: v for k, v in mapping.items() if k != key}
    return MappingProxyType(out if value is None else out | {key: value})
