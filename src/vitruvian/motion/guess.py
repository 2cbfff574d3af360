"""Who is who in a rig whose names nobody knows, by how its joints hang together and where they are at rest.

Source: note motion.md, 4.1: names first, then the topology of the chains.
"""

from __future__ import annotations

import numpy as np

from vitruvian.body.types import Floats, Skeleton
from vitruvian.motion.names import NECK, SPINE

FOOT, HAND, HEAD = (
    0.12,
    0.14,
    0.045,
)  # of the figure's height: above the ankle's; less than from wrist to finger tip; skull
UPPER = 1.15  # upper arm in forearms; thighs are as long as shanks


def guessed(skeleton: Skeleton) -> dict[str, str]:
    """{joint: H-Anim joint, "spine" or "neck"} of a figure that stands with Y up, fingers apart; {} where no two legs hang
    from one joint. Which way toes point tells left from right; without toes it faces +Z."""
    tree = _Tree(skeleton)
    legs = tree.legs()
    if legs is None:
        return {}
    fork, *chains = legs
    names = skeleton.names
    limbs = [tree.limb(c, tree.ankle(c), 1.0) for c in chains]
    if any(limb is None for limb in limbs):
        return {}
    found = [limb for limb in limbs if limb is not None]
    lateral = skeleton.centers[found[0][1]] - skeleton.centers[found[1][1]]
    ahead = np.mean([tree.tip(f[2]) - skeleton.centers[f[2]] for f in found], axis=0) * [1, 0, 1]
    if np.linalg.norm(ahead) < 0.02 * tree.size:
        ahead = np.array([0.0, 0.0, 1.0])
    left = np.cross([0.0, 1.0, 0.0], ahead)
    out: dict[str, str] = {}
    base, trunk = tree.trunk(fork)
    out[names[base]] = "humanoid_root"
    if fork != base:
        out[names[fork]] = "sacroiliac"
    for (hip, knee, ankle), chain, side in zip(found, chains, "lr" if lateral @ left > 0 else "rl"):
        out |= {names[hip]: f"{side}_hip", names[knee]: f"{side}_knee", names[ankle]: f"{side}_talocrural"}
        foot = np.hypot(*(tree.tip(ankle) - tree.at[ankle])[[0, 2]])
        ball = [
            j for j in chain[chain.index(ankle) + 1 :] if np.hypot(*(tree.at[j] - tree.at[ankle])[[0, 2]]) > foot / 2
        ]
        if ball and foot > 0.02 * tree.size:
            out[names[ball[0]]] = f"{side}_metatarsophalangeal_2"
    top = len(trunk)
    arms = tree.arms(trunk, left)
    if arms is not None:
        top = arms[0] + 1
        for side, chain in zip("lr", arms[1:]):
            wrist = next((j for j in chain if tree.reach(j) < HAND * tree.size), chain[-1])
            arm = tree.limb(chain, wrist, UPPER)
            if arm is None:
                continue
            before = chain[: chain.index(arm[0])]
            if before:
                out[names[before[-1]]] = f"{side}_sternoclavicular"
            out |= {names[j]: f"{side}_{n}" for j, n in zip(arm, ("shoulder", "elbow", "radiocarpal"))}
    upper = trunk[top:]
    head = tree.head(upper)
    out |= {names[j]: SPINE for j in trunk[:top]}
    if head is not None:
        out |= {names[j]: NECK for j in upper[: upper.index(head)]}
        out[names[head]] = "skullbase"
    return out


