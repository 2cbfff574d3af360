"""Let another skeleton do what a captured one does.

Only turns in the world are carried over, never local angles: rest poses, local axes and joint counts of the two may
differ. Source: note motion.md, section 4 (world deltas, rest alignment by swing and secondary axis, trunk by arc
length). Frames: humanoid space, Y up; A is the turn that brings the target at rest into the pose of the source at rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vitruvian.body.rotations import between, inverse, multiply, rotate, slerp
from vitruvian.body.types import Floats, Skeleton
from vitruvian.errors import VitruvianError
from vitruvian.motion.contacts import Leg, floor_at_rest, in_units, legs, sole_points, standing, units_per_metre
from vitruvian.motion.hands import relaxed
from vitruvian.motion.legs import Foothold, footholds, plant
from vitruvian.motion.names import FINGER_JOINTS, VERTEBRAE, joint_index
from vitruvian.motion.source import Source, facing_of, source_of
from vitruvian.motion.turns import about, frame, local_rotations, positions, twist, unit, world_rotations
from vitruvian.motion.types import Motion

UP = np.array([0.0, 1.0, 0.0])
FINGERS = [n for joints in FINGER_JOINTS.values() for n in joints] + [f"carpometacarpal_{k}" for k in range(2, 6)]


def retarget(
    motion: Motion,
    skeleton: Skeleton,
    *,
    names: Mapping[str, str] | None = None,
    feet: bool = True,
    twist_to_elbow: float = 0.5,
    root: str = "scale",
    rest_frame: int | None = None,
) -> Motion:
    """The clip on another skeleton: `motion` on its own skeleton to a Motion on `skeleton` (H-Anim names, any LOA).

    names: {joint of the clip: H-Anim joint}, wins over the built-in tables. feet: find when feet stand and keep them on
    the floor (y = 0 at rest) by inverse kinematics. twist_to_elbow: share of the forearm's twist that the elbow takes,
    the wrist the rest; not used between two H-Anim skeletons. root: "scale" walks in proportion to the leg length,
    "keep" leaves distances as they were captured. rest_frame: a frame of the clip that shows the rest pose.
    `Motion.notes` says what was not matched. Raises `VitruvianError` when the clip has no recognisable hips or
    `skeleton` is no H-Anim skeleton.
    """
    if root not in ("scale", "keep"):
        raise VitruvianError(f"root: expected 'scale' or 'keep', found {root!r}")
    target = joint_index(skeleton.names)
    if "l_hip" not in target and "humanoid_root" not in target:
        raise VitruvianError("skeleton: expected H-Anim joint names (humanoid_root, l_hip, ...), found none")
    unit = units_per_metre(skeleton)
    if unit != 1.0:
        keys: dict = {"names": names, "feet": feet, "twist_to_elbow": twist_to_elbow}
        out = retarget(motion, in_units(skeleton, 1 / unit), **keys, root=root, rest_frame=rest_frame)
        return replace(out, skeleton=skeleton, translation=out.translation * unit)
    source, notes = source_of(motion, names, rest_frame)
    facing = facing_of(source)
    align = _alignment(source, skeleton, target, facing)
    world, given = _transfer(source, skeleton, target, align, facing)
    local = np.zeros_like(world)
    local[..., 3] = 1.0
    known = np.flatnonzero(given)  # the others do not turn in their parents
    above = skeleton.parents[known]
    local[:, known] = np.where(above[:, None] < 0, world[:, known], multiply(inverse(world[:, above]), world[:, known]))
    move, scale = _root(source, skeleton, target, world, root)
    if not _is_hanim(motion.skeleton):
        _untwist(local, skeleton, target, twist_to_elbow)
        _relax_fingers(local, skeleton, target, given)
    notes = [*notes, f"distances scaled by {scale:.3f}"]
    limbs = legs(skeleton)
    if feet and limbs and len(motion) > 1:
        world = world_rotations(skeleton.parents, local)
        holds = footholds(skeleton, world, move, limbs, motion.fps)
        move[:, 1] += _ground(skeleton, world, move, limbs, holds)
        world, move = plant(skeleton, world, move, limbs, holds, motion.fps)
        local = local_rotations(skeleton.parents, world)
    elif feet and limbs:  # a pose: nothing tells which foot stands, but a figure does not hang or sink
        alone = Motion(skeleton, motion.fps, local, move)
        move[:, 1] -= sole_points(alone)[..., 1].min() * units_per_metre(skeleton)
    elif feet:
        notes.append("no legs with hip, knee and ankle: feet are left as they come")
    return Motion(
        skeleton,
        motion.fps,
        local,
        move,
        weights=dict(motion.weights),
        loop=motion.loop,
        name=motion.name,
        notes=tuple([*motion.notes, *notes]),
    )


def _is_hanim(skeleton: Skeleton) -> bool:
    return len(joint_index(skeleton.names)) > len(skeleton) // 2


def _alignment(source: Source, skeleton: Skeleton, target: dict[str, int], facing: Floats) -> dict[str, Floats]:
    """A (4,) for each joint that both have; the trunk is taken to stand alike in both rest poses."""
    align = {name: facing for name in source.index if name in target}
    c, rest, index = skeleton.centers, source.rest, source.index
    both = lambda name: name in index and name in target  # noqa: E731
    for side in "lr":
        for chain in (("hip", "knee", "talocrural"), ("shoulder", "elbow", "radiocarpal")):
            before = facing
            for near, far in zip(chain, chain[1:]):
                a, b = f"{side}_{near}", f"{side}_{far}"
                if both(a) and both(b):
                    own, his = c[target[b]] - c[target[a]], rest[index[b]] - rest[index[a]]
                    if near in ("hip", "shoulder"):
                        before = multiply(_sideways(facing, rotate(before, own), his), before)
                    before = _swing(before, own, his)
                if a in align:
                    align[a] = before
            if f"{side}_{chain[-1]}" in align:
                align[f"{side}_{chain[-1]}"] = before
        if both(f"{side}_radiocarpal"):
            hand = _hand(source, skeleton, target, side, align[f"{side}_radiocarpal"])
            align[f"{side}_radiocarpal"] = hand
            for name in (f"{side}_{f}" for f in FINGERS):
                if name in align:
                    align[name] = hand
            _align_fingers(source, skeleton, target, side, align)
        if both(f"{side}_talocrural"):
            foot = _foot(source, skeleton, target, side, facing)
            for part in ("talocrural", "tarsometatarsal_2", "metatarsophalangeal_2", "tarsal_distal_interphalangeal_2"):
                if f"{side}_{part}" in align:
                    align[f"{side}_{part}"] = foot
        for name in _toes(source, target, side):
            align[name] = align[f"{side}_metatarsophalangeal_2"]
    return align


def _toes(source: Source, target: dict[str, int], side: str) -> list[str]:
    """Joints of toes that follow the only one that the clip has, so that a shoe bends as one."""
    toes = [f"{side}_metatarsophalangeal_{k}" for k in range(1, 6)]
    if [n for n in toes if n in source.index] != [toes[1]] or toes[1] not in target:
        return []
    return [n for n in toes if n in target and n != toes[1]]


def _swing(before: Floats, target: Floats, source: Floats) -> Floats:
    """`before`, then the least turn that lays the target's bone along the source's."""
    return multiply(between(rotate(before, target), source), before)


def _sideways(facing: Floats, own: Floats, his: Floats) -> Floats:
    """The turn about the front axis that brings limb `own` as far out from the body as `his`.

    Rest poses differ by how far arms and legs are raised to the side (T, A, hanging). Done first and about that axis,
    it keeps thumbs and kneecaps where they are; the shortest turn would roll limbs that do not hang exactly straight.
    """
    front = rotate(facing, np.array([0.0, 0.0, 1.0]))
    a, b = (unit(v - front * (v @ front)) for v in (own, his))
    if abs(unit(own) @ front) > 0.95 or abs(unit(his) @ front) > 0.95:
        return np.array([0.0, 0.0, 0.0, 1.0])  # a limb that points to the front says nothing about it
    return about(front, np.arctan2(np.cross(a, b) @ front, a @ b))


def _hand(source: Source, skeleton: Skeleton, target: dict[str, int], side: str, forearm: Floats) -> Floats:
    """Knuckles along knuckles, and thumb beside thumb when both have one."""
    c, wrist = skeleton.centers, f"{side}_radiocarpal"
    middle = next((target[n] for k in (3, 2, 4) if (n := f"{side}_metacarpophalangeal_{k}") in target), None)
    if middle is None:
        return forearm
    own = c[middle] - c[target[wrist]]
    known = [n for k in (3, 2, 4) if (n := f"{side}_metacarpophalangeal_{k}") in source.index]
    thumb = source.index.get(f"{side}_carpometacarpal_1")
    tip = source.rest[source.index[known[0]]] if known else source.end(source.index[wrist], skip=thumb)
    if tip is None:
        return forearm
    his = tip - source.rest[source.index[wrist]]
    if thumb is None or f"{side}_carpometacarpal_1" not in target:
        return _swing(forearm, own, his)
    # the same joint of both thumbs, or the far ends of both
    knuckle = f"{side}_metacarpophalangeal_1"
    tips = [n for joint in FINGER_JOINTS[1] if (n := f"{side}_{joint}") in target]
    own_thumb = target[knuckle if knuckle in target and knuckle in source.index else tips[-1]]
    his_thumb = source.rest[source.index[knuckle]] if knuckle in source.index else source.end(thumb)
    if his_thumb is None:
        return _swing(forearm, own, his)
    a = frame(his, his_thumb - source.rest[source.index[wrist]])
    b = frame(own, c[own_thumb] - c[target[wrist]])
    return multiply(a, inverse(b))


def _align_fingers(
    source: Source, skeleton: Skeleton, target: dict[str, int], side: str, align: dict[str, Floats]
) -> None:
    for k in range(1, 6):
        joints = FINGER_JOINTS[k] if k == 1 else (f"carpometacarpal_{k}", *FINGER_JOINTS[k])
        chain = [n for joint in joints if (n := f"{side}_{joint}") in align]
        for near, far in zip(chain, chain[1:]):
            own = skeleton.centers[target[far]] - skeleton.centers[target[near]]
            his = source.rest[source.index[far]] - source.rest[source.index[near]]
            align[near] = _swing(align[near], own, his)
            align[far] = align[near]


def _foot(source: Source, skeleton: Skeleton, target: dict[str, int], side: str, facing: Floats) -> Floats:
    """Sole on sole, toes in line.

    A rest pose with legs apart may hold its feet flat on the floor or square to the shins; what the clip does while the
    foot stands decides which.
    """
    ankle, knee = source.index[f"{side}_talocrural"], source.index.get(f"{side}_knee")
    toe = source.index.get(f"{side}_metatarsophalangeal_2")
    tip = source.rest[toe] if toe is not None else source.end(ankle)
    up = rotate(facing, UP)
    if knee is not None and tip is not None and len(source.turn) > 1:
        shin = unit(source.rest[knee] - source.rest[ankle])
        ends = (ankle, toe if toe is not None else ankle)
        stands = np.logical_and(*(standing(source.place[:, j], source.fps) for j in ends))
        normal = rotate(inverse(source.turn[stands, ankle]), UP).mean(axis=0) if stands.sum() >= 10 else up
        # lying, jumping or noise: no decision, the floor counts
        if np.linalg.norm(normal) > 0.9 and normal @ shin > normal @ up + 0.01:
            up = shin
    ball = target.get(f"{side}_metatarsophalangeal_2")
    own = skeleton.centers[ball] - skeleton.centers[target[f"{side}_talocrural"]] if ball is not None else np.eye(3)[2]
    his = tip - source.rest[ankle] if tip is not None else rotate(facing, np.eye(3)[2])
    return multiply(frame(up, his), inverse(frame(UP, own)))


def _transfer(
    source: Source, skeleton: Skeleton, target: dict[str, int], align: dict[str, Floats], facing: Floats
) -> tuple[Floats, list[bool]]:
    """World rotations (F,J,4) of the target, and which joints were given one (the others follow their parents)."""
    frames = len(source.turn)
    world = np.zeros((frames, len(skeleton), 4))
    world[..., 3] = 1.0
    given = [False] * len(skeleton)
    trunk = _trunk(source, skeleton, target, facing)
    lean = about(np.eye(3)[0], _lean(source, skeleton, target, facing))
    base = source.fork("l_hip", "r_hip", "skullbase", "l_shoulder", "r_shoulder")
    pelvis = source.fork("l_hip", "r_hip")
    drivers = dict(source.index)
    for side in "lr":
        # a thumb without fingers is CMU's: it shows where the palm is, but its angles flip from frame to frame
        if not any(f"{side}_{joint}" in drivers for k in range(2, 6) for joint in FINGER_JOINTS[k]):
            drivers.pop(f"{side}_carpometacarpal_1", None)
        for name in _toes(source, target, side):
            drivers[name] = drivers[f"{side}_metatarsophalangeal_2"]
    if base is not None and "humanoid_root" in target:
        drivers.setdefault("humanoid_root", base)
        drivers["humanoid_root"] = max(drivers["humanoid_root"], base)
    if pelvis is not None and "sacroiliac" in target:
        drivers.setdefault("sacroiliac", pelvis)
    for name, j in target.items():
        if name in trunk:
            world[:, j] = trunk[name]
        elif name in drivers:
            world[:, j] = multiply(source.turn[:, drivers[name]], align.get(name, facing))
            if name in ("l_sternoclavicular", "r_sternoclavicular") and trunk:
                world[:, j] = multiply(world[:, j], lean)
        else:
            continue
        given[j] = True
    for j, parent in enumerate(skeleton.parents):
        if not given[j] and parent >= 0:
            world[:, j] = world[:, parent]
    return world, given


def _trunk(source: Source, skeleton: Skeleton, target: dict[str, int], facing: Floats) -> dict[str, Floats]:
    """World rotations (F,4) of the vertebrae that the source does not have by name.

    Both spines run from 0 at the hips over 1 where the arms branch off to 2 at the head. A bone's turn belongs to its
    middle; between the middles turns are interpolated in the world.
    """
    head = source.index.get("skullbase")
    base = source.fork("l_hip", "r_hip", "skullbase")
    if head is None or base is None or not source.trunk:
        return {}
    path = source.path(head)
    path = path[path.index(base) :]
    arms = source.fork("l_shoulder", "skullbase") or source.fork("r_shoulder", "skullbase")
    his_arms = path.index(arms) if arms in path[1:-1] else max(1, len(path) // 2)
    his = _along(source.rest[path], his_arms)
    names = ["humanoid_root", *VERTEBRAE, "skullbase"]
    own_path = [target[n] for n in names if n in target]
    wanted = [n for n in VERTEBRAE if n in target and n not in source.index]
    if not wanted or "skullbase" not in target or "humanoid_root" not in target:
        return {}
    carrier = target.get("l_sternoclavicular", target.get("l_shoulder", target["skullbase"]))
    while carrier >= 0 and carrier not in own_path:
        carrier = int(skeleton.parents[carrier])
    own_arms = max(1, own_path.index(carrier)) if carrier in own_path else 1
    own = _along(skeleton.centers[own_path], own_arms)
    own[own_arms] = 1.0
    # the joint that carries the arms has its turn up to where the neck begins
    his = np.insert(his, his_arms + 1, 1.0)
    drivers = np.array([*path[: his_arms + 1], path[his_arms], *path[his_arms + 1 :]])
    his[0] = 0.0
    at = np.array([own[own_path.index(target[n])] for n in wanted])
    right = np.clip(np.searchsorted(his, at, side="left"), 1, len(his) - 1)
    span = his[right] - his[right - 1]
    t = np.where(span > 1e-9, (at - his[right - 1]) / np.maximum(span, 1e-9), 1.0)
    before, after = source.turn[:, drivers[right - 1]], source.turn[:, drivers[right]]
    # the lumbar spine takes what the two rest poses differ in lean, the neck gives it back
    lean = _lean(source, skeleton, target, facing) * np.clip(np.minimum(2 * at, 2 - at), 0.0, 1.0)
    world = multiply(multiply(slerp(before, after, np.clip(t, 0.0, 1.0)), facing), about(np.eye(3)[0], lean))
    return {name: world[:, i] for i, name in enumerate(wanted)}


def _lean(source: Source, skeleton: Skeleton, target: dict[str, int], facing: Floats) -> float:
    """How much farther forward (radians) the source's head is over its hips at rest than the target's.

    Rigs draw their spines straight up, anatomical ones lean from the sacrum to the head; without this the target would
    bow all the time. At most 15 degrees: more than that is a pose.
    """
    names = ("l_hip", "r_hip", "skullbase")
    if not all(n in source.index and n in target for n in names):
        return 0.0
    angles = []
    for points in (rotate(inverse(facing), source.rest[[source.index[n] for n in names]]), None):
        left, right, head = skeleton.centers[[target[n] for n in names]] if points is None else points
        way = head - 0.5 * (left + right)
        angles.append(np.arctan2(way[2], way[1]))
    return float(np.clip(angles[0] - angles[1], -np.radians(15), np.radians(15)))


def _along(points: Floats, arms: int) -> Floats:
    """Where the middle of each joint's bone lies: 0..1 up to the end of the one that carries the arms, 1..2 to the
    head.

    CMU's conversions have dropped the length of the chest; it gets the mean of the bones below.
    """
    length = np.linalg.norm(np.diff(points, axis=0), axis=1)
    arms = min(arms, len(length) - 1)
    if length[arms] < 1e-6 and arms > 0:
        length[arms] = length[:arms].sum() / max(1, np.count_nonzero(length[:arms] > 1e-6))
    ends = np.cumsum(length)
    middle = np.append(ends - 0.5 * length, ends[-1])
    chest, rest = max(ends[arms], 1e-9), max(ends[-1] - ends[arms], 1e-9)
    out = np.where(np.arange(len(points)) <= arms, middle / chest, 1 + (middle - ends[arms]) / rest)
    return np.maximum.accumulate(np.clip(out, 0.0, 2.0))


def _untwist(local: Floats, skeleton: Skeleton, target: dict[str, int], share: float) -> None:
    """Spread the turning of the hand about the forearm over elbow and wrist; the hand itself stays as it is."""
    for side in "lr":
        elbow, wrist = target.get(f"{side}_elbow"), target.get(f"{side}_radiocarpal")
        if elbow is None or wrist is None:
            continue
        axis = unit(skeleton.centers[wrist] - skeleton.centers[elbow])
        at_elbow, at_wrist = twist(local[:, elbow], axis), twist(local[:, wrist], axis)
        total = np.unwrap(at_elbow + at_wrist)
        total -= 2 * np.pi * np.round(np.median(total) / (2 * np.pi)) if len(total) else 0.0
        change = about(axis, share * total - at_elbow)
        local[:, elbow] = multiply(local[:, elbow], change)
        local[:, wrist] = multiply(inverse(change), local[:, wrist])


def _relax_fingers(local: Floats, skeleton: Skeleton, target: dict[str, int], given: list[bool]) -> None:
    """Fingers that the clip says nothing about hang as those of a hand at rest."""
    for name, turn in relaxed(skeleton).items():
        if not given[target[name]]:
            local[:, target[name]] = turn


def _root(source: Source, skeleton: Skeleton, target: dict[str, int], world: Floats, root: str) -> tuple[Floats, float]:
    """Translation (F,3) of the first joint that puts the middle of the hips where the source has it, and the scale."""
    index, c = source.index, skeleton.centers
    ratios = []
    for side in "lr":
        names = [f"{side}_{p}" for p in ("hip", "knee", "talocrural")]
        if all(n in index and n in target for n in names):
            mine, other = (
                sum(float(np.linalg.norm(p[i[a]] - p[i[b]])) for a, b in zip(names, names[1:]))
                for p, i in ((c, target), (source.rest, index))
            )
            ratios.append(mine / max(other, 1e-9))
    scale = float(np.mean(ratios)) if ratios else 1.0
    hips = [n for n in ("l_hip", "r_hip") if n in index and n in target]
    theirs = [index[n] for n in hips] or [index["humanoid_root"]]
    ours = [target[n] for n in hips] or [0]
    his = source.place[:, theirs].mean(axis=1)
    chain = sorted({k for j in ours for k in _upward(skeleton, j)})
    parents = [chain.index(p) if (p := int(skeleton.parents[j])) >= 0 else -1 for j in chain]
    place = positions(parents, c[chain], world[:, chain], np.zeros((len(world), 3)))
    own = place[:, [chain.index(j) for j in ours]].mean(axis=1)
    if root == "keep":
        # distances on the floor as captured, heights still in proportion: legs have to reach the ground
        return np.stack([his[:, 0], his[:, 1] * scale, his[:, 2]], axis=1) - own, scale
    if not ratios:  # no legs to compare: the way from the rest pose
        return his - source.rest[theirs].mean(axis=0) + c[ours].mean(axis=0) - own, 1.0
    return his * scale - own, scale


def _upward(skeleton: Skeleton, joint: int) -> list[int]:
    """A joint and all those that it hangs from."""
    found = [joint]
    while skeleton.parents[found[-1]] >= 0:
        found.append(int(skeleton.parents[found[-1]]))
    return found


def _ground(
    skeleton: Skeleton, world: Floats, move: Floats, limbs: tuple[Leg, ...], holds: Mapping[str, Foothold]
) -> float:
    """How far (m) to lift the clip so that the soles that stand do so on the floor."""
    place = positions(skeleton.parents, skeleton.centers, world, move)
    heights = []
    for leg in limbs:
        for stands, point in ((holds[leg.side].heel, leg.heel), (holds[leg.side].ball, leg.ball)):
            path = place[:, leg.ankle] + rotate(world[:, leg.ankle], point - skeleton.centers[leg.ankle])
            heights.append(path[stands, 1])
    found = np.concatenate(heights) if heights else np.zeros(0)
    if not found.size:
        found = place[:, [leg.ankle for leg in limbs], 1].min(axis=1) - limbs[0].length * 0.1
    return floor_at_rest(skeleton) - float(np.median(found))
