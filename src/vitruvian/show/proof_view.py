"""Proofs of worn cloth as a picture: in layers, wholly simulated, and how far one is from the other, side by side."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Ints
from vitruvian.cloth.proof import Proof
from vitruvian.errors import VitruvianError
from vitruvian.show.fit_view import KINDS, SKIN
from vitruvian.show.heat import drawn, ramp
from vitruvian.show.surfaces import Surface
from vitruvian.stage.clip import Mesh

if TYPE_CHECKING:
    from vitruvian.show.render import Pixels

REACH = 0.05  # metres at the end of the colours
COLUMNS = 4  # frames that are shown
_INK, _PAPER = (38, 40, 44), (250, 249, 247)


def sheet(
    proof: Proof, skins: Sequence[NDArray[np.floating]], skin_triangles: Ints, cloth_triangles: Ints,
    path: str | os.PathLike[str], *, height: int = 380,
) -> Pixels:  # fmt: skip
    """Write a picture: frames of a clip from left to right; above in layers, coloured by them, below that wholly simulated,
    and at the bottom in layers again, coloured by how far each vertex is from the other's surface. skins: (V,3) of each
    frame of the proof. Returns its pixels (H,W,3). Raises VitruvianError for another ending than .png."""
    from PIL import Image, ImageDraw, ImageFont

    from vitruvian.formats.atomic import atomic
    from vitruvian.show.figure import Figure
    from vitruvian.show.picture import aim

    if Path(path).suffix.lower() != ".png":
        raise VitruvianError(f"{path}: expected a name that ends in .png")
    size = (round(0.62 * height), height)
    frames = np.unique(np.linspace(0, len(skins) - 1, COLUMNS).astype(int))
    warm = np.asarray(ramp()[len(ramp()) // 2 :])
    kinds = np.array(KINDS)[proof.layer]
    columns = []
    for k in frames:
        skin = np.asarray(skins[k], np.float64)
        off = np.clip(proof.off[k] / REACH, 0, 1) * (len(warm) - 1)
        far = np.stack([np.interp(off, np.arange(len(warm)), warm[:, i]) for i in range(3)], axis=1)
        cells, plain = [], np.full((len(proof.layer), 3), 0.72)
        for x, paint in ((proof.layered[k], kinds), (proof.full[k], plain), (proof.layered[k], far)):
            points = np.concatenate([skin, x.astype(np.float64)])
            triangles = np.concatenate([skin_triangles, cloth_triangles + len(skin)]).astype(np.int32)
            figure = Figure(Mesh(points, triangles, name="worn"))
            surface: Surface = next(iter(figure.at([0.0])))
            colors = np.concatenate([np.full((len(skin), 3), SKIN), paint])
            cells.append(drawn(surface, colors, aim(figure, surface, "three-quarter", 0.0, size)[0], size))
        columns.append(np.concatenate(cells, axis=0))
    pixels = np.concatenate(columns, axis=1)
    s = proof.summary()
    lines = [
        "above: tight blue, loose green, floating red; middle: wholly simulated; below: distance to that, 0 to "
        f"{1000 * REACH:.0f} mm",
        f"{s['from_full_surface_mm']} mm from its surface on average; {s['inside']} points over 1 mm in the skin in "
        f"{s['frames_with_any_inside']} of {s['frames']} frames; cost {proof.seconds[0] / proof.seconds[1]:.0%}",
    ]
    words = Image.new("RGB", (pixels.shape[1], 16 + 21 * len(lines)), _PAPER)
    draw, font = ImageDraw.Draw(words), ImageFont.load_default(13)
    for n, line in enumerate(lines):
        draw.text((16, 4 + 21 * n), line, _INK, font=font)
    pixels = np.concatenate([pixels, np.asarray(words)], axis=0)
    with atomic(path) as part:
        Image.fromarray(pixels).save(part, format="PNG", compress_level=6)
    return pixels
