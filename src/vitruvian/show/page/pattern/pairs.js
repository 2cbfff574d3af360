// Panels of the body's two sides: mirrored copies, and pairs that are edited together.

import { add, box, carried, controls, distance, dot, ends, loops, scale, sub, unit } from "./geometry.js";
import { copyDimensions, drawing, fresh, keepDimension, panelOf, renumber, setLength } from "./shaping.js";

const SIDES = { left: "right", right: "left", l: "r", r: "l" };

/** A name for the other side: left_sleeve of right_sleeve. */
export function otherSide(name) {
  const words = name.split("_"), k = words.findIndex((w) => Object.hasOwn(SIDES, w));
  if (k < 0) return null;
  words[k] = SIDES[words[k]];
  return words.join("_");
}

const backwards = (panel) => loops(panel).flatMap((loop) => [...loop].reverse());

/** The outline for the body's other side, from edge e of a panel to edge `to(e)` of the copy: the loops run backwards. */
function reflected(panel) {
  const order = backwards(panel);
  const flip = ([u, v]) => [-u, v];
  return {
    to: (e) => order.indexOf(e),
    vertices: panel.vertices.map(flip),
    edges: order.map((e) => {
      const { ends: [a, b], points, label, ...rest } = panel.edges[e], side = label && (otherSide(label) ?? label);
      return { ...rest, ends: [b, a], ...(points ? { points: points.map(flip).reverse() } : {}), ...(side ? { label: side } : {}) };
    }),
    grain: flip(panel.grain ?? [0, 1]),
  };
}

/** A mirrored copy for the body's other side, and its seams with itself; its name. The two are a pair from then on. */
export function mirrorPanel(doc, name) {
  const panel = panelOf(doc, name), { to, ...shape } = reflected(panel), copy = { ...structuredClone(panel), ...shape };
  copy.name = fresh(doc, otherSide(name) ?? `${name}_mirrored`);
  if (panel.rotation) {
    copy.rotation = panel.rotation.map((row, i) => row.map((x, j) => x * (i === 0 ? -1 : 1) * (j === 0 ? -1 : 1)));
    copy.translation = panel.translation.map((x, i) => (i ? x : -x));
  }
  doc.panels.push(copy);
  copyDimensions(doc, name, copy.name, (e, fix) => [to(e), OTHER[fix]]);
  const across = (s) => [copy.name, to(s[1]), 1 - (s[3] ?? 1), 1 - (s[2] ?? 0)];
  const pairs = drawing(doc).pairs, partner = (n) => (n === name ? copy.name : pairs.find((p) => p.includes(n))?.find((m) => m !== n));
  for (const seam of [...doc.seams]) {
    const spans = [...seam.a, ...seam.b];
    if (!spans.some((s) => s[0] === name) || !spans.every((s) => s[0] === name || partner(s[0]))) continue;
    const side = (list) => list.map((s) => (s[0] === name ? across(s) : acrossTo(doc, s, partner(s[0])))).reverse();
    const made = { ...seam, a: side(seam.a), b: side(seam.b) };
    if (!doc.seams.some((s) => sewn(s, made))) doc.seams.push(made);
  }
  const kept = drawing(doc), [low, high] = box(panel), place = kept.board[name] ?? [0, 0, 0];
  kept.board[copy.name] = [place[0] + (high[0] - low[0]) + 0.06 + high[0] + low[0], place[1], -place[2]];
  if (kept.worn?.[name]) kept.worn[copy.name] = kept.worn[name].map((w) => otherSide(w) ?? w);
  kept.pairs.push([name, copy.name]);
  return copy.name;
}

function acrossTo(doc, s, other) {
  const from = panelOf(doc, s[0]), twin = panelOf(doc, other), found = aligned(from, twin), n = twin.edges.length;
  return [other, (backwards(from).indexOf(s[1]) + (found?.shift ?? 0)) % n, 1 - (s[3] ?? 1), 1 - (s[2] ?? 0)];
}

const sewn = (one, two) => [...one.a, ...one.b].some((s) => [...two.a, ...two.b].some((r) => s[0] === r[0] && s[1] === r[1] && Math.min(s[3], r[3]) - Math.max(s[2], r[2]) > 1e-6));

