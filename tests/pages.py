"""Opening the page in a browser and driving it, for tests."""

from __future__ import annotations

import time
from contextlib import contextmanager

import numpy as np

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]


@contextmanager
def opened(browser, url, size=(520, 440), **options):
    """A page that shows something; nothing may be written to its console and nothing fetched from elsewhere."""
    page = browser.new_page(viewport={"width": size[0], "height": size[1]}, **options)
    complaints, addresses = [], []
    page.on("console", lambda m: complaints.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda e: complaints.append(str(e)))
    page.on("request", lambda r: addresses.append(r.url))
    try:
        page.goto(url)
        wait(page, "vitruvian.actors.length && vitruvian.fps > 0")
        yield page
    finally:
        page.close()
    drawn = [c for c in complaints if "GPU stall" not in c and "GL Driver Message" not in c]  # the software renderer
    assert not drawn, drawn
    base = url.split("#")[0]
    base = base.rsplit("/", 1)[0] + "/" if base.startswith("http") else base
    assert all(a.startswith((base, "blob:", "data:", "ws://127.0.0.1")) for a in addresses), addresses


def wait(page, condition, seconds=30):
    """Poll by `evaluate`, which the page's policy against `eval` allows."""
    end = time.monotonic() + seconds
    while not page.evaluate(f"Boolean(window.vitruvian && ({condition}))"):
        assert time.monotonic() < end, f"never: {condition}; {page.locator('#notice').text_content()}"
        page.wait_for_timeout(50)


def pause(page):
    """A page that has shown a picture knows whether it plays."""
    if page.evaluate("vitruvian.playing"):
        page.get_by_test_id("play").click()
    wait(page, "!vitruvian.playing")


def scrub(page, frame):
    page.get_by_test_id("timeline").evaluate(
        "(e, n) => { e.value = n; e.dispatchEvent(new Event('input')); e.dispatchEvent(new Event('change')); }", frame
    )
    wait(page, f"Math.abs(vitruvian.time * 30 - {frame}) < 1e-6 && !vitruvian.playing")


def slide(page, name, value):
    page.get_by_test_id(name).evaluate(
        "(e, v) => { e.value = v; e.dispatchEvent(new Event('input')); e.dispatchEvent(new Event('change')); }", value
    )
    page.wait_for_timeout(60)


def find(page, joint):
    page.keyboard.press("/")
    page.locator("#joint-filter").fill(joint)
    page.get_by_test_id(f"joint-{joint}").locator("> .row").click()


def positions(page):
    return np.array(page.evaluate("vitruvian.positions()")).reshape(-1, 3)
