"""Files that mean harm or are broken: one FileError with file and line, soon, in little memory, without recursion."""

from __future__ import annotations

import gzip
import random
import socket
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vitruvian.errors import FileError
from vitruvian.formats.source import Limits
from vitruvian.formats.vrml import parse_vrml, read_vrml
from vitruvian.formats.vrml_writer import print_vrml
from vitruvian.formats.x3d import parse_x3d, read_x3d
from vitruvian.formats.x3d_json import parse_json, read_json
from vitruvian.formats.x3d_json_writer import print_json
from vitruvian.formats.x3d_writer import print_x3d
from vitruvian.hanim.compare import difference
from vitruvian.hanim.fields import type_of
from vitruvian.hanim.graph import Literal, Scene
from vitruvian.hanim.values import parse

OPEN, CLOSE = b"<X3D version='4.0' profile='Full'><Scene>\n", b"</Scene></X3D>"
VRML = b"#VRML V2.0 utf8\n"
JSON, END = b'{"X3D": {"@version": "4.0", "@profile": "Full", "Scene": {"-children": [\n', b"]}}}"
MILLION = 1_000_000

XML_SEED = b"""<?xml version="1.0" encoding="UTF-8"?><!DOCTYPE X3D PUBLIC "a" "b">
<X3D version='4.0' profile='Full'><head><meta name='a' content='b'/>
<unit category='length' name='m' conversionFactor='1'/></head>
<Scene><!-- c --><ProtoDeclare name='P'><ProtoInterface>
<field accessType='inputOutput' type='SFFloat' name='f' value='1'/></ProtoInterface>
<ProtoBody><Group><IS><connect nodeField='a' protoField='f'/></IS></Group></ProtoBody></ProtoDeclare>
<ProtoInstance name='P' DEF='p'><fieldValue name='f' value='2'/></ProtoInstance>
<HAnimHumanoid DEF='h'><HAnimJoint DEF='r' name='humanoid_root' containerField='skeleton'
skinCoordIndex='0 1' skinCoordWeight='1 .5'><HAnimJoint name='l_hip' center='0 1e-2 3'/></HAnimJoint>
<HAnimJoint USE='r'/><Coordinate point='0 0 0, 1 1 1' containerField='skinCoord'/></HAnimHumanoid>
<Script><field accessType='inputOnly' type='SFBool' name='b'/><![CDATA[javascript: x < 1]]></Script>
<ROUTE fromNode='p' fromField='f' toNode='r' toField='center'/></Scene></X3D>"""
VRML_SEED = b"""#VRML V2.0 utf8
# c
PROTO P [ exposedField SFFloat f 1 eventIn SFBool b ] { Group { bboxCenter IS f } }
EXTERNPROTO E [ field SFNode n ] "x"
DEF p P { f 2 }
DEF h HAnimHumanoid { skeleton [ # d
  DEF r HAnimJoint { name "humanoid_root" skinCoordIndex [ 0 1 0x2 ]
    children [ HAnimJoint { center 0 1e-2 3 } USE h ] } ]
  joints USE r info [ "a=\\"b\\"" , "c" ] skinCoord Coordinate { point [ 0 0 0, 1 1 1 # e
  ] } visible TRUE }
Script { eventIn SFBool b IS x field MFNode n [ Group { } ] url "javascript:" }
ROUTE p.f TO r.center
"""
CLASSIC_SEED = b"""#X3D V3.3 utf8
PROFILE Full COMPONENT HAnim:1 UNIT length m 1.5 META "a" "b"
DEF I Inline { url "i" } IMPORT I.a AS b EXPORT I AS J
Transform { translation 1 2 3 children [ Shape { geometry NULL } ROUTE a.b TO c.d ] }
"""


