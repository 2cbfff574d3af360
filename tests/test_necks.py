"""Necks of figures in segments: in contours, and sewn to the head and to the trunk that they run into."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

import vitruvian as vt
from vitruvian.body.types import Skin
from vitruvian.errors import VitruvianWarning
from vitruvian.hanim.humanoid import Humanoid, Joint, Material, Segment, Shape
from vitruvian.modeling.contours import contoured
from vitruvian.modeling.trials import seam_gap, trials

FILES = ("JinLOA1.x3d", "JinLOA3.x3d", "NancyPrototypes.wrl")


def tube(start, end, radius, rings=6, around=20, closed=True, grow=1.0) -> Shape:
    """From one place to another, closed at both ends; in the middle `grow` times as wide."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    way = (end - start) / np.linalg.norm(end - start)
    side = np.cross(way, [0.3, 0.2, 0.9])
    side /= np.linalg.norm(side)
    s = np.linspace(0, 1, rings)
    turn = np.arange(around) * 2 * np.pi / around
    circle = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(way, side)
    size = radius * (1 + (grow - 1) * np.sin(np.pi * s))
    points = (start + s[:, None] * (end - start))[:, None] + size[:, None, None] * circle
    i = np.arange(rings * around).reshape(rings, around)
    a, b, c, d = i[:-1], np.roll(i, -1, 1)[:-1], np.roll(i, -1, 1)[1:], i[1:]
    faces = [np.stack(f, -1).reshape(-1, 3) for f in ((a, b, c), (a, c, d))]
    points = np.concatenate([points.reshape(-1, 3), [start, end]])
    if closed:
        n = rings * around
        faces += [np.stack([np.full(around, n), np.roll(i[0], -1), i[0]], -1)]
        faces += [np.stack([np.full(around, n + 1), i[-1], np.roll(i[-1], -1)], -1)]
    return Shape("", np.concatenate(faces).astype(np.int32), points)


def figure(neck_joint: bool) -> Humanoid:
    """A doll of tubes: the neck is a segment on its own joint, or goes on out of the trunk."""

    def joint(name, center, *children, shapes=()):
        looks = {"skullbase": (0.8, 0.6, 0.5), "vl5": (0.7, 0.1, 0.1)}
        for s in shapes:
            s.material = Material(name, looks.get(name, (0.5, 0.5, 0.5)))
        segments = [Segment(f"{name}_segment", shapes=list(shapes))] if shapes else []
        return Joint(name, center=np.asarray(center, float), joints=list(children), segments=segments)

    def limbs(side):
        x = 0.18 if side == "l" else -0.18
        h = 0.1 if side == "l" else -0.1
        hand = joint(f"{side}_radiocarpal", [x, 0.85, 0], shapes=[tube([x, 0.88, 0], [x, 0.7, 0], 0.03)])
        fore = joint(f"{side}_elbow", [x, 1.1, 0], hand, shapes=[tube([x, 1.12, 0], [x, 0.83, 0], 0.035)])
        arm = joint(f"{side}_shoulder", [x, 1.38, 0], fore, shapes=[tube([x, 1.42, 0], [x, 1.08, 0], 0.045)])
        foot = joint(f"{side}_talocrural", [h, 0.08, 0], shapes=[tube([h, 0.12, 0], [h, 0, 0.1], 0.04)])
        calf = joint(f"{side}_knee", [h, 0.48, 0], foot, shapes=[tube([h, 0.52, 0], [h, 0.06, 0], 0.05)])
        leg = joint(f"{side}_hip", [h, 0.9, 0], calf, shapes=[tube([h, 0.95, 0], [h, 0.46, 0], 0.07)])
        return arm, leg

    (l_arm, l_leg), (r_arm, r_leg) = limbs("l"), limbs("r")
    skull = joint("skullbase", [0, 1.55, 0], shapes=[tube([0, 1.5, 0.02], [0, 1.75, 0.03], 0.08, grow=1.2)])
    trunk = [tube([0, 0.92, 0], [0, 1.44, 0], 0.14, rings=12)]
    if neck_joint:
        above = joint("vc4", [0, 1.45, 0], skull, shapes=[tube([0, 1.4, 0], [0, 1.56, 0.01], 0.05)])
    else:
        above = skull
        s = trunk[0]
        points, keep = s.points, len(s.points) - 2  # the lid goes; rings lead over it to the neck and up it
        first = points[keep - 20 : keep] - [0, 1.44, 0]
        rows = [first * [w, 0, w] + [0, y, 0] for w, y in ((0.6, 1.44), (0.36, 1.45), (0.36, 1.5), (0.36, 1.56))]
        s.points = np.concatenate([points, *rows])
        lid = (s.triangles == keep + 1).any(axis=1)
        i = np.concatenate([[np.arange(keep - 20, keep)], len(points) + np.arange(80).reshape(4, 20)])
        a, b, c, d = i[:-1], np.roll(i, -1, 1)[:-1], np.roll(i, -1, 1)[1:], i[1:]
        more = [np.stack(f, -1).reshape(-1, 3) for f in ((a, b, c), (a, c, d))]
        s.triangles = np.concatenate([s.triangles[~lid], *more]).astype(np.int32)
    spine = joint("vl5", [0, 1.0, 0], above, l_arm, r_arm, shapes=trunk)
    root = joint("humanoid_root", [0, 0.95, 0], spine, l_leg, r_leg)
    return Humanoid("doll", skeleton=[root])


