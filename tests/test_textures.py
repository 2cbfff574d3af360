"""Pictures on surfaces are drawn: the right way up, wrapped, filtered, the same here, in the page and elsewhere."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

import cards
import vitruvian as vt
from cards import CELLS, cells, in_page, in_three, in_xite, levels, photographed, places, sampled
from vitruvian.body.types import Part
from vitruvian.errors import VitruvianWarning
from vitruvian.hanim.humanoid import Picture
from vitruvian.show.actors import actors_of, mesh_messages
from vitruvian.show.camera import Camera
from vitruvian.show.comparison import chequered
from vitruvian.show.figure import Figure
from vitruvian.show.recording import messages
from vitruvian.show.render import render
from vitruvian.show.server import FOLDER
from vitruvian.show.showing import Showing
from vitruvian.show.textures import SIDE, Sent, opened, texture
from vitruvian.show.wire import decode
from vitruvian.stage.clip import Clip
from xite import page_of

TRUE = cells().reshape(-1, 3) > 128
CLOSE = 0.1  # mean difference of channels in 0..1, the light taken out; tone curves differ, a wrong picture has 0.5


def alike(ours: np.ndarray, theirs: np.ndarray) -> bool:
    ours, theirs = levels(ours), levels(theirs)
    assert theirs.std() > 0.3  # something is seen
    return bool(np.abs(ours - theirs).mean() < CLOSE) and bool(((ours > 0.5) == (theirs > 0.5)).all())


def card(tmp_path: Path, *arguments, **options):
    (tmp_path / "card.x3d").write_text(cards.scene(*arguments, **options), "utf-8")
    return vt.load(tmp_path / "card.x3d")


@pytest.fixture(scope="module")
def stranger(browser, referee):
    with page_of(browser, referee) as page:
        yield page


@pytest.mark.parametrize("faces", cards.FACES)
def test_a_card_looks_as_in_x_ite_here_and_in_the_page(tmp_path, browser, stranger, faces):
    h, text = card(tmp_path, faces), cards.scene(faces)
    theirs = in_xite(stranger, text, places())
    assert alike(photographed(h, places()), theirs)
    assert alike(in_page(browser, h, places(), tmp_path), theirs)
    if faces == "point":
        assert ((levels(theirs) > 0.5) == TRUE).all()  # and as it is meant


@pytest.mark.parametrize("faces", ["corner", "beyond", "moved"])
def test_a_card_in_a_glb_looks_as_in_three(tmp_path, browser, referee, faces):
    vt.save(card(tmp_path, faces), tmp_path / "card.glb")
    h = vt.load(tmp_path / "card.glb")
    theirs = in_three(browser, referee, tmp_path / "card.glb", places())
    assert alike(photographed(h, places()), theirs)
    assert alike(in_page(browser, h, places(), tmp_path), theirs)


def test_a_figure_in_usd_keeps_its_picture(tmp_path):
    pytest.importorskip("pxr")
    h = card(tmp_path, "corner")
    vt.save(h, tmp_path / "card.usda")
    assert alike(photographed(vt.load(tmp_path / "card.usda"), places()), photographed(h, places()))


@pytest.mark.parametrize("tracing", ["embree", "numpy"])
def test_holes_show_what_is_behind(tmp_path, tracing):
    """A card whose picture has holes in every second cell: there the paper is seen, elsewhere the card."""
    holes = np.indices((CELLS, CELLS)).sum(axis=0) % 2 * 255
    h = card(tmp_path, data=cards.picture(holes))
    seen = photographed(h, places(), transparent=True, tracing=tracing)
    solid = photographed(card(tmp_path), places(), tracing=tracing)
    there = holes.reshape(-1) > 0
    assert (seen[~there] == 0).all()  # nothing, black under no cover
    assert np.abs(seen[there] - solid[there]).max() < 8


@pytest.mark.parametrize("tracing", ["embree", "numpy"])
def test_holes_of_one_surface_show_the_next(tmp_path, tracing):
    holes = np.zeros((CELLS, CELLS))
    holes[:, 3:] = 255
    h = card(tmp_path, data=cards.picture(holes))
    back = card(tmp_path).joints()[0].segments[0].shapes[0]
    back.points = back.points - [0, 0, 0.05]
    h.joints()[0].segments[0].shapes.append(back)
    seen = photographed(h, places(), tracing=tracing)
    assert alike(seen, photographed(card(tmp_path), places(), tracing=tracing))


def test_a_fine_chequer_far_away_is_grey_and_does_not_crawl(tmp_path):
    board = np.indices((1024, 1024)).sum(axis=0) % 2 * 255
    out = io.BytesIO()
    Image.fromarray(board.astype(np.uint8)).save(out, "PNG")
    h = card(tmp_path, data=out.getvalue())
    surface = next(iter(Figure(h).at([0.0])))
    images = []
    for shift in (0.0, 0.0021):
        camera = Camera((shift, cards.WIDE, 6.0), (shift, cards.WIDE, 0.0))
        images.append(render([surface], camera, (160, 160), floor=None, quality=1)[60:100, 60:100].astype(int))
    assert images[0].std() < 3 and np.abs(images[0] - images[1]).max() < 6
    assert 90 < images[0].mean() < 215  # the mean of the light, not of the bytes


def test_pictures_travel_once_and_not_with_frames(tmp_path):
    h = card(tmp_path)
    showing = Showing(actors_of([h, h]))
    headers = [decode(m)[0] for m in messages(showing)]
    kinds = [m["type"] for m in headers]
    assert kinds == ["hello", "picture", "mesh", "mesh", "frame"]
    (first, second) = (m for m in headers if m["type"] == "mesh")
    assert first["parts"][0]["picture"] == second["parts"][0]["picture"]
    assert first["parts"][0]["picture"]["name"] == headers[1]["name"]


def test_a_picture_that_would_not_fit_is_left_out(tmp_path, monkeypatch):
    """Too many pixels, cut short, not what it says: the surface keeps its colour, with one warning."""
    good = cards.picture(each=8)
    wide = bytearray(good)
    wide[16:24] = (16000).to_bytes(4) * 2  # the header says 256 million pixels
    for data in (bytes(wide), good[:60], good[:33] + b"\0" * 400, b"\x89PNG\r\n\x1a\n" + b"IHDR" * 20):
        h = card(tmp_path, data=data)
        with pytest.warns(VitruvianWarning, match="keeps its colour"):
            seen = photographed(h, places(), size=200)
        assert np.ptp(seen) < 40
        with pytest.warns(VitruvianWarning, match="keeps its colour"):
            (mesh,) = (m for m in map(decode, mesh_messages(actors_of([h])[0])))
        assert "picture" not in mesh[0]["parts"][0]


def test_large_pictures_are_made_smaller_for_the_page():
    out = io.BytesIO()
    Image.new("RGB", (SIDE + 400, 300), (10, 200, 30)).save(out, "PNG")
    sent = Sent()
    part = Part("card", 0, 1, picture=Picture("wide", out.getvalue()))
    name = sent.part(part)["picture"]["name"]
    assert max(Image.open(io.BytesIO(sent.data[name][1])).size) == SIDE


@given(st.binary(max_size=300), st.integers(0, 400), st.sampled_from(["PNG", "JPEG"]))
def test_no_bytes_crash_the_decoder(noise, at, kind):
    good = cards.picture(each=2, kind=kind)
    for data in (noise, good[:at] + noise, good[:at] + noise + good[at + len(noise) :]):
        image = opened(data, 64)
        assert image is None or max(image.size) <= 64


@given(
    arrays(np.float64, (12, 2), elements=st.floats(allow_nan=True, allow_infinity=True)),
    st.tuples(st.booleans(), st.booleans()),
)
def test_no_coordinates_crash_the_lookup(uv, repeat):
    found = texture(Picture("card", cards.picture(each=2), repeat=repeat))
    assert found is not None
    colors = found.colors(uv, np.linspace(-3, 20, len(uv)))
    assert np.isfinite(colors).all() and (colors >= 0).all() and (colors <= 1.001).all()


def test_stripes_take_the_place_of_pictures(tmp_path):
    h = card(tmp_path)
    surface = next(iter(Figure(h).at([0.0])))
    striped = chequered(surface, surface.vertices)
    assert all(p.picture is None for p in striped.parts)


@pytest.fixture(scope="module")
def suited():
    """The built-in person in contours, its suit chequered, the left knee bent; and the same from a DefBodyTex file."""
    h = vt.person(outfit="body suit", hair="none")
    board = np.indices((64, 64)).sum(axis=0) % 2 * 150 + 60
    out = io.BytesIO()
    Image.fromarray(board.astype(np.uint8)).resize((1024, 1024), Image.Resampling.NEAREST).save(out, "PNG")
    for shape in h.skin:
        shape.material.picture = Picture("board", out.getvalue())
    return vt.contours(h)


@pytest.mark.parametrize("how", ["made", "file"])
def test_a_chequer_goes_on_across_the_seam_of_the_knee(tmp_path, suited, how):
    """Pixels on both sides of the knee's seam, a hundredth of a contour apart, have one colour."""
    h = suited
    if how == "file":
        vt.save(h, tmp_path / "suit.wrl")
        h = vt.load(tmp_path / "suit.wrl")
    body = vt.pack(h)
    thigh, shank = (next(s for s in body.contours if s.name.startswith(n)) for n in ("l_thigh", "l_calf"))
    turn = body.skeleton.rotation.copy()
    turn[body.skeleton.index["l_knee"]] = [np.sin(0.4), 0, 0, np.cos(0.4)]
    body = replace(body, skeleton=replace(body.skeleton, rotation=turn))
    surface = next(iter(Figure(Clip(h, body, None, "contours")).at([0.0])))
    v = surface.vertices
    above, seam, below, own = v[thigh.vertices[-2]], v[thigh.vertices[-1]], v[shank.vertices[1]], v[shank.vertices[0]]
    assert np.array_equal(seam, own)
    middle = seam.mean(axis=0)
    front = np.flatnonzero((seam - middle)[:, 2] > 0.5 * (seam - middle)[:, 2].max())
    camera = Camera(tuple(middle + [0, 0.1, 0.9]), tuple(middle), fov=0.25)
    sides = [seam + 0.12 * (other - seam) for other in (above, below)]
    image = render([surface], camera, (600, 600), floor=None, samples=9)
    a, b = (sampled(image, camera.project(s[front], (600, 600))[0]) for s in sides)
    assert np.ptp(image[250:350, 250:350]) > 80  # the chequer is there
    assert len(front) >= 5 and np.median(np.abs(a - b)) < 12


