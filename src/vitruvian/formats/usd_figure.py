"""A humanoid as UsdSkel: SkelRoot, Skeleton, SkelAnimation, BlendShapes, and Sites as Xforms.

Bridge (own derivation from ISO/IEC 19774-1 and the UsdSkel schemas): with M_j the joint matrix in humanoid space, c_j
its centre and Q_j the frame in which it is scaled (identity unless scaleOrientation is used), the joint stands at
G_j = M_j T(c_j) Q_j. Its bind transform is T(c_j) Q_j; its local transform is
T(Q_p^-1 (translation + c_j - c_p)) R(Q_p^-1 R Q_j) S, p the parent: always a translation, a rotation and a scale, as
SkelAnimation wants them. USD's matrices are for row vectors, so ours are transposed on the way.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.kinematics import joint_matrices, move
from vitruvian.body.rotations import from_axis_angle, from_matrix, inverse, multiply, rotate, to_matrix
from vitruvian.body.types import Body, Floats, Skeleton, Weights
from vitruvian.errors import VitruvianError
from vitruvian.formats.gltf_skin import completed, measure
from vitruvian.formats.usd import identifier, place
from vitruvian.formats.usd_mesh import Surface, bounds, surfaces, vectors, write_surface
from vitruvian.motion.types import Motion, continuous
from vitruvian.stage.clip import Clip

if TYPE_CHECKING:
    from vitruvian.formats.usd import Stage
    from vitruvian.hanim.humanoid import Joint, Site

STATIC = "static"
_STILL = 1e-9
_ROUNDING = 1e-4  # sums of weights nearer to one than this were meant to be one
_HELD = 1 << 26  # bytes of deformed points that are held at once


def figure(stage: Stage, clip: Clip, report: dict[str, Any]) -> Any:
    """Write a clip as one SkelRoot, which is answered; adds to the report what `write_usd` says."""
    from pxr import UsdSkel

    body, motion = clip.body, clip.motion
    root = stage.top("SkelRoot", body.name or "humanoid")
    place(root, body.placement)
    codes = None if motion is None else stage.codes(len(motion), motion.fps)
    full = completed(body.skin.weights, len(body.skeleton))
    rig = Rig(body, still=bool(len(full.joint)) and int(full.joint.max()) == len(body.skeleton))
    skeleton = rig.write(stage, root, clip)
    looks: dict[tuple, Any] = {}
    channels: dict[str, NDArray] = {}  # token of a displacer -> its weights over time
    if len(body.skin.triangles):
        for surface in surfaces(body.skin, _shared(clip)):
            prim = write_surface(stage, root, looks, surface)
            if clip.deformer == "dual-quaternion":
                UsdSkel.BindingAPI.Apply(prim).CreateSkinningMethodAttr(UsdSkel.Tokens.dualQuaternion)
            _bind(prim, skeleton, rig, surface, full, report)
            _blend_shapes(stage, prim, surface, rig, motion, channels)
            if len({p.double_sided for p in surface.parts}) > 1:
                report["lost"].append(
                    f"{surface.name}: its one-sided parts show both sides, a USD mesh has one setting"
                )
        joints, weights = padded(full)
        found = measure(body, motion, joints, weights, clip.deformer)
        worst = max(report["max_vertex_error_m"], found["max_vertex_error_m"])
        report |= {**found, "max_vertex_error_m": worst}
        report["overweight_vertices"] = int((body.skin.weights.sums > 1 + _ROUNDING).sum())
        _extent(root, clip, codes)
    animation = rig.animate(stage, root, motion, channels, codes)
    if motion is not None and motion.joint_scale is not None:
        report["lost"].append("scales of joints over time: they stay as they are at rest")
    rounded = np.abs(body.skeleton.scale.astype(np.float16) - body.skeleton.scale).max(axis=1) > 0
    if motion is not None and rounded.any():
        report["lost"].append(f"{int(rounded.sum())} joint scales are rounded to the half floats of SkelAnimation")
    if animation is not None:
        UsdSkel.BindingAPI(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    sites(stage, root, clip, codes)
    unknown = [n for n in (motion.weights if motion is not None else {}) if n not in {m.name for m in body.skin.morphs}]
    if unknown:
        report["lost"].append(f"the motion of {len(unknown)} displacers that move no vertex: {', '.join(unknown[:5])}")
    report["joints"] += len(body.skeleton)
    report["vertices"] += len(body.skin.rest)
    report["triangles"] += len(body.skin.triangles)
    return root


def facts(clip: Clip) -> dict[str, Any]:
    """What H-Anim says of the whole figure, for customData."""
    from pxr import Vt

    h = clip.humanoid
    out: dict[str, Any] = {"name": h.name, "version": h.version, "loa": int(h.loa)}
    out["skeletalConfiguration"] = h.skeletal_configuration
    if h.info:
        out["info"] = Vt.StringArray([f"{k}={v}" for k, v in h.info.items()])
    if clip.motion is not None:
        out |= {"motion": clip.motion.name, "loop": bool(clip.motion.loop)}
    return out


def _tree(clip: Clip) -> list[Joint] | None:
    """The humanoid's joints in the order of the body's, or None when the body was made otherwise."""
    joints = list({id(j): j for j in clip.humanoid.joints()}.values())
    return joints if tuple(j.name for j in joints) == clip.body.skeleton.names else None


def _shared(clip: Clip) -> int:
    """How many of the body's first vertices are the seamless skin's; all when the body was made otherwise."""
    coord, rest = clip.humanoid.skin_coord, clip.body.skin.rest
    if not len(coord):
        return 0 if _tree(clip) is not None and clip.humanoid.segments() else len(rest)
    same = len(coord) <= len(rest) and np.allclose(rest[: len(coord)], coord, rtol=0, atol=1e-12)
    return len(coord) if same else len(rest)


class Rig:
    """The joints as UsdSkel knows them. names (J,) unique identifiers, paths (J,) tokens, bind (J,4,4) and the local
    transform at rest as translation (J,3), rotation (J,4) and scale (J,3). With `still` one more joint follows that
    never moves: it carries what is missing to a weight of one."""

    def __init__(self, body: Body, *, still: bool):
        s = body.skeleton
        self.skeleton, self.still = s, still
        taken: set[str] = set()
        self.names = [identifier(n, taken) for n in s.names]
        self.paths: list[str] = []
        for name, p in zip(self.names, s.parents):
            self.paths.append(name if p < 0 else f"{self.paths[p]}/{name}")
        self.frame = _frames(s)
        above = np.where(s.parents >= 0, s.parents, 0)
        root = s.parents[:, None] < 0
        self.back = inverse(np.where(root, [0.0, 0, 0, 1], self.frame[above]))
        self.offset = s.centers - np.where(root, 0.0, s.centers[above])
        self.translation, self.rotation = self.local(s.translation[None], s.rotation[None])
        self.bind = np.tile(np.eye(4), (len(s), 1, 1))
        self.bind[:, :3, :3], self.bind[:, :3, 3] = to_matrix(self.frame), s.centers
        if s.binding is not None:
            try:
                self.bind = np.linalg.inv(s.binding) @ self.bind
            except np.linalg.LinAlgError:
                raise VitruvianError("USD: expected binding matrices that can be inverted, found a flat one") from None
        self.rest = np.tile(np.eye(4), (len(s), 1, 1))
        self.rest[:, :3, :3] = to_matrix(self.rotation[0]) * s.scale[:, None, :]
        self.rest[:, :3, 3] = self.translation[0]
        self.spare = identifier(STATIC, taken)

    def local(self, translation: Floats, rotation: Floats) -> tuple[Floats, Floats]:
        """Local translations (F,J,3) and rotations (F,J,4) of H-Anim's (F,J,3) and (F,J,4)."""
        moved = rotate(self.back, translation + self.offset)
        return moved, multiply(multiply(self.back, rotation), self.frame)

    def write(self, stage: Stage, root: Any, clip: Clip) -> Any:
        """The Skeleton prim."""
        from pxr import UsdSkel, Vt

        skeleton = UsdSkel.Skeleton.Define(stage.usd, root.GetPath().AppendChild("Skeleton"))
        UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
        extra = [self.spare] if self.still else []
        spare = [np.eye(4)] if self.still else []
        skeleton.CreateJointsAttr(Vt.TokenArray([*self.paths, *extra]))
        skeleton.CreateJointNamesAttr(Vt.TokenArray([*self.names, *extra]))
        skeleton.CreateBindTransformsAttr(_matrices(np.stack([*self.bind, *spare])))
        skeleton.CreateRestTransformsAttr(_matrices(np.stack([*self.rest, *spare])))
        about: dict[str, Any] = {"joints": self._about(_tree(clip))}
        if self.still:
            about["static"] = self.spare
        skeleton.GetPrim().SetCustomData({"hanim": about})
        root.SetCustomData({"hanim": facts(clip)})
        return skeleton

    def _about(self, joints: list[Joint] | None) -> dict[str, dict[str, Any]]:
        """What UsdSkel has no place for, joint by joint: limits, stiffness, Segments with their masses, names."""
        from pxr import Vt

        s = self.skeleton
        array = lambda values: Vt.DoubleArray([float(x) for x in np.ravel(values)])  # noqa: E731
        out: dict[str, dict[str, Any]] = {}
        for j, name in enumerate(self.names):
            item: dict[str, Any] = {} if name == s.names[j] else {"name": s.names[j]}
            for k, side in enumerate(("llimit", "ulimit")):
                if np.isfinite(s.limits[j, :, k]).any():
                    item[side] = array(s.limits[j, :, k])
            if np.abs(s.limit_orientation[j, :3]).max() > 0:
                item["limitOrientation"] = array(s.limit_orientation[j])
            if s.stiffness[j].any():
                item["stiffness"] = array(s.stiffness[j])
            segments = joints[j].segments if joints is not None else []
            for k, g in enumerate(segments):
                about: dict[str, Any] = {"name": g.name}
                if g.mass:
                    about["mass"] = float(g.mass)
                if np.any(g.center_of_mass):
                    about["centerOfMass"] = array(g.center_of_mass)
                if np.any(g.moments_of_inertia):
                    about["momentsOfInertia"] = array(g.moments_of_inertia)
                item.setdefault("segments", {})[str(k)] = about
            if item:
                out[name] = item
        return out

    def animate(
        self, stage: Stage, root: Any, motion: Motion | None, channels: dict[str, NDArray], codes: list[float] | None
    ) -> Any:
        """The SkelAnimation: the joints that leave the file's pose, and displacers with a weight; None for neither."""
        from pxr import UsdSkel, Vt

        s = self.skeleton
        channels = {token: w for token, w in channels.items() if w.any()}
        joints = np.zeros(0, np.int64)
        if motion is not None:
            shift = motion.joint_translation
            if shift is None:
                shift = np.repeat(s.translation[None], len(motion), axis=0)
                shift[:, 0] = motion.translation
            moved, turned = self.local(shift, motion.rotation)
            twin = np.concatenate([self.rotation, turned])
            gone = np.abs(continuous(twin)[1:] - self.rotation).max(axis=(0, 2)) > _STILL
            joints = np.flatnonzero(gone | (np.abs(moved - self.translation).max(axis=(0, 2)) > _STILL))
        if not len(joints) and not channels:
            return None
        out = UsdSkel.Animation.Define(stage.usd, root.GetPath().AppendChild("Animation"))
        if len(joints):
            out.CreateJointsAttr(Vt.TokenArray([self.paths[j] for j in joints]))
            _samples(out.CreateTranslationsAttr(), vectors, moved[:, joints], codes)
            _samples(out.CreateRotationsAttr(), _quaternions, turned[:, joints], codes)
            scale = np.ascontiguousarray(s.scale[joints], np.float16)
            out.CreateScalesAttr(Vt.Vec3hArray.FromNumpy(scale))
        if channels:
            out.CreateBlendShapesAttr(Vt.TokenArray(list(channels)))
            frames = max(len(w) for w in channels.values())
            weights = np.stack([np.broadcast_to(w, frames) for w in channels.values()], -1)
            numbers = lambda v: Vt.FloatArray.FromNumpy(np.ascontiguousarray(v, np.float32))  # noqa: E731
            _samples(out.CreateBlendShapeWeightsAttr(), numbers, weights, codes)
        return out


