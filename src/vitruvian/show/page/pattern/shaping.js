// What can be done to the panels of a pattern's document (see formats/pattern_file.py). Each function changes `doc` in
// place; seams, dimensions and partners follow. Metres of the panel's plane.

import { add, along, area, box, carried, controls, cross, cut, distance, dot, ends, length, loops, mix, scale, sub, turned, unit } from "./geometry.js";
import { evaluate } from "./measures.js";

export const panelOf = (doc, name) => doc.panels.find((p) => p.name === name);

/** What the editor keeps in a pattern's `extra`: places on the board, dimensions, pairs of mirrored panels. */
export function drawing(doc) {
  const kept = ((doc.extra ??= {}).drawing ??= {});
  kept.board ??= {};
  kept.dimensions ??= [];
  kept.pairs ??= [];
  return kept;
}

/** A name that no panel has. */
export function fresh(doc, wish) {
  const taken = new Set(doc.panels.map((p) => p.name));
  if (!taken.has(wish)) return wish;
  const stem = wish.replace(/_\d+$/, "");
  for (let n = 2; ; n++) if (!taken.has(`${stem}_${n}`)) return `${stem}_${n}`;
}

const shaped = (edge, { kind, points }) => { edge.kind = kind; if (points) edge.points = points; else delete edge.points; };

// Corners and curves ------------------------------------------------------------------------------------------------

/** Put vertices at new places, {vertex: [u, v]}; the curves beside them are turned and scaled with their chords. */
export function moveVertices(panel, places) {
  for (const edge of panel.edges) {
    const [a, b] = edge.ends;
    if (!edge.points?.length || !(a in places || b in places)) continue;
    const from = [panel.vertices[a], panel.vertices[b]];
    edge.points = carried(edge.points, ...from, places[a] ?? from[0], places[b] ?? from[1]);
  }
  for (const [v, place] of Object.entries(places)) panel.vertices[v] = [...place];
}

/** Say that an edge is straight or which curve it is; it stays as near to what it was as that allows. */
export function setKind(panel, i, kind) {
  const edge = panel.edges[i], [a, b] = ends(panel, i), was = edge.kind, p = controls(edge);
  if (was === kind) return;
  if (kind === "line") { shaped(edge, { kind }); return; }
  const chord = sub(b, a), bulge = scale([chord[1], -chord[0]], 0.12 * (Math.sign(area(panel)) || 1)); // outwards
  const straight = was === "line" || (was === "polyline" && !p.length);
  const middle = straight ? add(mix(a, b, 0.5), bulge) : along(panel, i, [0.5])[0];
  const pull = was === "quadratic" ? p[0] : was === "cubic" ? sub(scale(add(p[0], p[1]), 0.75), scale(add(a, b), 0.25)) : sub(scale(middle, 2), mix(a, b, 0.5));
  if (kind === "arc") shaped(edge, { kind, points: [middle] });
  else if (kind === "quadratic") shaped(edge, { kind, points: [pull] });
  else if (kind === "cubic") shaped(edge, { kind, points: [mix(a, pull, 2 / 3), mix(b, pull, 2 / 3)] });
  else shaped(edge, { kind: "polyline", points: along(panel, i, [0.25, 0.5, 0.75]) });
}

/** All spans of seams, and dimensions, that speak of a panel's edges: `to(edge, t0, t1)` gives the spans instead. */
export function renumber(doc, name, to) {
  for (const seam of doc.seams) {
    for (const side of ["a", "b"]) {
      seam[side] = seam[side].flatMap((s) => (s[0] === name ? to(s[1], s[2] ?? 0, s[3] ?? 1).map((r) => [name, ...r]) : [s]));
      seam[side] = joined(seam[side]);
    }
  }
  doc.seams = doc.seams.filter((s) => s.a.length && s.b.length);
  const kept = drawing(doc);
  kept.dimensions = kept.dimensions.flatMap((d) => {
    if (d.panel !== name || d.edge === undefined) return [d];
    const spans = to(d.edge, 0, 1);
    return spans.length === 1 && spans[0][2] - spans[0][1] > 0.999 ? [{ ...d, edge: spans[0][0] }] : []; // of a part of an edge nothing was said
  });
}

