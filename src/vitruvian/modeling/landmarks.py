"""Feature points on a scan: as JSON, as Sites, checked, and found without help.

A file is one JSON object, `{"feature point name": [x, y, z]}`, in the scan's own unit and axes; names are those of the
Sites of H-Anim, of either version, with or without `_pt`. The reflection test compares the best rotation with the best
rotation and reflection onto the built-in person (S. Umeyama, "Least-squares estimation of transformation parameters
between two point patterns", 1991); arms are left out of it, because their pose is not known.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vitruvian.body.types import Floats
from vitruvian.errors import FileError, VitruvianError, warn
from vitruvian.hanim import tables
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.modeling.bones import similarity
from vitruvian.modeling.features import add_feature_points, feature_name, feature_points
from vitruvian.modeling.scans import Surface

MAX_BYTES = 1 << 20
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
_ARM = ("carpal", "humer", "radi", "ulnar", "olecranon", "dactylion", "metacarpal", "acromion", "axilla")
_FEW = 5  # landmarks off the arms that tell left from right


def read(path: str | os.PathLike[str]) -> dict[str, Floats]:
    """Feature point -> place (3,) of a JSON file, in the unit and axes that it was written in; names of H-Anim 2.0.

    Raises FileError with the line, or with the key, for what is no such file: more than 1 MB, no object, names that the
    standard does not have (with the nearest that it has), names given twice, places that are not three finite numbers.
    """

    def fail(line: int, what: str) -> NoReturn:
        raise FileError(path, line, what) from None

    try:
        if os.path.getsize(path) > MAX_BYTES:
            fail(0, f"expected landmarks of at most {MAX_BYTES >> 20} MB")
        text = Path(path).read_bytes().decode("utf-8-sig")
    except OSError as error:
        fail(0, f"can't be read ({error.strerror})")
    except UnicodeDecodeError:
        fail(0, "expected JSON text in UTF-8, found other bytes")
    try:
        pairs = json.loads(text, object_pairs_hook=_Pairs)
    except json.JSONDecodeError as error:
        fail(error.lineno, f"expected JSON, found something else ({error.msg})")
    except (RecursionError, ValueError) as error:
        fail(0, f"expected JSON of plain numbers, found something else ({str(error)[:80]})")
    if not isinstance(pairs, _Pairs):
        fail(0, 'expected an object {"feature point name": [x, y, z]}')
    out: dict[str, Floats] = {}
    for key, value in pairs:
        try:
            name = _known(key)
            out_twice = name in out
            out[name] = _place(key, value)
        except VitruvianError as error:
            fail(_line(text, key), str(error))
        if out_twice:
            fail(_line(text, key), f"{key[:60]!r}: this feature point is given twice; keep one")
    return out


class _Pairs(list[tuple[str, Any]]):
    """An object of a JSON file, with keys that may be there twice."""


def _line(text: str, key: str) -> int:
    at = text.rfind(json.dumps(key, ensure_ascii=False))
    return text.count("\n", 0, at) + 1 if at >= 0 else 0


def _known(name: str) -> str:
    """The standard's name of a feature point; VitruvianError with the nearest name for others."""
    known = feature_name(name)
    if known is not None:
        return known
    from difflib import get_close_matches

    names = [*tables.feature_points(), *tables.feature_points("1.x")]
    near = get_close_matches(name[:80].removesuffix("_pt").lower(), names, n=1, cutoff=0.6)
    hint = f"; did you mean {near[0]}?" if near else "; names are those of H-Anim's feature points, such as l_acromion"
    raise VitruvianError(f"landmark {name[:60]!r}: no such feature point{hint}")


def _place(name: str, value: object) -> Floats:
    numbers = isinstance(value, (list, tuple, np.ndarray)) and len(value) == 3
    if not numbers or any(isinstance(x, (bool, str, list, dict)) or x is None for x in value):  # type: ignore[attr-defined]
        raise VitruvianError(f"landmark {name[:60]!r}: expected three numbers [x, y, z], found {str(value)[:60]}")
    try:
        place = np.array([float(x) for x in value], dtype=np.float64)  # type: ignore[attr-defined]
    except (OverflowError, TypeError, ValueError):
        place = np.full(3, np.nan)
    if not (np.isfinite(place).all() and (np.abs(place) < 1e9).all()):
        raise VitruvianError(f"landmark {name[:60]!r}: expected three finite numbers, found {str(value)[:60]}")
    return place


def save(points: Mapping[str, ArrayLike], path: str | os.PathLike[str]) -> None:
    """Write feature points, name -> place (3,), as such a JSON file; a failed call leaves an older file as it was.

    Raises VitruvianError for names and places that `read` would refuse.
    """
    found = {_known(n): _place(n, np.asarray(p, dtype=np.float64).tolist()) for n, p in points.items()}
    lines = [f' "{n}": [{", ".join(repr(float(x)) for x in p)}]' for n, p in found.items()]
    target = Path(path)
    part = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        part.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
        part.replace(target)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise VitruvianError(f"{target}: can't be written ({error.strerror})") from None


