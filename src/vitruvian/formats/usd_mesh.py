"""Surfaces in USD: points, triangles, normals, texture coordinates, colours, materials and subsets."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from vitruvian.body.seams import creases, face_normals
from vitruvian.body.types import Floats, Ints, Part, Skin
from vitruvian.deform.normals import incidence, mesh_normals

if TYPE_CHECKING:
    from vitruvian.formats.usd import Stage


@dataclass(frozen=True, eq=False)
class Surface:
    """What becomes one Mesh prim: vertices `source` (n,) and triangles `faces` (t,) of a skin, both increasing.

    `parts` have ranges of `faces`; `joint` is the one that carries the surface rigidly, or None.
    """

    skin: Skin
    name: str
    source: Ints
    faces: Ints
    parts: tuple[Part, ...]
    joint: int | None = None

    @cached_property
    def triangles(self) -> Ints:
        """(t,3) into `source`."""
        return np.searchsorted(self.source, self.skin.triangles[self.faces]).astype(np.int32)

    @staticmethod
    def whole(skin: Skin, name: str) -> Surface:
        """All of a skin."""
        count = lambda rows: np.arange(len(rows), dtype=np.int32)  # noqa: E731
        return Surface(skin, name, count(skin.rest), count(skin.triangles), skin.parts)

    @staticmethod
    def of(skin: Skin, name: str, source: Ints, parts: list[Part], joint: int | None) -> Surface:
        faces = [np.arange(p.start, p.stop, dtype=np.int32) for p in parts]
        stops = np.cumsum([len(f) for f in faces])
        moved = tuple(replace(p, start=int(s) - len(f), stop=int(s)) for p, f, s in zip(parts, faces, stops))
        return Surface(skin, name, source, np.concatenate(faces) if faces else np.zeros(0, np.int32), moved, joint)


def surfaces(skin: Skin, shared: int) -> list[Surface]:
    """A skin as one surface that deforms, and one for each piece that a single joint carries.

    Pieces are parts that share vertices among each other, all of them after the first `shared` vertices, which are
    the seamless skin's and stay together.
    """
    n = len(skin.rest)
    drawn = [np.unique(skin.triangles[p.start : p.stop]) for p in skin.parts]
    part = np.repeat(np.arange(len(drawn)), [len(d) for d in drawn])
    link = coo_array((np.ones(len(part)), (n + part, np.concatenate(drawn))), shape=(n + len(drawn),) * 2)
    label = connected_components(link, directed=False)[1]
    whole = set(label[:shared])
    rows: dict[int, list[Part]] = {}
    for k, p in enumerate(skin.parts):
        if p.stop > p.start:
            rows.setdefault(int(label[n + k]), []).append(p)
    order = np.argsort(label[:n], kind="stable")
    starts = np.searchsorted(label[:n][order], np.arange(label.max() + 2))
    pieces = []
    left = np.isin(np.arange(n), np.concatenate(drawn))
    left[:shared] = True
    kept: list[Part] = []
    for group, parts in rows.items():
        source = np.sort(order[starts[group] : starts[group + 1]]).astype(np.int32)
        joint = None if group in whole else carrier(skin, source)
        if joint is None:
            kept += parts
        else:
            left[source] = False
            pieces.append(Surface.of(skin, parts[0].name, source, parts, joint))
    if not kept and not shared:
        return pieces
    return [Surface.of(skin, "skin", np.flatnonzero(left).astype(np.int32), kept, None), *pieces]


def carrier(skin: Skin, source: Ints) -> int | None:
    """The joint that carries vertices `source` with weight one each, or None."""
    w = skin.weights
    if not len(source) or not (w.counts[source] == 1).all():
        return None
    joints, weights = w.joint[w.row[source]], w.weight[w.row[source]]
    return int(joints[0]) if (joints == joints[0]).all() and (weights == 1).all() else None


def write_surface(
    stage: Stage,
    root: Any,
    looks: dict[tuple, Any],
    surface: Surface,
    frames: tuple[Iterable[float | None], Iterable[NDArray]] | None = None,
) -> Any:
    """A Mesh prim under `root`, with materials in `root`/Looks, which `looks` remembers; the prim.

    `frames`: time codes and chunks of all points of the skin (f,V,3) that replace the rest; a code None is no time.
    """
    from pxr import Usd, UsdGeom, Vt

    from vitruvian.formats.usd import identifier

    taken = {c.GetName() for c in root.GetAllChildren()} | {"Looks", "Sites", "Skeleton", "Animation"}
    prim = stage.usd.DefinePrim(root.GetPath().AppendChild(identifier(surface.name or "mesh", taken)), "Mesh")
    mesh, skin = UsdGeom.Mesh(prim), surface.skin
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(any(p.double_sided for p in surface.parts))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray(len(surface.faces), 3))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(surface.triangles.reshape(-1))))
    points, extent, normals = mesh.CreatePointsAttr(), mesh.CreateExtentAttr(), mesh.CreateNormalsAttr()
    shade = Shading(surface)
    mesh.SetNormalsInterpolation(shade.interpolation)
    codes, chunks = ((None,), (skin.rest[None],)) if frames is None else frames
    clock = iter(codes)
    for chunk in chunks:
        for whole in chunk:
            code = next(clock)
            time = Usd.TimeCode.Default() if code is None else Usd.TimeCode(code)
            rest = whole[surface.source]
            points.Set(vectors(rest), time)
            extent.Set(vectors(bounds(rest)), time)
            normals.Set(vectors(shade(rest)), time)
    _texture(mesh, surface)
    _paint(mesh, surface)
    _materials(stage, root, looks, prim, surface)
    return prim


def vectors(values: NDArray) -> Any:
    """(n,3) as USD's float vectors."""
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))


