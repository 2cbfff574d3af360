"""A hand as links between joints: what its deformation takes from the skeleton, and the animator's parameters.

Source: joint-dependent local operators for hands: finger and palm mapping, joint rounding, muscle inflation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from vitruvian.body.rotations import unit
from vitruvian.body.types import Floats, Ints, floats, indices, require
from vitruvian.errors import VitruvianError, warn
from vitruvian.hanim.humanoid import Humanoid

# What each parameter of a link is called, from which number to which it goes; the flexion axis is the fifth of the source.
RANGES = {
    "joint": (0, 1),
    "near": (0, 0.5),
    "far": (0, 0.5),
    "muscle": (0, 1),
    "belly": (0.2, 0.8),
    "arc": (0, 1),
    "palm": (0, 1),
}

STORED = "rounding:"  # of the keys in Humanoid.info, before the name of a joint or finger


@dataclass(frozen=True)
class Rounding:
    """How a link deforms. `joint` (0..1, 1 is the mitre) inflates the back of a bent joint, over the portions `near` and
    `far` (0..0.5) of the link next to its two joints; `muscle` (0..1) inflates its palm side, most at `belly` (0.2..0.8)
    of its length. `axis`: unit flexion axis of the link's first joint in humanoid space at rest, positive towards the
    palm; None: fitted to the skeleton. `arc` (0..1): how far the back of a bent joint follows a circle; 0 leaves the
    corner of the source's construction. `palm` (0..1): how much of the muscle's inflation the inner side of the palm
    takes, on metacarpals that bend and between those that approach; 0 as in the source, where it takes none.
    """

    joint: float = 0.5
    near: float = 0.3
    far: float = 0.3
    muscle: float = 0.3
    belly: float = 0.5
    axis: tuple[float, float, float] | None = None
    arc: float = 1.0
    palm: float = 0.0

    def __post_init__(self) -> None:
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            require(low <= value <= high, f"rounding {name}", f"{low} to {high}", value)
        if self.axis is not None:
            axis = floats(self.axis, "rounding axis", 3)
            require(float(np.linalg.norm(axis)) > 1e-9, "rounding axis", "a direction", self.axis)
            object.__setattr__(self, "axis", tuple(unit(axis).tolist()))

    @property
    def words(self) -> str:
        """What differs from the defaults, as text: "joint 0.8 axis 0 0 -1"."""
        default = Rounding()
        parts = [
            f"{name} {getattr(self, name):.6g}" for name in RANGES if getattr(self, name) != getattr(default, name)
        ]
        if self.axis is not None:
            parts.append("axis " + " ".join(f"{v:.6g}" for v in self.axis))
        return " ".join(parts) or "default"

    @staticmethod
    def read(words: str) -> Rounding:
        """From `words`. Raises VitruvianError for a name or a number that none of the parameters has."""
        values: dict[str, object] = {}
        left = [w for w in words.split() if w != "default"]
        try:
            while left:
                name = left.pop(0)
                count = 3 if name == "axis" else 1
                require(name in RANGES or name == "axis", "rounding", f"{', '.join(RANGES)} or axis", repr(name[:40]))
                numbers = [float(left.pop(0)) for _ in range(count)]
                values[name] = tuple(numbers) if name == "axis" else numbers[0]
        except (ValueError, IndexError):
            raise VitruvianError(f"rounding {name[:40]}: expected {count} numbers, found {words[:80]!r}") from None
        return Rounding(**values)  # type: ignore[arg-type]


def store_roundings(humanoid: Humanoid, roundings: Mapping[str, Rounding]) -> None:
    """Keep the parameters of a humanoid's hands in its `info`, which every format of scene files, glTF and USD carries.

    By joint or finger, as `deformer` takes them; those stored before go.
    """
    kept = {key: value for key, value in humanoid.info.items() if not key.startswith(STORED)}
    humanoid.info = kept | {f"{STORED}{name}": r.words for name, r in roundings.items()}


def roundings_of(document: object) -> dict[str, Rounding]:
    """Parameters by joint or finger out of JSON as pages of hands save it: {"l_metacarpophalangeal_2": "joint 0.8"}.

    Raises VitruvianError naming the entry that is not such words.
    """
    require(isinstance(document, dict), "hands", '{"joint or finger": "joint 0.8 muscle 0.5"}', repr(document)[:60])
    out = {}
    for name, words in document.items():  # type: ignore[attr-defined]
        require(isinstance(words, str), f"hands: {name[:60]}", "words such as 'joint 0.8'", repr(words)[:60])
        try:
            out[name] = Rounding.read(words)
        except VitruvianError as e:
            raise VitruvianError(f"hands: {name[:60]}: {e}") from None
    return out


def stored_roundings(humanoid: Humanoid) -> dict[str, Rounding]:
    """What `store_roundings` kept; entries that cannot be read are left out with a warning."""
    out = {}
    for key, value in humanoid.info.items():
        if key.startswith(STORED):
            try:
                out[key.removeprefix(STORED)] = Rounding.read(value)
            except VitruvianError as e:
                warn(f"info {key[:60]}: {e}; ignored")
    return out


@dataclass(frozen=True, eq=False)
class Hand:
    """The links of one hand, near the wrist first, and the skin that follows them.

    before, near, far (L,): the joint before the link's first joint (-1: none), its first joint, and its last one (-1: a
    fingertip). start, end (L,3): where they are at rest. axis_near, axis_far (L,3): unit flexion axes there, positive
    towards the palm. beside (L,2): neighbouring links of the palm, -1 for none. roundings (L).
    vertices (N,): the skin of the hand; share (N,) in 0..1: how much of the hand's deformation each takes.
    fade: over which portion of the first link of each finger the hand's deformation sets in; 0: it is whole at once.
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
    fade: float = 0.0

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
        require(0 <= self.fade <= 1, f"{title}: fade", "0 to 1", self.fade)

    def before_links(self) -> Ints:
        """(L,) the link that ends where each link begins, -1 for the first of a finger."""
        ends = {int(j): i for i, j in enumerate(self.far) if j >= 0}
        out = [ends.get(int(j), -1) for j in self.near]
        return np.array([-1 if i == j else j for i, j in enumerate(out)], np.int32)

    def rounded(self, roundings: tuple[Rounding, ...]) -> Hand:
        """The same hand with other parameters, one a link; an axis that is given replaces that of both its links."""
        near, far = self.axis_near.copy(), self.axis_far.copy()
        previous = self.before_links()
        for i, rounding in enumerate(roundings):
            if rounding.axis is not None:
                near[i] = rounding.axis
                if previous[i] >= 0:
                    far[previous[i]] = rounding.axis
        return replace(self, roundings=roundings, axis_near=near, axis_far=far)
