// What is known about the selected joint, and the sliders that turn it.

import { multiply3, transpose3 } from "./deform.js";
import { angles, fromAngles, fromQuaternion, localRotation } from "./pose.js";
import { chip, el } from "./controls.js";

const DEGREES = 180 / Math.PI;
const AXES = ["x", "y", "z"];
const SLACK = 0.05; // degrees beyond a limit that rounding makes
const AT_ONCE = 400; // joints whose sliders are made before they are asked for

/** `on.turn(j, rotation or null, key)`, `on.settle()`, `on.site(s)`, `on.shape(d)`, `on.select(j)`, `on.finding(n)`. */
export class Details {
  constructor({ card, name, other, sliders, facts, things, free }, on) {
    Object.assign(this, { card, name, other, sliders, facts, things, free, on, rows: [], selected: -1 });
    free.addEventListener("change", () => { for (const row of this.rows) if (row) this.bounds(row); this.update(true); });
  }

  show(figure) {
    this.figure = figure;
    this.rows = new Array(figure.joints.length).fill(null);
    this.sliders.replaceChildren();
    for (let j = 0; j < Math.min(AT_ONCE, this.rows.length); j++) this.row(j);
    this.select(-1);
  }

  /** The sliders of joint j. */
  row(j) {
    if (this.rows[j]) return this.rows[j];
    const box = el("div", "sliders"), inputs = AXES.map((axis, a) => this.slider(this.figure.joints[j], j, axis, a, box));
    box.hidden = true;
    this.sliders.append(box);
    this.rows[j] = { j, box, inputs };
    this.bounds(this.rows[j]);
    return this.rows[j];
  }

  /** Limits of axis `a` in degrees, null when it is free. */
  limit(j, a) {
    const { limits } = this.figure, low = limits?.[6 * j + 2 * a], high = limits?.[6 * j + 2 * a + 1];
    return Number.isFinite(low) && Number.isFinite(high) ? [low * DEGREES, high * DEGREES] : null;
  }

  slider(name, j, axis, a, parent) {
    const box = el("div", `slider axis-${axis}`), input = el("input"), value = el("input", "value"), limit = this.limit(j, a);
    const said = limit ? `${limit[0].toFixed(0)}\u00b0 to ${limit[1].toFixed(0)}\u00b0` : "no limits in the file";
    Object.assign(input, { type: "range", step: 0.1, value: 0 });
    Object.assign(value, { type: "number", step: 0.1, value: 0 });
    input.dataset.testid = `slider-${name}-${axis}`;
    value.dataset.testid = `angle-${name}-${axis}`;
    input.dataset.tip = `Turn ${name} about its ${axis} axis, in degrees (${said})`;
    input.dataset.key = "arrows";
    value.dataset.tip = `Degrees about the ${axis} axis (${said})`;
    input.setAttribute("aria-label", `${name} ${axis}, degrees`);
    value.setAttribute("aria-label", `${name} ${axis}, degrees, as a number`);
    input.oninput = () => this.turn(j, a, Number(input.value));
    value.onchange = () => { if (value.value !== "" && Number.isFinite(Number(value.value))) this.turn(j, a, Number(value.value)); this.on.settle(); this.update(true); };
    input.onchange = () => this.on.settle();
    const ends = el("span", "ends", limit ? `${limit[0].toFixed(0)}\u2026${limit[1].toFixed(0)}\u00b0` : "free");
    box.append(el("span", "axis", axis.toUpperCase()), input, value, ends);
    parent.append(box);
    return { box, input, value };
  }

  /** Put the ends of the sliders where the limits are, or at half a turn when they are ignored. */
  bounds({ j, inputs }) {
    inputs.forEach(({ input, box }, a) => {
      const limit = this.limit(j, a), open = !limit || this.free.checked, low = open ? -180 : limit[0], high = open ? 180 : limit[1];
      input.min = low.toFixed(1);
      input.max = high.toFixed(1);
      const place = (x) => Math.min(1, Math.max(0, (x - low) / (high - low || 1)));
      box.style.setProperty("--low", limit ? place(limit[0]) : 0);
      box.style.setProperty("--high", limit ? place(limit[1]) : 1);
      box.classList.toggle("open", Boolean(limit) && this.free.checked);
    });
  }

  /** The frame in which joint j's angles are measured (9): its limit orientation. */
  frame(j) {
    const o = this.figure.limitOrientation;
    return fromQuaternion(o ? [o[4 * j], o[4 * j + 1], o[4 * j + 2], o[4 * j + 3]] : [0, 0, 0, 1]);
  }

  /** Degrees about the three axes, in the present pose. */
  angles(j, pose = this.figure.pose) {
    const F = this.frame(j), R = localRotation(pose, this.figure.parents, j);
    return angles(multiply3(multiply3(transpose3(F), R), F)).map((x) => x * DEGREES);
  }

