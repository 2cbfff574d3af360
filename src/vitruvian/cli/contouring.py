"""Command about contour bodies: contours."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli import app
from vitruvian.cli.files import with_hands
from vitruvian.cli.output import Hands, Json, Out, Repair, count, emit
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.body.types import Body
    from vitruvian.hanim.humanoid import Humanoid


@app.command(epilog="Example: vitruvian contours body.x3d -o contours.wrl --live")
def contours(
    source: str = typer.Argument(..., metavar="IN", help="H-Anim, glTF, VRM or USD body, or the word person."),
    out: Path = Out,
    live: bool = typer.Option(False, "--live", help="Add a script that deforms the body in any X3D or VRML97 browser."),
    density: float = typer.Option(1.0, min=0.25, max=4, help="More (2: twice) or fewer contours and points in each."),
    mitre: float = typer.Option(0.25, min=0, max=1, help="How much of the thickness of bends is kept."),
    diversion: float = typer.Option(0.0, min=0, max=1, help="How far contours that swing aside are taken back."),
    recentre: bool = typer.Option(
        False, "--recentre", help="Contours of a bend keep their distances from the bone instead of swinging aside."
    ),
    ramp: str = typer.Option("linear", help="How the turn grows over the contours of a bend: linear or smoothstep."),
    tilt: float | None = typer.Option(
        None,
        min=0,
        max=1,
        help="How far contours fan at rest about the axes of knees and elbows; 1: evenly apart when bent by 90 degrees "
        "(default: as IN says if it has contours, else 0).",
    ),
    change: list[str] = typer.Option(
        [],
        "--set",
        metavar="SURFACE.PARAMETER=VALUE",
        help="Another parameter: l_thigh_def.lower=4 contours, l_thigh_def.lower=80mm, l_thigh_def.mitre=0.5, and so "
        "bulge, diversion, recentre (0 or 1), ramp, tilt, upper, fixed_upper, extra. Repeatable.",
    ),
    report: bool = typer.Option(
        False, "--report", help="Say what hard poses do to it, and how each Segment's surface can be organised."
    ),
    organise: str = typer.Option(
        "",
        metavar="MODE",
        help="Instead of slicing: put each Segment's own surface in contours, by reorder (its points as they are), "
        "resample (its shape a little changed) or auto, and write those that can be.",
    ),
    skin: int = typer.Option(2000, help="--live: points of head, hands, feet and clothes together; 0 keeps them all."),
    fingers: bool = typer.Option(False, "--fingers", help="--live: fingers and toes bend."),
    pointers: str = typer.Option("routes", help="--live: what leaves the script by: routes, human, nodes."),
    schemes: str = typer.Option("", help="--live: javascript, ecmascript, vrmlscript: copies of the script, in order."),
    hands: Path | None = Hands,
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Turn a body into contour surfaces: limbs, torso and neck in loops that turn by shares of the joints' rotations."""
    from vitruvian.cli.people import subject
    from vitruvian.formats import registry
    from vitruvian.modeling.contours import TILTED, contoured
    from vitruvian.modeling.fans import tilts
    from vitruvian.modeling.organising import segments
    from vitruvian.modeling.trials import trials
    from vitruvian.modeling.tuning import tuned

    form = registry.extension(out)
    if live and form not in registry.SCENES and form != ".json":
        raise VitruvianError(f"--live: expected a scene file to write (.x3d, .x3dv, .x3dj, .wrl), found {out}")
    chosen = tuple(s.strip() for s in schemes.split(",") if s.strip())
    if live:
        from vitruvian.formats.live import known

        known(pointers, chosen)
    humanoid = subject(source, repair=repair)
    if organise:
        _organised(humanoid, out, organise, as_json, live)
        return
    changes = _changes(change)
    fans = {name: float(values.pop("tilt")) for name, values in changes.items() if "tilt" in values}
    if fans:
        fans = tilts(humanoid, tilt, list(TILTED)) | fans
    made = contoured(
        humanoid, density=density, mitre=mitre, diversion=diversion, recentre=recentre, ramp=ramp, tilt=fans or tilt
    )
    tuned(made.humanoid, changes)
    if hands is not None:
        with_hands(made.humanoid, hands)
    unit = 1000 / (made.scale if not 1 / 3 < made.scale < 3 else 1)  # of figures in inches: as on a person
    surfaces = [c for s in made.humanoid.segments() for c in s.contours]
    document: dict[str, Any] = {
        "surfaces": len(surfaces),
        "contours": sum(len(c.points) for c in surfaces),
        "points": sum(c.points.shape[0] * c.points.shape[1] for c in surfaces),
        "shape_error_mm": round(made.error[0] * unit, 3),
        "shape_error_max_mm": round(made.error[1] * unit, 3),
    }
    more: list[str] = []
    if report:
        tried, organised = trials(made.humanoid), segments(humanoid)
        document |= {"poses": [t.document() for t in tried], "segments": [s.document() for s in organised]}
        more = [
            f"{t.pose:<22} gap {t.gap:g} m, volume {t.volume:.3f}, {count(t.folds, 'fold')}, stretch {t.stretch:.2f}"
            for t in tried
        ]
        more += [f"{s.segment}: {s.mode or 'not organised'}{': ' + s.message if s.message else ''}" for s in organised]
    if live:
        document |= _write_live(made.humanoid, out, skin, fingers, pointers, chosen)
    else:
        document["lost"] = registry.save(made.humanoid, out)["lost"]
    document["file_bytes"] = out.stat().st_size
    lines = [
        f"wrote {out}: {count(document['surfaces'], 'surface')}, {count(document['contours'], 'contour')}, "
        f"{count(document['points'], 'point')}, {document['shape_error_mm']:.2f} mm off in the mean"
    ]
    if live:
        lines.append(
            f"live: {count(document['live']['soft_points'], 'more point')} moved by the script and "
            f"{document['live']['rigid_points']} that ride on joints; file {document['file_bytes'] / 1000:.0f} kB, "
            f"{document['file_gzip_bytes'] / 1000:.0f} kB packed; script {document['script_bytes'] / 1000:.0f} kB, "
            f"{document['live']['script_gzip_bytes'] / 1000:.0f} kB packed; "
            f"here a pose takes {document['pose_ms']:.2f} ms"
        )
    emit(document, "\n".join([*lines, *more, *(f"lost: {line}" for line in document["lost"])]), as_json)


