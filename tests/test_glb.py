"""GLB: what a player computes from the file is what we compute, and the Khronos validator has nothing to say."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vitruvian as vt
from gltf_player import Player
from small_body import CENTERS, figure, wave
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.seams import split_seams
from vitruvian.body.types import Body, Skeleton, Skin, Weights
from vitruvian.errors import VitruvianError
from vitruvian.formats.glb import write_glb
from vitruvian.formats.gltf_skin import completed, limit, measure
from vitruvian.hanim.humanoid import Humanoid, Joint, Segment
from vitruvian.stage.clip import Clip, Mesh


def skinned(body: Body, matrices: np.ndarray, rest: np.ndarray | None = None) -> np.ndarray:
    """p' = p + sum w (M p - p), the plain loop over influences, in the world."""
    w, rest = body.skin.weights, body.skin.rest if rest is None else rest
    p = np.concatenate([rest, np.ones((len(rest), 1))], -1)
    moved = np.einsum("nab,nb->na", matrices[w.joint][:, :3], p[w.vertex]) - rest[w.vertex]
    out = rest.copy()
    np.add.at(out, w.vertex, w.weight[:, None] * moved)
    return out @ body.placement[:3, :3].T + body.placement[:3, 3]


def thin(body: Body) -> Body:
    """The same body with at most four influences."""
    joints, weights = body.skin.weights.top(4)
    weights = weights / weights.sum(axis=1, keepdims=True) * body.skin.weights.sums[:, None]
    n = len(joints)
    flat = Weights.from_pairs(n, np.repeat(np.arange(n), 4), joints.reshape(-1), weights.reshape(-1))
    return replace(body, skin=replace(body.skin, weights=flat, morphs=()))


def placed(body: Body) -> Body:
    place = np.eye(4)
    place[:3, :3] = 1.5 * np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    place[:3, 3] = 0.3, 0.1, -0.2
    return replace(body, placement=place)


@pytest.mark.parametrize("loop", [False, True])
@pytest.mark.parametrize("deficit", [False, True])
def test_player_shows_our_vertices(tmp_path: Path, deficit: bool, loop: bool) -> None:
    body = placed(thin(figure(deficit=deficit, spread=0.06)))
    motion = wave(body, loop=loop)
    report = write_glb(Clip(Humanoid("tester"), body, motion, "linear"), tmp_path / "a.glb")
    assert report["pruned_weights"] == 0 and report["max_vertex_error_m"] < 1e-5
    player = Player(tmp_path / "a.glb")
    source, _, _ = split_seams(body.skin)
    matrices = joint_matrices(body.skeleton, motion)
    for frame in (0, 3, 7, len(motion) - 1):
        ours = skinned(body, matrices[frame])[source]
        assert np.abs(player.vertices(frame / motion.fps) - ours).max() <= 1e-5
    if loop:  # the last key is the first pose again
        end = len(motion) / motion.fps
        turned = [player.locals(t)[0][player.named["l_elbow"]][:3, :3] for t in (0, end)]
        assert np.abs(turned[0] - turned[1]).max() < 1e-6


def test_joint_nodes_stand_at_moved_centres(tmp_path: Path) -> None:
    body = placed(figure())
    motion = wave(body)
    write_glb(Clip(Humanoid("tester"), body, motion, "linear"), tmp_path / "a.glb")
    player = Player(tmp_path / "a.glb")
    world, _ = player.worlds(5 / motion.fps)
    matrices = joint_matrices(body.skeleton, motion)[5]
    for j, name in enumerate(body.skeleton.names):
        expected = body.placement @ matrices[j] @ [*CENTERS[j], 1]
        assert np.abs(world[player.named[name]][:3, 3] - expected[:3]).max() < 1e-6
    tip = body.placement @ matrices[5] @ [*body.skeleton.site_points[0], 1]
    assert np.abs(world[player.named["l_hand_tip"]][:3, 3] - tip[:3]).max() < 1e-6


def test_scale_along_turned_axes_gets_a_helper_node(tmp_path: Path) -> None:
    body = thin(figure(spread=0.06))
    s = body.skeleton
    scale, turn = np.ones((6, 3)), np.tile([0.0, 0, 0, 1], (6, 1))
    scale[3], turn[3] = [1.0, 1.4, 0.8], [0, 0, np.sin(0.3), np.cos(0.3)]
    scale[4] = [1.2, 1.0, 0.9]
    skeleton = Skeleton(s.names, s.parents, s.centers, scale=scale, scale_orientation=turn)
    body = replace(body, skeleton=skeleton)
    motion = wave(body, loop=False)
    report = write_glb(Clip(Humanoid("tester"), body, motion, "linear"), tmp_path / "a.glb")
    assert any("l_shoulder" in sentence for sentence in report["lost"])
    player = Player(tmp_path / "a.glb")
    source, _, _ = split_seams(body.skin)
    matrices = joint_matrices(skeleton, motion)
    for frame in (0, 5):
        assert np.abs(player.vertices(frame / motion.fps) - skinned(body, matrices[frame])[source]).max() <= 1e-5


