"""Editing skin weights: paint, flood, smooth, mirror, normalise, prune. Pure functions: a Body in, another Body out.

Points at the same place (copies at seams) always get the same weights. What a vertex has in sum stays what it was,
except under `normalised`; a vertex without any gets a sum of 1 from the brush. Distances of brushes run over the surface,
along edges and straight across pairs of triangles, so a brush on one finger does not reach the next.
`modeling.attaching` makes weights for a mesh that has none; `modeling.weight_files` reads and writes them.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vitruvian.body.types import Body, Floats, Ints, Weights, floats, require
from vitruvian.errors import VitruvianError, warn

if TYPE_CHECKING:
    from scipy.sparse import csr_array

MODES = ("add", "subtract", "replace", "smooth")
TINY = 1e-7  # weights below this are left out
MOST = 64  # rounds of smoothing in one call


def table(weights: Weights, joints: int) -> csr_array:
    """(V,J) sparse weights."""
    from scipy.sparse import csr_array

    return csr_array((weights.weight, weights.joint, weights.row), shape=(len(weights), joints))


def from_table(rows: csr_array) -> Weights:
    """The weights of a sparse (V,J) table; what is not above 1e-7 is left out."""
    pairs = rows.tocoo()
    keep = pairs.data > TINY
    return Weights.from_pairs(rows.shape[0], pairs.row[keep], pairs.col[keep], pairs.data[keep])


def reweighted(body: Body, weights: Weights) -> Body:
    """The same body with other weights, one row for each vertex."""
    require(len(weights) == len(body.skin.rest), "weights", f"{len(body.skin.rest)} rows", len(weights))
    return replace(body, skin=replace(body.skin, weights=weights))


def reach(body: Body, center: ArrayLike, radius: float) -> tuple[Ints, Floats]:
    """Vertices (n,) within `radius` of the surface point nearest to `center` (3,), and their distances (n,) over it.

    Metres, humanoid space at rest. Ways go along edges and straight across pairs of triangles, so distances are
    somewhat too long, on slivers by a third.
    """
    at = floats(center, "center", 3)
    require(np.isfinite(radius) and radius > 0, "radius", "more than 0 metres", radius)
    if not len(body.skin.rest):
        return np.zeros(0, np.int32), np.zeros(0)
    same, places, faces = _welded(body)
    start, foot = _nearest(places, faces, at)
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    near = np.union1d(np.flatnonzero(((places - foot) ** 2).sum(axis=1) <= radius**2), start)
    number = np.full(len(places), -1)
    number[near] = np.arange(len(near))
    some = number[faces]
    some = some[(some >= 0).all(axis=1)]
    p = places[near]
    edges = _edges(some)
    flat, straight = _across(p, some)
    seed = np.linalg.norm(places[start] - foot, axis=1)
    hub, n = len(near), len(near) + 1  # a point of its own, joined to where the brush stands
    i = np.concatenate([edges[:, 0], flat[:, 0], np.full(len(start), hub)])
    j = np.concatenate([edges[:, 1], flat[:, 1], number[start]])
    length = np.concatenate([np.linalg.norm(p[edges[:, 0]] - p[edges[:, 1]], axis=1), straight, seed])
    order = np.lexsort((length, j, i))  # of two ways between the same places, the shorter
    i, j, length = i[order], j[order], length[order]
    first = np.r_[True, (i[1:] != i[:-1]) | (j[1:] != j[:-1])]
    ways = csr_array((np.maximum(length, 1e-12)[first], (i[first], j[first])), shape=(n, n))
    distance = dijkstra(ways, directed=False, indices=hub, limit=radius)[:hub]
    far = np.full(len(places), np.inf)
    far[near] = distance
    chosen = np.flatnonzero(far[same] <= radius)
    return chosen.astype(np.int32), far[same][chosen]


def falloff(distance: Floats, radius: float) -> Floats:
    """How much of its strength a brush has at distances from its middle: 1 there, 0 at the radius, smooth at both."""
    return np.asarray((1 - np.minimum(distance / radius, 1) ** 2) ** 2)


def paint(
    body: Body, joint: str, center: ArrayLike, *, radius: float = 0.05, strength: float = 0.25, mode: str = "add"
) -> Body:
    """One dab of a brush on the skin at rest.

    center (3,) and radius in metres, humanoid space; strength 0..1, fading towards the radius (`falloff`). "add" raises
    the weight of `joint` by the strength and "subtract" lowers it, as a part of the vertex's sum; "replace" draws it
    towards the strength; "smooth" draws all weights towards the mean of the neighbours. The other joints of a vertex
    give or take in proportion; where there are none, subtracting hands the weight to the parent joint.
    Raises VitruvianError for joints the body does not have and for numbers out of range.
    """
    require(mode in MODES, "mode", " or ".join(MODES), repr(mode))
    require(0 <= strength <= 1, "strength", "0 to 1", strength)
    number = _joint(body, joint)
    vertices, distance = reach(body, center, radius)
    amount = strength * falloff(distance, radius)
    if mode == "smooth":
        return _smoothed(body, vertices, amount, 1)
    rows = table(body.skin.weights, len(body.skeleton))
    some = rows[vertices].toarray()
    total = _total(some)
    now = some[:, number] / total
    if mode == "replace":
        wanted = now + falloff(distance, radius) * (strength - now)
    else:
        wanted = np.clip(now + (amount if mode == "add" else -amount), 0, 1)
    return _put(body, vertices, _shared(body, some / total[:, None], number, wanted) * total[:, None])


def flood(body: Body, joint: str, value: float, *, vertices: ArrayLike | None = None) -> Body:
    """The weight of `joint` on all `vertices` (n,) (None: every one) set to `value` 0..1 of their sum."""
    require(0 <= value <= 1, "value", "0 to 1", value)
    number, chosen = _joint(body, joint), _chosen(body, vertices)
    some = table(body.skin.weights, len(body.skeleton))[chosen].toarray()
    total = _total(some)
    return _put(
        body, chosen, _shared(body, some / total[:, None], number, np.full(len(chosen), value)) * total[:, None]
    )


def smooth(body: Body, *, vertices: ArrayLike | None = None, rounds: int = 5, amount: float = 0.5) -> Body:
    """Each vertex `amount` of the way (0..1) to the mean of its neighbours along edges, in `rounds` rounds.

    Sums stay: what moves between joints is each vertex's own. `vertices` (n,): only these change.
    """
    require(1 <= rounds <= MOST, "rounds", f"1 to {MOST}", rounds)
    require(0 <= amount <= 1, "amount", "0 to 1", amount)
    chosen = _chosen(body, vertices)
    return _smoothed(body, chosen, np.full(len(chosen), float(amount)), int(rounds))


def mirrored(body: Body, *, side: str = "left", tolerance: float = 0.002) -> Body:
    """The weights of one side (`left` is +X) given to the other, left joints becoming right ones.

    Vertices are paired by the mirror image of the rest shape in the plane through the root, no farther apart than
    `tolerance` metres; those in the plane become symmetric. Vertices without a pair stay as they are, with a warning.
    Joints are paired by name (`l_` and `r_`, `left` and `right`).
    """
    require(side in ("left", "right"), "side", "left or right", repr(side))
    require(tolerance > 0, "tolerance", "more than 0 metres", tolerance)
    from scipy.spatial import cKDTree

    rest, names = body.skin.rest, body.skeleton.names
    if not len(rest):
        return body
    index = body.skeleton.index
    mate = np.array([index.get(_other(n), index[n]) for n in names])
    x = body.skeleton.centers[0, 0]
    image = rest * [-1, 1, 1] + [2 * x, 0, 0]
    distance, pair = cKDTree(rest).query(image)
    away = (rest[:, 0] - x) * (1 if side == "left" else -1)
    middle = (np.abs(away) <= tolerance / 2) & (distance <= tolerance)
    target = (away < 0) & ~middle
    lost = target & (distance > tolerance)
    if lost.any():
        warn(
            f"mirror: {int(lost.sum())} of {int(target.sum())} vertices have no mate within {tolerance:g} m; they stay"
        )
    rows = table(body.skin.weights, len(names))
    target = np.flatnonzero(target & ~lost)
    body = _put(body, target, _swapped(rows[pair[target]].toarray(), mate))
    middle = np.flatnonzero(middle)
    own = rows[middle].toarray()
    return _put(body, middle, (own + _swapped(own, mate)) / 2)


def normalised(body: Body) -> Body:
    """Every vertex that has weights gets a sum of 1."""
    w = body.skin.weights
    sums = np.where(w.sums > 0, w.sums, 1.0)
    return reweighted(body, Weights(w.row, w.joint, w.weight / sums[w.vertex]))


def pruned(body: Body, *, least: float = 0.001, most: int | None = None) -> tuple[Body, float]:
    """Without weights below `least` (as a part of the sum) and with no more than `most` joints a vertex.

    The largest weight always stays, and the rest takes what went. Answers the body and the largest part of any vertex's
    sum that went, 0..1: with d the distance between where two of its joints put a vertex, it moves at most that times d.
    """
    require(0 <= least < 1, "least", "0 to less than 1", least)
    require(most is None or most >= 1, "most", "at least 1", most)
    w = body.skin.weights
    if not len(w.weight):
        return body, 0.0
    share = w.weight / np.where(w.sums > 0, w.sums, 1.0)[w.vertex]
    order = np.lexsort((w.joint, -w.weight, w.vertex))
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order)) - w.row[w.vertex[order]]
    keep = ((share >= least) & (place < (most or len(body.skeleton)))) | (place == 0)
    left = np.bincount(w.vertex[keep], share[keep], minlength=len(w))
    scale = np.where(left > 0, 1 / np.where(left > 0, left, 1), 1)[w.vertex[keep]]
    out = Weights.from_pairs(len(w), w.vertex[keep], w.joint[keep], w.weight[keep] * scale)
    return reweighted(body, out), float(np.max(1 - left[w.sums > 0], initial=0.0))


def _joint(body: Body, name: str) -> int:
    if name not in body.skeleton.index:
        from difflib import get_close_matches

        near = get_close_matches(str(name)[:80], body.skeleton.names, n=1)
        raise VitruvianError(f"joint {name!r:.60}: the body has none" + (f"; did you mean {near[0]}?" if near else ""))
    return body.skeleton.index[name]


def _chosen(body: Body, vertices: ArrayLike | None) -> Ints:
    count = len(body.skin.rest)
    if vertices is None:
        return np.arange(count, dtype=np.int32)
    chosen = np.unique(np.asarray(vertices, dtype=np.int64)).reshape(-1)
    inside = not chosen.size or (chosen[0] >= 0 and chosen[-1] < count)
    require(bool(inside), "vertices", f"numbers in 0..{count - 1}", chosen[[0, -1]] if chosen.size else 0)
    return chosen.astype(np.int32)


def _total(rows: Floats) -> Floats:
    total = rows.sum(axis=1)
    return np.where(total > TINY, total, 1.0)


def _shared(body: Body, rows: Floats, number: int, wanted: Floats) -> Floats:
    """Rows (n,J) that sum to 1 (or 0), with `wanted` (n,) for one joint; the others share the rest as they did. Where
    there are no others the parent has the rest; a root keeps all, and rows without anything get the joint alone."""
    others = rows.sum(axis=1) - rows[:, number]
    alone = others <= TINY
    empty = alone & (rows[:, number] <= TINY)
    out = rows * np.where(alone, 0.0, (1 - wanted) / np.where(alone, 1.0, others))[:, None]
    parent = int(body.skeleton.parents[number])
    out[:, number] = np.where(alone, 1.0, wanted) if parent < 0 else wanted
    if parent >= 0:
        out[alone, parent] = 1 - wanted[alone]
    out[empty] = 0
    out[empty, number] = wanted[empty] > 0
    return out


def _put(body: Body, vertices: NDArray, rows: Floats) -> Body:
    """The body with other rows (n,J) at `vertices` (n,)."""
    w = body.skin.weights
    changed = np.zeros(len(w), bool)
    changed[vertices] = True
    keep = ~changed[w.vertex]
    i, j = np.nonzero(rows > TINY)
    v = np.concatenate([w.vertex[keep], np.asarray(vertices)[i]])
    joint, weight = np.concatenate([w.joint[keep], j]), np.concatenate([w.weight[keep], rows[i, j]])
    return reweighted(body, Weights.from_pairs(len(w), v, joint, weight))


def _smoothed(body: Body, vertices: Ints, amount: Floats, rounds: int) -> Body:
    from scipy.sparse import csr_array, diags_array

    same, places, faces = _welded(body)
    share = np.zeros(len(places))
    share[same[vertices]] = amount
    edges = _edges(faces)
    n = len(places)
    links = csr_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n))
    links = links + links.T
    degree = np.asarray(links.sum(axis=1)).ravel()
    share[degree == 0] = 0
    first = np.unique(same, return_index=True)[1]
    whole = table(body.skin.weights, len(body.skeleton))[first]
    total = np.asarray(whole.sum(axis=1)).ravel()
    bare = total <= TINY  # a vertex without weights neither gives nor gets
    share[bare] = 0
    rows = diags_array(np.where(bare, 0, 1 / np.where(bare, 1, total))) @ whole
    seen = links @ np.where(bare, 0.0, 1.0)
    share[seen == 0] = 0
    mean = diags_array(share / np.where(seen > 0, seen, 1)) @ links
    step = (diags_array(1 - share) + mean).tocsr()
    for _ in range(rounds):
        rows = step @ rows
    chosen = vertices[share[same[vertices]] > 0]
    out = rows.tocsr()[same[chosen]].toarray()
    sums = np.asarray(table(body.skin.weights, len(body.skeleton))[chosen].sum(axis=1)).ravel()
    return _put(body, chosen, out * (sums / _total(out))[:, None])


def _swapped(rows: Floats, mate: NDArray) -> Floats:
    """Rows (n,J) with the columns of left and right joints exchanged."""
    out = np.zeros_like(rows)
    np.add.at(out.T, mate, rows.T)
    return out


def _other(name: str) -> str:
    """The name of a joint on the other side."""
    words = {"l_": "r_", "r_": "l_", "left": "right", "right": "left", "Left": "Right", "Right": "Left"}
    found = re.match(r"l_|r_", name) or re.search(r"left|right|Left|Right", name)
    return name[: found.start()] + words[found.group()] + name[found.end() :] if found else name


def _welded(body: Body) -> tuple[NDArray, Floats, NDArray]:
    """(V,) number of the place of each vertex, (n,3) places, (T,3) triangles of places."""
    places, same = np.unique(body.skin.rest, axis=0, return_inverse=True)
    same = same.reshape(-1)
    return same, places, same[body.skin.triangles]


def _edges(faces: NDArray) -> NDArray:
    """(E,2) each edge of triangles once."""
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    pairs = np.unique(pairs, axis=0)
    return pairs[pairs[:, 0] != pairs[:, 1]]


def _across(places: Floats, faces: NDArray) -> tuple[NDArray, Floats]:
    """Ways across an edge from corner to corner of the two triangles there, laid flat: (n,2) places and (n,) lengths."""
    edge = np.concatenate([faces[:, [k, (k + 1) % 3, (k + 2) % 3]] for k in range(3)])
    edge[:, :2] = np.sort(edge[:, :2], axis=1)
    _, group, size = np.unique(edge[:, :2], axis=0, return_inverse=True, return_counts=True)
    some = np.flatnonzero(size[group.reshape(-1)] == 2)
    two = some[np.argsort(group.reshape(-1)[some], kind="stable")].reshape(-1, 2)
    a, b = places[edge[two[:, 0], 0]], places[edge[two[:, 0], 1]]
    length = np.maximum(np.linalg.norm(b - a, axis=1), 1e-30)
    along = (b - a) / length[:, None]
    ends = edge[two, 2]
    away = places[ends] - a[:, None]
    u = np.einsum("nka,na->nk", away, along)
    h = np.linalg.norm(away - u[..., None] * along[:, None], axis=2)
    high = h.sum(axis=1)
    cut = u[:, 0] + (u[:, 1] - u[:, 0]) * h[:, 0] / np.maximum(high, 1e-30)
    good = (high > 1e-30) & (cut >= 0) & (cut <= length) & (ends[:, 0] != ends[:, 1])
    return np.sort(ends[good], axis=1), np.hypot(u[good, 0] - u[good, 1], high[good])


def _nearest(places: Floats, faces: NDArray, at: Floats) -> tuple[NDArray, Floats]:
    """Numbers of the places that a brush at `at` (3,) stands between, the corners of the nearest triangle, and where."""
    if not len(faces):
        one = int(np.argmin(((places - at) ** 2).sum(axis=1)))
        return np.array([one]), places[one]
    import igl

    _, face, foot = igl.point_mesh_squared_distance(at[None], places, faces.astype(np.int64))[:3]
    return np.unique(faces[int(np.asarray(face).reshape(-1)[0])]), np.asarray(foot, np.float64).reshape(3)
