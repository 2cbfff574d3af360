"""Surfaces organised in contours, and the share that each contour takes of each joint's rotation.

Source: cross-section deformation of H-Anim bodies (DefBody): a surface is NbContours loops of NbPoints points each, from
top to bottom; the rotation of a joint is dispatched over the contours on both sides of it, half of it at the seam.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vitruvian.body.types import Floats, Ints, floats, indices, require
from vitruvian.errors import VitruvianError, warn
from vitruvian.hanim.defbody import corners, halved
from vitruvian.hanim.humanoid import RAMPS


@dataclass(frozen=True, eq=False)
class Contours:
    """One surface of a body, organised in contours.

    vertices (C,P) int32: the points of each contour, numbers of vertices of the skin. `joint`: the joint that the
    surface hangs on.
    joints (n,): the joints that turn its contours, root to tip; what lies above the first moves all of it.
    swing (C,n): the share, 0..1, that each contour takes of each joint's rotation. twist (C,n): its share of the part
    of that rotation about `axes` (n,3), the rest then being `swing`; NaN: the rotation is not split.
    diversion (C,), 0..1: how much of the way that a contour's centre goes besides the rigid surface is taken back.
    mitre (C,), 0..1: how much of the thickness that a bend takes away is given back. recentre (C,), 0..1: how far the
    contour's centre is brought back, in the contour's plane, to where it is as far from its bone as at rest. bulge (C,):
    how much wider (0.3: a third) the contour gets where `muscle` (an index into `joints`) is fully bent; -1: none.
    middle, normal (C,3): centres and unit normals at rest, None: those of `vertices`.
    tied (n,2): vertices outside all contours that lie on an end of this surface, and the contour that moves them.
    wound (n,n): of a torso that skin is sewn to above: the share of the twist of each joint (columns) that this skin takes
    where it follows each (rows); None: it follows them as they are.
    """

    name: str
    joint: int
    vertices: Ints
    joints: Ints
    swing: Floats
    twist: Floats = None  # type: ignore[assignment]
    axes: Floats = None  # type: ignore[assignment]
    diversion: Floats = None  # type: ignore[assignment]
    mitre: Floats = None  # type: ignore[assignment]
    bulge: Floats = None  # type: ignore[assignment]
    muscle: int = -1
    closed: bool = True
    middle: Floats | None = None
    normal: Floats | None = None
    tied: Ints = None  # type: ignore[assignment]
    recentre: Floats = None  # type: ignore[assignment]
    wound: Floats | None = None

    def __post_init__(self) -> None:
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        title = f"contours {self.name}"
        vertices = np.asarray(self.vertices)
        require(vertices.ndim == 2 and vertices.size > 0, title, "vertices of shape (contours, points)", vertices.shape)
        put("vertices", indices(self.vertices, f"{title}: vertices", 1 << 30, None, None))
        count, n = len(self.vertices), len(self.joints)
        require(n > 0, title, "at least one joint that turns it", 0)
        put("joints", indices(self.joints, f"{title}: joints", 1 << 30, n))
        put("swing", floats(self.swing, f"{title}: swing", count, n))
        outside = (self.swing < 0) | (self.swing > 1)
        require(not outside.any(), f"{title}: swing", "shares in 0..1", self.swing[outside][:1])
        twist = np.full((count, n), np.nan) if self.twist is None else np.ascontiguousarray(self.twist, np.float64)
        require(twist.shape == (count, n), f"{title}: twist", f"shape ({count}, {n})", twist.shape)
        put("twist", twist)
        axes = np.tile([0.0, 1.0, 0.0], (n, 1)) if self.axes is None else self.axes
        put("axes", floats(axes, f"{title}: axes", n, 3))
        for field in ("diversion", "mitre", "bulge", "recentre"):
            value = getattr(self, field)
            put(field, floats(np.zeros(count) if value is None else value, f"{title}: {field}", count))
        tied = np.zeros((0, 2), np.int32) if self.tied is None else self.tied
        put("tied", indices(tied, f"{title}: tied", 1 << 30, None, 2))
        for field in ("middle", "normal"):
            if getattr(self, field) is not None:
                put(field, floats(getattr(self, field), f"{title}: {field}", count, 3))
        if self.wound is not None:
            put("wound", floats(self.wound, f"{title}: wound", n, n))
        require(-1 <= self.muscle < n, f"{title}: muscle", f"-1 to {n - 1}", self.muscle)

    def __len__(self) -> int:
        return len(self.vertices)

    @property
    def rigid(self) -> Contours:
        """The same surface, all of it following its joint: a hand whose deformation is switched off."""
        whole = np.zeros_like(self.swing)
        own = np.flatnonzero(self.joints == self.joint)
        if len(own):
            whole[:, : own[0] + 1] = 1
        nothing = np.zeros(len(self))
        unsplit = np.full_like(whole, np.nan)
        return replace(
            self,
            swing=whole,
            twist=unsplit,
            diversion=nothing,
            mitre=nothing,
            bulge=nothing,
            recentre=nothing,
            wound=None,
        )

    @property
    def settled(self) -> Contours:
        """The same torso where no skin is sewn to its top: that takes of twists what it takes of bends, for what is
        above takes the rest."""
        end = int(np.argmax(self.twist.sum(axis=1)))
        top = self.twist[end]
        part = np.where(top > 0, self.swing[end] / np.where(top > 0, top, 1), 0)
        return replace(self, twist=np.minimum(self.twist * part, 1.0), wound=None)


def steps(points: Floats) -> Floats:
    """(C,) numbers of contours (C,P,3) as ramps count them: 0, 1, 2, ..., but contours that lie closer together than
    half of what is usual on the surface, as those at a hem do, count for less in proportion."""
    way = np.diff(_along(points))
    usual = float(np.median(way)) if len(way) else 0.0
    part = np.minimum(2 * way / usual, 1.0) if usual > 0 else np.ones(len(way))
    return np.concatenate([[0.0], np.cumsum(part)])


def own_shares(
    count: int, *, fixed: int = 0, upper: int = 0, extra: int = 0, ramp: str = "linear", at: Floats | None = None
) -> Floats:
    """(C,) the share of its own joint's rotation that each contour of a surface takes.

    The first `fixed` contours (FixedUpperDef) stay with the parent; over the next `upper` (UpperDef) the share grows to
    one, from a half at the seam when nothing is fixed; contours with an index below `extra` (ExtrContour) take all.
    `at` (C,): see `steps`.
    """
    k = np.arange(count, dtype=np.float64) if at is None else at
    start = 0.0 if fixed else 0.5
    out = np.ones(count)
    if upper:
        low, high = (float(k[min(n, count - 1)]) + max(n - count + 1, 0) for n in (fixed, fixed + upper))
        along = np.clip((k - low) / (high - low), 0.0, 1.0)
        out = start + (1 - start) * _shape(along, ramp)
    out[:fixed] = 0.0
    out[:extra] = 1.0
    return out


def distal_shares(count: int, lower: int, *, ramp: str = "linear", at: Floats | None = None) -> Floats:
    """(C,) the share of a distal joint's rotation: from nothing to a half over the last `lower` contours (LowerDef)."""
    k = np.arange(count, dtype=np.float64) if at is None else at
    if not lower:
        return np.zeros(count)
    low = float(k[max(count - 1 - lower, 0)]) - max(lower - count + 1, 0)
    return 0.5 * _shape(np.clip((k - low) / (k[-1] - low), 0.0, 1.0), ramp)


