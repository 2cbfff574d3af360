"""A pinhole camera, and where it stands for each named view.

World metres, Y up. A camera looks from `eye` to `target`; `fov` is the vertical opening in radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats
from vitruvian.errors import VitruvianError

VIEWS = ("front", "side", "back", "three-quarter", "face", "hands")
_AZIMUTH = {"front": 0.0, "three-quarter": 35.0, "side": 90.0, "back": 180.0}


@dataclass(frozen=True)
class Camera:
    """eye, target (3,) metres, fov radians (vertical), up (3,)."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    fov: float = float(np.radians(22.0))
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)

    def axes(self) -> Floats:
        """(3,3) rows: right, up, backward of the camera, unit, in world space."""
        back = np.subtract(self.eye, self.target).astype(np.float64)
        length = np.linalg.norm(back)
        if not np.isfinite(length) or length < 1e-9:
            raise VitruvianError("camera: expected an eye away from its target, found both at one place")
        back /= length
        right = np.cross(np.asarray(self.up, np.float64), back)
        if np.linalg.norm(right) < 1e-6:  # looking straight up or down
            right = np.cross([0.0, 0.0, -np.sign(back[1]) or 1.0], back)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(back, right), back])

    def rays(self, x: Floats, y: Floats, size: tuple[int, int]) -> Floats:
        """Directions (...,3) through pixel positions x, y (continuous, origin top left) of a (width, height) picture.

        Not normalised: the component along the viewing axis is 1, so that a ray parameter is a depth.
        """
        width, height = size
        half = np.tan(self.fov / 2)
        axes = self.axes()
        sx = (2 * np.asarray(x) / width - 1) * half * width / height
        sy = (1 - 2 * np.asarray(y) / height) * half
        return sx[..., None] * axes[0] + sy[..., None] * axes[1] - axes[2]

    def through(
        self, pixel: NDArray[np.int64] | None, offset: tuple[float, float], size: tuple[int, int]
    ) -> NDArray[np.float32]:
        """`rays` (n,3) float32 at `offset` in each of the pixels (n,), row-major indices; None for all."""
        corner, right, down = self.rays(np.array([0.0, 1, 0]), np.array([0.0, 0, 1]), size)  # affine in the pixel
        x = ((np.arange(size[0]) + offset[0])[:, None] * (right - corner)).astype(np.float32)
        y = ((np.arange(size[1]) + offset[1])[:, None] * (down - corner) + corner).astype(np.float32)
        if pixel is None:
            return (y[:, None] + x).reshape(-1, 3)
        row = pixel // size[0]
        return y[row] + x[pixel - row * size[0]]

    def project(self, points: NDArray[np.floating], size: tuple[int, int]) -> tuple[Floats, Floats]:
        """Pixel positions (...,2) and depths (...) along the viewing axis; positions behind the camera are NaN."""
        width, height = size
        local = (np.asarray(points, np.float64) - np.asarray(self.eye)) @ self.axes().T
        depth = -local[..., 2]
        safe = np.where(depth > 1e-9, depth, np.nan)
        scale = height / 2 / np.tan(self.fov / 2)
        x = width / 2 + local[..., 0] / safe * scale
        y = height / 2 - local[..., 1] / safe * scale
        return np.stack([x, y], -1), depth

    def moved(self, offset: object) -> Camera:
        """The same camera, eye and target shifted by `offset` (3,)."""
        offset = np.asarray(offset, np.float64)
        return Camera(_tuple(self.eye + offset), _tuple(self.target + offset), self.fov, self.up)


def _tuple(v: object) -> tuple[float, float, float]:
    x, y, z = (float(a) for a in np.asarray(v))
    return x, y, z


def direction(azimuth: float, elevation: float) -> Floats:
    """Unit vector at `azimuth` degrees from +Z towards +X and `elevation` degrees above the floor."""
    a, e = np.radians([azimuth, elevation])
    return np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])


def fit(
    points: Floats,
    toward: Floats,
    size: tuple[int, int],
    *,
    fov: float = float(np.radians(22.0)),
    margin: float = 0.07,
    level: float | None = None,
) -> Camera:
    """The nearest camera in direction `toward` (unit, from the subject to the eye) that sees all points (n,3).

    `margin` is the free share at each edge of the picture. `level`: height of the eye in metres (then only the azimuth
    of `toward` counts).
    """
    points = np.asarray(points, np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    target = (low + high) / 2
    reach = max(float(np.linalg.norm(high - low)), 1e-3)
    toward = np.asarray(toward, np.float64)
    distance = reach / np.tan(fov / 2) / 2
    usable = np.array(size) * (1 - 2 * margin)
    camera = Camera((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), fov)
    for _ in range(12):
        eye = target + toward * distance
        if level is not None:
            flat = np.array([toward[0], 0.0, toward[2]])
            flat /= max(float(np.linalg.norm(flat)), 1e-9)
            eye = target + flat * distance
            eye[1] = level
        camera = Camera(_tuple(eye), _tuple(target), fov)
        pixels, depth = camera.project(points, size)
        if not (depth > 0.02 * distance).all():
            distance *= 1.5
            continue
        a, b = pixels.min(axis=0), pixels.max(axis=0)
        axes = camera.axes()
        metres = 2 * np.tan(fov / 2) * float(np.linalg.norm(np.subtract(camera.eye, camera.target))) / size[1]
        offset = (a + b) / 2 - np.array(size) / 2
        shift = axes[0] * offset[0] * metres - axes[1] * offset[1] * metres
        target = target + shift
        distance *= float(max(((b - a) / usable).max(), 0.05)) ** 0.9
    return camera


def stand(
    points: Floats,
    view: str,
    size: tuple[int, int],
    *,
    places: dict[str, Floats] | None = None,
    heading: float = 0.0,
    stature: float | None = None,
) -> Camera:
    """The camera of a named view of a figure (or object) whose surface points are `points` (n,3).

    view: one of `VIEWS`, or a key of `places`: name -> either a frame (4,4), whose -Z axis looks as a Viewpoint does,
    or for "face" and "hands" points (n,3) that the view must hold. heading: degrees the figure is turned about Y.
    Raises `VitruvianError` for another name.
    """
    points = np.asarray(points, np.float64).reshape(-1, 3)
    if not len(points):
        raise VitruvianError("picture: there is nothing to see, expected at least one vertex")
    places = places or {}
    low, high = points.min(axis=0), points.max(axis=0)
    height = stature or float(high[1] - low[1])
    if view in _AZIMUTH:
        toward = direction(_AZIMUTH[view] + heading, 6.0)
        level = low[1] + 0.82 * height
        return fit(points, toward, size, level=float(level))
    if view in ("face", "hands") and view not in places:
        raise VitruvianError(f"view {view}: this figure has no such place; use one of {', '.join(_AZIMUTH)}")
    place = places.get(view)
    if place is None:
        known = ", ".join([*VIEWS, *(n for n in places if n.endswith("_view"))])
        raise VitruvianError(f"view {view}: expected one of {known}")
    if place.shape == (4, 4):
        eye = place[:3, 3]
        return Camera(_tuple(eye), _tuple(eye - place[:3, 2]), float(np.radians(45.0)), _tuple(place[:3, 1]))
    if view == "face":
        return fit(place, direction(22.0 + heading, 2.0), size, fov=float(np.radians(20.0)), margin=0.1)
    return fit(place, direction(28.0 + heading, 8.0), size, fov=float(np.radians(20.0)), margin=0.1)
