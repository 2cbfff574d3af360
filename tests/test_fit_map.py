"""Ease, strain, pressure and girths of garments: closed forms on a tube round a cylinder; what a tight shirt says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vitruvian.cloth.fabric import FABRICS
from vitruvian.cloth.fit_map import PRESSED, evened, fit_map, gradients, limit_of, principal, pulls
from vitruvian.cloth.garment import Garment
from vitruvian.cloth.girths import Ring, girths
from vitruvian.cloth.obstacle import still
from vitruvian.cloth.pattern import Edge, Panel, Pattern, Seam, Span
from vitruvian.cloth.tessellate import tessellate, welded
from vitruvian.errors import VitruvianError

RUBBER = replace(FABRICS["jersey"], name="rubber", poisson=0.0, density=0.01)


def cylinder(radius: float, high: float = 0.5, around: int = 96, along: int = 24):
    """A closed cylinder about Y, outwards: vertices, triangles."""
    turn = 2 * np.pi * np.arange(around) / around
    ring = np.stack([np.cos(turn), np.zeros(around), -np.sin(turn)], axis=1) * radius
    levels = np.linspace(0, high, along + 1)
    v = [ring + [0, y, 0] for y in levels] + [np.array([[0, 0, 0], [0, high, 0]])]
    i, j = np.meshgrid(np.arange(around), np.arange(along), indexing="ij")
    a, b = j * around + i, j * around + (i + 1) % around
    t = [np.stack([a, b, b + around], -1).reshape(-1, 3), np.stack([a, b + around, a + around], -1).reshape(-1, 3)]
    k, top = np.arange(around), along * around
    t += [np.stack([(k + 1) % around, k, np.full(around, len(levels) * around)], -1)]
    t += [np.stack([top + k, top + (k + 1) % around, np.full(around, len(levels) * around + 1)], -1)]
    return np.concatenate(v), np.concatenate(t).astype(np.int32)


def tube(radius: float, girth: float, *, high: float = 0.3, rise: float = 0.1, size: float = 0.01, fabric=RUBBER):
    """A rectangle of cloth, `girth` wide, sewn into a tube and laid on a cylinder about Y."""
    corners = np.array([[0, 0], [girth, 0], [girth, high], [0, high]])
    panel = Panel("tube", corners, tuple(Edge(i, (i + 1) % 4) for i in range(4)))
    pattern = Pattern("tube", (panel,), (Seam((Span("tube", 1),), (Span("tube", 3),)),))
    mesh = tessellate(pattern, size)
    weld = welded(mesh)
    flat = np.empty((weld.max() + 1, 2))
    flat[weld] = mesh.material
    turn = 2 * np.pi * flat[:, 0] / girth
    x = np.stack([radius * np.sin(turn), rise + flat[:, 1], radius * np.cos(turn)], axis=1)
    return Garment(pattern, mesh, weld, x, (fabric,), np.eye(4)[None])


def ring(radius: float, height: float, count: int = 400) -> Ring:
    turn = 2 * np.pi * np.arange(count) / count
    return Ring(np.stack([radius * np.sin(turn), np.full(count, height), radius * np.cos(turn)], axis=1))


@pytest.mark.parametrize("strain", [0.05, 0.2])
def test_a_stretched_tube_presses_as_laplace_says(strain):
    radius = 0.1
    garment = tube(radius, 2 * np.pi * radius / (1 + strain))
    found = fit_map(garment, still(*cylinder(radius - 0.002)))
    tension = RUBBER.stretch_u * strain  # N per metre of the tube's length
    inner = np.abs(garment.vertices[:, 1] - 0.25) < 0.12
    assert np.allclose(found.weft, strain, rtol=0.02) and np.abs(found.warp).max() < 0.01
    assert np.allclose(found.stretch[:, 0], strain, rtol=0.02)
    assert np.median(found.tension) == pytest.approx(tension, rel=0.02)
    assert np.mean(found.pressure[inner]) == pytest.approx(tension / radius, rel=0.02)
    assert np.quantile(np.abs(found.pressure[inner] - tension / radius), 0.9) < 0.1 * tension / radius
    assert found.ease == pytest.approx(0.002, abs=2e-4)


def test_what_wrinkles_does_not_pull():
    wide = tube(0.1, 1.1 * 2 * np.pi * 0.1)  # pushed together by a tenth
    force, tension = pulls(wide.sheet, gradients(wide.sheet, wide.vertices), len(wide.vertices))
    assert np.abs(force).max() < 1e-3 * RUBBER.stretch_u * 0.1 and tension.max() < 1.0
    tight = tube(0.1, 0.5)
    force, _ = pulls(tight.sheet, gradients(tight.sheet, tight.vertices), len(tight.vertices))
    assert np.abs(force.sum(axis=0)).max() < 1e-9  # it pulls on itself, not on the world


def test_noise_of_the_solver_is_evened_out_and_what_is_even_stays():
    garment = tube(0.1, 0.55)
    f, area = gradients(garment.sheet, garment.vertices), garment.sheet.areas
    same = evened(np.tile(f[:1], (len(f), 1, 1)), garment.mesh.triangles, area)
    assert np.abs(same - f[0]).max() < 1e-9
    noise = np.random.default_rng(1).normal(0, 0.05, len(f))
    before, after = (
        principal(g)[0]
        for g in (f * (1 + noise)[:, None, None], evened(f * (1 + noise)[:, None, None], garment.mesh.triangles, area))
    )
    assert after.std() < 0.3 * before.std() and after.mean() == pytest.approx(before.mean(), rel=0.01)


def test_pulls_are_the_slope_of_the_energy():
    """In a sheet that is stretched everywhere nothing is left out, so that forces are -dU/dx."""
    fabric = FABRICS["cotton"]
    garment = tube(0.1, 0.55, size=0.03, fabric=fabric)
    sheet = garment.sheet
    x = garment.vertices * [1, 1.05, 1]
    k = np.linalg.inv([[1 / fabric.stretch_u, -fabric.poisson / fabric.stretch_u],
                       [-fabric.poisson / fabric.stretch_u, 1 / fabric.stretch_v]])  # fmt: skip

    def energy(x):
        f = gradients(sheet, x)
        c = np.stack([np.linalg.norm(f[:, :, 0], axis=1) - 1, np.linalg.norm(f[:, :, 1], axis=1) - 1], -1)
        shear = np.sum(f[:, :, 0] * f[:, :, 1], axis=1)
        return float((0.5 * sheet.areas * (np.einsum("mi,ij,mj->m", c, k, c) + fabric.shear * shear**2)).sum())

    force, _ = pulls(sheet, gradients(sheet, x), len(x))
    for v in (3, 40, 77):
        for axis in range(3):
            step = np.zeros_like(x)
            step[v, axis] = 1e-6
            slope = (energy(x + step) - energy(x - step)) / 2e-6
            assert -slope == pytest.approx(force[v, axis], rel=0.03, abs=0.02 * np.abs(force[v]).max())


def test_girths_of_the_cloth_and_of_the_body():
    garment = tube(0.1, 0.7)
    found = girths(garment.sheet, garment.vertices, {"waist": ring(0.09, 0.25), "knee": ring(0.09, 0.05)})
    assert set(found) == {"waist"}  # it does not reach the knee
    g = found["waist"]
    assert g.body == pytest.approx(2 * np.pi * 0.09, rel=1e-3) and g.worn == pytest.approx(2 * np.pi * 0.1, rel=1e-3)
    assert g.cloth == pytest.approx(0.7, rel=1e-6) and g.ease == pytest.approx(0.7 - g.body)
    aside = Ring(ring(0.03, 0.25).points + [0.06, 0, 0])  # a leg in a skirt
    assert not girths(garment.sheet, garment.vertices, {"thigh": aside})
    tilted = ring(0.09, 0.0).points @ np.array([[1, 0, 0], [0, 0.96, -0.28], [0, 0.28, 0.96]]).T + [0, 0.25, 0]
    assert girths(garment.sheet, garment.vertices, {"waist": Ring(tilted)})["waist"].cloth > 0.7
    with pytest.raises(VitruvianError, match="tape"):
        Ring(np.zeros((2, 3)))


def test_what_is_too_tight_is_said_in_words():
    radius = 0.1
    garment = tube(radius, 2 * np.pi * radius / 1.5, fabric=replace(RUBBER, stretch_u=900.0, stretch_v=900.0))
    v, t = cylinder(radius - 0.002)
    regions = np.where(v[:, 1] > 0.25, "chest", "waist")
    found = fit_map(garment, still(v, t), regions=regions, rings={"waist": ring(radius, 0.2)})
    said = found.summary()
    assert said["all"]["pressure_kpa"]["mean"] > PRESSED / 1000 and said["all"]["contact"] > 0.99
    assert set(said["regions"]) == {"chest", "waist"} and set(said["panels"]) == {"tube"}
    assert said["all"]["strain_percent"]["mean"] == pytest.approx(50, rel=0.02)
    first = found.findings()[0]
    assert {f.region for f in found.findings()} == {"chest", "waist"} and "tube at the" in "".join(said["findings"])
    assert (
        first.severity > 1
        and "weft" in said["findings"][-1] + said["findings"][0]
        and "kPa" in "".join(said["findings"])
    )
    assert any(m.startswith("too small at the waist: the cloth measures 41.9 cm") for m in said["findings"])
    easy = fit_map(
        tube(radius, 2 * np.pi * radius * 1.02), still(v, t), regions=regions, rings={"waist": ring(0.098, 0.2)}
    )
    assert not easy.findings() and easy.girths["waist"].ease > 0
    with pytest.raises(VitruvianError, match="regions"):
        fit_map(garment, still(v, t), regions=regions[:5])


def test_knits_may_stretch_more_than_wovens():
    assert limit_of(FABRICS["cotton"]) == 0.05 and limit_of(FABRICS["jersey"]) > 0.2
