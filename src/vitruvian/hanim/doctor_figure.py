"""The doctor's rules about one humanoid: names, tree, versions, lists, skin, displacers."""

from __future__ import annotations

from collections import Counter, defaultdict
from functools import cache
from itertools import pairwise

import numpy as np

from vitruvian.hanim import surface, tables
from vitruvian.hanim.doctor import Chart, Floats
from vitruvian.hanim.graph import Node
from vitruvian.hanim.view import name_of, walk_groups

_WEIGHT_TOLERANCE = 1e-3
_STRANGERS = 100  # names that are not in the tables, for which a near one is looked up
_MIRROR_TOLERANCE = 0.02 / 1.75  # of the figure's stature


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
    for rule in (_names, _tree, _version, _lists, _places, _weights, _skin, _displacers, _limits, _prototypes):
        rule(figure)


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
        parent = figure.parent[id(node)]
        own = tables.canonical(figure.name(node))
        above = tables.canonical(figure.name(parent)) if parent is not None else None
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
    old = [n for n in names if tables.canonical(n) not in (None, n)]
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


def _places(figure: Figure) -> None:
    chart, add = figure.chart, figure.chart.add
    moved = []
    for joint in figure.joints:
        rotation, translation = chart.numbers(joint, "rotation"), chart.numbers(joint, "translation")
        scale = chart.numbers(joint, "scale")
        if rotation[3:4].any() or translation.any() or (scale.size == 3 and (scale != 1).any()):
            moved.append(joint)
    if moved:
        some = ", ".join(figure.name(j) for j in moved[:3]) + (", ..." if len(moved) > 3 else "")
        message = f"{len(moved)} joints are not at rest in the file ({some}): motion assumes that they are"
        add("P01", moved[0], message, "bake the pose into centres and skin")
    centers = {figure.name(j): chart.numbers(j, "center") for j in figure.joints}
    centers = {n: c for n, c in centers.items() if c.size in (0, 3) and np.isfinite(c).all()}
    given = np.array([c for c in centers.values() if c.size == 3 and c.any()]).reshape(-1, 3)
    if len(given) < 2:
        return
    lost = [n for n, c in centers.items() if not c.any() and not tables.humanoid_root(n)]
    if lost and len(lost) < len(centers):
        some = ", ".join(lost[:3]) + (", ..." if len(lost) > 3 else "")
        message = f"{len(lost)} joints have no center ({some}): they turn about the floor"
        add("P02", next(j for j in figure.joints if figure.name(j) == lost[0]), message, "give their centres")
    stature = float(np.ptp(given[:, 1]))
    crooked = []
    for name, c in centers.items():
        mate = centers.get("r_" + name[2:]) if name.startswith("l_") else None
        if mate is None or c.size != 3 or mate.size != 3 or not c.any() or not mate.any():
            continue
        if float(np.abs(c - mate * [-1, 1, 1]).max()) > _MIRROR_TOLERANCE * max(stature, 1e-9):
            crooked.append(name)
    if crooked:
        some = ", ".join(crooked[:3]) + (", ..." if len(crooked) > 3 else "")
        message = f"{len(crooked)} pairs of joints are not mirror images ({some}): lopsided motion"
        add("P03", figure.node, message, "mirror the left centres")


