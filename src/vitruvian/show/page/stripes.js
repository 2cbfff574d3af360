// Bands across the limbs and stripes along them, by the bones at rest: where a seam opens or slips, the pattern breaks.
// The same pattern as the sheets of `vitruvian render --compare`.

import * as THREE from "three";

const BAND = 0.03, SECTORS = 12, THIN = 0.012; // metres along a limb, stripes round it, metres of radius
const CLAY = [0.86, 0.8, 0.74], DARK = [0.1, 0.24, 0.36];
const KEPT = /eye|iris|pupil|sclera|cornea|hair|brow|lash|beard|teeth|tongue/i; // parts that stay as they are

/**
 * (V*3) for each vertex of `skin`, at rest: metres along its limb, downwards, and across it forwards and sideways. Each
 * joint has a frame of its own, and the weights blend them.
 */
export function limbPlaces(skin) {
  const maps = limbMaps(skin), { V, rest } = skin, out = new Float32Array(3 * V);
  for (let v = 0; v < V; v++) out.set(put(maps, v, rest, v), 3 * v);
  return out;
}

/** The same for other points (N*3) on or near the skin at rest, each by the map of the nearest vertex. */
export function placesOn(skin, points) {
  const maps = limbMaps(skin), { V, rest } = skin, out = new Float32Array(points.length), cell = 0.02 * extent(rest), cells = new Map();
  const at = (a, i, d = [0, 0, 0]) => [0, 1, 2].map((c) => Math.floor(a[3 * i + c] / cell) + d[c]).join();
  for (let v = 0; v < V; v++) { const key = at(rest, v); if (!cells.has(key)) cells.set(key, []); cells.get(key).push(v); }
  const steps = [-1, 0, 1].flatMap((x) => [-1, 0, 1].flatMap((y) => [-1, 0, 1].map((z) => [x, y, z])));
  for (let i = 0; 3 * i < points.length; i++) {
    let best = 0, nearest = Infinity;
    for (const d of steps) for (const v of cells.get(at(points, i, d)) ?? []) {
      const away = (rest[3 * v] - points[3 * i]) ** 2 + (rest[3 * v + 1] - points[3 * i + 1]) ** 2 + (rest[3 * v + 2] - points[3 * i + 2]) ** 2;
      if (away < nearest) { nearest = away; best = v; }
    }
    out.set(put(maps, best, points, i), 3 * i);
  }
  return out;
}

const extent = (a) => { let low = Infinity, high = -Infinity; for (let i = 1; i < a.length; i += 3) { low = Math.min(low, a[i]); high = Math.max(high, a[i]); } return Math.max(high - low, 1e-6); };
const put = (maps, v, points, i) => [0, 4, 8].map((r) => maps[12 * v + r] * points[3 * i] + maps[12 * v + r + 1] * points[3 * i + 1] + maps[12 * v + r + 2] * points[3 * i + 2] + maps[12 * v + r + 3]);

/** (V*12) the blended map of each vertex from points at rest to places on its limb. */
function limbMaps({ V, J, row, joint, weight, centers, parents }) {
  const load = new Float64Array(J), below = parents.map(() => []), down = [], along = new Float64Array(J), frames = [];
  for (let k = 0; k < row[V]; k++) if (joint[k] < J) load[joint[k]] += weight[k];
  for (let j = J - 1; j >= 0; j--) if (parents[j] >= 0) { load[parents[j]] += load[j]; below[parents[j]].unshift(j); }
  const at = (j) => [centers[3 * j], centers[3 * j + 1], centers[3 * j + 2]], dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]], cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  for (let j = 0; j < J; j++) {
    const next = below[j].reduce((best, i) => (best < 0 || load[i] > load[best] ? i : best), -1), bone = next < 0 ? [0, 0, 0] : sub(at(next), at(j)), size = Math.hypot(...bone), p = parents[j];
    down[j] = size > 1e-6 ? bone.map((x) => (x / size) * (bone[1] > 0.5 * size ? -1 : 1)) : p >= 0 ? down[p] : [0, -1, 0];
    if (p >= 0) along[j] = along[p] + dot(sub(at(j), at(p)), down[p]);
    let ahead = Math.abs(down[j][2]) < 0.8 ? [0, 0, 1] : [0, 1, 0];
    const on = dot(ahead, down[j]);
    ahead = ahead.map((x, c) => x - on * down[j][c]);
    const s = Math.hypot(...ahead);
    ahead = ahead.map((x) => x / s);
    const rows = [down[j], ahead, cross(down[j], ahead)];
    frames.push({ rows, offset: rows.map((r, c) => (c ? 0 : along[j]) - dot(r, at(j))) });
  }
  const maps = new Float32Array(12 * V);
  for (let v = 0; v < V; v++) {
    let sum = 0;
    for (let k = row[v]; k < row[v + 1]; k++) if (joint[k] < J) sum += weight[k];
    for (let k = row[v]; k < row[v + 1]; k++) if (joint[k] < J) {
      const { rows, offset } = frames[joint[k]], w = weight[k] / (sum || 1);
      for (let r = 0; r < 3; r++) for (let c = 0; c < 4; c++) maps[12 * v + 4 * r + c] += w * (c < 3 ? rows[r][c] : offset[r]);
    }
  }
  return maps;
}

/** The material of a part {name, double_sided} with stripes, or null when it stays as it is; `unit`: metres a unit of `place`. */
export function striped(part, unit) {
  if (KEPT.test(part.name)) return null;
  const made = new THREE.MeshStandardMaterial({ color: new THREE.Color().setRGB(...CLAY, THREE.SRGBColorSpace), roughness: 0.6, metalness: 0, side: part.double_sided ? THREE.DoubleSide : THREE.FrontSide });
  const dark = new THREE.Color().setRGB(...DARK, THREE.SRGBColorSpace).toArray().map((x) => x.toFixed(4));
  made.onBeforeCompile = (shader) => {
    shader.vertexShader = shader.vertexShader.replace("void main() {", `attribute vec3 place; varying vec3 place_;\nvoid main() {\n place_ = place * ${unit.toFixed(6)};`);
    shader.fragmentShader = shader.fragmentShader.replace("void main() {", `varying vec3 place_;
      float wave(float x, float blur) { float edge = abs(x - floor(x + 0.5)); return (1.0 - 2.0 * mod(floor(x), 2.0)) * clamp(2.0 * edge / max(blur, 1e-6), 0.0, 1.0); }
      void main() {`).replace("#include <color_fragment>", `#include <color_fragment>
      float across = length(place_.yz), pixel = 0.5 * length(fwidth(place_)), wide = across * ${(2 * Math.PI / SECTORS).toFixed(6)};
      float band = wave(place_.x / ${BAND}, pixel / ${BAND}), stripe = across < ${THIN} ? 1.0 : wave(atan(place_.z, place_.y) * ${(SECTORS / (2 * Math.PI)).toFixed(6)}, pixel / max(wide, 1e-6));
      diffuseColor.rgb *= mix(vec3(1.0), vec3(${dark.join(", ")}), 0.5 - 0.5 * band * stripe);`);
  };
  made.customProgramCacheKey = () => `stripes ${unit.toFixed(6)}`;
  return made;
}
