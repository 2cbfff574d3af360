"""Forward kinematics with the meaning X3D browsers give it.

Local transform of a joint: `L = T(translation) T(center) R(rotation) R(so) S(scale) R(so)^-1 T(-center)`; its matrix is
`M_j = M_parent L_j` in humanoid space, identity when nothing is posed, so that `p' = M_j p` moves rest points.
Source: ISO/IEC 19774-1, Joint; ISO/IEC 19775-1, Transform.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from vitruvian.body.rotations import from_axis_angle, to_matrix
from vitruvian.body.types import Floats, Skeleton, require
from vitruvian.native import kernels

if TYPE_CHECKING:  # motion is above body
    from vitruvian.motion.types import Motion


def joint_matrices(skeleton: Skeleton, motion: Motion | None = None, *, out: Floats | None = None) -> Floats:
    """(F,J,4,4) float64: the matrix of each joint in humanoid space, binding included.

    `motion` None gives one frame: the pose that the file has. Joints without motion of their own translation keep the
    skeleton's, and so does scale. `out` (F,J,4,4) float64 C-contiguous is filled and returned.
    The Humanoid's own transform (`Body.placement`) is not included.
    Raises VitruvianError when the motion belongs to a skeleton with other joints or `out` does not fit.
    """
    if motion is None:
        return pose_matrices(skeleton, skeleton.rotation[None], skeleton.translation[None], out=out)
    same = motion.skeleton is skeleton or motion.skeleton.names == skeleton.names
    require(same, "motion", "a motion on this skeleton", "one with other joints; retarget it first")
    scale = motion.joint_scale
    if motion.joint_translation is not None:
        return pose_matrices(skeleton, motion.rotation, motion.joint_translation, scale=scale, out=out)
    still = skeleton.translation[None]
    return pose_matrices(skeleton, motion.rotation, still, root=motion.translation, scale=scale, out=out)


def pose_matrices(
    skeleton: Skeleton,
    rotation: Floats,
    translation: Floats,
    *,
    root: Floats | None = None,
    scale: Floats | None = None,
    out: Floats | None = None,
    threads: int = 0,
) -> Floats:
    """`joint_matrices` for bare arrays: rotation (F,J,4) xyzw, translation (F,J,3) or (1,J,3) for all frames.

    `root` (F,3) replaces the translation of the first joint, `scale` (F,J,3) the skeleton's. `threads` 0 chooses by size.
    """
    frames, joints = len(rotation), len(skeleton)
    rotation = np.ascontiguousarray(rotation, dtype=np.float64)
    translation = np.ascontiguousarray(translation, dtype=np.float64)
    require(rotation.shape == (frames, joints, 4), "rotation", f"shape (F, {joints}, 4)", rotation.shape)
    good = translation.shape in ((frames, joints, 3), (1, joints, 3))
    require(good, "translation", f"shape ({frames}, {joints}, 3) or (1, {joints}, 3)", translation.shape)
    if root is not None:
        root = np.ascontiguousarray(root, dtype=np.float64)
        require(root.shape == (frames, 3), "root", f"shape ({frames}, 3)", root.shape)
    if out is None:
        out = np.empty((frames, joints, 4, 4))
    fits = out.shape == (frames, joints, 4, 4) and out.dtype == np.float64 and out.flags.c_contiguous
    require(fits, "out", f"float64, C-contiguous, shape ({frames}, {joints}, 4, 4)", f"{out.dtype} {out.shape}")
    native = kernels()
    stretch = _stretch(skeleton) if scale is None else _stretches(skeleton, scale, frames)
    if native is None or scale is not None:  # the kernel knows one scale for all frames
        return _numpy(skeleton, rotation, translation, root, stretch, out)
    native.forward_kinematics(
        skeleton.parents, skeleton.centers, rotation, translation, root, stretch, skeleton.binding, out, threads
    )
    return out


def bound_kinematics(skeleton: Skeleton) -> Callable[[Floats, Floats], Floats]:
    """`pose_matrices` for many calls on one skeleton, of rotation (F,J,4) and translation (F,J,3).

    What does not change is worked out once, and input is trusted: float64, C-contiguous, of these shapes.
    """
    native, stretch = kernels(), _stretch(skeleton)

    def matrices(rotation: Floats, translation: Floats) -> Floats:
        out = np.empty((*rotation.shape[:2], 4, 4))
        if native is None:
            return _numpy(skeleton, rotation, translation, None, stretch, out)
        native.forward_kinematics(
            skeleton.parents, skeleton.centers, rotation, translation, None, stretch, skeleton.binding, out, 0
        )
        return out

    return matrices


def transform_matrix(
    translation: ArrayLike,
    rotation: ArrayLike,
    scale: ArrayLike = (1.0, 1.0, 1.0),
    scale_orientation: ArrayLike = (0.0, 0.0, 1.0, 0.0),
    center: ArrayLike = (0.0, 0.0, 0.0),
) -> Floats:
    """(4,4) of X3D Transform fields, rotations as `x y z angle`: T C R SR S -SR -C."""
    turn = to_matrix(from_axis_angle(scale_orientation))
    center = np.asarray(center, dtype=np.float64)
    out = np.eye(4)
    out[:3, :3] = to_matrix(from_axis_angle(rotation)) @ (turn * np.asarray(scale, dtype=np.float64)) @ turn.T
    out[:3, 3] = np.asarray(translation) + center - out[:3, :3] @ center
    return out


def move(matrices: Floats, points: Floats) -> Floats:
    """Points (...,3) moved by matrices (...,4,4): `p' = M p`, leading axes broadcast."""
    return np.einsum("...ij,...j->...i", matrices[..., :3, :3], points) + matrices[..., :3, 3]


def site_positions(skeleton: Skeleton, matrices: Floats) -> Floats:
    """(F,S,3): the skeleton's Sites under joint matrices (F,J,4,4), humanoid space."""
    return move(matrices[..., skeleton.site_joints, :, :], skeleton.site_points)


