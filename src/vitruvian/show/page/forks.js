// Sections of the "volume" operator where a limb goes on straight into several bones, as the forearm into the palm: laid
// about one line until the bones part. The same as vitruvian.deform.forks.

const STRAIGHT = 0.9; // cosine between the bone before and the line beyond
const STEPS = 8, LAST = 2 * STEPS; // stations on the line; as many before the joint, as far apart
const BEFORE = 0.25; // of the line, before the joint: from there its sections are taken over
const PART = [0.35, 0.85]; // of the line: bones begin to part, and have
const WIDE = [1.8, 2.4]; // mean radii at the joint: so far from the line sections are those of another limb (thumb)
const ROUND = 3; // times that the shares of a station are mixed with its neighbours'

/** Changes centres (V*3), radii (V) and `rows` (row, joint, weight) of sections, for those that know of no forks; area (V). */
export function forked(skin, rows, center, radius, area) {
  const { V, rest, centers, parents } = skin, { row, joint, weight } = rows, stations = Array.from({ length: LAST + 1 }, (_, i) => i);
  const total = sums(V, rows, () => true);
  for (const { at, under, line } of forks(skin, rows, area)) {
    const own = sums(V, rows, (j) => under[j]), above = sums(V, rows, (j) => j === parents[at]), size = dot(line, line), start = [0, 1, 2].map((c) => centers[3 * at + c]);
    let near = 0, thick = 0;
    const along = new Float64Array(V), away = new Float64Array(V), share = new Float64Array(V), mine = new Uint8Array(V), many = new Float64Array(LAST + 1), much = new Float64Array(LAST + 1);
    const where = (v) => { const place = Math.min(LAST, Math.max(0, (along[v] + 1) * STEPS)), before = Math.min(Math.floor(place), LAST - 1); return [before, place - before]; };
    for (let v = 0; v < V; v++) {
      along[v] = [0, 1, 2].reduce((s, c) => s + (rest[3 * v + c] - start[c]) * line[c], 0) / size;
      share[v] = own[v] / (total[v] || 1);
      mine[v] = own[v] + above[v] > 0.5 * total[v] && Math.abs(along[v]) < 1 ? 1 : 0;
      if (!mine[v]) continue;
      away[v] = Math.hypot(...[0, 1, 2].map((c) => rest[3 * v + c] - start[c] - along[v] * line[c]));
      const here = area[v] * Math.max(0, 1 - Math.abs(along[v]) * STEPS);
      near += here;
      thick += here * away[v];
      const [before, part] = where(v);
      for (const [i, near] of [[before, 1 - part], [before + 1, part]]) { many[i] += area[v] * near; much[i] += area[v] * near * share[v]; }
    }
    const known = stations.filter((i) => many[i] > 0);
    if (!known.length) continue;
    thick = Math.max(thick / Math.max(near, 1e-12), 1e-9);
    let mean = stations.map((i) => between(i, known, (k) => much[k] / many[k]));
    for (let n = 0; n < ROUND; n++) mean = mean.map((m, i) => (i > 0 && i < LAST ? m / 2 + (mean[i - 1] + mean[i + 1]) / 4 : m));
    for (let v = 0; v < V; v++) {
      const even = mine[v] * smooth(along[v], -BEFORE, 0) * (1 - smooth(along[v], ...PART)) * (1 - smooth(away[v] / thick, ...WIDE)), [before, part] = where(v);
      if (!even) continue;
      const goal = share[v] + even * ((1 - part) * mean[before] + part * mean[before + 1] - share[v]);
      if (share[v] > 0 && share[v] < 1) for (let k = row[v]; k < row[v + 1]; k++) weight[k] *= under[joint[k]] ? goal / share[v] : (1 - goal) / (1 - share[v]);
      for (let c = 0; c < 3; c++) center[3 * v + c] += even * (start[c] + along[v] * line[c] - center[3 * v + c]);
      radius[v] += even * (away[v] - radius[v]);
      const list = Array.from({ length: row[v + 1] - row[v] }, (_, i) => [joint[row[v] + i], weight[row[v] + i]]).sort((a, b) => b[1] - a[1] || a[0] - b[0]);
      list.forEach(([j, w], i) => { joint[row[v] + i] = j; weight[row[v] + i] = w; });
    }
  }
}

/** Joints at which a limb goes on straight into several bones, which joints (J+1) are that or below it, and the line from there to the middle of their skin. */
function forks({ V, J, rest, centers, parents }, rows, area) {
  const below = new Uint32Array(J), out = [];
  parents.forEach((p) => { if (p >= 0) below[p]++; });
  for (let at = 0; at < J; at++) {
    const parent = parents[at], under = new Uint8Array(J + 1), middle = [0, 0, 0];
    if (below[at] < 2 || parent < 0 || below[parent] !== 1) continue;
    under[at] = 1;
    for (let j = at + 1; j < J; j++) under[j] = parents[j] >= 0 ? under[parents[j]] : 0;
    const load = sums(V, rows, (j) => under[j]);
    let whole = 0;
    for (let v = 0; v < V; v++) { whole += load[v] * area[v]; for (let c = 0; c < 3; c++) middle[c] += load[v] * area[v] * rest[3 * v + c]; }
    if (whole <= 0) continue;
    const line = middle.map((x, c) => x / whole - centers[3 * at + c]), into = [0, 1, 2].map((c) => centers[3 * at + c] - centers[3 * parent + c]);
    const a = Math.hypot(...line), b = Math.hypot(...into);
    if (a > 1e-6 && a < b && dot(line, into) > STRAIGHT * a * b) out.push({ at, under, line });
  }
  return out;
}

/** (V) sums of the weights of some joints. */
function sums(V, { row, joint, weight }, some) {
  const out = new Float64Array(V);
  for (let v = 0; v < V; v++) for (let k = row[v]; k < row[v + 1]; k++) if (some(joint[k])) out[v] += weight[k];
  return out;
}

/** The value at i between those of its known neighbours. */
function between(i, known, value) {
  const next = known.find((k) => k >= i) ?? known.at(-1), last = known.findLast((k) => k <= i) ?? known[0];
  return next <= last || i <= known[0] || i >= known.at(-1) ? value(i <= known[0] ? known[0] : last) : value(last) + ((i - last) / (next - last)) * (value(next) - value(last));
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const smooth = (x, low, high) => { const t = Math.min(1, Math.max(0, (x - low) / (high - low))); return t * t * (3 - 2 * t); };
