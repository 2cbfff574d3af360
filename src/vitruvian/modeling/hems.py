"""Where clothes end on a limb: contours that follow the edge, so that a hem is a line and not a smear.

Where the outermost part of the skin changes (sleeve to arm), four contours stand close together: two on the garment, up
to its edge; one under the edge on what is within; one just beyond it. They are not flat: they go with the hem.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints
from vitruvian.modeling.slicing import Rings, barycentric

_SLICES = 24  # across a hem: so finely it is looked for
_BRIM, _UNDER, _BEYOND = 0.004, 0.004, 0.002  # metres of a person: the garment's last strip, and how far in and out
_APART = 0.008  # metres that other contours keep from those of a hem

Sliced = Callable[[Floats], Rings]  # contours at places 0..1 along a limb


@dataclass(frozen=True, eq=False)
class Hemmed:
    """Contours of a limb, with hems. s (C,) where they are, 0..1. bands: (contour, number of the skin's part): from that
    contour on, faces are of this part. shaded: pairs of a contour under a hem and the garment's edge above it."""

    s: Floats
    rings: Rings
    bands: tuple[tuple[int, int], ...] = ()
    shaded: tuple[tuple[int, int], ...] = ()


def outermost(rings: Rings, part: NDArray[np.int64]) -> Ints:
    """(C,P) numbers of the parts that the points lie on, by the parts (T,) of the triangles; -1 where none was met."""
    return np.where(rings.face >= 0, part[rings.face], -1).astype(np.int32)


def usual(parts: Ints) -> list[int]:
    """(C,) the part that most points of each contour lie on, -1 for none."""
    out = []
    for row in parts:
        some = row[row >= 0]
        out.append(int(np.bincount(some).argmax()) if len(some) else -1)
    return out


def hemmed(
    sliced: Sliced,
    s: Floats,
    plain: Rings,
    rest: Floats,
    triangles: Ints,
    part: NDArray[np.int64],
    length: float,
    scale: float,
) -> Hemmed:
    """The contours `plain` at `s` (C,) of a limb of this length (m), with four more at each hem instead of those that
    are too near. `part` (T,): the part of each triangle."""
    which = usual(outermost(plain, part))
    rows = [(float(x), _row(plain, k)) for k, x in enumerate(s)]
    bands, added = [(0.0, which[0])], []
    for k in np.flatnonzero(np.diff(which)).tolist():
        if -1 in (which[k], which[k + 1]):
            continue
        low, high = float(s[max(k - 1, 0)]), float(s[min(k + 2, len(s) - 1)])
        places = np.linspace(low, high, _SLICES)
        fine = sliced(places)
        parts = outermost(fine, part)
        hem = _edge(parts, places, which[k])
        reach = float(np.ptp(hem)) / 2 + _APART * scale / length
        at = float(hem.mean())
        if at - reach < s[0] or at + reach > s[-1]:
            continue
        wide = [_width(fine, parts, p) for p in which[k : k + 2]]
        first = wide[0] >= wide[1]  # the garment comes first
        brim, under, beyond = (x * scale / length for x in (_BRIM, _UNDER, _BEYOND))
        offsets = ((0, -brim), (0, 0.0), (1, -under), (1, beyond))
        if not first:
            offsets = ((0, -beyond), (0, under), (1, 0.0), (1, brim))
        middle = [at + x for x in ((-brim, 0.0, 1e-6, beyond) if first else (-beyond, 0.0, 1e-6, brim))]
        rows = [r for r in rows if abs(r[0] - at) > reach or r[0] in (s[0], s[-1])]
        for (side, offset), x in zip(offsets, middle, strict=True):
            rows.append((x, _on(fine, parts, places, which[k + side], hem + offset, rest, triangles)))
        bands.append((middle[2] if first else middle[1], which[k + 1]))
        added.append((middle[2], middle[1]) if first else (middle[1], middle[2]))
    rows.sort(key=lambda r: r[0])
    order = {x: n for n, (x, _) in enumerate(rows)}
    made = Rings(*(np.stack([getattr(r, f)[0] for _, r in rows]) for f in ("points", "face", "barycentric")))
    return Hemmed(
        np.array([x for x, _ in rows]), made, tuple((order[x] if x else 0, p) for x, p in bands),
        tuple((order[a], order[b]) for a, b in added),
    )  # fmt: skip


def _row(rings: Rings, k: int) -> Rings:
    return Rings(rings.points[k : k + 1], rings.face[k : k + 1], rings.barycentric[k : k + 1])


def _edge(parts: Ints, places: Floats, above: int) -> Floats:
    """(P,) where the part `above` ends in each direction, evened out round the limb."""
    last = np.where((parts == above).any(axis=0), len(parts) - 1 - np.argmax((parts == above)[::-1], axis=0), -1)
    some = np.flatnonzero((last >= 0) & (last < len(parts) - 1))
    if not len(some):
        return np.full(parts.shape[1], places.mean())
    step = places[1] - places[0]
    edge = np.interp(np.arange(parts.shape[1]), some, places[last[some]] + step / 2, period=parts.shape[1])
    for _ in range(3):
        edge = (np.roll(edge, 1) + 2 * edge + np.roll(edge, -1)) / 4
    return edge


def _width(fine: Rings, parts: Ints, part: int) -> float:
    """Mean distance of a part's points from the middles of their contours."""
    away = np.linalg.norm(fine.points - fine.points.mean(axis=1, keepdims=True), axis=2)
    mine = parts == part
    return float(away[mine].mean()) if mine.any() else 0.0


def _on(fine: Rings, parts: Ints, places: Floats, part: int, at: Floats, rest: Floats, triangles: Ints) -> Rings:
    """One contour on a part, at `at` (P,) along the limb: between two slices of it, or beyond the last two."""
    each = len(at)
    points, face, inside = np.zeros((1, each, 3)), np.zeros((1, each), np.int64), np.zeros((1, each, 3))
    for j in range(each):
        mine = np.flatnonzero(parts[:, j] == part)
        if len(mine) < 2:
            mine = np.arange(len(places))
        k = int(np.clip(np.searchsorted(places[mine], at[j]), 1, len(mine) - 1))
        a, b = mine[k - 1], mine[k]
        t = (at[j] - places[a]) / (places[b] - places[a])
        points[0, j] = fine.points[a, j] + t * (fine.points[b, j] - fine.points[a, j])
        face[0, j] = fine.face[a if t < 0.5 else b, j]
    some = face[0] >= 0
    inside[0, some] = barycentric(rest[triangles[face[0, some]]], points[0, some])
    return Rings(points, face, inside)


def clear(sliced: Sliced, part: NDArray[np.int64], margin: float, start: float = 0.66) -> float:
    """Where a limb should end, at most 1: `margin` (share of its length) before the first edge of clothes after `start`,
    so that shoes, cuffs and collars there keep their layers."""
    places = np.linspace(start, 1.0, 18)
    parts = outermost(sliced(places), part)
    which = usual(parts)
    changed = np.flatnonzero((parts != which[0]) & (parts >= 0)) // parts.shape[1]
    return float(places[max(changed[0] - 1, 0)]) - margin if len(changed) else 1.0
