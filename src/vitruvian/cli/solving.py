"""Commands that make motion of what a tracker saw: solve."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli import app
from vitruvian.cli.capture import Actor, Fps, Unit, Up, said
from vitruvian.cli.output import Json, Out, count, emit, progress
from vitruvian.errors import FileError, VitruvianError

if TYPE_CHECKING:
    from vitruvian.body.types import Body
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.motion.markers import Markers
    from vitruvian.motion.tracking import Tracked
    from vitruvian.motion.types import Motion

LARGEST = 1 << 20  # bytes of a map of labels


@app.command(
    epilog="Example: vitruvian solve walk.c3d -o walk.bvh --plot residuals.svg, or "
    "vitruvian solve walk.trc --performer standing.trc --body anna.x3d -o anna.glb"
)
def solve(
    markers: Path = typer.Argument(..., metavar="MARKERS", help="C3D, TRC or CSM file."),
    out: Path = Out,
    body: str | None = typer.Option(
        None, "--body", help="Body that shall move (default: the built-in person, as tall as the performer)."
    ),
    labels: Path | None = typer.Option(
        None, "--markers", metavar="MAP.json", help='JSON {"label": "Site or joint"}; "" leaves a marker out.'
    ),
    performer: Path | None = typer.Option(
        None, "--performer", metavar="FILE", help="Another clip of the same person and markers: its bones hold."
    ),
    still: tuple[float, float] | None = typer.Option(
        None, "--still", metavar="FROM TO", help="Seconds in which the performer stands like the body at rest."
    ),
    lowpass: float | None = typer.Option(None, metavar="HZ", help="Take out of the motion what is quicker."),
    plot: Path | None = typer.Option(None, "--plot", metavar="SVG", help="Draw how far off each marker is over time."),
    unit: str | None = Unit,
    up: str | None = Up,
    fps: float | None = Fps,
    actor: str | None = Actor,
    as_json: bool = Json,
) -> None:
    """Make a motion of joints from trajectories of markers.

    Files with a skeleton alone (.bvh .amc .npz .vrma .trc .csm) get the performer's own bones, others (.glb .usdz .x3d
    .html .mp4 .png ...) a body that does the same.
    """
    import numpy as np

    from vitruvian.body.pack import pack
    from vitruvian.cli.people import subject, write
    from vitruvian.formats.registry import MOTIONS, WRITERS, extension, save
    from vitruvian.motion.contacts import floor_penetration_mm, foot_slide_mm
    from vitruvian.motion.filters import lowpass as calmer
    from vitruvian.stage.clip import Clip

    if plot is not None and plot.suffix.lower() != ".svg":
        raise VitruvianError(f"--plot: expected a name that ends in .svg, found {plot}")
    if extension(out) not in (*WRITERS, ".html", ".png", ".mp4", ".gif", ".webp"):
        raise VitruvianError(f"{out}: can't write this kind of file; expected one of {', '.join(WRITERS)}")
    asked = said(markers, unit, up, fps, actor, None)
    seen = read(markers, **asked)
    places = None if labels is None else label_map(labels)
    humanoid = None if body is None else subject(body)
    packed = None if humanoid is None else pack(humanoid)
    with progress("solve") as bar:
        found, note = solved(
            seen, packed, places, None if performer is None else read(performer, **asked), still, lambda x: bar(x, 1)
        )
    motion = found.motion if lowpass is None else calmer(found.motion, lowpass)
    if plot is not None:
        from vitruvian.formats.atomic import atomic
        from vitruvian.show.plots import residual_panels, svg

        panels = residual_panels(found.names, found.residual)
        with atomic(plot) as temporary:
            seconds = seen.start + np.arange(len(motion)) / motion.fps
            temporary.write_text(svg(panels, seconds, f"{markers.name}: residuals"), "utf-8")
    document = facts(found, [*note, *found.notes])
    if extension(out) in MOTIONS and humanoid is None:
        save(motion, out)
    else:
        if humanoid is None or packed is None:
            humanoid, packed = like(motion)
        shown = moved(motion, packed)
        write(Clip(humanoid, packed, shown), out)
        document["foot_slide_mm"] = foot_slide_mm(shown)
        document["floor_penetration_mm"] = floor_penetration_mm(shown, packed)
    document["files"] = [str(f) for f in (plot, out) if f is not None]
    emit(document, text_of(document, out), as_json)


def read(path: Path, **options: Any) -> Markers:
    """The markers of a file. Raises VitruvianError when it holds something else."""
    from vitruvian.formats.registry import load
    from vitruvian.motion.markers import Markers

    found = load(path, **options)
    if not isinstance(found, Markers):
        raise VitruvianError(f"{path}: expected markers (.c3d, .trc, .csm), found a {type(found).__name__.lower()}")
    return found


def label_map(path: Path) -> dict[str, str]:
    """{label: Site or joint} from a JSON file. Raises FileError for anything else."""
    from vitruvian.formats.rows import content

    try:
        found = json.loads(content(path, LARGEST))
    except (ValueError, RecursionError) as error:
        raise FileError(path, getattr(error, "lineno", 0), f"expected JSON, found {error}") from None
    if not isinstance(found, dict) or not all(isinstance(v, str) for v in found.values()):
        raise FileError(path, 1, 'expected {"label": "Site or joint", ...}, "" to leave a marker out')
    return found


def solved(
    seen: Markers,
    body: Body | None,
    places: dict[str, str] | None,
    other: Markers | None,
    still: tuple[float, float] | None,
    progress: Any,
) -> tuple[Tracked, list[str]]:
    """What markers say, on the body or, where that lacks the feature points that they sit on, on the built-in person.

    `other`: a clip that tells the performer's bones; `still`: its seconds, else those of `seen`, of standing."""
    from vitruvian.body.pack import pack
    from vitruvian.modeling.person import person
    from vitruvian.motion.tracking import attach, track

    own = None if body is None else body.skeleton
    notes: list[str] = []
    usual = pack(person()).skeleton
    if own is not None and places is None:
        known, most = (len(attach(s, seen.names)[1]) for s in (own, usual))
        if known < most:
            notes.append(
                f"the body has places for {known} of {most} markers: solved on the built-in person, carried over to it"
            )
            own = None
    skeleton = usual if own is None else own
    told = None if other is None else track(
        skeleton, other.names, other.points, other.fps, places=_of(places, other), still=_frames(still, other)
    )  # fmt: skip
    free = None if told is not None else _frames(still, seen)
    return (
        track(
            skeleton,
            seen.names,
            seen.points,
            seen.fps,
            places=None if told is not None else places,
            still=free,
            performer=told,
            progress=progress,
        ),
        notes,
    )