JSON_SEED = rb"""{"X3D": {"encoding": "UTF-8", "@profile": "Full", "@version": "4.0", "head": {
"meta": [{"@name": "a", "@content": "b"}], "unit": [{"@category": "length", "@name": "m", "@conversionFactor": 1}]},
"Scene": {"-children": [ {"#comment": "c"},
{"ProtoDeclare": {"@name": "P", "ProtoInterface": {"field": [
{"@accessType": "inputOutput", "@type": "SFFloat", "@name": "f", "@value": 1}]},
"ProtoBody": {"-children": [{"Group": {"IS": {"connect": [{"@nodeField": "a", "@protoField": "f"}]}}}]}}},
{"ProtoInstance": {"@name": "P", "@DEF": "p", "fieldValue": [{"@name": "f", "@value": 2.5e-1}]}},
{"HAnimHumanoid": {"-joints": [{"HAnimJoint": {"@USE": "r"}}], "@DEF": "h", "-skeleton": [
{"HAnimJoint": {"@DEF": "r", "@name": "humanoid\u005froot", "@skinCoordIndex": [0, 1], "@skinCoordWeight": [1, 0.5],
"-children": [{"#comment": "d"}, {"HAnimJoint": {"@name": "l_hip", "@center": [0, 1e-2, 3]}}]}}],
"-skinCoord": {"Coordinate": {"@point": [0, 0, 0,
1, 1, 1]}}, "@info": ["a=\"b\"", "c"]}},
{"Script": {"field": [{"@accessType": "inputOnly", "@type": "SFBool", "@name": "b"}], "#sourceText": ["javascript:", "x"]}},
{"ROUTE": {"@fromNode": "p", "@fromField": "f", "@toNode": "r", "@toField": "center"}} ]}}}"""


def everything(scene: Scene) -> None:
    """Use the graph as its readers do: walk, type every value, write it in all encodings."""
    protos = scene.protos()
    for node in scene.walk():
        for key, found in node.fields.items():
            type = type_of(node, key, protos)
            if isinstance(found, Literal) and type:
                try:
                    parse(found, type, scene.path)
                except FileError as error:
                    assert error.line > 0
    print_x3d(scene)
    print_vrml(scene, "x3dv")
    print_vrml(scene, "wrl")
    print_json(scene)


def survives(parser: Callable, data: bytes) -> bool:
    """Whether the file is read; any exception but FileError is a failure, as is one that takes long."""
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            scene = parser(data, "t")
        except FileError as error:
            assert "\n" not in str(error)
            assert str(error).startswith("t")
            return False
        everything(scene)
        printer = {parse_x3d: print_x3d, parse_json: print_json}.get(parser, print_vrml)
        text, lost = printer(scene)
        if not lost:
            assert difference(scene, parser(text.encode(), "t")) == ""
    assert time.process_time() - start < 3
    return True


BOMB = (
    b"<?xml version='1.0'?><!DOCTYPE X3D [<!ENTITY a 'ha'>"
    + b"".join(b"<!ENTITY %c '&%c;&%c;&%c;&%c;'>" % (98 + i, 97 + i, 97 + i, 97 + i, 97 + i) for i in range(20))
    + b"]><X3D><Scene><WorldInfo title='&u;'/></Scene></X3D>"
)
NESTED_PROTO = b"".join(b"PROTO P%d [ ] { " % i for i in range(40))
DOUBLING = b"".join(b"DEF n%d Group { children [ USE n%d USE n%d ] }\n" % (i, i - 1, i - 1) for i in range(1, 60))

USE = b'{"Group": {"@USE": "n%d"}}'
DOUBLING_JSON = [b'{"Group": {"@DEF": "n0"}}'] + [
    b'{"Group": {"@DEF": "n%d", "-children": [{"Group": {"@USE": "n%d"}}, {"Group": {"@USE": "n%d"}}]}}'
    % (i, i - 1, i - 1)
    for i in range(1, 60)
]

