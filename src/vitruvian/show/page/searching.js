// Feature points that are found by themselves: asked for, awaited, coloured by how sure they are.

import { RAMP, css } from "./colors.js";

const $ = (id) => document.getElementById(id);
export const SURE = 0.5; // points with less are not saved: they want to be set by hand

/** Colour of a confidence 0..1. */
export const sureColor = (c) => css(RAMP[Math.round(255 * Math.min(1, Math.max(0, c)))]);

export class Searching {
  constructor(picking) {
    Object.assign(this, { picking, running: null });
    $("points-find").onclick = () => this.press();
    $("sure-ramp").style.background = `linear-gradient(to right, ${RAMP.filter((_, i) => i % 15 === 0).map(css).join(", ")})`;
  }

  /** Only a live page has somebody to ask. */
  show() { $("points-find").hidden = $("points-girths").hidden = !this.picking.page.source?.live; }

  press() {
    const { picking } = this, { source } = picking.page;
    if (this.running) { source.stopSearch(picking.figure.name); return; }
    source.find(picking.figure.name);
    this.begin("found");
  }

  begin(what) {
    this.running = what;
    $("points-find").textContent = "Stop";
    $("points-busy").hidden = false;
    $("points-busy").removeAttribute("value"); // under way, nobody knows how far
  }

  /** What the server says of its work. */
  heard({ what, actor, done, total, ready, stopped, error, points, girths }) {
    const { picking } = this;
    if (picking.figure?.name !== actor) return;
    if (!ready) {
      if (this.running !== what) this.begin(what);
      if (done) Object.assign($("points-busy"), { value: done, max: total });
      return;
    }
    this.running = null;
    $("points-find").textContent = "Find";
    $("points-busy").hidden = true;
    if (stopped) picking.say("Stopped.");
    else if (error) picking.say(error);
    else if (points) this.take(points);
    if (what === "girths") picking.girths.take(stopped || error ? null : girths);
  }

  /** Put what was found, {name: [x, y, z, confidence]}, where nobody has set a point: one step that can be taken back. */
  take(points) {
    const { picking } = this, own = (name) => picking.points.has(name) && picking.points.get(name).confidence === undefined;
    const fresh = Object.entries(points).filter(([name]) => picking.rows.has(name) && !own(name));
    picking.put(fresh.map(([name, [x, y, z, confidence]]) => [name, { point: [x, y, z], confidence }]));
    picking.sort();
    picking.select(picking.next(null));
    const low = fresh.filter(([, p]) => p[3] < SURE).length, kept = Object.keys(points).length - fresh.length;
    const parts = [`${fresh.length} found`, low ? `${low} of them unsure: set those, first in the list` : "", kept ? `${kept} of yours kept` : ""];
    picking.say(`${parts.filter(Boolean).join("; ")}.`);
    picking.girths.refresh();
  }

  /** The legend is there while points of this kind are. */
  update() { $("points-sure").hidden = ![...this.picking.points.values()].some((p) => p.confidence !== undefined); }
}
