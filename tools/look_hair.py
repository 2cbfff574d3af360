"""Hair, brows and lashes as thin strips bound to the skin: each vertex a mean of three skin points plus an offset."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.sparse import identity

from look_meshes import Cut, clip

Array = np.ndarray
CENTER = np.array([0.0, 0.765, 0.045])
# Where the hair ends: azimuth from the front (degrees) -> elevation seen from CENTER (degrees).
LINE = np.array(
    [(0, 32), (18, 32), (32, 29), (43, 20), (52, 8), (57, -8), (61, -20), (66, -22), (71, -8), (80, -3), (95, -3),
     (102, -9), (109, -26), (117, -38), (132, -46), (145, -49), (165, -50), (180, -52)], dtype=float
)  # fmt: skip


def direction(azimuth: Array, elevation: Array) -> Array:
    a, e = np.radians(azimuth), np.radians(elevation)
    return np.stack([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)], axis=-1)


def angles(d: Array) -> tuple[Array, Array]:
    d = d / np.linalg.norm(d, axis=-1, keepdims=True)
    return np.degrees(np.arctan2(d[..., 0], d[..., 2])), np.degrees(np.arcsin(np.clip(d[..., 1], -1, 1)))


def above_line(d: Array) -> Array:
    """Degrees above the hairline."""
    azimuth, elevation = angles(d)
    return elevation - np.interp(np.abs(azimuth), LINE[:, 0], LINE[:, 1])


def slerp(a: Array, b: Array, t: Array) -> Array:
    """(..., t, 3) along the great circle from a to b."""
    w = np.arccos(np.clip((a * b).sum(-1), -1, 1))[..., None]
    s = np.maximum(np.sin(w), 1e-6)
    return (np.sin((1 - t) * w) / s)[..., None] * a[..., None, :] + (np.sin(t * w) / s)[..., None] * b[..., None, :]


class Skin:
    """The reference body, for shooting at."""

    def __init__(self, points: Array, triangles: Array):
        from trimesh.ray.ray_pyembree import RayMeshIntersector

        self.triangles = triangles
        self.mesh = trimesh.Trimesh(points, triangles, process=False)
        self.rays = RayMeshIntersector(self.mesh)

    def hit(self, origins: Array, directions: Array) -> tuple[Array, Array, Array]:
        """(triangles' vertices (n,3), barycentric (n,3), points (n,3)); every ray must hit."""
        where, ray, tri = self.rays.intersects_location(origins, directions, multiple_hits=False)
        if len(ray) != len(origins):
            raise SystemExit(f"error: {len(origins) - len(ray)} of {len(origins)} rays missed the head")
        order = np.argsort(ray)
        where, tri = where[order], tri[order]
        bary = trimesh.triangles.points_to_barycentric(self.mesh.triangles[tri], where)
        bary = np.clip(bary, 0, 1)
        return self.triangles[tri], bary / bary.sum(axis=1, keepdims=True), where

    def toward(self, d: Array) -> tuple[Array, Array, Array]:
        """What is seen of the head from outside, looking along -d at its centre."""
        return self.hit(CENTER + 0.4 * d, -d)


def strips(center: Array, across: Array, width: Array) -> tuple[Array, Array]:
    """Flat ribbons: center (s,n,3), across (s,n,3) units, width (s,n). Returns vertices (s*n*2, 3) and triangles."""
    s, n, _ = center.shape
    half = across * (width / 2)[..., None]
    rows = np.stack([center - half, center + half], axis=2)
    index = np.arange(s * n * 2).reshape(s, n, 2)
    a, b, c, d = index[:, :-1, 0], index[:, :-1, 1], index[:, 1:, 1], index[:, 1:, 0]
    quads = [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    return rows.reshape(-1, 3), np.concatenate(quads).astype(np.int32)


def bound(
    skin: Skin, lines: Array, anchors: Array, width: Array, shade: Array, out: Array | None = None
) -> dict[str, Array]:
    """Ribbons along `lines` (s,n,3), bound to the skin below `anchors` (s,n,3 directions from CENTER).

    `out` (s,n,3): where they face; None: away from the middle of the head.
    """
    s, n, _ = lines.shape
    tri, bary, foot = skin.toward(anchors.reshape(-1, 3))
    tangent = np.gradient(lines, axis=1)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-9)
    if out is None:
        out = lines - CENTER
        out[..., 1] = np.where(lines[..., 1] < CENTER[1], 0, out[..., 1])
        out /= np.linalg.norm(out, axis=-1, keepdims=True)
    across = np.cross(out, tangent)
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-9)
    vertices, triangles = strips(lines, across, width)
    return {
        "point": np.repeat(tri, 2, axis=0),
        "share": np.repeat(bary, 2, axis=0),
        "offset": vertices - np.repeat(foot, 2, axis=0),
        "triangles": triangles,
        "shade": np.repeat(shade.reshape(-1), 2),
    }


