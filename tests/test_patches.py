"""Bezier patches: exact on polynomials, without cracks, near the limit of Catmull-Clark subdivision."""

from __future__ import annotations

import numpy as np
import pytest

from vitruvian.errors import VitruvianError
from vitruvian.modeling.patches import Patches, evaluate, flatness, halved, levels, patches_of, subdivided

# u, v and u^2 in Bernstein coefficients
LINE, SQUARE = np.array([0, 1, 2, 3]) / 3, np.array([0, 0, 1, 3]) / 3


def polynomial(columns: int = 1, low: float = 0.0) -> Patches:
    """z = x^2 y over squares beside each other along y."""
    points, nets = [], np.empty((columns, 4, 4), int)
    for n in range(columns):
        for i in range(4):
            for j in range(4):
                if n and not j:
                    nets[n, i, j] = nets[n - 1, i, 3]
                    continue
                nets[n, i, j] = len(points)
                points.append([LINE[i], low + n + LINE[j], SQUARE[i] * (low + n + LINE[j])])
    return Patches(np.array(points), nets)


def cube() -> tuple[np.ndarray, np.ndarray]:
    points = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return points, np.array(quads)


def borders(triangles) -> int:
    """Edges that no other triangle goes along the other way, or several do."""
    edges = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    there, back = ({tuple(e) for e in es.tolist()} for es in (edges, edges[:, ::-1]))
    assert len(there) == len(edges), "two triangles on the same side of an edge"
    return len(there - back)


@pytest.mark.parametrize("level", range(5))
def test_a_polynomial_surface_is_met_at_every_level(level):
    patches = polynomial(3)
    made = subdivided(patches, level=level)
    x, y, z = (made.matrix @ patches.points).T
    assert len(x) == (2**level + 1) * (3 * 2**level + 1) and len(made.faces) == 3 * 4**level
    assert np.abs(z - x * x * y).max() < 1e-12
    wanted = np.stack([-2 * x * y, -x * x, np.ones_like(x)], axis=1)
    assert np.allclose(made.normals, wanted / np.linalg.norm(wanted, axis=1, keepdims=True), atol=1e-9)
    u, v = np.moveaxis(made.at, 2, 0)
    assert np.allclose(u, x[made.faces]) and np.allclose(v + made.patch[:, None], y[made.faces])


def test_quarters_are_the_same_surface():
    rng = np.random.default_rng(3)
    net = rng.normal(size=(5, 4, 4, 3))
    parts = halved(net)
    u, v = rng.random((2, 5))
    whole = Patches(net.reshape(-1, 3), np.arange(80).reshape(5, 4, 4))
    for a in (0, 1):
        for b in (0, 1):
            part = Patches(parts[:, a, b].reshape(-1, 3), np.arange(80).reshape(5, 4, 4))
            here, normal = evaluate(part, np.arange(5), u, v)
            there, same = evaluate(whole, np.arange(5), (u + a) / 2, (v + b) / 2)
            assert np.allclose(here, there, atol=1e-13) and np.allclose(normal, same, atol=1e-9)


def test_flatness_says_how_often_patches_are_halved():
    """Each halving leaves a quarter of the distance, so levels are logarithms of it."""
    patches = polynomial(1, low=1.0)
    flat = flatness(patches.points[patches.nets])[0]
    for deep in range(4):
        assert levels(patches, flat / 4**deep * 1.01).tolist() == [deep]
    assert levels(patches, 1e-12).tolist() == [6]


def test_neighbours_of_other_levels_have_no_cracks():
    """A closed body with one sharp bump: levels differ, all edges have two triangles, vertices lie on the surface."""
    points, quads = cube()
    patches, _ = patches_of(points, quads)
    lifted = patches.points.copy()
    lifted[patches.nets[1, 1:3, 1:3].ravel()] += [1.5, 0, 0]
    patches = Patches(lifted, patches.nets)
    deep = levels(patches, 0.004)
    assert deep[1] > deep[0] > 0
    made = subdivided(patches, tolerance=0.004)
    assert borders(made.triangles) == 0
    found = made.matrix @ patches.points
    there, _ = evaluate(patches, np.repeat(made.patch, 4), *made.at.reshape(-1, 2).T)
    assert np.abs(there - found[made.faces.ravel()]).max() < 1e-14
    a, b, c = np.moveaxis(found[made.triangles], 1, 0)
    out = np.cross(b - a, c - a)
    assert np.all(np.sum(out * made.normals[made.triangles].mean(axis=1), axis=1) > 0)
    rows = np.asarray(made.matrix.sum(axis=1)).ravel()
    assert np.allclose(rows, 1, atol=1e-14) and made.matrix.min() >= 0
    coarse = subdivided(patches, tolerance=1.0)
    assert len(coarse.faces) < len(made.faces) and borders(coarse.triangles) == 0


