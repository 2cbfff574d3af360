"""Seams proposed for patterns without: measured against patterns whose seams are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import vitruvian as vt
from conftest import SHARED
from vitruvian.cloth.drafting import drafted
from vitruvian.cloth.pattern import Edge, Panel, Pattern
from vitruvian.cloth.proposals import proposals

FILES = sorted(p for p in (SHARED / "data/patterns/garmentcode").glob("*.json") if "truth" not in p.name)
MEASURES = {"height": 1.72, "chest": 0.96, "waist": 0.82, "hips": 1.0}


def keys(seams: object) -> set[frozenset[tuple[str, int]]]:
    """What is sewn to what; sides of as many edges each, one by one."""
    out = set()
    for seam in seams:
        even = len(seam.a) == len(seam.b)
        pairs = zip(seam.a, seam.b[::-1] if seam.reversed else seam.b) if even else [(*seam.a, *seam.b)]
        out |= {frozenset((s.panel, s.edge) for s in pair) for pair in pairs}
    return out


def rates(pattern: Pattern) -> tuple[int, int, int]:
    """Right ones, proposed, true."""
    truth = keys(pattern.seams)
    found = keys(p.seam for p in proposals(replace(pattern, seams=())))
    return len(found & truth), len(found), len(truth)


@pytest.mark.parametrize("name", ["tshirt", "toga"])
def test_all_seams_of_simple_garments_are_found(name):
    hit, found, true = rates(drafted(name, MEASURES))
    assert hit == found == true


@pytest.mark.skipif(not FILES, reason="needs ../shared/data/patterns")
def test_most_seams_of_real_patterns_are_found():
    hit, found, true = np.sum([rates(vt.load(p)) for p in FILES], axis=0)
    assert hit / found > 0.8 and hit / true > 0.7


def test_darts_are_found_by_their_shape_and_tell_why():
    skirt = drafted("skirt", MEASURES)
    found = [p for p in proposals(replace(skirt, seams=())) if p.seam.kind == "dart"]
    assert keys(p.seam for p in found) == keys(s for s in skirt.seams if s.kind == "dart")
    assert all("wedge" in p.reason and 0.6 < p.score < 1 for p in found)


def test_edges_that_are_sewn_are_left_alone_and_notches_part_what_is_as_long():
    pattern = drafted("tshirt", MEASURES)
    assert proposals(pattern) == []
    sides = np.array([[0, 0], [0.4, 0], [0.4, 0.3], [0, 0.7]])
    pieces = tuple(Panel(n, sides, tuple(Edge(i, (i + 1) % 4) for i in range(4))) for n in "ab")
    plain = proposals(Pattern("two", pieces))
    assert {p.reason.split(",")[0] for p in plain} == {
        "lengths 40.0 and 40.0 cm", "lengths 30.0 and 30.0 cm", "lengths 56.6 and 56.6 cm", "lengths 70.0 and 70.0 cm"
    }  # fmt: skip
    marked = proposals(Pattern("two", pieces), notches={("a", 0): 2, ("b", 0): 1, ("a", 1): 1, ("b", 1): 1})
    said = [p.reason for p in marked]
    assert len(said) == 3 and any("30.0 cm, 1 notches" in r for r in said)
