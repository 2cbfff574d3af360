"""Eyes with sclera, iris, pupil and a glossy cornea: one surface each, crisp borders by doubled rings."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.sparse import csr_matrix

from vitruvian.body.types import Floats
from vitruvian.modeling import source
from vitruvian.modeling.look import Color, LookPart

AROUND = 48
LIMBUS = 27.0  # degrees from the axis
PUPIL = 10.0
BULGE = 0.085  # height of the cornea over the ball, in radii
# Polar angle of each ring and what it belongs to: 0 pupil, 1 iris, 2 sclera. Rings at a border are there twice.
RINGS = [
    (0.001, 0),
    (6.0, 0),
    (PUPIL, 0),
    (PUPIL, 1),
    (11.5, 1),
    (14.0, 1),
    (18.0, 1),
    (22.0, 1),
    (25.0, 1),
    (LIMBUS, 1),
]
RINGS += [(LIMBUS, 2), (28.5, 2), (33.0, 2), (40.0, 2), (50.0, 2), (65.0, 2), (85.0, 2), (110.0, 2)]


@cache
def _template() -> tuple[Floats, Floats, Floats]:
    """Directions (n,3), radii (n,) and triangles of an eye that looks along +Z."""
    theta = np.radians([t for t, _ in RINGS])
    phi = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
    s, c = np.sin(theta)[:, None], np.cos(theta)[:, None]
    d = np.stack([s * np.cos(phi), s * np.sin(phi), np.broadcast_to(c, (len(theta), AROUND))], axis=-1)
    lift = np.clip(1 - (np.degrees(theta) / (LIMBUS + 5)) ** 2, 0, 1)
    radius = 1 + BULGE * lift
    index = np.arange(len(theta) * AROUND).reshape(len(theta), AROUND)
    after = np.roll(index, -1, axis=1)
    kinds = np.array([k for _, k in RINGS])
    quads = [
        np.stack([index[i], index[i + 1], after[i + 1], after[i]], 1)
        for i in range(len(RINGS) - 1)
        if kinds[i] == kinds[i + 1]
    ]
    q = np.concatenate(quads)
    triangles = np.concatenate([q[:, [0, 1, 2]], q[:, [0, 2, 3]]])
    return d.reshape(-1, 3), np.repeat(radius, AROUND), triangles


def _colors(iris: Color, seed: int) -> Floats:
    """(n,3) colours of the template's vertices."""
    rng = np.random.default_rng(seed + 17)
    fibre = np.convolve(np.tile(rng.normal(size=AROUND), 3), [0.25, 0.5, 0.25], "same")[AROUND : 2 * AROUND]
    base = np.array(iris)
    out = np.zeros((len(RINGS), AROUND, 3))
    phi = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
    for k, (theta, kind) in enumerate(RINGS):
        if kind == 0:
            out[k] = (0.015, 0.013, 0.013)
        elif kind == 1:
            near = np.exp(-(((theta - 13.0) / 4.0) ** 2))
            dark = np.clip((theta - 21.0) / (LIMBUS - 21.0), 0, 1) ** 1.5
            lit = 1 + 0.16 * fibre * (1 - dark) + 0.45 * near - 0.68 * dark - 0.15 * np.clip(np.sin(phi), 0, 1)
            warm = np.array([1.15, 1.0, 0.8]) * near + (1 - near)
            out[k] = base * lit[:, None] * warm
        else:
            white = np.array([0.93, 0.905, 0.88])
            rim = np.exp(-((theta - LIMBUS) / 2.2))
            pink = np.clip((theta - 38) / 25, 0, 1)[..., None] * np.abs(np.cos(phi))[:, None]
            lid = 1 - 0.14 * np.clip(np.sin(phi), 0, 1)[:, None] * np.clip((theta - 20) / 25, 0, 1)
            out[k] = (white * (1 - 0.30 * rim)) * (1 - pink * np.array([0.06, 0.20, 0.20])) * lid
    return np.clip(out.reshape(-1, 3), 0, 1)


def _balls(points: Floats) -> tuple[Floats, Floats, Floats]:
    """Of the source's eyes: points (2,72,3), middle (2,3) and radius (2,)."""
    old = points[source.EYES].reshape(2, 72, 3)
    low, high = old.min(axis=1), old.max(axis=1)
    size = (high - low)[:, :2].mean(axis=1) / 2
    middle = (low + high) / 2
    middle[:, 2] = low[:, 2] + size
    return old, middle, size


@cache
def eye_parents() -> csr_matrix:
    """(n, 19158) the source's eye points that each vertex of both eyes goes with, see `look.parents_of`."""
    directions, _, _ = _template()
    n = len(directions)
    old, middle, _ = _balls(source.points())
    rows, columns, values = [], [], []
    for e in range(2):
        toward = old[e] - middle[e]
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        near = directions @ toward.T
        best = np.argpartition(-near, 3, axis=1)[:, :3]
        share = 1 / (1e-3 + np.arccos(np.clip(np.take_along_axis(near, best, 1), -1, 1))) ** 2
        rows.append(np.repeat(np.arange(e * n, e * n + n), 3))
        columns.append((best + source.EYES.start + 72 * e).ravel())
        values.append((share / share.sum(axis=1, keepdims=True)).ravel())
    return csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (2 * n, source.POINTS))


def eyes_part(points: Floats, iris: Color, seed: int) -> LookPart:
    """Both eyes in the sockets of a shaped person (points (19158,3), A pose)."""
    directions, radii, triangles = _template()
    _, middle, size = _balls(points)
    vertices = middle[:, None] + size[:, None, None] * (directions * radii[:, None])
    colors = np.tile(_colors(iris, seed), (2, 1))
    both = np.concatenate([triangles, triangles + len(directions)]).astype(np.int32)
    return LookPart("eyes", vertices.reshape(-1, 3), both, colors, "eyes", roughness=0.08)
