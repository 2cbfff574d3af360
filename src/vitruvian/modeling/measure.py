"""Measures of a body as a tailor takes them, and the search for sliders that give wanted measures.

Girths are tape girths: the convex hull of the section of the named region by a plane, in the A pose of the source for
arms and legs and trunk alike (the section plane is across the bone). Lengths are straight, between joint centres and
surface points. Everything in metres.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from vitruvian.body.types import Floats
from vitruvian.errors import VitruvianError, warn
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.modeling import anatomy, source
from vitruvian.modeling.mass import DENSITY
from vitruvian.modeling.shape import WEIGHTS, Shape, shaped

NAMES = (
    "height chest underbust waist hips neck shoulder_width arm_length upper_arm wrist thigh calf inseam back_length"
).split()
# Which sliders a wanted measure may move: details of the data pack, `height` the macro slider.
SLIDERS = {
    "height": "height",
    "chest": "measure-bust-circ",
    "underbust": "measure-underbust-circ",
    "waist": "measure-waist-circ",
    "hips": "measure-hips-circ",
    "neck": "measure-neck-circ",
    "shoulder_width": "measure-shoulder-dist",
    "arm_length": "measure-lowerarm-length",
    "upper_arm": "measure-upperarm-circ",
    "wrist": "measure-wrist-circ",
    "thigh": "measure-thigh-circ",
    "calf": "measure-calf-circ",
    "inseam": "measure-upperleg-height",
    "back_length": "measure-napetowaist-dist",
}
TRUNK = ("humanoid_root", "sacroiliac", "vl", "vt", "vc", "l_hip", "r_hip", "l_stern", "r_stern")


def _region(prefixes: tuple[str, ...]) -> np.ndarray:
    """(T,) triangles of the body whose strongest joint's name starts with one of the prefixes."""
    strongest = source.weights().top(1)[0][: source.BODY, 0]
    mine = np.array([n.startswith(prefixes) for n in anatomy.names()])[strongest]
    return mine[source.array("triangles")].all(axis=1)


def girth(points: Floats, prefixes: tuple[str, ...], at: Floats, normal: Floats) -> float:
    """Length of a tape around a part of the body: hull of its section by the plane through `at` across `normal`."""
    triangles = source.array("triangles")[_region(prefixes)]
    n = normal / np.linalg.norm(normal)
    height = (points[: source.BODY] - at) @ n
    cut = []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        i, j = triangles[:, a], triangles[:, b]
        crossed = (height[i] < 0) != (height[j] < 0)
        i, j = i[crossed], j[crossed]
        t = (height[i] / (height[i] - height[j]))[:, None]
        cut.append(points[i] * (1 - t) + points[j] * t)
    section = np.concatenate(cut)
    u = np.cross(n, [1.0, 0.0, 0.0] if abs(n[0]) < 0.9 else [0.0, 0.0, 1.0])
    u /= np.linalg.norm(u)
    flat = np.stack([section @ u, section @ np.cross(n, u)], axis=1)
    try:
        return float(ConvexHull(flat).area)  # in the plane, "area" is the perimeter
    except (QhullError, ValueError):
        return 0.0


def measured(points: Floats) -> dict[str, float]:
    """All measures of a shaped person (points in the A pose, as `shaped` gives them)."""
    centers = dict(zip(anatomy.names(), anatomy.centers(points), strict=True))
    body = points[: source.BODY]
    up = np.array([0.0, 1.0, 0.0])
    vertices = source.feature_vertices()

    def trunk(y: float) -> float:
        return girth(points, TRUNK, np.array([0.0, y, 0.0]), up)

    def limb(prefix: str, start: str, end: str, share: float) -> float:
        a, b = centers[start], centers[end]
        return girth(points, (prefix,), a + share * (b - a), b - a)

    bust = body[vertices["l_thelion"], 1]
    hip = centers["l_hip"][1]
    under = bust - 0.045 * np.ptp(body[:, 1]) / 1.7
    shoulder, elbow, wrist = (centers[n] for n in ("l_shoulder", "l_elbow", "l_radiocarpal"))
    levels = np.linspace(hip + 0.06, under - 0.04, 9)
    around = [trunk(y) for y in levels]
    narrow = int(np.argmin(around))
    nape = body[vertices["cervicale"]]
    crotch = centers["l_hip"][1] - 0.075 * np.ptp(body[:, 1]) / 1.7
    width = np.linalg.norm(body[vertices["l_acromion"]] - body[vertices["r_acromion"]])
    return {
        "height": float(np.ptp(body[:, 1])),
        "chest": trunk(bust),
        "underbust": trunk(under),
        "waist": around[narrow],
        "hips": max(trunk(y) for y in np.linspace(hip - 0.05, hip + 0.05, 5)),
        "neck": girth(points, ("vc", "vt1", "skull"), (centers["vc4"] + centers["vc7"]) / 2, up),
        "shoulder_width": float(width),
        "arm_length": float(np.linalg.norm(elbow - shoulder) + np.linalg.norm(wrist - elbow)),
        "upper_arm": limb("l_shoulder", "l_shoulder", "l_elbow", 0.55),
        "wrist": limb("l_elbow", "l_elbow", "l_radiocarpal", 0.93),
        "thigh": limb("l_hip", "l_hip", "l_knee", 0.35),
        "calf": limb("l_knee", "l_knee", "l_talocrural", 0.3),
        "inseam": float(crotch - body[:, 1].min()),
        "back_length": float(np.linalg.norm(nape - [0.0, levels[narrow], nape[2]])),
    }


