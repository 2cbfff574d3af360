"""The clips inside a Humanoid as arrays and back, for conversions that change what every joint has to do.

A take is what all joints of a skeleton do in one clip: rotations (F,J,4) and translations (F,J,3), the file's pose
where the clip says nothing. Writing back touches only joints whose local motion changed: the others keep their keys,
channels and figures.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vitruvian.body.rotations import to_euler
from vitruvian.body.types import Floats, Skeleton
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import Humanoid, MotionData, Track
from vitruvian.hanim.tables import canonical
from vitruvian.motion.names import joint_index
from vitruvian.motion.tracks import axis_angles, flags, motion_of, sample_track
from vitruvian.motion.types import continuous

_SAME = 1e-9
_RATE = 30.0  # frames per second between the keys of interpolators where their blend is not exact


@dataclass(frozen=True, eq=False)
class Take:
    """rotation (F,J,4) xyzw, translation (F,J,3) of all joints of one skeleton."""

    rotation: Floats
    translation: Floats


def local_matrices(skeleton: Skeleton, world: Floats) -> Floats:
    """(F,J,4,4) of joints relative to their parents, from those in humanoid space.

    Raises VitruvianError, naming the joint, where a parent is squashed flat by a scale of zero.
    """
    flat = np.abs(np.linalg.det(world[..., :3, :3])).min(axis=0) < 1e-15
    if flat.any():
        name = skeleton.names[int(np.argmax(flat))]
        raise VitruvianError(f"joint {name}: expected a scale above zero, found zero; give it a scale to convert it")
    local = world.copy()
    for j, parent in enumerate(skeleton.parents):
        if parent >= 0:
            local[:, j] = np.linalg.solve(world[:, parent], world[:, j])
    return local


def carried(
    humanoid: Humanoid,
    skeleton: Skeleton,
    out: Humanoid,
    target: Skeleton,
    change: Callable[[Take], Take],
    *,
    dense: bool = True,
) -> Humanoid:
    """`out` (packed: `target`) with the clips of `humanoid` (packed: `skeleton`), each take passed through `change`.

    `change` answers the take of `target`'s joints frame by frame. Interpolators are evaluated at the keys of all tracks
    of their TimeSensor, and with `dense` 30 times a second between them. Joints are matched by name across versions.
    """
    same = _pairs(skeleton, target)
    motions = [_data(humanoid, d, skeleton, target, same, change) for d in humanoid.motions]
    tracks: list[Track] = []
    for timer in dict.fromkeys(t.timer for t in humanoid.tracks):
        mine = [t for t in humanoid.tracks if t.timer == timer]
        tracks += _tracks(mine, skeleton, target, same, change, dense)
    return replace(out, motions=motions, tracks=tracks)


def _pairs(skeleton: Skeleton, target: Skeleton) -> dict[int, int]:
    """Joint of the target -> the same joint of the source."""
    known = joint_index(skeleton.names)
    out = {}
    for j, name in enumerate(target.names):
        i = skeleton.index.get(name)
        i = known.get(canonical(name) or "") if i is None else i
        if i is not None:
            out[j] = i
    return out


def changed(before: Take, after: Take, same: dict[int, int]) -> tuple[set[int], set[int]]:
    """Target joints whose rotations, and whose translations, are not those of their partners in the source."""
    turned, shifted = set(), set()
    for j in range(after.rotation.shape[1]):
        i = same.get(j)
        if i is None:
            turned.add(j)
            shifted.add(j)
            continue
        a, b = before.rotation[:, i], after.rotation[:, j]
        sign = np.where(np.sum(a * b, axis=-1, keepdims=True) < 0, -1.0, 1.0)
        if np.abs(a - sign * b).max(initial=0.0) > _SAME:
            turned.add(j)
        if np.abs(before.translation[:, i] - after.translation[:, j]).max(initial=0.0) > _SAME:
            shifted.add(j)
    return turned, shifted


def _data(
    humanoid: Humanoid,
    data: MotionData,
    skeleton: Skeleton,
    target: Skeleton,
    same: dict[int, int],
    change: Callable[[Take], Take],
) -> MotionData:
    """An HAnimMotion with the groups of joints that changed written anew: positions where they move, turns Z X Y."""
    whole = replace(data, enabled=True, loop=False, start_frame=0, end_frame=0, frame_increment=1)
    alone = replace(humanoid, motions=[whole], motions_enabled=[], tracks=[])
    motion = motion_of(alone, skeleton)
    if motion is None or not len(motion):
        return data
    shift = motion.joint_translation
    if shift is None:
        shift = np.repeat(skeleton.translation[None], len(motion), axis=0)
        shift[:, 0] = motion.translation
    before = Take(motion.rotation, shift)
    after = change(before)
    turned, shifted = changed(before, after, same)
    touched = turned | shifted
    back = {i: j for j, i in same.items()}
    known = joint_index(skeleton.names)
    joints: list[str] = []
    channels: list[tuple[str, ...]] = []
    columns: list[Floats] = []
    enabled: list[bool] = []
    column = 0
    for name, group, on in zip(data.joints, data.channels, flags(data)):
        own = data.values[:, column : column + len(group)]
        column += len(group)
        i = skeleton.index.get(name, known.get(canonical(name) or ""))
        j = None if i is None else back.get(i)
        if i is not None and (j is None or j in touched):
            continue
        joints.append(name if j is None else target.names[j])
        channels.append(group)
        columns.append(own)
        enabled += on
    for j in sorted(touched):
        turn, place = after.rotation[:, j], after.translation[:, j]
        moves = np.abs(place - target.translation[j]).max(initial=0.0) > _SAME or j == 0
        joints.append(target.names[j])
        channels.append(
            (("Xposition", "Yposition", "Zposition") if moves else ()) + ("Zrotation", "Xrotation", "Yrotation")
        )
        columns += [place] if moves else []
        columns.append(np.degrees(to_euler(continuous(turn), "ZXY", continuous=True)))
    values = np.concatenate([*columns, np.zeros((len(data.values), 0))], axis=1)
    enabled += [True] * (values.shape[1] - len(enabled))
    off = [] if all(enabled) else enabled
    return replace(data, joints=joints, channels=channels, values=values, channels_enabled=off, node=None)


def _tracks(
    tracks: list[Track],
    skeleton: Skeleton,
    target: Skeleton,
    same: dict[int, int],
    change: Callable[[Take], Take],
    dense: bool,
) -> list[Track]:
    """Interpolators of one TimeSensor."""
    known = joint_index(skeleton.names)
    where = [skeleton.index.get(t.target, known.get(canonical(t.target) or "")) for t in tracks]
    moving = [(t, i) for t, i in zip(tracks, where) if i is not None and t.field in ("rotation", "translation")]
    if not moving:
        return tracks
    keys = _keys([t for t, _ in moving], dense)
    rotation = np.repeat(skeleton.rotation[None], len(keys), axis=0)
    translation = np.repeat(skeleton.translation[None], len(keys), axis=0)
    for t, i in moving:
        (rotation if t.field == "rotation" else translation)[:, i] = sample_track(t, keys)
    before = Take(continuous(rotation), translation)
    after = change(before)
    turned, shifted = changed(before, after, same)
    back = {i: j for j, i in same.items()}
    out = []
    for t, at in zip(tracks, where):
        if at is None or t.field not in ("rotation", "translation", "scale", "center"):
            out.append(t)
            continue
        j = back.get(at, -1)
        touched = turned if t.field == "rotation" else shifted if t.field == "translation" else set()
        if j >= 0 and j not in touched:
            out.append(replace(t, target=target.names[j]))
    model = moving[0][0]
    for j in sorted(turned):
        if np.abs(np.abs(np.sum(after.rotation[:, j] * target.rotation[j], axis=-1)) - 1).max() > 1e-15:
            values = axis_angles(continuous(after.rotation[:, j]))
            out.append(_slim(replace(model, target=target.names[j], field="rotation", keys=keys, values=values)))
    for j in sorted(shifted):
        if np.abs(after.translation[:, j] - target.translation[j]).max() > _SAME:
            place = after.translation[:, j].copy()
            out.append(_slim(replace(model, target=target.names[j], field="translation", keys=keys, values=place)))
    return out


def _slim(track: Track) -> Track:
    """One key for what stands still."""
    if np.ptp(track.values, axis=0).max(initial=0.0) < 1e-12:
        return replace(track, keys=track.keys[:1].copy(), values=track.values[:1].copy())
    return track


def _keys(tracks: list[Track], dense: bool) -> Floats:
    """Fractions at which all tracks are evaluated; just before a jump too."""
    found = [np.zeros(1)]
    for t in tracks:
        keys = np.asarray(t.keys, dtype=np.float64)
        found += [keys, np.nextafter(keys[1:][np.diff(keys) == 0], -1.0)]
    if dense:
        seconds = max(float(t.interval) for t in tracks)
        found.append(np.linspace(0.0, 1.0, min(max(int(np.ceil(seconds * _RATE)), 1), 20000) + 1))
    return np.unique(np.clip(np.concatenate(found), 0.0, 1.0))
