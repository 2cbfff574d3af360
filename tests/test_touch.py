"""Cloth against cloth: it sticks and slides as on a slope, is not passed through, and one layer lies on the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cloth_maker import COTTON, strip
from vitruvian.cloth.intersections import intersections
from vitruvian.cloth.sheet import Sheet
from vitruvian.cloth.solver import assemble, step
from vitruvian.native import kernels

pytestmark = pytest.mark.skipif(kernels() is None, reason="the extension vitruvian._native is not built: pip install .")
GAP = 0.002


def layers(*sizes_and_places, friction: float = 0.4):
    """Flat pieces as one sheet that is not sewn: the sheet, positions, and the vertices of each."""
    triangles, material, places, ranges, count = [], [], [], [], 0
    for (width, height), at in sizes_and_places:
        sheet, x = strip(width, height, 0.02, friction_self=friction, damping=0.0)
        triangles.append(sheet.triangles + count)
        material.append(sheet.material)
        places.append(np.column_stack([x[:, 0], np.zeros(len(x)), x[:, 1]]) + at)
        ranges.append(np.arange(count, count + len(x)))
        count += len(x)
    faces = np.concatenate(triangles)
    cloth = replace(COTTON, friction_self=friction, damping=0.0)
    return (
        Sheet(faces, np.concatenate(material), np.zeros(len(faces), int), (cloth,)),
        np.concatenate(places),
        *ranges,
    )


@pytest.mark.parametrize(("friction", "slope"), [(0.0, 0.2), (0.4, 0.2), (0.4, 0.6)])
@pytest.mark.parametrize("substeps", [20, 40])
def test_a_layer_on_a_layer_sticks_or_slides_as_on_a_slope(friction, slope, substeps):
    lower, upper = ((0.6, 0.1), (0.0, 0.0, 0.0)), ((0.06, 0.06), (0.05, GAP, 0.02))
    sheet, x, low, high = layers(lower, upper, friction=friction)
    cloth, seconds = assemble(sheet, pinned=low, gap=GAP), 0.4
    state = cloth.state(x)
    gravity = (9.81 * np.sin(slope), -9.81 * np.cos(slope), 0.0)
    for _ in range(round(60 * seconds)):
        state = step(cloth, state, substeps=substeps, gravity=gravity)
    pull = max(0.0, 9.81 * (np.sin(slope) - friction * np.cos(slope)))
    expected = 0.5 * pull * seconds**2
    assert np.abs((state.x - x)[high, 0] - expected).max() < 0.01 * expected + 1e-5
    assert np.abs(state.x[high, 1] - GAP).max() < 0.02 * GAP


@pytest.mark.parametrize("speed", [1.0, 5.0, 20.0])
def test_what_falls_fast_does_not_pass_through(speed):
    sheet, x, low, high = layers(((0.2, 0.2), (0.0, 0.0, 0.0)), ((0.1, 0.1), (0.053, 0.01, 0.047)))
    v = np.zeros_like(x)
    v[high, 1] = -speed
    cloth = assemble(sheet, pinned=low, gap=GAP)
    state = cloth.state(x, v)
    for _ in range(60):
        state = step(cloth, state)
        assert not len(intersections(state.x, sheet.triangles, edges=sheet.edges))
        assert state.x[high, 1].min() > 0.5 * GAP
    assert np.abs(state.x[high, 1] - GAP).max() < 0.1 * GAP and state.speed < 1e-3


def test_beside_a_rim_cloth_is_not_lifted():
    sheet, x, low, high = layers(((0.1, 0.1), (0.0, 0.0, 0.0)), ((0.1, 0.1), (0.1 + 1.2 * GAP, 0.0, 0.0)))
    cloth = assemble(sheet, pinned=low, gap=GAP)
    state = step(cloth, cloth.state(x), gravity=(0, 0, 0))
    assert np.abs(state.x - x).max() < 1e-6


def crumpled(width: float, size: float):
    """A strip, rolled up and shaken: many parts near to others, moving."""
    sheet, x = strip(width, 0.4 * width, size)
    rng = np.random.default_rng(1)
    angle, r = 12 / width * x[:, 0], 0.01 + 0.05 * x[:, 0]
    place = np.stack([r * np.cos(angle), r * np.sin(angle), x[:, 1]], axis=1) + rng.normal(scale=1e-3, size=x.shape)
    rows = np.column_stack([place, np.ones(len(x))]).astype(np.float32)
    speed = np.column_stack([rng.normal(scale=0.5, size=x.shape), np.zeros(len(x))]).astype(np.float32)
    same = np.arange(len(x), dtype=np.int32)
    limits = np.array([0.0044, 0.025, 0.04, 0.003], np.float32)
    none = np.zeros((0, 2), np.int32), np.zeros(0, np.float32)
    plan = kernels().near_plan(rows, sheet.triangles, sheet.edges, sheet.sides)
    return sheet, (rows, speed, sheet.triangles, sheet.edges, sheet.sides, same, limits, *none, plan)


def test_nothing_that_is_near_is_missed():
    """Everything against everything finds the same, also in folds and where the cloth moves."""
    from vitruvian.cloth.touch_numpy import near_cloth

    sheet, arguments = crumpled(0.2, 0.014)
    flat = np.column_stack([sheet.material[:, 0], np.zeros((len(sheet.triangles), 2))]).astype(np.float32)
    other = kernels().near_plan(flat[np.resize(np.arange(len(flat)), sheet.count)], *arguments[2:5])  # a bad one
    ours, theirs = kernels().near_cloth(*arguments), near_cloth(*arguments)
    assert all(np.array_equal(a, b) for a, b in zip(ours, kernels().near_cloth(*arguments[:-1], other)))
    assert len(ours[1]) > 500 and len(ours[0]) - len(ours[1]) > 100
    assert all(np.array_equal(a, b) for a, b in zip(ours, theirs))


def test_any_number_of_threads_gives_the_same_bits():
    sheet, arguments = crumpled(0.7, 0.0055)
    one = kernels().near_cloth(*arguments, 1)
    cloth = assemble(sheet, gap=0.0004)
    start = cloth.state(arguments[0][:, :3], arguments[1][:, :3])
    alone = step(cloth, step(cloth, start, threads=1), threads=1)
    assert len(sheet.triangles) > 10_000 and len(one[0]) > 10_000 and len(alone.near) > 100
    for threads in (2, 4, 7):
        for a, b in zip(one, kernels().near_cloth(*arguments, threads)):
            assert a.tobytes() == b.tobytes()
        other = step(cloth, step(cloth, start, threads=threads), threads=threads)
        assert other.x.tobytes() == alone.x.tobytes() and other.v.tobytes() == alone.v.tobytes()
        assert other.near.tobytes() == alone.near.tobytes() and other.side.tobytes() == alone.side.tobytes()
