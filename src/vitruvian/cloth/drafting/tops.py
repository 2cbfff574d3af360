"""Garments that hang from the shoulders, cut to the body: T-shirt, shirt and dress."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vitruvian.cloth.drafting.bottoms import sector
from vitruvian.cloth.drafting.figure import Figure, figure, number
from vitruvian.cloth.drafting.pieces import (
    ARMS,
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
from vitruvian.cloth.pattern import Button, Pattern, Seam
from vitruvian.errors import VitruvianError

SLOPE = np.tan(np.radians(21.0))  # of the shoulder seam
RISE = 0.018  # metres of the shoulder seam's inner end over the nape
HEAD = 0.338  # a head's girth as a share of the height
BALANCE = 0.006  # metres that a quarter of the front is wider than one of the back
Point = tuple[float, float]


@dataclass(frozen=True)
class Bodice:
    """The lines of half a front or back, u = 0 in the middle, v = 0 at the nape, from the neck to the waist or hem."""

    neck: Line
    shoulder: Line
    armhole: Line
    under: Point  # where the side begins, at the armhole's lower end

    def lines(self) -> list[Line]:
        """From the middle of the neck to the side."""
        return [self.neck, self.shoulder, self.armhole]

    def armhole_length(self) -> float:
        """Metres."""
        return curve(self.armhole.at, *self.armhole.via, self.under)

    def neck_length(self) -> float:
        """Metres."""
        return curve(self.neck.at, *self.neck.via, self.shoulder.at)


def bodice(
    f: Figure, name: str, quarter: float, deep: float, *, neck: float, drop: float, label: str = "left_armhole"
) -> Bodice:
    """Half a front or back. quarter: width at the armhole's lower end, deep: its depth under the nape; neck: half width
    of the neck hole, drop: its depth in the middle under the nape."""
    tip = min(f["shoulder_width"] / 2, quarter - 0.02)
    inner, outer = (neck, RISE), (tip, RISE - SLOPE * (tip - neck))
    if tip - neck < 0.02:
        raise VitruvianError(
            f"draft: the {name}'s shoulder is {100 * (tip - neck):.1f} cm long; make the neck narrower"
        )
    hollow = 0.075 if name == "front" else 0.04  # of the half shoulder: how far the armhole cuts in
    across = tip * (1 - hollow)
    fall = outer[1] + deep
    armhole = ((across, outer[1] - 0.5 * fall), (across + 0.3 * (quarter - across), -deep))
    curved = ((0.62 * neck, -drop), (neck - 0.04 * neck, RISE - 0.6 * (RISE + drop)))
    return Bodice(
        Line("neck", (0.0, -drop), curved, "left_collar"),
        Line("shoulder", inner),
        Line("armhole", outer, armhole, label),
        (quarter, -deep),
    )


def _widths(f: Figure, ease: float, hem: float) -> tuple[float, float, float]:
    """Quarter of the chest with ease, a quarter at the hem, `hem` under the nape, that is wide enough for what the garment
    covers, and the depth of the armhole."""
    quarter, deep = (f["chest"] + ease) / 4, f["chest"] / 8 + 0.058 * f["height"] + 0.06 * ease
    wide = quarter
    for level, girth in ((f.nape - f.waist, f["waist"]), (f.nape - f.hips, f["hips"])):
        if deep + 0.02 < level <= hem:
            need = (girth + min(ease, 0.06)) / 4 - quarter
            wide = max(wide, quarter + need * (hem - deep) / (level - deep) if need > 0 else wide)
    return quarter, wide, deep


def _pair(
    f: Figure, quarter: float, deep: float, thick: float, *, neck: float, front_drop: float, back_drop: float
) -> tuple[Bodice, Bodice, float]:
    """Front and back with armholes that a sleeve over an arm of girth `thick` goes into, and the depth that took."""
    for more in np.arange(0.0, 0.2, 0.01):
        front = bodice(f, "front", quarter + BALANCE, deep + more, neck=neck, drop=front_drop)
        back = bodice(f, "back", quarter - BALANCE, deep + more, neck=neck, drop=back_drop)
        if 0.94 * (front.armhole_length() + back.armhole_length()) >= thick:
            return front, back, deep + float(more)
    raise VitruvianError("draft: the armhole of this chest is too small for the arm; give more ease")


def _sleeves(
    f: Figure, front: Bodice, back: Bodice, thick: float, long: float, wrist: float, ease: float
) -> dict[tuple[str, str], Piece]:
    """Sleeves in two halves, front and back, joined over and under the arm; caps as long as their armholes with `ease`.

    thick: girth of the sleeve at the armpit at least; long: from the shoulder's tip; wrist: girth at its end.
    """
    caps = {"front": front.armhole_length() * (1 + ease), "back": back.armhole_length() * (1 + ease)}
    mean = 0.5 * sum(caps.values())
    wide = max(0.5 * thick, 0.86 * mean)

    def cap(high: float, across: float) -> tuple[Point, Point]:
        return (high, -0.68 * across), (0.0, -0.42 * across)

    def length(high: float, across: float) -> float:
        return curve((high, -across), *cap(high, across), (0.0, 0.0))

    high = solved(lambda x: length(x, wide) - mean, 0.0, mean, "the sleeve's cap")
    if long < high + 0.03:
        raise VitruvianError(f"sleeve: expected more than {high + 0.03:.2f} m, which its cap takes, found {long:.2f}")
    out = {}
    reach = np.array([np.cos(ARMS), -np.sin(ARMS)])
    for name, face in (("front", FRONT), ("back", BACK)):
        across = solved(lambda x: length(high, x) - caps[name], 0.5 * wide, 1.5 * wide, "the sleeve's cap")  # noqa: B023
        end = wrist / 2 + across - wide
        lines = [
            Line("over", (0.0, 0.0)),
            Line("cuff", (long, 0.0)),
            Line("under", (long, -end)),
            Line("cap", (high, -across), cap(high, across), "left_armhole"),
        ]
        # the arm's axis runs through the middle of the sleeve
        axis = np.array([f["shoulder_width"] / 2 - 0.01, f.shoulder - 0.035])
        top = axis + 0.03 * reach + 0.5 * wide * np.array([-reach[1], reach[0]])
        for side, sign in (("left", 1), ("right", -1)):
            drawn = lines if sign > 0 else mirrored(lines)
            place = (sign * float(top[0]), float(top[1]), face * 0.09)
            title = f"{side}_sleeve_{name}"
            out[side, name] = piece(title, drawn, face, place, turn=-sign * ARMS, label="arm", grain=(1.0, 0.0))
    return out


def _sleeve_seams(sleeves: Mapping[tuple[str, str], Piece], bodies: Mapping[tuple[str, str], Piece]) -> list[Seam]:
    """Sleeves sewn over and under the arm and into the armholes. bodies: by side and name; those cut on the fold have
    edges `l_armhole`, `r_armhole`, the others `armhole`."""
    out = []
    for side in ("left", "right"):
        out += [join(sleeves[side, "front"], n, sleeves[side, "back"]) for n in ("over", "under")]
        for name in ("front", "back"):
            body = bodies[side, name]
            hole = "armhole" if "armhole" in body.names else f"{side[0]}_armhole"
            out.append(join(sleeves[side, name], "cap", body, hole))
    return out


def _opening(front: Bodice, back: Bodice) -> float:
    return 2 * (front.neck_length() + back.neck_length())


def _neck(f: Figure, ease: float) -> tuple[float, float, float]:
    """Half width, drop in front and drop at the back of a neck hole, `ease` metres wider than the neck's base."""
    base = f["neck"] + 0.03 + ease
    return base / 5.6, base / 5.6 + 0.008, 0.012 + 0.05 * ease


