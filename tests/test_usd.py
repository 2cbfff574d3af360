"""USD files: OpenUSD is the stranger who skins, morphs and validates what we write; what we read back is what it was."""

from __future__ import annotations

import subprocess
import sys
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pxr", reason="OpenUSD is missing: pip install usd-core")

from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt  # noqa: E402

import vitruvian as vt  # noqa: E402
from scene_figure import typed  # noqa: E402
from usd_stranger import findings, skinned  # noqa: E402
from vitruvian.body.kinematics import move  # noqa: E402
from vitruvian.errors import FileError, VitruvianError  # noqa: E402
from vitruvian.formats import usd_reader, usd_stage  # noqa: E402
from vitruvian.formats.scenes import clip_of as _clip  # noqa: E402
from vitruvian.formats.usd_figure import _shared  # noqa: E402
from vitruvian.formats.usd_mesh import surfaces  # noqa: E402
from vitruvian.formats.usd_reader import read_usd  # noqa: E402
from vitruvian.hanim.humanoid import Displacer  # noqa: E402
from vitruvian.motion.tracks import motion_of  # noqa: E402


def clip_of(humanoid: vt.Humanoid) -> vt.Clip:
    return _clip(humanoid, Path("x.usdc"))


@pytest.fixture(scope="module")
def walking() -> vt.Clip:
    h = vt.person(loa=4)
    b = vt.pack(h)
    m = vt.walk(b.skeleton)
    smile = h.displacers()[0].name
    weights = {smile: np.linspace(0, 1, len(m))}
    return vt.Clip(h, b, vt.Motion(m.skeleton, m.fps, m.rotation, m.translation, None, weights, m.loop, "walk"))


