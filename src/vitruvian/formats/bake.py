"""Skins that move in viewers that do not skin: the points of every frame as keys of a CoordinateInterpolator.

The deformer makes the points; keys are left out where linear interpolation between the kept ones stays within a
tolerance, and numbers are rounded to a fraction of it. Own method: every coordinate keeps the range of slopes that
passes all frames since the last key within its share of the tolerance, which settles most frames at one look; only
where a slope leaves its range are all frames since then measured. Source of what is written: ISO/IEC 14772-1,
CoordinateInterpolator.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.types import Body, Floats, require
from vitruvian.deform.deformer import deformer
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import Humanoid, Material, Segment, Shape, Track
from vitruvian.motion.tracks import frames_to_write, scales_to_write
from vitruvian.motion.types import Motion
from vitruvian.stage.clip import Clip

TOLERANCE = 0.001  # metres
_LOOKS = 256  # frames since the last key that are measured once more
_HELD = 1 << 25  # bytes of deformed points that are held at once
_MOST = 1 << 25  # numbers of all keys together: about a quarter of a gigabyte of text


def bake_skin(clip: Clip, *, tolerance: float = TOLERANCE) -> tuple[Humanoid, list[Track], dict[str, Any]]:
    """The humanoid of a clip with a skin that no joint moves any more, and the tracks that move it instead.

    The skin (and Segments cut out of it, contour surfaces) is what the clip's deformer makes of it; points of Segments
    are baked where displacers move them; rigid Segments stay with their joints. tolerance: metres that a point may be
    off in any frame. The points that the file shows before it plays are those of the first frame.
    The report: `frames`, `keys` and `points` of the skin, `max_error_m` (largest distance in any frame), `lost`.
    Raises `VitruvianError` when there is no surface to bake, for a tolerance that is no length, and for more keys than
    a file should hold.
    """
    require(1e-6 <= tolerance <= 1.0, "tolerance", "0.000001 to 1 metre", tolerance)
    body, motion = clip.body, clip.motion
    humanoid, points = _one_skin(clip.humanoid, body)
    segments = _driven(humanoid, motion)
    if not points and not segments:
        raise VitruvianError("bake: expected a skin, found only rigid Segments, which move without skinning")
    report: dict[str, Any] = {"frames": 1, "keys": 1, "points": points, "max_error_m": 0.0, "lost": []}
    out = humanoid.copied()
    tracks: list[Track] = []
    if points:
        keys, values, report["frames"], report["max_error_m"] = reduced(_frames(clip, points), points, tolerance)
        report["keys"] = len(keys)
        out.skin_coord, out.skin_normal = values[0], None
        if len(keys) > 1:
            tracks.append(_track("", keys, values, report["frames"], motion))
    for segment, moved in segments:
        each = moved.shape[1]
        keys, values, frames, error = reduced(iter(moved.reshape(len(moved), each, 3)), each, tolerance)
        report["frames"], report["max_error_m"] = max(frames, report["frames"]), max(error, report["max_error_m"])
        own = next(s for s in out.segments() if s.name == segment.name)
        _put(own, segment.coord, values[0])
        if len(keys) > 1:
            tracks.append(_track(segment.name, keys, values, frames, motion))
    gone = sum(len(j.displacers) for j in out.joints()) + len(out.skin_displacers)
    for joint in out.joints() if points else ():
        joint.skin_coord_index, joint.skin_coord_weight = np.zeros(0, np.int32), np.zeros(0)
        joint.displacers = []
    if points:
        out.skin_displacers, out.binding = [], {}
        report["lost"].append("the weights of the skin: its baked points need none")
    if gone or segments:
        report["lost"].append("displacers: what they did is in the baked points")
    return out, tracks, report


def _track(target: str, keys: Floats, values: Floats, frames: int, motion: Motion | None) -> Track:
    assert motion is not None
    interval = max(frames - 1, 1) / motion.fps
    return Track(target, "point", keys, values.reshape(len(keys), -1), interval, motion.loop, motion.name, motion.fps)


def _put(segment: Segment, old: Floats | None, new: Floats) -> None:
    """Other points for a segment, its displacers gone."""
    segment.shapes = [
        replace(s, points=new, normals=None, normal_triangles=None) if s.points is old else s for s in segment.shapes
    ]
    segment.coord, segment.displacers = new, []


def _one_skin(humanoid: Humanoid, body: Body) -> tuple[Humanoid, int]:
    """A humanoid all of whose bending surfaces are its skin, and how many points that has: the first of the body's."""
    bends = any(s.skin_index is not None for g in humanoid.segments() for s in g.shapes)
    if not body.contours and not bends:
        moved = any(s.points is None for s in humanoid.skin) and len(humanoid.skin_coord) > 0
        return humanoid, len(humanoid.skin_coord) if moved else 0
    skin = body.skin
    shapes = []
    for part in skin.parts:
        some = slice(part.start, part.stop)
        look = Material(
            part.name, part.color, part.roughness, part.metallic, part.opacity, double_sided=part.double_sided
        )  # fmt: skip
        look.picture = part.picture
        uv_triangles = None if skin.uv_triangles is None else skin.uv_triangles[some]
        shapes.append(
            Shape(part.name, skin.triangles[some], None, skin.uv, uv_triangles, skin.colors, look,
                  crease_angle=part.crease)
        )  # fmt: skip
    out = humanoid.copied()
    out.skin, out.skin_coord = shapes, skin.rest
    for segment in out.segments():
        segment.shapes, segment.contours, segment.coord, segment.displacers = [], [], None, []
        segment.sites = [replace(s, shapes=[]) for s in segment.sites]
    return out, len(skin.rest)