/** Spans that go on where the one before ends are one. */
function joined(side) {
  const out = [];
  for (const s of side) {
    const last = out.at(-1);
    if (last && last[0] === s[0] && last[1] === s[1] && Math.abs(last[3] - s[2]) < 1e-9) last[3] = s[3];
    else out.push([...s]);
  }
  return out;
}

/** Cut an edge at t of its length by a new vertex; its number. What was edge i is then i and i + 1. */
export function addVertex(doc, name, i, t) {
  const panel = panelOf(doc, name), edge = panel.edges[i], { point, before, after } = cut(panel, i, t);
  const v = panel.vertices.push(point) - 1, label = edge.label ? { label: edge.label } : {};
  panel.edges.splice(i, 1, { ends: [edge.ends[0], v], ...before, ...label }, { ends: [v, edge.ends[1]], ...after, ...label });
  renumber(doc, name, (e, t0, t1) => {
    if (e !== i) return [[e > i ? e + 1 : e, t0, t1]];
    const parts = [];
    if (t0 < t) parts.push([i, t0 / t, Math.min(1, t1 / t)]);
    if (t1 > t) parts.push([i + 1, Math.max(0, (t0 - t) / (1 - t)), (t1 - t) / (1 - t)]);
    return parts;
  });
  return v;
}

/** Take a vertex away; its two edges become one. False where too little would be left. */
export function deleteVertex(doc, name, v) {
  const panel = panelOf(doc, name), loop = loops(panel).find((l) => l.some((i) => panel.edges[i].ends[0] === v));
  if (!loop || loop.length <= (loop.every((i) => panel.edges[i].kind === "line") ? 3 : 2)) return false;
  const two = loop.find((i) => panel.edges[i].ends[0] === v), one = loop.find((i) => panel.edges[i].ends[1] === v);
  const [a, b] = [panel.edges[one], panel.edges[two]], start = ends(panel, one)[0], end = ends(panel, two)[1];
  const share = length(panel, one) / (length(panel, one) + length(panel, two)), joint = { kind: "line" };
  if (a.kind !== "line" || b.kind !== "line") { // a cubic that leaves and arrives as they did
    const reach = (length(panel, one) + length(panel, two)) / 3;
    const out = unit(sub(along(panel, one, [0.01])[0], start)), into = unit(sub(along(panel, two, [0.99])[0], end));
    Object.assign(joint, { kind: "cubic", points: [add(start, scale(out, reach)), add(end, scale(into, reach))] });
  }
  const label = a.label === b.label ? a.label : a.label || b.label;
  panel.edges[one] = { ends: [a.ends[0], b.ends[1]], ...joint, ...(label ? { label } : {}) };
  panel.edges.splice(two, 1);
  const shift = (e) => (e > two ? e - 1 : e), at = shift(one);
  renumber(doc, name, (e, t0, t1) => {
    if (e === one) return [[at, t0 * share, t1 * share]];
    if (e === two) return [[at, share + t0 * (1 - share), share + t1 * (1 - share)]];
    return [[shift(e), t0, t1]];
  });
  dropVertex(panel, v);
  return true;
}

function dropVertex(panel, v) {
  if (panel.edges.some((e) => e.ends.includes(v))) return;
  panel.vertices.splice(v, 1);
  for (const e of panel.edges) e.ends = e.ends.map((n) => (n > v ? n - 1 : n));
}

// Lengths -----------------------------------------------------------------------------------------------------------

/** Make an edge `wanted` metres long. `fix`: which of its ends stays, "start", "end" or "middle"; `stretch`: all that lies
 * beyond its ends goes with them, so that a rectangle stays one. Twin of `lengthened` in vitruvian.cloth.dimensions. */
