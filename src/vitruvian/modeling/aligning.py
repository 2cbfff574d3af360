"""Skeleton first: the skin of one body brought onto the surface of another, by their joints and by what surfaces look like.

The skin goes along with the joint centres; where it is the built-in person's, its shape space then says how people differ
about their bones; free offsets that a Laplacian keeps smooth do the rest. A point answers that one of the other surface
which lies close, faces as it does and is as hollow or as round, at two sizes: so noses find noses, not just the nearest.
Sources: note body.md, sections 3 and 4; F. L. Bookstein, "Principal Warps: Thin-Plate Splines and the Decomposition of
Deformations" (1989); B. Allen, B. Curless, Z. Popovic, "The space of human body shapes" (2003); for the hollows, M. Desbrun
et al., "Implicit Fairing of Irregular Meshes using Diffusion and Curvature Flow" (1999).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Body, Floats, Ints, Skeleton, Skin
from vitruvian.errors import VitruvianError, warn
from vitruvian.hanim import tables
from vitruvian.modeling import shrink, source
from vitruvian.modeling.slicing import cotangents

SIZES = (0.006, 0.03)
FACING, HOLLOW = 0.05, 3.0  # metres that a turned normal (by a radian), and times that a hollow, counts in a match
SAMPLES = 2000
SHAPES = 8  # rounds of the shape space
STIFF = (10.0,)  # of the free offsets, round by round
LITTLE = 0.09  # how much of a distance along the surface counts
TAME = 1e-3  # how much sliders are held back
FEW = 4  # joints that a body must share with the skeleton it is brought to
NEAR = 6
MOST, PIECE = 0.5, 0.01  # of a surface's area: the piece that is the body, or of those that are


@dataclass(frozen=True, eq=False)
class Look:
    """A surface to match: points (n,3), unit normals (n,3), how round it is at each of `SIZES` (n,2), metres."""

    points: Floats
    normals: Floats
    round: Floats

    @staticmethod
    def of(points: Floats, triangles: Ints) -> Look:
        normals = shrink.vertex_normals(points, triangles)
        return Look(points, normals, roundness(points, triangles, normals))

    def keys(self, facing: float = FACING, hollow: float = HOLLOW) -> Floats:
        """(n,8) between which distances are taken."""
        return np.concatenate([self.points, facing * self.normals, hollow * self.round], axis=1)


def roundness(points: Floats, triangles: Ints, normals: Floats) -> Floats:
    """(n,2) how far each point lies outside the surface smoothed over each of `SIZES`, metres, larger sizes toned down."""
    from scipy.sparse import diags_array

    links = cotangents(points, triangles, 0.05, 20.0) * 0.5
    laplacian = diags_array(np.asarray(links.sum(axis=1)).ravel()) - links
    mass = diags_array(shrink.areas(points, triangles) + 1e-12)
    out = []
    for size in SIZES:
        smooth = _solver(mass + size**2 * laplacian).solve(mass @ points)
        out.append(((points - smooth) * normals).sum(axis=1) * np.sqrt(0.01 / size))
    return np.stack(out, axis=1)


def _solver(matrix: Any) -> Any:
    """Of a symmetric sparse matrix."""
    from scipy.sparse.linalg import splu

    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def shared(skeleton: Skeleton, other: Skeleton) -> Ints:
    """(J,) for each joint of a skeleton the one of the other that the standard calls the same, -1 for none."""
    names: dict[str, int] = {}
    for j, name in enumerate(other.names):
        names.setdefault(tables.canonical(name) or name, j)
        names.setdefault(name, j)
    return np.array([names.get(n, names.get(tables.canonical(n) or n, -1)) for n in skeleton.names], np.int32)


def held_by(skeleton: Skeleton, other: Skeleton) -> tuple[Ints, Floats]:
    """For each joint of a skeleton (J,) itself, or the nearest above it, that another skeleton has, too, and (J,3) by how
    much that one's centre is elsewhere there. Joints above all shared ones go with the first of these.

    Raises VitruvianError when there are fewer than 4 joints that the two share.
    """
    same = shared(skeleton, other)
    if (same >= 0).sum() < min(FEW, len(skeleton)):
        some = ", ".join(other.names[:4])
        raise VitruvianError(
            f"skeleton: expected at least {FEW} joints with the names of the source's, found {int((same >= 0).sum())} "
            f"(it has {some} ...); rename them, or transfer to the mesh alone"
        )
    held = np.arange(len(skeleton), dtype=np.int32)
    for j, p in enumerate(skeleton.parents):
        if same[j] < 0:
            held[j] = held[p] if p >= 0 else int(np.argmax(same >= 0))
    return held, other.centers[same[held]] - skeleton.centers[held]


def aligned(body: Body, points: Floats, triangles: Ints, skeleton: Skeleton) -> Floats:
    """(V,3) the skin of `body` at rest brought onto a surface at rest, points (n,3) and triangles (t,3), metres.

    `skeleton` is that surface's; joints of the body that it lacks go with those above them.
    Only the largest pieces of the two are matched; what else
    belongs to the body goes along. Deterministic.
    """
    rest, weights = body.skin.rest, _matrix(body)
    piece = main_piece(rest, uncovered(body.skin).triangles)
    whole = shrink.surface_of(points, triangles)[0]
    used, number = np.unique(main_piece(whole.vertices, whole.triangles), return_inverse=True)
    goal = Look.of(whole.vertices[used], number.reshape(-1, 3).astype(np.int32))
    mine, number = np.unique(piece, return_inverse=True)
    faces = number.reshape(-1, 3).astype(np.int32)
    start = rest[mine]
    held, step = held_by(body.skeleton, skeleton)
    modes = _modes(body, mine, piece, held)
    look = Look.of(start, faces)
    if modes is None:
        known = np.unique(held)
        before = body.skeleton.centers[known]
        first = _spline(before, before + step[known], start)
    else:
        first = _shaped(start + weights[mine] @ step, modes, look, faces, goal)
    if np.linalg.norm(first - start, axis=1).mean() > 0.5:
        warn("transfer: the skeleton of the target stands far from the source's; the weights may suffer")
    moved = _freed(first, look, faces, goal)
    return _followed(rest, mine, moved)


def main_piece(points: Floats, triangles: Ints) -> Ints:
    """(t,3) the triangles of a surface that are a body: see `is_main`."""
    return triangles[is_main(points, triangles)]


def is_main(points: Floats, triangles: Ints) -> NDArray[np.bool_]:
    """(t,) which triangles are the piece of a surface that has most of its area; points at one place count as one.

    Where none has (a body of Segments, skin cut out under clothes) all larger pieces are.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    same = np.unique(points, axis=0, return_inverse=True)[1].reshape(-1)
    t = same[triangles]
    n = int(same.max(initial=-1)) + 1
    pairs = csr_array((np.ones(2 * len(t)), (np.r_[t[:, 0], t[:, 1]], np.r_[t[:, 1], t[:, 2]])), shape=(n, n))
    part = connected_components(pairs, directed=False)[1][t[:, 0]]
    a, b, c = (points[triangles[:, k]] for k in range(3))
    area = np.bincount(part, np.linalg.norm(np.cross(b - a, c - a), axis=1), minlength=1)
    large = area >= (MOST if area.max() >= MOST * area.sum() else PIECE) * area.sum()
    return np.asarray(large[part], bool)


