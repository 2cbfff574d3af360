"""VRML97 and Classic X3D: what the reader makes of each construct, and that the writer gives it back."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from vitruvian.errors import FileError, VitruvianWarning
from vitruvian.formats.convert import convert
from vitruvian.formats.vrml import parse_vrml, read_vrml, write_vrml
from vitruvian.formats.vrml_lexer import legal_name
from vitruvian.formats.vrml_writer import print_vrml
from vitruvian.formats.x3d import parse_x3d, read_x3d, write_x3d
from vitruvian.hanim.compare import difference
from vitruvian.hanim.fields import type_of
from vitruvian.hanim.graph import Comment, Literal, Node, Scene, Use
from vitruvian.hanim.values import parse, value

FILES = ["NancyPrototypes.wrl", "sample1.wrl", "JoeHAnimKick1a.x3dv", "hanim_transforms.x3dv"]
BODY = """#VRML V2.0 utf8 made by hand
# first
PROTO Joint [ # the interface
  exposedField SFVec3f center 0 0 0
  field MFNode children [ Group { } ] # a default
  eventIn SFRotation set_it
] {
  DEF inner Transform { center IS center  translation IS center  children IS children }
  ROUTE inner.rotation_changed TO inner.set_rotation
}
EXTERNPROTO Far [ exposedField SFNode thing ] [ "a.wrl#Far" "b.wrl" ]
DEF root Joint {
  center 0, 0.9 , # a comma is a blank
    0
  children [
    # inside the list
    DEF knee Joint { center 0 .5 0 children USE nothing }
    USE knee, Wobble { depth 0x1F  mood [ "a # no comment" "b\\"c" ]  odd [ 1 # one
      2 ] flag TRUE word "x" more [ Group {} ] }
    ROUTE knee.a TO root.b
    # at the end of the list
  ]
}
DEF S Script {
  eventIn SFFloat set_fraction
  field SFNode target USE root
  field MFString names [ ]
  eventOut SFTime done
  url "javascript:
    function set_fraction(v) { done = v; }"
  directOutput TRUE
}
ROUTE S.done TO root.set_it
Shape { geometry IndexedFaceSet { coord Coordinate { point [ 0 0 0, 1 0 0, # corner
   0 1 0 ] } coordIndex [ 0 1 2 -1 ] } appearance NULL }
# last"""
CLASSIC = """#X3D V3.3 utf8
PROFILE Interchange
COMPONENT H-Anim:1
COMPONENT Core : 2
UNIT length inch 0.0254
META "title" "a \\"b\\""
DEF I Inline { url "x.x3d" }
IMPORT I.part AS mine
EXPORT mine AS yours
PROTO P [ inputOutput SFTime t 0 exposedField SFBool b true initializeOnly MFNode n [] ] { Group { } }
P { t 1 }
"""


def scene_of(text: str, header: str = "#VRML V2.0 utf8") -> Scene:
    return parse_vrml(f"{header}\n{text}".encode(), "t.wrl")


def comes_back(scene: Scene) -> str:
    text, lost = print_vrml(scene)
    assert lost == []
    return difference(scene, parse_vrml(text.encode(), scene.path))


@pytest.fixture
def body() -> Scene:
    with pytest.warns(VitruvianWarning, match=r"b.wrl:17: USE nothing names no node before it; it stands"):
        return parse_vrml(BODY.encode(), "b.wrl")


def test_header_and_comments(body: Scene) -> None:
    assert (body.encoding, body.version) == ("wrl", "2.0")
    assert body.header_comments[0].text == "made by hand"
    assert body.body[0] == Comment(" first", 2)
    assert body.body[-1].text == " last"
    root = body.defs()["root"]
    texts = [v.text for v in root.fields["children"] if isinstance(v, Comment)]
    assert texts == [" inside the list", " at the end of the list"]