def _shape(along: Floats, ramp: str) -> Floats:
    require(ramp in RAMPS, "ramp", " or ".join(map(repr, RAMPS)), repr(ramp))
    return along if ramp == "linear" else along * along * (3 - 2 * along)


def limb_parameters(own: Floats, distal: Floats | None = None, *, tolerance: float = 1e-6) -> dict[str, int]:
    """{"fixed", "upper", "lower", "extra"} of a limb whose contours have these weights (C,): the own joint's, 1 what is
    left to its parent, and the distal joint's. The inverse of `own_shares` and `distal_shares`.

    Raises VitruvianError naming the first contour that no parameters give.
    """
    own = np.asarray(own, np.float64)
    count = len(own)
    lower = 0 if distal is None else int((np.asarray(distal) > tolerance).sum())
    fixed = int(np.argmax(own > tolerance)) if (own > tolerance).any() else count
    fixed = max(fixed - 1, 0) if fixed else 0  # the ramp itself begins at nothing
    upper = int(np.argmax(own >= 1 - tolerance)) - fixed if (own >= 1 - tolerance).any() else count - fixed
    whole = bool((own >= 1 - tolerance).all())
    found = {"fixed": 0 if whole else fixed, "upper": 0 if whole else upper, "lower": lower, "extra": count * whole}
    made = own_shares(count, fixed=found["fixed"], upper=found["upper"], extra=found["extra"])
    wrong = np.abs(made - own) > tolerance
    if distal is not None:
        wrong |= np.abs(distal_shares(count, lower) - distal) > tolerance
    if wrong.any():
        k = int(np.argmax(wrong))
        raise VitruvianError(
            f"weights: expected a linear ramp of contours, found {own[k]:g} at contour {k}, where it has {made[k]:g}"
        )
    return found


