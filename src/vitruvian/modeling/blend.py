"""Blending people: mixtures of bodies of one topology.

A body is `v = W c + d`: what its joint centres c carry along by the skin's weights W, and displacements d. Mixtures are
affine in both, in the dress pose, so that everything else that has a place (Sites, Displacers, clothes, hair, eyes)
takes the same weights. The space of shapes that several people span is in `vitruvian.modeling.space`.

Source: seed 003, table 1, "Shape Interpolator".
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from vitruvian.body.types import Floats, require
from vitruvian.errors import VitruvianError, warn
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Shape, Site
from vitruvian.modeling.slicing import Whole

BEYOND = 0.5  # how far weights may leave 0..1 without a word
NEAR = 8  # points of the skin that carry a point of a part which only one person has


def measures_of(humanoid: Humanoid, names: Collection[str] | None = None) -> dict[str, float]:
    """Measures (m) of a body in the dress pose, by the names of `vitruvian person --measure`."""
    from vitruvian.modeling.figures import humanoid_figure
    from vitruvian.modeling.measures import NAMES, taken

    return taken(humanoid_figure(humanoid), NAMES if names is None else names).values


def blend(people: Sequence[Humanoid], weights: Sequence[float]) -> Humanoid:
    """The mixture `sum w_k person_k` of people of one topology in the dress pose; weights sum to 1.

    Points, joint centres, limits, Sites, Displacers, skin weights, texture coordinates, colours and masses follow. Hair
    and clothes that not all of them wear come from the leader, the person of greatest weight (the taller of equals), and
    are carried by the skin; so do names, motions and everything else (`worn`). The people stay as they are.
    Warns of weights more than 0.5 outside of 0..1; raises VitruvianError for fewer than two people, other counts, weights
    that are not finite or do not sum to 1, and bodies whose joints or skin differ.
    """
    require(len(people) > 1, "people", "two or more", len(people))
    w = np.asarray(weights, np.float64)
    require(w.shape == (len(people),), "weights", f"one for each of {len(people)} people", w.shape)
    require(bool(np.isfinite(w).all()) and abs(w.sum() - 1) < 1e-6, "weights", "numbers that sum to 1", list(weights))
    for other in people[1:]:
        alike(people[0], other)
    warn_beyond(w)
    return mixed(people, w, w)


def worn(people: Sequence[Humanoid], made: Humanoid) -> list[str]:
    """Names of the shapes of a mixture that not all people have alike: they are the leader's, carried by the skin."""
    parts = [parts_of(p) for p in people]
    own = parts_of(made)
    return [s.name for k, s in enumerate(made.skin[1:], 1) if _alike(people, parts, s, own[k]) is None]


def warn_beyond(w: Floats) -> None:
    if (w < -BEYOND).any() or (w > 1 + BEYOND).any():
        found = ", ".join(f"{x:.2f}" for x in w)
        warn(f"weights: {found} go more than {BEYOND} beyond the examples; the body may not look human")


def mixed(
    people: Sequence[Humanoid], joints: Floats, skins: Floats, *, lead: int | None = None, bare: bool = False
) -> Humanoid:
    """Mixture by weights of the joint parameters and of the displacements; `bare`: only what measures depend on."""
    if lead is None:  # of equal weights the taller one leads, whatever the order
        heights = [float(np.ptp(p.skin_coord[:, 1])) for p in people]
        lead = max(range(len(people)), key=lambda k: (round(float(skins[k]), 12), heights[k]))
    out = owned(people[lead])
    if np.array_equal(joints, skins) and skins[lead] == 1 and np.count_nonzero(skins) == 1:
        return out
    parts = [parts_of(p) for p in people]
    sets = [p.joints() for p in people]
    centers = np.array([[j.center for j in every] for every in sets])
    middle = np.tensordot(joints, centers, 1)
    extra = middle - np.tensordot(skins, centers, 1)  # by which the joints go another way than the displacements
    mine = out.joints()
    weights = held_by(mine, len(out.skin_coord))
    if not bare:
        weights = _held(mine, weights, sets, parts, [len(p.skin_coord) for p in people], skins, lead)
    out.skin_coord = _skin(people, parts, skins, lead) + weights @ extra
    out.skin_normal = None
    _moved(out.sites, [p.sites for p in people], skins, np.zeros(3))
    for k, joint in enumerate(mine):
        same = [every[k] for every in sets]
        joint.center = middle[k]
        _places(joint, same, skins, extra[k])
        if bare:
            continue
        for field in ("llimit", "ulimit", "stiffness"):
            values = [getattr(j, field) for j in same]
            if len({v.shape for v in values}) == 1:
                setattr(joint, field, np.tensordot(skins, np.array(values), 1))
        _displacers(joint.displacers, [j.displacers for j in same], skins, parts, lead)
    if bare:
        return out
    _displacers(out.skin_displacers, [p.skin_displacers for p in people], skins, parts, lead)
    _looks(out, people, skins)
    out.made_from = None
    _facts(out, people, skins)
    return out


