"""How far one surface is from another: signed distances, their figures for the whole and for each part of the body.

The closest point of a surface answers unless it is far, faces another way or lies on the border of a hole: there nothing
is known, and nothing is counted. Source: note body.md, section 3, step 4 (which points of a scan answer).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, floats, indices, require
from vitruvian.errors import VitruvianError, warn
from vitruvian.modeling import shrink

FAR = 0.05  # metres: what is farther answers nothing
STEEP = np.radians(75)  # between normals
INWARD = 0.7  # share of answers that face inward, above which a surface is inside out
HIDDEN = 0.004  # metres: what is farther has to be the nearest to its answer, too, or nearly so
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "dm": 0.1, "ft": 0.3048}
LOST = 0.5  # share without an answer, above which the surfaces are not in one place


@dataclass(frozen=True, eq=False)
class Gaps:
    """From a surface's points to another surface: `mm` (V,) signed, positive where the surface stands out of the other,
    NaN where the other has a hole; `area` (V,) m2 of each point, 0 for what is not looked at; `part` (V,) of the body,
    "" without; `back` (N,) mm from the other's points to the surface, only those nearer than `FAR`."""

    mm: Floats
    area: Floats
    part: NDArray[np.str_]
    back: Floats

    @property
    def holes(self) -> float:
        """Share of the area that the other surface does not answer."""
        total = float(self.area.sum())
        return float(self.area[np.isnan(self.mm)].sum()) / total if total > 0 else 1.0

    def numbers(self) -> dict[str, Any]:
        """Figures in mm: mean, rms, p95 and max of the distance, bias (the signed mean), by area; `holes` a share; the
        same for each part, and `back` for the way back, by points."""
        answered = (self.area > 0) & np.isfinite(self.mm)
        document: dict[str, Any] = {**_figures(self.mm[answered], self.area[answered]), "holes": self.holes}
        parts = {}
        for name in sorted(set(self.part[self.area > 0]) - {""}):
            mine = self.part == name
            some = answered & mine
            whole = float(self.area[mine].sum())
            known = float(self.area[some].sum())
            parts[str(name)] = {
                **_figures(self.mm[some], self.area[some]),
                "holes": 1 - known / whole if whole else 1.0,
            }
        return document | {"parts": parts, "back": _figures(self.back, np.ones(len(self.back)))}

    def histogram(self, reach: float, bins: int = 48) -> tuple[Floats, Floats]:
        """(bins,) share of the answered area in each of even steps from -reach to reach mm, what is beyond in the first
        and last; (bins + 1,) edges."""
        answered = (self.area > 0) & np.isfinite(self.mm)
        edges = np.linspace(-reach, reach, bins + 1)
        inside = np.clip(self.mm[answered], -reach, reach)
        counts, _ = np.histogram(inside, edges, weights=self.area[answered])
        return counts / max(float(counts.sum()), 1e-12), edges


def _figures(mm: Floats, weight: Floats) -> dict[str, float | None]:
    """None for all where there is nothing to count: JSON knows no infinity."""
    names = ("mean_mm", "rms_mm", "p95_mm", "max_mm", "bias_mm")
    total = float(weight.sum())
    if not len(mm) or total <= 0:
        return dict.fromkeys(names)
    size = np.abs(mm)
    order = np.argsort(size)
    reached = np.cumsum(weight[order]) / total
    p95 = size[order][min(int(np.searchsorted(reached, 0.95)), len(mm) - 1)]
    share = weight / total
    rms = np.sqrt((size**2 * share).sum())
    values = ((size * share).sum(), rms, p95, size.max(), (mm * share).sum())
    return {n: float(v) for n, v in zip(names, values, strict=True)}


