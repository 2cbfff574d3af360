"""The face of the built-in person as Displacers: movements, regions and whole expressions, one kind per suffix.

`_action` is one of the 52 face units. `_feature` marks a region and moves nothing. `_config` is a whole configuration of
the face, as for an expression. Source: ISO/IEC 19774-1, Displacer (its three uses and their suffixes).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints
from vitruvian.modeling import anatomy, source
from vitruvian.modeling.look import mask, parents_of

LEAST_MOVE = 2e-4  # metres: what moves less does not show in an expression
# The six basic expressions as shares of face units (Ekman and Friesen, Facial Action Coding System, 1978: prototypes in
# their action units, the nearest units here). `*` is both sides.
EXPRESSIONS: dict[str, dict[str, float]] = {
    # 6 12
    "joy": {"*CheekSquint": 0.7, "*MouthSmile": 1.0, "*EyeSquint": 0.3},
    # 1 4 15 17
    "sadness": {"browInnerUp": 1.0, "*BrowDown": 0.3, "*MouthFrown": 1.0, "mouthShrugLower": 0.3},
    # 4 5 7 24
    "anger": {"*BrowDown": 1.0, "*EyeWide": 0.4, "*EyeSquint": 0.6, "*MouthPress": 0.8, "*NoseSneer": 0.3},
    # 1 2 4 5 20 26
    "fear": {
        "browInnerUp": 1.0,
        "*BrowOuterUp": 0.6,
        "*BrowDown": 0.4,
        "*EyeWide": 1.0,
        "*MouthStretch": 0.6,
        "jawOpen": 0.15,
    },
    # 9 10 15
    "disgust": {"*NoseSneer": 1.0, "*MouthUpperUp": 0.5, "*MouthFrown": 0.5, "*EyeSquint": 0.5, "*CheekSquint": 0.4},
    # 1 2 5 26
    "surprise": {"browInnerUp": 1.0, "*BrowOuterUp": 1.0, "*EyeWide": 1.0, "jawOpen": 0.4},
}


@cache
def configurations() -> dict[str, dict[str, float]]:
    """Displacer name of each basic expression, `joy_config` and so on -> face unit -> share."""
    out = {}
    for name, shares in EXPRESSIONS.items():
        units = {u: w for unit, w in shares.items() for u in _both(unit)}
        out[f"{name}_config"] = units
    return out


def _both(unit: str) -> list[str]:
    if not unit.startswith("*"):
        return [unit]
    return [unit[1].lower() + unit[2:] + side for side in ("Left", "Right")]


@cache
def regions() -> dict[str, Ints]:
    """Region of the face -> body vertices (n,), rising. No vertex is in two, and left and right are mirror images.

    They come from what the pack says: painted masks, weights, where brow hairs grow, and what its sliders and face units
    move (more than a share of their largest move).
    """
    points = source.points()[: source.BODY]
    left = points[:, 0] > 0
    lids, lips, ears = mask("eyelids") > 0.5, (mask("lips") > 0.5) & (mask("inside-mouth") < 0.5), mask("ears") > 0.5
    hairs = np.zeros(source.BODY, bool)
    hairs[np.unique(parents_of("brows").indices)] = True
    jaw = _weight("temporomandibular")
    sides: dict[str, NDArray[np.bool_]] = {
        "eyebrow": hairs,
        "upper_eyelid": lids & (_weight("l_eyelid_joint") + _weight("r_eyelid_joint") > 0.05),
        "lower_eyelid": lids,
        "ear": ears,
        "nostril": _reach("nose-flaring-incr", 0.4),
        "cheek": _reach("l-cheek-volume-incr", 0.1) | _reach("r-cheek-volume-incr", 0.1) | _reach("cheekPuff", 0.4),
    }
    middle: dict[str, NDArray[np.bool_]] = {
        "upper_lip": lips & (jaw <= 0.5),
        "lower_lip": lips,
        "nose": _reach("nose-scale-vert-incr", 0.6) | _reach("nose-hump-incr", 0.2) | _reach("nose-greek-incr", 0.2),
        "chin_pad": _reach("chin-prominent-incr", 0.25),
        "forehead": _reach("forehead-trans-forward", 0.1),
        "scalp": mask("scalp") > 0.5,
    }
    order = ("eyebrow", "upper_eyelid", "lower_eyelid", "upper_lip", "lower_lip", "ear", "nostril", "nose", "chin_pad",
             "cheek", "scalp", "forehead")  # fmt: skip
    mirror = source.array("mirror")[: source.BODY]
    free = np.ones(source.BODY, bool)
    found: dict[str, Ints] = {}
    for name in order:
        here = (sides | middle)[name]
        here = (here | here[mirror]) & free
        free &= ~here
        both = {f"l_{name}": here & left, f"r_{name}": here & ~left} if name in sides else {name: here}
        found |= {n: np.flatnonzero(some).astype(np.int32) for n, some in both.items()}
    return found


def _weight(joint: str) -> Floats:
    """(13380,) weights of a joint."""
    w = source.weights()
    mine = (w.joint == anatomy.names().index(joint)) & (w.vertex < source.BODY)
    out = np.zeros(source.BODY)
    np.add.at(out, w.vertex[mine], w.weight[mine])
    return out


def _reach(target: str, share: float) -> NDArray[np.bool_]:
    """(13380,) what a slider's target or a face unit moves by more than a share of its largest move."""
    index, offset = source.target(target, "faces" if target in source.manifest()["faces"] else "targets")
    size = np.zeros(source.BODY)
    on = index < source.BODY
    size[index[on]] = np.linalg.norm(offset[on], axis=1)
    return size > share * size.max()
