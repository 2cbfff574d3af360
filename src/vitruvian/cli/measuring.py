"""Commands about the sizes of bodies: landmarks, measure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli import app
from vitruvian.cli.output import Json, Out, Repair, emit
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.modeling.measures import Measures

Landmarks = typer.Option(None, "--landmarks", help="JSON {feature point: [x, y, z]} in the file's unit and axes.")
Unit = typer.Option(None, "--unit", help="Of a mesh: mm, cm, m or in (default: what its size suggests).")


@app.command(epilog="Example: vitruvian landmarks scan.obj -o landmarks.json")
def landmarks(
    scan: Path = typer.Argument(..., help="Mesh (.obj .ply .stl) of one upright person, or a body with Sites."),
    out: Path = Out,
    sure: float = typer.Option(0.5, "--sure", min=0, max=1, help="Leave out points with less confidence."),
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Find the standard's feature points on a scan, any way it faces, and write them as JSON.

    Arms should be 20 to 90 degrees from the body. The points of an H-Anim body are those of its Sites.
    """
    from vitruvian.formats.registry import load
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.modeling import landmarks as marks

    if out.suffix.lower() != ".json":
        raise VitruvianError(f"{out}: expected a .json file to write landmarks into")
    thing = load(scan, repair=repair)
    if isinstance(thing, Humanoid):
        found = {n: (p, 1.0) for n, p in marks.from_sites(thing).items()}
    elif hasattr(thing, "triangles"):
        found = marks.detect(thing)
    else:
        raise VitruvianError(f"{scan}: expected a mesh or an H-Anim body, found a {type(thing).__name__.lower()}")
    kept = {n: p for n, (p, c) in found.items() if c >= sure}
    if not kept:
        raise VitruvianError(f"{scan}: found no feature point with a confidence of {sure:g}; try a lower --sure")
    marks.save(kept, out)
    document = {"points": {n: {"place": p.tolist(), "confidence": c} for n, (p, c) in found.items()}, "kept": len(kept)}
    emit(document, f"wrote {out}: {len(kept)} of {len(found)} feature points", as_json)


@app.command(epilog="Example: vitruvian measure fitted.x3d --before template.x3d -o contours.x3d")
def measure(
    file: str = typer.Argument(..., help="Body with feature points (Sites), a mesh of a person, or the word person."),
    before: str | None = typer.Option(None, "--before", metavar="FILE", help="Another body: show what has changed."),
    out: Path | None = typer.Option(None, "-o", "--out", help="Write the tapes as .x3d, .x3dv, .x3dj, .wrl or .csv."),
    marks: Path | None = Landmarks,
    unit: str | None = Unit,
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Take a body's measures as a tailor does: girths by tape, lengths, volume, mass of the whole and of every Segment."""
    from vitruvian.modeling.measures import TABLE

    if out is not None and out.suffix.lower() not in (".csv", *_ENCODINGS):
        raise VitruvianError(f"{out}: expected one of .csv, {', '.join(_ENCODINGS)} to write the tapes into")
    found = _taken(file, marks, unit, repair)
    old = None if before is None else _taken(before, None, None, repair)
    if out is not None:
        _write(found, out)
    document = _document(found) | ({} if old is None else {"before": _document(old)})
    head = f"{'':16}{'cm':>8}" + ("" if old is None else f"{'before':>9}{'change':>9}")
    lines = [head]
    for name, value in found.values.items():
        line = f"{name:16}{value * 100:8.1f}"
        if old is not None and name in old.values:
            was = old.values[name]
            line += f"{was * 100:9.1f}{(value - was) * 100:+9.1f}"
        elif old is not None:
            line += " " * 18
        lines.append(f"{line}   {TABLE[name]}")
    for title, now, was in (
        ("volume, l", found.volume * 1000, old.volume * 1000 if old else 0),
        ("mass, kg", found.mass, old.mass if old else 0),
    ):
        lines.append(f"{title:16}{now:8.1f}" + (f"{was:9.1f}{now - was:+9.1f}" if old else ""))
    heavy = sorted(found.masses.items(), key=lambda m: -m[1])
    lines += [f"  {name:24}{kg:7.2f} kg" for name, kg in heavy if kg >= 0.05]
    emit(document, "\n".join(lines + ([f"wrote {out}"] if out else [])), as_json)


def _taken(source: str, marks: Path | None, unit: str | None, repair: bool) -> Measures:
    from vitruvian.formats.registry import load
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.modeling.landmarks import read
    from vitruvian.modeling.measures import measures
    from vitruvian.modeling.person import person

    thing = person() if source == "person" and not Path(source).is_file() else load(source, repair=repair)
    if not isinstance(thing, Humanoid) and not hasattr(thing, "triangles"):
        raise VitruvianError(f"{source}: expected a body or a mesh, found a {type(thing).__name__.lower()}")
    return measures(thing, None if marks is None else read(marks), unit=unit)


def _document(found: Measures) -> dict[str, Any]:
    return {
        "height_m": found.values.get("height"),
        "mass_kg": found.mass,
        "volume_m3": found.volume,
        "measures": found.values,
        "masses_kg": found.masses,
    }


_ENCODINGS = {".x3d": "x3d", ".x3dv": "x3dv", ".x3dj": "x3dj", ".wrl": "wrl"}


def _write(found: Measures, out: Path) -> None:
    """The tapes as closed lines of a scene, or as rows name, x, y, z."""
    import numpy as np

    if out.suffix.lower() == ".csv":
        from vitruvian.formats.atomic import atomic

        rows = [f"{n},{x:.6f},{y:.6f},{z:.6f}" for n, line in found.contours.items() for x, y, z in line]
        with atomic(out) as part:
            part.write_text("\n".join(["contour,x,y,z", *rows]) + "\n", encoding="utf-8")
        return
    from vitruvian.formats.registry import write_scene
    from vitruvian.hanim.graph import Node, Scene

    body = []
    for name, line in found.contours.items():
        closed = np.array([*range(len(line)), 0, -1], np.int32)
        points = Node("Coordinate", fields={"point": np.asarray(line, np.float64)})
        lines = Node("IndexedLineSet", fields={"coordIndex": closed, "coord": points})
        paint = Node("Material", fields={"emissiveColor": np.array([0.85, 0.2, 0.1])})
        look = Node("Appearance", fields={"material": paint})
        body.append(Node("Shape", name=f"tape_{name}", fields={"appearance": look, "geometry": lines}))
    encoding = _ENCODINGS[out.suffix.lower()]
    profile = "" if encoding == "wrl" else "Interchange"
    version = "2.0" if encoding == "wrl" else "4.0"
    write_scene(Scene(path=str(out), encoding=encoding, version=version, profile=profile, body=list(body)), out)
