"""Moving cloth in glTF: carried by the joints as the skin is, and morph targets for what it does besides.

Own method. The points of every frame are taken back through the joint matrices of that frame. Points that hardly move
then need no morph target; for the others either the leading singular vectors of all frames become targets, whose weights
play with the joints, or, where those do not save a fifth, frames themselves, one leading into the next, of which a player
has to look at two at a time. Source of what is written: glTF 2.0 specification, sections 3.7.2.2 (morph targets),
3.7.3 (skins) and 3.6.2.3 (sparse accessors).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.seams import split_seams
from vitruvian.body.types import Body, Floats, Ints, Skin, Weights
from vitruvian.deform.normals import incidence, mesh_normals
from vitruvian.errors import VitruvianError
from vitruvian.formats.bake import reduced
from vitruvian.formats.gltf_buffer import Document
from vitruvian.formats.gltf_nodes import Nodes
from vitruvian.formats.gltf_skin import completed
from vitruvian.motion.tracks import frames_to_write, scales_to_write
from vitruvian.motion.types import Motion
from vitruvian.stage.vertex_cache import VertexCache, surface

TOLERANCE = 0.002  # metres
INFLUENCES = 4
LEAST = 0.2  # volume that a blend of joints keeps at least; less of it can't be undone, and one joint carries the point
KEPT = 0.75  # of the tolerance that is left to morph targets; the rest covers rounding
SAVED = 0.8  # of the keys, so many targets that each frame looks at at most
MOST = 1 << 26  # numbers in all frames together
LONGEST = 600  # frames that singular vectors are looked for in: more take minutes

Single = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Morphs:
    """A surface as glTF moves it: at rest (n,3), points `live` (l,) morphed by weights (K,k) at times (K,) seconds, linear
    in between, of shapes (k,l,3), then all carried by joints (n,4) with shares (n,4). normals (n,3) at rest, turns
    (k,l,3) of them likewise. error: the largest distance in any frame, metres."""

    rest: Floats
    live: Ints
    times: Floats
    weights: Floats
    shapes: Floats
    joints: Ints
    shares: Floats
    normals: Floats
    turns: Floats
    error: float


def morphed(cache: VertexCache, matrices: Floats, tolerance: float = TOLERANCE) -> Morphs:
    """A cache in few morph targets that are within `tolerance` metres of every point of every frame.

    matrices (F,J,4,4) of the joints in its frames, without the binding of a file. Raises VitruvianError for more frames
    than can be held.
    """
    frames, n = cache.positions.shape[:2]
    if frames * n * 3 > MOST:
        raise VitruvianError(f"{cache.name}: {frames} frames of {n} points are too many for a GLB; cut the clip")
    joints, shares = _four(cache.weights or Weights.from_pairs(n, np.arange(n), np.zeros(n), np.ones(n)), matrices)
    back, turned = np.empty((frames, n, 3), np.float32), np.empty((frames, n, 3), np.float32)
    around, widest = incidence(cache.positions[0].astype(np.float64), cache.triangles), 1.0
    for f, frame in enumerate(cache.positions):
        blend = np.einsum("nk,nkab->nab", shares, matrices[f, :, :3][joints])
        inverse = np.linalg.inv(blend[:, :, :3])
        back[f] = np.einsum("nab,nb->na", inverse, frame - blend[:, :, 3])
        turned[f] = _unit(np.einsum("nab,nb->na", inverse, mesh_normals(around, frame[None])[0]))
        widest = max(widest, float(np.linalg.norm(blend[:, :, :3], axis=(1, 2)).max()) / np.sqrt(3))
    within = tolerance / widest
    rest = ((back.max(axis=0) + back.min(axis=0)) / 2).astype(np.float64)
    off = back - rest
    far = np.sqrt((off**2).sum(axis=2).max(axis=0))
    live = np.flatnonzero(far > within).astype(np.int32)
    error = float(far[far <= within].max(initial=0.0))
    normals = _unit(turned.mean(axis=0, dtype=np.float64))
    nothing = Morphs(rest, live, cache.times[:1], np.zeros((1, 0)), np.zeros((0, 0, 3)), joints, shares, normals,
                     np.zeros((0, 0, 3)), error * widest)  # fmt: skip
    if not len(live):
        return nothing
    moved, sway = off[:, live].astype(np.float64), turned[:, live].astype(np.float64) - normals[live]
    keys, shapes, _, worst = reduced(iter(moved), len(live), KEPT * within)
    at = np.rint(keys * (frames - 1)).astype(int)
    times, weights, turns = cache.times[at], np.eye(len(at)), sway[at]
    few = _fewest(moved.reshape(frames, -1), within) if frames <= LONGEST else None
    if few is not None and len(few[1]) <= SAVED * len(shapes):
        weights, worst = few[0], few[2]
        shapes = few[1].reshape(-1, len(live), 3)
        times, turns = cache.times, np.linalg.lstsq(weights, sway.reshape(frames, -1), rcond=None)[0]
    return Morphs(rest, live, times, weights, shapes, joints, shares, normals, turns.reshape(shapes.shape),
                  max(error, worst) * widest)  # fmt: skip


def _four(carry: Weights, matrices: Floats) -> tuple[Ints, Floats]:
    """(n,4) joints and shares, 1 in all, of a blend that can be undone in every frame."""
    joints, shares = completed(carry, matrices.shape[1]).top(INFLUENCES)
    shares = shares / shares.sum(axis=1, keepdims=True)
    least = np.full(len(joints), np.inf)
    for m in matrices:
        least = np.minimum(least, np.linalg.det(np.einsum("nk,nkab->nab", shares, m[:, :3, :3][joints])))
    folded = least < LEAST
    shares[folded] = np.eye(INFLUENCES)[0]
    shares = shares.astype(np.float32).astype(np.float64)
    shares[:, 0] += 1 - shares.sum(axis=1)
    joints[shares == 0] = 0
    return joints, shares


def _fewest(off: Floats, within: float) -> tuple[Floats, Floats, float]:
    """Weights (F,k) and shapes (k,3n) whose product is within a distance of off (F,3n) for every point; the largest."""
    square = off @ off.T
    value, vector = np.linalg.eigh(square)
    order = np.argsort(-value, kind="stable")
    value, vector = np.maximum(value[order], 0), vector[:, order]
    usable = int((value > 1e-12 * max(value[0], 1e-300)).sum()) if value[0] > 0 else 0

    def made(count: int) -> tuple[Floats, Floats, float]:
        weights = vector[:, :count]
        shapes = weights.T @ off
        scale = np.abs(weights).max(axis=0, initial=1e-30)
        weights, shapes = weights / scale, (shapes * scale[:, None]).astype(np.float32).astype(np.float64)
        worst = 0.0
        for row, w in zip(off, weights):
            worst = max(worst, float(np.linalg.norm((row - w @ shapes).reshape(-1, 3), axis=1).max(initial=0.0)))
        return weights, shapes, worst

    low, high = 0, usable
    best = made(0)
    if best[2] <= within:
        return best
    best = made(usable)
    while high - low > 1:
        middle = (low + high) // 2
        tried = made(middle)
        if tried[2] <= within:
            high, best = middle, tried
        else:
            low = middle
    return best


def _unit(vectors: NDArray) -> NDArray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-12, vectors / np.where(length > 1e-12, length, 1), [0.0, 1.0, 0.0])


def wear(
    doc: Document, nodes: Nodes, body: Body, motion: Motion | None, cache: VertexCache, draw: Draw,
    tolerance: float = TOLERANCE,
) -> tuple[int, dict[str, Any]]:  # fmt: skip
    """A cache as a mesh of its own in a document that has the body and its motion: its node, and what there is to say.

    `draw` makes the mesh of a Skin, its drawn vertices `source`, triangles, uv and normals.
    Raises VitruvianError for a cache of other frames than the motion has.
    """
    skeleton = body.skeleton
    if motion is None:
        matrices = pose_matrices(skeleton, skeleton.rotation[None], skeleton.translation[None])
    else:
        rotation, shift, _ = frames_to_write(motion)
        matrices = pose_matrices(skeleton, rotation, shift, scale=scales_to_write(motion))
    if skeleton.binding is not None:
        matrices = matrices @ np.linalg.inv(skeleton.binding)
    if len(matrices) != len(cache):
        raise VitruvianError(f"{cache.name}: expected the {len(matrices)} frames of the motion, found {len(cache)}")
    made = morphed(cache, matrices, tolerance)
    n, skin = len(made.rest), surface(cache, made.rest)
    source, triangles, uv = split_seams(skin)
    mesh = draw(skin, source, triangles, uv, made.normals[source])
    bones, inverse = list(nodes.bone), np.tile(np.eye(4), (len(skeleton), 1, 1))
    inverse[:, :3, 3] = -skeleton.centers
    if made.joints.max() >= len(bones):
        bones.append(nodes.static)
        inverse = np.concatenate([inverse, np.eye(4)[None]])
    narrow = np.uint8 if len(bones) <= 256 else np.uint16
    for primitive in mesh["primitives"]:
        primitive["attributes"] |= {
            "JOINTS_0": doc.add(made.joints[source], narrow, target=34962),
            "WEIGHTS_0": doc.add(made.shares[source], target=34962),
        }
    if len(made.shapes):
        slot = np.full(n, -1)
        slot[made.live] = np.arange(len(made.live))
        drawn = np.flatnonzero(slot[source] >= 0)
        which, targets = slot[source[drawn]], []
        shared: list[int] = []
        for shape, turn in zip(made.shapes, made.turns):
            targets.append({
                "POSITION": doc.add_sparse(len(source), drawn, shape[which], shared),
                "NORMAL": doc.add_sparse(len(source), drawn, turn[which], shared),
            })  # fmt: skip
        for primitive in mesh["primitives"]:
            primitive["targets"] = targets
        mesh["weights"] = [float(w) for w in made.weights[0].astype(np.float32)]
    skin_index = doc.append("skins", {"joints": bones, "skeleton": nodes.root, "inverseBindMatrices": doc.add(inverse)})
    node = doc.append("nodes", {"name": cache.name, "mesh": doc.append("meshes", mesh), "skin": skin_index})
    if len(made.times) > 1:
        animation = doc.root.setdefault("animations", [{"name": "cloth", "channels": [], "samplers": []}])[0]
        times, values = doc.add(made.times, bounds=True), doc.add(made.weights.reshape(-1))
        animation["samplers"].append({"input": times, "interpolation": "LINEAR", "output": values})
        sampler = len(animation["samplers"]) - 1
        animation["channels"].append({"sampler": sampler, "target": {"node": node, "path": "weights"}})
    return node, {
        "name": cache.name, "frames": len(cache), "points": n, "shapes": len(made.shapes), "max_error_m": made.error,
        "tolerance_m": tolerance, "closing_m": cache.closing,
    }  # fmt: skip


Draw = Callable[[Skin, NDArray, NDArray, NDArray | None, Floats], dict[str, Any]]