CASES: dict[str, tuple[Callable, bytes, int, str]] = {
    "entity bomb": (parse_x3d, BOMB, 1, "declares the entity a"),
    "external entity": (
        parse_x3d,
        b"<!DOCTYPE X3D [\n<!ENTITY x SYSTEM 'file:///etc/passwd'>]><X3D>&x;</X3D>",
        2,
        "declares the entity x",
    ),
    "parameter entity": (
        parse_x3d,
        b"<!DOCTYPE X3D [<!ENTITY % x SYSTEM 'http://127.0.0.1:9/x'>%x;]><X3D/>",
        1,
        "declares the entity x",
    ),
    "undeclared entity": (
        parse_x3d,
        b"<!DOCTYPE X3D SYSTEM 'http://127.0.0.1:9/x.dtd'>\n<X3D><Scene>\n&boo;</Scene></X3D>",
        3,
        "uses the entity &boo;",
    ),
    "attribute defaults": (
        parse_x3d,
        b"<!DOCTYPE X3D [<!ATTLIST Group a CDATA '" + b"x" * 1000 + b"'>]><X3D/>",
        1,
        "attribute defaults",
    ),
    "deep xml": (parse_x3d, OPEN + b"<Group>" * 500_000, 2, "nested deeper than 512"),
    "deep vrml": (parse_vrml, VRML + b"Group { children [\n" * 90_000, 514, "nested deeper than 512"),
    "deep vrml without brackets": (parse_vrml, VRML + b"A { b " * 90_000, 2, "nested deeper than 512"),
    "brackets": (parse_vrml, VRML + b"A { b " + b"[" * MILLION, 2, "expected a value or ]"),
    "a million xml nodes": (parse_x3d, OPEN + b"<Group/>\n" * MILLION + CLOSE, 1_000_000, "more than 1000000 XML tags"),
    "many xml nodes": (parse_x3d, OPEN + b"<Group/>\n" * 500_000 + CLOSE, 100_002, "more than 100000 nodes"),
    "a million vrml nodes": (parse_vrml, VRML + b"Group { }\n" * MILLION, 100_002, "more than 100000 nodes"),
    "many xml comments": (parse_x3d, OPEN + b"<!-- -->\n" * 600_000 + CLOSE, 500_001, "more than 500000 nodes, fields"),
    "many vrml comments": (
        partial(parse_vrml, limits=Limits(entries=100_000)),
        VRML + b"#\n" * MILLION,
        100_002,
        "more than 100000 nodes, fields and comments",
    ),
    "prototypes in prototypes": (parse_vrml, VRML + NESTED_PROTO, 2, "more than 32 prototypes inside each other"),
    "a prototype in itself": (
        parse_x3d,
        OPEN + b"<ProtoDeclare name='P'><ProtoBody>\n<ProtoInstance name='P'/></ProtoBody></ProtoDeclare>" + CLOSE,
        3,
        "prototype P contains itself",
    ),
    "a prototype in itself, vrml": (parse_vrml, VRML + b"PROTO P [ ] {\n P { } }", 3, "prototype P contains itself"),
    "uses that double": (parse_vrml, VRML + b"DEF n0 Group { }\n" + DOUBLING, 23, "USEs expand to more than 4000000"),
    "binary as xml": (parse_x3d, random.Random(0).randbytes(100_000), 1, "well-formed"),
    "binary as vrml": (parse_vrml, VRML + random.Random(0).randbytes(100_000), 4, "NUL byte"),
    "an endless string": (parse_vrml, VRML + b'A { b "' + b'\\"' * MILLION, 2, "a string is not closed"),
    "an endless list": (parse_vrml, VRML + b"A { b [ " + b"1 #x\n" * MILLION, 1_000_002, "found the end of the file"),
    "deep json": (parse_json, b'{"a":\n' * 100_000, 2065, "nested deeper than 2064"),
    "deep json lists": (parse_json, JSON + b"[" * MILLION, 2, "nested deeper than 2064"),
    "deep json nodes": (
        parse_json,
        JSON + b'{"Group": {"-children": [\n' * 520 + b"]}}" * 520 + END,
        514,
        "nested deeper than 512",
    ),
    "a million json nodes": (
        parse_json,
        JSON + b'{"Group": {}},\n' * MILLION + END,
        350_000,
        "more than 700000 objects",
    ),
    "many json nodes": (
        parse_json,
        JSON + b'{"Group": {}},\n' * 150_000 + b"{}" + END,
        100_002,
        "more than 100000 nodes",
    ),
    "many json values": (
        parse_json,
        b"[" + b'{"a": 1, "b": 2, "c": 3},\n' * 400_000,
        200_000,
        "more than 800000 values",
    ),
    "a json key twice": (
        parse_json,
        JSON + b'{"Group": {"@DEF": "a",\n"@DEF": "b"}}' + END,
        3,
        '"@DEF" is given twice',
    ),
    "an open json string": (parse_json, JSON + b'{"#comment": "' + b'\\"' * MILLION, 2, "a string is not closed"),
    "a json list without end": (
        parse_json,
        JSON + b'{"Group": {"@x": [' + b"1,\n" * MILLION,
        1_000_002,
        "the file ends inside the list of line 2",
    ),
    "words in json": (parse_json, JSON + b'{"Group": {"@x": [0,\n zero]}}' + END, 3, "found 'zero'"),
    "another top in json": (parse_json, b'{"pattern": {}}', 1, 'expected {"X3D": {...}} at the top, found the key'),
    "binary as json": (parse_json, random.Random(0).randbytes(100_000), 3, "NUL byte"),
    "xml as json": (parse_json, XML_SEED, 1, "is not JSON but XML; name it .x3d"),
    "a json prototype in itself": (
        parse_json,
        JSON
        + b'{"ProtoDeclare": {"@name": "P", "ProtoBody": {"-children": [\n{"ProtoInstance": {"@name": "P"}}]}}}'
        + END,
        3,
        "prototype P contains itself",
    ),
    "json uses that double": (
        parse_json,
        JSON + b",\n".join(DOUBLING_JSON) + END,
        23,
        "USEs expand to more than 4000000",
    ),
    "json uses that triple before their DEF": (
        parse_json,
        JSON
        + b"".join(
            b'{"Group": {"@DEF": "n%d", "-a": [%s, %s], "-z": [\n' % (i, USE % (i + 1), USE % (i + 1))
            for i in range(40)
        )
        + b'{"Group": {"@DEF": "n40"}}'
        + b"]}}" * 40
        + END,
        28,
        "USEs expand to more than 4000000",
    ),
    "an endless name": (parse_vrml, VRML + b"x" * MILLION, 2, "expected { after"),
}