def joined(parts: list[dict[str, Array]]) -> dict[str, Array]:
    starts = np.cumsum([0] + [len(p["point"]) for p in parts])
    out = {k: np.concatenate([p[k] for p in parts]) for k in ("point", "share", "offset", "shade")}
    out["triangles"] = np.concatenate([p["triangles"] + a for p, a in zip(parts, starts)])
    out["point"] = out["point"].astype(np.uint16)
    out["triangles"] = out["triangles"].astype(np.uint16)
    return {k: v.astype(np.float16) if v.dtype == np.float64 else v for k, v in out.items()}


def cap(points: Array, triangles: Array, ears: Array, lift) -> dict[str, Array]:
    """The scalp itself, lifted: fills what shows between the strips."""
    d = points - CENTER
    field = np.where(points[:, 1] < 0.6, -60.0, above_line(d))
    azimuth = np.radians(angles(d)[0])
    uneven = 0.9 * np.sin(17 * azimuth + 1) + 0.8 * np.sin(31 * azimuth) + 0.6 * np.sin(53 * azimuth + 2)
    field = np.minimum(field - 1.6 + uneven, (0.35 - ears) * 30)
    outer = np.linalg.norm(d, axis=1) > 0.055
    cut = Cut(identity(len(points), format="csr"), triangles[outer[triangles].all(axis=1)], {"line": field})
    cut = clip(cut, "line")
    p = cut.at(points)
    u = p - CENTER
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    share = np.zeros((len(p), 3))
    index = np.zeros((len(p), 3), np.int64)
    m = cut.means.tocsr()
    for k in range(2):
        has = np.diff(m.indptr) > k
        at = m.indptr[:-1][has] + k
        index[has, k], share[has, k] = m.indices[at], m.data[at]
    height = lift(u) * np.clip(cut.fields["line"] / 10, 0.06, 1)
    shade = np.full(len(p), 0.86)
    return {"point": index, "share": share, "offset": u * height[:, None], "triangles": cut.triangles, "shade": shade}


def scattered(count: int, seed: int) -> Array:
    """Directions spread evenly over the sphere, a little shaken."""
    k = np.arange(count) + 0.5
    y = 1 - 2 * k / count
    turn = np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - y * y)
    d = np.stack([r * np.sin(turn), y, r * np.cos(turn)], 1)
    d += np.random.default_rng(seed).normal(0, 0.035, d.shape)
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def short(skin: Skin, points: Array, triangles: Array, ears: Array) -> dict[str, Array]:
    """Short hair that grows from a whorl at the crown, longer on top."""
    rng = np.random.default_rng(1)
    whorl = direction(np.array(168.0), np.array(62.0))

    def top(d: Array) -> Array:
        return np.clip((angles(d)[1] - 25) / 45, 0, 1)

    start = scattered(2800, 2)
    start = start[above_line(start) > 1.0]
    away = start - whorl * (start @ whorl)[:, None]
    away = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6)
    away = away + 0.22 * np.cross(start, away) + 0.16 * rng.normal(size=away.shape)
    # Over the forehead the hair falls forward and a little to one side, as a short fringe.
    front = np.clip((start[:, 2] - 0.35) / 0.5, 0, 1)[:, None] * top(start)[:, None]
    away = away * (1 - 0.30 * front) + front * np.array([0.34, 0.0, 0.0])
    away -= start * (away * start).sum(1, keepdims=True)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    reach = np.radians(23 + 17 * top(start) + rng.uniform(-4, 4, len(start)))
    t = np.linspace(0, 1, 5)
    d = np.cos(reach[:, None] * t)[..., None] * start[:, None] + np.sin(reach[:, None] * t)[..., None] * away[:, None]
    # Stop at the hairline, unevenly: no edge as if cut with a bowl.
    forehead = np.clip((d[..., 2] - 0.55) / 0.25, 0, 1)
    ok = above_line(d) > -1.0 - rng.gamma(2.0, 1.1, (len(d), 1)) - 2.0 * forehead * rng.uniform(0, 1, (len(d), 1))
    last = np.where(ok.all(1), 4, np.maximum(ok.argmin(1) - 1, 0))
    good = last >= 2
    d, last, start, reach = d[good], last[good], start[good], reach[good]
    scale = (last / 4)[:, None] * t * reach[:, None]
    away = away[good]
    d = np.cos(scale)[..., None] * start[:, None] + np.sin(scale)[..., None] * away[:, None]
    _, _, foot = skin.toward(d.reshape(-1, 3))
    full = np.clip(above_line(d) / 14, 0.12, 1) ** 0.7
    lift = (
        (0.0035 + 0.0105 * top(d) * (0.75 + 0.5 * front[good]))
        * full
        * (0.35 + 0.65 * np.sin(np.pi * (0.15 + 0.62 * t)))
    )
    lift = lift * rng.uniform(0.85, 1.12, (len(d), 1)) + 0.0012
    lines = foot.reshape(d.shape) + d * lift[..., None]
    width = 0.0062 * np.interp(t, [0, 0.25, 0.7, 1], [0.7, 1, 0.7, 0.05]) * rng.uniform(0.6, 1.0, (len(d), 1))
    shade = rng.uniform(0.95, 1.05, (len(d), 1)) * np.interp(t, [0, 0.5, 1], [0.95, 1.0, 1.0])
    hair = bound(skin, lines, d, width, shade)
    base = cap(points, triangles, ears, lambda u: 0.0005 + 0.0018 * top(u))
    return joined([base, hair])


