"""Fit maps as the page and pictures show them: the dressed body, its garment coloured by strain, pressure or ease.

Colours are those of distance maps, see `vitruvian.show.heat`: red where cloth is stretched, presses or lies near, blue
where it is pushed together, nearly white where there is nothing to say, grey where there is no cloth.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vitruvian.body.types import Floats, Ints
from vitruvian.cloth.fit_map import PRESSED, FitMap
from vitruvian.cloth.layers import NAMES
from vitruvian.errors import VitruvianError
from vitruvian.show.heat import HOLE, drawn, ramp
from vitruvian.show.surfaces import Surface
from vitruvian.stage.clip import Mesh

if TYPE_CHECKING:
    from vitruvian.show.render import Pixels

SKIN = 0.93  # of the body in pictures, so that cloth stands out from it
ENDS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)  # of colour bars
KINDS = ((0.27, 0.45, 0.72), (0.36, 0.66, 0.42), (0.86, 0.42, 0.32))  # tight, loose, floating
_INK, _FAINT, _PAPER = (38, 40, 44), (104, 107, 112), (250, 249, 247)


@dataclass(frozen=True, eq=False)
class Layer:
    """One thing to be seen: values (V,), NaN where there is no cloth, from `low` to `high` at the ends of its bar, and the
    figures of the whole and of each region, (name, mean, p99, max). names: of the values 0, 1, ... where they are kinds."""

    name: str
    unit: str
    values: Floats
    low: float
    high: float
    ramp: Floats
    rows: tuple[tuple[str, float, float, float], ...]
    names: tuple[str, ...] = ()

    def told(self) -> dict[str, Any]:
        """What pages hear of it beside the values."""
        return {
            "name": self.name, "unit": self.unit, "low": self.low, "reach": self.high,
            "ramp": np.round(self.ramp, 4).tolist(), "rows": [list(r) for r in self.rows], "kinds": list(self.names),
        }  # fmt: skip

    def colors(self, hole: tuple[float, float, float] = HOLE) -> Floats:
        """(V,3) sRGB."""
        at = np.clip((np.nan_to_num(self.values) - self.low) / (self.high - self.low), 0, 1) * (len(self.ramp) - 1)
        out = np.stack([np.interp(at, np.arange(len(self.ramp)), self.ramp[:, i]) for i in range(3)], -1)
        out[np.isnan(self.values)] = hole
        return out


@dataclass(frozen=True, eq=False)
class FitView:
    """A dressed body and what is known of the fit: `thing` body and garment, metres, as draped; `findings` in words."""

    thing: Mesh
    layers: tuple[Layer, ...]
    name: str
    findings: tuple[str, ...] = ()

    def values(self) -> list[Floats]:
        """(V,) of each layer."""
        return [layer.values for layer in self.layers]

    def told(self) -> dict[str, Any]:
        """What pages hear of it: that of the first layer, and all of them."""
        first = self.layers[0].told()
        told = {"layers": [layer.told() for layer in self.layers], "findings": list(self.findings)}
        return {**first, "hole": list(HOLE), "against": "skin", "numbers": {"parts": {}}, **told}


def fit_view(
    found: FitMap,
    skin: Floats,
    skin_triangles: Ints,
    vertices: Floats,
    *,
    name: str = "garment",
    kinds: Ints | None = None,
) -> FitView:
    """The view of a fit: the body, skin (V,3) with its triangles (t,3), and the garment's vertices (n,3), metres; kinds
    (n,): their layers, see `vitruvian.cloth.layers`."""
    points = np.concatenate([skin, vertices])
    triangles = np.concatenate([skin_triangles, found.triangles + len(skin)]).astype(np.int32)
    summary, layers = found.summary(), []
    warm = ramp()[len(ramp()) // 2 :]
    plans = (
        ("strain", "%", 100 * found.of_vertices("strain"), "strain_percent", 5.0),
        ("pressure", "kPa", found.pressure / 1000, "pressure_kpa", 0.1),
        ("ease", "mm", 1000 * found.ease, "ease_mm", 20.0),
    )
    for title, unit, values, key, least in plans:
        p99 = float(np.quantile(np.abs(values), 0.99)) if len(values) else 0.0
        high = next((e for e in ENDS if e >= max(p99, least)), ENDS[-1])
        if title == "pressure":
            high = min(high, PRESSED / 500)
        whole = np.concatenate([np.full(len(skin), np.nan), values])
        low, colours = (-high, ramp()) if title == "strain" else (0.0, warm[::-1] if title == "ease" else warm)
        rows = [(n, s[key]["mean"], s[key]["p99"], s[key]["max"]) for n, s in summary["regions"].items()]
        total = summary["all"][key]
        layers.append(
            Layer(title, unit, whole, low, high, colours, (("all", total["mean"], total["p99"], total["max"]), *rows))
        )
    if kinds is not None:
        whole = np.concatenate([np.full(len(skin), np.nan), kinds])
        layers.append(Layer("layers", "", whole, 0.0, len(NAMES) - 1.0, np.array(KINDS), (), NAMES))
    return FitView(Mesh(points, triangles, name=name), tuple(layers), name, tuple(summary["findings"]))


def sheet(view: FitView, path: str | os.PathLike[str], *, height: int = 460) -> Pixels:
    """Write a picture: strain, pressure and ease from the front and from behind, each with its bar, and what is too tight.
    Returns its pixels (H,W,3). Raises VitruvianError for another ending than .png."""
    from PIL import Image

    from vitruvian.formats.atomic import atomic
    from vitruvian.show.figure import Figure
    from vitruvian.show.picture import aim

    if os.path.splitext(os.fspath(path))[1].lower() != ".png":
        raise VitruvianError(f"{path}: expected a name that ends in .png")
    figure = Figure(view.thing)
    surface: Surface = next(iter(figure.at([0.0])))
    worn = surface.vertices[~np.isnan(view.layers[0].values)]
    box = np.ptp(worn, axis=0)
    size = (int(np.clip(1.1 * height * box[0] / max(box[1], 1e-9), 0.5 * height, 1.2 * height)), height)
    shown = _around(surface, worn)
    columns = []
    for layer in view.layers:
        paint = layer.colors((SKIN, SKIN, SKIN))
        both = [drawn(surface, paint, aim(figure, shown, v, 0.0, size)[0], size) for v in ("front", "back")]
        columns.append(np.concatenate([*both, _bar(layer, size[0])], axis=0))
    pixels = np.concatenate(columns, axis=1)
    pixels = np.concatenate([pixels, _words(view, pixels.shape[1])], axis=0)
    with atomic(path) as temporary:
        Image.fromarray(pixels).save(temporary, format="PNG", compress_level=6)
    return pixels


def _around(surface: Surface, worn: Floats) -> Surface:
    """The surface, its points moved into the box of what is worn and a little more, for cameras to look at."""
    from dataclasses import replace

    low, high = worn.min(axis=0), worn.max(axis=0)
    more = 0.06 * (high - low)
    return replace(surface, vertices=np.clip(surface.vertices, low - more, high + more))


def _bar(layer: Layer, width: int) -> Pixels:
    """Its colours with numbers and unit."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.new("RGB", (width, 74), _PAPER)
    draw = ImageDraw.Draw(image)
    left, right = int(0.16 * width), int(0.84 * width)
    at = np.linspace(0, len(layer.ramp) - 1, right - left)
    if layer.names:
        at = np.minimum(np.floor(np.linspace(0, len(layer.ramp), right - left)), len(layer.ramp) - 1)
    inks = np.stack([np.interp(at, np.arange(len(layer.ramp)), layer.ramp[:, i]) for i in range(3)], -1)
    for x, ink in zip(range(left, right), (inks * 255 + 0.5).astype(int), strict=True):
        draw.line([(x, 26), (x, 40)], fill=tuple(int(c) for c in ink))
    draw.rectangle([left, 26, right, 40], outline=(150, 150, 150))
    font, big = ImageFont.load_default(13), ImageFont.load_default(15)
    title = f"{layer.name}, {layer.unit}" if layer.unit else layer.name
    draw.text(((left + right) / 2, 4), title, _INK, font=big, anchor="ma")
    for k, kind in enumerate(layer.names):
        draw.text((left + (k + 0.5) / len(layer.names) * (right - left), 47), kind, _INK, font=font, anchor="ma")
    for t in (0, 0.25, 0.5, 0.75, 1) if not layer.names else ():
        value = layer.low + t * (layer.high - layer.low)
        tick = left + t * (right - left)
        draw.line([(tick, 40), (tick, 45)], fill=_FAINT)
        draw.text((tick, 47), f"{value:.3g}", _INK, font=font, anchor="ma")
    return np.asarray(image)


def _words(view: FitView, width: int) -> Pixels:
    """What is too tight, a line each."""
    from PIL import Image, ImageDraw, ImageFont

    lines = list(view.findings[:8]) or ["nothing is too tight"]
    if len(view.findings) > 8:
        lines.append(f"and {len(view.findings) - 8} more")
    image = Image.new("RGB", (width, 16 + 21 * len(lines)), _PAPER)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(14)
    for k, line in enumerate(lines):
        draw.text((24, 4 + 21 * k), line, _INK, font=font)
    return np.asarray(image)
