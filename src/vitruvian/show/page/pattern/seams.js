// Seams: sewing edges together, what a seam is like, and those that are proposed.

import { length, sideLength } from "./geometry.js";
import { panelOf } from "./shaping.js";

export const SEAMS = ["plain", "gather", "ease", "dart", "pleat"];

/** Spans of one side in the order of their loops: one that ends where another starts comes before it. */
function ordered(doc, side) {
  const out = [];
  for (const s of side) {
    const of = (r) => panelOf(doc, r[0]).edges[r[1]].ends, first = out[0];
    if (first && first[0] === s[0] && of(s)[1] === of(first)[0]) out.unshift(s);
    else out.push(s);
  }
  return out;
}

/** Sew one side to another; the number of the seam, -1 where an edge would be sewn to itself. */
export function sew(doc, a, b) {
  if (a.some((s) => b.some((r) => s[0] === r[0] && s[1] === r[1]))) return -1;
  const lengths = [a, b].map((side) => sideLength(doc.panels, side)), ratio = Math.max(...lengths) / Math.max(Math.min(...lengths), 1e-9);
  const dart = a.length === 1 && b.length === 1 && a[0][0] === b[0][0] && meet(panelOf(doc, a[0][0]), a[0][1], b[0][1]);
  doc.seams.push({ a: ordered(doc, a), b: ordered(doc, b), reversed: true, kind: dart ? "dart" : ratio > 1.25 ? "gather" : "plain", open: false });
  return doc.seams.length - 1;
}

const meet = (panel, i, j) => panel.edges[i].ends.some((v) => panel.edges[j].ends.includes(v)) && panel.edges[i].kind === "line" && panel.edges[j].kind === "line" && Math.abs(length(panel, i) - length(panel, j)) < 0.01;

/** The seams that sew an edge. */
export const seamsOf = (doc, name, i) => doc.seams.flatMap((s, k) => ([...s.a, ...s.b].some((r) => r[0] === name && r[1] === i) ? [k] : []));

/** {a, b, differ}: metres of both sides and how much longer b is. */
export function measured(doc, seam) {
  const a = sideLength(doc.panels, seam.a), b = sideLength(doc.panels, seam.b);
  return { a, b, differ: b - a };
}

export const said = (side) => side.map(([panel, edge, t0 = 0, t1 = 1]) => `${panel} ${edge}${t0 > 0 || t1 < 1 ? ` (${Math.round(100 * t0)}\u2013${Math.round(100 * t1)} %)` : ""}`).join(", ");
