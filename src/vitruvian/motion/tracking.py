"""Trajectories of markers become the motion of a skeleton.

Source: note motion.md, 5: gaps, calibration of bone lengths and of where each marker sits, poses by least squares with
the body's own limits and stiffness (`vitruvian.motion.solver`).
"""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.rotations import from_matrix, slerp
from vitruvian.body.threads import one_thread
from vitruvian.body.types import Body, Floats, Ints, Skeleton
from vitruvian.errors import VitruvianError
from vitruvian.hanim.tables import canonical
from vitruvian.motion.calibration import Attachment, calibrated, groups
from vitruvian.motion.gaps import cleaned, uncrossed
from vitruvian.motion.limits import within
from vitruvian.motion.marker_sets import place_of, sides
from vitruvian.motion.names import VERTEBRAE, joint_index
from vitruvian.motion.solver import Answer, Freedom, Prior, Wishes, solve
from vitruvian.motion.types import Motion

NEAR = 1e-4  # m^2 a radian^2: what a turn away from the frames before costs (times 1 + 10 stiffness)
HELD = 10.0  # times NEAR while following: noise of millimetres turns short segments by degrees
MOVING, STANDING = 0.1, 1000.0  # how much of that holds while calibrating on any frames, and on those of a still stand
COARSE = 0.1  # seconds between the frames that are solved one after the other
_MOVERS = {
    "hip", "knee", "talocrural", "sternoclavicular", "shoulder", "elbow", "radiocarpal",
    "metatarsophalangeal_2",  # the toes together
}  # fmt: skip
# one marker on the acromion does not tell a turn about the collar bone
_CALM = {"sternoclavicular": 1000.0}
# the spine is a chain of two dozen joints and a few markers: each gives way little, or it curls up to please them
_SPINE = {*VERTEBRAE, "skullbase"}
_SPINAL = 100.0


@dataclass(frozen=True, eq=False)
class Tracked:
    """What the markers say.

    motion: on a skeleton with the body's joints and the performer's proportions. attachment: where each used marker
    sits. names (M,) of the markers used, residual (F,M) metres, NaN where a marker is missing or was left out.
    scale: part of the body -> length against the body's own. notes: one line each.
    seconds: what calibration and poses took.
    """

    motion: Motion
    attachment: Attachment
    names: tuple[str, ...]
    residual: Floats
    scale: dict[str, float]
    notes: tuple[str, ...]
    seconds: tuple[float, float] = (0.0, 0.0)

    @property
    def rms(self) -> float:
        """Root mean square of all residuals, metres."""
        return float(np.sqrt(np.nanmean(self.residual**2)))


@one_thread()
def track(
    body: Body | Skeleton,
    names: tuple[str, ...],
    points: Floats,
    fps: float,
    *,
    places: Mapping[str, str] | None = None,
    still: slice | None = None,
    performer: Tracked | None = None,
    progress: Callable[[float], None] | None = None,
) -> Tracked:
    """The motion that carries markers `names` (M,) along points (F,M,3), metres, Y up, NaN where missing.

    `places` {label: Site or joint of the body} wins over the tables of `marker_sets`; "" leaves a marker out. `still`:
    frames in which the performer stands like the body at rest; left out, frames all over the clip calibrate, which tells
    lengths as well but not how far a limb's markers are turned about the limb.
    `performer`: another clip of the same person with the same markers, whose lengths and places of markers hold here too.
    Raises VitruvianError when fewer than six markers are known or visible, naming those that are not.
    """
    began = time.perf_counter()
    if performer is not None:
        body = performer.motion.skeleton
    skeleton = body.skeleton if isinstance(body, Body) else body
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 3 or points.shape[1:] != (len(names), 3) or not len(points):
        raise VitruvianError(f"points: expected shape (F, {len(names)}, 3), found {points.shape}")
    notes: list[str] = []
    attachment, used, unknown = _attached(performer, names) if performer else attach(skeleton, names, places)
    if len(used) < 6:
        raise VitruvianError(
            f"markers: expected at least 6 whose place is known, found {len(used)}; unknown: {', '.join(unknown[:12])}; "
            "say where they sit with places={label: Site}"
        )
    if unknown:
        notes.append(f"not used, nobody knows where they sit: {', '.join(unknown)}")
    labels = tuple(names[i] for i in used)
    straight, crossed = uncrossed(points[:, used], sides(labels), labels)
    if performer is None:
        attachment, turned = _uncrossed_wrists(attachment, labels, places or (), straight)
        notes += turned
    clean, said = cleaned(straight, fps, labels)
    notes += [*crossed, *said]
    if np.isfinite(clean).all(axis=2).sum(axis=1).max() < 6:
        raise VitruvianError("markers: no frame shows six of them at once")
    movers = _movers(skeleton, attachment)
    few = np.arange(len(clean))[still if still is not None else slice(None)]
    if not len(few):
        raise VitruvianError(f"still: expected some of the {len(clean)} frames, found none")
    few = few[_spread_frames(clean[few], 20 if performer is None else 1)]
    if performer is None:
        skeleton, attachment, scale, pose = calibrated(
            skeleton, attachment, clean[few], movers, rest=MOVING if still is None else STANDING
        )
    else:
        scale, pose = performer.scale, aligned(skeleton, attachment, clean[few])
    solver = _Solver(skeleton, attachment, movers, fps)
    ready = time.perf_counter()
    rotation, shift = solver.through(clean, (few, *pose), progress)
    residual = np.linalg.norm(clean - _places(skeleton, attachment, rotation, shift), axis=2)
    bad = _outliers(residual)
    if bad.any():
        clean = np.where(bad[..., None], np.nan, clean)
        notes.append(f"{int(bad.sum())} points of {int(np.isfinite(residual).sum())} are far from the body: left out")
        rotation, shift = solver.through(clean, (few, *pose), None)
        residual = np.linalg.norm(clean - _places(skeleton, attachment, rotation, shift), axis=2)
    _toes_together(skeleton, rotation)
    motion = Motion(skeleton, fps, rotation, shift)
    spent = (ready - began, time.perf_counter() - ready)
    return Tracked(motion, attachment, labels, residual, scale, tuple(notes), spent)


