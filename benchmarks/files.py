"""How fast files load, beside other programs, in turns.

BVH: the playground clip of CMU (2.07 MB, 31 joints, 2,752 frames) of the folder ../shared against pybvh 0.9, which
reads the same numbers but leaves angles as they are, while ours are quaternions. Without the folder a clip of that size
is written first. USD: a person who walks two cycles (60 frames), beside GLB, which says the same with four influences.

Scenes: 20 MB of numbers in each encoding, on one core; the real files of ../shared against the times they may take; the
largest of them against Castle's converter (each a process that reads the file and prints it as Classic X3D; start-up is the
same for an empty scene) and
against X_ITE in headless Chromium (each from the text to the scene in memory, nothing drawn, in a process that has
loaded other files before). `python benchmarks/files.py` prints the rows.
"""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

from _rows import main, row

ROOT = Path(__file__).resolve().parent.parent
CLIP = ROOT.parent / "shared" / "data" / "motion" / "cmu_01_01_playground.bvh"


HANIM = ROOT.parent / "shared" / "data" / "hanim"
LARGEST = HANIM / "JinNoAnimations_Fixed.x3d"
LEAST = 20.0  # MB/s
CONVERT = """import sys
from vitruvian.formats.vrml_writer import print_vrml
from vitruvian.formats.x3d import read_x3d
sys.stdout.write(print_vrml(read_x3d(sys.argv[1]), "x3dv")[0])"""


def rows(quick: bool = False) -> list[dict]:
    """Medians of interleaved runs, after one run each to warm up."""
    found = clip_rows(quick) + number_rows(quick)
    if LARGEST.is_file():
        found += real_rows(quick) + converter_rows(quick) + browser_rows(quick)
    return found


def number_rows(quick: bool = False) -> list[dict]:
    """Coordinates and key values, from bytes to typed arrays, in processor time."""
    import numpy as np

    from vitruvian.formats.vrml import parse_vrml
    from vitruvian.formats.x3d import parse_x3d
    from vitruvian.hanim.values import text_of, value

    rng = np.random.default_rng(0)
    places = rng.normal(size=(330_000, 3)).astype(np.float32)
    turns = rng.normal(size=(250_000, 4)).astype(np.float32)
    fields = (("Coordinate", "point", "MFVec3f", places), ("OrientationInterpolator", "keyValue", "MFRotation", turns))
    texts = {syntax: [text_of(a, kind, syntax) for *_, kind, a in fields] for syntax in ("xml", "vrml")}
    xml = "".join(f"<{n} {f}='{t}'/>" for (n, f, *_), t in zip(fields, texts["xml"]))
    vrml = "".join(f"{n} {{ {f} {t} }}\n" for (n, f, *_), t in zip(fields, texts["vrml"]))
    files = {
        "X3D XML": (parse_x3d, f"<X3D version='4.0' profile='Full'><Scene>{xml}</Scene></X3D>"),
        "Classic X3D": (parse_vrml, f"#X3D V4.0 utf8\nPROFILE Full\n{vrml}"),
        "VRML97": (parse_vrml, f"#VRML V2.0 utf8\n{vrml}"),
    }
    found = []
    for title, (parser, text) in files.items():
        data = text.encode()

        def read(parser: Callable = parser, data: bytes = data) -> list:
            return [value(n, f, k) for n, (_, f, k, _) in zip(parser(data, "t").walk(), fields, strict=True)]

        assert all(np.array_equal(a.astype(np.float32), b) for a, (*_, b) in zip(read(), fields))
        size = sum(map(len, texts["xml" if title == "X3D XML" else "vrml"])) / 1e6
        ours = _processor(read, 3 if quick else 7)
        found.append(
            _limit(f"numbers of {title}, {size / ours:.0f} MB/s of {size:.0f} MB", ours, size / LEAST, ">= 20 MB/s")
        )
    return found


