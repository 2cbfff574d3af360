"""Displacements along a surface: exact per point, within 0.2 mm as a picture, at other resolutions, hostile files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vitruvian.errors import FileError, VitruvianError, VitruvianWarning
from vitruvian.formats import relief as files
from vitruvian.modeling.offsets import (
    CELLS,
    Chart,
    Relief,
    captured,
    chart_of,
    displaced,
    drawn,
    sampled,
)
from vitruvian.modeling.person import person


@pytest.fixture(scope="module")
def body():
    return person(loa=1, outfit=None, hair="none")


@pytest.fixture(scope="module")
def chart(body):
    return chart_of(body)


def bumpy(points):
    """Detail of 8 mm, waves of 12 cm."""
    return points + 0.004 * np.sin(50 * points[:, [1, 2, 0]] + [0, 1, 2])


@pytest.fixture(scope="module")
def picture(chart, tmp_path_factory):
    file = tmp_path_factory.mktemp("relief") / "d.png"
    relief = drawn(chart, bumpy(chart.points) - chart.points)
    files.write(relief, file)
    return relief, files.read(file), file


def with_points(body, points):
    out = body.copied()
    out.skin_coord = points
    return out


def halved(chart):
    """Every triangle in four, with linear UVs."""

    def split(triangles, values):
        sides = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
        edges, number = np.unique(sides, axis=0, return_inverse=True)
        a, b, c = (number.reshape(3, -1) + len(values)).astype(np.int32)
        x, y, z = triangles.T
        parts = [np.stack(t, axis=1) for t in ((x, a, c), (a, y, b), (c, b, z), (a, b, c))]
        return np.concatenate(parts), np.concatenate([values, values[edges].mean(axis=1)])

    triangles, points = split(chart.triangles, chart.points)
    corners, uv = split(chart.uv_triangles, chart.uv)
    return Chart(points, triangles, uv, corners)


def test_displacements_are_exact_on_the_same_base(body, chart):
    used = np.unique(chart.triangles)
    y = bumpy(chart.points)
    d = captured(body, with_points(body, y))
    assert np.abs(chart.points + d - y)[used].max() < 1e-12
    hidden = np.setdiff1d(np.arange(len(y)), used)
    assert len(hidden) and not d[hidden].any()  # eyes and teeth are no skin


def test_a_picture_holds_them_to_a_fifth_of_a_millimetre(body, chart, picture):
    relief, again, file = picture
    assert np.array_equal(again.texels, relief.texels) and np.array_equal(again.covered, relief.covered)
    assert (again.scale, again.offset) == (relief.scale, relief.offset)
    made = displaced(body, again)
    off = np.linalg.norm(made.skin_coord - bumpy(chart.points), axis=1)[chart.point]
    assert off.max() < 2e-4
    assert relief.scale * 65535 < 0.012  # places that share texels do not blow up the range
    half = displaced(body, again, strength=0.5)
    assert np.allclose(half.skin_coord * 2, made.skin_coord + body.skin_coord, atol=1e-12)
    from PIL import Image

    with Image.open(file) as image:  # another reader agrees that it is a picture
        assert image.size == relief.texels.shape[1::-1] and "vitruvian:scale" in image.info
        image.load()


def test_inputs_stay_as_they_are(body, picture):
    before = body.skin_coord.copy()
    displaced(body, picture[1])
    assert np.array_equal(body.skin_coord, before) and body.made_from is not None


def test_normals_alone_keep_what_goes_along_them(body, chart, tmp_path):
    along = 0.003 * np.cos(40 * chart.points[:, :1]) * chart.normals
    files.write(drawn(chart, along, normal_only=True), tmp_path / "d.png")
    again = files.read(tmp_path / "d.png")
    assert again.texels.shape[2] == 1
    assert np.linalg.norm(sampled(chart, again) - along, axis=1)[chart.point].max() < 2e-4


def test_the_same_picture_fits_a_finer_surface(chart, picture):
    """A base with every triangle in four plus the picture is nearly the target treated so."""
    fine = halved(chart)
    target = halved(replace(chart, points=bumpy(chart.points)))
    off = np.linalg.norm(fine.points + sampled(fine, picture[1]) - target.points, axis=1)[np.unique(fine.triangles)]
    assert np.percentile(off, 99.5) < 2e-4 and off.max() < 4e-3


def test_the_same_picture_fits_subdivided_bodies(body, chart, picture):
    from vitruvian.modeling.smoother import smoother

    fine = smoother(body, level=1)
    moves = displaced(fine, picture[1]).skin_coord - fine.skin_coord
    off = np.linalg.norm(fine.skin_coord + moves - bumpy(fine.skin_coord), axis=1)[np.unique(fine.skin[0].triangles)]
    assert np.percentile(off, 95) < 8e-4  # the picture knows the coarse points alone


def test_a_surface_of_another_topology_gives_its_detail(body, chart):
    fine = halved(chart)
    d = captured(body, fine.points + 0.002 * fine.normals, fine.triangles)
    assert np.median(np.sum(d * chart.normals, axis=1)[chart.point]) == pytest.approx(0.002, abs=2e-4)
    with pytest.raises(VitruvianError, match="in metres, in its pose"):
        captured(body, fine.points + [0, 9, 0], fine.triangles)
    with pytest.warns(VitruvianWarning, match="have nothing of it"):
        low = fine.triangles[(fine.points[fine.triangles, 1] < 0.3).all(axis=1)]
        captured(body, fine.points, low)


def test_a_picture_of_another_map_is_refused(body, chart, picture):
    other = body.copied()
    skin = other.skin[0]
    other.skin = [replace(skin, uv=skin.uv * [0.3, 1.0]), *other.skin[1:]]
    relief = drawn(chart_of(other), np.zeros(other.skin_coord.shape), size=64)
    with pytest.raises(VitruvianError, match="over the UVs of this body"):
        displaced(body, relief)
    with pytest.raises(VitruvianError, match="inside 0..1"):
        replace(chart, uv=chart.uv + 3)
    with pytest.raises(VitruvianError, match="seamless skin with UVs"):
        chart_of(with_points(replace(body, skin=[]), body.skin_coord))
    with pytest.raises(VitruvianError, match="strength"):
        displaced(body, picture[1], strength=1.5)
    for size in (8, 9000):
        with pytest.raises(VitruvianError, match="16..4096"):
            drawn(chart, bumpy(chart.points), size=size)
    with pytest.raises(VitruvianError, match="finite"):
        drawn(chart, np.full(chart.points.shape, np.nan))


def test_a_picture_that_is_too_small_says_so(chart):
    with pytest.warns(VitruvianWarning, match="picture of 64 texels: .* more than 0.2 mm off"):
        drawn(chart, bumpy(chart.points) - chart.points, size=64)


@pytest.mark.parametrize("damage", ["short", "no text", "no map", "sign", "sides", "scale", "cut"])
def test_damaged_pictures_are_one_line(tmp_path, damage):
    file = tmp_path / "d.png"
    files.write(
        Relief(np.arange(48, dtype=np.uint16).reshape(4, 4, 3), 1e-6, -0.01, np.ones((CELLS, CELLS), bool)), file
    )
    data = bytearray(file.read_bytes())
    if damage == "short":
        data = data[:-40]
    elif damage == "no text":
        data = data.replace(b"vitruvian:scale", b"vitruvian:scalx")
    elif damage == "no map":
        data = data.replace(b"covered\0ff", b"covered\0zz")
    elif damage == "scale":
        data = data.replace(b"scale\x001e-06", b"scale\x00nan  ")
    elif damage == "cut":
        data = data[: data.index(b"IDAT") + 8]
    elif damage == "sign":
        data[1] = 0
    else:
        data[16:20] = b"\xff\xff\xff\xff"
    file.write_bytes(data)
    with pytest.raises(FileError):
        files.read(file)
