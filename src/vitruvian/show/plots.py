"""Plots as SVG: angles of joints over time against their limits, and any other lines over time."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.errors import VitruvianError
from vitruvian.motion.limits import angles, boxes
from vitruvian.motion.types import Motion

# Okabe and Ito's colours, which colour-blind people tell apart
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
WIDE, HIGH, LEFT, TOP, GAP = 560.0, 120.0, 64.0, 40.0, 46.0
MOST = 2000  # points of a line


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes: lines (F,) by name, bands (low, high) of the same colours, a unit."""

    title: str
    lines: Mapping[str, Floats]
    bands: Mapping[str, tuple[float, float]]
    unit: str


def angle_panels(motion: Motion, joints: Sequence[str] | None = None) -> list[Panel]:
    """A panel of angles (degrees) against the limits for each of `joints` (None: all that turn and have limits)."""
    skeleton = motion.skeleton
    box, angle = np.degrees(boxes(skeleton)), np.degrees(angles(skeleton, motion.rotation))
    if joints is None:
        limited = np.isfinite(box).any(axis=(1, 2))
        moves = np.ptp(angle, axis=0).max(axis=1) > 1.0
        joints = [n for n, show in zip(skeleton.names, limited & moves, strict=True) if show]
    panels = []
    for name in joints:
        if name not in skeleton.index:
            raise VitruvianError(f"joints: the clip has no joint {name!r}; it has {', '.join(skeleton.names[:8])}, ...")
        j = skeleton.index[name]
        lines = {axis: np.unwrap(angle[:, j, k], period=360.0) for k, axis in enumerate("XYZ")}
        bands = {axis: (float(box[j, k, 0]), float(box[j, k, 1])) for k, axis in enumerate("XYZ")}
        panels.append(Panel(name, lines, bands, "degrees"))
    return panels


def residual_panels(names: Sequence[str], residual: Floats) -> list[Panel]:
    """How far markers (M,) are off over time, residual (F,M) in metres, NaN where one is missing; the worst ones first.

    The first panel has the root mean square of all markers, each other one six markers, with their own as a dashed line.
    """
    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # frames and markers without a single point
        every = 1000 * np.sqrt(np.nanmean(residual**2, axis=1))
        each = 1000 * np.sqrt(np.nanmean(residual**2, axis=0))
    panels = [Panel("root mean square of all markers", {"all": every}, {}, "mm")]
    order = [int(k) for k in np.argsort(-np.nan_to_num(each, nan=-1.0), kind="stable") if np.isfinite(each[k])]
    for first in range(0, len(order), len(COLORS)):
        some = order[first : first + len(COLORS)]
        lines = {names[k]: 1000 * residual[:, k] for k in some}
        bands = {names[k]: (float(each[k]), float(each[k])) for k in some}
        panels.append(Panel("markers" if first else "markers, the worst first", lines, bands, "mm"))
    return panels


def svg(panels: Sequence[Panel], seconds: Floats, title: str) -> str:
    """Panels one below the other over common seconds (F,), as an SVG document."""
    high = TOP + len(panels) * (HIGH + GAP) + 20
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDE + LEFT + 90:.0f}" height="{high:.0f}" '
        f'viewBox="0 0 {WIDE + LEFT + 90:.0f} {high:.0f}" font-family="sans-serif" font-size="11">',
        '<rect width="100%" height="100%" fill="white"/>',
        f'<text x="{LEFT}" y="22" font-size="15">{escape(title)}</text>',
    ]
    for number, panel in enumerate(panels):
        out += _panel(panel, np.asarray(seconds, dtype=np.float64), TOP + number * (HIGH + GAP) + 14)
    return "\n".join([*out, "</svg>\n"])


def _panel(panel: Panel, seconds: Floats, top: float) -> list[str]:
    values = np.concatenate([line[np.isfinite(line)] for line in panel.lines.values()] or [np.zeros(1)])
    if not len(values):
        values = np.zeros(1)
    low, high = float(values.min()), float(values.max())
    for floor, ceiling in panel.bands.values():  # limits near the lines belong in the picture
        low, high = (
            (min(low, floor) if floor > low - 40 else low),
            (max(high, ceiling) if ceiling < high + 40 else high),
        )
    ticks = _ticks(low, high)
    low, high = min(low, ticks[0]), max(high, ticks[-1])
    span = max(high - low, 1e-12)
    start, length = float(seconds[0]), max(float(seconds[-1] - seconds[0]), 1e-12)

    def x(t: Any) -> Any:
        return LEFT + (t - start) / length * WIDE

    def y(v: Any) -> Any:
        return top + (high - v) / span * HIGH

    out = [
        f'<text x="{LEFT}" y="{top - 4:.1f}" font-weight="bold">{escape(panel.title)}</text>',
        f'<rect x="{LEFT}" y="{top:.1f}" width="{WIDE}" height="{HIGH}" fill="#f6f6f6"/>',
    ]
    for tick in ticks:
        out.append(f'<line x1="{LEFT}" x2="{LEFT + WIDE}" y1="{y(tick):.1f}" y2="{y(tick):.1f}" stroke="#ddd"/>')
        out.append(f'<text x="{LEFT - 6}" y="{y(tick) + 4:.1f}" text-anchor="end">{tick:g}</text>')
    middle = top + HIGH / 2
    turned = f'transform="rotate(-90 16 {middle:.1f})"'
    out.append(f'<text x="16" y="{middle:.1f}" text-anchor="middle" {turned}>{escape(panel.unit)}</text>')
    for tick in _ticks(start, start + length):
        out.append(f'<text x="{x(tick):.1f}" y="{top + HIGH + 14:.1f}" text-anchor="middle">{tick:g}</text>')
    out.append(f'<text x="{LEFT + WIDE + 8}" y="{top + HIGH + 14:.1f}">s</text>')
    for number, (name, line) in enumerate(panel.lines.items()):
        color = COLORS[number % len(COLORS)]
        for limit in panel.bands.get(name, ()):
            if np.isfinite(limit) and low <= limit <= high:
                out.append(
                    f'<line x1="{LEFT}" x2="{LEFT + WIDE}" y1="{y(limit):.1f}" y2="{y(limit):.1f}" stroke="{color}" '
                    'stroke-dasharray="5 4"/>'
                )
        step = max(1, len(line) // MOST)
        some = np.isfinite(line[::step])
        for run in np.split(np.flatnonzero(some), np.flatnonzero(np.diff(np.flatnonzero(some)) > 1) + 1):
            if len(run):
                points = zip(x(seconds[::step][run]), y(line[::step][run]), strict=True)
                path = " ".join(f"{a:.1f},{b:.1f}" for a, b in points)
                out.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="1.5"/>')
        out.append(
            f'<text x="{LEFT + WIDE + 12}" y="{top + 12 + 15 * number:.1f}" fill="{color}">{escape(name)}</text>'
        )
    return out


def _ticks(low: float, high: float) -> Floats:
    """Three to seven round numbers in a range."""
    span = max(high - low, 1e-9)
    step = 10 ** np.floor(np.log10(span / 3))
    step *= next(f for f in (1, 2, 5, 10) if span / (step * f) <= 6)
    return np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1) * step + 0.0  # no -0
