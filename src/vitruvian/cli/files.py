"""Commands about files: info, check, convert, pose."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli import app
from vitruvian.cli.capture import FACTS, Actor, Fps, Skeleton, Unit, Up, said
from vitruvian.cli.output import Bake, Hands, Json, Repair, Tolerance, WeightFile, baked, baking, count, emit, say
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.hanim.humanoid import Humanoid


def _humanoid_facts(h: Humanoid) -> dict[str, Any]:
    segments = h.segments()
    if h.skin and len(h.skin_coord):
        vertices, triangles = len(h.skin_coord), sum(len(s.triangles) for s in h.skin)
    else:
        shapes = [s for g in segments for s in g.shapes]
        vertices = sum(len(p) for p in {id(s.points): s.points for s in shapes if s.points is not None}.values())
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

    extras = {"film": "av", "patterns": "ezdxf", "usd": "pxr"}
    return {
        "version": __version__,
        "kernels": variant(),
        "python": platform.python_version(),
        "numpy": numpy.__version__,
        "extras": {name: find_spec(module) is not None for name, module in extras.items()},
    }


@app.command(epilog="Example: vitruvian info body.x3d")
def info(
    file: Path | None = typer.Argument(
        None,
        help="X3D (XML, Classic, JSON), VRML, glTF, VRM, USD, BVH, AMC, npz, C3D, TRC, CSM, MOT, OBJ, PLY or STL.",
    ),
    about_self: bool = typer.Option(False, "--self", help="Say what this installation has instead."),
    unit: str | None = Unit,
    up: str | None = Up,
    fps: float | None = Fps,
    actor: str | None = Actor,
    skeleton: Path | None = Skeleton,
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Say what is in a file; of a capture also what was found about its unit, up axis and rate."""
    if about_self:
        facts = _self_facts()
        emit(facts, "\n".join(f"{k}: {v}" for k, v in facts.items()), as_json)
        return
    if file is None:
        raise VitruvianError("info: expected a file (or --self)")
    from vitruvian.formats import registry

    form = registry.kind(file)
    document: dict[str, Any] = {"format": form.lstrip(".").removesuffix(".json")}
    lines = []
    options = said(file, unit, up, fps, actor, skeleton)
    if "actor" in registry.SAYABLE.get(form, ()):
        options.setdefault("actor", "*")  # lists who is there
    found = registry.contents(file, repair=repair, **options)
    figures = [_humanoid_facts(h) for h in found if hasattr(h, "skin_coord")]
    if figures or form in registry.SCENES:
        document["humanoids"] = figures
    lines += [
        f"{h['name'] or '(no name)'}: H-Anim {h['version']}, LOA {h['loa']}, {count(h['joints'], 'joint')}, "
        f"{count(h['segments'], 'segment')}, {count(h['sites'], 'site')}, {count(h['displacers'], 'displacer')}, "
        f"{count(h['motions'], 'motion')}, {h['vertices']:,} vertices, {count(h['triangles'], 'triangle')}"
        + "".join(f"\n  clip {c['name']}: {c['seconds']:g} s" for c in h["clips"])
        for h in figures
    ]
    for thing in found:
        if type(thing).__name__ in FACTS:
            key, describe = FACTS[type(thing).__name__]
            document[key], text = describe(thing)
            lines.append(text)
        elif hasattr(thing, "panels"):
            facts = {"panels": len(thing.panels), "seams": len(thing.seams)}
            document["pattern"] = facts
            lines.append(f"sewing pattern: {count(facts['panels'], 'panel')}, {count(facts['seams'], 'seam')}")
        elif hasattr(thing, "unit"):
            facts = {"vertices": len(thing.vertices), "triangles": len(thing.triangles), "unit": thing.unit}
            document["mesh"] = facts
            lines.append(f"mesh: {facts['vertices']:,} vertices, {count(facts['triangles'], 'triangle')}")
    lines = lines or ["no humanoid in this file"]
    emit(document, "\n".join(lines), as_json)


