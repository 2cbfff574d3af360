"""Maps of the distances between two surfaces, for the commands that write and show them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from vitruvian.cli.output import emit
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.show.heat import Heat


def heated(thing: Any, file: str, other: Any, against: str, unit: str | None, reach: float | None) -> Heat:
    """The map of a loaded file against another."""
    from vitruvian.show.heat import heat
    from vitruvian.stage.clip import Clip, Mesh

    for found, name in ((thing, file), (other, against)):
        if not isinstance(found, (Clip, Mesh)):
            raise VitruvianError(f"{name}: expected a body or a mesh, found a {type(found).__name__.lower()}")
    if unit is not None and not isinstance(other, Mesh):
        raise VitruvianError(f"--unit: expected a mesh, {against} is a body in metres")
    names = {"name": Path(file).stem, "against": Path(against).stem}
    if names["name"] == names["against"]:
        names["against"] += " (other)"
    return heat(thing, other, unit=unit, reach=reach, **names)


def write_map(found: Heat, out: Path) -> None:
    """Write a map as a picture, a page that plays from disk, or its figures."""
    import json

    kind = out.suffix.lower()
    if kind == ".png":
        from vitruvian.show.heat import sheet

        sheet(found, out)
    elif kind == ".html":
        from vitruvian.show.recording import record

        record(found, out, found.other)
    elif kind == ".json":
        from vitruvian.formats.atomic import atomic

        with atomic(out) as part:
            part.write_text(json.dumps(found.gaps.numbers(), indent=1) + "\n", encoding="utf-8")
    else:
        raise VitruvianError(f"{out}: expected .png, .html or .json")


def map_of(found: Heat, out: Path, view: str | None, as_json: bool) -> None:
    """Write a map and print its figures."""
    from vitruvian.show.heat import sheet

    if out.suffix.lower() == ".png":
        sheet(found, out, view=view)
    else:
        write_map(found, out)
    numbers = found.gaps.numbers()
    emit({"files": [str(out)], **numbers}, "\n".join([f"wrote {out}", *_lines(numbers, found.against)]), as_json)


def _lines(numbers: dict[str, Any], against: str) -> list[str]:
    def row(name: str, of: dict[str, Any]) -> str:
        cells = "".join(f"{'-' if of[k] is None else f'{of[k]:.2f}':>9}" for k in _FIELDS)
        return f"{name:<24}{cells}" + (f"{of['holes']:>8.0%}" if "holes" in of else "")

    head = f"{'mm, by area':<24}" + "".join(f"{k.removesuffix('_mm'):>9}" for k in _FIELDS) + f"{'holes':>8}"
    parts = [row(f"  {n}", part) for n, part in numbers["parts"].items()]
    return [head, row("all", numbers), *parts, row(f"{against} to it, by points"[:24], numbers["back"])]


_FIELDS = ("mean_mm", "rms_mm", "p95_mm", "max_mm", "bias_mm")
