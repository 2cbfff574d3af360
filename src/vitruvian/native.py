"""The compiled kernels, or their NumPy twins where the extension has not been built.

`kernels()` is the extension `vitruvian._native`, or None; the first None says how to build it. What takes arrays and
has a twin asks here, so that everything works without a compiler, only slower.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from vitruvian.errors import warn

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

HOW = "vitruvian._native is not built, using slower NumPy code; build it with a C++17 compiler: pip install ."


@cache
def kernels() -> ModuleType | None:
    """The extension module, or None after one warning."""
    try:
        return import_module("vitruvian._native")
    except ImportError:
        warn(HOW)
        return None


def variant() -> str:
    """Which kernels run: "x86-64-v3", "baseline" or "numpy"."""
    native = kernels()
    return "numpy" if native is None else {"v3": "x86-64-v3"}.get(native.instruction_set(), "baseline")


def parse_floats(text: bytes | bytearray | memoryview, expected: int = -1) -> NDArray[np.float64]:
    """All numbers of `text`, separated by white space or commas, as float64 (n,).

    Only finite decimal numbers count. Raises ValueError that names the first bad token; its attribute `offset` is the
    token's first byte. With `expected` >= 0 another count raises ValueError as well.
    """
    native = kernels()
    if native is not None:
        return native.parse_floats(text, expected)
    return parse_floats_numpy(text, expected)


def parse_floats_numpy(text: bytes | bytearray | memoryview, expected: int = -1) -> NDArray[np.float64]:
    """`parse_floats` without the extension."""
    import re

    import numpy as np

    data = bytes(text)
    pieces, start = [], 0
    try:
        if b"_" in data:  # float() takes digit groups, files do not
            raise ValueError
        while start < len(data):  # a megabyte at a time, cut at a blank, so that a long list needs little memory
            cut = re.compile(rb"[\s,]").search(data, start + (1 << 20))
            end = cut.start() if cut else len(data)
            tokens = data[start:end].replace(b",", b" ").split()
            pieces.append(np.array([float(t) for t in tokens], np.float64))
            start = end
        values = np.concatenate([*pieces, np.zeros(0)])
        good = bool(np.isfinite(values).all())
    except ValueError:
        good = False
    if not good:
        number = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
        for token in re.finditer(rb"[^\s,]+", data):
            if not number.fullmatch(token[0]) or not np.isfinite(float(token[0])):
                shown = token[0][:40].decode("latin-1")
                error = ValueError(f"byte {token.start()}: expected a finite number, found {shown!r}")
                error.offset = token.start()  # type: ignore[attr-defined]
                raise error
    if expected >= 0 and len(values) != expected:
        raise ValueError(f"expected {expected} numbers, found {len(values)}")
    return values
