// One pose under several deformers side by side, each with its numbers. The columns share the room, the camera and what
// is drawn over the figure; each has a surface of its own.

import { el } from "./controls.js";
import { FIELDS, Gauge, turnedJoints } from "./gauge.js";
import { meshNormals } from "./mesh.js";
import { DEFORMERS, able, run } from "./operators.js";
import { placesOn } from "./stripes.js";

const FIRST = ["linear", "log", "volume", "contours"]; // of those that the figure is able to
const WIDEST = 6; // columns
export const WORDS = {
  linear: "linear", "dual-quaternion": "dual quaternion", log: "log-matrix", "log-pair": "log, pairwise", "log-absolute": "log, as published", hybrid: "hybrid",
  volume: "volume, no bulge", hand: "hands", contours: "contours",
};
// Labels, how a number is written, what makes it red (the same as on the sheets of `vitruvian render --compare`), what it
// says, and how far it is from what one wants.
const SHOWN = {
  volume: ["volume", (v) => v.toFixed(3), (v) => Math.abs(v - 1) > 0.03, "Enclosed volume over that at rest", (v) => Math.abs(v - 1)],
  area: ["least area", (v) => v.toFixed(2), (v) => v < 0.95, "Smallest section round a joint over its area at rest", (v) => -v],
  thickness: ["thickness", (v) => v.toFixed(2), (v) => v < 0.95, "Least distance of opposite points of a section over that at rest", (v) => -v],
  bulge: ["bulge", (v) => v.toFixed(2), (v) => v > 1.05, "How far the surface moves away from the bent bones; 1 is not at all", (v) => v],
  folds: ["folds", (v) => String(v), (v) => v > 0, "Triangles that face the wrong way", (v) => v],
  gap: ["seam gap", (v) => `${(1000 * v).toFixed(2)} mm`, (v) => v > 1e-5, "How far points come apart that lie at one place at rest", (v) => v],
};

class Column {
  constructor(name, body) {
    Object.assign(this, { name, body, shapes: new Map(), numbers: null });
    this.positions = new Float32Array(3 * body.skin.V);
    this.normals = new Float32Array(3 * body.skin.V);
  }

  /** Deform: all of the surface, or, while it plays on a slow machine, the coarser one that the figure draws. */
  pose(pose, weights, coarse) {
    const { body } = this;
    if (coarse) {
      const { source, triangles, groups, uv, skin } = coarse, { geometry } = this.shape(coarse, source, triangles, groups, uv), { position, normal } = geometry.attributes;
      run(this.name, skin, pose, weights, position.array, normal.array);
      position.needsUpdate = normal.needsUpdate = true;
      this.whole = false;
      return;
    }
    this.deform(pose, weights);
    const { geometry } = this.shape(null, body.source, body.triangles, body.parts, body.uv), { position, normal } = geometry.attributes, { same, faces } = body.gauge;
    meshNormals(this.positions, faces, same, this.normals);
    for (let i = 0, k = 0; i < body.source.length; i++, k += 3) for (let c = 0, s = 3 * body.source[i]; c < 3; c++) {
      position.array[k + c] = this.positions[s + c];
      normal.array[k + c] = this.normals[s + c];
    }
    position.needsUpdate = normal.needsUpdate = true;
  }

  /** All of the surface, for the numbers. */
  deform(pose, weights) {
    run(this.name, this.body.skin, pose, weights, this.positions, this.normals);
    this.whole = true;
  }

  shape(key, source, triangles, groups, uv) {
    if (!this.shapes.has(key)) this.shapes.set(key, { geometry: this.body.shape(source, triangles, groups, uv), source });
    return (this.now = this.shapes.get(key));
  }

  /** Let the figure look like this column; `mode` as for `Figure.paint`. */
  wear(figure, mode, joint) {
    const { body, now } = this;
    if (!now) return;
    if (now.mode !== mode || now.joint !== joint) Object.assign(now, { mode, joint, material: body.dress(now.geometry, now.source, mode, joint) });
    figure.mesh.geometry = now.geometry;
    figure.mesh.material = now.material;
    if (figure.edges) figure.edges.visible = figure.edges.userData.on && body === figure && now === this.shapes.get(null);
    if (figure.edges?.visible) figure.edges.geometry.setAttribute("position", now.geometry.attributes.position);
  }

