"""What a body wears in the commands that move it: `--garment`, `--fabric`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vitruvian.cli.output import count, progress
from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.cloth.garment import Garment
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.stage.clip import Clip

Garments = typer.Option(
    [],
    "--garment",
    metavar="GARMENT",
    help="Wear this: a draft (tshirt, shirt, skirt, ...; see pattern list), a pattern's file, or what dress kept as "
    ".garment.npz. Once for each, innermost first.",
)
Proof = typer.Option(
    None,
    "--proof",
    metavar="FILE",
    help="Also simulate the outermost garment wholly, and show how far from that it is "
    "in real time: .png or .json (figures).",
)
Fabrics = typer.Option(["cotton"], "--fabric", help="Of the garments, as in dress; once for each garment.")


def dressed_in(names: Sequence[str], fabrics: Sequence[str], humanoid: Humanoid) -> Garment | None:
    """Garments sewn and draped on a body, each over the ones before it; None for no names."""
    if not names:
        return None
    from vitruvian.body.pack import pack
    from vitruvian.cli.dressing import _lowered, _sewable, _told, placed_on
    from vitruvian.cloth.tailor import tailor
    from vitruvian.formats.fabrics import fabric_from

    kept = [n for n in names if n.lower().endswith(".garment.npz")]
    if kept:
        if len(names) > 1:
            raise VitruvianError(f"{kept[0]}: is worn alone; give patterns to wear several garments")
        return _kept(Path(kept[0]), humanoid)
    body, cloths = pack(humanoid), [fabric_from(f) for f in fabrics or ["cotton"]]
    patterns = [_sewable(Path(n), humanoid, None) for n in names]
    arms = _lowered(patterns)
    over: list[Garment] = []
    with progress("dressing") as bar:
        for k, pattern in enumerate(patterns):
            made = tailor(
                placed_on(pattern, humanoid, arms=arms), body, fabric=cloths[min(k, len(cloths) - 1)], size=SIZE,
                arms=arms, over=over, progress=partial(_told, bar, k, len(patterns)),
            )  # fmt: skip
            over = [*made.below, made]
    return over[-1]


SIZE = 0.010  # metres between the points of cloth


def _kept(path: Path, humanoid: Humanoid) -> Garment:
    """A garment that was kept, on the body that it was sewn on, in that or another shape."""
    import numpy as np

    from vitruvian.body.pack import pack
    from vitruvian.cli.refitting import _followed
    from vitruvian.cloth.resizing import standing
    from vitruvian.formats.garment_file import read_garment

    before = read_garment(path)
    body = pack(humanoid)
    same = before.garment.matrices.shape == (len(body.skeleton), 4, 4)
    there = standing(before.garment, body).vertices if same else None
    if there is not None and there.shape == before.skin.shape and np.abs(there - before.skin).max() < 1e-6:
        return before.garment
    return _followed(before, humanoid, "keep_pattern")


def fit_of(garment: Garment | None) -> tuple[list[str], bool]:
    """What does not fit of a garment and those below it, in a line each, and whether all of their seams close."""
    from vitruvian.cli.dressing import APART, faults

    worn = [] if garment is None else [*garment.below, garment]
    reasons = [f"{g.name}: {line}" for g in worn for line in faults({**g.report, "settled": True, "speed": 0.0})]
    return reasons, all(g.report["seam_gap_max_mm"] <= APART for g in worn)


def clothes_of(clip: Clip, out: Path, *, bake: bool = False) -> Clip:
    """A clip with what its garment does in each frame, as a file at `out` takes it."""
    from vitruvian.formats.registry import clothed, shown_by
    from vitruvian.stage.baking import bake as moved

    if clip.garment is None:
        return clip
    if not clothed(out) and out.suffix.lower() not in SHOWN:
        kinds = ".glb .x3d .x3dv .x3dj .wrl .usdz .usdc .usda .objs .cache.npz .html .mp4 .png"
        raise VitruvianError(f"--garment: expected a file that clothes move in ({kinds}), found {out}")
    with progress("moving the clothes") as bar:
        return replace(clip, caches=moved(clip, deformer=shown_by(out, clip.deformer, bake=bake), progress=bar))


def proof(clip: Clip, out: Path) -> dict[str, Any]:
    """Write how near the outermost garment of a clip, worn in layers, comes to itself wholly simulated; the figures."""
    import json

    from vitruvian.body.kinematics import joint_matrices
    from vitruvian.cloth.proof import proven
    from vitruvian.cloth.wear import wear, wearer
    from vitruvian.deform.deformer import deformer
    from vitruvian.formats.atomic import atomic

    assert clip.garment is not None and clip.motion is not None
    person = wearer(deformer(clip.deformer, clip.body))
    every = max(1, round(clip.motion.fps / 60))
    matrices = joint_matrices(clip.body.skeleton, clip.motion)[::every]
    worn = wear(clip.garment, person)[-1]
    with progress("proving the clothes") as bar:
        found = proven(
            worn, person, matrices, dt=every / clip.motion.fps, progress=lambda share: bar(round(1000 * share), 1000)
        )
    figures = dict(found.summary())
    if out.suffix.lower() == ".json":
        with atomic(out) as part:
            part.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    else:
        from vitruvian.show.proof_view import sheet

        skins = [person.at(m)[0].points for m in matrices]
        sheet(found, skins, person.skin.triangles, worn.garment.triangles, out)
    return figures


def provable(garments: Sequence[str], out: Path | None) -> None:
    """VitruvianError, before any work, for a proof that cannot be."""
    if out is not None and out.suffix.lower() not in (".png", ".json"):
        raise VitruvianError(f"--proof {out}: expected .png or .json")
    if out is not None and not garments:
        raise VitruvianError("--proof: expected something to wear, --garment tshirt")


SHOWN = (".html", ".png", ".mp4", ".gif", ".webp")  # what we draw ourselves


def told(report: dict[str, Any]) -> list[str]:
    """What was written of clothes, a line each."""
    out = []
    for cloth in report.get("cloth", ()):
        few = count(cloth["shapes"], "shape") if "shapes" in cloth else count(cloth["keys"], "key")
        text = (
            f"{cloth['name']}: {cloth['points']:,} points, {few} for {count(cloth['frames'], 'frame')}, at most "
            f"{cloth['max_error_m'] * 1000:.2f} mm off"
        )
        if cloth["closing_m"]:
            text += f"; {cloth['closing_m'] * 1000:.0f} mm were made up for at the end of the loop"
        out.append(text)
    return out
