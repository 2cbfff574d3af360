// A surface coloured by its distance from another, or by how clothes fit: colour bar with a histogram, figures, what is shown.

import * as THREE from "three";
import { css, toLinear } from "./colors.js";
import { el } from "./controls.js";
import { flat } from "./looks.js";

const $ = (id) => document.getElementById(id);
const WORST = 4; // findings that are shown at once
const SHOWN = ["map", "other", "both"];

/** Where a value is on a colour bar, 0 to 1. The bar begins at -reach, or at 0 where that is what is told. */
const along = ({ low, reach }, mm) => { const from = low === 0 ? 0 : -reach; return Math.min(1, Math.max(0, (mm - from) / (reach - from))); };

/** Colours (sRGB 0..1) of a distance in mm; NaN is a hole. */
export function heatColor(heat, mm) {
  const { ramp, hole } = heat;
  if (!Number.isFinite(mm)) return hole;
  const at = along(heat, mm) * (ramp.length - 1), i = Math.min(ramp.length - 2, Math.floor(at));
  return ramp[i].map((c, k) => c + (at - i) * (ramp[i + 1][k] - c));
}

/** The material of a geometry that draws the points `source` of a figure, which gets their colours. */
export function heated(figure, geometry, source) {
  const { heat } = figure, c = new Float32Array(3 * source.length);
  for (let i = 0; i < source.length; i++) c.set(heatColor(heat, heat.mm[source[i]]).map(toLinear), 3 * i);
  geometry.setAttribute("color", new THREE.BufferAttribute(c, 3));
  return (figure.flat ??= flat());
}

export class HeatMap {
  constructor(page) {
    Object.assign(this, { page, shown: "map", figure: null, opened: false });
    for (const name of SHOWN) $(`heat-${name}`).onclick = () => this.show(name);
    $("heat-range").oninput = () => this.range(Number($("heat-range").value));
    page.studio.canvas.addEventListener("pointermove", (e) => this.point(e));
  }

  /** Look for a figure with a map among those that have arrived. */
  arrive() {
    const { page } = this, all = [...page.figures.values()];
    this.figure = all.find((f) => f.heat) ?? null;
    $("heat").hidden = !this.figure;
    if (!this.figure) return;
    const { heat } = this.figure;
    this.other = all.find((f) => f !== this.figure && !f.isBody && f.name === heat.against) ?? null;
    this.unit = heat.unit ?? "mm";
    this.layered(heat.layers ?? []);
    if (!heat.layers) $("heat-title").textContent = `mm from ${heat.against}`;
    $("heat-map").textContent = this.figure.name;
    $("heat-other").textContent = heat.against;
    for (const name of ["other", "both"]) $(`heat-${name}`).hidden = !this.other;
    $("heat-range").value = String(10 * Math.log2(heat.reach));
    this.ends();
    this.numbers();
    $("heat-hole").textContent = heat.layers ? "no cloth" : "no answer: a hole, or left out";
    $("heat-map").parentElement.hidden = Boolean(heat.layers);
    this.words(heat.findings ?? []);
    if (!this.opened) { this.opened = true; page.setMode("heat"); }
  }

  /** Where clothes are too tight: the worst places, and the others on request. */
  words(lines) {
    const said = (some) => some.map((text) => el("p", "", text)), more = el("details"), head = el("summary", "", `${lines.length - WORST} more`);
    more.append(head, ...said(lines.slice(WORST)));
    $("heat-findings").replaceChildren(...said(lines.slice(0, WORST)), ...(lines.length > WORST ? [more] : []));
  }

  /** Buttons for each of several things that a surface may be coloured by. */
  layered(layers) {
    $("heat-layers").hidden = !layers.length;
    $("heat-layers").replaceChildren(...layers.map((layer, i) => {
      const button = el("button", "", layer.name);
      Object.assign(button.dataset, { testid: `heat-${layer.name}`, tip: `Colour the clothes by ${layer.name}${layer.unit && `, ${layer.unit}`}`, key: ":" });
      button.onclick = () => this.layer(i);
      return button;
    }));
    if (layers.length) this.layer(0);
  }

  layer(i) {
    const { heat } = this.figure, { name, unit, low, reach, ramp, mm } = heat.layers[i];
    Object.assign(heat, { low, reach, ramp, mm, at: i });
    this.unit = unit;
    $("heat-title").textContent = unit ? `${name}, ${unit}` : name;
    $("heat-range").hidden = Boolean(heat.layers[i].kinds.length);
    [...$("heat-layers").children].forEach((b, k) => b.setAttribute("aria-pressed", String(k === i)));
    $("heat-range").value = String(10 * Math.log2(reach));
    this.ends();
    this.numbers();
    this.page.looks();
  }

  show(name) {
    this.shown = name;
    if (this.page.mode !== "heat") this.page.setMode("heat");
    this.page.looks();
  }

  /** The next of: the map, the other surface, both. */
  next() {
    const { layers, at } = this.figure?.heat ?? {};
    if (layers) this.layer((at + 1) % layers.length);
    else if (this.other) this.show(SHOWN[(SHOWN.indexOf(this.shown) + 1) % SHOWN.length]);
  }

  /** `step`: ten times the binary logarithm of the mm at the ends of the bar. */
  range(step) {
    const mm = 2 ** (step / 10);
    this.figure.heat.reach = mm < 1 ? Math.round(20 * mm) / 20 : mm < 10 ? Math.round(10 * mm) / 10 : Math.round(mm);
    this.ends();
    this.page.looks();
  }

