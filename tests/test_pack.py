"""Humanoid to Body."""

import numpy as np
import pytest

from vitruvian import VitruvianError, VitruvianWarning
from vitruvian.body.pack import pack
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Material, Segment, Shape, Site


def vec(*v):
    return np.array(v, dtype=np.float64)


def figure():
    tip = Site("r_tip", center=vec(0, 2, 0), translation=vec(0, 0, 0.1))
    hand = Segment(
        "r_hand",
        shapes=[Shape("glove", np.array([[0, 1, 2]]), np.eye(3), transform=np.diag([2.0, 2, 2, 1]))],
        sites=[tip],
        displacers=[Displacer("r_bulge_action", np.array([1]), np.array([[0, 1.0, 0]]), 0.5)],
    )
    wrist = Joint(
        "r_radiocarpal",
        center=vec(0, 1, 0),
        rotation=vec(0, 0, 1, 0.5),
        segments=[hand],
        skin_coord_index=np.array([1, 2]),
        skin_coord_weight=vec(0.25, 1),
        ulimit=vec(1, 2, 3),
        llimit=vec(-1, -2),
        displacers=[Displacer("smile_action", np.array([0]), np.array([[0, 0, 1.0]]), 0.0)],
    )
    root = Joint("humanoid_root", joints=[wrist], skin_coord_index=np.array([0, 1]), skin_coord_weight=vec(1, 0.75))
    skin = Shape("face", np.array([[0, 1, 2]]), uv=np.array([[0, 0], [1, 0], [0, 1.0]]), colors=np.eye(3))
    grid = np.arange(9.0).reshape(3, 3)
    return Humanoid("joe", skeleton=[root], skin=[skin], skin_coord=grid, translation=vec(5, 0, 0))


def test_skin_first_then_segments_each_rigid():
    body = pack(figure())
    skin = body.skin
    assert skin.rest[:3].tolist() == np.arange(9.0).reshape(3, 3).tolist()
    assert skin.rest[3:].tolist() == (2 * np.eye(3)).tolist()
    assert skin.triangles.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert skin.weights.row.tolist() == [0, 1, 3, 4, 5, 6, 7]
    assert skin.weights.joint.tolist() == [0, 0, 1, 1, 1, 1, 1]
    assert skin.weights.weight.tolist() == [1, 0.75, 0.25, 1, 1, 1, 1]
    assert [(p.name, p.start, p.stop) for p in skin.parts] == [("face", 0, 1), ("glove", 1, 2)]
    assert skin.uv_triangles.tolist() == [[0, 1, 2], [3, 3, 3]]
    assert skin.colors[:3].tolist() == np.eye(3).tolist()
    assert skin.colors[3:].tolist() == [[0.8] * 3] * 3


def test_skeleton_limits_sites_and_placement():
    s = pack(figure()).skeleton
    assert s.names == ("humanoid_root", "r_radiocarpal")
    assert s.parents.tolist() == [-1, 0]
    assert np.allclose(s.rotation[1], [0, 0, np.sin(0.25), np.cos(0.25)])
    assert s.limits[1, :, 1].tolist() == [1, 2, 3]
    assert s.limits[1, :2, 0].tolist() == [-1, -2]
    assert np.isnan(s.limits[1, 2, 0])
    assert np.isnan(s.limits[0]).all()
    assert s.site_names == ("r_tip",)
    assert s.site_joints.tolist() == [1]
    assert s.site_points.tolist() == [[0, 2, 0.1]]
    assert pack(figure()).placement[:3, 3].tolist() == [5, 0, 0]


def test_displacers_become_morphs():
    smile, bulge = pack(figure()).skin.morphs
    assert (smile.name, smile.joint, smile.before, smile.weight) == ("smile_action", 1, False, 0.0)
    assert (bulge.name, bulge.joint, bulge.before, bulge.weight) == ("r_bulge_action", 1, True, 0.5)
    assert bulge.index.tolist() == [4]
    assert bulge.offset.tolist() == [[0, 2, 0]]  # the shape's own transform scales it


