"""What a scene file says it is, in its first bytes, against what its name says (rule F01)."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

from vitruvian.formats.source import LIMITS, read_bytes
from vitruvian.formats.vrml import parse_vrml
from vitruvian.hanim.doctor import Finding, finding
from vitruvian.hanim.graph import Comment, Scene

_BY_NAME = {".x3d": "x3d", ".x3dv": "x3dv", ".wrl": "wrl", ".wrz": "wrl"}
_CALLED = {"x3d": "X3D XML", "x3dv": "Classic X3D", "wrl": "VRML97", "json": "X3D JSON"}
_READERS = {"x3d": ("x3d", "parse_x3d"), "x3dv": ("vrml", "parse_vrml"), "wrl": ("vrml", "parse_vrml")}
HEADERS = {"x3dv": "#X3D V3.3 utf8", "wrl": "#VRML V2.0 utf8"}
_RIGHT = re.compile(rb"#(?:VRML V2\.0 utf8|X3D V[0-9]+\.[0-9]+ utf8)[ \t\r\n]")
_LIKE = re.compile(r"\s*(?:VRML|X3D)", re.IGNORECASE)
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
        module, function = _READERS[found]
        scene = getattr(import_module(f"vitruvian.formats.{module}"), function)(data, path)
        message = f"the content is {_CALLED[found]} though the name says {_CALLED[expected]}: loaders choose by it"
        return scene, [finding("F01", "file", 1, message, f"name it .{found}")]
    if expected == "x3d" or _RIGHT.match(data.lstrip(b"\xef\xbb\xbf")) or found == "json":
        return None
    scene = parse_vrml(data, path, assume=HEADERS[expected])
    first = scene.body[0] if scene.body else None
    what = "there is no header"
    if isinstance(first, Comment) and first.line == 1 and _LIKE.match(first.text):
        del scene.body[0]  # it tried to be the header
        what = f"the header '#{first.text[:40]}' is none"
    return scene, [finding("F01", "file", 1, f"{what}, expected {HEADERS[expected]}", f"write {HEADERS[expected]}")]
