"""Skinning operators: known numbers, no collapse, no dependence on where the character stands."""

import numpy as np
import pytest

import skins
from vitruvian import VitruvianError, VitruvianWarning
from vitruvian.body.kinematics import pose_matrices, transform_matrix
from vitruvian.body.types import Body, Morph, Skin, Weights
from vitruvian.deform.deformer import WEIGHTED, deformer

pytestmark = pytest.mark.usefixtures("both")

TWIST, BEND = (0, 0, 1), (1, 0, 0)
MOTIONS = np.stack(
    [
        np.eye(4),
        transform_matrix((0, 0, 0), (1, 0, 0, 1.2)),
        transform_matrix((0, 0, 0), (0, 1, 0, 0.9), center=(0, 0, 1)),
    ]
)
KNOWN = {
    ("linear", 1): (0.1989639, 0.1836771, 0.5070377),
    ("dual-quaternion", 1): (0.2180991, 0.2090500, 0.5626261),
    ("log-absolute", 1): (0.2165450, 0.2069100, 0.5636159),
    ("log-pair", 1): (0.2165450, 0.2069100, 0.5636159),
    ("log", 0): (0.2180991, 0.2090500, 0.5626261),
    ("log", 1): (0.2202586, 0.2093763, 0.5635217),
    ("log", 2): (0.2203418, 0.2094936, 0.5635371),
    ("hybrid", 1): (0.2202586, 0.2093763, 0.5635217),
}


@pytest.mark.parametrize(("name", "steps"), KNOWN)
def test_known_numbers(name, steps):
    d = deformer(name, skins.point([0.5, 0.3, 0.2]), steps=steps)
    assert np.abs(d(MOTIONS)[0] - KNOWN[name, steps]).max() < 1.5e-7


def test_log_converges():
    d = deformer("log", skins.point([0.5, 0.3, 0.2]), steps=3)
    assert np.abs(d(MOTIONS)[0] - (0.2203450, 0.2094986, 0.5635375)).max() < 5e-7


@pytest.mark.parametrize(
    ("axis", "degrees", "name", "ratio", "area"),
    [
        (TWIST, 90, "linear", 0.9032, 0.5000),
        (TWIST, 90, "dual-quaternion", 0.9995, 1.0),
        (TWIST, 90, "log", 0.9995, 1.0),
        (TWIST, 90, "log-pair", 0.9995, 1.0),
        (TWIST, 90, "log-absolute", 0.9995, 1.0),
        (TWIST, 90, "hybrid", 0.9995, 1.0),
        (TWIST, 135, "linear", 0.8350, 0.1464),
        (TWIST, 179.9, "linear", 0.8068, 0.0),
        (TWIST, 179.9, "dual-quaternion", 0.9984, 1.0),
        (TWIST, 179.9, "log", 0.9985, 1.0),
        (BEND, 90, "linear", 0.9515, 0.7071),
        (BEND, 90, "dual-quaternion", 0.9997, None),
        (BEND, 90, "log", 0.9997, None),
        (BEND, 90, "volume", 0.9829, None),
        (TWIST, 90, "volume", 0.9995, 1.0),
        (BEND, 135, "linear", 0.9173, 0.3827),
        (BEND, 135, "log", 0.9993, None),
    ],
)
def test_reference_cylinder(axis, degrees, name, ratio, area):
    body = skins.cylinder(skins.halves)
    points = deformer(name, body)(skins.turned(axis, degrees))
    assert abs(skins.volume(body, points) / skins.volume(body, body.skin.rest) - ratio) < 1e-4
    if area is not None:
        areas = skins.ring_areas(points) / skins.ring_areas(body.skin.rest)
        assert abs(areas.min() - area) < 1e-4
    if name in ("log", "dual-quaternion") and degrees == 90:
        assert skins.volume(body, points) / skins.volume(body, body.skin.rest) >= 0.999
        assert (skins.ring_areas(points) / skins.ring_areas(body.skin.rest)).min() >= 0.999 or axis == BEND


