"""From the source rig to H-Anim at LOA 4: where the joints are and which joint each weight goes to."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.sparse import coo_matrix, diags

from body_source import Source

SIDES = (("l_", ".L"), ("r_", ".R"))
# The chain of the spine: source bone whose head is the joint's centre. The joints between are interpolated.
SPINE = {
    "vl5": "spine05",
    "vl3": "spine04",
    "vl1": "spine03",
    "vt10": "spine02",
    "vt6": "spine01",
    "vt1": "neck01",
    "vc4": "neck02",
    "vc2": "neck03",
    "skullbase": "head",
}
LIMBS = {
    "hip": ["upperleg01", "upperleg02"],
    "knee": ["lowerleg01", "lowerleg02"],
    "talocrural": ["foot"],
    "sternoclavicular": ["clavicle"],
    "acromioclavicular": ["shoulder01"],
    "shoulder": ["upperarm01", "upperarm02"],
    "elbow": ["lowerarm01", "lowerarm02"],
    "radiocarpal": ["wrist"],
    "eyeball_joint": ["eye"],
    "eyelid_joint": ["orbicularis03"],
    "eyebrow_joint": ["oculi01", "oculi02"],
    "carpometacarpal_1": ["finger1-1"],
    "metacarpophalangeal_1": ["finger1-2"],
    "carpal_interphalangeal_1": ["finger1-3"],
    "metatarsophalangeal_1": ["toe1-1"],
    "tarsal_interphalangeal_1": ["toe1-2"],
}
for ray in (2, 3, 4, 5):
    LIMBS[f"carpometacarpal_{ray}"] = [f"metacarpal{ray - 1}"]
    LIMBS[f"metacarpophalangeal_{ray}"] = [f"finger{ray}-1"]
    LIMBS[f"carpal_proximal_interphalangeal_{ray}"] = [f"finger{ray}-2"]
    LIMBS[f"carpal_distal_interphalangeal_{ray}"] = [f"finger{ray}-3"]
    LIMBS[f"metatarsophalangeal_{ray}"] = [f"toe{ray}-1"]
    LIMBS[f"tarsal_proximal_interphalangeal_{ray}"] = [f"toe{ray}-2"]
    LIMBS[f"tarsal_distal_interphalangeal_{ray}"] = [f"toe{ray}-3"]
# Joints without a bone: (from, to, share of the way), both joints with a bone. The foot's small joints lie between the
# ankle and the balls of the toes, the wrist's between the wrist and the knuckles' roots.
BETWEEN = {
    "talocalcaneonavicular": ("talocrural", "metatarsophalangeal_2", 0.18),
    "cuneonavicular_1": ("talocrural", "metatarsophalangeal_1", 0.32),
    "cuneonavicular_2": ("talocrural", "metatarsophalangeal_2", 0.32),
    "cuneonavicular_3": ("talocrural", "metatarsophalangeal_3", 0.32),
    "calcaneocuboid": ("talocrural", "metatarsophalangeal_4", 0.25),
    "transversetarsal": ("talocrural", "metatarsophalangeal_4", 0.38),
    "midcarpal_1": ("radiocarpal", "carpometacarpal_1", 0.5),
    "midcarpal_2": ("radiocarpal", "carpometacarpal_2", 0.5),
    "midcarpal_3": ("radiocarpal", "carpometacarpal_3", 0.5),
    "midcarpal_4_5": ("radiocarpal", "carpometacarpal_4", 0.5),
    **{f"tarsometatarsal_{n}": ("talocrural", f"metatarsophalangeal_{n}", 0.48) for n in (1, 2, 3, 4, 5)},
}


def bone_joints(source: Source) -> dict[str, str]:
    """Bone -> H-Anim joint that its weights go to; bones of the face and breast go to the next mapped ancestor."""
    direct = {"root": "humanoid_root", "pelvis.L": "sacroiliac", "pelvis.R": "sacroiliac", "jaw": "temporomandibular"}
    direct |= {bone: joint for joint, bone in SPINE.items()}
    direct |= {b + dot: side + joint for side, dot in SIDES for joint, bones in LIMBS.items() for b in bones}
    direct |= {f"breast{dot}": "vt6" for _, dot in SIDES}
    out = {}
    for bone in source.bones:
        at = bone
        while at not in direct:
            at = source.rig[at]["parent"]
        out[bone] = direct[at]
    return out


def centre_matrix(source: Source, joints: list[dict]) -> np.ndarray:
    """(146, 2 bones): the centre of every joint as a linear combination of bone heads and tails."""
    index = {j["name"]: i for i, j in enumerate(joints)}
    head = {bone: i for i, bone in enumerate(source.bones)}
    matrix = np.zeros((len(joints), 2 * len(source.bones)))

    def put(joint: str, **parts: float) -> None:
        for bone, share in parts.items():
            matrix[index[joint], head[bone]] += share

    put("humanoid_root", root=1)
    put("temporomandibular", jaw=1)
    # midway between the lumbosacral joint and the middle of the hips
    put("sacroiliac", spine05=0.5, **{"upperleg01.L": 0.25, "upperleg01.R": 0.25})
    for side, dot in SIDES:
        for joint, bones in LIMBS.items():
            put(side + joint, **{bones[0] + dot: 1})
        for joint, (a, b, share) in BETWEEN.items():
            matrix[index[side + joint]] = (1 - share) * matrix[index[side + a]] + share * matrix[index[side + b]]
    known = list(SPINE)
    for joint, bone in SPINE.items():
        put(joint, **{bone: 1})
    chain = spine_chain(joints)
    height = {j["name"]: j["default_center"][1] for j in joints if j["default_center"]}
    stations = np.array([height[j] for j in known])
    blend = CubicSpline(stations, np.eye(len(known)), bc_type="natural")
    for joint in chain:
        if joint not in SPINE:
            shares = blend(height[joint])
            matrix[index[joint]] = sum(s * matrix[index[k]] for s, k in zip(shares, known, strict=True))
    return matrix


def spine_chain(joints: list[dict]) -> list[str]:
    """vl5 ... vc1, skullbase."""
    parent = {j["name"]: j["parent"] for j in joints}
    chain = ["skullbase"]
    while chain[-1] != "vl5":
        chain.append(parent[chain[-1]])
    return chain[::-1]


def weights(
    source: Source, joints: list[dict], centres: np.ndarray, points: np.ndarray, triangles: np.ndarray
) -> np.ndarray:
    """(19158, 146) dense: the source's weights carried to H-Anim joints, rows sum to 1 where the source has any."""
    index = {j["name"]: i for i, j in enumerate(joints)}
    table = source.json("rigs/standard/weights.default.json")["weights"]
    out = np.zeros((len(points), len(joints)))
    for bone, joint in bone_joints(source).items():
        pairs = np.array(table.get(bone) or np.zeros((0, 2)))
        out[pairs[:, 0].astype(int), index[joint]] += pairs[:, 1]
    sums = out.sum(axis=1, keepdims=True)
    out = np.divide(out, sums, out=np.zeros_like(out), where=sums > 0)
    _spread_spine(out, points, centres, joints, index)
    _spread_feet(out, points, centres, index)
    _smooth_thumbs(out, triangles, index)
    return out


