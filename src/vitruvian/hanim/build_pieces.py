"""Small parts of a new scene: lists of what was made, info strings, cameras, and what a source leaves behind."""

from __future__ import annotations

from collections import Counter

from vitruvian.hanim.build_motion import INTERPOLATORS
from vitruvian.hanim.graph import Node, Use
from vitruvian.hanim.humanoid import Humanoid, Viewpoint
from vitruvian.hanim.reading import Reading
from vitruvian.hanim.studio import of_a_studio

# Node types whose meaning the typed view carries (or that are made anew).
_CARRIED = {
    *(
        "Shape",
        "Appearance",
        "Material",
        "PhysicalMaterial",
        "ImageTexture",
        "TextureTransform",
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


class Lists:
    """Nodes of one humanoid in the order they were made, for the lists of USEs and for ROUTEs."""

    def __init__(self) -> None:
        self.joints: list[Node] = []
        self.segments: list[Node] = []
        self.sites: list[Node] = []
        self.by_name: dict[str, Node] = {}
        self.by_site: dict[int, Node] = {}
        self.points: dict[str, Node | Use] = {}  # Coordinate of a segment, or of the skin under ""


def token(name: str) -> str:
    """A name without blanks, as the schema's NMTOKEN wants it."""
    return "_".join(name.split())


def use(node: Node) -> Use:
    return Use(node.name, node, type=node.type)


def put(node: Node, field: str, children: list) -> None:
    if not children:
        return
    for child in children:
        if field in _NAMED:
            child.container = field
    node.fields[field] = children


def viewpoint_node(view: Viewpoint) -> Node:
    fields: dict[str, object] = {"description": view.description, "position": view.position}
    if view.orientation[3] != 0:
        fields["orientation"] = view.orientation
    if view.field_of_view != 0.785398:
        fields["fieldOfView"] = float(view.field_of_view)
    return Node("Viewpoint", fields=fields)


def info_strings(h: Humanoid) -> list[str]:
    """The info strings: those of the file in their order and wording, with what was changed, removed and added.

    Of a key that stands twice the last value counts; all its strings stay until it is removed.
    """
    out: list[str] = []
    last: dict[str, tuple[int, str]] = {}
    for text in h.info_given:
        key, _, value = (part.strip() for part in text.partition("="))
        if not text.strip() or key in h.info:
            last[key] = (len(out), value)
            out.append(text)
    for key, value in h.info.items():
        if key not in last:
            out.append(f"{key}={value}" if value else key)
        elif last[key][1] != value:
            out[last[key][0]] = f"{key}={value}"
    return out


def left_behind(humanoids: list[Humanoid], carried: set[int]) -> list[str]:
    """What the source files hold that a new scene does not, nor makes anew: node types with their counts."""
    counts: Counter[str] = Counter()
    for scene in {id(h.scene): h.scene for h in humanoids if h.scene is not None}.values():
        reading = Reading(scene)
        other = (n for n in scene.walk() if n.type not in _CARRIED and id(n) not in carried)
        counts.update(n.type for n in other if not reading.kind(n) and not of_a_studio(reading, n))
    if not counts:
        return []
    some = ", ".join(f"{n} {kind}" for kind, n in counts.most_common(8)) + (", ..." if len(counts) > 8 else "")
    return [f"other nodes of the source file: {some}"]


def credits(humanoids: list[Humanoid]) -> list[str]:
    return [f"{k}={v}" for h in humanoids for k, v in h.info.items() if v][:16] or ["H-Anim humanoid"]
