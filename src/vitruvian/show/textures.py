"""Pictures on surfaces as pixels: decoded within bounds, looked up with filters, packed for the page.

Texture coordinates count from the lower left corner of a picture, as X3D's do; readers turn those of other formats.
Filters: bilinear within a level, and between two levels of a pyramid of halved pictures (Williams, Pyramidal
Parametrics, SIGGRAPH 1983); levels are averaged in linear light, with colours weighted by their alpha.
"""

from __future__ import annotations

import hashlib
import io
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Part
from vitruvian.errors import warn
from vitruvian.formats.pictures import content, size_of

if TYPE_CHECKING:
    from PIL.Image import Image

    from vitruvian.hanim.humanoid import Picture

Single = NDArray[np.floating]  # float32 where it is large
Pixels = NDArray[np.uint8]
MAX_PIXELS = 1 << 26  # of a picture that is opened at all
SIDE = 4096  # pixels of the page's pictures; larger ones are made smaller
DRAWN = 2048  # the same of pictures drawn here
MAX_SENT = 1 << 27  # pixels of all pictures that go to a page
MAX_BYTES = 1 << 27  # of the same
MAX_COUNT = 256  # and how many
MAX_KEPT = 1 << 29  # bytes of pyramids that are kept for the next frame
SOLID = 250  # alpha from which nothing shines through
HALF = 128  # alpha from which a cut-out is there


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture and its halved copies, (h,w,4) uint8 sRGB and straight alpha, first row at the top; `repeat` in u and v."""

    levels: tuple[Pixels, ...]
    repeat: tuple[bool, bool]
    clear: bool  # whether any pixel lets something shine through

    def colors(self, uv: Single, level: Single) -> Single:
        """Linear RGB and alpha (n,4) at texture coordinates (n,2); `level` (n,): log2 of pixels of the picture between
        neighbouring samples, negative where the picture is magnified."""
        level = np.clip(level, 0, len(self.levels) - 1)
        whole = np.minimum(level.astype(np.int32), max(len(self.levels) - 2, 0))
        part = (level - whole).astype(np.float32)[:, None]
        out = np.empty((len(uv), 4), np.float32)
        for k in np.unique(whole):
            some = np.flatnonzero(whole == k)
            near = _bilinear(self.levels[k], uv[some], self.repeat)
            if part[some].any():
                far = _bilinear(self.levels[min(k + 1, len(self.levels) - 1)], uv[some], self.repeat)
                near += (far - near) * part[some]
            out[some] = near
        out[:, :3] /= np.maximum(out[:, 3:], 1e-6)
        return out


def _bilinear(pixels: Pixels, uv: Single, repeat: tuple[bool, bool]) -> Single:
    """Linear premultiplied RGB and alpha (n,4): the four pixels round each place, weighted."""
    height, width = pixels.shape[:2]
    at = []
    for value, n, again in ((uv[:, 0], width, repeat[0]), (1 - uv[:, 1], height, repeat[1])):
        value = np.asarray(value, np.float64)
        value = np.where(np.isfinite(value), value, 0.0)
        x = (value - np.floor(value) if again else np.clip(value, 0, 1)) * n - 0.5
        low = np.floor(x).astype(np.int64)
        both = [low, low + 1]
        both = [i % n for i in both] if again else [np.clip(i, 0, n - 1) for i in both]
        at.append((*both, (x - low).astype(np.float32)[:, None]))
    (x0, x1, fx), (y0, y1, fy) = at
    top = _light(pixels[y0, x0]) * (1 - fx) + _light(pixels[y0, x1]) * fx
    return top * (1 - fy) + (_light(pixels[y1, x0]) * (1 - fx) + _light(pixels[y1, x1]) * fx) * fy


@cache
def _curve() -> Single:
    from vitruvian.show.shade import to_linear

    return to_linear(np.arange(256) / 255)


def _light(pixels: Pixels) -> Single:
    """sRGB bytes (...,4) as linear light times alpha, and alpha."""
    out = np.empty(pixels.shape, np.float32)
    out[..., 3] = pixels[..., 3] * np.float32(1 / 255)
    out[..., :3] = _curve()[pixels[..., :3]] * out[..., 3:]
    return out


def _pyramid(pixels: Pixels) -> tuple[Pixels, ...]:
    """The picture and its halves down to one pixel; odd sides lose their last row or column to the one before."""
    from vitruvian.show.shade import to_srgb

    levels = [pixels]
    light = _light(pixels)
    while max(light.shape[:2]) > 1:
        for axis in (0, 1):
            n = light.shape[axis]
            if n > 1:
                even = np.take(light, range(0, n - n % 2, 2), axis)
                odd = np.take(light, range(1, n, 2), axis)
                light = (even + odd) / 2
        alpha = light[..., 3:]
        straight = to_srgb(light[..., :3] / np.maximum(alpha, 1e-6))
        levels.append((np.concatenate([straight, alpha], -1) * 255 + 0.5).astype(np.uint8))
    return tuple(levels)


def opened(data: bytes, side: int) -> Image | None:
    """The pixels of a PNG or JPEG, sides at most `side`, mode RGB or RGBA, as they are stored: no profile, no turn by
    metadata. None when it is damaged or has more than `MAX_PIXELS`."""
    from PIL import Image

    size = size_of(data)
    if size is None or size[0] * size[1] > MAX_PIXELS:
        return None
    try:
        with Image.open(io.BytesIO(data), formats=("PNG", "JPEG")) as image:
            if image.size != size:
                return None
            if image.format == "JPEG":
                image.draft("RGB", (side, side))
            image.load()
            return _small(_plain(image), side)
    except (OSError, ValueError, SyntaxError, EOFError, Image.DecompressionBombError):  # what Pillow says of bad data
        return None


def _plain(image: Image) -> Image:
    """RGB, or RGBA where something may be transparent, eight bits each."""
    from PIL import Image as pillow

    if image.mode.startswith("I"):  # sixteen bits of grey
        image = pillow.fromarray((np.asarray(image).astype(np.int64).clip(0, 65535) >> 8).astype(np.uint8))
    clear = image.mode in ("LA", "PA", "RGBA", "La", "RGBa") or "transparency" in image.info
    return image.convert("RGBA" if clear else "RGB")


def _small(image: Image, side: int) -> Image:
    from PIL import Image as pillow

    if max(image.size) <= side:
        return image
    scale = side / max(image.size)
    width, height = (max(1, round(n * scale)) for n in image.size)
    return image.resize((width, height), pillow.Resampling.BOX)


_known: OrderedDict[Picture, Texture | None] = OrderedDict()


def texture(picture: Picture) -> Texture | None:
    """A picture as it is drawn here; None, with one warning, when it is not at hand or can't be read."""
    if picture in _known:
        _known.move_to_end(picture)
        return _known[picture]
    found = content(picture)
    image = opened(found[0], DRAWN) if found else None
    made = None
    if image is None:
        _miss(picture, bool(found))
    else:
        pixels = np.asarray(image.convert("RGBA"))
        made = Texture(_pyramid(pixels), picture.repeat, bool(pixels[..., 3].min() < SOLID))
    _known[picture] = made
    kept = lambda t: sum(p.nbytes for p in t.levels) if t else 0  # noqa: E731
    while len(_known) > 1 and sum(map(kept, _known.values())) > MAX_KEPT:
        _known.popitem(last=False)
    return made


