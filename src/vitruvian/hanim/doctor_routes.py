"""The doctor's rules about events: ROUTEs, interpolators, timers, and who drives what."""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from vitruvian.hanim import doctor_motion
from vitruvian.hanim.animation import event
from vitruvian.hanim.doctor import Chart, Floats
from vitruvian.hanim.doctor_figure import Figure
from vitruvian.hanim.doctor_words import several, some
from vitruvian.hanim.fields import field as field_of
from vitruvian.hanim.fields import fields_of, known
from vitruvian.hanim.graph import Import, Node, Route

STEPS = {
    "OrientationInterpolator": 4,
    "PositionInterpolator": 3,
    "ScalarInterpolator": 1,
    "ColorInterpolator": 3,
    "PositionInterpolator2D": 2,
}
_STILL = 1e-6
_CHAIN = 4  # nodes between a sensor and the clock that it starts
_RADIANS = 2 * np.pi * 1.05  # the largest angle that a turn in radians usually has
_WHO_WAITS = {"TouchSensor", "ProximitySensor", "VisibilitySensor", "KeySensor", "StringSensor", "PlaneSensor"}
_WHO_WAITS |= {"SphereSensor", "CylinderSensor"}


@dataclass(slots=True)
class Events:
    """The ROUTEs of a scene whose ends are there: by what they drive, and by where they come from."""

    defs: dict[str, Node]
    into: dict[tuple[str, str], list[Route]]
    out: dict[str, list[Route]]


def examine(chart: Chart, figures: list[Figure]) -> None:
    """M07 to M13, M22, and M18 of interpolators."""
    events = Events(chart.defs(), defaultdict(list), defaultdict(list))
    imported = {s.alias or s.name for s in chart.scene.body if isinstance(s, Import)}
    for route in chart.scene.routes():
        faults = route_faults(chart, route, events.defs, imported)
        for message, fix in faults:
            node = events.defs.get(route.to_node) or events.defs.get(route.from_node)
            chart.add("M07", node, message, fix, route.line)
        if route.to_node in events.defs and route.from_node in events.defs:
            events.into[(route.to_node, event(route.to_field))].append(route)
        if route.from_node in events.defs:
            events.out[route.from_node].append(route)
    targets = {id(t) for f in figures for t in (f.node, *f.joints, *f.sites, *(d for d, _ in f.displacers))}
    still: list[Node] = []
    seen: set[int] = set()
    for (name, field), sources in events.into.items():
        if id(events.defs[name]) not in targets:
            continue
        _sources(chart, name, field, sources, events)
        for route in sources:
            source = events.defs[route.from_node]
            if source.type in STEPS and id(source) not in seen:
                seen.add(id(source))
                _interpolator(chart, source, events, still, field)
    if still:
        what = several(len(still), "interpolator gives", "interpolators give")
        message = f"{what} the same value all the time: there is nothing to see"
        chart.add("M11", still[0], message)
    _idle(chart, events, seen)
    _twice_driven(figures, events)
    for node in chart.nodes:
        if node.type == "TimeSensor" and node.name in events.out:
            _timer(chart, node, events)


# ROUTEs


def route_faults(chart: Chart, route: Route, defs: dict[str, Node], imported: set[str]) -> list[tuple[str, str]]:
    """M07: what is wrong with a ROUTE, each with what to do."""
    found: list[tuple[str, str]] = []
    types = []
    for name, field, end in ((route.from_node, route.from_field, "from"), (route.to_node, route.to_field, "to")):
        node = defs.get(name)
        if node is None:
            if name not in imported:
                near = chart.closest(name, defs)
                fix = f"perhaps {near} is meant" if near else f"add DEF {name} or drop the ROUTE"
                found.append((f"ROUTE {end} {name}.{field}: there is no DEF {name}", fix))
            continue
        known_field = interface(chart, node, field)
        if known_field is None:
            continue
        kind, access = known_field
        if not access:
            near = nearest_field(chart, node, field)
            fix = f"perhaps {near} is meant" if near else ""
            found.append((f"ROUTE {end} {name}.{field}: {node.type} has no such field", fix))
        elif access in (("outputOnly", "initializeOnly") if end == "to" else ("inputOnly", "initializeOnly")):
            found.append((f"ROUTE {end} {name}.{field}: the field is {access}", "turn the ROUTE round"))
        types.append(kind)
    if not found and len(types) == 2 and all(types) and _width(types[0]) != _width(types[1]):
        what = f"ROUTE from {route.from_node}.{route.from_field} to {route.to_node}.{route.to_field}"
        found.append((f"{what}: {types[0]} does not fit {types[1]}", "ROUTE between fields of one type"))
    return found


