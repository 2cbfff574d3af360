"""Commands that make people from scans: fit."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli import app
from vitruvian.cli.output import Json, emit, progress, say
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.modeling.fit import Fit
    from vitruvian.stage.clip import Mesh


REPORTS = (".png", ".html", ".json")


@app.command(epilog="Example: vitruvian fit scan.obj --landmarks scan.json -o anna.x3d --report heat.png")
def fit(
    scans: list[Path] = typer.Argument(..., metavar="SCAN...", help="OBJ, PLY, STL or glTF files."),
    out: Path = typer.Option(..., "-o", "--out", help="File to write; with several scans a folder."),
    landmarks: Path | None = typer.Option(
        None,
        "--landmarks",
        help='JSON {"feature point": [x, y, z]} in the scan\'s own unit and axes; with several scans a folder that has '
        "NAME.json for NAME.obj. Default: SCAN.json beside a scan, else they are looked for on an upright scan.",
    ),
    unit: str | None = typer.Option(None, "--unit", help="mm, cm, m, in, dm or ft (default: by the person's size)."),
    template: str | None = typer.Option(
        None, "--template", help="A skinned body to fit instead of the built-in person."
    ),
    form: str = typer.Option("x3d", "--form", help="With several scans: extension of the files to write."),
    pose_out: Path | None = typer.Option(None, "--pose-out", help="File for the person in the scan's pose, or .bvh."),
    detail: Path | None = typer.Option(
        None, "--detail", help="PNG for what the scan has and the body lacks; `offsets apply` puts it on."
    ),
    report: Path | None = typer.Option(
        None,
        "--report",
        help="Map of the distances between person and scan: .png, .html (to turn and switch) or .json.",
    ),
    hair: str | None = typer.Option(None, help="short, bob, bun or none (default: by sex and age)."),
    outfit: str | None = typer.Option(
        None, help='"t-shirt and shorts", ... (default: a body suit painted on the skin).'
    ),
    loa: int = typer.Option(4, min=0, max=4, help="Level of articulation."),
    as_json: bool = Json,
) -> None:
    """Make an animatable person from a scan and landmarks, in the standard rest pose.

    Several scans are a batch: one that fails does not stop the others.
    """
    from vitruvian.cli.people import subject

    if report is not None and report.suffix.lower() not in REPORTS:
        raise VitruvianError(f"--report {report}: expected {', '.join(REPORTS)}")
    body = subject(template) if template else None
    look = {k: v for k, v in {"hair": hair, "outfit": outfit}.items() if v is not None}
    options: dict[str, Any] = {"unit": unit, "template": body, "loa": loa, **look}
    if len(scans) == 1 and not out.is_dir():
        marks = landmarks or _beside(scans[0], None)
        document, text = _one(scans[0], marks, out, pose_out, options, detail, report)
        emit(document, text, as_json)
        return
    for option, given in (("--pose-out", pose_out), ("--detail", detail), ("--report", report)):
        if given is not None:
            raise VitruvianError(f"{option}: expected one scan, found several")
    out.mkdir(parents=True, exist_ok=True)
    documents, lines, failed = [], [], 0
    for scan in scans:
        target = out / f"{scan.stem}.{form.lstrip('.')}"
        try:
            document, text = _one(scan, _beside(scan, landmarks), target, None, options, None)
        except (VitruvianError, OSError) as error:
            failed += 1
            document, text = {"scan": str(scan), "error": str(error)}, f"failed {scan}: {error}"
            say(f"warning: {scan} failed: {error}")
        documents.append(document)
        lines.append(text)
    emit(documents, "\n".join(lines), as_json)
    if failed:
        raise typer.Exit(1)


def _beside(scan: Path, folder: Path | None) -> Path | None:
    """The landmarks of a scan: a file of its name in the folder, or beside it."""
    if folder is not None and not folder.is_dir():
        return folder
    name = (folder or scan.parent) / f"{scan.stem}.json"
    if folder is not None or name.is_file():
        return name
    return None


def _one(
    scan: Path,
    marks: Path | None,
    out: Path,
    pose_out: Path | None,
    options: dict[str, Any],
    detail: Path | None = None,
    map_out: Path | None = None,
) -> tuple[dict[str, Any], str]:
    """Fit one scan, write what is wanted, answer the document and its text."""
    from vitruvian.cli import blending
    from vitruvian.formats.registry import load, save
    from vitruvian.modeling import offsets
    from vitruvian.modeling.fit import fit as fitted
    from vitruvian.modeling.landmarks import read
    from vitruvian.stage.clip import Mesh

    start = time.perf_counter()
    if detail is not None:
        blending.png(detail)
    mesh = load(scan)
    if not isinstance(mesh, Mesh):
        mesh = _surface(mesh, scan)
    places = None if marks is None else read(marks)
    with progress(f"fit {scan.name}") as update:
        found = fitted(mesh, places, name=scan.stem, progress=update, **options)
    save(found.humanoid, out)
    if pose_out is not None:
        _write_pose(found, pose_out)
    relief = None if detail is None else blending.picture(found.humanoid, offsets.detail(found), detail)
    if map_out is not None:
        _write_map(found, mesh, scan, map_out)
    report = found.report
    near = report["scan_to_fit"]
    document = {
        "scan": str(scan),
        "mean_mm": near["mean"],
        "p95_mm": near["p95"],
        "joints": report["joints"],
        "warnings": report["warnings"],
        "seconds": time.perf_counter() - start,
        "report": {k: v for k, v in report.items() if k not in ("joints", "warnings")},
        "shape": None if found.shape is None else vars(found.shape),
    } | ({} if relief is None else {"detail": relief})
    worst = max(report["landmarks"], key=lambda n: report["landmarks"][n])
    text = (
        f"wrote {out}: scan to body {near['mean']:.2f} mm in the mean, 95 % within {near['p95']:.2f} mm; "
        f"{report['unmatched']:.0%} of the skin without scan; {report['folds']} folds; {document['seconds']:.1f} s\n"
        f"  landmark farthest off: {worst}, {report['landmarks'][worst]:.0f} mm"
    )
    if relief is not None:
        text += f"\nwrote {detail}: {blending.said(relief)}"
    return document, text


def _surface(thing: object, scan: Path) -> Any:
    """The skin of a humanoid, as glTF readers give it, as a scan."""
    from vitruvian.body.kinematics import joint_matrices
    from vitruvian.body.pack import pack
    from vitruvian.deform.deformer import deformer
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.stage.clip import Mesh

    if not isinstance(thing, Humanoid):
        raise VitruvianError(f"{scan}: expected a surface, found a {type(thing).__name__.lower()}")
    body = pack(thing)
    points = deformer("linear", body)(joint_matrices(body.skeleton))[0]
    return Mesh(points.astype("float64"), body.skin.triangles)


def _write_pose(found: Fit, out: Path) -> None:
    """The person in the scan's pose, as a clip of one frame."""
    from vitruvian.body.pack import pack
    from vitruvian.cli.people import write
    from vitruvian.stage.clip import Clip

    humanoid: Humanoid = found.humanoid
    write(Clip(humanoid, pack(humanoid), found.pose), out)


def _write_map(found: Fit, mesh: Mesh, scan: Path, out: Path) -> None:
    """How far the person is from the scan, in the scan's pose."""
    from vitruvian.body.pack import pack
    from vitruvian.cli.nearness import write_map
    from vitruvian.show.heat import heat
    from vitruvian.stage.clip import Clip

    clip = Clip(found.humanoid, pack(found.humanoid), found.pose)
    write_map(heat(clip, mesh, unit=found.report["unit"], name=scan.stem, against="scan"), out)
