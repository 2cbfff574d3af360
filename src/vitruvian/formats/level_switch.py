"""A scene whose LOD node shows one file or another of the same figure, by how far away the viewer is.

Each file keeps its own joints, clips and Scripts, so that the figure moves at every level. Source: run-time levels of
detail (seed 000, 4.2); LOD and Inline of X3D (ISO/IEC 19775-1, 23.4.3 and 9.4.2) and VRML97.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vitruvian.errors import VitruvianError
from vitruvian.formats.registry import write_scene
from vitruvian.hanim.graph import Node, Scene
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.hanim.studio import bounds, studio

ENCODINGS = {".x3d": "x3d", ".x3dv": "x3dv", ".x3dj": "x3dj", ".wrl": "wrl"}
LINES, ANGLE = 1080, 0.785398  # a picture: how many lines, and how much it shows from top to bottom (radians)


def distances(errors: Sequence[float]) -> list[float]:
    """Metres from which on each coarser level will do: where its error (metres, rising) is a line of a picture.

    A level whose error is not above the last one's begins a tenth farther away.
    """
    out: list[float] = []
    for error in errors:
        far = error * LINES / (2 * np.tan(ANGLE / 2))
        out.append(float(max(far, 1.1 * out[-1] if out else 0.1)))
    return out


def write_switch(path: Path, humanoid: Humanoid, files: Sequence[Path], ranges: Sequence[float]) -> None:
    """Write the scene: `files`, the finest first, beside it; `ranges` (m) where each of the others takes over.

    Raises VitruvianError for a format that has no LOD node.
    """
    encoding = ENCODINGS.get(path.suffix.lower())
    if encoding is None:
        raise VitruvianError(f"{path}: expected a scene for its LOD node, a name that ends in {', '.join(ENCODINGS)}")
    low, high = bounds([humanoid])
    levels: list[Any] = [Node("Inline", fields={"url": [file.name]}) for file in files]
    children = "level" if encoding == "wrl" else "children"
    fields = {"center": (low + high) / 2, "range": np.array(ranges, float), children: levels}
    # the files bring their own lights
    body: list[Any] = [n for n in studio([humanoid]) if n.type != "DirectionalLight"]
    version = "2.0" if encoding == "wrl" else "4.0"
    write_scene(
        Scene(encoding=encoding, version=version, profile="Immersive", body=[*body, Node("LOD", "Levels", fields)]),
        path,
    )
