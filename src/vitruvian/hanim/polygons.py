"""Quadrilaterals that triangles were cut from, for writing: quads before triangles, as modelling programs like them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vitruvian.hanim.humanoid import Shape

Ints = NDArray[np.int32]


def corner_loops(shape: Shape) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(q,4) quads and (r,3) triangles of a shape; entries number the corners, 3 t + k for corner k of triangle t.

    Two triangles that follow each other are a quad when `Shape.faces` says that they are one polygon and they agree on
    the points, texture coordinates and normals of their common edge. A quad begins at that edge, so that readers who
    fan it out get the same two triangles. Together the loops have every triangle once.
    """
    triangles = shape.triangles
    corners = np.arange(3 * len(triangles)).reshape(-1, 3)
    faces = shape.faces
    if faces is None or len(faces) != len(triangles) or len(triangles) < 2:
        return np.zeros((0, 4), np.int64), corners
    size = np.bincount(faces)[faces]
    first = np.flatnonzero((faces[:-1] == faces[1:]) & (size[:-1] == 2))
    tables = [triangles.reshape(-1)]
    tables += [t.reshape(-1) for t in (shape.uv_triangles, shape.normal_triangles) if t is not None]
    quads = np.full((len(first), 4), -1)
    for turn in range(3):
        for other in range(3):
            a = corners[first][:, (turn + np.arange(3)) % 3]
            b = corners[first + 1][:, (other + np.arange(3)) % 3]
            fit = quads[:, 0] < 0
            for table in tables:
                fit &= (table[a[:, 0]] == table[b[:, 0]]) & (table[a[:, 2]] == table[b[:, 1]])
            quads[fit] = np.column_stack([a, b[:, 2]])[fit]
    good = quads[:, 0] >= 0
    alone = np.ones(len(triangles), bool)
    alone[first[good]] = alone[first[good] + 1] = False
    return quads[good], corners[alone]


def closed(table: Ints, loops: tuple[NDArray[np.int64], NDArray[np.int64]]) -> Ints:
    """What a (t,3) table has at the corners of loops, as a coordIndex list with -1 behind each polygon."""
    flat = table.reshape(-1)
    rows = []
    for corners in loops:
        if len(corners):
            row = np.full((len(corners), corners.shape[1] + 1), -1, np.int32)
            row[:, :-1] = flat[corners]
            rows.append(row.reshape(-1))
    return rows[0] if len(rows) == 1 else np.concatenate([*rows, np.zeros(0, np.int32)])
