"""What VRM says beside bones: who made the figure and what may be done with it, and which morphs make which expression.

Sources: VRM 1.0 `meta` and `expressions`, VRM 0.x `meta` and `blendShapeMaster` (VRM Consortium). Expressions made of
several face units follow EMFACS (Ekman and Friesen: happiness 6+12, sadness 1+4+15, anger 4+5+7+23, surprise 1+2+5+26)
and, for vowels, the openness and the rounding or spreading of the lips of the IPA chart.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from vitruvian.formats.gltf_file import GltfFile

LICENSE = "https://vrm.dev/licenses/1.0/"
# meta fields with a choice: what is allowed, the first is VRM's own default and the most careful one
CHOICES = {
    "avatarPermission": ("onlyAuthor", "onlySeparatelyLicensedPerson", "everyone"),
    "commercialUsage": ("personalNonProfit", "personalProfit", "corporation"),
    "creditNotation": ("required", "unnecessary"),
    "modification": ("prohibited", "allowModification", "allowModificationRedistribution"),
}
FLAGS = (
    "allowExcessivelyViolentUsage", "allowExcessivelySexualUsage", "allowPoliticalOrReligiousUsage",
    "allowAntisocialOrHateUsage", "allowRedistribution",
)  # fmt: skip
# Humanoid.info key -> meta field
_PLAIN = {
    "humanoidVersion": "version", "copyright": "copyrightInformation", "authorEmail": "contactInformation",
    "thirdPartyLicenses": "thirdPartyLicenses", "otherLicenseUrl": "otherLicenseUrl",
}  # fmt: skip
PRESETS = (
    "happy angry sad relaxed surprised aa ih ou ee oh blink blinkLeft blinkRight "
    "lookUp lookDown lookLeft lookRight neutral"
).split()
_PRESETS_0 = {
    "joy": "happy", "angry": "angry", "sorrow": "sad", "fun": "relaxed", "a": "aa", "i": "ih", "u": "ou", "e": "ee",
    "o": "oh", "blink": "blink", "blink_l": "blinkLeft", "blink_r": "blinkRight", "lookup": "lookUp",
    "lookdown": "lookDown", "lookleft": "lookLeft", "lookright": "lookRight",
}  # fmt: skip
# preset -> {face unit: weight}; a unit that starts with `*_` means both sides
UNITS: dict[str, dict[str, float]] = {
    "blink": {"*_eye_blink": 1}, "blinkLeft": {"l_eye_blink": 1}, "blinkRight": {"r_eye_blink": 1},
    "lookUp": {"*_eye_look_up": 1}, "lookDown": {"*_eye_look_down": 1},
    "lookLeft": {"l_eye_look_out": 1, "r_eye_look_in": 1}, "lookRight": {"l_eye_look_in": 1, "r_eye_look_out": 1},
    "happy": {"*_cheek_squint": 0.7, "*_mouth_smile": 1},
    "sad": {"brow_inner_up": 1, "*_brow_down": 0.3, "*_mouth_frown": 1},
    "angry": {"*_brow_down": 1, "*_eye_wide": 0.4, "*_eye_squint": 0.6, "*_mouth_press": 0.8},
    "surprised": {"brow_inner_up": 1, "*_brow_outer_up": 1, "*_eye_wide": 1, "jaw_open": 0.4},
    "aa": {"jaw_open": 0.7}, "oh": {"jaw_open": 0.4, "mouth_funnel": 0.7}, "ou": {"jaw_open": 0.1, "mouth_pucker": 0.9},
    "ee": {"jaw_open": 0.35, "*_mouth_stretch": 0.4}, "ih": {"jaw_open": 0.15, "*_mouth_stretch": 0.6},
}  # fmt: skip


def info_of(file: GltfFile) -> dict[str, str]:
    """Humanoid.info from VRM meta: its own keys where H-Anim has none."""
    meta = file.object(file.extension("VRMC_vrm"), "meta")
    out: dict[str, str] = {}
    if meta:
        authors = meta.get("authors")
        names = [a for a in authors if isinstance(a, str) and a.strip()] if isinstance(authors, list) else []
        if names:
            out["authorName"] = ", ".join(names)[:500]
        for key, field in _PLAIN.items():
            if file.text(meta, field):
                out[key] = file.text(meta, field)
        for field in ("licenseUrl", *CHOICES):
            if file.text(meta, field):
                out[field] = file.text(meta, field)
        out |= {f: "true" if meta[f] else "false" for f in FLAGS if isinstance(meta.get(f), bool)}
        return out
    old = file.object(file.extension("VRM"), "meta")
    for key, field in (
        ("authorName", "author"), ("humanoidVersion", "version"), ("authorEmail", "contactInformation"),
        ("otherLicenseUrl", "otherLicenseUrl"),
    ):  # fmt: skip
        if file.text(old, field):
            out[key] = file.text(old, field)
    if file.text(old, "licenseName"):
        out["usageRestrictions"] = file.text(old, "licenseName")
    person = {
        "OnlyAuthor": "onlyAuthor", "ExplicitlyLicensedPerson": "onlySeparatelyLicensedPerson", "Everyone": "everyone"
    }.get(file.text(old, "allowedUserName"))  # fmt: skip
    if person:
        out["avatarPermission"] = person
    for field, key in (("violentUssageName", FLAGS[0]), ("sexualUssageName", FLAGS[1])):
        if file.text(old, field):
            out[key] = "true" if file.text(old, field) == "Allow" else "false"
    if file.text(old, "commercialUssageName") == "Allow":
        out["commercialUsage"] = "personalProfit"
    return out


def meta_of(name: str, info: dict[str, str]) -> tuple[dict[str, Any], list[str]]:
    """VRM 1.0 meta from a Humanoid's name and info, and what it had to assume, one line each.

    Nothing is granted that info does not grant: missing fields get VRM's defaults, which are its most careful ones.
    """
    lost = []
    author = info.get("authorName", "").strip()
    if not author:
        lost.append("VRM asks for an author, info names none (authorName): written as unknown")
    meta: dict[str, Any] = {
        "name": name or "humanoid", "authors": [a for a in re.split(r"\s*,\s*", author) if a] or ["unknown"],
        "licenseUrl": LICENSE,
    }  # fmt: skip
    for key, field in _PLAIN.items():
        if info.get(key):
            meta[field] = info[key]
    rules = info.get("usageRestrictions", "").strip()
    if rules:
        said = meta.get("copyrightInformation")
        meta["copyrightInformation"] = f"{said}; usage: {rules}" if said else f"usage: {rules}"
    for field, choices in CHOICES.items():
        meta[field] = info[field] if info.get(field) in choices else choices[0]
    meta |= {f: info.get(f, "").strip().lower() == "true" for f in FLAGS}
    if not any(k in info for k in ("avatarPermission", "commercialUsage", "modification")):
        lost.append(
            "info grants no use (avatarPermission, commercialUsage, ...): VRM's most careful terms were written"
        )
    return meta, lost


def preset_names(file: GltfFile, origin: dict[tuple[int, int], int], names: Sequence[str]) -> dict[int, str]:
    """Target -> `<preset>_action`, for expressions of VRM that are one whole morph target (in every mesh)."""
    made: dict[str, dict[int, float]] = {}
    presets = file.object(file.object(file.extension("VRMC_vrm"), "expressions"), "preset")
    for preset in PRESETS:
        for bind in file.objects(file.object(presets, preset), "morphTargetBinds"):
            at: Any = (bind.get("node"), bind.get("index"))
            weight = bind.get("weight", 1)
            if all(isinstance(x, int) for x in at) and isinstance(weight, int | float) and at in origin:
                made.setdefault(preset, {})[origin[at]] = float(weight)
    nodes = file.items("nodes")
    for group in file.objects(file.object(file.extension("VRM"), "blendShapeMaster"), "blendShapeGroups"):
        known = _PRESETS_0.get(file.text(group, "presetName").lower())
        for bind in file.objects(group, "binds") if known else []:
            mesh, index, weight = bind.get("mesh"), bind.get("index"), bind.get("weight", 100)
            for (node, i), target in origin.items():
                if i == index and nodes[node].get("mesh") == mesh and isinstance(weight, int | float):
                    made.setdefault(known or "", {})[target] = float(weight) / 100
    out: dict[int, str] = {}
    for preset, binds in made.items():
        target, weight = next(iter(binds.items()))
        if len(binds) == 1 and weight > 0.99 and target not in out and f"{preset}_action" not in names:
            out[target] = f"{preset}_action"
    return out


def expressions(displacers: Sequence[str], node: int) -> dict[str, Any]:
    """VRM 1.0 presets from the morph targets of a mesh's node, named as our displacers; {} without any.

    A displacer that is called like a preset is that preset. Else a preset needs all its face units; units may be named
    as ours (`l_eye_blink_action`) or as ARKit's (`eyeBlinkLeft`). "relaxed" and "neutral" have no agreed units.
    """
    at: dict[str, int] = {}
    for i, name in enumerate(displacers):
        at.setdefault(_unit(name), i)
        at.setdefault(name.removesuffix("_action"), i)
    presets: dict[str, Any] = {}
    for preset in PRESETS:
        binds = []
        if preset in at:
            binds = [{"node": node, "index": at[preset], "weight": 1.0}]
        else:
            units: dict[str, float] = {}
            for unit, weight in UNITS.get(preset, {}).items():
                both = [unit.replace("*", s, 1) for s in "lr"] if unit.startswith("*") else [unit]
                units |= dict.fromkeys(both, float(weight))
            if units and all(u in at for u in units):
                binds = [{"node": node, "index": at[u], "weight": w} for u, w in units.items()]
        if binds:
            presets[preset] = {"morphTargetBinds": binds}
    return {"preset": presets} if presets else {}


def _unit(name: str) -> str:
    """`eyeBlinkLeft` and `l_eye_blink_action` as `l_eye_blink`."""
    stem = name.removesuffix("_action")
    if "_" in stem:
        return stem
    side = ""
    if stem not in ("jawLeft", "jawRight", "mouthLeft", "mouthRight"):
        for word, letter in (("Left", "l_"), ("Right", "r_")):
            if stem.endswith(word) and stem not in PRESETS:
                stem, side = stem.removesuffix(word), letter
    return side + re.sub(r"([A-Z])", lambda m: "_" + m[0].lower(), stem)
