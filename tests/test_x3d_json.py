"""X3D JSON: what files in the wild have is read, what we write others read, and nothing is lost on the way."""

from __future__ import annotations

import gzip
import inspect
import json
import re
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scene_figure import GOOD
from vitruvian.errors import FileError, VitruvianError, VitruvianWarning
from vitruvian.formats import registry
from vitruvian.formats.convert import convert
from vitruvian.formats.json_tree import List, Object, Span, Tree, Value
from vitruvian.formats.vrml import parse_vrml
from vitruvian.formats.x3d import parse_x3d
from vitruvian.formats.x3d_json import parse_json
from vitruvian.formats.x3d_json_writer import print_json
from vitruvian.formats.x3d_writer import print_x3d
from vitruvian.hanim.compare import difference
from vitruvian.hanim.doctor import check
from vitruvian.hanim.fields import type_of
from vitruvian.hanim.graph import Comment, Literal, Node, Scene, Use
from vitruvian.hanim.json_values import WIDTH
from vitruvian.hanim.values import parse, text_of, translate
from vitruvian.hanim.view import humanoids


def world(*entries: str) -> bytes:
    return f'{{"X3D": {{"@version": "4.0", "Scene": {{"-children": [{", ".join(entries)}]}}}}}}'.encode()


def read(*entries: str) -> Scene:
    return parse_json(world(*entries), "t.x3dj")


def again(scene: Scene) -> Scene:
    text, lost = print_json(scene)
    assert lost == []
    json.loads(text)
    return parse_json(text.encode(), "t.x3dj")


