"""Commands about fabrics: fabric list, fabric fit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from vitruvian.cli import app
from vitruvian.cli.output import Json, emit
from vitruvian.errors import VitruvianError

fabric = typer.Typer(help="Name fabrics, and make them from measurements.", no_args_is_help=True)
app.add_typer(fabric, name="fabric")


@fabric.command("list", epilog="Example: vitruvian fabric list")
def named(as_json: bool = Json) -> None:
    """Name the fabrics that are built in: starting values by order of magnitude, not measurements."""
    from vitruvian.cloth.fabric import FABRICS
    from vitruvian.cloth.fabric_tests import values_of

    emit([values_of(f) for f in FABRICS.values()], "\n".join(_line(values_of(f)) for f in FABRICS.values()), as_json)


@fabric.command(epilog="Example: vitruvian fabric fit measured.json -o poplin.json")
def fit(
    source: Path = typer.Argument(
        ..., metavar="FILE", help="JSON: name, like, fields in SI, and measured (docs/garments.md)."
    ),
    out: Path = typer.Option(..., "-o", "--out", help="JSON to write, for dress --fabric."),
    drape: bool = typer.Option(
        False, "--drape", help="Drape a disc of 30 cm of it, and tell its coefficient and folds."
    ),
    as_json: bool = Json,
) -> None:
    """Make a fabric from bending lengths, FAST, KES, tensile curves or a drape coefficient."""
    from vitruvian.cloth.fabric_tests import draped, values_of
    from vitruvian.formats.fabrics import read_fabric, write_fabric

    if out.suffix.lower() != ".json":
        raise VitruvianError(f"{out}: expected a .json file to write")
    made = read_fabric(source)
    write_fabric(out, made)
    document: dict[str, Any] = values_of(made)
    lines = [_line(document), f"wrote {out}"]
    if drape:
        disc = draped(made)
        document |= {"drape_coefficient": round(disc.coefficient, 4), "folds": disc.folds}
        lines.insert(1, f"a disc of 30 cm drapes with {disc.coefficient:.2f} and {disc.folds} folds")
    emit(document, "\n".join(lines), as_json)


def _line(f: dict[str, Any]) -> str:
    return (
        f"{f['name']:14}{1000 * f['density']:5.0f} g/m2, warp {f['stretch_v']:g} weft {f['stretch_u']:g} "
        f"shear {f['shear']:g} N/m, bends {1e6 * f['bend_v']:.3g} / {1e6 * f['bend_u']:.3g} uN m, "
        f"{1000 * f['thickness']:.2g} mm, friction {f['friction_body']:g}"
    )
