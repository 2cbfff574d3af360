"""Mass, centre and inertia: closed forms, trimesh as a second opinion, the built-in person."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import vitruvian as vt
from scene_figure import typed
from vitruvian.body.rotations import from_axis_angle
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import Humanoid, Joint, Segment, Shape
from vitruvian.modeling import mass
from vitruvian.modeling.person import person
from vitruvian.motion.types import Motion


@pytest.fixture(scope="module")
def somebody() -> Humanoid:
    return person()


def test_box_ball_and_capsule() -> None:
    box = trimesh.creation.box([1, 2, 3])
    box.apply_translation([4, 5, 6])
    m = mass.solid(box.vertices, box.faces[:, ::-1], density=2)  # inside out, on purpose
    assert m.mass == pytest.approx(12)
    np.testing.assert_allclose(m.center, [4, 5, 6], atol=1e-12)
    np.testing.assert_allclose(m.inertia, np.diag([13, 10, 5]), atol=1e-11)
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.5)
    m = mass.solid(ball.vertices, ball.faces)
    assert m.mass == pytest.approx(1000 * 4 / 3 * np.pi * 0.125, rel=2e-3)
    np.testing.assert_allclose(m.inertia, np.eye(3) * 0.4 * m.mass * 0.25, rtol=3e-3, atol=1e-9)
    pill = trimesh.creation.capsule(height=1, radius=0.3, count=[96, 96])
    pill.density = 1000
    m = mass.solid(pill.vertices, pill.faces)
    exact = np.pi * 0.09 * 1 + 4 / 3 * np.pi * 0.027
    assert m.mass == pytest.approx(1000 * exact, rel=2e-3)
    np.testing.assert_allclose(m.inertia, pill.moment_inertia, atol=1e-9)
    np.testing.assert_allclose(m.center, pill.center_mass, atol=1e-12)


def test_holes_are_closed() -> None:
    box = trimesh.creation.box([1, 1, 1])
    lid = np.abs(box.face_normals[:, 1] - 1) > 1e-9
    m = mass.solid(box.vertices, box.faces[lid], density=1)
    assert m.mass == pytest.approx(1) and np.abs(m.center).max() < 1e-12
    with pytest.raises(VitruvianError, match="encloses"):
        mass.solid(np.eye(3), np.array([[0, 1, 2]]))


def test_a_cut_loses_nothing() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=1)
    owner = (ball.triangles_center[:, 1] > 0.3).astype(int) + (ball.triangles_center[:, 1] > 0.6)
    volume, first, second = mass.measured(ball.vertices, mass.cut(ball.faces, owner, 3))
    assert volume.sum() == pytest.approx(ball.volume, rel=1e-12) and (volume > 0.05).all()
    np.testing.assert_allclose(first.sum(axis=0), 0, atol=1e-12)
    cap = np.pi * 0.4**2 * (3 - 0.4) / 3
    assert volume[2] == pytest.approx(cap, rel=0.06)  # the cut follows the triangles
    assert np.trace(second.sum(axis=0)) == pytest.approx(4 / 5 * np.pi, rel=0.01)


def snake() -> Humanoid:
    """A capsule along Y as one skin over four joints, weights blended along it, points doubled along a seam."""
    pill = trimesh.creation.capsule(height=1, radius=0.15, count=[32, 32]).subdivide_to_size(0.04)
    faces = np.asarray(pill.faces)
    points = np.asarray(pill.vertices) @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]).T  # z to -y: still outwards
    high = points[faces].mean(axis=1)[:, 0] > 0
    copy = np.arange(len(points)) + len(points)
    faces = np.where(high[:, None], copy[faces], faces).astype(np.int32)
    points = np.concatenate([points, points])
    ends = np.linspace(points[:, 1].max() - 0.15, points[:, 1].min() + 0.15, 5)
    names = ["humanoid_root", "l_hip", "l_knee", "l_talocrural"]
    joints = [Joint(n, center=np.array([0, y, 0])) for n, y in zip(names, ends, strict=False)]
    for above, below in zip(joints, joints[1:], strict=False):
        above.joints.append(below)
    at = np.clip((ends[0] - points[:, 1]) / (ends[0] - ends[1]), 0.5, 3.5) - 0.5
    for k, joint in enumerate(joints):
        weight = np.clip(1 - np.abs(at - k), 0, 1)
        joint.skin_coord_index = np.flatnonzero(weight).astype(np.int32)
        joint.skin_coord_weight = weight[weight > 0]
    return Humanoid("snake", skeleton=[joints[0]], skin=[Shape("skin", faces)], skin_coord=points)


def test_skin_is_filled_without_gap() -> None:
    """The wedges between a skin and its bones fill it: the pieces together are the whole, and each is its stretch."""
    h = snake()
    pill = trimesh.Trimesh(h.skin_coord, h.skin[0].triangles)
    pill.density = 1000
    found = mass.masses(h, density=1000)
    assert list(found) == ["sacrum", "l_thigh", "l_calf", "l_talus"]
    total = sum(m.mass for m in found.values())
    assert total == pytest.approx(pill.mass, rel=1e-4)
    middle = sum(m.mass * m.center for m in found.values()) / total
    np.testing.assert_allclose(middle, pill.center_mass, atol=1e-5)
    spread = np.zeros((3, 3))
    for m in found.values():
        d = m.center - middle
        spread += m.inertia + m.mass * (d @ d * np.eye(3) - np.outer(d, d))
    np.testing.assert_allclose(spread, pill.moment_inertia, rtol=1e-3, atol=1e-3)
    cylinder = 1000 * np.pi * 0.15**2 * 0.25
    assert found["l_thigh"].mass == pytest.approx(cylinder, rel=0.08)
    assert found["l_thigh"].center[1] == pytest.approx(h.joint("l_hip").center[1] - 0.125, abs=0.02)
    stored = mass.masses(h, weight=2.0, store=True)
    assert h.joint("l_knee").segments[0].mass == stored["l_calf"].mass
    assert vt.whole_body(h).mass == pytest.approx(2)


def block(name: str, at: list[float], size: list[float]) -> Segment:
    box = trimesh.creation.box(size)
    box.apply_translation(at)
    return Segment(name, shapes=[Shape(name, np.asarray(box.faces, np.int32), points=np.asarray(box.vertices))])


def blocks() -> Humanoid:
    """A trunk and an arm of boxes."""
    arm = Joint("l_shoulder", center=np.array([0.5, 1, 0]), segments=[block("l_upperarm", [1.0, 1, 0], [1, 0.2, 0.2])])
    root = Joint("humanoid_root", segments=[block("sacrum", [0, 0.5, 0], [1, 1, 0.5])], joints=[arm])
    return Humanoid("blocks", skeleton=[root])


def test_segments_of_boxes() -> None:
    h = blocks()
    found = vt.masses(h, density={"sacrum": 500, "l_upperarm": 1000}, store=True)
    assert found["sacrum"].mass == pytest.approx(250) and found["l_upperarm"].mass == pytest.approx(40)
    sacrum = h.joint("humanoid_root").segments[0]
    assert sacrum.mass == pytest.approx(250)
    np.testing.assert_allclose(sacrum.center_of_mass, [0, 0.5, 0], atol=1e-12)
    np.testing.assert_allclose(sacrum.moments_of_inertia.reshape(3, 3), np.diag([1.25, 1.25, 2]) * 250 / 12, atol=1e-9)
    scaled = vt.masses(h, weight=29, density={"sacrum": 500, "l_upperarm": 1000})
    assert scaled["sacrum"].mass == pytest.approx(25) and scaled["l_upperarm"].mass == pytest.approx(4)


def test_whole_body_of_boxes_in_motion() -> None:
    """Centre and inertia of the whole while the arm turns, against the sum done by hand."""
    h = blocks()
    vt.masses(h, density={"sacrum": 500, "l_upperarm": 1000}, store=True)
    skeleton = vt.pack(h).skeleton
    angles = np.radians([0.0, 90.0])
    rotation = np.tile([0, 0, 0, 1.0], (2, 2, 1))
    rotation[:, 1] = from_axis_angle(np.stack([np.zeros(2), np.zeros(2), np.ones(2), angles], axis=1))
    body = vt.whole_body(h, Motion(skeleton, 10, rotation, np.array([[0, 0, 0], [0, 0, 2.0]])))
    assert body.mass == pytest.approx(290)
    arm = np.array([[1.0, 1, 0], [0.5, 1.5, 2.0]])
    trunk = np.array([[0, 0.5, 0], [0, 0.5, 2.0]])
    center = (250 * trunk + 40 * arm) / 290
    np.testing.assert_allclose(body.center, center, atol=1e-12)
    long, thin = 40 / 12 * (1 + 0.04), 40 / 12 * 0.08
    own = [np.diag([thin, long, long]), np.diag([long, thin, long])]
    for f in range(2):
        expected = np.diag([1.25, 1.25, 2]) * 250 / 12 + own[f]
        for m, c in ((250, trunk[f]), (40, arm[f])):
            d = c - center[f]
            expected = expected + m * (d @ d * np.eye(3) - np.outer(d, d))
        np.testing.assert_allclose(body.inertia[f], expected, atol=1e-9)
    with pytest.raises(VitruvianError, match="masses"):
        vt.whole_body(blocks())


def test_the_person_weighs_what_it_says(somebody: Humanoid) -> None:
    total = sum(s.mass for s in somebody.segments())
    assert total == pytest.approx(float(somebody.info["weight"]), abs=0.051)
    body = vt.whole_body(somebody)
    skin = somebody.skin_coord[:13380]
    stature = np.ptp(skin[:, 1])
    assert 0.53 < body.center[0, 1] / stature < 0.58
    assert np.abs(body.center[0, [0, 2]]).max() < 0.01
    solid = trimesh.Trimesh(skin, person_triangles(), process=False)
    solid.density = total / solid.volume
    np.testing.assert_allclose(body.center[0], solid.center_mass, atol=2e-3)
    np.testing.assert_allclose(body.inertia[0], solid.moment_inertia, atol=0.01 * solid.moment_inertia.max())
    for s in somebody.segments():
        moments = np.linalg.eigvalsh(s.moments_of_inertia.reshape(3, 3))
        assert s.mass == 0 or (moments[0] > 0 and moments[0] + moments[1] >= moments[2] * (1 - 1e-6)), s.name


def person_triangles() -> np.ndarray:
    from vitruvian.modeling import source

    return source.array("triangles")


def test_parts_of_the_person_are_like_published_ones(somebody: Humanoid) -> None:
    """By volume every part lies within 2.5 % of the body of its published share (skin weights end elsewhere than the
    cuts of anatomists)."""
    part = mass.part_of(somebody.joints())
    found: dict[str, float] = {}
    for j in somebody.joints():
        found[part[j.name]] = found.get(part[j.name], 0) + sum(s.mass for s in j.segments)
    total = sum(found.values())
    for name, (female, male, _) in mass.FRACTIONS.items():
        share = (female + male) / 2 * (1 if name in {"head", "trunk"} else 2)
        assert abs(found[name] / total - share) < 0.025, (name, found[name] / total, share)


def test_published_shares(somebody: Humanoid) -> None:
    found = vt.masses(somebody, weight=70, method="fractions", gender=1.0)
    assert sum(m.mass for m in found.values()) == pytest.approx(70)
    part = mass.part_of(somebody.joints())
    sums: dict[str, float] = {}
    for j in somebody.joints():
        for s in j.segments:
            sums[part[j.name]] = sums.get(part[j.name], 0) + (found[s.name].mass if s.name in found else 0)
    assert sums["thigh"] == pytest.approx(70 * 2 * 0.1416, rel=1e-3)
    assert sums["head"] == pytest.approx(70 * 0.0694, rel=1e-3)
    assert sums["hand"] == pytest.approx(70 * 2 * 0.0061, rel=1e-3)
    with pytest.raises(VitruvianError, match="method"):
        vt.masses(somebody, method="guess")


def test_masses_go_into_files_and_come_back(tmp_path) -> None:
    h = typed(1)
    segment = h.joint("l_hip").segments[0]
    segment.center_of_mass = np.array([0.1, 0.7, 0.0])
    segment.moments_of_inertia = np.diag([0.5, 0.25, 0.5]).reshape(9)
    vt.save(h, tmp_path / "mass.x3d")
    back = vt.load(tmp_path / "mass.x3d")
    assert vt.whole_body(back).mass == pytest.approx(27)
    np.testing.assert_allclose(vt.whole_body(back).inertia, vt.whole_body(h).inertia, rtol=1e-5)
