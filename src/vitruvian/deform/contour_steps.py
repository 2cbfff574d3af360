"""How contours move: each takes shares of the local motions of a chain of joints, root to tip.

Source: cross-section deformation of H-Anim bodies, formulas (2) and (3); the exact twist is swing-twist about the bone.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.contours import Contours
from vitruvian.body.rotations import from_matrix, from_vector, inverse, multiply, to_matrix, unit
from vitruvian.body.types import Body, Floats, Ints, Skeleton
from vitruvian.deform.motions import NEAR
from vitruvian.deform.survey import vector_areas
from vitruvian.native import kernels

LIMIT = 1.5  # how much a mitre may widen


@dataclass(frozen=True, eq=False)
class Program:
    """What turns which contour, as flat arrays; C contours, L pairs of joints, n steps. See src/native/kernels.h."""

    center: Floats
    link: Ints
    axis: Floats
    bone: Floats
    base: Ints
    row: Ints
    step: Ints
    swing: Floats
    twist: Floats
    middle: Floats
    along: Floats
    frame: Ints
    diversion: Floats
    mitre: Floats
    mitre_link: Ints
    mitre_share: Floats
    bulge: Floats
    bulge_link: Ints
    recentre: Floats
    limb: Ints
    way: Floats
    aside: Floats
    seam: Floats
    paper: bool = False  # twists as first published: the axis-angle's component along the bone

    def __len__(self) -> int:
        return len(self.base)

    @cached_property
    def bound(self) -> object:
        """As the kernel takes it."""
        p, native = self, kernels()
        assert native is not None
        arrays = (
            p.center, p.link, p.axis, p.bone, p.base, p.row, p.step, p.swing, p.twist, p.middle, p.along, p.frame,
            p.diversion, p.mitre, p.mitre_link, p.mitre_share, p.bulge, p.bulge_link,
            p.recentre, p.limb, p.way, p.aside, p.seam, p.same, p.whole,
        )  # fmt: skip
        return native.bind_contours(*map(np.ascontiguousarray, arrays))

    @cached_property
    def same(self) -> Ints:
        """(C,) an earlier contour that takes the same steps from the same base, or -1: what turns it turns this one."""
        first: dict[tuple[int, bytes], int] = {}
        out = np.full(len(self), -1, np.int32)
        steps = np.stack([self.step, self.swing, self.twist], axis=1).astype(np.float64)
        for k in range(len(self)):
            key = (int(self.base[k]), steps[self.row[k] : self.row[k + 1]].tobytes())
            other = first.setdefault(key, k)
            if other < k:
                out[k] = other
        return out

    @cached_property
    def whole(self) -> NDArray[np.uint8]:
        """(L,) whether some step takes a share of that pair's turn as a whole, not split into swing and twist."""
        out = np.zeros(len(self.link), np.uint8)
        out[self.step[np.isnan(self.twist)]] = 1
        return out

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in self.__dict__.items() if name != "bound"}


