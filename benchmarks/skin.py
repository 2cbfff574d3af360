"""Skinning against UsdSkel, against the memory it has to touch, and the operators against each other.

Everything of one row runs in one process, taking turns of five runs each; times are medians over all runs. The threads
of UsdSkel go on looking for work for a while after its call, on processors that whoever comes next needs: with turns of
several runs that falls on the first of them only. Run: python benchmarks/skin.py [--quick]
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from _rows import main, row

from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.rotations import from_vector
from vitruvian.body.types import Body, Skeleton, Skin, Weights
from vitruvian.deform.deformer import Deformer, deformer
from vitruvian.native import kernels


def figure(vertices: int, joints: int = 64, influences: int = 4, seed: int = 0) -> Body:
    """A tube around a chain of joints, each vertex on its nearest joints: coherent in memory, as real meshes are."""
    rng = np.random.default_rng(seed)
    height = np.linspace(0, 1.7, vertices)
    turn = np.arange(vertices) * 2.4
    rest = np.stack([0.1 * np.cos(turn), height, 0.1 * np.sin(turn)], axis=1)
    centers = np.zeros((joints, 3))
    centers[:, 1] = np.linspace(0, 1.7, joints)
    first = np.clip(np.floor(height / 1.7 * (joints - 1)).astype(int) - influences // 2 + 1, 0, joints - influences)
    joint = first[:, None] + np.arange(influences)
    weight = np.exp(-(((height[:, None] - centers[joint, 1]) * joints / 1.7) ** 2)) + rng.uniform(0, 0.05, joint.shape)
    weight /= weight.sum(axis=1, keepdims=True)
    names = tuple(f"j{i}" for i in range(joints))
    skeleton = Skeleton(names, np.arange(-1, joints - 1), centers)
    vertex = np.repeat(np.arange(vertices), influences)
    weights = Weights.from_pairs(vertices, vertex, joint.ravel(), weight.ravel())
    ring = np.arange(vertices - 2)
    return Body("tube", skeleton, Skin(rest, np.stack([ring, ring + 1, ring + 2], axis=1), weights))


def poses(body: Body, frames: int, angle: float = 0.25, seed: int = 1) -> np.ndarray:
    """Joint matrices of random turns, (F,J,4,4)."""
    rng = np.random.default_rng(seed)
    turns = from_vector(rng.normal(scale=angle, size=(frames, len(body.skeleton), 3)))
    return pose_matrices(body.skeleton, turns, rng.normal(scale=0.02, size=(frames, len(body.skeleton), 3)))


TURN = 5  # runs in a row


def interleaved(tasks: dict[str, Callable[[], object]], seconds: float) -> dict[str, float]:
    """Median time of each task, the tasks taking turns of `TURN` runs, all timed, for about that long in all."""
    times: dict[str, list[float]] = {name: [] for name in tasks}
    for task in tasks.values():
        task()
    stop = time.perf_counter() + seconds
    while time.perf_counter() < stop or len(next(iter(times.values()))) < 5:
        for name, task in tasks.items():
            for _ in range(TURN):
                start = time.perf_counter()
                task()
                times[name].append(time.perf_counter() - start)
    return {name: float(np.median(t)) for name, t in times.items()}


class Usd:
    """UsdSkel's skinning of a body with the same number of influences on every vertex."""

    def __init__(self, body: Body, matrices: np.ndarray):
        from pxr import Gf, UsdSkel, Vt

        k = int(body.skin.weights.counts.max())
        joints, weights = body.skin.weights.top(k)
        self.skin, self.identity, self.k = UsdSkel.SkinPoints, Gf.Matrix4d(1), k
        self.rest = body.skin.rest.astype(np.float32)
        self.matrices = Vt.Matrix4dArray.FromNumpy(np.ascontiguousarray(matrices.swapaxes(-1, -2)))
        self.joints = Vt.IntArray.FromNumpy(np.ascontiguousarray(joints.ravel()))
        self.weights = Vt.FloatArray.FromNumpy(np.ascontiguousarray(weights.ravel().astype(np.float32)))
        self.vectors = Vt.Vec3fArray.FromNumpy
        self.points = self.vectors(self.rest)

    def __call__(self, method: str = "classicLinear") -> None:
        """Skins `points` in place, whatever they are: the time does not depend on their values."""
        self.skin(method, self.identity, self.matrices, self.joints, self.weights, self.k, self.points)

    def fresh(self, method: str = "classicLinear") -> np.ndarray:
        """The skinned rest positions."""
        self.points = self.vectors(self.rest)
        self(method)
        result = np.array(self.points)
        self.points = self.vectors(self.rest)
        return result


def rows(quick: bool = False) -> list[dict[str, object]]:
    """The benchmark's rows; `quick` leaves out the largest mesh and measures for a shorter time."""
    if kernels() is None:
        return []
    seconds = 1.0 if quick else 4.0
    out = _mesh(10_000, 4.0, seconds) + _mesh(100_000, 8.0, seconds)
    if not quick:
        out += _mesh(1_000_000, 4.0, 2 * seconds)
    return out + _person(seconds) + _batch(seconds)