@pytest.mark.parametrize(
    ("name", "bulge"), [("linear", 1.0234), ("dual-quaternion", 1.1464), ("log", 1.1527), ("volume", 1.0097)]
)
def test_bulge_and_thickness_of_the_bend(name, bulge):
    body = skins.cylinder(skins.halves)
    points = deformer(name, body)(skins.turned(BEND, 90)).astype(float)
    middle = points[40 * skins.POINTS : 41 * skins.POINTS]
    thickness = np.linalg.norm(middle[16] - middle[48]) / 2
    assert abs(thickness - (0.7071 if name == "linear" else 1.0)) < 1e-4
    # distance from the bent bone line: the negative z axis, then the positive one turned by 90 degrees about x
    rings = points[: skins.RINGS * skins.POINTS]
    ends = [np.array([0, 0, -4.0]), np.array([0, -4.0, 0])]
    away = [rings - np.clip(rings @ e / 16, 0, None)[:, None] * e for e in ends]
    distance = np.minimum(*(np.linalg.norm(a, axis=1) for a in away))
    inside = distance[20 * skins.POINTS : 61 * skins.POINTS]
    assert abs(inside.max() - bulge) < 2e-3


def test_closed_form_of_linear_collapse():
    body = skins.cylinder(skins.halves)
    for degrees in (10, 45, 90, 150):
        points = deformer("linear", body)(skins.turned(TWIST, degrees))
        radius = np.linalg.norm(points[40 * skins.POINTS : 41 * skins.POINTS, :2], axis=1)
        assert np.abs(radius - np.cos(np.radians(degrees) / 2)).max() < 1e-6


@pytest.mark.parametrize("degrees", [10, 20, 45, 90])
def test_distance_of_linear_from_log(degrees):
    body = skins.cylinder(skins.halves)
    for axis in (TWIST, BEND):
        m = skins.turned(axis, degrees)
        away = np.linalg.norm(deformer("linear", body)(m) - deformer("log", body, steps=3)(m), axis=1)
        assert (
            abs(away.max() - (1 - np.cos(np.radians(degrees) / 2)))
            < 2e-3 * (1 - np.cos(np.radians(degrees) / 2)) + 1e-6
        )


@pytest.mark.parametrize("name", WEIGHTED)
def test_rest_is_rest(name):
    body = skins.crowd(6)
    rest = np.tile(np.eye(4), (12, 1, 1))
    assert np.abs(deformer(name, body)(rest) - body.skin.rest).max() < 2e-7
    assert np.abs(deformer(name, body).frames(rest) - np.eye(4)[:3]).max() < 1e-7


@pytest.mark.parametrize("name", WEIGHTED)
def test_turning_the_character_turns_the_skin(name):
    """To 1e-5 of the body's size, for every operator but the one kept as it was published."""
    body, matrices = skins.crowd(4, seed=3), skins.poses(skins.crowd(4, seed=3), angle=1.5)
    turn = transform_matrix((0.3, -0.2, 0.5), (0.6, 0, 0.8, 2.0), center=(1, 2, 3))
    d = deformer(name, body)
    before = d(matrices).astype(float)
    error = np.abs(d(turn @ matrices) - (before @ turn[:3, :3].T + turn[:3, 3])).max()
    if name == "log-absolute":
        assert error > 0.01
    else:
        assert error < 1e-5 * 2


def test_how_far_the_published_operator_is_off():
    """The three known motions, all turned: why log-absolute is not the default."""
    turn = transform_matrix((0, 0, 0), (0, 0, 1, np.pi / 2), center=(1, 2, 3))
    errors = {}
    for name in ("log", "log-absolute"):
        d = deformer(name, skins.point([0.5, 0.3, 0.2]))
        expected = turn[:3, :3] @ d(MOTIONS)[0].astype(float) + turn[:3, 3]
        errors[name] = np.linalg.norm(d(turn @ MOTIONS)[0] - expected)
    assert errors["log"] < 1e-6
    assert abs(errors["log-absolute"] - 0.0345) < 1e-4


