// All deformers of the page by name: those of deform.js, and those that are made of them. The same formulas as
// vitruvian.deform; no drawing library here, so that node can run it beside the kernels.
//
// "hybrid" is linear where joints turn little and log elsewhere. "volume" has log's rotations and keeps every
// cross-section centred on its bent bone (volume.js). "contours" and "hand" run what Python has laid out (contours.js,
// hands.js).
// Unlike a live server's, twists do not remember the frame before: beyond 180 degrees they go the short way.

import { BLENDS, blend, deform, displaceAfter, displaceBefore, once, rigid, setPose } from "./deform.js";
import { contoured } from "./contours.js";
import { handed } from "./hands.js";
import { volume } from "./volume.js";

export const DEFORMERS = ["linear", "dual-quaternion", "log", "volume", "hand", "contours", "hybrid", "log-pair", "log-absolute"];
const TOLERANCE = 0.0005; // metres that linear blending may be wrong by in "hybrid"
const FLOOR = 1e-3; // metres: the least radius that an angle is derived from

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
    contoured(skin, rest, positions, normals);
    displaceAfter(skin, weights, positions);
  } else if (name === "hand") {
    setPose(skin, pose);
    rigid(skin);
    const rest = displaceBefore(skin, weights);
    blend(skin, rest, positions, normals, "log");
    handed(skin, positions, rest);
    displaceAfter(skin, weights, positions);
  } else deform(BLENDS.includes(name) ? name : "log", skin, pose, weights, positions, normals);
}

function hybrid(skin, pose, weights, positions, normals) {
  const other = once(skin, "other", () => new Float32Array(3 * skin.V)), otherN = once(skin, "otherN", () => new Float32Array(3 * skin.V));
  deform("linear", skin, pose, weights, positions, normals);
  deform("log", skin, pose, weights, other, otherN);
  const { limit, pairs, sets, group: all } = once(skin.whole ?? skin, "pairs", () => pairsOf(skin.whole ?? skin)), { dq } = skin;
  const group = skin.whole ? once(skin, "group", () => Uint32Array.from(skin.vertices, (v) => all[v])) : all;
  const share = limit.map((most, i) => {
    const a = 8 * pairs[i][0], b = 8 * pairs[i][1];
    if (most >= Math.PI || most <= 0) return most <= 0 ? 1 : 0;
    // The short way: two joints of a vertex are only more than half a turn apart where another pair of it is bent enough.
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
