"""Cloth between skin and skin that comes to face it: closed forms on plates, the kernel and its twin, a folded body."""

import numpy as np
import pytest

from test_worn import RADIUS, cloth_of, skin_of, tube
from vitruvian.cloth import layers, layers_numpy, pinching, worn
from vitruvian.cloth.binding import bind
from vitruvian.cloth.moving import Skin
from vitruvian.cloth.pinching import KEPT, Pinched, given_way, pinched
from vitruvian.native import kernels

rng = np.random.default_rng(15)


def plate(height, *, facing, size=0.2, across=8):
    """Points, normals and triangles of a square plate at a height, facing up (1) or down (-1)."""
    u = np.linspace(-size, size, across + 1)
    x, z = np.meshgrid(u, u, indexing="ij")
    points = np.stack([x, np.full_like(x, height), z], axis=2).reshape(-1, 3)
    i = (np.arange(across)[:, None] * (across + 1) + np.arange(across)).ravel()
    a, b, c, d = i, i + 1, i + across + 1, i + across + 2
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)])
    return points, np.tile([0.0, facing, 0.0], (len(points), 1)), faces if facing > 0 else faces[:, ::-1]


def plates(apart):
    """Two plates that face each other as one skin, and how many triangles the lower one has."""
    below, above = plate(0.0, facing=1), plate(apart, facing=-1)
    points = np.concatenate([below[0], above[0]]).astype(np.float32)
    normals = np.concatenate([below[1], above[1]]).astype(np.float32)
    triangles = np.concatenate([below[2], above[2] + len(below[0])]).astype(np.int32)
    return Skin(points, normals, triangles, np.zeros(len(points), np.int8)), len(below[2])


def between(apart, high, count=60):
    """Where cloth goes that lies `high` over the lower plate with the upper one `apart` from it: heights."""
    skin, lower = plates(apart)
    foot = rng.uniform(-0.1, 0.1, (count, 3)).astype(np.float32)
    foot[:, 1] = 0
    x = foot + np.float32([0.004, high, -0.003])
    some = np.arange(count, dtype=np.int32)
    middle = skin.points[skin.triangles[lower:]].mean(axis=1)
    near = [rng.choice(np.flatnonzero(np.linalg.norm(middle - p, axis=1) < 0.09)) for p in x]
    near = (lower + np.array(near)).astype(np.int32)
    up = np.tile(np.float32([0, 1, 0]), (count, 1))
    given_way(Pinched(some, near), x, np.ones(count, np.float32), foot, up, skin)
    return x[:, 1]


def test_cloth_gives_way_as_skin_closes_in():
    assert between(0.05, 0.01) == pytest.approx(0.01, abs=1e-6)  # nothing near
    assert between(0.011, 0.01) == pytest.approx(0.011 - KEPT, abs=1e-5)  # too near
    assert between(0.008, 0.01) == pytest.approx(0.008 - KEPT, abs=1e-5)  # through it
    assert between(0.003, 0.01) == pytest.approx(0.0015, abs=1e-5)  # half way, where there is no room for more
    assert np.abs(between(-0.004, 0.01)).max() < 4e-4  # skin in skin: to its own foot


def test_what_is_far_is_not_looked_at():
    skin, lower = plates(0.008)
    x = np.float32([[0, 0.01, 0]])
    there = x.copy()
    far = lower + int(np.argmax(skin.points[skin.triangles[lower:]].mean(axis=1) @ [1, 0, 1]))
    some = Pinched(np.zeros(1, np.int32), np.full(1, far, np.int32))
    given_way(some, x, np.ones(1, np.float32), np.zeros((1, 3), np.float32), np.float32([[0, 1, 0]]), skin)
    assert np.array_equal(x, there)


@pytest.mark.skipif(kernels() is None, reason="the extension is not built: pip install .")
def test_the_kernel_does_what_its_twin_does():
    inner, triangles = tube(RADIUS)
    skin = skin_of(inner, triangles)
    middle = inner[triangles].mean(axis=1)
    for _ in range(60):
        n = int(rng.integers(1, 120))
        turn, high = rng.uniform(0, 2 * np.pi, n), RADIUS + rng.uniform(-0.01, 0.006, n)
        at, turned = rng.uniform(0.05, 0.35, n), np.stack([np.cos(turn), np.sin(turn)], axis=1)
        x, foot = (
            np.column_stack([at, size[:, None] * turned]).astype(np.float32)
            for size in (high, RADIUS + rng.uniform(0.001, 0.03, n))
        )
        vertex = np.sort(rng.integers(0, n, int(rng.integers(0, 2 * n)))).astype(np.int32)
        near = np.argmin(((x[vertex, None] - middle) ** 2).sum(axis=2), axis=1).astype(np.int32)
        ours, theirs = x.copy(), x.copy()
        up = rng.normal(size=(n, 3)).astype(np.float32)
        rest = (foot, up, vertex, near, skin.triangles, skin.neighbours, skin.both, KEPT, pinching.FAR, 0.3)
        had = rng.uniform(0.5, 1, n).astype(np.float32)
        part, there = had.copy(), had.copy()
        kernels().cloth_pinch(ours, part, *rest)
        layers_numpy.cloth_pinch(theirs, there, *rest)
        assert np.abs(ours - theirs).max() < 2e-5 and np.abs(part - there).max() < 2e-2
        assert (part <= np.minimum(had + np.float32(0.3), 1)).all()
        moved = np.unique(vertex)
        alike = (skin.both[triangles[near, 0], 3:] * up[vertex]).sum(axis=1) > layers_numpy.ALIKE
        assert (np.linalg.norm(ours[np.setdiff1d(moved, vertex[alike]), 1:], axis=1) > RADIUS - 2e-4).all()
        still = np.setdiff1d(np.arange(n), moved)
        assert np.array_equal(ours[still], x[still])


