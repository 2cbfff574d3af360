"""The doctor's rules about HAnimMotion nodes."""

from __future__ import annotations

import numpy as np

from vitruvian.hanim import tables
from vitruvian.hanim.animation import channel_groups
from vitruvian.hanim.doctor_figure import Figure
from vitruvian.hanim.doctor_space import Floats
from vitruvian.hanim.graph import Node


def motions(figure: Figure) -> list[Node]:
    """The HAnimMotion nodes of a humanoid, wherever they stand in it."""
    return [n for f in ("motions", "children") for n in figure.node.children(f) if n.type == "HAnimMotion"]


def examine(figure: Figure) -> None:
    """M14 to M18 for the HAnimMotion nodes of a humanoid."""
    chart, add, node = figure.chart, figure.chart.add, figure.node
    names = set(figure.names.values())
    known = {tables.canonical(n): n for n in names}
    for motion in motions(figure):
        if motion in node.children("children"):
            add("M15", motion, "the motion is not in motions: it never plays", "containerField='motions'")
        enabled = chart.flag(motion, "enabled")
        if not enabled:
            state = "FALSE: it stands still" if enabled is False else "not given: engines differ on the default"
            add("M14", motion, f"enabled is {state}", "enabled='true'")
        if chart.flag(motion, "loop") is None:
            add("M14", motion, "loop is not given: engines differ on the default", "write loop")
        joints = chart.names(motion, "joints")
        for name in joints:
            if name == "IGNORED" or name in names:
                continue
            other = known.get(tables.canonical(name) or "")
            message = f"the motion names joint {name}, which the skeleton does not have: that joint is still"
            add("M16", motion, message, f"write {other}" if other else "write IGNORED")
        _channels(figure, motion, len(joints))
        for message in stillness(figure, motion):
            add("M17", motion, f"{message}: it stands still", "--also M17 gives the default")
        start, stature = first_position(figure, motion)
        if start is not None and stature and float(np.linalg.norm(start)) > stature:
            place = " ".join(f"{v:g}" for v in start)
            message = f"the first root position {place} is further off than the figure is tall"
            add("M18", motion, message + ": positions are offsets from rest", "subtract it, the motion starts at rest")


def _channels(figure: Figure, motion: Node, joints: int) -> None:
    """M15: counts of joints, channels and values."""
    chart, add = figure.chart, figure.chart.add
    groups = channel_groups(chart.names(motion, "channels"))
    if groups is None:
        add("M15", motion, "channels: expected groups of a count and that many channel names", "rewrite channels")
        return
    if len(groups) != joints:
        add("M15", motion, f"{len(groups)} groups of channels for {joints} joints", "one group per joint")
    width, values = sum(len(g) for g in groups), chart.numbers(motion, "values")
    if width and len(values) % width:
        message = f"{len(values)} values are not a multiple of {width} channels: frames shift"
        add("M15", motion, message, f"cut {len(values) % width} values")


def stillness(figure: Figure, motion: Node) -> list[str]:
    """M17: what keeps a motion from running."""
    chart, found = figure.chart, []
    duration, step = chart.numbers(motion, "frameDuration"), chart.numbers(motion, "frameIncrement")
    if duration.size and duration[0] <= 0:
        found.append(f"frameDuration {duration[0]:g}")
    if step.size and step[0] == 0:
        found.append("frameIncrement 0")
    start, end = chart.numbers(motion, "startFrame"), chart.numbers(motion, "endFrame")
    if end.size and end[0] > 0 and (start[0] if start.size else 0.0) == end[0]:
        found.append(f"startFrame and endFrame are both {end[0]:g}")
    switches = [w.lower() for w in chart.names(motion, "channelsEnabled")]
    if switches and not any(w in {"true", "1"} for w in switches):
        found.append("channelsEnabled is FALSE for all")
    return found


def first_position(figure: Figure, motion: Node) -> tuple[Floats | None, float]:
    """(3,) the root's position in the first frame, None when there is none; the figure's stature (centres' heights)."""
    columns = position_columns(figure, motion)
    values = figure.chart.numbers(motion, "values")
    if columns is None or len(values) <= max(columns):
        return None, 0.0
    start = values[list(columns)]
    heights = [c[1] for j in figure.joints if (c := figure.chart.numbers(j, "center")).size == 3]
    stature = float(np.ptp(heights)) if len(heights) > 1 and np.isfinite(heights).all() else 0.0
    return (start if np.isfinite(start).all() else None), stature


def position_columns(figure: Figure, motion: Node) -> tuple[int, int, int] | None:
    """Which values of a frame are the root's X, Y and Z position; None when the first joint has none."""
    groups = channel_groups(figure.chart.names(motion, "channels"))
    at = {name: k for k, name in enumerate(groups[0])} if groups else {}
    places = tuple(at.get(f"{axis}position", -1) for axis in "XYZ")
    return (places[0], places[1], places[2]) if min(places) >= 0 else None
