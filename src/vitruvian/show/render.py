"""Surfaces, a camera and a studio become pixels.

Primary visibility at every sub-pixel; soft key shadow and ambient occlusion once per pixel, from sixteen complementary
sets of directions that an edge-aware 4 x 4 mean puts together; the floor only catches shadow, so there is no horizon.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Part, require
from vitruvian.errors import VitruvianError
from vitruvian.show.camera import Camera
from vitruvian.show.shade import KINDS, Samples, Studio, kind_of, shade, to_linear, to_srgb
from vitruvian.show.trace import Hits, Single, Tracer, tile, tracer

Pixels = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Surface:
    """What is drawn: vertices (V,3) metres in the world, triangles (T,3).

    normals (V,3), or (T,3,3) per corner where creases are, or None: smooth. colors (V,3) sRGB or None: those of the
    parts, which cover the triangles in order. rest (V,3): positions that patterns stick to, or None: the vertices.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    normals: NDArray[np.float64] | None = None
    colors: NDArray[np.float64] | None = None
    parts: tuple[Part, ...] = ()
    rest: NDArray[np.float64] | None = None


def vertex_normals(vertices: NDArray, triangles: NDArray) -> Single:
    """Unit normals (V,3): the area-weighted mean of the faces round each vertex, shared by vertices at one place."""
    corner = vertices[triangles]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return _unit(_gather(face, triangles, len(vertices)))


def _gather(value: NDArray, triangles: NDArray, n: int) -> NDArray:
    """Sum (n,3) over the triangles of each vertex of a value (T,3) per triangle."""
    flat = triangles.T.reshape(-1)
    return np.stack([np.bincount(flat, np.tile(value[:, i], 3), minlength=n) for i in range(3)], -1)


def _unit(a: NDArray) -> Single:
    length = np.sqrt(np.einsum("...i,...i->...", a, a))[..., None]
    return (a / np.where(length > 1e-30, length, 1)).astype(np.float32)


def softened(normals: Single, triangles: NDArray, rounds: int = 3) -> Single:
    """Normals (V,3) averaged over their neighbours `rounds` times."""
    for _ in range(rounds):
        total = normals[triangles].sum(axis=1)
        normals = _unit(_gather(total, triangles, len(normals)))
    return normals


class Soup:
    """All surfaces as one list of triangles, near the origin, in float32."""

    def __init__(self, surfaces: Sequence[Surface], middle: NDArray):
        self.parts: list[Part] = []
        lists: dict[str, list[NDArray]] = {k: [] for k in ("v", "t", "n", "s", "c", "p", "r", "h")}
        start = 0
        for s in surfaces:
            v = np.asarray(s.vertices, np.float64)
            t = np.asarray(s.triangles, np.int32)
            parts = s.parts or (Part("object", 0, len(t)),)
            require(parts[-1].stop == len(t), "parts", f"ranges that cover 0..{len(t)}", parts[-1].stop)
            normals = vertex_normals(v, t) if s.normals is None else _unit(np.asarray(s.normals))
            per_vertex = normals if normals.ndim == 2 else vertex_normals(v, t)
            which = np.repeat(np.arange(len(parts)), [p.stop - p.start for p in parts]) + len(self.parts)
            lists["v"].append(v - middle)
            lists["t"].append(t + start)
            lists["n"].append(per_vertex[t] if normals.ndim == 2 else normals)
            lists["s"].append(softened(per_vertex, t)[t])
            lists["p"].append(which)
            if s.colors is None:
                flat = to_linear([p.color for p in parts])
                lists["c"].append(np.repeat(flat[which - len(self.parts)][:, None], 3, axis=1))
            else:
                lists["c"].append(to_linear(s.colors)[t])
            lists["r"].append(v if s.rest is None else np.asarray(s.rest))
            lists["h"].append(_crowns(v - middle, t, parts))
            self.parts += parts
            start += len(v)
        self.vertices = np.concatenate(lists["v"]).astype(np.float32)
        self.triangles = np.concatenate(lists["t"]).astype(np.int32)
        self.normals = np.concatenate(lists["n"]).astype(np.float32)
        self.soft = np.concatenate(lists["s"]).astype(np.float32)
        self.colors = np.concatenate(lists["c"])
        self.part = np.concatenate(lists["p"]).astype(np.int32)
        self.rest = np.concatenate(lists["r"]).astype(np.float32)
        self.crowns = np.concatenate(lists["h"]).astype(np.float32)
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


