"""The command that puts a garment on a body of another shape, and what is written of how clothes fit."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli import app
from vitruvian.cli.output import Json, Out, Repair, count, emit, progress
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.cloth.fit_map import FitMap
    from vitruvian.cloth.garment import Garment
    from vitruvian.hanim.humanoid import Humanoid

FitOption = typer.Option(
    None, "--fit-map", metavar="FILE", help="Also write how it fits: .png, .html (a page) or .json (figures)."
)
# red, green and blue of clothes worn over each other, innermost first
COLORS = ((0.33, 0.42, 0.58), (0.86, 0.84, 0.78), (0.52, 0.22, 0.25), (0.30, 0.38, 0.28))
POLICIES = ("keep_pattern", "grade", "draft")


def written(made: Garment, body: Humanoid, out: Path, fit_map: Path | None) -> tuple[list[str], dict[str, Any]]:
    """Write a garment on its body, or by itself where `out` ends in .garment.npz, and how it fits. What is lost, and
    what to say about the fit."""
    from vitruvian.formats.garment_file import ENDING

    if out.name.lower().endswith(ENDING):
        kept(made, body, out)
        lost = [f"{one.name}: worn below {made.name}" for one in made.below]
    else:
        from vitruvian.cloth.garment import charted
        from vitruvian.formats.registry import save
        from vitruvian.modeling.wearing import worn

        whole = body
        for k, one in enumerate((*made.below, made)):
            uv, corners = charted(one)
            whole = worn(
                whole, one.vertices, one.triangles, one.matrices, uv=uv, uv_triangles=corners,
                name=one.name, color=COLORS[k % len(COLORS)],
            )  # fmt: skip
        lost = list(save(whole, out)["lost"])
    if fit_map is None:
        return lost, {}
    found = fit(made, body, fit_map)
    return lost, {"fit": found.summary() if fit_map.suffix.lower() == ".json" else {"findings": _told(found)}}


def _told(found: FitMap) -> list[str]:
    return [f.message for f in found.findings()]


def kept(made: Garment, body: Humanoid, out: Path) -> None:
    """Write a garment with the skin that it hangs on, to be put on another body later; not what is worn below it."""
    from dataclasses import replace

    from vitruvian.body.pack import pack
    from vitruvian.cloth.resizing import standing
    from vitruvian.formats.garment_file import Kept, write_garment

    there = standing(made, pack(body))
    write_garment(Kept(replace(made, below=()), there.vertices, there.body.skin.triangles), out)


def fit(made: Garment, body: Humanoid, out: Path) -> FitMap:
    """Write how a garment fits: a picture, a page or figures."""
    from vitruvian.body.pack import pack
    from vitruvian.cloth.resizing import standing
    from vitruvian.stage.fitting_room import fit_of

    kind = out.suffix.lower()
    if kind not in (".png", ".html", ".json"):
        raise VitruvianError(f"--fit-map {out}: expected .png, .html or .json")
    found = fit_of(made, body)
    if kind == ".json":
        import json

        from vitruvian.formats.atomic import atomic

        with atomic(out) as part:
            part.write_text(json.dumps(found.summary(), indent=1) + "\n", encoding="utf-8")
        return found
    from vitruvian.show.fit_view import fit_view, sheet

    there = standing(made, pack(body))
    view = fit_view(found, there.vertices, there.body.skin.triangles, made.vertices, name=made.name,
                    kinds=None if made.hung is None else made.hung.layer)  # fmt: skip
    if kind == ".png":
        sheet(view, out)
    else:
        from vitruvian.show.recording import record

        record(view, out, title=f"{made.name}: how it fits")
    return found


@app.command(
    epilog="Example: vitruvian refit tshirt.garment.npz person --measure waist=90 -o larger.glb --fit-map fit.png"
)
def refit(
    garment: Path = typer.Argument(..., metavar="GARMENT", help="A garment kept by dress: NAME.garment.npz."),
    source: str = typer.Argument("person", metavar="BODY", help="The body in its new shape, or the word person."),
    out: Path = Out,
    measure: list[str] = typer.Option(
        [], "--measure", metavar="NAME=CM", help="A measure of the person in cm; may be repeated."
    ),
    policy: str = typer.Option(
        "keep_pattern",
        "--policy",
        help="keep_pattern: the cloth as it was cut, draped anew. grade: cut larger or smaller as the skin has changed. "
        "draft: a pattern of our own, drafted and sewn anew.",
    ),
    fit_map: Path | None = FitOption,
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Put a garment on the body that it was sewn on, in another shape.

    The body needs the same points: the built-in person to other measures, or the same file with its points moved. Exit
    status 1: the garment does not fit any more, and the reason.
    """
    from vitruvian.cli.dressing import faults
    from vitruvian.formats.garment_file import read_garment

    if policy not in POLICIES:
        raise VitruvianError(f"--policy: expected {', '.join(POLICIES)}, found {policy!r:.40}")
    if fit_map is not None and fit_map.suffix.lower() not in (".png", ".html", ".json"):
        raise VitruvianError(f"--fit-map {fit_map}: expected .png, .html or .json")
    before = read_garment(garment)
    body = _wearer(source, measure, repair)
    start = time.perf_counter()
    made = _drafted(before.garment, body) if policy == "draft" else _followed(before, body, policy)
    lost, said = written(made, body, out, fit_map)
    document: dict[str, Any] = {**made.report, "policy": policy, "seconds": time.perf_counter() - start, "lost": lost}
    reasons = faults(document)
    text = (
        f"wrote {out}: {count(document['faces'], 'face')}, strain {document['strain_p99']:.1%}, "
        f"{count(document['penetrating_vertices'], 'point')} in the body; {document['seconds']:.1f} s"
    )
    lines = [text, *reasons, *said.get("fit", {}).get("findings", []), *(f"lost: {line}" for line in lost)]
    emit(document | {"reasons": reasons, **said}, "\n".join(lines), as_json)
    if reasons:
        raise typer.Exit(1)


