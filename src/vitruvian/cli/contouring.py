"""Command about contour bodies: contours."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import typer

from vitruvian.cli import app
from vitruvian.cli.output import Json, Out, Repair, count, emit
from vitruvian.errors import VitruvianError


@app.command(epilog="Example: vitruvian contours body.x3d -o contours.wrl --live")
def contours(
    source: str = typer.Argument(..., metavar="IN", help="H-Anim, glTF, VRM or USD body, or the word person."),
    out: Path = Out,
    live: bool = typer.Option(False, "--live", help="Add a script that deforms the body in any X3D or VRML97 browser."),
    density: float = typer.Option(1.0, min=0.25, max=4, help="More (2: twice) or fewer contours and points in each."),
    mitre: float = typer.Option(0.25, min=0, max=1, help="How much of the thickness of bends is kept."),
    diversion: float = typer.Option(0.0, min=0, max=1, help="How far contours that swing aside are taken back."),
    change: list[str] = typer.Option(
        [],
        "--set",
        metavar="SURFACE.PARAMETER=VALUE",
        help="Another parameter: l_thigh_def.lower=4 contours, l_thigh_def.lower=80mm, l_thigh_def.mitre=0.5. Repeatable.",
    ),
    report: bool = typer.Option(
        False, "--report", help="Say what hard poses do to it, and how each Segment's surface can be organised."
    ),
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Turn a body into contour surfaces: limbs, torso and neck in loops that turn by shares of the joints' rotations."""
    from vitruvian.cli.people import subject
    from vitruvian.formats import registry
    from vitruvian.modeling.contours import contoured, tuned
    from vitruvian.modeling.organising import segments
    from vitruvian.modeling.trials import trials

    form = registry.extension(out)
    if live and form not in registry.SCENES and form != ".json":
        raise VitruvianError(f"--live: expected a scene file to write (.x3d, .x3dv, .x3dj, .wrl), found {out}")
    humanoid = subject(source, repair=repair)
    made = contoured(humanoid, density=density, mitre=mitre, diversion=diversion)
    tuned(made.humanoid, _changes(change))
    unit = 1000 / (made.scale if not 1 / 3 < made.scale < 3 else 1)  # of figures in inches: as on a person
    surfaces = [c for s in made.humanoid.segments() for c in s.contours]
    document: dict[str, Any] = {
        "surfaces": len(surfaces),
        "contours": sum(len(c.points) for c in surfaces),
        "points": sum(c.points.shape[0] * c.points.shape[1] for c in surfaces),
        "shape_error_mm": round(made.error[0] * unit, 3),
        "shape_error_max_mm": round(made.error[1] * unit, 3),
    }
    more: list[str] = []
    if report:
        tried, organised = trials(made.humanoid), segments(humanoid)
        document |= {"poses": [t.document() for t in tried], "segments": [s.document() for s in organised]}
        more = [
            f"{t.pose:<22} gap {t.gap:g} m, volume {t.volume:.3f}, {count(t.folds, 'fold')}, stretch {t.stretch:.2f}"
            for t in tried
        ]
        more += [f"{s.segment}: {s.mode or 'not organised'}{': ' + s.message if s.message else ''}" for s in organised]
    if live:
        document |= _write_live(made.humanoid, out)
    else:
        document["lost"] = registry.save(made.humanoid, out)["lost"]
    document["file_bytes"] = out.stat().st_size
    text = (
        f"wrote {out}: {count(document['surfaces'], 'surface')}, {count(document['contours'], 'contour')}, "
        f"{count(document['points'], 'point')}, {document['shape_error_mm']:.2f} mm off in the mean"
    )
    emit(document, "\n".join([text, *more, *(f"lost: {line}" for line in document["lost"])]), as_json)


def _changes(options: list[str]) -> dict[str, dict[str, float]]:
    """SURFACE.PARAMETER=VALUE options; a value with mm, cm or m is a length, a whole number a number of contours."""
    out: dict[str, dict[str, float]] = {}
    units = {"mm": 0.001, "cm": 0.01, "m": 1.0}
    for option in options:
        found = re.fullmatch(r"(\w+)\.(\w+)=([0-9.]+)(mm|cm|m)?", option.strip())
        try:
            if found is None:
                raise ValueError
            name, field, number, suffix = found.groups()
            value: float = float(number) * units[suffix] if suffix else float(number) if "." in number else int(number)
        except ValueError:
            raise VitruvianError(
                f"--set: expected SURFACE.PARAMETER=VALUE, such as l_thigh_def.lower=80mm, found {option!r}"
            ) from None
        out.setdefault(name, {})[field] = value
    return out


def _write_live(humanoid: Any, out: Path) -> dict[str, Any]:
    from vitruvian.body.pack import pack
    from vitruvian.formats import registry
    from vitruvian.formats.live import add_script
    from vitruvian.hanim.build import scene_of
    from vitruvian.hanim.convert import converted

    form = registry.extension(out)
    encoding = "x3dj" if form == ".json" else form[1:]
    version = "200x" if encoding == "wrl" else "2.0"
    scene, lost = scene_of([humanoid], version=version, encoding=encoding)
    told = add_script(scene, humanoid, pack(converted(humanoid, version)[0]))
    registry.write_scene(scene, out)
    return {"lost": lost, "script_bytes": told["script_bytes"]}
