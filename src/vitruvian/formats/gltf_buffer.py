"""The container of a GLB file: one JSON document and one block of bytes that its accessors point into.

Source: glTF 2.0 specification (Khronos), sections 3.6 (binary data) and 4.4 (GLB).
"""

from __future__ import annotations

import json
import os
import struct
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vitruvian.formats.atomic import atomic

_TYPES = {np.dtype(np.float32): 5126, np.dtype(np.uint8): 5121, np.dtype(np.uint16): 5123, np.dtype(np.uint32): 5125}
_SHAPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
VERTICES, INDICES = 34962, 34963


class Document:
    """A glTF document being written: `root` is the JSON, arrays go to `add`."""

    def __init__(self) -> None:
        self.root: dict[str, Any] = {"asset": {"version": "2.0", "generator": "vitruvian"}}
        self.bytes = bytearray()

    def append(self, kind: str, item: dict[str, Any]) -> int:
        """Add to a list of the document ("nodes", "meshes", ...); its index."""
        items = self.root.setdefault(kind, [])
        items.append(item)
        return len(items) - 1

    def view(self, data: NDArray, target: int | None = None) -> int:
        """Bytes of an array as a bufferView."""
        self.bytes += bytes(-len(self.bytes) % 4)
        item: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.bytes), "byteLength": data.nbytes}
        if target:
            item["target"] = target
        self.bytes += data.tobytes()
        return self.append("bufferViews", item)

    def add(
        self, values: ArrayLike, dtype: type = np.float32, *, target: int | None = None, bounds: bool = False,
        normalized: bool = False,
    ) -> int:  # fmt: skip
        """An accessor of values (n,), (n,2..4) or (n,4,4): matrices are stored by columns."""
        data = np.asarray(values)
        if data.ndim == 3:
            data = data.transpose(0, 2, 1)
        data = np.ascontiguousarray(data, dtype=dtype)
        item = self._accessor(data, bounds)
        item["bufferView"] = self.view(data, target)
        if normalized:
            item["normalized"] = True
        return self.append("accessors", item)

    def add_sparse(self, count: int, index: NDArray, values: NDArray, where: list[int] | None = None) -> int:
        """An accessor of `count` vectors that are zero but at `index` (increasing), where they are values (n,3).

        where: takes the bufferView of the index, for further accessors with the same one.
        """
        data = np.ascontiguousarray(values, np.float32)
        item = self._accessor(data, False)
        low, high = data.min(axis=0), data.max(axis=0)
        if len(index) < count:
            low, high = np.minimum(low, 0), np.maximum(high, 0)
        item.update(count=count, min=[float(x) for x in low], max=[float(x) for x in high])
        small = np.uint16 if count <= 0xFFFF else np.uint32
        where = [] if where is None else where
        if not where:
            where.append(self.view(np.ascontiguousarray(index, small)))
        item["sparse"] = {
            "count": len(index),
            "indices": {
                "bufferView": where[0],
                "componentType": _TYPES[np.dtype(small)],
            },
            "values": {"bufferView": self.view(data)},
        }
        return self.append("accessors", item)

    def _accessor(self, data: NDArray, bounds: bool) -> dict[str, Any]:
        shape = data.shape[1:]
        item: dict[str, Any] = {
            "componentType": _TYPES[data.dtype],
            "count": len(data),
            "type": _SHAPES[shape],
        }
        if bounds:
            low, high = np.atleast_1d(data.min(axis=0)), np.atleast_1d(data.max(axis=0))
            item["min"], item["max"] = [float(x) for x in low], [float(x) for x in high]
        return item

    def write(self, path: str | os.PathLike[str]) -> int:
        """Write the GLB; its size in bytes."""
        if self.bytes:
            self.bytes += bytes(-len(self.bytes) % 4)
            self.root["buffers"] = [{"byteLength": len(self.bytes)}]
        text = json.dumps(self.root, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        if self.bytes:
            chunks += struct.pack("<II", len(self.bytes), 0x004E4942) + bytes(self.bytes)
        with atomic(path) as temporary:
            temporary.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return 12 + len(chunks)