@app.command(epilog="Example: vitruvian check body.x3d --fix mended.x3d --also S04,P03")
def check(
    files: list[Path] | None = typer.Argument(None, help="X3D (XML, Classic, JSON), VRML, glTF, VRM or USD files."),
    out: Path | None = typer.Option(None, "--fix", help="Repair what has one right repair and write it here."),
    also: str = typer.Option("", help="With --fix: rules to repair as well that are repaired on request only, or all."),
    why: bool = typer.Option(False, "--why", help="Say beside each finding why it matters."),
    schema: bool = typer.Option(False, "--schema", help="Ask the X3D XML schema too (rule F09); half a second more."),
    points: bool = typer.Option(
        False, "--points", help="Say too where the actor's 87 points are not where they should be."
    ),
    place: Path | None = typer.Option(None, "--place", help="Move limb joints into the flesh and write the body here."),
    lock: str = typer.Option("", help="With --place: points that stay, as l_knee,r_knee."),
    rules: bool = typer.Option(False, "--rules", help="List all rules instead: what each finds, why, what to do."),
    as_json: bool = Json,
) -> None:
    """Say what is wrong in H-Anim files, where, and what to do about it. Exit status 1 when there are errors.

    With --fix the answer is about the repaired file. Points are the 71 joints of LOA 2 and 16 ends; rules a to g say
    where they go.
    """
    from dataclasses import asdict

    from vitruvian.formats.registry import check as examine
    from vitruvian.formats.registry import fix
    from vitruvian.hanim.doctor_rules import RULES, SEVERITIES, rules_text

    if rules:
        listed = [asdict(r) | {"severity": SEVERITIES[r.severity]} for r in RULES.values()]
        emit(listed, rules_text(), as_json)
        return
    if not files:
        raise VitruvianError("check: expected files (or --rules)")
    repairs: list[str] = []
    if out is not None:
        if len(files) != 1:
            raise VitruvianError(f"--fix: expected one file to repair, found {len(files)}")
        repairs = fix(files[0], out, also=also.replace(",", " ").split())
        for line in repairs or ["nothing to repair"]:
            say(line)
        files = [out]
    elif also:
        raise VitruvianError("--also: says what --fix repairs; give --fix OUT")
    if place is not None:
        from vitruvian.cli.positions import put_points

        files = [put_points(files, place, lock.replace(",", " ").split())]
    elif lock:
        raise VitruvianError("--lock: says what --place leaves alone; give --place OUT")
    documents, lines = [], []
    for file in files:
        findings = examine(file, schema=schema)
        ok = not any(f.severity == "error" for f in findings)
        document = {"file": str(file), "ok": ok, "findings": [asdict(f) | {"why": f.why} for f in findings]}
        documents.append(document | ({"repairs": repairs} if out is not None else {}))
        tally = {s: sum(f.severity == s for f in findings) for s in SEVERITIES.values()}
        lines.append(f"{file}: " + (", ".join(count(n, s) for s, n in tally.items() if n) or "nothing to say"))
        for f in findings:
            where = f"{file}:{f.line}" if f.line else str(file)
            lines.append(f"  {where}: {f.severity} {f.rule} {f.where}: {f.message}" + (f" ({f.fix})" if f.fix else ""))
            lines += [f"      {f.why}"] if why else []
        if points or place is not None:
            from vitruvian.cli.positions import actor_points

            documents[-1]["actors"], said = actor_points(file)
            lines += said
        more = sorted({f.rule for f in findings if RULES[f.rule].auto in {"opt", "part"}})
        if more and out is not None:
            lines.append(f"  on request: --also {','.join(more)}")
    emit(documents, "\n".join(lines), as_json)
    if not all(d["ok"] for d in documents):
        raise typer.Exit(1)


