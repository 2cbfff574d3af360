"""Handles in the page: dragged with pointer, finger and keys, held, taken back, saved; none without a server."""

from __future__ import annotations

import json

import numpy as np
import pytest

from capsules import capsule_clip
from pages import opened, pause, positions, wait
from vitruvian.body.kinematics import joint_matrices
from vitruvian.motion.types import Motion
from vitruvian.show.live import show
from vitruvian.show.recording import record


def middle(page, name: str) -> tuple[float, float]:
    box = page.get_by_test_id(f"grip-{name}").bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def drag(page, name: str, x: float, y: float, *, release: bool = True) -> None:
    """Lead a handle so many pixels across the picture."""
    a, b = middle(page, name)
    page.mouse.move(a, b)
    page.mouse.down()
    for part in (0.3, 0.6, 1.0):
        page.mouse.move(a + part * x, b + part * y)
        page.wait_for_timeout(30)
    wait(page, "Object.keys(vitruvian.handles.short).length")
    if release:
        page.mouse.up()
        settled(page)


def settled(page) -> None:
    wait(page, "!vitruvian.handles.dragging")
    steady(page)


def steady(page) -> None:
    """Wait for pictures in which the handles do not move any more, however slowly they are drawn."""
    same, before = 0, None
    for _ in range(100):
        page.wait_for_timeout(60)
        now = [page.evaluate("vitruvian.handles.places"), [middle(page, n) for n in ("l_hand", "pelvis")]]
        same, before = (same + 1 if now == before else 0), now
        if same == 3:
            return
    raise AssertionError("the handles never come to rest")


def place(page, name: str) -> np.ndarray:
    return np.array(page.evaluate(f"vitruvian.handles.places['{name}']"))


def ready(page) -> None:
    """Handles on a figure that stands still, seen from the front."""
    pause(page)
    page.keyboard.press("1")
    page.keyboard.press("@")
    wait(page, "vitruvian.handles.shown.length && !vitruvian.camera.moving && !vitruvian.playing")
    steady(page)


@pytest.fixture
def live(browser):
    clip = capsule_clip(vertices=1500, frames=20)
    with (
        show(clip, open_browser=False, block=False) as window,
        opened(browser, window.url, (900, 640)) as page,
    ):
        ready(page)
        yield page, clip, window


def test_the_body_follows_a_hand_and_every_step_can_be_taken_back(live):
    page, clip, window = live
    assert page.evaluate("vitruvian.handles.shown") == ["l_hand", "r_hand", "l_foot", "r_foot", "head", "pelvis"]
    camera, before, first = page.evaluate("vitruvian.camera.position"), place(page, "l_hand"), positions(page)
    x, y = middle(page, "l_hand")
    drag(page, "l_hand", 60, -90)
    after = place(page, "l_hand")
    assert after[0] - before[0] > 0.1 and after[1] - before[1] > 0.15  # to the right and up in the picture
    assert np.abs(np.array(middle(page, "l_hand")) - [x + 60, y - 90]).max() < 4  # under the pointer
    np.testing.assert_allclose(page.evaluate("vitruvian.camera.position"), camera, atol=0.01)  # it did not turn
    stage = window._server.showing.stage.frame["capsules"]  # the server has the same pose
    j = clip.body.skeleton.index["l_wrist"]
    there = stage.joints[j, :3, :3] @ clip.body.skeleton.centers[j] + stage.joints[j, :3, 3]
    np.testing.assert_allclose(there, after, atol=2e-3)
    drag(page, "l_hand", -20, 50)
    second = place(page, "l_hand")
    page.keyboard.press("Escape")
    settled(page)
    np.testing.assert_allclose(place(page, "l_hand"), after, atol=1e-4)
    page.keyboard.press("Escape")
    settled(page)
    np.testing.assert_allclose(positions(page), first, atol=1e-5)
    for _ in range(2):
        page.keyboard.press("Control+Shift+z")
    settled(page)
    np.testing.assert_allclose(place(page, "l_hand"), second, atol=1e-4)
    page.keyboard.press("0")  # reset of the pose
    settled(page)
    np.testing.assert_allclose(positions(page), first, atol=1e-5)
    assert not window._server.showing.stage.actors["capsules"].turns


def test_escape_while_dragging_and_what_is_out_of_reach(live):
    page, _, _ = live
    first = positions(page)
    drag(page, "r_hand", -300, -120, release=False)
    wait(page, "vitruvian.handles.short.r_hand > 0.1")
    page.wait_for_timeout(150)
    assert "mm short" in page.get_by_test_id("grip-r_hand").text_content()
    assert page.locator("#grips line").count() == 1
    page.keyboard.press("Escape")
    page.mouse.up()
    settled(page)
    np.testing.assert_allclose(positions(page), first, atol=1e-5)
    assert page.locator("#grips line").count() == 0 and page.get_by_test_id("undo").is_disabled()


