"""The body that cloth lies on: a closed surface that may move during a frame."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, floats, indices, require

OFFSET = 0.002  # metres between the skin and what lies on it
MOST = 0.01  # metres that a substep pushes a vertex out at most


class Meets(Protocol):
    """What `vitruvian.cloth.solver.step` takes as the body: an `Obstacle`, or what knows as much."""

    @property
    def triangles(self) -> Ints: ...
    @property
    def neighbours(self) -> Ints: ...
    @property
    def start(self) -> NDArray[np.float32]: ...
    @property
    def end(self) -> NDArray[np.float32]: ...
    @property
    def reach(self) -> float: ...
    @property
    def offset(self) -> float: ...
    @property
    def most(self) -> float: ...
    def nearest(self, points: Floats) -> tuple[Floats, Ints]: ...


@dataclass(frozen=True, eq=False)
class Obstacle:
    """Triangles (t,3) of a closed surface, outwards, and its vertices at a frame's begin and end (V,3) metres."""

    triangles: Ints
    before: Floats
    after: Floats
    offset: float = OFFSET
    most: float = MOST
    shared: dict[str, NDArray] = field(default_factory=dict)  # what does not change between frames

    def __post_init__(self) -> None:
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        put("before", floats(self.before, "before", None, 3))
        put("after", floats(self.after, "after", len(self.before), 3))
        put("triangles", indices(self.triangles, "triangles", len(self.before), None, 3))
        require(len(self.triangles) > 0, "triangles", "a surface", "none")

    def moved(self, after: Floats) -> Obstacle:
        """The next frame, in which it comes to be `after`."""
        out = replace(self, before=self.after, after=after)
        if "end" in self.__dict__:
            out.__dict__["start"] = self.end
        return out

    @property
    def neighbours(self) -> Ints:
        """(t,3) the triangle across the edge from corner k to k + 1, or -1."""
        if "neighbours" not in self.shared:
            self.shared["neighbours"] = neighbours(self.triangles)
        return self.shared["neighbours"]

    @cached_property
    def start(self) -> NDArray[np.float32]:
        """(V,6) positions and normals at the begin."""
        return _with_normals(self.before, self.triangles)

    @cached_property
    def end(self) -> NDArray[np.float32]:
        """(V,6) positions and normals at the end."""
        return self.start if self.after is self.before else _with_normals(self.after, self.triangles)

    @cached_property
    def reach(self) -> float:
        """Metres that its fastest vertex moves in the frame."""
        return 0.0 if self.after is self.before else float(np.linalg.norm(self.after - self.before, axis=1).max())

    def nearest(self, points: Floats) -> tuple[Floats, Ints]:
        """Distances (n,) of points (n,3) to the surface as it is at the begin, and the triangles (n,) that are nearest."""
        import igl

        squared, face = igl.point_mesh_squared_distance(
            np.ascontiguousarray(points, np.float64), self.before, self.triangles.astype(np.int64)
        )[:2]
        return np.sqrt(np.asarray(squared).reshape(-1)), np.asarray(face, np.int32).reshape(-1)

    def distances(self, points: Floats) -> Floats:
        """(n,) metres from the surface as it is at the begin, negative inside (by the winding number)."""
        import igl

        points = np.ascontiguousarray(points, np.float64)
        far = self.nearest(points)[0]
        inside = igl.fast_winding_number(self.before, self.triangles.astype(np.int64), points) > 0.5
        return np.where(inside, -far, far)


def still(vertices: Floats, triangles: Ints, *, offset: float = OFFSET) -> Obstacle:
    """A surface that does not move."""
    vertices = np.ascontiguousarray(vertices, np.float64)
    return Obstacle(triangles, vertices, vertices, offset)


def neighbours(triangles: Ints) -> Ints:
    """(t,3) the triangle across the edge from corner k to k + 1 of each, or -1 where there is not exactly one."""
    count = np.int64(triangles.max(initial=0)) + 1
    a, b = triangles.T.ravel().astype(np.int64), np.roll(triangles, -1, axis=1).T.ravel().astype(np.int64)
    key = np.minimum(a, b) * count + np.maximum(a, b)
    order = np.argsort(key, kind="stable")
    _, first, size = np.unique(key[order], return_index=True, return_counts=True)
    one, two = order[first[size == 2]], order[first[size == 2] + 1]
    out = np.full(len(key), -1, np.int32)
    out[one], out[two] = two % len(triangles), one % len(triangles)
    return np.ascontiguousarray(out.reshape(3, -1).T)


def _with_normals(vertices: Floats, triangles: Ints) -> NDArray[np.float32]:
    """Positions and normals."""
    return np.concatenate([vertices, pseudo_normals(vertices, triangles)], axis=1).astype(np.float32)


def pseudo_normals(vertices: Floats, triangles: Ints) -> Floats:
    """(V,3) normals of vertices, weighted by angles (Thuermer and Wuethrich 1998)."""
    corner = vertices[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    total = np.zeros_like(vertices)
    for k in range(3):
        u, v = corner[:, (k + 1) % 3] - corner[:, k], corner[:, (k + 2) % 3] - corner[:, k]
        long = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
        angle = np.arccos(np.clip(np.sum(u * v, axis=1) / np.maximum(long, 1e-30), -1, 1))
        for j in range(3):
            total[:, j] += np.bincount(triangles[:, k], angle * normal[:, j], len(vertices))
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)
