"""Weights of a skin on another surface, and surfaces taken back to the dress pose."""

from dataclasses import replace

import numpy as np
import pytest

import skins
import vitruvian as vt
from vitruvian import VitruvianError, VitruvianWarning
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.rotations import from_axis_angle
from vitruvian.body.types import Weights
from vitruvian.deform.deformer import deformer
from vitruvian.deform.normals import incidence, mesh_normals
from vitruvian.modeling.transfer import OPERATORS, dressed, transfer

BEND, TWIST = (1, 0, 0), (0, 0, 1)


def sleeve(radius=1.02, rings=33, points=40, length=3.0):
    """A tube round the middle of the reference cylinder."""
    z = np.repeat(np.linspace(-length, length, rings), points)
    turn = np.tile((np.arange(points) + 0.3) * 2 * np.pi / points, rings)
    vertices = np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)
    a = np.arange(points)
    b = (a + 1) % points
    quads = np.concatenate(
        [np.stack([r + a, r + b, r + points + b, r + points + a], 1) for r in np.arange(rings - 1) * points]
    )
    return vt.Mesh(vertices, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]))


def dense(weights, joints):
    out = np.zeros((len(weights), joints))
    out[weights.vertex, weights.joint] = weights.weight
    return out


def test_a_close_surface_gets_the_weights_of_the_skin_under_it():
    body, mesh = skins.cylinder(skins.halves), sleeve()
    skin = transfer(body, mesh)
    assert np.array_equal(skin.rest, mesh.vertices)
    assert np.abs(dense(skin.weights, 2) - skins.halves(mesh.vertices[:, 2])).max() < 2e-3
    assert np.abs(skin.weights.sums - 1).max() < 1e-9
    worn = replace(body, skin=skin)
    pose = skins.turned(BEND, 80)
    away = deformer("log", worn)(pose).astype(float)
    foot = replace(body, skin=replace(skin, rest=skin.rest * [1 / 1.02, 1 / 1.02, 1]))
    lifted = np.linalg.norm(away - deformer("log", foot)(pose), axis=1)
    assert np.abs(lifted - 0.02).max() < 1e-6


def test_what_is_far_or_turned_away_is_filled_smoothly():
    """A sleeve that stands off the limb in the middle, where a second limb passes close by and faces the other way."""
    body, mesh = skins.cylinder(skins.halves), sleeve()
    z = mesh.vertices[:, 2]
    wide = 1.02 + 0.3 * np.exp(-((z / 0.6) ** 2))
    mesh = replace(mesh, vertices=mesh.vertices * np.stack([wide / 1.02, wide / 1.02, np.ones_like(z)], axis=1))
    other = skins.cylinder(lambda z: np.stack([0 * z, 0 * z, np.ones_like(z)], axis=1), 3)
    shifted = other.skin.rest + [2.4, 0, 0]
    weights = np.zeros((len(body.skin.rest), 3))
    weights[:, :2] = skins.halves(body.skin.rest[:, 2])
    all_of_it = np.concatenate([weights, np.tile([0, 0, 1.0], (len(shifted), 1))])
    vertex, joint = np.nonzero(all_of_it)
    both = vt.Skin(
        np.concatenate([body.skin.rest, shifted]),
        np.concatenate([body.skin.triangles, other.skin.triangles + len(body.skin.rest)]),
        Weights.from_pairs(len(all_of_it), vertex, joint, all_of_it[vertex, joint]),
    )
    pair = replace(other, skin=both)
    found = dense(transfer(pair, mesh, distance=0.2).weights, 3)
    assert found[:, 2].max() < 1e-9  # nothing of the other limb
    assert np.abs(found.sum(axis=1) - 1).max() < 1e-9
    assert np.abs(found[:, :2] - skins.halves(z)).max() < 0.1  # filled across the bulge
    assert np.abs(np.diff(found[::40, 1])).max() < 0.12
    plain = dense(transfer(pair, mesh, distance=2.0, angle=np.pi).weights, 3)
    assert plain[:, 2].max() > 0.9  # without the filters the nearest limb pulls


