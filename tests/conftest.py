"""Where tests find things: real files beside the checkout, the referees that CI installs."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from hypothesis import settings

# The gate tries the same cases every time, so that it judges the change and not the day; `make hunt` tries others.
settings.register_profile("gate", derandomize=True, print_blob=True)
settings.register_profile("hunt", derandomize=False, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "gate"))

ROOT = Path(__file__).resolve().parent.parent
SHARED = ROOT.parent / "shared"
REFEREE = ROOT / ".referee"


def chromium_path() -> str | None:
    return shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@pytest.fixture(params=["kernel", "twin"])
def both(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The test runs with the extension and without."""
    from vitruvian.deform import normals, operators
    from vitruvian.native import kernels

    if request.param == "twin":
        monkeypatch.setattr(operators, "kernels", lambda: None)
        monkeypatch.setattr(normals, "kernels", lambda: None)
    elif kernels() is None:
        pytest.skip("the extension vitruvian._native is not built: pip install .")


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of real files; tests that need it skip where it is absent."""
    if not (SHARED / "data").is_dir():
        pytest.skip("the folder ../shared with real files is not beside this checkout")
    return SHARED


@pytest.fixture(scope="session")
def referee() -> Path:
    """Folder whose node_modules hold x_ite, gltf-validator and playwright-core."""
    if not (REFEREE / "node_modules" / "x_ite").is_dir() or not shutil.which("node"):
        pytest.skip("referees are missing: install node, then run `make referees` (npm packages x_ite, gltf-validator)")
    return REFEREE


@pytest.fixture(scope="session")
def chromium() -> str:
    """Path of a Chromium."""
    path = chromium_path()
    if path is None:
        pytest.skip("no Chromium: install Debian's `chromium` (apt-get install chromium)")
    return path


@pytest.fixture(scope="session")
def playwright(chromium: str):
    """What drives browsers. There can be only one in a process."""
    with pytest.importorskip("playwright.sync_api").sync_playwright() as found:
        yield found


@pytest.fixture(scope="session")
def browser(playwright, chromium: str):
    """A headless browser that draws without a graphics processor."""
    from pages import FLAGS

    browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
    yield browser
    browser.close()
