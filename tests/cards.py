"""Test cards: figures with a picture of coloured cells that no turn, mirror or exchange of colours leaves the same, and
how they look in our page, in our headless pictures and in the viewers of others."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import numpy as np
from PIL import Image

from pages import opened, wait
from vitruvian.show.camera import Camera
from vitruvian.show.figure import Figure
from vitruvian.show.recording import record
from vitruvian.show.render import render

CELLS = 6
WIDE = 0.8  # metres from the middle of a card to its sides


def cells(seed: int = 3) -> np.ndarray:
    """(CELLS,CELLS,3) colours, each channel low or high, rows from the top of the picture."""
    return np.where(np.random.default_rng(seed).random((CELLS, CELLS, 3)) < 0.5, 90, 210).astype(np.uint8)


def picture(alpha: np.ndarray | None = None, each: int = 24, kind: str = "PNG") -> bytes:
    """The card as a file; `alpha` (CELLS,CELLS) in 0..255."""
    pixels = cells() if alpha is None else np.concatenate([cells(), alpha[..., None].astype(np.uint8)], -1)
    out = io.BytesIO()
    Image.fromarray(pixels.repeat(each, 0).repeat(each, 1)).save(out, kind)
    return out.getvalue()


def uri(data: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(data).decode()}"


def places() -> np.ndarray:
    """(CELLS * CELLS,3) places in the cells of an upright card that shows its picture once, rows from the top; off their
    middles, so that they are in cells of cards that show it twice too."""
    at = (np.arange(CELLS) + 0.7) / CELLS * 2 * WIDE - WIDE
    x, y = np.meshgrid(at, -at)
    return np.stack([x, y + WIDE, 0 * x], -1).reshape(-1, 3)


# coordinates of the four corners, from the lower left one on, anticlockwise
QUAD = f"{-WIDE} 0 0, {WIDE} 0 0, {WIDE} {2 * WIDE} 0, {-WIDE} {2 * WIDE} 0, "
QUAD += f"0 0 0, {WIDE} {WIDE} 0, 0 {2 * WIDE} 0, {-WIDE} {WIDE} 0, 0 {WIDE} 0"
# per point; and per corner: each quarter shows another quarter, turned, so that points have several coordinates
FACES = {
    "point": ("0 1 2 3 -1", "", "0 0, 1 0, 1 1, 0 1, 0 0, 0 0, 0 0, 0 0, 0 0", "", ""),
    "beyond": ("0 1 2 3 -1", "", "-0.5 0, 1.5 0, 1.5 1, -0.5 1, 0 0, 0 0, 0 0, 0 0, 0 0", "", "repeatS='false'"),
    "repeat": ("0 1 2 3 -1", "", "-0.5 -1, 0.5 -1, 0.5 1, -0.5 1, 0 0, 0 0, 0 0, 0 0, 0 0", "", ""),
    "moved": ("0 1 2 3 -1", "", "0 0, 1 0, 1 1, 0 1, 0 0, 0 0, 0 0, 0 0, 0 0",
              "<TextureTransform translation='0.166667 0.333333' rotation='1.5707963' scale='1 -1' center='0.5 0.5'/>", ""),
    "corner": ("0 4 8 7 -1 4 1 5 8 -1 8 5 2 6 -1 7 8 6 3 -1", "0 1 4 3 -1 7 4 5 8 -1 4 1 2 5 -1 6 3 4 7 -1",
               "0 0, 0.5 0, 1 0, 0 0.5, 0.5 0.5, 1 0.5, 0 1, 0.5 1, 1 1", "", ""),
}  # fmt: skip


def scene(faces: str = "point", color: str = "1 1 1", data: bytes | None = None, double: bool = True) -> str:
    """X3D of a figure whose only surface is the card."""
    index, corners, uv, moved, wrap = FACES[faces]
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<X3D profile='Full' version='4.0'><head><component name='HAnim' level='3'/></head><Scene>
<Viewpoint position='0 {WIDE} 4' centerOfRotation='0 {WIDE} 0'/>
<HAnimHumanoid name='card' version='2.0'>
<HAnimJoint DEF='root' name='humanoid_root' containerField='skeleton' center='0 {WIDE} 0'>
<HAnimSegment name='sacrum' containerField='children'>
<Shape><Appearance><Material diffuseColor='{color}' specularColor='0 0 0' ambientIntensity='0'/>
<ImageTexture {wrap} url='"{uri(data or picture())}"'/>{moved}</Appearance>
<IndexedFaceSet solid='{str(not double).lower()}' coordIndex='{index}' texCoordIndex='{corners}'>
<Coordinate point='{QUAD}'/><TextureCoordinate point='{uv}'/></IndexedFaceSet></Shape>
</HAnimSegment></HAnimJoint><HAnimJoint USE='root' containerField='joints'/></HAnimHumanoid></Scene></X3D>"""


