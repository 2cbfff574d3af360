"""What was captured, shown: markers on the body they move, and a clip's own skeleton beside its target."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vitruvian as vt
from capsules import capsule_clip
from pages import opened, pause, scrub, wait
from vitruvian.body.kinematics import joint_matrices, joint_positions
from vitruvian.body.types import Skeleton, Weights
from vitruvian.cli.captured import moved
from vitruvian.errors import VitruvianError
from vitruvian.motion.calibration import groups, scaled
from vitruvian.motion.types import Motion
from vitruvian.show.actors import actors_of
from vitruvian.show.marked import Marked, proportioned
from vitruvian.show.recording import record
from vitruvian.show.showing import Showing
from vitruvian.show.sticks import Sticks, sticks
from vitruvian.show.wire import decode

NAMES = ("LASI", "RSHO", "LKNE")
OFF = np.array([[0.0, 0.0, 0.005], [0.02, 0.0, 0.0], [0.0, 0.04, 0.0]])  # metres from where they sit


def marked_clip(frames: int = 12) -> Marked:
    """Capsules with three markers beside their places, one of which is gone from frame 6 on."""
    clip = capsule_clip(vertices=1500, frames=frames)
    s = clip.body.skeleton
    joint = np.array([s.index[n] for n in ("humanoid_root", "r_shoulder", "l_knee")], np.int32)
    point = s.centers[joint] + [0.0, 0.02, 0.1]
    m = joint_matrices(s, clip.motion)[:, joint]
    points = np.einsum("fmab,mb->fma", m[..., :3, :3], point) + m[..., :3, 3] + OFF
    points[6:, 2] = np.nan
    return Marked(clip, NAMES, joint, point, points)


def test_markers_come_with_each_frame_and_gaps_are_gaps():
    own = marked_clip()
    showing = Showing(actors_of([own]))
    header, blocks = decode(showing.meshes[0])
    assert header["markers"] == list(NAMES) and blocks["capsules", "marker_point"].shape == (3, 3)
    np.testing.assert_array_equal(blocks["capsules", "marker_joint"], own.joint)
    for n in (0, 5, 6, 11):
        showing.apply({"type": "seek", "frame": n})
        _, blocks = decode(showing.frame(1))
        np.testing.assert_allclose(blocks["capsules", "markers"], own.points[n], atol=1e-5)
    np.testing.assert_allclose(own.at(2.5), (own.points[2] + own.points[3]) / 2, atol=1e-6)
    assert np.isnan(own.at(5.5)[2]).all() and np.isfinite(own.at(5.5)[:2]).all()
    np.testing.assert_allclose(own.at(99.0), own.points[-1], atol=1e-6)
    for change in ({"points": own.points[:5]}, {"point": own.point[:2]}, {"joint": own.joint + 99},
                   {"clip": replace(own.clip, motion=None)}):  # fmt: skip
        with pytest.raises(VitruvianError, match="markers"):
            replace(own, **change)


@pytest.mark.parametrize("bound", [False, True])
def test_a_body_in_other_proportions_keeps_its_skin_on_its_joints(bound):
    clip = capsule_clip(vertices=1500, frames=2)
    joint = clip.body.skin.weights.top(1)[0][:, 0]
    rigid = Weights(np.arange(len(joint) + 1), joint, np.ones(len(joint)))
    body = replace(clip.body, skin=replace(clip.body.skin, weights=rigid))
    if bound:  # as files of other programs bind: joints' own frames are not those of the world
        back = np.tile(np.eye(4), (len(body.skeleton), 1, 1))
        back[:, :3, 3] = [0.3, -0.2, 0.1]
        skin = replace(body.skin, rest=body.skin.rest - back[0, :3, 3])
        body = replace(body, skeleton=replace(body.skeleton, binding=back), skin=skin)
    parts = sorted(set(groups(body.skeleton)))
    scale = {p: 1.1 + 0.05 * i for i, p in enumerate(parts)}
    skeleton = scaled(body.skeleton, scale)
    made = proportioned(body, skeleton, scale)
    s, w = body.skeleton, body.skin.weights
    shift = 0.0 if not bound else s.binding[0, :3, 3]
    for name, part in (("l_knee", "shank"), ("r_shoulder", "upper arm")):
        j = s.index[name]
        child = int(np.argmax(s.parents == j))
        mine = np.flatnonzero(w.joint == j)
        assert len(mine) > 20
        along = s.centers[child] - s.centers[j]
        long = np.linalg.norm(along)
        old = (body.skin.rest + shift - s.centers[j])[mine]
        new = (made.skin.rest + shift - skeleton.centers[j])[mine]
        np.testing.assert_allclose(new @ along / long, scale[part] * old @ along / long, atol=1e-9)
        across = lambda x: np.linalg.norm(x - np.outer(x @ along, along) / long**2, axis=1)  # noqa: B023, E731
        np.testing.assert_allclose(across(new), np.median([scale[p] for p in groups(s)]) * across(old), atol=1e-9)
    assert made.skin.triangles is body.skin.triangles
    np.testing.assert_allclose(proportioned(body, s, dict.fromkeys(parts, 1.0)).skin.rest, body.skin.rest, atol=1e-12)


def stiff(figure: Sticks, frame: int) -> np.ndarray:
    """(V,3) the points of a stick figure at a frame, on the stage."""
    m = joint_matrices(figure.body.skeleton, figure.motion)[frame]
    own = m[figure.body.skin.weights.joint]
    points = np.einsum("vab,vb->va", own[:, :3, :3], figure.body.skin.rest) + own[:, :3, 3]
    return points + figure.body.placement[:3, 3]


def test_sticks_join_the_balls_of_every_joint_and_stand_on_the_floor_beside():
    clip = capsule_clip(frames=20)
    figure = sticks(clip.motion, (clip.body.skeleton, clip.motion))
    s, skin = clip.body.skeleton, figure.body.skin
    assert [p.name for p in skin.parts] == ["middle", "left", "right"]
    assert set(skin.weights.joint) == set(range(len(s)))
    where = joint_positions(s, joint_matrices(s, clip.motion))
    joints = where[7] + figure.body.placement[:3, 3]
    points = stiff(figure, 7)
    for j, p in enumerate(s.parents):
        own = points[skin.weights.joint == j]
        far = np.linalg.norm(own - joints[j], axis=1)
        assert far.min() < 0.025, s.names[j]  # its ball
        if p >= 0:  # the stick from its parent ends in it
            assert np.linalg.norm(points[skin.weights.joint == p] - joints[j], axis=1).min() < 0.012, s.names[j]
    edge = skin.rest[skin.triangles]
    volume = np.einsum("ti,ti->t", edge[:, 0], np.cross(edge[:, 1], edge[:, 2])).sum() / 6
    assert volume > 0  # faces look outwards
    theirs = where[0]
    assert stiff(figure, 0)[:, 0].max() < theirs[:, 0].min() - 0.2  # to its right
    lowest = min(stiff(figure, f)[:, 1].min() for f in range(20))
    assert abs(lowest - where[..., 1].min()) < 0.03
    lone = Skeleton(("root",), [-1], [[0, 0, 0]])
    alone = sticks(Motion(lone, 30.0, lone.rotation[None], np.zeros((1, 3))))
    assert len(alone.body.skin.rest) == 42 and np.isfinite(alone.body.placement).all()


BVH = """HIERARCHY
ROOT Hips
{ OFFSET 0 90 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT LeftUpLeg { OFFSET 10 0 0 CHANNELS 3 Zrotation Yrotation Xrotation
    JOINT LeftLeg { OFFSET 0 -45 0 CHANNELS 3 Zrotation Yrotation Xrotation
      JOINT LeftFoot { OFFSET 0 -40 0 CHANNELS 3 Zrotation Yrotation Xrotation End Site { OFFSET 0 -5 15 } } } }
  JOINT RightUpLeg { OFFSET -10 0 0 CHANNELS 3 Zrotation Yrotation Xrotation
    JOINT RightLeg { OFFSET 0 -45 0 CHANNELS 3 Zrotation Yrotation Xrotation
      JOINT RightFoot { OFFSET 0 -40 0 CHANNELS 3 Zrotation Yrotation Xrotation End Site { OFFSET 0 -5 15 } } } }
  JOINT Spine { OFFSET 0 20 0 CHANNELS 3 Zrotation Yrotation Xrotation
    JOINT Head { OFFSET 0 40 0 CHANNELS 3 Zrotation Yrotation Xrotation End Site { OFFSET 0 20 0 } } }
}
MOTION
Frames: 4
Frame Time: 0.033333
"""


def clip_file(folder: Path) -> Path:
    rows = [[0, 90, f, 0, f, 0, *([0] * 5), 3 * f, *([0] * 18)] for f in range(4)]
    path = folder / "walk.bvh"
    text = BVH
    for word in (" }", " CHANNELS", " JOINT", " End"):
        text = text.replace(word, "\n" + word)
    path.write_text(text.replace("{ ", "{\n") + "\n".join(" ".join(map(str, r)) for r in rows) + "\n")
    return path


def test_view_shows_a_clip_on_a_body_with_its_source(tmp_path):
    clip = clip_file(tmp_path)
    body, source = moved("person", clip, True, None, None, None)
    assert isinstance(body, vt.Clip) and isinstance(source, Sticks) and len(body.motion) == len(source.motion) == 4
    assert source.body.name == "walk (source)" and "LeftLeg" in source.body.skeleton.names
    height = np.ptp(stiff(source, 0)[:, 1])
    assert 1.65 < height < 1.8  # 1.7 m: the file's centimetres
    (alone,) = moved("person", clip, False, None, None, None)
    np.testing.assert_allclose(alone.motion.rotation, body.motion.rotation)
    assert len(moved(str(clip), None, True, None, None, None)) == 2
    for given, what in (
        (("person", None, True, None), "--source: goes with"),
        (("person", clip, False, clip), "--markers: goes without"),
        (("person", None, False, clip), "expected markers"),
        ((str(clip), clip, False, None), "name the body first"),
    ):
        with pytest.raises(VitruvianError, match=what):
            moved(*given, None, None)


def test_the_page_draws_markers_and_says_how_far_they_are(browser, tmp_path):
    clip = clip_file(tmp_path)
    record(marked_clip(), tmp_path / "marks.html", sticks(vt.load(clip)))
    with opened(browser, (tmp_path / "marks.html").as_uri(), (900, 640)) as page:
        wait(page, "vitruvian.marks")
        scrub(page, 3)
        wait(page, "vitruvian.marks.there.length === 3")
        told = {m["name"]: m["mm"] for m in page.evaluate("vitruvian.marks.there")}
        assert told == pytest.approx({"LASI": 5, "RSHO": 20, "LKNE": 40}, abs=0.05)
        page.wait_for_timeout(300)
        said = page.locator("#marks-said").text_content()
        assert "3 of 3" in said and "LKNE 40.0" in said and "26.0 mm" in said
        page.keyboard.press("1")
        page.wait_for_timeout(200)
        wait(page, "!vitruvian.camera.moving")
        with_marks = page.screenshot()
        page.keyboard.press("%")
        wait(page, "!vitruvian.marks.on")
        page.wait_for_timeout(300)
        assert page.get_by_test_id("marks-legend").is_hidden() and page.screenshot() != with_marks
        page.get_by_test_id("marks").click()
        scrub(page, 8)
        wait(page, "vitruvian.marks.there.length === 2")
        page.wait_for_timeout(200)
        assert "2 of 3" in page.locator("#marks-said").text_content()
        assert [a["name"] for a in page.evaluate("vitruvian.actors")] == ["capsules", "source"]


def test_marker_colours_go_from_green_to_red_where_the_lines_are(browser, tmp_path):
    from io import BytesIO

    from PIL import Image

    own = marked_clip()
    record(own, tmp_path / "marks.html")
    with opened(browser, (tmp_path / "marks.html").as_uri(), (900, 640)) as page:
        pause(page)
        scrub(page, 0)
        page.keyboard.press("1")
        page.wait_for_timeout(300)
        wait(page, "!vitruvian.camera.moving")
        page.wait_for_timeout(200)
        picture = np.asarray(Image.open(BytesIO(page.screenshot())).convert("RGB")).astype(int)
        colors = {}
        for k, name in enumerate(NAMES):
            x, y = page.evaluate("p => vitruvian.pixel(p)", own.points[0, k].tolist())
            colors[name] = picture[round(y), round(x)]
        assert colors["LASI"][1] > colors["LASI"][0] + 30  # green
        assert colors["LKNE"][0] > colors["LKNE"][1] + 30  # red
        x, y = page.evaluate("p => vitruvian.pixel(p)", own.points[0, 2].tolist())
        page.mouse.move(x, y)
        page.wait_for_timeout(100)
        assert page.locator("#label").text_content().startswith("LKNE")
