"""Self-deforming files in X_ITE, headless Chromium, software GL: the whole, and what of it is X_ITE's own drawing.

`python benchmarks/live.py [--quick]` prints the rows. All joints that the script knows turn in each frame. Each row is one
window: frames a second in the median of all frames, in the median of the quietest `RUN_LENGTH` frames in a row, which a
busy machine disturbs less, and in the best tenth; `cpu_ms` are milliseconds of processor time for each frame in the page's
process and in the one that draws; `load` is the machine's load (1 minute) beside it.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from pathlib import Path

from _rows import main, row

SLOW_GL = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
DIST = Path(__file__).resolve().parent.parent / ".referee" / "node_modules" / "x_ite" / "dist"
EMPTY = "<X3D profile='Immersive' version='4.0'><Scene><Viewpoint/></Scene></X3D>"
GOAL = 30.0  # frames a second
RUN_LENGTH = 15  # frames
LOAD = """async (source) => {
  const browser = document.querySelector('x3d-canvas').browser;
  await browser.replaceWorld(await browser.createX3DFromString(source));
  for (let k = 0; k < 5; ++k) await browser.nextFrame();
}"""
RUN = """async ([move, seconds]) => {
  const browser = document.querySelector('x3d-canvas').browser, times = [];
  let script = null;
  try { script = browser.currentScene.getNamedNode('hanim_ContourScript'); } catch (e) {}
  const fields = script ? Array.from(script.getFieldDefinitions(), (f) => f.name) : [];
  const joints = fields.filter((name) => /^hanim_.*Def$/.test(name)); // all that it knows
  for (let began = performance.now(), last = began; last - began < 1000 * seconds;) {
    if (move) for (const joint of joints)
      script[joint] = new X3D.SFRotation(1, 0, 0, 0.1 + 0.1 * Math.sin(times.length / 5));
    await browser.nextFrame();
    const now = performance.now();
    times.push(now - last);
    last = now;
  }
  return times.slice(1);
}"""
# The script alone: fields and events stood in for by plain arrays, no browser of scenes.
ALONE = """([code, fields, names]) => {
  class MFVec3f extends Array { setValue(v) { this.length = v.length / 3; this[1] = { z: v[5] }; } }
  const given = Object.keys(fields), bench = `
    initialize();
    let count = 0;
    const start = performance.now();
    while (performance.now() - start < 500) {
      for (let j = 0; j < J; ++j) turn(j, [1, 0, 0, 0.3 + 0.3 * Math.sin(count)]);
      eventsProcessed();
      ++count;
    }
    return (performance.now() - start) / count;`;
  const make = new Function('MFVec3f', 'MFInt32', 'SFVec3f', ...given, ...names, code + bench);
  return make(MFVec3f, Array, Array, ...given.map((k) => fields[k]), ...names.map(() => null));
}"""


def rows(quick: bool = False) -> list[dict[str, object]]:
    import numpy as np
    from playwright.sync_api import sync_playwright

    import vitruvian as vt
    from vitruvian.formats import registry
    from vitruvian.formats.live import SCRIPT, live_scene
    from vitruvian.modeling.lighter import lightened

    body = vt.contours(vt.person(gender=1, loa=2), density=0.65)
    bare = lightened(body, 100)
    bare.skin, bare.skin_coord = [], np.zeros((0, 3))
    for joint in bare.joints():
        joint.skin_coord_index, joint.skin_coord_weight = np.zeros(0, np.int32), np.zeros(0)
    small = lightened(vt.contours(vt.person(gender=1, loa=2), density=0.4), 800)
    scenes = {
        "contours alone": (bare, "x3d"),
        "contours and a light rest": (lightened(body, 2000), "x3d"),
        "1,900 points in all": (small, "x3d"),
        "contours alone, VRML97": (bare, "wrl"),
    }
    sizes = [(240, 180)] if quick else [(240, 180), (640, 480)]
    out: list[dict[str, object]] = []
    path = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        browser = play.chromium.launch(executable_path=path, args=SLOW_GL)
        for size in sizes:
            out.append(measured(browser, EMPTY, "nothing", size, False, True, quick))
        for name, (humanoid, encoding) in scenes.items():
            live = live_scene(humanoid, encoding=encoding)
            file = Path(folder) / f"live.{encoding}"
            registry.write_scene(live.scene, file)
            points = f"{live.report['points']} + {live.report['soft_points']} + {live.report['rigid_points']} points"
            text = file.read_text()
            script = live.scene.defs()[SCRIPT]
            fields = {f.name: np.asarray(f.value).tolist() for f in script.interface if f.access == "initializeOnly"}
            events = [f.name for f in script.interface if f.access == "outputOnly"]
            code = re.sub(r"^\w+:", "", script.text or script.fields["url"][0])
            tab = browser.new_page()
            alone = tab.evaluate(ALONE, [code, fields, events])
            tab.close()
            title = f"{name}, {points}: script alone, a pose"
            out.append(row(title, alone / 1000, "allowed", 0.002, 2 / alone, ">= 1", alone <= 2))
            for size in sizes:
                for smooth in (True, False):
                    for move in (False, True):
                        out.append(measured(browser, text, f"{name}, {points}", size, move, smooth, quick))
        browser.close()
    return out


def measured(
    browser, source: str, name: str, size: tuple[int, int], move: bool, smooth: bool, quick: bool
) -> dict[str, object]:
    width, height = size
    tab = browser.new_page(viewport={"width": width, "height": height})
    style = f"width:{width}px;height:{height}px;display:block"
    html = f"<body style='margin:0'><script src='x_ite.js'></script><x3d-canvas antialiased='{str(smooth).lower()}' "
    html += f"style='{style}'></x3d-canvas>"

    def answer(route) -> None:
        file = DIST / route.request.url.removeprefix("http://xite.test/")
        if file.name == "page.html":
            route.fulfill(body=html, content_type="text/html")
        elif file.is_file():
            route.fulfill(path=file)
        else:
            route.abort()

    tab.route("**/*", answer)
    tab.goto("http://xite.test/page.html")
    tab.evaluate(LOAD, source)
    tab.evaluate(RUN, [move, 0.5 if quick else 1])  # until its code is compiled
    before = processor()
    each = tab.evaluate(RUN, [move, 2 if quick else 5])
    times = sorted(each)
    parts = [sorted(each[k : k + RUN_LENGTH]) for k in range(max(1, len(each) - RUN_LENGTH + 1))]
    after = processor()
    tab.close()
    best = times[: max(1, len(times) // 10)]
    frames = len(times) + 1
    rate = 1000 / times[len(times) // 2]
    title = f"{name}, {width}x{height}, {'moving' if move else 'still'}{'' if smooth else ', not antialiased'}"
    return row(
        f"{title}: {rate:.1f} frames/s",
        1 / rate,
        "allowed",
        1 / GOAL,
        rate / GOAL,
        ">= 1",
        rate >= GOAL,
        frames_s=rate,
        quiet_frames_s=1000 / min(p[len(p) // 2] for p in parts),
        best_frames_s=1000 * len(best) / sum(best),
        load=os.getloadavg()[0],
        cpu_ms={k: round((after[k] - before[k]) / frames * 1000, 1) for k in after},
    )


def processor() -> dict[str, float]:
    """Seconds of processor time of our browser's processes so far, by kind."""
    tick, found = os.sysconf("SC_CLK_TCK"), {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state = (folder / "stat").read_text().rsplit(")", 1)[1].split()
            command = (folder / "cmdline").read_text()
        except OSError:
            continue
        found[int(folder.name)] = (int(state[1]), (int(state[11]) + int(state[12])) / tick, command)
    mine = {os.getpid()}
    for _ in range(6):
        mine |= {pid for pid, (parent, _, _) in found.items() if parent in mine}
    out = {"page": 0.0, "drawing": 0.0}
    for pid in mine:
        _, seconds, command = found.get(pid, (0, 0.0, ""))
        if "--type=renderer" in command:
            out["page"] += seconds
        elif "--type=gpu-process" in command:
            out["drawing"] += seconds
    return out


if __name__ == "__main__":
    main(__doc__, rows)
