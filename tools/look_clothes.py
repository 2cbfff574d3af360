"""T-shirt, shorts, trousers and shoes, cut out of the source's tights along level lines of simple fields."""

from __future__ import annotations

import numpy as np

from look_meshes import Cut, border, clip, of_quads, split

Array = np.ndarray
LIMB = ("shoulder", "elbow", "radiocarpal", "carp", "midcarpal", "metacarp")


def ramp(x: Array, a: float, b: float) -> Array:
    """0 below a, 1 above b, smooth between."""
    t = np.clip((x - a) / (b - a), 0, 1)
    return t * t * (3 - 2 * t)


class Measures:
    """Signed distances (about metres) from the edges of garments, for any points beside the reference body."""

    def __init__(self, centers: dict[str, Array]):
        self.c = centers

    def along(self, p: Array, start: str, end: str) -> Array:
        """Distance along the bone from its start, on the point's own side."""
        a, b = self.c["l_" + start], self.c["l_" + end]
        d = (b - a) / np.linalg.norm(b - a)
        q = np.stack([np.abs(p[:, 0]), p[:, 1], p[:, 2]], axis=1)
        return (q - a) @ d

    def length(self, start: str, end: str) -> float:
        return float(np.linalg.norm(self.c["l_" + end] - self.c["l_" + start]))

    def sleeve(self, p: Array, arm: Array, share: float) -> Array:
        """Above the end of the sleeve: `arm` (n,) is the weight of the arm's joints."""
        left = share * self.length("shoulder", "elbow") - self.along(p, "shoulder", "elbow")
        return np.where(arm > 0.3, left, 0.3)

    def neck(self, p: Array) -> Array:
        """Below a slanted plane: low at the throat, high at the nape."""
        q = p - np.array([0.0, 0.555, 0.078])
        return -(q @ np.array([0.0, 0.905, 0.425])) + 0.9 * np.maximum(np.abs(p[:, 0]) - 0.05, 0) * (p[:, 1] < 0.62)

    def above(self, p: Array, height: float) -> Array:
        return p[:, 1] - height

    def leg(self, p: Array, share: float) -> Array:
        """Above a cut across the leg: `share` 0..1 down the thigh, 1..2 down the calf."""
        if share <= 1:
            return share * self.length("hip", "knee") - self.along(p, "hip", "knee")
        return (share - 1) * self.length("knee", "talocrural") - self.along(p, "knee", "talocrural")


def noise(p: Array, seed: int, scale: Array | float) -> Array:
    """Smooth noise about -1..1: a few random waves; `scale` wavelengths (m) per axis."""
    rng = np.random.default_rng(seed)
    out = np.zeros(len(p))
    for _ in range(9):
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        out += np.sin(p @ (direction / scale) * 2 * np.pi * rng.uniform(0.6, 1.6) + rng.uniform(0, 6.28))
    return out / 3


