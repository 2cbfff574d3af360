"""Surfaces put in contours: reordered to the point, by a harmonic field, resampled; what can't be is named."""

import numpy as np
import pytest

import vitruvian as vt
from vitruvian.body.contours import grid
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import Humanoid, Joint, Segment, Shape
from vitruvian.modeling.organising import organise, rearranged


def tube(count=18, each=25, *, bend=0.0, noise=0.0, seed=1):
    """(C,P,3) down the Y axis, and its triangles."""
    rng = np.random.default_rng(seed)
    angle = np.arange(each) * 2 * np.pi / each
    y = -np.arange(count) / (count - 1.0)
    points = np.zeros((count, each, 3))
    points[..., 0], points[..., 2] = 0.15 * np.sin(angle), 0.15 * np.cos(angle)
    points[..., 1] = y[:, None]
    points[..., 2] += bend * y[:, None] ** 2
    points += noise * rng.normal(size=points.shape)
    return points, grid(np.arange(count * each, dtype=np.int32).reshape(count, each), True)


def shuffled(points, triangles, seed=3):
    rng = np.random.default_rng(seed)
    place = rng.permutation(points.shape[0] * points.shape[1])
    out = np.empty((len(place), 3))
    out[place] = points.reshape(-1, 3)
    return out, place[triangles][rng.permutation(len(triangles))], place


