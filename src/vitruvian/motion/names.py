"""What joints of other rigs are called, and which H-Anim joint each one is.

Known: CMU (both families of BVH names), ASF, Mixamo, MakeHuman (default rig and old BVH), Unity and VRM, Blender and
Rigify, Biped of 3ds Max, MotionBuilder, SMPL, OpenSim bodies, H-Anim 1.x and 2.0. Names are compared without side,
case, separators and the rig's prefix (`mixamorig:LeftUpLeg` is "upleg" on the left).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import cache

from vitruvian.hanim.tables import canonical

SPINE, NECK = "spine", "neck"
VERTEBRAE = (
    *(f"vl{i}" for i in range(5, 0, -1)),
    *(f"vt{i}" for i in range(12, 0, -1)),
    *(f"vc{i}" for i in range(7, 0, -1)),
)
FINGER_JOINTS = {
    1: ("carpometacarpal_1", "metacarpophalangeal_1", "carpal_interphalangeal_1"),
    **{
        k: (f"metacarpophalangeal_{k}", f"carpal_proximal_interphalangeal_{k}", f"carpal_distal_interphalangeal_{k}")
        for k in range(2, 6)
    },
}

# Words of the middle of the body and of each side: H-Anim joint -> how rigs spell it.
_MIDDLE = {
    "humanoid_root": "hips hip pelvis root humanoidroot humanoid bip bip01 bip001",
    SPINE: "spine spine0 spine1 spine2 spine3 spine4 spine5 spine01 spine02 spine03 spine04 spine05 spine001 spine002 "
    "spine003 lowerback lowback chest chest1 chest2 chest3 chest4 upperchest torso abdomen lumbar thorax upperback waist",
    NECK: "neck neck0 neck1 neck2 neck01 neck02 neck03 lowerneck upperneck spine004 spine005",
    "skullbase": "head spine006 skull",
    "temporomandibular": "jaw",
}
_SIDED = {
    "hip": "upleg upperleg upperleg01 thigh hip femur",
    "knee": "leg lowleg loleg lowerleg lowerleg01 knee shin calf tibia",
    "talocrural": "foot ankle talus",
    "talocalcaneonavicular": "calcn calcaneus",
    "metatarsophalangeal_2": "toe toes toebase toe0 toe1-1 ball foot",
    "sternoclavicular": "clavicle clavicula collar collarbone shoulder scapula",
    "acromioclavicular": "shoulder01",
    "shoulder": "arm uparm upperarm upperarm01 shoulder humerus",
    "elbow": "forearm lowarm loarm lowerarm lowerarm01 elbow ulna radius",
    "radiocarpal": "hand wrist",
    "eyeball_joint": "eye",
}
_STUCK = "hand|clavicle|humerus|radius|wrist|femur|tibia|foot|toes|thumb|fingers"  # after a bare l or r, as in ASF
_PREFIX = r"^(Bip\d*|Character\d*|mixamorig\d*|DEF|ORG|J_Bip_C|J_Bip|J_Sec|CC_Base|m_avg|ValveBiped\.Bip\d*)[ _\-.]+"
_UPPER_ARM = {"arm", "uparm", "upperarm", "upperarm01", "humerus"}
# A word is this joint only if the same side has (True) or has not (False) one of those words too: what is called "hand"
# in a rig with a "wrist" is the palm, a "shoulder" beside an "arm" is the collar bone.
_WHEN = {
    ("sternoclavicular", "shoulder"): (True, _UPPER_ARM),
    ("shoulder", "shoulder"): (False, _UPPER_ARM),
    ("radiocarpal", "hand"): (False, {"wrist"}),
    ("elbow", "radius"): (False, {"ulna"}),  # beside an ulna it turns the forearm
    ("talocrural", "foot"): (False, {"ankle"}),
    ("metatarsophalangeal_2", "foot"): (True, {"ankle"}),
    ("knee", "leg"): (False, {"lowleg", "loleg", "lowerleg", "knee", "shin", "calf"}),
}


@cache
def _words() -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """(middle, sided): word -> the joints it may mean, in order."""
    sided = {joint: words.split() for joint, words in _SIDED.items()}
    for k, (joints, fingers) in enumerate(
        zip(FINGER_JOINTS.values(), ("thumb", "index", "middle mid", "ring", "pinky little")), 1
    ):
        phases = ("metacarpal", "proximal", "distal") if k == 1 else ("proximal", "intermediate", "distal")
        for i, joint in enumerate(joints):
            forms = [f"finger{k}-{i + 1}", f"finger{k - 1}{i or ''}"]  # MakeHuman 1-1, Biped 0, 01, 02
            for finger in fingers.split():
                forms += [f"{finger}{i + 1}", f"hand{finger}{i + 1}", f"{finger}0{i + 1}", f"f{finger}0{i + 1}"]
                forms.append(finger + phases[i])
            sided[joint] = forms
    sided["carpometacarpal_1"].append("thumb")
    sided["metacarpophalangeal_1"].append("thumbintermediate")
    out: tuple[dict[str, list[str]], dict[str, list[str]]] = {}, {}
    for table, source in zip(out, ({j: w.split() for j, w in _MIDDLE.items()}, sided)):
        for joint, forms in source.items():
            for form in forms:
                table.setdefault(form, []).append(joint)
    return out


def split_name(name: str) -> tuple[str, str]:
    """Side ("l", "r" or "") and bare lower-case word of a joint's name."""
    bare = re.sub(r"^.*[:|]", "", name.strip())
    bare = re.sub(_PREFIX, "", bare)
    tokens = [t for t in re.split(r"[ _\-.]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", bare)) if t]
    side = ""
    for i, token in enumerate(tokens):
        if token.lower() in ("l", "left", "r", "right"):
            side = tokens.pop(i)[0].lower()
            break
    word = ""
    for token in tokens:  # numbers side by side stay apart: finger1-2 is not Biped's finger 12
        word += ("-" if word[-1:].isdigit() and token[0].isdigit() else "") + token.lower()
    if not side:
        # one letter stuck to the front, or all in one word: LThumb, lhand, lfemur, leftarm
        stuck = re.match(r"(left|right)(?=.)", word) or re.match(rf"[LR](?=[A-Z])|[lr](?=({_STUCK})$)", bare)
        if stuck:
            side, word = stuck[0][0].lower(), word[len(stuck[0]) :]
    return side, word


