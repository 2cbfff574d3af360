"""HAnimMotions of a figure whose file pose is baked away (P01): the same movement about joints at rest.

As for interpolators (see `doctor_fix_pose`), the turn R(t) and shift t(t) of joint j under p become
R_p R(t) R_j^-1 R_p^-1 and R_p (t(t) - t_j). A turn of fewer than three channels gets all three, since its axis is
another one now. Meaning of the channels: note hanim.md, 5.
"""

from __future__ import annotations

import numpy as np

from vitruvian.hanim import tables
from vitruvian.hanim.animation import channel_groups
from vitruvian.hanim.doctor import Floats
from vitruvian.hanim.doctor_figure import Figure
from vitruvian.hanim.doctor_motion import motions
from vitruvian.hanim.doctor_space import at_rest, matrix, vector
from vitruvian.hanim.graph import Node

_ORDER = "ZXY"
_STILL = 1 - 1e-12


def rebuilt(figure: Figure, poses: dict[int, Floats]) -> list[tuple[Node, dict[str, object]]] | None:
    """New fields of the figure's HAnimMotions, None when one of them can't be carried over.

    poses: node id -> (4,4) what the file's pose does to all that a joint carries.
    """
    out = []
    for motion in motions(figure):
        if len(figure.chart.numbers(motion, "values")):
            fields = _fields(figure, motion, poses)
            if fields is None:
                return None
            out.append((motion, fields))
    return out


def _fields(figure: Figure, motion: Node, poses: dict[int, Floats]) -> dict[str, object] | None:
    chart = figure.chart
    groups = channel_groups(chart.names(motion, "channels"))
    joints, flat = chart.names(motion, "joints"), chart.numbers(motion, "values")
    width = sum(len(g) for g in groups or ())
    if groups is None or len(groups) != len(joints) or not width or len(flat) % width or not np.isfinite(flat).all():
        return None
    values = flat.reshape(-1, width)
    flags = _flags([w.lower() in {"true", "1"} for w in chart.names(motion, "channelsEnabled")], groups)
    by_name = {n: j for j in figure.joints for n in (figure.name(j), tables.canonical(figure.name(j))) if n}
    channels, columns, enabled, at = [], [], [], 0
    for name, group, on in zip(joints, groups, flags):
        own, part = values[:, at : at + len(group)], group
        at += len(group)
        joint = None if name == "IGNORED" else by_name.get(name, by_name.get(tables.canonical(name) or ""))
        if joint is not None:
            above, rest = _around(figure, joint, poses)
            if not (np.array_equal(above, np.eye(3)) and np.array_equal(rest, np.eye(4))):
                kinds = {c[1:].lower() for c in group}
                scaled = any(np.abs(m @ m.T - np.eye(3)).max() > 1e-6 for m in (above, rest[:3, :3]))
                if scaled or not kinds <= {"rotation", "position"} or len(set(on)) > 1:
                    return None
                part, own = _turned(group, own, above, rest[:3, :3], vector(chart, joint, "translation"))
        channels.append(part)
        columns.append(own)
        enabled += [on[0] if on else True] * len(part) if part is not group else on
    fields: dict[str, object] = {
        "channels": " ".join(f"{len(g)} {' '.join(g)}" for g in channels),
        "values": np.concatenate(columns, axis=1).reshape(-1),
    }
    given = chart.names(motion, "channelsEnabled")
    if given and len(given) != len(groups):  # one per channel, of which there may be more now
        fields["channelsEnabled"] = np.array(enabled, bool)
    return fields


def _flags(given: list[bool], groups: list[tuple[str, ...]]) -> list[list[bool]]:
    """One flag per channel and group, of flags per group, per channel or none."""
    if len(given) == len(groups):
        return [[on] * len(g) for on, g in zip(given, groups)]
    given = given + [True] * sum(len(g) for g in groups)
    out, at = [], 0
    for group in groups:
        out.append(given[at : at + len(group)])
        at += len(group)
    return out


def _around(figure: Figure, joint: Node, poses: dict[int, Floats]) -> tuple[Floats, Floats]:
    """How the joint's parent is turned (3,3) and the joint's own pose (4,4)."""
    holder = figure.parent[id(joint)]
    above = poses[id(holder)][:3, :3] if holder is not None else np.eye(3)
    return above, np.eye(4) if at_rest(figure.chart, joint) else matrix(figure.chart, joint)


def _turned(
    group: tuple[str, ...], values: Floats, above: Floats, rest: Floats, shift: Floats
) -> tuple[tuple[str, ...], Floats]:
    """A joint's channels and their columns (n,k) about its new rest."""
    names: list[str] = []
    columns: list[Floats] = []
    places = [(c[0].upper(), values[:, k]) for k, c in enumerate(group) if c[1:].lower() == "position"]
    if places:
        moved = np.repeat(shift[None], len(values), axis=0)
        for letter, column in places:
            moved[:, "XYZ".index(letter)] = column
        names += [f"{c}position" for c in "XYZ"]
        columns += list(((moved - shift) @ above.T).T)
    turns = [(c[0].upper(), values[:, k]) for k, c in enumerate(group) if c[1:].lower() == "rotation"]
    if turns:
        linear = np.repeat(np.eye(3)[None], len(values), axis=0)
        for letter, degrees in turns:
            linear = linear @ _about("XYZ".index(letter), np.radians(degrees))
        order = "".join(c for c, _ in turns)
        order = order if sorted(order) == ["X", "Y", "Z"] else _ORDER
        names += [f"{c}rotation" for c in order]
        columns += list(_angles(above @ linear @ rest.T @ above.T, order).T)
    return tuple(names), np.stack(columns, axis=1) if columns else values[:, :0]


def _about(axis: int, angle: Floats) -> Floats:
    """(n,3,3) turns about a main axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out = np.zeros((len(angle), 3, 3))
    out[:, axis, axis] = 1.0
    out[:, i, i] = out[:, j, j] = np.cos(angle)
    out[:, j, i] = np.sin(angle)
    out[:, i, j] = -out[:, j, i]
    return out


def _angles(turn: Floats, order: str) -> Floats:
    """(n,3) degrees, continuous, with turn (n,3,3) = R_first R_second R_third about three different main axes."""
    i, j, k = ("XYZ".index(c) for c in order)
    even = 1.0 if (j - i) % 3 == 1 else -1.0
    sine = np.clip(even * turn[:, i, k], -1, 1)
    locked = np.abs(sine) > _STILL
    first = np.where(
        locked,
        np.arctan2(even * turn[:, k, j], turn[:, j, j]),
        np.arctan2(-even * turn[:, j, k], turn[:, k, k]),
    )
    third = np.where(locked, 0.0, np.arctan2(-even * turn[:, i, j], turn[:, i, i]))
    return np.degrees(np.unwrap(np.stack([first, np.arcsin(sine), third], axis=1), axis=0))
