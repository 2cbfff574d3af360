"""What the page needs to run the "contours" and "hand" deformers by itself: their programs, as blocks of a message.

Numbers of joints are sent one higher, so that 0 can mean none.
"""

from __future__ import annotations

from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.hands import RANGES
from vitruvian.body.types import Body
from vitruvian.deform.contour_steps import Program
from vitruvian.deform.contours import ContourOperator
from vitruvian.deform.hand_links import hands_of
from vitruvian.deform.hand_terms import hand_program
from vitruvian.show.wire import Block

_CONTOUR = (
    "link axis bone base row step swing twist middle along frame diversion mitre mitre_link mitre_share bulge bulge_link "
    "recentre limb way aside seam"
).split()
_HAND = (
    "hand.start hand.end hand.axis_near hand.axis_far hand.vertices normal_near normal_far vertex gap_vertex "
    "assignment.share assignment.gap_share"
).split()
_NEXT = ("base", "limb")  # fields in which -1 means none


def program_blocks(body: Body, actor: str) -> list[Block]:
    """Blocks named `contour_...`, `seen_...` and `hand_...` of those that the body has; see contours.js and hands.js."""
    arrays = _contours(body) | _hands(body)
    return [Block(name, _sent(a), actor) for name, a in arrays.items()]


def _sent(array: NDArray) -> NDArray:
    return np.asarray(array, np.float32 if array.dtype.kind == "f" else np.uint32)


def _contours(body: Body) -> dict[str, NDArray]:
    """The program of all contours as `contour_...`, and that of the joints `seen_joint`, as `seen_...`: how vertices
    outside the contours see them turned."""
    if not body.contours:
        return {}
    operator = ContourOperator(body)
    out = _laid("contour", operator.program) | {"contour_owner": operator.owner + 1}
    if operator.seen is not None:
        joints, turns = operator.seen
        out |= _laid("seen", turns) | {"seen_joint": joints}
    return out


def _laid(title: str, program: Program) -> dict[str, NDArray]:
    out = {name: getattr(program, name) + (name in _NEXT) for name in _CONTOUR}
    out["link"] = out["link"] + np.array([1, 0])  # the first of a pair may be none
    return {f"{title}_{name}": a for name, a in out.items()}


def _hands(body: Body) -> dict[str, NDArray]:
    """Both hands as one: links of the second follow those of the first. What terms take of the rest points is worked out
    in the page."""
    programs = [hand_program(hand, body.skin) for hand in hands_of(body)]
    if not programs:
        return {}
    starts = np.cumsum([0, *(len(p.hand.near) for p in programs)])[:-1]

    def joined(path: str) -> NDArray:
        return np.concatenate([attrgetter(path)(p) for p in programs])

    def linked(path: str) -> NDArray:
        arrays = [attrgetter(path)(p) for p in programs]
        return np.concatenate([np.where(a >= 0, a + n, -1) for a, n in zip(arrays, starts, strict=True)])

    out = {name: joined(f"hand.{name}") + 1 for name in ("before", "near", "far")}
    out |= {path.rpartition(".")[2]: joined(path) for path in _HAND}
    out |= {path.rpartition(".")[2]: linked(path) for path in ("assignment.link", "assignment.links")}
    roundings = [[getattr(r, name) for name in RANGES] for p in programs for r in p.hand.roundings]
    out |= {
        "previous": linked("previous") + 1,
        "rounding": np.array(roundings, np.float64),
        "palm": np.concatenate([(p.hand.beside >= 0).any(axis=1) for p in programs]),
        "left": 1 - joined("whole"),
    }
    return {f"hand_{name}": a for name, a in out.items()}
