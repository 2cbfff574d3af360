"""Clothes that move, kept frame by frame in files: what is read back is what was worn, within the bound that is said."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import vitruvian as vt
from gltf_player import Player
from pages import opened, pause, scrub
from test_bake import PLAY
from test_glb import assert_clean
from vitruvian.body.kinematics import pose_matrices
from vitruvian.cli import app
from vitruvian.cloth.drafting import drafted
from vitruvian.cloth.placing import dummy
from vitruvian.cloth.tailor import tailor
from vitruvian.deform.normals import incidence, mesh_normals
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.cache_file import read_caches, write_caches
from vitruvian.formats.obj_sequence import write_sequence
from vitruvian.formats.registry import save
from vitruvian.modeling.measures import measures
from vitruvian.motion.contacts import soled
from vitruvian.motion.live import baked as played
from vitruvian.motion.tracks import frames_to_write
from vitruvian.stage.baking import CLOSING, bake, led_in
from vitruvian.stage.clip import Clip
from xite import complaints, page_of

BOUND = 0.002


@pytest.fixture(scope="session")
def walker() -> Clip:
    """A woman who walks in a shirt, at twelve frames a second."""
    h = vt.person(loa=1, outfit=None, hair="none", gender=0.0)
    body = vt.pack(h)
    pattern = drafted("tshirt", measures(h).values)
    from vitruvian.cli.dressing import placed_on

    garment = tailor(placed_on(pattern, h), body, size=0.03)
    walk = vt.walk(soled(body), fps=12.0)
    return Clip(h, body, walk, "linear", garment)


@pytest.fixture(scope="session")
def dressed(walker: Clip) -> Clip:
    return replace(walker, caches=bake(walker))


def still(clip: Clip, frames: int) -> Clip:
    """The first frames of a clip, which end."""
    m = clip.motion
    assert m is not None
    return replace(
        clip, motion=replace(m, rotation=m.rotation[:frames], translation=m.translation[:frames], loop=False)
    )


# baking


def test_the_same_clip_gives_the_same_bits_and_cloth_stays_on(walker: Clip) -> None:
    short = still(walker, 4)
    told: list[tuple[int, int]] = []
    first, again = bake(short, progress=lambda *a: told.append(a))[0], bake(short)[0]
    assert np.array_equal(first.positions, again.positions) and len(first) == 4 and first.closing == 0
    assert told[-1] == (len(told), len(told))
    assert np.array_equal(first.times, np.arange(4) / 12) and first.name == "garment" and first.uv is not None
    garment = walker.garment
    assert garment is not None and np.array_equal(first.triangles, garment.triangles)
    edges = np.concatenate([first.triangles[:, [0, 1]], first.triangles[:, [1, 2]]])
    rest = np.linalg.norm(np.diff(garment.vertices[edges], axis=1)[:, 0], axis=1)
    long = np.linalg.norm(np.diff(first.positions[:, edges], axis=2)[:, :, 0], axis=2)
    assert np.percentile(long / rest, 90) < 1.3  # it is not torn
    assert first.weights is not None and np.abs(first.weights.sums - 1).max() < 1e-9


def test_a_loop_comes_back_to_where_it_began(dressed: Clip) -> None:
    (cache,), motion = dressed.caches, dressed.motion
    assert motion is not None
    root = frames_to_write(motion)[1][:, 0]
    assert len(cache) == len(motion) + 1
    assert np.abs(cache.positions[-1] - cache.positions[0] - (root[-1] - root[0])).max() < 1e-5
    assert 0 < cache.closing < 0.3
    assert np.linalg.norm(np.diff(cache.positions, axis=0), axis=2).max() < 0.4  # no leap in a twelfth of a second


def test_what_leads_into_a_motion_is_continuous(walker: Clip) -> None:
    motion = walker.motion
    assert motion is not None
    long, lead = led_in(motion)
    step = np.linalg.norm(np.diff(long.translation, axis=0), axis=1)
    assert lead == 24 and not long.loop and len(long) == lead + len(motion) + 1
    assert step.max() < 1.5 * np.median(step) and step.min() > 0.5 * np.median(step)  # it walks all the time
    turned = np.abs(np.einsum("fji,fji->fj", long.rotation[1:], long.rotation[:-1]))
    assert turned[lead - 1].min() >= turned[lead:].min() - 1e-9
    ended, lead = led_in(replace(motion, loop=False))
    speed = np.diff(ended.translation[: lead + 2], axis=0)
    assert np.linalg.norm(speed[0]) < 0.1 * np.linalg.norm(speed[-1])  # gets up speed
    assert np.abs(speed[-2] - speed[-1]).max() < 0.1 * np.linalg.norm(speed[-1])
    assert motion.seconds > CLOSING


def test_clips_without_garment_or_motion(walker: Clip) -> None:
    assert bake(replace(walker, garment=None)) == ()
    (cache,) = bake(replace(walker, motion=None))
    assert len(cache) == 1 and cache.times[0] == 0


# files


def exact(clip: Clip, path: Path) -> tuple[Player, np.ndarray, int]:
    """A GLB's player, the points that its cloth should have (F,drawn,3), and the node of the cloth."""
    player = Player(path)
    node = player.named["garment"]
    primitive = player.json["meshes"][player.nodes[node]["mesh"]]["primitives"][0]
    source = player.read(primitive["attributes"]["_POINT"])[:, 0].astype(int)
    return player, clip.caches[0].positions[:, source], node


