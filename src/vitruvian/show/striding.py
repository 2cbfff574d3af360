"""A garment on the desk that is worn in motion: its body walks on the spot, as on a stage.

Source: seed 003, section 5.3 (what is being designed is seen on the animated body); note cloth.md, section 14.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from vitruvian.body.types import Body
from vitruvian.cloth.garment import Garment
from vitruvian.errors import VitruvianError
from vitruvian.motion.gait import walk
from vitruvian.show.wire import Block, quantise
from vitruvian.stage.actor import Actor
from vitruvian.stage.stage import Stage

RATE = 30.0  # pictures a second
Tell = Callable[[str, dict[str, Any], list[Block]], None]


class Stride:
    """Somebody who walks in a garment, in a thread of its own, until `stop`. tell(kind, fields, blocks): `walk` with the
    state, "dressing", "walking", "stopped" or "failed", and `stride` with the points of body and cloth."""

    def __init__(self, body: Body, made: Garment, tell: Tell, ended: Callable[[], None]):
        self.body, self.made, self.tell, self.ended = body, made, tell, ended
        self.stopping = threading.Event()
        self.thread = threading.Thread(target=self._run, name="vitruvian stride", daemon=True)
        self.thread.start()

    def stop(self) -> None:
        """It ends after the picture that is being made, or once it is dressed."""
        self.stopping.set()

    def _run(self) -> None:
        self.tell("walk", {"state": "dressing"}, [])
        try:
            self._walk()
            self.ended()
            self.tell("walk", {"state": "stopped"}, [])
        except VitruvianError as error:
            self.tell("walk", {"state": "failed", "message": str(error)}, [])
        except Exception as error:  # nobody else would ever hear of it
            logging.getLogger(__name__).exception("the walk failed")
            self.tell("walk", {"state": "failed", "message": f"{type(error).__name__}: {error}"[:300]}, [])

    def _walk(self) -> None:
        actor = Actor("figure", self.body, motion=walk(self.body.skeleton, cycles=8))
        actor.garment = self.made
        stage = Stage([actor], rate=RATE)
        cloth = next(name for name in reversed(list(stage.actors)) if stage.actors[name].on is actor)
        self.tell("walk", {"state": "walking"}, [])
        due = time.monotonic()
        while not self.stopping.is_set():
            frame = stage.step()
            body, worn = frame[actor.name], frame[cloth]
            assert body.vertices is not None and worn.vertices is not None
            shift = body.translation[0] * [1.0, 0.0, 1.0]
            blocks = []
            for name, points in (("body", body.vertices), ("vertices", worn.vertices)):
                q, scale, origin = quantise(points - shift.astype(np.float32))
                blocks.append(Block(name, q, "", scale, origin))
            self.tell("stride", {}, blocks)
            due = max(due + 1 / RATE, time.monotonic() - 1 / RATE)  # one who is late does not hurry after it
            self.stopping.wait(max(0.0, due - time.monotonic()))