def real_rows(quick: bool = False) -> list[dict]:
    """Real files: reading a humanoid with everything typed, writing it, examining it; processor time."""
    from vitruvian.formats import registry

    def saved(name: str) -> Callable[[], object]:
        humanoid = registry.humanoids(HANIM / name)[0]
        return lambda: registry.save(humanoid, Path(folder) / name, hanim="2.0")

    found = []
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        works: list[tuple[str, Callable[[], object], float]] = [
            (
                f"read {n} ({(HANIM / n).stat().st_size // 1000} kB), typed",
                lambda n=n: registry.humanoids(HANIM / n),
                0.06,
            )
            for n in ("JinNoAnimations_Fixed.x3d", "JinLOA3.x3d", "NancyPrototypes.wrl", "sample1.wrl")
        ]
        works += [(f"write {n}, built afresh", saved(n), 0.08) for n in ("JinNoAnimations_Fixed.x3d", "JinLOA3.x3d")]
        works += [(f"check {LARGEST.name}", lambda: registry.check(LARGEST), 0.15)]
        for title, work, goal in works:
            found.append(_limit(title, _processor(work, 3 if quick else 9), goal, f"<= {goal * 1000:.0f} ms"))
    return found


def converter_rows(quick: bool = False) -> list[dict]:
    """Castle's converter and ours, two processes: the processor time that each takes, in turns."""
    import resource

    castle = shutil.which("tovrmlx3d")
    if castle is None:
        return []

    def seconds(*command: str) -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, capture_output=True, check=True, env=environment)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime

    with tempfile.TemporaryDirectory() as folder:
        # modules are compiled once, as in every installation, whatever this process does with bytecode
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        environment["PYTHONPYCACHEPREFIX"] = str(Path(folder) / "compiled")
        empty = Path(folder) / "empty.x3d"
        empty.write_text("<X3D version='4.0' profile='Full'><Scene/></X3D>")
        programs = ([sys.executable, "-c", CONVERT], [castle])
        commands = [[*c, str(p)] for p in (LARGEST, empty) for c in programs]
        seconds(*commands[0])
        turns = [[seconds(*c) for c in commands] for _ in range(3 if quick else 9)]
    ours, peer, ours_start, peer_start = (statistics.median(t) for t in zip(*turns))
    return [
        _against(f"convert {LARGEST.name}, start-up taken off", ours - ours_start, "Castle 4.2.0", peer - peer_start),
        _against(f"convert {LARGEST.name}, whole process", ours, "Castle 4.2.0", peer, 1.0),
    ]


def browser_rows(quick: bool = False) -> list[dict]:
    """X_ITE's parser and ours, from text to scene: our graph, our graph with every number typed."""
    from vitruvian.formats.x3d import parse_x3d
    from vitruvian.hanim.view import humanoids

    chromium, referee = shutil.which("chromium"), ROOT / ".referee"
    sys.path.insert(0, str(ROOT / "tests"))
    try:
        import playwright.sync_api  # noqa: F401

        from xite import xite
    except ImportError:
        return []
    if chromium is None or not (referee / "node_modules" / "x_ite").is_dir():
        return []
    data = LARGEST.read_bytes()
    taken: list[float] = []
    with xite(referee, chromium) as browser:
        text = data.decode()
        runs = [
            lambda: parse_x3d(data, "t"),
            lambda: humanoids(parse_x3d(data, "t")),
            lambda: taken.append(browser.parse(text)),
        ]
        graph, typed, _ = medians(runs, 3 if quick else 9)
    peer = statistics.median(taken[1:]) / 1000
    return [
        _against(f"parse {LARGEST.name} into the scene graph", graph, "X_ITE 15", peer),
        _against(f"parse {LARGEST.name} into a typed humanoid", typed, "X_ITE 15", peer),
    ]


def _processor(work: Callable[[], object], times: int) -> float:
    """Median processor seconds, after one run to warm up: what else the machine does counts little."""
    work()
    taken = []
    for _ in range(times):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return statistics.median(taken)