def hidden(skin: Skin) -> Ints:
    """(h,) which of the built-in person's triangles are left out under clothes; none for other bodies.

    Points and weights of such skin are kept, whoever wears the clothes, so that it can be had again.
    """
    stop, none = skin.parts[0].stop, np.zeros(0, np.int32)
    base, shown = source.array("triangles"), skin.triangles[:stop]
    if len(skin.rest) < source.BODY or not 0 < stop < len(base) or len(skin.rest) >= 1 << 20:
        return none
    if (skin.weights.sums[: source.BODY] <= 0).any() or not np.isin(_keys(shown), _base_keys()).all():
        return none
    return np.flatnonzero(~np.isin(_keys(base), _keys(shown))).astype(np.int32)


def uncovered(skin: Skin) -> Skin:
    """The skin with what clothes hide of a built-in person, as more triangles of its first part."""
    add = hidden(skin)
    if not len(add):
        return skin
    stop, corners = skin.parts[0].stop, skin.uv_triangles
    triangles = np.concatenate([skin.triangles[:stop], source.array("triangles")[add], skin.triangles[stop:]])
    if corners is not None and skin.uv is not None:
        places = source.array("uv_triangles")
        if len(skin.uv) < len(source.array("uv")) or not np.isin(_keys(corners[:stop]), _keys(places)).all():
            corners = None
        else:
            corners = np.concatenate([corners[:stop], places[add], corners[stop:]])
    first, *rest = skin.parts
    more = len(add)
    parts = (replace(first, stop=stop + more), *(replace(p, start=p.start + more, stop=p.stop + more) for p in rest))
    uv = None if corners is None else skin.uv
    return replace(skin, triangles=triangles, uv=uv, uv_triangles=corners, parts=parts)


