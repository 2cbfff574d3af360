"""DefBody and DefBodyTex: contour surfaces as prototype instances, read and written.

Fields as published; repaired: `name` has a type, `Texscale` is 1 1 (0 0 would collapse the map), and there are texture
coordinates (without them a texture swims as the surface deforms). Added: colours per point, `closed`, `ramp`, `diversion`,
`mitre`, `recentre`, `spread`, `bulge`, `tilt`, and `bands`: the contours from which on faces show a cloth of another name
and shininess. `TexCoords` are those of the points; where a border of the map runs between points, more of them follow, and
`TexCoordsIndex` says which the corners of the faces have. Points are in the frame of the surface's joint, whose axes are
the world's: `translation` is the joint's centre.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from vitruvian.hanim.graph import Literal, Node, Proto, ProtoField
from vitruvian.hanim.humanoid import RAMPS, Array, ContourSurface, Joint, Material, Picture
from vitruvian.hanim.reading import Reading

TYPES = ("DefBody", "DefBodyTex")
_FRAME = 1e-6  # metres between the surface's frame and its joint's
# access, type, name, default as VRML text
_INTERFACE = (
    ("inputOutput", "SFString", "name", '"Def"'),
    ("inputOutput", "SFVec3f", "translation", "0 0 0"),
    ("inputOutput", "SFFloat", "ambientIntensity", "0.2"),
    ("inputOutput", "SFColor", "diffuseColor", "0.8 0.8 0.8"),
    ("inputOutput", "SFColor", "emissiveColor", "0 0 0"),
    ("inputOutput", "SFFloat", "shininess", "0.2"),
    ("inputOutput", "SFColor", "specularColor", "0 0 0"),
    ("inputOutput", "SFFloat", "transparency", "0"),
    ("inputOutput", "MFVec3f", "Points", "[ ]"),
    ("initializeOnly", "MFInt32", "PointsIndex", "[ ]"),
    ("inputOutput", "SFInt32", "NbContours", "0"),
    ("inputOutput", "SFInt32", "NbPoints", "0"),
    ("inputOutput", "SFInt32", "ExtrContour", "0"),
    ("inputOutput", "SFInt32", "FixedUpperDef", "0"),
    ("inputOutput", "SFInt32", "UpperDef", "0"),
    ("inputOutput", "SFInt32", "LowerDef", "0"),
    ("inputOutput", "SFString", "ramp", '"linear"'),
    ("inputOutput", "SFFloat", "diversion", "0"),
    ("inputOutput", "SFFloat", "mitre", "0"),
    ("inputOutput", "SFBool", "recentre", "FALSE"),
    ("inputOutput", "SFBool", "spread", "FALSE"),
    ("inputOutput", "SFFloat", "bulge", "0"),
    ("initializeOnly", "SFFloat", "tilt", "0"),
    ("inputOutput", "SFBool", "closed", "TRUE"),
)
_PICTURE = (
    ("inputOutput", "MFString", "tex", "[ ]"),
    ("inputOutput", "SFVec2f", "Textranslation", "0 0"),
    ("inputOutput", "SFFloat", "Texrotation", "0"),
    ("inputOutput", "SFVec2f", "Texscale", "1 1"),
    ("inputOutput", "SFVec2f", "Texcenter", "0 0"),
)
_TEXTURE = (
    *_PICTURE,
    ("inputOutput", "MFVec2f", "TexCoords", "[ ]"),
    ("initializeOnly", "MFInt32", "TexCoordsIndex", "[ ]"),
)
_COLORS = (("inputOutput", "MFColor", "Colors", "[ ]"),)
_BANDS = (
    ("initializeOnly", "MFInt32", "bands", "[ ]"),
    ("initializeOnly", "MFString", "bandNames", "[ ]"),
    ("initializeOnly", "MFFloat", "bandShininess", "[ ]"),
)
CREASE = 1.74533


def prototype(textured: bool, colored: bool) -> Proto:
    """The declaration: DefBodyTex with a texture, DefBody without; `colored` with a colour per point."""
    rows = (*_INTERFACE, *_BANDS, *(_TEXTURE if textured else ()), *(_COLORS if colored else ()))
    fields = [ProtoField(access, kind, name, Literal(default, "vrml")) for access, kind, name, default in rows]
    look = ("ambientIntensity", "diffuseColor", "specularColor", "emissiveColor", "shininess", "transparency")
    appearance = Node("Appearance", fields={"material": Node("Material", connects=[(n, n) for n in look])})
    if textured:
        appearance.fields["texture"] = Node("ImageTexture", connects=[("url", "tex")])
        pairs = [(n, f"Tex{n}") for n in ("translation", "rotation", "scale", "center")]
        appearance.fields["textureTransform"] = Node("TextureTransform", connects=pairs)
    geometry = Node("IndexedFaceSet", connects=[("coordIndex", "PointsIndex")])
    if textured:
        geometry.connects.append(("texCoordIndex", "TexCoordsIndex"))
    geometry.fields |= {"solid": False, "creaseAngle": CREASE}
    geometry.fields["coord"] = Node("Coordinate", connects=[("point", "Points")])
    if textured:
        geometry.fields["texCoord"] = Node("TextureCoordinate", connects=[("point", "TexCoords")])
    if colored:
        geometry.fields["color"] = Node("Color", connects=[("color", "Colors")])
    shape = Node("Shape", fields={"appearance": appearance, "geometry": geometry})
    body = Node("Transform", connects=[("translation", "translation")], fields={"children": [shape]})
    return Proto(TYPES[textured], fields, [body])


def corners(points: np.ndarray, closed: bool) -> np.ndarray:
    """(C-1,F,4,...) of the corners of faces between contours, what points (C,P,...) have: upper left, upper right, lower
    right, lower left."""
    right = np.roll(points, -1, axis=1) if closed else points[:, 1:]
    left = points if closed else points[:, :-1]
    return np.stack([left[:-1], right[:-1], right[1:], left[1:]], axis=2)


def halved(quads: np.ndarray) -> np.ndarray:
    """(2F,3) triangles of faces (...,4) between contours, from the upper left corner on: one of each, then the others."""
    flat = quads.reshape(-1, 4)
    return np.concatenate([flat[:, [0, 2, 1]], flat[:, [0, 3, 2]]]).astype(np.int32)


def faces(count: int, each: int, closed: bool) -> np.ndarray:
    """coordIndex of the grid of `count` contours of `each` points: quadrangles, the outside out."""
    return _listed(corners(np.arange(count * each).reshape(count, each), closed))


def _listed(numbers: np.ndarray) -> np.ndarray:
    """Numbers of the corners (C-1,F,4) of quadrangles, as an IndexedFaceSet lists them."""
    return closed_faces(numbers[..., [0, 3, 2, 1]])


def closed_faces(numbers: np.ndarray) -> np.ndarray:
    """Faces (...,n) of n corners as an IndexedFaceSet lists them: -1 after each."""
    return np.concatenate([numbers, np.full_like(numbers[..., :1], -1)], axis=-1).reshape(-1).astype(np.int32)


def listed_corners(index: np.ndarray, count: int) -> np.ndarray:
    """(C-1,F,4) what an IndexedFaceSet lists (`index`) for the corners of faces between `count` contours: quadrangles, or
    the triangles that they are cut into."""
    if len(index) % 5 == 0 and (index[4::5] < 0).all() and not (index.reshape(-1, 5)[:, :4] < 0).any():
        return index.reshape(-1, 5)[:, [0, 3, 2, 1]].reshape(count - 1, -1, 4)
    one, other = np.split(index.reshape(-1, 4), 2)
    return np.concatenate([one[:, [0, 2, 1]], other[:, 1:2]], axis=1).reshape(count - 1, -1, 4)


def mapped(surface: ContourSurface) -> tuple[Array, np.ndarray]:
    """(U,2) texture coordinates of a surface that has some, those of its points first, and (C-1,F,4) int32: which of them
    the corners of its faces have."""
    assert surface.uv is not None
    own = np.asarray(surface.uv, np.float64)
    count, each = own.shape[:2]
    index = corners(np.arange(count * each).reshape(count, each), surface.closed)
    flat = own.reshape(-1, 2)
    if surface.uv_corners is None:
        return flat, index.astype(np.int32)
    other = (surface.uv_corners != flat[index]).any(axis=-1)
    more, number = np.unique(surface.uv_corners[other], axis=0, return_inverse=True)
    index = index.copy()
    index[other] = len(flat) + number.reshape(-1)
    return np.concatenate([flat, more]), index.astype(np.int32)


def defbody_node(
    surface: ContourSurface,
    center: Array,
    name: str,
    textured: bool,
    colored: bool,
    address: Callable[[Picture], list[str]],
) -> Node:
    """The instance of a surface whose joint has its centre at `center`; `address` gives the urls of its picture."""
    count, each = surface.points.shape[:2]
    look = surface.material
    white = (1.0, 1.0, 1.0)
    fields: dict[str, object] = {
        "name": surface.name,
        "translation": np.asarray(center, np.float64),
        "diffuseColor": np.array(white if colored else look.color[:3], np.float64),
        "emissiveColor": np.array(look.emission, np.float64),
        "shininess": _shininess(look),
        "transparency": float(1 - look.opacity),
        "Points": (surface.points - center).reshape(-1, 3),
        "PointsIndex": faces(count, each, surface.closed),
        "NbContours": count,
        "NbPoints": each,
        "ExtrContour": surface.extra,
        "FixedUpperDef": surface.fixed_upper,
        "UpperDef": surface.upper,
        "LowerDef": surface.lower,
        "ramp": surface.ramp,
        "diversion": float(surface.diversion),
        "mitre": float(surface.mitre),
        "recentre": surface.recentre,
        "spread": surface.spread,
        "bulge": float(surface.bulge),
        "tilt": float(surface.tilt),
        "closed": surface.closed,
    }
    if look.ambient is not None:
        fields["ambientIntensity"] = float(look.ambient)
    if look.specular is not None:
        fields["specularColor"] = np.array(look.specular, np.float64)
    bands = surface.bands or (((0, look),) if look.name not in ("", surface.name) else ())
    if bands:
        fields["bands"] = np.array([k for k, _ in bands], np.int32)
        fields["bandNames"] = [m.name for _, m in bands]
        fields["bandShininess"] = np.array([_shininess(m) for _, m in bands])
    if textured and surface.uv is not None:
        fields["TexCoords"], index = mapped(surface)
        if surface.uv_corners is not None:
            fields["TexCoordsIndex"] = _listed(index)
    if textured and isinstance(surface.node, Node):  # the picture that came with it, and where it lies
        fields |= {f: v for _, _, f, _ in _PICTURE if (v := surface.node.fields.get(f)) is not None}
    elif textured and look.picture is not None:
        fields["tex"] = address(look.picture)
    if colored:
        own = surface.colors if surface.colors is not None else np.broadcast_to(look.color[:3], (count, each, 3))
        fields["Colors"] = np.clip(own.reshape(-1, 3), 0, 1)
    return Node(TYPES[textured], name, fields, instance=True)


def _shininess(look: Material) -> float:
    return float(np.clip((2 / max(look.roughness, 0.124) ** 2 - 2) / 128, 0, 1))


def _roughness(shininess: float) -> float:
    return float(np.sqrt(2 / (128 * shininess + 2)))


def is_defbody(reading: Reading, node: Node) -> bool:
    """Whether a node is a contour surface: by its prototype's name, or by fields that only such a prototype has."""
    proto = reading.protos.get(node.type)
    if proto is not None:
        return {"NbContours", "NbPoints", "Points"} <= {f.name for f in proto.interface}
    return node.type in TYPES


