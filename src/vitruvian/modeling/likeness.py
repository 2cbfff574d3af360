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

from vitruvian.body.types import Floats, Ints
from vitruvian.modeling import anatomy, source
from vitruvian.modeling.bones import Bones, Rows, changed, flat, jacobian, placed, posed, skinned
from vitruvian.modeling.shape import WEIGHTS, Shape, details, factors, shaped
from vitruvian.modeling.template import Template

MACROS = ("gender", "age", "muscle", "weight", "height", "proportions", "cup", "firmness")
ORIGIN = 3
DETAILS = len(MACROS) + ORIGIN  # where the sliders of details begin
YEARS = 25.0  # of one unit of age
STEP = 0.03  # of a slider, over which slopes are taken
PULL_MACRO, PULL_DETAIL = 5e-6, 1e-3  # against squares of landmarks that are 1 cm off
FIRM = 30.0
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
    macro = {"age": (10 / YEARS, 90 / YEARS), "weight": WEIGHTS}
    some = [macro.get(m, (0.0, 1.0)) for m in MACROS] + [(0.0, 1.0)] * ORIGIN
    some += [(-1.0, 1.0)] * (len(slider_names()) - len(some))
    low, high = np.array(some).T
    return low, high


@cache
def _move(target: str) -> tuple[Any, Floats]:
    """(40140,) float32 how a target of the data moves the body's points, and (146,3) the joint centres."""
    whole = np.zeros_like(source.points())
    index, offset = source.target(target)
    whole[index] = offset
    return whole[: source.BODY].astype(np.float32).ravel(), anatomy.centers(whole)


@cache
def _detail_moves() -> tuple[Floats, Floats]:
    """(2,K,40140) float32 how the details move the body upward and downward, per unit, and (2,K,146,3) the centres."""
    names = slider_names()[len(MACROS) + ORIGIN :]
    both = [[_move(f"{name}-{word}") for name in names] for word in ("incr", "decr")]
    points = np.array([[m[0] for m in side] for side in both])
    centers = np.array([[m[1] for m in side] for side in both])
    points[1] *= -1
    centers[1] *= -1
    return points, centers


def moves(values: Floats, used: Ints) -> tuple[Floats, Floats]:
    """(K,n,3) float32 and (K,146,3): how these body points (n,) and the centres move per unit of each slider, here."""
    low, high = bounds()
    macro = len(MACROS) + ORIGIN
    change: list[dict[str, float]] = []
    for k in range(macro):
        up, down = values.copy(), values.copy()
        up[k], down[k] = min(values[k] + STEP, high[k]), max(values[k] - STEP, low[k])
        more, less = factors(shape_of(up)), factors(shape_of(down))
        gap = up[k] - down[k]
        change.append({n: (more.get(n, 0.0) - less.get(n, 0.0)) / gap for n in more.keys() | less.keys()})
    names = sorted({n for c in change for n, x in c.items() if x})
    table = np.array([[c.get(n, 0.0) for n in names] for c in change])
    flat = (3 * used[:, None] + np.arange(3)).ravel()
    points = table.astype(np.float32) @ np.array([_move(n)[0][flat] for n in names])
    centers = np.tensordot(table, np.array([_move(n)[1] for n in names]), 1)
    up_and_down, joints = _detail_moves()
    up_and_down = up_and_down[:, :, flat]
    share = np.clip(0.5 + values[macro:] / (2 * STEP), 0, 1)  # which side of its middle a slider is on
    detail = share.astype(np.float32)[:, None] * (up_and_down[0] - up_and_down[1]) + up_and_down[1]
    inner = share[:, None, None] * joints[0] + (1 - share)[:, None, None] * joints[1]
    both = np.concatenate([points, detail]).reshape(len(values), len(used), 3)
    return both, np.concatenate([centers, inner])


@dataclass(frozen=True, eq=False)
class Likeness:
    """Sliders (K,) and joint parameters that were found, and the template of these sliders."""

    values: Floats
    bones: Bones
    template: Template


def on_scan(found: Likeness) -> Floats:
    """(V,3) where joint parameters and sliders put the skin."""
    t = found.template
    return skinned(t.points, t.weights, posed(t.parents, t.centers, t.axes, found.bones).matrices(t.centers))[0]


def reshaped(template: Template, values: Floats) -> Template:
    """The template with other sliders."""
    points = shaped(shape_of(values))
    return replace(template, points=points[: source.BODY], centers=anatomy.centers(points))


