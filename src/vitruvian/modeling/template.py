"""What a fit needs of a body: its bare surface, joints, weights, and which joint parameters may change together.

The built-in person is taken as its data has it, in an A pose, before clothes and hair; any other skinned humanoid as its
file has it at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from vitruvian.body.types import Body, Floats, Ints
from vitruvian.errors import VitruvianError
from vitruvian.hanim import tables
from vitruvian.modeling.bones import EACH, Knobs, bone_axes

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from vitruvian.modeling.shape import Shape

FACE = ("eyelid_joint", "eyeball_joint", "eyebrow_joint", "temporomandibular")
FOOT = ("talocalcaneo", "cuneonavicular", "tarsometatarsal", "calcaneocuboid", "transversetarsal", "metatarsophal")
FOOT += ("tarsal_", "subtalar", "midtarsal", "metatarsal")
PALM = ("midcarpal", "carpometacarpal")
# How much joint parameters are held back, in units of the square of a landmark that is 1 cm off. Radians, logarithms.
TURN, SCALE, MIRROR, SHIFT = 1e-4, 1e-3, 1e-2, 1.0


@dataclass(frozen=True, eq=False)
class Template:
    """A body as arrays: `points` (V,3), `triangles` (T,3), `weights` (V,J) sparse, rows that sum to 1; joint `names`
    (2.0's where the standard knows them), `parents`, `centers` (J,3); `places`: feature point -> vertices (k,) and their
    shares (k,). `soft` (V,) 0..1: how far the surface may follow the scan by itself; `heard` (V,): it is skin that a
    scanner sees."""

    names: tuple[str, ...]
    parents: Ints
    centers: Floats
    points: Floats
    triangles: Ints
    weights: csr_array
    places: dict[str, tuple[Ints, Floats]]
    soft: Floats
    heard: Any

    @cached_property
    def axes(self) -> Floats:
        """(J,3) unit directions of the bones; parts that are scaled as one share theirs."""
        axes = bone_axes(self.parents, self.centers)
        index = {n: i for i, n in enumerate(self.names)}
        for i, name in enumerate(self.names):
            side = name[:2] if name[:2] in ("l_", "r_") else ""
            stem = name[len(side) :]
            if stem.startswith(FACE) and "skullbase" in index:
                axes[i] = axes[index["skullbase"]] = [0.0, 1.0, 0.0]
            elif (stem.startswith(FOOT) or stem == "talocrural") and side + "talocrural" in index:
                toe = next((index[side + t] for t in ("metatarsophalangeal_2",) if side + t in index), None)
                if toe is not None:
                    way = self.centers[toe] - self.centers[index[side + "talocrural"]]
                    axes[i] = way * [1, 0, 1] / max(float(np.linalg.norm(way * [1, 0, 1])), 1e-9)
            elif stem in ("sacroiliac", "humanoid_root"):
                axes[i] = [0.0, 1.0, 0.0]
        return axes

    @cached_property
    def knobs(self) -> Knobs:
        """All knobs of this body's joints."""
        return _knobs(self.names, self.parents)

    def chosen(self, vertices: Any) -> Any:
        """(n,V) sparse: the vertices of these numbers."""
        from scipy.sparse import csr_array

        count = len(vertices)
        return csr_array((np.ones(count), (np.arange(count), vertices)), shape=(count, len(self.points)))

    def landmarks(self, names: list[Any]) -> Any:
        """(n,V) sparse: means of vertices for names of feature points, or (face, barycentric) pairs.

        Raises VitruvianError for names that this template has no place for.
        """
        from scipy.sparse import csr_array

        row, column, share = [], [], []
        for k, name in enumerate(names):
            if isinstance(name, str):
                if name not in self.places:
                    known = ", ".join(list(self.places)[:5])
                    raise VitruvianError(f"landmark {name!r}: not a feature point of the template; it has {known} ...")
                index, part = self.places[name]
            else:
                face, part = name
                if not 0 <= int(face) < len(self.triangles):
                    most = len(self.triangles) - 1
                    raise VitruvianError(f"landmark {name!r}: expected a face in 0..{most} of the template")
                index, part = self.triangles[int(face)], np.asarray(part, np.float64)
            row += [k] * len(index)
            column += list(index)
            share += list(part)
        return csr_array((share, (row, column)), shape=(len(names), len(self.points)))


def person_template(shape: Shape) -> Template:
    """The built-in person of these sliders in its A pose: bare skin, LOA 4."""
    from vitruvian.modeling import anatomy, source
    from vitruvian.modeling.look import mask
    from vitruvian.modeling.person import weight_matrix
    from vitruvian.modeling.shape import shaped

    points = shaped(shape)
    places = {n: (np.array([v], np.int32), np.ones(1)) for n, v in source.feature_vertices().items()}
    hidden = np.maximum(mask("inside-mouth"), 0)
    names = anatomy.names()
    weights = normalised(weight_matrix()[: source.BODY])
    hands = _share(weights, names, ("radiocarpal", *PALM, "metacarpo", "carpal_"))
    toes = _share(weights, names, ("tarsal_", "metatarsophalangeal"))
    stiff = np.max([hands * 0.9, toes * 0.9, mask("ears"), mask("eyelids"), mask("lips") * 0.7, hidden], axis=0)
    return Template(
        names,
        anatomy.parents(),
        anatomy.centers(points),
        points[: source.BODY],
        source.array("triangles").astype(np.int32),
        weights,
        places,
        1 - np.clip(stiff, 0, 1),
        (hidden < 0.1) & (mask("eyelids") < 0.5),
    )


def body_template(body: Body) -> Template:
    """Any packed body at rest. Feature points are where its Sites are on the surface.

    Raises VitruvianError for a body without a skin that its joints move.
    """
    import igl

    from vitruvian.modeling.features import feature_name
    from vitruvian.modeling.slicing import barycentric

    skin, skeleton = body.skin, body.skeleton
    if not len(skin.triangles) or not (skin.weights.sums > 0).any():
        raise VitruvianError(f"template {body.name!r}: expected a skin that joints move, found none")
    from scipy.sparse import csr_array

    w = skin.weights
    shares = w.weight / np.maximum(w.sums, 1e-12)[w.vertex]
    weights = csr_array((shares, w.joint, w.row), shape=(len(skin.rest), len(skeleton)))
    loose = np.flatnonzero(w.sums <= 0)
    if len(loose):
        rigid = csr_array((np.ones(len(loose)), (loose, np.zeros(len(loose), int))), shape=weights.shape)
        weights = (weights + rigid).tocsr()
    names: list[str] = []
    for name in skeleton.names:
        known = tables.canonical(name)
        names.append(known if known and known not in names else f"({name})")
    places = {}
    if len(skeleton.site_names):
        t = skin.triangles.astype(np.int64)
        face, foot = igl.point_mesh_squared_distance(skeleton.site_points, skin.rest, t)[1:3]
        corners = skin.triangles[np.asarray(face).reshape(-1)]
        share = barycentric(skin.rest[corners], np.asarray(foot, np.float64))
        far = np.linalg.norm(np.asarray(foot) - skeleton.site_points, axis=1) > 0.03
        for k, site in enumerate(skeleton.site_names):
            name = feature_name(site)
            if name and not far[k] and (name not in places or not site.endswith("_tip")):
                places[name] = (corners[k], share[k])
    hands = _share(weights, tuple(names), ("radiocarpal", *PALM, "metacarpo", "carpal_"))
    return Template(
        tuple(names), skeleton.parents, skeleton.centers, skin.rest, skin.triangles, weights, places,
        1 - 0.9 * hands, np.ones(len(skin.rest), bool),
    )  # fmt: skip


def normalised(matrix: Any) -> csr_array:
    from scipy.sparse import csr_array

    out = csr_array(matrix)
    total = np.asarray(out.sum(axis=1)).ravel()
    out.data /= np.repeat(np.maximum(total, 1e-12), np.diff(out.indptr))
    return out


def _share(weights: Any, names: tuple[str, ...], stems: tuple[str, ...]) -> Floats:
    """(V,) how much of each vertex hangs on joints whose names, without their side, start like that."""
    chosen = np.array([n[2:].startswith(stems) and n[:2] in ("l_", "r_") for n in names], np.float64)
    return np.asarray(weights @ chosen)


def _knobs(names: tuple[str, ...], parents: Ints) -> Knobs:
    """The knobs of a skeleton: joints of the spine turn together by regions, hands and feet are scaled as one."""
    from scipy.sparse import csr_array

    index = {n: i for i, n in enumerate(names)}
    rows: list[tuple[str, list[int], int, float, float]] = []  # name, joints, parameter, amount, pull

    def turn(title: str, joints: list[str], pull: float = 1.0) -> None:
        some = [index[j] for j in joints if j in index]
        for k in range(3 if some else 0):
            # one knob is the sum of the turns
            rows.append((f"turn {title} {k}", some, k, 1 / len(some), TURN * pull * len(some) ** 2))

    def scale(title: str, joints: list[str], pull: float = 1.0) -> None:
        some = [index[j] for j in joints if j in index]
        for k in range(2 if some else 0):
            rows.append((f"scale {title} {k}", some, 6 + k, 1.0, SCALE * pull))

    def shift(title: str, joint: str, pull: float) -> None:
        for k in range(3 if joint in index else 0):
            rows.append((f"shift {title} {k}", [index[joint]], 3 + k, 1.0, pull))

    root = names[0]
    turn("root", [root], 1e-4)
    shift("root", root, 1e-8)
    scale("pelvis", [root, "sacroiliac"])
    turn("pelvis", ["sacroiliac"], 100.0)
    spine = {r: [n for n in names if n[:2] == r and n[2:].isdigit()] for r in ("vl", "vt", "vc")}
    for region, some in spine.items():
        turn(region, some, 3.0)
        scale(region, some)
    turn("skull", ["skullbase"], 2.0)
    scale("skull", ["skullbase", *(n for n in names if n.removeprefix("l_").removeprefix("r_").startswith(FACE))])
    for side in ("l_", "r_"):
        mine = [n for n in names if n.startswith(side)]
        stem = {n: n[2:] for n in mine}
        palm = [n for n in mine if stem[n].startswith(PALM)]
        fingers = [n for n in mine if stem[n].startswith(("metacarpophalangeal", "carpal_"))]
        feet = [n for n in mine if stem[n].startswith(FOOT)]
        turn(side + "clavicle", [side + "sternoclavicular"], 20.0)
        turn(side + "blade", [side + "acromioclavicular"], 60.0)
        scale(side + "clavicle", [side + "sternoclavicular", side + "acromioclavicular"])
        for joint, pull in (("shoulder", 1.0), ("elbow", 1.0), ("radiocarpal", 2.0)):
            turn(side + joint, [side + joint], pull)
        for joint, pull in (("hip", 1.0), ("knee", 1.0), ("talocrural", 2.0)):
            turn(side + joint, [side + joint], pull)
        for joint in ("shoulder", "elbow", "hip", "knee"):
            scale(side + joint, [side + joint])
            shift(side + joint, side + joint, SHIFT * (1 if joint in ("shoulder", "hip") else 10))
        scale(side + "hand", [side + "radiocarpal", *palm, *fingers], 2.0)
        scale(side + "foot", [side + "talocrural", *feet])
        for n in fingers:
            turn(n, [n], 30.0 if "interphalangeal" in n and not n.endswith("_1") else 15.0)
        turn(side + "toes", [n for n in feet if stem[n].startswith("metatarsophalangeal")], 60.0)
        if side + "metatarsophalangeal_2" not in index:
            turn(side + "toes", [n for n in feet if stem[n].startswith(("midtarsal", "metatarsal"))][:1], 60.0)
        for n in mine:
            if stem[n].startswith("carpometacarpal") and n.endswith(("_1",)):
                turn(n, [n], 20.0)
    for n in names:  # joints the standard does not know
        if n.startswith("(") and n != root:
            turn(n, [n], 5.0)
            scale(n, [n], 5.0)
    cells = [(EACH * j + k, c, amount) for c, (_, some, k, amount, _) in enumerate(rows) for j in some]
    r, c, v = (np.array(x) for x in zip(*cells, strict=True))
    links = csr_array((v.astype(np.float64), (r, c)), shape=(EACH * len(names), len(rows)))
    titles = tuple(row[0] for row in rows)
    place = {t: i for i, t in enumerate(titles)}
    pairs = [
        (i, place["scale r_" + t[8:]])
        for t, i in place.items()
        if t.startswith("scale l_") and "scale r_" + t[8:] in place
    ]
    return Knobs(
        links, np.array([row[4] for row in rows]), np.array(pairs, np.int32).reshape(-1, 2),
        np.full(len(pairs), MIRROR), titles,
    )  # fmt: skip
