"""A figure made of capsules, for tests of what is shown: any number of joints and vertices, weights that blend."""

from __future__ import annotations

import numpy as np

from vitruvian.body.types import Body, Morph, Part, Skeleton, Skin, Weights
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.motion.types import Motion
from vitruvian.stage.clip import Clip

# name, parent, centre, radius of the capsule that leads to the joint
BONES = [
    ("humanoid_root", None, (0, 0.95, 0), 0),
    ("vl5", "humanoid_root", (0, 1.05, 0), 0.13),
    ("vt6", "vl5", (0, 1.3, 0), 0.15),
    ("vc4", "vt6", (0, 1.48, 0), 0.06),
    ("skullbase", "vc4", (0, 1.6, 0.01), 0.1),
    *[
        (f"{s}_{name}",
         parent if parent in ("vt6", "humanoid_root") else f"{s}_{parent}", (x if s == "l" else -x, y, z), r)
        for s in "lr"
        for name, parent, (x, y, z), r in [
            ("shoulder", "vt6", (0.19, 1.42, 0), 0.06),
            ("elbow", "shoulder", (0.22, 1.13, 0), 0.05),
            ("wrist", "elbow", (0.23, 0.88, 0.02), 0.04),
            ("carpometacarpal_2", "wrist", (0.235, 0.78, 0.04), 0.035),
            ("hip", "humanoid_root", (0.1, 0.9, 0), 0.1),
            ("knee", "hip", (0.1, 0.5, 0.01), 0.075),
            ("talocrural", "knee", (0.1, 0.09, -0.02), 0.05),
            ("metatarsophalangeal_2", "talocrural", (0.11, 0.045, 0.13), 0.04),
        ]
    ],
]  # fmt: skip


def capsule_body(joints: int = len(BONES), vertices: int = 3000) -> Body:
    """A body of about so many vertices; joints beyond the named ones hang on the wrists like fingers."""
    names = [b[0] for b in BONES]
    parents = [-1 if b[1] is None else names.index(b[1]) for b in BONES]
    centers = [list(b[2]) for b in BONES]
    for i in range(joints - len(BONES)):
        wrist = names.index("lr"[i % 2] + "_wrist")
        names.append(f"extra_{i}")
        parents.append(wrist)
        centers.append([centers[wrist][0], 0.84, 0.01 * (i // 2 % 7)])
    around = max(8, round((vertices / len(BONES)) ** 0.5))
    along = max(4, vertices // (len(BONES) * around))
    rest, triangles, pairs, colors, parts = [], [], [], [], []
    for j, (name, parent, center, radius) in enumerate(BONES):
        if parent is None:
            continue
        a, b = np.array(centers[parents[j]]), np.array(center)
        if name == "skullbase":
            b = b + [0, 0.12, 0.02]
        axis = (b - a) / np.linalg.norm(b - a)
        u = np.cross(axis, [0.3, 0.1, 1.0])
        u /= np.linalg.norm(u)
        w = np.cross(axis, u)
        start, length = len(rest), np.linalg.norm(b - a)
        for k in range(along):
            t = (1 - np.cos(np.pi * k / (along - 1))) / 2
            s = t * (length + 2 * radius) - radius
            over = max(0.0, -s, s - length)
            ring = radius * max(0.0, 1 - (over / radius) ** 2) ** 0.5
            near = np.clip(s / length, 0, 1)
            share = near * near * (3 - 2 * near)
            for i in range(around):
                h = 2 * np.pi * i / around
                index = len(rest)
                rest.append(a + axis * s + ring * (np.cos(h) * u + np.sin(h) * w))
                upper = parents[j]
                above = parents[upper] if parents[upper] >= 0 else upper
                # three joints: the bone's own most of the way, its neighbours at both ends
                pairs += [(index, above, 0.3 * (1 - share)), (index, upper, 0.7 * (1 - share) + 0.7 * share)]
                pairs.append((index, j, 0.3 * share))
                tone = [0.86, 0.66, 0.55] if name[2:7] not in ("hip", "knee", "talo") else [0.27, 0.33, 0.45]
                colors.append(tone)
        first = len(triangles)
        for k in range(along - 1):
            for i in range(around):
                p, q = start + k * around + i, start + k * around + (i + 1) % around
                triangles += [(p, q, q + around), (p, q + around, p + around)]
        parts.append(Part(f"body {name}", first, len(triangles), (0.86, 0.66, 0.55)))
    rest, pairs = np.array(rest), np.array(pairs)
    limits = np.full((len(names), 3, 2), np.nan)
    for side in "lr":
        limits[names.index(f"{side}_elbow")] = [[-2.6, 0.0], [-1.0, 1.0], [-0.1, 0.1]]
    head = np.flatnonzero(rest[:, 1] > 1.6).astype(np.int32)
    morphs = (
        Morph("chin_action", head, np.tile([0.0, 0.0, 0.05], (len(head), 1)), names.index("skullbase")),
        Morph("grow_action", head, rest[head] * 0.02, names.index("skullbase"), before=True),
    )
    skeleton = Skeleton(
        tuple(names),
        np.array(parents),
        np.array(centers, dtype=float),
        limits=limits,
        site_names=("l_hand_tip", "skull_tip"),
        site_joints=np.array([names.index("l_wrist"), names.index("skullbase")]),
        site_points=np.array([[0.235, 0.75, 0.04], [0, 1.82, 0.02]]),
    )
    weights = Weights.from_pairs(len(rest), pairs[:, 0], pairs[:, 1], pairs[:, 2])
    skin = Skin(rest, np.array(triangles), weights, colors=np.array(colors), parts=tuple(parts), morphs=morphs)
    return Body("capsules", skeleton, skin)


def about(axis: str, angle: np.ndarray) -> np.ndarray:
    """(F,) radians about one axis -> (F,4) quaternions xyzw."""
    q = np.zeros((len(angle), 4))
    q[:, "xyz".index(axis)] = np.sin(angle / 2)
    q[:, 3] = np.cos(angle / 2)
    return q


def stride(body: Body, frames: int = 36, fps: float = 30.0) -> Motion:
    """A crude walk in a loop that travels 1.3 m."""
    index, t = body.skeleton.index, np.arange(frames) / frames * 2 * np.pi
    rotation = np.zeros((frames, len(body.skeleton), 4))
    rotation[..., 3] = 1
    for side, phase in (("l", 0.0), ("r", np.pi)):
        rotation[:, index[f"{side}_hip"]] = about("x", -0.45 * np.sin(t + phase) - 0.1)
        rotation[:, index[f"{side}_knee"]] = about("x", 0.35 - 0.35 * np.cos(t + phase - 0.9))
        rotation[:, index[f"{side}_shoulder"]] = about("x", 0.4 * np.sin(t + phase))
        rotation[:, index[f"{side}_elbow"]] = about("x", -0.4 + 0.2 * np.sin(t + phase))
    translation = np.zeros((frames, 3))
    translation[:, 1] = -0.02 + 0.015 * np.cos(2 * t)
    translation[:, 2] = np.arange(frames) / frames * 1.3
    return Motion(body.skeleton, fps, rotation, translation, loop=True, name="stride")


def capsule_clip(joints: int = len(BONES), vertices: int = 3000, frames: int = 36, deformer: str = "log") -> Clip:
    body = capsule_body(joints, vertices)
    return Clip(Humanoid(name="capsules"), body, stride(body, frames), deformer)
