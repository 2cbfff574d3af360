"""`vitruvian check` as a user meets it: rules, reasons, repairs on request, the schema."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from doctor_cases import BULGE
from scene_figure import GOOD
from vitruvian.cli import app
from vitruvian.errors import VitruvianError
from vitruvian.formats import schema
from vitruvian.formats.registry import check, fix
from vitruvian.hanim.doctor_rules import RULES

pytestmark = pytest.mark.filterwarnings("ignore::vitruvian.errors.VitruvianWarning")


def run(*args: object) -> Result:
    return CliRunner().invoke(app, ["check", *map(str, args)])


@pytest.fixture
def sick(tmp_path: Path) -> Path:
    path = tmp_path / "sick.x3d"
    path.write_text(GOOD.replace('"1 0.5 0.5"', '"1 0.5"').replace('name="vl5" center', 'name="vL5" center'))
    return path


def test_rules_are_listed() -> None:
    listed = json.loads(run("--rules", "--json").stdout)
    assert [r["id"] for r in listed] == list(RULES)
    assert listed[0] == {
        "id": "F01",
        "severity": "error",
        "finds": RULES["F01"].finds,
        "why": RULES["F01"].why,
        "repair": RULES["F01"].repair,
        "auto": "yes",
    }
    text = run("--rules").stdout
    assert text.count("why: ") == len(RULES)
    assert "Why it does not move" in text


def test_reasons_on_request(sick: Path) -> None:
    plain, explained = run(sick), run(sick, "--why")
    assert plain.exit_code == explained.exit_code == 1
    assert RULES["S01"].why not in plain.stdout
    assert RULES["S01"].why in explained.stdout
    assert f"{sick}: 2 errors" in plain.stdout
    (document,) = json.loads(run(sick, "--json").stdout)
    assert document["ok"] is False
    found = {f["rule"]: f for f in document["findings"]}
    assert set(found["S01"]) == {"rule", "severity", "where", "line", "message", "fix", "path", "why"}


def test_repairs_on_request(sick: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.x3d"
    half = run(sick, "--fix", out)
    assert half.exit_code == 1
    assert "joint vL5 is named vl5 (N02)" in half.stderr
    assert "on request: --also S01" in half.stdout
    whole = run(sick, "--fix", out, "--also", "S01,p03", "--json")
    assert whole.exit_code == 0
    (document,) = json.loads(whole.stdout)
    assert document["ok"] and document["findings"] == [] and len(document["repairs"]) == 2
    again = run(out, "--fix", tmp_path / "again.x3d")
    assert "nothing to repair" in again.stderr
    assert (tmp_path / "again.x3d").read_bytes() == out.read_bytes()


def test_mistakes(sick: Path, tmp_path: Path) -> None:
    for args, message in (
        ((), "expected files"),
        ((sick, "--also", "S01"), "give --fix OUT"),
        ((sick, "--fix", tmp_path / "o.x3d", "--also", "S99"), "S99 is no rule"),
        ((sick, sick, "--fix", tmp_path / "o.x3d"), "expected one file"),
        ((sick, "--fix", tmp_path / "o.wrl"), "keeps its encoding"),
    ):
        done = run(*args)
        assert isinstance(done.exception, VitruvianError)
        assert message in str(done.exception)
        assert not (tmp_path / "o.x3d").exists()


def test_the_schema_speaks_only_when_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "odd.x3d"
    path.write_text(BULGE.replace("<TimeSensor", '<Group bboxSize="1 2"/><TimeSensor', 1))
    asked = []
    complaints = schema.complaints
    monkeypatch.setattr(schema, "complaints", lambda p: asked.append(p) or complaints(p))
    assert check(path) == []
    assert asked == []
    found = {f.rule: f for f in check(path, schema=True)}
    assert set(found) == {"F09", "D02"}
    assert found["F09"].line == BULGE[: BULGE.index("<TimeSensor")].count("\n") + 1
    assert "bboxSize" in found["F09"].message


def test_the_schemas_own_defects_are_left_out(shared: Path) -> None:
    """`name` of HAnimMotion is allowed by the standard; a displacer under a joint too, and is told as D02."""
    folder = shared / "data" / "hanim"
    assert "F09" not in {f.rule for f in check(folder / "KoreanCharacterMotionAnnexD01Jin.x3d", schema=True)}
    joe = {f.rule for f in check(folder / "JoeKick.x3d", schema=True)}
    assert "F09" not in joe
    assert "D02" in joe
    assert {f.rule for f in check(folder / "HAnim1SpecificationLOA3Invisible.x3d", schema=True)} == {"V04"}


def test_the_schema_asks_no_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import socket

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a connection was opened")

    monkeypatch.setattr(socket, "socket", refuse)
    monkeypatch.setattr(socket, "create_connection", refuse)
    path = tmp_path / "t.x3d"
    doctype = '<!DOCTYPE X3D PUBLIC "ISO//Web3D//DTD X3D 4.0//EN" "http://127.0.0.1:9/x3d-4.0.dtd">\n'
    path.write_text(doctype + GOOD)
    schema._schema.cache_clear()
    assert check(path, schema=True) == []
    bomb = '<!DOCTYPE X3D [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>\n'
    path.write_text(bomb + GOOD.replace('name="Tin"', 'name="&b;"'))
    assert schema.complaints(path) == []


def test_wrong_headers(tmp_path: Path) -> None:
    """F01: read in spite of it, written right, lines keep their numbers."""
    bare = tmp_path / "bare.wrl"
    bare.write_text("# mine\nDEF a Group { }\nROUTE a.x TO b.y\n")
    found = check(bare)
    assert [(f.rule, f.line) for f in found if f.rule == "F01"] == [("F01", 1)]
    assert [f.line for f in found if f.rule == "M07"] == [3]
    assert fix(bare, tmp_path / "out.wrl") == ["there is no header, expected #VRML V2.0 utf8: written anew (F01)"]
    assert (tmp_path / "out.wrl").read_text().startswith("#VRML V2.0 utf8\n")
    assert "# mine" in (tmp_path / "out.wrl").read_text()
    xml = tmp_path / "xml.wrl"
    xml.write_text(GOOD)
    (finding,) = check(xml)
    assert (finding.rule, finding.fix) == ("F01", "name it .x3d")
    fix(xml, tmp_path / "out.x3d")
    assert check(tmp_path / "out.x3d") == []
    old = tmp_path / "old.wrl"
    old.write_text("#VRML V1.0 ascii\nSeparator { }\n")
    (finding,) = check(old)
    assert finding.rule == "F02"
    assert "VRML97" in finding.message
