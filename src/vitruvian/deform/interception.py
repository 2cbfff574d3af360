"""Rotation events go to the deformer first: points are computed once per time stamp, then the rotations are released.

Without this a frame may show joints already turned and a surface that is not yet. Source: cross-section deformation of
H-Anim bodies, Script node, interception of events and updates of one time stamp grouped.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.rotations import from_axis_angle
from vitruvian.body.types import Floats
from vitruvian.deform.deformer import Deformer
from vitruvian.errors import VitruvianError

ALIASES = {"l_thigh": "l_hip", "r_thigh": "r_hip"}  # printed in the source; H-Anim has no such joints

Release = Callable[[NDArray[np.float32], dict[str, Floats]], None]


class Interceptor:
    """Collects `hanim_JOINTDef` events of one time stamp, computes the points once, and hands both over together.

    `release(points, rotations)`: points (V,3) of the pose with all rotations so far, and the rotations {joint: x y z
    angle} of this time stamp. `findings`: events for joints that the body does not have; these are passed through at
    once, without points. `computed`: how many times points were computed.
    """

    def __init__(self, move: Deformer, release: Release):
        self.move, self.release = move, release
        self.skeleton = move.body.skeleton
        self.rotation = self.skeleton.rotation.copy()
        self.findings: list[str] = []
        self.computed = 0
        self._time: float | None = None
        self._fresh: dict[str, Floats] = {}

    def set(self, joint: str, rotation: Floats, time: float) -> None:
        """A joint's new rotation (x y z angle) at `time` (s); another time than before ends the step before it."""
        value = np.asarray(rotation, np.float64).reshape(-1)
        if value.shape != (4,) or not np.isfinite(value).all():
            raise VitruvianError(f"{joint}: expected a rotation of 4 finite numbers, found {rotation!r}")
        name = ALIASES.get(joint, joint)
        if self._time is not None and time != self._time:
            self.end_of_step()
        self._time = time
        if name not in self.skeleton.index:
            self.findings.append(f"no joint {joint}: its rotation is passed through")
            self.release(np.zeros((0, 3), np.float32), {joint: value})
            return
        self._fresh[name] = value

    def send(self, event: str, rotation: Floats, time: float) -> None:
        """The same by the event's name, `hanim_JOINTDef` or `JOINTDef`."""
        self.set(event.removeprefix("hanim_").removesuffix("Def"), rotation, time)

    def end_of_step(self) -> None:
        """Compute the points of what has been collected and release it; nothing collected: nothing happens."""
        if not self._fresh:
            return
        for name, value in self._fresh.items():
            self.rotation[self.skeleton.index[name]] = from_axis_angle(value)
        matrices = joint_matrices(replace(self.skeleton, rotation=self.rotation))[0]
        points, fresh = self.move(matrices), self._fresh
        self.computed += 1
        self._fresh, self._time = {}, None
        self.release(points, fresh)
