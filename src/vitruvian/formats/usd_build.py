"""The arrays of a USD file as a Humanoid: metres, Y up, H-Anim names. See `usd_reader` for the bridge."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.pack import pack
from vitruvian.body.rotations import from_matrix, to_axis_angle, to_matrix
from vitruvian.body.types import Floats
from vitruvian.errors import FileError, warn
from vitruvian.formats.usd_shapes import SNAP, axis_angle, shapes_of, split, upright
from vitruvian.hanim import tables
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Segment, Shape, Site, Track
from vitruvian.motion.names import NECK, SPINE, VERTEBRAE, match
from vitruvian.motion.tracks import tracks_of
from vitruvian.motion.types import Motion

_COARSE = 2e-3  # of a scale: SkelAnimation holds half floats
_TRUNK = {1: ("vl5",), 2: ("vl5", "vt10"), 3: ("vl5", "vt10", "vt6")}
_NECK = {1: ("vc4",), 2: ("vc4", "vc2")}


def humanoid_of(path: object, figure: dict[str, Any], document: dict[str, Any]) -> Humanoid:
    """One skeleton with its skin, Sites and animation."""
    about = figure["about"]
    space, placement = _space(figure, document)
    rig = Rig(path, figure, space)
    name = about.get("name") or figure["name"]
    h = Humanoid(name=str(name), version=str(about.get("version", "2.0")), skeleton=rig.roots)
    known = [tables.canonical(j.name) for j in rig.joints]
    h.loa = int(about["loa"]) if "loa" in about else tables.complete_loa(n for n in known if n)
    h.skeletal_configuration = str(about.get("skeletalConfiguration", "BASIC"))
    for entry in about.get("info", []):
        key, _, value = str(entry).partition("=")
        h.info[key] = value
    h.translation, h.rotation, h.scale, h.scale_orientation = _fields(placement)
    _skin(h, rig, figure["meshes"], space)
    views: list[tuple[int, Site]] = []
    for site in figure["sites"]:
        _site(h, rig, site, space, views)
    h.viewpoints = [site for _, site in sorted(views, key=lambda pair: pair[0])]
    animation = figure["animation"]
    if animation is not None:
        _animate(path, h, rig, animation, about)
    return h


def _space(figure: dict[str, Any], document: dict[str, Any]) -> tuple[Floats, Floats]:
    """From the skeleton's space to humanoid space (4,4), and the Humanoid's own transform.

    Files that we wrote keep theirs. For others, where the skeleton stands in the scene goes into the figure itself when
    it is a turn, a shift and one scale, so that the figure is in metres and upright.
    """
    there = upright(document)
    world = figure["world"]
    if not np.isfinite(world).all() or abs(np.linalg.det(world[:3, :3])) < 1e-12:
        world = np.eye(4)
    whole = there @ world
    scale = np.cbrt(np.linalg.det(whole[:3, :3]))
    turn = whole[:3, :3] / scale
    if not figure["about"] and scale > 0 and np.allclose(turn.T @ turn, np.eye(3), rtol=0, atol=1e-5):
        return whole, np.eye(4)
    return there, there @ world @ np.linalg.inv(there)


def _fields(matrix: Floats, frame: Floats | None = None) -> tuple[Floats, Floats, Floats, Floats]:
    """translation, rotation, scale and scaleOrientation of a matrix, turns as axis and angle.

    Of the frames (3,3) in which it may be scaled, that of humanoid space is preferred, then `frame`.
    """
    rotation, stretch = split(matrix[:3, :3])
    for turn in (np.eye(3), np.eye(3) if frame is None else split(frame)[0]):
        own = turn.T @ stretch @ turn
        size = np.diag(own).copy()
        if np.abs(own - np.diag(size)).max() <= SNAP * np.abs(size).max():
            break
    else:
        size, turn = np.linalg.eigh(stretch)
        turn = turn * (1 if np.linalg.det(turn) > 0 else -1)
    size = np.where(np.abs(size - 1) < SNAP, 1.0, size)
    shift = np.where(np.abs(matrix[:3, 3]) < 1e-12, 0.0, matrix[:3, 3])
    return shift, axis_angle(rotation), size, axis_angle(turn)


class Rig:
    """The joints of a figure, in USD's order.

    `joints` and `roots`; `place` (n,) the joint of a USD joint, -1 for the one that never moves; `keys` USD's name ->
    joint; `bind` and `above` (J,4,4) bind transforms of a joint and of its parent in the skeleton's space, from which
    `space` leads to the humanoid's; `stretch` (J,3,3) at rest; `tokens_of` displacer -> BlendShape.
    """

    def __init__(self, path: object, figure: dict[str, Any], space: Floats):
        tokens, about = figure["joints"], figure["joints_about"]
        parents = np.array(figure["parents"])
        still = about.get("static")
        leaves = figure["names"] or [t.rpartition("/")[2] for t in tokens]
        kept = [k for k in range(len(tokens)) if leaves[k] != still]
        self.place = np.full(len(tokens), -1, np.int64)
        self.place[kept] = np.arange(len(kept))
        self.space = space
        self.tokens_of: dict[str, str] = {}
        self.keys = {leaves[k]: n for n, k in enumerate(kept)}
        rest, bind = figure["rest"], figure["bind"]
        if rest is None and bind is None:
            raise FileError(path, 0, f"{figure['path']}: expected bindTransforms or restTransforms, one per joint")
        up = np.where(parents >= 0, parents, 0)
        child = parents >= 0
        if bind is None:
            warn(f"{path}: {figure['path']}: no bindTransforms; the rest pose is taken for the one that was bound")
            bind = rest.copy()
            for j in np.flatnonzero(child):
                bind[j] = bind[parents[j]] @ rest[j]
        if (np.abs(np.linalg.det(bind[:, :3, :3])) < 1e-12).any():
            raise FileError(
                path, 0, f"{figure['path']}: expected bindTransforms that can be inverted, found a flat one"
            )
        above = np.where(child[:, None, None], bind[up], np.eye(4))
        if rest is None:
            rest = np.linalg.inv(above) @ bind
        self.bind, self.above = bind[kept], above[kept]
        centers = (space @ self.bind)[:, :3, 3]
        names = _names([leaves[k] for k in kept], about.get("joints"))
        fields = self.turned(rest[kept][None])
        self.stretch = fields[2][0]
        self.joints: list[Joint] = []
        self.roots: list[Joint] = []
        for n, k in enumerate(kept):
            rotation, shift, stretch = (f[0, n] for f in fields)
            joint = Joint(names[n], center=np.where(np.abs(centers[n]) < 1e-12, 0.0, centers[n]))
            _, joint.rotation, joint.scale, joint.scale_orientation = _fields(
                _linear(to_matrix(rotation) @ stretch), (space @ self.bind[n])[:3, :3]
            )
            joint.translation = np.where(np.abs(shift) < SNAP, 0.0, shift)
            _tell(joint, about["joints"].get(leaves[k], {}) if "joints" in about else None)
            self.joints.append(joint)
            above_it = self.joints[self.place[parents[k]]].joints if child[k] else self.roots
            above_it.append(joint)

    def turned(self, local: Floats) -> tuple[Floats, Floats, Floats]:
        """Rotation (F,J,4), translation (F,J,3) and stretch (F,J,3,3) of H-Anim's joints, of local transforms
        (F,J,4,4)."""
        moved = self.above @ local  # where the joint comes to while its parent rests
        matrix = self.space @ moved @ np.linalg.inv(self.space @ self.bind)
        rotation, stretch = split(matrix[..., :3, :3])
        there, center = (self.space @ moved)[..., :3, 3], (self.space @ self.bind)[:, :3, 3]
        return from_matrix(rotation), there - center, stretch


def _linear(matrix: Floats) -> Floats:
    out = np.eye(4)
    out[:3, :3] = matrix
    return out


def _names(leaves: list[str], about: dict[str, Any] | None) -> list[str]:
    """What H-Anim calls the joints: as we wrote them, else by the tables; what nobody knows keeps its name."""
    if about is not None:
        return [str(about.get(n, {}).get("name", n)) for n in leaves]
    known = match(leaves)
    taken = {h for h in known.values() if h not in (SPINE, NECK)}
    for kind, few, many in ((SPINE, _TRUNK, VERTEBRAE[:17]), (NECK, _NECK, VERTEBRAE[17:])):
        row = [n for n in leaves if known.get(n) == kind]
        free = [v for v in few.get(len(row), ()) if v not in taken] or [v for v in many if v not in taken]
        some = [free[k] for k in np.linspace(0, len(free) - 1, len(row)).round().astype(int)] if free else []
        for n, vertebra in zip(row, some if len(row) <= len(free) else []):
            known[n] = vertebra
        for n in row:
            if known[n] == kind:
                del known[n]
    out: list[str] = []
    used, meant = set(), set(known.values())
    for n in leaves:
        name, k = known.get(n, n), 1
        while name in used or (n not in known and name in meant):
            name, k = f"{n}_{k}", k + 1
        used.add(name)
        out.append(name)
    return out


def _tell(joint: Joint, about: dict[str, Any] | None) -> None:
    """Limits, stiffness and Segments of a joint, from what we wrote; else the Segment that the standard gives it."""
    if about is None:
        known = tables.canonical(joint.name)
        joint.segments += [Segment(tables.joints()[known].segment)] if known else []
        return
    joint.llimit, joint.ulimit = (_limit(about.get(side)) for side in ("llimit", "ulimit"))
    for field, width in (("stiffness", 3), ("limitOrientation", 4)):
        given = np.array(about.get(field, []), dtype=np.float64)
        if len(given) == width and np.isfinite(given).all():
            if field == "stiffness":
                joint.stiffness = given
            else:
                joint.limit_orientation = to_axis_angle(given)
    for _, item in sorted(about.get("segments", {}).items(), key=lambda pair: (len(pair[0]), pair[0])):
        segment = Segment(str(item.get("name", "")), mass=float(item.get("mass", 0.0)))
        segment.center_of_mass = _array(item.get("centerOfMass"), 3)
        segment.moments_of_inertia = _array(item.get("momentsOfInertia"), 9)
        joint.segments.append(segment)


def _limit(given: Any) -> Floats:
    values = np.array([] if given is None else given, dtype=np.float64)[:3]
    bad = np.flatnonzero(~np.isfinite(values))
    return values[: bad[0]] if len(bad) else values


def _array(given: Any, width: int) -> Floats:
    values = np.array([] if given is None else given, dtype=np.float64)
    return values if values.shape == (width,) and np.isfinite(values).all() else np.zeros(width)


def _site(h: Humanoid, rig: Rig, item: dict[str, Any], space: Floats, views: list[tuple[int, Site]]) -> None:
    """A Site goes to its joint or to the skeleton field; a viewpoint to `views` too, with its place in the list."""
    about, place = item["about"], space @ item["matrix"]
    site = Site(str(about.get("name", "")), center=place[:3, 3], rotation=axis_angle(split(place[:3, :3])[0]))
    j, view = int(about.get("joint", -1)), int(about.get("viewpoint", -1))
    if view >= 0:
        views.append((view, site))
    if about.get("root"):
        h.sites.append(site)
    elif 0 <= j < len(rig.joints):
        joint = rig.joints[j]
        (joint.segments[0].sites if joint.segments else joint.sites).append(site)


def _skin(h: Humanoid, rig: Rig, meshes: list[dict[str, Any]], space: Floats) -> None:
    """Meshes that bend become the seamless skin, one after the other; those on one joint its Segment's geometry."""
    points: list[Floats] = []
    count = 0
    pairs: list[tuple[NDArray, NDArray, NDArray]] = []
    painted: list[tuple[Shape, int]] = []  # and the first point of the mesh that its colours are for
    for mesh in meshes:
        whole = space @ mesh["geometry"]
        at = mesh["points"] @ whole[:3, :3].T + whole[:3, 3]
        joints, weights = rig.place[mesh["joints"]], np.where(np.isfinite(mesh["weights"]), mesh["weights"], 0.0)
        if mesh["rigid"]:
            used = np.flatnonzero((weights[0] != 0) & (joints[0] >= 0))
            if len(used) == 1 and abs(weights[0, used[0]] - 1) < 1e-6:
                _rigid(rig, rig.joints[joints[0, used[0]]], mesh, at, whole)
                continue
            joints, weights = (np.repeat(v, len(at), axis=0) for v in (joints, weights))
        if mesh["sums"] is not None and len(mesh["sums"]) == len(weights):
            weights = weights * mesh["sums"][:, None]
        some = (joints >= 0) & (weights > 0)
        pairs.append((np.nonzero(some)[0] + count, joints[some], weights[some]))
        for shape in shapes_of(mesh, at):
            shape.points, shape.triangles = None, shape.triangles + np.int32(count)
            h.skin.append(shape)
            if shape.colors is not None:
                painted.append((shape, count))
        for item in mesh["shapes"]:
            _displacer(rig, item, count, joints, weights, whole)
        points.append(at)
        count += len(at)
    if not points:
        return
    h.skin_coord = np.concatenate(points)
    for shape, first in painted:  # a colour for each point of the whole skin
        full = np.full((count, 3), 0.8)
        colors = shape.colors
        assert colors is not None
        full[first : first + len(colors)] = colors
        shape.colors = full
    vertex, joint, weight = (np.concatenate(p) for p in zip(*pairs))
    order = np.lexsort((vertex, joint))
    starts = np.searchsorted(joint[order], np.arange(len(rig.joints) + 1))
    for j, owner in enumerate(rig.joints):
        mine = order[starts[j] : starts[j + 1]]
        owner.skin_coord_index = vertex[mine].astype(np.int32)
        owner.skin_coord_weight = weight[mine]


