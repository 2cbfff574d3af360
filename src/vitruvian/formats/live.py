"""A contour body that deforms by itself: a Script in the file, run by any X3D or VRML97 browser, no server.

Rotations are routed to the Script instead of to the joints; it sends the new points of every surface, then releases the
rotations, so that no picture shows one without the other. What lies between contours is cut into parts that ride on one
joint and parts that the Script moves too: no browser skins anything. Source: cross-section deformation of H-Anim bodies,
Script node and interception of events; plain ECMAScript, ROUTEs instead of directOutput unless pointers are asked for.
"""

from __future__ import annotations

import gzip
from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain

import numpy as np

from vitruvian.body.contours import carried_on
from vitruvian.body.pack import pack
from vitruvian.body.types import Body, Ints
from vitruvian.errors import VitruvianError
from vitruvian.formats.live_parts import Soft, parted, smooth_normals
from vitruvian.formats.live_script import Plan, code, plan, values
from vitruvian.hanim.build import scene_of
from vitruvian.hanim.convert import converted
from vitruvian.hanim.defbody import closed_faces, listed_corners
from vitruvian.hanim.graph import Literal, Node, Proto, ProtoField, Route, Scene, Use
from vitruvian.hanim.humanoid import Humanoid, Picture
from vitruvian.hanim.values import parse

SCRIPT, CLOCK = "hanim_ContourScript", "hanim_ClockScript"
POINTERS = ("routes", "human", "nodes")
SCHEMES = ("javascript", "ecmascript", "vrmlscript")
_STRIPS = "IndexedTriangleStripSet"
# X_ITE works out tangents, which only normal maps need, after each change; given one, it need not. VRML97 has no such
# node, nor triangle sets, whose indices X_ITE keeps as a list while it asks a proxy for each index of an IndexedFaceSet
# several times at each change; so there both come out of scenes of their own. Browsers that make no X3D leave it.
_MADE = """function made(text, then) {
  try {
    Browser.createX3DFromString('#X3D V4.0 utf8' + String.fromCharCode(10) + 'PROFILE Full ' + text)
      .then(function (scene) { then(scene.rootNodes[0]); }, function () {});
  } catch (e) {}
}
"""
_TANGENTS = """function initialize() {
  made('Tangent { vector 0 1 0 1 }', function (tangent) {
    for (var i = 0; i < geometry.length; ++i) geometry[i].tangent = tangent;
  });
}
"""
_STRIPPING = """var strips = [], latest = null, shared = ['color', 'texCoord', 'normal', 'coord'];
function set_index(value) { latest = value; if (strips[0]) strips[0].set_index = value; }
function strip(i) {
  var faces = geometry[i], solid = faces.solid ? 'TRUE' : 'FALSE';
  made('IndexedTriangleStripSet { solid ' + solid + ' tangent Tangent { vector 0 1 0 1 } }', function (strip) {
    strip.set_index = latest || faces.coordIndex;
    for (var k = 0; k < shared.length; ++k)
      if (faces[shared[k]]) { strip[shared[k]] = faces[shared[k]]; faces[shared[k]] = null; }
    strips[i] = strip;
    shapes[i].geometry = strip;
  });
}
function initialize() { for (var i = 0; i < geometry.length; ++i) strip(i); }
"""


@dataclass(frozen=True, eq=False)
class Live:
    """A scene that deforms itself. `body` is what it shows: the packed humanoid, in the scene's version and names,
    `soft` the points of its skin that the script moves.

    `report`: points (contours), soft_points and rigid_points (between them), surfaces, joints, levels, script_bytes.
    """

    scene: Scene
    body: Body
    soft: Soft
    lost: list[str]
    report: dict[str, int]