def test_a_closed_mesh_goes_to_the_limit_of_catmull_clark():
    """Corners are the limit positions of the vertices: those that many rounds of subdivision come to."""
    points, quads = cube()
    patches, matrix = patches_of(points, quads)
    fine, faces = points, quads
    for _ in range(6):
        fine, faces = catmull_clark(fine, faces)
    assert np.abs(patches.points[:8] - fine[:8]).max() < 1e-3
    assert np.allclose(np.asarray(matrix.sum(axis=1)).ravel(), 1, atol=1e-14) and matrix.min() >= 0
    mesh = subdivided(patches, level=4)
    assert borders(mesh.triangles) == 0
    from scipy.spatial import cKDTree

    far = cKDTree(fine).query(mesh.matrix @ patches.points)[0]
    assert far.max() < 0.05


def catmull_clark(points, quads):
    """One round for closed quad meshes, plainly."""
    middle = points[quads].mean(axis=1)
    sides = np.sort(np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    edges, edge = np.unique(sides, axis=0, return_inverse=True)
    edge = edge.reshape(quads.shape)
    near = np.zeros((len(edges), 3))
    np.add.at(near, edge, middle[:, None])
    new = (points[edges].sum(axis=1) + near) / 4
    n = np.bincount(quads.ravel(), minlength=len(points))[:, None]
    around, along = np.zeros_like(points), np.zeros_like(points)
    np.add.at(around, quads, middle[:, None])
    for k in (0, 1):
        np.add.at(along, edges[:, k], points[edges].mean(axis=1))
    own = (around / n + 2 * along / n + (n - 3) * points) / n
    V, E = len(points), len(edges)
    face = V + E + np.arange(len(quads))
    out = [np.stack([quads[:, k], V + edge[:, k], face, V + edge[:, k - 1]], axis=1) for k in range(4)]
    return np.concatenate([own, new, middle]), np.concatenate(out)


def test_borders_are_splines_and_corners_stay():
    """A flat sheet stays the flat sheet: same outline, same corners."""
    grid = np.arange(16).reshape(4, 4)
    points = np.array([[i, j, 0.0] for i in range(4) for j in range(4)])
    quads = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=-1).reshape(-1, 4)
    patches, _ = patches_of(points, quads)
    made = subdivided(patches, level=2)
    found = made.matrix @ patches.points
    assert np.allclose(found.min(axis=0), 0) and np.allclose(found.max(axis=0), [3, 3, 0])
    assert borders(made.triangles) == 4 * 3 * 4
    assert np.allclose(made.normals, [0, 0, 1])


def test_weights_go_through_the_same_matrix():
    points, quads = cube()
    patches, matrix = patches_of(points, quads)
    weights = np.random.default_rng(1).dirichlet(np.ones(5), size=8)
    fine = subdivided(patches, level=3).matrix @ (matrix @ weights)
    assert fine.min() >= 0 and np.allclose(fine.sum(axis=1), 1)


def test_texture_coordinates_of_corners():
    points, quads = cube()
    patches, _ = patches_of(points, quads)
    made = subdivided(patches, level=2)
    square = np.tile([[0, 0], [1, 0], [1, 1], [0, 1]], (6, 1, 1)) + 2.0 * np.arange(6)[:, None, None]
    found = made.corners(square)
    assert np.allclose(found, made.at + 2.0 * made.patch[:, None, None])


def test_a_repeated_corner_makes_a_triangle():
    """A patch whose one side is a point, closed by its mirror image: no cracks, no faces without area."""
    nets = np.arange(16).reshape(4, 4)
    u, v = np.meshgrid(np.arange(4) / 3, np.arange(4) / 3, indexing="ij")
    points = np.stack([u * (v - 0.5), u, 0.2 * u * (1 - u) + 0 * v], axis=-1).reshape(-1, 3)
    nets[0] = 0
    patches = Patches(points, nets[None])
    made = subdivided(patches, level=2)
    t = made.triangles
    assert len(made.faces) == 16 and len(t) == 28 and borders(t) == 12
    assert np.allclose(np.linalg.norm(made.normals, axis=1), 1)


def test_what_does_not_fit_is_said():
    points, quads = cube()
    with pytest.raises(VitruvianError, match="quads: expected"):
        patches_of(points, quads[:, :3])
    with pytest.raises(VitruvianError, match="quad 2 repeats one"):
        patches_of(points, np.where(np.arange(6)[:, None] == 2, 3, quads))
    with pytest.raises(VitruvianError, match="3 at edge"):
        patches_of(np.concatenate([points, points[:4] * 2]), np.concatenate([quads, [[0, 1, 9, 8]]]))
    with pytest.raises(VitruvianError, match="indices below 8"):
        patches_of(points, quads + 1)
    patches, _ = patches_of(points, quads)
    with pytest.raises(VitruvianError, match="level"):
        subdivided(patches, level=7)
    with pytest.raises(VitruvianError, match="tolerance"):
        subdivided(patches, tolerance=0)
    with pytest.raises(VitruvianError, match="nets"):
        Patches(points, quads)
    empty = subdivided(Patches(np.zeros((0, 3)), np.zeros((0, 4, 4), np.int32)), level=2)
    assert not len(empty.faces) and empty.matrix.shape == (0, 0)
