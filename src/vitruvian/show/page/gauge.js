// How good a deformed surface is, in numbers: volume, sections round joints, bulge, folds, seam gap, stretch. The same
// as vitruvian.deform.quality, which says what each number means; all are ratios to rest but folds (a count) and the gap
// (metres). No drawing library here, so that node can run it beside the package.

import { blend, rigid, setPose } from "./deform.js";
import { regionOf, sectionsOf, treeOf } from "./sections.js";
import { welded } from "./mesh.js";

const SAME = 1e-6; // metres: points closer than this at rest are one point of the surface
const TURNED = Math.PI / 180; // joints that turn less are not looked at
export const MOST = 32; // joints that are measured at once
export const FIELDS = ["volume", "area", "thickness", "bulge", "folds", "gap", "stretch"];

export class Gauge {
  /** `skin` as of `bind`. Regions and sections of joints are laid when they are first asked for. */
  constructor(skin) {
    this.skin = skin;
    this.same = welded(skin.rest, SAME);
    this.faces = skin.triangles.map((v) => this.same[v]);
    this.edges = edges(skin.triangles, skin.V);
    this.lengths = this.edges.map(([a, b]) => distance(skin.rest, a, b));
    this.tree = treeOf(skin);
    this.solid = solid(this.faces, skin.V);
    this.full = volume(skin.rest, this.solid);
    this.laid = new Map();
  }

  /** Region, sections and the rest's sizes of joint j; null for roots and where bones have no length. */
  at(j) {
    if (!this.laid.has(j)) this.laid.set(j, this.lay(j));
    return this.laid.get(j);
  }

  lay(j) {
    const { skin, faces } = this, region = regionOf(skin, j, this.tree);
    if (!region) return null;
    const { limb, inside } = region, part = [], own = [], mine = [];
    for (let k = 0; k < faces.length; k += 3) {
      if (limb[faces[k]] && limb[faces[k + 1]] && limb[faces[k + 2]]) part.push(faces[k], faces[k + 1], faces[k + 2]);
      const t = skin.triangles;
      if (inside[t[k]] && inside[t[k + 1]] && inside[t[k + 2]]) { own.push(faces[k], faces[k + 1], faces[k + 2]); mine.push(k / 3); }
    }
    const cut = sectionsOf(skin.rest, part, region), before = cut.at(skin.rest), body = solid(own, skin.V);
    const near = this.edges.flatMap(([a, b], e) => (inside[a] && inside[b] ? [e] : []));
    return { region, cut, mine, body, near, full: volume(skin.rest, body), size: cut.areas(before), wide: cut.diameters(before), away: region.distance(before, null) };
  }

  /** {whole, joints: Map j -> numbers}: points (V*3) in a pose (J*12, with the binding), measured round `joints`. */
  measure(points, pose, joints, flipped = this.flipped(points, pose)) {
    const { rest, V } = this.skin, gaps = new Float64Array(V), stretch = new Float64Array(this.edges.length);
    for (let v = 0; v < V; v++) if (this.same[v] !== v) gaps[v] = Math.max(0, distance(points, v, this.same[v]) - distance(rest, v, this.same[v]));
    this.edges.forEach(([a, b], e) => { stretch[e] = this.lengths[e] > SAME ? distance(points, a, b) / this.lengths[e] : NaN; });
    const found = new Map();
    for (const j of joints) {
      const laid = this.at(j);
      if (!laid) continue;
      let folds = 0, gap = 0;
      for (const t of laid.mine) folds += flipped[t];
      for (let v = 0; v < V; v++) if (laid.region.inside[v] && gaps[v] > gap) gap = gaps[v];
      found.set(j, { volume: volume(points, laid.body) / (laid.full || NaN), ...cuts(laid, points, pose), folds, gap, stretch: most(laid.near, (e) => stretch[e]) });
    }
    const worst = (name, sign) => sign * most([...found.values()], (q) => sign * q[name]);
    return {
      whole: {
        volume: volume(points, this.solid) / (this.full || NaN), area: worst("area", -1), thickness: worst("thickness", -1), bulge: worst("bulge", 1),
        folds: flipped.reduce((n, f) => n + f, 0), gap: gaps.reduce((m, g) => Math.max(m, g), 0), stretch: most(stretch, (x) => x),
      },
      joints: found,
    };
  }

  /** (T) 1 for triangles that face away from where their joints turn them, by "log". */
  flipped(points, pose) { return this.against(points, this.compass(pose)); }

  /** (9V) the mean rotation of each vertex in a pose, by rows. */
  compass(pose) {
    const { skin } = this, { V, rest } = skin, out = new Float32Array(9 * V), unused = (this.unused ??= new Float32Array(3 * V)), column = (this.column ??= new Float32Array(3 * V));
    setPose(skin, pose);
    rigid(skin);
    for (let c = 0; c < 3; c++) {
      const normals = (this.axes ??= [0, 1, 2].map((a) => Float32Array.from({ length: 3 * V }, (_, i) => (i % 3 === a ? 1 : 0))))[c];
      blend({ ...skin, normals }, rest, unused, column, "log");
      for (let v = 0; v < V; v++) for (let r = 0; r < 3; r++) out[9 * v + 3 * r + c] = column[3 * v + r];
    }
    return out;
  }

  against(points, turns) {
    const t = this.skin.triangles, { rest } = this.skin, out = new Uint8Array(t.length / 3), n = [0, 0, 0], m = [0, 0, 0];
    for (let k = 0; k < t.length; k += 3) {
      normal(rest, t, k, n);
      normal(points, t, k, m);
      let dot = 0;
      for (let r = 0; r < 3; r++) for (let c = 0; c < 3; c++) {
        dot += m[r] * n[c] * (turns[9 * t[k] + 3 * r + c] + turns[9 * t[k + 1] + 3 * r + c] + turns[9 * t[k + 2] + 3 * r + c]);
      }
      out[k / 3] = dot < 0 ? 1 : 0;
    }
    return out;
  }
}

