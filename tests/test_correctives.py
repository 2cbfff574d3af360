"""Displacers driven by joint angles: the angle, the curve, the files, and correctives that are worked out."""

import numpy as np
import pytest

import skins
import vitruvian as vt
from vitruvian import VitruvianError, VitruvianWarning
from vitruvian.body.kinematics import joint_matrices, transform_matrix
from vitruvian.body.types import Drive, Morph, Skin, Weights
from vitruvian.deform.deformer import WEIGHTED, deformer
from vitruvian.deform.morphs import driven
from vitruvian.hanim.drivers import Driver, drive, driver_of
from vitruvian.hanim.graph import Node
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Shape
from vitruvian.modeling.correctives import add_corrective

CURVE = dict(angles=[0.0, 1.0, 2.0], weights=[0.0, 0.5, 2.0])


def about(axis, angle):
    return transform_matrix((0, 0, 0), (*axis, angle))


@pytest.mark.parametrize(("angle", "expected"), [(-0.5, 0), (0, 0), (0.5, 0.25), (1.5, 1.25), (2.5, 2.0)])
def test_weight_by_angle(angle, expected):
    """The part of the rotation about the axis counts, against the parent, whatever the swing."""
    drive_ = Drive(1, np.array([1.0, 0, 0]), *(np.array(v) for v in CURVE.values()))
    parent = about((0.6, 0.8, 0), 1.1)
    for swing in (np.eye(4), about((0, 1, 0), 0.7), about((0, 0.6, -0.8), -0.4)):
        m = np.stack([parent, parent @ swing @ about((1, 0, 0), angle)])[None]
        assert abs(driven(drive_, m, 0)[0] - expected) < 1e-9
        assert abs(driven(drive_, m * [[[[2, 2, 2, 1]]]], 0)[0] - expected) < 1e-9  # size does not matter


def test_driven_displacer_adds_to_its_weight_under_every_deformer():
    body = skins.point([1.0], (0, 0, 0))
    drive_ = Drive(0, np.array([0.0, 0, 1]), np.array([0.0, np.pi / 2]), np.array([0.0, 1.0]))
    morph = Morph("bulge_action", np.array([0], np.int32), np.array([[0, 1.0, 0]]), joint=0, drive=drive_)
    skin = Skin(np.zeros((1, 3)), np.zeros((0, 3)), Weights.from_pairs(1, [0], [0], [1.0]), morphs=(morph,))
    frames = np.stack([about((0, 0, 1), a) for a in (0, np.pi / 4, np.pi / 2)])[:, None]
    for name in WEIGHTED:
        d = deformer(name, type(body)("b", body.skeleton, skin))
        assert np.allclose(d(frames)[:, 0], [[0, 0, 0], [-(0.5**0.5) / 2, 0.5**0.5 / 2, 0], [-1, 0, 0]], atol=1e-6)
        assert np.allclose(d(frames, {"bulge_action": 0.5})[2, 0], [-1.5, 0, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joint": ""}, "joint"),
        ({"axis": [0, 0, 0]}, "axis"),
        ({"axis": [1, 0]}, "axis"),
        ({"angles": [0, 0, 1]}, "rising"),
        ({"angles": [0, np.nan, 1]}, "finite"),
        ({"weights": [1.0]}, "3 and 1"),
        ({"angles": [], "weights": []}, "0 and 0"),
    ],
)
def test_drivers_that_make_no_sense_are_refused(change, message):
    with pytest.raises(VitruvianError, match=message):
        Driver(**{"joint": "l_elbow", "axis": [1, 0, 0], **CURVE, **change})


def limb() -> Humanoid:
    """A bent tube round two joints, as a Humanoid."""
    body = skins.cylinder(skins.halves)
    joints = [Joint(n) for n in ("humanoid_root", "l_elbow")]
    joints[0].joints.append(joints[1])
    joints[0].center = np.array([0, 0, -4.0])
    h = Humanoid("limb", skeleton=[joints[0]])
    h.skin_coord = body.skin.rest
    h.skin = [Shape("tube", body.skin.triangles)]
    w = body.skin.weights
    for i, joint in enumerate(joints):
        joint.skin_coord_index, joint.skin_coord_weight = w.vertex[w.joint == i], w.weight[w.joint == i]
    return h


