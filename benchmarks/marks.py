"""Feature points found on scans whose truth is known, and people made to measure: how far off, in how many seconds.

Run: python benchmarks/marks.py [detect] [sizes]
"""

from __future__ import annotations

import sys
import time
import warnings
from pathlib import Path

import numpy as np

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


def detect() -> None:
    """A table of cases: seconds, points found, distances from the truth in mm, and of those said to be sure."""
    from scan_maker import CASES, case
    from vitruvian.modeling.landmarks import detect as found

    everything, sure = [], []
    found(case("man, A pose"))  # the stand-in is made once
    print(f"{'scan':52}{'s':>5}{'points':>7}{'mean':>6}{'p90':>6}{'max':>6}{'sure':>6}{'worst sure':>11}")
    for name in CASES:
        s = case(name)
        start = time.perf_counter()
        points = found(s)
        seconds = time.perf_counter() - start
        off = np.array([np.linalg.norm(p - s.truth[n]) * s.metres * 1000 for n, (p, _) in points.items()])
        trust = np.array([c for _, c in points.values()]) >= 0.7
        everything.append(off)
        sure.append(off[trust])
        worst = off[trust].max() if trust.any() else 0.0
        numbers = f"{off.mean():6.1f}{np.quantile(off, 0.9):6.1f}{off.max():6.0f}{trust.sum():6d}{worst:11.0f}"
        print(f"{name:52}{seconds:5.1f}{len(off):7d}{numbers}")
    off, good = np.concatenate(everything), np.concatenate(sure)
    print(f"all: mean {off.mean():.1f} mm (goal 25), 90th percentile {np.quantile(off, 0.9):.1f} mm (goal 50)")
    print(f"confidence >= 0.7: {np.mean(good <= 40) * 100:.1f} % within 40 mm (goal 95 %)")


def sizes() -> None:
    """A table of people made to measure: every wish, what the finished figure measures, and the difference in mm."""
    from vitruvian.modeling.measures import measures
    from vitruvian.modeling.person import person

    worst = 0.0
    for name, (shape, wishes) in SIZES.items():
        start = time.perf_counter()
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            h = person(**shape, measures=wishes)
        seconds = time.perf_counter() - start
        got = measures(h).values
        print(f"{name} ({seconds:.1f} s, {h.info['weight']} kg)" + "".join(f"; {w.message}" for w in said))
        for wish, want in wishes.items():
            off = (got[wish] - want) * 1000
            worst = max(worst, abs(off))
            print(f"  {wish:16}{want * 100:7.1f} cm asked{got[wish] * 100:9.2f} cm measured{off:+7.2f} mm")
    print(f"largest difference {worst:.2f} mm (goal 2)")


if __name__ == "__main__":
    chosen = sys.argv[1:] or ["detect", "sizes"]
    for word in chosen:
        {"detect": detect, "sizes": sizes}[word]()
