"""Patterns that stick to a surface: smooth noise in space, evaluated at positions at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Single = NDArray[np.floating]  # float32 where it is large


def noise(points: Single, channels: int = 1) -> Single:
    """Value noise (n, channels) in -1..1 at points (n,3), one feature per unit; the same for ever and everywhere."""
    cell = np.floor(points)
    t = (points - cell).astype(np.float32)
    t = t * t * (3 - 2 * t)
    i = cell.astype(np.int64)
    out = np.zeros((len(points), channels), np.float32)
    with np.errstate(over="ignore"):
        x = [(i[:, 0] + k) * 73856093 for k in (0, 1)]
        y = [(i[:, 1] + k) * 19349663 for k in (0, 1)]
        z = [(i[:, 2] + k) * 83492791 for k in (0, 1)]
        for a in (0, 1):
            wx = t[:, 0] if a else 1 - t[:, 0]
            for b in (0, 1):
                wy = wx * (t[:, 1] if b else 1 - t[:, 1])
                for c in (0, 1):
                    w = wy * (t[:, 2] if c else 1 - t[:, 2])
                    h = ((x[a] ^ y[b] ^ z[c]) & 0xFFFFFFFF).astype(np.uint32)
                    for k in range(channels):  # finaliser of MurmurHash3 (public domain), one round per channel
                        h ^= h >> np.uint32(16)
                        h *= np.uint32(0x85EBCA6B)
                        h ^= h >> np.uint32(13)
                        h *= np.uint32(0xC2B2AE35)
                        h ^= h >> np.uint32(16)
                        out[:, k] += w * (h >> np.uint32(8)).astype(np.float32)
    return out * np.float32(2 / (1 << 24)) - 1


def close(size: float, pixel: float) -> float:
    """How much of a pattern of that size (metres) a picture can hold whose pixels are `pixel` metres wide: 0..1."""
    return float(np.clip((size / max(pixel, 1e-9) - 1.5) / 2, 0, 1))


BAND, SECTORS, THIN = 0.03, 12, 0.012  # metres along a limb, stripes round it, metres of radius
_DARK = np.array([0.10, 0.24, 0.36], np.float32)


def checks(place: Single, pixel: float) -> Single:
    """Tint (n,3) of a chequered surface at places (n,3): metres along a limb, then across it in two directions.

    Bands across the limb and stripes along it; on very thin limbs the bands alone. Edges are a `pixel` (metres) wide.
    """
    along, u, v = place.T
    radius = np.hypot(u, v)
    blur = max(pixel, 1e-6)
    band = _square(along / BAND, blur / BAND)
    width = radius * (2 * np.pi / SECTORS)
    stripe = _square(np.arctan2(v, u) * (SECTORS / (2 * np.pi)), blur / np.maximum(width, 1e-9))
    dark = 0.5 - 0.5 * band * np.where(radius < THIN, 1, stripe)
    return (1 + dark[:, None] * (_DARK - 1)).astype(np.float32)


def _square(x: Single, blur: Single | float) -> Single:
    """A wave that is 1 in every other unit and -1 between, with edges of width `blur`; 0 where it is too fine."""
    edge = np.abs(x - np.round(x))  # distance from the next change
    sign = 1 - 2 * (np.floor(x) % 2)
    return sign * np.clip(2 * edge / np.maximum(blur, 1e-9), 0, 1)
