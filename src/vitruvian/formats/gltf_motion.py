"""Poses and animations of glTF nodes as those of H-Anim joints.

For joint j, M_j = W_j B_j^-1 (see `gltf_rig`) and L_j = M_parent^-1 M_j = T(c + t) A T(-c): the translation is
t = L_j c - c, the rotation is the orthogonal factor of A, what is left is the scale. Nodes between joints and above
them are multiplied in. Source: glTF 2.0, section 3.11 and appendix C (interpolation).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.rotations import from_axis_angle, from_matrix, normalize, slerp, to_axis_angle, to_matrix
from vitruvian.body.types import Floats, Skeleton
from vitruvian.errors import warn
from vitruvian.formats.gltf_file import GltfFile, trs
from vitruvian.formats.gltf_rig import Rig, solid
from vitruvian.hanim.humanoid import Joint, Track
from vitruvian.motion.tracks import axis_angles
from vitruvian.motion.types import Motion, continuous

MAX_SAMPLES = 1 << 22  # frames times joints, of all animations of a file
MAX_CHANNELS = 1 << 16
MAX_KEYS = 1 << 23  # of all channels together
CURVE_FPS = 60.0  # a cubic spline is sampled at least this often
SAME_TURN, SAME_PLACE = 1e-3, 1e-3  # radians, metres: within these the end of a clip is its beginning
_WIDTH = {"translation": 3, "rotation": 4, "scale": 3}


@dataclass(eq=False)
class Channel:
    """One animated property of a node: keys (k,) seconds, values (k,w), of cubic splines (k,3,w)."""

    node: int
    path: str
    keys: Floats
    values: Floats
    how: str

    def at(self, times: Floats, after: NDArray[np.bool_]) -> Floats:
        """(n,w) at times (n,); where a step stands, `after` tells the value behind it from the one before."""
        keys, values = self.keys, self.values
        if len(keys) == 1:
            value = values[:, 1] if self.how == "CUBICSPLINE" else values
            return np.repeat(value, len(times), axis=0)
        if self.how == "STEP":
            index = np.where(after, np.searchsorted(keys, times, "right"), np.searchsorted(keys, times, "left")) - 1
            return values[np.clip(index, 0, len(keys) - 1)]
        right = np.clip(np.searchsorted(keys, times, "right"), 1, len(keys) - 1)
        span = keys[right] - keys[right - 1]
        t = np.clip((times - keys[right - 1]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
        if self.how == "LINEAR":
            if self.path == "rotation":
                return slerp(values[right - 1], values[right], t)
            return values[right - 1] + (values[right] - values[right - 1]) * t[:, None]
        t, span = t[:, None], span[:, None]
        start, end = values[right - 1], values[right]
        return (
            (2 * t**3 - 3 * t**2 + 1) * start[:, 1] + span * (t**3 - 2 * t**2 + t) * start[:, 2]
            + (-2 * t**3 + 3 * t**2) * end[:, 1] + span * (t**3 - t**2) * end[:, 0]
        )  # fmt: skip


@dataclass(eq=False)
class Animation:
    """One animation of a file. `fps`, `loop`: what our own writer left, else None."""

    name: str
    channels: list[Channel]
    fps: float | None = None
    loop: bool | None = None

    @property
    def seconds(self) -> float:
        return max((float(c.keys[-1]) for c in self.channels), default=0.0)

    def times(self) -> tuple[Floats, NDArray[np.bool_]]:
        """Times at which linear interpolation of all values gives the animation: steps have two, splines many."""
        plain, steps = [np.zeros(1)], []
        for c in self.channels:
            plain.append(c.keys)
            if c.how == "STEP":
                steps.append(c.keys[1:])
            if c.how == "CUBICSPLINE" and len(c.keys) > 1:
                parts = np.clip(np.ceil(np.diff(c.keys) * CURVE_FPS), 1, 10000).astype(int)
                plain += [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(c.keys, c.keys[1:], parts)]
        after = np.unique(np.concatenate(plain))
        before = np.unique(np.concatenate(steps)) if steps else np.zeros(0)
        times = np.concatenate([before, after])
        side = np.repeat([False, True], [len(before), len(after)])
        order = np.lexsort((side, times))
        return times[order], side[order]


def animations(file: GltfFile) -> list[Animation]:
    """All animations with at least one channel that can be read."""
    out: list[Animation] = []
    total = keys = 0
    for a, entry in enumerate(file.items("animations")):
        samplers, channels = file.objects(entry, "samplers"), []
        for c, channel in enumerate(file.objects(entry, "channels")):
            where = f"animation {a} channel {c}"
            target = file.object(channel, "target")
            path = target.get("path")
            if target.get("node") is None or path not in ("translation", "rotation", "scale", "weights"):
                continue
            total += 1
            if total > MAX_CHANNELS:
                file.bad(f"animations: expected at most {MAX_CHANNELS} channels")
            node = file.integer(target, "node", where, len(file.parents))
            sampler = samplers[file.integer(channel, "sampler", where, len(samplers))]
            channels.append(_channel(file, sampler, node, path, where))
            keys += len(channels[-1].keys)
            if keys > MAX_KEYS:
                file.bad(f"animations: expected at most {MAX_KEYS} keys together")
        if channels:
            ours = file.object(file.object(entry, "extras"), "hanim")
            fps, loop = ours.get("fps"), ours.get("loop")
            made = Animation(file.text(entry, "name") or f"animation_{a}", channels)
            made.fps = float(fps) if isinstance(fps, int | float) and 0 < fps < 1e5 else None
            made.loop = loop if isinstance(loop, bool) else None
            out.append(made)
    return out


def _channel(file: GltfFile, sampler: dict, node: int, path: str, where: str) -> Channel:
    how = sampler.get("interpolation", "LINEAR")
    if how not in ("LINEAR", "STEP", "CUBICSPLINE"):
        file.bad(f"{where}: expected LINEAR, STEP or CUBICSPLINE, found {str(how)[:40]!r}")
    keys = file.accessor(sampler.get("input", -1), ("SCALAR",), f"{where} input")
    if (np.diff(keys) < 0).any() or abs(keys[0]) > 1e9 or keys[-1] > 1e9:
        file.bad(f"{where} input: expected times that increase")
    keys = np.maximum(keys, 0.0)
    kinds = {"weights": ("SCALAR",), "rotation": ("VEC4",)}.get(path, ("VEC3",))
    values = file.accessor(sampler.get("output", -1), kinds, f"{where} output")
    each = 3 if how == "CUBICSPLINE" else 1
    if path == "weights":
        fits = len(values) % (len(keys) * each) == 0
        width = max(len(values) // (len(keys) * each), 1)
    else:
        fits, width = len(values) == len(keys) * each, _WIDTH[path]
    if not fits:
        file.bad(f"{where}: {len(keys)} keys do not fit {len(values)} values")
    values = values.reshape((len(keys), 3, width) if each == 3 else (len(keys), width))
    return Channel(node, path, keys, values, how)


class Player:
    """Matrices of a figure's joints at any time of an animation."""

    def __init__(self, file: GltfFile, rig: Rig, animation: Animation | None = None):
        self.file, self.rig = file, rig
        chosen: set[int] = set()
        for node in rig.bones:
            while node >= 0 and node not in chosen:
                chosen.add(node)
                node = file.parents[node]
        self.nodes = [i for i in file.order if i in chosen]
        self.tracks: dict[int, list[Channel]] = {}
        for channel in animation.channels if animation else []:
            if channel.node in chosen and channel.path != "weights":
                self.tracks.setdefault(channel.node, []).append(channel)
        self.home = np.linalg.inv(rig.world)
        self.unbind = np.linalg.inv(rig.bind)

    def _local(self, node: int, times: Floats, after: NDArray[np.bool_]) -> Floats:
        if node not in self.tracks:
            return self.file.local[node]
        state = {
            "translation": self.file.translation[node],
            "rotation": self.file.rotation[node],
            "scale": self.file.scale[node],
        }
        state |= {c.path: c.at(times, after) for c in self.tracks[node]}
        n = len(times)
        return trs(*(np.broadcast_to(state[p], (n, _WIDTH[p])) for p in ("translation", "rotation", "scale")))

    def parts(self, times: Floats, after: NDArray[np.bool_]) -> tuple[Floats, Floats, Floats]:
        """Rotation (n,J,4), translation (n,J,3) and what is left as scale (n,J,3,3), symmetric, of each joint."""
        rig, n = self.rig, len(times)
        world: dict[int, Floats] = {}
        for i in self.nodes:
            local = self._local(i, times, after)
            p = self.file.parents[i]
            world[i] = local if p < 0 else world[p] @ local
        matrices: list[Floats] = []
        rotation, shift = np.empty((n, len(rig), 4)), np.empty((n, len(rig), 3))
        scale = np.empty((n, len(rig), 3, 3))
        for j, node in enumerate(rig.bones):
            moved = np.broadcast_to(self.home @ world[node] @ self.unbind[j], (n, 4, 4))
            matrices.append(moved)
            p = rig.parents[j]
            own = moved if p < 0 else _inverse(matrices[p]) @ moved
            if not np.isfinite(own).all():
                self.file.bad(f"joint {rig.names[j]}: expected transforms that stay finite")
            c = rig.bind[j, :3, 3]
            shift[:, j] = own[:, :3, :3] @ c + own[:, :3, 3] - c
            turn, scale[:, j] = polar(own[:, :3, :3])
            rotation[:, j] = from_matrix(turn)
        return rotation, shift, scale


