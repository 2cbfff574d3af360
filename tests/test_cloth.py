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
from vitruvian.cloth.intersections import intersections
from vitruvian.cloth.obstacle import neighbours, still
from vitruvian.cloth.sheet import Sheet, strains
from vitruvian.cloth.sheet import sides as sides_of
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
    ours = step(cloth, step(cloth, state, **options), **options)
    monkeypatch.setattr(solver, "kernels", lambda: None)
    twin = step(cloth, step(cloth, state, **options), **options)
    assert np.abs(ours.x - twin.x).max() < 2e-5 and np.abs(ours.x - state.x).max() > 1e-3


@kernel
def test_what_is_near_is_what_the_twin_finds():
    from vitruvian.cloth.touch_numpy import cloth_cuts, near_cloth

    rng = np.random.default_rng(3)
    points = rng.random((60, 3)).astype(np.float32) * 0.2
    triangles = np.concatenate([rng.permutation(60).reshape(-1, 3) for _ in range(3)]).astype(np.int32)
    edges, sides = sides_of(triangles)
    x = np.column_stack([points, np.ones(60)]).astype(np.float32)
    same = np.arange(60, dtype=np.int32)
    same[5] = 4
    keys, known = np.zeros((0, 2), np.int32), np.zeros(0, np.float32)
    native, limits = kernels(), np.array([0.012, 0.01, 0.015, 0.01], np.float32)
    plan = native.near_plan(x, triangles, edges, sides)
    v = rng.normal(size=(60, 4)).astype(np.float32)
    ours, theirs = (
        f(x, v, triangles, edges, sides, same, limits, keys, known, plan) for f in (native.near_cloth, near_cloth)
    )
    assert len(ours[1]) > 20 and all(np.array_equal(a, b) for a, b in zip(ours, theirs))
    assert len(ours[0]) > len(native.near_cloth(x, 0 * v, triangles, edges, sides, same, limits, keys, known, plan)[0])
    flipped = native.near_cloth(
        x, v, triangles, edges, sides, same, limits, ours[2], -ours[3], plan
    )  # remembered sides stay
    assert np.array_equal(flipped[2], ours[2]) and np.array_equal(flipped[3], -ours[3])
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


@pytest.mark.parametrize("size", [0.03, 0.02])
def test_momentum_and_angular_momentum_stay(size):
    sheet, x = strip(0.2, 0.2, size)
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
    assert np.abs((masses * fast).sum(axis=0) - linear).max() < 1e-3 * np.linalg.norm(linear)
    assert np.abs(np.cross(now - centre, masses * fast).sum(axis=0) - angular).max() < 5e-3 * np.linalg.norm(angular)


def pulled(sheet, x, pull):
    """Strain along y of the middle of a strip, about the origin, whose ends are pulled apart with `pull` N/m."""
    tall = x[:, 1].max()
    low, high = np.flatnonzero(x[:, 1] < 1e-9 - tall), np.flatnonzero(x[:, 1] > tall - 1e-9)
    cloth = assemble(sheet)
    state = cloth.state(x)
    way = np.zeros((len(x), 3), np.float32)
    for some, sign in ((low, -1), (high, 1)):
        share = np.gradient(np.sort(x[some, 0]))[np.argsort(np.argsort(x[some, 0]))]
        share[[np.argmin(x[some, 0]), np.argmax(x[some, 0])]] /= 2
        way[some, 1] = sign * pull * share / sheet.masses[some]
    dt = 1 / 4000
    for _ in range(3000):
        state = replace(state, v=state.v + dt * way)
        state = step(cloth, state, dt=dt, substeps=1, gravity=NONE, damping=30.0)
    middle = np.abs(x[:, 1]) < 0.4 * tall
    return np.polyfit(x[middle, 1], state.x[middle, 1], 1)[0] - 1


