"""glTF 2.0, GLB, VRM and VRMA in: a skinned figure is a Humanoid, a surface a Mesh, an animation alone a Motion.

Joints get H-Anim names from VRM's bone table, from what our own writer left, or from tables of known rigs; the others
keep their names. Sources: glTF 2.0 (Khronos); VRM 1.0 and 0.x, VRMC_vrm_animation 1.0 (VRM Consortium); note on bind
poses in `gltf_rig`.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from vitruvian.body.rotations import from_matrix, to_axis_angle
from vitruvian.body.types import Floats
from vitruvian.errors import FileError, VitruvianError, warn
from vitruvian.formats import gltf_motion, gltf_surface
from vitruvian.formats.gltf_file import GltfFile
from vitruvian.formats.gltf_pictures import warn_pictures
from vitruvian.formats.gltf_rig import Rig, figures, nearest, solid
from vitruvian.formats.vrm_tables import info_of, preset_names
from vitruvian.hanim import tables
from vitruvian.hanim.drivers import MOST, Driver, drive
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Segment, Site
from vitruvian.motion.rigs import Names, own_names
from vitruvian.motion.types import Motion
from vitruvian.stage.clip import Mesh


def read_all(path: str | os.PathLike[str], *, names: Names | None = None) -> list[Humanoid] | Motion | Mesh:
    """What a .glb, .gltf, .vrm or .vrma file holds.

    A file with a skin, with nodes that a known rig names, or of our own writer is a list of `Humanoid`s in their bind
    pose, metres, facing +Z, animations as tracks. A file with animation but no surface is a `Motion`. A file with
    surfaces only is one `Mesh` in metres.
    names: {bone: H-Anim joint} or a JSON file with that, used before our own tables.
    Raises `FileError` for whatever can't be read.
    """
    own = own_names(names)
    file = GltfFile(path)
    try:
        return _read(file, own)
    except FileError:
        raise
    except VitruvianError as error:  # a dataclass refused what the file asks for
        raise FileError(path, 0, str(error)) from None
    except np.linalg.LinAlgError:
        raise FileError(path, 0, "expected transforms that can be inverted, found a scale of nothing") from None


def _read(file: GltfFile, own: dict[str, str]) -> list[Humanoid] | Motion | Mesh:
    nodes = file.items("nodes")
    shown = [i for i in file.order if nodes[i].get("mesh") is not None]
    rigs = figures(file, own)
    clips = gltf_motion.animations(file) if rigs else []
    if rigs and (shown or rigs[0].home is not None or not clips):
        figures_found = [_humanoid(file, rig, shown, clips, len(rigs)) for rig in rigs]
        warn_pictures(file)
        return figures_found
    if rigs:
        longest = max(clips, key=lambda c: len(c.channels))
        if len(clips) > 1:
            warn(f"{file.path}: holds {len(clips)} animations; {longest.name} was taken")
        return gltf_motion.motion(file, rigs[0], longest)
    if not shown:
        file.bad("expected a figure, a surface or an animation of a known rig, found none")
    warn_pictures(file, mesh=True)
    return _mesh(file, shown)


# figures


def _humanoid(
    file: GltfFile, rig: Rig, shown: list[int], clips: list[gltf_motion.Animation], count: int
) -> Humanoid:  # fmt: skip
    joints = [Joint(name, rig.bind[j, :3, 3].copy()) for j, name in enumerate(rig.names)]
    out = Humanoid(rig.name or file.path.stem, info=info_of(file))
    for joint, parent in zip(joints, rig.parents):
        (out.skeleton if parent < 0 else joints[parent].joints).append(joint)
    _place(out, rig.placement)
    gltf_motion.pose(file, rig, joints, rig.home is not None)
    morphs = _skin(file, rig, out, joints, shown, count)
    if rig.home is not None:
        _own(file, rig, out, joints)
    else:
        known = tables.joints()
        for joint in joints:
            if joint.name in known:
                joint.segments.append(Segment(known[joint.name].segment))
        loa = tables.complete_loa(rig.names)
        out.loa = loa if loa > 0 else -1  # a rig that lacks joints of level 1 claims none
    for clip in clips:
        out.tracks += gltf_motion.tracks(file, rig, clip, joints, morphs)
    return out


def _place(humanoid: Humanoid, placement: Floats) -> None:
    """The Humanoid's own transform."""
    if np.abs(placement - np.eye(4)).max() < 1e-9:
        return
    humanoid.translation = placement[:3, 3].copy()
    turn, stretch = gltf_motion.polar(placement[None, :3, :3])
    humanoid.rotation = to_axis_angle(from_matrix(turn[0]))
    humanoid.scale, humanoid.scale_orientation = gltf_motion.stretched(stretch[0])


