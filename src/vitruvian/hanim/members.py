"""Which attribute of a typed object is which field of its node, in which versions of the standard.

One table serves the reader, the writer of new scenes and the update of a file's own graph. Node-valued fields and a few
that need more than their type (weights, names, the lists of USEs) have code of their own: `APART` says which and where.
Source: ISO/IEC 19774-1 and 19775-1, and the prototypes of VRML97 (`node_fields.json`).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

from vitruvian.errors import FileError
from vitruvian.hanim.fields import fields_of, type_of
from vitruvian.hanim.graph import Literal, Node, Use
from vitruvian.hanim.reading import Reading
from vitruvian.hanim.values import parse

DRAFT = "draft"  # X3D 4.1 as drafted: H-Anim 2.0 with HAnimPose
_SOURCES = {
    "1.0": "X3D_3_3",
    "2.0": "X3D_4_0",
    DRAFT: "X3D_4_x_py",
    "200x": "VRML97_200x",
    "1.1": "VRML97_1_1",
}


@dataclass(frozen=True, slots=True)
class Member:
    """`attribute` of the typed object, `field` of the node, its X3D `type` and default."""

    attribute: str
    field: str
    type: str
    default: object

    def differs(self, value: object) -> bool:
        """Whether a value has to be written."""
        return not alike(value, self.default)


_ZERO, _ONE, _NO_TURN, _UNKNOWN = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.0, 0.0, 1.0, 0.0), (-1.0, -1.0, -1.0)
_PLACE = (
    Member("translation", "translation", "SFVec3f", _ZERO),
    Member("rotation", "rotation", "SFRotation", _NO_TURN),
    Member("scale", "scale", "SFVec3f", _ONE),
    Member("scale_orientation", "scaleOrientation", "SFRotation", _NO_TURN),
    Member("center", "center", "SFVec3f", _ZERO),
)
_DESCRIBED = (Member("description", "description", "SFString", ""),)
_BOUNDED = (
    *_DESCRIBED,
    Member("bbox_center", "bboxCenter", "SFVec3f", _ZERO),
    Member("bbox_size", "bboxSize", "SFVec3f", _UNKNOWN),
    Member("bbox_display", "bboxDisplay", "SFBool", False),
    Member("visible", "visible", "SFBool", True),
)
MEMBERS: dict[str, tuple[Member, ...]] = {
    "Humanoid": (
        *_PLACE,
        *_BOUNDED,
        Member("skeletal_configuration", "skeletalConfiguration", "SFString", "BASIC"),
        Member("motions_enabled", "motionsEnabled", "MFBool", ()),
    ),
    "Joint": (*_PLACE, *_BOUNDED, Member("limit_orientation", "limitOrientation", "SFRotation", _NO_TURN)),
    "Segment": (
        *_BOUNDED,
        Member("mass", "mass", "SFFloat", 0.0),
        Member("center_of_mass", "centerOfMass", "SFVec3f", _ZERO),
    ),
    "Site": (*_PLACE, *_BOUNDED),
    "Displacer": (*_DESCRIBED, Member("weight", "weight", "SFFloat", 0.0)),
    "Motion": (
        *_DESCRIBED,
        Member("loa", "loa", "SFInt32", -1),
        Member("start_frame", "startFrame", "SFInt32", 0),
        Member("frame_increment", "frameIncrement", "SFInt32", 1),
        Member("frame_index", "frameIndex", "SFInt32", 0),
        Member("channels_enabled", "channelsEnabled", "MFBool", ()),
    ),
    "Pose": (
        *_DESCRIBED,
        Member("enabled", "enabled", "SFBool", True),
        Member("loa", "loa", "SFInt32", -1),
        Member("transition_duration", "transitionDuration", "SFTime", 0.0),
    ),
}
"""Fields that are read, compared and written by their type alone, per kind of object."""

# Fields with code of their own: the attribute that holds them.
APART: dict[str, dict[str, str]] = {
    "Humanoid": {
        "name": "name",
        "version": "version",
        "loa": "loa",
        "info": "info",
        "jointBindingPositions": "binding",
        "jointBindingRotations": "binding",
        "jointBindingScales": "binding",
        "skeleton": "skeleton",
        "humanoidBody": "skeleton",
        "joints": "joints",
        "segments": "segments",
        "sites": "all_sites",
        "viewpoints": "viewpoints",
        "skin": "skin",
        "skinCoord": "skin_coord",
        "skinNormal": "skin_normal",
        "skinBindingCoords": "skin_binding_coords",
        "skinBindingNormals": "skin_binding_normals",
        "motions": "motions",
        "displacers": "skin_displacers",
        "poses": "poses",
        "children": "children",
        "metadata": "metadata",
    },
    "Joint": {
        "name": "name",
        "children": "joints",
        "displacers": "displacers",
        "skinCoordIndex": "skin_coord_index",
        "skinCoordWeight": "skin_coord_weight",
        "llimit": "llimit",
        "ulimit": "ulimit",
        "stiffness": "stiffness",
        "metadata": "metadata",
    },
    "Segment": {
        "name": "name",
        "momentsOfInertia": "moments_of_inertia",
        "coord": "coord",
        "displacers": "displacers",
        "children": "children",
        "metadata": "metadata",
    },
    "Site": {"name": "name", "children": "children", "metadata": "metadata"},
    "Displacer": {
        "name": "name",
        "coordIndex": "coord_index",
        "displacements": "displacements",
        "metadata": "metadata",
    },
    "Motion": {
        "name": "name",
        "joints": "joints",
        "channels": "channels",
        "values": "values",
        "enabled": "enabled",
        "loop": "loop",
        "frameDuration": "frame_duration",
        "endFrame": "end_frame",
        "metadata": "metadata",
    },
    "Pose": {"name": "name", "children": "joints", "metadata": "metadata"},
}
# Fields that hold nothing to keep, and why.
WITHOUT_VALUE: dict[str, str] = {
    "containerField": "a word of the XML encoding: kept by the graph",
    "addChildren": "an event: see vitruvian.hanim.events",
    "removeChildren": "an event: see vitruvian.hanim.events",
    "frameCount": "an output: what `values` and `channels` give",
    "cycleTime": "an output while it plays",
    "elapsedTime": "an output while it plays",
    "next": "an event while it plays",
    "previous": "an event while it plays",
    "IS": "a prototype's connection: kept by the graph",
    "DEF": "kept by the graph",
    "USE": "kept by the graph",
}


def alike(a: object, b: object) -> bool:
    """Whether two field values are the same, arrays and sequences by their elements."""
    if a is None or b is None:
        return a is b
    if isinstance(a, np.ndarray) and isinstance(b, tuple) and a.ndim == 1 and a.size <= 16:
        return tuple(a.tolist()) == b or a.size == len(b) == 0
    if isinstance(a, np.ndarray | list | tuple) or isinstance(b, np.ndarray | list | tuple):
        x, y = np.asarray(a), np.asarray(b)
        return bool(np.array_equal(x, y)) or x.size == y.size == 0
    return bool(a == b)


@cache
def _table() -> dict[str, dict]:
    return json.loads((files("vitruvian.hanim") / "data" / "node_fields.json").read_text("utf-8"))


@cache
def available(version: str) -> dict[str, frozenset[str]]:
    """Kind of object -> names of the fields it has in "1.0" (X3D 3.x), "2.0" (4.0), "draft" (4.1), "200x", "1.1".

    A kind that the version lacks is absent. What every X3D node has (metadata) and the children that the schemas give
    by inheritance are counted in.
    """
    out: dict[str, frozenset[str]] = {}
    for node, entry in _table()[_SOURCES[version]].items():
        if isinstance(entry, list):
            names = {e["name"] for e in entry}
        elif "fields" in entry:
            names = {*entry["fields"], *entry.get("node_fields", {})}
        else:
            names = set(entry)
        kind = node.removeprefix("HAnim")
        if version in {"1.0", "2.0", DRAFT}:
            names |= {"metadata"} | ({"children"} if kind in {"Joint", "Segment", "Site"} else set())
        if version == DRAFT and kind == "Humanoid":
            names |= {"poses"}
        out[kind] = frozenset(names)
    return out


def has(version: str, kind: str, field: str) -> bool:
    """Whether objects of that kind have the field in a version."""
    return field in available(version).get(kind, ())


@cache
def _standard(kind: str) -> frozenset[str]:
    """Names that are no extras."""
    return frozenset({*(m.field for m in MEMBERS[kind]), *APART[kind], *WITHOUT_VALUE})


# What movement depends on: values that can't be read are refused. Others then have their default, with a warning.
_STRICT = {
    *(m.field for m in _PLACE),
    *("limitOrientation", "mass", "centerOfMass", "weight", "skeletalConfiguration"),
}


def read_members(reading: Reading, node: Node, thing: object, kind: str, *, soft: bool = False) -> None:
    """Fill the plain fields of a typed object, its metadata and its extras. `soft`: nothing in it is refused."""
    given = None if node.type in reading.protos else node.fields
    for m in MEMBERS[kind]:
        if given is not None and m.field not in given:
            continue
        raw = reading.raw(node, m.field)
        if raw is None:
            continue
        if soft or m.field not in _STRICT:
            setattr(thing, m.attribute, _soft(reading, node, m))
        else:
            setattr(thing, m.attribute, _strict(reading, node, m))
    metadata = node.children("metadata")
    if metadata:
        thing.metadata = metadata[0]  # type: ignore[attr-defined]
    thing.extras = _extras(reading, node, kind)  # type: ignore[attr-defined]


def _strict(reading: Reading, node: Node, m: Member) -> object:
    if m.type in {"SFVec3f", "SFRotation"}:
        return reading.vector(node, m.field, m.default)  # type: ignore[arg-type]
    if m.type == "SFString":
        return reading.text(node, m.field, str(m.default))
    return reading.number(node, m.field, float(m.default))  # type: ignore[arg-type]


def _soft(reading: Reading, node: Node, m: Member) -> object:
    default = np.array(m.default) if m.type in {"SFVec3f", "SFRotation"} else m.default
    value = reading.softly(node, m.field, m.type, default)
    if m.type in {"SFVec3f", "SFRotation"}:
        array = np.array(value, dtype=np.float64)
        return array * reading.length if m.field == "bboxSize" and (array >= 0).all() else array
    if m.type == "MFBool":
        return [bool(v) for v in value] if isinstance(value, list | tuple) else []
    if m.type == "SFBool":
        return bool(value)
    if m.type == "SFString":
        return str(value)
    number = float(value)  # type: ignore[arg-type]
    return int(number) if m.type == "SFInt32" else number


def _extras(reading: Reading, node: Node, kind: str) -> dict[str, object]:
    """Fields beyond the standard's: typed where the file's prototype or the robot dialect tells how."""
    out: dict[str, object] = {}
    standard = _standard(kind)
    for name, raw in node.fields.items():
        if name in standard or raw is None or isinstance(raw, Node | Use):
            continue
        if isinstance(raw, list) and any(not isinstance(v, str | bool) for v in raw):
            continue  # nodes: the graph keeps them
        out[name] = raw
        if isinstance(raw, Literal):
            declared = extra_type(reading, node, name)
            if not declared or declared.endswith("Node"):
                continue
            try:
                out[name] = parse(raw, declared, reading.path)
            except FileError as error:
                reading.defect("extra", f"{reading.who(node)} {name}: {error.what}; kept as text", node)
    return out


def extra_type(reading: Reading, node: Node, name: str) -> str:
    """Type of a field beyond the standard's, "" when nothing tells it."""
    declared = type_of(node, name, reading.protos)
    if declared:
        return declared
    kind = reading.kind(node)
    for table in (kind, "Transform"):  # the robot dialect; Segments with the fields of a Transform
        found = fields_of(table).get(name)
        if found is not None:
            return found.type
    return ""