def tshirt(
    measures: Mapping[str, float],
    *,
    ease: float = 0.10,
    length: float | None = None,
    sleeve: float | None = None,
    neck_ease: float = 0.08,
    heights: Mapping[str, float] | None = None,
) -> Pattern:
    """A T-shirt: front and back on the fold, sleeves in halves.

    ease: of the chest; length: from the nape to the hem (None: to below the hips); sleeve: from the shoulder (None: two
    fifths of the arm); neck_ease: how much the neck hole is longer than the neck's base.
    """
    f = figure(measures, heights)
    ease, neck_ease = number("ease", ease, 0.0, 0.8), number("neck_ease", neck_ease, 0.0, 0.5)
    hem = number("length", f.nape - f.hips + 0.02 if length is None else length, 0.25 * f.nape, 0.95 * f.nape)
    arm = number("sleeve", 0.4 * f["arm_length"] if sleeve is None else sleeve, 0.1, 1.1 * f["arm_length"])
    quarter, wide, deep = _widths(f, ease, hem)
    neck, front_drop, back_drop = _neck(f, neck_ease)
    thick = f["upper_arm"] + max(0.04, 0.6 * ease)
    front, back, deep = _pair(f, quarter, deep, thick, neck=neck, front_drop=front_drop, back_drop=back_drop)
    bodies, made = {}, []
    for name, face, block in (("front", FRONT, front), ("back", BACK, back)):
        low = (block.under[0] + wide - quarter, -hem)
        lines = [*block.lines(), Line("side", block.under), Line("hem", low)]
        whole = piece(name, unfolded(lines, (0.0, -hem)), face, (0.0, f.nape, face * 0.16))
        bodies["left", name] = bodies["right", name] = whole
        made.append(whole)
    cuff = max(f["upper_arm"] + 0.05, 0.9 * thick) if arm < 0.6 * f["arm_length"] else max(f["wrist"] + 0.06, 0.2)
    sleeves = _sleeves(f, front, back, thick, arm, cuff, 0.0)
    seams = [join(made[0], f"{s}_{n}", made[1]) for s in "lr" for n in ("shoulder", "side")]
    seams += _sleeve_seams(sleeves, bodies)
    every = [*made, *sleeves.values()]
    return Pattern("tshirt", tuple(p.panel for p in every), tuple(seams), measures=dict(f.measures))