# Ways of writing that are met in files, and what they mean in XML.
VARIANTS = {
    "typed values": (
        '{"Transform": {"@translation": [0, 2.5, -1e-3], "@rotation": [0,1,0,3], "@visible": false}}',
        "<Transform translation='0 2.5 -1e-3' rotation='0 1 0 3' visible='false'/>",
    ),
    "values as in XML": (
        '{"Transform": {"@translation": "0 2.5 -1e-3", "@visible": "true"}}',
        "<Transform translation='0 2.5 -1e-3' visible='true'/>",
    ),
    "vectors in lists of their own": (
        '{"Coordinate": {"@point": [[0, 0, 0], [1, 1.5, 1]]}}',
        "<Coordinate point='0 0 0 1 1.5 1'/>",
    ),
    "strings": (
        r'{"WorldInfo": {"@title": "a \"b\" \\ \u00e9", "@info": ["c", "d \"e\" \\"]}}',
        '<WorldInfo title=\'a "b" \\\\ é\' info=\'"c" "d \\"e\\" \\\\"\'/>',
    ),
    "one string for a list": ('{"WorldInfo": {"@info": "a=b"}}', "<WorldInfo info='a=b'/>"),
    "a number for a string": ('{"HAnimHumanoid": {"@version": 2.0}}', "<HAnimHumanoid version='2.0'/>"),
    "null for no value": ('{"Shape": {"@bboxSize": null, "-geometry": null}}', "<Shape/>"),
    "a list of one for a single node": (
        '{"Shape": {"-geometry": [{"Sphere": {"@radius": 2}}]}}',
        "<Shape><Sphere radius='2'/></Shape>",
    ),
    "an object for a list of one": (
        '{"Group": {"-children": {"Shape": {"-geometry": {"Box": {}}}}}}',
        "<Group><Shape><Box/></Shape></Group>",
    ),
    "several types in one object": ('{"Group": {}, "Shape": {}}', "<Group/><Shape/>"),
    "nodes without their field": (
        '{"Group": {"Shape": {"Appearance": {}, "Sphere": {}}, "Group": [{"@DEF": "a"}, {"@DEF": "b"}]}}',
        "<Group><Shape><Appearance/><Sphere/></Shape><Group DEF='a'/><Group DEF='b'/></Group>",
    ),
    "containerField": (
        '{"HAnimHumanoid": {"-children": [{"HAnimJoint": {"@containerField": "skeleton", "@DEF": "r"}}]}}',
        "<HAnimHumanoid><HAnimJoint containerField='skeleton' DEF='r'/></HAnimHumanoid>",
    ),
    "keys in the order of the alphabet": (
        '{"HAnimHumanoid": {"-joints": [{"HAnimJoint": {"@USE": "r"}}], '
        '"-skeleton": [{"HAnimJoint": {"-children": [{"Group": {}}], "@DEF": "r"}}], "@name": "h"}}',
        "<HAnimHumanoid name='h'><HAnimJoint DEF='r' containerField='skeleton'><Group/></HAnimJoint>"
        "<HAnimJoint USE='r' containerField='joints'/></HAnimHumanoid>",
    ),
    "a route inside a node": (
        '{"Group": {"-children": [{"ROUTE": {"@fromNode": "a", "@fromField": "b", "@toNode": "c", "@toField": "d"}}]}}',
        "<Group><ROUTE fromNode='a' fromField='b' toNode='c' toField='d'/></Group>",
    ),
    "a prototype": (
        '{"ProtoDeclare": {"ProtoBody": {"-children": [{"Group": {"IS": {"connect": '
        '{"@nodeField": "bboxSize", "@protoField": "s"}}}}]}, "ProtoInterface": {"field": {"@type": "SFVec3f", '
        '"@accessType": "inputOutput", "@name": "s", "@value": [1,1,1], "@appinfo": "size"}}, "@name": "P"}}, '
        '{"ProtoInstance": {"fieldValue": [{"@name": "s", "@value": [2,2,2]}], "@name": "P", "@DEF": "p"}}',
        "<ProtoDeclare name='P'><ProtoInterface><field name='s' accessType='inputOutput' type='SFVec3f' value='1 1 1' "
        "appinfo='size'/></ProtoInterface><ProtoBody><Group><IS><connect nodeField='bboxSize' protoField='s'/></IS>"
        "</Group></ProtoBody></ProtoDeclare><ProtoInstance name='P' DEF='p'><fieldValue name='s' value='2 2 2'/>"
        "</ProtoInstance>",
    ),
    "nodes for a prototype": (
        '{"ProtoDeclare": {"@name": "P", "ProtoInterface": {"field": [{"@name": "n", "@type": "SFNode", "@accessType": '
        '"inputOutput", "-children": [{"Box": {}}]}, {"@name": "m", "@type": "MFNode", "@accessType": "inputOutput"}]}, '
        '"ProtoBody": {"-children": [{"Group": {}}]}}}, {"ProtoInstance": {"@name": "P", "fieldValue": [{"@name": "n", '
        '"-children": [{"Sphere": {}}]}, {"@name": "m", "-children": [{"Group": {}}]}]}}',
        "<ProtoDeclare name='P'><ProtoInterface><field name='n' type='SFNode' accessType='inputOutput'><Box/></field>"
        "<field name='m' type='MFNode' accessType='inputOutput'/></ProtoInterface><ProtoBody><Group/></ProtoBody>"
        "</ProtoDeclare><ProtoInstance name='P'><fieldValue name='n'><Sphere/></fieldValue><fieldValue name='m'><Group/>"
        "</fieldValue></ProtoInstance>",
    ),
    "a foreign prototype": (
        '{"ExternProtoDeclare": {"@name": "E", "@url": ["e.x3d#E"], "field": [{"@name": "f", "@type": "SFBool", '
        '"@accessType": "inputOutput"}]}}, {"ProtoInstance": {"@name": "E", "fieldValue": {"@name": "f", "@value": true}}}',
        "<ExternProtoDeclare name='E' url='\"e.x3d#E\"'><field name='f' type='SFBool' accessType='inputOutput'/>"
        "</ExternProtoDeclare><ProtoInstance name='E'><fieldValue name='f' value='true'/></ProtoInstance>",
    ),
    "a program": (
        '{"Script": {"@url": ["a.js"], "field": [{"@accessType": "inputOnly", "@type": "SFBool", "@name": "b"}], '
        '"#sourceText": ["javascript:", "  if (a < b) {}"]}}',
        "<Script url='\"a.js\"'><field accessType='inputOnly' type='SFBool' name='b'/>"
        "<![CDATA[javascript:\n  if (a < b) {}]]></Script>",
    ),
    "a program as one string": (
        '{"Script": {"#sourceCode": "ecmascript: x"}}',
        "<Script><![CDATA[ecmascript: x]]></Script>",
    ),
    "imports and exports": (
        '{"Inline": {"@DEF": "i"}}, {"IMPORT": {"@inlineDEF": "i", "@importedDEF": "a", "@AS": "b"}}, '
        '{"EXPORT": {"@localDEF": "i", "@AS": "j"}}',
        "<Inline DEF='i'/><IMPORT inlineDEF='i' importedDEF='a' AS='b'/><EXPORT localDEF='i' AS='j'/>",
    ),
    "unknown nodes and fields": (
        '{"Unheard": {"@of": [1, 2], "@word": "x", "-parts": [{"Part": {}}, {"Part": {"@n": "\\"1\\""}}]}}',
        "<Unheard of='1 2' word='x'><Part containerField='parts'/><Part containerField='parts' n='\"1\"'/></Unheard>",
    ),
}