def _offsets(samples: int) -> list[tuple[float, float]]:
    """Sub-pixel positions: a rotated grid."""
    side = round(samples**0.5)
    if samples < 1 or side * side != samples:
        raise VitruvianError(f"samples: expected 1, 4, 9 or 16, found {samples}")
    if side == 1:
        return [(0.5, 0.5)]
    at = (np.arange(side) + 0.5) / side
    slant = (np.arange(side) - (side - 1) / 2) / side**2
    return [(float(at[i] + slant[j]), float(at[j] - slant[i])) for j in range(side) for i in range(side)]


def whole(size: tuple[int, int]) -> tuple[int, int]:
    """(width, height) as integers in 1..16384; raises `VitruvianError`."""
    width, height = (int(n) for n in size)
    if not (0 < width <= 16384 and 0 < height <= 16384):
        raise VitruvianError(f"size: expected two numbers in 1..16384, found {size}")
    return width, height


def render(
    surfaces: Sequence[Surface],
    camera: Camera,
    size: tuple[int, int],
    *,
    samples: int = 4,
    studio: Studio | None = None,
    transparent: bool = False,
    floor: float | None = 0.0,
    tracing: str = "auto",
    quality: int = 6,
) -> Pixels:
    """A picture (height, width, 3) uint8 sRGB, or (.., 4) with straight alpha when `transparent`.

    size: (width, height) pixels. samples: 1, 4, 9 or 16 per pixel. floor: its height in metres, None for none.
    quality: directions per pixel for ambient light and for the key's soft shadow (times sixteen after the mean).
    tracing: "auto", "embree" or "numpy". Raises `VitruvianError` for an empty size or no surface.
    """
    width, height = whole(size)
    if not surfaces or not any(len(s.triangles) for s in surfaces):
        raise VitruvianError("picture: there is nothing to see, expected at least one triangle")
    studio = studio or Studio()
    points = np.concatenate([s.vertices for s in surfaces])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    soup = Soup(surfaces, middle)
    camera = camera.moved(-middle)
    back = camera.axes()[2]
    heading = float(np.degrees(np.arctan2(back[0], back[2])))
    solid_triangles = np.flatnonzero(soup.opacity[soup.part] > 0.999)
    glass_triangles = np.flatnonzero(soup.opacity[soup.part] <= 0.999)
    solid = tracer(soup.vertices, soup.triangles[solid_triangles], tracing)
    reach = float(np.linalg.norm(np.ptp(points, axis=0)))

    offsets = _offsets(samples)
    color = np.zeros((height * width, 3), np.float32)
    cover = np.zeros(height * width, np.float32)
    hits = _trace(solid, camera, (width, height), offsets, solid_triangles)
    glass = None
    if glass_triangles.size:
        clear = tracer(soup.vertices, soup.triangles[glass_triangles], tracing)
        glass = _trace(clear, camera, (width, height), offsets, glass_triangles)
    _lay(color, cover, hits, glass, soup, solid, camera, (width, height), studio, heading, reach, samples, quality)

    dark = np.ones(height * width, np.float32)
    if floor is not None:
        dark = _floor(solid, soup, camera, (width, height), studio, heading, floor - middle[1], reach)
    if transparent:
        alpha = cover + (1 - cover) * (1 - dark)
        rgb = to_srgb(color / np.maximum(alpha, 1e-6)[:, None])
        out = np.concatenate([rgb, alpha[:, None]], -1)
    else:
        scene = _backdrop(camera, (width, height), studio) * dark[:, None]
        out = to_srgb(color + scene * (1 - cover)[:, None])
        out += _dither(width, height)[:, None] / 255
    return (np.clip(out, 0, 1) * 255 + 0.5).astype(np.uint8).reshape(height, width, -1)


def _trace(
    rays: Tracer, camera: Camera, size: tuple[int, int], offsets: list[tuple[float, float]], names: NDArray
) -> Hits:
    """All samples of the picture in one list; `pixel` counts on through the sub-pixel patterns."""
    parts = []
    for i, offset in enumerate(offsets):
        h = rays.visible(camera, size, offset)
        parts.append(Hits(h.pixel + i * size[0] * size[1], names[h.triangle].astype(np.int32), h.u, h.v, h.depth))
    return Hits.join(parts)


