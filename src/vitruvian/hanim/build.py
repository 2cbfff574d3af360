"""Humanoids to a scene graph: native nodes (X3D XML and Classic) or PROTO instances (VRML97 200x and 1.1)."""

from __future__ import annotations

from collections import Counter

import numpy as np

import vitruvian
from vitruvian.errors import VitruvianError
from vitruvian.hanim import prototypes, tables
from vitruvian.hanim.build_motion import INTERPOLATORS, motion_node, track_nodes
from vitruvian.hanim.build_shape import Names, ShapeWriter
from vitruvian.hanim.convert import converted
from vitruvian.hanim.graph import Node, Route, Scene, Use
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Segment, Site
from vitruvian.hanim.reading import Reading
from vitruvian.hanim.segmenting import segment as cut
from vitruvian.hanim.studio import studio

_ROTATION = np.array([0.0, 0.0, 1.0, 0.0])
_PLACE = {
    "translation": ("translation", np.zeros(3)),
    "rotation": ("rotation", _ROTATION),
    "scale": ("scale", np.ones(3)),
    "scaleOrientation": ("scale_orientation", _ROTATION),
    "center": ("center", np.zeros(3)),
}
# Node types whose meaning the typed view carries (or that are made anew).
_CARRIED = {
    *(
        "Shape",
        "Appearance",
        "Material",
        "PhysicalMaterial",
        "ImageTexture",
        "Coordinate",
        "TextureCoordinate",
        "Color",
    ),
    *(
        "ColorRGBA",
        "Normal",
        "IndexedFaceSet",
        "IndexedTriangleSet",
        "TriangleSet",
        "Box",
        "Sphere",
        "Cylinder",
        "Cone",
    ),
    *("Group", "Transform", "TimeSensor", *INTERPOLATORS.values(), "WorldInfo", "NavigationInfo", "Background"),
}
# Fields of a Humanoid whose children need a containerField in XML.
_NAMED = {"skeleton", "joints", "segments", "sites", "viewpoints", "skin", "skinCoord", "skinNormal", "motions"}


def scene_of(
    humanoids: list[Humanoid], *, version: str | None = None, encoding: str = "x3d"
) -> tuple[Scene, list[str]]:
    """A scene that holds these humanoids, and a list of what it cannot say.

    `encoding` "x3d", "x3dv" or "wrl". `version` of H-Anim: "2.0" (X3D 4.0), "1.0" (X3D 3.3), "200x" or "1.1" (VRML97
    prototypes); names are converted to it. Without a version, humanoids that came together from one file of the same
    family go back into their own scene graph, so that everything unknown to us survives; others are built afresh with
    2.0 names, or as 200x in VRML97. Raises `VitruvianError` for combinations that do not exist.
    """
    if encoding not in {"x3d", "x3dv", "wrl"}:
        raise VitruvianError(f"encoding: expected x3d, x3dv or wrl, found {encoding!r}")
    if not humanoids:
        raise VitruvianError("humanoids: expected at least one, found none")
    if version is None:
        from vitruvian.hanim.update import updated

        kept = updated(humanoids, encoding)
        if kept is not None:
            return kept
    lost: list[str] = []
    version = version or ("200x" if encoding == "wrl" else "2.0")
    if encoding == "wrl" and version not in {"200x", "1.1"}:
        lost.append(f"H-Anim {version} has no VRML97 encoding: written as 200x with 1.x names")
        version = "200x"
    elif encoding != "wrl" and version in {"200x", "1.1"}:
        lost.append(f"X3D does not know H-Anim version {version}: written as 1.0, the same names")
        version = "1.0"
    return _Builder(version, encoding).scene(humanoids, lost), lost