def _driven(humanoid: Humanoid, motion: Motion | None) -> list[tuple[Segment, Floats]]:
    """Segments whose points displacers move: with (F,n,3) where they are, in the segment's own frame."""
    weights = {} if motion is None else frames_to_write(motion)[2]
    found = []
    for segment in humanoid.segments():
        active = [d for d in segment.displacers if d.weight or d.name in weights]
        model = segment.coord
        if model is None:
            model = next((s.points for s in segment.shapes if s.points is not None), None)
        if not active or model is None:
            continue
        count = max((len(weights[d.name]) for d in active if d.name in weights), default=1)
        moved = np.repeat(model[None], count, axis=0)
        for d in active:
            share = weights.get(d.name, np.full(count, d.weight))
            for frame, w in zip(moved, share):
                np.add.at(frame, d.coord_index, w * d.displacements)
        segment = replace(segment, coord=model)
        found.append((segment, moved))
    return found


def _frames(clip: Clip, points: int) -> Iterator[Floats]:
    """The points of the skin, frame by frame, the closing one of a loop included: (points,3) float64."""
    body, motion = clip.body, clip.motion
    move, skeleton = deformer(clip.deformer, body), body.skeleton
    if motion is None:
        given: dict[str, Floats] = {}
        rotation, shift, scale = skeleton.rotation[None], skeleton.translation[None], None
    else:
        rotation, shift, given = frames_to_write(motion)
        scale = scales_to_write(motion)
    named = {m.name for m in body.skin.morphs}
    weights = {k: w for k, w in given.items() if k in named}
    step = max(2, _HELD // max(1, len(body.skin.rest) * 24))
    for start in range(0, len(rotation), step):
        some = slice(start, start + step)
        matrices = pose_matrices(skeleton, rotation[some], shift[some], scale=None if scale is None else scale[some])
        made = np.asarray(move(matrices, {k: w[some] for k, w in weights.items()}), np.float64)
        yield from made.reshape(len(matrices), -1, 3)[:, :points]


def reduced(frames: Iterator[Floats], count: int, tolerance: float) -> tuple[Floats, Floats, int, float]:
    """Few keys, found in one pass, whose linear interpolation is nowhere further than `tolerance` from the frames.

    frames: (count,3) each. Answers keys (k,) in 0..1, values (k,count,3) rounded, the number of frames, and the largest
    distance of a point in any frame.
    """
    grid = 10.0 ** np.floor(np.log10(tolerance / 5))
    within = tolerance - np.sqrt(3) * grid / 2  # what rounding a key leaves of it
    kept: list[Floats] = []
    places: list[int] = []
    waiting: list[Floats] = []  # frames since the last key
    low = high = np.zeros((count, 3))
    worst, number = 0.0, 0

    def close(frame: Floats) -> None:
        """Make the last frame seen a key."""
        nonlocal worst, waiting, low, high
        kept.append(np.round(frame / grid) * grid)
        places.append(number - 1)
        if len(kept) * count * 3 > _MOST:
            most = f"{_MOST // 3_000_000} million points in all keys"
            raise VitruvianError(f"bake: more than {most}; raise the tolerance or cut the clip")
        worst = max(worst, _off(kept[-2:], waiting or [frame]))
        waiting, low, high = [], np.full((count, 3), -np.inf), np.full((count, 3), np.inf)

    for frame in frames:
        if not kept:
            number = 1
            close(frame)
            continue
        length = len(waiting) + 1
        slope = (frame - kept[-1]) / length
        outside = bool(waiting) and not ((slope >= low) & (slope <= high)).all()
        if outside and (length > _LOOKS or _off([kept[-1], frame], [*waiting, frame]) > within):
            close(waiting[-1])
            length, slope = 1, frame - kept[-1]
        room = within / np.sqrt(3) / length
        low, high = np.maximum(low, slope - room), np.minimum(high, slope + room)
        waiting.append(frame.copy())
        number += 1
    if waiting:
        close(waiting[-1])
    keys = np.array(places, np.float64) / max(number - 1, 1)
    if len(kept) == 2 and np.array_equal(kept[0], kept[1]):
        keys, kept = keys[:1], kept[:1]
    return keys, np.array(kept), number, worst


def _off(ends: list[Floats], frames: list[Floats]) -> float:
    """Largest distance of the points of frames after the first end, the last at the other end, from the line between."""
    square = 0.0
    for k, frame in enumerate(frames, 1):
        between = ends[0] + (ends[-1] - ends[0]) * (k / len(frames))
        square = max(square, float(((between - frame) ** 2).sum(axis=1).max(initial=0.0)))
    return float(np.sqrt(square))