def _displacer(rig: Rig, item: dict[str, Any], first: int, joints: NDArray, weights: NDArray, whole: Floats) -> None:
    """A BlendShape of the skin, under the joint that we wrote it from, else under the one that moves most of it."""
    about, index = item["about"], item["index"]
    j = rig.keys.get(str(about.get("joint", "")))
    if j is None:
        mine = joints[index]
        total = np.bincount(np.maximum(mine, 0).reshape(-1), (weights[index] * (mine >= 0)).reshape(-1), 1)
        j = int(np.argmax(total))
    rig.joints[j].displacers.append(_made(rig, item, index + first, whole))


def _made(rig: Rig, item: dict[str, Any], index: NDArray, whole: Floats) -> Displacer:
    name = str(item["about"].get("name", item["name"]))
    rig.tokens_of.setdefault(name, item["token"])
    moves = item["offsets"] @ whole[:3, :3].T
    return Displacer(name, index.astype(np.int32), moves, float(item["about"].get("weight", 0.0)))


def _rigid(rig: Rig, joint: Joint, mesh: dict[str, Any], at: Floats, whole: Floats) -> None:
    """A mesh on one joint: geometry of its Segment. Displacers mean the first Shape, so they get a Segment alone."""
    if not joint.segments:
        joint.segments.append(Segment(f"{joint.name}_segment"))
    segment = joint.segments[0]
    if mesh["shapes"] and segment.shapes:
        segment = Segment(f"{segment.name}_{len(joint.segments)}")
        joint.segments.append(segment)
    segment.shapes += shapes_of(mesh, at)
    segment.displacers += [_made(rig, item, item["index"], whole) for item in mesh["shapes"]]


