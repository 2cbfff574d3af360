"""Any body as a contour body: limbs, torso and neck in contours; hands, feet, head, shoulders and hips sewn to them.

Contours lie in planes that turn from the bisector of one joint to that of the next; on request they fan about knees and
elbows, so that they are evenly apart when bent (`fans`). Their points are where rays from the bone meet the outermost
surface. The torso is a front and a back. What is not in contours keeps its triangles, cut along the planes and sewn to the
contours' own points: nothing can open. It moves by its own weights, which become the contours' towards them.

Source: cross-section deformation of H-Anim bodies (pre-oriented contours, torso in two halves, ExtrContour).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.contours import Contours
from vitruvian.body.organise import equivalent, organised
from vitruvian.body.pack import pack
from vitruvian.body.types import Floats, Part, Skin, require
from vitruvian.errors import VitruvianError, warn
from vitruvian.hanim import tables
from vitruvian.hanim.defbody import corners
from vitruvian.hanim.humanoid import ContourSurface, Displacer, Humanoid, Joint, Material, Segment, Shape
from vitruvian.hanim.welding import pieces, weld
from vitruvian.modeling.cuts import CLEAR, FRONT, OUTER, Cuts, unit
from vitruvian.modeling.fans import Fan, fan, tilts
from vitruvian.modeling.hems import Hemmed, clear, hemmed
from vitruvian.modeling.slicing import Rings, rings, section
from vitruvian.modeling.stitching import Cloth, Loop
from vitruvian.modeling.throats import HEAD, NECK, Throat, throat
from vitruvian.modeling.trials import shape_error
from vitruvian.modeling.tuning import assign
from vitruvian.modeling.unions import followed, united

FIXED = 2  # contours of the limbs of a segmented figure that stand in the trunk and stay with it
_SHADE = 0.55  # colour of the skin under a hem, over the garment's
BEND = 1.5  # radii of a limb over which a joint bends it on each side: that far no fold on the inside to 135 degrees
CLOSE = 0.25  # how much closer contours are at the ends of a limb than evenly spaced
_STAND = 0.045  # metres of a person over which the trunk of a figure in segments comes to stand on its pelvis
_COLLAR = 0.05  # metres of a person between a neck of segments and the contours of the trunk
_TUBE = 1.6  # times as wide as a neck: a wider loop is a collar
_CUFF = 0.012  # metres of a person between the end of a limb and the clothes below it
_WHOLE = 0.75  # a limb that its joint moves by this much where it begins takes all of the joint's rotation there


@dataclass(frozen=True, eq=False)
class ContourBody:
    """A humanoid whose limbs, torso and neck are contour surfaces; `error` (mean, largest) m between its surface and
    that of the original, without what stands in the trunk; `scale`: the figure's size over that of a person in metres."""

    humanoid: Humanoid
    error: tuple[float, float]
    scale: float = 1.0


def contours(humanoid: Humanoid, **options: Any) -> Humanoid:
    """The contour form of a humanoid; options as for `contoured`."""
    return contoured(humanoid, **options).humanoid


