// Sites in a list, and a ring in the picture that says where something is.

import * as THREE from "three";
import { el } from "./controls.js";

const TITLES = { "feature point": "Feature points", "end effector": "End effectors", viewpoint: "Viewpoints", "other place": "Other places" };
const MOST = 1000; // rows

/** `on.site(s)` flies there, `on.look(c)` looks through a camera, `on.point(s or -1)` while the pointer is on a row. */
export class Places {
  constructor({ root, filter, count }, on) {
    Object.assign(this, { root, filter, count, on, rows: [], cameras: [] });
    filter.addEventListener("input", () => this.search());
  }

  show(figure) {
    this.figure = figure;
    this.rows = [];
    this.cameras = [];
    this.root.replaceChildren();
    const eyes = new Map(figure.cameras.map((c, i) => [c.name, i])), named = new Set(figure.sites.map((s) => s.name));
    const all = figure.sites.map((s, i) => ({ ...s, site: i, camera: eyes.get(s.name) ?? -1 }));
    figure.cameras.forEach((c, i) => { if (!named.has(c.name)) all.push({ name: c.name, kind: "viewpoint", site: -1, camera: i }); });
    this.count.textContent = all.length ? String(all.length) : "";
    for (const kind of Object.keys(TITLES)) {
      const these = all.filter((s) => s.kind === kind);
      if (!these.length) continue;
      const group = el("details", "group"), head = el("summary", "", TITLES[kind]);
      group.open = true;
      group.dataset.testid = `sites-${kind.replace(" ", "-")}`;
      head.append(el("span", "count", String(these.length)));
      group.append(head, ...these.slice(0, MOST).map((s) => this.row(s)));
      if (these.length > MOST) group.append(el("p", "where", `and ${these.length - MOST} more`));
      this.root.append(group);
    }
    if (!all.length) this.root.append(el("p", "where", "This figure has no Sites."));
    this.search();
  }

  row(place) {
    const { name, site, camera } = place, row = el("button", `place ${place.kind.replace(" ", "-")}`);
    row.dataset.testid = `site-${name}`;
    row.append(el("span", "pin"), el("span", "name", name), el("span", "where", site < 0 ? "humanoid" : this.figure.joints[place.joint]));
    row.dataset.tip = camera >= 0 ? `Look through ${name}` : `Fly to ${name}`;
    row.onclick = () => (camera >= 0 ? this.on.look(camera) : this.on.site(site));
    if (site >= 0) {
      row.onpointerenter = () => this.on.point(site);
      row.onpointerleave = () => this.on.point(-1);
    }
    if (camera >= 0) this.cameras.push(camera);
    this.rows.push({ row, place });
    return row;
  }

  select(site, camera = -1) {
    for (const { row, place } of this.rows) {
      const on = (site >= 0 && place.site === site) || (camera >= 0 && place.camera === camera);
      row.setAttribute("aria-pressed", String(on));
      if (on && row.offsetParent) row.scrollIntoView({ block: "nearest" });
    }
  }

  search() {
    const text = this.filter.value.trim().toLowerCase();
    for (const { row, place } of this.rows) row.hidden = Boolean(text) && !place.name.toLowerCase().includes(text);
    for (const group of this.root.querySelectorAll(".group")) group.hidden = ![...group.querySelectorAll(".place")].some((r) => !r.hidden);
  }
}

/** The ring and its name, over the picture. `at` gives a world position, or is null. */
export class Beacon {
  constructor(element) {
    this.element = element;
    this.name = element.querySelector("span");
    this.at = null;
    this.p = new THREE.Vector3();
  }

  /** Mark `at` with `name`; with `flash` rings run out of it. */
  show(at, name, flash) {
    this.at = at;
    this.name.textContent = name;
    this.element.classList.remove("flash");
    if (flash) { void this.element.offsetWidth; this.element.classList.add("flash"); } // from the beginning
  }

  hide() { this.at = null; this.element.hidden = true; }

  update(studio) {
    if (!this.at) return;
    this.at(this.p).project(studio.camera);
    const out = this.p.z > 1 || Math.abs(this.p.x) > 1.05 || Math.abs(this.p.y) > 1.05;
    if (this.element.hidden !== out) this.element.hidden = out;
    if (!out) this.element.style.transform = `translate(${studio.window(this.p).map((x) => `${x.toFixed(1)}px`).join(", ")})`;
  }
}
