"""Fabrics from measurements, and their files."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from vitruvian.cli import app
from vitruvian.cloth.fabric import FABRICS
from vitruvian.cloth.fabric_tests import draped, draping_so, fitted, from_fast, from_kes, modulus
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.fabrics import fabric_from
from vitruvian.native import kernels

COTTON = FABRICS["cotton"]
kernel = pytest.mark.skipif(kernels() is None, reason="the extension vitruvian._native is not built: pip install .")


def test_bending_lengths_fast_and_kes_by_their_formulas():
    """Note cloth.md, section 4.6: FAST B = 9.81e-6 W c^3 (uN m, g/m2, mm), G = 123 / EB5; KES by its units."""
    one = from_fast({"W": 150, "C1": 20, "C2": 15, "EB5": 4.1, "E20-1": 0.98, "T2": 0.5})
    assert 1e6 * one["bend_v"] == pytest.approx(9.81e-6 * 150 * 8000) and 1e6 * one["bend_u"] == pytest.approx(
        4.966, rel=1e-3
    )
    assert (one["shear"], one["stretch_v"], one["density"]) == pytest.approx((30.0, 2000.0, 0.15))
    two = from_kes({"W": 15, "B-1": 0.1, "G": 1.0, "EM-1": 4.903, "T": 0.6})
    assert (two["bend_v"], two["shear"], two["stretch_v"]) == pytest.approx((9.807e-6, 56.19, 10_000.0))
    assert (two["density"], two["thickness"]) == pytest.approx((0.15, 6e-4))
    three = fitted("poplin", density=0.2, bending_length=(0.02, 0.015))
    assert (three.bend_v, three.bend_u) == pytest.approx((0.2 * 9.81 * 8e-6, 0.2 * 9.81 * 3.375e-6))
    assert three.stretch_v == COTTON.stretch_v and three.name == "poplin"


def test_tensile_curves_give_the_secant_at_a_worn_load():
    assert modulus([[0.0, 0.0], [0.01, 9.8], [0.02, 39.2]]) == pytest.approx(19.6 / (0.01 + 0.01 * 9.8 / 29.4))
    assert modulus([[0.5, 10.0]]) == pytest.approx(20.0)  # one that ends before
    truth = replace(COTTON, stretch_u=1000.0, stretch_v=500.0, shear=100.0, poisson=0.2)
    bias = 4 / (1 / 1000 + 1 / 500 + 1 / 100 - 2 * 0.2 / 1000)
    assert bias == pytest.approx(317.46, abs=0.01)
    lines = {k: [[10 / e, 10.0]] for k, e in (("weft", 1000.0), ("warp", 500.0), ("bias", bias))}
    assert fitted("x", tensile=lines).shear == pytest.approx(truth.shear)
    stretchy = fitted("y", tensile={"weft": [[1.0, 10.0]]})  # weft 10, warp 3000: cotton's Poisson ratio is too much
    assert stretchy.poisson**2 < stretchy.stretch_u / stretchy.stretch_v


@kernel
def test_discs_drape_as_those_of_cusick():
    """The stiffer, the larger the shadow, up to 1; limp ones fold more. At two resolutions the same."""
    stiff = [replace(COTTON, bend_u=b, bend_v=b) for b in (3e-6, 1e-5, 3e-5, 1e-3)]
    coarse, fine = ([draped(f, size=size) for f in stiff] for size in (0.012, 0.009))
    for some in (coarse, fine):
        values = [d.coefficient for d in some]
        assert values == sorted(values) and values[0] < 0.36 and values[-1] > 0.93
        assert all(d.folds >= 3 for d in some[:3]) and some[0].folds > some[2].folds
    assert [d.coefficient for d in coarse] == pytest.approx([d.coefficient for d in fine], abs=0.08)
    assert draped(stiff[2], 0.24).coefficient > draped(stiff[2], 0.36, size=0.014).coefficient  # more hangs over


@kernel
def test_a_drape_coefficient_is_found_again():
    made = draping_so(replace(COTTON, bend_u=1e-6, bend_v=1e-6), 0.6, rounds=5)
    assert draped(made).coefficient == pytest.approx(0.6, abs=0.03)
    assert 1e-5 < made.bend_u < 5e-5 and made.bend_u == pytest.approx(made.bend_v)
    with pytest.raises(VitruvianError, match="drape coefficient: expected 0.2"):
        draping_so(COTTON, 0.05)


def test_fabric_files(tmp_path):
    assert fabric_from("denim") is FABRICS["denim"]
    source, out = tmp_path / "a.json", tmp_path / "b.json"
    source.write_text(
        json.dumps({"name": "poplin", "like": "silk", "density": 0.12, "measured": {"bending_length": 0.02}})
    )
    made = fabric_from(source)
    assert (
        made.name == "poplin"
        and made.bend_u == pytest.approx(0.12 * 9.81 * 8e-6)
        and made.shear == FABRICS["silk"].shear
    )
    result = CliRunner().invoke(app, ["fabric", "fit", str(source), "-o", str(out), "--json"])
    assert result.exit_code == 0 and json.loads(result.output)["density"] == 0.12
    assert fabric_from(out) == made
    listed = CliRunner().invoke(app, ["fabric", "list", "--json"])
    assert [f["name"] for f in json.loads(listed.output)] == list(FABRICS)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1]", "expected an object"),
        ("{", "expected JSON"),
        ('{"name": "x", "density": NaN}', "finite"),
        ('{"density": 1}', "a name"),
        ('{"name": "x", "colour": 1}', "colour"),
        ('{"name": "x", "like": "denin"}', "did you mean denim"),
        ('{"name": "x", "density": "heavy"}', "expected numbers"),
        ('{"name": "x", "density": 1e9}', "density: expected"),
        ('{"name": "x", "measured": {"tensile": {"warp": [[0, 0]]}}}', "strain that grows"),
        ('{"name": "x", "measured": {"tensile": {"up": [[0, 0]]}}}', "warp, weft or bias"),
        ('{"name": "x", "measured": {"drape": [0.5]}}', "expected numbers"),
        ('{"name": "x", "measured": {"drape": [1.5, 0.3]}}', "drape coefficient"),
        ('{"name": "x", "measured": {"fast": {"C1": 20}}}', "W, the weight"),
    ],
)
def test_fabric_files_that_are_refused(tmp_path, text, message):
    file = tmp_path / "fabric.json"
    file.write_text(text)
    with pytest.raises(FileError, match=message):
        fabric_from(file)


def test_the_outline_of_a_flat_disc_is_round():
    from vitruvian.cloth import fabric_tests

    stiff = replace(COTTON, bend_u=1e-2, bend_v=1e-2)
    flat = fabric_tests.draped(stiff, 0.24, size=0.02, seconds=1 / 60)
    assert np.abs(flat.outline - 0.12).max() < 1e-3 and flat.coefficient == pytest.approx(1, abs=0.02)
