"""OpenSim's reference of inverse kinematics: 31 markers of a walk on its gait model, 23 coordinates, 73 frames.

Angles of ours from the model's own geometry beside those of its .mot, coordinate by coordinate. The files are those of
the folder ../shared. `python benchmarks/opensim.py` prints the table and the rows.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from _rows import main, row

from vitruvian.formats.osim import read_osim
from vitruvian.formats.registry import load
from vitruvian.motion.mechanism import Mechanism, coordinates_of

FOLDER = Path(__file__).resolve().parent.parent.parent / "shared" / "data" / "motion"
GOAL = 1.0  # degrees


def compared(folder: Path = FOLDER) -> tuple[Mechanism, np.ndarray, np.ndarray, np.ndarray]:
    """The model, our coordinates and the reference's (F,23), radians and metres, residuals (F,31)."""
    model = read_osim(folder / "opensim_ik_subject01_simbody.osim")
    seen = load(folder / "opensim_ik_subject01_synthetic_marker_data.trc")
    table = load(folder / "opensim_ik_std_subject01_walk1_ik.mot")
    angle, left = coordinates_of(model, seen.names, seen.points)
    truth = table.values[:, [table.columns.index(n) for n in model.coordinates]].copy()
    for c in turning(model):
        truth[:, c] = np.radians(truth[:, c])
    return model, angle, truth, left


def turning(model: Mechanism) -> list[int]:
    """Coordinates that are angles."""
    return [c for c, name in enumerate(model.coordinates) if name[-3:] not in ("_tx", "_ty", "_tz")]


def rows(quick: bool = False) -> list[dict[str, object]]:
    """Two rows: the worst angle and the worst shift. Prints the table of all."""
    if not FOLDER.is_dir():
        return []
    start = time.perf_counter()
    model, ours, theirs, left = compared()
    spent = time.perf_counter() - start
    angles = turning(model)
    rms, most = np.sqrt(((ours - theirs) ** 2).mean(axis=0)), np.abs(ours - theirs).max(axis=0)
    print(f"{'coordinate':<20}{'RMS':>10}{'largest':>10}")
    for c, name in enumerate(model.coordinates):
        by, unit = (np.degrees(1), "degrees") if c in angles else (1000.0, "mm")
        print(f"{name:<20}{rms[c] * by:>10.4f}{most[c] * by:>10.4f} {unit}")
    print(f"markers: {1000 * np.sqrt(np.nanmean(left**2)):.3f} mm off (root mean square)")
    worst = max(float(np.degrees(rms[c])) for c in angles)
    shift = max(float(1000 * rms[c]) for c in range(len(rms)) if c not in angles)
    return [
        row(
            f"OpenSim's walk, {len(ours)} frames: worst angle {worst:.3f} degrees RMS, worst shift {shift:.2f} mm RMS",
            spent,
            "OpenSim's answer",
            None,
            worst,
            f"<= {GOAL:g} degree",
            worst <= GOAL,
        )
    ]


if __name__ == "__main__":
    main(__doc__, rows)
