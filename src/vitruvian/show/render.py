"""Surfaces, a camera and a studio become pixels.

Primary visibility at every sub-pixel; soft key shadow and ambient occlusion once per pixel and surface, from sixteen
complementary sets of directions that an edge-aware 4 x 4 mean puts together. The samples of a pixel that lie on one
smooth surface are shaded once, as their mean; on the others sample by sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.errors import VitruvianError
from vitruvian.show.backdrop import dither, paper, shadow
from vitruvian.show.camera import Camera
from vitruvian.show.refine import refined
from vitruvian.show.shade import Samples, Studio, dot, shade, to_srgb
from vitruvian.show.surfaces import Soup, Surface, unit
from vitruvian.show.trace import Hits, Single, Tracer, tile, tracer

Pixels = NDArray[np.uint8]
LAYERS = 6  # that holes of pictures may let through one another
CALM = 0.995  # length of the mean of a pixel's normals above which they count as one


def _offsets(samples: int) -> list[tuple[float, float]]:
    """Sub-pixel positions: a rotated grid."""
    side = round(samples**0.5) if 1 <= samples <= 64 else 0
    if side < 1 or side * side != samples:
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
    size = whole(size)
    if not surfaces or not any(len(s.triangles) for s in surfaces):
        raise VitruvianError("picture: there is nothing to see, expected at least one triangle")
    surfaces = [refined(s, camera, size) for s in surfaces]
    points = np.concatenate([s.vertices for s in surfaces])
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2  # rays are float32: everything is near the origin
    soup = Soup(surfaces, middle)
    camera = camera.moved(-middle)
    back = camera.axes()[2]
    heading = float(np.degrees(np.arctan2(back[0], back[2])))
    opaque = soup.opacity[soup.part] > 0.999
    if soup.textures is not None:
        opaque &= ~soup.textures.clear
    solid = tracer(soup.vertices, soup.triangles[opaque], tracing)
    shot = Shot(
        soup, solid, camera, size, studio or Studio(), heading, float(np.linalg.norm(high - low)), samples, quality
    )
    shot.take(np.flatnonzero(opaque), np.flatnonzero(~opaque), tracing)
    color, cover = shot.color, shot.cover
    dark = np.ones(len(cover), np.float32)
    if floor is not None:
        level = float(floor - middle[1])
        dark = shadow(solid, soup.vertices, camera, size, shot.studio, heading, level, shot.reach)
    if transparent:
        alpha = cover + (1 - cover) * (1 - dark)
        rgb = to_srgb(color / np.maximum(alpha, 1e-6)[:, None])
        out = np.concatenate([rgb, alpha[:, None]], -1)
    else:
        scene = paper(size, shot.studio) * dark[:, None]
        out = to_srgb(color + scene * (1 - cover)[:, None])
        out += dither(*size)[:, None] / 255
    return (np.clip(out, 0, 1) * 255 + 0.5).astype(np.uint8).reshape(size[1], size[0], -1)


@dataclass(eq=False)
class Shot:
    """One exposure: what is needed to shade, and the film it falls on (`color` linear, premultiplied; `cover`)."""

    soup: Soup
    solid: Tracer
    camera: Camera
    size: tuple[int, int]
    studio: Studio
    heading: float
    reach: float
    samples: int
    quality: int

    def __post_init__(self) -> None:
        self.count = self.size[0] * self.size[1]
        away = float(np.linalg.norm(self.camera.eye))
        self.pixel = 2 * away * float(np.tan(self.camera.fov / 2)) / self.size[1]  # metres, at the subject
        self.color = np.zeros((self.count, 3), np.float32)
        self.cover = np.zeros(self.count, np.float32)

    def take(self, opaque: NDArray, glass: NDArray, tracing: str) -> None:
        """Trace and shade; see-through triangles (one layer, of pictures with holes several) go over the solid ones."""
        offsets, soup = _offsets(self.samples), self.soup
        hits = self._trace(self.solid, offsets, opaque)
        left = np.ones(self.count * self.samples, np.float32)  # what the layers so far let through
        if glass.size:
            rays = tracer(soup.vertices, soup.triangles[glass], tracing)
            far = np.full(len(left), np.inf, np.float32)
            far[hits.pixel] = hits.depth
            beyond: Single | None = None
            for _ in range(LAYERS if soup.textures is not None and soup.textures.clear.any() else 1):
                panes = self._trace(rays, offsets, glass, beyond)
                panes = panes[panes.depth < far[panes.pixel]]
                tint = self._tint(panes)
                opacity = soup.opacity[soup.part[panes.triangle]] * (1 if tint is None else tint[:, 3])
                self._lay(panes, opacity * left[panes.pixel] / np.float32(self.samples), tint)
                left[panes.pixel] *= 1 - opacity
                beyond = np.full(len(left), np.inf, np.float32)
                beyond[panes.pixel] = np.where(left[panes.pixel] > 0.004, panes.depth, np.inf)
                if not np.isfinite(beyond).any():
                    break
        self._lay(hits, left[hits.pixel] / np.float32(self.samples), self._tint(hits))

    def _trace(
        self, rays: Tracer, offsets: list[tuple[float, float]], names: NDArray, beyond: Single | None = None
    ) -> Hits:
        """All samples of the picture in one list; `pixel` counts on through the sub-pixel patterns, and so do the depths
        `beyond` that a hit has to be."""
        parts = []
        for i, offset in enumerate(offsets):
            start = None if beyond is None else beyond[i * self.count : (i + 1) * self.count]
            h = rays.visible(self.camera, self.size, offset, start)
            parts.append(Hits(h.pixel + i * self.count, names[h.triangle].astype(np.int32), h.u, h.v, h.depth))
        return Hits.join(parts)

    def _tint(self, hits: Hits) -> Single | None:
        """Colour and alpha (n,4) of the pictures at the hits, None when there are none."""
        textures = self.soup.textures
        if textures is None or not textures.pictured[hits.triangle].any():
            return None
        way = _mixed(self.soup.corners[:, :, :3], hits) - np.asarray(self.camera.eye, np.float32)
        slant = np.abs(dot(unit(way), self.soup.faces[hits.triangle]))
        sample = 2 * float(np.tan(self.camera.fov / 2)) / self.size[1] / self.samples**0.5  # metres at one metre
        return textures.colors(hits.triangle, hits.u, hits.v, hits.depth * sample / np.sqrt(np.maximum(slant, 0.05)))

    def _lay(self, hits: Hits, share: Single, tint: Single | None = None) -> None:
        """Shade samples and add them to the picture; `tint` (n,4) multiplies their colours."""
        if not len(hits.pixel):
            return
        soup = self.soup
        part = soup.part[hits.triangle]
        order = np.argsort((hits.pixel % self.count) * len(soup.parts) + part, kind="stable")
        hits, share, part = hits[order], share[order], part[order]
        pixel = hits.pixel % self.count
        # samples of one pixel on one surface make a group
        fresh = (np.diff(pixel, prepend=-1) != 0) | (np.diff(part, prepend=-1) != 0)
        fresh |= np.abs(np.diff(hits.depth, prepend=0)) > 8 * self.pixel
        first = np.flatnonzero(fresh)
        counts = np.diff(first, append=len(pixel))
        group = np.repeat(np.arange(len(first)), counts)
        eye = np.asarray(self.camera.eye, np.float32)
        # surfaces seen from behind are lit from behind; a plane has one side towards the eye
        behind = dot(soup.faces, eye - soup.corners[:, 0, :3]) < 0
        away = behind[hits.triangle]
        shades = _mixed(soup.corners[:, :, 3:9], hits)  # normal and colour, of all samples
        if tint is not None:
            shades[:, 3:] *= tint[order, :3]
        shades[:, :3] = unit(shades[:, :3]) * np.where(away, -1, 1).astype(np.float32)[:, None]
        # where the surface is smooth, one sample stands for its group: with the mean normal and colour
        mean = np.add.reduceat(shades, first, axis=0) / counts[:, None].astype(np.float32)
        calm = dot(mean[:, :3], mean[:, :3]) > CALM**2

        places = _mixed(soup.corners[:, :, :3], hits[first])
        start = _above(places, soup.corners[hits.triangle[first]], hits.u[first], hits.v[first], away[first])
        start += np.where(away[first], -1, 1)[:, None] * soup.faces[hits.triangle[first]] * (1.5e-4 * self.reach)
        sky, lit = self._light(start.astype(np.float32), shades[first, :3], pixel[first])

        one, busy = np.flatnonzero(calm), np.flatnonzero(~calm[group])
        owner = np.concatenate([one, group[busy]])
        which = np.concatenate([first[one], busy])
        shades = np.concatenate([mean[one], shades[busy]])
        share = np.concatenate([np.add.reduceat(share, first)[one], share[busy]])
        hits, part = hits[which], part[which]
        normal, albedo = unit(shades[:, :3]), shades[:, 3:]
        point, soft, rest = (_mixed(soup.corners[:, :, i : i + 3], hits) for i in (0, 9, 12))
        soft = unit(soft) * np.where(away[which], -1, 1).astype(np.float32)[:, None]
        view = unit(eye - point)
        lack = np.minimum(dot(normal, view) - 0.02, 0)  # grazing smooth normals are bent back into view
        normal = unit(normal - lack[:, None] * view)
        pictured = np.zeros(len(part), bool) if tint is None else soup.textures.pictured[hits.triangle]  # type: ignore
        s = Samples(
            normal, soft, view, albedo, point - soup.crowns[part], rest, soup.kind[part], soup.roughness[part],
            soup.metallic[part], sky[owner], lit[owner], pictured,
        )  # fmt: skip
        light = shade(s, self.studio, self.heading, self.pixel) * share[:, None]
        where = pixel[first[owner]]
        for i in range(3):
            self.color[:, i] += np.bincount(where, light[:, i], minlength=self.count).astype(np.float32)
        self.cover += np.bincount(where, share, minlength=self.count).astype(np.float32)

    def _light(self, start: Single, normal: Single, pixel: NDArray) -> tuple[Single, Single]:
        """Open sky and key light (n,) at points just above the surface; `pixel` (n,) does not decrease."""
        row = tile(pixel, self.size[0])
        key = self.studio.key.towards(self.heading)
        both = np.zeros((len(pixel), 2), np.float32)
        both[:, 0] = self.solid.ambient(start, normal, row, self.quality)
        facing = np.flatnonzero(dot(normal, key) > -0.35)
        both[facing, 1] = self.solid.light(start[facing], key, self.studio.key.radius, row[facing], self.quality)
        place = np.full(self.count, -1, np.int32)
        place[pixel] = np.arange(len(pixel), dtype=np.int32)  # where a pixel shows several surfaces, the last
        thick = float(np.clip(4 * self.pixel, 1e-4 * self.reach, 4e-3 * self.reach))
        both = _smooth(both, place.reshape(self.size[::-1]), pixel, start, normal, thick)
        return both[:, 0], both[:, 1]


def _mixed(corners: Single, hits: Hits) -> Single:
    """Values (n,k) at the hits of values (T,3,k) at the corners of all triangles."""
    c = corners[hits.triangle]
    out = c[:, 0] * (1 - hits.u - hits.v)[:, None]
    out += c[:, 1] * hits.u[:, None]
    out += c[:, 2] * hits.v[:, None]
    return out


def _above(point: Single, corners: Single, u: Single, v: Single, away: NDArray) -> Single:
    """Points lifted to the smooth surface that the normals describe, against faceted edges of shadows.

    Source: Hanika, Hacking the Shadow Terminator, Ray Tracing Gems II, 2021.
    """
    lifted = point.copy()
    sign = np.where(away, np.float32(-1), np.float32(1))
    for i, share in enumerate((1 - u - v, u, v)):
        normal = corners[:, i, 3:6]
        depth = np.minimum(dot(point - corners[:, i, :3], normal) * sign, 0) * sign
        lifted -= (share * depth)[:, None] * normal
    return lifted


def _smooth(value: Single, place: NDArray, pixel: NDArray, point: Single, normal: Single, thick: float) -> Single:
    """Mean of value (n,k) over the 4 x 4 block of pixels round each that lie on the same surface.

    place (height, width): which of the n each pixel is, or -1.
    """
    height, width = place.shape
    around = np.full((height + 3, width + 3), -1, np.int32)
    around[2:-1, 2:-1] = place
    around = around.reshape(-1)
    at = (pixel // width) * (width + 3) + pixel % width
    level = dot(point, normal)
    both = np.concatenate([point, normal, value], -1)
    own = np.arange(len(value))
    total, weight = value.copy(), np.ones(len(value), np.float32)
    for dy in range(4):
        for dx in range(4):
            j = around[at + dy * (width + 3) + dx]
            other = both[j]
            apart = np.abs(dot(other[:, :3], normal) - level)
            good = (j >= 0) & (j != own) & (apart < thick) & (dot(other[:, 3:6], normal) > 0.75)
            w = good.astype(np.float32)
            total += other[:, 6:] * w[:, None]
            weight += w
    return total / weight[:, None]
