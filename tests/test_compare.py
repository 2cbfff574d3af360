"""The page's view of deformers side by side, and the commands that measure them."""

from __future__ import annotations

import json
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

import skins
import vitruvian as vt
from capsules import capsule_clip
from pages import find, opened, pause, scrub, slide, wait
from test_quality import cylinder
from vitruvian.cli import app
from vitruvian.deform.deformer import deformer
from vitruvian.deform.quality import quality
from vitruvian.deform.trials import trial
from vitruvian.errors import VitruvianError
from vitruvian.show.actors import actors_of, mesh_messages
from vitruvian.show.live import show
from vitruvian.show.recording import record
from vitruvian.show.wire import decode


def shown(page):
    return {c["deformer"]: c for c in page.evaluate("vitruvian.compared")}


def test_columns_measure_as_the_package_does_while_a_joint_is_dragged(browser, tmp_path):
    clip = capsule_clip(vertices=1500, frames=6)
    record(clip, tmp_path / "clip.html")
    with opened(browser, (tmp_path / "clip.html").as_uri(), (900, 700)) as page:
        pause(page)
        scrub(page, 0)
        page.keyboard.press("q")
        wait(page, "vitruvian.compared.length === 3 && vitruvian.compared.every((c) => c.whole)")
        assert [*shown(page)] == ["linear", "log", "volume"]  # a body without contours and hands
        page.locator("[data-testid=compare-choose-3]").select_option("dual-quaternion")
        assert [*shown(page)] == ["linear", "log", "dual-quaternion"]
        page.locator("[data-testid=compare-choose-1]").select_option("log")  # the two change places
        assert [*shown(page)] == ["log", "linear", "dual-quaternion"]
        page.get_by_test_id("compare-remove-3").click()
        find(page, "l_elbow")
        before = shown(page)["linear"]["whole"]
        slide(page, "slider-l_elbow-x", -120)
        wait(page, "(document.querySelector('[data-testid=quality-linear] dd').textContent ?? '') !== '' "
             f"&& Math.abs(vitruvian.compared[1].whole.thickness - {before['thickness']}) > 0.02")  # fmt: skip
        found = shown(page)
        assert "Round l_elbow" in page.get_by_test_id("compare-linear").inner_text()
        with page.expect_download() as saved:
            page.get_by_test_id("export-pose").click()
        skeleton = clip.body.skeleton
        rotation = np.tile([0.0, 0, 0, 1], (len(skeleton), 1))
        for joint, (x, y, z, angle) in json.loads(saved.value.path().read_text()).items():
            rotation[skeleton.index[joint]] = [*(np.array([x, y, z]) * np.sin(angle / 2)), np.cos(angle / 2)]
        matrices = vt.joint_matrices(replace(skeleton, rotation=rotation))[0]
        for name in ("linear", "log"):
            points = deformer(name, clip.body)(matrices)
            wanted = quality(clip.body, points, matrices).joints["l_elbow"].document()
            theirs = found[name]["joints"]["l_elbow"]
            for field in ("volume", "area", "thickness", "bulge"):
                if wanted[field] is not None:
                    assert theirs[field] == pytest.approx(wanted[field], rel=2e-3), (name, field)
            text = page.get_by_test_id(f"quality-{name}-volume").text_content()
            assert text == f"{theirs['volume']:.3f}"
        page.get_by_test_id("undo").click()
        wait(page, f"Math.abs(vitruvian.compared[1].whole.thickness - {before['thickness']}) < 1e-3")
        page.keyboard.press("z")
        wait(page, "vitruvian.mode === 'stripes'")
        assert "compare=log%2Clinear" in page.url and "stripes=1" in page.url
        page.reload()
        wait(page, "vitruvian.mode === 'stripes' && vitruvian.compared.length === 2")
        page.keyboard.press("q")
        wait(page, "vitruvian.compared.length === 0")
        assert "compare" not in page.url and page.get_by_test_id("compare-view").is_hidden()


