"""Reusing what a body has on another surface: weights, texture coordinates, Sites, Displacers and contours.

The other surface is a body with joints of its own, a scan without any, a garment that lies on the source at rest, or an
accessory that goes with one Segment. Source: seed 003, section 3.2 and table 1; note body.md, section 4.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.pack import pack
from vitruvian.body.types import Body, Floats, Ints, Skeleton, Weights, floats, indices
from vitruvian.errors import VitruvianError, warn
from vitruvian.hanim.humanoid import Humanoid, Joint, Material, Segment, Shape
from vitruvian.hanim.tables import canonical
from vitruvian.hanim.welding import weld
from vitruvian.modeling import shrink, source
from vitruvian.modeling.aligning import hidden, is_main, shared
from vitruvian.modeling.anatomy import folded
from vitruvian.modeling.carrying import carried_displacers, carried_sites, carried_uv, each_joint
from vitruvian.modeling.fit import UNITS, fit
from vitruvian.modeling.metric import in_metres, unit_of
from vitruvian.modeling.person import humanoid_of
from vitruvian.modeling.shape import Shape as Sliders
from vitruvian.modeling.template import body_template
from vitruvian.modeling.transfer import Matched, Surface, match

KINDS = ("body", "garment", "accessory")
WHOLE = 0.8  # of the source's height: what is as high is a body, not a garment
NEAR, FAR = 0.06, 0.5  # metres from the skin: a garment's nearest part, and what cannot be meant
LARGE = 20.0  # metres
FEW = 0.005  # of a body's points: lashes and buttons are not worth a word
LEAST = 8  # feature points that a source must have to be fitted to a scan
CLOTH = (0.5, 0.54, 0.6)  # sRGB


@dataclass(frozen=True, eq=False)
class Sheet:
    """A target's surface: vertices (n,3) in `unit`, triangles (t,3); uv (u,2), uv_triangles (t,3), colors (n,3) or None."""

    vertices: Floats
    triangles: Ints
    uv: Floats | None = None
    colors: Floats | None = None
    name: str = "object"
    unit: str = "m"
    uv_triangles: Ints | None = None


@dataclass(frozen=True, eq=False)
class Reused:
    """`humanoid`: the surface with what it got; `kind`: what it was taken for; `report`: "filled" share of its points
    whose weights were filled in, "sites", "displacers" and "contours" counted, "uv" whether texture coordinates came
    from the source, "joint" of an accessory."""

    humanoid: Humanoid
    kind: str
    report: dict[str, Any] = field(default_factory=dict)


def reuse(
    humanoid: Humanoid,
    target: Humanoid | Surface,
    *,
    kind: str | None = None,
    joint: str | None = None,
    wear: bool = False,
    landmarks: Mapping[Any, Any] | None = None,
    unit: str | None = None,
    name: str | None = None,
) -> Reused:
    """What a skinned humanoid has, on another surface: its weights, and what of texture coordinates, Sites, Displacers and
    contours the surface has not by itself.

    target: a Humanoid with joints of its own, in the same rest pose, which keeps them; or a mesh (vertices (n,3),
    triangles (t,3)). A mesh as high as the source is a "body": a scan in any pose between A and T that `vitruvian.fit`
    first finds the joints of (`landmarks`, `unit` as there), and the result is in the rest pose. Others lie on the source
    at rest: a "garment", or with `joint` an "accessory", which goes with one joint's Segment; "" finds the joint. `unit`
    scales them, too. `wear`: garments and accessories come on the source's body instead of on its joints alone.
    Raises VitruvianError for a mesh without triangles, one that lies far from the body or is of a size that no garment
    has (with the unit it may be in), for joints that the source lacks, and a source without skin.
    """
    if kind is not None and kind not in KINDS:
        raise VitruvianError(f"kind: expected {', '.join(KINDS)}, found {kind!r}")
    humanoid = in_metres(humanoid)
    body = pack(humanoid)
    if not len(body.skin.triangles) or not (body.skin.weights.sums > 0).any():
        raise VitruvianError(
            f"transfer: expected a source with a skin that joints move, found none in {humanoid.name!r}"
        )
    if isinstance(target, Humanoid):
        if target.joints() and kind in (None, "body"):
            return _on_body(humanoid, body, target)
        target = surface_of(target)
    mesh = _checked(target)
    if joint is not None:
        kind = "accessory"
    kind = kind or _guessed(body, mesh, unit)
    if kind == "body":
        return _on_scan(humanoid, mesh, landmarks, unit, name)
    mesh = _placed(body, mesh, unit)
    if kind == "accessory":
        return _on_segment(humanoid, body, mesh, joint or "", wear, name)
    return _on_skin(humanoid, body, mesh, wear, name)


