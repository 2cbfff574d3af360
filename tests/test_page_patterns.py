"""The pattern editor in a real browser: draw, sew, mirror, place, drape, save, and nothing lost."""

from __future__ import annotations

import json
from contextlib import contextmanager

import numpy as np
import pytest

import vitruvian as vt
from pages import opened, wait
from test_dressing import skirt
from vitruvian.cloth.drafting import drafted
from vitruvian.cloth.pattern import Pattern, area, length
from vitruvian.cloth.placing import dummy
from vitruvian.formats.pattern_file import document, pattern_from, write_any
from vitruvian.show.editing import EMPTY, Editing
from vitruvian.show.live import Window, serve
from vitruvian.show.server import Server

MEASURES = {"height": 1.67, "chest": 0.9, "waist": 0.72, "hips": 0.96}
SIZE = (1240, 640)


@pytest.fixture(scope="module")
def figure():
    body = vt.pack(vt.person(outfit=None, hair="none"))
    return body, dummy(body)


def desk_on(figure, start, **more) -> Editing:
    desk = Editing(start, figure[0], measures=MEASURES, **more)
    desk._dummy = figure[1]  # posed once for all tests
    return desk


@contextmanager
def editor(browser, figure, start, **more):
    """A page with a pattern on its desk; and the desk."""
    desk = desk_on(figure, start, **more)
    server = Server(desk)
    with Window(server, serve(server)), opened(browser, server.url, SIZE) as page:
        yield page, desk


def read(page) -> Pattern:
    return pattern_from(page.evaluate("vitruvian.document"), "page")


def pixel(page, panel, point):
    return page.evaluate("([n, p]) => vitruvian.pixel(n, p)", [panel, list(map(float, point))])


def corner(page, panel, v):
    return pixel(page, panel, read(page).panel(panel).vertices[v])


def middle(page, panel, edge, t=0.5):
    return page.evaluate("([n, i, t]) => vitruvian.middle(n, i, t)", [panel, edge, t])


def drag(page, a, b, key=None):
    if key:
        page.keyboard.down(key)
    page.mouse.move(*a)
    page.mouse.down()
    for s in (0.3, 0.7, 1.0):
        page.mouse.move(a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]))
    page.mouse.up()
    if key:
        page.keyboard.up(key)


def press(page, *keys):
    for key in keys:
        page.keyboard.press(key)
    page.wait_for_timeout(40)


def rules(page):
    return {f["rule"] for f in page.evaluate("vitruvian.findings")}


def test_panels_are_drawn_dragged_measured_and_undone(browser, figure):
    with editor(browser, figure, EMPTY) as (page, _):
        drag(page, (120, 150), (320, 350))  # an empty desk has the rectangle in hand
        wait(page, "vitruvian.document.panels.length === 1 && vitruvian.tool === 'select'")
        panel = read(page).panels[0]
        wide, high = np.ptp(panel.vertices, axis=0)
        assert wide > 0.1 and wide == pytest.approx(high, abs=0.006)
        assert np.abs(np.array([wide, high]) / 0.005 - np.rint(np.array([wide, high]) / 0.005)).max() < 1e-6  # the grid
        assert area(panel) > 0 and panel.translation is not None
        page.keyboard.press("p")
        for at in ((360, 120), (490, 130), (470, 300), (360, 120)):
            page.mouse.click(*at)
        wait(page, "vitruvian.document.panels.length === 2")
        assert len(read(page).panels[1].edges) == 3 and area(read(page).panels[1]) > 0
        name = panel.name
        page.keyboard.press("y")  # this panel is its own mirror image: edit one side only
        page.mouse.click(*middle(page, name, 0))
        at = corner(page, name, 2)
        drag(page, at, (at[0] + 30, at[1] - 20), "Alt")
        moved = read(page).panel(name)
        assert np.abs(moved.vertices - panel.vertices).max() > 0.01
        assert np.array_equal(moved.vertices[[0, 1, 3]], panel.vertices[[0, 1, 3]])
        press(page, "Control+z")
        assert np.array_equal(read(page).panel(name).vertices, panel.vertices)
        press(page, "Control+Shift+z")
        assert np.array_equal(read(page).panel(name).vertices, moved.vertices)
        press(page, "Control+z")
        for text, wanted in (("32.5", 0.325), ("chest/4 + 2", 0.245)):
            page.mouse.dblclick(*middle(page, name, 0))
            page.get_by_test_id("measure").fill(text)
            page.keyboard.press("Enter")
            made = read(page).panel(name)
            assert length(made, 0) == pytest.approx(wanted) and length(made, 2) == pytest.approx(wanted)
        kept = page.evaluate("vitruvian.document.extra.drawing.dimensions")
        assert [(d["edge"], d["length"]) for d in kept] == [(0, "chest/4 + 2")]
        page.mouse.dblclick(*middle(page, name, 0))
        page.get_by_test_id("measure").fill("bust/2")
        page.keyboard.press("Enter")
        assert "no measure bust" in page.locator("#notice").text_content()
        assert length(read(page).panel(name), 0) == pytest.approx(0.245)


