"""Commands that put what a body has on other surfaces: transfer."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import typer

from vitruvian.cli import app
from vitruvian.cli.output import Json, Out, Repair, count, emit


@app.command(epilog="Example: vitruvian transfer person jacket.obj --wear -o dressed.x3d")
def transfer(
    source: str = typer.Argument(..., metavar="SOURCE", help="A skinned body, or the word person."),
    target: Path = typer.Argument(..., metavar="TARGET", help="A body, scan, garment or accessory: any readable file."),
    out: Path = Out,
    kind: str | None = typer.Option(None, "--kind", help="body, garment or accessory (default: by its size)."),
    joint: str | None = typer.Option(
        None, "--joint", help="An accessory that goes with this joint's Segment; nearest: with the nearest."
    ),
    wear: bool = typer.Option(False, "--wear", help="Write the source's body with the garment or accessory on."),
    landmarks: Path | None = typer.Option(None, "--landmarks", help="Feature points of a scan, as for fit."),
    unit: str | None = typer.Option(None, "--unit", help="mm, cm, m, in, dm or ft, the target's."),
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Put a body's weights, texture coordinates, Sites, Displacers and contours on another surface.

    A target with joints keeps them. One as high as a person is a scan, whose joints are found first; others lie on the
    source at rest. What the target has by itself stays.
    """
    from vitruvian.cli.people import subject
    from vitruvian.formats.registry import load, save
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.modeling.landmarks import read
    from vitruvian.modeling.reuse import reuse
    from vitruvian.stage.clip import Mesh

    body, thing = subject(source, repair=repair), load(target, repair=repair)
    if not isinstance(thing, Humanoid | Mesh):
        from vitruvian.errors import VitruvianError

        raise VitruvianError(f"{target}: expected a surface, found a {type(thing).__name__.lower()}")
    start = time.perf_counter()
    marks = None if landmarks is None else read(landmarks)
    rigid = "" if joint == "nearest" else joint
    made = reuse(body, thing, kind=kind, joint=rigid, wear=wear, landmarks=marks, unit=unit)
    seconds = time.perf_counter() - start
    lost = list(save(made.humanoid, out)["lost"])
    document: dict[str, Any] = {"kind": made.kind, **made.report, "points": len(made.humanoid.skin_coord)}
    document |= {"seconds": seconds, "lost": lost}
    parts = [count(document[k], k[:-1]) for k in ("sites", "displacers") if document.get(k)]
    parts += ["contours"] * bool(document["contours"]) + ["texture coordinates"] * bool(document["uv"])
    with_ = f", with {', '.join(parts)}" if parts else ""
    rows = (
        f"{document['filled']:.0%} of the weights filled in"
        if "filled" in document
        else f"rigid on {document['joint']}"
    )
    text = f"wrote {out}: {made.kind}, {rows}{with_}; {seconds:.1f} s"
    emit(document, "\n".join([text, *(f"lost: {line}" for line in lost)]), as_json)