@pytest.fixture(scope="module")
def walk_file(walking: vt.Clip, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("usd") / "walk.usdc"
    report = vt.save(walking, path)
    assert report["lost"] == ["skin: its one-sided parts show both sides, a USD mesh has one setting"]
    assert report["joints"] == 146 and report["bytes"] == path.stat().st_size
    assert report["influences"] == walking.body.skin.weights.counts.max()
    return path


@pytest.fixture
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reading without a process of its own, which costs a second of start-up each time."""
    monkeypatch.chdir(tmp_path)  # reading changes it
    monkeypatch.setattr(usd_reader, "_read", lambda path, seconds: usd_stage._read(path, tmp_path))


def ours(clip: vt.Clip, frame: int) -> np.ndarray:
    """Our linear skin (V,3) in a frame, displacers added before skinning, as UsdSkel does it."""
    skin, motion = clip.body.skin, clip.motion
    rest = skin.rest.copy()
    for m in skin.morphs:
        moving = motion.weights.get(m.name) if motion is not None else None
        np.add.at(rest, m.index, (m.weight if moving is None else moving[frame]) * m.offset)
    matrices = vt.joint_matrices(clip.body.skeleton, motion)[frame]
    w = skin.weights
    moved = move(matrices[w.joint], rest[w.vertex])
    total = rest * (1 - w.sums)[:, None]
    np.add.at(total, w.vertex, w.weight[:, None] * moved)
    if not any(m.name for m in skin.morphs):
        single = vt.deformer("linear", clip.body)(matrices)
        assert np.abs(total - single).max() < 1e-6 * max(1, np.abs(total).max())
    return total


def agree(clip: vt.Clip, path: Path, *, size: float = 1.0) -> float:
    """Largest distance between UsdSkel's points and ours, over frames spread over the clip."""
    pieces = surfaces(clip.body.skin, _shared(clip))
    count = 1 if clip.motion is None else len(clip.motion)
    worst = 0.0
    for frame in np.unique(np.linspace(0, count - 1, 5).astype(int)):
        theirs, here = skinned(path, float(frame)), ours(clip, int(frame))
        assert len(theirs) == len(pieces)
        for piece, points in zip(pieces, theirs.values()):
            worst = max(worst, float(np.abs(points - here[piece.source]).max()))
    return worst * size


def same(clip: vt.Clip, back: vt.Humanoid, *, tolerance: float = 1e-6) -> None:
    """That a humanoid read from a file is the one that was written."""
    h, a, b = clip.humanoid, clip.body, vt.pack(back)
    s, t = a.skeleton, b.skeleton
    assert s.names == t.names and (s.parents == t.parents).all() and s.site_names == t.site_names
    for field in ("centers", "translation", "scale", "stiffness", "limits", "limit_orientation", "site_points"):
        np.testing.assert_allclose(getattr(t, field), getattr(s, field), rtol=0, atol=tolerance, err_msg=field)
    turn = np.abs(np.sum(s.rotation * t.rotation, axis=-1))
    np.testing.assert_allclose(turn, 1, rtol=0, atol=1e-12)
    np.testing.assert_allclose(b.placement, a.placement, rtol=0, atol=tolerance)
    assert (a.skin.triangles == b.skin.triangles).all()
    np.testing.assert_allclose(b.skin.rest, a.skin.rest, rtol=0, atol=tolerance * max(1, np.abs(a.skin.rest).max()))
    assert (a.skin.weights.row == b.skin.weights.row).all() and (a.skin.weights.joint == b.skin.weights.joint).all()
    np.testing.assert_allclose(b.skin.weights.weight, a.skin.weights.weight, rtol=0, atol=tolerance)
    assert [(m.name, m.joint, m.before) for m in a.skin.morphs] == [(m.name, m.joint, m.before) for m in b.skin.morphs]
    for m, n in zip(a.skin.morphs, b.skin.morphs):
        assert (m.index == n.index).all()
        np.testing.assert_allclose(n.offset, m.offset, rtol=0, atol=tolerance)
        assert n.weight == pytest.approx(m.weight, abs=1e-12)
    for p, q in zip(a.skin.parts, b.skin.parts, strict=True):
        assert (p.name, p.start, p.stop, p.double_sided, p.crease) == (
            q.name,
            q.start,
            q.stop,
            q.double_sided,
            q.crease,
        )
        assert q.color == pytest.approx(p.color, abs=1e-6)
        assert (q.roughness, q.opacity, q.metallic) == pytest.approx((p.roughness, p.opacity, p.metallic), abs=1e-6)
    if a.skin.uv is not None:
        uv = b.skin.uv[b.skin.uv_triangles], a.skin.uv[a.skin.uv_triangles]
        np.testing.assert_allclose(*uv, rtol=0, atol=tolerance)
    assert (back.name, back.version, back.loa, back.info) == (h.name, h.version, h.loa, h.info)
    assert [(g.name, g.mass) for g in back.segments()] == [(g.name, g.mass) for g in h.segments()]
    assert [v.name for v in back.viewpoints] == [v.name for v in h.viewpoints]
    if clip.motion is not None:
        m, n = clip.motion, motion_of(back, t)
        assert n is not None and len(n) == len(m) and n.loop == m.loop and n.fps == pytest.approx(m.fps)
        np.testing.assert_allclose(np.abs(np.sum(m.rotation * n.rotation, -1)), 1, rtol=0, atol=1e-12)
        np.testing.assert_allclose(n.translation, m.translation, rtol=0, atol=4 * tolerance)
        assert set(m.weights) == set(n.weights)
        for name, weight in m.weights.items():
            np.testing.assert_allclose(n.weights[name], weight, rtol=0, atol=tolerance)


def test_usdskel_skins_the_walking_person_as_we_do(walking: vt.Clip, walk_file: Path) -> None:
    assert agree(walking, walk_file) <= 1e-5


def test_the_walking_person_comes_back(walking: vt.Clip, walk_file: Path) -> None:
    (back,) = read_usd(walk_file)
    same(walking, back)


def test_usd_finds_nothing_to_say(walking: vt.Clip, walk_file: Path, tmp_path: Path) -> None:
    assert findings(walk_file) == []
    several = [typed(1), typed(1, skin=False), vt.Mesh(np.eye(3), np.array([[0, 1, 2]]), name="a b/c")]
    for name in ("several.usda", "several.usdz"):
        vt.save(several, tmp_path / name)
        assert findings(tmp_path / name) == []
    vt.save(typed(1), tmp_path / "baked.usd", bake=True)
    assert findings(tmp_path / "baked.usd") == []


@pytest.mark.parametrize("skin", [True, False])
def test_everything_a_figure_has_survives(skin: bool, tmp_path: Path) -> None:
    """Weights that leave some of a vertex at rest, odd names, scaled joints, a posed and placed figure."""
    h = typed(1, skin=skin)
    h.translation, h.scale = np.array([1.0, 2, 3]), np.array([0.5, 0.5, 0.5])
    h.rotation = np.array([0, 1, 0, 0.7])
    h.joint("l_knee").rotation = np.array([1, 0, 0, 0.5])
    h.joint("l_hip").scale, h.joint("l_hip").scale_orientation = np.array([1.5, 1, 0.75]), np.array([0, 0, 1, 0.4])
    h.joint("r_hip").translation = np.array([0, 0.05, 0])
    h.joint("r_hip").name = "r hip/2"
    h.joint("l_elbow").limit_orientation = np.array([0, 1, 0, 0.3])
    if not skin:
        segment = h.joint("l_elbow").segments[0]
        segment.displacers.append(
            Displacer("bulge_action", np.array([1, 3]), np.array([[0.01, 0, 0], [0, 0.02, 0]]), 0.25)
        )
    clip = clip_of(h)
    path = tmp_path / "figure.usda"
    vt.save(clip, path)
    assert agree(clip, path) <= 1e-5
    assert findings(path) == []
    same(clip, vt.load(path))
    if skin:  # what does not follow any joint is held by one more joint, which is not there when it is read
        assert '"static"' in path.read_text()
    else:
        stage = Usd.Stage.Open(str(path))
        meshes = [p for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)]
        assert len(meshes) == len(h.joints())
        for mesh in meshes:
            assert UsdSkel.BindingAPI(mesh).GetJointIndicesPrimvar().GetInterpolation() == "constant"


