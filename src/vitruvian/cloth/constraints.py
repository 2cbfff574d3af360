"""What holds a sheet together, in groups of eight constraints that share no vertex.

Source: note cloth.md, sections 4.2 to 4.4; bending after Bergou, Wardetzky, Harmon, Zorin and Grinspun (2006, "A quadratic
bending model for inextensible surfaces"), whose hinge is linear in the vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints
from vitruvian.cloth.sheet import Sheet

LANES = 8
LEAST = 0.25  # of its compliance is left to each membrane: without any, triangles that fold up would burst
Single = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Groups:
    """Constraints in the order in which they are worked off: index (g,k,8) of their k vertices, rest (g,c,8) of their
    coefficients. Places without a constraint name the vertex behind the last."""

    index: Ints
    rest: Single


def colours(constraints: Ints, vertices: int) -> NDArray[np.int64]:
    """(c,) of each constraint (c,k): those of one colour share no vertex, but for the one behind the last. Greedy, in
    order."""
    taken = [0] * (vertices + 1)
    out = np.empty(len(constraints), np.int64)
    for i, row in enumerate(constraints.tolist()):
        used = 0
        for v in row:
            used |= taken[v]
        bit = ~used & (used + 1)
        for v in row:
            taken[v] |= bit
        taken[vertices] = 0
        out[i] = bit.bit_length() - 1
    return out


def grouped(constraints: Ints, coefficients: Floats, vertices: int) -> Groups:
    """Constraints (c,k) with coefficients (c,q), by colour."""
    width, depth = constraints.shape[1], coefficients.shape[1]
    if not len(constraints):
        return Groups(np.zeros((0, width, LANES), np.int32), np.zeros((0, depth, LANES), np.float32))
    colour = colours(constraints, vertices)
    order = np.argsort(colour, kind="stable")
    sizes = np.bincount(colour)
    full = -(-sizes // LANES) * LANES
    place = (
        np.repeat(np.cumsum(full) - full, sizes) + np.arange(len(order)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    )
    index = np.full((full.sum(), width), vertices, np.int32)
    rest = np.ones((full.sum(), depth), np.float32)
    index[place], rest[place] = constraints[order], coefficients[order]
    return Groups(
        np.ascontiguousarray(index.reshape(-1, LANES, width).transpose(0, 2, 1)),
        np.ascontiguousarray(rest.reshape(-1, LANES, depth).transpose(0, 2, 1)),
    )


def membranes(sheet: Sheet) -> tuple[Ints, Floats]:
    """Triangles (m,3) and for each the inverse of its rest matrix, a b c d, and its compliance over its area: uu uv vv of
    the strains along weft and warp, and of the shear."""
    e = sheet.material[:, 1:] - sheet.material[:, :1]
    d = np.swapaxes(e, 1, 2)  # columns X1 - X0, X2 - X0
    inverse = np.linalg.inv(d).reshape(-1, 4)
    table = np.array(
        [[1 / f.stretch_u, -f.poisson / f.stretch_u, 1 / f.stretch_v, 1 / f.shear] for f in sheet.fabrics]
    )[sheet.fabric]
    return sheet.triangles, np.concatenate([inverse, table / sheet.areas[:, None]], axis=1)


@dataclass(frozen=True, eq=False)
class Folds:
    """Edges between two triangles: index (h,4) its ends and what is opposite, factor (h,4) of the four vertices, whose sum
    is as long as the angle of the bend; face (h,2) the triangles, side (h,2) which of their edges it is, from corner k to
    k + 1; across (h,2,2) the edge's normal in the fabric of each, long (h,2) its metres there."""

    index: Ints
    factor: Floats
    face: Ints
    side: Ints
    across: Floats
    long: Floats


