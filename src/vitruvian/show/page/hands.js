// Hands by their links: knuckles that round, palms that swell. The same as vitruvian.deform.hands (and hand_terms): which
// links place which vertices comes from Python, both hands in one; what that takes is worked out here from the rest points,
// again when displacers move them. Names of arrays are those of the hand program's fields there.

const MOST = (120 * Math.PI) / 180; // flexion beyond which a knuckle grows no more
const ROUND = Math.PI / 3; // flexion at which the back of a joint is fully an arc
const ROOM = 0.9; // of the depth at which the palm side would fold onto itself, that it may have
const ARC = 1.6; // an arc's share of the link over the portion that is inflated
export const TILT = Math.PI / 4; // how far a flexion axis may be turned about its link
const LINKS = ["before", "near", "far", "previous", "start", "end", "axis_near", "axis_far", "normal_near", "normal_far", "rounding", "palm"];
const TERMS = ["vertex", "link", "share"], GAPS = ["gap_vertex", "links", "gap_share"], OWN = ["vertices", "left"];

/**
 * The hands out of a mesh message's blocks; null when it has none, or lacks something.
 * before, near, far, previous: one more than the joint or link, 0: none. rounding (L*7): joint, near, far, muscle, belly, arc,
 * palm. palm (L): 1 for the metacarpals.
 * vertices and left: what the base operator keeps of each. A term: a vertex, its link and share; a gap: its two links.
 * tuning: shared by all parts of a skin; `plain`: no second pass, `change` counts what `tune` did.
 */
export function handProgram(get) {
  const out = Object.fromEntries([...LINKS, ...TERMS, ...GAPS, ...OWN].map((name) => [name, get(`hand_${name}`)]));
  if (!Object.values(out).every(Boolean)) return null;
  const copy = (name) => out[name].slice();
  return { ...out, tuning: { plain: false, change: 0, axis_near: copy("axis_near"), axis_far: copy("axis_far") } };
}

/**
 * Other parameters: rounding (L*7); tilt (L) radians by which the axis at the beginning of each link is turned about it;
 * `plain`: neither knuckles nor arcs nor muscle. Whatever shares these hands follows.
 */
export function tune(p, { rounding, tilt, plain }) {
  const given = p.tuning, L = p.near.length, at = (a, k) => [...a.subarray(3 * k, 3 * k + 3)];
  const way = Array.from({ length: L }, (_, k) => unit(at(p.end, k).map((x, c) => x - p.start[3 * k + c])));
  p.rounding.set(rounding);
  Object.assign(given, { plain, change: given.change + 1 });
  p.axis_far.set(given.axis_far);
  const follows = [...way.keys()];
  for (let k = 0; k < L; k++) {
    const axis = turned(at(given.axis_near, k), way[k], tilt[k]), before = p.previous[k] - 1;
    p.axis_near.set(axis, 3 * k);
    if (before < 0) continue;
    follows[before] = k;
    if (tilt[k]) p.axis_far.set(axis, 3 * before);
  }
  for (let k = 0; k < L; k++) {
    const before = p.previous[k] ? p.previous[k] - 1 : k;
    p.normal_near.set(unit(cross(unit(add(way[before], way[k])), at(p.axis_near, k))), 3 * k);
    p.normal_far.set(unit(cross(unit(add(way[k], way[follows[k]])), at(p.axis_far, k))), 3 * k);
  }
}

/** v turned by an angle about a unit axis. */
function turned(v, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle), d = (1 - c) * (v[0] * axis[0] + v[1] * axis[1] + v[2] * axis[2]), w = cross(axis, v);
  return v.map((x, i) => c * x + s * w[i] + d * axis[i]);
}

/** The same for some vertices; `of`: old vertex -> new one or -1. */
export function handsOf(program, of) {
  const cut = (names) => {
    const vertex = program[names[0]], keep = [...vertex.keys()].filter((i) => of[vertex[i]] >= 0);
    return Object.fromEntries(names.map((name, n) => {
      const a = program[name], w = a.length / (vertex.length || 1);
      if (!n) return [name, Uint32Array.from(keep, (i) => of[a[i]])];
      const out = new a.constructor(keep.length * w);
      keep.forEach((i, k) => out.set(a.subarray(w * i, w * i + w), w * k));
      return [name, out];
    }));
  };
  return { ...program, ...cut(TERMS), ...cut(GAPS), ...cut(OWN) };
}

