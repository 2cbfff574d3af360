"""Hand poses: how fingers hang when nobody asks for anything.

Flexion is about the line across the knuckles, so it works for any rest pose in which fingers are straight.
"""

from __future__ import annotations

import numpy as np

from vitruvian.body.types import Floats, Skeleton
from vitruvian.motion.names import FINGER_JOINTS, joint_index
from vitruvian.motion.turns import about, unit

# Degrees of flexion at the knuckle, the middle and the last joint, index to little finger; a hand at rest closes
# towards the little finger. Of our own choice within the ranges of relaxed hands.
RELAXED = {2: (18.0, 26.0, 12.0), 3: (23.0, 31.0, 15.0), 4: (27.0, 34.0, 17.0), 5: (30.0, 35.0, 18.0)}
THUMB = (6.0, 10.0, 14.0)


def relaxed(skeleton: Skeleton, amount: float = 1.0) -> dict[str, Floats]:
    """Local rotations (4,) of the finger joints of a relaxed hand, by H-Anim 2.0 name; `amount` 0 is the rest pose."""
    index = joint_index(skeleton.names)
    c = skeleton.centers
    out: dict[str, Floats] = {}
    for side, sign in (("l", 1.0), ("r", -1.0)):
        first, last = index.get(f"{side}_metacarpophalangeal_2"), index.get(f"{side}_metacarpophalangeal_5")
        across = c[last] - c[first] if first is not None and last is not None else np.array([0.0, 0.0, -1.0])
        for finger, angles in RELAXED.items():
            names = [f"{side}_{joint}" for joint in FINGER_JOINTS[finger]]
            known = [index[n] for n in names if n in index]
            if len(known) < 2:
                continue
            bone = unit(c[known[1]] - c[known[0]])
            axis = unit(across - bone * (across @ bone)) * sign
            for name, degrees in zip(names, angles):
                if name in index:
                    out[name] = about(axis, np.radians(degrees * amount))
        names = [f"{side}_{joint}" for joint in FINGER_JOINTS[1]]
        known = [index[n] for n in names if n in index]
        if len(known) == 3:
            # the thumb folds across the palm, towards the knuckle of the middle finger
            bone = unit(c[known[2]] - c[known[0]])
            palm = np.array([-sign, 0.0, 0.0])
            axis = unit(np.cross(bone, palm + np.array([0.0, -0.5, 0.0])))
            for name, degrees in zip(names, THUMB):
                out[name] = about(axis, np.radians(degrees * amount))
    return out