def test_binding_is_t_r_s_and_zero_scale_means_one():
    h = figure()
    assert pack(h).skeleton.binding is None
    h.binding = {"r_radiocarpal": (vec(1, 2, 3), vec(0, 0, 1, 0), vec(0, 0, 0))}
    binding = pack(h).skeleton.binding
    assert np.array_equal(binding[0], np.eye(4))
    assert np.array_equal(binding[1], np.array([[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1.0]]))
    h.binding = {"r_radiocarpal": (vec(0, 0, 0), vec(0, 0, 1, 0), vec(0, 0, 0))}
    assert pack(h).skeleton.binding is None


def test_a_joint_in_two_places_counts_once():
    h = figure()
    h.skeleton.append(h.skeleton[0].joints[0])
    body = pack(h)
    assert body.skeleton.names == ("humanoid_root", "r_radiocarpal")
    assert body.skin.weights.weight.max() == 1.0


def test_shapes_sharing_points_share_vertices():
    h = figure()
    points = np.eye(3)
    shapes = [Shape("a", np.array([[0, 1, 2]]), points), Shape("b", np.array([[2, 1, 0]]), points)]
    h.skeleton[0].segments = [Segment("trunk", shapes=shapes)]
    body = pack(h)
    assert len(body.skin.rest) == 9
    assert body.skin.triangles.tolist()[1:3] == [[3, 4, 5], [5, 4, 3]]


def test_looks_come_from_materials():
    h = figure()
    h.skin[0].colors = None
    h.skin[0].material = Material("skin", (0.1, 0.2, 0.3), 0.4, 0.5, 0.6, double_sided=True)
    part = pack(h).skin.parts[0]
    assert part.color == (0.1, 0.2, 0.3)
    assert (part.roughness, part.metallic, part.opacity, part.double_sided) == (0.4, 0.5, 0.6, True)
    assert pack(h).skin.colors is None


def test_short_weights_reuse_the_last_with_one_warning():
    h = figure()
    h.skeleton[0].joints[0].skin_coord_weight = vec(0.25)
    with pytest.warns(VitruvianWarning, match="r_radiocarpal: 2 skinCoordIndex but 1 skinCoordWeight") as said:
        weights = pack(h).skin.weights
    assert len(said) == 1
    assert weights.weight[:4].tolist() == [1, 0.75, 0.25, 0.25]


@pytest.mark.parametrize(
    ("index", "weight", "says"),
    [
        ([0, 3], [1, 1], r"joint r_radiocarpal skinCoordIndex: expected indices in 0\.\.2"),
        ([-1], [1], "joint r_radiocarpal skinCoordIndex"),
        ([0], [-0.5], "joint r_radiocarpal skinCoordWeight: expected finite weights >= 0"),
        ([0], [np.nan], "joint r_radiocarpal skinCoordWeight"),
    ],
)
def test_bad_weights_name_the_joint(index, weight, says):
    h = figure()
    h.skeleton[0].joints[0].skin_coord_index = np.array(index)
    h.skeleton[0].joints[0].skin_coord_weight = np.array(weight, dtype=np.float64)
    with pytest.raises(VitruvianError, match=says):
        pack(h)


def test_bad_displacer_entries_are_skipped_with_a_warning():
    h = figure()
    h.skeleton[0].joints[0].displacers = [Displacer("d", np.array([0, 9]), np.ones((2, 3)))]
    with pytest.warns(VitruvianWarning, match="Displacer d of r_radiocarpal"):
        morphs = pack(h).skin.morphs
    assert morphs[0].index.tolist() == [0]


def test_nothing_to_pack_is_said():
    with pytest.raises(VitruvianError, match="expected at least one Joint"):
        pack(Humanoid("empty"))


def test_a_skeleton_alone_has_an_empty_skin():
    body = pack(Humanoid("bones", skeleton=[Joint("humanoid_root")]))
    assert body.skin.rest.shape == (0, 3)
    assert body.skin.triangles.shape == (0, 3)
