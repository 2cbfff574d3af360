"""What a fit needs of a body: its bare surface, joints, weights, and which joint parameters may change together.

The built-in person is taken as its data has it, in an A pose, before clothes and hair; any other skinned humanoid as its
file has it at rest.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
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
FOOT: tuple[str, ...] = (
    "talocalcaneo",
    "cuneonavicular",
    "tarsometatarsal",
    "calcaneocuboid",
    "transversetarsal",
    "metatarsophal",
)
FOOT += ("tarsal_", "subtalar", "midtarsal", "metatarsal")
PALM = ("midcarpal", "carpometacarpal")
# How much joint parameters are held back, in units of the square of a landmark that is 1 cm off. Radians, logarithms.
TURN, SCALE, MIRROR, SHIFT = 1e-4, 1e-3, 1e-2, 1.0
FINGERS = 1e-3  # how much neighbouring fingers bend alike


@dataclass(frozen=True, eq=False)
class Template:
    """A body as arrays: `points` (V,3), `triangles` (T,3), `weights` (V,J) sparse, rows that sum to 1; joint `names`
    (2.0's where the standard knows them), `parents`, `centers` (J,3); `places`: feature point -> vertices (k,) and their
    shares (k,). `stiff` (V,) 0..1: how little the surface follows the scan by itself; `reach` (V,) 0..1: from how far
    away a part is drawn, against the trunk; `heard` (V,): it is skin that a scanner sees."""

    names: tuple[str, ...]
    parents: Ints
    centers: Floats
    points: Floats
    triangles: Ints
    weights: csr_array
    places: dict[str, tuple[Ints, Floats]]
    stiff: Floats
    reach: Floats
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
        return _knobs(self.names, self.centers)

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
        np.clip(stiff, 0, 1),
        1 - 0.5 * hands - 0.5 * toes,
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
    for joint in skeleton.names:
        known = tables.canonical(joint)
        names.append(known if known and known not in names else f"({joint})")
    places = {}
    if len(skeleton.site_names):
        t = skin.triangles.astype(np.int64)
        face, foot = igl.point_mesh_squared_distance(skeleton.site_points, skin.rest, t)[1:3]
        corners = skin.triangles[np.asarray(face).reshape(-1)]
        share = barycentric(skin.rest[corners], np.asarray(foot, np.float64))
        far = np.linalg.norm(np.asarray(foot) - skeleton.site_points, axis=1) > 0.03
        for k, site in enumerate(skeleton.site_names):
            point = feature_name(site)
            if point and not far[k] and (point not in places or not site.endswith("_tip")):
                places[point] = (corners[k], share[k])
    hands = _share(weights, tuple(names), ("radiocarpal", *PALM, "metacarpo", "carpal_"))
    return Template(
        tuple(names), skeleton.parents, skeleton.centers, skin.rest, skin.triangles, weights, places,
        0.9 * hands, 1 - 0.5 * hands, np.ones(len(skin.rest), bool),
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


@dataclass
class _Board:
    """Knobs while they are gathered: name, (joint, parameter, amount) each, pull."""

    index: dict[str, int]
    names: list[str] = field(default_factory=list)
    cells: list[tuple[int, int, float]] = field(default_factory=list)
    pull: list[float] = field(default_factory=list)

    def add(self, title: str, cells: list[tuple[int, int, float]], pull: float) -> None:
        self.cells += [(EACH * j + k, len(self.names), amount) for j, k, amount in cells if amount]
        self.names.append(title)
        self.pull.append(pull)

    def some(self, joints: Iterable[str]) -> list[int]:
        return [self.index[j] for j in joints if j in self.index]

    def turn(self, title: str, joints: Iterable[str], pull: float = 1.0) -> None:
        """One turn that the joints share."""
        some = self.some(joints)
        for k in range(3 if some else 0):
            self.add(f"turn {title} {k}", [(j, k, 1 / len(some)) for j in some], TURN * pull * len(some) ** 2)

    def hinge(self, joint: str, axis: Floats, pull: float, aside: float) -> None:
        """Turns about an axis, which are easy, and about the two across it."""
        j = self.index[joint]
        first = np.cross(axis, [0.3, 0.5, 0.8])
        first /= np.linalg.norm(first)
        for k, (way, held) in enumerate(((axis, pull), (first, aside), (np.cross(axis, first), aside))):
            self.add(f"turn {joint} {k}", [(j, a, float(way[a])) for a in range(3)], TURN * held)

    def scale(self, title: str, joints: Iterable[str], pull: float = 1.0) -> None:
        some = self.some(joints)
        for k in range(2 if some else 0):
            self.add(f"scale {title} {k}", [(j, 6 + k, 1.0) for j in some], SCALE * pull)

    def shift(self, title: str, joint: str, pull: float) -> None:
        for k in range(3 if joint in self.index else 0):
            self.add(f"shift {title} {k}", [(self.index[joint], 3 + k, 1.0)], pull)

    def knobs(self) -> Knobs:
        from scipy.sparse import csr_array

        r, c, v = (np.array(x) for x in zip(*self.cells, strict=True))
        links = csr_array((v.astype(np.float64), (r, c)), shape=(EACH * len(self.index), len(self.names)))
        place = {t: i for i, t in enumerate(self.names)}
        pairs, tie = [], []
        for title, i in place.items():
            other = "scale r_" + title[8:] if title.startswith("scale l_") else _neighbour(title)
            if other in place:
                pairs.append((i, place[other]))
                tie.append(MIRROR if title.startswith("scale") else FINGERS)
        return Knobs(
            links, np.array(self.pull), np.array(pairs, np.int32).reshape(-1, 2), np.array(tie), tuple(self.names)
        )


def _neighbour(title: str) -> str:
    """The same turn of the next finger, "" where there is none."""
    parts = title.split()
    stem, ray = parts[1][:-1], parts[1][-1]
    if parts[0] != "turn" or "phalangeal" not in stem or "tarsal" in stem or ray not in "234":
        return ""
    return f"turn {stem}{int(ray) + 1} {parts[2]}"


def _knobs(names: tuple[str, ...], centers: Floats) -> Knobs:
    """The knobs of a skeleton: joints of the spine turn together by regions, hands and feet are scaled as one."""
    board = _Board({n: i for i, n in enumerate(names)})
    root = names[0]
    board.turn("root", [root], 1e-4)
    board.shift("root", root, 1e-8)
    board.scale("pelvis", [root, "sacroiliac"])
    board.turn("pelvis", ["sacroiliac"], 100.0)
    for region in ("vl", "vt", "vc"):
        some = [n for n in names if n[:2] == region and n[2:].isdigit()]
        board.turn(region, some, 3.0)
        board.scale(region, some)
    board.turn("skull", ["skullbase"], 2.0)
    board.scale("skull", ["skullbase", *(n for n in names if n.removeprefix("l_").removeprefix("r_").startswith(FACE))])
    for side in ("l_", "r_"):
        _side(board, side, [n for n in names if n.startswith(side)], centers)
    for n in names:  # joints the standard does not know
        if n.startswith("(") and n != root:
            board.turn(n, [n], 5.0)
            board.scale(n, [n], 5.0)
    return board.knobs()


def _side(board: _Board, side: str, mine: list[str], centers: Floats) -> None:
    """The knobs of the limbs of one side."""
    stem = {n: n[2:] for n in mine}
    palm = [n for n in mine if stem[n].startswith(PALM)]
    fingers = [n for n in mine if stem[n].startswith(("metacarpophalangeal", "carpal_"))]
    feet = [n for n in mine if stem[n].startswith(FOOT)]
    board.turn(side + "clavicle", [side + "sternoclavicular"], 20.0)
    board.turn(side + "blade", [side + "acromioclavicular"], 60.0)
    board.scale(side + "clavicle", [side + "sternoclavicular", side + "acromioclavicular"])
    for joint, pull in (("shoulder", 1), ("elbow", 1), ("radiocarpal", 6), ("hip", 1), ("knee", 1), ("talocrural", 2)):
        board.turn(side + joint, [side + joint], pull)
    for joint in ("shoulder", "elbow", "hip", "knee"):
        board.scale(side + joint, [side + joint])
        board.shift(side + joint, side + joint, SHIFT * (1 if joint in ("shoulder", "hip") else 10))
    board.scale(side + "hand", [side + "radiocarpal", *palm, *fingers], 2.0)
    board.scale(side + "foot", [side + "talocrural", *feet])
    knuckles = board.some(f"{side}metacarpophalangeal_{k}" for k in (2, 5))
    for n in fingers:
        if n.endswith("_1") or len(knuckles) < 2:
            board.turn(n, [n], 1.0)
            continue
        across = centers[knuckles[1]] - centers[knuckles[0]]
        bent = "interphalangeal" in n
        board.hinge(n, across / max(float(np.linalg.norm(across)), 1e-9), 0.3, 60.0 if bent else 8.0)
    board.turn(side + "carpometacarpal_1", [side + "carpometacarpal_1"], 2.0)
    toes = [n for n in feet if stem[n].startswith("metatarsophalangeal")]
    board.turn(side + "toes", toes or [n for n in feet if stem[n].startswith(("midtarsal", "metatarsal"))][:1], 4.0)