@pytest.mark.parametrize("case", CASES)
def test_one_clear_line(case: str) -> None:
    parser, data, line, message = CASES[case]
    start = time.process_time()
    with warnings.catch_warnings(), pytest.raises(FileError) as caught:
        warnings.simplefilter("ignore")
        parser(data, "t")
    assert time.process_time() - start < 5
    assert message in str(caught.value)
    assert caught.value.line == line
    assert len(str(caught.value)) < 320


def test_the_largest_files_that_are_read_stay_small(tmp_path: Path) -> None:
    """A file at the limits takes under 1 GB, measured in a process of its own."""
    path = tmp_path / "large.x3d"
    path.write_bytes(OPEN + b"<Transform translation='0 0 1' scale='1 1 1' rotation='0 0 1 0'/>\n" * 99_000 + CLOSE)
    code = (
        "import re, sys; from vitruvian.formats.x3d import read_x3d; read_x3d(sys.argv[1]);"
        "print(re.search(r'VmHWM:\\s+(\\d+)', open('/proc/self/status').read())[1])"  # rusage would count the parent's
    )
    run = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, check=True)
    assert int(run.stdout) < 500_000


def test_gzip_is_bounded(tmp_path: Path) -> None:
    path = tmp_path / "bomb.wrl"
    path.write_bytes(gzip.compress(VRML + b" " * 50_000_000))
    with pytest.raises(FileError, match="unpacks to more than"):
        read_vrml(path)
    good = gzip.compress(VRML_SEED)
    path.write_bytes(good[:-20])
    with pytest.raises(FileError, match="gzip data that ends too early"):
        read_vrml(path)
    path.write_bytes(good[:30] + b"xxxxx" + good[35:])
    with pytest.raises(FileError, match="gzip"):
        read_vrml(path)


def test_files_that_are_none(tmp_path: Path) -> None:
    for read in (read_x3d, read_vrml, read_json):
        with pytest.raises(FileError, match="no such file"):
            read(tmp_path / "missing.x3d")
        with pytest.raises(FileError, match="is not a file"):
            read(tmp_path)
    path = tmp_path / "large.x3d"
    path.write_bytes(b" " * 2000)
    with pytest.raises(FileError, match="is larger than"):
        read_x3d(path, limits=Limits(bytes=1000))


