"""Models of OpenSim (.osim of versions 2 and 3, where each body holds its joint): bodies, joints, coordinates, markers.

Read: CustomJoint, PinJoint and WeldJoint; functions LinearFunction, Constant, SimmSpline, NaturalCubicSpline,
PiecewiseLinearFunction, with a MultiplierFunction about them. Muscles, geometry and forces are left aside. The splines of
SIMM end in other third derivatives than ours, which changes what is between their last two knots only.
The parser is expat with entities refused, and neither depth nor size of the file is trusted.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from xml.parsers import expat

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.errors import FileError, warn
from vitruvian.formats.rows import content, number
from vitruvian.motion.mechanism import Drive, Link, Mechanism

LARGEST = 64 << 20
DEEPEST, MOST = 64, 500_000
_JOINTS = ("CustomJoint", "PinJoint", "WeldJoint")


@dataclass(slots=True)
class Element:
    """An element: its text is what stands before its first child."""

    tag: str
    name: str
    line: int
    text: str = ""
    children: list[Element] = field(default_factory=list)

    def child(self, tag: str) -> Element | None:
        return next((c for c in self.children if c.tag == tag), None)

    def under(self, *path: str) -> Element | None:
        here: Element | None = self
        for tag in path:
            here = None if here is None else here.child(tag)
        return here

    def word(self, tag: str) -> str:
        found = self.child(tag)
        return "" if found is None else found.text.strip()


def read_osim(path: str | os.PathLike[str]) -> Mechanism:
    """The mechanism of a model, metres, radians. Raises FileError with the line where it can't be one."""
    top = _tree(path, content(path, LARGEST))
    model = top if top.tag == "Model" else top.child("Model")
    bodies = None if model is None else model.under("BodySet", "objects")
    if model is None or bodies is None:
        raise FileError(path, top.line, "expected a Model with a BodySet, found none")
    if model.word("length_units").lower() not in ("", "meters", "metres", "m"):
        raise FileError(path, model.line, f"expected meters, found {model.word('length_units')[:20]!r}")
    if model.child("JointSet") is not None:
        raise FileError(
            path, model.line, "expected joints in their bodies (versions 2 and 3), found a JointSet (version 4)"
        )
    names: list[str] = []
    start: list[float] = []
    locked: list[bool] = []
    links: list[Link] = []
    index = {"ground": -1}
    for body in bodies.children:
        if body.tag != "Body" or body.name == "ground":
            continue
        if body.name in index:
            raise FileError(path, body.line, f"expected bodies of different names, found {body.name[:40]!r} twice")
        joint = body.child("Joint")
        kind = None if joint is None else next((c for c in joint.children if c.tag in _JOINTS), None)
        if kind is None:
            found = joint.children[0].tag if joint is not None and joint.children else "none"
            raise FileError(
                path, body.line, f"body {body.name[:40]!r}: expected one of {', '.join(_JOINTS)}, found {found[:40]}"
            )
        parent = kind.word("parent_body")
        if parent not in index:
            raise FileError(path, kind.line, f"body {body.name[:40]!r}: its parent {parent[:40]!r} is not before it")
        if kind.word("reverse").lower() == "true":
            raise FileError(path, kind.line, f"joint {kind.name[:40]!r}: reversed joints are not read")
        for item in getattr(kind.under("CoordinateSet", "objects"), "children", []):
            names.append(item.name)
            start.append(_numbers(path, item.child("default_value"), 1, [0.0])[0])
            locked.append(item.word("locked").lower() == "true")
        turns, slides = _drives(path, kind, names)
        links.append(
            Link(
                body.name,
                index[parent],
                _place(path, kind, "location_in_parent", "orientation_in_parent"),
                _place(path, kind, "location", "orientation"),
                turns,
                slides,
            )
        )
        index[body.name] = len(links) - 1
    if not links:
        raise FileError(path, bodies.line, "expected at least one body besides the ground, found none")
    known = [m for m in getattr(model.under("MarkerSet", "objects"), "children", []) if m.tag == "Marker"]
    there = [m for m in known if index.get(m.word("body"), -1) >= 0]
    if len(there) < len(known):
        warn(f"{path}: {len(known) - len(there)} markers sit on bodies that there are not; left out")
    if len(set(names)) < len(names):
        raise FileError(path, model.line, "expected coordinates of different names")
    return Mechanism(
        tuple(links),
        tuple(names),
        np.array(start, np.float64),
        np.array(locked, bool),
        tuple(m.name for m in there),
        np.array([index[m.word("body")] for m in there], np.int32),
        np.array([_numbers(path, m.child("location"), 3) for m in there], np.float64).reshape(-1, 3),
    )


