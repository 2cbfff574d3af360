"""glTF 2.0 binary files: a skinned, animated H-Anim figure as other programs play it.

Bridge (own derivation from ISO/IEC 19774-1 and the glTF 2.0 specification): with M_j the joint matrix in humanoid space
and c_j its centre, the node of a joint stands at G_j = M_j T(c_j), so its local transform is
T(translation + c_j - c_parent) R(rotation) R(so) S R(so)^-1, and its inverse bind matrix is T(-c_j).
glTF players skin linearly, with four influences: what that changes is measured and reported, never hidden.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from vitruvian.body.rotations import from_matrix, to_matrix
from vitruvian.body.seams import creases, face_normals, split_seams
from vitruvian.body.types import Body, Floats, Part, Skeleton, Skin
from vitruvian.errors import VitruvianError
from vitruvian.formats.gltf_buffer import INDICES, VERTICES, Document
from vitruvian.formats.gltf_skin import limit, measure
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
    thing: Clip | Humanoid | Body | Mesh, path: str | os.PathLike[str], *, influences: int = 4
) -> dict[str, Any]:
    """Write a Clip, Humanoid, Body or Mesh as GLB and report what the format could not carry.

    influences: joints per vertex, 4 (every player) or 8 (JOINTS_1, WEIGHTS_1, which many players ignore).
    The report: `vertices triangles joints bytes`; `pruned_weights` vertices that lost influences,
    `largest_dropped_weight`; `max_vertex_error_m` and `rms_vertex_error_m` of that over `poses` poses (rest and every
    frame, or 100 random ones); `deformer` and `deformer_difference_m`, the largest distance between the clip's own
    deformer and the linear skin that players show; `displacer_error_m`; `lost`, a list of sentences.
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
    report: dict[str, Any] = {"vertices": 0, "triangles": 0, "joints": len(body.skeleton), "lost": []}
    nodes = Nodes(doc, body, humanoid)
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
    report["bytes"] = doc.write(path)
    return report


class Nodes:
    """The joints as nodes. Attributes: `root` the humanoid's node, `joint` (J,) nodes that are animated, `bone` (J,)
    nodes the skin follows (the same unless a joint has a helper node), `static` a node that never moves."""

    def __init__(self, doc: Document, body: Body, humanoid: Humanoid | None):
        self.doc, self.skeleton = doc, body.skeleton
        s = body.skeleton
        self.helpers: list[str] = []
        self.spin = np.tile([0.0, 0, 0, 1], (len(s), 1))  # multiplied on the right of every animated rotation
        about = _about(humanoid)
        self.root, inner = self._placement(body, humanoid)
        self.joint: list[int] = []
        self.bone: list[int] = []
        turn = to_matrix(s.scale_orientation)
        rotation = to_matrix(s.rotation)
        local = s.translation + s.centers - np.where(s.parents[:, None] >= 0, s.centers[s.parents], 0)
        for j, name in enumerate(s.names):
            node: dict[str, Any] = {"name": name or f"joint_{j}"}
            stretch = s.scale[j]
            matrix = rotation[j]
            plain = np.ptp(stretch) < 1e-9 * np.abs(stretch).max() or np.allclose(
                turn[j] @ np.diag(stretch) @ turn[j].T, np.diag(stretch), atol=1e-12
            )
            if not plain:
                self.spin[j] = s.scale_orientation[j]
                matrix = matrix @ turn[j]
            _set(node, local[j], from_matrix(matrix), stretch)
            extras = {**_limits(s, j), **about.get(name, {})}
            if extras:
                node["extras"] = {"hanim": extras}
            index = doc.append("nodes", node)
            self.joint.append(index)
            if not plain:
                self.helpers.append(name)
                back = from_matrix(turn[j].T)
                helper = doc.append("nodes", {"name": f"{name}_frame", "rotation": [float(x) for x in back]})
                node["children"] = [helper]
                index = helper
            self.bone.append(index)
            parent = inner if s.parents[j] < 0 else self.bone[s.parents[j]]
            self._hang(parent, self.joint[j])
        for name, j, point in zip(s.site_names, s.site_joints, s.site_points):
            node = {"name": name or "site", "extras": {"hanim": {"node": "Site"}}}
            _set(node, point - s.centers[j], np.array([0, 0, 0, 1.0]), np.ones(3))
            self._hang(self.bone[j], doc.append("nodes", node))
        self.inner = inner
        self._static: int | None = None

    def _hang(self, parent: int, child: int) -> None:
        self.doc.root["nodes"][parent].setdefault("children", []).append(child)

    @property
    def static(self) -> int:
        if self._static is None:
            self._static = self.doc.append("nodes", {"name": "static"})
            self._hang(self.inner, self._static)
        return self._static

    def _placement(self, body: Body, humanoid: Humanoid | None) -> tuple[int, int]:
        """The Humanoid's own transform: one node, or two when it shears (placement = T U S, then V^T)."""
        extras: dict[str, Any] = {"node": "Humanoid"}
        if humanoid is not None:
            extras.update(version=humanoid.version, loa=int(humanoid.loa))
            if humanoid.info:
                extras["info"] = dict(humanoid.info)
        node: dict[str, Any] = {"name": body.name or "humanoid", "extras": {"hanim": extras}}
        linear = body.placement[:3, :3]
        length = np.linalg.norm(linear, axis=0)
        index = self.doc.append("nodes", node)
        unit = linear / np.where(length > 0, length, 1)
        if np.linalg.det(linear) > 0 and np.allclose(unit.T @ unit, np.eye(3), atol=1e-9):
            _set(node, body.placement[:3, 3], from_matrix(unit), length)
            return index, index
        u, stretch, vt = np.linalg.svd(linear)
        if np.linalg.det(u) < 0:
            u[:, 2], stretch[2] = -u[:, 2], -stretch[2]
        if np.linalg.det(vt) < 0:
            vt[2], stretch[2] = -vt[2], -stretch[2]
        _set(node, body.placement[:3, 3], from_matrix(u), stretch)
        inner = {"name": f"{node['name']}_frame"}
        _set(inner, np.zeros(3), from_matrix(vt), np.ones(3))
        second = self.doc.append("nodes", inner)
        node["children"] = [second]
        return index, second


