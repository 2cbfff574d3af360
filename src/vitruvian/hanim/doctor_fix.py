"""The doctor's repairs: what has one right answer is put right in the graph, everything else stays as it is."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np

from vitruvian.hanim import surface, tables
from vitruvian.hanim.doctor import Chart
from vitruvian.hanim.doctor_figure import Figure
from vitruvian.hanim.fields import container_of
from vitruvian.hanim.graph import Node, Scene, Use
from vitruvian.hanim.view import humanoids


def mend(scene: Scene, path: object = None) -> list[str]:
    """Repair a scene in place; answers one line per repair, [] when there was nothing to do (so: idempotent).

    Numbers that are not finite, indices outside their array and counts that do not fit are dropped; lists of joints,
    containerFields, skinCoord, names, versions, levels, weights and limits are put right where only one answer fits.
    """
    done: list[str] = []
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        humanoids(scene, path, repair=True)
    done += [str(w.message) for w in said if "repaired:" in str(w.message)]
    chart = Chart(scene, path)
    taken = set(scene.defs())
    for node in [n for n in scene.walk() if chart.reading.kind(n) == "Humanoid"]:
        for step in (_places, _skeleton, _joints, _skin_coord, _names, _version, _weights, _limits, _motions):
            chart = Chart(scene, path)  # each step sees what the one before it left
            where = f"humanoid {chart.text(node, 'name') or node.name}"
            done += [f"{where}: {what}" for what in step(Figure(chart, node), taken)]
    return done


def _entries(node: Node, field: str) -> list[Node | Use]:
    value = node.fields.get(field)
    return [v for v in (value if isinstance(value, list) else [value]) if isinstance(v, Node | Use)]


def _free(taken: set[str], wanted: str) -> str:
    name, n = wanted, 2
    while name in taken:
        name, n = f"{wanted}_{n}", n + 1
    taken.add(name)
    return name


def _places(figure: Figure, taken: set[str]) -> Iterator[str]:
    """F06: nodes into the fields where they belong, containerField written out."""
    node, kind = figure.node, figure.chart.reading.kind
    if not node.type.startswith("HAnim"):
        return
    stray = {"HAnimSegment": "segments", "HAnimMotion": "motions", "Coordinate": "skinCoord", "Normal": "skinNormal"}
    value = node.fields.get("children")
    if isinstance(value, list):
        for entry in list(value):
            target = entry.node if isinstance(entry, Use) else entry
            if not isinstance(target, Node):
                continue
            field = stray.get(target.type, "")
            if kind(target) in {"Joint", "Site"}:
                field = {"Joint": "joints", "Site": "sites"}[kind(target)] if isinstance(entry, Use) else "skeleton"
            if field:
                value.remove(entry)
                node.fields[field] = [*_entries(node, field), entry]
                entry.container = field
                node.order = []
                yield f"{target.type} {entry.name} moved from children to {field} (F06)"
        if not value:
            del node.fields["children"]
    for field, entry in node.entries() if figure.chart.scene.encoding == "x3d" else ():  # only XML has the word
        target = entry.node if isinstance(entry, Use) else entry
        if target is not None and not entry.container and container_of(target.type) != field and entry.line:
            entry.container = field
            yield f"{target.type} {entry.name} given containerField='{field}' (F06)"
    for owner in (*figure.joints, *(s for s, _ in figure.segments)):
        loose = [n for n in _entries(owner, "children") if isinstance(n, Node) and kind(n) == "Displacer"]
        for entry in loose:
            owner.fields["children"] = [n for n in _entries(owner, "children") if n is not entry]
            owner.fields["displacers"] = [*_entries(owner, "displacers"), entry]
            entry.container, owner.order = "displacers", []
            yield f"displacer {entry.name} moved to displacers (F06)"


def _skeleton(figure: Figure, taken: set[str]) -> Iterator[str]:
    """T04: each joint once in the skeleton."""
    for joint, parent in figure.twice:
        field = "children"
        if parent is figure.node:
            field = "skeleton" if figure.node.children("skeleton") else "humanoidBody"
        entries = _entries(parent, field)
        at = [k for k, e in enumerate(entries) if (e.node if isinstance(e, Use) else e) is joint]
        uses = [k for k in at if isinstance(entries[k], Use)]
        if uses:
            entries.pop(uses[-1])
            parent.fields[field] = entries
            parent.order = []
            yield f"second {figure.name(joint)} taken out of {field} (T04)"


def _joints(figure: Figure, taken: set[str]) -> Iterator[str]:
    """M01, M02, M03: `joints` lists every joint of the skeleton once, by USE."""
    node = figure.node
    if not figure.joints or not node.type.startswith("HAnim"):
        return
    kind = figure.chart.reading.kind
    listed = _entries(node, "joints")
    targets = [e.node if isinstance(e, Use) else e for e in listed]
    joints = [(e, t) for e, t in zip(listed, targets) if t is None or kind(t) == "Joint"]
    right = sorted(id(j) for j in figure.joints)
    if right == sorted(id(t) for _, t in joints) and all(isinstance(e, Use) for e, _ in joints):
        return
    kept: list[Node | Use] = [e for e, t in zip(listed, targets) if t is not None and kind(t) != "Joint"]
    for joint in figure.joints:
        joint.name = joint.name or _free(taken, f"hanim_{figure.name(joint)}")
        kept.append(Use(joint.name, joint, container="joints", type=joint.type))
    # the list must stand behind the skeleton, so that no USE comes before its DEF
    node.fields.pop("joints", None)
    node.fields["joints"] = kept
    node.order = []
    yield f"joints lists the {len(figure.joints)} joints of the skeleton, each once (M01, M02, M03)"


def _skin_coord(figure: Figure, taken: set[str]) -> Iterator[str]:
    """M04: the skin's geometry and skinCoord share one Coordinate, when the points are the same."""
    node = figure.node
    coords = [c for s in figure.skin for g in s.children("geometry") if (c := surface.coordinate(g)) is not None]
    weighted = any(figure.chart.numbers(j, "skinCoordWeight").any() for j in figure.joints)
    if not coords or not weighted or figure.skin_coord in coords:
        return
    points = figure.chart.numbers(coords[0], "point")
    if figure.skin_coord is not None and not np.array_equal(points.reshape(-1), figure.points.reshape(-1)):
        return
    coords[0].name = coords[0].name or _free(taken, "hanim_skin_coords")
    node.fields.pop("skinCoord", None)
    node.fields["skinCoord"] = [Use(coords[0].name, coords[0], container="skinCoord", type=coords[0].type)]
    node.order = []
    yield f"skinCoord is a USE of {coords[0].name} (M04)"


