"""Clips that live in H-Anim files: HAnimMotion (X3D 4.0) and interpolators, to and from `Motion`.

Meaning as in browsers (note hanim.md, 5): HAnimMotion angles are degrees, `Zrotation Xrotation Yrotation` is Rz Rx Ry,
positions go straight to Joint.translation; OrientationInterpolators turn by slerp, keys are clamped at their ends.
"""

from __future__ import annotations

import numpy as np

from vitruvian.body.rotations import (
    from_axis_angle,
    from_euler,
    from_vector,
    inverse,
    multiply,
    rotate,
    slerp,
    to_euler,
)
from vitruvian.body.types import Floats, Skeleton, require
from vitruvian.errors import VitruvianError, warn
from vitruvian.hanim.humanoid import Humanoid, MotionData, Track
from vitruvian.hanim.tables import canonical
from vitruvian.motion.names import joint_index
from vitruvian.motion.types import Motion

LARGEST = 4_000_000  # frames times joints of a clip that is unrolled: a cycleInterval of years would fill the memory


def motion_of(
    humanoid: Humanoid, skeleton: Skeleton, *, fps: float | None = None, name: str | None = None, rebase: bool = False
) -> Motion | None:
    """The clip that a humanoid brings along, on its packed `skeleton`; None when it has none.

    The first enabled HAnimMotion at its own rate, else the interpolators of the TimeSensor that drives most tracks (a
    HAnimMotion that is not enabled comes last), sampled at `fps` (None: at the rate they were made with or at
    their keys where these are even, else 30).
    `name` picks one of `clip_names`. `rebase`: positions are taken as places (as in BVH) instead of offsets, so the
    rest centre is taken off them. Joints without animation keep the pose of the file.
    Raises `VitruvianError` for a name it does not have.
    """
    data = [m for m in humanoid.motions if m.values.size and (name is None or m.name == name)]
    tracks = [t for t in humanoid.tracks if len(t.keys)]
    playing = [m for m in data if _plays(humanoid, m)]
    if playing or data and (name is not None or not tracks):
        return _from_data((playing or data)[0], skeleton, rebase)
    if name is not None:
        tracks = [t for t in tracks if name in (t.timer, timer_name(humanoid, t.timer))]
        if not tracks:
            known = ", ".join(clip_names(humanoid)) or "none"
            raise VitruvianError(f"humanoid {humanoid.name!r}: expected a clip named {name!r}, found {known}")
    if not tracks:
        return None
    timers = [t.timer for t in tracks]
    timer = max(dict.fromkeys(timers), key=timers.count)
    chosen = [t for t in tracks if t.timer == timer]
    return _from_tracks(humanoid, chosen, skeleton, fps or max(t.rate for t in chosen) or None)


def _plays(humanoid: Humanoid, motion: MotionData) -> bool:
    """Whether a browser plays it: enabled itself and in the humanoid's `motions_enabled` (4.1 draft)."""
    at = next(k for k, m in enumerate(humanoid.motions) if m is motion)
    given = humanoid.motions_enabled
    return motion.enabled and (at >= len(given) or given[at])


def timer_name(humanoid: Humanoid, timer: str) -> str:
    """What a clip of interpolators is called: the DEF of its TimeSensor without the humanoid's prefix."""
    for prefix in ("hanim_", f"{humanoid.name}_"):
        if prefix != "_" and timer.startswith(prefix) and len(timer) > len(prefix):
            return timer[len(prefix) :]
    return timer


def clip_names(humanoid: Humanoid) -> dict[str, float]:
    """Name of every clip in a humanoid -> its seconds: HAnimMotions first, then interpolators by their TimeSensor."""
    out = {m.name: len(played_frames(m)) * m.frame_duration for m in humanoid.motions if m.values.size}
    for t in humanoid.tracks:
        if len(t.keys):
            out.setdefault(timer_name(humanoid, t.timer), t.interval)
    return out


def played_frames(motion: MotionData) -> list[int]:
    """The frames that an HAnimMotion shows, in order: start to end frame (0: the last) in steps of the increment.

    Start and end in the wrong order are exchanged; an increment of 0 stands still at the frame index.
    """
    last = len(motion.values) - 1
    end = min(motion.end_frame, last) if motion.end_frame > 0 else last
    low, high = sorted((min(max(motion.start_frame, 0), last), end))
    if motion.frame_increment == 0:
        return [min(max(motion.frame_index, low), high)]
    frames = list(range(low, high + 1, abs(motion.frame_increment)))
    return frames if motion.frame_increment > 0 else list(range(high, low - 1, motion.frame_increment))


