"""Numbers from text, and life without the extension."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vitruvian import native

PARSERS = [native.parse_floats_numpy]
if native.kernels() is not None:
    PARSERS.append(native.kernels().parse_floats)

number = st.floats(allow_nan=False, allow_infinity=False)
printed = st.one_of(
    number.map(repr), number.map(lambda v: f"{v:.6f}"), number.map(lambda v: f"{v:+.17e}"), st.integers().map(str)
)


@pytest.mark.parametrize("parse", PARSERS)
@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(printed, st.sampled_from([" ", ",", "\n", "\t , \r\n"])), max_size=30))
def test_every_number_is_read_as_python_reads_it(parse, items):
    texts = [text for text, _ in items if abs(float(text)) < 1e300]
    data = "".join(text + gap for text, gap in items if abs(float(text)) < 1e300).encode()
    assert parse(data).tolist() == [float(t) for t in texts]


@pytest.mark.parametrize("parse", PARSERS)
def test_shapes_of_numbers(parse):
    assert parse(b"").shape == (0,)
    assert parse(b" 1,2 ,3\n-4.5e3\t+.5 7. 1e-400 -0").tolist() == [1, 2, 3, -4500, 0.5, 7, 0, 0]
    assert parse(memoryview(b"12 34")[1:], 2).tolist() == [2, 34]
    assert parse(b"123456789012345678901234567890").tolist() == [123456789012345678901234567890.0]


@pytest.mark.parametrize("parse", PARSERS)
@pytest.mark.parametrize(
    ("text", "offset"),
    [(b"1 2 abc 3", 4), (b"nan", 0), (b"0 inf", 2), (b"1e999", 0), (b"1 - 2", 2), (b"1e", 0), (b"1..2", 0),
     (b"0x10", 0), (b"1_0", 0), (b"--1", 0), (b".", 0), (b"7 \xff\xfe", 2), (b"1\x002", 0), (b"5 1e+", 2)],
)  # fmt: skip
def test_the_first_bad_token_is_named(parse, text, offset):
    with pytest.raises(ValueError, match=f"byte {offset}: expected a finite number, found") as error:
        parse(text)
    assert error.value.offset == offset


@pytest.mark.parametrize("parse", PARSERS)
def test_counts(parse):
    with pytest.raises(ValueError, match="expected 3 numbers, found 2"):
        parse(b"1 2", 3)
    with pytest.raises(ValueError, match="expected 1000000000000 numbers, found 1"):
        parse(b"1", 10**12)


def test_without_the_extension_one_warning_says_how_to_build_it():
    script = """
import sys, warnings
sys.modules["vitruvian._native"] = None
warnings.simplefilter("always")
import numpy as np
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.types import Body, Skeleton, Skin, Weights
from vitruvian.deform.deformer import deformer
s = Skeleton(("a",), [-1], [[0, 0, 0]])
body = Body("b", s, Skin([[1.0, 2, 3]], np.zeros((0, 3)), Weights.from_pairs(1, [0], [0], [1.0])))
for name in ("linear", "log", "hybrid"):
    assert np.allclose(deformer(name, body)(joint_matrices(s)), [[1, 2, 3]])
"""
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert ran.stderr.count("vitruvian._native is not built") == 1
    assert "pip install ." in ran.stderr


@pytest.mark.parametrize("size", [0, 10, 1000])
def test_twins_agree_on_large_input(size):
    values = np.random.default_rng(size).normal(size=size)
    data = " ".join(map(repr, values.tolist())).encode()
    assert all(np.array_equal(parse(data), values) for parse in PARSERS)
