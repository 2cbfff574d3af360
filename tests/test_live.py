"""Files that deform themselves: X_ITE runs the exported script, and its points are ours."""

from __future__ import annotations

import dataclasses
import json
import shutil
import subprocess
import sys
import warnings
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import vitruvian as vt
from test_pictures import png
from vitruvian.body.contours import grid
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.rotations import from_axis_angle
from vitruvian.deform.contour_steps import Program
from vitruvian.deform.contours import ContourOperator
from vitruvian.errors import VitruvianError, VitruvianWarning
from vitruvian.formats import registry
from vitruvian.formats.live import CLOCK, SCRIPT, Live, _below, live_scene
from vitruvian.formats.live_parts import levels
from vitruvian.hanim.graph import Node, Proto
from vitruvian.hanim.graph import Route as SceneRoute
from vitruvian.hanim.humanoid import Picture
from vitruvian.modeling.lighter import lightened
from vitruvian.modeling.tuning import tuned
from vitruvian.motion.tracks import tracks_of
from vitruvian.motion.types import Motion
from xite import complaints, page_of

STEPS = """async ([steps, surfaces, softs]) => {
  const browser = document.querySelector('x3d-canvas').browser;
  const scene = browser.currentScene, script = scene.getNamedNode('hanim_ContourScript'), all = [];
  const numbers = (field) => Array.from(field, (p) => [p.x, p.y, p.z]);
  for (const { pose, events } of steps) {
    for (const [name, value] of Object.entries(events))
      script[name] = !Array.isArray(value) ? value : new X3D[name.endsWith('Def') ? 'SFRotation' : 'MFInt32'](...value);
    for (const [joint, r] of Object.entries(pose)) script[`hanim_${joint}Def`] = new X3D.SFRotation(...r);
    await browser.nextFrame();
    await browser.nextFrame();
    const out = { points: {}, joints: {} };
    for (const name of surfaces) out.points[name] = numbers(scene.getNamedNode('hanim_' + name).Points);
    for (const name of softs) out.points[name] = numbers(scene.getNamedNode(name + '_coord').point);
    for (const joint of Object.keys(pose)) out.joints[joint] = Array.from(scene.getNamedNode('hanim_' + joint).rotation);
    all.push(out);
  }
  return all;
}"""


@contextmanager
def shown(browser, referee: Path, path: Path):
    """A page in which X_ITE shows a file without a complaint."""
    with page_of(browser, referee) as xite:
        xite.load(path.read_text())
        yield xite.page
        real = complaints({"messages": xite.said})
    assert not real, real


@pytest.fixture(scope="module")
def humanoid():
    made = vt.contours(vt.person(gender=1, loa=2), density=0.5, diversion=0.4)
    left = [f"l_{part}_def" for part in ("upperarm", "forearm", "thigh", "calf")]
    tuned(made, {"r_upperarm_def": {"bulge": 0.3}} | {name: {"recentre": 1} for name in left})
    return lightened(made, 800)


@pytest.fixture(scope="module")
def walking(humanoid):
    out = humanoid.copied()
    out.tracks = tracks_of(vt.walk(vt.pack(humanoid).skeleton))
    return out


