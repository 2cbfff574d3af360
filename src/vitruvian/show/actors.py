"""What is on stage, as the messages that the page understands: a `mesh` message once, pose blocks per frame.

The page gets poses, not vertices: it deforms by itself with the deformers it knows. For the others (`SERVED`) vertices
are computed here and sent quantised.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.seams import split_seams
from vitruvian.body.types import Body, Part
from vitruvian.deform.hand_links import hands_of
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.motion.types import Motion
from vitruvian.show.explore import details
from vitruvian.show.openness import openness, owners, reaches
from vitruvian.show.wire import Block, encode, quantise, quantise_normals
from vitruvian.stage.clip import Clip, Mesh

PAGE = ("linear", "dual-quaternion", "log")  # deform.js
SERVED = ("volume", "hand", "contours", "hybrid", "log-pair", "log-absolute")  # computed here, sent as vertices


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

    def __len__(self) -> int:
        return len(self.poses)

    @cached_property
    def joint_index(self) -> dict[str, int]:
        return self.body.skeleton.index if self.body else {}

    @cached_property
    def displacer_index(self) -> dict[str, int]:
        return {m.name: i for i, m in enumerate(self.body.skin.morphs)} if self.body else {}


def actors_of(things: Sequence[object]) -> list[Actor]:
    """An actor for each Clip, Humanoid, Body or Mesh, with names that differ; `VitruvianError` for anything else."""
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
    return actors


def _actor(thing: object) -> Actor:
    if isinstance(thing, Mesh):
        empty = np.zeros((1, 0, 12), np.float32)
        return Actor(thing.name or "object", None, thing, empty, np.zeros((1, 0), np.float32), 30.0)
    if isinstance(thing, Humanoid):
        from vitruvian.body.pack import pack

        return _moving(pack(thing), None, "log", thing)
    if isinstance(thing, Body):
        return _moving(thing, None, "log")
    if isinstance(thing, Clip):
        return _moving(thing.body, thing.motion, thing.deformer, thing.humanoid)
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
    travel = _travel(motion) if motion is not None and motion.loop else np.zeros(3)
    return Actor(body.name or "figure", body, None, poses, weights, fps, deformer, travel, humanoid)


def _travel(motion: Motion) -> NDArray[np.float64]:
    """Displacement (3,) on the floor of one round: from the first frame to the one that would follow the last."""
    t = motion.translation
    if len(t) < 3:
        return np.zeros(3)
    step = (t[-1] - t[-2] + t[1] - t[0]) / 2
    travel = (t[-1] + step - t[0]) * [1.0, 0.0, 1.0]
    return travel if np.linalg.norm(travel) > 0.05 else np.zeros(3)


def sample(actor: Actor, seconds: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Pose (J,12) and displacer weights (D,) at a time; between frames in proportion, after the end the last frame.

    A loop that travels leads from its last frame on to the first one of the next round.
    """
    n = len(actor)
    at = min(max(seconds * actor.fps, 0.0), n if actor.travel.any() else n - 1)
    i = min(int(at + 1e-6), n - 1)
    part = np.float32(at - i)
    if part < 1e-5 or n == 1:
        return actor.poses[i], actor.weights[i]
    j = (i + 1) % n
    following = actor.poses[j]
    if j == 0:
        following = following.copy()
        following[:, 3::4] += actor.travel.astype(np.float32)
    pose = actor.poses[i] + part * (following - actor.poses[i])
    return pose, actor.weights[i] + part * (actor.weights[j] - actor.weights[i])


def mesh_message(actor: Actor) -> bytes:
    """Everything about an actor that does not move: sent once."""
    if actor.mesh is not None:
        return _still(actor.name, actor.mesh)
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
    fields: dict[str, Any] = {
        "actor": actor.name,
        "joints": list(skeleton.names),
        "parents": skeleton.parents.tolist(),
        **details(body, actor.humanoid),
        "parts": [_part(p) for p in skin.parts],
        "deformer": actor.deformer,
        "travel": actor.travel.tolist(),
        "frames": len(actor),
        "fps": actor.fps,
    }
    return encode("mesh", fields, blocks)


def _still(name: str, mesh: Mesh) -> bytes:
    blocks = [
        Block("rest", mesh.vertices.astype(np.float32), name),
        Block("triangles", mesh.triangles.astype(np.uint32), name),
    ]
    if mesh.uv is not None:
        blocks.append(Block("uv", mesh.uv.astype(np.float32), name))
    if mesh.colors is not None:
        blocks.append(Block("colors", _bytes(mesh.colors), name))
    part = Part(mesh.name or "object", 0, len(mesh.triangles), double_sided=True)
    fields = {"actor": name, "joints": [], "parents": [], "sites": [], "displacers": [], "parts": [_part(part)]}
    return encode("mesh", fields | {"deformer": "", "travel": [0, 0, 0], "frames": 1, "fps": 30.0}, blocks)


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


class Vertices:
    """Positions and normals of an actor by one of the deformers that the page does not have. Kept between frames."""

    def __init__(self, actor: Actor, name: str):
        from vitruvian.deform.deformer import deformer

        assert actor.body is not None
        self.actor, self.binding = actor, actor.body.skeleton.binding
        self.run = deformer(name, actor.body, live=True)

    def blocks(self, pose: NDArray[np.float32], weights: NDArray[np.float32]) -> list[Block]:
        matrices = np.zeros((1, len(pose), 4, 4))
        matrices[0, :, :3] = pose.reshape(-1, 3, 4)
        matrices[0, :, 3, 3] = 1
        if self.binding is not None:
            matrices = matrices @ self.binding
        assert self.actor.body is not None
        names = [m.name for m in self.actor.body.skin.morphs]
        morphs = {name: np.array([w]) for name, w in zip(names, weights)} or None
        points = self.run(matrices, morphs)
        points = points[0] if points.ndim == 3 else points
        normals = np.asarray(self.run.normals(points)).reshape(-1, 3)
        q, scale, origin = quantise(points)
        name = self.actor.name
        return [Block("vertices", q, name, scale, origin), Block("normals", quantise_normals(normals), name)]


def turned(actor: Actor, pose: NDArray[np.float32], turns: dict[int, NDArray[np.float64]]) -> NDArray[np.float32]:
    """The pose with extra rotations (joint -> unit quaternion xyzw), each in its parent's frame, about its centre.

    The same as pose.js: `M'_j = D_j M_j`, `D_j = D_parent rot(x_j)`, where rot(x_j) turns about the posed centre.
    """
    if not turns or actor.body is None:
        return pose
    skeleton = actor.body.skeleton
    moved = pose.reshape(-1, 3, 4).astype(np.float64)
    out = moved.copy()
    change: dict[int, NDArray[np.float64]] = {}
    for j, parent in enumerate(skeleton.parents.tolist()):
        d = change.get(parent)
        if j in turns:
            rotation = _matrix(turns[j])
            if parent >= 0:
                u, _, vt = np.linalg.svd(moved[parent, :, :3])
                frame = u @ vt
                rotation = frame @ rotation @ frame.T
            x = moved[j, :, :3] @ skeleton.centers[j] + moved[j, :, 3]
            own = np.eye(4)
            own[:3, :3] = rotation
            own[:3, 3] = x - rotation @ x
            d = own if d is None else d @ own
        if d is not None:
            change[j] = d
            out[j] = d[:3, :3] @ moved[j]
            out[j, :, 3] += d[:3, 3]
    return out.reshape(-1, 12).astype(np.float32)


def _matrix(q: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z, w = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
