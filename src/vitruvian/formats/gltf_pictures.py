"""Base colour pictures of a glTF file: their bytes, which texture coordinates they use, and how these are moved.

Sources: glTF 2.0, sections 3.8 (texture data) and 3.9; KHR_texture_transform (Khronos).
"""

from __future__ import annotations

import base64
import binascii
from typing import Any

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.errors import FileError, warn
from vitruvian.formats.gltf_file import GltfFile
from vitruvian.formats.pictures import MAX_ALL, kind
from vitruvian.hanim.humanoid import Picture

SETS = 4  # TEXCOORD_0 to TEXCOORD_3
_CLAMP = 33071


def base(file: GltfFile, entry: dict[str, Any], where: str) -> Picture | None:
    """The picture of a material's base colour, None when it has none or one that can't be read (with a warning)."""
    given = file.object(file.object(entry, "pbrMetallicRoughness"), "baseColorTexture")
    if not given:
        return None
    textures = file.items("textures")
    texture = textures[file.integer(given, "index", f"{where} baseColorTexture", len(textures))]
    images = file.items("images")
    if texture.get("source") is None:
        _left(file, "in a format that only an extension knows")
        return None
    number = file.integer(texture, "source", "texture", len(images))
    if number not in file.pictures:
        file.pictures[number] = _bytes(file, images[number], number)
    data = file.pictures[number]
    if not data:
        return None
    samplers = file.items("samplers")
    wrap = {}
    if texture.get("sampler") is not None:
        wrap = samplers[file.integer(texture, "sampler", "texture", len(samplers))]
    repeat = (wrap.get("wrapS") != _CLAMP, wrap.get("wrapT") != _CLAMP)
    alpha = {"MASK": "mask", "BLEND": "blend"}.get(str(entry.get("alphaMode")), "")
    return Picture(file.text(images[number], "name"), data, repeat=repeat, alpha=alpha)


def _bytes(file: GltfFile, image: dict[str, Any], number: int) -> bytes:
    """What an image holds, b"" when it is our own writer's white pixel or can't be used."""
    where = f"image {number}"
    if image.get("bufferView") is not None:
        data = file.view_bytes(image["bufferView"], where)
    else:
        address = image.get("uri")
        if not isinstance(address, str):
            file.bad(f"{where}: expected a bufferView or a uri, found neither")
        if address[:5] == "data:":
            try:
                data = base64.b64decode(address.partition(",")[2], validate=False)
            except (binascii.Error, ValueError):
                data = b""
        else:
            try:
                data = file.beside(address, where)
            except FileError as error:  # a picture that is gone is no reason to refuse the figure
                warn(str(error))
                return b""
    if file.text(image, "name") == "white" and len(data) < 100:
        return b""
    if kind(data) is None:
        _left(file, "no PNG or JPEG, or too large")
        return b""
    file.pictured += len(data)
    if file.pictured > MAX_ALL:
        file.bad(f"images: expected at most {MAX_ALL >> 20} MB of pictures")
    return data


def _left(file: GltfFile, why: str) -> None:
    warn(f"{file.path}: a picture is {why}; the surface keeps its base colour")


def mapping(file: GltfFile, primitive: dict[str, Any], where: str) -> tuple[int, tuple[float, ...]]:
    """Which set of texture coordinates the base colour uses, and offset, rotation and scale that move them ((): none)."""
    if primitive.get("material") is None:
        return 0, ()
    materials = file.items("materials")
    entry = materials[file.integer(primitive, "material", where, len(materials))]
    given = file.object(file.object(entry, "pbrMetallicRoughness"), "baseColorTexture")
    moved = file.object(file.object(given, "extensions"), "KHR_texture_transform")
    coordinates = moved if moved.get("texCoord") is not None else given
    number = file.integer(coordinates, "texCoord", f"{where} baseColorTexture", SETS, 0)
    if not moved:
        return number, ()
    offset = file.numbers(moved, "offset", where, (0.0, 0.0))
    turn = file.numbers({"rotation": [moved.get("rotation", 0.0)]}, "rotation", where, (0.0,))
    return number, (*offset, *turn, *file.numbers(moved, "scale", where, (1.0, 1.0)))


def moved(uv: Floats, by: tuple[float, ...]) -> Floats:
    """Texture coordinates (n,2) under KHR_texture_transform: T R S."""
    if not by:
        return uv
    x, y, angle, sx, sy = by
    cosine, sine = np.cos(angle), np.sin(angle)
    u, v = uv[:, 0] * sx, uv[:, 1] * sy
    return np.stack([cosine * u + sine * v + x, -sine * u + cosine * v + y], -1)


def warn_pictures(file: GltfFile, *, mesh: bool = False) -> None:
    """One warning about pictures that are not read: other than base colours, and all of a surface without a figure."""
    names = [file.text(i, "name") for i in file.items("images")]
    used = set() if mesh else set(file.pictures)
    left = [n for k, n in enumerate(names) if k not in used and n != "white"]
    if left:
        kept = "a mesh keeps its colours" if mesh else "base colours are read"
        warn(f"{file.path}: {len(left)} pictures (bumps, shine and the like) were left out; {kept}")
