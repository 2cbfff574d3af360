"""Faces and points of a surface in the order that other programs want: quads before triangles, points by first use.

Source: the Quad/Tri rearrange plug-in (seed 003, table 1; note body.md, section 6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vitruvian.body.types import Ints, require
from vitruvian.errors import warn
from vitruvian.hanim.humanoid import Humanoid, Shape
from vitruvian.modeling.rows import chosen


@dataclass(frozen=True, eq=False)
class Arranged:
    """A figure in another order, and the way back.

    `quads`: for each shape of the skin how many quads it begins with. `triangle_perm`: for each the old number of each
    triangle. `vertex_perm` (V,): the old number of each point; `chosen(humanoid, np.argsort(vertex_perm))` undoes it.
    """

    humanoid: Humanoid
    quads: tuple[int, ...]
    triangle_perm: tuple[Ints, ...]
    vertex_perm: Ints


def quads_first(faces: Sequence[Sequence[int]]) -> tuple[Ints, int, Ints]:
    """Faces (F,4), quads before triangles, each kind in its old order; how many quads; (F,) which face each was.

    A triangle repeats its last corner, in the answer and, if they are like that, in `faces`. Faces with more corners
    are cut into fans of triangles, with one warning. Raises VitruvianError for faces with fewer than three corners.
    """
    quads: list[list[int]] = []
    threes: list[list[int]] = []
    quad_of: list[int] = []
    three_of: list[int] = []
    cut = 0
    for number, corners in enumerate(faces):
        face = [int(c) for c in corners]
        while len(face) > 1 and face[-1] == face[-2]:
            face.pop()
        require(len(face) >= 3, f"face {number}", "three or more corners", face)
        if len(face) == 4:
            quads.append(face)
            quad_of.append(number)
            continue
        cut += len(face) > 4
        for k in range(1, len(face) - 1):
            threes.append([face[0], face[k], face[k + 1], face[k + 1]])
            three_of.append(number)
    if cut:
        warn(f"{cut} of {len(faces)} faces have more than four corners; they are cut into triangles")
    return np.array(quads + threes, np.int32).reshape(-1, 4), len(quads), np.array(quad_of + three_of, np.int32)


def first_use(faces: Ints, count: int) -> Ints:
    """(count,) old numbers of points in the order in which faces (F,n) use them first; those in no face come last."""
    used, first = np.unique(np.asarray(faces).ravel(), return_index=True)
    rest = np.setdiff1d(np.arange(count), used)
    return np.concatenate([used[np.argsort(first)], rest]).astype(np.int32)


def rearrange(humanoid: Humanoid, *, points: bool = True) -> Arranged:
    """A copy whose skin shapes have their quads before their triangles, and whose points are numbered by first use.

    Quads are the polygons that a file's triangles were cut from (`Shape.faces`). Without `points` they keep their numbers.
    Weights, colours, texture coordinates and displacers go with their points, to the bit. Polygons of more than four
    corners count as triangles, with a warning. Raises VitruvianError for triangles whose points the skin does not have.
    """
    skin: list[Shape] = []
    quads: list[int] = []
    perms: list[Ints] = []
    cut = 0
    for shape in humanoid.skin:
        order, first, many = _order(shape)
        cut += many
        some = lambda a: None if a is None else a[order]  # noqa: E731, B023
        numbers = None
        if shape.faces is not None:
            rest = len(order) - 2 * first
            numbers = np.concatenate([np.repeat(np.arange(first), 2), first + np.arange(rest)]).astype(np.int32)
        skin.append(
            replace(
                shape,
                triangles=shape.triangles[order],
                uv_triangles=some(shape.uv_triangles),
                normal_triangles=some(shape.normal_triangles),
                faces=numbers,
                node=None,
            )
        )
        quads.append(first)
        perms.append(order)
    if cut:
        warn(f"{cut} faces have more than four corners; they count as triangles")
    out = replace(humanoid.copied(), skin=skin)
    count = len(humanoid.skin_coord)
    perm = np.arange(count, dtype=np.int32)
    if points:
        used = [s.triangles for s in skin if s.points is None]
        flat = np.concatenate([np.zeros((0, 3), np.int32), *used])
        require(
            not len(flat) or (flat.min() >= 0 and flat.max() < count), "triangles", f"points below {count}", "others"
        )
        perm = first_use(flat, count)
        out = chosen(out, perm)
    return Arranged(out.settled(), tuple(quads), tuple(perms), perm)


def _order(shape: Shape) -> tuple[Ints, int, int]:
    """Old numbers of triangles in the new order, how many quads they begin with, and how many polygons are larger."""
    if shape.faces is None:
        return np.arange(len(shape.triangles), dtype=np.int32), 0, 0
    _, first, number, size = np.unique(shape.faces, return_index=True, return_inverse=True, return_counts=True)
    number = number.reshape(-1)
    kind = size[number] != 2
    order = np.lexsort((np.arange(len(number)), first[number], kind))
    return order.astype(np.int32), int((size == 2).sum()), int((size > 2).sum())
