// Edges of panels, measured while they are drawn: the same geometry as vitruvian.cloth.pattern, in metres of the panel.

export const KINDS = { line: 0, quadratic: 1, cubic: 2, arc: 1, polyline: null }; // points beside the ends
const CHORDS = 256; // of a Bezier curve, to measure along it

export const add = (p, q) => [p[0] + q[0], p[1] + q[1]];
export const sub = (p, q) => [p[0] - q[0], p[1] - q[1]];
export const scale = (p, s) => [p[0] * s, p[1] * s];
export const mix = (p, q, t) => [p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])];
export const dot = (p, q) => p[0] * q[0] + p[1] * q[1];
export const cross = (p, q) => p[0] * q[1] - p[1] * q[0];
export const size = (p) => Math.hypot(p[0], p[1]);
export const distance = (p, q) => Math.hypot(p[0] - q[0], p[1] - q[1]);
export const unit = (p) => { const l = size(p); return l > 0 ? scale(p, 1 / l) : p; };
export const turned = (p, angle) => { const c = Math.cos(angle), s = Math.sin(angle); return [c * p[0] - s * p[1], s * p[0] + c * p[1]]; };

export function ends(panel, i) {
  const [a, b] = panel.edges[i].ends;
  return [panel.vertices[a], panel.vertices[b]];
}

export const controls = (edge) => edge.points ?? [];

/** Centre, start angle and signed angle of the arc from a through its middle to b; angle 0: a straight line. */
export function arcOf(a, middle, b) {
  const chord = sub(b, a), sag = sub(middle, mix(a, b, 0.5)), width = size(chord);
  const across = [chord[1], -chord[0]]; // to the right of the chord
  const h = width ? dot(sag, across) / width : size(sag);
  if (width && Math.abs(h) < 1e-9 * width) return { center: a, start: 0, angle: 0 };
  if (!width) { // a whole circle
    const center = mix(a, middle, 0.5), way = sub(a, center);
    return { center, start: Math.atan2(way[1], way[0]), angle: 2 * Math.PI };
  }
  const angle = 4 * Math.atan2(2 * h, width), radius = (width * width / 4 + h * h) / (2 * h);
  const center = add(mix(a, b, 0.5), scale(across, (h - radius) / width)), way = sub(a, center);
  return { center, start: Math.atan2(way[1], way[0]), angle };
}

/** Points along a line, polyline or Bezier; chords of the latter. */
function knots(edge, a, b) {
  const all = [a, ...controls(edge), b];
  if (edge.kind === "line" || edge.kind === "polyline") return all;
  const out = new Array(CHORDS + 1), cubic = all.length === 4;
  for (let k = 0; k <= CHORDS; k++) {
    const t = k / CHORDS, r = 1 - t, w = cubic ? [r * r * r, 3 * t * r * r, 3 * t * t * r, t * t * t] : [r * r, 2 * t * r, t * t];
    let x = 0, y = 0;
    for (let j = 0; j < w.length; j++) { x += w[j] * all[j][0]; y += w[j] * all[j][1]; }
    out[k] = [x, y];
  }
  return out;
}

const traces = new WeakMap(); // edge -> what was traced last, for as long as its points are the same ones

/** {points, at}: points along an edge and how far along each is. */
function traced(edge, a, b) {
  const ends = [a, ...controls(edge), b], kept = traces.get(edge);
  if (kept?.kind === edge.kind && kept.ends.length === ends.length && ends.every((p, k) => p[0] === kept.ends[k][0] && p[1] === kept.ends[k][1])) return kept;
  const points = knots(edge, a, b), made = { kind: edge.kind, ends: ends.map((p) => [...p]), points, at: steps(points) };
  traces.set(edge, made);
  return made;
}

function steps(points) {
  const out = [0];
  for (let k = 1; k < points.length; k++) out.push(out[k - 1] + distance(points[k - 1], points[k]));
  return out;
}

/** Metres along an edge of a panel. */
export function length(panel, i) {
  const [a, b] = ends(panel, i), edge = panel.edges[i];
  if (edge.kind === "arc") {
    const { center, angle } = arcOf(a, edge.points[0], b);
    return angle ? distance(a, center) * Math.abs(angle) : distance(a, b);
  }
  return traced(edge, a, b).at.at(-1);
}

