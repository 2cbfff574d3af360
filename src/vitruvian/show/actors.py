"""What is on stage, as the messages that the page understands: a `mesh` message once, pose blocks per frame.

The page gets poses, not vertices: it deforms by itself. While a live page shows one of `SERVED`, vertices are computed
on the stage and sent quantised as well: they keep twists continuous past 180 degrees, which a single pose does not tell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.seams import split_seams
from vitruvian.body.types import Body, Part
from vitruvian.cloth.garment import Garment
from vitruvian.deform.hand_links import hands_of
from vitruvian.errors import VitruvianError, warn
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.motion.types import Motion
from vitruvian.show.explore import details
from vitruvian.show.fit_view import FitView
from vitruvian.show.heat import Heat
from vitruvian.show.keeping import features
from vitruvian.show.marked import Marked
from vitruvian.show.openness import openness, owners, reaches
from vitruvian.show.posing import told as handled
from vitruvian.show.programs import program_blocks
from vitruvian.show.sticks import Sticks
from vitruvian.show.textures import Sent
from vitruvian.show.wire import Block, encode
from vitruvian.stage.actor import travel
from vitruvian.stage.clip import Clip, Mesh
from vitruvian.stage.stage import Stage

PAGE = ("linear", "dual-quaternion", "log")  # always computed in the page
SERVED = ("volume", "hand", "contours", "hybrid", "log-pair", "log-absolute")  # on live pages computed by the stage


def able(body: Body, name: str) -> bool:
    """Whether a deformer has what it needs of a body."""
    if name == "contours":
        return bool(body.contours)
    return name != "hand" or bool(hands_of(body))


@dataclass(frozen=True, eq=False)
class Actor:
    """One thing to show.

    poses (F,J,12) float32: rows of the 3x4 joint matrices in humanoid space without the file's binding, which the page
    applies; weights (F,D) float32 of the displacers; travel (3,): how far the figure gets in one round of a loop.
    """

    name: str
    body: Body | None
    mesh: Mesh | None
    poses: NDArray[np.float32]
    weights: NDArray[np.float32]
    fps: float
    deformer: str = "log"
    travel: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    humanoid: Humanoid | None = None  # what the body was packed from, for the names that arrays do not have
    motion: Motion | None = None
    twin: Body | None = None  # the same body with contours, which the page compares with
    heat: Heat | FitView | None = None  # how far it is from another surface, or how clothes fit
    marked: Marked | None = None  # the markers that moved it
    garment: Garment | None = None  # that it wears
    on: Actor | None = None  # what it is placed with, as clothes are

    def __len__(self) -> int:
        return len(self.poses)

    @cached_property
    def joint_index(self) -> dict[str, int]:
        return self.body.skeleton.index if self.body else {}

    @cached_property
    def displacer_index(self) -> dict[str, int]:
        return {m.name: i for i, m in enumerate(self.body.skin.morphs)} if self.body else {}


def actors_of(things: Sequence[object], *, compare: bool = False) -> list[Actor]:
    """An actor for each Clip, Humanoid, Body, Mesh, Heat, Marked or Sticks, with names that differ; `VitruvianError` else.

    `compare`: the first figure gets a twin that is sliced into contours (seconds), unless it has contours itself.
    """
    actors: list[Actor] = []
    taken: set[str] = set()
    for thing in things:
        actor = _actor(thing)
        name, n = actor.name, 2
        while name in taken:
            name, n = f"{actor.name} {n}", n + 1
        taken.add(name)
        actors.append(replace(actor, name=name))
    if not actors:
        raise VitruvianError("show: expected at least one Clip, Humanoid, Body or Mesh, found nothing")
    return _with_twin(actors) if compare else actors


def actors_on(stage: Stage, *, compare: bool = False) -> list[Actor]:
    """The actors of a stage, as pages see them. `compare`: as for `actors_of`."""
    out = []
    for a in stage.actors.values():
        if a.body is None:
            assert a.mesh is not None
            if a.on is None:
                out.append(replace(_actor(a.mesh), name=a.name))
        else:
            out.append(replace(_moving(a.body, a.motion, a.deformer, a.humanoid), name=a.name))
    return _with_twin(out) if compare else out


def clothes_on(stage: Stage, wearers: Mapping[str, Actor]) -> list[Actor]:
    """What the actors of a stage wear, as pages see it."""
    worn = [(a, a.mesh, a.on) for a in stage.actors.values() if a.on is not None and a.mesh is not None]
    return [replace(_actor(mesh), name=a.name, on=wearers[on.name]) for a, mesh, on in worn]


def _with_twin(actors: list[Actor]) -> list[Actor]:
    """The actors, the first figure with a twin that is sliced into contours."""
    first = next((i for i, a in enumerate(actors) if a.body is not None), None)
    if first is not None:
        actors[first] = replace(actors[first], twin=_sliced(actors[first]))
    return actors


def _sliced(actor: Actor) -> Body | None:
    """The body of an actor in contours; None, with a warning that says why, when it has or can have none."""
    from vitruvian.body.pack import pack
    from vitruvian.modeling.contours import contours

    assert actor.body is not None
    if actor.humanoid is None or actor.body.contours:
        return None
    try:
        made = pack(contours(actor.humanoid))
    except VitruvianError as error:
        warn(f"no contours to compare with: {error}")
        return None
    return made if made.skeleton.names == actor.body.skeleton.names else None


def _actor(thing: object) -> Actor:
    if isinstance(thing, Heat | FitView):
        return replace(_actor(thing.thing), name=thing.name, heat=thing)
    if isinstance(thing, Marked):
        return replace(_actor(thing.clip), marked=thing)
    if isinstance(thing, Sticks):
        return _moving(thing.body, thing.motion, "linear")
    if isinstance(thing, Mesh):
        empty = np.zeros((1, 0, 12), np.float32)
        return Actor(thing.name or "object", None, thing, empty, np.zeros((1, 0), np.float32), 30.0)
    if isinstance(thing, Humanoid):
        from vitruvian.body.pack import pack

        return _moving(pack(thing), None, "log", thing)
    if isinstance(thing, Body):
        return _moving(thing, None, "log")
    if isinstance(thing, Clip):
        return replace(_moving(thing.body, thing.motion, thing.deformer, thing.humanoid), garment=thing.garment)
    raise VitruvianError(f"show: expected a Clip, Humanoid, Body or Mesh, found {type(thing).__name__}")


def _moving(body: Body, motion: Motion | None, deformer: str, humanoid: Humanoid | None = None) -> Actor:
    from vitruvian.body.kinematics import joint_matrices

    if deformer not in PAGE + SERVED:
        raise VitruvianError(f"deformer: expected one of {', '.join(PAGE + SERVED)}, found {deformer}")
    bare = replace(body.skeleton, binding=None)
    matrices = joint_matrices(bare, motion)
    poses = np.ascontiguousarray(matrices[:, :, :3, :], dtype=np.float32).reshape(len(matrices), len(bare), 12)
    morphs = body.skin.morphs
    weights = np.tile(np.array([m.weight for m in morphs], np.float32), (len(poses), 1))
    for i, morph in enumerate(morphs):
        if motion is not None and morph.name in motion.weights:
            weights[:, i] = motion.weights[morph.name]
    fps = motion.fps if motion is not None else 30.0
    way = travel(motion) if motion is not None and motion.loop else np.zeros(3)
    return Actor(body.name or "figure", body, None, poses, weights, fps, deformer, way, humanoid, motion)


def mesh_messages(actor: Actor, sent: Sent | None = None) -> list[bytes]:
    """Everything about an actor and its twin that does not move: sent once, in this order. `sent` collects pictures."""
    sent = sent or Sent()
    messages = [mesh_message(actor, sent)]
    if actor.twin is not None:
        name = f"{actor.name} in contours"
        twin = replace(actor, name=name, body=actor.twin, deformer="contours", humanoid=None)
        messages.append(mesh_message(twin, sent, twin=actor.name))
    return messages


def mesh_message(actor: Actor, sent: Sent | None = None, *, twin: str = "") -> bytes:
    """Everything about an actor that does not move. `sent`: pictures that pages have, which gets those of this actor;
    `twin`: the actor that this is another surface of."""
    sent = sent or Sent()
    warm, told = _warm(actor)
    if actor.mesh is not None:
        return _still(actor, actor.mesh, warm, told)
    assert actor.body is not None
    body, skeleton, skin = actor.body, actor.body.skeleton, actor.body.skin
    source, triangles, uv = split_seams(skin)
    f32 = lambda a: np.asarray(a, dtype=np.float32)  # noqa: E731
    blocks = [
        Block("rest", f32(skin.rest), actor.name),
        Block("source", source.astype(np.uint32), actor.name),
        Block("triangles", triangles.astype(np.uint32), actor.name),
        Block("row", skin.weights.row.astype(np.uint32), actor.name),
        Block("joint", skin.weights.joint.astype(np.uint16), actor.name),
        Block("weight", f32(skin.weights.weight), actor.name),
        Block("centers", f32(skeleton.centers), actor.name),
        Block("limits", f32(_limits(skeleton.limits)), actor.name),
        Block("limit_orientation", f32(skeleton.limit_orientation), actor.name),
        Block("stiffness", f32(skeleton.stiffness), actor.name),
        Block("site_points", f32(skeleton.site_points), actor.name),
        Block("placement", f32(body.placement[:3]), actor.name),
    ]
    if len(triangles):
        shade = openness(skin.rest, skin.triangles, owners(skin.weights), reaches(skeleton))
        blocks.append(Block("openness", np.rint(255 * shade).astype(np.uint8), actor.name))
    if uv is not None:
        blocks.append(Block("uv", f32(uv), actor.name))
    if skin.colors is not None:
        blocks.append(Block("colors", _bytes(skin.colors), actor.name))
    if skeleton.binding is not None:
        blocks.append(Block("binding", f32(skeleton.binding[:, :3, :]).reshape(-1, 12), actor.name))
    if skin.morphs:
        rows = np.cumsum([0, *(len(m.index) for m in skin.morphs)])
        blocks += [
            Block("morph_row", rows.astype(np.uint32), actor.name),
            Block("morph_index", np.concatenate([m.index for m in skin.morphs]).astype(np.uint32), actor.name),
            Block("morph_offset", f32(np.concatenate([m.offset for m in skin.morphs])), actor.name),
        ]
    blocks += program_blocks(body, actor.name)
    blocks += warm
    if actor.marked is not None:
        told = {**told, "markers": list(actor.marked.names)}
        blocks += [
            Block("marker_joint", actor.marked.joint.astype(np.uint32), actor.name),
            Block("marker_point", f32(actor.marked.point), actor.name),
        ]
    fields: dict[str, Any] = {
        "actor": actor.name,
        **told,
        "joints": list(skeleton.names),
        "parents": skeleton.parents.tolist(),
        **details(body, actor.humanoid),
        "handles": handled(body),
        "parts": [_part(p) | (sent.part(p) if uv is not None else {}) for p in skin.parts],
        "deformer": actor.deformer,
        "travel": actor.travel.tolist(),
        "frames": len(actor),
        "fps": actor.fps,
    }
    return encode("mesh", fields | ({"twin": twin} if twin else {}), blocks)


def _warm(actor: Actor) -> tuple[list[Block], dict[str, Any]]:
    """Distances of an actor from another surface, NaN where there are none, and what is said about them."""
    if actor.heat is None:
        return [], {}
    blocks = [
        Block(f"heat_{k}" if k else "heat", values.astype(np.float32), actor.name)
        for k, values in enumerate(actor.heat.values())
    ]
    return blocks, {"heat": actor.heat.told()}


def _still(actor: Actor, mesh: Mesh, warm: list[Block], told: dict[str, Any]) -> bytes:
    name, way, on = actor.name, [0.0, 0.0, 0.0], None if actor.on is None else actor.on.name
    blocks = [
        *warm,
        Block("rest", mesh.vertices.astype(np.float32), name),
        Block("triangles", mesh.triangles.astype(np.uint32), name),
    ]
    if actor.on is not None and actor.on.body is not None:
        blocks.append(Block("placement", actor.on.body.placement[:3].astype(np.float32), name))
        way = actor.on.travel.tolist()
    if mesh.uv is not None and mesh.uv_triangles is None:
        blocks.append(Block("uv", mesh.uv.astype(np.float32), name))
    if mesh.colors is not None:
        blocks.append(Block("colors", _bytes(mesh.colors), name))
    part = Part(mesh.name or "object", 0, len(mesh.triangles), double_sided=True)
    fields: dict[str, Any] = {
        "actor": name,
        **told,
        "joints": [],
        "parents": [],
        "sites": [],
        "displacers": [],
        "parts": [_part(part)],
    }
    if actor.on is None:
        fields["features"] = features()
    return encode("mesh", fields | {"deformer": "", "travel": way, "on": on, "frames": 1, "fps": 30.0}, blocks)


def _limits(limits: NDArray[np.float64]) -> NDArray[np.float64]:
    """Limits (J,3,2) with NaN for every axis that is free: one without both, or whose lower is not below its upper."""
    bounded = (limits[..., 0] < limits[..., 1])[..., None] & np.isfinite(limits).all(axis=-1, keepdims=True)
    return np.where(bounded, limits, np.nan)


def _bytes(colors: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.rint(np.clip(colors, 0, 1) * 255).astype(np.uint8)


def _part(p: Part) -> dict[str, Any]:
    return {
        "name": p.name,
        "start": int(p.start),
        "stop": int(p.stop),
        "color": [float(c) for c in p.color],
        "roughness": float(p.roughness),
        "metallic": float(p.metallic),
        "opacity": float(p.opacity),
        "double_sided": bool(p.double_sided),
    }


def pose_blocks(actor: Actor, pose: NDArray[np.float32], weights: NDArray[np.float32]) -> list[Block]:
    """Blocks of one frame of an actor for the page's own deformers."""
    if actor.body is None:
        return []
    if not np.isfinite(pose).all():
        joint = actor.body.skeleton.names[int(np.flatnonzero(~np.isfinite(pose).all(axis=1))[0])]
        raise VitruvianError(f"pose of {actor.name}: expected finite matrices, found {joint} without")
    blocks = [Block("pose", pose, actor.name)]
    if any(m.drive for m in actor.body.skin.morphs):  # the page does not know what drives them
        from vitruvian.deform.morphs import driven

        matrices = np.zeros((1, len(pose), 4, 4))
        matrices[0, :, :3] = pose.reshape(-1, 3, 4)
        weights = weights.copy()
        for i, morph in enumerate(actor.body.skin.morphs):
            if morph.drive is not None:
                weights[i] += driven(morph.drive, matrices, int(actor.body.skeleton.parents[morph.drive.joint]))[0]
    return [*blocks, Block("displacers", weights, actor.name)] if weights.size else blocks
