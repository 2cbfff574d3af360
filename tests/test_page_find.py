"""Feature points found from the page, coloured by confidence; girths drawn on the scan and written."""

from __future__ import annotations

import json
import threading
import time

import numpy as np
import pytest
from typer.testing import CliRunner

import vitruvian as vt
from pages import opened, wait
from vitruvian.cli import app
from vitruvian.errors import VitruvianError
from vitruvian.modeling import landmarks, source
from vitruvian.modeling.measures import GIRTHS, measures
from vitruvian.modeling.shape import Shape, shaped
from vitruvian.modeling.tapes import as_sites, tapes
from vitruvian.show.actors import actors_of
from vitruvian.show.keeping import Keeping
from vitruvian.show.live import show
from vitruvian.show.searching import Search
from vitruvian.show.showing import Showing
from vitruvian.show.wire import parse_request
from vitruvian.stage.clip import Mesh


@pytest.fixture(scope="module")
def scan() -> Mesh:
    """The built-in person's surface in millimetres, Z up, away from its origin."""
    points = shaped(Shape())[: source.BODY] * 1000
    turned = np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1) + [500.0, -300.0, 40.0]
    return Mesh(turned, source.array("triangles"), name="scan")


@pytest.fixture(scope="module")
def marks(scan: Mesh) -> dict:
    told: list[tuple[int, int]] = []
    found = landmarks.detect(scan, progress=lambda done, total: told.append((done, total)))
    assert len(told) > 5 and all(a <= b and 0 < a[0] <= a[1] for a, b in zip(told, told[1:], strict=False))
    return {n: p for n, (p, _) in found.items()}


def test_tapes_lie_on_the_scan_in_its_own_numbers(scan, marks) -> None:
    from vitruvian.modeling import shrink

    found = tapes(scan, marks)
    known = measures(scan, marks)
    assert {n.removeprefix("l_").removeprefix("r_") for n in found} == set(GIRTHS)
    surface, _ = shrink.surface_of(scan.vertices, scan.triangles)
    for name, tape in found.items():
        assert shrink.closest(tape.points, surface)[0].max() < 0.1, name  # mm
        around = np.linalg.norm(np.roll(tape.points, -1, axis=0) - tape.points, axis=1).sum()
        assert around / 1000 == pytest.approx(tape.length, rel=1e-6)
    assert found["waist"].length == pytest.approx(known.values["waist"])


def test_tapes_are_sites_that_come_back(tmp_path) -> None:
    person = vt.person(outfit=None, hair="none")
    found = tapes(person)
    assert as_sites(person, found) == as_sites(person, found)  # replaced, not doubled
    vt.save(person, tmp_path / "p.x3d")
    again = {s.name: s for s in vt.load(tmp_path / "p.x3d").all_sites() if s.name.endswith("_contour_pt")}
    assert len(again) == len(found)
    holders = {s.name: j.name for j in person.joints() for g in j.segments for s in g.sites}
    assert holders["l_calf_contour_pt"] == "l_knee" and "hip" in holders["r_thigh_contour_pt"]
    site = again["waist_contour_pt"]
    np.testing.assert_allclose(site.translation, found["waist"].points.mean(axis=0), atol=1e-5)
    assert "l_acromion" in landmarks.from_sites(person)  # the others are as they were
    bad = CliRunner().invoke(app, ["measure", str(tmp_path / "none.x3d"), "--sites", str(tmp_path / "o.x3d")])
    assert bad.exit_code


def test_two_people_are_compared(tmp_path) -> None:
    vt.save(vt.person(height=1.8, outfit=None), tmp_path / "tall.x3d")
    run = CliRunner().invoke
    words = ["measure", "person", str(tmp_path / "tall.x3d")]
    answer = json.loads(run(app, [*words, "--json", "-o", str(tmp_path / "t.json")]).stdout)
    assert answer["height_m"] == pytest.approx(1.8, abs=0.003)
    assert answer["change"]["height_m"] == pytest.approx(answer["height_m"] - answer["before"]["height_m"])
    assert answer["change"]["limbs_m"]["l_thigh"] > 0.01
    assert sum(answer["volumes_m3"].values()) == pytest.approx(answer["volume_m3"], rel=0.1)
    assert len(set(answer["volumes_m3"]) & set(answer["masses_kg"])) > 80
    same = json.loads(run(app, ["measure", str(tmp_path / "tall.x3d"), "--before", "person", "--json"]).stdout)
    assert same["change"] == answer["change"]
    written = json.loads((tmp_path / "t.json").read_text())
    assert written["waist"]["girth_m"] == pytest.approx(answer["measures"]["waist"])
    text = run(app, words).stdout
    assert "before" in text and "change" in text and "l_forearm" in text and "l_thigh" in text
    twice = run(app, [*words, "--before", "person"])
    assert isinstance(twice.exception, VitruvianError) and "both" in str(twice.exception)