/** Points of an edge at each of `ts`, normalised arc length. */
export function along(panel, i, ts) {
  const [a, b] = ends(panel, i), edge = panel.edges[i], clipped = ts.map((t) => Math.min(1, Math.max(0, t)));
  const tip = (t) => (t === 0 ? a : t === 1 ? b : null);
  if (edge.kind === "arc") {
    const { center, start, angle } = arcOf(a, edge.points[0], b), radius = distance(a, center);
    return clipped.map((t) => tip(t) ?? (angle ? [center[0] + radius * Math.cos(start + t * angle), center[1] + radius * Math.sin(start + t * angle)] : mix(a, b, t)));
  }
  const { points, at } = traced(edge, a, b);
  return clipped.map((t) => tip(t) ?? interpolated(points, at, t * at.at(-1)));
}

function interpolated(points, at, wanted) {
  const k = below(at, wanted), span = at[k + 1] - at[k];
  return mix(points[k], points[k + 1], span > 0 ? (wanted - at[k]) / span : 0);
}

/** The last entry but one at most that is not above `value`. */
function below(at, value) {
  let low = 0, high = at.length - 2;
  while (low < high) { const k = (low + high + 1) >> 1; if (at[k] <= value) low = k; else high = k - 1; }
  return low;
}

/** Indices of the edges of each closed loop; one that does not close ends where it breaks off. */
export function loops(panel) {
  const out = [];
  let loop = [];
  panel.edges.forEach((edge, i) => {
    if (loop.length && panel.edges[loop.at(-1)].ends[1] !== edge.ends[0]) { out.push(loop); loop = []; }
    loop.push(i);
    if (edge.ends[1] === panel.edges[loop[0]].ends[0]) { out.push(loop); loop = []; }
  });
  if (loop.length) out.push(loop);
  return out;
}

/** A loop as a polygon with a point at least every `step` metres of each curve; lines stay whole. */
export function outline(panel, loop, step = 0.002) {
  return loop.flatMap((i) => {
    const count = panel.edges[i].kind === "line" ? 1 : Math.max(8, Math.ceil(length(panel, i) / step));
    return along(panel, i, Array.from({ length: count }, (_, k) => k / count));
  });
}

/** Square metres, positive where the outline winds counter-clockwise; holes taken off. */
export function area(panel) {
  const [first = 0, ...holes] = loops(panel).map((loop) => loop.reduce((total, i) => total + swept(panel, i), 0));
  return first - Math.sign(first) * holes.reduce((total, p) => total + Math.abs(p), 0);
}

function swept(panel, i) {
  const [a, b] = ends(panel, i), edge = panel.edges[i];
  if (edge.kind === "arc") {
    const { center, angle } = arcOf(a, edge.points[0], b), r = distance(a, center);
    return 0.5 * cross(a, b) + (angle ? 0.5 * r * r * (angle - Math.sin(angle)) : 0);
  }
  const p = traced(edge, a, b).points;
  return 0.5 * p.slice(1).reduce((total, q, k) => total + cross(p[k], q), 0);
}

/** Where an edge comes nearest to p: {t, point, distance}. */
export function nearest(panel, i, p) {
  const [a, b] = ends(panel, i), edge = panel.edges[i];
  const points = edge.kind === "arc" ? along(panel, i, Array.from({ length: 97 }, (_, k) => k / 96)) : traced(edge, a, b).points, at = steps(points);
  let best = { t: 0, point: a, distance: Infinity };
  for (let k = 0; k + 1 < points.length; k++) {
    const way = sub(points[k + 1], points[k]), l = dot(way, way), s = l > 0 ? Math.min(1, Math.max(0, dot(sub(p, points[k]), way) / l)) : 0;
    const point = mix(points[k], points[k + 1], s), far = distance(p, point);
    if (far < best.distance) best = { t: (at[k] + s * (at[k + 1] - at[k])) / (at.at(-1) || 1), point, distance: far };
  }
  return best;
}

