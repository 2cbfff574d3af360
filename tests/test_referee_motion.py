"""X_ITE, an X3D browser, as referee of live motion: our HAnimMotion plays there to our joint matrices."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import vitruvian as vt
from scene_figure import typed
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.pack import pack
from vitruvian.motion.tracks import motion_of

if TYPE_CHECKING:
    from playwright.sync_api import Route

# Puts the motion to one frame after another and reads the matrices that X_ITE skins with.
STEP = """async ([text, frames]) => {
  await new Promise(resolve => X3D(resolve))
  const browser = document.querySelector('x3d-canvas').browser
  const scene = await browser.createX3DFromString(text)
  await browser.replaceWorld(scene)
  const motion = scene.getNamedNode('hanim_walk'), figure = scene.getNamedNode('hanim_Ada').getValue()
  const out = { count: motion.frameCount, frames: [] }
  for (const frame of frames) {
    motion.frameIndex = frame
    for (let k = 0; k < 4; ++k)
      await new Promise(resolve => requestAnimationFrame(resolve))
    await new Promise(resolve => setTimeout(resolve, 150))
    const found = {}
    figure.jointNodes.forEach((j, i) =>
      found[j._name.getValue()] = Array.from(figure.jointMatricesArray.slice(i * 32, i * 32 + 16)))
    out.frames.push(found)
  }
  return out
}"""


def answer(route: Route, referee: Path) -> None:
    """A page with an X_ITE canvas, and the files of X_ITE; nothing leaves the machine."""
    address = route.request.url.removeprefix("http://xite.test/")
    page = "<script src='x_ite.js'></script><x3d-canvas style='width:100px;height:100px'></x3d-canvas>"
    path = referee / "node_modules" / "x_ite" / "dist" / address
    if address == "page.html":
        route.fulfill(body=page, content_type="text/html")
    elif path.is_file():
        route.fulfill(path=path)
    else:
        route.abort()


def test_xite_plays_our_hanimmotion(referee: Path, browser: Any, tmp_path: Path) -> None:
    h = typed(3)
    h.tracks = []
    walk = replace(vt.walk(pack(h).skeleton), name="walk")
    vt.save(vt.Clip(h, pack(h), walk), tmp_path / "walk.x3d", motion="hanimmotion")
    back = vt.load(tmp_path / "walk.x3d")
    motion = motion_of(back, pack(back).skeleton)
    ours = joint_matrices(motion.skeleton, motion)
    text = (tmp_path / "walk.x3d").read_text().replace("enabled='true'", "enabled='false'")  # stepped by hand
    frames = [1, 7, 16, 25, len(motion) - 1]
    page = browser.new_page(viewport={"width": 120, "height": 120})
    page.route("**/*", lambda route: answer(route, referee))
    page.goto("http://xite.test/page.html")
    found = page.evaluate(STEP, [text, frames])
    page.close()
    assert found["count"] == len(motion) + 1  # the loop ends with its first frame
    worst = 0.0
    for frame, matrices in zip(frames, found["frames"], strict=True):
        assert len(matrices) == len(motion.skeleton)
        for name, theirs in matrices.items():
            mine = ours[frame, motion.skeleton.index[name]]
            worst = max(worst, np.abs(mine - np.array(theirs).reshape(4, 4).T).max())
    print(f"X_ITE and we differ by {worst:.1e} at most")
    assert np.abs(ours[frames[0]] - ours[frames[2]]).max() > 0.3
    assert worst < 1e-6
