"""Bodies whose joints are driven by named coordinates through functions: what models of biomechanics are made of.

A H-Anim joint turns about its centre; here a joint may turn about any axes and slide along others while it turns, as the
knee of a gait model does. Source: the joint transforms of OpenSim (Delp and others 2007; its documentation of
CustomJoint): child = parent * P * translation * R1 R2 R3 * C^-1, axes fixed in the moved frame one after the other.
Metres and radians; Y up as in the model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.rotations import from_matrix
from vitruvian.body.types import Floats, Ints, Skeleton
from vitruvian.errors import VitruvianError
from vitruvian.motion.types import Motion

_STEP = 1e-6  # radians or metres of differences
_DONE = 1e-9


@dataclass(frozen=True, eq=False)
class Drive:
    """An amount along an axis (3,): scale * f(coordinate). f is a spline through knots (n,2), or slope and intercept;
    coordinate -1: a constant, the intercept."""

    axis: Floats
    coordinate: int
    line: tuple[float, float] = (0.0, 0.0)
    knots: Floats | None = None
    scale: float = 1.0

    def of(self, q: Floats) -> Floats:
        """(N,) amounts for coordinates q (N,C)."""
        slope, start = self.line
        if self.coordinate < 0:
            return np.full(len(q), self.scale * start)
        x = q[:, self.coordinate]
        return self.scale * (slope * x + start if self.knots is None else _spline(self.knots, x))


@dataclass(frozen=True, eq=False)
class Link:
    """A body and the joint that carries it: parent (-1: the ground), place of the joint in the parent and in the body
    (4,4), three turns and three slides."""

    name: str
    parent: int
    in_parent: Floats
    in_body: Floats
    turns: tuple[Drive, ...]
    slides: tuple[Drive, ...]


@dataclass(frozen=True, eq=False)
class Mechanism:
    """links, parents first. coordinates (C,): names; start (C,) where they rest, locked (C,) those that stay there.

    markers (M,): names, marker_link (M,), marker_point (M,3) in the axes of their bodies.
    """

    links: tuple[Link, ...]
    coordinates: tuple[str, ...]
    start: Floats
    locked: NDArray[np.bool_]
    markers: tuple[str, ...]
    marker_link: Ints
    marker_point: Floats

    def places(self, q: Floats) -> Floats:
        """(N,L,4,4): bodies in the ground for coordinates q (N,C)."""
        out = np.zeros((len(q), len(self.links), 4, 4))
        for i, link in enumerate(self.links):
            own = np.tile(np.eye(4), (len(q), 1, 1))
            for d in link.slides:
                own[:, :3, 3] += d.of(q)[:, None] * d.axis
            for d in link.turns:
                own[:, :3, :3] = own[:, :3, :3] @ _about(d.axis, d.of(q))
            above = np.eye(4) if link.parent < 0 else out[:, link.parent]
            out[:, i] = above @ link.in_parent @ own @ np.linalg.inv(link.in_body)
        return out

    def marker_places(self, q: Floats, some: Ints | None = None) -> Floats:
        """(N,M,3): markers in the ground, those of indices `some` only."""
        k = np.arange(len(self.markers)) if some is None else some
        m = self.places(q)[:, self.marker_link[k]]
        return np.einsum("nmij,mj->nmi", m[..., :3, :3], self.marker_point[k]) + m[..., :3, 3]

    def skeleton(self) -> Skeleton:
        """The bodies as joints at `start`, the markers as Sites. Joints lie at the origins of their bodies."""
        rest = self.places(self.start[None])[0]
        parents = np.array([link.parent for link in self.links], np.int32)
        own = rest[self.marker_link]
        points = np.einsum("mij,mj->mi", own[:, :3, :3], self.marker_point) + own[:, :3, 3]
        names = tuple(link.name for link in self.links)
        return Skeleton(
            names, parents, rest[:, :3, 3], site_names=self.markers, site_joints=self.marker_link, site_points=points
        )

    def motion(self, q: Floats, fps: float) -> Motion:
        """Coordinates (F,C) over time as a motion of `skeleton`."""
        skeleton = self.skeleton()
        rest, now = self.places(self.start[None])[0], self.places(q)
        world = now[..., :3, :3] @ np.swapaxes(rest[:, :3, :3], 1, 2)
        turn, move = np.empty((*world.shape[:2], 4)), np.empty((*world.shape[:2], 3))
        for i, link in enumerate(self.links):
            p = link.parent
            up = np.eye(3) if p < 0 else world[:, p]
            back = np.swapaxes(np.broadcast_to(up, world[:, i].shape), 1, 2)
            turn[:, i] = from_matrix(back @ world[:, i])
            # where the parent would leave the joint is not where it is: joints slide
            left = np.zeros(3) if p < 0 else now[:, p, :3, 3] - np.einsum("fij,j->fi", up, rest[p, :3, 3])
            move[:, i] = np.einsum("fij,fj->fi", back, now[:, i, :3, 3] - left) - rest[i, :3, 3]
        return Motion(skeleton, fps, turn, move[:, 0], joint_translation=move)


def coordinates_of(
    mechanism: Mechanism, names: tuple[str, ...], points: Floats, *, iterations: int = 60
) -> tuple[Floats, Floats]:
    """Coordinates (F,C) that bring the mechanism's markers nearest to points (F,M,3), NaN where missing, and what is
    left (F,M) metres. All weigh the same; each frame starts from the one before.

    Method: Gauss-Newton steps damped after Levenberg and Marquardt. Raises VitruvianError for markers it has not.
    """
    place = {n: i for i, n in enumerate(mechanism.markers)}
    wrong = [n for n in names if n not in place]
    if wrong:
        raise VitruvianError(f"markers: the model has no {wrong[0]!r}; it has {', '.join(mechanism.markers[:8])}, ...")
    some = np.array([place[n] for n in names], np.int32)
    free = np.flatnonzero(~mechanism.locked).astype(np.int32)
    out = np.empty((len(points), len(mechanism.coordinates)))
    left = np.empty(points.shape[:2])
    q = mechanism.start.copy()
    for f, goal in enumerate(points):
        seen = np.isfinite(goal).all(axis=1)
        q, left[f] = _fitted(mechanism, some, np.where(seen[:, None], goal, 0.0), seen, free, q, iterations)
        out[f] = q
    return out, left


def _fitted(
    mechanism: Mechanism, some: Ints, goal: Floats, seen: Floats, free: Ints, q: Floats, iterations: int
) -> tuple[Floats, Floats]:
    def missing(at: Floats) -> Floats:
        return (goal - mechanism.marker_places(at, some)) * seen[:, None]

    mu, error = 1e-3, missing(q[None])[0]
    for _ in range(iterations):
        near = np.repeat(q[None], len(free), axis=0)
        near[np.arange(len(free)), free] += _STEP
        slope = ((error - missing(near)) / _STEP).reshape(len(free), -1)  # of places
        normal, pull = slope @ slope.T, slope @ error.ravel()
        for _ in range(12):
            step = np.linalg.solve(normal + mu * 1e-3 * np.eye(len(free)), pull)
            trial = q.copy()
            trial[free] += step
            then = missing(trial[None])[0]
            if (then**2).sum() <= (error**2).sum():
                break
            mu *= 10
        else:
            break
        gained = (error**2).sum() - (then**2).sum()
        q, error, mu = trial, then, max(mu * 0.1, 1e-9)
        if np.abs(step).max() < 1e-7 or gained < _DONE * (then**2).sum():
            break
    return q, np.where(seen, np.linalg.norm(error, axis=1), np.nan)


def _about(axis: Floats, angle: Floats) -> Floats:
    """(N,3,3) turns about an axis (Rodrigues)."""
    x, y, z = axis / max(float(np.linalg.norm(axis)), 1e-12)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle)[:, None, None] * k + (1 - np.cos(angle))[:, None, None] * (k @ k)


def _spline(knots: Floats, x: Floats) -> Floats:
    """A cubic spline through knots (n,2), straight on beyond them."""
    from scipy.interpolate import CubicSpline

    at, value = knots.T
    if len(at) < 4:
        return np.interp(x, at, value)
    curve = CubicSpline(at, value)
    inside = np.clip(x, at[0], at[-1])
    return np.asarray(curve(inside) + (x - inside) * curve(inside, 1))
