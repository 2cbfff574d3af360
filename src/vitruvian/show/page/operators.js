// All deformers of the page by name: those of deform.js, and those that are made of them. The same formulas as
// vitruvian.deform; no drawing library here, so that node can run it beside the kernels.
//
// "hybrid" is linear where joints turn little and log elsewhere. "volume" has log's rotations and keeps every
// cross-section centred on its bent bone. "contours" and "hand" run what Python has laid out (contours.js, hands.js).
// Unlike a live server's, twists do not remember the frame before: beyond 180 degrees they go the short way.

import { BLENDS, blend, deform, displaceAfter, displaceBefore, linear, rigid, setPose } from "./deform.js";
import { contoured } from "./contours.js";
import { handed } from "./hands.js";
import { welded } from "./mesh.js";

export const DEFORMERS = ["linear", "dual-quaternion", "log", "volume", "hand", "contours", "hybrid", "log-pair", "log-absolute"];
const TOLERANCE = 0.0005; // metres that linear blending may be wrong by in "hybrid"
const FLOOR = 1e-3; // metres: the least radius that an angle is derived from
const SMOOTH = 8; // rounds in which neighbouring centres of "volume" are averaged

/** Whether a deformer has what it needs of a skin. */
export const able = (name, skin) => (name === "contours" ? Boolean(skin.contours) : name === "hand" ? Boolean(skin.hands) : DEFORMERS.includes(name));

/** As `deform`, by any of `DEFORMERS` that the skin is able to. */
export function run(name, skin, pose, weights, positions, normals) {
  if (name === "hybrid") hybrid(skin, pose, weights, positions, normals);
  else if (name === "volume") volume(skin, pose, weights, positions, normals);
  else if (name === "contours") {
    setPose(skin, pose);
    const rest = displaceBefore(skin, weights);
    rigid(skin);
    blend(skin, rest, positions, normals, "log");
    contoured(skin, rest, positions, normals);
    displaceAfter(skin, weights, positions);
  } else if (name === "hand") {
    setPose(skin, pose);
    rigid(skin);
    blend(skin, displaceBefore(skin, weights), positions, normals, "log");
    handed(skin, positions);
    displaceAfter(skin, weights, positions);
  } else deform(BLENDS.includes(name) ? name : "log", skin, pose, weights, positions, normals);
}

/** Arrays of a skin that are made once, and never twice: `make()` under that name. */
const once = (skin, name, make) => ((skin.made ??= {})[name] ??= make());

/** What `make` works out about a whole skin; of a part of it, what `pick` takes for each vertex. */
function whole(skin, name, make, pick) {
  if (!skin.whole) return once(skin, name, () => make(skin));
  const all = once(skin.whole, name, () => make(skin.whole));
  return once(skin, name, () => Float32Array.from([...skin.vertices].flatMap((v) => [...pick(all, v)])));
}

// Volume ------------------------------------------------------------------------------------------------------------

function volume(skin, pose, weights, positions, normals) {
  deform("log", skin, pose, weights, positions, normals);
  const center = whole(skin, "center", centers, (all, v) => all.subarray(3 * v, 3 * v + 3)), carried = once(skin, "carried", () => sharpened(skin));
  const turned = once(skin, "turned", () => new Float32Array(3 * skin.V)), there = once(skin, "there", () => new Float32Array(3 * skin.V));
  const unused = once(skin, "unused", () => new Float32Array(3 * skin.V));
  blend(skin, center, turned, unused, "log");
  linear({ ...skin, ...carried }, center, there, unused);
  for (let i = 0; i < positions.length; i++) positions[i] += there[i] - turned[i];
}

/** Weights that carry the centres: squares, made to sum to what those of moving joints sum to. */
function sharpened({ V, J, row, joint, weight }) {
  const out = new Float32Array(weight.length);
  for (let v = 0; v < V; v++) {
    let total = 0, plain = 0, squares = 0;
    for (let k = row[v]; k < row[v + 1]; k++) total += weight[k];
    for (let k = row[v]; k < row[v + 1]; k++) if (joint[k] < J) { plain += weight[k] / total; squares += weight[k] ** 2; }
    for (let k = row[v]; k < row[v + 1]; k++) out[k] = joint[k] < J ? (weight[k] ** 2 * plain) / (squares || 1) : weight[k] / total;
  }
  return { weight: out, over: new Float32Array(V) };
}