def _inverse(matrices: Floats) -> Floats:
    """Inverses (n,4,4); the identity where there is none (a bone scaled to nothing)."""
    return np.linalg.inv(np.where(solid(matrices)[:, None, None], matrices, np.eye(4)))


def polar(linear: Floats) -> tuple[Floats, Floats]:
    """Rotations R and symmetric S with linear = R S, (n,3,3) each.

    Nearly uniform scales by Newton's iteration (Bjorck and Bowie 1971), the others by singular values.
    """
    size = np.sqrt(np.einsum("nab,nab->n", linear, linear) / 3)
    turn = linear / np.maximum(size, 1e-30)[:, None, None]
    eye = np.eye(3)
    gram = np.einsum("nab,nac->nbc", turn, turn)
    even = (np.abs(gram - eye).max(axis=(1, 2)) < 1e-2) & (np.linalg.det(turn) > 0)
    for _ in range(3):
        turn = 1.5 * turn - 0.5 * turn @ np.einsum("nab,nac->nbc", turn, turn)
    rest = np.flatnonzero(~even)
    if len(rest):
        u, _, vt = np.linalg.svd(linear[rest])
        u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
        turn[rest] = u @ vt
    stretch = np.einsum("nba,nbc->nac", turn, linear)
    return turn, (stretch + stretch.transpose(0, 2, 1)) / 2


