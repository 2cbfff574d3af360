"""Repairs of the file: header, DEFs, containerFields, profile."""

from __future__ import annotations

import re
from collections.abc import Iterator

from vitruvian.hanim.doctor import Chart
from vitruvian.hanim.doctor_file import VERSIONS, header_version, legal, right_field, uncovered, unsaid
from vitruvian.hanim.doctor_fix import Names, Wanted, put, take, target
from vitruvian.hanim.graph import Node

_ONE = {"skinCoord", "skinNormal", "coord", "skinBindingCoords", "skinBindingNormals"}  # fields of a single node


def _header(chart: Chart, wanted: Wanted) -> Iterator[str]:
    """F01: a version that exists."""
    scene = chart.scene
    if scene.encoding != "wrl" and scene.version not in VERSIONS:
        old, scene.version = scene.version or "(none)", header_version(chart)
        yield f"the header's version {old} is {scene.version} (F01)"


def _defs(chart: Chart, wanted: Wanted) -> Iterator[str]:
    """F04: each DEF once and legal; USEs and ROUTEs follow."""
    names, seen = Names(chart.scene), set()
    for node in chart.nodes:
        old = node.name
        if not old:
            continue
        again = old in seen and chart.scene.encoding != "wrl"
        if again or (chart.scene.encoding == "x3d" and not legal(old)):
            plain = re.sub(r"[^\w.\-:\u00b7]", "_", old)
            names.rename(node, names.free(plain), alone=not again)
            yield f"DEF {old!r} of line {node.line} is {node.name} (F04)"
        seen.add(node.name)


def _places(chart: Chart, wanted: Wanted) -> Iterator[str]:
    """F06 (and M15): nodes into the fields where they belong, containerField written out."""
    for node in chart.nodes:
        if not chart.reading.kind(node) or not node.type.startswith("HAnim"):
            continue
        for field, entry in list(node.entries()):
            child = target(entry)
            if child is None:
                continue
            right = right_field(chart, node, field, entry)
            if right != field:
                if right in _ONE and node.children(right):
                    continue  # there is one already: nobody knows which is meant
                take(node, field, entry)
                put(node, right, entry)
                rules = "F06, M15" if right == "motions" else "F06"
                yield f"{child.type} {entry.name} moved from {field} to {right} ({rules})"
            elif unsaid(chart, field, entry):
                entry.container = field
                yield f"{child.type} {entry.name} given containerField='{field}' (F06)"


def _profile(chart: Chart, wanted: Wanted) -> Iterator[str]:
    """F07: the components that the nodes need."""
    scene = chart.scene
    if scene.encoding == "wrl" or not any(isinstance(s, Node) for s in scene.body):
        return
    if not scene.profile:
        scene.profile = "Immersive"
        yield "profile Immersive given (F07)"
    for name, _ in uncovered(chart):
        name = "H-Anim" if name == "HAnim" and scene.version < "4" else name
        scene.components.append((name, 1))
        yield f"component {name} added (F07)"


STEPS = (_header, _defs, _places, _profile)