def program(body: Body, surfaces: Collection[Contours], *, paper: bool = False) -> Program:
    """The steps of all contours of `surfaces`, one after the other.

    What a contour takes in full and nothing follows before is left to the joint's own matrix; what it takes nothing of is
    left out. So contours that share a seam have the same steps.
    """
    skeleton, rest = body.skeleton, body.skin.rest
    links: dict[tuple[int, int], int] = {}
    axes: list[Floats] = []
    base, row, step, swing, twist, lean, share, wide, lies, ends = [], [0], [], [], [], [], [], [], [], []
    for surface in surfaces:
        chain = surface.joints.tolist()
        near = [int(skeleton.parents[chain[0]]), *chain[:-1]]
        after = [*chain[1:], _next(skeleton, chain[-1], rest[surface.vertices[-1]].mean(axis=0))]
        here = []
        for a, b, axis in zip(near, chain, surface.axes, strict=True):
            if (a, b) not in links:
                links[a, b] = len(links)
                axes.append(axis / (np.linalg.norm(axis) or 1.0))
            here.append(links[a, b])
        whole = (surface.swing == 1) & (np.isnan(surface.twist) | (surface.twist == 1))
        none = (surface.swing == 0) & (np.isnan(surface.twist) | (surface.twist == 0))
        for k in range(len(surface)):
            first = int(np.argmin(np.append(whole[k], False)))
            base.append(near[0] if first == 0 else chain[first - 1])
            taken = [i for i in range(first, len(chain)) if not none[k, i]]
            step += [here[i] for i in taken]
            swing += surface.swing[k, taken].tolist()
            twist += surface.twist[k, taken].tolist()
            row.append(len(step))
            # A contour lies on the bone below the last joint that it takes more than half of, and lacks the rest.
            missing = [1 - s if s >= 0.5 else s for s in surface.swing[k]]
            worst = int(np.argmax(missing))
            lean.append(here[worst])
            share.append(missing[worst])
            lies.append((near[worst], chain[worst]) if surface.swing[k, worst] <= 0.5 else (chain[worst], after[worst]))
            ends.append(len(base) - 1 - k + (len(surface) - 1 if worst else 0))
            wide.append(here[surface.muscle] if surface.muscle >= 0 else 0)
    points = [rest[s.vertices] for s in surfaces]
    middle = np.concatenate([
        p.mean(axis=1) if s.middle is None else s.middle for s, p in zip(surfaces, points, strict=True)
    ])  # fmt: skip
    along = np.concatenate(
        [normals(p) if s.normal is None else s.normal for s, p in zip(surfaces, points, strict=True)]
    )
    flat = lambda field: np.concatenate([getattr(s, field) for s in surfaces])  # noqa: E731
    pairs = np.array(list(links), np.int32).reshape(-1, 2)
    bone = np.array([_bone(body, a, b) for a, b in pairs.tolist()], np.float64).reshape(-1, 3)
    way = np.array([_way(skeleton, *held, bone[at]) for held, at in zip(lies, lean, strict=True)])
    aside, along_bone = middle - skeleton.centers[pairs[lean, 1]], lambda v: np.sum(v * way, axis=1)
    return Program(
        center=skeleton.centers,
        link=pairs,
        axis=np.array(axes, np.float64).reshape(-1, 3),
        bone=bone,
        base=np.array(base, np.int32),
        row=np.array(row, np.int32),
        step=np.array(step, np.int32),
        swing=np.array(swing, np.float64),
        twist=np.array(twist, np.float64),
        middle=middle,
        along=along,
        frame=np.repeat([s.joint for s in surfaces], [len(s) for s in surfaces]).astype(np.int32),
        diversion=flat("diversion"),
        mitre=flat("mitre"),
        mitre_link=np.array(lean, np.int32),
        mitre_share=np.array(share, np.float64),
        bulge=np.where(np.repeat([s.muscle for s in surfaces], [len(s) for s in surfaces]) >= 0, flat("bulge"), 0.0),
        bulge_link=np.array(wide, np.int32),
        recentre=flat("recentre"),
        limb=np.array([a for a, _ in lies], np.int32),
        way=way,
        aside=aside - along_bone(aside)[:, None] * way,
        seam=along_bone(middle[ends] - skeleton.centers[pairs[lean, 1]]),
        paper=paper,
    )


def _next(skeleton: Skeleton, joint: int, end: Floats) -> int:
    """The joint that the bone below `joint` ends in, the nearest to `end`; -1: none."""
    below = np.flatnonzero(skeleton.parents == joint)
    return int(below[np.argmin(np.linalg.norm(skeleton.centers[below] - end, axis=1))]) if len(below) else -1


