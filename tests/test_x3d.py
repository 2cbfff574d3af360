"""X3D XML: what the reader makes of each construct, and that the writer gives it back."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from vitruvian.errors import FileError, VitruvianError, VitruvianWarning
from vitruvian.formats.convert import convert
from vitruvian.formats.vrml import read_vrml
from vitruvian.formats.x3d import parse_x3d, read_x3d, write_x3d
from vitruvian.formats.x3d_writer import print_x3d
from vitruvian.hanim.compare import difference
from vitruvian.hanim.fields import container_of, field, fields_of, placement, type_of
from vitruvian.hanim.graph import Comment, Literal, Node, Scene, Use
from vitruvian.hanim.values import parse, shortest, value

FILES = [
    "DiamondManLOA0.x3d",
    "DiamondManLOA2.x3d",
    "HAnim1SpecificationLOA3Invisible.x3d",
    "HAnim2SpecificationLOA3Illustrated.x3d",
    "HAnimModelHandLeft.x3d",
    "HAnimPrototypes.x3d",
    "Humanoid1NoSegSite.x3d",
    "JinLOA1.x3d",
    "JinLOA3.x3d",
    "JinNoAnimations_Fixed.x3d",
    "JinScaledV2L1LOA4Humanoid.x3d",
    "JoeKick.x3d",
    "KoreanCharacterMotionAnnexD01Jin.x3d",
]
SMALL = """<?xml version="1.0" encoding="UTF-8"?>
<!DOCTYPE X3D PUBLIC "ISO//Web3D//DTD X3D 4.0//EN" "https://www.web3d.org/specifications/x3d-4.0.dtd">
<X3D profile='Immersive' version='4.0'>
  <head>
    <!-- in the head -->
    <component name='HAnim' level='1'/>
    <unit category='length' name='centimetre' conversionFactor='0.01'/>
    <meta name='title' content='small &amp; &lt;odd>'/>
  </head>
  <Scene>
    <HAnimHumanoid DEF='hanim_Ann' name='Ann' info='"age=30" "say \\"hi\\""' loa='1'>
      <!-- the skeleton -->
      <HAnimJoint DEF='hanim_humanoid_root' name='humanoid_root' center='0 .9 0' containerField='skeleton'>
        <HAnimSegment DEF='hanim_sacrum' name='sacrum'>
          <Shape><IndexedFaceSet coordIndex='0,1,2,-1'><Coordinate DEF='P' point='0 0 0, 1 0 0, 0 1 0'/>
          </IndexedFaceSet></Shape>
        </HAnimSegment>
        <Wobble DEF='w' speed='3' mood='"a" "b"' label='plain'><!-- inside --></Wobble>
      </HAnimJoint>
      <HAnimJoint USE='hanim_humanoid_root'/>
      <Coordinate USE='P' containerField='skinCoord'/>
    </HAnimHumanoid>
    <Script DEF='S' directOutput='true'>
      <field accessType='inputOnly' type='SFFloat' name='set_x'/>
      <field accessType='initializeOnly' type='SFNode' name='target' appinfo='who'><Group USE='w'/></field>
      <![CDATA[ecmascript: if (1 < 2 && a) { b = ']'; }]]>
    </Script>
    <ROUTE fromNode='S' fromField='x' toNode='w' toField='y'/>
    <IMPORT inlineDEF='I' importedDEF='a' AS='b'/>
    <EXPORT localDEF='w'/>
    <!-- the end -->
  </Scene>
