"""Which nodes of a glTF file are joints of which figure, what H-Anim calls them, and how they stand when bound.

Bridge: let B_j be the place of joint j in the bind pose (its inverse bind matrix, inverted) and W_j(t) its node at any
time, both in humanoid space. The joint matrix is M_j(t) = W_j(t) B_j^-1, the centre is the origin of B_j, and the
frames of foreign bones vanish: every joint is unturned in the bind pose. Source: glTF 2.0, section 3.7.3, and
ISO/IEC 19774-1, Joint; the algebra is our own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats
from vitruvian.errors import warn
from vitruvian.formats.gltf_file import GltfFile
from vitruvian.hanim.tables import ROOT, canonical
from vitruvian.motion.rigs import FEWEST, hanim_names, rig

MAX_JOINTS = 4096
_NO_TITLES = {"armature", "rootnode", "root", "root node", "scene", "sketchfab_model", "skeleton", "rig"}
_ABOUT_FACE = np.diag([-1.0, 1.0, -1.0, 1.0])  # half a turn about Y


@dataclass(eq=False)
class Rig:
    """The joints of one figure, parents before children.

    nodes: the node that carries a joint's name; bones: the one that the skin follows (the same but for our own helper
    nodes). bind (J,4,4) in humanoid space. world: humanoid space to scene; placement: what of it is the Humanoid's own
    transform. slots: skin -> joint of each of its entries, -1 for what stays at rest; rest: skin -> (n,4,4), mesh to
    humanoid space. home: the node our writer made of the Humanoid itself, or None.
    """

    nodes: list[int]
    bones: list[int]
    names: list[str]
    parents: list[int]
    bind: Floats
    world: Floats
    placement: Floats
    slots: dict[int, NDArray[np.int64]] = field(default_factory=dict)
    rest: dict[int, Floats] = field(default_factory=dict)
    name: str = ""
    home: int | None = None

    def __len__(self) -> int:
        return len(self.nodes)


def nearest(file: GltfFile, chosen: Mapping[int, int]) -> list[int]:
    """For each node the value of the nearest chosen node at or above it, -1 where there is none."""
    out = [-1] * len(file.parents)
    for i in file.order:
        p = file.parents[i]
        out[i] = chosen[i] if i in chosen else (out[p] if p >= 0 else -1)
    return out


def human_bones(file: GltfFile) -> dict[int, str]:
    """Node -> H-Anim joint, as VRM 1.0, VRM 0.x or VRMA says; {} for other files."""
    found: dict[int, str] = {}
    count = len(file.parents)
    for extension in ("VRMC_vrm", "VRMC_vrm_animation"):
        bones = file.object(file.object(file.extension(extension), "humanoid"), "humanBones")
        for bone, joint in rig("vrm")["joints"].items():
            entry = file.object(bones, bone)
            if entry:
                found.setdefault(file.integer(entry, "node", f"{extension} {bone}", count), joint)
    humanoid = file.object(file.extension("VRM"), "humanoid")
    table = rig("vrm0")["joints"]
    for entry in file.objects(humanoid, "humanBones"):
        joint = table.get(entry.get("bone")) if isinstance(entry.get("bone"), str) else None
        if joint:
            found.setdefault(file.integer(entry, "node", f"VRM {entry['bone']}", count), joint)
    return found


def backwards(file: GltfFile) -> bool:
    """VRM 0.x figures look along -Z."""
    return bool(file.extension("VRM")) and not file.extension("VRMC_vrm")


def figures(file: GltfFile, own: Mapping[str, str]) -> list[Rig]:
    """The figures of a file that has skins, or nodes our own writer or VRM or a known rig named; [] when it has none."""
    shown = set(file.order)
    asset = file.object(file.root, "asset")
    if file.text(asset, "generator").startswith("vitruvian"):
        homes = [i for i in file.order if file.extras(i).get("node") == "Humanoid"]
        if homes:
            return [_ours(file, home) for home in homes]
    skins = _used_skins(file)
    known = {node: joint for node, joint in human_bones(file).items() if node in shown}
    bones = {j for joints in skins.values() for j in joints} | set(known)
    if not skins and not known:
        guessed = hanim_names([file.name(i) for i in file.order], own)
        known = {i: joint for i, joint in zip(file.order, guessed) if joint}
        if len(known) < FEWEST + 2 or ROOT not in known.values():
            return []
        bones = set(known)
    if not skins:  # what moves below the root without a name is a joint of its own
        below = nearest(file, {node: node for node, joint in known.items() if joint == ROOT})
        bones |= {i for i in _animated(file) if i in shown and below[i] >= 0}
    groups = _groups(file, skins, bones)
    found = []
    for joints, members in groups:
        names = _names(file, joints, known, own)
        found.append((sum(canonical(n) is not None for n in names), joints, names, members))
    people = [g for g in found if g[0] >= FEWEST]
    if len(people) > 1:
        if len(people) < len(found):
            warn(f"{file.path}: {len(found) - len(people)} skinned things beside the figures were left out")
        return [_foreign(file, joints, names, members) for _, joints, names, members in people]
    joints = [i for i in file.order if i in bones]
    return [_foreign(file, joints, _names(file, joints, known, own), skins)]


def _animated(file: GltfFile) -> set[int]:
    out = set()
    for entry in file.items("animations"):
        for channel in file.objects(entry, "channels"):
            target = file.object(channel, "target")
            if target.get("path") == "rotation" and target.get("node") is not None:
                out.add(file.integer(target, "node", "animation", len(file.parents)))
    return out


def _used_skins(file: GltfFile) -> dict[int, list[int]]:
    """Skin -> nodes of its entries, for the skins that a mesh of the scene follows."""
    nodes, skins, shown = file.items("nodes"), file.items("skins"), set(file.order)
    used: dict[int, list[int]] = {}
    for i in file.order:
        if nodes[i].get("skin") is None or nodes[i].get("mesh") is None:
            continue
        k = file.integer(nodes[i], "skin", f"node {i}", len(skins))
        if k in used:
            continue
        joints = file.indices(skins[k], "joints", f"skin {k}", len(nodes))
        if not joints or len(joints) > MAX_JOINTS:
            file.bad(f"skin {k}: expected 1 to {MAX_JOINTS} joints, found {len(joints)}")
        lost = [j for j in joints if j not in shown]
        if lost:
            file.bad(f"skin {k}: joint node {lost[0]} is not in the scene")
        used[k] = joints
    return used


def _groups(file: GltfFile, skins: dict[int, list[int]], bones: set[int]) -> list[tuple[list[int], dict]]:
    """Trees of joints that share a skin: (joint nodes, their skins)."""
    top = [-1] * len(file.parents)
    for i in file.order:
        p = file.parents[i]
        top[i] = top[p] if p >= 0 and top[p] >= 0 else (i if i in bones else -1)
    group = {top[b]: top[b] for b in bones}

    def root(t: int) -> int:
        while group[t] != t:
            t = group[t]
        return t

    for joints in skins.values():
        for j in joints:
            group[root(top[j])] = root(top[joints[0]])
    trees: dict[int, list[int]] = {}
    for i in file.order:
        if i in bones:
            trees.setdefault(root(top[i]), []).append(i)
    return [
        (joints, {k: s for k, s in skins.items() if root(top[s[0]]) == t}) for t, joints in trees.items()
    ]  # fmt: skip


def _names(file: GltfFile, joints: list[int], known: dict[int, str], own: Mapping[str, str]) -> list[str]:
    """A name for every joint, each once: the standard's where known, else the node's own."""
    bare = [file.name(i) for i in joints]
    if known:
        guessed: list[str | None] = [known.get(i) for i in joints]
        guessed = [own.get(name, joint) for name, joint in zip(bare, guessed)]
    else:
        guessed = hanim_names(bare, own)
    taken = {n for n in guessed if n}
    out = []
    for i, (name, joint) in enumerate(zip(bare, guessed)):
        if joint is None:
            joint = _free(name or f"joint_{i + 1}", taken)
            taken.add(joint)
        out.append(joint)
    return out


def _free(name: str, taken: set[str]) -> str:
    """A custom joint never takes a standard name that means another joint."""
    if name not in taken and canonical(name) is None:
        return name
    number = 2
    while f"{name}_{number}" in taken:
        number += 1
    return f"{name}_{number}"


def _ours(file: GltfFile, home: int) -> Rig:
    """A figure that our own writer wrote: names, centres and the Humanoid's own place stand in extras."""
    roles = {i: file.extras(i).get("node") for i in file.order}
    inner = next((c for c in file.children[home] if roles.get(c) == "Frame"), home)
    below = nearest(file, {home: home})
    nodes = [i for i in file.order if roles[i] == "Joint" and below[i] == home]
    if not nodes or len(nodes) > MAX_JOINTS:
        file.bad(f"expected 1 to {MAX_JOINTS} joints under {file.name(home) or 'the humanoid'}, found {len(nodes)}")
    index = {node: j for j, node in enumerate(nodes)}
    above = nearest(file, index)
    parents = [above[file.parents[i]] for i in nodes]
    bones, taken, names = [], set[str](), []
    for j, i in enumerate(nodes):
        bones.append(next((c for c in file.children[i] if roles.get(c) == "Frame"), i))
        name = file.name(i) or f"joint_{j + 1}"
        names.append(name if name not in taken else _free(name, taken))
        taken.add(names[-1])
    bind = np.tile(np.eye(4), (len(nodes), 1, 1))
    for j, i in enumerate(nodes):
        bind[j, :3, 3] = file.numbers(file.extras(i), "center", f"node {i}", (0, 0, 0))
    with np.errstate(all="ignore"):
        world = file.worlds()[inner]
    if not np.isfinite(world).all() or not solid(world):
        file.bad(f"node {inner}: expected a figure with a size, found a scale of nothing")
    made = Rig(nodes, bones, names, parents, bind, world, world, name=file.name(home), home=home)
    where = {bone: j for j, bone in enumerate(bones)}
    for k, entries in _used_skins(file).items():
        if all(below[i] == home for i in entries):
            made.slots[k] = np.array([where.get(i, -1) for i in entries])
            made.rest[k] = np.tile(np.eye(4), (len(entries), 1, 1))
    return made


