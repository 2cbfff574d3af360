"""Clothes of a clip, worn on a stage and kept frame by frame.

Source: note cloth.md, sections 7 and 10; note stage-and-viewer.md, section 8.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from vitruvian.body.types import Floats, Weights, floats
from vitruvian.cloth.garment import charted
from vitruvian.motion.tracks import frames_to_write
from vitruvian.motion.types import Motion
from vitruvian.stage.clip import Clip
from vitruvian.stage.clothes import COLOURS, Dress, Wardrobe
from vitruvian.stage.stage import Stage
from vitruvian.stage.vertex_cache import VertexCache

RATE = 60.0  # ticks per second at least in which cloth is computed
LEAD = 2.0
CLOSING = 0.4  # seconds at the end of a loop that lead back to its beginning


def bake(
    clip: Clip, *, deformer: str | None = None, wind: ArrayLike | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[VertexCache, ...]:  # fmt: skip
    """What the garment of a clip, and those below it, do in each of its frames, innermost first; () without a garment.

    The clip is played on a Stage of its own in steps of a sixtieth of a second or less, so that the same clip gives the
    same bits. Cloth comes to rest on the first pose and is moving as the body does when the first frame begins: a loop is
    led in by its own end, anything else by a second in which the body gets up speed. A loop has a frame more, as
    `vitruvian.motion.tracks.frames_to_write` has, in which the cloth is where it began.
    deformer: how the body moves under it, the clip's own without; for files that are played with linear skinning, that.
    wind (3,) m/s; progress: called with frames that are done and all of them.
    Raises VitruvianError as `vitruvian.stage.clothes.dressed` does.
    """
    if clip.garment is None:
        return ()
    how = clip.deformer if deformer is None else deformer
    motion, lead = (None, 0) if clip.motion is None or not len(clip.motion) else led_in(clip.motion)
    pace = 1 if motion is None else int(np.ceil(RATE / motion.fps - 1e-9))
    stage = Stage([replace(clip, motion=motion, deformer=how)], rate=RATE if motion is None else pace * motion.fps)
    wardrobe = next(s.run for s in stage.systems if isinstance(s.run, Wardrobe))
    wardrobe.wind = None if wind is None else floats(wind, "wind", 3)
    (_, _, dresses), *_ = wardrobe.worn.values()
    frames = 1 if motion is None else len(motion) - lead
    positions = [np.empty((frames, len(d.prepared.x), 3), np.float32) for d in dresses]
    for k in range(-lead, frames):
        if k > -lead:
            stage.step(pace)
        for dress, kept in zip(dresses, positions):
            if k >= 0:
                kept[k] = stage.frame[dress.actor.name].vertices
        if progress is not None:
            progress(k + lead + 1, frames + lead)
    looped = clip.motion is not None and clip.motion.loop and frames > 1
    times = np.arange(frames) / (1.0 if motion is None else motion.fps)
    way = np.zeros(3) if motion is None else motion.translation[-1] - motion.translation[lead]
    return tuple(
        _cache(clip, dress, k, times, kept, way if looped else None)
        for k, (dress, kept) in enumerate(zip(dresses, positions))
    )


def led_in(motion: Motion) -> tuple[Motion, int]:
    """A motion that plays once, a loop with its closing frame, after frames that lead into it; how many those are."""
    rotation, shift, weights = frames_to_write(motion)
    root, n = shift[:, 0], len(motion)
    lead = max(1, round(LEAD * motion.fps))
    scale = motion.joint_scale
    if motion.loop and n > 1:
        before = np.arange(n - lead, n) % n
        rounds = (np.arange(n - lead, n) // n - 1)[:, None]
        path = root[before] + rounds * (root[-1] - root[0])
        scale = None if scale is None else np.concatenate([scale, scale[:1]])
    else:
        before = np.zeros(lead, int)
        share = np.arange(lead)[:, None] / lead
        speed = (root[1] - root[0]) * motion.fps if n > 1 else np.zeros(3)
        path = root[0] - speed * (lead / motion.fps) * (1 - share**2) / 2
    joined = lambda a: np.concatenate([a[before], a])  # noqa: E731
    moves = None if motion.joint_translation is None else joined(shift)
    path = np.concatenate([path, root])
    if moves is not None:
        moves[:, 0] = path
    out = replace(
        motion, rotation=joined(rotation), translation=path, joint_translation=moves, loop=False,
        weights={name: joined(w) for name, w in weights.items()}, joint_scale=None if scale is None else joined(scale),
    )  # fmt: skip
    return out, lead


def _cache(
    clip: Clip, dress: Dress, number: int, times: Floats, positions: NDArray[np.float32], way: Floats | None
) -> VertexCache:
    """The cache of one garment; `way` (3,): how far a loop has gone at its closing frame."""
    closing = 0.0
    if way is not None:
        apart = positions[-1] - positions[0] - way
        closing = float(np.linalg.norm(apart, axis=1).max(initial=0.0))
        last = min(len(times) - 1, max(1, round(CLOSING / (times[1] - times[0]))))
        share = np.arange(1, last + 1)[:, None, None] / last
        positions[-last:] -= (share**2 * (3 - 2 * share) * apart).astype(np.float32)
    made = dress.prepared.garment
    uv, corners = charted(made)
    return VertexCache(
        dress.actor.name, made.triangles, times, positions, uv, corners, COLOURS[number % len(COLOURS)],
        carried(dress, clip.body.skin.weights), closing,
    )  # fmt: skip


def carried(dress: Dress, weights: Weights) -> Weights:
    """How joints carry a garment: the weights of the skin at the feet of its points."""
    worn = dress.prepared.worn
    n = len(worn.corner)
    joints = int(weights.joint.max(initial=0)) + 1
    skin = csr_array((weights.weight, weights.joint, weights.row), shape=(len(weights), joints))
    feet = csr_array((worn.share.astype(np.float64).ravel(), worn.corner.ravel(), np.arange(0, 3 * n + 1, 3)),
                     shape=(n, len(weights)))  # fmt: skip
    found = (feet @ skin).tocoo()
    total = np.bincount(found.row, found.data, minlength=n)
    good = found.data > 1e-4 * total[found.row]
    row, joint, weight = found.row[good], found.col[good], found.data[good]
    bare = np.flatnonzero(total <= 0)  # on a piece of skin that nothing moves
    row, joint = np.concatenate([row, bare]), np.concatenate([joint, np.zeros(len(bare), int)])
    weight = np.concatenate([weight, np.ones(len(bare))])
    total = np.bincount(row, weight, minlength=n)
    return Weights.from_pairs(n, row, joint, weight / total[row])
