// Feature contours: the tapes of girths on a scan, with their numbers, as its feature points allow.

import * as THREE from "three";
import { download, el } from "./controls.js";

const $ = (id) => document.getElementById(id);
const WAIT = 600; // ms after a change of points before the tapes are taken again

export class Girths {
  constructor(picking) {
    Object.assign(this, { picking, found: null, on: false, group: null, labels: new Map(), timer: 0 });
    $("points-girths").onclick = () => this.toggle();
    $("girths-download").onclick = () => this.download();
  }

  toggle() {
    this.on = !this.on;
    $("points-girths").setAttribute("aria-pressed", String(this.on));
    if (this.on) this.ask();
    else this.take(null);
  }

  /** Points have changed: take the tapes again in a moment, when they are seen. */
  refresh() {
    clearTimeout(this.timer);
    if (this.on) this.timer = setTimeout(() => this.ask(), WAIT);
  }

  ask() {
    const { picking } = this, { searching } = picking;
    if (!this.on || !picking.figure) return;
    if (searching.running) { this.refresh(); return; }
    searching.begin("girths");
    picking.page.source.girths(picking.figure.name, picking.allPoints);
  }

  /** {name: {m, points}} in the scan's own numbers, or null for none. */
  take(girths) {
    const { picking } = this, { figure } = picking;
    this.found = this.on ? girths : null;
    if (this.group) { this.group.parent?.remove(this.group); this.group.traverse((o) => o.geometry?.dispose()); this.group = null; }
    for (const { box } of this.labels.values()) box.remove();
    this.labels.clear();
    $("girths-download").hidden = !this.found;
    if (this.found && figure) this.build(figure);
    picking.page.changed = true;
  }

  build(figure) {
    const size = figure.stature, thick = new THREE.MeshBasicMaterial({ color: "#e4572e", toneMapped: false });
    this.group = new THREE.Group();
    for (const [name, { m, points }] of Object.entries(this.found)) {
      const line = new THREE.CurvePath(), at = points.map((p) => new THREE.Vector3(...p));
      at.forEach((p, i) => { const q = at[(i + 1) % at.length]; if (p.distanceTo(q) > 1e-6 * size) line.add(new THREE.LineCurve3(p, q)); });
      if (!line.curves.length) continue;
      const tube = new THREE.Mesh(new THREE.TubeGeometry(line, Math.max(24, at.length * 2), 0.0022 * size, 6, true), thick);
      tube.renderOrder = 3;
      this.group.add(tube);
      const box = el("div", "girth");
      box.append(el("b", "", (100 * m).toFixed(1)), el("span", "", ` cm ${name.replace(/_/g, " ")}`));
      box.dataset.testid = `girth-${name}`;
      $("landmarks").append(box);
      this.labels.set(name, { box, at });
    }
    figure.mesh.add(this.group);
  }

  /** Numbers beside their tapes, right of them in the picture; those that would lie upon another go below it. */
  draw() {
    if (!this.labels.size) return;
    const { figure, page } = this.picking, { studio } = page, p = new THREE.Vector3(), taken = [];
    const shown = figure && this.picking.panel.open;
    const put = [...this.labels.values()].map(({ box, at }) => {
      let best = null;
      for (const q of at) {
        const [x, y] = studio.window(p.copy(q).applyMatrix4(figure.mesh.matrixWorld).project(studio.camera));
        if (!best || x > best[0]) best = [x, y];
      }
      return { box, x: best[0] + 6, y: best[1] };
    }).sort((a, b) => a.y - b.y);
    for (const { box, x, y } of put) {
      let low = y;
      for (const t of taken) if (Math.abs(t.x - x) < 120 && low < t.y + 16 && low > t.y - 16) low = t.y + 16;
      taken.push({ x, y: low });
      box.hidden = !shown;
      box.style.transform = `translate(${x.toFixed(1)}px, ${(low - 8).toFixed(1)}px)`;
    }
    if (this.group) this.group.visible = Boolean(shown);
  }

  /** {name: {girth_m, points}}: as `vitruvian measure -o tapes.json` writes them, in the scan's own unit and axes. */
  get json() { return Object.fromEntries(Object.entries(this.found ?? {}).map(([n, t]) => [n, { girth_m: t.m, points: t.points }])); }

  download() { download(new Blob([JSON.stringify(this.json, null, 1)], { type: "application/json" }), `${this.picking.page.fileName()}-girths.json`); }
}
