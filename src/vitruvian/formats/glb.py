"""glTF 2.0 binary files: a skinned, animated H-Anim figure as other programs play it.

Bridge (own derivation from ISO/IEC 19774-1 and the glTF 2.0 specification): with M_j the joint matrix in humanoid space
and c_j its centre, the node of a joint stands at G_j = M_j T(c_j), so its local transform is
T(translation + c_j - c_parent) R(rotation) R(so) S R(so)^-1, and its inverse bind matrix is T(-c_j).
glTF players skin linearly, with four influences: what that changes is measured and reported, never hidden.
"""

from __future__ import annotations

import os
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.seams import creases, face_normals, split_seams
from vitruvian.body.types import Body, Floats, Part, Skin
from vitruvian.errors import VitruvianError
from vitruvian.formats.gltf_buffer import INDICES, VERTICES, Document
from vitruvian.formats.gltf_nodes import Nodes
from vitruvian.formats.gltf_skin import limit, measure
from vitruvian.formats.pictures import Addresses, content, transparent
from vitruvian.hanim.humanoid import Picture
from vitruvian.motion.types import Motion
from vitruvian.stage.clip import Clip, Mesh

if TYPE_CHECKING:
    from vitruvian.hanim.humanoid import Humanoid

# one white pixel, so that texture coordinates have a material that uses them: put your own picture there
_WHITE = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010802000000907753de"
    "0000000c49444154789c63f8ffff3f0005fe02fe0def46b80000000049454e44ae426082"
)


def write_glb(
    thing: Clip | Humanoid | Body | Mesh, path: str | os.PathLike[str], *, influences: int = 4, tolerance: float = 0.002
) -> dict[str, Any]:
    """Write a Clip, Humanoid, Body or Mesh as GLB and report what the format could not carry.

    influences: joints per vertex, 4 (every player) or 8 (JOINTS_1, WEIGHTS_1, which many players ignore). tolerance:
    metres that points of the clip's caches may be off in any frame, see `formats.gltf_cloth`.
    The report: `vertices triangles joints bytes`; `pruned_weights` vertices that lost influences and
    `largest_dropped_weight`, what the largest leave out at most; `max_vertex_error_m` and `rms_vertex_error_m` of that
    over `poses` poses (rest and every frame, or 100 random ones); `deformer` and `deformer_difference_m`, the largest
    distance between the clip's own deformer and the linear skin that players show; `displacer_error_m`; `cloth`, of each
    cache its `name frames points shapes max_error_m tolerance_m closing_m`; `lost`, a list of sentences.
    Raises `VitruvianError` when there is nothing to write or `influences` is neither 4 nor 8.
    """
    if influences not in (4, 8):
        raise VitruvianError(f"influences: expected 4 or 8, found {influences}")
    if isinstance(thing, Mesh):
        return _write_mesh(thing, path)
    humanoid: Humanoid | None = None
    motion: Motion | None = None
    deformer = "linear"
    if isinstance(thing, Clip):
        humanoid, body, motion, deformer = thing.humanoid, thing.body, thing.motion, thing.deformer
    elif isinstance(thing, Body):
        body = thing
    else:
        from vitruvian.hanim.humanoid import Humanoid as Tree

        if not isinstance(thing, Tree):
            raise VitruvianError(f"GLB: expected a Clip, Humanoid, Body or Mesh, found {type(thing).__name__}")
        from vitruvian.body.pack import pack

        humanoid, body = thing, pack(thing)
    doc = Document()
    report, nodes, _ = figure(doc, body, humanoid, motion, deformer, influences)
    for cache in thing.caches if isinstance(thing, Clip) else ():
        from vitruvian.formats.gltf_cloth import wear

        node, facts = wear(doc, nodes, body, motion, cache, partial(_drawn, doc, cache.name, report["lost"]), tolerance)
        doc.root["scenes"][0]["nodes"].append(node)
        report.setdefault("cloth", []).append(facts)
    report["bytes"] = doc.write(path)
    return report