def shirt(
    measures: Mapping[str, float],
    *,
    ease: float = 0.14,
    length: float | None = None,
    sleeve: float | None = None,
    neck_ease: float = 0.02,
    collar: float = 0.04,
    cuff: float = 0.055,
    closed: str = "seam",
    heights: Mapping[str, float] | None = None,
) -> Pattern:
    """A shirt with long sleeves, cuffs, a stand collar in three parts and a front that opens.

    ease: of the chest; length: from the nape (None: to below the hips); sleeve: from the shoulder to the wrist; collar and
    cuff: heights of them (0: none). closed: "seam" sews both fronts edge to edge; "buttons" lets them overlap and puts
    buttons on the middle of the front.
    """
    f = figure(measures, heights)
    ease, neck_ease = number("ease", ease, 0.0, 0.8), number("neck_ease", neck_ease, 0.0, 0.3)
    collar, cuff = number("collar", collar, 0.0, 0.1), number("cuff", cuff, 0.0, 0.15)
    if closed not in ("seam", "buttons"):
        raise VitruvianError(f"closed: expected seam or buttons, found {closed!r:.40}")
    hem = number("length", f.nape - f.hips + 0.05 if length is None else length, 0.25 * f.nape, 0.95 * f.nape)
    arm = number("sleeve", f["arm_length"] if sleeve is None else sleeve, 0.3, 1.2 * f["arm_length"])
    quarter, wide, deep = _widths(f, ease, hem)
    neck, front_drop, back_drop = _neck(f, neck_ease)
    thick = f["upper_arm"] + max(0.05, 0.6 * ease)
    front, back, deep = _pair(f, quarter, deep, thick, neck=neck, front_drop=front_drop, back_drop=back_drop)
    over = 0.015 if closed == "buttons" else 0.0
    bodies = {}
    tail = 0.045  # the hem curves up at the sides
    low = (front.under[0] + wide - quarter, -hem + tail)
    lines = [*front.lines(), Line("side", front.under), _tail(low, hem)]
    if over:
        lines += [
            Line("hem_stand", (0.0, -hem)),
            Line("middle", (-over, -hem)),
            Line("neck_stand", (-over, -front_drop)),
        ]
    else:
        lines.append(Line("middle", (0.0, -hem)))
    for side, sign in (("left", 1), ("right", -1)):
        drawn = lines if sign > 0 else mirrored(lines)
        above = 0.03 if over and sign > 0 else 0.0  # the left front lies over the right one
        place = (0.0, f.nape, 0.16 + above)
        bodies[side, "front"] = piece(f"{side}_front", drawn, FRONT, place, order=int(above > 0))
    low = (back.under[0] + wide - quarter, -hem + tail)
    lines = [*back.lines(), Line("side", back.under), _tail(low, hem)]
    whole = piece("back", unfolded(lines, (0.0, -hem)), BACK, (0.0, f.nape, -0.16))
    bodies["left", "back"] = bodies["right", "back"] = whole
    wrist = f["wrist"] + 0.06
    sleeves = _sleeves(f, front, back, thick, arm - cuff, 1.2 * wrist if cuff else wrist, 0.0)
    every = [bodies["left", "front"], bodies["right", "front"], whole, *sleeves.values()]
    seams = [join(bodies[s, "front"], n, whole, f"{s[0]}_{n}") for s in ("left", "right") for n in ("shoulder", "side")]
    seams += _sleeve_seams(sleeves, bodies)
    if not over:
        seams.append(join(bodies["left", "front"], "middle", bodies["right", "front"]))
    if cuff:
        bands, more = _cuffs(f, sleeves, wrist, cuff, arm)
        every, seams = every + bands, seams + more
    if collar:
        bands, more = _collar(f, bodies, collar)
        every, seams = every + bands, seams + more
    count = max(2, round((hem - front_drop) / 0.09))
    places = [-front_drop - 0.015 - k * (hem - front_drop - 0.12) / (count - 1) for k in range(count)] if over else []
    buttons = tuple(Button(("left_front", (0.0, v)), ("right_front", (0.0, v))) for v in places)
    return Pattern("shirt", tuple(p.panel for p in every), tuple(seams), buttons, dict(f.measures))