def _frames(s: Skeleton) -> Floats:
    """(J,4): scaleOrientation where it matters, else the identity."""
    turn = to_matrix(s.scale_orientation)
    stretch = np.einsum("jab,jb,jcb->jac", turn, s.scale, turn)
    plain = np.abs(stretch - s.scale[:, None] * np.eye(3)).max(axis=(1, 2)) < 1e-12
    return np.where(plain[:, None], [0.0, 0, 0, 1], s.scale_orientation)


def _matrices(matrices: Floats) -> Any:
    from pxr import Vt

    return Vt.Matrix4dArray.FromNumpy(np.ascontiguousarray(matrices.transpose(0, 2, 1)))


def _quaternions(values: NDArray) -> Any:
    """(n,4) xyzw as USD's quaternions, whose memory has the same order."""
    from pxr import Vt

    return Vt.QuatfArray.FromNumpy(np.ascontiguousarray(values, np.float32))


def _samples(attribute: Any, convert: Any, values: NDArray, codes: list[float] | None) -> None:
    """Values (F,...) over time; once when they do not change."""
    if codes is None or len(values) == 1 or (values == values[:1]).all():
        attribute.Set(convert(values[0]))
        return
    for code, value in zip(codes, values):
        attribute.Set(convert(value), code)


def _bind(prim: Any, skeleton: Any, rig: Rig, surface: Surface, full: Weights, report: dict[str, Any]) -> None:
    """Joints and weights of a surface: for each vertex, or one joint for a rigid piece."""
    from pxr import Gf, Sdf, UsdGeom, UsdSkel, Vt

    api = UsdSkel.BindingAPI.Apply(prim)
    api.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    api.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
    if surface.joint is not None:
        api.CreateJointIndicesPrimvar(True, 1).Set(Vt.IntArray([surface.joint]))
        api.CreateJointWeightsPrimvar(True, 1).Set(Vt.FloatArray([1.0]))
        return
    joints, weights = padded(full)
    joints, weights = joints[surface.source], weights[surface.source]
    k = joints.shape[1]
    api.CreateJointIndicesPrimvar(False, k).Set(Vt.IntArray.FromNumpy(np.ascontiguousarray(joints.reshape(-1))))
    flat = np.ascontiguousarray(weights.reshape(-1), np.float32)
    api.CreateJointWeightsPrimvar(False, k).Set(Vt.FloatArray.FromNumpy(flat))
    sums = surface.skin.weights.sums[surface.source]
    sums = np.where(sums < 1 - _ROUNDING, 1.0, sums)  # what is missing there is on the joint that never moves
    if np.abs(sums - 1).max(initial=0) > 1e-7:  # players want sums of one; the reader gives back what the file had
        kind = Sdf.ValueTypeNames.FloatArray
        kept = UsdGeom.PrimvarsAPI(prim).CreatePrimvar("hanim:weightSum", kind, UsdGeom.Tokens.vertex)
        kept.Set(Vt.FloatArray.FromNumpy(sums.astype(np.float32)))
    report["influences"] = max(report.get("influences", 1), k)


