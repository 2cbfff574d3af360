"""A scene whose syntax is broken: the doctor says where, and what could be read; nothing loads it."""

from __future__ import annotations

import warnings

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scene_figure import GOOD, VRML
from vitruvian.errors import FileError
from vitruvian.formats import registry
from vitruvian.formats.vrml import parse_vrml
from vitruvian.formats.x3d import parse_x3d
from vitruvian.formats.x3d_json import parse_json
from vitruvian.formats.x3d_json_writer import print_json
from vitruvian.hanim.doctor import unreadable
from vitruvian.hanim.graph import Scene

JSON = print_json(parse_x3d(GOOD.encode(), "tin"))[0]
READERS = {"x3d": (parse_x3d, GOOD), "wrl": (parse_vrml, VRML), "x3dj": (parse_json, JSON)}
AT = {"x3d": ('name="l_elbow"', "3 joints"), "wrl": ('"sacrum"', "1 joint"), "x3dj": ('"l_elbow"', "4 joints")}


@pytest.mark.parametrize("form", READERS)
def test_the_doctor_says_what_could_be_read_and_load_refuses(tmp_path, form):
    _, text = READERS[form]
    word, joints = AT[form]
    cut = text[: text.index(word) + len(word) + 3]
    path = tmp_path / f"cut.{form}"
    path.write_text(cut)
    (finding,) = registry.check(path)
    assert (finding.rule, finding.severity) == ("F02", "error")
    assert finding.line == cut.count("\n") + 1 or "ends inside" in finding.message
    assert f"read before it: 1 humanoid, {joints}" in finding.fix, finding.fix
    with pytest.raises(FileError):
        registry.load(path)


def test_the_last_node_before_the_place_is_named():
    broken = GOOD.replace("</HAnimSegment>", "</Segment>")
    with pytest.raises(FileError) as caught:
        parse_x3d(broken.encode(), "tin.x3d")
    assert unreadable(caught.value).fix.endswith("the last is HAnimSite hanim_navel_pt of line 10")
    assert isinstance(caught.value.partial, Scene)
    with pytest.raises(FileError) as caught:
        parse_x3d(b"<X3D version='4.0'><Scene><", "empty.x3d")
    assert unreadable(caught.value).fix == "read before it: no node"


@given(st.sampled_from(sorted(READERS)), st.floats(0, 1), st.text(alphabet='<>{}[]",/ a1', max_size=3))
def test_wherever_it_breaks_there_is_one_answer(form, share, noise):
    reader, text = READERS[form]
    at = int(share * len(text))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            reader((text[:at] + noise).encode(), "cut")
        except FileError as error:
            found = unreadable(error, "")
            assert found.rule == "F02" and "\n" not in found.fix