def _wearer(source: str, measure: list[str], repair: bool) -> Humanoid:
    from vitruvian.cli.people import _measures, subject

    if source == "person" and not Path(source).is_file():
        from vitruvian.modeling.person import person

        return person(outfit=None, measures=_measures(measure) or None)
    if measure:
        raise VitruvianError(f"--measure: only the built-in person can be made to measure, found {source}")
    return subject(source, repair=repair)


def _followed(before: Any, body: Humanoid, policy: str) -> Garment:
    """A kept garment on a body with the same triangles."""
    import numpy as np

    from vitruvian.body.pack import pack
    from vitruvian.cloth.resizing import refitted

    packed = pack(body)
    if not np.array_equal(packed.skin.triangles, before.triangles):
        raise VitruvianError(
            f"refit: expected the body that the garment was sewn on ({len(before.skin)} points, {len(before.triangles)} "
            f"triangles) in another shape, found one with {len(packed.skin.rest)} and {len(packed.skin.triangles)}; "
            "--policy draft sews a draft anew"
        )
    return refitted(before.garment, before.skin, packed, policy=policy)


def _drafted(garment: Garment, body: Humanoid) -> Garment:
    """A draft of ours, made anew for the measures of a body."""
    from vitruvian.body.pack import pack
    from vitruvian.cli.dressing import pattern_of
    from vitruvian.cloth.drafting import DRAFTS
    from vitruvian.cloth.tailor import tailor

    if garment.name not in DRAFTS or not garment.pattern.measures:
        raise VitruvianError(
            f"--policy draft: expected a pattern of our own ({', '.join(DRAFTS)}), found {garment.name}"
        )
    sides = garment.mesh.material[garment.mesh.triangles]
    size = float(((sides - sides[:, [1, 2, 0]]) ** 2).sum(axis=2).mean() ** 0.5)
    with progress("dressing") as bar:
        return tailor(
            pattern_of(Path(garment.name), body), pack(body), fabric=garment.fabrics[0], size=min(0.04, size),
            progress=lambda _, share: bar(round(1000 * share), 1000),
        )  # fmt: skip
