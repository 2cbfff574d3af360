"""Trajectories of markers, cleaned: jumps taken out, short gaps filled (note motion.md, 5.1)."""

from __future__ import annotations

import numpy as np

from vitruvian.body.types import Floats

FILL = 0.2  # seconds: the longest gap that is filled
FASTEST = 10.0  # metres a second
CROSSED = 0.1  # metres: both steps of markers that change places


def cleaned(points: Floats, fps: float, names: tuple[str, ...]) -> tuple[Floats, list[str]]:
    """points (F,M,3) without jumps and with gaps of at most FILL seconds filled by cubic splines; one line notes."""
    out = points.copy()
    notes = []
    jumps = 0
    for k in range(points.shape[1]):
        known = np.flatnonzero(np.isfinite(out[:, k]).all(axis=1))
        jumps += _unjumped(out[:, k], known, fps)
    if jumps:
        notes.append(f"{jumps} points jump faster than {FASTEST:.0f} m/s: taken out")
    filled = 0
    for k in range(points.shape[1]):
        filled += _filled(out[:, k], max(1, round(FILL * fps)))
    if filled:
        notes.append(f"{filled} missing points in gaps of at most {FILL} s: filled")
    lost = [n for k, n in enumerate(names) if not np.isfinite(out[:, k]).any()]
    if lost:
        notes.append(f"never seen: {', '.join(lost)}")
    return out, notes


def uncrossed(points: Floats, pairs: list[tuple[int, int]], names: tuple[str, ...]) -> tuple[Floats, list[str]]:
    """points (F,M,3) with labels of pairs set right where both jump into each other's place; what most frames say holds."""
    out, notes = points.copy(), []
    for a, b in pairs:
        both = np.flatnonzero(np.isfinite(points[:, [a, b]]).all(axis=(1, 2)))
        if len(both) < 3:
            continue
        here, there = points[both, a], points[both, b]
        apart = lambda p, q: np.linalg.norm(p[1:] - q[:-1], axis=1)  # noqa: E731
        stay, cross = apart(here, here) + apart(there, there), apart(here, there) + apart(there, here)
        turned = np.concatenate([[False], np.logical_xor.accumulate((cross < 0.5 * stay) & (stay > CROSSED))])
        if not turned.any():
            continue
        wrong = both[turned if turned.mean() <= 0.5 else ~turned]
        out[wrong, a], out[wrong, b] = points[wrong, b], points[wrong, a]
        notes.append(f"{names[a]} and {names[b]} are exchanged in {len(wrong)} frames: read the other way round")
    return out, notes


def _unjumped(track: Floats, known: np.ndarray, fps: float) -> int:
    """Takes out, in place, short pieces of a trajectory (F,3) that are far off what is before and after them."""
    if len(known) < 3:
        return 0
    step = np.linalg.norm(np.diff(track[known], axis=0), axis=1) * fps / np.diff(known)
    cuts = np.flatnonzero(step > FASTEST)
    if not len(cuts):
        return 0
    pieces = np.split(known, cuts + 1)
    longest = max(len(p) for p in pieces)
    gone = 0
    for piece in pieces:
        if len(piece) < min(longest, max(3, 0.2 * fps)):
            track[piece] = np.nan
            gone += len(piece)
    return gone


def _filled(track: Floats, most: int) -> int:
    """Fills, in place, gaps of at most `most` frames of a trajectory (F,3)."""
    from scipy.interpolate import CubicSpline

    known = np.flatnonzero(np.isfinite(track).all(axis=1))
    gap = np.diff(known)
    short = np.flatnonzero((gap > 1) & (gap <= most + 1))
    if len(known) < 4 or not len(short):
        return 0
    spline = CubicSpline(known, track[known])
    count = 0
    for i in short:
        frames = np.arange(known[i] + 1, known[i + 1])
        track[frames] = spline(frames)
        count += len(frames)
    return count
