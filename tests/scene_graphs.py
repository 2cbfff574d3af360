"""Random scene graphs for property tests, in any encoding."""

from __future__ import annotations

import json

import numpy as np
from hypothesis import strategies as st

from vitruvian.hanim.graph import Comment, Literal, Node, Proto, ProtoField, Route, Scene, Use

NAMES = st.from_regex(r"[A-Za-z_][A-Za-z0-9_-]{0,6}", fullmatch=True).map(lambda n: "n" + n)
PLAIN = st.text(st.characters(codec="utf-8", exclude_characters="\x00\r", exclude_categories=["Cc", "Cs"]), max_size=12)
STRINGS = st.text(
    st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"], include_characters="\n\t\"\\'<&[]{}#,"), max_size=12
).filter(lambda s: not any(c in s for c in "\ufffe\uffff"))
COMMENTS = st.text(st.characters(codec="ascii", exclude_categories=["Cc"]), max_size=10).filter(
    lambda t: "--" not in t and not t.endswith("-")
)
FLOATS = st.floats(width=32, allow_nan=False, allow_infinity=False)
INTS = st.integers(-(2**31), 2**31 - 1)

# Node type -> value fields by type; node fields with the type of their children.
VALUES = {
    "Transform": {"translation": "SFVec3f", "rotation": "SFRotation", "scale": "SFVec3f"},
    "HAnimJoint": {"center": "SFVec3f", "skinCoordIndex": "MFInt32", "skinCoordWeight": "MFFloat", "name": "SFString"},
    "Shape": {},
    "Appearance": {},
    "Material": {"transparency": "SFFloat", "diffuseColor": "SFColor"},
    "IndexedFaceSet": {"coordIndex": "MFInt32", "solid": "SFBool"},
    "Coordinate": {"point": "MFVec3f"},
    "WorldInfo": {"title": "SFString", "info": "MFString"},
    "TimeSensor": {"cycleInterval": "SFTime", "loop": "SFBool"},
    "ShipOfTheseus": {},
}
CHILDREN = {
    "Transform": [("children", ["Transform", "Shape", "WorldInfo", "TimeSensor", "ShipOfTheseus"])],
    "HAnimJoint": [("children", ["HAnimJoint", "Transform"]), ("displacers", ["ShipOfTheseus"])],
    "Shape": [("appearance", ["Appearance"]), ("geometry", ["IndexedFaceSet"])],
    "Appearance": [("material", ["Material"])],
    "IndexedFaceSet": [("coord", ["Coordinate"])],
    "ShipOfTheseus": [("planks", ["ShipOfTheseus", "Material"]), ("mast", ["WorldInfo"])],
}
SINGLE = {"appearance", "geometry", "material", "coord", "mast"}


def typed(kind: str) -> st.SearchStrategy:
    """Values of a field type."""
    columns = {"SFVec3f": 3, "SFRotation": 4, "SFColor": 3}
    if kind in columns:
        return st.lists(FLOATS, min_size=columns[kind], max_size=columns[kind]).map(np.array)
    return {
        "SFFloat": FLOATS,
        "SFTime": st.floats(allow_nan=False, allow_infinity=False),
        "SFBool": st.booleans(),
        "SFInt32": INTS,
        "SFString": STRINGS,
        "MFString": st.lists(STRINGS, min_size=1, max_size=3),
        "MFInt32": st.lists(INTS, max_size=5).map(lambda v: np.array(v, np.int32)),
        "MFFloat": st.lists(FLOATS, max_size=5).map(np.array),
        "MFVec3f": st.lists(st.lists(FLOATS, min_size=3, max_size=3), max_size=3).map(
            lambda v: np.array(v, float).reshape(-1, 3)
        ),
    }[kind]


def literals(syntax: str) -> st.SearchStrategy[Literal]:
    """Source text as files have it, for a field that nobody knows."""
    if syntax == "xml":
        return STRINGS.map(lambda t: Literal(t, "xml"))
    if syntax == "json":
        words = st.sampled_from(["0", "-1", "2.5e-07", "true", "null", "1E9", "NaN"])
        value = st.one_of(words, STRINGS.map(json.dumps), STRINGS.map(lambda t: json.dumps(t, ensure_ascii=False)))
        lists = st.lists(st.one_of(st.lists(words, max_size=9), st.lists(STRINGS.map(json.dumps), max_size=3)))
        flat = lists.map(lambda found: [v for vs in found[:1] for v in vs])
        return st.one_of(value, flat.map(lambda vs: f"[ {', '.join(vs)}\n]" if vs else "[1]")).map(
            lambda t: Literal(t, "json")
        )
    number = st.sampled_from(["0", "-1", "+2.5", ".5", "1e-3", "0x1F", "1.", "-.0E+7"])
    string = STRINGS.map(lambda t: '"' + t.replace("\\", "\\\\").replace('"', '\\"') + '"')
    booleans = st.sampled_from(["TRUE", "FALSE"])
    gap = st.sampled_from([" ", "\n", ", ", ' #x ] " {\n', "\t"])
    run = st.one_of(
        st.lists(st.tuples(token, gap), min_size=1, max_size=4).map(
            lambda pairs: "".join(t + g for t, g in pairs[:-1]) + pairs[-1][0]
        )
        for token in (number, string, booleans)
    )
    return st.one_of(run, run.map(lambda r: f"[ {r} ]"), run.map(lambda r: f"[{r}#y\n]")).map(
        lambda t: Literal(t, "vrml")
    )


