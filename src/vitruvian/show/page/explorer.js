// The explorer: joint tree and details, limits, Sites, displacers, findings, level of articulation; and flying to places.

import * as THREE from "three";
import { Details } from "./details.js";
import { Findings } from "./findings.js";
import { counts } from "./level.js";
import { JointTree } from "./panels.js";
import { Beacon, Places } from "./places.js";
import { Ranges } from "./ranges.js";
import { Shapes } from "./shapes.js";

const $ = (id) => document.getElementById(id);
const pressed = (id) => $(id).getAttribute("aria-pressed") === "true";

export class Explorer {
  constructor(page) {
    this.page = page;
    this.level = null; // until somebody chooses one: all joints
    this.look = -1;
    const settle = () => page.history.settle(), select = (j) => this.select(j);
    this.tree = new JointTree($("joints"), $("joint-filter"), { select, point: (j) => this.pointJoint(j) });
    this.details = new Details(
      { card: $("details"), name: $("joint-name"), other: $("joint-other"), sliders: $("joint-sliders"), facts: $("joint-facts"), things: $("joint-things"), free: $("ignore-limits") },
      { select, settle, turn: (j, R, key) => page.turn(j, R, key), site: (s) => this.site(s), shape: (d) => this.shape(d), finding: (n) => this.finding(n) },
    );
    this.places = new Places({ root: $("sites-list"), filter: $("site-filter"), count: $("site-count") }, {
      site: (s) => this.site(s), look: (c) => this.lookThrough(c), point: (s) => this.point(s),
    });
    this.shapes = new Shapes({ root: $("shapes"), filter: $("shape-filter"), count: $("shape-count"), reset: $("reset-shapes") }, {
      displace: (d, w, key) => page.displace(d, w, key), settle,
    });
    this.findings = new Findings({ root: $("findings"), count: $("finding-count"), sift: $("sift"), panel: $("findings-panel") }, { place: (p) => this.go(p) });
    this.beacon = new Beacon($("beacon"));
    this.ranges = new Ranges();
    this.before = null; // what the beacon marked before the pointer came to rest on a row
  }

  get figure() { return this.page.figure; }
  get selected() { return this.page.selected; }

  present(figure, hello) {
    const full = this.offer(figure);
    this.tree.show(figure);
    this.details.show(figure);
    this.places.show(figure);
    this.shapes.show(figure);
    this.findings.show(hello.findings, hello.found ?? hello.findings.length, figure);
    this.setLevel(this.level ?? full);
    $("findings-panel").classList.toggle("empty", !hello.findings.length);
  }

  // Level of articulation -------------------------------------------------------------------------------------------

  /** Fill the switch with the levels of `figure`; returns the lowest that has all its joints. */
  offer(figure) {
    const n = counts(figure.loa, figure.parents), full = n.indexOf(n.at(-1)), name = (c) => `${c} joint${c === 1 ? "" : "s"}`;
    $("loa").replaceChildren(...n.map((c, level) => {
      const option = new Option(`${full || c === 1 ? `LOA ${level}` : "Any LOA"} \u00b7 ${name(c)}`, level); // names of its own belong to no level
      option.disabled = level > full; // nothing more to show
      return option;
    }));
    $("loa").parentElement.hidden = !figure.isBody;
    this.full = full;
    return full;
  }

  setLevel(level) {
    const { page, figure } = this;
    level = Math.min(level, Math.max(0, this.full));
    $("loa").value = String(level);
    for (const f of page.figures.values()) {
      f.setLevel(level === this.full ? 4 : level);
      f.refresh();
      f.overlay.relevel();
    }
    this.tree.relevel();
    this.tree.marks();
    const { all, worst } = this.findings.byJoint(figure.kept);
    this.details.findings = all;
    this.tree.findings(worst);
    if (this.selected >= 0) this.select(figure.kept[this.selected]);
    if (page.mode !== "skin") page.looks();
    page.changed = true;
  }

  chooseLevel(level) { this.level = level; this.setLevel(level); }

  nextLevel() {
    const now = Number($("loa").value);
    this.chooseLevel(now > 0 ? now - 1 : this.full);
  }

  // Choosing --------------------------------------------------------------------------------------------------------

  select(j) {
    const { page, figure } = this;
    page.selected = j;
    if (j >= 0 && innerWidth <= 480) $("joints-panel").open = false; // its card takes the room
    this.tree.select(j);
    this.details.select(j);
    figure.overlay.color(j);
    this.unmark();
    this.showRanges();
    page.painting.update();
    if (page.mode === "weights") page.looks();
    page.changed = true;
  }

