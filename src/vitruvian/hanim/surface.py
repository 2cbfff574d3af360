"""Shape nodes to triangulated `Shape`s: geometry, colours, texture coordinates, materials, nested transforms."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.hanim import triangulate
from vitruvian.hanim.graph import Node
from vitruvian.hanim.humanoid import Material, Picture, Shape
from vitruvian.hanim.reading import Reading

Floats = NDArray[np.float64]
_GROUPS = {"Group", "StaticGroup", "Collision", "Anchor", "Billboard", "CADLayer", "CADAssembly", "CADPart", "CADFace"}
_FLAT = {"IndexedLineSet", "LineSet", "PointSet", "Text"}  # drawn as lines or letters: no surface
_PRIMITIVES = {"Box", "Sphere", "Cylinder", "Cone"}
_DEPTH = 512
_PLACES = {"translation", "center", "rotation", "scale", "scaleOrientation"}
_COLOURING = {"texture", "diffuseTexture", "baseTexture", "emissiveTexture"}


def drawable(node: Node) -> bool:
    """Whether `shapes` looks for surfaces in a node."""
    return node.type in {"Shape", "Transform", "Switch", "LOD"} or node.type in _GROUPS


def transform_of(reading: Reading, node: Node) -> Floats:
    """(4, 4) of a Transform's fields: T C R SR S -SR -C, column vectors."""
    if node.type not in reading.protos and not _PLACES.intersection(node.fields):
        return np.eye(4)
    return matrix(
        reading.vector(node, "translation", (0, 0, 0)),
        reading.vector(node, "center", (0, 0, 0)),
        reading.vector(node, "rotation", (0, 0, 1, 0)),
        reading.vector(node, "scale", (1, 1, 1)),
        reading.vector(node, "scaleOrientation", (0, 0, 1, 0)),
    )


def matrix(translation: Floats, center: Floats, rotation: Floats, scale: Floats, orientation: Floats) -> Floats:
    """(4, 4) T C R SR S -SR -C of the five fields that Transform, Joint, Site and Humanoid share; unit axes."""
    linear = np.diag(scale) if orientation[3] == 0 else _turn(orientation) @ np.diag(scale) @ _turn(orientation).T
    if rotation[3] != 0:
        linear = _turn(rotation) @ linear
    placed = np.eye(4)
    placed[:3, :3] = linear
    placed[:3, 3] = translation + center - linear @ center
    return placed


def _turn(rotation: Floats) -> Floats:
    """(3, 3) of a unit axis and angle."""
    if rotation[3] == 0:
        return np.eye(3)
    x, y, z, angle = rotation.tolist()
    c, s = math.cos(angle), math.sin(angle)
    k = 1 - c
    return np.array(
        [
            [c + k * x * x, k * x * y - s * z, k * x * z + s * y],
            [k * x * y + s * z, c + k * y * y, k * y * z - s * x],
            [k * x * z - s * y, k * y * z + s * x, c + k * z * z],
        ]
    )


def shapes(reading: Reading, nodes: list[Node], skin_coord: Node | None = None) -> list[Shape]:
    """Every surface below `nodes`, in source order, nested Transforms baked into `Shape.transform`.

    H-Anim objects among them are left to the caller. Geometry whose Coordinate is `skin_coord` gets `points` None.
    """
    found: list[Shape] = []
    stack: list[tuple[Node, Floats | None, int]] = [(n, None, 0) for n in reversed(nodes)]
    while stack:
        node, matrix, depth = stack.pop()
        if depth > _DEPTH:
            reading.broken(f"groups nested deeper than {_DEPTH}", node)
            continue
        if node.type == "Shape":
            shape = _shape(reading, node, skin_coord)
            if shape is not None:
                shape.transform = matrix
                found.append(shape)
            continue
        if node.type == "Transform":
            own = transform_of(reading, node)
            matrix = own if matrix is None else matrix @ own
        stack.extend((child, matrix, depth + 1) for child in reversed(_visible(reading, node)))
    return found


