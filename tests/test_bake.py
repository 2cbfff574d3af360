"""Skins baked into points: what viewers without skinning show is what our deformer makes, within the tolerance."""

from __future__ import annotations

import subprocess
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

import vitruvian as vt
from scene_figure import typed
from vitruvian.body.kinematics import pose_matrices
from vitruvian.cli import app
from vitruvian.deform.deformer import deformer
from vitruvian.errors import VitruvianError
from vitruvian.formats import registry
from vitruvian.formats.bake import bake_skin, reduced
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Material, Segment, Shape
from vitruvian.motion.live import baked
from vitruvian.motion.tracks import frames_to_write
from vitruvian.motion.types import Motion
from vitruvian.stage.clip import Clip
from xite import complaints, page_of

FRACTIONS = (0.0, 0.13, 0.5, 0.77, 1.0)
# the points of the skin and how large the drawn figure is, at some fractions of the clip
PLAY = """async ([text, fractions, names]) => {
  await new Promise(resolve => X3D(resolve))
  const browser = document.querySelector('x3d-canvas').browser, X = X3D
  const scene = await browser.createX3DFromString(text)
  await browser.replaceWorld(scene)
  const [clock, mover, coords] = names.map(n => scene.getNamedNode(n))
  clock.enabled = false
  const out = []
  for (const f of fractions) {
    mover.set_fraction = f
    for (let k = 0; k < 2; ++k) await browser.nextFrame()
    out.push(Array.from(coords.point, p => [p.x, p.y, p.z]))
  }
  return out
}"""


def bendy(frames: int = 80, deformer: str = "log") -> Clip:
    """An arm of two joints that bends with a skin, a rigid box in a Segment."""
    rng = np.random.default_rng(1)
    h = Humanoid("Bend", loa=-1)
    root = Joint("humanoid_root", np.array([0, 0.8, 0]))
    arm, lower = Joint("l_shoulder", np.array([0.2, 1.4, 0])), Joint("l_elbow", np.array([0.5, 1.4, 0]))
    root.joints, arm.joints = [arm], [lower]
    u = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    x = np.linspace(0.2, 0.8, 16)
    ring = np.stack([np.cos(u), np.sin(u)], -1) * 0.05
    points = np.concatenate([np.stack([np.full(12, a), 1.4 + ring[:, 0], ring[:, 1]], -1) for a in x])
    i, j = np.arange(12), (np.arange(12) + 1) % 12
    faces = [np.concatenate([np.stack([k + i, k + j, k + 12 + j], -1), np.stack([k + i, k + 12 + j, k + 12 + i], -1)])
             for k in range(0, 180, 12)]  # fmt: skip
    share = np.clip((points[:, 0] - 0.4) / 0.2, 0, 1)
    every = np.arange(len(points), dtype=np.int32)
    arm.skin_coord_index, arm.skin_coord_weight = every, 1 - share
    lower.skin_coord_index, lower.skin_coord_weight = every, share
    h.skeleton, h.skin_coord = [root], points
    h.skin = [Shape("sleeve", np.concatenate(faces).astype(np.int32), material=Material("cloth", (0.2, 0.4, 0.8)))]
    box = Shape("box", np.array([[0, 1, 2]], np.int32), rng.uniform(size=(3, 3)))
    root.segments = [Segment("sacrum", shapes=[box])]
    body = vt.pack(h)
    t = np.linspace(0, 2 * np.pi, frames, endpoint=False)
    turn = np.tile([0.0, 0, 0, 1], (frames, 3, 1))
    for joint, axis, angle in ((1, 2, 0.6 * np.sin(t)), (2, 1, 1 - np.cos(t))):
        turn[:, joint, axis], turn[:, joint, 3] = np.sin(angle / 2), np.cos(angle / 2)
    return Clip(
        h, body, Motion(body.skeleton, float(frames), turn, np.zeros((frames, 3)), loop=True, name="wave"), deformer
    )


