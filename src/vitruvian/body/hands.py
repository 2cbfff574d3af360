"""A hand as links between joints: what its deformation takes from the skeleton, and the animator's parameters.

Source: joint-dependent local operators for hands: finger and palm mapping, joint rounding, muscle inflation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vitruvian.body.types import Floats, Ints, floats, indices, require


@dataclass(frozen=True)
class Rounding:
    """How a link deforms. `joint` (0..1, 1 is the mitre) inflates the back of a bent joint, over the portions `near` and
    `far` (0..0.5) of the link next to its two joints; `muscle` (0..1) inflates its palm side, most at `belly` (0.2..0.8)
    of its length.
    """

    joint: float = 0.5
    near: float = 0.3
    far: float = 0.3
    muscle: float = 0.3
    belly: float = 0.5

    def __post_init__(self) -> None:
        for name, low, high in (
            ("joint", 0, 1), ("near", 0, 0.5), ("far", 0, 0.5), ("muscle", 0, 1), ("belly", 0.2, 0.8),
        ):  # fmt: skip
            value = getattr(self, name)
            require(low <= value <= high, f"rounding {name}", f"{low} to {high}", value)


@dataclass(frozen=True, eq=False)
class Hand:
    """The links of one hand, near the wrist first, and the skin that follows them.

    before, near, far (L,): the joint before the link's first joint (-1: none), its first joint, and its last one (-1: a
    fingertip). start, end (L,3): where they are at rest. axis_near, axis_far (L,3): unit flexion axes there, positive
    towards the palm. beside (L,2): neighbouring links of the palm, -1 for none. roundings (L).
    vertices (N,): the skin of the hand; share (N,) in 0..1: how much of the hand's deformation each takes.
    """

    name: str
    before: Ints
    near: Ints
    far: Ints
    start: Floats
    end: Floats
    axis_near: Floats
    axis_far: Floats
    beside: Ints
    vertices: Ints
    share: Floats
    roundings: tuple[Rounding, ...] = ()

    def __post_init__(self) -> None:
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        title, count = f"hand {self.name}", len(self.near)
        require(count > 0, title, "at least one link", 0)
        for field in ("before", "near", "far"):
            shifted = np.asarray(getattr(self, field), np.int64) + 1
            put(field, indices(shifted, f"{title}: {field}", 1 << 30, count) - 1)
        for field in ("start", "end", "axis_near", "axis_far"):
            put(field, floats(getattr(self, field), f"{title}: {field}", count, 3))
        length = np.linalg.norm(self.end - self.start, axis=1)
        require(bool((length > 1e-9).all()), f"{title}: end", "links with a length", np.flatnonzero(length <= 1e-9)[:1])
        put("beside", indices(np.asarray(self.beside, np.int64) + 1, f"{title}: beside", count + 1, count, 2) - 1)
        put("vertices", indices(self.vertices, f"{title}: vertices", 1 << 30, None))
        put("share", floats(self.share, f"{title}: share", len(self.vertices)))
        put("roundings", tuple(self.roundings) or (Rounding(),) * count)
        require(len(self.roundings) == count, f"{title}: roundings", f"{count}, one a link", len(self.roundings))
