"""Headless pictures of people and things, in a studio: PNG by name of view, contact sheets.

No display, no OpenGL: Intel Embree through `embreex`, NumPy when that is missing.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.errors import VitruvianError
from vitruvian.formats.atomic import atomic
from vitruvian.show.camera import Camera, direction, fit, stand
from vitruvian.show.figure import Figure, Thing
from vitruvian.show.render import Pixels, render, whole
from vitruvian.show.shade import Studio
from vitruvian.show.surfaces import Surface

_ENDINGS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".webp": "WEBP"}


def picture(
    thing: Thing,
    path: str | os.PathLike[str],
    *,
    view: str | Camera = "three-quarter",
    views: Sequence[str | Camera] | None = None,
    time: float | Sequence[float] = 0.0,
    size: tuple[int, int] = (720, 960),
    samples: int = 4,
    transparent: bool = False,
    studio: Studio | None = None,
    tracing: str = "auto",
) -> Pixels:
    """Photograph a Clip, Humanoid, Body, Mesh or Motion; write PNG, JPEG or WebP by the ending of `path`.

    view: "front", "side", "back", "three-quarter", "face", "hands", the name of a Site that ends in `_view`, or a
    `Camera`. time: seconds into the motion. Several `views` (across) or times (down) make a contact sheet; size is that
    of one picture. samples: 1, 4, 9 or 16 per pixel. Returns the pixels (H,W,3|4) uint8 sRGB as written.
    Raises `VitruvianError` for an unknown view or ending, or when there is nothing to see.
    """
    ending = os.path.splitext(os.fspath(path))[1].lower()
    if ending not in _ENDINGS:
        raise VitruvianError(f"{path}: expected a name that ends in {', '.join(_ENDINGS)}, found {ending!r}")
    if transparent and _ENDINGS[ending] == "JPEG":
        raise VitruvianError(f"{path}: JPEG can't be transparent, use .png or .webp")
    size = whole(size)
    figure = Figure(thing)
    times = [float(t) for t in np.atleast_1d(np.asarray(time, np.float64))]
    rows = []
    for t in times:
        surface = next(iter(figure.at([t])))
        across = [
            photograph(
                figure, surface, v, t, size, samples=samples, transparent=transparent, studio=studio, tracing=tracing
            )
            for v in (views or [view])
        ]
        rows.append(np.concatenate(across, axis=1))
    pixels = np.concatenate(rows, axis=0)
    from PIL import Image

    with atomic(path) as temporary:
        Image.fromarray(pixels).save(temporary, format=_ENDINGS[ending], **_settings(_ENDINGS[ending]))
    return pixels


def _settings(kind: str) -> dict[str, Any]:
    kinds: dict[str, dict[str, Any]] = {
        "PNG": {"compress_level": 6},
        "JPEG": {"quality": 92},
        "WEBP": {"quality": 92},
    }
    return kinds[kind]


def photograph(
    figure: Figure,
    surface: Surface,
    view: str | Camera,
    time: float,
    size: tuple[int, int],
    *,
    samples: int = 4,
    transparent: bool = False,
    studio: Studio | None = None,
    tracing: str = "auto",
) -> Pixels:
    """One view of a figure whose surface at that time is given. "hands" is two pictures side by side: right, left."""
    cameras = aim(figure, surface, view, time, size)
    each = (size[0] // len(cameras), size[1])
    ground = floor_of(figure, surface)
    pixels = [
        render(
            [surface], c, each, samples=samples, studio=studio, transparent=transparent, floor=ground, tracing=tracing
        )
        for c in cameras
    ]
    return np.concatenate(pixels, axis=1)


def aim(figure: Figure, surface: Surface, view: str | Camera, time: float, size: tuple[int, int]) -> list[Camera]:
    """The camera of a view, or the two of "hands"."""
    if isinstance(view, Camera):
        return [view]
    places = figure.places(surface, time)
    heading = figure.heading(time)
    if view == "hands":
        hands = [places[k] for k in ("hands-r", "hands-l") if k in places]
        if not hands:
            raise VitruvianError("view hands: this figure has no hands; use front, side, back or three-quarter")
        each = (size[0] // len(hands), size[1])
        signs = [-1.0, 1.0] if len(hands) == 2 else [1.0 if "hands-l" in places else -1.0]
        return [
            fit(p, direction(sign * 52.0 + heading, 12.0), each, fov=float(np.radians(18.0)), margin=0.12)
            for p, sign in zip(hands, signs)
        ]
    return [stand(_drawn(surface), view, size, places=places, heading=heading)]


def _drawn(surface: Surface) -> NDArray[np.float64]:
    """The vertices that belong to a triangle."""
    used = np.zeros(len(surface.vertices), bool)
    used[surface.triangles] = True
    return surface.vertices[used]


def floor_of(figure: Figure, surface: Surface) -> float:
    """Height of the floor: 0 when the figure stands near it, else its lowest point."""
    points = _drawn(surface)
    if not len(points):
        return 0.0
    low, tall = float(points[:, 1].min()), float(np.ptp(points[:, 1]))
    if figure.mesh is None and -0.06 * tall < low < 0.8 * tall:
        return min(0.0, low) if low > -0.005 * tall else low
    return low