/** Joints that a pose (J*12) turns by more than a degree against their parent, most first, at most `MOST`. */
export function turnedJoints(pose, parents) {
  const found = [];
  parents.forEach((p, j) => {
    if (p < 0) return;
    let trace = 0;
    for (let r = 0; r < 3; r++) for (let c = 0; c < 3; c++) trace += pose[12 * j + 4 * r + c] * pose[12 * p + 4 * r + c];
    const angle = Math.acos(Math.min(1, Math.max(-1, (trace - 1) / 2)));
    if (angle > TURNED) found.push([angle, j]);
  });
  return found.sort((a, b) => b[0] - a[0] || a[1] - b[1]).slice(0, MOST).map(([, j]) => j);
}

/** Area, thickness and bulge of the sections of a joint. */
function cuts({ region, cut, size, wide, away }, points, pose) {
  const after = cut.at(points), areas = cut.areas(after), width = cut.diameters(after), now = region.distance(after, pose);
  return {
    area: -most(areas, (a, i) => -a / size[i]),
    thickness: -most(width, (d, i) => -d / wide[i]),
    bulge: most(now, (d, i) => 1 + (d - away[i]) / Math.sqrt(size[cut.section[i]] / Math.PI)),
  };
}

/** The largest of what can be measured, NaN when nothing can. */
function most(list, value) {
  let out = -Infinity;
  for (let i = 0; i < list.length; i++) { const x = value(list[i], i); if (Number.isFinite(x) && x > out) out = x; }
  return out === -Infinity ? NaN : out;
}

function distance(points, a, b) { return Math.hypot(points[3 * a] - points[3 * b], points[3 * a + 1] - points[3 * b + 1], points[3 * a + 2] - points[3 * b + 2]); }

function normal(p, t, k, out) {
  const a = 3 * t[k], b = 3 * t[k + 1], c = 3 * t[k + 2];
  const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2], vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
  out[0] = uy * vz - uz * vy; out[1] = uz * vx - ux * vz; out[2] = ux * vy - uy * vx;
}

/** Different pairs of points that triangles join. */
function edges(triangles, V) {
  const seen = new Set(), out = [];
  for (let k = 0; k < triangles.length; k += 3) for (let e = 0; e < 3; e++) {
    const a = triangles[k + e], b = triangles[k + ((e + 1) % 3)], key = Math.min(a, b) * V + Math.max(a, b);
    if (!seen.has(key)) { seen.add(key); out.push([a, b]); }
  }
  return out;
}

/** Faces (T*3) with what closes them: directed edges without a partner, with how many times each, by boundary loop. */
function solid(faces, V) {
  const net = new Map();
  for (let k = 0; k < faces.length; k += 3) for (let e = 0; e < 3; e++) {
    const a = faces[k + e], b = faces[k + ((e + 1) % 3)], key = Math.min(a, b) * V + Math.max(a, b);
    if (a !== b) net.set(key, (net.get(key) ?? 0) + (a < b ? 1 : -1));
  }
  const open = [], root = new Map(), find = (v) => { while (root.get(v) !== v) { root.set(v, root.get(root.get(v))); v = root.get(v); } return v; };
  for (const [key, n] of net) if (n) {
    const low = Math.floor(key / V), high = key % V, [a, b] = n > 0 ? [low, high] : [high, low];
    for (const v of [a, b]) if (!root.has(v)) root.set(v, v);
    root.set(find(a), find(b));
    open.push([a, b, Math.abs(n)]);
  }
  const numbers = new Map();
  return { faces, open: open.map(([a, b, n]) => { const r = find(a); if (!numbers.has(r)) numbers.set(r, numbers.size); return [a, b, n, numbers.get(r)]; }), loops: numbers.size };
}

/** Signed volume of a solid; each boundary loop is closed by a fan round its mean point. */
function volume(points, { faces, open, loops }) {
  if (!faces.length) return 0;
  const o = [0, 0, 0], p = (v, c) => points[3 * v + c] - o[c];
  for (let k = 0; k < faces.length; k += 3) for (let c = 0; c < 3; c++) o[c] += points[3 * faces[k] + c];
  for (let c = 0; c < 3; c++) o[c] /= faces.length / 3;
  let total = 0;
  for (let k = 0; k < faces.length; k += 3) {
    const a = faces[k], b = faces[k + 1], c = faces[k + 2];
    const bx = p(b, 0), by = p(b, 1), bz = p(b, 2), cx = p(c, 0), cy = p(c, 1), cz = p(c, 2);
    total += p(a, 0) * (by * cz - bz * cy) + p(a, 1) * (bz * cx - bx * cz) + p(a, 2) * (bx * cy - by * cx);
  }
  const middle = new Float64Array(4 * loops);
  for (const [a, , , l] of open) { for (let c = 0; c < 3; c++) middle[4 * l + c] += p(a, c); middle[4 * l + 3]++; }
  for (const [a, b, n, l] of open) {
    const m = [0, 1, 2].map((c) => middle[4 * l + c] / middle[4 * l + 3]), bx = p(b, 0), by = p(b, 1), bz = p(b, 2), ax = p(a, 0), ay = p(a, 1), az = p(a, 2);
    total += n * (m[0] * (by * az - bz * ay) + m[1] * (bz * ax - bx * az) + m[2] * (bx * ay - by * ax)); // against the boundary: that closes it
  }
  return total / 6;
}
