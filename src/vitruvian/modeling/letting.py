"""Girths let out or taken in by hand: the body swollen round the axis of a limb or of the trunk, smoothly along it.

What the sliders of the data pack cannot reach is made up for here. The radial distance of a point from the axis grows by
the amount times a bell along the axis times the weight that ties the point to that part of the body, all of them smooth,
so that the skin stays smooth and clothes, which have the same weights, follow. Bones stay where they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.errors import VitruvianError
from vitruvian.modeling import anatomy, source
from vitruvian.modeling.mass import part_of

MOST = 0.16  # by which a girth may be let out or taken in, as a share of it
# girth -> parts of the body that move, how far along the axis (share of the stature)
REACH: dict[str, tuple[tuple[str, ...], float]] = {
    "head": (("head",), 0.045),
    "neck": (("head", "trunk"), 0.022),
    "chest": (("trunk",), 0.032),
    "underbust": (("trunk",), 0.028),
    "waist": (("trunk",), 0.045),
    "hips": (("trunk", "thigh"), 0.05),
    "thigh": (("thigh",), 0.05),
    "knee": (("thigh", "shank"), 0.035),
    "calf": (("shank",), 0.05),
    "ankle": (("shank", "foot"), 0.03),
    "upper_arm": (("upper arm",), 0.045),
    "elbow": (("upper arm", "forearm"), 0.03),
    "wrist": (("forearm", "hand"), 0.025),
}


@cache
def _shares(parts: tuple[str, ...], side: str) -> Floats:
    """(19158,) how much of each source point belongs to some parts of one side of the body."""
    joints = list(anatomy.skeleton(4, np.zeros((len(anatomy.names()), 3))).values())
    part = part_of(joints)
    mine = [part[n] in parts and (n.startswith(side) or part[n] in ("trunk", "head")) for n in anatomy.names()]
    w = source.weights()
    chosen = np.array(mine)[w.joint]
    return np.bincount(w.vertex[chosen], w.weight[chosen], minlength=source.POINTS).astype(np.float64)


def let_out(points: Floats, amounts: Mapping[str, float]) -> Floats:
    """Points (19484,3) of a shaped person, A pose, with girths larger by those shares (negative: smaller).

    Raises VitruvianError for names that are no girths and for amounts beyond `MOST`.
    """
    from vitruvian.modeling.measures import Figure, axis_of

    for name, amount in amounts.items():
        if name not in REACH or not abs(amount) <= MOST + 1e-9:
            raise VitruvianError(f"girths: expected one of {', '.join(REACH)} by at most {MOST}, found {name} {amount}")
    if not any(amounts.values()):
        return points
    places = {n: points[v] for n, v in source.feature_vertices().items()}
    figure = Figure(points, source.array("triangles"), places)
    tall = float(np.ptp(points[: source.BODY, 1]))
    out = points.copy()
    flesh = points[: source.POINTS]
    for name, amount in amounts.items():
        parts, reach = REACH[name]
        for side in ("l_", "r_") if parts[0] not in ("trunk", "head") else ("",):
            center, axis = axis_of(figure, name, side)
            along = (flesh - center) @ axis
            bell = np.exp(-((along / (reach * tall)) ** 2)) * _shares(parts, side or "l_")
            if name == "hips":
                bell += np.exp(-((along / (reach * tall)) ** 2)) * (_shares(parts, "r_") - _shares(("trunk",), "l_"))
            radial = flesh - center - along[:, None] * axis
            far = bell > 1e-4
            out[: source.POINTS][far] += (amount * bell[far])[:, None] * radial[far]
    return out