def _visible(reading: Reading, node: Node) -> list[Node]:
    """The children that a browser draws first: the chosen one of a Switch, the nearest of a LOD."""
    if reading.kind(node):
        return []
    if node.type == "Switch":
        choices = node.children("children") or node.children("choice")
        which = int(reading.number(node, "whichChoice", -1))
        return choices[which : which + 1] if which >= 0 else []
    if node.type == "LOD":
        return (node.children("children") or node.children("level"))[:1]
    if node.type in _GROUPS or node.type == "Transform" or node.type in reading.protos:
        return node.children("children") + node.children("shapes")
    return []


@dataclass(slots=True)
class _Mesh:
    """Corners that point into coordinates: triangles are rows of `corners`, `index` says which point a corner is."""

    index: NDArray[np.int64]
    corners: NDArray[np.int64]
    face: NDArray[np.int64]  # of each triangle, for per-face colours

    @property
    def triangles(self) -> NDArray[np.int32]:
        return self.index[self.corners].astype(np.int32)


def coordinate(node: Node) -> Node | None:
    """The Coordinate node of a geometry, if it has one."""
    found = node.children("coord")
    return found[0] if found else None


def _shape(reading: Reading, node: Node, skin_coord: Node | None) -> Shape | None:
    geometries = node.children("geometry")
    if not geometries or geometries[0].type in _FLAT:
        return None
    geometry = geometries[0]
    shape = Shape(name=node.name or geometry.name, node=node, material=material(reading, node))
    shape.material.double_sided = not reading.flag(geometry, "solid", True)
    if geometry.type in _PRIMITIVES:
        if id(geometry) not in reading.primitives:  # the same ball USEd a hundred times is made once
            reading.primitives[id(geometry)] = _primitive(reading, geometry)
        primitive = reading.primitives[id(geometry)]
        shape.points, shape.triangles = primitive
        shape.crease_angle = 0.5
        return shape
    coord = coordinate(geometry)
    if coord is None:
        if not geometry.type.startswith(("Indexed", "Triangle", "Quad")):
            reading.defect("geometry", f"{geometry.type} {geometry.name} is not read as a surface", geometry)
        return None
    points = reading.numbers(coord, "point", "MFVec3f", 3)
    mesh = _mesh(reading, geometry, points)
    if mesh is None:
        return None
    if coord is not skin_coord:
        shape.points = points
    shape.crease_angle = reading.number(geometry, "creaseAngle", 0.0) * reading.angle
    if geometry.type != "IndexedFaceSet" and not geometry.type.startswith("Quad"):
        shape.crease_angle = np.pi if reading.flag(geometry, "normalPerVertex", True) else 0.0
    turned = not reading.flag(geometry, "ccw", True)
    shape.triangles = mesh.triangles[:, ::-1] if turned else mesh.triangles
    shape.triangles = np.ascontiguousarray(shape.triangles)
    if geometry.type in {"IndexedFaceSet", "QuadSet", "IndexedQuadSet"} and (np.diff(mesh.face) == 0).any():
        shape.faces = mesh.face.astype(np.int32)
    _texture(reading, geometry, mesh, shape, turned)
    _normals(reading, geometry, mesh, shape, turned)
    _colors(reading, geometry, mesh, shape, len(points))
    return shape


def _primitive(reading: Reading, node: Node) -> tuple[Floats, NDArray[np.int32]]:
    points, triangles = _tessellated(reading, node)
    return points, triangles.astype(np.int32)


def _tessellated(reading: Reading, node: Node) -> tuple[Floats, NDArray[np.int64]]:
    if node.type == "Box":
        return triangulate.box(reading.vector(node, "size", (2, 2, 2)))
    unit = reading.length
    if node.type == "Sphere":
        return triangulate.sphere(reading.number(node, "radius", 1.0) * unit)
    if node.type == "Cylinder":
        parts = {name: reading.flag(node, name, True) for name in ("top", "bottom", "side")}
        radius, height = reading.number(node, "radius", 1.0), reading.number(node, "height", 2.0)
        return triangulate.cylinder(radius * unit, height * unit, **parts)
    parts = {name: reading.flag(node, name, True) for name in ("bottom", "side")}
    radius, height = reading.number(node, "bottomRadius", 1.0), reading.number(node, "height", 2.0)
    return triangulate.cylinder(radius * unit, height * unit, tip=True, **parts)


