"""Skeleton, Skin and Body: what a humanoid is for kernels, as arrays.

Metres, humanoid space, Y up. Quaternions `xyzw`, matrices for column vectors (`p' = M p`). float64 at rest.
Everything is validated once, here; whatever takes one of these may trust it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.body.contours import Contours
    from vitruvian.body.hands import Rounding
    from vitruvian.hanim.humanoid import Picture

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


def require(ok: bool, array: str, expected: str, found: object) -> None:
    """Raise `VitruvianError` naming the array, what was expected and what was found."""
    if not ok:
        raise VitruvianError(f"{array}: expected {expected}, found {found}")


def floats(value: object, name: str, *shape: int | None) -> Floats:
    """`value` as a C-contiguous finite float64 array of that shape (None: any length)."""
    try:
        array = np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise VitruvianError(f"{name}: expected numbers, found {value!r:.60}") from None
    fits = array.ndim == len(shape) and all(n is None or n == m for n, m in zip(shape, array.shape, strict=False))
    require(fits, name, f"shape {tuple('n' if n is None else n for n in shape)}", array.shape)
    if not np.isfinite(array).all():
        bad = np.argwhere(~np.isfinite(array))[0]
        require(False, name, "finite numbers", f"{array[tuple(bad)]} at index {tuple(int(i) for i in bad)}")
    return array


def indices(value: object, name: str, limit: int, *shape: int | None) -> Ints:
    """`value` as a C-contiguous int32 array of that shape with entries in 0..limit-1."""
    array = np.ascontiguousarray(value, dtype=np.int32)
    fits = array.ndim == len(shape) and all(n is None or n == m for n, m in zip(shape, array.shape, strict=False))
    require(fits, name, f"shape {tuple('n' if n is None else n for n in shape)}", array.shape)
    if array.size and (array.min() < 0 or array.max() >= limit):
        bad = np.argwhere((array < 0) | (array >= limit))[0]
        require(False, name, f"indices in 0..{limit - 1}", f"{array[tuple(bad)]} at {tuple(int(i) for i in bad)}")
    return array


def _default(value: object, shape: tuple[int, ...], fill: object) -> object:
    return np.broadcast_to(np.asarray(fill, dtype=np.float64), shape) if value is None else value


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Joints, parents before children, and the named places (Sites) that hang on them.

    names (J,), parents (J,) int32 with -1 for roots, centers (J,3) in humanoid space at rest.
    translation (J,3), rotation (J,4) xyzw, scale (J,3), scale_orientation (J,4): the pose as the file gives it.
    limits (J,3,2) radians about X, Y, Z of the frame turned by limit_orientation (J,4), NaN where free.
    stiffness (J,3) in 0..1.
    binding (J,4,4): multiplied on the right of each joint matrix, None for identity.
    site_names (S,), site_joints (S,), site_points (S,3) in humanoid space at rest.
    """

    names: tuple[str, ...]
    parents: Ints
    centers: Floats
    translation: Floats = None  # type: ignore[assignment]
    rotation: Floats = None  # type: ignore[assignment]
    scale: Floats = None  # type: ignore[assignment]
    scale_orientation: Floats = None  # type: ignore[assignment]
    limits: Floats = None  # type: ignore[assignment]
    limit_orientation: Floats = None  # type: ignore[assignment]
    stiffness: Floats = None  # type: ignore[assignment]
    binding: Floats | None = None
    site_names: tuple[str, ...] = ()
    site_joints: Ints = field(default_factory=lambda: np.zeros(0, np.int32))
    site_points: Floats = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        n = len(self.names)
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        put("names", tuple(self.names))
        require(n > 0, "names", "at least one joint", 0)
        parents = np.ascontiguousarray(self.parents, dtype=np.int32)
        require(parents.shape == (n,), "parents", f"shape ({n},)", parents.shape)
        bad = np.flatnonzero((parents < -1) | (parents >= np.arange(n)))
        require(not bad.size, "parents", "-1 or an earlier joint", f"{parents[bad[:1]]} at joint {bad[:1]}")
        put("parents", parents)
        put("centers", floats(self.centers, "centers", n, 3))
        put("translation", floats(_default(self.translation, (n, 3), 0.0), "translation", n, 3))
        put("rotation", floats(_default(self.rotation, (n, 4), [0, 0, 0, 1]), "rotation", n, 4))
        put("scale", floats(_default(self.scale, (n, 3), 1.0), "scale", n, 3))
        put(
            "scale_orientation",
            floats(_default(self.scale_orientation, (n, 4), [0, 0, 0, 1]), "scale_orientation", n, 4),
        )
        limits = np.array(_default(self.limits, (n, 3, 2), np.nan), dtype=np.float64)
        require(limits.shape == (n, 3, 2), "limits", f"shape ({n}, 3, 2)", limits.shape)
        put("limits", limits)
        put(
            "limit_orientation",
            floats(_default(self.limit_orientation, (n, 4), [0, 0, 0, 1]), "limit_orientation", n, 4),
        )
        put("stiffness", floats(_default(self.stiffness, (n, 3), 0.0), "stiffness", n, 3))
        if self.binding is not None:
            put("binding", floats(self.binding, "binding", n, 4, 4))
        put("site_names", tuple(self.site_names))
        put("site_joints", indices(self.site_joints, "site_joints", n, len(self.site_names)))
        put("site_points", floats(self.site_points, "site_points", len(self.site_names), 3))

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def index(self) -> dict[str, int]:
        """Joint name -> index."""
        return {name: i for i, name in enumerate(self.names)}

    @cached_property
    def site_index(self) -> dict[str, int]:
        """Site name -> index."""
        return {name: i for i, name in enumerate(self.site_names)}