def test_binding_matrices_are_in_the_inverse_bind(tmp_path: Path) -> None:
    body = thin(figure(spread=0.06))
    binding = np.tile(np.eye(4), (6, 1, 1))
    binding[4, :3, 3] = 0.02, 0.01, -0.03
    body = replace(body, skeleton=replace(body.skeleton, binding=binding))
    write_glb(body, tmp_path / "a.glb")
    source, _, _ = split_seams(body.skin)
    ours = skinned(body, joint_matrices(body.skeleton)[0])[source]
    assert np.abs(Player(tmp_path / "a.glb").vertices(0) - ours).max() < 1e-5


def test_morphs_move_what_displacers_move(tmp_path: Path) -> None:
    body = replace(figure(spread=0.06), placement=np.eye(4))
    morphs = body.skin.morphs
    body = replace(thin(body), skin=replace(thin(body).skin, morphs=morphs))
    motion = wave(body, loop=False)
    write_glb(Clip(Humanoid("tester"), body, motion, "linear"), tmp_path / "a.glb")
    player = Player(tmp_path / "a.glb")
    assert player.json["meshes"][0]["extras"]["targetNames"] == ["smile_action", "chest_action"]
    rest = body.skin.rest.copy()
    rest[morphs[0].index] += motion.weights["smile_action"][4] * morphs[0].offset
    source, _, _ = split_seams(body.skin)
    ours = skinned(body, joint_matrices(body.skeleton, motion)[4], rest)[source]
    assert np.abs(player.vertices(4 / motion.fps) - ours).max() <= 1e-5


def chain(weights: list[list[float]], spread: float = 0.1) -> Body:
    """A chain of joints up the Y axis, one vertex beside the middle for each row of weights."""
    joints = len(weights[0])
    skeleton = Skeleton(
        tuple(f"j{k}" for k in range(joints)), np.arange(-1, joints - 1), [[0, 0.1 * k, 0] for k in range(joints)]
    )
    rows = [(v, j, w) for v, row in enumerate(weights) for j, w in enumerate(row) if w]
    rest = np.array([[spread, 0.05 * joints, 0.01 * v] for v in range(len(weights))])
    return Body(
        "chain", skeleton, Skin(rest, np.zeros((0, 3), np.int32), Weights.from_pairs(len(weights), *zip(*rows)))
    )


def test_pruning_gives_weight_to_joints_that_move_alike() -> None:
    """The fifth influence of a chain goes to its neighbour, and the vertex is nearer than with the largest four."""
    body = chain([[0.3, 0.09, 0.2, 0.21, 0.2], [0.3, 0.0, 0.2, 0.3, 0.2]])
    joints, kept, facts = limit(body, 4)
    assert facts["pruned_weights"] == 1 and facts["largest_dropped_weight"] == pytest.approx(0.09)
    assert np.abs(kept.sum(axis=1) - 1).max() < 1e-12 and kept.min() >= 0
    assert dict(zip(joints[1], kept[1].round(6))) == {0: 0.3, 2: 0.2, 3: 0.3, 4: 0.2}  # four: left as they are
    found = measure(body, None, joints, kept, "linear")["rms_vertex_error_m"]
    largest, cut = completed(body.skin.weights, 5).top(4)
    cut /= cut.sum(axis=1, keepdims=True)
    assert found < 0.9 * measure(body, None, largest, cut, "linear")["rms_vertex_error_m"]


def test_pruning_fits_the_motion_and_other_motions_too() -> None:
    body = vt.pack(vt.person(loa=4, hair="none"))
    own, other = vt.walk(body.skeleton), vt.idle(body.skeleton)
    joints, kept, _ = limit(body, 4, joint_matrices(body.skeleton, own))
    largest, cut = completed(body.skin.weights, len(body.skeleton)).top(4)
    cut /= cut.sum(axis=1, keepdims=True)
    for motion, better in ((own, 2), (other, 1.5)):
        now, before = (
            measure(body, motion, *w, "linear")["rms_vertex_error_m"] for w in ((joints, kept), (largest, cut))
        )
        print(f"largest four {1000 * before:.3f} mm, fitted {1000 * now:.3f} mm")
        assert better * now < before