@pytest.mark.parametrize("case", VARIANTS)
def test_variants(case: str) -> None:
    entries, xml = VARIANTS[case]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = read(entries)
    expected = parse_x3d(f"<X3D version='4.0'><Scene>{xml}</Scene></X3D>".encode())
    assert difference(expected, scene, typed=True) == ""
    assert difference(scene, again(scene)) == ""
    assert [type(s) for s in scene.body] == [type(s) for s in expected.body]


def test_head() -> None:
    data = """{"X3D": {"encoding": "UTF-8", "@profile": "Immersive", "@version": 3.3, "JSON schema": "x", "head": {
      "-children": [{"#comment": "first"}], "component": {"@name": "H-Anim", "@level": "1"},
      "unit": [{"@category": "angle", "@name": "degree", "@conversionFactor": 0.0174533}],
      "meta": [{"@name": "title", "@content": "a"}, {"@name": "title", "@content": "b"}]}, "Scene": {}}}"""
    scene = parse_json(data.encode())
    assert (scene.version, scene.profile, scene.encoding) == ("3.3", "Immersive", "x3dj")
    assert scene.components == [("H-Anim", 1)]
    assert scene.units == [("angle", "degree", 0.0174533)]
    assert scene.metas == [("title", "a"), ("title", "b")]
    assert [c.text for c in scene.header_comments] == ["first"]
    assert difference(scene, again(scene)) == ""
    xml, lost = convert(scene, "x3d")
    assert lost == []
    assert difference(scene, convert(xml, "x3dj")[0]) == ""


def test_comments_stay_where_json_can_have_them() -> None:
    scene = read(
        '{"#comment": "a"}',
        '{"Group": {"@DEF": "g", "-children": [{"#comment": "b"}, {"Shape": {"-children": [{"#comment": "c"}], '
        '"-geometry": {"Box": {"#comment": ["d", "e"]}}}}, {"#comment": "f"}]}}',
        '{"ProtoDeclare": {"@name": "P", "ProtoInterface": {"-children": [{"#comment": "h"}], "field": [{"@name": "n", '
        '"@type": "SFBool", "@accessType": "inputOnly"}]}, '
        '"ProtoBody": {"-children": [{"#comment": "i"}, {"Group": {}}]}}}',
    )
    first, group, proto = scene.body
    assert isinstance(first, Comment) and isinstance(group, Node)
    before, shape, after = group.fields["children"]  # type: ignore[misc]
    assert (first.text, before.text, after.text) == ("a", "b", "f")
    assert [(n, c.text) for n, c in shape.comments] == [("geometry", "c")]
    assert [c.text for _, c in shape.fields["geometry"].comments] == ["d", "e"]
    assert [(n, c.text) for n, c in proto.comments] == [("n", "h")]  # type: ignore[union-attr]
    assert difference(scene, again(scene)) == ""


