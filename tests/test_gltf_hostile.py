"""Whatever stands in a glTF file: something that can be shown, or one line that says why not, in bounded time."""

from __future__ import annotations

import copy
import functools
import json
import random
import struct
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import vitruvian as vt
from gltf_maker import Foreign, Maker
from gltf_player import Player
from small_body import figure, wave
from test_vrm import vrm_file
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.glb import write_glb
from vitruvian.hanim.humanoid import Humanoid

RUBBISH: list[Any] = [None, -1, 0, 1, 2, 3, 7, 65536, 2**31, 2**63, 1e300, -0.5, 1e-30, True, "", "x", "..", [], {}, [0],
                      [1e38] * 3, [0] * 4, [0] * 16, {"node": 0}, "SCALAR", "VEC4", "MAT4", 5121, 5126]  # fmt: skip


@functools.cache
def seeds() -> tuple[tuple[dict, bytes, str], ...]:
    """(JSON, bytes, ending) of good files of several kinds."""
    folder = Path(tempfile.mkdtemp())
    body = figure()
    write_glb(vt.Clip(Humanoid("t", info={"age": "3"}), body, wave(body), "linear"), folder / "own.glb")
    vrm_file(folder / "a.vrm", 1)
    vrm_file(folder / "b.vrm", 0)
    rig = Foreign(skin=False)
    rig.animate([0, 1.0], LeftArm=("rotation", [[0, 0, 0, 1.0], [0, 1, 0, 0]], "STEP"))
    rig.maker.glb(folder / "c.glb")
    out = []
    for path in sorted(folder.iterdir()):
        player = Player(path)
        out.append((player.json, player.bin, path.suffix))
    return tuple(out)


def places(value: Any) -> list[tuple[Any, Any]]:
    """Every (holder, key) in a JSON document."""
    out: list[tuple[Any, Any]] = []
    stack = [value]
    while stack:
        item = stack.pop()
        pairs = item.items() if isinstance(item, dict) else enumerate(item) if isinstance(item, list) else ()
        for key, inner in pairs:
            out.append((item, key))
            stack.append(inner)
    return out


def broken(number: int, changes: list[tuple[int, int]], bites: list[tuple[int, int]], folder: Path) -> Path:
    document, data, ending = seeds()[number % len(seeds())]
    document = copy.deepcopy(document)
    for at, what in changes:
        known = places(document)
        holder, key = known[at % len(known)]
        if what % 7 == 0:
            del holder[key]
        elif what % 7 == 1:
            other, inner = known[(at * 31 + what) % len(known)]
            holder[key] = copy.deepcopy(other[inner])
        else:
            holder[key] = copy.deepcopy(RUBBISH[what % len(RUBBISH)])
    raw = bytearray(data)
    for at, what in bites:
        raw[at % len(raw)] = what % 256
    return container(document, bytes(raw), folder / f"f{ending}")


def container(document: dict, raw: bytes, path: Path) -> Path:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(raw), 0x004E4942) + raw
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path


def survives(path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = vt.load(path)
        except FileError as error:
            assert "\n" not in str(error)
            return
        if isinstance(found, Humanoid):
            try:
                vt.pack(found)
            except VitruvianError as error:
                assert "\n" not in str(error)


@settings(max_examples=250, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    number=st.integers(0, 3),
    changes=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 10**6)), min_size=0, max_size=4),
    bites=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=6),
)
def test_broken_files(number: int, changes: list, bites: list, tmp_path_factory: pytest.TempPathFactory) -> None:
    survives(broken(number, changes, bites, _folder()))


def test_bind_matrices_without_a_size(tmp_path: Path) -> None:
    survives(broken(1, [(7792, 7792), (7791, 274)], [], tmp_path))
    for document, data, _ in seeds():
        for skin in range(len(document.get("skins", []))):
            flat = copy.deepcopy(document)
            view = flat["bufferViews"][flat["accessors"][flat["skins"][skin]["inverseBindMatrices"]]["bufferView"]]
            raw = bytearray(data)
            start = view.get("byteOffset", 0)
            raw[start : start + 64] = struct.pack("<16f", *[1e-30, *[0] * 4, 1, *[0] * 4, 1, *[0] * 4, 1])
            survives(container(flat, bytes(raw), tmp_path / "flat.glb"))


@functools.cache
def _folder() -> Path:
    return Path(tempfile.mkdtemp())


def test_cut_and_garbled_containers(tmp_path: Path) -> None:
    data = Foreign().maker.glb(tmp_path / "a.glb").read_bytes()
    rng = random.Random(0)
    for k in range(60):
        cut = data[: rng.randrange(len(data))] if k % 2 else bytearray(data)
        if k % 2 == 0:
            for _ in range(4):
                cut[rng.randrange(40)] = rng.randrange(256)
        (tmp_path / "b.glb").write_bytes(bytes(cut))
        survives(tmp_path / "b.glb")
    for text in (
        b"",
        b"{}",
        b"[1]",
        b'{"asset": {"version": "1.0"}}',
        b"[" * 100000,
        b'{"a": ' * 5000,
        b"\xff\xfe{}",
        b"nul",
    ):
        (tmp_path / "b.gltf").write_bytes(text)
        with pytest.raises(FileError):
            vt.load(tmp_path / "b.gltf")


