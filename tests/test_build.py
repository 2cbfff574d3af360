"""Humanoids to scenes and back: fresh ones, converted ones, and loaded ones that are brought up to date."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from scene_figure import GOOD, typed
from vitruvian.errors import VitruvianError
from vitruvian.formats.vrml import read_vrml, write_vrml
from vitruvian.formats.x3d import parse_x3d, read_x3d, write_x3d
from vitruvian.hanim import tables
from vitruvian.hanim.build import scene_of
from vitruvian.hanim.convert import converted
from vitruvian.hanim.doctor import check
from vitruvian.hanim.graph import Scene
from vitruvian.hanim.humanoid import Humanoid, MotionData, Shape, Track
from vitruvian.hanim.segmenting import segment, triangle_joints
from vitruvian.hanim.studio import bounds, studio
from vitruvian.hanim.view import humanoids


def through(h: Humanoid, tmp_path: Path, **options: str) -> tuple[Humanoid, Scene, list[str]]:
    """Written, read again without a warning."""
    scene, lost = scene_of([h], **options)
    encoding = options.get("encoding", "x3d")
    path = tmp_path / f"out.{encoding}"
    (write_x3d if encoding == "x3d" else write_vrml)(scene, path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = (read_x3d if encoding == "x3d" else read_vrml)(path)
        (back,) = humanoids(again)
    return back, again, lost


def same(a: np.ndarray, b: np.ndarray) -> None:
    np.testing.assert_allclose(a, b, rtol=2e-7, atol=1e-9)


@pytest.mark.parametrize(("encoding", "version"), [("x3d", "2.0"), ("x3dv", "2.0"), ("x3d", "1.0"), ("wrl", "200x")])
def test_what_is_written_reads_back(tmp_path: Path, encoding: str, version: str) -> None:
    h = typed(1, version="2.0" if version == "2.0" else "1.x")
    back, scene, lost = through(h, tmp_path, encoding=encoding, version=version)
    moving = ["a moving skin: plain VRML97 browsers draw the skin at rest, only H-Anim browsers move it"]
    assert lost == (moving if encoding == "wrl" else [])
    assert (back.name, back.version, back.info) == ("Ada", version, {"age": "36"})
    assert back.loa == (1 if version == "2.0" else -1)
    names = [j.name for j in h.joints()]
    if version == "200x":
        names[0] = "HumanoidRoot"
    assert [j.name for j in back.joints()] == names
    for a, b in zip(h.joints(), back.joints()):
        same(a.center, b.center)
        same(a.llimit, b.llimit)
        same(a.stiffness, b.stiffness)
        np.testing.assert_array_equal(a.skin_coord_index, b.skin_coord_index)
        same(a.skin_coord_weight, b.skin_coord_weight)
        assert [s.name for s in a.segments] == [s.name for s in b.segments]
    same(h.skin_coord, back.skin_coord)
    assert [s.points for s in back.skin] == [None, None]
    for a, b in zip(h.skin, back.skin):
        np.testing.assert_array_equal(a.triangles, b.triangles)
        same(np.array(a.material.color), np.array(b.material.color))
        assert b.material.roughness == pytest.approx(a.material.roughness, abs=1e-6)
    same(h.skin[0].uv, back.skin[0].uv)
    np.testing.assert_array_equal(back.skin[0].uv_triangles, h.skin[0].uv_triangles)
    used = np.unique(h.skin[1].triangles)
    same(back.skin[1].colors[used], h.skin[1].colors[used])
    (d,) = back.displacers()
    assert (d.name, d.weight, list(d.coord_index)) == ("blink_action", 0.5, [0, 1])
    assert sorted(s.name for s in back.all_sites()) == ["front_view", "skull_vertex_tip"]
    assert [(t.target, t.field, t.timer) for t in back.tracks] == [
        ("l_shoulder", "rotation", "hanim_wave"),
        (names[0], "translation", "hanim_wave"),
    ]
    same(back.tracks[0].values, h.tracks[0].values)
    assert {f.rule for f in check(scene) if f.severity == "error"} == set()


def test_one_coordinate_for_skin_and_skin_coord(tmp_path: Path) -> None:
    _, scene, _ = through(typed(1), tmp_path)
    (root,) = [n for n in scene.walk() if n.type == "HAnimHumanoid"]
    coords = {id(c) for s in root.children("skin") for g in s.children("geometry") for c in g.children("coord")}
    assert coords == {id(root.children("skinCoord")[0])}
    assert sum(n.type == "Coordinate" for n in scene.walk()) == 1
    for field, kind in (("joints", "HAnimJoint"), ("segments", "HAnimSegment"), ("sites", "HAnimSite")):
        listed = [id(n) for n in root.children(field)]
        assert len(set(listed)) == len(listed) == sum(n.type == kind for n in scene.walk())


def test_h_anim_1_1_has_segments_instead_of_skin(tmp_path: Path) -> None:
    h = typed(1)
    back, _, lost = through(h, tmp_path, encoding="wrl", version="1.1")
    assert any("seamless skin" in x for x in lost)
    assert len(back.skin_coord) == 0
    (blink,) = back.displacers()  # the joint's, over the points of the Segment that holds them
    assert (blink.name, len(blink.coord_index)) == ("blink_action", 2)
    assert sum(len(s.triangles) for g in back.segments() for s in g.shapes) == 36
    assert {j.name for j in back.joints()} == {tables.name_in(j.name, "1.1") for j in h.joints()}
    body = back.node.children("humanoidBody")  # type: ignore[union-attr]
    assert [n.type for n in body] == ["Joint"]


def test_two_humanoids_in_one_file(tmp_path: Path) -> None:
    a, b = typed(1), typed(1)
    b.name = "Bob"
    scene, lost = scene_of([a, b])
    assert lost == []
    write_x3d(scene, tmp_path / "two.x3d")
    back = humanoids(read_x3d(tmp_path / "two.x3d"))
    assert [h.name for h in back] == ["Ada", "Bob"]
    assert [len(h.tracks) for h in back] == [2, 2]
    assert back[1].joints()[3].node.name.startswith("Bob_")  # type: ignore[union-attr]


def test_hanim_motion(tmp_path: Path) -> None:
    h = typed(1)
    h.tracks = []
    values = np.arange(12.0).reshape(3, 4)
    channels = [("Xposition", "Yposition", "Zposition"), ("Xrotation",)]
    h.motions = [MotionData("stroll", ["humanoid_root", "l_knee"], channels, values, 0.04, True, False)]
    back, scene, lost = through(h, tmp_path)
    assert lost == []
    assert ("HAnim", 3) in scene.components
    (m,) = back.motions
    assert (m.joints, m.channels, m.frame_duration, m.enabled, m.loop) == (
        ["humanoid_root", "l_knee"],
        channels,
        0.04,
        True,
        False,
    )
    same(m.values, values)
    _, _, lost = through(h, tmp_path, encoding="wrl", version="200x")
    assert "HAnimMotion: only X3D 4.0 has it" in lost


def test_baked_transforms_and_mirrors(tmp_path: Path) -> None:
    h = typed(1, skin=False)
    h.tracks = []
    shape = h.joint("l_hip").segments[0].shapes[0]
    mirror = np.diag([-2.0, 2.0, 2.0, 1.0])
    mirror[:3, 3] = [1, 0, 0]
    shape.transform = mirror
    back, _, _ = through(h, tmp_path)
    there = back.joint("l_hip").segments[0].shapes[0]
    same(there.points, shape.points @ mirror[:3, :3].T + mirror[:3, 3])
    np.testing.assert_array_equal(there.triangles, shape.triangles[:, ::-1])


def test_down_conversion_folds_and_adds_weights() -> None:
    h = typed(4)
    h.tracks.append(Track("l_talocalcaneonavicular", "rotation", np.zeros(1), np.zeros((1, 4)), timer="wave"))
    down, lost = converted(h, "1.1")
    assert len(down.joints()) == 94
    assert {j.name for j in down.joints()} == {tables.name_in(n, "1.1") for n in tables.joints_at(3)}
    assert any("52 joints" in x for x in lost)
    assert any("animation of 1 folded" in x for x in lost)
    total = np.zeros(len(h.skin_coord))
    for j in down.joints():
        assert len(np.unique(j.skin_coord_index)) == len(j.skin_coord_index)
        np.add.at(total, j.skin_coord_index, j.skin_coord_weight)
    same(total, np.tile([1, 1, 0.75, 0.5], 146))
    assert len(h.joints()) == 146  # the original stays as it was
    assert len(h.joint("l_talocrural").skin_coord_index) == 4
    up, lost = converted(down, "2.0")
    assert (len(up.joints()), up.loa, lost) == (94, 3, [])
    assert {j.name for j in up.joints()} == set(tables.joints_at(3))
    assert [s.name for s in up.joint("l_talocrural").segments] == ["l_talus"]
    assert {t.target for t in up.tracks} == {"l_shoulder", "humanoid_root"}


def test_segmenting_gives_each_triangle_to_its_strongest_joint() -> None:
    h = typed(1)
    owner = triangle_joints(h, h.skin[0].triangles)
    np.testing.assert_array_equal(owner, h.skin[0].triangles[:, 0] // 4)
    cut = segment(h)
    for number, joint in enumerate(cut.joints()):
        for shape in joint.segments[0].shapes:
            same(shape.points, h.skin_coord[4 * number : 4 * number + 4])
            if shape.uv is not None:
                np.testing.assert_array_equal(shape.uv_triangles, h.skin[0].uv_triangles[2 * number : 2 * number + 2])


def test_the_whole_figure_is_in_the_first_view() -> None:
    h = typed(1)
    views = [n for n in studio([h]) if n.type == "Viewpoint"]
    assert [v.fields["description"] for v in views] == ["Front", "Three-quarter", "Side", "Back"]
    low, high = bounds([h])
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    from vitruvian.hanim.surface import _turn

    for v in views:
        axis = _turn(v.fields["orientation"])  # type: ignore[arg-type]
        seen = (corners - v.fields["position"]) @ axis
        assert (seen[:, 2] < 0).all()
        reach = np.abs(seen[:, :2] / seen[:, 2:]).max()
        assert 0.5 < reach / np.tan(0.3) < 1.0, v.fields["description"]


def test_combinations_that_do_not_exist() -> None:
    h = typed(1)
    with pytest.raises(VitruvianError, match="encoding"):
        scene_of([h], encoding="obj")
    with pytest.raises(VitruvianError, match="at least one"):
        scene_of([])
    with pytest.raises(VitruvianError, match="H-Anim version"):
        scene_of([h], version="3")
    scene, lost = scene_of([h], version="2.0", encoding="wrl")
    assert "no VRML97 encoding" in lost[0]
    assert scene.version == "2.0"  # VRML 2.0
    scene, lost = scene_of([h], version="1.1", encoding="x3d")
    assert "written as 1.0" in lost[0]
    assert scene.version == "3.3"


EXTRA = "<Sound><AudioClip url='\"hum.wav\"'/></Sound><!-- keep me -->"


def loaded(text: str = GOOD) -> Humanoid:
    (h,) = humanoids(parse_x3d(text.replace("</Scene>", EXTRA + "</Scene>").encode(), "tin.x3d"))
    return h


def test_an_untouched_humanoid_goes_back_as_it_was(tmp_path: Path) -> None:
    h = loaded()
    write_x3d(h.scene, tmp_path / "before.x3d")  # type: ignore[arg-type]
    scene, lost = scene_of([h])
    write_x3d(scene, tmp_path / "after.x3d")
    assert lost == []
    assert (tmp_path / "before.x3d").read_bytes() == (tmp_path / "after.x3d").read_bytes()


def test_only_what_was_changed_is_touched(tmp_path: Path) -> None:
    h = loaded()
    write_x3d(h.scene, tmp_path / "before.x3d")  # type: ignore[arg-type]
    h.joint("l_elbow").rotation = np.array([1.0, 0, 0, 0.5])
    h.skin_coord = h.skin_coord + [0, 0, 1]
    h.info["age"] = "8"
    scene, lost = scene_of([h])
    assert lost == []
    write_x3d(scene, tmp_path / "after.x3d")
    before, after = ((tmp_path / f).read_text().splitlines() for f in ("before.x3d", "after.x3d"))
    changed = [(a, b) for a, b in zip(before, after, strict=True) if a != b]
    assert len(changed) == 3
    assert "keep me" in "".join(after)
    (back,) = humanoids(read_x3d(tmp_path / "after.x3d"))
    same(back.joint("l_elbow").rotation, np.array([1, 0, 0, 0.5]))
    same(back.skin_coord, h.skin_coord)
    assert back.info == h.info


def test_motion_and_tracks_can_be_added_and_replaced(tmp_path: Path) -> None:
    h = loaded()
    h.motions = [MotionData("run", ["vl5"], [("Xrotation",)], np.array([[0.0], [30.0]]), 0.5)]
    h.tracks = [
        Track("l_elbow", "rotation", np.array([0.0, 1]), np.array([[1.0, 0, 0, 0], [1, 0, 0, 1]]), 3.0, True, "t")
    ]
    scene, lost = scene_of([h])
    assert lost == []
    write_x3d(scene, tmp_path / "after.x3d")
    (back,) = humanoids(read_x3d(tmp_path / "after.x3d"))
    assert [(t.target, t.interval) for t in back.tracks] == [("l_elbow", 3.0)]
    assert [(m.joints, m.values.tolist()) for m in back.motions] == [(["vl5"], [[0.0], [30.0]])]
    assert any(n.type == "Sound" for n in scene.walk())
    again, _ = scene_of([h])  # a second save changes nothing more
    write_x3d(again, tmp_path / "again.x3d")
    assert (tmp_path / "again.x3d").read_bytes() == (tmp_path / "after.x3d").read_bytes()


def test_what_the_graph_cannot_take_is_built_afresh() -> None:
    h = loaded()
    h.skin.append(Shape("new", np.array([[0, 1, 2]], np.int32)))
    scene, lost = scene_of([h])
    assert scene is not h.scene
    assert any("1 AudioClip" in x and "1 Sound" in x for x in lost)
    scene, _ = scene_of([loaded()], encoding="x3dv")
    assert any(n.type == "Sound" for n in scene.walk())  # the other encoding of X3D takes the same graph
    scene, lost = scene_of([loaded()], encoding="wrl")
    assert not any(n.type == "Sound" for n in scene.walk())


@pytest.mark.parametrize("name", ["JinNoAnimations_Fixed.x3d", "JoeKick.x3d", "NancyPrototypes.wrl", "JinLOA1.x3d"])
@pytest.mark.parametrize(("encoding", "version"), [("x3d", "2.0"), ("wrl", "200x")])
def test_real_files_convert(shared: Path, tmp_path: Path, name: str, encoding: str, version: str) -> None:
    path = shared / "data" / "hanim" / name
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        (h,) = humanoids((read_x3d if path.suffix == ".x3d" else read_vrml)(path))
    back, _, _ = through(h, tmp_path, encoding=encoding, version=version)
    folded = name.startswith("JinNo") and version == "200x"
    assert len(back.joints()) == (94 if folded else len(h.joints()))
    same(back.skin_coord, h.skin_coord)
    assert len(back.tracks) == len(h.tracks)
    old = [s for g in h.segments() for s in g.shapes]
    new = [s for g in back.segments() for s in g.shapes]
    assert sum(len(s.triangles) for s in new) == sum(len(s.triangles) for s in old)
