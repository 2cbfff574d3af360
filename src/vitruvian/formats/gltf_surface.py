"""Meshes of a glTF file as one skin of a figure, or as one Mesh: vertices that exporters split are points again.

Source: glTF 2.0, sections 3.7.2 (meshes, topology, morph targets) and 3.7.3 (skinned mesh attributes).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints
from vitruvian.formats.gltf_file import GltfFile
from vitruvian.formats.gltf_pictures import base, mapping, moved
from vitruvian.hanim.humanoid import Displacer, Material, Shape

Whole = NDArray[np.int64]
MAX_SETS = 4  # JOINTS_0 to JOINTS_3: sixteen influences
MAX_TARGETS = 2000
MAX_POINTS = 1 << 23  # vertices, and corners of triangles times three, of one figure
MAX_MOVES = 1 << 25  # offsets of morph targets
READ = ("POSITION", "COLOR_0", "_POINT", *(f"{a}_{k}" for a in ("TEXCOORD", "JOINTS", "WEIGHTS") for k in range(4)))
LEAST_MOVE = 1e-9  # metres: what a morph target moves less is rounding


@dataclass(eq=False)
class Block:
    """The vertices of one set of attributes, in the space of what they become part of.

    points (n,3), joints and weights (n,k); moves: target number -> (n,3); numbers: (n,) point of each as our own writer
    wrote it, or None.
    """

    points: Floats
    joints: Whole
    weights: Floats
    uv: Floats | None = None
    colors: Floats | None = None
    numbers: Whole | None = None
    moves: dict[int, Floats] = field(default_factory=dict)
    first: int = 0  # place of its first vertex among those of all blocks


@dataclass(eq=False)
class Surface:
    """Everything that one figure shows. `targets`: name, weight at rest, and the node and index it came from."""

    blocks: list[Block] = field(default_factory=list)
    pieces: list[tuple[Block, Whole, Material, str, float, bool]] = field(default_factory=list)
    targets: list[tuple[str, float]] = field(default_factory=list)
    named: dict[tuple[str, int], int] = field(default_factory=dict)
    origin: dict[tuple[int, int], int] = field(default_factory=dict)  # (node, index of target) -> target

    count: int = 0
    corners: int = 0
    moves: int = 0


def influences(file: GltfFile, attributes: dict[str, Any], slots: int, where: str) -> tuple[Whole, Floats]:
    """(n,k) entries of the skin and weights that sum to one; vertices without weight follow entry 0."""
    joints, weights = [], []
    for k in range(MAX_SETS):
        if f"JOINTS_{k}" not in attributes or f"WEIGHTS_{k}" not in attributes:
            break
        j = file.accessor(attributes[f"JOINTS_{k}"], ("VEC4",), f"{where} JOINTS_{k}", whole=True)
        w = file.accessor(attributes[f"WEIGHTS_{k}"], ("VEC4",), f"{where} WEIGHTS_{k}")
        if len(j) != len(w):
            file.bad(f"{where}: {len(j)} JOINTS_{k} but {len(w)} WEIGHTS_{k}")
        w = np.maximum(w, 0.0)
        wrong = (j >= slots) & (w > 0)
        if wrong.any():
            file.bad(f"{where} JOINTS_{k}: expected 0..{slots - 1}, found {int(j[wrong][0])}")
        joints.append(np.minimum(j, slots - 1))
        weights.append(w)
    if not joints:
        file.bad(f"{where}: a skinned mesh needs JOINTS_0 and WEIGHTS_0, found none")
    if len({len(j) for j in joints}) > 1:
        file.bad(f"{where}: expected as many JOINTS_1 as JOINTS_0")
    joint, weight = np.concatenate(joints, axis=1), np.concatenate(weights, axis=1)
    total = weight.sum(axis=1)
    weight[total <= 0, 0], joint[total <= 0, 0] = 1.0, 0
    return joint, weight / weight.sum(axis=1, keepdims=True)


def add_mesh(
    file: GltfFile, surface: Surface, node: int, matrix: Floats, slots: Whole, rest: Floats | None = None
) -> None:
    """The mesh of a node as part of a surface.

    Skinned with `rest` (s,4,4): each entry of the skin brings vertices to where they are bound, `slots` (s,) are its
    joints, -1 for what stays, and `matrix` is not used. Rigid without: moved by `matrix` (4,4), on joint slots[0].
    """
    nodes, meshes = file.items("nodes"), file.items("meshes")
    number = file.integer(nodes[node], "mesh", f"node {node}", len(meshes))
    mesh = meshes[number]
    targets = _targets(file, surface, node, mesh, number)
    ready: dict[tuple, Block] = {}
    for p, primitive in enumerate(file.objects(mesh, "primitives")):
        where = f"mesh {number} primitive {p}"
        mode = file.integer(primitive, "mode", where, 7, 4)
        attributes = file.object(primitive, "attributes")
        if mode < 4 or attributes.get("POSITION") is None:
            continue
        if "KHR_draco_mesh_compression" in file.object(primitive, "extensions"):
            file.bad(f"{where}: is compressed with KHR_draco_mesh_compression; export it without compression")
        shift = file.objects(primitive, "targets")
        if len(shift) > MAX_TARGETS:
            file.bad(f"{where}: expected at most {MAX_TARGETS} morph targets, found {len(shift)}")
        count = len(file.items("accessors"))
        plain = {k: file.integer(attributes, k, where, count) for k in READ if k in attributes}
        number_of, turned_by = mapping(file, primitive, where)
        plain = {k: v for k, v in plain.items() if k[:9] != "TEXCOORD_" or k == f"TEXCOORD_{number_of}"}
        key = (tuple(sorted(plain.items())), turned_by, tuple(str(t.get("POSITION"))[:20] for t in shift))
        if key not in ready:
            ready[key] = _block(file, plain, shift, targets, matrix, slots, rest, where)
            ready[key].uv = _coordinates(file, plain, turned_by, len(ready[key].points), where)
            ready[key].first = surface.count
            surface.blocks.append(ready[key])
            surface.count += len(ready[key].points)
            surface.moves += len(ready[key].points) * len(ready[key].moves)
        block = ready[key]
        triangles = _triangles(file, primitive, mode, len(block.points), where)
        surface.corners += triangles.size
        if surface.count > MAX_POINTS or surface.corners > 3 * MAX_POINTS or surface.moves > MAX_MOVES:
            file.bad(f"{where}: expected at most {MAX_POINTS} vertices and {MAX_MOVES} morph offsets in one figure")
        turned = np.linalg.det((rest[0] if rest is not None else matrix)[:3, :3]) < 0
        if turned:
            triangles = triangles[:, ::-1]
        material, crease = _material(file, primitive, where)
        title = material.name or file.text(mesh, "name") or file.name(node)
        surface.pieces.append((block, triangles, material, title, crease, "COLOR_0" in plain))


def _targets(file: GltfFile, surface: Surface, node: int, mesh: dict[str, Any], number: int) -> list[int]:
    """Numbers of a mesh's morph targets among those of the figure; equal names in different meshes are one."""
    primitives = file.objects(mesh, "primitives")
    count = max((len(file.objects(p, "targets")) for p in primitives), default=0)
    if not count:
        return []
    given = file.object(mesh, "extras").get("targetNames")
    given = given if isinstance(given, list) else []
    if len(given) != count and primitives:  # older exporters name them at the primitive
        other = file.object(primitives[0], "extras").get("targetNames")
        given = other if isinstance(other, list) else given
    holder = file.items("nodes")[node] if "weights" in file.items("nodes")[node] else mesh
    weights = holder.get("weights")
    rest = file.numbers(holder, "weights", f"mesh {number}", (0.0,) * count) if weights is not None else np.zeros(count)
    seen: dict[str, int] = {}
    out = []
    for i in range(count):
        name = given[i] if i < len(given) and isinstance(given[i], str) and given[i].strip() else ""
        name = " ".join(name.split())[:100] or f"{file.text(mesh, 'name') or f'mesh_{number}'}_{i}"
        again = seen.get(name, 0)
        seen[name] = again + 1
        if (name, again) not in surface.named:
            surface.named[name, again] = len(surface.targets)
            surface.targets.append((name, float(rest[i])))
        out.append(surface.named[name, again])
        surface.origin[node, i] = out[-1]
    return out


