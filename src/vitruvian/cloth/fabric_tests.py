"""Fabrics from what laboratories measure: bending length, FAST, KES, tensile curves, and the drape coefficient of Cusick.

Source: note cloth.md, sections 4.6 and 11; Peirce (1930), "The handle of cloth as a measurable quantity"; Cusick (1968),
"The measurement of fabric drape". All but the drape coefficient have closed forms; that one is found by draping discs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import log10
from typing import Any

import numpy as np

from vitruvian.body.types import Floats, require
from vitruvian.cloth.fabric import FABRICS, RANGES, Fabric, bending_from_length, fabric
from vitruvian.cloth.obstacle import Obstacle, still
from vitruvian.cloth.pattern import Edge, Panel, Pattern
from vitruvian.cloth.sheet import Sheet
from vitruvian.cloth.solver import assemble, step, substeps_for
from vitruvian.cloth.tessellate import tessellate
from vitruvian.errors import VitruvianError

DISC = 0.09  # metres: radius of the table that Cusick's fabric lies on
LOAD = 19.6  # N/m at which a tensile curve is read: what cloth bears when it is worn
FAST_LOADS = {"E5": 4.9, "E20": 19.6, "E100": 98.1}  # N/m
SECONDS, CALM = 2.0, 8.0  # of draping; its damping, 1/s
Ask = Callable[[str, float], None]


def modulus(curve: Sequence[Sequence[float]], load: float = LOAD) -> float:
    """N/m: the load over the strain at which a tensile curve, rows of strain and N/m, reaches it; at its end if never."""
    table = np.asarray(curve, np.float64)
    require(
        table.ndim == 2 and table.shape[1] == 2 and len(table) > 0, "tensile", "rows of strain and N/m", table.shape
    )
    table = table[np.argsort(table[:, 1])]
    if table[0, 1] > 0:
        table = np.concatenate([[[0.0, 0.0]], table])
    load = min(load, float(table[-1, 1]))
    strain = float(np.interp(load, table[:, 1], table[:, 0]))
    require(strain > 0 and load > 0, "tensile", "a strain that grows with the load", f"{strain:g} at {load:g} N/m")
    return load / strain


def from_fast(values: Mapping[str, float]) -> dict[str, float]:
    """Fields of a Fabric from FAST: W g/m2; T2 mm; C1 and C2, bending lengths of warp and weft in mm; E5-1, E20-1, E100-1
    (and -2), per cent of extension at 5, 20, 100 gf/cm; EB5, per cent along the bias."""
    out: dict[str, float] = {}
    if "W" in values:
        out["density"] = values["W"] / 1000
    if "T2" in values:
        out["thickness"] = values["T2"] / 1000
    for number, way in (("1", "v"), ("2", "u")):
        if f"C{number}" in values:
            require("W" in values, "FAST", "W, the weight, for bending", "none")
            out[f"bend_{way}"] = bending_from_length(values["W"] / 1000, values[f"C{number}"] / 1000)
        curve = [(values[f"{k}-{number}"] / 100, load) for k, load in FAST_LOADS.items() if f"{k}-{number}" in values]
        if curve:
            out[f"stretch_{way}"] = modulus(curve)
    if "EB5" in values:
        require(values["EB5"] > 0, "FAST EB5", "more than 0 per cent", values["EB5"])
        out["shear"] = 123 / values["EB5"]
    return out


def from_kes(values: Mapping[str, float]) -> dict[str, float]:
    """Fields of a Fabric from KES-F: W mg/cm2; T mm; B-1 and B-2 gf cm2/cm of warp and weft; G gf/(cm degree); EM-1 and
    EM-2, per cent of extension at 500 gf/cm."""
    out: dict[str, float] = {}
    if "W" in values:
        out["density"] = values["W"] / 100
    if "T" in values:
        out["thickness"] = values["T"] / 1000
    for number, way in (("1", "v"), ("2", "u")):
        if f"B-{number}" in values:
            out[f"bend_{way}"] = values[f"B-{number}"] * 9.807e-5
        if f"EM-{number}" in values:
            require(values[f"EM-{number}"] > 0, f"KES EM-{number}", "more than 0 per cent", values[f"EM-{number}"])
            out[f"stretch_{way}"] = 490.3 / (values[f"EM-{number}"] / 100)
    if "G" in values:
        out["shear"] = values["G"] * 56.19
    return out


def fitted(
    name: str,
    *,
    like: str | Fabric = "cotton",
    fast: Mapping[str, float] | None = None,
    kes: Mapping[str, float] | None = None,
    bending_length: float | tuple[float, float] | None = None,
    tensile: Mapping[str, Sequence[Sequence[float]]] | None = None,
    drape: tuple[float, float] | None = None,
    progress: Ask | None = None,
    **known: float,
) -> Fabric:
    """A fabric from measurements; what nobody measured is as in `like`.

    fast, kes: see `from_fast`, `from_kes`; bending_length: metres, of warp and weft; tensile: curves by "warp", "weft" and
    "bias", rows of strain and N/m; known: fields of Fabric, SI; later ones win in this order. drape: Cusick's coefficient,
    0 to 1, and the diameter of the fabric in metres: both bending stiffnesses are scaled until a disc of it drapes so,
    which takes some seconds. Raises VitruvianError for values that make no sense.
    """
    base = fabric(like) if isinstance(like, str) else like
    found: dict[str, float] = {} if fast is None else from_fast(fast)
    found |= {} if kes is None else from_kes(kes)
    curves = {} if tensile is None else dict(tensile)
    require(set(curves) <= {"warp", "weft", "bias"}, "tensile", "warp, weft or bias", ", ".join(curves))
    found |= {f"stretch_{way}": modulus(curves[k]) for k, way in (("warp", "v"), ("weft", "u")) if k in curves}
    wrong = sorted(set(known) - set(RANGES))
    require(not wrong, f"fabric {name}", f"fields {', '.join(RANGES)}", ", ".join(wrong))
    found |= known
    density = found.get("density", base.density)
    if bending_length is not None:
        both = (bending_length, bending_length) if isinstance(bending_length, (int, float)) else bending_length
        found |= {"bend_v": bending_from_length(density, both[0]), "bend_u": bending_from_length(density, both[1])}
    if "poisson" not in found:  # what `like` has may be too much for what was measured
        stiff = found.get("stretch_u", base.stretch_u) / found.get("stretch_v", base.stretch_v)
        found["poisson"] = min(base.poisson, 0.9 * float(np.sqrt(stiff)))
    made = replace(base, name=name, **found)
    if "bias" in curves:
        made = replace(made, shear=_shear(made, modulus(curves["bias"])))
    return made if drape is None else draping_so(made, *drape, progress=progress)


def _shear(cloth: Fabric, bias: float) -> float:
    """Shear stiffness from the modulus at 45 degrees: 4/E = 1/Eu + 1/Ev + 1/G - 2 nu/Eu."""
    rest = 4 / bias - 1 / cloth.stretch_u - 1 / cloth.stretch_v + 2 * cloth.poisson / cloth.stretch_u
    require(rest > 0, f"fabric {cloth.name}: tensile of the bias", "softer than warp and weft allow", f"{bias:g} N/m")
    return 1 / rest


@dataclass(frozen=True)
class Drape:
    """A disc of fabric on Cusick's table: coefficient 0 to 1, folds, and the outline of its shadow (a,) metres by angle."""

    coefficient: float
    folds: int
    outline: Floats


