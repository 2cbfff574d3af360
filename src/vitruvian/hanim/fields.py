"""What fields each node type has: type, access, default; where an XML child goes when it doesn't say.

Facts of ISO/IEC 19775-1 (X3D), 14772-1 (VRML97) and 19774 (H-Anim), kept as data. A type that isn't in the tables is
an unknown node: its fields are kept as text and no entry is needed for it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

from vitruvian.hanim.graph import Node, Proto

ACCESS = {
    "eventIn": "inputOnly",
    "eventOut": "outputOnly",
    "field": "initializeOnly",
    "exposedField": "inputOutput",
    "inputOnly": "inputOnly",
    "outputOnly": "outputOnly",
    "initializeOnly": "initializeOnly",
    "inputOutput": "inputOutput",
}
"""The words of VRML97 and of X3D for how a field may be used -> X3D's words."""

# Fields that the schemas leave out.
_ADDED = {
    "Appearance": {"backMaterial": ("SFNode", "inputOutput", "NULL")},
    "HAnimJoint": {"addChildren": ("MFNode", "inputOnly", "[]"), "removeChildren": ("MFNode", "inputOnly", "[]")},
    "HAnimSegment": {"addChildren": ("MFNode", "inputOnly", "[]"), "removeChildren": ("MFNode", "inputOnly", "[]")},
    "HAnimSite": {"addChildren": ("MFNode", "inputOnly", "[]"), "removeChildren": ("MFNode", "inputOnly", "[]")},
    "HAnimMotion": {
        "next": ("SFBool", "inputOnly", ""),
        "previous": ("SFBool", "inputOnly", ""),
        "frameCount": ("SFInt32", "outputOnly", "0"),
        "cycleTime": ("SFTime", "outputOnly", "0"),
        "elapsedTime": ("SFTime", "outputOnly", "0"),
    },
}
_HANIM_CONTAINERS = {"HAnimDisplacer": "displacers", "HAnimMotion": "motions", "HAnimPose": "poses"}
# Where a child of a humanoid belongs when its containerField is missing: (as DEF, as USE).
_IN_HUMANOID = {
    "HAnimJoint": ("skeleton", "joints"),
    "HAnimSegment": ("segments", "segments"),
    "HAnimSite": ("skeleton", "sites"),
    "Coordinate": ("skinCoord", "skinCoord"),
    "CoordinateDouble": ("skinCoord", "skinCoord"),
    "Normal": ("skinNormal", "skinNormal"),
    "Shape": ("skin", "skin"),
    "Group": ("skin", "skin"),
    "Transform": ("skin", "skin"),
    "Viewpoint": ("viewpoints", "viewpoints"),
}


@dataclass(frozen=True, slots=True)
class Field:
    """`type` as in the standard (SFVec3f), `access` in X3D's words, `default` as XML text ("" when there is none)."""

    name: str
    type: str
    access: str
    default: str


def _table(name: str) -> dict:
    return json.loads((files("vitruvian.hanim") / "data" / name).read_text(encoding="utf-8"))


def _xml(default: object) -> str:
    """A default of the H-Anim table as XML text."""
    if default is None:
        return "NULL"
    if isinstance(default, bool):
        return "true" if default else "false"
    if isinstance(default, list | tuple):
        return " ".join(_xml(d) for d in default)
    return str(default)


@lru_cache(maxsize=1)
def _x3d() -> dict[str, dict]:
    return _table("x3d_fields.json")


@lru_cache(maxsize=1)
def _hanim() -> dict[str, dict[str, Field]]:
    """H-Anim nodes of X3D (4.1 draft, a superset of 3.0-4.0); the five prototypes of VRML97 with the robot dialect."""
    source = _table("node_fields.json")
    tables: dict[str, dict[str, Field]] = {}
    for node, entries in source["X3D_4_x_py"].items():
        table = tables[node] = {}
        for entry in entries:
            name = entry["name"]
            if name not in ("DEF", "USE", "IS", "class_", "id_", "style_"):
                kind, access = entry["type"].split(" ")[0], entry["access"].split(" ")[0]
                table[name] = Field(name, kind, access, _xml(entry["default"]))
    for version in ("VRML97_1_1", "VRML97_200x"):
        for node, fields in source[version].items():
            table = tables.setdefault(node, {})
            for name, (access, kind, default) in fields.items():
                table[name] = Field(name, kind, ACCESS[access], default)
    for name, (access, kind, default) in source["OpenHRP_dialect"]["Joint_extra"].items():
        tables["Joint"][name] = Field(name, kind, ACCESS[access], default)
    for node in ("Joint", "Segment"):
        for name in ("addChildren", "removeChildren"):
            tables[node].setdefault(name, Field(name, "MFNode", "inputOnly", "[]"))
    return tables


@lru_cache(maxsize=512)
def fields_of(node_type: str) -> Mapping[str, Field]:
    """Field name -> `Field` of a node type; empty for a type that the tables don't have."""
    hanim = _hanim().get(node_type)
    if hanim is not None:
        table = dict(hanim)
    else:
        raw = _x3d().get(node_type, {"fields": {}})["fields"]
        table = {name: Field(name, *entry) for name, entry in raw.items() if name != "IS"}
    for name, entry in _ADDED.get(node_type, {}).items():
        table.setdefault(name, Field(name, *entry))
    return table


def known(node_type: str) -> bool:
    """Whether the tables have this node type."""
    return node_type in _x3d() or node_type in _hanim()


def field(node_type: str, name: str) -> Field | None:
    """The field a ROUTE means by `name`: the field itself, or an inputOutput one through set_NAME or NAME_changed."""
    table = fields_of(node_type)
    found = table.get(name)
    if found is None and name.startswith("set_"):
        found = table.get(name[4:])
    if found is None and name.endswith("_changed"):
        found = table.get(name[:-8])
    return found


def type_of(node: Node, name: str, protos: Mapping[str, Proto]) -> str:
    """Type of a node's field ("SFVec3f"), "" when nothing tells it.

    Asks the node's own interface (Script), then the prototype of that name in `protos`, then the tables.
    """
    for own in node.interface:
        if own.name == name:
            return own.type
    proto = protos.get(node.type)
    if proto is not None:
        for own in proto.interface:
            if own.name == name:
                return own.type
    found = fields_of(node.type).get(name)
    return found.type if found is not None else ""


def native(node_type: str) -> bool:
    """Whether X3D has this node without any prototype."""
    return node_type in _x3d() or node_type.startswith("HAnim")


@lru_cache(maxsize=512)
def container_of(node_type: str) -> str:
    """The containerField that a node type has by default in X3D XML."""
    if node_type.startswith("Metadata"):
        return "metadata"
    if node_type in _HANIM_CONTAINERS:
        return _HANIM_CONTAINERS[node_type]
    entry = _x3d().get(node_type)
    return entry["container"] if entry is not None else "children"


def placement(parent_type: str, child_type: str, use: bool) -> str:
    """The field that an XML child without containerField lands in.

    Under a humanoid the node's default would be no field of the parent; there the place is guessed by type.
    """
    if parent_type == "HAnimHumanoid" and child_type in _IN_HUMANOID:
        return _IN_HUMANOID[child_type][use]
    if parent_type == "MetadataSet" and child_type.startswith("Metadata"):
        return "value"
    return container_of(child_type)


def node_types() -> list[str]:
    """All node types of the tables."""
    return [*_x3d(), *_hanim()]
