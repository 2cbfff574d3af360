"""A file that deforms itself: a walking person for any X3D or VRML97 browser, and a scene of one's own that drives it.

The joints' rotations go to a Script in the file, which moves the skin and then lets the joints turn; docs/live.md lists
its events.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import vitruvian as vt
from vitruvian.formats import registry
from vitruvian.formats.live import SCRIPT, live_scene
from vitruvian.hanim.graph import Node, Route
from vitruvian.modeling.lighter import lightened
from vitruvian.motion.tracks import tracks_of
from vitruvian.show.picture import picture


def main(out: Path = Path("out/examples")) -> None:
    out.mkdir(parents=True, exist_ok=True)
    person = lightened(vt.contours(vt.person(loa=2), density=0.5), 1000)
    body = vt.pack(person)
    walk = vt.walk(body.skeleton)
    walking = person.copied()
    walking.tracks = tracks_of(walk)
    live = live_scene(walking, encoding="wrl")
    registry.write_scene(live.scene, out / "walk-live.wrl")

    waving = live_scene(person, encoding="x3d")  # a timer of one's own: to the Script, not to the joint
    up = np.array([[0, 0, 1, 0.0], [0, 0, 1, 2.0], [0, 0, 1, 0.0]])
    timer = Node("TimeSensor", "TIME", {"cycleInterval": 2.0, "loop": True})
    wave = Node("OrientationInterpolator", "WAVE", {"key": np.array([0, 0.5, 1]), "keyValue": up})
    waving.scene.body += [timer, wave, Route("TIME", "fraction_changed", "WAVE", "set_fraction"),
                          Route("WAVE", "value_changed", SCRIPT, "hanim_l_shoulderDef")]  # fmt: skip
    registry.write_scene(waving.scene, out / "wave-live.x3d")

    told = live.report
    print(f"{told['points']} contour points and {told['soft_points']} of soft skin are moved by "
          f"{told['script_bytes']} bytes of script, {told['rigid_points']} points ride on joints")  # fmt: skip
    again = vt.pack(vt.load(out / "walk-live.wrl"))
    assert sum(s.vertices.size for s in again.contours) == told["points"] > 1000
    assert not any(r.to_field == "set_rotation" and r.from_node != SCRIPT and r.to_node.endswith("_knee")
                   for r in live.scene.routes())  # fmt: skip
    assert (out / "walk-live.wrl").stat().st_size < 1_500_000
    clip = vt.Clip(person, body, walk, deformer="contours")
    picture(clip, out / "live-file.png", time=walk.seconds / 4)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
