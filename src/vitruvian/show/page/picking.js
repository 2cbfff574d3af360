// Feature points on a scan: which names there are, placing them on its surface, and their file.

import * as THREE from "three";
import { download, el, keys } from "./controls.js";
import { Girths } from "./girths.js";
import { SURE, Searching, sureColor } from "./searching.js";
import { across, mirrorPlane, nearest, reflected } from "./surface.js";

const $ = (id) => document.getElementById(id);
const NEAR = 11; // pixels within which a point is taken hold of
const mate = (name) => (/^[lr]_/.test(name) ? (name[0] === "l" ? "r" : "l") + name.slice(1) : null);

export class Picking {
  constructor(page) {
    Object.assign(this, { page, panel: $("points-panel"), points: new Map(), names: [], rows: new Map(), labels: new Map(), selected: null, figure: null });
    this.searching = new Searching(this);
    this.girths = new Girths(this);
    this.panel.addEventListener("toggle", () => this.update());
    $("points-mirror").onclick = () => this.mirror();
    $("points-delete").onclick = () => this.remove(this.selected);
    $("points-save").onclick = () => this.save();
    $("points-download").onclick = () => this.download();
    $("points-load").onclick = () => $("points-file").click();
    $("points-file").onchange = (e) => { const [file] = e.target.files; e.target.value = ""; if (file) file.text().then((text) => this.read(text)); };
    $("points-list").addEventListener("keydown", (e) => this.walk(e));
    const press = (id) => () => { if (!this.panel.hidden && !$(id).disabled) $(id).click(); };
    keys({ 5: () => { if (!this.panel.hidden) this.panel.open = !this.panel.open; }, ";": press("points-mirror"), Delete: press("points-delete"), "'": () => this.placeAtPointer(), "\\": press("points-snap"), "`": press("points-save"), "!": press("points-find"), "#": press("points-girths") });
    const stage = page.studio.canvas.parentElement, own = (act) => (e) => { if (e.target === page.studio.canvas) act(e); };
    stage.addEventListener("pointerdown", own((e) => this.down(e)), true); // before the camera's
    stage.addEventListener("pointermove", own((e) => { this.pointer = [e.clientX, e.clientY]; this.hover(e); }), true);
    stage.addEventListener("click", own((e) => this.click(e)), true);
  }

  get active() { return Boolean(this.figure) && this.panel.open && !this.panel.hidden; }

  /** The scan among the figures, if there is one. */
  show() {
    const { page } = this, { keeps } = page.hello;
    this.figure = [...page.figures.values()].find((f) => !f.isBody && f.features) ?? null;
    this.panel.hidden = !this.figure;
    if (!this.figure) return this.draw();
    const given = Object.entries(keeps?.points ?? {});
    if (!this.points.size) this.points = new Map(given.map(([name, point]) => [name, { point }])); // a reconnected page keeps its own
    this.names = this.figure.features;
    this.segments = new Map(this.names.map((n) => [n.name, n.segment]));
    for (const name of this.points.keys()) if (!this.names.some((n) => n.name === name)) this.names.push({ name, segment: "", needed: false });
    this.searching.show();
    $("points-save").hidden = !keeps?.landmarks;
    $("points-list").replaceChildren(...this.names.map((n) => this.row(n)));
    if (given.length) this.panel.open = true;
    this.select(this.next(null));
  }

  row({ name, segment, needed }) {
    const row = el("button", "place point"), state = el("span", "state");
    row.append(state, el("span", "name", name), el("span", "where", segment));
    row.dataset.testid = `point-${name}`;
    row.dataset.tip = `${name}${segment ? `, on ${segment}` : ""}${needed ? ": a fit needs it" : ""}. Choose it, then click the surface; Enter flies to it`;
    row.tabIndex = -1;
    row.onclick = () => { this.select(name); if (this.points.has(name)) this.fly(name); };
    row.classList.toggle("needed", needed);
    this.rows.set(name, row);
    return row;
  }

  walk(e) {
    const by = { ArrowDown: 1, ArrowUp: -1 }[e.key];
    if (!by) return;
    const i = this.names.findIndex((n) => n.name === this.selected), to = this.names[Math.min(this.names.length - 1, Math.max(0, i + by))];
    this.select(to.name);
    this.rows.get(to.name).focus();
    e.preventDefault();
    e.stopPropagation();
  }

  select(name) {
    this.selected = name;
    this.update();
    this.rows.get(name)?.scrollIntoView({ block: "nearest" });
  }

