"""Inverse kinematics while a handle is dragged: a move of one limb and of the whole body, beside `vt.reach` for each."""

from __future__ import annotations

import statistics
import time

import numpy as np
from _rows import main, row

GOALS = ("l_hand", "r_hand", "l_foot", "r_foot", "head", "pelvis")


def moves(name: str, held: tuple[str, ...], count: int, goal: float) -> dict:
    """A handle led round a loop of 20 cm, the others held: seconds of a move, interleaved with `reach` for the same."""
    import vitruvian as vt
    from vitruvian.motion.dragging import Drag, handles

    skeleton = vt.pack(vt.person(outfit=None, hair="none")).skeleton
    table = {h.name: h for h in handles(skeleton)}
    rest = {n: h.point for n, h in table.items() if h.main}
    spots = {"l_hand": "l_radiocarpal", "r_hand": "r_radiocarpal", "l_foot": "l_talocrural", "r_foot": "r_talocrural"}
    spots |= {"head": "skull_tip", "pelvis": "humanoid_root"}
    drag = Drag(skeleton, skeleton.rotation, skeleton.translation[0], (name, *held))
    ours, theirs, short = [], [], []
    for k in range(count):
        a = 2 * np.pi * k / count
        place = rest[name] + 0.2 * np.array([np.sin(a), 1 - np.cos(a), 0.5 * np.sin(2 * a)])
        begin = time.perf_counter()
        found = drag.to({name: place})
        ours.append(time.perf_counter() - begin)
        short.append(float(found.residual[0]))
        if k % 5 == 0:
            goals = {spots[n]: place if n == name else rest[n] for n in (name, *held)}
            begin = time.perf_counter()
            vt.reach(skeleton, None, goals, root=bool(held))
            theirs.append(time.perf_counter() - begin)
    mine, yours = statistics.median(ours), statistics.median(theirs)
    title = f"a move of {name}, {len(held)} others held" if held else f"a move of {name}"
    more = {"p95_s": float(np.quantile(ours, 0.95)), "short_mm": 1000 * statistics.median(short)}
    return row(title, mine, "vt.reach, unprepared", yours, mine / yours, f"<= {1000 * goal:g} ms", mine <= goal, **more)


def rows(quick: bool = False) -> list[dict]:
    count = 60 if quick else 400
    return [
        *(moves(name, (), count, 0.2e-3) for name in ("l_hand", "r_foot")),
        moves("l_hand", GOALS[1:], count, 2e-3),
    ]


if __name__ == "__main__":
    main(__doc__, rows)