def test_nothing_asks_the_network(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a reader opened a connection")

    monkeypatch.setattr(socket, "socket", refuse)
    monkeypatch.setattr(socket, "create_connection", refuse)
    head = b"<!DOCTYPE X3D PUBLIC 'ISO//Web3D//DTD X3D 3.3//EN' 'http://127.0.0.1:9/x3d-3.3.dtd'>"
    scene = parse_x3d(
        head + b"<X3D><Scene><Inline url='\"http://127.0.0.1:9/a.x3d\"'/><ExternProtoDeclare name='E' "
        b"url='\"http://127.0.0.1:9/b.x3d\"'/><ProtoInstance name='E'/></Scene></X3D>"
    )
    assert [type(s).__name__ for s in scene.body] == ["Node", "Proto", "Node"]
    parse_vrml(VRML + b'EXTERNPROTO E [ ] "http://127.0.0.1:9/x.wrl" E { } Inline { url "http://127.0.0.1:9/y.wrl" }')


def test_deep_but_allowed_graphs_need_no_recursion() -> None:
    for parser, data in (
        (parse_x3d, OPEN + b"<Group>" * 500 + b"</Group>" * 500 + CLOSE),
        (parse_vrml, VRML + b"Group { children [ " * 500 + b"] }" * 500),
        (parse_json, JSON + b'{"Group": {"-children": [' * 500 + b"]}}" * 500 + END),
    ):
        limit = sys.getrecursionlimit()
        sys.setrecursionlimit(150 + len(__import__("inspect").stack()))
        try:
            scene = parser(data, "t")
            assert sum(1 for _ in scene.walk()) == 500
            everything(scene)
        finally:
            sys.setrecursionlimit(limit)


SEEDS = [(parse_x3d, XML_SEED), (parse_vrml, VRML_SEED), (parse_vrml, CLASSIC_SEED), (parse_json, JSON_SEED)]


@pytest.mark.parametrize(("parser", "seed"), SEEDS, ids=["xml", "vrml97", "classic", "json"])
def test_the_seeds_are_good(parser: Callable, seed: bytes) -> None:
    assert survives(parser, seed)


@pytest.mark.parametrize(("parser", "seed"), SEEDS, ids=["xml", "vrml97", "classic", "json"])
def test_every_truncation(parser: Callable, seed: bytes) -> None:
    read = [survives(parser, seed[:end]) for end in range(0, len(seed), 3)]
    assert not all(read)


TOKENS = [
    b"{",
    b"}",
    b"[",
    b"]",
    b'"',
    b"#",
    b"<",
    b">",
    b"/>",
    b"'",
    b"&",
    b"DEF a ",
    b"USE h ",
    b" IS ",
    b"PROTO x [",
]
TOKENS += [
    b"nan",
    b"1e999",
    b"-",
    b"99999999999999999999",
    b"\\",
    b"\xff",
    b"\x01",
    b"\xe2\x80\xa8",
    b"ROUTE ",
    b"]]>",
    b"<!--",
    b"NULL",
    b"NaN",
    b"null",
    b'"-children": ',
    b'{"Group": {"@USE": "h"}}',
    b'"@DEF": "r",',
    b"\\ud800",
    b",",
    b":",
]


@pytest.mark.parametrize(("parser", "seed"), SEEDS, ids=["xml", "vrml97", "classic", "json"])
def test_random_mutations(parser: Callable, seed: bytes) -> None:
    """Cut, doubled, swapped and foreign pieces: a graph or a FileError, nothing else, soon."""
    edit = st.tuples(
        st.integers(0, len(seed)), st.integers(0, 30), st.one_of(st.sampled_from(TOKENS), st.binary(max_size=4))
    )

    @settings(max_examples=150, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(st.lists(edit, min_size=1, max_size=4))
    def endures(edits: list[tuple[int, int, bytes]]) -> None:
        data = seed
        for place, length, new in edits:
            data = data[:place] + new + data[place + length :]
        survives(parser, data)

    endures()


@pytest.mark.parametrize("name", ["sample1.wrl", "JoeKick.x3d", "hanim_transforms.x3dv", "HAnimPrototypes.x3d"])
def test_real_files_cut_short(name: str, shared: Path) -> None:
    data = (shared / "data/hanim" / name).read_bytes()
    parser = parse_x3d if name.endswith("x3d") else parse_vrml
    for percent in range(0, 100, 7):
        survives(parser, data[: len(data) * percent // 100])
