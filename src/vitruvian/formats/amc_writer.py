"""ASF and AMC written: any skeleton as Acclaim's bones.

A bone runs from its joint to the only joint or the Site below it. Where a joint has several below it, its own bone has no
length and a bone without freedom, named after both, leads to each. Source: note motion.md, 3.2.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from vitruvian.body.rotations import inverse, multiply, to_euler
from vitruvian.body.types import Floats
from vitruvian.formats.atomic import atomic
from vitruvian.motion.types import Motion

_SCALE = 0.0254 / 0.45  # metres per unit, CMU's


def write_amc(motion: Motion, path: str | os.PathLike[str]) -> dict[str, Any]:
    """Write a clip as AMC with its ASF beside it, of the same name; CMU's length unit and degrees.

    Joint limits are written for joints that have them about all three axes, in the frame of `limit_orientation`.
    The report: {"files": [...], "lost": what the pair can't hold}. Each file is complete or absent.
    """
    path = Path(path)
    s = motion.skeleton
    parents = np.where((s.parents < 0) & (np.arange(len(s)) > 0), 0, s.parents)
    names = _names(s.names)
    below: list[list[int]] = [[] for _ in names]
    for j, p in enumerate(parents):
        if p >= 0:
            below[p].append(j)
    bones: list[str] = []
    tree: dict[str, list[str]] = {}
    used = set(names)
    order: list[int] = []
    stack = [(0, "root")]
    while stack:
        j, holder = stack.pop()
        arm = np.zeros(3)
        sites = np.flatnonzero(s.site_joints == j)
        alone = j > 0 and len(below[j]) == 1
        if alone:
            arm = s.centers[below[j][0]] - s.centers[j]
        elif j > 0 and not below[j] and sites.size:
            arm = s.site_points[sites[0]] - s.centers[j]
        if j > 0:
            order.append(j)
            bones.append(_bone(len(bones) + 1, names[j], arm, motion, j))
            tree.setdefault(holder, []).append(names[j])
        own = names[j] if j else "root"
        for child in reversed(below[j]):
            if alone:
                stack.append((child, own))
                continue
            link = f"{own}_to_{names[child]}"
            while link in used:
                link += "_"
            used.add(link)
            bones.append(_bone(len(bones) + 1, link, s.centers[child] - s.centers[j], None, -1))
            tree.setdefault(own, []).append(link)
            stack.append((child, link))
    start = " ".join(f"{v:.6f}" for v in s.centers[0] / _SCALE + 0.0)
    head = ["# skeleton written by vitruvian", ":version 1.10", f":name {'_'.join((motion.name or 'figure').split())}"]
    head += [":units", "  mass 1.0", "  length 0.45", "  angle deg", ":documentation", "  joints as bones", ":root"]
    head += ["  order TX TY TZ RX RY RZ", "  axis XYZ", f"  position {start}", "  orientation 0 0 0", ":bonedata"]
    hierarchy = [f"    {holder} {' '.join(bones_below)}" for holder, bones_below in tree.items()]
    with atomic(path.with_suffix(".asf")) as temporary:
        lines = [*head, *bones, ":hierarchy", "  begin", *hierarchy, "  end", ""]
        temporary.write_text("\n".join(lines), encoding="utf-8", newline="\n")
    root = np.concatenate([motion.translation / _SCALE, _angles(motion.rotation[:, 0])], axis=1)
    columns = [("root", root)]
    columns += [(names[j], _angles(_in_frame(motion, j))) for j in order]
    forms = [f"{name} " + " ".join(["%.6f"] * table.shape[1]) for name, table in columns]
    form = "\n".join(forms) + "\n"
    wide = np.concatenate([table for _, table in columns], axis=1) + 0.0
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write(":FULLY-SPECIFIED\n:DEGREES\n")
        file.writelines(f"{f}\n" + form % tuple(row) for f, row in enumerate(wide.tolist(), 1))
    lost = [f"the rate of {motion.fps:g} frames a second: AMC holds none"]
    if motion.joint_translation is not None:
        lost.append("translations of joints other than the root")
    if motion.weights:
        lost.append(f"{len(motion.weights)} weights of displacers")
    return {"files": [str(path), str(path.with_suffix(".asf"))], "lost": lost}


def _names(names: tuple[str, ...]) -> list[str]:
    """One word each, unique, not a number and not `root`, but for the first."""
    out: list[str] = []
    for j, name in enumerate(names):
        word = (
            "_".join(name.replace("(", "_").replace(")", "_").replace("#", "_").replace(":", "_").split())
            or f"joint{j}"
        )
        word = f"_{word}" if word.isdigit() or (j and word.lower() in ("root", "begin", "end")) else word
        while word in out:
            word += "_"
        out.append(word)
    return out


def _bone(number: int, name: str, arm: Floats, motion: Motion | None, j: int) -> str:
    length = float(np.linalg.norm(arm))
    direction = arm / length if length > 0 else np.array([0.0, 1.0, 0.0])
    lines = ["  begin", f"     id {number}", f"     name {name}"]
    lines.append("     direction " + " ".join(f"{v:.9g}" for v in direction + 0.0))
    lines.append(f"     length {length / _SCALE:.9g}")
    angles = np.zeros(3)
    limits: Floats | None = None
    if motion is not None:
        angles = np.degrees(to_euler(motion.skeleton.limit_orientation[j], "ZYX"))[::-1]
        limits = np.degrees(motion.skeleton.limits[j])
    lines.append("     axis " + " ".join(f"{v:.9g}" for v in angles + 0.0) + " XYZ")
    if limits is not None:
        lines.append("    dof rx ry rz")
        if np.isfinite(limits).all():
            pairs = [f"({low:.9g} {high:.9g})" for low, high in limits]
            lines += [f"    limits {pairs[0]}", *(f"           {p}" for p in pairs[1:])]
    return "\n".join([*lines, "  end"])


def _in_frame(motion: Motion, j: int) -> Floats:
    """Local turns (F,4) of a joint in the frame of its limits: M of C M C^-1."""
    c = motion.skeleton.limit_orientation[j]
    return multiply(multiply(inverse(c), motion.rotation[:, j]), c)


def _angles(turns: Floats) -> Floats:
    """Degrees (F,3) about X, Y, Z, X applied first, continuous in time."""
    return np.degrees(to_euler(turns, "ZYX", continuous=True))[:, ::-1]
