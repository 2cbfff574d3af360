"""VRM animation out: the human bones of a motion, on a skeleton that stands in VRM's T pose.

Source: VRMC_vrm_animation 1.0 (VRM Consortium). Let T_j be the joint matrices of the T pose and M_j(t) those of the
motion: on the T-posed skeleton the same motion has the matrices M_j T_j^-1. Joints that VRM has no bone for are
multiplied into the bone below them.
"""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

import numpy as np

from vitruvian.body.kinematics import move, pose_matrices
from vitruvian.body.rotations import inverse, multiply
from vitruvian.formats.gltf_buffer import Document
from vitruvian.formats.vrm_pose import t_turns, vrm_bones
from vitruvian.formats.vrm_tables import PRESETS
from vitruvian.hanim.tables import canonical
from vitruvian.motion.rigs import hanim_names
from vitruvian.motion.tracks import frames_to_write
from vitruvian.motion.turns import local_rotations, world_rotations
from vitruvian.motion.types import Motion


def write_vrma(motion: Motion, path: str | os.PathLike[str]) -> dict[str, Any]:
    """Write a motion as VRMA and report `frames`, `bones` and `lost`, what it could not carry, one sentence each.

    Its skeleton may have H-Anim names or those of a known rig. Rotations of all human bones and the place of the hips
    have a key per frame; weights of displacers become expressions, presets where the names are VRM's (`aa_action`).
    Raises `VitruvianError` naming the joints that VRM needs and the skeleton lacks.
    """
    s = motion.skeleton
    if sum(canonical(n) is not None for n in s.names) < len(s) / 2:
        s = replace(s, names=tuple(h or n for n, h in zip(s.names, hanim_names(s.names))))
    bones = vrm_bones(s)
    turn = t_turns(s, bones)
    centers = move(pose_matrices(s, local_rotations(s.parents, turn[None]), s.translation[None])[0], s.centers)
    rotation, shift, weights = frames_to_write(motion)
    world = multiply(world_rotations(s.parents, rotation), inverse(turn))
    moved = pose_matrices(s, rotation, shift)
    doc = Document()
    nodes: dict[int, int] = {}
    clock = doc.add(np.arange(len(rotation)) / motion.fps, bounds=True)
    channels: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []

    def track(node: int, target: str, values: np.ndarray) -> None:
        samplers.append({"input": clock, "interpolation": "LINEAR", "output": doc.add(values)})
        channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": target}})

    for j in sorted(bones.values()):
        p = int(s.parents[j])
        while p >= 0 and p not in nodes:
            p = int(s.parents[p])
        place = centers[j] - (centers[p] if p >= 0 else 0)
        nodes[j] = doc.append("nodes", {"name": s.names[j], "translation": [float(np.float32(x)) for x in place]})
        if p >= 0:
            doc.root["nodes"][nodes[p]].setdefault("children", []).append(nodes[j])
        track(nodes[j], "rotation", world[:, j] if p < 0 else multiply(inverse(world[:, p]), world[:, j]))
    hips = bones["hips"]
    track(nodes[hips], "translation", move(moved[:, hips], s.centers[hips]))
    extension: dict[str, Any] = {
        "specVersion": "1.0", "humanoid": {"humanBones": {b: {"node": nodes[j]} for b, j in bones.items()}}
    }  # fmt: skip
    roots = [nodes[hips]]
    for name, values in weights.items():
        bare = name.removesuffix("_action")
        node = doc.append("nodes", {"name": f"expression {bare}"})
        roots.append(node)
        group = "preset" if bare in PRESETS else "custom"
        extension.setdefault("expressions", {}).setdefault(group, {})[bare] = {"node": node}
        track(node, "translation", np.stack([values, 0 * values, 0 * values], -1))
    about = {"hanim": {"fps": float(motion.fps), "loop": bool(motion.loop)}}
    doc.append(
        "animations", {"name": motion.name or "motion", "channels": channels, "samplers": samplers, "extras": about}
    )
    doc.root.update(scenes=[{"nodes": roots}], scene=0, extensionsUsed=["VRMC_vrm_animation"])
    doc.root["extensions"] = {"VRMC_vrm_animation": extension}
    lost = []
    others = [n for j, n in enumerate(s.names) if j not in nodes]
    if others:
        lost.append(f"{len(others)} joints that VRM has no bone for: their turns went into the bones below them")
    below = [j for j in nodes if s.parents[j] >= 0]
    if motion.joint_translation is not None and np.abs(shift[:, below] - s.translation[below]).max(initial=0) > 1e-6:
        lost.append("translations of joints other than the root: VRMA has none")
    return {"frames": len(motion), "bones": len(bones), "lost": lost, "bytes": doc.write(path)}
