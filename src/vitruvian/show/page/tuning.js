// The panel of the hands' parameters: which joints, a slider for each parameter, and what is behind them.

import * as THREE from "three";
import { download, el } from "./controls.js";
import { TILT, tune } from "./hands.js";

const $ = (id) => document.getElementById(id);
const FINGERS = ["thumb", "index", "middle", "ring", "pinky"];
const PLACES = ["palm", "knuckle", "middle", "end"]; // joints of a finger, by their number; a thumb has no middle one
const CHOICES = {
  side: [["", "Both"], ["l", "Left"], ["r", "Right"]],
  finger: [["", "All fingers"], ...FINGERS.map((f) => [f, f[0].toUpperCase() + f.slice(1)])],
  place: [["", "All joints"], ["palm", "Palm"], ["knuckle", "Knuckle"], ["middle", "Middle joint"], ["end", "End joint"]],
};
const DEGREES = 180 / Math.PI;
// Number in a link's seven parameters (`tilt`: an angle of its own), label, range, what it does.
const ROWS = [
  ["joint", 0, "Knuckle", 0, 1, "How far the back of a bent joint is pushed out; 1 is the full corner"],
  ["near", 1, "Rounded before", 0, 0.5, "Portion of the bone next to its first joint that is rounded"],
  ["far", 2, "Rounded after", 0, 0.5, "Portion of the bone next to its last joint that is rounded"],
  ["muscle", 3, "Muscle", 0, 1, "How much the palm side of a bent bone swells"],
  ["belly", 4, "Fullest at", 0.2, 0.8, "Where along the bone the muscle swells most"],
  ["arc", 5, "Arc", 0, 1, "How far the back of a bent joint follows a circle; 0 leaves its corner"],
  ["palm", 6, "Inner palm", 0, 1, "How much of the muscle's swelling the inside of the palm takes, on its bones and where they close in"],
  ["tilt", -1, "Flexion axis", -TILT * DEGREES, TILT * DEGREES, "Degrees that the axis the joint bends about is turned about its bone"],
];

/** A state is {rounding (L*7), tilt (L) in radians, plain}; `given` is that of the file. */
export class Tuning {
  constructor(page) {
    Object.assign(this, { page, panel: $("hands-panel"), second: $("hands-second"), reset: $("reset-hands"), save: $("save-hands"), view: $("look-hand") });
    Object.assign(this, { chosen: { side: "", finger: "", place: "" }, seen: 0 });
    const choosers = el("div", "choosers");
    this.selects = Object.fromEntries(Object.entries(CHOICES).map(([name, options]) => {
      const box = el("label", "select"), select = el("select");
      select.append(...options.map(([value, text]) => new Option(text, value)));
      select.dataset.testid = `hands-${name}`;
      select.setAttribute("aria-label", { side: "Hand", finger: "Finger", place: "Joint" }[name]);
      box.dataset.tip = { side: "Whose hand", finger: "Which fingers", place: "Which joints; the palm's are those of the wrist's end" }[name];
      select.onchange = () => { this.chosen[name] = select.value; this.seen = 0; this.update(true); };
      box.append(select);
      choosers.append(box);
      return [name, select];
    }));
    this.about = el("p", "where");
    this.rows = ROWS.map((row) => this.row(row));
    $("hands-rows").replaceChildren(choosers, this.about, ...this.rows.map(({ box }) => box));
    this.panel.addEventListener("toggle", () => this.update(true));
    this.second.onchange = () => this.change({ ...this.state, plain: !this.second.checked });
    this.reset.onclick = () => this.change(this.given);
    this.view.onclick = () => this.look();
    this.save.onclick = () => this.write();
  }