def padded(weights: Weights) -> tuple[NDArray, NDArray]:
    """(V,k) joints and weights, k the most that a vertex has, in float32 steps that sum to one."""
    joints, kept = weights.top(max(1, int(weights.counts.max(initial=1))))
    kept = kept.astype(np.float32).astype(np.float64)
    kept[:, 0] += 1 - kept.sum(axis=1)
    return joints, kept


def _blend_shapes(
    stage: Stage, prim: Any, surface: Surface, rig: Rig, motion: Motion | None, channels: dict[str, NDArray]
) -> None:
    """Displacers that move vertices of this surface; their weights over time go to `channels` by token."""
    from pxr import UsdSkel, Vt

    skin, taken = surface.skin, {c.GetName() for c in prim.GetAllChildren()}
    tokens, targets = [], []
    for m in skin.morphs:
        total = np.zeros((len(skin.rest), 3))
        np.add.at(total, m.index, m.offset)
        total = total[surface.source]
        moved = np.flatnonzero(total.any(axis=1)).astype(np.int32)
        if not len(moved):
            continue
        token = identifier(m.name, taken)
        shape = UsdSkel.BlendShape.Define(stage.usd, prim.GetPath().AppendChild(token))
        shape.CreateOffsetsAttr(vectors(total[moved]))
        shape.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(moved))
        about = {"name": m.name, "joint": rig.names[m.joint], "node": "Segment" if m.before else "Joint"}
        shape.GetPrim().SetCustomData({"hanim": {**about, "weight": float(m.weight)}})
        tokens.append(token)
        targets.append(shape.GetPath())
        moving = None if motion is None else motion.weights.get(m.name)
        channels.setdefault(token, np.array([m.weight]) if moving is None else np.asarray(moving, np.float64))
    if tokens:
        api = UsdSkel.BindingAPI(prim)
        api.CreateBlendShapesAttr(Vt.TokenArray(tokens))
        api.CreateBlendShapeTargetsRel().SetTargets(targets)


