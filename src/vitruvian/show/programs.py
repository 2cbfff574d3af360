"""What the page needs to run the "contours" and "hand" deformers by itself: their programs, as blocks of a message.

Numbers of joints are sent one higher, so that 0 can mean none.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Body
from vitruvian.deform.contours import ContourOperator, Program
from vitruvian.deform.hand_links import hands_of
from vitruvian.deform.hands import HandProgram, hand_program
from vitruvian.show.wire import Block

_CONTOUR = (
    "link axis bone base row step swing twist middle along frame diversion mitre mitre_link mitre_share bulge bulge_link"
).split()
_NEXT = ("base",)  # fields in which -1 means none


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
    """Both hands as one: links of the second follow those of the first."""
    programs = [hand_program(hand, body.skin) for hand in hands_of(body)]
    if not programs:
        return {}
    starts = np.cumsum([0, *(len(p.hand.near) for p in programs)])

    def joined(name: str) -> NDArray:
        return np.concatenate([getattr(p, name) for p in programs])

    def linked(name: str) -> NDArray:
        return np.concatenate([getattr(p, name) + n for p, n in zip(programs, starts)])

    def of_hand(name: str) -> NDArray:
        return np.concatenate([getattr(p.hand, name) for p in programs])

    names = [f.name for f in fields(HandProgram)]
    wanted = ("normal_near", "normal_far", *names[names.index("vertex") :])
    out = {name: linked(name) if name in ("link", "links") else joined(name) for name in wanted}
    out |= {name: of_hand(name) for name in ("start", "end", "axis_near", "axis_far", "vertices")}
    out |= {name: of_hand(name) + 1 for name in ("before", "near", "far")}
    return {f"hand_{name}": a for name, a in out.items()} | {"hand_left": 1 - of_hand("share")}
