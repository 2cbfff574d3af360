"""Distance maps: a surface coloured by how far it is from another, as the page and pictures show it, and a sheet of them.

Colours are made in OKLab (B. Ottosson 2020): blue where the surface lies inside of the other, red where it stands out,
nearly white where both are one, lightness and chroma going evenly with the distance; grey where nothing is known.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats
from vitruvian.errors import VitruvianError
from vitruvian.modeling import shrink
from vitruvian.modeling.gaps import Gaps, gaps, metres
from vitruvian.show.camera import Camera
from vitruvian.show.figure import Figure, pose
from vitruvian.show.shade import KINDS, kind_of, to_linear, to_srgb
from vitruvian.show.surfaces import Surface, places, vertex_normals
from vitruvian.show.trace import tracer
from vitruvian.stage.clip import Clip, Mesh

if TYPE_CHECKING:
    from vitruvian.show.render import Pixels

STEPS = (0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0)  # mm at the ends of a colour bar
HOLE = (0.55, 0.55, 0.55)
LEFT_OUT = ("teeth", "tongue", "mouth", "gum")
_INK, _FAINT, _PAPER = (38, 40, 44), (104, 107, 112), (250, 249, 247)


@dataclass(frozen=True, eq=False)
class Heat:
    """A thing that is shown with its distances from another: `thing` and `other` as pages show them, in metres in one
    frame; `gaps` of the points of its skin; `reach` mm at the ends of the colour bar; what the two are called."""

    thing: Clip | Mesh
    other: Mesh
    gaps: Gaps
    reach: float
    surface: Surface
    name: str = "surface"
    against: str = "scan"

    def values(self) -> list[Floats]:
        """What its points are coloured by, in mm."""
        return [self.gaps.mm]

    def told(self) -> dict[str, Any]:
        """What pages hear of it beside the distances."""
        share, _ = self.gaps.histogram(self.reach)
        return {
            "reach": self.reach,
            "ramp": [[round(float(c), 4) for c in rgb] for rgb in ramp()],
            "hole": list(HOLE),
            "histogram": share.tolist(),
            "numbers": self.gaps.numbers(),
            "against": self.against,
        }


@cache
def ramp(count: int = 65) -> Floats:
    """(count,3) sRGB 0..1 from far inside over none to far outside."""
    t = np.linspace(-1, 1, count)
    size = np.abs(t)
    lightness = 0.95 - 0.5 * size
    chroma = np.where(t < 0, 0.15, 0.165) * size**0.9
    hue = np.radians(np.where(t < 0, 258.0, 27.0))
    a, b = chroma * np.cos(hue), chroma * np.sin(hue)
    cubed = [
        (lightness + k * a + m * b) ** 3
        for k, m in ((0.3963377774, 0.2158037573), (-0.1055613458, -0.0638541728), (-0.0894841775, -1.291485548))
    ]
    mix = np.array([[4.0767416621, -3.3077115913, 0.2309699292], [-1.2684380046, 2.6097574011, -0.3413193965],
                    [-0.0041960863, -0.7034186147, 1.707614701]])  # fmt: skip
    return np.asarray(to_srgb(np.clip(np.stack(cubed, -1) @ mix.T, 0, 1)), np.float64)


def colors(mm: Floats, reach: float) -> Floats:
    """(V,3) sRGB of signed distances (V,); grey where they are NaN."""
    table = ramp()
    at = (np.clip(np.nan_to_num(mm) / reach, -1, 1) + 1) / 2 * (len(table) - 1)
    out = np.stack([np.interp(at, np.arange(len(table)), table[:, i]) for i in range(3)], -1)
    out[np.isnan(mm)] = HOLE
    return out


def reach_of(found: Gaps) -> float:
    """The end of a colour bar that holds 95 % of what is known, a round number of mm."""
    p95 = found.numbers()["p95_mm"] or 0.0
    return next((s for s in STEPS if s >= p95), STEPS[-1])


def heat(
    thing: Clip | Mesh,
    other: Clip | Mesh,
    *,
    unit: str | None = None,
    reach: float | None = None,
    name: str = "surface",
    against: str = "scan",
) -> Heat:
    """Distances of a body, in the pose it is in, or of a mesh from another surface.

    `unit` of the other: None takes the one that brings both to one size. `reach`: mm at the ends of the colour bar; None:
    what 95 % need. Hair, eyes and the inside of the mouth are not looked at. Raises VitruvianError where one of them
    has no surface. Warns where they hardly meet.
    """
    mine, theirs = _surface(thing, name), _surface(other, against)
    factor = 1.0
    if isinstance(other, Mesh):
        theirs = replace(theirs, vertices=other.vertices)
        factor = metres(_size(theirs.vertices), _size(mine.vertices), unit)
    target, _ = shrink.surface_of(theirs.vertices * factor, theirs.triangles)
    place = places(mine.vertices)  # points at one place are one, so that seams have no normals of their own
    count = len(thing.body.skin.rest) if isinstance(thing, Clip) else len(mine.vertices)
    found = gaps(
        mine.vertices, _welded(mine, place), target, part=_parts(thing, len(mine.vertices)), counted=_seen(mine)
    )
    first = np.zeros(int(place.max()) + 1, np.int64)
    first[place[::-1]] = np.arange(len(place))[::-1]
    spread = found.mm[first[place]]
    found = replace(found, mm=np.where(np.isnan(found.mm), spread, found.mm))
    shown = Mesh(theirs.vertices * factor, theirs.triangles, name=against)
    skin = replace(found, mm=found.mm[:count], area=found.area[:count], part=found.part[:count])
    if isinstance(thing, Clip) and thing.motion is not None:  # the map is of one pose
        thing = replace(thing, motion=pose(thing.motion, [0.0]))
    still = thing if isinstance(thing, Clip) else Mesh(mine.vertices, mine.triangles, name=name)
    return Heat(still, shown, skin, reach or reach_of(skin), mine, name, against)


def _size(points: Floats) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0


def _surface(thing: Clip | Mesh, name: str) -> Surface:
    if isinstance(thing, Clip) and not len(thing.body.skin.triangles):
        raise VitruvianError(f"{name}: expected a surface to compare, found a body without skin")
    found = next(iter(Figure(thing).at([0.0])))
    if not len(found.triangles):
        raise VitruvianError(f"{name}: expected a surface to compare, found no triangles")
    return found


def _welded(s: Surface, place: NDArray[np.int64]) -> NDArray[np.int32]:
    """Triangles (T,3) by the first point at each place."""
    first = np.full(int(place.max()) + 1, len(place), np.int64)
    np.minimum.at(first, place, np.arange(len(place)))
    return first[place][s.triangles].astype(np.int32)


def _seen(s: Surface) -> NDArray[np.bool_]:
    """(T,) the triangles that a scan has, too."""
    out = np.ones(len(s.triangles), bool)
    for p in s.parts:
        away = KINDS[kind_of(p.name)] in ("hair", "eye") or any(w in p.name.lower() for w in LEFT_OUT)
        out[p.start : p.stop] = not away
    return out if out.any() else np.ones(len(out), bool)


def _parts(thing: Clip | Mesh, count: int) -> NDArray[np.str_] | None:
    """(count,) the part of the body that each point is of."""
    if not isinstance(thing, Clip):
        return None
    from vitruvian.modeling.mass import part_of

    joints = thing.humanoid.joints()
    part = part_of(joints)
    sided = {}
    for joint in joints:
        side = {"l_": "left ", "r_": "right "}.get(joint.name[:2], "")
        sided[joint.name] = part[joint.name] if part[joint.name] in ("trunk", "head") else side + part[joint.name]
    skin = thing.body.skin
    label = np.array([sided.get(n, "") for n in thing.body.skeleton.names] + [""])
    out = np.full(count, "", label.dtype)
    owner = np.where(skin.weights.counts > 0, skin.weights.top(1)[0][:, 0], -1)
    out[: len(owner)] = label[owner]
    return out


# Pictures --------------------------------------------------------------------------------------------------------------


def drawn(s: Surface, paint: Floats, camera: Camera, size: tuple[int, int], samples: int = 3) -> Pixels:
    """(H,W,3) uint8: a surface in colours (V,3) sRGB that match their bar, darker only towards its outline."""
    middle = (s.vertices.min(axis=0) + s.vertices.max(axis=0)) / 2
    points = (s.vertices - middle).astype(np.float32)
    camera = camera.moved(-middle)
    rays = tracer(points, s.triangles)
    normals = vertex_normals(s.vertices, s.triangles)
    linear = to_linear(paint).astype(np.float32)
    total = np.zeros((size[0] * size[1], 3))
    total += to_linear(np.array(_PAPER) / 255.0)
    offsets = [((i + 0.5) / samples, (j + 0.5) / samples) for i in range(samples) for j in range(samples)]
    back = total.copy()
    eye = np.asarray(camera.eye)
    for offset in offsets:
        h = rays.visible(camera, size, offset)
        share = np.stack([1 - h.u - h.v, h.u, h.v], -1)[..., None]
        corner = s.triangles[h.triangle]
        normal = (normals[corner] * share).sum(axis=1)
        toward = eye - (points[corner] * share).sum(axis=1)
        front = np.abs((normal * toward).sum(axis=1))
        front /= np.maximum(np.linalg.norm(normal, axis=1) * np.linalg.norm(toward, axis=1), 1e-9)
        t = np.clip(front / 0.62, 0, 1)
        shade = 0.42 + 0.58 * t * t * (3 - 2 * t)  # as the page's flat materials
        total[h.pixel] += ((linear[corner] * share).sum(axis=1) * shade[:, None] - back[h.pixel]) / len(offsets)
    return (np.clip(to_srgb(total), 0, 1) * 255 + 0.5).astype(np.uint8).reshape(size[1], size[0], 3)


def sheet(found: Heat, path: str | os.PathLike[str], *, view: str | None = None, height: int = 600) -> Pixels:
    """Write a picture of the map from the front and from behind (or one `view`), the colour bar with a histogram, and the
    figures of each part of the body. Returns its pixels (H,W,3). Raises VitruvianError for another ending than .png."""
    from PIL import Image

    from vitruvian.formats.atomic import atomic
    from vitruvian.show.picture import aim

    if os.path.splitext(os.fspath(path))[1].lower() != ".png":
        raise VitruvianError(f"{path}: expected a name that ends in .png")
    figure = Figure(found.thing)
    box = np.ptp(found.surface.vertices, axis=0)
    size = (int(np.clip(1.05 * height * box[0] / max(box[1], 1e-9), 0.5 * height, height)), height)
    mm = np.full(len(found.surface.vertices), np.nan)
    mm[: len(found.gaps.mm)] = found.gaps.mm
    paint = colors(mm, found.reach)
    views = [view] if view else ["front", "back"]
    columns = [drawn(found.surface, paint, aim(figure, found.surface, v, 0.0, size)[0], size) for v in views]
    table = _table(found.gaps.numbers(), found, size[1])
    top = np.concatenate([*columns, table], axis=1)
    pixels = np.concatenate([top, _bar(found, top.shape[1])], axis=0)
    with atomic(path) as temporary:
        Image.fromarray(pixels).save(temporary, format="PNG", compress_level=6)
    return pixels


def _table(numbers: Mapping[str, Any], found: Heat, height: int) -> Pixels:
    """The figures of the whole and of each part, in mm."""
    from PIL import Image, ImageDraw, ImageFont

    width, line = 372, 22
    image = Image.new("RGB", (width, height), _PAPER)
    draw = ImageDraw.Draw(image)
    big, plain, small = (ImageFont.load_default(n) for n in (17, 14, 12))
    draw.text((14, 18), _cut(f"{found.name} against {found.against}", big, width - 28), _INK, font=big)
    across = (150, 208, 266, 324)
    for x, text in zip(across, ("mean", "95 %", "max", "hole"), strict=True):
        draw.text((x + 36, 56), text, _FAINT, font=small, anchor="ra")
    back = numbers["back"]
    rows = [("all", numbers, _INK), *((n, r, _FAINT) for n, r in numbers["parts"].items())]
    rows.append((f"{found.against} to it", {**back, "holes": None}, _FAINT))
    y = 76
    for title, row, ink in rows[: (height - 110) // line]:
        draw.text((14, y), _cut(title, plain, 120), ink, font=plain)
        for x, key in zip(across, ("mean_mm", "p95_mm", "max_mm"), strict=False):
            text = "-" if row[key] is None else f"{row[key]:.2f}" if row[key] < 100 else f"{row[key]:.0f}"
            draw.text((x + 36, y), text, _INK, font=plain, anchor="ra")
        if row["holes"] is not None:
            draw.text((across[3] + 36, y), f"{row['holes']:.0%}", _INK, font=plain, anchor="ra")
        y += line
    draw.text((14, y + 8), "mm; by area, holes left out", _FAINT, font=small)
    return np.asarray(image)


def _cut(text: str, font: Any, width: int) -> str:
    while len(text) > 4 and font.getlength(text) > width:
        text = text[:-2].rstrip("\u2026") + "\u2026"
    return text


def _bar(found: Heat, width: int) -> Pixels:
    """The colour bar with its numbers, below a histogram of the area."""
    from PIL import Image, ImageDraw, ImageFont

    share, _ = found.gaps.histogram(found.reach)
    height, left, right, base = 150, 40, width - 150, 84
    image = Image.new("RGB", (width, height), _PAPER)
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(13)
    inks = (colors(np.linspace(-found.reach, found.reach, right - left), found.reach) * 255 + 0.5).astype(int)
    most = max(float(share.max()), 1e-9)
    for i, x in enumerate(range(left, right)):
        ink = tuple(int(c) for c in inks[i])
        draw.line([(x, base), (x, base + 16)], fill=ink)
        high = share[min(int(i / (right - left) * len(share)), len(share) - 1)] / most
        if high > 0:
            draw.line([(x, base - 4 - int(64 * high)), (x, base - 4)], fill=(176, 178, 182))
    draw.rectangle([left, base, right, base + 16], outline=(150, 150, 150))
    for t in (-1, -0.5, 0, 0.5, 1):
        at = left + (t + 1) / 2 * (right - left)
        draw.line([(at, base + 16), (at, base + 21)], fill=_FAINT)
        draw.text((at, base + 23), f"{t * found.reach:+.3g}" if t else "0", _INK, font=font, anchor="ma")
    middle = (left + right) / 2
    caption = f"mm; blue: inside of {found.against}, red: outside; grey bars: share of the area"
    draw.text((middle, base + 42), _cut(caption, font, right - left), _FAINT, font=font, anchor="ma")
    hole = tuple(round(255 * c) for c in HOLE)
    draw.rectangle([right + 30, base, right + 46, base + 16], fill=hole, outline=(150, 150, 150))
    draw.text((right + 54, base), "no answer", _INK, font=font)
    return np.asarray(image)
