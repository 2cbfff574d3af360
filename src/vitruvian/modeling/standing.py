"""Any body re-posed to the rest pose of the standard: arms down, palms to the thighs, gaze +Z, feet on the ground.

A body that was made in an A or T pose, or that is turned in its file, gets a new surface and new joint centres; every
joint rotation is zero again, and clips are told anew relative to the new rest, so that they move as before in space.
Method: the turns of `vitruvian.modeling.rest`, the skin by one of our deformers. With B_j the motion that takes joint j
from the old rest to the new one, an old matrix M_j becomes M_j B_j^-1, a local rotation R becomes B_p R B_j^-1.
Source: note hanim.md, section 2 ("Default pose"); seed 003, section 3.2.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

from vitruvian.body import rotations as rot
from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.pack import pack
from vitruvian.body.types import Body, Floats, Skeleton
from vitruvian.deform.deformer import deformer as bound
from vitruvian.hanim import tables
from vitruvian.hanim.humanoid import Displacer, Humanoid, Segment, Shape, Site
from vitruvian.hanim.normals import turned
from vitruvian.modeling.rest import hip_reach, rest_matrices, rest_turns
from vitruvian.motion.takes import Take, carried, local_matrices

HAND = 0.034 / 1.43  # from the thigh to the middle of a hanging hand, over the height from ankle to skull
_TURNED = 0.1  # radians by which a joint's rest must turn for its limits to mean something else
_FACING = 0.02  # radians that a body may look past +Z


def standard_pose(humanoid: Humanoid, *, deformer: str = "log") -> tuple[Humanoid, list[str]]:
    """A copy in the standard rest pose with all joint rotations, translations and scales at rest, and what was lost.

    The pose that the file shows is the one that is carried over: rest rotations are baked. Skin (by `deformer`, any
    name of `vt.deformer`), Segment geometry, centres, Sites, Displacers, masses and clips follow. Joints that a body
    lacks are left out of account; limbs it has none of stay. Metres, humanoid space; the lowest point comes to Y = 0.
    Raises VitruvianError for a body without joints and for an unknown deformer.
    """
    body = pack(humanoid)
    plain = replace(body.skeleton, binding=None)
    shown = pose_matrices(plain, plain.rotation[None], plain.translation[None])[0]
    local_matrices(plain, shown[None])  # says which joint has no inverse
    stand = _stand(humanoid, body, shown)
    matrices = stand @ shown
    points = _posed(body, matrices, deformer)
    matrices[:, :3, 3] += (shift := _shift(points, plain, matrices))
    points = points + shift
    lost: list[str] = []
    out = _rebuilt(humanoid, body, matrices, points, lost)
    target = replace(pack(out).skeleton, binding=None)
    back = np.linalg.inv(matrices)
    if not (plain.scale == 1).all():
        lost.append("scales of joints: they are part of the surface now, turns of scaled joints are approximate")

    def change(take: Take) -> Take:
        old = pose_matrices(plain, take.rotation, take.translation) @ back
        local = local_matrices(plain, old)
        linear = local[..., :3, :3]
        if not (plain.scale == 1).all():
            u, _, vt = np.linalg.svd(linear)
            linear = u @ vt
        place = local[..., :3, 3] - target.centers + np.einsum("fjab,jb->fja", local[..., :3, :3], target.centers)
        return Take(rot.from_matrix(linear), place)

    return carried(humanoid, plain, out, target, change, dense=False), lost


def _names(skeleton: Skeleton) -> tuple[str, ...]:
    """2.0 names where the standard knows the joint; each once."""
    seen: set[str] = set()
    out = []
    for name in skeleton.names:
        known = tables.canonical(name)
        out.append(known if known and known not in seen else f"({name})")
        seen.add(out[-1])
    return tuple(out)


def _stand(humanoid: Humanoid, body: Body, shown: Floats) -> Floats:
    """(J,4,4) what takes the pose that the file shows to the standard one, but for its place."""
    skeleton = body.skeleton
    names = _names(skeleton)
    index = {n: i for i, n in enumerate(names)}
    centers = np.einsum("jab,jb->ja", shown[:, :3, :3], skeleton.centers) + shown[:, :3, 3]
    tips = _tips(humanoid, index, shown)
    start = _upright(index, centers)
    matrices = rest_matrices(skeleton.parents, centers, rest_turns(names, skeleton.parents, centers, tips, 0.0, start))
    points = _posed(body, shown, "linear")
    width = hip_reach(points, body.skin.weights, index, centers, matrices)
    if width > 0:
        ankle, skull = index.get("l_talocrural"), index.get("skullbase")
        tall = 1.43 if ankle is None or skull is None else float(np.linalg.norm(centers[skull] - centers[ankle]))
        turns = rest_turns(names, skeleton.parents, centers, tips, width + HAND * tall, start)
        matrices = rest_matrices(skeleton.parents, centers, turns)
    return matrices


def _upright(index: dict[str, int], centers: Floats) -> Floats:
    """(4,) the turn that sets the whole body upright and makes it face +Z; none for a body that already does."""
    turn = rot.IDENTITY.copy()
    if "skullbase" in index and "humanoid_root" in index:
        trunk = centers[index["skullbase"]] - centers[index["humanoid_root"]]
        axis = np.zeros(3)
        axis[np.argmax(np.abs(trunk))] = np.sign(trunk[np.argmax(np.abs(trunk))])
        turn = rot.between(axis, np.array([0.0, 1.0, 0.0]))
    pairs = [("l_hip", "r_hip"), ("l_shoulder", "r_shoulder")]
    across = [centers[index[a]] - centers[index[b]] for a, b in pairs if a in index and b in index]
    if not across:
        return turn
    left = rot.rotate(turn, np.sum(across, axis=0))
    angle = float(np.arctan2(-left[2], left[0]))  # of the body's left from +X about Y
    if abs(angle) < _FACING:
        return turn
    return rot.multiply(rot.from_vector(np.array([0.0, -angle, 0.0])), turn)


def _tips(humanoid: Humanoid, index: dict[str, int], shown: Floats) -> dict[str, Floats]:
    """Ends of the last phalanges where Sites say them, by joint, in the pose that the file shows."""
    holder = tables.segments()
    out = {}
    for number, joint in enumerate({id(j): j for j in humanoid.joints()}.values()):
        for site in [*joint.sites, *(s for g in joint.segments for s in g.sites)]:
            known = tables.canonical(site.name.removesuffix("_tip"), "segment") if site.name.endswith("_tip") else None
            if known and index.get(holder[known]) == number:
                place = site.center + site.translation
                out[holder[known]] = shown[number, :3, :3] @ place + shown[number, :3, 3]
    return out


def _posed(body: Body, matrices: Floats, name: str) -> Floats:
    """(V,3) all vertices moved from rest by matrices (J,4,4), weights as shares of one; those without go with the root."""
    whole = matrices if body.skeleton.binding is None else matrices @ body.skeleton.binding
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        moved = bound(name, replace(body, skin=replace(body.skin, morphs=())), weights="normalise")(whole)
    out: Floats = moved.astype(np.float64)
    loose = body.skin.weights.sums == 0
    out[loose] = body.skin.rest[loose] @ matrices[0, :3, :3].T + matrices[0, :3, 3]
    return out


def _shift(points: Floats, skeleton: Skeleton, matrices: Floats) -> Floats:
    """(3,) what brings the soles to Y = 0, the middle of the hips to X = 0 and a body far off the Y axis onto it."""
    names = _names(skeleton)
    centers = np.einsum("jab,jb->ja", matrices[:, :3, :3], skeleton.centers) + matrices[:, :3, 3]
    cloud = points if len(points) else centers
    index = {n: i for i, n in enumerate(names)}
    hips = [centers[index[n], 0] for n in ("l_hip", "r_hip") if n in index]
    middle = np.mean(hips) if len(hips) == 2 else centers[0, 0]
    tall = max(float(np.ptp(cloud[:, 1])), 1e-9)
    depth = float(cloud[:, 2].mean())
    down = -float(cloud[:, 1].min()) if len(points) else 0.0
    return np.array([-middle, down, -depth if abs(depth) > 0.05 * tall else 0.0])


@dataclass(eq=False)
class _Mover:
    """Moves what is rigid by the matrix of its joint; shapes that shared points share them again."""

    matrix: Floats
    seen: dict[tuple[int, bytes], Shape]

    def shape(self, shape: Shape) -> Shape:
        moved = turned(shape, self.matrix)
        key = (id(shape.points), b"" if shape.transform is None else shape.transform.tobytes())
        first = self.seen.setdefault(key, moved)
        normals = moved.normals
        if normals is not None and first.normals is not None and np.array_equal(first.normals, normals):
            normals = first.normals
        return replace(moved, points=first.points, normals=normals, node=None)

    def site(self, site: Site) -> Site:
        turn = self.matrix[:3, :3]
        rotation = rot.multiply(rot.from_matrix(turn), rot.from_axis_angle(site.rotation))
        place = turn @ (site.translation + site.center) + self.matrix[:3, 3] - site.center
        return replace(site, rotation=rot.to_axis_angle(rotation), translation=place)

    def displacer(self, d: Displacer, before: Floats | None = None) -> Displacer:
        turn = self.matrix[:3, :3] if before is None else self.matrix[:3, :3] @ before[:3, :3]
        return replace(d, displacements=d.displacements @ turn.T)

    def segment(self, segment: Segment) -> None:
        model = next((s for s in segment.shapes if s.points is not None), None)
        turn = self.matrix[:3, :3]
        segment.displacers = [self.displacer(d, model.transform if model else None) for d in segment.displacers]
        segment.shapes = [s if s.points is None else self.shape(s) for s in segment.shapes]
        segment.sites = [self.site(s) for s in segment.sites]
        if segment.mass or segment.center_of_mass.any():
            segment.center_of_mass = turn @ segment.center_of_mass + self.matrix[:3, 3]
        segment.moments_of_inertia = (turn @ segment.moments_of_inertia.reshape(3, 3) @ turn.T).reshape(9)


def _rebuilt(humanoid: Humanoid, body: Body, matrices: Floats, points: Floats, lost: list[str]) -> Humanoid:
    """The humanoid with every part moved by its joint; no clips yet."""
    out = humanoid.copied()
    count = len(humanoid.skin_coord)
    skin = points[:count] if len(body.skin.rest) >= count else humanoid.skin_coord
    every = list({id(j): j for j in out.joints()}.values())
    local = matrices[:, :3, :3].copy()
    for j, parent in enumerate(body.skeleton.parents):
        if parent >= 0:
            local[j] = matrices[parent, :3, :3].T @ matrices[j, :3, :3]
    freed = []
    for number, joint in enumerate(every):
        mover = _Mover(matrices[number], {})
        joint.center = matrices[number, :3, :3] @ joint.center + matrices[number, :3, 3]
        joint.rotation, joint.translation = np.array([0.0, 0.0, 1.0, 0.0]), np.zeros(3)
        joint.scale, joint.scale_orientation = np.ones(3), np.array([0.0, 0.0, 1.0, 0.0])
        joint.displacers = [mover.displacer(d) for d in joint.displacers]
        joint.sites = [mover.site(s) for s in joint.sites]
        for segment in joint.segments:
            mover.segment(segment)
            for shape in segment.shapes:
                if shape.skin_index is not None:
                    shape.points = skin[shape.skin_index]
        angle = np.arccos(np.clip((np.trace(local[number]) - 1) / 2, -1, 1))
        if number and angle > _TURNED and (len(joint.llimit) or len(joint.ulimit)):
            freed.append(joint.name)
            joint.llimit, joint.ulimit = np.zeros(0), np.zeros(0)
    if freed:
        some = ", ".join(freed[:4]) + (", ..." if len(freed) > 4 else "")
        lost.append(f"limits of {len(freed)} joints ({some}): they were angles from the former rest pose")
    if humanoid.binding:
        lost.append("binding matrices: they are part of the surface now")
    partial = int(((body.skin.weights.sums > 0) & (np.abs(body.skin.weights.sums - 1) > 1e-3)).sum())
    if partial:
        lost.append(f"{partial} vertices have weights that do not sum to one: they were re-posed as if they did")
    normal = humanoid.skin_normal
    if normal is not None and len(normal) == count and count:
        normal = _turned_normals(body, matrices, normal)
    root = matrices[0]
    fixed = [s if s.points is None else turned(s, root) for s in out.skin]
    stood = replace(
        out, skin=fixed, skin_coord=skin, skin_normal=normal, binding={}, motions=[], tracks=[], made_from=None
    )
    return stood.settled()


def _turned_normals(body: Body, matrices: Floats, normals: Floats) -> Floats:
    """Unit normals (n,3) of the skin turned by the weighted rotations of its joints."""
    w = body.skin.weights
    mine = w.vertex < len(normals)
    each = np.einsum("nab,nb->na", matrices[w.joint[mine], :3, :3], normals[w.vertex[mine]]) * w.weight[mine, None]
    total = np.stack([np.bincount(w.vertex[mine], each[:, k], minlength=len(normals)) for k in range(3)], axis=1)
    size = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(size > 1e-12, total / np.where(size > 1e-12, size, 1.0), normals)