@pytest.mark.parametrize("name", [
    "JinNoAnimations_Fixed.x3d", "JinLOA3.x3d", "JoeKick.x3d", "KoreanCharacterMotionAnnexD01Jin.x3d",
    "HAnim2SpecificationLOA3Illustrated.x3d", "sample1.wrl",
])  # fmt: skip
def test_real_figures(name: str, shared: Path, tmp_path: Path, inside: None) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vt.VitruvianWarning)
        h = vt.load(shared / "data" / "hanim" / name)
        clip = clip_of(h)
        path = tmp_path / "figure.usdc"
        report = vt.save(clip, path)
    # weights that miss one by a rounding error are made to sum to one, and what that moves is said
    size = np.linalg.norm(clip.body.placement[:3, 0])
    assert agree(clip, path, size=size) <= 1e-5 + report["max_vertex_error_m"]
    assert report["max_vertex_error_m"] < 2e-5
    assert findings(path) == []
    (back,) = read_usd(path)
    same(clip, back)


def test_bake_skinning_makes_our_frames(tmp_path: Path) -> None:
    clip = clip_of(typed(1))
    vt.save(clip, tmp_path / "f.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "f.usdc"))
    assert UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetDefaultPrim()), Gf.Interval.GetFullInterval())
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/Ada/skin")).GetPointsAttr()
    for frame in (0, len(clip.motion) // 2, len(clip.motion) - 1):
        assert np.abs(np.array(points.Get(frame)) - ours(clip, frame)).max() <= 1e-5


def test_dual_quaternion_is_said(walking: vt.Clip, tmp_path: Path) -> None:
    """UsdSkel knows this deformer too: told to use it, it makes our points, which linear skinning would not."""
    clip = vt.Clip(walking.humanoid, walking.body, walking.motion, "dual-quaternion")
    vt.save(clip, tmp_path / "f.usdc")
    matrices = vt.joint_matrices(clip.body.skeleton, clip.motion)[0]
    there = skinned(tmp_path / "f.usdc", 0.0)["skin"]
    assert np.abs(there - vt.deformer("dual-quaternion", clip.body)(matrices)).max() <= 1e-5
    assert np.abs(there - vt.deformer("linear", clip.body)(matrices)).max() > 1e-3


def test_baked_points_are_those_of_the_clips_deformer(walking: vt.Clip, tmp_path: Path) -> None:
    clip = vt.Clip(walking.humanoid, walking.body, walking.motion, "log")
    report = vt.save(clip, tmp_path / "b.usdc", bake=True)
    assert report["deformer"] == "log" and any("skeleton" in line for line in report["lost"])
    stage = Usd.Stage.Open(str(tmp_path / "b.usdc"))
    assert stage.GetTimeCodesPerSecond() == walking.motion.fps and stage.GetEndTimeCode() == len(walking.motion) - 1
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/person/body"))
    frames = [0, 7, len(walking.motion) - 1]
    matrices = vt.joint_matrices(clip.body.skeleton, clip.motion)[frames]
    weights = {n: w[frames] for n, w in clip.motion.weights.items()}
    for frame, here in zip(frames, vt.deformer("log", clip.body)(matrices, weights)):
        assert np.abs(np.array(mesh.GetPointsAttr().Get(frame)) - here).max() == 0
        normals = np.array(mesh.GetNormalsAttr().Get(frame))
        assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-5
        assert np.allclose(np.array(mesh.GetExtentAttr().Get(frame)), [here.min(0), here.max(0)])


def test_sites_follow_their_joints(walking: vt.Clip, walk_file: Path) -> None:
    from vitruvian.body.kinematics import site_positions

    stage, s = Usd.Stage.Open(str(walk_file)), walking.body.skeleton
    there = site_positions(s, vt.joint_matrices(s, walking.motion))
    assert len(s.site_names) > 90
    for k in range(0, len(s.site_names), 9):
        prim = next(p for p in stage.GetPrimAtPath("/person/Sites").GetChildren()
                    if p.GetCustomDataByKey("hanim:name") == s.site_names[k])  # fmt: skip
        for frame in (0, 11):
            at = UsdGeom.Xformable(prim).GetLocalTransformation(frame).ExtractTranslation()
            assert np.abs(np.array(at) - there[frame, k]).max() < 1e-9


def test_meshes_alone_in_a_row_and_side_by_side(tmp_path: Path, inside: None) -> None:
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]])
    seams = np.array([[0, 1, 2], [4, 2, 3]])
    square = vt.Mesh(
        np.array([[0, 0, 0], [100, 0, 0], [100, 100, 0], [0, 100, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]]), uv,
        np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1.0]]), "square", "cm", seams,
    )  # fmt: skip
    vt.save(square, tmp_path / "one.usdz")
    back = vt.load(tmp_path / "one.usdz")
    assert back.unit == "m" and back.name == "square"
    np.testing.assert_allclose(back.vertices * 100, square.vertices, atol=1e-5)
    assert (back.triangles == square.triangles).all()
    np.testing.assert_allclose(back.uv[back.uv_triangles], uv[seams], atol=1e-7)
    np.testing.assert_allclose(back.colors, square.colors, atol=1e-6)
    row = [vt.Mesh(square.vertices + [0, 0, 10 * k], square.triangles, name="square", unit="cm") for k in range(4)]
    vt.save(row, tmp_path / "row.usda", bake=True, fps=12)
    stage = Usd.Stage.Open(str(tmp_path / "row.usda"))
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/square/mesh")).GetPointsAttr()
    assert [points.Get(k)[0][2] for k in range(4)] == pytest.approx([0, 0.1, 0.2, 0.3])
    assert stage.GetTimeCodesPerSecond() == 12 and stage.GetEndTimeCode() == 3
    other = vt.Mesh(square.vertices, square.triangles[:1])
    with pytest.raises(VitruvianError, match="mesh 1 of the list: expected the triangles of the first"):
        vt.save([square, other], tmp_path / "no.usda", bake=True)
    vt.save([square, other], tmp_path / "both.usda")
    assert len(vt.load(tmp_path / "both.usda").vertices) == 8
    assert not (tmp_path / "no.usda").exists()


