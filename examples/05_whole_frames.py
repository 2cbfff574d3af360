"""A stage without a window: an arm bends and no frame is torn, a joint is guarded, points are spared.

A person made of contours walks on a stage. A hook sees every turn of the elbows before it takes effect and lets them bend
only half as far; joints and points of each frame belong together all the same. Had the turns gone to the joints and to the
deformer at once, the joints would be ahead of their skin, and by how much is printed. Then an event takes points away.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import vitruvian as vt
from vitruvian.body.rotations import slerp
from vitruvian.show.picture import picture
from vitruvian.stage.events import Event


def main(out: Path = Path("out/examples")) -> None:
    out.mkdir(parents=True, exist_ok=True)
    humanoid = vt.contours(vt.person())
    body = vt.pack(humanoid)
    motion = vt.walk(body.skeleton, speed=1.6)
    motion = replace(motion, translation=motion.translation * [1, 1, 0])  # on the spot
    walk = vt.Clip(humanoid, body, motion, "contours")
    stage = vt.Stage([walk, replace(walk, deformer="log")], rate=30, journal=True)
    guarded, free = stage.actors

    def half(stage: vt.Stage, event: Event) -> Event:
        return replace(event, value=slerp([0, 0, 0, 1], event.value, 0.5))

    for side in "lr":
        stage.intercept(half, actor=guarded, name=f"{side}_elbow")

    deform = vt.deformer("contours", body)
    torn, whole, before = [], [], stage.frame
    for _ in range(30):
        frame = stage.step()
        one = frame[guarded]
        whole.append(np.abs(deform(one.matrices) - one.vertices).max())
        torn.append(
            np.abs(deform(one.matrices) - before[guarded].vertices).max()
        )  # points come a frame after the joints
        before = frame
    bend = [np.degrees(2 * np.arccos(frame[n].rotation[body.skeleton.index["l_elbow"]][3])) for n in (guarded, free)]
    print(f"elbow after a second: {bend[0]:.1f} degrees, unguarded {bend[1]:.1f}")
    print(f"points off their joints: {max(whole):.1e} m; sent to both at once: up to {1000 * max(torn):.0f} mm")

    counts = [len(frame[guarded].vertices)]
    for level in (1, 2):
        stage.send("level", guarded, value=level)
        coarse = stage.step(0)[guarded]
        counts.append(len(coarse.vertices))
        assert np.array_equal(coarse.vertices, one.vertices[coarse.source])  # to the bit
    print(f"points at levels 0, 1, 2: {counts}")
    again = vt.Stage([walk, replace(walk, deformer="log")], rate=30)
    for side in "lr":
        again.intercept(half, actor=guarded, name=f"{side}_elbow")
    *_, last = again.replay(stage.journal[1:])
    assert np.array_equal(last[guarded].vertices, coarse.vertices)

    assert max(whole) < 1e-6 and max(torn) > 0.02
    assert counts[2] < counts[1] < counts[0]
    assert abs(bend[0] / bend[1] - 0.5) < 1e-6
    skin = body.skin
    picture(vt.Mesh(one.vertices, skin.triangles, colors=skin.colors), out / "whole-frames.png", size=(480, 640))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