def surface_of(humanoid: Humanoid) -> Sheet:
    """The surface of a humanoid at rest, metres."""
    if humanoid.joints():
        skin = pack(humanoid).skin
        return Sheet(skin.rest, skin.triangles, skin.uv, None, humanoid.name, uv_triangles=skin.uv_triangles)
    shapes = [s for s in humanoid.skin if s.points is None]
    triangles = np.concatenate([np.zeros((0, 3), np.int32), *(s.triangles for s in shapes)])
    return Sheet(humanoid.skin_coord, triangles, name=humanoid.name)


def _checked(mesh: Surface) -> Sheet:
    vertices = floats(mesh.vertices, "target: vertices", None, 3)
    triangles = indices(mesh.triangles, "target: triangles", len(vertices), None, 3)
    if not len(triangles):
        raise VitruvianError("target: expected a surface, found no triangles")
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    if not np.linalg.norm(np.cross(b - a, c - a), axis=1).any():
        raise VitruvianError("target: expected a surface, found triangles without area")
    more: dict[str, Any] = {f.name: getattr(mesh, f.name, f.default) for f in fields(Sheet)[2:]}
    return Sheet(vertices, triangles, **more)


def _guessed(body: Body, mesh: Sheet, unit: str | None) -> str:
    """A mesh that is one person high, in some unit, is a body."""
    tall = float(np.ptp(body.skin.rest[:, 1]))
    size = np.ptp(mesh.vertices, axis=0).max()
    if unit is not None or mesh.unit != "m":
        return "body" if size * _factor(unit or mesh.unit) >= WHOLE * tall else "garment"
    lies = np.quantile(_off(body, mesh.vertices), 0.5) < NEAR
    if lies:
        return "body" if size >= WHOLE * tall else "garment"
    return "body" if any(WHOLE <= size * f / tall <= 1.3 for f in UNITS.values()) else "garment"


def _factor(unit: str) -> float:
    if unit not in UNITS:
        raise VitruvianError(f"unit: expected one of {', '.join(UNITS)}, found {unit!r}")
    return UNITS[unit]


def _off(body: Body, points: Floats) -> Floats:
    """(n,) distances to the skin of up to 4000 of points (m,3)."""
    some = points[np.unique(np.linspace(0, len(points) - 1, 4000).astype(int))]
    return shrink.closest(some, shrink.surface(body.skin.rest, body.skin.triangles))[0]


def _placed(body: Body, mesh: Sheet, unit: str | None) -> Sheet:
    """A garment in metres, checked to lie on the body."""
    factor = _factor(unit or mesh.unit)
    made = replace(mesh, vertices=mesh.vertices * factor, unit="m")
    near = float(_off(body, made.vertices).min())
    size = float(np.ptp(made.vertices, axis=0).max())
    if near > FAR or size > LARGE:
        hint = ""
        for other, f in UNITS.items():
            moved = mesh.vertices * f
            if f != factor and np.ptp(moved, axis=0).max() < 3 and float(_off(body, moved).min()) < NEAR:
                hint = f"; in {other} it would lie on the body, say the unit"
        raise VitruvianError(
            f"target: expected a surface on the body at rest, found one {near:.3g} m away and {size:.3g} m large{hint}"
        )
    if size < 0.01:
        warn(f"transfer: the target is only {size * 1000:.2g} mm large; is its unit right?")
    return made


def _on_skin(humanoid: Humanoid, body: Body, mesh: Sheet, wear: bool, name: str | None) -> Reused:
    made = match(body, mesh, distance=0.05).said()
    first = len(humanoid.skin_coord) if wear else 0
    out = _bones_of(humanoid, wear, name or (humanoid.name if wear else mesh.name))
    joints = each_joint(out)
    put_weights(joints, made.skin.weights, first, None)
    shape, textured = _shape(body, made, mesh, None, plain=True)
    out.skin = [*out.skin, replace(shape, triangles=(shape.triangles + first).astype(np.int32))]
    rest = made.skin.rest
    coordinates = np.concatenate([humanoid.skin_coord, rest]) if wear else rest
    out.skin_coord, out.skin_normal = coordinates, None
    moved = carried_displacers(humanoid, body, joints, made, first, None, 1.0)
    return _done(out, "garment", made, uv=textured, displacers=moved)


