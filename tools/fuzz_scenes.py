"""Broken files by the thousand: every reader answers with what it read or with one clear error, soon, in little memory.

    python tools/fuzz_scenes.py --cases 20000 --data ../shared/data

Each case is a small real file or one of our own, changed at random: bytes flipped, cut short, words and pieces
doubled, swapped or left out, extreme numbers, deep nesting, broken gzip. It is loaded, its humanoids are read (every
other time with repairs), the doctor looks at it; some are repaired, packed and written back. Only `VitruvianError` may
come out. Case K of a seed is always the same bytes: `--only K --keep DIR` leaves it in a file.

A worker process may use 1 GB above what it starts with; one that takes longer than 5 s over a case is ended and the
case counts as a hang.
"""

from __future__ import annotations

import argparse
import base64
import gzip
import json
import multiprocessing
import os
import random
import re
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

SECONDS = 5.0
BYTES = 1 << 30
LARGEST = 500_000  # bytes of a file that is mutated
_WORD = re.compile(rb"[\w.+-]+")
_NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_EXTREME = (
    b"nan inf -inf 1e400 -1e400 1e39 3.5e38 1e-400 -1 -0 0 1 2147483647 2147483648 -2147483649 4294967296 "
    b"99999999999999999999 0x7fffffff 0xffffffffff 1.2.3 --1 1e 5_0 1e-46 65536 1000000 0.5"
).split()
_WORDS = (
    b"USE DEF NULL TRUE FALSE true IS PROTO EXTERNPROTO ROUTE TO children skeleton humanoidBody joints skin skinCoord "
    b"coordIndex point key keyValue HAnimHumanoid HAnimJoint HAnimSegment HAnimSite HAnimDisplacer HAnimMotion Humanoid "
    b"Joint Coordinate Group Shape IndexedFaceSet name values channels containerField humanoid_root l_hip HumanoidRoot "
    b"ProtoInstance ProtoDeclare fieldValue field IS connect Script MFNode SFFloat MFRotation HIERARCHY ROOT OFFSET "
    b"CHANNELS JOINT End Site MOTION Frames: v vt vn f g o usemtl nodes meshes skins accessors"
).split()
_MARKS = [*b"{}[]<>\"'#&;:,/\\=\0\r\n", 0xFF, 0xC3, 0xE2]
_NESTS = {
    ".x3d": (b"<Group>", b"<HAnimJoint name='l_hip'>", b"<HAnimSegment><HAnimSite>", b"<ProtoBody>", b"<![CDATA["),
    ".bvh": (b"JOINT a\n{\n", b"{"),
    ".glb": (b"[", b'{"a":'),
    ".x3dj": (b"[", b'{"-children":[', b'{"Group":{"-children":['),
    ".gltf": (b"[", b'{"a":'),
}
LIKE = {".wrz": ".wrl", ".vrm": ".glb", ".vrma": ".glb"}  # extensions that hold the same as another
_VRML_NESTS = (b"Group { children [ ", b"Joint { children ", b"PROTO A [ ] { ", b"[", b"{ ", b"A { b ")


@dataclass(frozen=True)
class Source:
    """A good file: its name, extension (as the registry knows it) and bytes."""

    name: str
    extension: str
    data: bytes


@dataclass(frozen=True)
class Failure:
    """A case that was not answered as it should be."""

    case: int
    source: str
    what: str


def sources(data: Path | None) -> list[Source]:
    """Small files for every reader: written by ourselves, and the real ones of up to 500 kB under `data`."""
    known = readable()
    found = list(own_files(known))
    if data is not None:
        for path in sorted(data.rglob("*")):
            if path.suffix.lower() in known and path.is_file():
                content = path.read_bytes()
                if path.suffix == ".bvh":  # its first frames
                    content = content[:20_000]
                if len(content) <= LARGEST:
                    found.append(Source(path.name, path.suffix.lower(), content))
    for extension in sorted(known - {s.extension for s in found}):
        like = [s for s in found if s.extension == LIKE.get(extension)]
        if not like:
            raise SystemExit(f"no file to mutate for {extension}: teach own_files to write one")
        found += [Source(f"{s.name} as {extension}", extension, s.data) for s in like]
    return found


def readable() -> set[str]:
    """Extensions that `load` takes."""
    from vitruvian.formats import registry

    tables = (getattr(registry, name, {}) for name in ("SCENES", "READERS", "FIGURES"))
    return {extension for table in tables for extension in table}


