"""Motion to nodes: HAnimMotion, and TimeSensors with interpolators and their ROUTEs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vitruvian.hanim.graph import Node, Route, Use
from vitruvian.hanim.humanoid import MotionData, Track

INTERPOLATORS = {4: "OrientationInterpolator", 3: "PositionInterpolator", 1: "ScalarInterpolator"}


def motion_node(motion: MotionData, name: str, *, enabled: bool) -> Node:
    """An HAnimMotion of that DEF; `enabled` and `loop` are always written, since engines differ on their defaults."""
    fields: dict[str, object] = {
        "joints": " ".join(motion.joints),
        "channels": " ".join(f"{len(g)} {' '.join(g)}" for g in motion.channels),
        "enabled": bool(enabled),
        "loop": bool(motion.loop),
        "frameDuration": float(motion.frame_duration),
        "endFrame": int(motion.end_frame) or max(len(motion.values) - 1, 0),
        "values": np.ascontiguousarray(motion.values).reshape(-1),
    }
    if motion.description:
        fields["description"] = motion.description
    return Node("HAnimMotion", name, fields)


def track_nodes(
    tracks: list[Track],
    targets: dict[str, Node],
    free: Callable[[str], str],
    prefix: str,
    points: dict[str, Node | Use] | None = None,
) -> tuple[list[Node], list[Route], list[str]]:
    """TimeSensors (one per clip), interpolators (one per track), their ROUTEs, and what could not be driven.

    `targets` maps track targets to nodes, `points` the humanoid ("") and segments to their Coordinates, `free` hands
    out DEFs. Only the first clip plays by itself.
    """
    timers: dict[str, Node] = {}
    sensors: list[Node] = []
    nodes: list[Node] = []
    routes: list[Route] = []
    absent: list[str] = []
    for track in tracks:
        values = track.values.reshape(len(track.keys), -1)
        width = values.shape[1]
        if track.field == "point":
            entry = (points or {}).get(track.target)
            target = entry.node if isinstance(entry, Use) else entry
            able = target is not None and width % 3 == 0
        else:
            target = targets.get(track.target)
            kind = target.type.removeprefix("HAnim") if target is not None else ""
            able = width in INTERPOLATORS and kind != "Segment" and (track.field == "weight") == (kind == "Displacer")
        if target is None or not able:
            absent.append(track.target)
            continue
        timer = timers.get(track.timer)
        if timer is None:
            timer = timers[track.timer] = Node(
                "TimeSensor", free(prefix + (track.timer or "timer").removeprefix(prefix))
            )
            timer.fields["cycleInterval"] = float(track.interval)
            timer.fields["loop"] = bool(track.loop)
            timer.fields["enabled"] = len(timers) == 1
            sensors.append(timer)
        label = f"{track.target or 'humanoid'}_{track.field}" + (f"_{track.timer}" if len(timers) > 1 else "")
        kind = "CoordinateInterpolator" if track.field == "point" else INTERPOLATORS[width]
        node = Node(kind, free(prefix + label))
        node.fields["key"] = track.keys
        node.fields["keyValue"] = values.reshape(-1, 3) if track.field == "point" else _column(values)
        nodes.append(node)
        routes.append(Route(timer.name, "fraction_changed", node.name, "set_fraction"))
        routes.append(Route(node.name, "value_changed", target.name, f"set_{track.field}"))
    lost = []
    if absent:
        lost.append(f"{len(absent)} tracks without a target ({absent[0] or 'humanoid'})")
    if len(timers) > 1:
        lost.append(f"{len(timers)} clips: only the first plays by itself, the other TimeSensors are disabled")
    return [*sensors, *nodes], routes, lost


def _column(values: np.ndarray) -> np.ndarray:
    return values if values.shape[1] > 1 else values.reshape(-1)
