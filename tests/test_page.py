"""The page in a real browser: it draws, plays, poses, and deforms as the kernels do."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

import vitruvian as vt
from capsules import about, capsule_body, capsule_clip, stride
from pages import find, opened, pause, positions, scrub, slide, wait
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.types import Body, Weights
from vitruvian.deform.deformer import deformer
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.motion.types import Motion
from vitruvian.show.live import show
from vitruvian.show.recording import record
from vitruvian.stage.clip import Clip, Mesh

FINDINGS = [
    {
        "rule": "limits",
        "severity": "warning",
        "where": "Joint l_elbow",
        "line": 12,
        "message": "<b>llimit</b> above ulimit",
    },
    {"rule": "name", "severity": "error", "where": "Segment x", "message": "unknown name", "fix": "rename it"},
]


def choose(page, name):
    page.get_by_test_id("deformer").select_option(name)
    page.wait_for_timeout(80)


def awkward() -> Clip:
    """Binding, scale, weights that do not sum to one, points without weights, both kinds of displacers."""
    body = capsule_body(vertices=900)
    w, n = body.skin.weights, len(body.skeleton)
    weight = w.weight.copy()
    weight[: w.row[200]] *= 0.6
    keep = np.ones(len(weight), bool)
    keep[w.row[300] : w.row[320]] = False
    weights = Weights.from_pairs(len(w), w.vertex[keep], w.joint[keep], weight[keep])
    scale = np.ones((n, 3))
    scale[6], scale[4] = [1.2, 0.8, 1.1], [1.1, 1.1, 1.1]
    binding = np.tile(np.eye(4), (n, 1, 1))
    binding[9, :3, 3] = [0.02, 0.0, -0.03]
    skeleton = replace(body.skeleton, scale=scale, binding=binding)
    morphs = tuple(replace(m, weight=0.7) for m in body.skin.morphs)
    body = Body("awkward", skeleton, replace(body.skin, weights=weights, morphs=morphs))
    motion = replace(stride(capsule_body(vertices=900), 6), skeleton=skeleton)
    return Clip(Humanoid(name="awkward"), body, motion)


@pytest.mark.parametrize("make", [lambda: capsule_clip(vertices=1500, frames=6), awkward], ids=["capsules", "awkward"])
def test_the_page_deforms_as_the_kernels_do(browser, tmp_path, make):
    clip = make()
    record(clip, tmp_path / "clip.html")
    matrices = joint_matrices(clip.body.skeleton, clip.motion)
    with opened(browser, (tmp_path / "clip.html").as_uri()) as page:
        pause(page)
        for name in ("linear", "dual-quaternion", "log"):
            choose(page, name)
            for frame in (0, 3):
                scrub(page, frame)
                wanted = deformer(name, clip.body)(matrices[frame])
                error = np.abs(positions(page) - wanted).max()
                print(f"{name}, frame {frame}: largest difference {error:.1e} m")
                assert error < 1e-4


def test_poses_and_displacers_set_by_hand_are_what_forward_kinematics_gives(browser):
    clip = capsule_clip(vertices=1500, frames=6)
    with show(clip, open_browser=False, block=False) as window, opened(browser, window.url) as page:
        pause(page)
        scrub(page, 2)
        find(page, "l_elbow")
        slide(page, "slider-l_elbow-x", -60)
        slide(page, "slider-l_elbow-y", 30)
        slide(page, "displacer-chin_action", 0.5)
        skeleton = clip.body.skeleton
        rotation = clip.motion.rotation[2:3].copy()
        x, y = about("x", np.radians([-60.0]))[0], about("y", np.radians([30.0]))[0]
        rotation[0, skeleton.index["l_elbow"]] = [  # the product x y
            x[0] * y[3], x[3] * y[1], x[0] * y[1], x[3] * y[3]
        ]  # fmt: skip
        posed = Motion(skeleton, 30, rotation, clip.motion.translation[2:3])
        matrices = joint_matrices(skeleton, posed)
        run = deformer("log", clip.body)
        wanted = run(matrices, {"chin_action": np.array([0.5])})[0]
        assert np.abs(positions(page) - wanted).max() < 1e-4
        choose(page, "hybrid")  # computed by the server, from the same pose
        page.wait_for_timeout(400)
        wanted = deformer("hybrid", clip.body)(matrices, {"chin_action": np.array([0.5])})[0]
        assert np.abs(positions(page) - wanted).max() < 1e-4
        choose(page, "log")
        with page.expect_download() as saved:
            page.get_by_test_id("export-pose").click()
        pose = json.loads(saved.value.path().read_text())
        axis, angle = np.array(pose["l_elbow"][:3]), pose["l_elbow"][3]
        np.testing.assert_allclose([*(axis * np.sin(angle / 2)), np.cos(angle / 2)], rotation[0, 6], atol=1e-4)


def test_undo_and_redo_go_through_every_step_and_limits_hold(browser, tmp_path):
    record(capsule_clip(vertices=800, frames=6), tmp_path / "clip.html")
    with opened(browser, (tmp_path / "clip.html").as_uri()) as page:
        pause(page)
        scrub(page, 0)
        undo, redo = page.get_by_test_id("undo"), page.get_by_test_id("redo")
        assert undo.is_disabled() and redo.is_disabled()
        states = [positions(page)]
        find(page, "l_elbow")
        bend = page.get_by_test_id("slider-l_elbow-x")
        assert abs(float(bend.get_attribute("min")) - np.degrees(-2.6)) < 0.06 and float(bend.get_attribute("max")) == 0
        slide(page, "slider-l_elbow-x", -100)
        states.append(positions(page))
        slide(page, "slider-r_hip-z", 25)
        states.append(positions(page))
        slide(page, "displacer-grow_action", 1)
        states.append(positions(page))
        page.locator("#reset-pose").click()
        page.wait_for_timeout(60)
        np.testing.assert_array_equal(positions(page), states[0])
        states.append(states[0])
        for state in states[-2::-1]:
            undo.click()
            page.wait_for_timeout(60)
            np.testing.assert_allclose(positions(page), state, atol=1e-6)
        assert undo.is_disabled()
        for state in states[1:]:
            page.keyboard.press("Control+Shift+Z")
            page.wait_for_timeout(60)
            np.testing.assert_allclose(positions(page), state, atol=1e-6)
        assert redo.is_disabled()


def test_time_can_be_played_stepped_scrubbed_and_stopped_at_the_end(browser, tmp_path):
    made = record(capsule_clip(vertices=800), tmp_path / "clip.html")
    assert made["frames"] == 36 and made["bytes"] < 1_500_000
    with opened(browser, (tmp_path / "clip.html").as_uri()) as page:
        assert page.evaluate("vitruvian.playing && vitruvian.recorded")
        page.keyboard.press("Space")
        wait(page, "!vitruvian.playing")
        scrub(page, 30)
        forward = positions(page)
        page.keyboard.press("ArrowRight")
        wait(page, "vitruvian.frame === 31")
        page.keyboard.press("Home")
        wait(page, "vitruvian.frame === 0")
        scrub(page, 30)
        np.testing.assert_array_equal(positions(page), forward)
        page.keyboard.press("ArrowLeft")
        wait(page, "vitruvian.frame === 29")
        page.keyboard.press("l")
        page.locator("#speed").select_option("4")
        page.get_by_test_id("play").click()
        wait(page, "!vitruvian.playing && vitruvian.frame === 35")
        with pytest.raises(Exception, match="assign|read only|Cannot"):
            page.evaluate("() => { 'use strict'; window.vitruvian.frame = 3; }")


def pixels(page, clip=None):
    from io import BytesIO

    from PIL import Image

    return np.asarray(Image.open(BytesIO(page.screenshot(clip=clip))).convert("RGB")).astype(int)


def settled(page):
    """The page's pixels once they stand still: a busy machine draws late."""
    now = pixels(page)
    for _ in range(20):
        page.wait_for_timeout(250)
        last, now = now, pixels(page)
        if np.array_equal(now, last):
            break
    return now


