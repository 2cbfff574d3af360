"""Events at run time: what a ROUTE or a Script may send to the objects of a humanoid.

`set_FIELD` of every field that is an inputOutput one, `addChildren` and `removeChildren` of Joint, Segment and Site.
Values are typed and in SI units as in the object tree. Source: ISO/IEC 19774-1, field access types.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vitruvian.errors import VitruvianError
from vitruvian.hanim.graph import Node
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, MotionData, Segment, Shape, Site, Viewpoint
from vitruvian.hanim.members import MEMBERS, Member, plain

Target = Humanoid | Joint | Segment | Site | Displacer | MotionData
# Fields beside the plain ones that take events, with their types.
_MORE: dict[str, tuple[Member, ...]] = {
    "Humanoid": (
        Member("version", "version", "SFString", ""),
        Member("loa", "loa", "SFInt32", -1),
        Member("skin_coord", "point", "MFVec3f", ()),
    ),
    "Joint": (
        Member("llimit", "llimit", "MFFloat", ()),
        Member("ulimit", "ulimit", "MFFloat", ()),
        Member("stiffness", "stiffness", "MFFloat", ()),
        Member("skin_coord_index", "skinCoordIndex", "MFInt32", ()),
        Member("skin_coord_weight", "skinCoordWeight", "MFFloat", ()),
    ),
    "Segment": (
        Member("moments_of_inertia", "momentsOfInertia", "MFFloat", ()),
        Member("coord", "point", "MFVec3f", ()),
    ),
    "Displacer": (
        Member("coord_index", "coordIndex", "MFInt32", ()),
        Member("displacements", "displacements", "MFVec3f", ()),
    ),
    "Motion": (
        Member("enabled", "enabled", "SFBool", True),
        Member("loop", "loop", "SFBool", False),
        Member("frame_duration", "frameDuration", "SFTime", 0.1),
        Member("end_frame", "endFrame", "SFInt32", 0),
    ),
}
_INITIAL = {"bboxCenter", "bboxSize"}  # initializeOnly
_CHILDREN: dict[type, dict[type, str]] = {
    Joint: {Joint: "joints", Segment: "segments", Site: "sites"},
    Segment: {Shape: "shapes", Site: "sites", Node: "children"},
    Site: {Shape: "shapes", Viewpoint: "viewpoints", Node: "children"},
}


def find(humanoid: Humanoid, name: str, field: str = "") -> Target:
    """The object that a track's target names: "" the humanoid; "weight" a Displacer, "point" a Segment, else by kind.

    Raises `VitruvianError` when there is none.
    """
    if not name:
        return humanoid
    kinds: list[Sequence[Target]] = [
        humanoid.joints(),
        [*humanoid.all_sites(), *humanoid.viewpoints],
        humanoid.segments(),
        humanoid.displacers(),
        humanoid.motions,
    ]
    if field == "weight":
        kinds.insert(0, humanoid.displacers())
    elif field == "point":
        kinds.insert(0, humanoid.segments())
    for things in kinds:
        for thing in things:
            if thing.name == name:
                return thing
    raise VitruvianError(f"humanoid {humanoid.name!r} has nothing named {name!r}")


def send(target: Target, event: str, value: object) -> None:
    """Deliver one event: `set_rotation` (or `rotation`), `set_weight`, ..., `addChildren`, `removeChildren`.

    Children are lists of typed objects (a Segment or Site also takes Shapes and graph nodes); what is there already is
    not added again, what is not there is not removed, as browsers do it.
    Raises `VitruvianError` naming object and field when it takes no such event or the value does not fit.
    """
    if event in {"addChildren", "removeChildren"}:
        _children(target, event, value)
        return
    kind = "Motion" if isinstance(target, MotionData) else type(target).__name__
    field = event.removeprefix("set_")
    for member in (*MEMBERS[kind], *_MORE.get(kind, ())):
        if member.field == field and field not in _INITIAL:
            setattr(target, member.attribute, _fitting(target, member, value))
            return
    raise VitruvianError(f"{kind} {target.name}: takes no event {event!r}")


def _fitting(target: Target, member: Member, value: object) -> object:
    """The value in the member's type."""
    where = f"{type(target).__name__} {target.name} {member.field}"
    try:
        if member.type == "SFBool":
            if not isinstance(value, bool | np.bool_):
                raise ValueError("a truth value")
            return bool(value)
        if member.type == "SFString":
            return str(value)
        if member.type == "MFBool":
            return [bool(v) for v in value]  # type: ignore[attr-defined]
        whole = member.type.endswith("Int32")
        array = np.array(plain(value), dtype=np.int32 if whole else np.float64)
        if not np.isfinite(array).all():
            raise ValueError("finite numbers")
        if member.type in {"SFInt32", "SFFloat", "SFTime"}:
            return int(array.reshape(())) if whole else float(array.reshape(()))
        width = {"SFVec3f": (3,), "SFRotation": (4,), "MFVec3f": (-1, 3)}.get(member.type, (-1,))
        return array.reshape(width)
    except (TypeError, ValueError) as error:
        raise VitruvianError(f"{where}: expected {member.type}, found {value!r:.60} ({error})") from None


def _children(target: Target, event: str, value: object) -> None:
    where = f"{type(target).__name__} {target.name}"
    places = _CHILDREN.get(type(target))
    if places is None:
        raise VitruvianError(f"{where}: takes no event {event!r}")
    things = list(value) if isinstance(value, list | tuple) else [value]
    for thing in things:
        attribute = places.get(type(thing))
        if attribute is None:
            known = ", ".join(t.__name__ for t in places)
            raise VitruvianError(f"{where} {event}: expected {known}, found a {type(thing).__name__}")
        if event == "addChildren" and isinstance(thing, Joint) and any(j is target for j in thing.walk()):
            raise VitruvianError(f"{where} {event}: joint {thing.name} is above it")
    for thing in things:
        held = getattr(target, places[type(thing)])
        rest = [t for t in held if t is not thing]
        setattr(
            target,
            places[type(thing)],
            [*held, thing]
            if event == "addChildren" and len(rest) == len(held)
            else held
            if event == "addChildren"
            else rest,
        )
