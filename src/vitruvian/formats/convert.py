"""One scene graph in another encoding."""

from __future__ import annotations

import warnings

from vitruvian.errors import VitruvianError
from vitruvian.formats.vrml import parse_vrml
from vitruvian.formats.vrml_writer import print_vrml
from vitruvian.formats.x3d import parse_x3d
from vitruvian.formats.x3d_writer import print_x3d
from vitruvian.hanim.graph import Scene


def convert(scene: Scene, encoding: str) -> tuple[Scene, list[str]]:
    """(a new scene in "x3d", "x3dv" or "wrl", what that encoding can't hold: one line each).

    Values are in the syntax of the new encoding afterwards; fields of unknown type are kept by what they look like.
    The scene itself comes back when it is in that encoding already. VitruvianError when the graph can't be a file.
    """
    if encoding == scene.encoding:
        return scene, []
    if encoding not in ("x3d", "x3dv", "wrl"):
        raise VitruvianError(f"no encoding {encoding!r}; there are x3d, x3dv and wrl")
    text, lost = print_x3d(scene) if encoding == "x3d" else print_vrml(scene, encoding)
    with warnings.catch_warnings():  # what is odd about the scene was said when it was read
        warnings.simplefilter("ignore")
        parse = parse_x3d if encoding == "x3d" else parse_vrml
        return parse(text.encode(), scene.path), lost
