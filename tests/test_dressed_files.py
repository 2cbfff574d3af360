"""A dressed person in files: each is read again, and the garment is there with its vertices, texture and weights."""

from __future__ import annotations

import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import vitruvian as vt
from pages import opened, wait
from test_dressing import skirt
from test_glb import assert_clean
from vitruvian.cli import app
from vitruvian.cloth.fit_map import fit_map
from vitruvian.cloth.garment import charted
from vitruvian.cloth.obstacle import still
from vitruvian.cloth.resizing import graded, moved, refitted, standing
from vitruvian.cloth.tailor import tailor
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.garment_file import Kept, read_garment, write_garment
from vitruvian.modeling.wearing import worn

runner = CliRunner()


@pytest.fixture(scope="module")
def person():
    return vt.person(outfit=None, hair="none")


@pytest.fixture(scope="module")
def made(person):
    return tailor(skirt(), vt.pack(person), size=0.03)


@pytest.fixture(scope="module")
def dressed(person, made):
    uv, corners = charted(made)
    return worn(person, made.vertices, made.triangles, made.matrices, uv=uv, uv_triangles=corners)


def garment_of(humanoid):
    """Its Shape, the rows of its points, in the order of the file, and a row of weights (n,J) for each."""
    shape = next(s for s in humanoid.skin if s.name.removeprefix("hanim_") == "garment")
    used = np.unique(shape.triangles)
    body = vt.pack(humanoid)
    w = body.skin.weights
    table = np.zeros((len(body.skin.rest), len(body.skeleton)))
    np.add.at(table, (w.vertex, w.joint), w.weight)
    return shape, used, table[used], body


@pytest.mark.parametrize("ending", [".glb", ".x3d", ".x3dv", ".x3dj", ".wrl", ".usda"])
@pytest.mark.filterwarnings("ignore::vitruvian.errors.VitruvianWarning")
def test_the_garment_comes_back(ending, dressed, made, tmp_path):
    if ending == ".usda":
        pytest.importorskip("pxr", reason="needs usd-core: pip install 'vitruvian[usd]'")
    path = tmp_path / f"dressed{ending}"
    vt.save(dressed, path)
    back = vt.load(path)
    shape, used, weights, body = garment_of(back)
    own, rows, ours, packed = garment_of(dressed)
    assert len(used) == len(made.vertices) and len(shape.triangles) == len(made.triangles)
    assert np.array_equal(np.searchsorted(used, shape.triangles), made.triangles)  # the same corners, in the same order
    assert np.abs(back.skin_coord[used] - dressed.skin_coord[rows]).max() < 1e-5
    assert np.abs(shape.uv[shape.uv_triangles] - own.uv[own.uv_triangles]).max() < 1e-5
    index = [body.skeleton.names.index(n) if n in body.skeleton.names else -1 for n in packed.skeleton.names]
    assert np.abs(weights.sum(axis=1) - 1).max() < 1e-3
    if ending != ".wrl":  # H-Anim 200x has fewer joints
        most = 0.15 if ending == ".glb" else 1e-6  # glTF: the four largest of each point
        assert np.abs(weights[:, index] - ours).max() < most and np.abs(weights[:, index] - ours).mean() < 1e-3
    posed = vt.deformer("log", body)(vt.joint_matrices(body.skeleton))[0][used]
    off = np.linalg.norm(posed - made.vertices, axis=1)
    assert off.max() < (1e-3 if ending == ".glb" else 1e-6) and off.mean() < 1e-5


@pytest.mark.filterwarnings("ignore::vitruvian.errors.VitruvianWarning")
def test_an_obj_holds_it_as_draped(dressed, made, tmp_path):
    vt.save(dressed, tmp_path / "dressed.obj")
    mesh = vt.load(tmp_path / "dressed.obj")
    n, m = len(made.vertices), len(made.triangles)
    assert np.abs(mesh.vertices[-n:] - made.vertices).max() < 2e-4
    assert np.array_equal(mesh.triangles[-m:] - (len(mesh.vertices) - n), made.triangles)
    uv, corners = charted(made)
    assert np.abs(mesh.uv[mesh.uv_triangles[-m:]] - uv[corners]).max() < 1e-5


