"""What pages do to a pose as a whole: drag it by handles, and put a pose back as it was.

A drag is prepared at its first request and solved at each; the answer says which turns, and which shift of the first
joint, on top of the motion make the pose. They take effect on the stage as if they had been set one by one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.rotations import inverse, multiply
from vitruvian.body.types import Body, Floats
from vitruvian.errors import VitruvianError
from vitruvian.motion.dragging import Drag, handles
from vitruvian.show.explore import levels
from vitruvian.show.wire import encode
from vitruvian.stage.stage import Stage


def told(body: Body) -> list[dict[str, Any]]:
    """The handles of a body, as pages hear of them."""
    return [
        {"name": h.name, "joint": h.joint, "point": [float(x) for x in h.point], "main": h.main}
        for h in handles(body.skeleton)
    ]


@dataclass(frozen=True, eq=False)
class _Held:
    """A drag in progress: what it is known by, its solver, and the rotations and shift that the motion gives."""

    key: tuple[object, ...]
    drag: Drag
    rotation: Floats
    shift: Floats


@dataclass
class Posing:
    """The drags of a stage: one for each actor at a time."""

    stage: Stage
    _held: dict[str, _Held] = field(default_factory=dict)

    def apply(self, request: Mapping[str, Any]) -> bytes | None:
        """Do what `reach` or `set_pose` asks for; the answer to the page that asked, if there is one."""
        if request["type"] == "set_pose":
            self._put(request["actor"], request["turns"], request["shift"])
            return None
        return self._reach(request)

    def _put(self, actor: str, turns: Mapping[str, list[float]], shift: list[float]) -> None:
        """Have these turns and this shift on top of the motion, and no others."""
        player = self.stage.actors[actor]
        unknown = [name for name in turns if name not in player.index]
        if unknown:
            raise VitruvianError(f"request set_pose: {actor} has no {unknown[0]!r:.60}")
        self.stage.advance(0.0)  # what was asked for before counts as there
        names = player.skeleton.names
        for j in player.turns:
            if names[j] not in turns:
                self.stage.send("turn", actor, names[j], None)
        for name, turn in turns.items():
            self.stage.send("turn", actor, name, turn)
        self.stage.send("shift", actor, value=shift if any(shift) else None)

    def _reach(self, request: Mapping[str, Any]) -> bytes:
        name, places = request["actor"], request["places"]
        if request["name"] not in places:
            raise VitruvianError("request reach: expected a place for the handle that is dragged")
        order = (request["name"], *(n for n in places if n != request["name"]))
        key = (request["gesture"], order, request["level"])
        held = self._held.get(name)
        if held is None or held.key != key:
            held = self._held[name] = self._begun(name, order, request["level"], key)
        drag = held.drag
        found = drag.to({n: np.array(p, dtype=np.float64) for n, p in places.items()})
        turns = multiply(found.rotation[drag.moving], inverse(held.rotation[drag.moving]))
        names = self.stage.actors[name].skeleton.names
        answer = {names[j]: turn.tolist() for j, turn in zip(drag.moving, turns, strict=True)}
        for joint, turn in answer.items():
            self.stage.send("turn", name, joint, turn)
        moved = found.shift - held.shift
        if drag.shifts:
            self.stage.send("shift", name, value=moved)
        fields = {"actor": name, "gesture": request["gesture"], "turns": answer}
        short = dict(zip(drag.names, found.residual.tolist(), strict=True))
        return encode("reached", fields | {"shift": moved.tolist() if drag.shifts else None, "short": short})

    def _begun(self, name: str, order: tuple[str, ...], level: int, key: tuple[object, ...]) -> _Held:
        """A drag from the present pose on."""
        self.stage.advance(0.0)  # turns that were set just now are part of it
        player = self.stage.actors[name]
        skeleton = replace(player.skeleton, translation=player.translation, binding=None)
        rotation = player.wanted()[0].copy()
        own = player.rotation.copy()
        above: NDArray[np.signedinteger] = np.flatnonzero(
            np.array(levels(skeleton.names, skeleton.parents.tolist())) > level
        )
        rotation[above] = own[above] = [0.0, 0.0, 0.0, 1.0]  # the page has them follow their parents
        drag = Drag(skeleton, rotation, player.moved()[0], order, still=above.tolist())
        return _Held(key, drag, own, player.translation[0].copy())
