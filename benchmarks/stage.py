"""What a Stage costs, the page, the demo's start and the command line's start, as a user meets them."""

from __future__ import annotations

import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from _rows import main, row

SLOW_GL = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
BODY = (
    '<X3D version="4.0" profile="Immersive"><Scene><HAnimHumanoid DEF="h" name="h" version="2.0" loa="0">'
    '<HAnimJoint DEF="h_humanoid_root" name="humanoid_root" containerField="skeleton" center="0 0.9 0"/>'
    '<HAnimJoint USE="h_humanoid_root" containerField="joints"/></HAnimHumanoid></Scene></X3D>'
)


def start(repeats: int) -> dict:
    """Whole process of `vitruvian info` on a small file beside importing NumPy, interleaved."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "small.x3d"
        path.write_text(BODY)
        commands = [[sys.executable, "-m", "vitruvian", "info", str(path)], [sys.executable, "-c", "import numpy"]]
        times: list[list[float]] = [[], []]
        for _ in range(repeats):
            for command, taken in zip(commands, times, strict=True):
                begin = time.perf_counter()
                subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
                taken.append(time.perf_counter() - begin)
    ours, numpy = (statistics.median(t) for t in times)
    name = "vitruvian info on a small file, whole process"
    return row(name, ours, "python -c 'import numpy'", numpy, ours / numpy, "<= 4", ours <= 4 * numpy)


def page(seconds: float) -> dict:
    """Frames a second of the page that plays the built-in person, software GL, 240x180; the median second counts."""
    from playwright.sync_api import sync_playwright

    import vitruvian as vt
    from vitruvian.show.recording import record

    humanoid = vt.person()
    body = vt.pack(humanoid)
    clip = vt.Clip(humanoid, body, vt.walk(body.skeleton, cycles=2))
    browser_path = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        path = Path(folder) / "walk.html"
        record(clip, path)
        browser = play.chromium.launch(executable_path=browser_path, args=SLOW_GL)
        tab = browser.new_page(viewport={"width": 240, "height": 180})
        tab.goto(path.as_uri())
        while not tab.evaluate("Boolean(window.vitruvian && window.vitruvian.actors.length)"):
            time.sleep(0.2)  # the page's content policy forbids waiting for an expression
        time.sleep(6)  # shaders are compiled and the page has found its quality
        drawn = []
        for _ in range(int(seconds)):
            drawn.append(float(tab.evaluate("window.vitruvian.fps")))
            time.sleep(1)
        browser.close()
    fps = statistics.median(drawn)
    name = f"page, {len(body.skin.rest):,} vertices, software GL, 240x180: {fps:.0f} frames/s"
    return row(name, 1 / fps, None, None, fps, ">= 30", fps >= 30)


def runtime(seconds: float) -> list[dict]:
    """A tick of a Stage beside the same pose and deformer called directly, taking turns; then many actors beside few."""
    import numpy as np
    from skin import figure

    from vitruvian.body.kinematics import pose_matrices
    from vitruvian.body.rotations import from_vector
    from vitruvian.body.types import Body, Morph
    from vitruvian.deform.deformer import deformer
    from vitruvian.motion.types import Motion
    from vitruvian.stage.actor import Actor
    from vitruvian.stage.stage import Stage

    frames, rng = 50, np.random.default_rng(1)
    plain = figure(13_000, joints=146)
    spots = np.arange(0, 13_000, 25, dtype=np.int32)
    faces = tuple(Morph(f"m{k}", spots, rng.normal(size=(len(spots), 3)), 3 * (k % 2)) for k in range(52))
    whole = replace(plain, skin=replace(plain.skin, morphs=faces))  # joints and displacers as the built-in person has

    def motion(body: Body) -> Motion:
        turns = from_vector(rng.normal(scale=0.25, size=(frames, len(body.skeleton), 3)))
        return Motion(body.skeleton, 60.0, turns, rng.normal(scale=0.02, size=(frames, 3)), loop=True)

    def stage_of(body: Body, actors: int) -> Stage:
        return Stage([Actor(f"a{k}", body, motion=motion(body), options={"threads": 1}) for k in range(actors)])

    def beside(body: Body, normals: bool) -> tuple[float, float, float]:
        stage, run = stage_of(body, 1), deformer("log", body, follow=False, threads=1)
        own, shift, at = stage.actors["a0"].motion, body.skeleton.translation[None], 0
        assert own is not None

        def direct() -> object:
            nonlocal at
            at = (at + 1) % frames
            some = slice(at, at + 1)
            points = run(pose_matrices(body.skeleton, own.rotation[some], shift, root=own.translation[some])[0])
            return run.normals(points) if normals else points

        def staged() -> object:
            posed = stage.step()["a0"]
            return posed.normals if normals else posed.vertices

        return _pairs(direct, staged, seconds)

    peer, found = "pose, deformer directly", []
    for title, normals in (("", False), (", with normals", True)):
        a, b, more = beside(whole, normals)
        name = f"Stage, full body of 13k vertices{title}, log"
        found.append(row(name, b, peer, a, 1 + more / a, "<= 1.05", more <= 0.05 * a))
    a, b, more = beside(plain, False)
    name = f"Stage adds {more * 1e6:.0f} us to 13k vertices without displacers"
    found.append(row(name, b, peer, a, more * 1e6, "<= 50", more <= 50e-6))
    a, b, _ = _pairs(stage_of(plain, 4).step, stage_of(plain, 16).step, seconds)
    each, few = b / 16, a / 4
    name = "Stage, 16 actors of 13k vertices, each"
    found.append(row(name, each, "4 actors, each", few, each / few, "<= 1.2", each <= 1.2 * few))
    return found


def _pairs(one: Callable[[], object], two: Callable[[], object], seconds: float) -> tuple[float, float, float]:
    """Medians of two tasks that take turns, and the median of how much longer the second took each time.

    Processor time: both run in one thread, and what else the machine does is not theirs.
    """
    one(), two()
    taken = []
    stop = time.perf_counter() + seconds
    while time.perf_counter() < stop or len(taken) < 20:
        start = time.thread_time()
        one()
        middle = time.thread_time()
        two()
        taken.append((middle - start, time.thread_time() - middle))
    a, b = ([t[k] for t in taken] for k in (0, 1))
    return statistics.median(a), statistics.median(b), statistics.median(t[1] - t[0] for t in taken)


def demo() -> dict:
    """`vitruvian demo` once, from start to exit."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        command = [sys.executable, "-m", "vitruvian", "demo", "--no-open", "--out", folder]
        subprocess.run(command, check=True, capture_output=True)
        taken = time.perf_counter() - begin
    return row("vitruvian demo, all files", taken, None, None, taken, "<= 60 s", taken <= 60)


def rows(quick: bool = False) -> list[dict]:
    return [*runtime(1 if quick else 4), start(5 if quick else 15), page(5 if quick else 15), demo()]


if __name__ == "__main__":
    main(__doc__, rows)
