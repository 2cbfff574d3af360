"""Pictures on surfaces: their bytes, checked, and the addresses under which a new file finds them.

A picture is a PNG or JPEG inside a file, or named by one; then it is opened only from that file's folder and below, and
never over a network. Nothing is decoded: bytes go from file to file as they are. Sources: PNG (ISO/IEC 15948), section
11.2.2; JPEG (ISO/IEC 10918-1), annex B; data URIs (RFC 2397).
"""

from __future__ import annotations

import base64
import binascii
import os
import re
from pathlib import Path
from urllib.parse import unquote, unquote_to_bytes

from vitruvian.formats.atomic import atomic
from vitruvian.hanim.humanoid import Humanoid, Picture

MAX_BYTES = 1 << 25  # of one picture
MAX_ALL = 1 << 28  # of all pictures of a file
MAX_SIDE = 1 << 14  # pixels
_PLAIN = re.compile(r"[^A-Za-z0-9_-]+")
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # JPEG segments that say the size


def kind(data: bytes) -> str | None:
    """ "image/png" or "image/jpeg" of a picture whose sides and bytes are within bounds, None of everything else."""
    if len(data) > MAX_BYTES:
        return None
    size = size_of(data)
    if size is None or not (0 < size[0] <= MAX_SIDE and 0 < size[1] <= MAX_SIDE):
        return None
    return "image/png" if data[:1] == b"\x89" else "image/jpeg"


def size_of(data: bytes) -> tuple[int, int] | None:
    """Width and height as the header of a PNG or JPEG says them, None of everything else."""
    if data[:8] == b"\x89PNG\r\n\x1a\n" and data[12:16] == b"IHDR" and len(data) > 33:
        return int.from_bytes(data[16:20]), int.from_bytes(data[20:24])
    if data[:2] != b"\xff\xd8":
        return None
    place = 2
    while place + 9 <= len(data) and data[place] == 0xFF:
        mark = data[place + 1]
        if mark in _FRAMES:
            return int.from_bytes(data[place + 7 : place + 9]), int.from_bytes(data[place + 5 : place + 7])
        place += 2 if mark in (0x01, *range(0xD0, 0xD9)) else 2 + max(int.from_bytes(data[place + 2 : place + 4]), 2)
    return None


def transparent(data: bytes) -> bool:
    """Whether a picture can hold transparent places: a PNG with an alpha channel or a transparent colour."""
    return data[:4] == b"\x89PNG" and (data[25] in (4, 6) or b"tRNS" in data[:4096])


def content(picture: Picture) -> tuple[bytes, str] | None:
    """Bytes and MIME type of a picture: its own, or those that the first address at hand leads to; None without any."""
    if picture.data:
        found = kind(picture.data)
        return None if found is None else (picture.data, found)
    for url in picture.urls:
        data = _embedded(url) if url[:5].lower() == "data:" else _beside(url, picture.folder)
        found = kind(data) if data else None
        if data and found:
            return data, found
    return None


def _embedded(url: str) -> bytes | None:
    head, comma, body = url[5:].partition(",")
    if not comma or len(body) > 2 * MAX_BYTES:
        return None
    if not head.lower().endswith(";base64"):
        return unquote_to_bytes(body)
    try:
        return base64.b64decode(unquote(body), validate=False)
    except (binascii.Error, ValueError):
        return None


def _beside(url: str, folder: str) -> bytes | None:
    """A file in the folder or below it, links out of it not followed."""
    name = unquote(url.partition("#")[0])
    if not folder or not name or "\0" in name or "\\" in name or "://" in name or os.path.isabs(name):
        return None
    try:
        home = Path(folder).resolve()
        target = (home / name).resolve()
        if not target.is_relative_to(home) or not target.is_file() or target.stat().st_size > MAX_BYTES:
            return None
        return target.read_bytes()
    except (OSError, ValueError, RuntimeError):
        return None


class Addresses:
    """Where the pictures of one new file go, and what `url` it gives them.

    A file in the folder that the picture was named from keeps its addresses. Else the picture comes along: inside the
    file (`beside` False), or as a file of its own beside it, written by `write`. What is not at hand keeps its address
    and is in `missing`.
    """

    def __init__(self, path: str | os.PathLike[str], *, beside: bool):
        self.path, self.beside = Path(path), beside
        self.missing: list[str] = []
        self._given: dict[Picture, list[str]] = {}
        self._files: dict[str, bytes] = {}

    def __call__(self, picture: Picture) -> list[str]:
        if picture not in self._given:
            self._given[picture] = self._place(picture)
        return self._given[picture]

    def _place(self, picture: Picture) -> list[str]:
        here = picture.folder and os.path.realpath(picture.folder) == os.path.realpath(self.path.parent)
        inside = any(u[:5].lower() == "data:" for u in picture.urls)
        if picture.urls and (here or inside) and not (inside and self.beside):
            return list(picture.urls)
        found = content(picture)
        if found is None:
            self.miss(picture)
            return list(picture.urls)
        data, mime = found
        return [self.file(picture.name, data, mime) if self.beside else uri(data, mime)]

    def miss(self, picture: Picture) -> None:
        """Count a picture that is not at hand."""
        name = " ".join((picture.urls[0] if picture.urls else picture.name or "picture")[:80].split())
        if name not in self.missing:
            self.missing.append(name)

    def file(self, name: str, data: bytes, mime: str) -> str:
        """The name of a file beside `path` that holds these bytes."""
        word = _PLAIN.sub("-", Path(name).stem).strip("-")[:40] or "picture"
        base = f"{self.path.name.partition('.')[0]}-{word}"
        end = ".png" if mime == "image/png" else ".jpg"
        out, n = base + end, 2
        while out in self._files and self._files[out] != data:
            out, n = f"{base}-{n}{end}", n + 1
        self._files[out] = data
        return out

    def write(self, folder: Path | None = None) -> None:
        """Write the files, each whole or not at all, into `folder` (default: that of `path`)."""
        for name, data in self._files.items():
            with atomic((folder or self.path.parent) / name) as temporary:
                temporary.write_bytes(data)

    def lost(self) -> list[str]:
        """A sentence about pictures that are not at hand."""
        if not self.missing:
            return []
        some = ", ".join(self.missing[:4]) + (", ..." if len(self.missing) > 4 else "")
        return [f"{len(self.missing)} pictures that are not beside their file, or no PNG or JPEG: {some}"]


def staying(humanoids: list[Humanoid], folder: str | os.PathLike[str]) -> list[str]:
    """A sentence about pictures that a scene names beside itself and that do not come along into another folder."""
    shapes = [s for h in humanoids for s in [*h.skin, *(s for g in h.segments() for s in g.shapes)]]
    found = {p.urls[0]: p for s in shapes if (p := s.material.picture) is not None and p.urls and p.folder}
    names = [
        u
        for u, p in found.items()
        if ":" not in u and not os.path.isabs(u) and os.path.realpath(p.folder) != os.path.realpath(folder)
    ]
    if not names:
        return []
    some = ", ".join(n[:60] for n in names[:4]) + (", ..." if len(names) > 4 else "")
    return [f"{len(names)} pictures stay beside the file that was read; copy them: {some}"]


def uri(data: bytes, mime: str) -> str:
    """A picture as an address that holds it."""
    return f"data:{mime};base64,{base64.b64encode(data).decode()}"