def own_files(known: set[str]) -> Iterator[Source]:
    """A figure of three joints with skin, segment, site, displacer and motion, in everything that we read and write."""
    import trimesh

    from vitruvian.errors import VitruvianError
    from vitruvian.formats.registry import WRITERS, save
    from vitruvian.stage.clip import Mesh

    box = trimesh.creation.box()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for extension in sorted(known & set(WRITERS)):
            versions = {".wrl": ("200x", "1.1"), ".x3d": ("2.0", "1.0")}.get(extension, (None,))
            for version in versions:
                path = Path(folder) / f"own{version or ''}{extension}"
                with suppress(VitruvianError):  # a VRM wants more joints
                    save(figure(), path, hanim=version)
                    yield Source(path.name, extension, path.read_bytes())
        if ".gltf" in known:
            path = Path(folder) / "own.glb"
            save(figure(), path)
            yield Source("own.gltf", ".gltf", _as_text(path.read_bytes()))
        for extension in sorted(known & {".ply", ".stl", ".obj"}):
            path = Path(folder) / f"box{extension}"
            if extension == ".obj":
                save(Mesh(box.vertices, box.faces), path)
            else:
                box.export(path)
            yield Source(path.name, extension, path.read_bytes())
    yield from _captures(known)


PATTERN = """{"pattern": {"panels": {
"front": {"translation": [0, 90, 20], "rotation": [0, 0, 0], "label": "body", "vertices": [[0, 0], [30, 0], [30, 40]],
"edges": [{"endpoints": [0, 1]}, {"endpoints": [1, 2], "curvature": {"type": "circle", "params": [25, 0, 1]}},
{"endpoints": [2, 0], "curvature": {"type": "cubic", "params": [[0.3, 0.1], [0.6, -0.1]]}, "label": "left_collar"}]},
"back": {"vertices": [[0, 0], [20, 0], [10, 20]], "edges": [{"endpoints": [0, 1]}, {"endpoints": [1, 2]},
{"endpoints": [2, 0], "curvature": [0.5, 0.1]}]}},
"stitches": [[{"panel": "front", "edge": 0}, {"panel": "back", "edge": 1}, "right_wrong"]]},
"properties": {"units_in_meter": 100, "curvature_coords": "relative"}}"""


OWN_PATTERN = """{"vitruvian_pattern": 1, "name": "tube", "panels": [
{"name": "front", "label": "body", "fabric": "", "order": 1, "grain": [0, 1], "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
"translation": [0, 1, 0.2], "vertices": [[0, 0], [0.3, 0], [0.3, 0.4]],
"edges": [{"ends": [0, 1], "kind": "line"}, {"ends": [1, 2], "kind": "arc", "points": [[0.32, 0.2]], "label": "armhole"},
{"ends": [2, 0], "kind": "polyline", "points": [[0.2, 0.3], [0.1, 0.2]]}]},
{"name": "back", "vertices": [[0, 0], [0.2, 0], [0.1, 0.2]], "edges": [{"ends": [0, 1]},
{"ends": [1, 2], "kind": "quadratic", "points": [[0.1, 0.1]]}, {"ends": [2, 0]}]}],
"seams": [{"a": [["front", 0, 0, 0.5]], "b": [["back", 1]], "reversed": true, "kind": "gather", "open": false}],
"buttons": [{"a": ["front", [0.1, 0.1]], "b": ["back", [0.1, 0.1]]}], "measures": {"chest": 0.9}, "extra": {"a": [1]}}"""


