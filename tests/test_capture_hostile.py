"""Broken capture files: a thousand mutations of each kind, and what bombs and liars get."""

from __future__ import annotations

import io
import random
import time
import tracemalloc
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest

import vitruvian as vt
from capture_maker import AMC, ASF, LABELS, c3d, cloud, mutated
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.amass import LAYOUTS, figure, write_amass
from vitruvian.formats.csm import write_csm
from vitruvian.formats.trc import write_trc
from vitruvian.motion.markers import Markers, from_y_up
from vitruvian.motion.types import Motion

CASES = 1000
MOT = "x\nnRows=3\nnColumns=3\ninDegrees=yes\nendheader\ntime\ta\tb\n0\t1\t2\n0.1\t1\t2\n0.2\t1.5\tnan\n"


def good(kind: str, folder: Path) -> bytes:
    """A small file of that kind."""
    if kind in ("amc", "asf", "mot"):
        return {"amc": AMC, "asf": ASF, "mot": MOT}[kind].encode()
    path = folder / f"good.{kind}"
    points = cloud()
    points[2, 3] = points[4:, 7] = np.nan
    markers = Markers(LABELS, points, 100.0)
    if kind == "c3d":
        analog = np.arange(12.0).reshape(12, 1)
        groups = {"ANALOG": {"USED": 1, "LABELS": ["Fz"], "SCALE": np.array([2.0])}}
        return c3d(from_y_up(points, "z") * 1000, list(LABELS), groups=groups, analog=analog, samples=2)
    if kind == "npz":
        turns = np.zeros((4, 22, 4))
        turns[..., 3] = 1
        write_amass(Motion(figure(LAYOUTS[22]), 60.0, turns, np.zeros((4, 3))), path)
    else:
        (write_trc if kind == "trc" else write_csm)(markers, path)
    return path.read_bytes()


@pytest.mark.parametrize("kind", ["amc", "asf", "npz", "c3d", "trc", "csm", "mot"])
def test_a_thousand_mutations(kind: str, tmp_path: Path) -> None:
    """Each is read, or refused in one line that names the file; nothing else comes out."""
    data = good(kind, tmp_path)
    path = tmp_path / f"case.{kind}"
    if kind == "amc":
        (tmp_path / "case.asf").write_text(ASF)
    read = refused = 0
    slowest = 0.0
    for seed in range(CASES):
        changed = mutated(data, seed)
        if kind == "npz" and seed % 2:  # the zip as it is, an array inside changed
            changed = inside(data, seed)
        path.write_bytes(changed)
        start = time.perf_counter()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)
                warnings.simplefilter("error", RuntimeWarning)
                thing = vt.load(path)
            read += 1
            assert len(thing) >= (1 if kind != "npz" else 0)
        except FileError as error:
            refused += 1
            text = str(error)
            assert "\n" not in text and f"case.{'asf' if kind == 'asf' else kind}" in text, (seed, text)
        except (VitruvianError, Exception) as error:
            raise AssertionError(f"case {seed}: {type(error).__name__}: {error}") from error
        slowest = max(slowest, time.perf_counter() - start)
    print(f"{kind}: {read} read, {refused} refused, the slowest took {slowest * 1000:.1f} ms")
    assert read > 20 and refused > 20 and slowest < 2


def inside(data: bytes, seed: int) -> bytes:
    """The npz with one of its arrays mutated."""
    rng = random.Random(seed)
    source = zipfile.ZipFile(io.BytesIO(data))
    names = source.namelist()
    victim = rng.choice(names)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name in names:
            member = source.read(name)
            archive.writestr(name, mutated(member[:200], seed) + member[200:] if name == victim else member)
    return out.getvalue()


def npz(path: Path, **arrays: bytes | np.ndarray) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            body = io.BytesIO()
            if isinstance(array, np.ndarray):
                np.lib.format.write_array(body, array, allow_pickle=True)
            archive.writestr(f"{name}.npy", body.getvalue() if isinstance(array, np.ndarray) else array)
    return path