def test_prototypes(body: Scene) -> None:
    joint, far = body.protos()["Joint"], body.protos()["Far"]
    assert [(f.access, f.type, f.name) for f in joint.interface] == [
        ("inputOutput", "SFVec3f", "center"),
        ("initializeOnly", "MFNode", "children"),
        ("inputOnly", "SFRotation", "set_it"),
    ]
    assert [(n, c.text) for n, c in joint.comments] == [("center", " the interface"), ("set_it", " a default")]
    inner = joint.body[0]
    assert inner.connects == [("center", "center"), ("translation", "center"), ("children", "children")]
    assert joint.body[1].to_field == "set_rotation"
    assert far.external
    assert far.interface[0].value is None
    assert "inner" not in body.defs()  # a prototype's names are its own


def test_instances_and_unknown_nodes(body: Scene) -> None:
    root = body.defs()["root"]
    assert root.instance
    assert value(root, "center", "SFVec3f").tolist() == [0, 0.9, 0]
    knee, again, wobble = root.children("children")
    assert again is knee
    assert knee.children("children") == []  # its USE stands for nothing
    assert parse(wobble.fields["depth"], "SFInt32") == 31
    assert parse(wobble.fields["mood"], "MFString") == ["a # no comment", 'b"c']
    assert parse(wobble.fields["odd"], "MFInt32").tolist() == [1, 2]
    assert wobble.children("more")[0].type == "Group"


def test_statements_inside_nodes_are_lifted(body: Scene) -> None:
    kinds = [type(s).__name__ for s in body.body]
    assert kinds == ["Comment", "Proto", "Proto", "Node", "Route", "Node", "Route", "Node", "Comment"]


def test_scripts(body: Scene) -> None:
    script = body.defs()["S"]
    assert [f.name for f in script.interface] == ["set_fraction", "target", "names", "done"]
    assert isinstance(script.interface[1].value, Use)
    assert script.interface[1].value.node is body.defs()["root"]
    assert list(script.fields) == ["url", "directOutput"]
    assert "\n    function" in parse(script.fields["url"], "MFString")[0]
    xml, lost = convert(body, "x3d")
    assert lost == ["USE nothing stands for nothing, so its type is not known; written as a Group"]
    assert "\n    function" in parse(xml.defs()["S"].fields["url"], "MFString")[0]


def test_it_comes_back(body: Scene) -> None:
    with pytest.warns(VitruvianWarning, match="USE nothing"):
        assert comes_back(body) == ""


def test_classic(tmp_path: Path) -> None:
    scene = parse_vrml(CLASSIC.encode(), "c.x3dv")
    assert (scene.encoding, scene.version, scene.profile) == ("x3dv", "3.3", "Interchange")
    assert scene.components == [("H-Anim", 1), ("Core", 2)]
    assert scene.units == [("length", "inch", 0.0254)]
    assert scene.metas == [("title", 'a "b"')]
    assert [type(s).__name__ for s in scene.body] == ["Node", "Import", "Export", "Proto", "Node"]
    assert scene.protos()["P"].interface[1].access == "inputOutput"
    assert comes_back(scene) == ""
    xml, lost = convert(scene, "x3d")
    assert lost == []
    assert difference(scene, xml, typed=True) == ""
    assert (xml.components, xml.units, xml.metas) == (scene.components, scene.units, scene.metas)
    assert [type(s).__name__ for s in xml.body] == [type(s).__name__ for s in scene.body]
    text, lost = print_vrml(scene, "wrl")
    assert lost == [
        "UNIT length inch 0.0254: VRML97 has no units",
        "IMPORT part: VRML97 has none",
        "EXPORT mine: VRML97 has none",
    ]
    assert "exposedField SFTime t 0" in text


def test_bom_crlf_and_gzip(tmp_path: Path) -> None:
    data = b"\xef\xbb\xbf" + CLASSIC.replace("\n", "\r\n").encode()
    path = tmp_path / "c.x3dv"
    path.write_bytes(gzip.compress(data))
    assert difference(read_vrml(path), parse_vrml(CLASSIC.encode())) == ""


def test_latin_1_is_read_with_a_warning() -> None:
    with pytest.warns(VitruvianWarning, match="t.wrl:2: not UTF-8; read as Latin-1"):
        scene = parse_vrml('#VRML V2.0 utf8\nWorldInfo { title "Zoë" }'.encode("latin-1"), "t.wrl")
    assert parse(scene.body[0].fields["title"], "SFString") == "Zoë"