def contoured(
    humanoid: Humanoid,
    *,
    density: float = 1.0,
    mitre: float = 0.25,
    diversion: float = 0.0,
    recentre: bool = False,
    ramp: str = "linear",
    tilt: float | Mapping[str, float] | None = None,
) -> ContourBody:
    """A humanoid with hips, knees, ankles, shoulders, elbows and wrists as a contour body.

    `density` scales the number of contours and of points in each. `mitre` and `diversion`, 0..1, `recentre` and `ramp`
    ("linear", "smoothstep"), for all limbs: see `ContourSurface`. `tilt`, 0..1, of all limbs or by the names of surfaces:
    how far contours fan at rest about the axis of knee or elbow, see `modeling.fans`; None: as in the contour surfaces
    that the humanoid has, else not.
    Raises VitruvianError naming the joints that are missing, and for a surface that the slices do not meet.
    """
    if next(pieces(humanoid), None) is not None:  # a skin that was cut into Segments is one again
        humanoid = weld(humanoid)
    body = pack(humanoid)
    cuts = Cuts(body)
    if cuts.segmented:
        cuts = united(cuts)
    neck = throat(cuts) if cuts.segmented else None
    if neck is not None:
        top, down = cuts.planes["top"]
        cuts.planes["top"] = (np.array([top[0], min(top[1], neck.base[1] - _COLLAR * cuts.scale), top[2]]), down)
    made = _limbs(cuts, density, tilts(humanoid, tilt, list(TILTED)))
    for m in made:
        for field, value in (("diversion", diversion), ("mitre", mitre), ("recentre", recentre), ("ramp", ramp)):
            assign(m.surface, field, value)
    for part in (_torso, partial(_neck, throat=neck)):
        try:
            made += part(cuts, density)
        except VitruvianError as missing:
            _passed(cuts, missing)
    require(bool(made), "contours", "a segment with a surface round its bone", "none")
    for m in made:
        _cornered(cuts, m)
    for above, below in zip(made, made[1:], strict=False):
        _alike(cuts, above.surface, below.surface)
    error = shape_error(cuts.body, [m.surface for m in made])
    return ContourBody(_assembled(humanoid, made, _pieces(cuts, made), cuts), error, cuts.scale)


@dataclass(frozen=True)
class Limb:
    """A limb between two joints, by names without side: how it is sliced at density 1. `code`: its left region;
    `above`: the limb that it shares its first contour with; `shod`: it ends above shoes and cuffs."""

    name: str
    near: str
    far: str
    code: int
    points: int
    contours: int
    above: str = ""
    shod: bool = False


LIMBS = (
    Limb("upperarm", "shoulder", "elbow", 2, 20, 16),
    Limb("forearm", "elbow", "radiocarpal", 2, 20, 16, "upperarm"),
    Limb("thigh", "hip", "knee", 6, 26, 20),
    Limb("calf", "knee", "talocrural", 6, 26, 18, "thigh", True),
)


TILTED = tuple(f"{side}_{spec.name}_def" for side in "lr" for spec in LIMBS)


@dataclass(frozen=True, eq=False)
class Made:
    """A surface, the joint it hangs on, and where it was sliced: `rings`, planes and directions.

    `ends`: whether its first and last contour are sewn; `regions`: to what in a figure of segments, see `Cuts`; `bored`:
    whether a hole is bored into that. `bands`:
    where it shows several parts of the skin, the contour from which on and the number of each. `columns`: which points of
    the loops are the surface's, None: all."""

    joint: int
    surface: ContourSurface
    rings: Rings
    centers: Floats
    axis: Floats
    angles: Floats
    ends: tuple[bool, bool] = (False, False)
    regions: tuple[int, int] = (0, 0)
    bands: tuple[tuple[int, int], ...] = ()
    bored: tuple[bool, bool] = (False, False)
    columns: NDArray | None = None


def _limbs(cuts: Cuts, density: float, tilt: Mapping[str, float]) -> list[Made]:
    out: list[Made] = []
    for number, side in enumerate("lr"):
        for spec in LIMBS:
            try:
                made = _limb(cuts, side, number, spec, density, tilt[f"{side}_{spec.name}_def"])
            except VitruvianError as error:
                _passed(cuts, error)
                continue
            if spec.near in ("elbow", "knee") and out and out[-1].surface.name == f"{side}_{spec.above}_def":
                # a seam is one loop, of both surfaces
                above = out[-1].surface
                made.surface.points[0] = above.points[-1]
                made.rings.face[0] = out[-1].rings.face[-1]
                for own, other in ((made.surface.colors, above.colors), (made.surface.uv, above.uv)):
                    if own is not None and other is not None:
                        own[0] = other[-1]
            out.append(made)
    return out


