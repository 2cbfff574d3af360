"""Capture files: ASF/AMC, AMASS-style npz, C3D, TRC, CSM, MOT: real ones as the notes say, our own there and back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import vitruvian as vt
from capture_maker import AMC, ASF, LABELS, c3d, cloud
from vitruvian.body.rotations import from_euler, from_vector, inverse, multiply, rotate
from vitruvian.cli import app
from vitruvian.errors import FileError, VitruvianError, VitruvianWarning
from vitruvian.formats.amass import LAYOUTS, figure, read_amass, write_amass
from vitruvian.formats.asf import read_amc
from vitruvian.formats.c3d import raw_points, read_c3d
from vitruvian.formats.csm import read_csm, write_csm
from vitruvian.formats.trc import read_trc, write_trc
from vitruvian.motion.markers import UP_AXES, Markers, from_y_up, markers_of, to_y_up
from vitruvian.motion.turns import positions, world_rotations
from vitruvian.motion.types import Motion


def places(motion: Motion) -> np.ndarray:
    s = motion.skeleton
    world = world_rotations(s.parents, motion.rotation)
    return positions(s.parents, s.centers, world, motion.translation, motion.joint_translation)


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """Largest angle in degrees between rotations."""
    q = multiply(inverse(a), b)
    return float(np.degrees(2 * np.arctan2(np.linalg.norm(q[..., :3], axis=-1), np.abs(q[..., 3]))).max())


def command(*words: str) -> None:
    app([str(w) for w in words], standalone_mode=False)


def tiny(folder: Path, asf: str = ASF, amc: str = AMC) -> Path:
    (folder / "tiny.asf").write_text(asf)
    (folder / "tiny_01.amc").write_text(amc)
    return folder / "tiny_01.amc"


# What section 8 of the note says of each file: format, extent, rate, and words of the notes about unit and axis.
FILES = {
    "cmu_01_01_playground.bvh": ("motion", 31, 2752, 120, "unit 0.0564444 m", "up axis Y"),
    "cmu_131_01_walk.bvh": ("motion", 31, 994, 120, "unit 0.0564444 m", "up axis Y"),
    "cmu_01_01.amc": ("motion", 31, 2751, 120, "unit 0.0564444 m", "up axis Y"),
    "cmu_pirouette.amc": ("motion", 31, 591, 120, "unit 0.0564444 m", "up axis Y"),
    "makehuman_dance1.bvh": ("motion", 75, 1, 24, "unit 0.1 m", "up axis Z"),
    "opensim_walking2.c3d": ("markers", 44, 1249, 250, "unit 0.001 m", "up axis Z"),
    "opensim_walk_free_01.trc": ("markers", 41, 73, 60, "unit 0.001 m", "up axis Y"),
    "opensim_subject01_static.trc": ("markers", 49, 300, 60, "unit 0.001 m", "up axis Y"),
    "opensim_ik_subject01_synthetic_marker_data.trc": ("markers", 31, 73, 60, "unit 1 m", "up axis Y"),
    "opensim_ik_std_subject01_walk1_ik.mot": ("table", 23, 73, 60, "angles in degrees", "rate 60"),
    "chatvrm_idle_loop.vrma": ("motion", 28, 249, 24, "unit 1 m", "up axis Y"),
}


@pytest.mark.parametrize("name", FILES)
def test_real_files_say_unit_axis_and_rate(name: str, shared: Path, capsys: pytest.CaptureFixture) -> None:
    noun, things, frames, fps, *words = FILES[name]
    command("info", shared / "data" / "motion" / name, "--json")
    document = json.loads(capsys.readouterr().out)
    facts = document[noun]
    count = facts.get("joints", facts.get("markers", len(facts.get("columns", ()))))
    assert (count, facts.get("frames", facts.get("rows"))) == (things, frames)
    assert facts["fps"] == pytest.approx(fps, abs=0.05)
    for word in words:
        assert any(word in note for note in facts["notes"]), facts["notes"]


def test_info_lists_labels_and_their_gaps(shared: Path, capsys: pytest.CaptureFixture) -> None:
    command("info", shared / "data/motion/opensim_walking2.c3d", "--json")
    facts = json.loads(capsys.readouterr().out)["markers"]
    assert facts["gaps_percent"] == 50.16 and facts["labels"]["RTH1"] == 30.1 and len(facts["analog"]) == 12
    command("info", shared / "data/motion/opensim_walking2.c3d")
    text = capsys.readouterr().out
    assert "44, 1,249 frames at 250 per second" in text and "RTH1" in text and "% missing" in text


def test_amc_and_bvh_of_one_clip_agree(shared: Path) -> None:
    """AMC frame k is BVH frame k + 1. The BVH drops the thorax's length, so its arms are off by exactly that."""
    folder = shared / "data" / "motion"
    amc, bvh = read_amc(folder / "cmu_01_01.amc"), vt.load(folder / "cmu_01_01_playground.bvh")
    a, b = places(amc), places(bvh)[1:]
    unit = 0.0254 / 0.45
    pairs = {
        "root": "Hips", "lfemur": "LeftUpLeg", "ltibia": "LeftLeg", "lfoot": "LeftFoot", "ltoes": "LeftToeBase",
        "rfemur": "RightUpLeg", "rtibia": "RightLeg", "rfoot": "RightFoot", "rtoes": "RightToeBase",
        "lowerback": "LowerBack", "upperback": "Spine", "thorax": "Spine1",
    }  # fmt: skip
    i, j = amc.skeleton.index, bvh.skeleton.index
    worst = {n: float(np.abs(a[:, i[n]] - b[:, j[m]]).max()) / unit for n, m in pairs.items()}
    thorax = rotate(world_rotations(amc.skeleton.parents, amc.rotation)[:, i["thorax"]], [0.0, 1.0, 0.0])
    chest = a[:, i["lclavicle"]] - a[:, i["thorax"]]
    assert np.linalg.norm(chest, axis=1) / unit == pytest.approx(2.06488, abs=1e-4)
    assert np.abs(np.einsum("fi,fi->f", thorax, chest)).min() > 0.9 * 2.06488 * unit
    arms = {"lhumerus": "LeftArm", "lradius": "LeftForeArm", "lwrist": "LeftHand", "rradius": "RightForeArm"}
    for n, m in arms.items():
        worst[n] = float(np.abs(a[:, i[n]] - chest - b[:, j[m]]).max()) / unit
    print("largest difference of AMC and BVH, file units:", {n: f"{w:.1e}" for n, w in worst.items()})
    assert max(worst.values()) < 1e-3
    hips = float(a[0, i["root"], 1])
    ends = {n: p for n, p in zip(amc.skeleton.site_names, amc.skeleton.site_joints)}
    assert hips == pytest.approx(1.009, abs=1e-3) and "head_tip" in ends