def _names(figure: Figure, taken: set[str]) -> Iterator[str]:
    """N01, V04, V05, N08: standard names where they follow from DEF or alias."""
    chart, node = figure.chart, figure.node
    default = "2.0" if chart.scene.version >= "4" else "1.0"
    modern = node.type.startswith("HAnim") and tables.family(chart.text(node, "version") or default) == "2.0"
    present = {chart.text(j, "name") for j in figure.joints}
    things = [(j, "joint") for j in figure.joints] + [(s, "segment") for s, _ in figure.segments]
    for thing, kind in [*things, *((s, "site") for s in figure.sites)]:
        name = chart.text(thing, "name")
        if not name:
            derived = figure.name(thing)
            if derived and tables.canonical(derived, kind) and derived not in present:
                thing.fields["name"] = derived
                yield f"{kind} {thing.name} is named {derived} (N01)"
        elif modern and kind != "site":
            new = tables.canonical(name, kind)
            if new is not None and new != name and new not in present:
                thing.fields["name"] = new
                yield f"{kind} {name} is named {new} (V04)"
    if not chart.text(node, "name"):
        node.fields["name"] = node.name.removeprefix("hanim_") or "humanoid"
        yield f"is named {node.fields['name']} (N08)"


def _version(figure: Figure, taken: set[str]) -> Iterator[str]:
    """V01, V02, V03: version and level of articulation say what is there."""
    chart, node = figure.chart, figure.node
    known = {n for name in figure.names.values() if (n := tables.canonical(name))}
    version = chart.text(node, "version")
    if node.type.startswith("HAnim") and version and version not in {"1.0", "1.1", "2.0"}:
        node.fields["version"] = "2.0" if chart.scene.version >= "4" else "1.0"
        yield f"version {version} is {node.fields['version']} (V01)"
    claim = chart.numbers(node, "loa")
    if not claim.size or claim[0] < 0 or not {tables.ROOT, "skullbase"} <= known:
        return
    best = tables.complete_loa(known)
    if best != claim[0]:
        node.fields["loa"] = best
        yield f"loa {claim[0]:g} is {best} (V02, V03)"


