"""Cloth against closed forms, at two resolutions each: the table of note cloth.md, section 11.

Bending: strips of equilateral triangles are held by two rows; rows bend as a chain does, whose first link begins half a row
behind the second row, so that the strip is as long as from there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cloth_maker import COTTON, lattice, strip
from vitruvian.cloth.fabric import Fabric
from vitruvian.cloth.obstacle import Obstacle, still
from vitruvian.cloth.solver import GRAVITY, Cloth, State, assemble, step, substeps_for
from vitruvian.native import kernels

pytestmark = pytest.mark.skipif(kernels() is None, reason="the extension vitruvian._native is not built: pip install .")
G, ROW = 9.81, np.sqrt(0.75)
NONE = (0.0, 0.0, 0.0)


def stiff(bend: float, density: float = 0.1, stretch: float = 2500.0) -> Fabric:
    even = {"stretch_u": stretch, "stretch_v": stretch, "shear": stretch / 3, "poisson": 0.0}
    return replace(COTTON, density=density, bend_u=bend, bend_v=bend, **even)


def at_rest(cloth: Cloth, state: State, seconds: float, **options) -> np.ndarray:
    for _ in range(round(60 * seconds)):
        state = step(cloth, state, **options)
    return state.x.astype(float)


# l/c, drop/l, chord and tip's slope in degrees; 2.00035 is Peirce's: his chord is 41.5 degrees
ELASTICA = (
    (0.5, 0.01562, 0.895, 1.193),
    (1.0, 0.12347, 7.1, 9.46),
    (1.5, 0.37354, 22.176, 29.361),
    (2.00035, 0.6408, 41.5, 53.87),
    (2.5, 0.79307, 56.892, 71.679),
    (3.0, 0.86355, 66.959, 81.602),
)


@pytest.mark.parametrize("rows", [8, 12, 16])
@pytest.mark.parametrize(("long", "drop", "chord", "slope"), ELASTICA)
def test_a_cantilever_bends_as_the_elastica(rows, long, drop, chord, slope):
    """c = (B / (w g))^(1/3) = 0.3 m; Peirce (1930). The shortest is too stiff for finer meshes: steps get too short for
    single precision."""
    c, w = 0.3, 0.03
    rows = rows // 4 + 4 if long == 0.5 else rows  # 6, 7 and 8
    edge = long * c / ((rows + 0.5) * ROW)
    sheet, x = lattice(8, rows + 1, edge, stiff(w * G * c**3, w, 300.0))
    cloth = assemble(sheet, pinned=np.flatnonzero(x[:, 2] < 1.5 * edge * ROW))
    now = at_rest(cloth, cloth.state(x), 2, damping=8.0, substeps=substeps_for(cloth, give=None))
    tip, last = (np.abs(x[:, 2] - x[:, 2].max() + back * edge * ROW) < 1e-6 for back in (0, 1))
    down, out = -now[tip, 1].mean() / (long * c), (now[tip, 2].mean() - 0.5 * edge * ROW) / (long * c)
    assert down == pytest.approx(drop, rel=0.02)
    assert np.degrees(np.arctan2(down, out)) == pytest.approx(chord, abs=1.0)
    way = now[tip].mean(axis=0) - now[last].mean(axis=0)
    assert np.degrees(np.arctan2(-way[1], way[2])) == pytest.approx(slope, abs=1.0)


@pytest.mark.parametrize("rows", [20, 30])
@pytest.mark.parametrize(
    ("span", "sag", "pull"),
    [(0.5, 0.398194, 0.513014), (0.6, 0.362782, 0.52595), (0.8, 0.265438, 0.603639), (0.9, 0.190709, 0.750803)],
)
def test_a_strip_that_does_not_bend_hangs_as_a_catenary(rows, span, sag, pull):
    """1 m long; sag, and the tension at its ends over its weight."""
    edge, w = 1 / (rows * ROW), 0.1
    sheet, x = lattice(3, rows, edge, stiff(0.0, w, 400.0))
    t = x[:, 2]
    ends = np.flatnonzero((t < 1e-9) | (t > 1 - 1e-9))
    cloth = assemble(sheet, pinned=ends)
    state, substeps = cloth.state(x), substeps_for(cloth, give=None)
    for k in range(240):  # the ends come together in a second
        near = x[ends] * [1, 1, 1 - (1 - span) * min(1.0, (k + 1) / 60)]
        state = step(cloth, state, damping=8.0, substeps=substeps, targets=near)
    now = state.x.astype(float)
    grown = 1 + w * G / 400 * 0.5  # about: it stretches by a thousandth
    mean = np.array([now[np.abs(t - k / rows) < 1e-6, 1:].mean(axis=0) for k in range(rows + 1)])
    assert -mean[rows // 2, 0] == pytest.approx(sag * grown, rel=0.01)
    way = mean[1] - mean[0]
    steep = abs(way[0]) / np.linalg.norm(way)
    middle = 0.5 * (1 - 1 / rows) / steep  # of the first link, which bears the half of the weight that is below it
    assert middle + 0.5 * abs(way[0]) == pytest.approx(pull, rel=0.01)


@pytest.mark.parametrize("size", [0.03, 0.02])
def test_a_cloth_hangs_under_its_own_weight(size):
    """1 m, 0.2 kg/m2, 1000 N/m: longer by w g L^2 / (2 E) = 0.981 mm."""
    sheet, x = strip(0.1, 1.0, size, stretch_u=1000.0, stretch_v=1000.0, poisson=0.0, density=0.2)
    cloth = assemble(sheet, pinned=np.flatnonzero(x[:, 1] > 1 - 1e-9))
    now = at_rest(cloth, cloth.state(x - [0, 1, 0]), 4, damping=8.0, substeps=substeps_for(cloth, give=None))
    assert -(now[x[:, 1] < 1e-9, 1] + 1).mean() == pytest.approx(0.981e-3, rel=0.02)


@pytest.mark.parametrize("rows", [10, 16])
@pytest.mark.parametrize("falls", [False, True])
def test_an_upright_strip_stands_up_to_greenhill_s_length(rows, falls):
    """l = 7.8373^(1/3) c = 1.98635 c; 0.95 of it stands, 1.05 falls, from a lean of 1 per cent."""
    c, w = 0.2, 0.1
    long = (1.05 if falls else 0.95) * 1.98635 * c
    edge = long / ((rows + 0.5) * ROW)
    sheet, x = lattice(3, rows + 1, edge, stiff(w * G * c**3))
    cloth = assemble(sheet, pinned=np.flatnonzero(x[:, 2] < 1.5 * edge * ROW))
    up = x[:, 2] - 0.5 * edge * ROW
    lean = np.where(up > edge, 0.01 * up**2 / long, 0.0)
    start = np.stack([x[:, 0], up, lean], axis=1)
    now = at_rest(cloth, cloth.state(start), 8, damping=1.0, substeps=substeps_for(cloth, give=None))
    aside = np.abs(now[up > up.max() - 1e-6, 2]).mean() / long
    assert aside > 0.3 if falls else aside < 0.15


@pytest.mark.parametrize("rows", [10, 16])
@pytest.mark.parametrize("load", [0.9, 1.1])
@pytest.mark.parametrize("bend_by", ["hinge", "shape"])
def test_a_strip_held_at_both_ends_buckles_at_euler_s_load(bend_by, load, rows):
    """4 pi^2 B / L^2; pressed by as much as makes 0.9 and 1.1 of that load. Below it a bow of a thousandth goes away; above
    it the strip bows out by what it was pressed. It bends over half a row more at each end than it is pressed over."""
    long, bend, stretch = 0.4, 2e-3, 40.0
    critical = 4 * np.pi**2 * bend / long**2 / stretch  # strain
    edge = long / ((rows + 1) * ROW)
    sheet, x = lattice(10, rows + 2, edge, stiff(bend, 0.1, stretch))
    z = x[:, 2]
    held = np.flatnonzero((z < 1.5 * edge * ROW) | (z > z.max() - 1.5 * edge * ROW))
    cloth = assemble(sheet, pinned=held, bend=bend_by)
    s = (z - 0.5 * edge * ROW) / long
    press = load * critical * rows * edge * ROW
    bow = 1e-3 * np.sin(np.pi * np.clip(s, 0, 1)) ** 2
    bow[held] = 0
    start = np.stack([x[:, 0], bow, z * (1 - load * critical)], axis=1)
    start[held, 2] = np.where(z[held] < long / 2, z[held], z[held] - press)
    substeps = substeps_for(cloth, give=None)
    now = at_rest(cloth, cloth.state(start), 6, damping=1.0, gravity=NONE, substeps=substeps)
    out = np.abs(now[:, 1]).max() / long
    expected = 2 / np.pi * np.sqrt(0.1 * critical)
    assert out == pytest.approx(expected, rel=0.25) if load > 1 else out < 0.5 * expected


@pytest.mark.parametrize("size", [0.03, 0.02])
def test_a_sheet_sinks_in_still_air_as_fast_as_its_drag_bears_it(size):
    """Flat: sqrt(2 w g / (rho Cd)) = 1.168 m/s with 0.1 kg/m2; a wind across a flat sheet drives it to its own speed."""
    sheet, x = strip(0.2, 0.2, size, density=0.1)
    cloth = assemble(sheet)
    falling, driven = (cloth.state(p) for p in (x[:, [0, 2, 1]], x))
    for _ in range(120):
        falling = step(cloth, falling, damping=0.0, wind=(0, 0, 0))
    for _ in range(300):
        driven = step(cloth, driven, damping=0.0, gravity=NONE, wind=(1.0, 0.0, 2.0))
    assert -falling.v[:, 1].mean() == pytest.approx(np.sqrt(2 * 0.1 * G / (1.2 * 1.2)), rel=0.02)
    assert driven.v[:, 2].mean() == pytest.approx(2.0, rel=0.1) and np.abs(driven.v[:, 0]).max() < 0.05


def energy(cloth: Cloth, state: State) -> float:
    """Joules of motion and height."""
    m, x, v = cloth.sheet.masses, state.x.astype(float), state.v.astype(float)
    return float(np.sum(m * (0.5 * np.sum(v * v, axis=1) + G * x[:, 1])))


@pytest.mark.parametrize("size", [0.03, 0.02])
def test_a_pendulum_loses_its_energy(size):
    """From the horizontal, damped: over windows of 0.5 s never more, until it hangs."""
    sheet, x = strip(0.1, 0.5, size, density=0.2)
    cloth = assemble(sheet, pinned=np.flatnonzero(x[:, 1] < 1e-9))
    state = cloth.state(x[:, [0, 2, 1]])
    seen = [energy(cloth, state)]
    for _ in range(360):
        state = step(cloth, state, damping=1.5)
        seen.append(energy(cloth, state))
    windows = np.mean(np.reshape(seen[1:], (12, 30)), axis=1)
    assert (np.diff(windows) < 2e-3 * abs(windows[0] - windows[-1])).all()
    hanging = -G * float(np.sum(sheet.masses * x[:, 1]))
    assert windows[-1] == pytest.approx(hanging, rel=0.02) and state.speed < 0.02


@pytest.mark.parametrize("size", [0.03, 0.02])
def test_turned_and_moved_with_gravity_it_is_the_same(size):
    sheet, x = strip(0.2, 0.2, size)
    cloth = assemble(sheet, pinned=[0])
    start = x + 0.01 * np.stack([np.zeros(len(x)), np.zeros(len(x)), np.sin(20 * x[:, 0])], axis=1)
    a, b = 0.7, 1.9
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1.0]])
    turn = turn @ np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    plain = at_rest(cloth, cloth.state(start), 0.1)
    other = at_rest(cloth, cloth.state(start @ turn.T + [0.1, -0.2, 0.1]), 0.1, gravity=tuple(turn @ GRAVITY))
    assert np.abs((other - [0.1, -0.2, 0.1]) @ turn - plain).max() < 1e-4


def drum(radius: float, count: int = 96, half: float = 0.1) -> Obstacle:
    """A round bar along x."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    ring = radius * np.stack([np.zeros(count), np.cos(angle), np.sin(angle)], axis=1)
    i = np.arange(count)
    j = (i + 1) % count
    near, far = np.full(count, 2 * count), np.full(count, 2 * count + 1)
    faces = [(i, j, i + count), (j, j + count, i + count), (near, j, i), (far, i + count, j + count)]
    vertices = np.concatenate([ring - [half, 0, 0], ring + [half, 0, 0], [[-half, 0, 0], [half, 0, 0]]])
    return still(vertices, np.concatenate([np.stack(f, axis=1) for f in faces]).astype(np.int32))


