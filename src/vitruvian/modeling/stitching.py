"""A skin cut along loops, parts of it taken out, and what is left sewn to other loops point by point.

Cutting divides triangles along a plane, but only those of the loops round the plane's centre. Sewing fills the strip
between such a loop and a contour with triangles whose corners are the points of both, so that nothing can open.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, Part, Skin, Weights
from vitruvian.modeling.charts import Charts, looks
from vitruvian.modeling.loops import divided, zipped
from vitruvian.modeling.slicing import Rings, Whole, frames, section

Mask = NDArray[np.bool_]
_SPOKES = 6  # planes through the middle of a hole that is bored
_ALIKE = 0.3  # how much of their weights points of two layers share


@dataclass(frozen=True, eq=False)
class Loop:
    """A contour that the skin is sewn to, in the plane through `center` across unit `axis`; `ring` has one contour.

    angles (P,): of its points in the plane from `forward` on. The skin is on the side that the axis points to (`side`
    1) or on the other (-1), and is cut `gap` (m) beyond the contour. joints (n,) and weights (n,): how the contour
    moves, said as skin weights; over `reach` (m) the skin's own weights become those. only (T,): triangles of
    the skin that may be cut, None for all. bored: the skin is not cut by the plane but by a tube round the contour, where
    a surface closes over it. shown (P,2,2): the texture coordinates of the two ends of each of its edges,
    where faces of the contours have others than points.
    """

    name: str
    center: Floats
    axis: Floats
    forward: Floats
    angles: Floats
    ring: Rings
    side: int
    gap: float
    reach: float
    joints: Ints
    weights: Floats
    only: Mask | None = None
    bored: bool = False
    shown: Floats | None = None

    @property
    def beyond(self) -> Floats:
        """Where the skin is cut."""
        return self.center + self.side * self.gap * self.axis

    def outside(self, points: Floats) -> Floats:
        """(n,) how far points (n,3) are on the skin's side of what cuts it, m: of the plane, or of the tube."""
        if not self.bored:
            return np.asarray(self.side * ((points - self.beyond) @ self.axis))
        off = points - self.center
        off = off - np.outer(off @ self.axis, self.axis)
        ring = self.ring.points[0] - self.center
        size = np.linalg.norm(ring - np.outer(ring @ self.axis, self.axis), axis=1)
        return np.asarray(
            np.linalg.norm(off, axis=1) - self.gap - np.interp(_angle(off, self), self.angles, size, period=2 * np.pi)
        )


