// Closed sections of a surface round its joints, laid at rest and followed as material points through any pose: planes
// from the middle of one bone to the middle of the next, turning from one to the other. As vitruvian.deform.quality.

const STATIONS = 41; // planes round a joint; odd, so that one goes through the joint
const DIAMETERS = 16; // directions in which each section's thickness is taken
const SAME = 1e-6;

const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const scaled = (v, s) => [v[0] * s, v[1] * s, v[2] * s];
const unit = (v) => scaled(v, 1 / (Math.hypot(...v) || 1));

/** Joints in an order that goes down before it goes on: those below j have first[j] <= place < first[j] + size[j]. */
export function treeOf({ parents, V, J, row, joint, weight }) {
  const size = new Uint32Array(J).fill(1), load = new Float64Array(J), first = new Uint32Array(J), free = new Uint32Array(J);
  for (let k = 0; k < row[V]; k++) if (joint[k] < J) load[joint[k]] += weight[k];
  for (let j = J - 1; j >= 0; j--) if (parents[j] >= 0) { size[parents[j]] += size[j]; load[parents[j]] += load[j]; }
  let top = 0;
  parents.forEach((p, j) => {
    first[j] = p >= 0 ? free[p] : top;
    if (p >= 0) free[p] += size[j];
    else top += size[j];
    free[j] = first[j] + 1;
  });
  return { first, size, load };
}

/** The surface round a joint: bones at rest, whose vertices they are; null for a root and bones without a length. */
export function regionOf(skin, j, tree) {
  const { parents, centers, rest, V, J, row, joint, weight } = skin, at = (i) => [...centers.subarray(3 * i, 3 * i + 3)], parent = parents[j];
  if (parent < 0 || !skin.triangles.length) return null;
  const middle = at(j), back = sub(at(parent), middle), size = Math.hypot(...back);
  if (size < SAME) return null;
  const under = (i) => tree.first[i] >= tree.first[j] && tree.first[i] < tree.first[j] + tree.size[j];
  const limb = new Uint8Array(V), below = new Uint8Array(V);
  let any = false;
  for (let v = 0; v < V; v++) {
    let share = 0, own = 0, sum = 0, n = 0;
    for (let k = row[v]; k < row[v + 1]; k++) {
      if (joint[k] >= J) continue;
      n++;
      sum += weight[k];
      if (under(joint[k])) own += weight[k];
      if (under(joint[k]) || joint[k] === parent) share += weight[k];
    }
    limb[v] = n && share > 0.5 * Math.max(sum, 1e-9) ? 1 : 0;
    below[v] = own > 0.5 ? 1 : 0;
    any ||= below[v];
  }
  const point = (v) => sub(rest.subarray(3 * v, 3 * v + 3), middle);
  let end = endOf(skin, tree, j, 0.25 * size);
  if (!end && any) { // the last joint of a chain: on along the parent's bone
    let furthest = -Infinity;
    for (let v = 0; v < V; v++) if (below[v]) furthest = Math.max(furthest, -dot(point(v), back) / size);
    end = [0, 1, 2].map((c) => middle[c] - (back[c] / size) * furthest);
  }
  const way = end ? sub(end, middle) : [0, 0, 0], length = Math.hypot(...way);
  if (length < SAME) return null;
  const line = { joint: middle, back: unit(back), on: unit(way) }, reach = [size / 2, length / 2], inside = new Uint8Array(V), mean = sub(line.on, line.back);
  for (let v = 0; v < V; v++) {
    if (!limb[v]) continue;
    const p = point(v), along = dot(p, mean) >= 0 ? dot(p, line.on) / reach[1] : -dot(p, line.back) / reach[0];
    inside[v] = Math.abs(along) <= 1 + 1e-6 ? 1 : 0;
  }
  return { line, reach, limb, inside, distance: (points, pose) => distances(points, pose ? moved(line, pose, parent, j) : line) };
}