def _tail(low: Point, hem: float) -> Line:
    """A hem from the side to the middle, which hangs lower."""
    return Line("hem", low, ((0.82 * low[0], low[1] - 0.004), (0.55 * low[0], -hem)))


def _cuffs(
    f: Figure, sleeves: Mapping[tuple[str, str], Piece], wrist: float, height: float, arm: float
) -> tuple[list[Piece], list[Seam]]:
    """Bands of `height` around the wrists, in halves, into which the sleeves are eased."""
    made, seams = {}, []
    for (side, name), sleeve in sleeves.items():
        sign, face = (1 if side == "left" else -1), (FRONT if name == "front" else BACK)
        half = 0.5 * wrist
        lines = [
            Line("over", (0, 0)),
            Line("end", (height, 0)),
            Line("under", (height, -half)),
            Line("top", (0, -half)),
        ]
        drawn = lines if sign > 0 else mirrored(lines)
        base = sleeve.panel.translation
        slack = 0.5 * (sleeve.length("cuff") - half)
        reach = np.array([np.cos(ARMS), -np.sin(ARMS)])
        where = np.array([sign * base[0], base[1]]) + (arm - height + 0.01) * reach  # type: ignore[index]
        where -= slack * np.array([-reach[1], reach[0]])
        place = (sign * float(where[0]), float(where[1]), face * 0.08)
        title = f"{side}_cuff_{name}"
        band = piece(title, drawn, face, place, turn=-sign * ARMS, label="arm", grain=(0.0, 1.0))
        made[side, name] = band
        seams.append(join(sleeve, "cuff", band, "top", "ease"))
    for side in ("left", "right"):
        seams += [join(made[side, "front"], n, made[side, "back"]) for n in ("over", "under")]
    return list(made.values()), seams


def _collar(f: Figure, bodies: Mapping[tuple[str, str], Piece], height: float) -> tuple[list[Piece], list[Seam]]:
    """A stand collar in three parts: two in front, which curve up and are rounded at the throat, one at the back."""
    fronts = [bodies[s, "front"] for s in ("left", "right")]
    back, lean = bodies["left", "back"], 0.12 * height
    half, long = back.length("l_neck"), fronts[0].length("neck")
    at_back = [
        Line("low", (0.0, 0.0), (), "left_collar"),
        Line("end", (half, 0.0)),
        Line("top", (half - lean, height)),
    ]
    made = [piece("collar_back", unfolded(at_back, (0.0, height)), BACK, (0.0, f.nape + 0.02, -0.08))]
    up = 0.1 * long

    def low(x: float) -> tuple[Point, ...]:
        return (0.0, up), (0.45 * x, 0.0), (x, 0.0)

    wide = solved(lambda x: curve(*low(x)) - long, 0.5 * long, long, "the collar")
    at_front = [
        Line("low", (0.0, up), ((0.45 * wide, 0.0),), "left_collar"),
        Line("end", (wide, 0.0)),
        Line("top", (wide - lean, height), ((0.5 * wide, height + 0.2 * up),)),
        Line("round", (0.5 * height + 0.002, height + 0.62 * up), ((0.004, height + 0.9 * up),)),
        Line("throat", (0.0, up + 0.55 * height)),
    ]
    seams = []
    for side, sign, front in zip(("left", "right"), (1, -1), fronts):
        drawn = at_front if sign > 0 else mirrored(at_front)
        band = piece(f"{side}_collar", drawn, FRONT, (sign * 0.004, f.nape - 0.5 * long, 0.1))
        made.append(band)
        seams.append(join(band, "low", front, "neck"))
        seams.append(join(band, "end", made[0], f"{side[0]}_end"))
        seams.append(join(made[0], f"{side[0]}_low", back, f"{side[0]}_neck"))
    return made, seams