def _mesh(vertices: int, goal: float, seconds: float) -> list[dict[str, object]]:
    """One mesh in one pose: every operator, UsdSkel, the linear kernel alone, and its memory alone."""
    native = kernels()
    assert native is not None
    out: list[dict[str, object]] = []
    label = f"{vertices // 1000}k vertices, 4 influences"
    body = figure(vertices)
    matrices = poses(body, 1)
    result = np.empty((1, vertices, 3), np.float32)
    bound = {n: deformer(n, body) for n in ("linear", "dual-quaternion", "log", "log-pair", "hybrid", "volume")}
    run = {n: _task(d, matrices, result) for n, d in bound.items()}
    usd, usd_dq = Usd(body, matrices[0]), Usd(body, matrices[0])
    for name, oracle in (("linear", usd.fresh()), ("dual-quaternion", usd_dq.fresh("dualQuaternion"))):
        error = float(np.abs(run[name]()[0] - oracle).max())
        title = f"{name} agrees with UsdSkel, metres, {label}"
        out.append(row(title, None, "UsdSkel", None, error, "<= 1e-05", error <= 1e-5))

    buckets = bound["linear"].operator.buckets  # type: ignore[attr-defined]
    table = native.linear_table(matrices)
    program = bound["linear"].operator.laid.program(None)  # type: ignore[attr-defined]

    def touch(matrices: np.ndarray | None) -> None:
        b = buckets[0]  # all but the few vertices that share their joints with fewer than seven others
        native.touch(matrices, b.rest, b.joint, b.weight, b.target, b.count, result[0], 0)

    assert buckets[0].count > 0.99 * vertices
    tasks: dict[str, Callable[[], object]] = {
        "kernel": lambda: native.linear(program, table, result, 0),
        "usd": usd,
        "touch": lambda: touch(table[0]),
        "usd-dq": lambda: usd_dq("dualQuaternion"),
        "stream": lambda: touch(None),
        **run,
    }
    t = interleaved(tasks, seconds)

    ratio = t["usd"] / t["linear"]
    out.append(row(f"linear, {label}", t["linear"], "UsdSkel", t["usd"], ratio, f">= {goal:g}", ratio >= goal))
    ratio = t["usd-dq"] / t["dual-quaternion"]
    title = f"dual-quaternion, {label}"
    out.append(row(title, t["dual-quaternion"], "UsdSkel", t["usd-dq"], ratio, ">= 3", ratio >= 3))
    goals = {"log": 1.7, "dual-quaternion": 2.0, "hybrid": None, "log-pair": None, "volume": None}
    for other, limit in goals.items():
        ratio = t[other] / t["linear"]
        goal_text = "(for information)" if limit is None else f"<= {limit:g}"
        title = f"{other}, {label}"
        out.append(row(title, t[other], "linear", t["linear"], ratio, goal_text, limit is None or ratio <= limit))
    ratio = t["hybrid"] / t["log"]  # all joints turn far: what is left is to find that out
    out.append(row(f"hybrid, {label}", t["hybrid"], "log", t["log"], ratio, "<= 1.4", ratio <= 1.4))
    if vertices >= 100_000:
        limit = 1.5 if vertices < 1_000_000 else 1.3
        ratio = t["kernel"] / t["touch"]
        title = f"linear kernel, {label}"
        peer = "same loads and stores"
        out.append(row(title, t["kernel"], peer, t["touch"], ratio, f"<= {limit:g}", ratio <= limit))
        ratio = t["kernel"] / t["stream"]
        out.append(row(title, t["kernel"], "the same without matrices", t["stream"], ratio, "(for information)", True))
    return out


def _person(seconds: float) -> list[dict[str, object]]:
    """A frame of the built-in person's body: points and normals, under a goal in milliseconds on two processors."""
    from dataclasses import replace

    from vitruvian.body.pack import pack
    from vitruvian.modeling.person import person

    whole = pack(person(outfit=None, hair=None))
    s = whole.skin
    part = next(p for p in s.parts if p.name == "skin")
    used, triangles = np.unique(s.triangles[part.start : part.stop], return_inverse=True)
    place = np.full(len(s.rest), -1)
    place[used] = np.arange(len(used))
    w = s.weights
    keep = place[w.vertex] >= 0
    weights = Weights.from_pairs(len(used), place[w.vertex[keep]], w.joint[keep], w.weight[keep])
    body = replace(whole, skin=Skin(s.rest[used], triangles.reshape(-1, 3), weights))
    matrices = poses(body, 1)
    result = np.empty((1, len(used), 3), np.float32)
    tasks: dict[str, Callable[[], object]] = {}
    for name in ("linear", "log", "hybrid", "volume"):
        d = deformer(name, body)
        tasks[name] = lambda d=d: d.normals(d(matrices, out=result))  # type: ignore[misc]
    t = interleaved(tasks, seconds)
    out = []
    for name, goal in (("linear", 0.25e-3), ("log", 0.4e-3), ("hybrid", None), ("volume", None)):
        title = f"{name} with normals, person: {len(used)} vertices, {len(body.skeleton)} joints"
        ratio = t[name] / goal if goal else t[name] / t["linear"]
        peer, goal_text = (f"{goal * 1e3:g} ms", "<= 1") if goal else ("linear", "(for information)")
        out.append(row(title, t[name], peer, goal or t["linear"], ratio, goal_text, not goal or ratio <= 1))
    return out


def _task(d: Deformer, matrices: np.ndarray, result: np.ndarray) -> Callable[[], np.ndarray]:
    return lambda: d(matrices, out=result)


def _batch(seconds: float) -> list[dict[str, object]]:
    """One hundred frames at once against one by one."""
    body = figure(10_000)
    matrices = poses(body, 100)
    result = np.empty((100, 10_000, 3), np.float32)
    d = deformer("linear", body)

    def singly() -> None:
        for f in range(100):
            d(matrices[f], out=result[f])

    t = interleaved({"batch": lambda: d(matrices, out=result), "singly": singly}, seconds)
    ratio = t["singly"] / t["batch"]
    return [row("linear, 100 frames of 10k at once", t["batch"], "one by one", t["singly"], ratio, ">= 2", ratio >= 2)]


if __name__ == "__main__":
    main(__doc__, rows)
