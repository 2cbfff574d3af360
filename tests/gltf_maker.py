"""glTF files for tests, written from the specification and not with the package's own writer; and a foreign rig."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from vitruvian.hanim.tables import default_centers

TYPES = {"b": 5120, "B": 5121, "h": 5122, "H": 5123, "I": 5125, "f": 5126}
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Maker:
    """A document under construction: `json`, and `add` for arrays."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {"asset": {"version": "2.0", "generator": "test"}}
        self.bin = bytearray()

    def put(self, kind: str, item: dict[str, Any]) -> int:
        self.json.setdefault(kind, []).append(item)
        return len(self.json[kind]) - 1

    def view(self, data: bytes, **more: Any) -> int:
        self.bin += bytes(-len(self.bin) % 4)
        item = {"buffer": 0, "byteOffset": len(self.bin), "byteLength": len(data), **more}
        self.bin += data
        return self.put("bufferViews", item)

    def add(self, values: Any, dtype: str = "f", *, stride: int = 0, offset: int = 0, **more: Any) -> int:
        """An accessor of values (n,), (n,k) or (n,4,4); `stride` and `offset` leave gaps of rubbish."""
        data = np.asarray(values)
        if data.ndim == 3:
            data = data.transpose(0, 2, 1).reshape(len(data), 16)
        flat = np.ascontiguousarray(data, np.dtype("<" + dtype))
        width = 1 if flat.ndim == 1 else flat.shape[1]
        rows = [r.tobytes() for r in flat.reshape(len(flat), -1)]
        if stride:
            rows = [r + b"\x7f" * (stride - len(r)) for r in rows]
            more_view = {"byteStride": stride}
        else:
            more_view = {}
        view = self.view(b"\x7f" * offset + b"".join(rows), **more_view)
        item = {"bufferView": view, "componentType": TYPES[dtype], "count": len(flat), "type": KINDS[width], **more}
        if offset:
            item["byteOffset"] = offset
        return self.put("accessors", item)

    def sparse(self, count: int, index: Any, values: Any, base: int | None = None, dtype: str = "H") -> int:
        values = np.asarray(values, "<f4")
        item: dict[str, Any] = {"componentType": 5126, "count": count, "type": KINDS[values.shape[1]]}
        if base is not None:
            item["bufferView"] = self.json["accessors"][base]["bufferView"]
        where = self.view(np.asarray(index, "<" + dtype).tobytes())
        item["sparse"] = {
            "count": len(values), "indices": {"bufferView": where, "componentType": TYPES[dtype]},
            "values": {"bufferView": self.view(values.tobytes())},
        }  # fmt: skip
        return self.put("accessors", item)

    def glb(self, path: Path) -> Path:
        self.json["buffers"] = [{"byteLength": len(self.bin)}] if self.bin else []
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        self.bin += bytes(-len(self.bin) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        if self.bin:
            chunks += struct.pack("<II", len(self.bin), 0x004E4942) + bytes(self.bin)
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return path

    def gltf(self, path: Path, *, beside: str = "", claim: str = "") -> Path:
        """JSON with the bytes as a data URI, or in the file `beside` it; `claim` is a uri that nothing is written to."""
        uri = claim or beside or "data:application/octet-stream;base64," + base64.b64encode(bytes(self.bin)).decode()
        self.json["buffers"] = [{"byteLength": len(self.bin), "uri": uri}]
        if beside:
            target = (path.parent / beside).resolve()
            assert target.is_relative_to(path.parent.resolve()), "tests write into their own folder only"
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(bytes(self.bin))
        path.write_text(json.dumps(self.json))
        return path


# H-Anim joint, Mixamo bone, parent bone
BONES = [
    ("humanoid_root", "Hips", ""), ("vl5", "Spine", "Hips"), ("vt10", "Spine1", "Spine"), ("vt6", "Spine2", "Spine1"),
    ("vc4", "Neck", "Spine2"), ("skullbase", "Head", "Neck"),
    *(
        (f"{s}_{joint}", side + bone, above if above in ("Hips", "Spine2") else side + above)
        for s, side in (("l", "Left"), ("r", "Right"))
        for joint, bone, above in (
            ("hip", "UpLeg", "Hips"), ("knee", "Leg", "UpLeg"), ("talocrural", "Foot", "Leg"),
            ("metatarsophalangeal_2", "ToeBase", "Foot"), ("sternoclavicular", "Shoulder", "Spine2"),
            ("shoulder", "Arm", "Shoulder"), ("elbow", "ForeArm", "Arm"), ("radiocarpal", "Hand", "ForeArm"),
            ("metacarpophalangeal_2", "HandIndex1", "Hand"),
            ("carpal_proximal_interphalangeal_2", "HandIndex2", "HandIndex1"),
        )
    ),
]  # fmt: skip


def t_centers() -> dict[str, np.ndarray]:
    """Joint centres of the default figure with the arms out: metres."""
    centers = default_centers()
    out = {}
    for joint, _, _ in BONES:
        c = np.array(centers[joint])
        sign = {"l": 1, "r": -1}.get(joint[0] if joint[1] == "_" else "", 0)
        pivot = np.array(centers[f"{joint[0]}_shoulder"]) if sign else c
        if sign and c[1] < pivot[1] and any(w in joint for w in ("elbow", "carp")):
            d = c - pivot
            c = pivot + [-sign * d[1], sign * d[0], d[2]]
        out[joint] = c
    return out


def trs(t: Any = (0, 0, 0), q: Any = (0, 0, 0, 1), s: float = 1.0) -> np.ndarray:
    x, y, z, w = np.asarray(q, float) / np.linalg.norm(q)
    out = np.eye(4)
    out[:3, :3] = s * np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    out[:3, 3] = t
    return out


ZUP = (-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))  # -90 degrees about X: Z up to Y up