def test_untouched_values_come_back_as_they_stood() -> None:
    values = [
        "[ 0,1.50,\n\n2e0 ]",
        "[0.10,1,1,0]",
        '"\\u0041\\/"',
        '[ "a" ,"b"]',
        "[[1,2,3],[4,5,6]]",
        "null",
        "1E+2",
        "NaN",
    ]
    scene = read(*(f'{{"Unheard": {{"@a": {v}}}}}' for v in values))
    text, _ = print_json(scene)
    for node, value in zip(scene.body, values, strict=True):
        assert node.fields["a"].text == value  # type: ignore[union-attr]
        assert f'"@a": {value}\n' in text


def test_written_form() -> None:
    """One row of a vector list a line, bounded width, faces by line; valid JSON with no key twice."""
    rng = np.random.default_rng(0)
    points, weights = rng.normal(size=(7, 3)), rng.random(50)
    faces = np.array([0, 1, 2, -1, 2, 3, 0, -1], np.int32)
    shape = Node("IndexedFaceSet", fields={"coordIndex": faces, "coord": Node("Coordinate", fields={"point": points})})
    joint = Node("HAnimJoint", "j", {"skinCoordWeight": weights, "center": np.array([0.1, 1, 2]), "name": "vl5"})
    joint.fields["children"] = [Node("Shape", fields={"geometry": shape})]
    scene = Scene(encoding="x3dj", body=[joint])
    text, _ = print_json(scene)
    lines = text.splitlines()
    assert max(map(len, lines)) <= WIDTH + 20
    assert any(line.strip() == "0, 1, 2, -1," for line in lines)
    rows = [
        line.strip().rstrip(",").split(", ")
        for line in lines[lines.index(next(v for v in lines if '"@point"' in v)) + 1 :]
    ]
    assert [len(r) for r in rows[:7]] == [3] * 7
    np.testing.assert_array_equal(np.array(rows[:7], np.float64).astype(np.float32), points.astype(np.float32))
    assert '"@center": [0.1, 1, 2]' in text
    assert difference(scene, parse_json(text.encode()), typed=True) == ""

    def once(pairs: list[tuple[str, object]]) -> dict[str, object]:
        assert len({k for k, _ in pairs}) == len(pairs)
        return dict(pairs)

    found = json.loads(text, object_pairs_hook=once)
    body = found["X3D"]["Scene"]["-children"][0]["HAnimJoint"]
    assert body["@DEF"] == "j"
    assert body["-children"][0]["Shape"]["-geometry"]["IndexedFaceSet"]["@coordIndex"] == faces.tolist()


def test_a_small_change_is_a_small_difference() -> None:
    points = np.arange(300.0).reshape(-1, 3)
    scene = Scene(encoding="x3dj", body=[Node("Coordinate", fields={"point": points})])
    before = print_json(scene)[0].splitlines()
    points[40, 1] += 0.5
    after = print_json(scene)[0].splitlines()
    assert sum(a != b for a, b in zip(before, after, strict=True)) == 1


VALUES = [
    ("SFFloat", "+.5", "0.5"),
    ("SFFloat", "1.", "1"),
    ("SFFloat", "-007.250E+1", "-7.250E+1"),
    ("SFInt32", "0x1F", "31"),
    ("SFVec3f", "0 1,2", "[0, 1, 2]"),
    ("MFFloat", "3", "[3]"),
    ("MFFloat", "", "[]"),
    ("SFBool", "true", "true"),
    ("MFBool", "true false", "[true, false]"),
    ("SFString", "12", '"12"'),
    ("SFString", 'a \\"b\\" \\\\ \n', '"a \\"b\\" \\\\ \\n"'),
    ("MFString", '"a" "b\\"c"', '["a", "b\\"c"]'),
    ("MFString", "a b", '["a b"]'),
    ("SFVec3f", "0 nan 1", '"0 nan 1"'),
    ("SFFloat", "zero", '"zero"'),
    ("SFVec3f", "1 2", "[1, 2]"),
    ("", "1 2 3", "[1, 2, 3]"),
    ("", "1", "1"),
    ("", "true", "true"),
    ("", "some words", '"some words"'),
    ("", '"a" "b"', '["a", "b"]'),
    ("", '"a', '"\\"a"'),
]