def _on_segment(humanoid: Humanoid, body: Body, mesh: Sheet, joint: str, wear: bool, name: str | None) -> Reused:
    """All of the mesh as a shape of one joint's Segment."""
    if joint and joint not in body.skeleton.index:
        from difflib import get_close_matches

        near = get_close_matches(joint, body.skeleton.names, n=1)
        raise VitruvianError(f"joint {joint!r:.60}: the body has none" + (f"; did you mean {near[0]}?" if near else ""))
    made = match(body, mesh, distance=0.05)
    if not joint:
        w, area = made.skin.weights, shrink.areas(made.skin.rest, made.skin.triangles)
        total = np.bincount(w.joint, w.weight * area[w.vertex], minlength=len(body.skeleton))
        joint = body.skeleton.names[int(np.argmax(total))]
    out = _bones_of(humanoid, wear, name or (humanoid.name if wear else mesh.name))
    holder = next(j for j in each_joint(out) if j.name == joint)
    if not holder.segments:
        holder.segments.append(Segment(f"{joint}_{mesh.name or 'accessory'}"))
    shape, textured = _shape(body, made, mesh, None, plain=True)
    holder.segments[0].shapes.append(replace(shape, points=mesh.vertices))
    return _done(out, "accessory", None, uv=textured, joint=joint)


def _on_body(humanoid: Humanoid, body: Body, target: Humanoid) -> Reused:
    """The weights for the target's own joints."""
    welded = not any(s.points is None and len(s.triangles) for s in target.skin)
    out = weld(target) if welded else target.copied()
    shapes = [s for s in out.skin if s.points is None and len(s.triangles)]
    if not shapes:
        raise VitruvianError(f"target {target.name!r}: expected a surface on its joints, found none")
    joints, unit = each_joint(out), unit_of(target)
    theirs = pack(_bare(out)).skeleton
    covered = source.array("triangles")[hidden(pack(out).skin)]
    triangles = np.concatenate([*(s.triangles for s in shapes), covered])
    mesh = _checked(Sheet(out.skin_coord * unit, triangles, name=target.name))
    made = match(body, mesh, skeleton=replace(theirs, centers=theirs.centers * unit), distance=0.05).said(FEW)
    onto = _taken_by(body.skeleton, theirs)
    for joint in joints:
        joint.skin_coord_index, joint.skin_coord_weight = np.zeros(0, np.int32), np.zeros(0)
    put_weights(joints, made.skin.weights, 0, onto)
    textured, start, fresh = False, 0, []
    main = is_main(mesh.vertices, triangles)
    for s in out.skin:
        if s.points is None and len(s.triangles):
            part = slice(start, start := start + len(s.triangles))
            if s.uv is None and main[part].mean() > 0.5:  # clothes and hair keep their own look
                shape, found = _shape(body, made, mesh, part)
                look = s.material
                if look.picture is None and look.node is None:
                    look = replace(look, picture=shape.material.picture)
                s = replace(s, uv=shape.uv, uv_triangles=shape.uv_triangles, material=look, node=None)
                textured |= found
        fresh.append(s)
    out.skin = fresh
    moved = carried_displacers(humanoid, body, joints, made, 0, onto, unit)
    sites = carried_sites(humanoid, body, joints, made, onto, unit)
    if body.contours:
        from vitruvian.modeling.contours import contours

        out = contours(out.settled())
    return _done(out, "body", made, uv=textured, displacers=moved, sites=sites, welded=welded)


def _taken_by(skeleton: Skeleton, other: Skeleton) -> Ints:
    """(J,) the joint of the other that takes the weights of each: the same, what the standard's lower levels have for it
    (the ball of the foot for its toes), or that of its parent."""
    out = shared(skeleton, other)
    index = {canonical(n) or n: j for j, n in reversed(list(enumerate(other.names)))}
    levels = [folded(loa) for loa in (3, 2, 1)]
    for j, p in enumerate(skeleton.parents):
        if out[j] < 0:
            name = canonical(skeleton.names[j]) or skeleton.names[j]
            found = [index[f[name]] for f in levels if f.get(name) in index]
            out[j] = found[0] if found else (out[p] if p >= 0 else 0)
    return out


def _bare(humanoid: Humanoid) -> Humanoid:
    """Its joints alone."""
    out = humanoid.copied()
    out.skin, out.skin_coord, out.skin_normal, out.skin_displacers = [], np.zeros((0, 3)), None, []
    for joint in out.joints():
        joint.skin_coord_index, joint.skin_coord_weight, joint.displacers = np.zeros(0, np.int32), np.zeros(0), []
        joint.segments = [
            replace(s, shapes=[], displacers=[], contours=[], coord=None, node=None) for s in joint.segments
        ]
    return out