def test_amc_turns_and_limits_are_those_of_the_axes(tmp_path: Path) -> None:
    path = tiny(tmp_path)
    motion = read_amc(path)
    s = motion.skeleton
    assert s.names == ("root", "lfemur", "ltibia", "head") and len(motion) == 3 and motion.fps == 120
    c = from_euler(np.radians([20.0, 0, 0]), "ZYX")  # axis 0 0 20 XYZ: X first, so Rz Ry Rx
    m = from_euler(np.radians([30.0, 20, 10]), "ZYX")
    assert angle(motion.rotation[0, 1], multiply(multiply(c, m), inverse(c))) < 1e-6
    k = from_vector([np.radians(40.0), 0, 0])
    assert angle(motion.rotation[0, 2], multiply(multiply(c, k), inverse(c))) < 1e-6
    assert np.degrees(s.limits[1]) == pytest.approx(np.array([[-160, 20], [-70, 70], [-60, 70]]))
    assert np.degrees(s.limits[2]) == pytest.approx(np.array([[-10, 170], [0, 0], [0, 0]]))
    assert angle(s.limit_orientation[1], c) < 1e-9
    assert motion.translation[1] == pytest.approx(np.array([1.5, 17, 2]) * 0.0254 / 0.45)
    with pytest.warns(VitruvianWarning, match="m high; if that is wrong, say unit="):
        asked = read_amc(path, unit="cm", up="z", fps=60)
    assert asked.fps == 60 and "as asked for" in asked.notes[0] and "up axis Z: as asked for" in asked.notes[1]
    assert asked.translation[1] == pytest.approx(to_y_up(np.array([1.5, 17, 2]) * 0.01, "z"))