def draped(cloth: Fabric, diameter: float = 0.30, *, size: float = 0.010, seconds: float = SECONDS) -> Drape:
    """A disc of fabric of `diameter` metres falls over a round table of 18 cm; size: metres between its points."""
    require(2 * DISC < diameter <= 0.6, "diameter", "more than 0.18, up to 0.6 m", f"{diameter:g}")
    angle = np.linspace(0, 2 * np.pi, 96, endpoint=False)
    rim = 0.5 * diameter * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    panel = Panel("disc", rim, tuple(Edge(i, (i + 1) % len(rim)) for i in range(len(rim))))
    mesh = tessellate(Pattern("disc", (panel,)), size)
    sheet = Sheet(mesh.triangles, mesh.grain[mesh.triangles], np.zeros(len(mesh.triangles), np.int32), (cloth,))
    table = _table(DISC, 0.15)
    x = np.stack([mesh.material[:, 0], np.full(sheet.count, table.offset), mesh.material[:, 1]], axis=1)
    x[:, 1] += 1e-4 * np.random.default_rng(0).normal(size=len(x))  # else it would not know where to fold
    ready = assemble(sheet, gap=max(1e-3, cloth.thickness))
    state, substeps = ready.state(x), substeps_for(ready)
    for _ in range(round(60 * seconds)):
        state = step(ready, state, obstacle=table, damping=CALM, substeps=substeps)
    outline = _outline(state.x.astype(np.float64), sheet)
    shadow, whole = float(np.mean(np.pi * np.maximum(outline, DISC) ** 2)), np.pi * (0.5 * diameter) ** 2
    waves = np.abs(np.fft.rfft(outline - outline.mean()))[:20]
    return Drape((shadow - np.pi * DISC**2) / (whole - np.pi * DISC**2), int(np.argmax(waves)), outline)


