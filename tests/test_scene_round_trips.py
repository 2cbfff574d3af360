"""Reading what was written gives what was written: random graphs, all pairs of encodings."""

from __future__ import annotations

import warnings

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scene_graphs import comments, scenes
from vitruvian.formats.vrml import parse_vrml
from vitruvian.formats.vrml_writer import print_vrml
from vitruvian.formats.x3d import parse_x3d
from vitruvian.formats.x3d_writer import print_x3d
from vitruvian.hanim.compare import difference
from vitruvian.hanim.graph import Scene

ENCODINGS = ("x3d", "x3dv", "wrl")
# What a foreign encoding may say about these graphs: VRML97 has no H-Anim nodes and no units; XML needs a USE's type.
EXPECTED = ("is no node of VRML97", "VRML97 has no units", "stands for nothing")


def write(scene: Scene, encoding: str) -> tuple[bytes, list[str]]:
    text, lost = print_x3d(scene) if encoding == "x3d" else print_vrml(scene, encoding)
    return text.encode(), lost


def read(data: bytes, encoding: str) -> Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return (parse_x3d if encoding == "x3d" else parse_vrml)(data, "t")


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
