"""The built-in person: an animatable H-Anim figure of any age, sex, size and build, dressed and with a face.

Sources: the shape data is the CC0 pack described in NOTICE; names, hierarchy and rest pose follow ISO/IEC 19774.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, eye, vstack

from vitruvian.body.types import Floats, Ints, Weights
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import Displacer, Humanoid, Material, Shape
from vitruvian.modeling import anatomy, source
from vitruvian.modeling.look import STYLES, Color, hair_color_at, look_parts, skin_colors
from vitruvian.modeling.mass import Wedges, wedges
from vitruvian.modeling.outfit import SUIT, hidden_faces, outfit_colors
from vitruvian.modeling.rest import at_rest, hip_reach, rest_matrices, rest_turns
from vitruvian.modeling.shape import Shape as Sliders
from vitruvian.modeling.shape import shaped

HAND = 0.024  # metres from the thigh to the middle of a hand that hangs beside it
RAISED = (0.18, 0.06)  # radians by which the source's A pose lifts the collar bones and the shoulder blades
LEAST_MOVE = 5e-5  # metres: displacers leave out what moves less


@dataclass(frozen=True, eq=False)
class Assembly:
    """All points of a dressed person in the A pose: the body's first, then those of every part.

    `parents` (points, 19158): the source points each takes weights and face movements from; rows sum to 1.
    """

    points: Floats
    parents: csr_matrix
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
    Asian and European forms; details slider name -> -1..1; measures name -> metres, see `vitruvian.modeling.measure`;
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
        from vitruvian.modeling.measure import solved

        sliders = solved(sliders, wishes, kilograms)
    return humanoid_of(sliders, loa=loa, name=name, seed=seed, stature=height, **look)


def humanoid_of(
    sliders: Sliders, *, loa: int = 4, name: str = "person", seed: int = 0, stature: float | None = None, **look: Any
) -> Humanoid:
    """The person of these sliders, without solving for measures.

    `stature` (m) takes off the few millimetres by which straightening the legs changes the height.
    """
    points = shaped(sliders)
    assembly = assemble(points, sliders, seed=seed, **look)
    where, centers, ends = rested(points, assembly)
    tall = float(np.ptp(where[: source.BODY, 1]))
    if stature is not None and abs(stature / tall - 1) < 0.02:
        scale = stature / tall
        where, centers, ends = where * scale, centers * scale, {n: p * scale for n, p in ends.items()}
    weights = _weights(assembly.parents, loa)
    joints = anatomy.skeleton(loa, centers)
    body = slice(0, source.BODY)
    mass = anatomy.add_masses(joints, where[body], _body_pieces(loa))
    anatomy.add_sites(joints, loa, feature_places(where), ends)
    by_joint = np.argsort(weights.joint, kind="stable")
    bounds = np.searchsorted(weights.joint[by_joint], np.arange(len(joints) + 1))
    for joint, a, b in zip(joints.values(), bounds, bounds[1:], strict=False):
        joint.skin_coord_index = weights.vertex[by_joint[a:b]]
        joint.skin_coord_weight = weights.weight[by_joint[a:b]]
    top = joints["skullbase"] if "skullbase" in joints else joints["humanoid_root"]
    top.displacers = face_displacers(assembly.parents)
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
        skin=assembly.shapes,
        skin_coord=where,
        made_from=sliders,
    )


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
    skin = skin_colors(flesh, hair=shade, suit=None if dressed else SUIT, **who)
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
    body = eye(source.BODY, source.POINTS, format="csr")
    return Assembly(all_points, vstack([body, *(p.parents for p in parts)]).tocsr(), shapes)


@cache
def _weight_matrix() -> csr_matrix:
    """(19158, 146) weights at LOA 4; teeth and eyes ride on their joint, points without weights on the skull."""
    w = source.weights()
    matrix = csr_matrix((w.weight, w.joint, w.row), (source.POINTS, len(anatomy.names()))).tolil()
    skull = anatomy.names().index("skullbase")
    empty = np.flatnonzero(w.counts == 0)
    matrix[empty, skull] = 1.0
    for side, rows in (("l_", range(14598, 14670)), ("r_", range(14670, 14742))):  # eyeballs are rigid
        matrix[rows.start : rows.stop] = 0
        matrix[rows.start : rows.stop, anatomy.names().index(side + "eyeball_joint")] = 1.0
    return matrix.tocsr()


@cache
def _folding(loa: int) -> csr_matrix:
    """(146, kept joints) 0-1 matrix that carries weights to a lower level of articulation."""
    kept = [n for n in anatomy.names() if anatomy.folded(loa)[n] == n]
    columns = [kept.index(anatomy.folded(loa)[n]) for n in anatomy.names()]
    size = len(columns)
    return csr_matrix((np.ones(size), (np.arange(size), columns)), (size, len(kept)))


@cache
def _body_pieces(loa: int) -> Wedges:
    """How the bare body falls into one piece per joint: every triangle follows its joint of greatest weight."""
    triangles = source.array("triangles")
    weights = (_weight_matrix()[: source.BODY] @ _folding(loa)).tocsr()
    rows = sum(weights[triangles[:, k]] for k in range(3))
    owner = np.asarray(rows.argmax(axis=1)).reshape(-1)
    bone = np.asarray(weights.argmax(axis=1)).reshape(-1)
    return wedges(triangles, owner, bone, weights.shape[1])


def _weights(parents: csr_matrix, loa: int) -> Weights:
    product = (parents @ _weight_matrix() @ _folding(loa)).tocsr()
    product.sort_indices()
    sums = np.asarray(product.sum(axis=1)).ravel()
    values = product.data / np.repeat(sums, np.diff(product.indptr))
    return Weights(product.indptr, product.indices, values)


def rested(points: Floats, assembly: Assembly) -> tuple[Floats, Floats, dict[str, Floats]]:
    """Points (n,3), joint centres (146,3) and bone ends in the rest pose: soles at Y = 0, centroid on the Y axis."""
    centers = anatomy.centers(points)
    ends = anatomy.ends(points)
    names, parents = anatomy.names(), anatomy.parents()
    weights = _weights(assembly.parents, 4)
    # The arms need to know how wide the hips come out; the hips do not need the arms.
    matrices = rest_matrices(parents, centers, rest_turns(names, parents, centers, ends, 0.0, raised=RAISED))
    width = hip_reach(assembly.points, weights, {n: i for i, n in enumerate(names)}, centers, matrices)
    matrices = rest_matrices(parents, centers, rest_turns(names, parents, centers, ends, width + HAND, raised=RAISED))
    where, middle = at_rest(centers, assembly.points, weights, matrices)
    place = {n: i for i, n in enumerate(names)}
    moved_ends = {n: matrices[place[n], :3, :3] @ p + matrices[place[n], :3, 3] for n, p in ends.items()}
    body = where[: source.BODY]
    shift = -np.array([0.0, where[:, 1].min(), _centroid(body, source.array("triangles"))[2]])
    return where + shift, middle + shift, {n: p + shift for n, p in moved_ends.items()}


def _centroid(points: Floats, triangles: Ints) -> Floats:
    """Centroid of the volume inside a closed surface."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    return ((a + b + c) * volume[:, None]).sum(axis=0) / (4 * volume.sum())


def face_displacers(parents: csr_matrix) -> list[Displacer]:
    """The 52 face units as Displacers of the skull; the names carry the standard's suffix `_action`."""
    units = {unit: source.target(unit, "faces") for unit in sorted(source.manifest()["faces"])}
    face = np.unique(np.concatenate([index for index, _ in units.values()]))
    near = parents[:, face]
    rows = np.flatnonzero(np.diff(near.indptr)).astype(np.int32)
    near = near[rows]
    out = []
    for unit, (index, offset) in units.items():
        field = np.zeros((len(face), 3))
        field[np.searchsorted(face, index)] = offset
        moved = near @ field
        chosen = np.flatnonzero((np.abs(moved) > LEAST_MOVE).any(axis=1))
        out.append(Displacer(action_name(unit), rows[chosen], moved[chosen]))
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