def bob(skin: Skin, points: Array, triangles: Array, ears: Array) -> dict[str, Array]:
    """Hair to the chin, parted beside the middle."""
    rng = np.random.default_rng(4)
    t_top = np.linspace(0, 1, 8)
    lines, anchors, widths, shades = [], [], [], []
    for layer, count in ((0, 84), (1, 84), (2, 72)):
        for side in (1, -1):
            u = (np.arange(count) + rng.uniform(0.1, 0.9, count)) / count
            arc = 32 + u * 118 + layer * 3  # along the parting, from the forehead over the top
            start = np.stack([np.full(count, 0.10 - 0.012 * side), np.sin(np.radians(arc)), np.cos(np.radians(arc))], 1)
            start /= np.linalg.norm(start, axis=1, keepdims=True)
            final = side * (51 + (180 - 51) * u**0.85) + rng.normal(0, 1.5, count)
            fall = direction(final, np.full(count, -2.0) + rng.normal(0, 2, count))
            # The front sweeps back over the temple instead of across the forehead.
            over = direction(side * (42 + 138 * u**0.9), 52 - 30 * u)
            first, second = slerp(start, over, t_top), slerp(over, fall, t_top)
            mix = (t_top * t_top * (3 - 2 * t_top))[:, None]
            d = first * (1 - mix) + second * mix
            d /= np.linalg.norm(d, axis=-1, keepdims=True)
            _, _, foot = skin.toward(d.reshape(-1, 3))
            # Close to the head where it grows, so that the front shows no edge of a sheet.
            body = 0.004 + 0.0036 * (layer + rng.uniform(-0.5, 0.5, (count, 1)))
            rise = np.array([0.05, 0.35, 0.7, 0.9, 1.0, 1.0, 1.0, 1.0])
            close = np.interp(u, [0, 0.6], [0.4, 1.0])[:, None]  # the front lies against the temples and cheeks
            lift = 0.0015 + close * rise * (body + np.array([0.0, 0.004, 0.006, 0.007, 0.007, 0.007, 0.008, 0.010]))
            r = np.linalg.norm(foot.reshape(d.shape) - CENTER, axis=-1)
            r = np.maximum(r, np.minimum(np.roll(r, 1, axis=1), 0.2) - 0.004)
            on_head = CENTER + d * (r + lift)[..., None]
            end = on_head[:, -1]
            back = np.abs(final) / 180
            length = end[:, 1] - (0.632 - 0.012 * back + rng.normal(0, 0.0014, count))
            s = np.linspace(0, 1, 6)[1:]
            flat = end - CENTER
            flat[:, 1] = 0
            r0 = np.linalg.norm(flat, axis=1, keepdims=True)
            flat /= r0
            bulge = np.interp(s, [0, 0.35, 0.7, 1], [0.001, 0.003, -0.002, -0.013])
            hang = (
                end[:, None]
                + (bulge - 0.022 * (1 - close) * s)[..., None] * flat[:, None]
                - (length[:, None] * s)[..., None] * np.array([0, 1, 0])
            )
            lines.append(np.concatenate([on_head, hang], axis=1))
            anchors.append(np.concatenate([d, np.repeat(d[:, -1:], 5, axis=1)], axis=1))
            w = np.interp(np.linspace(0, 1, 13), [0, 0.2, 0.8, 1], [0.5, 1, 1, 0.62])
            widths.append(0.0115 * w * rng.uniform(0.7, 1.2, (count, 1)))
            tone = np.interp(np.linspace(0, 1, 13), [0, 0.3, 0.5, 1], [0.84, 1.05, 0.97, 1.04])
            shades.append(rng.uniform(0.90, 1.08, (count, 1)) * tone * (0.86 + 0.07 * layer))
    hair = bound(skin, *(np.concatenate(a) for a in (lines, anchors, widths, shades)))
    return joined([cap(points, triangles, ears, lambda d: np.full(len(d), 0.0035)), hair])


