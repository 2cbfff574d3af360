"""The doctor's rules about one humanoid: names, tree, versions, lists, skin, displacers."""

from __future__ import annotations

from collections import Counter, defaultdict
from functools import cache

import numpy as np

from vitruvian.hanim import tables
from vitruvian.hanim.doctor import Chart
from vitruvian.hanim.graph import Node
from vitruvian.hanim.view import name_of, walk_groups

_STRANGERS = 100  # names that are not in the tables, for which a near one is looked up


class Figure:
    """A humanoid's nodes, gathered leniently."""

    def __init__(self, chart: Chart, node: Node):
        self.chart, self.node = chart, node
        self.joints: list[Node] = []  # each once, tree order
        self.parent: dict[int, Node | None] = {}
        self.segments: list[tuple[Node, Node]] = []  # with their joint
        self.sites: list[Node] = []
        self.displacers: list[tuple[Node, Node]] = []  # with their Joint or Segment
        self.roots: list[Node] = []
        self.twice: list[tuple[Node, Node]] = []  # joint reached again, and where
        self._tree()
        self.listed = [n for n in node.children("joints") if chart.reading.kind(n) == "Joint"]
        coords = node.children("skinCoord")
        self.skin_coord = coords[0] if coords else None
        self.points = chart.numbers(self.skin_coord, "point") if self.skin_coord is not None else np.zeros(0)
        self.points = self.points[: len(self.points) // 3 * 3].reshape(-1, 3)
        self.skin = [n for n in walk_all_groups(node.children("skin")) if n.type == "Shape"]
        self.names = {id(j): self.name(j) for j in self.joints}

    def name(self, node: Node) -> str:
        """The node's own name, or the one that its DEF gives it."""
        return self.chart.text(node, "name") or name_of(self.chart.reading, node, self.prefixes)

    @property
    def prefixes(self) -> tuple[str, ...]:
        own = self.chart.text(self.node, "name")
        return ("hanim_", f"{own}_" if own else "", f"{self.node.name}_" if self.node.name else "")

    def _tree(self) -> None:
        reading = self.chart.reading
        tops = self.node.children("skeleton") or self.node.children("humanoidBody")
        if not tops:
            value = self.node.fields.get("children")
            entries = value if isinstance(value, list) else []
            tops = [v for v in entries if isinstance(v, Node) and reading.kind(v) == "Joint"]
        stack: list[tuple[Node, Node | None, Node | None]] = [(n, None, None) for n in reversed(tops)]
        done: set[int] = set()
        while stack:
            node, joint, owner = stack.pop()
            kind = reading.kind(node)
            if kind == "Joint":
                if joint is None:
                    self.roots.append(node)
                if id(node) in self.parent:
                    self.twice.append((node, joint or self.node))
                    continue
                self.parent[id(node)] = joint
                self.joints.append(node)
                joint = owner = node
            elif id(node) in done:
                continue
            elif kind == "Segment" and joint is not None:
                self.segments.append((node, joint))
                owner = node
            elif kind == "Site":
                self.sites.append(node)
            elif kind == "Displacer" and owner is not None:
                self.displacers.append((node, owner))
            done.add(id(node))
            if node.type != "Shape":
                below = node.children("children") + node.children("displacers")
                stack.extend((n, joint, owner) for n in reversed(below))


def walk_all_groups(nodes: list[Node]) -> list[Node]:
    """Nodes and what hangs in `children` below them, each once."""
    found: list[Node] = []
    stack, seen = list(reversed(nodes)), set()
    while stack:
        node = stack.pop()
        if id(node) not in seen:
            seen.add(id(node))
            found.append(node)
            stack.extend(reversed(node.children("children")))
    return found


def examine(figure: Figure) -> None:
    """All rules about one humanoid."""
    from vitruvian.hanim import doctor_pose, doctor_skin

    for rule in (_names, _tree, _version, _lists, _shown, _prototypes):
        rule(figure)
    doctor_pose.examine(figure)
    doctor_skin.examine(figure)


def together(chart: Chart, figures: list[Figure]) -> None:
    """N08: several humanoids need names of their own."""
    counts = Counter(chart.text(f.node, "name") for f in figures)
    for f in figures:
        name = chart.text(f.node, "name")
        if not name:
            chart.add("N08", f.node, "the humanoid has no name", "give it one")
        elif counts[name] > 1:
            chart.add(
                "N08", f.node, f"{counts[name]} humanoids are called {name}: their DEF prefixes collide", "rename"
            )


def _names(figure: Figure) -> None:
    add, text = figure.chart.add, figure.chart.text
    things = [(j, "joint") for j in figure.joints] + [(s, "segment") for s, _ in figure.segments]
    things += [(s, "site") for s in figure.sites]
    strange = 0
    for node, kind in things:
        name = text(node, "name")
        if not name:
            derived = figure.name(node)
            fix = f"name='{derived}'" if derived and tables.canonical(derived, kind) else "give it its standard name"
            add("N01", node, f"{kind} without a name: nothing can address it", fix)
        elif kind == "joint" and tables.canonical(name) is None:
            strange += 1
            near = _near(name) if strange < _STRANGERS else ""
            if near:
                add("N02", node, f"joint name {name} is not standard though close to one", f"name='{near}'")
            else:
                add("N03", node, f"joint name {name} is not in the tables: taken for an addition")
    alike: dict[str, list[Node]] = defaultdict(list)
    for joint in figure.joints:
        alike[text(joint, "name")].append(joint)
    for name, joints in alike.items():
        if name and len(joints) > 1:
            message = f"{len(joints)} joints are called {name}: motion drives one of them"
            add("N04", joints[1], message, "rename the other")
    for segment, joint in figure.segments:
        own = tables.canonical(text(segment, "name"), "segment")
        joint_name = tables.canonical(figure.name(joint))
        if own and joint_name and tables.segments()[own] != joint_name:
            wanted = tables.joints()[joint_name].segment
            message = f"segment {own} hangs on joint {joint_name}, whose segment is {wanted}"
            add("N07", segment, message, f"name='{wanted}'")


@cache
def _near(name: str) -> str:
    """The one standard joint name (of either version) within two edits, "" when none or several."""
    plain = "_".join(name.split()).lower()
    words = [*tables.joints(), *tables.joints("1.x")]
    for word in words:
        if word.lower() == plain:
            return word
    if not 5 <= len(plain) <= 40 or any(c.isdigit() for c in plain):  # vt3 and vt4 are one edit apart and both right
        return ""
    found = {w: d for w in words if abs(len(w) - len(plain)) <= 2 and (d := _edits(plain, w)) <= 2}
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


def _tree(figure: Figure) -> None:
    add = figure.chart.add
    if not figure.joints:
        add(
            "T01", figure.node, "the skeleton is empty: there is nothing to animate", "put the root joint into skeleton"
        )
        return
    root = figure.name(figure.joints[0])
    whole = {"l_hip", "r_hip", "vl5", "l_shoulder", "skullbase"} & {tables.canonical(n) for n in figure.names.values()}
    if not tables.humanoid_root(root) and (whole or not tables.canonical(root)):  # a hand may start at its wrist
        fix = "make humanoid_root the root of the skeleton"
        add("T01", figure.joints[0], f"the skeleton starts at {root}, expected humanoid_root", fix)
    present = {tables.canonical(n) for n in figure.names.values()}
    for node, parent in figure.twice:
        listed = "" if node in figure.listed else "; it is missing from joints, where it belongs"
        message = f"joint {figure.name(node)} is reached twice (again under {figure.chart.reading.who(parent)}){listed}"
        add("T04", node, message + ": drawn and moved twice", "take the second one out of skeleton")
    for node in figure.joints:
        holder = figure.parent[id(node)]
        own = tables.canonical(figure.name(node))
        above = tables.canonical(figure.name(holder)) if holder is not None else None
        if own is None or above is None:
            continue
        if own == "vl5" and above == "sacroiliac" or own.endswith("sternoclavicular") and above == "vc7":
            add("T03", node, f"{own} hangs under {above}, as the schema's text has it; the standard says otherwise")
        elif above not in _ancestors(own):
            wanted = next((a for a in _ancestors(own) if a in present), "")
            fix = f"hang it under {wanted}" if wanted else ""
            add("T02", node, f"{own} hangs under {above}, which is not above it in the standard", fix)


def _ancestors(name: str) -> list[str]:
    found = []
    parent = tables.joints()[name].parent
    while parent is not None:
        found.append(parent)
        parent = tables.joints()[parent].parent
    return found


def _version(figure: Figure) -> None:
    chart, node = figure.chart, figure.node
    names = [n for j in figure.joints if (n := chart.text(j, "name"))]
    known = {tables.canonical(n) for n in names} - {None}
    version = chart.text(node, "version")
    native = node.type.startswith("HAnim")
    if native and version and version not in {"1.0", "1.1", "2.0"}:
        chart.add(
            "V01", node, f"version {version!r}: X3D knows 1.0 and 2.0", "version='2.0' or '1.0', as the names are"
        )
    default = "2.0" if chart.scene.version >= "4" else "1.0"
    modern = native and tables.family(version or default) == "2.0"
    old = [n for n in names if tables.canonical(n) not in (None, n) and not tables.humanoid_root(n)]
    expected = tables.ROOT if native else "HumanoidRoot"
    root = next((j for j in figure.joints if tables.humanoid_root(chart.text(j, "name"))), None)
    if root is not None and chart.text(root, "name") != expected:
        message = f"the root is called {chart.text(root, 'name')}, in this kind of file it is {expected}"
        chart.add("V05", root, message, f"name='{expected}'")
    if modern and old:
        some = ", ".join(old[:3]) + (", ..." if len(old) > 3 else "")
        message = f"{len(old)} joints of a 2.0 humanoid have older names ({some}): motion and tools miss them"
        chart.add("V04", node, message, "rename by the alias table: convert --hanim 2.0")
    claim = chart.numbers(node, "loa")
    whole = tables.ROOT in known and {"skullbase", "l_hip", "r_hip"} & known
    if not claim.size or not np.isfinite(claim[0]) or not 0 <= claim[0] <= 4:
        return
    loa = int(claim[0])
    missing = [n for n in tables.joints_at(loa) if n not in known]
    beyond = [n for n in known if n and tables.joints()[n].loa > loa]
    if whole and missing:
        best = tables.complete_loa(k for k in known if k)
        some = ", ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
        message = f"claims level of articulation {loa} but {len(missing)} of its joints are missing ({some})"
        chart.add("V02", node, message, f"loa='{best}'")
    if beyond:
        message = f"claims level {loa} but has {len(beyond)} joints of higher levels ({sorted(beyond)[0]}, ...)"
        chart.add("V03", node, message, "raise the claim when the set is complete, or loa='-1'")


def _lists(figure: Figure) -> None:
    add, node = figure.chart.add, figure.node
    if not figure.joints or not node.type.startswith("HAnim"):
        return
    counts = Counter(id(n) for n in figure.listed)
    absent = [j for j in figure.joints if id(j) not in counts]
    if not figure.listed:
        message = f"joints is empty: X_ITE keeps the rest pose of all {len(figure.joints)} joints"
        add("M01", node, message, "list every joint by USE with containerField='joints'")
    elif absent:
        some = ", ".join(figure.name(j) for j in absent[:3]) + (", ..." if len(absent) > 3 else "")
        message = f"{len(absent)} joints of the skeleton are not in joints ({some}): X_ITE does not move their skin"
        add("M01", node, message, "list every joint by USE with containerField='joints'")
    again = [n for n in figure.listed if counts[id(n)] > 1]
    if again:
        number = len({id(n) for n in again})
        message = f"{number} joints are listed twice in joints ({figure.name(again[0])}, ...): their weights act twice"
        add("M02", node, message, "list each joint once")
    strangers = [n for n in figure.listed if id(n) not in figure.parent]
    if strangers:
        message = f"{len(strangers)} entries of joints are not in the skeleton ({figure.name(strangers[0])})"
        add("M03", strangers[0], message + ": the copy turns, the skeleton does not", "replace the copy by a USE")


def _prototypes(figure: Figure) -> None:
    if not figure.node.type.startswith("HAnim") and figure.skin:
        message = "a PROTO humanoid with a skin: plain VRML browsers do not move it"
        figure.chart.add("M20", figure.node, message, "write it as X3D")


def _shown(figure: Figure) -> None:
    """M19: what hides the humanoid; M21: geometry that no joint carries."""
    chart, add = figure.chart, figure.chart.add
    for node in [*chart.above(figure.node), figure.node]:
        if chart.flag(node, "visible") is False:
            add("M19", node, "visible is FALSE: nothing below it is drawn", "visible='true'")
        if node.type == "Switch" and not (chart.numbers(node, "whichChoice") >= 0).any():
            add("M19", node, "a Switch above the humanoid has whichChoice -1: it is hidden", "whichChoice='0'")
        if node.type == "Transform" and node is not figure.node and (chart.numbers(node, "scale") == 0).any():
            add("M19", node, "a Transform above the humanoid has scale 0: it is hidden", "give a positive scale")
    for owner, kind in [(figure.node, "humanoid"), *((j, "joint") for j in figure.joints)]:
        loose = [n for n in walk_groups(chart.reading, owner.children("children")) if n.type == "Shape"]
        if loose:
            message = f"{len(loose)} shapes stand in {kind} {figure.name(owner)} outside any Segment or skin"
            add("M21", loose[0], message, "put them into the Segment that they belong to")