export function setLength(panel, i, wanted, { fix = "start", stretch = true } = {}) {
  const [a, b] = ends(panel, i), now = length(panel, i), chord = sub(b, a), l = Math.hypot(...chord);
  if (!(wanted > 0) || !(now > 0) || !(l > 0) || Math.abs(now - wanted) < 1e-10) return;
  const grown = scale(chord, wanted / now - 1), way = scale(chord, 1 / l);
  const share = { start: [0, 1], middle: [-0.5, 0.5], end: [-1, 0] }[fix], [from, to] = panel.edges[i].ends, places = {};
  panel.vertices.forEach((p, v) => {
    const at = dot(sub(p, a), way);
    const s = v === from ? share[0] : v === to ? share[1] : !stretch ? 0 : at >= l - 1e-6 ? share[1] : at <= 1e-6 ? share[0] : 0;
    if (s) places[v] = add(p, scale(grown, s));
  });
  moveVertices(panel, places);
}

/** Make a panel so wide or high, metres: axis 0 is u, 1 is v. */
export function setExtent(panel, axis, wanted) {
  const [low, high] = box(panel), now = high[axis] - low[axis];
  if (!(wanted > 0) || !(now > 0) || Math.abs(now - wanted) < 1e-10) return;
  const put = (p) => { const q = [...p]; q[axis] = low[axis] + (p[axis] - low[axis]) * (wanted / now); return q; };
  panel.vertices = panel.vertices.map(put);
  for (const e of panel.edges) if (e.points) e.points = e.points.map(put);
}

/** Make all dimensions that are kept with the pattern hold, for a body of these measures. What the doctor says of those
 * that do not: expressions without a value, and dimensions that contradict each other. */
export function applyDimensions(doc, measures) {
  const lines = drawing(doc).dimensions.filter((d) => panelOf(doc, d.panel) && (d.edge === undefined || panelOf(doc, d.panel).edges[d.edge]));
  const value = (d) => { const x = evaluate(d.length, measures) / 100; if (!(x > 0)) throw new Error("a length has to be positive"); return x; };
  for (let pass = 0; pass < 3; pass++) for (const d of lines) { // one may move what another had set
    let wanted;
    try { wanted = value(d); } catch { continue; }
    if (d.edge !== undefined) setLength(panelOf(doc, d.panel), d.edge, wanted, d);
    else setExtent(panelOf(doc, d.panel), d.axis, wanted);
  }
  return lines.flatMap((d) => {
    const panel = panelOf(doc, d.panel), finding = { rule: "", severity: "warning", panel: d.panel, edge: d.edge ?? -1 };
    try {
      const wanted = value(d), [low, high] = box(panel), now = d.edge !== undefined ? length(panel, d.edge) : high[d.axis] - low[d.axis];
      if (Math.abs(now - wanted) < 1e-4) return [];
      const what = d.edge !== undefined ? "length" : d.axis ? "height" : "width";
      return [{ ...finding, message: `its ${what} ${d.length} is ${(100 * wanted).toFixed(1)} cm, but other dimensions make it ${(100 * now).toFixed(1)}: forget one of them` }];
    } catch (error) { return [{ ...finding, message: `${d.length}: ${error.message}` }]; }
  });
}

/** Keep an expression for an edge ({panel, edge}) or an extent ({panel, axis}), or forget it (null). */
export function keepDimension(doc, about, text, options = {}) {
  const kept = drawing(doc), same = (d) => d.panel === about.panel && d.edge === about.edge && d.axis === about.axis;
  kept.dimensions = kept.dimensions.filter((d) => !same(d));
  if (text !== null) kept.dimensions.push({ ...about, length: text, ...options });
}

/** A copy of a panel is as long as the panel; `to(edge)`: the number of its edges there, and which end stays. */
export function copyDimensions(doc, name, copy, to = (edge, fix) => [edge, fix]) {
  const kept = drawing(doc), mine = kept.dimensions.filter((d) => d.panel === name);
  kept.dimensions.push(...mine.map((d) => {
    if (d.edge === undefined) return { ...d, panel: copy };
    const [edge, fix] = to(d.edge, d.fix ?? "start");
    return { ...d, panel: copy, edge, fix };
  }));
}

export const dimensionOf = (doc, panel, edge) => drawing(doc).dimensions.find((d) => d.panel === panel && d.edge === edge);

// Panels ------------------------------------------------------------------------------------------------------------