def _on_scan(humanoid: Humanoid, mesh: Sheet, landmarks: Any, unit: str | None, name: str | None) -> Reused:
    """The scan's own surface, skinned, at rest."""
    given: dict[str, Any] = {"unit": unit or (mesh.unit if mesh.unit != "m" else None), "name": name or mesh.name}
    own = isinstance(humanoid.made_from, Sliders)
    if not own and len(body_template(pack(humanoid)).places) < LEAST:  # by the built-in person, who has feature points
        middle = _on_scan(humanoid_of(Sliders(), outfit=None, hair="none"), mesh, landmarks, unit, name)
        done = _on_body(humanoid, pack(humanoid), middle.humanoid)
        return replace(done, report=middle.report | done.report)
    if own:  # the built-in person, whose shape is found better
        found = fit(mesh, landmarks, outfit=None, hair="none", **given)
    else:
        found = fit(mesh, landmarks, template=humanoid, **given)
    body = pack(found.humanoid)
    metres = replace(mesh, vertices=mesh.vertices * UNITS[found.report["unit"]], unit="m")
    made = match(body, metres, matrices=joint_matrices(found.pose.skeleton, found.pose)[0], distance=0.04).said(FEW)
    out = _bones_of(found.humanoid, False, given["name"])
    joints = each_joint(out)
    sites = sum(len(j.sites) + sum(len(s.sites) for s in j.segments) for j in joints)
    put_weights(joints, made.skin.weights, 0, None)
    if metres.colors is None and metres.uv is None and body.skin.colors is not None:  # brows, lips, a painted suit
        metres = replace(metres, colors=np.clip(made.foot @ body.skin.colors, 0, 1))
    shape, textured = _shape(body, made, metres, None)
    out.skin, out.skin_coord, out.skin_normal = [shape], made.skin.rest, None
    moved = carried_displacers(found.humanoid, body, joints, made, 0, None, 1.0)
    if pack(humanoid).contours:
        from vitruvian.modeling.contours import contours

        out = contours(out.settled())
    return _done(out, "body", made, uv=textured, displacers=moved, sites=sites, fit=found.report)


def _done(out: Humanoid, kind: str, made: Matched | None, **report: Any) -> Reused:
    if made is not None:
        report["filled"] = float((np.diff(made.blend.indptr) == 0).mean())
    final = out.settled()
    report["contours"] = sum(len(s.contours) for s in final.segments())
    return Reused(final, kind, report)


def _bones_of(humanoid: Humanoid, whole: bool, name: str) -> Humanoid:
    """A copy: all of it, or its joints and Sites without skin."""
    if whole:
        return replace(humanoid.copied(), name=name)
    return replace(_bare(humanoid), name=name, motions=[], tracks=[], made_from=None, poses=[], skin_binding_coords=None,
                   skin_binding_normals=None)  # fmt: skip


def put_weights(joints: list[Joint], weights: Weights, first: int, onto: Ints | None) -> None:
    """Weights added to joints, for points that begin at `first`; `onto` (J,) renumbers the joints."""
    owner = weights.joint if onto is None else onto[weights.joint]
    pairs = Weights.from_pairs(len(weights), weights.vertex, owner, weights.weight)
    for j in np.unique(pairs.joint):
        some = pairs.joint == j
        joint = joints[j]
        index = np.concatenate([joint.skin_coord_index, pairs.vertex[some] + first]).astype(np.int32)
        given = joint.skin_coord_weight
        joint.skin_coord_index, joint.skin_coord_weight = index, np.concatenate([given, pairs.weight[some]])


def _shape(body: Body, made: Matched, mesh: Sheet, part: slice | None, *, plain: bool = False) -> tuple[Shape, bool]:
    """The mesh as a skin shape, or the triangles `part` of it, and whether its texture coordinates are the source's.

    `plain`: it is no skin and does not look like it.
    """
    triangles = made.skin.triangles if part is None else made.skin.triangles[part]
    look = max(body.skin.parts, key=lambda p: p.stop - p.start)
    if plain:
        look = replace(look, color=CLOTH, roughness=0.9, picture=None)
    color = look.color if mesh.colors is None else (1.0, 1.0, 1.0)
    material = Material(mesh.name, color=color, roughness=look.roughness, double_sided=_open(triangles, mesh.vertices))
    shape = Shape(mesh.name, triangles, None, made.skin.uv, made.skin.uv_triangles if part is None else None,
                  mesh.colors, material)  # fmt: skip
    if made.skin.uv is not None or body.skin.uv is None:
        return shape, False
    placed = replace(mesh, triangles=triangles)
    uv, corners = carried_uv(body, made.source, placed)
    return replace(shape, uv=uv, uv_triangles=corners, material=replace(material, picture=look.picture)), True


def _open(triangles: Ints, points: Floats) -> bool:
    """Whether a surface has borders, so that its inner side may be seen."""
    return bool(shrink.surface_of(points, triangles)[0].border.any())
