"""What light does at a surface: a photographer's studio, materials by the name of a part, tone mapping.

All colours inside are linear; sRGB comes in and goes out. Sources: GGX with Smith shadowing (Walter et al. 2007;
Hammon's approximation), Schlick's Fresnel, wrapped diffuse light for skin (Green, GPU Gems, 2004), hair
highlights after Kajiya and Kay 1989, the filmic curve is Narkowicz's fit of the ACES reference.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.show.camera import direction
from vitruvian.show.grain import checks, close, noise

Single = NDArray[np.floating]  # float32 where it is large
KINDS = ("plain", "skin", "eye", "hair", "cloth", "gloss", "checked")
_WORDS = {
    "skin": ("skin", "face", "flesh", "lips", "nail"),
    "eye": ("eye", "cornea", "iris", "sclera", "pupil"),
    "hair": ("hair", "brow", "lash", "beard"),
    "cloth": ("top", "shirt", "short", "trouser", "pants", "skirt", "dress", "cloth", "garment", "underwear", "suit",
              "sock", "sleeve", "panel"),
    "gloss": ("teeth", "tooth", "tongue", "gum", "shoe"),
    "checked": ("checked",),
}  # fmt: skip


def kind_of(name: str) -> int:
    """Which of `KINDS` a part of this name is drawn as: index."""
    low = name.lower()
    if "brow" in low or "lash" in low or "hair" in low:  # before "eye": eyebrows, eyelashes
        return KINDS.index("hair")
    if "eyelid" in low:
        return KINDS.index("skin")
    for kind, words in _WORDS.items():
        if any(w in low for w in words):
            return KINDS.index(kind)
    return KINDS.index("skin") if low.endswith("_def") else 0  # contour surfaces, by the names that DefBody gives


@dataclass(frozen=True)
class Light:
    """A far light. azimuth, elevation: degrees in the camera's frame (0 azimuth is at the camera, positive to its right
    side); color linear RGB times strength; radius: tangent of half its opening, for soft edges."""

    azimuth: float
    elevation: float
    color: tuple[float, float, float]
    radius: float = 0.15
    shadow: bool = False

    def towards(self, heading: float) -> Single:
        """Unit vector to the light for a camera that stands at azimuth `heading` (degrees) of the world."""
        return direction(self.azimuth + heading, self.elevation).astype(np.float32)


@dataclass(frozen=True)
class Studio:
    """Light and backdrop. Colours of the backdrop are sRGB as they shall appear."""

    key: Light = field(default_factory=lambda: Light(-40.0, 42.0, (2.62, 2.46, 2.26), 0.20, True))
    fill: Light = field(default_factory=lambda: Light(58.0, 14.0, (0.30, 0.34, 0.40), 0.6))
    rim: Light = field(default_factory=lambda: Light(146.0, 36.0, (1.35, 1.4, 1.5), 0.4))
    kicker: Light = field(default_factory=lambda: Light(-140.0, 22.0, (0.6, 0.64, 0.72), 0.4))
    sky: tuple[float, float, float] = (0.42, 0.445, 0.49)
    earth: tuple[float, float, float] = (0.24, 0.225, 0.21)
    center: tuple[float, float, float] = (0.925, 0.92, 0.912)
    edge: tuple[float, float, float] = (0.70, 0.695, 0.69)
    floor: tuple[float, float, float] = (0.80, 0.80, 0.80)
    exposure: float = 0.66

    def mirrored(self) -> Studio:
        """The studio seen in a mirror."""
        lights = ("key", "fill", "rim", "kicker")
        return replace(self, **{n: replace(getattr(self, n), azimuth=-getattr(self, n).azimuth) for n in lights})

    def lights(self) -> tuple[Light, ...]:
        return self.key, self.fill, self.rim, self.kicker


@dataclass(eq=False)
class Samples:
    """What is to be shaded: n points. Directions are unit vectors, colours linear."""

    normal: Single  # (n,3)
    soft: Single  # (n,3) normals of the smoothed surface, for light that has been inside the skin
    view: Single  # (n,3) to the eye
    albedo: Single  # (n,3)
    strand: Single  # (n,3) direction of hair, not normalised
    texture: Single  # (n,3) position at rest, for patterns that stay on the surface
    kind: NDArray[np.int8]
    roughness: Single
    metallic: Single
    sky: Single  # (n,) share of open sky
    lit: Single  # (n,) share of the key light
    pictured: NDArray[np.bool_]  # (n,) coloured by a picture, which needs no unevenness on top

    def __getitem__(self, some: object) -> Samples:
        return Samples(**{n: getattr(self, n)[some] for n in Samples.__dataclass_fields__})


def dot(a: Single, b: Single) -> Single:
    """Scalar products over the last axis of three."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def _unit(a: Single) -> Single:
    return a / np.maximum(np.sqrt(dot(a, a)), 1e-12)[..., None]