def _table(radius: float, height: float) -> Obstacle:
    """A round table whose top is at 0."""
    count = 64
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    ring = np.stack([radius * np.cos(angle), np.zeros(count), radius * np.sin(angle)], axis=1)
    vertices = np.concatenate([ring, ring - [0, height, 0], [[0, 0, 0], [0, -height, 0]]])
    i = np.arange(count)
    j, low = (i + 1) % count, i + count
    top, bottom = np.full(count, 2 * count), np.full(count, 2 * count + 1)
    sides = [(top, j, i), (bottom, low, j + count), (i, j, low), (j, j + count, low)]
    return still(vertices, np.concatenate([np.stack(t, axis=1) for t in sides]).astype(np.int32))


def _outline(x: Floats, sheet: Sheet, count: int = 720) -> Floats:
    """(count,) how far the shadow reaches from the middle, in each direction."""
    a, b = (x[sheet.edges[:, k]][:, [0, 2]] for k in (0, 1))
    out = np.zeros(count)
    for i, angle in enumerate(np.linspace(0, 2 * np.pi, count, endpoint=False)):
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        sa, sb = a @ across, b @ across
        hit = (sa <= 0) != (sb <= 0)
        share = sa[hit] / (sa[hit] - sb[hit])
        out[i] = np.max(a[hit] @ along * (1 - share) + b[hit] @ along * share, initial=0.0)
    return out


def draping_so(
    cloth: Fabric, coefficient: float, diameter: float = 0.30, *, rounds: int = 8, progress: Ask | None = None
) -> Fabric:
    """The fabric, its bending stiffnesses scaled so that a disc of it has this drape coefficient, to about 0.01.

    Raises VitruvianError where no stiffness does that.
    """
    require(0 < coefficient < 1, "drape coefficient", "0 to 1", f"{coefficient:g}")
    ratio = cloth.bend_v / cloth.bend_u if cloth.bend_u > 0 else 1.0
    scaled = lambda exponent: replace(cloth, bend_u=10.0**exponent, bend_v=min(ratio * 10.0**exponent, 1e-2))  # noqa: E731
    low, high = -6.5, -3.0
    ends = [draped(scaled(e), diameter).coefficient for e in (low, high)]
    if not ends[0] <= coefficient <= ends[1]:
        reach = f"{ends[0]:.2f} to {ends[1]:.2f}"
        raise VitruvianError(f"fabric {cloth.name}: drape coefficient: expected {reach}, found {coefficient:g}")
    start = log10(max(cloth.bend_u, 1e-7))
    for k in range(rounds):
        middle = start if k == 0 and low < start < high else 0.5 * (low + high)
        if draped(scaled(middle), diameter).coefficient < coefficient:
            low = middle
        else:
            high = middle
        if progress:
            progress("draping discs", (k + 1) / rounds)
    return scaled(0.5 * (low + high))


def fabric_of(values: Mapping[str, Any], *, progress: Ask | None = None) -> Fabric:
    """A fabric from what a file says: `name`, `like` (a preset), fields of Fabric in SI, and `measured` with the arguments
    of `fitted`: fast, kes, bending_length, tensile, drape [coefficient, metres]. Raises VitruvianError for the rest."""
    name, like = values.get("name"), values.get("like", "cotton")
    require(isinstance(name, str) and bool(name), "fabric", "a name", repr(name)[:40])
    require(isinstance(like, str), "fabric: like", f"one of {', '.join(FABRICS)}", repr(like)[:40])
    measured = values.get("measured", {})
    require(isinstance(measured, Mapping), "fabric: measured", "an object", repr(measured)[:40])
    allowed = {"fast", "kes", "bending_length", "tensile", "drape"}
    own = {k: v for k, v in values.items() if k not in {"name", "like", "measured"}}
    wrong = sorted((set(measured) - allowed) | (set(own) - set(RANGES)))
    require(not wrong, f"fabric {name}", f"{', '.join(sorted(allowed))} or a field of it", ", ".join(wrong)[:80])
    try:
        numbers = {k: float(v) for k, v in own.items()}
        tests: dict[str, Any] = {
            k: {q: float(v) for q, v in measured[k].items()} for k in ("fast", "kes") if k in measured
        }
        if "bending_length" in measured:
            length = np.asarray(measured["bending_length"], np.float64).reshape(-1)
            require(len(length) in (1, 2), f"fabric {name}: bending_length", "one or two lengths", len(length))
            tests["bending_length"] = (float(length[0]), float(length[-1]))
        if "tensile" in measured:
            tests["tensile"] = {str(k): [[float(n) for n in row] for row in v] for k, v in measured["tensile"].items()}
        if "drape" in measured:
            coefficient, diameter = measured["drape"]
            tests["drape"] = (float(coefficient), float(diameter))
    except (TypeError, ValueError, AttributeError) as e:
        raise VitruvianError(f"fabric {name}: expected numbers, found {e}") from e
    return fitted(name, like=like, progress=progress, **tests, **numbers)  # type: ignore[arg-type]


def values_of(cloth: Fabric) -> dict[str, Any]:
    """What a file says of a fabric."""
    return {f.name: getattr(cloth, f.name) for f in fields(cloth)}
