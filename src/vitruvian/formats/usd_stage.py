"""What a USD file holds, as plain arrays; runs in a process of its own (FILE FOLDER SECONDS), see `read_usd`.

USD's own library opens the file, and a file that isn't ours may crash it, or make it compose for hours. So nothing but
numbers and words leaves this process, by a file in FOLDER: arrays in `out.npz`, the rest as JSON in it. Matrices leave
for column vectors. Layers are opened only from the file's folder and below it; nothing comes over a network.
"""

from __future__ import annotations

import json
import os
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.formats.usd_pictures import Found

MAX_BYTES = 1 << 29  # of all layers together
MAX_LAYERS = 256
MAX_PRIMS = 200_000
MAX_NUMBERS = 1 << 27  # of an animation
LAYERS = (".usd", ".usda", ".usdc")
MEMORY = 6 << 30  # bytes of addresses, most of which are never used


class Refused(Exception):
    """One line about the file."""


def main(path: str, folder: str, seconds: str) -> None:
    """Read `path` and write what it holds, or one line that says why not, to `folder`/out.npz."""
    arrays: dict[str, NDArray] = {}
    try:
        _limit(int(seconds))
        document = _portable(_read(Path(path), Path(folder)), arrays)
    except Refused as error:
        document = {"error": str(error).replace(f"{Path(folder) / 'package'}{os.sep}", "")}
    except MemoryError:
        document = {"error": "asks for too much memory"}
    text = json.dumps(document, allow_nan=True).encode()
    np.savez(Path(folder) / "out.npz", document=np.frombuffer(text, np.uint8), **arrays)  # type: ignore[arg-type]


def _limit(seconds: int) -> None:
    """Bounds of memory and of computing time, where the system has them."""
    try:
        import resource
    except ImportError:  # not on Windows; the parent still watches the clock
        return
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 2))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _portable(value: Any, arrays: dict[str, NDArray]) -> Any:
    """Arrays go to `arrays` and leave their key."""
    if isinstance(value, np.ndarray):
        key = f"a{len(arrays)}"
        arrays[key] = value
        return {"array": key}
    if isinstance(value, dict):
        return {k: _portable(v, arrays) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_portable(v, arrays) for v in value]
    return value


def _read(path: Path, folder: Path) -> dict[str, Any]:
    from pxr import Tf, Usd

    home = path.parent
    if path.suffix.lower() == ".usdz" or zipfile.is_zipfile(path):
        home = folder / "package"
        path = _unpacked(path, home)
    notes = _check_layers(path, home)
    os.chdir(path.parent)  # where USD looks for what it can't find beside a layer
    try:
        return Reader(Usd.Stage.Open(str(path)), notes, home).document()
    except Tf.ErrorException as error:
        raise Refused(_line(error)) from None


def _line(error: Exception) -> str:
    """The first sentence that USD has for it."""
    for arg in getattr(error, "args", ()):
        text = getattr(arg, "commentary", None) or str(arg)
        if text.strip():
            return "USD says: " + " ".join(text.split())[:200]
    return "the USD library can't open it"


def _unpacked(path: Path, folder: Path) -> Path:
    """The layers and pictures of a package, unpacked; the first layer is the root."""
    root = None
    try:
        with zipfile.ZipFile(path) as package:
            members = [m for m in package.infolist() if not m.is_dir()]
            if len(members) > 10_000 or sum(m.file_size for m in members) > MAX_BYTES:
                raise Refused(f"expected a package of at most {MAX_BYTES >> 20} MB in 10,000 files")
            for member in members:
                target = Path(os.path.normpath(folder / member.filename))
                if not target.is_relative_to(folder):
                    raise Refused(f"holds a file outside of itself: {member.filename}")
                form = target.suffix.lower()
                if form in LAYERS or form in (".png", ".jpg", ".jpeg"):
                    target.parent.mkdir(parents=True, exist_ok=True)
                    target.write_bytes(package.read(member))
                    root = root or (target if form in LAYERS else None)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError, EOFError) as error:
        raise Refused(f"expected a USDZ package: {error}") from None
    if root is None:
        raise Refused("expected a package with a USD layer, found none")
    return root


