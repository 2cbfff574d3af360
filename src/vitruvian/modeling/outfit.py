"""Clothes of the built-in person: surfaces cut from the source's tights, smoothed outward, with hems and seams."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags, identity

from vitruvian.body.types import Floats
from vitruvian.errors import VitruvianError
from vitruvian.modeling import anatomy, source
from vitruvian.modeling.look import Color, LookPart, looks, named
from vitruvian.modeling.rest import cross

# Name -> (title of the shape, second colour as a factor and an addition, roughness, smoothing rounds, hem in metres).
GARMENTS = {
    "t-shirt": ("top", (0.86, 0.0), 0.85, 24, 0.004),
    "shorts": ("shorts", (1.0, 0.0), 0.8, 10, 0.004),
    "trousers": ("trousers", (1.0, 0.0), 0.8, 40, 0.003),
    "suit": ("suit", (0.7, 0.0), 0.7, 4, 0.0012),
    "shoes": ("shoes", (0.0, 0.9), 0.6, 6, 0.003),
}
OUTFITS: dict[str, tuple[str, ...]] = {
    "t-shirt and shorts": ("shorts", "t-shirt", "shoes"),
    "t-shirt and trousers": ("trousers", "t-shirt", "shoes"),
    "body suit": ("suit",),
}
COLORS: dict[str, Color] = {
    "white": (0.90, 0.90, 0.88), "grey": (0.45, 0.46, 0.48), "charcoal": (0.20, 0.21, 0.23), "navy": (0.13, 0.18, 0.30),
    "blue": (0.23, 0.40, 0.58), "teal": (0.13, 0.42, 0.44), "green": (0.24, 0.42, 0.29), "red": (0.62, 0.19, 0.18),
    "coral": (0.82, 0.42, 0.36), "plum": (0.40, 0.22, 0.36), "sand": (0.70, 0.60, 0.46), "denim": (0.24, 0.31, 0.42),
}  # fmt: skip
SUIT: Color = (0.20, 0.24, 0.30)
STEEP = 0.2  # difference of what two neighbours follow a leg by, from which on weights are evened out
EASE, EASING = 6, 30  # over how many edges round such places, and in how many rounds
MARGIN = 22  # millimetres inside a garment's edge where the skin beneath is left out


def outfit_colors(
    outfit: str | None, top: str | Color | None, bottom: str | Color | None, shoes: str | Color | None, gender: float
) -> dict[str, Color]:
    """Garments of an outfit, inner first, with their colours. None wears none: a suit is painted on the skin."""
    if outfit is None:
        return {}
    if outfit not in OUTFITS:
        raise VitruvianError(f"outfit: expected one of {', '.join(OUTFITS)}, found {outfit!r}")
    chosen = {
        "t-shirt": top or ("teal" if gender < 0.5 else "blue"),
        "shorts": bottom or ("navy" if gender < 0.5 else "charcoal"),
        "trousers": bottom or "denim",
        "suit": top or SUIT,
        "shoes": shoes or "grey",
    }
    return {name: named(chosen[name], COLORS, "colour of " + name) for name in OUTFITS[outfit]}


def hidden_faces(garments: dict[str, Color]) -> np.ndarray:
    """(T,) bool: body triangles that lie well under a garment."""
    under = np.zeros(source.BODY, bool)
    for name in garments:
        under |= looks(f"{name}.cover") > (MARGIN if name != "shoes" else 12)
    return under[source.array("triangles")].all(axis=1)


@dataclass(frozen=True, eq=False)
class Pattern:
    """What of a garment does not depend on who wears it. `means` (n, 19158) and `drawn` (v, 19158): the source points
    that its points and its drawn vertices are means of; `surface` (t,3) of the points; `near` (n,n): the mean of the
    neighbours; `corners` (n, 3t): 1 at the triangles of a point; `rim`, `along`: the points on edges of the cloth and
    the mean of their neighbours there."""

    means: csr_matrix
    drawn: csr_matrix
    surface: np.ndarray
    near: csr_matrix
    corners: csr_matrix
    rim: np.ndarray
    along: csr_matrix


@cache
def pattern(name: str) -> Pattern:
    """The pattern of a garment in `GARMENTS`."""
    row = looks(f"{name}.row")
    n = len(row) - 1
    share = looks(f"{name}.share").astype(np.float64)
    share /= np.repeat(np.add.reduceat(share, row[:-1]), np.diff(row))
    means = csr_matrix((share, looks(f"{name}.point").astype(np.int32), row), (n, source.POINTS))
    surface = looks(f"{name}.surface").astype(np.int32)
    edges = surface[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, first, count = np.unique(np.sort(edges, axis=1) @ np.array([n, 1]), return_index=True, return_counts=True)
    border = edges[first[count == 1]]
    rim = np.unique(border)
    t = np.tile(np.arange(len(surface)), 3)
    corners = csr_matrix((np.ones(len(t)), (surface.T.ravel(), t)), (n, len(surface)))
    near = _neighbours(edges, n)
    drawn = _eased(means, edges, near, rim)[looks(f"{name}.vertex").astype(np.int64)].tocsr()
    return Pattern(means, drawn, surface, near, corners, rim, _neighbours(border, n)[rim][:, rim])


def _eased(means: csr_matrix, edges: np.ndarray, near: csr_matrix, rim: np.ndarray) -> csr_matrix:
    """The source points (n, 19158) that garment points take weights from, evened out round places where neighbours
    follow the legs by very different shares: between the legs cloth spans what lies apart on the body, and would be torn.
    """
    w, names = source.weights(), anatomy.names()
    steep = np.zeros(len(near.indptr) - 1, bool)
    for side in "lr":
        leg = np.isin(w.joint, [names.index(f"{side}_{joint}") for joint in ("hip", "knee")])
        share = means @ np.bincount(w.vertex[leg], w.weight[leg], minlength=source.POINTS)
        steep[edges[np.abs(share[edges[:, 0]] - share[edges[:, 1]]) > STEEP]] = True
    if not steep.any():
        return means
    edge = np.zeros(len(steep), bool)
    edge[rim] = True
    much = np.clip(1 - _rings(steep, near, EASE) / EASE, 0, 1) * np.clip(_rings(edge, near, 3) / 3, 0, 1)
    take = diags(0.5 * much)
    step = (identity(len(steep)) - take + take @ near).tocsr()
    for _ in range(EASING):
        means = step @ means
    return means


def _rings(some: np.ndarray, near: csr_matrix, most: int) -> np.ndarray:
    """(n,) how many edges each point is away from some (n,), at most so many."""
    out = np.where(some, 0, most)
    for ring in range(1, most):
        some = some | (near @ some > 0)
        out[some & (out == most)] = ring
    return out


def _neighbours(edges: np.ndarray, n: int) -> csr_matrix:
    """(n,n) the mean over the other ends of the edges (e,2) of each point."""
    near = coo_matrix((np.ones(2 * len(edges)), (edges.ravel(), edges[:, ::-1].ravel())), (n, n)).tocsr()
    return (diags(1 / np.maximum(np.asarray(near.sum(axis=1)).ravel(), 1)) @ near).tocsr()


def _unit(v: Floats, least: float = 1e-12) -> Floats:
    return v / np.maximum(np.sqrt(np.einsum("ij,ij->i", v, v)), least)[:, None]


def garment_part(name: str, points: Floats, color: Color) -> LookPart:
    """A garment on a shaped person (points (19158,3), A pose).

    The cloth lies `loose` metres over the tights and, where the body is hollow, on its smoothed surface.
    """
    title, (factor, plus), roughness, rounds, hem = GARMENTS[name]
    get = lambda key: looks(f"{name}.{key}")  # noqa: E731
    cut = pattern(name)
    near = cut.near
    skin = cut.means @ points
    a, b, c = (skin[cut.surface[:, k]] for k in range(3))
    normal = _unit(cut.corners @ cross(b - a, c - a))
    smooth, turned = skin, normal
    for k in range(rounds):
        smooth = 0.5 * (smooth + near @ smooth)
        if k < 8:
            turned = _unit(turned + near @ turned)
    fill = np.clip(((smooth - skin) * normal).sum(axis=1), 0, 0.04)
    cloth = skin + normal * fill[:, None] + turned * get("loose").astype(np.float64)[:, None]
    if name == "shoes":
        cloth = _soled(cloth, normal, points, cut)
    else:  # an edge is smooth along itself: no hem zigzags
        edge = cloth[cut.rim]
        for k in range(12):
            axes = slice(0, 3) if k < 3 else slice(1, 2)  # heights more than girth, which would shrink
            edge[:, axes] = (edge[:, axes] + cut.along @ edge[:, axes]) / 2
        cloth[cut.rim] = edge
    inner = cloth - turned * hem
    vertex, is_hem = get("vertex").astype(np.int64), get("hem")
    where = np.where(is_hem[:, None], inner[vertex], cloth[vertex])
    second, seam = get("piece") == 1, get("piece") == 2
    shade = get("shade").astype(np.float64)[vertex] * np.where(seam, 0.72, 1.0)
    tint = np.where(second[:, None], np.array(color) * factor + plus, np.array(color))
    colors = np.clip(tint * np.where(is_hem, 0.6 * shade, shade)[:, None], 0, 1)
    return LookPart(title, where, get("triangles").astype(np.int32), colors, name, roughness, double_sided=True)


def _soled(cloth: Floats, normal: Floats, points: Floats, cut: Pattern) -> Floats:
    """Shoes (n,3) with a flat sole, and an upper that meets it along a straight line and does not show the toes."""
    get = lambda key: looks(f"shoes.{key}")  # noqa: E731
    flat = get("flat").astype(np.float64)
    floor = points[: source.BODY, 1].min() - 0.017
    low = (np.clip((0.085 - (cloth[:, 1] - floor)) / 0.02, 0, 1) * (1 - 0.85 * flat))[:, None]
    drawn, kind = get("vertex").astype(np.int64), get("piece")
    line = np.intersect1d(drawn[kind == 0], drawn[(kind == 1) & ~get("hem")])
    line = line[cloth[line, 1] < floor + 0.040]
    for _ in range(14):
        cloth = cloth + 0.5 * low * (cut.near @ cloth - cloth)
        cloth[line, 1] = floor + 0.029
    outward = normal * [1, 0, 1]
    for _ in range(6):
        outward = cut.near @ outward
    cloth += (0.004 * low + 0.002 * flat[:, None]) * _unit(outward, 0.3)
    cloth[:, 1] = (1 - flat) * cloth[:, 1] + flat * floor
    return cloth