def _attached(performer: Tracked, names: tuple[str, ...]) -> tuple[Attachment, list[int], list[str]]:
    """As `attach`, from what another clip told."""
    there = {name: k for k, name in enumerate(performer.names)}
    used = [i for i, name in enumerate(names) if name in there]
    rows = [there[names[i]] for i in used]
    a = performer.attachment
    known = Attachment(a.joint[rows], a.point[rows], a.sure[rows])
    return known, used, [name for name in names if name not in there]


def attach(
    skeleton: Skeleton, names: tuple[str, ...], places: Mapping[str, str] | None = None
) -> tuple[Attachment, list[int], list[str]]:
    """Where markers sit on the resting body, indices of those that are known, and the names of the others."""
    from vitruvian.motion.reach import spot

    index = joint_index(skeleton.names)
    own = dict(places or {})
    wrong = set(own) - set(names)
    if wrong:
        raise VitruvianError(f"places: the file has no marker {sorted(wrong)[0]!r}; it has {', '.join(names[:8])}, ...")
    used: list[int] = []
    unknown: list[str] = []
    joint: list[int] = []
    point: list[Floats] = []
    sure: list[bool] = []
    for i, name in enumerate(names):
        if name in own:
            if own[name]:
                j, p = spot(skeleton, own[name])
                used, joint, point, sure = [*used, i], [*joint, j], [*point, p], [*sure, True]
            continue
        place = place_of(name)
        found = None if place is None else _found(skeleton, index, place.site, place.joint, place.along, place.center)
        if found is None:
            unknown.append(name)
            continue
        used.append(i)
        joint.append(_led(skeleton, index, found[0]))
        point.append(found[1])
        sure.append(found[2])
    return (
        Attachment(np.array(joint, np.int32), np.array(point).reshape(-1, 3), np.array(sure, bool)),
        used,
        unknown,
    )


def _led(skeleton: Skeleton, index: dict[str, int], joint: int) -> int:
    """The joint that moves a marker on `joint`: all toes go with the second."""
    name = canonical(skeleton.names[joint]) or ""
    toe = re.fullmatch(r"([lr])_metatarsophalangeal_[1345]", name)
    return joint if toe is None else index.get(f"{toe[1]}_metatarsophalangeal_2", joint)


def _uncrossed_wrists(
    attachment: Attachment, names: tuple[str, ...], own: Iterable[str], points: Floats
) -> tuple[Attachment, list[str]]:
    """Markers at both sides of a wrist, points (F,M,3), exchanged where thumbs would point backwards: what laboratories
    call lateral is the thumb's side for some, for others what is outside while the palms look down."""
    left = np.array([points[:, a] - points[:, b] for a, b in sides(names)])
    left = np.nansum(left[..., [0, 2]], axis=0) if len(left) else np.zeros((len(points), 2))
    ahead = np.stack([-left[:, 1], np.zeros(len(left)), left[:, 0]], axis=1)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True) + 1e-12
    pairs, forward = [], []
    place = {p.site: k for k, n in enumerate(names) if n not in own and (p := place_of(n)) is not None}
    for side in "lr":
        thumb, little = place.get(f"{side}_radial_styloid"), place.get(f"{side}_ulnar_styloid")
        if thumb is not None and little is not None:
            pairs.append((thumb, little))
            across = points[:, thumb] - points[:, little]
            forward.append(np.sum(ahead * across, axis=1) / (np.linalg.norm(across, axis=1) + 1e-12))
    told = np.array(forward)
    if not np.isfinite(told).any() or np.nanmean(told) > -0.2:
        return attachment, []
    order = np.arange(len(names))
    for a, b in pairs:
        order[[a, b]] = b, a
    said = " and ".join(names[k] for k in pairs[0])
    made = Attachment(attachment.joint[order], attachment.point[order], attachment.sure[order])
    return made, [f"{said} and their like exchanged: the thumbs would point backwards"]


