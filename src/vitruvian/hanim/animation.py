"""What moves a humanoid in a file: interpolators behind ROUTEs as `Track`s, HAnimMotion nodes as `MotionData`."""

from __future__ import annotations

import re
from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from vitruvian.hanim.graph import Node, Route
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, MotionData, Shape, Site, Track
from vitruvian.hanim.members import read_members
from vitruvian.hanim.reading import Reading
from vitruvian.hanim.surface import coordinate

_WIDTHS = {
    "OrientationInterpolator": 4,
    "PositionInterpolator": 3,
    "ScalarInterpolator": 1,
    "CoordinateInterpolator": 3,
}
_VALUES = {4: "MFRotation", 3: "MFVec3f", 1: "MFFloat"}
_FIELDS = {"rotation": 4, "translation": 3, "scale": 3, "center": 3, "weight": 1, "point": 3}
_CHAIN = 16  # nodes between timer and interpolator


def event(name: str) -> str:
    """The field behind an event name: `set_x` and `x_changed` are x."""
    return name.removeprefix("set_").removesuffix("_changed")


def motions(reading: Reading, node: Node, prefixes: tuple[str, ...] = ()) -> list[MotionData]:
    """The HAnimMotion nodes of a Humanoid, wherever a wrong containerField has put them."""
    found = [n for f in ("motions", "children") for n in node.children(f) if reading.kind(n) == "Motion"]
    return [_motion(reading, n, k, prefixes) for k, n in enumerate(found)]


def _words(texts: list[str]) -> list[str]:
    return [w for t in texts for w in re.split(r"[\s,\"]+", t) if w]


def channel_groups(words: list[str]) -> list[tuple[str, ...]] | None:
    """`6 Xposition .. 3 Zrotation ..` as one tuple of names per group; None when the counts do not fit."""
    groups = []
    at = 0
    while at < len(words):
        if not words[at].isdigit() or at + int(words[at]) >= len(words):
            return None
        n = int(words[at])
        groups.append(tuple(words[at + 1 : at + 1 + n]))
        at += 1 + n
    return groups