def test_log_pair_jumps_where_the_largest_weight_changes():
    """And the others do not."""
    step = {}
    for name in WEIGHTED:
        ends = []
        for e in (1e-6, -1e-6):
            ends.append(deformer(name, skins.point([0.4 + e, 0.4 - e, 0.2]))(MOTIONS)[0].astype(float))
        step[name] = np.linalg.norm(ends[0] - ends[1])
    assert step.pop("log-pair") == pytest.approx(0.00906, abs=1e-5)
    assert max(step.values()) < 1e-5


def test_chain_past_180_degrees():
    """120 and 240 degrees: half way along the tube the turn is 120, except in the published operator."""

    def hats(z):
        s = np.clip((z + 3) / 6, 0, 1) * 2
        return np.stack([np.clip(1 - s, 0, 1), 1 - np.abs(s - 1), np.clip(s - 1, 0, 1)], axis=1)

    body = skins.cylinder(hats, 3)
    motions = np.stack([transform_matrix((0, 0, 0), (0, 0, 1, np.radians(a))) for a in (0, 120, 240)])
    for name in ("dual-quaternion", "log", "log-pair", "log-absolute"):
        line = deformer(name, body)(motions)[: skins.RINGS * skins.POINTS : skins.POINTS, :2].astype(float)
        steps = np.degrees(np.diff(np.unwrap(np.arctan2(line[:, 1], line[:, 0]))))
        assert abs(steps.sum() - (-120 if name == "log-absolute" else 240)) < 1e-3
        assert (steps.min() < -1) == (name == "log-absolute")


def test_twist_stays_continuous_through_180_degrees_in_consecutive_frames():
    body = skins.cylinder(skins.halves)
    matrices = np.stack([skins.turned(TWIST, a) for a in np.arange(0, 230, 10.0)])
    for name in ("log", "dual-quaternion"):
        followed = deformer(name, body)(matrices)
        assert np.abs(np.diff(followed, axis=0)).max() < 0.2
        alone = deformer(name, body, follow=False)(matrices)
        assert np.abs(np.diff(alone, axis=0)).max() > 1.5
        assert np.array_equal(alone[:18], followed[:18])


def test_near_half_turn_is_finite():
    body = skins.cylinder(skins.halves)
    for degrees in (179.9999, 180.0, 180.0001):
        for name in WEIGHTED:
            assert np.isfinite(deformer(name, body)(skins.turned(TWIST, degrees))).all()


def test_weights_that_do_not_sum_to_one():
    """What is missing stays at rest; linear follows the file beyond one as well."""
    motion = transform_matrix((1, 0, 0), (0, 0, 1, 0))[None]
    for name in WEIGHTED:
        assert np.allclose(deformer(name, skins.point([0.25]))(motion)[0], [0.55, 0.4, 0.5], atol=1e-7)
    assert np.allclose(deformer("linear", skins.point([1.5]))(motion)[0], [1.8, 0.4, 0.5])
    with pytest.warns(VitruvianWarning, match="1 of 1 vertices sum to more than 1"):
        d = deformer("log", skins.point([1.5]))
    assert np.allclose(d(motion)[0], [1.3, 0.4, 0.5])
    with pytest.warns(VitruvianWarning, match="do not sum to 1"):
        d = deformer("linear", skins.point([0.25]), weights="normalise")
    assert np.allclose(d(motion)[0], [1.3, 0.4, 0.5])


@pytest.mark.parametrize(
    ("vertex", "joint", "weight", "message"),
    [
        ([0, 5], [0, 0], [1.0, 1.0], r"weights.vertex: expected vertices in 0..1, found \[5\] at \[1\]"),
        ([0, -1], [0, 0], [1.0, 1.0], "weights.vertex"),
        ([0, 1], [0, -3], [1.0, 1.0], r"weights.joint: expected joints from 0 on, found \[-3\] at \[1\]"),
        ([0, 1], [0], [1.0, 1.0], "a weight for each entry, found 2, 1 and 2"),
        ([0], [0], [np.nan], "finite"),
        ([0], [0], [-1.0], "no negative weight"),
    ],
)
def test_weights_that_make_no_sense_are_named(vertex, joint, weight, message):
    with pytest.raises(VitruvianError, match=message):
        Weights.from_pairs(2, vertex, joint, weight)