def test_pruning_reports_the_error(tmp_path: Path) -> None:
    body = replace(figure(), skin=replace(figure().skin, morphs=()))
    motion = wave(body, loop=False)
    report = write_glb(Clip(Humanoid("tester"), body, motion, "linear"), tmp_path / "a.glb")
    player = Player(tmp_path / "a.glb")
    source, _, _ = split_seams(body.skin)
    matrices = joint_matrices(body.skeleton, motion)
    errors = [
        np.linalg.norm(player.vertices(f / motion.fps) - skinned(body, m)[source], axis=1)
        for f, m in enumerate(matrices)
    ]
    assert report["poses"] == 1 + len(motion) and report["pruned_weights"] > 0
    assert report["max_vertex_error_m"] == pytest.approx(np.max(errors), rel=1e-3)
    eight = write_glb(Clip(Humanoid("tester"), body, motion, "linear"), tmp_path / "b.glb", influences=8)
    assert eight["pruned_weights"] == 0 and eight["max_vertex_error_m"] < 1e-6


def test_missing_weight_goes_to_a_joint_that_stays() -> None:
    body = chain([[0.0, 0.25, 0, 0, 0, 0, 0], [0.5, 0.5, 0, 0, 0, 0, 0], [0.0] * 7])
    full = completed(body.skin.weights, 7)
    assert np.allclose(full.sums, 1)
    joints, kept, _ = limit(body, 4)
    assert joints[0, :2].tolist() == [7, 1] and np.allclose(kept[0, :2], [0.75, 0.25])
    assert joints[2, 0] == 7 and kept[2, 0] == 1


def test_difference_of_a_deformer_is_reported(tmp_path: Path) -> None:
    body = figure()
    report = write_glb(Clip(Humanoid("tester"), body, wave(body), "dual-quaternion"), tmp_path / "a.glb")
    assert report["deformer"] == "dual-quaternion" and 1e-4 < report["deformer_difference_m"] < 0.2


def test_colours_are_linear_and_coordinates_count_from_the_top(tmp_path: Path) -> None:
    body = figure()
    write_glb(body, tmp_path / "a.glb")
    player = Player(tmp_path / "a.glb")
    a = player.json["meshes"][0]["primitives"][0]["attributes"]
    assert np.abs(player.read(a["COLOR_0"])[0, :3] - [0.6038, 0.3185, 0.2140]).max() < 1e-3
    source, _, uv = split_seams(body.skin)
    assert uv is not None
    assert np.abs(player.read(a["TEXCOORD_0"])[:, 1] - (1 - uv[:, 1])).max() < 1e-6
    names = [m["name"] for m in player.json["materials"]]
    assert names == ["skin", "top"] and player.nodes[-1]["name"] == "body"
    assert "generator" in player.json["asset"] and player.nodes[player.named["l_elbow"]]["extras"]["hanim"]["llimit"]


def test_extras_hold_what_arrays_do_not(tmp_path: Path) -> None:
    from vitruvian.body.pack import pack

    root = Joint("humanoid_root", segments=[Segment("sacrum", mass=7.5, center_of_mass=np.array([0, 0.9, 0]))])
    humanoid = Humanoid("joe", loa=1, info={"age": "30"}, skeleton=[root])
    write_glb(Clip(humanoid, pack(humanoid)), tmp_path / "a.glb")
    player = Player(tmp_path / "a.glb")
    extras = player.nodes[player.named["joe"]]["extras"]["hanim"]
    assert extras["loa"] == 1 and extras["info"] == {"age": "30"}
    assert player.nodes[player.named["humanoid_root"]]["extras"]["hanim"]["segments"][0]["mass"] == 7.5


def test_mesh_and_refusals(tmp_path: Path) -> None:
    skin = figure().skin
    report = write_glb(Mesh(skin.rest * 100, skin.triangles, unit="cm"), tmp_path / "m.glb")
    assert report["triangles"] == len(skin.triangles)
    assert np.abs(Player(tmp_path / "m.glb").vertices(0) - skin.rest).max() < 1e-6
    with pytest.raises(VitruvianError, match="4 or 8"):
        write_glb(figure(), tmp_path / "x.glb", influences=3)
    with pytest.raises(VitruvianError, match="expected a Clip"):
        write_glb("joe", tmp_path / "x.glb")  # type: ignore[arg-type]
    with pytest.raises(VitruvianError, match="triangle"):
        write_glb(Mesh(skin.rest, np.zeros((2, 3))), tmp_path / "x.glb")
    assert not (tmp_path / "x.glb").exists()


