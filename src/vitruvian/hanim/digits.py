"""Numbers as the shortest text that reads back the same."""

from __future__ import annotations

import re
import struct
from typing import TYPE_CHECKING

from vitruvian.errors import VitruvianError
from vitruvian.native import parse_floats

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_FEW = 12  # numbers that are formatted one by one
_SINGLE = struct.Struct("f")
_FORMS = ("%.6g", "%.7g", "%.8g", "%.9g")
_NOT_FINITE = "can't write a number that is not finite as a 32-bit float; look for NaN in the values"
_EXPONENT = re.compile(r"e([+-])0*(?=\d)")


def shortest(values: NDArray[np.float64]) -> list[str]:
    """For each number the shortest text that reads back as the same float32. VitruvianError when one isn't finite."""
    import numpy as np

    values = np.asarray(values, np.float64).ravel()
    if values.size <= _FEW:
        return [shortest_of(v) for v in values.tolist()]
    with np.errstate(over="ignore"):
        single = values.astype(np.float32)
    if not np.isfinite(single).all():
        raise VitruvianError(_NOT_FINITE)
    texts = _formatted(single, 6)
    rest, new = np.arange(single.size), texts
    for digits in (7, 8, 9):
        rest = rest[parse_floats(" ".join(new).encode()).astype(np.float32) != single[rest]]
        if not rest.size:
            break
        new = _formatted(single[rest], digits)
        for i, text in zip(rest.tolist(), new, strict=True):
            texts[i] = text
    return texts


def shortest_of(value: float) -> str:
    """`shortest` of one number, without arrays."""
    try:
        (single,) = _SINGLE.unpack(_SINGLE.pack(value))
    except OverflowError:
        raise VitruvianError(_NOT_FINITE) from None
    if single - single != 0:
        raise VitruvianError(_NOT_FINITE)
    for form in _FORMS:
        text = form % single
        if _SINGLE.unpack(_SINGLE.pack(float(text)))[0] == single:
            break
    return _EXPONENT.sub(_short_exponent, text) if "e" in text else text


def _formatted(single: NDArray[np.float32], digits: int) -> list[str]:
    text = (f"%.{digits}g " * single.size) % tuple(single.tolist())
    return (_EXPONENT.sub(_short_exponent, text) if "e" in text else text).split()


def _short_exponent(match: re.Match[str]) -> str:
    return "e-" if match[1] == "-" else "e"


def double_of(number: float) -> str:
    """The shortest text that reads back as the same float64. VitruvianError when it isn't finite."""
    if number - number != 0:
        raise VitruvianError("can't write a number that is not finite; look for NaN in the values")
    text = repr(float(number))
    text = text[:-2] if text.endswith(".0") else text
    return _EXPONENT.sub(_short_exponent, text)
