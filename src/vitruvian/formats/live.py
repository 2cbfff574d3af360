"""A contour body that deforms by itself: a Script in the file, run by any X3D or VRML97 browser, no server.

Rotations are routed to the Script instead of to the joints; it sends the new points of every surface, then releases the
rotations, so that no picture shows one without the other. Source: cross-section deformation of H-Anim bodies, Script node
and interception of events; plain ECMAScript, ROUTEs instead of directOutput.
"""

from __future__ import annotations

from importlib.resources import files

import numpy as np

from vitruvian.body.types import Body
from vitruvian.deform.contours import Program, program
from vitruvian.errors import VitruvianError
from vitruvian.hanim.graph import Node, ProtoField, Route, Scene
from vitruvian.hanim.humanoid import Humanoid

SCRIPT = "hanim_ContourScript"


def add_script(scene: Scene, humanoid: Humanoid, body: Body) -> dict[str, int]:
    """Append the Script and its ROUTEs to a scene that `scene_of` made of `humanoid`; routes to joints go through it.

    Returns {"script_bytes", "points", "joints"}. Raises VitruvianError when the body has no contours, or when the scene
    has no node for a surface or a joint.
    """
    if not body.contours:
        raise VitruvianError("live: expected a body with contours, found none; make one by `contours`")
    p = program(body, body.contours)
    skeleton = body.skeleton
    defs = scene.defs()
    joints = {_text(n.fields.get("name")): n for n in scene.walk() if n.type in ("HAnimJoint", "Joint")}
    surfaces = {_text(n.fields.get("name")): n for n in scene.walk() if n.type in ("DefBody", "DefBodyTex")}
    needed = _needed(body, p)
    for name in (skeleton.names[j] for j in needed):
        if name not in joints:
            raise VitruvianError(f"live: expected a node of joint {name} in the scene, found none")
    for surface in body.contours:
        if surface.name not in surfaces:
            raise VitruvianError(f"live: expected a DefBody node {surface.name} in the scene, found none")
    place = {j: i for i, j in enumerate(needed)}
    renumber = np.array([place.get(j, -1) for j in range(len(skeleton))] + [-1], np.int32)
    script = Node("Script", SCRIPT)
    names = [skeleton.names[j] for j in needed]
    for name in names:
        script.interface.append(ProtoField("inputOnly", "SFRotation", f"hanim_{name}Def"))
    script.interface.append(ProtoField("inputOnly", "SFBool", "set_extremities"))
    for name in names:
        script.interface.append(ProtoField("outputOnly", "SFRotation", f"hanim_{name}_rotation"))
    for surface in body.contours:
        script.interface.append(ProtoField("outputOnly", "MFVec3f", f"{surface.name}_points"))
    first = np.concatenate([[0], np.cumsum([len(s) for s in body.contours])])
    rest = np.concatenate([body.skin.rest[s.vertices].reshape(-1) for s in body.contours])
    values: list[tuple[str, str, np.ndarray]] = [
        ("MFInt32", "parent", renumber[skeleton.parents[needed]]),
        ("MFFloat", "center", skeleton.centers[needed].ravel()),
        ("MFInt32", "link", renumber[p.link].ravel()),
        ("MFFloat", "axis", p.axis.ravel()),
        ("MFFloat", "bone", p.bone.ravel()),
        ("MFInt32", "base", renumber[p.base]),
        ("MFInt32", "row", p.row),
        ("MFInt32", "step", p.step),
        ("MFFloat", "swing", p.swing),
        ("MFFloat", "twist", np.where(np.isnan(p.twist), -1.0, p.twist)),
        ("MFFloat", "middle", p.middle.ravel()),
        ("MFFloat", "along", p.along.ravel()),
        ("MFInt32", "frame", renumber[p.frame]),
        ("MFFloat", "diversion", p.diversion),
        ("MFFloat", "mitre", p.mitre),
        ("MFInt32", "mitreLink", p.mitre_link),
        ("MFFloat", "mitreShare", p.mitre_share),
        ("MFFloat", "bulge", p.bulge),
        ("MFInt32", "bulgeLink", p.bulge_link),
        ("MFInt32", "first", first),
        ("MFInt32", "each", np.array([s.vertices.shape[1] for s in body.contours])),
        ("MFInt32", "switched", np.array([int(s.name.startswith("c")) for s in body.contours])),
        ("MFFloat", "points", rest),
    ]
    for kind, name, value in values:
        typed = np.asarray(value, np.int32 if kind == "MFInt32" else np.float64)
        script.interface.append(ProtoField("initializeOnly", kind, name, typed))
    code = _code(names, [s.name for s in body.contours])
    if scene.encoding in ("x3d", "x3dj"):
        script.text = "ecmascript:\n" + code
    else:
        script.fields["url"] = ["javascript:\n" + code if scene.encoding == "wrl" else "ecmascript:\n" + code]
    _reroute(scene, {joints[n].name: n for n in names if joints[n].name in defs})
    scene.body.append(script)
    for name in names:
        scene.body.append(Route(SCRIPT, f"hanim_{name}_rotation", joints[name].name, "set_rotation"))
    for surface in body.contours:
        scene.body.append(Route(SCRIPT, f"{surface.name}_points", surfaces[surface.name].name, "set_Points"))
    # Routes are read in the order of the file: those from the script come after its node.
    scene.body.sort(key=lambda statement: isinstance(statement, Route))
    return {"script_bytes": len(code), "points": len(rest) // 3, "joints": len(names)}


def _needed(body: Body, p: Program) -> list[int]:
    """Joints whose rotations the script must know: those of the contours, and all above them."""
    wanted = {int(j) for j in [*p.link.ravel(), *p.base, *p.frame] if j >= 0}
    for j in list(wanted):
        while j >= 0:
            wanted.add(j)
            j = int(body.skeleton.parents[j])
    return sorted(wanted)


def _code(joints: list[str], surfaces: list[str]) -> str:
    template = (files("vitruvian.formats") / "live.js").read_text("utf-8")
    events = [f"function hanim_{name}Def(value) {{ turn({i}, value); }}" for i, name in enumerate(joints)]
    publish = [f"  {name}_points = surface({i}, M);" for i, name in enumerate(surfaces)]
    release = [
        f"  if (fresh[{i}]) {{ hanim_{name}_rotation = fresh[{i}]; fresh[{i}] = null; }}"
        for i, name in enumerate(joints)
    ]
    return "\n".join([
        template, *events, "function publish(M) {", *publish, "}", "function release() {", *release, "}", "",
    ])  # fmt: skip


def _reroute(scene: Scene, joints: dict[str, str]) -> None:
    """Routes that turn a joint go to the script."""
    for statement in scene.body:
        turns = isinstance(statement, Route) and statement.to_field in ("rotation", "set_rotation")
        if turns and isinstance(statement, Route) and statement.to_node in joints:
            statement.to_field = f"hanim_{joints[statement.to_node]}Def"
            statement.to_node = SCRIPT


def _text(value: object) -> str:
    return value if isinstance(value, str) else ""
