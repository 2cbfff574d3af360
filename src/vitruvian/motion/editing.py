"""Clips put together: one after the other, mixed, made into loops, layered, kept on the spot.

Pure functions from Motion to Motion on one skeleton. Source: note motion.md, 7. Turning is interpolated by slerp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.rotations import inverse, multiply, rotate, slerp
from vitruvian.body.types import Floats
from vitruvian.errors import VitruvianError
from vitruvian.motion.clips import resample, sample
from vitruvian.motion.legs import smooth
from vitruvian.motion.turns import about
from vitruvian.motion.types import Motion

UP = np.array([0.0, 1.0, 0.0])
PATH = 1.0  # Hz: what of the root's way is slower is its path, the rest its sway


def reverse(motion: Motion) -> Motion:
    """The clip from its end to its beginning."""
    return _rows(motion, np.arange(len(motion))[::-1])


def faster(motion: Motion, factor: float) -> Motion:
    """The same frames played `factor` times as fast."""
    if not (np.isfinite(factor) and 1e-3 <= factor <= 1e3):
        raise VitruvianError(f"faster: expected a factor in 0.001..1000, found {factor}")
    return replace(motion, fps=motion.fps * factor)


def placed(motion: Motion, *, yaw: float = 0.0, shift: Floats | Sequence[float] = (0.0, 0.0, 0.0)) -> Motion:
    """The clip turned by `yaw` (radians) about the vertical through the origin, then moved by `shift` (3,), metres."""
    turn, center = about(UP, yaw), motion.skeleton.centers[0]
    rotation = motion.rotation.copy()
    rotation[:, 0] = multiply(turn, rotation[:, 0])
    move = rotate(turn, motion.translation + center) - center + np.asarray(shift, dtype=np.float64)
    return _root(replace(motion, rotation=rotation), move)


def heading(motion: Motion) -> Floats:
    """(F,) where the figure faces: radians about the vertical from +Z towards +X."""
    front = rotate(motion.rotation[:, 0], np.array([0.0, 0.0, 1.0]))
    return np.arctan2(front[:, 0], front[:, 2])


def concatenate(clips: Sequence[Motion], blend: float = 0.2) -> Motion:
    """Clips one after the other. Each begins where the one before ends and faces as it does; over `blend` seconds the end
    of one fades into the beginning of the next (0: they only meet).

    The first clip's rate holds. Raises VitruvianError for clips of other skeletons, or shorter than twice the fade.
    """
    if not clips:
        raise VitruvianError("concatenate: expected at least one clip, found none")
    if not (np.isfinite(blend) and blend >= 0):
        raise VitruvianError(f"concatenate: expected a fade of 0 seconds or more, found {blend}")
    out = replace(clips[0], loop=False)
    for clip in clips[1:]:
        _same(out, clip)
        clip = replace(resample(replace(clip, loop=False), out.fps), loop=False)
        over = max(1, round(blend * out.fps))
        if over * 2 > min(len(out), len(clip)) and blend:
            raise VitruvianError(
                f"concatenate: expected clips of at least {2 * blend:g} s for a fade of {blend:g} s, found "
                f"{min(out.seconds, clip.seconds):.2f} s"
            )
        begin = len(out) - over
        clip = placed(clip, yaw=float(heading(out)[begin] - heading(clip)[0]))
        gap = out.translation[begin] - clip.translation[0]
        clip = placed(clip, shift=[gap[0], 0.0, gap[2]])
        share = smooth((np.arange(over) + 0.5) / over)
        middle = _mixed(_rows(out, np.arange(begin, len(out))), _rows(clip, np.arange(over)), share)
        out = _joined([_rows(out, np.arange(begin)), middle, _rows(clip, np.arange(over, len(clip)))])
    return out


def blend(first: Motion, second: Motion, share: float) -> Motion:
    """Between two clips: `share` 0 is the first, 1 the second. They are stretched to a length in between, so that clips of
    one cycle keep step."""
    _same(first, second)
    if not 0 <= share <= 1:
        raise VitruvianError(f"blend: expected a share in 0..1, found {share}")
    seconds = (1 - share) * first.seconds + share * second.seconds
    count = max(1, round(seconds * first.fps))
    both = [_stretched(clip, count) for clip in (first, second)]
    out = _mixed(both[0], both[1], np.full(count, share))
    return replace(out, fps=first.fps, loop=first.loop and second.loop)


def looped(motion: Motion, seam: float = 0.3) -> Motion:
    """The clip as a loop: what its end and its beginning differ by is taken back over `seam` seconds at both ends.

    The way that the figure goes, and how far it turns on the whole, are kept out of it.
    """
    if len(motion) < 3:
        raise VitruvianError(f"looped: expected at least 3 frames, found {len(motion)}")
    near = min(max(1, round(seam * motion.fps)), len(motion) // 2)
    at = np.arange(len(motion))
    late = 0.5 * smooth(np.clip((at - (len(motion) - 1 - near)) / near, 0, 1))
    early = 0.5 * (1 - smooth(np.clip(at / near, 0, 1)))
    last, first = motion.rotation[-1], motion.rotation[0].copy()
    turn = about(UP, float(heading(motion)[-1] - heading(motion)[0]))
    first[0] = multiply(turn, first[0])
    gap = multiply(inverse(last), first)  # from the last pose to the first
    back = multiply(inverse(first), last)
    one = np.broadcast_to([0.0, 0.0, 0.0, 1.0], motion.rotation.shape)
    fixed = multiply(motion.rotation, slerp(one, np.broadcast_to(gap, one.shape), late[:, None]))
    fixed = multiply(fixed, slerp(one, np.broadcast_to(back, one.shape), early[:, None]))
    move = motion.translation.copy()
    high = move[0, 1] - move[-1, 1]
    move[:, 1] += (late - early) * high
    weights = {n: w + (late - early) * (w[0] - w[-1]) for n, w in motion.weights.items()}
    return replace(_root(replace(motion, rotation=fixed, weights=weights), move), loop=True)


def in_place(motion: Motion) -> tuple[Motion, Floats]:
    """The clip on the spot, and the path (F,3) it went along, metres, height 0: `along` puts it back.

    The path is the horizontal way of the root without what is quicker than 1 Hz; a loop's, or a short clip's, is straight.
    """
    move = motion.translation
    share = np.linspace(0.0, 1.0, len(motion))[:, None]
    path = move[:1] + share * (move[-1:] - move[:1]) if len(motion) > 1 else move.copy()
    if not motion.loop and len(motion) >= 15 and motion.fps / 2 > PATH:
        from scipy.signal import butter, sosfiltfilt

        away = move - path
        path = path + sosfiltfilt(butter(2, PATH / (motion.fps / 2), output="sos"), away, axis=0)
    path = (path - path[:1]) * [1.0, 0.0, 1.0]
    return _root(motion, move - path), path


def along(motion: Motion, path: Floats) -> Motion:
    """The clip with its root moved by a path (F,3), metres."""
    way = np.asarray(path, dtype=np.float64)
    if way.shape != motion.translation.shape:
        raise VitruvianError(f"path: expected shape {motion.translation.shape}, found {way.shape}")
    return _root(motion, motion.translation + way)


def layer(motion: Motion, extra: Motion, share: float = 1.0) -> Motion:
    """`motion` with what `extra` does beyond its own first frame added to every joint; its weights win where both have one.

    `extra` is played at its own rate and its last pose held.
    """
    _same(motion, extra)
    some = sample(extra, np.arange(len(motion)) / motion.fps)
    change = multiply(inverse(some.rotation[:1]), some.rotation)
    one = np.broadcast_to([0.0, 0.0, 0.0, 1.0], change.shape)
    part = slerp(one, change, np.full(change.shape[:2], float(share)))
    weights = motion.weights | {n: share * w for n, w in some.weights.items()}
    return replace(motion, rotation=multiply(motion.rotation, part), weights=weights)


def _same(first: Motion, second: Motion) -> None:
    if first.skeleton is not second.skeleton and first.skeleton.names != second.skeleton.names:
        raise VitruvianError("clips: expected two of one skeleton, found other joints; retarget one of them first")


def _root(motion: Motion, move: Floats) -> Motion:
    shift = motion.joint_translation
    if shift is not None:
        shift = shift.copy()
        shift[:, 0] = move
    return replace(motion, translation=move, joint_translation=shift)


def _rows(motion: Motion, frames: NDArray[np.signedinteger]) -> Motion:
    shift, scale = motion.joint_translation, motion.joint_scale
    return replace(
        motion,
        rotation=motion.rotation[frames],
        translation=motion.translation[frames],
        joint_translation=None if shift is None else shift[frames],
        joint_scale=None if scale is None else scale[frames],
        weights={n: w[frames] for n, w in motion.weights.items()},
    )


def _stretched(motion: Motion, count: int) -> Motion:
    span = motion.seconds if motion.loop else (len(motion) - 1) / motion.fps
    return sample(motion, np.arange(count) / max(count - (not motion.loop), 1) * span)


def _weights(clips: Sequence[Motion]) -> list[dict[str, Floats]]:
    """Weights of all clips by the same names; 0 where a clip has none."""
    names = list(dict.fromkeys(n for c in clips for n in c.weights))
    return [{n: c.weights.get(n, np.zeros(len(c))) for n in names} for c in clips]


def _still(clips: Sequence[Motion]) -> list[tuple[Floats | None, Floats | None]]:
    """Joint translations and scales of all clips, those of the skeleton for a clip without where another has them."""
    moves = any(c.joint_translation is not None for c in clips)
    scales = any(c.joint_scale is not None for c in clips)
    out = []
    for c in clips:
        move, scale = c.joint_translation, c.joint_scale
        if moves and move is None:
            move = np.repeat(c.skeleton.translation[None], len(c), axis=0)
            move[:, 0] = c.translation
        if scales and scale is None:
            scale = np.repeat(c.skeleton.scale[None], len(c), axis=0)
        out.append((move, scale))
    return out


def _mixed(first: Motion, second: Motion, share: Floats) -> Motion:
    """Frame by frame between two clips of one length."""
    (move_a, scale_a), (move_b, scale_b) = _still([first, second])
    one, two = _weights([first, second])

    def linear(a: Floats, b: Floats) -> Floats:
        return np.asarray(a + share.reshape(-1, *[1] * (a.ndim - 1)) * (b - a))

    return replace(
        first,
        rotation=slerp(first.rotation, second.rotation, np.broadcast_to(share[:, None], first.rotation.shape[:2])),
        translation=linear(first.translation, second.translation),
        joint_translation=None if move_a is None or move_b is None else linear(move_a, move_b),
        joint_scale=None if scale_a is None or scale_b is None else linear(scale_a, scale_b),
        weights={n: linear(one[n], two[n]) for n in one},
    )


def _joined(clips: Sequence[Motion]) -> Motion:
    extra, weights = _still(clips), _weights(clips)

    def all_of(parts: Sequence[Floats | None]) -> Floats | None:
        return None if parts[0] is None else np.concatenate([p for p in parts if p is not None])

    return replace(
        clips[0],
        rotation=np.concatenate([c.rotation for c in clips]),
        translation=np.concatenate([c.translation for c in clips]),
        joint_translation=all_of([e[0] for e in extra]),
        joint_scale=all_of([e[1] for e in extra]),
        weights={n: np.concatenate([w[n] for w in weights]) for n in weights[0]},
    )
