"""The doctor's rules about motion: HAnimMotion nodes, ROUTEs, interpolators, timers."""

from __future__ import annotations

import re
from collections import defaultdict

import numpy as np

from vitruvian.hanim import tables
from vitruvian.hanim.animation import channel_groups, event
from vitruvian.hanim.doctor import Chart
from vitruvian.hanim.doctor_figure import Figure
from vitruvian.hanim.fields import field as field_of
from vitruvian.hanim.graph import Import, Node, Route

_STEPS = {
    "OrientationInterpolator": 4,
    "PositionInterpolator": 3,
    "ScalarInterpolator": 1,
    "ColorInterpolator": 3,
    "PositionInterpolator2D": 2,
}


def motions(figure: Figure) -> None:
    """M14 to M18 for the HAnimMotion nodes of a humanoid."""
    chart, add, node = figure.chart, figure.chart.add, figure.node
    found = [n for f in ("motions", "children") for n in node.children(f) if n.type == "HAnimMotion"]
    names = set(figure.names.values())
    known = {tables.canonical(n): n for n in names}
    for motion in found:
        if motion in node.children("children"):
            add("M15", motion, "the motion is not in motions: it never plays", "containerField='motions'")
        enabled = chart.flag(motion, "enabled")
        if not enabled:
            state = "FALSE: it stands still" if enabled is False else "not given: engines differ on the default"
            add("M14", motion, f"enabled is {state}", "enabled='true'")
        if chart.flag(motion, "loop") is None:
            add("M14", motion, "loop is not given: engines differ on the default", "write loop")
        joints = [w for w in re.split(r"[\s,\"]+", chart.text(motion, "joints")) if w]
        for name in joints:
            if name == "IGNORED" or name in names:
                continue
            other = known.get(tables.canonical(name) or "")
            message = f"the motion names joint {name}, which the skeleton does not have: that joint is still"
            add("M16", motion, message, f"write {other}" if other else "write IGNORED")
        _channels(figure, motion, len(joints))
        duration = chart.numbers(motion, "frameDuration")
        if duration.size and duration[0] <= 0:
            add("M17", motion, f"frameDuration {duration[0]:g}: it stands still", "give the seconds of a frame")


def _channels(figure: Figure, motion: Node, joints: int) -> None:
    chart, add = figure.chart, figure.chart.add
    groups = channel_groups([w for w in re.split(r"[\s,\"]+", chart.text(motion, "channels")) if w])
    if groups is None:
        add("M15", motion, "channels: expected groups of a count and that many channel names", "rewrite channels")
        return
    if len(groups) != joints:
        add("M15", motion, f"{len(groups)} groups of channels for {joints} joints", "one group per joint")
    width, values = sum(len(g) for g in groups), chart.numbers(motion, "values")
    if width and len(values) % width:
        message = f"{len(values)} values are not a multiple of {width} channels: frames shift"
        add("M15", motion, message, f"cut {len(values) % width} values")
    if not width or len(values) < width or not groups or len(groups[0]) < 3:
        return
    at = {name: k for k, name in enumerate(groups[0])}
    if {"Xposition", "Yposition", "Zposition"} <= at.keys():
        start = np.array([values[at[f"{a}position"]] for a in "XYZ"])
        heights = [c[1] for j in figure.joints if (c := chart.numbers(j, "center")).size == 3]
        stature = float(np.ptp(heights)) if len(heights) > 1 else 0.0
        if stature and np.isfinite(start).all() and float(np.linalg.norm(start)) > stature:
            message = (
                f"the first root position {' '.join(f'{v:g}' for v in start)} is further off than the figure is tall"
            )
            add("M18", motion, message + ": positions are offsets from rest", "subtract the root's centre")