def _found(
    skeleton: Skeleton, index: dict[str, int], site: str, name: str, along: float, center: bool
) -> tuple[int, Floats, bool] | None:
    from vitruvian.motion.reach import spot

    if site:
        try:
            joint, point = spot(skeleton, site)
        except VitruvianError:
            return None
        return joint, point, True
    if name == "vt6":  # riders of the thorax sit on whatever vertebra the body has there
        name = next((n for n in ("vt6", "vt7", "vt5", "vt8", "vt1", "vl1", "vl5", "humanoid_root") if n in index), name)
    if name == "metatarsophalangeal_2" and name not in index:
        name = "talocrural"
    if name not in index:
        return None
    joint = index[name]
    if center:
        parent = int(skeleton.parents[joint])
        return max(parent, 0), skeleton.centers[joint], True
    below = np.flatnonzero(skeleton.parents == joint)
    if len(below):
        end = skeleton.centers[below].mean(axis=0)
    else:
        own = skeleton.site_points[skeleton.site_joints == joint]
        end = own.mean(axis=0) if len(own) else skeleton.centers[joint]
    return joint, skeleton.centers[joint] + along * (end - skeleton.centers[joint]), False


def _toes_together(skeleton: Skeleton, rotation: Floats) -> None:
    """All toes bend, in place (F,J,4), as the second does, which carries the markers of all: a shoe bends as one."""
    index = joint_index(skeleton.names)
    for side in "lr":
        toes = [index[n] for n in (f"{side}_metatarsophalangeal_{k}" for k in range(1, 6)) if n in index]
        led = index.get(f"{side}_metatarsophalangeal_2")
        if led is not None:
            rotation[:, toes] = rotation[:, led, None]


def _movers(skeleton: Skeleton, attachment: Attachment) -> Ints:
    """Joints that the markers can tell something about: root, spine and limbs with a marker at or below them."""
    index = joint_index(skeleton.names)
    wanted = {"humanoid_root", "skullbase", *VERTEBRAE, *(f"{s}_{n}" for s in "lr" for n in _MOVERS)}
    below = set()
    for j in attachment.joint:
        while j >= 0:
            below.add(int(j))
            j = skeleton.parents[j]
    return np.array(sorted({0} | {j for n, j in index.items() if n in wanted and j in below}), np.int32)


def _spread_frames(points: Floats, count: int) -> Ints:
    """Frames, spread over the clip, that show the most markers."""
    seen = np.isfinite(points).all(axis=2).sum(axis=1)
    pieces = np.array_split(np.arange(len(points)), min(count, len(points)))
    best = [int(p[np.argmax(seen[p])]) for p in pieces]
    return np.array([f for f in best if seen[f] >= 6] or [int(np.argmax(seen))], np.int32)


def calm(skeleton: Skeleton) -> Floats:
    """(J,3) how much each axis is held against what markers say, relative to a free one."""
    out = 1 + 10 * skeleton.stiffness
    for name, j in joint_index(skeleton.names).items():
        out[j] *= _SPINAL if name in _SPINE else _CALM.get(name[2:], 1.0)
    return out