/** Where the bone of a joint ends: in the middle of its branches by how much skin hangs on each, if that is far enough. */
function endOf({ parents, centers }, { load }, j, least) {
  const under = (j) => [...parents.keys()].filter((i) => parents[i] === j), center = (i) => [...centers.subarray(3 * i, 3 * i + 3)];
  const heaviest = (list) => list.reduce((best, i) => (load[i] > load[best] ? i : best), list[0]), away = (p) => Math.hypot(...sub(p, center(j)));
  const far = (at) => {
    for (let below = under(at); away(center(at)) < least && below.length; below = under(at)) at = heaviest(below);
    return center(at);
  };
  const below = under(j), middle = [0, 0, 0], total = below.reduce((sum, i) => sum + load[i] + 1e-9, 0);
  if (!below.length) return null;
  for (const i of below) far(i).forEach((x, c) => { middle[c] += ((load[i] + 1e-9) / total) * x; });
  return away(middle) >= least ? middle : far(heaviest(below));
}

function moved({ joint, back, on }, pose, parent, j) {
  const turn = (i, v) => [0, 4, 8].map((r) => dot([pose[12 * i + r], pose[12 * i + r + 1], pose[12 * i + r + 2]], v));
  return { joint: turn(j, joint).map((x, r) => x + pose[12 * j + 4 * r + 3]), back: unit(turn(parent, back)), on: unit(turn(j, on)) };
}

/** Of each point to the nearer of two half lines. */
function distances(points, { joint, back, on }) {
  const out = new Float64Array(points.length / 3);
  for (let i = 0; i < out.length; i++) {
    const p = [points[3 * i] - joint[0], points[3 * i + 1] - joint[1], points[3 * i + 2] - joint[2]];
    const from = (u) => { const s = Math.max(0, dot(p, u)); return Math.hypot(p[0] - s * u[0], p[1] - s * u[1], p[2] - s * u[2]); };
    out[i] = Math.min(from(back), from(on));
  }
  return out;
}

/** The closed sections round a joint of `faces` (welded vertices of `rest`). */
export function sectionsOf(rest, faces, { line, reach }) {
  const first = [], second = [], share = [], section = [], start = [], stop = [], owner = [], near = [], far = [];
  let count = 0;
  for (let n = 0; n < STATIONS; n++) {
    const s = (2 * n) / (STATIONS - 1) - 1, t = (s + 1) / 2, h = t * t * (3 - 2 * t);
    let normal = [0, 1, 2].map((c) => (h - 1) * line.back[c] + h * line.on[c]);
    if (Math.hypot(...normal) < 1e-6) continue;
    normal = unit(normal);
    const center = [0, 1, 2].map((c) => line.joint[c] + (s >= 0 ? s * reach[1] * line.on[c] : -s * reach[0] * line.back[c]));
    const found = slice(rest, faces, center, normal);
    if (!found) continue;
    const from = first.length;
    for (const [a, b, w] of found.nodes) { first.push(a); second.push(b); share.push(w); section.push(count); }
    for (const [a, b] of found.segments) { start.push(from + a); stop.push(from + b); owner.push(count); }
    for (const [a, b] of opposite(found.nodes.map((node) => found.place(node)), normal)) { near.push(from + a); far.push(from + b); }
    count++;
  }
  return { first, second, share, section, start, stop, owner, near, far, count, at, areas, diameters };
}

/** (N*3) where the points of sections are. */
function at(points) {
  const out = new Float64Array(3 * this.first.length);
  this.first.forEach((a, i) => { const b = this.second[i], t = this.share[i]; for (let c = 0; c < 3; c++) out[3 * i + c] = (1 - t) * points[3 * a + c] + t * points[3 * b + c]; });
  return out;
}

/** (count) lengths of the vector areas of sections with points (N*3). */
function areas(points) {
  const middle = new Float64Array(4 * this.count), sum = new Float64Array(3 * this.count);
  this.section.forEach((s, i) => { for (let c = 0; c < 3; c++) middle[4 * s + c] += points[3 * i + c]; middle[4 * s + 3]++; });
  this.start.forEach((i, e) => {
    const s = this.owner[e], k = this.stop[e], m = [0, 1, 2].map((c) => middle[4 * s + c] / middle[4 * s + 3]);
    const v = cross([points[3 * i] - m[0], points[3 * i + 1] - m[1], points[3 * i + 2] - m[2]], [points[3 * k] - m[0], points[3 * k + 1] - m[1], points[3 * k + 2] - m[2]]);
    for (let c = 0; c < 3; c++) sum[3 * s + c] += v[c] / 2;
  });
  return Float64Array.from({ length: this.count }, (_, s) => Math.hypot(sum[3 * s], sum[3 * s + 1], sum[3 * s + 2]));
}

