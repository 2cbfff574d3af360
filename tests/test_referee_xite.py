"""X_ITE, an X3D browser, as referee: our files load there without a message, and its joint matrices are ours."""

from __future__ import annotations

import json
import os
import subprocess
import warnings
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from scene_figure import typed
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.pack import pack
from vitruvian.formats.convert import convert
from vitruvian.formats.registry import scene as scene_in
from vitruvian.formats.registry import write_scene
from vitruvian.formats.vrml import read_vrml, write_vrml
from vitruvian.formats.x3d import read_x3d, write_x3d
from vitruvian.formats.x3d_json import parse_json
from vitruvian.hanim import tables
from vitruvian.hanim.build import scene_of
from vitruvian.hanim.humanoid import Humanoid, MotionData
from vitruvian.hanim.view import humanoids
from vitruvian.hanim.welding import weld
from vitruvian.modeling.levels import at_level
from vitruvian.modeling.person import person

if TYPE_CHECKING:
    from playwright.sync_api import Route

POSE = {
    "l_shoulder": [0, 0, 1, 1.5707963],
    "l_elbow": [1, 0, 0, -1],
    "l_hip": [1, 0, 0, -0.6],
    "l_knee": [1, 0, 0, 0.8],
    "vl5": [0, 1, 0, 0.3],
}
# file, encoding and version that it is written in here; all have a skin
SKINNED = {
    "JinNoAnimations_Fixed.x3d": ("x3d", "2.0"),
    "JoeKick.x3d": ("x3d", "2.0"),
    "Humanoid1NoSegSite.x3d": ("x3dv", "2.0"),
    "JoeHAnimKick1a.x3dv": ("x3d", "1.0"),
}
KNOWN = {  # file, joint: its centre after the pose
    ("HAnim2SpecificationLOA3Illustrated.x3d", "l_elbow"): (0.485157, 1.436100, -0.216971),
    ("HAnim2SpecificationLOA3Illustrated.x3d", "l_radiocarpal"): (0.684828, 1.433100, -0.035847),
    ("HAnim2SpecificationLOA3Illustrated.x3d", "l_talocrural"): (0.110100, 0.186537, 0.079793),
    ("HAnim2SpecificationLOA3Illustrated.x3d", "skullbase"): (0.034235, 1.620900, 0.018607),
    ("JinNoAnimations_Fixed.x3d", "l_radiocarpal"): (0.630893, 1.359540, 0.004170),
}


def load(path: Path) -> Humanoid:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return humanoids((read_x3d if path.suffix == ".x3d" else read_vrml)(path))[0]


def write(h: Humanoid, folder: Path, name: str, encoding: str, version: str) -> Path:
    scene, _ = scene_of([h], version=version, encoding=encoding)
    path = folder / f"{name}_{version}.{encoding}"
    (write_x3d if encoding == "x3d" else write_vrml)(scene, path)
    return path


def matrices(h: Humanoid) -> dict[str, np.ndarray]:
    """Ours, in the pose."""
    for joint in h.joints():
        joint.rotation = np.array(POSE.get(joint.name, [0, 0, 1, 0]), float)
    body = pack(h)
    return dict(zip(body.skeleton.names, joint_matrices(body.skeleton)[0], strict=True))


@pytest.mark.parametrize(("name", "joint"), KNOWN)
def test_known_answers(shared: Path, name: str, joint: str) -> None:
    h = load(shared / "data" / "hanim" / name)
    moved = matrices(h)[joint] @ [*h.joint(joint).center, 1]
    np.testing.assert_allclose(moved[:3], KNOWN[name, joint], atol=1e-6)


def test_known_answer_of_the_skin(shared: Path) -> None:
    h = load(shared / "data" / "hanim" / "JinNoAnimations_Fixed.x3d")
    found = matrices(h)
    rest = h.skin_coord[787]
    moved = rest.copy()
    for joint in h.joints():
        for weight in joint.skin_coord_weight[joint.skin_coord_index == 787]:
            moved += weight * ((found[joint.name] @ [*rest, 1])[:3] - rest)
    np.testing.assert_allclose(rest, (0.17834, 0.5577, -0.01941), atol=1e-9)
    np.testing.assert_allclose(moved, (0.843202, 1.331000, 0.165058), atol=1e-6)