def _matrix(body: Body) -> Any:
    """(V,J) sparse weights that sum to 1."""
    from vitruvian.modeling.template import normalised
    from vitruvian.modeling.weights import table

    return normalised(table(body.skin.weights, len(body.skeleton)))


def _spline(before: Floats, after: Floats, points: Floats) -> Floats:
    """(n,3) points moved as smoothly as can be so that joints go from `before` (J,3) to `after` (J,3)."""
    from scipy.spatial.distance import cdist

    _, some = np.unique(np.round(before, 3), axis=0, return_index=True)
    a, b = before[some], after[some]
    count = len(a)
    flat = np.c_[np.ones(count), a]
    # a little of a ridge: joints may lie in a plane, which says nothing of the way across it
    left = np.block([[cdist(a, a), flat], [flat.T, -1e-3 * np.eye(4)]])
    left[-4, -4] = 0 if count > 1 else -1e-9
    bend = np.linalg.lstsq(left, np.r_[b - a, np.zeros((4, 3))], rcond=1e-10)[0]
    return points + cdist(points, a) @ bend[:count] + np.c_[np.ones(len(points)), points] @ bend[count:]


@cache
def _base_keys() -> NDArray[np.int64]:
    """Sorted keys of the triangles of the built-in person."""
    return np.sort(_keys(source.array("triangles")))


def _keys(triangles: Any) -> NDArray[np.int64]:
    t = np.sort(np.asarray(triangles, np.int64), axis=1)
    return (t[:, 0] << 40) | (t[:, 1] << 20) | t[:, 2]


def _modes(body: Body, mine: Any, piece: Ints, held: Ints) -> Floats | None:
    """(n,3,K) how sliders of the built-in person move skin about the joints that hold it, `held` (J,) for each joint; None
    when the body is not such a person."""
    from vitruvian.modeling import anatomy
    from vitruvian.modeling.likeness import moves, values_of
    from vitruvian.modeling.shape import Shape, shaped

    place = {n: i for i, n in enumerate(anatomy.names())}
    names = body.skeleton.names
    if len(mine) < 100 or mine[-1] >= source.BODY or not all(n in place for n in names):
        return None
    if np.isin(_keys(piece), _base_keys()).mean() < 0.95:
        return None
    base, rest = shaped(Shape())[mine], body.skin.rest[mine]
    weights = _matrix(body)[mine]
    # the turn of each joint from the data's A pose to rest, as its own skin shows it
    share = weights.T.tocsr()
    size = np.asarray(share.sum(axis=1)).ravel()[:, None] + 1e-9
    a, b = share @ base / size, share @ rest / size
    cross = (share @ (rest[:, :, None] * base[:, None, :]).reshape(-1, 9)).reshape(-1, 3, 3)
    u, _, vt = np.linalg.svd(cross - size[..., None] * b[:, :, None] * a[:, None, :] + 1e-9 * np.eye(3))
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    turn = u @ vt
    skin, centers = moves(values_of(Shape()), np.asarray(mine, np.int32))
    order = [place[n] for n in names]
    count = len(skin)
    blended = (weights @ turn.reshape(-1, 9)).reshape(-1, 3, 3).astype(np.float32)
    out = np.einsum("vab,kvb->vak", blended, skin.astype(np.float32), optimize=True)
    joints = np.einsum("jab,kjb->jak", turn, centers[:, order])[held]
    out -= (weights.astype(np.float32) @ joints.reshape(len(order), -1).astype(np.float32)).reshape(-1, 3, count)
    return out


