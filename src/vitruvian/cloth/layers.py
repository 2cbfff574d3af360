"""Cloth sorted into layers: what lies tight on the skin, what hangs loose about it, and what floats.

Source: note cloth.md, section 6; seed 003, section 5.3.1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Body, Floats, Ints, Skeleton, indices, require
from vitruvian.cloth.binding import Binding, feet

TIGHT, LOOSE, FLOATING = 0, 1, 2
NAMES = ("tight", "loose", "floating")
TRUNK = "trunk"
# The joint that each region begins at, the region that it hangs on, and the joint that its bone ends at
REGIONS: Mapping[str, tuple[tuple[str, ...], str, tuple[str, ...]]] = {
    "head": (("skullbase",), TRUNK, ()),
    **{
        f"{s}_{name}": (tuple(f"{s}_{j}" for j in joints), TRUNK if on == TRUNK else f"{s}_{on}",
                        tuple(f"{s}_{j}" for j in ends))
        for s in ("l", "r")
        for name, joints, on, ends in (
            ("upper_arm", ("shoulder",), TRUNK, ("elbow",)),
            ("forearm", ("elbow",), "upper_arm", ("radiocarpal", "wrist")),
            ("hand", ("radiocarpal", "wrist"), "forearm", ()),
            ("thigh", ("hip",), TRUNK, ("knee",)),
            ("calf", ("knee",), "thigh", ("talocrural", "ankle")),
            ("foot", ("talocrural", "ankle"), "calf", ()),
        )
    },
}  # fmt: skip
LIMBS = tuple(n for n, (_, _, end) in REGIONS.items() if end)  # with a bone to hang about
EDGE = {n: (0.008, 0.050) for n in LIMBS}  # metres from the skin: what is tight, and what is loose
ELSEWHERE = (0.008, 0.040)
STRETCH = 0.5  # share by which cloth may be stretched between the places it is bound to
OFTEN = 0.2  # of the training poses
ISLAND = 12  # triangles: smaller spots take the layer around them
FORK, DEEP, HEM = 0.04, 0.15, 0.03  # metres under the crotch: where legs are apart, those of trousers too; over a hem


@dataclass(frozen=True, eq=False)
class Anatomy:
    """names of regions, and which of them each joint belongs to: joints (J,). adjacent (R,R): regions that meet; bones
    (R,2): joints at the ends of a limb's bone, or -1."""

    names: tuple[str, ...]
    joints: Ints
    adjacent: NDArray[np.bool_]
    bones: Ints

    def of(self, body: Body) -> Ints:
        """(V,) the region of each vertex of a body's skin: that of the joint that moves it most."""
        weights = body.skin.weights
        share = np.zeros((len(body.skin.rest), len(self.names)))
        np.add.at(share, (weights.vertex, self.joints[weights.joint]), weights.weight)
        return share.argmax(axis=1).astype(np.int32)


def anatomy(skeleton: Skeleton) -> Anatomy:
    """The regions of a skeleton with the standard's names; what is missing belongs to what is above it."""
    names, on, first = [TRUNK], {TRUNK: -1}, {}
    ends = {}
    for region, (joints, above, end) in REGIONS.items():
        found = [j for j in joints if j in skeleton.index]
        if found:
            while above not in on:
                above = REGIONS[above][1]
            on[region], first[skeleton.index[found[0]]] = names.index(above), len(names)
            ends[region] = (skeleton.index[found[0]], next((skeleton.index[j] for j in end if j in skeleton.index), -1))
            names.append(region)
    joints_of = np.zeros(len(skeleton), np.int32)
    for j, parent in enumerate(skeleton.parents):
        joints_of[j] = first.get(j, joints_of[parent] if parent >= 0 else 0)
    adjacent = np.eye(len(names), dtype=bool)
    for k, name in enumerate(names[1:], 1):
        adjacent[k, on[name]] = adjacent[on[name], k] = True
    bones = np.full((len(names), 2), -1, np.int32)
    for k, name in enumerate(names):
        if name in LIMBS and ends[name][1] >= 0:
            bones[k] = ends[name]
    return Anatomy(tuple(names), joints_of, adjacent, bones)