def bent(body, degrees):
    rotation = body.skeleton.rotation.copy()
    rotation[1] = [np.sin(np.radians(degrees) / 2), 0, 0, np.cos(np.radians(degrees) / 2)]
    return joint_matrices(type(body.skeleton)(body.skeleton.names, body.skeleton.parents, body.skeleton.centers,
                                              rotation=rotation))  # fmt: skip


def thickness(points):
    middle = points[40 * skins.POINTS : 41 * skins.POINTS].astype(float)
    return np.linalg.norm(middle[16] - middle[48]) / 2


def test_corrective_makes_linear_blending_as_good_as_its_target():
    """The bend that linear blending pinches to 0.71 keeps its thickness, at the angle it was made for and on the way."""
    h = limb()
    plain = vt.pack(h)
    made = add_corrective(h, "l_elbow", (1, 0, 0, np.pi / 2))
    body = vt.pack(h)
    assert made.name.endswith("_action")
    for degrees, worst in ((0, 1e-9), (45, 0.08), (90, 1e-5)):
        m = bent(body, degrees)
        with_it, target = deformer("linear", body)(m)[0], deformer("volume", plain)(m)[0]
        without = deformer("linear", plain)(m)[0]
        assert np.abs(with_it - target).max() <= worst + 2e-4
        if degrees == 90:
            assert abs(thickness(without) - 0.7071) < 1e-3
            assert thickness(with_it) > 0.99
    with pytest.raises(VitruvianError, match="difference"):
        add_corrective(limb(), "l_elbow", (1, 0, 0, 1.0), target="linear")
    with pytest.raises(VitruvianError, match="a joint of limb"):
        add_corrective(limb(), "l_knee", (1, 0, 0, 1.0))


@pytest.mark.parametrize("ending", [".x3d", ".x3dv", ".glb"])
def test_drivers_survive_files(tmp_path, ending):
    h = limb()
    add_corrective(h, "l_elbow", (1, 0, 0, np.pi / 2))
    before = vt.pack(h)
    path = tmp_path / f"limb{ending}"
    vt.save(h, path)
    after = vt.pack(vt.load(path))
    (one,), (two,) = before.skin.morphs, after.skin.morphs
    assert after.skeleton.names[two.drive.joint] == "l_elbow"
    assert np.allclose(one.drive.axis, two.drive.axis)
    assert np.allclose(one.drive.angles, two.drive.angles, atol=1e-6)
    assert np.allclose(one.drive.weights, two.drive.weights, atol=1e-6)
    m = bent(before, 80)
    moved = [np.sort(deformer("linear", b)(m)[0], axis=0) for b in (before, after)]
    if ending != ".glb":  # which orders points anew
        assert np.abs(moved[0] - moved[1]).max() < 1e-5
    assert abs(moved[0][-1, 2] - moved[1][-1, 2]) < 1e-5


def test_bad_driver_in_a_file_is_left_out_with_a_warning():
    h = limb()
    made = add_corrective(h, "l_elbow", (1, 0, 0, 1.0))
    made.metadata.fields["value"][0].fields["value"] = ["l_knee"]
    with pytest.warns(VitruvianWarning, match="no joint of this figure, 'l_knee'"):
        assert vt.pack(h).skin.morphs[0].drive is None
    made.metadata.fields["value"] = made.metadata.fields["value"][:1]
    with pytest.warns(VitruvianWarning, match="driver axis"):
        assert vt.pack(h).skin.morphs[0].drive is None
    other = Displacer("x_action", metadata=Node("MetadataSet", fields={"name": "something else"}))
    assert driver_of(other) is None
    drive(made, None)
    assert driver_of(made) is None
