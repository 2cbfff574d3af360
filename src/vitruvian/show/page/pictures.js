// Pictures on surfaces: each arrives once, is decoded by the browser and shared by all materials that show it. Texture
// coordinates count from the lower left corner of a picture.

import * as THREE from "three";

class Pictures {
  constructor() {
    this.sources = new Map(); // name -> THREE.TextureSource, null when the browser could not read it, or a Promise
    this.textures = new Map(); // name and wrapping -> THREE.Texture
    this.changed = () => {};
  }

  /** {wanted, ready, failed}: how many have arrived, can be seen, can't be read. */
  get told() {
    const all = [...this.sources.values()];
    return { wanted: all.length, ready: all.filter((s) => s instanceof THREE.TextureSource).length, failed: all.filter((s) => s === null).length };
  }

  /** A message of type "picture": {name, mime} and its bytes. */
  take({ name, mime }, blocks) {
    if (this.sources.has(name)) return;
    const blob = new Blob([blocks[""].data.array], { type: mime });
    const made = createImageBitmap(blob, { premultiplyAlpha: "none", colorSpaceConversion: "none" });
    this.sources.set(name, made.then(
      (bitmap) => { this.sources.set(name, new THREE.TextureSource(bitmap)); return bitmap; },
      () => { this.sources.set(name, null); return null; },
    ));
  }

  /** `material` with the picture {name, repeat, alpha} of a part multiplied on its colour, as soon as it is there. */
  dress(material, picture) {
    const source = picture && this.sources.get(picture.name);
    if (!source) return material;
    const put = () => {
      material.map = this.texture(picture);
      if (!material.map) return;
      if (picture.alpha === "mask") material.alphaTest = 0.5;
      else if (picture.alpha === "blend") material.transparent = true;
      material.needsUpdate = true;
      this.changed();
    };
    if (source instanceof Promise) source.then(put); else put();
    return material;
  }

  texture({ name, repeat }) {
    const source = this.sources.get(name), key = `${name} ${repeat}`;
    if (!(source instanceof THREE.TextureSource)) return null;
    if (!this.textures.has(key)) {
      const made = new THREE.Texture(), wrap = (on) => (on ? THREE.RepeatWrapping : THREE.ClampToEdgeWrapping);
      Object.assign(made, { source, flipY: false, colorSpace: THREE.SRGBColorSpace, wrapS: wrap(repeat[0]), wrapT: wrap(repeat[1]), anisotropy: 8, needsUpdate: true });
      this.textures.set(key, made);
    }
    return this.textures.get(key);
  }
}

export const pictures = new Pictures();

/** The texture coordinates (N*2) of a geometry as its attribute; WebGL counts from the first row, which is at the top. */
export function coordinates(uv) {
  const out = new Float32Array(uv.length);
  for (let i = 0; i < uv.length; i += 2) { out[i] = uv[i]; out[i + 1] = 1 - uv[i + 1]; }
  return new THREE.BufferAttribute(out, 2);
}