def exact(clip: Clip) -> np.ndarray:
    """(F,V,3) what the deformer makes of every frame that a file holds."""
    rotation, shift, _ = frames_to_write(clip.motion)
    made = deformer(clip.deformer, clip.body)(pose_matrices(clip.body.skeleton, rotation, shift))
    return np.asarray(made, np.float64)[:, : len(clip.humanoid.skin_coord)]


@pytest.mark.parametrize(("form", "kind"), [(".x3d", "linear"), (".wrl", "log"), (".x3dv", "volume"), (".json", "log")])
def test_read_back_the_points_are_the_deformers(tmp_path, form, kind):
    clip, path = bendy(deformer=kind), tmp_path / f"bend{form}"
    report = registry.save(clip, path, bake=True, tolerance=0.002)
    facts = report["baked"]
    assert facts["frames"] == 81 and 3 < facts["keys"] < 50 and facts["bytes"] == path.stat().st_size
    again = vt.load(path)
    points = baked(again, fps=80.0)
    assert points.shape == (81, 192, 3)
    worst = np.linalg.norm(points - exact(clip), axis=-1).max()
    assert worst <= 0.002 and worst == pytest.approx(facts["max_error_m"], abs=2e-6)
    assert not any(len(j.skin_coord_index) for j in again.joints())
    assert {t.target for t in again.tracks if t.field == "rotation"} == {"l_shoulder", "l_elbow"}  # what is rigid
    assert not [f for f in vt.check(path) if f.rule in ("M06", "M20") or f.severity == "error"]


def test_a_smaller_tolerance_needs_more_keys_and_a_larger_one_fewer():
    clip = bendy()
    counts = [bake_skin(clip, tolerance=t)[2]["keys"] for t in (1e-5, 3e-3, 1e-2, 0.5)]
    assert counts[0] == 81 and counts[0] > counts[1] > counts[2] > counts[3] >= 2, counts


@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.sampled_from([1e-4, 1e-3, 0.05]))
def test_no_frame_is_further_off_than_the_tolerance(seed, frames, tolerance):
    rng = np.random.default_rng(seed)
    steps = rng.normal(scale=rng.choice([0.0, 1e-4, 0.01]), size=(frames, 7, 3)).cumsum(axis=0)
    keys, values, count, worst = reduced(iter(steps), 7, tolerance)
    assert count == frames and keys[0] == 0 and worst <= tolerance
    at = np.arange(frames) / max(frames - 1, 1)
    between = np.stack([np.interp(at, keys, v) for v in values.reshape(len(keys), -1).T], -1)
    assert np.linalg.norm(between.reshape(steps.shape) - steps, axis=-1).max() <= tolerance * (1 + 1e-9)


def test_a_body_that_stands_still_has_its_pose_and_no_interpolator(tmp_path):
    clip = replace(bendy(), motion=None)
    clip.humanoid.joint("l_elbow").rotation = np.array([0, 1, 0, 1.0])
    path = tmp_path / "still.x3d"
    registry.save(replace(clip, body=vt.pack(clip.humanoid)), path, bake=True)
    again = vt.load(path)
    assert not [t for t in again.tracks if t.field == "point"]
    assert again.skin_coord[-1, 2] < -0.2


def test_displacers_of_segments_are_baked_into_their_points(tmp_path):
    clip = bendy()
    segment = clip.humanoid.joint("humanoid_root").segments[0]
    segment.displacers = [Displacer("lift_action", np.array([1], np.int32), np.array([[0, 0.5, 0.0]]))]
    body = vt.pack(clip.humanoid)
    moving = replace(clip.motion, weights={"lift_action": np.linspace(0, 1, 80)})
    path = tmp_path / "lift.wrl"
    registry.save(Clip(clip.humanoid, body, moving), path, bake=True)
    again = vt.load(path)
    points = baked(again, fps=80.0, target="sacrum")
    lift = points[:, 1, 1] - points[0, 1, 1]
    assert np.abs(lift[:80] - 0.5 * np.linspace(0, 1, 80)).max() < 0.001 and abs(lift[80]) < 0.001
    assert not again.displacers()