def zone_lengths(points: Floats, **counts: int) -> dict[str, float]:
    """Parameters of a surface (C,P,3) as lengths along its middle (m): over so much the first contours (`fixed`,
    `upper`, `extra`) or the last ones (`lower`) reach."""
    at = _along(points)
    return {
        k: float(at[-1] - at[-1 - n]) if k == "lower" else float(at[min(n, len(at) - 1)]) for k, n in counts.items()
    }


def zone_counts(points: Floats, **lengths: float) -> dict[str, int]:
    """The inverse of `zone_lengths`: the nearest numbers of contours, so that zones keep their size when contours are
    added."""
    at = _along(points)
    nearest = lambda x: int(np.argmin(np.abs(at - x)))  # noqa: E731
    last = len(at) - 1
    return {k: last - nearest(at[-1] - x) if k == "lower" else nearest(x) for k, x in lengths.items()}


def _along(points: Floats) -> Floats:
    middle = np.asarray(points, np.float64).mean(axis=1)
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])


def taper(count: int, first: int, last: int) -> Floats:
    """(C,) 0 at the first and the last contour, smoothly 1 from `first` contours in, and `last` contours from the end."""
    k = np.arange(count, dtype=np.float64)
    near = np.clip(k / first, 0, 1) if first else np.ones(count)
    far = np.clip((count - 1 - k) / last, 0, 1) if last else np.ones(count)
    return _shape(near, "smoothstep") * _shape(far, "smoothstep")