def _foreign(file: GltfFile, nodes: list[int], names: list[str], skins: dict[int, list[int]]) -> Rig:
    """A figure of anybody else, bound as its inverse bind matrices say."""
    nodes, names = _without_tops(file, nodes, names, skins)
    if len(nodes) > MAX_JOINTS:
        file.bad(f"expected at most {MAX_JOINTS} joints, found {len(nodes)}")
    index = {node: j for j, node in enumerate(nodes)}
    above = nearest(file, index)
    parents = [above[file.parents[i]] if file.parents[i] >= 0 else -1 for i in nodes]
    with np.errstate(all="ignore"):
        worlds = file.worlds()
    if not np.isfinite(worlds).all():
        file.bad("nodes: expected transforms that stay finite")
    place = np.eye(4)  # where the whole figure stands in its scene
    root = nodes[0]
    while file.parents[root] >= 0:
        root = file.parents[root]
    if root not in index:
        place[:3, 3] = worlds[root, :3, 3]
    bind = np.zeros((len(nodes), 4, 4))
    given = np.zeros(len(nodes), bool)
    slots: dict[int, NDArray[np.int64]] = {}
    inverses: dict[int, Floats] = {}
    for k, entries in skins.items():
        inverses[k] = _inverse_binds(file, k, len(entries))
        slots[k] = np.array([index.get(i, -1) for i in entries])
        sound = solid(inverses[k])
        space = _bind_space(file, k, [i if good else -1 for i, good in zip(entries, sound)], inverses[k], worlds)
        for j, inverse, good in zip(slots[k], inverses[k], sound):
            if j >= 0 and good and not given[j]:
                bind[j], given[j] = space @ np.linalg.inv(inverse), True
    for j, i in enumerate(nodes):  # bones without a bind matrix stand at their parents as the file shows them
        if not given[j]:
            p = parents[j]
            steady = p >= 0 and solid(worlds[nodes[p]])
            bind[j] = bind[p] @ np.linalg.inv(worlds[nodes[p]]) @ worlds[i] if steady else worlds[i]
    if not np.isfinite(bind).all():
        file.bad("skins: expected bind matrices that can be inverted")
    bind[~solid(bind), :3, :3] = np.eye(3)  # a helper scaled to nothing has a place, no frame
    turn = _facing(file, names, bind)
    home = turn @ np.linalg.inv(place)
    bind = home @ bind
    made = Rig(nodes, nodes, names, parents, bind, np.linalg.inv(home), place, slots, name=_title(file, nodes))
    made.rest = {k: bind[slots[k]] @ inverses[k] for k in skins}
    _same_bind(file, made)
    for k in skins:  # bones above the root that move nothing
        made.slots[k] = np.where(slots[k] < 0, 0, slots[k])
    return made