  showRanges() {
    this.ranges.group.visible = this.selected >= 0 && pressed("arcs") && this.page.mode !== "weights"; // whose colours must match their bar
    this.page.changed = true;
  }

  unmark() {
    this.before = null;
    this.beacon.hide();
    this.places.select(-1);
    this.figure?.overlay.colorSites(-1);
  }

  /** Flash a place and keep its name there. */
  mark(at, name) {
    this.unmark();
    this.beacon.show(at, name, true);
    this.page.changed = true;
  }

  site(s) {
    const { figure } = this;
    this.mark((out) => figure.sitePosition(s, out), figure.sites[s].name);
    this.places.select(s);
    figure.overlay.colorSites(s);
    const p = figure.sitePosition(s);
    this.page.studio.approach(p, this.metres(0.085), figure.outward(p));
  }

  /** The pointer rests on a Site of the list, or (-1) on none. */
  point(s) {
    const { figure } = this;
    this.hint(s < 0 ? null : { at: (out) => figure.sitePosition(s, out), name: figure.sites[s].name });
  }

  pointJoint(j) {
    const { figure } = this;
    this.hint(j < 0 ? null : { at: (out) => figure.jointPosition(j, out), name: figure.joints[j] });
  }

  /** Show a name for as long as the pointer rests; what was marked before comes back after. */
  hint(thing) {
    if (!thing && !this.before) return;
    this.before ??= { at: this.beacon.at, name: this.beacon.name.textContent };
    const shown = thing ?? this.before;
    if (!thing) this.before = null;
    if (shown.at) this.beacon.show(shown.at, shown.name, false);
    else this.beacon.hide();
    this.page.changed = true;
  }

  shape(d) {
    const { figure } = this, { joint, point } = figure.region(d);
    $("shapes-panel").open = true;
    this.shapes.reveal(d);
    this.mark((out) => figure.moved(joint, point, out), figure.displacers[d].name);
    const p = figure.moved(joint, point);
    this.page.studio.approach(p, this.metres(0.1), figure.outward(p));
  }

  finding(n) {
    $("findings-panel").open = true;
    this.findings.mark(n);
  }

  /** Go where a finding is. */
  go({ kind, index, joint }) {
    if (kind === "site") this.site(index);
    else if (kind === "displacer") this.shape(index);
    else this.flyTo(this.figure.kept[joint], kind === "segment");
  }

  /** Select joint j, fly to it and flash it. */
  flyTo(j, segment = false) {
    if (j < 0) return;
    const { figure, page } = this, p = figure.jointPosition(j);
    this.select(j);
    this.mark((out) => figure.jointPosition(j, out), segment ? (figure.segments[j]?.[0] ?? figure.joints[j]) : figure.joints[j]);
    const root = figure.jointPosition(0), away = new THREE.Vector3(p.x - root.x, 0, p.z - root.z);
    const aside = away.length() > this.metres(0.05) ? away.normalize() : null;
    page.studio.approach(p, Math.min(this.metres(0.35), Math.max(this.metres(0.07), 1.5 * this.bone(j))), aside);
  }

  /** Length of the bone at joint j in the world, as far as one is known. */
  bone(j) {
    const { figure } = this, p = figure.jointPosition(j);
    const ends = [...figure.above.keys()].filter((k) => figure.kept[k] === k && (figure.above[k] === j || figure.above[j] === k)).map((k) => figure.jointPosition(k).distanceTo(p));
    return Math.max(0, ...ends);
  }

  /** Share of the height of the box about everything. */
  metres(share) { const { low, high } = this.page.studio.box; return share * Math.max(high[1] - low[1], 0.05); }

  // Cameras ---------------------------------------------------------------------------------------------------------

  /** Look through camera c of the figure and ride along with it. */
  lookThrough(c) {
    const { figure, page } = this, camera = figure.cameras[c], far = 0.5 * figure.stature;
    const at = camera.eye, to = camera.look.map((d, i) => at[i] + far * d);
    this.unmark();
    this.look = c;
    this.places.select(-1, c);
    page.studio.through(() => ({ position: figure.moved(camera.joint, at), target: figure.moved(camera.joint, to) }), camera.fov);
  }

  nextCamera() {
    const n = this.figure?.cameras?.length ?? 0;
    if (n) this.lookThrough((this.look + 1) % n);
  }

  // Each frame ------------------------------------------------------------------------------------------------------

  update() {
    if (this.selected < 0) return;
    this.details.update();
    if (!this.ranges.group.visible) return;
    const j = this.selected;
    this.ranges.draw(this.figure, j, this.details.now, (a) => this.details.limit(j, a), this.details.frame(j));
  }

  edited() {
    this.tree.marks();
    this.shapes.update();
    this.details.update();
  }
}
