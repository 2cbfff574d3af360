"""How the built-in person looks: skin colours, eyes, hair, brows, lashes, clothes, all following the shape.

Parts are made in the source's A pose from the points of the shaped person; whatever poses the body poses them too.
Geometry comes from the pack's `looks.npz` (built by `tools/build_looks.py`); colours are procedural. sRGB in 0..1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from scipy.sparse import csr_matrix

from vitruvian.body.types import Floats, Ints
from vitruvian.errors import VitruvianError
from vitruvian.modeling import source

Color = tuple[float, float, float]

# Skin from lightest to darkest, warm undertones.
TONES = np.array([(0.95, 0.80, 0.72), (0.90, 0.71, 0.60), (0.79, 0.57, 0.44), (0.61, 0.41, 0.30), (0.40, 0.26, 0.19), (0.27, 0.17, 0.13)])  # fmt: skip  # noqa: E501
TONE_NAMES = {"porcelain": 0.0, "fair": 0.15, "light": 0.25, "medium": 0.4, "tan": 0.5, "brown": 0.65, "dark": 0.8, "deep": 0.95}  # fmt: skip  # noqa: E501
HAIR: dict[str, Color] = {
    "black": (0.085, 0.07, 0.065), "dark brown": (0.19, 0.125, 0.085), "brown": (0.30, 0.195, 0.125),
    "chestnut": (0.36, 0.20, 0.12), "auburn": (0.42, 0.18, 0.09), "blond": (0.66, 0.50, 0.29),
    "red": (0.56, 0.25, 0.10), "grey": (0.56, 0.55, 0.53), "white": (0.84, 0.83, 0.80),
}  # fmt: skip
EYES: dict[str, Color] = {
    "brown": (0.36, 0.21, 0.10), "hazel": (0.44, 0.33, 0.15), "green": (0.32, 0.42, 0.24),
    "blue": (0.30, 0.45, 0.60), "grey": (0.42, 0.47, 0.50),
}  # fmt: skip
PLAIN = {"teeth": source.TEETH, "tongue": source.TONGUE}  # parts that the source has as they are
STYLES = ("short", "bob", "bun", "none")


@dataclass(frozen=True, eq=False)
class LookPart:
    """One part: `vertices` (n,3) in the A pose, `triangles` (t,3), `colors` (n,3); `key` says which of the pack's parts
    it is, and so where its vertices hang, see `parents_of`."""

    name: str
    vertices: Floats
    triangles: Ints
    colors: Floats
    key: str
    roughness: float = 0.5
    double_sided: bool = False

    @property
    def parents(self) -> csr_matrix:
        return parents_of(self.key)


@cache
def parents_of(key: str) -> csr_matrix:
    """(n, 19158) sparse rows that sum to 1: the source points whose weights and face movements each vertex of a part
    takes. They do not depend on the shape."""
    from vitruvian.modeling import eyes, outfit

    if key == "eyes":
        return eyes.eye_parents()
    if key in outfit.GARMENTS:
        return outfit.pattern(key).drawn
    if key in PLAIN:
        index = np.arange(PLAIN[key].start, PLAIN[key].stop)
        return csr_matrix((np.ones(len(index)), index, np.arange(len(index) + 1)), (len(index), source.POINTS))
    index, share = looks(f"{key}.point").astype(np.int32), looks(f"{key}.share").astype(np.float64)
    share = share / share.sum(axis=1, keepdims=True)
    n, k = len(index), index.shape[-1]
    return csr_matrix((share.ravel(), index.ravel(), np.arange(0, n * k + 1, k)), (n, source.POINTS))


def named(value: str | Color, table: dict[str, Color], what: str) -> Color:
    """A colour of the table by name, or the three numbers themselves."""
    if isinstance(value, str):
        if value not in table:
            raise VitruvianError(f"{what}: expected one of {', '.join(table)} or three numbers, found {value!r}")
        return table[value]
    if len(value) != 3 or not all(0 <= float(c) <= 1 for c in value):
        raise VitruvianError(f"{what}: expected three numbers in 0..1, found {value}")
    return (float(value[0]), float(value[1]), float(value[2]))


@cache
def looks(name: str) -> np.ndarray:
    """An array of the looks pack."""
    return source._archive("looks")[name]


def mask(name: str) -> Floats:
    """(13380,) how much a body vertex belongs to a region.

    Regions: ears eyelids face fingernails toenails lips inside-mouth scalp.
    """
    return looks(f"mask.{name}") / 255.0


def tone_color(tone: float | str) -> Floats:
    """(3,) the colour of a skin tone 0 light to 1 dark, or of a name in `TONE_NAMES`."""
    if isinstance(tone, str):
        if tone not in TONE_NAMES:
            raise VitruvianError(f"skin_tone: expected 0..1 or one of {', '.join(TONE_NAMES)}, found {tone!r}")
        return tone_color(TONE_NAMES[tone])
    if not 0 <= tone <= 1:
        raise VitruvianError(f"skin_tone: expected a number in 0..1, found {tone}")
    at = np.linspace(0, 1, len(TONES))
    return np.array([np.interp(tone, at, TONES[:, k]) for k in range(3)])


def hair_color_at(age: float, color: str | Color | None, tone: float | str) -> Color:
    """The hair's colour: as asked for, else dark for dark skin, brown otherwise, greying from 45 to 75 years."""
    if color is not None:
        return named(color, HAIR, "hair_color")
    dark = float(np.clip((0.75 - tone_color(tone)[1]) / 0.3, 0, 1))
    own = (1 - dark) * np.array(HAIR["brown"]) + dark * np.array(HAIR["black"])
    grey = float(np.clip((age - 42) / 30, 0, 1)) ** 1.2
    mixed = (1 - grey) * own + grey * np.array((0.70, 0.69, 0.67))
    return (float(mixed[0]), float(mixed[1]), float(mixed[2]))


