// Hands by their links: knuckles that round, palms that swell. The same as the hand program of vitruvian.deform, which
// Python lays out, both hands in one; names of arrays are those of its fields. Displacers that act before skinning move
// the skin that a hand's points were laid out on, not their places on its links.

import { quaternionOf, rigidParts } from "./contours.js";
import { multiply3, transpose3 } from "./deform.js";

const MOST = (120 * Math.PI) / 180; // flexion beyond which a knuckle grows no more
const TERMS = ["vertex", "share", "link", "along", "blend", "local", "swell"], GAPS = ["gap_vertex", "gap_share", "links", "alongs", "blends", "across", "gap_local", "fold", "width"];

/** The program out of a mesh message's blocks, or null. before, near, far: one more than the joint, 0: none. */
export function handProgram(get) {
  if (!get("hand_near")) return null;
  const out = {};
  for (const name of ["before", "near", "far", "start", "end", "axis_near", "axis_far", "normal_near", "normal_far", "vertices", "left", ...TERMS, ...GAPS]) out[name] = get(`hand_${name}`);
  return out;
}

/** The same program for some vertices; `of`: old vertex -> new one or -1. */
export function handsOf(program, of) {
  const cut = (names, vertex, renamed) => {
    const keep = [...program[vertex].keys()].filter((i) => of[program[vertex][i]] >= 0), n = program[vertex].length;
    return Object.fromEntries(names.map((name) => {
      const a = program[name], w = a.length / (n || 1);
      if (name === renamed) return [name, Uint32Array.from(keep, (i) => of[a[i]])];
      const out = new a.constructor(keep.length * w);
      keep.forEach((i, k) => out.set(a.subarray(w * i, w * i + w), w * k));
      return [name, out];
    }));
  };
  return { ...program, ...cut(TERMS, "vertex", "vertex"), ...cut(GAPS, "gap_vertex", "gap_vertex"), ...cut(["vertices", "left"], "vertices", "vertices") };
}

/** Move the vertices of hands in `positions`; after `rigid` and `blend`. */
export function handed(skin, positions) {
  const p = skin.hands, b = bent(p, rigidParts(skin)), at = new Float64Array(3), frame = new Float64Array(9), local = new Float64Array(3);
  p.vertices.forEach((v, i) => { for (let c = 3 * v; c < 3 * v + 3; c++) positions[c] *= p.left[i]; });
  for (let i = 0; i < p.vertex.length; i++) {
    const k = p.link[i], v = 3 * p.vertex[i];
    foot(b, k, p.along[i], at);
    frames(b, k, p.blend[i], frame);
    const grown = 1 + p.swell[3 * i] * b.bend[3 * k] + p.swell[3 * i + 1] * b.bend[3 * k + 1] + p.swell[3 * i + 2] * b.bend[3 * k + 2];
    const x = p.local[3 * i], y = p.local[3 * i + 1] * grown, z = p.local[3 * i + 2];
    for (let c = 0; c < 3; c++) positions[v + c] += p.share[i] * (at[c] + frame[3 * c] * x + frame[3 * c + 1] * y + frame[3 * c + 2] * z);
  }
  const two = new Float64Array(3), other = new Float64Array(9);
  for (let i = 0; i < p.gap_vertex.length; i++) {
    const a = p.links[2 * i], c = p.links[2 * i + 1], v = 3 * p.gap_vertex[i], part = p.across[i];
    foot(b, a, p.alongs[2 * i], at);
    foot(b, c, p.alongs[2 * i + 1], two);
    frames(b, a, p.blends[2 * i], frame);
    frames(b, c, p.blends[2 * i + 1], other);
    const bridge = [two[0] - at[0], two[1] - at[1], two[2] - at[2]], length = Math.hypot(...bridge), x = unit(bridge);
    const mean = [1, 4, 7].map((r) => (1 - part) * frame[r] + part * other[r]), y = square(mean, x), z = cross(x, y);
    const ratio = p.width[i] < 1e-6 ? 1 : length / p.width[i], thick = ratio < 1 ? Math.min(1 + p.fold[i] * (1 / Math.max(ratio, 1e-6) - 1), 2) : 1;
    for (let n = 0; n < 3; n++) local[n] = p.gap_local[3 * i + n] * (n === 1 ? thick : 1);
    for (let n = 0; n < 3; n++) positions[v + n] += p.gap_share[i] * (at[n] + part * bridge[n] + x[n] * local[0] + y[n] * local[1] + z[n] * local[2]);
  }
}

