"""Commands about clothes: dress, and what is said of patterns."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli import app
from vitruvian.cli.output import Json, Out, Repair, count, emit, progress
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.cloth.pattern import Pattern

WORST = 0.05  # strain of the 99th percentile above which a garment is called tight


def pattern_of(source: Path, body: Any = None) -> Pattern:
    """The pattern of a file, or one of our own by its name, drafted for a body (None: the built-in person).

    VitruvianError where the file holds something else, or there is neither.
    """
    from vitruvian.cloth.drafting import DRAFTS, drafted
    from vitruvian.cloth.pattern import Pattern
    from vitruvian.formats.registry import load

    if not source.exists() and (source.name in DRAFTS or not source.suffix):
        from vitruvian.modeling.measures import measures
        from vitruvian.modeling.person import person

        known = ("height", "neck", "chest", "underbust", "waist", "hips", "thigh", "calf", "upper_arm", "wrist",
                 "inseam", "arm_length", "shoulder_width", "back_length")  # fmt: skip
        values = measures(person(outfit=None, hair="none") if body is None else body).values
        return drafted(str(source), {n: values[n] for n in known if n in values})
    found = load(source)
    if not isinstance(found, Pattern):
        raise VitruvianError(f"{source}: expected a sewing pattern, found a {type(found).__name__.lower()}")
    from vitruvian.cloth.dimensions import dimensions, fitted

    if body is None or not dimensions(found):
        return found
    from vitruvian.modeling.measures import measures

    return fitted(found, measures(body).values)  # lengths that are said by measures are those of this body


@app.command(epilog="Example: vitruvian dress person tshirt --fabric jersey -o dressed.glb")
def dress(
    source: str = typer.Argument(..., metavar="BODY", help="H-Anim, glTF, VRM or USD body, or the word person."),
    garment: Path = typer.Argument(
        ..., metavar="PATTERN", help="GarmentCode's JSON, or a draft: tshirt, ... (see pattern list)."
    ),
    out: Path = Out,
    fabric: str = typer.Option(
        "cotton", "--fabric", help="chiffon, silk, cotton, linen, wool, jersey, denim, leather."
    ),
    size: float = typer.Option(10.0, "--size", min=3.0, max=40.0, help="Millimetres between the cloth's points."),
    arms: float = typer.Option(10.0, "--arms", min=0.0, max=90.0, help="Degrees of the arms below the horizontal."),
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Sew a pattern around a body and let it fall into place.

    The result is the body in the pose it was dressed in, with the garment as part of its skin, moved by its joints. Exit
    status 1: the garment does not fit, and the reason.
    """
    from math import radians

    from vitruvian.body.pack import pack
    from vitruvian.cloth.garment import charted
    from vitruvian.cloth.tailor import tailor
    from vitruvian.formats.registry import save
    from vitruvian.modeling.wearing import worn

    body = _bare(source, repair)
    pattern = pattern_of(garment, body)
    start = time.perf_counter()
    with progress("dressing") as bar:
        made = tailor(
            pattern, pack(body), fabric=fabric, size=size / 1000, arms=radians(arms),
            progress=lambda _, share: bar(round(1000 * share), 1000),
        )  # fmt: skip
    uv, uv_triangles = charted(made)
    whole = worn(body, made.vertices, made.triangles, made.matrices, uv=uv, uv_triangles=uv_triangles)
    lost = list(save(whole, out)["lost"])
    document: dict[str, Any] = dict(made.report) | {"seconds": time.perf_counter() - start, "lost": lost}
    reasons = faults(document)
    text = (
        f"wrote {out}: {count(document['faces'], 'face')}, seams {document['seam_gap_max_mm']:.2f} mm, strain "
        f"{document['strain_p99']:.1%}, {document['self_intersections']} cuts of itself, "
        f"{count(document['penetrating_vertices'], 'point')} in the body; {document['seconds']:.1f} s"
    )
    emit(document | {"reasons": reasons}, "\n".join([text, *reasons, *(f"lost: {line}" for line in lost)]), as_json)
    if reasons:
        raise typer.Exit(1)


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
    if report["open_seams"]:
        some = ", ".join(map(str, report["open_seams"][:8]))
        out.append(f"does not close: seams {some} stay up to {report['seam_gap_max_mm']:.0f} mm apart; too small?")
    if report["strain_p99"] > WORST:
        out.append(f"tight: the most stretched hundredth of its edges is {report['strain_p99']:.0%} longer or more")
    if report["penetrating_vertices"]:
        out.append(f"{count(report['penetrating_vertices'], 'point')} of it are inside the body")
    if not report["settled"]:
        out.append(f"still moves by {1000 * report['speed']:.0f} mm/s")
    return out
