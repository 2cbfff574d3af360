// The panels: joint tree with sliders, displacers, findings. Names from files go in as text, never as markup.

import { multiply3, transpose3 } from "./deform.js";
import { angles, fromAngles, fromQuaternion, localRotation } from "./pose.js";

const DEGREES = 180 / Math.PI;
const el = (tag, className = "", text = "") => {
  const e = document.createElement(tag);
  if (className) e.className = className;
  if (text) e.textContent = text;
  return e;
};

/** Rows for every joint of `figure` in the tree; `on.select(j)`, `on.turn(j, rotation or null, key)`. */
export class JointTree {
  constructor(root, filter, on) {
    Object.assign(this, { root, filter, on, rows: [], selected: -1 });
    filter.addEventListener("input", () => this.search());
  }

  show(figure) {
    this.figure = figure;
    this.selected = -1;
    this.root.replaceChildren();
    const children = figure.joints.map(() => []);
    figure.parents.forEach((p, j) => { if (p >= 0) children[p].push(j); });
    this.rows = figure.joints.map((name, j) => this.row(name, j, children[j].length === 0));
    figure.parents.forEach((p, j) => (p < 0 ? this.root : this.rows[p].list).append(this.rows[j].item));
    figure.parents.forEach((p, j) => { if (this.depth(j) < 3) this.rows[j].item.classList.add("unfolded"); });
  }

  depth(j) { let d = 0; for (let p = this.figure.parents[j]; p >= 0; p = this.figure.parents[p]) d++; return d; }

  row(name, j, leaf) {
    const item = el("li", leaf ? "joint leaf" : "joint"), row = el("div", "row"), fold = el("button", "fold"), list = el("ul");
    item.setAttribute("role", "treeitem");
    item.dataset.testid = `joint-${name}`;
    item.style.setProperty("--depth", Math.min(this.depth(j), 12) ? 1 : 0);
    list.style.paddingLeft = "7px";
    fold.setAttribute("aria-label", `Fold ${name}`);
    fold.tabIndex = -1;
    fold.onclick = (e) => { e.stopPropagation(); item.classList.toggle("unfolded"); };
    row.append(fold, el("span", "", name), el("span", "dot"));
    row.tabIndex = 0;
    row.onclick = () => this.on.select(this.selected === j ? -1 : j);
    row.onkeydown = (e) => { if (e.key === "Enter") row.onclick(); };
    const sliders = el("div", "sliders"), inputs = ["x", "y", "z"].map((axis, a) => this.slider(name, j, axis, a, sliders));
    item.append(row, sliders, list);
    return { item, list, inputs };
  }

  slider(name, j, axis, a, parent) {
    const { limits } = this.figure, box = el("label", "slider"), input = el("input"), value = el("span", "value");
    const low = limits[6 * j + 2 * a], high = limits[6 * j + 2 * a + 1], bounded = Number.isFinite(low) && Number.isFinite(high);
    Object.assign(input, { type: "range", min: bounded ? (low * DEGREES).toFixed(1) : -180, max: bounded ? (high * DEGREES).toFixed(1) : 180, step: 0.1, value: 0 });
    input.dataset.testid = `slider-${name}-${axis}`;
    input.dataset.tip = `Turn ${name} about its ${axis} axis, in degrees${bounded ? " (limits of the file)" : ""}`;
    input.dataset.key = "arrows";
    input.setAttribute("aria-label", `${name} ${axis}, degrees`);
    input.oninput = () => this.turn(j, a, Number(input.value));
    input.onchange = () => this.on.settle();
    box.append(el("span", "axis", axis.toUpperCase()), input, value);
    parent.append(box);
    return { input, value };
  }

  /** The frame in which joint j's angles are measured (9): its limit orientation. */
  frame(j) {
    const o = this.figure.limitOrientation;
    return fromQuaternion(o ? [o[4 * j], o[4 * j + 1], o[4 * j + 2], o[4 * j + 3]] : [0, 0, 0, 1]);
  }

  angles(j, pose = this.figure.pose) {
    const F = this.frame(j), R = localRotation(pose, this.figure.parents, j);
    return angles(multiply3(multiply3(transpose3(F), R), F)).map((x) => x * DEGREES);
  }