@dataclass(frozen=True, eq=False)
class Weights:
    """Which joints move each vertex: compressed rows. row (V+1,), joint (n,) int32, weight (n,) >= 0.

    Rows need not sum to one: the missing part stays at rest, as browsers do it (ISO/IEC 19774-1, skinCoordWeight).
    """

    row: Ints
    joint: Ints
    weight: Floats

    def __post_init__(self) -> None:
        row = np.ascontiguousarray(self.row, dtype=np.int32)
        require(row.ndim == 1 and row.size > 0 and row[0] == 0, "weights.row", "offsets starting at 0", row.shape)
        require(bool((np.diff(row) >= 0).all()), "weights.row", "offsets that do not decrease", "a decrease")
        object.__setattr__(self, "row", row)
        object.__setattr__(self, "joint", indices(self.joint, "weights.joint", 1 << 30, int(row[-1])))
        object.__setattr__(self, "weight", floats(self.weight, "weights.weight", int(row[-1])))
        bad = np.flatnonzero(self.weight < 0)
        require(not bad.size, "weights.weight", "no negative weight", f"{self.weight[bad[:1]]} at {bad[:1]}")

    def __len__(self) -> int:
        return len(self.row) - 1

    @cached_property
    def counts(self) -> Ints:
        """(V,) influences per vertex."""
        return np.diff(self.row)

    @cached_property
    def vertex(self) -> Ints:
        """(n,) vertex of each entry."""
        return np.repeat(np.arange(len(self), dtype=np.int32), self.counts)

    @cached_property
    def sums(self) -> Floats:
        """(V,) sum of the weights of each vertex."""
        return np.bincount(self.vertex, self.weight, minlength=len(self)).astype(np.float64)

    @staticmethod
    def from_pairs(vertices: int, vertex: object, joint: object, weight: object) -> Weights:
        """From unordered (vertex, joint, weight) triples; a joint named twice on a vertex adds up, zeros go.

        Raises VitruvianError, naming the first offender, for arrays of different lengths and vertices out of range.
        """
        v = np.asarray(vertex, dtype=np.int64).reshape(-1)
        j = np.asarray(joint, dtype=np.int64).reshape(-1)
        w = np.asarray(weight, dtype=np.float64).reshape(-1)
        same = len(v) == len(j) == len(w)
        require(same, "weights", "a vertex, a joint and a weight for each entry", f"{len(v)}, {len(j)} and {len(w)}")
        bad = np.flatnonzero((v < 0) | (v >= vertices))
        require(not bad.size, "weights.vertex", f"vertices in 0..{vertices - 1}", f"{v[bad[:1]]} at {bad[:1]}")
        bad = np.flatnonzero(j < 0)
        require(not bad.size, "weights.joint", "joints from 0 on", f"{j[bad[:1]]} at {bad[:1]}")
        keep = w != 0
        key, where = np.unique((v[keep] << 32) | j[keep], return_inverse=True)
        total = np.bincount(where, w[keep], minlength=len(key)).astype(np.float64)
        row = np.zeros(vertices + 1, np.int32)
        np.cumsum(np.bincount(key >> 32, minlength=vertices), out=row[1:])
        return Weights(row, (key & 0xFFFFFFFF).astype(np.int32), total)

    def top(self, k: int) -> tuple[Ints, Floats]:
        """The k largest influences of each vertex, (V,k) joints and weights, ties to the lower joint, not renormalised.

        Free places hold joint 0 with weight 0.
        """
        order = np.lexsort((self.joint, -self.weight, self.vertex))
        slot = np.arange(len(order)) - self.row[self.vertex[order]]
        keep = slot < k
        joints = np.zeros((len(self), k), np.int32)
        weights = np.zeros((len(self), k))
        joints[self.vertex[order][keep], slot[keep]] = self.joint[order][keep]
        weights[self.vertex[order][keep], slot[keep]] = self.weight[order][keep]
        return joints, weights


