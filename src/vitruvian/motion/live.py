"""A humanoid at a moment of its own animation: what its ROUTEs deliver, sent to its objects as events."""

from __future__ import annotations

import numpy as np

from vitruvian.body.rotations import to_axis_angle
from vitruvian.body.types import Floats
from vitruvian.errors import VitruvianError
from vitruvian.hanim.events import find, send
from vitruvian.hanim.humanoid import Humanoid, Track
from vitruvian.motion.tracks import clip_names, sample_track, timer_name


def _clip(humanoid: Humanoid, name: str | None) -> list[Track]:
    tracks = [t for t in humanoid.tracks if len(t.keys) and (name is None or timer_name(humanoid, t.timer) == name)]
    if name is not None and not tracks:
        known = ", ".join(clip_names(humanoid)) or "none"
        raise VitruvianError(f"humanoid {humanoid.name!r}: expected interpolators named {name!r}, found {known}")
    return tracks


def fraction_at(track: Track, seconds: float) -> float:
    """What its TimeSensor says that long after it started: 0..1, staying at 1 when it does not loop."""
    turns = seconds / track.interval
    if track.loop and turns > 0 and turns == int(turns):
        return 1.0  # a cycle ends with 1 before the next begins
    return turns % 1.0 if track.loop else min(max(turns, 0.0), 1.0)


def set_time(humanoid: Humanoid, seconds: float, *, name: str | None = None) -> list[tuple[str, str]]:
    """Put the humanoid into the state that its interpolators give it `seconds` after their start; changes it in place.

    All fields that may take such events are driven: transforms of the humanoid, its joints and sites, weights of
    displacers, points of the skin and of segments. `name` picks a clip. Answers the (target, field) pairs set.
    Raises `VitruvianError` for an unknown clip or a target that the humanoid does not have.
    """
    done = []
    for track in _clip(humanoid, name):
        value = sample_track(track, np.array([fraction_at(track, seconds)]))[0]
        if track.field == "rotation":
            value = to_axis_angle(value)
        elif track.field == "point":
            value = value.reshape(-1, 3)
        elif track.field == "weight":
            value = value[0]
        send(find(humanoid, track.target, track.field), f"set_{track.field}", value)
        done.append((track.target, track.field))
    return done


def baked(humanoid: Humanoid, *, fps: float = 30.0, target: str = "", name: str | None = None) -> Floats | None:
    """(F,V,3) the points that a CoordinateInterpolator gives the skin, or the Segment `target`; None without one.

    From the start of the clip to its end, both included, `fps` times a second; of a body that was baked into points.
    """
    tracks = [t for t in _clip(humanoid, name) if t.field == "point" and t.target == target]
    if not tracks:
        return None
    track = tracks[0]
    count = max(1, round(track.interval * fps)) + 1
    return sample_track(track, np.linspace(0.0, 1.0, count)).reshape(count, -1, 3)
