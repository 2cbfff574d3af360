"""How a garment fits: ease between cloth and skin, strain of the cloth, its pressure on the body, girths by the tape.

Pressure is that of the cloth's own pull: the force with which the stretched triangles round a vertex draw it towards the
skin, over their area. In the limit of a fine mesh that is the law of Laplace, p = T1 / R1 + T2 / R2, without having to
estimate curvatures. The solver's contact is no measure of it: a step of its iteration puts right where vertices are,
and what it adds up to depends on masses and on the length of the step more than on the fabric.

Source: note cloth.md, sections 4.2 (membrane) and 5.6 (fit map).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, floats, require
from vitruvian.cloth.fabric import GRAVITY, Fabric
from vitruvian.cloth.garment import Garment
from vitruvian.cloth.girths import Girth, Ring, girths
from vitruvian.cloth.obstacle import Obstacle
from vitruvian.cloth.sheet import Sheet

TOUCH = 0.004  # metres: cloth as near as that lies on the skin (the solver keeps it 2 mm off)
PRESSED = 2400.0  # Pa: as a light medical stocking presses, 18 mm of mercury; tighter than clothes are meant to be
PULL = 30.0  # N/m: a fabric stretched so far that it pulls as much across any direction is tight ...
STRETCHED = (0.05, 0.3)  # ... but no fabric before the first of these strains, and each beyond the second
ROUNDS = 2  # in which strains are evened out
SHARE = 0.005  # of the garment's area that a tight place has at least


@dataclass(frozen=True)
class Finding:
    """A place where the garment is too tight: which panel, which part of the body, in words; how many times its limit."""

    panel: str
    region: str
    message: str
    severity: float


@dataclass(frozen=True, eq=False)
class FitMap:
    """A garment of n vertices and m triangles on a body.

    ease (n,) metres from the skin, negative inside; pressure (n,) Pa, 0 where it does not lie on the skin; stretch (m,2)
    largest and smallest principal strain; weft, warp (m,) strains along them, 0.1: ten per cent longer; tension (m,) N/m,
    the largest principal pull. panel (m,) of `panels`, region (n,) of `regions`; area (m,) square metres as it hangs.
    girths: of the body and the garment, see `vitruvian.cloth.girths`; limits (m,): the strain above which each triangle
    counts as too tight.
    """

    triangles: Ints
    ease: Floats
    pressure: Floats
    stretch: Floats
    weft: Floats
    warp: Floats
    tension: Floats
    area: Floats
    limits: Floats
    panel: Ints
    panels: tuple[str, ...]
    region: Ints
    regions: tuple[str, ...]
    girths: Mapping[str, Girth] = field(default_factory=dict)

    @property
    def strain(self) -> Floats:
        """(n,) largest principal strain of the triangles round each vertex, their mean by area."""
        return spread(self.stretch[:, 0], self.triangles, self.area, len(self.ease))

    def of_vertices(self, name: str) -> Floats:
        """(n,) `ease`, `pressure`, `strain`, `weft`, `warp` or `tension`, at vertices."""
        values = getattr(self, name)
        return values if len(values) == len(self.ease) else spread(values, self.triangles, self.area, len(self.ease))

    def summary(self) -> dict[str, Any]:
        """As numbers: `ease_mm`, `strain_percent`, `weft_percent`, `warp_percent`, `pressure_kpa` with `min`, `mean` and
        `p99`, of the whole, per panel and per region; `girths`, centimetres; `findings`, the worst first; `contact`: the
        share of the area that lies on the skin."""
        owner = _mode(self.region[self.triangles])
        everything = np.ones(len(self.triangles), bool)
        return {
            "all": self._figures(everything),
            "panels": {n: self._figures(self.panel == k) for k, n in enumerate(self.panels)},
            "regions": {n: self._figures(owner == k) for k, n in enumerate(self.regions) if n and np.any(owner == k)},
            "girths": {name: g.told() for name, g in self.girths.items()},
            "findings": [f.message for f in self.findings()],
        }

    def _figures(self, some: NDArray[np.bool_]) -> dict[str, Any]:
        weight = np.bincount(self.triangles[some].ravel(), np.repeat(self.area[some] / 3, 3), len(self.ease)).astype(
            float
        )
        mine = weight > 0
        at = lambda values, unit: _spread_of(unit * values[mine], weight[mine])  # noqa: E731
        on = lambda values: _spread_of(100 * values[some], self.area[some])  # noqa: E731
        touching = self.ease[mine] <= TOUCH
        return {
            "ease_mm": at(self.ease, 1000),
            "strain_percent": on(self.stretch[:, 0]),
            "weft_percent": on(self.weft),
            "warp_percent": on(self.warp),
            "pressure_kpa": at(self.pressure, 1e-3),
            "contact": float((weight[mine] * touching).sum() / max(weight.sum(), 1e-12)),
        }

    def findings(self) -> list[Finding]:
        """Where it is too tight, the worst first: by stretch and pressure of the tighter half of each panel's part on
        each region, and by girths that the stretched cloth could not lend."""
        out = []
        along = np.maximum(self.weft, self.warp)  # not on the bias: cloth shears easily, which is no tightness
        owner, on = _mode(self.region[self.triangles]), self.pressure[self.triangles].mean(axis=1)
        total = self.area.sum()
        for k, panel in enumerate(self.panels):
            for r, region in enumerate(self.regions):
                some = (self.panel == k) & (owner == r)
                if not region or self.area[some].sum() < SHARE * total:
                    continue
                strain, limit = float(np.quantile(along[some], 0.75)), float(self.limits[some].mean())
                press = float(np.quantile(on[some], 0.75))
                much = max(strain / limit, press / PRESSED)
                if much <= 1:
                    continue
                across = self.weft[some].mean() >= self.warp[some].mean()
                how = f"stretched {strain:.0%}, most {'across, along the weft' if across else 'lengthwise, along the warp'}"
                if press >= 0.1 * PRESSED:
                    how += f", and presses with {press / 1000:.1f} kPa"
                out.append(Finding(panel, region, f"too tight here: {panel} at the {region}: {how}", much))
        for name, g in self.girths.items():
            stretch, limit = -g.ease / g.cloth, float(np.median(self.limits))
            if stretch > limit:
                text = f"the cloth measures {100 * g.cloth:.1f} cm, the body {100 * g.body:.1f} cm"
                place = name.replace("_", " ")
                out.append(Finding("", place, f"too small at the {place}: {text}", stretch / limit))
        return sorted(out, key=lambda f: -f.severity)


def fit_map(
    garment: Garment,
    obstacle: Obstacle,
    *,
    regions: NDArray[np.str_] | None = None,
    rings: Mapping[str, Ring] | None = None,
) -> FitMap:
    """How a garment fits the surface that it lies on.

    obstacle: the body as it stands, see `vitruvian.cloth.obstacle.still`; regions (V,): what part of the body each of its
    vertices is; rings: tapes round it. `vitruvian.stage.fitting_room.fit_of` has both for a humanoid.
    """
    x, sheet = garment.vertices, garment.sheet
    names = np.full(len(obstacle.before), "body") if regions is None else np.asarray(regions)
    require(len(names) == len(obstacle.before), "regions", f"{len(obstacle.before)} names", len(names))
    place, number = np.unique(names, return_inverse=True)
    ease, corner, normal = _feet(obstacle, x)
    f = evened(gradients(sheet, x), garment.mesh.triangles, sheet.areas)
    weft, warp, stretch = principal(f)
    force, tension = pulls(sheet, f, len(x))
    return FitMap(
        garment.triangles,
        ease,
        pressures(sheet, x, force, normal, ease <= TOUCH),
        stretch,
        weft,
        warp,
        tension,
        _areas(x, sheet.triangles),
        np.array([limit_of(f) for f in sheet.fabrics])[sheet.fabric],
        garment.mesh.panel[garment.mesh.triangles[:, 0]],
        tuple(p.name for p in garment.pattern.panels),
        number.reshape(-1)[corner].astype(np.int32),
        tuple(map(str, place)),
        girths(sheet, x, rings or {}),
    )


def limit_of(fabric: Fabric) -> float:
    """The strain above which a fabric counts as too tight."""
    softer = min(fabric.stretch_u, fabric.stretch_v)
    return float(np.clip(PULL / softer, *STRETCHED))


def principal(f: Floats) -> tuple[Floats, Floats, Floats]:
    """Strains of deformations (m,3,2): along weft (m,) and warp (m,), and the largest and smallest (m,2)."""
    c = np.einsum("mki,mkj->mij", f, f)
    middle, half = 0.5 * (c[:, 0, 0] + c[:, 1, 1]), 0.5 * (c[:, 0, 0] - c[:, 1, 1])
    radius = np.hypot(half, c[:, 0, 1])
    both = np.sqrt(np.maximum(np.stack([middle + radius, middle - radius], axis=1), 0)) - 1
    return np.sqrt(c[:, 0, 0]) - 1, np.sqrt(c[:, 1, 1]) - 1, both


def gradients(sheet: Sheet, x: Floats) -> Floats:
    """(m,3,2): what becomes of a metre along weft and warp in each triangle."""
    x = floats(x, "positions", None, 3)
    e, now = sheet.material[:, 1:] - sheet.material[:, :1], x[sheet.triangles]
    return np.swapaxes(now[:, 1:] - now[:, :1], 1, 2) @ np.linalg.inv(np.swapaxes(e, 1, 2))


def evened(f: Floats, triangles: Ints, area: Floats, rounds: int = ROUNDS) -> Floats:
    """(m,3,2) deformations as they are, with stretches that are the mean of those near by in the same panel.

    triangles (m,3) of the panels, not welded. Where cloth pulls against a body, the solver works off one constraint after
    the other and leaves those that come last less stretched than their neighbours; over some triangles it evens out."""
    c = np.einsum("mki,mkj->mij", f, f)
    u = stretch_of(c)
    way = f @ np.linalg.inv(u)
    corners, count = triangles.ravel(), int(triangles.max(initial=-1)) + 1
    total = np.bincount(corners, np.repeat(area, 3), count)
    for _ in range(rounds):
        for i, j in ((0, 0), (0, 1), (1, 1)):
            at = np.bincount(corners, np.repeat(area * u[:, i, j], 3), count) / np.maximum(total, 1e-30)
            u[:, i, j] = u[:, j, i] = at[triangles].mean(axis=1)
    return way @ u


def stretch_of(c: Floats) -> Floats:
    """(m,2,2) symmetric roots of (m,2,2) symmetric, positive."""
    root = np.sqrt(np.maximum(np.linalg.det(c), 1e-24))
    out = c + root[:, None, None] * np.eye(2)
    return out / np.sqrt(np.einsum("mii->m", c) + 2 * root)[:, None, None]


def pulls(sheet: Sheet, f: Floats, count: int) -> tuple[Floats, Floats]:
    """(n,3) newtons with which the stretched cloth pulls each of `count` vertices, and (m,) N/m, the largest pull of each
    triangle, from its deformation (m,3,2).

    The fabric's law is the solver's: strains along weft and warp and their shear times moduli. Where that would push, the
    cloth wrinkles instead: only the pulling part of the stress is kept (tension field)."""
    size = np.linalg.norm(f, axis=1)
    u, v = f[:, :, 0] / size[:, :1], f[:, :, 1] / size[:, 1:]
    table = np.array([[g.stretch_u, g.stretch_v, g.poisson, g.shear] for g in sheet.fabrics])[sheet.fabric]
    eu, ev, nu, shear = table.T
    a, b, c = size[:, 0] - 1, size[:, 1] - 1, np.sum(f[:, :, 0] * f[:, :, 1], axis=1)
    # the inverse of [[1/Eu, -nu/Eu], [-nu/Eu, 1/Ev]]
    scale = 1 / (1 - nu * nu * ev / eu)
    su, sv, s = scale * (eu * a + nu * ev * b), scale * (nu * ev * a + ev * b), shear * c
    middle, half = 0.5 * (su + sv), 0.5 * (su - sv)
    radius = np.hypot(half, s)
    high, low = middle + radius, middle - radius
    first, second = np.maximum(high, 0), np.maximum(low, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        way = np.where(radius > 1e-12, (first - second) / (2 * radius), 0.0)
    mean = 0.5 * (first + second)
    su, sv, s = mean + way * half, mean - way * half, way * s
    p = np.stack([su[:, None] * u + s[:, None] * v, s[:, None] * u + sv[:, None] * v], axis=2)  # (m,3,2) N/m
    e = sheet.material[:, 1:] - sheet.material[:, :1]
    shape = np.linalg.inv(np.swapaxes(e, 1, 2))  # rows: gradients of the second and third corner's share
    corner = -sheet.areas[:, None, None] * (p @ np.swapaxes(shape, 1, 2))
    out = np.zeros((count, 3))
    for k in range(3):
        mine = -corner.sum(axis=2) if k == 0 else corner[:, :, k - 1]
        for axis in range(3):
            out[:, axis] += np.bincount(sheet.triangles[:, k], mine[:, axis], count)
    return out, first


def pressures(sheet: Sheet, x: Floats, force: Floats, normal: Floats, touching: NDArray[np.bool_]) -> Floats:
    """(n,) Pa: of the cloth's pull (n,3) N and its weight on skin with normals (n,3), where it touches; each vertex with
    its neighbours, so that what one bears for the other counts for both."""
    weight = np.zeros_like(force)
    weight[:, 1] = -GRAVITY * sheet.masses
    area = np.bincount(sheet.triangles.ravel(), np.repeat(_areas(x, sheet.triangles) / 3, 3), len(x))
    pushed = np.where(touching, -np.sum((force + weight) * normal, axis=1), 0.0)
    area = np.where(touching, area, 0.0)
    a, b = sheet.edges.T
    over = lambda q: q + np.bincount(a, q[b], len(q)) + np.bincount(b, q[a], len(q))  # noqa: E731
    return np.where(touching, np.maximum(over(pushed), 0) / np.maximum(over(area), 1e-12), 0.0)


def spread(values: Floats, triangles: Ints, area: Floats, count: int) -> Floats:
    """(n,) of values (m,) of triangles: the mean of those round each vertex, by area."""
    corners = triangles.ravel()
    total = np.bincount(corners, np.repeat(area, 3), count)
    return np.bincount(corners, np.repeat(area * values, 3), count) / np.maximum(total, 1e-30)


def _feet(obstacle: Obstacle, x: Floats) -> tuple[Floats, Ints, Floats]:
    """Signed distance (n,), the nearest of the foot's corners (n,) and the surface's normal at the foot (n,3)."""
    from vitruvian.cloth.binding import feet

    face, share, _ = feet(obstacle.before, obstacle.triangles, x)
    corners = obstacle.triangles[face]
    normal = np.einsum("nk,nkx->nx", share, obstacle.start[corners, 3:].astype(np.float64))
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    return obstacle.distances(x), corners[np.arange(len(x)), share.argmax(axis=1)], normal


def _areas(x: Floats, triangles: Ints) -> Floats:
    corner = x[triangles]
    return 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)


def _mode(corners: Ints) -> Ints:
    """(m,) of three numbers the one that is there twice, or the first."""
    return np.where(corners[:, 1] == corners[:, 2], corners[:, 1], corners[:, 0]).astype(np.int32)


def _spread_of(values: Floats, weight: Floats) -> dict[str, float]:
    if not len(values):
        return {"min": 0.0, "mean": 0.0, "p99": 0.0, "max": 0.0}
    mean = float(np.sum(values * weight) / max(float(weight.sum()), 1e-30))
    return {
        "min": float(values.min()), "mean": mean, "p99": float(np.quantile(values, 0.99)), "max": float(values.max())
    }  # fmt: skip
