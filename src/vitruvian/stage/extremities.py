"""Fingers, neck and toes, which may be switched off: their surfaces are then rigid pieces of what they hang on.

Source: H-Anim deformation in VRML, future work: for a global animation static surfaces are used for hands, and hands
become alive as soon as they matter, as for sign language.
"""

from __future__ import annotations

import re
from collections.abc import Collection

import numpy as np

from vitruvian.body.types import Ints, Skeleton
from vitruvian.hanim.tables import canonical

_WRIST = re.compile(r"[lr]_radiocarpal")
_TOE = re.compile(r"[lr]_(metatarsophalangeal|tarsal_\w*interphalangeal)_\d")
_NECK = re.compile(r"vc[1-7]")


def parts(skeleton: Skeleton) -> dict[str, Ints]:
    """The joints of each extremity that the skeleton has: all below the wrists, of the toes, of the neck."""
    names = [canonical(n, "joint") or n for n in skeleton.names]
    hand = np.zeros(len(names), bool)
    for j, parent in enumerate(skeleton.parents.tolist()):
        hand[j] = parent >= 0 and (hand[parent] or bool(_WRIST.fullmatch(names[parent])))
    found = {
        "fingers": np.flatnonzero(hand),
        "neck": np.array([j for j, n in enumerate(names) if _NECK.fullmatch(n)], int),
        "toes": np.array([j for j, n in enumerate(names) if _TOE.fullmatch(n)], int),
    }
    return {name: joints.astype(np.int32) for name, joints in found.items() if len(joints)}


def stilled(skeleton: Skeleton, off: Collection[str]) -> tuple[Ints, Ints]:
    """(n,) joints that do not move by themselves when these extremities are off, and (n,) those they follow then."""
    known = parts(skeleton)
    still = np.zeros(len(skeleton), bool)
    for name in off:
        still[known[name]] = True
    follows = np.arange(len(skeleton), dtype=np.int32)
    for j in np.flatnonzero(still):  # parents come first
        if skeleton.parents[j] >= 0:
            follows[j] = follows[skeleton.parents[j]]
    joints = np.flatnonzero(follows != np.arange(len(skeleton))).astype(np.int32)
    return joints, follows[joints]