def live_scene(
    humanoid: Humanoid,
    *,
    encoding: str = "x3d",
    version: str | None = None,
    pointers: str = "routes",
    schemes: tuple[str, ...] | None = None,
    address: Callable[[Picture], list[str]] | None = None,
) -> Live:
    """A scene of a humanoid with contours, and the Script that deforms it.

    `encoding` and `version` as in `scene_of` (default 2.0, in VRML97 200x). `pointers`: "routes" sends points and
    rotations by ROUTEs, which every browser has; "human" gives the Script one pointer to the Humanoid, "nodes" lists of
    the joints and surfaces, and no ROUTEs leave it. `schemes`: how the Script's url may begin, one copy of the code each;
    default "javascript" in VRML97, "ecmascript" in X3D. `address` gives the urls of pictures (default: their own).
    Raises VitruvianError for a body without contours and for an unknown option.
    """
    schemes = schemes or (("javascript",) if encoding == "wrl" else ("ecmascript",))
    known(pointers, schemes)
    version = version or ("200x" if encoding == "wrl" else "2.0")
    there, _ = converted(humanoid, version)
    body = pack(there)
    if not body.contours:
        raise VitruvianError("live: expected a body with contours, found none; make one by `contours`")
    cut, soft = parted(there, body)
    scene, lost = scene_of([cut], version=version, encoding=encoding, address=address)
    made = _Writer(scene, plan(body, soft), pointers, schemes)
    made.write()
    report = {
        "points": sum(s.vertices.size for s in body.contours),
        "soft_points": len(soft.rest),
        "rigid_points": sum(len(s.points) for g in cut.segments() for s in g.shapes if s.points is not None)
        - len(soft.rest),
        "surfaces": len(body.contours) + len(soft.names),
        "joints": len(made.names),
        "levels": len(made.plan.levels),
        "script_bytes": len(made.code.encode()),
        "script_gzip_bytes": len(gzip.compress(made.code.encode(), mtime=0)),
    }
    return Live(scene, body, soft, lost, report)


def known(pointers: str, schemes: tuple[str, ...]) -> None:
    """Raise VitruvianError unless these are options of `live_scene`."""
    if pointers not in POINTERS:
        raise VitruvianError(f"pointers: expected {', '.join(POINTERS)}, found {pointers!r}")
    if any(s not in SCHEMES for s in schemes):
        raise VitruvianError(f"schemes: expected some of {', '.join(SCHEMES)}, found {', '.join(map(repr, schemes))}")


