"""Distances between surfaces: their figures against known ones, pictures, commands, the page."""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import vitruvian as vt
from pages import opened, wait
from vitruvian.errors import VitruvianError, VitruvianWarning
from vitruvian.modeling import shrink
from vitruvian.modeling.gaps import gaps, metres
from vitruvian.show.heat import HOLE, colors, heat, ramp, reach_of, sheet
from vitruvian.show.live import show
from vitruvian.show.recording import record
from vitruvian.stage.clip import Clip, Mesh


def ball(radius: float, up: float = 1.0, detail: int = 4) -> Mesh:
    made = trimesh.creation.icosphere(detail, radius)
    return Mesh(np.asarray(made.vertices) + [0, up, 0], np.asarray(made.faces, np.int32), name="ball")


def run(*args: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "vitruvian", *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


def test_concentric_balls_are_their_radii_apart() -> None:
    inner, outer = ball(0.5), ball(0.51)
    other, _ = shrink.surface_of(outer.vertices, outer.triangles)
    found = gaps(inner.vertices, inner.triangles, other)
    np.testing.assert_allclose(found.mm, -10, atol=0.5)  # the faceting of the balls
    numbers = found.numbers()
    assert numbers["bias_mm"] < 0 < numbers["mean_mm"] and found.holes == 0
    assert numbers["mean_mm"] == pytest.approx(-numbers["bias_mm"]) and numbers["p95_mm"] <= numbers["max_mm"]
    back = gaps(outer.vertices, outer.triangles, shrink.surface_of(inner.vertices, inner.triangles)[0])
    np.testing.assert_allclose(back.mm, 10, atol=0.5)
    for mine, theirs in ((1, -1), (-1, 1), (-1, -1)):  # inside out, either or both
        other, _ = shrink.surface_of(outer.vertices, outer.triangles[:, ::theirs])
        turned = gaps(inner.vertices, inner.triangles[:, ::mine], other)
        np.testing.assert_allclose(turned.mm, found.mm, atol=1e-9)


def test_a_distance_weighs_by_its_area() -> None:
    """A plane of two halves, one finely and one coarsely cut: points would count the fine half more."""
    x = np.concatenate([np.linspace(0, 1, 41), [1.5, 2.0]])
    grid = np.array([[a, 0.0, b] for b in (0.0, 0.5, 1.0) for a in x])
    n = len(x)
    cells = [(j * n + i, j * n + i + 1, j * n + n + i) for j in range(2) for i in range(n - 1)]
    cells += [(j * n + i + 1, j * n + n + i + 1, j * n + n + i) for j in range(2) for i in range(n - 1)]
    faces = np.array(cells)[:, ::-1]
    grid[:, 1] = np.where(grid[:, 0] > 1, 0.01, 0.0)
    flat = np.array([[-1, 0, -1], [3, 0, -1], [-1, 0, 3], [3, 0, 3]], float)
    under, _ = shrink.surface_of(flat, np.array([[0, 2, 1], [1, 2, 3]]))
    numbers = gaps(grid, faces, under).numbers()
    assert 3.5 < numbers["mean_mm"] < 6.5 and numbers["max_mm"] == pytest.approx(10)
    assert numbers["bias_mm"] == pytest.approx(numbers["mean_mm"])


def test_holes_are_grey_and_do_not_count() -> None:
    whole = ball(0.5)
    kept = whole.vertices[whole.triangles].mean(axis=1)[:, 1] < 1.3
    torn = Mesh(whole.vertices, whole.triangles[kept], name="torn")
    found = heat(ball(0.505), torn, unit="m")
    top = found.gaps.mm[ball(0.505).vertices[:, 1] > 1.36]
    assert np.isnan(top).all() and 0.1 < found.gaps.holes < 0.3
    assert found.gaps.numbers()["max_mm"] < 12
    paint = colors(found.gaps.mm, found.reach)
    np.testing.assert_allclose(paint[np.isnan(found.gaps.mm)], np.tile(HOLE, (np.isnan(found.gaps.mm).sum(), 1)))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        nothing = heat(ball(0.5), ball(0.5, up=3.0), unit="m")
    assert nothing.gaps.holes == 1 and "nothing of the other" in str(said[0].message)
    assert nothing.gaps.numbers()["mean_mm"] is None
    json.dumps(nothing.told(), allow_nan=False)


@given(st.sampled_from(["m", "cm", "mm", "in", "dm", "ft"]), st.floats(0.95, 1.05))
def test_units_are_those_that_bring_sizes_together(unit: str, off: float) -> None:
    size = {"m": 1.0, "cm": 100, "mm": 1000, "in": 1 / 0.0254, "dm": 10, "ft": 1 / 0.3048}[unit]
    assert metres(1.8 * size * off, 1.8) * size == pytest.approx(1)
    with pytest.raises(VitruvianError, match="--unit"):
        metres(1.0, 1.0, "yard")


def test_colours_go_evenly_from_blue_to_red() -> None:
    table = ramp()
    luma = table**2.2 @ [0.2126, 0.7152, 0.0722]
    half = len(table) // 2
    assert (np.diff(luma[: half + 1]) > 0).all() and (np.diff(luma[half:]) < 0).all()
    assert table[0, 2] > table[0, 0] + 0.3 and table[-1, 0] > table[-1, 2] + 0.3
    assert np.ptp(table[half]) < 0.02 and table[half].min() > 0.9
    steps = np.abs(np.diff(table**2.2, axis=0)).sum(axis=1)
    assert steps.max() < 0.2
    np.testing.assert_array_equal(colors(np.array([-9.0, 0, 9, np.nan]), 2.0)[[0, 2]], table[[0, -1]])


@pytest.fixture(scope="module")
def person() -> Clip:
    made = vt.person(outfit=None, hair="short")
    return Clip(made, vt.pack(made))


@pytest.fixture(scope="module")
def swollen(person: Clip) -> Mesh:
    """The person's bare skin in centimetres, its left thigh 4 mm thicker."""
    skin = person.body.skin
    strong = skin.weights.top(1)[0][:, 0]
    thigh = strong == person.body.skeleton.index["l_hip"]
    normals = shrink.vertex_normals(skin.rest, skin.triangles)
    points = skin.rest + 0.004 * thigh[:, None] * normals
    return Mesh(points * 100, skin.triangles, name="scan")


def test_the_part_that_is_off_is_named(person, swollen) -> None:
    found = heat(person, swollen)
    numbers = found.gaps.numbers()
    parts = numbers["parts"]
    assert set(parts) >= {"trunk", "head", "left thigh", "right thigh", "left hand", "right foot"}
    assert parts["left thigh"]["bias_mm"] == pytest.approx(-4, abs=0.5)
    assert all(abs(p["bias_mm"]) < 0.35 for n, p in parts.items() if n not in ("left thigh", "trunk"))
    assert max(parts, key=lambda n: parts[n]["mean_mm"]) == "left thigh"
    share, edges = found.gaps.histogram(found.reach)
    assert share.sum() == pytest.approx(1) and len(edges) == len(share) + 1
    assert found.reach == reach_of(found.gaps) and np.ptp(found.other.vertices[:, 1]) < 3


def test_pictures_match_their_bar(person, swollen, tmp_path) -> None:
    found = replace(heat(person, swollen, name="anna"), reach=5.0)
    pixels = sheet(found, tmp_path / "heat.png")
    assert (tmp_path / "heat.png").read_bytes()[:4] == b"\x89PNG" and pixels.shape[0] == 750
    blue = (pixels[:600, :, 2].astype(int) - pixels[:600, :, 0]) > 60
    rows, columns = np.nonzero(blue)
    assert len(rows) > 300 and 280 < rows.mean() < 460  # the thigh, from in front and behind
    with pytest.raises(VitruvianError, match=r"\.png"):
        sheet(found, tmp_path / "heat.jpg")


def test_commands_write_maps(person, swollen, tmp_path) -> None:
    vt.save(swollen, tmp_path / "scan.obj")
    vt.save(person.humanoid, tmp_path / "anna.x3d")
    done = run("render", tmp_path / "anna.x3d", "--against", tmp_path / "scan.obj", "-o", tmp_path / "a.png", "--json")
    answer = json.loads(done.stdout)
    assert done.returncode == 0 and answer["parts"]["left thigh"]["bias_mm"] == pytest.approx(-4, abs=0.5)
    assert {"mean_mm", "p95_mm", "max_mm", "holes", "back"} <= set(answer)
    other = run("render", tmp_path / "scan.obj", "--against", tmp_path / "anna.x3d", "-o", tmp_path / "b.html")
    assert other.returncode in (0, 2) and (other.returncode == 0 or other.stderr.count("error:") == 1)
    for words, text in (
        (["--against", tmp_path / "none.obj"], "none.obj"),
        (["--against", tmp_path / "scan.obj", "--unit", "yard"], "--unit"),
        (["--range", "3"], "--against"),
        (["--against", tmp_path / "scan.obj", "--compare", "log"], "--against"),
    ):
        bad = run("render", tmp_path / "anna.x3d", "-o", tmp_path / "c.png", *words)
        assert bad.returncode == 2 and text in bad.stderr and bad.stderr.count("\n") == 1
    assert not (tmp_path / "c.png").exists()


def test_the_page_shows_the_map_and_both_surfaces(browser, person, swollen, tmp_path) -> None:
    found = replace(heat(person, swollen, name="anna", against="the scan"), reach=5.0)
    record(found, tmp_path / "heat.html", found.other)
    with opened(browser, (tmp_path / "heat.html").as_uri(), (1000, 640)) as page:
        wait(page, "vitruvian.heat && vitruvian.heat.on")
        page.keyboard.press("1")
        page.wait_for_timeout(300)
        wait(page, "!vitruvian.camera.moving")
        legend = page.get_by_test_id("heat-legend")
        assert "−5" in legend.text_content() and "left thigh" in legend.text_content()
        for mm in (-4.0, 0.0, 2.5, None):
            ours = colors(np.array([np.nan if mm is None else mm]), 5.0)[0]
            theirs = page.evaluate(f"vitruvian.heat.color({'NaN' if mm is None else mm})")
            np.testing.assert_allclose(theirs, ours, atol=2e-4)
        thigh = np.flatnonzero(found.gaps.mm < -3.8)
        rest = person.body.skin.rest
        front = thigh[np.argmax(rest[thigh, 2] - 4 * np.abs(rest[thigh, 1] - np.median(rest[thigh, 1])))]
        spots = {int(front): found.gaps.mm[front]}
        even = np.flatnonzero((np.abs(found.gaps.mm) < 0.3) & (rest[:, 1] > 1.1) & (rest[:, 1] < 1.3))
        middle = even[np.argmax(rest[even, 2] - 2 * np.abs(rest[even, 0]))]
        spots[int(middle)] = found.gaps.mm[middle]
        page.wait_for_timeout(600)
        for vertex, mm in spots.items():
            x, y = page.evaluate("p => vitruvian.pixel(p)", rest[vertex].tolist())
            page.mouse.move(x, y)
            page.wait_for_timeout(250)
            text = page.locator("#label").text_content().replace("−", "-")
            assert float(text.removesuffix(" mm")) == pytest.approx(mm, abs=1.0), (text, mm)
        shown = []
        for _ in range(3):
            shown.append(page.evaluate("vitruvian.heat.shown"))
            page.keyboard.press(":")
        assert shown == ["map", "other", "both"] and page.evaluate("vitruvian.heat.shown") == "map"
        page.get_by_test_id("heat-range").fill("0")
        assert page.evaluate("vitruvian.heat.reach") == 1 and "+1" in legend.text_content()
        page.keyboard.press("*")
        assert page.evaluate("vitruvian.mode") == "skin" and legend.is_hidden()
        page.keyboard.press("*")
        assert legend.is_visible()


def test_meshes_are_shown_with_maps_too(browser) -> None:
    found = heat(ball(0.5), ball(0.51), unit="m", name="inner", against="outer")
    with (
        show(found, found.other, open_browser=False, block=False) as window,
        opened(browser, window.url, (700, 500)) as page,
    ):
        wait(page, "vitruvian.heat && vitruvian.heat.on")
        assert page.evaluate("vitruvian.heat.numbers.bias_mm") == pytest.approx(-10, abs=0.5)
        page.keyboard.press(":")
        assert page.evaluate("vitruvian.heat.shown") == "other"
        assert page.evaluate("vitruvian.heat.reach") == 10 or page.evaluate("vitruvian.heat.reach") == 20


def test_a_warning_says_that_poses_differ(person, swollen) -> None:
    moved = Mesh(swollen.vertices + [0, 0, 50], swollen.triangles)
    with pytest.warns(VitruvianWarning, match="--pose-out"):
        heat(person, moved)