def test_a_vertex_without_influence_stays():
    body = skins.point([1.0])
    skin = Skin(np.array([[1.0, 2, 3], [4, 5, 6]]), np.zeros((0, 3)), Weights.from_pairs(2, [0], [0], [1.0]))
    body = type(body)("two", body.skeleton, skin)
    motion = transform_matrix((1, 0, 0), (0, 0, 1, 0))[None]
    for name in WEIGHTED:
        assert np.allclose(deformer(name, body)(motion), [[2, 2, 3], [4, 5, 6]])


def test_scale_is_blended_apart_from_turns():
    """On one joint every operator gives M p, whatever M is; mixed mirrors are refused by name."""
    body = skins.point([1.0])
    motion = transform_matrix((0.1, 0.2, 0.3), (0, 0.6, 0.8, 1.1), (2, 0.5, 1.5), (1, 0, 0, 0.4))[None]
    for m in (motion, motion @ np.diag([-1.0, 1, 1, 1])):
        expected = (m[0] @ [0.3, 0.4, 0.5, 1])[:3]
        for name in WEIGHTED:
            d = deformer(name, body)
            assert np.allclose(d(m)[0], expected, atol=1e-6)
            assert np.allclose(d.frames(m)[0], m[0, :3], atol=1e-6)
    mixed = np.stack([np.eye(4), np.diag([-1.0, 1, 1, 1])])
    with pytest.raises(VitruvianError, match="joint j1 mirrors"):
        deformer("log", skins.point([0.5, 0.5]))(mixed)
    assert np.isfinite(deformer("linear", skins.point([0.5, 0.5]))(mixed)).all()


@pytest.mark.parametrize("name", WEIGHTED)
@pytest.mark.parametrize("scale", [False, True])
def test_frames_carry_the_points(name, scale):
    body = skins.crowd(5)
    matrices = skins.poses(body, angle=1.0, scale=scale)
    d = deformer(name, body)
    frames = d.frames(matrices).astype(float)
    moved = np.einsum("fvab,vb->fva", frames[..., :3], body.skin.rest) + frames[..., 3]
    assert np.abs(moved - d(matrices)).max() < 2e-6
    upright = d.frames(matrices, kind="orthonormal").astype(float)
    assert np.abs(np.einsum("fvba,fvbc->fvac", upright[..., :3], upright[..., :3]) - np.eye(3)).max() < 1e-5
    moved = np.einsum("fvab,vb->fva", upright[..., :3], body.skin.rest) + upright[..., 3]
    assert np.abs(moved - d(matrices)).max() < 3e-6


def test_hybrid_is_linear_at_small_and_log_at_large_angles():
    body = skins.cylinder(skins.halves)
    low, high = skins.turned(TWIST, 1.0), skins.turned(TWIST, 60.0)
    assert np.abs(deformer("hybrid", body)(low) - deformer("linear", body)(low)).max() < 5e-7
    assert np.abs(deformer("hybrid", body)(high) - deformer("log", body)(high)).max() < 3e-7
    everywhere, nowhere = deformer("hybrid", body, angle=0), deformer("hybrid", body, angle=np.pi)
    assert np.abs(everywhere(low) - deformer("log", body)(low)).max() < 3e-7
    assert np.abs(nowhere(high) - deformer("linear", body)(high)).max() < 5e-7


def test_hybrid_fades_and_the_hard_switch_pops():
    """At radius r and tolerance tol, linear errs by tol at th0 = 2 acos(1 - tol / r)."""
    body = skins.cylinder(skins.halves)
    limit = np.degrees(2 * np.arccos(1 - 0.005))
    soft, hard = (deformer("hybrid", body, tolerance=0.005, fade=f) for f in (True, False))
    step = {}
    for name, d in (("soft", soft), ("hard", hard), ("log", deformer("log", body))):
        a, b = (d(skins.turned(TWIST, limit + e)).astype(float) for e in (-1e-3, 1e-3))
        step[name] = np.abs(a - b).max()
    assert step["soft"] < 2 * step["log"] + 1e-6
    assert step["hard"] > 0.0045


