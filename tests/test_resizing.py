"""The body changes its shape, its garment follows: note cloth.md, section 8."""

from __future__ import annotations

import numpy as np
import pytest

import vitruvian as vt
from test_dressing import skirt
from test_fit_map import RUBBER, cylinder, tube
from vitruvian.cloth.binding import bind
from vitruvian.cloth.fit_map import fit_map, gradients, principal
from vitruvian.cloth.obstacle import still
from vitruvian.cloth.resizing import displaced, firmed, graded, moved, refitted, settled, standing
from vitruvian.cloth.sheet import strains
from vitruvian.cloth.tailor import tailor
from vitruvian.errors import VitruvianError


def test_nothing_moves_where_the_body_does_not():
    v, t = cylinder(0.1)
    garment = tube(0.102, 0.7)
    assert np.array_equal(moved(garment, v, v.copy(), t).vertices, garment.vertices)
    assert graded(moved(garment, v, v.copy(), t), garment).graded is None


@pytest.mark.parametrize("scale", [0.9, 1.15])
def test_graded_with_the_body_the_gap_stays(scale):
    v, t = cylinder(0.1)
    garment = tube(0.106, 0.7)
    made = graded(moved(garment, v, scale * v, t), garment)
    gap = still(v, t).distances(garment.vertices)
    assert np.abs(still(scale * v, t).distances(made.vertices) - gap).max() < 1e-6
    assert np.allclose(strains(made.sheet, made.vertices), strains(garment.sheet, garment.vertices), atol=2e-3)
    now, then = (principal(gradients(g.sheet, g.vertices))[2] for g in (made, garment))
    assert np.abs(now - then).max() < 1e-9
    around = made.sheet.areas.sum() / garment.sheet.areas.sum()
    assert around == pytest.approx(
        scale * (0.1 * scale + 0.006) / 0.106, rel=1e-3
    )  # ease in mm is kept, not in per cent


def test_a_tight_tube_on_a_thicker_cylinder_is_stretched():
    v, t = cylinder(0.1, around=192)
    garment = tube(0.1002, 2 * np.pi * 0.1002)
    made = moved(garment, v, v * [1.1, 1, 1.1], t)
    weft = principal(gradients(made.sheet, made.vertices))[0]
    assert weft.mean() == pytest.approx(0.1, abs=1e-3) and np.abs(weft - 0.1).max() < 0.01
    assert made.graded is None


def test_settled_it_presses_as_laplace_says():
    v, t = cylinder(0.1)
    garment = tube(0.103, 2 * np.pi * 0.1, size=0.02)
    body = still(v * [1.1, 1, 1.1], t)
    made = settled(moved(garment, v, v * [1.1, 1, 1.1], t), body, 0.5)
    assert made.report["penetrating_vertices"] == 0 and "settled" in made.report
    strain = 0.112 / 0.1 - 1  # 2 mm off the skin
    found = fit_map(firmed(made, body), body)
    press = found.pressure[np.abs(made.vertices[:, 1] - 0.25) < 0.12]
    assert press.mean() == pytest.approx(RUBBER.stretch_u * strain / 0.112, rel=0.03)
    assert np.quantile(np.abs(press - press.mean()), 0.95) < 0.05 * press.mean()
    assert np.mean(found.weft) == pytest.approx(strain, rel=0.03) and found.weft.max() < 1.1 * strain
    rough = fit_map(made, body)  # as it was draped
    assert rough.weft.max() > found.weft.max()


def test_what_hangs_free_follows_its_border():
    v, t = cylinder(0.1)
    garment = tube(0.102, 0.7, high=0.3)
    x = garment.vertices.copy()
    far = x[:, 1] > 0.25
    x[far, 0] *= 1 + 8 * (x[far, 1] - 0.25)
    x[far, 2] *= 1 + 8 * (x[far, 1] - 0.25)
    bound = bind(v, t, x)
    assert (bound.distance > 0.05).any()
    shift = displaced(bound, garment.sheet, v, v + [0.01, 0, 0.02])
    assert np.abs(shift - [0.01, 0, 0.02]).max() < 1e-9  # harmonic between the same is the same
    grown = displaced(bound, garment.sheet, v, v * [1.2, 1, 1.2])
    size = np.linalg.norm(grown, axis=1)
    assert size[bound.distance > 0.05].max() <= size[bound.distance <= 0.05].max() + 1e-9


def test_binding_is_exact_and_turns_with_the_skin():
    v, t = cylinder(0.1)
    x = tube(0.11, 0.7).vertices
    bound = bind(v, t, x)
    assert np.abs(bound.at(v) - x).max() < 1e-12
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    assert np.abs(bound.at(v @ turn.T + 1) - (x @ turn.T + 1)).max() < 1e-12


@pytest.fixture(scope="module")
def people():
    return [vt.pack(vt.person(outfit=None, hair="none", measures=m)) for m in (None, {"hips": 1.12, "waist": 0.98})]


@pytest.fixture(scope="module")
def made(people):
    return tailor(skirt(), people[0], size=0.025)


def test_a_skirt_follows_its_wearer(people, made):
    slim, stout = people
    assert np.array_equal(refitted(made, slim, slim).vertices, made.vertices)
    larger = refitted(made, slim, stout, policy="grade")
    kept = refitted(made, slim, stout)
    assert larger.report["penetrating_vertices"] == 0 and kept.report["penetrating_vertices"] == 0
    assert larger.report["strain_p99"] < made.report["strain_p99"] + 0.01 < kept.report["strain_p99"]
    before, after = (still(d.vertices, d.triangles) for d in (standing(made, slim), standing(made, stout)))
    tight = before.distances(made.vertices) < 0.004
    assert np.quantile(np.abs(after.distances(larger.vertices) - before.distances(made.vertices))[tight], 0.95) < 0.002
    assert larger.sheet.areas.sum() > 1.02 * made.sheet.areas.sum() == pytest.approx(1.02 * kept.sheet.areas.sum())


def test_another_body_is_refused(people, made):
    with pytest.raises(VitruvianError, match="joints it was sewn on"):
        refitted(made, people[0], vt.pack(vt.person(outfit=None, hair="none", loa=1)))
    with pytest.raises(VitruvianError, match="points that it was sewn on"):
        refitted(made, people[0], vt.pack(vt.person(outfit=None, hair="bob")))
    with pytest.raises(VitruvianError, match="policy"):
        refitted(made, people[0], people[1], policy="stretch")