/** (V*3) the centre of each vertex's section at rest: its mean foot on the bones of its joints, smoothed. */
function centers(skin) {
  const { V, row, joint, weight, rest, parents } = skin, below = parents.map(() => []), out = new Float64Array(3 * V);
  parents.forEach((p, j) => { if (p >= 0) below[p].push(j); });
  const middle = leaves(skin, below);
  for (let v = 0; v < V; v++) {
    let total = 0;
    for (let k = row[v]; k < row[v + 1]; k++) total += weight[k];
    const p = rest.subarray(3 * v, 3 * v + 3);
    for (let k = row[v]; k < row[v + 1]; k++) {
      const foot = joint[k] < skin.J ? footOf(skin, below, middle, joint[k], p) : p;
      for (let c = 0; c < 3; c++) out[3 * v + c] += (weight[k] / total) * foot[c];
    }
  }
  return Float32Array.from(averaged(skin, out));
}

/** For joints whose bones have no length and no parent: the mean of their vertices, towards which they go on. */
function leaves({ V, row, joint, rest, J }, below) {
  const sum = new Float64Array(4 * J);
  for (let v = 0; v < V; v++) for (let k = row[v]; k < row[v + 1]; k++) {
    const j = joint[k];
    if (j >= J || below[j].length) continue;
    for (let c = 0; c < 3; c++) sum[4 * j + c] += rest[3 * v + c];
    sum[4 * j + 3]++;
  }
  return sum;
}

/** The point nearest to p on the bones that begin at joint j. */
function footOf({ centers, parents }, below, middle, j, p) {
  const at = (i) => [centers[3 * i], centers[3 * i + 1], centers[3 * i + 2]], start = at(j);
  const on = (bone, share) => [start[0] + share * bone[0], start[1] + share * bone[1], start[2] + share * bone[2]];
  const along = (bone, size) => ((p[0] - start[0]) * bone[0] + (p[1] - start[1]) * bone[1] + (p[2] - start[2]) * bone[2]) / size;
  let best = null, nearest = Infinity;
  for (const child of below[j]) {
    const end = at(child), bone = [end[0] - start[0], end[1] - start[1], end[2] - start[2]], size = bone[0] ** 2 + bone[1] ** 2 + bone[2] ** 2;
    if (size < 1e-12) continue;
    const share = along(bone, size), clipped = Math.min(1, Math.max(0, share));
    const foot = on(bone, below[j].length === 1 ? share : clipped); // beyond a joint the bone's line goes on
    const d = Math.hypot(p[0] - foot[0], p[1] - foot[1], p[2] - foot[2]);
    if (d < nearest) { nearest = d; best = foot; }
  }
  if (best) return best;
  const bone = [0, 1, 2].map((c) => (parents[j] >= 0 ? start[c] - centers[3 * parents[j] + c] : middle[4 * j + c] / (middle[4 * j + 3] || 1) - start[c]));
  const size = bone[0] ** 2 + bone[1] ** 2 + bone[2] ** 2;
  return size > 1e-12 ? on(bone, along(bone, size)) : start;
}

/** Each value (V*3) with the mean of its neighbours on the surface, some times over; what lies at one place is one. */
function averaged({ V, rest, triangles }, values) {
  if (!triangles.length) return values;
  const same = welded(rest, 0), links = Array.from({ length: V }, () => new Set()), shared = new Uint32Array(V);
  let now = new Float64Array(3 * V);
  for (let v = 0; v < V; v++) { shared[same[v]]++; for (let c = 0; c < 3; c++) now[3 * same[v] + c] += values[3 * v + c]; }
  for (let v = 0; v < V; v++) for (let c = 0; c < 3; c++) now[3 * v + c] /= shared[v] || 1;
  for (let k = 0; k < triangles.length; k += 3) for (const [a, b] of [[0, 1], [1, 2], [2, 0]]) {
    const x = same[triangles[k + a]], y = same[triangles[k + b]];
    links[x].add(y);
    links[y].add(x);
  }
  const near = links.map((s) => Uint32Array.from(s));
  for (let n = 0; n < SMOOTH; n++) {
    const next = now.slice();
    for (let v = 0; v < V; v++) if (near[v].length) for (let c = 0; c < 3; c++) {
      let sum = 0;
      for (const u of near[v]) sum += now[3 * u + c];
      next[3 * v + c] = (now[3 * v + c] + sum / near[v].length) / 2;
    }
    now = next;
  }
  const out = new Float64Array(3 * V);
  for (let v = 0; v < V; v++) for (let c = 0; c < 3; c++) out[3 * v + c] = now[3 * same[v] + c];
  return out;
}