def _weights(figure: Figure, taken: set[str]) -> Iterator[str]:
    """S01, S06, S03: as many weights as indices, each vertex once per joint, sums of 1."""
    chart = figure.chart
    if figure.skin_coord is None or not len(figure.points):
        return
    pairs: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    changed: set[int] = set()
    total = np.zeros(len(figure.points))
    for joint in figure.joints:
        index, weight = chart.indices(joint, "skinCoordIndex"), chart.numbers(joint, "skinCoordWeight")
        if len(index) != len(weight):
            if 0 < len(weight) < len(index):
                weight = np.concatenate([weight, np.full(len(index) - len(weight), weight[-1])])
            n = min(len(index), len(weight))
            index, weight = index[:n], weight[:n]
            changed.add(id(joint))
            yield f"joint {figure.name(joint)} has {n} weights for {n} indices (S01)"
        if len(np.unique(index)) < len(index):
            index, where = np.unique(index, return_inverse=True)
            weight = np.bincount(where, weight, minlength=len(index)).astype(np.float64)
            changed.add(id(joint))
            yield f"joint {figure.name(joint)} names each vertex once (S06)"
        pairs[id(joint)] = (index, weight)
        np.add.at(total, index, weight)
    off = (total > 0) & (np.abs(total - 1) > 1e-3)
    if off.any():
        yield f"weights of {int(off.sum())} vertices sum to 1 (S03)"
    for joint in figure.joints:
        index, weight = pairs[id(joint)]
        if off[index].any():
            weight = np.where(off[index], weight / np.where(total[index] > 0, total[index], 1), weight)
            changed.add(id(joint))
        if id(joint) in changed:
            joint.fields["skinCoordIndex"] = index.astype(np.int32)
            joint.fields["skinCoordWeight"] = weight


def _limits(figure: Figure, taken: set[str]) -> Iterator[str]:
    """D05: lower limits below upper ones, stiffness in 0..1."""
    chart = figure.chart
    for joint in figure.joints:
        low, high = chart.numbers(joint, "llimit"), chart.numbers(joint, "ulimit")
        if len(low) == len(high) == 3 and (low > high).any():
            joint.fields["llimit"], joint.fields["ulimit"] = np.minimum(low, high), np.maximum(low, high)
            yield f"limits of joint {figure.name(joint)} swapped (D05)"
        stiffness = chart.numbers(joint, "stiffness")
        if ((stiffness < 0) | (stiffness > 1)).any():
            joint.fields["stiffness"] = np.clip(stiffness, 0, 1)
            yield f"stiffness of joint {figure.name(joint)} clamped to 0..1 (D05)"


def _motions(figure: Figure, taken: set[str]) -> Iterator[str]:
    """M14, M16: enabled and loop written out, joints called as the skeleton calls them."""
    chart = figure.chart
    names = set(figure.names.values())
    known = {tables.canonical(n): n for n in names if tables.canonical(n)}
    for motion in figure.node.children("motions"):
        for field, value in (("enabled", True), ("loop", True)):
            if chart.flag(motion, field) is None:
                motion.fields[field] = value
                yield f"motion {motion.name}: {field} is {value} (M14)"
        words = chart.text(motion, "joints").replace(",", " ").replace('"', " ").split()
        new = [w if w in names else known.get(tables.canonical(w) or "", w) for w in words]
        if new != words:
            motion.fields["joints"] = " ".join(new)
            changed = ", ".join(f"{a} is {b}" for a, b in zip(words, new) if a != b)
            yield f"motion {motion.name}: joints as the skeleton calls them: {changed} (M16)"
