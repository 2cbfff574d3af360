"""Commands that change clips: clip."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from vitruvian.cli import app
from vitruvian.cli.output import Json, count, emit
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.motion.types import Motion


@app.command(
    epilog="Example: vitruvian clip walk.bvh --start 1 --stop 3 --loop --in-place -o cycle.bvh --plot angles.svg"
)
def clip(
    motion: str = typer.Argument(..., help="A motion file (BVH, VRMA, ...), or the words walk or idle."),
    out: Path | None = typer.Option(None, "-o", "--out", help="File to write: .bvh or .vrma."),
    start: float | None = typer.Option(None, help="Seconds: begin here."),
    stop: float | None = typer.Option(None, help="Seconds: end here."),
    fps: float | None = typer.Option(None, help="Frames per second of the result."),
    speed: float | None = typer.Option(None, help="Play so many times as fast."),
    reverse: bool = typer.Option(False, "--reverse", help="From the end to the beginning."),
    mirror: bool = typer.Option(False, "--mirror", help="Exchange left and right."),
    lowpass: float | None = typer.Option(None, metavar="HZ", help="Take out what is quicker."),
    then: list[str] = typer.Option([], "--then", metavar="FILE", help="Go on with this clip; may be repeated."),
    fade: float = typer.Option(0.2, help="Seconds that one clip takes to fade into the next."),
    blend: str | None = typer.Option(None, metavar="FILE", help="Mix with this clip."),
    share: float = typer.Option(0.5, min=0, max=1, help="How much of the clip of --blend."),
    loop: bool = typer.Option(False, "--loop", help="Make the end meet the beginning."),
    in_place: bool = typer.Option(False, "--in-place", help="Keep the figure on the spot."),
    plot: Path | None = typer.Option(None, "--plot", metavar="SVG", help="Draw angles of joints against their limits."),
    joints: str | None = typer.Option(None, help="Joints to draw, separated by commas (default: all with limits)."),
    as_json: bool = Json,
) -> None:
    """Cut, join, mix, filter and loop clips, in the order of these options; draw their joint angles."""
    from vitruvian.motion import clips, editing, filters

    if out is None and plot is None:
        raise VitruvianError("clip: expected -o FILE or --plot SVG, found neither")
    made = _clip(motion)
    if start is not None or stop is not None:
        made = clips.trim(made, start or 0.0, made.seconds if stop is None else stop)
    if fps is not None:
        made = clips.resample(made, fps)
    if speed is not None:
        made = editing.faster(made, speed)
    if reverse:
        made = editing.reverse(made)
    if mirror:
        made = clips.mirror(made)
    if lowpass is not None:
        made = filters.lowpass(made, lowpass)
    if then:
        made = editing.concatenate([made, *(_clip(f) for f in then)], fade)
    if blend is not None:
        made = editing.blend(made, _clip(blend), share)
    if loop:
        made = editing.looped(made)
    if in_place:
        made, _ = editing.in_place(made)
    written = []
    if plot is not None:
        written.append(_plot(made, plot, joints))
    if out is not None:
        from vitruvian.formats.registry import save

        save(made, out)
        written.append(str(out))
    document = {"frames": len(made), "fps": made.fps, "seconds": made.seconds, "loop": made.loop, "files": written}
    text = f"wrote {', '.join(written)}: {count(len(made), 'frame')}, {made.seconds:.2f} s at {made.fps:g} per second"
    emit(document, text, as_json)


def _clip(source: str) -> Motion:
    """A motion on its own skeleton."""
    from vitruvian.cli.people import GAITS
    from vitruvian.motion.types import Motion

    if source in GAITS and not Path(source).is_file():
        import vitruvian as gait
        from vitruvian.body.pack import pack

        return getattr(gait, source)(pack(gait.person()).skeleton)
    from vitruvian.body.pack import pack
    from vitruvian.formats.registry import load
    from vitruvian.motion.tracks import motion_of

    found = load(source)
    if not isinstance(found, Motion):
        found = motion_of(found, pack(found).skeleton) if hasattr(found, "motions") else None
    if found is None:
        raise VitruvianError(f"{source}: expected a motion, found none in it")
    return found


def _plot(motion: Motion, path: Path, joints: str | None) -> str:
    import numpy as np

    from vitruvian.formats.atomic import atomic
    from vitruvian.show.plots import angle_panels, svg

    if path.suffix.lower() != ".svg":
        raise VitruvianError(f"--plot: expected a name that ends in .svg, found {path}")
    panels = angle_panels(motion, None if joints is None else [j.strip() for j in joints.split(",")])
    if not panels:
        raise VitruvianError("--plot: no joint of the clip has limits; name joints with --joints")
    with atomic(path) as temporary:
        temporary.write_text(svg(panels, np.arange(len(motion)) / motion.fps, motion.name or path.stem), "utf-8")
    return str(path)
