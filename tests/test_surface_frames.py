"""Per-vertex frames that cloth is laid on, and the kinds of normals: closed forms, finite differences, seams."""

from dataclasses import replace

import numpy as np
import pytest

import skins
from vitruvian import VitruvianError
from vitruvian.body.kinematics import transform_matrix
from vitruvian.body.types import Body, Morph, Skin, Weights
from vitruvian.deform import normals
from vitruvian.deform.deformer import WEIGHTED, deformer

pytestmark = pytest.mark.usefixtures("both")

TWIST, BEND = (0, 0, 1), (1, 0, 0)


def doubled(body: Body, which: np.ndarray) -> tuple[Body, int]:
    """The body with some vertices twice: every other triangle uses the copies, which have the same weights."""
    skin, n = body.skin, len(body.skin.rest)
    copy = np.arange(n)
    copy[which] = n + np.arange(len(which))
    odd = (np.arange(len(skin.triangles)) % 2 == 1)[:, None]
    source = np.concatenate([np.arange(n), which])
    pick = np.concatenate([np.arange(skin.weights.row[s], skin.weights.row[s + 1]) for s in source])
    vertex = np.repeat(np.arange(len(source)), skin.weights.counts[source])
    rows = Weights.from_pairs(len(source), vertex, skin.weights.joint[pick], skin.weights.weight[pick])
    return replace(body, skin=Skin(skin.rest[source], np.where(odd, copy[skin.triangles], skin.triangles), rows)), n


@pytest.mark.parametrize("name", WEIGHTED)
def test_surface_frames_are_right_handed_frames_on_the_surface(name):
    body = skins.cylinder(skins.halves)
    d = deformer(name, body)
    poses = np.stack([skins.turned(TWIST, 120), skins.turned(BEND, 70)])
    found, points = d.frames(poses, kind="surface").astype(float), d(poses)
    axes = found[..., :3]
    assert np.abs(np.einsum("fvba,fvbc->fvac", axes, axes) - np.eye(3)).max() < 1e-6
    assert np.abs(np.linalg.det(axes) - 1).max() < 1e-6
    assert np.abs(found[..., 3] - points).max() < 2e-6
    normal = d.normals(found[..., 3].astype(np.float32))
    assert np.abs(found[..., 2] - normal).max() < 1e-3 * (name == "volume") + 1e-4


def test_a_rigid_motion_turns_surface_frames_with_it():
    body = skins.cylinder(skins.halves)
    d = deformer("log", body)
    still = np.tile(np.eye(4), (2, 1, 1))
    move = transform_matrix((0.1, -0.3, 0.2), (0.6, 0, 0.8, 2.0), center=(1, 2, 3))
    rest, moved = (d.frames(m, kind="surface").astype(float) for m in (still, move @ still))
    assert np.abs(moved[..., :3] - move[:3, :3] @ rest[..., :3]).max() < 1e-4
    assert np.abs(moved[..., 3] - (rest[..., 3] @ move[:3, :3].T + move[:3, 3])).max() < 1e-5


def test_the_surface_normal_leans_where_weights_vary_and_the_operator_does_not_know():
    """A twisted cylinder keeps its radial normals; a bent one tapers on the inside. Against differences along the skin."""
    body = skins.cylinder(skins.halves)
    d = deformer("linear", body)
    pose = skins.turned(BEND, 60)
    points = d(pose).astype(float)[: skins.RINGS * skins.POINTS].reshape(skins.RINGS, skins.POINTS, 3)
    along = points[2:] - points[:-2]
    round_ = np.roll(points, -1, axis=1) - np.roll(points, 1, axis=1)
    true = normals.normalized(np.cross(round_[1:-1], along))
    inner = slice(1, skins.RINGS - 1)
    shape = (skins.RINGS, skins.POINTS, 3)
    surface = d.frames(pose, kind="surface")[: skins.RINGS * skins.POINTS, :, 2].reshape(shape)[inner]
    plain = d.operator_normals(pose)[: skins.RINGS * skins.POINTS].reshape(shape)[inner]
    error = [np.degrees(np.arccos(np.clip(np.sum(true * n, axis=-1), -1, 1))) for n in (surface, plain)]
    assert np.percentile(error[0], 99) < 2.5
    assert error[1].max() > 15


