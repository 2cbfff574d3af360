"""The shape of the built-in person that is nearest to a scan: its sliders and its pose, solved together.

Every slider moves the points of the A pose and, through these, the joint centres; bones carry both into the scan's pose.
A Gauss-Newton step of sliders and joint parameters is a ridge least-squares problem within the sliders' bounds.
Source: note body.md, sections 2.3 and 3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.modeling import anatomy, source
from vitruvian.modeling.bones import Bones, Rows, changed, flat, jacobian, placed, posed
from vitruvian.modeling.shape import WEIGHTS, Shape, details, shaped
from vitruvian.modeling.template import Template

MACROS = ("gender", "age", "muscle", "weight", "height", "proportions", "cup", "firmness")
ORIGIN = 3
YEARS = 25.0  # of one unit of age
STEP = 0.1
PULL_MACRO, PULL_DETAIL = 2e-4, 1e-3  # against squares of landmarks that are 1 cm off
# Sliders of the face's small parts are left to the free refinement: scans are seldom that good.
_SMALL = (
    "chin-",
    "mouth-",
    "nose-",
    "eye-",
    "cheek-",
    "ear-",
    "forehead-",
    "neck-double",
    "breast-point",
    "hand-fingers",
)


@cache
def slider_names() -> tuple[str, ...]:
    """The sliders that a fit moves: macro sliders, origins, details of the body."""
    chosen = [n for n in details() if not n.removeprefix("l-").removeprefix("r-").startswith(_SMALL)]
    return (*MACROS, "african", "asian", "caucasian", *chosen)


def values_of(shape: Shape) -> Floats:
    """(K,) of `slider_names`; age in units of 25 years."""
    macro = [getattr(shape, m) / (YEARS if m == "age" else 1) for m in MACROS]
    return np.array(
        [*macro, *shape.origin, *(shape.details.get(n, 0.0) for n in slider_names()[len(MACROS) + ORIGIN :])]
    )


def shape_of(values: Floats) -> Shape:
    """The sliders with these values (K,), kept in their bounds."""
    low, high = bounds()
    v = np.clip(values, low, high)
    fields: dict[str, Any] = {m: float(v[k]) * (YEARS if m == "age" else 1) for k, m in enumerate(MACROS)}
    start = len(MACROS)
    origin = v[start : start + ORIGIN] + 1e-6
    found = dict(zip(slider_names()[start + ORIGIN :], v[start + ORIGIN :].tolist(), strict=True))
    a, b, c = (origin / origin.sum()).tolist()
    return Shape(**fields, origin=(a, b, c), details={n: x for n, x in found.items() if abs(x) > 1e-4})


@cache
def bounds() -> tuple[Floats, Floats]:
    """(K,) least and greatest values."""
    macro = {"age": (14 / YEARS, 85 / YEARS), "weight": WEIGHTS}
    some = [macro.get(m, (0.0, 1.0)) for m in MACROS] + [(0.0, 1.0)] * ORIGIN
    some += [(-1.0, 1.0)] * (len(slider_names()) - len(some))
    low, high = np.array(some).T
    return low, high


@cache
def _detail_moves() -> tuple[Floats, Floats]:
    """(K,13380,3) float32 how the details move the body per unit, and (K,146,3) the centres; mean of both sides."""
    names = slider_names()[len(MACROS) + ORIGIN :]
    points = np.zeros((len(names), source.BODY, 3), np.float32)
    centers = np.zeros((len(names), len(anatomy.names()), 3))
    for k, name in enumerate(names):
        both = np.zeros_like(source.points())
        for word, sign in (("incr", 0.5), ("decr", -0.5)):
            index, offset = source.target(f"{name}-{word}")
            both[index] += sign * offset
        points[k], centers[k] = both[: source.BODY], anatomy.centers(both)
    return points, centers


def moves(values: Floats) -> tuple[Floats, Floats]:
    """(K,13380,3) and (K,146,3): how body points and centres move per unit of each slider, about these values."""
    low, high = bounds()
    some, joints = [], []
    for k in range(len(MACROS) + ORIGIN):
        up, down = values.copy(), values.copy()
        up[k], down[k] = min(values[k] + STEP, high[k]), max(values[k] - STEP, low[k])
        change = (shaped(shape_of(up)) - shaped(shape_of(down))) / (up[k] - down[k])
        some.append(change[: source.BODY].astype(np.float32))
        joints.append(anatomy.centers(change))
    points, centers = _detail_moves()
    return np.concatenate([np.array(some), points]), np.concatenate([np.array(joints), centers])


@dataclass(frozen=True, eq=False)
class Likeness:
    """Sliders (K,) and joint parameters that were found, and the template of these sliders."""

    values: Floats
    bones: Bones
    template: Template


def reshaped(template: Template, values: Floats) -> Template:
    """The template with other sliders."""
    points = shaped(shape_of(values))
    return replace(template, points=points[: source.BODY], centers=anatomy.centers(points))


def _slopes(template: Template, bones: Bones, rows: Rows, moved: tuple[Floats, Floats]) -> Floats:
    """(n,K) how the distance of each row changes with the sliders."""
    parents, centers = template.parents, template.centers
    frame = posed(parents, centers, template.axes, bones)
    linear = frame.turn @ frame.stretch
    by_points, by_centers = moved
    place = by_centers.copy()  # (K,J,3) of the centres in the world
    for j, p in enumerate(parents):
        if p >= 0:
            place[:, j] = place[:, p] + (by_centers[:, j] - by_centers[:, p]) @ linear[p].T
    place -= np.einsum("jab,kjb->kja", linear, by_centers)
    count, sliders = len(rows.at), len(place)
    shift = rows.weights @ place.transpose(1, 2, 0).reshape(len(parents), -1)
    out = np.einsum("na,nak->nk", rows.along, shift.reshape(count, 3, sliders))
    blend = (rows.weights @ linear.reshape(-1, 9)).reshape(-1, 3, 3)
    local = np.einsum("na,nab->nb", rows.along, blend)  # the direction, in the template
    used, where = np.unique(rows.vertex.indices, return_inverse=True)
    small = type(rows.vertex)((rows.vertex.data, where, rows.vertex.indptr), shape=(count, len(used)))
    for a in range(3):
        out += local[:, a, None] * (small @ by_points[:, used, a].T.astype(np.float64))
    return out


def improved(
    found: Likeness, rows: Rows, *, usual: Floats, firm: float = 1.0, moved: tuple[Floats, Floats] | None = None
) -> Likeness:
    """One step of sliders and joint parameters together; the same again when it is no improvement.

    usual (K,): the values that the ridge pulls sliders to; firm: factor on what holds back scales of bones.
    """
    from scipy.optimize import lsq_linear

    t, bones, knobs = found.template, found.bones, found.template.knobs
    scales = np.array([n.startswith(("scale", "shift")) and not n.startswith("shift root") for n in knobs.names])
    pull = knobs.pull * np.where(scales, firm, 1.0)
    tie = knobs.tie * firm
    mean = knobs.links / np.maximum(np.asarray(abs(knobs.links).sum(axis=0)).ravel(), 1e-12)
    macro = len(MACROS) + ORIGIN
    ridge = np.r_[np.full(macro, PULL_MACRO), np.full(len(found.values) - macro, PULL_DETAIL)]

    def cost(trial: Likeness) -> tuple[float, Floats]:
        frame = posed(t.parents, trial.template.centers, t.axes, trial.bones)
        here = placed(replace(rows, at=rows.vertex @ trial.template.points), frame, trial.template.centers)
        short = ((rows.goal - here) * rows.along).sum(axis=1)
        off = mean.T @ flat(trial.bones)
        gap = off[knobs.pairs[:, 0]] - off[knobs.pairs[:, 1]]
        total = rows.trust @ short**2 + pull @ off**2 + tie @ gap**2 + ridge @ (trial.values - usual) ** 2
        return float(total), short

    now = replace(rows, at=rows.vertex @ t.points)
    before, short = cost(found)
    frame = posed(t.parents, t.centers, t.axes, bones)
    by_bones = jacobian(t.parents, t.centers, t.axes, bones, frame, now) @ knobs.links
    by_shape = _slopes(t, bones, now, moves(found.values) if moved is None else moved)
    slope = np.concatenate([by_shape, by_bones], axis=1)
    hessian = slope.T @ (slope * rows.trust[:, None])
    downhill = slope.T @ (rows.trust * short)
    off = mean.T @ flat(bones)
    keep = (mean.T @ knobs.links).toarray()  # turns are small against the prior's reach: their own axes serve
    pairs = keep[knobs.pairs[:, 0]] - keep[knobs.pairs[:, 1]]
    gap = off[knobs.pairs[:, 0]] - off[knobs.pairs[:, 1]]
    k = len(found.values)
    hessian[k:, k:] += keep.T @ (pull[:, None] * keep) + pairs.T @ (tie[:, None] * pairs)
    downhill[k:] -= keep.T @ (pull * off) + pairs.T @ (tie * gap)
    hessian[:k, :k] += np.diag(ridge)
    downhill[:k] -= ridge * (found.values - usual)
    low, high = bounds()
    span = np.full(len(downhill) - k, np.inf)
    limits = np.r_[low - found.values - 1e-9, -span], np.r_[high - found.values + 1e-9, span]
    size = np.diag(hessian)
    for damping in (1e-6, 1e-2, 0.1, 1.0):
        factor = np.linalg.cholesky(hessian + np.diag(damping * size + 1e-9)).T
        step = lsq_linear(factor, np.linalg.solve(factor.T, downhill), bounds=limits, method="bvls", max_iter=60).x
        values = np.clip(found.values + step[:k], low, high)
        trial = Likeness(values, changed(bones, knobs.links @ step[k:]), reshaped(t, values))
        if cost(trial)[0] < before:
            return trial
    return found
