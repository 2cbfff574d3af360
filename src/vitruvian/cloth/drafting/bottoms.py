"""Garments from the waist down: trousers, the straight skirt and the circle skirt."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vitruvian.cloth.drafting.figure import Figure, figure, number
from vitruvian.cloth.drafting.pieces import (
    BACK,
    FRONT,
    Line,
    Piece,
    curve,
    dart,
    darted,
    join,
    mirrored,
    piece,
    shared,
    solved,
    unfolded,
)
from vitruvian.cloth.pattern import Pattern, Seam
from vitruvian.errors import VitruvianError

GORES = 0.45  # of a full ring: wider skirts are cut in four
STEEPEST = np.radians(55.0)  # that their parts lean out before they are sewn
WAIST = "lower_interface"  # the edge that a garment without shoulders hangs by
Point = tuple[float, float]


def _waists(piece_: Piece) -> list[str]:
    return [n for n in piece_.names if "waist" in n]


def _darts(piece_: Piece) -> list[Seam]:
    return [dart(piece_, n[:-2]) for n in piece_.names if "dart" in n and n.endswith("_a")]


def _bands(fronts: list[Piece], backs: list[Piece], at: Figure, height: float, depth: float) -> tuple[list, list[Seam]]:
    """A waistband of two pieces, above the waist by its height, sewn to the waists of the pieces below and at the sides."""
    made: list[Piece] = []
    seams = []
    for name, below, face in (("front_band", fronts, FRONT), ("back_band", backs, BACK)):
        widths = {who.panel.name: who.length(*_waists(who)) for who in below}
        half = 0.5 * sum(widths.values())
        if len(below) == 1:
            low = [Line("low", (-half, 0.0))]
        else:
            low = [Line("r_low", (-half, 0.0)), Line("l_low", (0.0, 0.0))]
        lines = [*low, Line("left", (half, 0)), Line("top", (half, height), (), WAIST), Line("right", (-half, height))]
        band = piece(name, lines, face, (0.0, at.waist, face * depth))
        made.append(band)
        if len(below) == 1:
            seams.append(join(below[0], _waists(below[0]), band, "low"))
        else:
            seams += [join(w, _waists(w), band, "l_low" if "left" in w.panel.name else "r_low") for w in below]
    seams += [join(made[0], side, made[1]) for side in ("left", "right")]
    return made, seams


def trousers(
    measures: Mapping[str, float],
    *,
    ease: float = 0.06,
    waist_ease: float = 0.02,
    length: float | None = None,
    knee: float | None = None,
    hem: float | None = None,
    band: float = 0.04,
    heights: Mapping[str, float] | None = None,
) -> Pattern:
    """Trousers: two fronts, two backs with darts, a waistband (`band` metres high; 0: none).

    ease: of the hips; waist_ease; length: of the inseam (None: to just above the ground); knee and hem: girths there.
    The back's fork is lowered until both inseams are equally long.
    """
    f = figure(measures, heights)
    ease, waist_ease = number("ease", ease, 0.0, 0.6), number("waist_ease", waist_ease, 0.0, 0.3)
    band = number("band", band, 0.0, 0.15)
    inside = number("length", 0.93 * f["inseam"] if length is None else length, 0.1, f.crotch)
    around_knee = max(0.72 * f["thigh"], f["calf"] + 0.05) if knee is None else knee
    around_hem = max(0.88 * around_knee, 0.2 * f["height"]) if hem is None else hem
    around_knee, around_hem = number("knee", around_knee, 0.15, 2.0), number("hem", around_hem, 0.15, 2.0)
    lines = _legs(f, ease, waist_ease, inside, around_knee, around_hem)
    pieces = {}
    for name, face in (("front", FRONT), ("back", BACK)):
        apart = 0.012 - min(line.at[0] for line in lines[name])
        for side, sign in (("left", 1), ("right", -1)):
            drawn = lines[name] if sign > 0 else mirrored(lines[name])
            place = (sign * apart, f.waist, face * 0.12)
            pieces[side, name] = piece(f"{side}_{name}", drawn, face, place, label="leg")
    seams = []
    for side in ("left", "right"):
        front, back = pieces[side, "front"], pieces[side, "back"]
        shared_edges = [n for n in front.names if n.startswith(("side", "in"))]
        seams += [join(front, n, back) for n in shared_edges]
        seams += _darts(front) + _darts(back)
    for name in ("front", "back"):
        seams += [join(pieces["left", name], n, pieces["right", name]) for n in ("crotch", "rise")]
    every = list(pieces.values())
    if band:
        fronts, backs = ([pieces[s, n] for s in ("left", "right")] for n in ("front", "back"))
        bands, more = _bands(fronts, backs, f, band, 0.12)
        every, seams = every + bands, seams + more
    return Pattern("trousers", tuple(p.panel for p in every), tuple(seams), measures=dict(f.measures))


def _legs(f: Figure, ease: float, waist_ease: float, inside: float, knee: float, hem: float) -> dict[str, list[Line]]:
    """Outlines of the left front and back, u = 0 in the middle of the body, v = 0 at the waist."""
    quarter = (f["hips"] + ease) / 4
    hips, crotch = f.hips - f.waist, f.crotch - f.waist - 0.012
    wide = {"front": quarter - 0.01, "back": quarter + 0.01}
    fork = {"front": 0.05 * f["hips"], "back": 0.105 * f["hips"]}
    lacking = max(0.0, f["thigh"] + 0.05 - sum(wide.values()) - sum(fork.values()))
    fork = {name: x + 0.5 * lacking for name, x in fork.items()}
    tops: dict[str, Point] = {"front": (0.01, 0.0), "back": (0.03, 0.02)}
    low, middle = crotch - inside, crotch - 0.44 * inside
    # the sides of front and back have one shape, so that they are equally long
    crease = 0.5 * (wide["front"] - fork["front"])
    out = {
        "hips": 0.0,
        "knee": crease + knee / 4 - 0.005 - wide["front"],
        "hem": crease + hem / 4 - 0.005 - wide["front"],
    }

    def waists(shift: float) -> float:
        return sum(float(np.hypot(wide[n] - shift - tops[n][0], tops[n][1])) for n in tops)

    target = (f["waist"] + waist_ease) / 2
    spare = waists(0.0) - target
    if spare > 0:
        shift = min(0.3 * spare, 0.03)
        rest = waists(shift) - target
        taken = {"front": min(0.3 * rest, 0.03), "back": rest - min(0.3 * rest, 0.03)}
    else:
        shift = -solved(lambda x: waists(-x) - target, 0.0, 1.0, "the waist")
        taken = {"front": 0.0, "back": 0.0}
    depth = {"front": 0.5 * abs(hips), "back": 0.72 * abs(hips)}
    lines, inseam, drop = {}, 0.0, 0.0
    for name in ("front", "back"):
        side, more = wide[name], 0.0 if name == "front" else 0.01
        knee_in, hem_in = (side + out[n] - (g / 2 + (more - 0.005) * 2) for n, g in (("knee", knee), ("hem", hem)))
        below = (knee_in, middle)

        def inner(fall: float, name: str = name, below: Point = below) -> tuple[Point, Point]:
            end = (-fork[name], crotch - fall)
            return (below[0] + 0.12 * (end[0] - below[0]), below[1] + 0.62 * (end[1] - below[1])), end

        if name == "front":
            inseam = curve(below, *inner(0.0))
        else:
            drop = solved(lambda x: inseam - curve(below, *inner(x)), 0.0, 0.15, "the inseam")  # noqa: B023
        via, end = inner(drop)
        top = tops[name]
        # the middle of front or back: straight from the waist to the level of the hips, then round to the fork
        slant = top[0] / (top[1] - hips)
        hip = (0.0, hips)
        reach = 0.55 * (hips - end[1])
        turn = ((0.55 * end[0] * 0.6, end[1] + 0.004), (-slant * reach, hips - reach))
        waist_side = (side - shift, 0.0)
        drawn = darted(top, waist_side, shared(taken[name], depth[name], 0.04))
        lines[name] = [
            *drawn,
            Line("side_hip", waist_side, ((side - 0.35 * shift, 0.4 * hips), (side, 0.7 * hips))),
            Line("side_thigh", (side, hips), ((side, hips + 0.35 * (middle - hips)),)),
            Line("side_leg", (side + out["knee"], middle)),
            Line("hem", (side + out["hem"], low)),
            Line("in_leg", (hem_in, low)),
            Line("in_thigh", below, (via,)),
            Line("crotch", end, turn),
            Line("rise", hip),
        ]
        if knee_in >= side + out["knee"] or hem_in >= side + out["hem"]:
            raise VitruvianError("trousers: the knee or hem has no width left; give a greater girth")
    return lines


def skirt(
    measures: Mapping[str, float],
    *,
    ease: float = 0.05,
    waist_ease: float = 0.02,
    length: float | None = None,
    flare: float = 0.0,
    band: float = 0.04,
    heights: Mapping[str, float] | None = None,
) -> Pattern:
    """A straight skirt of a front and a back with darts, and a waistband (`band` metres high; 0: none).

    ease: of the hips; length: from the waist (None: to the knee); flare: how far each side goes out from hips to hem.
    """
    f = figure(measures, heights)
    ease, waist_ease = number("ease", ease, 0.0, 0.6), number("waist_ease", waist_ease, 0.0, 0.3)
    band, flare = number("band", band, 0.0, 0.15), number("flare", flare, -0.05, 0.6)
    hips = f.hips - f.waist
    long = number("length", f.waist - f.knee if length is None else length, 0.02 - hips, f.waist)
    quarter, target = (f["hips"] + ease) / 4, (f["waist"] + waist_ease) / 4
    spare = quarter - target
    shift = spare if spare <= 0.012 else min(0.35 * spare, 0.03)
    rest = 2 * (spare - shift)
    side = [
        Line("side_hip", (quarter - shift, 0.0), ((quarter - 0.4 * shift, 0.4 * hips), (quarter, 0.7 * hips))),
        Line("side_low", (quarter, hips)),
        Line("hem", (quarter + flare, -long)),
    ]
    made = []
    for name, face, share, deep in (("front", FRONT, 0.35, 0.5), ("back", BACK, 0.65, 0.72)):
        top = darted((0.0, 0.0), (quarter - shift, 0.0), shared(share * rest, deep * abs(hips)))
        if not band:
            top = [Line(n.name, n.at, (), WAIST if n.name.startswith("waist") else "") for n in top]
        made.append(piece(name, unfolded([*top, *side], (0.0, -long)), face, (0.0, f.waist, face * 0.12)))
    seams = [join(made[0], f"{s}_{n.name}", made[1]) for s in "lr" for n in side[:2]]
    seams += [s for p in made for s in _darts(p)]
    if band:
        bands, more = _bands(made[:1], made[1:], f, band, 0.12)
        made, seams = made + bands, seams + more
    return Pattern("skirt", tuple(p.panel for p in made), tuple(seams), measures=dict(f.measures))


def sector(
    name: str,
    waist: float,
    angle: float,
    long: float,
    face: int,
    place: tuple[float, float, float],
    label: str,
    around: float = 0.0,
    tilt: float = 0.0,
) -> Piece:
    """Part of a ring: its inner arc of `waist` metres over `angle` radians, hanging down `long` metres."""
    inner, half = waist / angle, angle / 2
    outer = inner + long

    def at(radius: float, turn: float) -> Point:
        return radius * float(np.sin(turn)), inner - radius * float(np.cos(turn))

    lines = [
        Line("waist", at(inner, -half), (at(inner, 0.0),), label, arc=True),
        Line("left", at(inner, half)),
        Line("hem", at(outer, half), (at(outer, 0.0),), arc=True),
        Line("right", at(outer, -half)),
    ]
    high = 0.5 * inner * (1 - float(np.cos(half)))  # half of what the waist's ends are above its middle
    return piece(name, lines, face, (place[0], place[1] - high, place[2]), around=around, tilt=tilt)


def circle_skirt(
    measures: Mapping[str, float],
    *,
    ease: float = 0.02,
    length: float | None = None,
    circle: float = 1.0,
    band: float = 0.04,
    heights: Mapping[str, float] | None = None,
) -> Pattern:
    """A skirt that is part of a ring: `circle` 1 a full one, 0.5 half of it; front and back, and a waistband.

    ease: of the waist; length: from the waist (None: to the knee). Raises VitruvianError where the hips do not go in.
    """
    f = figure(measures, heights)
    ease, circle = number("ease", ease, 0.0, 0.6), number("circle", circle, 0.05, 1.0)
    band = number("band", band, 0.0, 0.15)
    long = number("length", f.waist - f.knee if length is None else length, 0.05, f.waist)
    waist, angle = (f["waist"] + ease) / 2, np.pi * circle
    if long > f.waist - f.hips and waist + angle * (f.waist - f.hips) < f["hips"] / 2 + 0.01:
        raise VitruvianError("circle-skirt: the hips do not go into it; give a greater circle or ease")
    label = "" if band else WAIST
    made = [
        sector(n, waist, angle, long, face, (0.0, f.waist, face * 0.12), label)
        for n, face in (("front", FRONT), ("back", BACK))
    ]
    seams = [join(made[0], side, made[1]) for side in ("left", "right")]
    if circle > GORES:
        made, seams = _gores(f, waist / 2, angle / 2, long, label)
    if band and len(made) == 2:
        bands, more = _bands(made[:1], made[1:], f, band, 0.12)
        made, seams = made + bands, seams + more
    elif band:
        bands, more = _ring(f, made, waist, band)
        made, seams = made + bands, seams + more
    return Pattern("circle-skirt", tuple(p.panel for p in made), tuple(seams), measures=dict(f.measures))


def _gores(f: Figure, waist: float, angle: float, long: float, label: str) -> tuple[list[Piece], list[Seam]]:
    """Four parts of a ring around the body: front, back, left, right, leaning out so that they do not cross. In two parts
    it would reach out to the hands."""
    far, below = 0.11 + f["hips"] / 12, f.waist - 0.09 * f["height"]  # clear of the hands: seams draw it up
    tilt = float(np.arcsin(min(np.tan(angle / 2), np.sin(STEEPEST))))
    made = [
        sector(name, waist, angle, long, face, (side * far, below, (face if not side else 0) * 0.14), label, turn, tilt)
        for name, face, side, turn in (
            ("front", FRONT, 0, 0.0),
            ("back", BACK, 0, 0.0),
            ("left", FRONT, 1, np.pi / 2),
            ("right", FRONT, -1, -np.pi / 2),
        )
    ]
    front, back, left, right = made
    seams = [join(front, "left", left, "right"), join(front, "right", right, "left")]
    seams += [join(back, "left", left, "left"), join(back, "right", right, "right")]
    return made, seams


def _ring(f: Figure, gores: list[Piece], waist: float, height: float) -> tuple[list[Piece], list[Seam]]:
    """A waistband of a front and a back, whose sides meet in the middle of the left and right gore."""
    half, quarter = waist / 2, waist / 4
    low = [Line("right_low", (-half, 0.0)), Line("low", (-quarter, 0.0)), Line("left_low", (quarter, 0.0))]
    lines = [*low, Line("left", (half, 0)), Line("top", (half, height), (), WAIST), Line("right", (-half, height))]
    made, seams = [], []
    for name, face, below in (("front_band", FRONT, gores[0]), ("back_band", BACK, gores[1])):
        band = piece(name, lines, face, (0.0, f.waist, face * 0.12))
        made.append(band)
        seams.append(join(band, "low", below, "waist"))
        # the waist of the left gore runs from the back to the front, that of the right one to the back
        first, last = (0.0, 0.5), (0.5, 1.0)
        for side, gore in (("left", gores[2]), ("right", gores[3])):
            part = last if (side == "left") == (face == FRONT) else first
            seams.append(Seam((band.span(f"{side}_low"),), (gore.span("waist", *part),)))
    seams += [join(made[0], side, made[1]) for side in ("left", "right")]
    return made, seams
