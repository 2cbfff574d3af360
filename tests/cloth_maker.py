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
