"""Rotations as quaternions `xyzw`, matrices, axis-angles and Euler angles, over any leading axes.

Radians, right-handed, column vectors: `p' = R p`, and `multiply(a, b)` turns by `b` first. float64.
Sources: J. Diebel, "Representing Attitude" (2006); S. Shepperd, "Quaternion from Rotation Matrix" (1978);
K. Shoemake, "Animating Rotation with Quaternion Curves" (1985).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from vitruvian.body.types import Floats, require

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
IDENTITY.flags.writeable = False


def _array(value: ArrayLike, name: str, *tail: int) -> Floats:
    array = np.asarray(value, dtype=np.float64)
    require(array.shape[-len(tail) :] == tail, name, f"shape (..., {', '.join(map(str, tail))})", array.shape)
    return array


def unit(v: Floats) -> Floats:
    """Vectors (...,3) of length one; a zero one stays zero."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)


def normalize(q: ArrayLike) -> Floats:
    """Unit quaternions (...,4); a zero one becomes the identity."""
    q = _array(q, "quaternion", 4)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(norm > 0, q / np.where(norm > 0, norm, 1.0), IDENTITY)


def from_axis_angle(rotation: ArrayLike) -> Floats:
    """Quaternions (...,4) of the standard's `x y z angle` (...,4) with any axis length; a zero axis does not turn."""
    rotation = _array(rotation, "rotation", 4)
    axis, half = rotation[..., :3], rotation[..., 3:] / 2
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    unit = axis / np.where(length > 0, length, 1.0)
    return np.concatenate([unit * np.sin(half), np.where(length > 0, np.cos(half), 1.0)], axis=-1)


def to_axis_angle(q: ArrayLike) -> Floats:
    """`x y z angle` (...,4) with a unit axis and an angle in 0..pi; no turn is `0 0 1 0`."""
    q = normalize(q)
    q = np.where(q[..., 3:] < 0, -q, q)
    length = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    axis = np.where(length > 0, q[..., :3] / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])
    return np.concatenate([axis, 2 * np.arctan2(length, q[..., 3:])], axis=-1)


def from_vector(vector: ArrayLike) -> Floats:
    """Quaternions (...,4) of rotation vectors (...,3): axis times angle."""
    vector = _array(vector, "rotation vector", 3)
    half = np.linalg.norm(vector, axis=-1, keepdims=True) / 2
    return np.concatenate([vector * np.sinc(half / np.pi) / 2, np.cos(half)], axis=-1)


def to_vector(q: ArrayLike) -> Floats:
    """Rotation vectors (...,3), axis times angle in 0..pi."""
    q = normalize(q)
    q = np.where(q[..., 3:] < 0, -q, q)
    length = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    small = length < 1e-12
    return q[..., :3] * np.where(small, 2.0, 2 * np.arctan2(length, q[..., 3:]) / np.where(small, 1.0, length))


def to_matrix(q: ArrayLike) -> Floats:
    """Rotation matrices (...,3,3) of quaternions (...,4), which are normalised first."""
    x, y, z, w = np.moveaxis(normalize(q), -1, 0)
    out = np.empty((*x.shape, 3, 3))
    out[..., 0, 0] = 1 - 2 * (y * y + z * z)
    out[..., 0, 1] = 2 * (x * y - z * w)
    out[..., 0, 2] = 2 * (x * z + y * w)
    out[..., 1, 0] = 2 * (x * y + z * w)
    out[..., 1, 1] = 1 - 2 * (x * x + z * z)
    out[..., 1, 2] = 2 * (y * z - x * w)
    out[..., 2, 0] = 2 * (x * z - y * w)
    out[..., 2, 1] = 2 * (y * z + x * w)
    out[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return out


def from_matrix(matrix: ArrayLike) -> Floats:
    """Unit quaternions (...,4), w >= 0, of rotation matrices (...,3,3) or the 3x3 part of (...,4,4).

    The largest of the four components is taken first, so no digits are lost anywhere.
    """
    m = np.asarray(matrix, dtype=np.float64)
    require(m.shape[-2:] in ((3, 3), (4, 4)), "matrix", "shape (..., 3, 3) or (..., 4, 4)", m.shape)
    m00, m01, m02 = m[..., 0, 0], m[..., 0, 1], m[..., 0, 2]
    m10, m11, m12 = m[..., 1, 0], m[..., 1, 1], m[..., 1, 2]
    m20, m21, m22 = m[..., 2, 0], m[..., 2, 1], m[..., 2, 2]
    rows = np.stack(  # each row is 4 q_k q, for k = x, y, z, w
        [
            np.stack([1 + m00 - m11 - m22, m01 + m10, m02 + m20, m21 - m12], -1),
            np.stack([m01 + m10, 1 - m00 + m11 - m22, m12 + m21, m02 - m20], -1),
            np.stack([m02 + m20, m12 + m21, 1 - m00 - m11 + m22, m10 - m01], -1),
            np.stack([m21 - m12, m02 - m20, m10 - m01, 1 + m00 + m11 + m22], -1),
        ],
        -2,
    )
    best = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., 3:] < 0, -q, q)


