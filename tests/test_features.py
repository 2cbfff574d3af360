"""Feature points: 118 of 2.0 and 76 of 1.x, as Sites and as Displacers, both ways."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vitruvian as vt
from scene_figure import typed
from vitruvian.errors import VitruvianError
from vitruvian.hanim import tables
from vitruvian.modeling.features import feature_name
from vitruvian.modeling.person import person


def places(version: str) -> dict[str, np.ndarray]:
    """A place of its own for every point of a version."""
    names = list(tables.feature_points(version))
    return {n: np.array([k / 64, 1.0, -k / 128]) for k, n in enumerate(names)}


@pytest.mark.parametrize(
    ("version", "count", "encoding"), [("2.0", 118, "x3d"), ("1.0", 76, "x3d"), ("200x", 76, "wrl")]
)
def test_all_points_as_sites(tmp_path: Path, version: str, count: int, encoding: str) -> None:
    h = typed(3, version=version)
    h.joint("skullbase").segments[0].sites.clear()
    given = places(version)
    assert len(given) == count
    written = vt.add_feature_points(h, given)
    assert len(written) == count
    named = {s.name for s in h.all_sites()}
    assert {f"{n}_pt" for n in given} <= named
    vt.save(h, tmp_path / f"points.{encoding}", hanim=version)
    back = vt.feature_points(vt.load(tmp_path / f"points.{encoding}"))
    assert len(back) == len({feature_name(n) for n in given})
    for name, place in given.items():
        if sum(feature_name(n) == feature_name(name) for n in given) == 1:
            np.testing.assert_allclose(back[feature_name(name)], place, atol=1e-6)
    again = vt.add_feature_points(h, {"l_acromion": [9, 9, 9]})  # moves, does not double
    assert again == ["l_acromion"] and len({s.name for s in h.all_sites()}) == len(h.all_sites()) == len(named)
    np.testing.assert_array_equal(vt.feature_points(h)["l_acromion"], [9, 9, 9])


def test_points_hang_where_the_standard_says() -> None:
    h = typed(3)
    vt.add_feature_points(h, places("2.0"))
    owner = {s.name: g.name for g in h.segments() for s in g.sites}
    segments = {s.name for s in h.segments()}
    for name, point in tables.feature_points().items():
        if point.segment in segments:
            assert owner[f"{name}_pt"] == point.segment, name


def test_sites_to_displacers_and_back(tmp_path: Path) -> None:
    """The person's Sites become the nearest vertices of its skin, and these become Sites again."""
    h = person()
    before = vt.feature_points(h)
    assert len(before) > 70
    written = vt.add_feature_points(h, form="displacers")
    assert set(written) == set(before)
    features = [d for d in h.displacers() if d.name.endswith("_feature") and feature_name(d.name)]
    assert len(features) == len(written)
    for d in features:
        place = before[feature_name(d.name)]
        apart = np.linalg.norm(h.skin_coord - place, axis=1)
        assert apart[d.coord_index[0]] == apart.min() and apart.min() < 0.03, d.name
    for segment in h.segments():
        segment.sites.clear()
    only = vt.feature_points(h)
    assert set(only) == set(before)
    assert max(np.linalg.norm(only[n] - before[n]) for n in only) < 0.03
    assert set(vt.add_feature_points(h)) == set(before)
    assert {s.name.removesuffix("_pt") for s in h.all_sites()} == set(before)


def test_displacers_of_segments() -> None:
    """Without a skin the nearest vertex is one of the Segment's own geometry, in its own frame."""
    h = typed(1, skin=False)
    shape = h.joint("l_hip").segments[0].shapes[0]
    shape.transform = np.diag([2.0, 2.0, 2.0, 1.0])
    target = shape.points[2] * 2
    name = next(n for n, p in tables.feature_points().items() if p.segment == "l_thigh")
    assert vt.add_feature_points(h, {name: target + 0.001}, form="displacers") == [name]
    (d,) = [d for d in h.displacers() if d.name == f"{name}_feature"]
    assert d.coord_index.tolist() == [2]
    np.testing.assert_allclose(vt.feature_points(h)[name], target)


def test_names_and_errors() -> None:
    assert feature_name("r_axilla_post._pt") == feature_name("r_axilla_post_pt")
    assert feature_name("skull_vertex_view") is None and feature_name("nose_ring_pt") is None
    assert feature_name("rib10_midspine_pt") == "rib10_midspine"
    with pytest.raises(VitruvianError, match="nose_ring"):
        vt.add_feature_points(typed(1), {"nose_ring": [0, 0, 0]})
    with pytest.raises(VitruvianError, match="form"):
        vt.add_feature_points(typed(1), {}, form="words")
