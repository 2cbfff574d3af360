"""The built-in person: an animatable H-Anim figure of any age, sex, size and build, dressed and with a face.

Sources: the shape data is the CC0 pack described in NOTICE; names, hierarchy and rest pose follow ISO/IEC 19774.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, eye, vstack

from vitruvian.body.types import Floats, Ints, Weights
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import Displacer, Humanoid, Material, Shape, Site, Viewpoint
from vitruvian.modeling import anatomy, face, source
from vitruvian.modeling.look import STYLES, Color, hair_color_at, look_parts, parents_of, skin_colors
from vitruvian.modeling.mass import Wedges, part_of, wedges
from vitruvian.modeling.outfit import SUIT, hidden_faces, outfit_colors
from vitruvian.modeling.rest import at_rest, hip_reach, rest_matrices, rest_turns
from vitruvian.modeling.shape import Shape as Sliders
from vitruvian.modeling.shape import shaped

HAND = 0.024  # metres from the thigh to the middle of a hand that hangs beside it
RAISED = (0.18, 0.06)  # radians by which the source's A pose lifts the collar bones and the shoulder blades
# An arm's weights reach over the shoulder, a thigh's end below the hip; anatomists cut arms off at the armpit and thighs
# along the groin (de Leva 1996). Factors on the weights by which joints claim triangles for their masses.
CLAIMS = {"shoulder": 0.4, "hip": 1.5}
VIEW, FACE = 1.45, 0.30  # statures from which a camera sees all of a person, and the face
LEAST_MOVE = 5e-5  # metres: displacers leave out what moves less


@dataclass(frozen=True, eq=False)
class Assembly:
    """All points of a dressed person in the A pose: the body's first, then those of every part.

    `keys` are those parts, as `vitruvian.modeling.look.parents_of` knows them.
    """

    points: Floats
    keys: tuple[str, ...]
    shapes: list[Shape]


def person(
    *,
    gender: float = 0.5,
    age: float = 25.0,
    height: float | None = None,
    weight: float = 0.5,
    muscle: float = 0.5,
    proportions: float = 0.5,
    cup: float = 0.5,
    firmness: float = 0.5,
    origin: tuple[float, float, float] = (1 / 3, 1 / 3, 1 / 3),
    details: dict[str, float] | None = None,
    measures: dict[str, float] | None = None,
    loa: int = 4,
    name: str = "person",
    seed: int = 0,
    **look: Any,
) -> Humanoid:
    """A person in the standard's rest pose, seamless skin, H-Anim 2.0 names.

    gender 0 female to 1 male; age in years, 10 to 90; height in metres (None: what the other values give); weight from
    0 thin to 1 heavy, or kilograms when above 1; muscle, proportions, cup, firmness 0..1; origin weights of African,
    Asian and European forms; details slider name -> -1..1; measures name -> metres, see `vitruvian.modeling.measures`;
    loa 0..4. `look`: hair, hair_color, eye_color, skin_tone, outfit, top_color, bottom_color, shoe_color, see `assemble`.
    Raises VitruvianError for values outside their range; warns where wishes could not be met exactly.
    """
    if loa not in range(5):
        raise VitruvianError(f"loa: expected 0..4, found {loa}")
    kilograms = float(weight) if weight > 1 else None
    sliders = Sliders(
        gender=gender,
        age=age,
        muscle=muscle,
        weight=0.5 if kilograms else weight,
        proportions=proportions,
        cup=cup,
        firmness=firmness,
        origin=origin,
        details=dict(details or {}),
    )
    wishes = dict(measures or {})
    if height is not None:
        wishes["height"] = float(height)
    if wishes or kilograms:
        from vitruvian.modeling.sizing import solved

        points = shaped(sliders)
        space = clearance(points, assemble(points, sliders, seed=seed, **look))
        sliders = solved(sliders, wishes, kilograms, clearance=space)
    return humanoid_of(sliders, loa=loa, name=name, seed=seed, stature=wishes.get("height"), **look)


def humanoid_of(
    sliders: Sliders, *, loa: int = 4, name: str = "person", seed: int = 0, stature: float | None = None, **look: Any
) -> Humanoid:
    """The person of these sliders, without solving for measures.

    `stature` (m) takes off the few millimetres by which straightening the legs changes the height.
    """
    points = shaped(sliders)
    assembly = assemble(points, sliders, seed=seed, **look)
    where, centers, ends = rested(points, assembly)
    scale = stature_scale(where, stature)
    where, centers, ends = where * scale, centers * scale, {n: p * scale for n, p in ends.items()}
    return figure(sliders, assembly, where, centers, ends, loa=loa, name=name)


def figure(
    sliders: Sliders,
    assembly: Assembly,
    where: Floats,
    centers: Floats,
    ends: dict[str, Floats],
    *,
    loa: int,
    name: str,
) -> Humanoid:
    """The humanoid of points (n,3), joint centres (146,3) and bone ends at rest."""
    joints = anatomy.skeleton(loa, centers)
    body = slice(0, source.BODY)
    mass = anatomy.add_masses(joints, where[body], body_pieces(loa))
    anatomy.add_sites(joints, loa, feature_places(where), ends)
    for joint, (index, weight) in zip(joints.values(), _held(assembly.keys, loa), strict=True):
        joint.skin_coord_index, joint.skin_coord_weight = index.copy(), weight.copy()
    top = joints["skullbase"] if "skullbase" in joints else joints["humanoid_root"]
    top.displacers = [Displacer(n, index.copy(), moves.copy()) for n, index, moves in _face_moves(assembly.keys)]
    for region, index in face.regions().items():
        top.displacers.append(Displacer(f"{region}_feature", index.copy(), np.zeros((len(index), 3))))
    stature = float(where[body, 1].max() - where[body, 1].min())
    info = {
        "age": f"{sliders.age:g}",
        "gender": "female" if sliders.gender < 0.35 else "male" if sliders.gender > 0.65 else "neutral",
        "height": f"{stature:.3f}",
        "weight": f"{mass:.1f}",
        "humanoidVersion": "2.0",
    }
    return Humanoid(
        name=name,
        version="2.0",
        loa=loa,
        info=info,
        skeleton=[joints["humanoid_root"]],
        viewpoints=_views(where),
        skin=assembly.shapes,
        skin_coord=where,
        made_from=sliders,
    )


def _views(where: Floats) -> list[Site]:
    """Cameras that go where the person goes: the whole of it from the front and from its left side, and the face."""
    body = where[: source.BODY]
    low, high = body.min(axis=0), body.max(axis=0)
    middle, brow = (low + high) / 2, feature_places(where)["sellion"]
    back, near = VIEW * (high[1] - low[1]), FACE * (high[1] - low[1])
    out = []
    for name, place, turn in (
        ("front", [0.0, middle[1], high[2] + back], 0.0),
        ("side", [high[0] + back, middle[1], middle[2]], np.pi / 2),
        ("face", [brow[0], brow[1] - 0.1 * near, brow[2] + near], 0.0),
    ):
        seen = Viewpoint(f"{name} of the person", position=np.zeros(3))
        rotation = np.array([0.0, 1.0, 0.0, turn])
        out.append(Site(f"{name}_view", translation=np.array(place), rotation=rotation, viewpoints=[seen]))
    return out


def stature_scale(where: Floats, stature: float | None) -> float:
    """What brings a person at rest (points, the body's first) to a stature that it nearly has, by at most 2 %."""
    if stature is None:
        return 1.0
    return float(np.clip(stature / np.ptp(where[: source.BODY, 1]), 0.98, 1.02))


def bare(points: Floats, clearance: float = 0.0) -> Floats:
    """(13380,3) the body alone of a shape, at rest; `clearance` (m): what clothes at the hips keep the arms away."""
    return rested(points, Assembly(points[: source.BODY], (), []), clearance)[0]


def clearance(points: Floats, assembly: Assembly) -> float:
    """By how much (m) a dressed person's hips are wider, to its hanging arms, than the body alone."""
    centers, ends = anatomy.centers(points), anatomy.ends(points)
    dressed, alone = (_hips(a, centers, ends) for a in (assembly, Assembly(points[: source.BODY], (), [])))
    return dressed - alone


def assemble(
    points: Floats,
    sliders: Sliders,
    *,
    seed: int = 0,
    hair: str | None = None,
    hair_color: str | Color | None = None,
    eye_color: str | Color = "brown",
    skin_tone: float | str | None = None,
    outfit: str | None = "t-shirt and shorts",
    top_color: str | Color | None = None,
    bottom_color: str | Color | None = None,
    shoe_color: str | Color | None = None,
) -> Assembly:
    """Body, eyes, hair and clothes of a shape, in the A pose.

    hair "short", "bob", "bun", "none" or None: by sex and age; skin_tone 0 light to 1 dark or a name, None: by origin;
    outfit a name in `vitruvian.modeling.outfit.OUTFITS` or None; colours by name or as three numbers.
    """
    if hair is not None and hair not in STYLES:
        raise VitruvianError(f"hair: expected one of {', '.join(STYLES)}, found {hair!r}")
    tone = float(np.dot(sliders.origin, (0.78, 0.30, 0.20))) - 0.08 if skin_tone is None else skin_tone
    dressed = outfit_colors(outfit, top_color, bottom_color, shoe_color, sliders.gender)
    flesh = points[: source.POINTS]
    who: dict[str, Any] = {"gender": sliders.gender, "age": sliders.age, "tone": tone, "seed": seed}
    parts = look_parts(flesh, hair=hair, hair_color=hair_color, eye_color=eye_color, outfit=dressed, **who)
    shade = None if hair == "none" else hair_color_at(sliders.age, hair_color, tone)
    skin = skin_colors(hair=shade, suit=None if dressed else SUIT, **who)
    all_points = np.concatenate([points[: source.BODY], *(p.vertices for p in parts)])
    colors = np.concatenate([skin, *(p.colors for p in parts)])
    visible = ~hidden_faces(dressed)
    shapes = [
        Shape(
            "skin",
            source.array("triangles")[visible],
            uv=source.array("uv").astype(np.float64),
            uv_triangles=source.array("uv_triangles")[visible],
            colors=colors,
            material=Material("skin", color=tuple(skin.mean(axis=0)), roughness=0.52),
        )
    ]
    start = source.BODY
    for part in parts:
        material = Material(part.name, tuple(part.colors.mean(axis=0)), part.roughness, double_sided=part.double_sided)
        shapes.append(Shape(part.name, (part.triangles + start).astype(np.int32), colors=colors, material=material))
        start += len(part.vertices)
    return Assembly(all_points, tuple(p.key for p in parts), shapes)


@lru_cache(maxsize=16)
def parents_matrix(keys: tuple[str, ...]) -> csr_matrix:
    """(points, 19158): the source points each point of body and parts takes weights and face movements from."""
    return vstack([eye(source.BODY, source.POINTS, format="csr"), *(parents_of(k) for k in keys)]).tocsr()


@cache
def weight_matrix() -> csr_matrix:
    """(19158, 146) weights at LOA 4; teeth and eyes ride on their joint, points without weights on the skull."""
    w, names = source.weights(), anatomy.names()
    joint, weight, point = w.joint, w.weight, w.vertex
    alone = np.full(source.POINTS, -1)
    alone[w.counts == 0] = names.index("skullbase")
    for side, ball in (("l_", slice(14598, 14670)), ("r_", slice(14670, 14742))):  # eyeballs are rigid
        alone[ball] = names.index(side + "eyeball_joint")
    kept, rigid = alone[point] < 0, np.flatnonzero(alone >= 0)
    values = np.concatenate([weight[kept], np.ones(len(rigid))])
    rows = np.concatenate([point[kept], rigid])
    columns = np.concatenate([joint[kept], alone[rigid]])
    return csr_matrix((values, (rows, columns)), (source.POINTS, len(names)))


@cache
def _folding(loa: int) -> csr_matrix:
    """(146, kept joints) 0-1 matrix that carries weights to a lower level of articulation."""
    kept = [n for n in anatomy.names() if anatomy.folded(loa)[n] == n]
    columns = [kept.index(anatomy.folded(loa)[n]) for n in anatomy.names()]
    size = len(columns)
    return csr_matrix((np.ones(size), (np.arange(size), columns)), (size, len(kept)))


@cache
def body_pieces(loa: int) -> Wedges:
    """How the bare body falls into one piece per joint: every triangle follows its joint of greatest weight."""
    triangles = source.array("triangles")
    weights = (weight_matrix()[: source.BODY] @ _folding(loa)).tocsr()
    shares = weights.toarray()
    kept = [n for n in anatomy.names() if anatomy.folded(loa)[n] == n]
    shares *= [CLAIMS.get(n[2:], 1.0) for n in kept]
    owner = np.empty(len(triangles), np.int64)
    for some in np.array_split(np.arange(len(triangles)), 16):
        owner[some] = (shares[triangles[some, 0]] + shares[triangles[some, 1]] + shares[triangles[some, 2]]).argmax(1)
    bone = shares.argmax(axis=1)
    return wedges(triangles, owner, bone, weights.shape[1])


@lru_cache(maxsize=16)
def _weights(keys: tuple[str, ...], loa: int) -> Weights:
    """Weights of body and parts; rows sum to 1."""
    product = (parents_matrix(keys) @ weight_matrix() @ _folding(loa)).tocsr()
    product.sort_indices()
    sums = np.asarray(product.sum(axis=1)).ravel()
    values = product.data / np.repeat(sums, np.diff(product.indptr))
    return Weights(product.indptr, product.indices, values)


@lru_cache(maxsize=16)
def _held(keys: tuple[str, ...], loa: int) -> list[tuple[Ints, Floats]]:
    """Of every joint the points that it moves and their weights."""
    weights = _weights(keys, loa)
    by_joint = np.argsort(weights.joint, kind="stable")
    bounds = np.searchsorted(weights.joint[by_joint], np.arange(_folding(loa).shape[1] + 1))
    some = [by_joint[a:b] for a, b in zip(bounds, bounds[1:], strict=False)]
    return [(weights.vertex[s], weights.weight[s]) for s in some]


def _hips(assembly: Assembly, centers: Floats, ends: dict[str, Floats]) -> float:
    """How far the hips reach from the middle plane (m) before the arms are down."""
    names, parents = anatomy.names(), anatomy.parents()
    # The arms need to know how wide the hips come out; the hips do not need the arms.
    matrices = rest_matrices(parents, centers, rest_turns(names, parents, centers, ends, 0.0, raised=RAISED))
    return hip_reach(
        assembly.points, _weights(assembly.keys, 4), {n: i for i, n in enumerate(names)}, centers, matrices
    )


def rested(points: Floats, assembly: Assembly, clearance: float = 0.0) -> tuple[Floats, Floats, dict[str, Floats]]:
    """Points (n,3), joint centres (146,3) and bone ends in the rest pose: soles at Y = 0, centroid on the Y axis.

    The arms hang `clearance` (m) further out than the hips of the assembly ask for.
    """
    return resting(assembly, anatomy.centers(points), anatomy.ends(points), clearance)[:3]


def resting(
    assembly: Assembly, centers: Floats, ends: dict[str, Floats], clearance: float = 0.0
) -> tuple[Floats, Floats, dict[str, Floats], Floats]:
    """`rested` for centres and bone ends of one's own, and the rigid motions (146,4,4) from the A pose to rest."""
    names, parents = anatomy.names(), anatomy.parents()
    weights = _weights(assembly.keys, 4)
    width = _hips(assembly, centers, ends) + clearance
    matrices = rest_matrices(parents, centers, rest_turns(names, parents, centers, ends, width + HAND, raised=RAISED))
    where, middle = at_rest(centers, assembly.points, weights, matrices)
    place = {n: i for i, n in enumerate(names)}
    moved_ends = {n: matrices[place[n], :3, :3] @ p + matrices[place[n], :3, 3] for n, p in ends.items()}
    change, middle_z = _restored(where[: source.BODY], _faces(assembly.points)[2])
    where[: source.BODY] += change
    shift = -np.array([0.0, where[:, 1].min(), middle_z])
    matrices[:, :3, 3] += shift
    return where + shift, middle + shift, {n: p + shift for n, p in moved_ends.items()}, matrices


def _faces(points: Floats) -> tuple[list[Floats], Floats, float]:
    """Of a body whose points come first: the corners (3,27036) of its triangles, twice their areas as vectors
    (3,27036), and its volume."""
    rows = np.ascontiguousarray(points[: source.BODY].T)
    a, b, c = corners = [rows.take(source.array("triangles")[:, k], axis=1) for k in range(3)]
    u, v = b - a, c - a
    area = np.stack([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])
    return corners, area, float(np.einsum("kt,kt->", a, area)) / 6


@cache
def _fleshy() -> tuple[csr_matrix, Floats]:
    """(13380, 27036) 1 where a triangle meets a point, and (13380,) how much of a point is trunk, upper arm or thigh."""
    triangles = source.array("triangles")
    t = np.tile(np.arange(len(triangles)), 3)
    meets = csr_matrix((np.ones(len(t)), (triangles.T.ravel(), t)), (source.BODY, len(triangles)))
    part = part_of(list(anatomy.skeleton(4, np.zeros((len(anatomy.names()), 3))).values()))
    some = [part[n] in ("trunk", "upper arm", "thigh") for n in anatomy.names()]
    return meets, weight_matrix()[: source.BODY] @ np.array(some, np.float64)


def _restored(body: Floats, volume: float) -> tuple[Floats, float]:
    """(13380,3) what gives a re-posed body the volume (m3) that blending has taken where skin folds: a fraction of a
    millimetre along the normals of trunk, upper arms and thighs. Also where the middle of its volume is along Z."""
    meets, amount = _fleshy()
    corners, faces, now = _faces(body)
    parts = np.einsum("kt,kt->t", corners[0], faces)
    middle = float((parts * (corners[0][2] + corners[1][2] + corners[2][2])).sum()) / (24 * now)
    area = np.stack([meets @ row for row in faces], axis=1) / 6
    area += area[source.array("mirror")[: source.BODY]] * [-1, 1, 1]  # quads are split one way on both sides
    area /= 2
    size = np.sqrt(np.einsum("ij,ij->i", area, area))
    step = (volume - now) / float((size * amount).sum())
    return (step * amount / np.maximum(size, 1e-12))[:, None] * area, middle


@lru_cache(maxsize=16)
def _face_moves(keys: tuple[str, ...]) -> list[tuple[str, Ints, Floats]]:
    """The 52 face units as name, points and displacements, named with the standard's suffix `_action`; then the
    expressions made of them, `_config`."""
    units = {unit: source.target(unit, "faces") for unit in sorted(source.manifest()["faces"])}
    some = np.unique(np.concatenate([index for index, _ in units.values()]))
    near = parents_matrix(keys)[:, some]
    rows = np.flatnonzero(np.diff(near.indptr)).astype(np.int32)
    near = near[rows]
    fields: dict[str, Floats] = {}
    for unit, (index, offset) in units.items():
        fields[unit] = np.zeros((len(some), 3))
        fields[unit][np.searchsorted(some, index)] = offset
    named = {action_name(unit): field for unit, field in fields.items()}
    for name, shares in face.configurations().items():
        named[name] = sum((w * fields[unit] for unit, w in shares.items()), np.zeros((len(some), 3)))
    out = []
    for name, field in named.items():
        moved = near @ field
        x, y, z = (np.abs(moved) > (LEAST_MOVE if name.endswith("_action") else face.LEAST_MOVE)).T
        chosen = np.flatnonzero(x | y | z)
        out.append((name, rows[chosen], moved[chosen]))
    return out


def action_name(unit: str) -> str:
    """ARKit's name of a face unit as a Displacer name: `browDownLeft` -> `l_brow_down_action`."""
    side = "l_" if unit.endswith("Left") and unit != "mouthLeft" and unit != "jawLeft" else ""
    side = "r_" if unit.endswith("Right") and unit != "mouthRight" and unit != "jawRight" else side
    stem = unit.removesuffix("Left").removesuffix("Right") if side else unit
    return side + "".join("_" + c.lower() if c.isupper() else c for c in stem) + "_action"


def unit_name(action: str) -> str:
    """The inverse of `action_name`."""
    stem = action.removesuffix("_action")
    side = {"l_": "Left", "r_": "Right"}.get(stem[:2], "")
    first, *rest = (stem[2:] if side else stem).split("_")
    return first + "".join(w.capitalize() for w in rest) + side


def feature_places(where: Floats) -> dict[str, Floats]:
    """Feature point name -> position on this body: the vertices chosen in the pack."""
    return {name: where[vertex] for name, vertex in source.feature_vertices().items()}