/** Move the vertices of hands in `positions`, which the base operator has set, in the pose of `skin`; `rest`: displaced points. */
export function handed(skin, positions, rest = skin.rest) {
  const p = skin.hands, a = laid(skin, rest), b = bent(p, skin.M), F = new Float64Array(9);
  p.vertices.forEach((v, i) => { for (let c = 3 * v; c < 3 * v + 3; c++) positions[c] *= p.left[i]; });
  for (let i = 0; i < p.vertex.length; i++) {
    const k = p.link[i], v = 3 * p.vertex[i], inner = clip(a.along[i], 0, 1);
    const along = a.along[i] + a.shift[2 * i] * b.arc[2 * k] + a.shift[2 * i + 1] * b.arc[2 * k + 1];
    const x = a.local[3 * i], z = a.local[3 * i + 2];
    let y = a.local[3 * i + 1] * (1 + a.swell[3 * i] * b.bend[3 * k] + a.swell[3 * i + 1] * b.bend[3 * k + 1] + a.swell[3 * i + 2] * b.bend[3 * k + 2]);
    const depth = a.press[i] * y * ((1 - inner) * b.tight[2 * k] + inner * b.tight[2 * k + 1]);
    y /= Math.sqrt(Math.sqrt(1 + depth ** 4));
    frame(b, k, a.coefficients, 3 * i, F);
    for (let c = 0; c < 3; c++) {
      const at = b.start[3 * k + c] + along * b.bone[3 * k + c];
      positions[v + c] += p.share[i] * (at + F[c] * x + F[3 + c] * y + F[6 + c] * z);
    }
  }
  const at = new Float64Array(3), way = new Float64Array(3);
  for (let i = 0; i < p.gap_vertex.length; i++) {
    const v = 3 * p.gap_vertex[i], width = a.width[i], part = a.across[i], length = bridge(p, b, a, i, at, way, F);
    const ratio = width < 1e-6 ? 1 : length / width, thick = ratio < 1 ? Math.min(1 + a.fold[i] * (1 / Math.max(ratio, 1e-6) - 1), 2) : 1;
    const x = a.gapLocal[3 * i], y = a.gapLocal[3 * i + 1] * thick, z = a.gapLocal[3 * i + 2];
    for (let c = 0; c < 3; c++) positions[v + c] += p.gap_share[i] * (at[c] + part * way[c] + F[c] * x + F[3 + c] * y + F[6 + c] * z);
  }
}

/** What the terms and gaps of a skin's hands take of its rest points; kept until those move. */
function laid(skin, rest) {
  const p = skin.hands, kept = skin.laid, { change } = p.tuning;
  if (kept?.hands === p && kept.change === change && same(p.vertices, kept.points, rest)) return kept;
  const points = new Float32Array(3 * p.vertices.length);
  p.vertices.forEach((v, i) => points.set(rest.subarray(3 * v, 3 * v + 3), 3 * i));
  return (skin.laid = { hands: p, change, points, ...placed(p, rest) });
}

function same(vertices, points, rest) {
  for (let i = 0; i < points.length; i++) if (points[i] !== rest[3 * vertices[Math.floor(i / 3)] + (i % 3)]) return false;
  return true;
}

