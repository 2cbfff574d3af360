"""Feature points and weights in the page: placing, dragging, mirroring, files; the brush against the Python one."""

from __future__ import annotations

import json

import numpy as np
import pytest

import vitruvian as vt
from capsules import capsule_clip
from pages import find, opened, pause, wait
from small_body import tube
from vitruvian.cli.keeping import keeping
from vitruvian.errors import VitruvianError
from vitruvian.modeling import landmarks
from vitruvian.modeling.weight_files import read_weights
from vitruvian.modeling.weights import MODES, paint, table
from vitruvian.show.actors import actors_of
from vitruvian.show.keeping import NEEDED, Keeping, features
from vitruvian.show.live import show
from vitruvian.show.recording import record
from vitruvian.show.showing import Showing
from vitruvian.stage.clip import Clip, Mesh

HEAD, NOSE, NAVEL = "skull_vertex", "sellion", "navel"


def scan(unit: float = 1000.0, far: tuple[float, float, float] = (300.0, -900.0, 2000.0)) -> Mesh:
    """A fat tube with two arms, in millimetres, away from its origin, symmetric about its own plane."""
    parts = [
        tube([0, 0, 0], [0, 1.7, 0], 0.2),
        tube([0.25, 0.8, 0], [0.25, 1.4, 0], 0.06),
        tube([-0.25, 0.8, 0], [-0.25, 1.4, 0], 0.06),
    ]
    first = np.cumsum([0, *(len(p) for p, _ in parts)])
    triangles = np.concatenate([t + n for (_, t), n in zip(parts, first)])
    return Mesh(np.concatenate([p for p, _ in parts]) * unit + far, triangles, name="scan")


def points(page) -> dict[str, list[float]]:
    return page.evaluate("vitruvian.landmarks.points")


def ready(page) -> None:
    wait(page, "vitruvian.landmarks")
    page.keyboard.press("5")
    page.keyboard.press("1")
    page.wait_for_timeout(200)
    wait(page, "!vitruvian.camera.moving")


def click(page, name: str, place, modifiers: tuple[str, ...] = ()) -> None:
    """Choose a name and click where the point `place` of the scan is seen."""
    if page.evaluate("vitruvian.landmarks.selected") != name:
        page.get_by_test_id(f"point-{name}").click()
    x, y = page.evaluate("p => vitruvian.pixel(p)", list(place))
    for key in modifiers:
        page.keyboard.down(key)
    page.mouse.click(x, y)
    for key in modifiers:
        page.keyboard.up(key)


def local(x: float, y: float, z: float) -> list[float]:
    """A place in metres of the tube as numbers of the scan."""
    return [1000 * x + 300, 1000 * y - 900, 1000 * z + 2000]


def test_points_are_placed_dragged_deleted_and_taken_back(browser):
    mesh, saved = scan(), []
    kept = Keeping(landmarks="marks.json", save_points=saved.append)
    with (
        show(mesh, open_browser=False, block=False, keeping=kept) as window,
        opened(browser, window.url, (1000, 640)) as page,
    ):
        ready(page)
        assert page.evaluate("vitruvian.landmarks.selected") == NEEDED[0]
        assert page.locator(".point.needed:not(.placed)").count() == len(NEEDED)
        click(page, HEAD, local(0, 1.45, 0.2))
        assert page.evaluate("vitruvian.landmarks.selected") == NEEDED[1]  # the next one by itself
        own = np.array(points(page)[HEAD])
        assert np.abs(own[:2] - local(0, 1.45, 0)[:2]).max() < 12 and abs(own[2] - 2200) < 25  # its own unit and axes
        surface = np.min(np.linalg.norm(mesh.vertices - own, axis=1))
        assert surface > 0.5  # the exact place, no vertex
        click(page, NOSE, local(0.03, 1.2, 0.19), ("Shift",))
        snapped = np.array(points(page)[NOSE])
        assert np.min(np.linalg.norm(mesh.vertices - snapped, axis=1)) < 1e-3  # a vertex
        a, b = (page.evaluate("p => vitruvian.pixel(p)", p) for p in (own.tolist(), local(0.05, 1.0, 0.19)))
        camera = page.evaluate("vitruvian.camera.position")
        page.mouse.move(*a)
        page.mouse.down()
        page.mouse.move((a[0] + b[0]) / 2, (a[1] + b[1]) / 2)
        page.mouse.move(*b)
        page.mouse.up()
        moved = np.array(points(page)[HEAD])
        assert np.abs(moved[:2] - local(0.05, 1.0, 0)[:2]).max() < 15
        assert page.evaluate("vitruvian.camera.position") == camera  # the camera did not turn
        assert len(points(page)) == 2
        page.keyboard.press("Control+z")
        np.testing.assert_allclose(points(page)[HEAD], own)
        page.keyboard.press("Control+Shift+z")
        np.testing.assert_allclose(points(page)[HEAD], moved)
        page.get_by_test_id(f"point-{NOSE}").click()
        page.wait_for_timeout(700)
        page.keyboard.press("Delete")
        assert list(points(page)) == [HEAD]
        page.keyboard.press("Control+z")
        assert set(points(page)) == {HEAD, NOSE}
        page.get_by_test_id(f"point-{NOSE}").focus()
        page.keyboard.press("ArrowDown")
        assert page.evaluate("vitruvian.landmarks.selected") == NEEDED[2]
        page.keyboard.press("`")
        for _ in range(60):
            if saved:
                break
            page.wait_for_timeout(50)
        np.testing.assert_allclose(saved[0][HEAD], moved, rtol=1e-6)