def test_bombs_pickles_and_lies_about_shapes(tmp_path: Path) -> None:
    bomb = npz(tmp_path / "bomb.npz", poses=np.zeros((40_000, 156)))
    assert bomb.stat().st_size < 200_000
    tracemalloc.start()
    with pytest.raises(FileError, match="bomb.npz: poses: unpacks from .* it may be a zip bomb"):
        vt.load(bomb)
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()
    with pytest.raises(FileError, match="poses: expected numbers, found object; pickles are never read"):
        vt.load(npz(tmp_path / "pickle.npz", poses=np.array([{}, None], dtype=object)))
    head = io.BytesIO()
    told = {"descr": "<f8", "fortran_order": False, "shape": (10**9, 156)}
    np.lib.format.write_array_header_1_0(head, told)
    with pytest.raises(FileError, match=r"poses: shape \(1000000000, 156\) needs .* bytes, the file has 136"):
        vt.load(npz(tmp_path / "lie.npz", poses=head.getvalue() + b"\0" * 8))
    for name, arrays, what in (
        (
            "width",
            {"poses": np.zeros((3, 100))},
            r"poses: expected \(frames, 66 or 72 or 156 or 165\), found \(3, 100\)",
        ),
        ("nan", {"poses": np.full((3, 156), np.nan)}, r"poses: expected finite numbers, found nan at \[0, 0, 0\]"),
        ("trans", {"poses": np.zeros((3, 156)), "trans": np.zeros((2, 3))}, r"trans: expected shape \(3, 3\)"),
        ("none", {"other": np.zeros(3)}, "poses: expected that array"),
    ):
        with pytest.raises(FileError, match=what):
            vt.load(npz(tmp_path / f"{name}.npz", **arrays))


def test_empty_and_binary_files(tmp_path: Path) -> None:
    (tmp_path / "a.asf").write_text(ASF)
    for kind in ("amc", "asf", "npz", "c3d", "trc", "csm", "mot"):
        for name, data in (("empty", b""), ("noise", random.Random(1).randbytes(5000)), ("zero", b"\0" * 5000)):
            path = tmp_path / f"{name}.{kind}"
            path.write_bytes(data)
            with pytest.raises(FileError) as caught:
                vt.load(path, skeleton=tmp_path / "a.asf") if kind == "amc" else vt.load(path)
            assert str(caught.value).startswith(str(path)) and "expected" in str(caught.value)


@pytest.mark.parametrize(
    "change, what",
    [
        (("1.62", "1,62"), r"a.trc:7: frame 1: expected a coordinate, found '1,62.*decimal commas"),
        (("DataRate", "Rate"), "a.trc:3: expected DataRate"),
        (("\n2\t0.01", "\n2\t0.00"), "a.trc:8: frame 1: expected times that rise, found 0 after 0"),
        (("\n3\t", "\nthree\t"), "a.trc:9: row 2: expected a frame number, found 'three'"),
        (("\n3\t0.02", "\n3\tinf"), "a.trc:9: frame 3: expected a time in seconds, found 'inf"),
    ],
)  # fmt: skip
def test_trc_errors_name_line_and_frame(change: tuple[str, str], what: str, tmp_path: Path) -> None:
    write_trc(Markers(LABELS, cloud(), 100.0), tmp_path / "a.trc", unit="m")
    text = (tmp_path / "a.trc").read_text()
    assert change[0] in text
    (tmp_path / "a.trc").write_text(text.replace(*change, 1))
    with pytest.raises(FileError, match=what):
        vt.load(tmp_path / "a.trc")


def test_asf_errors_name_the_line(tmp_path: Path) -> None:
    path = tmp_path / "a.asf"
    for old, new, what in (
        ("lfemur ltibia", "lfemur lfemur", r"a.asf:\d+: bone 'lfemur' hangs in two places"),
        ("root lfemur head", "root lfemur tail", r"a.asf:\d+: the hierarchy names a bone 'tail'"),
        ("dof rx ry rz", "dof rx rx", r"a.asf:\d+: expected different ones of tx"),
        ("           (-60.0 70.0)\n", "", r"a.asf:\d+: bone lfemur: expected limits for 3 dof, found 2"),
        ("axis 0 0 20 XYZ", "axis 0 0 nan XYZ", r"a.asf:18: expected a number, found 'nan'"),
        ("name ltibia", "name lfemur", r"a.asf:\d+: the bone name 'lfemur' is used twice"),
        (":hierarchy", ":other", r"a.asf:\d+: expected the section :hierarchy"),
    ):
        assert old in ASF
        path.write_text(ASF.replace(old, new, 1))
        with pytest.raises(FileError, match=what):
            vt.load(path)
    # a root of its own below another: a loop that hangs on nothing
    path.write_text(
        ASF.replace("root lfemur head", "root head").replace("lfemur ltibia", "lfemur ltibia\nltibia lfemur")
    )
    with pytest.warns(UserWarning, match="hangs on nothing that leads to the root"):
        assert vt.load(path).skeleton.names == ("root", "head")


def test_deep_skeletons_do_not_recurse(tmp_path: Path) -> None:
    """Two thousand bones in a row."""
    count = 2000
    bones = "".join(f" begin\n name b{i}\n direction 0 1 0\n length 0.006\n end\n" for i in range(count))
    tree = "root b0\n" + "".join(f"b{i} b{i + 1}\n" for i in range(count - 1))
    path = tmp_path / "deep.asf"
    path.write_text(f":units\n length 0.45\n:root\n:bonedata\n{bones}:hierarchy\nbegin\n{tree}end\n")
    start = time.perf_counter()
    assert len(vt.load(path).skeleton) == count + 1
    assert time.perf_counter() - start < 5
