"""Commands about sewing patterns: pattern list, check, draw, sew, convert."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from vitruvian.cli import app
from vitruvian.cli.dressing import pattern_of
from vitruvian.cli.output import Json, count, emit
from vitruvian.errors import VitruvianError

pattern = typer.Typer(help="Check, draw, sew and convert sewing patterns.", no_args_is_help=True)
app.add_typer(pattern, name="pattern")
Source = typer.Argument(
    ..., metavar="PATTERN", help="JSON of GarmentCode, FreeSewing or ours, SVG, DXF, or the name of a draft (see list)."
)
Sidecar = typer.Option(None, "--sidecar", help="How a drawing is sewn (NAME.sewing.json beside it otherwise).")
Unit = typer.Option(None, "--unit", help="mm, cm, m or in, where a DXF file does not say it.")
Outlines = typer.Option(None, "--outlines", help="The class of an SVG drawing's outlines that are pieces.")


@pattern.command("list", epilog="Example: vitruvian pattern list")
def drafts(as_json: bool = Json) -> None:
    """Name the patterns that are drafted from a body's measures."""
    from vitruvian.cloth.drafting import DRAFTS

    rows = {name: (draft.__doc__ or "").strip().split("\n")[0] for name, draft in DRAFTS.items()}
    emit(rows, "\n".join(f"{name:14}{text}" for name, text in rows.items()), as_json)


@pattern.command(epilog="Example: vitruvian pattern check tshirt.json")
def check(
    source: Path = Source,
    sidecar: Path | None = Sidecar,
    unit: str | None = Unit,
    outlines: str | None = Outlines,
    as_json: bool = Json,
) -> None:
    """Say what is wrong with a pattern before anything is sewn; exit status 1 where something is."""
    from vitruvian.cloth.doctor import ERROR, RULES, examined
    from vitruvian.cloth.pattern import area, length

    found = pattern_of(source, sidecar=sidecar, unit=unit, outlines=outlines)
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


@pattern.command(epilog="Example: vitruvian pattern draw tshirt.json -o tshirt.pdf --paper a4")
def draw(
    source: Path = Source,
    out: Path = typer.Option(..., "-o", "--out", help="SVG or PDF to write, 1:1 in mm."),
    paper: str | None = typer.Option(None, "--paper", help="a4, a3, letter: a PDF's pages to be glued; one page else."),
    sidecar: Path | None = Sidecar,
    unit: str | None = Unit,
    outlines: str | None = Outlines,
    as_json: bool = Json,
) -> None:
    """Draw the panels at scale 1:1, seams in matching colours with arrows along which both sides run together."""
    from vitruvian.formats.pattern_pdf import write_pdf
    from vitruvian.formats.pattern_svg import laid_out, write_svg

    form = out.suffix.lower()
    if form not in (".svg", ".pdf"):
        raise VitruvianError(f"{out}: expected a name that ends in .svg or .pdf")
    if paper is not None and form != ".pdf":
        raise VitruvianError(f"{out}: --paper is for .pdf")
    found = pattern_of(source, sidecar=sidecar, unit=unit, outlines=outlines)
    pages = 1
    if form == ".pdf":
        pages = write_pdf(found, out, paper=paper)
    else:
        write_svg(found, out)
    width, height = laid_out(found)[1]
    text = f"wrote {out}: {count(len(found.panels), 'panel')} on {width / 10:.0f} x {height / 10:.0f} cm"
    text += f", {count(pages, 'page')}" * (pages > 1)
    document = {"panels": len(found.panels), "width_mm": width, "height_mm": height, "pages": pages}
    emit(document, text, as_json)


@pattern.command(epilog="Example: vitruvian pattern sew teagan.json -o teagan.pattern.json")
def sew(
    source: Path = Source,
    out: Path = typer.Option(..., "-o", "--out", help=".pattern.json to write, or .sewing.json: the seams alone."),
    least: float = typer.Option(0.6, "--least", min=0.3, max=1.0, help="How certain a seam must be to be taken."),
    sidecar: Path | None = Sidecar,
    unit: str | None = Unit,
    outlines: str | None = Outlines,
    as_json: bool = Json,
) -> None:
    """Propose seams for a pattern that says none, each with how certain it is and why, and write it with them.

    What is proposed wants to be looked at: draw it, and take out in the file what is wrong.
    """
    from dataclasses import replace

    from vitruvian.cli.dressing import placed_on
    from vitruvian.cloth.proposals import proposals
    from vitruvian.formats.registry import save

    whole = out.name.lower().endswith(".pattern.json")
    if not whole and not out.name.lower().endswith(".sewing.json"):
        raise VitruvianError(f"{out}: expected a name that ends in .pattern.json or .sewing.json")
    found = pattern_of(source, sidecar=sidecar, unit=unit, outlines=outlines)
    taken = proposals(placed_on(found, None), least=least)
    sewn = replace(found, seams=(*found.seams, *(p.seam for p in taken)))
    if whole:
        save(sewn, out)
    else:
        from vitruvian.formats.sewing import write_sidecar

        write_sidecar(sewn, out)
    rows = [
        {
            "a": [[s.panel, s.edge] for s in p.seam.a],
            "b": [[s.panel, s.edge] for s in p.seam.b],
            "kind": p.seam.kind,
            "certainty": round(p.score, 3),
            "reason": p.reason,
        }
        for p in taken
    ]
    lines = [f"wrote {out}: {count(len(taken), 'seam')} proposed, {len(found.seams)} were there; look at each"]
    lines += [f"{p.score:4.0%}  {_side(p.seam.a)} - {_side(p.seam.b)}: {p.reason}" for p in taken]
    held = {s.panel for seam in sewn.seams for s in (*seam.a, *seam.b)}
    alone = [p.name for p in sewn.panels if p.name not in held]
    lines += [f"nothing is sewn to {', '.join(alone)}"] * bool(alone)
    emit({"seams": rows, "there": len(found.seams), "alone": alone}, "\n".join(lines), as_json)


def _side(spans: Any) -> str:
    edges: dict[str, list[str]] = {}
    for s in spans:
        edges.setdefault(s.panel, []).append(str(s.edge))
    return ", ".join(f"{panel} {'+'.join(those)}" for panel, those in edges.items())


@pattern.command(epilog="Example: vitruvian pattern convert tshirt.json tshirt.dxf")
def convert(
    source: Path = Source,
    out: Path = typer.Argument(
        ..., metavar="OUT", help=".pattern.json, .garmentcode.json, .svg or .dxf, or .pdf, which is drawn."
    ),
    sidecar: Path | None = Sidecar,
    unit: str | None = Unit,
    outlines: str | None = Outlines,
    as_json: bool = Json,
) -> None:
    """Write a pattern in another format, and say what that cannot hold."""
    from vitruvian.formats.registry import save

    found = pattern_of(source, sidecar=sidecar, unit=unit, outlines=outlines)
    lost = list(save(found, out)["lost"])
    text = f"wrote {out}: {count(len(found.panels), 'panel')}, {count(len(found.seams), 'seam')}"
    document = {"panels": len(found.panels), "seams": len(found.seams), "lost": lost}
    emit(document, "\n".join([text, *(f"lost: {line}" for line in lost)]), as_json)