def _lobe(normal: Single, view: Single, light: Single, roughness: Single, base: Single | float) -> Single:
    """Specular reflection times the cosine, (n,) or (n,3): GGX, Smith, Schlick."""
    half = _unit(view + light)
    nl, nv = np.maximum(dot(normal, light), 0), np.maximum(dot(normal, view), 1e-3)
    nh, vh = np.maximum(dot(normal, half), 0), np.maximum(dot(view, half), 0)
    a = np.maximum(roughness * roughness, 0.002)
    d = a * a / (np.pi * (nh * nh * (a * a - 1) + 1) ** 2)
    smith = 0.5 / np.maximum(nl * (nv * (1 - a) + a) + nv * (nl * (1 - a) + a), 1e-4)
    bend = (1 - vh) ** 5
    scale = d * smith * nl
    if isinstance(base, np.ndarray):
        return scale[:, None] * (base + (1 - base) * bend[:, None])
    return scale * (base + (1 - base) * bend)


def shade(s: Samples, studio: Studio, heading: float, pixel: float = 1.0) -> Single:
    """Light (n,3), linear and tone mapped to 0..1 (display-linear), that leaves the samples towards the eye.

    pixel: how many metres of the subject a pixel is wide; patterns too fine for it are left out.
    """
    out = np.zeros_like(s.albedo)
    s = textured(s, pixel)
    for index, draw in enumerate((_plain, _skin, _eye, _hair, _cloth, _plain, _plain)):
        some = np.flatnonzero(s.kind == index)
        if some.size == len(s.kind):
            out = draw(s, studio, heading)
        elif some.size:
            out[some] = draw(s[some], studio, heading)
    out *= np.float32(studio.exposure)
    grey = dot(out, np.array([0.2126, 0.7152, 0.0722], np.float32))[:, None]
    return filmic(grey + 0.86 * (out - grey))  # the curve makes colours richer than they are


def textured(s: Samples, pixel: float) -> Samples:
    """The samples with the small unevenness of skin, cloth and hair."""
    albedo, normal, roughness = s.albedo.copy(), s.normal.copy(), s.roughness.copy()
    skin = np.flatnonzero((s.kind == KINDS.index("skin")) & ~s.pictured)
    if skin.size:
        rest = s.texture[skin]
        blood = 0.045 * noise(rest * 38) + 0.03 * noise(rest * 130 + 7)
        red = albedo[skin, 0] / np.maximum(albedo[skin, 1], 1e-3)
        moist = np.clip(red / max(float(np.median(red)), 1e-3) - 1.25, 0, 0.5)  # lips
        roughness[skin] *= 1 - 0.9 * moist
        albedo[skin] *= 1 + blood * np.array([0.45, 1.0, 1.1], np.float32)
        pores = close(0.0016, pixel)
        if pores:
            normal[skin] = _unit(normal[skin] + np.float32(0.05 * pores) * noise(rest * 640, 3))
    cloth = np.flatnonzero((s.kind == KINDS.index("cloth")) & ~s.pictured)
    weave = close(0.002, pixel)
    if cloth.size and weave:
        rest = s.texture[cloth] * np.array([900, 420, 900], np.float32)
        fibre = noise(rest, 3)
        albedo[cloth] *= 1 + np.float32(0.10 * weave) * fibre[:, :1]
        normal[cloth] = _unit(normal[cloth] + np.float32(0.10 * weave) * fibre)
    hair = np.flatnonzero((s.kind == KINDS.index("hair")) & ~s.pictured)
    if hair.size:
        x, y, z = s.strand[hair].T
        way = np.stack([np.arctan2(x, z) * 70, y * 14, np.hypot(x, z) * 9], -1)  # changes slowly along a strand
        locks = noise(way * np.array([0.3, 1, 1], np.float32)) * 0.16 + noise(way) * 0.16
        albedo[hair] *= 1 + locks
        normal[hair] = _unit(normal[hair] + np.float32(0.12) * noise(way + 31, 3))
    checked = np.flatnonzero(s.kind == KINDS.index("checked"))
    if checked.size:
        albedo[checked] *= checks(s.texture[checked], pixel)
    return replace(s, albedo=albedo, normal=normal, roughness=roughness)


