"""Fabrics: what the solver needs to know of a cloth, presets, and how to get it from measurements.

Source: note cloth.md, section 4.6. Presets are starting values by order of magnitude, not measurements.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from difflib import get_close_matches
from types import MappingProxyType

from vitruvian.body.types import require
from vitruvian.errors import VitruvianError

GRAVITY = 9.81  # m/s^2

# What makes sense, from chiffon to leather and some way beyond
RANGES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "density": (0.01, 3.0), "stretch_u": (5.0, 1e5), "stretch_v": (5.0, 1e5), "shear": (0.5, 1e4),
        "poisson": (0.0, 0.9), "bend_u": (0.0, 1e-2), "bend_v": (0.0, 1e-2), "thickness": (5e-5, 0.02),
        "friction_body": (0.0, 2.0), "friction_self": (0.0, 2.0), "damping": (0.0, 50.0),
    }
)  # fmt: skip


@dataclass(frozen=True)
class Fabric:
    """A cloth: density kg/m2; stretch_u (weft) and stretch_v (warp), shear: N/m; poisson, of weft to warp; bend_u and
    bend_v: N m; thickness m; friction with the body and with itself; damping 1/s."""

    name: str
    density: float
    stretch_u: float
    stretch_v: float
    shear: float
    bend_u: float
    bend_v: float
    thickness: float
    friction_body: float
    friction_self: float
    poisson: float = 0.2
    damping: float = 1.0

    def __post_init__(self) -> None:
        for f in fields(self)[1:]:
            low, high = RANGES[f.name]
            value = getattr(self, f.name)
            require(low <= value <= high, f"fabric {self.name}: {f.name}", f"{low:g} to {high:g}", f"{value:g}")
        stiff = self.stretch_u / self.stretch_v
        limit = f"less than the root of stretch_u / stretch_v, {stiff**0.5:.2g}"
        require(self.poisson**2 < stiff, f"fabric {self.name}: poisson", limit, f"{self.poisson:g}")

    @property
    def bends_by(self) -> str:
        """How it is best bent: "shape" where weft and warp differ by more than twice (note cloth.md, 4.3), else "hinge"."""
        low, high = sorted((self.bend_u, self.bend_v))
        return "shape" if high > 2 * low else "hinge"


def _preset(
    name: str, density: float, u: float, v: float, shear: float, bu: float, bv: float, mm: float, mu: float
) -> Fabric:
    return Fabric(name, density, v, u, shear, bv * 1e-6, bu * 1e-6, mm * 1e-3, mu, mu)


# The note's table gives the stiffer direction first; that is the warp, v
FABRICS: Mapping[str, Fabric] = MappingProxyType(
    {
        f.name: f
        for f in (
            _preset("chiffon", 0.05, 1000, 800, 15, 1.5, 1, 0.2, 0.25),
            _preset("silk", 0.08, 2500, 2000, 25, 4, 3, 0.2, 0.2),
            _preset("cotton", 0.15, 3000, 2500, 50, 10, 7, 0.35, 0.4),
            _preset("linen", 0.20, 4000, 3500, 60, 25, 20, 0.45, 0.4),
            _preset("wool", 0.25, 2000, 1600, 50, 15, 12, 0.7, 0.5),
            _preset("jersey", 0.19, 140, 60, 40, 23, 15, 0.8, 0.45),
            _preset("denim", 0.40, 6000, 5000, 150, 120, 80, 0.9, 0.45),
            _preset("leather", 0.80, 8000, 8000, 300, 600, 600, 1.2, 0.6),
        )
    }
)


def fabric(name: str) -> Fabric:
    """A preset by its name; "cotton jersey" is jersey. Raises VitruvianError for a name that no preset has."""
    words = name.lower().replace("-", " ").split()
    found = [w for w in words if w in FABRICS]
    if found:
        return FABRICS[found[-1]]
    near = get_close_matches(words[-1] if words else "", FABRICS, n=1)
    hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(FABRICS)}"
    raise VitruvianError(f"fabric {name!r:.60}: {hint}")


def bending_from_length(density: float, length: float) -> float:
    """N m, from the bending length (metres) of a cantilever test: B = w g c^3 (Peirce 1930)."""
    return density * GRAVITY * length**3