TUBE = """
const [, folder] = process.argv, { coarser, mapped, ordered } = await import(`file://${folder}/detail.js`);
const N = 120, M = 60, rest = [], source = [], uv = [], triangles = [];
const turn = (2 * Math.PI) / N;
for (let j = 0; j <= M; j++) for (let i = 0; i < N; i++) rest.push(Math.cos(turn * i), (3 * j) / M, Math.sin(turn * i));
for (let j = 0; j <= M; j++) for (let i = 0; i < N; i++) { // the cut runs along i = 0, which is drawn twice
  source.push(N * j + i); uv.push(i / N, j / M);
  if (!i) { source.push(N * j); uv.push(1, j / M); }
}
const at = (i, j) => (N + 1) * j + (i === N ? 1 : i ? i + 1 : 0);
for (let j = 0; j < M; j++) for (let i = 0; i < N; i++) {
  triangles.push(at(i, j), at(i, j + 1), at(i + 1, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1));
}
const whole = { source, uv, rest, triangles }, answer = [];
for (const cell of [0.11, 0.2, 0.3]) {
  const points = triangles.map((v) => source[v]), kinds = new Uint8Array(rest.length / 3);
  const made = coarser(rest, points, [{ start: 0, stop: triangles.length / 3 }], cell, kinds);
  const split = mapped(made, whole, cell), order = ordered(split.triangles, split.groups, split.source.length);
  let wide = 0, off = 0;
  for (let k = 0; k < order.triangles.length; k += 3) {
    const u = [0, 1, 2].map((c) => split.uv[2 * order.source[order.triangles[k + c]]]);
    wide = Math.max(wide, Math.max(...u) - Math.min(...u));
  }
  split.source.forEach((s, i) => { off = Math.max(off, Math.abs(rest[3 * s + 1] / 3 - split.uv[2 * i + 1])); });
  answer.push([cell, triangles.length / order.triangles.length, wide, off]);
}
console.log(JSON.stringify(answer));
"""


def test_coarser_surfaces_of_the_page_keep_the_borders_of_pictures():
    """A tube of radius one that is cut along one side, drawn with fewer triangles: none goes over the whole picture."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node")
    command = [node, "--input-type=module", "-e", TUBE, str(FOLDER)]
    for cell, fewer, wide, off in json.loads(subprocess.run(command, check=True, capture_output=True).stdout):
        assert fewer > 1.5
        assert wide < 5 * cell / (2 * np.pi)  # a triangle is up to two cells' diagonals long
        assert off < 4 * cell / 3