def _check_layers(path: Path, home: Path) -> list[str]:
    """Look at every layer before anything is composed: all must be in `home`, and small enough together."""
    from pxr import Sdf, Tf

    folder = Path(os.path.realpath(home))
    todo, seen, size, notes = [Path(os.path.realpath(path))], set(), 0, []
    while todo:
        file = todo.pop()
        if file in seen:
            continue
        seen.add(file)
        size += file.stat().st_size
        if size > MAX_BYTES or len(seen) > MAX_LAYERS:
            raise Refused(f"expected at most {MAX_LAYERS} layers of {MAX_BYTES >> 20} MB together")
        try:
            layer = Sdf.Layer.FindOrOpen(str(file))
        except Tf.ErrorException as error:
            raise Refused(_line(error)) from None
        if layer is None:
            raise Refused(f"{file.name} is not a USD layer")
        for asset in sorted(layer.GetCompositionAssetDependencies()):
            if not asset:  # an arc within the layer
                continue
            if any(mark in asset for mark in ("://", "`", "[", ":SDF_FORMAT_ARGS:")):
                raise Refused(f"{file.name} refers to {asset}: only plain files beside it are opened")
            target = Path(os.path.realpath(file.parent / asset))
            if not target.is_relative_to(folder):
                raise Refused(f"{file.name} refers to {asset}, which is outside of its folder")
            if target.is_file():
                todo.append(target)
            else:
                notes.append(f"{file.name} refers to {asset}, which does not exist")
        if _has_clips(layer):
            raise Refused(f"{file.name} takes its animation from other files (value clips), which are not opened")
    return notes


def _has_clips(layer: Any) -> bool:
    stack = list(layer.rootPrims)
    while stack:
        spec = stack.pop()
        if spec.HasInfo("clips"):
            return True
        stack += list(spec.nameChildren)
        stack += [v.primSpec for s in spec.variantSets for v in s.variants.values()]
    return False