def test_held_hands_and_feet_stay_while_the_pelvis_sinks(live):
    page, clip, _ = live
    page.get_by_test_id("grip-l_hand").click()
    assert page.evaluate("vitruvian.handles.held") == ["l_hand"]
    assert page.get_by_test_id("grip-l_hand").get_attribute("aria-pressed") == "true"
    before = {n: place(page, n) for n in ("l_hand", "r_hand", "l_foot", "r_foot", "pelvis")}
    drag(page, "pelvis", 8, 40)
    assert place(page, "pelvis")[1] < before["pelvis"][1] - 0.06
    for name in ("l_hand", "l_foot", "r_foot"):
        assert np.linalg.norm(place(page, name) - before[name]) < 4e-3, name
    assert np.linalg.norm(place(page, "r_hand") - before["r_hand"]) > 0.05
    with page.expect_download() as waiting:
        page.keyboard.press("e")
    saved = json.loads(waiting.value.path().read_text())
    skeleton = clip.body.skeleton
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (1, len(skeleton), 1))
    for name, (x, y, z, angle) in ((n, v) for n, v in saved.items() if len(v) == 4):
        turns[0, skeleton.index[name]] = [*(np.sin(angle / 2) * np.array([x, y, z])), np.cos(angle / 2)]
    shift = np.array([saved["humanoid_root.translation"]])
    m = joint_matrices(skeleton, Motion(skeleton, 30.0, turns, shift))[0]
    j = skeleton.index["l_talocrural"]
    np.testing.assert_allclose(m[j, :3, :3] @ skeleton.centers[j] + m[j, :3, 3], place(page, "l_foot"), atol=1e-3)
    page.keyboard.press("Control+z")
    settled(page)
    np.testing.assert_allclose(place(page, "pelvis"), before["pelvis"], atol=1e-4)
    page.get_by_test_id("grip-l_hand").click()
    assert page.evaluate("vitruvian.handles.held") == []


def test_handles_show_while_it_stands_and_keys_move_them(live):
    page, _, _ = live
    page.get_by_test_id("grip-head").focus()
    before = place(page, "head")
    page.keyboard.press("Shift+ArrowDown")
    settled(page)
    lower = place(page, "head") - before
    assert -0.06 < lower[1] < -0.03 and abs(lower[0]) < 0.01
    page.keyboard.press("Enter")
    assert page.evaluate("vitruvian.handles.held") == ["head"]
    page.get_by_test_id("play").click()
    wait(page, "vitruvian.playing && vitruvian.handles.shown.length === 0")
    assert page.locator("#grips").is_hidden()
    pause(page)
    wait(page, "vitruvian.handles.shown.length")
    assert page.evaluate("vitruvian.handles.held") == []  # they were of another moment
    page.keyboard.press("@")
    wait(page, "!vitruvian.handles.on")
    assert page.locator("#grips").is_hidden()


def test_a_finger_drags_handles(browser):
    with (
        show(capsule_clip(vertices=1500, frames=2), open_browser=False, block=False) as window,
        opened(browser, window.url, (420, 700), has_touch=True, is_mobile=True) as page,
    ):
        ready(page)
        before, (x, y) = place(page, "l_hand"), middle(page, "l_hand")
        box = page.get_by_test_id("grip-l_hand").bounding_box()
        assert box["width"] >= 40
        touch = page.context.new_cdp_session(page)
        send = lambda kind, points: touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})  # noqa: E731
        send("touchStart", [{"x": x, "y": y}])
        for part in (0.3, 0.6, 1.0):
            send("touchMove", [{"x": x + 30 * part, "y": y - 60 * part}])
            page.wait_for_timeout(40)
        send("touchEnd", [])
        settled(page)
        after = place(page, "l_hand") - before
        assert after[0] > 0.05 and after[1] > 0.1


def test_a_page_without_server_has_no_handles(browser, tmp_path):
    record(capsule_clip(vertices=800, frames=3), tmp_path / "clip.html")
    with opened(browser, (tmp_path / "clip.html").as_uri()) as page:
        assert page.get_by_test_id("handles").is_hidden()
        page.keyboard.press("@")
        page.wait_for_timeout(100)
        assert page.evaluate("vitruvian.handles") is None and page.locator("#grips").is_hidden()
