"""Universal Scene Description: figures as UsdSkel, meshes, and caches of deformed points.

UsdSkel skins linearly with any number of influences, so nothing is pruned; what a displacer or another deformer than
"linear" does differently is measured and reported. How joints become UsdSkel's is said in `usd_figure`.
Source: the UsdGeom, UsdSkel, UsdShade and UsdUtils documentation of OpenUSD.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vitruvian import __version__
from vitruvian.body.kinematics import joint_matrices
from vitruvian.body.types import Floats, Part, Skin, Weights
from vitruvian.errors import MissingExtra, VitruvianError
from vitruvian.formats.atomic import atomic
from vitruvian.stage.clip import Clip, Mesh

UNITS = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
CLOTH = 0.002  # metres that points of caches may be off
_HELD = 1 << 26  # bytes of deformed points that are held at once


def require_usd() -> None:
    """Raise `MissingExtra` when usd-core is not installed."""
    try:
        import pxr  # noqa: F401
    except ImportError:
        raise MissingExtra("usd", "USD (.usd, .usda, .usdc, .usdz)") from None


def write_usd(
    thing: Clip | Mesh | Sequence[Clip | Mesh], path: str | os.PathLike[str], *, bake: bool = False, fps: float = 24.0,
    tolerance: float = CLOTH,
) -> dict[str, Any]:  # fmt: skip
    """Write a Clip or Mesh, or a list of them, as .usda (text), .usdc, .usd (binary) or .usdz (package).

    bake: instead of a skeleton, the points that the clip's own deformer makes, frame by frame, for players without
    UsdSkel and for deformers that are not linear; a list of Meshes with the same triangles becomes one moving mesh at
    `fps` frames per second. tolerance: metres that points of the clips' caches may be off in any frame; they are written
    at as many times as that takes.
    The report: `vertices triangles joints bytes`; `influences`, the most joints of a vertex; `overweight_vertices`,
    whose weights had to be divided by a sum above one; `max_vertex_error_m` and `rms_vertex_error_m` of rounding sums
    to one, over `poses`; `cloth`, of each cache its `name frames points keys max_error_m tolerance_m closing_m`;
    `deformer` and `deformer_difference_m`, the largest distance between the clip's own deformer
    and the linear skin that players show; `displacer_error_m`; `lost`, a list of sentences.
    Raises `MissingExtra` without usd-core and `VitruvianError` for things that can't be written.
    """
    require_usd()
    things: list[Any] = list(thing) if isinstance(thing, list | tuple) else [thing]
    if not things:
        raise VitruvianError("USD: expected something to write, found an empty list")
    if not 0 < fps < 1e5:
        raise VitruvianError(f"fps: expected frames per second above zero, found {fps}")
    report: dict[str, Any] = {"vertices": 0, "triangles": 0, "joints": 0, "lost": [], "max_vertex_error_m": 0.0}
    empty = [isinstance(t, Clip) and t.motion is not None and not len(t.motion) for t in things]
    things = [replace(t, motion=None) if e else t for t, e in zip(things, empty)]
    meshes = [t for t in things if isinstance(t, Mesh)]
    sequence = bake and len(meshes) == len(things)
    rates = [t.motion.fps for t in things if isinstance(t, Clip) and t.motion is not None]
    stage = Stage(rates[0] if rates else fps, Path(path), several=len(things) > 1 and not sequence)
    if sequence:
        _sequence(stage, meshes, fps, report)
    else:
        from vitruvian.formats.usd_figure import figure

        for item in things:
            if isinstance(item, Mesh):
                _sequence(stage, [item], fps, report)
            else:
                _clothes(stage, item, (_cache if bake else figure)(stage, item, report), tolerance, report)
    with atomic(path) as temporary:
        stage.export(temporary, Path(path).stem)
        report["bytes"] = temporary.stat().st_size
    report["lost"] += stage.pictures.lost()
    return report


def identifier(name: str, taken: set[str]) -> str:
    """`name` as a USD identifier that is not in `taken`, to which it is added."""
    from pxr import Sdf, Tf

    plain = name if name and Sdf.Path.IsValidIdentifier(name) else Tf.MakeValidIdentifier(name or "unnamed")
    out, k = plain, 1
    while out in taken:
        out, k = f"{plain}_{k}", k + 1
    taken.add(out)
    return out


class Stage:
    """A USD stage being written, at `rate` time codes per second. Several things hang under one root; `pictures` go
    beside the file of that `path`, or into the package."""

    def __init__(self, rate: float, path: Path, *, several: bool = False):
        from pxr import Kind, Usd, UsdGeom

        from vitruvian.formats.pictures import Addresses

        self.pictures = Addresses(path, beside=True)

        self.usd = Usd.Stage.CreateInMemory()
        self.rate = float(rate)
        self.last = -1.0
        self.taken: set[str] = set()
        self.root = None
        UsdGeom.SetStageUpAxis(self.usd, UsdGeom.Tokens.y)
        UsdGeom.SetStageMetersPerUnit(self.usd, 1.0)
        self.usd.GetRootLayer().customLayerData = {"creator": f"vitruvian {__version__}"}
        if several:
            self.root = UsdGeom.Xform.Define(self.usd, "/scene").GetPrim()
            Usd.ModelAPI(self.root).SetKind(Kind.Tokens.group)
            self.usd.SetDefaultPrim(self.root)

    def top(self, kind: str, name: str) -> Any:
        """A new component: under the scene's root when there is one, else the default prim."""
        from pxr import Kind, Usd

        above = "" if self.root is None else str(self.root.GetPath())
        prim = self.usd.DefinePrim(f"{above}/{identifier(name, self.taken)}", kind)
        Usd.ModelAPI(prim).SetKind(Kind.Tokens.component)
        if self.root is None:
            self.usd.SetDefaultPrim(prim)
        return prim

    def codes(self, frames: int, fps: float) -> list[float]:
        """The time codes of that many frames; the stage's range grows to hold them."""
        codes = [k * self.rate / fps for k in range(frames)]
        self.last = max(self.last, codes[-1])
        return codes

    def export(self, path: Path, stem: str) -> None:
        """Write the stage as the ending of `path` says; a package holds one binary layer named by `stem`."""
        if self.last >= 0:
            self.usd.SetTimeCodesPerSecond(self.rate)
            self.usd.SetFramesPerSecond(self.rate)
            self.usd.SetStartTimeCode(0.0)
            self.usd.SetEndTimeCode(self.last)
        layer = self.usd.GetRootLayer()
        if path.suffix.lower() != ".usdz":
            self._write(layer, path)
            self.pictures.write()
            return
        from pxr import Sdf, UsdUtils

        with tempfile.TemporaryDirectory(prefix=".usdz-", dir=path.parent) as folder:
            inner = Path(folder) / f"{identifier(stem, set())}.usdc"
            self._write(layer, inner)
            self.pictures.write(Path(folder))
            if not UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(inner)), str(path)):
                raise VitruvianError(f"{path}: the USD library could not write the package")

    @staticmethod
    def _write(layer: Any, path: Path) -> None:
        if not layer.Export(str(path)):
            raise VitruvianError(f"{path}: the USD library could not write the file")