@pytest.mark.parametrize(("kind", "xml", "text"), VALUES)
def test_values_from_xml(kind: str, xml: str, text: str) -> None:
    """Numbers become JSON's with the digits they had; what is no value of its type stays the same defect."""
    here, there = Literal(xml, "xml", 1), Literal(text, "json", 1)
    found = translate(here, kind, "json")
    assert found is not None
    assert json.loads(found) == json.loads(text)
    if not kind:
        return
    results: list[object] = []
    for literal in (here, there):
        try:
            results.append(text_of(parse(literal, kind), kind, "vrml"))
        except FileError as error:
            results.append(error.what.split(", found")[0])
    assert results[0] == results[1]


@pytest.mark.parametrize(
    ("kind", "vrml", "text"),
    [
        ("SFNode", "NULL", "null"),
        ("MFFloat", "[ 1, 2 # c\n 3 ]", "[1, 2, 3]"),
        ("MFString", '[ "a" ]', '["a"]'),
        ("SFString", '"a" "b"', '["a", "b"]'),
        ("", '"TRUE"', '"TRUE"'),
        ("", "[ TRUE ]", "[true]"),
        ("", "NULL", "null"),
        ("", "[ ]", "[]"),
    ],
)
def test_values_from_vrml(kind: str, vrml: str, text: str) -> None:
    found = translate(Literal(vrml, "vrml"), kind, "json")
    assert found is not None and json.loads(found) == json.loads(text)


@settings(max_examples=100, deadline=None, database=None)
@given(st.floats(width=32, allow_nan=False, allow_infinity=False), st.lists(st.text(max_size=6), max_size=4))
def test_typed_values_come_back(number: float, strings: list[str]) -> None:
    text = text_of(number, "SFFloat", "json")
    assert np.float32(json.loads(text)) == np.float32(number)
    assert np.float32(parse(Literal(text, "json"), "SFFloat")) == np.float32(number)  # type: ignore[arg-type]
    kept = [s.encode("utf-8", "replace").decode().replace("\0", "\ufffd") for s in strings]
    assert parse(Literal(text_of(strings, "MFString", "json"), "json"), "MFString") == kept


def test_numbers_that_are_not_finite_are_for_the_doctor() -> None:
    text = '{"HAnimHumanoid": {"@name": "h", "-skeleton": [{"HAnimJoint": {"@name": "r",\n"@center": [0,\nNaN, 0]}}]}}'
    scene = read(text)
    joint = next(n for n in scene.walk() if n.type == "HAnimJoint")
    with pytest.raises(FileError, match="expected a finite number, found 'NaN'") as caught:
        parse(joint.fields["center"], "SFVec3f", "t.x3dj")  # type: ignore[arg-type]
    assert caught.value.line == 3
    assert any(f.severity == "error" and f.line in (2, 3) for f in check(scene))
    with pytest.raises(FileError):
        humanoids(scene)
    for literal in ("[0, -Infinity, 1]", '"0 nan 1"', '[0, "nan", 1]'):
        with pytest.raises(FileError, match="finite"):
            parse(Literal(literal, "json"), "SFVec3f")


