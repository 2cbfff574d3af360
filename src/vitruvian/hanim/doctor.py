"""The H-Anim doctor: what is wrong with a scene, where, why it matters in real browsers, and how to mend it.

`check` never raises on bad content; whatever it cannot read becomes a finding. Rules that start with M are about
"why it does not move", S about the skin, N names, T the tree, V versions, F the file, P places, D displacers
and limits.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.errors import FileError
from vitruvian.hanim.fields import container_of, fields_of
from vitruvian.hanim.graph import Literal, Node, Scene, Use
from vitruvian.hanim.reading import Reading, leniently
from vitruvian.hanim.values import bare

Floats = NDArray[np.float64]
# Severity of each rule: E broken, W likely wrong, N style.
SEVERITY = {
    "F02": "E", "F03": "W", "F04": "E", "F05": "E", "F06": "W", "F07": "W",
    "V01": "W", "V02": "W", "V03": "N", "V04": "W", "V05": "N",
    "N01": "E", "N02": "E", "N03": "N", "N04": "E", "N07": "W", "N08": "W",
    "T01": "E", "T02": "E", "T03": "N", "T04": "E",
    "P01": "W", "P02": "W", "P03": "W", "P04": "W", "P05": "W", "P06": "E",
    "S01": "E", "S02": "E", "S03": "W", "S04": "W", "S05": "E", "S06": "W", "S07": "N", "S08": "E", "S09": "E",
    "D01": "E", "D02": "W", "D04": "W", "D05": "W",
    "M01": "E", "M02": "E", "M03": "E", "M04": "E", "M05": "E", "M06": "E", "M07": "E", "M08": "E", "M09": "W",
    "M10": "E", "M11": "N", "M12": "W", "M13": "E", "M14": "W", "M15": "E", "M16": "E", "M17": "W", "M18": "W",
    "M19": "W", "M20": "N", "M21": "W", "M22": "N",
}  # fmt: skip
_WORDS = {"E": "error", "W": "warning", "N": "note"}
# Number fields that are read for every node: their type decides how many numbers belong together.
_NUMERIC = {
    "center": "SFVec3f", "translation": "SFVec3f", "scale": "SFVec3f", "rotation": "SFRotation",
    "scaleOrientation": "SFRotation", "limitOrientation": "SFRotation", "centerOfMass": "SFVec3f",
    "point": "MFVec3f", "vector": "MFVec3f", "displacements": "MFVec3f", "coordIndex": "MFInt32", "index": "MFInt32",
    "skinCoordIndex": "MFInt32", "skinCoordWeight": "MFFloat", "llimit": "MFFloat", "ulimit": "MFFloat",
    "stiffness": "MFFloat", "mass": "SFFloat", "momentsOfInertia": "MFFloat", "weight": "SFFloat", "key": "MFFloat",
    "keyValue": "MFFloat", "values": "MFFloat", "cycleInterval": "SFFloat", "frameDuration": "SFFloat",
    "jointBindingPositions": "MFVec3f", "jointBindingRotations": "MFRotation", "jointBindingScales": "MFVec3f",
}  # fmt: skip
_DEEPEST = 1024  # holders of one node that are looked at
_SINGLE = {"SFVec3f": 3, "SFRotation": 4, "SFFloat": 1}


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong. `severity` "error", "warning" or "note"; `where` the object, `line` 1-based or 0.

    `fix` says what to do ("" when nothing can be proposed).
    """

    rule: str
    severity: str
    where: str
    line: int
    message: str
    fix: str = ""


def unreadable(error: FileError) -> Finding:
    """F02: the finding for a file that no scene could be read from."""
    return Finding("F02", _WORDS[SEVERITY["F02"]], "file", error.line, error.what, "")


def check(scene: Scene, path: object = None) -> list[Finding]:
    """All findings about a scene, errors first, then in order of lines. Never raises on bad content."""
    from vitruvian.hanim import doctor_figure, doctor_motion

    chart = Chart(scene, path)
    _file(chart)
    _numbers(chart)
    figures = [doctor_figure.Figure(chart, n) for n in chart.nodes if chart.reading.kind(n) == "Humanoid"]
    for figure in figures:
        doctor_figure.examine(figure)
        doctor_motion.motions(figure)
    doctor_figure.together(chart, figures)
    doctor_motion.routes(chart, figures)
    order = {"error": 0, "warning": 1, "note": 2}
    return sorted(chart.findings, key=lambda f: (order[f.severity], f.line, f.rule))


