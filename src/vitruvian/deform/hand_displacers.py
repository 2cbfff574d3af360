"""Hands as displacers: what the hand operator adds to plain skin, sampled over the angle of each joint.

A body with these shows knuckles and swelling palms wherever displacers work. Each joint's samples are taken with that
joint alone bent, so that several bent joints are nearly, not exactly, what the operator gives.

Source: ISO/IEC 19774-1, Displacer; the operator is that of `hands`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vitruvian.body.types import Floats, Ints, Morph, Skeleton
from vitruvian.deform.deformer import Deformer
from vitruvian.deform.hands import HandOperator
from vitruvian.deform.local import Displaced, angles_of, turned
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import Displacer, Humanoid

LEAST = 2e-5  # metres; smaller offsets are left out


def hand_displacers(deformer: Deformer, degrees: Sequence[float] = (30.0, 60.0, 90.0)) -> tuple[Displaced, ...]:
    """One operator for each joint of the hands that bends a finger: offsets from the base operator, at these flexions.

    `deformer`: one with hands. Raises VitruvianError for another and for angles that do not grow from zero.
    """
    operator = deformer.operator
    if not isinstance(operator, HandOperator):
        raise VitruvianError(f"hand_displacers: expected a deformer with hands, found {deformer.name!r}")
    samples = np.radians(np.asarray(degrees, np.float64))
    if not len(samples) or samples[0] <= 0 or (np.diff(samples) <= 0).any() or samples[-1] > np.pi:
        raise VitruvianError(f"degrees: expected growing angles in 0..180, found {list(degrees)}")
    body = deformer.body
    out = []
    for program in operator.programs:
        hand = program.hand
        previous = hand.before_links()
        for link in np.flatnonzero(previous >= 0).tolist():
            joint, axis = int(hand.near[link]), hand.axis_near[link]
            own = np.array([joint], np.int32)
            matrices = turned(body.skeleton, own, samples[:, None, None] * axis)
            both = np.empty((2, len(samples), len(body.skin.rest), 3), np.float32)
            operator.points(matrices, both[0])
            operator.base.points(matrices, both[1])
            moved = both[0, :, hand.vertices].astype(np.float64) - both[1, :, hand.vertices]  # (N, s, 3)
            some = np.linalg.norm(moved, axis=2).max(axis=1) > LEAST
            local = np.einsum("sba,nsb->sna", matrices[:, joint, :3, :3], moved[some])
            anchor = int(body.skeleton.parents[joint])
            name = body.skeleton.names[joint]
            out.append(Displaced(name, hand.vertices[some], own, anchor, axis, samples, local))
    return tuple(out)


def displacer_weights(displacers: Sequence[Displaced], skeleton: Skeleton, matrices: Floats) -> dict[str, Floats]:
    """Displacer name -> weight (F,) in poses given by joint matrices (F,J,4,4)."""
    out: dict[str, Floats] = {}
    for d in displacers:
        weights = d.weights(angles_of(skeleton, d.joints, matrices)[:, 0])
        out |= {name: weights[:, k] for k, name in enumerate(_names(d))}
    return out


def _names(d: Displaced) -> list[str]:
    return [f"{d.name}_{round(float(np.degrees(a))):03d}_action" for a in d.samples]


def as_morphs(displacers: Sequence[Displaced]) -> tuple[Morph, ...]:
    """The samples as displacers of a packed body, named by joint and angle ("l_metacarpophalangeal_2_060_action")."""
    return tuple(
        Morph(name, d.domain, d.offsets[k], int(d.joints[0])) for d in displacers for k, name in enumerate(_names(d))
    )


def add_displacers(humanoid: Humanoid, displacers: Sequence[Displaced], vertices: Ints | None = None) -> Humanoid:
    """A copy of a humanoid with a skin that has them as Displacers of its joints, weight 0.

    `vertices` (V,): of which point of `skin_coord` each vertex of the packed body is a copy, when they differ.
    Raises VitruvianError for a humanoid without those joints or points.
    """
    made = humanoid.copied()
    joints = {j.name: j for j in made.joints()}
    for d, m in zip([each for each in displacers for _ in each.samples], as_morphs(displacers), strict=True):
        index = m.index if vertices is None else vertices[m.index]
        if d.name not in joints or len(index) and int(index.max()) >= len(made.skin_coord):
            raise VitruvianError(f"joint {d.name}: expected it and a skin of {int(index.max()) + 1} points, found none")
        joint = joints[d.name]
        joint.displacers = [*joint.displacers, Displacer(m.name, index.astype(np.int32), m.offset)]
    return made