def book(angle):
    """Points and normals of two leaves that meet in the z axis, the right one turned up by an angle."""
    left, right = plate(0.0, facing=1), plate(0.0, facing=1)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    points = np.concatenate([left[0] - [0.2, 0, 0], (right[0] + [0.2, 0, 0]) @ turn])
    normals = np.concatenate([left[1], right[1] @ turn])
    return points, normals, np.concatenate([left[2], right[2] + len(left[0])]).astype(np.int32)


def test_partners_are_found_where_a_body_folds():
    points, normals, triangles = book(0.0)
    skin = Skin(points.astype(np.float32), normals.astype(np.float32), triangles, np.zeros(len(points), np.int8))
    pick = np.flatnonzero((points[:, 0] < -0.08) & (points[:, 0] > -0.32) & (np.abs(points[:, 2]) < 0.18))[::2]
    x = points[pick] + [0, 0.01, 0]
    binding = bind(points, triangles, x, normals=normals)
    regions = (points[:, 0] > 0).astype(int)
    corner = triangles[binding.face]
    flat = pinched(skin, regions, corner, binding.share, [(x, points, normals)])
    assert not len(flat.vertices)
    there, up, _ = book(np.pi - 0.02)
    close = pinched(skin, regions, corner, binding.share, [(x, points, normals), (binding.at(there, up), there, up)])
    assert set(close.vertices) == set(range(len(x)))
    folded = skin.at(there.astype(np.float32), up.astype(np.float32))
    x = binding.at(there, up).astype(np.float32)
    foot = np.einsum("nk,nkx->nx", binding.share, there[corner]).astype(np.float32)
    before, apart = x.copy(), np.abs(foot[:, 0]) * np.tan(0.02)
    given_way(close, x, np.ones(len(x), np.float32), foot, np.tile(np.float32([0, 1, 0]), (len(x), 1)), folded)
    assert (before[:, 1] > apart - KEPT).any()  # it was through the other leaf
    assert (x[:, 1] < apart).all() and (x[:, 1] > 0).all()


def test_a_garment_on_a_limb_that_folds_stays_out_of_it():
    """Cloth 6 mm over a leaf that closes to 4 mm is through the other leaf without partners, and between both with them."""
    points, normals, triangles = book(0.0)
    skin = Skin(points.astype(np.float32), normals.astype(np.float32), triangles, np.zeros(len(points), np.int8))
    half = len(points) // 2
    faces = triangles[: len(triangles) // 2]
    x = points[:half] + [0, 0.006, 0]
    binding = bind(points, triangles, x, faces, normals)
    known = layers.Anatomy(("trunk",), np.zeros(1, int), np.ones((1, 1), bool), np.full((1, 2), -1))
    zero = np.zeros(len(x), int)
    layer = layers.sort(binding, x, faces, np.zeros(len(points), int), known)
    close = pinched(
        skin, (points[:, 0] > 0).astype(int), triangles[binding.face], binding.share,
        [(binding.at(*book(a)[:2]), *book(a)[:2]) for a in (np.pi - 0.05, np.pi - 0.02)],
    )  # fmt: skip
    there, up, _ = book(np.pi - 0.02)
    folded = skin.at(there.astype(np.float32), up.astype(np.float32))
    deepest = []
    for some in (pinching.NOTHING, close):
        made = worn.made(cloth_of(x, faces), x, binding, layer, zero, known.bones, skin, np.zeros((1, 3)),
                         np.full(len(x), 0.003), close=some)  # fmt: skip
        now = worn.moved(made, worn.begun(made, folded, np.zeros((1, 3))), folded, np.zeros((1, 3)))
        wide = (now.x[:, 0] < -0.08) & (now.x[:, 0] > -0.32) & (np.abs(now.x[:, 2]) < 0.18)
        deepest.append((now.x[wide, 1] - np.abs(now.x[wide, 0]) * np.tan(0.02)).max())
    assert deepest[0] > 0.003 and deepest[1] < 1e-4
