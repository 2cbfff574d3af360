"""Transfer where limbs hang near clothes, where clothes hide skin, and where figures are not in metres."""

from dataclasses import replace

import numpy as np
import pytest

import vitruvian as vt
from vitruvian.body.types import Skeleton
from vitruvian.modeling.aligning import hidden, uncovered
from vitruvian.modeling.metric import in_metres, unit_of
from vitruvian.modeling.person import humanoid_of
from vitruvian.modeling.regions import strayed
from vitruvian.modeling.reuse import Sheet, reuse
from vitruvian.modeling.shape import Shape as Sliders
from vitruvian.modeling.weights import table


def sheet(wide, high, size=0.05):
    """A flat grid: points (n,3) m, triangles."""
    x, y = np.meshgrid(np.arange(wide) * size, np.arange(high) * size)
    a = (np.arange(high - 1)[:, None] * wide + np.arange(wide - 1)).ravel()
    faces = np.concatenate([np.c_[a, a + 1, a + wide + 1], np.c_[a, a + wide + 1, a + wide]]).astype(np.int32)
    return np.c_[x.ravel(), y.ravel(), 0 * x.ravel()], faces


def tree():
    """A trunk of 5 bones and an arm of 5 hanging from its top, 0.32 m each."""
    up = [[0, 0.32 * k, 0] for k in range(6)]
    down = [[0.2, 1.6 - 0.32 * k, 0] for k in range(6)]
    parents = np.array([-1, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10], np.int32)
    return Skeleton(tuple(f"j{k}" for k in range(12)), parents, np.array(up + down, float))


def test_a_patch_that_took_another_limb_is_found_and_neighbours_stay():
    points, faces = sheet(20, 10)
    joint = np.where(points[:, 0] < 0.5, 0, 1).astype(np.int32)
    patch = (np.abs(points[:, :2] - [0.7, 0.2]) < 0.11).all(axis=1)
    joint[patch] = 11  # the hand: 3.4 m along the bones from the trunk's foot
    known = np.ones(len(points), bool)
    assert np.array_equal(strayed(known, joint, points, faces, tree()), patch)
    gap = (np.abs(points[:, :2] - [0.7, 0.2]) < 0.16).all(axis=1) & ~patch
    assert np.array_equal(strayed(~gap, joint, points, faces, tree()), patch)
    joint[patch] = 2  # near along the bones: no leap
    assert not strayed(known, joint, points, faces, tree()).any()
    joint[:] = 11  # a glove is all hand
    assert not strayed(known, joint, points, faces, tree()).any()
    assert not strayed(~known, joint, points, faces, tree()).any()


def test_halves_that_are_as_deep_stay_both():
    points, faces = sheet(20, 10)
    legs = Skeleton(
        ("root", *(f"l{k}" for k in range(3)), *(f"r{k}" for k in range(3))),
        np.array([-1, 0, 1, 2, 0, 4, 5], np.int32),
        np.array([[0, 1.6, 0], *([x, 1.2 - 0.4 * k, 0] for x in (0.1, -0.1) for k in range(3))], float),
    )
    joint = np.where(points[:, 0] < 0.5, 3, 6).astype(np.int32)
    assert not strayed(np.ones(len(points), bool), joint, points, faces, legs).any()


@pytest.fixture(scope="module")
def woman():
    return vt.person(gender=0.0, hair="short")


def skirt(body, low=0.5, high=1.0, around=64, rows=24):
    """A tube about hips, thighs and the hanging hands."""
    rest = body.skin.rest
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    ways = np.c_[np.cos(angle), np.sin(angle)]
    rings = []
    for y in np.linspace(high, low, rows):
        near = rest[np.abs(rest[:, 1] - y) < 0.02][:, [0, 2]]
        rings.append(np.c_[ways * ((near @ ways.T).max(axis=0) + 0.005)[:, None], np.full(around, y)][:, [0, 2, 1]])
    a = (np.arange(rows - 1)[:, None] * around + np.arange(around)).ravel()
    b = (np.arange(rows - 1)[:, None] * around + (np.arange(around) + 1) % around).ravel()
    faces = np.concatenate([np.c_[a, b, b + around], np.c_[a, b + around, a + around]])
    return Sheet(np.concatenate(rings), faces.astype(np.int32), name="skirt")


