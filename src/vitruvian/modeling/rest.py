"""From an A or T pose to the rest pose of the standard: forearms, hands and fingers along -Y, palms to the thighs,
thumbs 45 degrees forward, legs straight down, toes forward, every joint rotation zero.

Serves the built-in person and, by `vitruvian.modeling.standing`, any body; joints that it lacks turn with their parents.

The upper arms are tilted outward just as far as the hands need to clear the thighs (arms that hang exactly along -Y
from these shoulders would stand inside the hips). Whoever lifts an arm lifts the shoulder with it (Inman et al. 1944):
where the pose is known to have raised the shoulder girdle, it comes down too.

Method: each bone's present direction is turned onto its direction at rest by the smallest rotation, the twist of the
arm is shared so that the elbow bends forward and the palm faces the thigh, and the surface follows by dual
quaternions. The attachment is then taken in the new pose (H-Anim "Modelisation"; seed 003, section 3.2).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from vitruvian.body import rotations as rot
from vitruvian.body.types import Floats, Ints, Weights

DOWN = np.array([0.0, -1.0, 0.0])
THUMB = np.array([0.0, -np.sqrt(0.5), np.sqrt(0.5)])
GIRDLE = ("sternoclavicular", "acromioclavicular")
MOST_TILT = 0.42  # sine of the largest tilt of an upper arm
BENT = 0.2  # radians that the last two joints of a thumb at ease may be bent
FORWARD = np.array([0.0, 0.0, 1.0])


def _unit(v: Floats) -> Floats:
    return v / max(float(np.linalg.norm(v)), 1e-12)


def cross(a: Floats, b: Floats) -> Floats:
    """(n,3) cross products of rows; NumPy's own is several times slower."""
    x, y, z = a.T
    u, v, w = b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)


def _turned(q: Floats, v: Floats) -> Floats:
    """One direction turned by one unit quaternion."""
    x, y, z, w = q.tolist()
    a, b, c = v.tolist()
    d, e, f = y * c - z * b + w * a, z * a - x * c + w * b, x * b - y * a + w * c
    return np.array([a + 2 * (y * f - z * e), b + 2 * (z * d - x * f), c + 2 * (x * e - y * d)])


