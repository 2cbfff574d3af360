"""Levels of articulation: the joints that a finer level has and a body lacks, with a share of its skin; and back.

A new joint is put where the standard's default figure has it, mapped by the similarity that takes the default bone
between its existing neighbours to this body's (spine and limbs), or by the frame of the joint it hangs on (hands, feet,
face). The skin of the joint that stood for it is shared out along the bones of the finer chain, so that nothing moves
while the new joints are at rest. Source: note hanim.md, sections 1, 2 and 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vitruvian.body.rotations import between, rotate
from vitruvian.body.types import Floats
from vitruvian.errors import VitruvianError
from vitruvian.hanim import tables
from vitruvian.hanim.convert import converted
from vitruvian.hanim.default import default_places
from vitruvian.hanim.humanoid import Humanoid, Joint, Segment, Site
from vitruvian.modeling.shares import Branch, shares
from vitruvian.motion.lowering import lowered

MIRROR = np.array([-1.0, 1.0, 1.0])
_FACE = ("eyelid_joint", "eyeball_joint", "eyebrow_joint", "temporomandibular")
# How far skin is from its bone, metres at a stature of 1.75 m: a rib is nearer to the collar bone than to its vertebra.
_THICK = {"vl": 0.12, "vt": 0.12, "vc": 0.06, "sacroiliac": 0.12, "humanoid_root": 0.12}
_THIN = 0.04
_STATURE = 1.75


def raised(humanoid: Humanoid, loa: int) -> tuple[Humanoid, list[str]]:
    """A copy with every joint of that level of articulation, and one line for each thing that could not follow.

    Existing joints keep names, centres, rotations and motion; `loa` 0..4 (at most 3 with 1.x names). New joints carry no
    rotation: posed as before, the copy moves exactly as the original. Weights of a vertex keep their sum. Left and right
    are mirror images where the body's are. Sites and Segments that belong to new joints move there. Metres, humanoid
    space. Raises VitruvianError for a level that the version lacks and for a body without humanoid_root.
    """
    version = _version(humanoid)
    wanted = tables.joints_at(loa) if loa <= 3 or version == "2.0" else ()
    if not wanted:
        raise VitruvianError(f"level of articulation {loa}: H-Anim {humanoid.version} ends at 3; convert to 2.0 first")
    figure = _Figure(humanoid)
    new = [n for n in wanted if n not in figure.joints]
    if not new:
        return figure.out, []
    for name in new:
        figure.insert(name, version)
    figure.share_skin()
    figure.move_parts(new)
    lost = []
    rigid = [j.name for j in figure.split if any(s.points is not None for g in j.segments for s in g.shapes)]
    if rigid:
        some = ", ".join(rigid[:3]) + (", ..." if len(rigid) > 3 else "")
        lost.append(
            f"Segments of {len(rigid)} joints stay in one piece ({some}): weld them to a skin to share them out"
        )
    bare = [figure.joints[n].name for n in new if n.endswith(_FACE)]
    if bare and len(humanoid.skin_coord):
        lost.append(f"no skin follows the new joints of the face ({', '.join(bare)}): nothing tells lids from cheeks")
    names = [tables.canonical(j.name) or j.name for j in figure.out.joints()]
    figure.out.loa = tables.complete_loa(names) if version == "2.0" else -1
    return figure.out, lost


def at_level(
    humanoid: Humanoid, loa: int | None = None, *, version: str | None = None
) -> tuple[Humanoid, list[str], float]:
    """The humanoid at a level of articulation 0..4 and in a version of the standard: finer, coarser or both.

    Joints that the level has and the body lacks are added (`raised`), standard joints beyond it are folded with their
    skin and motion (`vitruvian.motion.lowering.lowered`). `version` "2.0", "200x", "1.1", "1.0"; None keeps the body's,
    as `loa` None keeps its level. Answers the new humanoid, what was lost, and the largest distance in metres by which a
    vertex is off in its clips or at rest. Raises VitruvianError for levels that the version lacks.
    """
    own = _version(humanoid)
    version = version or own
    lost: list[str] = []
    if loa is not None:
        if tables.family(version) == "2.0" and own != "2.0":
            humanoid, lost = converted(humanoid, "2.0")
        elif tables.family(version) != "2.0" and loa > 3:
            raise VitruvianError(f"level of articulation {loa}: H-Anim {version} ends at 3")
        humanoid, gone = raised(humanoid, loa)
        lost += gone
    out, gone, off = lowered(humanoid, version, loa=loa)
    return out, lost + gone, off


def _ends() -> dict[str, str]:
    """Last joint of each finger -> the feature point at its end, where the default figure has it."""
    return {
        joint: s for s, joint in tables.segments().items() if "_carpal_distal_phalanx" in s and s in default_places()
    }


def _version(humanoid: Humanoid) -> str:
    """The version whose names the body uses: what most of its joints say, else its tag."""
    names = [j.name for j in humanoid.joints()]
    old = sum(tables.canonical(n) not in (None, n) for n in names)
    new = sum(tables.canonical(n) == n and tables.name_in(n, "1.0") != n for n in names)
    if old or new:
        root = "1.1" if "HumanoidRoot" in names else "1.0"
        return root if old > new else "2.0"
    return "2.0" if tables.family(humanoid.version) == "2.0" else humanoid.version


def _mate(name: str) -> str:
    """The joint on the other side; midline joints are their own."""
    return {"l_": "r_", "r_": "l_"}.get(name[:2], name[:2]) + name[2:]


@dataclass(frozen=True)
class _Frame:
    """How the default figure's surroundings of a joint lie on this body: `at + scale * turn(x - default)`."""

    at: Floats
    default: Floats
    turn: Floats
    scale: float

    def __call__(self, point: Floats) -> Floats:
        return self.at + self.scale * rotate(self.turn, point - self.default)