class Cloth:
    """A skin on the way to be cut: triangles know which they come from, vertices which loops they lie on."""

    def __init__(self, skin: Skin, sliced: Whole, corners: Ints, charts: Charts | None = None):
        """`sliced`: the triangles that may be cut. `corners` (T,3): into the skin's colours. `charts`: of the skin, where
        it has texture coordinates."""
        self.rest, self.triangles = skin.rest, skin.triangles
        self.uv, self.corners = looks(skin, corners)
        self.first, self.looks = self.corners, self.uv
        self.part = np.repeat(np.arange(len(skin.parts)), [p.stop - p.start for p in skin.parts])
        self.origin = np.arange(len(skin.triangles))
        self.free = np.zeros(len(skin.triangles), bool)
        self.free[sliced] = True
        self.blend: list[tuple[Whole, Floats]] = []  # new vertices: the pair (n,2) each lies between, and where (n,)
        self.on: list[Mask] = []
        self.skin, self.charts = skin, charts

    def cut(self, loop: Loop) -> None:
        """Divide the triangles along the plane beyond a contour."""
        if loop.bored:
            self._bore(loop)
            return
        chosen = self._chosen(loop)
        found = section(self.rest, self.triangles[chosen], loop.beyond, loop.axis, loop.forward)
        faces = chosen[np.unique(found.face[np.isin(found.loop, found.round)])]
        self.on.append(self._divide((self.rest - loop.beyond) @ loop.axis, faces))

    def _chosen(self, loop: Loop) -> Whole:
        return np.flatnonzero(self.free if loop.only is None else self.free & loop.only[self.origin])

    def _bore(self, loop: Loop) -> None:
        """Divide triangles along a tube round a contour, where it meets a surface beyond it first: first along spokes, so
        that it meets edges all round, then along the tube."""
        near, far, mine = self._met(loop)
        chosen = lambda: np.flatnonzero(mine[self.origin])  # noqa: E731
        rays = np.linspace(0, np.pi, _SPOKES, endpoint=False)
        first, second = (d[0] for d in frames(loop.axis[None], loop.forward))
        for normal in np.cos(rays)[:, None] * first + np.sin(rays)[:, None] * second:
            self._divide((self.rest - loop.center) @ normal, chosen())
        height = loop.side * ((self.rest - loop.center) @ loop.axis)
        faces = chosen()
        low, high = (f(height[self.triangles[faces]], axis=1) for f in (np.min, np.max))
        self.on.append(self._divide(loop.outside(self.rest), faces[(low < far) & (high > near)]))

    def _met(self, loop: Loop) -> tuple[float, float, Mask]:
        """Between which distances (m) along its axis a bored contour's tube meets a surface first, and the triangles of
        the original (T,) that hang together with it."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        chosen = self._chosen(loop)
        t = self.triangles[chosen].astype(np.int64)
        ring = loop.ring.points[0]
        start, way = np.concatenate([[loop.center], ring]), loop.side * loop.axis
        a, b, c = np.moveaxis(self.rest[t], 1, 0)
        across = np.cross(way, c - a)
        size = np.einsum("nk,nk->n", b - a, across)
        size = np.where(np.abs(size) > 1e-15, size, np.inf)
        from_a = start[:, None] - a
        u = np.einsum("rnk,nk->rn", from_a, across) / size
        turned = np.cross(from_a, b - a)
        v, far = turned @ way / size, np.einsum("rnk,nk->rn", turned, c - a) / size
        far = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (far > 0), far, np.inf)
        mine = np.zeros(len(self.skin.triangles), bool)
        hit = np.flatnonzero(np.isfinite(far).any(axis=1))
        if not len(hit):
            return 0.0, 0.0, mine
        face, distance = np.argmin(far, axis=1)[hit], np.min(far, axis=1)[hit]
        ends = np.concatenate([t[:, [0, 1]], t[:, [1, 2]]])
        graph = coo_array((np.ones(len(ends)), ends.T), shape=(len(self.rest),) * 2)
        piece = connected_components(graph, directed=False)[1][t[:, 0]]
        mine[self.origin[chosen[np.isin(piece, piece[face])]]] = True
        return float(distance.min()) - loop.ring.radius, float(distance.max()) + loop.ring.radius, mine

    def _divide(self, d: Floats, faces: Whole) -> Mask:
        """Divide triangles where the values d (V,) of their corners change sign; which vertices are on that line then."""
        d = d.copy()
        d[np.abs(d) < 1e-7] = 0.0
        t = self.triangles[faces]
        sides = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
        pairs = np.unique(sides[d[sides[:, 0]] * d[sides[:, 1]] < 0], axis=0).astype(np.int64)
        first, touched = len(self.rest), np.unique(t)
        self.split(pairs, d[pairs[:, 0]] / (d[pairs[:, 0]] - d[pairs[:, 1]]))
        here = np.zeros(len(self.rest), bool)
        here[first:] = True
        here[touched[d[touched] == 0]] = True
        return here

    def split(self, pairs: Whole, share: Floats) -> None:
        """Put new vertices on edges `pairs` (n,2), lower number first, at `share` (n,) of the way, and divide all triangles
        that have them."""
        first = len(self.rest)
        edges = {(a, b): n for n, (a, b) in enumerate(pairs.tolist())}
        corners: dict[tuple[int, int], int] = {}
        shares: list[float] = []
        coordinates = 0 if self.uv is None else len(self.uv)
        new, new_uv, source = [], [], []
        t = self.triangles.astype(np.int64)
        sides = np.sort(np.stack([t, np.roll(t, -1, axis=1)], axis=-1), axis=-1)
        keys = sides[..., 0] * first + sides[..., 1]
        across = np.flatnonzero(np.isin(keys, pairs[:, 0] * first + pairs[:, 1]).any(axis=1))
        for n in across.tolist():
            tri, uv = self.triangles[n].tolist(), self.corners[n].tolist()
            middle: list[tuple[int, int] | None] = []
            for i in range(3):
                a, b, ua, ub = tri[i], tri[(i + 1) % 3], uv[i], uv[(i + 1) % 3]
                if a > b:
                    a, b, ua, ub = b, a, ub, ua
                e = edges.get((a, b))
                if e is None:
                    middle.append(None)
                    continue
                if (ua, ub) not in corners:
                    corners[ua, ub] = coordinates + len(corners)
                    shares.append(float(share[e]))
                middle.append((first + e, corners[ua, ub]))
            for face in divided(list(zip(tri, uv, strict=True)), middle):
                new.append([v for v, _ in face])
                new_uv.append([u for _, u in face])
                source.append(n)
        keep = np.ones(len(self.triangles), bool)
        keep[across] = False
        stack = lambda a, b: np.concatenate([a[keep], np.array(b, a.dtype).reshape(-1, *a.shape[1:])])  # noqa: E731
        for field in ("part", "origin", "free"):
            value = getattr(self, field)
            setattr(self, field, np.concatenate([value[keep], value[source]]) if source else value)
        self.triangles = stack(self.triangles, new)
        self.corners = stack(self.corners, new_uv)
        self.rest = np.concatenate([self.rest, _between(self.rest, pairs, share)])
        if self.uv is not None and corners:
            ends = np.array(list(corners), np.int64)
            self.uv = np.concatenate([self.uv, _between(self.uv, ends, np.array(shares))])
        self.blend.append((pairs, share))
        for n, on in enumerate(self.on):  # a line that is divided stays whole
            line = np.zeros(first, bool)
            line[: len(on)] = on
            self.on[n] = np.concatenate([line, line[pairs].all(axis=1)])

    def pieces(self) -> Whole:
        """(T,) which connected piece each triangle is of, the cuts between them."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        count, t = len(self.triangles), self.triangles.astype(np.int64)
        edges = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
        barred = np.zeros(len(edges), bool)
        for on in self.on:
            flag = np.zeros(len(self.rest), bool)
            flag[: len(on)] = on
            barred |= flag[edges].all(axis=1)
        keys, number = np.unique(edges[:, 0] * len(self.rest) + edges[:, 1], return_inverse=True)
        face = np.tile(np.arange(count), 3)
        some = ~barred
        graph = coo_array(
            (np.ones(int(some.sum())), (face[some], count + number[some])), shape=(count + len(keys),) * 2
        )
        return connected_components(graph, directed=False)[1][:count].astype(np.int64)

    def capped(self, loops: list[Loop]) -> Mask:
        """(T,) triangles of pieces that lie on the contours' side of a cut that they end at: lids of closed segments."""
        piece, corners = self.pieces(), self.rest[self.triangles]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) + 1e-15
        out = np.zeros(len(self.triangles), bool)
        for on, loop in zip(self.on, loops, strict=True):
            here = np.zeros(len(self.rest), bool)
            here[: len(on)] = on
            touching = np.isin(piece, piece[here[self.triangles].any(axis=1)])
            height = loop.outside(corners.mean(axis=1))
            mean = np.bincount(piece, area * height) / np.bincount(piece, area)
            out |= touching & (mean[piece] < 0)
        return out

    def without(self, gone: Mask) -> None:
        """Take triangles (T,) out."""
        for field in ("triangles", "corners", "part", "origin", "free"):
            setattr(self, field, getattr(self, field)[~gone])

    def sew(self, number: int, loop: Loop) -> Whole:
        """Fill the strip between cut `number` and its contour; the numbers (P,) of the contour's points, empty where
        the cut left no loop."""
        line = self._line(number, loop)
        if line is None:
            return np.zeros(0, np.int64)
        each = loop.ring.points.shape[1]
        first = len(self.rest)
        ring = np.arange(first, first + each)
        self.rest = np.concatenate([self.rest, loop.ring.points[0]])
        face, inside = loop.ring.face[0], loop.ring.barycentric[0]
        face = np.where(face >= 0, face, face[np.argmax(face >= 0)])
        beside: list[int] = []
        corner_of = dict(zip(self.triangles.ravel().tolist(), self.corners.ravel().tolist(), strict=True))
        ring_uv = np.arange(each)
        if self.uv is not None:
            assert self.looks is not None
            own = np.einsum("nk,nkc->nc", inside, self.looks[self.first[face]])
            ring_uv = len(self.uv) + ring_uv
            self.uv = np.concatenate([self.uv, own])
            if loop.bored:  # what a neck runs into keeps its colour up to the seam
                away = np.linalg.norm(self.rest[line][None] - loop.ring.points[0][:, None], axis=2)
                beside = line[away.argmin(axis=1)].tolist()
                ring_uv = np.array([corner_of[v] for v in beside])
        a = loop.angles - loop.angles[0]
        b = _angle(self.rest[line] - loop.beyond, loop) - loop.angles[0]
        start = int(np.argmin(np.abs(np.angle(np.exp(1j * b)))))  # beside the contour's first point
        line, b = np.roll(line, -start), np.roll(b, -start)
        b = np.unwrap(b)
        b = np.maximum.accumulate(b - 2 * np.pi * np.round(b[0] / (2 * np.pi)))
        a, b = np.append(a, 2 * np.pi), np.append(b, max(b[0] + 2 * np.pi, b[-1]))
        i = j = 0
        faces, edge = [], []
        while i < each or j < len(line):
            p, q, l, m = ring[i % each], ring[(i + 1) % each], line[j % len(line)], line[(j + 1) % len(line)]  # noqa: E741
            if j == len(line) or (i < each and a[i + 1] <= b[j + 1]):
                faces.append((p, q, l))
                edge.append(i)
                i += 1
            else:
                faces.append((p, m, l))
                edge.append(-1)
                j += 1
        strip = np.array(faces, np.int32)
        if loop.side > 0:  # the skin is below its contour
            strip = strip[:, ::-1]
        known = {int(v): int(u) for v, u in zip(ring, ring_uv, strict=True)}
        uv = np.array([[known.get(v, corner_of.get(v, 0)) for v in row] for row in strip.tolist()], np.int32)
        if self.charts is not None:
            lies = dict(zip(self.triangles.ravel().tolist(), np.repeat(self.origin, 3).tolist(), strict=True))
            there = [lies[v] for v in beside] if loop.bored else loop.ring.face[0]
            lies |= dict(zip(ring.tolist(), there, strict=True))
            on = np.array([[lies[v] for v in row] for row in strip.tolist()], np.int64)
            uv = self._shown(self.charts, strip, on, uv, self._home(line), np.array(edge), loop)
        self._add(strip, uv, line)
        return ring

    def _shown(self, charts: Charts, strip: Ints, on: Whole, looks: Ints, part: int, edge: Whole, loop: Loop) -> Ints:
        """(n,3) what corners of sewn triangles (n,3) look like, each triangle on one island of the map of its part: those
        that they lie `on` (n,3) and their `looks` (n,3) there, and more where these lie on others."""
        assert self.uv is not None
        own = self.uv[looks]
        group = np.full(len(strip), charts.of_parts[part])
        found = charts.mapped(self.rest[strip], on, own[..., :2], group)
        if loop.shown is not None and not loop.bored:
            turn = slice(None, None, -1 if loop.side > 0 else 1)  # the ends of edges first
            found = charts.sewn(self.rest[strip][:, turn], found[:, turn], edge, loop.shown)[:, turn]
        other = (found != own[..., :2]).any(axis=-1)
        more = np.concatenate([found[other], own[other][:, 2:]], axis=1)
        out = looks.copy()
        out[other] = len(self.uv) + np.arange(len(more))
        self.uv = np.concatenate([self.uv, more])
        return out

    def _line(self, number: int, loop: Loop) -> Whole | None:
        """The vertices of the widest loop that a cut left, the angle growing; None when there is none."""
        best, widest = None, 0.0
        for line in self.lines(self.on[number]):
            points = self.rest[line] - self.rest[line].mean(axis=0)
            area = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0) @ loop.axis
            if abs(area) > widest:
                best, widest = line if area < 0 else line[::-1], abs(area)
        return best

    def lines(self, along: Mask) -> list[Whole]:
        """The closed loops of open edges between vertices on a line (V,), in the direction of the faces beside them."""
        on = np.zeros(len(self.rest), bool)
        on[: len(along)] = along
        t = self.triangles.astype(np.int64)
        a, b = t[:, [0, 1, 2]].ravel(), t[:, [1, 2, 0]].ravel()
        both = on[a] & on[b]
        a, b = a[both], b[both]
        keys = np.minimum(a, b) * len(self.rest) + np.maximum(a, b)
        _, first, times = np.unique(keys, return_index=True, return_counts=True)
        open_ = first[times == 1]
        following: dict[int, list[int]] = {}
        for u, v in zip(a[open_].tolist(), b[open_].tolist(), strict=True):
            following.setdefault(u, []).append(v)
        out = []
        while following:
            start = next(iter(following))
            line, here = [start], start
            while here in following:
                ahead = following[here].pop()
                if not following[here]:
                    del following[here]
                if ahead == start:
                    break
                line.append(ahead)
                here = ahead
            else:
                continue  # not closed
            if len(line) > 2:
                out.append(np.array(line))
        return out

    def bridge(self, one: Whole, other: Whole) -> None:
        """Sew two loops of open edges (n,), (m,), each in the direction of its faces, to each other. The strip looks like
        what is beside the other."""
        p, q = one[::-1], other
        p = np.roll(p, -int(np.linalg.norm(self.rest[p] - self.rest[q[0]], axis=1).argmin()))
        strip = np.concatenate([p, q])[zipped(self.rest[p], self.rest[q])].astype(np.int32)
        corner_of = dict(zip(self.triangles.ravel().tolist(), self.corners.ravel().tolist(), strict=True))
        near = np.linalg.norm(self.rest[q][None] - self.rest[p][:, None], axis=2).argmin(axis=1)
        known = {int(v): corner_of[int(q[n])] for v, n in zip(p, near, strict=True)}
        corners = np.array([[known.get(v, corner_of[v]) for v in row] for row in strip.tolist()], np.int32)
        self._add(strip, corners, q)

    def close(self, lid: Ints, like: int) -> None:
        """Add triangles (n,3) over an open end, as if they came from triangle `like` of the original."""
        corner_of = dict(zip(self.triangles.ravel().tolist(), self.corners.ravel().tolist(), strict=True))
        corners = np.array([[corner_of[v] for v in row] for row in lid.tolist()], np.int32).reshape(-1, 3)
        self._add(lid, corners, lid.ravel().astype(np.int64))
        self.origin[len(self.origin) - len(lid) :], self.free[len(self.free) - len(lid) :] = like, True

    def _add(self, strip: Ints, corners: Ints, beside: Whole) -> None:
        """New triangles of the part that most triangles at some vertices are of."""
        if not len(strip):
            return
        home = self._home(beside)
        self.triangles = np.concatenate([self.triangles, strip])
        self.corners = np.concatenate([self.corners, corners])
        self.part = np.concatenate([self.part, np.full(len(strip), home)])
        self.origin = np.concatenate([self.origin, np.full(len(strip), -1)])
        self.free = np.concatenate([self.free, np.zeros(len(strip), bool)])

    def _home(self, beside: Whole) -> int:
        """The part that most triangles at some vertices are of."""
        near = np.flatnonzero(np.isin(self.triangles, beside).any(axis=1))
        return int(np.bincount(self.part[near]).argmax())

    def carried(self, values: Floats) -> Floats:
        """Values (V,n) of the original's vertices, such as weights (V,J), for all vertices; those of contours 0."""
        for pairs, share in self.blend:
            values = np.concatenate([values, _between(values, pairs, share)])
        return np.concatenate([values, np.zeros((len(self.rest) - len(values), values.shape[1]))])

    def meet(self, table: Floats, rings: list[Whole], loops: list[Loop]) -> Floats:
        """Weights (V,J) that become the contours' towards them, over each one's `reach` along the surface; layers that do
        not hang together with it go with the nearest points that do."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components, dijkstra
        from scipy.spatial import cKDTree

        if not loops:
            return table
        t = self.triangles.astype(np.int64)
        edges = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
        length = np.linalg.norm(self.rest[edges[:, 0]] - self.rest[edges[:, 1]], axis=1) + 1e-12
        order = np.unique(edges[:, 0] * len(self.rest) + edges[:, 1], return_index=True)[1]
        graph = coo_array((length[order], edges[order].T), shape=(len(self.rest),) * 2).tocsr()
        layer = connected_components(graph, directed=False)[1]
        near = np.zeros((len(loops), len(self.rest)))
        own = np.zeros((len(loops), table.shape[1]))
        for n, (ring, loop) in enumerate(zip(rings, loops, strict=True)):
            on = np.flatnonzero(self.on[n])
            start = np.concatenate([ring, on[np.isin(on, self.triangles)]])
            if len(start):
                far = dijkstra(graph, directed=False, indices=start, min_only=True, limit=loop.reach)
                s = np.clip(1 - far / loop.reach, 0, 1)
                near[n] = s * s * (3 - 2 * s)
                reached = np.flatnonzero(np.isfinite(far) & table.any(axis=1))
                others = np.flatnonzero(~np.isin(layer, layer[reached]))
                away, which = cKDTree(self.rest[reached]).query(
                    self.rest[others], distance_upper_bound=0.25 * loop.reach
                )
                inner = np.flatnonzero(np.isfinite(away))
                one, other = others[inner], reached[which[inner]]
                alike = np.minimum(table[one], table[other]).sum(axis=1) > _ALIKE  # a hand beside the hip is no layer
                near[n, one[alike]] = near[n, other[alike]]
            np.add.at(own[n], loop.joints, loop.weights)
        rest = 1 - near
        kept = rest.prod(axis=0)
        share = np.array([near[n] * np.delete(rest, n, axis=0).prod(axis=0) for n in range(len(loops))])
        total = kept + share.sum(axis=0)
        share, kept = share / np.maximum(total, 1e-12), kept / np.maximum(total, 1e-12)
        return kept[:, None] * table + share.T @ own

    def finished(self, table: Floats) -> Skin:
        """The skin that is left, with weights (V,J) of all vertices; without triangles that have become lines."""
        a, b, c = self.triangles.T
        self.without((a == b) | (b == c) | (c == a))
        order = np.argsort(self.part, kind="stable")
        triangles, corners, part = self.triangles[order], self.corners[order], self.part[order]
        uv = uv_triangles = colors = None
        hue = np.zeros(triangles.size, np.int64)
        if self.uv is not None:
            named, flat = np.unique(corners, return_inverse=True)
            looks = self.uv[named]
            if self.skin.uv is not None:
                uv, uv_triangles = looks[:, :2], flat.reshape(-1, 3).astype(np.int32)
            if self.skin.colors is not None:
                colors = looks[:, -3:]
                hue = np.unique(np.round(colors * 512), axis=0, return_inverse=True)[1].reshape(-1)[flat.reshape(-1)]
        pairs, first, where = np.unique(
            np.stack([triangles.reshape(-1), hue]), axis=1, return_index=True, return_inverse=True
        )
        used = pairs[0]  # where colours meet a point is there once for each
        if colors is not None:
            colors = colors[flat.reshape(-1)[first]]
        vertex, joint = np.nonzero(table[used] > 1e-6)
        parts: list[Part] = []
        for n, p in enumerate(self.skin.parts):
            start, stop = np.searchsorted(part, [n, n + 1]).tolist()
            if stop > start:
                parts.append(replace(p, start=start, stop=stop))
        morphs = []
        for m in self.skin.morphs:
            offset = np.full((len(self.rest), 3), np.nan)
            offset[m.index] = m.offset
            left = np.flatnonzero(np.isfinite(offset[used, 0]))
            if len(left):
                morphs.append(replace(m, index=left.astype(np.int32), offset=offset[used[left]]))
        return Skin(
            self.rest[used], where.reshape(-1, 3).astype(np.int32),
            Weights.from_pairs(len(used), vertex, joint, table[used][vertex, joint]), uv, uv_triangles,
            colors, tuple(parts), tuple(morphs),
        )  # fmt: skip


def _between(values: Floats, pairs: Whole, share: Floats) -> Floats:
    return values[pairs[:, 0]] + share[:, None] * (values[pairs[:, 1]] - values[pairs[:, 0]])


def _angle(points: Floats, loop: Loop) -> Floats:
    first, second = (d[0] for d in frames(loop.axis[None], loop.forward))
    return np.arctan2(points @ second, points @ first)
