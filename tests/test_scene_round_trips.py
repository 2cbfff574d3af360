"""Reading what was written gives what was written: random graphs and real files, all pairs of encodings."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from conftest import SHARED
from scene_graphs import comments, scenes
from vitruvian.formats.convert import convert
from vitruvian.formats.registry import scene as load
from vitruvian.formats.vrml import parse_vrml
from vitruvian.formats.vrml_writer import print_vrml
from vitruvian.formats.x3d import parse_x3d
from vitruvian.formats.x3d_json import parse_json
from vitruvian.formats.x3d_json_writer import print_json
from vitruvian.formats.x3d_writer import print_x3d
from vitruvian.hanim.compare import difference
from vitruvian.hanim.graph import Literal, Node, Scene

ENCODINGS = ("x3d", "x3dv", "wrl", "x3dj")
# What a foreign encoding may say about these graphs: VRML97 has no H-Anim nodes and no units; XML needs a USE's type.
EXPECTED = ("is no node of VRML97", "VRML97 has no units", "stands for nothing")


def write(scene: Scene, encoding: str) -> tuple[bytes, list[str]]:
    if encoding == "x3dj":
        text, lost = print_json(scene)
    else:
        text, lost = print_x3d(scene) if encoding == "x3d" else print_vrml(scene, encoding)
    return text.encode(), lost


def read(data: bytes, encoding: str) -> Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return {"x3d": parse_x3d, "x3dj": parse_json}.get(encoding, parse_vrml)(data, "t")


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_random_graphs_come_back(encoding: str) -> None:
    @settings(max_examples=25, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(scenes(encoding))
    def round_trips(scene: Scene) -> None:
        for other in ENCODINGS:
            data, lost = write(scene, other)
            back = read(data, other)
            assert difference(scene, back, typed=True) == ""
            assert [what for what in lost if not any(e in what for e in EXPECTED)] == []
            if other == encoding:
                assert lost == [] or encoding != "x3dv"
                assert comments(back) == comments(scene)
                again, _ = write(back, other)
                assert again == data
                assert difference(back, read(again, other)) == ""

    round_trips()


@pytest.mark.parametrize(
    "word", ["true", "TRUE", "False", "tRuE false", "Falsehood", "NULL", "1e5", "0x1F", "''", "[", "#"]
)
def test_words_of_unknown_nodes_mean_the_same_everywhere(word: str) -> None:
    node = Node("ShipOfTheseus", fields={"planks": Literal(word, "xml")})
    scene = Scene("", "x3d", "4.0", body=[node])
    for other in ENCODINGS:
        assert difference(scene, read(write(scene, other)[0], other), typed=True) == ""


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_there_and_back_again(encoding: str) -> None:
    """A -> B -> A keeps what the values mean."""

    @settings(max_examples=8, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(scenes(encoding), st.sampled_from([e for e in ENCODINGS if e != encoding]))
    def returns(scene: Scene, other: str) -> None:
        there = read(write(scene, other)[0], other)
        back = read(write(there, encoding)[0], encoding)
        assert difference(scene, back, typed=True) == ""

    returns()


# Each encoding into each other one, in one walk.
WALK = ("x3d", "x3dv", "x3d", "wrl", "x3d", "x3dj", "x3dv", "wrl", "x3dv", "x3dj", "wrl", "x3dj", "x3d")
REAL = sorted(p.name for p in (SHARED / "data" / "hanim").glob("*.[xw]*")) or ["(none)"]


def test_the_walk_goes_everywhere() -> None:
    assert set(zip(WALK, WALK[1:], strict=False)) == {(a, b) for a in ENCODINGS for b in ENCODINGS if a != b}


@pytest.mark.parametrize("name", REAL)
def test_real_files_through_all_encodings(shared: Path, name: str) -> None:
    """The graph is the same after every pair of encodings, and what is written twice is written the same."""
    path = shared / "data" / "hanim" / name
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = original = load(path)
        for number, encoding in enumerate(WALK):
            scene, lost = convert(scene, encoding)
            assert [what for what in lost if not any(e in what for e in EXPECTED)] == []
            if path.stat().st_size < 80_000 or number + 1 == len(WALK):
                assert difference(original, scene, typed=True) == "", WALK[: number + 1]
        for encoding in ENCODINGS:
            data, _ = write(scene, encoding)
            once = read(data, encoding)
            again, _ = write(once, encoding)
            assert again == data
            assert difference(once, read(again, encoding)) == ""


def test_the_comparison_sees_changes() -> None:
    """One changed number, name, comment or field order is a difference."""
    text = b"<X3D version='4.0'><Scene><!--a--><Transform DEF='t' scale='1 1 1' rotation='0 0 1 0'/></Scene></X3D>"
    scene = read(text, "x3d")
    assert difference(scene, read(text, "x3d")) == ""
    for old, new, typed in [
        (b"1 1 1", b"1 1 2", True),
        (b"DEF='t'", b"DEF='u'", True),
        (b"<!--a-->", b"<!--b-->", False),
        (b"scale='1 1 1' rotation='0 0 1 0'", b"rotation='0 0 1 0' scale='1 1 1'", False),
        (b"1 1 1", b"1.0 1 1", False),
    ]:
        changed = read(text.replace(old, new), "x3d")
        assert difference(scene, changed) != ""
        assert bool(difference(scene, changed, typed=True)) == typed
