"""One pass over a scene graph: typed access to fields, units applied, defects collected and said once per kind."""

from __future__ import annotations

import os
import re

import numpy as np
from numpy.typing import NDArray

from vitruvian.errors import FileError, warn
from vitruvian.hanim.graph import Literal, Node, Proto, Scene
from vitruvian.hanim.humanoid import Picture
from vitruvian.hanim.values import bare, parse

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

KINDS = ("Humanoid", "Joint", "Segment", "Site", "Displacer", "Motion", "Pose")
_NAME = re.compile(r"(?:HAnim)?(Humanoid|Joint|Segment|Site|Displacer|Motion|Pose)(?:_?\d[\w.]*)?\Z")
# Fields that only one kind of prototype has in its interface: how prototypes under other names are recognised.
_MARKS = (
    ("humanoidBody", "Humanoid"),
    ("skeleton", "Humanoid"),
    ("limitOrientation", "Joint"),
    ("momentsOfInertia", "Segment"),
    ("displacements", "Displacer"),
)
_WIDTH = {"SFVec2f": 2, "SFVec3f": 3, "SFRotation": 4, "SFColor": 3}
_VECTORS = {2: "SFVec2f", 3: "SFVec3f", 4: "SFRotation"}
_SHARED = {"Coordinate", "CoordinateDouble", "TextureCoordinate", "Color", "ColorRGBA", "Normal"}
_LENGTHS = {"center", "translation", "point", "displacements", "centerOfMass", "jointBindingPositions", "size"}
_LENGTHS |= {"bboxCenter", "position"}


def leniently(text: str) -> Floats:
    """The numbers of a text in which some are not: those become NaN, so that the others keep their places."""

    def number(token: str) -> float:
        try:
            return float(token)
        except ValueError:
            return float("nan")

    try:
        return np.array([float(t) for t in text.strip(" \t\r\n[]").replace(",", " ").split()], np.float64)
    except ValueError:
        pass
    plain = re.sub(r"#[^\n]*", " ", text)
    return np.array([number(t) for t in re.split(r'[\s,\[\]"]+', plain) if t], np.float64)


