// Bodies organised in contours: each contour moves as one piece, by shares of its joints' rotations. Skin between them
// follows its weights, and sees joints turned as the contours that it is sewn to have taken their twist.
// The same as the contour program of vitruvian.deform, which Python lays out; names of arrays are those of its fields.

import { blend, linear, once, rigid, subset } from "./deform.js";

const LIMIT = 1.5; // how much a mitre may widen
const ROUND = 0.3; // of "log" in what skins vertices outside the contours, the rest is "linear"
const FIELDS = ["link", "axis", "bone", "base", "row", "step", "swing", "twist", "middle", "along", "frame", "diversion", "mitre", "mitre_link", "mitre_share", "bulge", "bulge_link", "recentre", "limb", "way", "aside", "seam"];

/** The program out of a mesh message's blocks, or null. `owner` (V): one more than the contour of a vertex, 0: none.
 * `seen`: another program, whose contours are how vertices outside see the joints `seen.joint` turned; or null. */
export function contourProgram(get) {
  const laid = (title) => get(`${title}_base`) && Object.fromEntries([...FIELDS.map((name) => [name, get(`${title}_${name}`)]), ["motion", new Float64Array(12 * get(`${title}_base`).length)]]);
  const out = laid("contour"), seen = out && laid("seen");
  return out ? { ...out, owner: get("contour_owner"), seen: seen ? { ...seen, joint: get("seen_joint") } : null } : null;
}

/** The same program for some vertices. */
export const contoursOf = (program, vertices) => ({ ...program, owner: Uint32Array.from(vertices, (v) => program.owner[v]) });

/** Vertices in `positions` and `normals` from `rest`; after `rigid`. */
export function contoured(skin, rest, positions, normals) {
  const { contours: p, V } = skin, R = rigidParts(skin), from = skin.stretched ? stretchedRest(skin, rest) : rest;
  motions(p, R, skin.centers);
  sewn(skin, R, from, positions, normals);
  for (let v = 0, i = 0; v < V; v++, i += 3) {
    if (!p.owner[v]) continue;
    const m = 12 * (p.owner[v] - 1), M = p.motion, x = from[i], y = from[i + 1], z = from[i + 2];
    const nx = skin.normals[i], ny = skin.normals[i + 1], nz = skin.normals[i + 2];
    for (let r = 0; r < 3; r++) {
      const a = m + 4 * r;
      positions[i + r] = M[a] * x + M[a + 1] * y + M[a + 2] * z + M[a + 3];
      normals[i + r] = M[a] * nx + M[a + 1] * ny + M[a + 2] * nz;
    }
    unit(normals, i);
  }
}

/** Vertices that no contour moves, by their weights: `ROUND` of "log" over "linear", of rigid joints R (J*12) as seen. */
function sewn(skin, R, from, positions, normals) {
  const p = skin.contours, part = once(skin, "sewn", () => loose(skin)), { vertices, V } = part;
  part.M.set(R);
  if (p.seen) {
    motions(p.seen, R, skin.centers);
    p.seen.joint.forEach((j, i) => part.M.set(p.seen.motion.subarray(12 * i, 12 * i + 12), 12 * j));
  }
  rigid(part);
  const { at, one, oneN, two, twoN } = part.room;
  vertices.forEach((v, i) => { for (let c = 0; c < 3; c++) at[3 * i + c] = from[3 * v + c]; });
  linear(part, at, one, oneN);
  blend(part, at, two, twoN, "log");
  for (let k = 0; k < V; k++) {
    const i = 3 * vertices[k];
    for (let c = 0; c < 3; c++) {
      positions[i + c] = one[3 * k + c] + ROUND * (two[3 * k + c] - one[3 * k + c]);
      normals[i + c] = oneN[3 * k + c] + ROUND * (twoN[3 * k + c] - oneN[3 * k + c]);
    }
    unit(normals, i);
  }
}

/** The part of a skin outside its contours, with weights that sum to one, and room to move it. */
function loose(skin) {
  const vertices = [...skin.contours.owner.keys()].filter((v) => !skin.contours.owner[v]), part = subset(skin, vertices);
  for (let v = 0; v < part.V; v++) {
    const s = 1 / (1 - part.over[v]);
    for (let k = part.row[v]; k < part.row[v + 1]; k++) part.weight[k] *= s;
    part.over[v] = 0;
  }
  const room = Object.fromEntries(["at", "one", "oneN", "two", "twoN"].map((name) => [name, new Float32Array(3 * part.V)]));
  const own = (name) => new Float32Array(skin[name].length);
  return { ...part, vertices, room, M: own("M"), dq: own("dq"), stretch: own("stretch") };
}

