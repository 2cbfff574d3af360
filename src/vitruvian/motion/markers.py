"""Markers: where a tracker saw points over time, before there is a skeleton.

Files of markers seldom say all of unit, up axis and rate. What they leave out is found from the figure and noted, or
asked for when the figure does not tell. Source: note motion.md, sections 3.3 to 3.5.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from vitruvian.body.rotations import rotate
from vitruvian.body.types import Floats, floats, require
from vitruvian.errors import VitruvianError, warn
from vitruvian.motion.turns import positions, world_rotations
from vitruvian.motion.types import Motion

# Metres per unit, by the words that files use.
UNITS = {
    "m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0, "dm": 0.1, "cm": 0.01, "centimeters": 0.01,
    "centimetres": 0.01, "mm": 0.001, "millimeters": 0.001, "millimetres": 0.001, "in": 0.0254, "inch": 0.0254,
    "inches": 0.0254, "ft": 0.3048, "feet": 0.3048,
}  # fmt: skip
UP_AXES = ("x", "y", "z", "-x", "-y", "-z")
FARTHEST = 1e9  # units of the file; what is farther away was not measured
_HIGH = re.compile(r"head|crown|vertex|[lr]?[fb]hd\b|c7\b|acromi|sternum|clav|sho(ulder)?\b", re.IGNORECASE)
_LOW = re.compile(r"heel|toe|foot|ankle|malleol|calc|midfoot|\bmt\d|[lr](ank|hee)\b", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Markers:
    """Trajectories of named points.

    names (M,). points (F,M,3): metres, Y up, NaN where a marker was not seen. fps: frames per second.
    first: the number that the file gives to its first frame. start: the time of that frame, s.
    unit: metres per unit of the file; up: the file's up axis, one of `UP_AXES`; both only say what it was.
    events: (seconds, name). analog: channel -> (S,) samples in the file's own units, `analog_fps` a second.
    notes: what the reader had to find or decide, one line each.
    """

    names: tuple[str, ...]
    points: Floats
    fps: float
    first: int = 1
    start: float = 0.0
    unit: float = 1.0
    up: str = "y"
    events: tuple[tuple[float, str], ...] = ()
    analog: dict[str, Floats] = field(default_factory=dict)
    analog_fps: float = 0.0
    name: str = ""
    notes: tuple[str, ...] = ()
    prefixes: tuple[str, ...] = ()  # of the people in it, where the file says so itself

    def __post_init__(self) -> None:
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        put("names", tuple(self.names))
        require(len(self.names) > 0, "names", "at least one marker", 0)
        require(len(set(self.names)) == len(self.names), "names", "unique names", "one that occurs twice")
        require(np.isfinite(self.fps) and self.fps > 0, "fps", "a positive number", self.fps)
        points = np.ascontiguousarray(self.points, dtype=np.float64)
        fits = points.ndim == 3 and points.shape[1:] == (len(self.names), 3)
        require(fits, "points", f"shape ('n', {len(self.names)}, 3)", points.shape)
        require(not np.isinf(points).any(), "points", "numbers or NaN", "an infinite one")
        unseen = np.isnan(points).any(axis=2)
        if unseen.any():  # one missing coordinate: the point was not seen
            points = points.copy()
            points[unseen] = np.nan
        put("points", points)
        require(self.up in UP_AXES, "up", " ".join(UP_AXES), self.up)
        for channel, values in self.analog.items():
            floats(values, f"analog[{channel}]", None)

    def __len__(self) -> int:
        return len(self.points)

    @property
    def seconds(self) -> float:
        """Duration: frames / fps."""
        return len(self) / self.fps

    @cached_property
    def missing(self) -> Floats:
        """(M,) the share of frames in which each marker was not seen, 0 to 1."""
        return np.isnan(self.points[..., 0]).mean(axis=0) if len(self) else np.zeros(len(self.names))

    @cached_property
    def actors(self) -> dict[str, list[int]]:
        """Who is in the capture: prefix of labels -> their markers. One person without a prefix is {}."""
        found: dict[str, list[int]] = {}
        for m, name in enumerate(self.names):
            said = next((p for p in self.prefixes if p and name.startswith(p)), None)
            head, colon, _ = name.rpartition(":")
            if said is not None or (colon and not self.prefixes):
                found.setdefault((said if said is not None else head).rstrip(":_"), []).append(m)
        return {who: index for who, index in found.items() if len(index) >= 3}


def chosen(markers: Markers, actor: str | None) -> Markers:
    """The markers of one person, without their prefix; all of them for "*" or where there is but one person.

    Raises VitruvianError that lists who is there when there are several and `actor` names none of them.
    """
    there = markers.actors
    if actor == "*" or (actor is None and len(there) < 2):
        return markers
    listed = (
        ", ".join(f"{who} ({len(index)} markers)" for who, index in there.items()) or "nobody by a prefix of labels"
    )
    if actor is None:
        raise VitruvianError(f"holds {len(there)} people: {listed[:200]}; say which: actor=NAME")
    if actor not in there:
        raise VitruvianError(f"actor: expected one of the people in it, {listed[:200]}; found {actor[:40]!r}")
    index = there[actor]
    names = [re.sub(rf"^{re.escape(actor)}[:_]?", "", markers.names[m]) for m in index]
    kept = [n if n else markers.names[m] for n, m in zip(names, index)]
    others = len(markers.names) - len(index)
    notes = (*markers.notes, f"actor {actor}: {len(index)} markers, {others} of others left out")
    points = markers.points[:, index]
    return replace(markers, names=tuple(kept), points=points, prefixes=(), notes=notes)


def to_y_up(points: Floats, up: str) -> Floats:
    """Points (...,3) in axes whose `up` points upwards, in ours: Y up. Exact: axes change places."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    turned = {"y": (x, y, z), "-y": (x, -y, -z), "z": (x, z, -y), "-z": (x, -z, y), "x": (-y, x, z), "-x": (y, -x, z)}
    return np.stack(turned[up], axis=-1)


