"""What labs call their markers, and where on the body each one sits.

Known: Plug-in Gait and its relatives (LASI, RKNE, LTOE ...), Helen Hayes and the sets of OpenSim's models (R.ASIS,
L.Knee.Lat, R.Thigh.Front ...), names of H-Anim Sites and feature points. A label is compared without the actor's prefix
(`anna:LASI`), separators and case. A place is a feature point of the standard where the marker is glued to one, else
the segment that a marker of a cluster rides on.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from vitruvian.hanim.tables import canonical, feature_points


@dataclass(frozen=True)
class Place:
    """On the body: a feature point or Site (`site`), or a segment of joint `joint`, share `along` of it to the next
    joint. `center`: the joint's centre itself, as estimated by the lab."""

    site: str = ""
    joint: str = ""
    along: float = 0.5
    center: bool = False


_POINTS = {
    "asis": "asis asi",
    "psis": "psis psi",
    "acromion": "acromium acromion sho shoulder acr",
    "humeral_lateral_epicondyle": "elb elbow lep elbowlat lelb elblat",
    "humeral_medial_epicondyle": "mep elbowmed melb elbmed",
    "radial_styloid": "wristlat wra",
    "ulnar_styloid": "wristmed wrb",
    "metacarpal_phalanx_3": "fin",
    "femoral_lateral_epicondyle": "kne knee kneelat lfc",
    "femoral_medial_epicondyle": "kneemed mfc mkne",
    "lateral_malleolus": "ank ankle anklelat lmal",
    "medial_malleolus": "anklemed mmal mank",
    "calcaneus_posterior": "hee heel cal",
    "metatarsal_phalanx_1": "mt1 toemed",
    "metatarsal_phalanx_5": "mt5 toelat",
}
_MIDDLE = {"cervicale": "c7", "suprasternale": "clav", "skull_vertex": "tophead", "substernale": "xiph"}
_RIDERS = {  # joint: labels of markers on its segment
    "hip": "thi thigh thighupper thighfront thighrear th1 th2 th3 th4",
    "knee": "tib shank shankupper shankfront shankrear tb1 tb2 tb3 tb4",
    "talocrural": "midfootsup midfootlat toe mt2 mt3",
    "metatarsophalangeal_2": "toetip",
    "shoulder": "upa bicep uparm upperarm",
    "elbow": "frm fra forearm frontarm",
}
_MIDDLE_RIDERS = {
    "skullbase": "lfhd rfhd lbhd rbhd ltemple rtemple fhd bhd head",
    "vt6": "t10 rbak lbak strn sternum t8",
    "humanoid_root": "sacr vsacral sacrum lbwt rbwt lfwt rfwt bwt fwt",
}
_CENTERS = {"hip": "hjc", "knee": "kjc", "talocrural": "ajc", "shoulder": "sjc", "elbow": "ejc", "radiocarpal": "wjc"}


def _turned(table: Mapping[str, str]) -> dict[str, str]:
    return {word: place for place, words in table.items() for word in words.split()}


_POINT, _MID, _RIDER, _MID_RIDER, _CENTER = map(_turned, (_POINTS, _MIDDLE, _RIDERS, _MIDDLE_RIDERS, _CENTERS))


def plain(label: str) -> str:
    """The label without the actor's prefix, separators and case."""
    return re.sub(r"[^a-z0-9]", "", label.rpartition(":")[2].lower())


def place_of(label: str) -> Place | None:
    """Where a marker of that name sits, or None when nobody knows."""
    name = label.rpartition(":")[2].strip()
    standard = canonical(name, "site") or (name if name in feature_points() else None)
    if standard:
        return Place(site=standard)
    word = plain(label)
    if word in _MID:
        return Place(site=_MID[word])
    if word in _MID_RIDER:
        return Place(joint=_MID_RIDER[word])
    for side in "lr":
        rest = word.removeprefix(side) if word.startswith(side) else word.removesuffix(side)
        if rest == word:
            continue
        if rest in _POINT:
            return Place(site=f"{side}_{_POINT[rest]}")
        if rest in _RIDER:
            return Place(joint=f"{side}_{_RIDER[rest]}")
        if rest in _CENTER:
            return Place(joint=f"{side}_{_CENTER[rest]}", center=True)
    return None


def sides(labels: Iterable[str]) -> list[tuple[int, int]]:
    """Pairs (left, right) of indices of labels that are mirror images of each other."""
    words = [plain(label) for label in labels]
    index = {w: i for i, w in enumerate(words)}
    out = []
    for i, w in enumerate(words):
        if w.startswith("l") and "r" + w[1:] in index:
            out.append((i, index["r" + w[1:]]))
    return out
