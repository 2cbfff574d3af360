"""What is worked out once per body: influences with the largest first, tables for the kernels, joint pairs in use."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, Weights, require
from vitruvian.errors import warn
from vitruvian.native import kernels

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from vitruvian import _native

RULES = ("as_file", "normalise")
MATRIX, DUAL = 16, 8  # floats per joint in the tables of the linear and of the rigid kernels
WIDTHS = (1, 2, 4, 8, 16, 64)  # influences that the kernels of rigid operators are compiled for
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
    """Vertices with up to `width` influences each, laid out for the kernels.

    `joint` holds places in the kernel's table, in floats: the joint times 16 (linear) or 8 (rigid).
    Plain layout (linear), `lanes` 1: joint and weight (n, width), rest (n,3); `width` 0: rows of any length.
    Lane layout: groups of `lanes` vertices, weight (g, width, lanes), rest (g,3,lanes). `shared`: the vertices of a group
    have the same joints, joint (g, width); else joint (g, width, lanes). Groups are filled up by repeating their last
    vertex.
    `vertices` (n,) are those of all places; `target` is the same, or None when it is all vertices in order.
    """

    width: int
    lanes: int
    count: int
    vertices: Ints
    rest: NDArray[np.float32]
    joint: Ints
    weight: NDArray[np.float32]
    row: Ints | None = None
    target: Ints | None = None
    shared: bool = False

    def lay(self, values: NDArray) -> NDArray[np.float32]:
        """Values per vertex (V,k) as this bucket lays them out: (n,k) or (g,k,lanes)."""
        return _lay(values[self.vertices], self.lanes).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Laid:
    """Buckets, and what an operator hangs on each, handed to the kernels once: a call with an array takes longer than
    some buckets. `more`: arrays for each bucket, by the names of `_native.Buckets.add`.
    """

    buckets: tuple[Bucket, ...]
    more: tuple[Mapping[str, NDArray], ...] = ()

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in self.__dict__.items() if name != "bound"}

    @cached_property
    def bound(self) -> _native.Buckets:
        return self._bind(None)

    def program(self, rest: Floats | None) -> _native.Buckets:
        """For the rest positions of the buckets, or others (V,3)."""
        return self.bound if rest is None else self._bind(rest)

    def _bind(self, rest: Floats | None) -> _native.Buckets:
        native = kernels()
        assert native is not None
        made = native.Buckets()
        for i, b in enumerate(self.buckets):
            points = b.rest if rest is None else b.lay(rest)
            more = self.more[i] if self.more else {}
            made.add(b.width, b.lanes, b.count, points, b.joint, b.weight, b.row, b.target, b.shared, **more)
        return made


def _lay(array: NDArray, lanes: int) -> NDArray:
    if lanes == 1:
        return np.ascontiguousarray(array)
    return np.ascontiguousarray(array.reshape(-1, lanes, array.shape[1]).swapaxes(1, 2))


def plain_buckets(rows: Influences, rest: Floats, only: Ints | None = None) -> tuple[Bucket, ...]:
    """Every vertex, or those of `only`, in one bucket of width 1, 2, 4, 8 or 0, in order: for the linear kernel."""
    out = []
    low = -1
    wanted = np.ones(len(rows), dtype=bool)
    if only is not None:
        wanted[:] = False
        wanted[only] = True
    for width in (1, 2, 4, 8, 0):
        high = width or int(rows.counts.max(initial=0))
        chosen = np.flatnonzero(wanted & (rows.counts > low) & (rows.counts <= high)).astype(np.int32)
        low = high
        if not len(chosen):
            continue
        if width:
            joint, weight = _table(rows, chosen, width)
            row = None
        else:
            counts = rows.counts[chosen]
            row = np.zeros(len(chosen) + 1, np.int32)
            np.cumsum(counts, out=row[1:])
            entry = np.repeat(rows.row[chosen] - row[:-1], counts) + np.arange(row[-1])
            joint, weight = rows.joint[entry], rows.weight[entry]
        target = None if len(chosen) == len(rows) else chosen
        points = np.ascontiguousarray(rest[chosen], dtype=np.float32)
        places = (joint * MATRIX).astype(np.int32)
        out.append(Bucket(width, 1, len(chosen), chosen, points, places, weight.astype(np.float32), row, target))
    return tuple(out)


def linear_buckets(rows: Influences, rest: Floats) -> tuple[Bucket, ...]:
    """Every vertex in one bucket for the linear kernels: in lanes where eight share their joints, else plain."""
    out, left, low = [], [np.zeros(0, np.int32)], -1
    for width in WIDTHS[:4]:
        chosen = np.flatnonzero((rows.counts > low) & (rows.counts <= width)).astype(np.int32)
        low = width
        if len(chosen):
            together, others = _grouped(rows, chosen, width)
            left.append(others)
            if len(together):
                out.append(_lane_bucket(rows, rest, together, width, MATRIX, shared=True))
    left.append(np.flatnonzero(rows.counts > low).astype(np.int32))
    rest_of_them = np.concatenate(left)
    return (*out, *plain_buckets(rows, rest, rest_of_them)) if len(rest_of_them) else tuple(out)


def lane_buckets(rows: Influences, rest: Floats) -> tuple[Bucket, ...]:
    """Every vertex in one bucket of a width in `WIDTHS`, for the kernels of rigid operators.

    Vertices that cannot be put together with seven others of the same joints are few: they share one bucket per 8, 16
    and 64 influences.
    Raises VitruvianError for a vertex with more influences than the largest width.
    """
    most = int(rows.counts.max(initial=0))
    found = f"{most} on vertex {int(rows.counts.argmax()) if most else 0}"
    require(most <= WIDTHS[-1], "weights", f"at most {WIDTHS[-1]} joints per vertex (linear takes any number)", found)
    out, left, low = [], [np.zeros(0, np.int32)], -1
    for width in WIDTHS:
        chosen = np.flatnonzero((rows.counts > low) & (rows.counts <= width)).astype(np.int32)
        low = width
        if len(chosen):
            together, others = _grouped(rows, chosen, width)
            left.append(others)
            if len(together):
                out.append(_lane_bucket(rows, rest, together, width, DUAL, shared=True))
        if width >= 8 and any(len(some) for some in left):
            mixed = np.sort(np.concatenate(left))
            need = next(w for w in WIDTHS if w >= int(rows.counts[mixed].max()))
            out.append(_lane_bucket(rows, rest, mixed, need, DUAL, shared=False))
            left = [np.zeros(0, np.int32)]
    return tuple(out)


def _lane_bucket(rows: Influences, rest: Floats, place: Ints, width: int, floats: int, *, shared: bool) -> Bucket:
    joint, weight = _sorted_table(rows, place, width)
    target = None if np.array_equal(place, np.arange(len(rows))) else place
    count = len(place)
    fill = np.concatenate([np.arange(count), np.full(-count % LANES, count - 1)])
    joint = (joint[fill] * floats).astype(np.int32)
    joint = np.ascontiguousarray(joint[::LANES]) if shared else _lay(joint, LANES)
    vertices = place[fill]
    shares = _lay(weight[fill].astype(np.float32), LANES)
    return Bucket(
        width,
        LANES,
        count,
        vertices,
        _lay(rest[vertices].astype(np.float32), LANES),
        joint,
        shares,
        None,
        target,
        shared,
    )


def _grouped(rows: Influences, chosen: Ints, width: int) -> tuple[Ints, Ints]:
    """Vertices in groups of `LANES` that have the same joints, and those left over. A group that is at least half full
    is filled up by repeating its last vertex."""
    joint = _sorted_table(rows, chosen, width)[0]
    order = np.lexsort(joint.T[::-1])
    ordered = joint[order]
    starts = np.flatnonzero(np.concatenate([[True], (ordered[1:] != ordered[:-1]).any(axis=1)]))
    sizes = np.diff(np.concatenate([starts, [len(order)]]))
    if len(sizes) == 1:
        return chosen, chosen[:0]
    rest = sizes % LANES
    kept = np.where(rest >= LANES // 2, sizes, sizes - rest)
    padded = -(-kept // LANES) * LANES
    run = np.repeat(np.arange(len(sizes)), padded)
    slot = np.arange(len(run)) - np.repeat(np.cumsum(padded) - padded, padded)
    own = order[starts[run] + np.minimum(slot, kept[run] - 1)]
    slot = np.arange(len(order)) - np.repeat(starts, sizes)
    return chosen[own], chosen[order[slot >= np.repeat(kept, sizes)]]


def _sorted_table(rows: Influences, chosen: Ints, width: int) -> tuple[Ints, Floats]:
    """`_table` by joint, padding last, so that the same joints make the same row whatever their weights."""
    joint, weight = _table(rows, chosen, width)
    order = np.argsort(np.where(weight > 0, joint, np.iinfo(np.int32).max), axis=1, kind="stable")
    joint, weight = np.take_along_axis(joint, order, axis=1), np.take_along_axis(weight, order, axis=1)
    return np.where(weight > 0, joint, joint[:, :1]), weight


def _table(rows: Influences, chosen: Ints, width: int) -> tuple[Ints, Floats]:
    """Joints and weights (n, width); padding repeats the first joint (0 where there is none) with weight 0."""
    slot = np.arange(width)
    real = slot < rows.counts[chosen][:, None]
    if not len(rows.joint):
        return np.zeros(real.shape, np.int32), np.zeros(real.shape)
    entry = np.where(real, rows.row[chosen][:, None] + slot, 0)
    first = np.where(real[:, :1], rows.joint[entry][:, :1], 0)
    return np.where(real, rows.joint[entry], first).astype(np.int32), np.where(real, rows.weight[entry], 0.0)