  /** The axis `a` goes to `degrees`, no further than its limits: what must be added to the clip's rotation to get there. */
  turn(j, a, degrees) {
    const wanted = this.wanted?.j === j ? this.wanted.angles : this.angles(j), limit = this.free.checked ? null : this.limit(j, a);
    wanted[a] = limit ? Math.min(limit[1], Math.max(limit[0], degrees)) : degrees;
    this.wanted = { j, angles: wanted };
    const F = this.frame(j), R = multiply3(multiply3(F, fromAngles(wanted.map((x) => x / DEGREES))), transpose3(F));
    const clip = localRotation(this.figure.clip, this.figure.parents, j);
    this.on.turn(j, multiply3(R, transpose3(clip)), `turn ${j} ${a}`);
  }

  select(j) {
    if (this.rows[this.selected]) this.rows[this.selected].box.hidden = true;
    this.selected = j;
    this.wanted = null;
    this.card.hidden = j < 0;
    if (j < 0) return;
    this.row(j).box.hidden = false;
    this.describe(j);
    this.update(true);
  }

  describe(j) {
    const f = this.figure, [version, called] = f.otherNames[j] ?? [], number = (x) => Number(x.toFixed(4)).toString();
    this.name.textContent = f.joints[j];
    this.name.title = f.joints[j];
    this.other.textContent = !version ? "not a name of the standard" : called === f.joints[j] ? `the same name in H-Anim ${version}` : called ? `${called} in H-Anim ${version}` : `not in H-Anim ${version}`;
    const rows = [], fact = (name, value, tip) => { rows.push(el("dt", "", name), value instanceof Node ? wrap("dd", value) : el("dd", "", value)); if (tip) rows.at(-1).dataset.tip = tip; };
    const above = f.above[j];
    fact("Segment", f.segments[j]?.join(", ") || "none", "The body part that this joint moves");
    if (above >= 0) fact("Parent", chip(f.joints[above], `Select ${f.joints[above]}`, () => this.on.select(above)));
    else fact("Parent", "none: the root");
    fact("Level", f.otherNames[j] ? `LOA ${f.loa[j]} and up` : "at every level", "The lowest level of articulation of a complete figure that has this joint");
    fact("Centre", `${[0, 1, 2].map((c) => f.centers[3 * j + c].toFixed(4)).join("  ")} m`, "x, y, z at rest, in metres, in the space of the humanoid");
    const s = f.stiffness ? [0, 1, 2].map((a) => number(f.stiffness[3 * j + a])) : ["0", "0", "0"];
    fact("Stiffness", s.every((x) => x === s[0]) ? (s[0] === "0" ? "0: turns freely" : s[0]) : s.join("  "), "0 turns freely, 1 not at all; about x, y, z");
    const [any, most] = f.skinOf(j);
    fact("Skin", any ? `${any} points, ${most} mainly` : "no points", "Vertices of the skin that this joint pulls");
    this.facts.replaceChildren(...rows);
    const things = [], list = (title, all) => { if (all.length) things.push(el("h3", "", `${title} ${all.length}`), wrap("div", ...all)); };
    const mine = (x) => f.kept[x.joint] === j;
    list("Findings", (this.findings?.get(j) ?? []).map(({ n, severity, text }) => chip(text, "Show this finding", () => this.on.finding(n), severity)));
    list("Sites", f.sites.flatMap((x, i) => (mine(x) ? [chip(x.name, `Fly to ${x.name}`, () => this.on.site(i))] : [])));
    list("Displacers", f.displacers.flatMap((x, i) => (mine(x) ? [chip(x.name, `Show the slider of ${x.name}`, () => this.on.shape(i))] : [])));
    this.things.replaceChildren(...things);
  }

  /** Sliders of the selected joint, from the present pose; in red what is beyond its limits. */
  update(force = false) {
    const row = this.rows[this.selected];
    if (!row) return;
    const held = this.wanted?.j === this.selected && row.inputs.some(({ input }) => input === document.activeElement);
    const now = !force && held ? this.wanted.angles : this.angles(this.selected);
    row.inputs.forEach(({ box, input, value }, a) => {
      if (input !== document.activeElement || force || !this.wanted) input.value = now[a];
      if (value !== document.activeElement || force) value.value = now[a].toFixed(1).replace(/^-0\.0$/, "0.0");
      const at = (x) => Math.min(1, Math.max(0, (x - input.min) / (input.max - input.min || 1))), limit = this.limit(this.selected, a);
      const over = Boolean(limit) && (now[a] < limit[0] - SLACK || now[a] > limit[1] + SLACK);
      const here = at(now[a]), zero = at(0);
      box.style.setProperty("--from", Math.min(here, zero));
      box.style.setProperty("--to", Math.max(here, zero));
      if (box.classList.contains("over") !== over) box.classList.toggle("over", over);
    });
    this.now = now;
  }
}

function wrap(tag, ...inside) { const e = el(tag); e.append(...inside); return e; }