/** The partner of a panel in a pair that is edited together, or undefined. */
export const partnerOf = (doc, name) => drawing(doc).pairs.find((p) => p.includes(name))?.find((n) => n !== name);

/** Unfold a piece that is cut on the fold: mirror it across a straight edge, which then is no edge any more. */
export function unfold(doc, name, i) {
  const panel = panelOf(doc, name), [a, b] = ends(panel, i), way = unit(sub(b, a)), loop = loops(panel).find((l) => l.includes(i));
  if (panel.edges[i].kind !== "line" || loops(panel).length > 1) return false;
  const flip = (p) => { const d = sub(p, a), s = dot(d, way); return add(a, sub(scale(way, 2 * s), d)); };
  const at = loop.indexOf(i), rest = [...loop.slice(at + 1), ...loop.slice(0, at)], [from, to] = panel.edges[i].ends, twin = new Map([[from, from], [to, to]]);
  const mirror = (v) => { if (!twin.has(v)) twin.set(v, panel.vertices.push(flip(panel.vertices[v])) - 1); return twin.get(v); };
  const half = rest.map((e) => structuredClone(panel.edges[e]));
  const other = [...rest].reverse().map((e) => {
    const { ends: [p, q], points, label, ...more } = panel.edges[e], side = label && (otherSide(label) ?? label);
    return { ...more, ends: [mirror(q), mirror(p)], ...(points ? { points: points.map(flip).reverse() } : {}), ...(side ? { label: side } : {}) };
  });
  panel.edges = [...half, ...other];
  renumber(doc, name, (e, t0, t1) => (e === i ? [] : [[rest.indexOf(e), t0, t1]]));
  return true;
}

// Pairs -------------------------------------------------------------------------------------------------------------

/** The document with all that the editor counts on: spans whole, what it keeps in `extra`, panels beside each other. */
export function clean(doc) {
  for (const seam of doc.seams ??= []) {
    Object.assign(seam, { reversed: seam.reversed ?? true, kind: seam.kind ?? "plain", open: seam.open ?? false });
    for (const side of ["a", "b"]) seam[side] = seam[side].map(([p, e, t0 = 0, t1 = 1]) => [p, e, t0, t1]);
  }
  for (const panel of doc.panels) Object.assign(panel, { label: panel.label ?? "", fabric: panel.fabric ?? "", order: panel.order ?? 0, grain: panel.grain ?? [0, 1] });
  doc.buttons ??= [];
  const kept = drawing(doc);
  layOut(doc, doc.panels.filter((p) => !kept.board[p.name]));
  for (const p of doc.panels) {
    const other = otherSide(p.name), twin = other && p.name < other && panelOf(doc, other);
    if (twin && !partnerOf(doc, p.name) && !partnerOf(doc, other) && aligned(p, twin)) kept.pairs.push([p.name, other]);
  }
  return doc;
}

/** Give panels places on the board, in rows under what lies there. */
export function layOut(doc, panels) {
  const { board } = drawing(doc), gap = 0.06;
  let bottom = 0;
  for (const p of doc.panels) if (board[p.name]) bottom = Math.min(bottom, board[p.name][1] + box(p)[0][1] - 0.1);
  const sizes = panels.map((p) => { const [low, high] = box(p); return { p, low, wide: high[0] - low[0], high: high[1] - low[1] }; });
  const most = Math.max(1.1, Math.sqrt(sizes.reduce((s, b) => s + (b.wide + gap) * (b.high + gap), 0)) * 1.15);
  let x = 0, row = 0;
  for (const { p, low, wide, high } of sizes) {
    if (x && x + wide > most) { x = 0; bottom -= row + gap; row = 0; }
    board[p.name] = [x - low[0], bottom - high - low[1], 0];
    x += wide + gap;
    row = Math.max(row, high);
  }
}