  /** The slider of axis `a` was moved to `degrees`: what must be added to the clip's rotation to get there. */
  turn(j, a, degrees) {
    const wanted = this.wanted?.j === j ? this.wanted.angles : this.angles(j);
    wanted[a] = degrees;
    this.wanted = { j, angles: wanted };
    const F = this.frame(j), R = multiply3(multiply3(F, fromAngles(wanted.map((x) => x / DEGREES))), transpose3(F));
    const clip = localRotation(this.figure.clip, this.figure.parents, j);
    this.on.turn(j, multiply3(R, transpose3(clip)), `turn ${j} ${a}`);
  }

  select(j) {
    this.rows[this.selected]?.item.classList.remove("selected");
    this.selected = j;
    this.wanted = null;
    const row = this.rows[j];
    if (!row) return;
    row.item.classList.add("selected");
    for (let p = this.figure.parents[j]; p >= 0; p = this.figure.parents[p]) this.rows[p].item.classList.add("unfolded");
    this.update();
    row.item.scrollIntoView({ block: "nearest" });
  }

  /** Sliders of the selected joint and marks of turned ones, from the present pose. */
  update(force = false) {
    if (!this.figure) return;
    const row = this.rows[this.selected];
    if (row) {
      const now = !force && this.wanted?.j === this.selected && row.inputs.some(({ input }) => input === document.activeElement) ? this.wanted.angles : this.angles(this.selected);
      row.inputs.forEach(({ input, value }, a) => {
        if (input !== document.activeElement || force || !this.wanted) input.value = now[a];
        value.textContent = `${now[a].toFixed(1)}\u00b0`;
        const span = input.max - input.min || 1;
        input.style.setProperty("--fill", `${(100 * (input.value - input.min)) / span}%`);
      });
    }
  }

  marks() { this.rows.forEach(({ item }, j) => item.classList.toggle("turned", this.figure.turns.has(j))); }

  search() {
    const text = this.filter.value.trim().toLowerCase(), { joints, parents } = this.figure;
    const keep = joints.map((n) => !text || n.toLowerCase().includes(text));
    for (let j = joints.length - 1; j >= 0; j--) if (keep[j] && parents[j] >= 0) keep[parents[j]] = true;
    this.rows.forEach(({ item }, j) => { item.classList.toggle("away", !keep[j]); if (text && keep[j]) item.classList.add("unfolded"); });
  }
}

/** One slider per displacer; `on.displace(d, weight, key)`, `on.settle()`. */
export class Shapes {
  constructor(root, on) { Object.assign(this, { root, on, rows: [] }); }

  show(figure) {
    this.figure = figure;
    this.root.replaceChildren();
    this.rows = figure.displacers.map(({ name }, d) => {
      const box = el("label", "shape"), input = el("input"), value = el("span", "value"), text = el("span", "", name.replace(/_action$/, "").replaceAll("_", " "));
      Object.assign(input, { type: "range", min: 0, max: 1, step: 0.01, value: 0 });
      input.dataset.testid = `displacer-${name}`;
      input.dataset.tip = `How much of \u201c${name}\u201d`;
      input.dataset.key = "arrows";
      input.oninput = () => this.on.displace(d, Number(input.value), `displace ${d}`);
      input.onchange = () => this.on.settle();
      box.append(text, input, value);
      this.root.append(box);
      return { input, value };
    });
    if (!this.rows.length) this.root.append(el("p", "where", "This figure has no displacers."));
  }

  update() {
    if (!this.figure) return;
    const w = this.figure.weights();
    this.rows.forEach(({ input, value }, d) => {
      if (input !== document.activeElement) input.value = w[d];
      value.textContent = Number(w[d]).toFixed(2);
      input.style.setProperty("--fill", `${100 * input.value}%`);
    });
  }
}

/** The findings of the doctor; a click on one that names a joint selects it. */
export function showFindings(root, count, findings, joints, select) {
  root.replaceChildren();
  count.textContent = findings.length ? `(${findings.length})` : "";
  if (!findings.length) root.append(el("li", "none", "Nothing to report."));
  for (const f of findings) {
    const severity = ["error", "warning", "note"].includes(f.severity) ? f.severity : "note";
    const item = el("li", severity), joint = joints.findIndex((n) => String(f.where ?? "").split(/[^\w]+/).includes(n));
    item.append(el("p", "", f.message ?? f.rule ?? ""));
    const where = [f.severity, f.rule, f.where, f.line ? `line ${f.line}` : ""].filter(Boolean).join(" \u00b7 ");
    item.append(el("div", "where", where));
    if (f.fix) item.append(el("div", "where", f.fix));
    if (joint >= 0) { item.classList.add("link"); item.onclick = () => select(joint); }
    root.append(item);
  }
}