@lru_cache(maxsize=32)
def waves(length: float, seed: int) -> Floats:
    """(13380,) smooth noise about -1..1 on the reference body with waves of about `length` metres."""
    points = source.points()[: source.BODY]
    rng = np.random.default_rng(seed)
    out = np.zeros(len(points))
    for _ in range(8):
        d = rng.normal(size=3)
        out += np.sin(
            points @ (d / np.linalg.norm(d)) * (2 * np.pi / length * rng.uniform(0.6, 1.7)) + rng.uniform(0, 6.3)
        )
    return out / 2.8


def _tint(amount: Floats, factor: tuple[float, float, float]) -> Floats:
    """(n,3) what colours are multiplied with where `amount` (n,) of a change by `factor` has taken place."""
    return 1 + amount[:, None] * (np.array(factor) - 1)


@cache
def _complexion() -> tuple[Floats, Floats]:
    """Two fields (13380, 3) and (13380,): how flushed cheeks, nose, ears, lids, elbows, knees and knuckles differ from
    other skin, as factors; and where a beard grows."""
    reference = source.points()[: source.BODY]
    eye = source.points()[source.EYES].reshape(2, 72, 3).mean(axis=1)[0]
    x, y, z = np.abs(reference[:, 0]), reference[:, 1] - eye[1], reference[:, 2]
    face = z > 0.06

    def spot(cx: float, cy: float, rx: float, ry: float) -> Floats:
        return np.exp(-(((x - cx) / rx) ** 2) - ((y - cy) / ry) ** 2) * face * (y > -0.16)

    warm = (1.06, 0.93, 0.91)
    out = _tint(0.55 * spot(0.042, -0.036, 0.020, 0.016), warm)
    out *= _tint(0.60 * spot(0.0, -0.030, 0.012, 0.014), warm)
    out *= _tint(0.30 * spot(0.0, -0.115, 0.018, 0.014), warm)
    out *= _tint(0.45 * mask("ears"), (1.05, 0.88, 0.86))
    out *= _tint(0.55 * mask("eyelids"), (0.97, 0.87, 0.85))
    out *= _tint(0.30 * spot(0.030, -0.016, 0.016, 0.006), (0.93, 0.87, 0.90))
    from vitruvian.modeling.anatomy import names

    centers = dict(zip(names(), source.array("centres").astype(np.float64) @ source.points()[source.POINTS :]))
    redder = [("elbow", 0.05, 0.35), ("knee", 0.07, 0.30)]
    redder += [(f"carpal_proximal_interphalangeal_{ray}", 0.012, 0.4) for ray in (2, 3, 4, 5)]
    redder += [(f"metacarpophalangeal_{ray}", 0.014, 0.25) for ray in (2, 3, 4)]
    redder += [(f"carpal_distal_interphalangeal_{ray}", 0.014, 0.3) for ray in (2, 3, 4, 5)]
    for joint, radius, amount in redder:
        for side in ("l_", "r_"):
            away = np.linalg.norm(reference - centers[side + joint], axis=1)
            out *= _tint(amount * np.exp(-((away / radius) ** 2)), (1.0, 0.86, 0.82))
    stubble = spot(0.0, -0.10, 0.045, 0.030) + spot(0.045, -0.085, 0.020, 0.030)
    return out, np.clip(stubble, 0, 1) * (1 - mask("lips"))