def bun(skin: Skin, points: Array, triangles: Array, ears: Array) -> dict[str, Array]:
    """Hair drawn back from the hairline to a knot at the back of the head."""
    rng = np.random.default_rng(6)
    knot = direction(np.array(180.0), np.array(34.0))
    lines: list[Array] = []
    anchors, facing, widths, shades = [], [], [], []
    t = np.linspace(0, 1, 10)
    for layer, above in ((0, 0.8), (1, 8.0), (2, 18.0)):
        azimuth = np.linspace(-180, 180, 170, endpoint=False) + rng.normal(0, 0.6, 170)
        azimuth = (azimuth + 180) % 360 - 180
        start = direction(azimuth, np.interp(np.abs(azimuth), LINE[:, 0], LINE[:, 1]) + above)
        d = slerp(start, np.broadcast_to(knot, start.shape), t * 0.97)
        _, _, foot = skin.toward(d.reshape(-1, 3))
        lift = np.interp(t, [0, 0.15, 0.5, 0.85, 1], [0.0006, 0.003, 0.0055, 0.006, 0.012]) + 0.0006 * layer
        lift = lift + rng.normal(0, 0.0003, (len(d), 1))
        lines.append(foot.reshape(d.shape) + d * lift[..., None])
        anchors.append(d)
        facing.append(d)
        widths.append(0.0085 * np.interp(t, [0, 0.2, 0.8, 1], [0.7, 1, 0.9, 0.6]) * rng.uniform(0.8, 1.15, (len(d), 1)))
        shades.append(rng.uniform(0.94, 1.05, (len(d), 1)) * np.interp(t, [0, 0.4, 1], [0.94, 1.02, 0.95]))
    # The knot: ribbons wound about a flattened ball.
    _, _, foot = skin.toward(knot[None])
    middle = foot[0] + knot * 0.021
    side = np.array([1.0, 0, 0])
    up = np.cross(side, knot)
    turns = np.linspace(0, 2 * np.pi, 26, endpoint=False)
    s = np.linspace(-0.99, 0.99, 10) * np.pi / 2
    winding = turns[:, None] + 0.9 * s
    ball = (
        0.033 * (np.cos(s) * np.cos(winding))[..., None] * side
        + 0.033 * (np.cos(s) * np.sin(winding))[..., None] * up
        + (0.024 * np.sin(s))[None, :, None] * knot
    )
    lines.append(middle + ball)
    anchors.append(np.broadcast_to(knot, ball.shape))
    facing.append(ball / np.linalg.norm(ball, axis=-1, keepdims=True))
    widths.append(np.broadcast_to(0.0105 * np.cos(s * 0.85), (26, 10)))
    shades.append(rng.uniform(0.84, 1.12, (26, 1)) * np.interp(np.cos(s), [0, 1], [0.8, 1.06]))
    hair = bound(skin, *(np.concatenate(a) for a in (lines, anchors, widths, shades, facing)))
    return joined([cap(points, triangles, ears, lambda d: np.full(len(d), 0.0010)), hair])