class _Tree:
    """A skeleton's joints with what hangs below each."""

    def __init__(self, skeleton: Skeleton):
        self.at, self.parents = skeleton.centers, skeleton.parents
        count = len(self.at)
        self.children: list[list[int]] = [[] for _ in range(count)]
        self.ends: list[list[Floats]] = [[p] for p in self.at]  # the joint and what is fixed to it
        for j, p in enumerate(self.parents):
            if p >= 0:
                self.children[p].append(j)
        for j, site in zip(skeleton.site_joints, skeleton.site_points):
            self.ends[j].append(site)
        heights = np.concatenate([np.array(e)[:, 1] for e in self.ends])
        self.floor, self.size = float(heights.min()), max(float(np.ptp(heights)), 1e-9)
        self.low = np.array([np.array(e)[:, 1].min() for e in self.ends])
        self.high = np.array([np.array(e)[:, 1].max() for e in self.ends])
        self.long = np.array([np.linalg.norm(np.array(e) - e[0], axis=1).max() for e in self.ends])
        for j in range(count - 1, 0, -1):
            p = self.parents[j]
            if p >= 0:
                self.low[p], self.high[p] = min(self.low[p], self.low[j]), max(self.high[p], self.high[j])
                self.long[p] = max(self.long[p], self.long[j] + self.apart(j, p))

    def apart(self, a: int, b: int) -> float:
        return float(np.linalg.norm(self.at[a] - self.at[b]))

    def reach(self, joint: int) -> float:
        """The longest way from a joint along bones to where they end."""
        return float(self.long[joint])

    def path(self, joint: int) -> list[int]:
        out = [joint]
        while self.parents[out[-1]] >= 0:
            out.append(int(self.parents[out[-1]]))
        return out[::-1]

    def chain(self, joint: int, least: Floats) -> list[int]:
        """From a joint down, each time to the child with the least value, while that is the value of all below."""
        out = [joint]
        while self.children[out[-1]]:
            best = min(self.children[out[-1]], key=lambda c: least[c])
            if least[best] > least[out[-1]] + 1e-12:
                break
            out.append(best)
        return out

    def longest(self, joint: int) -> list[int]:
        """From a joint down the longest way."""
        out = [joint]
        while self.children[out[-1]]:
            out.append(max(self.children[out[-1]], key=lambda c: self.long[c] + self.apart(c, out[-1])))
        return out

    def legs(self) -> tuple[int, list[int], list[int]] | None:
        """The joint that two legs hang from, and the joints of each from the top to the lowest point."""
        for fork in range(len(self.at) - 1, -1, -1):
            down = [c for c in self.children[fork] if self.low[c] < self.floor + 0.1 * self.size]
            if len(down) > 1 and self.at[fork][1] > self.floor + 0.3 * self.size:
                down = sorted(down, key=lambda c: self.low[c])[:2]
                return fork, self.chain(down[0], self.low), self.chain(down[1], self.low)
        return None

    def ankle(self, chain: list[int]) -> int:
        low = [j for j in chain if self.at[j][1] < self.floor + FOOT * self.size]
        return low[0] if low else chain[-1]

    def tip(self, joint: int) -> Floats:
        """The point at or below a joint that is farthest from it on the floor."""
        stack, best = [joint], self.at[joint]
        while stack:
            j = stack.pop()
            stack += self.children[j]
            best = max([best, *self.ends[j]], key=lambda p: np.hypot(*(p - self.at[joint])[[0, 2]]))
        return best

    def limb(self, chain: list[int], end: int, ratio: float) -> tuple[int, int, int] | None:
        """Hip, knee, ankle or shoulder, elbow, wrist: the joints above `end` whose bones are in the ratio of a body's."""
        above = chain[: chain.index(end)]
        best, least = None, np.inf
        for k, middle in enumerate(above):
            for start in above[:k]:
                upper, lower = self.apart(start, middle), self.apart(middle, end)
                bent = self.way(chain, start, middle) - upper + self.way(chain, middle, end) - lower
                off = abs(upper - ratio * lower) + bent - 0.15 * (upper + lower)  # long bones rather than pieces
                if min(upper, lower) > 0.04 * self.size and off < least + 1e-9:
                    best, least = (start, middle, end), off
        return best

    def way(self, chain: list[int], start: int, end: int) -> float:
        """The length of the chain between two of its joints."""
        part = self.at[chain[chain.index(start) : chain.index(end) + 1]]
        return float(np.linalg.norm(np.diff(part, axis=0), axis=1).sum())

    def head(self, upper: list[int]) -> int | None:
        """Which of the joints above the arms is the skull's: a joint at its top that carries nothing is not."""
        if not upper:
            return None
        face = [j for j in upper if len(self.children[j]) > 1]  # eyes, a jaw
        if face:
            return face[0]
        last = upper[-1]
        if self.reach(last) == 0 and (len(upper) == 1 or self.apart(*upper[-2:]) < 2 * HEAD * self.size):
            return last
        return next((j for j in reversed(upper) if self.reach(j) >= HEAD * self.size), last)

    def trunk(self, fork: int) -> tuple[int, list[int]]:
        """The joint that legs and head have in common, and those from there up to the highest point."""
        up = self.chain(0, -self.high)
        shared = [j for j in self.path(fork) if j in up]
        base = shared[-1] if shared else 0
        return base, up[up.index(base) + 1 :]

    def arms(self, trunk: list[int], left: Floats) -> tuple[int, list[int], list[int]] | None:
        """Where in the trunk two arms branch off, and the left and the right arm's joints."""
        for k, joint in reversed(list(enumerate(trunk))):
            sides: list[list[int]] = [[], []]
            for child in self.children[joint]:
                chain = self.longest(child)
                if child in trunk or self.reach(child) < 0.25 * self.size:
                    continue
                where = np.mean([self.tip(chain[-1]), self.at[chain[-1]]], axis=0) - self.at[joint]
                sides[0 if where @ left > 0 else 1] = chain
            if all(sides):
                return k, sides[0], sides[1]
        return None
