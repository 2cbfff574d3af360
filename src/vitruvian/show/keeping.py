"""What pages may save: feature points of a scan and weights of a body, in the files that were named when the page opened.

A page never names a file: it sends content, and what is done with it was decided here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from vitruvian.errors import VitruvianError
from vitruvian.hanim import tables

MAX_TEXT = 64 << 20  # characters of weights that a page may send

# What a fit stands on: spread over the body and easy to find on a scan.
NEEDED = tuple(
    "skull_vertex sellion cervicale suprasternale l_acromion r_acromion l_humeral_lateral_epicondyle "
    "r_humeral_lateral_epicondyle l_ulnar_styloid r_ulnar_styloid l_dactylion r_dactylion navel l_asis r_asis "
    "l_trochanterion r_trochanterion crotch l_femoral_lateral_epicondyle r_femoral_lateral_epicondyle "
    "l_lateral_malleolus r_lateral_malleolus l_calcaneus_posterior r_calcaneus_posterior".split()
)


@cache
def features() -> list[dict[str, Any]]:
    """The feature points of H-Anim 2.0 as the page lists them: what a fit needs, then the others."""
    known = tables.feature_points()
    order = [*NEEDED, *(n for n in known if n not in NEEDED)]
    return [{"name": n, "segment": known[n].segment, "needed": n in NEEDED} for n in order]


@dataclass
class Keeping:
    """Files behind a page, by the words that people know them by ("" for none), and what writes them.

    points: feature point -> [x, y, z] in the scan's own unit and axes, given at the start.
    save_points(points) and save_weights(actor name, CSV text) raise VitruvianError.
    """

    points: Mapping[str, Sequence[float]] = field(default_factory=dict)
    landmarks: str = ""
    weights: str = ""
    save_points: Callable[[dict[str, list[float]]], None] | None = None
    save_weights: Callable[[str, str], None] | None = None
    _text: dict[str, list[str]] = field(default_factory=dict)

    def told(self) -> dict[str, Any]:
        """What pages hear of it."""
        points = {n: [float(x) for x in p] for n, p in self.points.items()}
        return {"points": points, "landmarks": self.landmarks, "weights": self.weights}

    def apply(self, request: Mapping[str, Any]) -> None:
        """Do what `set_landmarks` or a piece of `set_weights` asks for."""
        if request["type"] == "set_landmarks":
            if self.save_points is None:
                raise VitruvianError("request set_landmarks: no file to save them in; start with --landmarks FILE")
            self.points = dict(request["points"])
            self.save_points(dict(request["points"]))
            return
        if self.save_weights is None:
            raise VitruvianError("request set_weights: no file to save them in; start with --weights FILE")
        pieces = self._text.setdefault(request["actor"], [])
        pieces.append(request["text"])
        if sum(map(len, pieces)) > MAX_TEXT:
            del self._text[request["actor"]]
            raise VitruvianError(f"request set_weights: expected at most {MAX_TEXT >> 20} MB")
        if request["last"]:
            self.save_weights(request["actor"], "".join(self._text.pop(request["actor"])))