class _Solver:
    """One body's markers, frame after frame."""

    def __init__(self, skeleton: Skeleton, attachment: Attachment, movers: Ints, fps: float):
        self.skeleton, self.attachment, self.fps = skeleton, attachment, fps
        self.freedom = Freedom(skeleton, movers, True)
        self.weight = NEAR * calm(skeleton)

    def pose(self, points: Floats, rotation: Floats, shift: Floats, iterations: int, near: float) -> Answer:
        frames, count = points.shape[:2]
        place = np.concatenate([points, np.zeros((frames, count, 1))], axis=2)
        a = self.attachment
        wishes = Wishes(
            np.zeros(count, np.int32), a.joint, a.point, np.zeros((count, 3)), place, np.ones((frames, count))
        )
        rest = np.array([0.0, 0.0, 0.0, 1.0])
        held = slerp(rotation, np.broadcast_to(rest, rotation.shape), 0.02)
        held[:, 0] = rotation[:, 0]
        prior = Prior(held, shift, self.weight * near)
        return solve(self.freedom, wishes, rotation, shift, prior=prior, iterations=iterations, idle=1e-5)

    def through(
        self,
        points: Floats,
        known: tuple[NDArray[np.signedinteger], Floats, Floats],
        progress: Callable[[float], None] | None,
    ) -> tuple[Floats, Floats]:
        """Rotations (F,J,4) and shifts (F,3): every COARSE seconds from the frame before, then the others between.

        `known`: frames whose poses are about known, rotations and shifts; the first of them is the start.
        """
        frames = len(points)
        seen = np.isfinite(points).all(axis=2).sum(axis=1)
        step = max(1, round(COARSE * self.fps))
        keys = [k for k in range(0, frames, step) if seen[k] >= 4]
        if frames - 1 not in keys and seen[-1] >= 4:
            keys.append(frames - 1)
        if not keys:
            keys = [int(np.argmax(seen))]
        start = int(np.argmin(np.abs(np.array(keys) - known[0][0])))
        first = self.pose(points[keys[start]][None], known[1][:1], known[2][:1], 60, 0.01)
        kept = {start: (first.rotation, first.shift)}
        for order in (range(start + 1, len(keys)), range(start - 1, -1, -1)):
            for i in order:
                before = kept[i - 1 if i > start else i + 1]
                now = self.pose(points[keys[i]][None], *before, 12, HELD)
                kept[i] = (now.rotation, now.shift)
            if progress is not None:
                progress(0.5 * len(kept) / len(keys))
        rotation = np.concatenate([kept[i][0] for i in range(len(keys))])
        shift = np.concatenate([kept[i][1] for i in range(len(keys))])
        at = np.interp(np.arange(frames), keys, np.arange(len(keys)))
        low = np.minimum(np.floor(at).astype(int), max(len(keys) - 2, 0))
        high = np.minimum(low + 1, len(keys) - 1)
        share = (at - low)[:, None]
        between = slerp(rotation[low], rotation[high], np.broadcast_to(share, rotation[low].shape[:2]))
        between[:, self.freedom.limited] = within(self.skeleton, between)[:, self.freedom.limited]
        answer = self.pose(points, between, shift[low] * (1 - share) + shift[high] * share, 8, HELD)
        if progress is not None:
            progress(1.0)
        return answer.rotation, answer.shift


def aligned(skeleton: Skeleton, attachment: Attachment, points: Floats) -> tuple[Floats, Floats]:
    """The resting body (F,J,4), (F,3) put where the markers (F,M,3) are, by those of trunk and head where they suffice."""
    part = groups(skeleton)
    trunk = np.array([part[j] in ("pelvis", "spine", "neck", "clavicle") for j in attachment.joint]) & attachment.sure
    rotation = np.tile([0.0, 0.0, 0.0, 1.0], (len(points), len(skeleton), 1))
    shift = np.zeros((len(points), 3))
    for f, frame in enumerate(points):
        known = np.isfinite(frame).all(axis=1)
        some = known & trunk if (known & trunk).sum() >= 3 else known
        here, there = attachment.point[some], frame[some]
        a, b = here - here.mean(axis=0), there - there.mean(axis=0)
        u, _, vt = np.linalg.svd(a.T @ b)
        turn = (u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt).T
        rotation[f, 0] = from_matrix(turn)
        c = skeleton.centers[0]
        shift[f] = there.mean(axis=0) - turn @ (here.mean(axis=0) - c) - c
    return rotation, shift


def _places(skeleton: Skeleton, attachment: Attachment, rotation: Floats, shift: Floats) -> Floats:
    """(F,M,3) where the markers of a pose are, metres."""
    out = np.empty((len(rotation), len(attachment.joint), 3))
    single = replace(skeleton, binding=None)
    for first in range(0, len(out), 512):
        some = slice(first, first + 512)
        mats = pose_matrices(single, rotation[some], skeleton.translation[None], root=shift[some])
        own = mats[:, attachment.joint]
        out[some] = np.einsum("fmij,mj->fmi", own[..., :3, :3], attachment.point) + own[..., :3, 3]
    return out


def _outliers(residual: Floats) -> NDArray[np.bool_]:
    """(F,M) those that miss by more than 3 robust deviations of their marker and by more than 4 cm."""
    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # markers that are never seen
        middle = np.nanmedian(np.where(np.isfinite(residual), residual, np.nan), axis=0)
        spread = 1.4826 * np.nanmedian(np.abs(residual - middle), axis=0)
        return np.asarray(residual > np.maximum(middle + 3 * spread, 0.04))
