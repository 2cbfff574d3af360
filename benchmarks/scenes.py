"""How long scene files take to read, with every value typed, and to write.

The file is made here: a figure of 146 joints with a weighted skin, about 480 kB of XML. The peer is
Python's xml.etree, which only parses XML and types nothing; VRML is set beside it too, for want of a VRML reader.
"""

from __future__ import annotations

import statistics
import time
import xml.etree.ElementTree as etree
from collections.abc import Callable

import numpy as np
from _rows import main, row

from vitruvian.formats.vrml import parse_vrml
from vitruvian.formats.vrml_writer import print_vrml
from vitruvian.formats.x3d import parse_x3d
from vitruvian.formats.x3d_writer import print_x3d
from vitruvian.hanim.fields import type_of
from vitruvian.hanim.graph import Literal, Node, Scene, Use
from vitruvian.hanim.values import parse


def figure(joints: int = 146, points: int = 4300) -> Scene:
    """A scene with one skinned humanoid, made up of random numbers."""
    rng = np.random.default_rng(0)
    coordinate = Node("Coordinate", "skin", {"point": rng.normal(size=(points, 3)).round(5)})
    humanoid = Node("HAnimHumanoid", "hanim_figure", {"name": "figure", "version": "2.0", "loa": 4})
    root = above = None
    members = []
    for index in range(joints):
        mine = np.flatnonzero(rng.random(points) < 4 / joints).astype(np.int32)
        fields = {
            "name": f"joint_{index}",
            "center": rng.normal(size=3).round(4),
            "skinCoordIndex": mine,
            "skinCoordWeight": rng.random(mine.size).round(4),
        }
        joint = Node("HAnimJoint", f"hanim_joint_{index}", fields)
        if above is None or index % 12 == 0:
            above = root or joint
        if joint is not above:
            above.fields.setdefault("children", []).append(joint)  # type: ignore[union-attr]
        root, above = root or joint, joint
        members.append(Use(joint.name, joint))
    faces = np.full((2 * points, 4), -1, np.int32)
    faces[:, :3] = rng.integers(0, points, (2 * points, 3))
    mesh = Node("IndexedFaceSet", fields={"coordIndex": faces.ravel(), "coord": Use("skin", coordinate)})
    humanoid.fields |= {"skinCoord": coordinate, "skeleton": [root], "joints": members}
    humanoid.fields["skin"] = [Node("Shape", fields={"geometry": mesh})]
    return Scene(version="4.0", profile="Immersive", components=[("HAnim", 1)], body=[humanoid])


def typed(scene: Scene) -> int:
    """Type every value of a scene; returns how many."""
    count, protos = 0, scene.protos()
    for node in scene.walk():
        for key, value in node.fields.items():
            if isinstance(value, Literal):
                parse(value, type_of(node, key, protos))
                count += 1
    return count


def median(work: Callable[[], object], times: int) -> float:
    """Median processor time: what else the machine does counts little."""
    taken = []
    for _ in range(times):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return statistics.median(taken)


def rows(quick: bool = False) -> list[dict]:
    """One row each for reading and writing XML and VRML97: seconds beside xml.etree's for the XML file."""
    scene = figure()
    xml = print_x3d(scene)[0].encode()
    vrml = print_vrml(scene, "wrl")[0].encode()
    small = print_vrml(figure(points=1000), "wrl")[0].encode()
    read = parse_x3d(xml)
    works: list[tuple[str, Callable[[], object], float]] = [
        (f"read x3d, {len(xml) // 1000} kB, typed", lambda: typed(parse_x3d(xml)), 0.06),
        (f"read wrl, {len(vrml) // 1000} kB, typed", lambda: typed(parse_vrml(vrml)), 0.06),
        (f"read wrl, {len(small) // 1000} kB, typed", lambda: typed(parse_vrml(small)), 0.06),
        ("write x3d as it was read", lambda: print_x3d(read), 0.08),
        ("write x3d, every number new", lambda: print_x3d(scene), 0.4),
    ]
    found = []
    times = 3 if quick else 11
    for name, work, goal in works:
        work()
        ours, peer = median(work, times), median(lambda: etree.fromstring(xml), times)
        found.append(
            row(name, ours, "xml.etree, parsing the XML only", peer, peer / ours, f"<= {goal:g} s", ours <= goal)
        )
    return found


if __name__ == "__main__":
    main(__doc__, rows)
