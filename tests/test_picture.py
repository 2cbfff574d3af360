"""Pictures: known shapes cover what they should, both renderers agree, a golden picture stays as it is."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from small_body import figure, wave
from vitruvian.body.types import Part
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.show.camera import Camera, direction, fit
from vitruvian.show.figure import Figure, pose
from vitruvian.show.picture import aim, picture
from vitruvian.show.render import render
from vitruvian.show.shade import Studio, filmic, kind_of, to_linear, to_srgb
from vitruvian.show.surfaces import Surface, softened, vertex_normals
from vitruvian.show.trace import cosine, disc, tracer
from vitruvian.stage.clip import Clip, Mesh

GOLDENS = Path(__file__).with_name("goldens")
KINDS = ("embree", "numpy")


def ball(rounds: int = 5) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    mesh = trimesh.creation.icosphere(rounds)
    return np.array(mesh.vertices), np.array(mesh.faces, np.int32)


def skin_of(body) -> Surface:  # type: ignore[no-untyped-def]
    return Surface(body.skin.rest, body.skin.triangles, None, None, body.skin.parts)


@pytest.mark.parametrize("kind", KINDS)
def test_sphere_covers_pi_r_squared(kind: str) -> None:
    v, t = ball()
    camera = Camera((0, 0, 12), (0, 0, 0), 0.25)
    size = (240, 200)
    pixels = render([Surface(v, t)], camera, size, transparent=True, floor=None, tracing=kind, quality=1)
    radius = size[1] / 2 / np.tan(0.125) / np.sqrt(12**2 - 1)
    assert pixels.shape == (200, 240, 4)
    assert pixels[..., 3].sum() / 255 == pytest.approx(np.pi * radius**2, rel=0.005)


@pytest.mark.parametrize("kind", KINDS)
def test_depth_of_a_plane(kind: str) -> None:
    # the plane z = 0.3 x - 0.2 y, seen from a place where it fills the picture
    v = np.array([[x, y, 0.3 * x - 0.2 * y] for x in (-9, 9) for y in (-9, 9)], np.float32)
    rays = tracer(v, np.array([[0, 2, 1], [1, 2, 3]], np.int32), kind)
    camera = Camera((0.5, 1.0, 8.0), (0.1, 0.2, 0.0), 0.5)
    size = (64, 48)
    hits = rays.visible(camera, size, (0.5, 0.5))
    assert len(hits.pixel) == 64 * 48
    d = camera.rays(hits.pixel % 64 + 0.5, hits.pixel // 64 + 0.5, size)
    normal = np.array([-0.3, 0.2, 1.0])
    exact = -(normal @ camera.eye) / (d @ normal)
    assert np.abs(hits.depth / exact - 1).max() < 1e-5
    corner = v[np.array([[0, 2, 1], [1, 2, 3]])[hits.triangle]]
    bary = np.stack([1 - hits.u - hits.v, hits.u, hits.v], -1)
    point = np.einsum("nk,nki->ni", bary, corner)
    assert np.abs(point - (camera.eye + d * exact[:, None])).max() < 1e-3


def test_both_renderers_see_the_same() -> None:
    surface = skin_of(figure())
    v = surface.vertices.astype(np.float32)
    camera = Camera((1.0, 1.5, 4.0), (0.3, 1.3, 0), 0.4)
    seen = []
    for kind in KINDS:
        hits = tracer(v, surface.triangles, kind).visible(camera, (150, 150), (0.4, 0.6))
        image = np.full(150 * 150, -1)
        image[hits.pixel] = hits.triangle
        depth = np.zeros(150 * 150)
        depth[hits.pixel] = hits.depth
        seen.append((image, depth))
    same = seen[0][0] == seen[1][0]
    assert same.mean() > 0.999 and (seen[0][0] >= 0).sum() > 2000
    assert np.abs(seen[0][1] - seen[1][1])[same].max() < 1e-4
    pictures = [render([surface], camera, (150, 150), tracing=kind).astype(int) for kind in KINDS]
    apart = np.abs(pictures[0] - pictures[1])
    assert apart.mean() < 2.5 and np.percentile(apart, 99) < 30


def test_open_sky_and_shadow() -> None:
    # a point on a wide floor under half a wall: the wall hides just under half of the sky
    floor = np.array([[0, 0, 0]], np.float32)
    wall = np.array([[0.001, 0, -500], [0.001, 0, 500], [0.001, 900, 500], [0.001, 900, -500]], np.float32)
    up = np.array([[0, 1, 0]], np.float32)
    rays = tracer(wall, np.array([[0, 1, 2], [0, 2, 3]], np.int32), "embree")
    rows = np.arange(16, dtype=np.int32)
    sky = rays.ambient(np.repeat(floor, 16, 0), np.repeat(up, 16, 0), rows, 16)
    assert sky.mean() == pytest.approx(0.5, abs=0.02)
    assert rays.light(floor, np.array([-1, 1, 0]) / np.sqrt(2), 0.1, rows[:1], 8)[0] == 1
    assert rays.light(floor, np.array([1, 1, 0]) / np.sqrt(2), 0.1, rows[:1], 8)[0] == 0
    for count in (4, 6):
        assert np.abs(disc(count).reshape(-1, 2).mean(axis=0)).max() < 0.02
        assert cosine(count)[..., 2].mean() == pytest.approx(2 / 3, abs=0.02)


def test_mirrored_body_gives_the_mirrored_picture() -> None:
    surface = skin_of(figure())
    flip = np.array([-1.0, 1, 1])
    other = replace(surface, vertices=surface.vertices * flip, triangles=surface.triangles[:, ::-1])
    one = render([surface], Camera((1, 1.6, 4), (0.2, 1.2, 0), 0.4), (160, 160), studio=Studio()).astype(int)
    two = render([other], Camera((-1, 1.6, 4), (-0.2, 1.2, 0), 0.4), (160, 160), studio=Studio().mirrored())
    apart = np.abs(one - two[:, ::-1].astype(int))
    assert apart.mean() < 1.0 and np.percentile(apart, 99) < 16


def test_golden_picture(tmp_path: Path) -> None:
    """Re-record with VITRUVIAN_BLESS=1 after looking at the new picture."""
    body = figure()
    clip = Clip(Humanoid("tester"), body, wave(body), "linear")
    pixels = picture(clip, tmp_path / "figure.png", time=0.1, size=(180, 180))
    golden = GOLDENS / "figure.png"
    if os.environ.get("VITRUVIAN_BLESS"):
        Image.fromarray(pixels).save(golden)
    expected = np.asarray(Image.open(golden)).astype(int)
    apart = np.abs(pixels.astype(int) - expected).max(axis=-1)
    if (apart <= 3).mean() < 0.999:
        Image.fromarray(np.minimum(apart * 8, 255).astype(np.uint8)).save(tmp_path / "difference.png")
        pytest.fail(f"{(apart > 3).mean():.2%} of the pixels differ: see {tmp_path} and {golden}")


def test_repeatable_and_transparent(tmp_path: Path) -> None:
    body = figure()
    a = picture(body, tmp_path / "a.png", size=(90, 120))
    b = picture(body, tmp_path / "b.png", size=(90, 120))
    assert (a == b).all() and (np.asarray(Image.open(tmp_path / "a.png")) == a).all()
    clear = picture(body, tmp_path / "c.png", size=(90, 120), transparent=True)
    assert clear.shape == (120, 90, 4) and clear[0, 0, 3] == 0 and clear[..., 3].max() == 255


def test_views_frame_the_figure(tmp_path: Path) -> None:
    body = figure()
    who = Figure(body)
    surface = next(who.at([0.0]))
    used = surface.vertices[np.unique(surface.triangles)]
    size = (120, 160)
    for view in ("front", "side", "back", "three-quarter", "front_view"):
        camera = aim(who, surface, view, 0.0, size)[0]
        pixels, depth = camera.project(used, size)
        assert (depth > 0).all()
        if view != "front_view":
            assert (pixels.min(axis=0) > 0).all() and (pixels.max(axis=0) < size).all()
            assert max(np.ptp(pixels, axis=0) / size) > 0.75  # and it is not small
    assert aim(who, surface, "side", 0, size)[0].eye[0] > 1  # the figure's left
    assert aim(who, surface, "front", 0, size)[0].eye[2] > 1
    assert aim(who, surface, "back", 0, size)[0].eye[2] < -1
    face = aim(who, surface, "face", 0.0, size)[0]
    assert face.target[1] > 1.4 and np.linalg.norm(np.subtract(face.eye, face.target)) < 3
    hand = aim(who, surface, "hands", 0.0, size)[0]
    assert hand.target[0] > 0.6
    sheet = picture(body, tmp_path / "sheet.png", views=["front", "side"], time=[0.0, 1.0], size=(40, 50), samples=1)
    assert sheet.shape == (100, 80, 3)


def test_a_turned_figure_is_seen_from_its_front() -> None:
    body = figure()
    turned = np.array([[0, 0, 1.0, 0], [0, 1, 0, 0], [-1.0, 0, 0, 0], [0, 0, 0, 1]])  # faces +X
    who = Figure(replace(body, placement=turned))
    assert who.heading(0.0) == pytest.approx(90)
    surface = next(who.at([0.0]))
    assert aim(who, surface, "front", 0.0, (100, 100))[0].eye[0] > 1.5


def test_what_is_refused(tmp_path: Path) -> None:
    body = figure()
    for call, what in (
        (lambda: picture(body, tmp_path / "a.png", view="above"), "view above"),
        (lambda: picture(body, tmp_path / "a.bmp"), "ends in"),
        (lambda: picture(body, tmp_path / "a.jpg", transparent=True), "JPEG"),
        (lambda: picture(body, tmp_path / "a.png", samples=3), "samples"),
        (lambda: picture(body, tmp_path / "a.png", size=(0, 9)), "size"),
        (lambda: picture(body, tmp_path / "none" / "a.png", size=(9, 9), samples=1), "folder"),
        (lambda: picture("joe", tmp_path / "a.png"), "Humanoid"),
        (lambda: picture(Mesh(np.zeros((3, 3)), np.zeros((0, 3))), tmp_path / "a.png"), "nothing"),
    ):
        with pytest.raises(VitruvianError, match=what) as error:
            call()
        assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_a_skeleton_without_surface_is_drawn_as_bones(tmp_path: Path) -> None:
    body = figure()
    bare = wave(body)
    pixels = picture(bare, tmp_path / "bones.png", view="front", size=(100, 100), samples=1)
    assert np.ptp(pixels[:, 50].astype(int), axis=0).max() > 60


def test_pose_between_frames() -> None:
    body = figure()
    motion = wave(body)
    exact = pose(motion, [2 / 24, (2 + len(motion)) / 24])
    assert np.allclose(exact.rotation, motion.rotation[2])
    half = pose(motion, [2.5 / 24])
    assert np.allclose(half.translation[0], motion.translation[2:4].mean(axis=0))
    assert np.allclose(np.linalg.norm(half.rotation, axis=-1), 1)
    held = pose(replace(motion, loop=False), [99.0])
    assert np.allclose(held.rotation[0], motion.rotation[-1])


def test_see_through_parts_show_what_is_behind() -> None:
    v = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    t = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    wall = Surface(v, t, parts=(Part("wall", 0, 2, (0.9, 0.1, 0.1)),))
    pane = Surface(v * 0.5 + [0, 0, 0.5], t, parts=(Part("pane", 0, 2, (0.1, 0.1, 0.9), opacity=0.25),))
    camera = Camera((0, 0, 8), (0, 0, 0), 0.2)
    solid = Surface(pane.vertices, t, parts=(replace(pane.parts[0], opacity=1.0),))
    without, half, full = (
        to_linear(render(s, camera, (64, 64), floor=None)[32, 32] / 255) for s in ([wall], [wall, pane], [wall, solid])
    )
    assert np.allclose(half, 0.75 * without + 0.25 * full, atol=0.02)


def test_colour_curves_and_parts() -> None:
    x = np.linspace(0, 1, 64, dtype=np.float32)
    assert np.abs(to_linear(to_srgb(x)) - x).max() < 1e-5
    curve = filmic(np.linspace(0, 8, 500))
    assert (np.diff(curve) >= 0).all() and curve[0] == 0 and curve[-1] <= 1
    kinds = [kind_of(n) for n in ("skin", "eyes", "eyebrows", "hair", "lashes", "top", "shorts", "shoes", "teeth", "x")]
    assert kinds == [1, 2, 3, 3, 3, 4, 4, 5, 5, 0]


def test_normals() -> None:
    v, t = ball(3)
    n = vertex_normals(v, t)
    assert np.abs(n - v).max() < 0.02
    bumpy = (n + np.random.default_rng(0).normal(size=n.shape) * 0.2).astype(np.float32)
    bumpy /= np.linalg.norm(bumpy, axis=1, keepdims=True)
    assert np.abs(softened(bumpy, t) - v).mean() < 0.5 * np.abs(bumpy - v).mean()


def test_fit_uses_the_whole_picture() -> None:
    points = np.random.default_rng(1).normal(size=(50, 3))
    for size in ((100, 300), (300, 100)):
        camera = fit(points, direction(30, 10), size, margin=0.1)
        pixels, _ = camera.project(points, size)
        share = np.ptp(pixels, axis=0) / size
        assert max(share) == pytest.approx(0.8, abs=0.02)
        assert np.abs((pixels.min(axis=0) + pixels.max(axis=0)) / 2 - np.array(size) / 2).max() < 0.03 * max(size)


def test_creases_split_normals_where_the_part_says() -> None:
    from vitruvian.body.seams import creases, face_normals

    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    t = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
                  [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]], np.int32)  # fmt: skip
    flat = face_normals(cube, t)
    assert creases(cube, t, (Part("cube", 0, 12),)) is None
    for crease in (0.0, 1.0, 2.0):
        matrix = creases(cube, t, (Part("cube", 0, 12, crease=crease),))
        assert matrix is not None
        normal = matrix @ flat
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        along = (normal * np.repeat(flat, 3, axis=0)).sum(axis=1)
        assert along.min() == pytest.approx(1.0) if crease < 1.5 else along.min() < 0.9 and along.min() > 0.3


def test_close_views_are_rounder() -> None:
    from vitruvian.show.refine import refined, split

    v, t = ball(2)
    colors = np.abs(v)
    half = len(t) // 2
    coarse = Surface(v, t, None, colors, (Part("a", 0, half), Part("b", half, len(t))))
    fine = split(coarse, np.ones(len(t), bool))
    assert len(fine.triangles) == 4 * len(t) and [p.stop for p in fine.parts] == [4 * half, 4 * len(t)]
    radius = np.linalg.norm(fine.vertices, axis=1)
    plain = np.linalg.norm((v[t[:, 0]] + v[t[:, 1]]) / 2, axis=1)
    assert np.abs(radius - 1).max() < 0.2 * np.abs(plain - 1).max()
    normal = np.cross(*(fine.vertices[fine.triangles[:, i]] - fine.vertices[fine.triangles[:, 0]] for i in (1, 2)))
    assert ((normal * fine.vertices[fine.triangles[:, 0]]).sum(axis=1) > 0).all()  # none is turned over
    edges = np.sort(np.concatenate([fine.triangles[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()  # and nothing is torn
    some = np.arange(len(t)) < 10
    assert len(split(coarse, some).triangles) == len(t) + 30
    far, near = Camera((0, 0, 60), (0, 0, 0), 0.2), Camera((0, 0, 4), (0, 0, 0), 0.6)
    assert len(refined(coarse, far, (100, 100)).triangles) == len(t) < len(refined(coarse, near, (400, 400)).triangles)