def _width(kind: str) -> str:
    return kind.replace("SFDouble", "SFFloat").replace("Vec3d", "Vec3f")


def interface(chart: Chart, node: Node, field: str) -> tuple[str, str] | None:
    """Type and access of a field that a ROUTE names: ("", "") when the node has none such, None when nobody can tell."""
    own = list(node.interface)
    if node.type in chart.reading.protos:
        own += chart.reading.protos[node.type].interface
    for candidate in (field, event(field)):
        for f in own:
            if f.name == candidate:
                return f.type, f.access
    if node.type in chart.reading.protos:
        return "", ""
    if not known(node.type):
        return None
    found = field_of(node.type, field)
    if found is not None:
        return found.type, found.access
    if node.interface or chart.scene.encoding == "wrl":  # VRML97 has fields that X3D has renamed
        return None
    return "", ""


def nearest_field(chart: Chart, node: Node, field: str) -> str:
    """The field of a node whose name is nearest to that in a ROUTE, "" when none is near."""
    if node.type in chart.reading.protos:
        names = [f.name for f in chart.reading.protos[node.type].interface]
    else:
        names = [*fields_of(node.type), *(f.name for f in node.interface)]
    return chart.closest(field, names) or chart.closest(event(field), names)


# Who drives what


def _sources(chart: Chart, name: str, field: str, sources: list[Route], events: Events) -> None:
    """M13 and M22."""
    timers = {_timer_of(r, events) for r in sources}
    if len(sources) > 1 and len(timers) < len(sources):
        message = f"{len(sources)} ROUTEs drive {name}.{field}: the last writer wins"
        chart.add("M13", events.defs[name], message, "keep one", sources[1].line)
    for route in sources:
        source = events.defs[route.from_node]
        if source.type == "Script":
            message = f"{name}.{field} is driven by Script {source.name}, which is not run here"
            chart.add("M22", source, message, "", route.line)


def _timer_of(route: Route, events: Events) -> str:
    """The node that feeds an interpolator's fraction, by name."""
    sources = events.into.get((route.from_node, "fraction"), [])
    return sources[0].from_node if sources else route.from_node


def _twice_driven(figures: list[Figure], events: Events) -> None:
    """M13: a joint that an HAnimMotion and an interpolator both turn."""
    for figure in figures:
        chart = figure.chart
        joints = {figure.name(j): j for j in figure.joints}
        for motion in doctor_motion.motions(figure):
            if not chart.flag(motion, "enabled"):
                continue
            both = [
                n for n in chart.names(motion, "joints") if n in joints and (joints[n].name, "rotation") in events.into
            ]
            if both:
                message = (
                    f"{several(len(both), 'joint is', 'joints are')} driven by the motion and by ROUTEs ({some(both)})"
                )
                chart.add("M13", motion, message + ": the last writer wins", "keep one")


# Interpolators


def _interpolator(chart: Chart, node: Node, events: Events, still: list[Node], field: str) -> None:
    """M08, M10, M11, M18 of one interpolator that drives a humanoid."""
    if (node.name, "fraction") not in events.into:
        message = f"nothing drives the fraction of {node.type} {node.name}: no event ever comes out"
        chart.add("M08", node, message, "ROUTE a TimeSensor's fraction_changed to its set_fraction")
    keys, values = chart.numbers(node, "key"), chart.numbers(node, "keyValue")
    step = STEPS[node.type]
    if len(values) != step * len(keys):
        message = f"{len(keys)} keys but {len(values) / step:g} key values"
        chart.add("M10", node, message, "cut both to the shorter")
    elif (np.diff(keys) < 0).any():
        chart.add("M10", node, "keys go backwards: the output is undefined", "sort them")
    elif ((keys < 0) | (keys > 1)).any():
        chart.add("M10", node, "keys lie outside 0..1, where the fraction never comes", "scale them to 0..1")
    elif len(keys) > 1 and _same(values.reshape(len(keys), -1)):
        still.append(node)
    if node.type == "OrientationInterpolator" and in_degrees(values, chart.reading.angle):
        largest = float(np.abs(values[3::4]).max())
        message = f"angles up to {largest:g}: degrees, where radians are meant"
        chart.add("M18", node, message, "--also M18 turns them into radians")