def as_sites(humanoid: Humanoid, points: Mapping[str, ArrayLike]) -> list[str]:
    """Write landmarks (metres, humanoid space at rest) into a humanoid as Sites `_pt`; answers their names.

    The way back is `from_sites`. Raises VitruvianError for unknown names.
    """
    return add_feature_points(humanoid, {_known(n): p for n, p in points.items()}, form="sites")


def from_sites(humanoid: Humanoid) -> dict[str, Floats]:
    """Landmarks of a humanoid: the feature points that its Sites (else its Displacers) give, metres, at rest."""
    return feature_points(humanoid)


@dataclass(frozen=True, eq=False)
class Checked:
    """Landmarks that make sense. points: 2.0 name -> place (3,) in their own unit; `unit` is what that unit seems to be.

    mirrored: left and right are swapped, or the scan is a mirror image. size: of the built-in person in that unit.
    """

    points: dict[str, Floats]
    unit: str
    mirrored: bool
    size: float


def checked(points: Mapping[str, ArrayLike], names: list[str] | None = None) -> Checked:
    """Whether landmarks, name -> place (3,) in any unit, can be those of a person. `names`: only these are wanted.

    Warns when left and right are swapped (`mirrored` says so too) and when the unit can't be told. Raises VitruvianError
    for unknown names, numbers that are not finite, fewer than 4 points, and points that are all in one place.
    """
    found = {_known(n): _place(n, np.asarray(p).tolist()) for n, p in points.items()}
    if names is not None:
        found = {n: p for n, p in found.items() if n in {_known(name) for name in names}}
    model = _reference()
    both = [n for n in found if n in model]
    if len(both) < 4:
        raise VitruvianError(f"landmarks: expected at least 4 feature points of the body, found {len(both)}")
    here, there = np.array([found[n] for n in both]), np.array([model[n] for n in both])
    spread = float(np.sqrt(((here - here.mean(axis=0)) ** 2).sum(axis=1).mean()))
    if not spread > 1e-6 * max(1e-9, float(np.abs(here).max())):
        raise VitruvianError("landmarks: expected places that are apart from each other, found all in one place")
    size = spread / float(np.sqrt(((there - there.mean(axis=0)) ** 2).sum(axis=1).mean()))
    away = {u: abs(np.log(size * metres)) for u, metres in UNITS.items()}
    unit = min(away, key=lambda u: away[u])
    if away[unit] > np.log(1.8):
        warn(f"landmarks: a person {1.7 * size:.3g} units tall fits no unit; taken for {unit}, say which with --unit")
    mirrored = _mirrored(both, here, there)
    if mirrored:
        warn("landmarks: left and right are swapped (or the scan is a mirror image)")
    return Checked(found, unit, mirrored, size)


def _reference() -> dict[str, Floats]:
    from vitruvian.modeling import source
    from vitruvian.modeling.shape import Shape, shaped

    body = shaped(Shape())
    return {n: body[v] for n, v in source.feature_vertices().items()}


def still(names: Sequence[object]) -> NDArray[np.bool_]:
    """Which landmarks (n,) keep their places whatever the arms do; all when they are too few to tell a person's place."""
    out = np.array([not (isinstance(n, str) and any(word in n for word in _ARM)) for n in names], bool)
    return out if out.sum() >= _FEW else np.ones(len(out), bool)


def _mirrored(names: list[str], here: Floats, there: Floats) -> bool:
    """Whether a reflection brings the landmarks much nearer to the model than a rotation does."""
    firm = still(names)
    if firm.all() or not any(n.startswith(("l_", "r_")) for n, s in zip(names, firm, strict=True) if s):
        return False
    return similarity(there[firm], here[firm])[3]


def detect(mesh: Surface, *, progress: Callable[[int, int], None] | None = None) -> dict[str, tuple[Floats, float]]:
    """The feature points of one upright person in a scan: 2.0 name -> (place (3,), confidence 0..1).

    mesh: vertices (V,3) in any unit, Y or Z up, facing anywhere, arms 20 to 90 degrees from the body; places are in the
    scan's own unit and axes. Noise, holes, missing soles, clothes, a floor and furniture may be there. Of points with a
    confidence of 0.7 or more, 95 in 100 are within 40 mm of where the built-in person has them.
    `progress` is called with what is done and about how much there is; what it raises ends the search.
    Warns when several parts could be the person and when the front is not sure. Raises VitruvianError when nothing in
    the scan stands like a person.
    """
    from vitruvian.modeling.finding import found

    return found(mesh, progress).points
