"""Commands about surfaces: decimate, subdivide, rearrange, split, join."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli import app
from vitruvian.cli.output import Json, Out, Repair, count, emit
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.hanim.humanoid import Humanoid

Body = typer.Argument(..., metavar="IN", help="H-Anim, glTF, VRM or USD body, or the word person.")


def _save(humanoid: Humanoid, out: Path) -> list[str]:
    from vitruvian.formats.registry import save

    return list(save(humanoid, out)["lost"])


@app.command(epilog="Example: vitruvian decimate person --vertices 6300 --vertices 1900 -o coarse.x3d")
def decimate(
    source: str = Body,
    vertices: list[int] = typer.Option(
        ..., "--vertices", min=4, help="Points of the skin. Repeated, each a subset of the last: one file for each."
    ),
    out: Path = Out,
    switch: bool = typer.Option(
        False, "--switch", help="Also the full body, and as --out a scene that shows each file from how far it will do."
    ),
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Give a body fewer points, a subset of its own: weights, looks and displacers stay.

    With several --vertices the files are called as --out with the number behind the name. With --switch (X3D, VRML) an
    X3D browser changes levels as the viewer comes and goes: where 95 % of a level are off by a line of the picture.
    """
    from vitruvian.cli.people import subject
    from vitruvian.formats.level_switch import ENCODINGS, distances, write_switch
    from vitruvian.modeling.decimate import levels

    if switch and out.suffix.lower() not in ENCODINGS:
        raise VitruvianError(f"{out}: --switch writes a scene, expected a name that ends in {', '.join(ENCODINGS)}")
    body = subject(source, repair=repair)
    start = time.perf_counter()
    whole, *made = levels(body, vertices)
    document: dict[str, Any] = {"points": whole.points, "seconds": time.perf_counter() - start, "levels": []}
    lines = [f"{count(whole.points, 'point')} in use, {count(whole.triangles, 'triangle')}"]
    for wanted, level in zip(vertices, made, strict=True):
        target = out if len(made) == 1 and not switch else out.with_name(f"{out.stem}-{wanted}{out.suffix}")
        lost = [*level.lost, *_save(level.humanoid, target)]
        mean, most, largest = (round(e * 1000, 3) for e in level.error)
        document["levels"].append({"file": str(target), "points": level.points, "triangles": level.triangles,
                                   "mean_mm": mean, "p95_mm": most, "max_mm": largest, "lost": lost})  # fmt: skip
        lines.append(
            f"wrote {target}: {count(level.points, 'point')}, {count(level.triangles, 'triangle')}; the full surface is "
            f"{mean:.2f} mm off in the mean, {most:.2f} mm at 95 %, {largest:.1f} mm at most"
        )
        lines += [f"lost: {line}" for line in lost]
    if switch:
        full = out.with_name(f"{out.stem}-full{out.suffix}")
        _save(whole.humanoid, full)
        ranges = distances([level.error[1] for level in made])
        write_switch(out, body, [full, *(Path(level["file"]) for level in document["levels"])], ranges)
        document["switch"] = {"file": str(out), "full": str(full), "ranges_m": ranges}
        lines.append(
            f"wrote {out}: coarser from {', '.join(f'{r:.1f}' for r in ranges)} m on; {full.name} is the nearest"
        )
    emit(document, "\n".join(lines), as_json)


