"""What can be photographed: a thing of any kind as surfaces at any time, and where its face and hands are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Union

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.seams import creases, face_normals
from vitruvian.body.types import Body, Part, Skeleton
from vitruvian.errors import VitruvianError
from vitruvian.motion.types import Motion
from vitruvian.show.surfaces import Surface, joined
from vitruvian.stage.clip import Clip, Mesh
from vitruvian.stage.vertex_cache import VertexCache
from vitruvian.stage.vertex_cache import surface as drawn

if TYPE_CHECKING:
    from vitruvian.hanim.humanoid import Humanoid

Array = NDArray[np.float64]
Thing = Union["Humanoid", Body, Clip, Mesh, Motion]
_BONE = Part("bone", 0, 0, (0.66, 0.61, 0.53), 0.45)
_WRISTS = ("{}_radiocarpal", "{}_wrist", "{}_hand")


def pose(motion: Motion, times: Sequence[float] | Array) -> Motion:
    """The motion at these times (seconds), one frame each: blended between frames, held or looped outside."""
    n = len(motion)
    at = np.asarray(times, np.float64) * motion.fps
    at = at % n if motion.loop and n > 1 else np.clip(at, 0, n - 1)
    a = np.floor(at + 1e-9).astype(int) % n
    b = (a + 1) % n if motion.loop else np.minimum(a + 1, n - 1)
    t = np.clip(at - a, 0, 1)

    def between(values: Array, wraps: bool = False) -> Array:
        x, y = values[a], values[b]
        share = t.reshape(-1, *[1] * (x.ndim - 1))
        if wraps:  # a looped walk goes on from where the last frame stands
            step = values[-1] - values[max(n - 2, 0)]
            last = ((a == n - 1) & (b == 0)).reshape(share.shape)
            y = np.where(last, x + step, y)
        return x + (y - x) * share

    x, y = motion.rotation[a], motion.rotation[b]
    y = np.where((x * y).sum(-1, keepdims=True) < 0, -y, y)
    share = t[:, None, None]
    rotation = x + (y - x) * share
    moves = None if motion.joint_translation is None else between(motion.joint_translation, True)
    weights = {k: between(w) for k, w in motion.weights.items()}
    return Motion(motion.skeleton, motion.fps, rotation, between(motion.translation, True), moves, weights)


class Figure:
    """A thing that can be photographed.

    Attributes: `skeleton` (or None), `motion` (or None), `seconds` of the motion, `fps`.
    """

    def __init__(self, thing: Thing):
        from vitruvian.hanim.humanoid import Humanoid

        self.motion: Motion | None = None
        self.skeleton: Skeleton | None = None
        self.humanoid: Humanoid | None = None
        self.body: Body | None = None
        self.mesh: Mesh | None = None
        self._caches: tuple[VertexCache, ...] = ()  # what it wears
        deformer = "log"
        if isinstance(thing, Humanoid):
            from vitruvian.body.pack import pack

            self.humanoid, self.body = thing, pack(thing)
        elif isinstance(thing, Clip):
            self.humanoid, self.body, self.motion = thing.humanoid, thing.body, thing.motion
            deformer = thing.deformer
            self._caches = thing.caches
            if thing.garment is not None and not thing.caches:
                from vitruvian.stage.baking import bake

                self._caches = bake(thing)
        elif isinstance(thing, Body):
            self.body = thing
        elif isinstance(thing, Mesh):
            self.mesh = thing
        elif isinstance(thing, Motion):
            self.motion, self.skeleton = thing, thing.skeleton
        else:
            raise VitruvianError(
                f"picture: expected a Humanoid, Body, Clip, Motion or Mesh, found {type(thing).__name__}"
            )
        if self.body is not None:
            self.skeleton = self.body.skeleton
        self._deformer = None
        if self.body is not None and len(self.body.skin.triangles):
            from vitruvian.deform.deformer import deformer as make

            self._deformer = make(deformer, self.body)
        self._strongest: NDArray[np.int32] | None = None
        self._sparse = self.body is not None and _sparse(self.body)
        self._creases = (
            creases(self.body.skin.rest, self.body.skin.triangles, self.body.skin.parts) if self.body else None
        )
        self._uv = None
        if self.body is not None and any(p.picture for p in self.body.skin.parts):
            skin = self.body.skin
            self._uv = None if skin.uv is None else skin.uv[skin.uv_triangles]
        self.fps = self.motion.fps if self.motion else 30.0
        self.seconds = self.motion.seconds if self.motion else 0.0
        self.placement = self.body.placement if self.body is not None else np.eye(4)

    def at(self, times: Sequence[float]) -> Iterator[Surface]:
        """One surface per time (seconds), in world space."""
        if self.mesh is not None:
            m = self.mesh
            scale = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}.get(m.unit, 1.0)
            part = Part(m.name, 0, len(m.triangles), (0.74, 0.72, 0.70), 0.55)
            for _ in times:
                yield Surface(m.vertices * scale, m.triangles, None, m.colors, (part,), m.vertices)
            return
        for start in range(0, len(times), 16):
            some = list(times)[start : start + 16]
            matrices, weights = self._matrices(some)
            if self._deformer is None:
                for m in matrices:
                    yield self._bones(m)
                continue
            skin = self.body.skin  # type: ignore[union-attr]
            known = {m.name for m in skin.morphs}
            moved = self._deformer(matrices, morphs={k: w for k, w in weights.items() if k in known})
            for t, m, vertices in zip(some, matrices, np.asarray(moved, np.float64).reshape(-1, len(skin.rest), 3)):
                world = vertices @ self.placement[:3, :3].T + self.placement[:3, 3]
                normals = None
                if self._creases is not None:
                    normals = (self._creases @ face_normals(world, skin.triangles)).reshape(-1, 3, 3)
                surface = Surface(world, skin.triangles, normals, skin.colors, skin.parts, skin.rest, uv=self._uv)
                for cache in self._caches:
                    surface = joined(surface, self._cloth(cache, t))
                yield joined(surface, self._bones(m)) if self._sparse else surface

    def _matrices(self, times: Sequence[float]) -> tuple[Array, dict[str, Array]]:
        from vitruvian.body.kinematics import joint_matrices

        assert self.skeleton is not None
        if self.motion is None:
            return np.repeat(joint_matrices(self.skeleton).reshape(1, -1, 4, 4), len(times), axis=0), {}
        posed = pose(self.motion, times)
        return joint_matrices(self.skeleton, posed), posed.weights

    def _cloth(self, cache: VertexCache, time: float) -> Surface:
        """What is worn, at a time."""
        at = time * self.fps
        at = at % max(len(cache) - 1, 1) if self.motion is not None and self.motion.loop else min(at, len(cache) - 1)
        k = min(int(at + 1e-9), max(len(cache) - 2, 0))
        a, b = cache.positions[k].astype(np.float64), cache.positions[min(k + 1, len(cache) - 1)]
        points = a + (b - a) * min(max(at - k, 0.0), 1.0)
        world = points @ self.placement[:3, :3].T + self.placement[:3, 3]
        look = drawn(cache, cache.positions[0].astype(np.float64))
        return Surface(world, cache.triangles, None, None, look.parts, look.rest)

    def _bones(self, matrices: Array) -> Surface:
        """Bones and joints as solids, for a skeleton without a surface."""
        s = self.skeleton
        assert s is not None
        ends = np.einsum("jab,jb->ja", matrices[:, :3, :3], s.centers) + matrices[:, :3, 3]
        ends = ends @ self.placement[:3, :3].T + self.placement[:3, 3]
        size = max(float(np.ptp(s.centers, axis=0).max()), 1e-3)
        corners, faces = [], []
        for j, parent in enumerate(s.parents):
            corners.append(ends[j] + _BALL * 0.009 * size)
            faces.append(_BALL_FACES)
            length = float(np.linalg.norm(ends[j] - ends[parent])) if parent >= 0 else 0.0
            if length > 1e-4 * size:
                corners.append(_bone(ends[parent], ends[j], min(0.12 * length, 0.018 * size)))
                faces.append(_BONE_FACES)
        counts = np.cumsum([0, *(len(c) for c in corners)])
        triangles = np.concatenate([f + n for f, n in zip(faces, counts)]).astype(np.int32)
        vertices = np.concatenate(corners)
        face = vertices[triangles]
        normal = np.cross(face[:, 1] - face[:, 0], face[:, 2] - face[:, 0])
        part = Part(_BONE.name, 0, len(triangles), _BONE.color, _BONE.roughness)
        return Surface(vertices, triangles, np.repeat(normal[:, None], 3, axis=1), None, (part,))

    def heading(self, time: float | None = None) -> float:
        """Degrees that the figure is turned about Y, from its root's mean over a second (None: over everything)."""
        forward = self.placement[:3, :3] @ [0, 0, 1.0]
        if self.motion is not None:
            span = (0.0, self.motion.seconds) if time is None else (time - 0.5, time + 0.5)
            x, y, z, w = pose(self.motion, np.linspace(*span, 15)).rotation[:, 0].T
            local = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], -1)
            forward = self.placement[:3, :3] @ local.mean(axis=0)
        return float(np.degrees(np.arctan2(forward[0], forward[2]))) if np.hypot(forward[0], forward[2]) > 0.1 else 0.0

    def path(self, times: Sequence[float]) -> Array:
        """Where the figure is on the floor (n,3), low-passed over about a second: what a camera follows."""
        if self.motion is None:
            return np.zeros((len(times), 3))
        fine = np.arange(0, max(self.motion.seconds, 1 / self.fps), 1 / self.fps)
        root = pose(self.motion, fine).translation * [1, 0, 1]
        root = root @ self.placement[:3, :3].T
        from scipy.ndimage import gaussian_filter1d

        line = np.zeros_like(root)
        if len(root) > 2:  # smooth what is left of the straight way, so that the ends do not lag behind
            t = np.linspace(0, 1, len(root))[:, None]
            line = root[0] + (root[-1] - root[0]) * t
        smooth = line + gaussian_filter1d(root - line, 0.4 * self.fps, axis=0, mode="nearest")
        return np.stack([np.interp(times, fine, smooth[:, i]) for i in range(3)], -1)

    def places(self, surface: Surface, time: float) -> dict[str, Array]:
        """What the views "face" and "hands" look at, points (n,3), and the frames (4,4) of the Sites named `_view`
        and of the Humanoid's viewpoints."""
        out: dict[str, Array] = {}
        s = self.skeleton
        if s is None or self.body is None:
            return out
        if len(surface.vertices) >= len(self.body.skin.rest):  # bones may follow
            for name, joints in (("face", ("skullbase", "skull")), ("l", _WRISTS), ("r", _WRISTS)):
                joint = next((s.index[j.format(name)] for j in joints if j.format(name) in s.index), None)
                points = surface.vertices[self._below(joint)] if joint is not None else np.zeros((0, 3))
                if len(points) >= 4:
                    out[name if name == "face" else f"hands-{name}"] = points
        matrices = self._matrices([time])[0][0]
        turned = self._turned_sites()
        for name, joint, point in zip(s.site_names, s.site_joints, s.site_points):
            if name.endswith("_view"):
                frame = np.eye(4)
                frame[:3, :3], frame[:3, 3] = turned.get(name, np.eye(3)), point
                frame = self.placement @ matrices[joint] @ frame
                out[name] = frame if name in turned else looking(frame, surface.vertices)
        if self.humanoid is not None and self.humanoid.viewpoints:
            out |= self._viewpoints()
        return out

    def _viewpoints(self) -> dict[str, Array]:
        """Frames (4,4) of the Humanoid's own viewpoints, which stay where it was put down."""
        from vitruvian.show.explore import cameras

        assert self.body is not None
        out = {}
        for camera in cameras(self.body, self.humanoid):
            if camera["joint"] < 0:
                frame = np.eye(4)
                back = -np.array(camera["look"])
                side = np.cross([0.0, 1.0, 0.0] if abs(back[1]) < 0.999 else [0.0, 0.0, 1.0], back)
                side /= np.linalg.norm(side)
                frame[:3, :3] = np.stack([side, np.cross(back, side), back], axis=1)
                frame[:3, 3] = camera["eye"]
                out[str(camera["name"])] = self.placement @ frame
        return out

    def _turned_sites(self) -> dict[str, Array]:
        """Rotations (3,3) of the Sites that have one: those say themselves where they look."""
        from vitruvian.body.rotations import from_axis_angle, to_matrix

        sites = self.humanoid.all_sites() if self.humanoid is not None else []
        return {s.name: to_matrix(from_axis_angle(s.rotation)) for s in sites if abs(s.rotation[3]) > 1e-6}

    def _below(self, joint: int) -> NDArray[np.int64]:
        """Skin vertices that follow this joint or one below it most, and belong to a drawn triangle."""
        assert self.body is not None
        skin, s = self.body.skin, self.body.skeleton
        if self._strongest is None:
            self._strongest = skin.weights.top(1)[0][:, 0]
        under = np.zeros(len(s), bool)
        under[joint] = True
        for j, parent in enumerate(s.parents):
            under[j] |= parent >= 0 and under[parent]
        drawn = np.zeros(len(skin.rest), bool)
        drawn[skin.triangles] = True
        return np.flatnonzero(under[self._strongest] & drawn & (skin.weights.counts > 0))


