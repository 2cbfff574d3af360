"""Repairs of motion: HAnimMotion nodes, ROUTEs, interpolators, timers."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from vitruvian.hanim import tables
from vitruvian.hanim.animation import channel_groups, event
from vitruvian.hanim.doctor import Chart, Floats
from vitruvian.hanim.doctor_figure import Figure
from vitruvian.hanim.doctor_fix import Wanted
from vitruvian.hanim.doctor_motion import first_position, motions, position_columns, stillness
from vitruvian.hanim.doctor_routes import STEPS as INTERPOLATORS
from vitruvian.hanim.doctor_routes import Events, in_degrees, interface, nearest_field, route_faults, timer_faults
from vitruvian.hanim.graph import Import, Node, Route


def _motions(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """M16: joints called as the skeleton calls them; on request M14, M17, M18."""
    chart = figure.chart
    names = set(figure.names.values())
    known = {tables.canonical(n): n for n in names if tables.canonical(n)}
    for motion in motions(figure):
        who = f"motion {motion.name}".strip()
        words = chart.names(motion, "joints")
        new = [w if w in names else known.get(tables.canonical(w) or "", w) for w in words]
        if new != words:
            motion.fields["joints"] = " ".join(new)
            changed = ", ".join(f"{a} is {b}" for a, b in zip(words, new) if a != b)
            yield f"{who}: joints as the skeleton calls them: {changed} (M16)"
        if "M14+" in wanted:
            if not chart.flag(motion, "enabled"):
                motion.fields["enabled"] = True
                yield f"{who}: enabled is TRUE (M14)"
            if chart.flag(motion, "loop") is None:
                motion.fields["loop"] = True
                yield f"{who}: loop is TRUE (M14)"
        if "M17+" in wanted and (reasons := stillness(figure, motion)):
            for reason in reasons:
                fields = ["startFrame", "endFrame"] if reason.startswith("startFrame") else [reason.split()[0]]
                for field in fields:
                    motion.fields.pop(field, None)
                yield f"{who}: {', '.join(fields)} left out for the default (M17)"
        start, stature = first_position(figure, motion)
        if "M18+" in wanted and start is not None and stature and float(np.linalg.norm(start)) > stature:
            yield from _rebase(figure, motion, start, who)


def _rebase(figure: Figure, motion: Node, start: Floats, who: str) -> Iterator[str]:
    """M18: the root's first position taken off all frames."""
    values = figure.chart.numbers(motion, "values").copy()
    groups = channel_groups(figure.chart.names(motion, "channels")) or []
    columns, width = position_columns(figure, motion), sum(len(g) for g in groups)
    if columns is None or len(values) % width:
        return
    for column, offset in zip(columns, start):
        values[column::width] -= offset
    motion.fields["values"] = values
    yield f"{who}: starts at rest, {' '.join(f'{v:g}' for v in start)} taken off all positions (M18)"


def _events(chart: Chart) -> Events:
    events = Events(chart.scene.defs(), defaultdict(list), defaultdict(list))
    for route in chart.scene.routes():
        if route.to_node in events.defs and route.from_node in events.defs:
            events.into[(route.to_node, event(route.to_field))].append(route)
        events.out[route.from_node].append(route)
    return events


def _routes(chart: Chart, wanted: Wanted) -> Iterator[str]:
    """M07, on request: ROUTEs turned round, their ends the nearest DEF and field, when that makes them right."""
    if "M07+" not in wanted:
        return
    defs = chart.scene.defs()
    imported = {s.alias or s.name for s in chart.scene.body if isinstance(s, Import)}
    for route in chart.scene.routes():
        if not route_faults(chart, route, defs, imported):
            continue
        before = f"{route.from_node}.{route.from_field} TO {route.to_node}.{route.to_field}"
        for candidate in _candidates(chart, route, defs):
            if candidate is not None and not route_faults(chart, candidate, defs, imported):
                route.from_node, route.from_field = candidate.from_node, candidate.from_field
                route.to_node, route.to_field = candidate.to_node, candidate.to_field
                after = f"{route.from_node}.{route.from_field} TO {route.to_node}.{route.to_field}"
                yield f"ROUTE {before} is {after} (M07)"
                break


def _candidates(chart: Chart, route: Route, defs: dict[str, Node]) -> Iterator[Route | None]:
    """What a wrong ROUTE may have meant."""
    yield Route(route.to_node, route.to_field, route.from_node, route.from_field)
    turned = (event(route.to_field) + "_changed", "set_" + event(route.from_field))
    yield Route(route.to_node, turned[0], route.from_node, turned[1])
    ends = []
    for name, field in ((route.from_node, route.from_field), (route.to_node, route.to_field)):
        near = name if name in defs else chart.closest(name, defs)
        if near not in defs:
            return
        known = interface(chart, defs[near], field)
        if known == ("", ""):
            field = nearest_field(chart, defs[near], field) or field
        ends.append((near, field))
    yield Route(*ends[0], *ends[1])


def _clocks(chart: Chart, wanted: Wanted) -> Iterator[str]:
    """M09, on request: clocks that run."""
    if "M09+" not in wanted:
        return
    events = _events(chart)
    for node in chart.nodes:
        if node.type != "TimeSensor" or node.name not in events.out:
            continue
        for message, _ in timer_faults(chart, node, events):
            if message.startswith(("cycleInterval", "stopTime")):
                node.fields.pop(message.split()[0], None)
                what = f"{message.split()[0]} left out"
            else:
                field = message.split()[0]
                node.fields[field] = True
                what = f"{field} is TRUE"
            yield f"TimeSensor {node.name}: {what} (M09)"


def _interpolators(chart: Chart, wanted: Wanted) -> Iterator[str]:
    """M10 and M18, on request: as many values as keys, in order, in 0..1; radians."""
    driven = {r.from_node for r in chart.scene.routes()}
    for node in chart.nodes:
        if node.type not in INTERPOLATORS or node.name not in driven:
            continue
        step = INTERPOLATORS[node.type]
        keys, flat = chart.numbers(node, "key"), chart.numbers(node, "keyValue")
        n = min(len(keys), len(flat) // step)
        if not np.isfinite(keys).all():
            continue
        values = flat[: n * step].reshape(n, step)
        if "M10+" in wanted:
            if n != len(keys) or n * step != len(flat):
                keys = keys[:n]
                yield from _store(node, keys, values, f"cut to {n} keys (M10)")
            if (np.diff(keys) < 0).any():
                order = np.argsort(keys, kind="stable")
                keys, values = keys[order], values[order]
                yield from _store(node, keys, values, "keys sorted (M10)")
            if len(keys) and (keys[-1] > 1 or keys[0] < 0):
                span = float(keys[-1] - min(keys[0], 0.0))
                keys = (keys - min(keys[0], 0.0)) / max(span, 1.0)
                yield from _store(node, keys, values, "keys scaled to 0..1 (M10)")
        if "M18+" in wanted and step == 4 and in_degrees(values.reshape(-1), chart.reading.angle):
            values = values.copy()
            values[:, 3] = np.radians(values[:, 3])
            yield from _store(node, keys, values, "angles are radians (M18)")


def _store(node: Node, keys: Floats, values: Floats, what: str) -> Iterator[str]:
    node.fields["key"], node.fields["keyValue"] = keys, values if values.shape[1] > 1 else values[:, 0]
    yield f"{node.type} {node.name}: {what}"


STEPS = (_motions,)
SCENE_STEPS = (_routes, _interpolators, _clocks)
