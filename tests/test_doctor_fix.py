"""Repairs: what can be mended is mended once, what was right is not touched."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from scene_figure import GOOD, MOTION, broken, good
from test_doctor import MUTATIONS
from vitruvian.formats.x3d import parse_x3d, read_x3d, write_x3d
from vitruvian.hanim.doctor import check
from vitruvian.hanim.doctor_fix import mend
from vitruvian.hanim.graph import Scene
from vitruvian.hanim.view import humanoids

AUTOMATIC = {"F06", "V01", "V04", "N01", "N08", "T04", "S01", "S02", "S03", "S06", "D01", "D05", "M01", "M02", "M03"}
AUTOMATIC |= {"M04", "M16"}
CASES = [
    m for m in MUTATIONS if (m[0] in AUTOMATIC and m[3] != "expected 0 or 3") or (m[0] == "P06" and "finite" in m[3])
]
# weights that no vertex would get back, or that stay wrong for another reason than the one under test
ALSO = {"S02": {"S04"}, "D01": set(), "P06": {"S04", "P02", "S03"}}


def written(scene: Scene, path: Path) -> bytes:
    write_x3d(scene, path)
    return path.read_bytes()


def test_a_good_figure_is_not_touched(tmp_path: Path) -> None:
    scene = good()
    before = written(scene, tmp_path / "a.x3d")
    assert mend(scene) == []
    assert written(scene, tmp_path / "b.x3d") == before


@pytest.mark.parametrize(("rule", "old", "new", "message"), CASES, ids=[f"{m[0]}-{m[3][:20]}" for m in CASES])
def test_what_can_be_mended_is_mended(rule: str, old: str, new: str, message: str, tmp_path: Path) -> None:
    scene = broken(old, new)
    assert mend(scene) != []
    assert rule not in {f.rule for f in check(scene)}
    assert mend(scene) == []
    first = written(scene, tmp_path / "a.x3d")
    again = read_x3d(tmp_path / "a.x3d")
    assert {f.rule for f in check(again) if f.severity == "error"} <= ALSO.get(rule, set())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (h,) = humanoids(again)
    assert len(h.joints()) == 4
    assert mend(again) == []
    assert written(again, tmp_path / "b.x3d") == first


def test_all_at_once() -> None:
    text = GOOD
    for old, new in (
        (' containerField="skeleton"', ""),
        ('"1 0.5 0.5"', '"1 0.5"'),
        ('"0.5 0.5 1"', '"0.5 0.3 1 7"'),
        ('llimit="-1 -1 -1"', 'llimit="9 -1 -1" stiffness="2 0 0"'),
        ('<HAnimJoint USE="hanim_vl5" containerField="joints"/>', ""),
        ("</HAnimHumanoid>", MOTION.replace('"humanoid_root', '"HumanoidRoot').replace(' enabled="true"', "")),
    ):
        text = text.replace(old, new)
    scene = parse_x3d(text.encode(), "tin.x3d")
    done = mend(scene)
    assert len(done) >= 8
    assert check(scene) == []
    (h,) = humanoids(scene)
    total = np.zeros(8)
    for j in h.joints():
        np.add.at(total, j.skin_coord_index, j.skin_coord_weight)
    np.testing.assert_allclose(total, 1)
    np.testing.assert_array_equal(h.joint("vl5").ulimit, [9, 1, 1])
    assert h.motions[0].joints == ["humanoid_root", "vl5"]


@pytest.mark.parametrize("name", ["JinNoAnimations_Fixed", "JinScaledV2L1LOA4Humanoid", "JoeKick", "DiamondManLOA2"])
def test_real_files(shared: Path, name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = read_x3d(shared / "data" / "hanim" / f"{name}.x3d")
    before = {f.rule for f in check(scene)}
    assert mend(scene) != []
    after = {f.rule for f in check(scene)}
    assert before & (AUTOMATIC | {"V02"})
    assert after & (AUTOMATIC - {"N01"}) == set()
    assert "V02" not in after
    assert mend(scene) == []
