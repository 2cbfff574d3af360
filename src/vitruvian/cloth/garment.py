"""A sewn garment: what the tailor hands over."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from vitruvian.body.types import Floats, Ints
from vitruvian.cloth.fabric import Fabric
from vitruvian.cloth.pattern import Pattern, area
from vitruvian.cloth.sheet import Sheet, sides
from vitruvian.cloth.tessellate import PanelMesh


@dataclass(frozen=True, eq=False)
class Hung:
    """How a garment hangs on the body that it was draped on when that stands with its arms down, x (w,3) metres, and the
    layer (w,) of each of its vertices, see `vitruvian.cloth.layers`."""

    x: Floats
    layer: Ints


@dataclass(frozen=True, eq=False)
class Garment:
    """A pattern sewn and draped on a body.

    mesh: its flat panels; weld (n,): the garment's vertex of each of theirs; vertices (w,3) metres, humanoid space, where
    it hangs on the body posed by matrices (J,4,4); fabrics: one for each panel. report: how it was made and fits, see
    `vitruvian.cloth.tailor.tailor`; below: the garments that it is worn over, as they lie under it, innermost first.
    graded (m,3,2) metres, weft and warp: the corners of its triangles in a cloth that is cut larger or smaller than the
    panels, see `vitruvian.cloth.resizing`; None: as the panels are. hung: what `vitruvian.cloth.wear.hung` has found out.
    """

    pattern: Pattern
    mesh: PanelMesh
    weld: Ints
    vertices: Floats
    fabrics: tuple[Fabric, ...]
    matrices: Floats
    report: Mapping[str, Any] = field(default_factory=dict)
    below: tuple[Garment, ...] = ()
    graded: Floats | None = None
    hung: Hung | None = None

    @property
    def name(self) -> str:
        return self.pattern.name

    @cached_property
    def triangles(self) -> Ints:
        """(m,3) of the garment's vertices, facing away from the body."""
        return self.weld[self.mesh.triangles]

    @cached_property
    def sheet(self) -> Sheet:
        """What the solver knows of it."""
        out = sewn(self.mesh, self.weld, self.fabrics)
        return out if self.graded is None else replace(out, material=self.graded)


def sewn(mesh: PanelMesh, weld: Ints | None, fabrics: tuple[Fabric, ...]) -> Sheet:
    """The sheet of flat panels, welded or (None) each for itself; `fabrics` of the panels.

    Where both sides of a seam differ in length, the longer is gathered: along the seam its rest length is the shorter's, as
    its folds are finer than the mesh.
    """
    different = tuple(dict.fromkeys(fabrics))
    number = np.array([different.index(f) for f in fabrics], np.int32)
    triangles = mesh.triangles if weld is None else weld[mesh.triangles]
    material = mesh.grain[mesh.triangles]
    if weld is not None:
        material = _gathered(triangles, material)
    return Sheet(triangles, material, number[mesh.panel[mesh.triangles[:, 0]]], different)


def buttoned(pattern: Pattern, mesh: PanelMesh) -> Ints:
    """(b,2) the vertices of a pattern's flat panels that are nearest to both places of each of its buttons."""
    number = {p.name: k for k, p in enumerate(pattern.panels)}
    out = np.empty((len(pattern.buttons), 2), np.int32)
    for k, button in enumerate(pattern.buttons):
        for side, (panel, at) in enumerate((button.a, button.b)):
            own = np.flatnonzero(mesh.panel == number[panel])
            out[k, side] = own[np.linalg.norm(mesh.material[own] - at, axis=1).argmin()]
    return out


FINEST = 0.2  # of its length that a side is gathered to at most


def _gathered(triangles: Ints, material: Floats) -> Floats:
    """material (m,3,2), each triangle shortened along those of its sides that are shorter in another triangle."""
    edges, side = sides(triangles)
    lengths = np.linalg.norm(np.roll(material, -1, axis=1) - material, axis=2)
    least = np.full(len(edges), np.inf)
    np.minimum.at(least, side.ravel(), lengths.ravel())
    out = material.copy()
    for k in range(3):
        share = np.maximum(least[side[:, k]] / lengths[:, k], FINEST)
        some = share < 1 - 1e-6
        way = (material[some, (k + 1) % 3] - material[some, k]) / lengths[some, k, None]
        along = np.einsum("mkx,mx->mk", out[some], way)
        out[some] += ((share[some] - 1)[:, None] * along)[..., None] * way[:, None]
    return out


GAP = 0.02  # metres between panels in the picture that texture coordinates speak of


def charted(garment: Garment) -> tuple[Floats, Ints]:
    """Texture coordinates (n,2) of the panels' vertices, laid out beside each other at one scale, and (m,3) which of them
    each corner has. Panels that wind clockwise are mirrored, so that print reads right from outside."""
    mesh = garment.mesh
    x = y = row = 0.0
    sizes = [mesh.material[mesh.panel == k] for k in range(len(garment.pattern.panels))]
    wide = max(1e-6, sum(float(np.prod(np.ptp(s, axis=0) + GAP)) for s in sizes)) ** 0.5 * 1.2
    out = np.empty_like(mesh.material)
    for k, own in enumerate(sizes):
        flat = own * [np.sign(area(garment.pattern.panels[k])) or 1.0, 1.0]
        low, (width, height) = flat.min(axis=0), np.ptp(flat, axis=0)
        if x and x + width > wide:
            x, y, row = 0.0, y + row + GAP, 0.0
        out[mesh.panel == k] = flat - low + [x, y]
        x, row = x + float(width) + GAP, max(row, float(height))
    return out / max(float(out.max()), 1e-6), mesh.triangles
