"""The data pack of the built-in person: a base mesh, and displacement targets that shape it.

The pack is CC0 data of the MakeHuman community (see NOTICE and `pack/LICENSE-CC0.txt`), built by
`tools/build_body_pack.py`. Metres, Y up, facing +Z, in the source's A pose. Points: 0..13379 body, then tongue, eyes,
lashes, teeth, tights and hair of the source at their old indices, then a head and a tail for every bone of its rig.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from vitruvian.body.types import Floats, Ints, Weights

PACK = Path(__file__).parent / "pack"
BODY = 13380
POINTS = 19158
TONGUE = slice(13380, 13606)
EYES = slice(14598, 14742)
TEETH = slice(14992, 15128)


@cache
def manifest() -> dict[str, Any]:
    """Steps of the stored targets, names of the source's bones."""
    return json.loads((PACK / "manifest.json").read_text())


@cache
def _archive(name: str) -> Any:
    return np.load(PACK / f"{name}.npz")


@cache
def array(name: str) -> np.ndarray:
    """An array of the base: points, triangles, uv, uv_triangles, centres, mirror, ..."""
    return _archive("base")[name]


def tied(name: str) -> np.ndarray:
    """Of the joints that are tied to the skin, in triples: `joint`, `vertex` and its `share` of the joint's centre."""
    return _archive("joints")[name]


@cache
def points() -> Floats:
    """(19158 + 326, 3) the base mesh and bone ends, metres."""
    return array("points").astype(np.float64)


@cache
def target(name: str, kind: str = "targets") -> tuple[Ints, Floats]:
    """A displacement target: indices (n,) and offsets (n,3) in metres."""
    stored = _archive(kind)
    index = np.cumsum(stored[f"{name}.i"].astype(np.int32), dtype=np.int32)
    planes = stored[f"{name}.d"].reshape(3, -1).astype(np.uint32)
    zigzag = planes[0] | planes[1] << 8 | planes[2] << 16
    change = (zigzag >> 1).astype(np.int32) ^ -(zigzag & 1).astype(np.int32)
    offsets = np.cumsum(change.reshape(3, -1), axis=1).T * manifest()[kind][name]
    return index, np.ascontiguousarray(offsets)


@cache
def weights() -> Weights:
    """Weights of the points at LOA 4; joints in the order of the H-Anim 2.0 table. Rows without influence are empty."""
    return Weights.from_pairs(POINTS, array("weight_vertex"), array("weight_joint"), array("weight").astype(np.float64))


@cache
def feature_vertices() -> dict[str, int]:
    """Feature point of H-Anim 2.0 -> body vertex."""
    return json.loads((PACK / "features.json").read_text())