def _limb(cuts: Cuts, side: str, number: int, spec: Limb, density: float, tilt: float) -> Made:
    near, far = f"{side}_{spec.near}", f"{side}_{spec.far}"
    top = spec.near in ("shoulder", "hip")
    fixed = FIXED if top and cuts.segmented and near not in cuts.seams else 0
    each, count = max(6, round(spec.points * density)), max(8, round(spec.contours * density))
    (start, first), (end, last) = cuts.planes[near], cuts.planes[far]
    u = np.arange(-fixed, count - fixed) / (count - 1 - fixed)
    s = np.where((u > 0) & (u < 1), u - CLOSE / (2 * np.pi) * np.sin(2 * np.pi * u), u * (1 - CLOSE * (u < 0)))
    angles = np.arange(each) * 2 * np.pi / each

    def planes(s: Floats) -> tuple[Floats, Floats]:
        t = np.clip(s, 0, 1)[:, None]
        normal = (1 - t) ** 2 * first + 2 * t * (1 - t) * axis + t**2 * last
        normal = fanned.turned(normal, np.clip(s, 0, 1)) if fanned else normal
        return start + s[:, None] * length * axis, normal / np.linalg.norm(normal, axis=1, keepdims=True)

    def sliced(s: Floats) -> Rings:
        return rings(
            cuts.skin.rest, cuts.skin.triangles, cuts.triangles(spec.code + number), *planes(s), forward=FRONT,
            angles=angles, name=f"{side}_{spec.name}", loose=cuts.segmented,
        )  # fmt: skip

    fanned: Fan | None = None
    axis, length = unit(end - start), float(np.linalg.norm(end - start))
    share = clear(sliced, cuts.part, _CUFF * cuts.scale / length) if spec.shod and not cuts.segmented else 1.0
    if share < 1:
        end, last, length = start + share * (end - start), axis, share * length
        cuts.planes[far] = (end, last)
    found = Hemmed(s, sliced(s))
    if fixed:
        warn(f"contours {side}_{spec.name}: its segment and the trunk do not meet in one seam; it stands in the trunk")
    if tilt:
        fanned = fan(
            spec.near, spec.far, axis, FRONT, reach=BEND * found.rings.radius / length, tilt=tilt, places=s[fixed:]
        )
        found = Hemmed(s, sliced(s))
    if not cuts.segmented:
        found = hemmed(sliced, s, found.rings, cuts.skin.rest, cuts.skin.triangles, cuts.part, length, cuts.scale)
    s, made, bands, count = found.s, found.rings, found.bands, len(found.s)
    centers, normal = planes(s)
    inward = 0.08 * np.arange(fixed, 0, -1)[:, None, None]  # what stands in the trunk stays below its surface
    made.points[:fixed] += inward * (made.points[:fixed].mean(axis=1, keepdims=True) - made.points[:fixed])
    wide = BEND * made.radius / length  # the bend takes so much of the surface at each end
    most = (count - fixed) // 2 - 1
    upper = int(np.clip(np.searchsorted(s[fixed:], wide), 2, most))
    lower = int(np.clip(np.searchsorted(1 - s[::-1], wide), 2, most)) if share == 1 else 0
    whole = top and not fixed and _share(cuts, near, made) >= _WHOLE
    surface = ContourSurface(
        f"{side}_{spec.name}_def", made.points, fixed_upper=fixed, upper=0 if whole else upper + fixed, lower=lower,
        extra=count if whole else 0, spread=True, tilt=tilt, colors=cuts.colored(made), uv=cuts.mapped(made),
    )  # fmt: skip
    for under, edge in found.shaded:
        if surface.colors is not None:
            surface.colors[under] = _SHADE * surface.colors[edge]
    sewn, regions = (top, not top), (spec.code + number, spec.code + number + 2)
    return Made(
        cuts.index[near], surface, made, centers, normal, angles, sewn, regions, bands if len(bands) > 1 else ()
    )