  ends() {
    const { heat } = this.figure, { reach, ramp, mm } = heat;
    const kinds = heat.layers?.[heat.at]?.kinds ?? [], part = 100 / (kinds.length || 1);
    if (kinds.length) $("heat-ramp").style.background = `linear-gradient(to right, ${kinds.map((_, i) => `${css(ramp[i])} ${i * part}% ${(i + 1) * part}%`).join(", ")})`;
    else $("heat-ramp").style.background = `linear-gradient(to right, ${ramp.filter((_, i) => i % 4 === 0).map(css).join(", ")})`;
    if (kinds.length) $("heat-ticks").replaceChildren(...kinds.map((name) => el("span", "", name)));
    else $("heat-ticks").replaceChildren(...(heat.low === 0 ? [0, 0.25, 0.5, 0.75, 1] : [-1, -0.5, 0, 0.5, 1]).map((t) => el("span", "", t ? `${t < 0 ? "\u2212" : heat.low === 0 ? "" : "+"}${Number(Math.abs(t * reach).toPrecision(3))}` : "0")));
    $("heat-range").setAttribute("aria-valuetext", `${reach} ${this.unit}`);
    const bins = new Float64Array(48), area = areas(this.figure);
    mm.forEach((d, v) => { if (Number.isFinite(d)) bins[Math.min(47, Math.floor(48 * along(heat, d)))] += area[v]; });
    const most = Math.max(...bins) || 1;
    const steps = [...bins].map((n, i) => `H${i}V${(28 * (1 - n / most)).toFixed(1)}`).join("");
    $("heat-bins").setAttribute("d", `M0 28${steps}H48V28Z`);
  }

  numbers() {
    const { numbers, layers, at } = this.figure.heat;
    if (layers) return this.rows(layers[at]);
    const say = (x) => (x === null ? "\u2013" : x.toFixed(x < 9.995 ? 2 : 1));
    const row = (name, n) => [el("span", "", name), ...["mean_mm", "p95_mm", "max_mm"].map((k) => el("b", "", say(n[k]))), el("b", "", `${Math.round(100 * n.holes)} %`)];
    const head = ["", "mean", "95 %", "max", "holes"].map((t) => el("i", "", t));
    $("heat-numbers").replaceChildren(...head, ...row("all", numbers), ...Object.entries(numbers.parts).flatMap(([n, p]) => row(n, p)));
  }

  /** The figures of a layer: of everything and of each part of the body. */
  rows({ rows, unit }) {
    const say = (x) => Number(x.toPrecision(3)).toString();
    const head = (rows.length ? ["", "mean", "99 %", "max", unit] : []).map((t) => el("i", "", t));
    $("heat-numbers").replaceChildren(...head, ...rows.flatMap(([n, ...x]) => [el("span", "", n), ...x.map((v) => el("b", "", say(v))), el("b", "", "")]));
  }

  /** Which figures are seen, and how. */
  update() {
    const { figure, other, page } = this, on = Boolean(figure) && page.mode === "heat";
    $("heat-legend").hidden = !on;
    if (!figure) return;
    figure.group.visible = !on || this.shown !== "other";
    if (other) {
      other.group.visible = !on || this.shown !== "map";
      const through = on && this.shown === "both";
      for (const look of other.looks) Object.assign(look, { transparent: through, opacity: through ? 0.38 : 1, depthWrite: !through, needsUpdate: true });
      other.mesh.castShadow = !through;
    }
    for (const name of SHOWN) $(`heat-${name}`).setAttribute("aria-pressed", String(on && this.shown === name));
    page.changed = true;
  }

  /** The distance under the pointer, in words; null beside the surface. */
  under(x, y) {
    const { figure, page } = this, [u, v, w, h] = page.studio.local(x, y), ray = new THREE.Raycaster();
    ray.setFromCamera(new THREE.Vector2((u / w) * 2 - 1, 1 - (v / h) * 2), page.studio.camera);
    const hit = ray.intersectObject(figure.mesh, false)[0];
    if (!hit) return null;
    const p = figure.mesh.worldToLocal(hit.point.clone()), { positions } = figure;
    const corners = [hit.face.a, hit.face.b, hit.face.c].map((i) => figure.drawn[i]);
    const [near] = corners.map((s) => [p.distanceToSquared(new THREE.Vector3().fromArray(positions, 3 * s)), s]).sort((a, b) => a[0] - b[0])[0].slice(1);
    const mm = figure.heat.mm[near];
    return Number.isFinite(mm) ? `${mm < 0 ? "\u2212" : "+"}${Math.abs(mm).toFixed(2)} ${this.unit}` : "no answer";
  }

  point(e) {
    const { page } = this;
    if (e.buttons || !this.figure || page.mode !== "heat" || this.shown === "other" || this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      const label = $("label"), text = page.at(e) ? null : this.under(e.clientX, e.clientY);
      if (!text) return;
      Object.assign(label, { textContent: text, hidden: false });
      Object.assign(label.style, { left: `${e.clientX}px`, top: `${e.clientY}px` });
    });
  }

  /** What scripts may read. */
  get told() { return this.figure && { on: this.page.mode === "heat", shown: this.shown, reach: this.figure.heat.reach, numbers: this.figure.heat.numbers, color: (mm) => heatColor(this.figure.heat, mm) }; }
}

/** A third of the area of the triangles round each point of a figure's skin, at rest. */
function areas({ rest, source, triangles }) {
  const out = new Float64Array(rest.length / 3), a = new THREE.Vector3(), b = new THREE.Vector3(), c = new THREE.Vector3();
  for (let k = 0; k < triangles.length; k += 3) {
    const [i, j, l] = [source[triangles[k]], source[triangles[k + 1]], source[triangles[k + 2]]];
    a.fromArray(rest, 3 * i);
    const size = b.fromArray(rest, 3 * j).sub(a).cross(c.fromArray(rest, 3 * l).sub(a)).length() / 6;
    for (const v of [i, j, l]) out[v] += size;
  }
  return out;
}
