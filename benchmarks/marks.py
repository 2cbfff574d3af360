"""Feature points found on scans whose truth is known, and people made to measure: how far off, in how many seconds.

Run: python benchmarks/marks.py [--quick]
"""

from __future__ import annotations

import sys
import time
import warnings
from pathlib import Path

import numpy as np
from _rows import main, row

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

# sensible people: what they are otherwise, and what was asked for in metres
SIZES = {
    "man": ({"gender": 1.0}, {"chest": 0.96, "waist": 0.80}),
    "woman": ({"gender": 0.0}, {"height": 1.68, "chest": 0.92, "waist": 0.72, "hips": 0.98}),
    "large man": (
        {"gender": 1.0},
        {"height": 1.82, "chest": 1.04, "waist": 0.92, "hips": 1.02, "neck": 0.40, "inseam": 0.84, "arm_length": 0.60,
         "thigh": 0.58, "shoulder_width": 0.39},
    ),
    "large woman": (
        {"gender": 0.0},
        {"height": 1.62, "chest": 1.06, "waist": 0.94, "hips": 1.12, "neck": 0.36, "inseam": 0.74, "arm_length": 0.53,
         "thigh": 0.64, "shoulder_width": 0.36},
    ),
    "slim woman of 62 kg": ({"gender": 0.0, "weight": 62.0}, {"height": 1.74, "chest": 0.86, "waist": 0.66, "hips": 0.92}),
    "woman, all girths": (
        {"gender": 0.0},
        {"height": 1.65, "chest": 0.88, "underbust": 0.75, "waist": 0.68, "hips": 0.96, "neck": 0.33, "thigh": 0.56,
         "knee": 0.36, "calf": 0.36, "ankle": 0.21, "upper_arm": 0.28, "elbow": 0.24, "wrist": 0.155},
    ),
    "old man": ({"gender": 1.0, "age": 75}, {"height": 1.70, "chest": 1.0, "waist": 0.96, "hips": 1.0, "inseam": 0.77}),
    "girl of 12": ({"gender": 0.0, "age": 12}, {"height": 1.48, "chest": 0.72, "waist": 0.62, "hips": 0.76}),
}  # fmt: skip


def detect(quick: bool) -> list[dict[str, object]]:
    """Distances from the truth, in mm, of the points found on each case, and of those said to be sure."""
    from scan_maker import CASES, case
    from vitruvian.modeling.landmarks import detect as found

    everything, sure, out, times = [], [], [], []
    found(case("man, A pose"))  # the stand-in is made once
    for name in list(CASES)[: 2 if quick else None]:
        s = case(name)
        start = time.perf_counter()
        points = found(s)
        times.append(time.perf_counter() - start)
        off = np.array([np.linalg.norm(p - s.truth[n]) * s.metres * 1000 for n, (p, _) in points.items()])
        trust = np.array([c for _, c in points.values()]) >= 0.7
        everything.append(off)
        sure.append(off[trust])
        title = f"{len(off)} points found on {name}: mean {off.mean():.1f} mm, largest {off.max():.0f}"
        out.append(row(title, times[-1], None, None, off.mean(), "<= 25", off.mean() <= 25))
    off, good = np.concatenate(everything), np.mean(np.concatenate(sure) <= 40)
    second, far = float(np.median(times)), float(np.quantile(off, 0.9))
    out.append(row("all points found: mean, mm", second, None, None, off.mean(), "<= 25", off.mean() <= 25))
    out.append(row("all points found: 90th percentile, mm", second, None, None, far, "<= 50", far <= 50))
    out.append(row("of those sure (0.7), within 40 mm", second, None, None, good, ">= 0.95", good >= 0.95))
    out.append(row("finding, seconds of the slowest", max(times), None, None, max(times), "<= 5", max(times) <= 5))
    return out


def sizes(quick: bool) -> list[dict[str, object]]:
    """How far the finished figure measures from what was asked for, mm."""
    from vitruvian.modeling.measures import measures
    from vitruvian.modeling.person import person

    out = []
    for name, (shape, wishes) in list(SIZES.items())[: 2 if quick else None]:
        start = time.perf_counter()
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            h = person(**shape, measures=wishes)
        seconds = time.perf_counter() - start
        got = measures(h).values
        off = {wish: (got[wish] - want) * 1000 for wish, want in wishes.items()}
        worst = max(off, key=lambda wish: abs(off[wish]))
        title = f"{name}, {len(wishes)} measures asked, worst {worst}, mm" + "".join(f"; {w.message}" for w in said)
        far = abs(off[worst])
        out.append(row(title, seconds, None, None, far, "<= 2", far <= 2, off_mm=off))
    return out


def rows(quick: bool = False) -> list[dict[str, object]]:
    return detect(quick) + sizes(quick)


if __name__ == "__main__":
    main(__doc__, rows)
