// The "volume" operator, the same as vitruvian.deform.volume: turns as "log" does, and keeps every cross-section centred
// on its bent bone; where no section is one limb's it fades to "log". No drawing library here.

import { blend, deform, linear, once } from "./deform.js";
import { welded } from "./mesh.js";

const LEAST = 0.02; // what an influence counts for far from its bone
const SOFT = 0.6; // radii on each side of a joint over which centres change bones
const SQUARE = [0, 0.3], STRAIGHT = [0.34, 0.87]; // cosines between a bone and the next
const EDGE = 8; // how fast a joint counts with its weight
const BLUR = 6; // rounds in which neighbouring shares are averaged
const SMOOTH = 3; // rounds in which neighbouring centres are averaged

/** As `deform`: p' = R (p - c) + sum v_i M_i c, R the rotation of "log", c the centre of the vertex's section. */
export function volume(skin, pose, weights, positions, normals) {
  deform("log", skin, pose, weights, positions, normals);
  const center = whole(skin, "center", 3, centers), share = whole(skin, "share", 1, shares), carried = once(skin, "carried", () => carriers(skin, center));
  const [turned, there, unused] = once(skin, "room", () => [0, 1, 2].map(() => new Float32Array(3 * skin.V)));
  blend(skin, center, turned, unused, "log");
  linear({ ...skin, ...carried }, center, there, unused);
  for (let i = 0; i < positions.length; i++) positions[i] += share[Math.floor(i / 3)] * (there[i] - turned[i]);
}

/** What `make` works out about a whole skin, `size` numbers a vertex; of a part of it, those of its vertices. */
function whole(skin, name, size, make) {
  if (!skin.whole) return once(skin, name, () => make(skin));
  const all = once(skin.whole, name, () => make(skin.whole));
  return once(skin, name, () => {
    const out = new all.constructor(size * skin.V);
    skin.vertices.forEach((v, i) => out.set(all.subarray(size * v, size * v + size), size * i));
    return out;
  });
}

/** Weights that carry the centres: squares times how far a centre lies on the joint's bone, with the sum of the moving. */
function carriers(skin, center) {
  const { V, J, row, joint, weight } = skin, out = new Float32Array(weight.length), near = membership(skin, center);
  for (let v = 0; v < V; v++) {
    const first = row[v], last = row[v + 1];
    let total = 0, plain = 0, sharp = 0;
    for (let k = first; k < last; k++) total += weight[k];
    for (let k = first; k < last; k++) if (joint[k] < J) {
      plain += weight[k] / total;
      sharp += out[k] = (weight[k] / total) ** 2 * (near[k] + LEAST);
    }
    for (let k = first; k < last; k++) out[k] = joint[k] < J ? (out[k] * plain) / (sharp || 1) : weight[k] / total;
  }
  return { weight: out, over: new Float32Array(V) };
}

/** (n) for each influence how far the centre of its vertex lies past its joint and before the next ones, 0..1. */
function membership({ V, J, row, joint, rest, centers, parents }, center) {
  const way = ways(centers, parents), above = aboves({ V, J, row, joint, parents }), past = new Float64Array(joint.length).fill(1), out = new Float64Array(joint.length).fill(1);
  for (let v = 0; v < V; v++) {
    const c = center.subarray(3 * v, 3 * v + 3), radius = SOFT * Math.max(1e-3, Math.hypot(rest[3 * v] - c[0], rest[3 * v + 1] - c[1], rest[3 * v + 2] - c[2]));
    for (let k = row[v]; k < row[v + 1]; k++) {
      if (above[k] < 0) continue;
      past[k] = smooth(dot(minus(c, at(centers, joint[k])), way[joint[k]]), -radius, radius);
      out[above[k]] *= 1 - past[k];
    }
  }
  return out.map((before, k) => past[k] * before);
}