class Foreign:
    """A rig as many exporters leave it: centimetres, Z up under a node that turns and scales it, bones with frames of
    their own, normals that split the surface, two primitives, bound in a T pose.

    `maker`; `bone` name -> node; `centers` (J,3) metres in the order of BONES; `points` (n,3) metres, split copies once.
    """

    def __init__(self, prefix: str = "mixamorig:", *, posed: bool = False, skin: bool = True) -> None:
        m = self.maker = Maker()
        rng = np.random.default_rng(7)
        centers = t_centers()
        self.centers = np.array([centers[j] for j, _, _ in BONES])
        armature = trs((0, 0, 0), ZUP, 0.01)
        self.root = m.put("nodes", {"name": "Armature", "rotation": list(ZUP), "scale": [0.01] * 3, "children": []})
        m.json["scenes"], m.json["scene"] = [{"nodes": [self.root]}], 0
        self.bone: dict[str, int] = {}
        bind: dict[str, np.ndarray] = {}
        for (_, name, above), c in zip(BONES, self.centers):
            q = rng.normal(size=4)
            place = np.linalg.inv(armature) @ np.append(c, 1)
            bind[name] = trs(place[:3], q)
            local = (np.linalg.inv(bind[above]) if above else np.eye(4)) @ bind[name]
            q = _quaternion(local[:3, :3])
            if posed and above:
                turn = np.append(rng.normal(size=3) * 0.1, 1)
                q = _quaternion(trs(q=turn)[:3, :3] @ local[:3, :3])
            node = {"name": prefix + name, "translation": local[:3, 3].tolist(), "rotation": q.tolist()}
            self.bone[name] = m.put("nodes", node)
            parent = self.root if not above else self.bone[above]
            m.json["nodes"][parent].setdefault("children", []).append(self.bone[name])
        self.bind = np.array([armature @ bind[n] for _, n, _ in BONES])
        if skin:
            self._surface(np.linalg.inv(armature), np.array([bind[n] for _, n, _ in BONES]))

    def _surface(self, to_mesh: np.ndarray, bind: np.ndarray) -> None:
        """A cube round every joint, each corner three times (its three normals), weights shared with the parent."""
        m = self.maker
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.03
        quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
        names = [n for _, n, _ in BONES]
        points, copies, normals, joints, weights, triangles = [], [], [], [], [], []
        for j, (c, (_, _, above)) in enumerate(zip(self.centers, BONES)):
            p = names.index(above) if above else j
            for quad in quads:
                a, b, d = (corners[quad[k]] for k in (0, 1, 3))
                n = np.cross(b - a, d - a)
                start = len(copies)
                for k in quad:
                    copies.append(c + corners[k])
                    normals.append(n / np.linalg.norm(n))
                    joints.append([j, p, 0, 0])
                    weights.append([0.75, 0.25, 0, 0] if p != j else [1, 0, 0, 0])
                triangles += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
            points += [c + k for k in corners]
        self.points = np.array(points)
        mesh = np.concatenate([copies, np.ones((len(copies), 1))], 1) @ to_mesh.T
        attributes = {
            "POSITION": m.add(mesh[:, :3]), "NORMAL": m.add(np.array(normals) @ to_mesh[:3, :3].T),
            "JOINTS_0": m.add(joints, "B"), "WEIGHTS_0": m.add(weights),
        }  # fmt: skip
        half = len(triangles) // 2
        parts = []
        for k, part in enumerate((triangles[:half], triangles[half:])):
            look = m.put(
                "materials", {"name": f"part {k}", "pbrMetallicRoughness": {"baseColorFactor": [0.2, 0.5, 1, 1]}}
            )
            parts.append({"attributes": attributes, "indices": m.add(np.ravel(part), "H"), "material": look})
        mesh_index = m.put("meshes", {"name": "cubes", "primitives": parts})
        inverse = m.add(np.linalg.inv(bind))
        skin = m.put("skins", {"joints": list(self.bone.values()), "inverseBindMatrices": inverse})
        self.node = m.put("nodes", {"name": "cubes", "mesh": mesh_index, "skin": skin})
        m.json["scenes"][0]["nodes"].append(self.node)

    def animate(self, times: Any, **paths: tuple[str, Any, str]) -> None:
        """An animation: bone=(path, values, interpolation)."""
        m = self.maker
        clock = m.add(np.asarray(times, float))
        samplers, channels = [], []
        for bone, (path, values, how) in paths.items():
            samplers.append({"input": clock, "output": m.add(values), "interpolation": how})
            node = self.root if bone == "Armature" else self.bone[bone]
            channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})
        m.put("animations", {"name": "move", "samplers": samplers, "channels": channels})


def _quaternion(r: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(r).as_quat()