def multiply(a: ArrayLike, b: ArrayLike) -> Floats:
    """The rotation `b` followed by `a`: to_matrix(multiply(a, b)) = to_matrix(a) @ to_matrix(b)."""
    a, b = _array(a, "a", 4), _array(b, "b", 4)
    ax, ay, az, aw = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bx, by, bz, bw = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0] = aw * bx + ax * bw + ay * bz - az * by
    out[..., 1] = aw * by - ax * bz + ay * bw + az * bx
    out[..., 2] = aw * bz + ax * by - ay * bx + az * bw
    out[..., 3] = aw * bw - ax * bx - ay * by - az * bz
    return out


def inverse(q: ArrayLike) -> Floats:
    """The opposite turn of unit quaternions (...,4)."""
    return _array(q, "quaternion", 4) * [-1.0, -1.0, -1.0, 1.0]


def rotate(q: ArrayLike, vector: ArrayLike) -> Floats:
    """Vectors (...,3) turned by unit quaternions (...,4)."""
    q, v = _array(q, "quaternion", 4), _array(vector, "vector", 3)
    x, y, z, w = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    vx, vy, vz = v[..., 0], v[..., 1], v[..., 2]
    tx, ty, tz = 2 * (y * vz - z * vy), 2 * (z * vx - x * vz), 2 * (x * vy - y * vx)
    out = np.empty((*np.broadcast_shapes(q.shape[:-1], v.shape[:-1]), 3))
    out[..., 0] = vx + w * tx + y * tz - z * ty
    out[..., 1] = vy + w * ty + z * tx - x * tz
    out[..., 2] = vz + w * tz + x * ty - y * tx
    return out


def slerp(a: ArrayLike, b: ArrayLike, t: ArrayLike) -> Floats:
    """From `a` (t = 0) to `b` (t = 1) the short way, at even speed. t broadcasts against the leading axes."""
    a, b = normalize(a), normalize(b)
    t = np.asarray(t, dtype=np.float64)[..., None]
    dot = np.sum(a * b, axis=-1, keepdims=True)
    b = np.where(dot < 0, -b, b)
    # the angle from chord and sum: exact near zero, where acos of the dot is not
    angle = 2 * np.arctan2(np.linalg.norm(b - a, axis=-1, keepdims=True), np.linalg.norm(b + a, axis=-1, keepdims=True))
    small = angle < 1e-8
    sine = np.where(small, 1.0, np.sin(angle))
    wa = np.where(small, 1 - t, np.sin((1 - t) * angle) / sine)
    wb = np.where(small, t, np.sin(t * angle) / sine)
    return normalize(wa * a + wb * b)


def between(a: ArrayLike, b: ArrayLike) -> Floats:
    """The smallest rotation (...,4) that turns direction `a` (...,3) into `b` (...,3); a zero vector does not turn.

    For opposite directions the axis is the coordinate axis farthest from `a`, made perpendicular to it.
    """
    a, b = np.broadcast_arrays(_array(a, "a", 3), _array(b, "b", 3))
    la, lb = np.linalg.norm(a, axis=-1, keepdims=True), np.linalg.norm(b, axis=-1, keepdims=True)
    void = (la == 0) | (lb == 0)
    x = np.array([1.0, 0.0, 0.0])
    u = np.where(void, x, a / np.where(la == 0, 1.0, la))
    v = np.where(void, x, b / np.where(lb == 0, 1.0, lb))
    half = u + v
    length = np.linalg.norm(half, axis=-1, keepdims=True)
    opposite = length < 1e-9
    middle = half / np.where(opposite, 1.0, length)
    q = np.concatenate([np.cross(u, middle), np.sum(u * middle, axis=-1, keepdims=True)], axis=-1)
    if opposite.any():
        far = np.eye(3)[np.argmin(np.abs(u), axis=-1)]
        axis = np.cross(u, far)
        axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
        q = np.where(opposite, np.concatenate([axis, np.zeros_like(length)], axis=-1), q)
    return normalize(q)


_AXES = {"X": 0, "Y": 1, "Z": 2}


