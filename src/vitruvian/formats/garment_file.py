"""Our own file of a sewn garment, `NAME.garment.npz`: pattern, mesh, how it hangs, and the skin that it hangs on.

An npz of plain arrays, never pickled. `head` is the bytes of a JSON text:

    {"vitruvian_garment": 1, "pattern": {see formats.pattern_file}, "fabrics": [{"name", "density", ...} of each panel],
     "edges": [[panel, edge, vertices], ...], "report": {...}}

and the arrays are those of `PanelMesh` (material, grain, triangles, panel, pairs, seam; `edges`: the vertices along each
edge, one after the other) and `Garment` (weld, vertices, matrices, graded if it is), with `skin` (V,3) metres and
`skin_triangles` (t,3) of the whole body as it stood; where it is ready to be worn, `hung` (w,3) metres, how it hangs on
the standing body, and `layer` (w,): what is tight, 0, loose, 1, and floating, 2. The binding of cloth to skin follows from
them, see `vitruvian.cloth.binding`.
Source: note cloth.md, section 10.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from vitruvian.body.types import Floats, Ints, floats, indices
from vitruvian.cloth.fabric import Fabric
from vitruvian.cloth.garment import Garment, Hung
from vitruvian.cloth.layers import NAMES
from vitruvian.cloth.tessellate import PanelMesh
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.amass import Archive
from vitruvian.formats.atomic import atomic
from vitruvian.formats.pattern_file import document, pattern_from

ENDING, KEY, VERSION = ".garment.npz", "vitruvian_garment", 1


@dataclass(frozen=True, eq=False)
class Kept:
    """A garment, and the skin that it hangs on: skin (V,3) metres as it stood, triangles (t,3)."""

    garment: Garment
    skin: Floats
    triangles: Ints


def write_garment(kept: Kept, path: str | os.PathLike[str]) -> None:
    """A file that `read_garment` reads as the same garment, bit for bit."""
    if not Path(path).name.lower().endswith(ENDING):
        raise VitruvianError(f"{path}: expected a name that ends in {ENDING}")
    if kept.garment.below:
        raise VitruvianError(f"{path}: {kept.garment.name} is worn over other garments; keep each in a file of its own")
    g, mesh = kept.garment, kept.garment.mesh
    keys = sorted(mesh.edges)
    head = {
        KEY: VERSION,
        "pattern": document(g.pattern),
        "fabrics": [asdict(f) for f in g.fabrics],
        "edges": [[int(k), int(e), len(mesh.edges[k, e])] for k, e in keys],
        "report": json.loads(json.dumps(dict(g.report), default=lambda v: v.tolist())),
    }
    arrays: dict[str, Any] = {
        "head": np.frombuffer(json.dumps(head, ensure_ascii=False).encode("utf-8"), np.uint8),
        "edges": np.concatenate([np.zeros(0, np.int32), *(mesh.edges[k] for k in keys)]).astype(np.int32),
        **{name: getattr(mesh, name) for name in _MESH},
        "weld": g.weld, "vertices": g.vertices, "matrices": g.matrices,
        "skin": kept.skin, "skin_triangles": kept.triangles,
    }  # fmt: skip
    if g.graded is not None:
        arrays["graded"] = g.graded
    if g.hung is not None:
        arrays |= {"hung": g.hung.x, "layer": g.hung.layer}
    with atomic(path) as part, open(part, "wb") as file:
        np.savez_compressed(file, **arrays)


_MESH = ("material", "grain", "triangles", "panel", "pairs", "seam")


def read_garment(path: str | os.PathLike[str]) -> Kept:
    """The garment of a file. Raises FileError for another file and for arrays that do not fit together."""
    with Archive(path) as archive:
        if "head" not in archive:
            raise FileError(path, 0, f"expected a garment ({ENDING}), found an npz without `head`")
        names = (*_MESH, "edges", "weld", "vertices", "matrices", "skin", "skin_triangles")
        lacking = [n for n in names if n not in archive]
        if lacking:
            raise FileError(path, 0, f"expected an array {lacking[0]}, found none")
        head = _head(path, archive.get("head"))
        arrays = {n: archive.get(n) for n in (*names, "graded", "hung", "layer")}
    try:
        return _kept(head, arrays, os.fspath(path))
    except (VitruvianError, ValueError, TypeError, KeyError, IndexError) as error:
        if isinstance(error, FileError):
            raise
        raise FileError(path, 0, f"garment: {error}") from None


def _head(path: str | os.PathLike[str], coded: Floats) -> Mapping[str, Any]:
    try:
        head = json.loads(coded.astype(np.uint8).tobytes().decode("utf-8"))
    except (ValueError, RecursionError):
        raise FileError(path, 0, "head: expected JSON, it can't be read") from None
    if not isinstance(head, dict) or head.get(KEY) != VERSION:
        found = head.get(KEY) if isinstance(head, dict) else head
        raise FileError(path, 0, f"head: expected {KEY} {VERSION}, found {found!r:.40}")
    return head


def _kept(head: Mapping[str, Any], arrays: Mapping[str, Any], path: str) -> Kept:
    pattern = pattern_from(_object(head.get("pattern"), "pattern"), Path(path).name.split(".")[0])
    known = {f.name for f in fields(Fabric)}
    fabrics = tuple(
        Fabric(**{k: v for k, v in _object(f, "fabric").items() if k in known}) for f in _list(head, "fabrics")
    )
    if len(fabrics) != len(pattern.panels):
        raise VitruvianError(f"expected {len(pattern.panels)} fabrics, found {len(fabrics)}")
    material = floats(arrays["material"], "material", None, 2)
    n, whole = len(material), lambda name: np.rint(arrays[name])
    edges: dict[tuple[int, int], Ints] = {}
    along, start = indices(whole("edges"), "edges", n, None), 0
    for row in _list(head, "edges"):
        k, e, size = (int(v) for v in row)
        if not 0 <= size <= len(along) - start:
            raise VitruvianError(f"edges: expected {size} vertices, found {len(along) - start}")
        edges[k, e], start = along[start : start + size], start + size
    triangles = indices(whole("triangles"), "triangles", n, None, 3)
    pairs = indices(whole("pairs"), "pairs", n, None, 2)
    mesh = PanelMesh(
        material, floats(arrays["grain"], "grain", n, 2), triangles,
        indices(whole("panel"), "panel", len(pattern.panels), n), edges, pairs,
        indices(whole("seam"), "seam", max(1, len(pattern.seams)), len(pairs)),
    )  # fmt: skip
    vertices = floats(arrays["vertices"], "vertices", None, 3)
    weld = indices(whole("weld"), "weld", len(vertices), n)
    used = np.zeros(len(vertices), bool)
    used[weld[triangles]] = True
    if not used.all():
        raise VitruvianError(f"vertex {int(np.argmin(used))}: expected a triangle that has it, found none")
    graded = None if arrays["graded"] is None else floats(arrays["graded"], "graded", len(triangles), 3, 2)
    skin = floats(arrays["skin"], "skin", None, 3)
    matrices = floats(arrays["matrices"], "matrices", None, 4, 4)
    report = _object(head.get("report", {}), "report")
    hung = None
    if arrays["hung"] is not None:
        layer = np.zeros(0) if arrays["layer"] is None else np.rint(arrays["layer"])
        hung = Hung(
            floats(arrays["hung"], "hung", len(vertices), 3), indices(layer, "layer", len(NAMES), len(vertices))
        )
    garment = Garment(pattern, mesh, weld, vertices, fabrics, matrices, report, graded=graded, hung=hung)
    if len(triangles):
        assert garment.sheet is not None  # a sheet whose triangles have no area is refused here
    return Kept(garment, skin, indices(whole("skin_triangles"), "skin_triangles", len(skin), None, 3))


def _object(value: Any, name: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise VitruvianError(f"{name}: expected an object, found {value!r:.40}")
    return value


def _list(head: Mapping[str, Any], name: str) -> list[Any]:
    value = head.get(name)
    if not isinstance(value, list):
        raise VitruvianError(f"{name}: expected a list, found {value!r:.40}")
    return value