def _passed(cuts: Cuts, error: VitruvianError) -> None:
    """Segments without a surface round their bone are said and left as they are; a skin has to have one."""
    if not cuts.segmented:
        raise error
    warn(f"{error}; its segment stays as it is")


def _share(cuts: Cuts, name: str, made: Rings) -> float:
    """How much of a joint's rotation the skin takes where its limb begins, by its weights."""
    face = made.face[0][made.face[0] >= 0]
    return float(cuts.share(name)[cuts.skin.triangles[face]].mean()) if len(face) else 1.0


def _torso(cuts: Cuts, density: float) -> list[Made]:
    """The torso's front and back."""
    points, count = max(6, round(27 * density)), max(8, round(20 * density))
    (top, down), (low, _) = cuts.planes["top"], cuts.planes["vl5"]
    centers = top + np.linspace(0, 1, count)[:, None] * (low - top)
    centers[:, 2] = [cuts.depth(y) for y in centers[:, 1]]
    axis = np.tile(down, (count, 1))
    around = np.arange(2 * (points - 1)) * np.pi / (points - 1) - np.pi / 2
    loops = rings(
        cuts.skin.rest, cuts.skin.triangles, cuts.triangles(0), centers, axis, forward=FRONT, angles=around,
        name="torso", loose=cuts.segmented,
    )  # fmt: skip
    colors, uv = cuts.colored(loops), cuts.mapped(loops)
    joint = cuts.spine[0] if cuts.spine else max(int(cuts.body.skeleton.parents[cuts.index["l_shoulder"]]), 0)
    out = []
    stand = int(np.ceil(_STAND * cuts.scale * (count - 1) / float(top[1] - low[1]))) if cuts.segmented else 0
    front, back = np.arange(points), np.append(np.arange(points - 1, 2 * points - 2), 0)
    for name, which in (("front", front), ("back", back)):
        part = lambda a, which=which: None if a is None else a[:, which]  # noqa: E731
        surface = ContourSurface(
            f"l5_{name}_def", loops.points[:, which], closed=False, lower=stand,
            colors=part(colors), uv=part(uv),
        )  # fmt: skip
        ends = (name == "front", name == "front" and (not cuts.segmented or bool(cuts.spine)))
        pelvis = 10 if len(cuts.triangles(10)) else 0
        out.append(Made(joint, surface, loops, centers, axis, around, ends, (0, pelvis), columns=which))
    return out


def _neck(cuts: Cuts, density: float, throat: Throat | None) -> list[Made]:
    """From the skull's plane to the base of the neck; of a figure in segments what shows of the neck."""
    if "skullbase" not in cuts.planes:
        return []
    points, count = max(6, round(24 * density)), max(6, round(9 * density))
    around = np.arange(points) * 2 * np.pi / points
    if cuts.segmented and throat is None and not cuts.neck:
        return []
    if throat is not None:
        found = _necked(cuts, *throat.sliced(cuts, np.linspace(0, 1, count), around), around)
        return [replace(found, ends=(True, True), bored=(True, throat.apart))]
    (skull, high), (base, low) = cuts.planes["skullbase"], cuts.planes["neck"]

    def planes(s: Floats) -> tuple[Floats, Floats]:
        axis = (1 - s[:, None]) * high + s[:, None] * low
        return (1 - s[:, None]) * skull + s[:, None] * base, axis / np.linalg.norm(axis, axis=1, keepdims=True)

    def sliced(s: Floats) -> Rings:
        return rings(
            cuts.skin.rest, cuts.skin.triangles, cuts.triangles(0, HEAD, NECK), *planes(s), forward=FRONT, angles=around,
            name="neck", loose=cuts.segmented,
        )  # fmt: skip

    if not cuts.segmented:  # a collar is left to the trunk
        share = clear(sliced, cuts.part, _CUFF * cuts.scale / float(np.linalg.norm(base - skull)), 0.4)
        base, low = (p[0] for p in planes(np.array([share])))
        cuts.planes["neck"] = (base, low)
    s = np.linspace(0, 1, count)
    return [_necked(cuts, sliced(s), *planes(s), around)]


