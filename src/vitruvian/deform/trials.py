"""A deformer on a set of poses: the worst that `quality` finds, and in which pose and round which joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from vitruvian.body.types import Body, Floats, require
from vitruvian.deform.deformer import Deformer
from vitruvian.deform.quality import Gauge, Quality, Report, turned

MOST = 32  # joints that are measured when none are named
# What one wants of each number: the larger one is worse.
_COST = {
    "volume": lambda v: abs(v - 1),
    "area": lambda v: -v,
    "thickness": lambda v: -v,
    "bulge": lambda v: v,
    "folds": lambda v: v,
    "gap": lambda v: v,
    "stretch": lambda v: v,
}


@dataclass(frozen=True)
class Trial:
    """`reports`: one a pose. `worst`: of each number the worst over the poses, of the whole surface. `where`: for each
    number its pose (counted from 0) and the joint round which it was found, "" where it belongs to the whole surface."""

    reports: tuple[Report, ...]
    worst: Quality
    where: dict[str, tuple[int, str]]

    def document(self) -> dict[str, object]:
        """As JSON knows it."""
        return {
            "worst": self.worst.document(),
            "where": {k: {"pose": pose, "joint": joint} for k, (pose, joint) in self.where.items()},
            "poses": [r.document() for r in self.reports],
        }


def trial(deformer: Deformer, matrices: Floats, *, joints: Sequence[str] | None = None) -> Trial:
    """Measures a deformer in poses with joint matrices (F,J,4,4), or one with (J,4,4), against its body at rest.

    `joints`: those round which to lay sections; by default the `MOST` that the poses turn most. Consecutive poses are
    consecutive frames: deformers that follow twists past 180 degrees do so here.
    Raises VitruvianError for shapes that do not fit and for joints that the body does not have.
    """
    m = np.asarray(matrices, dtype=np.float64)
    m = m[None] if m.ndim == 3 else m
    require(len(m) > 0, "matrices", "at least one pose", 0)
    points = deformer(m)
    gauge = Gauge(deformer.body, tuple(most_turned(deformer.body, m) if joints is None else joints))
    reports = tuple(gauge.measure(p, pose) for p, pose in zip(points, m, strict=True))
    worst: dict[str, float] = {}
    where: dict[str, tuple[int, str]] = {}
    for field in fields(Quality):
        cost = _COST[field.name]
        values = [getattr(r.whole, field.name) for r in reports]
        known = [i for i, v in enumerate(values) if v == v]
        at = max(known, key=lambda i: cost(values[i]), default=0)
        worst[field.name] = values[at]
        where[field.name] = (at, _joint(reports[at], field.name) if known else "")
    return Trial(reports, Quality(**worst), where)  # type: ignore[arg-type]


def _joint(report: Report, name: str) -> str:
    """The joint whose own number is that of the whole surface: volume and folds are of the whole."""
    if name in ("volume", "folds"):
        return ""
    value = getattr(report.whole, name)
    return next((j for j, q in report.joints.items() if value and getattr(q, name) == value), "")


def most_turned(body: Body, matrices: Floats) -> list[str]:
    """At most `MOST` joints that poses (F,J,4,4) turn, those that come first in most poses before others."""
    rank: dict[str, int] = {}
    for pose in matrices:
        for place, joint in enumerate(turned(body.skeleton, pose)):
            rank[joint] = min(rank.get(joint, place), place)
    return sorted(rank, key=lambda j: (rank[j], body.skeleton.index[j]))[:MOST]