def _miss(picture: Picture, found: bool) -> None:
    name = " ".join((picture.urls[0] if picture.urls else picture.name or "a picture")[:80].split())
    why = "is damaged or has too many pixels" if found else "is not at hand, or no PNG or JPEG"
    warn(f"{name} {why}; the surface keeps its colour")


def drawn(parts: Sequence[Part]) -> list[Texture | None]:
    """The texture of each part."""
    return [None if p.picture is None else texture(p.picture) for p in parts]


class Sent:
    """Pictures on their way to pages: each once, however many surfaces it lies on, and within `MAX_SENT` pixels.

    `names` of `Picture`s, None for those that can't be sent; `data` by name: MIME type and bytes.
    """

    def __init__(self) -> None:
        self.names: dict[Picture, str | None] = {}
        self.data: dict[str, tuple[str, bytes]] = {}
        self.clear: dict[str, bool] = {}
        self.pixels = 0

    def part(self, p: Part) -> dict[str, Any]:
        """What the page is told about the picture of a part: `{"picture": {"name", "repeat", "alpha"}}`, or nothing."""
        if p.picture is None:
            return {}
        if p.picture not in self.names:
            self.names[p.picture] = self._add(p.picture)
        name = self.names[p.picture]
        if name is None:
            return {}
        alpha = p.picture.alpha if self.clear[name] else ""
        return {"picture": {"name": name, "repeat": list(p.picture.repeat), "alpha": alpha}}

    def _add(self, picture: Picture) -> str | None:
        found = content(picture)
        name = hashlib.sha256(found[0]).hexdigest()[:16] if found else ""
        if name in self.data:
            return name
        image = opened(found[0], SIDE) if found else None
        if image is None or not found:
            _miss(picture, bool(found))
            return None
        pixels = image.size[0] * image.size[1]
        # what is small enough goes as it is: browsers read what Pillow could read
        kept = size_of(found[0]) == image.size and b"Exif" not in found[0][:65536]
        mime, data = (found[1], found[0]) if kept else _packed(image)
        size = sum(len(d) for _, d in self.data.values()) + len(data)
        if self.pixels + pixels > MAX_SENT or size > MAX_BYTES or len(self.data) >= MAX_COUNT:
            warn("the pictures are too many or too large for one page; some surfaces keep their colour")
            return None
        self.pixels += pixels
        self.data[name] = (mime, data)
        self.clear[name] = image.mode == "RGBA" and bool(np.asarray(image)[..., 3].min() < SOLID)
        return name


def _packed(image: Image) -> tuple[str, bytes]:
    out = io.BytesIO()
    if image.mode == "RGBA":
        image.save(out, "PNG", compress_level=6)
        return "image/png", out.getvalue()
    image.save(out, "JPEG", quality=92, subsampling=0)
    return "image/jpeg", out.getvalue()