def test_columns_show_different_surfaces_under_one_camera(browser):
    clip = capsule_clip(vertices=1500, frames=6)
    with (
        show(clip, open_browser=False, block=False) as window,
        opened(browser, window.url + "&compare=linear,log&stripes=1", (800, 600)) as page,
    ):
        pause(page)
        find(page, "l_elbow")
        slide(page, "slider-l_elbow-x", -140)
        page.keyboard.press("Escape")
        page.wait_for_timeout(800)
        picture = np.asarray(Image.open(BytesIO(page.screenshot())).convert("RGB")).astype(int)
        boxes = [page.get_by_test_id(f"compare-{n}").locator(".view").bounding_box() for n in ("linear", "log")]
        views = [picture[round(b["y"]) + 4 :, round(b["x"]) + 4 :][: int(b["height"]) - 8, : int(b["width"]) - 8]
                 for b in boxes]  # fmt: skip
        assert views[0].shape == views[1].shape and min(views[0].shape[:2]) > 100
        for view in views:  # light and dark stripes on a figure that stands in the middle
            assert np.ptp(view[:, view.shape[1] // 3 : -view.shape[1] // 3].sum(axis=2)) > 250
        different = (np.abs(views[0] - views[1]).max(axis=-1) > 40).mean()
        assert 0.0005 < different < 0.2
        assert page.evaluate("vitruvian.connected")


def test_a_person_is_compared_with_itself_in_contours(browser, tmp_path):
    humanoid = vt.person(loa=1, outfit="body suit", hair="none")
    (actor,) = actors_of([humanoid], compare=True)
    assert actor.twin is not None and len(actor.twin.contours) == 11
    headers = [decode(m)[0] for m in mesh_messages(actor)]
    assert [h.get("twin", "") for h in headers] == ["", actor.name] and len(
        mesh_messages(actors_of([humanoid])[0])
    ) == 1
    record(humanoid, tmp_path / "person.html", compare=True)
    with opened(browser, (tmp_path / "person.html").as_uri() + "#compare=linear,contours", (700, 500)) as page:
        wait(page, "vitruvian.compared.length === 2 && vitruvian.compared.every((c) => c.whole)")
        assert [*shown(page)] == ["linear", "contours"] and len(page.evaluate("vitruvian.actors")) == 1
        find(page, "l_knee")
        slide(page, "slider-l_knee-x", 100)
        wait(page, "vitruvian.compared.every((c) => c.joints.l_knee?.area < 0.9999)")
        found = shown(page)
        assert found["linear"]["joints"]["l_knee"]["area"] < 0.75 < found["contours"]["joints"]["l_knee"]["area"]
        assert found["contours"]["whole"]["gap"] < 1e-6


def test_a_trial_finds_the_worst_pose(tmp_path):
    body = cylinder()
    poses = np.stack([skins.turned((1, 0, 0), a) for a in (10, 90, 45)])
    found = trial(deformer("linear", body), poses)
    assert len(found.reports) == 3 and found.where["thickness"] == (1, "j1") and found.where["volume"] == (1, "")
    assert found.worst.thickness == pytest.approx(np.cos(np.pi / 4), abs=1e-6)
    assert found.worst.volume == pytest.approx(0.9515, abs=1e-4)
    single = trial(deformer("linear", body), poses[1], joints=("j1",))
    assert single.worst == found.reports[1].whole and json.dumps(single.document())
    assert found.where["bulge"] == (2, "j1") and found.worst.bulge > single.worst.bulge  # the most at 45 degrees
    still = trial(deformer("linear", body), skins.turned((1, 0, 0), 0))
    assert still.worst.volume == pytest.approx(1, abs=1e-6)
    assert np.isnan(still.worst.area) and still.where["area"] == (0, "")
    with pytest.raises(VitruvianError, match="at least one pose"):
        trial(deformer("linear", body), poses[:0])


@pytest.fixture(scope="module")
def person_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("compare") / "person.x3d"
    vt.save(vt.person(loa=1, outfit="body suit", hair="none"), path)
    return str(path)


def test_the_command_measures_poses_and_motions(person_file):
    poses = json.dumps([{"l_elbow": [1, 0, 0, -0.5]}, {"l_elbow": [1, 0, 0, -2.0]}])
    args = ["quality", person_file, "--deformers", "linear,log", "--joints", "l_elbow"]
    answer = CliRunner().invoke(app, [*args, "--poses", poses, "--json"])
    assert answer.exit_code == 0, answer.output
    document = json.loads(answer.stdout)
    assert document["poses"] == 2 and [*document["deformers"]] == ["linear", "log"]
    linear, log = (document["deformers"][n] for n in ("linear", "log"))
    assert linear["where"]["area"] == {"pose": 1, "joint": "l_elbow"} and len(linear["poses"]) == 2
    assert linear["worst"]["area"] < log["worst"]["area"] and log["worst"]["gap"] < 1e-6
    assert linear["poses"][1]["joints"]["l_elbow"]["area"] == linear["worst"]["area"]
    table = CliRunner().invoke(app, [*args, "--poses", "walk", "--every", "12"])
    assert table.exit_code == 0 and "worst of" in table.stdout and "gap_mm" in table.stdout


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--deformers", "linear,best"], "found 'best'"),
        (["--deformers", ","], "--deformers: expected names"),
        (["--poses", "[]"], "1 to 2000 poses"),
        (["--poses", "[1]"], "pose 0"),
        (["--poses", '{"l_fin": [1, 0, 0, 1]}'], "l_fin is not a joint"),
        (["--poses", '{"l_knee": [1, 0, 0, NaN]}'], "finite"),
        (["--poses", "missing.json"], "can't read missing.json"),
        (["--joints", "l_fin"], "no joint l_fin"),
    ],
)
def test_bad_requests_are_one_line(person_file, extra, message):
    answer = CliRunner().invoke(app, ["quality", person_file, *extra])
    assert isinstance(answer.exception, VitruvianError) and message in str(answer.exception)


def test_the_sheet_can_do_without_stripes(person_file, tmp_path):
    pictures = []
    for option in ("--stripes", "--no-stripes"):
        out = tmp_path / f"sheet{option}.png"
        args = ["render", person_file, "--compare", "log", "--pose", '{"l_knee": [1, 0, 0, 1]}', option, "-o", str(out)]
        assert CliRunner().invoke(app, args).exit_code == 0
        pictures.append(np.asarray(Image.open(out)).astype(int))
    changed = np.abs(pictures[0] - pictures[1])[40:540].max(axis=-1) > 60
    assert 0.02 < changed.mean() < 0.4
