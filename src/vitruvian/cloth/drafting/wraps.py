"""Garments of rectangles, as in antiquity: the tunic, and a cloth that is pinned on one shoulder."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vitruvian.cloth.drafting.figure import figure, number
from vitruvian.cloth.drafting.pieces import ARMS, BACK, FRONT, Line, Piece, join, piece
from vitruvian.cloth.drafting.tops import HEAD
from vitruvian.cloth.pattern import Pattern, Seam
from vitruvian.errors import VitruvianError


def tunic(
    measures: Mapping[str, float],
    *,
    ease: float = 0.3,
    length: float | None = None,
    width: float | None = None,
    heights: Mapping[str, float] | None = None,
) -> Pattern:
    """A Roman tunic: two rectangles sewn along the shoulders, but for a slit for the head, and along the sides up to the
    openings for the arms.

    ease: of the widest of chest, waist and hips; width: of each rectangle (None: to the elbows or what ease asks for);
    length: from the shoulders (None: to the knees).
    """
    f = figure(measures, heights)
    ease = number("ease", ease, 0.05, 1.5)
    need = 0.5 * (max(f["chest"], f["waist"], f["hips"]) + ease)
    elbows = f["shoulder_width"] + 0.75 * f["arm_length"] * float(np.cos(ARMS))
    wide = number("width", max(need, elbows) if width is None else width, need - 1e-9, 2.5)
    top = f.nape + 0.03
    long = number("length", top - f.knee if length is None else length, 0.4 * top, 0.98 * top)
    slit = 0.5 * (HEAD * f["height"] + 0.04)
    share = 0.5 * (1 - slit / wide)
    if share * wide < 0.03:
        raise VitruvianError("tunic: the head's slit leaves no shoulder; give more width")
    # deep enough for the arm, which hangs down at the side, and wide enough for its girth
    hole = max(0.5 * wide - f["shoulder_width"] / 2, 0.0) * float(np.tan(ARMS)) + 0.6 * f["upper_arm"] + 0.06
    if hole > 0.6 * long:
        raise VitruvianError("tunic: the openings for the arms leave no sides; give less width or more length")
    half = 0.5 * wide
    slot = share * wide
    lines = [
        Line("right_shoulder", (-half, 0.0)),
        Line("neck", (slot - half, 0.0), (), "left_collar"),
        Line("left_shoulder", (half - slot, 0.0)),
        Line("left_opening", (half, 0.0)),
        Line("left_side", (half, -hole)),
        Line("hem", (half, -long)),
        Line("right_side", (-half, -long)),
        Line("right_opening", (-half, -hole)),
    ]
    made = [piece(n, lines, face, (0.0, top, face * 0.16)) for n, face in (("front", FRONT), ("back", BACK))]
    seams = [join(made[0], f"{s}_{n}", made[1]) for s in ("left", "right") for n in ("shoulder", "side")]
    return Pattern("tunic", tuple(p.panel for p in made), tuple(seams), measures=dict(f.measures))


def toga(
    measures: Mapping[str, float],
    *,
    ease: float = 0.5,
    length: float | None = None,
    pin: float = 0.12,
    heights: Mapping[str, float] | None = None,
) -> Pattern:
    """A rectangle of cloth wrapped around the body and pinned over the left shoulder, as an exomis: the right shoulder
    and arm stay free.

    It is cut in a front and a back, so that it can be hung: seams join them along `pin` metres of the left shoulder and
    down both sides from below the arms. ease: of the widest girth; length: from the shoulder (None: to below the knees).
    """
    f = figure(measures, heights)
    ease, pin = number("ease", ease, 0.1, 2.0), number("pin", pin, 0.03, 0.4)
    wide = 0.5 * (max(f["chest"], f["waist"], f["hips"]) + ease)
    top = f.nape + 0.02
    long = number("length", top - 0.75 * f.knee if length is None else length, 0.5 * top, 0.98 * top)
    half, shoulder = 0.5 * wide, f["shoulder_width"] / 2
    pin = min(pin, 0.8 * shoulder)
    hole = max(half - shoulder, 0.0) * float(np.tan(ARMS)) + 0.6 * f["upper_arm"] + 0.06
    lines = [
        Line("top", (half, 0.0), (), "strapless_top"),
        Line("right", (-half, 0.0)),
        Line("hem", (-half, -long)),
        Line("left", (half, -long)),
    ]
    made = [piece(n, lines, face, (0.0, top, face * 0.16)) for n, face in (("front", FRONT), ("back", BACK))]
    front, back = made
    # both tops begin at the left and at the right: the pin sits between the neck and the tip of the left shoulder
    near, far = (half - shoulder) / wide, (half - shoulder + pin) / wide
    seams = [_part(front, back, "top", "left", near, far)]
    seams += [_part(front, back, "left", "bottom", 0.0, 1 - hole / long)]
    seams += [_part(front, back, "right", "bottom", 0.0, 1 - hole / long)]
    return Pattern("toga", tuple(p.panel for p in made), tuple(seams), measures=dict(f.measures))


def _part(front: Piece, back: Piece, name: str, start: str, low: float, high: float) -> Seam:
    """Two equal edges sewn from `low` to `high` of their length, counted from the left end or from the bottom."""
    spans = []
    for who in (front, back):
        edge = who.panel.edges[who.edge(name)]
        a, b = who.panel.vertices[edge.start], who.panel.vertices[edge.end]
        onward = a[0] > b[0] if start == "left" else a[1] < b[1]
        spans.append(who.span(name, low, high) if onward else who.span(name, 1 - high, 1 - low))
    return Seam((spans[0],), (spans[1],))
