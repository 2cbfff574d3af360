"""What joints of other rigs are called, and which H-Anim joint each one is.

Known: CMU (both families of BVH names), ASF, Mixamo, MakeHuman (default rig and old BVH), Unity and VRM, Blender and
Rigify, Biped of 3ds Max, SMPL, H-Anim 1.x and 2.0. Names are compared without side, case, separators and the rig's prefix
(`mixamorig:LeftUpLeg` is "upleg" on the left).
"""

from __future__ import annotations

import re
from collections.abc import Iterable

SPINE, NECK = "spine", "neck"

# H-Anim 1.x joint names that differ from 2.0 (ISO/IEC 19774-1: part 1, tables of joint names), without side.
_OLD = {
    "ankle": "talocrural",
    "subtalar": "tarsometatarsal_2",
    "midtarsal": "metatarsophalangeal_2",
    "metatarsal": "tarsal_distal_interphalangeal_2",
    "wrist": "radiocarpal",
    "thumb1": "carpometacarpal_1",
    "thumb2": "metacarpophalangeal_1",
    "thumb3": "carpal_interphalangeal_1",
}
for _i, _finger in enumerate(("index", "middle", "ring", "pinky"), 2):
    _OLD[f"{_finger}0"] = f"carpometacarpal_{_i}"
    _OLD[f"{_finger}1"] = f"metacarpophalangeal_{_i}"
    _OLD[f"{_finger}2"] = f"carpal_proximal_interphalangeal_{_i}"
    _OLD[f"{_finger}3"] = f"carpal_distal_interphalangeal_{_i}"

VERTEBRAE = (
    *(f"vl{i}" for i in range(5, 0, -1)),
    *(f"vt{i}" for i in range(12, 0, -1)),
    *(f"vc{i}" for i in range(7, 0, -1)),
)
_MIDDLE = {"humanoid_root", "sacroiliac", "skullbase", "temporomandibular", *VERTEBRAE}
_SIDED = {
    *("hip knee talocrural metatarsophalangeal_2 tarsometatarsal_2 tarsal_distal_interphalangeal_2".split()),
    *("sternoclavicular acromioclavicular shoulder elbow radiocarpal".split()),
    *("eyelid_joint eyeball_joint eyebrow_joint".split()),
    *(name for name in _OLD.values()),
}

# Spellings without side. A name in two rows is decided by what else the rig has (see `_UNLESS`).
_MIDDLE_WORDS = {
    "humanoid_root": "hips hip pelvis root humanoidroot humanoid root hipsjoint",
    SPINE: "spine spine0 spine1 spine2 spine3 spine4 spine5 spine01 spine02 spine03 spine04 spine05 spine001 spine002 "
    "spine003 lowerback lowback chest chest1 chest2 chest3 chest4 upperchest torso abdomen thorax upperback waist",
    NECK: "neck neck0 neck1 neck2 neck01 neck02 neck03 lowerneck upperneck spine004 spine005",
    "skullbase": "head spine006 skull",
    "temporomandibular": "jaw",
}
_SIDED_WORDS = {
    "hip": "upleg upperleg upleg1 upperleg01 thigh hip femur leftupleg",
    "knee": "leg lowleg loleg lowerleg lowerleg01 knee shin calf tibia",
    "talocrural": "foot ankle",
    "metatarsophalangeal_2": "toe toes toebase toe0 toe11 ball foot",
    "sternoclavicular": "clavicle clavicula collar collarbone shoulder scapula",
    "acromioclavicular": "shoulder01",
    "shoulder": "arm uparm upperarm upperarm01 shoulder humerus",
    "elbow": "forearm lowarm loarm lowerarm lowerarm01 elbow radius",
    "radiocarpal": "hand wrist",
    "eyeball_joint": "eye",
}
for _i, _words in enumerate(("thumb", "index", "middle mid", "ring", "pinky little"), 1):
    _joints = (
        ("carpometacarpal_1", "metacarpophalangeal_1", "carpal_interphalangeal_1")
        if _i == 1
        else tuple(f"{part}_{_i}" for part in ("metacarpophalangeal", "carpal_proximal_interphalangeal"))
        + (f"carpal_distal_interphalangeal_{_i}",)
    )
    for _k, _joint in enumerate(_joints):
        _forms = [f"finger{_i}{_k + 1}", f"finger{_i - 1}{_k or ''}"]
        for _word in _words.split():
            _forms += [f"{_word}{_k + 1}", f"hand{_word}{_k + 1}", f"f{_word}0{_k + 1}", f"{_word}0{_k + 1}"]
            _forms.append(_word + ("proximal", "intermediate", "distal")[_k])
        if _i == 1:
            _forms[-1] = ("thumbmetacarpal", "thumbproximal", "thumbdistal")[_k]
            _forms += ["thumb"] if _k == 0 else ["thumbintermediate"] if _k == 1 else []
        _SIDED_WORDS[_joint] = " ".join(_forms)

