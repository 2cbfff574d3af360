"""Clip operations."""

from __future__ import annotations

import numpy as np
import pytest

from skeletons import figure
from vitruvian.errors import VitruvianError
from vitruvian.motion.clips import mirror, repeat, resample, sample, trim
from vitruvian.motion.gait import walk
from vitruvian.motion.idle import idle
from vitruvian.motion.turns import positions, world_rotations


def places(motion):
    world = world_rotations(motion.skeleton.parents, motion.rotation)
    return positions(motion.skeleton.parents, motion.skeleton.centers, world, motion.translation)


def test_resampled_clip_shows_the_same():
    """Half the rate, sampled at the old times: within a millimetre but for the moment of heel strike."""
    motion = walk(figure(2), fps=120, cycles=2)
    half = resample(motion, 60)
    assert len(half) == len(motion) // 2
    back = sample(half, np.arange(len(motion) - 1) / motion.fps)
    off = np.linalg.norm(places(back) - places(motion)[:-1], axis=-1)
    assert np.quantile(off, 0.98) < 1e-3 and off.max() < 0.012  # the knock of a heel strike falls between two frames
    assert resample(motion, 120).rotation == pytest.approx(motion.rotation)


def test_mirror_twice_is_the_same_and_once_is_half_a_cycle_later():
    motion = walk(figure(3), fps=60, in_place=True)
    there = mirror(motion)
    assert np.abs(mirror(there).rotation - motion.rotation).max() < 1e-12
    count = len(motion)
    if count % 2:
        motion = resample(motion, 60 * (count + 1) / count)
        there = mirror(motion)
    later = np.roll(places(motion), -len(motion) // 2, axis=0)
    assert np.abs(places(there) - later).max() < 0.01  # a walk is the same on both sides


def test_repeat_goes_on():
    motion = walk(figure(2), fps=60)
    twice = repeat(motion, 2)
    assert np.abs(places(twice) - places(walk(figure(2), fps=60, cycles=2))).max() < 1e-2
    still = repeat(idle(figure(2), seconds=4), 3)
    assert len(still) == 360 and still.translation[120] == pytest.approx(still.translation[0])


def test_trim():
    motion = walk(figure(2), fps=30, cycles=2)
    part = trim(motion, 0.5, 1.0)
    assert len(part) == 15 and not part.loop
    assert part.translation[0] == pytest.approx(motion.translation[15])
    with pytest.raises(VitruvianError, match="trim"):
        trim(motion, 1.0, 0.5)
    with pytest.raises(VitruvianError, match="repeat"):
        repeat(part, 2)
    with pytest.raises(VitruvianError, match="fps"):
        resample(motion, 0)
