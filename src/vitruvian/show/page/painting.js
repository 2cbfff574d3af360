// The brush of the weights: dabs on the skin give weight to the selected joint, take it, or smooth. The same rules as
// vitruvian.modeling.weights; what is painted moves the skin as soon as the brush is lifted.

import * as THREE from "three";
import { bind } from "./deform.js";
import { download, keys } from "./controls.js";
import { Surface } from "./surface.js";

const $ = (id) => document.getElementById(id);
const TINY = 1e-7; // weights below this are left out
const PIECE = 30000; // characters of one message to the server

/** Weights of a vertex in a brush. row: Map joint -> weight; `mean`: that of its neighbours, shares that sum to 1. */
export function dabbed(row, joint, parent, mode, strength, fall, mean) {
  let total = 0;
  for (const w of row.values()) total += w;
  const empty = total <= TINY, sum = empty ? 1 : total, out = new Map();
  if (mode === "smooth") {
    if (empty || !mean) return row;
    const part = strength * fall;
    for (const [j, w] of row) out.set(j, (1 - part) * w);
    for (const [j, w] of mean) out.set(j, (out.get(j) ?? 0) + part * sum * w);
    return cleaned(out);
  }
  const now = (row.get(joint) ?? 0) / sum, others = (empty ? 0 : 1) - now;
  let wanted = mode === "replace" ? now + fall * (strength - now) : now + (mode === "add" ? 1 : -1) * strength * fall;
  wanted = Math.min(1, Math.max(0, wanted));
  if (empty) { if (wanted > 0) out.set(joint, 1); return out; }
  if (others <= TINY) {
    out.set(joint, sum * (parent < 0 ? 1 : wanted));
    if (parent >= 0) out.set(parent, sum * (1 - wanted));
  } else for (const [j, w] of row) if (j !== joint) out.set(j, (w * (1 - wanted)) / others);
  if (others > TINY) out.set(joint, sum * wanted);
  return cleaned(out);
}

function cleaned(row) {
  for (const [j, w] of row) if (!(w > TINY)) row.delete(j);
  return row;
}

export class Painting {
  constructor(page) {
    Object.assign(this, { page, panel: $("weights-panel"), on: false, changed: new Set(), sent: false });
    $("paint").onclick = () => this.toggle(!this.on);
    $("weights-save").onclick = () => this.save();
    $("weights-download").onclick = () => download(new Blob([this.csv(this.rows.keys())], { type: "text/csv" }), `${page.fileName()}-weights.csv`);
    for (const id of ["brush-radius", "brush-strength"]) $(id).oninput = () => this.update();
    this.panel.addEventListener("toggle", () => { if (!this.panel.open) this.toggle(false); this.update(); });
    const cycle = () => { const s = $("brush-mode"); s.selectedIndex = (s.selectedIndex + 1) % s.length; };
    const shift = (by) => () => { const s = $("brush-radius"); s.value = Number(s.value) + by; this.update(); };
    keys({ 6: () => { if (!this.panel.hidden) this.panel.open = !this.panel.open; }, 7: () => { if (!this.panel.hidden) $("paint").click(); }, "-": shift(-5), "=": shift(5), Enter: () => this.on && cycle() });
    const { canvas } = page.studio, stage = canvas.parentElement, own = (act) => (e) => { if (e.target === canvas) act(e); };
    stage.addEventListener("pointerdown", own((e) => this.down(e)), true); // before the camera's
    stage.addEventListener("pointermove", own((e) => this.ring(e)), true);
    stage.addEventListener("click", own((e) => { if (this.painted) { this.painted = false; e.stopPropagation(); } }), true);
    canvas.addEventListener("pointerleave", () => { $("brush").hidden = true; });
  }

  show(figure) {
    this.toggle(false);
    this.figure = figure.isBody && figure.triangles.length ? figure : null;
    this.panel.hidden = !this.figure;
    this.changed.clear();
    this.sent = false;
    this.surface = null;
    if (!this.figure) return;
    const { row, joint, weight } = figure;
    this.rows = new Map(Array.from({ length: row.length - 1 }, (_, v) => [v, new Map(Array.from({ length: row[v + 1] - row[v] }, (_, k) => [joint[row[v] + k], weight[row[v] + k]]))]));
    this.first = new Map(this.rows);
    $("weights-save").hidden = !this.page.hello.keeps?.weights;
    this.update();
  }

