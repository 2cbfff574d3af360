"""X_ITE in one headless browser page that loads scene after scene from text."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from playwright.sync_api import Page, Route

# A page that the browser takes for one in the background draws and ticks once a second.
FLAGS = [
    "--no-sandbox",
    "--disable-background-timer-throttling",
    "--disable-renderer-backgrounding",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]
PAGE = """<!doctype html><body style="margin:0"><link rel=icon href="data:,"><script src='x_ite.js'></script>
<x3d-canvas style='width:200px;height:200px;display:block'></x3d-canvas>"""
# Nodes by type, each once; of each humanoid its name and, with a pose, the matrices that move its skin, column major.
LOAD = """async ([text, pose]) => {
  await new Promise(resolve => X3D(resolve))
  const browser = document.querySelector('x3d-canvas').browser, T = X3D.X3DConstants
  const scene = await browser.createX3DFromString(text)
  await browser.replaceWorld(scene)
  const nodes = {}, joints = {}, figures = [], seen = new Set(), stack = [...scene.rootNodes].reverse()
  while (stack.length) {
    const node = stack.pop()
    if (!node || seen.has(node)) continue
    seen.add(node)
    const type = node.getNodeTypeName()
    nodes[type] = (nodes[type] || 0) + 1
    if (type === 'HAnimHumanoid') figures.push(node)
    if (type === 'HAnimJoint') (joints[node.name] ??= []).push(node)
    if (type === 'TimeSensor' && pose) node.enabled = false
    for (const field of node.getFieldDefinitions()) {
      if (field.accessType === T.inputOnly || field.accessType === T.outputOnly) continue
      if (field.dataType === T.SFNode) stack.push(node[field.name])
      else if (field.dataType === T.MFNode) stack.push(...node[field.name])
    }
  }
  const result = {nodes}
  if (pose) for (const name in joints)
    for (const joint of joints[name]) joint.rotation = new X3D.SFRotation(...(pose[name] ?? [0, 0, 1, 0]))
  for (let k = 0; k < 2; ++k) await browser.nextFrame()
  result.figures = figures.map((humanoid) => {
    const own = humanoid.getValue(), matrices = {}
    if (pose && humanoid.skinCoord && own.jointMatricesArray) own.jointNodes.forEach((joint, k) =>
      matrices[joint._name.getValue()] ??= Array.from(own.jointMatricesArray.slice(k * 32, k * 32 + 16)))
    return {name: humanoid.name, matrices}
  })
  return result
}"""


PARSE = """async text => {
  await new Promise(resolve => X3D(resolve))
  const browser = document.querySelector('x3d-canvas').browser, start = performance.now()
  const scene = await browser.createX3DFromString(text)
  const taken = performance.now() - start
  scene.dispose()
  return taken
}"""


@dataclass
class Browser:
    page: Page
    said: list[str]

    def load(self, text: str, pose: dict[str, list[float]] | None = None) -> dict[str, Any]:
        """What X_ITE makes of a file's text, and its `messages`."""
        self.said.clear()
        return {**self.page.evaluate(LOAD, [text, pose]), "messages": list(self.said)}

    def parse(self, text: str) -> float:
        """Milliseconds that X_ITE takes from a file's text to its scene, which is not shown."""
        return self.page.evaluate(PARSE, text)


@contextmanager
def page_of(browser: Any, referee: Path) -> Iterator[Browser]:
    """A page of a browser with X_ITE, whose files come from `referee`; nothing leaves the machine."""
    page = browser.new_page(viewport={"width": 400, "height": 400})
    said: list[str] = []
    page.on("console", lambda m: said.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda e: said.append(str(e)))
    page.route("**/*", lambda route: answer(route, referee))
    page.goto("http://xite.test/page.html")
    try:
        yield Browser(page, said)
    finally:
        page.close()


@contextmanager
def xite(referee: Path, chromium: str) -> Iterator[Browser]:
    """The same in a browser of its own, where no test runner has one."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as p:
        browser = p.chromium.launch(executable_path=chromium, args=FLAGS)
        with page_of(browser, referee) as page:
            yield page
        browser.close()


def answer(route: Route, referee: Path) -> None:
    address = route.request.url.removeprefix("http://xite.test/")
    path = referee / "node_modules" / "x_ite" / "dist" / address
    if address == "page.html":
        route.fulfill(body=PAGE, content_type="text/html")
    elif path.is_file():
        route.fulfill(path=path)
    else:
        route.abort()


def complaints(result: dict) -> list[str]:
    """Messages of the browser, those about pictures and addresses that are not at hand subtracted."""
    unable = ("Error loading image", "Failed to load resource")
    return [m for m in result["messages"] if not any(u in m for u in unable)]


if __name__ == "__main__":  # what X_ITE says of files: tests/xite.py REFEREE FILE...
    import sys

    with xite(Path(sys.argv[1]), "/usr/bin/chromium") as b:
        for name in sys.argv[2:]:
            print(name, json.dumps(b.load(Path(name).read_text("utf-8"), {}))[:1500])
