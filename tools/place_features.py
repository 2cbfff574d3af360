"""Place the standard's feature points on the built-in body: `python tools/place_features.py`.

Each default position is carried to the body relative to the nearest end of its segment, scaled by stature, and put on the
nearest vertex that moves with that joint or a neighbour. Left is mastered, right is its mirror image. Points without a
default position in the standard are left out.
"""

from __future__ import annotations

import json

import numpy as np

from vitruvian.hanim import tables
from vitruvian.modeling import anatomy, source
from vitruvian.modeling.person import assemble, rested
from vitruvian.modeling.shape import Shape, shaped


def main() -> None:
    sliders = Shape(proportions=0.75)
    points = shaped(sliders)
    where, centers, _ = rested(points, assemble(points, sliders))
    body = where[: source.BODY]
    names = anatomy.names()
    table, defaults = tables.joints(), tables.default_centers()
    holder = {entry.segment: entry.name for entry in table.values()}
    scale = np.ptp(body[:, 1]) / 1.7504
    weights = source.weights()
    strongest = weights.top(1)[0][: source.BODY, 0]
    mirror = source.array("mirror")
    places: dict[str, int] = {}
    for name, point in tables.feature_points().items():
        if point.position is None or name.startswith("r_"):
            continue
        joint = holder[point.segment]
        below = [n for n, e in table.items() if e.parent == joint and e.loa < 4 and joint != "skullbase"]
        ends = [joint, *below, *(n for n, e in table.items() if e.parent in below and e.loa < 4)]
        anchor = min(ends, key=lambda n: np.linalg.norm(np.array(point.position) - defaults[n]))
        wanted = centers[names.index(anchor)] + scale * (np.array(point.position) - defaults[anchor])
        near = {joint, anchor, table[joint].parent} | {n for n, e in table.items() if e.parent == joint}
        mine = np.isin(strongest, [names.index(n) for n in near if n])
        vertex = int(np.argmin(np.where(mine, np.linalg.norm(body - wanted, axis=1), np.inf)))
        places[name] = vertex
        if name.startswith("l_"):
            places["r_" + name[2:]] = int(mirror[vertex])
    (source.PACK / "features.json").write_text(json.dumps(places, indent=0, sort_keys=True) + "\n")
    print(f"{len(places)} feature points placed")


if __name__ == "__main__":
    main()
