"""The explorer of the page: levels of articulation, joint details, Sites, displacers, findings, in a real browser."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from capsules import about, capsule_body, capsule_clip
from pages import find, opened, pause, positions, scrub, slide, wait
from test_page import awkward, pixels, walking_person
from vitruvian.body.kinematics import joint_matrices, move
from vitruvian.deform.deformer import deformer
from vitruvian.hanim import tables
from vitruvian.motion.types import Motion
from vitruvian.show.actors import actors_of
from vitruvian.show.live import Window, serve, show
from vitruvian.show.recording import record
from vitruvian.show.server import Server, Showing

FINDINGS = [
    {"rule": "S01", "severity": "error", "where": "joint l_elbow", "line": 12, "message": "<b>15</b> w", "fix": "cut"},
    {"rule": "D05", "severity": "warning", "where": "HAnimSite joe_skull_tip", "line": 3, "message": "no segment"},
    {"rule": "D01", "severity": "warning", "where": "Displacer grow_action", "line": 9, "message": "beyond the mesh"},
    {"rule": "M11", "severity": "note", "where": "TimeSensor Clock", "line": 77, "message": "it never runs"},
    {"rule": "M01", "severity": "error", "where": "humanoid x", "line": 1, "message": "not in joints (r_knee): it stays"},
]  # fmt: skip


def folded(skeleton, level):
    """For each joint the joint it follows at that level, from the standard's tables alone."""
    out = []
    for j, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents.tolist())):
        known = tables.canonical(name, "joint")
        kept = parent < 0 or known is None or tables.joints()[known].loa <= level
        out.append(j if kept else out[parent])
    return out


def choose_level(page, level):
    page.get_by_test_id("loa").select_option(str(level))
    page.wait_for_timeout(80)


def told(page, showing, wanted):
    """Wait until the server has heard of these displacers."""
    for _ in range(200):
        if showing.displaced["capsules"] == wanted:
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"the server knows {showing.displaced['capsules']}, expected {wanted}")


def select(page, joint):
    """Select a joint by its row, and leave the panel open."""
    find(page, joint)
    wait(page, f"vitruvian.selected === '{joint}'")


@pytest.mark.parametrize("make", [lambda: capsule_clip(vertices=1500, frames=6), awkward], ids=["capsules", "awkward"])
def test_at_each_level_the_skin_follows_the_kept_ancestors(browser, tmp_path, make):
    clip = make()
    record(clip, tmp_path / "clip.html")
    skeleton = clip.body.skeleton
    matrices = joint_matrices(skeleton, clip.motion)
    with opened(browser, (tmp_path / "clip.html").as_uri()) as page:
        pause(page)
        page.get_by_test_id("deformer").select_option("linear")
        scrub(page, 3)
        labels = page.get_by_test_id("loa").locator("option").all_text_contents()
        for level in (0, 1, 2, 3):
            follow = folded(skeleton, level)
            kept = [n for j, n in enumerate(skeleton.names) if follow[j] == j]
            assert labels[level] == f"LOA {level} · {len(kept)} joint{'s' * (len(kept) > 1)}"
            if page.get_by_test_id("loa").locator("option").nth(level).is_disabled():
                assert len(kept) == len(skeleton)
                continue
            choose_level(page, level)
            wanted = deformer("linear", clip.body)(matrices[3][follow])
            error = np.abs(positions(page) - wanted).max()
            print(f"level {level}: {len(kept)} joints, largest difference {error:.1e} m")
            assert error < 1e-4
            assert page.evaluate("vitruvian.bones") == kept
            rows = page.locator("#joints [role=treeitem]")
            assert {e.removeprefix("joint-") for e in rows.evaluate_all("a => a.map(e => e.dataset.testid)")} == set(
                kept
            )
        choose_level(page, max(i for i in range(5) if page.get_by_test_id("loa").locator("option").nth(i).is_enabled()))
        assert np.abs(positions(page) - deformer("linear", clip.body)(matrices[3])).max() < 1e-4


