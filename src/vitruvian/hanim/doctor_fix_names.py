"""Repairs of names, of the tree and of what the humanoid claims to be."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator

import numpy as np

from vitruvian.hanim import tables
from vitruvian.hanim.doctor_figure import Figure, expected_root, modern, proper_version, whole, wrong_version
from vitruvian.hanim.doctor_fix import Names, Wanted, entries, target
from vitruvian.hanim.doctor_motion import motions
from vitruvian.hanim.doctor_names import (
    DISPLACER_SUFFIXES,
    SITE_SUFFIXES,
    STRANGERS,
    accepted,
    coordinates,
    near,
    prefix,
    strangers,
    things,
)
from vitruvian.hanim.doctor_words import some
from vitruvian.hanim.graph import Node, Use


def _skeleton(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """T04: each joint once in the skeleton."""
    again = {id(joint) for joint, _ in figure.twice}
    parents = {id(parent): parent for _, parent in figure.twice}
    held_first = {id(j): figure.parent[id(j)] for j in figure.joints}
    for parent in parents.values():
        field = "children"
        if parent is figure.node:
            field = "skeleton" if figure.node.children("skeleton") else "humanoidBody"
        kept: list[Node | Use] = []
        gone: list[Node] = []
        seen: set[int] = set()
        for entry in entries(parent, field):
            joint = target(entry)
            first = joint is not None and (held_first.get(id(joint)) or figure.node) is parent and id(joint) not in seen
            if joint is not None and isinstance(entry, Use) and id(joint) in again and not first:
                gone.append(joint)
                continue
            if joint is not None:
                seen.add(id(joint))
            kept.append(entry)
        if gone:
            parent.fields[field] = kept
            parent.order = []
            names = list(dict.fromkeys(figure.name(j) for j in gone))
            yield f"second {some(names)} taken out of {field} (T04)"


def _names(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """N01, N02, V04, V05, N07: standard names where they follow from DEF, alias or likeness."""
    chart = figure.chart
    new_names = modern(figure)
    present = {(chart.text(n, "name"), kind) for n, kind in things(figure)}
    strange = 0
    for thing, kind in things(figure):
        name = chart.text(thing, "name")
        if not name:
            new, rule = figure.name(thing), "N01"
            if not tables.canonical(new, kind):
                continue
        elif kind == "joint" and tables.humanoid_root(name):
            new, rule = expected_root(figure), "V05"
        elif kind != "site" and tables.canonical(name, kind) is None:
            strange += 1
            new, rule = near(name, kind) if strange < STRANGERS else "", "N02"
        elif kind != "site" and new_names:
            new, rule = tables.canonical(name, kind) or "", "V04"
        else:
            continue
        if new and new != name and (new, kind) not in present:
            thing.fields["name"] = new
            present.add((new, kind))
            if name:
                _follow(figure, name, new)
            yield f"{kind} {name or thing.name} is named {new} ({rule})"
    for segment, right, joint in list(strangers(figure)):
        own = chart.text(segment, "name")
        right = right if new_names else tables.name_in(right, "1.x", "segment") or right
        if (right, "segment") not in present and tables.canonical(own, "segment") != tables.canonical(right, "segment"):
            segment.fields["name"] = right
            present.add((right, "segment"))
            yield f"segment {own} of joint {joint} is named {right} (N07)"


def _follow(figure: Figure, old: str, new: str) -> None:
    """Motions call the joint as it is called now."""
    for motion in motions(figure):
        words = figure.chart.names(motion, "joints")
        if old in words:
            motion.fields["joints"] = " ".join(new if w == old else w for w in words)


def _humanoid(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """N08: a name of its own."""
    chart, node = figure.chart, figure.node
    others = [n for n in chart.nodes if chart.reading.kind(n) == "Humanoid"]
    names = [chart.text(n, "name") for n in others]
    own = chart.text(node, "name")
    base = own or node.name.removeprefix("hanim_") or "humanoid"
    earlier = [
        n
        for n, other in zip(names, others)
        if other is not node and (not own or others.index(other) < others.index(node))
    ]
    if own and own not in earlier:
        return
    new, number = base, 2
    while new in set(names) - {""} and (new != own or own in earlier):
        new, number = f"{base}_{number}", number + 1
    if new != own:
        node.fields["name"] = new
        yield f"is named {new} (N08)"


def _prefixes(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """N05, on request: DEFs with the standard's prefix."""
    if "N05+" not in wanted:
        return
    chart = figure.chart
    count = sum(chart.reading.kind(n) == "Humanoid" for n in chart.nodes)
    names, done = Names(chart.scene), 0
    for node, _ in things(figure):
        if node.name and not node.name.startswith(accepted(figure, count)):
            base = "_".join(figure.name(node).split()) or node.name
            names.rename(node, names.free(prefix(figure, count) + base))
            done += 1
    if done:
        yield f"{done} DEFs start with {prefix(figure, count)} (N05)"