def _sparse(body: Body) -> bool:
    """Whether the surface is little more than marks on the joints, so that bones help to see the figure."""
    area = np.linalg.norm(face_normals(body.skin.rest, body.skin.triangles), axis=1).sum() / 2
    tall = np.ptp(body.skeleton.centers, axis=0).max()
    return len(body.skeleton) > 5 and area < 0.12 * tall**2


def looking(frame: Array, points: Array) -> Array:
    """The frame turned so that its -Z axis points at the figure: at its middle from afar, level from near by."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, tall = (low + high) / 2, high[1] - low[1]
    back = frame[:3, 3] - middle
    if np.hypot(back[0], back[2]) < 1.2 * tall:
        back[1] = frame[1, 3] - np.clip(frame[1, 3], low[1] + 0.1 * tall, high[1] - 0.06 * tall)
    back /= max(float(np.linalg.norm(back)), 1e-9)
    right = np.cross([0, 1, 0], back)
    right /= max(float(np.linalg.norm(right)), 1e-9)
    out = np.eye(4)
    out[:3, :3] = np.stack([right, np.cross(back, right), back], -1)
    out[:3, 3] = frame[:3, 3]
    return out


def _bone(a: Array, b: Array, radius: float) -> Array:
    """Corners (6,3) of a bone: two points and a square near the first."""
    axis = (b - a) / np.linalg.norm(b - a)
    side = np.cross(axis, [1.0, 0, 0] if abs(axis[0]) < 0.9 else [0, 1.0, 0])
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    waist = a + 0.18 * (b - a)
    return np.stack(
        [a, waist + radius * side, waist + radius * other, waist - radius * side, waist - radius * other, b]
    )


_BONE_FACES = np.array([[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 1, 4], [5, 1, 2], [5, 2, 3], [5, 3, 4], [5, 4, 1]])


def _ball(rings: int = 6, around: int = 10) -> tuple[Array, NDArray[np.int64]]:
    t, p = np.pi * np.arange(1, rings) / rings, 2 * np.pi * np.arange(around) / around
    body = np.stack(
        [np.outer(np.sin(t), np.sin(p)), np.outer(np.cos(t), np.ones(around)), np.outer(np.sin(t), np.cos(p))], -1
    )
    points = np.concatenate([[[0, 1.0, 0]], body.reshape(-1, 3), [[0, -1.0, 0]]])
    i, faces = np.arange(around), []
    j, last = (i + 1) % around, len(points) - 1
    faces.append(np.stack([0 * i, 1 + i, 1 + j], -1))
    for r in range(rings - 2):
        a, b = 1 + r * around, 1 + (r + 1) * around
        faces += [np.stack([a + i, b + i, b + j], -1), np.stack([a + i, b + j, a + j], -1)]
    faces.append(np.stack([last + 0 * i, last - around + j, last - around + i], -1))
    return points, np.concatenate(faces)


_BALL, _BALL_FACES = _ball()