def routes(chart: Chart, figures: list[Figure]) -> None:
    """M07 to M13 and M22."""
    defs = chart.scene.defs()
    imported = {s.alias or s.name for s in chart.scene.body if isinstance(s, Import)}
    driven: dict[tuple[str, str], list[Route]] = defaultdict(list)
    inputs: set[str] = set()
    for route in chart.scene.routes():
        ends = ((route.from_node, route.from_field, "from"), (route.to_node, route.to_field, "to"))
        whole = True
        for name, field, end in ends:
            node = defs.get(name)
            if node is None:
                if name not in imported:
                    chart.add("M07", None, f"ROUTE {end} {name}.{field}: there is no DEF {name}", "", route.line)
                whole = False
            elif node.type not in chart.reading.protos and not node.interface:
                found = field_of(node.type, field)
                wrong = ("outputOnly", "initializeOnly") if end == "to" else ("inputOnly", "initializeOnly")
                if (
                    found is not None
                    and found.access in wrong
                    and node.type.startswith(("HAnim", *_STEPS, "TimeSensor"))
                ):
                    message = f"ROUTE {end} {name}.{field}: the field is {found.access}"
                    chart.add("M07", node, message, "turn the ROUTE round", route.line)
        if whole:
            driven[(route.to_node, event(route.to_field))].append(route)
            inputs.add(f"{route.to_node}.{event(route.to_field)}")
    still: list[Node] = []
    for figure in figures:
        ids = {id(j) for j in figure.joints} | {id(s) for s in figure.sites} | {id(d) for d, _ in figure.displacers}
        for (name, field), sources in driven.items():
            if id(defs[name]) not in ids and defs[name] is not figure.node:
                continue
            timers = {_timer_of(chart, r, defs, driven) for r in sources}
            if len(sources) > 1 and len(timers) < len(sources):
                message = f"{len(sources)} ROUTEs drive {name}.{field}: the last writer wins"
                chart.add("M13", defs[name], message, "keep one", sources[1].line)
            for route in sources:
                source = defs[route.from_node]
                if source.type == "Script":
                    message = f"{name}.{field} is driven by Script {source.name}, which is not run here"
                    chart.add("M22", source, message, "", route.line)
                elif source.type in _STEPS:
                    _interpolator(chart, source, f"{source.name}.fraction" in inputs, still)
    if still:
        message = f"{len(still)} interpolators give the same value all the time: there is nothing to see"
        chart.add("M11", still[0], message)
    used = {route.from_node for route in chart.scene.routes()}
    for node in chart.nodes:
        if node.type == "TimeSensor" and node.name in used:
            _timer(chart, node, driven, defs)


def _timer_of(chart: Chart, route: Route, defs: dict[str, Node], driven: dict) -> str:
    """The node that feeds an interpolator's fraction, by name."""
    sources = driven.get((route.from_node, "fraction"), [])
    return sources[0].from_node if sources else route.from_node


def _interpolator(chart: Chart, node: Node, fed: bool, still: list[Node]) -> None:
    if not fed:
        message = f"nothing drives the fraction of {node.type} {node.name}: no event ever comes out"
        chart.add("M08", node, message, "ROUTE a TimeSensor's fraction_changed to its set_fraction")
    keys, values = chart.numbers(node, "key"), chart.numbers(node, "keyValue")
    step = _STEPS[node.type]
    if len(values) != step * len(keys):
        message = f"{len(keys)} keys but {len(values) / step:g} key values"
        chart.add("M10", node, message, "cut both to the shorter")
    elif (np.diff(keys) < 0).any():
        chart.add("M10", node, "keys go backwards: the output is undefined", "sort them")
    elif ((keys < 0) | (keys > 1)).any():
        chart.add("M10", node, "keys lie outside 0..1, where the fraction never comes", "scale them to 0..1")
    elif len(keys) > 1 and (values.reshape(len(keys), -1) == values[:step]).all():
        still.append(node)


def _timer(chart: Chart, node: Node, driven: dict, defs: dict[str, Node]) -> None:
    started = [r for f in ("startTime", "enabled", "resumeTime", "loop") for r in driven.get((node.name, f), [])]
    loop, enabled = chart.flag(node, "loop"), chart.flag(node, "enabled")
    interval = chart.numbers(node, "cycleInterval")
    if interval.size and interval[0] <= 0:
        chart.add("M09", node, f"cycleInterval {interval[0]:g}: the clock never runs", "give its seconds")
    if enabled is False and not any(event(r.to_field) == "enabled" for r in started):
        chart.add("M09", node, "enabled is FALSE and nothing switches it on", "enabled='true'")
    elif not loop and not started:
        chart.add(
            "M09", node, "loop is FALSE and nothing starts it: it looks frozen", "loop='true' or ROUTE a start time"
        )
    for route in started:
        source = defs.get(route.from_node)
        if source is not None and source.type.endswith("Sensor") and source.type != "TimeSensor":
            chart.add("M12", node, f"waits for {source.type} {source.name}", "", route.line)
