// Runs the page's functions on panels from stdin, {panels, cuts, lengths, extents, expressions, measures, documents}, and
// prints what they answer, for tests that compare them with Python.
import { readFileSync } from "node:fs";

const from = (name) => import(new URL(`../src/vitruvian/show/page/pattern/${name}`, import.meta.url));
const g = await from("geometry.js"), { evaluate } = await from("measures.js"), s = await from("shaping.js"), pairs = await from("pairs.js");
const asked = JSON.parse(readFileSync(0, "utf8")), copy = (x) => structuredClone(x);
const ts = [0, 0.13, 0.5, 0.77, 1];

const panels = asked.panels.map((p) => ({
  area: g.area(p), lengths: p.edges.map((_, i) => g.length(p, i)), along: p.edges.map((_, i) => g.along(p, i, ts)), loops: g.loops(p),
  outline: g.loops(p).map((loop) => g.outline(p, loop, 0.01)),
}));
const doc = (p) => ({ panels: [copy(p)], seams: [], extra: {} });
const first = (act) => (p) => { const d = doc(p); act(d, p); return d.panels[0]; };
const cut = asked.panels.map(first((d, p) => { for (let i = p.edges.length - 1; i >= 0; i--) s.addVertex(d, p.name, i, 0.37); }));
const longer = asked.panels.map((p) => ["start", "middle", "end"].flatMap((fix) => [true, false].map((stretch) => first((d) => s.setLength(d.panels[0], 1, 0.345, { fix, stretch }))(p))));
const wider = asked.panels.map((p) => [0, 1].map((axis) => first((d) => s.setExtent(d.panels[0], axis, 0.777))(p)));
const mirrored = asked.panels.map((p) => { const d = doc(p); pairs.mirrorPanel(d, p.name); return d.panels[1]; });
const values = asked.expressions.map((e) => { try { return evaluate(e, asked.measures); } catch { return null; } });
const documents = asked.documents.map((d) => { const c = pairs.clean(copy(d)); s.applyDimensions(c, asked.measures); return c; });
console.log(JSON.stringify({ panels, cut, longer, wider, mirrored, values, documents }));
