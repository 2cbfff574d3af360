"""Segments joined into one skin: the way back from `segment`, and the way to a skin for bodies of rigid pieces.

Source: note hanim.md, section 7 ("welding the copies gives back the mesh").
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Material, Segment, Shape
from vitruvian.hanim.normals import turned

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


def weld(humanoid: Humanoid) -> Humanoid:
    """A copy whose Segments carry no surface: all of it is one skin, moved by `skinCoordWeight`.

    Pieces that were cut out of a skin (`segment`, also when they went through a file with its skinCoord) become that
    skin again, with its weights. Other Segment geometry joins it with weight 1 on its joint, transforms baked into the
    points; points of different pieces that coincide and follow the same joint become one. Displacers of Segments become
    displacers of joints. Geometry of Sites, masses and Sites stay. Metres, humanoid space.
    """
    return _Welder(humanoid).welded()


def pieces(humanoid: Humanoid, *, by_place: bool = True) -> Iterator[tuple[Joint, Segment, Shape]]:
    """Every shape of a Segment that copies skin points, in tree order, with `skin_index`.

    With `by_place` also those read from a file, where only their places tell which points they copy.
    """
    known: dict[bytes, list[int]] = {}
    if by_place and len(humanoid.skin_coord) and not humanoid.skin:
        for row, point in enumerate(humanoid.skin_coord.astype(np.float32) + 0.0):
            known.setdefault(point.tobytes(), []).append(row)
    for joint in humanoid.joints():
        own = dict(zip(joint.skin_coord_index.tolist(), joint.skin_coord_weight.tolist()))
        for home in joint.segments:
            found: dict[int, Ints | None] = {}
            for shape in home.shapes:
                if shape.points is None:
                    continue
                if shape.skin_index is None and known and shape.transform is None:
                    if id(shape.points) not in found:
                        found[id(shape.points)] = _by_place(shape.points, known, own)
                    index = found[id(shape.points)]
                    if index is not None:
                        yield joint, home, replace(shape, skin_index=index)
                elif shape.skin_index is not None and len(humanoid.skin_coord):
                    yield joint, home, shape


def _by_place(points: Floats, known: dict[bytes, list[int]], own: dict[int, float]) -> Ints | None:
    """The skin points (n,) where these stand, None when one stands elsewhere.

    Of several at one place: `segment` keeps the order of the skin, so those between their neighbours; then those that
    the joint moves most.
    """
    rows = [known.get(p.tobytes(), []) for p in points.astype(np.float32) + 0.0]
    if not all(rows):
        return None
    first = np.array([r[0] for r in rows])
    sure = np.array([len(r) == 1 for r in rows])
    low = np.maximum.accumulate(np.where(sure, first, -1))
    high = np.minimum.accumulate(np.where(sure, first, np.iinfo(np.int64).max)[::-1])[::-1]
    index = first.astype(np.int32)
    taken = set(first[sure].tolist())
    for k in np.flatnonzero(~sure):
        free = [r for r in rows[k] if r not in taken] or rows[k]
        between = [r for r in free if low[k] < r < high[k]]
        index[k] = max(between or free, key=lambda r: (own.get(r, 0.0), -r))
        taken.add(int(index[k]))
    return index


def restored(piece: Shape, count: int) -> Shape:
    """A piece with `skin_index` as a shape of the skin: its triangles index `count` skin points."""
    index = piece.skin_index
    assert index is not None
    colors = None
    if piece.colors is not None:
        colors = np.full((count, 3), 0.8)
        colors[index] = piece.colors
    return replace(
        piece,
        points=None,
        triangles=index[piece.triangles],
        uv_triangles=piece.triangles if piece.uv is not None and piece.uv_triangles is None else piece.uv_triangles,
        colors=colors,
        normals=None,
        normal_triangles=None,
        skin_index=None,
        node=None,
    )


class _Welder:
    """One skin under construction."""

    def __init__(self, humanoid: Humanoid):
        self.old = humanoid
        self.points: list[Floats] = [humanoid.skin_coord]
        self.count = len(humanoid.skin_coord)
        self.places: dict[tuple[str, bytes, int], int] = {}  # joint, place, how many there before -> row
        self.gain: dict[str, list[int]] = {}  # joint -> rows that ride with it
        self.shapes: list[tuple[Shape, str]] = []  # over skin rows, and the joint they come from
        self.moves: dict[str, list[tuple[str, Displacer]]] = {}  # displacer name -> parts and their joints

    def welded(self) -> Humanoid:
        old = self.old
        cut = {(id(home), id(s.points)): s for _, home, s in pieces(old)}
        used: dict[int, Ints] = {}  # segment -> skin row of each point that its displacers index
        for joint in old.joints():
            for home in joint.segments:
                for shape in home.shapes:
                    if shape.points is None:
                        continue
                    model = cut.get((id(home), id(shape.points)))
                    if model is not None and model.skin_index is not None:
                        index = model.skin_index
                    else:
                        index = self._placed(shape, joint)
                    self.shapes.append((replace(turned(shape), skin_index=index), joint.name))
                    used.setdefault(id(home), index)
                if home.displacers and id(home) in used:
                    self._displacers(home, joint, used[id(home)])
        return self._finished()

    def _placed(self, shape: Shape, joint: Joint) -> Ints:
        """Rows of the skin for points of rigid geometry, new ones where none stands there for this joint."""
        assert shape.points is not None
        baked = turned(shape)
        assert baked.points is not None
        rows = np.empty(len(baked.points), np.int32)
        seen: dict[bytes, int] = {}
        fresh = []
        for k, point in enumerate(baked.points + 0.0):
            place = point.tobytes()
            seen[place] = seen.get(place, 0) + 1  # points of one piece stay apart: its hard edges
            key = (joint.name, place, seen[place])
            if key not in self.places:
                self.places[key] = self.count
                self.count += 1
                fresh.append(point)
                self.gain.setdefault(joint.name, []).append(self.places[key])
            rows[k] = self.places[key]
        if fresh:
            self.points.append(np.array(fresh))
        return rows

    def _displacers(self, home: Segment, joint: Joint, index: Ints) -> None:
        model = next(s for s in home.shapes if s.points is not None)
        matrix = np.eye(3) if model.transform is None else model.transform[:3, :3]
        for d in home.displacers:
            whole = replace(d, coord_index=index[d.coord_index], displacements=d.displacements @ matrix.T, node=None)
            self.moves.setdefault(d.name, []).append((joint.name, whole))

    def _finished(self) -> Humanoid:
        old, out = self.old, self.old.copied()
        for joint in out.joints():
            for home in joint.segments:
                home.shapes = _left(home)
                home.displacers = home.displacers if home.shapes else []
            rows = self.gain.pop(joint.name, [])
            if rows:
                joint.skin_coord_index = np.concatenate([joint.skin_coord_index, rows]).astype(np.int32)
                joint.skin_coord_weight = np.concatenate([joint.skin_coord_weight, np.ones(len(rows))])
        by_name = {c.name: c for c in out.joints()}
        for name, parts in self.moves.items():
            for owner, d in self._joined(name, parts):
                by_name[owner].displacers.append(d)
        skin = [*(_padded(s, self.count) for s in old.skin), *_merged(self.shapes, self.count)]
        normal = old.skin_normal if len(self.points) == 1 else None
        return replace(out, skin=skin, skin_coord=np.concatenate(self.points), skin_normal=normal).settled()

    def _joined(self, name: str, parts: list[tuple[str, Displacer]]) -> list[tuple[str, Displacer]]:
        """Displacers of one name are parts of one that was cut: joined at the lowest joint above all of them."""
        if len(parts) == 1:
            return parts
        index = np.concatenate([d.coord_index for _, d in parts])
        moves = np.concatenate([d.displacements for _, d in parts])
        rows, first = np.unique(index, return_index=True)
        top = _common([owner for owner, _ in parts], self.old)
        return [(top, replace(parts[0][1], coord_index=rows.astype(np.int32), displacements=moves[first]))]


def _padded(shape: Shape, count: int) -> Shape:
    """A shape of the skin after points were added behind its own."""
    if shape.colors is None or shape.points is not None or len(shape.colors) >= count:
        return shape
    more = np.full((count - len(shape.colors), 3), 0.8)
    return replace(shape, colors=np.concatenate([shape.colors, more]))


def _left(home: Segment) -> list[Shape]:
    """Shapes that stay with a Segment: those without points of their own."""
    return [s for s in home.shapes if s.points is None]


def _common(names: list[str], humanoid: Humanoid) -> str:
    """The lowest joint that is above, or is, each of these."""
    above: dict[str, str | None] = {j.name: None for j in humanoid.skeleton}
    for joint in humanoid.joints():
        above |= {c.name: joint.name for c in joint.joints}
    paths = []
    for name in names:
        path: list[str] = []
        at: str | None = name
        while at is not None:
            path.append(at)
            at = above[at]
        paths.append(path[::-1])
    shared = [level[0] for level in zip(*paths) if len(set(level)) == 1]
    return shared[-1] if shared else humanoid.skeleton[0].name


def _merged(shapes: list[tuple[Shape, str]], count: int) -> list[Shape]:
    """Skin shapes, each of all pieces that look the same and were named alike; in order of their first points."""
    groups: dict[tuple, list[Shape]] = {}
    for shape, joint in shapes:
        name = shape.name.removesuffix(f"_{joint}")
        whole = restored(replace(shape, name=name), count)
        uv = whole.uv if whole.uv is None else whole.uv.tobytes()
        key = (name, _look(whole.material), uv, whole.colors is None, round(whole.crease_angle, 6))
        groups.setdefault(key, []).append(whole)
    out = []
    for group in groups.values():
        first = group[0]
        colors = None
        if first.colors is not None:
            colors = np.full((count, 3), 0.8)
            for s in group:
                used = np.unique(s.triangles)
                colors[used] = s.colors[used] if s.colors is not None else 0.8
        corners = [s.uv_triangles for s in group if s.uv_triangles is not None]
        triangles = np.concatenate([s.triangles for s in group])
        faces = _numbered(group)
        uv_triangles = np.concatenate(corners) if corners else None
        out.append(replace(first, triangles=triangles, uv_triangles=uv_triangles, colors=colors, faces=faces))
    return sorted(out, key=lambda s: int(s.triangles.min(initial=count)))


def _numbered(group: list[Shape]) -> Ints | None:
    """Polygon numbers of shapes laid end to end; None when none of them has any."""
    if all(s.faces is None for s in group):
        return None
    out, count = [], 0
    for s in group:
        own = np.arange(len(s.triangles)) if s.faces is None else s.faces
        out.append(own + count)
        count += int(own.max(initial=-1)) + 1
    return np.concatenate(out).astype(np.int32)


def _look(m: Material) -> tuple:
    return (m.color, m.roughness, m.metallic, m.opacity, m.emission, m.double_sided, id(m.node) if m.node else 0)
