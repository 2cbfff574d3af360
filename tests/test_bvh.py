"""BVH: dialects, units, axes, hostile files, round trips."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skeletons import figure
from vitruvian.body.rotations import from_euler, multiply, rotate, to_matrix
from vitruvian.errors import FileError, VitruvianError, VitruvianWarning
from vitruvian.formats.bvh import read_bvh, write_bvh
from vitruvian.motion.turns import positions, world_rotations
from vitruvian.motion.types import Motion

PERSON = """HIERARCHY
ROOT Hips
{
  OFFSET 0 90 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Spine
  {
    OFFSET 0 20 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    JOINT Head
    {
      OFFSET 0 40 0
      CHANNELS 1 Yrotation
      End Site
      {
        OFFSET 0 20 0
      }
    }
  }
  JOINT LeftFoot
  {
    OFFSET 10 -90 0
    CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
    End Site
    {
      OFFSET 0 0 15
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.033333
1 91 2 30 40 50 10 20 30 45 10 -90 0 0 0 0
2 92 3 31 41 51 11 21 31 46 11 -89 1 5 6 7
"""


def write(tmp_path, text, name="clip.bvh"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def places(motion):
    world = world_rotations(motion.skeleton.parents, motion.rotation)
    return positions(
        motion.skeleton.parents, motion.skeleton.centers, world, motion.translation, motion.joint_translation
    )


def test_meaning_of_channels(tmp_path):
    """Angles multiply in channel order, orders differ per joint, positions replace the offset."""
    motion = read_bvh(write(tmp_path, PERSON))
    assert motion.skeleton.names == ("Hips", "Spine", "Head", "LeftFoot")
    assert motion.fps == pytest.approx(30)
    assert motion.notes[0].startswith("unit 0.01 m") and motion.notes[1].startswith("up axis Y")
    hips = from_euler(np.radians([30.0, 40.0, 50.0]), "ZYX")
    spine = multiply(hips, from_euler(np.radians([10.0, 20.0, 30.0]), "ZXY"))
    place = places(motion)[0]
    assert place[0] == pytest.approx([0.01, 0.91, 0.02])
    assert place[1] == pytest.approx(place[0] + rotate(hips, [0, 0.2, 0]))
    assert place[2] == pytest.approx(place[1] + rotate(spine, [0, 0.4, 0]))
    assert to_matrix(motion.rotation[0, 2])[0, 2] == pytest.approx(np.sin(np.radians(45)))
    later = places(motion)[1]
    hips = from_euler(np.radians([31.0, 41.0, 51.0]), "ZYX")
    assert later[3] == pytest.approx(later[0] + rotate(hips, [0.11, -0.89, 0.01]))
    assert motion.skeleton.site_names == ("Head_tip", "LeftFoot_tip")
    assert motion.skeleton.site_points[0] == pytest.approx([0, 1.7, 0])


def test_dialects(tmp_path):
    """Lower case, braces on the line of the name, tabs, mixed line ends, blank lines at the end, a byte order mark."""
    plain = read_bvh(write(tmp_path, PERSON))
    other = PERSON.replace("\n  {", " {").replace("Frames: 2", "frames:2").replace("ROOT", "root").replace("  ", "\t")
    other = other.replace("OFFSET", "offset").replace("Xrotation\n", "XROTATION\r\n") + "\n\n \n"
    twin = read_bvh(write(tmp_path, b"\xef\xbb\xbf" + other.encode()))
    assert twin.skeleton.names == plain.skeleton.names
    np.testing.assert_array_equal(twin.rotation, plain.rotation)
    np.testing.assert_array_equal(twin.joint_translation, plain.joint_translation)


def test_frames_may_be_broken_over_lines_and_names_have_spaces(tmp_path):
    text = PERSON.replace("30 40 50", "30\n40 50").replace("JOINT Head", "JOINT My Head")
    assert read_bvh(write(tmp_path, text)).skeleton.names[2] == "My Head"


def test_z_up_becomes_y_up(tmp_path):
    text = PERSON.replace("OFFSET 0 90 0", "OFFSET 0 0 90").replace("OFFSET 0 20 0", "OFFSET 0 0 20")
    text = text.replace("OFFSET 0 40 0", "OFFSET 0 0 40").replace("OFFSET 10 -90 0", "OFFSET 10 0 -90")
    text = text.replace("OFFSET 0 0 15", "OFFSET 0 -15 0")
    text = text.split("MOTION")[0] + "MOTION\nFrames: 1\nFrame Time: .04\n" + "0 0 90 0 0 10 0 0 0 0 10 0 -90 0 0 0\n"
    motion = read_bvh(write(tmp_path, text))
    assert "up axis Z" in motion.notes[1]
    assert motion.skeleton.centers[2] == pytest.approx([0, 1.5, 0])
    assert motion.skeleton.site_points[1] == pytest.approx([0.1, 0, 0.15])
    # ten degrees about the file's X are ten degrees about ours, which is the same axis
    assert rotate(motion.rotation[0, 0], [0, 1, 0]) == pytest.approx(
        [0, np.cos(np.radians(10)), np.sin(np.radians(10))]
    )
    forced = read_bvh(write(tmp_path, text), up="z", unit="mm")
    assert forced.skeleton.centers[2] == pytest.approx([0, 0.15, 0])
    assert "as asked for" in forced.notes[0]


@pytest.mark.parametrize(("factor", "unit"), [(1, "cm"), (10, "mm"), (0.01, "m"), (1 / 2.54, "in"), (0.1, "dm")])
def test_unit_is_found_by_the_height(tmp_path, factor, unit):
    lines = []
    for line in PERSON.splitlines():
        words = line.split()
        if words and words[0] == "OFFSET":
            line = "OFFSET " + " ".join(str(float(w) * factor) for w in words[1:])
        lines.append(line)
    motion = read_bvh(write(tmp_path, "\n".join(lines)))
    assert f"({unit})" in motion.notes[0]
    assert motion.skeleton.centers[2, 1] == pytest.approx(1.5)


BAD = {
    "empty": (b"", 1, "HIERARCHY"),
    "garbage": (bytes(range(256)) * 40, 1, "HIERARCHY"),
    "no motion": (PERSON.split("MOTION")[0], None, "MOTION"),
    "cut hierarchy": (PERSON.partition("      CHANNELS 1")[0], None, "still open"),
    "open joint": (PERSON.replace("}\nMOTION", "MOTION"), None, "still open"),
    "unit": (PERSON.replace("OFFSET 0 90 0", "OFFSET 0 9000 0").replace("-90 0\n", "-9000 0\n"), 0, "unit"),
    "no offset": (PERSON.replace("    OFFSET 0 20 0\n", "", 1), 18, "OFFSET"),
    "two numbers": (PERSON.replace("OFFSET 0 40 0", "OFFSET 0 40"), 12, "3 finite numbers"),
    "comma": (PERSON.replace("30 40 50", "30,5 40 50"), 33, "comma"),
    "nan": (PERSON.replace("31 41", "nan 41"), 34, "frame 1"),
    "word": (PERSON.replace("31 41", "x 41"), 34, "frame 1"),
    "few numbers": (PERSON.replace(" 5 6 7", ""), 34, "frame 1: expected 16 numbers, one per channel, found 13"),
    "few frames": (PERSON.replace("Frames: 2", "Frames: 3"), None, "expected 3 frames, found 2"),
    "many frames": (PERSON.replace("Frames: 2", "Frames: 99999999999"), None, "found 2"),
    "frame count": (PERSON.replace("Frames: 2", "Frames: -2"), 31, "frame count"),
    "frame time": (PERSON.replace("0.033333", "0"), 32, "frame time"),
    "channel": (PERSON.replace("1 Yrotation", "1 Wrotation"), 13, "Wrotation"),
    "channel twice": (
        PERSON.replace("3 Zrotation Xrotation Yrotation", "3 Zrotation Zrotation Yrotation"),
        9,
        "different",
    ),
    "channel count": (PERSON.replace("1 Yrotation", "2 Yrotation"), 13, "count"),
    "name twice": (PERSON.replace("JOINT Head", "JOINT Spine"), 10, "twice"),
    "second root": (PERSON.replace("MOTION", "ROOT Other\n{\nOFFSET 0 0 0\n}\nMOTION"), 30, "second ROOT"),
    "brace": (PERSON.replace("HIERARCHY\n", "HIERARCHY\n}\n"), 2, "expected {"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_say_where(tmp_path, case):
    text, line, what = BAD[case]
    with pytest.raises(FileError) as error:
        read_bvh(write(tmp_path, text))
    assert what in str(error.value)
    assert line is None or error.value.line == line
    assert "\n" not in str(error.value)


def test_missing_file_and_bad_options(tmp_path):
    with pytest.raises(FileError, match="can't be read"):
        read_bvh(tmp_path / "nothing.bvh")
    path = write(tmp_path, PERSON)
    with pytest.raises(FileError, match="expected x, y or z"):
        read_bvh(path, up="w")
    with pytest.raises(FileError, match="metres per unit"):
        read_bvh(path, unit="parsec")


def test_too_many_numbers_are_left_out(tmp_path):
    with pytest.warns(VitruvianWarning, match="3 numbers beyond"):
        motion = read_bvh(write(tmp_path, PERSON + "1 2 3\n"))
    assert len(motion) == 2


def test_deep_and_wide_files_are_quick(tmp_path):
    count = 3000
    text = "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 3 Zrotation Yrotation Xrotation\n"
    text += "".join(f"JOINT j{i}\n{{\nOFFSET 0 0.0005 0\nCHANNELS 1 Xrotation\n" for i in range(count))
    text += "}\n" * (count + 1) + "MOTION\nFrames: 1\nFrame Time: 0.01\n" + "0 " * (count + 3)
    start = time.perf_counter()
    motion = read_bvh(write(tmp_path, text), up="y")
    assert len(motion.skeleton) == count + 1
    assert time.perf_counter() - start < 20


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_mutations_never_crash(tmp_path_factory, data):
    """Any damage gives a motion or one FileError (warnings are fine)."""
    raw = bytearray(PERSON.encode())
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(raw) - 1))
        kind = data.draw(st.sampled_from(["set", "cut", "repeat"]))
        if kind == "set":
            raw[at] = data.draw(st.sampled_from(b"{}\n 0-.eEzX,\x00\xff"))
        elif kind == "cut":
            del raw[at : at + data.draw(st.integers(1, 60))]
        else:
            raw[at:at] = raw[at : at + data.draw(st.integers(1, 60))]
        if not raw:
            break
    path = tmp_path_factory.getbasetemp() / "mutated.bvh"
    path.write_bytes(bytes(raw))
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            motion = read_bvh(path)
        except FileError as error:
            assert "\n" not in str(error)
        else:
            assert np.isfinite(motion.rotation).all()


def random_motion(frames=40, loa=2, slides=False):
    rng = np.random.default_rng(5)
    skeleton = figure(loa)
    angles = np.cumsum(rng.normal(0, 0.2, (frames, len(skeleton), 3)), axis=0)  # far beyond a half turn
    shift = rng.normal(0, 0.1, (frames, len(skeleton), 3)) if slides else None
    move = rng.normal(0, 1, (frames, 3)) if shift is None else shift[:, 0]
    return Motion(skeleton, 60, from_euler(angles, "XYZ"), move, joint_translation=shift)


@pytest.mark.parametrize("slides", [False, True])
@pytest.mark.parametrize("order", ["ZYX", "ZXY", "XYZ", "YXZ"])
def test_written_clips_come_back(tmp_path, order, slides):
    motion = random_motion(slides=slides)
    write_bvh(motion, tmp_path / "out.bvh", order=order)
    back = read_bvh(tmp_path / "out.bvh", unit="cm", up="y")
    assert back.fps == pytest.approx(motion.fps)
    assert set(back.skeleton.names) == set(motion.skeleton.names)
    pick = [back.skeleton.index[n] for n in motion.skeleton.names]
    dots = np.abs(np.sum(back.rotation[:, pick] * motion.rotation, axis=-1))
    assert np.degrees(2 * np.arccos(np.clip(dots, 0, 1))).max() < 1e-4
    assert np.abs(places(back)[:, pick] - places(motion)).max() < 1e-6  # a tenth of a millimetre is asked for


def test_written_angles_do_not_jump(tmp_path):
    write_bvh(random_motion(frames=200), tmp_path / "out.bvh")
    lines = (tmp_path / "out.bvh").read_text().splitlines()
    values = np.array([line.split() for line in lines[lines.index("MOTION") + 3 :]], dtype=float)
    assert np.abs(np.diff(values[:, 3:], axis=0)).max() < 180


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "out.bvh"
    path.write_text("old")
    with pytest.raises(VitruvianError, match="unit"):
        write_bvh(random_motion(), path, unit="ell")
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["out.bvh"]


@pytest.mark.parametrize(
    ("name", "frames", "joints", "fps", "unit", "up", "height"),
    [
        ("cmu_01_01_playground", 2752, 31, 120, 0.0254 / 0.45, "Y", 1.45),
        ("cmu_131_01_walk", 994, 31, 120, 0.0254 / 0.45, "Y", 1.37),
        ("makehuman_dance1", 1, 75, 24, 0.1, "Z", 1.59),
    ],
)
def test_real_files(shared, tmp_path, name, frames, joints, fps, unit, up, height):
    path = shared / "data" / "motion" / f"{name}.bvh"
    motion = read_bvh(path)
    assert (len(motion), len(motion.skeleton)) == (frames, joints)
    assert motion.fps == pytest.approx(fps, rel=1e-3)
    assert f"unit {unit:.6g} m" in motion.notes[0] and f"{height} m high" in motion.notes[0]
    assert f"up axis {up}" in motion.notes[1]
    write_bvh(motion, tmp_path / "out.bvh", unit=unit)
    back = read_bvh(tmp_path / "out.bvh")
    assert np.abs(places(back) - places(motion)).max() < 1e-4
    dots = np.abs(np.sum(back.rotation * motion.rotation, axis=-1))
    assert np.degrees(2 * np.arccos(np.clip(dots, 0, 1))).max() < 1e-4


def test_positions_replace_the_offset_in_the_real_file(shared):
    """makehuman_dance1.bvh has the same numbers as OFFSET and as position: the root does not move from its rest."""
    motion = read_bvh(shared / "data" / "motion" / "makehuman_dance1.bvh")
    assert np.abs(motion.translation).max() < 1e-9


def test_channel_order_per_joint_in_the_real_file(shared):
    """cmu_131_01: arms are Z X Y, the rest Z Y X; read against the numbers of the file themselves."""
    path = shared / "data" / "motion" / "cmu_131_01_walk.bvh"
    motion = read_bvh(path)
    row = np.array(path.read_bytes().split(b"Frame Time:")[1].split(b"\n")[500].split(), dtype=float)
    index = motion.skeleton.index
    at = 3 + 3 * index["LeftElbow"]
    expected = from_euler(np.radians(row[at : at + 3]), "ZXY")
    assert np.abs(motion.rotation[499, index["LeftElbow"]] @ expected) == pytest.approx(1, abs=1e-9)
    at = 3 + 3 * index["LeftKnee"]
    expected = from_euler(np.radians(row[at : at + 3]), "ZYX")
    assert np.abs(motion.rotation[499, index["LeftKnee"]] @ expected) == pytest.approx(1, abs=1e-9)