def flags(data: MotionData) -> list[list[bool]]:
    """`channels_enabled` as one flag per channel and group: it is given per group or per channel."""
    given = list(data.channels_enabled)
    if len(given) == len(data.channels) or not given:
        whole = given or [True] * len(data.channels)
        return [[on] * len(group) for on, group in zip(whole, data.channels)]
    given += [True] * sum(len(g) for g in data.channels)
    out, at = [], 0
    for group in data.channels:
        out.append(given[at : at + len(group)])
        at += len(group)
    return out


def _joint(skeleton: Skeleton, name: str) -> int | None:
    """Index by the name itself, else by what the standard's other version calls it."""
    if name in skeleton.index:
        return skeleton.index[name]
    known = canonical(name)
    return joint_index(skeleton.names).get(known) if known else None


def _finish(
    skeleton: Skeleton,
    fps: float,
    rotation: Floats,
    shift: Floats,
    weights: dict[str, Floats],
    loop: bool,
    name: str,
    scale: Floats | None = None,
) -> Motion:
    still = np.abs(shift[:, 1:] - skeleton.translation[1:]).max(initial=0.0) < 1e-12
    return Motion(
        skeleton,
        fps,
        rotation,
        shift[:, 0],
        joint_translation=None if still else shift,
        weights=weights,
        loop=loop,
        name=name,
        joint_scale=scale,
    )


def _pose(skeleton: Skeleton, frames: int, title: str) -> tuple[Floats, Floats]:
    """Every frame in the pose of the file."""
    most = LARGEST // max(1, len(skeleton.names))
    require(frames <= most, title, f"at most {most} frames for {len(skeleton.names)} joints", frames)
    rotation = np.repeat(skeleton.rotation[None], frames, axis=0)
    return rotation, np.repeat(skeleton.translation[None], frames, axis=0)


def _from_data(data: MotionData, skeleton: Skeleton, rebase: bool) -> Motion:
    width = sum(len(c) for c in data.channels)
    values = np.asarray(data.values, dtype=np.float64)
    title = f"HAnimMotion {data.name}".strip()
    require(len(data.joints) == len(data.channels), title, "one group of channels per joint", len(data.channels))
    require(values.ndim == 2 and values.shape[1] == width, title, f"values of shape (frames, {width})", values.shape)
    require(bool(np.isfinite(values).all()), title, "finite values", "NaN or infinity")
    require(0 < data.frame_duration < np.inf, title, "a frameDuration above zero", data.frame_duration)
    values = values[played_frames(data)]
    rotation, shift = _pose(skeleton, len(values), title)
    column, lost, sizes = 0, [], None
    for joint, group, on in zip(data.joints, data.channels, flags(data)):
        columns = [k for k, yes in enumerate(on, column) if yes]
        channels = [c for c, yes in zip(group, on) if yes]
        column += len(group)
        if joint == "IGNORED" or not channels:
            continue
        j = _joint(skeleton, joint)
        if j is None:
            lost.append(joint)
            continue
        turns = [(c[0].upper(), values[:, k]) for c, k in zip(channels, columns) if c[1:].lower() == "rotation"]
        if turns:
            q = from_vector(np.zeros(3))
            order = "".join(letter for letter, _ in turns)
            if sorted(order) == ["X", "Y", "Z"]:
                rotation[:, j] = from_euler(np.radians(np.stack([v for _, v in turns], axis=1)), order)
            else:
                for letter, degrees in turns:
                    axis = np.eye(3)["XYZ".index(letter)]
                    q = multiply(q, from_vector(np.radians(degrees)[:, None] * axis))
                rotation[:, j] = q
        for channel, k in zip(channels, columns):
            if channel[1:].lower() == "scale":
                sizes = np.repeat(skeleton.scale[None], len(values), axis=0) if sizes is None else sizes
                sizes[:, j, "XYZ".index(channel[0].upper())] = values[:, k]
            if channel[1:].lower() == "position":
                axis = "XYZ".index(channel[0].upper())
                shift[:, j, axis] = values[:, k]
                if rebase:
                    parent = skeleton.parents[j]
                    rest = skeleton.centers[j] - (skeleton.centers[parent] if parent >= 0 else 0.0)
                    shift[:, j, axis] -= rest[axis]
    if lost:
        warn(
            f"{title}: the skeleton has no joint {', '.join(lost[:5])}; "
            f"{len(lost)} of {len(data.joints)} groups left out"
        )
    loop = data.loop and len(values) > 1
    if loop and _same_frame(rotation, shift):  # players show the last frame as the seam; ours leads back by itself
        rotation, shift = rotation[:-1], shift[:-1]
        sizes = None if sizes is None else sizes[:-1]
    return _finish(skeleton, 1 / data.frame_duration, rotation, shift, {}, loop, data.name, sizes)