class _Builder:
    """One scene under construction."""

    def __init__(self, version: str, encoding: str):
        self.version = version
        self.native = encoding != "wrl"
        x3d = "4.0" if version == "2.0" else "3.3"
        self.out = Scene(encoding=encoding, version=x3d if self.native else "2.0")
        self.names = Names()
        self.shapes = ShapeWriter(self.names, physical=self.out.version == "4.0")
        self.routes: list[Route] = []
        self.lost: list[str] = []

    def scene(self, humanoids: list[Humanoid], lost: list[str]) -> Scene:
        if self.native:
            self.out.profile = "Immersive"
            level = 3 if any(h.motions for h in humanoids) and self.version == "2.0" else 1
            self.out.components.append(("HAnim" if self.out.version == "4.0" else "H-Anim", level))
            self.out.metas.append(("generator", f"vitruvian {vitruvian.__version__}"))
        else:
            self.out.body += prototypes.prototypes(self.version)
        title = ", ".join(h.name for h in humanoids if h.name) or "humanoid"
        self.out.body.append(Node("WorldInfo", fields={"title": title, "info": _credits(humanoids)}))
        ready = []
        for h in humanoids:
            there, gone = converted(h, self.version)
            self.lost += gone
            ready.append(self._fitted(there))
        self.out.body += studio(ready)
        for h in ready:
            self._humanoid(h, "hanim_" if len(ready) == 1 else f"{h.name}_")
        self.out.body += self.routes
        known = sorted(self.shapes.lost)
        lost += self.lost + known
        lost += _left_behind(humanoids)
        return self.out

    def _fitted(self, h: Humanoid) -> Humanoid:
        """What this version can show of it: 1.1 has no skin, so each triangle moves to one segment."""
        if self.version != "1.1" or not len(h.skin_coord):
            return h
        self.lost.append("the seamless skin: H-Anim 1.1 has none, its triangles went to the segments of their joints")
        return cut(h)

    def node(self, kind: str, name: str = "") -> Node:
        """An H-Anim node: HAnimJoint in X3D, Joint in VRML97."""
        if self.native:
            return Node(f"HAnim{kind}", name)
        return Node(kind, name)

    def has(self, kind: str, field: str) -> bool:
        """Whether the target's node of that kind has the field."""
        return self.native or field in prototypes.fields_of(self.version, kind)

    def _humanoid(self, h: Humanoid, prefix: str) -> None:
        root = self.node("Humanoid", self.names.free(prefix + (h.name or "humanoid")))
        fields = root.fields
        fields["name"] = _token(h.name) or "humanoid"
        fields["version"] = self.version
        if self.out.version == "4.0":
            fields["loa"] = int(h.loa)
            if h.skeletal_configuration != "BASIC":
                fields["skeletalConfiguration"] = h.skeletal_configuration
        if h.info:
            fields["info"] = [f"{k}={v}" if v else k for k, v in h.info.items()]
        _place(fields, h)
        figure = _Lists()
        body = "humanoidBody" if self.version == "1.1" else "skeleton"
        entries: list[Node] = [self._joint(j, prefix, figure, h) for j in h.skeleton]
        entries += [self._site(s, prefix, figure) for s in h.sites]
        _put(root, body, entries)
        self._skin(h, root, prefix)
        _put(root, "joints", [_use(n) for n in figure.joints])
        _put(root, "segments", [_use(n) for n in figure.segments])
        _put(root, "sites", [_use(n) for n in figure.sites])
        _put(root, "viewpoints", [self._viewpoint(s, prefix, figure) for s in h.viewpoints])
        self._motions(h, root, prefix)
        if h.binding:
            self.lost.append("binding matrices (browsers disagree on them, so they are not written)")
        self.out.body.append(root)
        self._tracks(h, prefix, {"": root, **figure.by_name})

    def _skin(self, h: Humanoid, root: Node, prefix: str) -> None:
        if not len(h.skin_coord) or not self.has("Humanoid", "skinCoord"):
            return
        coords = f"{prefix}skin_coords"
        shown = [n for s in h.skin if (n := self.shapes.shape(s, prefix, coords, h.skin_coord)) is not None]
        _put(root, "skin", shown)
        made = Node("Coordinate", fields={"point": h.skin_coord})
        coord = self.shapes.share("coord", h.skin_coord, coords, made)
        coord.container = "skinCoord"
        root.fields["skinCoord"] = coord
        if h.skin_normal is not None and len(h.skin_normal):
            root.fields["skinNormal"] = Node("Normal", container="skinNormal", fields={"vector": h.skin_normal})
        if not self.native:
            self.lost.append("a moving skin: plain VRML97 browsers draw the skin at rest, only H-Anim browsers move it")

    def _joint(self, top: Joint, prefix: str, figure: _Lists, h: Humanoid) -> Node:
        """A joint and all below it."""
        made: dict[int, Node] = {}
        for joint in top.walk():
            node = self.node("Joint", self.names.free(prefix + joint.name))
            made[id(joint)] = node
            figure.joints.append(node)
            figure.by_name[joint.name] = node
            fields = node.fields
            fields["name"] = _token(joint.name)
            _place(fields, joint)
            fields["center"] = joint.center
            for field, value in (("llimit", joint.llimit), ("ulimit", joint.ulimit)):
                if len(value) and (len(joint.llimit) != len(joint.ulimit) or (joint.llimit != joint.ulimit).any()):
                    fields[field] = value
            if joint.limit_orientation[3] != 0:
                fields["limitOrientation"] = joint.limit_orientation
            if joint.stiffness.any():
                fields["stiffness"] = joint.stiffness
            if len(joint.skin_coord_index) and self.has("Joint", "skinCoordIndex"):
                fields["skinCoordIndex"] = joint.skin_coord_index.astype(np.int32)
                fields["skinCoordWeight"] = joint.skin_coord_weight
            if joint.displacers and self.has("Joint", "displacers"):
                fields["displacers"] = [self._displacer(d, prefix, figure) for d in joint.displacers]
            elif joint.displacers:
                self.lost.append(
                    f"displacers of joint {joint.name}: H-Anim {self.version} has them under segments only"
                )
            children = self._segments(joint, prefix, figure)
            if children:
                fields["children"] = children
        for joint in top.walk():
            if joint.joints:
                below = made[id(joint)].fields.setdefault("children", [])
                below += [made[id(j)] for j in joint.joints]  # type: ignore[operator]
        return made[id(top)]

    def _segments(self, joint: Joint, prefix: str, figure: _Lists) -> list[Node]:
        """Segment nodes; the joint's own Sites go into its segment, where the schema wants them."""
        segments = joint.segments
        if joint.sites and not segments:
            known = tables.canonical(joint.name)
            name = tables.joints()[known].segment if known else f"{joint.name}_segment"
            segments = [Segment(tables.name_in(name, self.version, "segment") or name)]
        nodes = []
        for k, segment in enumerate(segments):
            nodes.append(self._segment(segment, prefix, figure, joint.sites if k == 0 else []))
        return nodes

    def _segment(self, segment: Segment, prefix: str, figure: _Lists, sites: list[Site]) -> Node:
        node = self.node("Segment", self.names.free(prefix + segment.name))
        figure.segments.append(node)
        fields = node.fields
        fields["name"] = _token(segment.name)
        if segment.mass:
            fields["mass"] = float(segment.mass)
        if segment.center_of_mass.any():
            fields["centerOfMass"] = segment.center_of_mass
        if segment.moments_of_inertia.any():
            fields["momentsOfInertia"] = segment.moments_of_inertia
        coords = f"{prefix}{segment.name}_coords"
        shapes = [n for s in segment.shapes if (n := self.shapes.shape(s, prefix, coords)) is not None]
        children = [*shapes, *(self._site(s, prefix, figure) for s in [*segment.sites, *sites])]
        if children:
            fields["children"] = children
        if segment.displacers and shapes:
            coord = shapes[0].children("geometry")[0].children("coord")[0]
            fields["coord"] = _use(coord)
            fields["displacers"] = [self._displacer(d, prefix, figure, segment) for d in segment.displacers]
        return node

    def _site(self, site: Site, prefix: str, figure: _Lists, listed: bool = True) -> Node:
        suffixed = site.name.rpartition("_")[2] in {"pt", "tip", "view"}
        node = self.node("Site", self.names.free(prefix + site.name + ("" if suffixed else "_pt")))
        if listed:
            figure.sites.append(node)
        figure.by_name.setdefault(site.name, node)
        figure.by_site[id(site)] = node
        node.fields["name"] = _token(site.name)
        _place(node.fields, site)
        coords = f"{prefix}{site.name}_coords"
        children = [n for s in site.shapes if (n := self.shapes.shape(s, prefix, coords)) is not None]
        if site.name.endswith("_view"):
            title = site.name.removesuffix("_view").replace("_", " ")
            children.append(Node("Viewpoint", fields={"description": title, "position": np.zeros(3)}))
        if children:
            node.fields["children"] = children
        return node

    def _viewpoint(self, site: Site, prefix: str, figure: _Lists) -> Node | Use:
        if id(site) in figure.by_site:
            return _use(figure.by_site[id(site)])
        return self._site(site, prefix, figure, listed=False)

    def _displacer(self, d: Displacer, prefix: str, figure: _Lists, segment: Segment | None = None) -> Node:
        node = self.node("Displacer", self.names.free(prefix + d.name))
        figure.by_name.setdefault(d.name, node)
        node.fields["name"] = _token(d.name)
        node.fields["coordIndex"] = d.coord_index.astype(np.int32)
        moves = d.displacements
        baked = next((s.transform for s in segment.shapes if s.points is not None), None) if segment else None
        node.fields["displacements"] = moves if baked is None else moves @ baked[:3, :3].T
        if d.weight and self.has("Displacer", "weight"):
            node.fields["weight"] = float(d.weight)
        return node

    def _motions(self, h: Humanoid, root: Node, prefix: str) -> None:
        if not h.motions:
            return
        if self.out.version != "4.0":
            self.lost.append("HAnimMotion: only X3D 4.0 has it")
            return
        nodes = [
            motion_node(m, self.names.free(prefix + m.name), enabled=m.enabled and not h.tracks) for m in h.motions
        ]
        if h.tracks and any(m.enabled for m in h.motions):
            self.lost.append("enabled of HAnimMotion: interpolators drive the same joints, so it is written as FALSE")
        _put(root, "motions", nodes)

    def _tracks(self, h: Humanoid, prefix: str, targets: dict[str, Node]) -> None:
        if not h.tracks:
            return
        able = [t for t in h.tracks if t.field != "weight" or self.has("Displacer", "weight")]
        nodes, routes, lost = track_nodes(able, targets, self.names.free, prefix)
        if len(able) < len(h.tracks):
            lost.append(f"{len(h.tracks) - len(able)} tracks of displacer weights: H-Anim {self.version} has none")
        self.out.body += nodes
        self.routes += routes
        self.lost += lost