def figure(
    doc: Document, body: Body, humanoid: Humanoid | None, motion: Motion | None, deformer: str, influences: int
) -> tuple[dict[str, Any], Nodes, int | None]:
    """A figure as the scene of a document: the report of `write_glb`, its nodes, the node of its mesh if it has one."""
    report: dict[str, Any] = {"vertices": 0, "triangles": 0, "joints": len(body.skeleton), "lost": []}
    nodes = Nodes(doc, body, humanoid, None if motion is None else motion.joint_scale)
    roots = [nodes.root]
    mesh_node = None
    if len(body.skin.triangles):
        mesh_node = _skinned(doc, body, motion, nodes, influences, deformer, report)
        roots.append(mesh_node)
    if motion is not None:
        _animate(doc, body, motion, nodes, mesh_node, report)
    if nodes.helpers:
        report["lost"].append(
            f"{len(nodes.helpers)} joints are scaled along turned axes and got a helper node each: "
            + ", ".join(nodes.helpers[:5])
        )
    doc.root["scenes"] = [{"name": body.name or "humanoid", "nodes": roots}]
    doc.root["scene"] = 0
    return report, nodes, mesh_node


def _skinned(
    doc: Document, body: Body, motion: Motion | None, nodes: Nodes, influences: int, deformer: str,
    report: dict[str, Any],
) -> int:  # fmt: skip
    skin, skeleton = body.skin, body.skeleton
    source, triangles, uv = split_seams(skin)
    normals = _normals(skin.rest, skin.triangles)[source]
    edges = creases(skin.rest, skin.triangles, skin.parts)
    if edges is not None:
        source, triangles, uv, normals = _split_creases(edges, skin, source, triangles, uv)
    joints, weights, facts = limit(body, influences, None if motion is None else joint_matrices(skeleton, motion))
    report.update(facts)
    report.update(measure(body, motion, joints, weights, deformer))
    inverse = np.tile(np.eye(4), (len(skeleton), 1, 1))
    inverse[:, :3, 3] = -skeleton.centers
    if skeleton.binding is not None:
        inverse = inverse @ skeleton.binding
    bones = list(nodes.bone)
    if joints.max() >= len(skeleton):  # the part of the weights that stays at rest
        bones.append(nodes.static)
        inverse = np.concatenate([inverse, np.eye(4)[None]])
    attributes = _attributes(doc, skin, source, uv, normals)
    narrow = np.uint8 if len(bones) <= 256 else np.uint16
    for k in range(influences // 4):
        some = slice(4 * k, 4 * k + 4)
        attributes[f"JOINTS_{k}"] = doc.add(joints[source, some], narrow, target=VERTICES)
        attributes[f"WEIGHTS_{k}"] = doc.add(weights[source, some], target=VERTICES)
    mesh = _mesh(doc, "body", skin, triangles, attributes, uv is not None, report["lost"])
    if skin.morphs:
        _morphs(doc, mesh, body, source, report)
    report.update(vertices=len(source), triangles=int(len(triangles)))
    index = doc.append("skins", {
        "joints": bones, "skeleton": nodes.root, "inverseBindMatrices": doc.add(inverse),
    })  # fmt: skip
    return doc.append("nodes", {"name": "body", "mesh": doc.append("meshes", mesh), "skin": index})


def _drawn(
    doc: Document, name: str, lost: list[str], skin: Skin, source: NDArray, triangles: NDArray, uv: NDArray | None,
    normals: Floats,
) -> dict[str, Any]:  # fmt: skip
    """A mesh of drawn vertices `source` of a surface."""
    return _mesh(doc, name, skin, triangles, _attributes(doc, skin, source, uv, normals), uv is not None, lost)


def _split_creases(
    edges: csr_array, skin: Skin, source: NDArray, triangles: NDArray, uv: NDArray | None
) -> tuple[NDArray, NDArray, NDArray | None, Floats]:
    """Drawn vertices doubled where their corners have different normals: source, triangles, uv and normals."""
    normal = edges @ face_normals(skin.rest, skin.triangles)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 1e-30, normal / np.where(length > 1e-30, length, 1), [0.0, 1.0, 0.0])
    key = np.concatenate([triangles.reshape(-1, 1), np.round(normal * 1024)], axis=1)
    unique, first, where = np.unique(key, axis=0, return_index=True, return_inverse=True)
    drawn = unique[:, 0].astype(np.int64)
    return (
        source[drawn], where.reshape(-1, 3).astype(np.int32), None if uv is None else uv[drawn], normal[first],
    )  # fmt: skip


