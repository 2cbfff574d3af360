"""Hanging another surface on a body: weights of the skin's nearest points, and the way back to the dress pose.

Where the surface lies close to the skin and faces as it does, each point takes the weights of the nearest point of the
skin, blended from the corners of its triangle. The rest (folds, wide sleeves, what is near another limb) is filled in
smoothly over the surface. Weights that the surface had before do not count. A surface that was reshaped or modelled in a
pose is taken back to the dress pose first, by the transforms that its own weights give there.

Sources: R. Abdrashitov et al., "Robust Skin Weights Transfer via Weight Inpainting" (2023), with a harmonic fill; for
the dress pose, seed 003, section 3.2: p_d of each influence is computed anew.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Body, Floats, Ints, Skeleton, Skin, Weights, floats, indices, require
from vitruvian.deform.deformer import deformer
from vitruvian.deform.normals import incidence, mesh_normals
from vitruvian.errors import VitruvianError, warn
from vitruvian.modeling.regions import strayed
from vitruvian.modeling.slicing import barycentric, cotangents
from vitruvian.modeling.weights import table

if TYPE_CHECKING:
    from scipy.sparse import csr_array

OPERATORS = (
    "linear",
    "dual-quaternion",
    "log",
    "log-pair",
    "log-absolute",
)  # whose transforms the weights alone decide
STEEP = 20.0  # the largest cotangent that counts: slivers do not tie points together
LIGHT = 1e-4  # weights below this are left out


class Surface(Protocol):
    """Anything with vertices (V,3), metres in humanoid space, and triangles (T,3): a Mesh, a Skin's own is `rest`."""

    @property
    def vertices(self) -> Floats: ...

    @property
    def triangles(self) -> Ints: ...


def transfer(
    body: Body,
    mesh: Surface,
    *,
    skeleton: Skeleton | None = None,
    matrices: Floats | None = None,
    operator: str = "log",
    distance: float = 0.03,
    angle: float = np.pi / 4,
) -> Skin:
    """The skin of another surface, such as a garment, that follows a body: (V,3) at rest with weights of its own.

    The mesh (metres, humanoid space) lies on the body at rest, or as it is with joint matrices (J,4,4) under `operator`;
    then it is taken back to the dress pose. With `skeleton`, that of a body of other size and shape in the same pose whose
    joints have the body's names, the mesh is that body's surface: the skin is brought onto it first (`modeling.aligning`);
    weights are for the joints of `body`, as ever. Only skin no farther than `distance` (metres) and turned by no more than
    `angle` (radians) against the surface gives weights; a part of the mesh where none is so takes the nearest, with a
    warning. Surfaces that are inside out are understood. Texture coordinates come along.
    Raises VitruvianError for a body without triangles, for shapes and options that do not fit, and where a transform
    cannot be undone.
    """
    made = match(body, mesh, skeleton=skeleton, matrices=matrices, operator=operator, distance=distance, angle=angle)
    return made.said().skin


@dataclass(frozen=True, eq=False)
class Matched:
    """A transfer: the new `skin` (n vertices), `source` (V,3), where the body's own skin was put to meet it, `foot` (n,V)
    sparse: which points of that skin are nearest to each vertex, and `blend` (n,V): the same without those that were not
    near enough, whose weights were filled in. `lost`: how many vertices are on pieces that are near to no skin at all."""

    skin: Skin
    source: Floats
    blend: csr_array
    foot: csr_array
    lost: int = 0

    def said(self, few: float = 0.0) -> Matched:
        """Itself, after a warning where more than a share of `few` are lost."""
        count = len(self.skin.rest)
        if self.lost > few * count:
            found = f"{self.lost} of {count} points lie on parts that are nowhere close to the skin"
            warn(f"transfer: {found}; they follow the nearest")
        return self