def cloth_at(player: Player, node: int, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of a skinned, morphed mesh, from the specification."""
    world, weights = player.worlds(time)
    mesh = player.json["meshes"][player.nodes[node]["mesh"]]
    (primitive,), skin = mesh["primitives"], player.json["skins"][player.nodes[node]["skin"]]
    a = {name: player.read(i) for name, i in primitive["attributes"].items()}
    points, normals = a["POSITION"].copy(), a["NORMAL"].copy()
    for w, target in zip(weights, primitive.get("targets", ())):
        if w:
            points += w * player.read(target["POSITION"])
            normals += w * player.read(target["NORMAL"])
    inverse = player.read(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    bones = np.array([world[j] for j in skin["joints"]]) @ inverse
    blend = np.einsum("nk,nkab->nab", a["WEIGHTS_0"], bones[a["JOINTS_0"].astype(int)])
    turned = np.einsum("nab,nb->na", blend[:, :3, :3], normals)
    return np.einsum("nab,nb->na", blend[:, :3, :3], points) + blend[:, :3, 3], turned


def test_glb_shows_the_cloth_in_every_frame(dressed: Clip, tmp_path: Path) -> None:
    path = tmp_path / "walk.glb"
    report = save(dressed, path, tolerance=BOUND)
    (told,), (cache,) = report["cloth"], dressed.caches
    assert told["frames"] == len(cache) and told["max_error_m"] <= BOUND and report["bytes"] == path.stat().st_size
    player, ours, node = exact(dressed, path)
    around = incidence(cache.positions[0].astype(float), cache.triangles)
    primitive = player.json["meshes"][player.nodes[node]["mesh"]]["primitives"][0]
    source = player.read(primitive["attributes"]["_POINT"])[:, 0].astype(int)
    for k in range(0, len(cache), 3):
        points, normals = cloth_at(player, node, cache.times[k])
        assert np.linalg.norm(points - ours[k], axis=1).max() <= told["max_error_m"] + 1e-5
        wanted = mesh_normals(around, cache.positions[k][None])[0][source]
        cosine = (normals * wanted).sum(axis=1) / np.linalg.norm(normals, axis=1)
        assert np.percentile(cosine, 5) > 0.95
    rough = save(dressed, tmp_path / "rough.glb", tolerance=0.03)
    assert rough["cloth"][0]["max_error_m"] <= 0.03 and rough["bytes"] < report["bytes"]
    assert hasattr(vt.load(path), "skin_coord")  # and the figure comes back


def test_glb_is_clean_and_three_agrees(dressed: Clip, tmp_path: Path, referee: Path) -> None:
    path = tmp_path / "walk.glb"
    told = save(dressed, path)["cloth"][0]
    unmoved = tmp_path / "still.glb"
    save(replace(dressed, motion=None, caches=(replace(dressed.caches[0], times=[0.0],
         positions=dressed.caches[0].positions[:1]),)), unmoved)  # fmt: skip
    assert_clean([path, unmoved], referee)
    if not (referee / "node_modules" / "three").is_dir():
        pytest.skip("three is missing: run `make referees`")
    _, ours, _ = exact(dressed, path)
    times = dressed.caches[0].times
    at = [0, 5, len(times) - 2]
    script = Path(__file__).with_name("cloth_three.mjs")
    done = subprocess.run(
        [shutil.which("node") or "node", str(script), str(path), "garment", json.dumps([float(times[k]) for k in at])],
        capture_output=True, text=True, timeout=60, env={**os.environ, "REFEREE": str(referee)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for k, row in zip(at, json.loads(done.stdout)):
        off = np.linalg.norm(np.array(row).reshape(-1, 3) - ours[k], axis=1).max()
        assert off <= told["max_error_m"] + 1e-4


@pytest.mark.parametrize("form", ["x3d", "x3dv", "x3dj", "wrl"])
def test_scenes_lead_the_cloth_and_come_back(dressed: Clip, tmp_path: Path, form: str) -> None:
    path = tmp_path / f"walk.{form}"
    told = save(dressed, path, tolerance=BOUND)["cloth"][0]
    (cache,) = dressed.caches
    assert told["max_error_m"] <= BOUND and told["keys"] <= len(cache)
    again = vt.load(path)
    shape = next(s for s in again.skin if s.points is not None)
    assert np.array_equal(shape.triangles, cache.triangles) and "garment" in shape.name
    assert dressed.motion is not None
    points = played(again, fps=dressed.motion.fps, target=shape.name)
    assert points.shape == cache.positions.shape
    assert np.linalg.norm(points - cache.positions, axis=2).max() <= BOUND + 1e-5
    assert not [f for f in vt.check(path) if f.severity in ("error", "warning")]
    save(again, tmp_path / f"again.{form}")
    twice = vt.load(tmp_path / f"again.{form}")
    assert np.abs(played(twice, fps=12.0, target=shape.name) - points).max() < 1e-6


def test_older_scenes_say_that_they_lose_it(dressed: Clip, tmp_path: Path) -> None:
    lost = save(dressed, tmp_path / "old.wrl", hanim="1.1")["lost"]
    assert any("moving clothes (garment)" in line for line in lost)
    assert any("tshirt" in line for line in save(dressed, tmp_path / "walk.bvh")["lost"])
    baked = save(dressed, tmp_path / "both.x3d", bake=True, tolerance=0.005)
    assert baked["cloth"][0]["max_error_m"] <= 0.005 and baked["baked"]["max_error_m"] <= 0.005


def test_xite_shows_the_cloth(dressed: Clip, browser, referee: Path, tmp_path: Path) -> None:
    path, (cache,) = tmp_path / "walk.x3d", dressed.caches
    save(dressed, path)
    fractions = [0.0, 0.25, 0.5, 1.0]
    with page_of(browser, referee) as page:
        names = ["hanim_walk", "hanim_garment_point", "hanim_garment_coords"]
        found = np.array(page.page.evaluate(PLAY, [path.read_text(), fractions, names]))
        assert not complaints({"messages": page.said}), page.said
    for fraction, points in zip(fractions, found):
        at = fraction * (len(cache) - 1)
        k = min(int(at), len(cache) - 2)
        expected = cache.positions[k] + (cache.positions[k + 1] - cache.positions[k]) * (at - k)
        assert np.linalg.norm(points - expected, axis=1).max() <= BOUND + 1e-4


def test_usd_has_samples(dressed: Clip, tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd")
    from pxr import UsdGeom

    told = save(dressed, tmp_path / "walk.usdc", tolerance=BOUND)["cloth"][0]
    stage, (cache,) = usd.Stage.Open(str(tmp_path / "walk.usdc")), dressed.caches
    (prim,) = [p for p in stage.Traverse() if p.GetName() == "garment" and p.IsA(UsdGeom.Mesh)]
    points = UsdGeom.Mesh(prim).GetPointsAttr()
    assert dressed.motion is not None and len(points.GetTimeSamples()) == told["keys"]
    for k in range(len(dressed.motion)):
        now = np.array(points.Get(k * stage.GetTimeCodesPerSecond() / dressed.motion.fps))
        assert np.linalg.norm(now - cache.positions[k], axis=1).max() <= BOUND + 1e-6


def test_a_folder_of_obj_files_is_whole_or_not_there(dressed: Clip, tmp_path: Path) -> None:
    short, folder = still(dressed, 3), tmp_path / "walk.objs"
    report = save(short, folder)
    assert report["frames"] == 3
    assert sorted(p.name for p in folder.iterdir()) == [f"walk_{k:04d}.obj" for k in (1, 2, 3)]
    (cache,), n = dressed.caches, len(dressed.body.skin.rest)
    mesh = vt.load(folder / "walk_0002.obj")
    assert np.abs(mesh.vertices[n:] - cache.positions[1]).max() < 1e-6
    assert np.array_equal(mesh.triangles[-len(cache.triangles) :], cache.triangles + n)
    motion = dressed.motion
    assert motion is not None
    body = vt.deformer("linear", dressed.body)(vt.joint_matrices(dressed.body.skeleton, motion)[1])
    assert np.abs(mesh.vertices[:n] - body).max() < 1e-5
    save(still(dressed, 2), folder)
    assert len(list(folder.iterdir())) == 2  # in place of the older ones
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(VitruvianError, match="something else"):
        save(short, folder)
    broken = replace(short, deformer="no such")
    with pytest.raises(VitruvianError):
        write_sequence(broken, tmp_path / "none.objs")
    with pytest.raises(VitruvianError, match="expected 14 frames"):
        longer = replace(dressed, caches=(replace(cache, times=cache.times[:3], positions=cache.positions[:3]),))
        write_sequence(replace(longer, motion=replace(motion, rotation=np.tile(motion.rotation[:1], (14, 1, 1)),
                       translation=np.zeros((14, 3)), loop=False)), tmp_path / "none.objs")  # fmt: skip
    assert sorted(p.name for p in tmp_path.iterdir()) == ["walk.objs"]


def test_the_cache_file_comes_back_bit_for_bit(dressed: Clip, tmp_path: Path) -> None:
    path = tmp_path / "walk.cache.npz"
    save(dressed, path)
    ((again,), (cache,)) = vt.load(path), dressed.caches
    for name in ("positions", "times", "triangles", "uv", "uv_triangles"):
        assert np.array_equal(getattr(again, name), getattr(cache, name)), name
    assert (again.name, again.color, again.closing) == (cache.name, cache.color, cache.closing)
    assert np.array_equal(again.weights.weight, cache.weights.weight) and again.positions.dtype == np.float32
    for wrong, said in (("positions_0.npy", "positions_0"), ("head.npy", "without `head`")):
        bad = tmp_path / "bad.cache.npz"
        with zipfile.ZipFile(path) as old, zipfile.ZipFile(bad, "w") as new:
            for item in old.namelist():
                if item != wrong:
                    new.writestr(item, old.read(item))
        with pytest.raises(FileError, match=said):
            read_caches(bad)
    bad.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(FileError):
        read_caches(bad)
    with pytest.raises(VitruvianError, match="found none"):
        write_caches((), bad)
    with pytest.raises(VitruvianError, match="cache.npz"):
        write_caches(dressed.caches, tmp_path / "a.npz")


def test_a_recorded_page_moves_the_cloth(dressed: Clip, browser, tmp_path: Path) -> None:
    from vitruvian.show.recording import record

    (cache,), motion = dressed.caches, dressed.motion
    assert motion is not None
    thirty = replace(motion, fps=30.0)
    clip = replace(dressed, motion=thirty, caches=(replace(cache, times=np.arange(len(cache)) / 30),))
    assert record(clip, tmp_path / "walk.html")["frames"] == len(motion)
    with opened(browser, (tmp_path / "walk.html").as_uri()) as page:
        pause(page)
        page.wait_for_timeout(100)
        frame = page.evaluate("vitruvian.time * 30")  # between two frames, as often as not
        k, now = int(frame), np.array(page.evaluate("vitruvian.positions('garment')")).reshape(-1, 3)
        between = cache.positions[k] + (frame - k) * (cache.positions[k + 1] - cache.positions[k])
        assert np.abs(now - between).max() < 5e-3 if k == len(motion) - 1 else np.abs(now - between).max() < 2e-4
        for k in (0, 5, len(motion) - 1):
            scrub(page, k)
            now = np.array(page.evaluate("vitruvian.positions('garment')")).reshape(-1, 3)
            assert np.abs(now - cache.positions[k]).max() < 2e-4


def test_the_command_line_dresses_who_moves(walker: Clip, tmp_path: Path) -> None:
    from vitruvian.formats.garment_file import Kept, write_garment

    body, kept, out = tmp_path / "anna.x3d", tmp_path / "shirt.garment.npz", tmp_path / "anna.glb"
    save(walker.humanoid, body)
    garment = walker.garment
    assert garment is not None
    there = dummy(walker.body)
    write_garment(Kept(garment, there.vertices, there.body.skin.triangles), kept)
    arguments = ["animate", str(body), "walk", "--garment", str(kept), "--tolerance", "3"]
    answer = CliRunner().invoke(app, [*arguments, "-o", str(out), "--json"])
    assert answer.exit_code == 0, answer.output
    told = json.loads(answer.stdout)
    assert told["cloth"][0]["max_error_m"] <= 0.003 == told["cloth"][0]["tolerance_m"]
    assert told["bytes"] == out.stat().st_size and "garment" in Player(out).named
    refused = CliRunner().invoke(app, [*arguments, "-o", str(tmp_path / "a.bvh")])
    assert refused.exit_code and "clothes move in" in str(refused.exception)
    several = CliRunner().invoke(app, [*arguments, "--garment", "skirt", "-o", str(out)])
    assert several.exit_code and "worn alone" in str(several.exception)


def test_matrices_of_a_binding_are_taken_out(dressed: Clip, tmp_path: Path) -> None:
    """A file whose skin was bound in another pose plays the same cloth."""
    skeleton = dressed.body.skeleton
    binding = np.tile(np.eye(4), (len(skeleton), 1, 1))
    binding[:, :3, 3] = [0.1, 0, 0]
    body = replace(dressed.body, skeleton=replace(skeleton, binding=binding))
    path = tmp_path / "bound.glb"
    told = save(replace(dressed, body=body), path)["cloth"][0]
    player, ours, node = exact(dressed, path)
    points, _ = cloth_at(player, node, dressed.caches[0].times[4])
    assert np.linalg.norm(points - ours[4], axis=1).max() <= told["max_error_m"] + 1e-5
    assert pose_matrices(skeleton, skeleton.rotation[None], skeleton.translation[None]).shape[1] == len(skeleton)


def test_pictures_show_the_cloth_as_it_is(dressed: Clip) -> None:
    from vitruvian.show.figure import Figure

    (cache,), n = dressed.caches, len(dressed.body.skin.rest)
    times = [0.0, 4 / 12, 4.5 / 12, cache.times[-1] + 2 / 12]
    bare = list(Figure(replace(dressed, garment=None, caches=())).at(times))
    for time, found, body in zip(times, Figure(dressed).at(times), bare):
        at = time * 12 % (len(cache) - 1)
        a, b = cache.positions[int(at)], cache.positions[int(at) + 1]
        assert np.abs(found.vertices[n:] - (a + (b - a) * (at - int(at)))).max() < 1e-5
        assert np.array_equal(found.vertices[:n], body.vertices) and found.parts[-1].name == "garment"


def test_our_own_reader_plays_what_we_wrote(dressed: Clip, tmp_path: Path) -> None:
    from vitruvian.motion.tracks import motion_of

    told = save(dressed, tmp_path / "walk.glb")["cloth"][0]
    h = vt.load(tmp_path / "walk.glb")
    body, (cache,) = vt.pack(h), dressed.caches
    motion = motion_of(h, body.skeleton)
    assert motion is not None
    m = vt.joint_matrices(body.skeleton, motion)
    known = {d.name for d in body.skin.morphs}
    moved = vt.deformer("linear", body)(m, {k: w for k, w in motion.weights.items() if k in known})
    part = next(p for p in body.skin.parts if p.name == "garment")
    assert part.stop - part.start == len(cache.triangles)
    theirs = body.skin.triangles[part.start : part.stop]
    for k in (0, 3, 7):
        off = np.asarray(moved)[k][theirs] - cache.positions[k][cache.triangles]
        far = np.linalg.norm(off, axis=2)  # an H-Anim displacer turns with one joint, not with those of the arms
        assert np.percentile(far, 95) <= told["max_error_m"] and far.max() < 0.02


def test_several_garments_keep_apart(dressed: Clip, tmp_path: Path) -> None:
    (cache,) = dressed.caches
    fewer = replace(cache, triangles=cache.triangles[:-1], uv_triangles=cache.uv_triangles[:-1])
    second = replace(cache, name="garment-skirt", positions=cache.positions + np.float32(0.02), color=(1, 0, 0))
    several = replace(dressed, caches=(cache, second))
    told = save(several, tmp_path / "two.glb")["cloth"]
    player = Player(tmp_path / "two.glb")
    assert [t["name"] for t in told] == ["garment", "garment-skirt"]
    led = [c["target"]["node"] for c in player.json["animations"][0]["channels"] if c["target"]["path"] == "weights"]
    assert led[-2:] == [player.named["garment"], player.named["garment-skirt"]]
    save(several, tmp_path / "two.x3dv")
    again = vt.load(tmp_path / "two.x3dv")
    own = [s for s in again.skin if s.points is not None]
    assert len(own) == 2 and own[1].material.color == (1.0, 0.0, 0.0)
    moved = [played(again, fps=12.0, target=s.name) for s in own]
    assert np.abs(moved[1] - moved[0] - 0.02).max() < 2 * BOUND
    assert dressed.motion is not None
    twice = [replace(dressed, motion=replace(dressed.motion, name=n)) for n in ("go", "on")]
    twice[1] = replace(twice[1], caches=(fewer,))  # other faces: another shape
    save(twice, tmp_path / "clips.x3d")
    again = vt.load(tmp_path / "clips.x3d")
    own = [s for s in again.skin if s.points is not None]
    assert [len(s.triangles) for s in own] == [len(cache.triangles), len(fewer.triangles)]
    assert {(t.target, t.timer) for t in again.tracks if t.field == "point"} == {
        (own[0].name, "hanim_go"), (own[1].name, "hanim_on")
    }  # fmt: skip


@pytest.mark.parametrize("form", ["wrl", "x3dv"])
def test_castle_reads_it_without_a_warning(dressed: Clip, tmp_path: Path, form: str) -> None:
    if shutil.which("tovrmlx3d") is None:
        pytest.skip("no tovrmlx3d: install Debian's `view3dscene` (apt-get install view3dscene)")
    path = tmp_path / f"walk.{form}"
    save(dressed, path, hanim="200x" if form == "wrl" else "1.0")
    done = subprocess.run(["tovrmlx3d", "--encoding=xml", str(path)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and not done.stderr.strip(), done.stderr
    assert "CoordinateInterpolator" in done.stdout and "hanim_garment_coords" in done.stdout