</X3D>
"""
PROTO = """<X3D profile='Immersive' version='3.3'><Scene>
  <ExternProtoDeclare name='Ext' url='"lib.x3d#Ext"'><field accessType='inputOutput' type='SFTime' name='t'/>
  </ExternProtoDeclare>
  <ProtoDeclare name='Joint' appinfo='a joint'>
    <ProtoInterface>
      <!-- name first -->
      <field accessType='inputOutput' type='SFString' name='name'/>
      <field accessType='inputOutput' type='SFVec3f' name='center' value='0 0 0'/>
      <field accessType='inputOutput' type='MFNode' name='children'/>
    </ProtoInterface>
    <ProtoBody>
      <Transform DEF='inner'><IS><connect nodeField='center' protoField='center'/>
        <connect nodeField='children' protoField='children'/></IS></Transform>
      <WorldInfo title='hidden'/>
    </ProtoBody>
  </ProtoDeclare>
  <ProtoInstance name='Joint' DEF='root'>
    <fieldValue name='name' value='humanoid_root'/>
    <fieldValue name='children'>
      <ProtoInstance name='Joint' DEF='knee'><fieldValue name='center' value='0 .5 0'/></ProtoInstance>
      <Group/>
    </fieldValue>
  </ProtoInstance>
  <Group><ProtoInstance USE='knee'/></Group>
