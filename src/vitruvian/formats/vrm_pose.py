"""A body as VRM wants it: which joints are its bones, and its rest pose in the T that VRM asks for.

Sources: VRM 1.0 `humanoid` and `tpose` (VRM Consortium). The arms of the standard's rest pose hang, palms inward: a
quarter turn about Z brings them to the T, palms down. Bodies with other rest poses are turned bone by bone.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from vitruvian.body.kinematics import move, pose_matrices
from vitruvian.body.rotations import between, from_axis_angle, from_matrix, inverse, multiply, rotate, to_axis_angle
from vitruvian.body.types import Body, Floats, Morph, Skeleton, Weights
from vitruvian.errors import VitruvianError
from vitruvian.formats.gltf_skin import browsers, limit, matrix_of, measure
from vitruvian.hanim.humanoid import Humanoid, Joint, Segment, Site
from vitruvian.motion.names import joint_index
from vitruvian.motion.rigs import rig
from vitruvian.motion.turns import about, unit

REQUIRED = ("hips", "spine", "head") + tuple(
    f"{side}{bone}"
    for side in ("left", "right")
    for bone in ("UpperLeg", "LowerLeg", "Foot", "UpperArm", "LowerArm", "Hand")
)
# What else may stand for a bone of the trunk when the joint of the table is missing, nearest first.
_INSTEAD = {
    "spine": ("vl4", "vl3", "vl2", "vl1"), "chest": ("vt11", "vt12", "vt9", "vt8", "vl1"),
    "upperChest": ("vt5", "vt7", "vt4", "vt3", "vt2", "vt1"), "neck": ("vc5", "vc3", "vc6", "vc7", "vc2", "vc1"),
    "leftToes": ("l_tarsometatarsal_2",), "rightToes": ("r_tarsometatarsal_2",),
}  # fmt: skip
LEAST_VOLUME = 0.1  # of a blend of joint matrices that is inverted
STILL = np.radians(1.0)  # a joint turned less keeps its limits


def vrm_bones(skeleton: Skeleton) -> dict[str, int]:
    """VRM bone -> joint. Bones that VRM does not need are left out where the joint is missing or hangs elsewhere.

    Raises `VitruvianError` naming the joints that a VRM needs and this skeleton lacks.
    """
    index = joint_index(skeleton.names)
    table = rig("vrm")["joints"]
    found: dict[str, int] = {}
    for bone, joint in table.items():
        for candidate in (joint, *_INSTEAD.get(bone, ())):
            if candidate in index and index[candidate] not in found.values():
                found[bone] = index[candidate]
                break
    lacking = [f"{bone} ({table[bone]})" for bone in REQUIRED if bone not in found]
    if lacking:
        raise VitruvianError(f"VRM: expected 15 bones, this humanoid lacks {', '.join(lacking)}")
    for bone in [b for b in table if b in found]:
        above = _bone_above(bone, found)
        if above is None or found[above] in _path(skeleton, found[bone]):
            continue
        if bone in REQUIRED:
            child, parent = skeleton.names[found[bone]], skeleton.names[found[above]]
            raise VitruvianError(f"VRM: expected joint {child} to hang below {parent}, it does not")
        del found[bone]
    if "upperChest" in found and "chest" not in found:  # there is no upper chest without a chest
        found["chest"] = found.pop("upperChest")
    for bone in [b for b in found if b.endswith(("Proximal", "Intermediate", "Distal"))]:
        if bone in found and (over := _phalanx_above(bone)) is not None and over not in found:
            del found[bone]
    return found


def _bone_above(bone: str, found: dict[str, int]) -> str | None:
    """The bone that VRM's tree has above another, among those found."""
    side = "left" if bone.startswith("left") else "right"
    part = bone.removeprefix(side)
    trunk = [b for b in ("upperChest", "chest", "spine") if b in found]
    if bone == "hips":
        return None
    if bone in ("leftEye", "rightEye", "jaw"):
        return "head"
    if bone in ("spine", "leftUpperLeg", "rightUpperLeg"):
        return "hips"
    if bone in ("head", "neck") or part in ("Shoulder", "UpperArm"):
        return "spine"  # whatever of the chest is there hangs below the spine
    chain = {"LowerLeg": "UpperLeg", "Foot": "LowerLeg", "Toes": "Foot", "LowerArm": "UpperArm", "Hand": "LowerArm"}
    if part in chain:
        return side + chain[part]
    if bone in ("chest", "upperChest"):
        return next((b for b in trunk if trunk.index(b) > ("upperChest", "chest").index(bone)), "spine")
    return _phalanx_above(bone) if _phalanx_above(bone) in found else f"{side}Hand"


def _phalanx_above(bone: str) -> str | None:
    for phases in (("Metacarpal", "Proximal", "Distal"), ("Proximal", "Intermediate", "Distal")):
        thumb = "Thumb" in bone
        if thumb != (phases[0] == "Metacarpal"):
            continue
        for a, b in zip(phases, phases[1:]):
            if bone.endswith(b):
                return bone.removesuffix(b) + a
    return None