def arms(skeleton):
    """Which joints are in an arm, below the shoulder."""
    out = np.zeros(len(skeleton), bool)
    for j, name in enumerate(skeleton.names):
        out[j] = name in ("l_elbow", "r_elbow") or (skeleton.parents[j] >= 0 and out[skeleton.parents[j]])
    return out


def test_a_skirt_goes_with_no_hand_that_is_inside_it(woman):
    body = vt.pack(woman)
    made = vt.pack(reuse(woman, skirt(body), kind="garment").humanoid)
    share = table(made.skin.weights, len(made.skeleton)).toarray()[:, arms(made.skeleton)].sum(axis=1)
    assert share.max() < 1e-6
    near = vt.transfer(body, Sheet(body.skin.rest, body.skin.triangles))  # the body's own hands keep their joints
    assert table(near.weights, len(body.skeleton)).toarray()[:, arms(body.skeleton)].sum() > 1000


def test_the_skin_that_clothes_hide_is_had_again(woman):
    skin = vt.pack(woman).skin
    bare = vt.pack(humanoid_of(Sliders(gender=0.0), outfit=None, hair="none")).skin
    whole = uncovered(skin)
    first, full = whole.parts[0], bare.parts[0].stop
    assert len(hidden(skin)) and first.stop == full
    key = lambda t, uv: np.unique(np.c_[np.sort(t, axis=1), np.sort(uv, axis=1)], axis=0)  # noqa: E731
    mine = key(whole.triangles[:full], whole.uv_triangles[:full])
    assert np.array_equal(mine, key(bare.triangles[:full], bare.uv_triangles[:full]))
    assert len(whole.triangles) == len(skin.triangles) + len(hidden(skin))
    assert not len(hidden(bare)) and uncovered(bare) is bare


def test_people_in_clothes_are_matched_by_the_skin_below(woman):
    man = vt.person(gender=1.0, hair="short")
    given = reuse(woman, man).humanoid
    made, truth = vt.pack(given), vt.pack(man)
    rows = [table(b.skin.weights, len(truth.skeleton)) for b in (made, truth)]
    error = 0.5 * np.asarray(abs(rows[0] - rows[1]).sum(axis=1)).ravel()
    for part in truth.skin.parts:
        if part.name in ("skin", "top", "shorts"):
            used = np.unique(truth.skin.triangles[part.start : part.stop])
            assert error[used].mean() <= (0.03 if part.name == "skin" else 0.08)
    assert [s.material for s in given.skin] == [s.material for s in man.skin]


def test_a_figure_of_segments_in_inches_is_welded_and_keeps_its_unit(woman):
    inches = vt.segment(humanoid_of(Sliders(gender=1.0), outfit=None, hair="none", loa=3))
    inches = replace(in_metres(replace(inches, scale=np.full(3, 1 / 0.0254))), scale=np.full(3, 0.0254))
    assert unit_of(inches) == pytest.approx(0.0254) and np.ptp(vt.pack(inches).skin.rest[:, 1]) > 60
    for joint in inches.joints():
        joint.sites = []
        for segment in joint.segments:
            segment.sites = []
    made = reuse(woman, inches)
    assert made.report["welded"] and made.report["sites"] > 100 and made.report["filled"] < 0.2
    body = vt.pack(made.humanoid)
    assert np.allclose(made.humanoid.scale, 0.0254) and np.allclose(body.skin.weights.sums, 1)
    assert not any(s.shapes for s in made.humanoid.segments())
    tip = next(s for s in made.humanoid.all_sites() if s.name == "l_carpal_distal_phalanx_3_tip")
    last = body.skeleton.centers[body.skeleton.index["l_carpal_distal_interphalangeal_3"]]
    assert np.linalg.norm(tip.center + tip.translation - last) * 0.0254 < 0.05
    back = in_metres(made.humanoid)
    assert np.allclose(vt.pack(back).skin.rest, body.skin.rest * 0.0254) and unit_of(back) == 1
