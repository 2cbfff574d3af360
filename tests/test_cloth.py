"""The cloth solver against closed forms, its twin and its invariants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from cloth_maker import COTTON, strip
from vitruvian.cloth import solver
from vitruvian.cloth.constraints import colours, grouped, hinges
from vitruvian.cloth.fabric import FABRICS, Fabric, bending_from_length, fabric
from vitruvian.cloth.obstacle import neighbours, still
from vitruvian.cloth.sheet import Sheet, strains
from vitruvian.cloth.solver import Pairs, assemble, step
from vitruvian.errors import VitruvianError
from vitruvian.native import kernels

NONE = (0.0, 0.0, 0.0)
kernel = pytest.mark.skipif(kernels() is None, reason="the extension vitruvian._native is not built: pip install .")


def settled(cloth, state, seconds, **options):
    for _ in range(round(60 * seconds)):
        state = step(cloth, state, **options)
    return state


@kernel
def test_the_kernel_is_its_twin(monkeypatch):
    sheet, x = strip(0.12, 0.1, 0.02)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    obstacle = still(np.array(ball.vertices) + [0.06, -0.055, 0.05], np.array(ball.faces, np.int32))
    x = np.stack([x[:, 0], 0.001 * np.sin(40 * x[:, 0]), x[:, 1]], axis=1)
    pairs = Pairs(np.array([[0, len(x) - 1]], np.int32), np.array([0.15]), np.array([0.14]), 1e-4)
    cloth = assemble(sheet, pinned=[1], gap=0.002)
    state = cloth.state(x, np.random.default_rng(0).normal(size=x.shape) * 0.05)
    options = {"substeps": 5, "pairs": pairs, "obstacle": obstacle, "targets": x[[1]] + 0.001}
    ours = step(cloth, state, **options)
    monkeypatch.setattr(solver, "kernels", lambda: None)
    twin = step(cloth, state, **options)
    assert np.abs(ours.x - twin.x).max() < 1e-5 and np.abs(ours.x - state.x).max() > 1e-3


@kernel
def test_what_is_near_is_what_the_twin_finds():
    from vitruvian.cloth.touch_numpy import cloth_cuts, near_cloth

    rng = np.random.default_rng(3)
    points = rng.random((60, 3)).astype(np.float32) * 0.2
    triangles = np.array([rng.choice(60, 3, replace=False) for _ in range(50)], np.int32)
    edges = np.unique(np.sort(triangles[:, :2], axis=1), axis=0).astype(np.int32)
    x = np.column_stack([points, np.ones(60)]).astype(np.float32)
    same = np.arange(60, dtype=np.int32)
    same[5] = 4
    keys, sides = np.zeros((0, 2), np.int32), np.zeros(0, np.float32)
    native = kernels()
    ours, theirs = (f(x, triangles, edges, same, 0.02, keys, sides) for f in (native.near_cloth, near_cloth))
    assert ours[2] == theirs[2] > 20 and all(np.array_equal(a, b) for a, b in zip(ours, theirs))
    flipped = native.near_cloth(x, triangles, edges, same, 0.02, ours[3], -ours[1][: ours[2]])  # remembered sides stay
    assert np.array_equal(flipped[1][: ours[2]], -ours[1][: ours[2]])
    cuts = native.cloth_cuts(x, triangles, edges, same)
    assert len(cuts) > 20 and np.array_equal(cuts, cloth_cuts(x, triangles, edges, same))


def test_free_fall_is_that_of_the_symplectic_step():
    sheet, x = strip(0.1, 0.1, 0.02)
    cloth = assemble(sheet)
    state, h = cloth.state(x), 1 / 1200
    for _ in range(12):
        state = step(cloth, state, damping=0)
    t = 12 / 60
    assert state.x[:, 1] - x[:, 1] == pytest.approx(-9.81 * t * (t + h) / 2, abs=1e-5)


def test_momentum_and_angular_momentum_stay():
    sheet, x = strip(0.2, 0.2, 0.02)
    cloth, masses = assemble(sheet), sheet.masses[:, None]
    middle = (masses * x).sum(axis=0) / masses.sum()
    v = np.cross([0.3, 2.0, 1.0], x - middle) + [0.2, 0.1, -0.3]
    state = cloth.state(x, v)
    linear = (masses * v).sum(axis=0)
    angular = np.cross(x - middle, masses * v).sum(axis=0)
    for _ in range(30):
        state = step(cloth, state, gravity=NONE, damping=0)
    now, fast = state.x.astype(float), state.v.astype(float)
    centre = (masses * now).sum(axis=0) / masses.sum()
    assert np.abs((masses * fast).sum(axis=0) - linear).max() < 1e-4 * np.linalg.norm(linear)
    assert np.abs(np.cross(now - centre, masses * fast).sum(axis=0) - angular).max() < 5e-3 * np.linalg.norm(angular)


@pytest.mark.parametrize("size", [0.02, 0.0125])
def test_a_cloth_hangs_under_its_own_weight(size):
    """1 m, 0.2 kg/m2, 1000 N/m: longer by w g L^2 / (2 E) = 0.981 mm (note cloth.md, section 11)."""
    sheet, x = strip(0.1, 1.0, size, stretch_u=1000.0, stretch_v=1000.0, poisson=0.0, density=0.2)
    top = np.flatnonzero(x[:, 1] > 1 - 1e-9)
    cloth = assemble(sheet, pinned=top)
    state = settled(cloth, cloth.state(x), 4, damping=12.0)
    low = np.flatnonzero(x[:, 1] < 1e-9)
    assert -state.x[low, 1].mean() == pytest.approx(0.981e-3, rel=0.02)


@pytest.mark.parametrize(("grain", "modulus"), [(0.0, 500.0), (np.pi / 2, 1000.0), (np.pi / 4, 317.46)])
def test_a_strip_pulled_is_as_stiff_as_its_fabric_in_that_direction(grain, modulus):
    """Eu 1000, Ev 500, nu 0.2, G 100 N/m; along the bias 1/E = c^4/Eu + s^4/Ev + (1/G - 2 nu/Eu) s^2 c^2."""
    more = {"stretch_u": 1000.0, "stretch_v": 500.0, "shear": 100.0, "poisson": 0.2}
    sheet, x = strip(0.1, 0.4, 0.0125, grain=grain, **more)
    low, high = np.flatnonzero(x[:, 1] < 1e-9), np.flatnonzero(x[:, 1] > 0.4 - 1e-9)
    pull, width = 2.0, 0.1  # N/m
    cloth = assemble(sheet)
    v = np.zeros_like(x)
    state = cloth.state(x, v)
    share = np.full(len(high), width / (len(high) - 1))
    share[[np.argmin(x[high, 0]), np.argmax(x[high, 0])]] /= 2
    force = pull * share / sheet.masses[high], pull * share / sheet.masses[low]
    for _ in range(360):  # pulled at both ends by accelerating the ends
        fast = state.v.copy()
        fast[high, 1] += force[0] / 1200
        fast[low, 1] -= force[1] / 1200
        state = step(cloth, replace(state, v=fast.astype(np.float32)), dt=1 / 1200, substeps=1, gravity=NONE, damping=20.0)
    for _ in range(360):
        fast = state.v.copy()
        fast[high, 1] += force[0] / 1200
        fast[low, 1] -= force[1] / 1200
        state = step(cloth, replace(state, v=fast.astype(np.float32)), dt=1 / 1200, substeps=1, gravity=NONE, damping=60.0)
    middle = (x[:, 1] > 0.12) & (x[:, 1] < 0.28)
    strain = np.polyfit(x[middle, 1], state.x[middle, 1], 1)[0] - 1
    assert pull / strain == pytest.approx(modulus, rel=0.03)
