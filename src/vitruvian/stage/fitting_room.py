"""How clothes fit a humanoid: its tapes and the names of its parts, where it stands in the garment.

Source: note cloth.md, section 5 (6); seed 003, section 6.3.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.pack import pack
from vitruvian.body.types import Body, Floats
from vitruvian.cloth.fit_map import FitMap, fit_map
from vitruvian.cloth.garment import Garment
from vitruvian.cloth.girths import Ring
from vitruvian.cloth.obstacle import pseudo_normals, still
from vitruvian.cloth.resizing import firmed, standing
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.modeling.features import feature_points
from vitruvian.modeling.figures import humanoid_figure
from vitruvian.modeling.mass import part_of
from vitruvian.modeling.measures import LIMBS, taken

GIRTHS = ("neck", "chest", "underbust", "waist", "hips", "thigh", "knee", "calf", "upper_arm", "elbow", "wrist")
# the joint that carries each girth of a limb
CARRIED = {"thigh": "hip", "knee": "hip", "calf": "knee", "ankle": "knee", "upper_arm": "shoulder",
           "elbow": "shoulder", "wrist": "elbow"}  # fmt: skip
FACING = 0.6  # of a normal along Z: front or back


def fit_of(garment: Garment, humanoid: Humanoid) -> FitMap:
    """The fit of a garment on the humanoid that it was draped on, at rest; see `vitruvian.cloth.fit_map`. It is pulled firm
    first, see `vitruvian.cloth.resizing.firmed`. Girths that the humanoid lacks the feature points for are left out."""
    body = pack(humanoid)
    there = standing(garment, body)
    obstacle = still(there.vertices, there.triangles)
    return fit_map(
        firmed(garment, obstacle),
        obstacle,
        regions=regions(humanoid, body),
        rings=rings(humanoid, body, garment.matrices),
    )


def rings(humanoid: Humanoid, body: Body, matrices: Floats) -> dict[str, Ring]:
    """Name of a girth, with `l_` and `r_` for limbs -> the tape round the body under joint matrices (J,4,4)."""
    out = {}
    for name, points in taken(humanoid_figure(humanoid), GIRTHS).contours.items():
        joint = body.skeleton.index.get(name[:2] + CARRIED.get(name[2:], "")) if name[2:] in LIMBS else None
        m = np.eye(4) if joint is None else matrices[joint]
        if len(points) >= 3:
            out[name] = Ring(points @ m[:3, :3].T + m[:3, 3])
    return out


def regions(humanoid: Humanoid, body: Body) -> NDArray[np.str_]:
    """(V,) what part of the body each point of its skin is, in words: "chest, front", "left upper arm"."""
    part = part_of(humanoid.joints())
    sides = {"l_": "left ", "r_": "right "}
    plain = ("trunk", "head")
    label = [part[n] if part[n] in plain else sides.get(n[:2], "") + part[n] for n in body.skeleton.names]
    names = np.array([*label, ""], dtype="<U24")
    weights, rest = body.skin.weights, body.skin.rest
    out = names[np.where(weights.counts > 0, weights.top(1)[0][:, 0], -1)]
    trunk = out == "trunk"
    levels = _levels(humanoid)
    if not levels or not trunk.any():
        return out
    heights = np.array(list(levels.values()))
    level = np.array(list(levels), dtype="<U24")[np.abs(rest[:, 1, None] - heights).argmin(axis=1)]
    normal = pseudo_normals(rest, body.skin.triangles)
    side = np.where(rest[:, 0] > 0, "left side", "right side")
    way = np.where(normal[:, 2] > FACING, "front", np.where(normal[:, 2] < -FACING, "back", side))
    told = np.char.add(np.char.add(level, ", "), way)
    return np.where(trunk, told.astype("<U24"), out)


def _levels(humanoid: Humanoid) -> dict[str, float]:
    """Name -> height (m) of the parts of the trunk."""
    found = taken(humanoid_figure(humanoid), ("chest", "waist", "hips")).contours
    out = {name: float(points[:, 1].mean()) for name, points in found.items() if len(points)}
    places = feature_points(humanoid)
    tops = [places[n][1] for n in ("l_acromion", "r_acromion") if n in places]
    if tops and "chest" in out:
        out["shoulders"] = float(np.mean(tops))
    return out