def _slopes(template: Template, bones: Bones, rows: Rows, values: Floats) -> Floats:
    """(n,K) how the distance of each row changes with the sliders."""
    used, where = np.unique(rows.vertex.indices, return_inverse=True)
    parents, centers = template.parents, template.centers
    frame = posed(parents, centers, template.axes, bones)
    linear = frame.turn @ frame.stretch
    by_points, by_centers = moves(values, used)
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
    small = type(rows.vertex)((rows.vertex.data, where, rows.vertex.indptr), shape=(count, len(used)))
    for a in range(3):
        out += local[:, a, None] * (small @ by_points[:, :, a].T.astype(np.float64))
    return out


def improved(found: Likeness, rows: Rows, *, usual: Floats, firm: float = 1.0, size: float = 0.0) -> Likeness:
    """One step of sliders and joint parameters together; the same again when it is no improvement.

    usual (K,): the values that the ridge pulls sliders to; size: the logarithm that scales of bones are pulled to; firm:
    factor on what holds back scales of bones and, beyond `FIRM`, details.
    """
    t, bones, knobs = found.template, found.bones, found.template.knobs
    scales = np.array([n.startswith(("scale", "shift")) and not n.startswith("shift root") for n in knobs.names])
    pull = knobs.pull * np.where(scales, firm, 1.0)
    tie = knobs.tie * np.where(scales[knobs.pairs[:, 0]], firm, 1.0)  # of sizes, not of how alike fingers bend
    sized = np.where([n.startswith("scale") for n in knobs.names], size, 0.0)
    mean = knobs.links / np.maximum(np.asarray(abs(knobs.links).sum(axis=0)).ravel(), 1e-12)
    macro = len(MACROS) + ORIGIN
    detail = PULL_DETAIL * max(firm / FIRM, 1.0)
    ridge = np.r_[np.full(macro, PULL_MACRO), np.full(len(found.values) - macro, detail)]

    def cost(trial: Likeness) -> tuple[float, Floats]:
        frame = posed(t.parents, trial.template.centers, t.axes, trial.bones)
        here = placed(replace(rows, at=rows.vertex @ trial.template.points), frame, trial.template.centers)
        short = ((rows.goal - here) * rows.along).sum(axis=1)
        off = mean.T @ flat(trial.bones) - sized
        gap = off[knobs.pairs[:, 0]] - off[knobs.pairs[:, 1]]
        total = rows.trust @ short**2 + pull @ off**2 + tie @ gap**2 + ridge @ (trial.values - usual) ** 2
        return float(total), short

    now = replace(rows, at=rows.vertex @ t.points)
    before, short = cost(found)
    frame = posed(t.parents, t.centers, t.axes, bones)
    by_bones = jacobian(t.parents, t.centers, t.axes, bones, frame, now, knobs)
    by_shape = _slopes(t, bones, now, found.values)
    slope = np.concatenate([by_shape, by_bones], axis=1)
    hessian = slope.T @ (slope * rows.trust[:, None])
    downhill = slope.T @ (rows.trust * short)
    off = mean.T @ flat(bones) - sized
    keep = (mean.T @ knobs.links).toarray()  # turns are small against the prior's reach: their own axes serve
    pairs = keep[knobs.pairs[:, 0]] - keep[knobs.pairs[:, 1]]
    gap = off[knobs.pairs[:, 0]] - off[knobs.pairs[:, 1]]
    k = len(found.values)
    hessian[k:, k:] += keep.T @ (pull[:, None] * keep) + pairs.T @ (tie[:, None] * pairs)
    downhill[k:] -= keep.T @ (pull * off) + pairs.T @ (tie * gap)
    hessian[:k, :k] += np.diag(ridge)
    downhill[:k] -= ridge * (found.values - usual)
    low, high = bounds()
    diagonal = np.diag(hessian)
    for damping in (1e-6, 1e-2, 0.1, 1.0):
        step = _bounded(hessian + np.diag(damping * diagonal + 1e-9), downhill, low - found.values, high - found.values)
        values = np.clip(found.values + step[:k], low, high)
        trial = Likeness(values, changed(bones, knobs.links @ step[k:]), reshaped(t, values))
        if cost(trial)[0] < before:
            return trial
    return found


def _bounded(hessian: Floats, downhill: Floats, low: Floats, high: Floats) -> Floats:
    """The step with least quadratic, whose first parts stay within low..high: those that would leave are held there."""
    count = len(low)
    step = np.zeros(len(downhill))
    free = np.ones(len(downhill), bool)
    for _ in range(12):
        right = downhill - hessian[:, ~free] @ step[~free]
        step[free] = np.linalg.solve(hessian[np.ix_(free, free)], right[free])
        out = free.copy()
        out[:count] &= (step[:count] < low - 1e-12) | (step[:count] > high + 1e-12)
        out[count:] = False
        if not out.any():
            break
        step[:count] = np.clip(step[:count], low, high)
        free &= ~out
    step[:count] = np.clip(step[:count], low, high)
    return step
