"""Files that the page reads and saves: feature points of a scan (`--landmarks`), weights of a body (`--weights`)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vitruvian.errors import VitruvianError

if TYPE_CHECKING:
    from vitruvian.show.keeping import Keeping


def keeping(things: list[Any], landmarks: Path | None, weights: Path | None) -> tuple[list[Any], Keeping]:
    """The things with what is in these files already, and what writes them."""
    from vitruvian.show.keeping import Keeping
    from vitruvian.stage.clip import Clip, Mesh

    kept = Keeping()
    if landmarks is not None:
        if not any(isinstance(t, Mesh) for t in things):
            raise VitruvianError("--landmarks: expected a scan (a mesh without joints) among the files, found none")
        from vitruvian.modeling.landmarks import read, save

        kept.points = {n: p.tolist() for n, p in read(landmarks).items()} if landmarks.exists() else {}
        kept.landmarks, kept.save_points = landmarks.name, lambda points: save(points, landmarks)
    if weights is not None:
        from vitruvian.modeling.weight_files import read_weights, rows_of, save_weights
        from vitruvian.modeling.weights import reweighted

        first = next((i for i, t in enumerate(things) if isinstance(t, Clip)), None)
        if first is None:
            raise VitruvianError("--weights: expected a body among the files, found none")
        if weights.suffix.lower() not in (".csv", ".npz"):
            raise VitruvianError(f"--weights {weights}: expected .csv or .npz")
        if weights.exists():
            body = things[first].body
            things[first] = replace(things[first], body=reweighted(body, read_weights(weights, body)))
        body = things[first].body
        kept.weights = weights.name
        kept.save_weights = lambda _, text: save_weights(reweighted(body, rows_of(text.splitlines(), body)), weights)
    return things, kept


def with_weights(humanoid: Any, path: Path) -> None:
    """Put the weights in a CSV or npz file, as pages save them, into a body."""
    from vitruvian.body.pack import pack
    from vitruvian.hanim.humanoid import Humanoid
    from vitruvian.modeling.weight_files import read_weights, stored

    if not isinstance(humanoid, Humanoid):
        raise VitruvianError(f"--weights: expected an H-Anim body, found a {type(humanoid).__name__.lower()}")
    stored(humanoid, read_weights(path, pack(humanoid)))