def _tree(path: object, data: bytes) -> Element:
    """The document as elements. FileError where it is no XML, too deep, too large or declares entities."""
    top = Element("", "", 0)
    stack, count = [top], 0
    parser = expat.ParserCreate()
    parser.buffer_text = True

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if len(stack) > DEEPEST or count > MOST:
            raise FileError(path, parser.CurrentLineNumber, f"expected at most {DEEPEST} levels and {MOST:,} elements")
        made = Element(tag, attributes.get("name", ""), parser.CurrentLineNumber)
        stack[-1].children.append(made)
        stack.append(made)

    def end(tag: str) -> None:
        stack.pop()

    def text(data: str) -> None:
        if not stack[-1].children:
            stack[-1].text += data

    def entity(*_: object) -> None:
        raise FileError(path, parser.CurrentLineNumber, "declares entities, which are not read")

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = begin, end, text
    parser.EntityDeclHandler = entity
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        what = expat.errors.messages.get(error.code, str(error))
        raise FileError(path, error.lineno, f"is not well-formed XML: {what}") from None
    return top.children[0]


def _numbers(path: object, element: Element | None, count: int, default: list[float] | None = None) -> list[float]:
    words = [] if element is None else element.text.split()
    if not words and default is not None:
        return default
    line = 0 if element is None else element.line
    if len(words) != count and count:
        tag = "numbers" if element is None else element.tag
        raise FileError(path, line, f"{tag}: expected {count} numbers, found {len(words)}")
    return [number(path, line, w) for w in words]


def _place(path: object, joint: Element, location: str, orientation: str) -> Floats:
    """(4,4) of a location and angles about the moved X, Y and Z axes."""
    from vitruvian.motion.mechanism import _about

    out = np.eye(4)
    for axis, angle in zip(np.eye(3), _numbers(path, joint.child(orientation), 3, [0.0] * 3), strict=True):
        out[:3, :3] = out[:3, :3] @ _about(axis, np.array([angle]))[0]
    out[:3, 3] = _numbers(path, joint.child(location), 3, [0.0] * 3)
    return out


def _drives(path: object, joint: Element, names: list[str]) -> tuple[tuple[Drive, ...], tuple[Drive, ...]]:
    """Turns and slides of a joint."""
    if joint.tag == "WeldJoint":
        return (), ()
    if joint.tag == "PinJoint":
        if joint.under("CoordinateSet", "objects", "Coordinate") is None:
            raise FileError(path, joint.line, f"joint {joint.name[:40]!r}: expected a coordinate, found none")
        return (Drive(np.array([0.0, 0.0, 1.0]), len(names) - 1, (1.0, 0.0)),), ()
    axes = joint.child("SpatialTransform")
    if axes is None:
        raise FileError(path, joint.line, f"joint {joint.name[:40]!r}: expected a SpatialTransform, found none")
    turns = tuple(_drive(path, a, names) for a in axes.children if a.name.startswith("rotation"))
    return turns, tuple(_drive(path, a, names) for a in axes.children if a.name.startswith("translation"))


def _drive(path: object, element: Element, names: list[str]) -> Drive:
    axis = np.array(_numbers(path, element.child("axis"), 3))
    if not np.linalg.norm(axis) > 1e-9:
        raise FileError(path, element.line, f"{element.name[:40]}: expected an axis with a length, found {axis}")
    words = element.word("coordinates").split()
    if len(words) > 1 or (words and words[0] not in names):
        raise FileError(path, element.line, f"{element.name[:40]}: expected one known coordinate, found {words[:3]}")
    coordinate = names.index(words[0]) if words else -1
    scale, holder = 1.0, element.child("function") or element
    for _ in range(DEEPEST):  # multipliers of multipliers
        outer = holder.child("MultiplierFunction")
        if outer is None:
            break
        scale *= _numbers(path, outer.child("scale"), 1, [1.0])[0]
        holder = outer.child("function") or outer
    for tag in ("SimmSpline", "NaturalCubicSpline", "PiecewiseLinearFunction"):
        curve = holder.child(tag)
        if curve is not None:
            x, y = (_numbers(path, curve.child(c), 0) for c in "xy")
            if len(x) != len(y) or len(x) < 2 or (np.diff(x) <= 0).any():
                raise FileError(path, curve.line, f"{tag}: expected two rows of as many numbers, x rising")
            return Drive(axis, coordinate, knots=np.array([x, y]).T, scale=scale)
    line = holder.child("LinearFunction")
    if line is not None:
        slope, start = _numbers(path, line.child("coefficients"), 2, [1.0, 0.0])
        return Drive(axis, coordinate, (slope, start), scale=scale)
    constant = holder.child("Constant")
    if constant is not None:
        return Drive(axis, -1, (0.0, _numbers(path, constant.child("value"), 1, [0.0])[0]), scale=scale)
    found = holder.children[0].tag if holder.children else "none"
    raise FileError(path, element.line, f"{element.name[:40]}: expected a function that is known, found {found[:40]}")
