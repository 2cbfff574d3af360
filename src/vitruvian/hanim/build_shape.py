"""Typed `Shape`s to Shape nodes. One writer per file: arrays that shapes share become one node and USEs of it."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable

import numpy as np

from vitruvian.hanim.graph import Node, Use
from vitruvian.hanim.humanoid import Array, Material, Picture, Shape
from vitruvian.hanim.normals import turned
from vitruvian.hanim.polygons import closed, corner_loops

_NOT_NMTOKEN = re.compile(r"[^A-Za-z0-9_.-]")


def rgb(color: tuple[float, float, float]) -> Array:
    """A colour as a field value."""
    return np.array(color[:3], np.float64)


class Names:
    """DEF names of one file: legal in every encoding, each used once."""

    def __init__(self) -> None:
        self.taken: set[str] = set()

    def free(self, wanted: str) -> str:
        """`wanted`, made legal, with a number behind it when it is taken."""
        base = wanted
        if not (wanted.isidentifier() and wanted.isascii()):
            base = _NOT_NMTOKEN.sub("_", wanted) or "node"
            if not (base[0].isalpha() or base[0] == "_"):
                base = "_" + base
        name, n = base, 2
        while name in self.taken:
            name, n = f"{base}_{n}", n + 1
        self.taken.add(name)
        return name


class ShapeWriter:
    """Makes Shape nodes; `names` hands out DEFs, `physical` allows X3D 4.0's PhysicalMaterial, `address` gives
    the urls of a picture (default: its own, or one that holds it)."""

    def __init__(self, names: Names, physical: bool, address: Callable[[Picture], list[str]] | None = None):
        self.names, self.physical = names, physical
        self.address = address or own_address
        self.lost: set[str] = set()
        self._shared: dict[tuple[str, int], Node] = {}
        self._textures: dict[Picture, Node] = {}
        self._alive: list[object] = []  # shared arrays are known by identity: keep them from being freed

    def share(self, kind: str, array: object, wanted: str, make: Node) -> Node | Use:
        """`make` the first time that this array is written as this kind, a USE of that node from then on."""
        key = (kind, id(array))
        if key not in self._shared:
            make.name = self.names.free(wanted)
            self._shared[key] = make
            self._alive.append(array)
            return make
        node = self._shared[key]
        return Use(node.name, node, container=node.container, type=node.type)

    def shape(self, shape: Shape, prefix: str, coords: str, skin: Array | None = None) -> Node | None:
        """A Shape node, or None when it has no triangles. `skin` is the array that shapes without points index.

        `coords` is the DEF wanted for the Coordinate. The shape's transform is baked into its points.
        """
        if len(shape.triangles) == 0:
            return None
        if shape.transform is not None and shape.points is None:
            self.lost.add(f"the transform of skin shape {shape.name}")
        shape = turned(shape)
        points = skin if shape.points is None else shape.points
        if points is None:
            return None
        node = Node("Shape")
        if shape.name:
            node.name = self.names.free(prefix + shape.name.removeprefix(prefix))
        node.fields["appearance"] = self.appearance(shape.material, prefix)
        node.fields["geometry"] = self._faces(shape, points, prefix, coords)
        return node

    def _faces(self, shape: Shape, points: Array, prefix: str, coords: str) -> Node:
        faces = Node("IndexedFaceSet")
        fields = faces.fields
        fields["creaseAngle"] = float(min(shape.crease_angle, np.pi))
        if shape.material.double_sided:
            fields["solid"] = False
        loops = corner_loops(shape)
        fields["coordIndex"] = closed(shape.triangles, loops)
        if shape.uv is not None:
            uv_triangles = shape.triangles if shape.uv_triangles is None else shape.uv_triangles
            if not np.array_equal(uv_triangles, shape.triangles):
                fields["texCoordIndex"] = closed(uv_triangles, loops)
        if shape.colors is not None:
            fields["colorPerVertex"] = True
        if shape.normals is not None and shape.points is not None:
            fields["normalPerVertex"] = True
            if shape.normal_triangles is not None:
                fields["normalIndex"] = closed(shape.normal_triangles, loops)
            made = Node("Normal", fields={"vector": shape.normals})
            fields["normal"] = self.share("normal", shape.normals, f"{prefix}normals", made)
        fields["coord"] = self.share("coord", points, coords, Node("Coordinate", fields={"point": points}))
        if shape.uv is not None:
            made = Node("TextureCoordinate", fields={"point": shape.uv})
            fields["texCoord"] = self.share("uv", shape.uv, f"{prefix}uv", made)
        if shape.colors is not None:
            used = np.unique(shape.triangles)
            if len(used) < len(shape.colors):
                local = np.searchsorted(used, shape.triangles).astype(np.int32)
                fields["colorIndex"] = closed(local, loops)
                fields["color"] = Node("Color", fields={"color": np.clip(shape.colors[used], 0, 1)})
            else:
                made = Node("Color", fields={"color": np.clip(shape.colors, 0, 1)})
                fields["color"] = self.share("color", shape.colors, f"{prefix}colors", made)
        return faces

    def appearance(self, look: Material, prefix: str) -> Node | Use:
        """An Appearance, shared by shapes of the same Material object.

        Phong's exponent is the usual match of `roughness`; PhysicalMaterial is used for metals only, because every
        browser knows Material.
        """
        appearance = Node("Appearance")
        fields: dict[str, object] = {}
        if self.physical and look.metallic > 0:
            material = Node("PhysicalMaterial", fields=fields)
            fields["baseColor"] = rgb(look.color)
            fields["metallic"] = float(look.metallic)
            fields["roughness"] = float(look.roughness)
        else:
            material = Node("Material", fields=fields)
            fields["diffuseColor"] = rgb(look.color)
            rough = min(max(look.roughness, 0.124), 1.0)
            fields["shininess"] = float(min(max((2 / rough**2 - 2) / 128, 0.0), 1.0))
            fields["specularColor"] = (
                np.full(3, round(0.25 * (1 - rough), 4)) if look.specular is None else rgb(look.specular)
            )
            if look.ambient is not None:
                fields["ambientIntensity"] = float(look.ambient)
            if look.metallic > 0:
                self.lost.add("metallic look of materials")
        if any(look.emission):
            fields["emissiveColor"] = rgb(look.emission)
        if look.opacity < 1:
            fields["transparency"] = float(1 - look.opacity)
        appearance.fields["material"] = material
        if look.picture is not None:
            appearance.fields["texture"] = self._texture(look.picture, prefix)
        wanted = f"{prefix}{look.name.removeprefix(prefix) or 'look'}"
        return self.share("look", look, wanted, appearance)

    def _texture(self, picture: Picture, prefix: str) -> Node | Use:
        if picture in self._textures:
            node = self._textures[picture]
            return Use(node.name, node, type=node.type)
        fields: dict[str, object] = {"url": self.address(picture)}
        fields |= {f: False for f, on in zip(("repeatS", "repeatT"), picture.repeat) if not on}
        self._textures[picture] = Node("ImageTexture", self.names.free(f"{prefix}texture"), fields)
        return self._textures[picture]


def own_address(picture: Picture) -> list[str]:
    """The addresses of a picture's file, or one that holds its bytes."""
    if picture.urls:
        return list(picture.urls)
    mime = "image/png" if picture.data[:4] == b"\x89PNG" else "image/jpeg"
    return [f"data:{mime};base64,{base64.b64encode(picture.data).decode()}"]
