"""Command about contour bodies: contours."""

from __future__ import annotations

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
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Turn a body into contour surfaces: limbs, torso and neck in loops that turn by shares of the joints' rotations."""
    from vitruvian.cli.people import subject
    from vitruvian.formats import registry
    from vitruvian.modeling.contours import contoured

    form = registry.extension(out)
    if live and form not in registry.SCENES and form != ".json":
        raise VitruvianError(f"--live: expected a scene file to write (.x3d, .x3dv, .x3dj, .wrl), found {out}")
    made = contoured(subject(source, repair=repair), density=density, mitre=mitre, diversion=diversion)
    surfaces = [c for s in made.humanoid.segments() for c in s.contours]
    document: dict[str, Any] = {
        "surfaces": len(surfaces),
        "contours": sum(len(c.points) for c in surfaces),
        "points": sum(c.points.shape[0] * c.points.shape[1] for c in surfaces),
        "shape_error_mm": round(made.error[0] * 1000, 3),
        "shape_error_max_mm": round(made.error[1] * 1000, 3),
    }
    if live:
        document |= _write_live(made.humanoid, out)
    else:
        document["lost"] = registry.save(made.humanoid, out)["lost"]
    document["file_bytes"] = out.stat().st_size
    text = (
        f"wrote {out}: {count(document['surfaces'], 'surface')}, {count(document['contours'], 'contour')}, "
        f"{count(document['points'], 'point')}, {document['shape_error_mm']:.2f} mm off in the mean"
    )
    emit(document, "\n".join([text, *(f"lost: {line}" for line in document["lost"])]), as_json)


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
