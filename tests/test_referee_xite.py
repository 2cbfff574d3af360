"""X_ITE, an X3D browser, as referee: our files load there without a message, and its joint matrices are ours."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scene_figure import typed
from test_decimate import sphere
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.pack import pack
from vitruvian.formats import registry
from vitruvian.formats.level_switch import write_switch
from vitruvian.hanim import tables
from vitruvian.hanim.build import scene_of
from vitruvian.hanim.humanoid import Humanoid, MotionData
from vitruvian.hanim.welding import weld
from vitruvian.modeling import decimate
from vitruvian.modeling.levels import at_level
from vitruvian.modeling.person import person
from written import KINDS, counts, people
from xite import FLAGS, Browser, complaints, page_of

ROUTES = re.compile(r"<ROUTE\b[^>]*/>|^\s*ROUTE\s+\S+\s+TO\s+\S+", re.MULTILINE)
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
    return figures(path)[0]


def figures(path: Path) -> list[Humanoid]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return registry.humanoids(path)


def write(h: Humanoid, folder: Path, name: str, encoding: str, version: str) -> Path:
    scene, _ = scene_of([h], version=version, encoding=encoding)
    path = folder / f"{name}_{version}.{encoding}"
    registry.write_scene(scene, path)
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


@pytest.fixture(scope="module")
def browser(playwright: Any, referee: Path, chromium: str) -> Iterator[Browser]:
    started = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
    with page_of(started, referee) as found:
        yield found
    started.close()


def agree(browser: Browser, path: Path, *, silent: bool = True, least: int = 1) -> dict[str, np.ndarray]:
    """X_ITE finds our nodes, our joint matrices within 1e-6 and, `silent`, nothing to say. Answers the matrices.

    Skinned figures have matrices; `least` is how many there must be. ROUTEs are left out: the pose alone counts.
    """
    text = path.read_text("utf-8-sig")
    result = browser.load(ROUTES.sub("", text), POSE)
    assert not silent or complaints(result) == [], path.name
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        nodes = counts(registry.scene(path))
    assert result["nodes"] == nodes, path.name
    every = [square(figure["matrices"]) for figure in result["figures"]]
    if not every:  # prototypes
        assert not least, path.name
        return {}
    for h, theirs in zip(figures(path), every, strict=True):
        assert len(theirs) >= least, path.name
        if theirs:
            ours = matrices(h)
            assert len(theirs) == len(ours), path.name
            for joint, matrix in theirs.items():
                assert np.abs(ours[joint] - matrix).max() < 1e-6, (path.name, h.name, joint)
    return every[0]


def square(columns: dict[str, list[float]]) -> dict[str, np.ndarray]:
    return {n: np.array(m).reshape(4, 4).T for n, m in columns.items()}


def test_xite_agrees(shared: Path, browser: Browser, tmp_path: Path) -> None:
    for name, (encoding, version) in SKINNED.items():
        agree(browser, write(load(shared / "data" / "hanim" / name), tmp_path, Path(name).stem, encoding, version))
    agree(browser, shared / "data" / "hanim" / "Humanoid1NoSegSite.x3d", silent=False)
    agree(browser, write(typed(4), tmp_path, "ada", "x3d", "2.0"), least=146)


def test_xite_agrees_on_the_built_in_person(browser: Browser, tmp_path: Path) -> None:
    agree(browser, write(person(), tmp_path, "person", "x3d", "2.0"), least=100)
    agree(browser, write(people()["person1-walks"][0], tmp_path, "walker", "x3dv", "2.0"), least=18)


def test_xite_agrees_on_people_side_by_side(browser: Browser, tmp_path: Path) -> None:
    """Two of one name, and a file's person twice: DEFs are theirs alone, and both move as ours do."""
    ada, bob = person(gender=0.0, loa=1), person(gender=1.0, loa=1)
    bob.translation = np.array([1.0, 0, 0])
    registry.save([ada, bob], tmp_path / "pair.x3d")
    one = figures(tmp_path / "pair.x3d")[0]
    twin, _, _ = at_level(person(gender=0.0, loa=2), 1)
    twin.translation = np.array([-1.0, 0, 0])
    registry.save([one, twin], tmp_path / "twins.x3dv")
    for name in ("pair.x3d", "twins.x3dv"):
        path = tmp_path / name
        defs = re.findall(r"DEF(?:='| )([^\s']+)", path.read_text())
        assert len(set(defs)) == len(defs) > 200
        assert {"person_l_elbow", "person_2_l_elbow"} <= set(defs)
        agree(browser, path, least=18)
        assert not [f for f in registry.check(path) if f.severity != "note"]


def test_real_figures_in_every_version(shared: Path, browser: Browser, tmp_path: Path) -> None:
    """One with a skin in all versions and encodings, others in one of each; prototypes and 1.1 have no matrices."""
    for name in ("JoeKick.x3d", "NancyPrototypes.wrl", "JinLOA1.x3d"):
        for encoding, version in KINDS if name == "JoeKick.x3d" else KINDS[2::2]:
            skinned = name == "JoeKick.x3d" and encoding != "wrl"
            path = write(load(shared / "data" / "hanim" / name), tmp_path, Path(name).stem, encoding, version)
            agree(browser, path, least=94 if skinned else 0)


