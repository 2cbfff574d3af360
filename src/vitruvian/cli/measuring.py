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


@app.command(
    epilog="Example: vitruvian measure template.x3d fitted.x3d, or vitruvian measure fitted.x3d -o contours.json"
)
def measure(
    file: str = typer.Argument(..., help="Body with feature points (Sites), a mesh of a person, or the word person."),
    after: str | None = typer.Argument(None, metavar="[AFTER]", help="Another: the first is before, this one after."),
    before: str | None = typer.Option(
        None, "--before", metavar="FILE", help="The same the other way: what was before."
    ),
    out: Path | None = typer.Option(
        None, "-o", "--out", help="Write the tapes as .json, .csv, .x3d, .x3dv, .x3dj or .wrl."
    ),
    sites: Path | None = typer.Option(
        None,
        "--sites",
        metavar="OUT",
        help="Write the body with its tapes as Sites NAME_contour_pt, which move with it.",
    ),
    marks: Path | None = Landmarks,
    unit: str | None = Unit,
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Take a body's measures as a tailor does: girths by tape, lengths, volume, mass of the whole and of every Segment.

    With two bodies: before, after and the change. What is written, and --landmarks and --unit, are of the one after.
    """
    if after is not None and before is not None:
        raise VitruvianError("measure: expected a second body or --before, found both")
    first, second = (before, file) if after is None else (file, after)
    if out is not None and out.suffix.lower() not in (".json", ".csv", *_ENCODINGS):
        raise VitruvianError(f"{out}: expected one of .json, .csv, {', '.join(_ENCODINGS)} to write the tapes into")
    thing = _read(second, repair)
    found = _taken(thing, marks, unit)
    old = None if first is None else _taken(_read(first, repair), None, None)
    written = []
    if out is not None:
        _write(found, thing, marks, unit, out)
        written.append(out)
    if sites is not None:
        _write_sites(thing, second, marks, sites)
        written.append(sites)
    document = _document(found)
    if old is not None:
        was = _document(old)
        document |= {"before": was, "change": _change(document, was)}
    lines = _table(found, old)
    emit(document, "\n".join([*lines, *(f"wrote {f}" for f in written)]), as_json)


def _table(found: Measures, old: Measures | None) -> list[str]:
    """Everything that was measured, in lines; with what was before and the change."""
    from vitruvian.modeling.measures import LENGTHS, TABLE

    def row(name: str, now: float | None, was: float | None, note: str = "", digits: int = 1) -> str:
        def cell(value: float | None, form: str, width: int) -> str:
            return f"{'-' if value is None else format(value, form):>{width}}"

        line = f"{name:<24}"
        if old is not None:
            change = None if now is None or was is None else now - was
            line += cell(was, f".{digits}f", 9) + cell(now, f".{digits}f", 9) + cell(change, f"+.{digits}f", 9)
        else:
            line += cell(now, f".{digits}f", 9)
        return f"{line}   {note}".rstrip()

    def block(title: str, now: dict[str, float], was: dict[str, float], factor: float, digits: int, least: float,
              notes: dict[str, str]) -> list[str]:  # fmt: skip
        head = f"{title:<24}" + (f"{'before':>9}{'after':>9}{'change':>9}" if old is not None else "")
        names = [n for n in dict.fromkeys([*now, *was]) if max(now.get(n, 0), was.get(n, 0)) >= least]

        def scaled(of: dict[str, float], name: str) -> float | None:
            return of[name] * factor if name in of else None

        rows = [row(f"  {n}", scaled(now, n), scaled(was, n), notes.get(n, ""), digits) for n in names]
        return [head, *rows] if names else []

    was = old or found
    lines = block("measures, cm", found.values, was.values, 100, 1, 0, TABLE)
    notes = {s + k.replace(" ", "_"): t for k, t in LENGTHS.items() for s in ("l_", "r_")}
    lines += block("limbs, cm", found.limbs, was.limbs, 100, 1, 0, notes)
    lines.append(row("volume, l", found.volume * 1000, was.volume * 1000))
    lines.append(row("mass, kg", found.mass, was.mass))
    heavy = dict(sorted(found.masses.items(), key=lambda m: -m[1]))
    return lines + block("mass of Segments, kg", heavy, was.masses, 1, 2, 0.05, {})


def _change(now: dict[str, Any], was: dict[str, Any]) -> dict[str, Any]:
    """After less before, of what both have."""
    out: dict[str, Any] = {}
    for key, value in now.items():
        other = was.get(key)
        if isinstance(value, dict) and isinstance(other, dict):
            out[key] = _change(value, other)
        elif value is not None and other is not None:
            out[key] = value - other
    return out


def _read(source: str, repair: bool) -> Any:
    from vitruvian.formats.registry import load
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.modeling.person import person

    thing = person() if source == "person" and not Path(source).is_file() else load(source, repair=repair)
    if not isinstance(thing, Humanoid) and not hasattr(thing, "triangles"):
        raise VitruvianError(f"{source}: expected a body or a mesh, found a {type(thing).__name__.lower()}")
    return thing


def _taken(thing: Any, marks: Path | None, unit: str | None) -> Measures:
    from vitruvian.modeling.landmarks import read
    from vitruvian.modeling.measures import measures

    return measures(thing, None if marks is None else read(marks), unit=unit)


def _document(found: Measures) -> dict[str, Any]:
    return {
        "height_m": found.values.get("height"),
        "mass_kg": found.mass,
        "volume_m3": found.volume,
        "measures": found.values,
        "limbs_m": found.limbs,
        "masses_kg": found.masses,
        "volumes_m3": found.volumes,
    }


_ENCODINGS = {".x3d": "x3d", ".x3dv": "x3dv", ".x3dj": "x3dj", ".wrl": "wrl"}


def _write_sites(thing: Any, source: str, marks: Path | None, out: Path) -> None:
    """The body with its tapes as Sites."""
    from vitruvian.formats.registry import save
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.modeling.landmarks import read
    from vitruvian.modeling.tapes import as_sites, tapes

    if not isinstance(thing, Humanoid):
        raise VitruvianError(f"--sites: expected an H-Anim body, {source} is a mesh; `-o` writes its tapes as .json")
    as_sites(thing, tapes(thing, None if marks is None else read(marks)))
    save(thing, out)


def _write(found: Measures, thing: Any, marks: Path | None, unit: str | None, out: Path) -> None:
    """The tapes: metres, upright, as closed lines of a scene or as rows name, x, y, z; as JSON in the file's own axes."""
    import numpy as np

    if out.suffix.lower() == ".json":
        from vitruvian.formats.atomic import atomic
        from vitruvian.modeling.landmarks import read
        from vitruvian.modeling.tapes import tapes, to_json

        text = to_json(tapes(thing, None if marks is None else read(marks), unit=unit))
        with atomic(out) as part:
            part.write_text(text + "\n", encoding="utf-8")
        return

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
