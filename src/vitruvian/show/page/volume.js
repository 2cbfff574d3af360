// The "volume" operator, the same as vitruvian.deform.volume: turns as "log" does, and keeps every cross-section centred
// on its bent bone; where no section is one limb's it fades to "log". No drawing library here.

import { blend, deform, linear, once } from "./deform.js";
import { forked } from "./forks.js";
import { welded } from "./mesh.js";

const LEAST = 0.02; // what an influence counts for far from its bone
const SOFT = 0.6; // radii on each side of a joint over which centres change bones
const SQUARE = [0, 0.3], STRAIGHT = [0.34, 0.87]; // cosines between a bone and the next
const EDGE = 8; // how fast a joint counts with its weight
const BLUR = 6; // rounds in which neighbouring shares are averaged
const SMOOTH = 2; // rounds in which neighbouring centres are averaged
const SPACING = 0.5, STATIONS = 64; // radii between stations along a bone, and how many at most
const ROUND = 4; // times that the weights of a station are mixed with its neighbours'
const OPEN = [0.1, 0.2]; // lengths of the mean direction over all that is seen from a section's centre: closed, and not
const NEAR = 0.2; // mean radii: skin nearer to its centre is seen as from there
const TIE = 1e-5; // of a bone: what lies in the plane of a joint, or of a bone's middle, does so after rounding too
const LIGHT = 1 / 64; // weights below this are left out where they are made even

/** As `deform`: p' = R (p - c) + sum v_i M_i c, R the rotation of "log", c the centre of the vertex's section. */
export function volume(skin, pose, weights, positions, normals) {
  const { even, center, share, carried } = skin.whole ? once(skin, "sections", () => part(skin, laid(skin.whole))) : laid(skin);
  deform("log", even, pose, weights, positions, normals);
  const [turned, there, unused] = once(skin, "room", () => [0, 1, 2].map(() => new Float32Array(3 * skin.V)));
  blend(even, center, turned, unused, "log");
  linear(carried, center, there, unused);
  for (let i = 0; i < positions.length; i++) positions[i] += share[Math.floor(i / 3)] * (there[i] - turned[i]);
}

/** What is worked out about a whole skin: it with even weights, centres (V*3), shares (V), it with weights that carry. */
const laid = (skin) => once(skin, "sections", () => {
  const { center, radius, rows } = sections(skin), even = { ...skin, ...rows, over: new Float32Array(skin.V) };
  return { even, center, share: Float32Array.from(clear(even, straightness(skin, true))), carried: { ...even, weight: carriers(even, center, radius) } };
});

/** The same of those `vertices` of it that a part of the skin has. */
function part(skin, all) {
  const pick = (array, n) => { const out = new array.constructor(n * skin.V); skin.vertices.forEach((v, i) => out.set(array.subarray(n * v, n * v + n), n * i)); return out; };
  const row = new Uint32Array(skin.V + 1), index = [];
  skin.vertices.forEach((v, i) => {
    for (let k = all.even.row[v]; k < all.even.row[v + 1]; k++) index.push(k);
    row[i + 1] = index.length;
  });
  const of = (array) => array.constructor.from(index, (k) => array[k]);
  const even = { ...skin, row, joint: of(all.even.joint), weight: of(all.even.weight), over: new Float32Array(skin.V) };
  return { even, center: pick(all.center, 3), share: pick(all.share, 1), carried: { ...even, weight: of(all.carried.weight) } };
}

