"""Every GarmentCode pattern of ../shared sewn and draped on the built-in person made to its measures.

Run: python benchmarks/tailor.py [--quick]. Finest case as in note cloth.md, section 12: 1 cm between points (quick: 2 cm).
"""

from __future__ import annotations

import time
from functools import cache
from pathlib import Path

from _rows import main, row

from vitruvian.body.pack import pack
from vitruvian.body.types import Body
from vitruvian.cloth.pattern import Pattern
from vitruvian.cloth.tailor import tailor
from vitruvian.formats.registry import load
from vitruvian.modeling.person import person
from vitruvian.native import kernels

PATTERNS = Path(__file__).parent.parent.parent / "shared/data/patterns"
# measures of GarmentCode's bodies -> ours; centimetres there
MEASURES = {"height": "height", "bust": "chest", "underbust": "underbust", "waist": "waist", "hips": "hips",
            "arm_length": "arm_length", "leg_circ": "thigh", "wrist": "wrist", "shoulder_w": "shoulder_width"}  # fmt: skip
GENDERS = {"mean_all": 0.5, "mean_female": 0.0, "mean_male": 1.0}
SECONDS, STRAIN = 20.0, 0.05
LOOPS = {"shirt": 4, "pants": 3, "skirt": 2, "dress": 4, "hoody": 4}


@cache
def wearer(name: str) -> Body:
    """The built-in person with the measures of one of GarmentCode's bodies."""
    lines = (PATTERNS / "bodies" / f"{name}.yaml").read_text().splitlines()
    pairs = (line.split(":")[:2] for line in lines if line.startswith("  "))
    found = {MEASURES[k.strip()]: float(v) / 100 for k, v in pairs if k.strip() in MEASURES}
    return pack(person(gender=GENDERS[name], outfit=None, hair="none", measures=found))


def rows(quick: bool = False) -> list[dict[str, object]]:
    """The benchmark's rows: one for each pattern."""
    if kernels() is None or not PATTERNS.is_dir():
        return []
    out = []
    for path in sorted((PATTERNS / "garmentcode").glob("*.json")):
        if path.name.endswith(".truth.json"):
            continue
        pattern = load(path)
        assert isinstance(pattern, Pattern)
        body = wearer(next((n for n in ("mean_female", "mean_male") if n in path.stem), "mean_all"))
        began = time.perf_counter()
        report = tailor(pattern, body, size=0.02 if quick else 0.01).report
        seconds = time.perf_counter() - began
        loops = next(n for word, n in LOOPS.items() if word in path.stem)
        clean = not report["self_intersections"] and not report["penetrating_vertices"] and report["settled"]
        whole = report["seam_gap_max_mm"] < 1 and report["boundary_loops"] == loops and clean
        # seconds for 14,000 faces
        share = seconds / SECONDS * min(1.0, 14_000 / report["faces"])
        words = (
            f"{path.stem}: {report['faces']} faces, seams {report['seam_gap_max_mm']:.2f} mm, "
            f"{report['penetrating_vertices']} inside, {report['self_intersections']} cuts, strain p99 "
            f"{report['strain_p99']:.1%}, {report['boundary_loops']} loops, "
            f"{'at rest' if report['settled'] else 'moving'}"
        )
        good = whole and report["strain_p99"] < STRAIN and share <= 1
        out.append(row(words, seconds, f"{SECONDS:g} s for 14k faces", SECONDS, share, "<= 1, strain < 5 %", good))
    return out


if __name__ == "__main__":
    main(__doc__, rows)
