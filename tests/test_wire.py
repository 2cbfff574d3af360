"""The bytes between Python and the page."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capsules import capsule_body, capsule_clip, stride
from vitruvian.body.kinematics import joint_matrices
from vitruvian.errors import VitruvianError
from vitruvian.show.actors import actors_of, mesh_message, sample, turned
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


def test_poses_of_a_clip_are_its_joint_matrices_and_sampling_between_frames_is_in_proportion():
    clip = capsule_clip()
    (actor,) = actors_of([clip])
    matrices = joint_matrices(clip.body.skeleton, clip.motion)
    np.testing.assert_allclose(actor.poses.reshape(36, -1, 3, 4), matrices[:, :, :3], atol=1e-6)
    pose, _ = sample(actor, 4 / 30)
    np.testing.assert_array_equal(pose, actor.poses[4])
    pose, _ = sample(actor, 4.25 / 30)
    np.testing.assert_allclose(pose, 0.75 * actor.poses[4] + 0.25 * actor.poses[5], atol=1e-5)
    np.testing.assert_allclose(actor.travel, [0, 0, 1.3], atol=0.02)
    pose, _ = sample(actor, 35.5 / 30)  # between the last frame and the first of the next round
    first = actor.poses[0].copy()
    first[:, 3::4] += actor.travel.astype(np.float32)
    np.testing.assert_allclose(pose, (actor.poses[35] + first) / 2, atol=1e-5)


def test_extra_turns_are_what_forward_kinematics_gives_for_the_product_of_rotations():
    clip = capsule_clip()
    (actor,) = actors_of([clip])
    motion, skeleton = clip.motion, clip.body.skeleton
    angle = np.radians(40)
    extra = np.array([0, np.sin(angle / 2), 0, np.cos(angle / 2)])
    joint = skeleton.index["l_shoulder"]
    rotation = motion.rotation.copy()
    x1, y1, z1, w1 = extra
    x2, y2, z2, w2 = np.moveaxis(rotation[:, joint], -1, 0)
    rotation[:, joint] = np.stack(
        [
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        ],
        axis=-1,
    )
    wanted = joint_matrices(
        skeleton, type(motion)(skeleton, motion.fps, rotation, motion.translation)
    )[7, :, :3].reshape(-1, 12)  # fmt: skip
    np.testing.assert_allclose(turned(actor, actor.poses[7], {joint: extra}), wanted, atol=2e-6)


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
