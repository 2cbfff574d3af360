"""A garment, or a strip of cloth, as the solver sees it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, floats, indices, require
from vitruvian.cloth.fabric import Fabric


@dataclass(frozen=True, eq=False)
class Sheet:
    """Triangles (m,3) with the place of their corners in the fabric, material (m,3,2) metres: weft, warp. Vertices where
    pieces are sewn have several places. fabric (m,): which of `fabrics`."""

    triangles: Ints
    material: Floats
    fabric: Ints
    fabrics: tuple[Fabric, ...]

    def __post_init__(self) -> None:
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        count = int(np.max(self.triangles, initial=-1)) + 1
        put("triangles", indices(self.triangles, "triangles", count, None, 3))
        put("material", floats(self.material, "material", len(self.triangles), 3, 2))
        put("fabric", indices(self.fabric, "fabric", len(self.fabrics), len(self.triangles)))
        flat = np.flatnonzero(self.areas <= 0)
        require(not len(flat), f"material of triangle {flat[0] if len(flat) else 0}", "an area", "none")

    @property
    def count(self) -> int:
        """Vertices."""
        return int(self.triangles.max(initial=-1)) + 1

    @cached_property
    def areas(self) -> Floats:
        """(m,) square metres at rest."""
        e = self.material[:, 1:] - self.material[:, :1]
        return 0.5 * np.abs(e[:, 0, 0] * e[:, 1, 1] - e[:, 0, 1] * e[:, 1, 0])

    @cached_property
    def masses(self) -> Floats:
        """(n,) kilograms: a third of each triangle at each of its corners."""
        density = np.array([f.density for f in self.fabrics])[self.fabric]
        return np.bincount(self.triangles.ravel(), np.repeat(density * self.areas / 3, 3), self.count).astype(
            np.float64
        )

    def of_vertices(self, name: str) -> Floats:
        """(n,) a property of the fabrics, the largest that meets in each vertex."""
        value = np.array([getattr(f, name) for f in self.fabrics])[self.fabric]
        out = np.zeros(self.count)
        np.maximum.at(out, self.triangles.ravel(), np.repeat(value, 3))
        return out

    @cached_property
    def edges(self) -> Ints:
        """(e,2) of the triangles, each once, smaller vertex first."""
        return self._sides[0]

    @cached_property
    def sides(self) -> Ints:
        """(m,3) which of `edges` each triangle has, from corner k to k + 1."""
        return self._sides[1]

    @cached_property
    def _sides(self) -> tuple[Ints, Ints]:
        return sides(self.triangles)


def joined(sheets: Sequence[Sheet]) -> Sheet:
    """Several sheets as one, vertices and fabrics of each after those of the one before."""
    counts = np.cumsum([0, *(s.count for s in sheets)])
    fabrics = np.cumsum([0, *(len(s.fabrics) for s in sheets)])
    return Sheet(
        np.concatenate([s.triangles + np.int32(n) for s, n in zip(sheets, counts)]),
        np.concatenate([s.material for s in sheets]),
        np.concatenate([s.fabric + np.int32(n) for s, n in zip(sheets, fabrics)]),
        tuple(f for s in sheets for f in s.fabrics),
    )


def sides(triangles: Ints) -> tuple[Ints, Ints]:
    """(e,2) edges of triangles (m,3), each once, smaller vertex first, and (m,3) which each triangle has, from corner k to
    k + 1."""
    every = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
    edges, number = np.unique(every, axis=0, return_inverse=True)
    return edges.astype(np.int32), number.reshape(-1, 3).astype(np.int32)


def strains(sheet: Sheet, x: NDArray[np.floating]) -> Floats:
    """(3m,) of the edges of each triangle: longer (positive) or shorter than in the fabric, as a share."""
    out = []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        rest = np.linalg.norm(sheet.material[:, b] - sheet.material[:, a], axis=1)
        now = np.linalg.norm(x[sheet.triangles[:, b]] - x[sheet.triangles[:, a]], axis=1)
        out.append(now / rest - 1)
    return np.concatenate(out)
