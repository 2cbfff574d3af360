"""Each rule of the doctor: a file that breaks it is found, one that keeps it is not; what can be repaired is."""

from __future__ import annotations

import difflib
import re
import warnings
from pathlib import Path

import pytest

from conftest import ROOT
from doctor_cases import CASES, Case
from vitruvian.formats.registry import check, fix, scene, write_scene
from vitruvian.hanim.doctor import Finding
from vitruvian.hanim.doctor_rules import GROUPS, RULES, SEVERITIES, rules_page, rules_text

pytestmark = pytest.mark.filterwarnings("ignore::vitruvian.errors.VitruvianWarning")
IDS = [f"{c.rule}-{re.sub(r'[^a-zA-Z]+', '-', c.message)[:24]}" for c in CASES]
FIXABLE = [c for c in CASES if RULES[c.rule].auto != "no" and c.mended]


def examined(case: Case, text: str, folder: Path, name: str = "tin") -> list[Finding]:
    path = folder / f"{name}{case.suffix}"
    path.write_text(text)
    return check(path, schema=case.schema)


def test_every_rule_has_a_case() -> None:
    assert {c.rule for c in CASES} == set(RULES)
    assert {c.rule for c in FIXABLE} == {r.id for r in RULES.values() if r.auto != "no"}


@pytest.mark.parametrize("case", CASES, ids=IDS)
def test_the_defect_is_found(case: Case, tmp_path: Path) -> None:
    found = [f for f in examined(case, case.bad, tmp_path) if f.rule == case.rule]
    hit = [f for f in found if case.message in f.message]
    assert hit, [f.message for f in found]
    assert hit[0].severity == SEVERITIES[RULES[case.rule].severity]
    assert hit[0].line > 0
    assert hit[0].where
    assert hit[0].why == RULES[case.rule].why
    assert "\n" not in hit[0].message


@pytest.mark.parametrize("case", {c.good: c for c in CASES}.values(), ids=lambda c: c.rule)
def test_the_good_files_have_nothing_wrong(case: Case, tmp_path: Path) -> None:
    """One file for each construct that a rule is about: no finding at all, whatever the rule."""
    assert [f for f in examined(case, case.good, tmp_path) if f.severity != "note" or f.rule == case.rule] == []


@pytest.mark.parametrize("case", FIXABLE, ids=[i for i, c in zip(IDS, CASES) if c in FIXABLE])
def test_the_defect_is_mended(case: Case, tmp_path: Path) -> None:
    path, out, twice = (tmp_path / f"{n}{case.suffix}" for n in ("bad", "out", "twice"))
    path.write_text(case.bad)
    before = {f.rule for f in check(path)}
    also = [] if RULES[case.rule].auto == "yes" else [case.rule]
    done = fix(path, out, also=also)
    assert any(f"{case.rule}" in line for line in done), done
    after = check(out, schema=case.schema)
    assert case.rule not in {f.rule for f in after if case.message[:12] in f.message}
    assert {f.rule for f in after if f.severity != "note"} <= (before - {case.rule}) | case.left
    assert fix(out, twice, also=also) == []
    assert twice.read_bytes() == out.read_bytes()
    if case.rule != "F01":
        same = tmp_path / f"same{case.suffix}"
        write_scene(scene(path), same)
        changed = [d for d in difflib.ndiff(same.read_text().split("\n"), out.read_text().split("\n")) if d[0] in "+-"]
        assert 0 < len(changed) <= 2 * case.touched, "\n".join(changed)


@pytest.mark.parametrize("case", [c for c in FIXABLE if RULES[c.rule].auto == "opt"], ids=lambda c: c.rule)
def test_what_is_optional_waits_to_be_asked(case: Case, tmp_path: Path) -> None:
    path, out = tmp_path / f"bad{case.suffix}", tmp_path / f"out{case.suffix}"
    path.write_text(case.bad)
    fix(path, out)
    assert case.rule in {f.rule for f in check(out, schema=case.schema)}


@pytest.mark.parametrize(
    "case", [c for c in CASES if c.good and c.rule == "F03" or c.rule == "M20"], ids=lambda c: c.rule
)
def test_good_files_are_left_alone(case: Case, tmp_path: Path) -> None:
    path, out, same = (tmp_path / f"{n}{case.suffix}" for n in ("good", "out", "same"))
    path.write_text(case.good)
    assert fix(path, out, also=["all"]) == []
    write_scene(scene(path), same)
    assert out.read_bytes() == same.read_bytes()


def test_the_table_is_whole() -> None:
    assert len(RULES) == 71
    for rule in RULES.values():
        assert rule.severity in SEVERITIES
        assert rule.auto in {"yes", "opt", "part", "no"}
        assert rule.id[0] in GROUPS
        assert rule.finds and rule.why and rule.repair
        assert not rule.why.endswith(".")
        assert rule.id in rules_text()


def test_the_page_of_rules_is_current() -> None:
    """`tools/write_rules_page.py` writes it."""
    assert (ROOT / "docs" / "rules.md").read_text() == rules_page()
    assert all(f"| {name} |" in rules_page() for name in RULES)


def test_nothing_is_said_aloud(tmp_path: Path) -> None:
    """The doctor answers by findings alone, never by warnings."""
    from doctor_cases import GOOD
    from vitruvian.formats.x3d import parse_x3d
    from vitruvian.hanim.doctor import check as examine

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert examine(parse_x3d(GOOD.encode(), "tin.x3d")) == []
