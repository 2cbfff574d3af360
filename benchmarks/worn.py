"""Clothes worn in real time: what a tick of a stage costs with dressed people on it, and how near their cloth comes to the
full simulation of the same garments.

Run: python benchmarks/worn.py [--quick]. Three people of 13,380 skin vertices walk; goals are those of issue 8 and of note
cloth.md, section 12. The clips of ../shared/data/motion are used where they are there.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from _rows import main, row

import vitruvian as vt
from vitruvian.cloth.drafting import drafted
from vitruvian.cloth.garment import Garment
from vitruvian.cloth.layers import FLOATING
from vitruvian.cloth.proof import Proof, proven
from vitruvian.cloth.wear import Prepared, wear, wearer
from vitruvian.deform.deformer import deformer
from vitruvian.modeling.measures import measures
from vitruvian.native import kernels
from vitruvian.stage.clothes import dressed

MOTIONS = Path(__file__).resolve().parents[2] / "shared" / "data" / "motion"
PEOPLE = (
    ({"gender": 1.0, "age": 40, "height": 1.80, "weight": 0.6}, ("trousers", "tshirt")),
    ({"gender": 0.0, "age": 30, "height": 1.66}, ("trousers", "tshirt")),
    ({"gender": 0.4, "age": 65, "height": 1.70, "weight": 0.7}, ("trousers", "tshirt")),
)
SIZE = 0.0098  # metres between vertices: about 20,000 of each person's clothes
CLIPS = ("cmu_131_01_walk.bvh", "cmu_pirouette.amc")
PERSON, THREE = 1 / 150, 1 / 60  # seconds a tick
NEAR = 0.015  # metres from the full simulation


def wardrobe(who: dict[str, float], names: tuple[str, ...], size: float) -> tuple[vt.Clip, Garment]:
    """Somebody who walks, and what is worn, the outermost with the others below it."""
    h = vt.person(outfit=None, hair="none", **who)
    body, worn = vt.pack(h), []
    for name in names:
        worn.append(vt.tailor(drafted(name, measures(h).values), body, size=size, over=worn))
    return vt.Clip(h, body, vt.walk(body.skeleton, cycles=4)), worn[-1]


def people(quick: bool) -> tuple[list[tuple[vt.Clip, tuple[Prepared, ...]]], float]:
    """Clips and what is prepared of their clothes; the seconds that the last took to prepare."""
    out, took = [], 0.0
    for who, names in PEOPLE[: 1 if quick else None]:
        clip, garment = wardrobe(who, names, 0.02 if quick else SIZE)
        begun = time.perf_counter()
        out.append((clip, wear(garment, wearer(deformer("log", clip.body)))))
        took = time.perf_counter() - begun
    return out, took


def ticks(some: list[tuple[vt.Clip, tuple[Prepared, ...]]], count: int) -> list[float]:
    """Seconds of each tick, skin, cloth and normals."""
    stage = vt.Stage([clip for clip, _ in some], rate=60)
    for name, (_, prepared) in zip(list(stage.actors), some):
        dressed(stage, name, prepared)
    out = []
    for k in range(count + 10):
        begun = time.perf_counter()
        frame = stage.step()
        for posed in frame.actors.values():
            _ = posed.normals
        if k >= 10:
            out.append(time.perf_counter() - begun)
    return out


def cost(some: list[tuple[vt.Clip, tuple[Prepared, ...]]], count: int, took: float) -> list[dict[str, object]]:
    """Rows of what dressed people cost."""
    vertices = [sum(len(p.worn.layer) for p in prepared) for _, prepared in some]
    floating = [
        0 if p.worn.floating is None else len(p.worn.floating.cloth.sheet.triangles) for _, q in some for p in q
    ]
    what = f"{np.mean(vertices):,.0f} cloth vertices each, {sum(floating):,} floating triangles in all"
    rows, medians = [], {}
    for n in sorted({1, len(some)}):
        medians[n] = float(np.median(ticks(some[:n], count)))
        goal = PERSON if n == 1 else THREE
        name = f"{n} dressed, {what}: {1 / medians[n]:.0f} ticks/s"
        rows.append(row(name, medians[n], None, None, None, f"{1000 * goal:.1f} ms", medians[n] <= goal))
    if len(some) > 1:
        many = [some[k % len(some)] for k in range(9)]
        each = float(np.median(ticks(many, count))) / len(many)
        ratio = each / (medians[len(some)] / len(some))
        name = "a person among nine over a person among three"
        rows.append(row(name, each, None, None, ratio, "linear: <= 1.15", ratio <= 1.15))
    rows.append(row("clothes prepared, of one person", took, None, None, None, "printed", True))
    return rows


def likeness(clip: vt.Clip, prepared: tuple[Prepared, ...], quick: bool) -> list[dict[str, object]]:
    """Rows of how good each garment is in the captured clips."""
    person, out = wearer(deformer("log", clip.body)), []
    for name in CLIPS if MOTIONS.is_dir() else ():
        motion = vt.retarget(vt.load(MOTIONS / name), clip.body.skeleton)
        matrices = vt.joint_matrices(clip.body.skeleton, motion)[:: max(1, round(motion.fps / 60))]
        for one in prepared:
            found = proven(one, person, matrices[: 60 if quick else 240])
            out += verdicts(f"{one.garment.name}, {name}", found)
    return out


def verdicts(what: str, found: Proof) -> list[dict[str, object]]:
    """Rows of one proof."""
    s = found.summary()
    near, share = float(found.off.mean()), found.seconds[0] / found.seconds[1]
    bound = float((found.layer != FLOATING).mean())
    return [
        row(f"{what}: to the surface of the full simulation {1000 * near:.1f} mm, to its vertices "
            f"{1000 * found.far.mean():.1f} mm", None, None, None, None, "<= 15 mm", near <= NEAR),
        row(f"{what}: cost over the full simulation's, {bound:.0%} tight or loose", found.seconds[0],
            "all of it simulated", found.seconds[1], share, "<= 0.1", share <= 0.1),
        row(f"{what}: {s['inside']} vertices over 1 mm in the skin in {s['frames_with_any_inside']} of {s['frames']} "
            f"frames, deepest {s['deepest_mm']} mm", None, None, None, None, "0", not found.inside.any()),
        row(f"{what}: largest step at a border over its neighbours' {found.jump:.1f}, strain p99 "
            f"{100 * np.median(found.strain):.0f} %", None, None, None, None, "<= 2", found.jump <= 2),
    ]  # fmt: skip


def rows(quick: bool = False) -> list[dict[str, object]]:
    """The benchmark's rows."""
    if kernels() is None:
        return []
    some, took = people(quick)
    return cost(some, 30 if quick else 120, took) + likeness(*some[0], quick)


if __name__ == "__main__":
    main(__doc__, rows)
