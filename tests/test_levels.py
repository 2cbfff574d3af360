"""Levels of articulation up and down: joints, skin and motion."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import vitruvian as vt
from scene_figure import typed
from vitruvian.body.kinematics import joint_matrices, joint_positions, pose_matrices
from vitruvian.body.rotations import from_axis_angle, from_vector, multiply, to_axis_angle
from vitruvian.errors import VitruvianError
from vitruvian.hanim import tables
from vitruvian.hanim.convert import converted
from vitruvian.hanim.default import default_body, default_places
from vitruvian.hanim.humanoid import Displacer, Humanoid, MotionData, Shape, Site, Track
from vitruvian.modeling.levels import at_level, raised
from vitruvian.motion.lowering import lowered, lowered_motion
from vitruvian.motion.tracks import motion_data, motion_of, tracks_of

TURN = {"ZXY": ("Zrotation", "Xrotation", "Yrotation")}


@cache
def person(loa: int) -> Humanoid:
    return vt.person(loa=loa, outfit=None, hair="none")


def load(shared: Path, name: str) -> Humanoid:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return vt.load(shared / "data" / "hanim" / name)


def sums(h: Humanoid) -> np.ndarray:
    total = np.zeros(len(h.skin_coord))
    for joint in h.joints():
        np.add.at(total, joint.skin_coord_index, joint.skin_coord_weight)
    return total


def skin(h: Humanoid, turns: dict[str, np.ndarray]) -> np.ndarray:
    """(V,3) vertices with these axis-angles."""
    body = vt.pack(h)
    q = body.skeleton.rotation[None].copy()
    for name, turn in turns.items():
        q[0, body.skeleton.index[name]] = from_axis_angle(turn)
    matrices = pose_matrices(body.skeleton, q, body.skeleton.translation[None])
    return vt.deformer("linear", body)(matrices)[0]


@pytest.mark.parametrize("version", ["2.0", "1.1", "200x", "1.0"])
def test_default_bodies(version: str) -> None:
    old = tables.family(version) == "1.x"
    for loa, count in enumerate(tables.LOA_COUNTS[: 4 if old else 5]):
        h = default_body(loa, version)
        names = [j.name for j in h.joints()]
        assert len(names) == count == len(h.segments())
        assert {tables.canonical(n) for n in names} == set(tables.joints_at(loa))
        assert names[0] == ("HumanoidRoot" if version in ("1.1", "200x") else "humanoid_root")
        for joint in h.joints():
            for child in joint.joints:
                assert tables.parent_at(tables.canonical(child.name), loa) == tables.canonical(joint.name)
            mate = next((j for j in h.joints() if j.name == "r_" + joint.name[2:]), None)
            if joint.name.startswith("l_"):
                np.testing.assert_array_equal(joint.center * [-1, 1, 1], mate.center)
            elif not joint.name.startswith("r_"):
                assert joint.center[0] == 0
        assert h.loa == (-1 if old else loa)
        assert len({s.name for s in h.all_sites()}) == len(h.all_sites()) == (57 if old else 77)
    if version == "2.0":
        home = {s.name: g.name for g in h.segments() for s in g.sites}
        assert all(home[f"{n}_pt"] == tables.feature_points()[n].segment for n in default_places())
    with pytest.raises(VitruvianError, match="level of articulation"):
        default_body(4 if old else 5, version)
    with pytest.raises(VitruvianError, match="H-Anim version"):
        default_body(1, "3.0")


@pytest.mark.parametrize("loa", [0, 1, 2, 3])
def test_raised_bodies_move_as_before(loa: int) -> None:
    h = person(loa)
    up, lost = raised(h, 4)
    assert (len(up.joints()), up.loa) == (146, 4)
    for joint in up.joints():
        for child in joint.joints:
            assert tables.parent_at(child.name, 4) == joint.name
    assert len(h.joints()) == tables.LOA_COUNTS[loa]
    np.testing.assert_allclose(sums(up), sums(h), atol=1e-12)
    rng = np.random.default_rng(loa)
    turns = {j.name: np.append(rng.normal(size=3), 0.6) for j in h.joints()}
    np.testing.assert_allclose(skin(up, turns), skin(h, turns), atol=2e-6)
    assert all("face" in x for x in lost)
    # the built-in person at LOA 4 is the truth that a coarser one has lost
    truth = {j.name: j.center for j in person(4).joints()}
    off = [np.linalg.norm(j.center - truth[j.name]) for j in up.joints() if j.name not in {x.name for x in h.joints()}]
    assert np.mean(off) < (0.07 if loa == 0 else 0.03)


def test_both_sides_are_mirror_images() -> None:
    up, _ = raised(person(1), 4)
    named = {j.name: j for j in up.joints()}
    for name, joint in named.items():
        if name.startswith("l_"):
            np.testing.assert_array_equal(joint.center * [-1, 1, 1], named["r_" + name[2:]].center, name)


def test_a_spread_turn_bends_smoothly() -> None:
    """60 degrees at one vertebra kink the trunk; over all of them edges stretch less, also less than at LOA 4."""
    h = person(1)
    up, _ = raised(h, 4)
    spine = [f"vl{k}" for k in range(5, 0, -1)] + [f"vt{k}" for k in range(12, 5, -1)]
    whole = np.radians(60)
    kinked = skin(h, {"vl5": np.array([1, 0, 0, whole])})
    spread = {n: np.array([1, 0, 0, whole / len(spine)]) for n in spine}
    edges = np.concatenate([s.triangles[:, [0, 1]] for s in h.skin])
    rest = np.linalg.norm(np.diff(h.skin_coord[edges], axis=1)[:, 0], axis=1)
    belly = (h.skin_coord[edges[:, 0], 1] > 0.8) & (h.skin_coord[edges[:, 0], 1] < 1.3) & (rest > 0.004)
    belly &= np.abs(h.skin_coord[edges[:, 0], 0]) < 0.17

    def stretch(points: np.ndarray) -> float:
        length = np.linalg.norm(np.diff(points[edges], axis=1)[:, 0], axis=1)
        return float(np.abs(np.log(np.maximum(length, 1e-9) / rest))[belly].max())

    assert stretch(skin(up, spread)) < 0.85 * stretch(kinked)
    assert stretch(skin(up, spread)) < stretch(skin(person(4), spread))


def test_a_fist_from_a_body_without_fingers() -> None:
    up, _ = raised(person(1), 2)
    parts = ("metacarpophalangeal", "carpal_proximal_interphalangeal", "carpal_distal_interphalangeal")
    turns = {f"l_{part}_{k}": np.array([0, 0, 1.0, -1.2]) for part in parts for k in range(2, 6)}
    ours, truth = skin(up, turns), skin(person(2), turns)
    tips = {s.name: s.translation for s in person(2).all_sites() if s.name.startswith("l_carpal_distal_phalanx")}
    for name, tip in tips.items():
        near = np.argsort(np.linalg.norm(person(2).skin_coord - tip, axis=1))[:20]
        moved = np.linalg.norm(truth[near] - person(2).skin_coord[near], axis=1).mean()
        off = np.linalg.norm(ours[near] - truth[near], axis=1).mean()
        assert off < (0.36 * moved if moved > 0.02 else 0.003), name


def test_sites_and_segments_find_their_joints() -> None:
    h = typed(1)
    holder = h.joint("l_radiocarpal")
    holder.segments[0].sites.append(Site("l_carpal_distal_phalanx_2_tip", translation=np.array([0.2, 0.7, 0.0])))
    holder.sites.append(Site("l_front_of_nothing_view"))
    up, _ = raised(h, 2)
    finger = up.joint("l_carpal_distal_interphalangeal_2")
    assert [s.name for s in finger.segments[0].sites] == ["l_carpal_distal_phalanx_2_tip"]
    assert finger.segments[0].name == "l_carpal_distal_phalanx_2"
    assert [s.name for s in up.joint("l_radiocarpal").sites] == ["l_front_of_nothing_view"]
    assert up.joint("l_radiocarpal").segments[0].sites == []
    assert len(holder.segments[0].sites) == 1  # the original stays as it was


@pytest.mark.parametrize(("name", "loa"), [("JinLOA1.x3d", 3), ("JoeKick.x3d", 4), ("DiamondManLOA2.x3d", 2)])
def test_real_files_reach_their_level(shared: Path, name: str, loa: int) -> None:
    h = load(shared, name)
    up, _, off = at_level(h, loa)
    standard = [tables.canonical(j.name) for j in up.joints() if tables.canonical(j.name)]
    assert sorted(standard) == sorted(tables.joints_at(loa))
    np.testing.assert_allclose(sums(up), sums(h), atol=1e-9)
    if h.tracks and off == 0:
        a, b = vt.pack(h), vt.pack(up)
        m, n = motion_of(h, a.skeleton), motion_of(up, b.skeleton)
        before, after = (joint_positions(x.skeleton, joint_matrices(x.skeleton, y)) for x, y in ((a, m), (b, n)))
        which = [b.skeleton.index[j] for j in a.skeleton.names if j in b.skeleton.index]
        same = [a.skeleton.index[b.skeleton.names[j]] for j in which]
        np.testing.assert_allclose(before[:, same], after[:, which], atol=1e-9)


def test_a_level_that_a_version_lacks() -> None:
    h = default_body(1, "1.1")
    with pytest.raises(VitruvianError, match="ends at 3"):
        raised(h, 4)
    with pytest.raises(VitruvianError, match="ends at 3"):
        at_level(person(1), 4, version="200x")
    up, lost, _ = at_level(h, 4, version="2.0")
    assert (len(up.joints()), up.version, up.loa) == (146, "2.0", 4)
    down, _, _ = at_level(up, 2, version="1.1")
    assert len(down.joints()) == 71
    assert down.joints()[0].name == "HumanoidRoot"
    headless = Humanoid("x", skeleton=[h.joint("skullbase")])
    with pytest.raises(VitruvianError, match="humanoid_root"):
        raised(headless, 1)


def walking(loa: int, kind: str) -> Humanoid:
    h = person(loa)
    motion = vt.walk(vt.pack(h).skeleton)
    if kind == "tracks":
        return replace(h, tracks=tracks_of(motion, timer="walk"))
    return replace(h, motions=[motion_data(motion)])


@pytest.mark.parametrize("kind", ["tracks", "motion"])
@pytest.mark.parametrize(("version", "loa"), [("2.0", 3), ("2.0", 1), ("1.1", None)])
def test_motion_goes_down_with_its_joints(kind: str, version: str, loa: int | None) -> None:
    h = walking(4, kind)
    down, lost, off = lowered(h, version, loa=loa)
    a, b = vt.pack(h), vt.pack(down)
    before, after = (joint_matrices(x.skeleton, motion_of(y, x.skeleton)) for x, y in ((a, h), (b, down)))
    which = [a.skeleton.index[tables.canonical(n)] for n in b.skeleton.names]
    places, found = joint_positions(a.skeleton, before)[:, which], joint_positions(b.skeleton, after)
    free = [j for j, n in enumerate(b.skeleton.names) if n not in ("vl5",)]
    np.testing.assert_allclose(places[:, free], found[:, free], atol=1e-6)
    np.testing.assert_allclose(before[:, which][:, free], after[:, free], atol=1e-6)
    skins = [vt.deformer("linear", x)(m) for x, m in ((a, before), (b, after))]
    measured = np.linalg.norm(skins[0] - skins[1], axis=2).max()
    assert off == pytest.approx(measured, abs=2e-5)
    assert off < (0.08 if loa == 1 else 0.012)  # toes and spine can't do less with so few joints
    assert any(f"{off:.4f} m off" in x for x in lost)
    dropped = [n for n in (t.target for t in down.tracks) if n not in b.skeleton.index]
    assert dropped == []
    assert all(set(m.joints) <= set(b.skeleton.names) for m in down.motions)


def test_dropping_the_folded_motion_would_be_far_worse() -> None:
    h = walking(4, "tracks")
    bare, lost = converted(h, "2.0", loa=1)
    assert any("animation of" in x for x in lost)
    down, _, off = lowered(h, "2.0", loa=1)
    a, b = vt.pack(h), vt.pack(bare)
    places = joint_positions(a.skeleton, joint_matrices(a.skeleton, motion_of(h, a.skeleton)))
    found = joint_positions(b.skeleton, joint_matrices(b.skeleton, motion_of(bare, b.skeleton)))
    head = np.abs(places[:, a.skeleton.index["skullbase"]] - found[:, b.skeleton.index["skullbase"]]).max()
    assert head > 0.02  # which `lowered` places within a micrometre, see above


def chain(kind: str, *, own_skin: bool) -> Humanoid:
    """LOA 3 where only vl4, which LOA 2 lacks, turns; its skin is all that vl5 and vl4 have, or half of it."""
    h = default_body(3)
    points = np.random.default_rng(0).normal(0, 0.1, (40, 3)) + h.joint("vl4").center
    h.skin_coord = points
    h.skin = [Shape("belt", np.arange(39, dtype=np.int32).reshape(-1, 3))]
    half = np.arange(20, 40, dtype=np.int32) if own_skin else np.arange(40, dtype=np.int32)
    h.joint("vl4").skin_coord_index, h.joint("vl4").skin_coord_weight = half, np.ones(len(half))
    if own_skin:
        rest = np.arange(20, dtype=np.int32)
        h.joint("vl5").skin_coord_index, h.joint("vl5").skin_coord_weight = rest, np.ones(20)
    turns = np.array([[0.0, 0, 1, 0], [0, 0, 1, 0.7], [1, 0, 0, 0.5]])
    if kind == "tracks":
        h.tracks = [Track("vl4", "rotation", np.array([0, 0.5, 1]), turns, 1.0, False, "bow")]
        h.tracks.append(
            Track("vl5", "rotation", np.array([0, 1.0]), np.array([[0, 1, 0, 0], [0, 1.0, 0, 0.3]]), 1.0, False, "bow")
        )
    else:
        values = np.array([[0, 0, 0, 0.0], [40, 0, 0, 9], [0, 30, 0, 17]])
        h.motions = [MotionData("bow", ["vl4", "vl5"], [TURN["ZXY"], ("Yrotation",)], values, 0.5, True, False)]
    return h


@pytest.mark.parametrize("kind", ["tracks", "motion"])
def test_what_a_coarser_skeleton_can_express_is_kept(kind: str) -> None:
    """Where all the skin follows the folded joint, the kept one does exactly what the chain did."""
    h = chain(kind, own_skin=False)
    down, lost, off = lowered(h, "2.0", loa=2)
    assert off < 1e-9
    a, b = vt.pack(h), vt.pack(down)
    m, n = motion_of(h, a.skeleton), motion_of(down, b.skeleton)
    before, after = joint_matrices(a.skeleton, m), joint_matrices(b.skeleton, n)
    np.testing.assert_allclose(before[:, a.skeleton.index["vl4"]], after[:, b.skeleton.index["vl5"]], atol=1e-9)
    np.testing.assert_allclose(
        before[:, a.skeleton.index["skullbase"]], after[:, b.skeleton.index["skullbase"]], atol=1e-9
    )
    torn = chain(kind, own_skin=True)
    _, lost, off = lowered(torn, "2.0", loa=2)
    assert 0.005 < off < 0.1
    assert any("turns of 1 folded joints (vl4)" in x for x in lost)


def test_motion_on_a_skeleton() -> None:
    """Without skin the kept joint takes the turns of the chain; what hangs below stays exact."""
    fine, coarse = vt.pack(default_body(3)).skeleton, vt.pack(default_body(1)).skeleton
    rng = np.random.default_rng(3)
    q = np.tile([0, 0, 0, 1.0], (5, len(fine), 1))
    chained = [fine.index[n] for n in ("vl5", "vl4", "vt3", "vt1", "vc4", "l_sternoclavicular", "l_elbow")]
    q[:, chained] = from_vector(rng.normal(0, 0.3, (5, len(chained), 3)))
    motion = vt.Motion(fine, 30.0, q, rng.normal(0, 0.1, (5, 3)))
    down = lowered_motion(motion, coarse)
    before, after = joint_matrices(fine, motion), joint_matrices(coarse, down)
    for name in ("skullbase", "l_shoulder", "l_elbow", "r_radiocarpal", "l_talocrural"):
        np.testing.assert_allclose(before[:, fine.index[name]], after[:, coarse.index[name]], atol=1e-12, err_msg=name)
    product = q[:, fine.index["vl5"]]
    for name in ("vl4", "vt3", "vt1"):
        product = multiply(product, q[:, fine.index[name]])
    got = down.rotation[:, coarse.index["vl5"]]
    np.testing.assert_allclose(np.abs(np.sum(product * got, axis=1)), 1, atol=1e-12)


def test_untouched_tracks_keep_their_keys_and_rest_rotations_are_carried() -> None:
    h = typed(4)
    h.tracks.append(
        Track("vl4", "rotation", np.array([0, 1.0]), np.array([[1.0, 0, 0, 0], [1, 0, 0, 0.4]]), 2.0, True, "wave")
    )
    h.tracks.append(Track("blink_action", "weight", np.array([0, 1.0]), np.array([[0.0], [1.0]]), 2.0, True, "wave"))
    h.joint("vc3").rotation = np.array([0, 1.0, 0, 0.5])
    down, _, _ = lowered(h, "1.1")
    kept = {(t.target, t.field): t for t in down.tracks}
    assert kept["l_shoulder", "rotation"].keys is h.tracks[0].keys
    assert kept["HumanoidRoot", "translation"].values is h.tracks[1].values
    assert kept["blink_action", "weight"].values is h.tracks[3].values
    assert len(kept) == len(down.tracks)
    low, _, _ = lowered(replace(h, tracks=[]), "2.0", loa=2)
    a, b = vt.pack(h).skeleton, vt.pack(low).skeleton
    before, after = joint_matrices(a)[0], joint_matrices(b)[0]
    np.testing.assert_allclose(before[a.index["skullbase"]], after[b.index["skullbase"]], atol=1e-12)
    np.testing.assert_allclose(to_axis_angle(from_axis_angle(low.joint("vc4").rotation))[3], 0.5, atol=0.51)
    assert (h.joint("vc3").rotation == [0, 1, 0, 0.5]).all()


def test_displacers_of_folded_segments_keep_their_points() -> None:
    h = typed(4, skin=False)
    h.tracks = []
    for name, weight in (("l_talocrural", 0.5), ("l_talocalcaneonavicular", 0.75)):
        home = h.joint(name).segments[0]
        home.displacers = [Displacer(f"{name}_action", np.array([1, 3], np.int32), np.full((2, 3), 0.01), weight)]
    home = h.joint("l_talocalcaneonavicular").segments[0]
    home.shapes[0].transform = np.diag([2.0, 2, 2, 1])
    home.moments_of_inertia = np.eye(3).reshape(9)
    body = vt.pack(h)
    down, lost = converted(h, "2.0", loa=3)
    assert not any("displacers" in x for x in lost)
    low = vt.pack(down)
    places = lambda b: {  # noqa: E731
        m.name: (b.skin.rest[m.index].round(9).tolist(), m.offset.round(9).tolist(), m.weight) for m in b.skin.morphs
    }
    assert places(low) == places(body)
    assert len(low.skin.morphs) == 2
    merged = down.joint("l_talocrural").segments[0]
    count = sum(j.name not in {x.name for x in down.joints()} for j in h.joint("l_talocrural").walk())
    assert merged.mass > 1.5 * 2
    assert count > 1
    assert np.linalg.eigvalsh(merged.moments_of_inertia.reshape(3, 3)).min() >= 1  # parallel axes only add
