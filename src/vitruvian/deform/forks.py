"""Sections of the "volume" operator where a limb goes on straight into several bones, as the forearm into the palm.

Skin past such a joint lies on different bones, which all turn with it, and got its weights from each by itself. Until the
bones part, sections are laid about one line, as on a limb of one bone: from the joint to the middle of the skin beyond it.
In them, what moves with the joint or anything below it is made even; how these share it among them stays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.rotations import unit
from vitruvian.body.types import Body, Floats
from vitruvian.deform.bind import Influences

STRAIGHT = 0.9  # cosine between the bone before and the line beyond
STEPS = 8  # stations on the line; as many before the joint, as far apart
BEFORE = 0.25  # of the line, before the joint: from there its sections are taken over
PART = (0.35, 0.85)  # of the line: bones begin to part, and have
WIDE = (1.8, 2.4)  # mean radii at the joint: so far from the line sections are those of another limb (thumb)
ROUND = 3  # times that the shares of a station are mixed with its neighbours'


def forked(
    body: Body, rows: Influences, center: Floats, radius: Floats, area: Floats
) -> tuple[Floats, Floats, Influences]:
    """The centres (V,3), radii (V,) and influences of sections, for those that know of no forks; `area` (V,) is what each
    vertex stands for, m2."""
    rest, weight, vertex = body.skin.rest, rows.weight.copy(), rows.vertex
    total = np.bincount(vertex, weight, minlength=len(rows))
    whole = np.where(total > 0, total, 1.0)
    for joint, under, line in forks(body, rows, area):
        start, inner = body.skeleton.centers[joint], under[rows.joint]
        own = np.bincount(vertex, weight * inner, minlength=len(rows))
        limb = own + np.bincount(vertex, weight * (rows.joint == body.skeleton.parents[joint]), minlength=len(rows))
        along = (rest - start) @ line / (line @ line)
        mine = (limb > 0.5 * total) & (np.abs(along) < 1)
        if not mine.any():
            continue
        place = np.clip((along + 1) * STEPS, 0, 2 * STEPS)
        before = np.minimum(place.astype(np.int64), 2 * STEPS - 1)
        part, share = place - before, own / whole
        sums = np.zeros((2, 2 * STEPS + 1))
        for at, near in ((before, 1 - part), (before + 1, part)):
            for k, values in enumerate((area * near, area * near * share)):
                sums[k] += np.bincount(at[mine], values[mine], minlength=2 * STEPS + 1)
        known = np.flatnonzero(sums[0] > 0)
        mean = np.interp(np.arange(2 * STEPS + 1), known, sums[1][known] / sums[0][known])
        for _ in range(ROUND):
            mean[1:-1] = mean[1:-1] / 2 + (mean[:-2] + mean[2:]) / 4
        away = np.linalg.norm(rest - start - along[:, None] * line, axis=1)
        near = mine * area * np.maximum(1 - np.abs(along) * STEPS, 0)
        thick = float(near @ away) / max(float(near.sum()), 1e-12)
        even = (
            mine
            * _smooth(along, -BEFORE, 0)
            * (1 - _smooth(along, *PART))
            * (1 - _smooth(away / max(thick, 1e-9), *WIDE))
        )
        goal = share + even * ((1 - part) * mean[before] + part * mean[before + 1] - share)
        inside = np.where((share > 0) & (share < 1), goal / np.where(share > 0, share, 1), 1.0)
        outside = np.where((share > 0) & (share < 1), (1 - goal) / np.where(share < 1, 1 - share, 1), 1.0)
        weight *= np.where(inner, inside[vertex], outside[vertex])
        center = center + even[:, None] * (start + along[:, None] * line - center)
        radius = radius + even * (away - radius)
    order = np.lexsort((rows.joint, -weight, vertex))
    return center, radius, Influences(rows.row, rows.joint[order], weight[order], rows.joints)


def forks(body: Body, rows: Influences, area: Floats) -> list[tuple[int, NDArray[np.bool_], Floats]]:
    """Joints at which a limb goes on straight into several bones; (J+1,) which joints are that or below it; and the line
    (3,) from the joint to the middle of their skin."""
    parents, centers = body.skeleton.parents, body.skeleton.centers
    below = np.bincount(parents[parents >= 0], minlength=len(parents))
    out = []
    for joint in np.flatnonzero(below > 1):
        if parents[joint] < 0 or below[parents[joint]] != 1:
            continue
        under = np.zeros(rows.joints + 1, bool)
        under[joint] = True
        for k in range(joint + 1, len(parents)):  # parents come first
            under[k] = parents[k] >= 0 and under[parents[k]]
        load = np.bincount(rows.vertex, rows.weight * under[rows.joint], minlength=len(rows)) * area
        if load.sum() <= 0:
            continue
        line = (load @ body.skin.rest) / load.sum() - centers[joint]
        into = centers[joint] - centers[parents[joint]]
        size = np.linalg.norm([line, into], axis=1)
        if 1e-6 < size[0] < size[1] and unit(line) @ unit(into) > STRAIGHT:
            out.append((int(joint), under, line))
    return out


def _smooth(x: Floats, low: float, high: float) -> Floats:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)
