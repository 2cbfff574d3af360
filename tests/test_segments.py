"""A skin cut into Segments and welded again: nothing moves, nothing is lost, seams don't show."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import vitruvian as vt
from scene_figure import typed
from vitruvian.body.kinematics import move, pose_matrices
from vitruvian.body.rotations import from_vector
from vitruvian.formats.x3d import parse_x3d, read_x3d, write_x3d
from vitruvian.hanim import tables
from vitruvian.hanim.build import scene_of
from vitruvian.hanim.doctor import check
from vitruvian.hanim.humanoid import Displacer, Humanoid, Shape
from vitruvian.hanim.normals import corner_normals, turned
from vitruvian.hanim.segmenting import patches, triangle_joints
from vitruvian.hanim.view import humanoids


@cache
def person() -> Humanoid:
    return vt.person(loa=2, outfit=None, hair="none")


def body(name: str, shared: Path | None = None) -> Humanoid:
    if shared is None:
        return person()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return vt.load(shared / "data" / "hanim" / name)


def poses(h: Humanoid, seed: int = 0) -> np.ndarray:
    """(3, J, 4, 4): random poses, everything turns."""
    skeleton = vt.pack(h).skeleton
    turn = from_vector(np.random.default_rng(seed).normal(0, 0.4, (3, len(skeleton), 3)))
    return pose_matrices(skeleton, turn, skeleton.translation[None])


def faces(shapes: list[Shape]) -> np.ndarray:
    """All triangles as sorted rows, each beginning at its lowest corner."""
    rows = np.concatenate([s.triangles for s in shapes])
    turn = (np.argmin(rows, axis=1)[:, None] + np.arange(3)) % 3
    rows = np.take_along_axis(rows, turn, axis=1)
    return rows[np.lexsort(rows.T)]


def influences(h: Humanoid) -> dict[str, dict[int, float]]:
    return {j.name: dict(zip(j.skin_coord_index.tolist(), j.skin_coord_weight.tolist())) for j in h.joints()}


@pytest.mark.parametrize("name", ["person", "JinNoAnimations_Fixed.x3d", "JoeKick.x3d"])
def test_welding_a_cut_skin_gives_it_back(name: str, request: pytest.FixtureRequest) -> None:
    h = body(name, None if name == "person" else request.getfixturevalue("shared"))
    cut = vt.segment(h)
    assert cut.skin == []
    assert sum(len(s.triangles) for g in cut.segments() for s in g.shapes) == sum(len(s.triangles) for s in h.skin)
    back = vt.weld(cut)
    np.testing.assert_array_equal(back.skin_coord, h.skin_coord)
    assert influences(back) == influences(h)
    assert [s.name for s in back.skin] == [s.name for s in h.skin]
    for a, b in zip(h.skin, back.skin):
        np.testing.assert_array_equal(faces([a]), faces([b]))
        if a.uv is not None:
            np.testing.assert_array_equal(a.uv, b.uv)
        if a.colors is not None:
            used = np.unique(a.triangles)
            np.testing.assert_array_equal(a.colors[used], b.colors[used])
    mine, theirs = (sorted(x.displacers(), key=lambda d: d.name) for x in (h, back))
    assert [(d.name, d.weight) for d in mine] == [(d.name, d.weight) for d in theirs]
    drawn = np.unique(np.concatenate([s.triangles for s in h.skin]))
    for a, b in zip(mine, theirs):
        seen = np.isin(a.coord_index, drawn)
        order = np.argsort(a.coord_index[seen])
        np.testing.assert_array_equal(a.coord_index[seen][order], b.coord_index)
        np.testing.assert_array_equal(a.displacements[seen][order], b.displacements)


@pytest.mark.parametrize("name", ["person", "JinNoAnimations_Fixed.x3d", "JoeKick.x3d"])
def test_seams_stay_closed(name: str, request: pytest.FixtureRequest) -> None:
    """At rest copies are equal to the bit; posed, each Segment for itself by its two lists, within a micrometre."""
    h = body(name, None if name == "person" else request.getfixturevalue("shared"))
    cut = vt.segment(h)
    packed = vt.pack(h)
    index = packed.skeleton.index
    w = packed.skin.weights
    matrices = poses(h)
    shapes = {(j.name, g.name): g.shapes for j in cut.joints() for g in j.segments}
    found = patches(cut)
    copies = np.zeros(len(h.skin_coord))
    normals = np.full((len(h.skin_coord), 3), np.nan)
    where = np.full((3, len(h.skin_coord), 3), np.nan)
    for patch in found:
        assert len(np.unique(patch.skin)) == len(patch.skin)  # each vertex once per segment
        copies[patch.skin] += 1
        np.testing.assert_array_equal(np.sort(np.r_[patch.rigid, patch.deformed]), np.arange(len(patch.skin)))
        first = shapes[patch.joint, patch.segment][0]
        np.testing.assert_array_equal(first.points, h.skin_coord[patch.skin])
        if first.normal_triangles is None:
            known = ~np.isnan(normals[patch.skin, 0])
            np.testing.assert_array_equal(first.normals[known], normals[patch.skin[known]])
            normals[patch.skin] = first.normals
        m = matrices[:, index[patch.joint]]
        local = first.points.copy()[None].repeat(3, axis=0)
        for k in patch.deformed:  # what a player writes into the Segment: the blend, in the joint's own frame
            row = patch.skin[k]
            a, b = w.row[row], w.row[row + 1]
            rest = h.skin_coord[row]
            blend = rest + sum(
                w.weight[e] * (move(matrices[:, w.joint[e]], np.broadcast_to(rest, (3, 3))) - rest) for e in range(a, b)
            )
            local[:, k] = move(np.linalg.inv(m), blend)
            if k > patch.deformed[min(400, len(patch.deformed) - 1)]:
                local[:, k:] = np.nan
                break
        posed = move(m[:, None], local)
        done = ~np.isnan(posed).any(axis=(0, 2))
        rows = patch.skin[done]
        gap = np.abs(posed[:, done] - where[:, rows])
        assert np.nanmax(np.where(np.isnan(gap), 0, gap), initial=0) <= 1e-6
        where[:, rows] = posed[:, done]
    assert (copies > 1).sum() > 10
    whole = vt.deformer("linear", packed)(matrices)[:, : len(h.skin_coord)]
    gap = np.abs(where - whole)
    assert np.nanmax(gap) < 2e-6  # float32 kernels
    again = vt.deformer("linear", vt.pack(cut))(matrices)[:, : len(h.skin_coord)]
    np.testing.assert_array_equal(again, whole)


def test_normals_are_those_of_the_whole_skin() -> None:
    h = person()
    cut = vt.segment(h)
    triangles = np.concatenate([s.triangles for s in h.skin])
    normals, corners = corner_normals(h.skin_coord, triangles, np.full(len(triangles), np.pi))
    assert corners is None
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-12)
    for shape in (s for g in cut.segments() for s in g.shapes):
        np.testing.assert_array_equal(shape.normals, normals[shape.skin_index])


def test_creases_keep_their_edges() -> None:
    """A cube with a crease angle of 0.5: each corner has the normal of its face."""
    points = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    triangles = np.array([t for q in quads for t in (q[:3], [q[0], q[2], q[3]])], np.int32)
    normals, corners = corner_normals(points, triangles, np.full(12, 0.5))
    a, b, c = (points[triangles[:, k]] for k in range(3))
    flat = np.cross(b - a, c - a)
    assert len(normals) == 6
    for k in range(3):
        np.testing.assert_allclose(normals[corners[:, k]], flat, atol=1e-12)
    mirror = np.diag([-2.0, 1, 1, 1])
    shape = Shape("cube", triangles, points=points, normals=normals, normal_triangles=corners)
    moved = turned(replace(shape, transform=mirror))
    a, b, c = (moved.points[moved.triangles[:, k]] for k in range(3))
    outward = np.cross(b - a, c - a)
    assert (np.einsum("ij,ij->i", outward, moved.normals[moved.normal_triangles[:, 0]]) > 0.5).all()


def test_ties_go_to_the_table_and_unlisted_joints_to_their_ancestors() -> None:
    h = typed(1)
    for joint in h.joints():
        joint.skin_coord_index, joint.skin_coord_weight = np.zeros(0, np.int32), np.zeros(0)
    both = np.arange(len(h.skin_coord), dtype=np.int32)
    for name in ("vl5", "l_hip"):  # l_hip comes first in the standard's table, vl5 is visited later in the tree
        h.joint(name).skin_coord_index, h.joint(name).skin_coord_weight = both, np.full(len(both), 0.5)
    names = [j.name for j in h.joints()]
    first = min(("vl5", "l_hip"), key=lambda n: tables.joints()[n].index)
    assert {names[n] for n in triangle_joints(h, h.skin[0].triangles)} == {first}
    h.joint("l_knee").skin_coord_index, h.joint("l_knee").skin_coord_weight = both, np.full(len(both), 0.4)
    listed = [n for n in names if n != "l_knee"]
    assert {names[n] for n in triangle_joints(h, h.skin[0].triangles, listed)} == {"l_hip"}
    cut = vt.segment(h, joints=["humanoid_root", "sacroiliac"])
    assert {p.joint for p in patches(cut)} == {"sacroiliac"}


@pytest.mark.parametrize("name", ["person", "JinNoAnimations_Fixed.x3d"])
def test_segments_through_a_file_weld_again(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    h = body(name, None if name == "person" else request.getfixturevalue("shared"))
    cut = vt.segment(h)
    scene, _ = scene_of([cut], version="2.0")
    assert {f.rule for f in check(scene) if f.severity != "note"} == set()
    write_x3d(scene, tmp_path / "cut.x3d")
    (read,) = humanoids(read_x3d(tmp_path / "cut.x3d"))
    a, b = (next(s for g in x.segments() for s in g.shapes) for x in (cut, read))
    np.testing.assert_allclose(a.normals, b.normals, atol=1e-6)
    back = vt.weld(read)
    assert len(back.skin) == len(h.skin)
    matrices = poses(h)
    drawn = np.unique(np.concatenate([s.triangles for s in h.skin]))
    again = np.unique(np.concatenate([s.triangles for s in back.skin]))
    places, found = (np.unique(h.skin_coord[rows].astype(np.float32), axis=0) for rows in (drawn, again))
    np.testing.assert_array_equal(places, found)
    drawn = np.intersect1d(drawn, again)
    before, after = (vt.deformer("linear", vt.pack(x))(matrices)[:, drawn] for x in (h, back))
    np.testing.assert_allclose(before, after, atol=2e-6)
    assert sorted(d.name for d in back.displacers()) == sorted(d.name for d in h.displacers())


def test_rigid_segments_become_a_skin(shared: Path) -> None:
    h = body("JinLOA1.x3d", shared)
    h.joint("skullbase").segments[0].displacers = [
        Displacer("nod_action", np.array([3, 1], np.int32), np.array([[0, 0.1, 0], [0, 0, 0.2]]))
    ]
    whole = vt.weld(h)
    assert all(not g.shapes and not g.displacers for g in whole.segments())
    assert sum(len(s.triangles) for s in whole.skin) == sum(len(s.triangles) for g in h.segments() for s in g.shapes)
    total = np.zeros(len(whole.skin_coord))
    for joint in whole.joints():
        np.add.at(total, joint.skin_coord_index, joint.skin_coord_weight)
    np.testing.assert_array_equal(total, 1)
    matrices = poses(h)
    for x in (h, whole):
        x_body = vt.pack(x)
        corners = vt.deformer("linear", x_body)(matrices)[:, x_body.skin.triangles].reshape(3, -1, 9)
        key = np.sort(np.round(corners.sum(axis=2), 3), axis=1)
        if x is h:
            before = key
    np.testing.assert_allclose(before, key, atol=2e-3)
    (nod,) = whole.joint("skullbase").displacers
    model = h.joint("skullbase").segments[0].shapes[0]
    placed = turned(model).points[[3, 1]]
    np.testing.assert_allclose(whole.skin_coord[nod.coord_index], placed)


def test_pieces_of_one_joint_share_their_border() -> None:
    h = typed(1, skin=False)
    home = h.joint("l_hip").segments[0]
    first = home.shapes[0]
    other = Shape("other", np.array([[0, 1, 2]], np.int32), points=first.points[[0, 1, 3]].copy())
    home.shapes.append(other)
    whole = vt.weld(h)
    assert len(whole.skin_coord) == 4 * len(h.joints())
    rows = next(s for s in whole.skin if s.name == "other").triangles
    np.testing.assert_array_equal(whole.skin_coord[rows[0]], other.points)


def test_a_figure_with_skin_and_segments_keeps_both() -> None:
    h = typed(1)
    ball = Shape("ball", np.array([[0, 1, 2]], np.int32), points=np.eye(3))
    home = h.joint("skullbase").segments[0]
    home.shapes = [ball]
    home.displacers = [Displacer("own_action", np.array([2], np.int32), np.ones((1, 3)))]
    h.joint("skullbase").displacers[0].coord_index = h.joint("skullbase").skin_coord_index[:2].astype(np.int32)
    cut = vt.segment(h)
    assert [s.name for s in cut.joint("skullbase").segments[0].shapes] == ["ball"]
    (own,) = cut.joint("skullbase").segments[0].displacers
    assert own.name == "own_action"
    (blink,) = cut.joint("skullbase").segments[1].displacers
    np.testing.assert_array_equal(blink.coord_index, [0, 1])
    assert len(h.joint("skullbase").displacers) == 1  # the original stays as it was
    back = vt.weld(cut)
    assert len(back.skin_coord) == len(h.skin_coord) + 3
    assert {d.name for d in back.joint("skullbase").displacers} == {"own_action", "blink_action"}


QUADS = """<X3D profile="Immersive" version="4.0"><Scene><HAnimHumanoid name="q" version="2.0">
<HAnimJoint name="humanoid_root" containerField="skeleton"><HAnimSegment name="sacrum"><Shape><IndexedFaceSet
 coordIndex="0 1 2 -1 0 2 3 4 -1 4 3 5 6 -1 1 7 2 -1" texCoordIndex="0 1 2 -1 0 2 3 4 -1 7 8 5 6 -1 1 7 2 -1">