def _organised(humanoid: Humanoid, out: Path, mode: str, as_json: bool, live: bool) -> None:
    from vitruvian.formats import registry
    from vitruvian.modeling.organising import rearranged

    modes = ("auto", "reorder", "resample")
    if mode not in modes or live:
        raise VitruvianError(f"--organise: expected {', '.join(modes)}, and not --live, found {mode!r}")
    made, reports = rearranged(humanoid, mode=mode)
    surfaces = [c for s in made.segments() for c in s.contours]
    document: dict[str, Any] = {
        "surfaces": len(surfaces),
        "contours": sum(len(c.points) for c in surfaces),
        "points": sum(c.points.shape[0] * c.points.shape[1] for c in surfaces),
        "shape_error_mm": round(1000 * max((r.error[0] for r in reports), default=0.0), 3),
        "segments": [r.document() for r in reports],
        "lost": registry.save(made, out)["lost"],
    }
    lines = [f"wrote {out}: {count(len(surfaces), 'Segment surface')} in contours of {len(reports)}"]
    lines += [f"{r.segment}: {r.mode or 'as it was'}{': ' + r.message if r.message else ''}" for r in reports]
    emit(document, "\n".join(lines), as_json)


def _changes(options: list[str]) -> dict[str, dict[str, float | str]]:
    """SURFACE.PARAMETER=VALUE options; a value with mm, cm or m is a length, a whole number a number of contours; a
    ramp is a word."""
    out: dict[str, dict[str, float | str]] = {}
    units = {"mm": 0.001, "cm": 0.01, "m": 1.0}
    for option in options:
        if word := re.fullmatch(r"(\w+)\.ramp=(\w+)", option.strip()):
            out.setdefault(word[1], {})["ramp"] = word[2]
            continue
        found = re.fullmatch(r"(\w+)\.(\w+)=([0-9.]+)(mm|cm|m)?", option.strip())
        try:
            if found is None:
                raise ValueError
            name, field, number, suffix = found.groups()
            value: float = float(number) * units[suffix] if suffix else float(number) if "." in number else int(number)
        except ValueError:
            raise VitruvianError(
                f"--set: expected SURFACE.PARAMETER=VALUE, such as l_thigh_def.lower=80mm, found {option!r}"
            ) from None
        out.setdefault(name, {})[field] = value
    return out


def _write_live(
    humanoid: Humanoid, out: Path, skin: int, fingers: bool, pointers: str, schemes: tuple[str, ...]
) -> dict[str, Any]:
    import gzip

    from vitruvian.formats import registry
    from vitruvian.formats.live import live_scene
    from vitruvian.formats.pictures import Addresses
    from vitruvian.modeling.lighter import lightened

    form = registry.extension(out)
    shown = lightened(humanoid, skin, fingers=fingers) if skin else humanoid
    encoding = "x3dj" if form == ".json" else form[1:]
    addresses = Addresses(out, beside=encoding == "wrl")  # VRML97 browsers know no data URIs
    made = live_scene(shown, encoding=encoding, pointers=pointers, schemes=schemes or None, address=addresses)
    addresses.write()
    registry.write_scene(made.scene, out)
    return {
        "lost": made.lost + addresses.lost(),
        "script_bytes": made.report["script_bytes"],
        "file_gzip_bytes": len(gzip.compress(out.read_bytes(), mtime=0)),
        "pose_ms": round(_pose_ms(made.body), 3),
        "live": made.report,
    }


def _pose_ms(body: Body) -> float:
    """How long our own deformer takes for a pose of the same body: the best of some frames, milliseconds."""
    import time

    import numpy as np

    from vitruvian.deform.deformer import deformer

    deform, rest = deformer("contours", body), np.tile(np.eye(4), (len(body.skeleton), 1, 1))
    times = []
    for _ in range(10):
        start = time.perf_counter()
        deform(rest)
        times.append(time.perf_counter() - start)
    return min(times) * 1000
