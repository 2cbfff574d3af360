"""Weights of the built-in woman on the man and back, whose truth is known because both have one topology.

What transfers must not use it: points come in another order, and once the target is another mesh altogether, whose truth is
read off the place where its points were taken from. The peer is the closest point, after the centres of the joints have
brought the source near, and as the two stand. Run: python benchmarks/transfer.py [--quick]
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from _rows import main, row

import vitruvian as vt
from vitruvian.body import rotations as rot
from vitruvian.body.types import Skin
from vitruvian.modeling import shrink
from vitruvian.modeling.aligning import main_piece
from vitruvian.modeling.person import humanoid_of
from vitruvian.modeling.shape import Shape
from vitruvian.modeling.transfer import match
from vitruvian.modeling.weights import from_table, table

POSES = 20
PARTS = ("skin", "eyes")


def person(gender: float, **sliders: Any) -> vt.Body:
    """Skin and eyes of a person, and nothing that hides them."""
    body = vt.pack(humanoid_of(Shape(gender=gender, **sliders), outfit=None, hair="none"))
    stop = max(p.stop for p in body.skin.parts if p.name in PARTS)
    triangles = body.skin.triangles[:stop]
    used, number = np.unique(triangles, return_inverse=True)
    rows = table(body.skin.weights, len(body.skeleton))[used]
    skin = Skin(body.skin.rest[used], number.reshape(-1, 3).astype(np.int32), from_table(rows))
    return replace(body, skin=skin, contours=())


def poses(body: vt.Body, count: int = POSES, seed: int = 5) -> np.ndarray:
    """(count,J,4,4) random poses: every joint that people turn, up to what they do."""
    rng = np.random.default_rng(seed)
    usual = {"shoulder": 0.7, "elbow": 0.7, "hip": 0.5, "knee": 0.6, "radiocarpal": 0.3, "talocrural": 0.3}
    turn = np.tile(rot.IDENTITY, (count, len(body.skeleton), 1))
    for name, j in body.skeleton.index.items():
        stem = name[2:] if name[:2] in ("l_", "r_") else name
        size = usual.get(stem, 0.15 if "phalangeal" in stem or stem == "skullbase" else 0.0)
        if stem[:2] in ("vl", "vt", "vc") and stem[2:].isdigit():
            size = 0.04
        if size:
            turn[:, j] = rot.from_vector(rng.normal(scale=size, size=(count, 3)).clip(-2 * size, 2 * size))
    return vt.joint_matrices(body.skeleton, vt.Motion(body.skeleton, 30.0, turn, np.zeros((count, 3))))


def shuffled(body: vt.Body, seed: int = 3) -> tuple[vt.Mesh, Any]:
    """Its surface with points in another order, and the true weights (n,J) of these."""
    order = np.random.default_rng(seed).permutation(len(body.skin.rest))
    place = np.argsort(order)
    faces = place[body.skin.triangles].astype(np.int32)
    return vt.Mesh(body.skin.rest[order], faces), table(body.skin.weights, len(body.skeleton))[order]


def remeshed(body: vt.Body, triangles: int = 16_000) -> tuple[vt.Mesh, Any]:
    """Its skin as another mesh: fewer triangles, points where there were none."""
    import igl

    skin = main_piece(body.skin.rest, body.skin.triangles)
    used, number = np.unique(skin, return_inverse=True)
    points, faces = igl.qslim(body.skin.rest[used], number.reshape(-1, 3).astype(np.int64), triangles)[:2]
    faces = np.asarray(faces, np.int32)
    _, _, face, share = shrink.closest(points, shrink.surface(body.skin.rest, skin))
    return vt.Mesh(points, faces), read(body, skin[face], share)


def read(body: vt.Body, corners: Any, share: Any) -> Any:
    """(n,J) weights of points in triangles."""
    return shrink.blend(corners, share, len(body.skin.rest)) @ table(body.skin.weights, len(body.skeleton))


def error(found: Any, truth: Any) -> np.ndarray:
    """(n,) half the sum of what the weights differ by, 0 to 1."""
    return 0.5 * np.asarray(abs(found - truth).sum(axis=1)).ravel()


def moved(body: vt.Body, mesh: vt.Mesh, rows: Any, matrices: np.ndarray) -> np.ndarray:
    """(frames,n,3) the mesh with these weights in poses."""
    skin = Skin(mesh.vertices, mesh.triangles, from_table(rows.tocsr()))
    return vt.deformer("log", replace(body, skin=skin, contours=()))(matrices)


def case(source: vt.Body, target: vt.Body, mesh: vt.Mesh, truth: Any, runs: int) -> dict[str, float]:
    """Figures of one transfer; errors of weights, posed errors in mm, seconds."""
    times, spent = [], []
    for _ in range(runs):
        start, used = time.perf_counter(), time.process_time()
        made = match(source, mesh, skeleton=target.skeleton)
        times.append(time.perf_counter() - start)
        spent.append(time.process_time() - used)
    rows = table(made.skin.weights, len(source.skeleton))
    off = error(rows, truth)
    t = source.skin.triangles

    def closest(points: np.ndarray) -> Any:
        _, _, face, share = shrink.closest(mesh.vertices, shrink.surface(points, t))
        return read(source, t[face], share)

    near = source.skin.rest + table(source.skin.weights, len(source.skeleton)) @ (
        target.skeleton.centers - source.skeleton.centers
    )
    matrices = poses(target)
    true = moved(target, mesh, truth, matrices)
    mm = lambda r: float(np.linalg.norm(moved(target, mesh, r, matrices) - true, axis=2).mean()) * 1000  # noqa: E731
    start = time.perf_counter()
    plain, led = closest(source.skin.rest), closest(near)
    return {
        "mean": float(off.mean()),
        "p95": float(np.quantile(off, 0.95)),
        "plain": float(error(plain, truth).mean()),
        "led": float(error(led, truth).mean()),
        "posed": mm(rows),
        "posed led": mm(led),
        "seconds": min(times),
        "processor": min(spent),
        "peer": (time.perf_counter() - start) / 2,
        "points": float(len(mesh.vertices)),
    }


def rows(quick: bool = False) -> list[dict[str, object]]:
    """The benchmark's rows; `quick` goes one way only."""
    woman, man = person(0.0), person(1.0)
    ways = [("woman to man", woman, man), ("man to woman", man, woman)][: 1 if quick else 2]
    odd = (person(0.2, age=61, weight=0.8, muscle=0.3), person(0.9, age=22, weight=0.3, height=0.8, muscle=0.8))
    ways += [] if quick else [("others", *odd)]
    out: list[dict[str, object]] = []
    for name, source, target in ways:
        for kind, make in (("", shuffled), (", remeshed", remeshed)):
            f = case(source, target, *make(target), runs=1 if quick else 3)
            title, took = f"{name}{kind}", f["seconds"]
            for figure, value, goal in (
                ("mean error", f["mean"], 0.03),
                ("p95 error", f["p95"], 0.12),
                ("posed, mm", f["posed"], 2.0),
            ):
                out.append(row(f"{title}, {figure}", took, None, None, value, f"<= {goal:g}", value <= goal))
            for peer, key in (("closest point", "plain"), ("joints + closest", "led")):
                share = f[key] / max(f["mean"], 1e-9)
                out.append(row(f"{title}, better than", took, peer, f["peer"], share, ">= 2", share >= 2))
            share = f["posed led"] / max(f["posed"], 1e-9)
            out.append(
                row(f"{title}, posed better than", took, "joints + closest", f["peer"], share, ">= 2", share >= 2)
            )
            text = f"{title}, s for {f['points']:.0f} points"
            out.append(row(text, took, None, None, took, "< 2", took < 2, processor_s=f["processor"]))
    return out


if __name__ == "__main__":
    main(__doc__, rows)
