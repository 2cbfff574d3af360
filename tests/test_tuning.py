"""The panel of the hands' parameters, in a real browser: on a recording and on a live page, whose stage follows."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import vitruvian as vt
from pages import opened, pause, positions, slide, wait
from test_cli import answer, fails
from vitruvian.body.hands import Rounding, roundings_of, store_roundings, stored_roundings
from vitruvian.body.rotations import from_axis_angle
from vitruvian.body.types import Skin, Weights
from vitruvian.cli.files import with_hands
from vitruvian.deform.deformer import deformer
from vitruvian.deform.hand_links import hands_of
from vitruvian.errors import VitruvianError
from vitruvian.motion.types import Motion
from vitruvian.show.actors import actors_of
from vitruvian.show.live import Window, serve
from vitruvian.show.recording import record
from vitruvian.show.server import Server, Showing
from vitruvian.stage.clip import Clip

SLIDERS = {"joint": (0, 1), "near": (0, 0.5), "far": (0, 0.5), "muscle": (0, 1), "belly": (0.2, 0.8), "arc": (1, 0)}


@pytest.fixture(scope="module")
def clip():
    """Only the hands of the built-in person, making fists."""
    humanoid = vt.person(loa=4, outfit="body suit", hair="none")
    body = vt.pack(humanoid)
    some = np.sort(np.concatenate([h.vertices for h in hands_of(body)]))
    place = np.full(len(body.skin.rest), -1)
    place[some] = np.arange(len(some))
    w, corners = body.skin.weights, place[body.skin.triangles]
    keep = place[w.vertex] >= 0
    weights = Weights.from_pairs(len(some), place[w.vertex[keep]], w.joint[keep], w.weight[keep])
    body = replace(body, skin=Skin(body.skin.rest[some], corners[(corners >= 0).all(axis=1)], weights))
    rotation = body.skeleton.rotation.copy()
    for hand in hands_of(body):
        for link in np.flatnonzero(hand.before_links() >= 0):
            rotation[hand.near[link]] = from_axis_angle([*hand.axis_near[link], 1.1])
    motion = Motion(body.skeleton, 30.0, rotation[None], np.zeros((1, 3)))
    return Clip(humanoid, body, motion, deformer="hand")


def matrices(clip):
    return vt.joint_matrices(clip.body.skeleton, clip.motion)[0]


def chosen(page, **choice):
    for name, value in choice.items():
        page.get_by_test_id(f"hands-{name}").select_option(value)


def test_sliders_of_a_recording_are_the_packages_parameters(browser, clip, tmp_path):
    record(clip, tmp_path / "clip.html")
    m, d = matrices(clip), deformer("hand", clip.body)
    with opened(browser, (tmp_path / "clip.html").as_uri(), (900, 620)) as page:
        panel = page.get_by_test_id("hands-panel")
        assert panel.is_visible() and np.abs(positions(page) - d(m)).max() < 1e-5
        page.keyboard.press("h")
        chosen(page, side="l", finger="index", place="knuckle")
        assert page.evaluate("vitruvian.hands.joints") == ["l_metacarpophalangeal_2"]
        for name, ends in SLIDERS.items():
            for value in ends:
                slide(page, f"hands-{name}", value)
                wanted = d.tuned({"l_metacarpophalangeal_2": Rounding(**{name: value})})(m)
                assert np.abs(positions(page) - wanted).max() < 1e-5, (name, value)
            page.get_by_test_id(f"hands-reset-{name}").click()
        chosen(page, side="l", finger="ring", place="palm")
        slide(page, "hands-palm", 1)
        assert page.evaluate("vitruvian.hands.words")["l_carpometacarpal_4"].split()[-2:] == ["palm", "1"]
        wanted = d.tuned({"l_carpometacarpal_4": Rounding(palm=1)})(m)
        assert np.abs(positions(page) - wanted).max() < 1e-5 and np.abs(wanted - d(m)).max() > 1e-4
        page.get_by_test_id("hands-reset-palm").click()
        chosen(page, side="", finger="index", place="")
        slide(page, "hands-tilt", 30)  # whole bones of both hands
        words = page.evaluate("vitruvian.hands.words")
        assert len(words) == 8
        tilted = d.tuned({joint: Rounding.read(text) for joint, text in words.items()})(m)
        assert np.abs(positions(page) - tilted).max() < 2e-5 and np.abs(tilted - d(m)).max() > 1e-3
        chosen(page, finger="")
        assert page.get_by_test_id("hands-number-tilt").get_attribute("placeholder") == "various"
        assert page.get_by_test_id("hands-number-tilt").input_value() == ""
        page.keyboard.press("Control+z")  # one gesture is one step
        assert np.abs(positions(page) - d(m)).max() < 1e-5 and not page.evaluate("vitruvian.hands.words['l_index']")
        page.get_by_test_id("hands-second").uncheck()
        assert np.abs(positions(page) - d.tuned(rounded=False)(m)).max() < 1e-5
        assert page.get_by_test_id("hands-joint").is_disabled() and page.get_by_test_id("hands-near").is_enabled()
        page.keyboard.press("8")
        assert page.evaluate("vitruvian.hands.rounded") and np.abs(positions(page) - d(m)).max() < 1e-5
        chosen(page, finger="thumb", place="middle")  # there is none
        assert page.get_by_test_id("hands-joint").is_disabled()
        page.get_by_test_id("deformer").select_option("log")
        assert panel.is_hidden() and page.get_by_test_id("hands-second").is_disabled()


def test_the_panel_is_driven_by_keys_and_readable_in_both_themes(browser, clip, tmp_path):
    record(clip, tmp_path / "clip.html")
    with opened(browser, (tmp_path / "clip.html").as_uri(), (420, 640)) as page:
        pause(page)
        page.get_by_test_id("hands-panel").locator("summary").focus()
        page.keyboard.press("Enter")
        reached = []
        for _ in range(30):
            page.keyboard.press("Tab")
            reached.append(page.evaluate("document.activeElement.dataset.testid ?? ''"))
            if reached[-1] == "hands-joint":
                page.keyboard.press("ArrowRight")
        assert {"hands-side", "hands-finger", "hands-place", *(f"hands-{n}" for n in SLIDERS), "hands-tilt"} <= set(
            reached
        )
        assert {"hands-second", "look-hand", "reset-hands", "save-hands"} <= set(reached)
        words = page.evaluate("vitruvian.hands.words")
        assert len(words) == 38 and all(w.startswith("joint 0.51 ") for w in words.values())
        page.keyboard.press("y")
        wait(page, "vitruvian.camera.moving")
        wait(page, "!vitruvian.camera.moving")
        ink = lambda: page.evaluate(  # noqa: E731
            "[getComputedStyle(document.querySelector('#hands-rows .name')).color, "
            "getComputedStyle(document.querySelector('#hands-panel')).backgroundColor]"
        )
        before = ink()
        page.keyboard.press("t")
        assert all(a != b for a, b in zip(before, ink(), strict=True))
        wide = (
            "[...document.querySelectorAll('#hands-panel, #hands-panel *')].filter(e => e.checkVisibility()"
            " && e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).textOverflow !== 'ellipsis')"
            ".map(e => e.outerHTML)"
        )
        assert not page.evaluate(wide)


def saved(page, path):
    with page.expect_download() as download:
        page.get_by_test_id("save-hands").click()
    assert download.value.suggested_filename.endswith("-hands.json")
    download.value.save_as(path)
    return roundings_of(json.loads(path.read_text()))


@pytest.mark.parametrize("live", [False, True])
def test_what_the_panel_saves_is_read_back(browser, clip, tmp_path, live):
    """From a recording and from a live page: the same points come out of the file."""
    m, d = matrices(clip), deformer("hand", clip.body)

    def tune(page):
        page.keyboard.press("h")
        assert page.get_by_test_id("save-hands").is_disabled()
        chosen(page, side="l", finger="ring", place="")
        slide(page, "hands-joint", 0.9)
        slide(page, "hands-palm", 0.75)
        chosen(page, side="r", finger="index", place="knuckle")
        slide(page, "hands-tilt", 20)
        given = saved(page, tmp_path / "hands.json")
        assert len(given) == 5 and given["l_carpometacarpal_4"].palm == 0.75
        assert np.abs(positions(page) - d.tuned(given)(m)).max() < 5e-5
        chosen(page, side="", finger="", place="")
        page.keyboard.press("8")
        assert page.get_by_test_id("save-hands").is_disabled()
        return given

    if live:
        server = Server(Showing(actors_of([clip])))
        with Window(server, serve(server)), opened(browser, server.url) as page:
            given = tune(page)
    else:
        record(clip, tmp_path / "clip.html")
        with opened(browser, (tmp_path / "clip.html").as_uri()) as page:
            given = tune(page)
    assert np.abs(d.tuned(given)(m) - d(m)).max() > 1e-3


def test_commands_put_saved_hands_into_bodies(clip, tmp_path):
    """convert and contours: what the file says is in the body, beside what that has of other joints."""
    kept = dict(clip.humanoid.info)
    try:
        store_roundings(clip.humanoid, {"thumb": Rounding(joint=0.1), "l_index": Rounding(joint=0.2)})
        vt.save(clip.humanoid, tmp_path / "person.x3d")
    finally:
        clip.humanoid.info = kept
    given = {"l_index": Rounding(joint=0.8, palm=0.5), "l_carpometacarpal_4": Rounding(axis=(0, 0.6, -0.8))}
    (tmp_path / "hands.json").write_text(json.dumps({name: r.words for name, r in given.items()}))
    wanted = given | {"thumb": Rounding(joint=0.1)}
    for command in (["convert", tmp_path / "person.x3d"], ["contours", tmp_path / "person.x3d", "-o"]):
        target = tmp_path / f"{command[0]}.wrl"
        answer(*command, target, "--hands", tmp_path / "hands.json")
        found = vt.load(target)
        assert stored_roundings(found) == wanted
        assert vt.pack(found).roundings == wanted
    for text, told in (
        ('{"l_elbow": "joint 1"}', "expected joints or rays of a hand, found l_elbow"),
        ('{"index": "joint 7"}', "hands: index: rounding joint: expected 0 to 1, found 7.0"),
        ('{"index": 0.5}', "hands: index: expected words such as 'joint 0.8', found 0.5"),
        ("[]", 'hands: expected {"joint or finger"'),
        ("joint", "expected JSON that the page's Hands panel saved"),
    ):
        (tmp_path / "wrong.json").write_text(text)
        with pytest.raises(VitruvianError, match="wrong.json: ") as refused:
            with_hands(clip.humanoid, tmp_path / "wrong.json")
        assert told in str(refused.value)
    with pytest.raises(VitruvianError, match="--hands: expected an H-Anim body, found a motion"):
        with_hands(clip.motion, tmp_path / "hands.json")
    assert stored_roundings(clip.humanoid) == {}
    assert "none.json" in fails("convert", tmp_path / "person.x3d", tmp_path / "out.x3d", "--hands", "none.json")


def test_a_live_stage_follows_and_keeps_what_was_set(browser, clip):
    showing = Showing(actors_of([clip]))
    server = Server(showing)
    m, d = matrices(clip), deformer("hand", clip.body)
    name = showing.actors[0].name

    def stands(page, wanted):
        """The stage publishes these points, and the page shows them."""
        for _ in range(100):
            page.wait_for_timeout(40)
            points = showing.stage.frame[name].vertices
            if (
                points is not None
                and np.abs(points - wanted).max() < 1e-6
                and np.abs(positions(page) - wanted).max() < 5e-5
            ):
                return
        raise AssertionError("the stage never had these points")

    with Window(server, serve(server)), opened(browser, server.url, (520, 440)) as page:
        stands(page, d(m))
        page.keyboard.press("h")
        chosen(page, finger="ring")
        slide(page, "hands-joint", 1)
        wanted = d.tuned({"ring": Rounding(joint=1)})(m)
        stands(page, wanted)
        bound = len(showing.stage.workshop._bound)
        for value in (0.1, 0.2, 1):  # nothing piles up while a slider moves
            slide(page, "hands-joint", value)
        stands(page, wanted)
        assert len(showing.stage.workshop._bound) == bound
        page.get_by_test_id("deformer").select_option("log")
        page.get_by_test_id("deformer").select_option("hand")
        stands(page, wanted)
        page.keyboard.press("8")
        stands(page, d(m))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ({"l_elbow": "joint 1"}, "expected joints or rays"),
        ({"index": "joint 9"}, "0 to 1"),
        ({"index": "axis 0 0"}, "3 numbers"),
    ],
)
def test_parameters_that_do_not_fit_are_refused(clip, words, told):
    showing = Showing(actors_of([clip]))
    with pytest.raises(VitruvianError, match=told):
        showing.apply({"type": "set_hands", "actor": showing.actors[0].name, "roundings": words, "rounded": True})
    assert showing.change == 0 and not showing.hands
