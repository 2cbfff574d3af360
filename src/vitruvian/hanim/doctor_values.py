"""The doctor's rules about single values: numbers, axes, scales, limits, masses."""

from __future__ import annotations

import numpy as np

from vitruvian.hanim.doctor import Chart, Floats
from vitruvian.hanim.doctor_figure import Figure
from vitruvian.hanim.doctor_space import segment_points
from vitruvian.hanim.fields import type_of
from vitruvian.hanim.graph import Literal, Node, Use
from vitruvian.hanim.values import COLUMNS, bare

# Number fields of nodes that no table knows, such as humanoids whose prototype stands in another file.
_BY_NAME = {
    "center": "SFVec3f", "translation": "SFVec3f", "scale": "SFVec3f", "rotation": "SFRotation",
    "scaleOrientation": "SFRotation", "limitOrientation": "SFRotation", "centerOfMass": "SFVec3f",
    "point": "MFVec3f", "vector": "MFVec3f", "displacements": "MFVec3f", "coordIndex": "MFInt32", "index": "MFInt32",
    "skinCoordIndex": "MFInt32", "skinCoordWeight": "MFFloat", "llimit": "MFFloat", "ulimit": "MFFloat",
    "stiffness": "MFFloat", "mass": "SFFloat", "momentsOfInertia": "MFFloat", "weight": "SFFloat", "key": "MFFloat",
    "keyValue": "MFFloat", "values": "MFFloat", "cycleInterval": "SFFloat", "frameDuration": "SFFloat",
    "jointBindingPositions": "MFVec3f", "jointBindingRotations": "MFRotation", "jointBindingScales": "MFVec3f",
}  # fmt: skip
AXIS = 1e-2  # how far an axis may be from length 1


def numbers(chart: Chart) -> None:
    """P06: numbers that are not finite, not numbers at all or too few; zero or negative scale; non-unit axes."""
    for node in chart.nodes:
        for field, value in node.fields.items():
            wanted = form_of(chart, node, field)
            if wanted:
                _number(chart, node, field, value, wanted)


def form_of(chart: Chart, node: Node, field: str) -> str:
    """Type of a field that holds numbers ("MFVec3f"), "" for all others."""
    key = (id(node) if node.interface else node.type, field)
    form = chart.forms.get(key)
    if form is None:
        form = type_of(node, field, chart.reading.protos) or _BY_NAME.get(field, "")
        form = chart.forms[key] = form if form[2:] in COLUMNS else ""
    return form


def single(form: str) -> int:
    """How many numbers a field of this type has, 0 for as many as there are."""
    return COLUMNS[form[2:]] if form.startswith("SF") else 0


def _number(chart: Chart, node: Node, field: str, value: object, wanted: str) -> None:
    kind = chart.reading.kind(node)
    if isinstance(value, Node | Use) or (isinstance(value, list) and not kind):
        return
    array = chart.numbers(node, field)
    bad = np.flatnonzero(~np.isfinite(array))
    line = value.line if isinstance(value, Literal) else 0
    if bad.size:
        chart.add("P06", node, f"{field}: entry {bad[0]} is not a finite number", "give a number", line)
    elif wanted.endswith("Int32") and not whole(value, array):
        chart.add("P06", node, f"{field}: expected whole numbers of 32 bits", "give whole numbers", line)
    elif single(wanted) and kind and len(array) not in (0, single(wanted)):
        message = f"{field}: expected {single(wanted)} numbers, found {len(array)}"
        chart.add("P06", node, message, "give the right count", line)
    elif kind and field == "scale" and (array <= 0).any():
        factors = " ".join(f"{v:g}" for v in array)
        message = f"scale {factors}: zero collapses, negative turns the surface inside out"
        chart.add("P06", node, message, "give a positive scale", line)
    elif kind and wanted == "SFRotation" and len(array) == 4 and array[3] != 0:
        size = float(np.linalg.norm(array[:3]))
        if abs(size - 1) > AXIS:
            message = f"{field}: the axis has length {size:.3g}, expected 1"
            chart.add("P06", node, message, "normalise the axis" if size else "give an axis", line)