def test_the_other_side_is_proposed_by_reflection_onto_the_surface(browser, tmp_path):
    mesh = scan()
    record(mesh, tmp_path / "scan.html")
    with opened(browser, (tmp_path / "scan.html").as_uri(), (1000, 640)) as page:
        ready(page)
        said = page.locator("#points-said")
        given = {NOSE: local(0, 1.5, 0.19), NAVEL: local(0, 1.0, 0.2), "suprasternale": local(0, 1.3, 0.2)}
        page.get_by_test_id("points-file").set_input_files(
            {
                "name": "a.json",
                "mimeType": "application/json",
                "buffer": json.dumps(given | {"no_such": [0, 0, 0]}).encode(),
            }
        )
        wait(page, "Object.keys(vitruvian.landmarks.points).length === 3")
        assert "1 with names" in said.text_content()
        click(page, "l_acromion", local(0.25, 1.3, 0.05))
        page.keyboard.press(";")
        assert "place a left and a right" in said.text_content()  # three points one above the other say nothing
        click(page, "r_acromion", local(-0.25, 1.3, 0.05))
        click(page, "l_ulnar_styloid", local(0.27, 0.9, 0.05))
        page.keyboard.press(";")
        assert page.evaluate("vitruvian.landmarks.proposed") == ["r_ulnar_styloid"]
        left, right = (np.array(points(page)[f"{s}_ulnar_styloid"]) - local(0, 0, 0) for s in "lr")
        assert np.abs(left * [-1, 1, 1] - right).max() < 6, (left, right)  # mm, by points placed to a pixel
        assert page.locator(".landmark").count() == 7
        with page.expect_download() as waiting:
            page.get_by_test_id("points-download").click()
        assert json.loads(waiting.value.path().read_text()) == points(page)
        page.keyboard.press("Control+z")
        assert "r_ulnar_styloid" not in points(page)
        page.get_by_test_id("points-file").set_input_files(
            {"name": "b.json", "mimeType": "application/json", "buffer": b'{"sellion": [1, 2]}'}
        )
        page.wait_for_timeout(200)
        assert "Expected JSON" in said.text_content() and len(points(page)) == 6
        assert page.get_by_test_id("points-save").is_hidden()


def test_a_file_of_landmarks_is_read_and_saved(tmp_path):
    path = tmp_path / "marks.json"
    path.write_text(json.dumps({NOSE: [1, 2, 3.5]}))
    _, kept = keeping([scan()], path, None)
    showing = Showing(actors_of([scan()]), keeping=kept)
    showing.apply({"type": "set_landmarks", "actor": "scan", "points": {NAVEL: [4, 5, 6]}})
    assert landmarks.read(path)[NAVEL].tolist() == [4, 5, 6] and len(landmarks.read(path)) == 1
    showing.apply({"type": "set_landmarks", "actor": "scan", "points": {}})
    assert landmarks.read(path) == {}
    with pytest.raises(VitruvianError, match="--landmarks FILE"):
        Showing(actors_of([scan()])).apply({"type": "set_landmarks", "actor": "scan", "points": {}})
    for actor in ("no", "capsules"):
        with pytest.raises(VitruvianError, match="expected a mesh"):
            Showing(actors_of([capsule_clip(frames=2), scan()])).apply(
                {"type": "set_landmarks", "actor": actor, "points": {}}
            )
    for text in ("[]", "{", '{"a": [1, 2]}', '{"a": [1, 2, NaN]}', '{"a": [1, 2, "3"]}'):
        path.write_text(text)
        with pytest.raises(VitruvianError, match="marks.json"):
            keeping([scan()], path, None)
    with pytest.raises(VitruvianError, match="expected a scan"):
        keeping([capsule_clip(frames=2)], path, None)
    assert len(features()) == 118 and {f["name"] for f in features() if f["needed"]} == set(NEEDED)