@pytest.mark.parametrize("shape", [{}, {"bend": 0.4, "noise": 0.003}])
def test_a_shuffled_tube_is_reordered_point_by_point(shape):
    points, triangles = tube(**shape)
    flat, faces, place = shuffled(points, triangles)
    found = organise(flat, faces, np.array([0.0, 0.05, 0]))
    assert found.mode == "reorder" and found.error == (0.0, 0.0)
    order = np.argsort(place)[found.order]  # back to the numbers before the shuffle
    assert np.array_equal(np.sort(order.ravel()), np.arange(points[..., 0].size))
    assert np.array_equal(order // 25, np.repeat(np.arange(18)[:, None], 25, axis=1))
    steps = np.diff(order % 25, axis=1) % 25
    assert len(np.unique(steps)) == 1  # all contours run one way round
    assert np.array_equal(np.ptp(order % 25, axis=0), np.zeros(25))  # and begin at the same point
    around = found.points[0] - found.points[0].mean(axis=0)
    assert np.cross(around, np.roll(around, -1, axis=0)).sum(axis=0)[1] > 0  # counter-clockwise seen from the top


def test_the_field_is_the_contour_number():
    points, triangles = tube()
    flat, faces, place = shuffled(points, triangles)
    found = organise(flat, faces, np.array([0.0, 0.05, 0]), mode="field")
    ratio = np.repeat(np.arange(18) / 17, 25)
    assert found.mode == "field" and np.abs(found.field[place] - ratio).max() < 0.02
    own = found.shares(18, fixed=3, upper=6, lower=3)[place]
    assert np.allclose(own[25 * 6, 0], 0.5, atol=0.02) and np.allclose(own[-1], [1, 0.5], atol=0.02)


def test_a_closed_end_is_a_pole():
    points, triangles = tube(10, 12)
    flat = np.concatenate([points.reshape(-1, 3), [[0, -1.15, 0]]])
    last = np.arange(108, 120)
    cap = np.stack([last, np.full(12, 120), np.roll(last, -1)], axis=1)
    found = organise(flat, np.concatenate([triangles, cap]), np.zeros(3), np.array([0, -1.2, 0]))
    assert found.mode == "field" and found.field[120] == 1 and found.field[:12].max() == 0
    assert "ring" in found.refused[0] or "reorder" in found.refused[0]


def test_resampling_says_how_far_it_is_off_and_carries_texture():
    points, triangles = tube(30, 40, bend=0.3)
    uv = np.stack([np.tile(np.arange(40) / 40, 30), np.repeat(np.arange(30) / 29, 40)], axis=1)
    flat = points.reshape(-1, 3)
    found = organise(flat, triangles, np.zeros(3), mode="resample", contours=12, each=24, uv=uv)
    assert found.points.shape == (12, 24, 3) and 0 < found.error[0] < found.error[1] < 0.01
    assert np.abs(found.uv[:, 0, 1] - np.arange(12) / 11).max() < 0.05
    fine = organise(flat, triangles, np.zeros(3), mode="resample", contours=30, each=80)
    assert fine.error[0] < found.error[0] / 2


def broken(change):
    points, triangles = tube(8, 10)
    return change(points.reshape(-1, 3).copy(), triangles.copy())


CASES = {
    "two islands": (lambda p, t: (np.concatenate([p, p + 3]), np.concatenate([t, t[:2] + 80])), "found 2 islands"),
    "a fin": (lambda p, t: (np.concatenate([p, [[0, 0, 9.0]]]), np.concatenate([t, [[t[40, 0], t[40, 1], 80]]])),
              "at most two faces at an edge, found 3"),
    "a mirrored face": (lambda p, t: (p, np.concatenate([t[:50], t[50:51, ::-1], t[51:]])), "found a mirrored one"),
    "inside out": (lambda p, t: (p, t[:, ::-1]), "the whole surface mirrored"),
    "three openings": (lambda p, t: (p, np.delete(t, [70], axis=0)), "at most two open ends, found 3"),
    "itself": (lambda p, t: (np.where((np.arange(80) // 10 == 6)[:, None], p + [0, 4.3 / 7, 0.15], p), t),
               "does not cross itself"),
    "nothing": (lambda p, t: (p, t[:0]), "found no triangles"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_what_cannot_be_organised_is_named(case):
    change, message = CASES[case]
    points, triangles = broken(change)
    with pytest.raises(VitruvianError, match=message):
        organise(points, triangles, np.zeros(3), mode="auto" if case != "three openings" else "field", name="thigh")


def test_levels_with_several_loops_are_refused_by_level():
    a, t = tube(10, 12)
    legs = np.concatenate([a.reshape(-1, 3) + [0.3, 0, 0], a.reshape(-1, 3) - [0.3, 0, 0]])
    bridge = np.array([[0, 1, 120], [0, 120, 121]])  # joins both tubes at their tops
    with pytest.raises(VitruvianError, match="resample: expected one closed loop at level|open ends"):
        organise(legs, np.concatenate([t, t + 120, bridge]), np.zeros(3), mode="resample", name="pelvis")


def test_segments_in_contours_are_written_and_move_as_before(tmp_path):
    points, triangles = tube(bend=0.2)
    flat, faces, _ = shuffled(points, triangles)
    colors = np.random.default_rng(0).uniform(0, 1, flat.shape)
    uv = flat[:, :2].copy()
    ball = Shape(triangles=np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]], np.int32), points=np.eye(4)[:, :3])
    arm = Segment("l_upperarm", shapes=[Shape(triangles=faces.astype(np.int32), points=flat, uv=uv, colors=colors)])
    elbow = Joint("l_elbow", center=np.array([0, -1.0, 0.2]), segments=[Segment("l_forearm", shapes=[ball])])
    shoulder = Joint("l_shoulder", center=np.array([0, 0.05, 0.0]), segments=[arm], joints=[elbow])
    figure = Humanoid("arm", skeleton=[Joint("humanoid_root", joints=[shoulder])])
    made, reports = rearranged(figure)
    assert [r.mode for r in reports] == ["reorder", "field"] and reports[0].error == (0.0, 0.0)
    surface = made.joint("l_shoulder").segments[0].contours[0]
    assert not made.joint("l_shoulder").segments[0].shapes and made.joint("l_elbow").segments[0].shapes
    assert surface.points.shape == points.shape and arm.shapes  # the figure itself is as it was
    same = lambda a, b: np.array_equal(np.unique(a, axis=0), np.unique(b, axis=0))  # noqa: E731
    whole = np.concatenate([surface.points, surface.uv, surface.colors], axis=-1).reshape(-1, 8)
    assert same(whole, np.concatenate([flat, uv, colors], axis=1))  # nothing but the order of points changed
    vt.save(made, tmp_path / "arm.x3d")
    body = vt.pack(vt.load(tmp_path / "arm.x3d"))
    m = np.tile(np.eye(4), (3, 1, 1))
    turn = np.array([[1, 0, 0], [0, 0.0, -1], [0, 1, 0]])
    m[1:, :3, :3], m[1:, :3, 3] = turn, [0, 0.05, 0] - turn @ [0, 0.05, 0]
    rows = body.contours[0].vertices
    moved = vt.deformer("contours", body)(m)[rows]
    assert np.abs(moved - (surface.points @ turn.T + m[1, :3, 3])).max() < 1e-5