def refused(tmp_path: Path, maker: Maker, what: str) -> None:
    start = time.process_time()
    with pytest.raises(FileError, match=what) as error:
        vt.load(maker.glb(tmp_path / "a.glb"))
    assert "\n" not in str(error.value) and time.process_time() - start < 5


def test_nodes_must_be_a_tree(tmp_path: Path) -> None:
    m = Maker()
    for k in range(3):
        m.put("nodes", {"children": [(k + 1) % 3]})
    refused(tmp_path, m, "tree")
    m.json["scenes"] = [{"nodes": [0]}]
    refused(tmp_path, m, "tree|hangs")
    m = Maker()
    m.json["nodes"] = [{"children": [2]}, {"children": [2]}, {}]
    refused(tmp_path, m, "two places")
    m.json["nodes"] = [{"children": [9]}]
    refused(tmp_path, m, "0..0")


def test_deep_trees_are_no_problem(tmp_path: Path) -> None:
    rig = Foreign()
    m = rig.maker
    count = len(m.json["nodes"])
    m.json["nodes"] += [{"name": "n", "children": [count + k + 1]} for k in range(20000)] + [{"name": "end"}]
    m.json["nodes"][rig.bone["Head"]].setdefault("children", []).append(count)
    start = time.process_time()
    assert len(vt.load(m.glb(tmp_path / "a.glb")).joints()) == len(rig.bone)
    assert time.process_time() - start < 10


def test_counts_are_limited(tmp_path: Path) -> None:
    m = Maker()
    huge = m.put("accessors", {"componentType": 5126, "count": 2**27 - 1, "type": "VEC3"})
    m.put("meshes", {"primitives": [{"attributes": {"POSITION": huge}}]})
    m.put("nodes", {"mesh": 0})
    refused(tmp_path, m, "at most")
    m = Maker()  # one list of vertices, used a thousand times over
    position = m.add(np.zeros((100000, 3)))
    for k in range(1000):
        m.put("meshes", {"primitives": [{"attributes": {"POSITION": position}}]})
        m.put("nodes", {"mesh": k})
    refused(tmp_path, m, "at most|triangles")
    m = Foreign()
    m.animate([0, 1e8], Hips=("translation", np.zeros((6, 3)), "CUBICSPLINE"))
    survives(m.maker.glb(tmp_path / "b.glb"))
    m = Foreign(skin=False)
    m.animate([0, 1e-4, 1e8], LeftArm=("rotation", np.tile([0, 0, 0, 1.0], (3, 1)), "LINEAR"))
    refused(tmp_path, m.maker, "at most")


def test_every_number_is_checked(tmp_path: Path) -> None:
    """Views past their buffer, accessors past their view, indices past their list, numbers that are none."""

    def change(where: str, key: str, value: Any, what: str) -> None:
        rig = Foreign()
        entry = rig.maker.json
        for step in where.split("/"):
            entry = entry[int(step) if step.isdigit() else step]
        entry[key] = value
        refused(tmp_path, rig.maker, what)

    change("bufferViews/0", "byteLength", 10, "bytes")
    change("bufferViews/0", "byteOffset", 10**6, "inside a buffer")
    change("accessors/0", "count", 10**5, "need")
    change("accessors/0", "byteOffset", 16, "need")
    change("accessors/0", "componentType", 5124, "componentType")
    change("accessors/0", "type", "VEC9", "type")
    change("accessors/0", "type", "VEC2", "VEC3")
    change("skins/0", "joints", [0, 999], "0..")
    change("skins/0", "joints", [1, 2], "JOINTS_0|joint")
    change("skins/0", "inverseBindMatrices", 0, "MAT4")
    change("meshes/0/primitives/0", "indices", 0, "whole numbers")
    change("nodes/1", "rotation", [0, 0, "x", 1], "4 numbers")
    change("nodes/1", "translation", [1e200, 0, 0], "3 numbers")
    change("asset", "version", "1.0", "version 2")
    for name in ("KHR_draco_mesh_compression", "ACME_unknown"):
        rig = Foreign()
        rig.maker.json["extensionsRequired"] = [name]
        refused(tmp_path, rig.maker, name)
    rig = Foreign()
    rig.maker.bin[100:104] = struct.pack("<f", float("nan"))
    refused(tmp_path, rig.maker, "finite")


def test_whole_numbers_may_be_written_with_a_point(tmp_path: Path) -> None:
    """The mesh of a node as 0.0: JSON makes no difference."""
    body = figure()
    write_glb(vt.Clip(Humanoid("t"), body, wave(body), "linear"), tmp_path / "own.glb")
    player = Player(tmp_path / "own.glb")
    document = copy.deepcopy(player.json)
    for node in document["nodes"]:
        for key in ("mesh", "skin"):
            if key in node:
                node[key] = float(node[key])
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = (
        struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(player.bin), 0x004E4942) + player.bin
    )
    (tmp_path / "b.glb").write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks)
    first, second = vt.load(tmp_path / "own.glb"), vt.load(tmp_path / "b.glb")
    assert [j.name for j in first.joints()] == [j.name for j in second.joints()]
    assert np.array_equal(first.skin_coord, second.skin_coord) and len(first.displacers()) == len(second.displacers())