def test_inside_out_surfaces_and_open_parts():
    body, mesh = skins.cylinder(skins.halves), sleeve()
    turned = replace(mesh, triangles=mesh.triangles[:, ::-1])
    assert np.array_equal(transfer(body, turned).weights.weight, transfer(body, mesh).weights.weight)
    far = np.array([[9.0, 0, 3], [9, 1, 3], [9, 0, 3.5]])
    n = len(mesh.vertices)
    two = vt.Mesh(np.concatenate([mesh.vertices, far]), np.concatenate([mesh.triangles, [[n, n + 1, n + 2]]]))
    with pytest.warns(VitruvianWarning, match=f"3 of {n + 3} points"):
        skin = transfer(body, two)
    assert np.allclose(dense(skin.weights, 2)[n:], [[0, 1]] * 3)  # the nearest skin is the second joint's
    doubled = vt.Mesh(
        np.concatenate([mesh.vertices, mesh.vertices]), np.concatenate([mesh.triangles, mesh.triangles + n])
    )
    rows = dense(transfer(body, doubled).weights, 2)
    assert np.array_equal(rows[:n], rows[n:])  # copies stay together


@pytest.mark.parametrize("operator", OPERATORS)
def test_back_to_the_dress_pose(operator):
    """Points in a pose, taken back and posed again, are where they were; for a reshaped body too."""
    body = skins.crowd(4, seed=6)
    pose = skins.poses(body, angle=0.8)[1]
    posed = deformer(operator, body)(pose).astype(float)
    assert np.abs(dressed(body, posed, pose, operator=operator) - body.skin.rest).max() < 2e-5
    shaped = posed + np.random.default_rng(1).normal(scale=0.05, size=posed.shape)
    again = replace(body, skin=replace(body.skin, rest=dressed(body, shaped, pose, operator=operator)))
    assert np.abs(deformer(operator, again)(pose) - shaped).max() < 2e-5


def test_a_garment_modelled_in_a_pose():
    body = skins.cylinder(skins.halves)
    pose = skins.turned(BEND, 60)
    worn = replace(body, skin=transfer(body, sleeve()))
    mesh = vt.Mesh(deformer("log", worn)(pose).astype(float), worn.skin.triangles)
    skin = transfer(body, mesh, matrices=pose, distance=0.1)
    assert np.abs(skin.rest - worn.skin.rest).max() < 0.03
    assert np.abs(deformer("log", replace(body, skin=skin))(pose) - mesh.vertices).max() < 1e-5


def test_a_thin_coat_of_the_person():
    """A coat of 4 mm keeps its distance from a bent body."""
    import igl

    body = vt.pack(vt.person(loa=1, outfit=None, hair=None))
    part = next(p for p in body.skin.parts if p.name == "skin")
    used, t = np.unique(body.skin.triangles[part.start : part.stop], return_inverse=True)
    place, same = np.unique(body.skin.rest[used], axis=0, return_inverse=True)
    faces = same.reshape(-1)[t.reshape(-1, 3)].astype(np.int32)
    normals = mesh_normals(incidence(place, faces), place[None].astype(np.float32))[0]
    mesh = vt.Mesh(place + 0.004 * normals, faces)
    skin = transfer(body, mesh)
    rotation = body.skeleton.rotation.copy()
    for joint, value in {"l_elbow": [1, 0, 0, -1.4], "r_knee": [1, 0, 0, 1.4], "l_shoulder": [0, 0, 1, 0.8]}.items():
        rotation[body.skeleton.index[joint]] = from_axis_angle(np.array(value))
    pose = joint_matrices(replace(body.skeleton, rotation=rotation))[0]
    coat = deformer("log", replace(body, skin=skin, contours=()))(pose).astype(float)
    below = deformer("log", body)(pose).astype(float)
    gap = np.sqrt(igl.point_mesh_squared_distance(coat, below, body.skin.triangles.astype(np.int64))[0])
    assert np.percentile(gap, 99) < 0.008 and np.median(gap) == pytest.approx(0.004, abs=5e-4)


def test_what_does_not_fit_is_said():
    body, mesh = skins.cylinder(skins.halves), sleeve()
    for options, message in (
        ({"distance": 0}, "distance: expected more than 0"),
        ({"angle": 4.0}, "angle: expected"),
        ({"matrices": skins.turned(BEND, 10), "operator": "volume"}, "operator: expected 'linear'"),
        ({"matrices": np.eye(4)}, "matrices: expected shape"),
    ):
        with pytest.raises(VitruvianError, match=message):
            transfer(body, mesh, **options)
    with pytest.raises(VitruvianError, match="a body with a surface"):
        transfer(skins.point([1.0]), mesh)
    with pytest.raises(VitruvianError, match="in metres"):
        transfer(body, replace(mesh, unit="cm"))
    with pytest.raises(VitruvianError, match="pressed flat in this pose by 'linear'"):
        dressed(body, body.skin.rest, skins.turned(TWIST, 180), operator="linear")
    with pytest.raises(VitruvianError, match="one pose"):
        dressed(body, body.skin.rest, np.stack([skins.turned(BEND, 10)] * 2))
