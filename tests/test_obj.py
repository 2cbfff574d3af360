"""OBJ: what is read, what is refused and where."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from small_body import figure, wave
from vitruvian.errors import FileError, VitruvianError, VitruvianWarning
from vitruvian.formats.obj import read_mesh, read_obj, write_obj
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.stage.clip import Clip, Mesh


def put(folder: Path, text: str | bytes, name: str = "a.obj") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def area(mesh: Mesh) -> float:
    p = mesh.vertices[mesh.triangles]
    return float(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])[:, 2].sum() / 2)


def test_polygons_and_relative_indices(tmp_path: Path) -> None:
    mesh = read_obj(put(tmp_path, "# square\r\n" + SQUARE + "f -4 -3 -2 \\\n -1\nf 1//7 2//7 3//7\n"))
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]
    assert mesh.name == "a" and mesh.uv is None


def test_concave_polygon_is_cut_into_ears(tmp_path: Path) -> None:
    # an arrow head: the fan from its first corner would cover area outside
    points = [(1, 0), (2, 2), (0, 1.2), (-2, 2), (-1, 0), (0, 0.8)]
    text = "".join(f"v {x} {y} 0\n" for x, y in points) + "f 1 2 3 4 5 6\n"
    mesh = read_obj(put(tmp_path, text))
    x, y = np.array(points).T
    shoelace = 0.5 * float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())
    p = mesh.vertices[mesh.triangles]
    each = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])[:, 2]
    assert len(mesh.triangles) == 4 and (each > 0).all() and area(mesh) == pytest.approx(shoelace)


def test_seams_and_colours(tmp_path: Path) -> None:
    text = SQUARE.replace("0\n", "0 1 0.5 0\n") + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0.2 0.2\nf 1/1 2/2 3/3\nf 1/4 3/3 4/1\n"
    mesh = read_obj(put(tmp_path, text))
    assert mesh.uv is not None and mesh.uv_triangles is not None and mesh.colors is not None
    assert len(mesh.vertices) == 4 and len(mesh.uv) == 4 and mesh.uv_triangles[1].tolist() == [3, 2, 0]
    write_obj(mesh, tmp_path / "b.obj")
    again = read_obj(tmp_path / "b.obj")
    assert again.uv_triangles is not None
    assert (again.triangles == mesh.triangles).all() and (again.uv_triangles == mesh.uv_triangles).all()
    assert np.allclose(again.colors, mesh.colors) and np.allclose(again.uv, mesh.uv)


@pytest.mark.parametrize(
    ("text", "line", "what"),
    [
        ("v 0 0 nan\n", 1, "finite"),
        ("v 0 0 0\nv 1e999 0 0\n", 2, "finite"),
        ("v 0 0 x\n", 1, "'x'"),
        ("v 0 0\n", 1, "3 numbers"),
        (SQUARE + "f 1 2\n", 5, "corners"),
        (SQUARE + "f 1 2 9\n", 5, "1..4"),
        (SQUARE + "f 1 2 3\nf 1 2 -5\n", 6, "1..4"),
        (SQUARE + "f 1 2 0\n", 5, "1..4"),
        (SQUARE + "f 1 2 99999999999999999999999\n", 5, "number of a vertex"),
        (SQUARE + "f 1 2 4000000000\n", 5, "1..4"),
        (SQUARE + "f 1/1 2/1 3/1\n", 5, "texture"),
        (SQUARE + "f 1 2 three\n", 5, "'three'"),
        (SQUARE, 0, "found none"),
        ("", 0, "found none"),
        (b"\x00\x01\x02" * 50, 0, "binary"),
    ],
)
def test_refused_in_one_line(tmp_path: Path, text: str | bytes, line: int, what: str) -> None:
    with pytest.raises(FileError, match=what) as error:
        read_obj(put(tmp_path, text))
    assert error.value.line == line and "\n" not in str(error.value)


def test_absent_file() -> None:
    with pytest.raises(FileError, match="can't be read"):
        read_obj("/nowhere/at/all.obj")


def test_strange_statements_are_named(tmp_path: Path) -> None:
    with pytest.warns(VitruvianWarning, match=":5: .*curv2"):
        mesh = read_obj(put(tmp_path, SQUARE + "curv2 1 2 3\nf 1 2 3\n"))
    assert len(mesh.triangles) == 1


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.one_of(
            st.tuples(
                st.sampled_from(["v", "vt", "f", "vn", "g", "x"]), st.text("0123456789-./ene+aif\\#", max_size=16)
            ),
            st.tuples(st.just("v"), st.just("0.5 1 2")),
            st.tuples(st.just("f"), st.just("1 2 3")),
        ),
        max_size=12,
    )
)
def test_anything_is_a_mesh_or_one_error(tmp_path: Path, lines: list[tuple[str, str]]) -> None:
    path = put(tmp_path, "\n".join(f"{a} {b}" for a, b in lines))
    try:
        mesh = read_obj(path)
    except FileError as error:
        assert "\n" not in str(error)
    else:
        assert len(mesh.triangles) and np.isfinite(mesh.vertices).all() and mesh.triangles.max() < len(mesh.vertices)


def test_clip_at_a_time_says_what_is_lost(tmp_path: Path) -> None:
    from vitruvian.body.kinematics import joint_matrices
    from vitruvian.deform.deformer import deformer

    body = figure()
    motion = wave(body)
    with pytest.warns(VitruvianWarning, match="skeleton"):
        report = write_obj(Clip(Humanoid("tester"), body, motion, "linear"), tmp_path / "a.obj", time=3 / 24)
    assert len(report["lost"]) == 2 and report["triangles"] == len(body.skin.triangles)
    mesh = read_obj(tmp_path / "a.obj")
    moved = deformer("linear", body)(joint_matrices(body.skeleton, motion)[3:4])[0]
    assert np.abs(mesh.vertices - moved).max() < 1e-5
    assert (mesh.triangles == body.skin.triangles).all() and mesh.colors is not None
    with pytest.raises(VitruvianError, match="no triangle"):
        write_obj(Mesh(mesh.vertices, np.zeros((0, 3))), tmp_path / "b.obj")
    assert not (tmp_path / "b.obj").exists()


def test_real_scan(shared: Path) -> None:
    mesh = read_obj(shared / "data" / "scans" / "human_man.obj")
    assert len(mesh.vertices) == 6890 and len(mesh.triangles) == 13776


def test_ply_and_stl(tmp_path: Path) -> None:
    import trimesh

    ball = trimesh.creation.icosphere(1)
    for ending in ("ply", "stl"):
        ball.export(tmp_path / f"ball.{ending}")
        mesh = read_mesh(tmp_path / f"ball.{ending}")
        assert len(mesh.vertices) == len(ball.vertices) and len(mesh.triangles) == len(ball.faces)
    for name, data in (
        ("a.stl", b"solid"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 9999999999\n"),
        ("b.stl", b""),
    ):
        with pytest.raises(FileError):
            read_mesh(put(tmp_path, data, name))
