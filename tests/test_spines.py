"""Torsos on any part of the spine: whatever joints there are, turns are shared out whole and nothing opens."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import vitruvian as vt
from test_contours import exact, posed, ring
from vitruvian.body.contours import Contours, spine_shares
from vitruvian.body.organise import SPINE
from vitruvian.body.rotations import from_matrix, to_axis_angle
from vitruvian.deform.deformer import deformer
from vitruvian.hanim.humanoid import ContourSurface, Humanoid, Joint, Segment

SUBSETS = (("vl5",), ("vt6",), ("vl5", "vt12", "vt6"), ("vl5", "vl3", "vt12", "vt6", "vt1"), SPINE)
HEIGHT = dict(zip(SPINE, np.linspace(0.98, 1.42, len(SPINE))))
COUNT = 40


def torso(joints, lower=2):
    """A humanoid whose trunk, 0.92 to 1.5 m high, is a front and a back on the first of these spine joints."""
    points = np.stack([ring([0, h, 0.01 * np.sin(9 * h)], 0.15) for h in np.linspace(1.5, 0.92, COUNT)])
    halves = [
        ContourSurface(f"l5_{name}_def", points[:, which], closed=False, lower=lower)
        for name, which in (("front", range(9)), ("back", [*range(8, 16), 0]))
    ]
    chain = None
    for name in reversed(joints):
        segments = [Segment("seg_" + name, contours=halves if name == joints[0] else [])]
        below = [chain] if chain else []
        chain = Joint(name=name, center=np.array([0, HEIGHT[name], 0.005]), joints=below, segments=segments)
    root = Joint(name="humanoid_root", center=np.array([0, 0.9, 0.0]), joints=[chain])
    return vt.pack(Humanoid(name="trunk", skeleton=[root]))


def angles(body, points):
    """(C,) degrees by which the contours of the front are wound about Y."""
    front = next(s for s in body.contours if s.name == "l5_front_def").vertices
    edge = points[front[:, -1]] - points[front[:, 0]]
    rest = body.skin.rest[front[:, -1]] - body.skin.rest[front[:, 0]]
    out = np.degrees(np.unwrap((np.arctan2(edge[:, 0], edge[:, 2]) - np.arctan2(rest[:, 0], rest[:, 2]))[::-1]))[::-1]
    return out - 360 * np.round(out[-1] / 360)


@pytest.mark.parametrize("joints", SUBSETS, ids=lambda j: str(len(j)))
def test_twists_are_shared_out_whole(joints):
    body = torso(joints)
    assert len(body.contours) == 2 and all(len(s.joints) == len(joints) for s in body.contours)
    each = {name: 40.0 / len(joints) + 3 * k for k, name in enumerate(joints)}
    wound = angles(body, exact(body, posed(body.skeleton, **{n: [0, 1, 0, np.radians(a)] for n, a in each.items()})))
    assert wound[0] == pytest.approx(sum(each.values()), abs=1e-6) and wound[-1] == pytest.approx(0, abs=1e-9)
    assert (np.diff(wound) < 1e-9).all()  # winds one way, from top to bottom
    summed = np.zeros(COUNT)
    for name, degrees in each.items():
        alone = angles(body, exact(body, posed(body.skeleton, **{name: [0, 1, 0, np.radians(degrees)]})))
        assert alone[0] == pytest.approx(degrees, abs=1e-6)
        summed += alone
    assert np.abs(summed - wound).max() < 1e-6  # turns about one axis add up, contour by contour


@pytest.mark.parametrize("joints", SUBSETS, ids=lambda j: str(len(j)))
def test_a_turn_of_the_upmost_joint_winds_all_of_the_trunk_in_even_steps(joints):
    body = torso(joints, lower=0)
    wound = angles(body, exact(body, posed(body.skeleton, **{joints[-1]: [0, 1, 0, np.radians(60)]})))
    steps = -np.diff(wound)
    moving = np.flatnonzero(steps > 1e-6)
    assert steps.sum() == pytest.approx(60, abs=1e-6) or len(joints) == 1
    if len(joints) > 1:  # below its zone: from the torso's bottom to there by equal steps
        assert len(moving) > COUNT / 3 and np.ptp(steps[moving[1:]]) < 1e-6


@given(
    st.lists(st.sampled_from(SPINE), min_size=1, max_size=len(SPINE), unique=True).map(
        lambda chosen: tuple(n for n in SPINE if n in chosen)
    ),
    st.integers(0, 10**6),
)
@settings(max_examples=30, deadline=None)
def test_the_top_goes_with_the_whole_spine_and_the_bottom_stays(joints, seed):
    rng = np.random.default_rng(seed)
    body = torso(joints)
    turns = {n: [*rng.normal(size=3), rng.uniform(0, 1.2 / np.sqrt(len(joints)))] for n in joints}
    m = posed(body.skeleton, **turns)
    out, rest = deformer("contours", body)(m), body.skin.rest
    front, back = (s.vertices for s in body.contours)
    assert np.array_equal(out[front[:, 0]], out[back[:, -1]]) and np.array_equal(out[front[:, -1]], out[back[:, 0]])
    last = m[body.skeleton.index[joints[-1]]]
    for half in (front, back):
        assert np.abs(out[half[0]] - (rest[half[0]] @ last[:3, :3].T + last[:3, 3])).max() < 2e-6
        assert np.array_equal(out[half[-1]], rest[half[-1]].astype(np.float32))
    still = deformer("contours", body)(posed(body.skeleton))
    assert np.array_equal(still, rest.astype(np.float32))
    middles = out[front].mean(axis=1)
    assert np.linalg.norm(np.diff(middles, axis=0), axis=1).max() < 0.08  # no contour leaps


@given(st.integers(1, 17), st.integers(3, 60), st.floats(0.3, 0.98), st.booleans())
@settings(max_examples=60, deadline=None)
def test_shares_of_any_spine_grow_from_the_bottom_to_all(n, count, reach, stand):
    heights = np.linspace(1.6, 0.9, count)
    swing, twist = spine_shares(heights, np.linspace(0.95, 0.95 + reach * 0.6, n), stand=stand)
    for share in (swing, twist):
        assert share.shape == (count, n) and share.min() >= 0 and share.max() <= 1
        assert (np.diff(share, axis=0) <= 1e-12).all()  # contours are from the neck down
    assert (twist[0] >= swing[0] - 1e-12).all()  # a twist of a joint above the top winds all of the torso
    if n > 1:
        made = Contours("t", 0, np.arange(count * 3).reshape(count, 3), np.arange(n), swing, twist).settled
        assert np.allclose(made.twist[0], swing[0]) and (made.twist <= twist + 1e-12).all()  # nothing takes it on
    assert (np.diff(swing, axis=1) <= 1e-12).all()  # a higher joint never holds more of a contour than a lower one


def test_a_bend_of_the_lowest_joint_moves_what_is_above_its_zone_as_one_piece():
    for joints in SUBSETS:
        body = torso(joints)
        m = posed(body.skeleton, **{joints[0]: [1, 0, 0.3, 0.5]})
        low = m[body.skeleton.index[joints[0]]]
        out, rest = exact(body, m), body.skin.rest
        center = HEIGHT[joints[0]]
        zone = center + (HEIGHT[joints[1]] - center) / 2 if len(joints) > 1 else center + 0.06
        above = np.flatnonzero(rest[:, 1] > zone + 0.01)
        assert len(above) > 100
        assert np.abs(out[above] - (rest[above] @ low[:3, :3].T + low[:3, 3])).max() < 1e-9
        assert np.isclose(to_axis_angle(from_matrix(low[:3, :3]))[3], 0.5)


@pytest.mark.parametrize(("loa", "spine"), [(1, 1), (2, 6)])
def test_people_of_all_levels_become_contour_bodies(loa, spine):
    humanoid = vt.contours(vt.person(loa=loa, outfit=None), density=0.5)
    body = vt.pack(humanoid)
    front = next(s for s in body.contours if s.name == "l5_front_def")
    assert len(front.joints) == spine
    names = [body.skeleton.names[j] for j in front.joints]
    m = posed(body.skeleton, **{n: [0.2, 1, 0, 0.6 / spine] for n in names})
    out = deformer("contours", body)(m)
    _, first, place = np.unique(body.skin.rest, axis=0, return_index=True, return_inverse=True)
    assert np.array_equal(out, out[first[place.reshape(-1)]])  # nothing opens, not by a bit


def test_a_twist_of_any_vertebra_winds_all_of_a_persons_trunk_below_it():
    """The contours end below the armpits; the skin sewn above them winds on, up to the neck."""
    body = vt.pack(vt.contours(vt.person(outfit=None), density=0.5))
    skeleton, rest, weights = body.skeleton, body.skin.rest, body.skin.weights
    move = deformer("contours", body)
    off = np.zeros(len(skeleton), bool)  # arms, legs and the head turn with what they hang on
    for j, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents, strict=True)):
        limb = name[2:] in ("sternoclavicular", "shoulder", "hip") or name in ("skullbase", "vc7")
        off[j] = limb or (parent >= 0 and off[parent])
    held = np.bincount(weights.vertex, np.where(off[weights.joint], weights.weight, 0.0), minlength=len(rest))
    centers = {n: skeleton.centers[skeleton.index[n]][1] for n in SPINE}
    levels = np.arange(centers["vl5"] - 0.01, centers["vt1"], 0.02)
    rings = [np.flatnonzero((held < 0.01) & (np.abs(rest[:, 1] - y) < 0.012)) for y in levels]
    rings = [r for r in rings if len(r)]
    assert len(rings) > 20
    _, first, place = np.unique(rest, axis=0, return_index=True, return_inverse=True)

    def wound(**turns):
        m = posed(skeleton, **turns)
        out = move(m)
        assert np.array_equal(out, out[first[place.reshape(-1)]])  # nothing opens, not by a bit
        r = move.frames(m).astype(np.float64)
        angle = np.degrees(np.arctan2(r[:, 0, 2] - r[:, 2, 0], r[:, 0, 0] + r[:, 2, 2]))
        return np.array([np.median(angle[ring]) for ring in rings])

    for name in SPINE:
        angle = wound(**{name: [0, 1, 0, np.radians(40)]})
        if centers[name] > 1.0:  # those below do not turn contours only
            assert angle[0] == pytest.approx(0, abs=2), name
        assert angle[-1] == pytest.approx(40, abs=1.5), name
        assert np.diff(angle).min() > -0.6, name  # winds one way
        if centers[name] > 1.1:  # no place takes it at once
            assert np.diff(angle).max() < 16, name
    each = wound(**{n: [0, 1, 0, np.radians(40 / len(SPINE))] for n in SPINE})
    assert each[-1] == pytest.approx(40, abs=1.5) and np.diff(each).min() > -0.6