  /** The first name after `name` that wants a point: of those that a fit needs, then unsure ones, then all without. */
  next(name) {
    const i = this.names.findIndex((n) => n.name === name), order = [...this.names.slice(i + 1), ...this.names.slice(0, i + 1)];
    const without = order.filter((n) => !this.points.has(n.name)), unsure = order.filter((n) => this.points.get(n.name)?.confidence < SURE);
    return (without.find((n) => n.needed) ?? unsure.find((n) => n.needed) ?? unsure[0] ?? without[0])?.name ?? name;
  }

  /** List what is needed and missing first, then what was found from unsure to sure, then what was set, then the others. */
  sort() {
    const rank = ({ name, needed }) => { const p = this.points.get(name); return !p ? (needed ? -1 : 3) : p.confidence ?? 2; };
    this.names = this.names.map((n, i) => [rank(n), i, n]).sort((a, b) => a[0] - b[0] || a[1] - b[1]).map(([, , n]) => n);
    $("points-list").replaceChildren(...this.names.map((n) => this.rows.get(n.name)));
  }

  /** The names of points that were found show while the pointer is near. */
  hover(e) {
    for (const { box, at, behind } of this.labels.values()) box.classList.toggle("hover", Boolean(at) && !behind && !e.buttons && Math.hypot(at[0] - e.clientX, at[1] - e.clientY) < NEAR);
  }

  // Placing ---------------------------------------------------------------------------------------------------------

  /** {point, normal} in the scan's own numbers where the ray through a pixel meets it; `snap`: its nearest vertex. */
  hit(x, y, snap) {
    const { figure, page } = this, [u, v, w, h] = page.studio.local(x, y), ray = new THREE.Raycaster();
    ray.setFromCamera(new THREE.Vector2((u / w) * 2 - 1, 1 - (v / h) * 2), page.studio.camera);
    const found = ray.intersectObject(figure.mesh, false)[0];
    if (!found) return null;
    const p = figure.mesh.worldToLocal(found.point.clone()).toArray(), corners = [found.face.a, found.face.b, found.face.c].map((i) => figure.drawn[i]);
    const [a, b, c] = corners.map((i) => [...figure.rest.subarray(3 * i, 3 * i + 3)]);
    const point = snap ? [a, b, c].sort((s, t) => distance(s, p) - distance(t, p))[0] : p;
    return { point, normal: facing(across(a, b, c), ray.ray.direction, figure) };
  }

  snaps(e) { return $("points-snap").checked !== Boolean(e?.shiftKey); }

  click(e) {
    if (this.dragged) { this.dragged = false; e.stopPropagation(); return; }
    if (!this.active || !this.start || Math.hypot(e.clientX - this.start[0], e.clientY - this.start[1]) > 4) return;
    if (this.place(e.clientX, e.clientY, this.snaps(e))) e.stopPropagation();
  }

  placeAtPointer() {
    const { clientWidth: w, clientHeight: h } = this.page.studio.canvas;
    if (this.active) this.place(...(this.pointer ?? [w / 2, h / 2]), $("points-snap").checked);
  }

  place(x, y, snap) {
    const found = this.selected && this.hit(x, y, snap);
    if (!found) return false;
    const name = this.selected;
    this.put([[name, found]]);
    this.select(this.next(name));
    return true;
  }

  /** Take hold of a point under the pointer and drag it over the surface. */
  down(e) {
    this.start = [e.clientX, e.clientY];
    this.dragged = false;
    if (!this.active || e.button) return;
    const [name, far] = [...this.labels].map(([n, l]) => [n, l.at && !l.behind ? Math.hypot(l.at[0] - e.clientX, l.at[1] - e.clientY) : Infinity]).sort((a, b) => a[1] - b[1])[0] ?? [null, Infinity];
    if (far > NEAR) return;
    e.stopPropagation();
    this.select(name);
    this.dragged = true; // the click that follows places nothing
    const before = this.points.get(name);
    const move = (m) => {
      const found = Math.hypot(m.clientX - e.clientX, m.clientY - e.clientY) > 2 && this.hit(m.clientX, m.clientY, this.snaps(m));
      if (found) { this.points.set(name, found); this.update(); }
    };
    const up = () => {
      window.removeEventListener("pointermove", move);
      window.removeEventListener("pointerup", up);
      window.removeEventListener("pointercancel", up);
      const after = this.points.get(name);
      if (after !== before) { this.points.set(name, before); this.put([[name, after]]); }
    };
    window.addEventListener("pointermove", move);
    window.addEventListener("pointerup", up);
    window.addEventListener("pointercancel", up);
  }