def owned(humanoid: Humanoid) -> Humanoid:
    """A copy of which all that a mixture writes into is its own."""
    out = humanoid.copied()
    out.info = dict(out.info)
    out.skin = [replace(s) for s in out.skin]
    out.sites = [replace(s) for s in out.sites]
    out.skin_displacers = [replace(d) for d in out.skin_displacers]
    for joint in out.joints():
        joint.displacers = [replace(d) for d in joint.displacers]
        joint.sites = [replace(s) for s in joint.sites]
        for segment in joint.segments:
            segment.sites = [replace(s) for s in segment.sites]
    return out


def alike(one: Humanoid, other: Humanoid) -> None:
    """VitruvianError for people that are not of one topology, with what differs."""
    a, b = [j.name for j in one.joints()], [j.name for j in other.joints()]
    if a != b:
        differ = next((f"{x} and {y}" for x, y in zip(a, b, strict=False) if x != y), f"{len(a)} and {len(b)} joints")
        raise VitruvianError(f"{other.name}: expected the joints of {one.name}, found {differ}; give both one template")
    for h in (one, other):
        if not h.skin or h.skin[0].points is not None or not len(h.skin[0].triangles):
            raise VitruvianError(
                f"{h.name}: expected a seamless skin, found none; `vitruvian.weld` makes one of Segments"
            )
        if h.binding or h.skin_binding_coords is not None:
            raise VitruvianError(f"{h.name}: expected a skin in the dress pose, found one bound in another pose")
    sizes = [len(parts_of(h)[0]) for h in (one, other)]
    if sizes[0] == sizes[1]:  # clothes hide some of the skin: what both show must be the same
        rows = [_keys(_faces(h.skin[0], parts_of(h)[0])) for h in (one, other)]
        if len(np.intersect1d(rows[0], rows[1])) > 0.5 * min(map(len, rows)):
            return
    found = f"{sizes[0]:,} and {sizes[1]:,} points" if sizes[0] != sizes[1] else "other triangles"
    raise VitruvianError(
        f"{other.name}: expected the skin's topology of {one.name}, found {found}; fit both with one template"
    )


def _keys(triangles: Whole) -> Whole:
    """(t,) numbers of triangles, whatever corner they begin with."""
    a, b, c = np.sort(triangles, axis=1).astype(np.int64).T
    return (a << 42) + (b << 21) + c


def parts_of(h: Humanoid) -> list[Whole]:
    """Of every shape of the skin the points that are its own; those that no shape draws are the first one's."""
    count = len(h.skin_coord)
    owner = np.zeros(count, np.int64)
    for k, shape in enumerate(h.skin[1:], 1):
        owner[np.unique(shape.triangles)] = k
    return [np.flatnonzero(owner == k) for k in range(len(h.skin))]


def _faces(shape: Shape, own: Whole) -> Whole:
    return np.searchsorted(own, shape.triangles)


def _alike(people: Sequence[Humanoid], parts: list[list[Whole]], shape: Shape, own: Whole) -> list[Floats] | None:
    """Points of a shape in all people, None where not all have it."""
    faces, places = _faces(shape, own), []
    for p, all_own in zip(people, parts, strict=True):
        for other, mine in zip(p.skin[1:], all_own[1:], strict=True):
            if other.name == shape.name and len(mine) == len(own) and np.array_equal(_faces(other, mine), faces):
                places.append(p.skin_coord[mine])
                break
        else:
            return None
    return places