def whole(value: object, array: Floats) -> bool:
    """Whether finite numbers are whole ones of 32 bits, and written so."""
    fraction = isinstance(value, Literal) and any(
        c in word for word in bare(value).split() if word[:2].lower() != "0x" for c in ".eE"
    )
    return not fraction and bool(((array == np.floor(array)) & (array >= -(2.0**31)) & (array < 2.0**31)).all())


def limits(figure: Figure) -> None:
    """D05: limits and stiffness."""
    chart, add = figure.chart, figure.chart.add
    for joint in figure.joints:
        low, high = chart.numbers(joint, "llimit"), chart.numbers(joint, "ulimit")
        one_axis = {"jointType", "jointAxis"} & joint.fields.keys() and len(low) <= 1 and len(high) <= 1
        if (len(low) not in (0, 3) or len(high) not in (0, 3)) and not one_axis:  # robots turn about one axis
            message = f"llimit and ulimit have {len(low)} and {len(high)} numbers, expected 0 or 3"
            add("D05", joint, message, "give three")
        elif len(low) == len(high) and (low > high).any():
            add("D05", joint, "llimit is above ulimit", "swap them")
        stiffness = chart.numbers(joint, "stiffness")
        if ((stiffness < 0) | (stiffness > 1)).any():
            add("D05", joint, "stiffness is outside 0..1", "clamp it")


def masses(figure: Figure) -> None:
    """D04: masses, inertias and centres of mass that no body can have."""
    chart, add = figure.chart, figure.chart.add
    for segment, _ in figure.segments:
        mass, inertia = chart.numbers(segment, "mass"), chart.numbers(segment, "momentsOfInertia")
        if (mass < 0).any():
            add("D04", segment, f"mass {mass[0]:g} is negative", "give a mass of 0 or more")
        if len(inertia) not in (0, 9):
            add("D04", segment, f"momentsOfInertia has {len(inertia)} numbers, expected 9", "give nine, row by row")
        elif len(inertia) == 9 and (what := wrong_inertia(inertia)):
            fix = "symmetrise it" if "symmetric" in what else "recompute it from the mesh"
            add("D04", segment, f"momentsOfInertia {what}", fix)
        if outside(chart, segment):
            center = " ".join(f"{v:g}" for v in chart.numbers(segment, "centerOfMass"))
            add("D04", segment, f"centerOfMass {center} is outside the segment's mesh", "recompute it from the mesh")


def wrong_inertia(inertia: Floats) -> str:
    """What is wrong with nine moments of inertia, "" when a solid can have them."""
    if not np.isfinite(inertia).all():
        return ""
    tensor = inertia.reshape(3, 3)
    size = max(float(np.abs(tensor).max()), 1e-12)
    if np.abs(tensor - tensor.T).max() > 1e-3 * size:
        return "is not symmetric"
    moments = np.linalg.eigvalsh((tensor + tensor.T) / 2 / size)
    return "belongs to no solid" if moments[0] < -1e-6 or moments[0] + moments[1] < moments[2] * (1 - 1e-3) else ""


def outside(chart: Chart, segment: Node) -> bool:
    """Whether a centre of mass is given (0 0 0 and -1 -1 -1 mean that it is not) and lies outside the mesh's box."""
    center = chart.numbers(segment, "centerOfMass")
    if center.size != 3 or not np.isfinite(center).all() or not center.any() or (center == -1).all():
        return False
    points, complete = segment_points(chart, segment)
    if not len(points) or not complete:
        return False
    low, high = points.min(axis=0), points.max(axis=0)
    slack = float((high - low).max())  # a segment cut out of a skin may be a scrap of its part
    return bool(((center < low - slack) | (center > high + slack)).any())