def _way(skeleton: Skeleton, start: int, end: int, usual: Floats) -> Floats:
    """Unit direction of a bone from joint to joint, on the side of `usual`, which it is where it does not say."""
    way = skeleton.centers[end] - skeleton.centers[start] if min(start, end) >= 0 else usual
    length = float(np.linalg.norm(way))
    way = way / length if length > 1e-9 else usual
    return way if way @ usual > 0.1 else usual  # a bone bent by more than that at rest is another limb's


def _bone(body: Body, near: int, far: int) -> Floats:
    """Unit direction of the limb at joint `far`: between the way to it and the way on."""
    skeleton = body.skeleton
    below = np.flatnonzero(skeleton.parents == far)
    out = np.zeros(3)
    if near >= 0:
        out += unit(skeleton.centers[far] - skeleton.centers[near])
    if len(below):
        out += unit(skeleton.centers[below[0]] - skeleton.centers[far])
    return unit(out) if np.linalg.norm(out) > 1e-9 else np.array([0.0, -1.0, 0.0])


def normals(points: Floats) -> Floats:
    """(C,3) unit normals of contours (C,P,3), by their vector areas."""
    area = 2 * vector_areas(points)
    size = np.linalg.norm(area, axis=1, keepdims=True)
    return np.where(size > 1e-15, area / np.where(size > 0, size, 1), [0.0, 1.0, 0.0])


def motions(program: Program, matrices: Floats, *, follow: bool = True, with_joints: bool = True) -> Floats:
    """(F,J+C,4,4): rigid joint matrices (F,J,4,4) as they are, unless they are left out, then the motions of all contours.

    `follow`: in consecutive frames rotations keep their sense past 180 degrees.
    """
    native = kernels()
    if native is None or program.paper:
        own = twin(program, matrices, follow=follow)
        return np.concatenate([matrices, own], axis=1) if with_joints else own
    return native.contour_motions(program.bound, np.ascontiguousarray(matrices), follow, with_joints)


def twin(program: Program, matrices: Floats, *, follow: bool = True) -> Floats:
    """(F,C,4,4) motions of all contours in NumPy: what they mean."""
    p, frames = program, len(matrices)
    padded = np.concatenate([matrices, np.tile(np.eye(4), (frames, 1, 1, 1))], axis=1)  # -1: does not move
    near, far = padded[:, p.link[:, 0]], matrices[:, p.link[:, 1]]
    center = p.center[p.link[:, 1]]
    back = np.swapaxes(near[..., :3, :3], -1, -2)
    q = from_matrix(back @ far[..., :3, :3])
    q = np.where(q[..., 3:] < 0, -q, q)
    for f in range(1, frames if follow else 0):
        dot = np.sum(q[f] * q[f - 1], axis=1)
        q[f] = np.where(((np.abs(dot) >= NEAR) & (dot < 0))[:, None], -q[f], q[f])
    whole = _vector(q)
    along = np.sum(q[..., :3] * p.axis, axis=-1)
    about = np.concatenate([along[..., None] * p.axis, q[..., 3:]], axis=-1)
    size = np.linalg.norm(about, axis=-1, keepdims=True)
    about = np.where(size < 1e-12, [0.0, 0, 0, 1], about / np.where(size < 1e-12, 1, size))
    angle = np.where(size[..., 0] < 1e-12, 0.0, 2 * np.arctan2(along, q[..., 3]))
    if p.paper:
        angle = np.sum(whole * p.axis, axis=-1)
        about = from_vector(p.axis * angle[..., None])
    split = _vector(multiply(q, inverse(about)))
    moved = np.einsum("flab,lb->fla", far[..., :3, :3], center) + far[..., :3, 3] - near[..., :3, 3]
    offset = np.einsum("flab,flb->fla", back, moved) - center
    out = padded[:, p.base].copy()
    steps = np.diff(p.row)
    for number in range(int(steps.max(initial=0))):
        which = np.flatnonzero(steps > number)
        entry = p.row[which] + number
        link, share, twist = p.step[entry], p.swing[entry][:, None], p.twist[entry][:, None]
        parted = from_vector(split[:, link] * share)
        parted = multiply(parted, from_vector(p.axis[link] * angle[:, link, None] * np.nan_to_num(twist)))
        local = np.tile(np.eye(4), (frames, len(which), 1, 1))
        local[..., :3, :3] = to_matrix(np.where(np.isnan(twist), from_vector(whole[:, link] * share), parted))
        c = center[link]
        local[..., :3, 3] = c + share * offset[:, link] - np.einsum("fcab,cb->fca", local[..., :3, :3], c)
        out[:, which] = out[:, which] @ local
    place = lambda m: np.einsum("fcab,cb->fca", m[..., :3, :3], p.middle) + m[..., :3, 3]  # noqa: E731
    here = place(out)
    shift = p.diversion[:, None] * (place(matrices[:, p.frame]) - here)
    if p.recentre.any():
        shift = shift + _recentred(p, padded[:, p.limb], out, here + shift)
    bend = np.linalg.norm(split, axis=-1)
    u = np.cross(split[:, p.mitre_link], p.bone[p.mitre_link])
    size = np.linalg.norm(u, axis=-1, keepdims=True)
    u = np.where(size > 1e-12, u / np.where(size > 0, size, 1), 0.0)
    lacks = np.minimum(p.mitre_share * bend[:, p.mitre_link], 1.5)
    stretch = p.mitre * (np.minimum(1 / np.cos(lacks), LIMIT) - 1)
    widen = 1 + p.bulge * (1 - np.cos(bend[:, p.bulge_link])) / 2
    eye = np.eye(3)
    shape = widen[..., None, None] * (eye + stretch[..., None, None] * u[..., :, None] * u[..., None, :])
    shape = shape + (1 - widen)[..., None, None] * p.along[:, :, None] * p.along[:, None, :]
    out[..., :3, :3] = out[..., :3, :3] @ shape
    out[..., :3, 3] += here - place(out) + shift
    return out


