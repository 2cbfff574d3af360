"""Motion: how the joints of one skeleton turn over time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from vitruvian.body.types import Floats, Skeleton, floats, require


@dataclass(frozen=True, eq=False)
class Motion:
    """A clip on its own skeleton.

    rotation (F,J,4): local joint rotations, unit quaternions xyzw, hemisphere-continuous in time.
    translation (F,3): the translation field of the first joint (an offset from its rest centre), metres.
    joint_translation (F,J,3): that of all joints (then column 0 equals `translation`), or None.
    weights: displacer name -> (F,). loop: the last frame leads to the first.
    joint_scale (F,J,3): scale of all joints along the skeleton's `scale_orientation`, in place of its own, or None.
    notes: what a reader or retargeting had to decide, one line each.
    """

    skeleton: Skeleton
    fps: float
    rotation: Floats
    translation: Floats
    joint_translation: Floats | None = None
    weights: dict[str, Floats] = field(default_factory=dict)
    loop: bool = False
    name: str = ""
    notes: tuple[str, ...] = ()
    joint_scale: Floats | None = None

    def __post_init__(self) -> None:
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        require(np.isfinite(self.fps) and self.fps > 0, "fps", "a positive number", self.fps)
        rotation = floats(self.rotation, "rotation", None, len(self.skeleton), 4)
        norm = np.sqrt(np.einsum("fji,fji->fj", rotation, rotation))
        if (norm < 1e-6).any():
            frame, joint = np.argwhere(norm < 1e-6)[0]
            name = self.skeleton.names[joint]
            require(False, "rotation", "unit quaternions", f"a zero one at frame {frame}, joint {name}")
        put("rotation", continuous(rotation / norm[..., None]))
        put("translation", floats(self.translation, "translation", len(rotation), 3))
        if self.joint_translation is not None:
            shape = (len(rotation), len(self.skeleton), 3)
            put("joint_translation", floats(self.joint_translation, "joint_translation", *shape))
        if self.joint_scale is not None:
            put("joint_scale", floats(self.joint_scale, "joint_scale", len(rotation), len(self.skeleton), 3))
        for name, weight in self.weights.items():
            floats(weight, f"weights[{name}]", len(rotation))

    def __len__(self) -> int:
        return len(self.rotation)

    @property
    def seconds(self) -> float:
        """Duration: frames / fps."""
        return len(self) / self.fps


def continuous(rotation: Floats) -> Floats:
    """The same rotations (F,...,4) with signs chosen so that neighbours in time have a non-negative dot product."""
    if len(rotation) < 2:
        return rotation
    flips = np.einsum("f...i,f...i->f...", rotation[1:], rotation[:-1]) < 0
    if not flips.any():
        return rotation
    out = rotation.copy()
    turned = np.logical_xor.accumulate(flips, axis=0)
    np.negative(out[1:], out=out[1:], where=turned[..., None])
    return out
