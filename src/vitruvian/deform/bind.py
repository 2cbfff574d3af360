"""What is worked out once per body: influences with the largest first, tables for the kernels, joint pairs in use."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, Weights, require
from vitruvian.errors import warn

if TYPE_CHECKING:
    from scipy.sparse import csr_array

RULES = ("as_file", "normalise")
MATRIX, DUAL = 16, 8  # floats per joint in the tables of the linear and of the rigid kernels
LANES = 8  # vertices that the kernels of rigid operators work on at once


@dataclass(frozen=True, eq=False)
class Influences:
    """Compressed rows like `Weights`, the largest weight of each row first, ties to the lower joint.

    Joint `joints` (one past the last) stands for "does not move".
    """

    row: Ints
    joint: Ints
    weight: Floats
    joints: int

    def __len__(self) -> int:
        return len(self.row) - 1

    @cached_property
    def counts(self) -> Ints:
        return np.diff(self.row)

    @cached_property
    def vertex(self) -> Ints:
        """(n,) vertex of each entry."""
        return np.repeat(np.arange(len(self), dtype=np.int32), self.counts)

    @cached_property
    def pivot(self) -> Ints:
        """(n,) the joint with the largest weight on the vertex of each entry."""
        return self.joint[self.row[:-1][self.vertex]]

    @cached_property
    def sum(self) -> csr_array:
        """(V, n) sparse: `sum @ values` adds weight times value over the entries of each vertex."""
        from scipy.sparse import csr_array

        n = len(self.joint)
        return csr_array((self.weight, np.arange(n), self.row), shape=(len(self), n))

    @cached_property
    def pairs(self) -> tuple[Ints, Ints]:
        """Joint pairs (P,2) (largest weight, other) in use, and (n,) the pair of each entry."""
        key = self.pivot.astype(np.int64) * (self.joints + 1) + self.joint
        unique, where = np.unique(key, return_inverse=True)
        both = np.stack([unique // (self.joints + 1), unique % (self.joints + 1)], axis=-1)
        return both.astype(np.int32), where.astype(np.int32)

    @cached_property
    def chain(self) -> tuple[Ints, Ints]:
        """The pairs as (E,2) edges of trees, outward from the most used joint, and (R,2) the pairs left over."""
        pairs = self.pairs[0]
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
        use = np.bincount(self.joint, minlength=self.joints + 1)
        near: dict[int, list[int]] = {}
        for a, b in pairs.tolist():
            near.setdefault(a, []).append(b)
            near.setdefault(b, []).append(a)
        seen: set[int] = set()
        edges: list[tuple[int, int]] = []
        for start in sorted(near, key=lambda j: (-use[j], j)):
            if start in seen:
                continue
            seen.add(start)
            queue = [start]
            for a in queue:  # grows while it is read: breadth first
                for b in sorted(set(near[a]) - seen):
                    seen.add(b)
                    edges.append((a, b))
                    queue.append(b)
        taken = {frozenset(e) for e in edges}
        rest = sorted({(min(a, b), max(a, b)) for a, b in pairs.tolist() if frozenset((a, b)) not in taken})
        shape = lambda e: np.array(e, dtype=np.int32).reshape(-1, 2)  # noqa: E731
        return shape(edges), shape(rest)


def bind(weights: Weights, joints: int, *, rule: str = "as_file", rigid: bool = False) -> Influences:
    """Weights as an operator wants them.

    Sums within 1e-6 of one are made one. "as_file": else the linear operators (`rigid` False) take weights as they are,
    the part missing to one staying at rest; operators that blend rigid motions add an influence that does not move for
    what is missing, or scale down, with a warning, sums above one (rounding up to 1e-4 is scaled away for both).
    "normalise": every sum becomes one, with a warning that counts those that were not.
    """
    require(rule in RULES, "weights", " or ".join(map(repr, RULES)), repr(rule))
    vertex, joint, weight = weights.vertex, weights.joint, weights.weight
    sums = weights.sums
    have = sums > 0
    factor = np.ones(len(weights))
    off = np.abs(sums - 1)
    close = have & (off <= (1e-4 if rigid else 1e-6))
    if rule == "normalise":
        odd = int((have & (off > 1e-4)).sum())
        if odd:
            warn(f"weights of {odd} of {len(weights)} vertices do not sum to 1 and were normalised")
        close = have
    elif rigid:
        over = have & (sums > 1 + 1e-4)
        if over.any():
            warn(f"weights of {int(over.sum())} of {len(weights)} vertices sum to more than 1 and were normalised")
        close |= over
    factor[close] = 1 / sums[close]
    weight = weight * factor[vertex]
    if rigid:
        short = np.flatnonzero(~close)
        vertex = np.concatenate([vertex, short.astype(np.int32)])
        joint = np.concatenate([joint, np.full(len(short), joints, np.int32)])
        weight = np.concatenate([weight, 1 - sums[short]])
    keep = weight > 0
    vertex, joint, weight = vertex[keep], joint[keep], weight[keep]
    order = np.lexsort((joint, -weight, vertex))
    row = np.zeros(len(weights) + 1, np.int32)
    np.cumsum(np.bincount(vertex, minlength=len(weights)), out=row[1:])
    return Influences(row, joint[order].astype(np.int32), weight[order], joints)


@dataclass(frozen=True, eq=False)
class Bucket:
    """Vertices with up to `width` influences each; `width` 0: any number, in rows.

    `joint` holds places in the kernel's table, in floats: the joint times 16 (plain) or 8 (lanes).
    Plain layout, `lanes` 1: joint and weight (n, width), rest (n,3). Lane layout: vertices in groups of `lanes`, joint
    and weight (g, width, lanes), rest (g,3,lanes); the last group repeats its last vertex.
    `vertices` are those of all places; target (n,) is the same without repeats, None when it is all vertices in order.
    """

    width: int
    lanes: int
    count: int
    vertices: Ints
    rest: NDArray[np.float32]
    joint: Ints
    weight: NDArray[np.float32]
    row: Ints | None
    target: Ints | None

    def lay(self, values: NDArray) -> NDArray[np.float32]:
        """Values per vertex (V,k) as this bucket lays them out: (n,k) or (g,k,lanes)."""
        return _lay(values[self.vertices], self.lanes).astype(np.float32)

    def moved(self, rest: Floats) -> Bucket:
        """The same bucket for other rest positions (V,3)."""
        return replace(self, rest=self.lay(rest))


def _lay(array: NDArray, lanes: int) -> NDArray:
    if lanes == 1:
        return np.ascontiguousarray(array)
    return np.ascontiguousarray(array.reshape(-1, lanes, array.shape[1]).swapaxes(1, 2))


def buckets(rows: Influences, rest: Floats, *, lanes: int = 1, order: Ints | None = None) -> tuple[Bucket, ...]:
    """Every vertex in one bucket: width 1, 2, 4, 8, then rows (16, 32, ... in lane layout). `order` sorts vertices."""
    order = np.arange(len(rows), dtype=np.int32) if order is None else order
    counts = rows.counts[order]
    most = int(counts.max(initial=0))
    widths = [1, 2, 4, 8]
    if lanes == 1:
        widths += [0]
    while lanes > 1 and widths[-1] < most:
        widths.append(widths[-1] * 2)
    out = []
    low = -1
    for width in widths:
        high = width or most
        chosen = order[(counts > low) & (counts <= high)].astype(np.int32)
        low = high
        if len(chosen):
            out.append(_rows(rows, rest, chosen) if width == 0 else _bucket(rows, rest, chosen, width, lanes))
    return tuple(out)


def _rows(rows: Influences, rest: Floats, chosen: Ints) -> Bucket:
    counts = rows.counts[chosen]
    row = np.zeros(len(chosen) + 1, np.int32)
    np.cumsum(counts, out=row[1:])
    entry = np.repeat(rows.row[chosen] - row[:-1], counts) + np.arange(row[-1])
    joint, weight = rows.joint[entry] * np.int32(MATRIX), rows.weight[entry].astype(np.float32)
    target = None if len(chosen) == len(rows) else chosen
    return Bucket(0, 1, len(chosen), chosen, rest[chosen].astype(np.float32), joint, weight, row, target)


def _bucket(rows: Influences, rest: Floats, chosen: Ints, width: int, lanes: int) -> Bucket:
    count = len(chosen)
    target = None if count == len(rows) and (np.diff(chosen) == 1).all() else chosen
    chosen = np.concatenate([chosen, np.repeat(chosen[-1:], -count % lanes)])
    slot = np.arange(width)
    real = slot < rows.counts[chosen][:, None]
    if len(rows.joint):
        entry = np.where(real, rows.row[chosen][:, None] + slot, 0)
        # padding repeats the first joint: it is in the cache, and turns no sign
        first = np.where(real[:, :1], rows.joint[entry][:, :1], 0)
        joint = np.where(real, rows.joint[entry], first).astype(np.int32)
        weight = np.where(real, rows.weight[entry], 0.0).astype(np.float32)
    else:
        joint, weight = np.zeros(real.shape, np.int32), np.zeros(real.shape, np.float32)
    joint = joint * np.int32(MATRIX if lanes == 1 else DUAL)
    points = _lay(rest[chosen].astype(np.float32), lanes)
    return Bucket(width, lanes, count, chosen, points, _lay(joint, lanes), _lay(weight, lanes), None, target)