# A word is not this joint when the same side also has one of those words: "hand" of a rig with a "wrist" is the palm.
_UNLESS = {
    ("sternoclavicular", "shoulder"): None,  # only when the upper arm has another name, see `match`
    ("shoulder", "shoulder"): {"arm", "uparm", "upperarm", "upperarm01", "humerus"},
    ("radiocarpal", "hand"): {"wrist"},
    ("talocrural", "foot"): {"ankle"},
    ("knee", "leg"): {"lowleg", "loleg", "lowerleg", "knee", "shin", "calf"},
}


def hanim_name(name: str) -> str | None:
    """The H-Anim 2.0 name of an H-Anim 1.x or 2.0 joint, or None when it is neither. Case counts, as in the standard."""
    if name == "HumanoidRoot" or name in _MIDDLE:
        return "humanoid_root" if name == "HumanoidRoot" else name
    side, _, part = name.partition("_")
    if side in ("l", "r") and part:
        part = _OLD.get(part, part)
        if part in _SIDED or re.fullmatch(r"[a-z_]*(tarsal|carpal|phalangeal|crural|cuboid|navicular)[a-z_]*(\d(_5)?)?", part):
            return f"{side}_{part}"
    return None


def split_name(name: str) -> tuple[str, str]:
    """Side ("l", "r" or "") and bare lower-case word of a joint's name."""
    bare = re.sub(r"^.*[:|]", "", name.strip())
    bare = re.sub(r"^(Bip\d*|Character\d*|DEF|ORG|J_Bip|J_Sec|CC_Base|m_avg|ValveBiped\.Bip\d*)[ _\-.]+", "", bare)
    bare = re.sub(r"([a-z])([A-Z])", r"\1 \2", bare)
    tokens = [t for t in re.split(r"[ _\-.]+", bare) if t]
    side = ""
    for i, token in enumerate(tokens):
        low = token.lower()
        if low in ("l", "left", "r", "right"):
            side = low[0]
            del tokens[i]
            break
    word = "".join(tokens).lower()
    if not side:
        # one letter stuck to the front or spelt together: LThumb, lhand, LHipJoint, leftarm
        stuck = re.match(r"(left|right)(?=.)", word) or re.match(r"[LR](?=[A-Z])", bare) or re.match(r"[lr](?=hand$)", bare)
        if stuck:
            side = stuck[0][0].lower()
            word = word[len(stuck[0]) :]
    return side, word


def match(names: Iterable[str], own: dict[str, str] | None = None) -> dict[str, str]:
    """Which H-Anim 2.0 joint each joint of a rig is: {rig's name: H-Anim name}.

    Trunk and neck joints that are no particular vertebra are answered as "spine" and "neck". Names nobody knows are
    absent. `own` {rig's name: H-Anim name} wins over the tables. Each H-Anim joint is given once, to the first.
    """
    names = list(names)
    own = own or {}
    found: dict[str, str] = {n: hanim_name(own[n]) or own[n] for n in names if n in own}
    exact = {n: h for n in names if n not in own and (h := hanim_name(n))}
    if len(exact) > len(names) // 2:
        return {**exact, **found}
    taken = {h for h in found.values() if h not in (SPINE, NECK)}
    split = {n: split_name(n) for n in names}
    words = {side: {w for s, w in split.values() if s == side} for side in ("", "l", "r")}
    for name in names:
        if name in found or name.startswith("__"):  # MakeHuman's helpers carry no motion of their own
            continue
        side, word = split[name]
        for joint, spellings in (_SIDED_WORDS if side else _MIDDLE_WORDS).items():
            if word not in spellings.split():
                continue
            if (joint, word) == ("sternoclavicular", "shoulder"):
                if not words[side] & {"arm", "uparm", "upperarm", "upperarm01", "humerus"}:
                    continue
            elif words[side] & (_UNLESS.get((joint, word)) or set()):
                continue
            if joint == "metatarsophalangeal_2" and word == "foot" and "ankle" not in words[side]:
                continue
            full = f"{side}_{joint}" if side else joint
            if full in taken:
                continue
            found[name] = full
            if full not in (SPINE, NECK):
                taken.add(full)
            break
    if "neck" not in {w for s, w in split.values() if not s}:
        # Rigify counts its neck as spine 4 and 5; other rigs with that many have a neck of their own
        return found
    return {n: SPINE if h == NECK and split[n][1].startswith("spine") else h for n, h in found.items()}


def joint_index(names: Iterable[str]) -> dict[str, int]:
    """H-Anim 2.0 name -> index among joints named by either version of the standard."""
    return {h: i for i, n in enumerate(names) if (h := hanim_name(n))}