def _lay(color, cover, hits, glass, soup, solid, camera, size, studio, heading, reach, samples, quality) -> None:  # type: ignore[no-untyped-def]
    """Shade the samples and add them to the picture; see-through parts (one layer) go over the solid ones."""
    n = size[0] * size[1]
    light = _shaded(hits, soup, solid, camera, size, studio, heading, reach, quality)
    share = np.full(len(hits.pixel), 1 / samples, np.float32)
    if glass is not None and len(glass.pixel):
        behind = np.full(n * samples, -1, np.int64)
        behind[hits.pixel] = np.arange(len(hits.pixel))
        at = behind[glass.pixel]
        front = np.flatnonzero((at < 0) | (glass.depth < hits.depth[np.maximum(at, 0)]))
        glass = Hits(*(getattr(glass, k)[front] for k in Hits.__dataclass_fields__))
        opacity = soup.opacity[soup.part[glass.triangle]]
        over = _shaded(glass, soup, solid, camera, size, studio, heading, reach, quality)
        some = at[front] >= 0
        share[at[front][some]] *= 1 - opacity[some]
        _add(color, cover, glass.pixel % n, over, opacity / samples)
    _add(color, cover, hits.pixel % n, light, share)


def _add(color: Single, cover: Single, pixel: NDArray, light: Single, share: Single) -> None:
    for i in range(3):
        color[:, i] += np.bincount(pixel, light[:, i] * share, minlength=len(cover)).astype(np.float32)
    cover += np.bincount(pixel, share, minlength=len(cover)).astype(np.float32)


def _shaded(hits: Hits, soup: Soup, solid: Tracer, camera, size, studio, heading, reach, quality) -> Single:  # type: ignore[no-untyped-def]
    if not len(hits.pixel):
        return np.zeros((0, 3), np.float32)
    bary = np.stack([1 - hits.u - hits.v, hits.u, hits.v], -1)
    corner = soup.triangles[hits.triangle]

    def mix(per_corner: Single) -> Single:
        return np.einsum("nk,nki->ni", bary, per_corner)

    point = mix(soup.vertices[corner])
    view = _unit(np.asarray(camera.eye, np.float32) - point)
    normal = _unit(mix(soup.normals[hits.triangle]))
    soft = _unit(mix(soup.soft[hits.triangle]))
    part = soup.part[hits.triangle]
    # surfaces seen from behind are lit from behind; grazing smooth normals are bent back into view
    a, b, c = (soup.vertices[corner[:, i]] for i in range(3))
    face = _unit(np.cross(b - a, c - a))
    away = np.einsum("ni,ni->n", face, view) < 0
    for array in (face, normal, soft):
        array[away] *= -1
    lack = np.minimum(np.einsum("ni,ni->n", normal, view) - 0.02, 0)
    normal = _unit(normal - lack[:, None] * view)

    n = size[0] * size[1]
    pixel = hits.pixel % n
    first = np.full(n, -1, np.int64)
    first[pixel[::-1]] = np.arange(len(pixel))[::-1]
    chosen = first[first >= 0]
    place = np.full(n, -1, np.int64)
    place[pixel[chosen]] = np.arange(len(chosen))
    start = _above(point[chosen], bary[chosen], corner[chosen], soup, hits.triangle[chosen], away[chosen])
    start = start + face[chosen] * np.float32(1.5e-4 * reach)
    row = tile(pixel[chosen], size[0])
    key = studio.key.towards(heading)
    sky = solid.ambient(start, normal[chosen], row, quality)
    lit = np.zeros(len(chosen), np.float32)
    facing = np.flatnonzero(np.einsum("ni,i->n", normal[chosen], key) > -0.35)
    lit[facing] = solid.light(start[facing], key, studio.key.radius, row[facing], quality)
    sky, lit = _smooth(np.stack([sky, lit], -1), place, pixel[chosen], size, point[chosen], normal[chosen], reach).T
    back = place[pixel]
    kind = soup.kind[part]
    samples = Samples(
        normal, soft, view, mix(soup.colors[hits.triangle]), point - soup.crowns[part], mix(soup.rest[corner]), kind,
        soup.roughness[part], soup.metallic[part], sky[back], lit[back],
    )  # fmt: skip
    return shade(samples, studio, heading)


def _above(point, bary, corner, soup, triangle, away) -> Single:  # type: ignore[no-untyped-def]
    """Points lifted to the smooth surface that the normals describe, against faceted edges of shadows.

    Source: Hanika, Hacking the Shadow Terminator, Ray Tracing Gems II, 2021.
    """
    lifted = np.zeros_like(point)
    for i in range(3):
        normal = soup.normals[triangle, i] * np.where(away, -1, 1)[:, None].astype(np.float32)
        offset = point - soup.vertices[corner[:, i]]
        depth = np.minimum(np.einsum("ni,ni->n", offset, normal), 0)
        lifted += bary[:, i, None] * (point - depth[:, None] * normal)
    return lifted


