"""People made to measure: the search for the sliders, and what is let out or taken in, that give wanted measures.

Sliders first (Gauss-Newton with Broyden's updates of the differences, on the figure as it will stand, measured by the
same `vitruvian.modeling.measures` that measures any body), then the girths that sliders leave off are let out or taken in
(`vitruvian.modeling.letting`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats
from vitruvian.errors import VitruvianError, warn
from vitruvian.modeling import source
from vitruvian.modeling.letting import MOST, REACH
from vitruvian.modeling.mass import DENSITY
from vitruvian.modeling.measures import NAMES, Figure, taken
from vitruvian.modeling.shape import WEIGHTS, Shape, shaped

# Which sliders a wanted measure moves, together: details of the data pack, `height` and `weight` the macro sliders.
SLIDERS: dict[str, tuple[str, ...]] = {
    "head": ("head-scale-depth", "head-scale-horiz"),
    "neck": ("measure-neck-circ",),
    "chest": ("measure-bust-circ",),
    "underbust": ("measure-underbust-circ",),
    "waist": ("measure-waist-circ",),
    "hips": ("measure-hips-circ",),
    "thigh": ("measure-thigh-circ",),
    "knee": ("measure-knee-circ",),
    "calf": ("measure-calf-circ",),
    "ankle": ("measure-ankle-circ",),
    "upper_arm": ("measure-upperarm-circ",),
    "elbow": (),
    "wrist": ("measure-wrist-circ",),
    "height": ("height",),
    "inseam": ("measure-upperleg-height", "measure-lowerleg-height"),
    "arm_length": ("measure-upperarm-length", "measure-lowerarm-length"),
    "shoulder_width": ("measure-shoulder-dist",),
    "back_length": ("measure-napetowaist-dist",),
    "foot_length": ("l-foot-scale", "r-foot-scale"),
}
NEAR = 0.002  # metres that a measure may be off without a word
CLOSE = 0.0003  # metres at which the search stops
STEP = 0.08  # of a slider, for differences
SMALL = 2e-4  # metres that a slider's whole way counts as, where the same can be had with less
HEAVY = 0.5  # kilograms likewise
STRETCH = 0.02  # of the height, that a scale may make up for
KG = 0.003  # metres that a kilogram counts as


def asked(wishes: dict[str, float], kilograms: float | None) -> None:
    """VitruvianError for measures nobody can have: names that there are not, sizes outside 5 cm to 2.5 m, weights."""
    for name, value in wishes.items():
        if name not in SLIDERS:
            raise VitruvianError(f"measure {name}: expected one of {', '.join(NAMES)}")
        if not 0.05 <= value <= 2.5:
            hint = f"; did you mean {value / 100:g}?" if 20 <= value <= 250 else ""
            raise VitruvianError(f"measure {name}: expected metres in 0.05..2.5, found {value:g}{hint}")
    if kilograms is not None and not 15 <= kilograms <= 250:
        raise VitruvianError(f"weight: expected 0..1 or 15..250 kg, found {kilograms:g}")


def solved(shape: Shape, wishes: dict[str, float], kilograms: float | None = None, *, clearance: float = 0.0) -> Shape:
    """The shape moved so that the person made of it measures as wished (metres; mass in kg).

    `clearance` (m): by how much clothes at the hips keep the hanging arms away, which moves the shoulders a little.
    Warns, with the nearest that is reached, of what stays more than 2 mm (0.5 kg) off; raises VitruvianError for unknown
    names and sizes no person has.
    """
    asked(wishes, kilograms)
    wanted = np.array([*wishes.values(), *([kilograms * KG] if kilograms is not None else [])])
    girths = [n for n in wishes if n in REACH]
    # a build that nobody asked for follows the girths, which is smoother than moving each of them far
    loose = ["weight"] if kilograms is not None or (girths and shape.weight == 0.5) else []
    keys = [n for n in wishes if SLIDERS[n]] + loose
    plain = list(wishes) == ["height"] and kilograms is None
    # Making people of a wished height ends in a small scale (`stature_scale`): one more number to search for.
    stretch = STRETCH if "height" in wishes and not plain else 0.0
    count = len(keys)

    def made(values: Floats) -> Shape:
        out = _with(shape, keys, values[:count])
        return replace(out, girths=dict(zip(girths, (MOST * values[count + 1 :]).tolist(), strict=True)))

    def answer(values: Floats) -> Floats:
        scale = 1 + stretch * float(values[count])
        return np.array(_measured(made(values), list(wishes), kilograms is not None, scale, plain, clearance))

    more = 1 + len(girths)
    low = np.array([{"height": 0.0, "weight": WEIGHTS[0]}.get(k, -1.0) for k in keys] + [-1.0] * more)
    high = np.array([WEIGHTS[1] if k == "weight" else 1.0 for k in keys] + [1.0] * more)
    best = np.array([_value(shape, k) for k in keys] + [0.0] * more)
    first = np.arange(count + more) < count + bool(stretch)
    best, missing = search(answer, wanted, best, low, high, first)
    if girths and (np.abs(missing) > CLOSE).any():
        best, missing = search(answer, wanted, best, low, high, first | (np.arange(count + more) > count))
    found = made(best)
    for name, miss, want in zip([*wishes, "weight"], missing, wanted, strict=False):
        if name == "weight" and abs(miss) > HEAVY * KG:
            near, unit, want = (want - miss) / KG, "kg", want / KG
            warn(f"weight: the nearest this build reaches is {near:.1f} {unit}, not {want:.1f}")
        elif name != "weight" and abs(miss) > NEAR:
            warn(f"measure {name}: the nearest this build reaches is {want - miss:.3f} m, not {want:.3f}")
    return found


def _value(shape: Shape, key: str) -> float:
    if key in ("height", "weight"):
        return 0.5
    return float(np.mean([shape.details.get(n, 0.0) for n in SLIDERS[key]]))


def _with(shape: Shape, keys: list[str], values: Floats) -> Shape:
    """The shape with the sliders of some measures set."""
    given = dict(zip(keys, values.tolist(), strict=True))
    macros = {k: v for k, v in given.items() if k in ("height", "weight")}
    found = {s: v for k, v in given.items() if k not in macros for s in SLIDERS[k]}
    return replace(shape, **macros, details=shape.details | found)


def _measured(
    shape: Shape, names: list[str], weighed: bool, scale: float, plain: bool, clearance: float
) -> list[float]:
    """The measures `names` of the person of a shape as it stands at rest, and its mass."""
    from vitruvian.modeling.person import bare

    points = shaped(shape)
    if plain:  # to make the height exact is no more than a scale
        return [float(np.ptp(points[: source.BODY, 1]))]
    body = bare(points, clearance) * scale
    places = {n: body[v] for n, v in source.feature_vertices().items()}
    from vitruvian.modeling.figures import built_in_parts

    figure = Figure(body, source.array("triangles"), places, built_in_parts())
    found = taken(figure, names, sides=("l_",)).values
    return [found[n] for n in names] + ([body_mass(body) * KG] if weighed else [])


def body_mass(points: Floats) -> float:
    """Volume inside the built-in skin, points (13380+,3), times the density of the body, kg."""
    a, b, c = (points[source.array("triangles")[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6 * DENSITY)


def search(
    answer: Callable[[Floats], Floats],
    wanted: Floats,
    start: Floats,
    low: Floats,
    high: Floats,
    moving: NDArray[np.bool_],
) -> tuple[Floats, Floats]:
    """Values (n,) within bounds for which `answer` comes nearest to `wanted` (m,), and what is missing (m,).

    Only what is `moving` (n,) changes. Differences once, towards where each value will go (sliders have kinks), then
    Broyden's updates; differences anew when a step does not help.
    """
    best, missing = start, wanted - answer(start)
    jacobian = np.zeros((len(wanted), len(start)))

    def difference(k: int, sign: float) -> None:
        move = np.zeros(len(start))
        move[k] = STEP * (sign if low[k] <= best[k] + STEP * sign <= high[k] else -sign)
        jacobian[:, k] = (missing - (wanted - answer(best + move))) / move[k]

    fresh = False
    for _ in range(20):
        if not moving.any() or (np.abs(missing) < CLOSE).all():
            break
        if not fresh and not jacobian.any():
            fresh = True
            for k in np.flatnonzero(moving).tolist():
                difference(k, 1.0)
            for k in np.flatnonzero(moving & (_change(jacobian, missing, best, low, high, moving) < -0.02)).tolist():
                difference(k, -1.0)
        change = _change(jacobian, missing, best, low, high, moving)
        better = False
        for share in (1.0, 0.5, 0.2):
            trial = np.clip(best + share * change, low, high)
            moved = trial - best
            if not np.abs(moved).max(initial=0) > 1e-7:
                break
            left = wanted - answer(trial)
            jacobian += np.outer(missing - left - jacobian @ moved, moved) / (moved @ moved)
            if np.linalg.norm(left) < 0.98 * np.linalg.norm(missing):
                best, missing, better = trial, left, True
                break
        if not better and fresh:
            break
        if not better:
            jacobian[:] = 0
        fresh = False
    return best, missing


def _change(
    jacobian: Floats, missing: Floats, best: Floats, low: Floats, high: Floats, moving: NDArray[np.bool_]
) -> Floats:
    """(n,) the smallest change within bounds that brings what is missing."""
    from scipy.optimize import lsq_linear

    change = np.zeros(len(best))
    room = low[moving] - best[moving] - 1e-9, high[moving] - best[moving] + 1e-9
    a = np.concatenate([jacobian[:, moving], SMALL * np.eye(int(moving.sum()))])
    change[moving] = lsq_linear(a, np.concatenate([missing, np.zeros(int(moving.sum()))]), bounds=room).x
    return change
