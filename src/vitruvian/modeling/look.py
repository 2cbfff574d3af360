from dataclasses import dataclass

import numpy as np

from vitruvian.modeling import source


@dataclass(frozen=True)
class LookPart:
    name: str
    vertices: object
    triangles: object
    colors: object
    parent_index: object
    parent_weight: object
    color: tuple = (0.8, 0.8, 0.8)
    roughness: float = 0.5
    double_sided: bool = False
    opacity: float = 1.0


def look_parts(v, *, gender, age, seed=0, **k):
    out = []
    for n, sl, c in (
        ("eyes", source.EYES, (0.9, 0.9, 0.9)),
        ("teeth", source.TEETH, (0.9, 0.9, 0.85)),
        ("tongue", source.TONGUE, (0.8, 0.4, 0.4)),
    ):
        t = source.array(n + "_triangles") - sl.start
        p = v[sl]
        out.append(
            LookPart(n, p, t, np.tile(c, (len(p), 1)), np.arange(sl.start, sl.stop)[:, None], np.ones((len(p), 1)), c)
        )
    return out


def skin_colors(v, *, tone, gender, age, seed):
    return np.tile((0.85, 0.65, 0.55), (source.BODY, 1))


def hidden_faces(o):
    return np.zeros(len(source.array("triangles")), bool)
