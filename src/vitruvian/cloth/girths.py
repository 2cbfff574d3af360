"""Girths of a garment where a tape goes round the body: as it hangs, and in the cloth it was cut from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vitruvian.body.types import Floats, Ints, floats, require
from vitruvian.cloth.sheet import Sheet

ROUND = 0.9  # of a turn that a line makes about the body to count as going round it
ASIDE = 0.4  # of its own radius that its middle may be off the tape's: a skirt goes round both legs, not round one
DROPS = (0.0, 0.01, 0.02, 0.03, 0.04, 0.05)  # metres that a tape may lie lower on the garment than on the body


@dataclass(frozen=True, eq=False)
class Ring:
    """A tape round the body: its corners (k,3) metres, in order, where the body stands."""

    points: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", floats(self.points, "tape", None, 3))
        require(len(self.points) >= 3, "tape", "three corners at least", len(self.points))

    @property
    def girth(self) -> float:
        """Metres."""
        return float(np.linalg.norm(np.roll(self.points, -1, axis=0) - self.points, axis=1).sum())

    @property
    def center(self) -> Floats:
        """(3,) the middle of its line."""
        after = np.roll(self.points, -1, axis=0)
        step = np.linalg.norm(after - self.points, axis=1)
        return (0.5 * (self.points + after) * step[:, None]).sum(axis=0) / max(step.sum(), 1e-12)

    @property
    def axis(self) -> Floats:
        """(3,) unit, across its plane (Newell)."""
        p, q = self.points - self.points[0], np.roll(self.points, -1, axis=0) - self.points[0]
        total = np.cross(p, q).sum(axis=0)
        return total / max(float(np.linalg.norm(total)), 1e-12)


@dataclass(frozen=True)
class Girth:
    """Metres: of the body; of the garment as it hangs (worn), and in the flat cloth, without its stretch (cloth)."""

    body: float
    worn: float
    cloth: float

    @property
    def ease(self) -> float:
        """Metres that the cloth is longer than the body is round; negative: it has to stretch."""
        return self.cloth - self.body

    def told(self) -> dict[str, float]:
        """In centimetres."""
        values = {"body_cm": self.body, "worn_cm": self.worn, "cloth_cm": self.cloth, "ease_cm": self.ease}
        return {k: 100 * v for k, v in values.items()}


def girths(sheet: Sheet, x: Floats, rings: Mapping[str, Ring]) -> dict[str, Girth]:
    """Ring's name -> girths there, of the rings that the garment, vertices (n,3), goes round. Of several lines the
    innermost counts. Where sleeves join it at that height, the tape goes lower, down to 50 mm."""
    out = {}
    for name, ring in rings.items():
        down = ring.axis * (-1.0 if ring.axis[1] > 0 else 1.0)
        for drop in DROPS:
            lines = _lines(sheet, x, Ring(ring.points + drop * down))
            if lines:
                worn, cloth = min(lines)
                out[name] = Girth(ring.girth, worn, cloth)
                break
    return out


def _lines(sheet: Sheet, x: Floats, ring: Ring) -> list[tuple[float, float]]:
    """Lengths of the lines in which the plane of a ring cuts a garment and that go round the ring's middle: as it hangs,
    and in the cloth."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    center, axis = ring.center, ring.axis
    height = (x - center) @ axis
    height[height == 0] = 1e-12
    above = height[sheet.triangles] > 0
    cut = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
    if not len(cut):
        return []
    ends = np.empty((len(cut), 2, 3))
    flat = np.empty((len(cut), 2, 2))
    side: Ints = np.empty((len(cut), 2), np.int32)
    lone = np.where(above[cut].sum(axis=1) == 1, above[cut].argmax(axis=1), (~above[cut]).argmax(axis=1))
    for j, step in enumerate((1, 2)):  # the two sides that leave the corner which is alone on its side of the plane
        other = (lone + step) % 3
        p, q = sheet.triangles[cut, lone], sheet.triangles[cut, other]
        t = (height[p] / (height[p] - height[q]))[:, None]
        ends[:, j] = x[p] + t * (x[q] - x[p])
        flat[:, j] = sheet.material[cut, lone] + t * (sheet.material[cut, other] - sheet.material[cut, lone])
        side[:, j] = sheet.sides[cut, np.where(step == 1, lone, other)]
    names, number = np.unique(side, return_inverse=True)
    number = number.reshape(-1, 2)
    graph = coo_array((np.ones(len(cut)), (number[:, 0], number[:, 1])), (len(names), len(names)))
    line = connected_components(graph, directed=False)[1][number[:, 0]]
    worn, cloth = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), np.linalg.norm(flat[:, 1] - flat[:, 0], axis=1)
    first = ring.points[0] - center
    first -= (first @ axis) * axis
    first /= max(float(np.linalg.norm(first)), 1e-12)
    second = np.cross(axis, first)
    angle = np.arctan2((ends - center) @ second, (ends - center) @ first)
    turn = (angle[:, 1] - angle[:, 0] + np.pi) % (2 * np.pi) - np.pi
    turn *= np.where(above[cut, lone], 1.0, -1.0)  # which way round the triangle the cut runs
    out = []
    for k in np.unique(line):
        mine = line == k
        long = float(worn[mine].sum())
        middle = (ends[mine].mean(axis=1) * worn[mine, None]).sum(axis=0) / max(long, 1e-12)
        aside = float(np.linalg.norm(middle - center)) / max(long / (2 * np.pi), 1e-12)
        if abs(float(turn[mine].sum())) >= ROUND * 2 * np.pi and aside <= ASIDE:
            out.append((long, float(cloth[mine].sum())))
    return out
