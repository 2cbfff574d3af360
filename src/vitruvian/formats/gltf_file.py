"""The container of a glTF file being read: its JSON, its bytes, its accessors, each number of it checked before use.

Source: glTF 2.0 specification (Khronos), sections 3.5 to 3.7 and 4.4. Whatever is wrong is one `FileError`.
"""

from __future__ import annotations

import base64
import binascii
import json
import os
import struct
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.rotations import to_matrix
from vitruvian.body.types import Floats
from vitruvian.errors import FileError

MAX_BYTES = 1 << 30  # of a file, and of all its buffers together
MAX_JSON = 64 << 20
MAX_NUMBERS = 1 << 27  # that all accessors of a file may ask for together
MAX_NODES = 1 << 17
_WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_TYPES: dict[int, Any] = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COMPRESSED = {"KHR_draco_mesh_compression", "EXT_meshopt_compression"}
# Required extensions whose absence changes nothing that is read here, by the beginning of their names.
_HARMLESS = (
    *("KHR_materials", "KHR_texture", "KHR_lights", "KHR_mesh_quantization", "KHR_node_visibility", "KHR_animation"),
    *("KHR_xmp", "EXT_texture", "EXT_lights", "MSFT_texture", "VRM"),
)


class GltfFile:
    """One open glTF document. `root` is its JSON; lists of it come from `items`, arrays from `accessor`.

    Attributes: `path`; `parents` (N,) list, -1 for roots; `order` of nodes, parents before children, without those that
    are not in the scene shown; `local` (N,4,4) matrices of the nodes as the file has them.
    """

    def __init__(self, path: str | os.PathLike[str]):
        self.path = Path(path)
        self.root, self._chunk = self._open()
        asset = self.root.get("asset")
        version = asset.get("version") if isinstance(asset, dict) else None
        if not isinstance(version, str) or not version.startswith("2."):
            self.bad(f"expected glTF version 2, found {version!r}; convert the file to glTF 2.0 first")
        required = [e for e in self._list(self.root, "extensionsRequired", str)]
        packed = sorted(_COMPRESSED.intersection(required))
        if packed:
            self.bad(f"is compressed with {packed[0]}, which is not read here; export it without compression")
        unknown = [e for e in required if not e.startswith(_HARMLESS)]
        if unknown:
            self.bad(f"requires the extension {unknown[0]}, which is not known here; export it without")
        self._lists: dict[str, list[dict[str, Any]]] = {}
        self._buffers: dict[int, bytes] = {}
        self._arrays: dict[tuple[int, bool], NDArray] = {}
        self._held = 0
        self._asked = 0
        self.pictures: dict[int, bytes] = {}  # of images that base colours use
        self.pictured = 0
        self.samples = 0  # frames times joints that animations have cost so far
        self._hierarchy()

    def bad(self, what: str) -> NoReturn:
        raise FileError(self.path, 0, what)

    def _open(self) -> tuple[dict[str, Any], bytes | None]:
        try:
            size = os.path.getsize(self.path)
            if size > MAX_BYTES:
                self.bad(f"expected a file of at most {MAX_BYTES >> 20} MB, found {size >> 20} MB")
            data = self.path.read_bytes()
        except OSError as error:
            self.bad(f"can't be read ({error.strerror})")
        chunk = None
        if data[:4] == b"glTF":
            data, chunk = self._chunks(data)
        if len(data) > MAX_JSON:
            self.bad(f"expected a JSON part of at most {MAX_JSON >> 20} MB, found {len(data) >> 20} MB")
        try:
            root = json.loads(data.decode("utf-8-sig"), parse_constant=self._not_finite)
        except UnicodeDecodeError:
            self.bad("expected GLB, or glTF's JSON in UTF-8; found neither")
        except RecursionError:
            self.bad("the JSON part is nested too deeply")
        except ValueError as error:
            self.bad(f"the JSON part can't be read: {error}")
        if not isinstance(root, dict):
            self.bad(f"expected a JSON object, found {type(root).__name__}")
        return root, chunk

    def _not_finite(self, constant: str) -> NoReturn:
        raise ValueError(f"expected finite numbers, found {constant}")

    def _chunks(self, data: bytes) -> tuple[bytes, bytes | None]:
        if len(data) < 20:
            self.bad(f"expected a GLB header and a JSON chunk, found {len(data)} bytes")
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2:
            self.bad(f"expected GLB version 2, found {version}")
        if length > len(data):
            self.bad(f"ends too early: its header says {length} bytes, there are {len(data)}")
        text, chunk, at = None, None, 12
        while at + 8 <= length:
            size, kind = struct.unpack_from("<II", data, at)
            if at + 8 + size > length:
                self.bad(f"the chunk at byte {at} says {size} bytes, {length - at - 8} are left")
            if kind == 0x4E4F534A and text is None:
                text = data[at + 8 : at + 8 + size]
            elif kind == 0x004E4942 and chunk is None:
                chunk = data[at + 8 : at + 8 + size]
            at += 8 + size
        if text is None:
            self.bad("expected a JSON chunk first, found none")
        return text, chunk

    # JSON values, each with the type that is expected of it

    def _list(self, holder: dict[str, Any], key: str, kind: type) -> list[Any]:
        value = holder.get(key, [])
        if not isinstance(value, list) or not all(isinstance(v, kind) for v in value):
            self.bad(f"{key}: expected a list of {'objects' if kind is dict else kind.__name__}")
        return value

    def items(self, key: str) -> list[dict[str, Any]]:
        """A list of the document ("nodes", "meshes", ...), every entry an object."""
        if key not in self._lists:
            self._lists[key] = self._list(self.root, key, dict)
        return self._lists[key]

    def objects(self, holder: dict[str, Any], key: str) -> list[dict[str, Any]]:
        return self._list(holder, key, dict)

    def object(self, holder: Any, key: str) -> dict[str, Any]:
        """The object under a key, {} when there is none or something else."""
        value = holder.get(key) if isinstance(holder, dict) else None
        return value if isinstance(value, dict) else {}

    def integer(self, holder: dict[str, Any], key: str, where: str, limit: int, default: int | None = None) -> int:
        """A whole number in 0..limit-1."""
        value = holder.get(key, default)
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < limit:
            shown = repr(value)[:60]
            self.bad(f"{where} {key}: expected a whole number in 0..{limit - 1}, found {shown}")
        return value

    def mesh_of(self, node: int) -> dict[str, Any]:
        """The mesh that a node shows."""
        meshes = self.items("meshes")
        return meshes[self.integer(self.items("nodes")[node], "mesh", f"node {node}", len(meshes))]

    def indices(self, holder: dict[str, Any], key: str, where: str, limit: int) -> list[int]:
        value = holder.get(key, [])
        if not isinstance(value, list):
            self.bad(f"{where} {key}: expected a list")
        return [self.integer({key: v}, key, where, limit) for v in value]

    def numbers(self, holder: dict[str, Any], key: str, where: str, default: tuple[float, ...]) -> Floats:
        """As many numbers as the default has."""
        value = holder.get(key)
        if value is None:
            return np.array(default, np.float64)
        plain = isinstance(value, list) and all(isinstance(v, int | float) and not isinstance(v, bool) for v in value)
        if not plain or len(value) != len(default) or not all(abs(v) < 1e30 for v in value):
            self.bad(f"{where} {key}: expected {len(default)} numbers, found {repr(value)[:60]}")
        return np.array(value, np.float64)

    def share(self, holder: dict[str, Any], key: str, where: str) -> float:
        """A factor, brought into 0..1; 1 when it is not given."""
        given = {} if key not in holder else {key: [holder[key]]}
        return float(np.clip(self.numbers(given, key, where, (1.0,))[0], 0, 1))

    def text(self, holder: dict[str, Any], key: str) -> str:
        value = holder.get(key)
        return " ".join(value.split())[:200] if isinstance(value, str) else ""

    def extension(self, name: str) -> dict[str, Any]:
        """An extension of the document, {} when it has none of that name."""
        return self.object(self.object(self.root, "extensions"), name)

    # bytes

    def _buffer(self, index: int) -> bytes:
        if index in self._buffers:
            return self._buffers[index]
        buffer = self.items("buffers")[index]
        where = f"buffer {index}"
        length = self.integer(buffer, "byteLength", where, MAX_BYTES + 1)
        uri = buffer.get("uri")
        if uri is None:
            if index or self._chunk is None:
                self.bad(f"{where}: expected a uri, found none")
            data = self._chunk
        elif not isinstance(uri, str):
            self.bad(f"{where} uri: expected text")
        elif uri.startswith("data:"):
            head, _, body = uri.partition(",")
            if not head.endswith(";base64"):
                self.bad(f"{where}: expected a base64 data URI")
            try:
                data = base64.b64decode(body, validate=False)
            except (binascii.Error, ValueError):
                self.bad(f"{where}: its base64 data can't be read")
        else:
            data = self.beside(uri, where)
        if len(data) < length:
            self.bad(f"{where}: expected {length} bytes, found {len(data)}")
        self._held += len(data)
        if self._held > MAX_BYTES:
            self.bad(f"buffers: expected at most {MAX_BYTES >> 20} MB together")
        self._buffers[index] = data
        return data

    def beside(self, uri: str, where: str) -> bytes:
        """A file in the folder of this one or below it; nothing else on the machine or the network is opened."""
        name = unquote(uri)
        folder = self.path.resolve().parent
        if "\0" in name or "://" in name or os.path.isabs(name) or "\\" in name:
            self.bad(f"{where}: expected a file beside this one, found {uri[:80]!r}")
        target = (folder / name).resolve()
        if not target.is_relative_to(folder):
            self.bad(f"{where}: {uri[:80]!r} lies outside the folder of this file, so it is not opened")
        try:
            if not target.is_file():
                self.bad(f"{where}: there is no file {uri[:80]!r} beside this one")
            if target.stat().st_size > MAX_BYTES:
                self.bad(f"{where}: expected a file of at most {MAX_BYTES >> 20} MB")
            return target.read_bytes()
        except OSError as error:
            self.bad(f"{where}: {uri[:80]!r} can't be read ({error.strerror})")

    def view_bytes(self, index: int, where: str) -> bytes:
        """The bytes of a bufferView."""
        data, start, length, _ = self._view(index, where)
        return data[start : start + length]

    def _view(self, index: int, where: str) -> tuple[bytes, int, int, int]:
        """Buffer, first byte, length and stride (0: none given) of a bufferView."""
        views = self.items("bufferViews")
        view = views[self.integer({"bufferView": index}, "bufferView", where, len(views))]
        where = f"bufferView {index}"
        if "EXT_meshopt_compression" in self.object(view, "extensions"):
            self.bad(f"{where}: is compressed with EXT_meshopt_compression; export it without compression")
        data = self._buffer(self.integer(view, "buffer", where, len(self.items("buffers"))))
        start = self.integer(view, "byteOffset", where, MAX_BYTES + 1, 0)
        length = self.integer(view, "byteLength", where, MAX_BYTES + 1)
        if start + length > len(data):
            self.bad(f"{where}: expected bytes inside a buffer of {len(data)}, found {start}..{start + length}")
        return data, start, length, self.integer(view, "byteStride", where, 253, 0)

    def _strided(self, holder: dict[str, Any], where: str, dtype: np.dtype, count: int, width: int) -> NDArray:
        """(count,width) numbers out of the bufferView and byteOffset of `holder`."""
        data, start, length, stride = self._view(holder["bufferView"], where)
        offset = self.integer(holder, "byteOffset", where, MAX_BYTES + 1, 0)
        size = dtype.itemsize * width
        stride = stride or size
        if stride < size:
            self.bad(f"{where}: expected a byteStride of at least {size}, found {stride}")
        if offset + stride * (count - 1) + size > length:
            self.bad(f"{where}: {count} entries need {offset + stride * (count - 1) + size} bytes, there are {length}")
        shape, strides = (count, width), (stride, dtype.itemsize)
        return np.ndarray(shape, dtype, data, start + offset, strides)

    def accessor(self, index: int, kinds: tuple[str, ...], where: str, *, whole: bool = False) -> NDArray:
        """The values of an accessor whose type is one of `kinds`: (n,) of SCALAR, (n,k) of VECk, (n,4,4) of MAT4.

        float64, normalised integers in -1..1; with `whole` int64, for indices. float32 is exact in float64.
        """
        entries = self.items("accessors")
        index = self.integer({"accessor": index}, "accessor", where, len(entries))
        if (index, whole) not in self._arrays:
            self._arrays[index, whole] = self._accessor(entries[index], f"accessor {index}", whole)
        kind = entries[index].get("type")
        if kind not in kinds:
            self.bad(f"{where}: expected {' or '.join(kinds)}, found {kind!r} (accessor {index})")
        return self._arrays[index, whole]

    def _accessor(self, entry: dict[str, Any], where: str, whole: bool) -> NDArray:
        kind, component = entry.get("type"), entry.get("componentType")
        if not isinstance(kind, str) or kind not in _WIDTH:
            self.bad(f"{where}: expected the type {', '.join(_WIDTH)}, found {str(kind)[:40]!r}")
        if not isinstance(component, int) or component not in _TYPES:
            self.bad(f"{where}: expected a componentType in 5120..5126, found {str(component)[:40]!r}")
        width, dtype = _WIDTH[kind], np.dtype(_TYPES[component])
        count = self.integer(entry, "count", where, MAX_NUMBERS)
        if count == 0:
            self.bad(f"{where}: expected at least one entry, found none")
        self._asked += count * width
        if self._asked > MAX_NUMBERS:
            self.bad(f"accessors: expected at most {MAX_NUMBERS} numbers in one file")
        raw = None if entry.get("bufferView") is None else self._strided(entry, where, dtype, count, width)
        sparse = self.object(entry, "sparse")
        if sparse:
            raw = np.zeros((count, width), dtype) if raw is None else raw.copy()
            self._replace(raw, sparse, where, dtype)
        if raw is None:
            raw = np.zeros((count, width), dtype)
        if whole:
            if dtype.kind == "f":
                self.bad(f"{where}: expected whole numbers, found floats")
            values: NDArray = raw.astype(np.int64)
        else:
            values = raw.astype(np.float64)
            if entry.get("normalized") is True and dtype.kind != "f":
                values = np.maximum(values / np.iinfo(dtype).max, -1.0)
            if not np.isfinite(values).all():
                first = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
                self.bad(f"{where}: expected finite numbers, found {values[first][0]} at entry {first}")
        if kind == "MAT4":
            return values.reshape(-1, 4, 4).transpose(0, 2, 1)
        return values[:, 0] if width == 1 else values

    def _replace(self, raw: NDArray, sparse: dict[str, Any], where: str, dtype: np.dtype) -> None:
        """Entries of a sparse accessor, in place."""
        count = self.integer(sparse, "count", f"{where} sparse", len(raw) + 1)
        index, values = self.object(sparse, "indices"), self.object(sparse, "values")
        component = index.get("componentType")
        if component not in (5121, 5123, 5125) or "bufferView" not in index or "bufferView" not in values:
            self.bad(f"{where} sparse: expected indices and values with a bufferView each")
        if not count:
            return
        at = self._strided(index, f"{where} sparse indices", np.dtype(_TYPES[component]), count, 1)[:, 0]
        if int(at.max()) >= len(raw):
            self.bad(f"{where} sparse indices: expected 0..{len(raw) - 1}, found {int(at.max())}")
        raw[at.astype(np.int64)] = self._strided(values, f"{where} sparse values", dtype, count, raw.shape[1])

    # nodes

    def _hierarchy(self) -> None:
        nodes = self.items("nodes")
        if len(nodes) > MAX_NODES:
            self.bad(f"nodes: expected at most {MAX_NODES}, found {len(nodes)}")
        self.parents = [-1] * len(nodes)
        self.children: list[list[int]] = []
        for i, node in enumerate(nodes):
            below = self.indices(node, "children", f"node {i}", len(nodes))
            self.children.append(below)
            for child in below:
                if self.parents[child] >= 0 or child == i:
                    self.bad(f"node {child} hangs in two places: nodes must form a tree")
                self.parents[child] = i
        scenes = self.items("scenes")
        if scenes:
            shown = scenes[self.integer(self.root, "scene", "document", len(scenes), 0)]
            roots = self.indices(shown, "nodes", "scene", len(nodes))
        else:
            roots = [i for i, p in enumerate(self.parents) if p < 0]
        self.order: list[int] = []
        seen: set[int] = set()
        stack = list(reversed(roots))
        while stack:
            i = stack.pop()
            if i in seen:
                self.bad(f"node {i} hangs in two places: nodes must form a tree")
            seen.add(i)
            self.order.append(i)
            stack.extend(reversed(self.children[i]))
        # a scene may show part of a tree; its roots hang on nothing then
        for i in roots:
            self.parents[i] = -1
        if not scenes and len(seen) < len(nodes):
            lone = next(i for i in range(len(nodes)) if i not in seen)
            self.bad(f"node {lone} is its own ancestor: nodes must form a tree")
        if len(self.order) < len(nodes):
            self._acyclic(seen)
        self.translation = np.zeros((len(nodes), 3))
        self.rotation = np.tile([0.0, 0, 0, 1], (len(nodes), 1))
        self.scale = np.ones((len(nodes), 3))
        self.local = np.tile(np.eye(4), (len(nodes), 1, 1))
        for i, node in enumerate(nodes):
            self._place(i, node)

    def _acyclic(self, seen: set[int]) -> None:
        """Nodes outside the scene must form trees as well."""
        rest = [i for i in range(len(self.parents)) if i not in seen]
        stack = [i for i in rest if self.parents[i] < 0 or self.parents[i] in seen]
        reached = set(stack)
        while stack:
            below = [c for c in self.children[stack.pop()] if c not in seen]
            reached.update(below)
            stack.extend(below)
        lone = next((i for i in rest if i not in reached), None)
        if lone is not None:
            self.bad(f"node {lone} is its own ancestor: nodes must form a tree")

    def _place(self, i: int, node: dict[str, Any]) -> None:
        where = f"node {i}"
        if node.get("matrix") is not None:
            matrix = self.numbers(node, "matrix", where, (0.0,) * 16).reshape(4, 4).T
            self.local[i, :3] = matrix[:3]
            return
        self.translation[i] = self.numbers(node, "translation", where, (0, 0, 0))
        self.rotation[i] = self.numbers(node, "rotation", where, (0, 0, 0, 1))
        self.scale[i] = self.numbers(node, "scale", where, (1, 1, 1))
        self.local[i] = trs(self.translation[i], self.rotation[i], self.scale[i])

    def name(self, node: int) -> str:
        return self.text(self.items("nodes")[node], "name")

    def extras(self, node: int) -> dict[str, Any]:
        """What our own writer left on a node, {} on nodes of others."""
        return self.object(self.object(self.items("nodes")[node], "extras"), "hanim")

    def worlds(self, local: Floats | None = None) -> Floats:
        """(N,4,4) matrices of all nodes in the scene, from local ones; identity for nodes outside it."""
        local = self.local if local is None else local
        out = np.tile(np.eye(4), (len(local), 1, 1))
        for i in self.order:
            p = self.parents[i]
            out[i] = local[i] if p < 0 else out[p] @ local[i]
        return out

    def ancestors(self, node: int) -> list[int]:
        """Nodes above a node, nearest first."""
        out = []
        while (node := self.parents[node]) >= 0:
            out.append(node)
        return out


def trs(translation: Floats, rotation: Floats, scale: Floats) -> Floats:
    """(...,4,4) of glTF's translation (...,3), rotation (...,4) xyzw and scale (...,3)."""
    out = np.zeros((*translation.shape[:-1], 4, 4))
    out[..., :3, :3] = to_matrix(rotation) * scale[..., None, :]
    out[..., :3, 3] = translation
    out[..., 3, 3] = 1.0
    return out