DRAFT = """{"units": "mm", "parts": {"x.front": {"points": {"a": [0, 0], "b": [100, 0]}, "paths": {
"seam": {"class": "fabric", "ops": [{"type": "move", "to": [0, 0]}, {"type": "line", "to": [0, 100]},
{"type": "curve", "cp1": [50, 120], "cp2": [90, 110], "to": [100, 100]}, {"type": "line", "to": [100, 0]},
{"type": "close"}]},
"__macro_cutonfold_x_line": {"class": "note", "ops": [{"type": "move", "to": [0, 0]}, {"type": "line", "to": [0, 100]}]}},
"snippets": {"n": {"def": "notch", "at": [100, 40]}}}}}"""
DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" width="300mm" height="200mm" viewBox="0 0 300 200">
<g id="a" transform="translate(10,10) rotate(30)">
<path class="cloth" d="M0 0h100v50C60 60 30 40 0 50zM20 20h20v20h-20z"/></g>
<g transform="scale(2)"><path d="m9,9a5,3 20 0130,0q9 9 12-4t3 3l-9-9z"/><rect x="1" y="1" width="40" height="3e1"/></g>
<polygon points="0,0 50,0 20,60"/><circle cx="9" cy="9" r="20"/><use href="#notch" x="3" y="4"/></svg>"""


def dxf_piece() -> bytes:
    """A square in a block, with a corner, a grain line and its texts."""
    corners = [(0, 0), (100, 0), (100, 80), (0, 80)]
    rows = ["0", "SECTION", "2", "BLOCKS", "0", "BLOCK", "8", "0", "2", "A", "70", "0", "10", "0", "20", "0", "3", "A"]
    rows += ["0", "POLYLINE", "8", "1", "66", "1", "70", "1", "10", "0", "20", "0", "30", "0"]
    for x, y in corners:
        rows += ["0", "VERTEX", "8", "1", "10", f"{x}", "20", f"{y}", "30", "0"]
    rows += ["0", "SEQEND", "8", "1", "0", "POINT", "8", "4", "10", "100", "20", "80", "30", "0"]
    rows += ["0", "LINE", "8", "7", "10", "50", "20", "20", "30", "0", "11", "50", "21", "60", "31", "0"]
    for text in ("PIECE NAME: A", "QUANTITY: 2"):
        rows += ["0", "TEXT", "8", "1", "10", "0", "20", "0", "30", "0", "40", "3", "1", text]
    rows += ["0", "ENDBLK", "8", "0", "0", "ENDSEC", "0", "SECTION", "2", "ENTITIES"]
    rows += ["0", "TEXT", "8", "1", "10", "0", "20", "0", "30", "0", "40", "3", "1", "UNITS: METRIC"]
    rows += ["0", "INSERT", "8", "0", "2", "A", "10", "0", "20", "0", "30", "0", "0", "ENDSEC", "0", "EOF"]
    return "\n".join([*rows, ""]).encode()


def _captures(known: set[str]) -> Iterator[Source]:
    """Files that we do not write: a skeleton of Acclaim, markers of C3D, models and tables of OpenSim,
    patterns, which a figure is not."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
    from capture_maker import ASF, LABELS, MARKS, SHANK, THIGH, c3d, cloud, model

    table = "still\nversion=1\nnRows=3\nnColumns=3\ninDegrees=yes\nendheader\ntime\tknee_r\tpelvis_ty\n"
    table += "".join(f"{0.1 * k:.1f}\t{5 * k}\t0.9\n" for k in range(3))
    made = {
        ".asf": ASF.encode(),
        ".c3d": c3d(cloud() * 1000, list(LABELS)),
        ".osim": model(THIGH, SHANK, markers=MARKS).encode(),
        ".mot": table.encode(),
        ".garmentcode.json": PATTERN.encode(),
        ".pattern.json": OWN_PATTERN.encode(),
        ".freesewing.json": DRAFT.encode(),
        ".svg": DRAWING.encode(),
        ".dxf": dxf_piece(),
        ".sto": table.encode(),
    }
    for extension in sorted(known & set(made)):
        yield Source(f"own{extension}", extension, made[extension])


def _chunks(glb: bytes) -> tuple[bytes, bytes]:
    """The JSON of a GLB file, and what follows it."""
    end = 20 + int.from_bytes(glb[12:16], "little")
    return glb[20:end], glb[end:]