def test_lists_with_and_without_brackets() -> None:
    scene = scene_of("Group { children Group {} } Group { children [ ] } Group { children [ # c\n ] } X { y [ ] }")
    one, none, comment, unknown = scene.body
    assert one.children("children")[0].type == "Group"
    assert none.fields["children"] == []
    assert comment.fields["children"] == [Comment(" c", 2)]
    assert unknown.fields["y"] == Literal("[ ]", "vrml", 3)
    assert comes_back(scene) == ""


def test_comments_between_fields() -> None:
    scene = scene_of("Transform { # a\n translation # b\n 1 2 3 # c\n # d\n scale 1 1 1 # e\n }")
    node = scene.body[0]
    found = [(n, c.text) for n, c in node.comments]
    assert found == [("translation", " a"), ("translation", " b"), ("scale", " c"), ("scale", " d"), ("", " e")]
    assert comes_back(scene) == ""


def test_a_field_given_twice() -> None:
    with pytest.warns(VitruvianWarning, match="t.wrl:2: Transform gives scale twice"):
        scene = scene_of("Transform { scale 1 1 1 scale 2 2 2 }")
    assert scene.body[0].fields["scale"].text == "2 2 2"
    with pytest.warns(VitruvianWarning, match="children twice"):
        scene = scene_of("Group { children [ DEF a Group {} ] children [ USE a ] }")
    assert len(scene.body[0].children("children")) == 2


def test_words_of_vrml97_and_x3d() -> None:
    scene = parse_x3d(
        b"<X3D version='3.3'><Scene><Switch><Group/></Switch><LOD><Group/></LOD><Collision enabled='false'/></Scene>"
        b"</X3D>"
    )
    text, _ = print_vrml(scene, "wrl")
    for word in ("choice [", "level [", "collide FALSE"):
        assert word in text
    vrml = parse_vrml(text.encode())
    assert difference(scene, vrml, typed=True) == ""
    assert difference(scene, convert(vrml, "x3d")[0], typed=True) == ""


def test_names_that_vrml_can_not_say() -> None:
    scene = parse_x3d(
        b"<X3D version='3.3'><Scene><Group DEF='a b'/><Group USE='a b'/><Group DEF='3.5'/><Group DEF='field'/>"
        b"<ROUTE fromNode='a b' fromField='x' toNode='3.5' toField='y'/></Scene></X3D>"
    )
    vrml, lost = convert(scene, "x3dv")
    assert list(vrml.defs()) == ["a_b", "_3_5", "_field"]
    assert vrml.body[1].node is vrml.body[0]
    assert vrml.routes()[0].to_node == "_3_5"
    assert lost == ["name 'a b', written as a_b", "name '3.5', written as _3_5", "name 'field', written as _field"]
    assert legal_name("l_hip-2") and not legal_name("-a") and not legal_name("TO")


def test_a_script_s_program_becomes_a_url() -> None:
    scene = parse_x3d(
        b"<X3D version='3.3'><Scene><Script url='\"a.js\"'><![CDATA[ecmascript: \"x\"]]></Script></Scene></X3D>"
    )
    vrml, lost = convert(scene, "x3dv")
    assert parse(vrml.body[0].fields["url"], "MFString") == ["a.js", 'ecmascript: "x"']
    assert lost == []
    assert difference(scene, vrml, typed=True) == ""


def test_fields_of_unknown_type_are_kept_by_what_they_look_like() -> None:
    attributes = "n='1 2 3' many='1 2 3 4 5' s='two words' list='\"a\" \"b\"' flag='true' empty=''"
    scene = parse_x3d(f"<X3D version='3.3' profile='Full'><Scene><Wobble {attributes}/></Scene></X3D>".encode())
    vrml, lost = convert(scene, "x3dv")
    texts = {k: v.text for k, v in vrml.body[0].fields.items()}
    assert texts == {
        "n": "1 2 3",
        "many": "[ 1 2 3 4 5 ]",
        "s": '"two words"',
        "list": '[ "a" "b" ]',
        "flag": "TRUE",
        "empty": '""',
    }
    assert lost == []
    back, _ = convert(vrml, "x3d")
    assert difference(scene, back) == ""