def _weights(figure: Figure) -> None:
    """S01 to S07 and M06."""
    chart, add = figure.chart, figure.chart.add
    count = len(figure.points)
    total, influences = np.zeros(count), np.zeros(count, np.int64)
    any_weight = mentioned = False
    for joint in figure.joints:
        index, weight = chart.indices(joint, "skinCoordIndex"), chart.numbers(joint, "skinCoordWeight")
        name = figure.name(joint)
        if len(index) != len(weight):
            message = f"joint {name}: {len(index)} skinCoordIndex but {len(weight)} skinCoordWeight: browsers differ"
            fix = "cut the weights" if len(weight) > len(index) else "give the missing weights"
            add("S01", joint, message, fix)
            n = min(len(index), len(weight))
            if 0 < len(weight) < len(index):
                weight = np.concatenate([weight, np.full(len(index) - len(weight), weight[-1])])
            else:
                index, weight = index[:n], weight[:n]
        mentioned |= bool(len(index))
        outside = (index < 0) | (index >= count)
        if outside.any() and figure.skin_coord is not None:
            first = int(np.argmax(outside))
            message = f"joint {name}: {int(outside.sum())} skinCoordIndex outside 0..{count - 1} (entry {first}"
            add("S02", joint, f"{message} is {index[first]})", "drop those pairs")
        good = np.isfinite(weight)
        bad = good & ((weight < 0) | (weight > 1 + _WEIGHT_TOLERANCE))
        if bad.any():
            first = int(np.argmax(bad))
            message = f"joint {name}: weight {weight[first]:g} at entry {first} is outside 0..1: the skin explodes"
            add("S05", joint, message, "clamp it")
        inside = ~outside & good
        index, weight = index[inside], weight[inside]
        if len(np.unique(index)) < len(index):
            message = f"joint {name} names {len(index) - len(np.unique(index))} vertices twice: their weights add up"
            add("S06", joint, message, "sum them into one entry")
        any_weight |= bool((weight != 0).any())
        np.add.at(total, index, weight)
        influences[np.unique(index[weight != 0])] += 1
    if figure.skin_coord is None:
        return
    if not any_weight and figure.joints:
        rule = "S05" if mentioned else "M06"
        message = (
            "all weights are zero: the skin does not follow" if mentioned else "no joint has weights: the skin stays"
        )
        add(rule, figure.node, message, "transfer weights from another body")
        return
    used = _used_points(figure)
    without = np.flatnonzero(influences == 0)
    if without.size:
        drawn = int(used[without].sum())
        message = f"{without.size} of {count} skin points have no weight (first {without[0]}): they stay behind"
        message += f"; faces use {drawn} of them" if drawn else "; no face uses them"
        add("S04", figure.node, message, "give them the weights of their nearest neighbour")
    off = np.flatnonzero((influences > 0) & (np.abs(total - 1) > _WEIGHT_TOLERANCE))
    if off.size:
        worst = off[int(np.argmax(np.abs(total[off] - 1)))]
        message = f"weights of {off.size} points do not sum to 1 (point {worst}: {total[worst]:.4g})"
        add("S03", figure.node, message + ": below 1 sticks to rest, above 1 overshoots", "normalise")
    many = int((influences > 4).sum())
    if many:
        add("S07", figure.node, f"{many} points have more than 4 influences: glTF and VRM export prunes them")


def _used_points(figure: Figure) -> np.ndarray:
    """(v,) whether a face of the skin uses the point; all when no face can be read."""
    used = np.zeros(len(figure.points), bool)
    for shape in figure.skin:
        for geometry in shape.children("geometry"):
            index = np.concatenate([figure.chart.indices(geometry, f) for f in ("coordIndex", "index")])
            used[index[(index >= 0) & (index < len(used))]] = True
    return used if used.any() else ~used


def _skin(figure: Figure) -> None:
    """M04, M05, S08, S09."""
    chart, add, node = figure.chart, figure.chart.add, figure.node
    weighted = any(chart.numbers(j, "skinCoordWeight").any() for j in figure.joints)
    geometries = [g for s in figure.skin for g in s.children("geometry")]
    if weighted and not geometries:
        fix = "put the Shape into skin, with skinCoord USEd in its geometry"
        add("M05", node, "joints have weights but skin is empty: nothing of it is drawn", fix)
    if figure.skin_coord is None and weighted and geometries:
        add("M04", node, "skinCoord is missing: the mesh never deforms", "USE the geometry's Coordinate as skinCoord")
    for geometry in geometries:
        coord = surface.coordinate(geometry)
        if coord is None:
            continue
        points = _rows(chart.numbers(coord, "point"))
        if figure.skin_coord is not None and coord is not figure.skin_coord and weighted:
            same = points.shape == figure.points.shape and np.allclose(points, figure.points, equal_nan=True)
            what = "is a copy of skinCoord" if same else "is another node than skinCoord"
            fix = "USE one Coordinate in both places" if same else "index the skinCoord"
            add("M04", geometry, f"the geometry's Coordinate {what}: the mesh never deforms", fix)
        for field, low in (("coordIndex", -1), ("index", 0)):
            index = chart.indices(geometry, field)
            bad = (index < low) | (index >= len(points))
            if bad.any():
                first = int(np.argmax(bad))
                message = (
                    f"{field}: {int(bad.sum())} entries outside 0..{len(points) - 1} (entry {first}: {index[first]})"
                )
                add("S09", geometry, message, "drop those faces")
            elif field == "coordIndex" and len(index):
                thin = sum(b - a - 1 < 3 for a, b in pairwise([-1, *np.flatnonzero(index == -1)]))
                if thin:
                    add("S09", geometry, f"{thin} faces with fewer than three corners", "drop those faces")
    normals = node.children("skinNormal")
    if normals and figure.skin_coord is not None:
        count = len(_rows(chart.numbers(normals[0], "vector")))
        if count != len(figure.points):
            message = f"skinNormal has {count} vectors for {len(figure.points)} points"
            add("S08", node, message, "leave skinNormal out or recompute it")
    for segment, _ in figure.segments:
        _segment_faces(figure, segment)


