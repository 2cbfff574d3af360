"""What the page needs to run the "contours" and "hand" deformers by itself: their programs, as blocks of a message.

Numbers of joints are sent one higher, so that 0 can mean none.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Body
from vitruvian.deform.contours import ContourOperator
from vitruvian.deform.hand_links import hands_of
from vitruvian.deform.hand_terms import HandProgram, hand_program
from vitruvian.show.wire import Block

_CONTOUR = (
    "link axis bone base row step swing twist middle along frame diversion mitre mitre_link mitre_share bulge bulge_link"
).split()
_OF_HAND = ("start", "end", "axis_near", "axis_far", "vertices")
_OF_PROGRAM = ("normal_near", "normal_far", "vertex", "gap_vertex")
_ROUNDING = ("joint", "near", "far", "muscle", "belly", "arc")
_NEXT = ("base",)  # fields in which -1 means none


def program_blocks(body: Body, actor: str) -> list[Block]:
    """Blocks named `contour_...` and `hand_...` of those that the body has; see contours.js and hands.js."""
    arrays = _contours(body) | _hands(body)
    return [Block(name, _sent(a), actor) for name, a in arrays.items()]


def _sent(array: NDArray) -> NDArray:
    return np.asarray(array, np.float32 if array.dtype.kind == "f" else np.uint32)


def _contours(body: Body) -> dict[str, NDArray]:
    if not body.contours:
        return {}
    operator = ContourOperator(body)
    out = {name: getattr(operator.program, name) + (name in _NEXT) for name in _CONTOUR}
    out["link"] = out["link"] + np.array([1, 0])  # the first of a pair may be none
    return {f"contour_{name}": a for name, a in out.items()} | {"contour_owner": operator.owner + 1}


def _hands(body: Body) -> dict[str, NDArray]:
    """Both hands as one: links of the second follow those of the first. What terms take of the rest points is worked out
    in the page."""
    programs = [hand_program(hand, body.skin) for hand in hands_of(body)]
    if not programs:
        return {}
    starts = np.cumsum([0, *(len(p.hand.near) for p in programs)])[:-1]

    def joined(of: Callable[[HandProgram], NDArray]) -> NDArray:
        return np.concatenate([of(p) for p in programs])

    def linked(of: Callable[[HandProgram], NDArray]) -> NDArray:
        return np.concatenate([np.where(of(p) >= 0, of(p) + n, -1) for p, n in zip(programs, starts, strict=True)])

    def roundings(p: HandProgram) -> NDArray:
        return np.array([[getattr(r, name) for name in _ROUNDING] for r in p.hand.roundings], np.float64)

    out = {name: joined(lambda p, n=name: getattr(p.hand, n) + 1) for name in ("before", "near", "far")}
    out |= {name: joined(lambda p, n=name: getattr(p.hand, n)) for name in _OF_HAND}
    out |= {name: joined(lambda p, n=name: getattr(p, n)) for name in _OF_PROGRAM}
    out |= {name: joined(lambda p, n=name: getattr(p.assignment, n)) for name in ("share", "gap_share")}
    out |= {name: linked(lambda p, n=name: getattr(p.assignment, n)) for name in ("link", "links")}
    out |= {"previous": linked(lambda p: p.previous) + 1, "rounding": joined(roundings)}
    return {f"hand_{name}": a for name, a in out.items()} | {"hand_left": joined(lambda p: 1 - p.whole)}