def test_numbers_that_json_writes_otherwise_are_read_with_one_warning() -> None:
    with pytest.warns(VitruvianWarning, match=r"t.x3dj:2: \.5 is not how JSON writes a number") as said:
        scene = read('{"Transform": {"@translation": [0,\n.5, +1], "@scale": [01, 1., 1]}}')
    assert len(said) == 1
    (node,) = scene.walk()
    np.testing.assert_array_equal(parse(node.fields["translation"], "SFVec3f"), [0, 0.5, 1])  # type: ignore[arg-type]
    np.testing.assert_array_equal(parse(node.fields["scale"], "SFVec3f"), [1, 1, 1])  # type: ignore[arg-type]


def test_lines_of_everything() -> None:
    scene = read(
        '\n{"Group": {\n"@DEF": "g", "@bboxSize":\n[1, 1, 1],\n"-children": [{"#comment": "c"},\n{"Shape": {}}]}}',
        '\n{"ROUTE": {"@fromNode": "g", "@fromField": "a", "@toNode": "g", "@toField": "b"}}',
    )
    group, route = scene.body
    assert isinstance(group, Node)
    comment, shape = group.fields["children"]  # type: ignore[misc]
    lines = (group.line, group.fields["bboxSize"].line, comment.line, shape.line, route.line)  # type: ignore[union-attr]
    assert lines == (2, 3, 5, 6, 7)


def test_keys_have_no_order_but_lists_have() -> None:
    """A USE finds its DEF in a later key of a node around both, not later in the same list."""
    scene = read('{"Shape": {"-geometry": {"Box": {"@USE": "b"}}, "-spare": {"Box": {"@DEF": "b"}}}}')
    (shape,) = [s for s in scene.body if isinstance(s, Node)]
    assert list(shape.fields) == ["spare", "geometry"]
    assert isinstance(shape.fields["geometry"], Use)
    assert shape.fields["geometry"].node is shape.fields["spare"]
    with pytest.warns(VitruvianWarning, match="USE a names no node before it"):
        scene = read('{"Group": {"@USE": "a"}}', '{"Group": {"@DEF": "a"}}')
    assert scene.body[0].node is None  # type: ignore[union-attr]


def test_uses_in_a_circle_stand_for_nothing() -> None:
    with pytest.warns(VitruvianWarning, match="names no node before it"):
        scene = read(
            '{"N": {"-f": {"Group": {"@DEF": "a", "-children": [{"Group": {"@USE": "b"}}]}}, '
            '"-g": {"Group": {"@DEF": "b", "-children": [{"Group": {"@USE": "a"}}, {"Group": {"@USE": "b"}}]}}}}'
        )
    assert sum(1 for _ in scene.walk()) == 3
    uses = [e for n in scene.walk() for _, e in n.entries() if isinstance(e, Use)]
    assert sum(u.node is None for u in uses) == 2
    for encoding in ("x3d", "x3dv", "wrl"):
        assert difference(scene, convert(scene, encoding)[0], typed=True) == ""


@pytest.mark.parametrize("kind", ["ProtoDeclare", "Script"])
def test_fields_in_fields_need_no_recursion(kind: str) -> None:
    """300 declarations, each in the default value of a field of the one before."""
    field = '"field": [{"@name": "f", "@type": "MFNode", "@accessType": "inputOutput", "-children": ['
    head = f'{{"{kind}": {{"@name": "P", {field}'
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(150 + len(inspect.stack()))
    try:
        scene = read(head * 300 + '{"Group": {}}' + "]}]}}" * 300)
        text, lost = print_json(scene)
        print_x3d(scene)
    finally:
        sys.setrecursionlimit(limit)
    assert (text.count(f'"{kind}"'), lost) == (300, [])