@pytest.mark.parametrize("edge", [0.03, 0.024, 0.02, 0.016])
@pytest.mark.parametrize("ratio", [2.44, 2.69])
def test_a_strap_round_a_bar_slides_beyond_euler_s_ratio(edge, ratio):
    """Capstan: half a turn with mu 0.3 holds up to exp(0.3 pi) = 2.5663; 5 per cent less rests, 5 per cent more slides."""
    bar, radius = drum(0.1), 0.1
    rows = round((np.pi * radius + 0.12) / (edge * ROW))
    sheet, x = lattice(2, rows, edge, replace(stiff(0.0, 0.2, 500.0), friction_body=0.3))
    s = x[:, 2] - 0.5 * rows * edge * ROW
    r, turn = radius + bar.offset, np.clip(s / radius, -np.pi / 2, np.pi / 2)
    start = np.stack([x[:, 0] - edge, r * np.cos(turn), r * np.sin(turn)], axis=1)
    start[:, 1] -= np.maximum(np.abs(s) - 0.5 * np.pi * radius, 0)
    cloth = assemble(sheet)
    state = cloth.state(start)
    ends = [np.flatnonzero(x[:, 2] < 1e-9), np.flatnonzero(x[:, 2] > x[:, 2].max() - 1e-9)]
    dt, moved = 1 / 1200, []
    for k in range(1500):
        v = state.v.copy()
        for end, force in zip(ends, (0.5, 0.5 * ratio)):
            v[end, 1] -= np.float32(min(1.0, k / 600) * force * dt / sheet.masses[end].sum())
        state = step(cloth, replace(state, v=v), dt=dt, substeps=6, gravity=NONE, damping=20.0, obstacle=bar)
        moved.append(float(state.x[ends[1], 1].mean()))
    slid = moved[1000] - moved[-1]
    assert slid > 1.0 if ratio > 2.5663 else slid < 2e-3  # it creeps a little where the step's rounding shakes it