def match(
    body: Body,
    mesh: Surface,
    *,
    skeleton: Skeleton | None = None,
    matrices: Floats | None = None,
    operator: str = "log",
    distance: float = 0.03,
    angle: float = np.pi / 4,
) -> Matched:
    """As `transfer`, with what else can be carried over by the same points."""
    vertices = floats(mesh.vertices, "vertices", None, 3)
    triangles = indices(mesh.triangles, "triangles", len(vertices), None, 3)
    require(len(vertices) > 0, "transfer", "a mesh with vertices", "none")
    require(len(body.skin.triangles) > 0, "transfer", "a body with a surface", "none")
    require(getattr(mesh, "unit", "m") == "m", "transfer", "a mesh in metres", getattr(mesh, "unit", "m"))
    require(distance > 0, "distance", "more than 0 metres", distance)
    require(0 < angle <= np.pi, "angle", "0 to pi radians", angle)
    require(skeleton is None or matrices is None, "transfer", "a skeleton or matrices", "both")
    skin = body.skin.rest
    if matrices is not None:
        require(operator in OPERATORS, "operator", " or ".join(map(repr, OPERATORS)), repr(operator))
        skin = deformer(operator, body)(matrices).astype(np.float64)
    if skeleton is not None:
        from vitruvian.modeling.aligning import aligned

        require(len(triangles) > 0, "transfer", "a mesh with triangles", "none")
        skin = aligned(body, vertices, triangles, skeleton)
    place, same = np.unique(vertices, axis=0, return_inverse=True)
    same = same.reshape(-1)
    faces = same[triangles].astype(np.int32)
    blend, near = _nearest(body, skin, place, faces, distance, np.cos(angle), whole=skeleton is not None)
    weights = blend @ table(body.skin.weights, len(body.skeleton))
    links = cotangents(place, faces, 1 / STEEP, STEEP)
    lost = _lost(near, links)
    some = near | lost
    joint = np.zeros(len(place), np.int32)
    joint[some] = weights[some].argmax(axis=1).ravel()
    wrong = strayed(some, joint, place, faces, body.skeleton)
    near &= ~wrong
    filled = _filled(weights, some & ~wrong, links)
    rows = filled[same].tocoo()
    keep = rows.data > LIGHT
    pairs = Weights.from_pairs(len(vertices), rows.row[keep], rows.col[keep], rows.data[keep])
    total = np.asarray(filled.sum(axis=1)).ravel()[same] / np.where(pairs.sums > 0, pairs.sums, 1)
    pairs = Weights(pairs.row, pairs.joint, pairs.weight * total[pairs.vertex])
    uv, seams = getattr(mesh, "uv", None), getattr(mesh, "uv_triangles", None)
    out = Skin(vertices, triangles, pairs, uv, triangles if uv is not None and seams is None else seams)
    if matrices is not None:
        worn = replace(body, skin=out, contours=())
        out = replace(out, rest=dressed(worn, vertices, matrices, operator=operator))
    from scipy.sparse import diags_array

    return Matched(
        out, skin, (diags_array(near.astype(np.float64)) @ blend).tocsr()[same], blend[same], int(lost[same].sum())
    )


def dressed(body: Body, points: Floats, matrices: Floats, *, operator: str = "log") -> Floats:
    """Rest positions (V,3) with which the skin of `body` comes to lie at `points` (V,3) with joint matrices (J,4,4).

    For a body that was reshaped in a pose: its weights stay, its dress pose is computed anew.
    Raises VitruvianError for an operator whose transforms depend on the rest positions, and for a vertex whose transform
    cannot be undone (linear blending at half a turn).
    """
    require(operator in OPERATORS, "operator", " or ".join(map(repr, OPERATORS)), repr(operator))
    given = floats(points, "points", *body.skin.rest.shape)
    frames = deformer(operator, replace(body, skin=replace(body.skin, morphs=()))).frames(matrices).astype(np.float64)
    require(frames.ndim == 3, "matrices", "one pose, (J,4,4)", np.shape(matrices))
    flat = np.flatnonzero(np.abs(np.linalg.det(frames[..., :3])) < 1e-6)
    if flat.size:
        raise VitruvianError(f"dressed: vertex {flat[0]} is pressed flat in this pose by {operator!r}; use 'log'")
    back = np.linalg.solve(frames[..., :3], (given - frames[..., 3])[..., None])[..., 0]
    return np.asarray(back, np.float64)