def from_y_up(points: Floats, up: str) -> Floats:
    """The inverse of `to_y_up`."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    turned = {"y": (x, y, z), "-y": (x, -y, -z), "z": (x, -z, y), "-z": (x, z, -y), "x": (y, -x, z), "-x": (-y, x, z)}
    return np.stack(turned[up], axis=-1)


def measured(
    names: Sequence[str],
    raw: Floats,
    fps: float,
    *,
    unit: float | str | None = None,
    up: str | None = None,
    said_unit: str | None = None,
    said_up: str | None = None,
    why_up: str = "the file says so",
    actor: str | None = None,
    notes: Sequence[str] = (),
    prefixes: Sequence[str] = (),
    **rest: object,
) -> Markers:
    """Markers from the numbers (F,M,3) of a file: `unit` and `up` as asked for, as the file says, or as found.

    Raises VitruvianError when nobody says them and the figure does not tell, or when there are several people and
    `actor` does not choose.
    """
    names = _unique(names)
    axis, why = (said_up, f"up axis {said_up.upper()}: {why_up}") if said_up and not up else _up_axis(names, raw, up)
    scale, why_unit = _metres(to_y_up(raw, axis), unit, said_unit)
    points = to_y_up(raw * scale, axis)
    told = tuple([why_unit, why, *notes])
    whole = Markers(
        tuple(names), points, fps, unit=scale, up=axis, notes=told, prefixes=tuple(prefixes), **rest  # type: ignore[arg-type]
    )  # fmt: skip
    return chosen(whole, actor)


def _unique(names: Sequence[str]) -> list[str]:
    out: list[str] = []
    seen: set[str] = set()
    again: dict[str, int] = {}
    for name in names:
        new = name
        while new in seen:
            again[name] = again.get(name, 1) + 1
            new = f"{name}_{again[name]}"
        seen.add(new)
        out.append(new)
    if again:
        warn(f"the label {next(iter(again))[:40]!r} is used more than once: the later ones get a number")
    return out


def metres_per(unit: float | str) -> float:
    """Metres per unit from a number or a word. Raises VitruvianError."""
    scale = UNITS.get(unit.strip().lower(), 0.0) if isinstance(unit, str) else float(unit)
    if not 0 < scale < 1e6:
        raise VitruvianError(f"unit: expected metres per unit above zero or one of m, dm, cm, mm, in, found {unit!r}")
    return scale


def _metres(upright: Floats, unit: float | str | None, said: str | None) -> tuple[float, str]:
    """Metres per unit of the file, and why."""
    if unit is not None:
        scale = metres_per(unit)
        return scale, f"unit {scale:.6g} m: as asked for"
    if said and said.strip().lower() in UNITS:
        return UNITS[said.strip().lower()], f"unit {UNITS[said.strip().lower()]:.6g} m: the file says {said.strip()}"
    height = float(_extents(upright)[1])
    good = {u: UNITS[u] for u in ("m", "cm", "mm", "in") if 0.9 <= UNITS[u] * height <= 2.4}
    if not good:
        told = f"{said.strip()[:20]!r}, which is no known unit" if said and said.strip() else "none"
        raise VitruvianError(
            f"unit: the file says {told}, and no common one makes markers {height:.4g} units high a person; "
            "say unit=m, cm, mm or in"
        )
    best = min(good, key=lambda u: abs(good[u] * height - 1.6))
    return good[
        best
    ], f"unit {good[best]:.6g} m ({best}): the markers reach {good[best] * height:.2f} m from low to high"


def _up_axis(names: Sequence[str], raw: Floats, up: str | None) -> tuple[str, str]:
    """The file's up axis, and why."""
    if up is not None:
        axis = up.lower().lstrip("+")
        if axis not in UP_AXES:
            raise VitruvianError(f"up: expected x, y or z, - before it for downwards, found {up!r}")
        return axis, f"up axis {axis.upper()}: as asked for"
    high = [m for m, n in enumerate(names) if _HIGH.search(n)]
    low = [m for m, n in enumerate(names) if _LOW.search(n) and m not in high]
    if high and low:
        spine = _mean(raw[:, high]) - _mean(raw[:, low])
        if np.isfinite(spine).all() and np.abs(spine).max() > max(0.8 * float(np.linalg.norm(spine)), 1e-300):
            along = int(np.argmax(np.abs(spine)))
            letter = ("-" if spine[along] < 0 else "") + "xyz"[along]
            return letter, f"up axis {letter.upper()}: from {names[low[0]]} to {names[high[0]]} and their like"
    size = _extents(raw)
    order = [int(k) for k in np.argsort(size)]
    if not size[order[2]] > 1.4 * size[order[1]]:
        raise VitruvianError(
            "up: the file does not say which axis is up and the markers do not show it; say up=y or up=z"
        )
    letter = "xyz"[order[2]]
    return letter, f"up axis {letter.upper()}: the markers reach farthest along it, taken to be upwards"


