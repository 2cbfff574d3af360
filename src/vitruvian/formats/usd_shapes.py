"""Meshes of a USD file as Shapes and as one Mesh. See `usd_reader`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.rotations import from_matrix, to_axis_angle
from vitruvian.body.types import Floats
from vitruvian.deform.se3 import polar
from vitruvian.formats.usd_mesh import nonlinear
from vitruvian.hanim.humanoid import Material, Shape
from vitruvian.hanim.triangulate import faces as cut
from vitruvian.stage.clip import Mesh

SNAP = 1e-6  # radians, metres, stretch: a joint this near to rest is at rest
_GRAY = (0.8, 0.8, 0.8)


def upright(document: dict[str, Any]) -> Floats:
    """(4,4) from the file's unit and up axis to metres with Y up."""
    out = np.eye(4)
    out[:3, :3] *= document["unit"]
    if document["up"].upper() == "Z":
        out[:3, :3] = out[:3, :3] @ [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    return out


def split(linear: Floats) -> tuple[Floats, Floats]:
    """Rotations and symmetric stretches (...,3,3) of matrices; a mirror stays in the stretch."""
    rotation, stretch = polar(linear)
    mirror = np.where(np.linalg.det(rotation) < 0, -1.0, 1.0)[..., None, None]
    return rotation * mirror, stretch * mirror


def axis_angle(rotation: Floats) -> Floats:
    """`x y z angle` of a matrix (3,3); next to nothing is none at all."""
    q = from_matrix(rotation)
    return to_axis_angle(q) if np.abs(q[:3]).max() > SNAP / 2 else np.array([0.0, 0.0, 1.0, 0.0])


def shapes_of(mesh: dict[str, Any], points: Floats) -> list[Shape]:
    """A Shape for each part of a mesh, its triangles into `points`, which all of them share."""
    corners, owner = _triangles(mesh, points)
    triangles = mesh["corners"][corners].astype(np.int32)
    if mesh["left"]:
        corners, triangles = corners[:, ::-1], triangles[:, ::-1]
    colors, tone = _colors(mesh, len(points))
    uv, uv_corner = _texture(mesh, len(points))
    out = []
    left = np.ones(len(mesh["counts"]), bool)
    parts = [*mesh["parts"]]
    for part in parts:
        if part["faces"] is not None:
            left[part["faces"]] = False
    if parts[0]["faces"] is not None and left.any():  # faces that no subset names
        parts.append({"name": mesh["name"], "about": {}, "faces": np.flatnonzero(left)})
    for part in parts:
        mine = slice(None) if part["faces"] is None else np.isin(owner, part["faces"])
        about = part["about"]
        shape = Shape(str(about.get("name", part["name"])), np.ascontiguousarray(triangles[mine]), points)
        shape.material = _material(part, tone, mesh["two_sided"])
        shape.crease_angle = float(about.get("creaseAngle", np.pi))
        if part.get("painted", "material" not in part):
            shape.colors = colors
        if uv is not None and uv_corner is not None:
            shape.uv, shape.uv_triangles = uv, np.ascontiguousarray(uv_corner[corners[mine]]).astype(np.int32)
        out.append(shape)
    return out


def _triangles(mesh: dict[str, Any], points: Floats) -> tuple[NDArray, NDArray]:
    """Corners (t,3), places in the list of face corners, and the face of each triangle."""
    counts, corners = mesh["counts"], mesh["corners"]
    if (counts == 3).all():
        return np.arange(len(corners)).reshape(-1, 3), np.arange(len(counts))
    marked = np.insert(corners, np.cumsum(counts), -1)
    place, owner = cut(marked, points)
    return place - owner[:, None], owner


def _spread(primvar: dict[str, Any] | None, mesh: dict[str, Any], points: int) -> NDArray | None:
    """For each face corner the row of the values that it shows; None when there are none or they do not fit."""
    if primvar is None or not len(primvar["values"]):
        return None
    corners, counts = mesh["corners"], mesh["counts"]
    rows = {
        "constant": np.zeros(len(corners), np.int64),
        "uniform": np.repeat(np.arange(len(counts)), counts),
        "faceVarying": np.arange(len(corners)),
    }.get(primvar["spread"], corners)
    if primvar["index"] is not None:
        if len(rows) and rows.max() >= len(primvar["index"]):
            return None
        rows = primvar["index"][rows]
    return rows if not len(rows) or rows.max() < len(primvar["values"]) else None


def _colors(mesh: dict[str, Any], points: int) -> tuple[Floats | None, tuple[float, float, float]]:
    """sRGB per point, or None, and the one colour of a mesh that has one."""
    rows = _spread(mesh["colors"], mesh, points)
    if rows is None:
        return None, _GRAY
    values = nonlinear(mesh["colors"]["values"])
    if mesh["colors"]["spread"] in ("constant", "uniform"):
        r, g, b = (float(x) for x in values[rows[0] if len(rows) else 0])
        return None, (r, g, b)
    out = np.full((points, 3), 0.8)
    out[mesh["corners"]] = values[rows]
    if mesh["colors"]["spread"] in ("vertex", "varying") and mesh["colors"]["index"] is None:
        out = values[:points].copy() if len(values) >= points else out
    return out, _GRAY


def _texture(mesh: dict[str, Any], points: int) -> tuple[Floats | None, NDArray | None]:
    """Texture coordinates (u,2) and the one of each face corner."""
    rows = _spread(mesh["st"], mesh, points)
    return (None, None) if rows is None else (mesh["st"]["values"], rows)


def _material(part: dict[str, Any], tone: tuple[float, float, float], two_sided: bool) -> Material:
    about = part["about"]
    color = tone
    if "color" in part:
        r, g, b = (float(x) for x in nonlinear(np.array(part["color"])))
        color = (r, g, b)
    if all(c in about for c in ("red", "green", "blue")):
        color = (float(about["red"]), float(about["green"]), float(about["blue"]))
    out = Material(str(part.get("material", "")), color, double_sided=bool(about.get("doubleSided", two_sided)))
    out.picture = part.get("picture")
    for field in ("roughness", "metallic", "opacity"):
        value = part.get(field)
        if value is not None and np.isfinite(value):
            setattr(out, field, float(np.clip(value, 0, 1)))
    return out


def mesh_of(document: dict[str, Any]) -> Mesh:
    """Everything that no skeleton moves, as one Mesh in metres and Y up."""
    there = upright(document)
    points, triangles, uvs, seams, colors = [], [], [], [], []
    count = coordinates = 0
    for mesh in document["meshes"]:
        whole = there @ mesh["world"]
        at = mesh["points"] @ whole[:3, :3].T + whole[:3, 3]
        paint, tone = _colors(mesh, len(at))
        paint = np.tile(tone, (len(at), 1)) if paint is None else paint
        for shape in shapes_of(mesh, at):
            if shape.colors is None and shape.material.color != tone:
                paint = paint.copy()
                paint[shape.triangles] = shape.material.color
            triangles.append(shape.triangles + np.int32(count))
            seam = np.full(shape.triangles.shape, -1, np.int32)
            if shape.uv is not None and shape.uv_triangles is not None:
                seam = shape.uv_triangles + np.int32(coordinates)
            seams.append(seam)
        if mesh["st"] is not None:
            uvs.append(mesh["st"]["values"])
            coordinates += len(uvs[-1])
        points.append(at)
        colors.append(paint)
        count += len(at)
    uv = uv_triangles = None
    faces = np.concatenate(triangles)
    if coordinates:
        uv_triangles = np.concatenate(seams)
        uv = np.concatenate([*uvs, np.zeros((1, 2))]) if (uv_triangles < 0).any() else np.concatenate(uvs)
        uv_triangles = np.where(uv_triangles < 0, coordinates, uv_triangles).astype(np.int32)
        if len(uv) == count and np.array_equal(uv_triangles, faces):
            uv_triangles = None
    paint = np.concatenate(colors)
    plain = all(m["colors"] is None for m in document["meshes"]) and (paint == _GRAY).all()
    name = document["meshes"][0]["name"] if len(document["meshes"]) == 1 else document["name"]
    name = document["name"] or name or "object"
    return Mesh(np.concatenate(points), faces, uv, None if plain else paint, name, "m", uv_triangles)