def place(prim: Any, placement: Floats) -> None:
    """One matrix as the prim's transform; nothing for the identity."""
    from pxr import Gf, UsdGeom

    if not np.allclose(placement, np.eye(4), rtol=0, atol=1e-15):
        matrix = Gf.Matrix4d(*[float(x) for x in placement.T.reshape(-1)])
        UsdGeom.Xformable(prim).AddTransformOp().Set(matrix)


def _sequence(stage: Stage, meshes: list[Mesh], fps: float, report: dict[str, Any]) -> None:
    """One Mesh, or the frames of a moving one."""
    from vitruvian.formats.usd_mesh import Surface, write_surface

    first = meshes[0]
    for k, mesh in enumerate(meshes):
        if not np.array_equal(mesh.triangles, first.triangles) or len(mesh.vertices) != len(first.vertices):
            raise VitruvianError(f"mesh {k} of the list: expected the triangles of the first one, found others")
    points = [m.vertices * UNITS.get(m.unit, 1.0) for m in meshes]
    seams = first.triangles if first.uv is not None and first.uv_triangles is None else first.uv_triangles
    n = len(first.vertices)
    nothing = Weights(np.zeros(n + 1, np.int32), np.zeros(0, np.int32), np.zeros(0))
    part = Part(first.name or "object", 0, len(first.triangles))
    skin = Skin(points[0], first.triangles, nothing, first.uv, seams, first.colors, (part,))
    root = stage.top("Xform", first.name or "object")
    frames = None if len(meshes) == 1 else (stage.codes(len(points), fps), iter([np.stack(points)]))
    write_surface(stage, root, {}, Surface.whole(skin, "mesh"), frames)
    report["vertices"] += n
    report["triangles"] += len(first.triangles)


