// A surface to work on: where a ray meets it, what is near on it, and a mirror plane. No drawing library here.

import { welded } from "./mesh.js";

const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const at = (p, i) => [p[3 * i], p[3 * i + 1], p[3 * i + 2]];
const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);

/** Places (points at the same place are one) and which of them edges join; ways over it from any point of it. */
export class Surface {
  /** points (V*3) at rest, faces (T*3). */
  constructor(points, faces) {
    const V = points.length / 3, same = welded(points, 0), pairs = new Set();
    Object.assign(this, { points, same });
    for (let k = 0; k < faces.length; k += 3) for (const [a, b] of [[0, 1], [1, 2], [2, 0]]) {
      const i = same[faces[k + a]], j = same[faces[k + b]];
      if (i !== j) pairs.add(Math.min(i, j) * V + Math.max(i, j));
    }
    const next = (this.next = Array.from({ length: V }, () => []));
    for (const id of pairs) { const i = Math.floor(id / V), j = id % V; next[i].push(j); next[j].push(i); }
    this.flat = this.across(faces);
    const copies = (this.copies = new Map());
    same.forEach((s, v) => { if (s !== v) copies.set(s, [...(copies.get(s) ?? [s]), v]); });
  }

  /** Vertices at the place of `s`. */
  at(s) { return this.copies.get(s) ?? [s]; }

  /** [[place, length]] of each place: ways across an edge from corner to corner of the two triangles there, laid flat. */
  across(faces) {
    const { points, same } = this, V = same.length, sides = new Map(), out = Array.from({ length: V }, () => []);
    for (let k = 0; k < faces.length; k += 3) for (const [a, b, c] of [[0, 1, 2], [1, 2, 0], [2, 0, 1]]) {
      const i = same[faces[k + a]], j = same[faces[k + b]], id = Math.min(i, j) * V + Math.max(i, j);
      sides.set(id, [...(sides.get(id) ?? []), same[faces[k + c]]]);
    }
    for (const [id, ends] of sides) {
      if (ends.length !== 2 || ends[0] === ends[1]) continue;
      const a = at(points, Math.floor(id / V)), b = at(points, id % V), length = apart(a, b), d = sub(b, a).map((x) => x / (length || 1));
      const [[u, h], [v, g]] = ends.map((e) => { const w = sub(at(points, e), a), t = dot(w, d); return [t, Math.hypot(...w.map((x, i) => x - t * d[i]))]; });
      const cut = u + ((v - u) * h) / (h + g || 1);
      if (!(h + g > 0) || cut < 0 || cut > length) continue;
      const far = Math.hypot(u - v, h + g);
      out[ends[0]].push([ends[1], far]);
      out[ends[1]].push([ends[0], far]);
    }
    return out;
  }

  /** Map place -> distance over the surface, up to `radius`, from `point` between the vertices `corners`. */
  reach(corners, point, radius) {
    const { points, same, next, flat } = this, far = new Map(), done = new Map(), queue = [];
    const put = (s, d) => {
      if (d > radius || d >= (far.get(s) ?? Infinity)) return;
      far.set(s, d);
      let i = queue.push([d, s]) - 1; // a heap
      while (i > 0 && queue[(i - 1) >> 1][0] > queue[i][0]) { const up = (i - 1) >> 1; [queue[i], queue[up]] = [queue[up], queue[i]]; i = up; }
    };
    const take = () => {
      const first = queue[0], last = queue.pop();
      if (queue.length) {
        queue[0] = last;
        for (let i = 0; ;) {
          let least = i;
          for (const c of [2 * i + 1, 2 * i + 2]) if (c < queue.length && queue[c][0] < queue[least][0]) least = c;
          if (least === i) break;
          [queue[i], queue[least]] = [queue[least], queue[i]];
          i = least;
        }
      }
      return first;
    };
    for (const v of corners) put(same[v], apart(at(points, v), point));
    while (queue.length) {
      const [d, s] = take();
      if (done.has(s)) continue;
      done.set(s, d);
      for (const n of next[s]) if (!done.has(n)) put(n, d + apart(at(points, s), at(points, n)));
      for (const [n, far] of flat[s]) if (!done.has(n)) put(n, d + far);
    }
    return done;
  }
}

/** {point, corners, normal}: the point of triangles (T*3) of points (V*3) that is nearest to `p`, or null. */
export function nearest(points, faces, p) {
  let best = Infinity, found = null;
  for (let k = 0; k < faces.length; k += 3) {
    const a = at(points, faces[k]), b = at(points, faces[k + 1]), c = at(points, faces[k + 2]);
    let box = 0; // squared distance to the triangle's box: most are far away
    for (let i = 0; i < 3; i++) {
      const d = Math.max(0, Math.min(a[i], b[i], c[i]) - p[i], p[i] - Math.max(a[i], b[i], c[i]));
      box += d * d;
    }
    if (box >= best) continue;
    const q = onTriangle(p, a, b, c), d = sub(p, q), size = dot(d, d);
    if (size < best) { best = size; found = { point: q, corners: [faces[k], faces[k + 1], faces[k + 2]], normal: across(a, b, c) }; }
  }
  return found;
}