def pose(file: GltfFile, rig: Rig, joints: list[Joint], exact: bool) -> None:
    """Give joints the pose that the nodes have, where it is not the bind pose; foreign rounding is no pose."""
    turn, place = (1e-7, 1e-7) if exact else (SAME_TURN, 1e-4)
    rotation, shift, scale = (x[0] for x in Player(file, rig).parts(np.zeros(1), np.ones(1, bool)))
    for joint, q, t, s in zip(joints, to_axis_angle(rotation), shift, scale):
        if q[3] > turn:
            joint.rotation = q
        if np.abs(t).max() > place:
            joint.translation = t
        if np.abs(s - np.eye(3)).max() > (1e-6 if exact else 1e-3):
            joint.scale, joint.scale_orientation = stretched(s)


def stretched(symmetric: Floats) -> tuple[Floats, Floats]:
    """Scale (3,) and scaleOrientation (4,) of a symmetric matrix: S = R(so) diag(scale) R(so)^-1."""
    if np.abs(symmetric - np.diag(np.diag(symmetric))).max() < 1e-6 * np.abs(symmetric).max():
        return np.diag(symmetric).copy(), np.array([0.0, 0, 1, 0])
    values, axes = np.linalg.eigh(symmetric)
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    return values, to_axis_angle(from_matrix(axes))