def _set(node: dict[str, Any], translation: Floats, rotation: Floats, scale: Floats) -> None:
    """TRS of a node; what is the default stays out."""
    if np.abs(translation).max() > 0:
        node["translation"] = [float(np.float32(x)) for x in translation]
    q = np.asarray(rotation, np.float64) / np.linalg.norm(rotation)
    if abs(q[3]) < 1 - 1e-15:
        node["rotation"] = [float(x) for x in q]
    if np.abs(scale - 1).max() > 0:
        node["scale"] = [float(x) for x in scale]


def _limits(s: Skeleton, j: int) -> dict[str, Any]:
    out: dict[str, Any] = {}
    limit = s.limits[j]
    if np.isfinite(limit).all():
        out["llimit"], out["ulimit"] = [float(x) for x in limit[:, 0]], [float(x) for x in limit[:, 1]]
        if abs(s.limit_orientation[j, 3]) < 1 - 1e-12:
            out["limitOrientation"] = [float(x) for x in s.limit_orientation[j]]
    if s.stiffness[j].any():
        out["stiffness"] = [float(x) for x in s.stiffness[j]]
    return out


def _about(humanoid: Humanoid | None) -> dict[str, dict[str, Any]]:
    """What the arrays do not hold: the Segments of each joint with their masses."""
    out: dict[str, dict[str, Any]] = {}
    for joint in humanoid.joints() if humanoid is not None else []:
        segments = []
        for g in joint.segments:
            item: dict[str, Any] = {"name": g.name}
            if g.mass:
                item.update(mass=float(g.mass), centerOfMass=[float(x) for x in g.center_of_mass])
                if np.any(g.moments_of_inertia):
                    item["momentsOfInertia"] = [float(x) for x in np.ravel(g.moments_of_inertia)]
            segments.append(item)
        if segments:
            out[joint.name] = {"segments": segments}
    return out


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
    joints, weights, facts = limit(skin.weights, len(skeleton), influences)
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
    mesh = _mesh(doc, "body", skin, triangles, attributes, uv is not None)
    if skin.morphs:
        _morphs(doc, mesh, skin, source, report)
    report.update(vertices=len(source), triangles=int(len(triangles)))
    index = doc.append("skins", {
        "joints": bones, "skeleton": nodes.root, "inverseBindMatrices": doc.add(inverse),
    })  # fmt: skip
    return doc.append("nodes", {"name": "body", "mesh": doc.append("meshes", mesh), "skin": index})


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
    return out