def _nearest(
    body: Body, skin: Floats, place: Floats, faces: Ints, distance: float, cosine: float, *, whole: bool = False
) -> tuple[csr_array, NDArray[np.bool_]]:
    """(n,V) sparse: which points of the skin are nearest; (n,) whether these are near enough and face the same way.

    `whole`: the mesh is all of a body; its largest piece answers to the skin's largest piece, not to lashes or clothes;
    the rest answers to what is seen.
    """
    from vitruvian.modeling.aligning import main_piece, uncovered

    t, every = body.skin.triangles, uncovered(body.skin).triangles
    own, theirs = (
        mesh_normals(incidence(p, f), p[None].astype(np.float32))[0].astype(np.float64)
        for p, f in ((place, faces), (skin, every))
    )
    blend, squared = _feet(place, skin, t)
    if whole:
        from scipy.sparse import diags_array

        main = np.zeros(len(place), bool)
        main[main_piece(place, faces)] = True
        found, far = _feet(place[main], skin, main_piece(body.skin.rest, every))
        number = np.cumsum(main) - 1
        blend = (diags_array((~main) * 1.0) @ blend + diags_array(main * 1.0) @ found[np.maximum(number, 0)]).tocsr()
        squared[main] = far
    agree = np.einsum("na,na->n", own, blend @ theirs)
    close = squared <= distance**2
    if agree[close].sum() < 0:  # inside out
        agree = -agree
    return blend, close & (agree >= cosine)


def _feet(place: Floats, skin: Floats, t: Ints) -> tuple[csr_array, Floats]:
    """(n,V) sparse: the nearest points of a skin's triangles (t,3) to places (n,3), and their squared distances (n,)."""
    import igl

    from vitruvian.modeling.shrink import blend

    squared, face, foot = igl.point_mesh_squared_distance(place, skin, t.astype(np.int64))[:3]
    corners = t[np.asarray(face).reshape(-1)]
    share = barycentric(skin[corners], np.asarray(foot, np.float64).reshape(-1, 3))
    return blend(corners, share, len(skin)), np.asarray(squared, np.float64).reshape(-1)


def _lost(near: NDArray[np.bool_], links: csr_array) -> NDArray[np.bool_]:
    """(n,) points on parts of the surface without any that is `near`."""
    from scipy.sparse.csgraph import connected_components

    part = connected_components(links, directed=False)[1]
    known = np.bincount(part, near, minlength=part.max(initial=-1) + 1) > 0
    return np.asarray(~known[part], bool)


def _filled(weights: csr_array, fixed: NDArray[np.bool_], links: csr_array) -> csr_array:
    """(n,J) sparse: `weights` where `fixed`, elsewhere harmonic over the surface."""
    from scipy.sparse import csr_array, diags_array, vstack
    from scipy.sparse.linalg import splu

    n = len(fixed)
    free = np.flatnonzero(~fixed)
    if not len(free):
        return weights
    held = np.flatnonzero(fixed)
    laplacian = (diags_array(np.asarray(links.sum(axis=1)).ravel()) - links).tocsr()
    used = np.unique(weights[held].indices)
    right = (links[free][:, held] @ weights[held][:, used]).toarray()
    solved = np.maximum(splu(laplacian[free][:, free].tocsc()).solve(right), 0)
    inner = csr_array(solved)
    inner = csr_array((inner.data, used[inner.indices], inner.indptr), shape=(len(free), weights.shape[1]))
    where = np.empty(n, np.int64)
    where[held], where[free] = np.arange(len(held)), len(held) + np.arange(len(free))
    return vstack([weights[held], inner]).tocsr()[where]