def _of(places: dict[str, str] | None, markers: Markers) -> dict[str, str] | None:
    return None if places is None else {k: v for k, v in places.items() if k in markers.names}


def _frames(still: tuple[float, float] | None, markers: Markers) -> slice | None:
    """Seconds of a file's own time as frames."""
    if still is None:
        return None
    first, last = (round((t - markers.start) * markers.fps) for t in still)
    if not 0 <= first < last <= len(markers) + 1:
        end = markers.start + markers.seconds
        raise VitruvianError(f"--still: expected FROM < TO within {markers.start:g} to {end:g} s, found {still}")
    return slice(first, last)


def like(motion: Motion) -> tuple[Humanoid, Body]:
    """The built-in person as tall as the one whose motion it is."""
    import numpy as np

    from vitruvian.body.pack import pack
    from vitruvian.modeling.measures import measures
    from vitruvian.modeling.person import person

    usual = person()
    own, tall = (float(np.ptp(s.site_points[:, 1])) for s in (pack(usual).skeleton, motion.skeleton))
    humanoid = person(height=float(np.clip(measures(usual).values["height"] * tall / own, 1.3, 2.1)))
    return humanoid, pack(humanoid)


def moved(motion: Motion, body: Body) -> Motion:
    """The motion on the body, feet on its soles."""
    from vitruvian.motion.contacts import soled
    from vitruvian.motion.retarget import retarget

    return retarget(motion, soled(body))


def facts(found: Tracked, notes: list[str]) -> dict[str, Any]:
    """What to answer: residuals in mm, rates in frames per second."""
    import numpy as np

    seen = np.asarray(np.isfinite(found.residual).any(axis=0))
    each = {
        name: round(1000 * float(np.sqrt(np.nanmean(found.residual[:, k] ** 2))), 3) if seen[k] else None
        for k, name in enumerate(found.names)
    }
    frames = len(found.motion)
    return {
        "frames": frames,
        "fps": found.motion.fps,
        "rms_mm": 1000 * found.rms,
        "max_mm": 1000 * float(np.nanmax(found.residual)),
        "per_marker_rms_mm": each,
        "frames_per_second": frames / max(found.seconds[1], 1e-9),
        "calibration_seconds": found.seconds[0],
        "scale": found.scale,
        "notes": notes,
    }


def text_of(document: dict[str, Any], out: Path) -> str:
    """The document as lines to read."""
    each = document["per_marker_rms_mm"]
    wide = max(map(len, each))
    lines = [
        f"wrote {out}: {count(document['frames'], 'frame')} at {document['fps']:g} per second; {len(each)} markers are "
        f"{document['rms_mm']:.1f} mm off (root mean square), {document['max_mm']:.1f} mm at most; "
        f"{document['frames_per_second']:,.0f} frames per second after {document['calibration_seconds']:.1f} s for bones",
        *(f"  {note}" for note in document["notes"]),
    ]
    if "foot_slide_mm" in document:
        lines.append(
            f"  feet slide {document['foot_slide_mm']:.1f} mm per frame at most and sink "
            f"{document['floor_penetration_mm']:.1f} mm"
        )
    return "\n".join(
        [*lines, *(f"  {n:<{wide}}  {'never seen' if v is None else f'{v:6.1f} mm'}" for n, v in each.items())]
    )
