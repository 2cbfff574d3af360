"""Where the panels of a pattern hang around a body before they are sewn.

Source: note cloth.md, section 5; seed 003, section 5.1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.rotations import between, from_vector, multiply
from vitruvian.body.types import Body, Floats, Ints
from vitruvian.cloth.pattern import Panel, Pattern, area, placed
from vitruvian.deform.deformer import deformer
from vitruvian.errors import VitruvianError

ARMS = np.radians(30.0)  # below the horizontal: higher than the 45 of most patterns, so that armpits do not crease
LEGS = np.radians(4.0)
CLEARANCE = 0.01  # metres between a panel and the skin
FARTHEST = 0.5  # metres that a panel may have to be moved to clear the body
Distance = Callable[[Floats], Floats]  # points (n,3) -> (n,) signed metres, negative inside


@dataclass(frozen=True, eq=False)
class Dummy:
    """The body that clothes are sewn on: its surface in a pose that leaves room for them.

    matrices (J,4,4) of the joints, vertices (V,3) of the body's whole skin under them, and the triangles (T,3) of its
    largest piece, which clothes touch: not those of eyes, brows and hair.
    """

    body: Body
    matrices: Floats
    vertices: Floats
    triangles: Ints


def dummy(body: Body, *, arms: float = ARMS, legs: float = LEGS) -> Dummy:
    """A body with its arms `arms` radians below the horizontal and its legs `legs` radians apart each, so that there is
    room for cloth; its other joints at rest.

    Raises VitruvianError for a body without shoulders and elbows or without skin.
    """
    skeleton = body.skeleton
    missing = [n for n in ("l_shoulder", "r_shoulder", "l_elbow", "r_elbow") if n not in skeleton.index]
    if missing or not len(body.skin.triangles):
        what = f"joint {missing[0]}" if missing else "a skin"
        raise VitruvianError(f"clothes need a body with {what}, found none")
    rotation = np.tile([0.0, 0.0, 0.0, 1.0], (1, len(skeleton), 1))
    for side, sign in (("l", 1.0), ("r", -1.0)):
        shoulder, elbow = (skeleton.index[f"{side}_{n}"] for n in ("shoulder", "elbow"))
        bone = skeleton.centers[elbow] - skeleton.centers[shoulder]
        flat = np.hypot(*bone[:2])
        lowered = np.array([sign * np.cos(arms) * flat, -np.sin(arms) * flat, bone[2]])
        rotation[0, shoulder] = multiply(between(bone, lowered), rotation[0, shoulder])
        hip = skeleton.index.get(f"{side}_hip")
        if hip is not None:
            rotation[0, hip] = from_vector(np.array([0.0, 0.0, sign * legs]))
    matrices = pose_matrices(skeleton, rotation, np.zeros((1, len(skeleton), 3)))[0]
    vertices = np.asarray(deformer("log", body)(matrices), np.float64)
    return Dummy(body, matrices, vertices, _largest(body.skin.triangles, len(vertices)))


def _largest(triangles: Ints, count: int) -> Ints:
    """Those triangles that hang together with most others."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    a, b = triangles[:, [0, 1]].ravel(), triangles[:, [1, 2]].ravel()
    piece = connected_components(coo_array((np.ones(len(a)), (a, b)), (count, count)), directed=False)[1]
    of = piece[triangles[:, 0]]
    return triangles[of == np.bincount(of).argmax()]


def outward(panel: Panel) -> Floats:
    """(3,) unit: which way a panel that has a place faces, away from the body."""
    if panel.rotation is None:
        raise ValueError(f"panel {panel.name}: expected a place")
    return panel.rotation[:, 2] * (1.0 if area(panel) > 0 else -1.0)


def hung(pattern: Pattern, material: Floats, panel: Ints, distance: Distance) -> Floats:
    """(n,3) metres: where points `material` (n,2) of panels `panel` (n,) hang, each panel moved outwards, or rolled wider,
    until it is clear of the body. Raises VitruvianError for a panel that would have to go too far."""
    out = np.empty((len(material), 3))
    for k, piece in enumerate(pattern.panels):
        mine = panel == k
        if piece.rotation is None or piece.translation is None:
            raise VitruvianError(f"panel {piece.name}: expected a place around the body, found none")
        points, moved = placed(piece, material[mine]), 0.0
        while mine.any():
            short = CLEARANCE - float(distance(points).min())
            if short <= 0:
                break
            moved += max(short, 0.005)
            if moved > FARTHEST:
                raise VitruvianError(
                    f"panel {piece.name}: it is still inside the body {FARTHEST:g} m away from its place; is the unit "
                    "right, and does it face outwards?"
                )
            points = placed(_out(piece, moved), material[mine])
        out[mine] = points
    return out


def _out(panel: Panel, moved: float) -> Panel:
    """A panel moved outwards by so many metres; one that is rolled keeps its axis and gets that much wider."""
    assert panel.translation is not None
    bend = panel.bend / (1 + moved * float(np.hypot(*panel.bend)))
    return replace(panel, translation=panel.translation + moved * outward(panel), bend=bend)
