"""UsdSkel, an independent implementation, as the oracle of linear and dual quaternion skinning."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))
pytest.importorskip("pxr", reason="UsdSkel is missing: pip install usd-core")

from skin import Usd, figure, poses  # noqa: E402

from vitruvian.deform.deformer import deformer  # noqa: E402


@pytest.mark.parametrize("influences", [1, 2, 4, 8, 10])
@pytest.mark.parametrize(("name", "method"), [("linear", "classicLinear"), ("dual-quaternion", "dualQuaternion")])
def test_same_points_as_usdskel(influences, name, method):
    body = figure(2000, influences=influences)
    for angle in (0.05, 0.25):
        matrices = poses(body, 1, angle)
        ours = deformer(name, body)(matrices)[0]
        assert np.abs(ours - Usd(body, matrices[0]).fresh(method)).max() <= 1e-5