/** The unit direction of the limb at each joint: between the way to it and the ways on; zero where there is neither. */
function ways(centers, parents) {
  const on = parents.map(() => [0, 0, 0]), into = parents.map((p, j) => (p >= 0 ? unit(minus(at(centers, j), at(centers, p))) : [0, 0, 0]));
  parents.forEach((p, j) => { if (p >= 0) on[p] = plus(on[p], into[j]); });
  return parents.map((p, j) => {
    const further = Math.hypot(...on[j]) > 1e-9 ? unit(on[j]) : null;
    const out = p >= 0 ? plus(into[j], further ?? into[j]) : on[j];
    return Math.hypot(...out) > 1e-9 ? unit(out) : [0, 0, 0];
  });
}

/** (n) for each influence the one of the same vertex by the nearest joint up the tree, -1 for none. */
function aboves({ V, J, row, joint, parents }) {
  const out = new Int32Array(joint.length).fill(-1), place = new Int32Array(J + 1).fill(-1);
  for (let v = 0; v < V; v++) {
    if (row[v + 1] - row[v] < 2) continue;
    for (let k = row[v]; k < row[v + 1]; k++) place[joint[k]] = k;
    for (let k = row[v]; k < row[v + 1]; k++) for (let up = joint[k] < J ? parents[joint[k]] : -1; up >= 0 && out[k] < 0; up = parents[up]) out[k] = place[up];
    for (let k = row[v]; k < row[v + 1]; k++) place[joint[k]] = -1;
  }
  return out;
}

/** (V) how much of this each vertex gets, the rest of "log": all where sections are clear. */
function shares(skin) {
  const { V, J, row, joint, weight, centers, parents } = skin, straight = straightness(centers, parents), above = aboves(skin), out = new Float64Array(V);
  for (let v = 0; v < V; v++) {
    let total = 0;
    out[v] = 1;
    for (let k = row[v]; k < row[v + 1]; k++) total += weight[k];
    for (let k = row[v]; k < row[v + 1]; k++) if (above[k] >= 0 && joint[k] < J) {
      const w = weight[k] / total;
      out[v] *= 1 - Math.min(1, Math.max(0, EDGE * w * (1 - w))) * (1 - straight[joint[k]]);
    }
  }
  return Float32Array.from(averaged(skin, out, 1, BLUR), (s) => Math.min(1, Math.max(0, s)));
}

/** (J) how clear the sections round a joint are: 1 where the limb goes straight on at rest or off square. */
function straightness(centers, parents) {
  const into = parents.map((p, j) => (p >= 0 ? unit(minus(at(centers, j), at(centers, p))) : [0, 0, 0])), most = parents.map(() => -Infinity);
  parents.forEach((p, j) => { if (p >= 0) most[p] = Math.max(most[p], dot(into[j], into[p])); });
  return parents.map((p, j) => (p >= 0 && most[j] > -Infinity ? Math.max(smooth(most[j], ...STRAIGHT), 1 - smooth(most[j], ...SQUARE)) : 1));
}

function smooth(x, low, high) {
  const t = Math.min(1, Math.max(0, (x - low) / (high - low)));
  return t * t * (3 - 2 * t);
}

/** (V*3) the centre of each vertex's section at rest: its mean foot on the bones of its joints, smoothed. */
function centers(skin) {
  const { V, row, joint, weight, rest, parents } = skin, below = parents.map(() => []), out = new Float64Array(3 * V);
  parents.forEach((p, j) => { if (p >= 0) below[p].push(j); });
  const middle = middles(skin);
  for (let v = 0; v < V; v++) {
    let total = 0;
    for (let k = row[v]; k < row[v + 1]; k++) total += weight[k];
    const p = rest.subarray(3 * v, 3 * v + 3);
    for (let k = row[v]; k < row[v + 1]; k++) {
      const foot = joint[k] < skin.J ? footOf(skin, below, middle, joint[k], p) : p;
      for (let c = 0; c < 3; c++) out[3 * v + c] += (weight[k] / total) * foot[c];
    }
  }
  return averaged(skin, out, 3, SMOOTH);
}