@st.composite
def nodes(draw: st.DrawFn, kind: str, syntax: str, named: dict[str, Node], depth: int) -> Node:
    node = Node(kind)
    if draw(st.booleans()):
        node.name = draw(NAMES)
        if node.name in named:
            node.name = ""
    for name, type in VALUES[kind].items():
        if draw(st.booleans()):
            node.fields[name] = draw(typed(type))
    if kind == "ShipOfTheseus":
        for name in draw(st.lists(NAMES, max_size=2, unique=True)):
            node.fields[name] = draw(literals(syntax))
    if node.name:
        named[node.name] = node
    for field, kinds in CHILDREN.get(kind, []) if depth else []:
        if field in SINGLE:
            if draw(st.booleans()):
                node.fields[field] = draw(nodes(draw(st.sampled_from(kinds)), syntax, named, depth - 1))
                if draw(st.booleans()):
                    node.comments.append((field, Comment(draw(COMMENTS))))
            continue
        children: list = []
        for _ in range(draw(st.integers(0, 3))):
            what = draw(st.integers(0, 5))
            able = [n for n in named.values() if n.type in kinds and n is not node]
            if what == 0 and syntax == "vrml" or what == 0 and children and not isinstance(children[-1], Comment):
                children.append(Comment(draw(COMMENTS)))
            elif what == 1 and able:
                target = draw(st.sampled_from(able))
                children.append(Use(target.name, target, type="" if syntax == "vrml" else target.type))
            else:
                children.append(draw(nodes(draw(st.sampled_from(kinds)), syntax, named, depth - 1)))
        if children:
            # Two at least: of one alone nobody can tell whether a field that no table has is a list.
            while sum(not isinstance(c, Comment) for c in children) < 2:
                children.append(Node(kinds[0]))
            node.fields[field] = children
    return node


def without_cycles(scene: Scene) -> Scene:
    """A USE of a node that is open becomes a USE of nothing, as a reader has it."""
    for node in scene.walk():
        inside, stack = set(), [node]
        while stack:
            top = stack.pop()
            inside.add(id(top))
            stack.extend(v for _, v in top.entries() if isinstance(v, Node))
        for below in list(scene.walk()):
            if id(below) in inside:
                for _, entry in below.entries():
                    if isinstance(entry, Use) and entry.node is node:
                        entry.node, entry.name = None, "nobody"
    return scene


@st.composite
def scenes(draw: st.DrawFn, encoding: str) -> Scene:
    """A scene with nodes, USEs, comments, ROUTEs, a prototype with an instance, and fields of unknown type."""
    syntax = {"x3d": "xml", "x3dj": "json"}.get(encoding, "vrml")
    scene = Scene(encoding=encoding, version="2.0" if encoding == "wrl" else "4.0")
    if encoding != "wrl":
        scene.profile = draw(st.sampled_from(["Immersive", "Full"]))
        scene.components = draw(st.lists(st.tuples(NAMES, st.integers(1, 5)), max_size=2))
        scene.metas = draw(st.lists(st.tuples(PLAIN, PLAIN), max_size=2))
        scene.units = draw(st.lists(st.tuples(st.just("length"), NAMES, st.floats(1e-3, 1e3)), max_size=1))
    named: dict[str, Node] = {}
    if draw(st.booleans()):
        types = draw(st.lists(st.sampled_from(["SFVec3f", "MFString", "SFBool", "MFInt32", "SFTime"]), max_size=3))
        interface = [ProtoField("inputOutput", t, f"f{i}", draw(typed(t))) for i, t in enumerate(types)]
        inner = Node("Group", "root", connects=[("bboxCenter", "f0")] if types[:1] == ["SFVec3f"] else [])
        scene.body.append(Proto("Golem", interface, [inner]))
        given = {f"f{i}": draw(typed(t)) for i, t in enumerate(types)}
        scene.body.append(Node("Golem", "golem", given, instance=True))
    for _ in range(draw(st.integers(1, 3))):
        if draw(st.integers(0, 3)) == 0:
            scene.body.append(Comment(draw(COMMENTS)))
        kind = draw(st.sampled_from(["Transform", "HAnimJoint", "ShipOfTheseus", "WorldInfo"]))
        scene.body.append(draw(nodes(kind, syntax, named, 3)))
    if named and draw(st.booleans()):
        a, b = (draw(st.sampled_from(sorted(named))) for _ in "ab")
        scene.body.append(Route(a, draw(NAMES), b, draw(NAMES)))
    return without_cycles(scene)


def comments(scene: Scene) -> list[str]:
    """The texts of all comments, sorted."""
    found = [s.text for s in scene.body if isinstance(s, Comment)]
    for node in scene.walk():
        found += [c.text for _, c in node.comments]
        for value in node.fields.values():
            if isinstance(value, list):
                found += [v.text for v in value if isinstance(v, Comment)]
    return sorted(found)