def test_edges_bend_and_are_cut_and_joined(browser, figure):
    with editor(browser, figure, skirt()) as (page, _):
        page.keyboard.press("y")
        page.mouse.click(*middle(page, "front", 1))
        before = read(page).panel("front")
        for kind in ("quadratic", "cubic", "arc", "line"):
            page.keyboard.press("c")
            edge = read(page).panel("front").edges[1]
            assert edge.kind == kind
            long = length(read(page).panel("front"), 1)
            assert (long > length(before, 1) + 1e-3) == (kind != "line")
        page.keyboard.press("c")
        point = read(page).panel("front").edges[1].points[0]
        at = pixel(page, "front", point)
        drag(page, at, (at[0] + 20, at[1] + 8), "Alt")
        assert np.abs(read(page).panel("front").edges[1].points[0] - point).max() > 1e-3
        bent = read(page).panel("front")
        press(page, "Escape", "a")
        page.mouse.click(*middle(page, "front", 1))
        wait(page, "vitruvian.document.panels[0].edges.length === 5")
        cut = read(page)
        assert area(cut.panel("front")) == pytest.approx(area(bent), abs=1e-6)
        assert [(s.edge, s.t0, s.t1) for s in cut.seams[0].a] == [(1, 0, 1), (2, 0, 1)]  # sewn as before
        assert cut.seams[1].a[0].edge == 4
        press(page, "Escape", "Delete")
        joined = read(page)
        assert len(joined.panel("front").edges) == 4
        assert [(s.edge, s.t0, s.t1) for s in joined.seams[0].a] == [(1, 0, 1)] and joined.seams[1].a[0].edge == 3
        assert joined.panel("front").edges[2].label == "lower_interface"


def test_edges_are_sewn_turned_round_and_proposed(browser, figure):
    bare = Pattern("skirt", skirt().panels)
    with editor(browser, figure, bare) as (page, _):
        wait(page, "vitruvian.findings.length")
        assert "P09" in rules(page)
        page.keyboard.press("s")
        page.mouse.click(*middle(page, "front", 1))
        page.mouse.click(*middle(page, "back", 3))
        wait(page, "vitruvian.document.seams.length === 1")
        seam = read(page).seams[0]
        assert (seam.a[0].panel, seam.a[0].edge, seam.b[0].panel, seam.b[0].edge) == ("front", 1, "back", 3)
        assert seam.reversed and seam.kind == "plain"
        assert page.evaluate("vitruvian.selection.kind") == "seam"
        page.wait_for_timeout(60)
        assert page.get_by_test_id("seam-difference").text_content() == "+0.00 cm"
        wait(page, "vitruvian.findings.every((f) => f.rule !== 'P09')")
        press(page, "x")
        assert not read(page).seams[0].reversed
        press(page, "Delete")
        assert not read(page).seams
        press(page, "Escape")
        page.get_by_test_id("proposals").locator("summary").click()
        wait(page, "vitruvian.proposed === 2")
        page.get_by_test_id("proposals").locator(".no").first.click()
        wait(page, "vitruvian.proposed === 1")
        page.get_by_test_id("proposals").locator(".yes").first.click()
        wait(page, "vitruvian.proposed === 0 && vitruvian.document.seams.length === 1")