def test_something_is_drawn_and_every_view_differs(browser, tmp_path):
    record(capsule_clip(vertices=1500), tmp_path / "clip.html", findings=FINDINGS)
    with opened(browser, (tmp_path / "clip.html").as_uri(), (1100, 760), color_scheme="dark") as page:
        pause(page)
        scrub(page, 5)
        seen = [settled(page)]
        middle = seen[0][200:560, 420:680]
        assert middle.std() > 20 and (middle[..., 0] - middle[..., 2]).max() > 30  # a figure with the colour of skin
        for key in ("2", "3", "4", "1", "b", "w", "m", "t", "p"):
            page.keyboard.press(key)
            page.wait_for_timeout(900 if key in "1234" else 250)
            seen.append(settled(page))
            others = (np.abs(seen[-1] - seen[-2]).sum(axis=2) > 20).sum()
            assert others > (40 if key == "p" else 500), key  # two pins are small
        assert page.get_by_test_id("findings").get_attribute("open") is not None  # one of them is an error
        items = page.get_by_test_id("findings").locator("li")
        assert items.count() == 2 and "<b>llimit</b>" in items.first.text_content()  # text, not markup
        items.first.click()
        assert page.evaluate("vitruvian.selected") == "l_elbow"
        with page.expect_download() as saved:
            page.get_by_test_id("export").click()
        assert saved.value.path().read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_the_weight_map_has_the_colours_of_its_bar(browser, tmp_path):
    record(capsule_clip(vertices=6000), tmp_path / "clip.html")
    with opened(browser, (tmp_path / "clip.html").as_uri(), (700, 560)) as page:
        pause(page)
        scrub(page, 0)
        find(page, "vt6")
        page.keyboard.press("Escape")
        page.keyboard.press("w")
        page.keyboard.press("Escape")
        page.keyboard.press("1")
        page.wait_for_timeout(900)
        shown = settled(page)
        assert page.locator("#legend-name").text_content() == "Weight of vt6"
        bar = page.locator("#legend-ramp").bounding_box()
        colours = pixels(page, bar)[3]
        found = []
        for joint in ("l_shoulder", "l_knee", "vt6"):
            x, y = page.evaluate(f"vitruvian.screen('{joint}')")
            colour = shown[int(y), int(x)]
            distance = np.abs(colours - colour).sum(axis=1)
            found.append((joint, distance.argmin() / (len(colours) - 1), int(distance.min())))
        print(found)
        values = {joint: value for joint, value, _ in found}
        assert all(distance < 24 for *_, distance in found)
        # the front of the shoulder's capsule hangs on vt6 by 0.7, the top of the trunk's by 0.3, the knee not at all
        assert values["l_knee"] < 0.01 and abs(values["l_shoulder"] - 0.7) < 0.02 and abs(values["vt6"] - 0.3) < 0.02