class _Lists:
    """Nodes of one humanoid in the order they were made, for the lists of USEs and for ROUTEs."""

    def __init__(self) -> None:
        self.joints: list[Node] = []
        self.segments: list[Node] = []
        self.sites: list[Node] = []
        self.by_name: dict[str, Node] = {}
        self.by_site: dict[int, Node] = {}


def _token(name: str) -> str:
    """A name without blanks, as the schema's NMTOKEN wants it."""
    return "_".join(name.split())


def _use(node: Node) -> Use:
    return Use(node.name, node, type=node.type)


def _put(node: Node, field: str, children: list) -> None:
    if not children:
        return
    for child in children:
        if field in _NAMED:
            child.container = field
    node.fields[field] = children


def _place(fields: dict[str, object], thing: Humanoid | Joint | Site) -> None:
    """The transform fields that differ from their defaults."""
    for field, (attribute, default) in _PLACE.items():
        value = getattr(thing, attribute)
        if not np.array_equal(value, default):
            fields[field] = value


def _left_behind(humanoids: list[Humanoid]) -> list[str]:
    """What the source files hold that a new scene does not: node types with their counts."""
    counts: Counter[str] = Counter()
    for scene in {id(h.scene): h.scene for h in humanoids if h.scene is not None}.values():
        reading = Reading(scene)
        counts.update(n.type for n in scene.walk() if n.type not in _CARRIED and not reading.kind(n))
    if not counts:
        return []
    some = ", ".join(f"{n} {kind}" for kind, n in counts.most_common(8)) + (", ..." if len(counts) > 8 else "")
    return [f"other nodes of the source file: {some}"]


def _credits(humanoids: list[Humanoid]) -> list[str]:
    return [f"{k}={v}" for h in humanoids for k, v in h.info.items() if v][:16] or ["H-Anim humanoid"]