def test_a_mirrored_panel_follows_and_a_panel_keeps_its_symmetry(browser, figure):
    shirt = drafted("tshirt", MEASURES | {"neck": 0.34, "inseam": 0.78, "back_length": 0.39})
    with editor(browser, figure, shirt) as (page, _):
        pairs = page.evaluate("vitruvian.document.extra.drawing.pairs")
        assert sorted(pairs) == [["left_sleeve_back", "right_sleeve_back"], ["left_sleeve_front", "right_sleeve_front"]]
        before = read(page)
        page.mouse.click(*middle(page, "left_sleeve_front", 0))
        at = corner(page, "left_sleeve_front", 1)
        drag(page, at, (at[0] + 12, at[1] + 18), "Alt")
        made = read(page)
        one, two = made.panel("left_sleeve_front"), made.panel("right_sleeve_front")
        assert abs(area(one) - area(before.panel("left_sleeve_front"))) > 1e-4
        assert area(two) == pytest.approx(area(one))
        for s, t in zip(made.seams, before.seams):  # and what was sewn to what
            assert [(x.panel, x.edge) for x in (*s.a, *s.b)] == [(x.panel, x.edge) for x in (*t.a, *t.b)]
        front = before.panel("front")
        v = int(np.argmax(front.vertices[:, 0] + 0.1 * front.vertices[:, 1]))
        page.mouse.click(*middle(page, "front", 0))
        at = corner(page, "front", v)
        drag(page, at, (at[0] - 14, at[1] - 10), "Alt")
        halves = read(page).panel("front").vertices
        assert np.abs(halves - front.vertices).max() > 0.01
        flipped = halves * [-1, 1]
        assert all(np.linalg.norm(halves - p, axis=1).min() < 1e-9 for p in flipped)
        page.keyboard.press("Escape")
        page.mouse.click(*pixel(page, "back", before.panel("back").vertices.mean(axis=0)))
        press(page, "m")
        wait(page, "vitruvian.document.panels.length === 7")
        copy = read(page).panels[-1]
        assert copy.name == "back_mirrored" and copy.translation[2] == before.panel("back").translation[2]


def test_a_dart_is_cut_and_sewn_on_both_sides(browser, figure):
    with editor(browser, figure, skirt()) as (page, _):
        before = read(page)
        page.keyboard.press("t")
        page.get_by_test_id("dart-wide").fill("2")
        page.get_by_test_id("dart-deep").fill("9")
        page.keyboard.press("Enter")
        page.mouse.click(*middle(page, "front", 2, 0.25))
        wait(page, "vitruvian.document.seams.length === 4")
        made = read(page)
        front = made.panel("front")
        darts = [s for s in made.seams if s.kind == "dart"]
        assert len(darts) == 2 and len(front.edges) == 10
        for s in darts:
            one, two = s.a[0].edge, s.b[0].edge
            assert two == one + 1 and length(front, one) == pytest.approx(np.hypot(0.01, 0.09))
            assert length(front, two) == pytest.approx(length(front, one))
        assert area(before.panel("front")) - area(front) == pytest.approx(2 * 0.5 * 0.02 * 0.09)
        assert not {"P03", "P05", "P06"} & rules(page)


def test_the_doctor_sees_every_change(browser, figure):
    with editor(browser, figure, skirt()) as (page, _):
        page.keyboard.press("y")
        page.mouse.click(*middle(page, "front", 0))
        a, b = corner(page, "front", 0), corner(page, "front", 2)
        drag(page, a, (b[0] + 40, b[1] + 20), "Alt")
        wait(page, "vitruvian.findings.some((f) => f.rule === 'P03' && f.panel === 'front')")
        assert "crosses or touches" in page.get_by_test_id("findings").text_content()
        press(page, "Control+z")
        wait(page, "!vitruvian.findings.some((f) => f.severity === 'error')")


def test_panels_are_moved_around_the_body(browser, figure):
    with editor(browser, figure, skirt()) as (page, _):
        page.keyboard.press("1")
        page.wait_for_timeout(900)
        at = page.evaluate("vitruvian.place('front')")
        before = read(page).panel("front")
        drag(page, at, (at[0] + 40, at[1] - 30))
        moved = read(page).panel("front")
        by = moved.translation - before.translation
        assert by[0] > 0.03 and by[1] > 0.03 and abs(by[2]) < 0.05
        assert np.array_equal(moved.rotation, before.rotation)
        press(page, "Control+z")
        at = page.evaluate("vitruvian.place('front')")
        drag(page, at, (at[0] + 60, at[1]), "Shift")
        around = read(page).panel("front")
        turn = 60 / 120  # radians
        assert around.rotation[0, 0] == pytest.approx(np.cos(turn), abs=0.02)
        radius = np.hypot(*around.translation[[0, 2]])
        assert radius == pytest.approx(np.hypot(*before.translation[[0, 2]]), abs=1e-6)
        press(page, "l")
        flipped = read(page).panel("front")
        assert np.abs(flipped.rotation[:, 2] + around.rotation[:, 2]).max() < 1e-6


