// Posing on top of a frame: extra rotations of joints, their angles against the limits, and undo.
// Quaternions here are xyzw as everywhere on the Python side.

import { apply3, multiply3, quaternion, transpose3 } from "./deform.js";

/** 9 row-major numbers of the rotation nearest to the 3x3 of joint `j` in `pose`, by two Gram-Schmidt steps. */
export function rotationOf(pose, j) {
  if (j < 0) return [1, 0, 0, 0, 1, 0, 0, 0, 1];
  const m = 12 * j, x = [pose[m], pose[m + 4], pose[m + 8]], y = [pose[m + 1], pose[m + 5], pose[m + 9]];
  const unit = (v) => { const s = 1 / (Math.hypot(...v) || 1); return v.map((a) => a * s); };
  const a = unit(x), d = a[0] * y[0] + a[1] * y[1] + a[2] * y[2];
  const b = unit(y.map((v, i) => v - d * a[i]));
  const c = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  return [a[0], b[0], c[0], a[1], b[1], c[1], a[2], b[2], c[2]];
}

/** Local rotation (9) of joint j: its own turn against its parent. */
export const localRotation = (pose, parents, j) => multiply3(transpose3(rotationOf(pose, parents[j])), rotationOf(pose, j));

/** Angles x, y, z (radians) with R = Rx Ry Rz, y within +-90 degrees. */
export function angles(R) {
  const y = Math.asin(Math.min(1, Math.max(-1, R[2])));
  if (Math.abs(R[2]) > 0.99999) return [Math.atan2(R[3], R[4]) * Math.sign(R[2]) || 0, y, 0];
  return [Math.atan2(-R[5], R[8]), y, Math.atan2(-R[1], R[0])];
}

/** The rotation (9) of angles x, y, z: Rx Ry Rz. */
export function fromAngles([x, y, z]) {
  const [a, b, c, d, e, f] = [Math.cos(x), Math.sin(x), Math.cos(y), Math.sin(y), Math.cos(z), Math.sin(z)];
  return [c * e, -c * f, d, a * f + b * d * e, a * e - b * d * f, -b * c, b * f - a * d * e, b * e + a * d * f, a * c];
}

/** Rotation (9) of a quaternion xyzw. */
export function fromQuaternion([x, y, z, w]) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
    2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
  ];
}

/** Quaternion xyzw of a rotation (9). */
export function toQuaternion(R) {
  const [w, x, y, z] = quaternion(R);
  return [x, y, z, w];
}

/**
 * pose (J*12) with extra rotations `turns` (Map joint -> 9), each in its joint's parent frame, about its posed centre:
 * M'_j = D_j M_j, D_j = D_parent rot(x_j). Written into `out`. The same as `turn` events of a Stage.
 */
export function turned(pose, turns, parents, centers, out) {
  out.set(pose);
  if (!turns.size) return out;
  const change = new Array(parents.length);
  for (let j = 0; j < parents.length; j++) {
    let d = parents[j] >= 0 ? change[parents[j]] : undefined;
    const E = turns.get(j);
    if (E) {
      const F = rotationOf(pose, parents[j]), W = multiply3(multiply3(F, E), transpose3(F));
      const x = center(pose, centers, j), rx = apply3(W, x);
      const own = { R: W, t: x.map((v, i) => v - rx[i]) };
      d = d ? { R: multiply3(d.R, own.R), t: apply3(d.R, own.t).map((v, i) => v + d.t[i]) } : own;
    }
    if (!d) continue;
    change[j] = d;
    const m = 12 * j;
    for (let c = 0; c < 4; c++) {
      const col = apply3(d.R, [pose[m + c], pose[m + 4 + c], pose[m + 8 + c]]);
      for (let r = 0; r < 3; r++) out[m + 4 * r + c] = col[r] + (c === 3 ? d.t[r] : 0);
    }
  }
  return out;
}

/** Move the first joint of `pose`, and all that hangs on it. */
export function shifted(pose, by, parents) {
  const first = parents.map(() => false);
  parents.forEach((p, j) => {
    first[j] = j === 0 || (p >= 0 && first[p]);
    if (first[j]) for (let r = 0; r < 3; r++) pose[12 * j + 4 * r + 3] += by[r];
  });
}

/** Where joint j's centre is in `pose`. */
export function center(pose, centers, j) {
  const m = 12 * j, x = centers[3 * j], y = centers[3 * j + 1], z = centers[3 * j + 2];
  return [0, 4, 8].map((r) => pose[m + r] * x + pose[m + r + 1] * y + pose[m + r + 2] * z + pose[m + r + 3]);
}

/** Steps that can be taken back. A step is {undo(), redo(), key}: steps of one gesture share a key and become one. */
export class History {
  constructor(changed) { this.done = []; this.undone = []; this.changed = changed; }

  push(step) {
    const last = this.done.at(-1);
    if (step.key && last?.key === step.key) last.redo = step.redo;
    else this.done.push(step);
    this.undone.length = 0;
    this.changed();
  }

  /** What follows is a new gesture. */
  settle() { const last = this.done.at(-1); if (last) last.key = null; }

  undo() { const s = this.done.pop(); if (s) { s.undo(); this.undone.push(s); this.changed(); } }
  redo() { const s = this.undone.pop(); if (s) { s.redo(); s.key = null; this.done.push(s); this.changed(); } }
}
