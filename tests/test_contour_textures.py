"""Texture coordinates of contour bodies: every face on one island of the map, at coarse levels of detail and in files too,
and equal where surfaces meet."""

from __future__ import annotations

import warnings
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

import vitruvian as vt
from vitruvian.body.types import Body
from vitruvian.errors import VitruvianWarning
from vitruvian.modeling.detail import coarser
from vitruvian.stage.actor import Actor


@pytest.fixture(scope="module", params=["person", "JinLOA1.x3d"])
def figure(request):
    if request.param == "person":
        return vt.person(outfit="body suit", hair="none")
    shared = request.getfixturevalue("shared")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", VitruvianWarning)
        return vt.load(shared / "data/hanim" / request.param)


@pytest.fixture(scope="module")
def made(figure):
    return vt.contours(figure)


@pytest.fixture(scope="module")
def body(made):
    return vt.pack(made)


def smeared(original: Body, body: Body) -> dict[str, int]:
    """By part: how many faces, of contours and of what is sewn to them, have texture coordinates over four times as far
    apart as the map of the original is stretched near them (a chord over a hollow is thrice as far). `fixed` contours in
    the trunk, which nobody sees, are not counted."""
    of, near_of = (surface_faces(b.skin) for b in (body, original))
    hidden = np.zeros(len(body.skin.rest), bool)
    for s in body.contours:
        hidden[s.vertices[s.swing[:, 0] == 0]] = True
    points, first = body.skin.rest[body.skin.triangles], original.skin.rest[original.skin.triangles]
    spread, dense = longest(body.skin), longest(original.skin) / edge(first)
    out: dict[str, int] = {}
    for name, mine in of.items():
        there = near_of[name]
        tree = cKDTree(first[there].mean(axis=1))
        near = tree.query(points[mine].mean(axis=1), k=min(24, len(there)))[1].reshape(len(mine), -1)
        bad = spread[mine] > 4 * dense[there][near].max(axis=1) * edge(points[mine]) + 1e-9
        out[name] = int((bad & ~hidden[body.skin.triangles[mine]].any(axis=1)).sum())
    return {name: count for name, count in out.items() if count}


def edge(corners: np.ndarray) -> np.ndarray:
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)


def longest(skin) -> np.ndarray:
    return edge(skin.uv[skin.uv_triangles])


def surface_faces(skin) -> dict[str, np.ndarray]:
    """Triangles by the name of the material: surfaces in contours have it after their own."""
    out: dict[str, list[np.ndarray]] = defaultdict(list)
    for p in skin.parts:
        out[p.name.rpartition(" ")[2]].append(np.arange(p.start, p.stop))
    return {name: np.concatenate(rows) for name, rows in out.items()}


def owners(body: Body) -> np.ndarray:
    """(V,) the contour surface of each vertex, -1: none."""
    out = np.full(len(body.skin.rest), -1)
    for n, surface in enumerate(body.contours):
        out[surface.vertices] = n
    return out


def looks(body: Body) -> dict[bytes, dict[tuple[str, int], set[bytes]]]:
    """Place at rest -> by part and surface: the texture coordinates that corners there have, all as bits."""
    out: dict[bytes, dict[tuple[str, int], set[bytes]]] = defaultdict(lambda: defaultdict(set))
    skin, owner = body.skin, owners(body)
    for part in skin.parts:
        for v, c in zip(
            skin.triangles[part.start : part.stop].ravel().tolist(),
            skin.uv_triangles[part.start : part.stop].ravel().tolist(),
            strict=True,
        ):
            out[skin.rest[v].tobytes()][part.name, int(owner[v])].add(skin.uv[c].tobytes())
    return out


def test_no_face_is_smeared_over_a_border_of_the_map(figure, made, body):
    assert not smeared(vt.pack(figure), body)
    made = made.copied()
    for s in (c for g in made.segments() for c in g.contours):
        s.uv_corners = None
    assert sum(smeared(vt.pack(figure), vt.pack(made)).values()) > 100  # what coordinates of points alone would show


