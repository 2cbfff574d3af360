"""The skin of a moving body as cloth meets it from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints
from vitruvian.cloth.obstacle import MOST, OFFSET, neighbours
from vitruvian.native import kernels

Single = NDArray[np.float32]
THREE = np.dtype("V12")  # a point of three numbers, copied as one
AROUND = 0.1  # metres about cloth in which it can meet something
PINCH = 0.03  # metres between parts of the body that face each other: cloth there meets its own part alone
CLEAR, WITHIN = 0.002, 0.03  # metres from the skin that cloth is put to; how deep it may be for that
SHALLOW = 0.01  # metres that cloth may be in an arm and still be pushed out of it


@dataclass(frozen=True, eq=False)
class Skin:
    """points (V,3) metres and unit normals (V,3), float32, of a surface with triangles (t,3); side (V,): 1 for those
    of the left arm and hand, 2 of the right, 0 else. `shared`: what does not change from frame to frame."""

    points: Single
    normals: Single
    triangles: Ints
    side: NDArray[np.int8]
    shared: dict[str, NDArray] = field(default_factory=dict, repr=False)

    @property
    def parts(self) -> tuple[Ints, Ints]:
        """Triangles (t,) of the body without arms, and of arms."""
        if "arms" not in self.shared:
            arms = (self.side[self.triangles] > 0).all(axis=1)
            self.shared["body"], self.shared["arms"] = np.flatnonzero(~arms), np.flatnonzero(arms)
        return self.shared["body"], self.shared["arms"]

    def at(self, points: Single, normals: Single) -> Skin:
        """The same surface elsewhere."""
        return Skin(points, normals, self.triangles, self.side, self.shared)

    def toward(self, other: Skin, share: float) -> Skin:
        """A share of the way to where the same surface is."""
        if share == 1:
            return other
        part = np.float32(share)
        return other.at(
            self.points + part * (other.points - self.points), self.normals + part * (other.normals - self.normals)
        )

    def under(self, points: Single, normals: Single, triangles: Ints, shared: dict[str, NDArray]) -> Skin:
        """With a cloth on it, points (n,3), normals and triangles; `shared`: of this pair."""
        if "triangles" not in shared:
            shared["triangles"] = np.concatenate([self.triangles, triangles + np.int32(len(self.points))])
            shared["side"] = np.concatenate([self.side, np.zeros(len(points), np.int8)])
        both = [np.concatenate(pair) for pair in ((self.points, points), (self.normals, normals))]
        return Skin(both[0], both[1], shared["triangles"], shared["side"], shared)

    @cached_property
    def both(self) -> Single:
        """(V,6) points and normals."""
        out = np.empty((len(self.points), 2), THREE)
        out[:, 0], out[:, 1] = (np.ascontiguousarray(a).view(THREE)[:, 0] for a in (self.points, self.normals))
        return out.view(np.float32)

    @property
    def neighbours(self) -> Ints:
        """(t,3) the triangle across the edge from corner k to k + 1 in the same part, arms or the rest, or -1."""
        if "neighbours" not in self.shared:
            arm = np.zeros(len(self.triangles), bool)
            arm[self.parts[1]] = True
            across = neighbours(self.triangles)
            across[arm[across] != arm[:, None]] = -1
            self.shared["neighbours"] = across
        return self.shared["neighbours"]


def feet(skin: Skin, corner: Ints, share: Single, offset: Single) -> tuple[Single, Single, Single]:
    """Where feet (n,3) are that have shares (n,3) of corners (n,3) of a skin, the normals there, and what is offset (n,3)
    from them: along the first side of the triangle, across it, along the normal."""
    native = kernels()
    if native is None:
        from vitruvian.cloth.layers_numpy import cloth_feet
    else:
        cloth_feet = native.cloth_feet
    foot, up, out = (np.empty((len(corner), 3), np.float32) for _ in range(3))
    cloth_feet(skin.points, skin.normals, corner, share, offset, foot, up, out)
    return foot, up, out


def clear(x: Single, vertices: Ints, nearest: Ints, skin: Skin, offset: float = CLEAR) -> None:
    """Puts some vertices (k,) of cloth at x (n,3) that are nearer to a skin than offset metres, or inside it, straight out
    of it. nearest (k,): the triangles from which what is nearest is looked for."""
    native = kernels()
    if native is None:
        from vitruvian.cloth.layers_numpy import cloth_clear
    else:
        cloth_clear = native.cloth_clear
    cloth_clear(x, vertices, nearest.copy(), skin.triangles, skin.neighbours, skin.both, offset, WITHIN)


@dataclass(frozen=True, eq=False)
class Passing:
    """A skin during a frame, as `vitruvian.cloth.solver.step` takes the body: see `Obstacle`.

    home (n,): cloth that lies on arms, which are its own part of the body; of other cloth that is the rest. The other part
    is met only from outside, as hands are put through the body where captured motion is shown on other people's bodies,
    and not where cloth would be pinched between both, as under arms.
    """

    skin: Skin
    before: Skin
    home: NDArray[np.bool_]
    offset: float = OFFSET
    most: float = MOST

    @property
    def triangles(self) -> Ints:
        return self.skin.triangles

    @property
    def neighbours(self) -> Ints:
        return self.skin.neighbours

    @property
    def start(self) -> Single:
        return self.before.both

    @property
    def end(self) -> Single:
        return self.skin.both

    @cached_property
    def reach(self) -> float:
        way = self.skin.points - self.before.points
        return float(np.sqrt(np.einsum("vx,vx->v", way, way).max(initial=0)))

    def nearest(self, points: Floats) -> tuple[Floats, Ints]:
        """Distances (n,) of points (n,3) to the middles of the triangles that they meet of the skin as it is at the begin,
        and which those are (n,): from there the solver goes on to what is nearest."""
        parts = [_Middles(self.before, faces, points) for faces in self.skin.parts]
        if not len(parts[0].faces) or not len(parts[1].faces):
            return (parts[0] if len(parts[0].faces) else parts[1]).nearest(points)
        far, face = np.empty(len(points)), np.empty(len(points), np.int32)
        for some, own, other in ((~self.home, parts[0], parts[1]), (self.home, parts[1], parts[0])):
            if not some.any():
                continue
            at = points[some]
            far[some], face[some] = own.nearest(at)
            away, on = other.nearest(at)
            corner = self.triangles[on, 0]
            up = np.einsum("nx,nx->n", at - self.before.points[corner], self.before.normals[corner])
            facing = np.einsum("nx,nx->n", self._middle(face[some]), self._middle(on)) < 0
            meets = (away < far[some]) & (up > -SHALLOW) & ~(facing & (away + far[some] < PINCH))
            far[some], face[some] = np.where(meets, away, far[some]), np.where(meets, on, face[some])
        return far, face

    def _middle(self, faces: Ints) -> Single:
        """(n,3) normals of faces, not of length one."""
        n, corner = self.before.normals, self.triangles[faces]
        return n[corner[:, 0]] + n[corner[:, 1]] + n[corner[:, 2]]


class _Middles:
    """Where the middles of some faces of a skin are, those far from all points (n,3) left out."""

    def __init__(self, skin: Skin, faces: Ints, points: Floats):
        from scipy.spatial import cKDTree

        x = skin.points[skin.triangles[faces, 0]]
        low, high = points.min(axis=0) - AROUND, points.max(axis=0) + AROUND
        some = np.flatnonzero(((x > low) & (x < high)).all(axis=1))
        self.faces = faces[some] if len(some) else faces
        corner = skin.triangles[self.faces]
        middle = (skin.points[corner[:, 0]] + skin.points[corner[:, 1]] + skin.points[corner[:, 2]]) / 3
        self.tree = cKDTree(middle, balanced_tree=False, compact_nodes=False)

    def nearest(self, points: Floats) -> tuple[Floats, Ints]:
        """Of points (n,3): how far the nearest is, and whose."""
        far, near = self.tree.query(points)
        return far, self.faces[near]


@dataclass(frozen=True, eq=False)
class Planes:
    """A tangent plane of its own for each vertex of a cloth, as `step` takes the body: the first layer's feet.

    foot and up (n,3) at a frame's end and begin. What is nearest never has to be looked for.
    """

    foot: Single
    up: Single
    foot_before: Single
    up_before: Single
    offset: float
    most: float = MOST
    wide: float = 0.5  # metres of a plane that are laid out

    @cached_property
    def triangles(self) -> Ints:
        return np.arange(3 * len(self.foot), dtype=np.int32).reshape(-1, 3)

    @cached_property
    def neighbours(self) -> Ints:
        return np.full((len(self.foot), 3), -1, np.int32)

    @cached_property
    def start(self) -> Single:
        return _laid(self.foot_before, self.up_before, self.wide)

    @cached_property
    def end(self) -> Single:
        return _laid(self.foot, self.up, self.wide)

    @cached_property
    def reach(self) -> float:
        way = self.foot - self.foot_before
        return float(np.sqrt(np.einsum("vx,vx->v", way, way).max(initial=0)))

    def nearest(self, points: Floats) -> tuple[Floats, Ints]:
        return np.zeros(len(points)), np.arange(len(points), dtype=np.int32)


def _laid(foot: Single, up: Single, wide: float) -> Single:
    """(3n,6) corners of a triangle about each foot, and its normal."""
    x, y, z = up.T
    sign = np.copysign(np.float32(1), z)
    a = -1 / (sign + z)
    c = x * y * a
    t = np.stack([1 + sign * x * x * a, sign * c, -sign * x], axis=1)  # with the normal and b, a frame without a pole
    b = np.stack([c, sign + y * y * a, -y], axis=1)
    out = np.empty((len(foot), 3, 6), np.float32)
    for k, turn in enumerate((0.0, 2 * np.pi / 3, 4 * np.pi / 3)):
        out[:, k, :3] = foot + np.float32(wide * np.cos(turn)) * t + np.float32(wide * np.sin(turn)) * b
    out[:, :, 3:] = up[:, None]
    return out.reshape(-1, 6)