def _block(
    file: GltfFile, attributes: dict[str, int], shift: list[dict[str, Any]], targets: list[int], matrix: Floats,
    slots: Whole, rest: Floats | None, where: str,
) -> Block:  # fmt: skip
    position = file.accessor(attributes["POSITION"], ("VEC3",), f"{where} POSITION")
    n = len(position)
    if rest is not None:
        entry, weight = influences(file, attributes, len(slots), where)
        _same(file, entry, n, f"{where} JOINTS_0")
        one = bool((rest == rest[0]).all())
        move = rest[0] if one else np.einsum("nk,nkab->nab", weight, rest[entry])
        joint = slots[entry]
    else:
        joint, weight = np.full((n, 1), slots[0]), np.ones((n, 1))
        move = matrix
    block = Block(_moved(move, position, 1.0), joint, weight)
    for number, target in zip(targets, shift):
        if target.get("POSITION") is None:
            continue
        values = file.accessor(target["POSITION"], ("VEC3",), f"{where} target POSITION")
        _same(file, values, n, f"{where} target POSITION")
        block.moves[number] = _moved(move, values, 0.0)
    if "COLOR_0" in attributes:
        colors = file.accessor(attributes["COLOR_0"], ("VEC3", "VEC4"), f"{where} COLOR_0")
        _same(file, colors, n, f"{where} COLOR_0")
        block.colors = np.clip(colors[:, :3], 0, 1)
    if "_POINT" in attributes:
        points = file.accessor(attributes["_POINT"], ("SCALAR",), f"{where} _POINT")
        _same(file, points, n, f"{where} _POINT")
        block.numbers = np.round(points).astype(np.int64)
    return block


