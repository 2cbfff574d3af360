"""Commands about people: person, animate."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli import app
from vitruvian.cli.capture import Fps, Skeleton, Unit, Up, no_joints, said
from vitruvian.cli.output import Bake, Json, Out, Tolerance, baked, baking, count, emit, progress
from vitruvian.cli.wearing import Fabrics, Garments, Proof, clothes_of, dressed_in, fit_of, proof, provable, told
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.body.types import Body
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.motion.types import Motion
    from vitruvian.stage.clip import Clip

GAITS = ("walk", "idle")


@app.command(epilog="Example: vitruvian person --gender female --age 40 --height 1.68 -o anna.glb")
def person(
    out: Path = Out,
    gender: str = typer.Option("0.5", help="female, male, or a number from 0 (female) to 1 (male)."),
    age: float = typer.Option(25, help="Years, 10 to 90."),
    height: float | None = typer.Option(None, help="Stature in metres."),
    weight: float = typer.Option(0.5, help="From 0 (thin) to 1 (heavy), or kilograms."),
    muscle: float = typer.Option(0.5, min=0, max=1, help="From 0 (slack) to 1 (muscular)."),
    measure: list[str] = typer.Option([], "--measure", metavar="NAME=CM", help="A measure in cm; may be repeated."),
    loa: int = typer.Option(4, min=0, max=4, help="Level of articulation."),
    hair: str | None = typer.Option(None, help="short, bob, bun or none (default: by gender)."),
    outfit: str | None = typer.Option(
        None, help='"t-shirt and shorts", "t-shirt and trousers", "body suit", or none, to dress them in other clothes.'
    ),
    tone: str | None = typer.Option(None, help="Skin tone: fair, light, medium, tan, brown, dark, ... or 0 to 1."),
    as_json: bool = Json,
) -> None:
    """Make the built-in person and write it to a file."""
    from vitruvian.formats.registry import save
    from vitruvian.modeling.measures import measures
    from vitruvian.modeling.person import person as make

    names = {"female": 0.0, "male": 1.0}
    try:
        sex = names[gender] if gender in names else float(gender)
    except ValueError:
        raise VitruvianError(f"--gender: expected female, male or a number in 0..1, found {gender}") from None
    wanted = {"hair": hair, "outfit": outfit, "skin_tone": _number_or_name(tone)}
    look: dict[str, Any] = {k: v for k, v in wanted.items() if v is not None}
    if outfit == "none":
        look["outfit"] = None
    humanoid = make(
        gender=sex,
        age=age,
        height=height,
        weight=weight,
        muscle=muscle,
        measures=_measures(measure) or None,
        loa=loa,
        **look,
    )
    save(humanoid, out)
    taken = measures(humanoid)
    facts = {"height_m": taken.values["height"], "mass_kg": taken.mass, "measures": taken.values}
    text = f"wrote {out}: {facts['height_m']:.2f} m, {facts['mass_kg']:.0f} kg"
    text += "".join(f"\n  {name} {value * 100:.1f} cm" for name, value in taken.values.items())
    emit(facts, text, as_json)


def _number_or_name(text: str | None) -> float | str | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return text


def _measures(items: list[str]) -> dict[str, float]:
    """NAME=CM options as {name: metres}."""
    out = {}
    for item in items:
        name, _, value = item.partition("=")
        try:
            out[name] = float(value) / 100
        except ValueError:
            raise VitruvianError(f"--measure: expected NAME=CM such as waist=78, found {item}") from None
    return out


def subject(source: str, *, repair: bool = False) -> Humanoid:
    """A humanoid from a file, or the built-in person for the word `person`."""
    if source == "person" and not Path(source).is_file():
        from vitruvian.modeling.person import person as make

        return make()
    from vitruvian.formats.registry import load
    from vitruvian.hanim.humanoid import Humanoid

    found = load(source, repair=repair)
    if not isinstance(found, Humanoid):
        raise VitruvianError(f"{source}: expected an H-Anim body, found a {type(found).__name__.lower()}")
    return found


def movement(source: str, body: Body, clip: str | None = None, *, names: Path | None = None, **options: Any) -> Motion:
    """A motion on the body's skeleton: our own gaits (`walk`, `idle`), a capture, or a motion of another body's file,
    the one named `clip` or the first. `names` is a JSON table of its joints, `options` go to the reader."""
    from vitruvian.motion.contacts import soled
    from vitruvian.motion.retarget import retarget
    from vitruvian.motion.rigs import own_names

    if source in GAITS and not Path(source).is_file():
        import vitruvian as gait

        return getattr(gait, source)(soled(body))
    from vitruvian.body.pack import pack
    from vitruvian.formats.registry import load
    from vitruvian.motion.tracks import motion_of
    from vitruvian.motion.types import Motion

    found = load(source, **options)
    if not isinstance(found, Motion):
        own = motion_of(found, pack(found).skeleton, name=clip) if hasattr(found, "motions") else None
        if own is None:
            raise no_joints(source, found)
        found = own
    return retarget(found, soled(body), names=own_names(names) or None)


def write(clip: Clip, out: Path, *, bake: bool = False, tolerance: float | None = None) -> dict[str, Any]:
    """Write a clip to a file of any kind we have: scenes, GLB, USD, BVH, OBJ, a page, a picture or a film."""
    kind = out.suffix.lower()
    options = baking(out, bake, tolerance, clothes=bool(clip.caches))
    if kind == ".html":
        from vitruvian.show.recording import record

        return {"lost": [], "pruned_weights": 0, "max_vertex_error_m": 0.0} | record(clip, out)
    if kind == ".png":
        from vitruvian.show.picture import picture

        picture(clip, out)
    elif kind in (".mp4", ".gif", ".webp"):
        from vitruvian.show.film import film

        with progress("film") as update:
            film(clip, out, progress=update)
    else:
        from vitruvian.formats.registry import save

        return save(clip, out, **options)
    return {"lost": [], "pruned_weights": 0, "max_vertex_error_m": 0.0}


@app.command(
    epilog="Example: vitruvian animate body.x3d walk.bvh -o walking.glb, or "
    "vitruvian animate person walk --garment tshirt --garment trousers -o dressed.glb"
)
def animate(
    body: str = typer.Argument(..., help="H-Anim, glTF, VRM or USD file, or the word person."),
    motion: str = typer.Argument(..., help="BVH, AMC, npz, VRMA, glTF, H-Anim or USD file, or walk or idle."),
    out: Path = Out,
    deformer: str = typer.Option(
        "log", help="How the skin follows: linear, dual-quaternion, log, volume, hand, hybrid, ..."
    ),
    clip: str | None = typer.Option(None, "--clip", help="Name of the clip in an H-Anim file; `info` lists them."),
    names: Path | None = typer.Option(
        None, "--names", metavar="FILE", help='JSON table {"joint of the motion": "H-Anim joint"}; wins over our own.'
    ),
    repair: bool = typer.Option(
        False, "--repair", help="Drop numbers that can't be meant instead of refusing the file."
    ),
    unit: str | None = Unit,
    up: str | None = Up,
    fps: float | None = Fps,
    skeleton: Path | None = Skeleton,
    garment: list[str] = Garments,
    fabric: list[str] = Fabrics,
    proven: Path | None = Proof,
    bake: bool = Bake,
    tolerance: float | None = Tolerance,
    as_json: bool = Json,
) -> None:
    """Put a motion on a body, and clothes if it is to wear any, and write what comes out. Exit status 1: a garment does not
    close.

    Writes .glb .usdz .usdc .usda .x3d .x3dv .x3dj .wrl .html .mp4 .png .bvh .amc .npz .trc .csm .obj; with --garment also
    NAME.objs, a folder with an OBJ for each frame, and NAME.cache.npz, the moving clothes alone.
    """
    from dataclasses import replace

    from vitruvian.body.pack import pack
    from vitruvian.cli.dressing import _bare
    from vitruvian.deform.deformer import deformer as bind
    from vitruvian.motion.contacts import floor_penetration_mm, foot_slide_mm
    from vitruvian.stage.clip import Clip

    start = time.perf_counter()
    provable(garment, proven)
    options = said(motion, unit, up, fps, None, skeleton)
    humanoid = _bare(body, repair) if garment else subject(body, repair=repair)
    packed = pack(humanoid)
    bind(deformer, packed)  # an unknown name fails here, before the work
    shown = Clip(humanoid, packed, movement(motion, packed, clip, names=names, **options), deformer)
    shown = clothes_of(replace(shown, garment=dressed_in(garment, fabric, humanoid)), out, bake=bake)
    report = write(shown, out, bake=bake, tolerance=tolerance)
    moved = shown.motion
    assert moved is not None
    document = {
        "frames": len(moved),
        "fps": moved.fps,
        "foot_slide_mm": foot_slide_mm(moved),
        "floor_penetration_mm": floor_penetration_mm(moved, packed),
        "seconds": time.perf_counter() - start,
        **report,
    }
    reasons, able = fit_of(shown.garment)
    if garment:
        document["reasons"] = reasons
    shown_proof = []
    if proven is not None:
        document["proof"] = figures = proof(shown, proven)
        shown_proof = [
            f"{proven}: {figures['from_full_surface_mm']} mm from the full simulation, {figures['inside']} points in the "
            f"skin, strain {figures['strain_p99']:.0%}, {figures['share']:.0%} of its cost"
        ]
    text = (
        f"wrote {out}: {count(document['frames'], 'frame')} at {moved.fps:g} per second; feet slide "
        f"{document['foot_slide_mm']:.1f} mm per frame at most and sink {document['floor_penetration_mm']:.1f} mm"
    )
    emit(document, "\n".join([text, *baked(report), *told(report), *shown_proof, *reasons]), as_json)
    if not able:
        raise typer.Exit(1)
