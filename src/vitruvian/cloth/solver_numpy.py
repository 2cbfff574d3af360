"""The cloth kernels in NumPy: what they mean, and what runs where the extension has not been built (slowly)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints
from vitruvian.cloth.touch_numpy import closest, shares

Single = NDArray[np.float32]
SUDDEN = 0.25  # strain that a step takes away at most


def cloth_frame(
    x: Single, v: Single, d: Single, membrane_force: Single, bends: int, carry: float,
    membrane: Ints, membrane_rest: Single, hinge: Ints, hinge_rest: Single,
    shape: Ints, shape_rest: Single, tether: Ints, tether_rest: Single,
    dt: float, substeps: int, gravity: Single, damping: float, limit: float,
    pin: Ints, pin_path: Single, pair: Ints, pair_rest: Single,
    triangle: Ints, neighbour: Ints, before: Single, after: Single, offset: float, most: float, reach: float,
    nearest: Ints, friction: Single,
    near: Ints, side: Single, gap: Single, rub: Single, corners: int,
) -> None:  # fmt: skip
    """One frame of x (n+1,4) and v (n+1,4), in place; see src/native/cloth.cpp and `vitruvian.cloth.solver.step`."""
    n, h = len(x) - 1, dt / substeps
    at, speed, w = x[:n, :3].astype(np.float64), v[:n, :3].astype(np.float64), x[:n, 3].astype(np.float64)
    at, w, speed = (
        np.append(at, np.zeros((1, 3)), axis=0),
        np.append(w, 0.0),
        np.append(speed, np.zeros((1, 3)), axis=0),
    )
    free = w > 0
    first = [closest(at[index], k < corners)[0] @ at[index] for k, index in enumerate(near)]
    first = [way / max(float(np.linalg.norm(way)), 1e-30) for way in first]
    for s in range(substeps):
        low, high = s / substeps, (s + 1) / substeps
        was = at.copy()
        speed[free] = (speed[free] + h * np.asarray(gravity, np.float64)) * np.exp(-damping * h)
        way = h * speed
        if limit > 0:
            size = np.linalg.norm(way, axis=1, keepdims=True)
            short = np.minimum(1.0, limit / np.maximum(size, 1e-30))
            way, speed = way * short, speed * short
        foreseen = at.copy()
        foreseen[free] += way[free]
        at = foreseen.copy()
        if len(pin):
            at[pin] = pin_path[:, :3] + high * (pin_path[:, 3:] - pin_path[:, :3])
        if s % bends == 0:
            for index, rest in zip(hinge, hinge_rest):
                _hinge(at, w, index, rest.astype(np.float64), h * min(bends, substeps - s) ** 0.5)
            for index, rest in zip(shape, shape_rest):
                _shape(at, w, index, rest.astype(np.float64), h * min(bends, substeps - s) ** 0.5)
        begin = at.copy()
        at += carry * d[:, :3]
        for index, rest, force in zip(membrane, membrane_rest, membrane_force):
            _membrane(at, w, index, rest.astype(np.float64), force, h, carry)
        d[:, :3] = at - begin
        for index, rest in zip(tether, tether_rest):
            _tether(at, w, index, rest.astype(np.float64))
        for (a, b), (start, end, compliance) in zip(pair, pair_rest.astype(np.float64)):
            way_ = at[b] - at[a]
            apart, both = np.linalg.norm(way_), w[a] + w[b] + compliance / (h * h)
            far = apart - (start + high * (end - start))
            if both > 0 and far > 0 and apart >= 1e-9:
                move = far / (apart * both) * way_
                at[a] += w[a] * move
                at[b] -= w[b] * move
        for k in range(len(near)):
            _part(at, was, w, near[k], float(side[k]) if k < corners else 0.0, float(gap[k]), float(rub[k]), first[k])
        if len(triangle):
            body = before.astype(np.float64) + high * (after.astype(np.float64) - before)
            then = before.astype(np.float64) + low * (after.astype(np.float64) - before)
            _push(at[:n], was[:n], w[:n], triangle, body, then, offset, most, nearest, friction)
        speed[free] += (at - foreseen)[free] / h
    x[:n, :3], v[:n, :3] = at[:n], speed[:n]


def _membrane(at: Floats, w: Floats, index: Ints, rest: Floats, force: Single, h: float, carry: float) -> None:
    a, b, c, d = rest[:4]
    p = at[index]
    e1, e2 = p[1] - p[0], p[2] - p[0]
    fu, fv = a[:, None] * e1 + c[:, None] * e2, b[:, None] * e1 + d[:, None] * e2
    lu, lv = np.sqrt(np.sum(fu * fu, axis=1) + 1e-12), np.sqrt(np.sum(fv * fv, axis=1) + 1e-12)
    gu, gv = np.stack([-a - c, a, c]), np.stack([-b - d, b, d])
    nu, nv = fu / lu[:, None], fv / lv[:, None]
    # gradients of the three strains by the three vertices
    grad = np.stack(
        [gu[:, :, None] * nu, gv[:, :, None] * nv, gu[:, :, None] * fv + gv[:, :, None] * fu], axis=1
    )  # (vertex, strain, lane, axis)
    matrix = np.einsum("vl,vilx,vjlx->lij", w[index], grad, grad)
    zero = np.zeros_like(a)
    give = np.array([[rest[4], rest[5], zero], [rest[5], rest[6], zero], [zero, zero, rest[7]]]).transpose(2, 0, 1)
    give = give / (h * h)
    matrix += give
    kept = carry * force.T.astype(np.float64)
    right = -np.stack([lu - 1, lv - 1, np.sum(fu * fv, axis=1)], axis=1) - np.einsum("lij,lj->li", give, kept)
    right = np.clip(right, -SUDDEN, SUDDEN)
    whole, most = np.linalg.det(matrix), 0.1 * np.prod(np.diagonal(matrix, axis1=1, axis2=2), axis=1)
    some = np.abs(whole) > 0
    share = np.zeros_like(right)
    share[some] = np.linalg.solve(matrix[some], right[some][..., None])[..., 0]
    share *= (whole / np.maximum(whole, most + 1e-30))[:, None]
    force[:] = (kept + share).T
    move = w[index][..., None] * np.einsum("vilx,li->vlx", grad, share)
    _add(at, index, move)


def _hinge(at: Floats, w: Floats, index: Ints, rest: Floats, h: float) -> None:
    factor = rest[:4]
    both = np.maximum(np.sum(w[index] * factor**2, axis=0) + rest[4] / (h * h), 1e-30)
    share = -np.einsum("vl,vlx->lx", factor, at[index]) / both[:, None]
    _add(at, index, (w[index] * factor)[..., None] * share)


def _shape(at: Floats, w: Floats, index: Ints, rest: Floats, h: float) -> None:
    sums = rest[:18].reshape(3, 6, -1)
    matrix = np.einsum("ivl,vl,jvl->lij", sums, w[index], sums) + (rest[18] / (h * h))[:, None, None] * np.eye(3)
    share = -np.linalg.solve(matrix, np.einsum("ivl,vlx->lix", sums, at[index]))
    _add(at, index, w[index][..., None] * np.einsum("ivl,lix->vlx", sums, share))


def _tether(at: Floats, w: Floats, index: Ints, rest: Floats) -> None:
    way = at[index[1]] - at[index[0]]
    apart = np.sqrt(np.sum(way * way, axis=1) + 1e-12)
    both = np.maximum(w[index].sum(axis=0), 1e-30)
    move = (np.maximum(apart - rest[0], 0) / (apart * both))[:, None] * way
    _add(at, index, np.stack([w[index[0]][:, None] * move, -w[index[1]][:, None] * move]))


def _add(at: Floats, index: Ints, move: Floats) -> None:
    """Lanes share no vertex, but for those without a constraint, which do not move."""
    inside = index < len(at) - 1
    at[index[inside]] += move[inside]


def _push(
    at: Floats, was: Floats, w: Floats, triangle: Ints, body: Floats, then: Floats, offset: float, most: float,
    nearest: Ints, friction: Single,
) -> None:  # fmt: skip
    import igl

    _, face = igl.point_mesh_squared_distance(np.ascontiguousarray(at), body[:, :3].copy(), triangle.astype(np.int64))[
        :2
    ]
    face = np.asarray(face, np.int64).reshape(-1)
    nearest[:] = face
    corner = triangle[face]
    share = shares(at, body[corner, :3])
    now, before = (np.einsum("nk,nkx->nx", share, b[corner, :3]) for b in (body, then))
    normal = np.einsum("nk,nkx->nx", share, body[corner, 3:])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    out = np.sum((at - now) * normal, axis=1)
    apart = np.linalg.norm(at - now, axis=1)
    by = np.minimum(offset - np.where(out < 0, -apart, apart), most)
    away = np.where(out < 0, -apart, apart)[:, None]
    normal = np.where(apart[:, None] > 1e-5, (at - now) / np.where(away == 0, 1, away), normal)
    hit = (by > 0) & (w > 0)
    slip = (at - was) - (now - before)
    slip -= np.sum(slip * normal, axis=1, keepdims=True) * normal
    size = np.linalg.norm(slip, axis=1)
    grip = friction * by
    share_ = np.where(size <= grip, 1.0, grip / np.maximum(size, 1e-30))
    move = by[:, None] * normal - share_[:, None] * slip
    at[hit] += move[hit]


def _part(at: Floats, was: Floats, w: Floats, index: Ints, side: float, gap: float, rub: float, first: Floats) -> None:
    """Vertex and triangle where there is a side, else edges, of which `first` is the way as the frame began."""
    x, p, inverse = at[index], was[index], w[index]
    share, inside = closest(x, side != 0)
    way = share @ x
    apart = float(np.linalg.norm(way))
    n, deep = way / max(apart, 1e-30), gap - apart
    if inside and side:
        n = np.cross(x[2] - x[1], x[3] - x[1])
        size = np.linalg.norm(n)
        if size < 1e-14:
            return
        n = n * side / size
        deep = gap - float(way @ n)
    elif inside:
        sign = -1.0 if way @ first < 0 else 1.0
        n, deep = first if apart < 1e-7 else sign * n, gap - sign * apart
    both = float(np.sum(inverse * share**2))
    if deep <= 0 or not both > 0 or (not inside and (not side or apart < 1e-7)):
        return
    by = min(deep, 0.5 * gap) / both
    slip = share @ (x - p)
    slip -= (slip @ n) * n
    length, grip = float(np.linalg.norm(slip)), rub * by * both
    hold = (1.0 if length <= grip else grip / length) / both
    at[index] += (inverse * share)[:, None] * (by * n - hold * slip)
