"""What commands print: JSON on stdout when asked for, text otherwise; progress on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer

from vitruvian.errors import VitruvianError

Json = typer.Option(False, "--json", help="Print one JSON document to stdout and nothing else.")
Out = typer.Option(..., "-o", "--out", help="File to write; its extension says the format.")
Repair = typer.Option(False, "--repair", help="Drop numbers that can't be meant instead of refusing the file.")

Hands = typer.Option(None, "--hands", help="JSON that the page's Hands panel saved: parameters of knuckles and palms.")
WeightFile = typer.Option(None, "--weights", help="CSV or npz of skin weights, as the page's Weights panel saves them.")

Bake = typer.Option(
    False,
    "--bake",
    help="Write deformed points instead of a skin, for viewers that do not skin: X3D and VRML as the keys of a "
    "CoordinateInterpolator, USD as every frame.",
)
Tolerance = typer.Option(
    None,
    "--tolerance",
    min=0.001,
    max=1000.0,
    help="Millimetres a point may be off: with --bake of X3D and VRML (1), and of moving clothes (2).",
)


def baking(out: Path, bake: bool, tolerance: float | None, *, clothes: bool = False) -> dict[str, Any]:
    """Options of `save` for --bake and --tolerance (millimetres); `clothes`: whether any are moving."""
    from vitruvian.formats.registry import SCENES, USD, extension

    form = extension(out)
    if bake and form not in (*SCENES, *USD, ".json"):
        raise VitruvianError(f"--bake: expected an X3D, VRML or USD file to write, found {out}")
    options: dict[str, Any] = {"bake": True} if bake else {}
    within = clothes and form in (*SCENES, *USD, ".json", ".glb") or bake and form not in USD
    return options | ({"tolerance": tolerance / 1000} if within and tolerance is not None else {})


def baked(report: dict[str, Any]) -> list[str]:
    """What was baked, as a line of text."""
    facts = report.get("baked")
    if facts is None:
        return []
    return [
        f"baked {facts['points']:,} points: {count(facts['keys'], 'key')} for {count(facts['frames'], 'frame')}, at most "
        f"{facts['max_error_m'] * 1000:.2f} mm off; {facts['bytes'] / 1e6:.2f} MB"
    ]


def emit(document: Any, text: str, as_json: bool) -> None:
    """Print the answer of a command."""
    print(json.dumps(document, indent=1, default=_plain) if as_json else text)


def _plain(value: Any) -> Any:
    """NumPy scalars and arrays as JSON knows them."""
    return value.tolist()


def say(text: str) -> None:
    """A message on the way, to stderr."""
    print(text, file=sys.stderr)


@contextmanager
def progress(title: str) -> Iterator[Callable[[int, int], None]]:
    """A bar on stderr when somebody watches; answers a callable (done, total)."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None)

        def update(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        yield update


def count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
