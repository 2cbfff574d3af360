"""What pages see: a stage, in the words of the page. Any number of pages show one showing; any of them may drive."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.hands import Rounding
from vitruvian.body.rotations import inverse, multiply
from vitruvian.body.types import Body
from vitruvian.errors import VitruvianError
from vitruvian.show.actors import PAGE, SERVED, Actor, able, clothes_on, mesh_messages, pose_blocks
from vitruvian.show.keeping import Keeping
from vitruvian.show.posing import Posing
from vitruvian.show.searching import Search
from vitruvian.show.textures import Sent
from vitruvian.show.wire import VERSION, Block, encode, quantise, quantise_normals
from vitruvian.stage.actor import Actor as Player
from vitruvian.stage.actor import Posed
from vitruvian.stage.stage import Frame, Stage

MAX_FINDINGS = 1000  # that a page lists; how many there are it always says
RATE = 240  # ticks a second at least, so that pages of any rate move evenly; only those that are looked at are made


class Showing:
    """A stage that pages look at, and how they drive it. Without a stage one is made for the actors: a round is as long
    as the longest of their motions, and the deformers in `leave` are left to the page."""

    def __init__(
        self,
        actors: Sequence[Actor],
        findings: Sequence[Mapping[str, Any]] = (),
        title: str = "",
        stage: Stage | None = None,
        leave: Sequence[str] = PAGE,
        keeping: Keeping | None = None,
    ):
        self.actors = list(actors)
        self.by_name = {a.name: a for a in self.actors}
        self.findings = [dict(f) for f in findings]
        self.title = title or ", ".join(a.name for a in self.actors)
        self.fps = max(a.fps for a in self.actors)
        self.frames = max(1, round(max(len(a) / a.fps for a in self.actors) * self.fps))
        self._meshes: dict[tuple[str, Body | None], list[bytes]] = {}
        self._pictures = Sent()
        self.own = stage is None
        if stage is not None and stage.clock.length == math.inf and any(a.motion is not None for a in self.actors):
            stage.clock.length, stage.clock.last = self.frames / self.fps, (self.frames - 1) / self.fps
        self.stage = staged(self.actors, self.fps, self.frames, leave) if stage is None else stage
        self.actors += clothes_on(self.stage, self.by_name)
        self.by_name = {a.name: a for a in self.actors}
        self.keeping = keeping or Keeping()  # what pages may save
        self.search = Search()
        self.posing = Posing(self.stage)
        self.change = 0  # counts everything that pages have to be told
        self.hands: dict[str, dict[str, Any]] = {}  # options of "hand" that pages set, of each actor
        self.wake: set[asyncio.Event] = set()
        self._since: float | None = None

    @property
    def playing(self) -> bool:
        return self.stage.clock.playing

    @playing.setter
    def playing(self, value: bool) -> None:
        self.stage.clock.playing = value

    @property
    def told(self) -> tuple[int, int]:
        """Differs when pages have to be told something."""
        return self.change, self.stage.sent

    @property
    def levels(self) -> dict[str, Body | None]:
        """The body of each actor at its level of detail, where points are computed here; others have the page's own."""
        actors = self.stage.actors.values()
        return {
            a.name: a.levels[a.level].body if a.body is not None and a.deformer in SERVED else a.body for a in actors
        }

    @property
    def meshes(self) -> list[bytes]:
        """What does not move, of all actors at their levels of detail."""
        bodies, out = self.levels, []
        for a in self.actors:
            key = (a.name, bodies[a.name])
            if key not in self._meshes:
                self._meshes[key] = mesh_messages(replace(a, body=bodies[a.name]), self._pictures)
            out += self._meshes[key]
        return out

    @property
    def pictures(self) -> dict[str, bytes]:
        """The pictures of all `meshes` that were asked for, each once, as messages by name: they come before those."""
        return {
            name: encode("picture", {"name": name, "mime": mime}, [Block("data", np.frombuffer(data, np.uint8))])
            for name, (mime, data) in self._pictures.data.items()
        }

    @property
    def deformers(self) -> dict[str, str]:
        return {a.name: a.deformer for a in self.stage.actors.values() if a.body is not None}

    @property
    def displaced(self) -> dict[str, dict[int, float]]:
        """Displacers (by number) that were set on top of the motion, of each actor."""
        return {a.name: dict(a.shaped) for a in self.stage.actors.values()}

    def begin(self) -> None:
        """Time starts to run when the first page looks."""
        if self._since is None:
            self._since = time.monotonic()

    def now(self) -> Frame:
        """The stage at this moment."""
        if self._since is None:
            return self.stage.advance(0.0)
        before, self._since = self._since, time.monotonic()
        playing = self.stage.clock.playing
        frame = self.stage.advance(self._since - before)
        if playing and not self.stage.clock.playing:
            self.change += 1
        return frame

    def apply(self, request: Mapping[str, Any]) -> bytes | None:
        """Do what a page asked for, and what to answer to that; `VitruvianError` for names that do not exist."""
        kind, stage, answer = request["type"], self.stage, None
        if kind in ("play", "pause"):
            stage.send(kind)
        elif kind == "seek":
            stage.seek(min(request["frame"], self.frames - 1.0) / self.fps)
        elif kind == "speed":
            stage.speed(float(request["value"]))
        elif kind == "step":
            at = stage.advance(0.0).time * self.fps  # after what was asked for before
            stage.pause()
            stage.seek((round(at) + request["frames"]) % self.frames / self.fps)
        elif kind == "loop":
            stage.send("loop", value=request["value"])
        elif kind in ("set_landmarks", "set_weights", "find_landmarks", "take_girths", "stop_search"):
            found = self.by_name.get(request["actor"])
            if found is None or (found.body is None) == (kind == "set_weights"):
                what = "a body" if kind == "set_weights" else "a mesh"
                raise VitruvianError(f"request {kind}: expected {what}, found {request['actor']!r:.60}")
            if kind.startswith("set_"):
                self.keeping.apply(request)
            else:
                assert found.mesh is not None
                self.search.apply(request, found.mesh)
        else:
            answer = self._edit(kind, request)
        if kind == "speed" and self.own:
            stage.clock.pace(ticks(self.fps, float(request["value"])))
        self.change += 1
        for event in self.wake:
            event.set()
        return answer

    def _edit(self, kind: str, request: Mapping[str, Any]) -> bytes | None:
        actor = self.by_name.get(request["actor"])
        if actor is None or actor.body is None:
            raise VitruvianError(f"request {kind}: expected an actor with joints, found {request['actor']!r:.60}")
        if kind in ("reach", "set_pose"):
            return self.posing.apply(request)
        if kind == "clear_pose":
            self.stage.send("clear", actor.name)
        elif kind == "deformer":
            name = request["name"]
            if name not in PAGE + SERVED:
                raise VitruvianError(f"request deformer: expected one of {', '.join(PAGE + SERVED)}")
            if not able(actor.body, name):
                raise VitruvianError(f"request deformer: {actor.name} has nothing that {name!r} could move")
            try:
                self.stage.send("deformer", actor.name, name, self.hands.get(actor.name) if name == "hand" else None)
            except (ImportError, ValueError) as error:
                raise VitruvianError(f"deformer {name} is not available: {error}") from None
        elif kind == "set_hands":
            roundings = {name: Rounding.read(words) for name, words in request["roundings"].items()}
            options = {"hands": roundings, "rounded": request["rounded"]}
            self.stage.send("deformer", actor.name, "hand", options)  # checks them, whatever deforms it now
            self.hands[actor.name] = options
        else:
            table = actor.joint_index if kind == "set_rotation" else actor.displacer_index
            name = request["joint"] if kind == "set_rotation" else request["name"]
            if name not in table:
                raise VitruvianError(f"request {kind}: {actor.name} has no {name!r:.60}")
            if kind == "set_rotation":
                self.stage.send("turn", actor.name, name, request["rotation"])
            else:
                self.stage.send("weight", actor.name, name, request.get("weight"))
        return None

    def running(self) -> dict[str, Any]:
        """How time runs, as pages show it."""
        clock = self.stage.clock
        return {"playing": clock.playing, "speed": clock.speed, "loop": clock.loop}

    def hello(self, deformers: Sequence[str] | None = None) -> bytes:
        """The first message. `deformers`: those that may be chosen; None: all that one of the bodies can take."""
        if deformers is None:
            bodies = [a.body for a in self.actors if a.body is not None]
            deformers = [*PAGE, *(name for name in SERVED if any(able(b, name) for b in bodies))]
        return encode(
            "hello",
            {
                "version": VERSION,
                "title": self.title,
                "actors": [a.name for a in self.actors],
                "frames": self.frames,
                "fps": self.fps,
                "findings": self.findings[:MAX_FINDINGS],
                "found": len(self.findings),
                "deformers": list(deformers),
                "keeps": self.keeping.told(),
            }
            | self.running(),
        )

    def frame(self, seq: int) -> bytes:
        """The message for this moment."""
        frame = self.now()
        at = frame.time * self.fps
        fields = {"seq": seq, "tick": int(at + 1e-6), "t": frame.time, "frame": at, "round": frame.round}
        state = self.running() | {"change": self.change, "deformers": self.deformers}
        return encode("frame", fields | state, self.blocks(frame))

    def blocks(self, frame: Frame) -> list[Block]:
        """Poses of all actors, and points of those that the page does not deform. `pose` and `displacers` are what the
        motion says, on which pages put what was set by themselves; points are of the pose `posed`, or `pose` without."""
        blocks: list[Block] = []
        for actor in self.actors:
            posed = frame[actor.name]
            player = self.stage.actors[actor.name]
            given = _rows(_unturned(posed, player) if posed.turns or posed.shift is not None else posed.joints)
            weights = player.weights if posed.shaped else posed.weights
            blocks += pose_blocks(actor, given, weights.astype(np.float32))
            if actor.marked is not None:
                blocks.append(Block("markers", actor.marked.at(frame.time * actor.fps), actor.name))
            cloth = player.on is not None
            if posed.vertices is None or posed.normals is None or (posed.deformer not in SERVED and not cloth):
                continue
            if posed.turns or posed.shift is not None:
                blocks.append(Block("posed", _rows(posed.joints), actor.name))
            q, scale, origin = quantise(posed.vertices)
            blocks.append(Block("vertices", q, actor.name, scale, origin))
            blocks.append(Block("normals", quantise_normals(posed.normals), actor.name))
        return blocks