def _as_text(glb: bytes) -> bytes:
    """A GLB file as glTF with its buffer inside."""
    text, rest = _chunks(glb)
    tree = json.loads(text)
    tree["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(rest[8:]).decode()
    return json.dumps(tree).encode()


def figure():  # noqa: ANN201 (a Humanoid; the package is imported late)
    """Three joints, a skin of eight points, a segment, a site, a displacer, a clip."""
    import numpy as np

    from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Material, MotionData, Segment, Shape, Site, Track

    names = ("humanoid_root", "vl5", "skullbase")
    joints = [Joint(n, center=np.array([0, 0.9 + 0.3 * k, 0])) for k, n in enumerate(names)]
    for k, joint in enumerate(joints):
        joint.skin_coord_index = np.arange(max(0, 3 * k - 1), 3 * k + 2, dtype=np.int32)
        joint.skin_coord_weight = np.full(len(joint.skin_coord_index), 0.5)
        joint.joints = joints[k + 1 : k + 2]
    points = np.array([[x, 0.8 + 0.2 * y, 0.1 * x * y] for y in range(4) for x in (-0.1, 0.1)])
    triangles = np.array([[a, a + 1, a + 2] for a in range(6)], np.int32)
    look = Material("cloth", (0.2, 0.4, 0.6))
    face = Shape("face", triangles[:2], points=points[:4].copy(), material=look)
    move = Displacer("jaw_open_action", np.array([0, 1], np.int32), np.full((2, 3), 0.01), weight=0.5)
    joints[2].segments = [Segment("skull", mass=4.0, shapes=[face], displacers=[move], sites=[Site("skull_tip")])]
    joints[1].llimit, joints[1].ulimit = np.full(3, -0.5), np.full(3, 0.5)
    keys = np.array([0, 0.5, 1.0])
    turns = np.array([[0, 1, 0, a] for a in (0, 0.5, 0)])
    h = Humanoid("Fay", "2.0", -1, skeleton=joints[:1], info={"age": "30"})
    h.skin_coord, h.skin = points, [Shape("skin", triangles, material=look)]
    h.tracks = [Track("vl5", "rotation", keys, turns, 2.0, True, "nod")]
    values = np.array([[0.0, 1.0], [0.1, 2.0]])
    h.motions = [MotionData("sway", ["vl5"], [("Xrotation", "Yrotation")], values, 0.1, False, True)]
    return h


def mutated(case: int, seed: int, files: list[Source]) -> tuple[str, str, bytes]:
    """(name of the source, extension, bytes) of a case."""
    chance = random.Random(f"{seed}:{case}")
    # the larger a file, the rarer: a case costs time with the size
    source = chance.choices(files, [1 / (12_000 + len(f.data)) for f in files])[0]
    extension, data = source.extension, source.data
    text, rest = _chunks(data) if data[:4] == b"glTF" and chance.random() < 0.7 else (data, b"")
    for _ in range(chance.choice((1, 1, 1, 1, 2, 4))):
        text = chance.choice(MUTATIONS)(text, chance, source, files)
    if rest:  # lengths that fit, so that the reader gets to see what is inside
        text += b" " * (-len(text) % 4)
        head = (len(text).to_bytes(4, "little"), (20 + len(text) + len(rest)).to_bytes(4, "little"))
        data = b"glTF" + data[4:8] + head[1] + head[0] + b"JSON" + text + rest
    else:
        data = text
    if extension in (".x3d", ".wrl", ".x3dv") and chance.random() < 0.04:
        data = gzip.compress(data, 1, mtime=0)
        extension = ".wrz" if extension == ".wrl" and chance.random() < 0.5 else f"{extension}.gz"
        if chance.random() < 0.7:
            data = chance.choice((_flip, _cut, _double))(data, chance, source, files)
    return source.name, extension, data


Mutation = Callable[[bytes, random.Random, Source, list[Source]], bytes]


def _flip(data: bytes, chance: random.Random, *_: object) -> bytes:
    changed = bytearray(data)
    for _ in range(min(len(data), chance.choice((1, 2, 8)))):
        changed[chance.randrange(len(changed))] = chance.choice((chance.randrange(256), chance.choice(_MARKS)))
    return bytes(changed)


def _cut(data: bytes, chance: random.Random, *_: object) -> bytes:
    return data[: chance.randrange(len(data) + 1)]


def _span(data: bytes, chance: random.Random) -> tuple[int, int]:
    start = chance.randrange(len(data) + 1)
    return start, min(len(data), start + chance.choice((1, 4, 20, 100, 1000)))


def _drop(data: bytes, chance: random.Random, *_: object) -> bytes:
    a, b = _span(data, chance)
    return data[:a] + data[b:]


def _double(data: bytes, chance: random.Random, *_: object) -> bytes:
    a, b = _span(data, chance)
    return data[:b] + data[a:b] * chance.choice((1, 1, 2, 20)) + data[b:]


def _swap(data: bytes, chance: random.Random, *_: object) -> bytes:
    a, b = _span(data, chance)
    c, d = _span(data, chance)
    if a > c:
        a, b, c, d = c, d, a, b
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:] if b <= c else data


def _splice(data: bytes, chance: random.Random, source: Source, files: list[Source]) -> bytes:
    """A piece of another file of the kind."""
    other = chance.choice([f for f in files if f.extension == source.extension]).data
    a, b = _span(other, chance)
    place = chance.randrange(len(data) + 1)
    return data[:place] + other[a:b] + data[place:]