  /** Set points (null: none), [[name, {point, normal, proposed}]], as one step that can be taken back. */
  put(changes) {
    const before = changes.map(([name]) => [name, this.points.get(name) ?? null]);
    const set = (list) => {
      for (const [name, p] of list) { if (p) this.points.set(name, p); else this.points.delete(name); }
      this.update();
      this.girths.refresh();
    };
    set(changes);
    this.page.history.push({ undo: () => set(before), redo: () => set(changes) });
  }

  remove(name) {
    if (!this.points.has(name)) return;
    this.put([[name, null]]);
    this.select(name);
  }

  /** Propose what is missing on either side from the other: reflected, then snapped onto the surface. */
  mirror() {
    const pairs = [], middle = [], found = [], { points, figure } = this;
    for (const [name, { point, proposed }] of points) {
      const other = mate(name);
      if (!other) middle.push(point);
      else if (name[0] === "l" && points.has(other) && !proposed && !points.get(other).proposed) pairs.push([point, points.get(other).point]);
    }
    const plane = mirrorPlane(pairs, middle);
    if (!plane) return this.say("To mirror, first place a left and a right point, and some of the midline, as the nose and the navel.");
    for (const [name, { point }] of points) {
      const other = mate(name);
      if (!other || points.has(other) || !this.rows.has(other)) continue;
      const foot = nearest(figure.rest, figure.triangles, reflected(point, plane));
      if (foot) found.push([other, { ...foot, proposed: true }]);
    }
    if (found.length) this.put(found);
    this.say(found.length ? `${found.length} mirrored; drag what is not right.` : "Nothing to mirror: no point lacks its other side.");
  }

  // Files -----------------------------------------------------------------------------------------------------------

  /** Points that count: set by hand, or found with some confidence. */
  get json() { return asJson([...this.points].filter(([, p]) => (p.confidence ?? 1) >= SURE)); }

  get allPoints() { return asJson([...this.points]); }

  save() {
    const sent = this.json, n = Object.keys(sent).length, left = this.points.size - n;
    this.page.source.landmarks(this.figure.name, sent);
    this.say(`${n} sent to ${this.page.hello.keeps.landmarks}${left ? `; ${left} unsure ones left out` : ""}.`);
  }

  download() { download(new Blob([JSON.stringify(this.json, null, 1)], { type: "application/json" }), `${this.page.fileName()}-landmarks.json`); }

  read(text) {
    let given = null;
    try { given = JSON.parse(text); } catch { /* said below */ }
    const good = (p) => Array.isArray(p) && p.length === 3 && p.every((x) => Number.isFinite(x));
    if (!given || typeof given !== "object" || Array.isArray(given) || !Object.values(given).every(good)) return this.say('Expected JSON of the form {"feature point": [x, y, z]}.');
    const plain = (name) => name.replace(/_pt$/, ""), known = Object.entries(given).filter(([n]) => this.rows.has(plain(n))), lost = Object.keys(given).length - known.length;
    if (known.length) this.put(known.map(([name, point]) => [plain(name), { point }]));
    this.select(this.next(null));
    this.say(`${known.length} read${lost ? `; ${lost} with names that the standard does not have` : ""}.`);
  }

  // What is seen ----------------------------------------------------------------------------------------------------

  say(text) { $("points-said").textContent = text; }

  fly(name) {
    const { figure, page } = this, { point } = this.points.get(name), p = new THREE.Vector3(...point).applyMatrix4(figure.mesh.matrixWorld);
    page.studio.approach(p, page.explorer.metres(0.12), this.normal(name));
  }

  /** Unit normal in the world at a point; null where none is known. */
  normal(name) {
    const entry = this.points.get(name), { figure } = this;
    if (!entry.normal) entry.normal = figure.outward(new THREE.Vector3(...entry.point).applyMatrix4(figure.mesh.matrixWorld))?.transformDirection(figure.mesh.matrixWorld.clone().invert()).toArray();
    return entry.normal ? new THREE.Vector3(...entry.normal).transformDirection(figure.mesh.matrixWorld) : null;
  }

  update() {
    const needed = this.names.filter((n) => n.needed), got = needed.filter((n) => this.points.has(n.name)).length;
    $("points-count").textContent = this.figure ? `${this.points.size} \u00b7 ${got}/${needed.length} needed` : "";
    for (const { name } of this.names) {
      const row = this.rows.get(name), p = this.points.get(name);
      row.classList.toggle("placed", Boolean(p));
      row.classList.toggle("proposed", Boolean(p?.proposed));
      row.classList.toggle("unsure", p?.confidence < SURE);
      row.querySelector(".state").style.background = p?.confidence === undefined ? "" : sureColor(p.confidence);
      row.querySelector(".where").textContent = p?.confidence === undefined ? this.segments.get(name) ?? "" : `${Math.round(100 * p.confidence)} %`;
      row.setAttribute("aria-pressed", String(name === this.selected));
      row.tabIndex = name === this.selected ? 0 : -1;
    }
    this.searching.update();
    $("points-delete").disabled = !this.points.has(this.selected);
    $("points-mirror").disabled = this.points.size < 3;
    $("points-save").disabled = $("points-download").disabled = !this.points.size;
    this.draw();
  }

