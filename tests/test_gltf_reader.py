"""glTF in: our own files come back whole, foreign rigs move as players move them, surfaces as they were."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

import vitruvian as vt
from gltf_maker import BONES, Foreign, Maker, trs
from gltf_player import Player
from small_body import figure, wave
from test_glb import placed, skinned, thin
from vitruvian.body.kinematics import joint_matrices
from vitruvian.errors import FileError, VitruvianError, VitruvianWarning
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Segment, Shape, Site
from vitruvian.motion.tracks import motion_of

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
SIDES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
         [1, 5, 7], [1, 7, 3]]  # fmt: skip


def tree() -> Humanoid:
    """A humanoid with every field that GLB has no place for."""
    tip = Site("l_hand_tip", np.array([0.9, 1.4, 0]), np.array([0.01, 0, 0]), np.array([0, 0, 1, 0.3]))
    hand = Joint("l_radiocarpal", np.array([0.7, 1.4, 0]), sites=[Site("l_palm_pt", np.array([0.75, 1.4, 0.0]))])
    hand.segments = [
        Segment("l_carpal", 0.4, np.array([0.75, 1.4, 0]), np.diag([1e-3, 2e-3, 3e-3]).ravel(), sites=[tip])
    ]
    hand.llimit, hand.ulimit = np.array([-1.0, -0.2]), np.array([1.0, 0.3])
    hand.limit_orientation, hand.stiffness = np.array([0, 1, 0, 0.5]), np.array([0.1, 0.2, 0.3])
    elbow = Joint("l_elbow", np.array([0.45, 1.4, 0]), joints=[hand], rotation=np.array([0, 1, 0, 0.4]))
    elbow.scale, elbow.scale_orientation = np.array([1.0, 1.3, 0.9]), np.array([0, 0, 1, 0.6])
    shoulder = Joint("l_shoulder", np.array([0.2, 1.4, 0]), joints=[elbow], translation=np.array([0.01, 0.02, 0]))
    root = Joint("humanoid_root", np.array([0, 0.9, 0]), joints=[shoulder], rotation=np.array([0, 1, 0, 0.2]))
    flesh = figure(spread=0.06, deficit=True).skin
    h = Humanoid("anna", "2.0", 1, {"age": "30", "authorName": "A. Nobody"}, skeleton=[root], skin_coord=flesh.rest)
    h.skeletal_configuration = "OWN"
    h.translation, h.rotation = np.array([0.3, 0, 1]), np.array([0, 1, 0, 0.7])
    h.scale, h.scale_orientation = np.array([1.2, 1.0, 1.0]), np.array([0, 0, 1, 0.3])
    h.sites, h.viewpoints = [Site("ground_pt", np.array([0.1, 0, 0]))], [Site("front_view", np.array([0, 1, 3.0]))]
    h.binding = {"l_elbow": (np.array([0.01, 0, 0.02]), np.array([0, 0, 1, 0.1]), np.ones(3))}
    index = {n: j for n, j in zip(("humanoid_root", "l_shoulder", "l_elbow", "l_radiocarpal"), (0, 3, 4, 5))}
    for joint in h.joints():
        mine = flesh.weights.joint == index[joint.name]
        joint.skin_coord_index = flesh.weights.vertex[mine]
        joint.skin_coord_weight = flesh.weights.weight[mine]
    h.skin = [Shape("arm", flesh.triangles, uv=flesh.uv, uv_triangles=flesh.triangles, crease_angle=0.5)]
    h.skin[0].material.color, h.skin[0].material.roughness = (0.8, 0.5, 0.25), 0.375
    shoulder.displacers = [Displacer("bump_action", np.arange(3), np.full((3, 3), 0.01), 0.5)]
    return h


def test_our_own_file_comes_back_whole(tmp_path: Path) -> None:
    h = tree()
    vt.save(h, tmp_path / "a.glb")
    g = vt.load(tmp_path / "a.glb")
    same = ("name", "version", "loa", "info", "skeletal_configuration")
    assert [getattr(g, k) for k in same] == [getattr(h, k) for k in same]
    for a, b in zip(h.joints(), g.joints(), strict=True):
        assert a.name == b.name
        for field in ("center", "llimit", "ulimit", "limit_orientation", "stiffness", "translation", "rotation"):
            assert np.allclose(getattr(a, field), getattr(b, field), atol=1e-6), (a.name, field)
        assert [s.name for s in a.sites] == [s.name for s in b.sites]
        for s, t in zip(a.segments, b.segments, strict=True):
            assert (s.name, s.mass, [x.name for x in s.sites]) == (t.name, t.mass, [x.name for x in t.sites])
            assert np.allclose(s.center_of_mass, t.center_of_mass) and np.allclose(
                s.moments_of_inertia, t.moments_of_inertia
            )
    a, b = h.joint("l_radiocarpal").segments[0].sites[0], g.joint("l_radiocarpal").segments[0].sites[0]
    for field in ("center", "translation", "rotation"):
        assert np.allclose(getattr(a, field), getattr(b, field), atol=1e-6), field
    assert [s.name for s in g.sites] == ["ground_pt"] and [s.name for s in g.viewpoints] == ["front_view"]
    assert np.allclose(g.viewpoints[0].center, [0, 1, 3])
    (d,) = g.joint("l_shoulder").displacers
    assert d.name == "bump_action" and d.weight == 0.5 and d.coord_index.tolist() == [0, 1, 2]
    (shape,) = g.skin
    assert shape.crease_angle == pytest.approx(0.5) and shape.name == "arm"
    assert np.allclose(shape.material.color, (0.8, 0.5, 0.25), atol=1e-6) and shape.material.roughness == 0.375
    ours, theirs = vt.pack(h), vt.pack(g)
    assert np.abs(ours.skin.rest - theirs.skin.rest).max() < 1e-6
    assert np.array_equal(ours.skin.triangles, theirs.skin.triangles)
    assert np.abs(ours.placement - theirs.placement).max() < 1e-6
    corners = lambda s: s.uv[s.uv_triangles]  # noqa: E731
    assert np.abs(corners(ours.skin) - corners(theirs.skin)).max() < 1e-6
    assert np.abs(joint_matrices(ours.skeleton) - joint_matrices(theirs.skeleton)).max() < 1e-5
    # what lacks less than 1e-4 to a sum of one is rounding for the writer
    assert np.abs(_dense(ours) - _dense(theirs)).max() < 1e-4


def _dense(body: vt.Body) -> np.ndarray:
    w = body.skin.weights
    out = np.zeros((len(w), len(body.skeleton)))
    out[w.vertex, w.joint] = w.weight
    return out


@pytest.mark.parametrize("influences", [4, 8])
def test_weights_come_back_as_they_were_written(tmp_path: Path, influences: int) -> None:
    body = replace(figure(), skin=replace(figure().skin, morphs=()))
    from vitruvian.formats.glb import write_glb

    report = write_glb(body, tmp_path / "a.glb", influences=influences)
    back = vt.pack(vt.load(tmp_path / "a.glb"))
    source = _used(body)
    full, kept = _dense(body)[source], _dense(back)
    off = np.abs(full - kept).max(axis=1) > 1e-5
    assert off.sum() <= report["pruned_weights"]
    assert (report["pruned_weights"] == 0) == (influences == 8)
    assert (kept > 0).sum(axis=1).max() <= influences
    assert np.abs(kept.sum(axis=1) - 1).max() < 1e-6


def _used(body: vt.Body) -> np.ndarray:
    return np.unique(body.skin.triangles) if body.skin.uv is not None else np.arange(len(body.skin.rest))


@pytest.mark.parametrize("loop", [False, True])
def test_motion_of_our_own_file(tmp_path: Path, loop: bool) -> None:
    body = placed(thin(figure(deficit=True, spread=0.06)))
    motion = wave(body, loop=loop)
    vt.save(vt.Clip(Humanoid("tester"), body, motion, "linear"), tmp_path / "a.glb")
    g = vt.load(tmp_path / "a.glb")
    back = vt.pack(g)
    again = motion_of(g, back.skeleton, fps=24)
    assert again is not None and again.loop == loop and len(again) == len(motion)
    for frame in (0, 5, 11):
        a = skinned(body, joint_matrices(body.skeleton, motion)[frame])[_used(body)]
        b = skinned(back, joint_matrices(back.skeleton, again)[frame])
        assert np.abs(a - b).max() < 1e-5


def test_weights_of_displacers_in_our_own_file(tmp_path: Path) -> None:
    body = figure(spread=0.06)
    motion = wave(body, loop=False)
    vt.save(vt.Clip(Humanoid("tester"), body, motion, "linear"), tmp_path / "a.glb")
    g = vt.load(tmp_path / "a.glb")
    assert [(d.name, j.name) for j in g.joints() for d in j.displacers] == [
        ("chest_action", "vl5"), ("smile_action", "skullbase")
    ]  # fmt: skip
    again = motion_of(g, vt.pack(g).skeleton, fps=24)
    assert again is not None
    assert np.abs(again.weights["smile_action"] - motion.weights["smile_action"]).max() < 1e-6


def test_real_figures_come_back(tmp_path: Path, shared: Path) -> None:
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in ("JinLOA3.x3d", "JoeKick.x3d", "JinNoAnimations_Fixed.x3d"):
            h = vt.load(shared / "data" / "hanim" / name)
            report = vt.save(h, tmp_path / "a.glb")
            a, g = vt.pack(h), vt.load(tmp_path / "a.glb")
            b = vt.pack(g)
            assert a.skeleton.names == b.skeleton.names and g.version == h.version and g.loa == h.loa
            assert np.abs(a.skeleton.centers - b.skeleton.centers).max() < 1e-6
            assert sorted(a.skeleton.site_names) == sorted(b.skeleton.site_names)
            size = np.ptp(a.skin.rest, axis=0).max()
            used = np.arange(len(a.skin.rest))
            used = used if len(b.skin.rest) == len(used) else np.unique(a.skin.triangles)
            assert np.abs(a.skin.rest[used] - b.skin.rest).max() < 1e-6 * size, name
            if not report["pruned_weights"]:
                poses = joint_matrices(a.skeleton)[0], joint_matrices(b.skeleton)[0]
                moved = [skinned(body, m) for body, m in zip((a, b), poses)]
                assert np.abs(moved[0][used] - moved[1]).max() < 1e-5 * size, name
            assert len(h.segments()) == len(g.segments())


# foreign rigs


def moved_like(path: Path, humanoid: Humanoid, times: list[float], fps: float = 30) -> float:
    """Largest distance between the vertices a player shows and the nearest of our skin points, over the times."""
    player, body = Player(path), vt.pack(humanoid)
    motion = motion_of(humanoid, body.skeleton, fps=fps)
    matrices = joint_matrices(body.skeleton, motion)
    worst = 0.0
    for t in times:
        ours = skinned(body, matrices[round(t * fps) if motion is not None else 0])
        theirs = player.vertices(t)
        worst = max(worst, float(cKDTree(ours).query(theirs)[0].max()), float(cKDTree(theirs).query(ours)[0].max()))
    return worst


@pytest.mark.parametrize("prefix", ["mixamorig:", "", "mixamorig1_"])
def test_foreign_rig_gets_our_names_and_stands_in_metres(tmp_path: Path, prefix: str) -> None:
    rig = Foreign(prefix if prefix != "mixamorig1_" else "mixamorig_")
    h = vt.load(rig.maker.glb(tmp_path / "a.glb"))
    by_name = {j.name: j for j in h.joints()}
    assert list(by_name) != [] and set(by_name) == {j for j, _, _ in BONES}
    for (joint, _, _), c in zip(BONES, rig.centers):
        assert np.abs(by_name[joint].center - c).max() < 1e-5
        assert by_name[joint].rotation[3] == 0 and not by_name[joint].translation.any()
    assert h.skeleton[0].name == "humanoid_root" and h.loa == -1
    assert by_name["l_elbow"].segments[0].name == "l_forearm"
    # three copies of each corner are one point again; two primitives are two shapes
    assert len(h.skin_coord) == len(rig.points) and len(h.skin) == 2
    assert cKDTree(h.skin_coord).query(rig.points)[0].max() < 1e-5
    assert np.allclose(h.skin[0].material.color, [0.4845, 0.7354, 1.0], atol=1e-3)
    body = vt.pack(h)
    assert np.abs(body.skin.weights.sums - 1).max() < 1e-6
    assert moved_like(tmp_path / "a.glb", h, [0]) < 1e-5


def test_foreign_rig_moves_as_players_move_it(tmp_path: Path) -> None:
    rig = Foreign()
    n, rng = 7, np.random.default_rng(1)
    rest = {k: np.array(rig.maker.json["nodes"][i]["rotation"]) for k, i in rig.bone.items()}
    turn = {
        k: ("rotation", rest[k] + 0.2 * rng.normal(size=(n, 4)), "LINEAR") for k in ("LeftArm", "Spine1", "RightLeg")
    }
    turn = {k: (p, v / np.linalg.norm(v, axis=1, keepdims=True), how) for k, (p, v, how) in turn.items()}
    at = rig.maker.json["nodes"][rig.bone["Hips"]]["translation"]
    rig.animate(np.arange(n) / 30, **turn, Hips=("translation", at + 10 * rng.normal(size=(n, 3)), "LINEAR"))
    h = vt.load(rig.maker.glb(tmp_path / "a.glb"))
    assert {t.target for t in h.tracks} == {"l_shoulder", "vt10", "r_knee", "humanoid_root"}
    assert moved_like(tmp_path / "a.glb", h, [k / 30 for k in range(n)]) < 2e-5


def test_a_rig_saved_in_another_pose_keeps_its_bind_pose(tmp_path: Path) -> None:
    rig = Foreign(posed=True)
    h = vt.load(rig.maker.glb(tmp_path / "a.glb"))
    centers = {j.name: j.center for j in h.joints()}
    assert max(np.abs(centers[j] - c).max() for (j, _, _), c in zip(BONES, rig.centers)) < 1e-5
    assert sum(j.rotation[3] != 0 for j in h.joints()) > 20
    assert moved_like(tmp_path / "a.glb", h, [0]) < 2e-5


def test_a_figure_that_stands_elsewhere_and_backwards(tmp_path: Path) -> None:
    rig = Foreign()
    m = rig.maker
    away = m.put("nodes", {"name": "away", "translation": [3, 0, -2], "rotation": [0, 1, 0, 0], "children": [rig.root]})
    m.json["scenes"][0]["nodes"] = [away, rig.node]
    with pytest.warns(VitruvianWarning, match="face"):
        h = vt.load(m.glb(tmp_path / "a.glb"))
    assert np.allclose(h.translation, [3, 0, -2])
    centers = {j.name: j.center for j in h.joints()}
    assert max(np.abs(centers[j] - c).max() for (j, _, _), c in zip(BONES, rig.centers)) < 1e-5


def test_own_table_of_names(tmp_path: Path) -> None:
    rig = Foreign("bone_")
    for node in rig.maker.json["nodes"]:
        if node["name"] == "bone_LeftHandIndex2":
            node["name"] = "Fancy"
    path = rig.maker.glb(tmp_path / "a.glb")
    table = tmp_path / "names.json"
    table.write_text('{"joints": {"Fancy": "l_carpal_proximal_interphalangeal_2", "bone_Hips": "HumanoidRoot"}}')
    names = [j.name for j in vt.load(path, names=table).joints()]
    assert "l_carpal_proximal_interphalangeal_2" in names and names[0] == "humanoid_root"
    assert "Fancy" in [j.name for j in vt.load(path).joints()]
    with pytest.raises(VitruvianError, match="names"):
        vt.load(path, names={"Fancy": 3})


def test_rigid_parts_and_custom_bones(tmp_path: Path) -> None:
    """A hat that hangs on the head follows it; a tail keeps its name; a second skin shares the joints."""
    rig = Foreign()
    m = rig.maker
    hat = m.put(
        "meshes", {"primitives": [{"attributes": {"POSITION": m.add(CUBE)}, "indices": m.add(np.ravel(SIDES), "B")}]}
    )
    head = rig.bone["Head"]
    on = m.put("nodes", {"name": "hat", "mesh": hat, "scale": [10, 10, 10]})
    m.json["nodes"][head].setdefault("children", []).append(on)
    h = vt.load(m.glb(tmp_path / "a.glb"))
    assert len(h.skin_coord) == len(rig.points) + 8
    body = vt.pack(h)
    w = body.skin.weights
    assert set(w.joint[w.vertex < 8].tolist()) == {body.skeleton.index["skullbase"]}
    world = rig.bind[5] @ trs(s=10)
    expected = CUBE @ world[:3, :3].T + world[:3, 3]
    assert cKDTree(body.skin.rest[:8]).query(expected)[0].max() < 1e-5


def test_every_kind_of_accessor(tmp_path: Path) -> None:
    """Strides, offsets, normalised integers, sparse, 8/16/32 bit indices, strips, fans and no indices: one cube each."""
    m = Maker()
    base = m.add(CUBE)
    short = np.round(CUBE * 32767)
    lists = [
        (m.add(CUBE, stride=20, offset=8), m.add(np.ravel(SIDES), "B"), 4),
        (m.add(short, "h", normalized=True, stride=8), m.add(np.ravel(SIDES), "H"), 4),
        (m.add(CUBE * 255, "B", normalized=True, stride=4), m.add(np.ravel(SIDES), "I"), 4),
        (m.sparse(8, [7, 1, 6], CUBE[[7, 1, 6]], base), m.add(np.ravel(SIDES), "B"), 4),
        (m.sparse(8, np.arange(8), CUBE, None, "B"), m.add(np.ravel(SIDES), "B"), 4),
        (m.add(CUBE[np.ravel(SIDES)]), None, 4),
        (base, m.add([0, 1, 2, 3, 6, 7, 4, 5, 0, 1], "B"), 5),
        (base, m.add([0, 1, 3, 2, 6, 4, 5, 1], "B"), 6),
    ]
    for k, (position, index, mode) in enumerate(lists):
        primitive = {"attributes": {"POSITION": position}, "mode": mode}
        if index is not None:
            primitive["indices"] = index
        mesh = m.put("meshes", {"name": f"cube {k}", "primitives": [primitive]})
        m.put("nodes", {"mesh": mesh, "translation": [3 * k, 0, 0]})
    found = vt.load(m.glb(tmp_path / "a.glb"))
    assert isinstance(found, vt.Mesh) and len(found.vertices) == 8 * len(lists)
    for k in range(len(lists)):
        mine = found.vertices[(found.vertices[:, 0] > 3 * k - 1) & (found.vertices[:, 0] < 3 * k + 2)] - [3 * k, 0, 0]
        assert cKDTree(mine).query(CUBE)[0].max() < 1e-5, k
    where = found.vertices[found.triangles].mean(axis=1)[:, 0] // 3
    assert [int((where == k).sum()) for k in range(8)] == [12] * 6 + [8, 6]
    faces = trimesh.Trimesh(found.vertices, found.triangles[where < 6], process=False)
    assert faces.is_watertight and faces.volume == pytest.approx(6, abs=1e-3)


def test_strips_keep_one_side_out(tmp_path: Path) -> None:
    m = Maker()
    grid = np.array([[x, y, 0] for x in range(4) for y in (0, 1)], float)
    m.put("meshes", {"primitives": [{"attributes": {"POSITION": m.add(grid)}, "mode": 5}]})
    m.put("nodes", {"mesh": 0, "scale": [-1, 1, 1]})
    found = vt.load(m.glb(tmp_path / "a.glb"))
    a, b, c = (found.vertices[found.triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    assert len(normal) == 6 and (normal[:, 2] == normal[0, 2]).all()


def test_files_beside_and_data_uris(tmp_path: Path) -> None:
    for beside in ("", "data.bin", "parts/a%20b.bin"):
        rig = Foreign()
        name = beside.replace("%20", " ")
        path = rig.maker.gltf(tmp_path / "a.gltf", beside=name)
        path.write_text(path.read_text().replace("a b.bin", "a%20b.bin"))
        assert len(vt.load(path).joints()) == len(BONES)


@pytest.mark.parametrize(
    "uri", ["../a.bin", "{outside}", "https://example.org/a.bin", "sub/../../a.bin", "%2e%2e/a.bin"]
)
def test_nothing_outside_the_folder_is_opened(tmp_path: Path, uri: str) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "a.bin").write_bytes(bytes(100000))
    rig = Foreign()
    path = rig.maker.gltf(tmp_path / "in" / "a.gltf", claim=uri.format(outside=tmp_path / "a.bin"))
    with pytest.raises(FileError, match="outside|beside"):
        vt.load(path)


def test_a_link_out_of_the_folder_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    rig = Foreign()
    path = rig.maker.gltf(tmp_path / "in" / "a.gltf", beside="data.bin")
    (tmp_path / "in" / "data.bin").rename(tmp_path / "data.bin")
    (tmp_path / "in" / "data.bin").symlink_to(tmp_path / "data.bin")
    with pytest.raises(FileError, match="outside"):
        vt.load(path)


def test_surface_of_trimesh(tmp_path: Path) -> None:
    """A scene written by another library: two meshes, placed, one painted."""
    scene = trimesh.Scene()
    ball = trimesh.creation.icosphere(2, 0.5)
    ball.visual.vertex_colors = np.tile([255, 0, 0, 255], (len(ball.vertices), 1))
    scene.add_geometry(ball, transform=trimesh.transformations.translation_matrix([0, 2, 0]))
    scene.add_geometry(trimesh.creation.box((1, 2, 3)))
    for name in ("a.glb", "a.gltf"):
        if name.endswith("glb"):
            (tmp_path / name).write_bytes(scene.export(file_type="glb"))
        else:
            for part, data in trimesh.exchange.gltf.export_gltf(scene).items():
                (tmp_path / ("a.gltf" if part == "model.gltf" else part)).write_bytes(data)
        found = vt.load(tmp_path / name)
        assert isinstance(found, vt.Mesh)
        whole = trimesh.Trimesh(found.vertices, found.triangles, process=False)
        assert whole.is_watertight and whole.volume == pytest.approx(ball.volume + 6, rel=1e-5)
        assert len(found.vertices) == len(ball.vertices) + 8
        red = np.abs(found.colors - [1, 0, 0]).max(axis=1) < 1e-6
        assert (found.vertices[red, 1] > 1.4).all() and red.sum() == len(ball.vertices)


def test_our_own_mesh_and_its_seams(tmp_path: Path) -> None:
    skin = figure().skin
    sent = vt.Mesh(skin.rest, skin.triangles, skin.uv, skin.colors, name="tube")
    vt.save(sent, tmp_path / "a.glb")
    got = vt.load(tmp_path / "a.glb")
    assert got.name == "tube" and np.abs(got.vertices - sent.vertices).max() < 1e-6
    assert np.array_equal(got.triangles, sent.triangles) and np.abs(got.colors - sent.colors).max() < 1e-4
    assert np.abs(got.uv[got.uv_triangles] - sent.uv[sent.triangles]).max() < 1e-6


def test_morphs_of_others_become_displacers_of_the_joint_they_move(tmp_path: Path) -> None:
    rig = Foreign()
    m = rig.maker
    mesh = m.json["meshes"][0]
    count = m.json["accessors"][mesh["primitives"][0]["attributes"]["POSITION"]]["count"]
    head = np.arange(5 * 24, 6 * 24)
    for primitive in mesh["primitives"]:
        primitive["targets"] = [{"POSITION": m.sparse(count, head, np.tile([0, 0, 5.0], (24, 1)))}, {}]
    mesh["extras"], mesh["weights"] = {"targetNames": ["grow", "nothing"]}, [0.25, 0]
    rig.maker.put("animations", {
        "samplers": [{"input": m.add([0, 1.0]), "output": m.add([0.0, 0, 1, 0.5])}],
        "channels": [{"sampler": 0, "target": {"node": rig.node, "path": "weights"}}],
    })  # fmt: skip
    h = vt.load(m.glb(tmp_path / "a.glb"))
    ((name, d),) = [(j.name, d) for j in h.joints() for d in j.displacers]
    assert (name, d.name, d.weight) == ("skullbase", "grow", 0.25)
    assert len(d.coord_index) == 8 and np.allclose(d.displacements, [0, 0.05, 0])  # 5 cm along Z up
    (track,) = h.tracks
    assert (track.target, track.field, track.values[:, 0].tolist()) == ("grow", "weight", [0, 1])


def test_command_line(tmp_path: Path) -> None:
    from test_cli import answer, fails

    path = Foreign().maker.glb(tmp_path / "a.glb")
    (facts,) = answer("info", path)["humanoids"]
    assert facts["joints"] == len(BONES) and facts["vertices"] == 8 * len(BONES)
    answer("convert", path, tmp_path / "a.x3d")
    assert len(vt.load(tmp_path / "a.x3d").joints()) == len(BONES)
    cube = Maker()
    cube.put("meshes", {"primitives": [{"attributes": {"POSITION": cube.add(CUBE[:3])}}]})
    cube.put("nodes", {"mesh": 0})
    assert answer("info", cube.glb(tmp_path / "m.glb"))["mesh"]["triangles"] == 1
    assert "doctor looks at humanoids only" in fails("check", tmp_path / "m.glb")


def test_a_figure_made_played_and_exported_by_three(tmp_path: Path, referee: Path) -> None:
    """Our skin stands where three.js itself puts the vertices of the file it wrote."""
    import json
    import os
    import shutil
    import subprocess

    if not (referee / "node_modules" / "three").is_dir():
        pytest.skip("three is missing: run `make referees`")
    script = Path(__file__).with_name("stranger_three.mjs")
    done = subprocess.run(
        [shutil.which("node") or "node", str(script), str(tmp_path / "a.glb")], capture_output=True, text=True,
        timeout=60, env={**os.environ, "REFEREE": str(referee)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    h = vt.load(tmp_path / "a.glb")
    centers = {j.name: j.center for j in h.joints()}
    for bone, joint in (
        ("Hips", "humanoid_root"),
        ("LeftForeArm", "l_elbow"),
        ("RightLeg", "r_knee"),
        ("Head", "skullbase"),
    ):
        assert np.abs(centers[joint] - told["bones"][bone]).max() < 1e-6
    assert [(d.name, j.name) for j in h.joints() for d in j.displacers] == [("surprise", "skullbase")]
    body = vt.pack(h)
    motion = motion_of(h, body.skeleton, fps=5)
    assert motion is not None and len(motion) == 4
    shown = vt.deformer("linear", body)(joint_matrices(body.skeleton, motion), motion.weights)
    for frame, flat in enumerate(told["vertices"]):
        theirs = np.array(flat).reshape(-1, 3)
        assert len(theirs) == len(shown[frame])
        assert cKDTree(theirs).query(shown[frame])[0].max() < 1e-5, frame
        assert cKDTree(shown[frame]).query(theirs)[0].max() < 1e-5, frame


def test_two_figures_in_one_file(tmp_path: Path) -> None:
    rig = Foreign()
    m = rig.maker
    count = len(m.json["nodes"])
    for node in [dict(n) for n in m.json["nodes"]]:
        node["children"] = [c + count for c in node.get("children", [])]
        if "skin" in node:
            node["skin"] = 1
        m.put("nodes", {k: v for k, v in node.items() if v != []})
    m.json["skins"].append({**m.json["skins"][0], "joints": [j + count for j in m.json["skins"][0]["joints"]]})
    for k, name in ((rig.root, "ann"), (rig.root + count, "bob")):
        m.json["nodes"][k]["name"] = name
    m.json["nodes"][rig.root + count]["translation"] = [2, 0, 0]
    m.json["scenes"][0]["nodes"] += [rig.root + count, rig.node + count]
    path = m.glb(tmp_path / "a.glb")
    with pytest.warns(VitruvianWarning, match="also holds bob; name= picks one"):
        assert vt.load(path).name == "ann"
    bob = vt.load(path, name="bob")
    assert np.allclose(bob.translation, [2, 0, 0]) and len(bob.joints()) == len(BONES)
    assert np.abs(bob.joint("skullbase").center - rig.centers[5]).max() < 1e-5
    with pytest.raises(VitruvianError, match="eve"):
        vt.load(path, name="eve")
    from vitruvian.formats.registry import humanoids

    assert [h.name for h in humanoids(path)] == ["ann", "bob"]
    assert {f.where.split()[1] for f in vt.check(path) if f.rule == "P04"} >= {"ann", "bob"}
