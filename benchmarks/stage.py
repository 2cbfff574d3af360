"""The page, the demo's start and the command line's start, as a user meets them."""

from __future__ import annotations

import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

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
    return {
        "name": "vitruvian info on a small file, whole process",
        "ours_s": ours,
        "peer": "python -c 'import numpy'",
        "peer_s": numpy,
        "ratio": ours / numpy,
        "goal": "<= 4",
        "holds": ours <= 4 * numpy,
    }


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
    return {
        "name": f"page, {len(body.skin.rest):,} vertices, software GL, 240x180: {fps:.0f} frames/s",
        "ours_s": 1 / fps,
        "peer": None,
        "peer_s": None,
        "ratio": fps,
        "goal": ">= 30",
        "holds": fps >= 30,
    }


def demo() -> dict:
    """`vitruvian demo` once, from start to exit."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        command = [sys.executable, "-m", "vitruvian", "demo", "--no-open", "--out", folder]
        subprocess.run(command, check=True, capture_output=True)
        taken = time.perf_counter() - begin
    return {
        "name": "vitruvian demo, all files",
        "ours_s": taken,
        "peer": None,
        "peer_s": None,
        "ratio": taken,
        "goal": "<= 60 s",
        "holds": taken <= 60,
    }


def rows(quick: bool = False) -> list[dict]:
    return [start(5 if quick else 15), page(5 if quick else 15), demo()]
