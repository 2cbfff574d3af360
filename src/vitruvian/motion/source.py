"""The clip that is to be carried over to another skeleton: who is who in it, how it stands at rest and where it faces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vitruvian.body.rotations import from_matrix, inverse, multiply, rotate
from vitruvian.body.types import Floats, Skeleton
from vitruvian.errors import VitruvianError
from vitruvian.motion.guess import guessed
from vitruvian.motion.names import NECK, SPINE, match
from vitruvian.motion.turns import positions, unit, world_rotations
from vitruvian.motion.types import Motion

UP = np.array([0.0, 1.0, 0.0])
_LIMBS = ("hip", "knee", "talocrural", "shoulder", "elbow", "radiocarpal")
FEWEST = 4  # of the twelve joints of limbs: with fewer known by name, the shape of a rig tells who is who


@dataclass(frozen=True, eq=False)
class Source:
    """The clip to be carried over: who is who, rest positions (J,3), turns from rest (F,J,4), positions (F,J,3)."""

    skeleton: Skeleton
    index: dict[str, int]
    trunk: tuple[int, ...]  # joints that are no particular vertebra
    rest: Floats
    turn: Floats
    place: Floats
    fps: float

    @cached_property
    def children(self) -> list[list[int]]:
        out: list[list[int]] = [[] for _ in self.skeleton.names]
        for j, p in enumerate(self.skeleton.parents):
            if p >= 0:
                out[p].append(j)
        return out

    def path(self, joint: int) -> list[int]:
        """Joints from the root down to `joint`."""
        out = [joint]
        while (joint := int(self.skeleton.parents[joint])) >= 0:
            out.append(joint)
        return out[::-1]

    def fork(self, *names: str) -> int | None:
        """The last common ancestor (or self) of those of the named joints that exist."""
        paths = [self.path(self.index[n]) for n in names if n in self.index]
        if not paths:
            return None
        common = [level[0] for level in zip(*paths) if len(set(level)) == 1]
        return common[-1] if common else None

    def end(self, joint: int, skip: int | None = None) -> Floats | None:
        """The farthest joint or Site at or below `joint` at rest, not below `skip`; None when there is none."""
        best, far, stack = None, 1e-6, [joint]
        while stack:
            j = stack.pop()
            if j == skip:
                continue
            stack.extend(self.children[j])
            sites = self.skeleton.site_points[self.skeleton.site_joints == j]
            for point in (self.rest[j], *(sites if self.rest is self.skeleton.centers else ())):
                if (size := float(np.linalg.norm(point - self.rest[joint]))) > far:
                    best, far = point, size
        return best


def source_of(motion: Motion, names: Mapping[str, str] | None, rest_frame: int | None) -> tuple[Source, list[str]]:
    skeleton = motion.skeleton
    unknown = set(names or {}) - set(skeleton.names)
    if unknown:
        raise VitruvianError(
            f"names: the clip has no joint {sorted(unknown)[0]!r}; it has {', '.join(skeleton.names[:8])}, ..."
        )
    roles = match(skeleton.names, names)
    notes: list[str] = []
    if len({f"{side}_{part}" for side in "lr" for part in _LIMBS} & set(roles.values())) < FEWEST:
        roles = _guessed(skeleton, {n: h for n, h in roles.items() if n in (names or {})}, notes) or roles
    twice = [h for h in roles.values() if h not in (SPINE, NECK) and list(roles.values()).count(h) > 1]
    if twice:
        raise VitruvianError(f"names: two joints of the clip are given to {twice[0]}; expected one")
    index = {h: skeleton.index[n] for n, h in roles.items() if h not in (SPINE, NECK)}
    trunk = tuple(skeleton.index[n] for n, h in roles.items() if h in (SPINE, NECK))
    if not any(k in index for k in ("humanoid_root", "l_hip", "r_hip")):
        some = ", ".join(skeleton.names[:6])
        raise VitruvianError(
            f"names: no joint of the clip ({some}, ...) is known as hips; give names={{joint: H-Anim joint}}"
        )
    rotation, move, shift = motion.rotation, motion.translation, motion.joint_translation
    if _odd_start(motion):
        # CMU's conversions begin with a row of zeros
        keep = np.r_[1, 1 : len(motion)]
        rotation, move, shift = rotation[keep], move[keep], None if shift is None else shift[keep]
        notes.append("frame 0 has nothing to do with frame 1 (an inserted pose): frame 1 is shown instead")
    world = world_rotations(skeleton.parents, rotation)
    place = positions(skeleton.parents, skeleton.centers, world, move, shift)
    rest = skeleton.centers
    if rest_frame is not None:
        if not -len(motion) <= rest_frame < len(motion):
            raise VitruvianError(f"rest_frame: expected a frame in 0..{len(motion) - 1}, found {rest_frame}")
        rest = place[rest_frame]
        world = multiply(world, inverse(world[rest_frame]))
    lost = [n for n in skeleton.names if n not in roles and not n.startswith("__")]
    if lost:
        notes.append(f"not matched, carried by their neighbours: {', '.join(lost)}")
    source = Source(skeleton, index, trunk, rest, world, place, motion.fps)
    if _sides_exchanged(source):
        said = "left and right are exchanged: by these names the feet point backwards"
        if any(h.startswith(("l_", "r_")) for h in (names or {}).values()):
            raise VitruvianError(f"names: {said}; exchange l_ and r_ in the table")
        notes.append(f"{said}; names= can say which is which")
    return source, notes


def _guessed(skeleton: Skeleton, own: dict[str, str], notes: list[str]) -> dict[str, str]:
    """The roles that the shape of the skeleton tells, {} for none; those of the caller's table win. Says so in `notes`."""
    shape = guessed(skeleton)
    if not shape:
        return {}
    taken = set(own.values()) - {SPINE, NECK}
    added = {n: h for n, h in shape.items() if n not in own and h not in taken}
    pairs = ", ".join(f"{n}={h}" for n, h in added.items())
    notes.append(f"names nobody knows, matched by the shape of the skeleton: {pairs}")
    return own | added