def body_mass(points: Floats) -> float:
    """Volume inside the skin times the density of the body, kg."""
    a, b, c = (points[source.array("triangles")[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6 * DENSITY)


def _with(shape: Shape, sliders: list[str], values: Floats) -> Shape:
    """The shape with some sliders set: macro sliders by field, details by name."""
    fields: dict[str, Any] = {s: float(v) for s, v in zip(sliders, values, strict=True) if s in ("height", "weight")}
    found = {s: float(v) for s, v in zip(sliders, values, strict=True) if s not in fields}
    return replace(shape, **fields, details=shape.details | found)


def solved(shape: Shape, wishes: dict[str, float], kilograms: float | None = None) -> Shape:
    """The shape moved so that it measures as wished (metres; mass in kg).

    Gauss-Newton on one slider a wish, with differences taken on the measured mesh, clamped to the sliders' ranges.
    Warns of what stays more than 5 mm (0.5 kg) off; raises VitruvianError for unknown names and sizes no person has.
    """
    for name, value in wishes.items():
        if name not in SLIDERS:
            raise VitruvianError(f"measure {name}: expected one of {', '.join(NAMES)}")
        if not 0.05 <= value <= 2.5:
            hint = f"; did you mean {value / 100:g}?" if 20 <= value <= 250 else ""
            raise VitruvianError(f"measure {name}: expected metres in 0.05..2.5, found {value:g}{hint}")
    if kilograms is not None and not 15 <= kilograms <= 250:
        raise VitruvianError(f"weight: expected 0..1 or 15..250 kg, found {kilograms:g}")
    sliders = [SLIDERS[n] for n in wishes] + (["weight"] if kilograms is not None else [])
    wanted = np.array([*wishes.values(), *([kilograms / 100] if kilograms is not None else [])])
    low = np.array([{"height": 0.0, "weight": WEIGHTS[0]}.get(s, -1.0) for s in sliders])
    high = np.array([WEIGHTS[1] if s == "weight" else 1.0 for s in sliders])
    scale = np.array([0.001 if s != "weight" else 1e-4 for s in sliders])

    def taken(values: Floats) -> Floats:
        points = shaped(_with(shape, sliders, values))
        if list(wishes) == ["height"]:
            out = [float(np.ptp(points[: source.BODY, 1]))]
        else:
            found = measured(points) if wishes else {}
            out = [found[n] for n in wishes]
        return np.array(out + ([body_mass(points) / 100] if kilograms is not None else []))

    values = np.array([0.5 if s in ("height", "weight") else shape.details.get(s, 0.0) for s in sliders])
    best, error = values, wanted - taken(values)
    for _ in range(8):
        if (np.abs(error) < scale).all():
            break
        jacobian = np.empty((len(wanted), len(values)))
        at = wanted - error
        for k in range(len(values)):
            step = np.zeros(len(values))
            step[k] = 0.05 if error[k] > 0 else -0.05  # sliders have a kink in the middle: look where we go
            if not low[k] <= best[k] + step[k] <= high[k]:
                step[k] = -step[k]
            jacobian[:, k] = (taken(best + step) - at) / step[k]
        move = np.linalg.lstsq(jacobian, error, rcond=1e-3)[0]
        for share in (1.0, 0.5, 0.25):
            trial = np.clip(best + share * move, low, high)
            missing = wanted - taken(trial)
            if np.linalg.norm(missing) < np.linalg.norm(error):
                best, error = trial, missing
                break
        else:
            break
    for name, miss, want in zip([*wishes, "mass"], error, wanted, strict=False):
        if abs(miss) > 0.005:
            if name == "mass":
                warn(f"weight: the nearest this build reaches is {100 * (want - miss):.1f} kg, not {100 * want:.1f}")
            else:
                warn(f"measure {name}: the nearest this build reaches is {want - miss:.3f} m, not {want:.3f}")
    return _with(shape, sliders, best)


def report(humanoid: Humanoid) -> dict[str, Any]:
    """{"height_m", "mass_kg", "measures": {name: metres}} of a person made here; VitruvianError for others."""
    if not isinstance(humanoid.made_from, Shape):
        raise VitruvianError("measures: expected a person made by vitruvian.person, found another body")
    points = shaped(humanoid.made_from)
    found = measured(points)
    return {"height_m": found["height"], "mass_kg": body_mass(points), "measures": found}