class _Figure:
    """A copy of a humanoid that joints are inserted into; `joints` by 2.0 name."""

    def __init__(self, humanoid: Humanoid):
        self.out = humanoid.copied()
        self.joints: dict[str, Joint] = {}
        for joint in self.out.joints():
            known = tables.canonical(joint.name)
            if known:
                self.joints.setdefault(known, joint)
        if tables.ROOT not in self.joints:
            raise VitruvianError(f"humanoid {humanoid.name!r}: expected a joint humanoid_root, found none")
        self.old = list(self.joints)
        self.parent = {id(c): j for j in self.out.joints() for c in j.joints}
        self.table = tables.joints()
        self.default = _defaults()
        self.where = {n: np.asarray(j.center, dtype=np.float64) for n, j in self.joints.items()}
        self.split: list[Joint] = []
        self.ends = _ends()
        self.tips = self._tips()

    def _tips(self) -> dict[str, Floats]:
        """Ends of fingers where Sites say them, by the last joint, whether this body has it or not."""
        points, holder = tables.feature_points(), tables.segments()
        sites = [s for j in self.out.joints() for s in [*j.sites, *(t for g in j.segments for t in g.sites)]]
        found = {_home(s, points, holder): s.center + s.translation for s in sites if s.name.endswith("_tip")}
        return {n: p for n, p in found.items() if n in self.ends}

    def above(self, name: str) -> str:
        """The nearest joint above `name` that the figure has by now."""
        at = self.table[name].parent
        while at is not None and at not in self.joints:
            at = self.table[at].parent
        return at or tables.ROOT

    def insert(self, name: str, version: str) -> None:
        """Put a joint between its neighbours."""
        center = self.place(name)
        holder = self.joints[self.above(name)]
        segment = self.table[name].segment
        joint = Joint(
            tables.name_in(name, version) or name,
            center=center,
            segments=[Segment(tables.name_in(segment, version, "segment") or segment)],
        )
        mine = [c for c in holder.joints if (known := tables.canonical(c.name)) and self._under(known, name)]
        holder.joints = [c for c in holder.joints if c not in mine] + [joint]
        joint.joints = mine
        self.parent[id(joint)] = holder
        self.parent |= {id(c): joint for c in mine}
        self.joints[name], self.where[name] = joint, center

    def _under(self, name: str, top: str) -> bool:
        at: str | None = name
        while at is not None and at != top:
            at = self.table[at].parent
        return at == top

    def place(self, name: str) -> Floats:
        """Where the new joint belongs; computed on the left and mirrored, so that both sides are alike to the bit."""
        flip = name.startswith("r_")
        own = _mate(name) if flip else name
        center = self._left(own, flip)
        return center * MIRROR if flip else center

    def _at(self, name: str, flip: bool) -> Floats:
        return self.where[_mate(name)] * MIRROR if flip else self.where[name]

    def _has(self, name: str, flip: bool) -> bool:
        return (_mate(name) if flip else name) in self.old

    def _left(self, name: str, flip: bool) -> Floats:
        target = self._target(name, flip)
        anchor = self.table[name].parent or tables.ROOT
        while not self._has(anchor, flip):
            placed = (_mate(anchor) if flip else anchor) in self.joints
            if placed and target is not None and self._target(anchor, flip) != target:
                break
            anchor = self.table[anchor].parent or tables.ROOT
        tip = self._end(name, flip)
        if target is not None:
            frame = self._bone(anchor, target, flip)
        elif tip is not None and anchor != tables.ROOT:
            frame = self._along(self._at(anchor, flip), tip[0], self.default[anchor], tip[1])
        else:
            frame = self._leaf(anchor, flip)
        center = frame(self.default[name])
        midline = name[:2] not in ("l_", "r_")
        if midline and self.where[tables.ROOT][0] == 0 and (target is None or self._at(target, flip)[0] == 0):
            center[0] = 0.0
        return center

    def _end(self, name: str, flip: bool) -> tuple[Floats, Floats] | None:
        """Where the finger that `name` belongs to ends, on this body and the default one; None when unknown."""
        ends = [n for n in self.table if n in self.ends and self._under(n, name)]
        mine = self.tips.get(_mate(ends[0]) if flip else ends[0]) if len(ends) == 1 else None
        if mine is None:
            return None
        return (mine * MIRROR if flip else mine), default_places()[self.ends[ends[0]]]

    def _target(self, name: str, flip: bool) -> str | None:
        """The existing joint that the bone through `name` leads to: the skull for the spine, else the nearest below."""
        below = [n for n in self.table if n != name and self._has(n, flip) and self._under(n, name)]
        if "skullbase" in below:
            ahead = [n for n in below if self._under("skullbase", n)]
            return ahead[0]
        return below[0] if below else None

    def _bone(self, start: str, end: str, flip: bool) -> _Frame:
        """The frame that takes the default bone from `start` to `end` to this body's."""
        return self._along(self._at(start, flip), self._at(end, flip), self.default[start], self.default[end])

    def _along(self, a: Floats, b: Floats, a0: Floats, b0: Floats) -> _Frame:
        length, length0 = np.linalg.norm(b - a), np.linalg.norm(b0 - a0)
        if length < 1e-9 or length0 < 1e-9:
            return _Frame(a, a0, between(b0 - a0, b0 - a0), self._size())
        return _Frame(a, a0, between(b0 - a0, b - a), float(length / length0))

    def _leaf(self, name: str, flip: bool) -> _Frame:
        """The frame of a joint that nothing existing hangs on (or only on other branches)."""
        at, default = self._at(name, flip), self.default[name]
        still = np.array([0.0, 0.0, 0.0, 1.0])
        if name == "skullbase":
            return _Frame(at, default, still, self._reach(name, np.array([0.0, 1.0, 0.0]), 0.1295, flip))
        ball = name[:2] + "metatarsophalangeal_2"
        target = ball if name.endswith("talocrural") and self._has(ball, flip) else self._target(name, flip)
        if target is not None and name != tables.ROOT:
            return self._bone(name, target, flip)
        above = self.table[name].parent
        while above is not None and not self._has(above, flip):
            above = self.table[above].parent
        if above is None:  # the root stands alone: from the ground up
            points = self._surface()
            if not len(points):
                return _Frame(at, default, still, self._size())
            middle = float(np.mean([c[2] for c in self.default.values()]))
            foot = np.array([at[0], points[:, 1].min(), points[:, 2].mean()])
            return _Frame(foot, np.array([0.0, 0.0, middle]), still, self._size())
        bone = self._bone(above, name, flip)
        scale = bone.scale
        if name.endswith("radiocarpal"):
            along = at - self._at(above, flip)
            scale = self._reach(name, along / max(float(np.linalg.norm(along)), 1e-12), 0.193, flip)
        turn = bone.turn if not name.endswith("metatarsophalangeal_2") else still
        return _Frame(at, default, turn, scale)

    def _size(self) -> float:
        """This body's size over the default figure's: by its surface, else by the spread of its joints."""
        points = self._surface()
        if len(points):
            return max(float(np.ptp(points[:, 1])), 1e-9) / _STATURE
        mine = np.array([self.where[n] for n in self.old])
        theirs = np.array([self.default[n] for n in self.old])
        spread = float(np.ptp(theirs[:, 1]))
        return float(np.ptp(mine[:, 1])) / spread if len(mine) > 1 and spread > 0 and np.ptp(mine[:, 1]) > 0 else 1.0

    def _surface(self) -> Floats:
        """(n,3) points of the skin, else of the Segments."""
        if len(self.out.skin_coord):
            return self.out.skin_coord
        own = [s.points for g in self.out.segments() for s in g.shapes if s.points is not None]
        return np.concatenate([np.zeros((0, 3)), *own])

    def _reach(self, name: str, along: Floats, default: float, flip: bool) -> float:
        """Scale of an end of the body: how far its own skin reaches beyond the joint, over the default figure's."""
        joint = self.joints[_mate(name) if flip else name]
        chosen = self.out.skin_coord[joint.skin_coord_index[joint.skin_coord_weight > 0.5]]
        own = [s.points for g in joint.segments for s in g.shapes if s.points is not None and s.transform is None]
        points = np.concatenate([chosen, *own])
        if len(points) < 8:
            return self._size()
        points = points * MIRROR if flip else points
        far = float(((points - self._at(name, flip)) @ along).max())
        return far / default if far > 0.3 * default * self._size() else self._size()

    def share_skin(self) -> None:
        """Share out the weights of each joint that new joints took parts of."""
        size = self._size()
        for name in self.old:
            joint = self.joints[name]
            branches = self._branches(name, size)
            if not branches:
                continue
            self.split.append(joint)
            if not len(joint.skin_coord_index):
                continue
            index, weight = joint.skin_coord_index, np.asarray(joint.skin_coord_weight, dtype=np.float64)
            parts = shares(self.out.skin_coord[index], branches)
            for owner, part in parts.items():
                kept = part > 1e-4
                target = self.joints[owner]
                target.skin_coord_index, target.skin_coord_weight = index[kept], (weight * part)[kept]
            taken = sum(np.where(p > 1e-4, weight * p, 0.0) for p in parts.values())
            left = weight - taken
            joint.skin_coord_index, joint.skin_coord_weight = index[left > 1e-14], left[left > 1e-14]

    def _branches(self, name: str, size: float) -> list[Branch]:
        """Chains of new joints below an existing one, each to the next existing joint or to its end."""
        out = []
        new = {id(j): n for n, j in self.joints.items() if n not in self.old}
        stack: list[tuple[Joint, list[str]]] = [(self.joints[name], [name])]
        while stack:
            at, path = stack.pop()
            fresh = [c for c in at.joints if id(c) in new and not new[id(c)].endswith(_FACE)]
            old = [c for c in at.joints if id(c) not in new]
            stack += [(c, [*path, new[id(c)]]) for c in fresh]
            if len(path) == 1 and not fresh:
                continue
            ends = [c.center for c in old] if len(path) > 1 or fresh else []
            if not fresh and not old:
                ends = [self._tip(path)]
            for end in ends:
                points = np.array([*(self.where[n] for n in path), end])
                out.append(Branch(tuple(path), points, size * np.array([_thickness(n) for n in path])))
        return out if any(len(b.joints) > 1 for b in out) else []

    def _tip(self, path: list[str]) -> Floats:
        """Where the last bone of a chain ends: as far on as the bone before it was long."""
        last = self.where[path[-1]]
        if path[-1] in self.tips:
            return self.tips[path[-1]]
        return last + 0.9 * (last - self.where[path[-2]])

    def move_parts(self, new: list[str]) -> None:
        """Sites of feature points, and Segments by name, to the new joint that they belong to."""
        points, holder = tables.feature_points(), tables.segments()
        fresh = set(new)
        for joint in [j for n, j in self.joints.items() if n not in fresh]:
            for k, segment in enumerate(list(joint.segments)):
                known = tables.canonical(segment.name, "segment")
                if k and known and holder[known] in fresh:
                    self.joints[holder[known]].segments = [segment]
                    joint.segments = [s for s in joint.segments if s is not segment]
            for sites in (joint.sites, *(s.sites for s in joint.segments)):
                for site in list(sites):
                    at = _home(site, points, holder)
                    if at in fresh:
                        sites.remove(site)
                        self.joints[at].segments[0].sites.append(site)