def test_xite_agrees(shared: Path, referee: Path, chromium: str, tmp_path: Path) -> None:
    files = {}
    for name, (encoding, version) in SKINNED.items():
        files[write(load(shared / "data" / "hanim" / name), tmp_path, Path(name).stem, encoding, version)] = True
    files[shared / "data" / "hanim" / "Humanoid1NoSegSite.x3d"] = False
    files[write(typed(4), tmp_path, "ada", "x3d", "2.0")] = True
    agree(shared, referee, chromium, files)


def test_xite_agrees_on_the_built_in_person(shared: Path, referee: Path, chromium: str, tmp_path: Path) -> None:
    agree(shared, referee, chromium, {write(person(), tmp_path, "person", "x3d", "2.0"): True})


def test_xite_agrees_after_conversions(shared: Path, referee: Path, chromium: str, tmp_path: Path) -> None:
    """Between versions and levels: joints that were there before move there as they did."""
    joe, jin = (load(shared / "data" / "hanim" / n) for n in ("JoeHAnimKick1a.x3dv", "JinNoAnimations_Fixed.x3d"))
    for h in (joe, jin):
        h.tracks, h.motions = [], []
    cases = {
        "1.1": (typed(4), weld(load(write(typed(4), tmp_path, "down", "wrl", "1.1"))), "1.0"),
        "200x": (joe, load(write(joe, tmp_path, "over", "wrl", "200x")), "2.0"),
        "up": (typed(1), at_level(typed(1), 4)[0], "2.0"),
        "low": (jin, at_level(jin, 2)[0], "2.0"),
    }
    files = {write(h, tmp_path, name, "x3d", version): True for name, (_, h, version) in cases.items()}
    found = agree(shared, referee, chromium, files)
    for (before, _, _), result in zip(cases.values(), found, strict=True):
        expected = {tables.canonical(n): m for n, m in matrices(before).items()}
        theirs = {tables.canonical(n): np.array(m).reshape(4, 4).T for n, m in result["matrices"].items()}
        both = [n for n in theirs if n in expected]
        assert len(both) == min(len(theirs), len(expected))
        for name in both:
            assert np.abs(theirs[name] - expected[name]).max() < 1e-6, name


def agree(shared: Path, referee: Path, chromium: str, files: dict[Path, bool]) -> list[dict]:
    """Every joint matrix within 1e-6; files marked True load without a message. What X_ITE said of each."""
    script = shared / "hanim" / "referee" / "xite_load.mjs"
    found = run(script, referee, chromium, list(files), "--pose", json.dumps(POSE))
    for path, result in zip(files, found, strict=True):
        assert not files[path] or complaints(result) == [], path.name
        ours = matrices(load(path))
        assert len(result["matrices"]) == len(ours), path.name
        for joint, theirs in result["matrices"].items():
            difference = np.abs(ours[joint] - np.array(theirs).reshape(4, 4).T).max()
            assert difference < 1e-6, (path.name, joint)
    return found


def test_xite_loads_every_version(shared: Path, referee: Path, chromium: str, tmp_path: Path) -> None:
    files = [write(typed(1), tmp_path, "ada", e, v) for e, v in (("wrl", "200x"), ("wrl", "1.1"), ("x3dv", "2.0"))]
    script = shared / "hanim" / "referee" / "xite_load.mjs"
    for path, result in zip(files, run(script, referee, chromium, files), strict=True):
        assert complaints(result) == [], path.name
        assert result["nodes"]["IndexedFaceSet"] >= 2


def run(script: Path, referee: Path, chromium: str, files: list[Path], *options: str) -> list[dict]:
    command = ["node", str(script), str(referee), *map(str, files), *options]
    environment = {**os.environ, "CHROMIUM": chromium}
    out = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, env=environment)
    assert out.returncode == 0, out.stdout + out.stderr
    return [json.loads(line) for line in out.stdout.splitlines()]