def staged(actors: Sequence[Actor], fps: float, frames: int, leave: Sequence[str] = PAGE) -> Stage:
    """A stage for actors of a page, which leaves some deformers to it."""
    players = []
    for a in actors:
        player = Player(a.name, a.body, humanoid=a.humanoid, mesh=a.mesh, motion=a.motion, deformer=a.deformer)
        player.garment = a.garment
        players.append(player)
    stage = Stage(players, rate=ticks(fps, 1.0), length=frames / fps, last=(frames - 1) / fps, leave=leave)
    stage.clock.playing = frames > 1
    return stage


def ticks(fps: float, speed: float) -> float:
    """Ticks in a second of play, so many that frames of the motions are among them, at a speed of play."""
    return fps * math.ceil(RATE / fps / min(max(speed, 0.1), 1.0))


def _rows(matrices: NDArray[np.float64]) -> NDArray[np.float32]:
    """(J,12) float32: the first three rows of matrices (J,4,4)."""
    return np.ascontiguousarray(matrices[:, :3, :], dtype=np.float32).reshape(len(matrices), 12)


def _unturned(posed: Posed, player: Player) -> NDArray[np.float64]:
    """(J,4,4) joints without what was set on top of the motion: pages put that on by themselves."""
    which = list(posed.turns)
    rotation, translation = posed.rotation.copy(), posed.translation.copy()
    if which:
        rotation[which] = multiply(inverse(np.array([posed.turns[j] for j in which])), rotation[which])
    if posed.shift is not None:
        translation[0] -= posed.shift
    return player.kinematics(rotation[None], translation[None])[0]