def _path(skeleton: Skeleton, joint: int) -> set[int]:
    out = set()
    while (joint := int(skeleton.parents[joint])) >= 0:
        out.add(joint)
    return out


def t_turns(skeleton: Skeleton, bones: dict[str, int]) -> Floats:
    """(J,4) world rotations that bring arms, hands and fingers into VRM's T pose.

    Upper arm, forearm, hand and fingers along X, thumbs halfway between X and Z, palms down; each bone by the smallest
    rotation after that of the joint above, what the palm lacks as pronation of the forearm.
    """
    c, parents = skeleton.centers, skeleton.parents
    index = joint_index(skeleton.names)
    aims: dict[int, tuple[Floats, Floats]] = {}  # joint -> its bone at rest, where that shall point
    for side, sign in (("left", 1.0), ("right", -1.0)):
        x, oblique = np.array([sign, 0, 0]), unit(np.array([sign, 0, 1.0]))
        chain = [bones[f"{side}{b}"] for b in ("UpperArm", "LowerArm", "Hand")]
        knuckle = next((bones[k] for f in ("Middle", "Index", "Ring") if (k := f"{side}{f}Proximal") in bones), None)
        for a, b in zip(chain, [*chain[1:], knuckle]):
            if b is not None:
                aims[a] = c[b] - c[a], x
        for finger in ("Thumb", "Index", "Middle", "Ring", "Little"):
            phases = (
                ("Metacarpal", "Proximal", "Distal") if finger == "Thumb" else ("Proximal", "Intermediate", "Distal")
            )
            joints = [bones[k] for p in phases if (k := f"{side}{finger}{p}") in bones]
            for a, b in zip(joints, joints[1:]):
                aims[a] = c[b] - c[a], oblique if finger == "Thumb" else x
    turn = np.tile([0.0, 0, 0, 1], (len(skeleton), 1))
    for j, p in enumerate(parents):
        turn[j] = turn[p] if p >= 0 else turn[j]
        if j in aims:
            bone, aim = aims[j]
            turn[j] = multiply(between(rotate(turn[j], bone), aim), turn[j])
            for side, letter in (("left", "l"), ("right", "r")):
                if j == bones[f"{side}LowerArm"]:
                    turn[j] = multiply(_pronation(skeleton, index, letter, turn[j]), turn[j])
    return turn


def _pronation(skeleton: Skeleton, index: dict[str, int], letter: str, turn: Floats) -> Floats:
    """Turn about X that brings the line across the knuckles, little finger to index, to +Z: palms down."""
    first, last = (index.get(f"{letter}_metacarpophalangeal_{k}") for k in (2, 5))
    if first is None or last is None:
        return np.array([0.0, 0, 0, 1])
    across = rotate(turn, skeleton.centers[first] - skeleton.centers[last])
    angle = np.arctan2(across[1], across[2])  # from +Z towards +Y is a turn about -X
    return about(np.array([1.0, 0, 0]), angle) if abs(angle) > STILL else np.array([0.0, 0, 0, 1])


def t_posed(body: Body, humanoid: Humanoid, bones: dict[str, int]) -> tuple[Body, Humanoid, list[str], dict[str, Any]]:
    """The body bound anew in VRM's T pose, its tree without shapes, what that changed, and by how much.

    The new surface is the one that linear skinning brings back: v' = (sum w_j B_j)^-1 v with B_j the joint matrices from
    the T to the rest pose of the file and w_j all weights, so a player that lowers the arms shows the file's own shape
    but for what four influences cost. (With the four weights it would be exact and the T rough, because pruning is.)
    Where that sum can't be inverted well, linear skinning from the rest pose is taken instead. The scale of joints,
    their binding and the uniform part of the Humanoid's own scale go into the surface, so no node needs a scale.
    The skin has four influences, chosen for the way back. The last answer is what that cost, as `write_glb` reports it,
    and `rest_error_m`: how far (m) vertices are at most from where they were when the arms are back.
    """
    s, skin = body.skeleton, body.skin
    turn = t_turns(s, bones)
    local = turn.copy()
    child = np.flatnonzero(s.parents >= 0)
    local[child] = multiply(inverse(turn[s.parents[child]]), turn[child])
    matrices = pose_matrices(s, local[None], s.translation[None])[0]
    still = pose_matrices(s, np.tile([0.0, 0, 0, 1], (1, len(s), 1)), s.translation[None])[0]
    bare = (
        matrices if s.binding is None else pose_matrices(replace(s, binding=None), local[None], s.translation[None])[0]
    )
    size = float(np.cbrt(abs(np.linalg.det(body.placement[:3, :3]))))
    share = browsers(skin.weights, len(s) + 1)
    back = still @ np.linalg.inv(matrices)
    back[:, :3, 3] *= size
    blend = (share @ _flat(back)).reshape(-1, 3, 4)
    sound = np.abs(np.linalg.det(blend[:, :, :3])) > LEAST_VOLUME
    shape = _linear(share, still, skin.rest) * size
    rest = _linear(share, matrices, skin.rest) * size
    solved = np.linalg.solve(blend[sound, :, :3], (shape - blend[:, :, 3])[sound, :, None])
    rest[sound] = solved[:, :, 0]
    centers = move(bare, s.centers) * size
    linear = (share @ _flat(matrices)).reshape(-1, 3, 4)[:, :, :3]
    morphs = tuple(_turned(m, linear, matrices, size) for m in skin.morphs)
    points = move(bare[s.site_joints], s.site_points) * size
    bent = 2 * np.arccos(np.clip(np.abs(local[:, 3]), 0, 1)) > STILL
    limits = s.limits.copy()
    limits[bent] = np.nan
    skeleton = Skeleton(
        s.names, s.parents, centers, limits=limits, limit_orientation=s.limit_orientation, stiffness=s.stiffness,
        site_names=s.site_names, site_joints=s.site_joints, site_points=points,
    )  # fmt: skip
    made = Body(body.name, skeleton, replace(skin, rest=rest, morphs=morphs))
    lost = []
    if bent.any():
        some = ", ".join(n for n, b in zip(s.names, bent) if b and "shoulder" in n) or s.names[int(np.argmax(bent))]
        lost.append(
            f"the rest pose: {int(bent.sum())} joints were turned to VRM's T ({some}); their limits are left out"
        )
    if np.abs(body.placement[:3, :3] / size - np.eye(3)).max() > 1e-6 or np.abs(body.placement[:3, 3]).max() > 1e-6:
        lost.append("the humanoid's place in its scene: a VRM stands at the origin; a uniform scale went into the body")
    joints, weights, facts = limit(made, 4, back[None])
    facts |= measure(made, None, joints, weights, "linear")
    shown = _linear(matrix_of(joints, weights, len(s) + 1), back, rest)
    facts["rest_error_m"] = float(np.linalg.norm(shown - shape, axis=1).max(initial=0.0))
    vertex, slot = np.nonzero((weights > 0) & (joints < len(s)))  # what stays at rest is what rows lack to one
    few = Weights.from_pairs(len(weights), vertex, joints[vertex, slot], weights[vertex, slot])
    made = replace(made, skin=replace(made.skin, weights=few))
    return made, _tree(humanoid, made, bare, bent, size), lost, facts