def _motion(reading: Reading, node: Node, number: int, prefixes: tuple[str, ...]) -> MotionData:
    joints = _words(reading.texts(node, "joints"))
    groups = channel_groups(_words(reading.texts(node, "channels")))
    prefix = next((p for p in prefixes if p and node.name.startswith(p) and len(node.name) > len(p)), "")
    name = reading.text(node, "name").strip() or node.name[len(prefix) :] or f"motion_{number + 1}"
    if groups is None:
        reading.broken(f"motion {name} channels: expected groups of a count and that many channel names", node)
        groups = []
    if len(groups) != len(joints):
        what = f"expected as many channel groups as joints, found {len(groups)} groups for {len(joints)} joints"
        reading.broken(f"motion {name}: {what}", node)
        n = min(len(groups), len(joints))
        groups, joints = groups[:n], joints[:n]
        reading.mend(node, "joints", " ".join(joints))
        reading.mend(node, "channels", " ".join(f"{len(g)} {' '.join(g)}" for g in groups))
    values = reading.numbers(node, "values")
    width = sum(len(g) for g in groups)
    if width and len(values) % width:
        reading.broken(f"motion {name} values: expected a multiple of {width} channels, found {len(values)}", node)
        reading.mend(node, "values", values[: len(values) // width * width])
    frames = len(values) // width if width else 0
    if not reading.flag(node, "enabled", False):
        reading.defect("M14", f"motion {name}: enabled is not TRUE, engines differ on whether it plays", node)
    duration = reading.number(node, "frameDuration", 0.1)
    if duration <= 0:
        reading.defect("M17", f"motion {name}: frameDuration {duration:g} is read as 0.1 s", node)
        duration = 0.1
    last = int(reading.softly(node, "endFrame", "SFInt32", 0))  # type: ignore[call-overload]
    motion = MotionData(
        name=name,
        joints=joints,
        channels=groups,
        values=values[: frames * width].reshape(frames, width),
        frame_duration=duration,
        enabled=reading.flag(node, "enabled", False),
        loop=reading.flag(node, "loop", False),
        end_frame=0 if last == frames - 1 else last,
        node=node,
    )
    read_members(reading, node, motion, "Motion")
    return motion


def attach_tracks(reading: Reading, figures: list[Humanoid]) -> None:
    """Fill `Humanoid.tracks` from the ROUTEs of the scene.

    Followed: TimeSensor fraction -> (anything) -> interpolator -> joint, site, displacer or humanoid. What stands
    between timer and interpolator is passed over with a warning.
    """
    routes = reading.scene.routes()
    if not routes or not figures:
        return
    targets: dict[int, tuple[Humanoid, str]] = {}
    for h in figures:
        things: list[Joint | Site | Displacer] = [*h.joints(), *h.all_sites(), *h.viewpoints, *h.displacers()]
        targets |= {id(t.node): (h, t.name) for t in things if t.node is not None}
        targets[id(h.node)] = (h, "")
        for owner, field, name in [(h.node, "skinCoord", ""), *((g.node, "coord", g.name) for g in h.segments())]:
            points = owner.children(field) if owner is not None else []
            targets |= {id(n): (h, name) for n in points}
        targets |= {id(c): (h, s.name) for s in h.skin if s.points is not None and (c := own_coordinate(s)) is not None}
    defs = reading.scene.defs()
    into: dict[str, list[Route]] = defaultdict(list)
    for route in routes:
        into[route.to_node].append(route)
    for route in routes:
        target, source = defs.get(route.to_node), defs.get(route.from_node)
        if target is None or source is None or id(target) not in targets or event(route.from_field) != "value":
            continue
        h, name = targets[id(target)]
        field = event(route.to_field)
        track = _track(reading, source, field, into, defs)
        if track is not None:
            track.target, track.field = name, field
            h.tracks.append(track)


def own_coordinate(shape: Shape) -> Node | None:
    """The Coordinate of a shape's geometry in its file."""
    geometry = shape.node.children("geometry") if shape.node is not None else []
    return coordinate(geometry[0]) if geometry else None


def _track(
    reading: Reading, source: Node, field: str, into: dict[str, list[Route]], defs: dict[str, Node]
) -> Track | None:
    width = _WIDTHS.get(source.type)
    whole = source.type == "CoordinateInterpolator"
    if width is None or _FIELDS.get(field) != width or whole != (field == "point"):
        return None
    timer = _timer(reading, source, into, defs)
    if timer is None:
        return None
    keys = reading.numbers(source, "key")
    values = reading.numbers(source, "keyValue", _VALUES[width], width).reshape(-1, width)
    if whole:
        width = 3 * (len(values) // max(len(keys), 1))
        values = values.reshape(len(keys), width) if width and values.size == len(keys) * width else values[:0]
    if len(keys) != len(values):
        what = f"expected {len(keys)} key values, one per key, found {len(values)}"
        reading.broken(f"{source.type} {source.name}: {what}", source)
        n = min(len(keys), len(values))
        keys, values = keys[:n], values[:n]
        reading.mend(source, "key", keys)
        reading.mend(source, "keyValue", (values.reshape(-1, 3) if whole else values) if width > 1 else values[:, 0])
    if len(keys) == 0:
        return None
    if (np.diff(keys) < 0).any():
        reading.defect("M10", f"{source.type} {source.name}: keys go backwards: read in ascending order", source)
        order = np.argsort(keys, kind="stable")
        keys, values = keys[order], values[order]
    values = values.copy()
    if width == 4:
        values[:, 3] *= reading.angle
    elif field in {"translation", "center", "point"}:
        values *= reading.length
    interval = reading.number(timer, "cycleInterval", 1.0)
    if interval <= 0:
        reading.defect("M09", f"TimeSensor {timer.name}: cycleInterval {interval:g} is read as 1 s", timer)
        interval = 1.0
    return Track("", field, keys, _unit(values) if width == 4 else values, interval, _loops(reading, timer), timer.name)


def _unit(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations with unit axes; a zero axis means no rotation."""
    size = np.linalg.norm(values[:, :3], axis=1, keepdims=True)
    values[:, :3] = np.where(size > 0, values[:, :3] / np.where(size > 0, size, 1), [0.0, 0.0, 1.0])
    values[:, 3] = np.where(size[:, 0] > 0, values[:, 3], 0.0)
    return values


def _loops(reading: Reading, timer: Node) -> bool:
    return reading.flag(timer, "loop", False)


def _timer(reading: Reading, node: Node, into: dict[str, list[Route]], defs: dict[str, Node]) -> Node | None:
    """The TimeSensor whose fraction drives an interpolator, through a chain of other nodes if need be."""
    level, seen = [node], {id(node)}
    for depth in range(_CHAIN):
        above: list[Node] = []
        for n in level:
            for route in into.get(n.name, []):
                if depth == 0 and event(route.to_field) != "fraction":
                    continue
                source = defs.get(route.from_node)
                if source is None or id(source) in seen:
                    continue
                seen.add(id(source))
                if source.type == "TimeSensor" and event(route.from_field) == "fraction":
                    if depth:
                        what = f"{node.type} {node.name} is driven through {n.type} {n.name}: read as driven directly"
                        reading.defect("M22", what, node)
                    return source
                above.append(source)
        level = above
    return None