def _coordinates(
    file: GltfFile, attributes: dict[str, int], by: tuple[float, ...], count: int, where: str
) -> Floats | None:  # fmt: skip
    """(n,2) texture coordinates of the one set that is used, None without."""
    for name in [k for k in attributes if k.startswith("TEXCOORD_")]:
        uv = file.accessor(attributes[name], ("VEC2",), f"{where} {name}")
        _same(file, uv, count, f"{where} {name}")
        uv = moved(uv, by)
        return np.stack([uv[:, 0], 1 - uv[:, 1]], -1)  # glTF counts from the top of the picture
    return None


def _same(file: GltfFile, array: NDArray, count: int, where: str) -> None:
    if len(array) != count:
        file.bad(f"{where}: expected {count} entries, one per POSITION, found {len(array)}")


def _moved(matrix: Floats, points: Floats, w: float) -> Floats:
    """Points (w 1) or offsets (w 0), exact where the matrix is the identity."""
    if matrix.ndim == 2:
        if (matrix == np.eye(4)).all():
            return points
        x, y, z = points.T
        return np.stack([r[0] * x + r[1] * y + r[2] * z + w * r[3] for r in matrix[:3]], -1)
    return np.einsum("nab,nb->na", matrix[:, :3, :3], points) + w * matrix[:, :3, 3]