def limb(
    name: str,
    vertices: Ints,
    joint: int,
    distal: int | None,
    *,
    fixed: int = 0,
    upper: int = 0,
    lower: int = 0,
    extra: int = 0,
    diversion: float = 0.0,
    mitre: float = 0.0,
    recentre: bool = False,
    ramp: str = "linear",
    axes: Floats | None = None,
    spread: tuple[bool, bool | None] = (False, None),
    closed: bool = True,
    at: Floats | None = None,
) -> Contours:
    """A limb's surface on `joint` with the next joint `distal`, by the parameters of DefBody.

    Zones that overlap turn with both joints, the distal one first. `axes` (2,3): the bones below the two joints; with
    `spread` the part of a joint's rotation about its bone is spread evenly over all of a surface: (own, distal). The own
    joint's over this surface, so that a turned shoulder winds the upper arm instead of its seam; the distal one's over
    this surface too (True: a turned hand winds the forearm), or over the next one (False); None: it is not split.
    `recentre`: contours keep their distances from the bone, but those of the own joint's ramp only when nothing is fixed,
    for else it begins on another part. `at` (C,): see `steps`. Raises VitruvianError for parameters out of range.
    """
    count = len(vertices)
    at = np.arange(count, dtype=np.float64) if at is None else at
    title = f"contours {name}"
    for field, value in (("FixedUpperDef", fixed), ("UpperDef", upper), ("LowerDef", lower), ("ExtrContour", extra)):
        require(0 <= value <= count, f"{title}: {field}", f"0 to {count}, the number of contours", value)
    require(0 <= diversion <= 1, f"{title}: diversion", "0 to 1", diversion)
    require(0 <= mitre <= 1, f"{title}: mitre", "0 to 1", mitre)
    if fixed + upper + lower > count:
        warn(
            f"{title}: FixedUpperDef + UpperDef + LowerDef is {fixed + upper + lower}, more than {count} contours: overlap"
        )
    own = own_shares(count, fixed=fixed, upper=upper, extra=extra, ramp=ramp, at=at)
    joints, swing = [joint], [own]
    if distal is not None:
        joints.append(distal)
        swing.append(distal_shares(count, lower, ramp=ramp, at=at))
    twist = np.full((count, len(joints)), np.nan)
    if spread[0]:
        first = float(at[min(fixed, count - 1)])
        twist[:, 0] = np.clip((at - first) / max(float(at[-1]) - first, 1e-9), 0.0, 1.0)
    if spread[1] is not None and distal is not None:
        twist[:, 1] = at / max(float(at[-1]), 1e-9) if spread[1] else 0.0
    bend = np.where(own < 1, 1.0, 0.0) if distal is None else np.where((own < 1) | (swing[1] > 0), 1.0, 0.0)
    return Contours(
        name,
        joint,
        vertices,
        np.array(joints, np.int32),
        np.stack(swing, axis=1),
        twist,
        (np.tile([0.0, 1.0, 0.0], (2, 1)) if axes is None else axes)[: len(joints)],
        diversion=diversion * taper(count, fixed + upper, lower),
        mitre=mitre * bend * np.where(np.arange(count) < fixed, 0.0, 1.0),
        closed=closed,
        recentre=np.where((own == 1) | (fixed == 0), float(recentre), 0.0),
    )


def spine_shares(
    heights: Floats,
    centers: Floats,
    *,
    extra: int = 0,
    ramp: str = "smoothstep",
    stand: bool = True,
    bottom: float | None = None,
) -> tuple[Floats, Floats]:
    """(C,n) swing and (C,n) twist shares of a torso's contours at `heights` (C,), neck first.

    `centers` (n,) heights of the spine's joints, lowest first. The zone of a joint reaches half way to its neighbours;
    its bend grows across the zone and is whole above. Its twist is spread from the torso's bottom to the start of the
    zone, so that a turn of the neck winds all of the trunk. Contours with an index below `extra` take all of it. `stand`:
    the lowest contour stays with what the torso stands on; else what is below bends with it, and zones go on there.
    `bottom`: where twists begin, None: at the lowest height. Where a surface ends below a joint's zone it has a part of
    the twist all the same, and what goes on above has to have the rest: see `Contours.wound`, or else `Contours.settled`.
    """
    low, high, step = _zones(centers)
    h = np.asarray(heights, dtype=np.float64)[:, None]
    bottom = float(h.min()) if bottom is None else bottom
    if stand:
        low = np.maximum(low, bottom)
    high = np.maximum(high, low + step / 4)
    swing = _shape(np.clip((h - low) / (high - low), 0, 1), ramp)
    reach = low - bottom
    spread = np.clip((h - bottom) / np.where(reach > 1e-9, reach, 1.0), 0, 1)
    twist = np.where(reach > 1e-9, spread, swing)
    twist[:, 0] = swing[:, 0]
    swing[:extra] = 1
    twist[:extra] = 1
    return swing, twist