def test_what_can_not_be_said_is_listed() -> None:
    scene = parse_x3d(b"<X3D version='3.3'><Scene><Transform scale='1 one 1'/></Scene></X3D>")
    vrml, lost = convert(scene, "x3dv")
    assert lost == ["Transform.scale: 1 one 1 can't be written"]
    assert vrml.body[0].fields == {}


def test_typed_values() -> None:
    node = Node(
        "Wobble", "w", {"a": 1, "b": [1.5] * 5, "c": "x", "d": ["y"], "e": np.eye(2), "f": True, "g": [True] * 5}
    )
    text, _ = print_vrml(Scene(encoding="wrl", version="2.0", body=[node]))
    lines = [line.strip() for line in text.splitlines()]
    assert lines[2:9] == [
        "a 1",
        "b [ 1.5 1.5 1.5 1.5 1.5 ]",
        'c "x"',
        'd [ "y" ]',
        "e [ 1 0, 0 1 ]",
        "f TRUE",
        "g [ TRUE TRUE TRUE TRUE TRUE ]",
    ]


def test_the_line_of_a_bad_number_inside_a_list() -> None:
    scene = scene_of("Coordinate { point [ 0 0 0,\n 1 0 0,\n 0 1e 0 ] }")
    with pytest.raises(FileError) as caught:
        value(scene.body[0], "point", "MFVec3f", None, "t.wrl")
    assert str(caught.value) == "t.wrl:4: expected a number, found '1e'"


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("Group {\n children [\n Group { }\n", 5, "the file ends inside the list of line 3"),
        ("Group {\n", 3, "the file ends inside Group of line 2"),
        ("PROTO A [ ] {\n Group {}", 3, "the file ends inside PROTO A of line 2"),
        ("Group { }\n}", 3, "a } that closes nothing"),
        ('WorldInfo {\n title "abc }', 3, "a string is not closed"),
        ("Group {\n children [ 1 2 {", 3, "expected a value or ] in the list of line 3, found '{'"),
        ("Group children", 2, "expected { after Group, found 'children'"),
        ("Transform { scale }", 2, "expected the value of scale, found '}'"),
        ("ROUTE a.b FROM c.d", 2, "expected TO in a ROUTE, found 'FROM'"),
        ("ROUTE a TO c.d", 2, "expected the source of the ROUTE as NODE.FIELD"),
        ("PROTO A [ banana SFBool x TRUE ] { }", 2, "expected eventIn, eventOut, field, exposedField or ]"),
        ("DEF", 2, "expected a name after DEF, found the end of the file"),
        ("\nPROTO A [ ] { Group { children A { } } }", 3, "prototype A contains itself"),
        ("PROTO A [ ] { B { } }\nPROTO B [ ] { A { } }", 3, "prototypes B and A contain each other"),
    ],
)
def test_broken_files_say_where(text: str, line: int, message: str) -> None:
    with pytest.raises(FileError) as caught:
        scene_of(text)
    assert message in str(caught.value)
    assert caught.value.line == line


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"#VRML V1.0 ascii\n", "VRML 1.0 is another language than VRML97"),
        (b"<X3D/>", "is XML"),
        (b"", "expected the header"),
        (b"Group { }", "expected the header"),
        (b"#VRML V2.0 utf8\n\0", "NUL byte"),
        (b"\xff\xfe\x00", "UTF-16"),
    ],
)
def test_wrong_files(data: bytes, message: str) -> None:
    with pytest.raises(FileError, match=message):
        parse_vrml(data, "t.wrl")


@pytest.mark.parametrize("name", FILES)
def test_real_files(name: str, shared: Path, tmp_path: Path) -> None:
    scene = read_vrml(shared / "data/hanim" / name)
    assert write_vrml(scene, tmp_path / name) == []
    assert difference(scene, read_vrml(tmp_path / name)) == ""
    write_x3d(scene, tmp_path / "x.x3d")
    assert difference(scene, read_x3d(tmp_path / "x.x3d"), typed=True) == ""
    protos = scene.protos()
    for node in scene.walk():
        for key, found in node.fields.items():
            if isinstance(found, Literal):
                type = type_of(node, key, protos)
                assert type, f"{node.type}.{key}"
                parse(found, type, name)
