"""Hands over plain skin, and inside a contour body of 6,300 points.

Run: python benchmarks/hands.py [--quick]
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from _rows import main, row
from skin import interleaved

import vitruvian as vt
from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.rotations import from_vector
from vitruvian.body.types import Body, Weights
from vitruvian.deform.deformer import deformer
from vitruvian.deform.hand_links import hands_of
from vitruvian.deform.hands import HandOperator, place
from vitruvian.native import kernels

POINTS = 6300
GOAL = 0.15e-3  # seconds a frame
FEWER, LESS = 1900, 0.06e-3  # points, seconds a frame


def bent(body: Body) -> np.ndarray:
    """(1,J,4,4) a pose in which every joint is turned, fingers most."""
    rng = np.random.default_rng(0)
    scale = np.array([0.8 if "phalangeal" in name else 0.2 for name in body.skeleton.names])
    turns = from_vector(rng.normal(size=(1, len(body.skeleton), 3)) * scale[:, None])
    return pose_matrices(body.skeleton, turns, np.zeros((1, len(body.skeleton), 3)))


def part(body: Body, chosen: np.ndarray) -> Body:
    """Those vertices of a contour body, its contours whole."""
    place_of = np.full(len(body.skin.rest), -1)
    place_of[chosen] = np.arange(len(chosen))
    weights = body.skin.weights
    keep = place_of[weights.vertex] >= 0
    some = Weights.from_pairs(len(chosen), place_of[weights.vertex[keep]], weights.joint[keep], weights.weight[keep])
    corner = place_of[body.skin.triangles]
    skin = replace(
        body.skin, rest=body.skin.rest[chosen], weights=some, triangles=corner[(corner >= 0).all(axis=1)],
        uv=None, uv_triangles=None, colors=None, parts=(), morphs=(),
    )  # fmt: skip
    contours = []
    for c in body.contours:
        tied = np.column_stack([place_of[c.tied[:, 0]], c.tied[:, 1]])
        contours.append(replace(c, vertices=place_of[c.vertices], tied=tied[tied[:, 0] >= 0]))
    return replace(body, skin=skin, contours=tuple(contours))


def contour_body(points: int = POINTS) -> Body:
    """A contour person of so many points, its hands among them: contours as dense as that needs, no head and feet. With
    fewer points, hands have fewer in proportion."""
    body = vt.pack(vt.person(outfit="body suit", hair="none"))
    every = round(POINTS / points)
    held = sum(len(h.vertices[::every]) for h in hands_of(body))
    density = every**-0.5
    for _ in range(4):
        made = vt.pack(vt.contours(vt.person(outfit="body suit", hair="none"), density=density))
        count = sum(c.vertices.size for c in made.contours)
        if abs(count + held - points) < points / 40:
            break
        density *= ((points - held) / count) ** 0.5
    chosen = np.unique(
        np.concatenate([*(c.vertices.ravel() for c in made.contours), *(h.vertices[::every] for h in hands_of(made))])
    )
    others = np.setdiff1d(
        np.arange(len(made.skin.rest)), np.concatenate([chosen, *(h.vertices for h in hands_of(made))])
    )
    chosen = np.sort(np.concatenate([chosen, others[: max(0, points - len(chosen))]]))
    return part(made, chosen)


def rows(quick: bool = False) -> list[dict[str, object]]:
    """The benchmark's rows."""
    if kernels() is None:
        return []
    seconds = 0.5 if quick else 3.0
    body = vt.pack(vt.person())
    d, matrices = deformer("hand", body), bent(body)
    assert isinstance(d.operator, HandOperator)
    result = d(matrices)
    programs = d.operator.programs
    plain = deformer("log", body)
    t = interleaved(
        {
            "place": lambda: [place(p, matrices, result) for p in programs],
            "log": lambda: plain(matrices, out=result),
            "hand": lambda: d(matrices, out=result),
        },
        seconds,
    )
    points = sum(len(p.hand.vertices) for p in programs)
    goal = t["place"] <= GOAL
    out = [
        row(f"both hands of the person, {points} points", t["place"], "0.15 ms", GOAL, GOAL / t["place"], ">= 1", goal),
        row(
            "log with hands, person",
            t["hand"],
            "log",
            t["log"],
            t["hand"] / t["log"],
            "<= 1.5",
            t["hand"] <= 1.5 * t["log"],
        ),
    ]
    bodies = [contour_body(), contour_body(FEWER)]
    poses = [bent(body) for body in bodies]
    bound = [deformer("contours", body, hands=True) for body in bodies]
    bare = deformer("contours", bodies[0])
    results = [d(m) for d, m in zip(bound, poses)]
    t = interleaved(
        {
            "all": lambda: bound[0](poses[0], out=results[0]),
            "few": lambda: bound[1](poses[1], out=results[1]),
            "none": lambda: bare(poses[0], out=results[0]),
        },
        seconds,
    )
    for key, body, goal in (("all", bodies[0], GOAL), ("few", bodies[1], LESS)):
        name, words = f"contour body of {len(body.skin.rest)} points, hands included", f"{1000 * goal:g} ms"
        out.append(row(name, t[key], words, goal, goal / t[key], ">= 1", t[key] <= goal))
    slope, even = len(bodies[0].skin.rest) / len(bodies[1].skin.rest), t["all"] / t["few"]
    name = "the larger over the smaller, and over its points"
    out.append(row(name, t["all"], "the smaller", t["few"], even / slope, "<= 1", even <= slope))
    out.append(
        row("contour body, hands", t["all"], "without", t["none"], t["all"] / t["none"], "(for information)", True)
    )
    return out


if __name__ == "__main__":
    main(__doc__, rows)
