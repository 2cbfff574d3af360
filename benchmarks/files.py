"""How fast files load, beside another package in the same process, in turns.

BVH: the playground clip of CMU (2.07 MB, 31 joints, 2,752 frames) of the folder ../shared against pybvh 0.9, which
reads the same numbers but leaves angles as they are, while ours are quaternions. Without the folder a clip of that size
is written first. USD: a person who walks two cycles (60 frames), beside GLB, which says the same with four influences.
`python benchmarks/files.py` prints the rows.
"""

from __future__ import annotations

import statistics
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CLIP = ROOT.parent / "shared" / "data" / "motion" / "cmu_01_01_playground.bvh"


def rows(quick: bool = False) -> list[dict]:
    """One row per format: medians of interleaved runs, after one run each to warm up."""
    from vitruvian.formats.bvh import read_bvh

    try:
        from pybvh import read_bvh_file
    except ImportError:
        read_bvh_file = None
    with tempfile.TemporaryDirectory() as folder:
        path = CLIP if CLIP.is_file() else _clip(Path(folder) / "clip.bvh")
        runs = [lambda: read_bvh(path)] + ([lambda: read_bvh_file(str(path))] if read_bvh_file else [])
        times = medians(runs, 5 if quick else 25)
        size = path.stat().st_size / 1e6
    ours, peer = times[0], times[1] if read_bvh_file else None
    return [
        {
            "name": f"load BVH, {size:.1f} MB",
            "ours_s": ours,
            "peer": "pybvh 0.9",
            "peer_s": peer,
            "ratio": None if peer is None else peer / ours,
            "goal": ">= 1",
            "holds": peer is not None and peer >= ours,
        },
        *_usd(quick),
    ]


def _usd(quick: bool) -> list[dict]:
    try:
        import pxr  # noqa: F401
    except ImportError:
        return []
    import vitruvian as vt
    from vitruvian.motion.clips import repeat

    h = vt.person()
    b = vt.pack(h)
    clip = vt.Clip(h, b, repeat(vt.walk(b.skeleton), 2), "linear")
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / "walk.usdc", Path(folder) / "walk.glb"]
        ours, peer = medians([lambda p=p: vt.save(clip, p) for p in paths], 3 if quick else 9)
        size = paths[0].stat().st_size / 1e6
    ratio = peer / ours
    name = f"write USD, {len(b.skin.rest):,} vertices, {len(clip.motion)} frames, {size:.1f} MB"
    row = {"name": name, "ours_s": ours, "peer": "GLB", "peer_s": peer, "ratio": ratio}
    return [{**row, "goal": ">= 0.4", "holds": ratio >= 0.4}]


def medians(runs: list[Callable[[], object]], times: int) -> list[float]:
    """Median seconds of each of `runs`, taken in turns so that a busy machine slows all of them alike."""
    taken: list[list[float]] = [[] for _ in runs]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for turn in range(times + 1):
            for k, run in enumerate(runs):
                start = time.perf_counter()
                run()
                if turn:
                    taken[k].append(time.perf_counter() - start)
    return [statistics.median(t) for t in taken]


def _clip(path: Path) -> Path:
    """A clip of about the same size as CMU's, of our own walk."""
    import numpy as np

    from vitruvian.body.types import Skeleton
    from vitruvian.formats.bvh import write_bvh
    from vitruvian.hanim.tables import default_centers, joints_at, parent_at
    from vitruvian.motion.gait import walk

    centers = default_centers()
    names = list(joints_at(2))[:40]
    parents = [-1 if (p := parent_at(n, 2)) is None else names.index(p) for n in names]
    skeleton = Skeleton(tuple(names), np.array(parents), np.array([centers[n] for n in names]))
    write_bvh(walk(skeleton, fps=120, cycles=16), path)
    return path


if __name__ == "__main__":
    for row in rows():
        print(row)