  dispose() { for (const { geometry } of this.shapes.values()) geometry.dispose(); }
}

export class Compare {
  /** `root`: where columns go; `page`: whose figure, selection and mode they follow. */
  constructor(root, page) {
    Object.assign(this, { root, page, on: false, names: [], columns: [], measured: 0, due: false });
  }

  /** The body that a deformer needs: the figure's, or its twin's that was sliced into contours; null for none. */
  body(name) {
    const { figure } = this.page;
    if (!figure?.isBody || !figure.triangles.length) return null;
    return [figure, figure.twin].find((f) => f && able(name, f.skin)) ?? null;
  }

  get able() { return DEFORMERS.filter((n) => this.body(n)); }

  /** Show columns of these deformers; those that the figure is not able to are left out. */
  open(names = this.names.length ? this.names : FIRST) {
    const all = this.able;
    if (!all.length) return;
    this.names = [...new Set(names)].filter((n) => all.includes(n)).slice(0, WIDEST);
    if (!this.names.length) this.names = all.slice(0, 1);
    this.on = true;
    this.build();
  }

  close() {
    this.on = false;
    this.build();
  }

  build() {
    const { page, root } = this, old = new Map(this.columns.map((c) => [c.name, c]));
    root.hidden = !this.on;
    this.columns = this.on ? this.names.map((n) => old.get(n) ?? new Column(n, this.body(n))) : [];
    for (const c of this.columns) {
      old.delete(c.name);
      c.body.gauge ??= new Gauge(c.body.skin);
      if (c.body !== page.figure) c.body.limbs ??= placesOn(page.figure.skin, c.body.rest);
    }
    for (const c of old.values()) c.dispose();
    root.replaceChildren(...this.columns.map((c, i) => this.card(c, i)));
    root.style.setProperty("--columns", String(this.columns.length));
    this.place();
    page.looks();
    page.remember();
    this.due = true;
    page.changed = true;
  }

  card(column, i) {
    const card = el("section", "column"), head = el("header"), view = el("div", "view"), select = el("select"), box = el("label", "select");
    card.setAttribute("aria-label", WORDS[column.name]);
    card.dataset.testid = `compare-${column.name}`;
    select.append(...this.able.map((n) => new Option(WORDS[n], n)));
    select.value = column.name;
    select.dataset.testid = `compare-choose-${i + 1}`;
    select.setAttribute("aria-label", `Deformer of column ${i + 1}`);
    select.dataset.tip = "Another deformer in this column";
    select.onchange = () => { this.names = this.swapped(i, select.value); this.build(); this.focus(`compare-choose-${i + 1}`); };
    box.append(select);
    head.append(box);
    const rest = this.able.filter((n) => !this.names.includes(n));
    if (i === this.columns.length - 1 && rest.length && this.columns.length < WIDEST) head.append(this.button("+", "compare-add", "One more deformer", () => { this.names.push(rest[0]); this.build(); this.focus("compare-add"); }));
    if (this.columns.length > 1) head.append(this.button("\u00d7", `compare-remove-${i + 1}`, "Close this column", () => { this.names.splice(i, 1); this.build(); this.focus("compare-choose-1"); }));
    const list = el("dl");
    list.dataset.testid = `quality-${column.name}`;
    column.title = el("p", "about", "");
    column.values = Object.fromEntries(Object.entries(SHOWN).map(([field, [label, , , tip]]) => {
      const term = el("dt", "", label), value = el("dd", "", "\u2013");
      term.dataset.tip = tip;
      value.dataset.testid = `quality-${column.name}-${field}`;
      list.append(term, value);
      return [field, value];
    }));
    column.view = view;
    const numbers = el("div", "numbers");
    numbers.append(column.title, list);
    card.append(head, view, numbers);
    return card;
  }

