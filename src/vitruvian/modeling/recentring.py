"""Joint centres of a fitted surface: what the skin round a joint says of it, when it has left the model's skin.

Free offsets move the skin and leave the bones behind. Near each joint, the offsets are explained by what the shape space
knows to move skin and centre together (its sliders) and by an affine motion of the flesh, both with the spread that is
expected of them; the centre moves by what that explanation says. It is the posterior mean of a linear Gaussian model
(C. Bishop, "Pattern Recognition and Machine Learning", 2006, section 2.3.3).
"""

from __future__ import annotations

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.modeling.bones import Frame
from vitruvian.modeling.likeness import DETAILS, moves
from vitruvian.modeling.template import FACE, Template

NEAR = 200  # points of the skin round a joint
NOISE = 0.010  # metres by which one point of the skin is expected to be off: neighbours err together
SLIDER, DETAIL, SHIFT, STRETCH = 0.1, 0.1, 0.02, 0.05  # spreads of what explains offsets


def recentred(
    template: Template, values: Floats, points: Floats, offset: Floats, centers: Floats, frame: Frame
) -> tuple[Floats, Floats]:
    """(J,3) corrections of joint centres in the A pose and, for the same, of `frame.place` in the scan's pose.

    values (K,): sliders; points (V,3) of the model in the A pose with its bones' sizes, offset (V,3) from there to the
    fitted skin; centers (J,3) in the same pose.
    """
    by_points, by_centers = moves(values, np.arange(len(points), dtype=np.int32))
    count = len(values)
    # details are spent on the surface: what they say of centres is no better than what the offsets say
    spent = np.where(np.arange(count) < DETAILS, 0.0, values)
    offset = offset + np.tensordot(spent, by_points, 1)
    undone = np.tensordot(spent, by_centers, 1)
    spread = np.r_[np.full(DETAILS, SLIDER), np.full(count - DETAILS, DETAIL), np.full(3, SHIFT), np.full(9, STRETCH)]
    weights = template.weights.toarray()
    parents = template.parents
    away = np.zeros_like(centers)  # in the world
    for j, p in enumerate(parents):
        if template.names[j].removeprefix("l_").removeprefix("r_").startswith(FACE):
            away[j] = away[p]
            continue
        family = [j, *np.flatnonzero(parents == j), *([p] if p >= 0 else [])]
        some = np.flatnonzero((weights[:, family].sum(axis=1) > 0.3) & template.heard)
        if len(some) < 20:
            some = np.flatnonzero(template.heard)
        near = some[np.argsort(np.linalg.norm(points[some] - centers[j], axis=1))[:NEAR]]
        cause = np.zeros((len(near), 3, count + 12))
        cause[:, :, :count] = by_points[:, near].transpose(1, 2, 0)
        for a in range(3):
            cause[:, a, count + a] = 1
            cause[:, a, count + 3 * (a + 1) : count + 3 * (a + 2)] = points[near] - centers[j]
        flat = cause.reshape(-1, count + 12) * spread
        right = flat.T @ offset[near].reshape(-1)
        found = spread * np.linalg.solve(flat.T @ flat + NOISE**2 * np.eye(count + 12), right)
        step = found[count : count + 3] + found[:count] @ by_centers[:, j] - undone[j]
        away[j] = (frame.turn[j] + frame.turn[p if p >= 0 else j]) @ step / 2
    # the same bones in both poses
    here = np.zeros_like(centers)
    for j, p in enumerate(parents):
        here[j] = frame.turn[j].T @ away[j] if p < 0 else here[p] + frame.turn[p].T @ (away[j] - away[p])
    return here, away