def _segment_faces(figure: Figure, segment: Node) -> None:
    chart = figure.chart
    for child in walk_groups(chart.reading, segment.children("children")):
        for geometry in child.children("geometry"):
            coord = surface.coordinate(geometry)
            if coord is None:
                continue
            count = len(_rows(chart.numbers(coord, "point")))
            index = chart.indices(geometry, "coordIndex")
            bad = (index < -1) | (index >= count)
            if bad.any():
                first = int(np.argmax(bad))
                message = f"coordIndex: {int(bad.sum())} entries outside 0..{count - 1} (entry {first}: {index[first]})"
                chart.add("S09", geometry, message, "drop those faces")


def _rows(array: Floats) -> Floats:
    return array[: len(array) // 3 * 3].reshape(-1, 3)


def _displacers(figure: Figure) -> None:
    chart, add = figure.chart, figure.chart.add
    for node, owner in figure.displacers:
        index, moves = chart.indices(node, "coordIndex"), chart.numbers(node, "displacements")
        on_joint = chart.reading.kind(owner) == "Joint"
        if on_joint:
            limit = len(figure.points)
            if figure.skin_coord is None:
                add("D02", node, "displacer of a joint without skinCoord has no effect", "give skinCoord")
        else:
            limit = max((len(_rows(chart.numbers(c, "point"))) for c in _coords(chart, owner)), default=0)
        bad = (index < 0) | (index >= limit)
        if bad.any() and (limit or not on_joint):
            first = int(np.argmax(bad))
            message = f"coordIndex: {int(bad.sum())} entries outside 0..{limit - 1} (entry {first}: {index[first]})"
            add("D01", node, message, "drop those entries")
        if len(moves) % 3 or (len(moves) and len(moves) // 3 != len(index)):
            message = f"{len(index)} coordIndex but {len(moves) / 3:g} displacements"
            add("D01", node, message, "cut both to the shorter")


def _coords(chart: Chart, segment: Node) -> list[Node]:
    found = list(segment.children("coord"))
    for child in walk_groups(chart.reading, segment.children("children")):
        found += [c for g in child.children("geometry") if (c := surface.coordinate(g)) is not None]
    return found


def _limits(figure: Figure) -> None:
    chart, add = figure.chart, figure.chart.add
    for joint in figure.joints:
        low, high = chart.numbers(joint, "llimit"), chart.numbers(joint, "ulimit")
        if len(low) not in (0, 3) or len(high) not in (0, 3):
            add(
                "D05",
                joint,
                f"llimit and ulimit have {len(low)} and {len(high)} numbers, expected 0 or 3",
                "give three",
            )
        elif len(low) == len(high) and (low > high).any():
            add("D05", joint, "llimit is above ulimit", "swap them")
        stiffness = chart.numbers(joint, "stiffness")
        if ((stiffness < 0) | (stiffness > 1)).any():
            add("D05", joint, "stiffness is outside 0..1", "clamp it")


def _prototypes(figure: Figure) -> None:
    if not figure.node.type.startswith("HAnim") and figure.skin:
        message = "a PROTO humanoid with a skin: plain VRML browsers do not move it"
        figure.chart.add("M20", figure.node, message, "write it as X3D")
