"""X_ITE as referee of X3D JSON: it finds all nodes in ours, and we read what it writes."""

from __future__ import annotations

import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from vitruvian.formats import registry
from vitruvian.formats.convert import convert
from vitruvian.formats.x3d_json import parse_json
from vitruvian.hanim.view import humanoids
from xite import complaints, page_of

EXPORT = """async text => {
  const scene = await document.querySelector('x3d-canvas').browser.createX3DFromString(text)
  return scene.toJSONString()
}"""


def test_json_goes_both_ways(shared: Path, referee: Path, browser: Any, tmp_path: Path) -> None:
    """X_ITE finds in our JSON all nodes of the source, prototypes too, without a message; we read the JSON it writes."""
    sources = [shared / "data" / "hanim" / name for name in ("JoeKick.x3d", "NancyPrototypes.wrl")]
    with page_of(browser, referee) as page:
        for source in sources:
            scene, path = registry.scene(source), tmp_path / f"{source.stem}.x3dj"
            registry.write_scene(convert(scene, "x3dj")[0], path)
            result = page.load(path.read_text())
            assert result["nodes"] == Counter(node.type for node in scene.walk())
            assert complaints(result) == []
        text = page.page.evaluate(EXPORT, sources[0].read_text())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = humanoids(parse_json(text.encode()))[0]
        mine = registry.humanoids(sources[0])[0]
    assert [j.name for j in theirs.joints()] == [j.name for j in mine.joints()]
    np.testing.assert_allclose(theirs.skin_coord, mine.skin_coord, atol=1e-6)
    for a, b in zip(theirs.joints(), mine.joints(), strict=True):
        np.testing.assert_allclose(a.center, b.center, atol=1e-6)
        np.testing.assert_allclose(a.skin_coord_weight, b.skin_coord_weight, atol=1e-6)
