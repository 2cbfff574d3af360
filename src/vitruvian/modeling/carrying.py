"""What goes over to another surface besides weights: texture coordinates, Displacers and Sites.

All of it by the points of the source's skin that are nearest, once this skin has been put where the other surface is.
Source: seed 003, section 3.2 and table 1; note body.md, section 4.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vitruvian.body.types import Body, Floats, Ints
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Segment, Site
from vitruvian.modeling import shrink
from vitruvian.modeling.aligning import is_main, main_piece, uncovered
from vitruvian.modeling.transfer import Matched, Surface

STILL = 5e-5  # metres: displacements below are none
_JUMP = 1.5  # of a triangle's size on the map: corners farther from where its middle expects them are beyond a seam


def each_joint(humanoid: Humanoid) -> list[Joint]:
    """Each joint once, in the order of `pack`."""
    return list({id(j): j for j in humanoid.joints()}.values())


def carried_uv(body: Body, source: Floats, mesh: Surface) -> tuple[Floats, Ints]:
    """(u,2), (t,3) texture coordinates for a mesh that lies on the body's skin at `source` (V,3).

    Each corner has those of the nearest point of the skin, unless that lies beyond a seam of the map from where the
    triangle's middle is; then the middle's triangle is carried on.
    """
    whole = uncovered(body.skin)
    whole = body.skin if whole.uv is None else whole
    main = is_main(whole.rest, whole.triangles)
    uv = whole.uv
    assert uv is not None and whole.uv_triangles is not None
    t, map_ = whole.triangles[main], whole.uv_triangles[main]
    skin = shrink.surface(source, t)
    points, faces = mesh.vertices, mesh.triangles
    corner = points[faces]
    face, share = shrink.closest(points, skin)[2:]
    own = np.einsum("nk,nka->na", share, uv[map_[face]])[faces]
    middle = corner.mean(axis=1)
    home = shrink.closest(middle, skin)[2]
    a, b, c = (source[t[home, k]] for k in range(3))
    u, v = b - a, c - a
    away = corner - a[:, None]
    uu, uv_, vv = (u * u).sum(1), (u * v).sum(1), (v * v).sum(1)
    pu, pv = np.einsum("nka,na->nk", away, u), np.einsum("nka,na->nk", away, v)
    size = np.maximum(uu * vv - uv_**2, 1e-30)[:, None]
    s, r = (vv[:, None] * pu - uv_[:, None] * pv) / size, (uu[:, None] * pv - uv_[:, None] * pu) / size
    place = uv[map_[home]]
    p, q = place[:, 1] - place[:, 0], place[:, 2] - place[:, 0]
    ahead = place[:, :1] + s[..., None] * p[:, None] + r[..., None] * q[:, None]
    scale = np.sqrt(np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])) / np.sqrt(np.sqrt(size[:, 0]) + 1e-12)
    wide = np.linalg.norm(corner - middle[:, None], axis=2).max(axis=1) * scale
    bad = (np.linalg.norm(own - ahead, axis=2) > _JUMP * wide[:, None]).any(axis=1)
    # sliver triangles carry on wildly: they keep to the map
    steep = np.linalg.norm(ahead - place.mean(axis=1)[:, None], axis=2).max(axis=1) > 20 * wide
    ahead[steep] = place.mean(axis=1)[steep][:, None]
    own[bad] = ahead[bad]
    found, index = np.unique(np.round(own.reshape(-1, 2), 7), axis=0, return_inverse=True)
    return found, index.reshape(-1, 3).astype(np.int32)


def carried_displacers(
    humanoid: Humanoid, body: Body, joints: list[Joint], made: Matched, first: int, onto: Ints | None, unit: float
) -> int:
    """Displacers of the source's skin on the new one, grown with it; how many of them move or mark any of its points.

    They go to `joints`, by `onto` (J,) where these are others, for points numbered from `first` on, in `unit` metres.
    """
    count = len(humanoid.skin_coord)
    mine = each_joint(humanoid)
    names = {d.name for j in joints for d in j.displacers} if first == 0 else set()
    grow = _grown(made, body)[:count]
    table = made.foot.tocsc()
    total = 0
    for j, joint in enumerate(mine):
        holder = joints[j if onto is None else int(onto[j])]
        for d in joint.displacers:
            index = np.asarray(d.coord_index, np.int64)
            if d.name in names or not len(index) or len(d.displacements) != len(index) or index.max() >= count:
                continue
            part = table[:, index]
            moves = part @ (d.displacements * grow[index, None])
            marks = np.abs(d.displacements).max() <= STILL
            here = np.asarray(part.sum(axis=1)).ravel() > 0.5 if marks else np.linalg.norm(moves, axis=1) > STILL
            rows = np.flatnonzero(here)
            if not len(rows):
                continue
            total += 1
            fresh = Displacer(
                d.name, (rows + first).astype(np.int32), moves[rows] / unit, d.weight, None, metadata=d.metadata,
                description=d.description, extras=dict(d.extras),
            )  # fmt: skip
            old = next((k for k, o in enumerate(holder.displacers) if o.name == d.name), None)
            if old is None:
                holder.displacers.append(fresh)
            else:  # worn: the body's own displacer moves the garment, too
                both = holder.displacers[old]
                holder.displacers[old] = replace(
                    both, coord_index=np.concatenate([both.coord_index, fresh.coord_index]),
                    displacements=np.concatenate([both.displacements, fresh.displacements]), node=None,
                )  # fmt: skip
    return total


def _grown(made: Matched, body: Body) -> Floats:
    """(V,) how much larger than at home each point of the source's skin is on the target."""
    triangles = uncovered(body.skin).triangles
    at_home = shrink.areas(body.skin.rest, triangles)
    ratio = shrink.areas(made.source, triangles) / np.maximum(at_home, 1e-12)
    return np.sqrt(np.clip(np.where(at_home > 0, ratio, 1), 0.1, 10))


def carried_sites(humanoid: Humanoid, body: Body, joints: list[Joint], made: Matched, onto: Ints, unit: float) -> int:
    """Sites that the target lacks, as far from its skin as they were from the source's; how many.

    They go to `joints`, by `onto` (J,), in `unit` metres.
    """
    have = {s.name for j in joints for s in [*j.sites, *(t for g in j.segments for t in g.sites)]}
    skin = shrink.surface(body.skin.rest, main_piece(body.skin.rest, uncovered(body.skin).triangles))
    total = 0
    for j, joint in enumerate(each_joint(humanoid)):
        holder = joints[int(onto[j])]
        groups: list[tuple[list[Site], bool]] = [(joint.sites, False), *((s.sites, True) for s in joint.segments)]
        for sites, inner in groups:
            fresh = [s for s in sites if s.name not in have]
            if not fresh:
                continue
            at = np.array([s.center + s.translation for s in fresh])
            _, foot, face, share = shrink.closest(at, skin)
            there = np.einsum("nk,nka->na", share, made.source[skin.triangles[face]]) + at - foot
            there /= unit
            if inner and not holder.segments:
                holder.segments.append(Segment(joint.segments[0].name))
            place = holder.segments[0].sites if inner else holder.sites
            place += [replace(s, translation=p - s.center, node=None) for s, p in zip(fresh, there, strict=True)]
            have |= {s.name for s in fresh}
            total += len(fresh)
    return total