class Reading:
    """Where typed values of one file come from. `repair` turns what would be an error into a reported repair.

    Fields that an instance does not give take the default of its prototype's interface.
    """

    def __init__(self, scene: Scene, path: object = None, repair: bool = False):
        self.scene = scene
        self.path = str(path if path is not None else scene.path) or "scene"
        self.repair = repair
        factors = {category: factor for category, _, factor in scene.units}
        self.length, self.angle = factors.get("length", 1.0), factors.get("angle", 1.0)
        self.protos: dict[str, Proto] = scene.protos()
        self.defects: dict[str, list[str]] = {}
        self.repairs = 0
        self._shared: dict[tuple[int, str], Floats] = {}
        self.primitives: dict[int, tuple[Floats, Ints]] = {}  # points and triangles, by geometry node
        self.pictures: dict[int, Picture] = {}  # by texture node
        self._kinds: dict[str, str] = {}

    def kind(self, node: Node) -> str:
        """Which H-Anim object a node is, native or prototype instance; "" when none."""
        found = self._kinds.get(node.type)
        if found is None:
            found = self._kinds[node.type] = self._find_kind(node.type)
        return found

    def _find_kind(self, name: str) -> str:
        match = _NAME.match(name)
        if match and (match[1] not in {"Motion", "Pose"} or name.startswith("HAnim")):
            return match[1]
        fields = {f.name for f in self.protos[name].interface} if name in self.protos else set()
        return next((kind for mark, kind in _MARKS if mark in fields), "")

    @property
    def folder(self) -> str:
        """Where the file's relative addresses begin; "" when it is none."""
        return os.path.dirname(os.path.abspath(self.scene.path)) if self.scene.path else ""

    def defect(self, rule: str, what: str, node: Node | None = None) -> None:
        """Remember something that is wrong but has one accepted meaning."""
        where = f"{self.path}:{node.line}: " if node is not None and node.line else f"{self.path}: "
        self.defects.setdefault(rule, []).append(where + what)

    def broken(self, what: str, node: Node | None = None, line: int = 0) -> None:
        """Refuse the file; in repair mode remember that the offender was dropped."""
        line = line or (node.line if node is not None else 0)
        if not self.repair:
            raise FileError(self.path, line, what)
        self.repairs += 1
        self.defect(f"repair {self.repairs}", f"repaired: {what}", node)

    def mend(self, node: Node, field: str, value: object) -> None:
        """In repair mode: put what is used instead (None: nothing) into the graph too, so that it will be written."""
        if self.repair and value is None:
            node.fields.pop(field, None)
        elif self.repair:
            node.fields[field] = value

    def say(self) -> None:
        """One warning per kind of defect: its first case and how many more there are."""
        for cases in self.defects.values():
            more = f" (and {len(cases) - 1} more like it)" if len(cases) > 1 else ""
            warn(cases[0] + more)
        self.defects.clear()

    def raw(self, node: Node, field: str) -> object:
        """The field's value as it stands, else the default of its prototype, else None."""
        value = node.fields.get(field)
        if value is None and node.type in self.protos:
            value = next((f.value for f in self.protos[node.type].interface if f.name == field), None)
        return value

    def _numbers(self, node: Node, field: str, kind: str) -> Floats | None:
        """Flat float64 of a field, or None when absent or (in repair mode) unreadable. Not checked for finiteness."""
        raw = self.raw(node, field)
        if raw is None:
            return None
        try:
            value = parse(raw, kind, self.path) if isinstance(raw, Literal) else raw
            array = np.asarray(value, dtype=np.float64).reshape(-1)
        except FileError as error:
            self.broken(f"{self.who(node)} {field}: {error.what}", node, error.line)
            return leniently(raw.text) if isinstance(raw, Literal) else None
        except (TypeError, ValueError):
            self.broken(f"{self.who(node)} {field}: expected {kind}, found something else", node)
            return None
        return array

    def vector(self, node: Node, field: str, default: tuple[float, ...]) -> Floats:
        """A fixed-length field, shape (len(default),); lengths in metres, angles in radians."""
        if self.raw(node, field) is None:
            return np.array(default, np.float64)
        kind = _VECTORS[len(default)]
        found = self._at_once(node, field, kind)
        if isinstance(found, np.ndarray) and len(found) == len(default):
            return self._in_si(found, node, field, kind)
        before = self.repairs
        array = self._numbers(node, field, kind)
        if array is None and self.repairs == before:
            return np.array(default)
        if array is None or self.repairs > before:
            self.mend(node, field, np.array(default))
            return np.array(default)
        if len(array) != len(default) or not np.isfinite(array).all():
            expected = f"{len(default)} finite numbers"
            found = " ".join(f"{v:g}" for v in array[:4])
            self.broken(f"{self.who(node)} {field}: expected {expected}, found {len(array)}: {found}", node)
            self.mend(node, field, np.array(default))
            return np.array(default)
        return self._in_si(array.copy(), node, field, kind)

    def _at_once(self, node: Node, field: str, kind: str) -> object:
        """The typed value of source text that nothing is wrong with, else None."""
        raw = self.raw(node, field)
        try:
            return parse(raw, kind, self.path) if isinstance(raw, Literal) else None
        except FileError:
            return None  # said, or mended, where it is looked at closely

    def _in_si(self, array: Floats, node: Node, field: str, kind: str) -> Floats:
        """The same array in metres or radians, a rotation about a unit axis."""
        if kind == "SFRotation":
            return self._rotation(array, node, field)
        if field in _LENGTHS and self.length != 1:
            array *= self.length
        return array

    def _rotation(self, value: Floats, node: Node, field: str) -> Floats:
        """The axis made a unit vector, the angle in radians; a zero axis means no rotation."""
        x, y, z, _ = value.tolist()
        size = (x * x + y * y + z * z) ** 0.5
        value[3] *= self.angle
        if size == 0:
            if value[3] != 0:
                self.defect("zero axis", f"{self.who(node)} {field}: axis 0 0 0 means no rotation", node)
            return np.array([0.0, 0.0, 1.0, 0.0])
        if abs(size - 1) > 1e-9:
            value[:3] /= size
        return value

    def numbers(self, node: Node, field: str, kind: str = "MFFloat", width: int = 1) -> Floats:
        """A many-valued field: shape (n,) for width 1, else (n, width). Non-finite numbers are refused.

        In repair mode non-finite numbers become 0, as the places of the others must not shift. Arrays of nodes that
        are typically USEd by many (Coordinate and its kin) are read once: the same array is answered again.
        """
        if node.type in _SHARED:
            key = (id(node), field)
            if key not in self._shared:
                self._shared[key] = self._many(node, field, kind, width)
            return self._shared[key]
        return self._many(node, field, kind, width)

    def was_read(self, node: Node, field: str) -> bool:
        """Whether `numbers` has answered this shared array before."""
        return (id(node), field) in self._shared

    def _many(self, node: Node, field: str, kind: str, width: int) -> Floats:
        before = self.repairs
        array = self._numbers(node, field, kind)
        if array is None:
            if self.repairs > before:
                self.mend(node, field, None)
            return np.zeros(0 if width == 1 else (0, width))
        told = isinstance(self.raw(node, field), Literal) and self.repairs == before  # text gives finite numbers only
        bad = np.zeros(0) if told else np.flatnonzero(~np.isfinite(array))
        if bad.size:
            if self.repairs == before:
                at = f"{array[bad[0]]} at entry {int(bad[0]) // width}"
                self.broken(f"{self.who(node)} {field}: expected finite numbers, found {at}", node)
            array = np.where(np.isfinite(array), array, 0.0)
        whole = len(array) // width * width
        if whole < len(array):
            self.broken(f"{self.who(node)} {field}: expected groups of {width} numbers, found {len(array)}", node)
            array = array[:whole]
        if self.repairs > before:
            typed = array.astype(np.int32) if kind == "MFInt32" else array
            self.mend(node, field, typed.reshape(-1, width) if width > 1 else typed)
        if field in _LENGTHS and self.length != 1:
            array = array * self.length
        return array.reshape(-1, width) if width > 1 else array

    def indices(self, node: Node, field: str) -> Ints:
        """A many-valued integer field, shape (n,)."""
        found = self._at_once(node, field, "MFInt32")
        if isinstance(found, np.ndarray):
            return found
        array = self.numbers(node, field, "MFInt32")
        if array.size and float(np.abs(array).max()) > 2**31 - 1:
            self.broken(
                f"{self.who(node)} {field}: expected 32-bit integers, found {array[np.abs(array).argmax()]:.0f}"
            )
            array = np.clip(array, -1, 2**31 - 1)
            self.mend(node, field, array.astype(np.int32))
        return array.astype(np.int32)

    def number(self, node: Node, field: str, default: float) -> float:
        """A single number."""
        if self.raw(node, field) is None:
            return default
        found = self._at_once(node, field, "SFFloat")
        if isinstance(found, float):
            return found
        before = self.repairs
        array = self._numbers(node, field, "SFFloat")
        if self.repairs > before:
            self.mend(node, field, default)
            return default
        if array is None or not len(array):
            return default
        if not np.isfinite(array[0]):
            self.broken(f"{self.who(node)} {field}: expected a finite number, found {array[0]}", node)
            self.mend(node, field, default)
            return default
        return float(array[0])

    def flag(self, node: Node, field: str, default: bool) -> bool:
        """TRUE or FALSE; anything else is refused."""
        raw = self.raw(node, field)
        if raw is None:
            return default
        try:
            return bool(parse(raw, "SFBool", self.path)) if isinstance(raw, Literal) else bool(raw)
        except FileError as error:
            self.broken(f"{self.who(node)} {field}: {error.what}", node, error.line)
            self.mend(node, field, default)
            return default

    def text(self, node: Node, field: str, default: str = "") -> str:
        """A string."""
        raw = self.raw(node, field)
        if raw is None:
            return default
        value = self._strings(node, field, raw, "SFString", default)
        return str(value)

    def texts(self, node: Node, field: str) -> list[str]:
        """A list of strings; an unquoted one counts as a list of one."""
        raw = self.raw(node, field)
        if raw is None:
            return []
        value = self._strings(node, field, raw, "MFString", [])
        return [str(v) for v in value] if isinstance(value, list | tuple) else [str(value)]

    def _strings(self, node: Node, field: str, raw: object, kind: str, default: object) -> object:
        if not isinstance(raw, Literal):
            return raw
        try:
            return parse(raw, kind, self.path)
        except FileError as error:
            self.broken(f"{self.who(node)} {field}: {error.what}", node, error.line)
            self.mend(node, field, default)
            return default

    def softly(self, node: Node, field: str, kind: str, default: object) -> object:
        """The value of a field that no movement depends on: unreadable, it is the default, with a warning.

        Lengths and angles are in SI units; a rotation has a unit axis.
        """
        raw = self.raw(node, field)
        if raw is None:
            return default
        try:
            value = parse(raw, kind, self.path) if isinstance(raw, Literal) else raw
        except FileError as error:
            self.defect(f"unreadable {field}", f"{self.who(node)} {field}: {error.what}; read as its default", node)
            return default
        if kind == "SFRotation":
            return self._rotation(np.array(value, dtype=np.float64), node, field)
        if field in _LENGTHS:
            return np.asarray(value, dtype=np.float64) * self.length
        return value

    def who(self, node: Node) -> str:
        """How messages call a node: its kind and its name or DEF."""
        raw = node.fields.get("name")
        name = ""
        if isinstance(raw, Literal):
            name = bare(raw).strip().strip('"')
        elif isinstance(raw, str):
            name = raw
        return f"{self.kind(node).lower() or node.type} {name or node.name}".strip()