def test_a_page_comes_back_when_its_server_does(browser):
    clip = capsule_clip(vertices=800)
    with show(clip, open_browser=False, block=False) as window:
        page = browser.new_page(viewport={"width": 320, "height": 240})
        page.goto(window.url)
        wait(page, "vitruvian.connected && vitruvian.actors.length")
        port = int(window.url.split(":")[2].split("/")[0])
        token = window._server.token
    wait(page, "!vitruvian.connected")
    assert "Connection lost" in page.locator("#notice").text_content()
    from vitruvian.show.actors import actors_of
    from vitruvian.show.live import Window, serve
    from vitruvian.show.server import Server, Showing

    again = Server(Showing(actors_of([clip])), port, token=token)
    with Window(again, serve(again)):
        wait(page, "vitruvian.connected")
        page.close()


def test_two_things_and_a_mesh_without_joints_are_shown(browser):
    box = Mesh(
        np.array([[x, y, z] for x in (0.5, 0.7) for y in (0.0, 0.2) for z in (0.0, 0.2)]),
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4]],
    )
    with (
        show(capsule_clip(vertices=800), box, open_browser=False, block=False) as window,
        opened(browser, window.url) as page,
    ):
        assert [a["joints"] for a in page.evaluate("vitruvian.actors")] == [21, 0]
    with show(box, open_browser=False, block=False) as window, opened(browser, window.url) as page:
        page.keyboard.press("w")
        page.keyboard.press("d")
        assert page.evaluate("vitruvian.actors.length") == 1


def test_a_long_clip_of_a_full_skeleton_stays_below_20_megabytes(tmp_path):
    clip = capsule_clip(joints=146, vertices=20_000, frames=994)
    shake = (
        np.random.default_rng(3).normal(size=clip.motion.rotation.shape) * 0.02
    )  # nothing repeats, as in captured motion
    motion = replace(clip.motion, rotation=clip.motion.rotation + shake)
    made = record(replace(clip, motion=motion), tmp_path / "long.html")
    print(f"994 frames, 146 joints, 20,000 vertices: {made['bytes'] / 1e6:.1f} MB")
    assert made["bytes"] < 20e6


def test_a_figure_in_coarser_detail_lies_on_the_same_skin_and_stands_whole(browser, tmp_path):
    clip = walking_person()
    record(clip, tmp_path / "person.html")
    with opened(browser, (tmp_path / "person.html").as_uri(), (240, 180)) as page:
        wait(page, "vitruvian.drawn < 0.8 * vitruvian.actors[0].triangles")  # software drawing, small canvas, playing
        drawn, all_of_them = page.evaluate("[vitruvian.drawn, vitruvian.actors[0].triangles]")
        assert 0.3 * all_of_them < drawn
        pause(page)
        scrub(page, 12)
        assert page.evaluate("vitruvian.drawn") == all_of_them
        wanted = deformer("log", clip.body)(joint_matrices(clip.body.skeleton, clip.motion))[12]
        assert np.abs(positions(page) - wanted).max() < 1e-4