/** A panel of corners; its place: before the body, at the height of its chest. Its name. */
export function addPanel(doc, corners, wish = "panel") {
  const name = fresh(doc, wish), turn = corners.reduce((s, p, k) => s + cross(p, corners[(k + 1) % corners.length]), 0);
  const round = turn < 0 ? [...corners].reverse() : corners;
  const edges = round.map((_, k) => ({ ends: [k, (k + 1) % round.length], kind: "line" }));
  const panel = { name, label: "body", fabric: "", order: 0, grain: [0, 1], vertices: round.map((p) => [...p]), edges };
  const [low, high] = box(panel), middle = mix(low, high, 0.5);
  panel.vertices = panel.vertices.map((p) => sub(p, middle));
  const before = doc.panels.filter((p) => p.translation?.[0] === 0 && p.translation[1] === 1.15).length; // none hides another
  Object.assign(panel, { rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], translation: [0, 1.15, 0.25 + 0.03 * before] });
  doc.panels.push(panel);
  drawing(doc).board[name] = [...middle, 0];
  return name;
}

export function deletePanel(doc, name) {
  doc.panels = doc.panels.filter((p) => p.name !== name);
  doc.seams = doc.seams.filter((s) => ![...s.a, ...s.b].some((r) => r[0] === name));
  doc.buttons = (doc.buttons ?? []).filter((b) => b.a[0] !== name && b.b[0] !== name);
  const kept = drawing(doc);
  for (const of of ["board", "worn"]) if (kept[of]) delete kept[of][name];
  kept.dimensions = kept.dimensions.filter((d) => d.panel !== name);
  kept.pairs = kept.pairs.filter((p) => !p.includes(name));
}

export function renamePanel(doc, name, wish) {
  const to = wish.trim();
  if (!to || to === name || panelOf(doc, to)) return name;
  panelOf(doc, name).name = to;
  for (const s of doc.seams) for (const r of [...s.a, ...s.b]) if (r[0] === name) r[0] = to;
  for (const b of doc.buttons ?? []) for (const side of [b.a, b.b]) if (side[0] === name) side[0] = to;
  const kept = drawing(doc);
  for (const of of ["board", "worn"]) if (kept[of]?.[name]) { kept[of][to] = kept[of][name]; delete kept[of][name]; }
  for (const d of kept.dimensions) if (d.panel === name) d.panel = to;
  kept.pairs = kept.pairs.map((p) => p.map((n) => (n === name ? to : n)));
  return to;
}

/** A dart at t of an edge: a cut so wide there and so deep into the panel, metres, and the seam that closes it. */
export function addDart(doc, name, i, t, wide, deep) {
  const panel = panelOf(doc, name), long = length(panel, i), half = wide / 2 / long;
  if (!(wide > 0) || !(deep > 0) || wide >= 0.9 * long) return false;
  t = Math.min(1 - half - 0.02, Math.max(half + 0.02, t));
  const [before, mouth, after] = along(panel, i, [t - half, t, t + half]), way = unit(sub(after, before));
  const inward = scale([-way[1], way[0]], Math.sign(area(panel)) || 1), tip = add(mouth, scale(inward, deep));
  addVertex(doc, name, i, t + half);
  const one = addVertex(doc, name, i, (t - half) / (t + half)), two = panel.edges[i + 1].ends[1];
  const v = panel.vertices.push(tip) - 1; // edge i + 1 lies across the dart's mouth now
  renumber(doc, name, (e, t0, t1) => (e === i + 1 ? [] : [[e > i + 1 ? e + 1 : e, t0, t1]]));
  panel.edges.splice(i + 1, 1, { ends: [one, v], kind: "line" }, { ends: [v, two], kind: "line" });
  doc.seams.push({ a: [[name, i + 1, 0, 1]], b: [[name, i + 2, 0, 1]], reversed: true, kind: "dart", open: false });
  return true;
}

/** Turn a panel's shape in its own plane about its middle, radians; the grain stays. */
export function turnShape(panel, angle) {
  const [low, high] = box(panel), middle = mix(low, high, 0.5), put = (p) => add(middle, turned(sub(p, middle), angle));
  panel.vertices = panel.vertices.map(put);
  for (const e of panel.edges) if (e.points) e.points = e.points.map(put);
}
