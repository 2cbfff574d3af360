"""Repairs of single values: numbers, axes, limits, masses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vitruvian.hanim.doctor import Chart, Floats
from vitruvian.hanim.doctor_figure import Figure
from vitruvian.hanim.doctor_fix import Wanted
from vitruvian.hanim.doctor_space import segment_points
from vitruvian.hanim.doctor_values import AXIS, form_of, outside, single, whole, wrong_inertia
from vitruvian.hanim.graph import Node, Use
from vitruvian.hanim.values import COLUMNS


def _numbers(chart: Chart, wanted: Wanted) -> Iterator[str]:
    """P06: axes of length 1; on request what is no number becomes 0, or the field its default."""
    for node in chart.nodes:
        kind, who = chart.reading.kind(node), chart.reading.who(node)
        for field, value in list(node.fields.items()):
            form = form_of(chart, node, field)
            if not form or isinstance(value, Node | Use) or (isinstance(value, list) and not kind):
                continue
            array = chart.numbers(node, field)
            finite = bool(np.isfinite(array).all())
            if form.endswith("Int32") and finite and not whole(value, array) and whole(None, array):
                node.fields[field] = array.astype(np.int32) if form == "MFInt32" else int(array[0])
                yield f"{who}: {field} is written in whole numbers (P06)"
            if form == "MFInt32":
                continue  # indices that are no numbers are dropped with their pair or face
            count = single(form)
            short = count > 0 and bool(kind) and len(array) not in (0, count)
            if "P06+" in wanted and (short or (count and not finite)):
                del node.fields[field]
                yield f"{who}: {field} is left out, it was no {form} (P06)"
            elif "P06+" in wanted and not finite:
                width = COLUMNS[form[2:]] if len(array) % COLUMNS[form[2:]] == 0 else 1
                mended = np.where(np.isfinite(array), array, 0.0)
                node.fields[field] = mended.reshape(-1, width) if width > 1 else mended
                yield f"{who}: {int((~np.isfinite(array)).sum())} numbers of {field} are 0 (P06)"
            elif kind and form == "SFRotation" and len(array) == 4 and finite and array[3] != 0:
                size = float(np.linalg.norm(array[:3]))
                if size and abs(size - 1) > AXIS:
                    node.fields[field] = np.array([*(array[:3] / size), array[3]])
                    yield f"{who}: the axis of {field} has length 1 (P06)"
                elif not size and "P06+" in wanted:
                    del node.fields[field]
                    yield f"{who}: {field} about no axis is left out (P06)"


def _limits(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """D05: three limits or none, lower ones below upper ones, stiffness in 0..1. An axis that lacks a limit is free."""
    chart = figure.chart
    for joint in figure.joints:
        low, high = chart.numbers(joint, "llimit"), chart.numbers(joint, "ulimit")
        one_axis = {"jointType", "jointAxis"} & joint.fields.keys() and len(low) <= 1 and len(high) <= 1
        if (len(low) not in (0, 3) or len(high) not in (0, 3)) and not one_axis:
            n = min(len(low), len(high), 3)
            low, high = np.r_[low[:n], np.zeros(3 - n)], np.r_[high[:n], np.zeros(3 - n)]
            joint.fields["llimit"], joint.fields["ulimit"] = np.minimum(low, high), np.maximum(low, high)
            yield f"joint {figure.name(joint)} has three limits, the axes from {n + 1} on are free (D05)"
        elif len(low) == len(high) and (low > high).any():
            joint.fields["llimit"], joint.fields["ulimit"] = np.minimum(low, high), np.maximum(low, high)
            yield f"limits of joint {figure.name(joint)} swapped (D05)"
        stiffness = chart.numbers(joint, "stiffness")
        if ((stiffness < 0) | (stiffness > 1)).any():
            joint.fields["stiffness"] = np.clip(stiffness, 0, 1)
            yield f"stiffness of joint {figure.name(joint)} clamped to 0..1 (D05)"


def _masses(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """D04, on request: no negative mass, an inertia and a centre that the mesh can have."""
    if "D04+" not in wanted:
        return
    chart = figure.chart
    for segment, _ in figure.segments:
        name = figure.name(segment)
        mass, inertia = chart.numbers(segment, "mass"), chart.numbers(segment, "momentsOfInertia")
        if (mass < 0).any():
            segment.fields["mass"] = 0.0
            yield f"mass {mass[0]:g} of segment {name} is 0: not given (D04)"
        points, _complete = segment_points(chart, segment)
        what = wrong_inertia(inertia) if len(inertia) == 9 else "has a wrong count" if len(inertia) else ""
        away = outside(chart, segment)
        kilograms = float(mass[0]) if mass.size and np.isfinite(mass[0]) else 0.0
        if away and len(points):
            segment.fields["centerOfMass"] = (points.min(axis=0) + points.max(axis=0)) / 2
            yield f"centerOfMass of segment {name} is the middle of its mesh (D04)"
        if "symmetric" in what:
            tensor = inertia.reshape(3, 3)
            tensor = (tensor + tensor.T) / 2
            if not wrong_inertia(tensor.reshape(-1)):
                segment.fields["momentsOfInertia"] = tensor.reshape(-1)
                yield f"momentsOfInertia of segment {name} is symmetric (D04)"
                continue
        if what:
            segment.fields["momentsOfInertia"] = _box(points, kilograms)
            yield f"momentsOfInertia of segment {name} is that of a box around its mesh (D04)"


def _box(points: Floats, mass: float) -> Floats:
    """(9,) moments of inertia about its middle of a solid box around points, row by row; zeros without mass."""
    if not len(points):
        return np.zeros(9)
    x, y, z = np.ptp(points, axis=0) ** 2
    return np.diag([y + z, x + z, x + y]).reshape(-1) * max(mass, 0.0) / 12


SCENE_STEPS = (_numbers,)
STEPS = (_limits, _masses)