def test_a_joint_turned_at_a_lower_level_turns_what_follows_it_and_hidden_turns_wait(browser):
    clip = capsule_clip(vertices=1500, frames=6)
    skeleton, motion = clip.body.skeleton, clip.motion
    with show(clip, open_browser=False, block=False) as window, opened(browser, window.url) as page:
        pause(page)
        page.get_by_test_id("deformer").select_option("linear")
        scrub(page, 2)
        select(page, "l_carpometacarpal_2")
        slide(page, "slider-l_carpometacarpal_2-x", 60)
        turned = positions(page)
        choose_level(page, 1)
        assert page.evaluate("vitruvian.selected") == "l_wrist"  # the one that is kept
        follow = folded(skeleton, 1)
        plain = joint_matrices(
            skeleton, replace(motion, rotation=motion.rotation[2:3], translation=motion.translation[2:3])
        )
        assert np.abs(positions(page) - deformer("linear", clip.body)(plain[:, follow])[0]).max() < 1e-4
        slide(page, "slider-l_elbow-x", -60)
        page.wait_for_timeout(80)
        rotation = motion.rotation[2:3].copy()
        rotation[0, skeleton.index["l_elbow"]] = about("x", np.radians([-60.0]))[0]
        posed = joint_matrices(skeleton, Motion(skeleton, 30, rotation, motion.translation[2:3]))
        assert np.abs(positions(page) - deformer("linear", clip.body)(posed[:, follow])[0]).max() < 1e-4
        page.get_by_test_id("undo").click()
        choose_level(page, 2)  # all there are
        page.keyboard.press("a")  # by the key, down
        wait(page, "vitruvian.level === 1")
        choose_level(page, 2)
        np.testing.assert_allclose(positions(page), turned, atol=1e-6)
        page.get_by_test_id("deformer").select_option("hybrid")
        choose_level(page, 1)  # the server knows the whole skeleton only: the page deforms by itself
        page.wait_for_timeout(300)
        assert page.get_by_test_id("deformer").input_value() == "hybrid"
        assert np.abs(positions(page) - deformer("hybrid", clip.body)(plain[:, follow])[0]).max() < 1e-4


def test_the_built_in_person_has_the_levels_of_the_standard_and_groups(browser, tmp_path):
    clip = walking_person()
    record(clip, tmp_path / "person.html")
    with opened(browser, (tmp_path / "person.html").as_uri(), (560, 440)) as page:
        pause(page)
        scrub(page, 7)
        labels = page.get_by_test_id("loa").locator("option").all_text_contents()
        assert labels == [f"LOA {i} · {n} joint{'s' * (n > 1)}" for i, n in enumerate((1, 18, 71, 94, 146))]
        page.get_by_test_id("deformer").select_option("linear")
        choose_level(page, 1)
        follow = folded(clip.body.skeleton, 1)
        wanted = deformer("linear", clip.body)(joint_matrices(clip.body.skeleton, clip.motion)[7][follow])
        assert np.abs(positions(page) - wanted).max() < 1e-4
        choose_level(page, 4)
        page.keyboard.press("f")
        groups = page.locator("#shapes .group > summary").all_text_contents()
        assert groups == ["Expressions6", "Brows5", "Eyes14", "Cheeks and nose5", "Mouth and jaw28"]
        page.locator("#shape-filter").fill("smile l_")
        assert page.locator("#shapes .shape:visible").count() == 1
        page.keyboard.press("Escape")
        page.keyboard.press("Escape")
        select(page, "l_radiocarpal")
        card = page.get_by_test_id("joint-details")
        text = card.text_content()
        body, j = clip.body, clip.body.skeleton.index["l_radiocarpal"]
        most = int((body.skin.weights.joint == j).sum())
        assert (
            "l_wrist in H-Anim 1.x" in text
            and "l_carpal" in text
            and "LOA 1 and up" in text
            and f"{most} points" in text
        )
        assert "  ".join(f"{x:.4f}" for x in body.skeleton.centers[j]) in text
        assert card.get_by_text("l_ulnar_styloid_pt").count() == 1
        card.get_by_role("button", name="l_elbow").click()
        assert page.evaluate("vitruvian.selected") == "l_elbow"