def test_names_that_are_not_there() -> None:
    scene = read('{"Group": {"@DEF": null}}', '{"ROUTE": {"@fromNode": "a", "@fromField": null}}')
    group, route = scene.body
    assert (group.name, route.from_field) == ("", "")  # type: ignore[union-attr]
    for entry, message in (
        ('{"ProtoInstance": {"@DEF": "p"}}', "ProtoInstance needs the name"),
        ('{"ProtoDeclare": {"ProtoBody": {}}}', "ProtoDeclare needs a name"),
        ('{"Group": {"@DEF": {}}}', "expected @DEF to be a string"),
        ('{"Group": {"@bboxSize": {}}}', "expected @bboxSize to be a value"),
        ('{"Group": {"@bboxSize": [[[1]]]}}', "expected @bboxSize to be a value"),
        ('{"Group": {"-children": 3}}', "expected nodes in -children, found '3'"),
        ('{"Group": [1]}', "expected the fields of Group in an object, found '\\['"),
        ('{"ROUTE": 1}', "expected ROUTE to be an object"),
    ):
        with pytest.raises(FileError, match=message):
            read(entry)


def test_a_json_file_is_what_its_top_says(tmp_path: Path) -> None:
    text = print_json(convert(parse_x3d(GOOD.encode()), "x3dj")[0])[0]
    for name, data in {
        "a.x3dj": text.encode(),
        "a.json": text.encode(),
        "b.json": b"\xef\xbb\xbf" + text.encode().replace(b"\n", b"\r\n"),
        "c.json": text.replace('{"X3D"', '{"$schema": "x", "X3D"', 1).encode(),
        "d.json.gz": gzip.compress(text.encode()),
    }.items():
        (tmp_path / name).write_bytes(data)
        assert registry.kind(tmp_path / name) == ".x3dj"
        assert registry.load(tmp_path / name).joint("l_elbow").name == "l_elbow"
    wanted = r'expected \{"X3D": ...\} or \{"pattern": ...\} or .* at the top of a .json file, found '
    for content, found in {
        '{"panels": {}}': "'panels'",
        "[1, 2]": "no object with keys",
        "{}": "no object with keys",
    }.items():
        (tmp_path / "p.json").write_text(content)
        for ask in (registry.load, registry.scene):
            with pytest.raises(FileError, match=wanted + found):
                ask(tmp_path / "p.json")
    with pytest.raises(VitruvianError, match="no such file"):
        registry.load(tmp_path / "missing.json")


def test_a_humanoid_goes_out_and_in(tmp_path: Path) -> None:
    """Through its own graph and afresh, to .x3dj and .json, and repaired in place."""
    (tmp_path / "a.x3d").write_text(GOOD)
    h = registry.load(tmp_path / "a.x3d")
    for name, version in (("b.json", None), ("c.x3dj", "2.0"), ("d.json", "1.1")):
        report = registry.save(h, tmp_path / name, hanim=version)
        back = registry.load(tmp_path / name)
        assert len(back.joints()) == len(h.joints())
        np.testing.assert_allclose(back.joint("l_elbow").center, h.joint("l_elbow").center, atol=1e-7)
        np.testing.assert_allclose(back.skin_coord, h.skin_coord, atol=1e-7)
        assert version == "1.1" or report["lost"] == []
    knee = back.joint("l_elbow")
    knee.center = knee.center + [0, 0.25, 0]
    registry.save(back, tmp_path / "e.json")
    assert (tmp_path / "e.json").read_text() != (tmp_path / "d.json").read_text()
    np.testing.assert_allclose(registry.load(tmp_path / "e.json").joint("l_elbow").center, knee.center, atol=1e-7)


