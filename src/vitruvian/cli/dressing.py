"""Commands about clothes: dress, and what is said of patterns."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli import app
from vitruvian.cli.output import Json, Out, Repair, count, emit, progress
from vitruvian.cli.refitting import FitOption
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from vitruvian.body.types import Body
    from vitruvian.cloth.garment import Garment
    from vitruvian.cloth.pattern import Pattern

BUTTONED = 20.0  # millimetres between what is buttoned above which it is called open
APART = 3.0  # millimetres between what was to be sewn above which a seam is called open; less is welded
WORST = 0.05  # strain of the 99th percentile above which a garment is called tight


MEASURES = ("height", "neck", "chest", "underbust", "waist", "hips", "thigh", "calf", "upper_arm", "wrist", "inseam",
            "arm_length", "shoulder_width", "back_length")  # fmt: skip


def pattern_of(source: Path, body: Any = None, **options: Any) -> Pattern:
    """The pattern of a file, or one of our own by its name, drafted for a body (None: the built-in person). Options go to
    the reader: sidecar, unit, outlines.

    VitruvianError where the file holds something else, or there is neither.
    """
    from vitruvian.cloth.drafting import DRAFTS, drafted
    from vitruvian.cloth.pattern import Pattern
    from vitruvian.formats.registry import kind, load

    if not source.exists() and (source.name in DRAFTS or not source.suffix):
        return drafted(str(source), _measures(body))
    given = {k: v for k, v in options.items() if v is not None}
    known = {".svg": ("sidecar", "outlines"), ".dxf": ("sidecar", "unit"), ".freesewing.json": ("sidecar",)}
    form = kind(source)
    strange = next((k for k in given if k not in known.get(form, ())), None)
    if strange is not None:
        raise VitruvianError(f"{source}: --{strange} says nothing about such a file")
    found = load(source, **given)
    if not isinstance(found, Pattern):
        raise VitruvianError(f"{source}: expected a sewing pattern, found a {type(found).__name__.lower()}")
    from vitruvian.cloth.dimensions import dimensions, fitted

    if body is None or not dimensions(found):
        return found
    from vitruvian.modeling.measures import measures

    return fitted(found, measures(body).values)  # lengths that are said by measures are those of this body


def _measures(body: Any) -> dict[str, float]:
    """The measures that drafts know of a body, or of the built-in person."""
    from vitruvian.modeling.measures import measures
    from vitruvian.modeling.person import person

    values = measures(person(outfit=None, hair="none") if body is None else body).values
    return {n: values[n] for n in MEASURES if n in values}


def placed_on(pattern: Pattern, body: Any, *, arms: float | None = None) -> Pattern:
    """The pattern with places around a body (None: the built-in person) for panels that have none."""
    if all(p.rotation is not None and p.translation is not None for p in pattern.panels):
        return pattern
    from vitruvian.body.pack import pack
    from vitruvian.cloth.drafting.figure import figure
    from vitruvian.cloth.placing import dummy
    from vitruvian.cloth.wrapping import ARMS, stand, wrapped
    from vitruvian.modeling.person import person

    body = person(outfit=None) if body is None else body
    stands = stand(figure(_measures(body)), dummy(pack(body), arms=ARMS if arms is None else arms))
    return wrapped(pattern, stands)


@app.command(epilog="Example: vitruvian dress person trousers shirt --fabric denim --fabric cotton -o dressed.glb")
def dress(
    source: str = typer.Argument(..., metavar="BODY", help="H-Anim, glTF, VRM or USD body, or the word person."),
    garments: list[Path] = typer.Argument(
        ...,
        metavar="PATTERN...",
        help="Patterns' files (.json, .svg, .dxf), or drafts: tshirt, ... (see pattern list), innermost first.",
    ),
    out: Path = Out,
    fabric: list[str] = typer.Option(
        ["cotton"],
        "--fabric",
        help="chiffon, silk, cotton, linen, wool, jersey, denim, leather; once for each garment.",
    ),
    size: float = typer.Option(10.0, "--size", min=3.0, max=40.0, help="Millimetres between the cloth's points."),
    arms: float | None = typer.Option(
        None,
        "--arms",
        min=0.0,
        max=90.0,
        help="Degrees of the arms below the horizontal (10; 30 for patterns that do not say where their panels hang).",
    ),  # fmt: skip
    sidecar: Path | None = typer.Option(
        None, "--sidecar", help="How a drawing is sewn (NAME.sewing.json beside it otherwise)."
    ),
    fit_map: Path | None = FitOption,
    layers: bool = typer.Option(
        False,
        "--layers",
        help="Also sort the cloth into tight, loose and floating, ready to be worn in motion: kept in "
        ".garment.npz, shown by --fit-map.",
    ),
    edge: list[str] = typer.Option(
        [],
        "--edge",
        metavar="REGION=TIGHT,LOOSE",
        help="Millimetres from the skin up to which cloth is tight and loose on "
        "trunk, l_thigh, ...: trunk=8,40; may be repeated. Means --layers.",
    ),
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Sew patterns around a body and let them fall into place, each over the ones before it.

    The result is the body in the pose it was dressed in, with the garment as part of its skin, moved by its joints; or,
    in a file that ends in .garment.npz, the garment to be put on other bodies, see refit. Exit status 1: the garment
    does not fit, and the reason.
    """
    from math import radians

    from vitruvian.body.pack import pack
    from vitruvian.cli.refitting import written
    from vitruvian.cloth.tailor import tailor
    from vitruvian.formats.fabrics import fabric_from

    body = _bare(source, repair)
    packed = pack(body)
    cloths = [fabric_from(name) for name in fabric]
    edges = _edges(edge)
    patterns = [_sewable(path, body, sidecar) for path in garments]
    lowered = _lowered(patterns) if arms is None else radians(arms)
    patterns = [placed_on(pattern, body, arms=lowered) for pattern in patterns]
    start = time.perf_counter()
    over: list[Any] = []
    with progress("dressing") as bar:
        for k, pattern in enumerate(patterns):
            made = tailor(
                pattern, packed, fabric=cloths[min(k, len(cloths) - 1)], size=size / 1000, arms=lowered, over=over,
                progress=partial(_told, bar, k, len(patterns)),
            )  # fmt: skip
            over = [*made.below, made]
    sorted_ = layers or bool(edge)
    if sorted_:
        made = ready(made, packed, edges)
    lost, said = written(made, body, out, fit_map)
    if sorted_:
        said["layers"] = {g.name: _counts(g) for g in (*made.below, made)}
    document: dict[str, Any] = dict(made.report) | {"seconds": time.perf_counter() - start, "lost": lost}
    document["below"] = [dict(g.report) | {"name": g.name} for g in made.below]
    reasons = faults(document)
    for g in made.below:
        reasons += [f"{g.name}: {line}" for line in faults({**g.report, "settled": True})]
    text = (
        f"wrote {out}: {count(document['faces'], 'face')}, seams {document['seam_gap_max_mm']:.2f} mm, strain "
        f"{document['strain_p99']:.1%}, {document['self_intersections']} cuts of itself, "
        f"{count(document['penetrating_vertices'], 'point')} in the body; {document['seconds']:.1f} s"
    )
    for name, counts in said.get("layers", {}).items():
        text += f"\n{name}: " + ", ".join(f"{v:.0%} {k}" for k, v in counts.items())
    lines = [text, *reasons, *said.get("fit", {}).get("findings", []), *(f"lost: {line}" for line in lost)]
    emit(document | {"reasons": reasons, **said}, "\n".join(lines), as_json)
    if reasons:
        raise typer.Exit(1)