def sort(
    binding: Binding,
    x: Floats,
    triangles: Ints,
    regions: Ints,
    known: Anatomy,
    trained: Sequence[tuple[Floats, Floats]] = (),
    *,
    edges: Mapping[str, tuple[float, float]] | None = None,
    crotch: float | None = None,
    painted: Mapping[int, int] | None = None,
) -> Ints:
    """(n,) the layer of each vertex of a cloth: `TIGHT`, `LOOSE` or `FLOATING`.

    binding: of its vertices x (n,3) metres to the skin that it was draped on; triangles (m,3) of the cloth; regions (V,) of
    the skin's vertices; trained: the skin (V,3) in training poses, and the cloth (n,3) as it is bound to it there. edges:
    region -> metres from the skin up to which cloth is tight, and loose; what is not named has the usual ones. crotch:
    height under which cloth that goes round both legs floats. painted: vertex -> layer, what a person decided.

    Loose cloth floats where it comes to be nearer to another part of the body in a training pose, and all cloth where the
    places that it is bound to move apart.
    """
    n = len(binding.face)
    triangles = indices(triangles, "triangles", n, None, 3)
    where = regions[binding.triangles[binding.face, binding.share.argmax(axis=1)]]
    limits = np.array([(edges or {}).get(name, EDGE.get(name, ELSEWHERE)) for name in known.names], np.float64)
    require(bool((limits[:, 0] <= limits[:, 1]).all()), "edges", "tight before loose", limits.tolist())
    far = np.linalg.norm(binding.offset, axis=1)
    layer = np.where(far <= limits[where, 0], TIGHT, np.where(far <= limits[where, 1], LOOSE, FLOATING))
    layer[(layer == TIGHT) & (binding.offset[:, 2] < 0)] = LOOSE  # it lies inside: it is put right with what is loose
    loose = np.flatnonzero(layer == LOOSE)
    layer[loose[_strays(binding, loose.astype(np.int32), where, regions, known, trained)]] = FLOATING
    layer[_torn(x, triangles, trained)] = FLOATING
    if crotch is not None:
        layer[_skirted(triangles, where, known, x[:, 1], crotch)] = FLOATING
    layer = _cleaned(layer, triangles)
    for vertex, value in (painted or {}).items():
        require(
            0 <= vertex < n and value in (TIGHT, LOOSE, FLOATING), "painted", "vertices and layers", (vertex, value)
        )
        layer[vertex] = value
    return layer.astype(np.int32)


def _strays(
    binding: Binding, loose: Ints, where: Ints, regions: Ints, known: Anatomy, trained: Sequence[tuple[Floats, Floats]]
) -> NDArray[np.bool_]:
    """(k,) which of the loose vertices come to be nearer to a part of the body that is no neighbour of their own."""
    out = np.zeros(len(loose), bool)
    for skin, cloth in trained if len(loose) else ():
        face, share, _ = feet(skin, binding.triangles, cloth[loose])
        now = regions[binding.triangles[face, share.argmax(axis=1)]]
        out |= ~known.adjacent[where[loose], now]
    return out


def _torn(x: Floats, triangles: Ints, trained: Sequence[tuple[Floats, Floats]]) -> NDArray[np.bool_]:
    """(n,) vertices of sides that would be stretched too far, in too many poses, by what they are bound to."""
    a, b = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]).T
    rest, often = np.maximum(np.linalg.norm(x[a] - x[b], axis=1), 1e-6), np.zeros(len(a))
    for _, cloth in trained:
        often += np.linalg.norm(cloth[a] - cloth[b], axis=1) > (1 + STRETCH) * rest
    out = np.zeros(len(x), bool)
    bad = often > OFTEN * max(1, len(trained))
    out[a[bad]] = out[b[bad]] = True
    return out


def _skirted(triangles: Ints, where: Ints, known: Anatomy, heights: Floats, crotch: float) -> NDArray[np.bool_]:
    """(n,) vertices under the crotch that hang together around both legs."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n, low = len(heights), heights < crotch - FORK
    if not low.any():
        return low
    deep = heights < max(crotch - DEEP, float(heights.min()) + HEM)  # trousers are in one piece some way down
    some = triangles[deep[triangles].all(axis=1)]
    a, b = some[:, [0, 1]].ravel(), some[:, [1, 2]].ravel()
    piece = connected_components(coo_array((np.ones(len(a)), (a, b)), (n, n)), directed=False)[1]
    both = np.ones(n, bool)
    for side in ("l", "r"):
        mine = np.array([name in (f"{side}_thigh", f"{side}_calf", f"{side}_foot") for name in known.names])
        has = np.zeros(n, bool)
        has[piece[mine[where] & deep]] = True
        both &= has
    skirt = both[piece] & deep
    rim = triangles[low[triangles].all(axis=1)]
    while True:  # up to the fork
        more = rim[skirt[rim].any(axis=1) & ~skirt[rim].all(axis=1)]
        if not len(more):
            return skirt
        skirt[more.ravel()] = True


def _cleaned(layer: NDArray, triangles: Ints) -> NDArray:
    """Layers without spots of fewer than `ISLAND` triangles: they take the layer that most of their neighbours have. A
    triangle has the highest layer of its vertices."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    layer = layer.copy()
    n = len(layer)
    a, b = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    for value in (FLOATING, LOOSE, TIGHT):
        same = (layer[a] == value) & (layer[b] == value)
        piece = connected_components(coo_array((np.ones(same.sum()), (a[same], b[same])), (n, n)), directed=False)[1]
        faces = np.bincount(piece[triangles[(layer[triangles] == value).any(axis=1)].ravel()], minlength=n) / 3
        small = (layer == value) & (faces[piece] < ISLAND)
        if not small.any() or small.all():
            continue
        votes = np.zeros((n, 3))
        for p, q in ((a, b), (b, a)):
            out = small[p] & ~small[q]
            np.add.at(votes, (piece[p[out]], layer[q[out]]), 1)
        won = votes[piece].argmax(axis=1)
        some = small & (votes[piece].sum(axis=1) > 0)
        layer[some] = won[some]
    return layer


def counts(layer: Ints) -> dict[str, int]:
    """How many vertices each layer has, by name."""
    return {name: int((layer == k).sum()) for k, name in enumerate(NAMES)}
