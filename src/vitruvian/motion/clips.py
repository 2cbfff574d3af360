"""Clip operations: pure functions from Motion to Motion that keep names and, unless asked, the rate.

Source: note motion.md, 7. Quaternions are `xyzw`; turning is interpolated by slerp, translation linearly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from vitruvian.body.rotations import slerp
from vitruvian.body.types import Floats
from vitruvian.errors import VitruvianError
from vitruvian.motion.types import Motion


def _each(motion: Motion, change: Callable[[Floats], Floats], rotation: Floats, **more: object) -> Motion:
    """The clip with `rotation` and with `change` applied to everything else that has a time axis."""
    shift = motion.joint_translation
    return replace(
        motion,
        rotation=rotation,
        translation=change(motion.translation),
        joint_translation=None if shift is None else change(shift),
        weights={name: change(w) for name, w in motion.weights.items()},
        **more,  # type: ignore[arg-type]
    )


def sample(motion: Motion, seconds: Floats) -> Motion:
    """The poses at given times (n,) in seconds, as frames of the same rate; times outside are clamped to the ends.

    A loop is continued from its last frame to its first, except for the way that its root goes.
    """
    if not len(motion):
        raise VitruvianError("motion: expected at least one frame, found none")
    at = np.asarray(seconds, dtype=np.float64) * motion.fps
    last = len(motion) if motion.loop else len(motion) - 1
    at = np.clip(at, 0, last)
    low = np.minimum(np.floor(at).astype(int), max(last - 1, 0))
    high = np.minimum(low + 1, last) % len(motion)
    t = at - low

    def linear(values: Floats) -> Floats:
        share = t.reshape(-1, *[1] * (values.ndim - 1))
        step = values[high] - values[low]
        if motion.loop and values is motion.translation and len(motion) > 2:
            back = high < low  # the seam of a clip that travels: go on as before
            step[back] = values[-1] - values[-2] if _travels(motion) else step[back]
        return values[low] + share * step

    return _each(motion, linear, slerp(motion.rotation[low], motion.rotation[high], t[:, None]))


def _travels(motion: Motion) -> bool:
    way = np.linalg.norm(motion.translation[-1] - motion.translation[0])
    return bool(way > 3 * np.linalg.norm(np.diff(motion.translation, axis=0), axis=1).max())


def resample(motion: Motion, fps: float) -> Motion:
    """The same clip at another rate."""
    if not 0 < fps < 1e5:
        raise VitruvianError(f"fps: expected a rate above zero, found {fps}")
    span = len(motion) if motion.loop else len(motion) - 1
    count = max(1, int(round(span / motion.fps * fps)) + (0 if motion.loop else 1))
    return replace(sample(motion, np.arange(count) / fps), fps=fps)


def trim(motion: Motion, start: float, stop: float) -> Motion:
    """The frames from `start` up to `stop` (seconds); not a loop any more."""
    first, last = int(np.ceil(start * motion.fps - 1e-9)), int(np.ceil(stop * motion.fps - 1e-9))
    if not 0 <= first < last <= len(motion):
        raise VitruvianError(f"trim: expected 0 <= start < stop <= {motion.seconds:.3f} s, found {start} to {stop}")
    rows = slice(first, last)
    return _each(motion, lambda values: values[rows], motion.rotation[rows], loop=False)


def repeat(motion: Motion, times: int) -> Motion:
    """A loop played several times in a row; one that travels goes on from where it has come to."""
    if not motion.loop or times < 1:
        raise VitruvianError(f"repeat: expected a loop and at least one time, found loop={motion.loop}, times={times}")
    out = _each(motion, lambda values: np.concatenate([values] * times), np.concatenate([motion.rotation] * times))
    if not _travels(motion):
        return out
    stride = 2 * motion.translation[-1] - motion.translation[-2] - motion.translation[0]
    stride[1] = 0.0
    move = out.translation + np.repeat(np.arange(times), len(motion))[:, None] * stride
    shift = out.joint_translation
    if shift is not None:
        shift = shift.copy()
        shift[:, 0] = move
    return replace(out, translation=move, joint_translation=shift)


def mirror(motion: Motion) -> Motion:
    """Left and right exchanged: what the left side did the right side does. Needs joints in l_ and r_ pairs."""
    names = motion.skeleton.names
    mates = {"l_": "r_", "r_": "l_"}
    swap = [motion.skeleton.index.get(mates.get(n[:2], "") + n[2:] if n[:2] in mates else n, -1) for n in names]
    if -1 in swap:
        raise VitruvianError(f"mirror: joint {names[swap.index(-1)]} has no mate on the other side")
    flip = np.array([-1.0, 1.0, 1.0])
    shift = motion.joint_translation
    weights = {mates.get(n[:2], n[:2]) + n[2:]: w for n, w in motion.weights.items()}
    return replace(
        motion,
        rotation=motion.rotation[:, swap] * [1.0, -1.0, -1.0, 1.0],
        translation=motion.translation * flip,
        joint_translation=None if shift is None else shift[:, swap] * flip,
        weights=weights,
    )