def bounds(points: NDArray) -> NDArray:
    """(2,3) lowest and highest corner; zeros without points."""
    rows = np.ascontiguousarray(points.T)  # ten times faster than along the first axis
    return np.stack([rows.min(axis=1), rows.max(axis=1)]) if len(points) else np.zeros((2, 3))


class Shading:
    """Unit normals of a surface in any pose: per vertex when all is smooth, else per corner, with its creases."""

    def __init__(self, surface: Surface):
        from pxr import UsdGeom

        self.triangles = surface.triangles
        rest = surface.skin.rest[surface.source]
        self.edges = creases(rest, self.triangles, surface.parts)
        self.smooth = incidence(rest, self.triangles) if self.edges is None else None
        self.interpolation = UsdGeom.Tokens.vertex if self.edges is None else UsdGeom.Tokens.faceVarying

    def __call__(self, points: NDArray) -> NDArray:
        if self.smooth is not None:
            out = mesh_normals(self.smooth, np.ascontiguousarray(points, np.float32)[None], 0)[0]
        else:
            out = self.edges @ face_normals(points, self.triangles)  # type: ignore[operator]
        length = np.linalg.norm(out, axis=1, keepdims=True)
        return np.where(length > 1e-30, out / np.where(length > 1e-30, length, 1), [0.0, 1.0, 0.0])


def _texture(mesh: Any, surface: Surface) -> None:
    """Texture coordinates: one per vertex, or with their own indices where there are seams."""
    from pxr import Sdf, UsdGeom, Vt

    skin = surface.skin
    if skin.uv is None or skin.uv_triangles is None:
        return
    api, kind = UsdGeom.PrimvarsAPI(mesh), Sdf.ValueTypeNames.TexCoord2fArray
    seams = skin.uv_triangles[surface.faces].reshape(-1)
    corner = surface.triangles.reshape(-1)
    one = np.full(len(surface.source), -1, np.int64)
    one[corner] = seams
    if (one[corner] == seams).all():
        uv = np.where(one[:, None] >= 0, skin.uv[np.maximum(one, 0)], 0.0)
        st = api.CreatePrimvar("st", kind, UsdGeom.Tokens.vertex)
    else:
        used, where = np.unique(seams, return_inverse=True)
        uv = skin.uv[used]
        st = api.CreatePrimvar("st", kind, UsdGeom.Tokens.faceVarying)
        st.SetIndices(Vt.IntArray.FromNumpy(where.reshape(-1).astype(np.int32)))
    st.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(uv, np.float32)))


def _paint(mesh: Any, surface: Surface) -> None:
    """displayColor, linear: per vertex, per face, or one."""
    from pxr import UsdGeom

    skin, parts = surface.skin, surface.parts
    if skin.colors is not None:
        color = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
        color.Set(vectors(linear(skin.colors[surface.source])))
        return
    tones = np.array([p.color for p in parts], dtype=np.float64).reshape(-1, 3)
    if len({p.color for p in parts}) == 1:
        mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant).Set(vectors(linear(tones[:1])))
    elif len(parts):
        each = np.repeat(tones, [p.stop - p.start for p in parts], axis=0)
        mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.uniform).Set(vectors(linear(each)))


