"""Displacement pictures: PNG with 16 bits a channel, grey (along the normal) or RGB (x, y, z), metres in text chunks.

Sources: PNG (ISO/IEC 15948), sections 5, 9, 11. Pillow does not write RGB of 16 bits.
"""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path

import numpy as np

from vitruvian.errors import FileError
from vitruvian.formats.atomic import atomic
from vitruvian.modeling.offsets import CELLS, SIDES, Relief

_SIGN = b"\x89PNG\r\n\x1a\n"
_SIDE = SIDES[-1]
_BYTES = 1 << 27
_TEXTS = (b"vitruvian:scale", b"vitruvian:offset", b"vitruvian:covered")


def write(relief: Relief, path: str | os.PathLike[str]) -> None:
    """Write a displacement picture; `vitruvian:scale` and `vitruvian:offset` in it say what texels are in metres,
    `vitruvian:covered`, in hexadecimal, which squares of the map the surface lies on."""
    height, width, channels = relief.texels.shape
    rows = relief.texels.astype(">u2").reshape(height, -1).view(np.uint8)
    up = rows.copy()
    up[1:] -= rows[:-1]  # filter 2: smooth pictures shrink
    body = zlib.compress(np.hstack([np.full((height, 1), 2, np.uint8), up]).tobytes(), 6)
    head = struct.pack(">IIBBBBB", width, height, 16, 2 if channels == 3 else 0, 0, 0, 0)
    values = (repr(float(relief.scale)), repr(float(relief.offset)), np.packbits(relief.covered).tobytes().hex())
    texts = [name + b"\0" + value.encode() for name, value in zip(_TEXTS, values, strict=True)]
    chunks = [(b"IHDR", head), *((b"tEXt", t) for t in texts), (b"IDAT", body), (b"IEND", b"")]
    with atomic(path) as temporary:
        temporary.write_bytes(_SIGN + b"".join(_chunk(kind, data) for kind, data in chunks))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def read(path: str | os.PathLike[str]) -> Relief:
    """A displacement picture written by `write`; FileError for other files."""
    file = Path(path)
    try:
        if file.stat().st_size > _BYTES:
            raise FileError(file, 0, "larger than any displacement picture")
        data = file.read_bytes()
    except OSError as error:
        raise FileError(file, 0, f"can't be read ({error.strerror})") from None
    if data[:8] != _SIGN:
        raise FileError(file, 0, "expected a PNG that `vitruvian offsets capture` wrote")
    place, head, body, texts = 8, b"", [], {}
    while place + 12 <= len(data):
        size, kind = struct.unpack_from(">I4s", data, place)
        content = data[place + 8 : place + 8 + size]
        if len(content) < size:
            raise FileError(file, 0, "ends in the middle of a chunk")
        if kind == b"IHDR":
            head = content
        elif kind == b"IDAT":
            body.append(content)
        elif kind == b"tEXt":
            name, _, text = content.partition(b"\0")
            texts[name] = text
        place += 12 + size
    if len(head) != 13:
        raise FileError(file, 0, "has no PNG header")
    width, height, bits, color, _, _, laced = struct.unpack(">IIBBBBB", head)
    if bits != 16 or color not in (0, 2) or laced:
        raise FileError(file, 0, "expected 16 bits a channel, grey or RGB, not interlaced")
    if not (2 <= width <= _SIDE and 2 <= height <= _SIDE):
        raise FileError(file, 0, f"expected 2..{_SIDE} texels a side, found {width} x {height}")
    try:
        scale, offset = (float(texts[n]) for n in _TEXTS[:2])
        bits = np.frombuffer(bytes.fromhex(texts[_TEXTS[2]].decode("latin-1")), np.uint8)
        covered = np.unpackbits(bits).reshape(CELLS, CELLS).astype(np.bool_)
    except (KeyError, ValueError):
        found = "the text that `vitruvian offsets capture` writes: its metres and its UVs are unknown"
        raise FileError(file, 0, f"lacks {found}; capture it again") from None
    if not (np.isfinite(scale) and np.isfinite(offset) and abs(scale) * 65535 + abs(offset) < 10):
        raise FileError(file, 0, f"scale {scale:g} and offset {offset:g} are no metres of a body")
    channels = 3 if color == 2 else 1
    long = 1 + 2 * channels * width
    unpack = zlib.decompressobj()
    try:
        raw = unpack.decompress(b"".join(body), long * height)
    except zlib.error:
        raise FileError(file, 0, "its picture data are damaged") from None
    if len(raw) != long * height:
        raise FileError(file, 0, "has less picture data than its header says")
    lines = np.frombuffer(raw, np.uint8).reshape(height, long)
    if not np.isin(lines[:, 0], (0, 2)).all():
        raise FileError(file, 0, "was written by another program (filters other than none and up); capture it again")
    out = np.empty((height, long - 1), np.uint8)
    above = np.zeros(long - 1, np.uint8)
    for k, line in enumerate(lines):
        above = out[k] = line[1:] + above if line[0] == 2 else line[1:]
    texels = out.view(">u2").reshape(height, width, channels).astype(np.uint16)
    return Relief(texels, scale, offset, covered)