def _shaped(first: Floats, modes: Floats, look: Look, faces: Ints, goal: Look) -> Floats:
    """(n,3) skin that sliders have brought nearest to the goal, from where the joints have brought it."""
    from scipy.linalg import cho_factor, cho_solve
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(0)
    tree = cKDTree(goal.keys(2 * FACING))
    points, count = first, modes.shape[2]
    for _ in range(SHAPES):
        now = Look(points, shrink.vertex_normals(points, faces), look.round)
        some = rng.choice(len(points), min(SAMPLES, len(points)), replace=False)
        index = tree.query(now.keys(2 * FACING)[some], workers=-1)[1]
        far = np.linalg.norm(goal.points[index] - points[some], axis=1)
        good = (now.normals[some] * goal.normals[index]).sum(axis=1) > 0.6
        good &= far <= np.quantile(far, 0.9)
        some, index, far = some[good], index[good], far[good]
        trust = 1 / (1 + (far / 0.02) ** 2)
        short = (goal.points[index] - first[some]).astype(np.float32)
        move, normal = modes[some], goal.normals[index].astype(np.float32)
        # distances to the plane, and a little to the point: rows whose squares are trust * (n n' + little * 1)
        root, more = np.sqrt(trust).astype(np.float32)[:, None], np.float32(np.sqrt(1 + LITTLE) - np.sqrt(LITTLE))
        ahead = normal * ((normal * short).sum(axis=1, keepdims=True) * more) + short * np.float32(np.sqrt(LITTLE))
        along = np.einsum("na,nak->nk", normal, move, optimize=True) * more
        rows = normal[:, :, None] * along[:, None, :]
        rows += move * np.float32(np.sqrt(LITTLE))
        rows = (rows * root[:, :, None]).reshape(-1, count)
        left = (rows.T @ rows).astype(np.float64)
        left[np.diag_indices(count)] += TAME
        right = rows.T @ (root * ahead).ravel()
        found = cho_solve(cho_factor(left, overwrite_a=True), right)
        points = first + modes @ found.astype(np.float32)
    return points


def _freed(first: Floats, look: Look, faces: Ints, goal: Look) -> Floats:
    """(n,3) skin drawn onto the goal by free offsets from where it is."""
    from scipy.sparse import csr_array
    from scipy.spatial import cKDTree

    smooth = shrink.laplacian(first, faces)
    points, count = first, len(first)
    tree = cKDTree(goal.keys())
    for stiff in STIFF:
        now = Look(points, shrink.vertex_normals(points, faces), look.round)
        index = tree.query(now.keys(), workers=-1)[1]
        good = (now.normals * goal.normals[index]).sum(axis=1) > 0.5
        back = cKDTree(now.keys()).query(goal.keys(), workers=-1)[1]  # what points of the goal want of the skin
        agree = 0.5 * ((goal.normals * now.normals[back]).sum(axis=1) > 0.5)
        wants = csr_array((agree, (back, np.arange(len(back)))), shape=(count, len(back)))
        asked = np.asarray(wants.sum(axis=1)).ravel()
        pull = good + asked
        total = good[:, None] * (goal.points[index] - first) + wants @ goal.points - asked[:, None] * first
        step = shrink.offsets(smooth, pull, total / np.maximum(pull, 1e-9)[:, None], np.full(count, stiff))
        points = shrink.unfolded(points, first + step - points, faces, smooth)[0]
    return points


def _followed(rest: Floats, mine: Any, moved: Floats) -> Floats:
    """(V,3) all points: those of the matched piece where they have gone, the others along with the nearest of them."""
    from scipy.spatial import cKDTree

    out = rest.copy()
    out[mine] = moved
    others = np.setdiff1d(np.arange(len(rest)), mine)
    if len(others):
        far, near = cKDTree(rest[mine]).query(rest[others], k=min(NEAR, len(mine)))
        far, near = far.reshape(len(others), -1), near.reshape(len(others), -1)
        share = 1 / (far + 0.004) ** 2
        share /= share.sum(axis=1, keepdims=True)
        out[others] += np.einsum("nk,nka->na", share, (moved - rest[mine])[near])
    return out