def _same_frame(rotation: Floats, shift: Floats) -> bool:
    """Whether the last frame is the first again, but for a root that goes on its way."""
    same = np.abs(np.sum(rotation[0] * rotation[-1], axis=-1)) > 1 - 1e-7
    places = np.abs(shift[0] - shift[-1]).max(axis=-1) < 1e-5
    return bool(same.all() and places[1:].all() and (places[0] or _goes_on(shift[:, 0])))


def _goes_on(places: Floats) -> bool:
    """Whether places (n,3) lead somewhere and end with the step before once more, as `_frames_to_write` ends them."""
    if len(places) < 4:
        return False
    step = np.linalg.norm(np.diff(places[:-1], axis=0), axis=1).max()
    far = np.linalg.norm(places[-2] - places[0]) > 3 * max(step, 1e-9)
    return bool(far and np.abs(places[-1] - 2 * places[-2] + places[-3]).max() < 1e-5)


def sample_track(track: Track, fraction: Floats) -> Floats:
    """Values (n,k) of an interpolator at fractions (n,): rotations as `xyzw` quaternions by slerp, else linear.

    Clamped outside the keys; of equal keys the later one counts from there on.
    """
    keys = np.asarray(track.keys, dtype=np.float64)
    values = np.asarray(track.values, dtype=np.float64).reshape(len(keys), -1)
    if track.field == "rotation":
        values = from_axis_angle(values)
    if len(keys) == 1:
        return np.repeat(values, len(fraction), axis=0)
    right = np.clip(np.searchsorted(keys, fraction, side="right"), 1, len(keys) - 1)
    span = keys[right] - keys[right - 1]
    t = np.clip((fraction - keys[right - 1]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
    t = np.where(span > 0, t, 1.0)
    if track.field == "rotation":
        return slerp(values[right - 1], values[right], t)
    return values[right - 1] + (values[right] - values[right - 1]) * t[:, None]


def _rate(tracks: list[Track]) -> float | None:
    """Frames per second at which every key of these tracks falls on a frame; None when they are not even."""
    interval, count = tracks[0].interval, max(len(t.keys) for t in tracks)
    even = np.linspace(0.0, 1.0, count)
    for t in tracks:
        if t.interval != interval or len(t.keys) not in (1, count):
            return None
        if len(t.keys) == count and np.abs(np.asarray(t.keys) - even).max() > 1e-6:
            return None
    return (count - 1) / interval if count > 2 and interval > 0 else None


def _from_tracks(humanoid: Humanoid, tracks: list[Track], skeleton: Skeleton, fps: float | None) -> Motion:
    interval = max(float(t.interval) for t in tracks)
    require(0 < interval < np.inf, f"TimeSensor {tracks[0].timer}", "a cycleInterval above zero", interval)
    loop = all(t.loop for t in tracks)
    even = _rate(tracks)
    rate = fps or even or 30.0
    closed = loop and all(_closed(t) for t in tracks)
    frames = max(1, int(round(interval * rate))) + (0 if closed else 1)
    rotation, shift = _pose(skeleton, frames, f"animation {tracks[0].timer} at {rate:g} frames a second")
    fraction = np.clip(np.arange(frames) / max(interval * rate, 1e-9), 0.0, 1.0)
    weights: dict[str, Floats] = {}
    regions = {d.name for d in humanoid.displacers() if d.marks}
    lost = []
    carried: dict[str, Floats] = {}
    sizes: Floats | None = None
    for track in tracks:
        exact = fps is None and even and len(track.keys) > 1  # frames are its keys, however these were rounded
        at = np.asarray(track.keys, dtype=np.float64)[:frames] if exact else fraction
        if track.field == "weight":
            if track.target in regions:
                continue  # nothing moves
            weights[track.target] = sample_track(track, at)[:, 0]
            continue
        if not track.target and track.field in ("rotation", "translation"):
            carried[track.field] = sample_track(track, at)
            continue
        j = _joint(skeleton, track.target) if track.target else None
        if j is None or track.field not in ("rotation", "translation", "scale"):
            lost.append(f"{track.target or 'the humanoid'} {track.field}")
        elif track.field == "rotation":
            rotation[:, j] = sample_track(track, at)
        elif track.field == "scale":
            sizes = np.repeat(skeleton.scale[None], frames, axis=0) if sizes is None else sizes
            sizes[:, j] = sample_track(track, at)
        else:
            shift[:, j] = sample_track(track, at)
    if carried:
        _carry(humanoid, skeleton, carried, rotation, shift)
    if lost:
        warn(f"animation {tracks[0].timer}: {', '.join(lost[:4])} can't be carried by a motion of joints; left out")
    return _finish(skeleton, rate, rotation, shift, weights, loop, timer_name(humanoid, tracks[0].timer), sizes)


def _carry(humanoid: Humanoid, skeleton: Skeleton, moved: dict[str, Floats], rotation: Floats, shift: Floats) -> None:
    """Let the root joint do what moves the humanoid as a whole, so that both look the same in the file's own place.

    With P the humanoid's own transform and P' the moving one, roots get inverse(P) P' in front of theirs.
    """
    count = len(rotation)
    still = from_axis_angle(humanoid.rotation)
    turn = moved.get("rotation", np.repeat(still[None], count, axis=0))
    place = moved.get("translation", np.repeat(humanoid.translation[None], count, axis=0))
    if not np.allclose(humanoid.scale, humanoid.scale[0]) or humanoid.scale[0] == 0:
        warn(f"humanoid {humanoid.name}: it is scaled unevenly, so its own movement is left out")
        return
    scale, center = float(humanoid.scale[0]), humanoid.center
    back = inverse(still)
    turned = multiply(back, turn)  # the scale is the same both ways
    # P x = t + c + s R (x - c): P^-1 P' x = c + R^-1 (t' - t) / s + R^-1 R' (x - c)
    moved_by = rotate(back, place - humanoid.translation) / scale
    for j in np.flatnonzero(skeleton.parents < 0):
        own = skeleton.centers[j] + shift[:, j] - center
        shift[:, j] = center + moved_by + rotate(turned, own) - skeleton.centers[j]
        rotation[:, j] = multiply(turned, rotation[:, j])


def _closed(track: Track) -> bool:
    ends = sample_track(track, np.array([0.0, 1.0]))
    if track.field == "rotation":
        return bool(abs(ends[0] @ ends[1]) > 1 - 1e-7)
    if track.field == "translation" and _goes_on(np.asarray(track.values, dtype=np.float64)):
        return True
    return bool(np.abs(ends[0] - ends[1]).max() < 1e-6)


def frames_to_write(motion: Motion) -> tuple[Floats, Floats, dict[str, Floats]]:
    """Rotations (n,J,4), translations (n,J,3) and weights, with one frame more at the end of a loop: the first again.

    A walk that goes somewhere ends one step further instead of jumping back to where it began.
    """
    shift = motion.joint_translation
    if shift is None:
        shift = np.repeat(motion.skeleton.translation[None], len(motion), axis=0)
        shift[:, 0] = motion.translation
    if not motion.loop or len(motion) < 2:
        return motion.rotation, shift, motion.weights
    rotation = np.concatenate([motion.rotation, motion.rotation[:1]])
    # the last rotation keeps the hemisphere of its neighbour
    flip = np.sum(rotation[-1] * rotation[-2], axis=-1) < 0
    rotation[-1, flip] *= -1
    travel = motion.translation[-1] - motion.translation[0]
    step = np.linalg.norm(np.diff(motion.translation, axis=0), axis=1).max()
    last = shift[:1].copy()
    if np.linalg.norm(travel) > 3 * max(step, 1e-9):
        last[0, 0] = 2 * shift[-1, 0] - shift[-2, 0]
    weights = {name: np.append(w, w[0]) for name, w in motion.weights.items()}
    return rotation, np.concatenate([shift, last]), weights


def scales_to_write(motion: Motion) -> Floats | None:
    """Scales (n,J,3) of the same frames, None where no joint grows or shrinks."""
    scale = motion.joint_scale
    if scale is None or not _moves(scale, motion.skeleton.scale):
        return None
    return np.concatenate([scale, scale[:1]]) if motion.loop and len(motion) > 1 else scale


def _moves(values: Floats, rest: Floats) -> bool:
    return bool(np.abs(values - rest).max(initial=0.0) > 1e-7)


def _turns(rotation: Floats, rest: Floats) -> bool:
    """Whether quaternions (n,4), continuous in time, leave the file's own pose (4,)."""
    return len(rotation) > 0 and _moves(rotation, -rest if rotation[0] @ rest < 0 else rest)


def axis_angles(rotation: Floats) -> Floats:
    """`x y z angle` (n,4) of quaternions (n,4) along time, without jumps of axis or angle.

    The axis keeps its side from key to key and its direction where nothing turns; the angle may be negative or beyond
    pi.
    """
    length = np.linalg.norm(rotation[:, :3], axis=1)
    known = length > 1e-9
    if not known.any():
        return np.tile([0.0, 0.0, 1.0, 0.0], (len(rotation), 1))
    nearest = np.maximum.accumulate(np.where(known, np.arange(len(rotation)), -1))
    nearest = np.where(nearest < 0, int(np.argmax(known)), nearest)
    axis = (rotation[:, :3] / np.where(known, length, 1.0)[:, None])[nearest]
    dots = np.sum(axis[1:] * axis[:-1], axis=1)
    sign = np.concatenate([[1.0], np.cumprod(np.where(dots < 0, -1.0, 1.0))])
    angle = 2 * np.arctan2(np.where(known, length, 0.0), rotation[:, 3]) * sign
    # whole turns are not told apart; of q and -q take the smaller angle at the start, then follow
    angle = np.unwrap(angle)
    angle -= 2 * np.pi * np.round(angle[0] / (2 * np.pi))
    return np.concatenate([axis * sign[:, None], angle[:, None]], axis=1)


def tracks_of(motion: Motion, *, timer: str = "") -> list[Track]:
    """Interpolator tracks with one key per frame: rotation of every joint that turns, translation and scale of those
    that move, weights of displacers. Keys 0..1 over the clip; a loop gets the first frame as its last key."""
    rotation, shift, weights = frames_to_write(motion)
    scale = scales_to_write(motion)
    count = len(rotation)
    keys = np.linspace(0.0, 1.0, count) if count > 1 else np.zeros(1)
    interval = max(count - 1, 1) / motion.fps
    rest = (interval, motion.loop, timer, motion.fps)
    make = lambda target, field, values: Track(target, field, keys, values, *rest)  # noqa: E731
    tracks = []
    for j, name in enumerate(motion.skeleton.names):
        if _moves(shift[:, j], motion.skeleton.translation[j]):
            tracks.append(make(name, "translation", shift[:, j]))
        if _turns(rotation[:, j], motion.skeleton.rotation[j]):
            tracks.append(make(name, "rotation", axis_angles(rotation[:, j])))
        if scale is not None and _moves(scale[:, j], motion.skeleton.scale[j]):
            tracks.append(make(name, "scale", scale[:, j]))
    return tracks + [make(name, "weight", w[:, None]) for name, w in weights.items()]


def motion_data(motion: Motion, *, order: str = "ZXY") -> MotionData:
    """The clip as one HAnimMotion: translation and rotation of the first joint, rotations of the others that turn.

    Angles in degrees, continuous, rotation channels in `order`; enabled and loop are always said, because engines
    differ in their defaults. A loop ends with its first frame, as players show (n - 1) frame durations.
    """
    rotation, shift, _ = frames_to_write(motion)
    scale = scales_to_write(motion)
    joints, channels, columns = [], [], []
    turning = tuple(f"{c}rotation" for c in order.upper())
    place = ("Xposition", "Yposition", "Zposition")
    for j, name in enumerate(motion.skeleton.names):
        slides = j == 0 or _moves(shift[:, j], motion.skeleton.translation[j])
        turns = j == 0 or _turns(rotation[:, j], motion.skeleton.rotation[j])
        grows = scale is not None and _moves(scale[:, j], motion.skeleton.scale[j])
        if not slides and not turns and not grows:
            continue
        joints.append(name)
        size = ("Xscale", "Yscale", "Zscale") if grows else ()
        channels.append((place if slides else ()) + (turning if turns else ()) + size)
        if slides:
            columns.append(shift[:, j])
        if turns:
            columns.append(np.degrees(to_euler(rotation[:, j], order, continuous=True)))
        if grows and scale is not None:
            columns.append(scale[:, j])
    return MotionData(motion.name, joints, channels, np.concatenate(columns, axis=1), 1 / motion.fps, True, motion.loop)