</Scene></X3D>
"""


def scene_of(inside: str) -> Scene:
    return parse_x3d(f"<X3D version='4.0' profile='Full'><Scene>{inside}</Scene></X3D>".encode(), "t.x3d")


def text_of(scene: Scene) -> str:
    return print_x3d(scene)[0]


def comes_back(scene: Scene) -> str:
    return difference(scene, parse_x3d(text_of(scene).encode(), scene.path))


def test_head() -> None:
    scene = parse_x3d(SMALL.encode(), "small.x3d")
    assert (scene.version, scene.profile, scene.encoding) == ("4.0", "Immersive", "x3d")
    assert scene.components == [("HAnim", 1)]
    assert scene.units == [("length", "centimetre", 0.01)]
    assert scene.metas == [("title", "small & <odd>")]
    assert [c.text for c in scene.header_comments] == [" in the head "]


def test_nodes_land_where_containerField_says_or_where_it_must_have_meant() -> None:
    scene = parse_x3d(SMALL.encode(), "small.x3d")
    humanoid = scene.defs()["hanim_Ann"]
    (root,) = humanoid.children("skeleton")
    assert root.type == "HAnimJoint"
    assert root.line == 13
    assert humanoid.children("joints") == [root]
    assert humanoid.fields["joints"][0].container == ""  # guessed, since it is a USE without containerField
    assert humanoid.children("skinCoord") == [scene.defs()["P"]]
    shape = root.children("children")[0].children("children")[0]
    assert shape.children("geometry")[0].children("coord")[0] is scene.defs()["P"]
    assert humanoid.fields["skeleton"][0] == Comment(" the skeleton ", 12)


def test_unknown_nodes_and_fields_are_kept() -> None:
    scene = parse_x3d(SMALL.encode(), "small.x3d")
    wobble = scene.defs()["w"]
    assert wobble.fields["label"] == Literal("plain", "xml", 18)
    assert "Wobble" in text_of(scene)
    assert comes_back(scene) == ""


def test_scripts() -> None:
    script = parse_x3d(SMALL.encode(), "small.x3d").defs()["S"]
    assert script.text == "ecmascript: if (1 < 2 && a) { b = ']'; }"
    first, second = script.interface
    assert (first.access, first.type, first.name) == ("inputOnly", "SFFloat", "set_x")
    assert isinstance(second.value, Use)
    assert second.value.node.type == "Wobble"
    assert second.extra == {"appinfo": "who"}


def test_statements() -> None:
    scene = parse_x3d(SMALL.encode(), "small.x3d")
    (route,) = scene.routes()
    assert (route.from_node, route.from_field, route.to_node, route.to_field) == ("S", "x", "w", "y")
    kinds = [type(s).__name__ for s in scene.body]
    assert kinds == ["Node", "Node", "Route", "Import", "Export", "Comment"]


def test_prototypes() -> None:
    scene = parse_x3d(PROTO.encode(), "proto.x3d")
    joint, ext = scene.protos()["Joint"], scene.protos()["Ext"]
    assert ext.external
    assert [f.type for f in joint.interface] == ["SFString", "SFVec3f", "MFNode"]
    assert joint.extra == {"appinfo": "a joint"}
    assert joint.comments[0][0] == "name"
    assert joint.body[0].connects == [("center", "center"), ("children", "children")]
    root = scene.defs()["root"]
    assert root.instance
    assert root.type == "Joint"
    knee, group = root.children("children")
    assert (knee.type, group.type) == ("Joint", "Group")
    assert value(knee, "center", "SFVec3f").tolist() == [0, 0.5, 0]
    assert scene.body[-1].children("children") == [knee]
    assert comes_back(scene) == ""
    assert text_of(scene).count("<ProtoInstance") == 3


def test_mixed_children_keep_their_order() -> None:
    scene = scene_of(
        "<HAnimHumanoid><HAnimSite DEF='a' containerField='skeleton'/><!--c-->"
        "<HAnimSite DEF='b' containerField='viewpoints'/>"
        "<HAnimSite USE='b' containerField='skeleton'/></HAnimHumanoid>"
    )
    assert scene.body[0].order == ["skeleton", "viewpoints", "skeleton"]
    assert comes_back(scene) == ""
    vrml, _ = convert(scene, "x3dv")  # lists are together there, so the DEF has to come earlier
    assert [n.name for n in vrml.body[0].children("skeleton")] == ["a", "b"]
    assert difference(scene, convert(vrml, "x3d")[0], typed=True).startswith("scene[0] HAnimHumanoid.skeleton[1]")


def test_routes_and_prototypes_inside_nodes_are_lifted() -> None:
    scene = scene_of(
        "<Group><ProtoDeclare name='P'><ProtoBody><Group/></ProtoBody></ProtoDeclare><ROUTE fromNode='a' fromField='b' "
        "toNode='c' toField='d'/><ProtoInstance name='P'/></Group><Group/>"
    )
    assert [type(s).__name__ for s in scene.body] == ["Proto", "Node", "Route", "Node"]
    assert comes_back(scene) == ""


def test_a_use_inside_its_own_node_or_before_it_dangles() -> None:
    with pytest.warns(VitruvianWarning, match="t.x3d:1: USE a names no node before it .1 more like it"):
        scene = scene_of("<Group DEF='a'><Group USE='a'/></Group><Group USE='b'/><Group DEF='b'/>")
    assert scene.body[0].fields["children"][0].node is None
    assert scene.body[1].node is None


def test_a_name_given_twice_means_the_latest_before_it() -> None:
    scene = scene_of("<Group DEF='a'/><Group USE='a'/><Box DEF='a'/><Box USE='a'/>")
    assert [scene.body[1].node.type, scene.body[3].node.type] == ["Group", "Box"]


def test_moving_a_use_before_its_node_moves_the_definition() -> None:
    scene = scene_of("<Group DEF='a'><Shape/></Group><Transform/><Group USE='a'/>")
    scene.body.reverse()
    back = parse_x3d(text_of(scene).encode(), "t.x3d")
    assert isinstance(back.body[0], Node)
    assert isinstance(back.body[2], Use)


def test_a_node_inside_itself_can_not_be_written() -> None:
    group = Node("Group", "a")
    group.fields["children"] = [group]
    with pytest.raises(VitruvianError, match="a contains itself"):
        print_x3d(Scene(body=[group]))


def test_edited_values_are_written_as_short_as_they_can_be() -> None:
    scene = scene_of("<Transform translation='0.10 .2 3' scale='1 1 1'/>")
    node = scene.body[0]
    node.fields["scale"] = np.array([0.1, 1 / 3, 2e-7])
    text = text_of(scene)
    assert "translation='0.10 .2 3'" in text
    assert "scale='0.1 0.33333334 2e-7'" in text


def test_shortest_floats() -> None:
    rng = np.random.default_rng(1)
    values = np.concatenate([rng.normal(size=500), rng.normal(size=500) * 1e-30, [0, 1e6, 123456789, -0.0, 3.4e38]])
    texts = shortest(values)
    assert (np.array(texts, np.float64).astype(np.float32) == values.astype(np.float32)).all()
    for text, number in zip(texts, values.astype(np.float32), strict=True):
        exact = np.format_float_scientific(number, unique=True, trim="-")
        assert len(text.lstrip("-").split("e")[0].replace(".", "").strip("0")) <= len(
            exact.lstrip("-").split("e")[0].replace(".", "").strip("0")
        )
    values = values * 10.0 ** rng.integers(-12, 4, len(values))
    assert [t for v in values for t in shortest(np.array([v]))] == shortest(values), "one by one as all at once"
    for bad in (np.nan, np.inf, 1e39):
        for count in (1, 100):
            with pytest.raises(VitruvianError, match="not finite"):
                shortest(np.array([1.0, bad] * count))


@pytest.mark.parametrize(
    ("text", "type", "expected"),
    [
        ("1 2, 3", "SFVec3f", [1, 2, 3]),
        ("1 0x10 -1", "MFInt32", [1, 16, -1]),
        ("true false", "MFBool", [True, False]),
        ("", "MFFloat", []),
        ('"a" "b\\"c\\\\"', "MFString", ["a", 'b"c\\']),
        ("no quotes", "MFString", ["no quotes"]),
        ("back\\\\slash", "SFString", "back\\slash"),
        ("2 1 1 0xFF 0x00", "SFImage", [2, 1, 1, 255, 0]),
        ("1e3", "SFTime", 1000.0),
    ],
)
def test_values(text: str, type: str, expected: object) -> None:
    found = parse(Literal(text, "xml"), type)
    assert (found.tolist() if isinstance(found, np.ndarray) else found) == expected


@pytest.mark.parametrize(
    ("text", "type", "message"),
    [
        ("1 2", "SFVec3f", "SFVec3f is 3 numbers, found 2"),
        ("1 2 3 4", "MFVec3f", "groups of 3 numbers, found 4"),
        ("1 2 x3", "SFVec3f", "expected a number, found 'x3'"),
        ("1_0", "SFFloat", "expected a number, found '1_0'"),
        ("nan", "SFFloat", "expected a finite number, found 'nan'"),
        ("0 1e999 0", "SFVec3f", "expected a finite number, found '1e999'"),
        ("1 2.5", "MFInt32", "expected a whole number, found '2.5'"),
        ("99999999999", "MFInt32", "fits 32 bits, found '99999999999'"),
        ("9" * 30, "MFInt32", "fits 32 bits"),
        ("yes", "SFBool", "expected true or false, found 'yes'"),
        ('"a" b', "MFString", "expected a string in quotes, found 'b'"),
    ],
)
def test_wrong_values_say_where_and_what(text: str, type: str, message: str) -> None:
    with pytest.raises(FileError) as caught:
        parse(Literal(text, "xml", 7), type, "f.x3d")
    assert str(caught.value).startswith("f.x3d:7: ")
    assert message in str(caught.value)


def test_long_lists_are_read_in_pieces() -> None:
    text = " ".join(str(i) for i in range(300_000))
    assert (parse(Literal(text, "xml"), "MFInt32") == np.arange(300_000)).all()
    assert parse(Literal(text, "xml"), "MFVec3f").shape == (100_000, 3)


def test_tables() -> None:
    assert field("HAnimJoint", "set_rotation").type == "SFRotation"
    assert field("TimeSensor", "fraction_changed").access == "outputOnly"
    assert field("OrientationInterpolator", "value_changed").type == "SFRotation"
    assert field("Transform", "nonsense") is None
    assert fields_of("HAnimHumanoid")["skinCoord"].type == "SFNode"
    assert fields_of("Joint")["jointAxis"].default == "0 0 1"
    assert not fields_of("Wobble")
    assert container_of("HAnimMotion") == "motions"
    assert placement("HAnimHumanoid", "HAnimJoint", False) == "skeleton"
    assert placement("HAnimJoint", "HAnimJoint", True) == "children"
    assert type_of(Node("Coordinate"), "point", {}) == "MFVec3f"


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("", 1, "holds no XML"),
        ("<X3D><Scene>\n<Group>\n", 3, "the file ends inside <Group> of line 2"),
        ("<X3D><Scene>\n<Group></Scene></X3D>", 2, "mismatched tag"),
        ("<html/>", 1, "expected the root element X3D, found html"),
        ("#X3D V3.3 utf8\n", 1, "name it .x3dv or .wrl"),
        ("<X3D><Scene>\n<ProtoInstance/></Scene></X3D>", 2, "ProtoInstance needs the name"),
        ("<X3D><head>\n<component name='a' level='x'/></head></X3D>", 2, "expected a number, found 'x'"),
        ("<?xml version='1.0' encoding='klingon'?><X3D/>", 1, "encoding"),
    ],
)
def test_broken_files_say_where(text: str, line: int, message: str) -> None:
    with pytest.raises(FileError) as caught:
        parse_x3d(text.encode(), "f.x3d")
    assert caught.value.line == line
    assert message in str(caught.value)


def test_other_character_sets() -> None:
    inside = "<X3D version='3.0'><Scene><WorldInfo title='Zoë'/></Scene></X3D>"
    for name in ("utf-16", "iso-8859-1", "windows-1252"):
        data = f"<?xml version='1.0' encoding='{name}'?>{inside}".encode(name)
        assert parse_x3d(data).body[0].fields["title"].text == "Zoë"


def test_writing_is_all_or_nothing(tmp_path: Path) -> None:
    target = tmp_path / "out.x3d"
    write_x3d(scene_of("<Group/>"), target)
    before = target.read_bytes()
    bad = scene_of("<Transform/>")
    bad.body[0].fields["scale"] = np.array([1, np.inf, 1])
    with pytest.raises(VitruvianError):
        write_x3d(bad, target)
    assert target.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["out.x3d"]
    with pytest.raises(VitruvianError, match="does not exist"):
        write_x3d(scene_of("<Group/>"), tmp_path / "nowhere" / "out.x3d")


@pytest.mark.parametrize("name", FILES)
def test_real_files_come_back(name: str, shared: Path, tmp_path: Path) -> None:
    scene = read_x3d(shared / "data/hanim" / name)
    assert write_x3d(scene, tmp_path / name) == []
    assert difference(scene, read_x3d(tmp_path / name)) == ""
    protos = scene.protos()
    for node in scene.walk():
        for key, found in node.fields.items():
            if isinstance(found, Literal):
                type = type_of(node, key, protos)
                assert type, f"{node.type}.{key}"
                parse(found, type, name)


@pytest.mark.parametrize("name", FILES)
def test_real_files_survive_other_encodings(name: str, shared: Path) -> None:
    scene = read_x3d(shared / "data/hanim" / name)
    for encoding in ("x3dv", "wrl"):
        other, lost = convert(scene, encoding)
        assert other.encoding == encoding
        assert difference(scene, other, typed=True) == ""
        assert all("is no node of VRML97" in what for what in lost)
        assert encoding == "wrl" or not lost


def test_what_is_written_fits_the_schema(shared: Path, tmp_path: Path) -> None:
    """Files that are valid before are valid after; so is VRML97 made into XML."""
    names = ["HAnim2SpecificationLOA3Illustrated.x3d", "JinNoAnimations_Fixed.x3d", "HAnimPrototypes.x3d"]
    for name in names:
        write_x3d(read_x3d(shared / "data/hanim" / name), tmp_path / name)
    write_x3d(read_vrml(shared / "data/hanim/NancyPrototypes.wrl"), tmp_path / "nancy.x3d")
    paths = [*(tmp_path / n for n in names), tmp_path / "nancy.x3d"]
    referee = shared / "hanim/referee/xsd_validate.py"
    run = subprocess.run(
        [sys.executable, referee, shared / "hanim/xsd", *paths], capture_output=True, text=True, check=False
    )
    assert [line.split()[0] for line in run.stdout.splitlines()] == ["valid"] * len(paths), run.stdout


def test_character_data_in_an_instance_stays() -> None:
    text = (
        "<X3D version='4.0'><Scene><ProtoDeclare name='P'><ProtoBody><Group/></ProtoBody></ProtoDeclare>"
        "<ProtoInstance name='P' DEF='p'>{</ProtoInstance></Scene></X3D>"
    )
    scene = parse_x3d(text.encode())
    printed, lost = print_x3d(scene)
    assert not lost and difference(scene, parse_x3d(printed.encode())) == ""
    assert scene.defs()["p"].text == "{"
