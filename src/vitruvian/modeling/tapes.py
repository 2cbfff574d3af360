"""Feature contours: the tapes of girths where they lie on a surface, in its own unit and axes, and their files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vitruvian.body.types import Floats
from vitruvian.errors import VitruvianError
from vitruvian.hanim.graph import Node
from vitruvian.hanim.humanoid import Humanoid, Joint, Segment, Site
from vitruvian.modeling.figures import humanoid_figure, surface_frame
from vitruvian.modeling.measures import GIRTHS, figure_of, taken
from vitruvian.modeling.scans import Surface


@dataclass(frozen=True, eq=False)
class Tape:
    """A feature contour: `length` in metres and the corners `points` (N,3) of the closed line, the first not repeated."""

    length: float
    points: Floats


def tapes(
    body: Humanoid | Surface, landmarks: Mapping[str, ArrayLike] | None = None, *, unit: str | None = None
) -> dict[str, Tape]:
    """The girths of a body, name (with `l_`, `r_` on limbs) -> tape, points in the body's own unit and axes.

    As `vitruvian.modeling.measures.measures`, of which these are the girths: landmarks None are Sites, or looked for on
    a surface. Raises VitruvianError where there are no feature points for any.
    """
    if isinstance(body, Humanoid):
        places = None if landmarks is None else {n: np.asarray(p, np.float64) for n, p in landmarks.items()}
        figure, turn, metres = humanoid_figure(body, places), np.eye(3), 1.0
    else:
        from vitruvian.modeling.landmarks import detect

        given = {n: p for n, (p, _) in detect(body).items()} if landmarks is None else dict(landmarks)
        turn, metres, places = surface_frame(given, unit)
        points = np.asarray(body.vertices, np.float64) @ turn.T * metres
        figure = figure_of(points, body.triangles, {n: turn @ p * metres for n, p in places.items()})
    found = taken(figure, GIRTHS)
    if not found.contours:
        raise VitruvianError("girths: expected feature points such as l_thelion and r_thelion, found none that serve")
    return {n: Tape(_around(line), line / metres @ turn) for n, line in found.contours.items()}


def _around(line: Floats) -> float:
    return float(np.linalg.norm(np.roll(line, -1, axis=0) - line, axis=1).sum())


def to_json(found: Mapping[str, Tape]) -> str:
    """Tapes as JSON, {name: {"girth_m": metres, "points": [[x, y, z], ...]}}, points in the body's own unit and axes."""
    document = {n: {"girth_m": t.length, "points": np.round(t.points, 6).tolist()} for n, t in found.items()}
    return json.dumps(document, indent=1)


def as_sites(humanoid: Humanoid, found: Mapping[str, Tape]) -> list[str]:
    """Hang tapes, metres in humanoid space at rest, into a humanoid as Sites `NAME_contour_pt`; answers their names.

    A Site stands in the middle of its tape, on the Segment of the joint that the skin there follows, and holds the tape
    as a closed line, so that it moves with the body. One that is there already is replaced.
    """
    joints = humanoid.joints()
    if not joints:
        raise VitruvianError(f"humanoid {humanoid.name!r}: expected joints to hang contours on, found none")
    names = []
    for name, tape in found.items():
        middle = tape.points.mean(axis=0)
        joint = _joint_at(humanoid, joints, tape.points)
        if not joint.segments:
            joint.segments.append(Segment(name=f"{joint.name}_segment"))
        title = f"{name}_contour_pt"
        for segment in humanoid.segments():
            segment.sites[:] = [s for s in segment.sites if s.name != title]
        closed = np.array([*range(len(tape.points)), 0, -1], np.int32)
        coord = Node("Coordinate", fields={"point": tape.points - middle})
        lines = Node("IndexedLineSet", fields={"coordIndex": closed, "coord": coord})
        paint = Node("Material", fields={"emissiveColor": np.array([0.85, 0.2, 0.1])})
        shape = Node("Shape", fields={"appearance": Node("Appearance", fields={"material": paint}), "geometry": lines})
        joint.segments[0].sites.append(Site(name=title, translation=middle, children=[shape]))
        names.append(title)
    return names


def _joint_at(humanoid: Humanoid, joints: list[Joint], line: Floats) -> Joint:
    """The joint that the skin along a line follows most; where there is no skin, the one that is nearest."""
    middle = line.mean(axis=0)
    skin = np.asarray(humanoid.skin_coord, np.float64)
    if len(skin):
        from scipy.spatial import cKDTree

        near = cKDTree(skin).query(line)[1]
        share = np.zeros(len(joints))
        for k, joint in enumerate(joints):
            weight = np.zeros(len(skin))
            np.add.at(weight, joint.skin_coord_index, joint.skin_coord_weight)
            share[k] = weight[near].sum()
        if share.max() > 0:
            return joints[int(np.argmax(share))]
    away = [float(np.linalg.norm(np.asarray(j.center) - middle)) for j in joints]
    return joints[int(np.argmin(away))]
