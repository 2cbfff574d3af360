// Displacers: sliders with numbers, in groups, each and all of them can go back to what the clip gives.

import { el } from "./controls.js";

const ORDER = ["Expressions", "Brows", "Eyes", "Cheeks and nose", "Mouth and jaw", "Other parts of the face", "Other shapes"];
const MOST = 10; // weights that the server takes

/** `on.displace(d, weight or null, key)`, `on.settle()`. */
export class Shapes {
  constructor({ root, filter, count, reset }, on) {
    Object.assign(this, { root, filter, count, reset, on, rows: [] });
    filter.addEventListener("input", () => this.search());
  }

  show(figure) {
    this.figure = figure;
    this.root.replaceChildren();
    this.rows = figure.displacers.map((shape, d) => this.row(shape, d));
    this.count.textContent = this.rows.length ? String(this.rows.length) : "";
    this.groups = [];
    for (const title of ORDER) {
      const these = figure.displacers.flatMap((s, d) => ((s.group ?? ORDER.at(-1)) === title ? [d] : []));
      if (!these.length) continue;
      const group = el("details", "group"), head = el("summary", "", title), active = el("span", "dot");
      group.open = true;
      group.dataset.testid = `shapes-${title.toLowerCase().replaceAll(" ", "-")}`;
      head.append(el("span", "count", String(these.length)), active);
      group.append(head, ...these.map((d) => this.rows[d].box));
      this.groups.push({ group, these, active });
      this.root.append(group);
    }
    if (!this.rows.length) this.root.append(el("p", "where", "This figure has no displacers."));
    this.search();
    this.update();
  }

  row({ name }, d) {
    const box = el("div", "shape"), input = el("input"), value = el("input", "value"), undo = el("button", "undo", "\u00d7");
    const [, side, plain] = name.replace(/_(action|feature|config)$/, "").match(/^([lr]_)?(.*)$/s), text = el("span", "called");
    text.append(el("span", "name", plain.replaceAll("_", " ")));
    text.title = name;
    if (side) text.append(el("b", "side", side[0].toUpperCase()));
    Object.assign(input, { type: "range", min: 0, max: 1, step: 0.01, value: 0 });
    Object.assign(value, { type: "number", min: -MOST, max: MOST, step: 0.05, value: 0 });
    input.dataset.testid = `displacer-${name}`;
    value.dataset.testid = `weight-${name}`;
    undo.dataset.testid = `reset-${name}`;
    input.dataset.tip = `How much of \u201c${name}\u201d`;
    input.dataset.key = "arrows";
    value.dataset.tip = `Weight of \u201c${name}\u201d: 0 not at all, 1 fully, beyond 1 exaggerated`;
    undo.dataset.tip = `Give \u201c${name}\u201d back to the clip`;
    input.setAttribute("aria-label", name);
    value.setAttribute("aria-label", `${name}, as a number`);
    undo.setAttribute("aria-label", `Reset ${name}`);
    input.oninput = () => this.on.displace(d, Number(input.value), `displace ${d}`);
    input.onchange = () => this.on.settle();
    value.onchange = () => {
      const w = Math.min(MOST, Math.max(-MOST, Number(value.value)));
      if (value.value !== "" && Number.isFinite(w)) this.on.displace(d, w);
      this.update(true);
    };
    undo.onclick = () => this.on.displace(d, null);
    box.append(text, input, value, undo);
    return { box, input, value, undo, name };
  }

  /** Put displacer `d` where it can be seen, and flash its row. */
  reveal(d) {
    this.filter.value = "";
    this.search();
    const { box, input } = this.rows[d];
    box.closest(".group").open = true;
    box.scrollIntoView({ block: "center" });
    box.classList.remove("flash");
    void box.offsetWidth; // from the beginning
    box.classList.add("flash");
    input.focus({ preventScroll: true });
  }

  search() {
    const words = this.filter.value.trim().toLowerCase().split(/\s+/);
    this.rows.forEach(({ box, name }) => { box.hidden = !words.every((w) => name.toLowerCase().includes(w)); });
    for (const { group, these } of this.groups ?? []) group.hidden = these.every((d) => this.rows[d].box.hidden);
  }

  update(force = false) {
    if (!this.figure) return;
    const w = this.figure.weights(), { displaced } = this.figure;
    this.rows.forEach(({ input, value, undo, box }, d) => {
      const shown = Number(w[d]).toFixed(2), state = `${shown} ${displaced.has(d)}`;
      if (!force && this.rows[d].state === state && value !== document.activeElement) return;
      this.rows[d].state = state;
      if (input !== document.activeElement || force) input.value = w[d];
      if ((value !== document.activeElement || force) && value.value !== shown) value.value = shown;
      box.style.setProperty("--to", Math.min(1, Math.max(0, w[d])));
      if (undo.disabled === displaced.has(d)) undo.disabled = !displaced.has(d);
    });
    for (const { these, active } of this.groups ?? []) active.classList.toggle("on", these.some((d) => displaced.has(d)));
    this.reset.disabled = !displaced.size;
  }
}
