"""Commands about files: info, check, convert, pose."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli import app
from vitruvian.cli.output import Json, Repair, count, emit, say
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.hanim.humanoid import Humanoid


def _humanoid_facts(h: Humanoid) -> dict[str, Any]:
    segments = h.segments()
    if len(h.skin_coord):
        vertices, triangles = len(h.skin_coord), sum(len(s.triangles) for s in h.skin)
    else:
        shapes = [s for g in segments for s in g.shapes]
        vertices = sum(0 if s.points is None else len(s.points) for s in shapes)
        triangles = sum(len(s.triangles) for s in shapes)
    return {
        "name": h.name,
        "version": h.version,
        "loa": h.loa,
        "joints": len(h.joints()),
        "segments": len(segments),
        "sites": len({id(s) for s in [*h.all_sites(), *h.viewpoints]}),
        "displacers": len(h.displacers()),
        "motions": len(h.motions) + len({t.timer for t in h.tracks}),
        "clips": _clips(h),
        "vertices": vertices,
        "triangles": triangles,
    }


def _clips(h: Humanoid) -> list[dict[str, Any]]:
    if not h.motions and not h.tracks:
        return []
    from vitruvian.motion.tracks import clip_names

    return [{"name": name, "seconds": round(seconds, 3)} for name, seconds in clip_names(h).items()]


def _self_facts() -> dict[str, Any]:
    import platform
    from importlib.util import find_spec

    import numpy

    from vitruvian import __version__
    from vitruvian.native import variant

    extras = {"film": "av", "usd": "pxr"}
    return {
        "version": __version__,
        "kernels": variant(),
        "python": platform.python_version(),
        "numpy": numpy.__version__,
        "extras": {name: find_spec(module) is not None for name, module in extras.items()},
    }


@app.command(epilog="Example: vitruvian info body.x3d")
def info(
    file: Path | None = typer.Argument(None, help="X3D, VRML, BVH or OBJ file."),
    about_self: bool = typer.Option(False, "--self", help="Say what this installation has instead."),
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Say what is in a file."""
    if about_self:
        facts = _self_facts()
        emit(facts, "\n".join(f"{k}: {v}" for k, v in facts.items()), as_json)
        return
    if file is None:
        raise VitruvianError("info: expected a file (or --self)")
    from vitruvian.formats import registry

    form = registry.extension(file)
    document: dict[str, Any] = {"format": form.lstrip(".")}
    if form in registry.SCENES:
        document["humanoids"] = [_humanoid_facts(h) for h in registry.humanoids(file, repair=repair)]
        lines = [
            f"{h['name'] or '(no name)'}: H-Anim {h['version']}, LOA {h['loa']}, {count(h['joints'], 'joint')}, "
            f"{count(h['segments'], 'segment')}, {count(h['sites'], 'site')}, {count(h['displacers'], 'displacer')}, "
            f"{count(h['motions'], 'motion')}, {h['vertices']:,} vertices, {count(h['triangles'], 'triangle')}"
            + "".join(f"\n  clip {c['name']}: {c['seconds']:g} s" for c in h["clips"])
            for h in document["humanoids"]
        ] or ["no humanoid in this file"]
    else:
        thing = registry.load(file)
        if hasattr(thing, "fps"):
            facts = {
                "joints": len(thing.skeleton),
                "frames": len(thing),
                "fps": thing.fps,
                "seconds": thing.seconds,
            }
            document["motion"] = facts
            lines = [f"motion: {facts['joints']} joints, {facts['frames']:,} frames at {facts['fps']:g} per second"]
        else:
            facts = {"vertices": len(thing.vertices), "triangles": len(thing.triangles), "unit": thing.unit}
            document["mesh"] = facts
            lines = [f"mesh: {facts['vertices']:,} vertices, {count(facts['triangles'], 'triangle')}"]
    emit(document, "\n".join(lines), as_json)


@app.command(epilog="Example: vitruvian check body.x3d")
def check(
    files: list[Path] = typer.Argument(..., help="X3D or VRML files."),
    out: Path | None = typer.Option(None, "--fix", help="Repair what has one right repair and write it here."),
    as_json: bool = Json,
) -> None:
    """Say what is wrong in H-Anim files, where, and what to do about it. Exit status 1 when there are errors.

    With --fix the answer is about the repaired file.
    """
    from dataclasses import asdict

    from vitruvian.formats.registry import check as examine
    from vitruvian.formats.registry import fix

    if out is not None:
        if len(files) != 1:
            raise VitruvianError(f"--fix: expected one file to repair, found {len(files)}")
        for line in fix(files[0], out):
            say(line)
        files = [out]
    documents, lines = [], []
    for file in files:
        findings = examine(file)
        ok = not any(f.severity == "error" for f in findings)
        documents.append({"file": str(file), "ok": ok, "findings": [asdict(f) for f in findings]})
        tally = {s: sum(f.severity == s for f in findings) for s in ("error", "warning", "note")}
        lines.append(f"{file}: " + (", ".join(count(n, s) for s, n in tally.items() if n) or "nothing to say"))
        for f in findings:
            where = f"{file}:{f.line}" if f.line else str(file)
            lines.append(f"  {where}: {f.severity} {f.rule} {f.where}: {f.message}" + (f" ({f.fix})" if f.fix else ""))
    emit(documents, "\n".join(lines), as_json)
    if not all(d["ok"] for d in documents):
        raise typer.Exit(1)