def _animate(path: object, h: Humanoid, rig: Rig, animation: dict[str, Any], about: dict[str, Any]) -> None:
    """One frame poses the figure; several become tracks with a key for each, on one timer."""
    local = animation["local"]
    if local is None or local.shape[1] != len(rig.place):
        warn(f"{path}: a SkelAnimation that does not fit its Skeleton is left out")
        return
    weights = _weights(h, rig, animation)
    rotation, shift, stretch = rig.turned(local[:, rig.place >= 0])
    if np.abs(stretch - rig.stretch).max() > _COARSE * np.abs(rig.stretch).max():
        warn(f"{path}: the animation scales joints, which a motion of H-Anim joints can't carry; scales stay at rest")
    frames = len(rotation)
    if frames == 1:
        for j, joint in enumerate(rig.joints):
            joint.rotation = axis_angle(to_matrix(rotation[0, j]))
            joint.translation = np.where(np.abs(shift[0, j]) < SNAP, 0.0, shift[0, j])
        return
    skeleton = pack(h).skeleton
    number = {id(j): k for k, j in enumerate(rig.joints)}
    order = [number[id(j)] for j in dict.fromkeys(h.joints())]
    rotation, shift = rotation[:, order], shift[:, order]
    for j in range(1, len(order)):
        if np.abs(shift[:, j] - skeleton.translation[j]).max() < SNAP:
            shift[:, j] = skeleton.translation[j]
    slides = bool((shift[:, 1:] != skeleton.translation[1:]).any())
    moving = {n: w for n, w in weights.items() if np.ptp(w) > 0}
    title = str(about.get("motion", animation["name"]))
    motion = Motion(skeleton, animation["fps"], rotation, shift[:, 0], shift if slides else None, moving)
    h.tracks = _tracks(motion, title, bool(about.get("loop", False)))


def _weights(h: Humanoid, rig: Rig, animation: dict[str, Any]) -> dict[str, Floats]:
    """Weights over time by displacer; one that does not change becomes the displacer's own."""
    tokens, out = animation["tokens"], {}
    for d in h.displacers():
        if rig.tokens_of.get(d.name) in tokens:
            out[d.name] = animation["weights"][:, tokens.index(rig.tokens_of[d.name])]
            if np.ptp(out[d.name]) == 0:
                d.weight = float(out[d.name][0])
    return out


def _tracks(motion: Motion, timer: str, loop: bool) -> list[Track]:
    """A loop that comes back to its beginning ends with its first frame again; one that travels ends as it is."""
    closed = replace(motion, loop=loop)
    tracks = tracks_of(closed, timer=timer)
    ends = [np.abs(t.values[0] - t.values[-1]).max() < 1e-6 for t in tracks if t.field == "translation"]
    if loop and not all(ends):
        tracks = tracks_of(motion, timer=timer)
        for track in tracks:
            track.loop = True
    return tracks