def _cache(stage: Stage, clip: Clip, report: dict[str, Any]) -> Any:
    """A clip as the points that its own deformer makes; its prim."""
    from vitruvian.deform.deformer import deformer
    from vitruvian.formats.usd_figure import facts, sites
    from vitruvian.formats.usd_mesh import Surface, write_surface

    body, motion = clip.body, clip.motion
    move = deformer(clip.deformer, body)
    matrices = joint_matrices(body.skeleton, motion)
    named = {m.name for m in body.skin.morphs}
    weights = {} if motion is None else {k: w for k, w in motion.weights.items() if k in named}
    step = max(1, _HELD // max(1, len(body.skin.rest) * 12))

    def chunks() -> Iterator[Floats]:
        for start in range(0, len(matrices), step):
            some = slice(start, start + step)
            yield np.asarray(move(matrices[some], {k: w[some] for k, w in weights.items()}))

    codes = None if motion is None else stage.codes(len(motion), motion.fps)
    root = stage.top("Xform", body.name or "humanoid")
    root.SetCustomData({"hanim": facts(clip)})
    place(root, body.placement)
    if len(body.skin.triangles):
        write_surface(stage, root, {}, Surface.whole(body.skin, "body"), (codes or [None], chunks()))
    sites(stage, root, clip, codes)
    report["vertices"] += len(body.skin.rest)
    report["triangles"] += len(body.skin.triangles)
    report["deformer"] = clip.deformer
    report["lost"].append("the skeleton and its weights: baked points have none")
    return root


def _clothes(stage: Stage, clip: Clip, root: Any, tolerance: float, report: dict[str, Any]) -> None:
    """The caches of a clip beside its body, their points at the times between which players may go straight."""
    from vitruvian.formats.bake import reduced
    from vitruvian.formats.usd_mesh import Surface, write_surface
    from vitruvian.stage.vertex_cache import surface

    looks: dict[tuple, Any] = {}
    for cache in clip.caches:
        frames = cache.positions if clip.motion is None else cache.positions[: len(clip.motion)]
        n = cache.positions.shape[1]
        keys, values, _, error = reduced((f.astype(np.float64) for f in frames), n, tolerance)
        codes: list[float | None] = [None]
        if len(keys) > 1 and clip.motion is not None:
            every = stage.codes(len(frames), clip.motion.fps)
            codes = [every[round(k * (len(frames) - 1))] for k in keys]
        write_surface(stage, root, looks, Surface.whole(surface(cache, values[0]), cache.name), (codes, [values]))
        report["vertices"] += n
        report["triangles"] += len(cache.triangles)
        report.setdefault("cloth", []).append({
            "name": cache.name, "frames": len(frames), "points": n, "keys": len(keys), "max_error_m": error,
            "tolerance_m": tolerance, "closing_m": cache.closing,
        })  # fmt: skip