@app.command(epilog="Example: vitruvian subdivide body.x3d --levels 1 -o smooth.x3d")
def subdivide(
    source: str = Body,
    out: Path = Out,
    levels: int | None = typer.Option(None, "--levels", min=0, max=4, help="Halve every patch so often (default 1)."),
    flatness: float | None = typer.Option(
        None, "--flatness", min=0.001, max=1000.0, help="Instead: halve until patches are flat to so many millimetres."
    ),
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Give a body more points on smooth patches through its faces, whose weights, looks and displacers are blended."""
    from vitruvian.cli.people import subject
    from vitruvian.modeling.smoother import smoother

    if levels is not None and flatness is not None:
        raise VitruvianError("subdivide: expected --levels or --flatness, found both")
    body = subject(source, repair=repair)
    start = time.perf_counter()
    tolerance = None if flatness is None else flatness / 1000
    made = smoother(body, level=1 if levels is None and tolerance is None else levels, tolerance=tolerance)
    lost = _save(made, out)
    triangles = sum(len(s.triangles) for s in made.skin)
    document = {
        "points": len(made.skin_coord),
        "triangles": triangles,
        "seconds": time.perf_counter() - start,
        "lost": lost,
    }
    text = f"wrote {out}: {count(len(made.skin_coord), 'point')}, {count(triangles, 'triangle')}"
    emit(document, "\n".join([text, *(f"lost: {line}" for line in lost)]), as_json)


@app.command(epilog="Example: vitruvian rearrange body.x3d -o ordered.x3d")
def rearrange(
    source: str = Body,
    out: Path = Out,
    faces_only: bool = typer.Option(False, "--faces-only", help="Points keep their numbers."),
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Put the quads of a skin before its triangles, and number its points by first use."""
    from vitruvian.cli.people import subject
    from vitruvian.modeling.rearrange import rearrange as arrange

    made = arrange(subject(source, repair=repair), points=not faces_only)
    lost = _save(made.humanoid, out)
    shapes: list[dict[str, Any]] = [
        {"shape": s.name, "quads": q, "triangles": len(s.triangles) - 2 * q}
        for s, q in zip(made.humanoid.skin, made.quads, strict=True)
    ]
    lines = [
        f"{s['shape'] or 'skin'}: {count(s['quads'], 'quad')}, {count(s['triangles'], 'triangle')}" for s in shapes
    ]
    document = {"shapes": shapes, "vertex_perm": made.vertex_perm, "lost": lost}
    emit(document, "\n".join([f"wrote {out}", *lines, *(f"lost: {line}" for line in lost)]), as_json)


@app.command(epilog="Example: vitruvian split person --parts head,l_hand,r_hand -o part.x3d")
def split(
    source: str = Body,
    out: Path = typer.Option(..., "-o", "--out", help="Each part gets this name with its own behind it."),
    parts: str = typer.Option(
        "head,l_hand,r_hand,l_foot,r_foot", "--parts", help="head, l_hand, r_hand, l_foot, r_foot, or joints."
    ),
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Take a body apart; each part is a figure with all joints and some of the skin, what is left is called body."""
    from vitruvian.cli.people import subject
    from vitruvian.modeling.parts import split as cut

    names = [p.strip() for p in parts.split(",") if p.strip()]
    files: dict[str, Any] = {}
    for name, piece in cut(subject(source, repair=repair), names).items():
        target = out.with_name(f"{out.stem}-{name}{out.suffix}")
        lost = _save(piece.humanoid, target)
        files[name] = {"file": str(target), "points": len(piece.rows), "lost": lost}
    lines = [f"wrote {f['file']}: {count(f['points'], 'point')}" for f in files.values()]
    emit({"parts": files}, "\n".join(lines), as_json)


@app.command(epilog="Example: vitruvian join person --part l_hand=hand.x3d --part head=head.x3d -o joined.x3d")
def join(
    source: str = Body,
    part: list[str] = typer.Option(..., "--part", metavar="PART=FILE", help="What to put in place of a part."),
    out: Path = Out,
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Put other heads, hands or feet on a body, with closed seams: parts that `split` wrote, or those of whole figures."""
    from vitruvian.cli.people import subject
    from vitruvian.modeling.parts import join as together
    from vitruvian.modeling.parts import split as cut

    others: dict[str, str] = {}
    for option in part:
        name, _, file = option.partition("=")
        if not name or not file:
            raise VitruvianError(f"--part: expected PART=FILE, such as l_hand=hand.x3d, found {option!r}")
        others[name] = file
    pieces: dict[str, Any] = dict(cut(subject(source, repair=repair), list(others)))
    for name, file in others.items():
        other = cut(subject(file, repair=repair), [name])
        if not other[name].shapes:
            raise VitruvianError(f"{file}: expected skin for the part {name}, found none")
        # a file that is this part alone has its open edges already; a whole figure gets them by being cut
        pieces[name] = other[name] if len(other[name].rim) else other[name].humanoid
    made = together(pieces)
    lost = _save(made, out)
    document: dict[str, Any] = {
        "points": len(made.skin_coord),
        "triangles": sum(len(s.triangles) for s in made.skin),
        "lost": lost,
    }
    text = f"wrote {out}: {count(document['points'], 'point')}, {count(document['triangles'], 'triangle')}"
    emit(document, "\n".join([text, *(f"lost: {line}" for line in lost)]), as_json)
