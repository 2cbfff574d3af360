"""Contours that are oriented for a bend in advance: at rest they fan about the axis of the knee or elbow.

A bend turns the contours of its ramp step by step, which crowds them on the inner side and spreads them on the outer. So
at rest they lean the other way, towards the bisector plane of the bent joint. The lean grows over the ramp and shrinks
again to the other end of the limb, and is just large enough that after a bend by `ANGLE` all contours on the way are
evenly apart, on either side of the limb.

Source: cross-section deformation of H-Anim bodies, on pre-oriented contours at the knee.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vitruvian.body.types import Floats, require
from vitruvian.hanim.humanoid import Humanoid

ANGLE = np.pi / 2  # the bend that contours are evenly apart in
INNER = {"elbow": 1.0, "knee": -1.0}  # the side that the joint bends to: the figure's front or its back


@dataclass(frozen=True, eq=False)
class Fan:
    """Planes of one limb, fanned by `tilt` (0..1) about the unit `axis` of the joint at its beginning, or at its end
    (`last`). `reach`: the share of the limb that the joint's ramp takes. places (C,): 0 to 1 along the limb, where its
    contours are that ramps count."""

    axis: Floats
    last: bool
    reach: float
    tilt: float
    places: Floats

    def counted(self, s: Floats) -> Floats:
        """(C,) places `s` (C,) by the number of contours from the joint on, 0..1 of all."""
        k = np.interp(s, self.places, np.linspace(0, 1, len(self.places)))
        return 1 - k if self.last else k

    def lean(self, s: Floats) -> Floats:
        """(C,) radians that planes at `s` (C,), 0..1 along the limb, are turned about the axis."""
        x = self.counted(s)
        ramp = max(float(self.counted(np.array([1 - self.reach if self.last else self.reach]))[0]), 1e-6)
        end = 1.0 if self.last else max(1 - ramp, 0.5)  # below knee and elbow the last contours are another joint's
        most = self.tilt * ANGLE / 2 * max(1 - ramp / end, 0.0)
        tent = np.minimum(x / ramp, (end - x) / max(end - ramp, 1e-9))
        return (most if self.last else -most) * np.clip(tent, 0, 1)

    def turned(self, normal: Floats, s: Floats) -> Floats:
        """(C,3) unit normals (C,3) of planes at `s` (C,)."""
        angle, a = self.lean(s)[:, None], self.axis
        along = np.sum(normal * a, axis=1, keepdims=True)
        return normal * np.cos(angle) + np.cross(a, normal) * np.sin(angle) + a * along * (1 - np.cos(angle))


def fan(near: str, far: str, bone: Floats, front: Floats, *, reach: float, tilt: float, places: Floats) -> Fan | None:
    """The fan of a limb along the unit `bone` from joint `near` to `far`, by names without side; None where neither is a
    knee or an elbow, or where the limb points the way that it bends to. `front`: the unit direction that the figure
    faces; the others as in `Fan`."""
    joint = next((j for j in (near, far) if j in INNER), None)
    across = np.cross(bone, INNER[joint] * front) if joint else np.zeros(3)
    size = float(np.linalg.norm(across))
    return Fan(across / size, joint == far, reach, tilt, places) if joint and size > 0.1 else None


def tilts(humanoid: Humanoid, tilt: float | Mapping[str, float] | None, names: list[str]) -> dict[str, float]:
    """How far each of the surfaces `names` fans: `tilt` of all, of those that are named, or, when None, what the contour
    surfaces that the humanoid has already say. Raises VitruvianError for another surface or a number outside 0..1."""
    if tilt is None:
        found = {c.name: float(c.tilt) for s in humanoid.segments() for c in s.contours}
        return {n: found.get(n, 0.0) for n in names}
    given = dict(tilt) if isinstance(tilt, Mapping) else dict.fromkeys(names, tilt)
    for name, value in given.items():
        require(name in names, "tilt", f"a surface at a knee or elbow, one of {', '.join(names)}", repr(name))
        require(bool(0 <= value <= 1), f"{name} tilt", "0 to 1", value)
    return dict.fromkeys(names, 0.0) | {n: float(v) for n, v in given.items()}
