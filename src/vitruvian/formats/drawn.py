"""Pieces as files of other programs draw them, and the panels that are cut from them.

Source: note cloth.md, sections 2.2 to 2.4.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.cutting import Segment, mirrored, notched, panel_of, unfolded
from vitruvian.cloth.pattern import Panel
from vitruvian.errors import VitruvianError

EDGES, NOTCHES = 5000, 200  # of a piece
MIRRORED = "_mirrored"  # what the name of a copy for the body's other side ends with


@dataclass(frozen=True, eq=False)
class Drawn:
    """A piece: its panel without a place, the line it is cut on the fold of, its notches (what kind, where), and how it is
    cut where nobody says otherwise: how many times, and whether every second one is mirrored. All metres, v up."""

    panel: Panel
    fold: Floats | None = None
    notches: tuple[tuple[str, Floats], ...] = ()
    copies: int = 1
    mirror: bool = False


@dataclass(frozen=True)
class Cut:
    """How a piece is cut: None is as the file has it."""

    unfold: bool | None = None
    copies: int | None = None
    mirror: bool | None = None


def drawn(
    name: str,
    outlines: Sequence[Sequence[Segment]],
    *,
    names: Sequence[str] = (),
    fold: Floats | None = None,
    grain: Floats | None = None,
    notches: Sequence[tuple[str, Floats]] = (),
    copies: int = 1,
    mirror: bool = False,
    wind: bool = True,
) -> Drawn:
    """A piece of outline and holes, split at its notches. The grain is the fold's where none is given."""
    if len(notches) > NOTCHES or sum(len(run) for run in outlines) > EDGES:
        raise VitruvianError(f"piece {name:.40}: expected at most {EDGES} edges and {NOTCHES} notches")
    panel, _, used = notched(panel_of(name, outlines, names, wind=wind), [at for _, at in notches])
    way = grain if grain is not None else None if fold is None else fold[1] - fold[0]
    if way is not None and np.hypot(*way) > 1e-6:
        way = way / np.hypot(*way)
        panel = replace(panel, grain=(way if (round(way[1], 9), way[0]) > (0, 0) else -way) + 0.0)
    return Drawn(panel, fold, tuple(notches[k] for k in used), copies, mirror)


def cut(pieces: Sequence[Drawn], ways: Mapping[str, Cut] | None = None) -> tuple[tuple[Panel, ...], list[list[object]]]:
    """The panels of pieces, and their notches as [panel, edge that starts there, kind].

    Those on the fold are unfolded; mirrored copies are named NAME_mirrored, further ones NAME_2, NAME_2_mirrored.
    """
    panels: list[Panel] = []
    marks: list[list[object]] = []
    for piece in pieces:
        name = piece.panel.name
        how = (ways or {}).get(name, Cut())
        whole, places = piece.panel, [at for _, at in piece.notches]
        kinds = [kind for kind, _ in piece.notches]
        if how.unfold and piece.fold is None:
            raise VitruvianError(f"piece {name:.40}: expected a fold to unfold it about, found none")
        if piece.fold is not None and how.unfold is not False:
            whole = unfolded(whole, piece.fold)
            places, kinds = places + list(_over(piece.fold, places)), 2 * kinds
        copies = piece.copies if how.copies is None else how.copies
        mirror = piece.mirror if how.mirror is None else how.mirror
        for k in range(copies):
            turned = mirror and k % 2 == 1
            number = k // 2 if mirror else k
            title = name + (f"_{number + 1}" if number else "")
            panels.append(mirrored(whole, title + MIRRORED) if turned else replace(whole, name=title))
            for kind, at in zip(kinds, places):
                marks += _marked(panels[-1], at * [-1.0, 1.0] if turned else at, kind)
    return tuple(panels), marks


def _over(fold: Floats, places: Sequence[Floats]) -> list[Floats]:
    way = (fold[1] - fold[0]) / np.hypot(*(fold[1] - fold[0]))
    across = np.array([-way[1], way[0]])
    return [at - 2 * ((at - fold[0]) @ across) * across for at in places]


def _marked(panel: Panel, at: Floats, kind: str) -> list[list[object]]:
    starts = np.array([panel.vertices[e.start] for e in panel.edges])
    apart = np.hypot(*(starts - at).T)
    near = int(apart.argmin())
    return [[panel.name, near, kind]] if apart[near] < 0.012 else []


def within(outer: Sequence[Segment], inner: Sequence[Segment]) -> bool:
    """Whether a run lies inside another: its first point does."""
    ring = np.concatenate([points[:-1] for _, points in outer])
    x, y = inner[0][1][0]
    a, b = ring, np.roll(ring, -1, axis=0)
    crosses = (a[:, 1] > y) != (b[:, 1] > y)
    rise = np.where(crosses, b[:, 1] - a[:, 1], 1.0)
    return bool((crosses & (x < a[:, 0] + (y - a[:, 1]) / rise * (b[:, 0] - a[:, 0]))).sum() % 2)


def size(run: Sequence[Segment]) -> float:
    """Square metres of a closed run, by its points."""
    ring = np.concatenate([points[:-1] for _, points in run])
    a, b = ring, np.roll(ring, -1, axis=0)
    return abs(0.5 * float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])))


def different(pieces: Sequence[Drawn]) -> list[Drawn]:
    """Pieces whose names are all different: later ones get a number."""
    out: list[Drawn] = []
    taken: set[str] = set()
    for piece in pieces:
        name, k = piece.panel.name, 1
        while name in taken:
            k += 1
            name = f"{piece.panel.name}_{k}"
        taken.add(name)
        out.append(replace(piece, panel=replace(piece.panel, name=name)))
    return out