/** The centre of each vertex's section (V*3), its radius (V), and the weights that turn it: even round limbs that the skin closes round. */
function sections(given) {
  const { V, J, row, joint, rest } = given, weight = Float64Array.from(given.weight);
  for (let v = 0; v < V; v++) {
    let total = 0;
    for (let k = row[v]; k < row[v + 1]; k++) total += weight[k];
    for (let k = row[v]; k < row[v + 1]; k++) weight[k] /= total || 1;
  }
  const skin = { ...given, weight }, feet = footing(skin), first = means(skin, weight, feet);
  const center = averaged(given, means(skin, carrying(skin, first, radii(rest, first)), feet), 3, SMOOTH), { fanned, bone } = fans(skin, bones(skin, center, radii(rest, center)), center);
  const facing = facings(given), area = Float64Array.from({ length: V }, (_, v) => Math.hypot(...at(facing, v))), radius = radii(rest, fanned);
  const { place, share: between, links } = stations(skin, bone, fanned, radius), sums = new Map(); // by station: area, radius, what is seen, weights
  const each = (v, f) => { if (place[2 * v] >= 0) for (let s = 0; s < 2; s++) if (between[2 * v + s] > 0) f(sums.get(place[2 * v + s]), between[2 * v + s], place[2 * v + s]); };
  for (let v = 0; v < V; v++) each(v, (sum, b, s) => {
    if (!sum) sums.set(s, (sum = { area: 0, radius: 0, seen: 0, way: [0, 0, 0], weight: new Float64Array(J + 1) }));
    sum.area += b * area[v];
    sum.radius += b * area[v] * radius[v];
    for (let k = row[v]; k < row[v + 1]; k++) sum.weight[joint[k]] += b * area[v] * weight[k];
  });
  const mean = new Float64Array(V), toward = new Float64Array(3 * V), closed = new Float64Array(V), within = new Uint8Array(V);
  for (let v = 0; v < V; v++) {
    each(v, (sum, b) => { if (sum.area > 0) mean[v] += (b * sum.radius) / sum.area; });
    for (let c = 3 * v; c < 3 * v + 3; c++) toward[c] = (rest[c] - fanned[c]) / Math.max(radius[v], 1e-9);
    const angle = dot(at(facing, v), at(toward, v)) / Math.max(radius[v], NEAR * mean[v] + 1e-9);
    each(v, (sum, b) => { sum.seen += b * angle; for (let c = 0; c < 3; c++) sum.way[c] += b * angle * toward[3 * v + c]; });
  }
  for (let v = 0; v < V; v++) {
    const way = [0, 0, 0];
    let seen = 0;
    each(v, (sum, b) => { seen += b * sum.seen; for (let c = 0; c < 3; c++) way[c] += b * sum.way[c]; });
    within[v] = seen > 0;
    closed[v] = within[v] ? 1 - smooth(Math.hypot(...way) / seen, ...OPEN) : 0;
  }
  const closes = averaged(given, closed, 1, BLUR), straight = clear(skin, straightness(given, false));
  const rows = new Uint32Array(V + 1), joints = [], weights = [], even = new Float64Array(J + 1), mixed = spread(sums, links);
  let any = false;
  const rigid = row.every((k, v) => v === 0 || k - row[v - 1] <= 1); // pieces that ride on their joints stay as they are
  for (let v = 0; v < V; v++) {
    const share = rigid ? 0 : closes[v] * within[v] * straight[v];
    any ||= share > 0;
    for (let c = 3 * v; c < 3 * v + 3; c++) center[c] += share * (fanned[c] - center[c]);
    const own = Math.hypot(...minus(at(rest, v), at(center, v)));
    radius[v] = own + share * (mean[v] - own);
    if (share > 0) {
      even.fill(0);
      each(v, (sum, b, s) => { if (sum.area > 0) mixed.get(s).forEach((w, j) => { even[j] += share * b * w; }); });
      for (let k = row[v]; k < row[v + 1]; k++) even[joint[k]] += (1 - share) * weight[k];
      const least = Math.min(LIGHT, even.reduce((a, b) => Math.max(a, b), 0)), list = [];
      let total = 0;
      for (let j = 0; j <= J; j++) if (even[j] > 0 && even[j] >= least) { list.push([j, even[j]]); total += even[j]; }
      list.sort((a, b) => b[1] - a[1] || a[0] - b[0]);
      for (const [j, w] of list) { joints.push(j); weights.push(w / total); }
    } else for (let k = row[v]; k < row[v + 1]; k++) { joints.push(joint[k]); weights.push(weight[k]); }
    rows[v + 1] = joints.length;
  }
  const out = { row: rows, joint: Uint16Array.from(joints), weight: Float64Array.from(weights) };
  if (any) forked(skin, out, center, radius, area);
  return { center, radius, rows: out };
}