def test_frames_of_seam_copies_have_the_same_bits():
    body, n = doubled(skins.cylinder(skins.halves), np.arange(38 * skins.POINTS, 42 * skins.POINTS))
    source = np.arange(38 * skins.POINTS, 42 * skins.POINTS)
    pose = skins.turned(BEND, 75)
    for name in WEIGHTED:
        d = deformer(name, body)
        for kind in ("operator", "orthonormal", "surface"):
            f = d.frames(pose, kind=kind)
            assert np.array_equal(f[source], f[n:]), (name, kind)
        assert np.array_equal(d.operator_normals(pose)[source], d.operator_normals(pose)[n:])
        assert np.array_equal(d.normals(d(pose))[source], d.normals(d(pose))[n:])
    assert np.array_equal(d.hanim_normals(pose)[source], d.hanim_normals(pose)[n:])


def test_frames_stand_on_displaced_vertices():
    body = skins.cylinder(skins.halves)
    lift = np.tile([0.0, 0.0, 0.5], (skins.POINTS, 1))
    ring = np.arange(60 * skins.POINTS, 61 * skins.POINTS)
    morph = Morph("collar", ring.astype(np.int32), lift, joint=1, weight=0.2)
    carried = replace(body, skin=replace(body.skin, morphs=(morph,)))
    d, pose = deformer("log", carried), skins.turned(BEND, 40)
    for given in (None, {"collar": 1.0}):
        points = d(pose, given)
        for kind in ("orthonormal", "surface"):
            f = d.frames(pose, given, kind=kind).astype(float)
            where = f[..., 3]
            if kind == "orthonormal":
                where = where + np.einsum("vab,vb->va", f[..., :3], body.skin.rest)
            assert np.abs(where - points).max() < 2e-6, (kind, given)
    assert np.abs(d.frames(pose, {"collar": 1.0}) - d.frames(pose)).max() == 0  # A knows nothing of displacers


def test_frames_without_area_are_still_frames():
    """Loose points, and a surface that is flat or folded to nothing."""
    points = skins.crowd(3)
    bare = replace(points, skin=replace(points.skin, triangles=np.zeros((0, 3), np.int32), parts=()))
    f = deformer("log", bare).frames(skins.poses(bare), kind="surface").astype(float)
    assert np.abs(np.einsum("fvba,fvbc->fvac", f[..., :3], f[..., :3]) - np.eye(3)).max() < 1e-6
    body = skins.cylinder(skins.halves)
    for flat in (np.diag([0.0, 0, 0, 1]), np.diag([1.0, 0, 0, 1]), np.diag([1.0, 0, 1, 1])):
        f = deformer("linear", body).frames(np.stack([flat, flat]), kind="surface").astype(float)
        assert np.abs(np.einsum("vba,vbc->vac", f[..., :3], f[..., :3]) - np.eye(3)).max() < 1e-5


@pytest.mark.parametrize("scale", [False, True])
def test_hanim_normals_by_the_standards_sum(scale):
    """n + sum w (N n - n), joint by joint, for weights that do not sum to one as well."""
    body = skins.crowd(5, sums=(0.6, 1.0))
    matrices = skins.poses(body, angle=1.2, scale=scale)
    given = np.random.default_rng(3).normal(size=body.skin.rest.shape)
    given /= np.linalg.norm(given, axis=1, keepdims=True)
    d = deformer("log", body)  # whatever the operator
    found = d.hanim_normals(matrices, given)
    w = body.skin.weights
    for f, pose in enumerate(matrices):
        expected = given.copy()
        for v, j, weight in zip(w.vertex, w.joint, w.weight):
            expected[v] += weight * (np.linalg.inv(pose[j, :3, :3]).T @ given[v] - given[v])
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
        assert np.abs(found[f] - expected).max() < 1e-6
    assert np.array_equal(d.hanim_normals(matrices[1], given), found[1])