def brows(skin: Skin, eye: Array) -> dict[str, Array]:
    """Both brows: fine tapered hairs that lean outward along an arc above the eye."""
    rng = np.random.default_rng(8)
    parts = []
    for side in (1, -1):
        n = 330
        u = np.sort(rng.uniform(0, 1, n))
        v = rng.uniform(-1, 1, n)
        x = -0.0165 + u * 0.0425
        y = 0.0130 + 0.0066 * np.sin(np.pi * np.minimum(u * 0.82, 1)) - 0.006 * np.maximum(u - 0.62, 0) / 0.38
        thick = np.interp(u, [0, 0.15, 0.6, 1], [0.0030, 0.0042, 0.0034, 0.0009])
        root = np.stack([x, y + v * thick], 1)
        lean = np.radians(np.interp(u, [0, 0.2, 0.5, 1], [64, 38, 14, -16]) - 18 * v + rng.normal(0, 6, n))
        length = np.interp(u, [0, 0.3, 1], [0.0052, 0.0072, 0.0046]) * rng.uniform(0.7, 1.15, n)
        s = np.linspace(0, 1, 3)
        line = root[:, None] + (length[:, None] * s)[..., None] * np.stack([np.cos(lean), np.sin(lean)], 1)[:, None]
        q = np.concatenate([line * [side, 1], np.zeros((n, 3, 1))], axis=-1) + [side * eye[0], eye[1], 0.4]
        tri, bary, foot = skin.hit(q.reshape(-1, 3), np.tile([0.0, 0, -1.0], (n * 3, 1)))
        lines = foot.reshape(n, 3, 3) + np.array([0, 0, 1.0]) * np.array([0.0002, 0.0011, 0.0010])[None, :, None]
        tangent = lines[:, 2] - lines[:, 0]
        normal = np.array([0.3 * side, 0.2, 1.0])
        across = np.cross(normal, tangent)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        width = 0.00062 * np.array([0.7, 1.0, 0.1]) * np.ones((n, 1))
        half = across[:, None] * (width / 2)[..., None]
        rows = np.stack([lines - half, lines + half], axis=2).reshape(-1, 3)
        index = np.arange(n * 6).reshape(n, 3, 2)
        a, b, c, d = index[:, :-1, 0], index[:, :-1, 1], index[:, 1:, 1], index[:, 1:, 0]
        t = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
        parts.append({
            "point": np.repeat(tri, 2, axis=0), "share": np.repeat(bary, 2, axis=0),
            "offset": rows - np.repeat(foot, 2, axis=0), "triangles": t,
            "shade": np.repeat(rng.uniform(0.75, 1.2, n), 6),
        })  # fmt: skip
    return joined(parts)


def lashes(groups: dict[str, Array], reference: Array, eyes: Array) -> dict[str, Array]:
    """Single lashes on the source's lash strips: triangles from the lid's edge to the tips."""
    rng = np.random.default_rng(9)
    parts = []
    for name, faces in groups.items():
        quads = faces
        center = eyes[0] if "-l-" in name else eyes[1]
        far = np.linalg.norm(reference - center, axis=1)
        used = np.unique(quads)
        # Follow the strip from the lid outward: neighbours along quads, sorted by distance from the eye.
        edges = np.concatenate([quads[:, [0, 1]], quads[:, [1, 2]], quads[:, [2, 3]], quads[:, [3, 0]]])
        rise = far[edges[:, 1]] - far[edges[:, 0]]
        edges = np.where((rise < 0)[:, None], edges[:, ::-1], edges)
        slope = np.abs(rise) / np.maximum(np.linalg.norm(reference[edges[:, 0]] - reference[edges[:, 1]], axis=1), 1e-9)
        best: dict[int, int] = {}
        for k in np.argsort(slope):
            if slope[k] > 0.35:
                best[int(edges[k, 0])] = int(edges[k, 1])
        roots = [v for v in used if v in best and v not in best.values()]
        chains = []
        for v in roots:
            chain = [int(v)]
            while chain[-1] in best and len(chain) < 8:
                chain.append(best[chain[-1]])
            chains.append((chain[0], chain[-1]))
        chains.sort(key=lambda c: reference[c[0], 0])
        ends = np.array(chains)
        count = 30 if name.endswith("2") else 22
        at = np.linspace(0, len(ends) - 1.001, count) + rng.uniform(-0.2, 0.2, count)
        at = np.clip(at, 0, len(ends) - 1.001)
        k, f = at.astype(int), at - at.astype(int)
        w = 0.10
        point = np.stack([ends[k, 0], ends[k + 1, 0], ends[k, 1], ends[k + 1, 1]], 1)
        reach = 0.8 if name.endswith("2") else 0.5
        tip_share = np.clip(f + rng.uniform(-0.3, 0.3, count), 0, 1)
        share = np.stack([
            np.stack([1 - np.clip(f - w, 0, 1), np.clip(f - w, 0, 1), 0 * f, 0 * f], 1),
            np.stack([1 - np.clip(f + w, 0, 1), np.clip(f + w, 0, 1), 0 * f, 0 * f], 1),
            np.stack([(1 - reach) * (1 - f), (1 - reach) * f, reach * (1 - tip_share), reach * tip_share], 1),
        ], 1)  # fmt: skip
        t = np.arange(count * 3).reshape(-1, 3)
        parts.append({
            "point": np.repeat(point, 3, axis=0), "share": share.reshape(-1, 4), "offset": np.zeros((count * 3, 3)),
            "triangles": t, "shade": np.ones(count * 3),
        })  # fmt: skip
    return joined(parts)