def _mesh(reading: Reading, node: Node, points: Floats) -> _Mesh | None:
    """Triangles of an indexed or plain face, triangle, strip, fan or quad set; None when it is something else."""
    kind = node.type
    plain = np.arange(len(points), dtype=np.int64)
    if kind == "IndexedFaceSet":
        index = _index(reading, node, "coordIndex", len(points), separated=True)
        corners, face = triangulate.faces(index, points)
        return _Mesh(index, corners, face)
    if kind in {"IndexedTriangleStripSet", "IndexedTriangleFanSet"}:
        index = _index(reading, node, "index", len(points), separated=True)
        starts, sizes = triangulate.polygons(index)
        keep = index[index >= 0]
        corners = (triangulate.strips if "Strip" in kind else triangulate.fans)(sizes)
        return _Mesh(keep, corners, np.zeros(len(corners), np.int64))
    if kind in {"TriangleStripSet", "TriangleFanSet"}:
        counts = reading.indices(node, "stripCount" if "Strip" in kind else "fanCount").astype(np.int64)
        if (counts < 3).any() or counts.sum() > len(points):
            reading.broken(f"{reading.who(node)}: expected strips that fit {len(points)} points", node)
            counts = counts[:0]
        corners = (triangulate.strips if "Strip" in kind else triangulate.fans)(counts)
        return _Mesh(plain, corners, np.zeros(len(corners), np.int64))
    if kind in {"TriangleSet", "IndexedTriangleSet", "QuadSet", "IndexedQuadSet"}:
        n = 3 if "Triangle" in kind else 4
        index = _index(reading, node, "index", len(points)) if kind.startswith("Indexed") else plain
        whole = len(index) // n * n
        if whole != len(index):
            reading.defect("rest", f"{reading.who(node)}: {len(index) - whole} corners left over", node)
        corners = np.arange(whole).reshape(-1, n)
        if n == 4:
            closed = np.column_stack([index[:whole].reshape(-1, 4), np.full(whole // 4, -1)]).reshape(-1)
            corners, face = triangulate.faces(closed, points)
            return _Mesh(closed, corners, face)
        return _Mesh(index, corners, np.arange(len(corners)))
    reading.defect("geometry", f"{kind} {node.name} is not read as a surface", node)
    return None


def _index(reading: Reading, node: Node, field: str, limit: int, separated: bool = False) -> NDArray[np.int64]:
    """An index list checked against the number of points; in repair mode faces with a bad index are dropped."""
    index = reading.indices(node, field).astype(np.int64)
    low = -1 if separated else 0
    if not index.size or (index.max() < limit and index.min() >= low):
        return index
    bad = (index >= limit) | (index < low)
    first = int(np.flatnonzero(bad)[0])
    what = f"{field}: expected indices in 0..{limit - 1}, found {index[first]} at entry {first}"
    reading.broken(f"{reading.who(node)} {what}; check the point list or drop the face", node)
    if limit == 0:
        index = index[:0]
    if not separated:
        n = 3 if "Triangle" in node.type else 4
        whole = len(index) // n * n
        index = index[:whole].reshape(-1, n)[~bad[:whole].reshape(-1, n).any(axis=1)].reshape(-1)
        reading.mend(node, field, index.astype(np.int32))
        return index
    # faces keep their places, so that per-corner and per-face lists still fit: a bad one loses its area
    bad = bad[: len(index)]
    starts, sizes = triangulate.polygons(np.where(bad, 0, index))
    for start, size in zip(starts, sizes):
        if bad[start : start + size].any():
            index[start : start + size] = 0
    reading.mend(node, field, index.astype(np.int32))
    return index


def _texture(reading: Reading, geometry: Node, mesh: _Mesh, shape: Shape, turned: bool) -> None:
    found = geometry.children("texCoord")
    if found and found[0].type == "MultiTextureCoordinate":
        found = found[0].children("texCoord")[:1]
    if not found or found[0].type != "TextureCoordinate":
        return
    uv = reading.numbers(found[0], "point", "MFVec2f", 2)
    if reading.length != 1:
        uv = uv / reading.length  # texture coordinates have no unit
    if mesh.corners.size == 0:
        return
    index = reading.indices(geometry, "texCoordIndex").astype(np.int64)
    if len(index) == 0:
        index = mesh.index
        if len(uv) <= mesh.triangles.max():  # browsers draw this, only the picture is wrong
            what = f"{len(uv)} texture coordinates for {mesh.triangles.max() + 1} points: they are left out"
            reading.defect("texture", f"{reading.who(geometry)}: {what}", found[0])
            return
    if len(index) <= mesh.corners.max():
        what = f"expected an entry for each of {mesh.corners.max() + 1} corners, found {len(index)}"
        reading.broken(f"{reading.who(geometry)} texCoordIndex: {what}", geometry)
        reading.mend(geometry, "texCoordIndex", np.zeros(0, np.int32))
        reading.mend(geometry, "texCoord", None)
        return
    corners = index[mesh.corners]
    if corners.min() < 0 or corners.max() >= len(uv):
        what = f"expected indices in 0..{len(uv) - 1}, found {corners.max() if corners.min() >= 0 else corners.min()}"
        reading.broken(f"{reading.who(geometry)} texCoordIndex: {what}", geometry)
        reading.mend(geometry, "texCoordIndex", np.zeros(0, np.int32))
        reading.mend(geometry, "texCoord", None)
        return
    shape.uv = _mapped(reading, shape, uv)
    shape.uv_triangles = np.ascontiguousarray((corners[:, ::-1] if turned else corners).astype(np.int32))


def _mapped(reading: Reading, shape: Shape, uv: Floats) -> Floats:
    """Texture coordinates as the appearance's TextureTransform moves them: S R (uv + T + C) - C (ISO/IEC 19775-1)."""
    look = shape.material.node
    found = look.children("textureTransform") if look is not None else []
    if not found or found[0].type != "TextureTransform":
        return uv
    shift, center, size = (
        reading.vector(found[0], field, default)
        for field, default in (("translation", (0.0, 0.0)), ("center", (0.0, 0.0)), ("scale", (1.0, 1.0)))
    )
    angle = reading.number(found[0], "rotation", 0.0) * reading.angle
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    if not shift.any() and not angle and (size == 1).all():
        return uv
    shift, center = shift / reading.length, center / reading.length  # texture coordinates have no unit
    return ((uv + shift + center) @ turn.T) * size - center


def _normals(reading: Reading, geometry: Node, mesh: _Mesh, shape: Shape, turned: bool) -> None:
    """Normals per corner. Those of a skin (Humanoid.skinNormal says them) and of faces are left to the faces."""
    found = geometry.children("normal")
    if (
        not found
        or shape.points is None
        or not mesh.corners.size
        or not reading.flag(geometry, "normalPerVertex", True)
    ):
        return
    normals = reading.numbers(found[0], "vector", "MFVec3f", 3)
    index = reading.indices(geometry, "normalIndex").astype(np.int64)
    if len(index) == 0:
        index = mesh.index
    corners = index[mesh.corners] if len(index) > mesh.corners.max() else np.full((1, 3), -1)
    if corners.min() < 0 or corners.max() >= len(normals):
        what = f"{len(normals)} normals do not fit the faces: they are left out"
        reading.defect("normals", f"{reading.who(geometry)}: {what}", found[0])
        return
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    shape.normals = np.where(size > 0, normals / np.where(size > 0, size, 1.0), [0.0, 1.0, 0.0])
    wound = np.ascontiguousarray((corners[:, ::-1] if turned else corners).astype(np.int32))
    if not np.array_equal(wound, shape.triangles) or len(normals) != len(shape.points):
        shape.normal_triangles = wound


def _colors(reading: Reading, geometry: Node, mesh: _Mesh, shape: Shape, points: int) -> None:
    """Colours per point. A point that corners or faces colour differently gets their mean: one colour per point."""
    found = geometry.children("color")
    if not found or not mesh.corners.size:
        return
    width = 4 if found[0].type == "ColorRGBA" else 3
    colors = reading.numbers(found[0], "color", "MFColorRGBA" if width == 4 else "MFColor", width)[:, :3]
    index = reading.indices(geometry, "colorIndex").astype(np.int64)
    if reading.flag(geometry, "colorPerVertex", True):
        if len(index) == 0:
            index = mesh.index
        wanted = mesh.corners.reshape(-1)
    else:
        if len(index) == 0:
            index = np.arange(int(mesh.face.max()) + 1)
        wanted = np.repeat(mesh.face, 3)
    if wanted.max() >= len(index) or index[wanted].min() < 0 or index[wanted].max() >= len(colors):
        reading.broken(f"{reading.who(geometry)} colorIndex: expected indices that fit {len(colors)} colors", geometry)
        reading.mend(geometry, "colorIndex", np.zeros(0, np.int32))
        reading.mend(geometry, "color", None)
        return
    place = mesh.index[mesh.corners].reshape(-1)
    weight = np.bincount(place, minlength=points)
    sums = np.stack([np.bincount(place, c, minlength=points) for c in colors[index[wanted]].T], axis=1)
    shape.colors = np.where(weight[:, None] > 0, sums / np.maximum(weight, 1)[:, None], 0.8)


def material(reading: Reading, shape: Node) -> Material:
    """The look of a Shape node; shininess becomes roughness by the usual Blinn exponent relation."""
    appearances = shape.children("appearance")
    if not appearances:
        return Material()
    appearance = appearances[0]
    nodes = appearance.children("material")
    look = Material(name=appearance.name or (nodes[0].name if nodes else ""), node=appearance)
    look.picture = _picture(reading, appearance, nodes)
    if not nodes:
        return look
    node = nodes[0]
    look.emission = _color(reading, node, "emissiveColor", (0, 0, 0))
    look.opacity = 1 - min(max(reading.number(node, "transparency", 0.0), 0.0), 1.0)
    if node.type == "PhysicalMaterial":
        look.color = _color(reading, node, "baseColor", (1, 1, 1))
        look.roughness, look.metallic = reading.number(node, "roughness", 1.0), reading.number(node, "metallic", 1.0)
    elif node.type == "UnlitMaterial":
        look.color = look.emission = _color(reading, node, "emissiveColor", (1, 1, 1))
        look.roughness = 1.0
    else:
        look.color = _color(reading, node, "diffuseColor", (0.8, 0.8, 0.8))
        if "ambientIntensity" in node.fields:
            look.ambient = min(max(reading.number(node, "ambientIntensity", 0.2), 0.0), 1.0)
        if "specularColor" in node.fields:
            look.specular = _color(reading, node, "specularColor", (0, 0, 0))
        shininess = min(max(reading.number(node, "shininess", 0.2), 0.0), 1.0)
        look.roughness = float(np.sqrt(2 / (2 + 128 * shininess)))
    return look


def _picture(reading: Reading, appearance: Node, materials: list[Node]) -> Picture | None:
    """The first ImageTexture that colours the surface; nothing is opened."""
    if not any(_COLOURING.intersection(n.fields) for n in (appearance, *materials)):
        return None
    found = appearance.children("texture")
    found = [n for t in found for n in (t.children("texture")[:1] if t.type == "MultiTexture" else [t])]
    for material in materials:
        found += [n for field in ("diffuseTexture", "baseTexture", "emissiveTexture") for n in material.children(field)]
    node = next((n for n in found if n.type == "ImageTexture"), None)
    if node is None:
        return None
    if id(node) not in reading.pictures:
        urls = tuple(u for t in reading.texts(node, "url") if (u := t.strip()))
        repeat = (reading.flag(node, "repeatS", True), reading.flag(node, "repeatT", True))
        reading.pictures[id(node)] = Picture(node.name, urls=urls, folder=reading.folder, repeat=repeat, alpha="mask")
    picture = reading.pictures[id(node)]
    return picture if picture.urls else None


def _color(reading: Reading, node: Node, field: str, default: tuple[float, float, float]) -> tuple[float, float, float]:
    r, g, b = (min(max(v, 0.0), 1.0) for v in reading.vector(node, field, default).tolist())
    return (r, g, b)