@pytest.mark.parametrize("name", ["log", "dual-quaternion", "log-pair", "log-absolute", "hybrid", "volume"])
@pytest.mark.parametrize("scale", [False, True])
def test_painted_mix_over_linear(name, scale):
    body = skins.crowd(5)
    m = skins.poses(body, scale=scale)
    paint = np.linspace(0, 1, len(body.skin.rest))
    linear, other = (deformer(n, body)(m).astype(float) for n in ("linear", name))
    mixed = deformer(name, body, mix=paint)
    assert np.abs(mixed(m) - (linear + paint[:, None] * (other - linear))).max() < 2e-6
    frames = mixed.frames(m).astype(float)
    assert np.abs(np.einsum("fvab,vb->fva", frames[..., :3], body.skin.rest) + frames[..., 3] - mixed(m)).max() < 3e-6


def test_painted_shares_of_several_operators():
    """What the others leave belongs to the operator itself; each vertex has its own shares."""
    body = skins.cylinder(skins.halves)
    m = skins.turned(BEND, 90)
    count = len(body.skin.rest)
    first, second = np.linspace(0, 1, count), np.linspace(0.5, 0, count) * np.linspace(1, 0, count)
    parts = {n: deformer(n, body)(m).astype(float) for n in ("log", "volume", "linear")}
    mixed = deformer("log", body, mix={"volume": first, "linear": second})
    left = (1 - first - second)[:, None]
    expected = left * parts["log"] + first[:, None] * parts["volume"] + second[:, None] * parts["linear"]
    assert np.abs(mixed(m) - expected).max() < 2e-6
    assert np.array_equal(deformer("log", body, mix={})(m), deformer("log", body)(m))
    with pytest.raises(VitruvianError, match="sum to at most 1"):
        deformer("log", body, mix={"volume": first, "linear": np.full(count, 0.5)})
    with pytest.raises(VitruvianError, match="values in 0..1"):
        deformer("log", body, mix={"volume": first * 2})
    with pytest.raises(VitruvianError, match="expected shape"):
        deformer("log", body, mix=first[1:])