  button(text, testid, tip, act) {
    const b = el("button", "", text);
    b.dataset.testid = testid;
    b.dataset.tip = tip;
    b.setAttribute("aria-label", tip);
    b.onclick = act;
    return b;
  }

  focus(testid) { this.root.querySelector(`[data-testid="${testid}"]`)?.focus(); }

  /** The names with `name` in place i; if another column has it, the two change places. */
  swapped(i, name) {
    const out = [...this.names], other = out.indexOf(name);
    if (other >= 0) out[other] = out[i];
    out[i] = name;
    return out;
  }

  /** Tell the studio where the columns are. */
  place() {
    const { studio } = this.page;
    studio.divide(this.on ? this.columns.map((c) => {
      const { left, top, width, height } = c.view.getBoundingClientRect();
      return { x: left, y: top, w: width, h: height, wear: () => { const { figure, mode, selected } = this.page; c.wear(figure, mode, Math.max(0, selected)); } };
    }) : null);
  }

  /** Weights of the displacers of the figure in the order of `body`. */
  weights(body) {
    const { figure } = this.page, own = figure.weights();
    return body === figure ? own : body.displacers.map((d) => own[figure.displacers.findIndex((o) => o.name === d.name)] ?? 0);
  }

  /** The pose or the figure has changed: deform again. */
  update() {
    const { figure } = this.page;
    if (!this.on) return;
    const pose = figure.matrices();
    for (const c of this.columns) c.pose(pose, this.weights(c.body), c.body === figure ? figure.coarse : null);
    this.due = true;
  }

  /** Measure when it is time to: soon after a change, less often while it plays. */
  tick(now, playing) {
    if (!this.on || !this.due || now - this.measured < (playing ? 600 : 90)) return;
    this.due = false;
    this.measure();
    this.measured = performance.now();
  }

  measure() {
    const { figure, selected } = this.page, pose = figure.matrices(), compasses = new Map();
    const joints = turnedJoints(pose, figure.parents), all = selected >= 0 && !joints.includes(selected) ? [...joints, selected] : joints;
    for (const c of this.columns) {
      const { gauge } = c.body;
      if (!c.whole) c.deform(pose, this.weights(c.body));
      if (!compasses.has(c.body)) compasses.set(c.body, gauge.compass(pose));
      const { whole, joints: found } = gauge.measure(c.positions, pose, all, gauge.against(c.positions, compasses.get(c.body)));
      const round = selected >= 0 ? found.get(selected) : null;
      c.numbers = { whole, joints: Object.fromEntries([...found].map(([j, q]) => [figure.joints[j], q])), shown: round ?? whole };
    }
    for (const c of this.columns) {
      const round = selected >= 0 && c.numbers.shown !== c.numbers.whole;
      c.title.textContent = round ? `Round ${figure.joints[selected]}` : "Whole figure";
    }
    for (const [field, [, write, bad, , cost]] of Object.entries(SHOWN)) {
      const values = this.columns.map((c) => c.numbers.shown[field]), costs = values.map((v) => (Number.isFinite(v) ? Number(cost(Number(v.toFixed(5))).toFixed(3)) : Infinity));
      const least = Math.min(...costs), tells = costs.some((x) => x > least);
      this.columns.forEach((c, i) => {
        const known = Number.isFinite(values[i]), cell = c.values[field];
        cell.textContent = known ? write(values[i]) : "\u2013";
        cell.classList.toggle("bad", known && bad(values[i]));
        cell.classList.toggle("best", tells && known && costs[i] === least);
      });
    }
  }

  /** What tests and scripts may read: [{deformer, whole, joints}]. */
  get report() { return this.columns.map(({ name, numbers }) => ({ deformer: name, whole: pick(numbers?.whole), joints: numbers?.joints ?? {} })); }
}

const pick = (numbers) => numbers && Object.fromEntries(FIELDS.map((f) => [f, numbers[f]]));