  row([name, index, label, low, high, tip]) {
    const box = el("div", "shape"), input = el("input"), value = el("input", "value"), undo = el("button", "undo", "\u00d7"), step = name === "tilt" ? 1 : 0.01;
    Object.assign(input, { type: "range", min: low, max: high, step });
    Object.assign(value, { type: "number", min: low, max: high, step: 5 * step });
    input.dataset.testid = `hands-${name}`;
    value.dataset.testid = `hands-number-${name}`;
    undo.dataset.testid = `hands-reset-${name}`;
    input.dataset.tip = value.dataset.tip = tip;
    input.dataset.key = "arrows";
    undo.dataset.tip = `Give \u201c${label}\u201d of these joints back`;
    input.setAttribute("aria-label", label);
    value.setAttribute("aria-label", `${label}, as a number`);
    undo.setAttribute("aria-label", `Reset ${label}`);
    const put = (x, key) => this.put(name, index, x, key);
    input.oninput = () => put(Number(input.value), name);
    input.onchange = () => this.page.history.settle();
    value.onchange = () => {
      if (value.value !== "" && Number.isFinite(Number(value.value))) put(Math.min(high, Math.max(low, Number(value.value))));
      this.update(true);
    };
    undo.onclick = () => put(null);
    box.append(el("span", "name", label), input, value, undo);
    return { name, index, low, high, box, input, value, undo };
  }

  show(figure) {
    this.figure = figure;
    const p = figure.skin?.hands;
    this.state = this.given = p ? { rounding: Float64Array.from(p.rounding, (x) => Number(x.toFixed(4))), tilt: new Float64Array(p.near.length), plain: false } : null;
    this.links = p ? linksOf(p, figure) : [];
    this.update(true);
  }

  /** The state of a figure's hands, after a change or when it is taken back. */
  set(state) {
    this.state = state;
    for (const f of [this.figure, this.figure.twin]) if (f?.skin?.hands) tune(f.skin.hands, state);
    this.update();
  }

  /** The links that are chosen, and those that share a joint with them. */
  get some() {
    const { side, finger, place } = this.chosen;
    const own = this.links.filter((l) => (!side || l.side === side) && (!finger || l.finger === finger) && (!place || l.place === place));
    return this.links.filter((l) => own.some((o) => o.joint === l.joint));
  }

  /** One parameter of the chosen links; `x` null: as it was given. */
  put(name, index, x, key) {
    const { rounding, tilt, plain } = this.state, out = { rounding: rounding.slice(), tilt: tilt.slice(), plain };
    for (const { k } of this.some) {
      if (name === "tilt") out.tilt[k] = x === null ? 0 : x / DEGREES;
      else out.rounding[7 * k + index] = x ?? this.given.rounding[7 * k + index];
    }
    this.change(out, key && `hands ${key}`);
  }

  /** Go to a state; changes with the same key are one step to take back. */
  change(state, key) {
    const { page, figure, state: before } = this;
    const put = (to) => {
      this.set(to);
      figure.served = null; // by itself, until the server's surface with these arrives
      page.source.hands(figure.name, this.words(), !to.plain);
      page.refresh(figure);
    };
    put(state);
    page.history.push({ key, undo: () => put(before), redo: () => put(state) });
  }

  /** What scripts may read. */
  get told() { return this.given && { joints: this.some.map((l) => l.joint), words: this.words(), rounded: !this.state.plain }; }

  /** Fly to the chosen joints: to the thumb's side, to the back of the hand, to the palm, in turn. */
  look() {
    const { figure, page } = this, side = this.chosen.side || "l", links = this.some.filter((l) => l.side === side), p = figure.skin.hands;
    if (!links.length) return;
    const at = new THREE.Vector3(), middle = (links.find((l) => l.finger === "middle" && l.place === "knuckle") ?? links[0]).k;
    for (const { k } of links) at.addScaledVector(figure.jointPosition(p.near[k] - 1), 1 / links.length);
    const turn = (v) => figure.turned(p.near[middle] - 1, v.subarray(3 * middle, 3 * middle + 3));
    const way = [turn(p.axis_near).multiplyScalar(side === "l" ? -1 : 1), turn(p.normal_near), turn(p.normal_near).negate()][this.seen++ % 3];
    const root = figure.jointPosition(0), reach = page.explorer.metres(links.length > 4 ? 0.075 : 0.035);
    way.addScaledVector(new THREE.Vector3(at.x - root.x, 0, at.z - root.z).normalize(), 0.3).normalize();
    page.studio.face(at, reach, way);
  }

