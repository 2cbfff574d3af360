"""What drafts know of a body: its measures, those missing estimated, and the heights of its landmarks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite

from vitruvian.errors import VitruvianError

NEEDED = ("height", "chest", "waist", "hips")
# shares of the height that fill in for lengths, and of a girth for girths: means of the built-in grown-up people
LENGTHS = {"shoulder_width": 0.221, "arm_length": 0.335, "inseam": 0.47, "back_length": 0.23}
GIRTHS = {
    "underbust": ("chest", 0.9),
    "neck": ("chest", 0.385),
    "upper_arm": ("chest", 0.32),
    "wrist": ("chest", 0.17),
    "thigh": ("hips", 0.57),
    "calf": ("hips", 0.38),
}
# heights over the soles as shares of the stature
NAPE, SHOULDER, ARMPIT = 0.861, 0.81, 0.752
RANGE = {"height": (0.5, 2.6), "chest": (0.25, 2.2), "waist": (0.25, 2.4), "hips": (0.25, 2.4)}
LOW, HIGH = 0.02, 2.0


@dataclass(frozen=True)
class Figure:
    """A body to draft for: all measures, metres, and heights over the soles of nape, armpit, waist, hips, crotch, knee
    and of the shoulder's tip."""

    measures: Mapping[str, float]
    nape: float
    shoulder: float
    armpit: float
    waist: float
    hips: float
    crotch: float
    knee: float

    def __getitem__(self, name: str) -> float:
        return self.measures[name]


def figure(measures: Mapping[str, float], heights: Mapping[str, float] | None = None) -> Figure:
    """Measures checked and completed. heights: of landmarks that are known, metres over the soles.

    Raises VitruvianError for height, chest, waist or hips missing, and numbers that no person has.
    """
    missing = [n for n in NEEDED if n not in measures]
    if missing:
        raise VitruvianError(f"draft: expected the measures {', '.join(NEEDED)} at least, {missing[0]} is missing")
    for name, value in measures.items():
        low, high = RANGE.get(name, (LOW, HIGH))
        if not isinstance(value, int | float) or not isfinite(value) or not low <= value <= high:
            raise VitruvianError(f"measure {name:.40}: expected {low:g} to {high:g} m, found {value!r:.40}")
    m = {n: float(v) for n, v in measures.items()}
    for name, share in LENGTHS.items():
        m.setdefault(name, share * m["height"])
    for name, (of, share) in GIRTHS.items():
        m.setdefault(name, share * m[of])
    nape = NAPE * m["height"]
    waist, crotch = nape - m["back_length"], m["inseam"]
    at = {
        "nape": nape,
        "shoulder": SHOULDER * m["height"],
        "armpit": ARMPIT * m["height"],
        "waist": waist,
        "hips": crotch + 0.3 * (waist - crotch),
        "crotch": crotch,
        "knee": 0.56 * crotch,
    }
    for name, value in (heights or {}).items():
        if name not in at:
            raise VitruvianError(f"heights: expected {', '.join(at)}, found {name!r:.40}")
        at[name] = float(value)
    order = ("nape", "shoulder", "armpit", "waist", "hips", "crotch", "knee")
    for upper, lower in zip(order, order[1:]):
        if not (isfinite(at[lower]) and at[upper] - at[lower] > 0.01):
            raise VitruvianError(
                f"heights: expected the {upper} above the {lower}, found {at[upper]:.3f} and {at[lower]:.3f} m"
            )
    return Figure(m, **at)


def number(name: str, value: float, low: float, high: float) -> float:
    """An option within its bounds; VitruvianError otherwise."""
    if not isinstance(value, int | float) or not isfinite(value) or not low <= value <= high:
        raise VitruvianError(f"{name}: expected {low:g} to {high:g}, found {value!r:.40}")
    return float(value)
