"""Geometry nodes to triangles."""

from __future__ import annotations

import numpy as np
import pytest

from vitruvian.errors import FileError, VitruvianWarning
from vitruvian.formats.x3d import parse_x3d
from vitruvian.hanim import triangulate
from vitruvian.hanim.humanoid import Shape
from vitruvian.hanim.reading import Reading
from vitruvian.hanim.surface import shapes

SQUARE = '<Coordinate point="0 0 0 1 0 0 1 1 0 0 1 0"/>'


def read(text: str) -> list[Shape]:
    scene = parse_x3d(f"<X3D version='4.0'><Scene>{text}</Scene></X3D>".encode(), "s.x3d")
    reading = Reading(scene)
    found = shapes(reading, [n for n in scene.body])  # type: ignore[misc]
    reading.say()
    return found


def geometry(text: str) -> Shape:
    (shape,) = read(f"<Shape>{text}</Shape>")
    return shape


def area(shape: Shape) -> np.ndarray:
    """Sum of the triangles' area vectors."""
    a, b, c = (shape.points[shape.triangles[:, k]] for k in range(3))  # type: ignore[index]
    return np.cross(b - a, c - a).sum(axis=0) / 2


def volume(points: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def test_concave_polygons_keep_their_area() -> None:
    shape = geometry(
        '<IndexedFaceSet convex="false" coordIndex="0 1 2 3 4 5 -1 5 4 3 2 1 0">'
        '<Coordinate point="0 0 0 3 0 0 3 3 0 2 3 0 2 1 0 0 1 0"/></IndexedFaceSet>'
    )
    assert shape.triangles.shape == (8, 3)
    a, b, c = (shape.points[shape.triangles[:, k]] for k in range(3))  # type: ignore[index]
    z = np.cross(b - a, c - a)[:, 2] / 2
    assert (z[:4] > 0).all()
    assert (z[4:] < 0).all()
    np.testing.assert_allclose([z[:4].sum(), z[4:].sum()], [5, -5])


def test_a_concave_quad_is_cut_at_its_dent() -> None:
    points = np.array([[0, 0, 0], [2, -1, 0], [0, 2, 0], [0.4, 0.2, 0]], float)  # dent at corner 3
    for index in (np.array([0, 1, 2, 3, -1]), np.array([3, 0, 1, 2])):
        corners, _ = triangulate.faces(index, points)
        a, b, c = (points[index[corners[:, k]]] for k in range(3))
        assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_clockwise_faces_are_turned_with_their_texture() -> None:
    text = (
        '<IndexedFaceSet ccw="{}" coordIndex="0 1 2 3" texCoordIndex="3 2 1 0">' + SQUARE
        + '<TextureCoordinate point="0 0 1 0 1 1 0 1"/></IndexedFaceSet>'
    )  # fmt: skip
    plain, turned = geometry(text.format("true")), geometry(text.format("false"))
    np.testing.assert_allclose(area(plain), [0, 0, 1])
    np.testing.assert_allclose(area(turned), [0, 0, -1])
    for shape in (plain, turned):
        np.testing.assert_array_equal(shape.uv_triangles, 3 - shape.triangles)


@pytest.mark.parametrize(
    "text",
    [
        f'<IndexedTriangleSet index="0 1 2 0 2 3">{SQUARE}</IndexedTriangleSet>',
        '<TriangleSet><Coordinate point="0 0 0 1 0 0 1 1 0 0 0 0 1 1 0 0 1 0"/></TriangleSet>',
        f'<IndexedTriangleStripSet index="0 1 3 2 -1">{SQUARE}</IndexedTriangleStripSet>',
        f'<IndexedTriangleFanSet index="0 1 2 3">{SQUARE}</IndexedTriangleFanSet>',
        '<TriangleStripSet stripCount="4"><Coordinate point="0 0 0 1 0 0 0 1 0 1 1 0"/></TriangleStripSet>',
        f'<TriangleFanSet fanCount="4">{SQUARE}</TriangleFanSet>',
        f"<QuadSet>{SQUARE}</QuadSet>",
        f'<IndexedQuadSet index="0 1 2 3">{SQUARE}</IndexedQuadSet>',
    ],
)
def test_every_kind_of_face_set_gives_the_square(text: str) -> None:
    shape = geometry(text)
    assert shape.triangles.shape == (2, 3)
    np.testing.assert_allclose(area(shape), [0, 0, 1])


@pytest.mark.parametrize(
    ("text", "expected", "tolerance"),
    [
        ('<Box size="1 2 3"/>', 6, 1e-12),
        ('<Sphere radius="2"/>', 4 / 3 * np.pi * 8, 0.05),
        ('<Cylinder radius="1" height="3"/>', 3 * np.pi, 0.02),
        ('<Cone bottomRadius="1" height="3"/>', np.pi, 0.02),
    ],
)
def test_primitives_are_closed_and_face_outwards(text: str, expected: float, tolerance: float) -> None:
    shape = geometry(text)
    assert volume(shape.points, shape.triangles) == pytest.approx(expected, rel=tolerance)  # type: ignore[arg-type]
    np.testing.assert_allclose(area(shape), 0, atol=1e-9)


def test_cylinder_without_caps() -> None:
    shape = geometry('<Cylinder top="false" bottom="false"/>')
    assert shape.triangles.shape == (48, 3)


def test_colours_per_face_and_per_corner() -> None:
    colors = '<Color color="1 0 0 0 1 0"/>'
    shape = geometry(
        '<IndexedFaceSet coordIndex="0 1 2 -1 0 2 3" colorPerVertex="false">' + SQUARE + colors + "</IndexedFaceSet>"
    )
    np.testing.assert_array_equal(shape.colors, [[0.5, 0.5, 0], [1, 0, 0], [0.5, 0.5, 0], [0, 1, 0]])
    shape = geometry('<IndexedFaceSet coordIndex="0 1 2" colorIndex="1 0 1">' + SQUARE + colors + "</IndexedFaceSet>")
    np.testing.assert_array_equal(shape.colors[:3], [[0, 1, 0], [1, 0, 0], [0, 1, 0]])


def test_nested_transforms_and_groups() -> None:
    shape, ball = read(
        "<Transform translation='1 0 0' rotation='0 0 1 1.5707963267948966'><Group>"
        "<Transform scale='2 2 2' center='0 1 0'><Shape DEF='b'><Box size='1 1 1'/></Shape></Transform></Group>"
        "<Switch whichChoice='1'><Shape><Box/></Shape><Shape><Sphere/></Shape></Switch></Transform>"
    )
    assert shape.transform is not None
    np.testing.assert_allclose(shape.transform @ [0, 0, 0, 1], [2, 0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(shape.transform @ [1, 0, 0, 1], [2, 2, 0, 1], atol=1e-12)
    assert len(ball.points) > 24  # type: ignore[arg-type]


def test_lines_and_text_are_no_surface() -> None:
    lines = "<Shape><IndexedLineSet coordIndex='0 1'><Coordinate point='0 0 0 1 1 1'/></IndexedLineSet></Shape>"
    assert read(lines + "<Shape><Text/></Shape>") == []


def test_what_does_not_fit_is_refused_or_left_out() -> None:
    with pytest.raises(FileError, match=r"coordIndex: expected indices in 0..3, found 4 at entry 2"):
        geometry(f'<IndexedFaceSet coordIndex="0 1 4">{SQUARE}</IndexedFaceSet>')
    with pytest.raises(FileError, match=r"texCoordIndex: expected indices in 0..0, found 2"):
        geometry(
            f'<IndexedFaceSet coordIndex="0 1 2" texCoordIndex="0 1 2">{SQUARE}<TextureCoordinate point="0 0"/>'
            "</IndexedFaceSet>"
        )
    with pytest.warns(VitruvianWarning, match="1 texture coordinates for 3 points"):
        shape = geometry(
            f'<IndexedFaceSet coordIndex="0 1 2">{SQUARE}<TextureCoordinate point="0 0"/></IndexedFaceSet>'
        )
    assert shape.uv is None


def test_materials() -> None:
    (shape,) = read(
        "<Shape><Appearance DEF='gold'><PhysicalMaterial baseColor='1 0.8 0.2' metallic='1' roughness='0.3'/>"
        "</Appearance><Box solid='false'/></Shape>"
    )
    look = shape.material
    assert (look.name, look.color, look.metallic, look.roughness) == ("gold", (1.0, 0.8, 0.2), 1.0, 0.3)
    assert look.double_sided
    (shape,) = read("<Shape><Appearance><Material shininess='0.2' emissiveColor='0 0 2'/></Appearance><Box/></Shape>")
    assert shape.material.color == (0.8, 0.8, 0.8)
    assert shape.material.emission == (0, 0, 1)
    assert shape.material.roughness == pytest.approx(0.2691, abs=1e-3)