def test_khronos_validator_finds_nothing(tmp_path: Path, referee: Path) -> None:
    body = figure(deficit=True)
    sheared = np.eye(4)
    sheared[:3, :3] = [[1, 0.3, 0], [0, 1.2, 0], [0.1, 0, 0.9]]
    things = {
        "clip": Clip(Humanoid("tester", info={"age": "3"}), placed(body), wave(body), "linear"),
        "body": figure(),
        "still": Clip(Humanoid("t"), replace(body, placement=sheared), wave(body, 1, loop=False), "linear"),
        "mesh": Mesh(body.skin.rest, body.skin.triangles, body.skin.uv, body.skin.colors),
        "bare": Mesh(body.skin.rest, body.skin.triangles),
    }
    files = []
    for name, thing in things.items():
        for influences in (4, 8):
            files.append(tmp_path / f"{name}{influences}.glb")
            write_glb(thing, files[-1], influences=influences)
    assert_clean(files, referee)


def assert_clean(files: list[Path], referee: Path) -> None:
    """The Khronos validator reports no error, warning or information about any of the files."""
    script = Path(__file__).with_name("referee_gltf.mjs")
    done = subprocess.run(
        [shutil.which("node") or "node", str(script), *map(str, files)], capture_output=True, text=True, timeout=60,
        env={**os.environ, "REFEREE": str(referee)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    reports = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(reports) == len(files)
    for report in reports:
        assert not report["errors"] and not report["warnings"] and not report["infos"], report


def humanoids_of(path: Path) -> list[Humanoid]:
    from vitruvian.formats.vrml import read_vrml
    from vitruvian.formats.x3d import read_x3d
    from vitruvian.hanim.view import humanoids

    return humanoids(read_x3d(path) if path.suffix == ".x3d" else read_vrml(path))


@pytest.mark.filterwarnings("ignore::vitruvian.errors.VitruvianWarning")
def test_real_figures_are_clean(tmp_path: Path, shared: Path, referee: Path) -> None:
    from vitruvian.body.pack import pack
    from vitruvian.motion.tracks import motion_of

    names = ("JoeKick.x3d", "JinLOA3.x3d", "NancyPrototypes.wrl", "DiamondManLOA2.x3d", "JinScaledV2L1LOA4Humanoid.x3d")
    files = []
    for name in names:
        humanoid = humanoids_of(shared / "data" / "hanim" / name)[0]
        body = pack(humanoid)
        files.append(tmp_path / f"{name}.glb")
        write_glb(Clip(humanoid, body, motion_of(humanoid, body.skeleton), "linear"), files[-1])
    assert_clean(files, referee)


@pytest.mark.filterwarnings("ignore::vitruvian.errors.VitruvianWarning")
def test_known_pose_of_a_real_figure(tmp_path: Path, shared: Path) -> None:
    """Places that browsers show (X_ITE, in humanoid space), reached through the file's own nodes and skin."""
    from vitruvian.body.pack import pack
    from vitruvian.motion.types import Motion

    humanoid = humanoids_of(shared / "data" / "hanim" / "JinNoAnimations_Fixed.x3d")[0]
    body = pack(humanoid)
    rotation = np.zeros((1, len(body.skeleton), 4))
    rotation[..., 3] = 1
    turns = (("l_shoulder", 2, np.pi / 2), ("l_elbow", 0, -1), ("l_hip", 0, -0.6), ("l_knee", 0, 0.8), ("vl5", 1, 0.3))
    for name, axis, angle in turns:
        joint = body.skeleton.index[name]
        rotation[0, joint, axis], rotation[0, joint, 3] = np.sin(angle / 2), np.cos(angle / 2)
    motion = Motion(body.skeleton, 30.0, rotation, np.zeros((1, 3)))
    write_glb(Clip(humanoid, replace(body, placement=np.eye(4)), motion, "linear"), tmp_path / "a.glb")
    player = Player(tmp_path / "a.glb")
    wrist = player.worlds(0)[0][player.named["l_radiocarpal"]][:3, 3]
    assert np.abs(wrist - [0.630893, 1.359540, 0.004170]).max() < 2e-6
    rest = player.read(player.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"])
    copies = np.flatnonzero(np.abs(rest - body.skin.rest[787]).max(axis=1) < 1e-6)
    assert np.abs(player.vertices(0)[copies] - [0.843202, 1.331000, 0.165058]).max() < 2e-5