@pytest.fixture(scope="module", params=["neck of its own", "neck of the trunk", *FILES])
def made(request):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", VitruvianWarning)
        if request.param in FILES:
            shared = request.getfixturevalue("shared")
            return contoured(vt.load(shared / "data/hanim" / request.param))
        return contoured(figure(request.param == "neck of its own"))


def neck_of(body):
    return next(s for s in body.contours if not s.name.startswith(("l_", "r_", "l5_")))


def welded(skin: Skin) -> np.ndarray:
    """(T,3) triangles by places: those that are equal to the bit are one."""
    return np.unique(skin.rest, axis=0, return_inverse=True)[1].reshape(-1)[skin.triangles]


def test_head_neck_and_trunk_hang_together(made):
    """Every edge of the neck's two ends has a face of the neck and one of what it is sewn to, and no other."""
    body = vt.pack(made.humanoid)
    neck = neck_of(body)
    each = neck.vertices.shape[1]
    assert sorted(np.bincount(neck.tied[:, 1], minlength=len(neck))[[0, -1]]) == [each, each]
    place = np.unique(body.skin.rest, axis=0, return_inverse=True)[1].reshape(-1)
    t = welded(body.skin)
    own = np.isin(body.skin.triangles, neck.vertices).all(axis=1)
    edges = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    of_neck = np.tile(own, 3)
    joints = body.skin.weights.top(1)[0][:, 0]
    names = body.skeleton.names
    for k, above in ((0, True), (len(neck) - 1, False)):
        ring = place[neck.vertices[k]]
        for pair in np.sort(np.stack([ring, np.roll(ring, -1)], axis=1), axis=1).tolist():
            at = np.flatnonzero((edges == pair).all(axis=1))
            assert sorted(of_neck[at].tolist()) == [False, True]
            face = body.skin.triangles[at[~of_neck[at]][0] % len(t)]
            assert all((names[joints[v]] == "skullbase") == above for v in face.tolist())


def test_no_pose_opens_the_neck_by_a_bit(made):
    poses = ("head nodded 40", "head turned 60", "neck bent 40", "spine twisted 60", "arms sideways 150")
    found = trials(made.humanoid, names=poses)
    assert {"head nodded 40", "head turned 60"} <= {t.pose for t in found}
    assert all(t.gap == 0 for t in found)
    assert all(0.97 < t.volume < 1.03 for t in found)


def test_a_neck_bends_and_head_and_trunk_stay_what_they_are(made):
    """At the head the neck goes with it, on the trunk it stays; between it is bent."""
    body = vt.pack(made.humanoid)
    neck, index = neck_of(body), body.skeleton.index["skullbase"]
    rotation = body.skeleton.rotation.copy()
    rotation[index] = [np.sin(0.3), 0, 0, np.cos(0.3)]
    m = vt.joint_matrices(replace(body.skeleton, rotation=rotation))
    out = vt.deformer("contours", body)(m)[0]
    assert seam_gap(body, out) == 0
    rest, head = body.skin.rest, m[0, index]
    rigid = rest @ head[:3, :3].T + head[:3, 3]
    size = 1e-5 * made.scale
    assert np.abs(out - rigid)[neck.vertices[0]].max() < size
    assert np.abs(out - rest)[neck.vertices[-1]].max() < size
    middle = neck.vertices[len(neck) // 2]
    assert np.abs(out - rest)[middle].max() > 100 * size and np.abs(out - rigid)[middle].max() > 100 * size


def test_colours_end_at_the_seam():
    """The trunk keeps its red up to the neck, which has none of it."""
    body = vt.pack(contoured(figure(True)).humanoid)
    by = {p.name: p for p in body.skin.parts}
    red = by["vl5"]
    assert red.color == (0.7, 0.1, 0.1) and red.stop > red.start
    neck = neck_of(body)
    place = np.unique(body.skin.rest, axis=0, return_inverse=True)[1].reshape(-1)
    met = {
        p.name
        for p in body.skin.parts
        if np.isin(place[body.skin.triangles[p.start : p.stop]], place[neck.vertices[-1]]).any()
    }
    assert met == {"vl5", "c4_def vc4"}


def test_marks_of_joints_are_no_neck(shared):
    """A figure of diamonds has nothing to be sewn; it is said, and nothing breaks."""
    with pytest.warns(VitruvianWarning, match="its segment stays as it is"):
        found = contoured(vt.load(shared / "data/hanim/DiamondManLOA2.x3d"))
    assert {s.name for s in vt.pack(found.humanoid).contours} >= {"l5_front_def"}
