"""The H-Anim doctor: what is wrong with a scene, where, why it matters in real browsers, and how to mend it.

`check` never raises on bad content; whatever it cannot read becomes a finding. Rules that start with M are about
"why it does not move", S about the skin, N names, T the tree, V versions, F the file, P places, D displacers
and limits.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.errors import FileError
from vitruvian.hanim.doctor_rules import RULES, SEVERITIES
from vitruvian.hanim.doctor_words import closest, several
from vitruvian.hanim.graph import Literal, Node, Scene, Use
from vitruvian.hanim.reading import KINDS, Reading, leniently
from vitruvian.hanim.values import bare

Floats = NDArray[np.float64]
_DEEPEST = 1024  # holders of one node that are looked at
_LONGEST = 48  # steps of a way through the file that are told
_GUESSES = 100  # looking for near words is slow, and a hostile file may hold many odd ones
_QUOTED = re.compile(r'"((?:[^"\\]|\\.)*+)"', re.DOTALL)


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong. `severity` "error", "warning" or "note"; `where` the object, `line` 1-based or 0.

    `fix` says what to do ("" when nothing can be proposed). `path` is the way to the object through the file: DEFs (or
    node types) from the scene down, with slashes.
    """

    rule: str
    severity: str
    where: str
    line: int
    message: str
    fix: str = ""
    path: str = ""

    @property
    def why(self) -> str:
        """Why it matters in real browsers, in one sentence."""
        return RULES[self.rule].why


def finding(rule: str, where: str, line: int, message: str, fix: str = "", path: str = "") -> Finding:
    """A finding with the severity that the table of rules gives."""
    return Finding(rule, SEVERITIES[RULES[rule].severity], where, line, message, fix, path)


def unreadable(error: FileError, text: str = "") -> Finding:
    """F02: the finding for a file whose syntax is broken: what stands in that line (`text`), what was read before it."""
    said = [f"the line reads: {text}"] if text else []
    if isinstance(error.partial, Scene):
        said.append(f"read before it: {salvaged(error.partial)}")
    return finding("F02", "file", error.line, error.what, "; ".join(said))


def salvaged(scene: Scene) -> str:
    """What of a broken scene could be read, in words: H-Anim objects, other nodes, the last node of all."""
    reading = Reading(scene)
    nodes = list(scene.walk())
    counts = Counter(reading.kind(n) for n in nodes)
    words = [several(counts[k], k.lower(), f"{k.lower()}s") for k in KINDS if counts[k]]
    if counts[""]:
        words.append(several(counts[""], "other node", "other nodes"))
    if not nodes:
        return "no node"
    last = max(nodes, key=lambda n: n.line)
    place = f" of line {last.line}" if last.line else ""
    return f"{', '.join(words)}; the last is {f'{last.type} {last.name}'.strip()[:80]}{place}"


def sort(findings: list[Finding]) -> list[Finding]:
    """Errors first, then in order of lines."""
    order = {word: k for k, word in enumerate(SEVERITIES.values())}
    return sorted(findings, key=lambda f: (order[f.severity], f.line, f.rule))


def check(scene: Scene, path: object = None) -> list[Finding]:
    """All findings about a scene, errors first, then in order of lines. Never raises on bad content.

    With the `path` of the file, urls are looked for beside it (F08). Source of the rules: `doctor_rules`.
    """
    from vitruvian.hanim import doctor_figure, doctor_file, doctor_motion, doctor_names, doctor_routes, doctor_values

    chart = Chart(scene, path)
    doctor_file.examine(chart)
    doctor_values.numbers(chart)
    figures = [doctor_figure.Figure(chart, n) for n in chart.nodes if chart.reading.kind(n) == "Humanoid"]
    for figure in figures:
        doctor_figure.examine(figure)
        doctor_motion.examine(figure)
    doctor_names.together(chart, figures)
    doctor_figure.unattached(chart, figures)
    doctor_routes.examine(chart, figures)
    return sort(chart.findings)


class Chart:
    """What is being found out about one scene."""

    def __init__(self, scene: Scene, path: object = None):
        self.scene, self.path = scene, path
        self.reading = Reading(scene, path, repair=True)
        self.findings: list[Finding] = []
        self.nodes = list(scene.walk())
        self.forms: dict[tuple[str | int, str], str] = {}  # types of number fields, by type of node and field
        self.guesses = 0
        self._defs: dict[str, Node] | None = None
        self._parents: dict[int, Node] | None = None
        self._read: dict[tuple[int, str], Floats] = {}

    def add(self, rule: str, node: Node | None, message: str, fix: str = "", line: int = 0) -> None:
        """A finding about a node."""
        where = self.reading.who(node) if node is not None else "scene"
        line = line or (node.line if node is not None else 0)
        way = [n.name or n.type for n in reversed([node, *self.above(node)])] if node is not None else []
        if len(way) > _LONGEST:
            way[3 : len(way) - _LONGEST + 4] = ["..."]
        self.findings.append(finding(rule, where, line, message, fix, "/".join(way)))

    def defs(self) -> dict[str, Node]:
        """DEF name -> node, gathered once."""
        if self._defs is None:
            self._defs = self.scene.defs()
        return self._defs

    def closest(self, word: str, words: Iterable[str]) -> str:
        """The nearest of the words, "" when none is near, or when the file has had enough guesses."""
        self.guesses += 1
        return closest(word, list(words)) if self.guesses <= _GUESSES else ""

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

    def words(self, node: Node, field: str) -> list[str]:
        """The strings of a field of many strings; an unquoted one counts as a list of one."""
        raw = self.reading.raw(node, field)
        if isinstance(raw, list):
            return [str(v) for v in raw]
        if not isinstance(raw, Literal):
            return [raw] if isinstance(raw, str) and raw else []
        if raw.text.strip().strip("[").lstrip().startswith('"'):
            return [m.replace('\\"', '"') for m in _QUOTED.findall(raw.text)]
        return [raw.text.strip()] if raw.text.strip(" []\t\n") else []

    def names(self, node: Node, field: str) -> list[str]:
        """The blank- or comma-separated words of a field, whatever its quotes and brackets."""
        return [w for text in self.words(node, field) for w in re.split(r"[\s,]+", text) if w]

    def flag(self, node: Node, field: str) -> bool | None:
        """TRUE, FALSE or not given."""
        raw = self.reading.raw(node, field)
        if isinstance(raw, Literal):
            return raw.text.strip().lower() == "true"
        return None if raw is None else bool(raw)
