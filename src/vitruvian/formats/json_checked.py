"""Small JSON files whose every value is checked as it is read: a line says where, what was expected, what was found."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeGuard, TypeVar

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.source import Limits, decode, read_bytes

MOST = 2000  # entries of a list: panels, and edges of one panel; no garment has as many
LONGEST = 200  # characters of a name
SMALL = Limits(bytes=32 << 20)
T = TypeVar("T")


def read_checked(path: str | Path, make: Callable[[object], T]) -> T:
    """What `make` makes of a file's JSON. Its VitruvianErrors become `FileError`s, as does what is no JSON."""
    text = decode(path, read_bytes(path, SMALL))
    try:
        whole = json.loads(text, parse_constant=_refused, object_pairs_hook=_once)
    except (ValueError, RecursionError) as e:
        raise FileError(path, getattr(e, "lineno", 1), f"expected JSON: {e}") from None
    try:
        return make(whole)
    except FileError:
        raise
    except VitruvianError as e:
        raise FileError(path, 1, str(e)) from None


def _refused(word: str) -> float:
    raise ValueError(f"expected a finite number, found {word}")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out = dict(pairs)
    if len(out) < len(pairs):
        seen: set[str] = set()
        twice = next(k for k, _ in pairs if k in seen or seen.add(k))  # type: ignore[func-returns-value]
        raise ValueError(f"expected every key once, found {twice[:40]!r} twice in one object")
    return out


def wrong(where: str, expected: str, found: object) -> VitruvianError:
    """The error to raise."""
    return VitruvianError(f"{where}: expected {expected}, found {found!r:.60}")


def an_object(value: object, where: str) -> Mapping[str, Any]:
    """`value` if it is an object; VitruvianError, as from the others."""
    if not isinstance(value, Mapping):
        raise wrong(where, "an object", value)
    return value


def a_list(value: object, where: str, most: int = MOST) -> list[Any]:
    """`value` if it is a list of at most `most` entries."""
    if not isinstance(value, list | tuple):
        raise wrong(where, "a list", value)
    if len(value) > most:
        raise wrong(where, f"at most {most} entries", len(value))
    return list(value)


def numbers(value: object, where: str, count: int, most: float = math.inf) -> Floats:
    """(count,) finite numbers, none larger than `most`."""
    good = isinstance(value, list | tuple) and len(value) == count and all(is_number(v) for v in value)
    if not good:
        raise wrong(where, f"{count} numbers", value)
    out = np.array(value, np.float64)
    if np.abs(out).max(initial=0) > most:
        raise wrong(where, f"numbers up to {most:g}", value)
    return out


def is_number(value: object) -> TypeGuard[float]:
    """Whether it is a number that a float can hold."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer of hundreds of digits
        return False


def an_index(value: object, where: str, count: int) -> int:
    """An integer of 0 to count - 1."""
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < count:
        raise wrong(where, f"an index of 0 to {count - 1}", value)
    return value


def a_flag(value: object, where: str) -> bool:
    """true or false."""
    if not isinstance(value, bool):
        raise wrong(where, "true or false", value)
    return value


def a_text(value: object, where: str, *, some: bool = False) -> str:
    """A line of text that can be shown and written; `some`: it may not be empty."""
    good = isinstance(value, str) and len(value) <= LONGEST and (value.isprintable()) and (value or not some)
    if not isinstance(value, str) or not good:
        raise wrong(where, f"a line of {'1' if some else '0'} to {LONGEST} characters", value)
    return value