function placed(p, rest) {
  const n = p.vertex.length, g = p.gap_vertex.length, still = atRest(p), F = new Float64Array(9), at = new Float64Array(3), way = new Float64Array(3);
  const floats = (sizes) => Object.fromEntries(Object.entries(sizes).map(([name, size]) => [name, new Float64Array(size)]));
  const out = floats({ along: n, shift: 2 * n, coefficients: 3 * n, local: 3 * n, swell: 3 * n, press: n, alongs: 2 * g, gapCoefficients: 6 * g, across: g, gapLocal: 3 * g, fold: g, width: g });
  const off = (v, c, k, along) => rest[3 * v + c] - still.start[3 * k + c] - along * still.bone[3 * k + c];
  for (let i = 0; i < n; i++) {
    const k = p.link[i], v = p.vertex[i], { along, outside, coefficients, shift } = zone(p, still, k, rest, v), [joint, near, far, muscle, belly, arc, palm] = rounding(p, k);
    out.along[i] = along;
    out.shift.set(shift, 2 * i);
    out.coefficients.set(coefficients, 3 * i);
    frame(still, k, out.coefficients, 3 * i, F);
    for (let c = 0; c < 3; c++) for (let r = 0; r < 3; r++) out.local[3 * i + r] += F[3 * r + c] * off(v, c, k, along);
    if (outside) out.swell.set([joint * bump(along / Math.max(near, 1e-9)), joint * bump((1 - along) / Math.max(far, 1e-9))], 3 * i);
    else out.swell[3 * i + 2] = muscle * (p.palm[k] ? palm : 1) * Math.sin(Math.PI * clip(along, 0, 1) ** (Math.log(0.5) / Math.log(belly))) ** 2;
    out.press[i] = outside ? 0 : arc;
  }
  for (let i = 0; i < g; i++) {
    const v = p.gap_vertex[i], pair = [p.links[2 * i], p.links[2 * i + 1]];
    const [one, two] = pair.map((k) => zone(p, still, k, rest, v, true));
    out.alongs.set([one.along, two.along], 2 * i);
    out.gapCoefficients.set([...one.coefficients, ...two.coefficients], 6 * i);
    const length = bridge(p, still, out, i, at, way, F); // for where it goes; its frame needs to know how far across
    for (let c = 0; c < 3; c++) out.across[i] += ((rest[3 * v + c] - at[c]) * way[c]) / Math.max(length, 1e-9) ** 2;
    bridge(p, still, out, i, at, way, F);
    for (let c = 0; c < 3; c++) for (let r = 0; r < 3; r++) out.gapLocal[3 * i + r] += F[3 * r + c] * (rest[3 * v + c] - at[c] - out.across[i] * way[c]);
    out.width[i] = length;
    for (const k of pair) out.fold[i] += (rounding(p, k)[3] / 2) * (out.gapLocal[3 * i + 1] < 0 ? rounding(p, k)[6] : 1);
  }
  return out;
}

/** Of link k: joint, near, far, muscle, belly, arc, palm. */
function rounding({ rounding: all, tuning }, k) {
  const own = all.subarray(7 * k, 7 * k + 7);
  return tuning.plain ? [0, own[1], own[2], 0, own[4], 0, 0] : own;
}
const bump = (u) => (Math.abs(u) < 1 ? Math.cos((Math.PI * u) / 2) ** 2 : 0);
const clip = (x, low, high) => Math.min(high, Math.max(low, x));

/**
 * Where a point stands on its link: how far along it, whether on the back's side, the coefficients of the frames at the
 * near end, of the link and at the far end, and how far an arc at its ends moves it. In a gap, whose points stand off the
 * link sideways, back and palm side pass into each other.
 */
function zone(p, { start, bone, y }, k, rest, v, gap = false) {
  const [, near, far, , , arc] = rounding(p, k);
  let along = 0, size = 0, height = 0, length = 0;
  for (let c = 0; c < 3; c++) {
    along += (rest[3 * v + c] - start[3 * k + c]) * bone[3 * k + c];
    size += bone[3 * k + c] ** 2;
  }
  along /= size;
  const inner = clip(along, 0, 1);
  for (let c = 0; c < 3; c++) {
    const off = rest[3 * v + c] - start[3 * k + c] - along * bone[3 * k + c];
    height += off * ((1 - inner) * y[9 * k + c] + inner * y[9 * k + 6 + c]);
    length += off * off;
  }
  if (height < 0) return { along, outside: false, coefficients: [1 - inner, 0, inner], shift: [0, 0] };
  const t = clip((3 * height) / Math.max(Math.sqrt(length), 1e-12), 0, 1), up = t * t * (3 - 2 * t);
  const outer = clip((along - near) / Math.max(1 - near - far, 1e-9), 0, 1);
  const a = Math.min(ARC * near, 0.5), b = Math.min(ARC * far, 0.5);
  const one = clip(along / Math.max(a, 1e-9), 0, 1), two = clip((1 - along) / Math.max(b, 1e-9), 0, 1), first = (1 - one) ** 2, last = (1 - two) ** 2;
  const mix = (plain, even, bow) => (1 - arc) * (gap ? (1 - up) * even + up * plain : plain) + arc * ((1 - up) * even + up * bow);
  return {
    along, outside: true, coefficients: [mix(1 - outer, 1 - inner, first), mix(0, 0, 1 - first - last), mix(outer, inner, last)],
    shift: [-arc * up * a * one * first, arc * up * b * two * last],
  };
}

