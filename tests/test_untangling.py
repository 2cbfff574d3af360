"""Where cloth cuts itself, against strangers, and pulled apart again."""

from __future__ import annotations

import time

import numpy as np
import pytest
import trimesh

from vitruvian.cloth import intersections as module
from vitruvian.cloth.intersections import cut_points, edges_of, intersections, intersections_between
from vitruvian.cloth.obstacle import still
from vitruvian.cloth.untangling import outside, untangle
from vitruvian.errors import VitruvianError
from vitruvian.native import kernels

kernel = pytest.mark.skipif(kernels() is None, reason="the extension vitruvian._native is not built: pip install .")
OFF = np.array([0.0013, 0.0, 0.0017])  # so that no vertex is over another


def grid(n: int, wide: float = 0.4, deep: float = 0.4) -> tuple[np.ndarray, np.ndarray]:
    i = np.arange(n * n)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    triangles = [np.stack([corner, corner + n + 1, corner + 1], 1), np.stack([corner, corner + n, corner + n + 1], 1)]
    x = np.stack([i % n / (n - 1) * wide, np.zeros(n * n), i // n / (n - 1) * deep], axis=1)
    return x, np.concatenate(triangles).astype(np.int32)


def two(a: np.ndarray, b: np.ndarray, t: np.ndarray, u: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    return np.concatenate([a, b]), np.concatenate([t, (t if u is None else u) + np.int32(len(a))])


def poked(n: int = 31) -> tuple[np.ndarray, np.ndarray]:
    x, t = grid(n)
    round_ = np.exp(-((x[:, 0] - 0.2) ** 2 + (x[:, 2] - 0.2) ** 2) / 0.04**2)
    return two(x, x + np.column_stack([0 * round_, 0.02 * round_ - 0.003, 0 * round_]) + OFF, t)


def waves(n: int = 31) -> tuple[np.ndarray, np.ndarray]:
    x, t = grid(n)
    one, other = x.copy(), x + OFF
    one[:, 1] = 0.006 * np.sin(60 * x[:, 0])
    other[:, 1] = 0.004 + 0.006 * np.sin(50 * x[:, 2])
    return two(one, other, t)


def edge_through(n: int = 31) -> tuple[np.ndarray, np.ndarray]:
    """A sheet of which a border stands 15 mm through another."""
    x, t = grid(n)
    y, u = grid(n, 0.2, 0.2)
    return two(x, np.stack([y[:, 0] + 0.1, 0.015 - y[:, 2], y[:, 1] + 0.2], axis=1) + OFF, t, u)


def exact_pairs(x: np.ndarray, t: np.ndarray) -> set[tuple[int, int]]:
    """Pairs of triangles without a common vertex that cut each other, by exact predicates."""
    from igl.predicates import find_self_intersections

    found = np.asarray(find_self_intersections(x.astype(np.float32).astype(float), t.astype(np.int64))[1]).reshape(
        -1, 2
    )
    return {(min(p), max(p)) for p in found.tolist() if not set(t[p[0]]) & set(t[p[1]])}


def pairs_of(x: np.ndarray, t: np.ndarray) -> set[tuple[int, int]]:
    beside: dict[tuple[int, int], list[int]] = {}
    for k, corners in enumerate(t.tolist()):
        for i in range(3):
            beside.setdefault(tuple(sorted((corners[i], corners[i - 2]))), []).append(k)
    edges = edges_of(t)
    cuts = intersections(x, t)
    pairs = ((own, f) for e, f in cuts.tolist() for own in beside[tuple(edges[e].tolist())])
    return {(min(p), max(p)) for p in pairs if not set(t[p[0]]) & set(t[p[1]])}


@pytest.mark.parametrize("make", [poked, waves, edge_through])
def test_cuts_are_those_of_exact_predicates(make):
    x, t = make(17)
    found = pairs_of(x, t)
    assert found == exact_pairs(x, t) and len(found) > 8


def test_cuts_of_a_soup_are_those_of_exact_predicates():
    rng = np.random.default_rng(5)
    x = rng.random((300, 1, 3)) + 0.1 * rng.normal(size=(300, 3, 3))
    x, t = x.reshape(-1, 3), np.arange(900, dtype=np.int32).reshape(-1, 3)
    found = pairs_of(x, t)
    assert found == exact_pairs(x, t) and len(found) > 50


@kernel
def test_the_kernel_finds_what_its_twin_finds(monkeypatch):
    x, t = waves(13)
    ours = intersections(x, t)
    monkeypatch.setattr(module, "kernels", lambda: None)
    assert len(ours) and np.array_equal(ours, intersections(x, t))


def test_two_meshes_cut_each_other_on_a_circle():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    plane, t = grid(41)
    there, back = intersections_between(plane - [0.2, -0.06, 0.2], t, ball.vertices, ball.faces)
    x, y = plane - [0.2, -0.06, 0.2], np.asarray(ball.vertices)
    spots = []
    for points, edges, others, faces, cut in (
        (x, edges_of(t), y, np.asarray(ball.faces), there),
        (y, edges_of(np.asarray(ball.faces, np.int32)), x, t, back),
    ):
        line = edges[cut[:, 0]]
        face = faces[cut[:, 1]] + len(points)
        along, corner = cut_points(np.concatenate([points, others]), line, face)
        spot = points[line[:, 0]] * (1 - along)[:, None] + points[line[:, 1]] * along[:, None]
        assert np.abs(spot - np.einsum("kc,kcx->kx", corner, others[faces[cut[:, 1]]])).max() < 1e-6
        spots.append(spot)
    radius = np.hypot(*np.concatenate(spots)[:, [0, 2]].T)  # of the circle 60 mm above the centre: 80 mm
    assert len(there) > 50 and len(back) > 50 and radius.max() < 0.0801 and radius.min() > 0.0785


@pytest.mark.parametrize("make", [poked, waves, edge_through])
def test_cloth_is_pulled_apart(make):
    x, t = make()
    done = untangle(x, t)
    assert done.counts[0] > 50 and done.left == 0 and done.rounds <= 15
    assert len(exact_pairs(done.positions, t)) == 0
    far = np.linalg.norm(done.positions - x, axis=1)
    assert far.max() == pytest.approx(done.moved) and done.moved < 0.03
    assert (untangle(x, t).positions == done.positions).all()


def test_what_passes_wholly_through_is_reported_and_not_made_worse():
    x, t = grid(21)
    tilted = np.stack([x[:, 0], x[:, 2] - 0.2, 0 * x[:, 1] + 0.2], axis=1) + OFF
    done = untangle(*two(x, tilted, t), rounds=5)
    assert done.left == len(intersections(done.positions, two(x, tilted, t)[1])) <= done.counts[0]
    assert done.rounds == 5 or done.left == 0


def test_held_vertices_stay_and_the_body_is_kept_out():
    x, t = waves()
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    obstacle = still(np.asarray(ball.vertices) + [0.2, -0.108, 0.2], np.asarray(ball.faces, np.int32))
    x = outside(obstacle, x)
    half = len(x) // 2
    done = untangle(x, t, held=np.arange(half), obstacle=obstacle)
    assert done.counts[0] > 50 and done.left == 0
    assert (done.positions[:half] == x[:half]).all() and obstacle.distances(done.positions).min() > 0.0015


def test_what_keep_gives_back_is_taken():
    x, t = poked()
    done = untangle(x, t, keep=lambda y: np.column_stack([x[:, 0], y[:, 1], x[:, 2]]))
    assert done.left == 0 and (done.positions[:, [0, 2]] == x[:, [0, 2]]).all()


def test_nothing_one_triangle_and_triangles_without_area():
    none = np.zeros((0, 3))
    assert untangle(none, none.astype(np.int32)).left == 0 and len(intersections(none, none.astype(np.int32))) == 0
    one = np.eye(3)
    assert (untangle(one, [[0, 1, 2]]).positions == one).all()
    flat = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], float)
    assert untangle(flat, [[0, 1, 2], [3, 4, 5]]).rounds == 0
    x, t = poked()
    x = np.concatenate([x, np.repeat(x[:1] + 1, 3, axis=0)])
    assert untangle(x, np.concatenate([t, [[len(x) - 3, len(x) - 2, len(x) - 1]]])).left == 0


def test_what_is_refused():
    bad = np.eye(3)
    bad[1, 1] = np.nan
    for call in (untangle, intersections):
        with pytest.raises(VitruvianError, match=r"positions.*finite"):
            call(bad, [[0, 1, 2]])
        with pytest.raises(VitruvianError, match="triangles"):
            call(np.eye(3), [[0, 1, 3]])
    with pytest.raises(VitruvianError, match="rounds"):
        untangle(np.eye(3), [[0, 1, 2]], rounds=-1)
    x, t = poked()
    with pytest.raises(VitruvianError, match="keep"):
        untangle(x, t, keep=lambda y: y[:-1])


@kernel
def test_fourteen_thousand_triangles_take_a_blink():
    x, t = waves(60)
    edges = edges_of(t)
    best = np.inf
    for _ in range(5):
        start = time.perf_counter()
        intersections(x, t, edges=edges)
        best = min(best, time.perf_counter() - start)
    assert len(t) > 13900 and best < 0.1
