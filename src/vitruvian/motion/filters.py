"""Motions made smoother."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vitruvian.body.rotations import unit
from vitruvian.body.types import Floats
from vitruvian.errors import VitruvianError
from vitruvian.motion.types import Motion


def lowpass(motion: Motion, hertz: float) -> Motion:
    """What changes faster than `hertz` taken out: fourth-order Butterworth, forwards and backwards, so nothing is late.

    Rotations are filtered as quaternions, which are continuous in time and made unit again. A cutoff of half the frame
    rate or more changes nothing; clips shorter than 15 frames are left as they are.
    """
    if not (np.isfinite(hertz) and hertz > 0):
        raise VitruvianError(f"lowpass: expected a frequency above 0 Hz, found {hertz}")
    if hertz >= motion.fps / 2 or len(motion) < 15:
        return motion
    from scipy.signal import butter, sosfiltfilt

    filter_ = butter(2, hertz / (motion.fps / 2), output="sos")

    def smooth(track: Floats) -> Floats:
        return np.asarray(sosfiltfilt(filter_, track, axis=0), dtype=np.float64)

    shift, scale = motion.joint_translation, motion.joint_scale
    return replace(
        motion,
        rotation=unit(smooth(motion.rotation)),
        translation=smooth(motion.translation),
        joint_translation=None if shift is None else smooth(shift),
        joint_scale=None if scale is None else smooth(scale),
        weights={name: np.clip(smooth(w), 0.0, 1.0) for name, w in motion.weights.items()},
    )