def _skin(people: Sequence[Humanoid], parts: list[list[Whole]], w: Floats, lead: int) -> Floats:
    """Points of the mixture, in the order of `people[lead]`."""
    mine, leader = parts[lead], people[lead]
    out = leader.skin_coord.copy()
    bodies = np.array([p.skin_coord[every[0]] for p, every in zip(people, parts, strict=True)])
    body = np.tensordot(w, bodies, 1)
    out[mine[0]] = body
    tree: cKDTree | None = None
    for k, shape in enumerate(leader.skin[1:], 1):
        places = _alike(people, parts, shape, mine[k])
        if places is not None:
            out[mine[k]] = np.tensordot(w, np.array(places), 1)
            continue
        tree = tree or cKDTree(bodies[lead])
        distance, near = tree.query(leader.skin_coord[mine[k]], NEAR)
        share = 1 / (distance + 0.005)
        share /= share.sum(axis=1, keepdims=True)
        out[mine[k]] += np.einsum("vn,vnc->vc", share, (body - bodies[lead])[near])
    return out


def _held(
    mine: list[Joint],
    weights: csr_matrix,
    sets: list[list[Joint]],
    parts: list[list[Whole]],
    counts: list[int],
    w: Floats,
    lead: int,
) -> csr_matrix:
    """Skin weights of the mixture, put into its joints `mine`: where people's differ they are mixed, none below 0."""
    every = [held_by(j, n)[own[0]] for j, n, own in zip(sets, counts, parts, strict=True)]
    if all(abs(other - every[lead]).max() < 1e-9 for other in every):
        return weights
    total = sum((share * one for share, one in zip(w, every, strict=True)), start=csr_matrix(every[0].shape))
    total.data[total.data < 1e-6] = 0.0
    total.eliminate_zeros()
    sums = np.asarray(total.sum(axis=1)).ravel()
    kept = np.asarray(weights.sum(axis=1)).ravel()[parts[lead][0]]
    total = csr_matrix(total.multiply((kept / np.where(sums > 0, sums, 1.0))[:, None]))
    place = csr_matrix((np.ones(len(sums)), (parts[lead][0], np.arange(len(sums)))), (weights.shape[0], len(sums)))
    rest = np.ones(weights.shape[0])
    rest[parts[lead][0]] = 0.0
    out = csr_matrix(place @ total + weights.multiply(rest[:, None]))
    columns = out.tocsc()
    for k, joint in enumerate(mine):
        some = slice(columns.indptr[k], columns.indptr[k + 1])
        order = np.argsort(columns.indices[some])
        joint.skin_coord_index = columns.indices[some][order].astype(np.int32)
        joint.skin_coord_weight = columns.data[some][order]
    return out


def held_by(joints: list[Joint], count: int) -> csr_matrix:
    row = np.concatenate([j.skin_coord_index for j in joints])
    column = np.repeat(np.arange(len(joints)), [len(j.skin_coord_index) for j in joints])
    value = np.concatenate([j.skin_coord_weight for j in joints])
    return csr_matrix((value, (row, column)), (count, len(joints)))


def _places(joint: Joint, same: list[Joint], w: Floats, extra: Floats) -> None:
    """Sites and what Segments know of their place."""
    _moved(joint.sites, [j.sites for j in same], w, extra)
    for k, segment in enumerate(joint.segments):
        others = [j.segments[k] for j in same if k < len(j.segments)]
        if len(others) == len(w):
            _moved(segment.sites, [s.sites for s in others], w, extra)
            segment.center_of_mass = np.tensordot(w, np.array([s.center_of_mass for s in others]), 1) + extra


def _moved(sites: list[Site], same: list[list[Site]], w: Floats, extra: Floats) -> None:
    """Sites that all people have."""
    named = [{s.name: s for s in every} for every in same]
    for site in sites:
        others = [some[site.name] for some in named if site.name in some]
        if len(others) == len(w):
            site.translation = np.tensordot(w, np.array([s.translation for s in others]), 1) + extra
            site.center = np.tensordot(w, np.array([s.center for s in others]), 1)