def _order(order: str) -> tuple[int, int, int]:
    good = len(order) == 3 and set(order.upper()) <= set("XYZ") and order[0] != order[1] and order[1] != order[2]
    require(good, "order", "three letters of XYZ, neighbours different, such as 'ZYX'", repr(order))
    i, j, k = (_AXES[c] for c in order.upper())
    return i, j, k


def from_euler(angles: ArrayLike, order: str = "ZYX") -> Floats:
    """Quaternions (...,4) of Euler angles (...,3) in the order of the letters, intrinsic: "ZYX" is R = Rz Ry Rx.

    That is the meaning of BVH channels, `angles[..., 0]` belonging to the first letter.
    """
    axes = _order(order)
    half = _array(angles, "angles", 3) / 2
    out = np.empty((*half.shape[:-1], 4))
    # one product written out; sines and cosines of one axis at a time, so that whole clips stay in the cache
    (sa, ca), (sb, cb), (sc, cc) = ((np.sin(h), np.cos(h)) for h in (half[..., 0], half[..., 1], half[..., 2]))
    i, j, k = axes
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    if i == k:
        k = 3 - i - j
        out[..., i] = cb * (sa * cc + ca * sc)
        out[..., j] = sb * (ca * cc + sa * sc)
        out[..., k] = sign * sb * (sa * cc - ca * sc)
        out[..., 3] = cb * (ca * cc - sa * sc)
        return out
    ss, sk, ks, kk = sa * sb * sign, sa * cb, ca * sb, ca * cb
    sc_signed = sc * sign
    out[..., i] = sk * cc + ks * sc_signed
    out[..., j] = ks * cc - sk * sc_signed
    out[..., k] = kk * sc + ss * cc
    out[..., 3] = kk * cc - ss * sc
    return out


def to_euler(q: ArrayLike, order: str = "ZYX", *, continuous: bool = False) -> Floats:
    """Euler angles (...,3) of quaternions (...,4): the inverse of `from_euler`.

    The middle angle is in -pi/2..pi/2 (0..pi for orders like "XYX"). At the poles, where only a sum of the outer angles
    is defined, the third is zero, or with `continuous` the previous frame's.
    With `continuous` the first axis is time: each frame takes, of the two equivalent triples and all turns by 2 pi, the
    one nearest to the frame before it.
    Method: with half angles A, B, C, sums and differences of the quaternion's components are products of
    sin or cos of A+C, of A-C and of B alone, so `arctan2` gives all three without a loss of digits anywhere.
    """
    i, j, k = _order(order)
    q = normalize(q)
    proper = i == k
    if proper:
        k = 3 - i - j
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    w, x, y, z = q[..., 3], q[..., i], q[..., j], sign * q[..., k]
    if proper:
        plus, minus = np.arctan2(x, w), np.arctan2(z, y)
        low, high = np.hypot(y, z), np.hypot(w, x)
        middle = 2 * np.arctan2(low, high)
        sign, minus_lost, plus_lost = 1.0, low < 1e-7, high < 1e-7
    else:
        plus, minus = np.arctan2(x + z, w + y), np.arctan2(x - z, w - y)
        low, high = np.hypot(x + z, w + y), np.hypot(x - z, w - y)
        middle = 2 * np.arctan2(low, high) - np.pi / 2
        minus_lost, plus_lost = high < 1e-7, low < 1e-7
    pole = minus_lost | plus_lost
    first = np.where(minus_lost, 2 * plus, np.where(plus_lost, 2 * minus, plus + minus))
    third = np.where(pole, 0.0, sign * (plus - minus))
    angles = np.stack([_wrap(first), middle, _wrap(third)], axis=-1)
    if not continuous or angles.ndim < 2 or len(angles) < 2:
        return angles
    mirror, flip = np.array([1.0, -1.0, 1.0]), np.array([np.pi, 0.0 if proper else np.pi, np.pi])
    slope = sign * np.where(minus_lost, -1.0, 1.0)  # first per third at a pole, where one may be traded for the other
    for f in range(1, len(angles)):
        before, now = angles[f - 1], angles[f]
        slide = np.where(pole[f], _wrap(before[..., 2]), 0.0)
        now[..., 0] += slope[f] * slide
        now[..., 2] += slide
        near, far = before + _wrap(now - before), before + _wrap(now * mirror + flip - before)
        shorter = np.abs(far - before).sum(-1, keepdims=True) < np.abs(near - before).sum(-1, keepdims=True) - 1e-9
        angles[f] = np.where(shorter, far, near)
    return angles


def _wrap(angle: Floats) -> Floats:
    """Into -pi..pi."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