def _materials(stage: Stage, root: Any, looks: dict[tuple, Any], prim: Any, surface: Surface) -> None:
    """A material for the mesh when all of it looks alike, else a subset of faces for each part."""
    from pxr import UsdGeom, UsdShade, Vt

    from vitruvian.formats.usd import identifier

    colored = surface.skin.colors is not None
    shown = [p for p in surface.parts if p.stop > p.start]
    if len(shown) == 1:
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(_material(stage, root, looks, shown[0], colored))
        prim.SetCustomDataByKey("hanim:part", _part(shown[0]))
        return
    taken: set[str] = set()
    for part in shown:
        faces = Vt.IntArray.FromNumpy(np.arange(part.start, part.stop, dtype=np.int32))
        name = identifier(part.name or "part", taken)
        subset = UsdGeom.Subset.CreateGeomSubset(
            UsdGeom.Imageable(prim), name, UsdGeom.Tokens.face, faces, UsdShade.Tokens.materialBind
        )
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(_material(stage, root, looks, part, colored))
        subset.GetPrim().SetCustomDataByKey("hanim:part", _part(part))
    if shown:
        kind = UsdGeom.Tokens.partition
        UsdGeom.Subset.SetFamilyType(UsdGeom.Imageable(prim), UsdShade.Tokens.materialBind, kind)


def _part(part: Part) -> dict[str, Any]:
    """What a mesh and its material can't say of a part."""
    color = ("red", "green", "blue")
    out: dict[str, Any] = {"name": part.name, "doubleSided": part.double_sided, "creaseAngle": float(part.crease)}
    return out | dict(zip(color, map(float, part.color)))


def _material(stage: Stage, root: Any, looks: dict[tuple, Any], part: Part, colored: bool) -> Any:
    """UsdPreviewSurface; painted surfaces take their colour from displayColor."""
    from pxr import Gf, Sdf, UsdGeom, UsdShade

    from vitruvian.formats.usd import identifier
    from vitruvian.formats.usd_pictures import texture

    key = (None if colored else part.color, part.roughness, part.metallic, part.opacity, part.picture)
    if key in looks:
        return looks[key]
    scope = root.GetPath().AppendChild("Looks")
    UsdGeom.Scope.Define(stage.usd, scope)
    path = scope.AppendChild(identifier(part.name or "material", {m.GetPrim().GetName() for m in looks.values()}))
    material = UsdShade.Material.Define(stage.usd, path)
    shader = UsdShade.Shader.Define(stage.usd, path.AppendChild("surface"))
    shader.CreateIdAttr("UsdPreviewSurface")
    diffuse = shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    shown = part.picture is not None and texture(stage, path, shader, part.picture, tuple(_tone(part)))
    if colored and not shown:
        reader = UsdShade.Shader.Define(stage.usd, path.AppendChild("paint"))
        reader.CreateIdAttr("UsdPrimvarReader_float3")
        reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
        reader.CreateInput("fallback", Sdf.ValueTypeNames.Float3).Set(Gf.Vec3f(*_tone(part)))
        diffuse.ConnectToSource(reader.CreateOutput("result", Sdf.ValueTypeNames.Float3))
    elif not shown:
        diffuse.Set(Gf.Vec3f(*_tone(part)))
    for name, value in (("roughness", part.roughness), ("metallic", part.metallic), ("opacity", part.opacity)):
        given = shader.CreateInput(name, Sdf.ValueTypeNames.Float)
        if not given.HasConnectedSource():  # a picture's transparency
            given.Set(float(np.clip(value, 0, 1)))
    material.CreateSurfaceOutput().ConnectToSource(shader.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    looks[key] = material
    return material


def _tone(part: Part) -> list[float]:
    return [float(x) for x in linear(np.asarray(part.color, np.float64))]


def linear(srgb: Floats) -> Floats:
    """Linear light of sRGB values in 0..1."""
    c = np.clip(srgb, 0, 1)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def nonlinear(light: Floats) -> Floats:
    """sRGB values of linear light in 0..1."""
    c = np.clip(light, 0, 1)
    return np.where(c <= 0.0031308, c * 12.92, 1.055 * c ** (1 / 2.4) - 0.055)
