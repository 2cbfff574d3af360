"""A figure with the markers that moved it: where they were measured, and where they sit on the body."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Body, Floats, Ints, Skeleton, floats, indices, require
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.motion.calibration import groups
from vitruvian.motion.markers import Markers
from vitruvian.motion.tracking import track
from vitruvian.stage.clip import Clip


@dataclass(frozen=True, eq=False)
class Marked:
    """A clip, and markers `names` (M,) that were measured at points (F,M,3), metres, humanoid space, NaN where missing.

    joint (M,), point (M,3): what each sits on, and where at rest. F as many frames as the clip's motion has.
    """

    clip: Clip
    names: tuple[str, ...]
    joint: Ints
    point: Floats
    points: Floats

    def __post_init__(self) -> None:
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        m, motion = len(self.names), self.clip.motion
        require(motion is not None, "markers", "a clip with a motion", "one without")
        assert motion is not None
        put("joint", indices(self.joint, "markers.joint", len(self.clip.body.skeleton), m))
        put("point", floats(self.point, "markers.point", m, 3))
        shape = np.shape(self.points)
        require(shape == (len(motion), m, 3), "markers.points", f"shape ({len(motion)}, {m}, 3)", shape)

    def at(self, frame: float) -> NDArray[np.float32]:
        """(M,3) at a frame or between two, NaN where missing in one of them."""
        i = min(max(int(frame + 1e-6), 0), len(self.points) - 1)
        j, part = min(i + 1, len(self.points) - 1), max(frame - i, 0.0)
        if part < 1e-4 or i == j:
            return np.asarray(self.points[i], np.float32)
        return np.asarray(self.points[i] + part * (self.points[j] - self.points[i]), np.float32)


def marked(
    humanoid: Humanoid, body: Body, markers: Markers, *, progress: Callable[[float], None] | None = None
) -> tuple[Marked, tuple[str, ...]]:
    """The body in the performer's proportions, moved by the markers and shown with them; and what was found, a line each.

    Raises VitruvianError as `track` does.
    """
    found = track(body, markers.names, markers.points, markers.fps, progress=progress)
    index = [markers.names.index(n) for n in found.names]
    made = proportioned(body, found.motion.skeleton, found.scale)
    own = Marked(
        Clip(humanoid, made, replace(found.motion, skeleton=made.skeleton)),
        found.names,
        found.attachment.joint,
        found.attachment.point,
        markers.points[:, index],
    )
    shown = np.isfinite(own.points).all(axis=2).mean()
    lines = [
        f"{len(found.names)} of {len(markers.names)} markers, {len(markers):,} frames, {shown:.0%} of the points there: "
        f"root mean square {1000 * found.rms:.1f} mm, at most {1000 * np.nanmax(found.residual):.1f} mm"
    ]
    return own, (*lines, *found.notes)


def proportioned(body: Body, skeleton: Skeleton, scale: dict[str, float]) -> Body:
    """The body on a skeleton whose parts are longer by `scale`, as `track` finds them: its skin goes with its joints.

    A segment grows by its own factor along its bone, by that of the whole body across it; where it holds several joints,
    by its own in all directions. Points between segments go with their weights.
    What it has of contours is left out, and so is its placement: markers are measured in metres on the floor.
    """
    s, skin = body.skeleton, body.skin
    factor = np.array([scale[part] for part in groups(s)])
    girth = float(np.median(factor))
    bind = np.broadcast_to(np.eye(4), (len(s), 4, 4)) if s.binding is None else s.binding
    back = np.linalg.inv(bind)
    grow = np.broadcast_to(np.eye(4), (len(s), 4, 4)).copy()
    grow[:, :3, :3] *= factor[:, None, None]
    for j in np.flatnonzero(np.bincount(s.parents[s.parents >= 0], minlength=len(s)) == 1):
        bone = s.centers[int(np.argmax(s.parents == j))] - s.centers[j]
        if (long := float(np.linalg.norm(bone))) > 1e-9:  # longer along the bone; as thick as all of it is larger
            grow[j, :3, :3] = girth * np.eye(3) + (factor[j] - girth) * np.outer(bone, bone) / long**2
    grow[:, :3, 3] = skeleton.centers - np.einsum("jab,jb->ja", grow[:, :3, :3], s.centers)
    maps = back @ grow @ bind
    w = skin.weights
    moved = np.einsum("nab,nb->na", maps[w.joint, :3, :3], skin.rest[w.vertex]) + maps[w.joint, :3, 3]
    rest = np.zeros_like(skin.rest)
    size = np.zeros(len(rest))
    np.add.at(rest, w.vertex, w.weight[:, None] * moved)
    np.add.at(size, w.vertex, w.weight * factor[w.joint])
    left = 1.0 - w.sums  # the share that no joint moves
    rest += left[:, None] * skin.rest
    size += left
    morphs = tuple(replace(m, offset=m.offset * size[m.index, None]) for m in skin.morphs)
    return replace(
        body, skeleton=skeleton, skin=replace(skin, rest=rest, morphs=morphs), placement=np.eye(4), contours=()
    )
