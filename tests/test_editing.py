"""Clips put together: identities, seams, what stays on the spot; plots and the command."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from skeletons import figure
from vitruvian.errors import VitruvianError
from vitruvian.motion import editing
from vitruvian.motion.clips import resample
from vitruvian.motion.filters import lowpass
from vitruvian.motion.gait import walk
from vitruvian.motion.idle import idle
from vitruvian.motion.turns import positions, world_rotations
from vitruvian.motion.types import Motion
from vitruvian.show.plots import angle_panels, svg


@pytest.fixture(scope="module")
def body():
    return figure(2)


def places(motion):
    world = world_rotations(motion.skeleton.parents, motion.rotation)
    return positions(motion.skeleton.parents, motion.skeleton.centers, world, motion.translation)


def quickest(motion):
    """Largest step of a joint between neighbours, metres."""
    return np.linalg.norm(np.diff(places(motion), axis=0), axis=-1).max()


def test_reversed_twice_is_the_same(body):
    motion = walk(body)
    again = editing.reverse(editing.reverse(motion))
    assert np.allclose(again.rotation, motion.rotation, atol=1e-12)
    assert np.array_equal(again.translation, motion.translation)


def test_placed_turns_and_moves_everything(body):
    motion = walk(body)
    there = editing.placed(motion, yaw=np.pi / 2, shift=[1.0, 0.0, 2.0])
    was, now = places(motion), places(there)
    assert np.allclose(now, np.stack([was[..., 2] + 1, was[..., 1], -was[..., 0] + 2], axis=-1), atol=1e-9)
    turn = editing.heading(there) - editing.heading(motion)
    assert np.allclose((turn - np.pi / 2 + np.pi) % (2 * np.pi) - np.pi, 0, atol=1e-9)


def test_clips_are_joined_where_the_figure_stands(body):
    """Walking on in another direction: no joint jumps farther than it does in either clip."""
    first = walk(body, fps=60, cycles=2)
    second = editing.placed(walk(body, fps=30, cycles=2), yaw=1.0, shift=[3.0, 0.0, -2.0])
    joined = editing.concatenate([first, second], 0.3)
    assert quickest(joined) < 1.6 * quickest(first)
    assert len(joined) == len(first) + len(resample(editing.replace(second, loop=False), 60)) - 18 and joined.fps == 60
    assert np.allclose(joined.rotation[: len(first) - 18], first.rotation[: len(first) - 18], atol=1e-12)
    way = joined.translation[-1] - joined.translation[0]
    assert abs(np.degrees(np.arctan2(way[0], way[2]))) < 5  # it goes on as it went
    with pytest.raises(VitruvianError, match="of one skeleton"):
        editing.concatenate([first, walk(figure(1))])
    with pytest.raises(VitruvianError, match="at least 8 s"):
        editing.concatenate([first, second], 4.0)


def test_a_mixture_lies_between(body):
    slow, quick = walk(body, speed=1.0), walk(body, speed=1.8)
    assert np.allclose(editing.blend(slow, quick, 0.0).rotation, slow.rotation, atol=1e-9)
    half = editing.blend(slow, quick, 0.5)
    assert half.loop and min(len(slow), len(quick)) <= len(half) <= max(len(slow), len(quick))
    speed = [np.linalg.norm(m.translation[-1] - m.translation[0]) / m.seconds for m in (slow, half, quick)]
    assert speed[0] < speed[1] < speed[2]
    assert quickest(half) <= 1.05 * quickest(quick)


def test_a_piece_becomes_a_loop(body):
    piece = editing.replace(walk(body, fps=60, cycles=2), loop=False)
    rows = np.arange(5, 5 + int(0.9 * len(piece) / 2))
    cut = editing._rows(piece, rows)
    made = editing.looped(cut)
    turn = lambda m: 2 * np.degrees(np.arccos(np.clip(np.abs(np.sum(m.rotation[0] * m.rotation[-1], -1)), 0, 1))).max()  # noqa: E731
    assert made.loop and turn(cut) > 5 and turn(made) < 0.5
    assert abs(made.translation[0, 1] - made.translation[-1, 1]) < 1e-9
    middle = len(cut) // 2
    assert np.allclose(made.rotation[middle], cut.rotation[middle], atol=1e-3)


@pytest.mark.parametrize("loop", [True, False])
def test_on_the_spot_and_back(body, loop):
    motion = editing.replace(walk(body, cycles=3), loop=loop)
    here, path = editing.in_place(motion)
    assert np.ptp(here.translation[:, [0, 2]], axis=0).max() < 0.12 < path[-1, 2]
    assert np.array_equal(here.translation[:, 1], motion.translation[:, 1])
    assert np.allclose(editing.along(here, path).translation, motion.translation, atol=1e-12)


def test_layers_add_what_they_do(body):
    base = walk(body)
    nod = Motion(
        base.skeleton, 30.0, idle(body).rotation[:2].copy(), np.zeros((2, 3)), weights={"smile": np.array([0.0, 1.0])}
    )
    head = base.skeleton.index["skullbase"]
    nod.rotation[0, head] = [0, 0, 0, 1]
    nod.rotation[1] = nod.rotation[0]
    nod.rotation[1, head] = [np.sin(0.1), 0, 0, np.cos(0.1)]
    out = editing.layer(base, nod)
    others = [j for j in range(len(base.skeleton)) if j != head]
    assert np.allclose(out.rotation[:, others], base.rotation[:, others], atol=1e-9)
    turn = 2 * np.arccos(np.abs(np.sum(out.rotation[-1, head] * base.rotation[-1, head])))
    assert turn == pytest.approx(0.2, abs=1e-6) and out.weights["smile"][-1] == 1.0
    assert np.allclose(editing.layer(base, nod, 0.0).rotation, base.rotation, atol=1e-9)


def test_noise_is_filtered_and_the_motion_stays(body):
    clean = walk(body, fps=120, cycles=3)
    rng = np.random.default_rng(2)
    noisy = editing.replace(clean, rotation=clean.rotation + rng.normal(size=clean.rotation.shape) * 0.01)
    smooth = lowpass(noisy, 8.0)
    angle = lambda m: 2 * np.degrees(np.arccos(np.clip(np.abs(np.sum(m.rotation * clean.rotation, -1)), 0, 1)))[20:-20]  # noqa: E731
    assert np.sqrt((angle(smooth) ** 2).mean()) < 0.45 * np.sqrt((angle(noisy) ** 2).mean())
    assert np.abs(np.linalg.norm(smooth.rotation, axis=-1) - 1).max() < 1e-12
    assert lowpass(clean, 60.0) is clean
    with pytest.raises(VitruvianError, match="above 0 Hz"):
        lowpass(clean, 0.0)


def test_angles_are_drawn_against_limits(body):
    import xml.etree.ElementTree as tree

    motion = walk(body)
    panels = angle_panels(motion, ["l_knee"])
    picture = svg(panels, np.arange(len(motion)) / motion.fps, "a <walk>")
    root = tree.fromstring(picture)
    assert "a <walk>" in "".join(root.itertext()) and "l_knee" in "".join(root.itertext())
    lines = [e for e in root if e.tag.endswith("polyline")]
    assert len(lines) == 3 and len(lines[0].get("points").split()) == len(motion)
    with pytest.raises(VitruvianError, match="no joint 'knee'"):
        angle_panels(motion, ["knee"])


def run(*args):
    command = [sys.executable, "-m", "vitruvian", *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


def test_the_command(tmp_path):
    out, plot = tmp_path / "c.bvh", tmp_path / "a.svg"
    args = [
        "clip",
        "walk",
        "--then",
        "walk",
        "--mirror",
        "--loop",
        "--in-place",
        "--fps",
        "60",
        "-o",
        out,
        "--plot",
        plot,
    ]
    done = run(*args, "--joints", "l_knee,r_knee", "--json")
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["fps"] == 60 and facts["loop"] and out.is_file() and plot.read_text().startswith("<svg")
    assert run("clip", "walk").returncode == 2
    bad = run("clip", "walk", "--start", "5", "--stop", "2", "-o", out)
    assert bad.returncode == 2 and bad.stderr.count("\n") == 1 and "trim" in bad.stderr