/** Edge and vertex numbers of the mirror image of a panel as the other has them, or null: it is no mirror image. */
function aligned(panel, other) {
  const { vertices, edges } = reflected(panel), n = edges.length;
  if (other.edges.length !== n || loops(panel).length !== 1 || loops(other).length !== 1) return null;
  const at = (p, k) => p.vertices[p.edges[k % n].ends[0]], mine = { vertices, edges };
  for (let shift = 0; shift < n; shift++) {
    const move = sub(at(other, shift), at(mine, 0));
    const same = edges.every((e, k) => {
      const f = other.edges[(k + shift) % n], p = controls(e), q = controls(f);
      return e.kind === f.kind && distance(add(at(mine, k), move), at(other, k + shift)) < 1e-5 && p.every((c, j) => distance(add(c, move), q[j]) < 1e-5);
    });
    if (same) return { shift, move };
  }
  return null;
}

/** Where a panel that is its own mirror image has its middle line, and which corner and edge is the other of which. */
export function halves(panel) {
  const found = aligned(panel, panel);
  if (!found || Math.abs(found.move[1]) > 1e-5) return null;
  const back = backwards(panel), n = back.length, corner = {}, edge = {};
  back.forEach((e, k) => {
    const f = (k + found.shift) % n;
    edge[e] = f;
    corner[panel.edges[e].ends[1]] = panel.edges[f].ends[0];
  });
  return { middle: found.move[0] / 2, corner, edge };
}

/** What was done to one panel of a pair happens to the other too, mirrored; and to the other half of a panel that is its
 * own mirror image. */
export function follow(doc, before) {
  for (const panel of doc.panels) {
    const was = panelOf(before, panel.name);
    if (was && shapeOf(was) !== shapeOf(panel)) balance(panel, was);
  }
  for (const pair of drawing(doc).pairs) {
    const [was, now] = [before, doc].map((d) => pair.map((name) => panelOf(d, name)));
    if (!was.every(Boolean) || !now.every(Boolean)) continue;
    const moved = now.map((p, k) => shapeOf(p) !== shapeOf(was[k]));
    if (moved[0] === moved[1] || !aligned(was[0], was[1])) continue;
    const leader = pair[moved[0] ? 0 : 1], follower = pair[moved[0] ? 1 : 0];
    if (panelOf(doc, leader).edges.length !== panelOf(doc, follower).edges.length) continue;
    mirrorShape(doc, before, leader, follower);
  }
}

const same = (p, q) => JSON.stringify(p) === JSON.stringify(q);

/** Bring the half of a panel that was not touched to the mirror image of the other. */
function balance(panel, was) {
  const topology = (p) => p.edges.map((e) => e.ends), found = same(topology(panel), topology(was)) && halves(was);
  if (!found) return;
  const { middle, corner, edge } = found, flip = ([u, v]) => [2 * middle - u, v];
  const moved = panel.vertices.map((p, v) => !same(p, was.vertices[v])), places = {};
  moved.forEach((yes, v) => {
    if (!yes) return;
    if (corner[v] === v) places[v] = [middle, panel.vertices[v][1]];
    else if (!moved[corner[v]]) places[corner[v]] = flip(panel.vertices[v]);
  });
  if (moved.every((yes, v) => !yes || (moved[corner[v]] && corner[v] !== v))) { if (moved.some(Boolean)) return; } // both halves were meant
  for (const [v, p] of Object.entries(places)) panel.vertices[v] = p;
  panel.edges.forEach((e, i) => {
    const other = panel.edges[edge[i]], [old, twin] = [was.edges[i], was.edges[edge[i]]];
    if (edge[i] === i) {
      if (e.kind !== old.kind || !e.points) return;
      if (e.points.length === 2 && e.ends.every((v) => !moved[v])) {
        const [p, q] = e.points.map((x, k) => !same(x, old.points[k]));
        if (p && !q) e.points[1] = flip(e.points[0]);
        else if (q && !p) e.points[0] = flip(e.points[1]);
      } else if (e.points.length === 1) e.points[0] = [middle, e.points[0][1]];
      if (e.ends.some((v) => moved[v])) e.points = carried(old.points, ...e.ends.map((v) => was.vertices[v]), ...e.ends.map((v) => panel.vertices[v]));
      return;
    }
    const touched = !same([e.kind, e.points], [old.kind, old.points]) || e.ends.some((v) => moved[v] && corner[v] !== v);
    const theirs = !same([other.kind, other.points], [twin.kind, twin.points]) || other.ends.some((v) => moved[v] && corner[v] !== v);
    if (touched && !theirs) { other.kind = e.kind; if (e.points) other.points = e.points.map(flip).reverse(); else delete other.points; }
    else if (!touched && !theirs && e.points && e.ends.some((v) => moved[v])) e.points = carried(old.points, ...e.ends.map((v) => was.vertices[v]), ...e.ends.map((v) => panel.vertices[v]));
  });
}

