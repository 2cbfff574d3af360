"""Clothes on a humanoid: a garment that was draped on a pose, as part of the skin that the joints move.

Source: note cloth.md, sections 6 (attachment weights) and 10; seed 003, section 5.2.
"""

from __future__ import annotations

import numpy as np

from vitruvian.body.pack import pack
from vitruvian.body.rotations import from_matrix, to_axis_angle
from vitruvian.body.types import Floats, Ints, floats, indices
from vitruvian.hanim.humanoid import Humanoid, Material, Shape
from vitruvian.modeling.carrying import each_joint
from vitruvian.modeling.reuse import Sheet, put_weights
from vitruvian.modeling.transfer import match

NEAR = 0.08  # metres: cloth farther from the skin takes its weights from the cloth around it


def worn(
    humanoid: Humanoid,
    vertices: Floats,
    triangles: Ints,
    matrices: Floats,
    *,
    uv: Floats | None = None,
    uv_triangles: Ints | None = None,
    color: tuple[float, float, float] = (0.33, 0.42, 0.58),
    name: str = "garment",
) -> Humanoid:
    """A copy of the humanoid that wears a garment and stands as it was draped.

    vertices (n,3) metres, humanoid space, draped on the body under joint matrices (J,4,4); triangles (t,3); uv (u,2) with
    uv_triangles (t,3). The garment takes the weights of the skin near to it and is put back to the rest pose by them, so
    that in the pose of the matrices, which becomes that of the joints, it hangs exactly as draped.
    """
    body = pack(humanoid)
    vertices = floats(vertices, "vertices", None, 3)
    triangles = indices(triangles, "triangles", len(vertices), None, 3)
    made = match(body, Sheet(vertices, triangles, name=name), matrices=matrices, distance=NEAR)
    out = humanoid.copied()
    joints, first = each_joint(out), len(out.skin_coord)
    put_weights(joints, made.skin.weights, first, None)
    material = Material(name, color=color, roughness=0.9, double_sided=True)
    placed = (triangles + first).astype(np.int32)
    out.skin = [*out.skin, Shape(name, placed, None, uv, uv_triangles, material=material)]
    out.skin_coord, out.skin_normal = np.concatenate([out.skin_coord, made.skin.rest]), None
    parents = body.skeleton.parents
    for j, joint in enumerate(joints):
        turn = matrices[j, :3, :3] if parents[j] < 0 else matrices[parents[j], :3, :3].T @ matrices[j, :3, :3]
        joint.rotation = to_axis_angle(from_matrix(turn))
    return out.settled()
