"""The doctor's rules about places: rest pose, joint centres, size, and whether the joints are inside the mesh."""

from __future__ import annotations

import numpy as np

from vitruvian.hanim import tables
from vitruvian.hanim.doctor import Floats
from vitruvian.hanim.doctor_figure import Figure
from vitruvian.hanim.doctor_space import at_rest, matrix, mesh
from vitruvian.hanim.doctor_words import several, some

MIRROR = 0.02 / 1.75  # of the figure's stature
_ARM = 15.0  # degrees that a resting arm may be off the vertical
_FEET = (0.5, 2.0)  # ankle spacing over hip spacing
_GROUND, _AXIS = 0.02, 0.05  # of the stature: how far feet and trunk may be off the ground and the Y axis
_GUESS = 0.06  # of the stature: how far soles told from the ankles alone may be
_OUTSIDE = 0.05  # of the stature: how far a joint may be outside the mesh
_WHOLE = ("humanoid_root", "skullbase", "l_hip", "r_hip", "l_shoulder", "r_shoulder")


def examine(figure: Figure) -> None:
    """P01 to P05 and P07."""
    chart, add = figure.chart, figure.chart.add
    moved = [j for j in figure.joints if not at_rest(chart, j)]
    if moved:
        names = some([figure.name(j) for j in moved])
        message = (
            f"{several(len(moved), 'joint is', 'joints are')} not at rest in the file ({names}): motion assumes rest"
        )
        add("P01", moved[0], message, "bake the pose into centres and skin")
    centers = centers_of(figure)
    given = np.array([c for c in centers.values() if c.any()]).reshape(-1, 3)
    if len(given) < 2:
        return
    lost = [n for n, c in centers.items() if not c.any() and not tables.humanoid_root(n)]
    if lost and len(lost) < len(centers):
        what = several(len(lost), "joint has", "joints have")
        message = f"{what} no center ({some(lost)}): turning about the floor"
        add("P02", next(j for j in figure.joints if figure.name(j) == lost[0]), message, "give their centres")
    if crooked := crooked_pairs(figure):
        what = several(len(crooked), "pair of joints is no mirror image", "pairs of joints are no mirror images")
        message = f"{what} ({some(list(crooked))}): lopsided motion"
        add("P03", figure.node, message, "mirror the left centres")
    points, complete = mesh(figure)
    at = whole_body(figure)
    if at is not None:
        _standing(figure, at)
        _size(figure, at, points)
    _inside(figure, centers, points, complete)


def centers_of(figure: Figure) -> dict[str, Floats]:
    """Joint name -> (3,) centre; zeros when it has none, left out when it can't be read."""
    found = {figure.name(j): figure.chart.numbers(j, "center") for j in figure.joints}
    return {n: c if c.size else np.zeros(3) for n, c in found.items() if c.size in (0, 3) and np.isfinite(c).all()}


def crooked_pairs(figure: Figure) -> dict[str, str]:
    """P03: left joint -> its right mate, where the centres are no mirror images."""
    centers = centers_of(figure)
    given = [c[1] for c in centers.values() if c.any()]
    slack = MIRROR * max(float(np.ptp(given)), 1e-9) if given else 0.0
    found = {}
    for name, c in centers.items():
        mate = "r_" + name[2:] if name.startswith("l_") else ""
        if mate not in centers or not c.any() or not centers[mate].any():
            continue
        if float(np.abs(c - centers[mate] * [-1, 1, 1]).max()) > slack:
            found[name] = mate
    return found


def whole_body(figure: Figure) -> dict[str, Floats] | None:
    """2.0 joint name -> centre (given ones only), when the joints are those of a whole body."""
    at = {n: c for name, c in centers_of(figure).items() if (n := tables.canonical(name)) and c.any()}
    return at if all(n in at for n in _WHOLE) else None


def _standing(figure: Figure, at: dict[str, Floats]) -> None:
    """P04: arms down, palms inward, feet forward and under the hips, left on the left."""
    add, node = figure.chart.add, figure.node
    if at["l_shoulder"][0] < at["r_shoulder"][0]:
        add("P04", node, "left and right are swapped, or the figure faces backwards", "turn it to face +Z")
        return
    for side, word in (("l", "left"), ("r", "right")):
        shoulder, wrist = at[f"{side}_shoulder"], at.get(f"{side}_radiocarpal")
        angle = _degrees(wrist - shoulder, np.array([0.0, -1, 0])) if wrist is not None else 0.0
        if angle > _ARM:
            message = f"the {word} arm is {angle:.0f} degrees off the body, not along it"
            add("P04", node, message + ": retargeting needs its rest offset", "re-pose to the default pose")
            continue
        index, pinky = (at.get(f"{side}_metacarpophalangeal_{k}") for k in (2, 5))
        if index is not None and pinky is not None:
            turn = _degrees((index - pinky) * [1, 0, 1], np.array([0.0, 0, 1]))
            if turn > 60:
                message = f"the {word} palm is turned {turn:.0f} degrees from facing inward"
                add("P04", node, message + ": retargeting needs its rest offset", "re-pose to the default pose")
    ankles = [at.get(f"{side}_talocrural") for side in "lr"]
    toes = [at.get(f"{side}_metatarsophalangeal_2") for side in "lr"]
    if all(a is not None and t is not None and t[2] <= a[2] for a, t in zip(ankles, toes)):
        add("P04", node, "the toes are behind the ankles: the figure looks backwards", "turn it to face +Z")
    left, right = ankles
    hips = float(at["l_hip"][0] - at["r_hip"][0])
    if left is not None and right is not None and hips > 0:
        apart = float(left[0] - right[0]) / hips
        if not _FEET[0] <= apart <= _FEET[1]:
            message = f"the ankles are {apart:.2g} times as far apart as the hips"
            add("P04", node, message, "re-pose to the default pose")