def _recentred(p: Program, bone: Floats, motion: Floats, here: Floats) -> Floats:
    """(F,C,3) how far centres, now `here` (F,C,3), go so that contours, which `motion` (F,C,4,4) turns, turn about their
    places on the bone, which `bone` (F,C,4,4) moves, and stand off from it as far as at rest.

    A centre's offset from the bone is carried along with the contour, laid across the bone, and given its length at rest;
    then the centre slides along the bone into the contour's plane. So all agree at a seam, whichever bone they go by.
    """
    back, dot = np.swapaxes(bone[..., :3, :3], -1, -2), lambda a, b: np.sum(a * b, axis=-1, keepdims=True)
    turn = lambda r, v: np.einsum("fcab,fcb->fca", r, np.broadcast_to(v, here.shape))  # noqa: E731
    against, plane = back @ motion[..., :3, :3], p.bone[p.mitre_link]
    gone = turn(back, here - bone[..., :3, 3]) - p.middle
    offset = turn(against, p.aside) - p.aside
    offset = p.aside + (offset - dot(offset, p.way) * p.way)
    size = dot(offset, offset)
    offset *= np.sqrt(np.where(size > 1e-24, dot(p.aside, p.aside) / np.where(size > 1e-24, size, 1), 1.0))
    normal, lag = turn(against, plane), p.seam[:, None] * (turn(against, p.way) - p.way)
    slide = (dot(offset - lag, normal) - dot(p.aside, plane)) / np.maximum(dot(p.way, normal), 0.2)
    return turn(bone[..., :3, :3], p.recentre[:, None] * (offset - p.aside - slide * p.way - gone))


def _vector(q: Floats) -> Floats:
    """Axis times angle, the angle in 0..2 pi as the sign of the quaternion says."""
    length = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(length, q[..., 3:])
    return q[..., :3] * np.where(length < 1e-12, 2.0, angle / np.where(length < 1e-12, 1.0, length))