/** Mean weights by station, each mixed with its two neighbours some times over; where there are not two it keeps its own. */
function spread(sums, links) {
  const near = new Map();
  let now = new Map([...sums].filter(([, sum]) => sum.area > 0).map(([s, sum]) => [s, sum.weight.map((w) => w / sum.area)]));
  for (const [a, b] of links) if (now.has(a) && now.has(b)) for (const [x, y] of [[a, b], [b, a]]) near.set(x, [...(near.get(x) ?? []), y]);
  for (let n = 0; n < ROUND; n++) now = new Map([...now].map(([s, own]) => {
    const two = near.get(s) ?? [];
    return [s, two.length === 2 ? own.map((w, j) => w / 2 + (now.get(two[0])[j] + now.get(two[1])[j]) / 4) : own];
  }));
  return now;
}

/** (V) how far the vertices are from their centres. */
const radii = (rest, center) => Float64Array.from({ length: rest.length / 3 }, (_, v) => Math.hypot(...minus(at(rest, v), at(center, v))));

/** (V*3) a third of the areas of the faces at each vertex, along their normals. */
function facings({ V, rest, triangles }) {
  const out = new Float64Array(3 * V);
  for (let k = 0; k < triangles.length; k += 3) {
    const [a, b, c] = [0, 1, 2].map((i) => at(rest, triangles[k + i])), normal = cross(minus(b, a), minus(c, a));
    for (let i = 0; i < 3; i++) for (let n = 0; n < 3; n++) out[3 * triangles[k + i] + n] += normal[n] / 6;
  }
  return out;
}

/** (V) the joint whose bone carries the centre of each vertex most, -1 for none. */
function bones(skin, center, radius) {
  const { V, row, joint } = skin, carry = carrying(skin, center, radius), out = new Int32Array(V).fill(-1);
  for (let v = 0; v < V; v++) {
    let best = -1;
    for (let k = row[v]; k < row[v + 1]; k++) if (best < 0 || carry[k] >= carry[best]) best = k;
    if (best >= 0) out[v] = joint[best];
  }
  return out;
}

/** For each joint the one below it, where there is just one; else -1. */
function onlyBelow(parents) {
  const out = parents.map(() => -1), count = parents.map(() => 0);
  parents.forEach((p, j) => { if (p >= 0) { out[p] = j; count[p]++; } });
  return out.map((k, j) => (count[j] === 1 ? k : -1));
}

/** The centres (V*3) of sections in planes that turn from one bone to the next between their middles, and on which they lie. */
function fans({ V, J, rest, centers, parents }, bone, center) {
  const fanned = center.slice(), lies = bone.slice(), only = onlyBelow(parents), way = (a, b) => minus(at(centers, b), at(centers, a));
  for (let v = 0; v < V; v++) {
    const j = bone[v], k = j >= 0 && j < J ? only[j] : -1;
    if (k < 0) continue;
    const own = way(j, k), size = dot(own, own);
    if (Math.sqrt(size) < 1e-6) continue;
    const later = dot(minus(at(center, v), at(centers, j)), own) > size * (0.5 + TIE), n = later ? k : j, above = parents[n], below = only[n];
    const into = above < 0 || only[above] !== n ? own : way(above, n), on = below < 0 ? own : way(n, below);
    const { place, ahead } = fan(minus(at(rest, v), at(centers, n)), into.map((x) => x / 2), on.map((x) => x / 2));
    fanned.set(plus(place, at(centers, n)), 3 * v);
    if (!later && above >= 0 && only[above] === n && !ahead) lies[v] = above;
    if (later && below >= 0 && ahead) lies[v] = n;
  }
  return { fanned, bone: lies };
}

