"""Humanoids to a scene graph: native nodes (X3D XML and Classic) or PROTO instances (VRML97 200x and 1.1)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np

import vitruvian
from vitruvian.errors import VitruvianError
from vitruvian.hanim import members, prototypes, tables
from vitruvian.hanim.build_kept import copies
from vitruvian.hanim.build_motion import motion_node, track_nodes
from vitruvian.hanim.build_pieces import Lists, credits, info_strings, left_behind, put, token, use, viewpoint_node
from vitruvian.hanim.build_shape import Names, ShapeWriter
from vitruvian.hanim.convert import converted
from vitruvian.hanim.defbody import defbody_node, prototype
from vitruvian.hanim.graph import Literal, Node, Route, Scene, Use
from vitruvian.hanim.humanoid import (
    ContourSurface,
    Described,
    Displacer,
    Humanoid,
    Joint,
    Picture,
    Pose,
    Segment,
    Site,
    Viewpoint,
)
from vitruvian.hanim.reading import Reading
from vitruvian.hanim.segmenting import segment as cut
from vitruvian.hanim.studio import studio

_SITES = {"pt", "tip", "view"}
_DISPLACERS = {"feature", "action", "config"}


def scene_of(
    humanoids: list[Humanoid],
    *,
    version: str | None = None,
    encoding: str = "x3d",
    draft: bool = False,
    address: Callable[[Picture], list[str]] | None = None,
) -> tuple[Scene, list[str]]:
    """A scene that holds these humanoids, and a list of what it cannot say.

    `encoding`: "x3d", "x3dv", "x3dj" (JSON) or "wrl". `version` of H-Anim: "2.0" (X3D 4.0), "1.0" (X3D 3.3), "200x" or
    "1.1" (VRML97 prototypes); names are converted to it. Without one, humanoids that came together from a file of the same
    family go back into their own scene graph, so that everything unknown to us survives; others are built afresh with
    2.0 names, or as 200x in VRML97. `draft` writes X3D 4.1 as drafted: HAnimPose, `motions_enabled`, `skin_displacers`
    and other nodes in `children` of the humanoid. `address` gives the urls of pictures. Raises
    `VitruvianError` for combinations that do not exist.
    """
    if encoding not in {"x3d", "x3dv", "x3dj", "wrl"}:
        raise VitruvianError(f"encoding: expected x3d, x3dv, x3dj or wrl, found {encoding!r}")
    if not humanoids:
        raise VitruvianError("humanoids: expected at least one, found none")
    if draft and (encoding == "wrl" or version not in {None, "2.0"}):
        raise VitruvianError("draft: expected X3D with H-Anim 2.0, found another encoding or version")
    if version is None and not draft:
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
    return Builder(version, encoding, draft, address).scene(humanoids, lost), lost


class Builder:
    """One scene under construction."""

    def __init__(
        self,
        version: str,
        encoding: str,
        draft: bool = False,
        address: Callable[[Picture], list[str]] | None = None,
    ):
        self.version = version
        self.table = members.DRAFT if draft else version
        self.native = encoding != "wrl"
        x3d = "4.1" if draft else "4.0" if version == "2.0" else "3.3"
        self.out = Scene(encoding=encoding, version=x3d if self.native else "2.0")
        self.names = Names()
        self.shapes = ShapeWriter(self.names, physical=self.out.version >= "4", address=address)
        self.routes: list[Route] = []
        self.lost: list[str] = []
        self.missing: Counter[str] = Counter()  # fields that the version lacks, with how many objects give them
        self.extra: dict[str, dict[str, str]] = {}  # kind -> further fields of its prototype, with types
        self.reading = Reading(self.out)
        self.carried: set[int] = set()
        self.defbodies: dict[bool, bool] = {}  # prototypes in use: textured -> with a colour per point
        self.instances: list[tuple[Node, ContourSurface]] = []

    def scene(self, humanoids: list[Humanoid], lost: list[str]) -> Scene:
        if self.native:
            self.out.profile = "Immersive"
            level = 3 if self.table == members.DRAFT or any(h.motions for h in humanoids) and self.modern else 1
            self.out.components.append(("HAnim" if self.modern else "H-Anim", level))
            self.out.metas.append(("generator", f"vitruvian {vitruvian.__version__}"))
        title = ", ".join(h.name for h in humanoids if h.name) or "humanoid"
        self.out.body.append(Node("WorldInfo", fields={"title": title, "info": credits(humanoids)}))
        ready = []
        for h in humanoids:
            there, gone = converted(h, self.version)
            self.lost += gone
            ready.append(self._fitted(there))
        self.out.body += studio(ready)
        given: set[str] = set()
        for h in ready:
            name, n = token(h.name) or "humanoid", 2
            while name in given:
                name, n = f"{token(h.name) or 'humanoid'}_{n}", n + 1
            given.add(name)
            if name != h.name:
                h = replace(h, name=name)
            self.reading = Reading(h.scene or self.out)
            self._humanoid(h, "hanim_" if len(ready) == 1 else f"{name}_")
        for node, surface in self.instances:  # all instances of a prototype have the fields that one of them needs
            if self.defbodies[node.type == "DefBodyTex"] and "Colors" not in node.fields:
                count = surface.points.shape[0] * surface.points.shape[1]
                node.fields["Colors"] = np.tile(surface.material.color[:3], (count, 1))
        self.out.body[:0] = [prototype(textured, colored) for textured, colored in self.defbodies.items()]
        if not self.native:
            self.out.body[:0] = prototypes.prototypes(self.version, self.extra)
        self.out.body += self.routes
        lost += self.lost + sorted(self.shapes.lost)
        for field, n in self.missing.items():
            lost.append(f"{field} of {n} object{'s' if n > 1 else ''}: H-Anim {self.version} has no such field")
        lost += left_behind(humanoids, self.carried)
        return self.out

    @property
    def modern(self) -> bool:
        """Whether it is X3D 4."""
        return self.native and self.out.version >= "4"

    def _plain(self, node: Node, thing: Described, kind: str) -> None:
        """The plain fields of an object, its metadata and its extras."""
        for field in members.set_members(node.fields, thing, kind, self.table):
            self.missing[f"{kind}.{field}"] += 1
        if thing.metadata is not None:
            copied = copies([thing.metadata], self.names, self.carried) if self.native else []
            if copied:
                copied[0].container = "metadata"
                node.fields["metadata"] = copied[0]
            elif not self.native:
                self.missing[f"{kind}.metadata"] += 1
        for field, value in thing.extras.items():
            kept = self._extra_type(thing, kind, field, value)
            if kept:
                node.fields[field] = value
                self.extra.setdefault(kind, {})[field] = kept
            else:
                self.missing[f"{kind}.{field}"] += 1

    def _extra_type(self, thing: Described, kind: str, field: str, value: object) -> str:
        """The type under which a prototype may declare an extra field; "" when there is none to add it to."""
        if self.native or isinstance(value, Literal):
            return ""
        source = getattr(thing, "node", None)
        declared = members.extra_type(self.reading, source if source is not None else Node(kind), field)
        return declared or members.type_like(value)

    def _kept(self, nodes: list[Node], what: str) -> list[Node]:
        """Copies of other nodes, where the encoding can take them."""
        found = copies(nodes, self.names, self.carried) if self.native else []
        if len(found) < len(nodes) and not any(n.line for n in nodes):
            self.lost.append(f"{len(nodes) - len(found)} other nodes in {what}")
        return found

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
        return members.has(self.table, kind, field)

    def part(
        self, part: Joint | Segment | Site | Displacer, prefix: str, figure: Lists, h: Humanoid, owner: Segment | None
    ) -> Node:
        """The node of one object and all it holds; `owner` is the Segment that a Displacer moves."""
        if isinstance(part, Joint):
            return self._joint(part, prefix, figure, h)
        if isinstance(part, Segment):
            return self._segment(part, prefix, figure, [])
        if isinstance(part, Site):
            return self._site(part, prefix, figure)
        return self._displacer(part, prefix, figure, owner)

    def _humanoid(self, h: Humanoid, prefix: str) -> None:
        root = self.node("Humanoid", self.names.free(prefix + (h.name or "humanoid")))
        fields = root.fields
        fields["name"] = token(h.name) or "humanoid"
        fields["version"] = self.version
        if self.has("Humanoid", "loa"):
            fields["loa"] = int(h.loa)
        strings = info_strings(h)
        if strings:
            fields["info"] = strings
        self._plain(root, h, "Humanoid")
        figure = Lists()
        body = "humanoidBody" if self.version == "1.1" else "skeleton"
        entries: list[Node] = [self._joint(j, prefix, figure, h) for j in h.skeleton]
        entries += [self._site(s, prefix, figure) for s in h.sites]
        put(root, body, entries)
        self._skin(h, root, prefix, figure)
        put(root, "joints", [use(n) for n in figure.joints])
        put(root, "segments", [use(n) for n in figure.segments])
        put(root, "sites", [use(n) for n in figure.sites])
        put(root, "viewpoints", [self._viewpoint(s, prefix, figure) for s in h.viewpoints])
        self._motions(h, root, prefix)
        if h.binding or h.skin_binding_coords is not None or h.skin_binding_normals is not None:
            self.lost.append("binding matrices (browsers disagree on them, so they are not written)")
        self._of_the_draft(h, root, prefix, figure)
        self.out.body.append(root)
        self._tracks(h, prefix, {"": root, **figure.by_name}, figure.points)

    def _of_the_draft(self, h: Humanoid, root: Node, prefix: str, figure: Lists) -> None:
        """What X3D 4.1 adds: displacers of the humanoid itself, poses and other children."""
        if self.table != members.DRAFT:
            gone: dict[str, list] = {"displacers": h.skin_displacers, "poses": h.poses, "children": h.children}
            self.missing.update({f"Humanoid.{field}": len(things) for field, things in gone.items() if things})
            return
        if h.skin_displacers:
            put(root, "displacers", [self._displacer(d, prefix, figure) for d in h.skin_displacers])
        children = [*(self._pose(p, prefix) for p in h.poses), *self._kept(h.children, "the humanoid")]
        put(root, "children", children)

    def _pose(self, pose: Pose, prefix: str) -> Node:
        node = Node("HAnimPose", self.names.free(prefix + pose.name), {"name": token(pose.name)})
        self._plain(node, pose, "Pose")
        joints = []
        for joint in pose.joints:
            child = Node("HAnimJoint", fields={"name": token(joint.name)})
            self._plain(child, joint, "Joint")
            joints.append(child)
        if joints:
            node.fields["children"] = joints
        return node

    def _skin(self, h: Humanoid, root: Node, prefix: str, figure: Lists) -> None:
        if not len(h.skin_coord) or not self.has("Humanoid", "skinCoord"):
            return
        coords = f"{prefix}skin_coords"
        shown = []
        for s in h.skin:
            own = s.points is not None
            node = self.shapes.shape(s, prefix, f"{prefix}{s.name}_coords" if own else coords, h.skin_coord)
            if node is None:
                continue
            shown.append(node)
            if own and s.name:
                figure.points.setdefault(s.name, node.children("geometry")[0].children("coord")[0])
        put(root, "skin", shown)
        made = Node("Coordinate", fields={"point": h.skin_coord})
        coord = self.shapes.share("coord", h.skin_coord, coords, made)
        coord.container = "skinCoord"
        root.fields["skinCoord"] = coord
        figure.points[""] = coord
        if h.skin_normal is not None and len(h.skin_normal):
            root.fields["skinNormal"] = Node("Normal", container="skinNormal", fields={"vector": h.skin_normal})
        if not self.native and any(len(j.skin_coord_index) for j in h.joints()):
            self.lost.append("a moving skin: plain VRML97 browsers draw the skin at rest, only H-Anim browsers move it")

    def _joint(self, top: Joint, prefix: str, figure: Lists, h: Humanoid) -> Node:
        """A joint and all below it."""
        made: dict[int, Node] = {}
        for joint in top.walk():
            node = self.node("Joint", self.names.free(prefix + joint.name))
            made[id(joint)] = node
            figure.joints.append(node)
            figure.by_name[joint.name] = node
            fields = node.fields
            fields["name"] = token(joint.name)
            self._plain(node, joint, "Joint")
            fields["center"] = joint.center
            for field, value in (("llimit", joint.llimit), ("ulimit", joint.ulimit)):
                if len(value) and (len(joint.llimit) != len(joint.ulimit) or (joint.llimit != joint.ulimit).any()):
                    fields[field] = value
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

    def _segments(self, joint: Joint, prefix: str, figure: Lists) -> list[Node]:
        """Segment nodes; the joint's own Sites go into its segment, where the schema wants them."""
        segments = joint.segments
        if joint.sites and not segments:
            known = tables.canonical(joint.name)
            name = tables.joints()[known].segment if known else f"{joint.name}_segment"
            segments = [Segment(tables.name_in(name, self.version, "segment") or name)]
        nodes = []
        for k, segment in enumerate(segments):
            node = self._segment(segment, prefix, figure, joint.sites if k == 0 else [])
            if segment.contours:
                below = node.fields.setdefault("children", [])
                below += [self._contours(c, joint, prefix) for c in segment.contours]  # type: ignore[operator]
            nodes.append(node)
        return nodes

    def _contours(self, surface: ContourSurface, joint: Joint, prefix: str) -> Node:
        textured, colored = surface.uv is not None, surface.colors is not None
        self.defbodies[textured] = self.defbodies.get(textured, False) or colored
        name = self.names.free(prefix + surface.name)
        node = defbody_node(surface, joint.center, name, textured, colored, self.shapes.address)
        self.instances.append((node, surface))
        return node

    def _segment(self, segment: Segment, prefix: str, figure: Lists, sites: list[Site]) -> Node:
        node = self.node("Segment", self.names.free(prefix + segment.name))
        figure.segments.append(node)
        fields = node.fields
        fields["name"] = token(segment.name)
        self._plain(node, segment, "Segment")
        if segment.moments_of_inertia.any():
            fields["momentsOfInertia"] = segment.moments_of_inertia
        coords = f"{prefix}{segment.name}_coords"
        shapes = [n for s in segment.shapes if (n := self.shapes.shape(s, prefix, coords)) is not None]
        children = [*shapes, *(self._site(s, prefix, figure) for s in [*segment.sites, *sites])]
        children += self._kept(segment.children, f"segment {segment.name}")
        if children:
            fields["children"] = children
        coord = self._segment_coord(segment, coords, shapes)
        if coord is not None:
            fields["coord"] = coord
            figure.points[segment.name] = coord
        if segment.displacers and coord is not None:
            fields["displacers"] = [self._displacer(d, prefix, figure, segment) for d in segment.displacers]
        elif segment.displacers:
            self.lost.append(f"displacers of segment {segment.name}: it has no points for them")
        return node

    def _segment_coord(self, segment: Segment, coords: str, shapes: list[Node]) -> Node | Use | None:
        """The points that displacers move: those of the shape that shares `Segment.coord`, else the first's."""
        if segment.coord is None and not segment.displacers:
            return None
        shared = [s for s in segment.shapes if s.points is not None and len(s.triangles)]
        model = next((s for s in shared if s.points is segment.coord), shared[0] if shared else None)
        if model is not None and (segment.coord is None or model.points is segment.coord) and shapes:
            return use(shapes[shared.index(model)].children("geometry")[0].children("coord")[0])
        if segment.coord is None:
            return None
        return self.shapes.share("coord", segment.coord, coords, Node("Coordinate", fields={"point": segment.coord}))

    def _site(self, site: Site, prefix: str, figure: Lists, listed: bool = True) -> Node:
        suffixed = site.name.rpartition("_")[2] in _SITES
        node = self.node("Site", self.names.free(prefix + site.name + ("" if suffixed else "_pt")))
        if listed:
            figure.sites.append(node)
        figure.by_name.setdefault(site.name, node)
        figure.by_site[id(site)] = node
        node.fields["name"] = token(site.name)
        self._plain(node, site, "Site")
        coords = f"{prefix}{site.name}_coords"
        children = [n for s in site.shapes if (n := self.shapes.shape(s, prefix, coords)) is not None]
        viewpoints = site.viewpoints
        if site.name.endswith("_view") and not viewpoints:
            viewpoints = [Viewpoint(site.name.removesuffix("_view").replace("_", " "), position=np.zeros(3))]
        children += [viewpoint_node(v) for v in viewpoints]
        self.carried |= {id(v.node) for v in viewpoints}
        children += self._kept(site.children, f"site {site.name}")
        if children:
            node.fields["children"] = children
        return node

    def _viewpoint(self, site: Site, prefix: str, figure: Lists) -> Node | Use:
        if id(site) in figure.by_site:
            return use(figure.by_site[id(site)])
        return self._site(site, prefix, figure, listed=False)

    def _displacer(self, d: Displacer, prefix: str, figure: Lists, segment: Segment | None = None) -> Node:
        kind = "" if d.name.rpartition("_")[2] in _DISPLACERS else "_action" if d.displacements.any() else "_feature"
        node = self.node("Displacer", self.names.free(prefix + d.name + kind))
        figure.by_name.setdefault(d.name, node)
        node.fields["name"] = token(d.name)
        node.fields["coordIndex"] = d.coord_index.astype(np.int32)
        moves = d.displacements
        baked = next((s.transform for s in segment.shapes if s.points is not None), None) if segment else None
        node.fields["displacements"] = moves if baked is None else moves @ baked[:3, :3].T
        self._plain(node, d, "Displacer")
        return node

    def _motions(self, h: Humanoid, root: Node, prefix: str) -> None:
        if not h.motions:
            return
        if not self.modern:
            self.lost.append("HAnimMotion: only X3D 4.0 has it")
            return
        nodes = []
        driven = any(t.field not in {"weight", "point"} for t in h.tracks)
        for m in h.motions:
            node = motion_node(m, self.names.free(prefix + m.name), enabled=m.enabled and not driven)
            self._plain(node, m, "Motion")  # type: ignore[arg-type]
            nodes.append(node)
        if driven and any(m.enabled for m in h.motions):
            self.lost.append("enabled of HAnimMotion: interpolators drive the same joints, so it is written as FALSE")
        put(root, "motions", nodes)

    def _tracks(self, h: Humanoid, prefix: str, targets: dict[str, Node], points: dict[str, Node | Use]) -> None:
        if not h.tracks:
            return
        able = [t for t in h.tracks if t.field != "weight" or self.has("Displacer", "weight")]
        nodes, routes, lost = track_nodes(able, targets, self.names.free, prefix, points)
        if len(able) < len(h.tracks):
            lost.append(f"{len(h.tracks) - len(able)} tracks of displacer weights: H-Anim {self.version} has none")
        self.out.body += nodes
        self.routes += routes
        self.lost += lost