def test_sliders_stop_at_limits_unless_they_are_ignored(browser, tmp_path):
    record(capsule_clip(vertices=800, frames=6), tmp_path / "clip.html")
    with opened(browser, (tmp_path / "clip.html").as_uri(), (1000, 700)) as page:
        pause(page)
        scrub(page, 0)
        select(page, "l_elbow")
        angle, row = page.get_by_test_id("angle-l_elbow-x"), page.locator(".slider:visible").first
        page.keyboard.press("r")  # arcs away
        page.wait_for_timeout(700)
        bare = pixels(page)
        page.keyboard.press("r")
        page.wait_for_timeout(700)
        assert np.abs(pixels(page) - bare).max() > 60  # arcs are drawn
        angle.fill("50")
        angle.press("Enter")
        page.wait_for_timeout(60)
        assert abs(page.evaluate("vitruvian.angles")[0]) < 0.01 and "over" not in row.get_attribute("class")
        page.locator("canvas").focus()
        page.keyboard.press("u")
        assert page.get_by_test_id("ignore-limits").is_checked()
        assert page.get_by_test_id("slider-l_elbow-x").get_attribute("max") == "180.0"
        angle.fill("50")
        angle.press("Enter")
        page.wait_for_timeout(60)
        assert abs(page.evaluate("vitruvian.angles")[0] - 50) < 0.01 and "over" in row.get_attribute("class")
        page.get_by_test_id("ignore-limits").click()
        page.wait_for_timeout(60)
        assert "over" in row.get_attribute("class")  # still so: nothing moves by itself
        slide(page, "slider-l_elbow-x", -30)
        assert abs(page.evaluate("vitruvian.angles")[0] + 30) < 0.01 and "over" not in row.get_attribute("class")
        for text, there in (("", -30), ("1e30", 0), ("-1e30", np.degrees(-2.6))):
            angle.evaluate("(e, t) => { e.value = t; e.dispatchEvent(new Event('change')); }", text)
            assert abs(page.evaluate("vitruvian.angles")[0] - there) < 0.01
        page.locator("canvas").focus()
        page.keyboard.press("Backspace")
        assert page.get_by_test_id("joint-details").is_hidden() and page.evaluate("vitruvian.selected") is None


def test_sites_are_sifted_and_flown_to_and_labelled(browser, tmp_path):
    clip = capsule_clip(vertices=1500, frames=6)
    record(clip, tmp_path / "clip.html")
    with opened(browser, (tmp_path / "clip.html").as_uri(), (1000, 700)) as page:
        pause(page)
        scrub(page, 0)
        page.keyboard.press("k")  # the camera no longer follows the walk
        page.keyboard.press("n")
        assert page.locator("#sites-list .group > summary").all_text_contents() == ["End effectors2"]
        page.locator("#site-filter").fill("hand")
        assert page.get_by_test_id("site-skull_tip").is_hidden()
        row = page.get_by_test_id("site-l_hand_tip")
        row.hover()
        wait(page, "document.querySelector('#beacon span').offsetWidth > 0")
        assert page.locator("#beacon").text_content() == "l_hand_tip"
        row.click()
        wait(page, "!vitruvian.camera.moving")
        matrices = joint_matrices(clip.body.skeleton, clip.motion)[0]
        s = clip.body.skeleton
        wanted = move(matrices[s.site_joints[0]], s.site_points[0])
        shown = np.array(page.evaluate("vitruvian.site('l_hand_tip')"))
        rounds = (shown - wanted)[2] / actors_of([clip])[0].travel[2]  # it has walked on until it was paused
        assert np.abs((shown - wanted)[:2]).max() < 1e-5 and abs(rounds - round(rounds)) < 1e-4
        assert np.abs(np.array(page.evaluate("vitruvian.camera.target")) - shown).max() < 1e-3
        box = page.locator("#beacon i").first.bounding_box()
        assert abs(box["x"] + box["width"] / 2 - 500) < 3 and abs(box["y"] + box["height"] / 2 - 350) < 3
        assert row.get_attribute("aria-pressed") == "true"