@pytest.mark.parametrize("name", ["log", "dual-quaternion", "log-pair", "hybrid", "volume"])
def test_twist_goes_on_past_180_degrees_and_past_300(name):
    """In one call, and frame by frame with `live`: no point jumps, and the way there and back is the same."""
    body = skins.cylinder(skins.halves)
    way = np.concatenate([np.arange(0, 320, 10.0), np.arange(320, -1, -10.0)])
    matrices = np.stack([skins.turned(TWIST, a) for a in way])
    together = deformer(name, body)(matrices).astype(float)
    # 10 degrees of the surface are 0.175; dual quaternions hurry through the middle the further the ends are apart
    assert np.abs(np.diff(together, axis=0)).max() < (0.4 if name == "dual-quaternion" else 0.2)
    assert np.abs(together[len(way) // 2 - 1 :: -1] - together[len(way) // 2 + 1 :]).max() < 1e-5
    single = deformer(name, body, live=True)
    alone = np.stack([single(m) for m in matrices])
    assert np.abs(alone - together).max() < 1e-6
    middle = together[24, 40 * skins.POINTS, :2]  # at 240 degrees the middle has turned by 120
    assert np.abs(middle - [np.cos(np.radians(120)), np.sin(np.radians(120))]).max() < 1e-4
    single(skins.turned(TWIST, 170))
    single.forget()
    fresh = single(skins.turned(TWIST, 190)).astype(float)  # nothing before it: the short way
    assert np.abs(fresh - deformer(name, body)(skins.turned(TWIST, 190))).max() < 1e-6


def test_displacers_under_joints_turn_with_them():
    body = skins.point([1.0], (0, 0, 0))
    points = np.arange(12.0).reshape(4, 3)
    morph = Morph("bulge_action", np.arange(4, dtype=np.int32), np.tile([0, 1.0, 0], (4, 1)), joint=0)
    weights = Weights.from_pairs(4, range(4), [0] * 4, [1.0] * 4)
    plain = type(body)("p", body.skeleton, Skin(points, np.zeros((0, 3)), weights))
    carried = type(body)("c", body.skeleton, Skin(points, np.zeros((0, 3)), weights, morphs=(morph,)))
    turn = transform_matrix((0, 0, 0), (0, 0, 1, np.pi / 2))[None]
    for name in WEIGHTED:
        d, without = deformer(name, carried), deformer(name, plain)(turn)
        assert np.array_equal(d(turn), without)
        assert np.abs(d(turn, {"bulge_action": 0.5}) - without - [-0.5, 0, 0]).max() < 1e-6
    series = deformer("log", carried)(np.stack([turn] * 3), {"bulge_action": [0, 0.5, 1.5]})
    assert np.abs(series[2] - series[0] - [-1.5, 0, 0]).max() < 2e-6
    with pytest.raises(VitruvianError, match="names of displacers"):
        deformer("log", carried)(turn, {"smile": 1.0})
    with pytest.raises(VitruvianError, match="no displacers"):
        deformer("log", plain)(turn, {"smile": 1.0})


def test_displacers_under_segments_come_before_skinning():
    body = skins.point([1.0], (0, 0, 0))
    morph = Morph("fist", np.array([0], np.int32), np.array([[1.0, 0, 0]]), joint=0, before=True, weight=0.5)
    skin = Skin(np.zeros((1, 3)), np.zeros((0, 3)), body.skin.weights, morphs=(morph,))
    turn = transform_matrix((0, 0, 0), (0, 0, 1, np.pi / 2), (2, 2, 2))[None]
    for name in WEIGHTED:
        d = deformer(name, type(body)("s", body.skeleton, skin))
        assert np.allclose(d(turn)[0], [0, 1, 0], atol=1e-6)
        assert np.allclose(d(turn, {"fist": 0})[0], 0)


def test_mesh_normals_are_welded_and_copies_equal():
    body = skins.cylinder(skins.halves)
    rest, t = body.skin.rest, body.skin.triangles
    seam = np.concatenate([rest, rest[:100]])  # the first hundred points twice
    t = np.where((t < 100) & (np.arange(len(t)) % 2 == 0)[:, None], t + len(rest), t)
    joint = np.zeros(len(seam), int)
    skin = Skin(seam, t, Weights.from_pairs(len(seam), np.arange(len(seam)), joint, np.ones(len(seam))))
    d = deformer("log", type(body)("seam", body.skeleton, skin))
    points = d(skins.turned(TWIST, 30))
    n = d.normals(points)
    assert np.array_equal(n[:100], n[len(rest) :])
    assert np.abs(np.linalg.norm(n, axis=1) - 1).max() < 1e-6
    ring = slice(40 * skins.POINTS, 41 * skins.POINTS)
    assert np.abs(n[ring, :2] - rest[ring, :2]).max() < 2e-3


def test_operator_normals_follow_rigid_and_sheared_motions():
    body = skins.cylinder(skins.halves)
    d = deformer("linear", body)
    assert np.abs(d.operator_normals(np.stack([np.eye(4)] * 2)) - d.rest_normals).max() < 1e-6
    squashed = np.stack([np.diag([1, 0, 1, 1.0])] * 2)  # singular: flat in y, normals along y
    n = d.operator_normals(squashed)
    assert np.isfinite(n).all()
    assert np.abs(np.abs(n[40 * skins.POINTS + 10]) - [0, 1, 0]).max() < 1e-6


def test_shapes_single_frames_and_out():
    body, d = skins.crowd(4), deformer("log", skins.crowd(4))
    m = skins.poses(body)
    batch = d(m)
    assert batch.shape == (3, 150, 3)
    assert batch.dtype == np.float32
    assert np.array_equal(d(m[1]), deformer("log", body)(m[1:2])[0])
    out = np.empty((3, 150, 3), np.float32)
    assert d(m, out=out) is out
    assert np.array_equal(out, batch)
    assert d.frames(m).shape == (3, 150, 3, 4)
    assert d.normals(batch).shape == batch.shape
    for wrong in (np.eye(4), m[:, :5]):
        with pytest.raises(VitruvianError, match=r"matrices: expected shape \(F, 12, 4, 4\)"):
            d(wrong)
    with pytest.raises(VitruvianError, match="out: expected float32"):
        d(m, out=np.empty((3, 150, 3)))


def test_unknown_names_and_options_are_said():
    body = skins.point([1.0])
    with pytest.raises(
        VitruvianError,
        match="dual-quaternion, log, log-pair, log-absolute, hybrid, volume, contours, hand, found 'lbs'",
    ):
        deformer("lbs", body)
    for option in ({"steps": 4}, {"tolerance": 1.0}, {"angle": 4.0}, {"weights": "x"}, {"mix": [2.0]}, {"mix": [0, 1]}):
        with pytest.raises(VitruvianError, match=next(iter(option))):
            deformer("log", body, **option)


def test_a_body_without_skin():
    body = skins.point([1.0])
    empty = Skin(np.zeros((0, 3)), np.zeros((0, 3)), Weights.from_pairs(0, [], [], []))
    for name in WEIGHTED:
        assert deformer(name, type(body)("bones", body.skeleton, empty))(np.eye(4)[None]).shape == (0, 3)


@pytest.mark.parametrize("name", ["log", "dual-quaternion", "log-pair", "hybrid", "volume"])
def test_a_fist_closes_without_a_jump(name):
    """Three joints of a chain turn by up to 70 degrees each: points between the first and the last pass half a turn
    although no joint does, one frame at a time, and the same wherever one starts."""
    rng = np.random.default_rng(4)
    count, joints = 60, 4
    rest = np.stack([rng.uniform(0.5, 3, count), rng.uniform(-0.3, 0.3, count), rng.uniform(-0.3, 0.3, count)], axis=1)
    share = rng.dirichlet(np.ones(joints), count)
    share[::3, 1:3] /= 4  # the first and the last above all
    vertex, joint = np.nonzero(share)
    weights = Weights.from_pairs(count, vertex, joint, share[vertex, joint] / share.sum(axis=1)[vertex])
    centers = np.array([[k, 0.0, 0] for k in range(joints)])
    finger = Body("finger", skins.skeleton(joints, centers), Skin(rest, np.zeros((0, 3)), weights))
    d = deformer(name, finger)
    angles = np.radians(np.arange(0, 71, 1.0))
    turn = np.zeros((len(angles), joints, 4))
    turn[:, :, 3] = 1
    turn[:, 1:, 2], turn[:, 1:, 3] = np.sin(angles / 2)[:, None], np.cos(angles / 2)[:, None]
    poses = pose_matrices(finger.skeleton, turn, np.zeros((len(angles), joints, 3)))
    alone = np.stack([d(m) for m in poses]).astype(float)
    assert np.linalg.norm(np.diff(alone, axis=0), axis=-1).max() < 0.15
    assert np.abs(d(poses) - alone).max() < 1e-6


@pytest.mark.parametrize("name", ["linear", "log", "dual-quaternion", "volume"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_matrices_that_are_not_finite_are_refused_by_the_name_of_the_joint(name, bad):
    body = skins.crowd(4)
    m = skins.poses(body)
    m[1, 3, 0, 3] = bad
    d, joint = deformer(name, body), body.skeleton.names[3]
    with pytest.raises(VitruvianError, match=rf"^matrices of joint {joint} in frame 1: expected finite numbers, found"):
        d(m)
    with pytest.raises(VitruvianError, match=rf"^matrices of joint {joint}: expected finite"):
        d.frames(m[1])