def joint_positions(skeleton: Skeleton, matrices: Floats) -> Floats:
    """(F,J,3): the joint centres under joint matrices (F,J,4,4), humanoid space."""
    return move(matrices, skeleton.centers)


def _stretch(skeleton: Skeleton) -> Floats | None:
    """R(so) S R(so)^-1 per joint, (J,3,3), or None when nothing is scaled."""
    if (skeleton.scale == 1).all():
        return None
    turn = to_matrix(skeleton.scale_orientation)
    return np.ascontiguousarray(np.einsum("jab,jb,jcb->jac", turn, skeleton.scale, turn))


def _stretches(skeleton: Skeleton, scale: Floats, frames: int) -> Floats:
    """(F,J,3,3) as `_stretch`, of scales over time."""
    scale = np.ascontiguousarray(scale, dtype=np.float64)
    require(scale.shape == (frames, len(skeleton), 3), "scale", f"shape ({frames}, {len(skeleton)}, 3)", scale.shape)
    turn = to_matrix(skeleton.scale_orientation)
    return np.einsum("jab,fjb,jcb->fjac", turn, scale, turn)


def _numpy(
    skeleton: Skeleton, rotation: Floats, translation: Floats, root: Floats | None, stretch: Floats | None, out: Floats
) -> Floats:
    """The reference for the kernel: all frames of one joint at a time."""
    linear = to_matrix(rotation)
    if stretch is not None:
        linear = linear @ stretch
    shift = translation + skeleton.centers - np.einsum("fjab,jb->fja", linear, skeleton.centers)
    if root is not None:
        shift[:, 0] += root - translation[:, 0]
    out[..., 3, :] = [0.0, 0.0, 0.0, 1.0]
    for j, parent in enumerate(skeleton.parents):
        if parent < 0:
            out[:, j, :3, :3], out[:, j, :3, 3] = linear[:, j], shift[:, j]
        else:
            above = out[:, parent]
            out[:, j, :3, :3] = above[:, :3, :3] @ linear[:, j]
            out[:, j, :3, 3] = np.einsum("fab,fb->fa", above[:, :3, :3], shift[:, j]) + above[:, :3, 3]
    if skeleton.binding is not None:
        np.matmul(out, skeleton.binding, out=out)
    return out
