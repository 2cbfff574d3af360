"""Joints that grow and shrink: out of glTF, into H-Anim interpolators and HAnimMotion, and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vitruvian as vt
from gltf_maker import BONES, Foreign
from test_bake import bendy, exact
from vitruvian.body.kinematics import joint_matrices, pose_matrices
from vitruvian.body.types import Skeleton
from vitruvian.deform.deformer import deformer
from vitruvian.errors import VitruvianWarning
from vitruvian.formats import registry
from vitruvian.motion.live import baked
from vitruvian.motion.tracks import motion_of
from vitruvian.motion.types import Motion
from vitruvian.stage.clip import Clip

TIMES = np.array([0.0, 0.5, 1.0])


def swelling(*, uneven: bool = True) -> Clip:
    """The bending arm, whose upper joint is scaled along a turned frame while it turns."""
    clip = bendy(frames=20)
    h = clip.humanoid
    if uneven:
        h.joint("l_shoulder").scale_orientation = np.array([0, 0, 1, 0.4])
    body = vt.pack(h)
    scale = np.ones((20, 3, 3))
    t = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    scale[:, 1] = (1 + 0.3 * np.sin(t))[:, None] ** ([1.0, 2.0, 0.5] if uneven else [1.0, 1.0, 1.0])
    m = clip.motion
    return Clip(
        h,
        body,
        Motion(body.skeleton, m.fps, m.rotation, m.translation, loop=True, name="wave", joint_scale=scale),
        "linear",
    )


def test_scales_over_time_are_scales_of_the_skeleton():
    rng = np.random.default_rng(0)
    turn = rng.normal(size=(3, 4))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    base = {
        "names": ("a", "b", "c"),
        "parents": np.array([-1, 0, 1]),
        "centers": rng.normal(size=(3, 3)),
        "scale_orientation": turn,
    }
    rotation = rng.normal(size=(4, 3, 4))
    rotation /= np.linalg.norm(rotation, axis=2, keepdims=True)
    scale, shift = rng.uniform(0.5, 2, size=(4, 3, 3)), rng.normal(size=(4, 3, 3))
    together = pose_matrices(Skeleton(**base), rotation, shift, scale=scale)
    for f in range(4):
        alone = pose_matrices(Skeleton(**base, scale=scale[f]), rotation[f : f + 1], shift[f : f + 1])
        assert np.allclose(together[f], alone[0], atol=1e-12)
    motion = Motion(Skeleton(**base), 30.0, rotation, shift[:, 0], shift, joint_scale=scale)
    assert np.allclose(joint_matrices(motion.skeleton, motion), together)


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("form", [".x3d", ".wrl", ".x3dv", ".glb"])
def test_written_and_read_back_the_matrices_are_the_same(tmp_path, form, uneven):
    clip, path = swelling(uneven=uneven), tmp_path / f"a{form}"
    registry.save(clip, path)
    h = vt.load(path)
    body = vt.pack(h)
    motion = motion_of(h, body.skeleton)
    ours = joint_matrices(clip.body.skeleton, clip.motion)
    assert np.abs(joint_matrices(body.skeleton, motion)[: len(ours)] - ours).max() < 2e-5


def test_a_hanimmotion_scales_too(tmp_path):
    clip, path = swelling(), tmp_path / "a.x3d"
    registry.save(clip, path, motion="hanimmotion")
    assert "Xscale Yscale Zscale" in path.read_text()
    h = vt.load(path)
    motion = motion_of(h, vt.pack(h).skeleton)
    assert np.abs(motion.joint_scale - clip.motion.joint_scale).max() < 1e-6


def test_a_baked_skin_grows(tmp_path):
    clip, path = swelling(), tmp_path / "a.wrl"
    registry.save(clip, path, bake=True, tolerance=0.0005)
    points = baked(vt.load(path), fps=20.0)
    moved = joint_matrices(clip.body.skeleton, clip.motion)
    m = clip.motion
    plain = exact(Clip(clip.humanoid, clip.body, Motion(clip.body.skeleton, 20.0, m.rotation, m.translation,
                                                        loop=True), "linear"))  # fmt: skip
    ours = np.asarray(deformer("linear", clip.body)(moved), np.float64)[:, :192]
    assert np.linalg.norm(points[:20] - ours, axis=-1).max() < 0.0006
    assert np.linalg.norm(points[:20] - plain[:20], axis=-1).max() > 0.02


def test_a_foreign_rig_scales_its_bones_along_their_own_axes(tmp_path: Path):
    rig = Foreign()
    rig.animate(TIMES, LeftArm=("scale", [[1, 1, 1], [1.5, 0.5, 1.2], [1, 1, 1]], "LINEAR"),
                Head=("scale", [[1, 1, 1], [2, 2, 2], [1, 1, 1]], "LINEAR"))  # fmt: skip
    h = vt.load(rig.maker.glb(tmp_path / "a.glb"))
    assert {(t.target, t.field) for t in h.tracks if len(t.keys) > 1} == {
        ("l_shoulder", "scale"),
        ("skullbase", "scale"),
    }
    skeleton = vt.pack(h).skeleton
    moved = joint_matrices(skeleton, motion_of(h, skeleton, fps=2.0))
    index = skeleton.index["l_shoulder"]
    bone = rig.bind[[n for _, n, _ in BONES].index("LeftArm")]
    linear = moved[1, index, :3, :3]
    expected = np.sort([1.5, 0.5, 1.2])
    assert np.allclose(np.sort(np.linalg.svd(linear, compute_uv=False)), expected, atol=1e-4)
    own = bone[:3, :3] / np.linalg.norm(bone[:3, :3], axis=0)
    assert np.abs(own.T @ linear @ own - np.diag([1.5, 0.5, 1.2])).max() < 1e-4
    assert np.allclose(moved[1, skeleton.index["skullbase"], :3, :3], 2 * np.eye(3), atol=1e-5)
    # and again through our own writer and a scene
    registry.save(h, tmp_path / "b.glb")
    registry.save(h, tmp_path / "c.x3d")
    for again in (vt.load(tmp_path / "b.glb"), vt.load(tmp_path / "c.x3d")):
        s = vt.pack(again).skeleton
        assert (
            np.abs(joint_matrices(s, motion_of(again, s, fps=2.0))[1, s.index["l_shoulder"]] - moved[1, index]).max()
            < 1e-4
        )


def test_axes_that_turn_are_said(tmp_path: Path):
    """The parent of a turning joint is squeezed: no one frame says it, the report does."""
    rig = Foreign()
    q = np.array([[0, 0, 0, 1], [0, 0, np.sin(0.5), np.cos(0.5)], [0, 0, np.sin(1), np.cos(1)]])
    rig.animate(
        TIMES, LeftForeArm=("rotation", q, "LINEAR"), LeftArm=("scale", [[1, 1, 1], [2, 0.5, 1], [2, 0.5, 1]], "STEP")
    )
    maker = rig.maker
    spare = maker.put("nodes", {"name": "between", "scale": [2, 0.4, 1], "children": [rig.bone["LeftForeArm"]]})
    above = maker.json["nodes"][rig.bone["LeftArm"]]
    above["children"] = [spare if c == rig.bone["LeftForeArm"] else c for c in above["children"]]
    with pytest.warns(VitruvianWarning, match="axes that turn"):
        vt.load(maker.glb(tmp_path / "a.glb"))
