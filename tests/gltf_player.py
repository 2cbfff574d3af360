"""A minimal glTF player for tests, written from the specification: nodes, one skin, one animation, morph targets."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_TYPES = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}


class Player:
    def __init__(self, path: Path):
        data = Path(path).read_bytes()
        magic, version, length = struct.unpack_from("<4sII", data)
        assert magic == b"glTF" and version == 2 and length == len(data)
        size, kind = struct.unpack_from("<II", data, 12)
        assert kind == 0x4E4F534A
        self.json: dict[str, Any] = json.loads(data[20 : 20 + size])
        self.bin = data[20 + size + 8 :]
        self.nodes = self.json["nodes"]
        self.named = {n.get("name", ""): i for i, n in enumerate(self.nodes)}

    def _view(self, index: int, dtype: type, count: int, width: int) -> np.ndarray:
        view = self.json["bufferViews"][index]
        return np.frombuffer(self.bin, dtype, count * width, view["byteOffset"]).reshape(count, width)

    def read(self, index: int) -> np.ndarray:
        a = self.json["accessors"][index]
        width, dtype = _SIZES[a["type"]], _TYPES[a["componentType"]]
        out = np.zeros((a["count"], width), dtype)
        if "bufferView" in a:
            out = self._view(a["bufferView"], dtype, a["count"], width).copy()
        if "sparse" in a:
            s = a["sparse"]
            where = self._view(s["indices"]["bufferView"], _TYPES[s["indices"]["componentType"]], s["count"], 1)[:, 0]
            out[where] = self._view(s["values"]["bufferView"], dtype, s["count"], width)
        if a.get("normalized"):
            return out / np.iinfo(dtype).max
        return out.astype(np.float64)

    def locals(self, time: float) -> tuple[list[np.ndarray], np.ndarray]:
        """Local matrices of all nodes and the morph weights at a time."""
        state = [
            {
                "translation": np.array(n.get("translation", [0, 0, 0.0])),
                "rotation": np.array(n.get("rotation", [0, 0, 0, 1.0])),
                "scale": np.array(n.get("scale", [1, 1, 1.0])),
            }
            for n in self.nodes
        ]
        weights = np.array(self.json.get("meshes", [{}])[0].get("weights", []))
        for animation in self.json.get("animations", []):
            for channel in animation["channels"]:
                sampler = animation["samplers"][channel["sampler"]]
                keys = self.read(sampler["input"])[:, 0]
                values = self.read(sampler["output"]).reshape(len(keys), -1)
                k = int(np.clip(np.searchsorted(keys, time, side="right") - 1, 0, max(len(keys) - 2, 0)))
                after = min(k + 1, len(keys) - 1)
                t = 0.0 if after == k else np.clip((time - keys[k]) / (keys[after] - keys[k]), 0, 1)
                value = values[k] + (values[after] - values[k]) * t
                if channel["target"]["path"] == "weights":
                    weights = value
                else:
                    state[channel["target"]["node"]][channel["target"]["path"]] = value
        return [_trs(**s) for s in state], weights

    def worlds(self, time: float) -> tuple[list[np.ndarray], np.ndarray]:
        local, weights = self.locals(time)
        world: list[np.ndarray] = [np.eye(4)] * len(local)
        stack = [(i, np.eye(4)) for i in self.json["scenes"][0]["nodes"]]
        while stack:
            i, above = stack.pop()
            world[i] = above @ local[i]
            stack += [(c, world[i]) for c in self.nodes[i].get("children", [])]
        return world, weights

    def vertices(self, time: float) -> np.ndarray:
        """Drawn vertices (N,3) in the world at a time: morphs, then skin, the mesh node's own transform ignored."""
        world, weights = self.worlds(time)
        primitive = self.json["meshes"][0]["primitives"][0]
        a = primitive["attributes"]
        p = self.read(a["POSITION"])
        for target, weight in zip(primitive.get("targets", []), weights):
            p = p + weight * self.read(target["POSITION"])
        if "skins" not in self.json:
            return p
        skin = self.json["skins"][0]
        inverse = self.read(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        bones = np.stack([world[j] for j in skin["joints"]]) @ inverse
        out = np.zeros_like(p)
        k = 0
        while f"JOINTS_{k}" in a:
            joints, share = self.read(a[f"JOINTS_{k}"]).astype(int), self.read(a[f"WEIGHTS_{k}"])
            blend = np.einsum("vk,vkab->vab", share, bones[joints])
            out += np.einsum("vab,vb->va", blend[:, :3], np.concatenate([p, np.ones((len(p), 1))], -1))
            k += 1
        return out


def _trs(translation: np.ndarray, rotation: np.ndarray, scale: np.ndarray) -> np.ndarray:
    x, y, z, w = rotation / np.linalg.norm(rotation)
    r = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = r * scale, translation
    return out
