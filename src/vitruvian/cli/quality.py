"""The command that measures deformers: quality."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli import app
from vitruvian.cli.output import Json, emit
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.body.types import Body, Floats
    from vitruvian.deform.trials import Trial
    from vitruvian.hanim.humanoid import Humanoid

LONGEST = 2000  # poses of one run


@app.command(epilog="Example: vitruvian quality person --poses walk --deformers linear,log,volume --every 10")
def quality(
    file: str = typer.Argument(..., help="H-Anim, glTF, VRM or USD file, or the word person."),
    poses: str | None = typer.Option(
        None,
        "--poses",
        help="JSON {joint: [x, y, z, angle]}, a list of such, its file; a motion file; walk or idle "
        "(default: one pose that is hard).",
    ),
    deformers: str = typer.Option(
        "linear,dual-quaternion,log,volume",
        "--deformers",
        metavar="NAMES",
        help="Of linear, dual-quaternion, log, log-pair, log-absolute, hybrid, volume, contours, hand.",
    ),
    joints: str | None = typer.Option(
        None, "--joints", metavar="NAMES", help="Measure round these (default: all that turn)."
    ),
    every: int = typer.Option(1, min=1, help="Of a motion take each so many frames."),
    as_json: bool = Json,
) -> None:
    """Measure deformed surfaces: volume, sections, thickness, bulge, folds, seam gap and stretch, worst over all poses.

    Numbers are ratios to rest, but folds (a count) and the gap (metres). --json also prints every pose and joint.
    """
    from vitruvian.body.pack import pack
    from vitruvian.cli.people import subject
    from vitruvian.deform.deformer import NAMES, deformer
    from vitruvian.deform.trials import trial

    names = list(dict.fromkeys(n.strip() for n in deformers.split(",") if n.strip()))
    unknown = [n for n in names if n not in NAMES]
    if unknown or not names:
        raise VitruvianError(f"--deformers: expected names out of {', '.join(NAMES)}, found {''.join(unknown[:1])!r}")
    humanoid = subject(file)
    body = pack(humanoid)
    if not len(body.skin.triangles):
        raise VitruvianError(f"{file}: expected a figure with a surface, found none")
    matrices = _matrices(body, poses, every)
    chosen = None if joints is None else [j.strip() for j in joints.split(",") if j.strip()]
    found = {n: trial(deformer(n, _suited(humanoid, body, n)), matrices, joints=chosen) for n in names}
    document = {"poses": len(matrices), "deformers": {n: t.document() for n, t in found.items()}}
    emit(document, "\n".join(_table(found, len(matrices))), as_json)


def _suited(humanoid: Humanoid, body: Body, name: str) -> Body:
    """The body, sliced into contours when the deformer wants some."""
    if name != "contours" or body.contours:
        return body
    from vitruvian.body.pack import pack
    from vitruvian.modeling.contours import contours

    return pack(contours(humanoid))


def _matrices(body: Body, poses: str | None, every: int) -> Floats:
    """(F,J,4,4) of the poses that were asked for."""
    import numpy as np

    from vitruvian.body.kinematics import joint_matrices
    from vitruvian.body.rotations import from_axis_angle
    from vitruvian.cli.files import pose_of
    from vitruvian.cli.people import movement
    from vitruvian.show.comparison import default_pose

    skeleton = body.skeleton
    if poses is not None and not poses.lstrip().startswith(("{", "[")) and Path(poses).suffix.lower() != ".json":
        motion = movement(poses, body)
        frames = range(0, len(motion.rotation), every)
        if len(frames) > LONGEST:
            raise VitruvianError(
                f"--poses: expected at most {LONGEST} poses, found {len(frames)}; give a larger --every"
            )
        return np.asarray(joint_matrices(skeleton, motion)[::every])
    asked: list[Any] = [default_pose(skeleton)] if poses is None else _listed(poses, pose_of)
    out = []
    for pose in asked:
        rotation = skeleton.rotation.copy()
        for joint, value in pose.items():
            if joint not in skeleton.index:
                raise VitruvianError(
                    f"--poses: {joint} is not a joint of {body.name}; it has {', '.join(skeleton.names[:8])} ..."
                )
            if not np.isfinite(value).all():
                raise VitruvianError(f"--poses: {joint}: expected finite numbers, found {value}")
            rotation[skeleton.index[joint]] = from_axis_angle(np.asarray(value, np.float64))
        out.append(joint_matrices(replace(skeleton, rotation=rotation))[0])
    return np.stack(out)


def _listed(poses: str, pose_of: Any) -> list[Any]:
    """The poses of a JSON text or file: one object, or a list of them."""
    import json

    text = poses
    if not poses.lstrip().startswith(("{", "[")):
        try:
            text = Path(poses).read_text("utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise VitruvianError(f"--poses: can't read {poses}: {error}") from None
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        raise VitruvianError(f"--poses: expected JSON, found {text[:40]!r}") from None
    if not isinstance(found, list):
        found = [found]
    if not 0 < len(found) <= LONGEST:
        raise VitruvianError(f"--poses: expected 1 to {LONGEST} poses, found {len(found)}")
    return [pose_of(json.dumps(pose), f"--poses: pose {i}") for i, pose in enumerate(found)]


def _table(found: dict[str, Trial], poses: int) -> list[str]:
    """The worst numbers as lines of text, and where the worst are."""
    fields = list(asdict(next(iter(found.values())).worst))
    lines = [f"worst of {poses} poses" if poses > 1 else "one pose"]
    lines.append(f"{'':<18}" + "".join(f"{f if f != 'gap' else 'gap_mm':>11}" for f in fields))
    for name, result in found.items():
        row = asdict(result.worst) | {"gap": round(result.worst.gap * 1000, 3)}
        lines.append(f"{name:<18}" + "".join(f"{row[f]:>11.4g}" for f in fields))
        places = {f: result.where[f] for f in ("area", "bulge") if row[f] == row[f]}
        lines += [f"  {f}: pose {pose}{f', {joint}' if joint else ''}" for f, (pose, joint) in places.items()]
    return lines
