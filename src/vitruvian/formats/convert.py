"""One scene graph in another encoding."""

from __future__ import annotations

import warnings

from vitruvian.errors import VitruvianError
from vitruvian.formats.vrml import parse_vrml
from vitruvian.formats.vrml_writer import print_vrml
from vitruvian.formats.x3d import parse_x3d
from vitruvian.formats.x3d_json import parse_json
from vitruvian.formats.x3d_json_writer import print_json
from vitruvian.formats.x3d_writer import print_x3d
from vitruvian.hanim.graph import Scene


def convert(scene: Scene, encoding: str) -> tuple[Scene, list[str]]:
    """(a new scene in "x3d", "x3dv", "x3dj" or "wrl", what that encoding can't hold: one line each).

    Values are in the syntax of the new encoding afterwards; fields of unknown type are kept by what they look like.
    The scene itself comes back when it is in that encoding already. VitruvianError when the graph can't be a file.
    """
    if encoding == scene.encoding:
        return scene, []
    if encoding not in ("x3d", "x3dv", "x3dj", "wrl"):
        raise VitruvianError(f"no encoding {encoding!r}; there are x3d, x3dv, x3dj and wrl")
    if encoding == "x3d":
        text, lost = print_x3d(scene)
    elif encoding == "x3dj":
        text, lost = print_json(scene)
    else:
        text, lost = print_vrml(scene, encoding)
    with warnings.catch_warnings():  # what is odd about the scene was said when it was read
        warnings.simplefilter("ignore")
        parse = {"x3d": parse_x3d, "x3dj": parse_json}.get(encoding, parse_vrml)
        return parse(text.encode(), scene.path), lost
