"""Strips and squares of cloth for tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vitruvian.cloth.fabric import Fabric, fabric
from vitruvian.cloth.pattern import Edge, Panel, Pattern
from vitruvian.cloth.sheet import Sheet
from vitruvian.cloth.tessellate import tessellate

COTTON = fabric("cotton")


def strip(
    width: float, height: float, size: float, cloth: Fabric = COTTON, *, grain: float = 0.0, **more: float
) -> tuple[Sheet, np.ndarray]:
    """A rectangle, and its vertices (n,3) in the plane z = 0; warp along y, turned by `grain` radians."""
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], float)
    panel = Panel(
        "strip", corners, tuple(Edge(i, (i + 1) % 4) for i in range(4)), grain=[-np.sin(grain), np.cos(grain)]
    )
    mesh = tessellate(Pattern("strip", (panel,)), size)
    sheet = Sheet(
        mesh.triangles, mesh.grain[mesh.triangles], np.zeros(len(mesh.triangles), int), (replace(cloth, **more),)
    )
    return sheet, np.column_stack([mesh.material, np.zeros(len(mesh.material))])


def lattice(width: int, rows: int, edge: float, cloth: Fabric) -> tuple[Sheet, np.ndarray]:
    """A strip of equilateral triangles, `width` edges of `edge` metres across and `rows` of them long; its vertices (n,3)
    in the plane y = 0, along z. Warp along z."""
    i, k = np.meshgrid(np.arange(width + 1), np.arange(rows + 1))
    flat = np.stack([(i + 0.5 * (k % 2)) * edge, k * edge * np.sqrt(0.75)], axis=-1).reshape(-1, 2)
    a = np.arange(width) + (width + 1) * np.arange(rows)[:, None]
    b = a + width + 1
    odd = (np.arange(rows) % 2 == 1)[:, None] & np.ones(width, bool)
    one = np.where(odd[..., None], np.stack([a, b + 1, b], axis=-1), np.stack([a, a + 1, b], axis=-1))
    two = np.where(odd[..., None], np.stack([a, a + 1, b + 1], axis=-1), np.stack([a + 1, b + 1, b], axis=-1))
    triangles = np.concatenate([one.reshape(-1, 3), two.reshape(-1, 3)]).astype(np.int32)
    sheet = Sheet(triangles, flat[triangles], np.zeros(len(triangles), int), (cloth,))
    return sheet, np.stack([flat[:, 0], np.zeros(len(flat)), flat[:, 1]], axis=1)