  /** {joint: words that `Rounding.read` takes} of every link that is not as it was given. */
  words({ rounding, tilt } = this.state) {
    const out = {}, p = this.figure.skin.hands, text = (x) => Number(x.toFixed(5)).toString();
    for (const { k, joint } of this.links) {
      const own = rounding.subarray(7 * k, 7 * k + 7);
      if (!tilt[k] && own.every((x, i) => x === this.given.rounding[7 * k + i])) continue;
      const axis = [...p.axis_near.subarray(3 * k, 3 * k + 3)];
      out[joint] = [...ROWS.filter(([, i]) => i >= 0).flatMap(([name, i]) => [name, text(own[i])]), ...(tilt[k] ? ["axis", ...axis.map(text)] : [])].join(" ");
    }
    return out;
  }

  /** What `--hands` of vitruvian convert and contours reads: these parameters of all links that are not as in the file. */
  write() {
    const words = JSON.stringify(this.words(), null, 1);
    download(new Blob([words], { type: "application/json" }), `${this.page.fileName()}-hands.json`);
  }

  update(force = false) {
    const shown = Boolean(this.given) && this.figure.deformer === "hand";
    this.panel.hidden = this.second.disabled = this.view.disabled = !shown;
    if (!shown) this.reset.disabled = this.save.disabled = true;
    if (!shown || (!force && !this.panel.open)) return;
    const some = this.some, { rounding, tilt, plain } = this.state;
    const odd = some.length === 0, joints = new Set(some.map((l) => l.joint)).size;
    this.about.textContent = odd ? "No such joint: a thumb has no middle one." : joints === 1 ? some[0].joint : `${joints} joints together`;
    for (const { name, index, low, high, box, input, value, undo } of this.rows) {
      const of = (r, t) => some.map(({ k }) => (name === "tilt" ? t[k] * DEGREES : r[7 * k + index])), now = of(rounding, tilt), given = of(this.given.rounding, this.given.tilt);
      const same = now.every((x) => Math.abs(x - now[0]) < 1e-6), mean = odd ? low : now.reduce((a, b) => a + b, 0) / now.length;
      input.disabled = value.disabled = odd || (plain && ["joint", "muscle", "belly", "arc", "palm"].includes(name));
      if (input !== document.activeElement || force) input.value = mean;
      if (value !== document.activeElement || force) value.value = same && !odd ? mean.toFixed(name === "tilt" ? 0 : 2).replace(/^-0$/, "0") : "";
      value.placeholder = odd ? "" : "various";
      const at = (x) => Math.min(1, Math.max(0, (x - low) / (high - low)));
      box.style.setProperty("--from", at(Math.min(mean, name === "tilt" ? 0 : low)));
      box.style.setProperty("--to", at(Math.max(mean, name === "tilt" ? 0 : low)));
      undo.disabled = now.every((x, i) => x === given[i]);
    }
    this.second.checked = !plain;
    this.save.disabled = !Object.keys(this.words()).length;
    this.reset.disabled = !plain && this.save.disabled;
  }
}

/** {k, joint, side, finger, place} of each link: its number, the joint that it begins at, and what people call it. */
function linksOf(p, figure) {
  const known = (j) => (figure.otherNames[j]?.[0] === "2.0" ? figure.otherNames[j][1] : figure.joints[j]);
  const depth = [];
  return [...p.near.keys()].map((k) => {
    depth[k] = p.previous[k] ? depth[p.previous[k] - 1] + 1 : 0;
    const near = known(p.near[k] - 1), far = p.far[k] ? known(p.far[k] - 1) : near; // links of the palm may begin at the wrist
    const ray = Number((near.match(/_(\d)$/) ?? far.match(/_(\d)$/))?.[1] ?? 1);
    const last = !p.far[k] && depth[k] > 1;
    return { k, joint: figure.joints[p.near[k] - 1], side: near[0], finger: FINGERS[ray - 1], place: last ? "end" : PLACES[depth[k]] };
  });
}