def garment(cut: Cut, reference: Array, loose: Array, shade: Array, pieces: Array) -> dict[str, Array]:
    """Arrays of one garment: means as CSR, triangles with a turned-in hem, looseness (m) and shade per vertex.

    `pieces` (t,) int: which colour each triangle takes; the vertices between two colours are doubled.
    """
    t = cut.triangles
    key = t.astype(np.int64) * 8 + pieces[:, None]
    pairs, where = np.unique(key, return_inverse=True)
    source = (pairs // 8).astype(np.int32)
    edge = border(t)
    rim = np.unique(edge)
    # The hem: a second row of vertices at the border, drawn in, and a strip between.
    first = np.full(len(loose), -1, np.int64)
    first[source[::-1]] = np.arange(len(source))[::-1]
    row = np.full(len(loose), -1, np.int64)
    row[rim] = len(source) + np.arange(len(rim))
    a, b = edge.T
    strip = np.concatenate([np.stack([first[b], first[a], row[a]], 1), np.stack([first[b], row[a], row[b]], 1)])
    smooth = cut.means.tocsr()
    smooth.eliminate_zeros()
    return {
        "row": smooth.indptr.astype(np.int32),
        "point": smooth.indices.astype(np.uint16),
        "share": smooth.data.astype(np.float16),
        "surface": t.astype(np.uint16),  # of the means, for normals and smoothing
        "vertex": np.concatenate([source, rim]).astype(np.uint16),  # row of the means of each drawn vertex
        "hem": (np.arange(len(source) + len(rim)) >= len(source)),
        "triangles": np.concatenate([where.reshape(-1, 3), strip]).astype(np.uint16),
        "piece": np.concatenate([(pairs % 8), np.zeros(len(rim), np.int64)]).astype(np.uint8),
        "loose": loose.astype(np.float16),
        "shade": shade.astype(np.float16),
    }


def clothes(quads: Array, reference: Array, arm_weight: Array, centers: dict[str, Array], body: Array) -> dict:
    """{garment: arrays}, and {garment: (13380,) signed distance of body vertices from its edges}.

    quads (q,4) of the tights; reference (points,3) the person they are cut on; arm_weight (points,) of the arms' joints.
    """
    m = Measures(centers)
    cloth = of_quads(quads, len(reference))
    p = cloth.at(reference)
    arm = cloth.means @ arm_weight
    ground = body[:, 1].min()
    hem = centers["l_hip"][1] - 0.012
    waist = hem + 0.075
    out, covers = {}, {}

    def fields(q: Array, a: Array) -> dict[str, Array]:
        high = ground + 0.088 + 0.10 * (q[:, 2] - 0.03)
        return {
            "top": np.minimum.reduce([m.sleeve(q, a, 0.66), m.neck(q), m.above(q, hem)]),
            "sleeve": m.sleeve(q, a, 0.66),
            "neck": m.neck(q),
            "hem": m.above(q, hem),
            "waist": np.where(a > 0.3, -0.3, waist - q[:, 1]),
            "shorts": m.leg(q, 0.74),
            "trousers": m.leg(q, 1.965),
            "suit": np.minimum.reduce([m.sleeve(q, a, 0.42), m.neck(q) - 0.004, m.leg(q, 0.36)]),
            "shoe": high - q[:, 1] + 0.25 * np.maximum(q[:, 2] - 0.09, 0),
            "sole": (ground + 0.014) - q[:, 1],
        }

    on_body = fields(body, arm_weight[: len(body)])
    covers["t-shirt"] = on_body["top"]
    covers["shorts"] = np.minimum(on_body["waist"], on_body["shorts"])
    covers["trousers"] = np.minimum(on_body["waist"], on_body["trousers"])
    covers["shoes"] = on_body["shoe"]
    covers["suit"] = on_body["suit"]
    cloth.fields = fields(p, arm)

    top = cloth
    for name in ("sleeve", "neck", "hem"):
        top = clip(top, name)
    for name, level in (("sleeve", 0.02), ("sleeve", 0.0225), ("neck", 0.017), ("hem", 0.022), ("hem", 0.0245)):
        top = split(top, name, level)
    f, q = top.fields, top.at(reference)
    arm_here = top.means @ arm_weight
    torso = ramp(f["neck"], 0.05, 0.15) * (1 - ramp(arm_here, 0.2, 0.5))
    around = np.arctan2(q[:, 0], q[:, 2] - 0.01)
    wander = 1.4 * noise(q, 3, np.array([0.3, 0.25, 0.3]))
    # Below the chest the cloth hangs in folds that widen toward the hem; at the waist it is heaped up a little.
    hang = np.sin(11 * around + wander) * (0.6 + 0.4 * np.sin(4 * around + 1)) * ramp(-f["hem"], -0.26, -0.02)
    heap = noise(q, 13, np.array([0.22, 0.05, 0.22])) * np.exp(-(((f["hem"] - 0.11) / 0.07) ** 2))
    folds = 0.0020 * noise(q, 3, np.array([0.10, 0.22, 0.10])) + 0.0058 * hang + 0.0026 * heap
    folds = folds * torso
    pulls = noise(q @ np.array([[1.0, 0.5, 0], [0, 1, 0], [0.6, 0, 1]]), 5, np.array([0.09, 0.09, 0.3]))
    near_arm = np.exp(-(((np.abs(q[:, 0]) - 0.16) / 0.06) ** 2 + ((q[:, 1] - 0.43) / 0.09) ** 2))
    sleeves = noise(q, 17, np.array([0.05, 0.07, 0.16])) * ramp(arm_here, 0.3, 0.7) * ramp(f["sleeve"], 0.01, 0.05)
    loose = 0.0032 + 0.012 * ramp(-f["hem"], -0.30, 0.0) + 0.007 * ramp(arm_here * (0.12 - f["sleeve"]), 0.0, 0.12)
    loose = loose * ramp(f["neck"], -0.03, 0.07) + 0.0018 + folds + 0.0042 * pulls * near_arm + 0.0022 * sleeves
    loose = np.maximum(loose, 0.002)
    # The ribbed collar lies closer to the neck than the cloth below it.
    loose += 0.0012 * ramp(0.018 - f["neck"], 0, 0.002) - 0.0022 * ramp(0.03 - f["neck"], 0, 0.03)
    shade = 1 + 9 * folds + 0.05 * np.minimum(pulls, 0) * near_arm
    sleeve, neck, low = (f[k][top.triangles].mean(axis=1) for k in ("sleeve", "neck", "hem"))
    pieces = np.where(neck < 0.017, 1, 0)
    pieces[((sleeve > 0.02) & (sleeve < 0.0225)) | ((low > 0.022) & (low < 0.0245))] = 2
    out["t-shirt"] = garment(top, reference, loose, shade, pieces)

    for name in ("shorts", "trousers"):
        legs = clip(clip(cloth, "waist"), name)
        legs = split(split(legs, name, 0.024), name, 0.0265)
        f, q = legs.fields, legs.at(reference)
        end = 0.011 if name == "shorts" else 0.016
        loose = 0.002 + 0.004 * ramp(f["waist"], 0.03, 0.15) + end * ramp(-f[name], -0.42, -0.05)
        crotch = np.exp(-((q[:, 0] / 0.09) ** 2) - ((q[:, 1] - hem + 0.07) / 0.07) ** 2)
        bends = noise(q, 7, np.array([0.10, 0.20, 0.10])) + (0.8 * noise(q, 9, np.array([0.2, 0.05, 0.2])) * crotch)
        if name == "trousers":
            knee = np.exp(-(((f["trousers"] - 0.40) / 0.07) ** 2)) + np.exp(-(((f["trousers"] - 0.02) / 0.06) ** 2))
            bends = bends + knee * noise(q, 11, np.array([0.3, 0.06, 0.3]))
        loose = loose + 0.0018 * bends * ramp(f["waist"], 0.05, 0.15)
        shade = 1 + 0.05 * bends
        low = f[name][legs.triangles].mean(axis=1)
        pieces = np.where((low > 0.024) & (low < 0.0265), 2, 0)
        out[name] = garment(legs, reference, np.maximum(loose, 0.0015), shade, pieces)

    suit = clip(cloth, "suit")
    suit = split(suit, "suit", 0.008)
    band = suit.fields["suit"][suit.triangles].mean(axis=1) < 0.008
    edge = suit.fields["suit"]
    loose = 0.0016 + 0.0008 * ramp(0.010 - edge, 0, 0.002)
    out["suit"] = garment(suit, reference, loose, np.ones(len(edge)), band.astype(int))

    shoe = split(split(clip(cloth, "shoe"), "sole"), "sole", 0.007)
    f, q = shoe.fields, shoe.at(reference)
    collar = ramp(f["shoe"], 0.0, 0.02)
    loose = 0.0045 + 0.002 * (1 - collar) + 0.0035 * (f["sole"] >= 0)
    shade = 1 - 0.10 * (1 - collar)
    pieces = np.where(f["sole"][shoe.triangles].mean(axis=1) > 0, 1, 0)
    out["shoes"] = garment(shoe, reference, loose, shade, pieces) | {"flat": (f["sole"] > 0.001).astype(np.uint8)}
    return {"garments": out, "covers": covers}