def _flat(matrices: Floats) -> Floats:
    return np.concatenate([matrices[:, :3].reshape(-1, 12), np.eye(4)[:3].reshape(1, 12)])


def _linear(share: csr_array, matrices: Floats, points: Floats) -> Floats:
    blend = (share @ _flat(matrices)).reshape(-1, 3, 4)
    return np.einsum("nab,nb->na", blend[:, :, :3], points) + blend[:, :, 3]


def _turned(morph: Morph, linear: Floats, matrices: Floats, size: float) -> Morph:
    """A displacer in the new rest pose."""
    turn = linear[morph.index] if morph.before else matrices[morph.joint, :3, :3]
    return replace(morph, offset=np.einsum("...ab,...b->...a", turn, morph.offset) * size)


def _tree(humanoid: Humanoid, body: Body, matrices: Floats, bent: np.ndarray, size: float) -> Humanoid:
    """The tree without surfaces, everything in it moved along: what nodes and their extras are written from."""
    joints = list({id(j): j for j in humanoid.joints()}.values())
    if tuple(j.name for j in joints) != body.skeleton.names:
        return Humanoid(humanoid.name, humanoid.version, humanoid.loa, dict(humanoid.info))
    made: list[Joint] = []
    for j, joint in enumerate(joints):
        turn = matrices[j, :3, :3] / max(float(np.cbrt(abs(np.linalg.det(matrices[j, :3, :3])))), 1e-12)
        new = Joint(joint.name, body.skeleton.centers[j], stiffness=joint.stiffness)
        if not bent[j]:
            new.llimit, new.ulimit, new.limit_orientation = joint.llimit, joint.ulimit, joint.limit_orientation
        new.sites = [_site(x, matrices[j], turn, size) for x in joint.sites]
        for g in joint.segments:
            inertia = turn @ np.reshape(g.moments_of_inertia, (3, 3)) @ turn.T
            middle = move(matrices[j], g.center_of_mass) * size if g.mass else g.center_of_mass
            moved = Segment(g.name, g.mass, middle, inertia.reshape(9))
            moved.sites = [_site(x, matrices[j], turn, size) for x in g.sites]
            new.segments.append(moved)
        made.append(new)
    out = replace(
        humanoid,
        skeleton=[],
        skin=[],
        motions=[],
        tracks=[],
        binding={},
        sites=[],
        viewpoints=[],
        scene=None,
        node=None,
    )
    for new, p in zip(made, body.skeleton.parents):
        (out.skeleton if p < 0 else made[p].joints).append(new)
    fixed = np.eye(4)
    out.sites = [_site(x, fixed, np.eye(3), size) for x in humanoid.sites]
    out.viewpoints = [_site(x, fixed, np.eye(3), size) for x in humanoid.viewpoints]
    return out


def _site(site: Site, matrix: Floats, turn: Floats, size: float) -> Site:
    rotation = to_axis_angle(multiply(from_matrix(turn), from_axis_angle(site.rotation)))
    return Site(site.name, move(matrix, site.center + site.translation) * size, rotation=rotation)
