"""The five prototypes of VRML97 humanoids, 200x and 1.1, as declarations for a scene.

Interfaces are those of the table of node fields; bodies follow the standard's own, with its gaps closed: Joint has
`displacers`, Displacer has a body, Humanoid groups viewpoints, skeleton and skin.
"""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files

from vitruvian.hanim.graph import Literal, Node, Proto, ProtoField
from vitruvian.hanim.values import default_of

_ACCESS = {
    "field": "initializeOnly",
    "exposedField": "inputOutput",
    "eventIn": "inputOnly",
    "eventOut": "outputOnly",
}
_TRANSFORM = ("translation", "rotation", "scale", "scaleOrientation", "center")
_BOX = ("bboxCenter", "bboxSize")
_EVENTS = ("addChildren", "removeChildren")


@cache
def _interfaces(version: str) -> dict[str, dict[str, list[str | None]]]:
    table = json.loads((files("vitruvian.hanim") / "data" / "node_fields.json").read_text("utf-8"))
    return table["VRML97_1_1" if version == "1.1" else "VRML97_200x"]


def fields_of(version: str, name: str) -> set[str]:
    """Names of the fields of a prototype ("Humanoid", "Joint", "Segment", "Site", "Displacer")."""
    return set(_interfaces(version)[name])


def prototypes(version: str, extra: dict[str, dict[str, str]] | None = None) -> list[Proto]:
    """The declarations for "200x" or "1.1", in an order in which each may be used by the next.

    `extra`: further exposed fields per prototype, name -> type, as the robot dialect has them.
    """
    found = [_proto(version, name) for name in ("Displacer", "Site", "Segment", "Joint", "Humanoid")]
    for proto in found:
        for name, kind in (extra or {}).get(proto.name, {}).items():
            default = default_of(kind, "vrml")
            proto.interface.append(ProtoField("inputOutput", kind, name, Literal(default, "vrml")))
    return found


def _default(kind: str, text: str | None) -> Literal | None:
    if text is None:
        return None
    if kind == "SFString":
        text = f'"{text}"'
    elif kind.startswith("MF"):
        text = f"[ {text.strip('[]').strip()} ]".replace("[  ]", "[ ]")
    return Literal(text, "vrml")


def _proto(version: str, name: str) -> Proto:
    interface = _interfaces(version)[name]
    fields = [
        ProtoField(_ACCESS[access or ""], kind or "", field, _default(kind or "", default))
        for field, (access, kind, default) in interface.items()
    ]
    return Proto(name, fields, [_body(name, set(interface))])


def _body(name: str, fields: set[str]) -> Node:
    def linked(kind: str, names: tuple[str, ...]) -> Node:
        return Node(kind, connects=[(n, n) for n in names if n in fields])

    if name == "Displacer":
        return Node("Group")
    if name == "Segment":
        return linked("Group", (*_BOX, "children", *_EVENTS))
    if name in {"Joint", "Site"}:
        return linked("Transform", (*_TRANSFORM, "children", *_EVENTS))
    body = linked("Transform", (*_TRANSFORM, *_BOX))
    shown = [f for f in ("viewpoints", "humanoidBody", "skeleton", "skin") if f in fields]
    body.fields["children"] = [Node("Group", connects=[("children", f)]) for f in shown]
    return body