class Chart:
    """What is being found out about one scene."""

    def __init__(self, scene: Scene, path: object = None):
        self.scene = scene
        self.reading = Reading(scene, path, repair=True)
        self.findings: list[Finding] = []
        self.nodes = list(scene.walk())
        self._parents: dict[int, Node] | None = None
        self._read: dict[tuple[int, str], Floats] = {}

    def add(self, rule: str, node: Node | None, message: str, fix: str = "", line: int = 0) -> None:
        """A finding about a node."""
        where = self.reading.who(node) if node is not None else "scene"
        line = line or (node.line if node is not None else 0)
        self.findings.append(Finding(rule, _WORDS[SEVERITY[rule]], where, line, message, fix))

    def above(self, node: Node) -> list[Node]:
        """The nodes that hold a node, nearest first."""
        if self._parents is None:
            self._parents = {}
            for parent in self.nodes:
                for _, child in parent.entries():
                    if isinstance(child, Node):
                        self._parents.setdefault(id(child), parent)
        found: list[Node] = []
        holder = self._parents.get(id(node))
        while holder is not None and len(found) < _DEEPEST:
            found.append(holder)
            holder = self._parents.get(id(holder))
        return found

    def numbers(self, node: Node, field: str) -> Floats:
        """(n,) the numbers of a field; what is no number is NaN; nothing when absent. Not to be changed."""
        key = (id(node), field)
        if key not in self._read:
            self._read[key] = self._numbers(node, field)
        return self._read[key]

    def _numbers(self, node: Node, field: str) -> Floats:
        raw = self.reading.raw(node, field)
        if isinstance(raw, Literal):
            return leniently(raw.text)
        if raw is None or isinstance(raw, Node | Use | str):
            return np.zeros(0)
        try:
            return np.asarray(raw, np.float64).reshape(-1)
        except (TypeError, ValueError):
            return np.zeros(0)

    def indices(self, node: Node, field: str) -> NDArray[np.int64]:
        """(n,) whole numbers of a field; what is none is a large negative number."""
        array = self.numbers(node, field)
        good = np.isfinite(array) & (np.abs(array) < 2**53)
        return np.where(good, array, -(2.0**40)).astype(np.int64)

    def text(self, node: Node, field: str) -> str:
        """A string field, stripped; "" when absent or unreadable."""
        raw = self.reading.raw(node, field)
        if isinstance(raw, Literal):
            return bare(raw).strip().strip("[]").strip().strip('"').strip()
        if isinstance(raw, list):
            return " ".join(str(v) for v in raw)
        return str(raw).strip() if isinstance(raw, str) else ""

    def flag(self, node: Node, field: str) -> bool | None:
        """TRUE, FALSE or not given."""
        raw = self.reading.raw(node, field)
        if isinstance(raw, Literal):
            return raw.text.strip().lower() == "true"
        return None if raw is None else bool(raw)


def _file(chart: Chart) -> None:
    """F03 unknown fields of H-Anim nodes, F04 DEFs, F05 USEs, F06 containerFields."""
    scene = chart.scene
    seen: dict[str, Node] = {}
    for node in chart.nodes:
        if node.name in seen and node.name and scene.encoding != "wrl":
            other = seen[node.name].line
            chart.add("F04", node, f"DEF {node.name} is given twice (first in line {other})", "rename the later one")
        seen.setdefault(node.name, node)
        if node.name and re.search(r"\s", node.name):
            chart.add("F04", node, f"DEF {node.name!r} holds a blank", "take the blank out, in its USEs and ROUTEs too")
        kind = chart.reading.kind(node)
        if kind and node.type.startswith("HAnim"):
            known = fields_of(node.type)
            for field, value in node.fields.items():
                if known and field not in known and isinstance(value, Literal):
                    fix = _closest(field, list(known))
                    chart.add("F03", node, f"{node.type} has no field {field}: browsers ignore it", fix)
        for field, entry in node.entries():
            if isinstance(entry, Use) and entry.node is None:
                message = f"{field}: USE {entry.name} has no DEF before it: browsers drop the node"
                later = entry.name in scene.defs()
                fix = f"move the DEF {entry.name} before it" if later else f"add DEF {entry.name} or drop the USE"
                chart.add("F05", node, message, fix, entry.line)
            if scene.encoding == "x3d" and kind:
                _container(chart, node, kind, field, entry)
    _cycles(chart)
    native = next((n for n in chart.nodes if n.type.startswith("HAnim")), None)
    covered = scene.profile == "Full" or any(name in {"HAnim", "H-Anim"} for name, _ in scene.components)
    if native is not None and scene.profile and not covered:
        message = (
            f"profile {scene.profile} without component HAnim does not cover {native.type}: strict browsers refuse it"
        )
        chart.add("F07", native, message, "add component HAnim")