def folds(sheet: Sheet) -> Folds:
    """Of a sheet; edges of three or more triangles bend freely."""
    t, m = sheet.triangles, sheet.material
    corner = np.concatenate([[(k, (k + 1) % 3, (k + 2) % 3)] for k in range(3)])
    ends = np.concatenate([t[:, [a, b]] for a, b, _ in corner])
    face = np.tile(np.arange(len(t)), 3)
    which = np.repeat(np.arange(3), len(t))
    low, high = ends.min(axis=1).astype(np.int64), ends.max(axis=1)
    key = low * (sheet.count + 1) + high
    order = np.argsort(key, kind="stable")
    _, first, count = np.unique(key[order], return_index=True, return_counts=True)
    two = first[count == 2]
    one, other = order[two], order[two + 1]
    good = (sheet.areas[face[one]] > 0) & (sheet.areas[face[other]] > 0)
    one, other = one[good], other[good]
    factor = np.zeros((len(one), 4))
    index = np.stack([low[one], high[one], low[one], high[one]], axis=1)
    across, long = np.zeros((len(one), 2, 2)), np.zeros((len(one), 2))
    for k, side in enumerate((one, other)):
        f, a, b, c = face[side], *(corner[which[side], i] for i in range(3))
        swap = t[f, a] != low[one]  # the edge runs the other way in this triangle
        a, b = np.where(swap, b, a), np.where(swap, a, b)
        pa, pb, pc = m[f, a], m[f, b], m[f, c]
        edge = pb - pa
        long[:, k] = np.linalg.norm(edge, axis=1)
        height = 2 * sheet.areas[f] / long[:, k]
        along = np.sum((pc - pa) * edge, axis=1) / long[:, k]
        factor[:, 0] += (long[:, k] - along) / height / long[:, k]  # cotangents of the angles at the far ends
        factor[:, 1] += along / height / long[:, k]
        factor[:, 2 + k] = -1 / height
        index[:, 2 + k] = t[f, c]
        across[:, k] = np.stack([-edge[:, 1], edge[:, 0]], axis=1) / long[:, k, None]
    return Folds(
        index.astype(np.int32), factor, face[np.stack([one, other], axis=1)], which[np.stack([one, other], axis=1)],
        across, long,
    )  # fmt: skip


def hinges(sheet: Sheet) -> tuple[Ints, Floats]:
    """Edges between two triangles: (h,4) its ends and what is opposite, and the factors of the four vertices, whose sum is
    as long as the angle of the bend, and the compliance. Edges of three or more triangles bend freely."""
    f = folds(sheet)
    inner = np.maximum(np.bincount(f.face.ravel(), minlength=len(sheet.triangles)), 1)
    area, stiffness = sheet.areas[f.face], _bending(sheet)[sheet.fabric[f.face]]
    total, size, stiff = area.sum(axis=1), f.long.mean(axis=1), 0.5 * np.sum(stiffness * f.across**2, axis=(1, 2))
    # a triangle at the rim bends about fewer edges, of which each does more
    rim = np.sum(area * 3 / inner[f.face], axis=1)
    some = stiff > 0
    compliance = total * total / np.where(some, stiff * size * size * rim, 1)
    return f.index[some], np.concatenate([f.factor, compliance[:, None]], axis=1)[some]


def _bending(sheet: Sheet) -> Floats:
    return np.array([[f.bend_u, f.bend_v] for f in sheet.fabrics])


