"""Whatever stands in a file: a humanoid, or one line that says why not; and the doctor always has an opinion."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scene_figure import GOOD, MOTION, VRML
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.vrml import parse_vrml
from vitruvian.formats.x3d import parse_x3d
from vitruvian.formats.x3d_json import parse_json
from vitruvian.formats.x3d_json_writer import print_json
from vitruvian.hanim import triangulate
from vitruvian.hanim.build import scene_of
from vitruvian.hanim.doctor import check
from vitruvian.hanim.doctor_fix import mend
from vitruvian.hanim.graph import Scene
from vitruvian.hanim.view import humanoids

TEXTS = {"x3d": GOOD.replace("</HAnimHumanoid>", MOTION), "wrl": VRML}
TEXTS["x3dj"] = print_json(parse_x3d(TEXTS["x3d"].encode()))[0]
PARSERS = {"x3d": parse_x3d, "wrl": parse_vrml, "x3dj": parse_json}
WORD = re.compile(r"[\w.-]+")
RUBBISH = [
    *("nan", "-1", "1e400", '""', "USE", "99999999", "NULL", "TRUE", "0", "[", "]", "Joint", "HAnimJoint", "skeleton"),
    *("children", "hanim_l_elbow", "joints", "name", "Shape", "HAnimSite", "displacers", "coordIndex", "value_changed"),
]
CHANGES = st.lists(
    st.tuples(st.integers(0, 10**6), st.sampled_from(RUBBISH) | st.integers(0, 10**6)), min_size=1, max_size=5
)


def changed(text: str, changes: list) -> str:
    """The text with words replaced by rubbish, or by other words of it."""
    for at, new in changes:
        words = list(WORD.finditer(text))
        word = words[at % len(words)]
        text = text[: word.start()] + (new if isinstance(new, str) else words[new % len(words)][0]) + text[word.end() :]
    return text


def read(kind: str, text: str) -> Scene | None:
    try:
        return PARSERS[kind](text.encode(), f"f.{kind}")
    except FileError:
        return None


@settings(max_examples=120, deadline=None, suppress_health_check=list(HealthCheck))
@given(kind=st.sampled_from(sorted(TEXTS)), changes=CHANGES)
def test_broken_files(kind: str, changes: list) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = read(kind, changed(TEXTS[kind], changes))
        if scene is None:
            return
        for finding in check(scene):
            assert finding.message
            assert "\n" not in finding.message
        try:
            found = humanoids(scene)
        except FileError as error:
            assert "\n" not in str(error)
            assert {f.severity for f in check(scene)} & {"error", "warning"}, error
            found = humanoids(scene, repair=True)
        humanoids(scene)
        mend(scene)
        assert mend(scene) == []
        for h in found:
            try:
                scene_of([h], version="2.0")
                scene_of([h], version="1.1", encoding="wrl")
                scene_of([h], encoding=kind)
            except VitruvianError as error:
                assert "\n" not in str(error)


@settings(max_examples=150, deadline=None)
@given(
    radii=st.lists(st.floats(0.2, 1), min_size=3, max_size=24),
    normal=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1),
    clockwise=st.booleans(),
)
def test_any_simple_polygon_keeps_its_area_and_side(radii: list, normal: tuple, clockwise: bool) -> None:
    """Star-shaped polygons in any plane: triangles all face the polygon's way and add up to its area."""
    turn = 2 * np.pi * np.arange(len(radii)) / len(radii)
    z = np.array(normal) / np.linalg.norm(normal)
    x = np.cross(z, [0.3, 0.5, 0.8] if abs(z @ [0.3, 0.5, 0.8]) < 0.9 else [1, 0, 0])
    x /= np.linalg.norm(x)
    points = np.outer(np.array(radii) * np.cos(turn), x) + np.outer(np.array(radii) * np.sin(turn), np.cross(z, x))
    if clockwise:
        points, z = points[::-1], -z
    corners, owner = triangulate.faces(np.arange(len(points)), points)
    assert corners.shape == (len(points) - 2, 3)
    assert (owner == 0).all()
    a, b, c = (points[corners[:, k]] for k in range(3))
    areas = np.cross(b - a, c - a) @ z / 2
    whole = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0) @ z / 2
    assert areas.min() > -1e-9
    np.testing.assert_allclose(areas.sum(), whole, atol=1e-9)


@pytest.mark.parametrize("kind", sorted(TEXTS))
def test_every_number_that_is_none_is_found(kind: str) -> None:
    """One after the other, also those of looks and shapes: what reading refuses, the doctor names."""
    words = [m[0] for m in WORD.finditer(TEXTS[kind])]
    numbers = [n for n, word in enumerate(words) if word.lstrip("-").replace(".", "").isdigit()]
    assert len(numbers) > 20
    for at in numbers:
        test_broken_files.hypothesis.inner_test(kind, [(at, "nan")])


@pytest.mark.parametrize("kind", sorted(TEXTS))
def test_whole_numbers_that_are_written_with_a_point(kind: str) -> None:
    words = [m[0] for m in WORD.finditer(TEXTS[kind])]
    numbers = [n for n, word in enumerate(words) if word.isdigit()]
    for at in numbers:
        test_broken_files.hypothesis.inner_test(kind, [(at, words[at] + ".0")])
