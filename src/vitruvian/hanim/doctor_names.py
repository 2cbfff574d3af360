"""The doctor's rules about names: of humanoids, joints, segments, sites and displacers, and their DEFs."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import cache
from typing import TYPE_CHECKING

from vitruvian.hanim import tables
from vitruvian.hanim.doctor_words import several, some
from vitruvian.hanim.graph import Node

if TYPE_CHECKING:
    from vitruvian.hanim.doctor import Chart
    from vitruvian.hanim.doctor_figure import Figure

_APIECE = 3  # nameless things of a kind that are told one by one
STRANGERS = 100  # names that are not in the tables, for which a near one is looked up
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
_SIDES = {"l": "l", "left": "l", "r": "r", "right": "r"}
SITE_SUFFIXES = ("_tip", "_view", "_pt")
DISPLACER_SUFFIXES = ("_feature", "_action", "_config")


def together(chart: Chart, figures: list[Figure]) -> None:
    """N08: several humanoids need names of their own; N05, which depends on how many there are."""
    counts = Counter(chart.text(f.node, "name") for f in figures)
    for f in figures:
        name = chart.text(f.node, "name")
        if not name:
            chart.add("N08", f.node, "the humanoid has no name", "give it one")
        elif counts[name] > 1:
            message = f"{counts[name]} humanoids are called {name}: their DEF prefixes collide"
            chart.add("N08", f.node, message, "rename")
        _prefixes(f, len(figures))


def things(figure: Figure) -> list[tuple[Node, str]]:
    """Joints, segments and sites of a humanoid, each with its kind of name."""
    found = [(j, "joint") for j in figure.joints] + [(s, "segment") for s, _ in figure.segments]
    return found + [(s, "site") for s in figure.sites]


def examine(figure: Figure) -> None:
    """N01 to N04, N06 and N07."""
    add, text = figure.chart.add, figure.chart.text
    strange, added = 0, []
    _nameless(figure)
    for node, kind in things(figure):
        name = text(node, "name")
        if not name:
            continue
        if kind != "site" and tables.canonical(name, kind) is None:
            strange += 1
            close = near(name, kind) if strange < STRANGERS else ""
            if close:
                add("N02", node, f"{kind} name {name} is not standard though close to one", f"name='{close}'")
            elif kind == "joint":
                added.append(node)
    for node in added if len(added) <= _APIECE else added[:1]:
        what = f"joint name {text(node, 'name')} is" if len(added) <= _APIECE else f"{len(added)} joint names are"
        names = "" if len(added) <= _APIECE else f" ({some([text(n, 'name') for n in added])})"
        add("N03", node, f"{what} not in the tables{names}: taken for an addition")
    alike: dict[str, list[Node]] = defaultdict(list)
    for joint in figure.joints:
        alike[text(joint, "name")].append(joint)
    for name, joints in alike.items():
        if name and len(joints) > 1:
            message = f"{len(joints)} joints are called {name}: motion drives one of them"
            add("N04", joints[1], message, "rename the other")
    for segment, wanted, joint_name in strangers(figure):
        own = text(segment, "name")
        message = f"segment {own} hangs on joint {joint_name}, whose segment is {wanted}"
        add("N07", segment, message, f"name='{wanted}'")
    _suffixes(figure)


def _nameless(figure: Figure) -> None:
    """N01: each by itself, or one finding for many of a kind."""
    bare: dict[str, list[Node]] = defaultdict(list)
    for node, kind in things(figure):
        if not figure.chart.text(node, "name"):
            bare[kind].append(node)
    for kind, nodes in bare.items():
        for node in nodes if len(nodes) <= _APIECE else nodes[:1]:
            what = f"{kind} without a name" if len(nodes) <= _APIECE else f"{len(nodes)} {kind}s without a name"
            derived = figure.name(node)
            fix = f"name='{derived}'" if derived and tables.canonical(derived, kind) else "give it its standard name"
            figure.chart.add("N01", node, f"{what}: nothing can address it", fix)


def strangers(figure: Figure) -> Iterator[tuple[Node, str, str]]:
    """N07: segments with the name of another joint's segment: (node, the name it should have, its joint)."""
    for segment, joint in figure.segments:
        own = tables.canonical(figure.chart.text(segment, "name"), "segment")
        joint_name = tables.canonical(figure.name(joint))
        if own and joint_name and tables.segments()[own] != joint_name:
            yield segment, tables.joints()[joint_name].segment, joint_name