def test_no_face_has_become_a_line(made, body):
    """Welded points leave such faces, which `check` calls an error."""
    for triangles in [body.skin.triangles, *(s.triangles for s in made.skin)]:
        assert (triangles != np.roll(triangles, 1, axis=1)).all()


@pytest.mark.parametrize("step", [2, 4])
def test_no_face_of_a_coarse_level_is_smeared(figure, body, step):
    assert not smeared(vt.pack(figure), coarser(body, contours=step, points=step)[0])


@pytest.mark.parametrize("step", [2, 4])
def test_a_coarse_level_has_the_texture_of_the_full_one(body, step):
    small, source = coarser(body, contours=step, points=step)
    full, few = looks(body), looks(small)
    assert len(few) < len(full) and len(small.skin.uv) < len(body.skin.uv)
    assert np.array_equal(np.unique(small.skin.uv_triangles), np.arange(len(small.skin.uv)))
    whole: dict[tuple[str, int], set[bytes]] = defaultdict(set)
    for by in full.values():
        for key, own in by.items():
            whole[key] |= own
    sewn = same = bordering = 0
    for place, by in few.items():
        for (part, surface), mine in by.items():
            if (part, surface) in full[place]:
                kept, of = mine <= full[place][part, surface], [(part, surface)]
            else:  # between a coarse contour and what is sewn to all its points: it has what the contour has there
                assert surface < 0
                kept = any(mine <= own for (p, s), own in full[place].items() if p == part and s >= 0)
                of = [key for key in whole if key[0] == part and key[1] >= 0]
                sewn += 1
            assert any(mine <= whole[key] for key in of)
            same, bordering = same + kept, bordering + (not kept)  # wide faces keep to one side of a border of the map
    assert sewn > 20 and bordering < 0.1 * same


@pytest.mark.parametrize("step", [1, 2, 4])
def test_texture_coordinates_are_equal_at_seams(body, step):
    """To the bit, where contours meet contours and where skin is sewn to them, unless the map of the original has a border
    there, as that of a figure in segments between them; heads of segments keep their own map."""
    small = body if step == 1 else coarser(body, contours=step, points=step)[0]
    met, borders = defaultdict(int), 0
    for by in looks(small).values():
        surfaces: dict[int, set[bytes]] = defaultdict(set)
        for (_, surface), mine in by.items():
            surfaces[surface] |= mine
        if "skull_def" in {small.contours[s].name for s in surfaces if s >= 0}:
            continue
        if len(surfaces) > 1:
            met[min(surfaces) < 0] += 1
            if not set.intersection(
                *surfaces.values()
            ):  # a seam that is a border of the map: both sides keep their own
                each = [np.array([np.frombuffer(c) for c in own]) for own in surfaces.values()]
                assert step > 1 or np.linalg.norm(each[0][:, None] - each[1], axis=2).min() > 0.02
                borders += 1
    assert met[True] > 40 and met[False] > 20  # what is sewn on; contours with contours
    assert borders < (0.05 if "person" in body.name else 0.3) * (met[True] + met[False])


def test_a_body_without_textures_stays_without(body):
    plain = replace(body, skin=replace(body.skin, uv=None, uv_triangles=None))
    small, _ = coarser(plain, contours=2, points=2)
    assert small.skin.uv is None and small.skin.uv_triangles is None
    assert np.array_equal(small.skin.triangles, coarser(body, contours=2, points=2)[0].skin.triangles)


def test_levels_of_a_stage_are_textured(body):
    stage = vt.Stage([Actor("p", body, deformer="contours")])
    stage.send("level", "p", value=2)
    shown = stage.step()["p"].body
    assert len(shown.skin.rest) < len(body.skin.rest)
    assert shown.skin.uv_triangles.shape == shown.skin.triangles.shape