def _dome(s: Samples, studio: Studio, normal: Single) -> Single:
    """Light of the surroundings from above and, off the floor, from below, dimmed where the sky is hidden."""
    up = (0.5 + 0.5 * normal[:, 1])[:, None]
    sky, earth = np.asarray(studio.sky, np.float32), np.asarray(studio.earth, np.float32)
    # hidden places get light back from their own surface: brighter and redder where the albedo is (Jimenez et al. 2016)
    x = s.sky[:, None]
    a, b, c = 2.0404 * s.albedo - 0.3324, -4.7951 * s.albedo + 0.6417, 2.7552 * s.albedo + 0.6903
    return (earth + (sky - earth) * up) * np.maximum(x, ((x * a + b) * x + c) * x)


def _mirror(s: Samples, studio: Studio, base: Single | float, roughness: Single) -> Single:
    """The studio reflected, blurred by roughness."""
    nv = np.clip(dot(s.normal, s.view), 0, 1)
    up = 2 * nv * s.normal[:, 1] - s.view[:, 1]
    width = 0.35 + roughness
    t = np.clip(0.5 + 0.5 * up / width, 0, 1)[:, None]
    t = t * t * (3 - 2 * t)
    sky, earth = np.asarray(studio.sky, np.float32), np.asarray(studio.earth, np.float32)
    bend = (1 - nv) ** 5 * (1 - roughness) ** 2
    fresnel = base + (1 - base) * (bend[:, None] if isinstance(base, np.ndarray) else bend)
    fresnel = fresnel if isinstance(base, np.ndarray) else fresnel[:, None]
    return (earth + (1.3 * sky - earth) * t) * fresnel * (s.sky * s.sky)[:, None]


def _reach(s: Samples, light: Light) -> Single:
    """How much of a light arrives: the traced share for the key, half of the open sky for those without shadow rays."""
    return s.lit if light.shadow else s.sky


def _plain(s: Samples, studio: Studio, heading: float) -> Single:
    metal = s.metallic[:, None]
    base = 0.04 * (1 - metal) + s.albedo * metal
    matte = s.albedo * (1 - metal)
    out = matte * _dome(s, studio, s.normal) + _mirror(s, studio, base, s.roughness)
    for light in studio.lights():
        to = light.towards(heading)
        cosine = np.maximum(dot(s.normal, to), 0)[:, None]
        rough = np.sqrt(s.roughness**2 + (0.35 * light.radius) ** 2)
        part = matte / np.pi * cosine * np.pi * 0.5 + _lobe(s.normal, s.view, to, rough, base)
        out += part * np.asarray(light.color, np.float32) * _reach(s, light)[:, None]
    return out


def _skin(s: Samples, studio: Studio, heading: float) -> Single:
    # red light travels furthest inside skin: it sees smoother normals, wraps further round and bleeds into shadow
    mixes, wraps, bleed = (0.75, 0.40, 0.15), (0.30, 0.14, 0.06), (0.62, 0.95, 1.10)
    bent = [_unit(s.normal + m * (s.soft - s.normal)) for m in mixes]
    dome = np.stack([_dome(s, studio, b)[:, i] for i, b in enumerate(bent)], -1)
    out = s.albedo * dome + _mirror(s, studio, 0.028, s.roughness) * 0.8
    for light in studio.lights():
        to = light.towards(heading)
        reach = np.maximum(_reach(s, light), 0)
        color = np.asarray(light.color, np.float32)
        for i in range(3):
            w = wraps[i]
            wrapped = np.clip((dot(bent[i], to) + w) / (1 + w), 0, 1)
            out[:, i] += s.albedo[:, i] * 0.5 * wrapped ** (1 + w) * color[i] * reach ** bleed[i]
        rough = np.sqrt(s.roughness**2 + (0.35 * light.radius) ** 2)
        gloss = 0.75 * _lobe(s.normal, s.view, to, rough, 0.028) + 0.25 * _lobe(
            s.normal, s.view, to, rough * 0.6, 0.028
        )
        out += (gloss * reach)[:, None] * color
    return out