def test_levels_of_detail_by_hand_while_nothing_plays(browser, tmp_path):
    clip = walking_person()
    record(clip, tmp_path / "person.html")
    with opened(browser, (tmp_path / "person.html").as_uri(), (700, 520)) as page:
        pause(page)
        scrub(page, 12)
        every = page.evaluate("vitruvian.actors[0].triangles")
        seen, pictures = [], []
        for _ in range(5):
            page.keyboard.press("$")
            page.wait_for_timeout(120)
            seen.append(page.evaluate("vitruvian.drawn"))
            pictures.append(page.get_by_test_id("canvas").screenshot())
        all_of_them, fewer, few, far, again = seen
        assert all_of_them == again == every and every > 1.2 * fewer and fewer > 1.3 * few and few > 1.5 * far > 500, (
            seen
        )
        assert len(set(pictures[:4])) == 4
        page.keyboard.press("$")
        page.keyboard.press("$")
        page.keyboard.press("m")
        page.keyboard.press("w")
        scrub(page, 20)
        assert page.evaluate("vitruvian.drawn") == fewer and page.evaluate("vitruvian.mode") == "weights"
        wanted = deformer("log", clip.body)(joint_matrices(clip.body.skeleton, clip.motion))[20]
        assert np.abs(positions(page) - wanted).max() < 1e-4  # what scripts read is always all of it


def walking_person() -> Clip:
    humanoid = vt.person()
    body = vt.pack(humanoid)
    return Clip(humanoid, body, vt.walk(body.skeleton))


def test_the_built_in_person_fits_into_four_megabytes_and_shows_its_face(browser, tmp_path):
    made = record(walking_person(), tmp_path / "person.html")
    print(f"the built-in person walking: {made['bytes'] / 1e6:.1f} MB")
    assert made["bytes"] < 4e6
    with opened(browser, (tmp_path / "person.html").as_uri(), (480, 480)) as page:
        pause(page)
        page.keyboard.press("4")
        page.wait_for_timeout(900)
        x, y = page.evaluate("vitruvian.screen('skullbase')")
        assert 120 < x < 360 and 120 < y < 420


@pytest.mark.parametrize(
    "make", [lambda: capsule_clip(joints=146, vertices=21_500), walking_person], ids=["20k", "person"]
)
def test_a_full_figure_keeps_playing_smoothly(browser, referee, tmp_path, make):
    """30 pictures a second; on a machine too slow for that, half as many again as three.js alone draws of the same clip."""
    clip = make()
    record(clip, tmp_path / "clip.html")
    vt.save(clip, tmp_path / "clip.glb")
    best = plain = 0.0
    for _ in range(4):  # the best look of each counts: what else the machine does is not the page's
        with opened(browser, (tmp_path / "clip.html").as_uri(), (240, 180)) as page:
            page.wait_for_timeout(6000)
            rate, quality, actors = page.evaluate("[vitruvian.fps, vitruvian.quality, vitruvian.actors]")
        best = max(best, rate)
        if best >= 30:
            break
        plain = max(plain, plain_rate(browser, referee, tmp_path / "clip.glb"))
    print(f"{best} pictures per second, three.js {plain:.1f}, {actors[0]['vertices']} vertices, {quality}")
    assert best >= 30 or best >= 1.5 * plain


def plain_rate(browser, referee, glb) -> float:
    """Pictures a second of a page that plays a GLB with nothing but three.js."""
    page = browser.new_page(viewport={"width": 240, "height": 180})
    files = {"/": Path(__file__).parent / "stranger_three.html", "/clip.glb": glb}

    def serve(route):
        path = urlsplit(route.request.url).path
        route.fulfill(path=files.get(path) or referee / "node_modules" / path[1:])

    try:
        page.route("**/*", serve)
        page.goto("http://stranger/")
        page.wait_for_function("window.pictures > 2")
        page.wait_for_timeout(1000)
        return page.evaluate("""new Promise((done) => {
            const start = performance.now(), first = pictures;
            setTimeout(() => done((1000 * (pictures - first)) / (performance.now() - start)), 4000);
        })""")
    finally:
        page.close()
