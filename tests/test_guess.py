"""Rigs whose names nobody knows: their shape tells who is who."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vitruvian as vt
from skeletons import figure, posed_rest, renamed
from vitruvian.body.types import Skeleton
from vitruvian.motion.guess import guessed
from vitruvian.motion.names import NECK, SPINE, match
from vitruvian.motion.retarget import retarget

LIMBS = ("hip", "knee", "talocrural", "metatarsophalangeal_2", "shoulder", "elbow", "radiocarpal")
JUDGED = [f"{s}_{n}" for s in "lr" for n in (*LIMBS, "sternoclavicular")] + ["humanoid_root", "skullbase"]
RESTS = {
    "stands": {},
    "T": {"l_shoulder": [0, 0, 1, 1.5], "r_shoulder": [0, 0, 1, -1.5]},
    "A": {
        "l_shoulder": [0, 0, 1, 0.7],
        "r_shoulder": [0, 0, 1, -0.7],
        "l_hip": [0, 0, 1, 0.15],
        "r_hip": [0, 0, 1, -0.15],
    },
}


def nameless(skeleton: Skeleton) -> Skeleton:
    return renamed(skeleton, {n: f"bone{i:03}" for i, n in enumerate(skeleton.names)})


@pytest.mark.parametrize("rest", RESTS)
@pytest.mark.parametrize("loa", [1, 2, 3, 4])
def test_the_standards_figure(loa: int, rest: str) -> None:
    known = posed_rest(figure(loa), RESTS[rest])
    found = guessed(nameless(known))
    right = {f"bone{i:03}": n for i, n in enumerate(known.names)}
    limbs = {
        n: right[n]
        for n, h in found.items()
        if h in JUDGED and h[2:] not in ("metatarsophalangeal_2", "sternoclavicular")
    }
    assert {n: found[n] for n in limbs} == limbs
    assert len(limbs) == 14
    trunk = [right[n] for n, h in found.items() if h in (SPINE, NECK)]
    assert all(n[0] == "v" or n == "sacroiliac" for n in trunk), trunk


@pytest.mark.parametrize("turn", [0.0, 1.0, -2.5])
def test_it_may_face_anywhere(turn: float) -> None:
    known = figure(3)
    c, s = np.cos(turn), np.sin(turn)
    about = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    turned = replace(nameless(known), centers=known.centers @ about.T + [3, 0, -1])
    found = guessed(turned)
    for side in "lr":
        assert found[f"bone{known.index[f'{side}_knee']:03}"] == f"{side}_knee"
        assert found[f"bone{known.index[f'{side}_elbow']:03}"] == f"{side}_elbow"


@pytest.mark.parametrize(
    "file", ["cmu_01_01_playground.bvh", "cmu_131_01_walk.bvh", "cmu_01_01.amc", "chatvrm_idle_loop.vrma"]
)
def test_real_rigs_without_their_names(shared: Path, file: str) -> None:
    skeleton = vt.load(shared / "data" / "motion" / file).skeleton
    known = {h: n for n, h in match(skeleton.names).items() if h in JUDGED}
    found = {h: n for n, h in guessed(skeleton).items() if h in JUDGED}
    assert {h: found.get(h) for h in known} == known


def test_a_clip_of_a_nameless_rig_comes_out_as_with_names(shared: Path) -> None:
    clip = vt.load(shared / "data" / "motion" / "cmu_01_01_playground.bvh")
    clip = replace(clip, rotation=clip.rotation[::40], translation=clip.translation[::40])
    target = figure(2)
    named = retarget(clip, target)
    told = retarget(replace(clip, skeleton=nameless(clip.skeleton)), target)
    assert any("shape" in note for note in told.notes) and not any("shape" in note for note in named.notes)
    limbs = [target.index[f"{s}_{n}"] for s in "lr" for n in ("hip", "knee", "talocrural", "shoulder", "elbow")]
    dots = np.abs(np.sum(named.rotation[:, limbs] * told.rotation[:, limbs], axis=-1))
    assert np.degrees(2 * np.arccos(np.clip(dots, 0, 1))).max() < 1.5  # the thumb tells the forearm's turn


def test_no_legs_no_guess() -> None:
    chain = Skeleton(("a", "b", "c"), np.array([-1, 0, 1]), np.array([[0, 0, 0], [0, 1, 0], [0, 2, 0.0]]))
    assert guessed(chain) == {}
    one = Skeleton(("a",), np.array([-1]), np.zeros((1, 3)))
    assert guessed(one) == {}