def _colors(doc: Document, srgb: Floats) -> int:
    rgba = np.concatenate([_linear(srgb), np.ones((len(srgb), 1))], -1)
    return doc.add(np.round(rgba * 65535), np.uint16, target=VERTICES, normalized=True)


def _mesh(
    doc: Document, name: str, skin: Skin, triangles: NDArray, attributes: dict[str, int], textured: bool
) -> dict[str, Any]:
    primitives = []
    picture = None
    for part in skin.parts:
        faces = triangles[part.start : part.stop]
        whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        faces = faces[whole]
        if not len(faces):
            continue
        if textured and picture is None:
            view = doc.view(np.frombuffer(_WHITE, np.uint8))
            image = doc.append("images", {"bufferView": view, "mimeType": "image/png", "name": "white"})
            picture = doc.append("textures", {"source": image})
        material = _material(part, skin.colors is not None)
        if picture is not None:
            material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": picture}
        small = np.uint16 if triangles.max() < 0xFFFF else np.uint32
        primitives.append({
            "attributes": attributes, "indices": doc.add(faces.reshape(-1), small, target=INDICES),
            "material": doc.append("materials", material),
        })  # fmt: skip
    if not primitives:
        raise VitruvianError("GLB: expected at least one triangle with three different corners, found none")
    return {"name": name, "primitives": primitives}


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
    return out


def _morphs(doc: Document, mesh: dict[str, Any], skin: Skin, source: NDArray, report: dict[str, Any]) -> None:
    """Displacers as morph targets. Drawn vertices are in the order of skin vertices, so each has one run of copies."""
    first = np.searchsorted(source, np.arange(len(skin.rest) + 1))
    targets, names, weights = [], [], []
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
        weights.append(float(morph.weight))
    if targets:
        for primitive in mesh["primitives"]:
            primitive["targets"] = targets
        mesh["weights"] = weights
        mesh["extras"] = {"targetNames": names}


def _animate(
    doc: Document, body: Body, motion: Motion, nodes: Nodes, mesh_node: int | None, report: dict[str, Any]
) -> None:
    """Rotations of all joints that move and translations, linear between the frames; a loop is closed."""
    from vitruvian.body.rotations import multiply

    s, n = body.skeleton, len(motion)
    closed = motion.loop and n > 1
    times = np.arange(n + closed) / motion.fps
    rotation = multiply(motion.rotation, nodes.spin) if nodes.helpers else motion.rotation
    if closed:
        last = np.where((rotation[0] * rotation[-1]).sum(-1, keepdims=True) < 0, -rotation[0], rotation[0])
        rotation = np.concatenate([rotation, last[None]])
    moves = np.repeat(s.translation[None], n, axis=0)
    if motion.joint_translation is not None:
        moves = motion.joint_translation
    else:
        moves[:, 0] = motion.translation
    if closed:
        moves = np.concatenate([moves, moves[-1:] + (moves[-1:] - moves[-2:-1])])
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
    mesh = doc.root["meshes"][doc.root["nodes"][mesh_node]["mesh"]] if mesh_node is not None else {}
    names = mesh.get("extras", {}).get("targetNames", [])
    if any(name in motion.weights for name in names):
        each = [motion.weights.get(name, np.full(n, w)) for name, w in zip(names, mesh["weights"])]
        values = np.stack(each, -1)
        assert mesh_node is not None
        track(mesh_node, "weights", np.concatenate([values, values[:1]]) if closed else values)
    missing = [name for name in motion.weights if name not in names]
    if missing:
        report["lost"].append(
            f"the motion of {len(missing)} displacers without a morph target: {', '.join(missing[:5])}"
        )
    if channels:
        doc.append("animations", {"name": motion.name or "motion", "channels": channels, "samplers": samplers})


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
    item = _mesh(doc, mesh.name or "object", skin, triangles, attributes, uv is not None)
    node = doc.append("nodes", {"name": mesh.name or "object", "mesh": doc.append("meshes", item)})
    doc.root["scenes"] = [{"nodes": [node]}]
    doc.root["scene"] = 0
    lost: list[str] = []
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
