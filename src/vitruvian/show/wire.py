"""The bytes between Python and the page, both ways.

Python -> page, binary: magic `VTF1`, uint32 length of a JSON header (padded with spaces so that what follows is 8-byte
aligned), the header, then blocks at 8-byte aligned offsets counted from the end of the header; little-endian. The
header is `{type, ..., blocks: [{actor, channel, dtype, shape, offset, scale?, origin?}]}`.

Page -> Python, text: one JSON object of a fixed list of types, each field checked for type and range. Anything else is
refused with one line.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.errors import VitruvianError

VERSION = 1
MAGIC = b"VTF1"
DTYPES = ("float32", "uint32", "uint16", "int16", "uint8", "int8")
MAX_REQUEST = 64 * 1024  # bytes of one request of the page


@dataclass(frozen=True, eq=False)
class Block:
    """One array of a message. For quantised positions `p = origin + q * scale / 32767`, normals `n = q / 127`."""

    channel: str
    array: NDArray[Any]
    actor: str = ""
    scale: float | None = None
    origin: tuple[float, float, float] | None = None


def encode(kind: str, fields: Mapping[str, Any] | None = None, blocks: tuple[Block, ...] | list[Block] = ()) -> bytes:
    """One message. `fields` must be JSON; NaN and infinity in the header are refused."""
    entries, pieces, offset = [], [], 0
    for block in blocks:
        array = np.ascontiguousarray(block.array)
        name = array.dtype.name
        if name not in DTYPES:
            raise VitruvianError(f"block {block.channel}: expected one of {', '.join(DTYPES)}, found {name}")
        entry: dict[str, Any] = {"actor": block.actor, "channel": block.channel, "dtype": name}
        entry |= {"shape": list(array.shape), "offset": offset}
        if block.scale is not None:
            entry |= {"scale": block.scale, "origin": list(block.origin or (0.0, 0.0, 0.0))}
        entries.append(entry)
        data = array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes()
        pieces += [data, bytes(-len(data) % 8)]
        offset += len(data) + (-len(data) % 8)
    header = json.dumps({"type": kind, **(fields or {}), "blocks": entries}, allow_nan=False, separators=(",", ":"))
    text = header.encode()
    text += b" " * (-(len(text) + 8) % 8)
    return b"".join([MAGIC, struct.pack("<I", len(text)), text, *pieces])


def decode(message: bytes) -> tuple[dict[str, Any], dict[tuple[str, str], NDArray[Any]]]:
    """Header and arrays by (actor, channel) of a message; `VitruvianError` when it is not one."""

    def need(ok: bool, what: str) -> None:
        if not ok:
            raise VitruvianError(f"message: {what}")

    need(len(message) >= 8 and message[:4] == MAGIC, f"expected the magic {MAGIC.decode()}, found {message[:4]!r}")
    (length,) = struct.unpack_from("<I", message, 4)
    start = 8 + length
    need(start % 8 == 0 and start <= len(message), f"expected a header of {length} bytes inside {len(message)}")
    try:
        header = json.loads(message[8:start])
    except (ValueError, RecursionError) as error:
        raise VitruvianError(f"message: expected a JSON header, found {error}") from None
    need(isinstance(header, dict) and isinstance(header.get("blocks"), list), "expected a header with blocks")
    arrays = {}
    for entry in header["blocks"]:
        need(isinstance(entry, dict) and entry.get("dtype") in DTYPES, "expected blocks with a known dtype")
        shape, offset = entry.get("shape"), entry.get("offset")
        need(
            isinstance(shape, list) and all(type(n) is int and 0 <= n < 1 << 31 for n in shape), "bad shape of a block"
        )
        need(type(offset) is int and offset >= 0 and offset % 8 == 0, "bad offset of a block")
        dtype = np.dtype(entry["dtype"]).newbyteorder("<")
        count = math.prod(shape)
        end = start + offset + count * dtype.itemsize
        need(end <= len(message), f"block {entry.get('channel')} ends at byte {end} of {len(message)}")
        key = (str(entry.get("actor", "")), str(entry.get("channel", "")))
        arrays[key] = np.frombuffer(message, dtype, count, start + offset).reshape(shape)
    return header, arrays


def quantise(points: NDArray[Any]) -> tuple[NDArray[np.int16], float, tuple[float, float, float]]:
    """(V,3) metres -> (V,4) int16 (the fourth is padding), scale, origin: `p = origin + q * scale / 32767`.

    One uniform scale, the largest half extent of the box, so that a shape is not bent; the error is at most
    scale / 65534 along each axis. `VitruvianError` on positions that are not finite.
    """
    if not np.isfinite(points).all():
        bad = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise VitruvianError(f"vertices: expected finite positions, found {points[bad].tolist()} at vertex {bad}")
    out = np.zeros((len(points), 4), np.int16)
    if not len(points):
        return out, 1.0, (0.0, 0.0, 0.0)
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    origin = (low + high) / 2
    scale = max(float((high - low).max()) / 2, 1e-9)
    out[:, :3] = np.clip(np.rint((points - origin) * (32767 / scale)), -32767, 32767)
    return out, scale, (float(origin[0]), float(origin[1]), float(origin[2]))


def quantise_normals(normals: NDArray[Any]) -> NDArray[np.int8]:
    """(V,3) unit vectors -> (V,4) int8, `n = q / 127`."""
    out = np.zeros((len(normals), 4), np.int8)
    out[:, :3] = np.clip(np.rint(normals * 127), -127, 127)
    return out


# What the page may ask for: field -> (kind, low, high). Numbers are finite and in range, strings at most `high` long,
# texts and places by name at most as many.
REQUESTS: dict[str, dict[str, tuple[str, float, float]]] = {
    "hello": {"token": ("text", 0, 64), "version": ("whole", 0, 1000)},
    "ack": {"seq": ("whole", 0, 2**53)},
    "play": {},
    "pause": {},
    "seek": {"frame": ("number", 0, 1e9)},
    "speed": {"value": ("number", 0, 4)},
    "step": {"frames": ("whole", -10000, 10000)},
    "loop": {"value": ("flag", 0, 1)},
    "deformer": {"actor": ("text", 0, 200), "name": ("text", 0, 40)},
    "set_rotation": {"actor": ("text", 0, 200), "joint": ("text", 0, 200), "rotation": ("quaternion", -1.001, 1.001)},
    "set_displacer": {"actor": ("text", 0, 200), "name": ("text", 0, 200), "weight": ("number", -10, 10)},
    "clear_displacer": {"actor": ("text", 0, 200), "name": ("text", 0, 200)},
    "clear_pose": {"actor": ("text", 0, 200)},
    "set_pose": {"actor": ("text", 0, 200), "turns": ("quaternions", -1.001, 1.001), "shift": ("vector", -1e6, 1e6)},
    "reach": {
        "actor": ("text", 0, 200),
        "name": ("text", 0, 200),
        "places": ("places", 0, 300),
        "gesture": ("whole", 0, 2**53),
        "level": ("whole", 0, 4),
    },
    "set_hands": {"actor": ("text", 0, 200), "roundings": ("texts", 0, 200), "rounded": ("flag", 0, 1)},
    "set_landmarks": {"actor": ("text", 0, 200), "points": ("places", 0, 300)},
    "find_landmarks": {"actor": ("text", 0, 200)},
    "take_girths": {"actor": ("text", 0, 200), "points": ("places", 0, 300)},
    "stop_search": {"actor": ("text", 0, 200)},
    "set_weights": {"actor": ("text", 0, 200), "text": ("text", 0, 40000), "last": ("flag", 0, 1)},
}


def parse_request(text: str | bytes, known: Mapping[str, Mapping[str, tuple[str, float, float]]] = REQUESTS) -> Any:
    """The request in `text`, a dict; `VitruvianError` with one line when it is not one of those `known`, exactly."""
    if len(text) > MAX_REQUEST:
        raise VitruvianError(f"request: expected at most {MAX_REQUEST} bytes, found {len(text)}")
    try:
        request = json.loads(text)
    except (ValueError, RecursionError):
        raise VitruvianError("request: expected JSON") from None
    if not isinstance(request, dict) or not isinstance(request.get("type"), str) or request["type"] not in known:
        raise VitruvianError(f"request: expected a type out of {', '.join(known)}")
    fields = known[request["type"]]
    if set(request) != {"type", *fields}:
        raise VitruvianError(f"request {request['type']}: expected the fields {sorted(fields)}")
    for name, (kind, low, high) in fields.items():
        if not _fits(request[name], kind, low, high):
            raise VitruvianError(f"request {request['type']}: expected {name} to be a {kind} in {low:g}..{high:g}")
    return request


def _fits(value: Any, kind: str, low: float, high: float) -> bool:
    if kind == "text":
        return isinstance(value, str) and len(value) <= high
    if kind == "texts":
        good = isinstance(value, dict) and len(value) <= high
        return good and all(_fits(text, "text", low, high) for pair in value.items() for text in pair)
    if kind == "places":
        good = isinstance(value, dict) and len(value) <= high and all(len(name) <= 200 for name in value)
        lists = good and all(isinstance(p, list) and len(p) == 3 for p in value.values())
        return lists and all(_fits(x, "number", -1e9, 1e9) for p in value.values() for x in p)
    if kind == "flag":
        return isinstance(value, bool)
    if kind == "whole":
        return type(value) is int and low <= value <= high
    if kind == "vector":
        return isinstance(value, list) and len(value) == 3 and all(_fits(x, "number", low, high) for x in value)
    if kind == "quaternions":
        good = isinstance(value, dict) and len(value) <= 1000 and all(len(name) <= 200 for name in value)
        return good and all(_fits(q, "quaternion", low, high) for q in value.values())
    if kind == "quaternion":
        good = isinstance(value, list) and len(value) == 4 and all(_fits(x, "number", low, high) for x in value)
        return good and abs(sum(x * x for x in value) - 1) < 1e-3
    return type(value) in (int, float) and math.isfinite(value) and low <= value <= high
