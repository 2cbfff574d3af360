"""The house rules: imports only go down, importing is fast, files stay short."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from conftest import ROOT

SOURCE = ROOT / "src" / "vitruvian"
# Every package may import itself and what stands here after it. Modules at the top have names of their own.
BELOW: dict[str, set[str]] = {
    "errors": set(),
    "native": {"errors"},
    "hanim": {"errors", "native"},
    "body": {"hanim", "errors", "native"},
    "motion": {"body", "hanim", "errors", "native"},
    "deform": {"body", "hanim", "errors", "native"},
    "modeling": {"deform", "motion", "body", "hanim", "errors", "native"},
    "cloth": {"deform", "motion", "body", "hanim", "errors", "native"},
    "flesh": {"deform", "motion", "body", "hanim", "errors", "native"},
    "stage": {"modeling", "cloth", "flesh", "deform", "motion", "body", "hanim", "errors", "native"},
}
BELOW["formats"] = {*BELOW["stage"], "stage"}
BELOW["show"] = {*BELOW["formats"], "formats"}
BELOW["cli"] = {*BELOW["show"], "show", "batch"}
BELOW["__main__"] = {"cli"}


def imports(path: Path) -> set[str]:
    """Packages of ours that a module imports, wherever in the module it does so; not those only for type checkers."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            node.body = []
    found = set()
    for node in ast.walk(tree):
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports hide the order"
            names = [f"{node.module}.{a.name}" if node.module == "vitruvian" else node.module or "" for a in node.names]
        found |= {n.split(".")[1] for n in names if n.startswith("vitruvian.")}
    return found


@pytest.mark.parametrize("path", sorted(SOURCE.rglob("*.py")), ids=lambda p: str(p.relative_to(SOURCE)))
def test_imports_only_go_down(path: Path) -> None:
    top = path.relative_to(SOURCE).parts[0].removesuffix(".py")
    if top == "__init__":
        return
    allowed = {top, "__version__", "_native"} | BELOW[top]
    assert imports(path) <= allowed, f"{path.name} in {top} imports {sorted(imports(path) - allowed)}"


def test_deform_cloth_and_flesh_never_see_files() -> None:
    for package in ("deform", "cloth", "flesh"):
        for path in (SOURCE / package).rglob("*.py"):
            assert not re.search(r"\bopen\(|pathlib|os\.path", path.read_text()), f"{path} sees files"


def test_import_is_fast() -> None:
    """`import vitruvian` costs less than 0.2 s on top of starting Python (best of five, interleaved)."""

    def seconds(code: str) -> float:
        start = time.perf_counter()
        subprocess.run([sys.executable, "-c", code], check=True)
        return time.perf_counter() - start

    extra = min(seconds("import vitruvian") - seconds("pass") for _ in range(5))
    assert extra < 0.2


def test_importing_brings_nothing_heavy() -> None:
    heavy = "('numpy', 'scipy', 'lxml', 'trimesh', 'uvicorn')"
    code = f"import sys, vitruvian; print([m for m in {heavy} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert out.strip() == "[]"


def test_public_names_are_there() -> None:
    import vitruvian

    for name in vitruvian.__all__:
        assert getattr(vitruvian, name) is not None


def test_source_files_stay_short() -> None:
    long = {}
    for suffix in ("*.py", "*.cpp", "*.h", "*.js"):
        for path in [*SOURCE.rglob(suffix), *(ROOT / "src" / "native").rglob(suffix)]:
            lines = path.read_text().count("\n")
            if "vendor" not in path.parts and lines > 500:
                long[str(path.relative_to(ROOT))] = lines
    assert not long
