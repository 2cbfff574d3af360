"""A moving, dressed figure as a folder of OBJ files, one for each frame: what every program can read.

`NAME.objs` holds NAME_0001.obj, NAME_0002.obj, ...; all have the same faces, and the points of their frame.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.types import Floats, Skin, Weights
from vitruvian.deform.deformer import deformer
from vitruvian.errors import VitruvianError
from vitruvian.formats.obj import painted, text_of
from vitruvian.motion.tracks import frames_to_write, scales_to_write
from vitruvian.stage.clip import Clip
from vitruvian.stage.vertex_cache import surface

ENDING = ".objs"


def write_sequence(clip: Clip, path: str | os.PathLike[str]) -> dict[str, Any]:
    """Every frame of a clip, its caches included, in a folder that appears whole or not at all.

    The body moves by the clip's own deformer. A folder that is there is replaced when it holds nothing but such frames.
    The report: `frames vertices triangles bytes` and `lost`. Raises VitruvianError when there is no triangle, for caches of
    other frames, and for a folder that holds anything else.
    """
    body, target = clip.body, Path(path)
    frames = 1 if clip.motion is None else len(clip.motion)
    short = next((c for c in clip.caches if len(c) < frames), None)
    if short is not None:
        raise VitruvianError(f"{short.name}: expected {frames} frames, found {len(short)}")
    whole = joined([body.skin, *(surface(c, c.positions[0].astype(np.float64)) for c in clip.caches)])
    if not len(whole.triangles):
        raise VitruvianError(f"{path}: there is no triangle to write")
    size, turn, shift = 0, body.placement[:3, :3], body.placement[:3, 3]
    with whole_folder(target) as folder:
        for k, points in enumerate(_bodies(clip, frames)):
            moved = np.concatenate([points, *(c.positions[k] for c in clip.caches)]) @ turn.T + shift
            text = text_of(body.name, moved, whole.triangles, whole.uv, whole.uv_triangles, whole.colors, whole.parts)
            size += (folder / f"{target.stem}_{k + 1:04d}.obj").write_text(text, encoding="utf-8")
    lost = ["the skeleton and its weights: OBJ holds points only"]
    return {
        "frames": frames,
        "vertices": len(whole.rest),
        "triangles": len(whole.triangles),
        "bytes": size,
        "lost": lost,
    }


def _bodies(clip: Clip, frames: int) -> Iterator[Floats]:
    """(V,3) of the body in each frame, humanoid space."""
    skeleton, move = clip.body.skeleton, deformer(clip.deformer, clip.body)
    if clip.motion is None:
        matrices = pose_matrices(skeleton, skeleton.rotation[None], skeleton.translation[None])
    else:
        rotation, shift, _ = frames_to_write(clip.motion)
        matrices = pose_matrices(skeleton, rotation, shift, scale=scales_to_write(clip.motion))
    weights = {} if clip.motion is None else clip.motion.weights
    known = {m.name for m in clip.body.skin.morphs}
    for k in range(frames):
        shaped = {name: w[k : k + 1] for name, w in weights.items() if name in known}
        yield np.asarray(move(matrices[k : k + 1], shaped), np.float64).reshape(-1, 3)


def joined(skins: list[Skin]) -> Skin:
    """Surfaces as one, without weights. Those without texture coordinates get (0, 0) where others have some."""
    points = np.cumsum([0, *(len(s.rest) for s in skins)])
    faces = np.cumsum([0, *(len(s.triangles) for s in skins)])
    uv = [np.zeros((1, 2)) if s.uv is None else s.uv for s in skins]
    seams = [np.zeros_like(s.triangles) if s.uv_triangles is None else s.uv_triangles for s in skins]
    first = np.cumsum([0, *map(len, uv)])
    colors = [painted(len(s.rest), s.triangles, s.parts) if s.colors is None else s.colors for s in skins]
    parts = [replace(p, start=p.start + n, stop=p.stop + n) for s, n in zip(skins, faces) for p in s.parts]
    textured = any(s.uv is not None for s in skins)
    stack = lambda arrays, starts: np.concatenate([a + n for a, n in zip(arrays, starts)])  # noqa: E731
    nothing = Weights(np.zeros(points[-1] + 1, np.int32), np.zeros(0, np.int32), np.zeros(0))
    return Skin(
        np.concatenate([s.rest for s in skins]), stack([s.triangles for s in skins], points), nothing,
        np.concatenate(uv) if textured else None, stack(seams, first) if textured else None,
        np.concatenate(colors), tuple(parts),
    )  # fmt: skip


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """A folder beside `path` that takes its name when the block ends well, in place of older frames."""
    frame = re.compile(re.escape(path.stem) + r"_\d{4,}\.obj")
    if path.exists() and (not path.is_dir() or any(not frame.fullmatch(p.name) for p in path.iterdir())):
        raise VitruvianError(
            f"{path}: expected a folder of {path.stem}_0001.obj, ..., found something else; move it away"
        )
    try:
        made = Path(tempfile.mkdtemp(prefix=f".{path.stem[:40]}-", dir=path.parent))
    except OSError as error:
        raise VitruvianError(f"{path}: can't write in {path.parent} ({error.strerror})") from None
    old = made.with_name(made.name + "-old")
    try:
        yield made
        umask = os.umask(0)
        os.umask(umask)
        made.chmod(0o777 & ~umask)
        if path.exists():
            os.replace(path, old)
        os.replace(made, path)
    finally:
        shutil.rmtree(made, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)
