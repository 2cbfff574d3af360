"""Which H-Anim joint each bone of a foreign rig is: one table of names per rig, and the table of whoever calls.

The tables are JSON files in `hanim/data/rigs`, `{"about", "prefixes", "joints": {bone: H-Anim 2.0 joint}}`; a table of
your own has the same form (or is just the inner object) and wins over them. Names are compared without case, dots,
dashes and underscores, and without the prefix of the rig. Rigs that no table knows go by the words of `motion.names`.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from vitruvian.errors import FileError, VitruvianError
from vitruvian.hanim.tables import canonical
from vitruvian.motion.names import NECK, SPINE, match

FEWEST = 8  # bones that a table must know before the rig counts as its own
Names = Mapping[str, str] | str | os.PathLike[str]
# A chain of n trunk or neck bones as vertebrae, from the bottom: the joints of LOA 2 and the three that VRM has.
_TRUNK = {
    1: ("vl5",), 2: ("vl5", "vt10"), 3: ("vl5", "vt10", "vt6"), 4: ("vl5", "vl2", "vt10", "vt6"),
    5: ("vl5", "vl3", "vl1", "vt10", "vt6"), 6: ("vl5", "vl3", "vl1", "vt10", "vt6", "vt1"),
    7: ("vl5", "vl3", "vl1", "vt12", "vt10", "vt6", "vt1"),
}  # fmt: skip
_NECK = {1: ("vc4",), 2: ("vc4", "vc2"), 3: ("vc6", "vc4", "vc2")}


@cache
def rig(name: str) -> dict[str, Any]:
    """One table of ours: "vrm", "vrm0", "mixamo", "makehuman" or "unreal"."""
    return json.loads((files("vitruvian.hanim") / "data" / "rigs" / f"{name}.json").read_text("utf-8"))


def own_names(names: Names | None) -> dict[str, str]:
    """A caller's table, from a mapping or a JSON file: {bone: joint}. Joints may have 1.x names; others are custom.

    Raises `FileError` for a file that holds no table, `VitruvianError` for values that are not text.
    """
    if names is None:
        return {}
    where = "names"
    if not isinstance(names, Mapping):
        where = str(names)
        try:
            names = json.loads(Path(names).read_text("utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise FileError(where, 0, f"expected a JSON table of names ({type(error).__name__})") from None
        if isinstance(names, dict) and isinstance(names.get("joints"), dict):
            names = names["joints"]
    if not isinstance(names, Mapping) or not all(isinstance(v, str) and v for v in names.values()):
        raise VitruvianError(f'{where}: expected {{"bone": "H-Anim joint"}}, found something else')
    return {bone: canonical(joint) or joint for bone, joint in names.items()}


def hanim_names(names: Sequence[str], own: Mapping[str, str] | None = None) -> list[str | None]:
    """For each bone, parents before children, the H-Anim 2.0 joint it is; None where nobody knows. Each joint once."""
    own = dict(own or {})
    found: list[str | None] = [own.get(n) for n in names]
    guesses = [_hanim(names), *(_table(names, rig(r)) for r in ("mixamo", "makehuman", "unreal", "vrm"))]
    best = max(guesses, key=lambda g: sum(x is not None for x in g))
    words = _words(names, own)
    count = sum(x is not None for x in best)
    if count < FEWEST or 2 * count < sum(x is not None for x in words):
        best = words
    taken = {x for x in found if x}
    for i, joint in enumerate(best):
        if found[i] is None and joint is not None and joint not in taken:
            found[i] = joint
            taken.add(joint)
    return found


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _hanim(names: Sequence[str]) -> list[str | None]:
    return _once([canonical(n) or canonical(n.removeprefix("hanim_")) for n in names])


def _table(names: Sequence[str], table: dict[str, Any]) -> list[str | None]:
    joints = {_plain(bone): joint for bone, joint in table["joints"].items()}
    out = []
    for name in names:
        bare = name
        for prefix in table["prefixes"]:
            if name.lower().startswith(prefix):
                bare = name[len(prefix) :]
                break
        out.append(joints.get(_plain(bare)))
    return _once(out)


def _once(found: list[str | None]) -> list[str | None]:
    seen: set[str] = set()
    out = []
    for joint in found:
        out.append(joint if joint not in seen else None)
        if joint:
            seen.add(joint)
    return out


def _words(names: Sequence[str], own: Mapping[str, str]) -> list[str | None]:
    """By the words of `motion.names`; bones of trunk and neck become vertebrae from the bottom up."""
    known = match(dict.fromkeys(names), {n: own[n] for n in names if n in own})
    out: list[str | None] = [known.get(n) for n in names]
    for part, places in ((SPINE, _TRUNK), (NECK, _NECK)):
        chain = [i for i, j in enumerate(out) if j == part]
        most = max(places)
        for k, i in enumerate(chain):
            out[i] = places[min(len(chain), most)][k] if k < most else None
    return _once(out)