/** Where the plane through p cuts the line that comes to the origin by `into` and goes on by `on`; planes turn along it. */
function fan(p, into, on) {
  let [a, b] = [Math.hypot(...into), Math.hypot(...on)];
  if (Math.min(a, b) < 1e-6) { into = on = a > b ? into : on; a = b = Math.max(a, b); }
  const plane = (s) => {
    const h = smooth(s, -1, 1);
    return { at: (s >= 0 ? on : into).map((x) => x * s), normal: unit(into.map((x, i) => ((1 - h) * x) / a + (h * on[i]) / b)) };
  };
  let low = -1, high = 1;
  for (let n = 0; n < 24; n++) {
    const middle = (low + high) / 2, { at: q, normal } = plane(middle);
    if (dot(minus(p, q), normal) > 0) low = middle;
    else high = middle;
  }
  const { at: q, normal } = plane((low + high) / 2), left = dot(minus(p, q), normal);
  return { place: q.map((x, i) => x + left * normal[i]), ahead: low + high >= -2 * TIE };
}

/** The two stations (V*2, -1 for none) along its bone next to each vertex's centre, how much it belongs to each, and pairs of stations that follow each other. */
function stations({ V, J, centers, parents }, bone, center, radius) {
  const place = new Int32Array(2 * V).fill(-1), share = new Float64Array(2 * V), mean = new Float64Array(J + 1), count = new Float64Array(J + 1), links = [];
  for (let v = 0; v < V; v++) if (bone[v] >= 0) {
    mean[bone[v]] += radius[v];
    count[bone[v]]++;
  }
  let free = J;
  const only = onlyBelow(parents), laid = Array.from({ length: J }, (_, j) => {
    if (only[j] < 0 || !count[j]) return null;
    const way = minus(at(centers, only[j]), at(centers, j)), size = dot(way, way), thick = mean[j] / count[j];
    if (Math.sqrt(size) <= thick) return null; // shorter than the section is wide: vertebrae
    const steps = Math.min(STATIONS, Math.round(Math.sqrt(size) / Math.max(SPACING * thick, 1e-6))), first = free;
    const known = (i) => (i === 0 ? j : i === steps ? only[j] : first + i - 1);
    free += steps - 1;
    for (let i = 0; i < steps; i++) links.push([known(i), known(i + 1)]);
    return { way, size, steps, known };
  });
  for (let v = 0; v < V; v++) {
    const b = bone[v] >= 0 && bone[v] < J ? laid[bone[v]] : null;
    if (!b) continue;
    const along = Math.min(1, Math.max(0, dot(minus(at(center, v), at(centers, bone[v])), b.way) / b.size)) * b.steps, before = Math.min(Math.floor(along), b.steps - 1);
    place[2 * v] = b.known(before);
    place[2 * v + 1] = b.known(before + 1);
    share[2 * v] = 1 - (along - before);
    share[2 * v + 1] = along - before;
  }
  return { place, share, links };
}

/** (n) how much each influence carries of the centre of its vertex, which is there; not yet of sum one. */
function carrying(skin, center, radius) {
  const near = membership(skin, center, radius);
  return Float64Array.from(skin.weight, (w, k) => w ** 2 * (near[k] + LEAST));
}

/** (V*3) means of the feet (n*3) of each vertex by `share` (n). */
function means({ V, row }, share, feet) {
  const out = new Float64Array(3 * V);
  for (let v = 0; v < V; v++) {
    let total = 0;
    for (let k = row[v]; k < row[v + 1]; k++) total += share[k];
    for (let k = row[v]; k < row[v + 1]; k++) for (let c = 0; c < 3; c++) out[3 * v + c] += (share[k] / (total || 1)) * feet[3 * k + c];
  }
  return out;
}