def _sides_exchanged(source: Source) -> bool:
    """Whether both feet point backwards when left is where the names say."""
    front = rotate(facing_of(source), np.array([0.0, 0.0, 1.0]))
    back = []
    for side in "lr":
        ankle, toe = (source.index.get(f"{side}_{p}") for p in ("talocrural", "metatarsophalangeal_2"))
        if ankle is None:
            return False
        end = source.rest[toe] if toe is not None else source.end(ankle)
        back.append(end is not None and float(unit(end - source.rest[ankle]) @ front) < -0.3)
    return all(back)


def _odd_start(motion: Motion) -> bool:
    """Whether the first frame is far from the second while the next ones follow each other closely."""
    if len(motion) < 4:
        return False
    some = min(len(motion), 12)
    dots = np.abs(np.sum(motion.rotation[1:some] * motion.rotation[: some - 1], axis=-1))
    turns = 2 * np.arccos(np.clip(dots, -1.0, 1.0)).max(axis=1)
    moves = np.linalg.norm(np.diff(motion.translation[:some], axis=0), axis=1)
    far = turns[0] > max(np.radians(10), 8 * turns[1:].max()) or moves[0] > max(0.1, 8 * moves[1:].max())
    return bool(far)


def facing_of(source: Source) -> Floats:
    """The turn (4,) from the standard's axes (X left, Y up, Z front) to those of the source at rest.

    Figures that stand within 20 degrees of a quarter turn are taken to face it exactly: hips are never quite symmetric.
    """
    index, rest = source.index, source.rest
    pairs = [(f"l_{p}", f"r_{p}") for p in ("hip", "shoulder", "knee") if f"l_{p}" in index and f"r_{p}" in index]
    left = unit(rest[index[pairs[0][0]]] - rest[index[pairs[0][1]]]) if pairs else np.array([1.0, 0.0, 0.0])
    low, high = source.fork("l_hip", "r_hip"), index.get("skullbase")
    spine = unit(rest[high] - rest[low]) if high is not None and low is not None else UP
    axes = []
    for axis in (spine, left):
        nearest = np.eye(3)[np.argmax(np.abs(axis))] * np.sign(axis[np.argmax(np.abs(axis))])
        axes.append(nearest if axis @ nearest > np.cos(np.radians(20)) else axis)
    y = unit(axes[0])
    x = unit(axes[1] - y * (axes[1] @ y))
    return from_matrix(np.stack([x, y, np.cross(x, y)], axis=-1))