def _degrees(a: Floats, b: Floats) -> float:
    """The angle between two directions; 0 when one has no length."""
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.degrees(np.arccos(np.clip(a @ b / size, -1, 1)))) if size else 0.0


def placement(figure: Figure, at: dict[str, Floats], points: Floats) -> tuple[float, float, Floats]:
    """What P05 measures, in metres where the Humanoid's own transform puts it: height from ankle to skull, height of
    the soles (of the ankles when there is no mesh), middle of the joints. People who share a scene stand side by side:
    for these the middle is that before their own translation.
    """
    place = matrix(figure.chart, figure.node)
    joints = np.array(list(at.values())) @ place[:3, :3].T + place[:3, 3]
    where = dict(zip(at, joints))
    ankle = where.get("l_talocrural", where["l_hip"])
    tall = float(where["skullbase"][1] - ankle[1])
    body = points @ place[:3, :3].T + place[:3, 3]
    covered = len(body) and float(np.ptp(body[:, 1])) > 0.8 * abs(tall)
    soles = float(body[:, 1].min()) if covered else float(ankle[1]) - 0.06 * tall
    middle = joints.mean(axis=0)
    if sum(figure.chart.reading.kind(n) == "Humanoid" for n in figure.chart.nodes) > 1:
        middle -= place[:3, 3]
    return tall, soles, middle


def misplaced(tall: float, soles: float, middle: Floats, points: Floats) -> tuple[bool, bool]:
    """Whether a body is off the ground, and off the Y axis."""
    stature = 1.12 * tall  # from ankle to skull it lacks the foot and the cap of the head
    ground = _GROUND if len(points) else _GUESS
    return abs(soles) > ground * stature, max(abs(float(middle[0])), abs(float(middle[2]))) > _AXIS * stature


def _size(figure: Figure, at: dict[str, Floats], points: Floats) -> None:
    """P05: metres, on the ground, on the Y axis."""
    add, node = figure.chart.add, figure.node
    tall, soles, middle = placement(figure, at, points)
    off = misplaced(tall, soles, middle, points)
    if tall < 0:
        add("P04", node, "skullbase is below the feet: the figure stands on its head", "turn it upright")
    elif not 0.25 <= tall <= 2.7:
        message = f"from ankle to skull it measures {tall:.3g} m: the units are not metres"
        add("P05", node, message, "give the Humanoid a scale")
    elif off[0]:
        add("P05", node, f"the soles are {soles:.2g} m above the ground", "give the Humanoid a translation")
    elif off[1]:
        message = f"the body stands {float(np.hypot(middle[0], middle[2])):.2g} m off the Y axis"
        add("P05", node, message, "give the Humanoid a translation")


def _inside(figure: Figure, centers: dict[str, Floats], points: Floats, complete: bool) -> None:
    """P07: joints far outside the box of the mesh. Silent when part of what is drawn has no points to look at."""
    given = {n: c for n, c in centers.items() if c.any()}
    if len(points) < 8 or not complete or len(given) < 2:
        return
    low, high = points.min(axis=0), points.max(axis=0)
    spread = np.ptp(np.array(list(given.values())), axis=0)
    main = int(np.argmax(spread))
    if (high - low)[main] < 0.5 * spread[main]:
        return  # a mesh of one part only
    slack = _OUTSIDE * max(float(spread.max()), float((high - low).max()))
    far = {n: float(np.maximum(low - c, c - high).max()) for n, c in given.items()}
    far = {n: d for n, d in far.items() if d > slack}
    if far:
        worst = max(far, key=lambda n: far[n])
        what = several(len(far), "joint is", "joints are")
        message = f"{what} outside the mesh ({some(list(far))}; {worst} by {far[worst]:.3g})"
        joint = next(j for j in figure.joints if figure.name(j) == worst)
        figure.chart.add("P07", joint, message, "move the mesh or the joint")