/** (n) weights that carry the centres, with the sum of the weights that move. */
function carriers(skin, center, radius) {
  const { V, J, row, joint, weight } = skin, out = Float32Array.from(weight), carry = carrying(skin, center, radius);
  for (let v = 0; v < V; v++) {
    let plain = 0, sharp = 0;
    for (let k = row[v]; k < row[v + 1]; k++) if (joint[k] < J) { plain += weight[k]; sharp += carry[k]; }
    for (let k = row[v]; k < row[v + 1]; k++) if (joint[k] < J) out[k] = (carry[k] * plain) / (sharp || 1);
  }
  return out;
}

/** (n) for each influence how far the centre of its vertex lies past its joint and before the next ones, 0..1. */
function membership({ V, J, row, joint, centers, parents }, center, radii) {
  const way = ways(centers, parents), above = aboves({ V, J, row, joint, parents }), past = new Float64Array(joint.length).fill(1), out = new Float64Array(joint.length).fill(1);
  for (let v = 0; v < V; v++) {
    const c = center.subarray(3 * v, 3 * v + 3), radius = SOFT * Math.max(1e-3, radii[v]);
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

/**
 * (V) 1 where no joint between bones that go on in another direction moves a vertex; `straight` (J) of joints. A joint counts
 * with all that lies past it on the limb, and with it all joints up to the next influence.
 */
function clear(skin, straight) {
  const { V, row, joint, weight, parents } = skin, above = aboves(skin), past = Float64Array.from(weight);
  for (let k = 0; k < joint.length; k++) for (let up = above[k]; up >= 0; up = above[up]) past[up] += weight[k];
  let out = new Float64Array(V).fill(1);
  for (let v = 0; v < V; v++) for (let k = row[v]; k < row[v + 1]; k++) if (above[k] >= 0) {
    let least = 1;
    for (let j = joint[k]; j !== joint[above[k]]; j = parents[j]) least = Math.min(least, straight[j]);
    out[v] *= 1 - Math.min(1, Math.max(0, EDGE * past[k] * (1 - past[k]))) * (1 - least);
  }
  for (let n = 0; n < BLUR; n++) { // narrow bands keep what they are: they are the ones that stretch most
    const mean = averaged(skin, out, 1, 1);
    out = out.map((s, v) => Math.min(s, mean[v]));
  }
  return out.map((s) => Math.min(1, Math.max(0, s)));
}

/** (J) how straight the limb goes on at a joint at rest; with `square` also how square it goes off. */
function straightness({ centers, parents }, square) {
  const into = parents.map((p, j) => (p >= 0 ? unit(minus(at(centers, j), at(centers, p))) : [0, 0, 0])), most = parents.map(() => -Infinity);
  parents.forEach((p, j) => { if (p >= 0) most[p] = Math.max(most[p], dot(into[j], into[p])); });
  return parents.map((p, j) => (p >= 0 && most[j] > -Infinity ? Math.max(smooth(most[j], ...STRAIGHT), square ? 1 - smooth(most[j], ...SQUARE) : 0) : 1));
}

function smooth(x, low, high) {
  const t = Math.min(1, Math.max(0, (x - low) / (high - low)));
  return t * t * (3 - 2 * t);
}

/** (n*3) for each influence the point nearest to its vertex on the bones of its joint. */
function footing(skin) {
  const { V, row, joint, rest, parents } = skin, below = parents.map(() => []), out = new Float64Array(3 * joint.length);
  parents.forEach((p, j) => { if (p >= 0) below[p].push(j); });
  const middle = middles(skin);
  for (let v = 0; v < V; v++) {
    const p = rest.subarray(3 * v, 3 * v + 3);
    for (let k = row[v]; k < row[v + 1]; k++) out.set(joint[k] < skin.J ? footOf(skin, below, middle, joint[k], p) : p, 3 * k);
  }
  return out;
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
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const plus = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const unit = (a) => { const s = Math.max(Math.hypot(...a), 1e-12); return [a[0] / s, a[1] / s, a[2] / s]; };