def weights_of(page, body, vertices) -> np.ndarray:
    told = page.evaluate("vs => vs.map((v) => vitruvian.painting.of(v))", [int(v) for v in vertices])
    out = np.zeros((len(vertices), len(body.skeleton)))
    for row, entry in zip(out, told):
        for joint, w in entry.items():
            row[body.skeleton.index[joint]] = w
    return out


def test_a_dab_does_what_paint_does(browser, tmp_path):
    clip = capsule_clip(vertices=1500, frames=2)
    body = clip.body
    everything = range(len(body.skin.rest))
    record(clip, tmp_path / "clip.html")
    with opened(browser, (tmp_path / "clip.html").as_uri(), (1000, 640)) as page:
        wait(page, "vitruvian.painting")
        pause(page)
        find(page, "l_shoulder")
        page.keyboard.press("Escape")
        page.keyboard.press("2")
        page.wait_for_timeout(200)
        wait(page, "!vitruvian.camera.moving")
        page.keyboard.press("7")
        wait(page, "vitruvian.painting.on && vitruvian.mode === 'weights'")
        page.get_by_test_id("brush-radius").fill("120")
        page.get_by_test_id("brush-strength").fill("60")
        before = weights_of(page, body, everything)
        x, y = page.evaluate("vitruvian.screen('l_shoulder')")
        x, y = round(x), round(y)  # clicks are told in whole pixels
        radius = page.evaluate("vitruvian.painting.radius")
        for mode in MODES:
            page.get_by_test_id("brush-mode").select_option(mode)
            under = page.evaluate("p => vitruvian.painting.under(p)", [x, y])
            page.mouse.click(x, y)
            rest = page.evaluate("vitruvian.painting.at")
            np.testing.assert_allclose(rest, under, atol=0.003)  # a slow machine may fly a little yet
            after = weights_of(page, body, everything)
            wanted = paint(body, "l_shoulder", rest, radius=radius, strength=0.6, mode=mode).skin.weights
            assert np.abs(after - before).max() > 0.005
            np.testing.assert_allclose(after, table(wanted, len(body.skeleton)).toarray(), atol=2e-4, err_msg=mode)
            page.keyboard.press("Control+z")
            np.testing.assert_allclose(weights_of(page, body, everything), before, atol=1e-9)


def test_painted_weights_move_the_skin_and_are_saved(browser, tmp_path):
    humanoid = vt.person(loa=1, outfit=None, hair="none")
    things, kept = keeping([Clip(humanoid, vt.pack(humanoid))], None, tmp_path / "w.csv")
    body = things[0].body
    with (
        show(*things, open_browser=False, block=False, keeping=kept) as window,
        opened(browser, window.url, (1000, 640)) as page,
    ):
        wait(page, "vitruvian.painting")
        find(page, "l_elbow")
        page.keyboard.press("Escape")
        page.keyboard.press("1")
        page.wait_for_timeout(200)
        wait(page, "!vitruvian.camera.moving")
        page.keyboard.press("7")
        page.get_by_test_id("brush-strength").fill("100")
        x, y = page.evaluate("vitruvian.screen('l_elbow')")
        page.mouse.move(x, y - 25)
        page.mouse.down()
        for k in range(6):
            page.mouse.move(x, y - 25 + 3 * k)
            page.wait_for_timeout(40)
        page.mouse.up()
        assert page.evaluate("vitruvian.painting.changed") > 10
        said = page.locator("#weights-count").inner_text()
        assert said == f"{page.evaluate('vitruvian.painting.changed')} changed"
        page.keyboard.press("Control+z")
        assert page.locator("#weights-count").inner_text() == ""
        assert page.get_by_test_id("weights-save").is_disabled()
        page.keyboard.press("Control+y")
        assert page.locator("#weights-count").inner_text() == said
        page.get_by_test_id("weights-save").click()
        for _ in range(200):
            if (tmp_path / "w.csv").exists():
                break
            page.wait_for_timeout(50)
        found = table(read_weights(tmp_path / "w.csv", body), len(body.skeleton)).toarray()
        np.testing.assert_allclose(found, weights_of(page, body, range(len(found))), atol=1e-6)
        page.keyboard.press("Control+z")
        assert page.get_by_test_id("weights-save").is_enabled()  # the file on the server still has what was undone
        change = found - table(body.skin.weights, len(body.skeleton)).toarray()
        assert change[:, body.skeleton.index["l_elbow"]].max() > 0.2
        np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-5)
    again, _ = keeping([Clip(humanoid, vt.pack(humanoid))], None, tmp_path / "w.csv")
    np.testing.assert_allclose(table(again[0].body.skin.weights, len(body.skeleton)).toarray(), found, atol=1e-9)
    with pytest.raises(VitruvianError, match="csv or .npz"):
        keeping([Clip(humanoid, body)], None, tmp_path / "w.txt")
    with pytest.raises(VitruvianError, match="expected a body"):
        keeping([scan()], None, tmp_path / "w.csv")