def _skin(
    file: GltfFile, rig: Rig, out: Humanoid, joints: list[Joint], shown: list[int], count: int
) -> dict[tuple[int, int], str]:
    """Surface, weights and displacers of a figure; answers the displacer of each morph target (node, index)."""
    nodes = file.items("nodes")
    surface = gltf_surface.Surface()
    above = nearest(file, {bone: j for j, bone in enumerate(rig.bones)})
    worlds, home = file.worlds(), np.linalg.inv(rig.world)
    stray = 0
    for i in shown:
        skin = nodes[i].get("skin")
        if skin in rig.slots:
            gltf_surface.add_mesh(file, surface, i, np.eye(4), rig.slots[skin], rig.rest[skin])
        elif skin is None and above[i] >= 0:
            j = above[i]
            bone = home @ worlds[rig.bones[j]]
            if solid(bone):
                matrix = rig.bind[j] @ np.linalg.inv(bone) @ home @ worlds[i]
                gltf_surface.add_mesh(file, surface, i, matrix, np.array([j]))
        else:
            stray += 1
    if stray and count == 1:
        warn(f"{file.path}: {stray} meshes that no joint moves were left out")
    if not surface.blocks:
        return {}
    point, first = gltf_surface.weld(surface)
    out.skin_coord = np.concatenate([b.points for b in surface.blocks])[first]
    out.skin = gltf_surface.shapes(surface, point, len(first))
    _weights(surface, joints, first)
    moves = gltf_surface.displacers(surface, point, first)
    owners = _owners(file, joints, shown, surface, moves)
    renamed = preset_names(file, surface.origin, [n for n, _ in surface.targets])
    names: dict[int, str] = {}
    taken: set[str] = set()
    for number, displacer in enumerate(moves):
        if displacer is None:
            continue
        displacer.name = renamed.get(number, displacer.name)
        if rig.home is None:  # animation finds displacers by name
            base, again = displacer.name, 2
            while displacer.name in taken:
                displacer.name, again = f"{base}_{again}", again + 1
        taken.add(displacer.name)
        names[number] = displacer.name
        owners[number].displacers.append(displacer)
    return {at: names[number] for at, number in surface.origin.items() if number in names}


