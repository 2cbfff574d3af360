"""Files that deform themselves: X_ITE runs the exported script, and its points are ours."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

import vitruvian as vt
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.rotations import from_axis_angle
from vitruvian.deform.deformer import deformer
from vitruvian.errors import VitruvianError
from vitruvian.formats.live import add_script
from vitruvian.formats.vrml import write_vrml
from vitruvian.formats.x3d import write_x3d
from vitruvian.hanim.build import scene_of
from vitruvian.motion.tracks import tracks_of
from vitruvian.motion.types import Motion

if TYPE_CHECKING:
    from playwright.sync_api import Route

POSE = {
    "l_knee": [1, 0, 0, 1.1], "l_hip": [1, 0.2, 0, -0.8], "r_elbow": [-1, 0, 0.1, 1.4], "r_shoulder": [0, 1, 0, 0.9],
    "vl5": [1, 0, 0, 0.2], "vt6": [0.1, 1, 0, 0.4], "vc4": [0, 1, 0.2, 0.3], "skullbase": [1, 0, 0, 0.2],
    "humanoid_root": [0, 1, 0, 0.5],
}  # fmt: skip
RUN = """async ([source, pose, names]) => {
  const browser = document.querySelector('x3d-canvas').browser;
  const messages = [];
  browser.replaceWorld(await browser.createX3DFromString(source));
  await browser.nextFrame();
  const scene = browser.currentScene, script = scene.getNamedNode('hanim_ContourScript');
  for (const [joint, r] of Object.entries(pose)) script[`hanim_${joint}Def`] = new X3D.SFRotation(...r);
  await browser.nextFrame();
  await browser.nextFrame();
  const out = {};
  for (const name of names) {
    const points = scene.getNamedNode('hanim_' + name).Points;
    out[name] = Array.from(points, (p) => [p.x, p.y, p.z]);
  }
  const joints = {};
  for (const joint of Object.keys(pose)) joints[joint] = Array.from(scene.getNamedNode('hanim_' + joint).rotation);
  const began = performance.now();
  let frames = 0, angle = 0;
  while (performance.now() - began < 2000) {
    angle = 0.5 + 0.4 * Math.sin(frames / 5);
    for (const joint of ['l_knee', 'r_knee', 'l_elbow', 'vt6'])
      script[`hanim_${joint}Def`] = new X3D.SFRotation(1, 0, 0, angle);
    await browser.nextFrame();
    frames += 1;
  }
  return { out, joints, rate: frames / (performance.now() - began) * 1000 };
}"""


def answer(route: Route, referee: Path) -> None:
    address = route.request.url.removeprefix("http://xite.test/")
    path = referee / "node_modules" / "x_ite" / "dist" / address
    page = "<script src='x_ite.js'></script><x3d-canvas style='width:100px;height:100px'></x3d-canvas>"
    if address == "page.html":
        route.fulfill(body=page, content_type="text/html")
    elif path.is_file():
        route.fulfill(path=path)
    else:
        route.abort()


@pytest.fixture(scope="module")
def humanoid():
    return vt.contours(vt.person(gender=1, loa=2), density=0.65)


@pytest.mark.parametrize(("encoding", "version"), [("x3d", "2.0"), ("wrl", "200x")])
def test_xite_runs_the_script_and_its_points_are_ours(browser, referee, humanoid, tmp_path, encoding, version):
    from vitruvian.hanim.convert import converted
    from vitruvian.hanim.tables import name_in

    scene, _ = scene_of([humanoid], version=version, encoding=encoding)
    body = vt.pack(converted(humanoid, version)[0])
    told = add_script(scene, humanoid, body)
    path = tmp_path / f"live.{encoding}"
    (write_x3d if encoding == "x3d" else write_vrml)(scene, path)
    pose = {name_in(k, version, "joint"): v for k, v in POSE.items()}
    page = browser.new_page(viewport={"width": 120, "height": 120})
    complaints: list[str] = []
    page.on("console", lambda m: complaints.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda e: complaints.append(str(e)))
    page.route("**/*", lambda route: answer(route, referee))
    page.goto("http://xite.test/page.html")
    found = page.evaluate(RUN, [path.read_text(), pose, [s.name for s in body.contours]])
    page.close()
    real = [c for c in complaints if "404" not in c and "ERR_FAILED" not in c and "GL Driver" not in c]
    assert not real, real
    for joint, rotation in pose.items():
        assert np.allclose(np.abs(from_axis_angle(found["joints"][joint]) @ from_axis_angle(rotation)), 1, atol=1e-6)

    skeleton = body.skeleton
    q = np.tile([0.0, 0, 0, 1], (1, len(skeleton), 1))
    for joint, rotation in pose.items():
        q[0, skeleton.index[joint]] = from_axis_angle(rotation)
    m = joint_matrices(skeleton, Motion(skeleton, 30.0, q, np.zeros((1, 3))))[0]
    ours = deformer("contours", body)(m).astype(np.float64)
    worst = 0.0
    for surface in body.contours:
        local = np.array(found["out"][surface.name]) + skeleton.centers[surface.joint]
        f = m[surface.joint]
        world = local @ f[:3, :3].T + f[:3, 3]
        worst = max(worst, np.abs(world - ours[surface.vertices].reshape(-1, 3)).max())
    print(f"{encoding}: {told['points']} points, worst {worst:.1e} m, {found['rate']:.0f} frames/s")
    assert worst < 1e-4


def test_rotations_are_routed_to_the_script_and_points_leave_first(humanoid):
    body = vt.pack(humanoid)
    humanoid.tracks = tracks_of(vt.walk(body.skeleton))
    try:
        scene, _ = scene_of([humanoid], version="2.0", encoding="x3d")
    finally:
        humanoid.tracks = []
    add_script(scene, humanoid, body)
    routes = scene.routes()
    to_joints = [r for r in routes if r.to_field in ("rotation", "set_rotation") and r.to_node.endswith("_knee")]
    assert to_joints and all(r.from_node == "hanim_ContourScript" for r in to_joints)
    assert any(r.to_field == "hanim_l_kneeDef" for r in routes)
    script = scene.defs()["hanim_ContourScript"]
    work = script.text.split("function eventsProcessed")[1]
    assert work.index("publish(M)") < work.index("release()")


def test_a_body_without_contours_is_refused():
    person = vt.person(loa=1)
    scene, _ = scene_of([person], version="2.0", encoding="x3d")
    with pytest.raises(VitruvianError, match="live: expected a body with contours"):
        add_script(scene, person, vt.pack(person))


def test_the_command_writes_contours_with_and_without_a_script(tmp_path):
    import subprocess
    import sys

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "vitruvian", "contours", *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)

    done = run("person", "-o", str(tmp_path / "c.x3dv"), "--density", "0.5", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["surfaces"] == 11 and told["points"] > 500 and told["shape_error_mm"] < 5
    back = vt.pack(vt.load(tmp_path / "c.x3dv"))
    assert len(back.contours) == 11 and sum(s.vertices.size for s in back.contours) == told["points"]
    done = run("person", "-o", str(tmp_path / "c.x3d"), "--live", "--density", "0.5")
    assert done.returncode == 0 and b"eventsProcessed" in (tmp_path / "c.x3d").read_bytes()
    for arguments, word in (
        (("person", "-o", str(tmp_path / "c.glb"), "--live"), "--live: expected a scene"),
        (("nobody.x3d", "-o", str(tmp_path / "d.x3d")), "no such file"),
    ):
        done = run(*arguments)
        assert done.returncode == 2 and word in done.stderr and done.stderr.count("\n") == 1, done.stderr