VIEW = """<HAnimSite DEF="hanim_eye_view" name="eye_view" translation="0.2 1.2 0.1"><Transform translation="0 0.1 0">
<Viewpoint orientation="0 1 0 3.14159265" position="0 0 0.5" fieldOfView="0.6"/></Transform></HAnimSite>
<HAnimSegment DEF="hanim_sacrum" """


def test_a_viewpoint_is_looked_through_and_rides_on_its_joint(browser):
    from scene_figure import GOOD
    from vitruvian.formats.x3d import parse_x3d
    from vitruvian.hanim.view import humanoids

    # the Site hangs on the root; far: a viewpoint of the humanoid itself
    text = GOOD.replace('<HAnimSegment DEF="hanim_sacrum" ', VIEW, 1).replace(
        '<HAnimJoint USE="hanim_humanoid_root"',
        '<HAnimSite DEF="hanim_far_view" name="far_view" translation="0 1 4" containerField="viewpoints"/>'
        '<HAnimJoint USE="hanim_humanoid_root"',
        1,
    )
    (humanoid,) = humanoids(parse_x3d(text.encode(), "tin.x3d"))
    with show(humanoid, open_browser=False, block=False) as window, opened(browser, window.url, (800, 600)) as page:
        page.keyboard.press("n")
        rows = page.get_by_test_id("sites-viewpoint").locator(".place")
        assert [r.split("_view")[0] for r in rows.all_text_contents()] == ["eye", "far"]
        page.get_by_test_id("site-eye_view").click()
        wait(page, "!vitruvian.camera.moving")
        seen = page.evaluate("vitruvian.camera")
        np.testing.assert_allclose(seen["position"], [0.2, 1.3, 0.6], atol=1e-3)
        ahead = np.subtract(seen["target"], seen["position"])
        np.testing.assert_allclose(ahead / np.linalg.norm(ahead), [0, 0, 1], atol=1e-3)
        assert abs(np.radians(seen["fov"]) - 0.6) < 1e-3
        select(page, "humanoid_root")
        slide(page, "slider-humanoid_root-y", 90)
        wait(page, "vitruvian.camera.position[0] > 0.5")
        seen = page.evaluate("vitruvian.camera")  # about (0, 0.8, 0): x -> -z, z -> x
        np.testing.assert_allclose(seen["position"], [0.6, 1.3, -0.2], atol=1e-3)
        page.keyboard.press("v")
        wait(page, "!vitruvian.camera.moving")
        np.testing.assert_allclose(page.evaluate("vitruvian.camera.position"), [0, 1, 4], atol=1e-3)
        page.keyboard.press("1")
        wait(page, "!vitruvian.camera.moving")
        assert abs(page.evaluate("vitruvian.camera.fov") - 28) < 1e-6


def test_displacers_take_numbers_and_go_back_one_by_one_or_all(browser):
    clip = capsule_clip(vertices=800, frames=6)
    server = Server(showing := Showing(actors_of([clip])))
    with Window(server, serve(server)) as window, opened(browser, window.url, (1000, 700)) as page:
        pause(page)
        scrub(page, 0)
        page.keyboard.press("f")
        rest = positions(page)
        grow, chin = page.get_by_test_id("weight-grow_action"), page.get_by_test_id("weight-chin_action")
        for field, value in ((grow, "1.5"), (chin, "-0.5")):
            field.fill(value)
            field.press("Enter")
        matrices = joint_matrices(clip.body.skeleton, clip.motion)
        weights = {"grow_action": np.array([1.5]), "chin_action": np.array([-0.5])}
        wanted = deformer("log", clip.body)(matrices[:1], weights)[0]
        assert np.abs(positions(page) - wanted).max() < 1e-4
        told(page, showing, {1: 1.5, 0: -0.5})
        page.get_by_test_id("reset-grow_action").click()
        told(page, showing, {0: -0.5})
        assert page.get_by_test_id("reset-grow_action").is_disabled()
        chin.fill("99")
        chin.press("Enter")
        told(page, showing, {0: 10.0})
        page.get_by_test_id("reset-shapes").click()
        told(page, showing, {})
        np.testing.assert_allclose(positions(page), rest, atol=1e-6)
        assert page.get_by_test_id("reset-shapes").is_disabled()
        page.get_by_test_id("undo").click()
        told(page, showing, {0: 10.0})