def contour_surface(reading: Reading, node: Node, joint: Joint) -> ContourSurface | None:
    """A surface from its instance, points in humanoid space; None where it can't be used, which is said."""
    points = reading.numbers(node, "Points", "MFVec3f", 3)
    whole = {f: int(reading.indices(node, f)[0]) if len(reading.indices(node, f)) else 0
             for f in ("NbContours", "NbPoints", "ExtrContour", "FixedUpperDef", "UpperDef", "LowerDef")}  # fmt: skip
    count, each = whole["NbContours"], whole["NbPoints"]
    who = reading.who(node)
    if count < 1 or each < 1 or count * each != len(points):
        reading.broken(f"{who}: expected NbContours x NbPoints = {count} x {each} Points, found {len(points)}", node)
        return None
    for field in ("ExtrContour", "FixedUpperDef", "UpperDef", "LowerDef"):
        if not 0 <= whole[field] <= count:
            reading.broken(f"{who} {field}: expected 0 to {count}, the number of contours, found {whole[field]}", node)
            whole[field] = min(max(whole[field], 0), count)
    ramp = reading.text(node, "ramp") or RAMPS[0]
    if ramp not in RAMPS:
        reading.broken(f"{who} ramp: expected {' or '.join(RAMPS)}, found {ramp!r}", node)
        ramp = RAMPS[0]
    place = reading.vector(node, "translation", (0.0, 0.0, 0.0))
    if np.abs(place - joint.center).max() > _FRAME:
        here, there = (" ".join(f"{v:g}" for v in p) for p in (place, joint.center))
        reading.defect("frame", f"{who}: its translation {here} is not the centre {there} of joint {joint.name}", node)
    closed = _flag(reading, node, "closed", _closed(reading, node, count, each))
    uv, uv_corners = _texture(reading, node, count, each, closed)
    colors = reading.numbers(node, "Colors", "MFColor", 3)
    diffuse = reading.vector(node, "diffuseColor", (0.8, 0.8, 0.8))
    value = lambda field: float(np.clip(next(iter(reading.numbers(node, field)), 0.0), 0, 1))  # noqa: E731
    color = lambda field: tuple(np.clip(reading.vector(node, field, (0.0, 0.0, 0.0)), 0, 1).tolist())  # noqa: E731
    look = Material(
        name=reading.text(node, "name"), color=(float(diffuse[0]), float(diffuse[1]), float(diffuse[2])),
        roughness=_roughness(value("shininess")), opacity=1 - value("transparency"), double_sided=True,
        emission=color("emissiveColor"), ambient=value("ambientIntensity") if "ambientIntensity" in node.fields else None,
        specular=color("specularColor") if "specularColor" in node.fields else None,
    )  # fmt: skip
    look.picture = _picture(reading, node) if uv is not None else None
    bands = _bands(reading, node, count, look)
    return ContourSurface(
        name=reading.text(node, "name") or node.name or "contours",
        points=(points + place).reshape(count, each, 3),
        closed=closed,
        fixed_upper=whole["FixedUpperDef"], upper=whole["UpperDef"], lower=whole["LowerDef"],
        extra=whole["ExtrContour"], ramp=ramp, diversion=value("diversion"), mitre=value("mitre"),
        recentre=_flag(reading, node, "recentre", False), spread=_flag(reading, node, "spread", False),
        bulge=value("bulge"), tilt=value("tilt"),
        uv=uv, uv_corners=uv_corners,
        colors=colors.reshape(count, each, 3) if len(colors) == len(points) else None,
        material=bands[0][1] if len(bands) == 1 else look, bands=bands if len(bands) > 1 else (), node=node,
    )  # fmt: skip


