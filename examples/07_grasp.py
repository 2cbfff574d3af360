"""A hand closes on a bar: a grasp as a motion, played on a stage with the hands' own deformation.

Each finger closes until its skin touches: the deformed surface is asked, not the bones, so the knuckles and the palm are
where they are seen. The bar lies across the palm. The motion then plays like any other; in the same pose without the
hands' deformation fingers stay off the bar or sink into it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import vitruvian as vt
from vitruvian.body.rotations import from_axis_angle
from vitruvian.body.types import Floats
from vitruvian.deform.hand_links import hands_of
from vitruvian.motion.types import Motion
from vitruvian.show.camera import Camera
from vitruvian.show.picture import picture
from vitruvian.stage.clip import Mesh

RADIUS, LENGTH, FRAMES = 0.021, 0.22, 30  # metres, metres
CLOSED = {0: 0.5, 1: 0.9, 2: 1.5, 3: 1.1}  # radians of the joints of a finger, from the wrist on, when it is closed
TOUCH = 0.0005  # metres


def bar(center: Floats, axis: Floats, steps: int = 48) -> Mesh:
    """A cylinder about `axis`, closed by fans."""
    aside = np.cross(axis, [0.0, 1.0, 0.0])
    aside /= np.linalg.norm(aside)
    turn = np.linspace(0, 2 * np.pi, steps, endpoint=False)[:, None]
    ring = RADIUS * (np.cos(turn) * aside + np.sin(turn) * np.cross(axis, aside))
    ends = [center + s * LENGTH / 2 * axis for s in (-1, 1)]
    i = np.arange(steps)
    j = np.roll(i, -1)
    sides = [
        (i, j, j + steps),
        (i, j + steps, i + steps),
        (j, i, i * 0 + 2 * steps),
        (i + steps, j + steps, i * 0 + 2 * steps + 1),
    ]
    return Mesh(
        np.concatenate([ends[0] + ring, ends[1] + ring, ends]), np.concatenate([np.stack(t, -1) for t in sides])
    )


def main(out: Path = Path("out/examples")) -> None:
    out.mkdir(parents=True, exist_ok=True)
    humanoid = vt.person(outfit="body suit", hair="none")
    body = vt.pack(humanoid)
    deform, hand = vt.deformer("hand", body), hands_of(body)[0]
    before = hand.before_links()
    depth, finger = np.zeros(len(before), int), np.arange(len(before))
    for link, previous in enumerate(before):
        if previous >= 0:
            depth[link], finger[link] = depth[previous] + 1, finger[previous]
    fingers = np.unique(finger)
    last = depth + (finger == 0)  # a thumb has one joint less

    def motion(closed: Floats) -> Motion:
        """(F,5) how far each finger is closed -> a motion of F frames."""
        rotation = np.tile(body.skeleton.rotation, (len(closed), 1, 1))
        for link in np.flatnonzero(depth > 0):
            angle = CLOSED[last[link]] * closed[:, np.searchsorted(fingers, finger[link])]
            axis = np.tile(hand.axis_near[link], (len(closed), 1))
            rotation[:, hand.near[link]] = from_axis_angle(np.column_stack([axis, angle]))
        rotation[:, body.skeleton.index["l_elbow"]] = from_axis_angle([-1, 0, 0, 1.3])  # clear of the thigh
        return Motion(body.skeleton, 30.0, rotation, np.zeros((len(closed), 3)))

    # The bar lies against the palm, along the knuckles: away from between them and the wrist until it is free.
    knuckles = hand.start[(depth == 1) & (finger > 0)]
    palm = np.cross(knuckles[-1] - hand.start[0], knuckles[0] - hand.start[0])
    palm /= np.linalg.norm(palm)
    axis = (knuckles[0] - knuckles[-1]) / np.linalg.norm(knuckles[0] - knuckles[-1])
    middle, skin = 0.8 * knuckles.mean(axis=0) + 0.2 * hand.start[0], body.skin.rest[hand.vertices]

    def off(points: Floats, center: Floats) -> Floats:
        """(...,) how far points (...,3) are from the bar; negative: inside."""
        way = points - center
        return np.linalg.norm(way - (way @ axis)[..., None] * axis, axis=-1) - RADIUS

    center = next(c for c in middle + np.arange(0, 0.1, TOUCH)[:, None] * palm if off(skin, c).min() >= 0)

    joint = body.skin.weights.top(1)[0][:, 0]
    rows = [np.flatnonzero(np.isin(joint, hand.near[(finger == f) & (depth > 0)])) for f in fingers]

    held = vt.joint_matrices(body.skeleton, motion(np.zeros((1, len(fingers)))))[
        0, body.skeleton.index["l_radiocarpal"]
    ]

    def touching(points: Floats) -> Floats:
        """(F,5) how far the skin of each finger is from the bar, which the wrist carries."""
        still = (points - held[:3, 3]) @ held[:3, :3]
        return np.stack([off(still[:, r], center).min(axis=1) for r in rows], axis=1)

    def gaps(closed: Floats, run: vt.Deformer = deform) -> Floats:
        return touching(run(vt.joint_matrices(body.skeleton, motion(closed))))

    steps = np.linspace(0, 1, 33)
    way = gaps(np.repeat(steps[:, None], len(fingers), axis=1))
    first = [int(np.argmax(way[:, k] < TOUCH)) for k in range(len(fingers))]
    low, high = steps[np.maximum(np.array(first) - 1, 0)], steps[first]
    for _ in range(8):  # between the last step that is free and the first that touches
        half = (low + high) / 2
        free = gaps(half[None])[0] > 0
        low, high = np.where(free, half, low), np.where(free, high, half)

    ease = np.clip(np.linspace(0, 1.4, FRAMES), 0, 1)
    closed = (ease * ease * (3 - 2 * ease))[:, None] * low
    grasp = vt.Clip(humanoid, body, motion(closed), "hand")
    stage = vt.Stage([grasp], rate=30)
    stage.play()
    name, seen = next(iter(stage.actors)), []
    for _ in range(FRAMES):
        seen.append(stage.step()[name].vertices)
    inside = -touching(np.array(seen)).min()
    end, plain = gaps(low[None])[0], gaps(low[None], vt.deformer("log", body))[0]
    print(
        f"fingers from the bar: {np.round(1000 * end, 2)} mm; without the hands' deformation {np.round(1000 * plain, 2)}"
    )
    assert all(f > 0 for f in first) and (np.abs(end) < TOUCH).all()  # all five touch, none sinks in
    assert (
        inside < TOUCH
        and np.abs(seen[-1] - deform(vt.joint_matrices(body.skeleton, motion(low[None])))[0]).max() < 1e-6
    )
    assert np.abs(plain).max() > TOUCH

    vt.save(grasp, out / "grasp.glb")
    carried = held[:3, :3] @ center + held[:3, 3]
    made, colors = bar(carried, held[:3, :3] @ axis), body.skin.colors
    skin_colors = np.full((len(seen[-1]), 3), [0.78, 0.6, 0.5]) if colors is None else colors[:, :3]
    scene = Mesh(
        np.concatenate([seen[-1], made.vertices]), np.concatenate([body.skin.triangles, made.triangles + len(seen[-1])]),
        colors=np.concatenate([skin_colors, np.full((len(made.vertices), 3), [0.75, 0.25, 0.2])]),
    )  # fmt: skip
    eye = carried + [-0.25, 0.3, 0.5]
    camera = Camera(tuple(eye.tolist()), tuple(carried.tolist()), fov=np.radians(24.0))
    picture(scene, out / "grasp.png", view=camera, size=(800, 600))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