@pytest.mark.parametrize("size", [0.03, 0.02, 0.015])
@pytest.mark.parametrize(
    ("grain", "modulus", "pull"), [(0.0, 500.0, 4.0), (np.pi / 2, 1000.0, 4.0), (np.pi / 4, 317.46, 1.0)]
)
def test_a_strip_pulled_is_as_stiff_as_its_fabric_in_that_direction(grain, modulus, pull, size):
    """Eu 1000, Ev 500, nu 0.2, G 100 N/m; along the bias 1/E = c^4/Eu + s^4/Ev + (1/G - 2 nu/Eu) s^2 c^2. Heavy, so that
    steps can be long, which single precision asks for; what it is at rest does not hang on that."""
    more = {"stretch_u": 1000.0, "stretch_v": 500.0, "shear": 100.0, "poisson": 0.2, "density": 3.0}
    sheet, x = strip(0.06, 0.24, size, grain=grain, **more)
    assert pull / pulled(sheet, x - [0.03, 0.12, 0], pull) == pytest.approx(modulus, rel=0.02)


def bent(size, angle, **more):
    """Energy of a strip bent round a cylinder of 0.4 m whose axis lies at `angle` to the weft, over 1/2 B k^2 A."""
    sheet, x = strip(0.5, 0.5, size, **more)
    index, rest = hinges(sheet)
    radius, way = 0.4, np.array([np.cos(angle), np.sin(angle)])
    along = x[:, :2] @ way
    across = x[:, :2] @ [-way[1], way[0]]
    p = np.stack([radius * np.sin(along / radius), across, radius * np.cos(along / radius)], axis=1)
    c = np.einsum("hk,hkx->hx", rest[:, :4], p[index])
    b_u, b_v = sheet.fabrics[0].bend_u, sheet.fabrics[0].bend_v
    energy = np.sum(np.sum(c * c, axis=1) / rest[:, 4]) / 2
    stiff = b_u * way[0] ** 2 + b_v * way[1] ** 2
    return energy / (0.5 * stiff / radius**2 * sheet.areas.sum())


@pytest.mark.parametrize("angle", [0.0, 0.4, 0.8, 1.2, np.pi / 2])
def test_the_energy_of_a_bent_cylinder(angle):
    """The same in every direction, in meshes as panels have; on a lattice see test_cloth_bending.py."""
    coarse, fine = (bent(size, angle, bend_u=1e-5, bend_v=1e-5) for size in (0.02, 0.012))
    assert fine == pytest.approx(1, abs=0.03) and coarse == pytest.approx(1, abs=0.07)


@pytest.mark.parametrize("size", [0.025, 0.018])
def test_a_cloth_falls_over_a_ball_and_stays_outside(size):
    sheet, x = strip(0.6, 0.6, size, density=0.2)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.15)
    obstacle = still(np.array(ball.vertices), np.array(ball.faces, np.int32))
    cloth = assemble(sheet, gap=0.002)
    start = np.stack([x[:, 0] - 0.3, np.full(len(x), 0.16), x[:, 1] - 0.3], axis=1)
    state = settled(cloth, cloth.state(start), 1.5, obstacle=obstacle)
    assert (obstacle.distances(state.x) > 0).all() and state.x[:, 1].min() < -0.05
    assert np.quantile(np.abs(strains(sheet, state.x)), 0.99) < 0.05


@pytest.mark.parametrize("size", [0.02, 0.014])
@pytest.mark.parametrize("slides", [False, True])
def test_cloth_slides_on_a_slope_that_is_steeper_than_its_friction(slides, size):
    """30 degrees, from rest, 1 s: g (sin a - mu cos a) / 2 = 1.178 m with mu 0.3, nothing with mu 0.7."""
    mu, angle = (0.3, np.radians(30)) if slides else (0.7, np.radians(30))
    board = trimesh.creation.box(extents=[8.0, 0.2, 2.0])
    obstacle = still(np.array(board.vertices) - [0, 0.1, 0], np.array(board.faces, np.int32))
    sheet, x = strip(0.1, 0.1, size, friction_body=mu)
    cloth = assemble(sheet)
    start = np.stack([x[:, 0], np.full(len(x), obstacle.offset), x[:, 1]], axis=1)
    gravity = (9.81 * np.sin(angle), -9.81 * np.cos(angle), 0.0)
    state = settled(cloth, cloth.state(start), 1.0, obstacle=obstacle, gravity=gravity, damping=0.0)
    way = state.x[:, 0].mean() - start[:, 0].mean()
    assert (
        way == pytest.approx(9.81 / 2 * (np.sin(angle) - mu * np.cos(angle)), rel=0.05) if slides else abs(way) < 1e-3
    )


