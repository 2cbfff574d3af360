"""Surfaces as they are drawn, and all of them as one list of triangles with attributes at their corners."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Part, require
from vitruvian.show.shade import KINDS, kind_of, to_linear
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
    return Surface(
        np.concatenate([a.vertices, b.vertices]), np.concatenate([a.triangles, b.triangles + n]),
        np.concatenate(normals), colors, parts, np.concatenate(rest),
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
    roughness, metallic, opacity, crowns (P,3).
    """

    def __init__(self, surfaces: Sequence[Surface], middle: NDArray):
        self.parts: list[Part] = []
        vertices, triangles, corners, part, crowns = [], [], [], [], []
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


def _crowns(vertices: NDArray, triangles: NDArray, parts: Sequence[Part]) -> NDArray:
    """(parts,3) the place that hair grows away from: behind the highest point of each part."""
    out = np.zeros((len(parts), 3))
    for i, p in enumerate(parts):
        if p.stop > p.start and KINDS[kind_of(p.name)] == "hair":
            points = vertices[np.unique(triangles[p.start : p.stop])]
            low, high = points.min(axis=0), points.max(axis=0)
            out[i] = [(low[0] + high[0]) / 2, high[1] + 0.02, 0.65 * low[2] + 0.35 * high[2]]
    return out
