"""Place the standard's feature points on the built-in body: `python tools/place_features.py`.

Each default position is carried to the body relative to the nearest end of its segment, scaled by stature, and put on the
nearest vertex that moves with that joint or a neighbour. Left is mastered, right is its mirror image. Points without a
default position in the standard are placed by the form of the body, or left out where their name does not say where.
"""

from __future__ import annotations

import json

import numpy as np

from vitruvian.hanim import tables
from vitruvian.modeling import anatomy, source
from vitruvian.modeling.look import mask
from vitruvian.modeling.person import assemble, rested
from vitruvian.modeling.shape import Shape, shaped


def shapes_of_the_face(body: np.ndarray, middle: np.ndarray) -> dict[str, int]:
    """Points that the form of the body itself shows: extremes of the face, the skull, the chest and the crotch."""
    eye = body[mask("eyelids") > 0.5]
    eye_x, eye_y, eye_z = np.abs(eye).mean(axis=0).tolist()
    x, y, z = body.T
    height = float(np.ptp(y))

    def most(value: np.ndarray, where: np.ndarray) -> int:
        if not where.any():
            raise SystemExit("error: no vertex where a feature point should be")
        return int(np.argmax(np.where(where, value, -np.inf)))

    front = middle & (z > eye[:, 2].min() - 0.02)
    face = front & (np.abs(y - eye_y) < 0.14)
    outer = mask("inside-mouth") < 0.1
    out = {
        "skull_vertex": most(y, middle),
        "sellion": most(-z, face & (np.abs(y - eye_y - 0.004) < 0.012)),
        "glabella": most(z, face & (np.abs(y - eye_y - 0.022) < 0.010)),
        "menton": most(-y, face & outer & (y > eye_y - 0.135) & (z > eye[:, 2].min() - 0.01)),
        "opisthocranion": most(-z, middle & (y > eye_y - 0.02)),
        "l_ectocanthus": most(x, (mask("eyelids") > 0.3) & (x > 0) & (np.abs(y - eye_y) < 0.006)),
        "l_infraorbitale": most(z, (np.abs(x - eye_x) < 0.006) & (np.abs(y - eye_y + 0.02) < 0.005) & (z > eye_z)),
        "l_tragion": most(z, (mask("ears") > 0.6) & (x > 0) & (np.abs(y - eye_y + 0.016) < 0.008)),
        "crotch": most(-y, middle & (np.abs(y - 0.47 * height) < 0.06) & (np.abs(z) < 0.06)),
        "navel": most(-z, middle & (z > 0.03) & (np.abs(y - 0.613 * height) < 0.012)),
        "l_thelion": most(z, (x > 0.045) & (x < 0.13) & (y > 0.68 * height) & (y < 0.76 * height)),
    }
    chin = body[out["menton"], 1]
    out["supramenton"] = most(-z, face & outer & (np.abs(y - chin - 0.026) < 0.009))
    return out


def epicondyles(body: np.ndarray, strongest: np.ndarray, centers: np.ndarray) -> dict[str, int]:
    """The sides of the left elbow and knee, which bend about X at rest: the vertices furthest out and in at its height."""
    names, out = anatomy.names(), {}
    for joint, above, bone in (("l_elbow", "l_shoulder", "humeral"), ("l_knee", "l_hip", "femoral")):
        limb = np.isin(strongest, [names.index(joint), names.index(above)])
        center = centers[names.index(joint)]
        limb &= np.abs(body[:, 1] - center[1]) < 0.015
        for side, sign in (("lateral", 1), ("medial", -1)):
            out[f"l_{bone}_{side}_epicondyle"] = int(np.argmax(np.where(limb, sign * body[:, 0], -np.inf)))
    return out