def _mean(points: Floats) -> Floats:
    """(3,) of all that was seen, NaN when nothing was."""
    seen = points[~np.isnan(points).any(axis=-1)]
    return seen.mean(axis=0) if len(seen) else np.full(3, np.nan)


def _extents(raw: Floats) -> Floats:
    """(3,) the median over at most 64 frames of how far markers reach along each axis."""
    pick = raw[np.unique(np.linspace(0, max(len(raw) - 1, 0), min(64, len(raw))).astype(int))]
    sizes = []
    for frame in pick:
        seen = frame[~np.isnan(frame).any(axis=-1)]
        if len(seen) >= 3:
            sizes.append(np.ptp(seen, axis=0))
    return np.median(sizes, axis=0) if sizes else np.zeros(3)


def markers_of(motion: Motion) -> Markers:
    """What a tracker would see of a motion: the centres of all joints and its Sites, exactly."""
    s = motion.skeleton
    world = world_rotations(s.parents, motion.rotation)
    place = positions(s.parents, s.centers, world, motion.translation, motion.joint_translation)
    arms = s.site_points - s.centers[s.site_joints]
    sites = place[:, s.site_joints] + rotate(world[:, s.site_joints], arms)
    names = [*s.names, *s.site_names]
    notes = (*motion.notes, f"{len(s)} joint centres and {len(s.site_names)} Sites as markers")
    points = np.concatenate([place, sites], axis=1)
    return Markers(tuple(_unique(names)), points, motion.fps, name=motion.name, notes=notes)


@dataclass(frozen=True, eq=False)
class Storage:
    """A table over time: columns (C,), times (F,) s, values (F,C) as they stand in the file, NaN for gaps.

    degrees: angles are in degrees (else radians; None: nobody says). fps: rows per second, 0 for a single row.
    """

    columns: tuple[str, ...]
    times: Floats
    values: Floats
    degrees: bool | None = None
    fps: float = 0.0
    name: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", floats(self.times, "times", None))
        values = np.ascontiguousarray(self.values, dtype=np.float64)
        require(values.shape == (len(self.times), len(self.columns)), "values", "a row per time", values.shape)
        object.__setattr__(self, "values", values)

    def __len__(self) -> int:
        return len(self.times)