function unit(a, i) {
  const s = 1 / (Math.hypot(a[i], a[i + 1], a[i + 2]) || 1);
  for (let c = i; c < i + 3; c++) a[c] *= s;
}

/** Rows of 12 of the rigid part of each joint's motion, out of the dual quaternions that `rigid` made. */
export function rigidParts({ dq, J, M, stretched }) {
  if (!stretched) return M;
  const out = new Float64Array(12 * (J + 1));
  for (let j = 0; j <= J; j++) {
    const [w, x, y, z, ew, ex, ey, ez] = dq.subarray(8 * j, 8 * j + 8);
    const t = [2 * (w * ex - ew * x + y * ez - z * ey), 2 * (w * ey - ew * y + z * ex - x * ez), 2 * (w * ez - ew * z + x * ey - y * ex)];
    const R = matrix([x, y, z, w]);
    for (let r = 0; r < 3; r++) out.set([R[3 * r], R[3 * r + 1], R[3 * r + 2], t[r]], 12 * j + 4 * r);
  }
  return out;
}

function stretchedRest(skin, rest) {
  const out = new Float32Array(rest.length);
  linear({ ...skin, M: skin.stretch }, rest, out, new Float32Array(rest.length));
  return out;
}

/** Writes `motion` (C*12) of a program for rigid joint matrices R (J*12). */
function motions(p, R, centers) {
  const links = p.link.length / 2, state = new Array(links);
  for (let l = 0; l < links; l++) state[l] = linkState(p, R, centers, l);
  const A = new Float64Array(12), identity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];
  for (let c = 0; c < p.base.length; c++) {
    if (p.base[c]) A.set(R.subarray(12 * (p.base[c] - 1), 12 * p.base[c]));
    else A.set(identity);
    for (let k = p.row[c]; k < p.row[c + 1]; k++) {
      const l = p.step[k], { whole, split, angle, axis, offset, center } = state[l], share = p.swing[k], twist = p.twist[k];
      const q = Number.isNaN(twist) ? turn(whole, share) : times(turn(split, share), turn(axis, angle * twist));
      const local = matrix(q), t = [0, 0, 0];
      for (let r = 0; r < 3; r++) t[r] = center[r] + share * offset[r] - (local[3 * r] * center[0] + local[3 * r + 1] * center[1] + local[3 * r + 2] * center[2]);
      append(A, local, t);
    }
    const m = p.middle.subarray(3 * c, 3 * c + 3), here = put(A, 0, m), before = put(R, 12 * p.frame[c], m);
    const aside = before.map((x, r) => p.diversion[c] * (x - here[r])), more = p.recentre[c] ? recentred(p, c, R, A, here.map((x, r) => x + aside[r])) : [0, 0, 0];
    const bend = (l) => Math.hypot(...state[l].split), lean = p.mitre_link[c], own = state[lean];
    const bone = p.bone.subarray(3 * lean, 3 * lean + 3), u = cross(own.split, bone), size = Math.hypot(...u);
    const stretch = p.mitre[c] * (Math.min(1 / Math.cos(Math.min(p.mitre_share[c] * bend(lean), 1.5)), LIMIT) - 1);
    const widen = 1 + (p.bulge[c] * (1 - Math.cos(bend(p.bulge_link[c])))) / 2, along = p.along.subarray(3 * c, 3 * c + 3), shape = new Float64Array(9);
    for (let r = 0; r < 3; r++) for (let s = 0; s < 3; s++) {
      const uu = size > 1e-12 ? (u[r] * u[s]) / (size * size) : 0, eye = r === s ? 1 : 0;
      shape[3 * r + s] = widen * (eye + stretch * uu) + (1 - widen) * along[r] * along[s];
    }
    append(A, shape, [0, 0, 0]);
    const now = put(A, 0, m);
    for (let r = 0; r < 3; r++) A[4 * r + 3] += here[r] - now[r] + aside[r] + more[r];
    p.motion.set(A, 12 * c);
  }
}

