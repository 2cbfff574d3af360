"""Cloth that bends by the curvature of its triangles, `bend="shape"`: note cloth.md, section 4.3."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cloth_maker import COTTON, lattice
from vitruvian.cloth import solver
from vitruvian.cloth.constraints import hinges, shapes
from vitruvian.cloth.fabric import FABRICS
from vitruvian.cloth.sheet import Sheet
from vitruvian.cloth.solver import assemble, step, substeps_for
from vitruvian.errors import VitruvianError
from vitruvian.native import kernels

kernel = pytest.mark.skipif(kernels() is None, reason="the extension vitruvian._native is not built: pip install .")
ROW = np.sqrt(0.75)


def energy(held, x: np.ndarray) -> float:
    """Joules of constraints as `hinges` and `shapes` give them: half of the squares of their sums over their compliance."""
    index, rest = held
    at = np.append(x, [[0, 0, 0]], axis=0)[index]
    sums = rest[:, :-1].reshape(len(rest), -1, index.shape[1])
    return float(np.sum(np.einsum("miv,mvx->mix", sums, at) ** 2 / rest[:, -1, None, None]) / 2)


def curled(sheet: Sheet, angle: float, radius: float = 0.4) -> np.ndarray:
    """Vertices of a flat sheet on a cylinder bent along the direction at `angle` to the weft."""
    flat = np.zeros((sheet.count, 2))
    flat[sheet.triangles.ravel()] = sheet.material.reshape(-1, 2)
    way = np.array([np.cos(angle), np.sin(angle)])
    along, across = flat @ way, flat @ [-way[1], way[0]]
    return np.stack([across, radius * np.sin(along / radius), radius * np.cos(along / radius)], axis=1)


@pytest.mark.parametrize("ratio", [1.0, 5.0, 20.0])
@pytest.mark.parametrize("angle", [0.0, 0.4, 0.8, 1.2, np.pi / 2])
def test_the_energy_of_a_bent_cylinder_in_every_direction(angle, ratio):
    """1/2 (Bu c^2 + Bv s^2) / r^2 of its area: within 3 per cent, less in a finer mesh."""
    stiff = 1e-5 * (ratio * np.cos(angle) ** 2 + np.sin(angle) ** 2)
    off = []
    for count in (20, 41):
        sheet, _ = lattice(count, count, 0.5 / count, replace(COTTON, bend_u=1e-5 * ratio, bend_v=1e-5))
        true = 0.5 * stiff / 0.4**2 * sheet.areas.sum()
        if ratio == 1.0 and count == 41:  # without that, hinges are as good
            assert energy(hinges(sheet), curled(sheet, angle)) / true == pytest.approx(1, abs=0.02)
        off.append(energy(shapes(sheet), curled(sheet, angle)) / true - 1)
        if ratio == 20.0 and angle == 1.2:  # what this is for: hinges blur weft and warp
            assert energy(hinges(sheet), curled(sheet, angle)) / true > 1.5
    assert abs(off[1]) < 0.03 and abs(off[1]) < 0.75 * abs(off[0])


def test_a_flat_sheet_and_one_that_is_turned_have_no_energy():
    sheet, x = lattice(5, 6, 0.02, COTTON)
    some = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    bent = energy(shapes(sheet), curled(sheet, 0.3, 0.1))
    assert energy(shapes(sheet), x @ some.T + [0.1, 0.2, 0.3]) < 1e-12 * bent
    assert (
        len(shapes(Sheet(np.array([[0, 1, 2]]), sheet.material[:1], [0], (COTTON,)))[0]) == 0
    )  # nothing to bend about


# l/c, drop/l, chord in degrees: the elastica, note cloth.md, section 11
@pytest.mark.parametrize(("long", "drop", "chord"), [(1.5, 0.37354, 22.176), (2.00035, 0.6408, 41.5)])
@pytest.mark.parametrize("rows", [8, 12])
@pytest.mark.parametrize("way", ["warp", "weft"])
@kernel
def test_a_cantilever_of_a_fabric_five_times_as_stiff_along_its_weft(way, rows, long, drop, chord):
    """Peirce: c = (B / (w g))^(1/3), with the B of the direction; strips as wide as they are long."""
    angle = 0.0 if way == "warp" else np.pi / 2
    down, slope = hung(angle, 8, rows, long)
    assert down == pytest.approx(drop, rel=0.03) and slope == pytest.approx(chord, abs=1.0)


@pytest.mark.parametrize("rows", [24, 32])
@kernel
def test_a_cantilever_along_the_bias(rows):
    """Narrow, it twists as it likes: 1/B = c^4/Bv + s^4/Bu + c^2 s^2/Bt, Bt = (Bu + Bv) / 4."""
    down, slope = hung(np.pi / 4, 3, rows, 1.5)
    assert down == pytest.approx(0.37354, rel=0.03) and slope == pytest.approx(22.176, abs=1.0)


def hung(angle: float, width: int, rows: int, long: float) -> tuple[float, float]:
    """Drop over length, and slope of the chord in degrees, of a strip of `long` c at `angle` to the warp."""
    c, w, u, v = 0.15, 0.03, 5.0, 1.0
    cos, sin = np.cos(angle), np.sin(angle)
    one = w * 9.81 * c**3 * (cos**4 / v + sin**4 / u + 4 * cos**2 * sin**2 / (u + v))
    even = {"stretch_u": 500.0, "stretch_v": 500.0, "shear": 167.0, "poisson": 0.0}
    edge = long * c / ((rows + 0.5) * ROW)
    sheet, x = lattice(width, rows + 1, edge, replace(COTTON, density=w, bend_u=u * one, bend_v=v * one, **even))
    sheet = Sheet(sheet.triangles, sheet.material @ [[cos, sin], [-sin, cos]], sheet.fabric, sheet.fabrics)
    cloth = assemble(sheet, pinned=np.flatnonzero(x[:, 2] < 1.5 * edge * ROW))
    assert len(cloth.shapes.index) and not len(cloth.hinges.index)
    state, substeps = cloth.state(x), substeps_for(cloth, give=None)
    for _ in range(120):
        state = step(cloth, state, damping=8.0, substeps=substeps)
    tip = x[:, 2] > x[:, 2].max() - 1e-6
    down = -state.x[tip, 1].mean() / (long * c)
    return down, np.degrees(np.arctan2(down, (state.x[tip, 2].mean() - 0.5 * edge * ROW) / (long * c)))


@kernel
def test_the_kernel_is_its_twin(monkeypatch):
    sheet, x = lattice(6, 7, 0.02, replace(COTTON, bend_u=2e-4, bend_v=2e-5))
    x = x + 0.004 * np.random.default_rng(0).normal(size=x.shape)
    cloth = assemble(sheet, pinned=[0, 1])
    ours = step(cloth, cloth.state(x), substeps=5)
    flat = step(assemble(sheet, pinned=[0, 1], bend="hinge"), cloth.state(x), substeps=5)
    monkeypatch.setattr(solver, "kernels", lambda: None)
    twin = step(cloth, cloth.state(x), substeps=5)
    assert np.abs(ours.x - twin.x).max() < 1e-5 and np.abs(ours.x - flat.x).max() > 1e-4


def test_how_fabrics_bend():
    """All that are given by name differ by less than twice; what is asked for goes before what the fabric says."""
    assert {f.bends_by for f in FABRICS.values()} == {"hinge"}
    sheet, _ = lattice(3, 3, 0.02, COTTON)
    assert len(assemble(sheet).hinges.index) and len(assemble(sheet, bend="shape").shapes.index)
    with pytest.raises(VitruvianError, match="bend: expected hinge, shape or None, found curve"):
        assemble(sheet, bend="curve")
