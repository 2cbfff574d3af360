"""Handles and drags: what they reach and leave alone, limits, pins; what a stage and a page's server make of them."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import vitruvian as vt
from capsules import capsule_clip
from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.rotations import from_vector
from vitruvian.body.types import Skeleton
from vitruvian.errors import VitruvianError
from vitruvian.motion.dragging import Drag, Dragged, Handle, handles
from vitruvian.motion.limits import beyond
from vitruvian.show.actors import actors_of
from vitruvian.show.explore import levels
from vitruvian.show.showing import Showing
from vitruvian.show.wire import decode, parse_request
from vitruvian.stage.stage import Stage

MM = 1e-3


@pytest.fixture(scope="module")
def person() -> Skeleton:
    return vt.pack(vt.person(outfit=None, hair="none")).skeleton


def at(skeleton: Skeleton, found: Dragged, handle: Handle) -> np.ndarray:
    """Where a handle is in a pose."""
    m = pose_matrices(replace(skeleton, binding=None), found.rotation[None], skeleton.translation[None],
                      root=found.shift[None])[0, handle.joint]  # fmt: skip
    return m[:3, :3] @ handle.point + m[:3, 3]


def standing(skeleton: Skeleton) -> Dragged:
    return Dragged(skeleton.rotation, skeleton.translation[0], np.zeros(0))


def drag(skeleton: Skeleton, *names: str, **options) -> Drag:
    return Drag(skeleton, skeleton.rotation, skeleton.translation[0], names, **options)


def test_hands_feet_head_and_pelvis_have_handles_and_so_do_fingertips(person):
    found = {h.name: h for h in handles(person)}
    assert list(found)[:6] == ["l_hand", "r_hand", "l_foot", "r_foot", "head", "pelvis"]
    assert [h.main for h in found.values()].count(True) == 6
    tips = [n for n in person.site_names if n.endswith("_tip") and n != "skull_tip"]
    assert sorted(n for n, h in found.items() if not h.main) == sorted(tips) and len(tips) == 20
    names = lambda n: {person.names[j] for j in found[n].moves}  # noqa: E731
    assert {"l_elbow", "l_shoulder"} < names("l_hand") and not any("radiocarpal" in n for n in names("l_hand"))
    assert {"vl3", "vc2", "skullbase"} < names("head") and names("l_foot") == {"l_hip", "l_knee", "l_talocrural"}
    assert all(n.startswith("l_") and "radiocarpal" not in n for n in names("l_carpal_distal_phalanx_2_tip"))
    legs = Skeleton(("humanoid_root", "l_hip", "l_knee"), [-1, 0, 1], [[0, 1, 0], [0.1, 0.9, 0], [0.1, 0.5, 0]])
    assert [(h.name, h.joint) for h in handles(legs)] == [("l_foot", 2), ("pelvis", 0)]


@pytest.mark.parametrize(
    ("name", "way"),
    [("l_hand", (0.15, 0.3, 0.2)), ("r_foot", (-0.05, 0.3, 0.15)), ("head", (0.1, -0.1, 0.1)),
     ("pelvis", (0.05, -0.1, 0.05)), ("l_carpal_distal_phalanx_2_tip", (0, 0.01, 0.02))],
)  # fmt: skip
def test_a_handle_comes_to_its_place_within_limits_and_nothing_else_moves(person, both, name, way):
    found = drag(person, name)
    handle = next(h for h in handles(person) if h.name == name)
    start = at(person, standing(person), handle)
    for part in (0.3, 0.6, 1.0):
        end = found.to({name: start + part * np.array(way)})
        missing = np.linalg.norm(at(person, end, handle) - start - part * np.array(way))
        assert abs(missing - end.residual[0]) < 1e-6 and missing < 2 * MM, (part, missing)
        assert np.abs(beyond(person, end.rotation)).max() < 1e-9
    still = np.setdiff1d(np.arange(len(person)), found.moving)
    np.testing.assert_array_equal(end.rotation[still], person.rotation[still])
    assert np.array_equal(end.shift, person.translation[0]) == (name != "pelvis")


def test_the_way_matters_little_and_coming_back_is_coming_home(person):
    there = np.array([0.45, 1.2, 0.25])
    at_once = drag(person, "l_hand").to({"l_hand": there})
    slowly, handle = drag(person, "l_hand"), next(h for h in handles(person) if h.name == "l_hand")
    start = at(person, standing(person), handle)
    for part in np.linspace(0.02, 1, 50):
        by_steps = slowly.to({"l_hand": start + part * (there - start) + 0.1 * np.sin(np.pi * part)})
    angle = 2 * np.arccos(np.clip(np.abs((at_once.rotation * by_steps.rotation).sum(axis=1)), 0, 1))
    assert np.degrees(angle).max() < 4
    for part in np.linspace(1, 0, 50):
        home = slowly.to({"l_hand": start + part * (there - start)})
    assert np.degrees(2 * np.arccos(np.clip(np.abs(home.rotation[:, 3]), 0, 1))).max() < 3


def test_steps_are_smooth_while_a_hand_circles(person):
    handle = next(h for h in handles(person) if h.name == "l_hand")
    start, found, before = at(person, standing(person), handle), drag(person, "l_hand"), person.rotation
    worst = 0.0
    for a in np.linspace(0, 2 * np.pi, 200):
        now = found.to({"l_hand": start + 0.2 * np.array([np.sin(a), 1 - np.cos(a), 0.5 * np.sin(2 * a) + 0.3])})
        step = 2 * np.arccos(np.clip(np.abs((now.rotation * before).sum(axis=1)), 0, 1)).max()
        worst, before = max(worst, step) if a else worst, now.rotation
    assert np.degrees(worst) < 30, np.degrees(worst)  # a free collar bone jumped by 168


def test_out_of_reach_an_arm_points_at_the_place(person):
    handle = next(h for h in handles(person) if h.name == "r_hand")
    far = np.array([-2.0, 1.3, 0.6])
    end = drag(person, "r_hand").to({"r_hand": far})
    joints = {n: at(person, end, Handle(n, person.index[n], person.centers[person.index[n]], handle.moves))
              for n in ("r_shoulder", "r_elbow", "r_radiocarpal")}  # fmt: skip
    reach = far - joints["r_shoulder"]
    assert np.dot(joints["r_radiocarpal"] - joints["r_shoulder"], reach) / np.linalg.norm(reach) > 0.98 * sum(
        np.linalg.norm(person.centers[person.index[a]] - person.centers[person.index[b]])
        for a, b in (("r_shoulder", "r_elbow"), ("r_elbow", "r_radiocarpal"))
    )
    assert abs(end.residual[0] - np.linalg.norm(far - joints["r_radiocarpal"])) < 1e-6 and end.residual[0] > 1


def test_feet_stay_where_the_pelvis_is_dragged_and_a_held_hand_does(person):
    table = {h.name: h for h in handles(person)}
    before = {n: at(person, standing(person), table[n]) for n in table}
    found = drag(person, "pelvis", "l_hand")
    goal = before["pelvis"] + [0.06, -0.15, 0.03]
    end = found.to({"pelvis": goal})
    assert np.linalg.norm(at(person, end, table["pelvis"]) - goal) < 10 * MM and found.shifts
    for name in ("l_hand", "l_foot", "r_foot"):
        assert np.linalg.norm(at(person, end, table[name]) - before[name]) < 1 * MM, name
    assert np.linalg.norm(at(person, end, table["r_hand"]) - before["r_hand"]) > 50 * MM  # which nobody holds
    knee = 2 * np.degrees(np.arccos(abs(end.rotation[person.index["l_knee"], 3])))
    assert knee > 30
    impossible = found.to({"pelvis": before["pelvis"] + [0, 0.5, 0]})
    assert impossible.residual[0] > 0.3  # the feet that are held win
    assert np.linalg.norm(at(person, impossible, table["l_foot"]) - before["l_foot"]) < 30 * MM


def test_what_cannot_be_is_refused(person):
    for names, what in ((["l_nose"], "l_hand, r_hand"), ([], "at least one")):
        with pytest.raises(VitruvianError, match=what):
            drag(person, *names)
    with pytest.raises(VitruvianError, match="l_hand: expected a place"):
        drag(person, "l_hand").to({"l_hand": np.array([np.nan, 0, 0])})
    with pytest.raises(VitruvianError, match="no joint"):
        drag(person, "l_hand", still=range(len(person)))
    stiff = replace(person, stiffness=np.ones((len(person), 3)))
    with pytest.raises(VitruvianError, match="no joint"):
        drag(stiff, "l_hand")


def test_bodies_in_centimetres_are_dragged_alike(person):
    big = replace(person, centers=100 * person.centers, site_points=100 * person.site_points)
    ends = []
    for body, unit in ((person, 1.0), (big, 100.0)):
        ends.append(drag(body, "l_hand").to({"l_hand": unit * np.array([0.4, 1.2, 0.3])}))
        assert ends[-1].residual[0] < MM * unit
    angle = 2 * np.arccos(np.clip(np.abs((ends[0].rotation * ends[1].rotation).sum(axis=1)), 0, 1))
    assert np.degrees(angle).max() < 0.5


NAMES = [
    "humanoid_root",
    "l_hip",
    "l_knee",
    "l_talocrural",
    "r_shoulder",
    "r_elbow",
    "skullbase",
    "vl5",
    "tail",
    "wing",
]


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_any_skeleton_can_be_dragged_anywhere(data):
    """Joints in any order, of no length, with limits that cross or fix them; places a kilometre off."""
    n = data.draw(st.integers(1, len(NAMES)))
    number = st.floats(-2, 2) | st.just(0.0)

    def draw(*shape: int) -> np.ndarray:
        size = int(np.prod(shape))
        return np.array(data.draw(st.lists(number, min_size=size, max_size=size))).reshape(shape)

    names = data.draw(st.permutations(NAMES))[:n]
    parents = [-1] + [data.draw(st.integers(-1, j - 1)) for j in range(1, n)]
    limits = np.where(draw(n, 3, 1) > 0, draw(n, 3, 2), np.nan)
    skeleton = Skeleton(
        tuple(names), parents, draw(n, 3), limits=limits, stiffness=np.clip(draw(n, 3), 0, 1),
        site_names=("a_tip", "b_tip"), site_joints=np.array([0, n - 1]), site_points=draw(2, 3),
    )  # fmt: skip
    for handle in handles(skeleton):
        try:
            found = drag(skeleton, handle.name, "pelvis")
        except VitruvianError as error:
            assert "may turn" in str(error)
            continue
        for place in (draw(3), 1000 * draw(3)):
            end = found.to({handle.name: place})
            assert np.isfinite(end.rotation).all() and np.isfinite(end.shift).all() and np.isfinite(end.residual).all()
            missing = np.linalg.norm(at(skeleton, end, handle) - place)
            np.testing.assert_allclose(end.residual[0], missing, atol=1e-6 * (1 + missing))


# On the stage and in the page's server


def test_a_shift_lies_on_top_of_the_motion_until_it_is_cleared():
    clip = capsule_clip(frames=20)
    stage, bare = Stage([clip]), Stage([clip])
    stage.send("shift", "capsules", value=[0.1, 0.2, -0.3])
    for n in (0, 7, 30):
        one, other = stage.step(n)["capsules"], bare.step(n)["capsules"]
        np.testing.assert_allclose(
            one.joints[:, :3, 3] - other.joints[:, :3, 3], [[0.1, 0.2, -0.3]] * len(one.joints), atol=1e-12
        )
        np.testing.assert_allclose(one.vertices, other.vertices + np.float32([0.1, 0.2, -0.3]), atol=1e-5)
        np.testing.assert_array_equal(one.shift, [0.1, 0.2, -0.3])
    stage.send("clear", "capsules")
    np.testing.assert_allclose(stage.step(0)["capsules"].joints, bare.step(0)["capsules"].joints)
    for bad in ([0, 1], [0, 0, np.inf], "far"):
        with pytest.raises(VitruvianError, match="event shift"):
            stage.send("shift", "capsules", value=bad)


def ask(showing: Showing, **fields) -> dict:
    """Send a request as a page does; the answer's header."""
    answer = showing.apply(parse_request(json.dumps(fields)))
    return {} if answer is None else decode(answer)[0]


