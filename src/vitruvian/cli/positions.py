"""What `check` says about the 87 points of an actor, and what it does about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from vitruvian.cli.output import count, say
from vitruvian.errors import VitruvianError


def actor_points(file: Path) -> tuple[list[dict[str, Any]], list[str]]:
    """For each humanoid of a file a document about its points, and lines that say the same."""
    from vitruvian.formats import registry
    from vitruvian.modeling.actor import POINTS, actor, examine

    documents, lines = [], []
    try:
        figures = registry.humanoids(file)
    except VitruvianError as e:
        return [], [f"  points: not looked at: {e}"]
    for h in figures:
        try:
            a = actor(h)
        except VitruvianError as e:
            lines.append(f"  {h.name or 'humanoid'}: points: not looked at: {e}")
            continue
        found = examine(a)
        documents.append(
            {
                "name": h.name,
                "points": len(POINTS),
                "missing": list(a.missing),
                "surface": a.flesh is not None,
                "findings": [asdict(f) for f in found],
            }
        )
        have = f"{len(POINTS) - len(a.missing)} of {len(POINTS)} points"
        without = "" if a.flesh is not None else ", no surface to compare with"
        lines.append(f"  {h.name or 'humanoid'}: {have}{without}, {count(len(found), 'finding')}")
        for f in found:
            move = "" if f.move_mm is None else " (move by {:.1f} {:.1f} {:.1f} mm)".format(*f.move_mm)
            lines.append(f"    {f.rule} {f.point}: {f.distance_mm:.1f} mm: {f.message}{move}")
    return documents, lines


def put_points(files: Sequence[Path], out: Path, lock: Sequence[str]) -> Path:
    """Write the one humanoid of a file with its limb joints moved into the flesh; says which moved how far."""
    import numpy as np

    from vitruvian.formats import registry
    from vitruvian.modeling.actor import actor, place, placed

    if len(files) != 1:
        raise VitruvianError(f"--place: expected one file, found {len(files)}")
    figure = registry.load(files[0])
    if not hasattr(figure, "skeleton") or not hasattr(figure, "skin_coord"):
        raise VitruvianError(f"{files[0]}: expected a humanoid to place the points of, found {type(figure).__name__}")
    before = actor(figure)
    after = place(before, lock=lock)
    for name, there in after.places.items():
        far = float(np.linalg.norm(there - before.places[name])) * 1000 * after.scale
        if far > 0.05:
            say(f"{name}: moved by {far:.1f} mm")
    registry.save(placed(figure, after), out)
    return out