def _extent(root: Any, clip: Clip, codes: list[float] | None) -> None:
    """The box of the linear skin in every frame, so that viewers need not skin to frame the figure."""
    from pxr import UsdGeom

    from vitruvian.deform.deformer import deformer

    body, motion = clip.body, clip.motion
    matrices = joint_matrices(body.skeleton, motion)
    named = {m.name for m in body.skin.morphs}
    weights = {} if motion is None else {n: w for n, w in motion.weights.items() if n in named}
    move_skin = deformer("linear", body)
    step = max(1, _HELD // (12 * len(body.skin.rest)))
    boxes = []
    for start in range(0, len(matrices), step):
        some = slice(start, start + step)
        boxes += [bounds(p) for p in move_skin(matrices[some], {n: w[some] for n, w in weights.items()})]
    _samples(UsdGeom.Boundable(root).CreateExtentAttr(), vectors, np.stack(boxes), codes)


def sites(stage: Stage, root: Any, clip: Clip, codes: list[float] | None) -> None:
    """Sites as Xforms that follow their joints, in `root`/Sites; viewpoints, which follow the figure, stand still.

    The value without time is the place at rest, in humanoid space.
    """
    from pxr import Gf, UsdGeom

    s, h = clip.body.skeleton, clip.humanoid
    hung: list[Site | None] = [*h.sites, *(t for j in _tree(clip) or [] for t in _of_joint(j))]
    if [t.name for t in hung if t is not None] != list(s.site_names):
        hung = [None] * len(s.site_names)
    known = {id(t) for t in hung}
    loose = [v for v in h.viewpoints if id(v) not in known]
    if not hung and not loose:
        return
    scope = UsdGeom.Scope.Define(stage.usd, root.GetPath().AppendChild("Sites")).GetPath()
    turn = np.tile([0.0, 0, 0, 1], (len(hung) + len(loose), 1))
    for k, site in enumerate([*hung, *loose]):
        if site is not None:
            turn[k] = from_axis_angle(site.rotation)
    point = np.array([*s.site_points, *(v.center + v.translation for v in loose)])
    n = len(hung)
    matrices = joint_matrices(s, clip.motion)[:, s.site_joints]
    linear = matrices[..., :3, :3]
    length = np.linalg.norm(linear, axis=-2, keepdims=True)
    there = move(matrices, s.site_points)
    turned = continuous(multiply(from_matrix(linear / np.where(length > 0, length, 1)), turn[:n]))
    names = [*s.site_names, *(v.name for v in loose)]
    taken: set[str] = set()
    every, views = [*hung, *loose], {id(v): i for i, v in enumerate(h.viewpoints)}
    for k, name in enumerate(names):
        prim = UsdGeom.Xform.Define(stage.usd, scope.AppendChild(identifier(name, taken)))
        about: dict[str, Any] = {"node": "Site", "name": name, "viewpoint": views.get(id(every[k]), -1)}
        if k < n:
            about |= {"joint": int(s.site_joints[k]), "root": k < len(h.sites) and every[k] is not None}
        prim.GetPrim().SetCustomData({"hanim": about})
        place_at = prim.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble)
        turn_to = prim.AddOrientOp(UsdGeom.XformOp.PrecisionFloat)
        place_at.Set(Gf.Vec3d(*point[k].tolist()))
        turn_to.Set(_quaternion(turn[k]))
        if k >= n:
            continue
        if codes is None:
            moving = np.abs(there[0, k] - point[k]).max() > _STILL or np.abs(turned[0, k] - turn[k]).max() > _STILL
            frames: list[float] = [0.0] if moving else []
        else:
            frames = codes
        for f, code in enumerate(frames):
            place_at.Set(Gf.Vec3d(*there[f, k].tolist()), code)
            turn_to.Set(_quaternion(turned[f, k]), code)


def _of_joint(joint: Joint) -> list[Site]:
    return [*joint.sites, *(t for g in joint.segments for t in g.sites)]


def _quaternion(q: Floats) -> Any:
    from pxr import Gf

    x, y, z, w = (float(v) for v in q)
    return Gf.Quatf(w, x, y, z)
