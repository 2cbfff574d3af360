"""Surfaces that move as they once did, and the few morph targets that show them within a bound."""

from __future__ import annotations

import numpy as np
import pytest

from vitruvian.body.types import Weights
from vitruvian.errors import VitruvianError
from vitruvian.formats.gltf_cloth import morphed
from vitruvian.stage.vertex_cache import VertexCache

BOUND = 0.002
rng = np.random.default_rng(5)


def flag(frames: int, points: np.ndarray, triangles: np.ndarray, **options: object) -> VertexCache:
    return VertexCache("flag", triangles, np.arange(frames) / 30, points, **options)  # type: ignore[arg-type]


def sheet(n: int = 12) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.linspace(0, 0.3, n), np.linspace(1, 1.3, n))
    points = np.stack([x.ravel(), y.ravel(), 0.2 + 0 * x.ravel()], 1)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    return points, np.concatenate([np.stack([a, a + 1, a + n], 1), np.stack([a + 1, a + n + 1, a + n], 1)])


def test_caches_say_what_is_wrong_with_them() -> None:
    points, triangles = sheet(3)
    good = np.repeat(points[None], 2, axis=0)
    with pytest.raises(VitruvianError, match="times"):
        VertexCache("a", triangles, np.array([0.0, 0.0]), good)
    with pytest.raises(VitruvianError, match="positions: expected"):
        VertexCache("a", triangles, np.array([0.0]), good)
    with pytest.raises(VitruvianError, match="finite"):
        VertexCache("a", triangles, np.array([0.0, 1.0]), good * [[[1]], [[np.nan]]])
    with pytest.raises(VitruvianError, match="triangles"):
        VertexCache("a", triangles + 5, np.array([0.0, 1.0]), good)
    with pytest.raises(VitruvianError, match="weights"):
        VertexCache("a", triangles, np.array([0.0, 1.0]), good, weights=Weights.from_pairs(1, [0], [0], [1.0]))


def matrices(frames: int) -> np.ndarray:
    """Two joints, the second turning and both walking."""
    out = np.tile(np.eye(4), (frames, 2, 1, 1))
    for f, a in enumerate(np.linspace(0, 1.5, frames)):
        out[f, 1, :3, :3] = [[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]
        out[f, :, 2, 3] = 0.04 * f
    return out


def shown(made, frames: int, m: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(F,n,3) as a player has them."""
    out = np.repeat(made.rest[None], frames, axis=0)
    if len(made.shapes):
        w = np.stack([np.interp(times, made.times, column) for column in made.weights.T], axis=1)
        out[:, made.live] += np.einsum("fk,klx->flx", w, made.shapes)
    blend = np.einsum("nk,fnkab->fnab", made.shares, m[:, :, :3][:, made.joints])
    return np.einsum("fnab,fnb->fna", blend[..., :3], out) + blend[..., 3]


def test_what_joints_carry_needs_no_shape_and_waves_need_few() -> None:
    frames, (points, triangles), m = 40, sheet(), matrices(40)
    n = len(points)
    joint = (points[:, 0] > 0.15).astype(int)
    weights = Weights.from_pairs(n, np.arange(n), joint, np.ones(n))
    carried = np.einsum("fnab,nb->fna", m[:, joint][..., :3, :3], points) + m[:, joint][..., :3, 3]
    made = morphed(flag(frames, carried, triangles, weights=weights), m, BOUND)
    assert len(made.shapes) == 0 and made.error < 1e-5
    wave = points + 0.03 * np.sin(np.linspace(0, 9, frames))[:, None, None] * np.sin(20 * points[:, :1]) * [0, 0, 1.0]
    wave += 0.03 * np.cos(np.linspace(0, 9, frames))[:, None, None] * np.cos(20 * points[:, :1]) * [0, 0, 1.0]
    moving = np.einsum("fnab,fnb->fna", m[:, joint][..., :3, :3], wave) + m[:, joint][..., :3, 3]
    cache = flag(frames, moving, triangles, weights=weights)
    made = morphed(cache, m, BOUND)
    assert 0 < len(made.shapes) <= 3
    off = np.linalg.norm(shown(made, frames, m, cache.times) - cache.positions, axis=2).max()
    assert off <= made.error + 1e-6 <= BOUND + 1e-6


@pytest.mark.parametrize("bound", [0.02, 0.002, 0.0005])
def test_any_motion_is_within_the_bound(bound: float) -> None:
    """Cloth that flutters everywhere, and some that is calm; also blends of joints that fold up."""
    frames, (points, triangles), m = 30, sheet(), matrices(30)
    n = len(points)
    m[:, 1, :3, :3] = m[:, 1, :3, :3] @ np.diag([-1.0, -1.0, 1.0])  # half of each is no volume at all
    share = np.repeat(rng.uniform(0, 1, n), 2)
    share[1::2] = 1 - share[1::2]
    weights = Weights.from_pairs(n, np.repeat(np.arange(n), 2), np.tile([0, 1], n), share)
    flutter = 0.05 * rng.normal(size=(frames, n, 3)) * (points[:, :1] > 0.1)
    cache = flag(frames, points + flutter, triangles, weights=weights)
    made = morphed(cache, m, bound)
    off = np.linalg.norm(shown(made, frames, m, cache.times) - cache.positions, axis=2).max()
    assert off <= made.error + 1e-6 <= bound + 1e-6
