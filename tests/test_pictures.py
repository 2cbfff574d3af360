"""Pictures on surfaces go from file to file as they are, and nothing outside the file's folder is opened."""

from __future__ import annotations

import base64
import io
import json
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import vitruvian as vt
from gltf_maker import Foreign, Maker
from test_bake import bendy
from vitruvian.errors import FileError, VitruvianWarning
from vitruvian.formats import registry
from vitruvian.formats.pictures import MAX_SIDE, content, kind, transparent
from vitruvian.hanim.humanoid import Humanoid, Picture
from xite import complaints, page_of


def png(color=(200, 40, 90), size=(4, 3), alpha: bool = False) -> bytes:
    """A picture of one colour."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    pixel = bytes(color) + (b"\x80" if alpha else b"")
    rows = b"".join(b"\0" + pixel * size[0] for _ in range(size[1]))
    head = struct.pack(">IIBBBBB", *size, 8, 6 if alpha else 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


JPEG = b"\xff\xd8\xff\xe0\0\x10JFIF\0\1\1\0\0\1\0\1\0\0\xff\xc0\0\x11\x08\0\x07\0\x09\3\1\x22\0\2\x11\1\3\x11\1\xff\xd9"


def dressed(picture: Picture | None = None) -> Humanoid:
    """A skin whose faces have texture coordinates and a picture."""
    h = bendy().humanoid
    shape = h.skin[0]
    shape.uv = np.stack([h.skin_coord[:, 0] * 1.5, h.skin_coord[:, 2] * 4 + 0.5], -1)
    shape.uv_triangles = shape.triangles.copy()
    shape.material.color = (0.5, 1.0, 1.0)
    shape.material.picture = picture or Picture("cloth", png(), repeat=(False, True), alpha="mask")
    return h


def picture_of(h: Humanoid) -> Picture:
    shape = next(s for s in h.skin if s.uv is not None)
    assert shape.material.picture is not None
    return shape.material.picture


PAIRS = [
    *[(".glb", second) for second in (".glb", ".x3d", ".wrl", ".usdz")],
    *[(first, ".glb") for first in (".x3d", ".wrl", ".x3dv", ".json", ".usdz", ".usda")],
    (".x3d", ".wrl"), (".wrl", ".x3d"), (".wrl", ".wrl"), (".usdz", ".usdc"),
]  # fmt: skip


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_bytes_and_places_survive_two_formats(tmp_path, first, second):
    if ".usd" in first + second:
        pytest.importorskip("pxr")
    h = dressed()
    one, two = tmp_path / "a" / f"one{first}", tmp_path / "b" / f"two{second}"
    for path in (one, two):
        path.parent.mkdir()
    registry.save(h, one)
    report = registry.save(vt.load(one), two)
    if (first, second) == (".wrl", ".wrl"):  # back into its own graph, word for word
        assert any("1 pictures stay beside" in line and "one-cloth.png" in line for line in report["lost"])
        return
    assert not [line for line in report["lost"] if "picture" in line]
    again = vt.load(two)
    found = content(picture_of(again))
    assert found == (png(), "image/png") and picture_of(again).repeat == (False, True)
    shape, old = again.skin[0], h.skin[0]
    assert np.allclose(
        np.sort(shape.uv[shape.uv_triangles].reshape(-1)), np.sort(old.uv[old.triangles].reshape(-1)), atol=1e-6
    )
    if first not in (".wrl", ".x3dv", ".x3d", ".json") or second not in (".wrl",):
        assert shape.material.color == pytest.approx(old.material.color, abs=2e-3)


@pytest.mark.parametrize("form", [".wrl", ".usda"])
def test_a_picture_beside_the_file(tmp_path, form):
    if form == ".usda":
        pytest.importorskip("pxr")
    path = tmp_path / f"body{form}"
    registry.save(dressed(), path)
    assert (tmp_path / "body-cloth.png").read_bytes() == png()
    assert "body-cloth.png" in path.read_text()
    (tmp_path / "body-cloth.png").unlink()
    report = registry.save(vt.load(path) if form == ".wrl" else dressed(), tmp_path / "out.glb")
    if form == ".wrl":
        assert any("1 pictures that are not beside their file" in line for line in report["lost"])


def test_a_scene_keeps_the_addresses_of_pictures_in_its_own_folder(tmp_path):
    h = dressed(Picture(urls=("cloth.png", "https://example.org/cloth.png"), folder=str(tmp_path)))
    registry.save(h, tmp_path / "one.x3d")
    assert "cloth.png" in (tmp_path / "one.x3d").read_text()
    (tmp_path / "cloth.png").write_bytes(png())
    other = tmp_path / "other"
    other.mkdir()
    registry.save(vt.load(tmp_path / "one.x3d"), other / "two.x3d", hanim="1.0")
    assert base64.b64encode(png()).decode() in (other / "two.x3d").read_text()


@pytest.mark.parametrize(
    "url",
    ["../secret.png", "/etc/passwd", "http://example.org/a.png", "file:///etc/passwd", "sub/../../secret.png", "link.png",
     "\\\\host\\a.png", "data:image/png;base64,!!!!", "data:text/html,<b>", "a\0b.png", "words.png"],
)  # fmt: skip
def test_nothing_else_is_opened(tmp_path, url):
    home = tmp_path / "home"
    home.mkdir()
    (tmp_path / "secret.png").write_bytes(png())
    (home / "link.png").symlink_to(tmp_path / "secret.png")
    (home / "words.png").write_text("not a picture, though its name says so")
    assert content(Picture(urls=(url,), folder=str(home))) is None
    report = registry.save(dressed(Picture(urls=(url,), folder=str(home))), home / "out.glb")
    assert any("pictures that are not beside" in line for line in report["lost"])
    assert picture_names(home / "out.glb") == ["white"]


def picture_names(path: Path) -> list[str]:
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    return [i["name"] for i in json.loads(data[20 : 20 + length]).get("images", [])]


def test_what_counts_as_a_picture():
    assert kind(png()) == "image/png" and kind(JPEG) == "image/jpeg"
    assert kind(png(size=(1, 1))[:20]) is None and kind(b"") is None and kind(b"GIF89a") is None
    huge = bytearray(png())
    huge[16:20] = (MAX_SIDE + 1).to_bytes(4)
    assert kind(bytes(huge)) is None
    assert not transparent(png()) and transparent(png(alpha=True)) and not transparent(JPEG)


@given(st.binary(max_size=80), st.integers(0, 120))
def test_headers_of_any_kind_are_judged_without_a_crash(noise, at):
    for start in (png(), JPEG):
        data = start[:at] + noise + start[at:]
        assert kind(data) in (None, "image/png", "image/jpeg")
        transparent(png()[:33] + noise)


def test_transparency_is_kept_where_the_picture_has_some(tmp_path):
    for alpha, data in (("mask", png(alpha=True)), ("blend", png(alpha=True)), ("", png(alpha=True)), ("mask", png())):
        registry.save(dressed(Picture("hair", data, alpha=alpha)), tmp_path / "hair.glb")
        expected = alpha if transparent(data) else ""
        assert picture_of(vt.load(tmp_path / "hair.glb")).alpha == expected


def textured(maker: Maker, image: dict, **texture) -> None:
    """One picture for all primitives, with coordinates in TEXCOORD_1 that are moved."""
    number = maker.put("textures", {"source": maker.put("images", image)})
    maker.put("materials", {"pbrMetallicRoughness": {"baseColorTexture": {"index": number, **texture}}})
    for mesh in maker.json["meshes"]:
        for primitive in mesh["primitives"]:
            n = maker.json["accessors"][primitive["attributes"]["POSITION"]]["count"]
            uv = np.stack([np.linspace(0, 1, n), np.linspace(0, 0.5, n)], -1).astype(np.float32)
            primitive["attributes"]["TEXCOORD_0"] = maker.add(np.zeros((n, 2)))
            primitive["attributes"]["TEXCOORD_1"] = maker.add(uv)
            primitive["material"] = len(maker.json["materials"]) - 1


def test_foreign_pictures_by_every_road(tmp_path):
    moved = {
        "texCoord": 1,
        "extensions": {"KHR_texture_transform": {"offset": [0.25, 0.5], "scale": [2, 2], "rotation": 0.5}},
    }
    (tmp_path / "skin.png").write_bytes(png())
    for image in (
        {"uri": "skin.png"},
        {"uri": "data:image/png;base64," + base64.b64encode(png()).decode()},
        None,
    ):
        maker = Foreign().maker
        if image is None:
            image = {"bufferView": maker.view(png()), "mimeType": "image/png"}
        textured(maker, image, **moved)
        h = vt.load(maker.gltf(tmp_path / "rig.gltf"))
        assert content(picture_of(h)) == (png(), "image/png")
        uv = np.concatenate([s.uv for s in h.skin if s.uv is not None])
        c, s = np.cos(0.5), np.sin(0.5)
        first = np.array([0.25, 1 - 0.5])  # of the vertex (0, 0)
        last = np.array([0.25 + c * 2 + s * 1, 1 - (0.5 - s * 2 + c * 1)])
        assert np.linalg.norm(uv - first, axis=1).min() < 1e-6 and np.linalg.norm(uv - last, axis=1).min() < 1e-6


def test_pictures_that_cannot_be_had_are_left_out_with_a_warning(tmp_path):
    for image, match in (
        ({"uri": "gone.png"}, "no file"),
        ({"uri": "../out.png"}, "outside"),
        ({"uri": "data:,x"}, "no PNG"),
    ):
        maker = Foreign().maker
        textured(maker, image)
        with pytest.warns(VitruvianWarning, match=match):
            h = vt.load(maker.gltf(tmp_path / "rig.gltf"))
        assert all(s.material.picture is None for s in h.skin)
    maker = Foreign().maker
    textured(maker, {"bufferView": 10**6})
    with pytest.raises(FileError):
        vt.load(maker.gltf(tmp_path / "rig.gltf"))


def test_a_usd_file_opens_no_picture_outside_its_folder(tmp_path):
    pytest.importorskip("pxr")
    home = tmp_path / "home"
    home.mkdir()
    registry.save(dressed(), home / "body.usda")
    text = (home / "body.usda").read_text()
    (tmp_path / "body-cloth.png").write_bytes(png())
    for name in ("../body-cloth.png", "/etc/passwd", "https://example.org/a.png", "gone.png"):
        (home / "body.usda").write_text(text.replace("@./body-cloth.png@", f"@{name}@"))
        with pytest.warns(VitruvianWarning, match="left out"):
            h = vt.load(home / "body.usda")
        assert all(s.material.picture is None for s in h.skin)


def test_texture_transforms_move_the_coordinates(tmp_path):
    path = tmp_path / "a.x3d"
    (tmp_path / "cloth.png").write_bytes(png())
    h = dressed(Picture(urls=("cloth.png",), folder=str(tmp_path)))
    registry.save(h, path)
    text = path.read_text()
    path.write_text(text.replace("</Appearance>", '<TextureTransform containerField="textureTransform" '
                                 'translation="0.1 0.2" '
                                 'center="0.5 0.5" scale="2 3" rotation="0.7"/></Appearance>'))  # fmt: skip
    moved, plain = vt.load(path).skin[0].uv, h.skin[0].uv
    c, s = np.cos(0.7), np.sin(0.7)
    at = plain + [0.1, 0.2] + [0.5, 0.5]
    expected = np.stack([(c * at[:, 0] - s * at[:, 1]) * 2, (s * at[:, 0] + c * at[:, 1]) * 3], -1) - 0.5
    assert np.allclose(moved, expected, atol=1e-6)


@pytest.mark.parametrize("form", ["x3d", "x3dv"])
def test_xite_draws_the_picture(browser, referee, tmp_path, form):
    h = dressed(Picture("cloth", png((0, 255, 0)), alpha="mask"))
    h.skin[0].material = replace(h.skin[0].material, color=(1.0, 1.0, 1.0), emission=(0.0, 0.0, 0.0))
    path = tmp_path / f"body.{form}"
    registry.save(h, path)
    with page_of(browser, referee) as page:
        result = page.load(path.read_text())
        assert result["nodes"]["ImageTexture"] == 1 and not complaints(result)
        page.page.wait_for_timeout(300)
        shot = page.page.screenshot(clip={"x": 0, "y": 0, "width": 200, "height": 200})
    image = pytest.importorskip("PIL.Image")
    pixels = np.asarray(image.open(io.BytesIO(shot)).convert("RGB")).reshape(-1, 3).astype(int)
    green = (pixels[:, 1] > 60) & (pixels[:, 0] < pixels[:, 1] / 2) & (pixels[:, 2] < pixels[:, 1] / 2)
    assert green.sum() > 50