@dataclass(frozen=True)
class Part:
    """A range of a skin's triangles with one look: `start:stop` into `triangles`. Colours are sRGB in 0..1.

    `crease`: faces that meet at a larger angle (radians) have an edge between them; pi, the default, is smooth.
    `picture` colours them through `Skin.uv`.
    """

    name: str
    start: int
    stop: int
    color: tuple[float, float, float] = (0.8, 0.8, 0.8)
    roughness: float = 0.6
    metallic: float = 0.0
    opacity: float = 1.0
    double_sided: bool = False
    crease: float = float(np.pi)
    picture: Picture | None = None


@dataclass(frozen=True, eq=False)
class Drive:
    """What a joint's angle adds to a displacer's weight.

    joint: index; axis (3,) unit, in the joint's frame: the angle is that of the rotation's part about it, radians.
    angles (n,) rising, and weights (n,) between which it is interpolated.
    """

    joint: int
    axis: Floats
    angles: Floats
    weights: Floats


@dataclass(frozen=True, eq=False)
class Morph:
    """A displacer, packed: vertices `index` (n,) move by weight * `offset` (n,3).

    `joint` is the joint in whose turned frame the offset is added after skinning; with `before` the offset is added to
    the rest position instead (Segment displacers). `drive`: a joint's angle adds to the weight.
    """

    name: str
    index: Ints
    offset: Floats
    joint: int
    before: bool = False
    weight: float = 0.0
    drive: Drive | None = None


@dataclass(frozen=True, eq=False)
class Skin:
    """The surface of a body. rest (V,3), triangles (T,3), weights V rows.

    uv (U,2) with uv_triangles (T,3), or None; colors (V,3) sRGB, or None; parts cover the triangles in order.
    Segment geometry is packed too: each vertex with weight 1 on the joint of its Segment.
    """

    rest: Floats
    triangles: Ints
    weights: Weights
    uv: Floats | None = None
    uv_triangles: Ints | None = None
    colors: Floats | None = None
    parts: tuple[Part, ...] = ()
    morphs: tuple[Morph, ...] = ()

    def __post_init__(self) -> None:
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        put("rest", floats(self.rest, "rest", None, 3))
        n = len(self.rest)
        put("triangles", indices(self.triangles, "triangles", n, None, 3))
        require(len(self.weights) == n, "weights", f"{n} rows, one per vertex", len(self.weights))
        require((self.uv is None) == (self.uv_triangles is None), "uv", "uv and uv_triangles together", "one of them")
        if self.uv is not None:
            put("uv", floats(self.uv, "uv", None, 2))
            put("uv_triangles", indices(self.uv_triangles, "uv_triangles", len(self.uv), len(self.triangles), 3))
        if self.colors is not None:
            put("colors", floats(self.colors, "colors", n, 3))
        parts = tuple(self.parts) or (Part("body", 0, len(self.triangles)),)
        stops = [0, *(p.stop for p in parts)]
        good = stops[-1] == len(self.triangles) and all(p.start == s for p, s in zip(parts, stops, strict=False))
        require(
            good, "parts", f"ranges that cover 0..{len(self.triangles)} in order", [(p.start, p.stop) for p in parts]
        )
        put("parts", parts)
        put("morphs", tuple(self.morphs))
        for m in self.morphs:
            indices(m.index, f"morph {m.name}", n, None)
            floats(m.offset, f"morph {m.name}", len(m.index), 3)


@dataclass(frozen=True, eq=False)
class Body:
    """A humanoid, packed. `placement` (4,4) is the Humanoid's own transform, applied after all joint matrices.

    `contours`: the surfaces of its skin that are organised in contours; each vertex is in one of them at most.
    `roundings`: the animator's parameters of the hands, by joint or finger; see `body.hands`.
    """

    name: str
    skeleton: Skeleton
    skin: Skin
    placement: Floats = field(default_factory=lambda: np.eye(4))
    contours: tuple[Contours, ...] = ()
    roundings: Mapping[str, Rounding] = field(default_factory=dict)

    def __post_init__(self) -> None:
        taken = np.zeros(len(self.skin.rest), np.int32)
        for surface in self.contours:
            title = f"contours {surface.name}"
            indices(surface.vertices, f"{title}: vertices", len(taken), None, None)
            indices([*surface.joints, surface.joint], f"{title}: joints", len(self.skeleton), None)
            np.add.at(taken, surface.vertices.ravel(), 1)
            twice = np.flatnonzero(taken > 1)
            require(not twice.size, title, "vertices of its own", f"vertex {twice[:1]} in two contours")
        joint = self.skin.weights.joint
        require(
            not joint.size or int(joint.max()) < len(self.skeleton),
            "weights.joint",
            f"joints in 0..{len(self.skeleton) - 1}",
            int(joint.max()) if joint.size else -1,
        )