def _smooth_thumbs(out: np.ndarray, triangles: np.ndarray, index: dict, reach: int = 6, rounds: int = 16) -> None:
    """Blur the weights where a thumb meets its hand: the source's web folds over itself once the thumb points forward."""
    edges = np.unique(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    near = coo_matrix(
        (np.ones(2 * len(edges)), (edges.ravel(), edges[:, ::-1].ravel())), shape=(len(out), len(out))
    ).tocsr()
    near = diags(1 / np.maximum(np.asarray(near.sum(axis=1)).ravel(), 1)) @ near
    base = [index[side + joint] for side, _ in SIDES for joint in ("carpometacarpal_1", "metacarpophalangeal_1")]
    tips = [index[side + "carpal_interphalangeal_1"] for side, _ in SIDES]
    some = out[:, base].sum(axis=1) > 0.02
    for _ in range(reach):
        some |= near @ some > 0
    amount = some.astype(float)
    for _ in range(4):
        amount = (amount + near @ amount) / 2
    amount *= np.clip(1 - out[:, tips].sum(axis=1), 0, 1)
    amount[np.diff(near.indptr) == 0] = 0
    rows = np.flatnonzero(amount)
    for _ in range(rounds):
        out[rows] += 0.5 * amount[rows, None] * (near[rows] @ out - out[rows])
    out[rows] *= out[rows] > 0.004
    out[rows] /= out[rows].sum(axis=1, keepdims=True)


def _hats(s: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """(n, k) hat functions on ascending nodes, constant beyond the ends: a partition of unity."""
    k = len(nodes)
    if k == 1:
        return np.ones((len(s), 1))
    return np.stack([np.interp(s, nodes, np.eye(k)[i]) for i in range(k)], axis=1)


def _spread_spine(out: np.ndarray, points: np.ndarray, centres: np.ndarray, joints: list[dict], index: dict) -> None:
    """Give each vertebra its share of the bone it was part of, by height along the spine."""
    chain = spine_chain(joints)
    known = list(SPINE)
    for lower, upper in zip(known, known[1:], strict=False):
        names = chain[chain.index(lower) : chain.index(upper)]
        heights = np.array([centres[index[n], 1] for n in [*names, upper]])
        middles = (heights[:-1] + heights[1:]) / 2  # a vertebra reaches from its own joint to the next one
        shares = _hats(points[:, 1], middles) * out[:, [index[lower]]]
        out[:, index[lower]] = 0
        for k, name in enumerate(names):
            out[:, index[name]] += shares[:, k]


def _spread_feet(out: np.ndarray, points: np.ndarray, centres: np.ndarray, index: dict) -> None:
    """Share the foot's weights between ankle and the five metatarsals, by position along and across the foot."""
    for side, _ in SIDES:
        ankle = centres[index[side + "talocrural"]]
        balls = np.array([centres[index[f"{side}metatarsophalangeal_{n}"]] for n in (1, 2, 3, 4, 5)])
        along = (points[:, 2] - ankle[2]) / (balls[1, 2] - ankle[2])
        forward = np.interp(along, [0.3, 0.75], [0, 1])
        order = np.argsort(balls[:, 0])
        rays = _hats(points[:, 0], balls[order, 0])
        share = out[:, index[side + "talocrural"]] * forward
        out[:, index[side + "talocrural"]] -= share
        for k, n in enumerate(order):
            out[:, index[f"{side}tarsometatarsal_{n + 1}"]] += share * rays[:, k]
