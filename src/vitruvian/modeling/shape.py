"""Sliders of the built-in person: from age, sex, muscle, weight, height to a shape.

A shape is `base + sum factor * target`; the factor of a target is the product of the factors of the words in its name.
Source: the macro parameters of the MakeHuman data, whose families and age ranges are in the names of its files.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache, lru_cache

import numpy as np

from vitruvian.body.types import Floats, Ints
from vitruvian.errors import VitruvianError, warn
from vitruvian.modeling.source import array, manifest, points, target

WEIGHTS = (-0.25, 1.75)  # beyond 0..1 only to meet a wish in kilograms: the data are extrapolated
# Face units that make the source's face the standard's neutral one: its lips part by a hair, the corners of its mouth
# hang and its lids are half down, which looks cross.
NEUTRAL = {"jawOpen": -0.05, "mouthSmileLeft": 0.14, "mouthSmileRight": 0.14, "eyeWideLeft": 0.3, "eyeWideRight": 0.3}
ORIGINS = ("african", "asian", "caucasian")
# The macro targets of weight and muscle stay within a few centimetres of the average; these details, scaled by how far
# the slider is from its middle, carry them on to builds that are met in the street. (at the low end, at the high end)
BUILD: dict[str, dict[str, tuple[float, float]]] = {
    "weight": {
        "stomach-tone": (0.3, -0.9), "measure-waist-circ": (-0.25, 0.75), "measure-underbust-circ": (-0.2, 0.55),
        "measure-hips-circ": (-0.25, 0.6), "measure-bust-circ": (-0.2, 0.45), "buttocks-volume": (-0.3, 0.5),
        "upperarm-fat": (-0.6, 0.9), "lowerarm-fat": (-0.5, 0.7), "upperleg-fat": (-0.6, 0.9),
        "lowerleg-fat": (-0.5, 0.7), "head-fat": (-0.35, 0.7), "neck-double": (0.0, 0.6),
        "measure-neck-circ": (-0.15, 0.4), "cheek-volume": (-0.3, 0.5),
    },
    "muscle": {
        "upperarm-muscle": (-0.4, 0.9), "lowerarm-muscle": (-0.4, 0.8), "upperarm-shoulder-muscle": (-0.4, 0.7),
        "upperleg-muscle": (-0.3, 0.7), "lowerleg-muscle": (-0.3, 0.7), "torso-muscle-pectoral": (-0.3, 0.6),
        "torso-muscle-dorsi": (-0.3, 0.6), "torso-vshape": (-0.1, 0.5), "measure-neck-circ": (-0.1, 0.4),
    },
}  # fmt: skip


@dataclass(frozen=True)
class Shape:
    """Slider values. gender 0 female to 1 male, age in years 10..90, the others 0..1; details name -> -1..1.

    girths: by what share girths are let out or taken in beyond that, see `vitruvian.modeling.letting`.
    """

    gender: float = 0.5
    age: float = 25.0
    muscle: float = 0.5
    weight: float = 0.5
    height: float = 0.5
    proportions: float = 0.5
    cup: float = 0.5
    firmness: float = 0.5
    origin: tuple[float, float, float] = (1 / 3, 1 / 3, 1 / 3)
    details: dict[str, float] = field(default_factory=dict)
    girths: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("gender", "muscle", "weight", "height", "proportions", "cup", "firmness"):
            value = getattr(self, name)
            least, most = WEIGHTS if name == "weight" else (0.0, 1.0)
            if not least <= value <= most:
                raise VitruvianError(f"{name}: expected a number in 0..1, found {value}")
        if not np.isfinite(self.age) or self.age <= 0:
            raise VitruvianError(f"age: expected years in 10..90, found {self.age}")
        if not 10 <= self.age <= 90:
            nearest = min(max(self.age, 10.0), 90.0)
            warn(f"age: the pack holds people of 10 to 90 years; {self.age:g} is taken for {nearest:g}")
            object.__setattr__(self, "age", nearest)
        total = sum(self.origin)
        if len(self.origin) != 3 or min(self.origin) < 0 or total <= 0:
            raise VitruvianError(f"origin: expected three numbers >= 0 with a positive sum, found {self.origin}")
        object.__setattr__(self, "origin", tuple(o / total for o in self.origin))


def _thirds(name: str, value: float) -> dict[str, float]:
    """Factors of the words min..., average..., max... of a slider."""
    most, least = max(0.0, 2 * value - 1), max(0.0, 1 - 2 * value)
    return {f"min{name}": least, f"max{name}": most, f"average{name}": 1 - most - least}


def word_factors(shape: Shape) -> dict[str, float]:
    """Factor of every word that may stand in the name of a macro target."""
    years = shape.age
    a = (years - 1) / 48 if years < 25 else 0.5 + (years - 25) / 130
    if a < 0.5:
        young = max(0.0, 3.2 * (a - 0.1875))
        child = max(0.0, min(1.0, 5.333 * a) - young)
        old = 0.0
    else:
        old = 2 * a - 1
        young, child = 1 - old, 0.0
    words = {"universal": 1.0, "female": 1 - shape.gender, "male": shape.gender}
    words |= {"child": child, "young": young, "old": old}
    words |= dict(zip(ORIGINS, shape.origin, strict=True))
    for name in ("muscle", "weight", "height", "cup", "firmness"):
        words |= _thirds(name, getattr(shape, name))
    ideal = _thirds("proportions", shape.proportions)
    words["idealproportions"], words["uncommonproportions"] = ideal["maxproportions"], ideal["minproportions"]
    return words


@cache
def _macros() -> dict[str, tuple[str, ...]]:
    """Macro targets: name -> its words."""
    known = set(word_factors(Shape()))
    split = {name: tuple(name.split("-")) for name in manifest()["targets"]}
    return {name: words for name, words in split.items() if known.issuperset(words)}


@cache
def _macro_words() -> tuple[tuple[str, ...], tuple[str, ...], Ints]:
    """Names of the macro targets (T,), the words that these are made of (W,), and (L,T) which: W where there is none."""
    macros = _macros()
    words = tuple(sorted({w for parts in macros.values() for w in parts}))
    place = {w: k for k, w in enumerate(words)}
    longest = max(len(parts) for parts in macros.values())
    rows = [[place[w] for w in parts] + [len(words)] * (longest - len(parts)) for parts in macros.values()]
    return tuple(macros), words, np.array(rows, np.int32).T


def details() -> list[str]:
    """Names of the detail sliders: pairs of targets that differ in their last word, such as `measure-waist-circ`."""
    names = {n.rsplit("-", 1)[0] for n in manifest()["targets"] if n not in _macros() and n.endswith(("decr", "incr"))}
    return sorted(names)


def factors(shape: Shape) -> dict[str, float]:
    """Target name -> factor, of those that are not zero."""
    words = word_factors(shape)
    names, used, place = _macro_words()
    amount = np.array([*(words[w] for w in used), 1.0])
    total = amount[place[0]]
    for column in place[1:]:
        total = total * amount[column]
    found = {names[k]: float(total[k]) for k in np.flatnonzero(total).tolist()}
    known = manifest()["targets"]
    wanted: dict[str, float] = {}
    for slider, table in BUILD.items():
        away = 2 * getattr(shape, slider) - 1
        for name, (low, high) in table.items():
            amount = away * high if away > 0 else -away * low
            for side in ("", "l-", "r-") if away else ():
                if f"{side}{name}-incr" in known:
                    wanted[side + name] = wanted.get(side + name, 0.0) + amount
    for name, value in shape.details.items():
        wanted[name] = wanted.get(name, 0.0) + value
    for name, value in wanted.items():
        if f"{name}-incr" not in manifest()["targets"]:
            raise VitruvianError(f"{name}: no such detail; there are {', '.join(details()[:6])} ...")
        if value:
            found[f"{name}-{'incr' if value > 0 else 'decr'}"] = abs(value)
    return found


@cache
def _neutral() -> Floats:
    """What makes the source's base face neutral; symmetric, the captures that the units came from are not quite."""
    out = np.zeros_like(points())
    for unit, amount in NEUTRAL.items():
        index, offset = target(unit, "faces")
        out[index] += amount * offset
    mirror = array("mirror")
    out[: len(mirror)] = (out[: len(mirror)] + out[mirror] * [-1, 1, 1]) / 2
    return out


@lru_cache(maxsize=128)
def _everywhere(name: str) -> Floats:
    """A target that moves most points, as one array: adding it is quicker than adding at indices."""
    index, offset = target(name)
    out = np.zeros_like(points())
    out[index] = offset
    return out


def shaped(shape: Shape) -> Floats:
    """(19158 + 326, 3) points of that shape in the source's A pose, metres; soles at the height they come out at."""
    out = points().copy()
    for name, factor in factors(shape).items():
        index, offset = target(name)
        if 2 * len(index) < len(out):
            out[index] += factor * offset
        else:
            out += factor * _everywhere(name)
    out += _neutral()
    if any(shape.girths.values()):
        from vitruvian.modeling.letting import let_out

        out = let_out(out, shape.girths)
    return out