def test_the_doctor_says_the_same_in_json(shared: Path, tmp_path: Path) -> None:
    """Same rules at the same places; containerFields aside, which JSON has no need of."""
    for name in ("JoeKick.x3d", "HAnimModelHandLeft.x3d", "sample1.wrl"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene = registry.scene(shared / "data" / "hanim" / name)
            if scene.encoding == "wrl":
                scene, _ = convert(scene, "x3dv")  # VRML97 may give a DEF twice
            there, _ = convert(scene, "x3dj")
            here, others = (
                [(f.rule, f.where, re.sub("line [0-9]+", "line", f.message)) for f in check(s) if f.rule != "F06"]
                for s in (scene, there)
            )
            assert here == others
            lines = print_json(there)[0].splitlines()
            for finding in check(there):
                assert 0 < finding.line <= len(lines)
            registry.write_scene(there, tmp_path / "a.json")
            done = registry.fix(tmp_path / "a.json", tmp_path / "b.json")
            assert not [d for d in done if "containerField" in d]
            assert registry.fix(tmp_path / "b.json", tmp_path / "c.json") == []


def typed(scene: Scene) -> int:
    """Ask for every value of a known type; how many."""
    count, protos = 0, scene.protos()
    for node in scene.walk():
        for key, value in node.fields.items():
            kind = type_of(node, key, protos)
            if isinstance(value, Literal) and kind:
                parse(value, kind)
                count += 1
    return count


def test_reading_numbers_is_fast(shared: Path) -> None:
    """The largest skinned file, all values typed: at most four times what XML takes, in one run.

    As JSON it is half as long again, and what reads XML is native code.
    """
    xml = (shared / "data/hanim/JinNoAnimations_Fixed.x3d").read_bytes()
    data = print_json(convert(parse_x3d(xml), "x3dj")[0])[0].encode()
    best = {}
    for _ in range(5):
        for name, read_all in (("xml", lambda: typed(parse_x3d(xml))), ("json", lambda: typed(parse_json(data)))):
            start = time.process_time()
            assert read_all() > 1000
            best[name] = min(best.get(name, 9.0), time.process_time() - start)
    assert best["json"] < 4 * best["xml"]


# The tree below


def plain(tree: Tree, value: Value) -> object:
    """What Python's own reader makes of it."""
    if isinstance(value, Object):
        return {key: plain(tree, v) for key, (_, v) in value.items.items()}
    if isinstance(value, List):
        return [plain(tree, v) for v in value.items]
    assert isinstance(value, Span)
    return json.loads(tree.source(value))


DOCUMENTS = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=4), inner, max_size=4),
    max_leaves=20,
)


@settings(max_examples=120, deadline=None, database=None)
@given(DOCUMENTS, st.sampled_from([None, 1]), st.booleans())
def test_any_document_is_read_as_python_reads_it(document: object, indent: int | None, ascii_only: bool) -> None:
    text = json.dumps(document, indent=indent, ensure_ascii=ascii_only)
    if "\\u" in text and ("\\u0000" in text or "\\ud" in text.lower()):
        return  # NUL and halves of surrogates are replaced
    tree = Tree("t", text)
    assert plain(tree, tree.top) == document


@settings(max_examples=120, deadline=None, database=None)
@given(DOCUMENTS, st.integers(0, 200), st.sampled_from(['"', "{", "}", "[", "]", ",", ":", "x", "\\", "0", ""]))
def test_what_python_refuses_is_refused(document: object, place: int, new: str) -> None:
    text = json.dumps(document)
    place %= len(text)
    broken = text[:place] + new + text[place + 1 :]
    try:
        json.loads(broken, strict=False)
        fine = True
    except ValueError:
        fine = False
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            Tree("t", broken)
        ours = True
    except (FileError, VitruvianWarning):
        ours = False
    doubled = fine and not ours  # the one thing that Python takes and we don't
    assert ours == fine or doubled and "twice" in str(_error(broken)) or ours and "\\" in broken


def _error(text: str) -> Exception | None:
    try:
        Tree("t", text)
    except FileError as error:
        return error
    return None


def test_vrml_to_json_keeps_comments() -> None:
    text = b"#VRML V2.0 utf8\n#a\nGroup { #b\n bboxSize 1 1 1 #c\n children [ #d\n Shape { #e\n } ] #f\n }"
    scene = parse_vrml(text)
    found, lost = convert(scene, "x3dj")
    assert lost == []
    written, _ = print_json(found)
    assert [w for w in "abcdef" if f'"#comment": "{w}"' in written] == list("abcdef")
    assert difference(found, again(found)) == ""
