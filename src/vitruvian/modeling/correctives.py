"""Corrective displacers: what one deformer makes better than another, as a Displacer that a joint's angle drives.

Players of the standard and of glTF blend linearly. The difference to a better operator at one angle of one joint, turned
back into the joint's frame, is a Displacer under that joint; its weight at other angles is the share of it that fits the
difference there best.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.pack import pack
from vitruvian.body.rotations import from_axis_angle, multiply
from vitruvian.body.types import Body, Floats, require
from vitruvian.deform.deformer import deformer
from vitruvian.hanim.drivers import Driver, drive
from vitruvian.hanim.humanoid import Displacer, Humanoid

SAMPLES = 9  # angles at which the curve is fitted
LEAST = 1e-4  # metres: smaller corrections are left out


def add_corrective(
    humanoid: Humanoid,
    joint: str,
    turn: ArrayLike,
    *,
    base: str = "linear",
    target: str = "volume",
    name: str = "",
) -> Displacer:
    """Adds to `joint` a Displacer that brings `base` to what `target` makes of the skin when it turns by `turn`.

    turn: axis-angle x y z angle in the joint's frame, radians; the curve goes from rest to that angle. base, target: names
    of deformers. name: of the Displacer; "" makes one that ends in _action, as the standard wants it.
    Offsets are metres, in humanoid space at rest; points that move by less than 0.1 mm are left out.
    Raises VitruvianError for a joint the figure lacks, a turn of no angle, a figure without a skin, and when the two
    deformers do not differ.
    """
    x, y, z, angle = (float(v) for v in np.asarray(turn, np.float64).reshape(4))
    axis = np.array([x, y, z])
    require(abs(angle) > 1e-3 and bool(np.linalg.norm(axis) > 1e-9), "turn", "an axis and an angle", turn)
    holder = next((j for j in humanoid.joints() if j.name == joint), None)
    require(holder is not None, "joint", f"a joint of {humanoid.name}", repr(joint))
    assert holder is not None
    body = pack(humanoid)
    count = len(humanoid.skin_coord) if humanoid.skin else 0
    require(count > 0, "humanoid", "a figure with a skin", "segments only")
    number = body.skeleton.index[joint]
    angles = np.linspace(0, angle, SAMPLES)
    matrices = _bent(body, number, axis / np.linalg.norm(axis), angles)
    gap = deformer(target, body)(matrices).astype(np.float64) - deformer(base, body)(matrices)
    back = np.linalg.inv(matrices[:, number, :3, :3])
    local = np.einsum("fab,fvb->fva", back, gap[:, :count])
    most = local[-1]
    moved = np.flatnonzero(np.linalg.norm(most, axis=1) >= LEAST)
    require(moved.size > 0, f"{target} against {base}", "a difference at this angle", "none")
    size = float(np.sum(most[moved] ** 2))
    weights = np.einsum("fva,va->f", local[:, moved], most[moved]) / size
    weights[0] = 0.0
    order = np.argsort(angles)
    made = Displacer(name or f"{humanoid.name}_{joint}_bend_action", moved.astype(np.int32), most[moved])
    drive(made, Driver(joint, axis, angles[order], weights[order]))
    holder.displacers.append(made)
    return made


def _bent(body: Body, joint: int, axis: Floats, angles: Floats) -> Floats:
    """(F,J,4,4): the file's own pose with one joint turned about an axis of its frame."""
    s = body.skeleton
    rotation = np.tile(s.rotation, (len(angles), 1, 1))
    turns = np.array([from_axis_angle(np.append(axis, a)) for a in angles])
    rotation[:, joint] = multiply(rotation[:, joint], turns)
    return pose_matrices(s, rotation, np.tile(s.translation, (len(angles), 1, 1)))