def skin_colors(
    *, tone: float | str, gender: float, age: float, seed: int, hair: Color | None, suit: Color | None
) -> Floats:
    """(13380, 3) colour of each body vertex: lips, nails, flushed cheeks, nose, ears, knuckles, knees, soft mottling.

    `hair`: the colour that shows through at the scalp, None for a bald head. `suit`: colour of the body suit that is
    painted where no clothes are worn, None for none.
    """
    base = tone_color(tone)
    fixed, stubble = _complexion()
    grown = float(np.clip((gender - 0.6) / 0.4, 0, 1) * np.clip((age - 15) / 6, 0, 1))
    color = base * fixed * _tint(0.22 * grown * stubble, (0.80, 0.82, 0.86))
    color *= 1 + 0.018 * waves(0.05, seed)[:, None] + 0.022 * waves(0.22, seed + 1)[:, None] * np.array([0.5, 1, 1])
    if age > 50:
        spots = np.clip(waves(0.022, seed + 2) - 0.8, 0, 1) * min(1.0, (age - 50) / 30)
        color *= _tint(0.5 * spots, (0.86, 0.78, 0.72))
    lips = (0.86, 0.56, 0.55) if base[1] > 0.45 else (1.02, 0.70, 0.68)
    color *= _tint((0.72 - 0.25 * gender) * np.clip(mask("lips") * 1.25, 0, 1), lips)
    inside = mask("inside-mouth")[:, None]
    color = color * (1 - inside) + inside * np.array([0.45, 0.16, 0.15])
    nails = np.clip(np.maximum(mask("fingernails"), mask("toenails")) * 1.2, 0, 1)[:, None]
    color = color * (1 - nails) + nails * (0.6 * base + 0.4 * np.array([0.98, 0.80, 0.78]))
    if hair is not None:
        scalp = 0.9 * mask("scalp")[:, None]
        color = color * (1 - scalp) + scalp * (0.75 * np.array(hair) + 0.25 * base)
    if suit is not None:
        cover = looks("suit.cover") / 1000.0
        painted = np.clip(cover / 0.01 + 0.5, 0, 1)[:, None]
        color = color * (1 - painted) + painted * np.array(suit)
    return np.clip(color, 0, 1)


def bound(key: str, points: Floats, scale: float) -> Floats:
    """Vertices (n,3) of a part that are means of source points plus an offset times `scale`."""
    return parents_of(key) @ points + scale * looks(f"{key}.offset")


def head_scale(points: Floats) -> float:
    """Size of the head against the reference person's: distance between the eyes and the back of the skull."""
    skull = looks("mask.scalp") > 200
    own, reference = points[: source.BODY][skull], source.points()[: source.BODY][skull]
    return float(np.linalg.norm(own.std(axis=0)) / np.linalg.norm(reference.std(axis=0)))


def hair_part(style: str, points: Floats, color: Color, seed: int) -> LookPart:
    """Hair of a style; strands differ a little in colour."""
    key = f"hair-{style}"
    vertices = bound(key, points, head_scale(points))
    shade = looks(f"{key}.shade").astype(np.float64)
    colors = np.array(color) * shade[:, None]
    colors += np.clip(shade - 1.0, 0, 1)[:, None] * np.array([0.10, 0.075, 0.05])
    return LookPart(
        "hair", vertices, looks(f"{key}.triangles").astype(np.int32), np.clip(colors, 0, 1), key, 0.45, True
    )


def fine_part(name: str, points: Floats, color: Color, thickness: float = 1.0) -> LookPart:
    """Brows or lashes. thickness: factor on the width of each brow hair."""
    vertices = bound(name, points, head_scale(points))
    if thickness != 1.0:  # brow hairs have a left and a right vertex in turn
        pair = vertices.reshape(-1, 2, 3)
        middle = pair.mean(axis=1, keepdims=True)
        vertices = (middle + thickness * (pair - middle)).reshape(-1, 3)
    colors = np.clip(np.array(color) * looks(f"{name}.shade")[:, None], 0, 1)
    return LookPart(name, vertices, looks(f"{name}.triangles").astype(np.int32), colors, name, 0.6, True)


def source_part(name: str, color: Color, roughness: float, points: Floats) -> LookPart:
    """A part that the source has as it is: teeth, tongue."""
    rows = PLAIN[name]
    triangles = (source.array(f"{name}_triangles") - rows.start).astype(np.int32)
    back = np.array([0.0, 0.0, -0.006 if name == "teeth" else 0.0])  # the lips do not quite close over them
    return LookPart(name, points[rows] + back, triangles, np.tile(color, (rows.stop - rows.start, 1)), name, roughness)


def auto_hair(gender: float, age: float) -> str:
    """The style of a person who was not asked."""
    return "short" if gender >= 0.5 else "bob" if age < 60 else "bun"


def look_parts(
    points: Floats,
    *,
    gender: float,
    age: float,
    tone: float | str,
    hair: str | None,
    hair_color: str | Color | None,
    eye_color: str | Color,
    outfit: dict[str, Color],
    seed: int,
) -> list[LookPart]:
    """All parts but the skin, for the points (19158,3) of a shaped person. `outfit`: garment -> colour, inner first."""
    from vitruvian.modeling.eyes import eyes_part
    from vitruvian.modeling.outfit import garment_part

    shade = hair_color_at(age, hair_color, tone)
    # Single hairs let the skin through, which opaque ones can only do by their colour.
    brow = 0.72 * np.array(shade) + 0.28 * 0.55 * tone_color(tone)
    parts = [
        eyes_part(points, named(eye_color, EYES, "eye_color"), seed),
        fine_part("brows", points, (float(brow[0]), float(brow[1]), float(brow[2])), 0.85 + 0.4 * gender),
        fine_part("lashes", points, (0.06, 0.045, 0.04)),
        source_part("teeth", (0.74, 0.70, 0.63), 0.25, points),
        source_part("tongue", (0.72, 0.36, 0.35), 0.4, points),
    ]
    if hair != "none":
        parts.append(hair_part(hair or auto_hair(gender, age), points, shade, seed))
    parts += [garment_part(name, points, color) for name, color in outfit.items()]
    return parts