def test_amc_radians_gaps_and_its_skeleton(tmp_path: Path) -> None:
    degrees = read_amc(tiny(tmp_path))
    turned = "\n".join(
        " ".join([w[0], *(f"{np.radians(float(v)):.12f}" if k > 2 or w[0] != "root" else v for k, v in enumerate(w[1:]))])
        for line in AMC.splitlines()[3:]
        if (w := line.split())
    )  # fmt: skip
    radians = read_amc(tiny(tmp_path, amc=":FULLY-SPECIFIED\n:RADIANS\n" + turned + "\n"))
    assert angle(degrees.rotation, radians.rotation) < 1e-6
    with pytest.warns(VitruvianWarning, match="2 frames are missing, the first after frame 2"):
        held = read_amc(tiny(tmp_path, amc=AMC.replace("\n3\nroot", "\n5\nroot")))
    assert len(held) == 5 and np.array_equal(held.rotation[1], held.rotation[3])
    with pytest.raises(FileError, match=r"tiny_01.amc:10: frame 2: expected 3 numbers for lfemur, found 2"):
        read_amc(tiny(tmp_path, amc=AMC.replace("lfemur 11 21 31", "lfemur 11 21")))
    with pytest.raises(FileError, match="frame 2 ends without ltibia"):
        read_amc(tiny(tmp_path, amc=AMC.replace("ltibia 41\n", "")))
    path = tiny(tmp_path)
    elsewhere = tmp_path / "there"
    elsewhere.mkdir()
    (elsewhere / "other.asf").write_bytes((tmp_path / "tiny.asf").read_bytes())
    (tmp_path / "tiny.asf").unlink()
    with pytest.raises(FileError, match="needs the .asf of its skeleton beside it, found none; say skeleton=FILE"):
        read_amc(path)
    assert len(read_amc(path, skeleton=elsewhere / "other.asf")) == 3


def test_amc_written_and_read_again(shared: Path, tmp_path: Path) -> None:
    motion = read_amc(shared / "data/motion/cmu_pirouette.amc")
    report = vt.save(motion, tmp_path / "out.amc")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.amc", "out.asf"] and "rate of 120" in report["lost"][0]
    again = read_amc(tmp_path / "out.amc")
    index = [again.skeleton.index[n] for n in motion.skeleton.names]
    assert np.abs(places(again)[:, index] - places(motion)).max() < 1e-4
    held = motion.skeleton.limits
    kept = again.skeleton.limits[index]
    full = np.isfinite(held).all(axis=(1, 2))
    assert full.sum() > 20 and np.allclose(kept[full], held[full], atol=1e-6)