class Reader:
    """One composed stage."""

    def __init__(self, stage: Any, notes: list[str], home: Path):
        from pxr import Usd, UsdGeom

        self.stage, self.notes = stage, notes
        self.pictures = Found(home, notes)
        self.start = Usd.TimeCode.EarliestTime()
        self.world = UsdGeom.XformCache(self.start)
        self.done: set[str] = set()  # meshes that a skeleton moves

    def document(self) -> dict[str, Any]:
        from pxr import Usd, UsdGeom, UsdSkel

        every = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
        prims = []
        for prim in Usd.PrimRange.Stage(self.stage, every):
            prims.append(prim)
            if len(prims) > MAX_PRIMS:
                raise Refused(f"expected at most {MAX_PRIMS:,} prims")
        cache, figures = UsdSkel.Cache(), []
        found: dict[str, list[Any]] = {}
        tops: dict[str, Any] = {}
        for prim in prims:
            if not prim.IsA(UsdSkel.Root):
                continue
            root = UsdSkel.Root(prim)
            cache.Populate(root, every)
            for binding in cache.ComputeSkelBindings(root, every):
                key = str(binding.GetSkeleton().GetPrim().GetPath())
                found.setdefault(key, []).extend(binding.GetSkinningTargets())
                tops.setdefault(key, prim)
        for prim in prims:
            if prim.IsA(UsdSkel.Skeleton):
                query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
                if query and len(query.GetJointOrder()):
                    key = str(prim.GetPath())
                    figures.append(self.figure(query, found.get(key, []), tops.get(key) or _root_of(prim)))
                else:
                    self.notes.append(f"{prim.GetPath()}: a Skeleton whose joints make no tree is left out")
        meshes = [
            self.mesh(p) | {"world": _matrix(self.world.GetLocalToWorldTransform(p))}
            for p in prims
            if p.IsA(UsdGeom.Mesh) and str(p.GetPath()) not in self.done
        ]
        top, unit = self.stage.GetDefaultPrim(), float(UsdGeom.GetStageMetersPerUnit(self.stage))
        if not 1e-6 <= unit <= 1e6:
            self.notes.append(f"metersPerUnit is {unit:g}; centimetres are taken, USD's default")
            unit = 0.01
        return {
            "name": top.GetName() if top else "",
            "up": str(UsdGeom.GetStageUpAxis(self.stage)),
            "unit": unit,
            "figures": figures,
            "meshes": meshes,
            "pictures": self.pictures.entries,
            "notes": self.notes,
        }

    def figure(self, query: Any, targets: list[Any], top: Any) -> dict[str, Any]:
        skeleton = query.GetSkeleton()
        prim = skeleton.GetPrim()
        joints = [str(t) for t in query.GetJointOrder()]
        bind, rest = skeleton.GetBindTransformsAttr().Get(), skeleton.GetRestTransformsAttr().Get()
        names = skeleton.GetJointNamesAttr().Get() if skeleton.GetJointNamesAttr() else None
        return {
            "path": str(prim.GetPath()),
            "name": top.GetName(),
            "joints": joints,
            "names": [str(n) for n in names] if names is not None and len(names) == len(joints) else None,
            "parents": [int(query.GetTopology().GetParent(j)) for j in range(len(joints))],
            "bind": _matrices(bind, len(joints)),
            "rest": _matrices(rest, len(joints)),
            "world": _matrix(self.world.GetLocalToWorldTransform(prim)),
            "about": _words(top.GetCustomDataByKey("hanim")),
            "joints_about": _words(prim.GetCustomDataByKey("hanim")),
            "animation": self.animation(query),
            "meshes": [m for t in targets if (m := self.skinned(t, joints)) is not None],
            "sites": _sites(top),
        }

    def animation(self, query: Any) -> dict[str, Any] | None:
        source = query.GetAnimQuery()
        if not source:
            return None
        codes = sorted({*source.GetJointTransformTimeSamples(), *source.GetBlendShapeWeightTimeSamples()})
        rate = self.stage.GetTimeCodesPerSecond()
        fps = self.stage.GetFramesPerSecond() or rate
        if len(codes) > 1:
            steps = np.diff(codes)
            step = float(np.median(steps))
            if step > 0 and np.abs(steps / step - np.round(steps / step)).max() < 1e-3:
                fps = rate / step
            count = round((codes[-1] - codes[0]) * fps / rate) + 1
            if count * len(query.GetJointOrder()) * 16 > MAX_NUMBERS:
                raise Refused(f"the animation asks for {count:,} frames of {len(query.GetJointOrder())} joints")
            if abs(count - 1 - (codes[-1] - codes[0]) * fps / rate) > 1e-6 or count != len(codes):
                codes = np.linspace(codes[0], codes[-1], count).tolist()
        frames = [_matrices(query.ComputeJointLocalTransforms(c), 0) for c in codes or [self.start]]
        found = [f for f in frames if f is not None]
        weights = [source.ComputeBlendShapeWeights(c) for c in codes or [self.start]]
        tokens = [str(t) for t in source.GetBlendShapeOrder() or ()]
        if any(len(w or ()) != len(tokens) for w in weights):
            tokens = []
        return {
            "name": source.GetPrim().GetName(),
            "fps": float(fps),
            "local": np.stack(found) if len(found) == len(frames) else None,
            "tokens": tokens,
            "weights": np.array(weights, dtype=np.float64).reshape(len(frames), -1) if tokens else None,
        }

    def skinned(self, target: Any, joints: list[str]) -> dict[str, Any] | None:
        from pxr import UsdGeom

        prim = target.GetPrim()
        if not prim.IsA(UsdGeom.Mesh) or not target.HasJointInfluences():
            return None
        out = self.mesh(prim)
        own = target.GetJointOrder()
        place = {token: j for j, token in enumerate(joints)}
        order = [place.get(str(t), -1) for t in own] if own is not None else list(range(len(joints)))
        index, weight = target.ComputeJointInfluences(self.start)
        k = target.GetNumInfluencesPerComponent()
        rows = 1 if target.IsRigidlyDeformed() else len(out["points"])
        if len(index) != rows * k or len(weight) != rows * k:
            raise Refused(f"{prim.GetPath()}: expected {rows} times {k} joint indices and weights")
        index = np.array(index, dtype=np.int64).reshape(rows, k)
        if index.size and (index.min() < 0 or index.max() >= len(order)):
            raise Refused(f"{prim.GetPath()}: expected joint indices in 0..{len(order) - 1}")
        self.done.add(str(prim.GetPath()))
        kept = prim.HasAttribute("primvars:hanim:weightSum")
        return out | {
            "rigid": target.IsRigidlyDeformed(),
            "joints": np.array(order)[index],
            "weights": np.array(weight, dtype=np.float64).reshape(rows, k),
            "geometry": _matrix(target.GetGeomBindTransform(self.start)),
            "sums": _numbers(prim.GetAttribute("primvars:hanim:weightSum").Get()) if kept else None,
            "shapes": self.blend_shapes(prim, len(out["points"])),
        }

    def blend_shapes(self, prim: Any, count: int) -> list[dict[str, Any]]:
        from pxr import UsdSkel

        api = UsdSkel.BindingAPI(prim)
        tokens = api.GetBlendShapesAttr().Get() or ()
        targets = api.GetBlendShapeTargetsRel().GetTargets() if api.GetBlendShapeTargetsRel() else []
        out = []
        for token, path in zip(tokens, targets):
            shape = UsdSkel.BlendShape(self.stage.GetPrimAtPath(path))
            if not shape:
                continue
            offsets = _numbers(shape.GetOffsetsAttr().Get(), 3)
            index = _numbers(shape.GetPointIndicesAttr().Get())
            index = np.arange(count) if index is None else index.astype(np.int64)
            if (
                offsets is None
                or len(offsets) != len(index)
                or (len(index) and not 0 <= index.min() <= index.max() < count)
            ):
                self.notes.append(f"{path}: a BlendShape whose offsets and points do not fit is left out")
                continue
            about = _words(shape.GetPrim().GetCustomDataByKey("hanim"))
            out.append({"token": str(token), "name": path.name, "offsets": offsets, "index": index, "about": about})
        return out

    def mesh(self, prim: Any) -> dict[str, Any]:
        from pxr import UsdGeom

        mesh = UsdGeom.Mesh(prim)
        points = _numbers(mesh.GetPointsAttr().Get(self.start), 3)
        counts = _numbers(mesh.GetFaceVertexCountsAttr().Get(self.start))
        corners = _numbers(mesh.GetFaceVertexIndicesAttr().Get(self.start))
        points = np.zeros((0, 3)) if points is None else points
        counts = np.zeros(0, np.int64) if counts is None else counts.astype(np.int64)
        corners = np.zeros(0, np.int64) if corners is None else corners.astype(np.int64)
        where = str(prim.GetPath())
        if (counts < 0).any() or counts.sum() != len(corners):
            raise Refused(f"{where}: expected {int(counts.sum())} face corners, found {len(corners)}")
        if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
            raise Refused(f"{where}: expected point indices in 0..{len(points) - 1}, found {int(corners.max())}")
        if not np.isfinite(points).all():
            raise Refused(f"{where}: expected finite points, found others")
        st, colors = self.texture(prim), self.primvar(mesh.GetDisplayColorPrimvar(), 3)
        return {
            "path": where,
            "name": prim.GetName(),
            "points": points,
            "counts": counts,
            "corners": corners,
            "st": st,
            "colors": colors,
            "parts": self.parts(prim, len(counts)),
            "two_sided": bool(mesh.GetDoubleSidedAttr().Get()),
            "left": mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded,
        }

    def texture(self, prim: Any) -> dict[str, Any] | None:
        from pxr import Sdf, UsdGeom

        kinds = (Sdf.ValueTypeNames.TexCoord2fArray, Sdf.ValueTypeNames.Float2Array, Sdf.ValueTypeNames.TexCoord2hArray)
        api = UsdGeom.PrimvarsAPI(prim)
        every = sorted(api.GetPrimvarsWithValues(), key=lambda p: p.GetPrimvarName() != "st")
        fit = next((p for p in every if p.GetTypeName() in kinds), None)
        return None if fit is None else self.primvar(fit, 2)

    def primvar(self, primvar: Any, width: int) -> dict[str, Any] | None:
        """Values (n,width), indices or None, and how they are spread."""
        values = _numbers(primvar.Get(self.start), width) if primvar else None
        if values is None or not np.isfinite(values).all():
            return None
        index = _numbers(primvar.GetIndices(self.start)) if primvar.IsIndexed() else None
        if index is not None and len(index) and not 0 <= index.min() <= index.max() < len(values):
            return None
        return {
            "values": values,
            "index": None if index is None else index.astype(np.int64),
            "spread": str(primvar.GetInterpolation()),
        }

    def parts(self, prim: Any, faces: int) -> list[dict[str, Any]]:
        """The subsets with materials of a mesh, or the mesh as one part. Faces None means all."""
        from pxr import UsdGeom, UsdShade

        out = []
        for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
            index = _numbers(subset.GetIndicesAttr().Get(self.start))
            if index is None or not len(index) or subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
                continue
            index = index.astype(np.int64)
            if index.min() < 0 or index.max() >= faces:
                raise Refused(f"{subset.GetPath()}: expected face indices in 0..{faces - 1}")
            out.append(self.part(subset.GetPrim()) | {"faces": index})
        return out or [self.part(prim) | {"faces": None}]

    def part(self, prim: Any) -> dict[str, Any]:
        from pxr import UsdShade

        out: dict[str, Any] = {"name": prim.GetName(), "about": _words(prim.GetCustomDataByKey("hanim:part"))}
        material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        source = material.ComputeSurfaceSource() if material else None
        shader = source[0] if isinstance(source, tuple) else source
        if not material or not shader:
            return out
        out["material"] = material.GetPrim().GetName()
        color = shader.GetInput("diffuseColor")
        if color and color.HasConnectedSource():
            reader = UsdShade.Shader(color.GetConnectedSources()[0][0].source.GetPrim())
            out["painted"] = str(reader.GetIdAttr().Get()).startswith("UsdPrimvarReader")
            out |= self.pictures.of(color, shader.GetInput("opacity"), shader.GetInput("opacityThreshold"))
        elif color and color.Get() is not None:
            out["color"] = [float(c) for c in color.Get()]
        for name in ("roughness", "metallic", "opacity"):
            given = shader.GetInput(name)
            value = given.Get() if given and not given.HasConnectedSource() else None
            if value is not None:
                out[name] = float(value)
        return out