def test_a_server_answers_drags_with_turns_that_its_stage_has_too():
    clip = capsule_clip(frames=30)
    showing = Showing(actors_of([clip]))
    header = decode(showing.meshes[0])[0]
    assert [h["name"] for h in header["handles"]] == ["l_hand", "r_hand", "l_foot", "r_foot", "head", "pelvis"]
    ask(showing, type="seek", frame=11)
    ask(showing, type="pause")
    before = showing.now()["capsules"]
    ask(showing, type="set_rotation", actor="capsules", joint="vt6", rotation=from_vector([0, 0.3, 0]).tolist())
    hand = next(h for h in header["handles"] if h["name"] == "l_hand")
    place = (np.array(hand["point"]) + [0.0, 0.25, 0.25]).tolist()
    drag = {
        "type": "reach",
        "actor": "capsules",
        "name": "l_hand",
        "places": {"l_hand": place},
        "gesture": 5,
        "level": 4,
    }
    told = ask(showing, **drag)
    assert set(told["turns"]) == {"l_shoulder", "l_elbow"} and told["shift"] is None and told["short"]["l_hand"] < MM
    posed = showing.now()["capsules"]
    m = posed.joints[hand["joint"]]
    np.testing.assert_allclose(m[:3, :3] @ hand["point"] + m[:3, 3], place, atol=1.1 * MM)
    _, blocks = decode(showing.frame(1))
    plain = before.joints[:, :3].reshape(-1, 12)
    np.testing.assert_allclose(blocks["capsules", "pose"], plain, atol=1e-6)  # pages put turns on by themselves
    down = header["handles"][-1]["point"]
    drag |= {"name": "pelvis", "places": {"l_hand": place, "pelvis": [down[0], down[1] - 0.1, down[2]]}, "gesture": 6}
    told = ask(showing, **drag)
    assert told["shift"][1] < -0.05
    np.testing.assert_allclose(showing.now()["capsules"].shift, told["shift"])
    _, blocks = decode(showing.frame(2))
    np.testing.assert_allclose(blocks["capsules", "pose"], plain, atol=1e-6)  # and the shift
    ask(showing, type="deformer", actor="capsules", name="volume")
    _, blocks = decode(showing.frame(3))
    posed = showing.now()["capsules"]
    np.testing.assert_allclose(blocks["capsules", "posed"], posed.joints[:, :3].reshape(-1, 12), atol=1e-6)
    ask(showing, type="set_pose", actor="capsules", turns={"vt6": from_vector([0, 0.3, 0]).tolist()}, shift=[0, 0, 0])
    back = showing.now()["capsules"]
    assert list(back.turns) == [clip.body.skeleton.index["vt6"]] and back.shift is None