/** Sums and counts (J*4) of the vertices of joints without a parent: those without bones too go on towards their mean. */
function middles({ V, row, joint, rest, parents, J }) {
  const sum = new Float64Array(4 * J);
  for (let v = 0; v < V; v++) for (let k = row[v]; k < row[v + 1]; k++) {
    const j = joint[k];
    if (j >= J || parents[j] >= 0) continue;
    for (let c = 0; c < 3; c++) sum[4 * j + c] += rest[3 * v + c];
    sum[4 * j + 3]++;
  }
  return sum;
}

/** The point nearest to p on the bones that begin at joint j. */
function footOf({ centers, parents }, below, middle, j, p) {
  const start = at(centers, j), on = (bone, share) => [start[0] + share * bone[0], start[1] + share * bone[1], start[2] + share * bone[2]];
  const along = (bone, size) => ((p[0] - start[0]) * bone[0] + (p[1] - start[1]) * bone[1] + (p[2] - start[2]) * bone[2]) / size;
  let best = null, nearest = Infinity;
  for (const child of below[j]) {
    const bone = minus(at(centers, child), start), size = dot(bone, bone);
    if (size < 1e-12) continue;
    const share = along(bone, size), clipped = Math.min(1, Math.max(0, share));
    const foot = on(bone, below[j].length === 1 ? share : clipped); // beyond a joint the bone's line goes on
    const d = Math.hypot(p[0] - foot[0], p[1] - foot[1], p[2] - foot[2]);
    if (d < nearest) { nearest = d; best = foot; }
  }
  if (best) return best;
  const bone = parents[j] >= 0 ? minus(start, at(centers, parents[j])) : [0, 1, 2].map((c) => middle[4 * j + c] / (middle[4 * j + 3] || 1) - start[c]);
  const size = dot(bone, bone);
  return size > 1e-12 ? on(bone, along(bone, size)) : start;
}

/** Each value (V*size) with the mean of its neighbours on the surface, some times over; what lies at one place is one. */
function averaged(skin, values, size, rounds) {
  const { V, triangles } = skin;
  if (!triangles.length) return values;
  const { same, near } = once(skin, "neighbours", () => neighbours(skin)), shared = new Uint32Array(V);
  let now = new Float64Array(size * V);
  for (let v = 0; v < V; v++) { shared[same[v]]++; for (let c = 0; c < size; c++) now[size * same[v] + c] += values[size * v + c]; }
  for (let v = 0; v < V; v++) for (let c = 0; c < size; c++) now[size * v + c] /= shared[v] || 1;
  for (let n = 0; n < rounds; n++) {
    const next = now.slice();
    for (let v = 0; v < V; v++) if (near[v].length) for (let c = 0; c < size; c++) {
      let sum = 0;
      for (const u of near[v]) sum += now[size * u + c];
      next[size * v + c] = (now[size * v + c] + sum / near[v].length) / 2;
    }
    now = next;
  }
  const out = new Float64Array(size * V);
  for (let v = 0; v < V; v++) for (let c = 0; c < size; c++) out[size * v + c] = now[size * same[v] + c];
  return out;
}

/** The first vertex at the place of each, and for those the ones that share an edge with them. */
function neighbours({ V, rest, triangles }) {
  const same = welded(rest, 0), links = Array.from({ length: V }, () => new Set());
  for (let k = 0; k < triangles.length; k += 3) for (const [a, b] of [[0, 1], [1, 2], [2, 0]]) {
    const x = same[triangles[k + a]], y = same[triangles[k + b]];
    links[x].add(y);
    links[y].add(x);
  }
  return { same, near: links.map((s) => Uint32Array.from(s)) };
}

const at = (points, i) => [points[3 * i], points[3 * i + 1], points[3 * i + 2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const plus = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const unit = (a) => { const s = Math.max(Math.hypot(...a), 1e-12); return [a[0] / s, a[1] / s, a[2] / s]; };
