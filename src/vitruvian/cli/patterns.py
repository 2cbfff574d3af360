"""Commands about sewing patterns: pattern check, pattern draw."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from vitruvian.cli import app
from vitruvian.cli.dressing import pattern_of
from vitruvian.cli.output import Json, count, emit
from vitruvian.errors import VitruvianError

pattern = typer.Typer(help="Check and draw sewing patterns.", no_args_is_help=True)
app.add_typer(pattern, name="pattern")
Source = typer.Argument(..., metavar="PATTERN", help="GarmentCode's JSON, or the name of a draft (see list).")


@pattern.command("list", epilog="Example: vitruvian pattern list")
def drafts(as_json: bool = Json) -> None:
    """Name the patterns that are drafted from a body's measures."""
    from vitruvian.cloth.drafting import DRAFTS

    rows = {name: (draft.__doc__ or "").strip().split("\n")[0] for name, draft in DRAFTS.items()}
    emit(rows, "\n".join(f"{name:14}{text}" for name, text in rows.items()), as_json)


@pattern.command(epilog="Example: vitruvian pattern check tshirt.json")
def check(source: Path = Source, as_json: bool = Json) -> None:
    """Say what is wrong with a pattern before anything is sewn; exit status 1 where something is."""
    from vitruvian.cloth.doctor import ERROR, RULES, examined
    from vitruvian.cloth.pattern import area, length

    found = pattern_of(source)
    findings = examined(found)
    ok = not any(f.severity == ERROR for f in findings)
    edges = {p.name: [100 * length(p, i) for i in range(len(p.edges))] for p in found.panels}
    areas = {p.name: 1e4 * abs(area(p)) for p in found.panels}
    sewn = [[a.panel, a.edge, b.panel, b.edge] for s in found.seams for a, b in zip(s.a, s.b)]
    said = [
        {
            "rule": f.rule,
            "severity": f.severity,
            "panel": f.panel,
            "edge": f.edge,
            "message": f.message,
            "means": RULES[f.rule],
        }
        for f in findings
    ]
    document: dict[str, Any] = {"ok": ok, "panels": [p.name for p in found.panels], "seams": sewn, "findings": said}
    document |= {"edge_lengths_cm": edges, "areas_cm2": areas}
    lines = [
        f"{source}: {count(len(found.panels), 'panel')}, {count(len(found.seams), 'seam')}, "
        f"{sum(areas.values()) / 1e4:.2f} m2; {'fit to sew' if ok else 'not fit to sew'}"
    ]
    for f in findings:
        where = f"panel {f.panel}: " * bool(f.panel) + f"edge {f.edge}: " * (f.edge >= 0)
        lines.append(f"{f.severity} {f.rule}: {where}{f.message}")
    emit(document, "\n".join(lines), as_json)
    if not ok:
        raise typer.Exit(1)


@pattern.command(epilog="Example: vitruvian pattern draw tshirt.json -o tshirt.svg")
def draw(
    source: Path = Source,
    out: Path = typer.Option(..., "-o", "--out", help="SVG to write, 1:1 in mm."),
    as_json: bool = Json,
) -> None:
    """Draw the panels at scale 1:1, seams in matching colours with arrows along which both sides run together."""
    from vitruvian.formats.pattern_svg import laid_out, write_svg

    if out.suffix.lower() != ".svg":
        raise VitruvianError(f"{out}: expected a name that ends in .svg")
    found = pattern_of(source)
    write_svg(found, out)
    width, height = laid_out(found)[1]
    text = f"wrote {out}: {count(len(found.panels), 'panel')} on {width / 10:.0f} x {height / 10:.0f} cm"
    emit({"panels": len(found.panels), "width_mm": width, "height_mm": height}, text, as_json)