def _suffixes(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """N06, on request: names that say what sites, displacers and coordinates are."""
    if "N06+" not in wanted:
        return
    chart = figure.chart
    ends = {id(s) for s, j in figure.segments if not any(figure.parent[id(k)] is j for k in figure.joints)}
    held = {id(n): s for s, _ in figure.segments for n in s.children("children")}
    for site in figure.sites:
        name = chart.text(site, "name")
        if name and not name.endswith(SITE_SUFFIXES):
            segment = held.get(id(site))
            tip = segment is not None and id(segment) in ends and name.startswith(chart.text(segment, "name") or "\0")
            views = any(n.type.endswith("Viewpoint") for n in site.children("children"))
            site.fields["name"] = name + ("_view" if views else "_tip" if tip else "_pt")
            yield f"site {name} is named {site.fields['name']} (N06)"
    for displacer, _ in figure.displacers:
        name = chart.text(displacer, "name")
        if name and not name.endswith(DISPLACER_SUFFIXES):
            moves = chart.numbers(displacer, "displacements").any()
            displacer.fields["name"] = name + ("_action" if moves else "_feature")
            yield f"displacer {name} is named {displacer.fields['name']} (N06)"
    names = Names(chart.scene)
    for coord, end in list(coordinates(figure)):
        old = coord.name
        names.rename(coord, names.free(f"hanim_{end}"))
        yield f"Coordinate {old} is {coord.name} (N06)"


def _claims(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """V01, V02, V03: version and level of articulation say what is there."""
    chart, node = figure.chart, figure.node
    if wrong_version(figure):
        old = chart.text(node, "version") or "''"
        node.fields["version"] = proper_version(figure)
        yield f"version {old} is {node.fields['version']} (V01)"
    known = {n for name in figure.names.values() if (n := tables.canonical(name))}
    claim = chart.numbers(node, "loa")
    if not claim.size or not np.isfinite(claim[0]) or not 0 <= claim[0] <= 4:
        return
    best = tables.complete_loa(known)
    lacks = not set(tables.joints_at(int(claim[0]))) <= known
    if (lacks and whole(set(known))) or best > claim[0]:
        node.fields["loa"] = best
        yield f"loa {claim[0]:g} is {best} ({'V02' if best < claim[0] else 'V03'})"


def _joints(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """M01, M02, M03: `joints` lists every joint of the skeleton once, by USE."""
    node = figure.node
    if not figure.joints or not node.type.startswith("HAnim"):
        return
    kind = figure.chart.reading.kind
    listed = entries(node, "joints")
    ours = [(e, t) for e in listed if (t := target(e)) is None or kind(t) == "Joint"]
    counts = Counter(id(t) for _, t in ours)
    if counts == Counter(id(j) for j in figure.joints) and all(isinstance(e, Use) for e, _ in ours):
        return
    kept: list[Node | Use] = [e for e in listed if (t := target(e)) is not None and kind(t) != "Joint"]
    names = Names(figure.chart.scene)
    for joint in figure.joints:
        joint.name = joint.name or names.free(re.sub(r"\W", "_", f"hanim_{figure.name(joint)}"))
        kept.append(Use(joint.name, joint, container="joints", type=joint.type))
    # the list must stand behind the skeleton, so that no USE comes before its DEF
    node.fields.pop("joints", None)
    node.fields["joints"] = kept
    node.order = []
    yield f"joints lists the {len(figure.joints)} joints of the skeleton, each once (M01, M02, M03)"


STEPS = (_skeleton, _names, _humanoid, _prefixes, _suffixes, _claims, _joints)