def foreign(path: Path) -> tuple[np.ndarray, list[list[int]]]:
    """A rig as other programs write it: centimetres, Z up, joints along their bones, half its data elsewhere."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.SetTimeCodesPerSecond(48)
    stage.SetFramesPerSecond(24)
    root = UsdSkel.Root.Define(stage, "/Armature")
    UsdGeom.Xformable(root).AddTranslateOp().Set(Gf.Vec3d(30, 0, 0))
    rig = UsdSkel.Skeleton.Define(stage, "/Armature/Rig")
    UsdGeom.Xformable(rig).AddRotateZOp().Set(90.0)
    names = ["mixamorig:Hips", "mixamorig:Spine", "mixamorig:Neck", "mixamorig:Head", "mixamorig:LeftUpLeg",
             "mixamorig:LeftLeg", "tail"]  # fmt: skip
    parents = [-1, 0, 1, 2, 0, 4, 0]
    tokens: list[str] = []
    for name, parent in zip(names, parents):
        leaf = name.replace(":", "_")
        tokens.append(leaf if parent < 0 else f"{tokens[parent]}/{leaf}")
    places = [(0, 0, 90), (0, 0, 110), (0, 0, 150), (0, 0, 160), (10, 0, 90), (10, 2, 50), (0, -10, 90)]
    rng = np.random.default_rng(1)
    bind = []
    for place in places:
        turn = Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(*rng.normal(size=3)), float(rng.uniform(20, 160))))
        bind.append(turn * Gf.Matrix4d().SetTranslate(Gf.Vec3d(*place)))
    local = [b if p < 0 else b * bind[p].GetInverse() for b, p in zip(bind, parents)]
    rig.CreateJointsAttr(Vt.TokenArray(tokens))
    rig.CreateJointNamesAttr(Vt.TokenArray(names))
    rig.CreateBindTransformsAttr(Vt.Matrix4dArray(bind))
    rig.CreateRestTransformsAttr(Vt.Matrix4dArray(local))
    clip = UsdSkel.Animation.Define(stage, "/Armature/Clip")
    moving = [4, 0, 2]
    clip.CreateJointsAttr(Vt.TokenArray([tokens[j] for j in moving]))
    clip.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1)] * 3))
    clip.CreateBlendShapesAttr(Vt.TokenArray(["puff"]))
    for k in range(6):
        turns, shifts = [], []
        for j in moving:
            spin = Gf.Rotation(Gf.Vec3d(1, 2, 3), 12.0 * k) * local[j].ExtractRotation()
            turns.append(Gf.Quatf(spin.GetQuat()))
            shifts.append(Gf.Vec3f(local[j].ExtractTranslation() + Gf.Vec3d(0, k if j == 0 else 0, 0)))
        clip.CreateRotationsAttr().Set(Vt.QuatfArray(turns), 2.0 * k + 10)
        clip.CreateTranslationsAttr().Set(Vt.Vec3fArray(shifts), 2.0 * k + 10)
        clip.CreateBlendShapeWeightsAttr().Set(Vt.FloatArray([0.2 * k]), 2.0 * k + 10)
    UsdSkel.BindingAPI.Apply(rig.GetPrim()).CreateAnimationSourceRel().SetTargets([clip.GetPath()])
    mesh = UsdGeom.Mesh.Define(stage, "/Armature/Body")
    points = rng.uniform(-1, 1, (12, 3)) * [20, 8, 1] + np.array(places)[rng.integers(0, 7, 12)]
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy((points / 2).astype(np.float32)))
    polygons = [[0, 1, 2, 3], [4, 5, 6], [7, 8, 9, 10, 11]]
    mesh.CreateFaceVertexCountsAttr([len(p) for p in polygons])
    mesh.CreateFaceVertexIndicesAttr([i for p in polygons for i in p])
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("UVMap", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying")
    st.Set(Vt.Vec2fArray.FromNumpy(rng.uniform(size=(12, 2)).astype(np.float32)))
    api = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    api.CreateSkeletonRel().SetTargets([rig.GetPath()])
    api.CreateGeomBindTransformAttr(Gf.Matrix4d().SetScale(2.0))
    order = [6, 2, 5, 0, 1, 3, 4]
    api.CreateJointsAttr(Vt.TokenArray([tokens[j] for j in order]))
    weights = rng.uniform(0.1, 1, (12, 3))
    weights /= weights.sum(axis=1, keepdims=True)
    index = np.argsort(rng.uniform(size=(12, 7)), axis=1)[:, :3]
    api.CreateJointIndicesPrimvar(False, 3).Set(Vt.IntArray.FromNumpy(index.astype(np.int32).reshape(-1)))
    api.CreateJointWeightsPrimvar(False, 3).Set(Vt.FloatArray.FromNumpy(weights.astype(np.float32).reshape(-1)))
    puff = UsdSkel.BlendShape.Define(stage, "/Armature/Body/puff")
    puff.CreateOffsetsAttr([Gf.Vec3f(1, 2, 3)])
    puff.CreatePointIndicesAttr([5])
    api.CreateBlendShapesAttr(["puff"])
    api.CreateBlendShapeTargetsRel().SetTargets([puff.GetPath()])
    world = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(rig.GetPrim()))
    stage.GetRootLayer().Save()
    return world, polygons


def test_a_rig_of_another_program(tmp_path: Path) -> None:
    """UsdSkel's skin of a file with other axes, unit, joint frames and names is our skin of what we read."""
    path = tmp_path / "foreign.usda"
    world, polygons = foreign(path)
    h = vt.load(path)
    assert [j.name for j in h.joints()] == ["humanoid_root", "vl5", "vc4", "skullbase", "l_hip", "l_knee", "tail"]
    assert h.joint("l_hip").segments[0].name == "l_thigh"
    clip = clip_of(h)
    assert clip.motion is not None and clip.motion.fps == 24 and len(clip.motion) == 6
    assert sum(len(s.triangles) for s in h.skin) == sum(len(p) - 2 for p in polygons)
    to_ours = 0.01 * np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # row vectors: Z up to Y up
    assert h.joint("humanoid_root").center == pytest.approx([0.3, 0.9, 0], abs=1e-9)
    for frame in range(6):
        theirs = skinned(path, 2.0 * frame + 10)["Body"]
        theirs = (theirs @ world[:3, :3] + world[3, :3]) @ to_ours
        assert np.abs(theirs - ours(clip, frame)).max() <= 1e-5
    vt.save(clip, tmp_path / "again.x3d")  # and it is a humanoid like any other
    assert len(vt.load(tmp_path / "again.x3d").joints()) == 7