def _without_tops(
    file: GltfFile, nodes: list[int], names: list[str], skins: dict[int, list[int]]
) -> tuple[list[int], list[str]]:
    """Without bones above `humanoid_root` that only hold it: their motion becomes its own."""
    if ROOT not in names:
        return nodes, names
    root = nodes[names.index(ROOT)]
    over = set(file.ancestors(root))
    others = set(nodes) - over
    below = nearest(file, {root: root})
    if any(below[i] != root for i in others):
        return nodes, names
    weighted = _weighted(file, {k: s for k, s in skins.items() if over.intersection(s)})
    drop = over - weighted
    kept = [(i, n) for i, n in zip(nodes, names) if i not in drop]
    return [i for i, _ in kept], [n for _, n in kept]


def _weighted(file: GltfFile, skins: dict[int, list[int]]) -> set[int]:
    """Nodes of the skins that move at least one vertex."""
    from vitruvian.formats.gltf_surface import influences

    out: set[int] = set()
    nodes, meshes = file.items("nodes"), file.items("meshes")
    for i in file.order:
        k = nodes[i].get("skin")
        if k not in skins or nodes[i].get("mesh") is None:
            continue
        mesh = meshes[file.integer(nodes[i], "mesh", f"node {i}", len(meshes))]
        for primitive in file.objects(mesh, "primitives"):
            joints, weights = influences(file, file.object(primitive, "attributes"), len(skins[k]), f"mesh of node {i}")
            out.update(skins[k][j] for j in np.unique(joints[weights > 0]))
    return out


