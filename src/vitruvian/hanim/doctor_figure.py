"""The doctor's rules about one humanoid: its tree, version, lists of joints, and what hides it."""

from __future__ import annotations

from collections import Counter

import numpy as np

from vitruvian.hanim import tables
from vitruvian.hanim.animation import event
from vitruvian.hanim.doctor import Chart
from vitruvian.hanim.doctor_words import several, some
from vitruvian.hanim.graph import Node, walk_all
from vitruvian.hanim.view import name_of, walk_groups


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
        self.given = {chart.text(j, "name") for j in self.joints}
        self.names = {id(j): self.name(j) for j in self.joints}

    def name(self, node: Node) -> str:
        """The node's own name, or the one that its DEF gives it unless another joint has that one by right."""
        own = self.chart.text(node, "name")
        if own:
            return own
        derived = name_of(self.chart.reading, node, self.prefixes)
        return node.name if derived in self.given else derived

    @property
    def baked(self) -> bool:
        """Whether an interpolator moves the points of the skin, which then needs no weights."""
        defs, coord = self.chart.defs(), self.skin_coord
        driven = [r for r in self.chart.scene.routes() if coord is not None and coord.name and r.to_node == coord.name]
        return any(
            event(r.to_field) == "point" and r.from_node in defs and defs[r.from_node].type == "CoordinateInterpolator"
            for r in driven
        )

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
    from vitruvian.hanim import doctor_names, doctor_pose, doctor_skin, doctor_values

    doctor_names.examine(figure)
    for rule in (_tree, _gaps, _version, _lists, _shown, _prototypes):
        rule(figure)
    doctor_pose.examine(figure)
    doctor_values.limits(figure)
    doctor_values.masses(figure)
    doctor_skin.examine(figure)


def _tree(figure: Figure) -> None:
    add = figure.chart.add
    if not figure.joints:
        add(
            "T01", figure.node, "the skeleton is empty: there is nothing to animate", "put the root joint into skeleton"
        )
        return
    root = figure.name(figure.joints[0])
    trunk = {"l_hip", "r_hip", "vl5", "l_shoulder", "skullbase"} & {tables.canonical(n) for n in figure.names.values()}
    if not tables.humanoid_root(root) and (trunk or not tables.canonical(root)):  # a hand may start at its wrist
        fix = "make humanoid_root the root of the skeleton"
        add("T01", figure.joints[0], f"the skeleton starts at {root}, expected humanoid_root", fix)
    present = {tables.canonical(n) for n in figure.names.values()}
    listed_ids = {id(n) for n in figure.listed}
    again: dict[int, list[tuple[Node, Node]]] = {}
    for node, parent in figure.twice:
        again.setdefault(id(node), []).append((node, parent))
    for (node, parent), *more in again.values():
        listed = "" if id(node) in listed_ids else "; it is missing from joints, where it belongs"
        times = "twice" if not more else f"{len(more) + 2} times"
        message = (
            f"joint {figure.name(node)} is reached {times} (again under {figure.chart.reading.who(parent)}){listed}"
        )
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


def _gaps(figure: Figure) -> None:
    """T05: standard joints of a child's own level that are missing between it and its parent."""
    present = {tables.canonical(n) for n in figure.names.values()}
    claim = figure.chart.numbers(figure.node, "loa")
    claimed = float(claim[0]) if claim.size and np.isfinite(claim[0]) and whole(present) else -1.0  # V02 counts those
    found: dict[str, tuple[Node, str, str]] = {}
    for node in figure.joints:
        holder = figure.parent[id(node)]
        own = tables.canonical(figure.name(node))
        above = tables.canonical(figure.name(holder)) if holder is not None else None
        if own is None or above is None or above not in _ancestors(own):
            continue
        for name in _ancestors(own)[: _ancestors(own).index(above)]:
            if above == tables.ROOT and not {"skullbase", "l_hip", "r_hip"} <= present:
                continue  # a hand or a foot by itself starts where it starts
            if claimed < tables.joints()[name].loa <= tables.joints()[own].loa and name not in present:
                found.setdefault(name, (node, own, above))
    if found:
        (first, (node, own, above)), *_ = found.items()
        what = several(len(found), "standard joint is", "standard joints are")
        message = (
            f"{what} missing between joints that are there ({some(list(found))}; {first} between {above} and {own})"
        )
        figure.chart.add("T05", node, message, f"add {first}; its motion goes to {above} meanwhile")