@app.command(epilog="Example: vitruvian convert body.wrl body.glb")
def convert(
    source: Path = typer.Argument(..., metavar="IN", help="File to read."),
    target: Path = typer.Argument(..., metavar="OUT", help="File to write; its extension says the format."),
    hanim: str | None = typer.Option(None, "--hanim", help="H-Anim version of scene files: 1.1, 200x or 2.0."),
    loa: int | None = typer.Option(None, min=0, max=4, help="Fold joints above this level of articulation."),
    name: str | None = typer.Option(None, help="Which humanoid, when the file holds several (scenes: all of them)."),
    clip: str | None = typer.Option(None, help="Which clip of an H-Anim file goes to .bvh, .glb; `info` lists them."),
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Convert any readable file to any writable format, and say what was lost."""
    from vitruvian.formats import registry

    if hanim not in (None, "1.1", "200x", "2.0"):
        raise VitruvianError(f"--hanim: expected 1.1, 200x or 2.0, found {hanim}")
    several = name is None and loa is None and {registry.extension(p) for p in (source, target)} <= set(registry.SCENES)
    found = registry.humanoids(source, repair=repair) if several else []  # a scene takes all the figures of a scene
    thing = found or registry.load(source, name=name, repair=repair)
    lost: list[str] = []
    if loa is not None:
        from vitruvian.hanim.convert import VERSIONS, converted
        from vitruvian.hanim.humanoid import Humanoid

        if not isinstance(thing, Humanoid):
            raise VitruvianError(f"--loa: expected an H-Anim body, found a {type(thing).__name__.lower()}")
        version = hanim or (thing.version if thing.version in VERSIONS else "2.0")
        thing, lost = converted(thing, version, loa=loa)
    report = registry.save(thing, target, hanim=hanim, clip=clip)
    report["lost"] = lost + report["lost"]
    text = f"wrote {target}"
    if report["pruned_weights"]:
        text += (
            f"\n{count(report['pruned_weights'], 'vertex')} had more than four influences: "
            f"at most {report['max_vertex_error_m'] * 1000:.2f} mm off"
        ).replace("vertexs", "vertices")
    emit(report, "\n".join([text, *(f"lost: {line}" for line in report["lost"])]), as_json)


def pose_of(text: str, option: str = "--joints") -> dict[str, list[float]]:
    """Joint rotations from JSON text or from a JSON file."""
    path = Path(text)
    try:
        source = path.read_text() if not text.lstrip().startswith("{") else text
        pose = json.loads(source)
    except (OSError, ValueError) as e:
        raise VitruvianError(f'{option}: expected JSON such as {{"l_knee": [1, 0, 0, 0.8]}} or its file; {e}') from e
    if not isinstance(pose, dict):
        raise VitruvianError(f"{option}: expected an object of joint names")
    for joint, value in pose.items():
        numbers = isinstance(value, list) and len(value) == 4 and all(isinstance(v, int | float) for v in value)
        if not numbers:
            raise VitruvianError(f"{option}: {joint}: expected [x, y, z, angle in radians], found {json.dumps(value)}")
    return pose


@app.command(epilog="Example: vitruvian pose body.x3d --joints '{\"l_knee\": [1, 0, 0, 0.8]}' -o kneeling.glb")
def pose(
    file: Path = typer.Argument(..., help="H-Anim file."),
    joints: str = typer.Option(..., "--joints", help="JSON {joint: [x, y, z, angle]}, or a file that holds it."),
    matrices: Path | None = typer.Option(None, "--matrices", help="Write the joint matrices here (JSON, row-major)."),
    out: Path | None = typer.Option(None, "-o", "--out", help="Write the posed humanoid here."),
    name: str | None = typer.Option(None, help="Which humanoid, when the file holds several."),
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Pose joints and write the joint matrices, the posed humanoid, or both."""
    import numpy as np

    from vitruvian.body.kinematics import joint_matrices
    from vitruvian.body.pack import pack
    from vitruvian.formats import registry
    from vitruvian.formats.atomic import atomic

    humanoid = registry.load(file, name=name, repair=repair)
    known = {j.name: j for j in humanoid.joints()}
    for joint, value in pose_of(joints).items():
        if joint not in known:
            raise VitruvianError(f"--joints: {joint} is not a joint of {file}; it has {', '.join(list(known)[:8])} ...")
        known[joint].rotation = np.array(value, dtype=np.float64)
    skeleton = pack(humanoid).skeleton
    poses = joint_matrices(skeleton)[0]
    document = {name: poses[i].tolist() for i, name in enumerate(skeleton.names)}
    written = []
    if matrices is not None:
        with atomic(matrices) as temporary:
            temporary.write_text(json.dumps(document))
        written.append(str(matrices))
    if out is not None:
        humanoid.tracks, humanoid.motions = [], []
        registry.save(humanoid, out)
        written.append(str(out))
    text = f"wrote {', '.join(written)}" if written else json.dumps(document)
    emit({"joints": len(document), "files": written} if written else document, text, as_json)