def dress(
    measures: Mapping[str, float],
    *,
    ease: float = 0.06,
    waist_ease: float = 0.04,
    length: float | None = None,
    circle: float = 0.4,
    sleeve: float = 0.0,
    heights: Mapping[str, float] | None = None,
) -> Pattern:
    """A dress: a bodice with waist darts and a neck hole that the head goes through, sewn to a skirt that is part of a
    ring.

    ease: of the chest; length: of the skirt from the waist (None: to the knee); circle: how much of a full ring the skirt
    is, more where the hips need it; sleeve: from the shoulder, 0: none.
    """
    f = figure(measures, heights)
    ease, waist_ease = number("ease", ease, 0.0, 0.6), number("waist_ease", waist_ease, 0.0, 0.4)
    long = number("length", f.waist - f.knee if length is None else length, 0.1, f.waist - 0.02)
    circle, arm = number("circle", circle, 0.1, 0.6), number("sleeve", sleeve, 0.0, 1.1 * f["arm_length"])
    quarter, _, deep = _widths(f, ease, 0.0)
    waist = f.nape - f.waist
    thick = f["upper_arm"] + 0.05 if arm else 0.0
    neck, front_drop, back_drop = _neck(f, 0.1)
    widest = min(f["shoulder_width"] / 2, quarter - 0.02) - 0.035
    for grown in np.linspace(0.0, 0.4, 41):  # until the head goes through
        sizes = {"neck": min(neck + 0.25 * grown, widest), "front_drop": front_drop + grown * 0.5}
        front, back, down = _pair(f, quarter, deep, thick, back_drop=back_drop + 0.15 * grown, **sizes)
        if _opening(front, back) >= HEAD * f["height"] + 0.02:
            break
    if waist - down < 0.05:
        raise VitruvianError("dress: the armhole reaches the waist; give less ease")
    target = (f["waist"] + waist_ease) / 4
    spare = quarter - target
    shift = spare if spare <= 0.01 else min(0.4 * spare, 0.03)
    bodies, made, seams = {}, [], []
    for name, face, block in (("front", FRONT, front), ("back", BACK, back)):
        side = (block.under[0] - shift, -waist)
        height = min(0.7 * (waist - down), 0.16)
        waists = darted((0.0, -waist), side, shared(spare - shift, -height))
        lines = [*block.lines(), Line("side", block.under), *_inwards(waists, side)]
        whole = piece(f"bodice_{name}", unfolded(lines, (0.0, -waist)), face, (0.0, f.nape, face * 0.16))
        bodies["left", name] = bodies["right", name] = whole
        waist_names = [n for n in whole.names if "waist" in n]
        finished = whole.length(*waist_names)
        need = f["hips"] / 2 + 0.02 - finished
        angle = max(np.pi * circle, need / (f.waist - f.hips))
        if angle > np.pi:
            raise VitruvianError("dress: the hips do not go into its skirt; give more waist_ease")
        below = sector(f"skirt_{name}", finished, angle, long, face, (0.0, f.waist, face * 0.14), "")
        seams.append(join(whole, waist_names, below, "waist"))
        seams += [dart(whole, n[:-2]) for n in whole.names if "dart" in n and n.endswith("_a")]
        made += [whole, below]
    seams += [join(made[0], f"{s}_{n}", made[2]) for s in "lr" for n in ("shoulder", "side")]
    seams += [join(made[1], side, made[3]) for side in ("left", "right")]
    if arm:
        cuff = max(f["upper_arm"] + 0.05, 0.9 * thick) if arm < 0.6 * f["arm_length"] else f["wrist"] + 0.06
        sleeves = _sleeves(f, front, back, thick, arm, cuff, 0.0)
        made += list(sleeves.values())
        seams += _sleeve_seams(sleeves, bodies)
    return Pattern("dress", tuple(p.panel for p in made), tuple(seams), measures=dict(f.measures))


def _inwards(lines: list[Line], side: Point) -> list[Line]:
    """Lines drawn outwards from the middle to `side`, drawn from the side inwards."""
    ends = [*(line.at for line in lines[1:]), side]
    swap = {"_a": "_b", "_b": "_a"}
    return [
        Line(line.name[:-2] + swap.get(line.name[-2:], line.name[-2:]), end, (), line.label)
        for line, end in zip(lines[::-1], ends[::-1])
    ]
