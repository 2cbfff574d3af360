"""Which deformer? The same pose under four of them, side by side, with what each does to the surface in numbers.

Elbow and knee are bent far, a hand is turned over on its forearm, an arm is lifted. Bands and stripes are drawn across the
seams: where a surface slips, folds or collapses, they show it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import vitruvian as vt
from vitruvian.show.comparison import compare


def main(out: Path = Path("out/examples")) -> None:
    out.mkdir(parents=True, exist_ok=True)
    person = vt.person(outfit="body suit")
    reports = compare(person, out / "which-deformer.png")
    print(f"{'':<10} volume  least area  thickness  bulge")
    for name, report in reports.items():
        all_of_it, wrist = report.whole, report.joints["r_radiocarpal"]
        print(
            f"{name:<10} {all_of_it.volume:.3f}   {all_of_it.area:10.2f}  {all_of_it.thickness:9.2f}  "
            f"{all_of_it.bulge:5.2f}   turned wrist: {wrist.area:.2f} of its area"
        )
    wrist = {name: r.joints["r_radiocarpal"] for name, r in reports.items()}
    knee = {name: r.joints["l_knee"] for name, r in reports.items()}
    assert wrist["linear"].area < 0.5  # the candy wrapper
    assert min(wrist[n].area for n in ("log", "volume", "contours")) > 0.85
    assert knee["linear"].thickness < 0.65 < 0.85 < min(knee[n].thickness for n in ("log", "volume", "contours"))
    assert knee["volume"].bulge < knee["log"].bulge
    assert all(r.whole.gap < 1e-6 for r in reports.values())  # no seam opens


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