/** How far the centre of contour c, now `here`, goes so that the contour, which A turns, turns about its place on the bone and stands off from it as far as at rest. */
function recentred(p, c, R, A, here) {
  const of = (name) => p[name].subarray(3 * c, 3 * c + 3), rest = of("middle"), d = of("way"), e = of("aside"), b = 12 * (p.limb[c] - 1);
  const l = 3 * p.mitre_link[c], n = p.bone.subarray(l, l + 3), get = (r, k) => (b < 0 ? (r === k ? 1 : 0) : R[b + 4 * r + k]);
  const back = (v) => [0, 1, 2].map((i) => get(0, i) * v[0] + get(1, i) * v[1] + get(2, i) * v[2]);
  const turn = (v) => back([0, 4, 8].map((r) => A[r] * v[0] + A[r + 1] * v[1] + A[r + 2] * v[2]));
  const gone = back(here.map((x, r) => x - (b < 0 ? 0 : R[b + 4 * r + 3]))).map((x, i) => x - rest[i]), carried = turn(e), s = dot(carried, d);
  const across = carried.map((x, i) => x - s * d[i]), size = dot(across, across), scale = size > 1e-24 ? Math.sqrt(dot(e, e) / size) : 1;
  const offset = across.map((x) => scale * x), normal = turn(n), lag = turn(d).map((x, i) => p.seam[c] * (x - d[i]));
  const slide = (dot(offset, normal) - dot(e, n) - dot(lag, normal)) / Math.max(dot(d, normal), 0.2);
  const v = offset.map((x, i) => p.recentre[c] * (x - e[i] - slide * d[i] - gone[i]));
  return [0, 1, 2].map((r) => get(r, 0) * v[0] + get(r, 1) * v[1] + get(r, 2) * v[2]);
}

/** How the two joints of a link are turned against each other. */
function linkState(p, R, centers, l) {
  const far = 12 * p.link[2 * l + 1], near = p.link[2 * l] ? 12 * (p.link[2 * l] - 1) : -1, center = centers.subarray(far / 4, far / 4 + 3);
  const get = (m, r, c) => (m < 0 ? (r === c ? 1 : 0) : R[m + 4 * r + c]), relative = new Float64Array(9);
  for (let r = 0; r < 3; r++) for (let c = 0; c < 3; c++) for (let k = 0; k < 3; k++) relative[3 * r + c] += get(near, k, r) * get(far, k, c);
  const q = quaternionOf(relative), axis = p.axis.subarray(3 * l, 3 * l + 3), on = q[0] * axis[0] + q[1] * axis[1] + q[2] * axis[2];
  const size = Math.hypot(on, q[3]), about = size < 1e-12 ? [0, 0, 0, 1] : [(on * axis[0]) / size, (on * axis[1]) / size, (on * axis[2]) / size, q[3] / size];
  const split = vector(times(q, [-about[0], -about[1], -about[2], about[3]])), moved = put(R, far, center).map((x, r) => x - get(near, r, 3));
  const offset = [0, 1, 2].map((r) => get(near, 0, r) * moved[0] + get(near, 1, r) * moved[1] + get(near, 2, r) * moved[2] - center[r]);
  return { whole: vector(q), split, angle: size < 1e-12 ? 0 : 2 * Math.atan2(on, q[3]), axis, offset, center };
}

// Quaternions here are xyzw.

/** Unit quaternion, w >= 0, of a rotation (9). */
export function quaternionOf(R) {
  const t = R[0] + R[4] + R[8];
  let q;
  if (t >= Math.max(R[0], R[4], R[8])) q = [R[7] - R[5], R[2] - R[6], R[3] - R[1], 1 + t];
  else if (R[0] >= R[4] && R[0] >= R[8]) q = [1 + 2 * R[0] - t, R[1] + R[3], R[2] + R[6], R[7] - R[5]];
  else if (R[4] >= R[8]) q = [R[1] + R[3], 1 + 2 * R[4] - t, R[5] + R[7], R[2] - R[6]];
  else q = [R[2] + R[6], R[5] + R[7], 1 + 2 * R[8] - t, R[3] - R[1]];
  const s = (q[3] < 0 ? -1 : 1) / Math.hypot(...q);
  return q.map((x) => x * s);
}

const times = (a, b) => [
  a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1], a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
  a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3], a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
];

function vector(q) {
  const length = Math.hypot(q[0], q[1], q[2]), s = length < 1e-12 ? 2 : (2 * Math.atan2(length, q[3])) / length;
  return [q[0] * s, q[1] * s, q[2] * s];
}

/** The quaternion of `share` times a rotation vector. */
function turn(v, share) {
  const x = v[0] * share, y = v[1] * share, z = v[2] * share, angle = Math.sqrt(x * x + y * y + z * z), s = angle < 1e-9 ? 0.5 : Math.sin(angle / 2) / angle;
  return [x * s, y * s, z * s, Math.cos(angle / 2)];
}

function matrix([x, y, z, w]) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
    2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
  ];
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const put = (A, m, p) => [0, 4, 8].map((r) => A[m + r] * p[0] + A[m + r + 1] * p[1] + A[m + r + 2] * p[2] + A[m + r + 3]);

/** A <- A [B t]. */
function append(A, B, t) {
  for (let r = 0; r < 12; r += 4) {
    const a = A[r], b = A[r + 1], c = A[r + 2];
    A[r + 3] += a * t[0] + b * t[1] + c * t[2];
    for (let k = 0; k < 3; k++) A[r + k] = a * B[k] + b * B[3 + k] + c * B[6 + k];
  }
}