def test_searches_are_told_stopped_and_refused(scan) -> None:
    search, request = Search(), {"type": "find_landmarks", "actor": "scan"}
    search.apply(request, scan)
    with pytest.raises(VitruvianError, match="nothing under way"):
        search.apply(request, scan)
    search.apply({"type": "stop_search", "actor": "scan"}, scan)
    search.wait()
    assert search.told == {"what": "found", "actor": "scan", "ready": True, "stopped": True}
    ball = Mesh(np.random.default_rng(1).normal(size=(60, 3)), np.arange(60).reshape(20, 3), name="scan")
    search.apply(request, ball)
    search.wait()
    assert "error" in search.told and "\n" not in search.told["error"]
    search.apply({"type": "take_girths", "actor": "scan", "points": {"sellion": [0.0, 0.0, 1.0]}}, scan)
    search.wait()
    assert "at least 4" in search.told["error"]
    showing = Showing(actors_of([vt.person(loa=1)]))
    with pytest.raises(VitruvianError, match="expected a mesh"):
        showing.apply({"type": "find_landmarks", "actor": showing.actors[0].name})
    with pytest.raises(VitruvianError, match="places"):
        parse_request('{"type": "take_girths", "actor": "scan", "points": {"a": [1, 2]}}')
    assert threading.active_count() < 50


def test_the_page_finds_points_and_keeps_what_was_set(browser, scan) -> None:
    saved: list[dict] = []
    own = {"navel": [500.0, -420.0, 1000.0]}
    kept = Keeping(points=own, landmarks="marks.json", save_points=saved.append)
    with (
        show(scan, open_browser=False, block=False, keeping=kept) as window,
        opened(browser, window.url, (1000, 700)) as page,
    ):
        wait(page, "vitruvian.landmarks")
        page.get_by_test_id("points-find").click()
        assert page.get_by_test_id("points-find").text_content() == "Stop"
        wait(page, "Object.keys(vitruvian.landmarks.all).length > 60", 60)
        state = page.evaluate("JSON.parse(JSON.stringify(vitruvian.landmarks))")
        assert state["all"]["navel"] == own["navel"] and "navel" not in state["confidence"]  # set by hand
        truth = {n: p for n, p in state["all"].items() if n in ("sellion", "l_acromion", "crotch")}
        for name, place in truth.items():
            vertex = scan.vertices[source.feature_vertices()[name]]
            assert np.linalg.norm(np.array(place) - vertex) < 40, name
        sure = [state["confidence"][n] for n in state["order"] if n in state["confidence"]]
        assert sure == sorted(sure)  # those that want a hand come first
        unsure = [n for n, c in state["confidence"].items() if c < 0.5]
        assert set(state["points"]) == set(state["all"]) - set(unsure)
        assert page.locator("#points-sure").is_visible()
        colors = page.locator(".landmark.found i").evaluate_all(
            "all => new Set(all.map((e) => e.style.background)).size"
        )
        assert colors > 4
        found = page.locator(".landmark.found:not(.chosen):not(.behind)", has_text="suprasternale")
        assert found.locator("span").is_hidden()
        page.mouse.move(*page.evaluate("vitruvian.pixel(vitruvian.landmarks.all.suprasternale)"))
        page.wait_for_timeout(100)
        assert found.locator("span").is_visible()
        page.get_by_test_id("points-girths").click()
        wait(page, "Object.keys(vitruvian.landmarks.girths).length > 10", 60)
        known = tapes(scan, {n: np.array(p) for n, p in state["all"].items()})
        drawn = page.evaluate("vitruvian.landmarks.girths")
        assert drawn["hips"]["girth_m"] == pytest.approx(known["hips"].length, rel=1e-4)
        page.wait_for_timeout(300)
        assert f"{100 * known['hips'].length:.1f}" in page.get_by_test_id("girth-hips").text_content()
        with page.expect_download() as waiting:
            page.get_by_test_id("girths-download").click()
        assert set(json.loads(waiting.value.path().read_text())) == set(known)
        page.get_by_test_id("points-save").click()
        end = time.monotonic() + 5
        while not saved and time.monotonic() < end:
            page.wait_for_timeout(50)
        assert set(saved[0]) == set(state["points"])
        page.keyboard.press("Control+z")  # all that were found, in one step
        assert list(page.evaluate("vitruvian.landmarks.all")) == ["navel"]