def test_khronos_validator_finds_nothing(dressed, tmp_path, referee: Path):
    vt.save(dressed, tmp_path / "dressed.glb")
    assert_clean([tmp_path / "dressed.glb"], referee)


def kept_of(person, made) -> Kept:
    there = standing(made, vt.pack(person))
    return Kept(made, there.vertices, there.body.skin.triangles)


def test_a_garment_file_is_the_same_garment(person, made, tmp_path):
    path = tmp_path / "skirt.garment.npz"
    kept = kept_of(person, made)
    write_garment(kept, path)
    back = read_garment(path)
    for name in ("vertices", "weld", "matrices"):
        assert np.array_equal(getattr(back.garment, name), getattr(made, name))
    for name in ("material", "grain", "triangles", "panel", "pairs", "seam"):
        assert np.array_equal(getattr(back.garment.mesh, name), getattr(made.mesh, name))
    assert set(back.garment.mesh.edges) == set(made.mesh.edges)
    assert all(np.array_equal(v, made.mesh.edges[k]) for k, v in back.garment.mesh.edges.items())
    assert back.garment.fabrics == made.fabrics and back.garment.pattern.seams == made.pattern.seams
    assert np.array_equal(back.garment.sheet.material, made.sheet.material)
    assert back.garment.report["settled"] == made.report["settled"] and back.garment.graded is None
    assert np.array_equal(back.skin, kept.skin) and np.array_equal(back.triangles, kept.triangles)
    larger = graded(moved(made, kept.skin, 1.1 * kept.skin, kept.triangles), made)
    write_garment(Kept(larger, 1.1 * kept.skin, kept.triangles), path)
    assert np.array_equal(read_garment(path).garment.sheet.material, larger.sheet.material)
    with pytest.raises(VitruvianError, match="garment.npz"):
        write_garment(kept, tmp_path / "skirt.npz")
    with pytest.raises(VitruvianError, match="keep each in a file of its own"):
        write_garment(replace(kept, garment=replace(made, below=(made,))), path)


def test_what_is_worn_below_follows_too(person, made):
    body = vt.pack(person)
    both = refitted(replace(made, below=(made,)), body, body)
    assert np.array_equal(both.below[0].vertices, made.vertices) and np.array_equal(both.vertices, made.vertices)


def spoiled(path: Path, name: str, value: object) -> None:
    with np.load(path) as whole:
        arrays = dict(whole)
    if value is None:
        del arrays[name]
    else:
        arrays[name] = value
    np.savez(path, **arrays)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("vertices", None, "expected an array vertices"),
        ("vertices", np.full((3, 3), np.nan), "vertices"),
        ("weld", np.full(4, 10**6), "weld"),
        ("triangles", np.array([[0, 1, 10**7]]), "triangles"),
        ("panel", np.array([-1]), "panel"),
        ("graded", np.zeros((1, 3, 2)), "graded"),
        ("edges", np.array([0]), "edges"),
        ("skin_triangles", np.array([[0, 1, 10**7]]), "skin_triangles"),
        ("head", np.frombuffer(b"[1, 2", np.uint8), "expected JSON"),
        ("head", np.frombuffer(b"{}", np.uint8), "vitruvian_garment"),
        ("head", np.frombuffer(b'{"vitruvian_garment": 1, "pattern": 3}', np.uint8), "pattern"),
        ("matrices", np.array([{"a": 1}], object), "pickles are never read"),
    ],
)
def test_spoiled_garment_files_are_refused_in_a_line(name, value, said, person, made, tmp_path):
    path = tmp_path / "skirt.garment.npz"
    write_garment(kept_of(person, made), path)
    spoiled(path, name, value)
    with pytest.raises(FileError, match=said):
        read_garment(path)