def _displacers(
    displacers: list[Displacer], same: list[list[Displacer]], w: Floats, parts: list[list[Whole]], lead: int
) -> None:
    """Displacers that all people have, on the points that all have: all of them when they are counted alike, else those
    of the first shape."""
    alike = len({tuple(map(len, every)) for every in parts}) == 1 and all(
        np.array_equal(a, b) for every in parts for a, b in zip(every, parts[lead], strict=True)
    )
    named = [{d.name: d for d in every} for every in same]
    for displacer in displacers:
        found = [some[displacer.name] for some in named if displacer.name in some]
        if len(found) != len(w):
            continue
        rows, moves = [], []
        for k, (share, d) in enumerate(zip(w, found, strict=True)):
            index, own = d.coord_index.astype(np.int64), parts[k][0]
            at = np.minimum(np.searchsorted(own, index), len(own) - 1)
            common = np.full(len(index), True) if alike else own[at] == index
            rows.append(index[common] if alike else parts[lead][0][at[common]])
            moves.append(share * d.displacements[common])
            if k == lead:
                rows.append(index[~common])
                moves.append(d.displacements[~common])
        index, where = np.unique(np.concatenate(rows), return_inverse=True)
        total = np.zeros((len(index), 3))
        np.add.at(total, where.reshape(-1), np.concatenate(moves))
        displacer.coord_index, displacer.displacements = index.astype(np.int32), total


def _looks(out: Humanoid, people: Sequence[Humanoid], w: Floats) -> None:
    """Colours and texture coordinates, where all people have as many of them."""
    for k, shape in enumerate(out.skin):
        every = [p.skin[k] for p in people if k < len(p.skin) and p.skin[k].name == shape.name]
        shape.normals = shape.normal_triangles = None
        for field in ("colors", "uv"):
            own = getattr(shape, field)
            some = [getattr(s, field) for s in every]
            if own is None or len(some) != len(w) or any(c is None or c.shape != own.shape for c in some):
                continue
            if any(not np.array_equal(c, own) for c in some):
                mean = np.tensordot(w, np.array(some), 1)
                setattr(shape, field, np.clip(mean, 0, 1) if field == "colors" else mean)


def _facts(out: Humanoid, people: Sequence[Humanoid], w: Floats) -> None:
    """Height, age and masses in what the file says about the person; volumes are not linear, so they are taken anew."""
    body = out.skin_coord[parts_of(out)[0]]
    if "height" in out.info:
        out.info["height"] = f"{np.ptp(body[:, 1]):.3f}"
    try:
        out.info["age"] = f"{sum(x * float(p.info['age']) for x, p in zip(w, people, strict=True)):g}"
    except (KeyError, ValueError):
        out.info.pop("age", None)
    for name in ("gender", "weight"):
        values = {p.info.get(name) for p in people}
        if name == "weight" or len(values) > 1:
            out.info.pop(name, None)
    _masses(out, people, w)
    total = sum(s.mass for s in out.segments())
    if total > 0 and "weight" in people[0].info:
        out.info["weight"] = f"{total:.1f}"


def _masses(out: Humanoid, people: Sequence[Humanoid], w: Floats) -> None:
    """Of the built-in body taken anew from its volume; of others mixed."""
    from vitruvian.modeling import anatomy, source
    from vitruvian.modeling.figures import bare
    from vitruvian.modeling.person import body_pieces

    joints = {j.name: j for j in out.joints()}
    if bare(out) and all(j.segments for j in joints.values()):
        for loa in range(5):
            if list(joints) == [n for n in anatomy.names() if anatomy.folded(loa)[n] == n]:
                anatomy.add_masses(joints, out.skin_coord[: source.BODY], body_pieces(loa))
                return
    lists = [p.segments() for p in people]
    for k, segment in enumerate(out.segments()):
        some = [s[k] for s in lists if k < len(s) and s[k].name == segment.name]
        if len(some) == len(w):
            segment.mass = max(0.0, float(sum(x * s.mass for x, s in zip(w, some, strict=True))))
            segment.moments_of_inertia = np.tensordot(w, np.array([s.moments_of_inertia for s in some]), 1)