def test_two_cloths_stay_apart():
    """Nothing goes through; of the 600 edges at most four cut a triangle, where one cloth bends over the other's rim."""
    one, x = strip(0.2, 0.2, 0.02)
    count = one.count
    both = Sheet(
        np.concatenate([one.triangles, one.triangles + count]), np.tile(one.material, (2, 1, 1)),
        np.zeros(2 * len(one.triangles), int), one.fabrics,
    )  # fmt: skip
    flat = np.stack([x[:, 0], np.zeros(len(x)), x[:, 1]], axis=1)
    middle, c, s = flat.mean(axis=0), np.cos(0.3), np.sin(0.3)
    start = np.concatenate([flat, (flat - middle) @ [[c, 0, s], [0, 1, 0], [-s, 0, c]] + middle + [0, 0.03, 0]])
    cloth = assemble(both, pinned=np.arange(count), gap=0.003)
    state = settled(cloth, cloth.state(start), 1.0)
    upper = state.x[count:]
    over = (upper[:, [0, 2]] > 0.01).all(axis=1) & (upper[:, [0, 2]] < 0.19).all(axis=1)
    assert len(intersections(state.x, both.triangles)) <= 4
    assert upper[over, 1].min() > 0.002 and upper[over, 1].max() < 0.03


def test_the_same_twice_and_whatever_else_is_there():
    sheet, x = strip(0.2, 0.2, 0.02)
    cloth = assemble(sheet, pinned=[0], gap=0.002)
    one, two = (settled(cloth, cloth.state(x), 0.3) for _ in range(2))
    assert np.array_equal(one.x, two.x)


def test_colours_share_no_vertex_and_groups_keep_everything():
    rng = np.random.default_rng(0)
    c = np.array([rng.choice(40, 3, replace=False) for _ in range(100)])
    colour = colours(c, 40)
    for k in range(colour.max() + 1):
        own = c[colour == k].ravel()
        assert len(np.unique(own)) == len(own)
    made = grouped(c.astype(np.int32), np.arange(100.0)[:, None], 40)
    real = made.index[:, 0] < 40
    assert np.array_equal(np.sort(made.rest[:, 0][real]), np.arange(100))


def test_neighbours_of_triangles():
    t = np.array([[0, 1, 2], [2, 1, 3], [0, 2, 4]], np.int32)
    assert neighbours(t).tolist() == [[-1, 1, 2], [0, -1, -1], [0, -1, -1]]


def test_fabrics_by_name_and_by_measure():
    assert fabric("cotton jersey").name == "jersey" and fabric("Denim").stretch_v == 6000
    with pytest.raises(VitruvianError, match="did you mean denim"):
        fabric("denin")
    with pytest.raises(VitruvianError, match="density"):
        replace(FABRICS["silk"], density=-1.0)
    with pytest.raises(VitruvianError, match="poisson"):
        Fabric("x", 0.2, 100.0, 4000.0, 20.0, 1e-6, 1e-6, 1e-3, 0.3, 0.3, poisson=0.5)
    # note cloth.md, section 11: 150 g/m2, bending length 1.5, 2, 3 cm
    assert [1e6 * bending_from_length(0.15, c) for c in (0.015, 0.02, 0.03)] == pytest.approx(
        [4.966, 11.772, 39.730], rel=1e-4
    )


def test_what_the_solver_refuses():
    sheet, x = strip(0.1, 0.1, 0.02)
    cloth = assemble(sheet)
    with pytest.raises(VitruvianError, match="positions"):
        cloth.state(x[:-1])
    with pytest.raises(VitruvianError, match="positions: expected finite numbers"):
        cloth.state(np.where(x == x[3], np.nan, x))
    with pytest.raises(VitruvianError, match="pinned: expected indices"):
        assemble(sheet, pinned=[len(x)])
    with pytest.raises(VitruvianError, match="substeps"):
        step(cloth, cloth.state(x), substeps=0)
    with pytest.raises(VitruvianError, match="material of triangle 0: expected an area"):
        Sheet(sheet.triangles, sheet.material * 0, sheet.fabric, (COTTON,))