def test_other_files_are_no_garments(tmp_path):
    path = tmp_path / "x.garment.npz"
    for data in (b"", b"PK\x03\x04 no", b"text"):
        path.write_bytes(data)
        with pytest.raises(FileError):
            read_garment(path)
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("a.npy", b"")
    with pytest.raises(FileError, match="expected a garment"):
        read_garment(path)


@pytest.fixture(scope="module")
def cut_to_measure(tmp_path_factory):
    """A coarse garment on the built-in person as `dress` makes it, in a file."""
    from vitruvian.cli.refitting import kept

    person = vt.person(outfit=None)
    path = tmp_path_factory.mktemp("kept") / "skirt.garment.npz"
    kept(tailor(skirt(), vt.pack(person), size=0.04), person, path)
    return path


def test_refit_follows_the_persons_measures(cut_to_measure, tmp_path):
    out, fit = tmp_path / "larger.garment.npz", tmp_path / "fit.json"
    wide = ["person", "--measure", "hips=108", "--measure", "waist=92"]
    args = ["refit", str(cut_to_measure), *wide, "-o", str(out), "--fit-map", str(fit), "--json"]
    kept = runner.invoke(app, args)
    said = json.loads(kept.stdout)
    assert out.exists() and said["policy"] == "keep_pattern" and (kept.exit_code == 1) == bool(said["reasons"])
    tight = json.loads(fit.read_text())
    assert set(tight["panels"]) == {"front", "back"} and "hips, front" in tight["regions"]
    assert tight["findings"] and any("hips" in line or "waist" in line for line in tight["findings"])
    args = ["refit", str(cut_to_measure), *wide, "-o", str(out), "--fit-map", str(fit), "--policy", "grade", "--json"]
    grown = runner.invoke(app, args)
    assert grown.exit_code == 0 and json.loads(grown.stdout)["strain_p99"] < said["strain_p99"]
    easy = json.loads(fit.read_text())
    assert easy["all"]["strain_percent"]["p99"] < 0.5 * tight["all"]["strain_percent"]["p99"]
    assert easy["all"]["pressure_kpa"]["mean"] < tight["all"]["pressure_kpa"]["mean"]


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--policy", "stretch"], "expected keep_pattern, grade, draft"),
        (["--fit-map", "x.pdf"], "expected .png, .html or .json"),
        (["--policy", "draft"], "expected a pattern of our own"),
        (["--measure", "hips"], "NAME=CM"),
    ],
)
def test_refit_refuses_in_a_line(more, said, cut_to_measure, tmp_path):
    done = runner.invoke(app, ["refit", str(cut_to_measure), "person", "-o", str(tmp_path / "x.glb"), *more])
    assert done.exit_code != 0 and isinstance(done.exception, VitruvianError) and said in str(done.exception)


def test_dress_sorts_cloth_into_layers(tmp_path):
    out, fit = tmp_path / "skirt.garment.npz", tmp_path / "fit.png"
    args = ["dress", "person", "skirt", "--size", "40", "-o", str(out)]
    done = runner.invoke(app, [*args, "--layers", "--fit-map", str(fit), "--json"])
    usual = json.loads(done.stdout)["layers"]["skirt"]
    assert sum(usual.values()) == pytest.approx(1, abs=1e-3) and usual["floating"] > 0.3 and fit.stat().st_size > 5000
    kept = read_garment(out).garment.hung
    assert kept is not None and usual["tight"] == pytest.approx((kept.layer == 0).mean(), abs=1e-4)
    done = runner.invoke(app, [*args, "--edge", "trunk=0,0", "--edge", "l_thigh=0,0", "--edge", "r_thigh=0,0"])
    assert "100% floating" in done.stdout
    assert "--layers" not in done.stdout and read_garment(out).garment.hung is not None