def complaints(result: dict) -> list[str]:
    """Messages of the browser, those about pictures and addresses that are not at hand subtracted."""
    return [m for m in result["messages"] if "Error loading image" not in m and "Failed to load resource" not in m]


EXPORT = """async text => {
  await new Promise(resolve => X3D(resolve))
  const scene = await document.querySelector('x3d-canvas').browser.createX3DFromString(text)
  return scene.toJSONString()
}"""


def test_json_goes_both_ways(shared: Path, referee: Path, chromium: str, tmp_path: Path) -> None:
    """X_ITE finds in our JSON all nodes of the source, prototypes too, without a message; we read the JSON it writes."""
    sync = pytest.importorskip("playwright.sync_api").sync_playwright
    script = shared / "hanim" / "referee" / "xite_load.mjs"
    sources = [shared / "data" / "hanim" / name for name in ("JoeKick.x3d", "NancyPrototypes.wrl")]
    scenes = [scene_in(path) for path in sources]
    files = [tmp_path / f"{path.stem}.x3dj" for path in sources]
    for scene, path in zip(scenes, files, strict=True):
        write_scene(convert(scene, "x3dj")[0], path)
    for scene, result in zip(scenes, run(script, referee, chromium, files), strict=True):
        assert result["nodes"] == Counter(node.type for node in scene.walk())
        assert complaints(result) == []
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
    with sync() as p:
        browser = p.chromium.launch(executable_path=chromium, args=flags)
        page = browser.new_page(viewport={"width": 120, "height": 120})
        page.route("**/*", lambda route: answer(route, referee))
        page.goto("http://xite.test/page.html")
        text = page.evaluate(EXPORT, sources[0].read_text())
        browser.close()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = humanoids(parse_json(text.encode()))[0]
    mine = load(sources[0])
    assert [j.name for j in theirs.joints()] == [j.name for j in mine.joints()]
    np.testing.assert_allclose(theirs.skin_coord, mine.skin_coord, atol=1e-6)
    for a, b in zip(theirs.joints(), mine.joints(), strict=True):
        np.testing.assert_allclose(a.center, b.center, atol=1e-6)
        np.testing.assert_allclose(a.skin_coord_weight, b.skin_coord_weight, atol=1e-6)


PLAY = """async ([text, joint]) => {
  await new Promise(resolve => X3D(resolve))
  const browser = document.querySelector('x3d-canvas').browser
  const scene = await browser.createX3DFromString(text)
  await browser.replaceWorld(scene)
  const node = scene.getNamedNode(joint), seen = []
  for (let k = 0; k < 40 && new Set(seen).size < 4; ++k) {
    await new Promise(resolve => setTimeout(resolve, 100))
    seen.push(node.rotation.angle)
  }
  return seen
}"""


def test_what_we_write_moves_in_xite(referee: Path, chromium: str, tmp_path: Path) -> None:
    sync = pytest.importorskip("playwright.sync_api").sync_playwright
    tracks, motion = typed(1), typed(1)
    values = np.array([[0.0], [90.0], [0.0]])
    motion.tracks = []
    motion.motions = [MotionData("wave", ["l_shoulder"], [("Zrotation",)], values, 0.5, True, True)]
    files = [write(h, tmp_path, n, "x3d", "2.0") for h, n in ((tracks, "tracks"), (motion, "motion"))]
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
    with sync() as p:
        browser = p.chromium.launch(executable_path=chromium, args=flags)
        for path in files:
            page = browser.new_page(viewport={"width": 120, "height": 120})
            page.route("**/*", lambda route: answer(route, referee))
            page.goto("http://xite.test/page.html")
            angles = page.evaluate(PLAY, [path.read_text(), "hanim_l_shoulder"])
            assert len(set(angles)) >= 4, (path.name, angles)
            assert max(map(abs, angles)) > 0.05, (path.name, angles)
            page.close()
        browser.close()


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