@app.command(epilog="Example: vitruvian convert body.wrl body.glb")
def convert(
    source: Path = typer.Argument(..., metavar="IN", help="File to read."),
    target: Path = typer.Argument(..., metavar="OUT", help="File to write; its extension says the format."),
    hanim: str | None = typer.Option(None, "--hanim", help="H-Anim version of scene files: 1.1, 200x or 2.0."),
    loa: int | None = typer.Option(
        None, min=0, max=4, help="Level of articulation: joints above it are folded, joints it lacks are added."
    ),
    rest: str | None = typer.Option(None, "--rest", help="standard: re-pose an A or T pose to the standard rest pose."),
    skin: str | None = typer.Option(None, "--skin", help="segments: cut the skin into Segments; seamless: weld them."),
    name: str | None = typer.Option(None, help="Which humanoid, when the file holds several (scenes: all of them)."),
    clip: str | None = typer.Option(None, help="Which clip of an H-Anim file goes to .bvh, .glb; `info` lists them."),
    names: Path | None = typer.Option(None, help='JSON table {"bone": "H-Anim joint"} for the rig of a glTF file.'),
    hands: Path | None = Hands,
    weights: Path | None = WeightFile,
    unit: str | None = Unit,
    up: str | None = Up,
    fps: float | None = Fps,
    actor: str | None = Actor,
    skeleton: Path | None = Skeleton,
    bake: bool = Bake,
    tolerance: float | None = Tolerance,
    repair: bool = Repair,
    as_json: bool = Json,
) -> None:
    """Convert any readable file to any writable format, and say what was lost.

    A body can change its H-Anim version, level of articulation, rest pose and kind of surface on the way; its clips
    follow.

    Reads .x3d .x3dv .x3dj .json .wrl .wrz .glb .gltf .vrm .vrma .bvh .amc (with its .asf) .npz (AMASS) .c3d .trc .csm
    .obj .ply .stl .usd .usda .usdc .usdz; writes .x3d .x3dv .x3dj .json .wrl .glb .vrm .vrma .usd .usda .usdc .usdz .bvh
    .amc .npz .trc .csm .obj. What a capture does not say, --unit, --up and --fps say. USD needs the extra:
    pip install 'vitruvian[usd]'.
    """
    from vitruvian.formats import registry

    if hanim not in (None, "1.1", "200x", "2.0"):
        raise VitruvianError(f"--hanim: expected 1.1, 200x or 2.0, found {hanim}")
    for option, value, choices in (("--rest", rest, ("standard",)), ("--skin", skin, ("segments", "seamless"))):
        if value is not None and value not in choices:
            raise VitruvianError(f"{option}: expected {' or '.join(choices)}, found {value}")
    if names is not None and registry.extension(source) not in registry.FIGURES:
        raise VitruvianError(f"--names: renames the bones of glTF files, {source} is none")
    plain = name is None and loa is None and rest is None and skin is None and hands is None and weights is None
    several = plain and {registry.extension(p) for p in (source, target)} <= set(registry.SCENES)
    found = registry.humanoids(source, repair=repair) if several else []  # a scene takes all the figures of a scene
    options = {} if names is None else {"names": names}
    options |= said(source, unit, up, fps, actor, skeleton)
    thing = found or registry.load(source, name=name, repair=repair, **options)
    lost: list[str] = []
    off = 0.0
    if weights is not None:
        from vitruvian.cli.keeping import with_weights

        with_weights(thing, weights)
    if hands is not None:
        with_hands(thing, hands)
    if loa is not None or rest or skin:
        thing, lost, off = _remade(thing, target, hanim, loa, rest, skin)
    report = registry.save(thing, target, hanim=hanim, clip=clip, **baking(target, bake, tolerance))
    report["lost"] = lost + report["lost"]
    report["max_vertex_error_m"] = max(report["max_vertex_error_m"], off)
    text = f"wrote {target}"
    if report["pruned_weights"]:
        text += (
            f"\n{count(report['pruned_weights'], 'vertex')} had more than four influences: "
            f"at most {report['max_vertex_error_m'] * 1000:.2f} mm off"
        ).replace("vertexs", "vertices")
    emit(report, "\n".join([text, *baked(report), *(f"lost: {line}" for line in report["lost"])]), as_json)