/** Links where they were bound, as `bent` has them in a pose. */
function atRest(p) {
  const identity = new Float64Array(12 * Math.max(...p.near, ...p.far, ...p.before));
  for (let i = 0; i < identity.length; i += 12) identity[i] = identity[i + 5] = identity[i + 10] = 1;
  return bent(p, identity);
}

/**
 * Links for joint matrices M (J*12): first ends and bones (L*3); normals y and side axes z at the near end, of the link and
 * at the far end (L*9); how far knuckles and muscle are bent (L*3), both ends rounded and how tight the palm side is (L*2).
 */
function bent(p, M) {
  const L = p.near.length, out = { start: new Float64Array(3 * L), bone: new Float64Array(3 * L), y: new Float64Array(9 * L), z: new Float64Array(9 * L), bend: new Float64Array(3 * L), arc: new Float64Array(2 * L), tight: new Float64Array(2 * L) };
  const turn = (m, v) => [0, 4, 8].map((r) => M[m + r] * v[0] + M[m + r + 1] * v[1] + M[m + r + 2] * v[2]);
  const put = (m, v) => turn(m, v).map((x, r) => x + M[m + 4 * r + 3]);
  const both = (a, b, v) => add(turn(a, v), turn(b, v)), back = (v) => v.map((x) => -x);
  for (let l = 0; l < L; l++) {
    const of = (name) => [...p[name].subarray(3 * l, 3 * l + 3)], joint = (name, none) => (p[name][l] ? 12 * (p[name][l] - 1) : none);
    const own = joint("near", 0), before = joint("before", own), after = joint("far", own);
    const normalNear = of("normal_near"), normalFar = of("normal_far"), axisNear = of("axis_near"), axisFar = of("axis_far");
    const start = put(own, of("start")), bone = put(after, of("end")).map((x, c) => x - start[c]);
    const ys = [unit(both(before, own, normalNear)), turn(own, unit(add(normalNear, normalFar))), unit(both(own, after, normalFar))];
    const zs = [both(before, own, axisNear), turn(own, unit(add(axisNear, axisFar))), both(own, after, axisFar)];
    out.start.set(start, 3 * l);
    out.bone.set(bone, 3 * l);
    out.y.set(ys.flat(), 9 * l);
    out.z.set(zs.flatMap((z, e) => square(back(z), ys[e])), 9 * l);
    const a = flexion(M, before, own, axisNear), b = flexion(M, own, after, axisFar), mean = Math.max(0, (a + b) / 2);
    out.bend.set([knuckle(a), knuckle(b), 1 - Math.cos(mean)], 3 * l);
    out.arc.set([a, b].map((x) => { const c = clip(x / ROUND, 0, 1); return c * (2 - c); }), 2 * l);
    // Along the palm side frames turn by the mean of both flexions while they advance by the link's length.
    out.tight.fill(mean / (ROOM * Math.hypot(...bone) * Math.cos(clip(Math.max(a, b), 0, MOST) / 2)), 2 * l, 2 * l + 2);
  }
  for (let l = 0; l < L; l++) if (p.previous[l]) { // both links of a joint agree there
    const k = 2 * (p.previous[l] - 1) + 1;
    out.tight[k] = out.tight[2 * l] = Math.max(out.tight[k], out.tight[2 * l]);
  }
  return out;
}

const knuckle = (angle) => 1 / Math.cos(clip(angle, 0, MOST) / 2) - 1;

