"""A built-in person walks.

Make a person, let it walk, deform the skin without collapse, and write files that other programs open.
"""

from __future__ import annotations

import sys
from pathlib import Path

import vitruvian as vt
from vitruvian.motion.contacts import floor_penetration_mm, foot_slide_mm
from vitruvian.show.picture import picture


def main(out: Path = Path("out/examples")) -> None:
    out.mkdir(parents=True, exist_ok=True)
    humanoid = vt.person(gender=0, age=32, height=1.70)
    body = vt.pack(humanoid)
    motion = vt.walk(body.skeleton, speed=1.4)
    clip = vt.Clip(humanoid, body, motion)

    report = vt.save(clip, out / "walk.glb")
    vt.save(clip, out / "walk.x3d")
    picture(clip, out / "walk.png", time=motion.seconds / 4)

    matrices = vt.joint_matrices(body.skeleton, motion)
    vertices = vt.deformer("log", body)(matrices)
    stature = vertices[:, :, 1].max(axis=1)
    print(f"{len(motion)} frames, stature {stature.min():.3f} to {stature.max():.3f} m while walking")
    print(f"glTF keeps four influences a vertex: at most {report['max_vertex_error_m'] * 1000:.2f} mm off")

    assert stature.min() > 1.60 and stature.max() < 1.74
    assert foot_slide_mm(motion, body) <= 2
    assert floor_penetration_mm(motion, body) <= 5


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
