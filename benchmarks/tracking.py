"""How fast markers become poses: 39 markers of the built-in person walking, 60 frames a second.

One core: frames per second of processor time. Batch: clips of a performer who is known from the first of them, frames per
second of the clock on all cores, gaps and residuals among them. `python benchmarks/tracking.py` prints the rows.
"""

from __future__ import annotations

import time

import numpy as np
from _rows import main, row

from vitruvian.body.kinematics import joint_matrices, site_positions
from vitruvian.body.pack import pack
from vitruvian.modeling.person import person
from vitruvian.motion.gait import walk
from vitruvian.motion.limits import within
from vitruvian.motion.tracking import track
from vitruvian.motion.types import Motion

ALONE, BATCH = 120, 1200  # frames per second
SITES = [
    *("cervicale", "suprasternale", "substernale", "skull_vertex", "glabella"),
    *(
        f"{side}_{name}"
        for side in "lr"
        for name in (
            "asis", "psis", "acromion", "humeral_lateral_epicondyle", "humeral_medial_epicondyle", "radial_styloid",
            "ulnar_styloid", "femoral_lateral_epicondyle", "femoral_medial_epicondyle", "lateral_malleolus",
            "medial_malleolus", "calcaneus_posterior", "metatarsal_phalanx_1", "metatarsal_phalanx_5", "tragion",
            "metacarpal_phalanx_2", "metacarpal_phalanx_5",
        )
    ),
]  # fmt: skip


def rows(quick: bool = False) -> list[dict[str, object]]:
    """Two rows, of one core and of a batch."""
    skeleton = pack(person(hair="none")).skeleton
    gait = walk(skeleton, fps=60, cycles=6 if quick else 20)
    motion = Motion(skeleton, 60.0, within(skeleton, gait.rotation), gait.translation)
    at = site_positions(skeleton, joint_matrices(skeleton, motion))
    points = at[:, [skeleton.site_index[f"{n}_pt"] for n in SITES]]
    points = points + np.random.default_rng(0).normal(size=points.shape) * 0.002
    first = track(skeleton, tuple(SITES), points[:120], 60.0)
    clips = 2 if quick else 4
    clock, work = time.perf_counter(), time.process_time()
    for _ in range(clips):
        track(skeleton, tuple(SITES), points, 60.0, performer=first)
    clock, work = time.perf_counter() - clock, time.process_time() - work
    frames = clips * len(points)
    alone, batch = frames / work, frames / clock
    what = f"{len(SITES)} markers"
    return [
        row(f"{what}, one core: {alone:,.0f} frames/s", work, None, None, None, f">= {ALONE} frames/s", alone >= ALONE),
        row(f"{what}, batch: {batch:,.0f} frames/s", clock, None, None, None, f">= {BATCH:,} frames/s", batch >= BATCH),
    ]


if __name__ == "__main__":
    main(__doc__, rows)
