"""Commands that mix people and carry detail between them: blend, offsets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli import app
from vitruvian.cli.output import Json, Out, emit, progress
from vitruvian.cli.people import _measures, subject
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.body.types import Floats
    from vitruvian.hanim.humanoid import Humanoid


@app.command(epilog="Example: vitruvian blend anna.x3d ben.x3d --weights 0.5,0.5 -o child.x3d")
def blend(
    files: list[str] = typer.Argument(..., metavar="A B [C...]", help="People of one topology, in the dress pose."),
    out: Path = Out,
    weights: str | None = typer.Option(None, help="One number each, separated by commas; they sum to 1."),
    measure: list[str] = typer.Option([], "--measure", metavar="NAME=CM", help="Size of a new body; may be repeated."),
    change: str | None = typer.Option(None, help="A body to change: --measure then says by how many cm."),
    as_json: bool = Json,
) -> None:
    """Mix people of one topology, by weights or so that the mixture has the measures asked for.

    People fitted with one template, built-in persons and mixtures have one topology. Hair and clothes that not all of
    them wear come from the person of greatest weight and are carried by the skin.
    """
    from vitruvian.formats.registry import save
    from vitruvian.modeling import blend as blending
    from vitruvian.modeling.space import space

    if (weights is None) == (not measure):
        raise VitruvianError("blend: expected --weights or --measure, one of them")
    if change and not measure:
        raise VitruvianError("blend: --change needs --measure NAME=CM, by how much")
    if len(files) < 2:
        raise VitruvianError("blend: expected two people or more, found one")
    people = [subject(f) for f in files]
    wishes = _measures(measure)
    if weights is not None:
        try:
            shares = [float(x) for x in weights.split(",")]
        except ValueError:
            raise VitruvianError(f"--weights: expected numbers such as 0.5,0.5, found {weights}") from None
        made = blending.blend(people, shares)
    else:
        spanned = space(people, list(wishes))
        with progress("blend") as update:
            if change:
                body = subject(change)
                made = spanned.changed(body, wishes, progress=update)
                people = [body, *people]
            else:
                made = spanned.made(wishes, progress=update)
    lost = save(made, out)["lost"]
    sizes, carried = blending.measures_of(made), blending.worn(people, made)
    document = {
        "measures": sizes,
        "height_m": sizes.get("height"),
        "mass_kg": sum(s.mass for s in made.segments()),
        "carried": carried,
        "lost": lost,
    }
    text = f"wrote {out}" + "".join(f"\n  {name} {value * 100:.1f} cm" for name, value in sizes.items())
    if carried:
        text += f"\nnot worn by all alike, so of the leading person alone, carried by the skin: {', '.join(carried)}"
    emit(document, "\n".join([text, *(f"lost: {line}" for line in lost)]), as_json)


Facts = dict[str, Any]
offsets = typer.Typer(help="Fine detail as displacements along a surface, kept as a 16-bit picture over its UVs.")
app.add_typer(offsets, name="offsets")


@offsets.command(epilog="Example: vitruvian offsets capture fitted.x3d detailed.x3d -o detail.png")
def capture(
    base: str = typer.Argument(..., help="The body, in the dress pose."),
    target: str = typer.Argument(..., help="The same body with detail, or any surface (m) in its pose."),
    out: Path = Out,
    size: int | None = typer.Option(
        None, help="Texels a side, 16 to 4096 (default: the least of 1024, 2048, 4096 that is within 0.2 mm)."
    ),
    normal: bool = typer.Option(False, "--normal", help="Only what goes along the normal: a grey picture."),
    as_json: bool = Json,
) -> None:
    """Keep what a surface has and a body lacks as a picture (.png) of displacements.

    `vitruvian fit --detail` writes such a picture of what a scan has and the fit lacks.
    """
    from vitruvian.formats.registry import load
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.modeling.offsets import captured
    from vitruvian.stage.clip import Mesh

    png(out)
    body, found = subject(base), load(target)
    if isinstance(found, Humanoid):
        moves = captured(body, found)
    elif isinstance(found, Mesh):
        moves = captured(body, found.vertices, found.triangles)
    else:
        raise VitruvianError(f"{target}: expected a body or a mesh, found a {type(found).__name__.lower()}")
    facts = picture(body, moves, out, size=size, normal=normal)
    emit(facts, f"wrote {out}: {said(facts)}", as_json)


def png(out: Path) -> None:
    """VitruvianError for a name that is no picture's."""
    if out.suffix.lower() != ".png":
        raise VitruvianError(f"{out}: expected a name that ends in .png")


def picture(body: Humanoid, moves: Floats, out: Path, *, size: int | None = None, normal: bool = False) -> Facts:
    """Write displacements (V,3) m of a body's skin as a picture; how large they are, and how far the picture is off."""
    import numpy as np

    from vitruvian.formats.relief import write
    from vitruvian.modeling.offsets import chart_of, drawn, sampled

    chart = chart_of(body)
    with progress("picture") as update:
        relief = drawn(chart, moves, size=size, normal_only=normal, progress=update)
    write(relief, out)
    far = np.linalg.norm(moves, axis=1)[chart.point]
    kept = np.sum(moves * chart.normals, axis=1, keepdims=True) * chart.normals if normal else moves
    off = np.linalg.norm(sampled(chart, relief) - kept, axis=1)[chart.point]
    along = np.linalg.norm(moves - kept, axis=1)[chart.point]
    return {
        "mean_mm": 1e3 * far.mean(),
        "max_mm": 1e3 * far.max(),
        "picture_max_error_mm": 1e3 * off.max(),
        "left_out_max_mm": 1e3 * along.max(),
        "size": relief.texels.shape[0],
    }


def said(facts: Facts) -> str:
    """The facts of a picture in words."""
    text = (
        f"{facts['size']} texels a side hold {facts['mean_mm']:.2f} mm in the mean, {facts['max_mm']:.1f} mm at most, "
    )
    text += f"within {facts['picture_max_error_mm']:.3f} mm"
    if facts["left_out_max_mm"] > 0.001:
        text += f"; {facts['left_out_max_mm']:.1f} mm across the normal are left out"
    return text


@offsets.command(epilog="Example: vitruvian offsets apply fitted.x3d detail.png --strength 0.5 -o detailed.x3d")
def apply(
    base: str = typer.Argument(..., help="The body that the picture was made on, at this or another resolution."),
    picture: Path = typer.Argument(..., help="A picture that `offsets capture` wrote."),
    out: Path = Out,
    strength: float = typer.Option(1.0, min=0, max=1, help="How much of it."),
    as_json: bool = Json,
) -> None:
    """Displace the skin of a body in the dress pose by a picture; it moves with every pose. Clothes and hair stay."""
    import numpy as np

    from vitruvian.formats.registry import save
    from vitruvian.formats.relief import read
    from vitruvian.modeling.offsets import displaced

    body = subject(base)
    made = displaced(body, read(picture), strength=strength)
    moved = np.linalg.norm(made.skin_coord - body.skin_coord, axis=1)
    lost = save(made, out)["lost"]
    emit(
        {"max_mm": 1e3 * moved.max(), "lost": lost}, f"wrote {out}: moved by up to {1e3 * moved.max():.1f} mm", as_json
    )
