"""Editing skin weights: brushes, smoothing, mirroring, pruning, weights from bones, files."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import vitruvian as vt
from small_body import figure, tube
from test_cli import run
from vitruvian.body.types import Body, Skeleton, Skin, Weights
from vitruvian.errors import FileError, VitruvianError
from vitruvian.modeling.attaching import weights_from_bones
from vitruvian.modeling.weight_files import read_weights, save_weights, stored
from vitruvian.modeling.weights import MODES, falloff, flood, mirrored, normalised, paint, pruned, reach, smooth, table
from vitruvian.stage.clip import Mesh


def rows(body: Body) -> np.ndarray:
    return table(body.skin.weights, len(body.skeleton)).toarray()


def limbs(gap: float = 0.03) -> Body:
    """Two tubes side by side, nearer to each other than a brush is wide, each on its own joint."""
    parts = [tube([x, 0, 0], [x, 1, 0], 0.05, 40, 24) for x in (0.05 + gap / 2, -0.05 - gap / 2)]
    count = len(parts[0][0])
    rest = np.concatenate([p for p, _ in parts])
    triangles = np.concatenate([parts[0][1], parts[1][1][:, ::-1] + count])
    rest[count:] = rest[:count] * [-1, 1, 1]
    triangles[len(parts[0][1]) :] = parts[0][1][:, ::-1] + count
    names = ("humanoid_root", "l_hip", "r_hip", "l_knee", "r_knee")
    x = 0.05 + gap / 2
    centers = [[0, 1.1, 0], [x, 1, 0], [-x, 1, 0], [x, 0.5, 0], [-x, 0.5, 0]]
    skeleton = Skeleton(names, [-1, 0, 0, 1, 2], centers, site_names=("l_toe", "r_toe"), site_joints=[3, 4],
                        site_points=[[x, 0, 0], [-x, 0, 0]])  # fmt: skip
    joint = np.where(np.arange(2 * count) < count, 1, 2) + np.where(rest[:, 1] < 0.5, 2, 0)
    weights = Weights.from_pairs(2 * count, np.arange(2 * count), joint, np.ones(2 * count))
    return Body("limbs", skeleton, Skin(rest, triangles, weights))


def test_a_brush_reaches_along_the_surface_and_not_across_a_gap() -> None:
    body = limbs()
    half = len(body.skin.rest) // 2
    inner = [body.skin.rest[:half, 0].min(), 0.5, 0]
    vertices, distance = reach(body, inner, 0.09)
    assert len(vertices) > 50 and vertices.max() < half  # the other limb is 30 mm away
    straight = np.linalg.norm(body.skin.rest[vertices] - inner, axis=1)
    assert (distance >= straight - 1e-9).all() and distance.max() <= 0.09
    x, y, z = (body.skin.rest[vertices] - [body.skeleton.centers[1, 0], 0.5, 0]).T
    true = np.hypot(0.05 * np.abs(np.arctan2(z, -x)), y)  # on the unrolled cylinder
    print(f"ways over the surface are at most {np.max(distance / np.maximum(true, 0.02)):.3f} times as long")
    assert np.max(distance / np.maximum(true, 0.02)) < 1.36
    assert falloff(np.array([0, 0.5, 1, 2]), 1.0).tolist() == [1, 0.5625, 0, 0]


@pytest.mark.parametrize("mode", MODES)
def test_sums_stay_and_only_the_brush_changes(mode) -> None:
    body = figure(deficit=True)
    at = body.skeleton.centers[4] + [0, 0.05, 0]
    out = paint(body, "l_elbow", at, radius=0.12, strength=0.6, mode=mode)
    before, after = rows(body), rows(out)
    near, distance = reach(body, at, 0.12)
    away = np.ones(len(before), bool)
    away[near] = False
    np.testing.assert_array_equal(before[away], after[away])
    np.testing.assert_allclose(after.sum(axis=1), before.sum(axis=1), atol=1e-6)
    change = (after - before)[:, 4]
    assert np.abs(change).max() > 0.03
    if mode in ("add", "subtract"):
        sums = before.sum(axis=1)[near]
        wanted = np.clip(before[near, 4] / sums + (0.6 if mode == "add" else -0.6) * falloff(distance, 0.12), 0, 1)
        np.testing.assert_allclose(after[near, 4], wanted * sums, atol=1e-6)
    if mode == "replace":
        nearest = near[np.argmin(distance)]
        assert abs(after[nearest, 4] / after[nearest].sum() - 0.6) < 0.1
    np.testing.assert_array_equal(rows(body), before)  # pure


def test_what_is_taken_from_the_only_joint_goes_to_its_parent_and_roots_keep_theirs() -> None:
    body = limbs()
    at = [body.skin.rest[:, 0].max(), 0.25, 0]
    out = paint(body, "l_knee", at, radius=0.05, strength=1, mode="subtract")
    changed = np.flatnonzero((rows(out) != rows(body)).any(axis=1))
    assert len(changed) > 5
    np.testing.assert_allclose(rows(out)[changed][:, [1, 3]].sum(axis=1), 1, atol=1e-6)
    alone = flood(body, "humanoid_root", 1.0)
    np.testing.assert_array_equal(rows(flood(alone, "humanoid_root", 0.2)), rows(alone))


def test_vertices_without_weights_get_the_joint_of_the_brush() -> None:
    body = limbs()
    bare = Body(
        "bare",
        body.skeleton,
        Skin(body.skin.rest, body.skin.triangles, Weights.from_pairs(len(body.skin.rest), [], [], [])),
    )
    out = rows(paint(bare, "l_hip", [0.115, 0.7, 0], radius=0.05, strength=0.3))
    assert set(np.unique(out)) == {0.0, 1.0} and (out[:, 1] == 1).sum() > 5
    for mode in ("subtract", "smooth"):
        assert not rows(paint(bare, "l_hip", [0.115, 0.7, 0], radius=0.05, mode=mode)).any()


def test_smoothing_evens_a_border_and_converges_on_constants() -> None:
    body = limbs()
    out = smooth(body, rounds=10)
    before, after = rows(body), rows(out)
    np.testing.assert_allclose(after.sum(axis=1), 1, atol=1e-6)
    edges = body.skin.triangles[:, [0, 1]]
    jump = lambda r: np.abs(r[edges[:, 0]] - r[edges[:, 1]]).max()  # noqa: E731
    assert jump(before) == 1 and jump(after) < 0.35
    half = len(before) // 2
    assert not after[:half, [2, 4]].any()  # nothing leaks to the other limb
    constant = flood(body, "l_hip", 1.0)
    np.testing.assert_allclose(rows(smooth(constant)), rows(constant), atol=1e-12)
    some = np.arange(0, half, 3)
    others = np.setdiff1d(np.arange(len(before)), some)
    np.testing.assert_array_equal(rows(smooth(body, vertices=some))[others], before[others])


def test_mirroring_makes_both_sides_the_same_and_says_what_has_no_mate() -> None:
    body = paint(limbs(), "l_knee", [0.115, 0.55, 0.0], radius=0.1, strength=0.5)
    out = mirrored(body)
    half, swap = len(body.skin.rest) // 2, [0, 2, 1, 4, 3]
    np.testing.assert_array_equal(rows(out)[:half], rows(body)[:half])
    np.testing.assert_allclose(rows(out)[half:][:, swap], rows(body)[:half], atol=1e-12)
    back = mirrored(out, side="right")
    np.testing.assert_allclose(rows(back), rows(out), atol=1e-12)
    moved = body.skin.rest.copy()
    moved[half] += [0.5, 0, 0]
    odd = Body("odd", body.skeleton, Skin(moved, body.skin.triangles, body.skin.weights))
    with pytest.warns(vt.VitruvianWarning, match="no mate"):
        mirrored(odd, side="right")


def test_pruning_keeps_the_largest_and_reports_what_went() -> None:
    body = vt.pack(vt.person(outfit=None, hair="none"))
    out, gone = pruned(body, most=4)
    before, after = rows(body), rows(out)
    assert out.skin.weights.counts.max() == 4
    np.testing.assert_allclose(after.sum(axis=1), before.sum(axis=1), atol=1e-9)
    lost = np.where(after > 0, 0, before).sum(axis=1) / before.sum(axis=1)
    assert gone == pytest.approx(lost.max(), abs=1e-9) and 0.05 < gone < 0.6
    assert np.array_equal(before.argmax(axis=1), after.argmax(axis=1))
    assert pruned(body, least=0)[1] < 1e-12
    half = Weights(body.skin.weights.row, body.skin.weights.joint, body.skin.weights.weight * 0.5)
    again = normalised(Body("half", body.skeleton, Skin(body.skin.rest, body.skin.triangles, half)))
    np.testing.assert_allclose(again.skin.weights.sums, 1, atol=1e-12)


def test_weights_from_bones_follow_the_nearest_bone_that_is_seen() -> None:
    body = limbs()
    w = rows(Body("new", body.skeleton, Skin(body.skin.rest, body.skin.triangles,
             weights_from_bones(body.skeleton, Mesh(body.skin.rest, body.skin.triangles)))))  # fmt: skip
    np.testing.assert_allclose(w.sum(axis=1), 1, atol=1e-9)
    half = len(w) // 2
    assert w[:half, [2, 4]].max(initial=0) < 1e-9 and w[half:, [1, 3]].max(initial=0) < 1e-9
    y = body.skin.rest[:half, 1]
    assert w[:half][(y > 0.65) & (y < 0.85), 1].min() > 0.9 and w[:half][y < 0.35, 3].min() > 0.9
    middle = w[:half][np.abs(y - 0.5) < 0.02]
    assert middle[:, 1].min() > 0.2 and middle[:, 1].max() < 0.8  # it changes smoothly at the knee
    with pytest.raises(VitruvianError, match="triangles"):
        weights_from_bones(body.skeleton, Mesh(body.skin.rest, np.zeros((0, 3), np.int32)))


def test_bones_of_the_person_give_weights_that_bend_it() -> None:
    humanoid = vt.person(loa=1, outfit=None, hair="none")
    body = vt.pack(humanoid)
    made = weights_from_bones(body.skeleton, Mesh(body.skin.rest, body.skin.triangles))
    error = np.abs(table(made, len(body.skeleton)).toarray() - rows(body)).sum(axis=1) / 2
    print(
        f"half the L1 distance to the person's own weights: mean {error.mean():.3f}, p95 {np.quantile(error, 0.95):.3f}"
    )
    assert error.mean() < 0.3
    index, x = body.skeleton.index, body.skin.rest[:, 0]
    arm = table(made, len(body.skeleton)).toarray()[:, [index["l_elbow"], index["l_radiocarpal"]]].sum(axis=1)
    assert arm[x < 0].max() < 0.02  # nothing of the left arm on the right side


@pytest.mark.parametrize("ending", ["csv", "npz"])
def test_files_round_trip_and_go_into_a_humanoid(ending, tmp_path) -> None:
    humanoid = vt.person(loa=1, outfit=None, hair="none")
    body = paint(vt.pack(humanoid), "l_elbow", vt.pack(humanoid).skeleton.centers[3], radius=0.1)
    save_weights(body, tmp_path / f"w.{ending}")
    found = read_weights(tmp_path / f"w.{ending}", body)
    np.testing.assert_array_equal(found.weight, body.skin.weights.weight)
    np.testing.assert_array_equal(found.joint, body.skin.weights.joint)
    again = vt.pack(stored(humanoid, found))
    np.testing.assert_array_equal(again.skin.weights.weight, found.weight)
    with pytest.raises(VitruvianError, match="expected .* vertices"):
        stored(vt.person(loa=1), found)


BAD = [
    ("joint,vertex,weight\n", "header"),
    ("vertex,joint,weight\n1,l_hip\n", ":2: .*2 fields"),
    ("vertex,joint,weight\n\n99999,l_hip,1\n", ":3: vertex 99999"),
    ("vertex,joint,weight\n-1,l_hip,1\n", "vertex -1"),
    ("vertex,joint,weight\n0,l_toe,1\n", "l_toe"),
    ("vertex,joint,weight\n0,l_hip,-1\n", "0 or more"),
    ("vertex,joint,weight\n0,l_hip,nan\n", "0 or more"),
    ("vertex,joint,weight\nx,l_hip,1\n", "whole number"),
    ("", "header"),
]


@pytest.mark.parametrize(("text", "said"), BAD)
def test_bad_files_are_refused_in_one_line(text, said, tmp_path) -> None:
    (tmp_path / "w.csv").write_text(text)
    with pytest.raises(FileError, match=said) as caught:
        read_weights(tmp_path / "w.csv", limbs())
    assert "\n" not in str(caught.value)


@given(st.binary(max_size=300))
@settings(max_examples=60, deadline=None)
def test_any_bytes_are_weights_or_refused(data) -> None:
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        for name in ("w.csv", "w.npz"):
            path = Path(folder) / name
            path.write_bytes(b"vertex,joint,weight\n" * (name == "w.csv") + data)
            try:
                assert len(read_weights(path, limbs())) == len(limbs().skin.rest)
            except FileError as error:
                assert "\n" not in str(error)


def test_an_archive_with_other_things_is_refused(tmp_path) -> None:
    body, w = limbs(), limbs().skin.weights
    good = {"row": w.row, "joint": w.joint, "weight": w.weight, "names": np.array(body.skeleton.names)}
    changes = [{"row": w.row[:-1]}, {"joint": w.joint + 90}, {"weight": w.weight * np.nan}, {"names": np.array(["x"] * 5)},
               {"row": w.row * 1.0}, {"joint": np.array([object()] * 3)}, {"row": w.row[::-1].copy()}]  # fmt: skip
    for change in changes:
        np.savez(tmp_path / "w.npz", **(good | change))
        with pytest.raises(FileError):
            read_weights(tmp_path / "w.npz", body)


def test_requests_that_make_no_sense() -> None:
    body = limbs()
    for call in (
        lambda: paint(body, "l_kne", [0, 0, 0]),
        lambda: paint(body, "l_knee", [0, 0, np.nan]),
        lambda: paint(body, "l_knee", [0, 0, 0], radius=0),
        lambda: paint(body, "l_knee", [0, 0, 0], strength=2),
        lambda: paint(body, "l_knee", [0, 0, 0], mode="erase"),
        lambda: flood(body, "l_knee", 0.5, vertices=[10**6]),
        lambda: smooth(body, rounds=0),
        lambda: mirrored(body, side="up"),
        lambda: pruned(body, most=0),
    ):
        with pytest.raises(VitruvianError) as caught:
            call()
        assert "\n" not in str(caught.value)


def test_convert_puts_weights_into_a_body(tmp_path) -> None:
    humanoid = vt.person(loa=1, outfit=None, hair="none")
    vt.save(humanoid, tmp_path / "a.x3d")
    body = vt.pack(vt.load(tmp_path / "a.x3d"))
    changed = flood(body, "l_elbow", 0.5, vertices=np.arange(50))
    save_weights(changed, tmp_path / "w.csv")
    options = (tmp_path / "a.x3d", tmp_path / "b.x3d", "--weights", tmp_path / "w.csv", "--json")
    assert json.loads(run("convert", *options).stdout)["lost"] == []
    np.testing.assert_allclose(rows(vt.pack(vt.load(tmp_path / "b.x3d"))), rows(changed), atol=1e-5)
    (tmp_path / "w.csv").write_text("nonsense")
    failed = run("convert", *options)
    assert failed.returncode == 2
    assert [line.split(":")[0] for line in failed.stderr.splitlines()] == ["error"]