def random_pose(names: list[str], seed: int) -> dict[str, list[float]]:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=(len(names), 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return {n: [*a.tolist(), float(t)] for n, a, t in zip(names, axis, rng.uniform(0, 0.9, len(names)), strict=True)}


def matrices(live: Live, pose: dict[str, list[float]]) -> np.ndarray:
    skeleton = live.body.skeleton
    q = np.tile([0.0, 0, 0, 1], (1, len(skeleton), 1))
    for joint, rotation in pose.items():
        q[0, skeleton.index[joint]] = from_axis_angle(rotation)
    return joint_matrices(skeleton, Motion(skeleton, 30.0, q, np.zeros((1, 3))))


def expected(live: Live, pose: dict[str, list[float]], events: dict[str, object]) -> dict[str, np.ndarray]:
    """Points of every part where the scene graph has them, by our own deformer."""
    body, soft = live.body, live.soft
    m = matrices(live, pose)
    on = events.get("set_extremities", True)
    off = frozenset() if on else frozenset(s.name for s in body.contours if s.name.startswith("c"))
    world = np.empty((1, *body.skin.rest.shape), np.float32)
    ContourOperator(body, off=off, survey=bool(events.get("set_survey")), follow=False).points(m, world)
    there = world[0].astype(np.float64)
    out = {}
    for s in body.contours:
        f = m[0, s.joint]
        local = (there[s.vertices].reshape(-1, 3) - f[:3, 3]) @ f[:3, :3]
        out[s.name] = local - body.skeleton.centers[s.joint]
    moved = there[soft.vertices]
    if not on:
        pivot = soft.influences.joint[soft.influences.row[:-1]]
        alone = np.einsum("nab,nb->na", m[0, pivot, :3, :3], soft.rest) + m[0, pivot, :3, 3]
        moved = np.where(soft.far[:, None] > 0, alone, moved)
    root = m[0, 0]
    for name, part in zip(soft.names, np.split(moved, soft.end[:-1]), strict=True):
        out[f"hanim_{name}"] = (part - root[:3, 3]) @ root[:3, :3]
    return out


@pytest.mark.parametrize(
    ("encoding", "pointers"), [("x3d", "routes"), ("wrl", "routes"), ("x3dv", "human"), ("wrl", "nodes")]
)
def test_xite_runs_the_script_and_its_points_are_ours(browser, referee, humanoid, tmp_path, encoding, pointers):
    live = live_scene(humanoid, encoding=encoding, pointers=pointers)
    path = tmp_path / f"live.{encoding}"
    registry.write_scene(live.scene, path)
    names = list(live.body.skeleton.names)
    needed = [n for n in names if f"hanim_{n}Def" in path.read_text()]
    assert len(needed) == live.report["joints"] > 20
    steps = [{"pose": random_pose(needed, seed), "events": {}} for seed in (1, 2)]
    last = steps[-1]["pose"]
    steps += [
        {"pose": {}, "events": {"set_extremities": False}},
        {"pose": {}, "events": {"set_extremities": True, "set_survey": True}},
        {"pose": {}, "events": {"set_survey": False, "set_lod": 2}},
        {"pose": {}, "events": {"add_lod": [3, 2], "set_lod": 3}},
        {"pose": {"l_elbow": [1, 0, 0, 1.0]}, "events": {}},
        {"pose": {}, "events": {"hanim_r_thighDef": [1, 0, 0, -0.7]}},  # as the source names r_hip
    ]
    softs = [f"hanim_{n}" for n in live.soft.names]
    every, level = levels(live.body, live.body.contours), 0
    with shown(browser, referee, path) as page:
        found = page.evaluate(STEPS, [steps, [s.name for s in live.body.contours], softs])
        every.append(added(page, live, [[3, 2]])[-1])
        assert page.evaluate(TANGENTS, softs) == [1] * len(softs)  # given, not worked out, in VRML97 too
    for joint, rotation in last.items():  # and the joints got their rotations
        assert np.allclose(np.abs(from_axis_angle(found[1]["joints"][joint]) @ from_axis_angle(rotation)), 1, atol=1e-6)
    worst, pose, before = 0.0, {}, {}
    for step, got in zip(steps, found, strict=True):
        pose = pose | step["pose"]
        if turned := step["events"].get("hanim_r_thighDef"):
            pose = pose | {"r_hip": turned}
        level = step["events"].get("set_lod", level)
        used = {s.name: np.unique(t) for s, t in zip(live.body.contours, every[level], strict=True)}
        ours = expected(live, pose, step["events"])
        for name, points in ours.items():
            theirs = np.array(got["points"][name])
            some = used.get(name, slice(None))
            worst = max(worst, np.abs(theirs[some] - points[some]).max())
            if level and name in used:  # what the level leaves out is not worked out: it stays as it was
                idle = np.setdiff1d(np.arange(len(points)), used[name])
                assert len(idle) and np.array_equal(theirs[idle], np.array(before[name])[idle])
        before = got["points"]
    print(f"{encoding}: {live.report['points']} contour points, worst {worst:.1e} m")
    assert worst < 1e-4


def test_the_animation_changes_its_speed_while_it_plays(browser, referee, walking, tmp_path):
    live = live_scene(walking, encoding="x3d")
    path = tmp_path / "walk.x3d"
    registry.write_scene(live.scene, path)
    run = """async (name) => {
      const browser = document.querySelector('x3d-canvas').browser, scene = browser.currentScene;
      const clock = scene.getNamedNode('hanim_ClockScript'), knee = scene.getNamedNode('hanim_l_knee');
      const seen = async (speed) => {
        clock.set_speed = speed;
        const angles = new Set(), start = performance.now();
        await browser.nextFrame(); await browser.nextFrame();
        for (let k = 0; k < 6; ++k) { await browser.nextFrame(); angles.add(knee.rotation.angle.toFixed(6)); }
        return angles.size;
      };
      return [await seen(1), await seen(0), await seen(-0.5)];
    }"""
    with shown(browser, referee, path) as page:
        moving, still, back = page.evaluate(run, "")
    assert moving > 2 and still == 1 and back > 2


def test_rotations_are_routed_to_the_script_and_points_leave_first(walking):
    live = live_scene(walking, encoding="x3d")
    routes = live.scene.routes()
    turned = [r for r in routes if r.to_field in ("rotation", "set_rotation")]
    assert not [r for r in turned if forks(r, live)]
    assert len([r for r in turned if r.from_node == SCRIPT]) == live.report["joints"]
    assert any(r.to_field == "hanim_l_kneeDef" for r in routes)
    assert {r.from_node for r in routes if r.to_field == "set_fraction"} == {CLOCK}
    work = live.scene.defs()[SCRIPT].text.split("function eventsProcessed")[1]
    assert work.index("publish();") < work.index("release();")
    # A fork, as an author may leave it: the knee turns at once, its points come by another way. That is seen.
    source = next(r.from_node for r in routes if r.to_field == "hanim_l_kneeDef")
    live.scene.body.append(SceneRoute(source, "value_changed", "hanim_l_knee", "set_rotation"))
    assert [r.to_node for r in live.scene.routes() if forks(r, live)] == ["hanim_l_knee"]


def forks(route: SceneRoute, live: Live) -> bool:
    """Whether a route turns a joint of the script past the script."""
    known = {f.name for f in live.scene.defs()[SCRIPT].interface}
    joint = route.to_node.removeprefix("hanim_")
    turns = route.to_field in ("rotation", "set_rotation") and f"hanim_{joint}Def" in known
    return turns and route.from_node != SCRIPT


@pytest.mark.parametrize("encoding", ["x3d", "wrl"])
def test_nothing_is_deformed_twice(humanoid, encoding):
    live = live_scene(humanoid, encoding=encoding)
    for node in live.scene.walk():
        assert not {"skinCoord", "skinCoordIndex", "skinCoordWeight"} & set(node.fields), node.type
        assert len(node.children("skin")) == 0
    targets = [(r.to_node, r.to_field) for r in live.scene.routes() if r.to_field in ("set_Points", "set_point")]
    assert len(targets) == len(set(targets)) == live.report["surfaces"]
    # every triangle of the skin is somewhere, once
    shapes = [n for n in live.scene.walk() if n.type == "Shape" and n.name]
    count = 0
    for shape in shapes:
        faces = shape.children("geometry")[0]
        index = np.asarray(faces.fields.get("index", faces.fields.get("coordIndex")))
        count += len(index[index >= 0]) // 3
    assert count == sum(len(s.triangles) for s in humanoid.skin)


TANGENTS = """(softs) => softs.map((name) => document.querySelector('x3d-canvas').browser.currentScene
  .getNamedNode(name).geometry.tangent?.vector.length)"""
ADDED = """([code, fields, names, steps]) => {
  const given = Object.keys(fields), all = 'initialize();' + steps.map((s) => `add_lod([${s}]);`).join('') + `
    const out = [], count = place.each.length;
    for (level = 0; level < (place.facesRow.length - 1) / count; ++level)
      out.push(place.each.map((_, s) => facesOf(s, place.faces)));
    return [out, lod_count];`;
  const make = new Function('MFVec3f', 'MFInt32', 'SFVec3f', ...given, ...names, code + all);
  return make(Array, Array, Array, ...given.map((k) => fields[k]), ...names.map(() => null));
}"""


def added(page, live: Live, steps: list[list[int]]) -> list[list[np.ndarray]]:
    """Triangles of each level and surface by the file's script alone, after some levels were added."""
    script = live.scene.defs()[SCRIPT]
    fields = {f.name: np.asarray(f.value).tolist() for f in script.interface
              if f.access == "initializeOnly" and not f.type.endswith("Node")}  # fmt: skip
    names = [f.name for f in script.interface if f.access == "outputOnly" or f.type.endswith("Node")]
    code = (script.text or script.fields["url"][0]).split(":", 1)[1]
    found, count = page.evaluate(ADDED, [code, fields, names, steps])
    assert len(found) == min(3 + len(steps), 32) == count
    return [[np.array(t, np.int32).reshape(-1, 3) for t in level] for level in found]


def test_levels_added_while_it_runs_leave_no_hole_either(browser, humanoid):
    live = live_scene(humanoid)
    page = browser.new_page()
    every = added(page, live, [[1, 1], [2, 2], [5, 1], [1, 3], [1000, 1000], [0, -1]])
    assert len(added(page, live, [[2, 2]] * 100)) == 32  # and no more
    page.close()
    for found, ours in zip(every, levels(live.body, live.body.contours, 3), strict=False):
        assert all(np.array_equal(a, b) for a, b in zip(found, ours, strict=True))
    check_levels(live.body, every)
    whole = every[0]
    for n in (3, 8):  # of steps 1 and less: all
        assert all(len(np.unique(a)) == len(np.unique(b)) for a, b in zip(every[n], whole, strict=True))
    sizes = [sum(len(t) for t in level) for level in every]
    assert sizes[0] > sizes[4] > sizes[7] and sizes[0] > sizes[6] > sizes[7] and sizes[0] > sizes[5] > sizes[7]


def test_levels_are_subsets_that_leave_no_hole(humanoid):
    body = vt.pack(humanoid)
    every = levels(body, body.contours, 3)
    check_levels(body, every)
    counts = [sum(len(np.unique(t)) for t in level) for level in every]
    assert counts[0] == sum(s.vertices.size for s in body.contours) and counts[0] > 1.5 * counts[1] > 1.5 * counts[2]
    assert np.array_equal(np.sort(every[0][0], axis=0),
                          np.sort(grid(np.arange(body.contours[0].vertices.size).reshape(body.contours[0].vertices.shape),
                                       body.contours[0].closed), axis=0))  # fmt: skip


def check_levels(body, every: list[list[np.ndarray]]) -> None:
    """All wound alike, open only at the ends, the same points on both sides of a seam."""
    for level in every:
        for s, triangles in zip(body.contours, level, strict=True):
            edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
            _, directed = np.unique(edges, axis=0, return_counts=True)
            assert (directed == 1).all()  # all wound alike
            pairs, times = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
            assert times.max() == 2
            rim = np.unique(pairs[times == 1]) // s.vertices.shape[1]
            if s.closed:
                assert set(rim.tolist()) == {0, len(s) - 1}
        seams = [keys(body, s, t) for s, t in zip(body.contours, level, strict=True)]
        for k, whole in enumerate(every[0]):
            full = keys(body, body.contours[k], whole)
            for other in range(k):  # points that two surfaces share: both keep them or neither
                both = full & keys(body, body.contours[other], every[0][other])
                assert both & seams[k] == both & seams[other]


def keys(body, surface, triangles) -> set:
    used = np.unique(triangles)
    return {tuple(p) for p in np.round(body.skin.rest[surface.vertices.reshape(-1)[used]] * 1e7).astype(int).tolist()}


def test_the_script_knows_all_that_turns_contours(humanoid):
    """Whoever adds a field to the program of contours must add it to the script."""
    from vitruvian.formats import live as module

    source = Path(module.__file__).with_suffix(".js").read_text()
    told = {"mitre_link": "mitreLink", "mitre_share": "mitreShare", "bulge_link": "bulgeLink"}
    for field in dataclasses.fields(Program):
        if field.name == "paper":  # twists as first published: files never turn so
            continue
        assert f"plain({told.get(field.name, field.name)})" in source, field.name


def test_a_lighter_skin_keeps_its_shape_and_its_weights(humanoid):
    whole = vt.contours(vt.person(gender=1, loa=2), density=0.5, diversion=0.4)
    assert len(humanoid.skin_coord) < 2200 < len(whole.skin_coord) / 10
    body, before = vt.pack(humanoid), vt.pack(whole)
    assert np.allclose(body.skin.weights.sums, 1)
    for axis in range(3):
        for end in (np.min, np.max):
            was, now = end(whole.skin_coord[:, axis]), end(humanoid.skin_coord[:, axis])
            assert abs(was - now) < 0.01
    assert len(body.contours) == len(before.contours)
    assert [len(s.tied) for s in body.contours] == [len(s.tied) for s in before.contours]  # seams stay, point by point
    tied = np.concatenate([s.tied[:, 0] for s in body.contours])
    assert len(open_edges(humanoid.skin[0].triangles, tied)) == len(tied) > 100  # with all edges between
    # What shows its inner side (hair) is drawn from both sides, what a body fills (clothes too) from outside only.
    assert [(s.name, s.material.double_sided) for s in humanoid.skin] == [("skin", False), ("hair", True)]
    assert sum(s.material.double_sided for s in whole.skin) > 3
    naked = whole.copied()
    naked.skin = [s for s in whole.skin if s.name == "shorts"]
    assert [s.material.double_sided for s in lightened(naked, 400).skin] == [True]  # little fills them then
    fine = lightened(whole, 800, fingers=True)
    bending = {j.name for j in fine.joints() if len(j.skin_coord_index)}
    assert "l_carpal_distal_interphalangeal_2" in bending
    assert not any("carpal_" in j.name and len(j.skin_coord_index) for j in humanoid.joints() if "radio" not in j.name)
    with pytest.raises(VitruvianError, match="at least 100"):
        lightened(whole, 50)


def open_edges(triangles: np.ndarray, some: np.ndarray) -> set[tuple[int, int]]:
    """Edges of one triangle alone, between some points."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    directed = {tuple(e) for e in edges[np.isin(edges, some).all(axis=1)].tolist()}
    return {(a, b) for a, b in directed if (b, a) not in directed}


def test_a_surface_in_which_fans_of_faces_meet_at_one_point_is_lightened(shared, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", VitruvianWarning)
        made = vt.contours(vt.load(shared / "data/hanim/JinLOA1.x3d"))
    light = lightened(made, 900)
    assert {s.name for s in light.skin} == {s.name for s in made.skin} and all(len(s.triangles) for s in light.skin)
    size = [np.ptp(h.skin_coord[np.concatenate([s.triangles.ravel() for s in h.skin])], axis=0) for h in (made, light)]
    assert np.abs(size[0] - size[1]).max() < 0.03 * size[0].max() and len(light.skin_coord) < 0.8 * len(made.skin_coord)


def test_one_side_is_drawn_where_nothing_is_open_and_seams_share_normals(humanoid):
    def sided(live: Live) -> bool:
        proto = next(n for n in live.scene.body if isinstance(n, Proto) and n.name.startswith("DefBody"))
        shown = [n for top in proto.body if isinstance(top, Node) for n in _below(top) if n.type == "Shape"]
        return shown[0].children("geometry")[0].fields["solid"]

    live = live_scene(humanoid)
    assert sided(live) is True
    body, soft = live.body, live.soft
    assert (np.bincount(soft.tied[soft.tied >= 0]) > 5).sum() == sum(
        len(np.unique(s.tied[:, 1])) for s in body.contours
    )
    shown = {s.name: node for s in body.contours for node in live.scene.walk() if node.fields.get("name") == s.name}
    first = 0
    for s in body.contours:
        normals = np.asarray(shown[s.name].fields["Normals"]).reshape(*s.vertices.shape, 3)
        for k in np.unique(s.tied[:, 1]):
            for v in np.flatnonzero(soft.tied == first + k):
                point = np.flatnonzero((body.skin.rest[s.vertices[k]] == soft.rest[v]).all(axis=1))
                assert len(point) and np.allclose(normals[k, point[0]], soft.normals[v], atol=1e-6)
        first += len(s)
    bare = humanoid.copied()
    bare.skin = []  # without what they are sewn to, contours are seen from inside
    assert sided(live_scene(bare)) is False


@pytest.mark.parametrize("encoding", ["x3d", "wrl"])
@pytest.mark.parametrize("source", ["x3d", "wrl"])
def test_pictures_are_drawn_where_a_surface_has_one(humanoid, tmp_path, source, encoding):
    def pictures(live: Live) -> int:
        tops = [n for proto in live.scene.body if isinstance(proto, Proto) for n in proto.body if isinstance(n, Node)]
        return sum(n.type in ("ImageTexture", "TextureCoordinate") for top in tops for n in _below(top))

    assert pictures(live_scene(humanoid, encoding=encoding)) == 0
    path = tmp_path / f"striped.{source}"
    vt.save(humanoid, path)
    name = {"x3d": "<fieldValue name='name' value='l_thigh_def'/>", "wrl": 'name "l_thigh_def"'}[source]
    more = {"x3d": "<fieldValue name='tex' value='\"stripes.png\"'/>", "wrl": ' tex [ "stripes.png" ]'}[source]
    text = path.read_text()
    assert text.count(name) == 1
    path.write_text(text.replace(name, name + more))
    live = live_scene(vt.load(path), encoding=encoding)
    assert pictures(live) == 2
    registry.write_scene(live.scene, tmp_path / f"live.{encoding}")
    assert (tmp_path / f"live.{encoding}").read_text().count("stripes.png") == 1


LOOKS = """async ([names, events]) => {
  const browser = document.querySelector('x3d-canvas').browser;
  const script = browser.currentScene.getNamedNode('hanim_ContourScript'), all = [];
  for (const [name, value] of events) {
    script[name] = Array.isArray(value) ? new X3D.MFInt32(...value) : value;
    await browser.nextFrame();
    await browser.nextFrame();
    all.push(names.map((n) => ['index', 'looks'].map((kind) => Array.from(script[`${n}_${kind}`]))));
  }
  return all;
}"""


@pytest.mark.parametrize("encoding", ["x3d", "wrl"])
def test_pictures_keep_to_one_side_of_a_border_of_the_map(browser, referee, humanoid, tmp_path, encoding):
    """At every level of detail of a file with pictures; one that is added while it runs has the points' own coordinates."""
    striped = humanoid.copied()
    for s in (s for g in striped.segments() for s in g.contours):
        s.material = dataclasses.replace(s.material, picture=Picture(data=png()))
    live = live_scene(striped, encoding=encoding)
    path = tmp_path / f"striped.{encoding}"
    registry.write_scene(live.scene, path)
    read = {s.name: s for g in vt.load(path).segments() for s in g.contours}
    for s in (s for g in striped.segments() for s in g.contours):
        assert (s.uv_corners is None) == (read[s.name].uv_corners is None)
        assert s.uv_corners is None or np.allclose(s.uv_corners, read[s.name].uv_corners, atol=1e-6)
        assert read[s.name].material.picture is not None
    names = [name for name, s in read.items() if s.uv_corners is not None]
    assert len(names) > 6
    events = [["set_lod", 1], ["set_lod", 2], ["set_lod", 0], ["add_lod", [3, 2]], ["set_lod", 3]]
    with shown(browser, referee, path) as page:
        found = page.evaluate(LOOKS, [names, events])
    coordinates = {n.fields["name"]: np.asarray(n.fields["TexCoords"]).reshape(-1, 2) for n in live.scene.walk()
                   if n.type == "DefBodyTex"}  # fmt: skip
    edge = lambda a: np.linalg.norm(a - np.roll(a, 1, axis=1), axis=2).max(axis=1)  # noqa: E731
    smeared = 0
    for level, shapes in enumerate(found):
        for name, (index, looks) in zip(names, shapes, strict=True):
            faces, shown_ = (np.array(a).reshape(-1, 4) for a in (index, looks))
            assert (faces[:, 3] == -1).all() and (shown_[:, 3] == -1).all()
            if level > 2:
                assert level == 3 or np.array_equal(faces, shown_)
                continue
            uv, points = coordinates[name], read[name].points.reshape(-1, 3)
            size = edge(points[faces[:, :3]])
            dense = np.quantile(edge(uv[shown_[:, :3]]) / size, 0.8)
            assert (edge(uv[shown_[:, :3]]) < 4 * dense * size).all()
            smeared += int((edge(uv[faces[:, :3]]) > 4 * dense * size).sum())
    assert smeared > 50


def test_what_is_asked_wrongly_is_refused(humanoid):
    person = vt.person(loa=1)
    with pytest.raises(VitruvianError, match="live: expected a body with contours"):
        live_scene(person)
    with pytest.raises(VitruvianError, match="pointers: expected routes"):
        live_scene(humanoid, pointers="strings")
    with pytest.raises(VitruvianError, match="schemes: expected some of javascript"):
        live_scene(humanoid, schemes=("java",))


def test_several_copies_of_the_script_for_several_browsers(humanoid):
    live = live_scene(humanoid, encoding="wrl", schemes=("javascript", "vrmlscript"))
    url = live.scene.defs()[SCRIPT].fields["url"]
    assert [u.split(":", 1)[0] for u in url] == ["javascript", "vrmlscript"]
    assert url[0].split(":", 1)[1] == url[1].split(":", 1)[1]


@pytest.mark.parametrize(("encoding", "version", "pointers"), [
    ("wrl", "200x", "routes"), ("wrl", "200x", "human"), ("x3d", "1.0", "routes"), ("x3dv", "1.0", "nodes"),
])  # fmt: skip
def test_castle_reads_it_without_a_warning(walking, tmp_path, encoding, version, pointers):
    castle = shutil.which("tovrmlx3d")
    if castle is None:
        pytest.skip("no tovrmlx3d: install Debian's `view3dscene` (apt-get install view3dscene)")
    path = tmp_path / f"live.{encoding}"
    registry.write_scene(live_scene(walking, encoding=encoding, version=version, pointers=pointers).scene, path)
    run = subprocess.run([castle, "--encoding=xml", str(path)], capture_output=True, timeout=120, check=False)
    assert run.returncode == 0 and not run.stderr.strip(), run.stderr.decode()[:500]


def test_the_command_writes_contours_with_and_without_a_script(tmp_path):
    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "vitruvian", "contours", *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)

    done = run("person", "-o", str(tmp_path / "c.x3dv"), "--density", "0.5", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["surfaces"] == 11 and told["points"] > 500 and told["shape_error_mm"] < 5
    back = vt.pack(vt.load(tmp_path / "c.x3dv"))
    assert len(back.contours) == 11 and sum(s.vertices.size for s in back.contours) == told["points"]
    path = tmp_path / "c.x3d"
    done = run("person", "-o", str(path), "--live", "--density", "0.5", "--skin", "600", "--json")
    assert done.returncode == 0 and b"eventsProcessed" in path.read_bytes(), done.stderr
    told = json.loads(done.stdout)
    assert told["file_bytes"] == path.stat().st_size > told["file_gzip_bytes"] > 10_000
    assert told["script_bytes"] > told["live"]["script_gzip_bytes"] > 1000 and 0 < told["pose_ms"] < 100
    assert told["live"]["points"] == told["points"] and told["live"]["levels"] == 3
    back = vt.pack(vt.load(path))  # and it is read again, contours and all
    assert len(back.contours) == 11
    for arguments, word in (
        (("person", "-o", str(tmp_path / "c.glb"), "--live"), "--live: expected a scene"),
        (("person", "-o", str(tmp_path / "c.wrl"), "--live", "--pointers", "no"), "pointers: expected"),
        (("nobody.x3d", "-o", str(tmp_path / "d.x3d")), "no such file"),
    ):
        done = run(*arguments)
        assert done.returncode == 2 and word in done.stderr and done.stderr.count("\n") == 1, done.stderr