def test_it_is_draped_saved_and_read_back(browser, figure, tmp_path):
    path = tmp_path / "mine.pattern.json"
    kept: list[str] = []
    more = {"where": path.name, "save": lambda made: write_any(made, path), "keep": kept.append}
    with editor(browser, figure, skirt(), **more) as (page, desk):
        page.get_by_test_id("size").select_option("0.03")
        press(page, "d")
        wait(page, "vitruvian.fell > 0")
        press(page, "Escape")
        wait(page, "vitruvian.draping === 'stopped'")
        assert page.evaluate("vitruvian.shown") == "panels"
        press(page, "d")
        wait(page, "vitruvian.draping === 'done'", 60)
        report = page.evaluate("vitruvian.report")
        assert report["faces"] > 300 and report["seam_gap_max_mm"] < 1 and page.evaluate("vitruvian.fell") >= 1
        assert page.evaluate("vitruvian.shown") == "worn" and page.get_by_test_id("report").is_visible()
        press(page, "e", "w")
        assert page.evaluate("vitruvian.shown") == "panels"
        page.mouse.click(*middle(page, "front", 0))
        page.get_by_test_id("edge-length").fill("72")
        page.keyboard.press("Enter")
        wait(page, "vitruvian.unsaved")
        page.wait_for_timeout(400)
        assert not path.exists() and kept and json.loads(kept[-1])["panels"]
        page.reload()
        wait(page, "vitruvian.actors.length && vitruvian.fps > 0")
        assert page.evaluate("vitruvian.unsaved") and length(read(page).panel("front"), 0) == pytest.approx(0.72)
        press(page, "Control+s")
        wait(page, "!vitruvian.unsaved")
        saved = vt.load(path)
        assert length(saved.panel("front"), 0) == pytest.approx(0.72) and len(saved.seams) == 2
        assert kept[-1] == "" and desk.saved == desk.text


def test_what_is_draped_is_worn_in_motion(browser, figure):
    with editor(browser, figure, skirt()) as (page, desk):
        press(page, "h")
        assert "Drape the pattern first" in page.locator("#notice").text_content()
        page.get_by_test_id("size").select_option("0.03")
        press(page, "d")
        wait(page, "vitruvian.draping === 'done'", 60)
        still = page.evaluate("vitruvian.hangs")
        press(page, "h")
        wait(page, "vitruvian.strides > 20", 60)
        seen = [page.evaluate("vitruvian.hangs") for _ in range(4) if page.wait_for_timeout(300) is None]
        body, cloth = np.array([s["body"] for s in seen]), np.array([s["cloth"] for s in seen])
        assert np.ptp(body, axis=0).max() > 0.02 and np.ptp(cloth, axis=0).max() > 0.002  # both move
        assert np.abs(cloth - body)[:, [0, 2]].max() < 0.5  # and stay together, on the spot
        assert page.get_by_test_id("walk").get_attribute("aria-pressed") == "true"
        press(page, "Escape")
        wait(page, "!vitruvian.walking", 20)
        wait(page, f"Math.abs(vitruvian.hangs.cloth[1] - {still['cloth'][1]}) < 1e-3", 20)
        assert page.evaluate("vitruvian.hangs.body") == pytest.approx(still["body"], abs=1e-3)  # it hangs again


def test_a_pattern_is_downloaded_in_the_formats_that_there_are(browser, figure):
    made = {"pattern.json": lambda p: json.dumps(document(p)).encode()}
    with editor(browser, figure, skirt(), exports=made) as (page, _):
        with page.expect_download() as got:
            page.get_by_test_id("export").select_option("pattern.json")
        assert got.value.suggested_filename == "skirt.pattern.json"
        text = json.loads(got.value.path().read_text())
        assert [p["name"] for p in text["panels"]] == ["front", "back"]


def test_panels_are_put_where_they_are_worn(browser, figure):
    with editor(browser, figure, EMPTY) as (page, _):
        drag(page, (120, 150), (220, 260))
        wait(page, "vitruvian.tool === 'select'")
        page.get_by_test_id("worn-region").select_option("torso")
        wait(page, "vitruvian.document.panels[0].translation[1] !== 1.15")
        front = read(page).panels[0]
        assert front.rotation[2, 2] == 1 and front.translation[2] > 0.1
        page.get_by_test_id("worn-face").select_option("back")
        wait(page, "vitruvian.document.panels[0].translation[2] < 0")
        back = read(page).panels[0]
        assert back.rotation[2, 2] == -1 and back.translation[1] == front.translation[1]
        page.get_by_test_id("worn-region").select_option("sleeve")
        wait(page, "Math.abs(vitruvian.document.panels[0].translation[0]) > 0.1")
        press(page, "Control+z")
        assert np.array_equal(read(page).panels[0].translation, back.translation)