def test_findings_open_by_themselves_and_lead_to_what_they_are_about(browser, tmp_path):
    record(capsule_clip(vertices=1500, frames=6), tmp_path / "clip.html", findings=FINDINGS)
    with opened(browser, (tmp_path / "clip.html").as_uri(), (1280, 800)) as page:
        pause(page)
        scrub(page, 0)
        page.keyboard.press("k")  # the camera no longer follows the walk
        panel = page.get_by_test_id("findings")
        assert panel.get_attribute("open") is not None and page.locator("#finding-count").text_content() == "5"
        items = panel.locator("li")
        first = items.first.text_content()
        assert "<b>15</b>" in first and "S01" in first and "line 12" in first and "Fix: cut" in first
        items.nth(0).click()
        wait(page, "vitruvian.selected === 'l_elbow' && !vitruvian.camera.moving")
        assert page.locator("#beacon").text_content() == "l_elbow" and "flash" in page.locator("#beacon").get_attribute(
            "class"
        )
        x, y = page.evaluate("vitruvian.screen('l_elbow')")
        assert abs(x - 640) < 4 and abs(y - 400) < 4
        assert "15" in page.get_by_test_id("joint-details").text_content()
        items.nth(1).click()  # a DEF with a prefix
        wait(page, "!vitruvian.camera.moving")
        assert page.locator("#beacon").text_content() == "skull_tip"
        items.nth(2).click()
        wait(page, "!vitruvian.camera.moving")
        assert page.locator("#beacon").text_content() == "grow_action"
        assert page.evaluate("document.activeElement.dataset.testid") == "displacer-grow_action"
        assert "link" not in (items.nth(3).get_attribute("class") or "") and "line 77" in items.nth(3).text_content()
        items.nth(4).click()  # named in the message only
        wait(page, "vitruvian.selected === 'r_knee'")
        assert page.locator("#joints .mark.error").count() == 2
        for severity, left in (("warning", 3), ("error", 1), ("warning", 3)):
            page.get_by_test_id(f"sift-{severity}").click()
            assert panel.locator("li:visible").count() == left