  /** Labels where the points are in the picture; those on the far side are faint. */
  draw() {
    this.girths.draw();
    const { figure, page } = this, shown = Boolean(figure) && this.panel.open, seen = new Set(shown ? this.points.keys() : []);
    for (const [name, { box }] of this.labels) if (!seen.has(name)) { box.remove(); this.labels.delete(name); }
    if (!shown) return;
    const { camera } = page.studio, p = new THREE.Vector3(), [middle] = page.studio.window(page.studio.controls.target.clone().project(camera));
    for (const name of seen) {
      if (!this.labels.has(name)) {
        const box = el("div", "landmark");
        box.append(el("i"), el("span", "", name));
        $("landmarks").append(box);
        this.labels.set(name, { box });
      }
      const label = this.labels.get(name), { box } = label, entry = this.points.get(name);
      p.fromArray(entry.point).applyMatrix4(figure.mesh.matrixWorld);
      label.behind = (this.normal(name)?.dot(camera.position.clone().sub(p)) ?? 1) < 0;
      p.project(camera);
      label.at = p.z < 1 ? page.studio.window(p) : null;
      box.hidden = !label.at;
      if (label.at) box.style.transform = `translate(${label.at[0].toFixed(1)}px, ${label.at[1].toFixed(1)}px)`;
      box.classList.toggle("left", (label.at?.[0] ?? 0) < middle - 1);
      box.classList.toggle("behind", label.behind);
      box.classList.toggle("proposed", Boolean(entry.proposed));
      box.classList.toggle("chosen", name === this.selected);
      box.classList.toggle("found", entry.confidence !== undefined);
      box.firstChild.style.background = entry.confidence === undefined || name === this.selected ? "" : sureColor(entry.confidence);
    }
  }

  /** What scripts may read. */
  get told() { return this.figure && { busy: this.searching.running, all: this.allPoints, confidence: Object.fromEntries([...this.points].filter(([, p]) => p.confidence !== undefined).map(([n, p]) => [n, p.confidence])), girths: this.girths.json, order: this.names.map((n) => n.name), selected: this.selected, points: this.json, proposed: [...this.points].filter(([, p]) => p.proposed).map(([n]) => n) }; }
}

const asJson = (points) => Object.fromEntries(points.map(([name, { point }]) => [name, point.map((x) => Number(x.toPrecision(8)))]));
const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);

/** A normal in the scan's own axes, turned to the side that is looked at: scans may be inside out. */
function facing(normal, direction, figure) {
  const n = new THREE.Vector3(...normal).transformDirection(figure.mesh.matrixWorld);
  return n.dot(direction) > 0 ? normal.map((x) => -x) : normal;
}

/** Show a lone scan as if it stood in metres on the floor, whatever its unit and origin are: its own numbers stay. */
export function stand(figure) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity], { rest } = figure;
  for (let i = 0; i < rest.length; i++) { low[i % 3] = Math.min(low[i % 3], rest[i]); high[i % 3] = Math.max(high[i % 3], rest[i]); }
  const size = high.map((h, c) => h - low[c]), most = Math.max(...size);
  if (!(most > 0) || !Number.isFinite(most)) return;
  const z = size[2] === most && size[2] > 1.3 * size[1]; // Z is up
  const scale = most > 20 || most < 0.02 ? 10 ** -Math.floor(Math.log10(most / 0.3)) : 1;
  const far = scale !== 1 || z || Math.hypot(low[0] + high[0], low[2] + high[2]) > 2 * most || low[1] < -0.2 * most;
  if (!far) return;
  const middle = low.map((l, c) => (l + high[c]) / 2), bottom = z ? low[2] : low[1];
  const move = z ? [-middle[0], -bottom, middle[1]] : [-middle[0], -bottom, -middle[2]];
  const turn = z ? new THREE.Matrix4().makeRotationX(-Math.PI / 2) : new THREE.Matrix4();
  figure.space.matrixAutoUpdate = false;
  figure.space.matrix.makeScale(scale, scale, scale).multiply(new THREE.Matrix4().makeTranslation(...move)).multiply(turn);
}
