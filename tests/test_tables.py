"""Facts about the names of the standard that everything else leans on."""

from __future__ import annotations

import numpy as np
import pytest

from vitruvian.errors import VitruvianError
from vitruvian.hanim import tables


def test_cumulative_counts_per_level() -> None:
    assert [len(tables.joints_at(n)) for n in range(5)] == [1, 18, 71, 94, 146]
    assert [len(tables.joints_at(n, "1.x")) for n in range(4)] == [1, 18, 71, 94]
    with pytest.raises(VitruvianError, match="0..3"):
        tables.joints_at(4, "1.1")


def test_levels_are_the_same_in_both_versions() -> None:
    for n in range(4):
        assert {tables.canonical(name) for name in tables.joints_at(n, "1.x")} == set(tables.joints_at(n))


def test_1_to_2_to_1_is_the_identity() -> None:
    for name in tables.joints("1.x"):
        assert tables.name_in(tables.canonical(name) or "", "2006") == name
    assert tables.name_in("humanoid_root", "1.1") == "HumanoidRoot"
    assert tables.canonical("HumanoidRoot") == "humanoid_root"
    assert sum(tables.name_in(n, "1.1") is None for n in tables.joints()) == 52


def test_parents_come_first_and_hang_together() -> None:
    for version, count in (("2.0", 146), ("1.x", 94)):
        seen: set[str] = set()
        for name, joint in tables.joints(version).items():
            assert joint.parent in seen or (joint.parent is None and tables.humanoid_root(name))
            seen.add(name)
        assert len(seen) == count


def test_parents_at_level_one() -> None:
    parents = {n: tables.parent_at(n, 1) for n in tables.joints_at(1)}
    assert parents["sacroiliac"] == parents["vl5"] == "humanoid_root"
    assert parents["l_hip"] == "sacroiliac"
    assert parents["l_talocrural"] == "l_knee"
    assert parents["l_metatarsophalangeal_2"] == "l_talocrural"
    assert parents["skullbase"] == parents["l_shoulder"] == "vl5"
    assert parents["l_radiocarpal"] == "l_elbow"
    assert parents["humanoid_root"] is None


def test_spine_at_level_two() -> None:
    chain, name = [], "skullbase"
    while (name := tables.parent_at(name, 2) or "") != "humanoid_root":
        chain.append(name)
    assert chain == ["vc2", "vc4", "vt1", "vt6", "vt10", "vl1", "vl3", "vl5"]
    assert tables.parent_at("l_sternoclavicular", 2) == "vt1"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("l_subtalar", "l_tarsometatarsal_2"),
        ("l_midtarsal", "l_metatarsophalangeal_2"),
        ("r_metatarsal", "r_tarsal_distal_interphalangeal_2"),
        ("l_ankle", "l_talocrural"),
        ("r_wrist", "r_radiocarpal"),
        ("l_thumb1", "l_carpometacarpal_1"),
        ("l_thumb3", "l_carpal_interphalangeal_1"),
        ("l_pinky0", "l_carpometacarpal_5"),
        ("r_ring2", "r_carpal_proximal_interphalangeal_4"),
        ("SI joint", "sacroiliac"),
        ("l_talocalcaneal", "l_talocalcaneonavicular"),
    ],
)
def test_joint_aliases(old: str, new: str) -> None:
    assert tables.canonical(old) == new


def test_names_are_resolved_per_kind() -> None:
    assert tables.canonical("l_metatarsal") == "l_tarsal_distal_interphalangeal_2"
    assert tables.canonical("l_metatarsal", "segment") == "l_metatarsal_2"
    assert tables.canonical("l_thumb_distal", "segment") == "l_carpal_distal_phalanx_1"
    assert tables.canonical("l_clavicle", "segment") == tables.canonical("l_clavicle", "site") == "l_clavicle"
    assert tables.canonical("L_hip") is None
    with pytest.raises(VitruvianError, match="kind"):
        tables.canonical("l_hip", "bone")


def test_segments_pair_with_joints() -> None:
    assert len(tables.segments()) == 146
    assert len(tables.segments("1.x")) == 94
    for name, joint in tables.segments().items():
        assert tables.joints()[joint].segment == name
    assert tables.name_in("l_talus", "1.1", "segment") == "l_hindfoot"
    assert tables.name_in("skull", "200x", "segment") == "skull"
    assert tables.name_in("l_navicular", "1.1", "segment") is None


def test_feature_points() -> None:
    assert len(tables.feature_points()) == 118
    assert sum(p.position is not None for p in tables.feature_points().values()) == 77
    assert len(tables.feature_points("1.x")) == 76
    assert tables.canonical("skull_tip", "site") == "skull_vertex"
    assert tables.canonical("l_calcaneous_post._pt", "site") == "l_calcaneus_posterior"
    assert tables.canonical("r_thelion/bustpoint", "site") == "r_thelion"
    assert tables.canonical("rib10_midspine", "site") is None


def test_complete_level() -> None:
    assert tables.complete_loa(tables.joints_at(3)) == 3
    assert tables.complete_loa([*tables.joints_at(1), "vl1", "my_tail"]) == 1
    assert tables.complete_loa(["l_hip"]) == -1


@pytest.mark.parametrize("version", ["2.0", "1.x"])
def test_default_centers_are_complete_and_symmetric(version: str) -> None:
    centers = tables.default_centers(version)
    table = tables.joints(version)
    if version == "2.0":
        assert list(centers) == list(table)
    else:
        assert len(centers) == sum(j.center is not None for j in table.values()) == 94
    for name, c in centers.items():
        if name.startswith("l_"):
            np.testing.assert_allclose(centers["r_" + name[2:]], c * [-1, 1, 1], atol=1e-12)
            assert c[0] > 0
        elif not name.startswith("r_"):
            assert c[0] == 0
        assert -0.05 < c[1] < 1.8
    assert centers["skullbase"][1] > centers["humanoid_root"][1] + 0.7
    wrist = "l_radiocarpal" if version == "2.0" else "l_wrist"
    assert centers[wrist][1] < centers["l_elbow"][1] < centers["l_shoulder"][1]