def test_contour_bodies_become_one_skin(tmp_path):
    h = vt.contours(vt.person(loa=1, hair="none", outfit="body suit"), density=0.3)
    body = vt.pack(h)
    walk = vt.walk(body.skeleton)
    clip = Clip(h, body, walk, "contours")
    path = tmp_path / "contours.x3d"
    registry.save(clip, path, bake=True, tolerance=0.01)
    points = baked(vt.load(path), fps=walk.fps)
    rotation, shift, _ = frames_to_write(walk)
    ours = np.asarray(deformer("contours", body)(pose_matrices(body.skeleton, rotation, shift)))
    assert points.shape == ours.shape and np.linalg.norm(points - ours, axis=-1).max() <= 0.01


def test_what_cannot_be_baked_is_refused_in_one_line(tmp_path):
    clip = bendy()
    with pytest.raises(VitruvianError, match="1.1 has no skin"):
        registry.save(clip, tmp_path / "a.wrl", bake=True, hanim="1.1")
    with pytest.raises(VitruvianError, match="tolerance"):
        registry.save(clip, tmp_path / "a.wrl", bake=True, tolerance=0.0)
    rigid = typed(1)
    with pytest.raises(VitruvianError, match="expected a skin"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        registry.save(replace(rigid, skin=[], skin_coord=np.zeros((0, 3))), tmp_path / "a.wrl", bake=True)
    assert not list(tmp_path.iterdir())


def test_the_command_line_bakes(tmp_path):
    source, target = tmp_path / "bend.x3d", tmp_path / "bend.wrl"
    registry.save(bendy(), source)
    answer = CliRunner().invoke(app, ["convert", str(source), str(target), "--bake", "--tolerance", "5"])
    assert answer.exit_code == 0 and "baked 192 points" in answer.output, answer.output
    answer = CliRunner().invoke(app, ["convert", str(source), str(tmp_path / "bend.glb"), "--bake"])
    assert answer.exit_code and "expected an X3D, VRML or USD file" in str(answer.exception)


@pytest.mark.parametrize("form", ["x3d", "wrl"])
def test_xite_shows_our_points_at_any_time(browser, referee, tmp_path, form):
    clip, path = bendy(), tmp_path / f"bend.{form}"
    registry.save(clip, path, bake=True, tolerance=0.001)
    names = ["hanim_wave", "hanim_humanoid_point", "hanim_skin_coords"]
    ours = exact(clip)
    with page_of(browser, referee) as page:
        found = np.array(page.page.evaluate(PLAY, [path.read_text(), FRACTIONS, names]))
        assert not complaints({"messages": page.said}), page.said
    for fraction, points in zip(FRACTIONS, found):
        at = fraction * 80
        k = min(int(at), 79)
        expected = ours[k] + (ours[k + 1] - ours[k]) * (at - k)
        assert np.linalg.norm(points - expected, axis=1).max() <= 0.0015
    assert np.ptp(found[:, -1], axis=0).max() > 0.2


@pytest.mark.parametrize("form", ["wrl", "x3dv"])
def test_castle_reads_it_without_a_warning(tmp_path, form):
    import shutil

    if shutil.which("tovrmlx3d") is None:
        pytest.skip("no tovrmlx3d: install Debian's `view3dscene` (apt-get install view3dscene)")
    path = tmp_path / f"bend.{form}"
    registry.save(bendy(), path, bake=True, hanim="200x" if form == "wrl" else "1.0")
    done = subprocess.run(["tovrmlx3d", "--encoding=xml", str(path)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and not done.stderr.strip(), done.stderr
    assert "CoordinateInterpolator" in done.stdout and "hanim_skin_coords" in done.stdout