def solid(matrices: Floats) -> NDArray[np.bool_]:
    """Which transforms (...,4,4) keep all three directions apart, so that they can be inverted; any unit."""
    with np.errstate(all="ignore"):
        linear = np.where(np.isfinite(matrices[..., :3, :3]), matrices[..., :3, :3], 0.0)
        size = np.linalg.svd(linear, compute_uv=False)
    return (size[..., 2] > 1e-10 * size[..., 0]) & (size[..., 2] > 1e-12)


def _inverse_binds(file: GltfFile, skin: int, count: int) -> Floats:
    entry = file.items("skins")[skin]
    if entry.get("inverseBindMatrices") is None:
        return np.tile(np.eye(4), (count, 1, 1))
    where = f"skin {skin} inverseBindMatrices"
    matrices = file.accessor(entry["inverseBindMatrices"], ("MAT4",), where)
    if len(matrices) < count:
        file.bad(f"{where}: expected {count}, one per joint, found {len(matrices)}")
    matrices = matrices[:count].copy()
    matrices[:, 3] = [0, 0, 0, 1]
    return matrices


def _bind_space(file: GltfFile, skin: int, entries: list[int], inverse: Floats, worlds: Floats) -> Floats:
    """(4,4): the space in which the mesh was bound, to the scene.

    When the nodes stand as they were bound, world times inverse bind is the same for every joint, and that is it. Else
    the figure was saved in another pose: what fits the topmost joint best of the scene itself, the node above the
    joints and the node of the mesh.
    """
    rank = {i: n for n, i in enumerate(file.order)}
    sound = [n for n, i in enumerate(entries) if i >= 0]
    if not sound:
        file.bad(f"skin {skin}: expected inverse bind matrices that can be inverted")
    top = min(sound, key=lambda n: rank[entries[n]])
    stand = worlds[[entries[n] for n in sound]]
    here = stand @ inverse[sound]
    first = worlds[entries[top]] @ inverse[top]
    size = float(np.abs(stand[:, :3, 3] - worlds[entries[top], :3, 3]).max()) + 1e-9
    linear = max(float(np.abs(first[:3, :3]).max()), 1e-12)
    apart = np.abs(here - first)
    if apart[:, :3, :3].max() < 2e-3 * linear and apart[:, :3, 3].max() < 2e-3 * size:
        return first
    nodes = file.items("nodes")
    choices = [np.eye(4)]
    if file.parents[entries[top]] >= 0:
        choices.append(worlds[file.parents[entries[top]]])
    choices += [worlds[i] for i in file.order if nodes[i].get("skin") == skin][:4]
    off = [float(np.abs(c[:3, :3] - first[:3, :3]).max()) / linear for c in choices]
    best = int(np.argmin(off))
    return choices[best] if off[best] < 1.0 else first


