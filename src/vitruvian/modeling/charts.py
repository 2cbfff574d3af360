"""Texture coordinates of new faces on a mapped surface, each face on one island of the map.

Where the border of an island runs between the corners of a face, their own coordinates lie far apart on the picture, and
the face would show all that is between. It belongs to the island that most of its corners are on; the others take the
coordinates of the nearest place there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, Skin
from vitruvian.modeling.slicing import Whole, barycentric

_REACH = 0.6  # diagonals of a face from its middle within which triangles may show on it
_FAR = 1.6  # times as far apart as the map is dense there: coordinates that do not belong together


class Charts:
    """The islands of a skin's texture coordinates.

    `triangles` (T,3): of the skin, welded, so that faces that meet share points; `chosen`: those that may be shown.
    """

    def __init__(self, skin: Skin, triangles: Ints, chosen: Whole):
        from scipy.spatial import cKDTree

        assert skin.uv is not None and skin.uv_triangles is not None
        self.rest, self.triangles = skin.rest, triangles
        self.uv = skin.uv[skin.uv_triangles]
        # one number for the parts that the same picture lies on, and for each part without one; -1: no part
        numbers: dict[object, int] = {}
        self.of_parts = np.array(
            [numbers.setdefault(p.picture or n, len(numbers)) for n, p in enumerate(skin.parts)] + [-1]
        )
        self.group = np.repeat(self.of_parts[:-1], [p.stop - p.start for p in skin.parts])
        self.island = _islands(triangles, self.uv, self.group)
        corners = skin.rest[triangles]
        turned = lambda a: np.linalg.norm(a - np.roll(a, -1, axis=1), axis=2).max(axis=1)  # noqa: E731
        self.dense = turned(self.uv) / np.maximum(turned(corners), 1e-12)
        middle = corners.mean(axis=1)
        self.size = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
        self.chosen, self.middle = chosen, middle[chosen]
        self.tree = cKDTree(self.middle)

    def mapped(self, places: Floats, face: Whole, uv: Floats, group: Whole) -> Floats:
        """(n,k,2) texture coordinates of the corners (n,k,3) of faces, each face on one island of its `group` (n,), or of
        any where that is -1 or not there. `face` (n,k): the triangle that each corner lies on, -1: unknown; `uv` (n,k,2):
        its coordinates there, which stay where they are on the face's island."""
        out = uv.copy()
        across = np.linalg.norm(places.max(axis=1) - places.min(axis=1), axis=1)
        wide = np.linalg.norm(uv.max(axis=1) - uv.min(axis=1), axis=1)
        island, groups = self.island[face], self.group[face]
        odd = (face < 0).any(axis=1) | (island != island[:, :1]).any(axis=1)
        odd |= (group >= 0) & (groups != group[:, None]).any(axis=1)
        odd |= wide > _FAR * self.dense[face].max(axis=1) * across
        for n in np.flatnonzero(odd).tolist():
            out[n] = self._on_one(places[n], face[n], uv[n], int(group[n]), float(across[n]))
        return out

    def _on_one(self, places: Floats, face: Whole, uv: Floats, group: int, across: float) -> Floats:
        near = self._near(places, face, across)
        of_group = near[self.group[near] == group]
        near = of_group if len(of_group) else near
        middle, there = self._nearest(near, places.mean(axis=0)[None])
        known = (face >= 0) & np.isin(self.island[face], self.island[near])
        island = np.append(self.island[face[known]], self.island[there])
        at = np.concatenate([uv[known], middle])
        dense = self.dense[near]
        radius = np.array([_FAR * across * dense[self.island[near] == i].max() for i in island])
        alike = (island[:, None] == island) & (np.linalg.norm(at[:, None] - at, axis=2) <= radius[:, None])
        votes = alike[:, :-1].sum(axis=1) + 0.5 * alike[:, -1]  # the middle's decides where corners are as many
        best = int(np.argmax(votes))
        out = uv.copy()
        stays = np.zeros(len(uv), bool)
        stays[known] = alike[best, :-1]
        if stays.all():
            return out
        off = np.linalg.norm(self.uv[near] - at[best], axis=2).min(axis=1)
        same = self.island[near] == island[best]
        mine = same & (off <= max(float(radius[best]), float(off[same].min())))
        out[~stays] = self._nearest(near[mine], places[~stays])[0]
        return out

    def sewn(self, places: Floats, uv: Floats, edge: Whole, shown: Floats) -> Floats:
        """(n,3,2) texture coordinates of triangles (n,3,3) that have `uv` (n,3,2) themselves, but where their first two
        corners are edge `edge` (n,) of a seam, -1: of none, those that the other side has there, `shown` (P,2,2)."""
        out = uv.copy()
        some = np.flatnonzero(edge >= 0)
        for n in some[(uv[some, :2] != shown[edge[some]]).any(axis=(1, 2))].tolist():
            out[n] = self.continued(places[n], shown[edge[n]])
        return out

    def continued(self, places: Floats, uv: Floats) -> Floats:
        """(k,2) texture coordinates of a face's corners (k,3) whose first two have those of `uv` (2,2): the others those of
        the nearest places on the same island, so that a face beyond a border of the map shows what is along it."""
        across = float(np.linalg.norm(np.ptp(places, axis=0)))
        near = self._near(places, np.zeros(0, np.int64), across)
        off = np.linalg.norm(self.uv[near][:, :, None] - uv, axis=3).min(axis=(1, 2))
        home = near[np.argmin(off)]
        radius = max(_FAR * across * float(self.dense[home]), float(off.min()))
        mine = near[(self.island[near] == self.island[home]) & (off <= radius)]
        return np.concatenate([uv, self._nearest(mine, places[2:])[0]])

    def _near(self, places: Floats, face: Whole, across: float) -> Whole:
        """Triangles about a face; the nearest where there are none."""
        middle, reach = places.mean(axis=0), _REACH * across
        some = np.array(self.tree.query_ball_point(middle, reach + float(self.size.max())), np.int64)
        far = np.linalg.norm(self.middle[some] - middle, axis=1) if len(some) else np.zeros(0)
        some = some[far <= reach + self.size[self.chosen[some]]]
        if not len(some):
            some = np.atleast_1d(self.tree.query(middle)[1]).astype(np.int64)
        return np.union1d(self.chosen[some], face[face >= 0])

    def _nearest(self, triangles: Whole, places: Floats) -> tuple[Floats, Whole]:
        """(n,2) coordinates of the nearest places on triangles to places (n,3), and (n,) which triangle each is on."""
        import igl

        faces = np.ascontiguousarray(self.triangles[triangles], np.int64)
        _, which, at = igl.point_mesh_squared_distance(np.ascontiguousarray(places), self.rest, faces)
        which = np.asarray(which).reshape(-1)
        share = barycentric(self.rest[faces[which]], np.asarray(at).reshape(-1, 3))
        return np.einsum("nk,nkc->nc", share, self.uv[triangles[which]]), triangles[which]


def looks(skin: Skin, corners: Ints) -> tuple[Floats | None, Ints]:
    """What corners of triangles look like (n,k), texture coordinates before colours, and which each has (T,3)."""
    if skin.uv is None or skin.uv_triangles is None:
        return skin.colors, corners
    if skin.colors is None:
        return skin.uv, skin.uv_triangles
    keys, flat = np.unique(skin.uv_triangles.astype(np.int64) << 32 | corners, return_inverse=True)
    return np.concatenate([skin.uv[keys >> 32], skin.colors[keys & 0xFFFFFFFF]], axis=1), flat.reshape(-1, 3).astype(
        np.int32
    )


def _islands(triangles: Ints, uv: Floats, group: Whole) -> NDArray[np.int64]:
    """(T,) which island each triangle is of: those that meet at points with the same coordinates."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    keys = np.column_stack([triangles.reshape(-1), np.repeat(group, 3), np.round(uv.reshape(-1, 2) * 1e6)])
    corner = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1, 3)
    ends = np.concatenate([corner[:, :2], corner[:, 1:]])
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(int(corner.max(initial=0)) + 1,) * 2)
    return connected_components(graph, directed=False)[1][corner[:, 0]].astype(np.int64)
