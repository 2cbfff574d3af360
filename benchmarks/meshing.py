"""Panels as triangles: how fast, and how good.

Needs ../shared/data/patterns; without them, patterns of our own are meshed. Run: python benchmarks/meshing.py [--quick]
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from _rows import main, row

import vitruvian as vt
from vitruvian.cloth.drafting import DRAFTS, drafted
from vitruvian.cloth.pattern import Pattern
from vitruvian.cloth.tessellate import angles, tessellate

FILES = Path(__file__).resolve().parents[2] / "shared/data/patterns/garmentcode"
MEASURES = {"height": 1.72, "chest": 0.96, "waist": 0.82, "hips": 1.0}
PEER = (1.1, 14_000)  # GarmentCode's box mesh: seconds and faces, note cloth.md, section 12


def patterns() -> list[Pattern]:
    """Real ones where they are, else our own."""
    found = [vt.load(p) for p in sorted(FILES.glob("*.json")) if "truth" not in p.name]
    return found or [drafted(name, MEASURES) for name in DRAFTS]


def rows(quick: bool) -> list[dict[str, object]]:
    """Meshing at 1 cm: seconds for 14k faces, and the sharpest angle of all."""
    seconds, faces, worst, thin = 0.0, 0, 180.0, 0
    for pattern in patterns()[: 3 if quick else None]:
        times = []
        for _ in range(1 if quick else 3):
            start = time.perf_counter()
            mesh = tessellate(pattern, 0.010)
            times.append(time.perf_counter() - start)
        found = np.degrees(angles(mesh))
        seconds, faces = seconds + min(times), faces + len(found)
        worst, thin = min(worst, float(found.min())), thin + int((found < 20).sum())
    ours = seconds / faces * PEER[1]
    return [
        row(
            "meshing 14k faces at 1 cm",
            ours,
            "GarmentCode's box mesh, as measured once on another run",
            PEER[0],
            PEER[0] / ours,
            "at most 0.5 s",
            ours <= 0.5,
            faces=faces,
            smallest_angle=worst,
            under_20_degrees=thin,
        )
    ]


if __name__ == "__main__":
    main(__doc__, rows)