def _triangles(file: GltfFile, primitive: dict[str, Any], mode: int, count: int, where: str) -> Whole:
    """(t,3) corners of triangles, strips or fans; those with two equal corners are left out."""
    if primitive.get("indices") is None:
        index = np.arange(count)
    else:
        index = file.accessor(primitive["indices"], ("SCALAR",), f"{where} indices", whole=True)
        if index.max(initial=0) >= count:
            file.bad(f"{where} indices: expected 0..{count - 1}, found {int(index.max())}")
    if mode == 4:
        out = index[: len(index) // 3 * 3].reshape(-1, 3)
    elif len(index) < 3:
        out = np.zeros((0, 3), np.int64)
    elif mode == 5:
        out = np.stack([index[:-2], index[1:-1], index[2:]], -1)
        out[1::2] = out[1::2, [1, 0, 2]]
    else:
        out = np.stack([np.full(len(index) - 2, index[0]), index[1:-1], index[2:]], -1)
    return out[(out != np.roll(out, 1, axis=1)).all(axis=1)]


def _material(file: GltfFile, primitive: dict[str, Any], where: str) -> tuple[Material, float]:
    """How a primitive looks: factors and the picture of its base colour. And its crease angle if we wrote it."""
    if primitive.get("material") is None:
        return Material(color=(1.0, 1.0, 1.0), roughness=1.0), float(np.pi)
    materials = file.items("materials")
    k = file.integer(primitive, "material", where, len(materials))
    entry, where = materials[k], f"material {k}"
    look = file.object(entry, "pbrMetallicRoughness")
    tone = np.clip(file.numbers(look, "baseColorFactor", where, (1, 1, 1, 1)), 0, 1)
    glow = np.clip(file.numbers(entry, "emissiveFactor", where, (0, 0, 0)), 0, 1)
    crease = file.object(file.object(entry, "extras"), "hanim").get("creaseAngle")
    made = Material(
        file.text(entry, "name"),
        _triple(srgb(tone[:3])),
        file.share(look, "roughnessFactor", where),
        file.share(look, "metallicFactor", where),
        float(tone[3]) if entry.get("alphaMode") == "BLEND" else 1.0,
        _triple(srgb(glow)),
        entry.get("doubleSided") is True,
        picture=base(file, entry, where),
    )
    return made, float(crease) if isinstance(crease, int | float) and 0 <= crease <= np.pi else float(np.pi)


def _triple(color: Floats) -> tuple[float, float, float]:
    return (float(color[0]), float(color[1]), float(color[2]))


def srgb(linear: Floats) -> Floats:
    """Linear colours 0..1 as sRGB (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


# the pieces together


def weld(surface: Surface) -> tuple[Whole, Whole]:
    """(vertices,) point of each vertex of all blocks, (points,) first vertex of each point.

    One point where position (to a micrometre), weights and morphs agree, whatever normal, texture coordinate or colour
    the copies have; points that our own writer numbered keep their numbers. Points are in order of first use.
    """
    if surface.blocks and all(b.numbers is not None for b in surface.blocks):
        numbers = [b.numbers for b in surface.blocks if b.numbers is not None]
        keys: NDArray = np.concatenate([[np.full(len(n), i), n] for i, n in enumerate(numbers)], axis=1).T
    else:
        width = max((b.joints.shape[1] for b in surface.blocks), default=1)
        rng = np.random.default_rng(0)  # two random sums tell morphs apart: equal rows have equal sums
        mix = rng.uniform(0.5, 1.5, (max(len(surface.targets), 1), 3, 2))
        keys = np.concatenate([_key(b, width, mix) for b in surface.blocks])
    rows = np.ascontiguousarray(keys, np.int64).view(np.dtype((np.void, keys.shape[1] * 8)))[:, 0]
    _, first, where = np.unique(rows, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return rank[where.reshape(-1)], first[order]


def _key(block: Block, width: int, mix: Floats) -> Whole:
    """(n,c) integers that are equal where vertices are copies of one point."""
    weight = np.round(block.weights * 10000).astype(np.int64)
    joint = np.where(weight > 0, block.joints, 1 << 40)
    order = np.argsort(joint, axis=1, kind="stable")
    pad = ((0, 0), (0, width - joint.shape[1]))
    joint = np.pad(np.take_along_axis(joint, order, 1), pad, constant_values=1 << 40)
    weight = np.pad(np.take_along_axis(weight, order, 1), pad)
    sums = np.zeros((len(block.points), 2))
    for target, offset in block.moves.items():
        sums += (offset[:, :, None] * mix[target]).sum(axis=1)
    places = np.round(np.clip(block.points, -1e12, 1e12) * 1e6).astype(np.int64)
    return np.concatenate([places, joint, weight, np.round(np.clip(sums, -1e10, 1e10) * 1e8).astype(np.int64)], axis=1)


def shapes(surface: Surface, point: Whole, count: int) -> list[Shape]:
    """A Shape per primitive, its triangles over the welded points; triangles that welding closed are left out."""
    out = []
    colors = np.full((count, 3), 0.8)  # shapes share one list of colours
    for block, triangles, material, title, crease, painted in surface.pieces:
        corners = point[block.first + triangles]
        whole = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
        triangles, corners = triangles[whole], corners[whole]
        if not len(corners):
            continue
        shape = Shape(title, corners.astype(np.int32), material=material, crease_angle=crease)
        if block.uv is not None and np.ptp(block.uv[triangles.reshape(-1)], axis=0).max() > 0:
            used, where = np.unique(triangles, return_inverse=True)
            shape.uv, shape.uv_triangles = _unique_uv(block.uv[used], where.reshape(-1, 3))
        if painted and block.colors is not None:
            tone = np.array([_linear(c) for c in material.color])
            colors[corners.reshape(-1)] = srgb(block.colors[triangles.reshape(-1)] * tone)
            shape.colors = colors
        out.append(shape)
    return out


def _linear(c: float) -> float:
    return c / 12.92 if c <= 0.04045 else float(((c + 0.055) / 1.055) ** 2.4)


def _unique_uv(uv: Floats, triangles: Whole) -> tuple[Floats, Ints]:
    unique, where = np.unique(uv, axis=0, return_inverse=True)
    return unique, where.reshape(-1)[triangles].astype(np.int32)


def displacers(surface: Surface, point: Whole, first: Whole) -> list[Displacer | None]:
    """A Displacer per target of the figure over the welded points, None for one that moves nothing."""
    out: list[Displacer | None] = []
    for number, (name, weight) in enumerate(surface.targets):
        offset = np.zeros((len(first), 3))
        for block in surface.blocks:
            if number in block.moves:
                offset[point[block.first : block.first + len(block.points)]] = block.moves[number]
        index = np.flatnonzero((np.abs(offset) > LEAST_MOVE).any(axis=1))
        out.append(Displacer(name, index.astype(np.int32), offset[index], weight) if len(index) else None)
    return out
