"""Texture coordinates of contour bodies: kept by coarse levels of detail to the bit, and equal where surfaces meet."""

from __future__ import annotations

import warnings
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest

import vitruvian as vt
from vitruvian.body.types import Body
from vitruvian.errors import VitruvianWarning
from vitruvian.modeling.detail import coarser
from vitruvian.stage.actor import Actor


@pytest.fixture(scope="module", params=["person", "JinLOA1.x3d"])
def body(request):
    if request.param == "person":
        return vt.pack(vt.contours(vt.person(outfit="body suit", hair="none")))
    shared = request.getfixturevalue("shared")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", VitruvianWarning)
        return vt.pack(vt.contours(vt.load(shared / "data/hanim" / request.param)))


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


@pytest.mark.parametrize("step", [2, 4])
def test_a_coarse_level_has_the_texture_of_the_full_one(body, step):
    small, source = coarser(body, contours=step, points=step)
    full, few = looks(body), looks(small)
    assert len(few) < len(full) and len(small.skin.uv) < len(body.skin.uv)
    assert np.array_equal(np.unique(small.skin.uv_triangles), np.arange(len(small.skin.uv)))
    sewn = 0
    for place, by in few.items():
        for (part, surface), mine in by.items():
            if (part, surface) in full[place]:
                assert mine <= full[place][part, surface]
            else:  # between a coarse contour and what is sewn to all its points: it has what the contour has there
                assert surface < 0 and any(mine <= own for (p, s), own in full[place].items() if p == part and s >= 0)
                sewn += 1
    assert sewn > 20


@pytest.mark.parametrize("step", [1, 2, 4])
def test_texture_coordinates_are_equal_at_seams(body, step):
    """To the bit, where contours meet contours and where skin is sewn to them; heads of segments keep their own map."""
    small = body if step == 1 else coarser(body, contours=step, points=step)[0]
    met = defaultdict(int)
    for by in looks(small).values():
        surfaces: dict[int, set[bytes]] = defaultdict(set)
        for (_, surface), mine in by.items():
            surfaces[surface] |= mine
        if "skull_def" in {small.contours[s].name for s in surfaces if s >= 0}:
            continue
        if len(surfaces) > 1:
            assert set.intersection(*surfaces.values()), [small.contours[s].name for s in surfaces if s >= 0]
            met[min(surfaces) < 0] += 1
    assert met[True] > 40 and met[False] > 20  # what is sewn on; contours with contours


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