def _near(pattern: re.Pattern[bytes], data: bytes, chance: random.Random) -> re.Match[bytes] | None:
    return pattern.search(data, chance.randrange(len(data) + 1)) or pattern.search(data)


def _word(data: bytes, chance: random.Random, *_: object) -> bytes:
    """A word becomes another one of the file or of the languages, or is gone, or doubled."""
    word = _near(_WORD, data, chance)
    if word is None:
        return data
    other = _near(_WORD, data, chance)
    new = chance.choice((chance.choice(_WORDS), other[0] if other else b"", b"", word[0] + b" " + word[0]))
    return data[: word.start()] + new + data[word.end() :]


def _number(data: bytes, chance: random.Random, *_: object) -> bytes:
    for _ in range(chance.choice((1, 1, 3))):
        found = _near(_NUMBER, data, chance)
        if found is not None:
            data = data[: found.start()] + chance.choice(_EXTREME) + data[found.end() :]
    return data


def _value(data: bytes, chance: random.Random, *_: object) -> bytes:
    """Numbers become other numbers of the file, or a little more or less: wrong counts, indices and weights."""
    for _ in range(chance.choice((1, 3, 10))):
        found, other = _near(_NUMBER, data, chance), _near(_NUMBER, data, chance)
        if found is None or other is None:
            break
        digit = b"%d" % chance.randrange(10)
        new = chance.choice(
            (
                other[0],
                found[0] + digit,
                b"-" + found[0].lstrip(b"+-"),
                digit,
                b"%d %s" % (chance.randrange(300), found[0]),
            )
        )
        data = data[: found.start()] + new + data[found.end() :]
    return data


def _nest(data: bytes, chance: random.Random, source: Source, *_: object) -> bytes:
    """Openers without end, at a place where a word begins."""
    opener = chance.choice(_NESTS.get(LIKE.get(source.extension, source.extension), _VRML_NESTS))
    word = _near(_WORD, data, chance)
    place = word.start() if word else 0
    if source.extension == ".x3d":
        place = max(data.find(b"<", place), 0)
    return data[:place] + opener * chance.choice((3, 40, 520, 3000)) + data[place:]


def _binary(data: bytes, chance: random.Random, *_: object) -> bytes:
    """Four bytes become an extreme count."""
    place = chance.randrange(max(1, len(data) - 3)) & ~3
    value = chance.choice((0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, len(data), 1 << chance.randrange(32)))
    return data[:place] + value.to_bytes(4, "little") + data[place + 4 :]