class _Writer:
    """One script under construction."""

    def __init__(self, scene: Scene, plan: Plan, pointers: str, schemes: tuple[str, ...]):
        self.scene, self.plan, self.pointers, self.schemes = scene, plan, pointers, schemes
        self.body, self.soft, self.names = plan.body, plan.soft, plan.names
        self.native = scene.encoding != "wrl"
        nodes = list(scene.walk())
        self.joints = {_text(n.fields.get("name")): n for n in nodes if n.type in ("HAnimJoint", "Joint")}
        self.surfaces = {_text(n.fields.get("name")): n for n in nodes if n.type in ("DefBody", "DefBodyTex")}
        self.shapes = {n.name: n for n in nodes if n.type == "Shape"}
        self.human = next(n for n in nodes if n.type in ("HAnimHumanoid", "Humanoid"))
        for what, wanted, have in (
            ("joint", self.names, self.joints),
            ("surface", [s.name for s in self.body.contours], self.surfaces),
        ):
            for name in wanted:
                if name not in have:
                    raise VitruvianError(f"live: expected a node of {what} {name} in the scene, found none")
        self.code = ""
        instances = self.surfaces.values()
        self.pictured = any(map(_pictured, instances))
        self.looks = [self._looks(level) for level in plan.levels]
        # surfaces whose faces need texture coordinates of their own at each level, as a border of the map crosses them
        self.bordered = [i for i, t in enumerate(self.looks[0]) if self.pictured and t is not None]

    def _looks(self, faces: list[Ints]) -> list[Ints | None]:
        """Texture coordinates of the corners of a level's faces, by surfaces; None: those of the points."""
        out: list[Ints | None] = []
        for surface, triangles in zip(self.body.contours, faces, strict=True):
            index = self.surfaces[surface.name].fields.get("TexCoordsIndex")
            count, each = surface.vertices.shape
            corners = None if index is None else listed_corners(np.asarray(index), count)
            out.append(None if corners is None else carried_on(corners, triangles, each, surface.closed))
        return out

    def write(self) -> None:
        prefix = "hanim_"
        self._prototypes()
        normals = smooth_normals(self.body)[np.concatenate([s.vertices.ravel() for s in self.body.contours])]
        first = 0
        for surface, triangles, looks in zip(self.body.contours, self.plan.levels[0], self.looks[0], strict=True):
            fields = self.surfaces[surface.name].fields
            count = surface.vertices.size
            fields["Normals"] = normals[first : first + count]
            first += count
            fields["PointsIndex"] = closed_faces(triangles)
            if looks is not None:
                fields["TexCoordsIndex"] = closed_faces(looks)
        # what receives points and normals: (name, node, its field) each
        parts: list[tuple[str, tuple[Node, str], tuple[Node, str]]] = [
            (s.name, (node := self.surfaces[s.name], "Points"), (node, "Normals")) for s in self.body.contours
        ]
        geometry = [self._softened(prefix + name) for name in self.soft.names]
        for name, shape in zip(self.soft.names, geometry, strict=True):
            coord, normal = shape.children("coord")[0], shape.children("normal")[0]
            parts.append((name, (coord, "point"), (normal, "vector")))
        script = Node("Script", SCRIPT)
        declare = script.interface.append
        for name in [*self.names, *self.plan.aliases]:
            declare(ProtoField("inputOnly", "SFRotation", f"hanim_{name}Def"))
        for kind, name in (("SFBool", "set_extremities"), ("SFBool", "set_survey"), ("SFInt32", "set_lod"),
                           ("MFInt32", "add_lod")):  # fmt: skip
            declare(ProtoField("inputOnly", kind, name))
        declare(ProtoField("outputOnly", "SFInt32", "lod_count"))
        if self.pointers == "routes":
            for name in self.names:
                declare(ProtoField("outputOnly", "SFRotation", f"hanim_{name}_rotation"))
            for name, _, _ in parts:
                declare(ProtoField("outputOnly", "MFVec3f", f"{name}_points"))
                declare(ProtoField("outputOnly", "MFVec3f", f"{name}_normals"))
            for surface in self.body.contours:
                declare(ProtoField("outputOnly", "MFInt32", f"{surface.name}_index"))
            for i in self.bordered:
                declare(ProtoField("outputOnly", "MFInt32", f"{self.body.contours[i].name}_looks"))
        else:
            script.fields["directOutput"] = True
            script.fields["mustEvaluate"] = True
            nodes = [self.human] if self.pointers == "human" else []
            if nodes:
                declare(ProtoField("initializeOnly", "SFNode", "Human", _use(self.human)))
            else:
                declare(
                    ProtoField("initializeOnly", "MFNode", "jointNodes", [_use(self.joints[n]) for n in self.names])
                )
                shown = [_use(self.surfaces[s.name]) for s in self.body.contours]
                declare(ProtoField("initializeOnly", "MFNode", "surfaceNodes", shown))
            if geometry:
                for field in ("coord", "normal"):
                    uses = [_use(g.children(field)[0]) for g in geometry]
                    declare(ProtoField("initializeOnly", "MFNode", f"{field}Nodes", uses))
        every = [np.zeros(0, np.int32)]
        if self.bordered:
            pairs = zip(chain(*self.looks), chain(*self.plan.levels), strict=True)
            every = [(own if own is not None else faces).reshape(-1) for own, faces in pairs]
        numbers = [*values(self.plan, normals), ("MFInt32", "looks", np.concatenate(every))]
        for kind, name, value in numbers:
            typed = np.asarray(value, np.int32 if kind == "MFInt32" else np.float64)
            declare(ProtoField("initializeOnly", kind, name, typed))
        self.code = code(self.plan, self.pointers, self.bordered)
        self._url(script, [f"{scheme}:\n{self.code}" for scheme in self.schemes])
        body = self.scene.body
        self._reroute({node.name: name for name, node in self.joints.items() if name in self.names})
        body.append(script)
        stripped = [i for i, g in enumerate(geometry) if not self.native and _single(g)]
        if stripped:
            body.append(self._stripping([(geometry[i], self.shapes[prefix + self.soft.names[i]]) for i in stripped]))
        if len(geometry) > len(stripped):
            body.append(self._tangents([g for i, g in enumerate(geometry) if i not in stripped]))
        if self.pointers == "routes":
            for name in self.names:
                body.append(Route(SCRIPT, f"hanim_{name}_rotation", self.joints[name].name, "set_rotation"))
            for name, (node, field), (other, vectors) in parts:
                body.append(Route(SCRIPT, f"{name}_points", node.name, f"set_{field}"))
                body.append(Route(SCRIPT, f"{name}_normals", other.name, f"set_{vectors}"))
            for surface in self.body.contours:
                body.append(Route(SCRIPT, f"{surface.name}_index", self.surfaces[surface.name].name, "set_PointsIndex"))
            for name in (self.body.contours[i].name for i in self.bordered):
                body.append(Route(SCRIPT, f"{name}_looks", self.surfaces[name].name, "set_TexCoordsIndex"))
        self._clock()
        # Routes are read in the order of the file: those from the script come after its node.
        body.sort(key=lambda statement: isinstance(statement, Route))

    def _prototypes(self) -> None:
        """DefBody with normals and with faces that events change, and without a picture where no surface has one: an
        empty one costs as much to draw as any. In X3D the faces are strips of one triangle each, of which X_ITE keeps
        a list, while it reads the indices of other sets through a proxy at each change; but strips have no texture
        coordinates of their own for corners."""
        for proto in self.scene.body:
            if not isinstance(proto, Proto) or proto.name not in ("DefBody", "DefBodyTex"):
                continue
            proto.interface.append(ProtoField("inputOnly", "MFInt32", "set_PointsIndex"))
            empty = np.zeros((0, 3))
            proto.interface.append(ProtoField("inputOutput", "MFVec3f", "Normals", empty))
            shown = next(n for top in proto.body if isinstance(top, Node) for n in _below(top) if n.type == "Shape")
            geometry = shown.children("geometry")[0]
            if not self.pictured:
                for field in ("texture", "textureTransform"):
                    shown.children("appearance")[0].fields.pop(field, None)
                geometry.fields.pop("texCoord", None)
            bordered = bool(self.bordered) and proto.name == "DefBodyTex"
            inner = "index" if self.native and not bordered else "coordIndex"
            geometry.connects = [(inner, "PointsIndex"), (f"set_{inner}", "set_PointsIndex")]
            if bordered:
                proto.interface.append(ProtoField("inputOnly", "MFInt32", "set_TexCoordsIndex"))
                geometry.connects += [("texCoordIndex", "TexCoordsIndex"), ("set_texCoordIndex", "set_TexCoordsIndex")]
            geometry.fields = {
                "solid": self._closed(),
                **{k: v for k, v in geometry.fields.items() if isinstance(v, Node)},
            }
            if self.native and not bordered:
                geometry.type = _STRIPS
            geometry.fields["normal"] = Node("Normal", connects=[("vector", "Normals")])
            geometry.name = "faces"
            if self.native or bordered:
                proto.body.append(self._tangents([geometry]))
            else:
                shown.name = "shown"
                script = self._stripping([(geometry, shown)])
                script.interface.append(ProtoField("inputOnly", "MFInt32", "set_index"))
                script.connects = [("set_index", "set_PointsIndex")]
                proto.body.append(script)

    def _closed(self) -> bool:
        """Whether no contours can be seen from inside, as all their rims meet other points: drawing one side is enough."""
        surfaces, rest = self.body.contours, self.body.skin.rest
        rims = [s.vertices[[0, -1]].ravel() for s in surfaces]
        rims += [s.vertices[:, [0, -1]].ravel() for s in surfaces if not s.closed]
        edge = np.unique(np.concatenate(rims))
        both = np.concatenate([edge, self.soft.vertices[self.soft.tied >= 0]])
        _, same, times = np.unique(rest[both], axis=0, return_inverse=True, return_counts=True)
        return bool((times[same.reshape(-1)[: len(edge)]] > 1).all())

    def _softened(self, name: str) -> Node:
        """The geometry of a shape that the script moves, as triangles with DEF names where it is sent to."""
        if name not in self.shapes:
            raise VitruvianError(f"live: expected a Shape {name} in the scene, found none")
        geometry = self.shapes[name].children("geometry")[0]
        geometry.name = f"{name}_faces"
        for field in ("coord", "normal"):
            node = geometry.children(field)[0]
            node.name = f"{name}_{field}"
        if self.native and _single(geometry):
            geometry.type = _STRIPS
            faces = geometry.fields["coordIndex"]
            geometry.fields = {k: v for k, v in geometry.fields.items() if k not in ("coordIndex", "creaseAngle")}
            geometry.fields["index"] = faces
        return geometry

    def _tangents(self, geometry: list[Node]) -> Node:
        return self._easing({"geometry": geometry}, _TANGENTS)

    def _stripping(self, shown: list[tuple[Node, Node]]) -> Node:
        """A script that gives Shapes strips for their faces: pairs of geometry and Shape."""
        return self._easing({"geometry": [g for g, _ in shown], "shapes": [s for _, s in shown]}, _STRIPPING)

    def _easing(self, nodes: dict[str, list[Node]], code: str) -> Node:
        script = Node("Script", fields={"directOutput": True})
        for name, some in nodes.items():
            script.interface.append(ProtoField("initializeOnly", "MFNode", name, [_use(n) for n in some]))
        self._url(script, [f"{scheme}:\n{_MADE}{code}" for scheme in self.schemes])
        return script

    def _url(self, script: Node, codes: list[str]) -> None:
        if self.scene.encoding in ("x3d", "x3dj") and len(codes) == 1:
            script.text = codes[0]
        else:
            script.fields["url"] = codes

    def _reroute(self, joints: dict[str, str]) -> None:
        """Routes that turn a joint go to the script."""
        for statement in self.scene.body:
            turns = isinstance(statement, Route) and statement.to_field in ("rotation", "set_rotation")
            if turns and isinstance(statement, Route) and statement.to_node in joints:
                statement.to_field = f"hanim_{joints[statement.to_node]}Def"
                statement.to_node = SCRIPT

    def _clock(self) -> None:
        """A second script between TimeSensors and interpolators, so that `set_speed` makes the animation slower, faster
        or run backwards while it plays: browsers do not let an active TimeSensor's cycle be changed."""
        body = self.scene.body
        sensors = {n.name: n for n in body if isinstance(n, Node) and n.type == "TimeSensor"}
        timed = [
            r for r in body if isinstance(r, Route) and r.from_node in sensors and r.from_field == "fraction_changed"
        ]
        if not timed:
            return
        script = Node("Script", CLOCK)
        script.interface.append(ProtoField("inputOnly", "SFFloat", "set_speed"))
        lines = [
            "var speed = 1, last = {}, phase = {};",
            "function set_speed(value) { speed = value; }",
            "function step(name, value) {",
            "  var way = last[name] === undefined ? 0 : value - last[name];",
            "  if (last[name] === undefined) phase[name] = value;",
            "  if (way < -0.5) way += 1;",
            "  last[name] = value;",
            "  phase[name] += way * speed;",
            "  phase[name] -= Math.floor(phase[name]);",
            "  return phase[name];",
            "}",
        ]
        sources = dict.fromkeys(r.from_node for r in timed)
        for name in sources:
            script.interface.append(ProtoField("inputOnly", "SFFloat", f"set_{name}"))
            script.interface.append(ProtoField("outputOnly", "SFFloat", f"{name}_fraction"))
            lines.append(f"function set_{name}(value) {{ {name}_fraction = step('{name}', value); }}")
        for r in timed:
            r.from_node, r.from_field = CLOCK, f"{r.from_node}_fraction"
        self._url(script, [f"{scheme}:\n" + "\n".join([*lines, ""]) for scheme in self.schemes])
        body.append(script)
        body.extend(Route(name, "fraction_changed", CLOCK, f"set_{name}") for name in sources)


def _below(top: Node) -> list[Node]:
    """A node and all below it; scenes of ours are shallow."""
    out = [top]
    for node in out:
        out += [n for _, n in node.entries() if isinstance(n, Node)]
    return out


def _single(geometry: Node) -> bool:
    """Whether a set of faces is of triangles whose corners have what their points have, as those of strips have."""
    faces = geometry.fields.get("coordIndex")
    own = {"texCoordIndex", "colorIndex", "normalIndex"} & set(geometry.fields)
    return not own and isinstance(faces, np.ndarray) and not (faces[3::4] >= 0).any()


def _use(node: Node) -> Use:
    return Use(node.name, node, type=node.type)


def _pictured(node: Node) -> bool:
    """Whether the instance of a DefBodyTex names a picture."""
    value = node.fields.get("tex")
    words = parse(value, "MFString") if isinstance(value, Literal) else value
    return isinstance(words, (str, list, tuple)) and any(words)


def _text(value: object) -> str:
    return value if isinstance(value, str) else ""