def _limit(name: str, ours: float, limit: float, goal: str) -> dict:
    """A row against a time that it may take; the ratio says how much time is to spare."""
    return row(name, ours, "allowed", limit, limit / ours, goal, ours <= limit)


def _against(name: str, ours: float, peer: str, theirs: float, least: float = 1) -> dict:
    """A row against another program's time."""
    return row(name, ours, peer, theirs, theirs / ours, f">= {least:g}", theirs >= least * ours)


def clip_rows(quick: bool = False) -> list[dict]:
    """A BVH file, ours and pybvh's."""
    from vitruvian.formats.bvh import read_bvh

    try:
        from pybvh import read_bvh_file
    except ImportError:
        read_bvh_file = None
    with tempfile.TemporaryDirectory() as folder:
        path = CLIP if CLIP.is_file() else _clip(Path(folder) / "clip.bvh")
        runs = [lambda: read_bvh(path)] + ([lambda: read_bvh_file(str(path))] if read_bvh_file else [])
        times = medians(runs, 5 if quick else 25)
        size = path.stat().st_size / 1e6
    ours, peer = times[0], times[1] if read_bvh_file else None
    ratio = None if peer is None else peer / ours
    name = f"load BVH, {size:.1f} MB"
    mine = row(name, ours, "pybvh 0.9", peer, ratio, ">= 1", ratio is not None and ratio >= 1)
    return [mine, *_bvhio(name, quick), *_usd(quick)]


def _bvhio(name: str, quick: bool) -> list[dict]:
    """The same file in bvhio, where it is installed and the folder ../shared is there."""
    from vitruvian.formats.bvh import read_bvh

    try:
        import bvhio
    except ImportError:
        return []
    if not CLIP.is_file():
        return []
    ours, theirs = medians([lambda: read_bvh(CLIP), lambda: bvhio.readAsBvh(str(CLIP))], 3 if quick else 7)
    return [_against(name, ours, "bvhio", theirs, 10)]


def _usd(quick: bool) -> list[dict]:
    try:
        import pxr  # noqa: F401
    except ImportError:
        return []
    import vitruvian as vt
    from vitruvian.motion.clips import repeat

    h = vt.person()
    b = vt.pack(h)
    clip = vt.Clip(h, b, repeat(vt.walk(b.skeleton), 2), "linear")
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / "walk.usdc", Path(folder) / "walk.glb"]
        ours, peer = medians([lambda p=p: vt.save(clip, p) for p in paths], 3 if quick else 9)
        size = paths[0].stat().st_size / 1e6
    ratio = peer / ours
    name = f"write USD, {len(b.skin.rest):,} vertices, {len(clip.motion)} frames, {size:.1f} MB"
    return [row(name, ours, "GLB", peer, ratio, ">= 0.4", ratio >= 0.4)]


def medians(runs: list[Callable[[], object]], times: int) -> list[float]:
    """Median seconds of each of `runs`, taken in turns so that a busy machine slows all of them alike."""
    taken: list[list[float]] = [[] for _ in runs]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for turn in range(times + 1):
            for k, run in enumerate(runs):
                start = time.perf_counter()
                run()
                if turn:
                    taken[k].append(time.perf_counter() - start)
    return [statistics.median(t) for t in taken]


def _clip(path: Path) -> Path:
    """A clip of about the same size as CMU's, of our own walk."""
    import numpy as np

    from vitruvian.body.types import Skeleton
    from vitruvian.formats.bvh import write_bvh
    from vitruvian.hanim.tables import default_centers, joints_at, parent_at
    from vitruvian.motion.gait import walk

    centers = default_centers()
    names = list(joints_at(2))[:40]
    parents = [-1 if (p := parent_at(n, 2)) is None else names.index(p) for n in names]
    skeleton = Skeleton(tuple(names), np.array(parents), np.array([centers[n] for n in names]))
    write_bvh(walk(skeleton, fps=120, cycles=16), path)
    return path


if __name__ == "__main__":
    main(__doc__, rows)