/** (D) distances of opposite points. */
function diameters(points) {
  return Float64Array.from(this.near, (a, i) => { const b = this.far[i]; return Math.hypot(points[3 * a] - points[3 * b], points[3 * a + 1] - points[3 * b + 1], points[3 * a + 2] - points[3 * b + 2]); });
}

/** The largest closed loop round `center` in which a plane cuts faces: nodes [low, high, share] and segments of them. */
function slice(rest, faces, center, normal) {
  const heights = new Map(), V = rest.length / 3, nodes = [], segments = [], known = new Map();
  const height = (v) => {
    let h = heights.get(v);
    if (h === undefined) heights.set(v, (h = (rest[3 * v] - center[0]) * normal[0] + (rest[3 * v + 1] - center[1]) * normal[1] + (rest[3 * v + 2] - center[2]) * normal[2]));
    return h;
  };
  const node = (a, b) => {
    const low = Math.min(a, b), high = Math.max(a, b), key = low * V + high;
    if (!known.has(key)) { known.set(key, nodes.length); nodes.push([low, high, height(low) / (height(low) - height(high))]); }
    return known.get(key);
  };
  for (let k = 0; k < faces.length; k += 3) {
    const up = [height(faces[k]) >= 0, height(faces[k + 1]) >= 0, height(faces[k + 2]) >= 0], n = up[0] + up[1] + up[2];
    if (n === 0 || n === 3) continue;
    const alone = up.indexOf(n === 1), a = faces[k + alone], b = faces[k + ((alone + 1) % 3)], c = faces[k + ((alone + 2) % 3)];
    const one = node(a, b), two = node(a, c);
    segments.push(up[alone] ? [one, two] : [two, one]);
  }
  if (segments.length < 3) return null;
  const place = ([a, b, t]) => [0, 1, 2].map((c) => (1 - t) * rest[3 * a + c] + t * rest[3 * b + c]), points = nodes.map(place);
  const root = [...nodes.keys()], find = (i) => { while (root[i] !== i) i = root[i] = root[root[i]]; return i; }, degree = new Uint32Array(nodes.length);
  for (const [a, b] of segments) { root[find(a)] = find(b); degree[a]++; degree[b]++; }
  const loops = new Map();
  points.forEach((p, i) => {
    const r = find(i), loop = loops.get(r) ?? { closed: true, n: 0, middle: [0, 0, 0], area: [0, 0, 0] };
    loops.set(r, loop);
    loop.closed &&= degree[i] === 2;
    loop.n++;
    for (let c = 0; c < 3; c++) loop.middle[c] += p[c];
  });
  for (const loop of loops.values()) loop.middle = scaled(loop.middle, 1 / loop.n);
  for (const [a, b] of segments) {
    const loop = loops.get(find(a)), v = cross(sub(points[a], loop.middle), sub(points[b], loop.middle));
    for (let c = 0; c < 3; c++) loop.area[c] += v[c] / 2;
  }
  let best = -1, largest = 0;
  for (const [r, loop] of loops) {
    const area = Math.abs(dot(loop.area, normal));
    if (loop.closed && Math.hypot(...sub(loop.middle, center)) < Math.sqrt(area / Math.PI) && area > largest) { largest = area; best = r; }
  }
  if (best < 0) return null;
  const number = new Map();
  nodes.forEach((_, i) => { if (find(i) === best) number.set(i, number.size); });
  return { nodes: [...number.keys()].map((i) => nodes[i]), segments: segments.filter(([a]) => number.has(a)).map(([a, b]) => [number.get(a), number.get(b)]), place };
}

/** The outermost points of a loop both ways in each of `DIAMETERS` directions of its plane. */
function opposite(points, normal) {
  const least = normal.map(Math.abs), axis = [0, 0, 0];
  axis[least.indexOf(Math.min(...least))] = 1;
  const d = dot(axis, normal), x = unit(axis.map((a, c) => a - d * normal[c])), y = cross(normal, x);
  return Array.from({ length: DIAMETERS }, (_, n) => {
    const angle = (n * Math.PI) / DIAMETERS, way = [0, 1, 2].map((c) => Math.cos(angle) * x[c] + Math.sin(angle) * y[c]);
    let low = 0, high = 0;
    const heights = points.map((p) => dot(p, way));
    heights.forEach((h, i) => { if (h < heights[low]) low = i; if (h > heights[high]) high = i; });
    return [low, high];
  });
}
