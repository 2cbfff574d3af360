"""The bytes between Python and the page."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capsules import capsule_body, capsule_clip, stride
from vitruvian.body.kinematics import joint_matrices
from vitruvian.errors import VitruvianError
from vitruvian.hanim import tables
from vitruvian.show.actors import actors_of, mesh_message
from vitruvian.show.explore import MAX_CAMERAS, group, levels
from vitruvian.show.wire import REQUESTS, Block, decode, encode, parse_request, quantise, quantise_normals
from vitruvian.stage.clip import Clip, Mesh


def test_a_message_comes_back_and_its_blocks_are_aligned():
    arrays = {
        "pose": np.arange(24, dtype=np.float32).reshape(2, 12),
        "odd": np.arange(5, dtype=np.uint8),
        "joint": np.arange(3, dtype=np.uint16),
        "empty": np.zeros((0, 3), np.float32),
    }
    message = encode("frame", {"seq": 7, "name": "é"}, [Block(k, v, "joe") for k, v in arrays.items()])
    header, back = decode(message)
    assert header["type"] == "frame" and header["seq"] == 7 and header["name"] == "é"
    assert all(b["offset"] % 8 == 0 for b in header["blocks"]) and len(message) % 8 == 0
    for key, array in arrays.items():
        assert back["joe", key].dtype == array.dtype
        np.testing.assert_array_equal(back["joe", key], array)


def test_quantised_positions_of_a_two_metre_box_are_within_16_micrometres():
    points = np.random.default_rng(1).uniform(-1, 1, (100_000, 3)) + [5, 1, -3]
    q, scale, origin = quantise(points)
    error = np.abs(np.array(origin) + q[:, :3] * (scale / 32767) - points).max()
    assert 5e-6 < error <= 1.6e-5


def test_quantised_normals_are_within_a_bit_more_than_half_a_degree():
    n = np.random.default_rng(2).normal(size=(100_000, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    back = quantise_normals(n)[:, :3].astype(float)
    back /= np.linalg.norm(back, axis=1, keepdims=True)
    assert np.degrees(np.arccos(np.clip((back * n).sum(axis=1), -1, 1))).max() <= 0.6


def test_positions_that_are_not_finite_are_refused_and_flat_or_empty_sets_are_not():
    with pytest.raises(VitruvianError, match="vertex 1"):
        quantise(np.array([[0, 0, 0], [0, np.nan, 0.0]]))
    assert quantise(np.zeros((3, 3)))[1] == 1e-9
    assert quantise(np.zeros((0, 3)))[0].shape == (0, 4)


def test_headers_do_not_carry_nan():
    with pytest.raises(ValueError):
        encode("frame", {"t": float("nan")})


@given(st.binary(max_size=200))
@settings(max_examples=200, deadline=None)
def test_bytes_that_are_no_message_are_refused_in_one_line(data):
    for message in (data, b"VTF1" + data):
        with pytest.raises(VitruvianError) as caught:
            decode(message)
        assert "\n" not in str(caught.value)


@given(st.integers(0, 400), st.integers(0, 255))
@settings(max_examples=200, deadline=None)
def test_a_damaged_message_is_refused_or_read(position, value):
    message = bytearray(encode("frame", {"seq": 1}, [Block("pose", np.ones((3, 12), np.float32), "a")]))
    message[position % len(message)] = value
    try:
        decode(bytes(message))
    except VitruvianError as error:
        assert "\n" not in str(error)


def test_requests_are_checked_field_by_field():
    good = {"type": "set_rotation", "actor": "a", "joint": "l_elbow", "rotation": [0, 0, 0, 1]}
    assert parse_request(json.dumps(good)) == good
    bad = [
        "",
        "[]",
        "{",
        "[" * 100_00,
        json.dumps({"type": "exec"}),
        json.dumps({"type": "seek"}),
        json.dumps({"type": "seek", "frame": 1, "more": 1}),
        json.dumps({"type": "seek", "frame": True}),
        json.dumps({"type": "seek", "frame": -1}),
        '{"type": "seek", "frame": NaN}',
        '{"type": "speed", "value": Infinity}',
        json.dumps({"type": "speed", "value": 5}),
        json.dumps({"type": "step", "frames": 1.5}),
        json.dumps({"type": "loop", "value": 1}),
        json.dumps(good | {"rotation": [0, 0, 0, 2]}),
        json.dumps(good | {"rotation": [0, 0, 0]}),
        json.dumps(good | {"joint": "x" * 300}),
        json.dumps({"type": "ack", "seq": "1"}),
        "x" * 70_000,
    ]
    for text in bad:
        with pytest.raises(VitruvianError) as caught:
            parse_request(text)
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


@given(st.recursive(st.none() | st.booleans() | st.floats() | st.text(max_size=9), lambda c: st.lists(c, max_size=4)))
@settings(max_examples=200, deadline=None)
def test_any_value_in_any_field_is_taken_or_refused(value):
    for kind, fields in REQUESTS.items():
        for name in fields:
            text = json.dumps({"type": kind, **dict.fromkeys(fields, 0), name: value})
            try:
                request = parse_request(text)
                assert set(request) == {"type", *fields}
            except VitruvianError:
                pass


def test_poses_of_a_clip_are_its_joint_matrices():
    clip = capsule_clip()
    (actor,) = actors_of([clip])
    matrices = joint_matrices(clip.body.skeleton, clip.motion)
    np.testing.assert_allclose(actor.poses.reshape(36, -1, 3, 4), matrices[:, :, :3], atol=1e-6)
    np.testing.assert_allclose(actor.travel, [0, 0, 1.3], atol=0.02)


def test_the_mesh_message_holds_all_influences_and_names():
    clip = capsule_clip(joints=60)
    (actor,) = actors_of([clip])
    header, arrays = decode(mesh_message(actor))
    name = header["actor"]
    np.testing.assert_array_equal(arrays[name, "row"], clip.body.skin.weights.row)
    np.testing.assert_allclose(arrays[name, "weight"], clip.body.skin.weights.weight, rtol=1e-6)
    assert header["joints"] == list(clip.body.skeleton.names) and len(header["joints"]) == 60
    assert [d["name"] for d in header["displacers"]] == ["chin_action", "grow_action"]
    assert np.isnan(arrays[name, "limits"]).any() and arrays[name, "limits"].shape == (60, 3, 2)


def test_several_things_get_names_that_differ_and_nothing_is_refused():
    mesh = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    body = capsule_body()
    names = [a.name for a in actors_of([Clip(capsule_clip().humanoid, body, stride(body)), body, mesh, mesh])]
    assert names == ["capsules", "capsules 2", "object", "object 2"]
    with pytest.raises(VitruvianError, match="found nothing"):
        actors_of([])
    with pytest.raises(VitruvianError, match="found int"):
        actors_of([3])


def test_openness_of_a_box_on_a_floor_and_of_things_that_only_lie_near():
    from vitruvian.show.openness import openness

    x, z = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41))
    floor = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)
    quad = np.array([[i, i + 41, i + 1] for i in range(40 * 41) if i % 41 < 40])
    other = np.array([[i + 1, i + 41, i + 42] for i in range(40 * 41) if i % 41 < 40])
    lid = np.array([[-0.2, 0.02, -0.2], [0.2, 0.02, -0.2], [0.2, 0.02, 0.2], [-0.2, 0.02, 0.2]])
    n = len(floor)
    points = np.concatenate([floor, lid])
    triangles = np.concatenate([quad, other, [[n, n + 1, n + 2], [n, n + 2, n + 3]]]).astype(np.int32)
    open_ = openness(points, triangles)[:n].reshape(41, 41)
    assert open_[20, 20] < 0.35 and open_[2, 2] > 0.99 and open_[0, 40] > 0.99
    owner = np.r_[np.zeros(n), np.ones(4)].astype(np.int32)
    apart = np.array([[0.0, 2.0], [2.0, 0.0]])
    assert openness(points, triangles, owner, apart)[:n].min() > 0.99


def test_the_mesh_message_says_levels_names_kinds_and_groups_from_the_standard():
    clip = capsule_clip(joints=25)
    (actor,) = actors_of([clip])
    header, arrays = decode(mesh_message(actor))
    levels = dict(zip(header["joints"], header["loa"]))
    assert levels["humanoid_root"] == 0 and levels["l_wrist"] == 1 and levels["l_carpometacarpal_2"] == 2
    assert levels["extra_0"] == 0  # not in the tables: stays, as in `convert --loa`
    names = dict(zip(header["joints"], header["names"]))
    assert names["l_wrist"] == ["2.0", "l_radiocarpal"] and names["l_talocrural"] == ["1.x", "l_ankle"]
    assert names["extra_0"] is None and names["l_elbow"] == ["1.x", "l_elbow"]
    assert [s["kind"] for s in header["sites"]] == ["end effector", "end effector"]
    assert [d["group"] for d in header["displacers"]] == ["Mouth and jaw", "Other shapes"]
    assert arrays[actor.name, "stiffness"].shape == (25, 3) and header["cameras"] == []
    shown = arrays[actor.name, "limits"][header["joints"].index("l_elbow")]
    np.testing.assert_allclose(shown, [[-2.6, 0], [-1, 1], [-0.1, 0.1]], atol=1e-6)


def test_levels_of_the_page_are_those_of_the_tables():
    for level, count in enumerate(tables.LOA_COUNTS):
        names = list(tables.joints())
        parents = [names.index(j.parent) if j.parent else -1 for j in tables.joints().values()]
        assert sum(at <= level for at in levels(names, parents)) == count
    assert levels(["l_wrist", "l_index1"], [-1, 0]) == [0, 2]  # a root stays


def test_limits_that_bound_nothing_are_sent_as_free():
    body = capsule_body()
    limits = np.full((21, 3, 2), np.nan)
    limits[1] = [[0, 0], [1, -1], [-1, 1]]
    limits[2] = [[np.nan, 1], [-np.inf, np.inf], [-0.5, 0.5]]
    (actor,) = actors_of([replace(body, skeleton=replace(body.skeleton, limits=limits))])
    _, arrays = decode(mesh_message(actor))
    sent = arrays[actor.name, "limits"]
    assert np.isnan(sent[1:3, :2]).all() and sent[1:3, 2].tolist() == [[-1, 1], [-0.5, 0.5]]


@pytest.mark.parametrize(
    "name, expected",
    [("l_eyebrow_raiser_action", "Brows"), ("eyeBlinkLeft", "Eyes"), ("r_eye_wide_action", "Eyes"),
     ("l_cheek_squint_action", "Cheeks and nose"), ("mouthSmileLeft", "Mouth and jaw"),
     ("jaw_open_action", "Mouth and jaw"), ("l_upper_eyelid_config", "Eyes"), ("viseme_aa", "Mouth and jaw"),
     ("fear_config", "Expressions"), ("skull_tip_raiser_action", "Other parts of the face"),
     ("biceps_bulge", "Other shapes"), ("", "Other shapes"), ("<script>", "Other shapes"), ("year", "Other shapes")],
)  # fmt: skip
def test_displacers_are_grouped_by_what_they_move(name, expected):
    assert group(name) == expected


def test_cameras_of_hostile_files_are_finite_and_few():
    from scene_figure import GOOD
    from vitruvian.formats.x3d import parse_x3d
    from vitruvian.hanim.view import humanoids

    deep = "<Transform>" * 300 + "<Viewpoint/>" + "</Transform>" * 300
    inside = [
        '<Viewpoint orientation="nan nan 0 1" position="1e39 0 0" fieldOfView="-5"/>',
        '<Viewpoint orientation="0 0 0 7" position="1 2" fieldOfView="inf"/>',
        '<Transform scale="0 0 0" rotation="0 1 0 1e300"><Viewpoint/></Transform>',
        '<Transform translation="1e300 0 0"><Transform translation="1e300 0 0"><Viewpoint/></Transform></Transform>',
        deep,
        "",
    ]
    sites = "".join(f'<HAnimSite DEF="s{i}_view" name="s{i}_view">{x}</HAnimSite>' for i, x in enumerate(inside))
    sites += "".join(f'<HAnimSite DEF="t{i}_view" name="t{i}_view"><Viewpoint/></HAnimSite>' for i in range(200))
    text = GOOD.replace('<HAnimSegment DEF="hanim_sacrum" ', sites + '<HAnimSegment DEF="hanim_sacrum" ', 1)
    (humanoid,) = humanoids(parse_x3d(text.encode(), "tin.x3d"))
    (actor,) = actors_of([humanoid])
    header, _ = decode(mesh_message(actor))
    found = header["cameras"]
    assert len(found) == MAX_CAMERAS
    for camera in found:
        assert np.isfinite([*camera["eye"], *camera["look"]]).all() and 0.1 <= camera["fov"] <= 2.6
        assert abs(np.linalg.norm(camera["look"]) - 1) < 1e-6


def test_findings_are_cut_to_what_a_page_can_list():
    from vitruvian.show.live import LONGEST, finding_fields
    from vitruvian.show.server import MAX_FINDINGS, Showing

    finding = finding_fields({"rule": "x" * 10_000, "where": object(), "line": 3, "severity": None, "other": 1})
    assert len(finding["rule"]) == LONGEST and finding["line"] == 3 and set(finding) == {"rule", "where", "line"}
    showing = Showing(actors_of([capsule_body(vertices=300)]), [finding] * (MAX_FINDINGS + 5))
    header, _ = decode(showing.hello())
    assert len(header["findings"]) == MAX_FINDINGS and header["found"] == MAX_FINDINGS + 5