def whole(names: set[str | None]) -> bool:
    """Whether the joints (2.0 names) are those of a whole body rather than of a hand."""
    return tables.ROOT in names and bool({"skullbase", "l_hip", "r_hip"} & names)


def proper_version(figure: Figure) -> str:
    """The version that fits the names of the joints and the kind of file: 2.0, 1.0 or 200x."""
    if not figure.node.type.startswith("HAnim"):
        return "200x"
    names = {n for n in figure.names.values() if tables.canonical(n)} - {tables.ROOT, "HumanoidRoot"}
    if any(tables.canonical(n) == n and n not in tables.joints("1.x") for n in names):
        return "2.0"
    if any(tables.canonical(n) != n for n in names):
        return "1.0"
    return "2.0" if figure.chart.scene.version >= "4" else "1.0"


def wrong_version(figure: Figure) -> bool:
    """V01: whether the version is given and is none that this kind of file has."""
    if "version" not in figure.node.fields:
        return False
    native = figure.node.type.startswith("HAnim")
    return figure.chart.text(figure.node, "version") not in (
        {"1.0", "1.1", "2.0"} if native else {"1.0", "1.1", "200x"}
    )


def modern(figure: Figure) -> bool:
    """Whether the humanoid says, or its file implies, that its names are those of 2.0."""
    default = "2.0" if figure.chart.scene.version >= "4" else "1.0"
    version = figure.chart.text(figure.node, "version") or default
    return figure.node.type.startswith("HAnim") and tables.family(version) == "2.0"


def expected_root(figure: Figure) -> str:
    """V05: humanoid_root in X3D, HumanoidRoot in VRML97."""
    return tables.ROOT if figure.node.type.startswith("HAnim") else "HumanoidRoot"


def _version(figure: Figure) -> None:
    chart, node = figure.chart, figure.node
    names = [n for j in figure.joints if (n := chart.text(j, "name"))]
    known = {k for name in figure.names.values() if (k := tables.canonical(name))}
    if wrong_version(figure):
        knows = "X3D knows 1.0 and 2.0" if node.type.startswith("HAnim") else "VRML97 knows 1.1 and 200x"
        message = f"version {chart.text(node, 'version')!r}: {knows}"
        chart.add("V01", node, message, f"version='{proper_version(figure)}'")
    old = [n for n in names if tables.canonical(n) not in (None, n) and not tables.humanoid_root(n)]
    expected = expected_root(figure)
    root = next((j for j in figure.joints if tables.humanoid_root(chart.text(j, "name"))), None)
    if root is not None and chart.text(root, "name") != expected:
        message = f"the root is called {chart.text(root, 'name')}, in this kind of file it is {expected}"
        chart.add("V05", root, message, f"name='{expected}'")
    if modern(figure) and old:
        what = several(len(old), "joint", "joints")
        message = f"{what} of a 2.0 humanoid with older names ({some(old)}): motion and tools miss them"
        chart.add("V04", node, message, "rename by the alias table: convert --hanim 2.0")
    parts = [chart.text(s, "name") for s, _ in figure.segments]
    parts = [n for n in parts if tables.canonical(n, "segment") not in (None, n)]
    if modern(figure) and parts:
        what = several(len(parts), "segment", "segments")
        chart.add(
            "V04", node, f"{what} of a 2.0 humanoid with older names ({some(parts)})", "rename by the alias table"
        )
    claim = chart.numbers(node, "loa")
    if not claim.size or not np.isfinite(claim[0]) or not 0 <= claim[0] <= 4:
        return
    loa, best = int(claim[0]), tables.complete_loa(known)
    missing = [n for n in tables.joints_at(loa) if n not in known]
    beyond = sorted(n for n in known if tables.joints()[n].loa > loa)
    if whole(set(known)) and missing:
        message = f"claims level of articulation {loa} but {len(missing)} of its joints are missing ({some(missing)})"
        chart.add("V02", node, message, f"loa='{best}'")
    if beyond:
        message = (
            f"claims level {loa} but has {several(len(beyond), 'joint', 'joints')} of higher levels ({beyond[0]}, ...)"
        )
        fix = f"loa='{best}'" if best > loa else "legal: no higher level is complete"
        chart.add("V03", node, message, fix)


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
        names = some([figure.name(j) for j in absent])
        what = several(len(absent), "joint", "joints")
        message = f"{what} of the skeleton missing in joints ({names}): X_ITE does not move their skin"
        add("M01", node, message, "list every joint by USE with containerField='joints'")
    again = [n for n in figure.listed if counts[id(n)] > 1]
    if again:
        number = len({id(n) for n in again})
        what = several(number, "joint is", "joints are")
        message = f"{what} listed twice in joints ({figure.name(again[0])}, ...): their weights act twice"
        add("M02", node, message, "list each joint once")
    strangers = [n for n in figure.listed if id(n) not in figure.parent]
    if strangers:
        what = several(len(strangers), "entry of joints is", "entries of joints are")
        message = f"{what} not in the skeleton ({figure.name(strangers[0])})"
        add("M03", strangers[0], message + ": the copy turns, the skeleton does not", "replace the copy by a USE")