def _attributes(doc: Document, skin: Skin, source: NDArray, uv: NDArray | None, normals: Floats) -> dict[str, int]:
    rest = skin.rest[source]
    out = {"POSITION": doc.add(rest, target=VERTICES, bounds=True)}
    out["NORMAL"] = doc.add(normals, target=VERTICES)
    if uv is not None:
        flipped = np.stack([uv[:, 0], 1 - uv[:, 1]], -1)  # glTF counts from the top of the picture
        out["TEXCOORD_0"] = doc.add(flipped, target=VERTICES)
    if skin.colors is not None:
        out["COLOR_0"] = _colors(doc, skin.colors[source])
    if len(rest) < 1 << 24:  # which copies are one point, for our reader
        out["_POINT"] = doc.add(source, target=VERTICES)
    return out


def _colors(doc: Document, srgb: Floats) -> int:
    rgba = np.concatenate([_linear(srgb), np.ones((len(srgb), 1))], -1)
    return doc.add(np.round(rgba * 65535), np.uint16, target=VERTICES, normalized=True)


def _mesh(
    doc: Document, name: str, skin: Skin, triangles: NDArray, attributes: dict[str, int], textured: bool,
    lost: list[str],
) -> dict[str, Any]:  # fmt: skip
    primitives = []
    pictures = _Pictures(doc)
    for part in skin.parts:
        faces = triangles[part.start : part.stop]
        whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        faces = faces[whole]
        if not len(faces):
            continue
        material = _material(part, skin.colors is not None)
        if textured:
            pictures.put(material, part.picture)
        small = np.uint16 if triangles.max() < 0xFFFF else np.uint32
        primitives.append({
            "attributes": attributes, "indices": doc.add(faces.reshape(-1), small, target=INDICES),
            "material": doc.append("materials", material),
        })  # fmt: skip
    if not primitives:
        raise VitruvianError("GLB: expected at least one triangle with three different corners, found none")
    lost += pictures.lost()
    return {"name": name, "primitives": primitives}


class _Pictures:
    """The pictures of one document, each once; a white pixel where a surface has coordinates but no picture."""

    def __init__(self, doc: Document):
        self.doc = doc
        self.known: dict[Picture, tuple[int, bool]] = {}
        self.missing = Addresses("", beside=False)

    def put(self, material: dict[str, Any], picture: Picture | None) -> None:
        """Give a material its base colour texture."""
        white = Picture("white", _WHITE)
        found = content(picture) if picture is not None and picture not in self.known else None
        if picture is None or (found is None and picture not in self.known):
            if picture is not None:
                self.missing.miss(picture)
            picture, found = white, (_WHITE, "image/png")
        if picture not in self.known and found is not None:
            self.known[picture] = self._texture(picture, *found)
        texture, holes = self.known[picture]
        material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": texture}
        if holes and picture.alpha and "alphaMode" not in material:
            material["alphaMode"] = picture.alpha.upper()

    def _texture(self, picture: Picture, data: bytes, mime: str) -> tuple[int, bool]:
        """The index of a picture's texture, and whether it can be transparent."""
        view = self.doc.view(np.frombuffer(data, np.uint8))
        name = picture.name or "picture"
        image = self.doc.append("images", {"bufferView": view, "mimeType": mime, "name": name})
        texture = {"source": image}
        if picture.repeat != (True, True):
            wrap = dict(zip(("wrapS", "wrapT"), (10497 if on else 33071 for on in picture.repeat)))
            texture["sampler"] = self.doc.append("samplers", wrap)
        return self.doc.append("textures", texture), transparent(data)

    def lost(self) -> list[str]:
        return self.missing.lost()