  toggle(on) {
    this.on = on && Boolean(this.figure);
    if (this.on) {
      this.panel.open = true;
      if (this.page.mode !== "weights") this.page.setMode("weights");
      this.surface ??= new Surface(this.figure.rest, this.figure.triangles.map((i) => this.figure.source[i]));
    }
    $("paint").setAttribute("aria-pressed", String(this.on));
    this.page.studio.canvas.classList.toggle("painting", this.on);
    $("brush").hidden = true;
    this.update();
  }

  get radius() { return (Number($("brush-radius").value) / 1000) * (this.figure.stature / 1.75); } // in the body's own unit
  get strength() { return Number($("brush-strength").value) / 100; }

  update() {
    const { page } = this;
    $("weights-count").textContent = this.changed.size ? `${this.changed.size} changed` : "";
    $("brush-joint").textContent = this.figure ? `Joint: ${this.figure.joints[page.selected] ?? "choose one in the list of joints"}` : "";
    $("brush-radius-value").textContent = `${$("brush-radius").value} mm`;
    $("brush-strength-value").textContent = `${$("brush-strength").value} %`;
    $("weights-save").disabled = $("weights-download").disabled = !this.changed.size && !this.sent; // what was sent may be taken back
  }

  /** {corners, point (3) at rest, world} where the ray through a pixel meets the skin. */
  hit(x, y) {
    const { figure, page } = this, [u, v, w, h] = page.studio.local(x, y), ray = new THREE.Raycaster();
    ray.setFromCamera(new THREE.Vector2((u / w) * 2 - 1, 1 - (v / h) * 2), page.studio.camera);
    const found = ray.intersectObject(figure.mesh, false)[0];
    if (!found) return null;
    const { a, b, c } = found.face, own = figure.mesh.worldToLocal(found.point.clone()), p = figure.mesh.geometry.attributes.position, V = (i) => new THREE.Vector3().fromBufferAttribute(p, i);
    const share = THREE.Triangle.getBarycoord(own, V(a), V(b), V(c), new THREE.Vector3())?.toArray() ?? [1, 0, 0], corners = [a, b, c].map((i) => figure.drawn[i]);
    return { corners, world: found.point, point: [0, 1, 2].map((i) => corners.reduce((s, v, k) => s + share[k] * figure.rest[3 * v + i], 0)) };
  }

  ring(e) {
    if (!this.on) return;
    const found = this.hit(e.clientX, e.clientY), ring = $("brush");
    ring.hidden = !found;
    if (!found) return;
    const scale = new THREE.Vector3().setFromMatrixScale(this.figure.mesh.matrixWorld).x, size = (2 * this.radius * scale) / this.page.studio.pixel(found.world);
    Object.assign(ring.style, { width: `${size}px`, height: `${size}px`, left: `${e.clientX - size / 2}px`, top: `${e.clientY - size / 2}px` });
  }

  down(e) {
    this.painted = false;
    const { page, figure } = this;
    if (!this.on || e.button || page.selected < 0 || !this.hit(e.clientX, e.clientY)) return; // beside the body the camera turns
    e.stopPropagation();
    this.painted = true;
    if (page.header.playing) page.source.pause();
    const before = new Map();
    let due = null;
    const dab = () => { const at = due; due = null; if (at) this.dab(at, before); };
    const move = (m) => { if (!due) requestAnimationFrame(dab); due = [m.clientX, m.clientY]; this.ring(m); };
    const up = () => {
      for (const [name, act] of [["pointermove", move], ["pointerup", up], ["pointercancel", up]]) window.removeEventListener(name, act);
      dab();
      const after = new Map([...before.keys()].map((v) => [v, this.rows.get(v)]));
      const put = (rows) => { for (const [v, row] of rows) this.set(v, row); this.settle(figure); };
      this.settle(figure);
      if (before.size) page.history.push({ undo: () => put(before), redo: () => put(after) });
    };
    for (const [name, act] of [["pointermove", move], ["pointerup", up], ["pointercancel", up]]) window.addEventListener(name, act);
    this.dab([e.clientX, e.clientY], before);
  }