TRIANGLE = """def Mesh "m" { int[] faceVertexCounts = [3]; int[] faceVertexIndices = [0, 1, 2]
 point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
}
"""
ARC = '#usda 1.0\ndef "a" (%s) {}\n' + TRIANGLE
REFUSED = {
    "reference": (ARC % "references = @../outside.usda@</m>", "outside of its folder"),
    "absolute": (ARC % "references = @/etc/passwd@</m>", "outside of its folder"),
    "payload over a network": (ARC % "payload = @https://example.com/a.usda@</m>", "only plain files"),
    "sublayer": ("#usda 1.0\n(subLayers = [@../outside.usda@])\n" + TRIANGLE, "outside of its folder"),
    "expression": (ARC % 'references = @`"${X}"`@</m>', "only plain files"),
    "package": (ARC % "references = @a.usdz[b.usda]@</m>", "only plain files"),
    "variant": (
        '#usda 1.0\ndef "a" (variants = {\n string v = "x"\n}\n prepend variantSets = "v") {\n variantSet "v" = {\n'
        ' "x" (references = @../outside.usda@</m>) {\n}\n}\n}\n',
        "outside of its folder",
    ),
    "value clips": (
        ARC % 'clips = {\n dictionary default = {\n asset[] assetPaths = [@../o.usda@]\n string primPath = "/m"\n}\n}',
        "value clips",
    ),
    "indices": ("#usda 1.0\n" + TRIANGLE.replace("1, 2]", "1, 9]"), "point indices in 0..2"),
    "counts": ("#usda 1.0\n" + TRIANGLE.replace("[3]", "[2000000000]"), "face corners"),
    "numbers": ("#usda 1.0\n" + TRIANGLE.replace("(1, 0, 0)", "(nan, 0, 0)"), "finite points"),
    "nothing": ("#usda 1.0\nfoo", "USD says"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_refused(case: str, tmp_path: Path, inside: None) -> None:
    """Nothing is opened from outside of the folder, whatever way a layer asks for it; broken arrays name their prim."""
    home = tmp_path / "home"
    home.mkdir()
    (tmp_path / "outside.usda").write_text("#usda 1.0\n" + TRIANGLE)
    text, why = REFUSED[case]
    (home / "bad.usda").write_text(text)
    with pytest.raises(usd_stage.Refused, match=why):
        usd_stage._read(home / "bad.usda", tmp_path)


def test_files_beside_it_are_opened(tmp_path: Path, inside: None, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "part.usda").write_text("#usda 1.0\n" + TRIANGLE)
    (tmp_path / "whole.usda").write_text('#usda 1.0\ndef "a" (references = @./part.usda@</m>) {}\n')
    assert len(vt.load(tmp_path / "whole.usda").vertices) == 3
    with zipfile.ZipFile(tmp_path / "slip.usdz", "w") as package:
        package.writestr("../../evil.usda", "#usda 1.0\n" + TRIANGLE)
    with pytest.raises(usd_stage.Refused, match="outside of itself"):
        usd_stage._read(tmp_path / "slip.usdz", tmp_path)
    monkeypatch.setattr(usd_stage, "MAX_BYTES", 1 << 20)
    with zipfile.ZipFile(tmp_path / "big.usdz", "w", zipfile.ZIP_DEFLATED) as package:
        package.writestr("a.usda", bytes(usd_stage.MAX_BYTES + 1))
    with pytest.raises(usd_stage.Refused, match="at most 1 MB"):
        usd_stage._read(tmp_path / "big.usdz", tmp_path)


@pytest.mark.parametrize(("old", "new"), [
    ("dictionary segments = {", "double segments = 3\n dictionary other = {"),
    ("double mass = 1.5", 'string mass = "heavy"'),
    ("int joint = ", "int joint = 9999"),
    ('string joint = "skullbase"', "int joint = 7"),
])  # fmt: skip
def test_facts_that_are_not_ours(old: str, new: str, tmp_path: Path, inside: None) -> None:
    """customData that others have changed is read or refused in one line."""
    vt.save(typed(1), tmp_path / "a.usda")
    text = (tmp_path / "a.usda").read_text()
    assert old in text
    (tmp_path / "a.usda").write_text(text.replace(old, new))
    try:
        assert len(read_usd(tmp_path / "a.usda")[0].joints()) == 18
    except FileError as error:
        assert "customData" in str(error) and "\n" not in str(error)


def test_a_file_that_crashes_the_library_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "deep.usda").write_text("#usda 1.0\n" + 'def "a" {' * 100_000 + "}" * 100_000)
    with pytest.raises(FileError, match="the USD library gave up on this file") as error:
        vt.load(tmp_path / "deep.usda")
    assert "\n" not in str(error.value)


def test_a_file_that_grows_without_end_is_given_up(tmp_path: Path) -> None:
    """Forty prims, each of them the one before twice."""
    rows = [f'def "r{i}" {{\n def "a" (references = </r{i - 1}>) {{}}\n def "b" (references = </r{i - 1}>) {{}}\n}}\n'
            for i in range(1, 40)]  # fmt: skip
    (tmp_path / "bomb.usda").write_text('#usda 1.0\ndef "r0" {}\n' + "".join(rows))
    with pytest.raises(FileError, match="takes more than 2 s to open"):
        read_usd(tmp_path / "bomb.usda", seconds=2)


def test_a_missing_extra_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    for act in (lambda: vt.save(typed(1), tmp_path / "a.usdz"), lambda: read_usd(tmp_path / "a.usdz")):
        with pytest.raises(VitruvianError, match=r"pip install 'vitruvian\[usd\]'"):
            act()
    assert not (tmp_path / "a.usdz").exists()


def test_the_command_line_knows_usd(tmp_path: Path) -> None:
    def run(*args: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, "-m", "vitruvian", *map(str, args)], capture_output=True, text=True)

    vt.save(typed(1), tmp_path / "ada.usdc")
    told = run("info", tmp_path / "ada.usdc")
    assert told.returncode == 0 and "Ada: H-Anim 2.0, LOA 1, 18 joints" in told.stdout
    baked = run("convert", tmp_path / "ada.usdc", tmp_path / "ada.usda", "--bake")
    assert baked.returncode == 0 and "lost: the skeleton" in baked.stdout
    assert isinstance(vt.load(tmp_path / "ada.usda"), vt.Mesh)
    refused = run("convert", tmp_path / "ada.usdc", tmp_path / "ada.glb", "--bake")
    assert refused.returncode == 2 and refused.stderr.startswith("error: --bake: expected an X3D, VRML or USD file")
    assert not (tmp_path / "ada.glb").exists()