def _remade(
    thing: Any, target: Path, hanim: str | None, loa: int | None, rest: str | None, skin: str | None
) -> tuple[Humanoid, list[str], float]:
    """The body with the level, rest pose and kind of surface that were asked for; what was lost; how far it is off."""
    from vitruvian.formats.registry import extension
    from vitruvian.hanim.humanoid import Humanoid

    if not isinstance(thing, Humanoid):
        what = "--loa" if loa is not None else "--rest" if rest else "--skin"
        raise VitruvianError(f"{what}: expected an H-Anim body, found a {type(thing).__name__.lower()}")
    lost: list[str] = []
    off = 0.0
    if skin == "seamless":
        from vitruvian.hanim.welding import weld

        thing = weld(thing)
    if rest:
        from vitruvian.modeling.standing import standard_pose

        thing, lost = standard_pose(thing)
    version = hanim or ("200x" if extension(target) == ".wrl" else None)
    if loa is not None or version is not None:
        from vitruvian.modeling.levels import at_level

        thing, gone, off = at_level(thing, loa, version=version)
        lost += gone
    if skin == "segments":
        from vitruvian.hanim.segmenting import segment

        thing = segment(thing)
    return thing, lost, off


def with_hands(humanoid: Any, path: Path) -> None:
    """Put the parameters of hands in a JSON file, as pages save them, into a body; those it has of other joints stay."""
    from vitruvian.body.hands import roundings_of, store_roundings, stored_roundings
    from vitruvian.body.pack import pack
    from vitruvian.deform.hand_links import hands_of
    from vitruvian.hanim.humanoid import Humanoid

    if not isinstance(humanoid, Humanoid):
        raise VitruvianError(f"--hands: expected an H-Anim body, found a {type(humanoid).__name__.lower()}")
    try:
        given = roundings_of(json.loads(path.read_bytes()))
        hands_of(pack(humanoid), given)  # names that no link has
    except (OSError, ValueError, RecursionError) as e:
        raise VitruvianError(f"--hands {path}: expected JSON that the page's Hands panel saved; {e}") from e
    except VitruvianError as e:
        raise VitruvianError(f"--hands {path}: {e}") from e
    store_roundings(humanoid, stored_roundings(humanoid) | given)


SHIFT = ".translation"  # after the name of a joint: where it is moved to, as the page saves it


def pose_of(text: str, option: str = "--joints") -> dict[str, list[float]]:
    """Joint rotations from JSON text or from a JSON file; translations in it are left out."""
    return {joint: value for joint, value in read_pose(text, option).items() if not joint.endswith(SHIFT)}


def read_pose(text: str, option: str) -> dict[str, list[float]]:
    """{joint: [x, y, z, angle], joint.translation: [x, y, z]} from JSON text or from a JSON file."""
    path = Path(text)
    try:
        source = path.read_text() if not text.lstrip().startswith("{") else text
        pose = json.loads(source)
    except (OSError, ValueError) as e:
        raise VitruvianError(f'{option}: expected JSON such as {{"l_knee": [1, 0, 0, 0.8]}} or its file; {e}') from e
    if not isinstance(pose, dict):
        raise VitruvianError(f"{option}: expected an object of joint names")
    for joint, value in pose.items():
        many, what = (3, "[x, y, z] metres") if joint.endswith(SHIFT) else (4, "[x, y, z, angle in radians]")
        numbers = isinstance(value, list) and len(value) == many and all(isinstance(v, int | float) for v in value)
        if not numbers:
            raise VitruvianError(f"{option}: {joint}: expected {what}, found {json.dumps(value)}")
    return pose


@app.command(epilog="Example: vitruvian pose body.x3d --joints '{\"l_knee\": [1, 0, 0, 0.8]}' -o kneeling.glb")
def pose(
    file: Path = typer.Argument(..., help="H-Anim or USD file."),
    joints: str = typer.Option(
        ..., "--joints", help="JSON {joint: [x, y, z, angle], joint.translation: [x, y, z]}, or its file."
    ),
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
    from vitruvian.hanim.humanoid import Humanoid

    humanoid = registry.load(file, name=name, repair=repair)
    if not isinstance(humanoid, Humanoid):
        raise VitruvianError(f"{file}: expected an H-Anim body to pose, found a {type(humanoid).__name__.lower()}")
    known = {j.name: j for j in humanoid.joints()}
    for key, value in read_pose(joints, "--joints").items():
        joint = key.removesuffix(SHIFT)
        if joint not in known:
            raise VitruvianError(f"--joints: {joint} is not a joint of {file}; it has {', '.join(list(known)[:8])} ...")
        setattr(known[joint], "rotation" if joint == key else "translation", np.array(value, dtype=np.float64))
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
