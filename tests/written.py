"""Everything we write that referees judge: real files and the built-in person, in every version and encoding."""

from __future__ import annotations

import warnings
from collections import Counter
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from vitruvian.body.pack import pack
from vitruvian.formats.registry import humanoids, write_scene
from vitruvian.hanim.build import scene_of
from vitruvian.hanim.graph import Node, Scene
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.modeling.person import person
from vitruvian.motion.gait import walk
from vitruvian.motion.tracks import tracks_of

# encoding and H-Anim version of all that can be built
KINDS = (("x3d", "2.0"), ("x3d", "1.0"), ("x3dv", "2.0"), ("x3dv", "1.0"), ("wrl", "200x"), ("wrl", "1.1"))


@dataclass(frozen=True)
class Written:
    """A file we wrote: what it was made from, how, and the graph that was printed."""

    path: Path
    source: str
    encoding: str
    version: str | None
    scene: Scene


@cache
def real_figures(shared: Path) -> dict[str, list[Humanoid]]:
    """Humanoids of every real file that holds one, by the file's name."""
    found = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for path in sorted((shared / "data" / "hanim").iterdir()):
            if path.suffix in (".x3d", ".x3dv", ".wrl") and (figures := humanoids(path)):
                found[path.name] = figures
    return found


@cache
def people() -> dict[str, list[Humanoid]]:
    """The built-in person at every level, two of them walking; bald, in a body suit, with three of its 52 face movements.

    (Castle's converter repeats a VRML97 joint with all below it wherever it is named: of the whole person it makes
    hundreds of megabytes.)
    """
    found = {}
    for loa in range(5):
        h = person(loa=loa, hair="none", outfit="body suit")
        for joint in h.joints():
            joint.displacers = joint.displacers[:3]
        found[f"person{loa}"] = [h]
        if loa in (1, 3):
            skeleton = pack(h).skeleton
            found[f"person{loa}-walks"] = [replace(h, tracks=tracks_of(walk(skeleton, fps=15)))]
    return found


def write(figures: list[Humanoid], folder: Path, name: str, encoding: str, version: str | None) -> Written:
    """`version` None: back into the figures' own scene graph."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene, _ = scene_of(figures, version=version, encoding=encoding)
        path = folder / f"{name}_{version or 'kept'}.{encoding}"
        write_scene(scene, path)
    return Written(path, name, encoding, version, scene)


def counts(scene: Scene) -> Counter[str]:
    """Nodes of each type outside of prototype bodies; one that is repeated in full with its DEF counts once."""
    found: Counter[str] = Counter()
    stack = [s for s in scene.body if isinstance(s, Node)]
    seen: set[tuple[str, str]] = set()
    while stack:
        node = stack.pop()
        if node.name and (node.type, node.name) in seen:
            continue
        seen.add((node.type, node.name))
        found[node.type] += 1
        stack.extend(v for _, v in reversed(list(node.entries())) if isinstance(v, Node))
    return found