@pytest.mark.parametrize("first", KINDS, ids="-".join)
def test_every_conversion(browser: Browser, tmp_path: Path, first: tuple[str, str]) -> None:
    """From each version and encoding to each that X_ITE moves: nodes, silence, and the matrices of the first figure."""
    expected = matrices(typed(1))
    there = load(write(typed(1), tmp_path, "first", *first))
    for second in KINDS[:4]:
        least = len(expected) if first[1] != "1.1" else 0  # its skin went to segments
        found = agree(browser, write(there, tmp_path, "second", *second), least=least)
        for joint, matrix in found.items():
            assert np.abs(expected[tables.canonical(joint)] - matrix).max() < 1e-6, (first, second, joint)


def test_levels_and_skins(shared: Path, browser: Browser, tmp_path: Path) -> None:
    """Between levels, and through segments and back: joints that were there before move there as they did."""
    joe, jin = (load(shared / "data" / "hanim" / n) for n in ("JoeHAnimKick1a.x3dv", "JinNoAnimations_Fixed.x3d"))
    for h in (joe, jin):
        h.tracks, h.motions = [], []
    cases = {
        "1.1": (typed(4), weld(load(write(typed(4), tmp_path, "down", "wrl", "1.1"))), "1.0"),
        "200x": (joe, load(write(joe, tmp_path, "over", "wrl", "200x")), "2.0"),
        "up": (typed(1), at_level(typed(1), 4)[0], "2.0"),
        "low": (jin, at_level(jin, 2)[0], "2.0"),
    }
    for name, (before, h, version) in cases.items():
        found = agree(browser, write(h, tmp_path, name, "x3d", version))
        expected = {tables.canonical(n): m for n, m in matrices(before).items()}
        theirs = {tables.canonical(n): m for n, m in found.items()}
        both = [n for n in theirs if n in expected]
        assert len(both) == min(len(theirs), len(expected))
        for joint in both:
            assert np.abs(theirs[joint] - expected[joint]).max() < 1e-6, (name, joint)


PLAY = """async ([text, joint]) => {
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


def test_what_we_write_moves_in_xite(browser: Browser, tmp_path: Path) -> None:
    tracks, motion = typed(1), typed(1)
    values = np.array([[0.0], [90.0], [0.0]])
    motion.tracks = []
    motion.motions = [MotionData("wave", ["l_shoulder"], [("Zrotation",)], values, 0.5, True, True)]
    files = [write(h, tmp_path, n, "x3d", "2.0") for h, n in ((tracks, "tracks"), (motion, "motion"))]
    for path in files:
        angles = browser.page.evaluate(PLAY, [path.read_text(), "hanim_l_shoulder"])
        assert len(set(angles)) >= 4, (path.name, angles)
        assert max(map(abs, angles)) > 0.05, (path.name, angles)


LEVELS = """async (away) => {
  await new Promise(resolve => X3D(resolve))
  const browser = document.querySelector('x3d-canvas').browser
  await browser.loadURL(new X3D.MFString('http://xite.test/levels/person.x3d'))
  const lod = browser.currentScene.getNamedNode('Levels'), out = []
  const view = [...browser.currentScene.rootNodes].find(n => n.getNodeTypeName() === 'Viewpoint')
  const points = inline => {
    const stack = [...inline.getValue().getInternalScene().rootNodes], seen = new Set()
    while (stack.length) {
      const node = stack.pop()
      if (!node || seen.has(node)) continue
      seen.add(node)
      if (node.getNodeTypeName() === 'HAnimHumanoid') return node.skinCoord.point.length
      if (node.children) stack.push(...node.children)
    }
    return null
  }
  for (const z of away) {
    view.position = new X3D.SFVec3f(0, 1, z)
    for (let k = 0; k < 20; ++k) await browser.nextFrame()
    out.push(lod.level_changed)
  }
  for (let k = 0; k < 200 && ![...lod.children].every(c => points(c)); ++k) await browser.nextFrame()
  return {shown: out, points: [...lod.children].map(points)}
}"""


def test_levels_change_as_the_viewer_comes_and_goes(browser: Browser, tmp_path: Path) -> None:
    files = [tmp_path / f"person-{n}.x3d" for n in ("full", 300, 100)]
    made = decimate.levels(sphere(), [300, 100])
    for level, file in zip(made, files, strict=True):
        registry.save(level.humanoid, file)
    write_switch(tmp_path / "person.x3d", sphere(), files, [5.0, 10.0])
    browser.page.route("**/levels/*", lambda route: route.fulfill(path=tmp_path / route.request.url.split("/")[-1]))
    found = browser.page.evaluate(LEVELS, [3.0, 7.0, 14.0, 3.0])
    assert found["shown"] == [0, 1, 2, 0]
    assert found["points"] == [len(registry.load(file).skin_coord) for file in files]


def test_the_referee_sees_mistakes(browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(typed(1), tmp_path, "good", "x3d", "2.0")
    assert len(agree(browser, path)) == 18
    monkeypatch.setitem(POSE, "l_knee", [1, 0, 0, 0.8 + 1e-5])
    result = browser.load(ROUTES.sub("", path.read_text()), POSE)
    monkeypatch.undo()
    theirs = square(result["figures"][0]["matrices"])["l_knee"]
    assert np.abs(matrices(load(path))["l_knee"] - theirs).max() > 1e-6
    assert complaints(browser.load(path.read_text().replace("<WorldInfo ", "<WorldInfos ")))