def _texture(reading: Reading, node: Node, count: int, each: int, closed: bool) -> tuple[Array | None, Array | None]:
    """(C,P,2) texture coordinates of a surface's points and (C-1,F,4,2) of the corners of its faces; None where there
    are none."""
    texture = reading.numbers(node, "TexCoords", "MFVec2f", 2)
    if len(texture) < count * each:
        return None, None
    index = reading.indices(node, "TexCoordsIndex").astype(np.int64)
    own = texture[: count * each].reshape(count, each, 2)
    if not len(index):
        return (own, None) if len(texture) == count * each else (None, None)
    quads = corners(np.arange(count * each).reshape(count, each), closed)
    listed = reading.indices(node, "PointsIndex")
    known = any(np.array_equal(listed, f) for f in (_listed(quads), closed_faces(halved(quads))))
    if not known or not np.array_equal(index < 0, listed < 0) or int(index.max()) >= len(texture):
        reading.broken(
            f"{reading.who(node)} TexCoordsIndex: expected numbers of {len(texture)} TexCoords for the corners of "
            f"{quads.size // 4} quadrangles between contours, as PointsIndex lists them, found others",
            node,
        )
        return own, None
    return own, texture[listed_corners(index, count)]


def _picture(reading: Reading, node: Node) -> Picture | None:
    """The picture that an instance names; nothing is opened."""
    urls = tuple(u for t in reading.texts(node, "tex") if (u := t.strip()))
    return Picture(urls=urls, folder=reading.folder, alpha="mask") if urls else None