def test_view_of_a_broken_file_opens_with_its_findings(browser, tmp_path):
    from scene_figure import GOOD

    path = tmp_path / "broken.x3d"
    path.write_text(GOOD.replace('<HAnimJoint USE="hanim_l_elbow" containerField="joints"/>', ""))
    command = [sys.executable, "-W", "ignore", "-m", "vitruvian", "view", str(path), "--no-open", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            address = ""
            while "}" not in address:
                line = process.stdout.readline()
                assert line, "view ended"
                address += line
            with opened(browser, json.loads(address)["address"], (800, 600)) as page:
                assert page.get_by_test_id("findings").get_attribute("open") is not None
                page.get_by_test_id("finding-0").click()
                wait(page, "vitruvian.selected === 'l_elbow'")
        finally:
            process.terminate()


def test_a_skeleton_without_skin_is_shown_by_its_bones(browser):
    from vitruvian.hanim.humanoid import Humanoid, Joint

    head = Joint("skullbase", center=np.array([0.0, 160, 0]))
    hand = Joint("my_<b>third</b>_hand", center=np.array([60.0, 120, 0]))
    root = Joint("humanoid_root", center=np.array([0.0, 90, 0]), joints=[head, hand])
    humanoid = Humanoid(name="bones", skeleton=[root], scale=np.full(3, 0.01))  # in centimetres
    with show(humanoid, open_browser=False, block=False) as window, opened(browser, window.url, (640, 480)) as page:
        wait(page, "document.getElementById('bones').ariaPressed === 'true'")
        assert page.get_by_test_id("loa").locator("option").all_text_contents()[1] == "LOA 1 · 3 joints"
        x, y = page.evaluate("vitruvian.screen('skullbase')")
        assert 200 < x < 440 and 30 < y < 300
        page.wait_for_timeout(700)
        assert np.abs(pixels(page)[int(y), int(x)] - pixels(page)[200, 600]).sum() > 100  # a dot on the wall
        select(page, "my_<b>third</b>_hand")
        text = page.get_by_test_id("joint-details").text_content()
        assert "my_<b>third</b>_hand" in text and "not a name of the standard" in text and "no points" in text
        page.keyboard.press("Escape")
        page.keyboard.press("Escape")
        page.keyboard.press("g")
        page.wait_for_timeout(100)
        wait(page, "!vitruvian.camera.moving")
        np.testing.assert_allclose(page.evaluate("vitruvian.camera.target"), [0.6, 1.2, 0], atol=1e-3)


@pytest.mark.parametrize("size", [(1280, 800), (520, 440)])
def test_nothing_jumps_and_nothing_is_cut_off(browser, tmp_path, size):
    clip = capsule_clip(vertices=800, frames=6)
    body = capsule_body(vertices=800)
    long = "l_a_joint_with_a_name_that_is_very_much_longer_than_any_in_the_standard"
    names = tuple(long if n == "l_elbow" else n for n in body.skeleton.names)
    skeleton = replace(body.skeleton, names=names, site_names=("a" * 90 + "_pt", "skull_tip"))
    body = replace(body, skeleton=skeleton, name="N" * 80)
    motion = replace(clip.motion, skeleton=skeleton)
    record(
        replace(clip, body=body, motion=motion), tmp_path / "clip.html", findings=[*FINDINGS, {"message": "m" * 400}]
    )
    with opened(browser, (tmp_path / "clip.html").as_uri(), size) as page:
        pause(page)
        fixed = ["#toolbar", "#transport", "canvas", "#joints-panel > summary"]
        where = [page.locator(s).bounding_box() for s in fixed]
        for key in "jnf":  # findings are open already
            page.keyboard.press(key)
            page.wait_for_timeout(60)
        page.get_by_test_id(f"joint-{long}").evaluate("e => e.querySelector('.row').click()")
        page.wait_for_timeout(100)
        for before, selector in zip(where, fixed):
            now = page.locator(selector).bounding_box()
            same = ("x", "y", "height") if "summary" in selector else ("x", "y", "width", "height")
            assert all(abs(now[k] - before[k]) < 1 for k in same), selector
        card = page.get_by_test_id("joint-details").bounding_box()
        bars = [page.locator(s).bounding_box() for s in ("#toolbar", "#transport")]
        assert card["x"] >= 0 and card["x"] + card["width"] <= size[0]
        assert card["y"] >= bars[0]["y"] + bars[0]["height"] and card["y"] + card["height"] <= bars[1]["y"]
        wide = page.evaluate(
            "[...document.querySelectorAll('#panels .panel, #details, .row, .place, .shape, #findings li')]"
            ".filter(e => e.checkVisibility() && e.scrollWidth > e.clientWidth + 1).map(e => e.className || e.id)"
        )
        assert not wide
        assert page.evaluate("document.scrollingElement.scrollWidth <= innerWidth")


def test_every_control_has_a_name_a_tooltip_and_a_key_of_its_own(browser, tmp_path):
    record(capsule_clip(vertices=800, frames=6), tmp_path / "clip.html", findings=FINDINGS)
    with opened(browser, (tmp_path / "clip.html").as_uri(), (1000, 700)) as page:
        select(page, "l_elbow")
        keys = page.evaluate(
            "[...document.querySelectorAll('[data-key]:not([data-key=arrows]):not([data-key^=Tab])')]"
            ".filter(e => e.dataset.key !== e.previousElementSibling?.dataset.key)"
            ".map(e => e.dataset.key)"  # buttons of one group next to each other have one key that goes through them
        )
        assert len(keys) == len(set(keys)) and {"A", "N", "G", "R", "U", "X", ",", ".", "Backspace"} <= set(keys)
        bare = page.evaluate(
            "[...document.querySelectorAll('button, select, input')].filter(e => !(e.getAttribute('aria-label')"
            " || e.closest('label')?.textContent.trim() || e.textContent.trim())).map(e => e.outerHTML)"
        )
        assert not bare
        untold = page.evaluate(
            "[...document.querySelectorAll('button:not(.fold), select, input')]"
            ".filter(e => !e.closest('[data-tip]')).map(e => e.outerHTML)"
        )
        assert not untold