def _eye(s: Samples, studio: Studio, heading: float) -> Single:
    s = replace(s, roughness=np.full_like(s.roughness, 0.5), metallic=np.zeros_like(s.metallic))
    out = s.albedo * _dome(s, studio, s.soft)
    for light in studio.lights():
        wrapped = np.clip((dot(s.soft, light.towards(heading)) + 0.3) / 1.3, 0, 1)
        out += s.albedo * 0.5 * (wrapped * _reach(s, light))[:, None] * np.asarray(light.color, np.float32)
    out = out * 0.9
    # the wet front mirrors the lamps as soft boxes
    nv = np.clip(dot(s.normal, s.view), 0, 1)
    reflected = 2 * nv[:, None] * s.normal - s.view
    fresnel = 0.03 + 0.97 * (1 - nv) ** 5 * 0.6
    for light, strength in ((studio.key, 1.0), (studio.fill, 0.5)):
        # as photographers do, the lamp's picture is put low enough not to hide behind the upper lid
        low = replace(light, azimuth=0.75 * light.azimuth, elevation=min(light.elevation, 22.0)).towards(heading)
        inside = np.clip((dot(reflected, low) - 0.968) / 0.012, 0, 1)
        box = inside * inside * (3 - 2 * inside) * strength * (0.3 + 0.7 * np.sqrt(np.maximum(s.sky, 0)))
        out += (box * (fresnel + 0.05) * 11.0)[:, None] * np.asarray(light.color, np.float32)
    return out + _mirror(replace(s, roughness=np.full_like(s.roughness, 0.1)), studio, 0.03, s.roughness * 0 + 0.1)


def _hair(s: Samples, studio: Studio, heading: float) -> Single:
    flat = s.strand - dot(s.strand, s.normal)[:, None] * s.normal
    strand = _unit(flat + 1e-4)
    # hairs let light through and scatter it on: under other hair it is never quite dark (Zinke et al. 2008)
    s = replace(s, lit=0.3 + 0.7 * s.lit, sky=0.35 + 0.65 * s.sky)
    out = s.albedo * _dome(s, studio, s.normal)
    for light in studio.lights():
        to = light.towards(heading)
        half = _unit(s.view + to)
        color = np.asarray(light.color, np.float32) * _reach(s, light)[:, None]
        cosine = np.clip((dot(s.normal, to) + 0.25) / 1.25, 0, 1)[:, None]
        along = np.clip(dot(strand, to), -1, 1)
        out += s.albedo * 0.5 * cosine * np.sqrt(1 - along**2)[:, None] * color
        for shift, power, tint in ((-0.06, 90.0, 0.055), (0.10, 22.0, 0.0)):
            t = _unit(strand + shift * s.normal)
            sine = np.sqrt(np.maximum(1 - dot(t, half) ** 2, 0))
            shine = (sine**power)[:, None] * cosine
            out += shine * color * (tint if tint else s.albedo * 0.45)
    return out


def _cloth(s: Samples, studio: Studio, heading: float) -> Single:
    # fibres that stand off the cloth brighten its outline (Ashikhmin's velvet term, mild)
    rough = np.maximum(s.roughness, 0.7)
    out = s.albedo * _dome(s, studio, s.normal)
    nv = np.clip(dot(s.normal, s.view), 0, 1)
    fuzz = (0.12 * (1 - nv) ** 3)[:, None] * np.sqrt(s.albedo)
    for light in studio.lights():
        to = light.towards(heading)
        cosine = np.clip((dot(s.normal, to) + 0.08) / 1.08, 0, 1)[:, None]
        gloss = _lobe(s.normal, s.view, to, rough, 0.03)[:, None]
        color = np.asarray(light.color, np.float32) * _reach(s, light)[:, None]
        out += (s.albedo * 0.5 * cosine + gloss + fuzz * np.sqrt(cosine)) * color
    return out


def filmic(x: Single) -> Single:
    """Scene-linear to display-linear in 0..1: the mean of a curve with a toe (Narkowicz 2015) and one without."""
    x = np.maximum(x, 0)
    toe = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1)
    return 0.5 * toe + 0.5 * (1 - np.exp(-1.05 * x))


def to_linear(srgb: object) -> Single:
    """sRGB 0..1 to linear (IEC 61966-2-1)."""
    c = np.clip(np.asarray(srgb, np.float32), 0, 1)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4).astype(np.float32)


def to_srgb(linear: object) -> Single:
    """Linear 0..1 to sRGB."""
    c = np.clip(np.asarray(linear, np.float32), 0, 1)
    return np.where(c <= 0.0031308, c * 12.92, 1.055 * c ** (1 / 2.4) - 0.055).astype(np.float32)
