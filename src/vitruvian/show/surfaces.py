"""Surfaces as they are drawn, and all of them as one list of triangles with attributes at their corners."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Part, require
from vitruvian.show.shade import KINDS, kind_of, to_linear
from vitruvian.show.textures import HALF, SOLID, Texture, drawn
from vitruvian.show.trace import Single


@dataclass(frozen=True, eq=False)
class Surface:
    """What is drawn: vertices (V,3) metres in the world, triangles (T,3).

    normals (V,3), or (T,3,3) per corner where creases are, or None: smooth. colors (V,3) sRGB or None: those of the
    parts, which cover the triangles in order. rest (V,3): positions that patterns stick to, or None: the vertices.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    normals: NDArray[np.floating] | None = None
    colors: NDArray[np.float64] | None = None
    parts: tuple[Part, ...] = ()
    rest: NDArray[np.float64] | None = None
    soft: NDArray[np.floating] | None = None  # (V,3) normals of the smoothed surface, or None: made of the others
    uv: NDArray[np.floating] | None = None  # (T,3,2) texture coordinates of each corner, or None


def vertex_normals(vertices: NDArray, triangles: NDArray) -> Single:
    """Unit normals (V,3): the area-weighted mean of the faces round each vertex, shared by vertices at one place."""
    corner = vertices[triangles]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    place = places(vertices)
    return unit(_gather(face, place[triangles], len(vertices)))[place]


def places(vertices: NDArray) -> NDArray[np.int64]:
    """(V,) numbers of the places that vertices (V,3) are at; those of surfaces that meet at a seam are equal to the bit."""
    flat = np.ascontiguousarray(vertices)
    rows = flat.view(np.dtype((np.void, flat.dtype.itemsize * 3))).reshape(-1)
    return np.unique(rows, return_inverse=True)[1].reshape(-1)


def _gather(value: NDArray, triangles: NDArray, n: int) -> NDArray:
    """Sum (n,3) over the triangles of each vertex of a value (T,3) per triangle."""
    flat = triangles.T.reshape(-1)
    return np.stack([np.bincount(flat, np.tile(value[:, i], 3), minlength=n) for i in range(3)], -1)


def unit(a: NDArray) -> Single:
    length = np.sqrt(np.einsum("...i,...i->...", a, a))[..., None]
    return (a / np.where(length > 1e-30, length, 1)).astype(np.float32)


def softened(normals: Single, triangles: NDArray, rounds: int = 3) -> Single:
    """Normals (V,3) averaged over their neighbours `rounds` times."""
    for _ in range(rounds):
        total = normals[triangles].sum(axis=1)
        normals = unit(_gather(total, triangles, len(normals)))
    return normals


def deep_normals(surface: Surface, normals: Single) -> Single:
    """Normals (V,3) for light that has been inside: softened where the parts are skin or eyes, else as they are."""
    if surface.soft is not None:
        return np.asarray(surface.soft)
    inside = [p for p in surface.parts if KINDS[kind_of(p.name)] in ("skin", "eye")]
    if not inside:
        return normals
    some = np.concatenate([surface.triangles[p.start : p.stop] for p in inside])
    place = places(surface.vertices)  # light does not stop at a seam
    soft = np.zeros_like(normals)
    soft[place] = normals
    out, used = normals.copy(), np.unique(some)
    out[used] = softened(soft, place[some])[place[used]]
    return out


def joined(a: Surface, b: Surface) -> Surface:
    """Two surfaces as one; a's vertices come first."""
    n, m = len(a.vertices), len(a.triangles)
    normals = []
    for s in (a, b):
        given = vertex_normals(s.vertices, s.triangles) if s.normals is None else s.normals
        normals.append(given[s.triangles] if given.ndim == 2 else given)
    colors = None
    if a.colors is not None or b.colors is not None:
        colors = np.concatenate([_painted(a), _painted(b)])
    parts = (*a.parts, *(replace(p, start=p.start + m, stop=p.stop + m) for p in b.parts))
    rest = [s.vertices if s.rest is None else s.rest for s in (a, b)]
    uv = None
    if a.uv is not None or b.uv is not None:
        uv = np.concatenate([np.zeros((len(s.triangles), 3, 2)) if s.uv is None else s.uv for s in (a, b)])
    return Surface(
        np.concatenate([a.vertices, b.vertices]), np.concatenate([a.triangles, b.triangles + n]),
        np.concatenate(normals), colors, parts, np.concatenate(rest), uv=uv,
    )  # fmt: skip


def _painted(s: Surface) -> NDArray[np.float64]:
    """Vertex colours (V,3): the given ones, or those of the parts."""
    if s.colors is not None:
        return s.colors
    out = np.full((len(s.vertices), 3), 0.8)
    for p in s.parts:
        out[s.triangles[p.start : p.stop]] = p.color
    return out