def type_like(value: object) -> str:
    """The X3D type of a typed value, "" when it is none of a field."""
    if isinstance(value, np.ndarray):
        widths = {3: "MFVec3f", 4: "MFRotation", 2: "MFVec2f"}
        if value.ndim == 2:
            return widths.get(value.shape[1], "")
        return "MFInt32" if np.issubdtype(value.dtype, np.integer) else "MFFloat"
    for kind, name in ((bool, "SFBool"), (int, "SFInt32"), (float, "SFFloat"), (str, "SFString")):
        if isinstance(value, kind):
            return name
    return "MFString" if isinstance(value, list) and all(isinstance(v, str) for v in value) else ""


def set_members(fields: dict[str, object], thing: object, kind: str, version: str) -> list[str]:
    """Write the plain fields that differ from their defaults; answers those that the version does not have."""
    missing = []
    for m in MEMBERS[kind]:
        value = getattr(thing, m.attribute)
        if not m.differs(value):
            continue
        if has(version, kind, m.field):
            fields[m.field] = plain(value)
        else:
            missing.append(m.field)
    return missing


def plain(value: object) -> object:
    """A value as the graph wants it: NumPy's scalars and tuples as Python's."""
    if isinstance(value, np.generic):
        return value.item()
    return list(value) if isinstance(value, tuple) else value
