"""Looking from points inside a body to its surface: sections of limbs, depth, what is inside."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from vitruvian.body.rotations import unit
from vitruvian.body.types import Body, Floats, Ints

AROUND = 48  # directions of a section
_EVERY = 26  # directions that tell inside from outside


def everywhere(count: int) -> Floats:
    """(count,3) directions spread evenly."""
    k = np.arange(count) + 0.5
    height, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(turn), height, flat * np.sin(turn)], axis=1)


@dataclass(frozen=True, eq=False)
class Flesh:
    """A body's surface at rest: points (V,3), triangles (T,3)."""

    points: Floats
    triangles: Ints

    @staticmethod
    def of(body: Body) -> Flesh:
        return Flesh(body.skin.rest, body.skin.triangles)

    @cached_property
    def _caster(self) -> Any:
        from trimesh import Trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector

        return RayMeshIntersector(Trimesh(self.points, self.triangles, process=False))

    @cached_property
    def _normals(self) -> Floats:
        corner = self.points[self.triangles]
        return unit(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]))

    def look(self, eyes: Floats, directions: Floats) -> tuple[Floats, Floats]:
        """(n,) distance to the first surface that is met, inf for none; (n,) cosine between direction and its normal:
        above zero where the eye is inside."""
        met = self._caster.intersects_first(eyes, directions)
        some = met >= 0
        corner, normal = self.points[self.triangles[met, 0]], self._normals[met]
        along = np.sum(directions * normal, axis=1)
        steep = some & (np.abs(along) > 1e-9)
        distance = np.sum((corner - eyes) * normal, axis=1) / np.where(steep, along, 1.0)
        return np.where(steep, distance, np.inf), np.where(steep, along, 0.0)

    def section(self, here: Floats, across: Floats, reach: float) -> tuple[Floats, Floats, float] | None:
        """Of the section through a point, square to a unit direction, no farther out than `reach`: centroid (3,), rim
        (n,3), mean radius; None when the point is not inside it."""
        helper = np.eye(3)[int(np.argmin(np.abs(across)))]
        one = unit(np.cross(across, helper))
        two = np.cross(across, one)
        turn = np.arange(AROUND) * 2 * np.pi / AROUND
        directions = np.cos(turn)[:, None] * one + np.sin(turn)[:, None] * two
        distance, along = self.look(np.tile(here, (AROUND, 1)), directions)
        good = np.isfinite(distance) & (along > 0) & (distance < reach)
        if good.sum() < 0.8 * AROUND:
            return None
        radius = np.interp(turn, turn[good], distance[good], period=2 * np.pi)
        radius = np.minimum(radius, 2.5 * np.median(radius))  # where the ray goes along a neighbour
        mean = (2 / 3) * np.sum(radius[:, None] ** 3 * directions, axis=0) / np.sum(radius**2)
        return here + mean, here + radius[:, None] * directions, float(np.sqrt(np.mean(radius**2)))

    def span(self, here: Floats, direction: Floats) -> tuple[float, float] | None:
        """How far the surface is in a unit direction and against it; None when the point is not inside."""
        distance, along = self.look(np.stack([here, here]), np.stack([direction, -direction]))
        return (float(distance[0]), float(distance[1])) if np.isfinite(distance).all() and (along > 0).all() else None

    def holds(self, points: Floats) -> tuple[np.ndarray, Floats]:
        """(n,) whether points (n,3) are inside, most of what they see in all directions being the surface's inner side,
        and (n,3) the nearest points of the surface."""
        import igl

        directions = everywhere(_EVERY)
        eyes = np.repeat(points, _EVERY, axis=0)
        distance, along = self.look(eyes, np.tile(directions, (len(points), 1)))
        inner = (np.isfinite(distance) & (along > 0)).reshape(len(points), _EVERY).mean(axis=1) > 0.6
        _, _, nearest = igl.point_mesh_squared_distance(points, self.points, self.triangles.astype(np.int64))[:3]
        return inner, np.asarray(nearest, np.float64)
