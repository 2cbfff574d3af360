"""Castle Game Engine's converter as referee: it reads what we write without a warning and finds the nodes we find.

`tovrmlx3d` (Debian's view3dscene, 4.2.0) parses VRML97, Classic and XML with the tables of X3D up to 3.3.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import warnings
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from vitruvian.formats.registry import scene as read
from vitruvian.formats.vrml import parse_vrml
from vitruvian.formats.x3d import parse_x3d
from vitruvian.modeling.person import person
from written import Written, counts, people, real_figures, write

# What Castle cannot know: X3D 4.0 is younger than it. In XML it warns of such a name and reads on, in Classic X3D it
# stops there: these lines, as our writer sets them, are taken out of the text before Castle sees it.
NEWER = ("loa", "skeletalConfiguration", "description")  # fields of HAnim nodes; description of ImageTexture and others
CASTLE_STOPS = re.compile(
    rf"^ *(?:{'|'.join(NEWER)}) (?:-?\d+|\"[^\n]*\")$\n|^( *)motions \[\n(?:\1 .*\n)*\1\]$\n", re.MULTILINE
)
CASTLE_WARNS = re.compile(
    rf'unhandled X3D XML attribute\) "(?:{"|".join(NEWER)})"'
    '|Unknown X3D node type "HAnimMotion"|by node "HAnimMotion" inside node "HAnimHumanoid"'
)
# Defects of real files that stop Castle in Classic X3D and that going back as they came keeps.
STOPS = {"JinScaledV2L1LOA4Humanoid.x3d": "USE sacrum_Sites names nothing"}
# Files that an Inline names and that are not at hand; the second line of such a warning stands alone.
NOT_AT_HAND = re.compile(r"when loading inline file from URL|^Unable to open file ")


@pytest.fixture(scope="module")
def castle() -> str:
    found = shutil.which("tovrmlx3d")
    if found is None:
        pytest.skip("no tovrmlx3d: install Debian's `view3dscene` (apt-get install view3dscene)")
    return found


def judge(castle: str, files: Iterable[Written], folder: Path | None = None) -> None:
    """Every file: exit status 0, no warning but those above, the same nodes as we find in it.

    What Castle says of the file of the same name in `folder` was there before us.
    """

    def one(written: Written) -> str:
        return complaint(castle, written, words(castle, folder / written.source)[1] if folder else ())

    with ThreadPoolExecutor(2) as pool:
        complaints = list(pool.map(one, files))
    assert complaints
    assert [c for c in complaints if c] == []


def words(castle: str, path: Path) -> tuple[subprocess.CompletedProcess, list[str]]:
    """Castle's run over a file, and what it says."""
    run = subprocess.run([castle, "--encoding=xml", str(path)], capture_output=True, timeout=120, check=False)
    return run, [line for line in run.stderr.decode("utf-8", "replace").splitlines() if line.strip()]


def complaint(castle: str, written: Written, before: Iterable[str] = ()) -> str:
    """One line that says what is wrong with a file, "" when nothing is."""
    path = written.path
    text = path.read_text("utf-8")
    if written.encoding == "x3dv" and (known := CASTLE_STOPS.sub("", text)) != text:
        path = path.with_name(f"{path.stem}_for_castle.x3dv")
        path.write_text(known, "utf-8", newline="\n")
    run, said = words(castle, path)
    wrong = [line for line in said if line not in before and not NOT_AT_HAND.search(line)]
    if written.encoding == "x3d":
        wrong = [line for line in wrong if not CASTLE_WARNS.search(line)]
    if run.returncode or wrong:
        return f"{path.name}: status {run.returncode}, {wrong[:3]}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ours, theirs = counts(read(path)), counts(parse_x3d(run.stdout, path.name))
    if written.encoding == "x3d":
        del ours["HAnimMotion"]
    if any("SFNode field MetadataSet.metadata" in line for line in before):  # their containerField is missing
        ours, theirs = (Counter({t: n for t, n in c.items() if "Metadata" not in t}) for c in (ours, theirs))
    if ours != theirs:
        return f"{path.name}: " + ", ".join(
            f"{t} {ours[t]} and {theirs[t]}" for t in ours | theirs if ours[t] != theirs[t]
        )
    return "" if sum(ours.values()) > 3 else f"{path.name}: no nodes"


@pytest.mark.parametrize(("encoding", "version"), [("wrl", "200x"), ("wrl", "1.1"), ("x3dv", "2.0"), ("x3dv", "1.0")])
def test_real_figures(castle: str, shared: Path, tmp_path: Path, encoding: str, version: str) -> None:
    figures = real_figures(shared)
    assert len(figures) >= 16
    judge(castle, (write(h, tmp_path, n, encoding, version) for n, h in figures.items()))


@pytest.mark.parametrize("encoding", ["x3d", "x3dv", "wrl"])
def test_real_files_go_back_as_they_came(castle: str, shared: Path, tmp_path: Path, encoding: str) -> None:
    """Into their own scene graph, with everything that we don't understand."""
    family = ("wrl",) if encoding == "wrl" else ("x3d", "x3dv")
    figures = {n: h for n, h in real_figures(shared).items() if n.rpartition(".")[2] in family}
    if encoding == "x3dv":
        figures = {n: h for n, h in figures.items() if n not in STOPS}
    assert figures
    judge(castle, (write(h, tmp_path, n, encoding, None) for n, h in figures.items()), shared / "data" / "hanim")


@pytest.mark.parametrize(
    ("encoding", "version", "names"),
    [
        ("wrl", "200x", ("person0", "person1-walks", "person2")),
        ("wrl", "1.1", ("person1-walks", "person4")),
        ("x3dv", "2.0", ("person3-walks",)),
        ("x3dv", "1.0", ("person3",)),
        ("x3d", "2.0", ("person1",)),
    ],
)
def test_people(castle: str, tmp_path: Path, encoding: str, version: str, names: tuple[str, ...]) -> None:
    judge(castle, (write(people()[n], tmp_path, n, encoding, version) for n in names))


def test_the_whole_person(castle: str, tmp_path: Path) -> None:
    judge(castle, [write([person()], tmp_path, "whole", "x3dv", "2.0")])


def test_the_referee_sees_mistakes(castle: str, tmp_path: Path) -> None:
    """A word too many, a node that is unknown, a list that is not closed."""
    good = "#VRML V2.0 utf8\nTransform { translation 1 2 3 children [ Group { } Group { } Group { } ] }\n"
    for old, new in (("", ""), ("translation", "translocation"), ("Group", "Troup"), ("]", "")):
        path = tmp_path / "mistake.wrl"
        path.write_text(good.replace(old, new, 1))
        found = complaint(castle, Written(path, "", "wrl", "", parse_vrml(good.encode())))
        assert bool(found) == bool(old), (old, found)
