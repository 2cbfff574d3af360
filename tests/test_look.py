"""Brows and shoes of the built-in person."""

import numpy as np
import pytest

from vitruvian.modeling import source
from vitruvian.modeling.look import fine_part
from vitruvian.modeling.outfit import garment_part
from vitruvian.modeling.shape import Shape, shaped

BROWN = (0.3, 0.2, 0.1)
SHAPES = (Shape(), Shape(gender=0.0, age=12), Shape(gender=1.0, weight=1.0, age=75))


@pytest.mark.parametrize("shape", SHAPES)
def test_brow_hairs_stay_on_the_face_and_widen_where_they_are(shape):
    points = shaped(shape)[: source.POINTS]
    thin, thick = (fine_part("brows", points, BROWN, t) for t in (1.0, 1.5))
    pairs = [p.vertices.reshape(-1, 2, 3) for p in (thin, thick)]
    width = [np.linalg.norm(p[:, 0] - p[:, 1], axis=1) for p in pairs]
    assert np.allclose(width[1], 1.5 * width[0], atol=1e-12)
    assert np.allclose(pairs[0].mean(axis=1), pairs[1].mean(axis=1))
    assert np.allclose(np.asarray(thin.parents.sum(axis=1)), 1)
    assert np.abs(thin.vertices - thin.parents @ points).max() < 0.004


@pytest.mark.parametrize("shape", SHAPES)
def test_soles_are_flat_and_shoes_no_bigger_than_feet_want(shape):
    points = shaped(shape)[: source.POINTS]
    body = points[: source.BODY]
    shoes = garment_part("shoes", points, BROWN)
    height = shoes.vertices[:, 1] - (body[:, 1].min() - 0.017)
    assert -1e-9 < height.min() < 1e-9
    assert (height < 1e-9).sum() > 200
    feet = body[body[:, 1] < body[:, 1].min() + 0.06]
    assert (shoes.vertices.max(axis=0)[[0, 2]] < feet.max(axis=0)[[0, 2]] + 0.025).all()
    assert (shoes.vertices.max(axis=0)[[0, 2]] > feet.max(axis=0)[[0, 2]] - 0.004).all()
