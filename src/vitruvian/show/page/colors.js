// Perceptually even colours, made in OKLab (B. Ottosson 2020).

/** sRGB 0..1 (clipped) of OKLCH: lightness 0..1, chroma, hue in degrees. */
export function oklch(L, C, h) {
  const a = C * Math.cos((h * Math.PI) / 180), b = C * Math.sin((h * Math.PI) / 180);
  const l = (L + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (L - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (L - 0.0894841775 * a - 1.291485548 * b) ** 3;
  return [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ].map((x) => toSrgb(Math.min(1, Math.max(0, x))));
}

export const toSrgb = (x) => (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);
export const toLinear = (x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);

/** 256 sRGB colours from dark violet over teal to light yellow; lightness rises evenly. */
export const RAMP = Array.from({ length: 256 }, (_, i) => {
  const t = i / 255;
  return oklch(0.3 + 0.63 * t, 0.115 + 0.03 * Math.sin(Math.PI * t), 292 - 187 * t);
});

export const css = (rgb) => `rgb(${rgb.map((x) => Math.round(255 * x)).join(" ")})`;

/** One of many colours that differ well: the golden angle around the hue circle at two lightnesses. */
export const category = (i) => oklch(0.66 + 0.1 * (i % 2), 0.12, (i * 137.508) % 360);
