"""What a scene file says it is, in its first bytes, against what its name says (rule F01)."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

from vitruvian.formats.source import LIMITS, read_bytes
from vitruvian.hanim.doctor import Finding, finding
from vitruvian.hanim.graph import Comment, Scene

_BY_NAME = {".x3d": "x3d", ".x3dv": "x3dv", ".wrl": "wrl", ".wrz": "wrl"}
_CALLED = {"x3d": "X3D XML", "x3dv": "Classic X3D", "wrl": "VRML97", "json": "X3D JSON"}
_READERS = {"x3d": ("x3d", "parse_x3d"), "x3dv": ("vrml", "parse_vrml"), "wrl": ("vrml", "parse_vrml")}
HEADERS = {"x3dv": b"#X3D V3.3 utf8", "wrl": b"#VRML V2.0 utf8"}
_RIGHT = re.compile(rb"#(?:VRML V2\.0 utf8|X3D V[0-9]+\.[0-9]+ utf8)[ \t\r\n]")
_OLD = re.compile(rb"#VRML V1\.")


def content(data: bytes) -> str:
    """The encoding that the first bytes show: x3d, x3dv, wrl, json; "" when they show none."""
    start = data[:400].lstrip(b"\xef\xbb\xbf \t\r\n")
    for mark, encoding in ((b"#VRML", "wrl"), (b"#X3D", "x3dv"), (b"<", "x3d"), (b"{", "json")):
        if start[: len(mark)].upper() == mark.upper():
            return encoding
    return ""


def recovered(path: Path, extension: str) -> tuple[Scene, list[Finding]] | None:
    """The scene of a file whose header is missing, wrong or that of another encoding, with the finding.

    None when the header is right, or when nobody can tell what the file is. Raises `FileError` as the readers do.
    """
    expected = _BY_NAME.get(extension)
    if expected is None:
        return None
    data = read_bytes(path, LIMITS)
    found = content(data)
    if _OLD.match(data):
        return None  # VRML 1.0 is another language
    if found and found != expected and found in _READERS:
        scene = _parse(found, data, path)
        message = f"the content is {_CALLED[found]} though the name says {_CALLED[expected]}: loaders choose by it"
        return scene, [finding("F01", "file", 1, message, f"name it .{found}")]
    if expected == "x3d" or _RIGHT.match(data.lstrip(b"\xef\xbb\xbf")) or found == "json":
        return None
    first, rest = _without_header(data)
    scene = _parse(expected, HEADERS[expected] + (b"" if first else b" ") + rest, path)
    what = f"the header {first[:40]!r} is none" if first else "there is no header"
    fix = f"write {HEADERS[expected].decode()}"
    return scene, [finding("F01", "file", 1, f"{what}, expected {HEADERS[expected].decode()}", fix)]


def _without_header(data: bytes) -> tuple[str, bytes]:
    """The first line when it tries to be a header, and what follows; line numbers stay as they are."""
    data = data.lstrip(b"\xef\xbb\xbf")
    line, end, rest = data.partition(b"\n")
    if re.match(rb"\s*#\s*(?:VRML|X3D)", line, re.IGNORECASE):
        return line.decode("utf-8", "replace").strip(), end + rest
    return "", b"\n" + data


def _parse(encoding: str, data: bytes, path: Path) -> Scene:
    module, function = _READERS[encoding]
    scene: Scene = getattr(import_module(f"vitruvian.formats.{module}"), function)(data, path)
    scene.header_comments = [c for c in scene.header_comments if isinstance(c, Comment) and c.text]
    return scene
