"""Events: everything that reaches a stage from outside, and the hooks that see it first.

Source: H-Anim deformation in VRML, interception of events: what turns a joint goes to the deformer first, and is released
together with the points; level-of-detail and extremity events are intercepted so that the right points are computed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from vitruvian.body.rotations import from_axis_angle
from vitruvian.body.types import Body, Ints, floats, require

if TYPE_CHECKING:
    from vitruvian.stage.stage import Stage


@dataclass(frozen=True, eq=False)
class Event:
    """One thing that shall happen, and what it changes.

    `kind`: one of `KINDS` or one that a system declared; `actor`: whose; `name`: of the joint, displacer, deformer or
    extremity. `time`: seconds of the play, through all rounds, at which it takes effect; None: with the next tick.
    `old`: what was so far, filled in for hooks.
    """

    kind: str
    actor: str = ""
    name: str = ""
    value: Any = None
    time: float | None = None
    old: Any = None


Hooked = Callable[["Stage", Event], Event | None]
HOLD: Final = Event("hold")  # what a hook answers to be asked again at the next tick; nothing changes until then


@dataclass(frozen=True, eq=False)
class Hook:
    """`run(stage, event)` is asked about events of a kind, of one actor and one name, or of any ("")."""

    run: Hooked
    kind: str
    actor: str = ""
    name: str = ""

    def wants(self, kind: str, actor: str, name: str) -> bool:
        return self.kind == kind and self.actor in ("", actor) and self.name in ("", name)


_ALIASES = {"l_thigh": "l_hip", "r_thigh": "r_hip"}  # printed in the source; H-Anim has no such joints


def of_script(event: Event) -> Event:
    """The rotation of a joint that a Script's event `hanim_JOINTDef`, an SFRotation (x y z angle), stands for."""
    joint = event.name.removeprefix("hanim_").removesuffix("Def")
    turn = from_axis_angle(floats(event.value, f"event {event.name}", 4))
    return replace(event, name=_ALIASES.get(joint, joint), value=turn)


def _rotation(value: object, where: str) -> Any:
    q = floats(value, where, 4)
    length = float(np.linalg.norm(q))
    require(length > 1e-6, where, "a quaternion x y z w", value)
    return q / length


def _turn(value: object, where: str) -> Any:
    return None if value is None else _rotation(value, where)


def _vector(value: object, where: str) -> Any:
    return floats(value, where, 3)


def _shift(value: object, where: str) -> Any:
    return None if value is None else floats(value, where, 3)


def _number(value: object, where: str) -> float:
    good = isinstance(value, (int, float, np.integer, np.floating)) and math.isfinite(value)
    require(bool(good), where, "a finite number", value)
    return float(value)  # type: ignore[arg-type]


def _weight(value: object, where: str) -> float | None:
    return None if value is None else _number(value, where)


def _seconds(value: object, where: str) -> float:
    number = _number(value, where)
    require(number >= 0, where, "0 or more seconds", number)
    return number


def _speed(value: object, where: str) -> float:
    number = _number(value, where)
    require(-4 <= number <= 4, where, "-4 to 4", number)
    return number


def _flag(value: object, where: str) -> bool:
    require(isinstance(value, bool | np.bool_), where, "true or false", value)
    return bool(value)


def _level(value: object, where: str) -> int:
    good = isinstance(value, int | np.integer) and not isinstance(value, bool) and int(value) >= 0
    require(good, where, "a level: 0 (all points), 1, ...", value)
    return int(value)  # type: ignore[call-overload]


def _finer(value: object, where: str) -> tuple[Body, Ints]:
    good = isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], Body)
    require(good, where, "a Body and which of its vertices the present one has", type(value).__name__)
    return value  # type: ignore[return-value]


def _options(value: object, where: str) -> dict[str, Any]:
    require(value is None or isinstance(value, Mapping), where, "options by name, or None", value)
    return dict(value or {})  # type: ignore[call-overload]


def _nothing(value: object, where: str) -> None:
    require(value is None, where, "no value", value)


TRANSPORT: dict[str, Callable[[object, str], Any]] = {
    "play": _nothing,
    "pause": _nothing,
    "seek": _seconds,
    "speed": _speed,
    "loop": _flag,
}
# What may happen to an actor. rotation, translation: the local ones of a joint, until its motion gives it others.
# turn: a rotation on top of what the motion says (in the parent's frame, about the joint), until another; None: none.
# shift: of the first joint, on top of the motion, until another; None: none.
# weight: of a displacer, instead of what the motion says; None: the motion's again. clear: no turns, shift and weights.
# deformer: by name, with options. level: how many points. finer: a body with more points becomes level 0, the others
# count one more. extremity: fingers, neck or toes, moving or still.
ACTOR: dict[str, Callable[[object, str], Any]] = {
    "rotation": _rotation,
    "translation": _vector,
    "turn": _turn,
    "shift": _shift,
    "weight": _weight,
    "clear": _nothing,
    "deformer": _options,
    "level": _level,
    "finer": _finer,
    "extremity": _flag,
}
KINDS = TRANSPORT | ACTOR