def test_joints_above_the_level_that_a_page_shows_stay_still():
    humanoid = vt.person(outfit=None, hair="none")
    body = vt.pack(humanoid)
    showing = Showing(actors_of([vt.Clip(humanoid, body)]))
    header = decode(showing.meshes[0])[0]
    head = next(h for h in header["handles"] if h["name"] == "head")
    place = (np.array(head["point"]) + [0.05, -0.02, 0.05]).tolist()
    told = ask(showing, type="reach", actor="person", name="head", places={"head": place}, gesture=1, level=1)
    shown = {
        n for n, k in zip(body.skeleton.names, levels(body.skeleton.names, body.skeleton.parents.tolist())) if k <= 1
    }
    assert told["turns"] and set(told["turns"]) <= shown


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"name": "l_foot"}, "a place for the handle"),
        ({"places": {"l_hand": [0, 1]}}, "places"),
        ({"places": {"l_hand": [0, 1, float("nan")]}}, "places"),
        ({"name": "nose", "places": {"nose": [0, 1, 0]}}, "expected one of l_hand"),
        ({"gesture": -1}, "gesture"),
        ({"level": 5}, "level"),
        ({"actor": "nobody"}, "an actor with joints"),
        ({"type": "set_pose"}, "fields"),
    ],
)
def test_hostile_requests_are_refused_in_one_line(change, what):
    showing = Showing(actors_of([capsule_clip(frames=2)]))
    drag = {
        "type": "reach",
        "actor": "capsules",
        "name": "l_hand",
        "places": {"l_hand": [0, 1, 0]},
        "gesture": 5,
        "level": 4,
    }
    with pytest.raises(VitruvianError, match=what) as error:
        ask(showing, **(drag | change))
    assert "\n" not in str(error.value)
    good = {"type": "set_pose", "actor": "capsules", "turns": {}, "shift": [0, 0, 0]}
    for bad in (
        {"turns": {"vt6": [0, 0, 0, 2]}},
        {"turns": {"nobody": [0, 0, 0, 1]}},
        {"shift": [0, 0]},
        {"turns": []},
    ):
        with pytest.raises(VitruvianError, match="set_pose"):
            ask(showing, **(good | bad))


def test_a_saved_shift_is_read_by_the_command(tmp_path, capsys):
    from vitruvian.cli.files import pose

    vt.save(vt.person(loa=1, outfit=None, hair="none"), tmp_path / "body.x3d")
    given = {"l_knee": [1, 0, 0, 0.5], "humanoid_root.translation": [0.1, -0.2, 0.3]}
    (tmp_path / "pose.json").write_text(json.dumps(given))
    options = {"matrices": tmp_path / "m.json", "out": None, "name": None, "repair": False, "as_json": True}
    pose(tmp_path / "body.x3d", str(tmp_path / "pose.json"), **options)
    found = json.loads((tmp_path / "m.json").read_text())
    np.testing.assert_allclose(np.array(found["humanoid_root"])[:3, 3], [0.1, -0.2, 0.3], atol=1e-9)
    for bad, what in (
        ({"humanoid_root.translation": [0, 0, 0, 1]}, "metres"),
        ({"tail.translation": [0, 0, 0]}, "tail"),
    ):
        with pytest.raises(VitruvianError, match=what):
            pose(tmp_path / "body.x3d", json.dumps(bad), **options)