def shapes(sheet: Sheet) -> tuple[Ints, Floats]:
    """Triangles with what is opposite across their edges, (c,6), and for each three sums of those, (c,18), whose squares
    are twice its energy, and their compliance, 1.

    Source: note cloth.md, 4.3, `bend="shape"`: the curvature S of a triangle is that of its folds, S = sum c_i l_i / (2 A)
    n_i n_i^T with n_i the normals of its edges, and the energy A/2 (Bu S_uu^2 + Bv S_vv^2 + (Bu + Bv) S_uv^2); c_i here the
    vectors of `folds` in place of angles, which makes it quadratic. At a rim no moment bends across it, so the curvature
    there takes the value of least energy.
    """
    f, m, n = folds(sheet), len(sheet.triangles), sheet.count
    index = np.concatenate([sheet.triangles, np.full((m, 3), n, np.int32)], axis=1)
    sums = np.zeros((m, 3, 6))
    own = np.arange(m)
    free = np.ones((m, 3), bool)
    e = np.roll(sheet.material, -1, axis=1) - sheet.material
    normal = np.stack([-e[..., 1], e[..., 0]], axis=-1) / np.linalg.norm(e, axis=-1, keepdims=True)
    tensor = np.stack([normal[..., 0] ** 2, normal[..., 1] ** 2, 2 * normal[..., 0] * normal[..., 1]], axis=-1)
    for k in (0, 1):
        face, side = f.face[:, k], f.side[:, k]
        free[face, side] = False
        index[face, 3 + side] = f.index[:, 3 - k]
        weight = (f.long[:, k] / (2 * sheet.areas[face]))[:, None] * tensor[face, side]
        for j in range(4):
            if j == 3 - k:
                place = 3 + side
            else:
                place = np.argmax(sheet.triangles[face] == f.index[:, [j]], axis=1)
            for row in range(3):
                np.add.at(sums[:, row], (face, place), weight[:, row] * f.factor[:, j])
    for i in range(3, 6):  # two neighbours may have the same vertex across
        for j in range(i + 1, 6):
            both = (index[:, i] == index[:, j]) & (index[:, i] < n)
            sums[both, :, i] += sums[both, :, j]
            sums[both, :, j], index[both, j] = 0, n
    bend = _bending(sheet)[sheet.fabric]
    stiff = np.zeros((m, 3, 3))
    stiff[own, 0, 0], stiff[own, 1, 1], stiff[own, 2, 2] = bend[:, 0], bend[:, 1], bend.sum(axis=1) / 4
    for k in range(3):
        moment = np.einsum("mij,mj->mi", stiff, tensor[:, k])
        against = np.sum(moment * tensor[:, k], axis=1)
        some = free[:, k] & (against > 1e-9 * bend.sum(axis=1))
        stiff[some] -= np.einsum("mi,mj->mij", moment[some], moment[some]) / against[some, None, None]
    value, way = np.linalg.eigh(stiff)
    root = np.sqrt(np.maximum(value, 0) * sheet.areas[:, None])[:, :, None] * np.swapaxes(way, 1, 2)
    sums = root @ sums
    some = (bend.sum(axis=1) > 0) & (np.abs(sums).max(axis=(1, 2)) > 0)
    return index[some], np.concatenate([sums.reshape(m, 18), np.ones((m, 1))], axis=1)[some]


def yielding(groups: Groups, sheet: Sheet, inverse_mass: Single) -> Floats:
    """(g,2,8) metres a newton over h^2: by how much one pass a step of h seconds leaves each triangle softer along weft and
    warp, were its multiplier new in each step.

    In a cloth at rest the pass restores what all multipliers make, one after the other. When a triangle's turn comes, what
    the later ones do is missing: under an even stress they would undo all of its own work, so the softness is w |grad C|^2
    of the triangle less what they undo.
    """
    w = np.append(inverse_mass, 0.0).astype(np.float64)
    later = np.zeros((len(w), 2))  # what the triangles worked off later pull at each vertex, along weft and warp
    out = np.zeros((len(groups.index), 2, LANES))
    a, b, c, d = (groups.rest[:, k].astype(np.float64) for k in range(4))
    area = 0.5 / np.maximum(np.abs(a * d - b * c), 1e-30)
    grad = np.stack([np.stack([-a - c, a, c], axis=1), np.stack([-b - d, b, d], axis=1)], axis=-1)  # (g,vertex,lane,uv)
    for g in range(len(out) - 1, -1, -1):
        index = groups.index[g]
        own = w[index][..., None] * grad[g]
        most = np.sum(own * grad[g], axis=0)
        undone = np.sum(own * later[index], axis=0) / area[g][:, None]
        out[g] = np.clip(most + undone, 0, most).T
        inside = index < len(w) - 1
        later[index[inside]] += (area[g][None, :, None] * grad[g])[inside]
    return out


def stiffened(groups: Groups, softer: Floats) -> Single:
    """The coefficients of membranes whose compliance is less by what the solver adds: softer (g,2,8)."""
    rest = groups.rest.copy()
    uu, uv, vv, ss = (rest[:, k].astype(np.float64) for k in range(4, 8))
    u, v = np.maximum(uu - softer[:, 0], LEAST * uu), np.maximum(vv - softer[:, 1], LEAST * vv)
    rest[:, 4], rest[:, 6], rest[:, 7] = u, v, np.maximum(ss - softer.sum(axis=1), LEAST * ss)
    limit = 0.95 * np.sqrt(u * v)
    rest[:, 5] = np.clip(uv, -limit, limit)
    return rest