def gaps(
    points: Floats,
    triangles: Ints,
    other: shrink.Scan,
    *,
    part: NDArray[np.str_] | None = None,
    counted: NDArray[np.bool_] | None = None,
    far: float = FAR,
) -> Gaps:
    """Signed distances from points (V,3) of triangles (T,3) to another surface, both in metres in one frame.

    part (V,): which part of the body a point is of. counted (T,): triangles that are looked at (None: all), so that hair
    and eyes are not. Surfaces that are inside out are turned. Raises VitruvianError where nothing is counted.
    """
    own = floats(points, "points", None, 3)
    faces = indices(triangles, "triangles", len(own), None, 3)
    some = faces if counted is None else faces[counted]
    require(len(some) > 0, "surface", "at least one triangle to look at", "none")
    used = np.unique(some)
    if _inside_out(own, some):
        some = np.ascontiguousarray(some[:, ::-1])
    if _inside_out(other.vertices, other.triangles):
        other = other.turned()
    skin = shrink.surface(own, some)
    match = shrink.matches(own[used], skin.normals[used], other, distance=far, angle=np.pi, worst=0.0)
    near = _answered(match, other, far)
    alike = (match.normal * skin.normals[used]).sum(axis=1)
    if near.any() and (alike[near] < 0).mean() > INWARD:  # sheets that enclose nothing: the first one tells
        other = other.turned()
        match = shrink.matches(own[used], skin.normals[used], other, distance=far, angle=np.pi, worst=0.0)
        alike = (match.normal * skin.normals[used]).sum(axis=1)
    good = _answered(match, other, far) & (alike > np.cos(STEEP))
    doubt = np.flatnonzero(good & (match.distance > HIDDEN))
    if len(doubt):  # the inside of a mouth: what it finds is answered by the face, which is much nearer to it
        nearer = shrink.closest(match.goal[doubt], skin)[0]
        good[doubt[nearer < 0.3 * match.distance[doubt]]] = False
    side = np.sign(((own[used] - match.goal) * match.normal).sum(axis=1))
    mm = np.full(len(own), np.nan)
    mm[used] = np.where(good, 1000 * side * match.distance, np.nan)
    area = shrink.areas(own, some)
    back = shrink.closest(other.vertices, skin)[0]
    names = np.full(len(own), "") if part is None else np.asarray(part)
    found = Gaps(mm, area, names, 1000 * back[back < far])
    if found.holes > LOST:
        warn(
            f"{found.holes:.0%} of the surface has nothing of the other within {far * 1000:.0f} mm: are both in one place "
            "and pose? (vitruvian fit --pose-out writes a person in the scan's pose)"
        )
    return found


def _answered(match: shrink.Match, other: shrink.Scan, far: float) -> NDArray[np.bool_]:
    """(n,) whether a closest point is near, and not on the border of a hole: beyond it there is nothing."""
    n = len(other.vertices)
    edges = np.sort(other.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1) @ [n, 1]
    keys, count = np.unique(edges, return_counts=True)
    corners = other.triangles[match.face].astype(np.int64)
    away = match.share <= 1e-9  # the corners that a closest point is straight across from
    across = np.stack([corners[:, [1, 2]], corners[:, [2, 0]], corners[:, [0, 1]]], axis=1)  # (n, 3, 2)
    side = np.isin(np.sort(across, axis=2) @ [n, 1], keys[count == 1])
    tip = np.take_along_axis(other.border[corners], match.share.argmax(axis=1)[:, None], axis=1)[:, 0]
    return (match.distance < far) & ~np.where(away.sum(axis=1) == 2, tip, (away & side).any(axis=1))


def _inside_out(points: Floats, triangles: Ints) -> bool:
    """Whether a surface, which may have holes, encloses less than nothing; False for sheets."""
    used = points[triangles]
    a, b, c = (used[:, k] - used.mean(axis=(0, 1)) for k in range(3))
    volume = float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6
    return volume < -0.003 * float(shrink.areas(points, triangles).sum()) ** 1.5  # of a ball it is 0.094


def metres(size: float, like: float, unit: str | None = None) -> float:
    """Metres per unit of a surface of that size (the diagonal of its box) that is near `like` metres.

    `unit`: its name; None: the one that brings the sizes nearest. Raises VitruvianError for unknown names.
    """
    if unit is not None:
        if unit not in UNITS:
            raise VitruvianError(f"--unit: expected one of {', '.join(UNITS)}, found {unit!r}")
        return UNITS[unit]
    if not (size > 0 and like > 0):
        return 1.0
    return min(UNITS.values(), key=lambda f: abs(np.log(size * f / like)))
