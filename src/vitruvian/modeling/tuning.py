"""Parameters of contour bodies, changed by hand."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vitruvian.body.contours import zone_counts
from vitruvian.body.types import require
from vitruvian.hanim.humanoid import RAMPS, ContourSurface, Humanoid

_COUNTED = ("extra", "fixed_upper", "lower", "upper")
_PARAMETERS = sorted((*_COUNTED, "bulge", "diversion", "mitre", "ramp", "recentre"))


def tuned(humanoid: Humanoid, changes: Mapping[str, Mapping[str, float | str]]) -> Humanoid:
    """The same contour body with other parameters: {surface: {parameter: value}}, of `fixed_upper`, `upper`, `lower`,
    `extra` (whole numbers: contours; others: lengths in metres along the surface), `bulge`, `diversion` and `mitre` (0..1),
    `recentre` (0 or 1), and `ramp`. `tilt` is none of them: it says where contours are, so `contours` takes it.

    The surfaces of `humanoid` itself are changed. Raises VitruvianError for surfaces and parameters it does not have.
    """
    surfaces = {c.name: c for s in humanoid.segments() for c in s.contours}
    for name, values in changes.items():
        require(name in surfaces, "surface", f"one of {', '.join(surfaces) or 'none'}", repr(name))
        for field, value in values.items():
            assign(surfaces[name], field, value)
    return humanoid


def assign(surface: ContourSurface, field: str, value: float | str) -> None:
    """Give a surface one parameter (`tuned`), or say what was expected."""
    title = f"{surface.name} {field}"
    require(field in _PARAMETERS, f"{surface.name} parameter", f"one of {', '.join(_PARAMETERS)}", repr(field))
    if field == "ramp":
        require(value in RAMPS, title, " or ".join(RAMPS), repr(value))
        surface.ramp = str(value)
        return
    require(not isinstance(value, str), title, "a number", repr(value))
    if field in _COUNTED:
        whole = isinstance(value, int | np.integer)
        number = int(value) if whole else zone_counts(surface.points, **{field: float(value)})[field]
        most = len(surface.points)
        require(0 <= number <= most, title, f"0 to {most} contours", number)
        setattr(surface, field, number)
    elif field == "recentre":
        require(value in (0, 1), title, "0 or 1", value)
        surface.recentre = bool(value)
    else:
        require(0 <= float(value) <= 1, title, "0 to 1", value)
        setattr(surface, field, float(value))