@pytest.mark.parametrize("joints", LAYOUTS)
def test_npz_there_and_back(joints: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(joints)
    skeleton = figure(LAYOUTS[joints])
    turns = from_vector(rng.normal(0, 0.3, (9, joints, 3)))
    motion = Motion(skeleton, 60.0, turns, rng.normal(0, 1, (9, 3)))
    write_amass(motion, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as raw:
        assert raw["poses"].shape == (9, 3 * joints) and float(raw["mocap_framerate"]) == 60
    again = read_amass(tmp_path / "a.npz", up="z")
    assert np.abs(places(again) - places(motion)).max() < 1e-9 and angle(again.rotation, motion.rotation) < 1e-6


def test_npz_as_amass_gives_it(tmp_path: Path) -> None:
    """Z up, the root turned upright by a quarter turn, frame rates by both names, betas; the elbow's bend is kept."""
    poses = np.zeros((5, 156))
    poses[:, 0] = np.pi / 2
    poses[:, 3 * 18 + 1] = -1.0  # the left elbow
    trans = np.array([[0.0, 2.0, 0.9]] * 5)
    np.savez(tmp_path / "a.npz", poses=poses, trans=trans, mocap_frame_rate=np.array(100.0), betas=np.ones(16))
    motion = vt.load(tmp_path / "a.npz")
    assert motion.fps == 100 and any("up axis Z" in n for n in motion.notes) and any("betas" in n for n in motion.notes)
    place = places(motion)[0]
    names = motion.skeleton.index
    assert place[names["head"], 1] > place[names["pelvis"], 1] + 0.5
    assert place[names["pelvis"], 2] == pytest.approx(-2.0, abs=0.3)
    person = vt.pack(vt.person(loa=1)).skeleton
    out = vt.retarget(motion, person)
    arm = [places(out)[0, person.index[f"l_{n}"]] for n in ("shoulder", "elbow", "radiocarpal")]
    upper, lower = arm[1] - arm[0], arm[2] - arm[1]
    bend = np.arccos(upper @ lower / np.linalg.norm(upper) / np.linalg.norm(lower))
    assert bend == pytest.approx(1.0, abs=1e-3)
    np.savez(tmp_path / "b.npz", poses=poses, trans=trans)
    with pytest.raises(FileError, match="b.npz: mocap_framerate: says no frame rate; say fps="):
        vt.load(tmp_path / "b.npz")
    assert vt.load(tmp_path / "b.npz", fps=30).fps == 30
    poses[:, 0] = np.pi / 4
    np.savez(tmp_path / "c.npz", poses=poses, trans=trans, mocap_framerate=np.array(100.0))
    with pytest.raises(FileError, match="does not show which axis is up; say up=z"):
        vt.load(tmp_path / "c.npz")


@pytest.mark.parametrize("up", UP_AXES)
def test_axes_change_places_exactly(up: str) -> None:
    points = cloud()
    assert np.array_equal(to_y_up(from_y_up(points, up), up), points)
    turn = np.stack([to_y_up(e, up) for e in np.eye(3)], axis=1)
    assert np.linalg.det(turn) == pytest.approx(1) and np.array_equal(turn @ turn.T, np.eye(3))
    axis = np.eye(3)["xyz".index(up[-1])] * (-1 if up.startswith("-") else 1)
    assert to_y_up(axis, up).tolist() == [0, 1, 0]


def gappy() -> Markers:
    points = cloud()
    points[2, 3] = points[0, 0] = points[4:, 7] = np.nan
    return Markers(LABELS, points, 100.0, first=11, start=0.11, events=((0.02, "Left Foot Strike"),))


@pytest.mark.parametrize("up", ["y", "z", "-y", "x"])
@pytest.mark.parametrize("unit", ["mm", "m", "in"])
def test_trc_there_and_back(tmp_path: Path, up: str, unit: str) -> None:
    markers = gappy()
    report = write_trc(markers, tmp_path / "a.trc", unit=unit, up=up)
    assert report["lost"] == ["1 events: the format holds markers only"]
    again = vt.load(tmp_path / "a.trc")
    assert again.up == up and again.names == markers.names and (again.first, again.start) == (11, 0.11)
    assert np.allclose(again.points, markers.points, atol=1e-6, equal_nan=True) and again.fps == 100


def test_csm_there_and_back(tmp_path: Path) -> None:
    markers = gappy()
    write_csm(markers, tmp_path / "a.csm")
    text = (tmp_path / "a.csm").read_text()
    assert text.count("DROPOUT DROPOUT DROPOUT") == 4 and "$Rate 100" in text
    again = vt.load(tmp_path / "a.csm")
    assert again.up == "z" and again.unit == 0.001 and again.names == markers.names and again.first == 11
    assert np.allclose(again.points, markers.points, atol=1e-8, equal_nan=True)
    other = text.replace("DROPOUT DROPOUT DROPOUT", "dropout").replace("$Rate 100\n", "").replace("$Order", "$ORDER")
    (tmp_path / "b.csm").write_text(other + "$Unknown more\n$Rate\n100\n")
    lenient = read_csm(tmp_path / "b.csm")
    assert np.array_equal(lenient.points, again.points, equal_nan=True) and "$unknown: more" in lenient.notes
    (tmp_path / "c.csm").write_text(text.replace("$Rate 100\n", ""))
    with pytest.raises(FileError, match=r"c.csm: says no frame rate \(\$Rate\); say fps="):
        read_csm(tmp_path / "c.csm")
    assert read_csm(tmp_path / "c.csm", fps=50).fps == 50


def test_nothing_is_guessed_in_silence(tmp_path: Path) -> None:
    """What neither the file nor the figure says is asked for."""
    flat = Markers(("a", "b", "c"), np.array([[[0, 0, 0], [1, 0.9, 0.8], [0.5, 0.9, 0.9]]]), 100.0)
    write_trc(flat, tmp_path / "a.trc")
    with pytest.raises(FileError, match="a.trc: up: .* say up=y or up=z"):
        read_trc(tmp_path / "a.trc")
    assert read_trc(tmp_path / "a.trc", up="y").points == pytest.approx(flat.points)
    write_csm(flat, tmp_path / "a.csm", unit=1e-5)
    with pytest.raises(FileError, match="a.csm: unit: the file says none, .* say unit=m, cm, mm or in"):
        read_csm(tmp_path / "a.csm")
    assert read_csm(tmp_path / "a.csm", unit=1e-5).points == pytest.approx(flat.points)


def test_trc_blank_cells_and_wrong_counts(tmp_path: Path) -> None:
    write_trc(gappy(), tmp_path / "a.trc", up="y")
    lines = (tmp_path / "a.trc").read_text().split("\n")
    lines[2] = lines[2].replace("\t6\t12", "\t900\t99")
    lines[7] = "\t".join(lines[7].split("\t")[:-9])
    (tmp_path / "b.trc").write_text("\r\n".join(lines))
    with pytest.warns(VitruvianWarning) as said:
        markers = read_trc(tmp_path / "b.trc")
    told = " | ".join(str(w.message) for w in said)
    assert "NumMarkers is 99, 12 markers are there" in told and "1 rows end early" in told
    assert np.isnan(markers.points[1, 9:]).all() and not np.isnan(markers.points[1, :3]).any()
    lines[7] += "\t1.0"
    (tmp_path / "c.trc").write_text("\n".join(lines))
    with pytest.raises(FileError, match=r"c.trc:8: row 1: expected 38 cells"):
        read_trc(tmp_path / "c.trc")


def z_up(points: np.ndarray) -> np.ndarray:
    """Millimetres, Z up."""
    return from_y_up(points, "z") * 1000


@pytest.mark.parametrize("real", [True, False])
@pytest.mark.parametrize("processor", ["Intel", "DEC", "MIPS"])
def test_c3d_of_every_processor(processor: str, real: bool, tmp_path: Path) -> None:
    points = cloud()
    points[1, 2] = np.nan
    analog = np.arange(6 * 4 * 2.0).reshape(24, 2)
    groups = {
        "ANALOG": {"USED": 2, "LABELS": ["Fz", "Mx"], "GEN_SCALE": 0.5, "SCALE": np.array([2.0, 4.0])},
        "EVENT": {"USED": 2, "LABELS": ["Foot Off", "Foot Strike"], "CONTEXTS": ["Left", "Right"],
                  "TIMES": np.array([[0.0, 0.05], [0.0, 0.02]])},
    }  # fmt: skip
    data = c3d(
        z_up(points), list(LABELS), processor=processor, real=real, groups=groups, analog=analog, samples=4, first=21
    )
    (tmp_path / "a.c3d").write_bytes(data)
    found = vt.load(tmp_path / "a.c3d")
    assert found.names == LABELS and found.fps == 100 and found.first == 21 and found.up == "z" and found.unit == 0.001
    assert np.allclose(found.points, points, atol=1e-6, equal_nan=True)
    assert found.analog["Fz"] == pytest.approx(analog[:, 0]) and found.analog["Mx"] == pytest.approx(2 * analog[:, 1])
    assert found.analog_fps == 400 and [n for _, n in found.events] == ["Right Foot Strike", "Left Foot Off"]


def test_c3d_more_than_255_labels_and_one_cut_short(tmp_path: Path) -> None:
    labels = [f"LHEE{i}" if i % 2 else f"LFHD{i}" for i in range(300)]
    points = cloud(4, 300)
    data = c3d(z_up(points), labels)
    (tmp_path / "a.c3d").write_bytes(data)
    assert read_c3d(tmp_path / "a.c3d", up="z").names[299] == "LHEE299"
    (tmp_path / "b.c3d").write_bytes(data[: len(data) - 300 * 16 - 512])
    with pytest.warns(VitruvianWarning, match="says 4 frames, [23] are there; the file is cut short"):
        short = read_c3d(tmp_path / "b.c3d")
    assert len(short) in (2, 3) and "the file says 4 frames" in " ".join(short.notes)
    assert np.allclose(short.points, points[: len(short)], atol=1e-6)


@pytest.mark.parametrize("kind", ["c3d", "trc", "subjects"])
def test_two_people_are_listed_and_chosen(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    two = np.concatenate([cloud(), cloud() + [1.0, 0, 0]], axis=1)
    mark = "_" if kind == "subjects" else ":"
    labels = [f"{who}{mark}{n}" for who in ("Ann", "Bob") for n in LABELS]
    path = tmp_path / f"two.{'trc' if kind == 'trc' else 'c3d'}"
    if kind == "trc":
        write_trc(Markers(tuple(labels), two, 100.0), path)
    else:
        groups = {"SUBJECTS": {"USED": 2, "NAMES": ["Ann", "Bob"], "LABEL_PREFIXES": ["Ann_", "Bob_"]}}
        path.write_bytes(c3d(z_up(two), labels, groups=groups if kind == "subjects" else None))
    with pytest.raises(FileError, match=r"holds 2 people: Ann \(12 markers\), Bob \(12 markers\); say which: actor="):
        vt.load(path)
    bob = vt.load(path, actor="Bob")
    assert bob.names == LABELS and np.allclose(bob.points, two[:, 12:], atol=1e-6)
    with pytest.raises(FileError, match="found 'Cid'"):
        vt.load(path, actor="Cid")
    command("info", path, "--json")
    assert json.loads(capsys.readouterr().out)["markers"]["actors"] == {"Ann": 12, "Bob": 12}
    command("convert", path, tmp_path / "ann.csm", "--actor", "Ann")
    assert vt.load(tmp_path / "ann.csm").names == LABELS


def test_c3d_is_what_other_readers_read(shared: Path) -> None:
    """Bit for bit, where ezc3d is installed; the share of missing points always."""
    path = shared / "data/motion/opensim_walking2.c3d"
    raw = raw_points(path)
    assert np.isnan(raw[..., 0]).mean() == pytest.approx(0.5016, abs=1e-4)
    ezc3d = pytest.importorskip("ezc3d")
    theirs = ezc3d.c3d(str(path))["data"]
    assert np.array_equal(raw, theirs["points"][:3].transpose(2, 1, 0), equal_nan=True)
    assert np.array_equal(np.array(list(read_c3d(path).analog.values())), theirs["analogs"][0])


def test_converting_captures(shared: Path, tmp_path: Path) -> None:
    folder = shared / "data" / "motion"
    command("convert", folder / "opensim_walk_free_01.trc", tmp_path / "b.csm")
    a, b = vt.load(folder / "opensim_walk_free_01.trc"), vt.load(tmp_path / "b.csm")
    assert a.names == b.names and np.allclose(a.points, b.points, atol=1e-7) and (b.first, b.fps) == (185, 60)
    command("convert", folder / "cmu_pirouette.amc", tmp_path / "p.bvh")
    c, d = vt.load(folder / "cmu_pirouette.amc"), vt.load(tmp_path / "p.bvh")
    assert np.abs(places(c) - places(d)).max() < 1e-4
    command("convert", folder / "makehuman_dance1.bvh", tmp_path / "m.npz")
    assert len(vt.load(tmp_path / "m.npz", up="z")) == 1
    command("convert", folder / "cmu_131_01_walk.bvh", tmp_path / "w.trc")
    tracks, motion = vt.load(tmp_path / "w.trc"), vt.load(folder / "cmu_131_01_walk.bvh")
    assert np.allclose(tracks.points[:, :31], places(motion), atol=1e-6)
    assert np.allclose(markers_of(motion).points, tracks.points, atol=1e-6)
    with pytest.raises(VitruvianError, match="markers have no joints; they can be written as .trc, .csm"):
        vt.save(a, tmp_path / "x.bvh")
    with pytest.raises(VitruvianError, match=r"--fps: .*walk.bvh takes --unit, --up"):
        command("convert", folder / "cmu_131_01_walk.bvh", tmp_path / "x.amc", "--fps", "30")


def test_animate_from_amc(shared: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """The person turns as the dancer does: the hips face where the AMC's root faces, the feet stay on the floor."""
    whole = (shared / "data/motion/cmu_pirouette.amc").read_text()
    clip = tmp_path / "part.amc"
    clip.write_text(whole[: whole.index("\n241\n") + 1])
    asf = shared / "data/motion/cmu_pirouette.asf"
    command("animate", "person", clip, "--skeleton", asf, "-o", tmp_path / "out.bvh", "--json")
    facts = json.loads(capsys.readouterr().out)
    assert facts["frames"] == 240 and facts["fps"] == 120 and facts["floor_penetration_mm"] < 5
    out, motion = vt.load(tmp_path / "out.bvh"), vt.load(clip, skeleton=asf)
    hips = world_rotations(out.skeleton.parents, out.rotation)[:, out.skeleton.index["sacroiliac"]]
    theirs = rotate(motion.rotation[:, 0], np.array([0.0, 0.0, 1.0]))[10:]
    ours = rotate(hips, np.array([0.0, 0.0, 1.0]))[10:]
    assert np.degrees(np.arccos(np.clip(np.einsum("fi,fi->f", theirs, ours), -1, 1))).max() < 15
    with pytest.raises(VitruvianError, match="expected a motion of joints, found markers"):
        command("animate", "person", shared / "data/motion/opensim_walk_free_01.trc", "-o", tmp_path / "no.glb")