def test_hanim_normals_equal_those_of_the_operator_where_one_joint_moves():
    """Cofactors and inverse transposes have one direction, for stretched joints too."""
    body = skins.cylinder(lambda z: np.stack([z < 0, z >= 0], axis=1).astype(float))
    stretch = transform_matrix((0.1, 0.2, 0.3), (0, 0.6, 0.8, 1.1), (2, 0.5, 1.5), (1, 0, 0, 0.4))
    d = deformer("linear", body)
    pose = np.stack([np.eye(4), stretch])
    assert np.abs(d.hanim_normals(pose) - d.operator_normals(pose)).max() < 1e-5
    mirrored = np.stack([np.eye(4), stretch @ np.diag([-1.0, 1, 1, 1])])
    upper = np.flatnonzero(body.skin.rest[:, 2] > 0.2)
    # the inverse transpose keeps what lies outside outside; cofactors follow the faces, which turn over
    assert np.abs(d.hanim_normals(mirrored) + d.operator_normals(mirrored))[upper].max() < 1e-5
    with pytest.raises(VitruvianError, match="not scaled to nothing, found .'j1'"):
        d.hanim_normals(np.stack([np.eye(4), np.diag([1.0, 0, 1, 1])]))
    with pytest.raises(VitruvianError, match="rest: expected shape"):
        d.hanim_normals(pose, np.zeros((3, 3)))


def test_unknown_kinds_are_said():
    body = skins.point([1.0])
    with pytest.raises(VitruvianError, match="kind: expected 'operator' or 'orthonormal' or 'surface', found 'x'"):
        deformer("log", body).frames(np.eye(4)[None], kind="x")


def test_points_on_faces_move_with_one_call_and_bad_ones_are_named():
    """At corners they are the vertices to the bit; between them frames carry the rest point, and blend weights only."""
    from vitruvian.deform.feet import on_faces

    body = skins.cylinder(skins.halves)
    m = skins.turned((1, 0, 0), 80)
    faces = np.arange(0, len(body.skin.triangles), 7)
    corners = on_faces(body, faces, np.tile([0, 1.0, 0], (len(faces), 1)))
    inside = on_faces(body, faces, np.tile([0.2, 0.3, 0.5], (len(faces), 1)))
    assert np.allclose(inside.skin.weights.sums, 1, atol=1e-12)
    for name in ("linear", "log", "dual-quaternion", "hybrid"):
        whole = deformer(name, body)(m)
        at = body.skin.triangles[faces]
        assert np.abs(deformer(name, corners)(m) - whole[at[:, 1]]).max() < 1e-6
        d = deformer(name, inside)
        frames, points = d.frames(m).astype(float), d(m).astype(float)
        carried = np.einsum("vab,vb->va", frames[..., :3], inside.skin.rest) + frames[..., 3]
        assert np.abs(carried - points).max() < 1e-5
        flat = np.einsum("nk,nkc->nc", np.tile([0.2, 0.3, 0.5], (len(faces), 1)), whole[at].astype(float))
        assert np.abs(points - flat).max() < 0.02  # of a radius of 1: off the chord, on the surface
        if name != "linear":
            turn = frames[..., :3]
            assert np.abs(np.einsum("vba,vbc->vac", turn, turn) - np.eye(3)).max() < 1e-5 or name == "hybrid"
    for face, share, message in (
        ([len(body.skin.triangles)], [[1, 0, 0]], "face: expected"),
        ([0], [[0.5, 0, 0]], "barycentric: expected rows that sum to 1"),
        ([0], [[2, -1, 0]], "barycentric: expected shares"),
    ):
        with pytest.raises(VitruvianError, match=message):
            on_faces(body, face, share)