def _necked(cuts: Cuts, made: Rings, centers: Floats, axis: Floats, around: Floats) -> Made:
    joint = cuts.neck[0] if cuts.neck else cuts.index["skullbase"]
    name = tables.canonical(cuts.body.skeleton.names[joint]) or "c7"
    segment = tables.joints()[name].segment if name in tables.joints() else "c7"
    surface = ContourSurface(f"{segment}_def", made.points, colors=cuts.colored(made), uv=cuts.mapped(made))
    return Made(joint, surface, made, centers, axis, around, (not cuts.segmented,) * 2, (HEAD, 0))


def _cornered(cuts: Cuts, made: Made) -> None:
    """Texture coordinates of the corners of a surface's faces, where borders of the map run between its points."""
    s = made.surface
    if s.uv is None or cuts.charts is None:
        return
    face = made.rings.face if made.columns is None else made.rings.face[:, made.columns]
    at = lambda a: corners(a, s.closed).reshape(-1, 4, *a.shape[2:])  # noqa: E731
    uv = at(s.uv)
    shown = made.bands or ((0, _most(cuts, made)),)
    starts = np.array([k for k, _ in shown])
    part = np.array([n for _, n in shown])[np.searchsorted(starts, np.arange(len(s.points) - 1), "right") - 1]
    group = cuts.charts.of_parts[part]
    each = len(uv) // len(group)
    found = cuts.charts.mapped(at(s.points), at(face), uv, np.repeat(group, each))
    if (found != uv).any():
        s.uv_corners = found.reshape(len(group), each, 4, 2)


def _alike(cuts: Cuts, above: ContourSurface, below: ContourSurface) -> None:
    """Where a border of the map runs along the seam of two surfaces, the faces below it show what those above do there."""
    a, b = above.points, below.points
    if above.uv is None or below.uv is None or cuts.charts is None or a.shape[1] != b.shape[1] or (a[-1] != b[0]).any():
        return
    of = lambda s: corners(s.uv, s.closed) if s.uv_corners is None else s.uv_corners  # noqa: E731
    upper, lower = of(above)[-1][:, [3, 2]], of(below).copy()
    for n in np.flatnonzero((upper != lower[0, :, :2]).any(axis=(1, 2))).tolist():
        lower[0, n] = cuts.charts.continued(corners(b, below.closed)[0, n], upper[n])
        below.uv_corners = lower


def _most(cuts: Cuts, made: Made) -> int:
    """The part of the skin that most points of a surface lie on, -1: none."""
    face = made.rings.face[made.rings.face >= 0]
    return int(np.bincount(cuts.part[face]).argmax()) if len(face) else -1