def _prefixes(figure: Figure, humanoids: int) -> None:
    """N05: DEFs start with hanim_, or with the humanoid's name when there are several."""
    chart = figure.chart
    bare = [n for n, _ in things(figure) if n.name and not n.name.startswith(accepted(figure, humanoids))]
    if bare:
        message = several(len(bare), "DEF does", "DEFs do") + " not start with the prefix"
        message += f" {prefix(figure, humanoids)} ({bare[0].name}, ...)"
        chart.add("N05", bare[0], message, "--also N05 renames them, their USEs and ROUTEs")


def prefix(figure: Figure, humanoids: int) -> str:
    """The DEF prefix that the standard wants: hanim_ for one humanoid, its name for several."""
    name = "_".join(figure.chart.text(figure.node, "name").split())
    return "hanim_" if humanoids == 1 or not name else f"{name}_"


def accepted(figure: Figure, humanoids: int) -> tuple[str, ...]:
    """DEF prefixes that nobody complains about."""
    return (prefix(figure, humanoids), *(p for p in figure.prefixes if p and (humanoids == 1 or p != "hanim_")))


def _suffixes(figure: Figure) -> None:
    """N06: suffixes of sites, displacers and the Coordinates of segments."""
    chart = figure.chart
    for what, nodes, suffixes in (
        ("site", [s for s in figure.sites if chart.text(s, "name")], SITE_SUFFIXES),
        ("displacer", [d for d, _ in figure.displacers if chart.text(d, "name")], DISPLACER_SUFFIXES),
    ):
        bare = [n for n in nodes if not chart.text(n, "name").endswith(suffixes)]
        if bare:
            message = (
                several(len(bare), f"{what} has", f"{what}s have")
                + f" none of the suffixes {' '.join(suffixes)} ({chart.text(bare[0], 'name')}"
            )
            chart.add("N06", bare[0], message + ", ...)", "--also N06 adds them")
    odd = list(coordinates(figure))
    if odd:
        message = (
            f"{several(len(odd), 'Coordinate is', 'Coordinates are')} not called SEGMENT_coords ({odd[0][0].name}, ...)"
        )
        chart.add("N06", odd[0][0], message, f"DEF {odd[0][1]}")


def coordinates(figure: Figure) -> Iterator[tuple[Node, str]]:
    """N06: Coordinates in `coord` of a Segment whose DEF is not SEGMENT_coords, and what it should end in."""
    for segment, _ in figure.segments:
        wanted = f"{figure.chart.text(segment, 'name')}_coords"
        for coord in segment.children("coord"):
            if coord.name and wanted != "_coords" and not coord.name.endswith(wanted):
                yield coord, wanted


@cache
def near(name: str, kind: str = "joint") -> str:
    """The one standard name (of either version) that is close: within two edits, in other case, with the side written
    in another way (LeftShoulder, shoulder_l). "" when there is none, or several.
    """
    if len(name) > 60:
        return ""
    if kind == "joint":
        words = list(dict.fromkeys([*tables.joints(), *tables.joints("1.x")]))
    else:
        words = list(dict.fromkeys([*tables.segments(), *tables.segments("1.x")]))
    plain = "_".join(name.split()).lower()
    parts = [w.lower() for w in _WORD.findall(name)]
    variants = {plain, "_".join(parts)}
    for end in (0, -1):
        if len(parts) > 1 and parts[end] in _SIDES:
            rest = parts[1:] if end == 0 else parts[:-1]
            variants |= {f"{_SIDES[parts[end]]}_{'_'.join(rest)}", f"{_SIDES[parts[end]]}_{''.join(rest)}"}
    for word in words:
        if word.lower() in variants:
            return word
    if not 5 <= len(plain) <= 40:
        return ""
    digits = re.sub(r"\D", "", plain)  # vt3 and vt4 are one edit apart and both right
    alike = [w for w in words if abs(len(w) - len(plain)) <= 2 and re.sub(r"\D", "", w) == digits]
    found = {w: d for w in alike if (d := _edits(plain, w)) <= 2}
    nearest = [w for w, d in found.items() if d == min(found.values())]
    return nearest[0] if len(nearest) == 1 else ""


def _edits(a: str, b: str) -> int:
    """Levenshtein distance."""
    row = list(range(len(b) + 1))
    for i, x in enumerate(a, 1):
        last, row[0] = row[0], i
        for k, y in enumerate(b, 1):
            last, row[k] = row[k], min(row[k] + 1, row[k - 1] + 1, last + (x != y))
    return row[-1]