const shapeOf = (p) => JSON.stringify([p.vertices, p.edges.map((e) => [e.ends, e.kind, e.points]), p.grain]);

/** The shape of one panel for its partner, whose edges keep their numbers and labels. */
function mirrorShape(doc, before, leader, follower) {
  const scratch = { panels: [panelOf(before, leader), panelOf(before, follower)].map((p) => structuredClone(p)), seams: [], extra: {} };
  const found = aligned(scratch.panels[0], scratch.panels[1]), twin = panelOf(doc, follower);
  const { vertices, edges, grain } = reflected(panelOf(doc, leader)), n = edges.length, put = (p) => add(p, found.move);
  twin.vertices = vertices.map(put);
  twin.edges = twin.edges.map((old, k) => {
    const { label: _, ...rest } = edges[(k - found.shift + n) % n];
    return { ...rest, ...(old.label ? { label: old.label } : {}), ...(rest.points ? { points: rest.points.map(put) } : {}) };
  });
  twin.grain = grain;
}

/** Do something to an edge of a panel, and the same to its mirror image, in the partner or in the other half of the panel:
 * `act(name, edge, t)`. */
export function both(doc, name, i, t, symmetric, act) {
  const panel = panelOf(doc, name), other = symmetric && partnerOf(doc, name), twin = other && panelOf(doc, other);
  const half = symmetric && halves(panel), found = twin && aligned(panel, twin), n = panel.edges.length;
  const mirror = half ? half.edge[i] : -1, edges = [[i, t]];
  if (half && mirror !== i) edges.push([mirror, 1 - t]);
  else if (half && Math.abs(t - 0.5) > 0.02) edges.push([i, 1 - t]);
  edges.sort(([e, s], [f, r]) => f - e || r - s); // from the last to the first: the numbers of those before stay
  let answer;
  const run = (of, list) => list.forEach(([e, s], k) => {
    const before = list[k - 1], share = before && before[0] === e ? s / before[1] : s; // what is left of the edge after the cut
    const said = act(of, e, share);
    if (of === name && e === i && s === t) answer = said;
  });
  const theirs = found ? edges.map(([e, s]) => [(backwards(panel).indexOf(e) + found.shift) % n, 1 - s]).sort(([e, s], [f, r]) => f - e || r - s) : [];
  run(name, edges);
  if (found) run(other, theirs);
  return answer;
}

/** An edge and its mirror images, in the partner and in the other half of the panel: [{panel, edge, flipped}];
 * across: the edge is its own mirror image. */
export function twins(doc, name, i, symmetric = true) {
  const panel = panelOf(doc, name), half = symmetric && halves(panel), out = [{ panel: name, edge: i, flipped: false, across: Boolean(half) && half.edge[i] === i }];
  if (half && half.edge[i] !== i) out.push({ panel: name, edge: half.edge[i], flipped: true });
  const other = symmetric && partnerOf(doc, name), twin = other && panelOf(doc, other), found = twin && aligned(panel, twin);
  if (!found) return out;
  const theirs = (e) => (backwards(panel).indexOf(e) + found.shift) % panel.edges.length;
  return [...out, ...out.map((o) => ({ ...o, panel: other, edge: theirs(o.edge), flipped: !o.flipped }))];
}

const OTHER = { start: "end", end: "start", middle: "middle" };

/** Make an edge and its mirror images so long, metres, and keep (a text) or forget (null) the expression that says so. */
export function dimension(doc, name, i, wanted, text, options, symmetric) {
  for (const { panel, edge, flipped, across } of twins(doc, name, i, symmetric)) {
    const own = { ...options, fix: across ? "middle" : flipped ? OTHER[options.fix] : options.fix };
    if (wanted !== null) setLength(panelOf(doc, panel), edge, wanted, own);
    keepDimension(doc, { panel, edge }, text, own);
  }
}