def _home(site: Site, points: dict[str, tables.FeaturePoint], holder: dict[str, str]) -> str:
    """The joint of the finest level that a Site belongs to, "" when the tables don't say."""
    known = tables.canonical(site.name, "site")
    if known in points and points[known].segment in holder:
        return holder[points[known].segment]
    segment = tables.canonical(site.name.removesuffix("_tip"), "segment") if site.name.endswith("_tip") else None
    return holder.get(segment or "", "")


def _defaults() -> dict[str, Floats]:
    """The default centres; lids and brows about the eyes and bones of the feet about the ankle from one skeleton.

    The table mixes two figures there: its lids are above the brows, its toes end behind their own tips.
    """
    out, table = dict(tables.default_centers()), tables.joints()
    for name, entry in table.items():
        feet = ("cuneo", "calcaneo", "transversetarsal", "talocalc", "tars", "metatars")
        at = "talocrural" if name[2:].startswith(feet) else "eyeball_joint" if name[2:5] == "eye" else ""
        if not at or name.startswith("r_") or name.endswith(at):
            continue
        center, around = entry.full_center, table["l_" + at].full_center
        if center is not None and around is not None:
            out[name] = out["l_" + at] + np.subtract(center, around) * (1.75 / 1.61)
            out[_mate(name)] = out[name] * MIRROR
    return out


def _thickness(name: str) -> float:
    return _THICK.get(name, _THICK.get(name[:2], _THIN))
