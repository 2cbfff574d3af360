"""Numbers of deformed surfaces against closed forms, and the sheet that shows them side by side."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.sparse import csr_array
from typer.testing import CliRunner

import skins
from small_body import figure
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.rotations import from_axis_angle, from_vector, to_matrix
from vitruvian.body.types import Skeleton, Skin, Weights
from vitruvian.cli import app
from vitruvian.deform.deformer import deformer
from vitruvian.deform.quality import Gauge, quality, turned
from vitruvian.errors import VitruvianError
from vitruvian.show.comparison import default_pose
from vitruvian.show.grain import checks

TWIST, BEND = (0, 0, 1), (1, 0, 0)


def cylinder(open_ends: bool = False):
    """The reference cylinder of the notes as a chain: one bone along -z, one along +z."""
    body = skins.cylinder(skins.halves)
    body = replace(body, skeleton=replace(body.skeleton, parents=np.array([-1, 0])))
    if open_ends:
        body = replace(body, skin=replace(body.skin, triangles=body.skin.triangles[: -2 * skins.POINTS], parts=()))
    return body


def measured(name: str, axis, degrees: float, body=None):
    body = body or cylinder()
    matrices = skins.turned(axis, degrees)
    return quality(body, deformer(name, body)(matrices), matrices, joints=("j1",))


@pytest.mark.parametrize(
    ("axis", "degrees", "name", "volume", "area", "thickness", "bulge"),
    [
        (TWIST, 90, "linear", 0.9032, 0.5, 0.7071, 1.0),
        (TWIST, 90, "dual-quaternion", 0.9995, 1.0, 1.0, 1.0),
        (TWIST, 90, "log", 0.9995, 1.0, 1.0, 1.0),
        (TWIST, 135, "linear", 0.8350, 0.1464, 0.3827, 1.0),
        (TWIST, 179.9, "linear", 0.8068, 0.0, 0.0009, 1.0),
        (TWIST, 179.9, "log", 0.9985, 1.0, 1.0, 1.0),
        (BEND, 90, "linear", 0.9515, 0.7071, 0.7071, 1.0234),
        (BEND, 90, "dual-quaternion", 0.9997, 1.0, 1.0, 1.1464),
        (BEND, 90, "log", 0.9997, 1.0, 1.0, 1.1527),
        (BEND, 135, "linear", 0.9173, 0.3827, 0.3827, 1.0073),
        (BEND, 135, "dual-quaternion", 0.9993, 1.0, 1.0, 1.1824),
        (BEND, 135, "log", 0.9993, 1.0, 1.0, 1.2031),
    ],
)
def test_reference_table(axis, degrees, name, volume, area, thickness, bulge) -> None:
    found = measured(name, axis, degrees).whole
    assert found.volume == pytest.approx(volume, abs=1e-4)
    assert found.area == pytest.approx(area, abs=1e-4)
    assert found.thickness == pytest.approx(thickness, abs=1e-4)
    assert found.bulge == pytest.approx(bulge, abs=2e-4)
    assert found.gap == 0


@pytest.mark.parametrize("degrees", [20, 60, 90, 120])
def test_closed_forms_of_linear(degrees: float) -> None:
    half = np.cos(np.radians(degrees) / 2)
    twisted, bent = measured("linear", TWIST, degrees).whole, measured("linear", BEND, degrees).whole
    assert twisted.area == pytest.approx(half**2, abs=1e-6) and twisted.thickness == pytest.approx(half, abs=1e-6)
    assert bent.thickness == pytest.approx(half, abs=1e-6)


def test_volume_operator_reaches_its_aim() -> None:
    found = measured("volume", BEND, 90).whole
    assert found.bulge <= 1.05 and found.thickness >= 0.95


@pytest.fixture(scope="module")
def person():
    import vitruvian as vt

    body = vt.pack(vt.person(outfit=None, hair=None))
    return body, deformer("volume", body), deformer("log", body)


@pytest.mark.parametrize(
    ("joint", "axis"),
    [
        ("l_elbow", (-1, 0, 0)),
        ("r_elbow", (-1, 0, 0)),
        ("l_radiocarpal", (0, 0, 1)),
        ("r_radiocarpal", (0, 0, -1)),
        ("l_hip", (-1, 0, 0)),
        ("r_hip", (-1, 0, 0)),
        ("l_knee", (1, 0, 0)),
        ("r_knee", (1, 0, 0)),
    ],
)
def test_the_aim_of_bulge_control_on_the_person(person, joint, axis) -> None:
    """At 90 degrees, where "log" bulges by a fifth and more."""
    body, volume, log = person
    rotation = body.skeleton.rotation.copy()
    rotation[body.skeleton.index[joint]] = from_axis_angle(np.array([*axis, np.pi / 2]))
    matrices = joint_matrices(replace(body.skeleton, rotation=rotation))[0]
    gauge = Gauge(body, (joint,))
    found, before = (gauge.measure(d(matrices), matrices).joints[joint] for d in (volume, log))
    assert found.thickness >= 0.95 and found.bulge <= 1.05 and found.area >= 0.94
    assert before.bulge > 1.15


PEOPLE = {
    "heavy man": {"gender": 1.0, "weight": 140.0},
    "thin woman": {"gender": 0.0, "weight": 40.0},
    "child": {"age": 10.0},
    "old man": {"gender": 1.0, "age": 85.0},
    "muscular woman": {"gender": 0.0, "muscle": 1.0},
    "slack": {"muscle": 0.0},
    "tall": {"gender": 1.0, "height": 2.05},
}


@pytest.mark.filterwarnings("ignore::vitruvian.VitruvianWarning")
@pytest.mark.parametrize("who", PEOPLE)
def test_the_aim_of_bulge_control_on_all_kinds_of_people(who) -> None:
    """Elbow and knee at 90 degrees; fat arms, whose bone is far from the middle, need even sections most."""
    import vitruvian as vt

    body = vt.pack(vt.person(outfit=None, hair="none", **PEOPLE[who]))
    move = deformer("volume", body)
    for joint, axis in (("l_elbow", (-1, 0, 0)), ("l_knee", (1, 0, 0))):
        rotation = body.skeleton.rotation.copy()
        rotation[body.skeleton.index[joint]] = from_axis_angle(np.array([*axis, np.pi / 2]))
        matrices = joint_matrices(replace(body.skeleton, rotation=rotation))[0]
        found = Gauge(body, (joint,)).measure(move(matrices), matrices).joints[joint]
        assert found.thickness >= 0.95 and found.bulge <= 1.05, (joint, found)


def test_sections_do_not_depend_on_which_side_has_which_weights() -> None:
    """A limb bent at rest, whose outside turns further down than its inside: sections turn as one all the same."""
    body = skins.cylinder(skins.halves)
    rest, angle = body.skin.rest, np.radians(30)
    turn = np.clip((rest[:, 2] + 1.5) / 3, 0, 1)[:, None] * [angle, 0, 0]  # bends the tube and its bone line
    centre = np.clip(rest[:, 2], 0, None)[:, None] * [0, -np.sin(angle), np.cos(angle)]
    centre[:, 2] += np.clip(rest[:, 2], None, 0)
    points = centre + np.einsum("nab,nb->na", to_matrix(from_vector(turn)), rest * [1, 1, 0])
    share = skins.halves(rest[:, 2] + 0.6 * rest[:, 1])[:, 1]
    weights = Weights.from_pairs(
        len(rest),
        np.tile(np.arange(len(rest)), 2),
        np.repeat([0, 1], len(rest)),
        np.concatenate([1 - share, share]),
    )
    ends = np.array([[0, 0, -4.0], [0, 0, 0], [0, -4 * np.sin(angle), 4 * np.cos(angle)]])
    skeleton = Skeleton(("j0", "j1", "j2"), np.array([-1, 0, 1]), ends)
    body = replace(body, skeleton=skeleton, skin=replace(body.skin, rest=points, weights=weights))
    operator = deformer("volume", body).operator
    near = np.abs(rest[:, 2]) < 1.5
    off = np.linalg.norm(operator.center - centre, axis=1)
    assert off[near].max() < 0.25
    made = operator.rigid.rows
    own = np.zeros(len(made))
    own[made.vertex[made.joint == 1]] = made.weight[made.joint == 1]
    rings = own[: skins.RINGS * skins.POINTS].reshape(skins.RINGS, skins.POINTS)[30:51]
    given = share[: skins.RINGS * skins.POINTS].reshape(skins.RINGS, skins.POINTS)[30:51]
    assert np.ptp(given, axis=1).max() > 0.5 and np.ptp(rings, axis=1).max() < 0.1


def test_rigid_pieces_stay_rigid() -> None:
    """Each vertex on one joint, as in a figure of Segments: nothing is made even there."""
    body = cylinder()
    skin, count = body.skin, len(body.skin.rest)
    alone = Weights.from_pairs(count, np.arange(count), (skin.rest[:, 2] > 0).astype(int), np.ones(count))
    body = replace(body, skin=replace(skin, weights=alone))
    matrices = skins.turned(BEND, 90)
    assert np.abs(deformer("volume", body)(matrices) - deformer("linear", body)(matrices)).max() < 2e-6


def test_a_skin_that_no_joint_moves_stays() -> None:
    body = cylinder()
    count = len(body.skin.rest)
    body = replace(body, skin=replace(body.skin, weights=Weights.from_pairs(count, [], [], [])))
    assert np.abs(deformer("volume", body)(skins.turned(BEND, 90)) - body.skin.rest).max() < 1e-6


def test_even_sections_leave_alone_what_is_not_one_limb(person) -> None:
    """Weights change round elbow and knee, and hardly on trunk and head."""
    body, volume, log = person
    given, made = log.operator.rows, volume.operator.rigid.rows
    dense = [csr_array((r.weight, r.joint, r.row), shape=(len(given), given.joints + 1)) for r in (given, made)]
    change = np.asarray(abs(dense[0] - dense[1]).sum(axis=1)).ravel()
    changed = change > 0.02
    names = np.array(body.skeleton.names)
    main = names[given.joint[given.row[:-1]]]
    assert np.abs(np.asarray(dense[1].sum(axis=1)).ravel() - 1).max() < 1e-9
    assert changed[np.isin(main, ["l_elbow", "r_knee"])].mean() > 0.1
    part = {k: changed[np.char.startswith(main, k)].mean() for k in ("vl", "vt", "vc", "skull", "temporo")}
    assert max(part.values()) < 0.02, part
    assert (
        change[np.char.startswith(main, "vt")].max() < 0.1
    )  # the flank has a trace of the arm's weights, but is no arm


@pytest.mark.parametrize(("name", "limit"), [("linear", 90.0), ("log", np.degrees(2))])
def test_folds_begin_where_the_inside_turns_back(name: str, limit: float) -> None:
    # along the limb the inside moves on by cos(h) - sin(h) ("linear", h half the angle) and by 1 - angle / 2 ("log"):
    # the weight's slope is 1/2 in the middle
    assert measured(name, BEND, limit - 3).whole.folds == 0
    assert measured(name, BEND, limit + 3).whole.folds > 0


def test_stretch_of_the_twist() -> None:
    # an edge along the limb, 0.1 long, whose ends are on rings that "log" turns apart
    found = measured("log", TWIST, 90).whole
    z = np.linspace(-4, 4, skins.RINGS)
    turn = np.diff(skins.halves(z)[:, 1]) * np.pi / 2
    around = 2 * np.pi / skins.POINTS  # the diagonals start with this much
    longest = np.hypot(2 * np.sin((turn.max() + around) / 2), 0.1) / np.hypot(2 * np.sin(around / 2), 0.1)
    straight = np.hypot(2 * np.sin(turn.max() / 2), 0.1) / 0.1
    assert found.stretch == pytest.approx(max(longest, straight), rel=1e-4)


def test_lids_close_an_open_surface() -> None:
    whole, tube = (measured("linear", BEND, 90, cylinder(ends)) for ends in (False, True))
    assert tube.whole.volume == pytest.approx(whole.whole.volume, rel=1e-6)
    assert tube.joints["j1"].volume == pytest.approx(whole.joints["j1"].volume, rel=1e-12)
    # half of the length is looked at, and all of the loss is in it
    assert 1 - whole.joints["j1"].volume == pytest.approx(2 * (1 - whole.whole.volume), rel=1e-4)


def test_a_rigid_motion_changes_nothing() -> None:
    body = cylinder()
    move = skins.turned((0.3, -0.5, 0.7), 70)[1]
    move[:3, 3] = 1, -2, 3
    found = quality(body, body.skin.rest @ move[:3, :3].T + move[:3, 3], np.stack([move, move]), joints=("j1",))
    for q in (found.whole, found.joints["j1"]):
        numbers = [q.volume, q.area, q.thickness, q.bulge, q.stretch]
        assert np.abs(np.array(numbers) - 1).max() < 1e-9 and q.folds == 0 and q.gap < 1e-12


def split(body):
    """The body cut at z = 0: the points there twice, the second copies for what lies above."""
    skin, n = body.skin, len(body.skin.rest)
    middle = np.flatnonzero(skin.rest[:, 2] == 0)
    copy = np.arange(n)
    copy[middle] = n + np.arange(len(middle))
    above = skin.rest[skin.triangles].mean(axis=1)[:, 2] > 0
    triangles = np.where(above[:, None], copy[skin.triangles], skin.triangles)
    source = np.concatenate([np.arange(n), middle])
    w = skin.weights
    vertex = [k for k, s in enumerate(source) for _ in range(w.counts[s])]
    pick = np.concatenate([np.arange(w.row[s], w.row[s + 1]) for s in source])
    rows = Weights.from_pairs(len(source), vertex, w.joint[pick], w.weight[pick])
    return replace(body, skin=Skin(skin.rest[source], triangles, rows)), n


def test_seams_are_one_surface_until_they_open() -> None:
    body, n = split(cylinder())
    matrices = skins.turned(TWIST, 90)
    points = deformer("linear", body)(matrices).astype(float)
    gauge = Gauge(body, ("j1",))
    shut = gauge.measure(points, matrices)
    assert shut.whole.gap == 0 and shut.whole.volume == pytest.approx(0.9032, abs=1e-4)
    assert shut.whole.area == pytest.approx(0.5, abs=1e-4)
    points[n:] += [0, 0, 0.01]
    opened = gauge.measure(points, matrices)
    assert opened.whole.gap == pytest.approx(0.01, abs=1e-9) and opened.joints["j1"].gap == opened.whole.gap


@pytest.mark.parametrize("name", ["linear", "dual-quaternion", "log", "log-pair", "hybrid", "volume"])
def test_no_operator_opens_a_seam(name: str) -> None:
    body, n = split(cylinder())
    for axis in (TWIST, BEND):
        matrices = skins.turned(axis, 100)
        points = deformer(name, body)(matrices)
        assert quality(body, points, matrices).whole.gap == 0
        whole = deformer(name, cylinder())(matrices)
        assert np.abs(points[:n] - whole).max() < 1e-6  # the cut changes nothing


def test_joints_that_turn_are_found_and_roots_are_not_measured() -> None:
    body = cylinder()
    assert turned(body.skeleton, skins.turned(BEND, 30)) == ("j1",)
    assert turned(body.skeleton, skins.turned(BEND, 0.5)) == ()
    still = quality(body, body.skin.rest, skins.turned(BEND, 0))
    assert still.whole.volume == 1 and np.isnan(still.whole.area) and still.joints == {}
    assert still.document()["whole"]["area"] is None  # type: ignore[index]
    assert Gauge(body, ("j0",)).regions == {}


def test_what_does_not_fit_is_said() -> None:
    body = cylinder()
    with pytest.raises(VitruvianError, match="no joint knee"):
        Gauge(body, ("knee",))
    with pytest.raises(VitruvianError, match="points: expected shape"):
        quality(body, np.zeros((3, 3)), skins.turned(BEND, 10))
    with pytest.raises(VitruvianError, match="matrices: expected shape"):
        quality(body, body.skin.rest, np.eye(4))


def test_a_body_without_skin_has_nothing_to_measure() -> None:
    body = figure()
    bare = Skin(np.zeros((0, 3)), np.zeros((0, 3), np.int32), Weights.from_pairs(0, [], [], []))
    bare = replace(body, skin=bare, contours=())
    matrices = np.tile(np.eye(4), (len(body.skeleton), 1, 1))
    found = quality(bare, np.zeros((0, 3)), matrices, joints=body.skeleton.names[1:2])
    assert np.isnan(found.whole.volume) and found.whole.folds == 0 and found.joints == {}


def test_checks_are_even_and_fade_when_too_fine() -> None:
    along = np.linspace(0, 0.6, 4001)[:-1]
    place = np.stack([along, np.full(4000, 0.05), np.full(4000, 0.01)], axis=1)
    sharp = checks(place, 1e-5)
    dark = sharp[:, 0] < 0.5
    assert dark.mean() == pytest.approx(0.5, abs=0.01)
    assert np.abs(np.diff(dark.astype(int))).sum() == 19  # 20 bands of 3 cm
    assert np.ptp(checks(place, 10.0)) < 0.9 * np.ptp(sharp) and np.ptp(checks(place, 10.0)[:, 0]) < 0.01


@pytest.fixture(scope="module")
def person_file(tmp_path_factory):
    import vitruvian as vt

    path = tmp_path_factory.mktemp("quality") / "person.x3d"
    vt.save(vt.person(loa=1, outfit="body suit"), path)
    return path


def test_the_sheet_of_a_person(person_file, tmp_path) -> None:
    pose = {"l_elbow": [1, 0, 0, -1.9], "r_radiocarpal": [0, 1, 0, 1.6]}
    (tmp_path / "pose.json").write_text(json.dumps(pose))
    out = tmp_path / "sheet.png"
    args = ["render", str(person_file), "--compare", "linear,log", "--pose", str(tmp_path / "pose.json")]
    answer = CliRunner().invoke(app, [*args, "-o", str(out), "--json"])
    assert answer.exit_code == 0, answer.output
    found = json.loads(answer.stdout)["deformers"]
    assert list(found) == ["linear", "log"]
    linear, log = (found[k] for k in found)
    wrist = "r_radiocarpal"
    assert set(linear["joints"]) == {"l_elbow", wrist}
    assert linear["joints"][wrist]["area"] < 0.75 < 0.9 < log["joints"][wrist]["area"]
    assert linear["joints"]["l_elbow"]["thickness"] < log["joints"]["l_elbow"]["thickness"]
    assert linear["whole"]["volume"] < log["whole"]["volume"] and log["whole"]["gap"] < 1e-6
    sheet = np.asarray(Image.open(out))
    assert sheet.shape[1] == 2 * 340 + 6
    left, right = sheet[40:540, :340].astype(int), sheet[40:540, 346:].astype(int)
    assert 0.001 < (np.abs(left - right).max(axis=-1) > 40).mean() < 0.2  # the same view, another arm


def test_the_default_pose_asks_much_whatever_the_rest_pose(person_file) -> None:
    import vitruvian as vt
    from vitruvian.body.rotations import from_vector, rotate

    hanging = vt.pack(vt.load(person_file)).skeleton
    sideways = hanging.centers.copy()  # the same arms stretched out
    for side, sign in (("l", 1), ("r", -1)):
        s = hanging.index[f"{side}_shoulder"]
        arm = [
            j for j in range(s, len(hanging)) if hanging.names[j].startswith(f"{side}_") and hanging.centers[j, 1] > 0.6
        ]
        sideways[arm] = rotate(from_vector([0, 0, sign * np.pi / 2]), sideways[arm] - sideways[s]) + sideways[s]
    for skeleton in (hanging, replace(hanging, centers=sideways)):
        pose = default_pose(skeleton)
        rotation = skeleton.rotation.copy()
        for joint, value in pose.items():
            rotation[skeleton.index[joint]] = from_axis_angle(value)
        m = vt.joint_matrices(replace(skeleton, rotation=rotation))[0]

        def at(joint: str, skeleton=skeleton, m=m) -> np.ndarray:
            j = skeleton.index[joint]
            return m[j, :3, :3] @ skeleton.centers[j] + m[j, :3, 3]

        lifted = at("r_elbow") - at("r_shoulder")
        assert -lifted[0] / np.linalg.norm(lifted) > np.cos(np.radians(12))
        upper, lower = at("l_elbow") - at("l_shoulder"), at("l_radiocarpal") - at("l_elbow")
        cosine = upper @ lower / np.linalg.norm(upper) / np.linalg.norm(lower)
        assert cosine < np.cos(np.radians(90)) and lower[2] > 0
        assert at("l_knee")[2] > at("l_hip")[2] + 0.2 and at("l_talocrural")[2] < at("l_knee")[2]


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--compare", "linear,best"], "found 'best'"),
        (["--compare", " , "], "at least one deformer"),
        (["--compare", "log", "--pose", '{"l_fin": [1, 0, 0, 1]}'], "l_fin is not a joint"),
        (["--compare", "log", "--pose", '{"l_elbow": [1, 0]}'], "--pose: l_elbow: expected"),
        (["--compare", "log", "--time", "1"], "--time"),
        (["--pose", "{}"], "goes with --compare"),
    ],
)
def test_bad_requests_are_one_line(person_file, tmp_path, extra, message) -> None:
    answer = CliRunner().invoke(app, ["render", str(person_file), "-o", str(tmp_path / "x.png"), *extra])
    assert isinstance(answer.exception, VitruvianError) and message in str(answer.exception)
    assert not (tmp_path / "x.png").exists()
