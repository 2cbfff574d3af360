"""Make src/vitruvian/hanim/data/x3d_fields.json: what fields the nodes of X3D have.

    python tools/build_x3d_fields.py FOLDER_WITH_x3d-3.3.xsd_AND_x3d-4.0.xsd

Facts are read from Web3D's X3D XML schemas (4.0 first, then what only 3.3 has): per node the default containerField and
per field [type, access, default]. The schemas say nothing about which attributes are initializeOnly, so that is listed
here by hand after ISO/IEC 19775-1. VRML97's own fields (Switch.choice, LOD.level, Collision.collide) are added, and
FontStyle.style, which shares its name with an attribute that all elements have.
The H-Anim nodes are left out: `hanim/data/node_fields.json` has them.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from lxml import etree

XS = "{http://www.w3.org/2001/XMLSchema}"
OUT = Path(__file__).resolve().parent.parent / "src/vitruvian/hanim/data/x3d_fields.json"
FIELD_TYPE = re.compile(
    r"(?:SF|MF)(?:Bool|Color(?:RGBA)?|Double|Float|Image|Int32|Matrix[34][fd]|Node|Rotation|String|Time|Vec[234][fd])$"
)
NOT_FIELDS = {
    "DEF",
    "USE",
    "containerField",
    "class",
    "id",
    "style",
    "sourceCode",
    "componentName",
    "componentLevel",
    "additionalInterface",
}
FIXED_EVERYWHERE = {"bboxCenter", "bboxSize", "directOutput", "mustEvaluate"}
FIXED_IN_GEOMETRY = set(
    "beginCap bottom bottomRadius ccw closureType colorIndex colorPerVertex convex coordIndex creaseAngle crossSection "
    "endAngle endCap height innerRadius normalIndex normalPerVertex order orientation outerRadius radius scale side "
    "size solid spine startAngle subdivision texCoordIndex top uDimension vDimension xDimension xSpacing zDimension "
    "zSpacing".split()  # fmt: skip
)
EXTRA = {
    "FontStyle": {"style": ["SFString", "initializeOnly", "PLAIN"]},
    "ScreenFontStyle": {"style": ["SFString", "initializeOnly", "PLAIN"]},
    "Switch": {"choice": ["MFNode", "inputOutput", "[]"]},
    "LOD": {"level": ["MFNode", "inputOutput", "[]"]},
    "Collision": {"collide": ["SFBool", "inputOutput", "true"]},
}


def base_types(root: etree._Element) -> dict[str, str]:
    """Named simple types of the schema -> the X3D field type they restrict."""
    parents = {}
    for simple in root.iterchildren(XS + "simpleType"):
        restriction = simple.find(XS + "restriction")
        if restriction is not None:
            parents[simple.get("name")] = restriction.get("base", "")
    found = {}
    for name in parents:
        base = name
        while base in parents and not FIELD_TYPE.match(base):
            base = parents[base]
        found[name] = base if FIELD_TYPE.match(base) else "SFString"
    return found


def attribute_type(attribute: etree._Element, named: dict[str, str]) -> str:
    kind = attribute.get("type")
    if kind is None:
        restriction = attribute.find(f"{XS}simpleType/{XS}restriction")
        kind = restriction.get("base", "SFString") if restriction is not None else "SFString"
    if FIELD_TYPE.match(kind):
        return kind
    if kind == "bboxSizeType":
        return "SFVec3f"
    if kind.startswith("xs:"):
        return "SFString"
    return named.get(kind, "SFString")


def own_fields(element: etree._Element, named: dict[str, str]) -> tuple[str, str, dict[str, list[str]]]:
    """(base type, containerField, fields) that one complex type or element adds to what it extends."""
    fields: dict[str, list[str]] = {}
    info = element.find(f"{XS}annotation/{XS}appinfo")
    for item in [] if info is None else info:
        if item.tag in (XS + "element", XS + "attribute") and (item.get("fixed") or "").endswith("Field"):
            kind = attribute_type(item, named)
            if item.get("name") in NOT_FIELDS or (item.get("type") and not FIELD_TYPE.match(item.get("type"))):
                continue
            default = "[]" if kind == "MFNode" else "NULL" if kind == "SFNode" else ""
            fields[item.get("name")] = [kind, item.get("fixed")[: -len("Field")], default]
    extension = element.find(f".//{XS}extension")
    if extension is None:  # a node that extends nothing: its attributes stand in its own type
        extension = element.find(f"{XS}complexType")
    if extension is None:
        return "", "", fields
    container = ""
    for attribute in extension.iterchildren(XS + "attribute"):
        name = attribute.get("name")
        if name == "containerField":
            container = attribute.get("default") or attribute.get("fixed") or ""
        elif name and name not in NOT_FIELDS and name not in fields:
            kind = attribute_type(attribute, named)
            fields[name] = [kind, "inputOutput", attribute.get("default") or ""]
    return extension.get("base", ""), container, fields


def interfaces_of(element: etree._Element) -> list[str]:
    """Abstract types that a type implements besides the one it extends."""
    found = element.findall(f"{XS}annotation/{XS}appinfo/{XS}attribute[@name='additionalInterface']")
    return [item.get("default", "") for item in found]


def nodes(schema: Path) -> dict[str, dict[str, object]]:
    root = etree.parse(str(schema)).getroot()
    named = base_types(root)
    by_name = {t.get("name"): t for t in root.iterchildren(XS + "complexType")}
    types = {name: own_fields(t, named) for name, t in by_name.items()}
    found = {}
    for element in root.iterchildren(XS + "element"):
        name = element.get("name")
        base, container, fields = own_fields(element, named)
        lineage = []
        interfaces = interfaces_of(element)
        while base in types:
            lineage.append(base)
            interfaces += interfaces_of(by_name[base])
            base_of, inherited_container, inherited = types[base]
            container = container or inherited_container
            fields = {**inherited, **fields}
            base = base_of
        if (not container and "X3DNode" not in lineage) or name.startswith(("HAnim", "ProtoInstance")):
            continue
        for interface in interfaces:
            fields = {**types.get(interface, ("", "", {}))[2], **fields}
        if "X3DUrlObject" in interfaces:  # the schema names the field only where an attribute has a hint about it
            fields.setdefault("url", ["MFString", "inputOutput", ""])
        geometry = any("Geometry" in b for b in lineage)
        for field, entry in fields.items():
            if entry[1] == "inputOutput" and (field in FIXED_EVERYWHERE or (geometry and field in FIXED_IN_GEOMETRY)):
                entry = fields[field] = [entry[0], "initializeOnly", entry[2]]
        found[name] = {"container": container or "children", "fields": fields}
    return found


def main(folder: Path) -> None:
    table = nodes(folder / "x3d-4.0.xsd")
    for name, older in nodes(folder / "x3d-3.3.xsd").items():
        entry = table.setdefault(name, older)
        entry["fields"] = {**older["fields"], **entry["fields"]}
    for name, extra in EXTRA.items():
        table[name]["fields"].update(extra)
    lines = [f"{json.dumps(name)}:{json.dumps(table[name], separators=(',', ':'))}" for name in sorted(table)]
    OUT.write_text("{\n" + ",\n".join(lines) + "\n}\n")
    print(f"{len(table)} nodes, {sum(len(t['fields']) for t in table.values())} fields, {OUT.stat().st_size} bytes")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
