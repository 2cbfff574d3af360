"""Our own file of surfaces that were computed ahead, `NAME.cache.npz`: plain arrays, never pickled.

`head` is the bytes of a JSON text, {"vitruvian_cache": 1, "surfaces": [{"name", "color", "closing"}, ...]}; the arrays of
surface K are `triangles_K` (m,3), `times_K` (F,) seconds, `positions_K` (F,n,3) float32 metres, and, if it has them,
`uv_K` (u,2), `uv_triangles_K` (m,3) and `row_K`, `joint_K`, `weight_K`, see `VertexCache`.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vitruvian.body.types import Weights
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.amass import Archive
from vitruvian.formats.atomic import atomic
from vitruvian.stage.vertex_cache import VertexCache

ENDING, KEY, VERSION = ".cache.npz", "vitruvian_cache", 1
MOST = 1000  # surfaces


def write_caches(caches: Sequence[VertexCache], path: str | os.PathLike[str]) -> dict[str, Any]:
    """A file that `read_caches` reads as the same caches, bit for bit. The report: `frames vertices bytes`."""
    if not Path(path).name.lower().endswith(ENDING):
        raise VitruvianError(f"{path}: expected a name that ends in {ENDING}")
    if not caches:
        raise VitruvianError(f"{path}: expected moving clothes to write, found none")
    told = [{"name": c.name, "color": list(c.color), "closing": c.closing} for c in caches]
    head = json.dumps({KEY: VERSION, "surfaces": told}, ensure_ascii=False).encode("utf-8")
    arrays: dict[str, Any] = {"head": np.frombuffer(head, np.uint8)}
    for k, c in enumerate(caches):
        arrays |= {f"triangles_{k}": c.triangles, f"times_{k}": c.times, f"positions_{k}": c.positions}
        if c.uv is not None:
            arrays |= {f"uv_{k}": c.uv, f"uv_triangles_{k}": c.uv_triangles}
        if c.weights is not None:
            w = c.weights
            arrays |= {f"row_{k}": w.row, f"joint_{k}": w.joint, f"weight_{k}": w.weight}
    with atomic(path) as part, open(part, "wb") as file:
        np.savez_compressed(file, **arrays)
    return {
        "frames": len(caches[0]), "vertices": sum(c.positions.shape[1] for c in caches),
        "bytes": Path(path).stat().st_size,
    }  # fmt: skip


def read_caches(path: str | os.PathLike[str]) -> tuple[VertexCache, ...]:
    """The caches of a file. Raises FileError for another file and for arrays that do not fit together."""
    with Archive(path) as archive:
        if "head" not in archive:
            raise FileError(path, 0, f"expected moving surfaces ({ENDING}), found an npz without `head`")
        try:
            head = json.loads(archive.get("head").astype(np.uint8).tobytes().decode("utf-8"))
        except (ValueError, RecursionError):
            raise FileError(path, 0, "head: expected JSON, it can't be read") from None
        told = head.get("surfaces") if isinstance(head, dict) and head.get(KEY) == VERSION else None
        if not isinstance(told, list) or not 0 < len(told) <= MOST or not all(isinstance(t, dict) for t in told):
            raise FileError(path, 0, f"head: expected {KEY} {VERSION} with surfaces, found {head!r:.60}")
        out = []
        for k, surface in enumerate(told):
            lacking = [n for n in ("triangles", "times", "positions") if f"{n}_{k}" not in archive]
            if lacking:
                raise FileError(path, 0, f"expected an array {lacking[0]}_{k}, found none")
            try:
                out.append(_cache(surface, lambda name, k=k: archive.get(f"{name}_{k}")))
            except (VitruvianError, ValueError, TypeError, KeyError, IndexError, AttributeError) as error:
                if isinstance(error, FileError):
                    raise
                raise FileError(path, 0, f"surface {k}: {error}") from None
    return tuple(out)


def _cache(told: dict[str, Any], get: Any) -> VertexCache:
    whole: Any = lambda name: None if (found := get(name)) is None else np.rint(found).astype(np.int64)  # noqa: E731
    row = whole("row")
    weights = None if row is None else Weights(row, whole("joint"), get("weight"))
    return VertexCache(
        str(told["name"]), whole("triangles"), get("times"), get("positions"), get("uv"), whole("uv_triangles"),
        tuple(told["color"]), weights, float(told["closing"]),
    )  # fmt: skip