@pytest.mark.parametrize(
    ("edge", "said"),
    [("trunk", "REGION=TIGHT,LOOSE"), ("trunk=8", "REGION=TIGHT,LOOSE"), ("tail=1,2", "l_thigh"),
     ("trunk=9,3", "TIGHT <= LOOSE"),
     ("trunk=nan,3", "TIGHT <= LOOSE")],
)  # fmt: skip
def test_distances_of_layers_that_cannot_be_are_refused(edge, said, tmp_path):
    done = runner.invoke(app, ["dress", "person", "skirt", "--edge", edge, "-o", str(tmp_path / "x.garment.npz")])
    assert done.exit_code != 0 and isinstance(done.exception, VitruvianError) and said in str(done.exception)


def test_a_fit_map_is_a_picture_and_a_page(person, made, tmp_path):
    from vitruvian.show.fit_view import fit_view, sheet
    from vitruvian.show.recording import record

    kept = kept_of(person, made)
    found = fit_map(made, still(kept.skin, standing(made, vt.pack(person)).triangles))
    view = fit_view(found, kept.skin, kept.triangles, made.vertices, name="skirt")
    assert [layer.name for layer in view.layers] == ["strain", "pressure", "ease"]
    n = len(made.vertices)
    for layer in view.layers:
        assert np.isnan(layer.values[:-n]).all() and np.isfinite(layer.values[-n:]).all() and layer.high > layer.low
    assert np.allclose(view.layers[2].values[-n:], 1000 * found.ease)
    pixels = sheet(view, tmp_path / "fit.png", height=160)
    colored = np.abs(pixels.astype(int) - pixels.mean(axis=2, keepdims=True)).max(axis=2) > 40
    assert colored.mean() > 0.01 and (tmp_path / "fit.png").stat().st_size > 5000
    assert record(view, tmp_path / "fit.html")["bytes"] > 100_000
    with pytest.raises(VitruvianError, match="png"):
        sheet(view, tmp_path / "fit.jpg")


def test_the_page_switches_between_what_it_knows_of_the_fit(person, made, tmp_path, browser):
    from vitruvian.show.fit_view import fit_view
    from vitruvian.show.recording import record

    kept = kept_of(person, made)
    found = fit_map(made, still(kept.skin, standing(made, vt.pack(person)).triangles))
    view = fit_view(found, kept.skin, kept.triangles, made.vertices, name="skirt")
    view = replace(view, findings=tuple(f"place {k}" for k in range(6)))
    kinds = np.arange(len(made.vertices)) % 3
    view = replace(view, layers=fit_view(found, kept.skin, kept.triangles, made.vertices, kinds=kinds).layers)
    record(view, tmp_path / "fit.html")
    with opened(browser, (tmp_path / "fit.html").as_uri(), size=(900, 700)) as page:
        wait(page, "vitruvian.heat && vitruvian.heat.on")
        title = page.locator("#heat-title")
        assert title.text_content() == "strain, %"
        page.get_by_test_id("heat-pressure").click()
        assert title.text_content() == "pressure, kPa"
        assert page.evaluate("vitruvian.heat.reach") == pytest.approx(view.layers[1].high)
        first = page.evaluate("vitruvian.heat.color(0)")
        assert first == pytest.approx(view.layers[1].ramp[0].tolist(), abs=1e-3)
        page.get_by_test_id("heat-layers").click()
        assert title.text_content() == "layers" and page.locator("#heat-ticks").text_content() == "tightloosefloating"
        assert page.evaluate("vitruvian.heat.color(2)") == pytest.approx(view.layers[3].ramp[2].tolist(), abs=1e-3)
        page.get_by_test_id("heat-pressure").click()
        assert page.locator("#heat-ticks span").first.text_content() == "0"
        page.keyboard.press(":")
        assert title.text_content() == "ease, mm" and not page.get_by_test_id("heat-map").is_visible()
        assert (
            page.locator("#heat-findings > p").count() == 4
            and "2 more" in page.locator("#heat-findings").text_content()
        )