def _weights(surface: gltf_surface.Surface, joints: list[Joint], first: gltf_surface.Whole) -> None:
    """skinCoordIndex and skinCoordWeight of each joint, from the first vertex of each point."""
    width = max(b.joints.shape[1] for b in surface.blocks)
    pad = lambda a, fill: np.pad(a, ((0, 0), (0, width - a.shape[1])), constant_values=fill)  # noqa: E731
    joint = np.concatenate([pad(b.joints, -1) for b in surface.blocks])[first]
    weight = np.concatenate([pad(b.weights, 0.0) for b in surface.blocks])[first]
    keep = (joint >= 0) & (weight > 0)
    at, owner, share = np.nonzero(keep)[0], joint[keep], weight[keep]
    key, where = np.unique(owner * len(first) + at, return_inverse=True)
    total = np.bincount(where, share, minlength=len(key))
    index = (key % len(first)).astype(np.int32)
    limits = np.searchsorted(key // len(first), np.arange(len(joints) + 1))
    for j, item in enumerate(joints):
        part = slice(limits[j], limits[j + 1])
        item.skin_coord_index, item.skin_coord_weight = index[part], total[part].astype(np.float64)


def _owners(
    file: GltfFile, joints: list[Joint], shown: list[int], surface: gltf_surface.Surface, moves: list[Displacer | None]
) -> list[Joint]:
    """The joint of each displacer: as our writer says, else the one that carries most of what it moves."""
    by_name = {j.name: j for j in joints}
    said: dict[int, Joint] = {}
    for (node, k), number in surface.origin.items():
        mesh = file.mesh_of(node)
        items = file.objects(file.object(file.object(mesh, "extras"), "hanim"), "displacers")
        item = items[k] if k < len(items) else {}
        joint = by_name.get(str(item.get("joint")))
        if joint is not None:
            said[number] = joint
        displacer = moves[number]
        if displacer is not None and "driver" in item:
            _lead(file, displacer, file.object(item, "driver"))
    size = max((int(j.skin_coord_index.max(initial=-1)) for j in joints), default=-1) + 1
    out = []
    for number, displacer in enumerate(moves):
        if displacer is None or number in said:
            out.append(said.get(number, joints[0]))
            continue
        length = np.zeros(max(size, int(displacer.coord_index.max()) + 1))
        length[displacer.coord_index] = np.linalg.norm(displacer.displacements, axis=1)
        shares = [float(j.skin_coord_weight @ length[j.skin_coord_index]) for j in joints]
        out.append(joints[int(np.argmax(shares))])
    return out


def _lead(file: GltfFile, displacer: Displacer, left: dict[str, Any]) -> None:
    """The driver that our writer left; one that makes no sense is left out, with a warning."""
    where = f"displacer {displacer.name}"
    try:
        arrays = {}
        for name in ("axis", "angles", "weights"):
            values = left.get(name)
            length = len(values) if isinstance(values, list) else 0
            arrays[name] = file.numbers(left, name, where, (0.0,) * min(length, MOST + 1))
        drive(displacer, Driver(file.text(left, "joint"), **arrays))
    except VitruvianError as error:
        warn(f"{file.path}: {where}: {error}; it is left out")


# what our own writer left


def _own(file: GltfFile, rig: Rig, out: Humanoid, joints: list[Joint]) -> None:
    """Fields that glTF has no place for, from the extras of our writer."""
    assert rig.home is not None
    about = file.extras(rig.home)
    out.version = file.text(about, "version") or "2.0"
    loa = about.get("loa")
    out.loa = loa if isinstance(loa, int) and 0 <= loa <= 4 else -1
    out.skeletal_configuration = file.text(about, "skeletalConfiguration") or "BASIC"
    if "info" in about:
        out.info = {str(k): str(v) for k, v in file.object(about, "info").items()}
    for joint, node in zip(joints, rig.nodes):
        left, where = file.extras(node), f"joint {joint.name}"
        joint.llimit, joint.ulimit = (_free(file, left, k, where) for k in ("llimit", "ulimit"))
        if "limitOrientation" in left:
            joint.limit_orientation = to_axis_angle(file.numbers(left, "limitOrientation", where, (0, 0, 0, 1)))
        joint.stiffness = file.numbers(left, "stiffness", where, (0, 0, 0))
        for item in file.objects(left, "segments"):
            mass = file.numbers({"mass": [item.get("mass", 0)]}, "mass", where, (0,))
            segment = Segment(file.text(item, "name"), float(mass[0]))
            segment.center_of_mass = file.numbers(item, "centerOfMass", where, (0, 0, 0))
            segment.moments_of_inertia = file.numbers(item, "momentsOfInertia", where, (0,) * 9)
            joint.segments.append(segment)
        if "binding" in left:
            b = file.numbers(left, "binding", where, (0,) * 10)
            out.binding[joint.name] = (b[:3], b[3:7], b[7:])
    above = nearest(file, {node: j for j, node in enumerate(rig.nodes)} | {rig.home: -2})
    for i in file.order:
        left = file.extras(i)
        if left.get("node") not in ("Site", "Viewpoint") or file.parents[i] < 0:
            continue
        j = above[file.parents[i]]
        if j == -1:
            continue
        site = _site(file, i, left, joints[j].center if j >= 0 else np.zeros(3))
        if j < 0:
            (out.viewpoints if left["node"] == "Viewpoint" else out.sites).append(site)
            continue
        holder = next((g for g in joints[j].segments if g.name == left.get("segment")), None)
        (joints[j].sites if holder is None else holder.sites).append(site)


def _site(file: GltfFile, node: int, left: dict[str, Any], center: Floats) -> Site:
    where = f"node {node}"
    site = Site(file.name(node))
    site.translation = file.numbers(left, "translation", where, (0, 0, 0))
    site.center = file.translation[node] + center - site.translation
    site.rotation = to_axis_angle(file.rotation[node])
    site.scale = file.scale[node].copy()
    if "scaleOrientation" in left:
        site.scale_orientation = file.numbers(left, "scaleOrientation", where, (0, 0, 1, 0))
    return site


def _free(file: GltfFile, left: dict[str, Any], key: str, where: str) -> Floats:
    """Zero to three numbers."""
    value = left.get(key)
    count = len(value) if isinstance(value, list) else 0
    return file.numbers(left, key, where, (0.0,) * min(count, 3))


# surfaces without a figure


def _mesh(file: GltfFile, shown: list[int]) -> Mesh:
    surface = gltf_surface.Surface()
    with np.errstate(all="ignore"):
        worlds = file.worlds()
    if not np.isfinite(worlds).all():
        file.bad("nodes: expected transforms that stay finite")
    for i in shown:
        gltf_surface.add_mesh(file, surface, i, worlds[i], np.zeros(1, np.int64))
    if not surface.pieces:
        file.bad("expected triangles, found none")
    point, first = gltf_surface.weld(surface)
    vertices = np.concatenate([b.points for b in surface.blocks])[first]
    shapes = gltf_surface.shapes(surface, point, len(first))
    if not shapes:
        file.bad("expected triangles, found none")
    uv, uv_triangles, start = [], [], 0
    for s in shapes:
        own = s.uv if s.uv is not None else np.zeros((1, 2))
        corners = s.uv_triangles if s.uv_triangles is not None else np.zeros_like(s.triangles)
        uv.append(own)
        uv_triangles.append(corners + np.int32(start))
        start += len(own)
    mapped = any(s.uv is not None for s in shapes)
    colors = None
    if any(s.colors is not None or s.material.color != (1.0, 1.0, 1.0) for s in shapes):
        colors = np.full((len(vertices), 3), 0.8)
        for s in shapes:
            used = np.unique(s.triangles)
            colors[used] = s.material.color if s.colors is None else s.colors[used]
    title = file.text(file.mesh_of(shown[0]), "name") or file.name(shown[0])
    return Mesh(
        vertices,
        np.concatenate([s.triangles for s in shapes]),
        np.concatenate(uv) if mapped else None,
        colors,
        name=title or file.path.stem,
        uv_triangles=np.concatenate(uv_triangles) if mapped else None,
    )
