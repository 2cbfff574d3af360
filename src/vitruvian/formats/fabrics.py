"""Fabric files: JSON of a fabric's fields, or of what a laboratory measured: `fabric_of` of cloth.fabric_tests."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from vitruvian.cloth.fabric import Fabric, fabric
from vitruvian.cloth.fabric_tests import fabric_of, values_of
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.atomic import atomic
from vitruvian.formats.source import LIMITS, decode, read_bytes


def read_fabric(path: str | Path, *, progress: Callable[[str, float], None] | None = None) -> Fabric:
    """The fabric of a file, fitted where it tells measurements. Raises `FileError`."""
    text = decode(path, read_bytes(path, LIMITS))
    try:
        whole = json.loads(text, parse_constant=_refused)
    except (ValueError, RecursionError) as e:
        raise FileError(path, getattr(e, "lineno", 1), f"expected JSON: {e}") from None
    if not isinstance(whole, dict):
        raise FileError(path, 1, f"expected an object of a fabric's values, found {type(whole).__name__}")
    try:
        return fabric_of(whole, progress=progress)
    except FileError:
        raise
    except VitruvianError as e:
        raise FileError(path, 1, str(e)) from None


def write_fabric(path: str | Path, cloth: Fabric) -> None:
    """The fields of a fabric, SI."""
    with atomic(path) as file:
        file.write_text(json.dumps(values_of(cloth), indent=2) + "\n", encoding="utf-8")


def fabric_from(source: str | Path) -> Fabric:
    """A preset by its name, or the fabric of a .json file."""
    return read_fabric(source) if str(source).lower().endswith(".json") else fabric(str(source))


def _refused(word: str) -> float:
    raise ValueError(f"expected a finite number, found {word}")