def _between(a: Floats, b: Floats) -> Floats:
    """The smallest turn of one unit direction onto another, as `rotations.between`."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    real = 1 + x * u + y * v + z * w
    return rot.between(a, b) if real < 1e-6 else _unit(np.array([y * w - z * v, z * u - x * w, x * v - y * u, real]))


def _about_y(angle: float) -> Floats:
    return np.array([0.0, np.sin(angle / 2), 0.0, np.cos(angle / 2)])


def _twist_to(direction: Floats, wanted: Floats) -> float:
    """Angle about Y that turns the horizontal part of `direction` onto that of `wanted`; 0 where there is none."""
    if np.hypot(direction[0], direction[2]) < 0.05:
        return 0.0
    angle = np.arctan2(direction[0], direction[2]) - np.arctan2(wanted[0], wanted[2])
    return float(-((angle + np.pi) % (2 * np.pi) - np.pi))


def rest_turns(
    names: tuple[str, ...],
    parents: Ints,
    centers: Floats,
    tips: dict[str, Floats],
    hip_width: float,
    start: Floats | None = None,
    raised: tuple[float, float] = (0.0, 0.0),
) -> Floats:
    """(J,4) world rotation of every joint that brings an A or T pose to rest; `names` are 2.0 names, parents first.

    `tips` gives the far end of the last phalanges, by joint name; `hip_width` (m) is how far from the middle plane the
    hands must hang to clear the hips. `start` (4,) turns the whole body first (None: not at all). `raised`: radians by
    which the pose has lifted the sternoclavicular and the acromioclavicular joints.
    """
    index = {n: i for i, n in enumerate(names)}
    first = rot.IDENTITY if start is None else start
    turn = np.tile(first, (len(names), 1))
    drawn: dict[str, float] = {}  # metres by which a shoulder has come nearer to the middle
    for i, name in enumerate(names):
        if parents[i] >= 0:
            turn[i] = turn[parents[i]]
        side, _, part = name.partition("_")
        if side not in ("l", "r"):
            continue

        def along(other: str, i: int = i, side: str = side, unit: bool = True) -> Floats | None:
            if other not in tips and f"{side}_{other}" not in index:
                return None
            end = tips[other] if other in tips else centers[index[f"{side}_{other}"]]
            if np.linalg.norm(end - centers[i]) < 1e-9:
                return None
            return _unit(end - centers[i]) if unit else end - centers[i]

        def swing(direction: Floats | None, wanted: Floats, i: int = i, spare: float = 0.0) -> None:
            if direction is not None:
                by = _between(_turned(turn[i], direction), wanted)
                if spare:  # all but that angle
                    angle = 2 * float(np.arctan2(np.linalg.norm(by[:3]), by[3]))
                    by = rot.slerp(rot.IDENTITY, by, max(angle - spare, 0.0) / max(angle, 1e-9))
                turn[i] = rot.multiply(by, turn[i])

        if part in GIRDLE:
            angle = raised[GIRDLE.index(part)] * (-1 if side == "l" else 1)
            turn[i] = rot.multiply(np.array([0.0, 0.0, np.sin(angle / 2), np.cos(angle / 2)]), turn[i])
            after = along("acromioclavicular" if part == GIRDLE[0] else "shoulder", unit=False)
            if after is not None:  # a shoulder that comes down comes nearer to the middle
                moved = rot.rotate(turn[i], after) - rot.rotate(first, after)
                drawn[side] = drawn.get(side, 0.0) - float(moved[0]) * (1 if side == "l" else -1)
        elif part == "shoulder" and f"{side}_elbow" in index:
            length = max(float(np.linalg.norm(centers[index[f"{side}_elbow"]] - centers[i])), 1e-9)
            mate = index.get(("r_" if side == "l" else "l_") + part)
            across = 2 * centers[i] if mate is None else centers[i] - centers[mate]
            half = abs(float(rot.rotate(first, across)[0])) / 2 - drawn.get(side, 0.0)
            tilt = np.arcsin(np.clip((hip_width - half) / length, 0.0, MOST_TILT))
            outward = np.sin(tilt) * (1 if side == "l" else -1)
            swing(along("elbow"), np.array([outward, -np.cos(tilt), 0.0]))
            if f"{side}_radiocarpal" in index:
                forearm = _unit(centers[index[f"{side}_radiocarpal"]] - centers[index[f"{side}_elbow"]])
                bent = rot.rotate(turn[i], forearm)
                twist = float(np.clip(_twist_to(bent, FORWARD), -1.0, 1.0))
                sure = float(
                    np.clip((np.hypot(bent[0], bent[2]) - 0.25) / 0.2, 0.0, 1.0)
                )  # a straight arm tells nothing
                turn[i] = rot.multiply(_about_y(twist * sure), turn[i])
        elif part == "elbow":
            swing(along("radiocarpal"), DOWN)
            turn[i] = rot.multiply(_about_y(0.7 * _palm(side, centers, index, turn[i])), turn[i])
        elif part == "radiocarpal":
            swing(along("metacarpophalangeal_3"), DOWN)
            turn[i] = rot.multiply(_about_y(_palm(side, centers, index, turn[i])), turn[i])
        elif part in ("hip", "knee"):
            swing(along("knee" if part == "hip" else "talocrural"), DOWN)
        elif part == "talocrural":
            foot = along("metatarsophalangeal_2")
            if foot is not None:  # the foot keeps its slope: soles are flat in any stance
                now = rot.rotate(first, foot)
                turn[i] = rot.multiply(_about_y(-float(np.arctan2(now[0], now[2]))), first)
        elif part.endswith("_1") and part.split("_")[0] in ("carpometacarpal", "metacarpophalangeal", "carpal"):
            nexts = {"carpometacarpal_1": "metacarpophalangeal_1", "metacarpophalangeal_1": "carpal_interphalangeal_1"}
            swing(along(nexts.get(part, name)), THUMB, spare=0.0 if part == "carpometacarpal_1" else BENT)
        elif part.startswith(("metacarpophalangeal", "carpal_")):
            ray = part[-1]
            order = ["metacarpophalangeal", "carpal_proximal_interphalangeal", "carpal_distal_interphalangeal"]
            at = order.index(part[:-2])
            swing(along(f"{order[at + 1]}_{ray}" if at < 2 else name), DOWN)
    return turn


def _palm(side: str, centers: Floats, index: dict[str, int], turn: Floats) -> float:
    """Twist about Y that makes the palm face the thigh; 0 without knuckles."""
    if any(f"{side}_metacarpophalangeal_{n}" not in index or f"{side}_radiocarpal" not in index for n in (2, 5)):
        return 0.0
    wrist = centers[index[f"{side}_radiocarpal"]]
    first, last = (centers[index[f"{side}_metacarpophalangeal_{n}"]] - wrist for n in (2, 5))
    normal = _unit(np.cross(first, last)) * (1 if side == "r" else -1)  # out of the palm
    inward = np.array([1.0 if side == "r" else -1.0, 0.0, 0.0])
    return _twist_to(rot.rotate(turn, normal), inward)


def rest_matrices(parents: Ints, centers: Floats, turns: Floats) -> Floats:
    """(J,4,4) humanoid-space matrices that take the A pose to rest."""
    matrices = np.tile(np.eye(4), (len(centers), 1, 1))
    matrices[:, :3, :3] = rot.to_matrix(turns)
    for i, parent in enumerate(parents):
        c = centers[i]
        at = c if parent < 0 else matrices[parent, :3, :3] @ c + matrices[parent, :3, 3]
        matrices[i, :3, 3] = at - matrices[i, :3, :3] @ c
    return matrices


def at_rest(centers: Floats, points: Floats, weights: Weights, matrices: Floats) -> tuple[Floats, Floats]:
    """Points (n,3) and joint centres (J,3) after `matrices`, the points moved by blended dual quaternions.

    Method: L. Kavan et al., Geometric skinning with approximate dual quaternion blending, 2008. The turns from the
    A pose stay below a half turn, so that all quaternions can be taken on the root's side.
    """
    real = rot.from_matrix(matrices[:, :3, :3])
    real = real * np.where(real[:, 3:] < 0, -1.0, 1.0)
    move = np.concatenate([matrices[:, :3, 3], np.zeros((len(matrices), 1))], axis=1)
    dual = 0.5 * rot.multiply(move, real)
    blend = csr_matrix((weights.weight, weights.joint, weights.row), (len(points), len(matrices)))
    mixed = blend @ np.concatenate([real, dual], axis=1)
    mixed /= np.sqrt(np.einsum("ij,ij->i", mixed[:, :4], mixed[:, :4]))[:, None]
    v, w, d = mixed[:, :3], mixed[:, 3:4], mixed[:, 4:]
    turned = points + 2 * cross(v, cross(v, points) + w * points)
    shift = 2 * (w * d[:, :3] - d[:, 3:] * v + cross(v, d[:, :3]))
    moved_centers = np.einsum("jab,jb->ja", matrices[:, :3, :3], centers) + matrices[:, :3, 3]
    return turned + shift, moved_centers


def hip_reach(points: Floats, weights: Weights, index: dict[str, int], centers: Floats, matrices: Floats) -> float:
    """How far (m) the left thigh and hip reach from the middle plane at the height of the hands at rest; 0 unknown.

    points (n,3) and centers (J,3) before `matrices` (J,4,4); `index` joint name -> number. Clothes count.
    """
    if "l_hip" not in index or "l_radiocarpal" not in index:
        return 0.0
    hip, wrist = index["l_hip"], index["l_radiocarpal"]
    share = np.zeros(len(weights))
    near = np.isin(weights.joint, [index[n] for n in ("l_hip", "sacroiliac", "humanoid_root") if n in index])
    np.add.at(share, weights.vertex[near], weights.weight[near])
    chosen = points[share > 0.8]
    chosen = chosen @ matrices[hip, :3, :3].T + matrices[hip, :3, 3]
    high = matrices[wrist, 1, :3] @ centers[wrist] + matrices[wrist, 1, 3]
    tip = index.get("l_carpal_distal_interphalangeal_3")
    if tip is None:
        elbow = index.get("l_elbow", wrist)
        low = high - 0.6 * float(np.linalg.norm(centers[wrist] - centers[elbow]))
    else:
        low = matrices[tip, 1, :3] @ centers[tip] + matrices[tip, 1, 3]
    level = (chosen[:, 1] > low - 0.03) & (chosen[:, 1] < high + 0.03)
    sides = [index[n] for n in ("l_hip", "r_hip") if n in index]
    middle = float(np.mean([matrices[j, 0, :3] @ centers[j] + matrices[j, 0, 3] for j in sides])) if sides[1:] else 0.0
    return float(chosen[level, 0].max()) - middle if level.any() else 0.0
