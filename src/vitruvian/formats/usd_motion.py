"""A SkelAnimation as the motion that a Humanoid brings along. See `usd_reader`."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vitruvian.body.pack import pack
from vitruvian.body.rotations import to_matrix
from vitruvian.body.types import Floats
from vitruvian.errors import warn
from vitruvian.formats.usd_shapes import axis_angle
from vitruvian.hanim.humanoid import Humanoid, Track
from vitruvian.motion.tracks import tracks_of
from vitruvian.motion.types import Motion

if TYPE_CHECKING:
    from vitruvian.formats.usd_build import Rig

_SNAP = 1e-6  # metres: a joint that slides less stays where it is
_COARSE = 2e-3  # of a scale: SkelAnimation holds half floats


def animate(path: object, h: Humanoid, rig: Rig, animation: dict[str, Any], about: dict[str, Any]) -> None:
    """One frame poses the figure; several become tracks with a key for each, on one timer."""
    local = animation["local"]
    if local is None or local.shape[1] != len(rig.place):
        warn(f"{path}: a SkelAnimation that does not fit its Skeleton is left out")
        return
    weights = _weights(h, rig, animation)
    rotation, shift, stretch = rig.turned(local[:, rig.place >= 0])
    if np.abs(stretch - rig.stretch).max() > _COARSE * np.abs(rig.stretch).max():
        warn(f"{path}: the animation scales joints, which a motion of H-Anim joints can't carry; scales stay at rest")
    frames = len(rotation)
    if frames == 1:
        for j, joint in enumerate(rig.joints):
            joint.rotation = axis_angle(to_matrix(rotation[0, j]))
            joint.translation = np.where(np.abs(shift[0, j]) < _SNAP, 0.0, shift[0, j])
        return
    skeleton = pack(h).skeleton
    number = {id(j): k for k, j in enumerate(rig.joints)}
    order = [number[id(j)] for j in dict.fromkeys(h.joints())]
    rotation, shift = rotation[:, order], shift[:, order]
    for j in range(1, len(order)):
        if np.abs(shift[:, j] - skeleton.translation[j]).max() < _SNAP:
            shift[:, j] = skeleton.translation[j]
    slides = bool((shift[:, 1:] != skeleton.translation[1:]).any())
    moving = {n: w for n, w in weights.items() if np.ptp(w) > 0}
    title = str(about.get("motion", animation["name"]))
    motion = Motion(skeleton, animation["fps"], rotation, shift[:, 0], shift if slides else None, moving)
    h.tracks = _tracks(motion, title, bool(about.get("loop", False)))


def _weights(h: Humanoid, rig: Rig, animation: dict[str, Any]) -> dict[str, Floats]:
    """Weights over time by displacer; one that does not change becomes the displacer's own."""
    tokens, out = animation["tokens"], {}
    for d in h.displacers():
        if rig.tokens_of.get(d.name) in tokens:
            out[d.name] = animation["weights"][:, tokens.index(rig.tokens_of[d.name])]
            if np.ptp(out[d.name]) == 0:
                d.weight = float(out[d.name][0])
    return out


def _tracks(motion: Motion, timer: str, loop: bool) -> list[Track]:
    """A loop that comes back to its beginning ends with its first frame again; one that travels ends as it is."""
    closed = replace(motion, loop=loop)
    tracks = tracks_of(closed, timer=timer)
    ends = [np.abs(t.values[0] - t.values[-1]).max() < 1e-6 for t in tracks if t.field == "translation"]
    if loop and not all(ends):
        tracks = tracks_of(motion, timer=timer)
        for track in tracks:
            track.loop = True
    return tracks
