"""A dressed body changes its shape, and its garment follows: at once, by the binding of cloth to skin, then at rest.

Source: note cloth.md, section 8; seed 003, sections 5.3 and 6.3.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.rotations import from_matrix
from vitruvian.body.types import Body, Floats, Ints, floats, require
from vitruvian.cloth.binding import Binding, bind
from vitruvian.cloth.fit_map import gradients, stretch_of
from vitruvian.cloth.garment import Garment, buttoned
from vitruvian.cloth.obstacle import Obstacle, still
from vitruvian.cloth.placing import Dummy, posed
from vitruvian.cloth.sheet import Sheet
from vitruvian.cloth.solver import FRAME, Pairs, assemble, step
from vitruvian.cloth.tailor import CALM, LOOSE, STILL, fitting
from vitruvian.cloth.untangling import untangle

POLICIES = ("keep_pattern", "grade")
SECONDS = 3.0  # of draping anew at most


def refitted(
    garment: Garment,
    before: Body | Floats,
    after: Body,
    *,
    policy: str = "keep_pattern",
    seconds: float | None = None,
) -> Garment:
    """The garment on a body of another shape, which stands as the one that it was sewn on.

    before and after: the same body with different measures, that is with the same joints and the same triangles; of the one
    before, its skin (V,3) as it stood in the garment will do. policy:
    "keep_pattern": the cloth stays as it was cut and drapes anew, for up to `seconds` (None: 3), so that it pulls where
    the body has become larger; "grade": it is cut larger or smaller by as much as the skin below it has changed, so that
    what is between cloth and skin stays the same, and is not draped unless `seconds` says so. On an unchanged body it is
    the same garment, bit for bit. Garments below it follow each by itself. Raises VitruvianError for another body.
    """
    require(policy in POLICIES, "policy", " or ".join(POLICIES), repr(policy))
    skin = standing(garment, before).vertices if isinstance(before, Body) else floats(before, "skin", None, 3)
    other = standing(garment, after)
    changed = moved(garment, skin, other.vertices, other.triangles)
    below = tuple(refitted(g, skin, after, policy=policy, seconds=seconds) for g in garment.below)
    made = replace(changed, matrices=other.matrices, below=below, hung=None)
    if policy == "grade":
        made = graded(made, garment)
    long = (SECONDS if policy == "keep_pattern" else 0.0) if seconds is None else seconds
    if np.array_equal(skin, other.vertices):
        return replace(made, report=garment.report, hung=garment.hung)
    return settled(made, still(other.vertices, other.triangles), long)


def standing(garment: Garment, body: Body) -> Dummy:
    """A body in the pose that a garment was sewn in; VitruvianError where it has other joints."""
    skeleton = body.skeleton
    found = f"{len(skeleton)}"
    require(len(garment.matrices) == len(skeleton), "body", f"the {len(garment.matrices)} joints it was sewn on", found)
    turn = garment.matrices[:, :3, :3].copy()
    parents = np.asarray(skeleton.parents)
    inner = parents >= 0
    turn[inner] = np.swapaxes(garment.matrices[parents[inner], :3, :3], 1, 2) @ turn[inner]
    return posed(body, pose_matrices(skeleton, from_matrix(turn)[None], np.zeros((1, len(skeleton), 3)))[0])


def moved(garment: Garment, before: Floats, after: Floats, triangles: Ints) -> Garment:
    """The garment with the skin, vertices (V,3) and triangles (t,3), moved: at once, without draping.

    What hangs within 50 mm of skin that faces the same way keeps its place in the frame of its foot; the rest moves as
    smoothly as it can between. Where the skin does not move, nothing does, to the last bit.
    """
    require(len(before) == len(after), "skin", f"the {len(before)} points that it was sewn on", len(after))
    bound = bind(before, triangles, garment.vertices, garment.triangles)
    return replace(garment, vertices=garment.vertices + displaced(bound, garment.sheet, before, after), hung=None)


def displaced(bound: Binding, sheet: Sheet, before: Floats, after: Floats) -> Floats:
    """(n,3) metres by which bound vertices follow a skin, and those that are far from it their neighbours."""
    change = bound.at(after) - bound.at(before)
    near = bound.facing & (bound.distance <= LOOSE)
    return change if near.all() or not near.any() else _harmonic(change, near, sheet)


def _harmonic(values: Floats, known: NDArray[np.bool_], sheet: Sheet) -> Floats:
    """(n,3) `values` where known; elsewhere harmonic over the sheet, or as they are on pieces where none is known."""
    from scipy.sparse import coo_array, diags_array
    from scipy.sparse.csgraph import connected_components
    from scipy.sparse.linalg import splu

    n, (a, b) = len(values), sheet.edges.T
    links = coo_array((np.ones(len(a)), (a, b)), (n, n))
    links = (links + links.T).tocsr()
    piece = connected_components(links, directed=False)[1]
    known = known | ~(np.bincount(piece, known) > 0)[piece]
    free, held = np.flatnonzero(~known), np.flatnonzero(known)
    if not len(free):
        return values
    laplacian = (diags_array(np.asarray(links.sum(axis=1)).ravel()) - links).tocsr()
    out = values.copy()
    out[free] = splu(laplacian[free][:, free].tocsc()).solve(links[free][:, held] @ values[held])
    return out


def graded(made: Garment, before: Garment) -> Garment:
    """The garment cut so that each triangle of `made` is strained as it was `before` its body changed.

    Each triangle's place in the cloth is stretched as its place in space was, without turning: with the principal
    stretches U before and V after, by U^-1 V.
    """
    sheet = before.sheet
    if np.array_equal(made.vertices, before.vertices):
        return made
    u, v = (stretch_of(np.einsum("mki,mkj->mij", f, f)) for f in (gradients(sheet, g.vertices) for g in (before, made)))
    way = np.linalg.inv(u) @ v
    return replace(made, graded=sheet.material @ np.swapaxes(way, 1, 2))


def held(garment: Garment, gap: float) -> Pairs:
    """What is buttoned, `gap` metres apart at most."""
    buttons = garment.weld[buttoned(garment.pattern, garment.mesh)]
    far = np.full(len(buttons), gap)
    return Pairs(buttons, far, far)


FINE, FRAMES = 200, 10  # substeps and frames in which cloth takes the strain that its fabric would


def firmed(garment: Garment, obstacle: Obstacle) -> Garment:
    """The garment where it rests when the solver takes ten times finer steps, to ask it for its strain and its pressure.

    A stiff cloth on coarse steps hangs as if it were softer, by the square of their length (see the solver): its stretch is
    hardly seen, but times its modulus it would be a multiple of the weight that it bears."""
    cloth = assemble(garment.sheet, gap=max(1e-3, *(f.thickness for f in garment.fabrics)))
    state = cloth.state(garment.vertices)
    for _ in range(FRAMES):
        state = step(cloth, state, damping=2.0, obstacle=obstacle, substeps=FINE, pairs=held(garment, cloth.gap))
    return replace(garment, vertices=state.x.astype(np.float64))


def settled(garment: Garment, obstacle: Obstacle, seconds: float) -> Garment:
    """The garment draped where it hangs, until it rests or for `seconds`, and what cuts itself untangled; its report says
    how it lies."""
    sheet = garment.sheet
    x, calm, speed = garment.vertices, True, 0.0
    if seconds > 0:
        cloth = assemble(sheet, gap=max(1e-3, *(f.thickness for f in garment.fabrics)))
        state, speeds = cloth.state(x), deque([np.inf] * CALM, CALM)
        for _ in range(max(1, round(seconds / FRAME))):
            state = step(cloth, state, damping=2.0, obstacle=obstacle, pairs=held(garment, cloth.gap))
            speeds.append(state.speed)
            if np.mean(speeds) < STILL:
                break
        x, calm, speed = state.x.astype(np.float64), bool(np.mean(speeds) < STILL), state.speed
        x = untangle(x, sheet.triangles, obstacle=obstacle).positions
    report: dict[str, Any] = {**garment.report, "settled": calm, "speed": speed, **fitting(sheet, x, obstacle)}
    return replace(garment, vertices=x, report=report)
