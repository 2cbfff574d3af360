"""The Script of a live file: the values that it is given, and its code.

What is the same in every file is live.js; here is what depends on a body: which joints it must know, which parts a joint
concerns, and one function or line for each event that comes or goes.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from vitruvian.body.contours import Contours
from vitruvian.body.types import Body, Floats, Ints
from vitruvian.deform.contour_steps import Program, program
from vitruvian.deform.contours import ROUND, retwisted
from vitruvian.deform.survey import slabs
from vitruvian.formats.live_parts import Soft, levels, staying

_ALIASES = {"l_thigh": "l_hip", "r_thigh": "r_hip"}
_NECK = "c"  # surfaces of the neck begin so


@dataclass(frozen=True, eq=False)
class Plan:
    """What a script works with: the contours' `program`, surfaces as skin sees them (`seen`), triangles of each level of
    detail and surface (`levels`), and the joints whose rotations it must know (`needed`, with their `names`)."""

    body: Body
    soft: Soft
    program: Program
    seen: list[Contours]
    levels: list[list[Ints]]
    needed: list[int]

    @property
    def names(self) -> list[str]:
        return [self.body.skeleton.names[j] for j in self.needed]

    @property
    def aliases(self) -> dict[str, str]:
        """Other names of joints that events may come under: the source's own, which are names of segments."""
        return {a: n for a, n in _ALIASES.items() if n in self.names and a not in self.names}

    @property
    def parts(self) -> list[str]:
        """What is moved: surfaces, then soft shapes."""
        return [*(s.name for s in self.body.contours), *self.soft.names]


def plan(body: Body, soft: Soft) -> Plan:
    seen = retwisted(body.contours)
    made = program(body, [*body.contours, *seen])
    return Plan(body, soft, made, seen, levels(body, body.contours), _needed(body, made, soft))


def values(plan: Plan, normals: Floats) -> list[tuple[str, str, np.ndarray]]:
    """Fields of the script: type, name, value. `normals` (n,3) of all points of the surfaces."""
    p, soft, body = plan.program, plan.soft, plan.body
    skeleton = body.skeleton
    surfaces = list(body.contours)
    place = {j: i for i, j in enumerate(plan.needed)}
    renumber = np.array([place.get(j, -1) for j in range(len(skeleton))] + [-1], np.int32)
    rest = np.concatenate([body.skin.rest[s.vertices].reshape(-1, 3) for s in surfaces])
    need = [renumber[n] for n in _needs(body, p, surfaces, plan.seen, soft)]
    slab = slabs(body, surfaces)
    faces = [t.reshape(-1) for level in plan.levels for t in level]
    ends = lambda arrays: np.cumsum([0, *map(len, arrays)])  # noqa: E731
    neck = [int(s.name.startswith(_NECK)) for s in surfaces]
    names = [s.name for s in surfaces]
    rows = soft.influences
    return [
        ("MFInt32", "parent", renumber[skeleton.parents[plan.needed]]),
        ("MFFloat", "center", skeleton.centers[plan.needed].ravel()),
        ("MFInt32", "link", renumber[p.link].ravel()),
        ("MFFloat", "axis", p.axis.ravel()),
        ("MFFloat", "bone", p.bone.ravel()),
        ("MFInt32", "base", renumber[p.base]),
        ("MFInt32", "row", p.row),
        ("MFInt32", "step", p.step),
        ("MFFloat", "swing", p.swing),
        ("MFFloat", "twist", np.where(np.isnan(p.twist), -1.0, p.twist)),
        ("MFFloat", "middle", p.middle.ravel()),
        ("MFFloat", "along", p.along.ravel()),
        ("MFInt32", "frame", renumber[p.frame]),
        ("MFFloat", "diversion", p.diversion),
        ("MFFloat", "mitre", p.mitre),
        ("MFInt32", "mitreLink", p.mitre_link),
        ("MFFloat", "mitreShare", p.mitre_share),
        ("MFFloat", "bulge", p.bulge),
        ("MFInt32", "bulgeLink", p.bulge_link),
        *_recentred(p, renumber),
        ("MFInt32", "pair", slab.pair.ravel()),
        ("MFFloat", "area", slab.area.ravel()),
        ("MFFloat", "free", slab.free),
        ("MFInt32", "first", np.concatenate([[0], np.cumsum([len(s) for s in surfaces])])),
        ("MFInt32", "each", np.array([s.vertices.shape[1] for s in surfaces])),
        ("MFInt32", "stays", np.concatenate([staying(s) for s in surfaces])),
        ("MFInt32", "closed", np.array([int(s.closed) for s in surfaces])),
        ("MFInt32", "switched", np.concatenate([neck, soft.far])),
        ("MFInt32", "needRow", ends(need)),
        ("MFInt32", "need", np.concatenate(need)),
        ("MFInt32", "softRow", rows.row),
        ("MFInt32", "softJoint", renumber[np.where(rows.joint < len(skeleton), rows.joint, -1)]),
        ("MFFloat", "softWeight", rows.weight),
        ("MFInt32", "softEnd", soft.end),
        ("MFInt32", "tied", soft.tied),
        ("MFInt32", "seenSurface", np.array([names.index(s.name) for s in plan.seen])),
        ("MFFloat", "round", np.array([ROUND])),
        ("MFInt32", "facesRow", ends(faces)),
        ("MFInt32", "faces", np.concatenate(faces)),
        ("MFFloat", "points", np.concatenate([rest, soft.rest]).ravel()),
        ("MFFloat", "normals", np.concatenate([normals, soft.normals]).ravel()),
    ]