def _facing(file: GltfFile, names: list[str], bind: Floats) -> Floats:
    """(4,4) that makes the figure look along +Z: half a turn when its left side is at -X."""
    if backwards(file):
        return _ABOUT_FACE
    sides = [(n[0], float(b[0, 3])) for n, b in zip(names, bind) if n[:2] in ("l_", "r_") and canonical(n)]
    left, right = ([x for s, x in sides if s == side] for side in "lr")
    if left and right and np.mean(left) < np.mean(right) - 1e-6:
        warn(f"{file.path}: the figure looks along -Z; it was turned to face +Z")
        return _ABOUT_FACE
    return np.eye(4)


def _title(file: GltfFile, nodes: list[int]) -> str:
    meta: dict[str, Any] = file.object(file.extension("VRMC_vrm"), "meta")
    title = file.text(meta, "name") or file.text(file.object(file.extension("VRM"), "meta"), "title")
    given = [n for i in file.ancestors(nodes[0]) if (n := file.name(i)) and n.lower() not in _NO_TITLES]
    return title or next(iter(given), "") or file.path.stem


def _same_bind(file: GltfFile, made: Rig) -> None:
    """One skin point is where its mesh says: bind matrices that nearly agree are made to; others are reported."""
    for k, rest in made.rest.items():
        held = made.slots[k] >= 0
        middle = rest[held][0] if held.any() else np.eye(4)
        rest[~held] = middle
        scale = max(float(np.abs(middle[:3, :3]).max()), 1e-12)
        apart = float(np.abs(rest[:, :3, :3] - middle[:3, :3]).max()) / scale
        far = float(np.abs(rest[:, :3, 3] - middle[:3, 3]).max())
        if apart < 1e-4 and far < 1e-4 * max(float(np.ptp(made.bind[:, :3, 3], axis=0).max()), 1e-9):
            rest[:] = middle
        elif apart > 1e-2:
            warn(f"{file.path}: skin {k} is bound in another pose than the rest of the figure; it was brought to that")
