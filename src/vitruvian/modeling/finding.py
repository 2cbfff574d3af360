"""Finds a person in a scan: the pieces that may be one, every way it may stand, and how sure each feature point is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from vitruvian.body.types import Floats
from vitruvian.errors import VitruvianError, warn
from vitruvian.modeling.laying import Target, begun, refined, score, settle, standing, widest
from vitruvian.modeling.rough import Likeness, Posed, Rough, posed, rough
from vitruvian.modeling.scans import Piece, Surface, cleaned, pieces, without_floor

MOST_POINTS = 20_000  # of a scan, for matching; feature points are put on the whole of it
# Axes that may be up, as rotations that bring them to +Y.
UPS = {
    "+y": np.eye(3),
    "+z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "-y": np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]]),
    "-z": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
}
RARE = 0.031  # metres: a score that makes us look at the axes the other way round, too
NONE = 0.036  # metres of a person of 1.7 m: a score that no person has
TWIN = 0.0025  # metres by which the score of the right front is better than that of the back, at least
# Metres by which feature points are usually off on people of the shape space, and more where soft or far from bone.
USUAL = 0.009
WORSE = {"carpal_distal_phalanx": 0.02, "carpal_distal_phalanx_1": 0.03, "dactylion": 0.02, "styloid": 0.013,
         "humeral": 0.014, "olecranon": 0.014, "radiale": 0.014, "axilla": 0.014, "tarsal": 0.012}  # fmt: skip
GOOD = 0.03  # metres: an expected error of so much has a confidence of one half


@dataclass(frozen=True, eq=False)
class Found:
    """Where a person stands in a scan. points: feature point -> (place (3,), confidence), in the scan's unit and axes.

    up: the axis, "+y", "+z", ...; upright (3,3): rows are the person's left, up and forward in the scan's axes; scale:
    metres of a person of 1.7 m per unit of the scan; piece: the part of the scan that is the person.
    """

    points: dict[str, tuple[Floats, float]]
    up: str
    upright: Floats
    scale: float
    piece: Piece
    score: float


@dataclass(frozen=True, eq=False)
class _Way:
    """One way to stand, settled coarsely."""

    score: float
    up: str
    sign: float
    piece: Piece
    target: Target
    foot: Floats
    scale: float
    who: Likeness


def found(mesh: Surface, progress: Callable[[int, int], None] | None = None) -> Found:
    """The person in a scan; see `vitruvian.modeling.landmarks.detect`."""
    points, triangles = cleaned(mesh)
    done = 0

    def step(total: int = 12) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(min(done, total), total)

    model = rough()
    step()
    ways: list[_Way] = []
    for ups in (("+y", "+z"), ("-y", "-z")):
        if ups == ("+y", "+z") or not ways or min(w.score for w in ways) > RARE:  # upside down is rare
            for way in (w for up in ups for w in _ways(model, points, triangles, up)):
                ways.append(way)
                step()
    if not ways:
        raise VitruvianError(
            "scan: expected one upright person (Y or Z up), found nothing that is taller than wide; turn it upright, cut "
            "people who touch apart, or give landmarks"
        )
    ways.sort(key=lambda w: w.score)
    for k, way in enumerate(ways[:3]):
        ways[k] = _settled(model, way)
        step()
    ways.sort(key=lambda w: w.score)
    best = ways[0]
    if best.score > NONE:
        raise VitruvianError(
            f"scan: found no upright person with arms away from the body (Y or Z up); the best guess is "
            f"{best.score * 1000:.0f} mm off on average; give landmarks"
        )
    rival = [w for w in ways if w.piece is not best.piece and w.up == best.up and w.score < best.score + 0.006]
    if rival:
        warn("scan: several parts look like people; the best one was taken, cut the others off if it is the wrong one")
    turned = min(
        (w.score for w in ways if w.piece is best.piece and w.up == best.up and w.sign != best.sign), default=1.0
    )
    sure = float(np.clip((turned - best.score) / TWIN, 0, 1))
    if sure < 0.5:
        warn("scan: front and back look alike; left and right of the feature points may be swapped")
    who = settle(model, best.who, best.target, rounds=16, every=1, spread=(0.05, 0.012))
    step()
    now = posed(model, who)
    places = refined(model, now, best.target)
    turn = UPS[best.up]
    upright = now.turns[0].T @ turn
    # back to the scan's own unit and axes
    own = (places / best.scale + best.foot) @ turn
    off = _off(model, now, places, best.target)
    final = score(model, who, best.target)
    trust = float(np.clip((NONE - final) / 0.008, 0, 1)) * sure
    out = {}
    snapped, far = _on_surface(own[model.matched :], best.piece)
    for k, name in enumerate(model.names):
        gone = float(far[k]) * best.scale
        place = snapped[k] if gone < 0.03 else own[model.matched + k]
        error = np.hypot(_usual(name), 1.2 * off[k] + 0.5 * gone)
        out[name] = (place, float(np.round(trust / (1 + (error / GOOD) ** 2), 3)))
    return Found(out, best.up, upright, best.scale, best.piece, final)


def _ways(model: Rough, points: Floats, triangles: np.ndarray, up: str) -> Iterator[_Way]:
    """Every part of the scan that may be a person with that axis up, both ways round."""
    turn = UPS[up]
    upright = points @ turn.T
    keep = without_floor(upright, triangles, np.array([0.0, 1.0, 0.0]))
    if keep.sum() < 50:
        return
    for piece in pieces(points, triangles[keep]):
        there = piece.points @ turn.T
        if np.ptp(there[:, 1]) < 0.75 * np.ptp(there, axis=0).max():
            continue
        foot, scale = standing(there)
        step = max(1, int(np.ceil(len(there) / MOST_POINTS)))
        some = (there[::step] - foot) * scale
        target = Target.of(some, (piece.normals @ turn.T)[::step])
        across = widest(some)
        for sign in (1.0, -1.0):
            first = begun(model, target, sign * across)
            who = settle(model, first, target, rounds=8, every=7, spread=(0.15, 0.06), shape=0.6)
            yield _Way(score(model, who, target), up, sign, piece, target, foot, scale, who)


def _settled(model: Rough, way: _Way) -> _Way:
    """The same way, settled better."""
    who = settle(model, way.who, way.target, rounds=10, every=4, spread=(0.08, 0.03), shape=0.8)
    return replace(way, who=who, score=score(model, who, way.target))


def _off(model: Rough, now: Posed, places: Floats, target: Target) -> Floats:
    """(F,) how far the drawn stand-in is from the scan round each feature point, metres; holes count as far."""
    matched = model.matched
    distance = np.minimum(cKDTree(target.points).query(places[:matched])[0], 0.1)
    _, near = cKDTree(model.points[:matched]).query(model.points[matched:], k=12)
    moved = np.linalg.norm(places - now.points, axis=1)
    return np.asarray(np.maximum(distance[near].mean(axis=1) - 0.006, 0) + 0.3 * moved[matched:])


def _usual(name: str) -> float:
    plain = name[2:] if name[:2] in ("l_", "r_") else name
    return max([USUAL, *(v for k, v in WORSE.items() if plain.startswith(k) or k in plain)])


def _on_surface(points: Floats, piece: Piece) -> tuple[Floats, Floats]:
    """The nearest places of a surface (F,3) and how far they are (F,), in its own unit."""
    import igl

    square, _, nearest = igl.point_mesh_squared_distance(
        np.ascontiguousarray(points), np.ascontiguousarray(piece.points), piece.triangles.astype(np.int64)
    )
    return np.asarray(nearest), np.sqrt(np.maximum(square, 0))