def spine_wound(heights: Floats, centers: Floats, *, stand: bool = True) -> Floats | None:
    """(n,n) of a torso's contours at `heights` (C,) whose spine's joints are at `centers` (n,): see `Contours.wound`. Skin
    that follows a joint alone winds as a contour does at the end of that joint's zone, where it is bent by all of it; that
    of a joint below the torso does not wind. None where a joint has both, for it cannot do both."""
    _, high, _ = _zones(centers)
    bottom, bent = float(np.min(heights)), np.tri(len(centers))
    below = np.asarray(centers) <= bottom
    if (below & (high > np.max(heights)))[:-1].any():
        return None
    wound = spine_shares(high, centers, stand=stand, bottom=bottom)[1]
    return np.where(below[:, None], bent, np.maximum(wound, bent))


def _zones(centers: Floats) -> tuple[Floats, Floats, float]:
    """The heights (n,), (n,) between which the bends of a spine's joints grow, half way to their neighbours, and the
    joints' usual distance."""
    centers = np.asarray(centers, dtype=np.float64)
    require(len(centers) > 0 and bool((np.diff(centers) > 0).all()), "spine", "joints above one another", centers)
    middle = (centers[1:] + centers[:-1]) / 2
    step = np.diff(centers).mean() if len(centers) > 1 else 0.1
    low = np.concatenate([[centers[0] - (middle[0] - centers[0] if len(middle) else step / 2)], middle])
    high = np.concatenate([middle, [centers[-1] + (centers[-1] - middle[-1] if len(middle) else step / 2)]])
    return low, high, float(step)


def grid(numbers: Ints, closed: bool) -> Ints:
    """(T,3) triangles between neighbouring contours of points (C,P), the outside out."""
    return halved(corners(numbers, closed))


def carried_on(index: Ints, triangles: Ints, each: int, closed: bool) -> Ints:
    """(T,3) for triangles (T,3) between any points of a surface of `each` points a contour: which texture coordinates
    their corners have, where those of the faces between neighbouring points are `index` (C-1,F,4).

    A triangle has those of the face in its middle as far as that one's hang together along its contours and then across
    them; beyond, the last of them: so no triangle lies over a border of the map.
    """
    rows, columns = np.divmod(triangles.astype(np.int64), each)
    if closed:  # the shortest way round, from the first corner on
        columns = columns[:, :1] + (columns - columns[:, :1] + each // 2) % each - each // 2
    count, wide = index.shape[:2]
    wrap = (lambda c: c % each) if closed else (lambda c: c)
    middle = lambda n: (n.min(axis=1) + np.maximum(n.max(axis=1) - 1, n.min(axis=1)))[:, None] // 2  # noqa: E731
    home_row = np.minimum(middle(rows), count - 1)
    home = middle(columns) if closed else np.minimum(middle(columns), wide - 1)
    below, right = rows > home_row, columns > home
    corner = np.where(below, np.where(right, 2, 3), np.where(right, 1, 0))
    goal_row, goal = rows - below, columns - right
    row, column = np.broadcast_to(home_row, rows.shape).copy(), np.broadcast_to(home, rows.shape).copy()
    sides = {(0, 1): ((1, 0), (2, 3)), (0, -1): ((0, 1), (3, 2)), (1, 0): ((3, 0), (2, 1)), (-1, 0): ((0, 3), (1, 2))}
    for down, on in sides:
        met = sides[down, on]
        going = np.ones(rows.shape, bool)
        while True:
            ahead = down * (goal_row - row) > 0 if down else on * (goal - column) > 0
            which = np.nonzero(going & ahead)
            if not len(which[0]):
                break
            r, c = row[which], column[which]
            here, there = index[r, wrap(c)], index[r + down, wrap(c + on)]
            joined = (here[:, met[0][0]] == there[:, met[0][1]]) & (here[:, met[1][0]] == there[:, met[1][1]])
            going[which] = joined
            row[which] += down * joined
            column[which] += on * joined
    return index[row, wrap(column), corner].astype(np.int32)