def _pieces(cuts: Cuts, made: list[Made]) -> Skin:
    """Head, hands, feet, shoulders and hips: the skin without what is in contours, sewn to them."""
    skeleton, weights = cuts.body.skeleton, cuts.skin.weights
    surfaces = [m.surface for m in made]
    numbers = [np.arange(s.points.size // 3, dtype=np.int32).reshape(s.points.shape[:2]) for s in surfaces]
    packed = organised([(m.joint, m.surface, n) for m, n in zip(made, numbers, strict=True)], skeleton)
    cloth = Cloth(cuts.skin, cuts.sliced, cuts.corners, cuts.charts)
    ends = [(m, p, end) for m, p in zip(made, packed, strict=True) for end in (0, -1) if m.ends[end]]
    loops = [_loop(cuts, *one) for one in ends]
    if cuts.segmented:
        met = [_met(cuts, loop, m, end) for loop, (m, _, end) in zip(loops, ends, strict=True)]
        loops = [loop for loop in met if loop is not None]
    for loop in loops:
        cloth.cut(loop)
    gone = _gone(cuts, cloth, made)
    cloth.without(gone | cloth.capped(loops) if cuts.segmented else gone)
    rings_ = [cloth.sew(n, loop) for n, loop in enumerate(loops)]
    table = np.zeros((len(weights), len(skeleton)))
    table[weights.vertex, weights.joint] = weights.weight
    table = cloth.carried(table)
    table = cloth.meet(table, rings_, loops)
    return cloth.finished(followed(cloth, cuts, table, np.concatenate([*rings_, np.zeros(0, np.int64)])))


def _loop(cuts: Cuts, made: Made, packed: Contours, end: int) -> Loop:
    """The contour at an end of a surface as something to sew to."""
    k = end % len(packed)
    ring = Rings(made.rings.points[k : k + 1], made.rings.face[k : k + 1], made.rings.barycentric[k : k + 1])
    joints, weights = equivalent(packed, max(int(cuts.body.skeleton.parents[packed.joints[0]]), 0))
    size, s = ring.radius, made.surface
    shown = None if s.uv_corners is None or not s.closed else s.uv_corners[end][:, [0, 1] if end == 0 else [3, 2]]
    name = f"{s.name} {'first' if end == 0 else 'last'}"
    return Loop(
        name, made.centers[k], made.axis[k], FRONT, made.angles, ring, -1 if end == 0 else 1,
        min(0.16 * size, 0.8 * CLEAR * cuts.scale), 0.8 * size, joints, weights[k], shown=shown,
    )  # fmt: skip


def _met(cuts: Cuts, loop: Loop, made: Made, end: int) -> Loop | None:
    """The loop at an end of a surface of a figure in segments, to be sewn to the segment beyond it, which is cut where it
    first goes all round, or into which a hole is bored; None where none does, which is said."""
    mine, code = np.zeros(len(cuts.skin.triangles), bool), made.regions[end]
    mine[chosen := cuts.triangles(code)] = True
    if made.bored[end]:
        return replace(loop, only=mine, bored=True)
    for gap in loop.gap * np.array([0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0]):
        found = replace(loop, gap=float(gap), only=mine)
        cut = section(cuts.skin.rest, cuts.skin.triangles[chosen], found.beyond, loop.axis, FRONT)
        if not len(cut.round):
            continue
        if code == 0 and made.regions[0] == HEAD:  # the trunk's own neck, and no hood round it
            inner = cut.round[np.argmin(cut.size[cut.round])]
            if cut.size[inner] > _TUBE * loop.ring.radius:
                continue
            mine[:] = False
            mine[chosen[cut.face[cut.loop == inner]]] = True
        return found
    if code in (*OUTER, HEAD) or made.regions[0] == HEAD:
        warn(f"contours {loop.name}: no segment beyond it to sew it to")
    return None


def _gone(cuts: Cuts, cloth: Cloth, made: list[Made]) -> NDArray[np.bool_]:
    """(T,) the triangles that contours stand for: connected pieces most of which lie in a zone of contours."""
    piece = cloth.pieces()
    corners = cloth.rest[cloth.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) + 1e-15
    region = np.median(cuts.region[cuts.skin.triangles[cloth.origin]], axis=1)
    inside = _inside(cuts, made, corners.mean(axis=1), region)
    share = np.bincount(piece, area * inside) / np.bincount(piece, area)
    return (share[piece] > 0.6) & cloth.free


def _inside(cuts: Cuts, made: list[Made], places: Floats, region: NDArray) -> NDArray[np.bool_]:
    """(n,) which places (n,3) of these regions (n,) lie between the planes of a surface in contours."""
    slack = 0.0 if cuts.segmented else 0.01 * cuts.scale
    beyond = lambda name: (places - cuts.planes[name][0]) @ cuts.planes[name][1]  # noqa: E731
    names = {m.surface.name for m in made}
    inside = np.zeros(len(places), bool)
    zones: list[tuple[tuple[int, ...], str, str]] = [((0,), "top", "vl5")] if "l5_front_def" in names else []
    if sum(not name.startswith(("l_", "r_", "l5_")) for name in names):
        if any(m.bored[0] for m in made):
            inside |= region == NECK  # all of it, what stands in the head and in the trunk too
        else:
            zones.append(((0, HEAD, NECK), "skullbase", "neck"))
    for n, side in enumerate("lr"):
        for spec in LIMBS:
            if f"{side}_{spec.name}_def" in names:
                zones.append(((spec.code + n, spec.code + n + 2), f"{side}_{spec.near}", f"{side}_{spec.far}"))
    for codes, high, low in zones:
        inside |= np.isin(region, codes) & (beyond(high) > -slack) & (beyond(low) < slack)
    return inside


def _assembled(humanoid: Humanoid, made: list[Made], pieces: Skin, cuts: Cuts) -> Humanoid:
    """The humanoid with contour surfaces in its Segments, and the pieces as its skin."""
    copies = {id(j): replace(j, joints=[], segments=[replace(s, shapes=[], displacers=[], contours=[]) for s in j.segments],
                             displacers=[], skin_coord_index=np.zeros(0, np.int32), skin_coord_weight=np.zeros(0))
              for j in humanoid.joints()}  # fmt: skip
    order = list({id(j): j for j in humanoid.joints()}.values())
    for joint in order:
        copies[id(joint)].joints = [copies[id(j)] for j in joint.joints]
    joints = [copies[id(j)] for j in order]
    for m in made:
        _segment(joints[m.joint]).contours.append(m.surface)
    looks = {s.name or s.material.name: s.material for s in humanoid.skin}
    looks |= {s.name or s.material.name or g.name: s.material for g in humanoid.segments() for s in g.shapes}
    for m in made:
        m.surface.material = _look(cuts.skin, _most(cuts, m), looks)
        m.surface.bands = tuple((k, _look(cuts.skin, number, looks)) for k, number in m.bands)
    skeleton = [copies[id(j)] for j in humanoid.skeleton]
    weights = pieces.weights
    for number, joint in enumerate(joints):
        mine = weights.joint == number
        joint.skin_coord_index = weights.vertex[mine]
        joint.skin_coord_weight = weights.weight[mine]
    for morph in pieces.morphs:
        joints[morph.joint].displacers.append(Displacer(morph.name, morph.index, morph.offset, morph.weight))
    shapes = []
    for part in pieces.parts:
        look = looks.get(part.name) or Material(part.name, part.color, part.roughness, part.metallic, part.opacity,
                                                double_sided=part.double_sided)  # fmt: skip
        rows = slice(part.start, part.stop)
        uv = None if pieces.uv_triangles is None else pieces.uv_triangles[rows]
        shapes.append(Shape(part.name, pieces.triangles[rows], uv=pieces.uv, uv_triangles=uv, colors=pieces.colors,
                            material=look, crease_angle=part.crease))  # fmt: skip
    return replace(
        humanoid, skeleton=skeleton, skin=shapes, skin_coord=pieces.rest, skin_normal=None, node=None, scene=None,
    )  # fmt: skip


def _segment(joint: Joint) -> Segment:
    if not joint.segments:
        known = tables.canonical(joint.name)
        joint.segments.append(Segment(tables.joints()[known].segment if known else f"{joint.name}_segment"))
    return joint.segments[0]


def _look(skin: Skin, number: int, looks: dict[str, Material]) -> Material:
    """What contours on a part of the skin look like, seen from both sides; -1: on none."""
    part = skin.parts[number] if number >= 0 else Part("contours", 0, 0)
    found = looks.get(part.name) or Material(part.name, part.color, part.roughness, part.metallic, part.opacity)
    return replace(found, name=part.name, double_sided=True, node=None)
