"""Your own body and your own motion.

A body comes as an X3D file, a captured clip as BVH on another skeleton with other names, proportions and another rest
pose. Here both files are written by the example itself.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import vitruvian as vt
from vitruvian.motion.contacts import foot_slide_mm
from vitruvian.show.picture import picture

RIG = {  # name: (parent, offset in centimetres); arms stretched out as in many capture rigs
    "Hips": ("", (0, 95, 0)),
    "Spine": ("Hips", (0, 12, 0)),
    "Spine1": ("Spine", (0, 20, 0)),
    "Neck": ("Spine1", (0, 22, 0)),
    "Head": ("Neck", (0, 10, 0)),
    "LeftArm": ("Spine1", (18, 16, 0)),
    "LeftForeArm": ("LeftArm", (28, 0, 0)),
    "LeftHand": ("LeftForeArm", (26, 0, 0)),
    "RightArm": ("Spine1", (-18, 16, 0)),
    "RightForeArm": ("RightArm", (-28, 0, 0)),
    "RightHand": ("RightForeArm", (-26, 0, 0)),
    "LeftUpLeg": ("Hips", (9, -3, 0)),
    "LeftLeg": ("LeftUpLeg", (0, -43, 0)),
    "LeftFoot": ("LeftLeg", (0, -42, 0)),
    "LeftToeBase": ("LeftFoot", (0, -5, 13)),
    "RightUpLeg": ("Hips", (-9, -3, 0)),
    "RightLeg": ("RightUpLeg", (0, -43, 0)),
    "RightFoot": ("RightLeg", (0, -42, 0)),
    "RightToeBase": ("RightFoot", (0, -5, 13)),
}


def squat_bvh(frames: int = 60) -> str:
    """A squat with the arms lifted forward, in centimetres, Euler order Z X Y."""
    lines = ["HIERARCHY"]

    def joint(name: str, depth: int) -> None:
        parent, offset = RIG[name]
        tab = "\t" * depth
        lines.extend([f"{tab}{'JOINT' if parent else 'ROOT'} {name}", tab + "{"])
        lines.append(f"{tab}\tOFFSET {' '.join(map(str, offset))}")
        position = "6 Xposition Yposition Zposition" if not parent else "3"
        lines.append(f"{tab}\tCHANNELS {position} Zrotation Xrotation Yrotation")
        children = [c for c, (p, _) in RIG.items() if p == name]
        for child in children:
            joint(child, depth + 1)
        if not children:
            lines.extend([f"{tab}\tEnd Site", tab + "\t{", f"{tab}\t\tOFFSET 0 8 0", tab + "\t}"])
        lines.append(tab + "}")

    joint("Hips", 0)
    lines += ["MOTION", f"Frames: {frames}", "Frame Time: 0.0333333"]
    for bend in np.sin(np.linspace(0, np.pi, frames)) ** 2:
        knee, thigh = 80 * bend, -40 * bend
        drop = 43 * (1 - np.cos(np.radians(thigh))) + 42 * (1 - np.cos(np.radians(thigh + knee)))
        shift = 43 * np.sin(np.radians(thigh)) + 42 * np.sin(np.radians(thigh + knee))
        values = {
            "LeftUpLeg": (0, thigh, 0),
            "LeftLeg": (0, knee, 0),
            "LeftFoot": (0, -thigh - knee, 0),
            "LeftArm": (-80 + 80 * bend, 0, -80 * bend),
            "RightArm": (80 - 80 * bend, 0, 80 * bend),
        }
        values |= {n.replace("Left", "Right"): v for n, v in values.items() if "Arm" not in n}
        row: list[float] = []
        for name, (parent, offset) in RIG.items():
            row += [] if parent else [offset[0], offset[1] - drop, offset[2] + shift]
            row += values.get(name, (0, 0, 0))
        lines.append(" ".join(f"{v:.5f}" for v in row))
    return "\n".join(lines) + "\n"


def main(out: Path = Path("out/examples")) -> None:
    out.mkdir(parents=True, exist_ok=True)
    vt.save(vt.person(gender=1, age=45, loa=2), out / "body.x3d")
    (out / "squat.bvh").write_text(squat_bvh())

    humanoid = vt.load(out / "body.x3d")
    body = vt.pack(humanoid)
    clip = vt.Clip(humanoid, body, vt.retarget(vt.load(out / "squat.bvh"), body.skeleton))
    vt.save(clip, out / "squat.glb")
    picture(clip, out / "squat.png", time=1.0)

    matrices = vt.joint_matrices(body.skeleton, clip.motion)
    knee = body.skeleton.index["l_knee"]
    hip = body.skeleton.index["l_hip"]
    bend = np.einsum("fji,fji->f", matrices[:, hip, :3, :3], matrices[:, knee, :3, :3])
    degrees = np.degrees(np.arccos(np.clip((bend - 1) / 2, -1, 1)))
    print(f"the knee bends {degrees.max():.1f} degrees; captured: 80")
    assert abs(degrees.max() - 80) < 6
    assert foot_slide_mm(clip.motion, body) <= 2


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