/** An edge cut at t of its length: the point, and {kind, points} of what is before and after it. */
export function cut(panel, i, t) {
  const [a, b] = ends(panel, i), edge = panel.edges[i], all = [a, ...controls(edge), b];
  const piece = (kind, points) => (points.length ? { kind, points } : { kind });
  if (edge.kind === "line") return { point: mix(a, b, t), before: piece("line", []), after: piece("line", []) };
  if (edge.kind === "arc") {
    const [one, point, two] = along(panel, i, [t / 2, t, (1 + t) / 2]);
    return { point, before: piece("arc", [one]), after: piece("arc", [two]) };
  }
  const { points, at } = traced(edge, a, b), wanted = t * at.at(-1), k = below(at, wanted);
  if (edge.kind === "polyline") {
    const [one, two] = [points.slice(1, k + 1), points.slice(k + 1, -1)], kind = (p) => (p.length ? "polyline" : "line");
    return { point: interpolated(points, at, wanted), before: piece(kind(one), one), after: piece(kind(two), two) };
  }
  const span = at[k + 1] - at[k], s = (k + (span > 0 ? (wanted - at[k]) / span : 0)) / CHORDS, before = [], after = [];
  for (let p = all; p.length; p = p.slice(1).map((q, n) => mix(p[n], q, s))) { before.push(p[0]); after.unshift(p.at(-1)); }
  return { point: before.at(-1), before: piece(edge.kind, before.slice(1, -1)), after: piece(edge.kind, after.slice(1, -1)) };
}

/** Points that follow when the chord a b comes to be c d: turned and scaled with it. */
export function carried(points, a, b, c, d) {
  const from = sub(b, a), to = sub(d, c), l = dot(from, from);
  if (l < 1e-18) return points.map((p) => add(c, sub(p, a)));
  const re = dot(from, to) / l, im = cross(from, to) / l;
  return points.map((p) => { const [x, y] = sub(p, a); return [c[0] + re * x - im * y, c[1] + im * x + re * y]; });
}

/** Lowest and highest corner of a panel's outline. */
export function box(panel) {
  const points = loops(panel).flatMap((loop) => outline(panel, loop, 0.01));
  if (!points.length) return [[0, 0], [0, 0]];
  const [us, vs] = [points.map((p) => p[0]), points.map((p) => p[1])];
  return [[Math.min(...us), Math.min(...vs)], [Math.max(...us), Math.max(...vs)]];
}

export function inside(polygon, [x, y]) {
  let odd = false;
  for (let k = 0, j = polygon.length - 1; k < polygon.length; j = k++) {
    const [ax, ay] = polygon[k], [bx, by] = polygon[j];
    if ((ay > y) !== (by > y) && x < ((bx - ax) * (y - ay)) / (by - ay) + ax) odd = !odd;
  }
  return odd;
}

/** Metres along one side of a seam: a list of [panel, edge, from, to]. */
export function sideLength(panels, side) {
  return side.reduce((total, [name, edge, t0 = 0, t1 = 1]) => {
    const panel = panels.find((p) => p.name === name);
    return panel?.edges[edge] ? total + length(panel, edge) * (t1 - t0) : total;
  }, 0);
}

/** Points of one side of a seam at shares `ts` of its length, in the order of its spans. */
export function sidePoints(panels, side, ts) {
  const parts = side.map(([name, edge, t0 = 0, t1 = 1]) => ({ panel: panels.find((p) => p.name === name), edge, t0, t1 })).filter((s) => s.panel?.edges[s.edge]);
  const long = parts.map((s) => length(s.panel, s.edge) * (s.t1 - s.t0)), all = long.reduce((x, y) => x + y, 0);
  return ts.map((t) => {
    let rest = t * all, k = 0;
    while (k + 1 < parts.length && rest > long[k]) rest -= long[k++];
    const s = parts[k];
    if (!s) return null;
    const share = long[k] > 0 ? Math.min(1, rest / long[k]) : 0;
    return { panel: s.panel, point: along(s.panel, s.edge, [s.t0 + share * (s.t1 - s.t0)])[0] };
  });
}
