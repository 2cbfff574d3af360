"""Surfaces whose points were computed ahead, frame by frame: what moving cloth is in files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, Part, Skin, Weights, floats, indices, require

ROUGHNESS = 0.9  # of cloth


@dataclass(frozen=True, eq=False)
class VertexCache:
    """A surface that moves as it once did.

    triangles (m,3); times (F,) seconds, increasing; positions (F,n,3) float32 metres, in the humanoid space of who wears
    it. uv (u,2) with uv_triangles (m,3), or None; color: sRGB. weights: how the joints of the wearer carry it by and
    large, rows sum to 1, or None; positions do not depend on them. closing: metres by which a loop did not end where it
    had begun, which its last frames make up for.
    """

    name: str
    triangles: Ints
    times: Floats
    positions: NDArray[np.float32]
    uv: Floats | None = None
    uv_triangles: Ints | None = None
    color: tuple[float, float, float] = (0.8, 0.8, 0.8)
    weights: Weights | None = None
    closing: float = 0.0

    def __post_init__(self) -> None:
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        times = floats(self.times, "times", None)
        require(len(times) > 0, "times", "one at least", "none")
        late = np.flatnonzero(np.diff(times) <= 0)
        require(not late.size, "times", "increasing seconds", f"{times[late[:1] + 1]} at {late[:1] + 1}")
        shape = np.shape(self.positions)
        good = len(shape) == 3 and shape[0] == len(times) and shape[2] == 3
        require(good, "positions", f"({len(times)}, n, 3)", shape)
        positions = np.ascontiguousarray(self.positions, np.float32)
        for k, frame in enumerate(positions):
            require(bool(np.isfinite(frame).all()), f"positions {k}", "finite numbers", "others")
        n, m = shape[1], len(self.triangles)
        put("times", times)
        put("positions", positions)
        put("triangles", indices(self.triangles, "triangles", n, None, 3))
        require((self.uv is None) == (self.uv_triangles is None), "uv", "uv with uv_triangles", "one of them")
        if self.uv is not None:
            put("uv", floats(self.uv, "uv", None, 2))
            put("uv_triangles", indices(self.uv_triangles, "uv_triangles", len(self.uv), m, 3))
        put("color", tuple(float(c) for c in floats(self.color, "color", 3)))
        if self.weights is not None:
            require(len(self.weights) == n, "weights", f"a row for each of {n} points", len(self.weights))

    def __len__(self) -> int:
        return len(self.times)

    @property
    def fps(self) -> float:
        """Frames per second, of one frame 1."""
        return 1.0 if len(self) < 2 else (len(self) - 1) / float(self.times[-1] - self.times[0])


def surface(cache: VertexCache, points: Floats) -> Skin:
    """What a cache looks like with its points at (n,3) metres: cloth that is seen from both sides, without weights."""
    n = len(points)
    nothing = Weights(np.zeros(n + 1, np.int32), np.zeros(0, np.int32), np.zeros(0))
    part = Part(cache.name, 0, len(cache.triangles), cache.color, roughness=ROUGHNESS, double_sided=True)
    return Skin(points, cache.triangles, nothing, cache.uv, cache.uv_triangles, None, (part,))