def limbs(body: np.ndarray, strongest: np.ndarray, centers: np.ndarray) -> dict[str, int]:
    """Left points that the standard gives no default place: extremes of the form at rest, near their joints."""
    names = anatomy.names()
    at = {n: centers[names.index(n)] for n in names}
    joint = np.array(names, dtype=object)[strongest]
    arm = [n for n in names if n.startswith(("l_shoulder", "l_elbow", "l_radio", "l_mid", "l_carp", "l_metac"))]
    is_arm, x, y, z = np.isin(joint, arm), *body.T
    leg = (x > 0) & ~is_arm & (y < at["l_hip"][1] + 0.02)
    knee, ankle, ball = at["l_knee"], at["l_talocrural"], at["l_metatarsophalangeal_2"]

    def most(value: np.ndarray, where: np.ndarray) -> int:
        return int(np.argmax(np.where(where, value, -np.inf)))

    def level(height: float, room: float = 0.008) -> np.ndarray:
        return leg & (np.abs(y - height) < room)

    out = {
        "l_trochanterion": most(x, level(at["l_hip"][1] - 0.01, 0.012)),
        "l_suprapatella": most(z, level(knee[1] + 0.035) & (np.abs(x - knee[0]) < 0.02)),
        "l_tibiale": most(-x, level(knee[1] - 0.03)),
        "l_medial_malleolus": most(-x, level(ankle[1] + 0.006)),
        "l_lateral_malleolus": most(x, level(ankle[1] - 0.004)),
        "l_sphyrion": most(-x, level(ankle[1] - 0.014)),
        "l_calcaneus_posterior": most(-z, leg & (y < 0.06)),
        "l_metatarsal_phalanx_1": most(-x, leg & (y < ball[1] + 0.03) & (np.abs(z - ball[2]) < 0.008)),
        "l_metatarsal_phalanx_5": most(x, leg & (y < ball[1] + 0.03) & (np.abs(z - ball[2] + 0.015) < 0.008)),
        "l_bideltoid": most(x, is_arm & (y > at["l_shoulder"][1] - 0.12)),
    }
    for ray in (2, 3, 5):
        c = at[f"l_metacarpophalangeal_{ray}"]
        out[f"l_metacarpal_phalanx_{ray}"] = most(x, is_arm & (np.hypot(y - c[1], z - c[2]) < 0.01))
    return out


def front_and_back(body: np.ndarray, middle: np.ndarray, places: dict[str, int]) -> dict[str, int]:
    """Points of the middle plane that lie at the heights of others."""
    x, y, z = body.T

    def front(height: float) -> int:
        trunk = middle & (np.abs(y - height) < 0.01)
        return int(np.argmax(np.where(trunk, z, -np.inf)))

    heights = {n: float(body[v, 1]) for n, v in places.items()}
    return {
        "waist_preferred_anterior": front(heights["waist_preferred_posterior"]),
        "mesosternale": front((heights["suprasternale"] + heights["substernale"]) / 2),
        "adams_apple": front(0.45 * heights["menton"] + 0.55 * heights["suprasternale"]),
    }


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
    middle = mirror[: source.BODY] == np.arange(source.BODY)
    seen = shapes_of_the_face(body, middle)
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
        if not name.startswith("l_"):
            mine &= middle
        else:
            mine &= body[:, 0] > 0
        vertex = int(np.argmin(np.where(mine, np.linalg.norm(body - wanted, axis=1), np.inf)))
        places[name] = vertex
        if name.startswith("l_"):
            places["r_" + name[2:]] = int(mirror[vertex])
    form = seen | epicondyles(body, strongest, centers) | limbs(body, strongest, centers)
    form |= front_and_back(body, middle, places | form)
    for name, vertex in form.items():
        places[name] = vertex
        if name.startswith("l_"):
            places["r_" + name[2:]] = int(mirror[vertex])
    (source.PACK / "features.json").write_text(json.dumps(places, indent=0, sort_keys=True) + "\n")
    print(f"{len(places)} feature points placed")


if __name__ == "__main__":
    main()
