"""Faces and points in another order and back; figures taken apart and put together; skins on smooth patches."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import vitruvian as vt
from test_decimate import counts, rows_of, sides, sphere
from vitruvian import VitruvianError, VitruvianWarning
from vitruvian.cli import app
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Shape
from vitruvian.modeling.parts import PARTS
from vitruvian.modeling.rearrange import first_use, quads_first
from vitruvian.modeling.rows import chosen
from vitruvian.modeling.smoother import smoother


@pytest.fixture(scope="module")
def person():
    return vt.person()


@pytest.fixture(scope="module")
def coarse():
    return vt.decimate(vt.person(hair="none"), 2000)


def open_edges(h):
    return int((counts(sides(h)) == 1).sum())


def same(a, b):
    """Two figures have the same skin, to the bit."""
    assert np.array_equal(a.skin_coord, b.skin_coord)
    assert [s.name for s in a.skin] == [s.name for s in b.skin]
    for s, t in zip(a.skin, b.skin, strict=True):
        for field in ("triangles", "uv", "uv_triangles", "colors", "faces"):
            one, two = getattr(s, field), getattr(t, field)
            assert (one is None) == (two is None), field
            assert one is None or np.array_equal(one, two), field
    for j, k in zip(a.joints(), b.joints(), strict=True):
        assert np.array_equal(j.skin_coord_index, k.skin_coord_index)
        assert np.array_equal(j.skin_coord_weight, k.skin_coord_weight)
    assert [d.name for d in a.displacers()] == [d.name for d in b.displacers()]
    for d, e in zip(a.displacers(), b.displacers(), strict=True):
        assert np.array_equal(d.coord_index, e.coord_index) and np.array_equal(d.displacements, e.displacements)


def test_quads_come_first_and_keep_their_order():
    faces = [[0, 1, 2], [3, 4, 5, 6], [7, 8, 9, 9], [1, 2, 3, 4]]
    made, quads, perm = quads_first(faces)
    assert quads == 2 and perm.tolist() == [1, 3, 0, 2]
    assert made.tolist() == [[3, 4, 5, 6], [1, 2, 3, 4], [0, 1, 2, 2], [7, 8, 9, 9]]
    again = made[np.argsort(perm)]
    assert [list(dict.fromkeys(f)) for f in again.tolist()] == [list(dict.fromkeys(f)) for f in faces]
    assert first_use(made, 11).tolist() == [3, 4, 5, 6, 1, 2, 0, 7, 8, 9, 10]


def test_larger_faces_are_cut_into_fans():
    with pytest.warns(VitruvianWarning, match="1 of 2 faces have more than four corners"):
        made, quads, perm = quads_first([[0, 1, 2, 3, 4], [5, 6, 7, 8]])
    assert quads == 1 and perm.tolist() == [1, 0, 0, 0]
    assert made[1:].tolist() == [[0, 1, 2, 2], [0, 2, 3, 3], [0, 3, 4, 4]]
    with pytest.raises(VitruvianError, match="face 1: expected three or more corners"):
        quads_first([[0, 1, 2], [3, 4, 4, 4]])


def test_nothing_is_a_list_of_faces_too():
    made, quads, perm = quads_first([])
    assert made.shape == (0, 4) and quads == 0 and len(perm) == 0


def mixed():
    """A ball whose polygons are quads and triangles in turns, with weights, colours and a displacer."""
    ball = sphere()
    rng = np.random.default_rng(5)
    count = len(ball.skin_coord)
    for n, s in enumerate(ball.skin):
        order = rng.permutation(len(s.triangles) // 2)  # pairs that belong together, in any order
        rows = np.stack([2 * order, 2 * order + 1], axis=1).ravel()
        numbers = np.repeat(np.arange(len(order)), 2)
        alone = rng.random(len(order)) < 0.3
        numbers = np.where(np.repeat(alone, 2), 1000 + np.arange(len(rows)), numbers).astype(np.int32)
        ball.skin[n] = replace(
            s,
            triangles=s.triangles[rows],
            uv_triangles=s.uv_triangles[rows],
            faces=numbers,
            colors=rng.random((count, 3)),
        )
    some = rng.permutation(count)[:100].astype(np.int32)
    ball.skeleton[0].displacers = [Displacer("bump", some, rng.normal(size=(100, 3)))]
    return ball


def test_a_rearranged_skin_is_the_same_surface_and_comes_back():
    h = mixed()
    made = vt.rearrange(h)
    for s, t, quads, perm in zip(h.skin, made.humanoid.skin, made.quads, made.triangle_perm, strict=True):
        assert np.array_equal(h.skin_coord[s.triangles[perm]], made.humanoid.skin_coord[t.triangles])
        assert np.array_equal(s.uv[s.uv_triangles[perm]], t.uv[t.uv_triangles])
        size = np.bincount(t.faces)
        assert quads > 50 and (size[:quads] == 2).all() and (size[quads:] == 1).all()
        assert np.array_equal(t.faces, np.sort(t.faces))
    flat = np.concatenate([s.triangles for s in made.humanoid.skin]).ravel()
    _, first = np.unique(flat, return_index=True)
    assert np.array_equal(flat[np.sort(first)], np.arange(len(first)))  # numbered by first use
    back = chosen(made.humanoid, np.argsort(made.vertex_perm))
    for n, (s, perm) in enumerate(zip(h.skin, made.triangle_perm, strict=True)):
        undo, t = np.argsort(perm), back.skin[n]
        back.skin[n] = replace(t, triangles=t.triangles[undo], uv_triangles=t.uv_triangles[undo], faces=s.faces)
    order = np.argsort(back.displacers()[0].coord_index)
    known = np.argsort(h.displacers()[0].coord_index)
    assert np.array_equal(back.displacers()[0].displacements[order], h.displacers()[0].displacements[known])
    for f in (back, h):
        f.skeleton[0].displacers = []
        j = f.skeleton[0]
        j.skin_coord_index = np.sort(j.skin_coord_index)
    same(back, h)


def test_points_that_come_twice_are_refused():
    with pytest.raises(VitruvianError, match="each point at most once"):
        chosen(sphere(), np.array([1, 2, 2]))
    with pytest.raises(VitruvianError, match="rows: expected numbers of skin points"):
        chosen(sphere(), np.array([1, 10**6]))


def test_parts_join_to_the_figure_to_the_bit(person):
    parts = vt.split(person)
    assert list(parts) == ["body", *PARTS]
    assert sum(len(t) for p in parts.values() for t in p.triangles) == sum(len(s.triangles) for s in person.skin)
    same(vt.join(parts), person)
    tips = {"l_hand": "l_carpal_distal_phalanx_2", "head": "l_eyeball_joint", "r_foot": "r_metatarsophalangeal_1"}
    for name, joint in tips.items():
        rows = rows_of(person.joints(), len(person.skin_coord))
        names = [j.name for j in person.joints()]
        held = np.flatnonzero(rows[:, names.index(joint)] > 0.6) if joint in names else []
        used = np.intersect1d(held, np.concatenate([s.triangles for s in person.skin]))
        assert joint not in names or np.isin(used, parts[name].rows).all()


def test_a_part_stays_away_when_it_is_not_joined(person):
    parts = vt.split(person, ["head"])
    body = vt.join({"body": parts["body"]})
    used = np.unique(np.concatenate([s.triangles for s in body.skin]))
    assert body.skin_coord[used, 1].max() < person.joint("skullbase").center[1] + 0.03
    assert "brows" not in [s.name for s in body.skin]


@pytest.mark.parametrize("points", [900, 300])
def test_a_coarser_hand_is_sewn_on_without_a_gap(person, points):
    parts = vt.split(person, ["l_hand"])
    hand = vt.decimate(parts["l_hand"].humanoid, points)
    made = vt.join(parts | {"l_hand": hand})
    edges = sides(made)
    assert open_edges(made) == open_edges(person)
    assert counts(edges).max() == 2 and np.unique(edges, axis=0, return_counts=True)[1].max() == 1
    assert len(made.skin_coord) < len(person.skin_coord) - 1500 + points
    assert np.abs(rows_of(made.joints(), len(made.skin_coord)).sum(axis=1) - 1).max() < 1e-6


def test_the_head_of_another_person_is_sewn_on(person):
    parts = vt.split(person, ["head"])
    other = vt.split(vt.person(gender=0.8, height=1.68, hair="none"), ["head"])
    made = vt.join(parts | {"head": other["head"]})
    edges = sides(made)
    gap = [len(p.rim) for p in (parts["body"], other["head"])]
    assert min(gap) > 40
    (seam,) = [s for s in made.skin if s.name == "seam"]
    assert len(seam.triangles) == sum(gap)  # one triangle for each edge of both rims
    assert counts(edges).max() == 2 and np.unique(edges, axis=0, return_counts=True)[1].max() == 1
    mine = open_edges(vt.join({"body": parts["body"]})) - gap[0]
    assert open_edges(made) == mine + int((counts(sides(other["head"].humanoid)) == 1).sum()) - gap[1]
    assert {d.name for d in made.displacers()} == {d.name for d in person.displacers()}
    body = vt.pack(made)
    assert np.isfinite(vt.deformer("log", body)(vt.joint_matrices(body.skeleton, vt.walk(body.skeleton))[:3])).all()


def test_parts_of_somebody_much_larger_are_brought_to_the_cuts(person):
    large = vt.person(gender=1.0, height=1.9, weight=0.8, hair="none")
    names = ["head", "l_hand"]
    parts, other = vt.split(person, names), vt.split(large, names)
    made = vt.join(parts | {n: other[n] for n in names})
    edges = sides(made)
    assert counts(edges).max() == 2 and np.unique(edges, axis=0, return_counts=True)[1].max() == 1
    width = 0.0
    for seam in (s for s in made.skin if s.name.startswith("seam")):
        corner = made.skin_coord[seam.triangles]
        width = max(width, float(np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).min(axis=1).max()))
    assert width < 0.012  # both edges are one line, nearly
    for root, inner in (("skullbase", "l_eyeball_joint"), ("l_radiocarpal", "l_carpal_distal_interphalangeal_2")):
        at = [h.joint(inner).center - h.joint(root).center for h in (made, large, person)]
        assert np.allclose(at[0], at[1]) and not np.allclose(at[0], at[2])
        assert np.allclose(made.joint(root).center, person.joint(root).center)
    tip = [next(s for s in h.all_sites() if s.name == "l_carpal_distal_phalanx_2_tip") for h in (made, large)]
    wrist = [h.joint("l_radiocarpal").center for h in (made, large)]
    assert np.allclose(*(s.center + s.translation - w for s, w in zip(tip, wrist, strict=True)))
    before = person.joint("l_eyeball_joint").center.copy()
    assert np.allclose(vt.split(person, ["head"])["head"].humanoid.joint("l_eyeball_joint").center, before)


def test_what_cannot_be_split_or_joined_is_said(person):
    with pytest.raises(VitruvianError, match="part nose: expected one of head, l_hand"):
        vt.split(person, ["nose"])
    with pytest.raises(VitruvianError, match="has no joint l_radiocarpal"):
        vt.split(sphere(), ["l_hand"])
    with pytest.raises(VitruvianError, match="expected a skin to split"):
        vt.split(Humanoid("bare", skeleton=[Joint("humanoid_root")]))
    parts = vt.split(person, ["l_hand"])
    with pytest.raises(VitruvianError, match='expected a piece "body"'):
        vt.join({"l_hand": parts["l_hand"]})
    away = parts["l_hand"].humanoid.copied()
    away.skin_coord = away.skin_coord + [0.5, 0, 0]
    with pytest.raises(VitruvianError, match="move it there"):
        vt.join(parts | {"l_hand": away})


def cube():
    points = np.array([[x, y, z] for z in (0.0, 1) for y in (0, 1) for x in (0, 1)])
    quads = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])
    triangles = quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3).astype(np.int32)
    shape = Shape("cube", triangles, faces=np.repeat(np.arange(6), 2).astype(np.int32), colors=np.clip(points, 0, 1))
    top = Joint("vl5", skin_coord_index=np.arange(4, 8, dtype=np.int32), skin_coord_weight=np.ones(4))
    root = Joint(
        "humanoid_root", joints=[top], skin_coord_index=np.arange(4, dtype=np.int32), skin_coord_weight=np.ones(4)
    )
    top.displacers = [Displacer("shift", np.arange(8, dtype=np.int32), np.tile([0.0, 1, 2], (8, 1)))]
    return Humanoid("cube", skeleton=[root], skin=[shape], skin_coord=points)


@pytest.mark.parametrize("quads", [True, False])
@pytest.mark.parametrize("level", [1, 2, 3])
def test_a_finer_surface_is_closed_and_carries_what_it_had(quads, level):
    h = cube()
    if not quads:
        h.skin[0] = replace(h.skin[0], faces=None)
    made = smoother(h, level=level)
    assert (counts(sides(made)) == 2).all()
    assert len(np.unique(made.skin[0].faces)) == (6 * 4**level if quads else 12 * 3 * 4 ** (level - 1))
    assert np.abs(rows_of(made.joints(), len(made.skin_coord)).sum(axis=1) - 1).max() < 1e-9
    (d,) = made.displacers()  # a shift of all points stays one
    assert len(d.coord_index) == len(made.skin_coord) and np.abs(d.displacements - [0, 1, 2]).max() < 1e-12
    middle = made.skin_coord - 0.5
    if quads:
        for turned in (middle[:, ::-1], -middle, middle[:, [1, 2, 0]]):  # as symmetric as a cube
            order = lambda p: p[np.lexsort(np.round(p, 9).T)]  # noqa: E731
            assert np.abs(order(turned) - order(middle)).max() < 1e-9


def test_flatness_is_reached_and_asks_for_less_where_less_is_needed(coarse):
    bare = sphere(8, 12)
    counts_ = [len(smoother(bare, level=None, tolerance=t).skin_coord) for t in (0.05, 0.01, 0.002)]
    assert counts_[0] < counts_[1] < counts_[2]
    fine = smoother(bare, level=None, tolerance=0.002)
    assert (counts(sides(fine)) == 2).all()
    h = vt.pack(smoother(coarse, level=1))
    assert np.isfinite(vt.deformer("log", h)(vt.joint_matrices(h.skeleton, vt.walk(h.skeleton))[:1])).all()


def test_no_level_changes_nothing_and_bad_wishes_are_refused():
    h = cube()
    same(smoother(h, level=0), h)
    with pytest.raises(VitruvianError, match="level, tolerance: expected one of them"):
        smoother(h, level=1, tolerance=0.1)
    with pytest.raises(VitruvianError, match="expected at most 3000000 faces"):
        smoother(sphere(60, 100), level=6)
    three = np.array([[0, 1, 6], [0, 1, 7]], np.int32)
    h.skin.append(Shape("fin", three))
    with pytest.raises(VitruvianError, match="edges of one or two faces, found"):
        smoother(h)


def test_the_commands_write_what_they_say(tmp_path, coarse):
    def run(*args):
        result = CliRunner().invoke(app, [*map(str, args), "--json"])
        assert result.exit_code == 0, (result.output, result.exception)
        return json.loads(result.stdout)

    vt.save(mixed(), tmp_path / "ball.x3d")
    found = run("rearrange", tmp_path / "ball.x3d", "-o", tmp_path / "ordered.x3d")
    assert sorted(found["vertex_perm"]) == list(range(len(vt.load(tmp_path / "ball.x3d").skin_coord)))
    found = run("subdivide", tmp_path / "ball.x3d", "--flatness", "20", "-o", tmp_path / "fine.x3d")
    assert found["points"] == len(vt.load(tmp_path / "fine.x3d").skin_coord) > 1000
    vt.save(coarse, tmp_path / "anna.x3d")
    found = run("split", tmp_path / "anna.x3d", "--parts", "head,r_hand", "-o", tmp_path / "p.x3d")
    assert list(found["parts"]) == ["body", "head", "r_hand"]
    run("join", tmp_path / "anna.x3d", "--part", f"r_hand={tmp_path / 'p-r_hand.x3d'}", "-o", tmp_path / "joined.x3d")
    assert open_edges(vt.load(tmp_path / "joined.x3d")) == open_edges(vt.load(tmp_path / "anna.x3d"))
    failed = CliRunner().invoke(
        app, ["join", str(tmp_path / "anna.x3d"), "--part", "head", "-o", str(tmp_path / "x.x3d")]
    )
    assert isinstance(failed.exception, VitruvianError) and "PART=FILE" in str(failed.exception)