def _material(part: Part, colored: bool) -> dict[str, Any]:
    color = [1.0, 1.0, 1.0] if colored else [float(x) for x in _linear(np.asarray(part.color, np.float64))]
    out: dict[str, Any] = {
        "name": part.name or "body",
        "pbrMetallicRoughness": {
            "baseColorFactor": [*color, float(np.clip(part.opacity, 0, 1))],
            "metallicFactor": float(np.clip(part.metallic, 0, 1)),
            "roughnessFactor": float(np.clip(part.roughness, 0, 1)),
        },
    }
    if part.opacity < 1:
        out["alphaMode"] = "BLEND"
    if part.double_sided:
        out["doubleSided"] = True
    if part.crease < np.pi:
        out["extras"] = {"hanim": {"creaseAngle": float(part.crease)}}
    return out


def _morphs(doc: Document, mesh: dict[str, Any], body: Body, source: NDArray, report: dict[str, Any]) -> None:
    """Displacers as morph targets. Drawn vertices are in the order of skin vertices, so each has one run of copies."""
    skin = body.skin
    first = np.searchsorted(source, np.arange(len(skin.rest) + 1))
    targets, names, weights, owners = [], [], [], []
    for morph in skin.morphs:
        total = np.zeros((len(skin.rest), 3))
        np.add.at(total, morph.index, morph.offset)
        moved = np.flatnonzero(total.any(axis=1))
        drawn = np.concatenate([np.arange(first[v], first[v + 1]) for v in moved]) if len(moved) else moved
        if not len(drawn):
            report["lost"].append(f"displacer {morph.name} moves no drawn vertex and was left out")
            continue
        targets.append({"POSITION": doc.add_sparse(len(source), drawn, total[source[drawn]])})
        names.append(morph.name)
        owner: dict[str, Any] = {"joint": body.skeleton.names[morph.joint]}
        if morph.drive is not None:
            d = morph.drive
            owner["driver"] = {"joint": body.skeleton.names[d.joint], "axis": d.axis.tolist(),
                               "angles": d.angles.tolist(), "weights": d.weights.tolist()}  # fmt: skip
        owners.append(owner)
        weights.append(float(morph.weight))
    led = sum("driver" in owner for owner in owners)
    if led:
        report["lost"].append(f"{led} displacers follow a joint's angle, which other programs do not know")
    if targets:
        for primitive in mesh["primitives"]:
            primitive["targets"] = targets
        mesh["weights"] = weights
        mesh["extras"] = {"targetNames": names, "hanim": {"displacers": owners}}


