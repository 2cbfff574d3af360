"""The names of the standard: joints, segments and feature points of H-Anim 2.0 and 1.x, and the bridges between them.

Everything comes from the JSON tables beside this module (facts of ISO/IEC 19774:2019 and :2006 as the Web3D schemas
list them) and is read when first asked for. A *kind* is "joint", "segment" or "site": the same word may be an alias in
one kind and something else in another, so names are always resolved per kind. "2.0" names are the canonical ones;
"1.x" stands for H-Anim 1.1, 200x and ISO/IEC 19774:2006.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from vitruvian.errors import VitruvianError

LOA_COUNTS = (1, 18, 71, 94, 146)  # joints of a complete figure at levels of articulation 0..4 (2.0)
ROOT = "humanoid_root"
_STATURE_RATIO = 1.09  # stature of the default figure over the stature of the complete one: 1.7504 m / 1.610 m


@dataclass(frozen=True, slots=True)
class JointEntry:
    """One line of the joint table. `center` is the default centre (m, humanoid space), None where the table has none.

    `full_center` comes from a complete skeleton of other proportions; only differences of it may be used.
    """

    index: int
    name: str
    parent: str | None
    segment: str
    loa: int
    center: tuple[float, float, float] | None
    full_center: tuple[float, float, float] | None
    name_1x: str | None
    aliases: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FeaturePoint:
    """A named place on the body: the segment it hangs on ("" when the table does not say) and its default position."""

    name: str
    segment: str
    loa: int
    position: tuple[float, float, float] | None


@cache
def _data(name: str) -> dict:
    return json.loads((files("vitruvian.hanim") / "data" / f"{name}.json").read_text("utf-8"))


def _point(value: list[float] | None) -> tuple[float, float, float] | None:
    return None if value is None else (float(value[0]), float(value[1]), float(value[2]))


def family(version: str) -> str:
    """ "1.x" or "2.0" for a version string of a Humanoid ("1.0", "1.1", "200x", "2.0", ""; empty means 2.0)."""
    return "1.x" if version.strip().lower() in {"1.0", "1.1", "1.x", "200x", "2006", "19774:2006"} else "2.0"


@cache
def joints(version: str = "2.0") -> dict[str, JointEntry]:
    """name -> entry in table order, parents before children: 146 joints of 2.0, or 94 of 1.x (root `humanoid_root`)."""
    if family(version) == "2.0":
        return {
            j["name"]: JointEntry(
                j["index"],
                j["name"],
                j["parent"],
                j["segment"],
                j["loa"],
                _point(j["default_center"]),
                _point(j["jin_scaled_center"]),
                j["hanim1_name"],
                tuple(j["other_aliases"]),
            )
            for j in _data("joints_2_0")["joints"]
        }
    return {
        j["name_19774_2006"]: JointEntry(
            j["index"],
            j["name_19774_2006"],
            j["parent"],
            j["segment"],
            j["loa"],
            _point(j["symmetrised_center"]),
            None,
            j["name_19774_2006"],
            (j["name_1_1"],) if j["name_1_1"] != j["name_19774_2006"] else (),
        )
        for j in _data("joints_1_1_200x")["joints"]
    }


@cache
def joints_at(loa: int, version: str = "2.0") -> tuple[str, ...]:
    """Names of all joints of a complete figure at that level of articulation, in table order."""
    top = 4 if family(version) == "2.0" else 3
    if not 0 <= loa <= top:
        raise VitruvianError(f"level of articulation: expected 0..{top} for H-Anim {version}, found {loa}")
    return tuple(n for n, j in joints(version).items() if j.loa <= loa)


@cache
def parent_at(name: str, loa: int, version: str = "2.0") -> str | None:
    """The joint above `name` in a figure of that level: its nearest ancestor in the full tree with loa <= `loa`."""
    table = joints(version)
    parent = table[name].parent
    while parent is not None and table[parent].loa > loa:
        parent = table[parent].parent
    return parent


def complete_loa(names: Iterable[str]) -> int:
    """The largest level whose joints (2.0 names) are all there; -1 when even `humanoid_root` is missing."""
    have = set(names)
    found = -1
    for loa in range(len(LOA_COUNTS)):
        if not have.issuperset(joints_at(loa)):
            break
        found = loa
    return found


@cache
def segments(version: str = "2.0") -> dict[str, str]:
    """Segment name -> its joint, in table order."""
    if family(version) == "2.0":
        return {s["name"]: s["joint"] for s in _data("segments")["segments"]}
    return {j.segment: j.name for j in joints("1.x").values()}


@cache
def feature_points(version: str = "2.0") -> dict[str, FeaturePoint]:
    """Feature point name -> entry: 118 of 2.0 or 76 of 1.x (without their `_pt`)."""
    if family(version) == "2.0":
        return {
            p["name"]: FeaturePoint(p["name"], p["segment"], p["loa"], _point(p["default_translation"]))
            for p in _data("feature_points")["feature_points_2_0"]
        }
    return {p["name"]: FeaturePoint(p["name"], "", 1, None) for p in _data("feature_points")["feature_points_1_x"]}


@cache
def _to_2(kind: str) -> dict[str, str]:
    """Every known name of a kind -> its 2.0 name; a 2.0 name always means itself."""
    aliases = _data("aliases")
    if kind == "joint":
        table = {**aliases["joints_alias_to_2"], **aliases["joints_1_to_2"]}
        own: Iterable[str] = joints()
    elif kind == "segment":
        table = dict(aliases["segments_alias_to_2"])
        table |= {j.segment: joints()[canonical(j.name) or j.name].segment for j in joints("1.x").values()}
        own = segments()
    elif kind == "site":
        table, own = dict(aliases["feature_points_alias_to_2"]), feature_points()
    else:
        raise VitruvianError(f"kind of name: expected joint, segment or site, found {kind!r}")
    return {**table, **{name: name for name in own}}


_SUFFIX = re.compile(r"_(?:tip|view|pt)\Z")


@cache
def canonical(name: str, kind: str = "joint") -> str | None:
    """The 2.0 name of anything the standard or its older texts call by `name`, case sensitive; None when unknown.

    Sites lose `_pt`, `_tip`, `_view`, dots and the `/bustpoint` of old spellings; an end effector is answered by the
    name of its feature point when it has one.
    """
    table = _to_2(kind)
    if name in table:
        return table[name]
    if kind == "site":
        plain = name.replace(".", "").replace("/bustpoint", "")
        for candidate in (plain, _SUFFIX.sub("", plain)):
            if candidate in table:
                return table[candidate]
    return None


@cache
def _joints_to_1() -> dict[str, str]:
    return {j.name: j.name_1x for j in joints().values() if j.name_1x}


@cache
def name_in(name: str, version: str, kind: str = "joint") -> str | None:
    """What `version` calls the thing known as `name`: the 2.0 name, or the 1.x name (1.1 and 200x: `HumanoidRoot`).

    None when `name` is unknown or that version has no such thing (52 joints exist in 2.0 only).
    """
    known = canonical(name, kind)
    if known is None or family(version) == "2.0":
        return known
    if kind == "joint":
        old = _joints_to_1().get(known)
        return "HumanoidRoot" if old == ROOT and version in {"1.1", "200x"} else old
    if kind == "segment":
        joint = _joints_to_1().get(segments()[known])
        return None if joint is None else joints("1.x")[joint].segment
    for old in feature_points("1.x"):
        if canonical(old, "site") == known:
            return old
    return None


def humanoid_root(name: str) -> bool:
    """Whether `name` is one of the two spellings of the root."""
    return name in {ROOT, "HumanoidRoot"}


@cache
def default_centers(version: str = "2.0") -> dict[str, NDArray[np.float64]]:
    """name -> (3,) default joint centre in metres for every joint of that version, mirror symmetric.

    The left side is master, midline joints have x = 0. Where the 2.0 table has no value, the offset to the nearest
    ancestor with one is taken from a complete skeleton and scaled to the default stature of 1.75 m.
    """
    table = joints(version)
    given: dict[str, NDArray[np.float64]] = {}
    mirror = np.array([-1.0, 1.0, 1.0])
    for name, joint in table.items():
        mate = table.get({"l_": "r_", "r_": "l_"}.get(name[:2], "") + name[2:])
        if name.startswith("r_") and mate is not None:
            continue
        center = joint.center
        if center is None and mate is not None and mate.center is not None:
            x, y, z = mate.center
            center = (-x, y, z)
        if center is not None:
            given[name] = np.array(center) * (1.0 if name.startswith("l_") else (0.0, 1.0, 1.0))
            continue
        if joint.full_center is None:
            continue
        above = joint.parent
        while above is not None and above not in given:
            above = table[above].parent
        reference = None if above is None else table[above].full_center
        if above is None or reference is None:
            continue
        offset = np.subtract(joint.full_center, reference)
        given[name] = given[above] + _STATURE_RATIO * offset
    for name in table:
        if name.startswith("r_") and "l_" + name[2:] in given:
            given[name] = given["l_" + name[2:]] * mirror
    return {name: given[name] for name in table if name in given}