  dab([x, y], before) {
    const found = this.hit(x, y);
    if (!found) return;
    this.at = found.point;
    const { surface, figure, page } = this, { strength, radius } = this, mode = $("brush-mode").value, joint = page.selected;
    const near = surface.reach(found.corners, found.point, radius), next = new Map();
    for (const [s, far] of near) {
      const fall = (1 - (far / radius) ** 2) ** 2, row = this.rows.get(s);
      next.set(s, dabbed(row, joint, figure.parents[joint], mode, strength, fall, mode === "smooth" ? this.mean(s) : null));
    }
    for (const [s, row] of next) for (const v of surface.at(s)) {
      if (!before.has(v)) before.set(v, this.rows.get(v));
      this.set(v, row);
    }
    this.flatten();
    figure.paint("weights", joint);
    page.changed = true;
    this.update();
  }

  /** Undoing brings back the very rows that came: these count as unchanged. */
  set(v, row) {
    this.rows.set(v, row);
    if (row === this.first.get(v)) this.changed.delete(v);
    else this.changed.add(v);
  }

  /** Mean shares of the neighbours of a place, or null. */
  mean(s) {
    const out = new Map();
    let n = 0;
    for (const t of this.surface.next[s]) {
      let sum = 0;
      for (const w of this.rows.get(t).values()) sum += w;
      if (sum <= TINY) continue;
      n++;
      for (const [j, w] of this.rows.get(t)) out.set(j, (out.get(j) ?? 0) + w / sum);
    }
    for (const [j, w] of out) out.set(j, w / n);
    return n ? out : null;
  }

  /** The rows as the arrays that colours are made of. */
  flatten() {
    const { figure, rows } = this, row = new Uint32Array(rows.size + 1), joint = [], weight = [];
    for (let v = 0; v < rows.size; v++) {
      for (const [j, w] of rows.get(v)) { joint.push(j); weight.push(w); }
      row[v + 1] = joint.length;
    }
    Object.assign(figure, { row, joint: Uint16Array.from(joint), weight: Float32Array.from(weight), owner: null });
  }

  /** Let the skin move by the rows. */
  settle(figure) {
    this.flatten();
    const { rest, row, joint, weight, centers, skin } = figure;
    Object.assign(skin, bind({ rest, row, joint, weight, triangles: skin.triangles, centers, morphs: skin.morphs }), { made: {} });
    Object.assign(figure, { reweighted: true, served: null, coarse: null, limbs: null }); // the server's surface has other weights
    figure.levels.clear();
    this.page.refresh(figure);
    this.page.looks();
    this.update();
  }

  /** Lines `vertex,joint,weight` of vertices. */
  csv(vertices) {
    const names = this.figure.joints.map((n) => (/[",\n]/.test(n) ? `"${n.replaceAll('"', '""')}"` : n)), lines = ["vertex,joint,weight"];
    for (const v of vertices) for (const [j, w] of this.rows.get(v)) lines.push(`${v},${names[j]},${Number(w.toPrecision(7))}`);
    return lines.join("\n") + "\n";
  }

  /** Send all rows to the server, in pieces. */
  async save() {
    const text = this.csv(this.rows.keys()), { source, hello } = this.page;
    for (let i = 0; i < text.length; i += PIECE) {
      source.weights(this.figure.name, text.slice(i, i + PIECE), i + PIECE >= text.length);
      await new Promise((done) => setTimeout(done, 12)); // the server takes so many requests a second
    }
    this.sent = true;
    this.update();
    $("weights-said").textContent = `Sent to ${hello.keeps.weights}.`;
  }

  /** What scripts may read. */
  get told() { return this.figure && { on: this.on, changed: this.changed.size, radius: this.radius, at: this.at, under: ([x, y]) => this.hit(x, y)?.point ?? null, of: (v) => Object.fromEntries([...this.rows.get(v)].map(([j, w]) => [this.figure.joints[j], w])) }; }
}
