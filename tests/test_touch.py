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