def _smooth(value, place, pixel, size, point, normal, reach) -> Single:  # type: ignore[no-untyped-def]
    """Mean of value (n,k) over the 4 x 4 block of pixels round each that lie on the same surface."""
    width, height = size
    total, weight = value.copy(), np.ones(len(value), np.float32)
    x, y = pixel % width, pixel // width
    for dy in range(-2, 2):
        for dx in range(-2, 2):
            if dx == dy == 0:
                continue
            inside = (x + dx >= 0) & (x + dx < width) & (y + dy >= 0) & (y + dy < height)
            j = np.where(inside, place[np.where(inside, pixel + dy * width + dx, 0)], -1)
            apart = np.abs(np.einsum("ni,ni->n", point[j] - point, normal))
            good = (j >= 0) & (apart < 0.004 * reach) & (np.einsum("ni,ni->n", normal[j], normal) > 0.75)
            w = good.astype(np.float32)
            total += value[j] * w[:, None]
            weight += w
    return total / weight[:, None]


def _floor(solid, soup, camera, size, studio, heading, level, reach) -> Single:  # type: ignore[no-untyped-def]
    """How much light is left on the floor at each pixel (height * width,): contact and key shadow on a fine grid."""
    width, height = size
    y, x = np.mgrid[0:height, 0:width]
    rays = camera.rays(x + 0.5, y + 0.5, size).astype(np.float32).reshape(-1, 3)
    eye = np.asarray(camera.eye, np.float32)
    dark = np.ones(height * width, np.float32)
    below = eye[1] > level + 1e-4
    seen = np.flatnonzero(rays[:, 1] < -1e-5) if below else np.zeros(0, np.int64)
    low, high = soup.vertices.min(axis=0), soup.vertices.max(axis=0)
    if not seen.size or low[1] > level + 0.5 * (high[1] - low[1]) + 0.3:
        return dark
    t = (level - eye[1]) / rays[seen, 1]
    at = eye[[0, 2]] + rays[seen][:, [0, 2]] * t[:, None]
    middle = (low[[0, 2]] + high[[0, 2]]) / 2
    half = 0.5 * max(float(np.ptp([low[0], high[0]])), float(np.ptp([low[2], high[2]]))) + 0.75 * (high[1] - low[1])
    cells = 144
    grid = (np.arange(cells, dtype=np.float32) + 0.5) / cells * 2 - 1
    gx, gz = np.meshgrid(grid * half + middle[0], grid * half + middle[1])
    points = np.stack([gx, np.full_like(gx, level + 2e-4 * reach), gz], -1).reshape(-1, 3).astype(np.float32)
    up = np.tile(np.array([[0, 1, 0]], np.float32), (len(points), 1))
    row = tile(np.arange(len(points)), cells)
    sky = solid.ambient(points, up, row, 8).reshape(cells, cells)
    lit = solid.light(points, studio.key.towards(heading), studio.key.radius, row, 6).reshape(cells, cells)
    from scipy.ndimage import map_coordinates, uniform_filter

    sky, lit = uniform_filter(sky, 4, mode="nearest"), uniform_filter(lit, 4, mode="nearest")
    fade = np.clip(1.15 - np.hypot(*np.meshgrid(grid, grid)), 0, 0.35) / 0.35
    left = 1 - fade * (1 - (0.35 + 0.65 * sky**1.5) * (0.62 + 0.38 * lit))
    where = ((at - middle) / half + 1) / 2 * cells - 0.5
    inside = (np.abs(where - cells / 2) < cells / 2).all(axis=1)
    dark[seen[inside]] = map_coordinates(left, where[inside].T[::-1], order=1, mode="nearest")
    return dark


def _backdrop(camera: Camera, size: tuple[int, int], studio: Studio) -> Single:
    """Paper roll behind the subject: bright behind it, darker towards the edges, linear (height * width, 3)."""
    width, height = size
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    dx, dy = (x + 0.5) / width * 2 - 1, (y + 0.5) / height * 2 - 1
    r = np.sqrt((dx * 0.75) ** 2 + ((dy + 0.15) * 0.8) ** 2)
    t = np.clip(r / 1.15, 0, 1)
    t = (t * t * (3 - 2 * t)).reshape(-1, 1)
    center, edge = np.asarray(studio.center, np.float32), np.asarray(studio.edge, np.float32)
    return to_linear(center + (edge - center) * t)


def _dither(width: int, height: int) -> Single:
    """Noise of half a level, the same every time, that keeps the soft backdrop from banding."""
    y, x = np.mgrid[0:height, 0:width]
    noise = (52.9829189 * ((0.06711056 * x + 0.00583715 * y) % 1)) % 1  # Jimenez's interleaved gradient noise
    return (noise - 0.5).astype(np.float32).reshape(-1)