/** Signed angle about `axis` of the rotation from joint matrix a to b; scaled ones are taken as the kernel takes them. */
function flexion(M, a, b, axis) {
  const r = (i, j) => M[a + i] * M[b + j] + M[a + 4 + i] * M[b + 4 + j] + M[a + 8 + i] * M[b + 8 + j];
  const trace = r(0, 0) + r(1, 1) + r(2, 2), q = [0, 0, 0, 0];
  if (trace > 0) q.splice(0, 4, r(2, 1) - r(1, 2), r(0, 2) - r(2, 0), r(1, 0) - r(0, 1), 1 + trace);
  else {
    let i = r(1, 1) > r(0, 0) ? 1 : 0;
    if (r(2, 2) > r(i, i)) i = 2;
    const j = (i + 1) % 3, k = (i + 2) % 3;
    q[i] = 1 + r(i, i) - r(j, j) - r(k, k);
    q[j] = r(j, i) + r(i, j);
    q[k] = r(k, i) + r(i, k);
    q[3] = r(k, j) - r(j, k);
    if (q[3] < 0) for (let c = 0; c < 4; c++) q[c] = -q[c];
  }
  return 2 * Math.atan2(q[0] * axis[0] + q[1] * axis[1] + q[2] * axis[2], q[3]);
}

/** Rows x, y, z into F (9): y the mixed normal of link k exactly, z as near as can be to the mixed side axis. */
function frame({ y, z }, k, coefficients, i, F) {
  const a = coefficients[i], b = coefficients[i + 1], c = coefficients[i + 2], o = 9 * k;
  let yx = a * y[o] + b * y[o + 3] + c * y[o + 6], yy = a * y[o + 1] + b * y[o + 4] + c * y[o + 7], yz = a * y[o + 2] + b * y[o + 5] + c * y[o + 8];
  let zx = a * z[o] + b * z[o + 3] + c * z[o + 6], zy = a * z[o + 1] + b * z[o + 4] + c * z[o + 7], zz = a * z[o + 2] + b * z[o + 5] + c * z[o + 8];
  const n = 1 / Math.sqrt(yx * yx + yy * yy + yz * yz + 1e-24);
  yx *= n; yy *= n; yz *= n;
  const d = zx * yx + zy * yy + zz * yz;
  zx -= d * yx; zy -= d * yy; zz -= d * yz;
  const m = 1 / Math.sqrt(zx * zx + zy * zy + zz * zz + 1e-24);
  zx *= m; zy *= m; zz *= m;
  F[0] = yy * zz - yz * zy; F[1] = yz * zx - yx * zz; F[2] = yx * zy - yy * zx;
  F[3] = yx; F[4] = yy; F[5] = yz;
  F[6] = zx; F[7] = zy; F[8] = zz;
}

/** The bridge of gap i from one link to the other: where it begins, the way across, and its frame (rows); its length. */
function bridge(p, b, a, i, at, way, F) {
  const one = p.links[2 * i], two = p.links[2 * i + 1], part = a.across[i];
  for (let c = 0; c < 3; c++) {
    at[c] = b.start[3 * one + c] + a.alongs[2 * i] * b.bone[3 * one + c];
    way[c] = b.start[3 * two + c] + a.alongs[2 * i + 1] * b.bone[3 * two + c] - at[c];
  }
  const x = unit([...way]), from = mixed(b.y, one, a.gapCoefficients, 6 * i), to = mixed(b.y, two, a.gapCoefficients, 6 * i + 3);
  const y = square(from.map((f, c) => (1 - part) * f + part * to[c]), x);
  F.set(x);
  F.set(y, 3);
  F.set(cross(x, y), 6);
  return Math.hypot(way[0], way[1], way[2]);
}

const mixed = (y, k, coefficients, i) => unit([0, 1, 2].map((c) => coefficients[i] * y[9 * k + c] + coefficients[i + 1] * y[9 * k + 3 + c] + coefficients[i + 2] * y[9 * k + 6 + c]));
const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const unit = (v) => { const s = 1 / Math.max(Math.hypot(v[0], v[1], v[2]), 1e-12); return [v[0] * s, v[1] * s, v[2] * s]; };
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** The part of v across y, of unit length. */
const square = (v, y) => { const d = v[0] * y[0] + v[1] * y[1] + v[2] * y[2]; return unit(v.map((x, c) => x - d * y[c])); };