def _root_of(prim: Any) -> Any:
    """The nearest SkelRoot above, or the prim itself."""
    from pxr import UsdSkel

    found = UsdSkel.Root.Find(prim)
    return found.GetPrim() if found else prim


def _sites(top: Any) -> list[dict[str, Any]]:
    """Xforms that we wrote as Sites: the values without time are their places at rest."""
    from pxr import Usd, UsdGeom

    out = []
    holder = top.GetChild("Sites")
    for prim in holder.GetChildren() if holder else ():
        about = _words(prim.GetCustomDataByKey("hanim"))
        if about.get("node") != "Site":
            continue
        local = UsdGeom.Xformable(prim).GetLocalTransformation(Usd.TimeCode.Default())
        out.append({"about": about, "matrix": _matrix(local)})
    return out


def _words(value: Any, depth: int = 6) -> Any:
    """Custom data as JSON knows it; {} for none."""
    if value is None:
        return {}
    if isinstance(value, dict):
        return {str(k): _words(v, depth - 1) for k, v in value.items()} if depth else {}
    if isinstance(value, str | bool | int | float):
        return value
    try:
        return [v if isinstance(v, str) else float(v) for v in value]
    except (TypeError, ValueError):
        return str(value)


def _numbers(value: Any, width: int = 0) -> NDArray | None:
    if value is None:
        return None
    out = np.array(value)
    if out.dtype == object or (width and out.size and (out.ndim != 2 or out.shape[1] != width)):
        return None
    return out.astype(np.float64).reshape(-1, width) if width else out.reshape(-1)


def _matrix(matrix: Any) -> NDArray:
    return np.array(matrix, dtype=np.float64).T


def _matrices(value: Any, count: int) -> NDArray | None:
    """(n,4,4) for column vectors; None when there are none, or not `count` (0: any)."""
    out = np.array(value if value is not None else [], dtype=np.float64)
    if out.ndim != 3 or (count and len(out) != count) or not np.isfinite(out).all():
        return None
    return out.transpose(0, 2, 1)


if __name__ == "__main__":
    main(*sys.argv[1:4])