def _recentred(p: Program, renumber: Ints) -> list[tuple[str, str, np.ndarray]]:
    """The fields of contours that keep to their bones: no numbers where none does, as in most bodies."""
    some = slice(None) if p.recentre.any() else slice(0)
    return [
        ("MFFloat", "recentre", p.recentre[some]),
        ("MFInt32", "limb", renumber[p.limb[some]]),
        ("MFFloat", "way", p.way[some].ravel()),
        ("MFFloat", "aside", p.aside[some].ravel()),
        ("MFFloat", "seam", p.seam[some]),
    ]


def code(plan: Plan, pointers: str, bordered: Collection[int] = ()) -> str:
    """The script: what is the same in every file, and one function or line for each event that comes or goes. `bordered`:
    numbers of surfaces whose faces have texture coordinates of their own."""
    parts, names = plan.parts, plan.names
    template = (files("vitruvian.formats") / "live.js").read_text("utf-8")
    lines = [f"function hanim_{name}Def(value) {{ turn({i}, value); }}" for i, name in enumerate(names)]
    lines += [f"function hanim_{a}Def(value) {{ hanim_{name}Def(value); }}" for a, name in plan.aliases.items()]
    surfaces = len(plan.body.contours)
    if pointers == "routes":
        kinds = ("points", "normals", "index", "looks")
        points, vectors, faces, looks = ([f"{n}_{kind}" for n in parts] for kind in kinds)
        rotations = [f"hanim_{name}_rotation" for name in names]
    else:
        if pointers == "human":
            lines.append("var nodes = null;")
            lines.append("function node(name) { return (nodes = nodes || found())[name]; }")
            at = [f"node('{n}')" for n in parts[:surfaces]]
            rotations = [f"node('{name}').rotation" for name in names]
        else:
            at = [f"surfaceNodes[{i}]" for i in range(surfaces)]
            rotations = [f"jointNodes[{i}].rotation" for i in range(len(names))]
        count = range(len(parts) - surfaces)
        points = [f"{a}.Points" for a in at] + [f"coordNodes[{i}].point" for i in count]
        vectors = [f"{a}.Normals" for a in at] + [f"normalNodes[{i}].vector" for i in count]
        faces = [f"{a}.set_PointsIndex" for a in at]
        looks = [f"{a}.set_TexCoordsIndex" for a in at]
    lines.append("function publish() {")
    for i in range(len(parts)):
        if i < surfaces:
            other = f" {looks[i]} = index({i}, place.looks);" if i in bordered else ""
            lines.append(
                f"  if (parts[{i}].relevel) {{ parts[{i}].relevel = false; {faces[i]} = index({i}, place.faces);{other} }}"
            )
        lines.append(
            f"  if (moved[{i}]) {{ {points[i]} = sent(parts[{i}], false); {vectors[i]} = sent(parts[{i}], true); }}"
        )
    lines += ["}", "function release() {"]
    lines += [f"  if (fresh[{i}]) {{ {r} = fresh[{i}]; fresh[{i}] = null; }}" for i, r in enumerate(rotations)]
    return "\n".join([template, *lines, "}", ""])


def _needed(body: Body, p: Program, soft: Soft) -> list[int]:
    """Joints whose rotations the script must know: those of the contours and of soft points, and all above them."""
    rows = soft.influences.joint
    wanted = {int(j) for j in [*p.link.ravel(), *p.base, *p.frame, *rows] if 0 <= j < len(body.skeleton)}
    for j in list(wanted):
        while j >= 0:
            wanted.add(j)
            j = int(body.skeleton.parents[j])
    return sorted(wanted)


def _needs(body: Body, p: Program, surfaces: list[Contours], seen: list[Contours], soft: Soft) -> list[np.ndarray]:
    """For each part the joints whose rotation changes its points, seen from the joint that it hangs on."""
    first, out, each = 0, [], []
    for s in [*surfaces, *seen]:
        for k in range(first, first + len(s)):
            steps = p.step[p.row[k] : p.row[k + 1]]
            links = [*steps.tolist(), p.mitre_link[k], p.bulge_link[k]]
            part = {int(p.limb[k])} if p.recentre[k] else set()
            each.append({int(p.base[k]), int(p.frame[k]), *p.link[links].ravel().tolist(), *part})
        first += len(s)
        out.append(_between(body, set.union(*each[first - len(s) :])))
    del out[len(surfaces) :]
    turned = {s.joint: each[len(each) - len(seen) + n] for n, s in enumerate(seen)}
    rows = soft.influences
    root = int(np.flatnonzero(body.skeleton.parents < 0)[0])
    start = 0
    for end in soft.end.tolist():
        used = {j if j < len(body.skeleton) else -1 for j in rows.joint[rows.row[start] : rows.row[end]].tolist()}
        tied = [each[k] for k in np.unique(soft.tied[start:end]).tolist() if k >= 0]
        out.append(_between(body, used.union({root}, *tied, *(turned[j] for j in used if j in turned))))
        start = end
    return out


def _between(body: Body, joints: set[int]) -> np.ndarray:
    """Joints on the ways between these, without the last one that they have in common: it turns them all alike."""
    parents = body.skeleton.parents
    paths = []
    for j in joints:
        path = []
        while j >= 0:
            path.append(j)
            j = int(parents[j])
        paths.append(set(path))
    common = set.intersection(*paths)
    return np.array(sorted(set.union(*paths) - common), np.int32)