def _container(chart: Chart, node: Node, kind: str, field: str, entry: Node | Use) -> None:
    target = entry.node if isinstance(entry, Use) else entry
    if target is None or target.type.startswith("Metadata"):
        return
    child = chart.reading.kind(target)
    right = field
    if kind == "Humanoid" and entry.line and not entry.container and container_of(target.type) != field:
        message = f"{target.type} {entry.name} stands without containerField: browsers put it elsewhere"
        chart.add("F06", node, message, f"containerField='{field}'", entry.line)
        return
    if field == "children" and kind == "Humanoid" and child in {"Joint", "Segment", "Site"}:
        used = isinstance(entry, Use)
        right = {"Joint": "joints" if used else "skeleton", "Segment": "segments", "Site": "sites"}[child]
    elif field == "children" and kind == "Humanoid" and target.type in {"Coordinate", "CoordinateDouble"}:
        right = "skinCoord"
    elif field == "children" and child == "Displacer":
        right = "displacers"
    elif kind in {"Joint", "Segment"} and field not in {"children", "displacers", "coord", "metadata"} and child:
        right = "displacers" if child == "Displacer" else "children"
    if right != field:
        message = f"{target.type} {entry.name} stands in {field} of {node.type}, where it has no effect"
        chart.add("F06", node, message, f"containerField='{right}'", entry.line)


def _cycles(chart: Chart) -> None:
    """F05: a node that holds itself through a USE."""
    state: dict[int, int] = {}  # 1 on the way down, 2 done
    for root in [s for s in chart.scene.body if isinstance(s, Node)]:
        if id(root) in state:
            continue
        state[id(root)] = 1
        stack: list[tuple[Node, Iterator[tuple[str, Node | Use]]]] = [(root, root.entries())]
        while stack:
            node, below = stack[-1]
            for field, entry in below:
                child = entry.node if isinstance(entry, Use) else entry
                if child is None or state.get(id(child)) == 2:
                    continue
                if state.get(id(child)) == 1:
                    chart.add(
                        "F05",
                        node,
                        f"{field}: USE {entry.name} holds itself: an endless loop",
                        "cut the USE",
                        entry.line,
                    )
                    continue
                state[id(child)] = 1
                stack.append((child, child.entries()))
                break
            else:
                state[id(node)] = 2
                stack.pop()


def _numbers(chart: Chart) -> None:
    """P06: numbers that are not finite, not numbers at all or too few; zero or negative scale; non-unit axes."""
    for node in chart.nodes:
        kind = chart.reading.kind(node)
        for field, value in node.fields.items():
            wanted = _NUMERIC.get(field)
            if wanted is None or isinstance(value, Node | Use) or (isinstance(value, list) and not kind):
                continue
            array = chart.numbers(node, field)
            bad = np.flatnonzero(~np.isfinite(array))
            line = value.line if isinstance(value, Literal) else 0
            if bad.size:
                message = f"{field}: entry {bad[0]} is not a finite number"
                chart.add("P06", node, message, "give a number", line)
            elif wanted in _SINGLE and kind and len(array) not in (0, _SINGLE[wanted]):
                message = f"{field}: expected {_SINGLE[wanted]} numbers, found {len(array)}"
                chart.add("P06", node, message, "give the right count", line)
            elif kind and field == "scale" and (array <= 0).any():
                message = (
                    f"scale {' '.join(f'{v:g}' for v in array)}: zero collapses, negative turns the surface inside out"
                )
                chart.add("P06", node, message, "give a positive scale", line)
            elif kind and wanted == "SFRotation" and len(array) == 4 and array[3] != 0:
                size = float(np.linalg.norm(array[:3]))
                if abs(size - 1) > 1e-2:
                    message = f"{field}: the axis has length {size:.3g}, expected 1"
                    chart.add("P06", node, message, "normalise the axis" if size else "give an axis", line)


def _closest(word: str, words: list[str]) -> str:
    """A proposal when exactly one known word is near."""
    import difflib

    near = difflib.get_close_matches(word, words, n=1, cutoff=0.75)
    return f"perhaps {near[0]} is meant" if near else ""