def levels(pixels: np.ndarray) -> np.ndarray:
    """(n,3) samples with the light taken out: each channel from its lowest to its highest."""
    pixels = pixels.astype(np.float64)
    low, high = np.percentile(pixels, 5, axis=0), np.percentile(pixels, 95, axis=0)
    return np.clip((pixels - low) / np.maximum(high - low, 1), 0, 1)


def sampled(image: bytes | np.ndarray, at: np.ndarray) -> np.ndarray:
    """(n,3) the mean of 5 x 5 pixels at each place (n,2)."""
    pixels = image if isinstance(image, np.ndarray) else np.asarray(Image.open(io.BytesIO(image)).convert("RGB"))
    around = np.arange(-2, 3)
    x, y = (np.round(at[:, i] - 0.5).astype(int)[:, None, None] for i in (0, 1))
    return pixels[y + around[:, None], x + around].mean(axis=(1, 2))[:, :3]


CAMERA = Camera((0.0, WIDE, 5.0), (0.0, WIDE, 0.0))


def photographed(thing: object, points: np.ndarray, size: int = 400, camera: Camera = CAMERA, **options) -> np.ndarray:
    """Colours at points of a thing in a headless picture."""
    surface = next(iter(Figure(thing).at([0.0])))  # type: ignore[arg-type]
    image = render([surface], camera, (size, size), **{"floor": None, "quality": 2, **options})
    return sampled(image, camera.project(points, (size, size))[0])


def in_page(browser, thing: object, points: np.ndarray, folder: Path) -> np.ndarray:
    """Colours at points of a thing in the page."""
    record(thing, folder / "card.html")
    with opened(browser, (folder / "card.html").as_uri(), (900, 900)) as page:
        wait(page, "vitruvian.pictures.wanted && vitruvian.pictures.ready == vitruvian.pictures.wanted")
        page.evaluate(
            "[...document.querySelectorAll('body *')].filter((e) => !e.querySelector('canvas') && e.tagName !== 'CANVAS')"
            ".forEach((e) => { e.style.visibility = 'hidden'; })"
        )
        page.wait_for_timeout(700)
        at = page.evaluate("(all) => all.map((p) => vitruvian.pixel(p))", points.tolist())
        return sampled(page.screenshot(), np.array(at))


def in_xite(xite, text: str, points: np.ndarray) -> np.ndarray:
    """Colours at points of an X3D scene in X_ITE."""
    xite.page.set_viewport_size({"width": 400, "height": 400})
    xite.page.evaluate("document.querySelector('x3d-canvas').style.cssText = 'width:400px;height:400px;display:block'")
    xite.load(text)
    xite.page.wait_for_timeout(600)
    camera = Camera((0.0, WIDE, 4.0), (0.0, WIDE, 0.0), fov=float(np.pi / 4))
    return sampled(xite.page.screenshot(), camera.project(points, (400, 400))[0])


THREE = """<!doctype html><html><body style="margin:0"><link rel="icon" href="data:,">
<script type="importmap">{"imports": {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}
</script><script type="module">
  import * as THREE from "three";
  import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
  const renderer = new THREE.WebGLRenderer(), scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(22, 1, 0.1, 20);
  renderer.setSize(400, 400);
  document.body.append(renderer.domElement);
  camera.position.set(0, HEIGHT, 5);
  scene.add(new THREE.HemisphereLight("#ffffff", "#ffffff", 3));
  const { scene: figure } = await new GLTFLoader().loadAsync("/card.glb");
  figure.traverse((o) => { o.frustumCulled = false; });
  scene.add(figure);
  renderer.render(scene, camera);
  window.done = true;
</script></body></html>""".replace("HEIGHT", str(WIDE))


def in_three(browser, referee: Path, glb: Path, points: np.ndarray) -> np.ndarray:
    """Colours at points of a GLB in three.js."""
    page = browser.new_page(viewport={"width": 400, "height": 400})

    def answer(route):
        name = route.request.url.removeprefix("http://three.test")
        if name == "/":
            route.fulfill(body=THREE, content_type="text/html")
        elif name == "/card.glb":
            route.fulfill(path=glb)
        else:
            route.fulfill(path=referee / "node_modules" / name.lstrip("/"))

    page.route("http://three.test/**", answer)
    try:
        page.goto("http://three.test/")
        page.wait_for_function("window.done")
        return sampled(page.screenshot(), CAMERA.project(points, (400, 400))[0])
    finally:
        page.close()