def _bands(reading: Reading, node: Node, count: int, look: Material) -> tuple[tuple[int, Material], ...]:
    """The bands of a surface; none where their numbers do not fit, which is said."""
    starts = reading.indices(node, "bands").tolist()
    names = reading.texts(node, "bandNames")
    shine = np.clip(reading.numbers(node, "bandShininess"), 0, 1).reshape(-1).tolist()
    rising = all(a < b for a, b in zip(starts, starts[1:])) and (
        not starts or (starts[0] == 0 and starts[-1] < count - 1)
    )
    if not (rising and len(starts) == len(names) == len(shine)):
        reading.broken(
            f"{reading.who(node)} bands: expected rising contours from 0 on, a name and a shininess for each, "
            f"found {starts[:6]} with {len(names)} names and {len(shine)} numbers",
            node,
        )
        return ()
    return tuple(
        (k, replace(look, name=n, roughness=_roughness(s))) for k, n, s in zip(starts, names, shine, strict=True)
    )


def _flag(reading: Reading, node: Node, field: str, default: bool) -> bool:
    raw = reading.raw(node, field)
    if raw is None:
        return default
    return raw.text.strip().lower() == "true" if isinstance(raw, Literal) else bool(raw)


def _closed(reading: Reading, node: Node, count: int, each: int) -> bool:
    """Whether faces join the last point of a contour to its first."""
    index = reading.indices(node, "PointsIndex")
    if not len(index) or count < 2 or each < 3:
        return True
    faces_ = np.split(index, np.flatnonzero(index < 0))
    both = {0, each - 1}
    return any(
        both <= set((f[f >= 0] % each).tolist()) and len(set((f[f >= 0] % each).tolist())) == 2
        for f in faces_[: 4 * each]
    )