/** Links in a pose: ends, normals and side axes at both ends, and how far knuckles and muscles are bent. */
function bent(p, R) {
  const L = p.near.length, out = { yNear: [], yFar: [], zNear: [], zFar: [], bend: new Float64Array(3 * L), start: new Float64Array(3 * L), end: new Float64Array(3 * L) };
  const rotation = (j) => [0, 1, 2, 4, 5, 6, 8, 9, 10].map((k) => R[12 * j + k]);
  const put = (j, x) => [0, 4, 8].map((r) => R[12 * j + r] * x[0] + R[12 * j + r + 1] * x[1] + R[12 * j + r + 2] * x[2] + R[12 * j + r + 3]);
  const both = (A, B, v) => [0, 3, 6].map((r) => (A[r] + B[r]) * v[0] + (A[r + 1] + B[r + 1]) * v[1] + (A[r + 2] + B[r + 2]) * v[2]);
  const flexion = (A, B, axis) => { const q = quaternionOf(multiply3(transpose3(A), B)); return 2 * Math.atan2(q[0] * axis[0] + q[1] * axis[1] + q[2] * axis[2], q[3]); };
  const knuckle = (a) => 1 / Math.cos(Math.min(MOST, Math.max(0, a)) / 2) - 1;
  for (let l = 0; l < L; l++) {
    const of = (name) => p[name].subarray(3 * l, 3 * l + 3), near = p.near[l] - 1, own = rotation(near);
    const before = p.before[l] ? rotation(p.before[l] - 1) : own, after = p.far[l] ? rotation(p.far[l] - 1) : own;
    out.start.set(put(near, of("start")), 3 * l);
    out.end.set(put(p.far[l] ? p.far[l] - 1 : near, of("end")), 3 * l);
    const yNear = unit(both(before, own, of("normal_near"))), yFar = unit(both(own, after, of("normal_far")));
    out.yNear.push(yNear);
    out.yFar.push(yFar);
    out.zNear.push(square(both(before, own, of("axis_near")).map((x) => -x), yNear));
    out.zFar.push(square(both(own, after, of("axis_far")).map((x) => -x), yFar));
    const a = flexion(before, own, of("axis_near")), b = flexion(own, after, of("axis_far"));
    out.bend.set([knuckle(a), knuckle(b), 1 - Math.cos(Math.max(0, (a + b) / 2))], 3 * l);
  }
  return out;
}

function foot({ start, end }, k, along, out) {
  for (let c = 0; c < 3; c++) out[c] = start[3 * k + c] + along * (end[3 * k + c] - start[3 * k + c]);
}

/** Columns x, y, z into `out` (9): y the interpolated normal exactly, z as near as can be to the interpolated one. */
function frames({ yNear, yFar, zNear, zFar }, k, t, out) {
  const mix = (a, b) => [0, 1, 2].map((c) => (1 - t) * a[c] + t * b[c]), y = unit(mix(yNear[k], yFar[k])), z = square(mix(zNear[k], zFar[k]), y), x = cross(y, z);
  for (let c = 0; c < 3; c++) { out[3 * c] = x[c]; out[3 * c + 1] = y[c]; out[3 * c + 2] = z[c]; }
}

const unit = (v) => { const s = 1 / (Math.hypot(v[0], v[1], v[2]) || 1); return [v[0] * s, v[1] * s, v[2] * s]; };
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** The part of v across y, of unit length. */
const square = (v, y) => { const d = v[0] * y[0] + v[1] * y[1] + v[2] * y[2]; return unit(v.map((x, c) => x - d * y[c])); };