def _sampled(
    file: GltfFile, rig: Rig, animation: Animation, times: Floats, after: NDArray
) -> tuple[Floats, Floats, Floats | None]:  # fmt: skip
    """Rotation (n,J,4), translation (n,J,3) and, where joints grow or shrink, scale (n,J,3,3) at the times."""
    file.samples += len(times) * max(len(rig), len(file.order) // 8)
    if file.samples > MAX_SAMPLES:
        file.bad(f"animation {animation.name}: expected at most {MAX_SAMPLES} frames times joints")
    player, chunk = Player(file, rig, animation), 2048
    parts = [player.parts(times[i : i + chunk], after[i : i + chunk]) for i in range(0, len(times), chunk)]
    scale = np.concatenate([s for _, _, s in parts])
    grows = np.abs(scale - scale[:1]).max() > 1e-3
    return np.concatenate([r for r, _, _ in parts]), np.concatenate([t for _, t, _ in parts]), scale if grows else None


def _sizes(file: GltfFile, rig: Rig, animation: Animation, joints: list[Joint], scale: Floats) -> dict[int, Floats]:
    """Scale over time (n,3) of each joint that grows or shrinks. Joint.scale has one scaleOrientation for all times: that
    of humanoid space, of the bone, or of the largest stretch, whichever fits best; the joint gets it."""
    out: dict[int, Floats] = {}
    worst = 0.0
    for j in np.flatnonzero(np.abs(scale - scale[:1]).max(axis=(0, 2, 3)) > 1e-3):
        own = scale[:, j]
        bone = rig.bind[j, :3, :3] / np.linalg.norm(rig.bind[j, :3, :3], axis=0)
        uneven = np.abs(own - np.trace(own, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)).max(axis=(1, 2))
        frames = [np.eye(3), bone, np.linalg.eigh(own[int(np.argmax(uneven))])[1]]
        frames = [f if np.linalg.det(f) > 0 else f * [1, 1, -1] for f in frames]
        turned = [np.einsum("ba,nbc,cd->nad", f, own, f) for f in frames]
        off = [float(np.abs(t - t * np.eye(3)).max()) for t in turned]
        best = next((k for k in range(3) if off[k] < 1e-4), int(np.argmin(off)))
        worst = max(worst, off[best])
        out[int(j)] = np.einsum("naa->na", turned[best])
        joint, at = joints[j], turned[best]
        still = _still_size(joint, frames[best])
        joint.scale = at[0][[0, 1, 2], [0, 1, 2]].copy() if still is None else still
        turn = to_axis_angle(from_matrix(frames[best]))
        joint.scale_orientation = turn if best else np.array([0.0, 0, 1, 0])
    if worst > 1e-3:
        warn(
            f"{file.path}: animation {animation.name}: joints are scaled along axes that turn, which Joint.scale "
            f"can't say; the nearest is off by {100 * worst:.2g} %"
        )
    return out


def _still_size(joint: Joint, frame: Floats) -> Floats | None:
    """The joint's own scale along the axes of a frame, None when it is not along them."""
    turn = to_matrix(from_axis_angle(joint.scale_orientation))
    own = frame.T @ (turn * joint.scale) @ turn.T @ frame
    size = np.diag(own).copy()
    return size if np.abs(own - np.diag(size)).max() < 1e-4 else None


def tracks(
    file: GltfFile, rig: Rig, animation: Animation, joints: list[Joint], morphs: dict[tuple[int, int], str]
) -> list[Track]:
    """Interpolator tracks of an animation for the joints of a figure and its displacers (node, target) -> name."""
    times, after = animation.times()
    rotation, shift, scale = _sampled(file, rig, animation, times, after)
    sizes = {} if scale is None else _sizes(file, rig, animation, joints, scale)
    seconds = animation.seconds
    length = seconds if seconds > 0 else 1.0
    keys = np.clip(times / length, 0, 1)
    loop = animation.loop
    if loop is None:
        loop = _closed(rotation, shift)
    rest = np.array([j.rotation for j in joints])
    out = []
    for j, joint in enumerate(joints):
        for path, values, still in (
            ("translation", shift[:, j], joint.translation),
            ("rotation", axis_angles(continuous(rotation[:, j])), rest[j]),
        ):
            if path == "rotation":
                flat = _turn_between(rotation[:, j], rotation[:1, j]).max() < 1e-6
                same = flat and _turn_between(rotation[:1, j], from_axis_angle(still)).max() < 1e-5
            else:
                flat = np.abs(values - values[:1]).max() < 1e-7
                same = flat and np.abs(values[0] - still).max() < 1e-5
            if same:
                continue
            part = slice(0, 1) if flat else slice(None)
            out.append(Track(joint.name, path, keys[part], values[part], length, bool(loop), animation.name))
        if j in sizes:
            out.append(Track(joint.name, "scale", keys, sizes[j], length, bool(loop), animation.name))
    known: set[str] = set()
    for channel in animation.channels:
        if channel.path != "weights":
            continue
        values = channel.at(times, after)
        for k in range(values.shape[1]):
            name = morphs.get((channel.node, k))
            if name is not None and name not in known:
                known.add(name)
                out.append(Track(name, "weight", keys, values[:, k : k + 1], length, bool(loop), animation.name))
    return out


def _turn_between(a: Floats, b: Floats) -> Floats:
    """Angles between quaternions."""
    return 2 * np.arccos(np.clip(np.abs((a * b).sum(-1)), 0, 1))


def _closed(rotation: Floats, shift: Floats) -> bool:
    near = np.abs((rotation[0] * rotation[-1]).sum(-1)) > np.cos(SAME_TURN * 2)
    return len(rotation) > 2 and bool(near.all()) and float(np.abs(shift[0] - shift[-1]).max()) < SAME_PLACE


def frames_per_second(animation: Animation) -> float:
    """The rate on whose frames all keys lie, else 30."""
    if animation.fps:
        return animation.fps
    keys = np.unique(np.concatenate([c.keys for c in animation.channels]))
    steps = np.diff(keys)
    steps = steps[steps > 1e-5]
    if not len(steps):
        return 30.0
    rate = 1 / float(np.median(steps))
    for fps in (round(rate), rate):
        if 1 <= fps <= 1000:
            at = (keys - keys[0]) * fps
            if np.abs(at - np.round(at)).max() < 0.02:
                return float(fps)
    return 30.0


def motion(file: GltfFile, rig: Rig, animation: Animation) -> Motion:
    """An animation without a surface as a Motion on the skeleton of its nodes, one frame per key."""
    fps = frames_per_second(animation)
    start = min(float(c.keys[0]) for c in animation.channels)
    count = int(round((animation.seconds - start) * fps)) + 1
    if count * len(rig) > MAX_SAMPLES:
        file.bad(f"animation {animation.name}: expected at most {MAX_SAMPLES} frames times joints")
    times, after = start + np.arange(count) / fps, np.ones(count, bool)
    rotation, shift, scale = _sampled(file, rig, animation, times, after)
    if scale is not None:
        warn(f"{file.path}: animation {animation.name}: without a figure, joints that grow or shrink keep their size")
    weights = {name: x[:, 0] for name, x in _expressions(file, animation, times, after).items()}
    closed = _closed(rotation, shift)
    loop = closed if animation.loop is None else animation.loop
    if loop and closed:  # the last key is the first pose again
        rotation, shift = rotation[:-1], shift[:-1]
        weights = {name: w[:-1] for name, w in weights.items()}
    skeleton = Skeleton(tuple(rig.names), np.array(rig.parents, np.int32), rig.bind[:, :3, 3])
    still = float(np.abs(shift[:, 1:]).max(initial=0.0)) < 1e-5
    return Motion(
        skeleton,
        fps,
        normalize(rotation),
        shift[:, 0],
        None if still else shift,
        weights,
        bool(loop),
        animation.name,
        notes=("unit 1 m and up axis Y: what glTF means",),
    )


def _expressions(file: GltfFile, animation: Animation, times: Floats, after: NDArray) -> dict[str, Floats]:
    """Weights of VRMA expressions: the x of the node that stands for each."""
    given = file.object(file.extension("VRMC_vrm_animation"), "expressions")
    nodes: dict[int, str] = {}
    for group in ("preset", "custom"):
        for name, entry in file.object(given, group).items():
            if isinstance(entry, dict) and "node" in entry:
                nodes[file.integer(entry, "node", f"expression {name[:40]}", len(file.parents))] = name[:100]
    moving = [c for c in animation.channels if c.path == "translation" and c.node in nodes]
    return {nodes[c.node]: c.at(times, after)[:, :1] for c in moving}
