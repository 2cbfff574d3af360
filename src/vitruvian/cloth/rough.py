"""Loose cloth about the trunk: a rough mesh is animated physically, and deforms the fine one.

Source: seed 003, section 5.3.2; note cloth.md, section 7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vitruvian.body.types import Floats, Ints
from vitruvian.cloth.binding import bind
from vitruvian.cloth.moving import Planes, Skin, feet
from vitruvian.cloth.sheet import Sheet
from vitruvian.cloth.solver import Cloth, State, assemble, step
from vitruvian.deform.normals import Incidence, incidence, mesh_normals

Single = NDArray[np.float32]
SHARE = 0.07  # of the vertices that the rough mesh has
STEPS = 5  # of a frame
DAMPING = 4.0  # 1/s, relative to the body
LEAST = 0.003  # metres from the skin


@dataclass(frozen=True, eq=False)
class Rough:
    """vertices (r,) of the garment that the rough mesh has, its `cloth`, of which `border` (b,) are moved; incidence of its
    triangles. fine (k,) vertices of the garment hang on its triangles `corner` (k,3) by shares (k,3) and offsets (k,3),
    and make up a part (k,) of their places, less than one near other layers; least (k,) metres from the skin."""

    vertices: Ints
    cloth: Cloth
    border: Ints
    incidence: Incidence
    fine: Ints
    corner: Ints
    share: Single
    offset: Single
    part: Single
    least: Single


def made(
    sheet: Sheet, x: Floats, least: Floats, mine: NDArray[np.bool_], kept: NDArray[np.bool_], rings: Ints, band: int
) -> Rough | None:
    """A rough mesh of the vertices `mine` (n,) of a garment at x (n,3), and a band beside them of those `kept` (n,) that
    other layers move; None where there is not enough for one. least (n,) metres from the skin;
    rings (n,): how many sides each is from `kept` ones."""
    beside = mine.copy()
    for _ in range(2):  # what other layers move holds the rough mesh at its border
        beside[sheet.edges[beside[sheet.edges].any(axis=1)].ravel()] = True
    domain = mine | (beside & kept)
    triangles = sheet.triangles[domain[sheet.triangles].all(axis=1)]
    domain[:] = False
    domain[triangles.ravel()] = True
    mine = mine & domain
    if mine.sum() < 30:
        return None
    seeds, coarse = thinned(x, triangles, domain, max(8, round(SHARE * domain.sum())))
    used = np.unique(coarse)
    number = np.full(len(seeds), -1, np.int32)
    number[used] = np.arange(len(used))
    coarse, seeds = number[coarse], seeds[used]
    border = np.flatnonzero(~mine[seeds]).astype(np.int32)
    corners = x[seeds[coarse]]
    fabric = _fabrics(sheet, seeds[coarse[:, 0]])
    cloth = assemble(Sheet(coarse, _flat(corners), fabric, sheet.fabrics), pinned=border)
    around = incidence(x[seeds], coarse)
    normals = mesh_normals(around, x[seeds][None].astype(np.float32))[0]
    fine = np.flatnonzero(mine).astype(np.int32)
    bound = bind(x[seeds].astype(np.float64), coarse, x[fine], normals=normals.astype(np.float64))
    return Rough(
        seeds.astype(np.int32), cloth, border, around, fine, np.ascontiguousarray(coarse[bound.face], np.int32),
        bound.share.astype(np.float32), bound.offset.astype(np.float32),
        np.minimum(1.0, rings[fine] / (band + 1)).astype(np.float32),
        least[fine].astype(np.float32),
    )  # fmt: skip


def moved(
    rough: Rough, state: State, x: Single, before: tuple[Single, Single], now: tuple[Single, Single], drift: Floats,
    dt: float, gravity: ArrayLike, wind: ArrayLike | None,
) -> State:  # fmt: skip
    """The rough mesh `dt` seconds later. x (n,3): the garment, which has its border; feet (n,3) and their normals before
    and now; drift (3,) m/s of the body, with which the air moves."""
    some = rough.vertices
    planes = Planes(now[0][some], now[1][some], before[0][some], before[1][some], LEAST)
    pull = np.asarray(gravity, np.float64) + DAMPING * drift
    return step(
        rough.cloth, state, dt=dt, substeps=STEPS, gravity=(pull[0], pull[1], pull[2]), damping=DAMPING,
        targets=x[some[rough.border]], obstacle=planes, wind=wind,
    )  # fmt: skip


def placed(rough: Rough, state: State, x: Single, foot: Single, up: Single) -> None:
    """Puts the fine vertices of x (n,3) where the rough mesh has them, and not nearer to the skin, at its feet (n,3) with
    their normals, than they may be."""
    normals = mesh_normals(rough.incidence, state.x[None])[0]
    skin = Skin(state.x, normals, rough.cloth.sheet.triangles, np.zeros(len(state.x), np.int8))
    out = feet(skin, rough.corner, rough.share, rough.offset)[2]
    bound = x[rough.fine]
    at = bound + rough.part[:, None] * (out - bound)
    n = up[rough.fine]
    at += np.maximum(rough.least - np.einsum("kx,kx->k", at - foot[rough.fine], n), 0)[:, None] * n
    x[rough.fine] = at


def thinned(x: Floats, triangles: Ints, domain: NDArray[np.bool_], count: int) -> tuple[Ints, Ints]:
    """About `count` vertices (r,) of a surface, spread evenly over the domain (n,), and triangles (t,3) between them: one
    for each of the surface's triangles whose corners are nearest, along the surface, to three different ones. Its border
    comes first, so that it keeps its outline."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    n = len(x)
    edges, times = np.unique(np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]),
                                     axis=1), axis=0, return_counts=True)  # fmt: skip
    rim = np.zeros(n, bool)
    rim[edges[times == 1].ravel()] = True
    corner = x[triangles]
    size = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1).sum()
    far = np.sqrt(size / count)  # metres between neighbours, about
    seeds: list[int] = []
    free = domain.copy()
    from scipy.spatial import cKDTree

    tree = cKDTree(x)
    for group in (np.flatnonzero(domain & rim), np.flatnonzero(domain & ~rim)):
        for v in group:
            if free[v]:
                seeds.append(int(v))
                free[tree.query_ball_point(x[v], far)] = False
    chosen = np.array(seeds, np.int64)
    length = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1)
    graph = coo_array((np.tile(length, 2), np.concatenate([edges, edges[:, ::-1]]).T), (n, n)).tocsr()
    _, _, source = dijkstra(graph, directed=False, indices=chosen, min_only=True, return_predecessors=True)
    number = np.full(n + 1, -1, np.int64)
    number[chosen] = np.arange(len(chosen))
    owner = number[np.where(source < 0, n, source)]
    face = owner[triangles]
    some = (
        (face >= 0).all(axis=1) & (face[:, 0] != face[:, 1]) & (face[:, 1] != face[:, 2]) & (face[:, 2] != face[:, 0])
    )
    face = face[some]
    _, first = np.unique(np.sort(face, axis=1), axis=0, return_index=True)
    return chosen.astype(np.int32), face[np.sort(first)].astype(np.int32)


def _flat(corners: Floats) -> Floats:
    """(t,3,2): triangles (t,3,3) laid into the plane as they are."""
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    long = np.linalg.norm(u, axis=1)
    along = np.einsum("tx,tx->t", u, v) / long
    high = np.sqrt(np.maximum(np.einsum("tx,tx->t", v, v) - along**2, 1e-12))
    zero = np.zeros(len(u))
    return np.stack([np.stack([zero, zero], 1), np.stack([long, zero], 1), np.stack([along, high], 1)], axis=1)


def _fabrics(sheet: Sheet, vertices: Ints) -> Ints:
    """(t,) the fabric of each of these vertices, of one triangle that has it."""
    of = np.zeros(sheet.count, np.int32)
    of[sheet.triangles.ravel()] = np.repeat(sheet.fabric, 3)
    return of[vertices]