def match(names: Iterable[str], own: Mapping[str, str] | None = None) -> dict[str, str]:
    """Which H-Anim 2.0 joint each joint of a rig is: {rig's name: H-Anim name}.

    Trunk and neck joints that are no particular vertebra are answered as "spine" and "neck". Names nobody knows are
    absent. `own` {rig's name: H-Anim name} wins over the tables. Each H-Anim joint is given once, to the first.
    """
    names, own = list(names), dict(own or {})
    found = {n: canonical(own[n]) or own[n] for n in names if n in own}
    exact = {n: known for n in names if n not in own and (known := canonical(n))}
    if len(exact) > len(names) // 2:
        return {**exact, **found}
    taken = set(found.values())
    split = {n: split_name(n) for n in names}
    said = {side: {w for s, w in split.values() if s == side} for side in ("", "l", "r")}
    middle, sided = _words()
    for name in names:
        if name in found or name.startswith("__"):  # MakeHuman's helpers carry no motion of their own
            continue
        side, word = split[name]
        for joint in (sided if side else middle).get(word, ()):
            wanted, others = _WHEN.get((joint, word), (False, set()))
            full = f"{side}_{joint}" if side else joint
            if full in taken or wanted != bool(said[side] & others):
                continue
            if full == NECK and word.startswith("spine") and "neck" in said[""]:
                full = SPINE  # Rigify's fifth and sixth spine joints are its neck, other rigs have one
            found[name] = full
            if full not in (SPINE, NECK):
                taken.add(full)
            break
    return found


def joint_index(names: Iterable[str]) -> dict[str, int]:
    """H-Anim 2.0 name -> index among joints named by either version of the standard; the first wins."""
    out: dict[str, int] = {}
    for i, name in enumerate(names):
        known = canonical(name)
        if known:
            out.setdefault(known, i)
    return out
