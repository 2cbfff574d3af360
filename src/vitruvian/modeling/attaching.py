"""Weights for a mesh that has none, from the bones inside it.

The heat method of I. Baran, J. Popovic, "Automatic rigging and animation of 3D characters" (2007): each bone is as hot as
1, each point of the surface takes heat from the nearest bone that it sees through the flesh, and heat spreads over the
surface: (L + M H) w = M H p, with L the cotangent Laplacian, M the areas and H = 1 / d^2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, Skeleton, Weights, floats, indices, require
from vitruvian.errors import warn
from vitruvian.modeling.flesh_rays import Flesh
from vitruvian.modeling.slicing import cotangents
from vitruvian.modeling.transfer import STEEP, Surface

LIGHT = 1e-3  # weights below this are left out
_NEAREST = 6  # bones of each point that it looks for
_TIED = 1.0001  # bones no farther than this times the nearest share the heat


def weights_from_bones(skeleton: Skeleton, mesh: Surface, *, heat: float = 1.0, least: float = LIGHT) -> Weights:
    """Weights of a mesh (vertices (V,3), triangles (T,3); metres, humanoid space at rest) by the bones of a skeleton.

    A bone goes from a joint's centre to each child's, or to its Sites where it has no child. `heat`: more makes borders
    between bones sharper. Sums are 1. Parts from which no bone is seen (inner surfaces, clothes over others) take the
    nearest bone. Raises VitruvianError for shapes and numbers that do not fit.
    """
    from scipy.sparse import csr_array, diags_array
    from scipy.sparse.linalg import splu

    vertices = floats(mesh.vertices, "vertices", None, 3)
    triangles = indices(mesh.triangles, "triangles", len(vertices), None, 3)
    require(len(triangles) > 0, "weights_from_bones", "a mesh with triangles", "none")
    require(getattr(mesh, "unit", "m") == "m", "weights_from_bones", "a mesh in metres", getattr(mesh, "unit", "m"))
    require(0 < heat <= 1e6, "heat", "more than 0", heat)
    place, same = np.unique(vertices, axis=0, return_inverse=True)
    same = same.reshape(-1)
    faces = same[triangles].astype(np.int32)
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = np.ascontiguousarray(faces[whole])
    start, end, owner = bones(skeleton)
    distance, source = _heated(place, faces, start, end, owner, len(skeleton))
    n = len(place)
    area = np.zeros(n)
    corner = place[faces]
    size = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2
    np.add.at(area, faces.ravel(), np.repeat(size / 3, 3))
    links = cotangents(place, faces, 1 / STEEP, STEEP) * 0.5
    laplacian = diags_array(np.asarray(links.sum(axis=1)).ravel()) - links
    pull = heat * np.maximum(area, 1e-12) / np.maximum(distance, 1e-4) ** 2
    used = np.unique(source.indices)
    right = (diags_array(pull) @ source[:, used]).toarray()
    solved = np.maximum(splu((laplacian + diags_array(pull)).tocsc()).solve(right), 0)
    solved[solved < least * solved.sum(axis=1, keepdims=True)] = 0
    solved /= solved.sum(axis=1, keepdims=True)
    rows = csr_array(solved)[same].tocoo()
    return Weights.from_pairs(len(vertices), rows.row, used[rows.col], rows.data)


def bones(skeleton: Skeleton) -> tuple[Floats, Floats, Ints]:
    """Ends (B,3), (B,3) of all bones at rest and the joint (B,) that moves each."""
    centers, parents = skeleton.centers, skeleton.parents
    start, end, owner = [], [], []
    for j in range(len(skeleton)):
        ends = [centers[k] for k in np.flatnonzero(parents == j)]
        if not ends:
            sites = skeleton.site_points[skeleton.site_joints == j]
            far = np.linalg.norm(sites - centers[j], axis=1)
            ends = [sites[int(np.argmax(far))]] if len(sites) else [centers[j]]
        start += [centers[j]] * len(ends)
        end += ends
        owner += [j] * len(ends)
    return np.array(start), np.array(end), np.array(owner, np.int32)


def _heated(place: Floats, faces: Ints, start: Floats, end: Floats, owner: Ints, joints: int):  # noqa: ANN202
    """(n,) distance to the nearest bone that is seen through the flesh, and (n,J) sparse: whose it is."""
    from scipy.sparse import csr_array

    n, count = len(place), min(_NEAREST, len(start))
    along = end - start
    size = np.maximum((along * along).sum(axis=1), 1e-30)
    numbers = np.empty((n, count), np.int64)
    feet, far = np.empty((n, count, 3)), np.empty((n, count))
    for first in range(0, n, 4096):  # all bones of a few thousand points at a time: bounded memory
        p = place[first : first + 4096]
        t = np.clip(np.einsum("nbk,bk->nb", p[:, None] - start, along) / size, 0, 1)
        foot = start + t[..., None] * along
        distance = np.linalg.norm(p[:, None] - foot, axis=2)
        order = np.argsort(distance, axis=1, kind="stable")[:, :count]
        rows = np.arange(len(p))[:, None]
        numbers[first : first + 4096], far[first : first + 4096] = order, distance[rows, order]
        feet[first : first + 4096] = foot[rows, order]
    seen = _seen(place, faces, feet, far)
    some = seen.any(axis=1)
    if not some.any():
        warn("weights_from_bones: no bone is inside the mesh; each point follows the nearest")
    seen[~some, 0] = True
    least = np.min(np.where(seen, far, np.inf), axis=1)
    hot = seen & (far <= _TIED * least[:, None])
    vertex, which = np.nonzero(hot)
    share = 1 / hot.sum(axis=1)[vertex]
    table = csr_array((share, (vertex, owner[numbers[vertex, which]])), shape=(n, joints))
    return least, table


def _seen(place: Floats, faces: Ints, feet: Floats, far: Floats) -> NDArray[np.bool_]:
    """(n,b) whether the way from a point to a bone is inside the flesh: it begins inwards and meets no other surface."""
    from vitruvian.deform.normals import incidence, mesh_normals

    normal = mesh_normals(incidence(place, faces), place[None].astype(np.float32))[0].astype(np.float64)
    a, b, c = (place[faces[:, k]] for k in range(3))
    if np.einsum("na,na->", a, np.cross(b, c)) < 0:  # inside out
        normal = -normal
    way = feet - place[:, None]
    unit = way / np.maximum(far, 1e-12)[..., None]
    inwards = np.einsum("nbk,nk->nb", unit, normal) < 0
    step = np.minimum(1e-4, 0.1 * far)
    eyes = (place[:, None] + step[..., None] * unit)[inwards]
    met = np.zeros(inwards.shape, bool)
    if len(eyes):
        distance, _ = Flesh(place, faces).look(eyes, unit[inwards])
        met[inwards] = distance < (far - step)[inwards] - 1e-6
    return np.asarray((inwards & ~met) | (far < 1e-6))