// Hybrid ------------------------------------------------------------------------------------------------------------

function hybrid(skin, pose, weights, positions, normals) {
  const other = once(skin, "other", () => new Float32Array(3 * skin.V)), otherN = once(skin, "otherN", () => new Float32Array(3 * skin.V));
  deform("linear", skin, pose, weights, positions, normals);
  deform("log", skin, pose, weights, other, otherN);
  const { limit, pairs, sets, group: all } = once(skin.whole ?? skin, "pairs", () => pairsOf(skin.whole ?? skin)), { dq } = skin;
  const group = skin.whole ? once(skin, "group", () => Uint32Array.from(skin.vertices, (v) => all[v])) : all;
  const share = limit.map((most, i) => {
    const a = 8 * pairs[i][0], b = 8 * pairs[i][1];
    if (most >= Math.PI || most <= 0) return most <= 0 ? 1 : 0;
    const dot = Math.abs(dq[a] * dq[b] + dq[a + 1] * dq[b + 1] + dq[a + 2] * dq[b + 2] + dq[a + 3] * dq[b + 3]);
    const s = Math.min(1, Math.max(0, (2 * Math.acos(Math.min(dot, 1)) - most / 2) / (most / 2)));
    return s * s * (3 - 2 * s);
  });
  const most = sets.map((list) => list.reduce((m, i) => Math.max(m, share[i]), 0));
  for (let v = 0, i = 0; v < skin.V; v++, i += 3) {
    const s = most[group[v]];
    if (!s) continue;
    let n = 0;
    for (let c = i; c < i + 3; c++) {
      positions[c] += s * (other[c] - positions[c]);
      normals[c] += s * (otherN[c] - normals[c]);
      n += normals[c] ** 2;
    }
    n = 1 / (Math.sqrt(n) || 1);
    for (let c = i; c < i + 3; c++) normals[c] *= n;
  }
}

/** Joint pairs that share vertices, with the angle from which each counts as turned; sets of pairs, one a vertex. */
function pairsOf({ V, J, row, joint, rest, centers, parents }) {
  const pairs = [], numbers = new Map(), sets = [], known = new Map(), group = new Uint32Array(V), radius = [];
  const depth = new Int32Array(J + 1);
  for (let j = 0; j < J; j++) depth[j] = parents[j] >= 0 ? depth[parents[j]] + 1 : 0;
  depth[J] = -1;
  for (let v = 0; v < V; v++) {
    const own = [...joint.subarray(row[v], row[v + 1])].sort((a, b) => a - b), key = own.join();
    if (!known.has(key)) {
      const list = [];
      own.forEach((a, n) => own.slice(n + 1).forEach((b) => {
        const name = a * (J + 1) + b;
        if (!numbers.has(name)) { numbers.set(name, pairs.length); pairs.push([a, b]); radius.push(FLOOR); }
        list.push(numbers.get(name));
      }));
      known.set(key, sets.length);
      sets.push(list);
    }
    group[v] = known.get(key);
    for (const i of sets[group[v]]) {
      const [a, b] = pairs[i], far = depth[a] <= depth[b] ? b : a, near = far === a ? b : a;
      radius[i] = Math.max(radius[i], away(rest, 3 * v, centers, 3 * far, near === J ? 0 : 3 * near));
    }
  }
  return { pairs, sets, group, limit: radius.map((r) => 2 * Math.acos(Math.min(1, Math.max(-1, 1 - TOLERANCE / r)))) };
}

/** Distance of a point from the line through the centre at `far` in the direction from the one at `near`. */
function away(points, p, centers, far, near) {
  const d = [0, 1, 2].map((c) => points[p + c] - centers[far + c]), bone = [0, 1, 2].map((c) => centers[far + c] - centers[near + c]);
  const size = Math.hypot(...bone), axis = size > 0 ? bone.map((x) => x / size) : [0, 1, 0], on = d[0] * axis[0] + d[1] * axis[1] + d[2] * axis[2];
  return Math.hypot(...d.map((x, c) => x - on * axis[c]));
}