def _animate(
    doc: Document, body: Body, motion: Motion, nodes: Nodes, mesh_node: int | None, report: dict[str, Any]
) -> None:
    """Rotations of all joints that move and translations, linear between the frames; a loop is closed."""
    from vitruvian.body.rotations import multiply
    from vitruvian.motion.tracks import frames_to_write, scales_to_write

    s = body.skeleton
    rotation, moves, given = frames_to_write(motion)
    scale = scales_to_write(motion)
    times = np.arange(len(rotation)) / motion.fps
    if nodes.helpers:
        rotation = multiply(rotation, nodes.spin)
    moves = moves + s.centers - np.where(s.parents[:, None] >= 0, s.centers[s.parents], 0)
    channels: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []
    clock: dict[int, int] = {}

    def track(node: int, path: str, values: NDArray) -> None:
        flat = values.reshape(len(times), -1)
        count = 1 if (np.abs(flat - flat[:1]) < 1e-9).all() else len(times)
        values = (flat.reshape(-1) if path == "weights" else flat)[
            : count * (flat.shape[1] if path == "weights" else 1)
        ]
        if count not in clock:
            clock[count] = doc.add(times[:count], bounds=True)
        samplers.append({"input": clock[count], "interpolation": "LINEAR", "output": doc.add(values)})
        channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})

    for j in range(len(s)):
        node = doc.root["nodes"][nodes.joint[j]]
        if np.abs(rotation[:, j] - np.asarray(node.get("rotation", [0, 0, 0, 1]))).max() > 1e-9:
            track(nodes.joint[j], "rotation", rotation[:, j])
        if np.abs(moves[:, j] - np.asarray(node.get("translation", [0, 0, 0]))).max() > 1e-6:
            track(nodes.joint[j], "translation", moves[:, j])
        if scale is not None and np.abs(scale[:, j] - s.scale[j]).max() > 1e-7:
            track(nodes.joint[j], "scale", scale[:, j])
    mesh = doc.root["meshes"][doc.root["nodes"][mesh_node]["mesh"]] if mesh_node is not None else {}
    names = mesh.get("extras", {}).get("targetNames", [])
    if any(name in motion.weights for name in names):
        each = [given.get(name, np.full(len(rotation), w)) for name, w in zip(names, mesh["weights"])]
        assert mesh_node is not None
        track(mesh_node, "weights", np.stack(each, -1))
    missing = [name for name in motion.weights if name not in names]
    if missing:
        report["lost"].append(
            f"the motion of {len(missing)} displacers without a morph target: {', '.join(missing[:5])}"
        )
    if channels:
        about = {"hanim": {"fps": float(motion.fps), "loop": bool(motion.loop)}}
        name = motion.name or "motion"
        doc.append("animations", {"name": name, "channels": channels, "samplers": samplers, "extras": about})


def _write_mesh(mesh: Mesh, path: str | os.PathLike[str]) -> dict[str, Any]:
    from vitruvian.body.types import Weights

    scale = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}.get(mesh.unit, 1.0)
    n = len(mesh.vertices)
    nothing = Weights(np.zeros(n + 1, np.int32), np.zeros(0, np.int32), np.zeros(0))
    part = Part(mesh.name, 0, len(mesh.triangles))
    seams = mesh.triangles if mesh.uv is not None and mesh.uv_triangles is None else mesh.uv_triangles
    skin = Skin(mesh.vertices * scale, mesh.triangles, nothing, mesh.uv, seams, mesh.colors, (part,))
    doc = Document()
    source, triangles, uv = split_seams(skin)
    attributes = _attributes(doc, skin, source, uv, _normals(skin.rest, skin.triangles)[source])
    lost: list[str] = []
    item = _mesh(doc, mesh.name or "object", skin, triangles, attributes, uv is not None, lost)
    node = doc.append("nodes", {"name": mesh.name or "object", "mesh": doc.append("meshes", item)})
    doc.root["scenes"] = [{"nodes": [node]}]
    doc.root["scene"] = 0
    return {
        "vertices": len(source),
        "triangles": len(mesh.triangles),
        "joints": 0,
        "lost": lost,
        "bytes": doc.write(path),
    }


def _normals(vertices: Floats, triangles: NDArray) -> Floats:
    """Smooth unit normals (V,3); +Y where a vertex has no face with an area."""
    face = face_normals(vertices, triangles)
    flat = triangles.T.reshape(-1)
    total = np.stack([np.bincount(flat, np.tile(face[:, i], 3), minlength=len(vertices)) for i in range(3)], -1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 1e-30, total / np.where(length > 1e-30, length, 1), [0.0, 1.0, 0.0])


def _linear(srgb: Floats) -> Floats:
    c = np.clip(srgb, 0, 1)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