/** Unit normal of a triangle. */
export function across(a, b, c) {
  const u = sub(b, a), v = sub(c, a), n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
  const s = Math.hypot(...n) || 1;
  return n.map((x) => x / s);
}

/** The point of the triangle a, b, c nearest to p. C. Ericson, "Real-time collision detection" (2005), 5.1.5. */
function onTriangle(p, a, b, c) {
  const ab = sub(b, a), ac = sub(c, a), ap = sub(p, a), mix = (o, d, t) => o.map((x, i) => x + t * d[i]);
  const d1 = dot(ab, ap), d2 = dot(ac, ap);
  if (d1 <= 0 && d2 <= 0) return a;
  const bp = sub(p, b), d3 = dot(ab, bp), d4 = dot(ac, bp);
  if (d3 >= 0 && d4 <= d3) return b;
  const vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return mix(a, ab, d1 / (d1 - d3 || 1));
  const cp = sub(p, c), d5 = dot(ab, cp), d6 = dot(ac, cp);
  if (d6 >= 0 && d5 <= d6) return c;
  const vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return mix(a, ac, d2 / (d2 - d6 || 1));
  const va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) return mix(b, sub(c, b), (d4 - d3) / (d4 - d3 + d5 - d6 || 1));
  const s = 1 / (va + vb + vc || 1);
  return a.map((x, i) => x + ab[i] * vb * s + ac[i] * vc * s);
}

/**
 * {normal, offset} of the plane that takes left points best to right ones, and keeps those of the midline; null when the
 * points do not say it. pairs [[left, right]], middle [point]. With R the reflection it is the least
 * sum |r - R l|^2 + sum |m - R m|^2: the normal is the eigenvector of the smallest eigenvalue of
 * 4 sum (m - mean)(m - mean)^T - sum (r - l)(r - l)^T over all midpoints m.
 */
export function mirrorPlane(pairs, middle) {
  const mids = [...pairs.map(([l, r]) => l.map((x, i) => (x + r[i]) / 2)), ...middle];
  if (!mids.length) return null;
  const mean = [0, 1, 2].map((i) => mids.reduce((s, m) => s + m[i], 0) / mids.length), A = [[0, 0, 0], [0, 0, 0], [0, 0, 0]];
  const add = (d, w) => { for (let i = 0; i < 3; i++) for (let j = 0; j < 3; j++) A[i][j] += w * d[i] * d[j]; };
  for (const m of mids) add(sub(m, mean), 4);
  for (const [l, r] of pairs) add(sub(r, l), -1);
  const { values, vectors } = eigen(A), scale = Math.max(...values.map(Math.abs));
  if (!(scale > 0) || values[1] - values[0] < 0.02 * scale) return null; // two planes are as good
  return { normal: vectors[0], offset: dot(vectors[0], mean) };
}

/** The mirror image of a point. */
export const reflected = (p, { normal, offset }) => { const d = 2 * (dot(p, normal) - offset); return p.map((x, i) => x - d * normal[i]); };

/** Eigenvalues, rising, and unit eigenvectors of a symmetric 3x3 matrix, by Jacobi's rotations. */
function eigen(M) {
  const A = M.map((r) => [...r]), U = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  for (let round = 0; round < 30; round++) for (const [p, q] of [[0, 1], [0, 2], [1, 2]]) {
    if (Math.abs(A[p][q]) < 1e-300) continue;
    const t = 0.5 * Math.atan2(2 * A[p][q], A[q][q] - A[p][p]), c = Math.cos(t), s = Math.sin(t);
    for (let k = 0; k < 3; k++) { const x = A[k][p], y = A[k][q]; A[k][p] = c * x - s * y; A[k][q] = s * x + c * y; }
    for (let k = 0; k < 3; k++) { const x = A[p][k], y = A[q][k]; A[p][k] = c * x - s * y; A[q][k] = s * x + c * y; }
    for (let k = 0; k < 3; k++) { const x = U[k][p], y = U[k][q]; U[k][p] = c * x - s * y; U[k][q] = s * x + c * y; }
  }
  const order = [0, 1, 2].sort((i, j) => A[i][i] - A[j][j]);
  return { values: order.map((i) => A[i][i]), vectors: order.map((i) => [U[0][i], U[1][i], U[2][i]]) };
}
