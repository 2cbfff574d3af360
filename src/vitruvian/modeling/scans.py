"""What of a scan is a person: copies of points welded, faces turned outwards, floors and furniture left aside."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, floats, indices, require
from vitruvian.errors import VitruvianError

GAP = 0.02  # of the scan's size: parts that are nearer to each other belong together
FLOOR = 0.12  # of the square of the height: more level surface than this in one plane is no sole
MOST = 3  # parts of a scan that may be the person


class Surface(Protocol):
    """Anything with vertices (V,3) in any unit and triangles (T,3)."""

    @property
    def vertices(self) -> Floats: ...

    @property
    def triangles(self) -> Ints: ...


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of a scan that stands by itself: points (N,3), triangles (T,3) of them, unit normals (N,3) outwards."""

    points: Floats
    triangles: Ints
    normals: Floats

    @property
    def size(self) -> float:
        """The diagonal of its box."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))


def cleaned(mesh: Surface) -> tuple[Floats, Ints]:
    """Points (N,3), none twice, and triangles with three different corners; raises VitruvianError where none is left."""
    points = floats(mesh.vertices, "vertices", None, 3)
    triangles = indices(mesh.triangles, "triangles", len(points), None, 3)
    require(len(triangles) >= 50, "scan", "a surface of at least 50 triangles", len(triangles))
    used, corner = np.unique(triangles, return_inverse=True)
    some = points[used]
    size = float(np.linalg.norm(np.ptp(some, axis=0)))
    require(np.isfinite(size) and size > 0, "scan", "points that are apart from each other", "all in one place")
    key = np.round((some - some.min(axis=0)) / size * 2**21).astype(np.int64)
    _, first, same = np.unique(key @ [1, 1 << 21, 1 << 42], return_index=True, return_inverse=True)
    faces = same.reshape(-1)[corner.reshape(-1, 3)]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    require(int(whole.sum()) >= 50, "scan", "at least 50 triangles with an area", int(whole.sum()))
    return some[first], faces[whole].astype(np.int32)


def facing(points: Floats, triangles: Ints) -> Ints:
    """Triangles (T,3) turned so that neighbours agree and most of every connected part faces away from its middle."""
    a, b = triangles[:, [0, 1, 2]].reshape(-1).astype(np.int64), triangles[:, [1, 2, 0]].reshape(-1).astype(np.int64)
    directed = np.unique(a * len(points) + b, return_counts=True)[1]
    if np.mean(directed > 1) > 0.002:  # an edge is gone along twice in the same direction: faces disagree
        import igl

        triangles = np.ascontiguousarray(igl.bfs_orient(triangles.astype(np.int64))[0], dtype=np.int32)
    part = _parts(len(points), triangles)[triangles[:, 0]]
    corners = points[triangles]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    count = int(part.max()) + 1
    size = np.bincount(part, minlength=count)
    middle = corners.mean(axis=1)
    center = np.stack([np.bincount(part, middle[:, k], count) for k in range(3)], axis=1) / np.maximum(size, 1)[:, None]
    outwards = np.bincount(part, np.einsum("ij,ij->i", area, middle - center[part]), count)
    return np.where((outwards < 0)[part][:, None], triangles[:, ::-1], triangles)


def _parts(count: int, triangles: Ints) -> NDArray[np.int64]:
    """(count,) the connected part of each point."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    a, b = triangles[:, [0, 1]].T.reshape(-1), triangles[:, [1, 2]].T.reshape(-1)
    graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def without_floor(points: Floats, triangles: Ints, up: Floats) -> NDArray[np.bool_]:
    """(T,) which triangles are no floor: none of the lowest level plane when it is too large to be two soles."""
    height = points @ up
    low, tall = float(height.min()), float(np.ptp(height))
    corners = points[triangles]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    size = np.linalg.norm(area, axis=1)
    level = (np.abs(area @ up) > 0.9 * size) & ((height[triangles] < low + 0.03 * tall).all(axis=1))
    if not level.any() or size[level].sum() < FLOOR * tall**2:
        return np.ones(len(triangles), bool)
    top = float(np.quantile(height[triangles[level]], 0.9))
    return np.asarray(~(height[triangles] < top + 0.004 * tall).all(axis=1))


def pieces(points: Floats, triangles: Ints) -> list[Piece]:
    """The parts of a scan that lie apart from each other, the largest first, without those that are flat or small.

    Parts of the surface that nearly touch (hair, shoes, islands of a broken scan) are one.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if not len(triangles):
        return []
    cell = GAP * float(np.linalg.norm(np.ptp(points[np.unique(triangles)], axis=0)))
    part = _parts(len(points), triangles)
    key, where = np.unique(
        np.floor(points[triangles].mean(axis=1) / cell).astype(np.int64), axis=0, return_inverse=True
    )
    where = where.reshape(-1)
    pairs = cKDTree(key).query_pairs(1.8, output_type="ndarray")
    count = len(key) + int(part.max()) + 1
    ends = np.concatenate([pairs, np.stack([where, len(key) + part[triangles[:, 0]]], axis=1)])
    graph = coo_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count))
    group = connected_components(graph, directed=False)[1][where]
    found = []
    for g in np.unique(group).tolist():
        mine = triangles[group == g]
        used, corner = np.unique(mine, return_inverse=True)
        some = points[used]
        if len(used) < 40:
            continue
        spread = np.sqrt(np.linalg.eigvalsh(np.cov(some.T)))
        if spread[0] < 0.02 * spread[2]:
            continue
        faces = facing(some, corner.reshape(-1, 3).astype(np.int32))
        from vitruvian.modeling.rough import vertex_normals

        found.append(Piece(some, faces, vertex_normals(some, faces)))
    found.sort(key=lambda p: -p.size)
    if not found:
        raise VitruvianError("scan: expected a person, found only flat or tiny parts")
    return [p for p in found[:20] if p.size > 0.5 * found[0].size or len(p.points) > 0.3 * len(points)][:MOST]