<Coordinate point="0 0 0 1 0 0 1 1 0 0 1 0 -1 1 0 0 2 0 -1 2 0 2 1 0"/>
<TextureCoordinate point="0 0 1 0 1 1 0 1 0 .5 .5 .5 .2 .2 .3 .3 .4 .4"/></IndexedFaceSet></Shape></HAnimSegment>
</HAnimJoint></HAnimHumanoid></Scene></X3D>"""


def test_quads_stay_quads_and_come_first() -> None:
    (h,) = humanoids(parse_x3d(QUADS.encode(), "q.x3d"))
    scene, _ = scene_of([h], version="2.0")
    (faces_node,) = [n for n in scene.walk() if n.type == "IndexedFaceSet"]
    index, uv = faces_node.fields["coordIndex"], faces_node.fields["texCoordIndex"]
    np.testing.assert_array_equal([len(p.split()) for p in " ".join(map(str, index)).split("-1")], [4, 4, 3, 3, 0])
    np.testing.assert_array_equal(np.flatnonzero(index == -1), np.flatnonzero(uv == -1))
    (again,) = humanoids(scene)
    a, b = (x.segments()[0].shapes[0] for x in (h, again))
    np.testing.assert_array_equal(faces([a]), faces([b]))
    corners = lambda s: {  # noqa: E731
        tuple(sorted(zip(map(int, p), map(int, u)))) for p, u in zip(s.triangles, s.uv_triangles)
    }
    assert corners(a) == corners(b)
    assert len(np.unique(b.faces)) == 4
    whole = vt.weld(h).skin[0]
    np.testing.assert_array_equal(whole.faces, a.faces)
    h.segments()[0].shapes[0].uv_triangles[2, 0] = 5  # a seam of the texture inside a quad keeps its triangles
    scene, _ = scene_of([h], version="2.0")
    (faces_node,) = [n for n in scene.walk() if n.type == "IndexedFaceSet"]
    assert (faces_node.fields["coordIndex"] == -1).sum() == 5


def test_texture_coordinates_go_on_over_borders() -> None:
    """Every corner of a face keeps its place in the picture, so that no seam shows where the skin was cut."""

    def corners(shapes: list[Shape], skin: np.ndarray | None = None) -> np.ndarray:
        rows = []
        for s in shapes:
            points = s.points if s.points is not None else skin
            if s.uv is not None and points is not None:
                charts = s.uv_triangles if s.uv_triangles is not None else s.triangles
                rows.append(np.hstack([points[s.triangles].reshape(-1, 3), s.uv[charts].reshape(-1, 2)]))
        out = np.concatenate(rows)
        return out[np.lexsort(out.T)]

    h = person()
    cut = vt.segment(h)
    homes = [s for home in cut.segments() for s in home.shapes if s.uv is not None]
    assert len(homes) > 30
    np.testing.assert_array_equal(corners(homes), corners(h.skin, h.skin_coord))
    welded = vt.weld(cut)
    np.testing.assert_array_equal(corners(welded.skin, welded.skin_coord), corners(h.skin, h.skin_coord))