def _long(data: bytes, chance: random.Random, *_: object) -> bytes:
    """Ten or a hundred thousand times the same."""
    place = chance.randrange(len(data) + 1)
    piece = chance.choice((b" ", b"0 ", b"9", b"x", b'"', b"[", b"#\n", b"-1,", b"\\", b"&amp;", b"A{}"))
    return data[:place] + piece * chance.choice((300, 10_000, 100_000 // len(piece))) + data[place:]


MUTATIONS: list[Mutation] = [
    *(_flip, _cut, _drop, _double, _swap, _splice, _nest, _binary, _long),
    *(_word, _word, _word, _word, _number, _number, _number, _number, _value, _value, _value, _value),
]


def endure(path: Path, *, thorough: bool = True, repair: bool = False) -> bool:
    """Everything that our commands do with a file they are given; whether it could be read."""
    from vitruvian.errors import VitruvianError
    from vitruvian.formats import registry

    def attempt(act: Callable[[], object]) -> object:
        try:
            return act() or True
        except VitruvianError as error:
            assert "\n" not in str(error) and 0 < len(str(error)) < 1000, f"not one line: {str(error)[:200]!r}"
            return None

    if registry.extension(path) not in registry.SCENES:
        return bool(attempt(lambda: registry.load(path)))
    for finding in registry.check(path):
        str(finding)
    figures = attempt(lambda: registry.humanoids(path, repair=repair))
    if thorough:
        attempt(lambda: packed(figures if isinstance(figures, list) else []))
        attempt(lambda: registry.fix(path, path.with_name("fixed" + path.suffix)))
    return figures is not None


def packed(figures: list) -> None:
    from vitruvian.body.pack import pack
    from vitruvian.motion.tracks import motion_of

    for h in figures:
        motion_of(h, pack(h).skeleton)


def fuzz(
    cases: Iterable[int], *, seed: int = 0, data: Path | None = None, workers: int = 2, keep: Path | None = None
) -> tuple[list[Failure], int]:
    """Run the cases in worker processes: what failed, in order, and how many could still be read."""
    files = sources(data)
    cases = list(cases)
    context = multiprocessing.get_context("fork")
    failures: list[Failure] = []
    lanes = [_Lane(context, cases[k::workers], seed, files, keep) for k in range(workers)]
    while any(lane.todo for lane in lanes):
        for lane in lanes:
            failures += lane.look()
        time.sleep(0.05)
    return sorted(failures, key=lambda f: f.case), sum(lane.read for lane in lanes)


class _Lane:
    """A worker process, watched from outside; when it dies or hangs, the next one goes on after the bad case."""

    def __init__(self, context, cases: list[int], seed: int, files: list[Source], keep: Path | None):  # noqa: ANN001
        self.context, self.todo, self.seed, self.files, self.keep = context, cases, seed, files, keep
        self.read = 0
        self.start()

    def start(self) -> None:
        self.inbox, end = self.context.Pipe(duplex=False)
        self.worker = self.context.Process(target=_work, args=(end, self.todo, self.seed, self.files, self.keep))
        self.worker.start()
        end.close()
        self.since = time.monotonic()

    def look(self) -> list[Failure]:
        """What happened since; restarts the worker where it must."""
        failures: list[Failure] = []
        done = 0
        try:
            while self.inbox.poll():
                case, read, what = self.inbox.recv()
                self.read += read
                done += 1
                self.since = time.monotonic()
                if what:
                    failures.append(self.failure(case, what))
        except EOFError:
            self.worker.join(5)
        self.todo = self.todo[done:]
        if not self.todo:
            self.worker.join(5)
        elif not self.worker.is_alive():
            failures.append(self.failure(self.todo.pop(0), f"the process ended with {self.worker.exitcode}"))
            self.restart()
        elif time.monotonic() - self.since > 3 * SECONDS:  # a busy machine is slower than its clock
            self.worker.kill()
            self.worker.join()
            failures.append(self.failure(self.todo.pop(0), "hangs"))
            self.restart()
        return failures

    def restart(self) -> None:
        if self.todo:
            self.start()

    def failure(self, case: int, what: str) -> Failure:
        return Failure(case, mutated(case, self.seed, self.files)[0], what)


def _work(outbox, cases: list[int], seed: int, files: list[Source], keep: Path | None) -> None:  # noqa: ANN001
    """In a process of its own: run cases, send (case, whether it was read, what went wrong or "") for each."""
    warm_up()
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + BYTES, used + BYTES))
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        for case in cases:
            name, extension, data = mutated(case, seed, files)
            path = Path(folder) / f"case{extension}"
            path.write_bytes(data)
            if keep is not None:
                (keep / f"case-{case}{extension}").write_bytes(data)
            before, read, what = time.process_time(), False, ""
            try:
                read = endure(path, thorough=case % 4 == 0, repair=case % 2 == 0)
            except BaseException:
                what = "".join(traceback.format_exc(limit=-4))
            taken = time.process_time() - before
            if taken > SECONDS:
                what += f"took {taken:.1f} s"
            outbox.send((case, read, what))
    outbox.close()


def warm_up() -> None:
    """Import what the readers import, so that it doesn't count as memory of a case."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for source in own_files({".x3d", ".ply", ".bvh"}):
            path = Path(folder) / source.name
            path.write_bytes(source.data)
            endure(path)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--only", type=int, help="run this case alone")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--data", type=Path, help="folder of real files")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--keep", type=Path, help="folder for the files of the cases")
    given = parser.parse_args()
    if given.keep:
        given.keep.mkdir(parents=True, exist_ok=True)
    data = given.data if given.data and given.data.is_dir() else None
    cases = range(given.cases) if given.only is None else [given.only]
    start = time.monotonic()
    failures, read = fuzz(cases, seed=given.seed, data=data, workers=given.workers, keep=given.keep)
    for failure in failures:
        print(f"case {failure.case} of {failure.source}: {failure.what}", file=sys.stderr)
    seconds = time.monotonic() - start
    print(f"{len(cases)} cases in {seconds:.0f} s: {read} could still be read, {len(failures)} failed")
    return 1 if failures else 0


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    raise SystemExit(main())