class Soup:
    """All surfaces as one list of triangles, near the origin, in float32.

    Attributes: vertices (V,3), triangles (T,3), faces (T,3) unit normals, corners (T,3,15): position, normal, linear
    colour, normal of the smoothed surface and position at rest at each corner; part (T,) into `parts`; and per part kind,
    roughness, metallic, opacity, crowns (P,3). Where a part has a picture: uv (T,3,2) and `Textures`, else None.
    """

    def __init__(self, surfaces: Sequence[Surface], middle: NDArray):
        self.parts: list[Part] = []
        vertices, triangles, corners, part, crowns, uv = [], [], [], [], [], []
        start = 0
        for s in surfaces:
            v = np.asarray(s.vertices, np.float64) - middle
            t = np.asarray(s.triangles, np.int32)
            parts = s.parts or (Part("object", 0, len(t)),)
            require(parts[-1].stop == len(t), "parts", f"ranges that cover 0..{len(t)}", parts[-1].stop)
            which = np.repeat(np.arange(len(parts)), [p.stop - p.start for p in parts])
            smooth = vertex_normals(v, t)
            given = smooth if s.normals is None else unit(np.asarray(s.normals))
            if s.colors is None:
                color = np.repeat(to_linear([p.color for p in parts])[which][:, None], 3, axis=1)
            else:
                color = to_linear(s.colors)[t]
            rest = v if s.rest is None else np.asarray(s.rest)
            normals = given[t] if given.ndim == 2 else given
            soft = deep_normals(s, smooth)
            corners.append(np.concatenate([v[t], normals, color, soft[t], rest[t]], -1, dtype=np.float32))
            vertices.append(v)
            triangles.append(t + start)
            part.append(which + len(self.parts))
            crowns.append(_crowns(v, t, parts))
            if s.uv is None:  # coordinates that are not there colour nothing
                parts = tuple(replace(p, picture=None) if p.picture else p for p in parts)
            uv.append(s.uv)
            self.parts += parts
            start += len(v)
        self.vertices = np.concatenate(vertices).astype(np.float32)
        self.triangles = np.concatenate(triangles).astype(np.int32)
        self.corners = np.concatenate(corners)
        self.part = np.concatenate(part).astype(np.int32)
        self.crowns = np.concatenate(crowns).astype(np.float32)
        a, b, c = (self.corners[:, i, :3] for i in range(3))
        self.faces = unit(np.cross(b - a, c - a))
        self.kind = np.array([kind_of(p.name) for p in self.parts], np.int8)
        self.roughness = np.array([np.clip(p.roughness, 0.03, 1) for p in self.parts], np.float32)
        self.metallic = np.array([p.metallic for p in self.parts], np.float32)
        self.opacity = np.array([p.opacity for p in self.parts], np.float32)
        self.textures = None
        if any(p.picture for p in self.parts):
            filled = [np.zeros((len(s.triangles), 3, 2)) if u is None else u for s, u in zip(surfaces, uv)]
            self.textures = Textures(self, np.concatenate(filled).astype(np.float32))


def _crowns(vertices: NDArray, triangles: NDArray, parts: Sequence[Part]) -> NDArray:
    """(parts,3) the place that hair grows away from: behind the highest point of each part."""
    out = np.zeros((len(parts), 3))
    for i, p in enumerate(parts):
        if p.stop > p.start and KINDS[kind_of(p.name)] == "hair":
            points = vertices[np.unique(triangles[p.start : p.stop])]
            low, high = points.min(axis=0), points.max(axis=0)
            out[i] = [(low[0] + high[0]) / 2, high[1] + 0.02, 0.65 * low[2] + 0.35 * high[2]]
    return out


class Textures:
    """The pictures on a soup: how dense each lies on its triangles, and its colours at hits.

    Attributes: uv (T,3,2); pictured (T,) whether a picture colours the triangle; clear (T,) whether it may let something
    shine through; density (T,) pixels of the picture per metre of the surface.
    """

    def __init__(self, soup: Soup, uv: Single):
        self.uv, self.part = uv, soup.part
        self.of = drawn(soup.parts)
        self.alpha = [p.picture.alpha if p.picture else "" for p in soup.parts]
        self.pictured = np.array([t is not None for t in self.of])[soup.part]
        self.density = np.zeros(len(uv), np.float32)
        size = np.array([t.levels[0].shape[1::-1] if t else (0, 0) for t in self.of], np.float64)[soup.part]
        some = np.flatnonzero(self.pictured)
        a, b, c = (self.uv[some, i].astype(np.float64) * size[some] for i in range(3))
        area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
        a, b, c = (soup.corners[some, i, :3].astype(np.float64) for i in range(3))
        place = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        self.density[some] = np.sqrt(np.where(np.isfinite(area), area, 0) / np.maximum(place, 1e-18))
        self.clear = np.zeros(len(uv), bool)
        for n, t in enumerate(self.of):
            if t is not None and t.clear and self.alpha[n]:
                mine = np.flatnonzero(soup.part == n)
                self.clear[mine] = self._see_through(t, mine)

    def _see_through(self, texture: Texture, mine: NDArray) -> NDArray[np.bool_]:
        """Which of these triangles have a place where something shines through, by a pattern of places on each."""
        out = np.zeros(len(mine), bool)
        for u, v in _PLACES:
            at = self.uv[mine, 0] * (1 - u - v) + self.uv[mine, 1] * u + self.uv[mine, 2] * v
            out |= texture.colors(at, np.zeros(len(mine)))[:, 3] < SOLID / 255
        return out

    def colors(self, triangle: NDArray, u: Single, v: Single, apart: Single) -> Single:
        """Linear RGB and alpha (n,4) that multiply the colour at hits; `apart` (n,): metres of the surface between
        neighbouring samples. Cut-outs are there or not."""
        out = np.ones((len(triangle), 4), np.float32)
        part = self.part[triangle]
        for n in np.unique(part[self.pictured[triangle]]):
            some = np.flatnonzero(part == n)
            texture, t = self.of[n], triangle[some]
            assert texture is not None
            at = self.uv[t, 0] * (1 - u - v)[some, None] + self.uv[t, 1] * u[some, None] + self.uv[t, 2] * v[some, None]
            found = texture.colors(at, np.log2(np.maximum(self.density[t] * apart[some], 1e-6)))
            if self.alpha[n] == "mask":
                found[:, 3] = found[:, 3] >= HALF / 255
            elif not self.alpha[n]:
                found[:, 3] = 1
            out[some] = found
        return out


_PLACES = [(a / 6, b / 6) for a in range(7) for b in range(7 - a)]
