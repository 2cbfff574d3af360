"""Levels of detail of a contour body: each a subset of the contours and points of the finer one.

Every contour keeps its shares of the joints' rotations, so a point of a coarse level is where it is at full detail, to
the bit. Source: cross-section deformation of H-Anim bodies, levels of detail as contour and point subsets.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.contours import Contours, carried_on, grid
from vitruvian.body.types import Body, Floats, Ints, Part, Skin, Weights, require
from vitruvian.deform.contour_steps import normals


def coarser(body: Body, *, contours: int = 2, points: int = 2) -> tuple[Body, Ints]:
    """A body with every `contours`-th contour and every `points`-th point of each, and (V',) which vertices it kept.

    Seams, hems, and the contours where a joint begins or ends to turn a surface, are always kept, so that neighbours
    still meet and bend in the same places. What is not organised in contours stays as it is. Points keep their texture
    coordinates to the bit; where one lies on several parts, it keeps those of each.
    """
    require(contours >= 1 and points >= 1, "level of detail", "steps of 1 or more", (contours, points))
    require(bool(body.contours), "level of detail", "a body with contours", "none")
    skin = body.skin
    owner, row = np.full(len(skin.rest), -1), np.full(len(skin.rest), -1)
    kept = np.ones(len(skin.rest), bool)
    grids: list[tuple[Contours, NDArray[np.int64], NDArray[np.int64]]] = []
    hems: list[list[int]] = [[] for _ in body.contours]
    for number, surface in enumerate(body.contours):
        owner[surface.vertices], row[surface.vertices] = number, np.arange(len(surface))[:, None]
        row[surface.tied[:, 0]] = surface.tied[:, 1]
        kept[surface.vertices] = False
    for part in skin.parts:
        faces = skin.triangles[part.start : part.stop]
        if len(faces) and (owner[faces] >= 0).all():
            start = int(row[faces].min())
            hems[owner[faces[0, 0]]] += [start - 1, start, start + 1] if start else []
    for surface, edges in zip(body.contours, hems, strict=True):
        rows, columns = _rows(surface, contours, edges), _columns(surface, points)
        grids.append((surface, rows, columns))
        kept[surface.vertices[np.ix_(rows, columns)]] = True
    source = np.flatnonzero(kept)
    place = np.full(len(kept), -1, np.int64)
    place[source] = np.arange(len(source))
    triangles: list[Ints] = []
    looks: list[Ints] = []
    parts: list[Part] = []
    total = 0
    for part in skin.parts:
        faces = skin.triangles[part.start : part.stop]
        corners = None if skin.uv_triangles is None else skin.uv_triangles[part.start : part.stop]
        if len(faces) and (owner[faces] >= 0).all():
            surface, rows, columns = grids[owner[faces[0, 0]]]
            first, last = (int(f(row[faces])) for f in (np.min, np.max))
            mine = rows[(rows >= first) & (rows <= last)]
            sewn, own = _fringe(skin.rest, surface, columns)
            fits = (row[sewn].min(axis=1, initial=last) >= first) & (row[sewn].max(axis=1, initial=first) <= last)
            plain = grid(surface.vertices[np.ix_(mine, columns)], surface.closed)
            if corners is not None:
                looks.append(_mapped(surface, np.concatenate([plain, own[fits]]), corners, first, last))
            faces = np.concatenate([plain, sewn[fits]])
        else:
            whole = kept[faces].all(axis=1)
            faces = faces[whole]
            if corners is not None:
                looks.append(corners[whole])
        faces = place[faces].astype(np.int32)
        triangles.append(faces)
        parts.append(replace(part, start=total, stop=total + len(faces)))
        total += len(faces)
    smaller = Skin(
        skin.rest[source],
        np.concatenate(triangles),
        _weights(skin.weights, source),
        *_looks(skin, looks),
        colors=None if skin.colors is None else skin.colors[source],
        parts=tuple(parts),
        morphs=tuple(
            replace(m, index=place[m.index[kept[m.index]]].astype(np.int32), offset=m.offset[kept[m.index]])
            for m in skin.morphs
            if kept[m.index].any()
        ),
    )
    surfaces = tuple(
        replace(
            s, vertices=place[s.vertices[np.ix_(rows, columns)]].astype(np.int32), swing=s.swing[rows],
            twist=s.twist[rows], diversion=s.diversion[rows], mitre=s.mitre[rows], bulge=s.bulge[rows],
            recentre=s.recentre[rows], middle=_middles(body, s)[rows],
            normal=_normals(body, s)[rows],
            tied=np.stack([place[s.tied[:, 0]], np.searchsorted(rows, s.tied[:, 1])], axis=1).astype(np.int32),
        )
        for s, rows, columns in grids
    )  # fmt: skip
    return replace(body, skin=smaller, contours=surfaces), source.astype(np.int32)


def _fringe(rest: Floats, s: Contours, columns: NDArray[np.int64]) -> tuple[Ints, Ints]:
    """(T,3) triangles between the kept points of a surface's ends and the vertices tied to the others: no gap opens
    between a coarse contour and what is sewn to all of its points. The second (T,3) has for those vertices the points of
    the contour that they lie on."""
    out: list[list[int]] = []
    lain: list[list[int]] = []
    count, each = s.vertices.shape
    for k in (0, count - 1):
        tied = {rest[v].tobytes(): int(v) for v in s.tied[s.tied[:, 1] == k, 0]}
        ring = s.vertices[k].tolist()
        ends = [*columns.tolist(), columns[0] + each] if s.closed else columns.tolist()
        for a, b in zip(ends, ends[1:]):
            between = [tied.get(rest[ring[c % each]].tobytes(), -1) for c in range(a + 1, b)]
            if -1 in between:
                continue
            line, under = [ring[a], *between, ring[b % each]], [ring[c % each] for c in range(a, b + 1)]
            for i in range(1, len(line) - 1):
                order = (0, i + 1, i) if k == 0 else (0, i, i + 1)
                out.append([line[n] for n in order])
                lain.append([under[n] for n in order])
    sewn, own = (np.array(faces, np.int32).reshape(-1, 3) for faces in (out, lain))
    return sewn, own


def _mapped(s: Contours, faces: Ints, corners: Ints, first: int, last: int) -> Ints:
    """(T,3) the texture coordinates of faces (T,3) between points of a surface, whose faces from contour `first` to `last`
    have `corners` (t,3), those of its `grid` before others."""
    each = s.vertices.shape[1]
    wide = each if s.closed else each - 1
    place = np.zeros(int(s.vertices.max()) + 1, np.int64)
    place[s.vertices] = np.arange(s.vertices.size).reshape(s.vertices.shape)
    count = (last - first) * wide
    quads = np.concatenate([corners[:count, [0, 2, 1]], corners[count : 2 * count, 1:2]], axis=1)
    return carried_on(quads.reshape(-1, wide, 4), place[faces] - first * each, each, s.closed)


def _looks(skin: Skin, corners: list[Ints]) -> tuple[Floats | None, Ints | None]:
    """Texture coordinates that corners (T,3), by parts, are still of, and the corners' numbers among them."""
    if skin.uv is None:
        return None, None
    used, flat = np.unique(np.concatenate(corners), return_inverse=True)
    return skin.uv[used], flat.reshape(-1, 3).astype(np.int32)


def _middles(body: Body, surface: Contours) -> Floats:
    return surface.middle if surface.middle is not None else body.skin.rest[surface.vertices].mean(axis=1)


def _normals(body: Body, surface: Contours) -> Floats:
    return surface.normal if surface.normal is not None else normals(body.skin.rest[surface.vertices])


def _rows(surface: Contours, step: int, edges: list[int]) -> NDArray[np.int64]:
    """Contours that are kept: every `step`-th, the seams, `edges`, and where the shares of a joint begin or stop to
    change."""
    count = len(surface)
    keep = np.zeros(count, bool)
    keep[[k for k in edges if 0 <= k < count]] = True
    keep[::step] = keep[[0, -1]] = True
    changing = np.abs(np.diff(surface.swing, axis=0)) > 1e-12
    for column in changing.T:
        ends = np.flatnonzero(np.diff(np.concatenate([[False], column, [False]]).astype(np.int8)))
        keep[np.clip(ends, 0, count - 1)] = True
    return np.flatnonzero(keep)


def _columns(surface: Contours, step: int) -> NDArray[np.int64]:
    count = surface.vertices.shape[1]
    keep = np.zeros(count, bool)
    keep[::step] = True
    if not surface.closed:
        keep[-1] = True
    return np.flatnonzero(keep)


def _weights(weights: Weights, source: NDArray[np.int64]) -> Weights:
    place = np.full(len(weights), -1, np.int64)
    place[source] = np.arange(len(source))
    keep = place[weights.vertex] >= 0
    return Weights.from_pairs(len(source), place[weights.vertex[keep]], weights.joint[keep], weights.weight[keep])
