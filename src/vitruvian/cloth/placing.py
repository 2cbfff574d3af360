"""Where the panels of a pattern hang around a body before they are sewn.

Source: note cloth.md, section 5; seed 003, section 5.1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.rotations import between, from_vector, multiply
from vitruvian.body.types import Body, Floats, Ints
from vitruvian.cloth.pattern import Panel, Pattern, area, length, placed
from vitruvian.cloth.tessellate import PanelMesh
from vitruvian.deform.deformer import deformer
from vitruvian.errors import VitruvianError

ARMS = np.radians(10.0)  # below the horizontal, nearly a T: cloth under raised arms does not crease in the armpits
LEGS = np.radians(4.0)
CLEARANCE = 0.01  # metres between a panel and the skin
WAIST, SHOULDERS = "lower_interface", ("collar", "armhole", "strapless_top")  # labels of edges
BAND, THICK = 0.06, 0.003  # metres: what of a waist has to fit, and what it stands off the skin
BARE = 0.8  # of a body's height that its skin is high in one piece
FARTHEST = 0.5  # metres that a panel may have to be moved to clear the body
RISES = np.arange(0, 0.125, 0.01)  # metres by which a pattern may be raised
DEAR = 1.0  # what a metre of that costs, in metres that seams are deep in the body
ROOM = 0.02  # metres from the skin at which a seam closes freely
UP = np.array([0.0, 1.0, 0.0])
Distance = Callable[[Floats], Floats]  # points (n,3) -> (n,) signed metres, negative inside
Move = Callable[[Floats], Floats]  # points (n,3) -> (n,3) metres


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

    def at(self, joint: str) -> Floats:
        """(3,) metres: where a joint is."""
        skeleton = self.body.skeleton
        k = skeleton.index[joint]
        return self.matrices[k, :3, :3] @ skeleton.centers[k] + self.matrices[k, :3, 3]


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
    return posed(body, pose_matrices(skeleton, rotation, np.zeros((1, len(skeleton), 3)))[0])


def posed(body: Body, matrices: Floats) -> Dummy:
    """A body under matrices (J,4,4) of its joints."""
    vertices = np.asarray(deformer("log", body)(matrices), np.float64)
    triangles = largest(body.skin.triangles, len(vertices))
    tall, whole = (float(np.ptp(vertices[t, 1])) for t in (triangles, body.skin.triangles))
    if tall < BARE * whole:
        raise VitruvianError(
            f"clothes need a bare body in one piece: the largest piece of this one is {tall:.2f} m of its {whole:.2f} m "
            "tall; is it dressed already (`vitruvian person --outfit none` makes one that is not), or in segments?"
        )
    return Dummy(body, matrices, vertices, triangles)


def largest(triangles: Ints, count: int) -> Ints:
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


def hung(pattern: Pattern, mesh: PanelMesh, mannequin: Dummy, distance: Distance) -> Floats:
    """(n,3) metres: where the vertices of the panels hang around the body before they are sewn.

    Patterns were drawn around another body in another pose. Sleeves are turned and moved to the arm's axis, the other
    panels raised until no seam closes through the body, a shoulder's say; and each panel is moved outwards, or rolled
    wider, until it is clear of the body. Raises VitruvianError for a panel without a place or that would have to go too
    far.
    """
    arm = np.array([_arm(p) for p in pattern.panels])
    moves: list[Move] = [_nowhere] * len(arm)
    first = _cleared(pattern, mesh, distance, moves)
    of = arm[mesh.panel[mesh.pairs]]
    a, b = (first[k] for k in mesh.pairs[(of == 0).all(axis=1)].T)
    share = np.linspace(0.1, 0.9, 7)[:, None, None]
    way = (((1 - share) * a + share * b).reshape(-1, 3) + RISES[:, None, None] * UP).reshape(-1, 3)
    blocked = np.maximum(ROOM - distance(way), 0).reshape(len(RISES), -1).sum(axis=1)
    cost = blocked + DEAR * RISES + _squeezed(pattern, mesh, first, mannequin)
    rise = RISES[int(np.argmin(cost))] * UP
    moves = [lambda x: x + rise] * len(arm)
    for sign, side in ((1, "l"), (-1, "r")):
        mine = arm == sign
        own = (of == sign).all(axis=1)
        if own.any():
            move = _sleeve(
                first, first[mine[mesh.panel]].mean(axis=0), mesh.pairs[own], mesh.seam[own], mannequin, side
            )
            moves = [move if m else old for m, old in zip(mine, moves)]
    return _cleared(pattern, mesh, distance, moves)


def waist(pattern: Pattern, mesh: PanelMesh) -> Ints:
    """Vertices of the edges that a garment without shoulders hangs by; none for others."""
    labels = {e.label for p in pattern.panels for e in p.edges}
    if any(label.endswith(SHOULDERS) for label in labels):
        return np.zeros(0, np.int32)
    named = [(k, i) for k, p in enumerate(pattern.panels) for i, e in enumerate(p.edges) if e.label == WAIST]
    return np.unique(np.concatenate([np.zeros(0, np.int32), *(mesh.edges[key] for key in named)]))


def _squeezed(pattern: Pattern, mesh: PanelMesh, points: Floats, mannequin: Dummy) -> Floats:
    """Metres by which the body is wider round than the band of a garment that hangs by its waist, for each of `RISES`."""
    top = waist(pattern, mesh)
    if not len(top):
        return np.zeros(len(RISES))
    edges = [(p, i) for p in pattern.panels for i, e in enumerate(p.edges) if e.label == WAIST]
    long = sum(length(p, i) for p, i in edges)
    band = np.isin(mesh.panel, np.unique(mesh.panel[top]))
    high = float(points[top, 1].mean())
    low = max(float(points[band, 1].min()), high - BAND)
    girths = [max(_girth(mannequin, y + r) for y in (low, 0.5 * (low + high), high)) for r in RISES]
    return np.maximum(np.array(girths) + 2 * np.pi * THICK - long, 0)


def _girth(mannequin: Dummy, height: float) -> float:
    """Metres round the trunk at that height, as a tape lies."""
    from scipy.spatial import ConvexHull, QhullError

    p = mannequin.vertices[mannequin.triangles]
    above = p[:, :, 1] > height
    met = above.any(axis=1) & ~above.all(axis=1)
    p, above = p[met], above[met]
    a, b = p.reshape(-1, 3), np.roll(p, -1, axis=1).reshape(-1, 3)
    cut = (above != np.roll(above, -1, axis=1)).ravel()
    share = ((height - a[cut, 1]) / (b[cut, 1] - a[cut, 1]))[:, None]
    flat = (a[cut] + share * (b[cut] - a[cut]))[:, [0, 2]]
    flat = flat[np.abs(flat[:, 0]) < 0.7 * abs(mannequin.at("l_elbow")[0])]  # not the arms
    try:
        return float(ConvexHull(flat).area)
    except (QhullError, ValueError):
        return 0.0


def _nowhere(points: Floats) -> Floats:
    return points


def _sleeve(points: Floats, middle: Floats, pairs: Ints, seam: Ints, mannequin: Dummy, side: str) -> Move:
    """How a sleeve, whose seams run along it, is brought to the arm: turned and moved in the plane that one sees from the
    front."""
    shoulder, elbow = mannequin.at(f"{side}_shoulder")[:2], mannequin.at(f"{side}_elbow")[:2]
    bone = (elbow - shoulder) / np.linalg.norm(elbow - shoulder)
    along = np.zeros(2)
    for k in np.unique(seam):
        ends = points[pairs[seam == k][[0, -1]]].mean(axis=1)[:, :2]
        chord = ends[1] - ends[0]
        along += chord * np.sign(chord @ bone)
    along /= max(float(np.linalg.norm(along)), 1e-9)
    c, s = float(along @ bone), float(along[0] * bone[1] - along[1] * bone[0])
    turn = np.array([[c, -s], [s, c]])
    out = turn @ (middle[:2] - shoulder)
    shift = shoulder - (out - (out @ bone) * bone)  # onto the axis, as far out as it was

    def move(x: Floats) -> Floats:
        return np.column_stack([(x[:, :2] - shoulder) @ turn.T + shift, x[:, 2]])

    return move


def _arm(panel: Panel) -> int:
    """1 for a panel of the left arm, -1 of the right, 0 of neither."""
    arm = panel.label == "arm" or any(word in panel.name.lower() for word in ("sleeve", "cuff"))
    if not arm or panel.rotation is None or panel.translation is None:
        return 0
    return 1 if placed(panel, panel.vertices)[:, 0].mean() > 0 else -1


def _cleared(pattern: Pattern, mesh: PanelMesh, distance: Distance, moves: Sequence[Move]) -> Floats:
    """(n,3) the panels where their pattern and `moves` put them, each moved outwards, or rolled wider, until it is clear of
    the body."""
    out, mine = np.empty((len(mesh.material), 3)), [np.flatnonzero(mesh.panel == k) for k in range(len(moves))]
    for k, piece in enumerate(pattern.panels):
        if piece.rotation is None or piece.translation is None:
            raise VitruvianError(f"panel {piece.name}: expected a place around the body, found none")
        out[mine[k]] = moves[k](placed(piece, mesh.material[mine[k]]))
    moved, inside = np.zeros(len(mine)), np.arange(len(mine))
    while len(inside):
        some = np.isin(mesh.panel, inside)
        far = np.full(len(mine), np.inf)
        np.minimum.at(far, mesh.panel[some], distance(out[some]))
        inside = np.flatnonzero(far < CLEARANCE)
        moved[inside] += np.maximum(CLEARANCE - far[inside], 0.005)
        if (moved > FARTHEST).any():
            raise VitruvianError(
                f"panel {pattern.panels[int(moved.argmax())].name}: it is still inside the body {FARTHEST:g} m away from "
                "its place; is the unit right, and does it face outwards?"
            )
        for k in inside.tolist():
            out[mine[k]] = moves[k](placed(_out(pattern.panels[k], moved[k]), mesh.material[mine[k]]))
    return out


def _out(panel: Panel, moved: float) -> Panel:
    """A panel moved outwards by so many metres; one that is rolled keeps its axis and gets that much wider."""
    assert panel.translation is not None
    bend = panel.bend / (1 + moved * float(np.hypot(*panel.bend)))
    return replace(panel, translation=panel.translation + moved * outward(panel), bend=bend)
