"""The doctor's rules about places: rest pose, joint centres, size, limits, masses."""

from __future__ import annotations

import numpy as np

from vitruvian.hanim import tables
from vitruvian.hanim.doctor import Floats
from vitruvian.hanim.doctor_figure import Figure

_MIRROR_TOLERANCE = 0.02 / 1.75  # of the figure's stature
_ARM = 15.0  # degrees that a resting arm may be off the vertical


def examine(figure: Figure) -> None:
    """P01 to P05, D04, D05."""
    for rule in (_rest, _limits, _masses):
        rule(figure)


def _rest(figure: Figure) -> None:
    """P01 to P05: the rest pose and the joint centres."""
    chart, add = figure.chart, figure.chart.add
    moved = []
    for joint in figure.joints:
        rotation, translation = chart.numbers(joint, "rotation"), chart.numbers(joint, "translation")
        scale = chart.numbers(joint, "scale")
        if rotation[3:4].any() or translation.any() or (scale.size == 3 and (scale != 1).any()):
            moved.append(joint)
    if moved:
        some = ", ".join(figure.name(j) for j in moved[:3]) + (", ..." if len(moved) > 3 else "")
        message = f"{len(moved)} joints are not at rest in the file ({some}): motion assumes that they are"
        add("P01", moved[0], message, "bake the pose into centres and skin")
    centers = {figure.name(j): chart.numbers(j, "center") for j in figure.joints}
    centers = {n: c for n, c in centers.items() if c.size in (0, 3) and np.isfinite(c).all()}
    given = np.array([c for c in centers.values() if c.size == 3 and c.any()]).reshape(-1, 3)
    if len(given) < 2:
        return
    lost = [n for n, c in centers.items() if not c.any() and not tables.humanoid_root(n)]
    if lost and len(lost) < len(centers):
        some = ", ".join(lost[:3]) + (", ..." if len(lost) > 3 else "")
        message = f"{len(lost)} joints have no center ({some}): they turn about the floor"
        add("P02", next(j for j in figure.joints if figure.name(j) == lost[0]), message, "give their centres")
    stature = float(np.ptp(given[:, 1]))
    crooked = []
    for name, c in centers.items():
        mate = centers.get("r_" + name[2:]) if name.startswith("l_") else None
        if mate is None or c.size != 3 or mate.size != 3 or not c.any() or not mate.any():
            continue
        if float(np.abs(c - mate * [-1, 1, 1]).max()) > _MIRROR_TOLERANCE * max(stature, 1e-9):
            crooked.append(name)
    if crooked:
        some = ", ".join(crooked[:3]) + (", ..." if len(crooked) > 3 else "")
        message = f"{len(crooked)} pairs of joints are not mirror images ({some}): lopsided motion"
        add("P03", figure.node, message, "mirror the left centres")
    _standing(figure, centers)


def _standing(figure: Figure, centers: dict[str, Floats]) -> None:
    """P04, P05: the default pose and the size of a whole body, told from its joints."""
    chart, add = figure.chart, figure.chart.add
    at = {tables.canonical(n): c for n, c in centers.items() if c.size == 3}
    whole = ("humanoid_root", "skullbase", "l_hip", "r_hip", "l_shoulder", "r_shoulder")
    if any(n not in at for n in whole):
        return
    for side in "lr":
        shoulder, wrist = at[f"{side}_shoulder"], at.get(f"{side}_radiocarpal")
        if wrist is None or not (wrist - shoulder).any():
            continue
        arm = (wrist - shoulder) / np.linalg.norm(wrist - shoulder)
        angle = float(np.degrees(np.arccos(np.clip(-arm[1], -1, 1))))
        if angle > _ARM:
            message = f"the {'left' if side == 'l' else 'right'} arm is {angle:.0f} degrees off the body, not along it"
            add("P04", figure.node, message + ": retargeting needs its rest offset", "re-pose to the default pose")
    given = chart.numbers(figure.node, "scale")
    scale = float(given[1]) if given.size == 3 and np.isfinite(given).all() else 1.0
    ankle = at.get("l_talocrural", at["l_hip"])
    tall = float(at["skullbase"][1] - ankle[1]) * scale
    if tall < 0:
        add("P04", figure.node, "skullbase is below the feet: the figure stands on its head", "turn it upright")
    elif not 0.25 <= tall <= 2.7:
        message = f"from ankle to skull it measures {tall:.3g} m: the units are not metres"
        add("P05", figure.node, message, "give the Humanoid a scale")
    elif abs(float(ankle[1])) * scale > 0.25 * tall:
        message = f"the ankles are {float(ankle[1]) * scale:.2g} m above the ground"
        add("P05", figure.node, message, "give the Humanoid a translation")


def _limits(figure: Figure) -> None:
    chart, add = figure.chart, figure.chart.add
    for joint in figure.joints:
        low, high = chart.numbers(joint, "llimit"), chart.numbers(joint, "ulimit")
        if len(low) not in (0, 3) or len(high) not in (0, 3):
            add(
                "D05",
                joint,
                f"llimit and ulimit have {len(low)} and {len(high)} numbers, expected 0 or 3",
                "give three",
            )
        elif len(low) == len(high) and (low > high).any():
            add("D05", joint, "llimit is above ulimit", "swap them")
        stiffness = chart.numbers(joint, "stiffness")
        if ((stiffness < 0) | (stiffness > 1)).any():
            add("D05", joint, "stiffness is outside 0..1", "clamp it")


def _masses(figure: Figure) -> None:
    """D04: masses and inertias that no body can have."""
    chart, add = figure.chart, figure.chart.add
    for segment, _ in figure.segments:
        mass, inertia = chart.numbers(segment, "mass"), chart.numbers(segment, "momentsOfInertia")
        if (mass < 0).any():
            add("D04", segment, f"mass {mass[0]:g} is negative", "give a mass of 0 or more")
        if len(inertia) not in (0, 9):
            add("D04", segment, f"momentsOfInertia has {len(inertia)} numbers, expected 9", "give nine, row by row")
        elif len(inertia) == 9 and np.isfinite(inertia).all():
            tensor = inertia.reshape(3, 3)
            size = max(float(np.abs(tensor).max()), 1e-12)
            moments = np.linalg.eigvalsh((tensor + tensor.T) / 2)
            if np.abs(tensor - tensor.T).max() > 1e-3 * size:
                add("D04", segment, "momentsOfInertia is not symmetric", "symmetrise it")
            elif moments[0] < -1e-6 * size or moments[0] + moments[1] < moments[2] * (1 - 1e-3):
                add("D04", segment, "momentsOfInertia belongs to no solid", "recompute it from the mesh")
