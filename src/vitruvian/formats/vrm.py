"""VRM 1.0 out: a GLB whose skeleton VRM programs know, in their T pose, with terms of use and expressions.

Source: VRM 1.0 specification `VRMC_vrm` (VRM Consortium). Pruning to four influences is that of the GLB writer.
"""

from __future__ import annotations

import os
from typing import Any

from vitruvian.body.types import Body
from vitruvian.errors import VitruvianError
from vitruvian.formats.glb import figure
from vitruvian.formats.gltf_buffer import Document
from vitruvian.formats.vrm_pose import t_posed, vrm_bones
from vitruvian.formats.vrm_tables import PRESETS, expressions, meta_of
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.stage.clip import Clip


def write_vrm(thing: Clip | Humanoid | Body, path: str | os.PathLike[str]) -> dict[str, Any]:
    """Write a figure as VRM 1.0 and report what the format could not carry.

    The report is that of `write_glb` and `bones`, how many VRM bones the figure has; `expressions`, the presets that its
    face displacers make; `rest_error_m`, how far the surface is off when the arms go back to the file's rest pose.
    Terms of use come from Humanoid.info under VRM's own names (`avatarPermission`, `commercialUsage`, ...), the author
    from `authorName`; what is missing is written as VRM's most careful default.
    Raises `VitruvianError` naming the joints that VRM needs and the figure lacks, or when it has no surface.
    """
    lost: list[str] = []
    if isinstance(thing, Clip):
        humanoid, body = thing.humanoid, thing.body
        if thing.motion is not None:
            lost.append("the motion: a VRM holds none; write a .glb for it")
    elif isinstance(thing, Body):
        humanoid, body = Humanoid(thing.name), thing
    elif isinstance(thing, Humanoid):
        from vitruvian.body.pack import pack

        humanoid, body = thing, pack(thing)
    else:
        raise VitruvianError(f"{path}: a VRM needs a humanoid, found a {type(thing).__name__.lower()}")
    if not len(body.skin.triangles):
        raise VitruvianError(f"{path}: a VRM needs a surface, this humanoid has none")
    bones = vrm_bones(body.skeleton)
    posed, tree, changed, cost = t_posed(body, humanoid, bones)
    doc = Document()
    report, nodes, mesh = figure(doc, posed, tree, None, "linear", 4)
    meta, assumed = meta_of(humanoid.name, humanoid.info)
    assert mesh is not None
    names = doc.root["meshes"][doc.root["nodes"][mesh]["mesh"]].get("extras", {}).get("targetNames", [])
    said = expressions(names, mesh)
    extension: dict[str, Any] = {
        "specVersion": "1.0", "meta": meta,
        "humanoid": {"humanBones": {bone: {"node": nodes.joint[j]} for bone, j in bones.items()}},
    }  # fmt: skip
    if said:
        extension["expressions"] = said
        left = [p for p in PRESETS if p not in said["preset"] and p != "neutral"]
        if left:
            lost.append(f"expressions without face units to make them: {', '.join(left)}")
    doc.root["extensionsUsed"] = ["VRMC_vrm"]
    doc.root["extensions"] = {"VRMC_vrm": extension}
    report["lost"] = lost + changed + assumed + report["lost"]
    report.update(bones=len(bones), expressions=sorted(said.get("preset", {})), **cost)
    report["bytes"] = doc.write(path)
    return report