def _same(values: Floats) -> bool:
    """Whether all key values mean the same: equal, or all of them turns by next to nothing."""
    if (values == values[0]).all():
        return True
    return values.shape[1] == 4 and bool((np.abs(values[:, 3]) < _STILL).all())


def in_degrees(values: Floats, unit: float = 1.0) -> bool:
    """M18: whether the angles of rotations are degrees: more than a turn, and no whole half turns of radians."""
    angles = np.abs(values[: len(values) // 4 * 4][3::4]) * unit
    if not angles.size or not np.isfinite(angles).all():
        return False
    large = angles[angles > _RADIANS]
    return bool(large.size) and bool((np.abs(large / np.pi - np.round(large / np.pi)) > 1e-3).any())


def _idle(chart: Chart, events: Events, seen: set[int]) -> None:
    """M08: timers that drive nothing while interpolators wait, interpolators that drive nothing."""
    held = {id(n) for s in chart.nodes if s.type == "Script" for f in s.interface for n in _nodes(f.value)}
    timers = [n for n in chart.nodes if n.type == "TimeSensor" and n.name not in events.out and id(n) not in held]
    if timers:
        names = some([n.name or "(no DEF)" for n in timers])
        what = several(len(timers), "TimeSensor drives", "TimeSensors drive")
        message = f"{what} nothing ({names}): no ROUTE leaves"
        chart.add("M08", timers[0], message, "ROUTE its fraction_changed to interpolators")
    mute = [n for n in chart.nodes if n.type in STEPS and n.name not in events.out and id(n) not in held]
    mute = [n for n in mute if (n.name, "fraction") in events.into]
    if mute:
        what = several(len(mute), "interpolator drives", "interpolators drive")
        message = f"{what} nothing ({some([n.name for n in mute])}): no ROUTE leaves"
        chart.add("M08", mute[0], message, "ROUTE its value_changed to a joint")


def _nodes(value: object) -> list[Node]:
    found = []
    for v in value if isinstance(value, list) else [value]:
        node = getattr(v, "node", v)
        if isinstance(node, Node):
            found.append(node)
    return found


# Timers


def timer_faults(chart: Chart, node: Node, events: Events) -> list[tuple[str, str]]:
    """M09: why a TimeSensor never runs, each with what to do."""
    found = []
    started = [r for f in ("startTime", "enabled", "resumeTime", "loop") for r in events.into.get((node.name, f), [])]
    loop, enabled = chart.flag(node, "loop"), chart.flag(node, "enabled")
    interval = chart.numbers(node, "cycleInterval")
    if interval.size and interval[0] <= 0:
        found.append((f"cycleInterval {interval[0]:g}: the clock never runs", "give its seconds"))
    if enabled is False and not any(event(r.to_field) == "enabled" for r in started):
        found.append(("enabled is FALSE and nothing switches it on", "enabled='true'"))
    elif not loop and not started:
        found.append(("loop is FALSE and nothing starts it: it looks frozen", "loop='true' or ROUTE a start time"))
    start, stop = (chart.numbers(node, f) for f in ("startTime", "stopTime"))
    stopped = float(stop[0]) if stop.size and np.isfinite(stop[0]) else 0.0
    if (start[0] if start.size else 0.0) < stopped < time.time() and not started:
        found.append((f"stopTime {stopped:g} is long past: it has stopped", "leave stopTime out"))
    return found


def _timer(chart: Chart, node: Node, events: Events) -> None:
    """M09 and M12."""
    for message, fix in timer_faults(chart, node, events):
        chart.add("M09", node, message, fix)
    for field in ("startTime", "enabled", "resumeTime", "loop"):
        for route in events.into.get((node.name, field), []):
            source = _sensor(events, events.defs[route.from_node])
            if source is not None:
                chart.add("M12", node, f"waits for {source.type} {source.name}", "", route.line)


def _sensor(events: Events, node: Node) -> Node | None:
    """The sensor that waits for somebody at the head of a chain of Scripts, filters and triggers."""
    seen: set[str] = set()
    for _ in range(_CHAIN):
        if node.type in _WHO_WAITS:
            return node
        seen.add(node.name)
        heads = [
            r.from_node
            for f in ("boolean", "touchTime", "triggerTime", *_own(node))
            for r in events.into.get((node.name, f), [])
        ]
        fresh = [h for h in heads if h not in seen]
        if node.type == "TimeSensor" or not fresh:
            return None
        node = events.defs[fresh[0]]
    return None


def _own(node: Node) -> list[str]:
    return [event(f.name) for f in node.interface if f.access in {"inputOnly", "inputOutput"}]