def ready(made: Garment, body: Body, edges: Mapping[str, tuple[float, float]]) -> Garment:
    """The garment and those below it with their layers, ready to be worn in motion."""
    from vitruvian.cloth.wear import hung, wear, wearer
    from vitruvian.deform.deformer import deformer

    return hung(wear(made, wearer(deformer("log", body)), edges=edges))


def _edges(words: list[str]) -> dict[str, tuple[float, float]]:
    """Region -> metres up to which cloth is tight and loose there, of `trunk=8,40` and the like."""
    from vitruvian.cloth.layers import REGIONS, TRUNK

    out = {}
    for word in words:
        name, _, values = word.partition("=")
        try:
            tight, loose = (float(v) / 1000 for v in values.split(","))
        except ValueError:
            raise VitruvianError(f"--edge: expected REGION=TIGHT,LOOSE in millimetres, found {word!r:.40}") from None
        if name not in (TRUNK, *REGIONS):
            raise VitruvianError(f"--edge: expected one of {', '.join((TRUNK, *REGIONS))}, found {name!r:.40}")
        if not 0 <= tight <= loose <= 1:
            raise VitruvianError(f"--edge {word}: expected 0 <= TIGHT <= LOOSE <= 1000")
        out[name] = (tight, loose)
    return out


def _counts(made: Garment) -> dict[str, float]:
    """Share of a garment's vertices in each layer."""
    from vitruvian.cloth.layers import NAMES

    assert made.hung is not None
    return {name: round(float((made.hung.layer == k).mean()), 4) for k, name in enumerate(NAMES)}


def _lowered(patterns: list[Pattern]) -> float:
    """Radians of the arms below the horizontal: lower where panels are placed here."""
    from vitruvian.cloth import placing, wrapping

    hung = all(p.rotation is not None and p.translation is not None for pattern in patterns for p in pattern.panels)
    return placing.ARMS if hung else wrapping.ARMS


def _told(bar: Any, done: int, all_of: int, _: str, share: float) -> None:
    bar(round(1000 * (done + share)), 1000 * all_of)


def _sewable(path: Path, body: Any, sidecar: Path | None) -> Pattern:
    """A pattern with seams. VitruvianError where it says none."""
    pattern = pattern_of(path, body, sidecar=sidecar)
    if not pattern.seams and len(pattern.panels) > 1:
        name = path.name.split(".")[0]
        raise VitruvianError(
            f"{path}: says no seams; propose some, `vitruvian pattern sew {path} -o {name}.pattern.json`, and dress in "
            f"that, or say them in {name}.sewing.json"
        )
    return pattern


def _bare(source: str, repair: bool) -> Any:
    """The body to dress; the built-in person without clothes of its own."""
    from vitruvian.cli.people import subject

    if source == "person" and not Path(source).is_file():
        from vitruvian.modeling.person import person

        return person(outfit=None)
    return subject(source, repair=repair)


def faults(report: dict[str, Any]) -> list[str]:
    """Why a garment cannot be worn, in a line each; [] when it can."""
    out = []
    if report["seam_gap_max_mm"] > APART:
        some = ", ".join(map(str, report["open_seams"][:8]))
        out.append(f"does not close: seams {some} stay up to {report['seam_gap_max_mm']:.0f} mm apart; too small?")
    if report.get("button_gap_max_mm", 0) > BUTTONED:
        out.append(f"does not close: its buttons stay up to {report['button_gap_max_mm']:.0f} mm apart; too small?")
    if report["strain_p99"] > WORST:
        out.append(f"tight: the most stretched hundredth of its edges is {report['strain_p99']:.0%} longer or more")
    if report["penetrating_vertices"]:
        out.append(f"{count(report['penetrating_vertices'], 'point')} of it are inside the body")
    if not report["settled"]:
        out.append(f"still moves by {1000 * report['speed']:.0f} mm/s")
    return out
