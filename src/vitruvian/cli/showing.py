"""Commands that show: view, render, bench."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli import app
from vitruvian.cli.capture import Actor, no_joints
from vitruvian.cli.output import Json, Out, emit, progress, say
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.deform.quality import Report
    from vitruvian.show.heat import Heat

Unit = typer.Option(
    None,
    "--unit",
    help="With --against of that surface (default: what brings both to one size), with --motion and --markers of the "
    "capture: mm, cm, m, in, dm, ft.",
)


def _shown(file: str) -> Any:
    """A file as something to look at: a clip with the animation the file brings, or a mesh."""
    from vitruvian.body.pack import pack
    from vitruvian.cli.captured import named as _loaded
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.motion.tracks import motion_of
    from vitruvian.motion.types import Motion
    from vitruvian.stage.clip import Clip, Mesh

    thing = _loaded(file)
    if isinstance(thing, Motion):  # shown on the built-in person
        from vitruvian.modeling.person import person
        from vitruvian.motion.retarget import retarget

        humanoid = person()
        body = pack(humanoid)
        return Clip(humanoid, body, retarget(thing, body.skeleton))
    if isinstance(thing, Humanoid):
        body = pack(thing)
        return Clip(thing, body, motion_of(thing, body.skeleton))
    if not isinstance(thing, Mesh):
        raise no_joints(file, thing)
    return thing


@app.command(
    epilog="Example: vitruvian view walking.x3d, or vitruvian view body.x3d --motion walk.bvh --source, or "
    "vitruvian view body.x3d --markers walk.c3d, or vitruvian view posed.x3d --against scan.obj"
)
def view(
    files: list[str] = typer.Argument(
        ..., help="H-Anim, glTF, VRM, USD, BVH, AMC, npz or OBJ files, or the word person."
    ),
    no_open: bool = typer.Option(False, "--no-open", help="Print the address without opening a browser."),
    compare: bool = typer.Option(
        False, "--compare", help="Slice the first figure into contours too, so that the page can compare with them."
    ),
    landmarks: Path | None = typer.Option(
        None, help="JSON of feature points on the scan: read when it is there, saved by the page's panel."
    ),
    weights: Path | None = typer.Option(
        None, help="CSV or npz of the first body's skin weights: read when it is there, saved by the page's panel."
    ),
    against: Path | None = typer.Option(
        None, "--against", metavar="SCAN", help="Colour the first file by its distance from this surface."
    ),
    unit: str | None = Unit,
    motion: Path | None = typer.Option(
        None,
        "--motion",
        metavar="CLIP",
        help="Let the first body do this clip: BVH, AMC, npz, VRMA or an animated body.",
    ),
    source: bool = typer.Option(
        False, "--source", help="Show the clip's own skeleton beside the body: balls and sticks, at the same time."
    ),
    markers: Path | None = typer.Option(
        None, "--markers", metavar="TRC|C3D", help="Move the first body by these markers, and draw them on it."
    ),
    actor: str | None = Actor,
    as_json: bool = Json,
) -> None:
    """Show files in the browser, until Ctrl-C. The page lists what the doctor finds in them, open when there are errors.

    With --against, what a person is compared with has to be in the same place and pose: `vitruvian fit --pose-out` writes
    a fitted person in the pose of its scan. With --markers the body is shown in the performer's proportions, each marker
    with a line to its place on the body, coloured by its length.
    """
    import sys
    import threading
    from contextlib import suppress

    from vitruvian.cli.captured import moved
    from vitruvian.cli.keeping import keeping
    from vitruvian.formats import registry
    from vitruvian.show.live import show

    if motion is not None or source or markers is not None:
        shown = [
            *moved(files[0], motion, source, markers, None if against else unit, actor),
            *(_shown(f) for f in files[1:]),
        ]
    else:
        shown = [_shown(f) for f in files]
    things, kept = keeping(shown, landmarks, weights)
    if against is not None:
        from vitruvian.cli.nearness import heated

        warm = heated(things[0], files[0], _shown(str(against)), str(against), unit, None)
        things[:1] = [warm, warm.other]
    elif unit is not None and motion is None and markers is None:
        raise VitruvianError("--unit: goes with --against, --motion and --markers")
    scenes = [f for f in files if registry.kind(f) in registry.SCENES]
    findings = [finding for f in scenes for finding in registry.check(f)]
    window = show(*things, open_browser=not no_open, block=False, findings=findings, compare=compare, keeping=kept)
    assert window is not None
    with window, suppress(KeyboardInterrupt):
        emit({"address": window.url}, f"{window.url}  (Ctrl-C ends it)", as_json)
        sys.stdout.flush()
        threading.Event().wait()


@app.command(
    epilog="Example: vitruvian render body.x3d -o front.png --view front, or "
    "vitruvian render body.x3d --compare linear,log,volume -o sheet.png, or "
    "vitruvian render posed.x3d --against scan.obj -o heat.png"
)
def render(
    file: str = typer.Argument(
        ..., help="H-Anim, glTF, VRM, USD, BVH, AMC, npz or OBJ file; with --compare also the word person."
    ),
    out: Path = Out,
    view: str = typer.Option("three-quarter", help="front, side, back, three-quarter, face, hands, or a _view Site."),
    time: float = typer.Option(0.0, help="Seconds into the motion."),
    compare: str | None = typer.Option(
        None,
        "--compare",
        metavar="NAMES",
        help="One pose under these deformers side by side, such as linear,log,volume,contours.",
    ),
    pose: str | None = typer.Option(
        None,
        "--pose",
        help="The pose to compare: JSON {joint: [x, y, z, angle]} or its file (default: one that is hard).",
    ),
    stripes: bool = typer.Option(
        True, "--stripes/--no-stripes", help="With --compare: stripe the skin, so that seams that slip show."
    ),
    against: Path | None = typer.Option(
        None,
        "--against",
        metavar="SCAN",
        help="Colour it by its distance from this surface, with a colour bar, a histogram and figures of each part.",
    ),
    reach: float | None = typer.Option(
        None, "--range", min=0.01, max=1000.0, help="With --against: mm at the ends of the colour bar."
    ),
    unit: str | None = Unit,
    as_json: bool = Json,
) -> None:
    """Draw a picture (.png) or film (.mp4 .gif .webp) without a screen.

    With --compare the picture has a column for each deformer, and says what it does to volume, sections, bulge, folds and
    seams; --json prints these numbers.
    """
    if against is not None:
        if compare is not None or pose is not None or time:
            raise VitruvianError("--against: goes with --view, --range and --unit only")
        from vitruvian.cli.nearness import map_of

        warm = heated_of(file, against, unit, reach)
        map_of(warm, out, None if view == "three-quarter" else view, as_json)
        return
    if reach is not None or unit is not None:
        raise VitruvianError("--range and --unit: go with --against")
    if compare is not None:
        if time:
            raise VitruvianError("--time: a comparison shows one pose, without motion; give it by --pose")
        _compare(file, out, [n.strip() for n in compare.split(",") if n.strip()], pose, view, stripes, as_json)
        return
    if pose is not None:
        raise VitruvianError("--pose: goes with --compare; `vitruvian pose` writes a posed file")
    from vitruvian.stage.clip import Clip

    thing = _shown(file)
    kind = out.suffix.lower()
    if kind == ".png":
        from vitruvian.show.picture import picture

        picture(thing, out, view=view, time=time)
    elif kind in (".mp4", ".gif", ".webp"):
        from vitruvian.show.film import film

        if not isinstance(thing, Clip) or thing.motion is None:
            raise VitruvianError(f"{file}: a film needs a motion, found none; write a .png instead")
        with progress("film") as update:
            film(thing, out, view=view, progress=update)
    else:
        raise VitruvianError(f"{out}: expected .png, .mp4, .gif or .webp")
    emit({"files": [str(out)]}, f"wrote {out}", as_json)


def heated_of(file: str, against: Path, unit: str | None, reach: float | None) -> Heat:
    """The map of one file against another."""
    from vitruvian.cli.nearness import heated

    return heated(_shown(file), file, _shown(str(against)), str(against), unit, reach)


def _compare(file: str, out: Path, names: list[str], pose: str | None, view: str, stripes: bool, as_json: bool) -> None:
    """A pose under several deformers: a sheet, and its numbers."""
    from vitruvian.cli.files import pose_of
    from vitruvian.cli.people import subject
    from vitruvian.show.comparison import compare

    if file == "person" and not Path(file).is_file():
        from vitruvian.modeling.person import person

        humanoid = person(outfit=None)  # nothing that hides the surface
    else:
        humanoid = subject(file)
    chosen = pose_of(pose, "--pose") if pose else None
    reports = compare(humanoid, out, deformers=names, pose=chosen, view=view, stripes=stripes)
    document = {"files": [str(out)], "deformers": {name: r.document() for name, r in reports.items()}}
    emit(document, "\n".join([f"wrote {out}", *_table(reports)]), as_json)


def _table(reports: Mapping[str, Report]) -> list[str]:
    """The numbers of a comparison as lines of text: a block for the whole figure and for each joint."""
    from dataclasses import asdict

    first = next(iter(reports.values()))
    fields = list(asdict(first.whole))
    lines = []
    for joint in ["", *first.joints]:
        lines.append(f"{joint or 'whole figure':<22}" + "".join(f"{f if f != 'gap' else 'gap_mm':>11}" for f in fields))
        for name, report in reports.items():
            found = report.whole if not joint else report.joints.get(joint)
            if found is not None:
                row = asdict(found) | {"gap": round(found.gap * 1000, 3)}
                lines.append(f"  {name:<20}" + "".join(f"{row[f]:>11.4g}" for f in fields))
    return lines


@app.command(epilog="Example: vitruvian bench skin kinematics")
def bench(
    names: list[str] | None = typer.Argument(
        None, help="Which: skin fit hands kinematics drag files live marks scenes stage transfer (default: all)."
    ),
    quick: bool = typer.Option(False, "--quick", help="Fewer repetitions."),
    as_json: bool = Json,
) -> None:
    """Measure this package against peers in one run and print ratios. Run it in a checkout of the project."""
    import os
    import platform
    import sys
    from importlib.util import module_from_spec, spec_from_file_location

    folder = Path.cwd() / "benchmarks"
    known = sorted(p.stem for p in folder.glob("[a-z]*.py"))
    if not known:
        raise VitruvianError(f"{folder}: no benchmarks here; run this in a checkout of the project")
    sys.path.insert(0, str(folder))  # benchmarks share pieces
    rows: list[dict[str, Any]] = []
    for name in names or known:
        if name not in known:
            raise VitruvianError(f"bench: {name} is not one of {', '.join(known)}")
        say(f"measuring {name} ...")
        spec = spec_from_file_location(f"benchmarks_{name}", folder / f"{name}.py")
        assert spec and spec.loader
        module = sys.modules[spec.name] = module_from_spec(spec)  # dataclasses look their module up
        spec.loader.exec_module(module)
        found = module.rows(quick=quick)
        rows += found
        if not as_json:
            print("\n".join(map(benchmark_line, found)), flush=True)  # at once: the next one may take minutes
    machine = {
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "system": platform.system(),
    }
    if as_json:
        emit({"machine": machine, "rows": rows}, "", True)


def benchmark_line(row: dict[str, Any]) -> str:
    """One row of a benchmark as a line of text."""

    def seconds(value: float | None) -> str:
        return "-" if value is None else f"{value * 1000:.4g} ms"

    verdict = "holds" if row["holds"] else "MISSED"
    return (
        f"{row['name']:<48} {seconds(row['ours_s']):>12}  {row['peer'] or '-':<24} {seconds(row['peer_s']):>12}  "
        f"{'-' if row['ratio'] is None else row['ratio']:>10}  {row['goal']:<10} {verdict}"
    )