def _prototypes(figure: Figure) -> None:
    if not figure.node.type.startswith("HAnim") and figure.skin and not figure.baked:
        message = "a PROTO humanoid with a skin: plain VRML browsers do not move it"
        figure.chart.add("M20", figure.node, message, "write it as X3D, or bake its motion into the skin's points")


def _shown(figure: Figure) -> None:
    """M19: what hides the humanoid; M21: geometry that no joint carries."""
    chart, add = figure.chart, figure.chart.add
    below = figure.node
    for node in [figure.node, *chart.above(figure.node)]:
        if chart.flag(node, "visible") is False:
            add("M19", node, "visible is FALSE: nothing below it is drawn", "visible='true'")
        if node.type in {"Switch", "LOD"} and node is not figure.node:
            levels = node.children("children") or node.children("choice") or node.children("level")
            place = next((k for k, n in enumerate(levels) if n is below), 0)
            choice = chart.numbers(node, "whichChoice")
            which = int(choice[0]) if choice.size and abs(choice[0]) < 2**31 else -1
            if node.type == "Switch" and which != place:
                message = f"a Switch above the humanoid has whichChoice {which}: it is hidden"
                add("M19", node, message, f"whichChoice='{place}'")
            elif node.type == "LOD" and place:
                add("M19", node, f"a LOD above the humanoid shows it only at level {place}: hidden when near", "")
        if node.type == "Transform" and (chart.numbers(node, "scale") == 0).any():
            add("M19", node, "a Transform above the humanoid has scale 0: it is hidden", "give a positive scale")
        below = node
    for owner, kind, _, shapes in loose_shapes(figure):
        what = several(len(shapes), "shape stands", "shapes stand")
        message = f"{what} in {kind} {figure.name(owner)} outside any Segment or skin"
        add("M21", shapes[0], message, "put them into the Segment that they belong to")


def loose_shapes(figure: Figure) -> list[tuple[Node, str, list[Node], list[Node]]]:
    """M21: owner, its kind, its children that hold shapes outside any Segment or skin, and those shapes."""
    found = []
    for owner, kind in [(figure.node, "humanoid"), *((j, "joint") for j in figure.joints)]:
        holders, shapes = [], []
        for child in owner.children("children"):
            inside = [n for n in walk_groups(figure.chart.reading, [child]) if n.type == "Shape"]
            shapes += inside
            holders += [child] if inside else []
        if shapes:
            found.append((owner, kind, holders, shapes))
    return found


def unattached(chart: Chart, figures: list[Figure]) -> None:
    """D06: sites that no joint, segment or humanoid carries."""
    held = {id(s) for f in figures for s in f.sites}
    held |= {id(n) for f in figures for n in walk_all(f.node.children("viewpoints"))}
    lost = [n for n in chart.nodes if chart.reading.kind(n) == "Site" and id(n) not in held]
    if lost:
        names = some([chart.text(n, "name") or n.name or "(no name)" for n in lost])
        what = several(len(lost), "site hangs", "sites hang")
        chart.add(
            "D06", lost[0], f"{what} under no joint or segment of a skeleton ({names})", "put it under its segment"
        )
